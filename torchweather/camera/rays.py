"""Geometry of a camera's rays: length per depth, elevation, and the way inside a layer of fog."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.camera.sensor import Camera

__all__ = ["EARTH_RADIUS_M", "Rays", "rays_of"]

EARTH_RADIUS_M = 6.371e6  # mean radius, IUGG
LEVEL_SINE = 1e-9  # below it a ray is level, and the earth's curvature ends its way in the layer


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
        x, y: ``(H, W)`` or broadcast to it, undistorted normalised coordinates.
        layer_top_m: height of the layer's top, metres.

    Example:
        >>> camera = Camera.from_intrinsics(100, 100, 0, 0, 2, 2, height_m=2.0)
        >>> rays_of(camera, torch.zeros(1, 2), torch.tensor([[0.0, -1.0]]), layer_top_m=200.0).in_layer_m.round()
        tensor([[[[50482.,   280.]]]])
    """
    right, down, forward = camera.down_direction()
    per_depth = torch.sqrt(1 + x.square() + y.square())
    sine = -(right * x + down * y + forward) / per_depth
    in_layer = None
    if math.isfinite(layer_top_m):
        level_m = math.sqrt(2 * EARTH_RADIUS_M * layer_top_m)
        rising_m = (layer_top_m - camera.height_m) / sine.clamp_min(LEVEL_SINE)
        in_layer = rising_m.clamp_max(level_m)[None, None]
    return Rays(per_depth[None, None], sine[None, None], in_layer)
