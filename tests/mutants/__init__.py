"""Deliberate breaks of the package, each with the tests that must notice it: ``python -m tests.mutants``.

A test that has never failed proves little. Each entry of ``rooms/`` changes one text of one module and names the tests
that must go red. The run works on a copy of the tree; the working tree stays as it is.
"""
