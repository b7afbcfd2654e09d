"""Beams that meet nothing in clear air: of those without a return, the ones that end in the sky.

A dark car, a pane, a side seen at a glancing angle give no return either, and end the beam all the same: no flake
behind them is seen. How far they are is not measured. So only beams that end in the sky, as far as their neighbours
and the ground tell, are compared with a simulation, in which they end at the maximum range.

References:
    ``beam_ends``: what a beam without a return met.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from torchweather.lidar.sweep.beam_ends import BeamEnd, beam_ends

__all__ = ["column_spacing_rad", "open_beams"]

LEAST_SPACING_RAD = 1e-3  # of columns of beams, to which a place in azimuth is told


def open_beams(range_m: Tensor, direction: Tensor, grid: tuple[int, int], max_range_m: float) -> Tensor:
    """Beams that see nothing and end in the sky.

    Args:
        range_m: ``(K, N)`` of K clear frames, metres; 0 where no return.
        direction: ``(N, 3)`` unit vectors of the beams, in the sensor's frame, z up.
        grid: rows and columns of the scan.
        max_range_m: of the sensor.

    Returns:
        ``(K, N)`` bool, frame by frame.

    Example:
        >>> elevation_rad = torch.deg2rad(torch.tensor([[-10.0], [-5.0], [10.0]]))
        >>> azimuth_rad = torch.deg2rad(torch.arange(-180.0, 180.0))[None]
        >>> level = torch.cos(elevation_rad)
        >>> x, y = level * torch.cos(azimuth_rad), level * torch.sin(azimuth_rad)
        >>> direction = torch.stack([x, y, torch.sin(elevation_rad).expand(3, 360)], -1)
        >>> range_m = torch.where(direction[..., 2] < 0, -1.7 / direction[..., 2], 0.0)
        >>> range_m[1, 180] = 0.0  # a puddle
        >>> found = open_beams(range_m.reshape(1, -1), direction.reshape(-1, 3), (3, 360), 120.0)
        >>> found.reshape(3, 360).sum(1).tolist()
        [0, 0, 360]
    """
    rows, columns = grid
    ring = np.repeat(np.arange(rows), columns)
    step_deg = math.degrees(column_spacing_rad(torch.atan2(direction[:, 1], direction[:, 0]).reshape(grid)))
    along = direction.double().numpy()
    found = torch.zeros(range_m.shape, dtype=torch.bool)
    for own, seen_m in zip(found, range_m.double().numpy(), strict=True):
        seen = seen_m > 0
        ends = beam_ends(
            along[seen] * seen_m[seen, None],
            along[~seen],
            max_range_m,
            ring=ring[seen],
            direction_ring=ring[~seen],
            step_deg=step_deg,
        )
        own[torch.from_numpy(~seen)] = torch.from_numpy(ends.end == BeamEnd.SKY)
    return found


def column_spacing_rad(azimuth_rad: Tensor) -> float:
    """Median distance of neighbouring columns of beams ``(H, W)``; a milliradian at least.

    Example:
        >>> round(column_spacing_rad(torch.tensor([[3.1, -3.1, -3.017, -2.934]])), 3)  # across half a turn
        0.083
    """
    apart = torch.remainder(azimuth_rad.diff(dim=-1) + math.pi, 2.0 * math.pi) - math.pi
    return max(float(apart.abs().median()), LEAST_SPACING_RAD) if apart.numel() else 2.0 * math.pi
