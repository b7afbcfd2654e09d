"""A photograph in cells: mean colour and steepest change of a few pixels each, where regions of sky are sought."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, adaptive_max_pool2d, interpolate, pad

__all__ = ["Cells", "Floats", "Mask", "cells_of", "enlarged", "steepest_change"]

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Size of the grid. PHOTOGRAPHS.md, sky mask: a width of 480 is enough for regions; 144 rows keep panoramas readable.
GRID_WIDTH, GRID_HEIGHT = 480, 144
# A picture smaller than the grid shows the same scene in fewer, steeper pixels: thresholds grow, at most this much.
LARGEST_STEEPNESS = 3.0
# Gaps between the rings of a 64-beam LiDAR are up to 3 cells tall in a picture of 1242 pixels (kitti_13).
RING_GAP = (7, 3)


@dataclass(frozen=True)
class Cells:
    """A photograph in cells.

    Args:
        colour: ``(h, w, 3)`` mean sRGB of each cell, 0..1.
        change: ``(h, w)`` steepest sRGB change a pixel inside each cell, of the full-size picture. A change of the
            shrunken picture would lose the pale edge between an overexposed wall and the sky.
        horizon_row: row of the horizon, in cells.
        end_row: first row of cells that can hold no sky.
        vanishing_column: column of the vanishing point, in cells.
        returns: ``(h, w)`` cells with LiDAR returns, gaps between rings closed; None without a LiDAR.
    """

    colour: Floats
    change: Floats
    horizon_row: float
    end_row: int
    vanishing_column: float
    returns: Mask | None = None

    @property
    def unit(self) -> float:
        """Size of the grid over the size that the lengths in cells are made for, at most 1."""
        height, width = self.change.shape
        return float(min(1.0, width / GRID_WIDTH, height / GRID_HEIGHT))

    @property
    def steepness(self) -> float:
        """Factor on thresholds of change, 1 for all pictures but small ones."""
        return min(LARGEST_STEEPNESS, 1.0 / self.unit)

    @property
    def light(self) -> Floats:
        """``(h, w)`` mean of the three colours, 0..1."""
        light: Floats = self.colour.mean(-1)
        return light


def steepest_change(rgb: Tensor) -> Tensor:
    """Steepest change of any colour, sRGB a pixel, ``(1, H, W)``: central differences averaged over three lines.

    The three lines (Prewitt's operator) let the noise of a camera fall by 1.7, an edge not at all.

    Example:
        >>> steepest_change(torch.arange(4.0).expand(3, 3, 4) / 10)[0, 1]
        tensor([0.0500, 0.1000, 0.1000, 0.0500])
    """
    # kornia.filters.filter2d_separable: 7.8 times the time at 1920 x 1080 (524 against 68 ms)
    padded = pad(rgb[None], (1, 1, 1, 1), mode="replicate")[0]
    across = padded[..., 2:] - padded[..., :-2]
    down = padded[..., 2:, :] - padded[..., :-2, :]
    across = (across[..., :-2, :] + across[..., 1:-1, :] + across[..., 2:, :]).abs().amax(0, keepdim=True)
    down = (down[..., :-2] + down[..., 1:-1] + down[..., 2:]).abs().amax(0, keepdim=True)
    return torch.maximum(across, down) / 6


def cells_of(
    rgb: Tensor, horizon_row: float, slack_rows: float, vanishing_column: float, returns: Tensor | None = None
) -> Cells:
    """Cells of a photograph ``(3, H, W)`` in 0..1; no sky lies more than ``slack_rows`` below the horizon."""
    from scipy.ndimage import binary_closing

    height, width = rgb.shape[-2:]
    factor = max(1.0, min(width / GRID_WIDTH, height / GRID_HEIGHT))
    size = (max(1, round(height / factor)), max(1, round(width / factor)))
    down, across = size[0] / height, size[1] / width
    colour = adaptive_avg_pool2d(rgb[None], size)[0].permute(1, 2, 0).contiguous().numpy()
    change = adaptive_max_pool2d(steepest_change(rgb)[None], size)[0, 0].numpy()
    hit = None
    if returns is not None:
        hit = adaptive_max_pool2d(returns.float()[None], size)[0, 0].numpy() > 0
        edge = max(RING_GAP)
        hit = binary_closing(np.pad(hit, edge), np.ones(RING_GAP, bool))[edge:-edge, edge:-edge]
    return Cells(
        colour,
        change,
        horizon_row=(horizon_row + 0.5) * down - 0.5,
        end_row=int(np.clip(np.ceil((horizon_row + slack_rows + 0.5) * down), 0, size[0])),
        vanishing_column=(vanishing_column + 0.5) * across - 0.5,
        returns=hit,
    )


def enlarged(values: Floats | Mask, height: int, width: int) -> Tensor:
    """Cells ``(C, h, w)`` or ``(h, w)`` as pixels ``(C, H, W)``, bilinear."""
    grid = torch.from_numpy(np.ascontiguousarray(np.atleast_3d(values.T).T, dtype=np.float32))
    return interpolate(grid[None], (height, width), mode="bilinear", align_corners=False)[0]
