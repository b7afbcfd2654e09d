"""Scalar quantities of a condition, measured beside simulated: bias, and scatter once the bias is taken off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.camera.bayer import cfa_index
from torchweather.camera.sensor import Camera
from torchweather.gap.study.study import Frame, Study
from torchweather.metrics.double_validation import double_validation

__all__ = ["Quantity", "Values", "compared_quantities", "quantity", "values_of"]

# A frame gives a quantity at most so many values, evenly picked: their distribution function is that of all to 0.005
# (1.36 / sqrt(n), the 95 % band of Kolmogorov and Smirnov).
VALUES_A_FRAME = 1 << 16

Array = NDArray[np.float64]
Values = dict[tuple[str, str], Array]
"""(quantity, unit) to its values in one frame."""


@dataclass(frozen=True)
class Quantity:
    """The double validation metric of one quantity; everything in its unit.

    Args:
        name, unit: of the quantity.
        measured_median, simulated_median: over all frames; not a number without a value.
        bias: simulated less measured median.
        scatter: area between the distribution functions once the bias is taken off.
        floor_bias, floor_scatter: the same of one half of the clear frames against the other; not a number where
            there are no two clear frames.
        rmse: root mean square of simulated less measured where the values pair one by one (links), else not a number.
        values: how many there are, measured and simulated.
    """

    name: str
    unit: str
    measured_median: float
    simulated_median: float
    bias: float
    scatter: float
    floor_bias: float
    floor_scatter: float
    rmse: float
    values: tuple[int, int]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "values": list(self.values)}


def values_of(study: Study, frame: Frame) -> Values:
    """The quantities of a frame: range, intensity and number of returns; signal per colour; power and number of
    detections.
    """
    return VALUES[study.kind](study, frame)


def _of_image(study: Study, frame: Frame) -> Values:
    camera, bayer = Camera.of(study.sensor), np.asarray(frame["bayer"], dtype=np.float64)
    index = cfa_index(bayer.shape[0], bayer.shape[1], camera.bayer_pattern).numpy()
    colours = enumerate(camera.bands)
    return {(f"signal, {name}", "of saturation"): _thinned(bayer[index == number]) for number, name in colours}


def _of_scan(study: Study, frame: Frame) -> Values:
    seen = np.asarray(frame["range_m"]) > 0
    return {
        ("range of the returns", "m"): _thinned(np.asarray(frame["range_m"], dtype=np.float64)[seen]),
        ("intensity of the returns", ""): _thinned(np.asarray(frame["intensity"], dtype=np.float64)[seen]),
        ("returns in a frame", ""): np.array([float(seen.sum())]),
    }


def _of_detections(study: Study, frame: Frame) -> Values:
    power = np.asarray(frame["power_db"], dtype=np.float64)
    seen = np.isfinite(power)
    return {
        ("power of the detections", "dB"): _thinned(power[seen]),
        ("detections in a frame", ""): np.array([float(seen.sum())]),
    }


VALUES = {"camera": _of_image, "lidar": _of_scan, "radar": _of_detections}


def _thinned(values: Array) -> Array:
    return values[:: max(1, -(-len(values) // VALUES_A_FRAME))]


def compared_quantities(
    measured: Sequence[Values], simulated: Sequence[Values], clear: Sequence[Values]
) -> tuple[Quantity, ...]:
    """Every quantity of the frames of a condition.

    Args:
        measured, simulated: of their frames.
        clear: of the clear frames, whose even and odd ones are held against each other.
    """
    return tuple(
        quantity(
            name,
            unit,
            _pooled(measured, name, unit),
            _pooled(simulated, name, unit),
            _pooled(clear[::2], name, unit),
            _pooled(clear[1::2], name, unit),
        )
        for name, unit in measured[0]
    )


def _pooled(frames: Sequence[Values], name: str, unit: str) -> Array:
    return np.concatenate([np.zeros(0), *(frame[name, unit] for frame in frames)])


def quantity(
    name: str,
    unit: str,
    measured: Array,
    simulated: Array,
    clear: Array,
    other_clear: Array,
    rmse: float = math.nan,
) -> Quantity:
    """The double validation metric of values, and its floor.

    Args:
        name, unit: of the quantity.
        measured, simulated: ``(N,)`` and ``(M,)``, finite.
        clear, other_clear: of clear frames, for the floor.
        rmse: of the pairs.

    Example:
        >>> one, other = np.array([1.0, 2.0, 3.0]), np.array([1.5, 2.5, 3.5])
        >>> found = quantity("range", "m", one, other, one, one)
        >>> found.bias, found.scatter, found.floor_bias
        (0.5, 0.0, 0.0)
    """
    bias, scatter = _both(simulated, measured)
    floor_bias, floor_scatter = _both(other_clear, clear)
    return Quantity(
        name=name,
        unit=unit,
        measured_median=_median(measured),
        simulated_median=_median(simulated),
        bias=bias,
        scatter=scatter,
        floor_bias=floor_bias,
        floor_scatter=floor_scatter,
        rmse=rmse,
        values=(len(measured), len(simulated)),
    )


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _both(simulated: Array, measured: Array) -> tuple[float, float]:
    if not len(simulated) or not len(measured):
        return math.nan, math.nan
    found = double_validation(torch.from_numpy(simulated), torch.from_numpy(measured))
    return float(found.bias), float(found.scatter)
