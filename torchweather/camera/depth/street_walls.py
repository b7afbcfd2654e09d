"""Depth of a plain street: flat ground, two side walls, and a far end, joined without an edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.camera.sensor import Camera

__all__ = ["StreetView", "ground_probability", "sky_shares", "street_depth", "view_of_street"]

# Chosen on seven KITTI frames (0, 2, 5, 8, 15, 20, 1545) against LiDAR.
_HALF_WIDTH_M, _HALF_WIDTH_PER_SKY_M = 5.0, 8.0  # half width w = 5 + 8 s, s the side's share of sky
_TALL_M = 6.5  # height above the camera of what makes the skyline: trees and houses of 8 m
_MOST_SKYLINE, _SKYLINE_PER_SKY = 0.7, 1.2  # weight of the skyline's depth: min(0.7, 1.2 s)
_FARTHEST_M, _FARTHEST_PER_SKY_M = 30.0, 120.0  # far end: 30 + 120 s
# Sky is counted up to this elevation (tangent), 22 degrees: the upper edge of common front cameras (nuScenes).
_COUNTED_ELEVATION = 0.40
_SKYLINE_BLUR = 0.015  # of the width: a pole or a gap between leaves is no wall of its own
_NEAREST_SKYLINE_M, _FARTHEST_SKYLINE_M = 3.0, 200.0  # a gap that reaches the horizon is no endless street
_SIDES_MEET = 0.08  # tangent over which the left side turns into the right one
_DEPTH_LOG_STD = 0.4  # of the guess against LiDAR: 91 % within a factor of 2
_ROUNDED = 0.04  # tangent: a wall 5 m aside ends at 125 m


@dataclass(frozen=True, eq=False)
class StreetView:
    """Directions of a camera's pixels in a street's frame.

    Args:
        fall: ``(H, W)``, metres fallen per metre along the optical axis; negative above the horizon.
        lateral: ``(H, W)``, metres to the right of the street's axis per metre along the optical axis.
    """

    fall: Tensor
    lateral: Tensor


def view_of_street(
    camera: Camera, height: int, width: int, pitch_rad: float, heading_rad: float, device: torch.device | str | None
) -> StreetView:
    """Directions of all pixels, lens distortion and roll removed.

    Args:
        camera: intrinsics, lens distortion and roll.
        height: rows.
        width: columns.
        pitch_rad: of the camera against the ground, positive looks up.
        heading_rad: of the street against the camera, positive to the right.
        device: of the result.
    """
    x, y, _ = camera.ray_directions(height, width, device=device)
    cos_roll, sin_roll = math.cos(camera.roll_rad), math.sin(camera.roll_rad)
    right, down = cos_roll * x - sin_roll * y, sin_roll * x + cos_roll * y
    cos, sin = math.cos(pitch_rad), math.sin(pitch_rad)
    ahead = cos + sin * down
    return StreetView(cos * down - sin, math.cos(heading_rad) * right - math.sin(heading_rad) * ahead)


def sky_shares(view: StreetView, sky: Tensor) -> tuple[float, float, float]:
    """Share of sky above the horizon: left of the street's axis, right of it, and in all.

    Args:
        view: directions.
        sky: ``(H, W)``, share of each pixel that shows the sky.
    """
    counted = (view.fall < 0) & (view.fall > -_COUNTED_ELEVATION)
    right = view.lateral > 0
    pixels = torch.stack([(counted & ~right).sum(), (counted & right).sum()]).double()
    sky = torch.where(counted, sky, 0.0)
    found = torch.stack([torch.where(right, 0.0, sky).sum(), torch.where(right, sky, 0.0).sum()]).double()
    total = float(found.sum() / pixels.sum().clamp_min(1.0))
    sides = [float(s / n) if n > 0 else total for s, n in zip(found, pixels, strict=True)]
    return sides[0], sides[1], total


def guessed_half_width_m(sky_share: float) -> float:
    """Half width of a street by the share of sky on that side of it, metres."""
    return _HALF_WIDTH_M + _HALF_WIDTH_PER_SKY_M * sky_share


def guessed_farthest_m(sky_share: float) -> float:
    """Distance of a street's far end by the share of sky, metres."""
    return _FARTHEST_M + _FARTHEST_PER_SKY_M * sky_share


