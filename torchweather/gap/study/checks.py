"""Arrays of a study: names, shapes, units and ranges of each kind, and the check that holds data against them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.gap.study.frames import Frame

__all__ = ["ARRAYS", "ArrayRule", "FrameRule"]

Array = NDArray[Any]
Holds = Callable[[Array], NDArray[np.bool_]]

# A unit vector whose components were rounded to half precision (2^-11 each) is off by less.
UNIT_TOLERANCE = 1e-3
# P.838-3 gives its coefficients for these frequencies (PHYSICS.md 6.5).
LINK_FREQUENCIES_GHZ = (1.0, 1000.0)


@dataclass(frozen=True)
class ArrayRule:
    """What an array must be.

    Args:
        shape: a number or a letter for each axis; a letter is the same number wherever it stands.
        wanted: the values in words, with their unit.
        holds: where the values are as wanted, of the array's shape (vectors: without the last axis).
        required: whether a frame must have it.
        advice: what to do where values are not as wanted.
    """

    shape: tuple[str | int, ...]
    wanted: str
    holds: Holds
    required: bool = True
    advice: str = ""


def _between(low: float, high: float) -> Holds:
    return lambda values: (values >= low) & (values <= high)


def _finite_from(low: float) -> Holds:
    return lambda values: (values >= low) & (values < math.inf)


def _or_nan(holds: Holds) -> Holds:
    return lambda values: holds(values) | np.isnan(values)


def _unit_vectors(values: Array) -> NDArray[np.bool_]:
    return np.asarray(np.abs(np.linalg.norm(values.astype(np.float64), axis=-1) - 1.0) <= UNIT_TOLERANCE)


def _normals(values: Array) -> NDArray[np.bool_]:
    """Unit vectors, and NaN or zeros where there is no surface."""
    return np.asarray(_unit_vectors(values) | np.isnan(values).all(-1) | (values == 0).all(-1))


def _whole(values: Array) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(values) & (values == np.rint(values)))


def _one_of(*numbers: float) -> Holds:
    return lambda values: np.isin(values, numbers)


def _not_infinite(values: Array) -> NDArray[np.bool_]:
    return np.asarray(~np.isinf(values))


GRID, TARGETS, LINKS = ("H", "W"), ("N",), ("L",)

ARRAYS: Mapping[tuple[str, str], Mapping[str, ArrayRule]] = {
    ("lidar", "beams"): {
        "direction": ArrayRule(
            (*GRID, 3), "unit vectors x forward, y left, z up", _unit_vectors, advice="Divide by their length."
        ),
    },
    ("lidar", "geometry"): {
        "cos_incidence": ArrayRule(
            GRID, "0..1, or NaN where a beam meets no surface", _or_nan(_between(0.0, 1.0 + UNIT_TOLERANCE)), False
        ),
        "up": ArrayRule(
            GRID,
            "-1..1 (z of the surface's normal), or NaN where a beam meets no surface",
            _or_nan(_between(-1.0 - UNIT_TOLERANCE, 1.0 + UNIT_TOLERANCE)),
            False,
        ),
    },
    ("lidar", "frame"): {
        "range_m": ArrayRule(
            GRID, "0 m (no return) or more, finite", _finite_from(0.0), advice="Set beams without a return to 0."
        ),
        "intensity": ArrayRule(
            GRID,
            "0 or more in the sensor's intensity_unit, finite",
            _finite_from(0.0),
            advice="Set beams without a return to 0.",
        ),
    },
    ("camera", "geometry"): {
        "depth_m": ArrayRule(
            GRID,
            "above 0 m along the optical axis, inf for sky",
            lambda values: values > 0,
            advice="Sky is inf, not 0.",
        ),
        "normal": ArrayRule((*GRID, 3), "unit vectors, or NaN or 0 where there is no surface", _normals, False),
        "label": ArrayRule(GRID, "whole numbers", _whole, False),
    },
    ("camera", "frame"): {
        "bayer": ArrayRule(
            GRID,
            "0 (black) to 1 (saturation), linear in light",
            _between(0.0, 1.0),
            advice="Subtract the black level, divide by white level less black level, and clip.",
        ),
    },
    ("radar", "geometry"): {
        "range_m": ArrayRule(TARGETS, "0 m or more, finite", _finite_from(0.0)),
        "azimuth_rad": ArrayRule(TARGETS, "-pi..pi rad", _between(-math.pi, math.pi), advice="Degrees are not taken."),
        "elevation_rad": ArrayRule(
            TARGETS, "-pi/2..pi/2 rad", _between(-math.pi / 2, math.pi / 2), advice="Degrees are not taken."
        ),
        "speed_m_per_s": ArrayRule(TARGETS, "finite, m/s", np.isfinite),
        "target_class": ArrayRule(TARGETS, "whole numbers", _whole),
    },
    ("radar", "frame"): {
        "power_db": ArrayRule(TARGETS, "finite in dB, or NaN where the target was not detected", _not_infinite),
        "range_m": ArrayRule(
            TARGETS, "0 m or more and finite, or NaN where the target was not detected", _or_nan(_finite_from(0.0))
        ),
        "speed_m_per_s": ArrayRule(TARGETS, "finite in m/s, or NaN where the target was not detected", _not_infinite),
        "noise_floor_db": ArrayRule((), "finite in dB", np.isfinite),
        "clutter": ArrayRule(
            ("M", 6),
            "finite: range m, azimuth rad, elevation rad, speed m/s, power dB, Doppler width m/s",
            np.isfinite,
            False,
        ),
    },
    ("link", "links"): {
        "length_km": ArrayRule(LINKS, "above 0 km, finite", lambda v: (v > 0) & (v < math.inf)),
        "frequency_ghz": ArrayRule(LINKS, "1..1000 GHz", _between(*LINK_FREQUENCIES_GHZ), advice="Divide MHz by 1000."),
        "polarisation": ArrayRule(LINKS, "0 (horizontal) or 1 (vertical)", _one_of(0, 1)),
        "split": ArrayRule(LINKS, "0 (fit) or 1 (holdout)", _one_of(0, 1)),
    },
    ("link", "frame"): {
        "time_s": ArrayRule(("T",), "finite, s", np.isfinite),
        "attenuation_db": ArrayRule(("T", "L"), "finite in dB, or NaN where a sample is missing", _not_infinite),
        "rain_mm_per_h": ArrayRule(
            ("T", "L", "P"), "0 mm/h or more and finite, or NaN where a sample is missing", _or_nan(_finite_from(0.0))
        ),
    },
}
"""By kind and part: the arrays of ``GAP.md`` section 1."""


@dataclass(frozen=True)
class FrameRule:
    """The check of all frames of one part of a study.

    Args:
        kind: ``lidar``, ``camera``, ``radar`` or ``link``.
        part: ``beams``, ``geometry``, ``frame`` or ``links``.
        sizes: what is known of the letters in the shapes.
        sizes_from: where that comes from, in words.
        full_scale: largest intensity of the sensor's unit; ``None`` without an end.

    Example:
        >>> rule = FrameRule("camera", "frame", {"H": 2, "W": 4}, "the camera")
        >>> rule({"bayer": np.full((2, 4), 0.5)}, "c00-000.npz")["bayer"].shape
        (2, 4)
        >>> rule({"bayer": np.full((2, 4), 512.0)}, "c00-000.npz")
        Traceback (most recent call last):
        torchweather.core.errors.TorchweatherError: c00-000.npz: bayer must be 0 (black) to 1 (saturation) ...
    """

    kind: str
    part: str
    sizes: Mapping[str, int] = field(default_factory=dict)
    sizes_from: str = ""
    full_scale: float | None = None

    def __call__(self, frame: Frame, name: str) -> Frame:
        """The frame, each array as it was stored (a scalar without axes)."""
        rules = ARRAYS[self.kind, self.part]
        if not isinstance(frame, Mapping):
            raise TorchweatherError(f"{name}: wanted arrays by name ({', '.join(rules)}); got {type(frame).__name__}.")
        self._check_names(frame, rules, name)
        sizes = dict(self.sizes)
        checked: dict[str, Array] = {}
        for key, value in frame.items():
            if key in rules:
                checked[key] = self._array(key, value, rules[key], sizes, name)
            else:
                checked[key] = numbers(value, f"{name}: {key}")
        self._check_together(checked, name)
        return checked

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
            wrong = ~np.asarray(rule.holds(array))
        _refuse(wrong, array, f"{name}: {key} must be {rule.wanted}", rule.advice)
        if key == "intensity" and self.full_scale is not None:
            _refuse(
                array > self.full_scale,
                array,
                f"{name}: intensity must be at most {self.full_scale:g} in the sensor's intensity_unit",
                "Name the unit of the data in the sensor's overrides.",
            )
        return array

    def _check_together(self, frame: Mapping[str, Array], name: str) -> None:
        """What one array says of another."""
        if (self.kind, self.part) == ("radar", "frame"):
            seen = ~np.isnan(frame["power_db"])
            for key in ("range_m", "speed_m_per_s"):
                _refuse(
                    seen & np.isnan(frame[key]),
                    frame[key],
                    f"{name}: {key} must be a number wherever power_db is one",
                    "Set power_db to NaN where the target was not detected.",
                )
        if (self.kind, self.part) == ("link", "frame"):
            time_s = frame["time_s"].astype(np.float64)
            _refuse(
                np.concatenate([[False], np.diff(time_s) <= 0]),
                time_s,
                f"{name}: time_s must rise from sample to sample, s",
                "Sort the samples and drop double ones.",
            )
            for key in ("attenuation_db", "rain_mm_per_h"):
                if np.isnan(frame[key]).all():
                    raise TorchweatherError(f"{name}: {key} must hold some numbers; got NaN everywhere.")

    @staticmethod
    def _shape(shape: Sequence[str | int]) -> str:
        return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})" if shape else "() (a scalar)"


def numbers(value: Any, name: str) -> Array:
    """A value as an array of real numbers in native byte order; ``name`` goes into the message."""
    array = value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TorchweatherError(f"{name} must be real numbers (float, int or bool); got dtype {array.dtype}.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _refuse(wrong: Any, array: Array, must: str, advice: str) -> None:
    """Raise where anything is wrong: how much, and the first of it."""
    count = int(np.count_nonzero(wrong))
    if count:
        first = tuple(int(place) for place in np.argwhere(wrong)[0])
        where = f" at {first if len(first) != 1 else first[0]}" if first else ""
        shown = array[first].tolist() if first else array.tolist()
        of = f" ({count} of {np.size(wrong)} are not)" if np.size(wrong) > 1 else ""
        raise TorchweatherError(f"{must}; got {shown}{where}{of}.{' ' + advice if advice else ''}")
