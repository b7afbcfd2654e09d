"""Rules for the arrays of a study: names, shapes, units and ranges, and the check of data by them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.gap.study.frames import Frame

__all__ = ["UNIT_TOLERANCE", "ArrayRule", "FrameRule", "numbers", "refuse", "unit_vectors"]

Array = NDArray[Any]

# A unit vector whose components were rounded to half precision (2^-11 each) is off by less.
UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class ArrayRule:
    """Rule for an array.

    Args:
        shape: a number or a letter for each axis; a letter is the same number wherever it stands.
        wanted: the values in words, with their unit.
        low, high: of finite values.
        nan: whether NaN is wanted as well.
        whole: whether values must be whole numbers.
        holds: where the values are as wanted, of the array's shape (vectors: without the last axis), in place of the
            four above.
        required: whether a frame must have it.
        advice: what to do where values are not as wanted.
    """

    shape: tuple[str | int, ...]
    wanted: str
    low: float = -math.inf
    high: float = math.inf
    nan: bool = False
    whole: bool = False
    holds: Callable[[Array], NDArray[np.bool_]] | None = None
    required: bool = True
    advice: str = ""

    def __call__(self, values: Array) -> NDArray[np.bool_]:
        """True where the values are as wanted."""
        if self.holds is not None:
            return self.holds(values)
        inside = np.isfinite(values) & (values >= self.low) & (values <= self.high)
        if self.whole:
            inside &= values == np.rint(values)
        return np.asarray(inside | np.isnan(values) if self.nan else inside)


def unit_vectors(values: Array) -> NDArray[np.bool_]:
    """True for vectors of length 1, along the last axis."""
    return np.asarray(np.abs(np.linalg.norm(values.astype(np.float64), axis=-1) - 1.0) <= UNIT_TOLERANCE)


@dataclass(frozen=True)
class FrameRule:
    """The check of all frames of one part of a study.

    Args:
        arrays: rule of each array.
        sizes: what is known of the letters in the shapes.
        sizes_from: where that comes from, in words.
        together: raises where the arrays contradict each other, or the sensor; gets the frame and its name.

    Example:
        >>> arrays = {"bayer": ArrayRule(("H", "W"), "0 (black) to 1 (saturation)", 0.0, 1.0)}
        >>> rule = FrameRule(arrays, {"H": 2, "W": 4}, "the camera")
        >>> rule({"bayer": np.full((2, 4), 0.5)}, "c00-000.npz")["bayer"].shape
        (2, 4)
        >>> rule({"bayer": np.full((2, 4), 512.0)}, "c00-000.npz")
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: c00-000.npz: bayer must be 0 (black) to 1 (saturation) ...
    """

    arrays: Mapping[str, ArrayRule]
    sizes: Mapping[str, int] = field(default_factory=dict)
    sizes_from: str = ""
    together: Callable[[Frame, str], None] | None = None

    def __call__(self, frame: Frame, name: str) -> Frame:
        """The frame, each array as it was stored (a scalar without axes)."""
        rules = self.arrays
        if not isinstance(frame, Mapping):
            raise TorchweatherError(
                f"{name}: expected arrays by name ({', '.join(rules)}); got {type(frame).__name__}."
            )
        self._check_names(frame, rules, name)
        sizes = dict(self.sizes)
        checked: dict[str, Array] = {}
        for key, value in frame.items():
            if key in rules:
                checked[key] = self._array(key, value, rules[key], sizes, name)
            else:
                checked[key] = numbers(value, f"{name}: {key}")
        if self.together is not None:
            self.together(checked, name)
        return checked

    def sized_by(self, others: Mapping[str, ArrayRule], frame: Frame, name: str) -> FrameRule:
        """The rule with the sizes that a frame of other arrays has, where none are known yet."""
        known = [(others[key].shape, array.shape) for key, array in frame.items() if key in others]
        sizes = {axis: size for pair in known for axis, size in zip(*pair, strict=True) if isinstance(axis, str)}
        return self if self.sizes else replace(self, sizes=sizes, sizes_from=name)

    def _check_names(self, frame: Frame, rules: Mapping[str, ArrayRule], name: str) -> None:
        absent = [key for key in rules if key not in frame]
        for key in frame:
            # Another array may stand beside the known ones, but not one that was meant to be one of them.
            if key not in rules and nearest_name(key, absent):
                raise TorchweatherError(f"{name}: unknown array {key!r}.{nearest_name(key, absent)}")
        for key in absent:
            if rules[key].required:
                raise TorchweatherError(
                    f"{name}: the array {key!r} is missing: {self._shape(rules[key].shape)}, {rules[key].wanted}; got "
                    f"{', '.join(frame) or 'no arrays'}."
                )

    def _array(self, key: str, value: Any, rule: ArrayRule, sizes: dict[str, int], name: str) -> Array:
        array = numbers(value, f"{name}: {key}")
        if rule.shape == () and array.shape == (1,):
            array = array.reshape(())
        fits = array.ndim == len(rule.shape) and all(
            size == (sizes.setdefault(axis, size) if isinstance(axis, str) else axis)
            for axis, size in zip(rule.shape, array.shape, strict=True)
        )
        if not fits:
            known = tuple(sizes.get(axis, axis) if isinstance(axis, str) else axis for axis in rule.shape)
            told = f" = {self._shape(known)} as in {self.sizes_from}" if self.sizes_from and rule.shape else ""
            raise TorchweatherError(
                f"{name}: {key} must have shape {self._shape(rule.shape)}{told}; got {array.shape}."
            )
        if array.size == 0 and "M" not in rule.shape:
            raise TorchweatherError(f"{name}: {key} must hold numbers, {self._shape(rule.shape)}; it is empty.")
        with np.errstate(invalid="ignore"):
            wrong = ~rule(array)
        refuse(wrong, array, f"{name}: {key} must be {rule.wanted}", rule.advice)
        return array

    @staticmethod
    def _shape(shape: Sequence[str | int]) -> str:
        return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})" if shape else "() (a scalar)"


def numbers(value: Any, name: str) -> Array:
    """A value as an array of real numbers in native byte order; ``name`` goes into the message."""
    array = as_numpy(value) if isinstance(value, Tensor) else np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TorchweatherError(f"{name} must be real numbers (float, int or bool); got dtype {array.dtype}.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def refuse(wrong: Any, array: Array, must: str, advice: str) -> None:
    """Raise where anything is wrong: how much, and the first of it."""
    count = int(np.count_nonzero(wrong))
    if count:
        first = tuple(int(place) for place in np.argwhere(wrong)[0])
        where = f" at {first if len(first) != 1 else first[0]}" if first else ""
        shown = array[first].tolist() if first else array.tolist()
        of = f" ({count} of {np.size(wrong)} are not)" if np.size(wrong) > 1 else ""
        raise TorchweatherError(f"{must}; got {shown}{where}{of}.{' ' + advice if advice else ''}")