def street_depth(
    view: StreetView,
    camera_height_m: float,
    half_width_m: tuple[float, float],
    farthest_m: float,
    sky: Tensor | None = None,
    shares: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Tensor:
    r"""Depth of a plain street.

    ``1/z^4 = 1/z_ground^4 + 1/z_side^4 + 1/z_far^4``: the nearest of the three, rounded where two meet, so that fog
    shows no ruled line. ``z_ground = h / fall``. ``z_side`` is the weighted geometric mean of the wall's depth
    ``w / |lateral|`` and the depth at which things of 6.5 m above the camera end where the sky begins.

    Args:
        view: directions.
        camera_height_m: above the ground.
        half_width_m: left and right, metres.
        farthest_m: depth of the far end.
        sky: ``(H, W)``, share of sky of each pixel; ``None``: no skyline is known.
        shares: of `sky_shares`.

    Returns:
        ``(H, W)``, metres along the optical axis, finite.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=30, width=101, height=61)
        >>> view = view_of_street(camera, 61, 101, 0.0, 0.0, None)
        >>> depth = street_depth(view, 1.5, (5.0, 5.0), 60.0)
        >>> depth[[0, 30, 60], [50, 50, 50]].round(decimals=1)      # far end, far end, ground 1.5 m / 0.3
        tensor([59.2000, 59.2000,  5.0000])
    """
    right = 0.5 + 0.5 * torch.tanh(view.lateral / _SIDES_MEET)
    log_width = math.log(half_width_m[0]) * (1.0 - right) + math.log(half_width_m[1]) * right
    # Rounded at the street's axis: a wall that runs to infinity there draws a pale upright stripe in fog.
    nearness = 0.5 * (view.lateral.square() + _ROUNDED**2).log() - log_width  # of the wall, log of 1/m
    if sky is not None:
        share = shares[0] * (1.0 - right) + shares[1] * right
        weight = (_SKYLINE_PER_SKY * share).clamp(max=_MOST_SKYLINE)
        nearness = torch.lerp(nearness, _skyline_nearness(view, sky), weight)
    ground = view.fall.clamp_min(0.0) / camera_height_m
    fourth = ground.square().square() + (4.0 * nearness).exp() + farthest_m**-4
    return fourth.rsqrt().sqrt()


def ground_probability(depth_m: Tensor, view: StreetView, camera_height_m: float) -> Tensor:
    """Probability that a pixel of a guessed street shows the ground, ``(H, W)``.

    Walls and the far end stand at a guessed distance, so where the ground ends is known to that factor alone:
    ``Phi(ln(z_other / z_ground) / 0.4)``, z_other from the fourth powers of `street_depth`. 9 in 10 depths of the
    guess are within a factor of 2 of LiDAR, which is a deviation of 0.4 of the logarithm.

    Args:
        depth_m: of `street_depth`, ``(H, W)``.
        view: directions.
        camera_height_m: above the ground.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=30, width=101, height=61)
        >>> view = view_of_street(camera, 61, 101, 0.0, 0.0, None)
        >>> ground = ground_probability(street_depth(view, 1.5, (5.0, 5.0), 60.0), view, 1.5)
        >>> ground[[20, 32, 60], [50, 50, 50]].round(decimals=2)  # above the horizon, by the far end, 5 m ahead
        tensor([0.0000, 0.2800, 1.0000])
    """
    ground = view.fall.clamp_min(0.0) / camera_height_m  # 1/m
    fourth = ground.square().square()
    other = (depth_m.pow(-4) - fourth).clamp_min(1e-12 * depth_m.pow(-4))
    step = torch.log(ground.clamp_min(1e-9)) - 0.25 * torch.log(other)
    return torch.where(ground > 0, torch.special.ndtr(step / _DEPTH_LOG_STD), 0.0)


def _skyline_nearness(view: StreetView, sky: Tensor) -> Tensor:
    """Logarithm of the inverse depth of each column's skyline, ``(W,)``."""
    from kornia.filters import gaussian_blur2d

    above = view.fall.clamp(max=0.0)
    rise = torch.diff(above, dim=0, append=above[-1:]).clamp_min(0.0)
    elevation = ((1.0 - sky) * rise).sum(0)  # tangent, of what is not sky
    nearness = (elevation / _TALL_M).clamp(1.0 / _FARTHEST_SKYLINE_M, 1.0 / _NEAREST_SKYLINE_M).log()
    sigma = max(1.0, _SKYLINE_BLUR * len(nearness))
    reach = min(round(3 * sigma), len(nearness) - 1)
    smooth: Tensor = gaussian_blur2d(nearness[None, None, None], (1, 2 * reach + 1), (sigma, sigma))
    return smooth[0, 0, 0]
