"""Results on standard output: JSON that every reader takes, or lines."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from typing import Any

__all__ = ["note", "plain", "print_json", "print_lines", "spelled"]


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
