"""Horizon of a street picture: the vanishing point of its straight edges, drawn towards the camera's own pitch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.camera.depth.line_segments import LineSegments, find_segments, grey_levels
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between

__all__ = ["Horizon", "below_the_sky", "find_horizon", "horizon_of_camera"]

Array = npt.NDArray[np.floating[Any]]

# Chosen on seven KITTI frames (0, 2, 5, 8, 15, 20, 1545) against planes through the LiDAR's road points.
_PITCH_SD_RAD = math.radians(1.0)  # of a mounted camera about its calibrated pitch: slopes, load, brakes
_HEADING_SD_RAD = math.radians(7.0)  # of the street about the camera's axis; Student's t with 3 degrees of freedom
_TRUE_SHARE = 0.10  # of all edges that run along the street
_DIRECTION_SD_RAD = math.radians(0.7)  # of an edge that does, however long; kerbs bend
_END_SD_PX = 1.0  # of an edge's ends across it
# Other edges: half are level across the street (bumpers, roofs), a third upright, both within 9 degrees.
_LEVEL_SHARE, _UPRIGHT_SHARE, _LEVEL_SD_RAD = 0.5, 0.3, math.radians(9.0)
_EDGE_WEIGHT = 0.25  # of independent evidence in an edge of 50 px: both sides of a mark are edges of one thing
_WEIGHT_ABOVE = 0.5  # of an edge above the candidate: roofs follow the street less than kerbs do
_LONGEST_PX = 200.0  # longer edges weigh no more
# Confidence: probability that the answer is off by less than half a degree, above that of the prior alone (0.383),
# as a share of what can be gained.
_CONFIDENT_RAD = math.radians(0.5)
_PRIOR_PROBABILITY = math.erf(_CONFIDENT_RAD / _PITCH_SD_RAD / math.sqrt(2.0))
_LEAST_CONFIDENCE = 0.05  # below it the camera's own pitch stands

# Columns of sky that a row needs to lie above the horizon, as a share of the width: less may be a puddle's reflection.
_LEAST_SKY = 0.02

_MOST_HEADING, _MOST_PITCH = 0.6, 0.10  # searched, tangents: 31 and 6 degrees
_WIDEST_PX = 1600  # wider pictures are averaged down: more pixels make no straighter edge


@dataclass(frozen=True)
class Horizon:
    """Horizon and vanishing point of a picture.

    Args:
        row: of the horizon at the principal point's column, pixels.
        column: of the street's vanishing point, pixels, lens distortion included; may lie beside the picture.
        confidence: 0..1: how much surer the picture makes the row. 0: it is the camera's own.
        pitch_rad: of the camera against the street's surface, positive looks up.
        heading_rad: of the street against the camera's axis, positive to the right.
    """

    row: float
    column: float
    confidence: float
    pitch_rad: float
    heading_rad: float


def horizon_of_camera(camera: Camera, *, pitch_rad: float | None = None, heading_rad: float = 0.0) -> Horizon:
    """Horizon by the camera's mounting alone, or by a pitch and heading that were found.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=30, width=101, height=61)
        >>> horizon_of_camera(camera).row
        30.0
    """
    pitch = camera.pitch_rad if pitch_rad is None else pitch_rad
    fx, fy, cx, cy = camera.intrinsics
    right, down = math.tan(heading_rad) / math.cos(pitch), math.tan(pitch)
    cos, sin = math.cos(camera.roll_rad), math.sin(camera.roll_rad)
    points = torch.tensor(
        [[0.0, down / cos], [cos * right + sin * down, -sin * right + cos * down]], dtype=torch.float64
    )  # on the horizon: at the principal column; in the street's direction
    x, y = camera.distort(points[:, 0], points[:, 1])
    return Horizon(float(fy * y[0] + cy), float(fx * x[1] + cx), 0.0, pitch, heading_rad)


def below_the_sky(horizon: Horizon, sky: Tensor, camera: Camera) -> tuple[Horizon, bool]:
    """Lower a horizon that is not sure to the lowest row with sky, for no sky lies below the horizon.

    Args:
        horizon: to start from.
        sky: ``(H, W)`` share of sky.
        camera: of the picture.

    Returns:
        The horizon, with the heading of the one given and confidence 0, and whether it was lowered.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=30, width=101, height=61)
        >>> sky = (torch.arange(61)[:, None] <= 40).float().expand(61, 101)
        >>> horizon, lowered = below_the_sky(horizon_of_camera(camera), sky, camera)
        >>> round(horizon.row, 3), lowered
        (40.0, True)
    """
    rows = ((sky > 0.5).float().mean(-1) >= _LEAST_SKY).nonzero()
    lowest = float(rows.max()) if len(rows) else -math.inf
    if lowest <= horizon.row:
        return horizon, False
    _, fy, _, cy = camera.intrinsics
    # The lens' distortion along the principal column is left out: a few pixels of a row that is not sure itself.
    return horizon_of_camera(
        camera, pitch_rad=math.atan((lowest - cy) / fy * math.cos(camera.roll_rad)), heading_rad=horizon.heading_rad
    ), True


def find_horizon(rgb: Tensor, camera: Camera) -> Horizon:
    r"""Horizon and vanishing point of a street picture.

    The vanishing point is the maximum of ``log prior + sum_i w_i log p(angle_i)``: the prior is the camera's pitch;
    ``p`` is a mixture of edges that run along the street, at a Gaussian angle to the direction of the point, and of
    others, most of them level or upright. A search on a grid, so the answer is the same every time.

    Args:
        rgb: ``(3, H, W)``, sRGB, uint8 or float 0..1.
        camera: intrinsics, lens distortion, roll, and the pitch to start from.

    Returns:
        Where edges say little (``confidence`` below 0.05) row and column are those of the camera.

    Note:
        Off by 2.6 px (mean of the seven KITTI frames it was chosen on) and 3.2 px (six others), 10 px at most; the
        principal point alone 7.2 px. A road that climbs or bends within view has no single horizon.
    """
    check_arguments("find_horizon(rgb: real, camera: Camera)", rgb, camera)
    check_between("rgb", rgb, 0.0, 65535.0, owner="find_horizon")
    if rgb.ndim != 3 or not len(rgb):
        raise InputValueError(f"find_horizon: expected one picture (3, H, W); got {tuple(rgb.shape)}.")
    height, width = rgb.shape[-2:]
    smaller = -(-width // _WIDEST_PX)
    grey = grey_levels((rgb.float() if rgb.dtype == torch.bfloat16 else rgb).detach().cpu())
    if smaller > 1:
        grey = grey[: height // smaller * smaller, : width // smaller * smaller]
        grey = grey.reshape(height // smaller, smaller, width // smaller, smaller).mean((1, 3))
    segments = find_segments(grey)
    middle, along = _level_segments(segments, smaller, camera)
    right, down, probability = _vanishing_point(middle, along, segments.length_px, math.tan(camera.pitch_rad))
    confidence = (probability - _PRIOR_PROBABILITY) / (1.0 - _PRIOR_PROBABILITY)
    if confidence < _LEAST_CONFIDENCE:
        return horizon_of_camera(camera)
    pitch = math.atan(down)
    found = horizon_of_camera(camera, pitch_rad=pitch, heading_rad=math.atan(right * math.cos(pitch)))
    return Horizon(found.row, found.column, confidence, found.pitch_rad, found.heading_rad)


def _level_segments(segments: LineSegments, smaller: int, camera: Camera) -> tuple[Array, Array]:
    """Middle and unit direction of each edge, ``(N, 2)``: tangents of a camera without lens distortion and roll."""
    half = 0.5 * segments.length_px[:, None] * segments.direction_xy
    ends = np.stack([segments.centre_xy - half, segments.centre_xy + half])
    ends_xy = torch.from_numpy((ends + 0.5) * smaller - 0.5)
    fx, fy, cx, cy = camera.intrinsics
    x, y = camera.undistort((ends_xy[..., 0] - cx) / fx, (ends_xy[..., 1] - cy) / fy)
    cos, sin = math.cos(camera.roll_rad), math.sin(camera.roll_rad)
    first, last = torch.stack([cos * x - sin * y, sin * x + cos * y], -1).numpy()
    along = last - first
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return 0.5 * (first + last), along


def _vanishing_point(middle: Array, along: Array, length_px: Array, own_down: float) -> tuple[float, float, float]:
    """Most likely vanishing point (tangents right and down) and how probably the latter is that near."""

    def log_posterior(right: Array, down: Array) -> Array:
        pitch_prior = -0.5 * np.square((down - own_down) / _PITCH_SD_RAD)
        heading_prior = -2.0 * np.log1p(np.square(right / _HEADING_SD_RAD) / 3.0)
        prior: Array = pitch_prior[:, None] + heading_prior
        return prior + _evidence(right, down, middle, along, length_px)

    right = np.linspace(-_MOST_HEADING, _MOST_HEADING, 81)  # steps of 0.015: edges slope, so the row decides
    down = own_down + np.linspace(-_MOST_PITCH, _MOST_PITCH, 61)
    coarse = log_posterior(right, down)
    best_down, best_right = np.unravel_index(int(coarse.argmax()), coarse.shape)
    share = np.exp(coarse - coarse.max()).sum(1)
    share /= share.sum()
    coarse_down = down
    right = right[best_right] + np.linspace(-0.02, 0.02, 21)
    down = down[best_down] + np.linspace(-0.015, 0.015, 31)
    fine = log_posterior(right, down)
    weight = np.exp(fine - fine.max())
    weight /= weight.sum()
    best = float(weight.sum(1) @ down)
    probability = float(share[np.abs(coarse_down - best) < _CONFIDENT_RAD].sum())
    return float(weight.sum(0) @ right), best, probability


def _evidence(right: Array, down: Array, middle: Array, along: Array, length_px: Array) -> Array:
    """Sum of the edges' log likelihood ratios for each candidate, ``(D, R)``."""
    point = np.stack(np.broadcast_arrays(right[None, :], down[:, None]), -1).reshape(-1, 1, 2).astype(np.float32)
    middle, along = middle.astype(np.float32), along.astype(np.float32)
    towards_x, towards_y = point[..., 0] - middle[:, 0], point[..., 1] - middle[:, 1]
    distance = np.square(towards_x) + np.square(towards_y) + np.float32(1e-12)
    off = np.square(along[:, 0] * towards_y - along[:, 1] * towards_x) / distance  # sine of the angle, squared
    sd = np.hypot(_DIRECTION_SD_RAD, _END_SD_PX / length_px)
    slope = np.abs(np.arctan2(along[:, 1], along[:, 0]))
    slope = np.minimum(slope, math.pi - slope)
    other = (
        _LEVEL_SHARE * _normal(slope, _LEVEL_SD_RAD)
        + _UPRIGHT_SHARE * _normal(0.5 * math.pi - slope, _LEVEL_SD_RAD)
        + (1.0 - _LEVEL_SHARE - _UPRIGHT_SHARE) / math.pi
    )
    ratio = (_TRUE_SHARE * _normal(0.0, sd) / other).astype(np.float32)
    precision = (-0.5 / np.square(sd)).astype(np.float32)
    gain = np.log((1.0 - _TRUE_SHARE) + ratio * np.exp(precision * off))
    weight = (_EDGE_WEIGHT * np.sqrt(np.minimum(length_px, _LONGEST_PX) / 50.0)).astype(np.float32)
    gain *= np.where(towards_y > 0, np.float32(_WEIGHT_ABOVE), np.float32(1.0)) * weight
    total: Array = gain.sum(-1).reshape(len(down), len(right)).astype(np.float64)
    return total


def _normal(value: Any, sd: Any) -> Any:
    """Density of a centred Gaussian."""
    return np.exp(-0.5 * np.square(value / sd)) / (sd * math.sqrt(2.0 * math.pi))
