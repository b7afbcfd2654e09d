"""Heights at which a LiDAR's beams start: the lasers of a Velodyne HDL-64E sit in two blocks, 8 cm apart."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchweather.lidar.cloud_frame import are_plain, holds_return
from torchweather.lidar.laser_blocks import height_blocks
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.tiling import is_exporting

if TYPE_CHECKING:
    from torchweather.lidar.sweep.compiled_heights import Block

__all__ = ["beam_heights_m"]

# Of compiled loops, against rounding: 4e-6 of a tangent are some 30 steps of single precision, of which both ways to an
# elevation take a few each.
NEAR, MARGIN_DEG, STEEPEST_DEG = 4e-6, 0.01, 60.0


def beam_heights_m(
    points: Tensor, sensor: Lidar, ring: Tensor | None = None, *, there: Tensor | None = None
) -> Tensor | None:
    """Height at which the beam of every point starts.

    Args:
        points: ``(..., N, 3 or more)`` x, y, z in metres in the sensor's frame.
        sensor: with ``origin_heights_m``, and ``elevations_deg`` where they differ.
        ring: ``(..., N)`` ring of every point, below 0 for none; ``None`` takes the sensor's ``ring_column``, or the
            ring that is nearest in elevation.
        there: ``(..., N)`` bool, points that do not lie at the origin, where that is known already.

    Returns:
        ``(..., N)`` metres over the sensor's origin, 0 for points at the origin; ``None`` where every beam starts at
        0.

    Note:
        Without rings, the height is that of the block whose nearest ring is nearer in elevation. It is exportable.

    Example:
        >>> lidar = Lidar(905.0, elevations_deg=(-10.0, 2.0), origin_heights_m=(0.1, 0.2))
        >>> beam_heights_m(torch.tensor([[10.0, 0.0, -1.66], [10.0, 0.0, 0.55], [0.0, 0.0, 0.0]]), lidar)
        tensor([0.1000, 0.2000, 0.0000])
    """
    heights = sensor.origin_heights_m
    if heights is None or not any(heights):
        return None
    values = sorted(set(heights))
    no_ring = ring is None and sensor.ring_column is None
    if no_ring and len(values) > 1 and are_plain(points) and (blocks := _blocks(sensor)) is not None:
        return _by_loops(points, sensor, *blocks)
    there = holds_return(points) if there is None else there
    if len(values) == 1:
        return torch.where(there, values[0], 0.0).to(points)
    if ring is None and sensor.ring_column is not None:
        ring = points[..., sensor.ring_column].long()
    if ring is not None:
        of_ring = points.new_tensor(heights)
        known = there & (ring >= 0) & (ring < len(heights))
        return torch.where(known, of_ring[ring.clamp(0, len(heights) - 1)], 0.0)
    return _by_elevation(points, sensor, there)


def _by_elevation(points: Tensor, sensor: Lidar, there: Tensor) -> Tensor:
    """Height of the block whose nearest ring is nearer in elevation."""
    heights = sensor.origin_heights_m or ()
    x, y, z = points[..., :3].unbind(-1)
    flat = (x * x + y * y).sqrt()
    found = best = None
    elevations = sensor.elevations_deg or ()
    for members in height_blocks(heights):
        middle = sum(heights[ring] for ring in members) / len(members)
        order = sorted(members, key=lambda ring: elevations[ring])
        rising = points.new_tensor([elevations[ring] for ring in order])
        own = points.new_tensor([heights[ring] for ring in order])
        elevation = torch.rad2deg(torch.atan2(z - middle, flat))
        place = _number_below(0.5 * (rising[1:] + rising[:-1]), elevation)
        height, distance = _values_at(own, place), (elevation - _values_at(rising, place)).abs()
        if found is None or best is None:
            found, best = height, distance
        else:
            found, best = torch.where(distance < best, height, found), torch.minimum(distance, best)
    assert found is not None
    return torch.where(there, found, 0.0)


def _by_loops(points: Tensor, sensor: Lidar, lower: Block, upper: Block) -> Tensor:
    """As ``_by_elevation``, by compiled loops: the same bits."""
    from torchweather.lidar.sweep.compiled_heights import heights_of_rows

    rows = points.detach().reshape(-1, points.shape[-1]).contiguous()
    found = torch.empty(len(rows))
    if heights_of_rows(found.numpy(), rows.numpy(), lower, upper, np.float32(NEAR)):
        unsure = torch.from_numpy(np.flatnonzero(np.isnan(found.numpy())))
        some = rows[unsure]
        found[unsure] = _by_elevation(some, sensor, holds_return(some))
    return found.reshape(points.shape[:-1])


@lru_cache(maxsize=16)
def _blocks(sensor: Lidar) -> tuple[Block, Block] | None:
    """The lower and the upper block of lasers as compiled loops take them; ``None`` where there are others than two.

    A beam is the block's of the nearest ring. Inside a block that is half a gap away at most: what lies farther than
    that from the other block's end is sure.
    """
    from torchweather.lidar.sweep.compiled_heights import Block

    heights, elevations = sensor.origin_heights_m or (), sensor.elevations_deg or ()
    members = height_blocks(heights)
    if len(members) != 2 or any(len(one) < 2 for one in members) or len(elevations) != len(heights):
        return None
    orders = [sorted(one, key=lambda ring: elevations[ring]) for one in members]
    rising = [np.array([elevations[ring] for ring in one]) for one in orders]
    lower, upper = rising
    if not (lower[0] < upper[0] and lower[-1] < upper[-1]) or max(abs(lower).max(), abs(upper).max()) > STEEPEST_DEG:
        return None
    gaps = [0.5 * np.diff(one).max() + MARGIN_DEG for one in rising]
    ends = (upper[0] - gaps[0], lower[-1]), (lower[-1] + gaps[1], upper[0])
    built = []
    for one, order, own, (sure, within) in zip(members, orders, rising, ends, strict=True):
        limits = np.tan(np.radians(0.5 * (own[1:] + own[:-1])))
        low, high, least = limits[0] - 0.01, limits[-1] + 0.01, np.diff(limits).min(initial=1.0)
        if least < 20.0 * NEAR:
            return None
        cells = math.ceil((high - low) / (0.5 * least))
        begins = low + (high - low) * np.arange(cells) / cells
        first = np.searchsorted(limits, begins - 2.0 * NEAR)
        built.append(
            Block(
                np.float32(sum(heights[ring] for ring in one) / len(one)),
                np.float32(math.tan(math.radians(sure))),
                np.float32(math.tan(math.radians(within))),
                np.float32(low),
                np.float32(cells / (high - low)),
                first.astype(np.int32),
                np.append(limits, np.inf).astype(np.float32),
                np.array([heights[ring] for ring in order], np.float32),
            )
        )
    return built[0], built[1]


def _number_below(rising: Tensor, values: Tensor) -> Tensor:
    """Number of entries of a rising row below each value."""
    if is_exporting():
        return (values[..., None] > rising).sum(-1)
    return torch.bucketize(values, rising)


def _values_at(table: Tensor, place: Tensor) -> Tensor:
    """Entries of a row at places of any shape."""
    return table.index_select(0, place.reshape(-1)).view(place.shape)
