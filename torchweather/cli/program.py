"""The ``torchweather`` program and its commands.

Results go to standard output (``--json`` for machines), everything else to standard error. Exit code 0 is success, 2 a
mistake in what was asked or in a file, with one line that says what was wanted; 130, 143 and 129 are an end by Ctrl-C,
SIGTERM and SIGHUP.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TextIO

from torchweather import __version__
from torchweather.cli import (
    apply,
    augment,
    correlate,
    d34,
    demo,
    explain,
    fit,
    fit_sensor,
    gap,
    listing,
    metrics,
    robustness,
    sweep,
    validate,
    view,
)
from torchweather.cli.early import refuse_early
from torchweather.cli.mistakes import is_mistake, one_line
from torchweather.cli.output import printable
from torchweather.cli.signals import code_of, signals_drain

__all__ = ["main"]

COMMANDS = (
    explain,
    apply,
    view,
    augment,
    demo,
    metrics,
    sweep,
    correlate,
    robustness,
    validate,
    gap,
    fit,
    fit_sensor,
    d34,
    listing,
)
MISTAKE = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program.

    Args:
        argv: the arguments; ``None`` takes those of the process.

    Returns:
        The exit code.

    Example:
        >>> main(["explain", "--weather", "rain:rate=-1", "--sensor", "camera"])
        2
    """
    given = sys.argv[1:] if argv is None else list(argv)
    named = next((word for word in given if not word.startswith("-")), None)
    args = build_parser(named).parse_args(given)
    try:
        with signals_drain(), warnings_in_one_line():
            refuse_early(args, next(command.NAME for command in COMMANDS if command.run is args.run))
            code: int = args.run(args)
            sys.stdout.flush()
            return code
    except BrokenPipeError:
        # The reader (head, less) has left: what is buffered goes nowhere, so that the last flush is quiet.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt as end:
        sys.stderr.write(f"torchweather: interrupted{f' by {end}' if str(end) else ''}\n")
        return code_of(end)
    except Exception as error:
        if args.debug or not is_mistake(error):
            raise
        sys.stderr.write(f"torchweather: error: {printable(one_line(error))}\n")
        return MISTAKE


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser of all commands.

    Args:
        only: command that alone gets its arguments, of several hundred; ``None`` or another word: every command.
    """
    if only not in {command.NAME for command in COMMANDS}:
        only = None
    parser = argparse.ArgumentParser(
        prog="torchweather",
        description="Physically right rain, fog and snow on automotive camera, LiDAR and radar data.",
    )
    parser.add_argument("--version", action="version", version=f"torchweather {__version__}")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print JSON; keys are lower case with units")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        added = subparsers.add_parser(
            command.NAME, help=command.SUMMARY, description=command.DESCRIPTION, parents=[common]
        )
        if only in (None, command.NAME):
            command.add_arguments(added)
        added.set_defaults(run=command.run)
    return parser


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """The library's warnings on standard error as one line each, without the place in the code."""
    shown: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = " ".join(str(message).split())
        if text not in shown:
            shown.add(text)
            sys.stderr.write(f"torchweather: warning: {printable(text)}\n")

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)  # TorchweatherWarning is one; its module would import torch
        warnings.showwarning = show
        yield


if __name__ == "__main__":
    raise SystemExit(main())
