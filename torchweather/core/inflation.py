"""Bounds on what a compressed file may inflate to: a small file must not fill the memory."""

from __future__ import annotations

import os
from collections.abc import Iterable

from torchweather.core.errors import InputValueError, TorchweatherError

__all__ = ["MOST_MB", "check_inflated", "few_names"]

MOST_MB = "TORCHWEATHER_MAX_INFLATED_MB"
"""Environment variable that lifts the bound, to so many megabytes."""

# A photograph, a scan and a depth map shrink 2 to 20 times. Up to this size even a single colour is read.
_MOST_RATIO = 100
_ALWAYS_BYTES = 64 << 20


def check_inflated(source: object, inflated_bytes: int, stored_bytes: int) -> None:
    """Raise where a file would inflate to more than 64 MB and more than 100 times what is stored.

    Args:
        source: the file, for the error.
        inflated_bytes: size of its contents, bytes.
        stored_bytes: size in the file, bytes.

    Raises:
        TorchweatherError: the bound, and the environment variable that lifts it.

    Example:
        >>> check_inflated("frame.png", 6_000_000, 2_000_000)
    """
    allowed = max(_ALWAYS_BYTES, _MOST_RATIO * stored_bytes, _lifted_bytes())
    if inflated_bytes > allowed:
        raise TorchweatherError(
            f"{source}: it would inflate from {stored_bytes / 1e6:,.1f} MB to {inflated_bytes / 1e6:,.0f} MB; "
            f"at most {_MOST_RATIO} times and {_ALWAYS_BYTES / 1e6:.0f} MB are read. If the file is yours, set "
            f"{MOST_MB}={inflated_bytes // 1_000_000 + 1} in the environment."
        )


def _lifted_bytes() -> int:
    text = os.environ.get(MOST_MB)
    if text is None:
        return 0
    try:
        return int(float(text) * 1e6)
    except (ValueError, OverflowError) as error:
        raise InputValueError(f"{MOST_MB}: expected a number of megabytes; got {text!r}. Set e.g. 8000.") from error


def few_names(names: Iterable[str], most: int = 10) -> str:
    """The first of some names from a file, each shortened and printable, for an error.

    Example:
        >>> few_names([str(k) for k in range(30)], 3), few_names([])
        ('0, 1, 2 and 27 more', 'none')
    """
    every = list(names)
    shown = [ascii(name if len(name) <= 60 else f"{name[:57]}...")[1:-1] for name in every[:most]]
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(shown) + more if shown else "none"
