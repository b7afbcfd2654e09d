"""Results on standard output: JSON that every reader takes, or lines."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from typing import Any

__all__ = ["note", "plain", "print_json", "print_lines"]


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


def print_json(value: Any) -> None:
    """JSON on standard output."""
    sys.stdout.write(json.dumps(plain(value), indent=2, allow_nan=False) + "\n")


def print_lines(text: str) -> None:
    """Text on standard output."""
    sys.stdout.write(text + "\n")


def note(text: str, *, quiet: bool = False) -> None:
    """One line on standard error about a choice that was made for the user."""
    if not quiet:
        sys.stderr.write(f"torchweather: {text}\n")
