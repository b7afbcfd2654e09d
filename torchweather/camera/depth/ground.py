"""Depth of a flat road below the camera."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.depth.scene_depth import GUESSED
from torchweather.camera.depth.source import DepthSource
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_positive

__all__ = ["FlatGround"]


@dataclasses.dataclass(frozen=True)
class FlatGround(DepthSource):
    """Depth of an endless flat road below the camera, with sky above the horizon.

    ``Z = h / (u . g)`` with ``u`` the pixel's ray scaled to ``u_z = 1`` (lens distortion removed), ``g`` the unit
    vector of gravity in the camera's frame and ``h`` the height; ``inf`` where the ray does not fall.

    Args:
        camera_height_m: height of the camera above the road. Default: the camera's ``height_m``.
        pitch_rad: mounting, positive looks up. Default: the camera's ``pitch_rad``. Roll is always the camera's.

    Example:
        >>> camera = Camera.from_intrinsics(fx=100, fy=100, cx=0, cy=0, width=2, height=52)
        >>> depth = FlatGround(camera_height_m=1.5)(camera, 52, 2)
        >>> depth[0, [0, 10, 50], 0]          # horizon; 1.5 m below the axis at 100/10 and 100/50 times that
        tensor([inf, 15.,  3.])
    """

    confidence: ClassVar[str] = GUESSED

    camera_height_m: float | None = None
    pitch_rad: float | None = None

    def __post_init__(self) -> None:
        check_arguments(
            "FlatGround(camera_height_m: float | None, pitch_rad: float | None)",
            self.camera_height_m,
            self.pitch_rad,
        )
        if self.camera_height_m is not None:
            check_positive("camera_height_m", self.camera_height_m, unit="m", owner=self)

    def __call__(
        self,
        camera: Camera,
        height: int,
        width: int,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
        image: Tensor | None = None,
    ) -> Tensor:
        """Depth ``(1, H, W)``, metres."""
        if self.pitch_rad is not None:
            camera = dataclasses.replace(camera, pitch_rad=self.pitch_rad)
        metres = camera.height_m if self.camera_height_m is None else self.camera_height_m
        ray = camera.ray_directions(height, width, device=device, dtype=dtype)
        right, down, forward = camera.down_direction()
        fall = right * ray[0] + down * ray[1] + forward  # metres fallen per metre of depth
        return torch.where(fall > 0, metres / torch.where(fall > 0, fall, 1.0), torch.inf)[None]
