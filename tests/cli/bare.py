"""Arguments of commands whose results are compared with the transforms' own calls."""

from __future__ import annotations

from collections.abc import Sequence

PLAIN = {"apply": ("--seed-rule", "added", "--no-record"), "sweep": ("--seed-rule", "added", "--no-record")}


def bare(argv: Sequence[object]) -> list[str]:
    """Arguments as texts; ``apply`` and ``sweep`` take plain seeds, as the transforms do, and write results alone.

    The defaults, seeds hashed with the file's name and a record, have tests of their own (test_cli_many_files).
    """
    words = [str(argument) for argument in argv]
    return words if "--seed-rule" in words else [*words, *PLAIN.get(words[0], ())]
