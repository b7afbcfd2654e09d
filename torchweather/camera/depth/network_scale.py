"""Scale and shift of a depth network's relative output: from flat ground below the camera, or from measured points."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.camera.depth.completion_scene import CompletedSource
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError

__all__ = ["Alignment", "check_metric", "fit_to_ground", "fit_to_points", "points_in_picture"]

Array = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]

# A pixel counts for the ground within this relative deviation of inverse depth.
_AGREES = 0.10
# Ground farther than this is left out: half a degree of pitch moves it by 16 % at 30 m and 1.65 m height.
GROUND_FARTHEST_M = 30.0
# Bands of rows and quantiles of the output in each from which lines are tried; the ground is the far side of a band,
# since things stand on it and hide what lies behind.
_BANDS, _QUANTILES = 8, (0.05, 0.15, 0.3, 0.5, 0.7)
_SAMPLES = 4000  # pixels that judge a line
_LEAST_PIXELS = 50
_ROUNDS = 50  # of reweighting; both fits settle within 30
# Nothing below the horizon of a street has a median depth outside of this: the output has another unit.
_NEAREST_MEDIAN_M, _FARTHEST_MEDIAN_M = 0.2, 500.0
# Correlation with the ground's inverse depth. On 13 KITTI frames the LiDAR's inverse depth has 0.24 to 0.97, its depth
# taken for an inverse one -0.90 to -0.43.
_REVERSED = -0.2


@dataclass(frozen=True)
class Alignment:
    """``1/z = scale x + shift``, 1/m, of a network's output ``x``, an inverse depth up to scale and shift.

    Args:
        scale: 1/m per unit of the output, more than 0.
        shift: 1/m.
        agreeing: share of the pixels or points within 10 % of the line's inverse depth.
    """

    scale: float
    shift: float
    agreeing: float


def points_in_picture(source: CompletedSource, inverse: Array, usable: Mask, camera: Camera) -> tuple[Array, Array]:
    """The network's output at the measured points that the camera sees, and their depth.

    Args:
        source: the points; those that the camera cannot see are left out.
        inverse: ``(H, W)`` the network's output.
        usable: ``(H, W)``, false for sky and the own vehicle.
        camera: of the picture.

    Returns:
        Output and metres, ``(N,)`` each.
    """
    height, width = inverse.shape
    _, seen = source.seen_points(camera, height, width)
    column, row = np.rint(seen[0].pixel_xy).astype(np.intp).T
    depth_m = seen[0].points_xyz[:, 2]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (depth_m > 0)
    inside[inside] = usable[row[inside], column[inside]]
    return inverse[row[inside], column[inside]], depth_m[inside]


def fit_to_points(inverse: Array, depth_m: Array, *, with_shift: bool) -> Alignment:
    """Scale and shift from measured points, by least absolute deviations of ``z (scale x + shift) - 1``.

    The relative deviation counts, so that far points count as much as near ones.

    Args:
        inverse: ``(N,)`` the network's output at the points, rising towards the camera.
        depth_m: ``(N,)`` metres.
        with_shift: else the shift is 0.

    Raises:
        ValueError: fewer than 50 points, or an output that does not rise towards the camera.
    """
    if len(inverse) < _LEAST_PIXELS:
        raise InputValueError(
            f"DepthNetwork: the scale needs {_LEAST_PIXELS} measured points in the picture; got {len(inverse)}."
        )
    line = _least_absolute(inverse, 1.0 / depth_m, with_shift)
    return _checked(line, inverse, 1.0 / depth_m, "measured points")


def fit_to_ground(inverse: Array, ground_m: Array, usable: Mask, *, with_shift: bool) -> Alignment:
    """Scale and shift from flat ground: the line on which most pixels of the road agree.

    Lines through two bands of rows are tried (one band without a shift) and judged by all pixels' truncated relative
    deviations; the best is refined by Tukey's weights. Cars, kerbs and walls are outliers.

    Args:
        inverse: ``(H, W)`` the network's output, rising towards the camera.
        ground_m: ``(H, W)`` depth of the flat ground, metres; ``inf`` above the horizon.
        usable: ``(H, W)``, false for sky and the own vehicle.
        with_shift: else the shift is 0.

    Raises:
        ValueError: too little ground in view, or an output that does not rise towards the camera.
    """
    row, column = np.nonzero(usable & (ground_m < GROUND_FARTHEST_M))
    if len(row) < _LEAST_PIXELS:
        raise InputValueError(
            f"DepthNetwork: no ground nearer than {GROUND_FARTHEST_M:g} m is in view ({len(row)} pixels), so it cannot "
            "give the scale. Check pitch and height of the camera, or scale by LiDAR points."
        )
    chosen = np.random.default_rng(0).permutation(len(row))[:_SAMPLES]
    x = inverse[row[chosen], column[chosen]].astype(np.float64)
    y = 1.0 / ground_m[row[chosen], column[chosen]].astype(np.float64)
    line = _best_line(x, y, with_shift)
    for _ in range(_ROUNDS):
        deviation = (line[0] * x + line[1]) / y - 1.0
        weight = np.square(np.clip(1.0 - np.square(deviation / _AGREES), 0.0, None))  # Tukey's biweight
        if weight.sum() < 1.0:
            break
        line = _weighted_line(x, y, weight / np.square(y), with_shift)
    return _checked(line, x, y, "ground")


def check_metric(inverse: Array, ground_m: Array, usable: Mask, path: str) -> None:
    """Raise where an output that is taken for metres cannot be in metres.

    Args:
        inverse: ``(H, W)`` the network's inverse depth, taken for 1/m.
        ground_m: ``(H, W)`` depth of the flat ground, metres; ``inf`` above the horizon.
        usable: ``(H, W)``, false for sky and the own vehicle.
        path: of the network, for the error.

    Raises:
        ValueError: the median below the horizon is no street's, or depth falls away from the camera.
    """
    remedy = (
        "Check output ('depth', 'inverse_depth', 'disparity'); a relative output needs scale='ground' or points "
        "(--depth-model-output, --depth-model-scale)."
    )
    below = usable & np.isfinite(ground_m)
    median = float(np.median(inverse[below] if below.any() else inverse))
    median_m = 1.0 / median if median > 0 else np.inf
    if not _NEAREST_MEDIAN_M <= median_m <= _FARTHEST_MEDIAN_M:
        raise InputValueError(
            f"DepthNetwork: the output of {path} taken for metres gives the ground a median depth of {median_m:.3g} m. "
            f"{remedy}"
        )
    road = usable & (ground_m < GROUND_FARTHEST_M)
    x, y = inverse[road], 1.0 / ground_m[road]
    if len(x) >= _LEAST_PIXELS and x.std() > 0 and y.std() > 0 and np.corrcoef(x, y)[0, 1] < _REVERSED:
        raise InputValueError(
            f"DepthNetwork: the output of {path} makes the ground nearer towards the horizon. {remedy}"
        )


def _best_line(x: Array, y: Array, with_shift: bool) -> tuple[float, float]:
    """The line through two quantiles of two bands on which most pixels agree."""
    edges = np.quantile(y, np.linspace(0.0, 1.0, _BANDS + 1))
    bands = [(y >= low) & (y <= high) for low, high in pairwise(edges)]
    points = [(float(q), float(np.median(y[band]))) for band in bands for q in np.quantile(x[band], _QUANTILES)]
    lines = [(v / u, 0.0) for u, v in points if u > 0] if not with_shift else []
    if with_shift:
        for index, (u, v) in enumerate(points):
            for s, t in points[index + 1 :]:
                if (s - u) * (t - v) > 0:
                    slope = (t - v) / (s - u)
                    lines.append((slope, v - slope * u))
    best, least = (0.0, 0.0), np.inf
    for slope, shift in lines:
        cost = float(np.minimum(np.abs((slope * x + shift) / y - 1.0) / _AGREES, 1.0).mean())
        if cost < least:
            best, least = (slope, shift), cost
    return best


def _least_absolute(x: Array, y: Array, with_shift: bool) -> tuple[float, float]:
    """Line of least absolute relative deviations, by reweighted least squares."""
    weight = 1.0 / np.square(y)
    line = _weighted_line(x, y, weight, with_shift)
    for _ in range(_ROUNDS):
        deviation = np.abs((line[0] * x + line[1]) / y - 1.0)
        line = _weighted_line(x, y, weight / np.maximum(deviation, 1e-4), with_shift)
    return line


def _weighted_line(x: Array, y: Array, weight: Array, with_shift: bool) -> tuple[float, float]:
    if not with_shift:
        return float((weight * x * y).sum() / max(float((weight * x * x).sum()), 1e-300)), 0.0
    total = weight.sum()
    mean_x, mean_y = (weight * x).sum() / total, (weight * y).sum() / total
    spread = (weight * np.square(x - mean_x)).sum()
    slope = float((weight * (x - mean_x) * (y - mean_y)).sum() / spread) if spread > 0 else 0.0
    return slope, float(mean_y - slope * mean_x)


def _checked(line: tuple[float, float], x: Array, y: Array, name: str) -> Alignment:
    if not line[0] > 0 or not np.isfinite(line).all():
        raise InputValueError(
            f"DepthNetwork: the network's output does not rise towards the camera on the {name}, as inverse depth "
            "does. Check output: 'depth', 'inverse_depth' or 'disparity' (--depth-model-output)."
        )
    agreeing = float((np.abs((line[0] * x + line[1]) / y - 1.0) < _AGREES).mean())
    return Alignment(line[0], line[1], agreeing)
