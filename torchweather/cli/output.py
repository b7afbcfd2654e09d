"""Results on standard output: JSON that every reader takes, or lines."""

from __future__ import annotations

import argparse
import json
import math
import sys
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

__all__ = ["add_no_fsync", "listed", "note", "plain", "print_json", "print_lines", "printable", "shown", "spelled"]

NAMED = 5  # files in a line; JSON has them all


def add_no_fsync(parser: argparse.ArgumentParser) -> None:
    """The argument that does not wait for the disk."""
    parser.add_argument(
        "--no-fsync",
        action="store_true",
        help="do not wait until the disk has each file: faster, but a power cut may leave empty ones",
    )


def plain(value: Any) -> Any:
    """Values as JSON knows them: infinite and undefined numbers become None, tuples lists, paths text.

    Example:
        >>> plain({"mor_m": math.inf, "airlight": (0.5, 0.25)})
        {'mor_m': None, 'airlight': [0.5, 0.25]}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, int)):
        return value
    return str(value)


def spelled(value: Any) -> Any:
    """Values as JSON knows them, but infinite and undefined numbers as the texts ``inf``, ``-inf`` and ``nan``.

    Scores are infinite for a reason (PSNR of identical images), which None would not tell from a missing one.

    Example:
        >>> spelled({"psnr": math.inf, "ssim": [1.0, math.nan]})
        {'psnr': 'inf', 'ssim': [1.0, 'nan']}
    """
    if isinstance(value, Mapping):
        return {str(key): spelled(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [spelled(entry) for entry in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else plain(value)


def printable(text: str, *, lines: bool = False) -> str:
    r"""Text that cannot steer a terminal: control characters and bytes that are no UTF-8 are written as escapes.

    Args:
        text: that may hold names of files.
        lines: keep line breaks.

    Example:
        >>> print(printable("a\x1b[2J.png"))
        a\x1b[2J.png
    """
    return "".join(
        one if (lines and one == "\n") or not _steers(one) else one.encode("unicode_escape").decode("ascii")
        for one in text
    )


def listed(names: Iterable[str]) -> str:
    """The first of many names.

    Example:
        >>> listed(["a", "b"]), listed("abcdefg")
        ('a, b', 'a, b, c, d, e and 2 more')
    """
    every = list(names)
    more = f" and {len(every) - NAMED} more" if len(every) > NAMED else ""
    return ", ".join(every[:NAMED]) + more


def shown(value: Any) -> Any:
    """Values whose texts are ``printable``, also where a name holds a line break."""
    if isinstance(value, Mapping):
        return {key: shown(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [shown(entry) for entry in value]
    return printable(value) if isinstance(value, str) else value


def _steers(one: str) -> bool:
    """Control characters, marks that turn the direction of writing, separators of lines, halves of surrogate pairs."""
    return unicodedata.category(one) in ("Cc", "Cf", "Cs", "Zl", "Zp")


def print_json(value: Any) -> None:
    """JSON on standard output."""
    sys.stdout.write(json.dumps(plain(value), indent=2, allow_nan=False) + "\n")


def print_lines(text: str) -> None:
    """Text on standard output; names in it cannot steer the terminal."""
    sys.stdout.write(printable(text, lines=True) + "\n")


def note(text: str, *, quiet: bool = False) -> None:
    """One line on standard error about a choice that was made for the user."""
    if not quiet:
        sys.stderr.write(f"torchweather: {printable(text)}\n")
