"""The library's exceptions, and the checks of numbers and names that raise them.

Each message names the owner, the expected value with its unit, the value that came, and the remedy.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

from torchweather.core.exceptions import (
    InputTypeError,
    InputValueError,
    MissingExtraError,
    TorchweatherError,
    TorchweatherWarning,
)
from torchweather.core.text import LONGEST_SHOWN, nearest_name

__all__ = [
    "InputTypeError",
    "InputValueError",
    "MissingExtraError",
    "TorchweatherError",
    "TorchweatherWarning",
    "check_at_least",
    "check_between",
    "check_finite",
    "check_one_of",
    "check_positive",
    "nearest_name",
]


def owner_name(owner: object) -> str:
    """Name under which ``owner`` (a string, a class or an instance) complains."""
    if isinstance(owner, str):
        return owner
    return owner.__name__ if isinstance(owner, type) else type(owner).__name__


def _shown(value: object) -> str:
    if isinstance(value, Tensor):
        if not value.numel():
            return "an empty tensor"
        if not _is_real(value):
            return f"{value.dtype} of shape {tuple(value.shape)}"
        value = value.detach().double()
        if value.numel() == 1:
            return f"{value.item():g}"
        return f"a tensor with values {value.min().item():g}..{value.max().item():g}"
    try:
        text = repr(value)
    except ValueError:  # Python writes whole numbers of a few thousand digits at most
        return "a whole number of too many digits"
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def _is_real(value: Tensor) -> bool:
    return not value.is_complex() and value.dtype != torch.bool


def _all(value: Any, holds: Any) -> bool:
    if isinstance(value, Tensor):
        if torch.compiler.is_compiling():
            return True
        if not _is_real(value):
            return False
        # Comparisons of torch.uint16 and its like are missing on some devices.
        return bool(holds(value.detach() if value.is_floating_point() else value.double()).all())
    # numbers.Real: numpy's scalars are numbers too.
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        number = float(value)
    except OverflowError:  # a whole number of more digits than float64 has, which nothing can compute with
        return False
    return bool(holds(number))


def check_finite(name: str, value: Any, *, unit: str = "", owner: object) -> None:
    """Raise `InputValueError` unless ``value`` (a number or a tensor) is finite."""
    if not _all(value, lambda v: v.isfinite() if isinstance(v, Tensor) else math.isfinite(v)):
        raise InputValueError(f"{owner_name(owner)}: {name} must be a finite number{_in(unit)}; got {_shown(value)}.")


def check_at_least(name: str, value: Any, low: float, *, unit: str = "", owner: object, advice: str = "") -> None:
    """Raise `InputValueError` unless ``value`` (a number or a tensor) is at least ``low``; NaN is refused."""
    low = float(low)  # a whole number may have more digits than a tensor takes
    if not _all(value, lambda v: v >= low):
        raise InputValueError(
            f"{owner_name(owner)}: {name} must be {low:g}{_unit(unit)} or more; got {_shown(value)}.{_then(advice)}"
        )


def check_positive(name: str, value: Any, *, unit: str = "", owner: object, advice: str = "") -> None:
    """Raise `InputValueError` unless ``value`` (a number or a tensor) is above zero; NaN is refused."""
    if not _all(value, lambda v: v > 0):
        raise InputValueError(
            f"{owner_name(owner)}: {name} must be above 0{_unit(unit)}; got {_shown(value)}.{_then(advice)}"
        )


def check_between(
    name: str, value: Any, low: float, high: float, *, unit: str = "", owner: object, advice: str = ""
) -> None:
    """Raise `InputValueError` unless ``low <= value <= high``; NaN is refused."""
    if not _all(value, lambda v: (v >= low) & (v <= high)):
        limits = f"{low:g}..{'inf' if math.isinf(high) else format(high, 'g')}"
        raise InputValueError(
            f"{owner_name(owner)}: {name} must lie in {limits}{_unit(unit)}; got {_shown(value)}.{_then(advice)}"
        )


def check_one_of(name: str, value: Any, allowed: Iterable[str], *, owner: object) -> None:
    """Raise `InputValueError` unless ``value`` is one of the ``allowed`` names; the nearest one is suggested."""
    names = list(allowed)
    # A tensor or an array is no name; asked whether it is, it answers for each element.
    if hasattr(value, "__array__") or value not in names:
        shown = _shown(value)
        raise InputValueError(
            f"{owner_name(owner)}: {name} must be one of {', '.join(names)}; got {shown}.{nearest_name(value, names)}"
        )


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _in(unit: str) -> str:
    return f" in {unit}" if unit else ""


def _then(advice: str) -> str:
    return f" {advice}" if advice else ""
