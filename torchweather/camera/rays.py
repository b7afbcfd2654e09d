"""Geometry of a camera's rays: length per depth, elevation, and the way inside a layer of fog."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchweather.camera.sensor import Camera

__all__ = ["EARTH_RADIUS_M", "Rays", "kept_rays", "rays_of", "rays_of_frame"]

EARTH_RADIUS_M = 6.371e6  # mean radius, IUGG
LEVEL_SINE = 1e-9  # below it a ray is level, and the earth's curvature ends its way in the layer
KEPT_BYTES = 1 << 27  # of the maps that all transforms share

_lock = threading.Lock()
_kept: dict[tuple[Any, ...], Rays] = {}


@dataclass(frozen=True)
class Rays:
    """Geometry of every pixel's ray.

    Args:
        per_depth: ``(1, 1, H, W)`` length of a ray per metre of depth, 1 / cos(theta).
        sine_elevation: ``(1, 1, H, W)`` sine of its elevation above the horizon.
        in_layer_m: ``(1, 1, H, W)`` its length up to the layer's top, metres; ``None`` where the layer has no top.
    """

    per_depth: Tensor
    sine_elevation: Tensor
    in_layer_m: Tensor | None


def rays_of(camera: Camera, x: Tensor, y: Tensor, layer_top_m: float = math.inf) -> Rays:
    """Geometry of the rays (x, y, 1) in the camera's frame, for a layer of a height above the ground.

    A ray that rises with elevation e leaves the layer after ``(h_top - h_camera) / sin e``, and a level one after
    ``sqrt(2 R_earth h_top)``, where the earth curves away under it (``PHYSICS.md`` 10.11).

    Args:
        camera: mounting: height, pitch, roll.
        x, y: ``(H, W)`` or ``(1, 1, H, W)``, or broadcast to it, undistorted normalised coordinates.
        layer_top_m: height of the layer's top, metres.

    Example:
        >>> camera = Camera.from_intrinsics(100, 100, 0, 0, 2, 2, height_m=2.0)
        >>> rays_of(camera, torch.zeros(1, 2), torch.tensor([[0.0, -1.0]]), layer_top_m=200.0).in_layer_m.round()
        tensor([[[[50482.,   280.]]]])
    """
    right, down, forward = camera.down_direction()
    per_depth = torch.sqrt(1 + x.square() + y.square())
    # Of a camera without roll that of the rows alone.
    falling = right * x + down * y if right else down * y
    sine = -(falling + forward) / per_depth
    in_layer = None
    if math.isfinite(layer_top_m):
        level_m = math.sqrt(2 * EARTH_RADIUS_M * layer_top_m)
        rising_m = (layer_top_m - camera.height_m) / sine.clamp_min(LEVEL_SINE)
        in_layer = _map(rising_m.clamp_max(level_m))
    return Rays(_map(per_depth), _map(sine), in_layer)


def _map(values: Tensor) -> Tensor:
    """Values of all pixels ``(1, 1, H, W)``."""
    return values if values.ndim == 4 else values[None, None]


def rays_of_frame(
    camera: Camera, height: int, width: int, like: Tensor, layer_top_m: float, horizon_row: float | None = None
) -> Rays:
    """Geometry of the rays of a frame's pixels, in the dtype and on the device of ``like``.

    Args:
        camera: of the frame.
        height, width: pixels.
        like: any tensor.
        layer_top_m: height of the layer's top, metres.
        horizon_row: row of the horizon, which sets the pitch; ``None`` is the camera's own.
    """
    if horizon_row is not None:
        camera = replace(camera, pitch_rad=math.atan2(horizon_row - camera.principal_point_px[1], camera.fy))
    x, y, _ = camera.ray_directions(height, width, device=like.device, dtype=like.dtype)
    return rays_of(camera, x, y, layer_top_m)


def kept_rays(
    camera: Camera, height: int, width: int, like: Tensor, layer_top_m: float, horizon_row: float | None = None
) -> Rays:
    """As `rays_of_frame`; transforms whose cameras have the same geometry share the maps of the last frames.

    A transform of a rate or visibility of its own for each sample would compute them anew each time: 9 of the 31 ms of
    a 1242 x 375 image in fog. The maps must not be changed in place.
    """
    lens = (camera.intrinsics, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3)
    mounting = (camera.roll_rad, camera.pitch_rad, camera.height_m)
    key = (lens, mounting, height, width, like.device, like.dtype, layer_top_m, horizon_row)
    with _lock:
        found = _kept.pop(key, None)
        if found is not None:
            _kept[key] = found  # the newest
            return found
    with torch.inference_mode(False), torch.no_grad():  # gradients may flow past them later
        found = rays_of_frame(camera, height, width, like, layer_top_m, horizon_row)
    with _lock:
        _kept[key] = found
        total = sum(_bytes(rays) for rays in _kept.values())
        while total > KEPT_BYTES and len(_kept) > 1:
            total -= _bytes(_kept.pop(next(iter(_kept))))
    return found


def _bytes(rays: Rays) -> int:
    maps = (rays.per_depth, rays.sine_elevation, rays.in_layer_m)
    return sum(one.numel() * one.element_size() for one in maps if one is not None)
