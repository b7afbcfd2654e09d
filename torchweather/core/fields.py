"""Fields of a frozen dataclass that a user fills in: type, finite, range and unit, from one declaration each.

A class declares ``RANGES``, field name to `Range`; the type comes from the annotation. `check_fields` in
``__post_init__`` checks them all and stores plain numbers.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from torch import Tensor

from torchweather.core.errors import check_at_least, check_between, check_finite, check_positive, owner_name
from torchweather.core.exceptions import InputTypeError, InputValueError

__all__ = ["Range", "above", "at_least", "between", "check_fields"]


@dataclass(frozen=True)
class Range:
    """Values that a field takes.

    Args:
        low, high: ends; both are taken, but the low one of ``open_low``.
        unit: for messages.
        open_low: above ``low``, not equal to it.
        named: both ends stand in the message; else the high one bounds what makes sense and is named when exceeded.
        advice: a sentence of the message.
    """

    low: float
    high: float
    unit: str = ""
    open_low: bool = False
    named: bool = True
    advice: str = ""

    def check(self, name: str, value: Any, owner: object) -> None:
        """Raise unless a number lies within the range; ``NaN`` does not."""
        if type(value) in (int, float) and self.low <= value <= self.high and (value > self.low or not self.open_low):
            return
        if self.open_low:
            check_positive(name, value, unit=self.unit, owner=owner, advice=self.advice)
        elif not self.named:
            check_at_least(name, value, self.low, unit=self.unit, owner=owner, advice=self.advice)
        if not self.named and math.isfinite(self.high):
            check_finite(name, value, unit=self.unit, owner=owner)
        check_between(name, value, self.low, self.high, unit=self.unit, owner=owner, advice=self.advice)


def between(low: float, high: float, unit: str = "", advice: str = "") -> Range:
    """Values from ``low`` to ``high``."""
    return Range(low, high, unit, advice=advice)


def above(low: float, high: float, unit: str = "", advice: str = "") -> Range:
    """Values above ``low``, up to ``high``, which bounds what makes sense."""
    return Range(low, high, unit, open_low=True, named=False, advice=advice)


def at_least(low: float, high: float, unit: str = "", advice: str = "") -> Range:
    """Values from ``low`` on, up to ``high``, which bounds what makes sense."""
    return Range(low, high, unit, named=False, advice=advice)


def check_fields(owner: Any, ranges: Mapping[str, Range]) -> None:
    """Check the fields of a frozen dataclass by their annotations and ranges; numbers become plain ones.

    Annotations ``bool``, ``int``, ``float``, ``str`` and tuples of floats, each perhaps ``| None``, are checked; other
    fields check themselves.

    Args:
        owner: the instance, in its ``__post_init__``.
        ranges: field name to range; of a tuple, the range of each value.

    Raises:
        InputTypeError: a flag or text of another type.
        InputValueError: no number or no sequence of them, not finite, not whole, or out of its range.
    """
    for field in fields(owner):
        kind, _, optional = str(field.type).partition(" | ")
        value = getattr(owner, field.name)
        if optional not in ("", "None") or (value is None and optional):
            continue
        checked = _checked(field.name, value, kind, ranges.get(field.name), owner)
        if checked is not value:
            object.__setattr__(owner, field.name, checked)


def _checked(name: str, value: Any, kind: str, within: Range | None, owner: object) -> Any:
    if kind == "bool":
        if not isinstance(value, (bool, np.bool_)):
            raise InputTypeError(f"{owner_name(owner)}: {name} must be True or False; got {value!r}.")
        return bool(value)
    if kind == "str":
        if not isinstance(value, str):
            raise InputTypeError(f"{owner_name(owner)}: {name} must be text; got {value!r}.")
        return value
    if kind in ("int", "float"):
        return _number(name, value, kind, within, owner)
    if kind.startswith("tuple[float"):
        return tuple(_number(name, one, "float", within, owner) for one in _sequence(name, value, kind, within, owner))
    return value


def _number(name: str, value: Any, kind: str, within: Range | None, owner: object) -> float | int:
    unit = within.unit if within else ""
    what = f"a {'whole ' if kind == 'int' else ''}number{f' in {unit}' if unit else ''}"
    if isinstance(value, (Tensor, np.ndarray)) and math.prod(value.shape) == 1:
        value = value.item()
    real = isinstance(value, numbers.Real) and not isinstance(value, (bool, np.bool_))
    if within is not None and (real or not isinstance(value, (Tensor, np.ndarray))):
        within.check(name, value, owner)
    if not real:
        raise InputValueError(f"{owner_name(owner)}: {name} must be {what}; got {value!r}.")
    if not _is_finite(value) and (within is None or math.isfinite(within.high)):
        raise InputValueError(f"{owner_name(owner)}: {name} must be a finite number; got {value!r}.")
    if kind == "float":
        return float(value)
    if value != int(value):
        raise InputValueError(f"{owner_name(owner)}: {name} must be {what}; got {value!r}.")
    return int(value)


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of more digits than float64 has
        return False


def _sequence(name: str, value: Any, kind: str, within: Range | None, owner: object) -> Sequence[Any]:
    wanted = 0 if "..." in kind else kind.count("float")
    if isinstance(value, (Tensor, np.ndarray)):
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence) or (wanted and len(value) != wanted):
        many = f"{wanted} numbers" if wanted else "numbers"
        unit = f" in {within.unit}" if within and within.unit else ""
        raise InputValueError(f"{owner_name(owner)}: {name} must be a sequence of {many}{unit}; got {value!r}.")
    return value
