"""Numbers of a declaration: which are wrong, and what is expected instead."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError

__all__ = ["check_numbers"]


def check_numbers(values: Mapping[str, Any], path: Path) -> None:
    """Refuse what is no number of the kind that its key needs.

    Raises:
        TorchweatherError: with the file, the key, what was expected and what was read.
    """
    for key, (fits, wanted) in RULES.items():
        value = values.get(key)
        if key in values and not (value is None and key in MAY_BE_ABSENT) and not fits(value):
            raise TorchweatherError(f"{path}: {key} must be {wanted}; got {value!r}.")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _not_negative(value: Any) -> bool:
    return bool(_is_number(value) and value >= 0)


def _positive(value: Any) -> bool:
    return bool(_is_number(value) and value > 0)


def _whole(least: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= least


def _share(value: Any) -> bool:
    return bool(_is_number(value) and 0 <= value <= 1)


def _colours(each: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """One number, or one a colour."""
    return lambda value: all(map(each, value)) and len(value) in (1, 3) if isinstance(value, list) else each(value)


def _size(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_whole(1), value))


def _strides(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(map(_positive, value))


MAY_BE_ABSENT = ("nms_iou", "operating_threshold", "size")
RULES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "scale": (_positive, "a number, more than 0"),
    "exposure": (_positive, "a number, more than 0"),
    "mean": (_colours(_is_number), "a number, or one a colour"),
    "std": (_colours(_positive), "a number more than 0, or one a colour"),
    "fill": (_colours(lambda v: _not_negative(v) and v <= 255), "a level from 0 to 255, or one a colour"),
    "size": (_size, "[height, width] in pixels"),
    "multiple": (_whole(1), "a whole number of pixels, 1 or more"),
    "columns": (_whole(3), "3 or more (x, y, z, intensity, ...)"),
    "enlarge": (lambda value: isinstance(value, bool), "true or false"),
    "batch": (lambda value: isinstance(value, bool), "true or false"),
    "normalised": (lambda value: isinstance(value, bool), "true or false"),
    "threshold": (_share, "a number in [0, 1]"),
    "operating_threshold": (_share, "a number in [0, 1]"),
    "nms_iou": (_share, "a number in [0, 1]"),
    "strides": (_strides, "a list of pixels, one a level"),
    "centre": (_not_negative, "a number of strides, 0 or more"),
}
"""By the key: the test, and what is expected."""
