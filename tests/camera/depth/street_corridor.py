"""A ray-cast street of known depth and vanishing point: flat ground, two walls, sky above them."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.sensors import Camera


def corridor(
    camera: Camera,
    *,
    half_width_m: tuple[float, float] = (6.0, 6.0),
    heading_rad: float = 0.0,
    wall_height_m: float = 6.0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Picture ``(3, H, W)`` 0..1, depth along the axis ``(1, H, W)`` (``inf`` is sky) and sky ``(1, H, W)``.

    Lane marks and kerbs run along the ground, boards and doors along the walls. Colours are averaged over 3 x 3 rays a
    pixel, so that edges are as soft as a camera's.
    """
    height, width = camera.height, camera.width
    fx, fy, cx, cy = camera.intrinsics
    finer = Camera.from_dict(
        {**camera.to_dict(), "width": 3 * width, "height": 3 * height, "fx": 3 * fx, "fy": 3 * fy,
         "cx": 3 * cx + 1, "cy": 3 * cy + 1}
    )  # fmt: skip
    colour, depth, sky = _cast(finer, half_width_m, heading_rad, wall_height_m)
    colour = torch.nn.functional.avg_pool2d(colour[None].expand(1, 3, -1, -1), 3)[0]
    return colour, depth[1::3, 1::3][None], torch.nn.functional.avg_pool2d(sky[None, None].float(), 3)[0]


def _cast(
    camera: Camera, half_width_m: tuple[float, float], heading_rad: float, wall_height_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    ray = camera.ray_directions(dtype=torch.float64)
    rotation = torch.tensor(camera.camera_from_vehicle(), dtype=torch.float64)
    forward, left, up = torch.einsum("cv,chw->vhw", rotation, ray)
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    along, right = cos * forward - sin * left, -sin * forward - cos * left  # of the street
    ground = torch.where(up < 0, -camera.height_m / up.clamp(max=-1e-9), torch.inf)
    side = torch.where(right > 0, half_width_m[1], half_width_m[0])
    wall = side / right.abs().clamp_min(1e-9)
    depth = torch.minimum(ground, wall)
    on_ground = ground <= wall
    x, z, y = right * depth, along * depth, up * depth + camera.height_m
    sky = ~on_ground & (y > wall_height_m)
    marks = ((x.abs() - 1.75).abs() < 0.08) & (z.remainder(6.0) < 3.0)
    kerb = (x.abs() > 3.8).double() * 0.15
    road = 0.35 + 0.5 * marks + kerb
    boards = 0.45 + 0.2 * (y.remainder(1.5) < 0.7) - 0.25 * ((z.remainder(5.0) < 1.2) & (y < 2.2))
    colour = torch.where(on_ground, road, boards)
    colour = torch.where(sky, 0.9, colour)[None]
    return colour.float(), torch.where(sky, torch.inf, depth).float(), sky


def leaves(height: int, width: int, *, seed: int = 0) -> Tensor:
    """Texture without a direction, ``(3, H, W)``."""
    noise = torch.rand(1, 1, height, width, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.avg_pool2d(noise, 5, 1, 2)[0].expand(3, -1, -1)
