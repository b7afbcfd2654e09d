"""The ``torchweather`` program and its commands, one file each; torch is imported when a command runs."""

from torchweather.cli.program import main

__all__ = ["main"]
