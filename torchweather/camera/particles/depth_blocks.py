"""Nearest and farthest scene depth in the neighbourhood of a pixel, to settle most depth tests at once."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["BLOCK_PX", "DepthBlocks"]

BLOCK_PX = 16


@dataclass(frozen=True)
class DepthBlocks:
    """Extremes of the depth over 3 x 3 blocks of ``BLOCK_PX`` pixels.

    A mark that reaches no farther than ``BLOCK_PX`` from its centre lies wholly within the blocks around it: it is
    hidden where it is behind their farthest point, and needs no test per pixel where it is before their nearest.
    """

    nearest_m: Tensor
    farthest_m: Tensor
    rows: int
    columns: int

    @classmethod
    def of(cls, depth_m: Tensor) -> DepthBlocks:
        """Blocks of a depth map ``(B, 1, H, W)``."""
        nearest = -_block_maximum(-depth_m)
        farthest = _block_maximum(depth_m)
        rows, columns = nearest.shape[-2:]
        return cls(nearest.reshape(-1), farthest.reshape(-1), rows, columns)

    def of_sample(self, row: int) -> DepthBlocks:
        """The blocks of one sample, of one depth map for each sample or one for all."""
        blocks = self.rows * self.columns
        first = row * blocks if self.nearest_m.numel() > blocks else 0
        some = slice(first, first + blocks)
        return DepthBlocks(self.nearest_m[some], self.farthest_m[some], self.rows, self.columns)

    def at(self, sample: Tensor | None, u_px: Tensor, v_px: Tensor) -> tuple[Tensor, Tensor]:
        """Nearest and farthest depth around image positions ``(P,)``."""
        row = (v_px * (1 / BLOCK_PX)).clamp(0, self.rows - 1).int()
        column = (u_px * (1 / BLOCK_PX)).clamp(0, self.columns - 1).int()
        block = (row * self.columns + column).long()  # float to long takes four times as long as to int
        if sample is not None:
            block = block + sample * (self.rows * self.columns)
        return self.nearest_m.index_select(0, block), self.farthest_m.index_select(0, block)


def _block_maximum(values: Tensor) -> Tensor:
    pooled = torch.nn.functional.max_pool2d(values, BLOCK_PX, ceil_mode=True)
    return torch.nn.functional.max_pool2d(pooled, 3, stride=1, padding=1)
