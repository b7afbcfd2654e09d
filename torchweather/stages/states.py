"""The state of a measurement on its way through a chain."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["CameraState"]


@dataclass(frozen=True)
class CameraState:
    """A raw camera frame on its way through the chain; B is the flattened batch.

    Args:
        signal: ``(B, 1, H, W)`` linear in light, black 0, saturation 1.
        depth_m: ``(B, 1, H, W)`` metres along the optical axis; infinity is sky.
        ray_per_depth: ``(1 or B, 1, H, W)`` length of a pixel's ray per metre of depth, 1 / cos(theta).
        cfa_index: ``(2, 2)`` colour of each CFA cell: 0 red, 1 green or clear, 2 blue.
        intrinsics: ``(1 or B, 4)`` fx, fy, cx, cy in pixels.
        airlight: ``(B, 3)`` linear signal of an infinitely deep fog, per colour; ``None`` until a stage sets it.
        fog_extinction_per_m: ``(B, 3)`` extinction of a continuous medium along the ray; ``None`` is clear air.
        transmission: ``(B, 1, H, W)`` share of the scene's light that the continuous medium lets through;
            ``None`` where it is 1 or was not asked for.
        particle_mask: ``(B, 1, H, W)`` share of the exposure in which particles cover the pixel; ``None`` likewise.
        keep_truth: compute ``transmission`` and ``particle_mask`` although the signal needs neither.
    """

    signal: Tensor
    depth_m: Tensor
    ray_per_depth: Tensor
    cfa_index: Tensor
    intrinsics: Tensor
    airlight: Tensor | None = None
    fog_extinction_per_m: Tensor | None = None
    transmission: Tensor | None = None
    particle_mask: Tensor | None = None
    keep_truth: bool = False

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"H": self.signal.shape[-2], "W": self.signal.shape[-1]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.signal.shape[0]

    @property
    def ray_length_m(self) -> Tensor:
        """``(B, 1, H, W)`` distance along each pixel's ray, metres."""
        return self.depth_m * self.ray_per_depth

    def per_pixel(self, per_colour: Tensor) -> Tensor:
        """Spread a value per colour over the CFA: ``(B, 3)`` to one row pair, ``(B, 1, 1, 2, W)``.

        Broadcast it against ``by_cells(image)``, which views an image as ``(B, 1, H/2, 2, W)``.
        """
        cell = per_colour[:, self.cfa_index]  # (B, 2, 2)
        row_pair = cell.repeat(1, 1, self.signal.shape[-1] // 2)  # (B, 2, W)
        return row_pair[:, None, None]


def by_cells(image: Tensor) -> Tensor:
    """View ``(B, 1, H, W)`` as ``(B, 1, H/2, 2, W)``: the rows of the CFA cells apart."""
    b, c, h, w = image.shape
    return image.reshape(b, c, h // 2, 2, w)


torch.export.register_dataclass(CameraState, serialized_type_name="torchweather.CameraState")
