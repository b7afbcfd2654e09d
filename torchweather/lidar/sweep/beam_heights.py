"""Heights at which a LiDAR's beams start: the lasers of a Velodyne HDL-64E sit in two blocks, 8 cm apart."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.lidar.cloud_frame import holds_return
from torchweather.lidar.laser_blocks import height_blocks
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.tiling import is_exporting

__all__ = ["beam_heights_m"]


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
    there = holds_return(points) if there is None else there
    values = sorted(set(heights))
    if len(values) == 1:
        return torch.where(there, values[0], 0.0).to(points)
    if ring is None and sensor.ring_column is not None:
        ring = points[..., sensor.ring_column].long()
    if ring is not None:
        of_ring = points.new_tensor(heights)
        known = there & (ring >= 0) & (ring < len(heights))
        return torch.where(known, of_ring[ring.clamp(0, len(heights) - 1)], 0.0)
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


def _number_below(rising: Tensor, values: Tensor) -> Tensor:
    """Number of entries of a rising row below each value."""
    if is_exporting():
        return (values[..., None] > rising).sum(-1)
    return torch.bucketize(values, rising)


def _values_at(table: Tensor, place: Tensor) -> Tensor:
    """Entries of a row at places of any shape."""
    return table.index_select(0, place.reshape(-1)).view(place.shape)
