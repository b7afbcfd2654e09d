"""A sweep completed: the beams that its scan pattern has and its points lack, where they end, and rows for them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.lidar.scan import empty_beams
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.sweep.beam_ends import BeamEnd, beam_ends, ways_above_ground
from torchweather.lidar.sweep.beam_heights import beam_heights_m
from torchweather.lidar.sweep.echo_pairs import first_rows, holds_pairs, shares_beams
from torchweather.lidar.sweep.own_vehicle import OwnVehicleMask
from torchweather.lidar.sweep.scan_counts import check_scan_counts
from torchweather.lidar.sweep.scan_pattern import estimate_pattern
from torchweather.lidar.sweep.sweep_check import checked_rings

__all__ = ["CompletedScan", "complete_scan"]

TURN_DEG = 360.0
TOO_MANY = 0.03  # the motor's speed changes the columns of a turn by 1 % (KITTI)


@dataclass(frozen=True)
class CompletedScan:
    """Beams that a sweep of N rows lacks, M of them.

    Args:
        direction: ``(M, 3)`` unit vectors.
        ring: ``(M,)`` int64.
        height_m: ``(M,)`` at which they start, metres, or ``None`` where all start at the origin.
        end_m: ``(M,)`` way to the end, metres.
        end: ``(M,)`` int8, `BeamEnd`.
        rows: ``(M, C)`` for the cloud: no position, no intensity, its ring in the ring column, the other columns as
            those of the nearest return of the ring.
        row_way_m: ``(N,)`` way of the sweep's own rows on which particles may lie, ``inf`` but for returns below the
            ground; 0 for rows without return.
        row_height_m: ``(N,)`` at which the beams of the sweep's own rows start, or ``None``.
        row_end: ``(N,)`` int8, `BeamEnd` of the sweep's own rows.
        first_row: ``(N,)`` int64 first row of each row's beam, where the file holds several echoes a beam; else
            ``None``.
        words: how many beams end where.
        row_own: ``(N,)`` bool, rows whose return lies on the own vehicle; ``None`` without a mask of it.
    """

    direction: Tensor
    ring: Tensor
    height_m: Tensor | None
    end_m: Tensor
    end: Tensor
    rows: Tensor
    row_way_m: Tensor
    row_height_m: Tensor | None
    row_end: Tensor
    first_row: Tensor | None
    words: str
    row_own: Tensor | None = None


def complete_scan(
    cloud: Tensor, sensor: Lidar, *, sky_alone: bool = False, own_vehicle: OwnVehicleMask | None = None
) -> CompletedScan:
    """Find the beams of a sweep that returned nothing.

    Args:
        cloud: ``(N, C)`` x, y, z in metres in the sensor's frame, further columns.
        sensor: with its scan pattern.
        sky_alone: keep only beams that end in the sky.
        own_vehicle: mask of it; ``None``: as `beam_ends` finds it in this sweep.

    Returns:
        What the sweep lacks.

    Raises:
        ValueError: returns and appended beams are more than rings times columns.
    """
    column = sensor.ring_column
    found, cloud = checked_rings(cloud, sensor)
    ring, sensor = found.ring, found.sensor
    squared_m2 = cloud[:, :3].square().sum(-1)
    there = (squared_m2 > 0) & (squared_m2 >= sensor.min_range_m**2)
    row_height_m = beam_heights_m(cloud, sensor, ring)
    lowered = cloud[:, :3].clone()
    if row_height_m is not None:
        lowered[:, 2] -= row_height_m
        lowered = torch.where(there[:, None], lowered, 0.0)
    direction, found_ring, _ = empty_beams(lowered, sensor, ring)
    if column is not None:
        kept = _as_many_as_rows(cloud[:, column].long(), there, found_ring)
        direction, found_ring = direction[kept], found_ring[kept]
    first_row = _checked_beams(cloud, ring, there, len(direction), sensor)
    heights = None
    if sensor.origin_heights_m is not None and row_height_m is not None:
        heights = cloud.new_tensor(sensor.origin_heights_m)[found_ring]
    columns = sensor.columns or 1
    every = bool(there.all())
    returns = as_numpy(cloud[:, :3] if every else cloud[there, :3])
    ends = beam_ends(
        returns,
        direction.cpu().numpy(),
        sensor.max_range_m,
        ring=(ring if every else ring[there]).cpu().numpy(),
        direction_ring=found_ring.cpu().numpy(),
        origin_height_m=0.0 if heights is None else heights.cpu().numpy(),
        step_deg=TURN_DEG / columns,
        own_vehicle=None
        if own_vehicle is None
        else own_vehicle.hides(direction.cpu().numpy(), found_ring.cpu().numpy()),
    )
    end, end_m = torch.from_numpy(ends.end).to(cloud.device), torch.from_numpy(ends.distance_m).to(cloud)
    kept = end == int(BeamEnd.SKY) if sky_alone else torch.ones_like(end, dtype=torch.bool)
    direction, found_ring, end, end_m = direction[kept], found_ring[kept], end[kept], end_m[kept]
    of_row = 0.0 if row_height_m is None else row_height_m[there].cpu().numpy()
    row_way_m = cloud.new_zeros(len(cloud))
    row_way_m[there] = torch.from_numpy(ways_above_ground(returns, ends.ground, of_row)).to(cloud)
    rows = _rows(cloud, there, ring, direction, found_ring, column)
    row_end = torch.where(there, int(BeamEnd.RETURN), int(BeamEnd.UNKNOWN)).to(torch.int8)
    words, row_own = found.words + _echo_words(first_row, there), None
    if own_vehicle is not None:
        held = own_vehicle.holds(as_numpy(cloud[:, :3]), torch.where(there, ring, -1).cpu().numpy())
        words, row_own = f"{words}; {own_vehicle.words}", torch.from_numpy(held).to(cloud.device)
    return CompletedScan(
        direction,
        found_ring,
        None if heights is None else heights[kept],
        end_m,
        end,
        rows,
        row_way_m,
        row_height_m,
        row_end,
        first_row,
        _words(end, words, sky_alone=sky_alone),
        row_own,
    )


def _as_many_as_rows(row_ring: Tensor, there: Tensor, found_ring: Tensor) -> Tensor:
    """Mask ``(M,)`` of the beams that stay, so that no ring has more than the file has rows without a return.

    A file with a row for every beam (nuScenes) has as many rows on every ring, and so says how many returned nothing.
    Where its points are compensated for motion, gaps are too wide by a percent.
    """
    kept = torch.ones(len(found_ring), dtype=torch.bool, device=found_ring.device)
    rows = torch.bincount(row_ring.clamp(min=0))
    if not len(rows) or bool((rows != rows[0]).any()) or bool(there.all()):
        return kept
    wanted = torch.bincount(row_ring[~there].clamp(min=0), minlength=len(rows))
    for ring, count in enumerate(torch.bincount(found_ring, minlength=len(rows)).tolist()):
        most = int(wanted[ring]) if ring < len(wanted) else count
        if count > most:
            own = (found_ring == ring).nonzero()[:, 0]
            kept[own] = False
            kept[own[torch.linspace(0, count - 1, most).round().long()]] = True
    return kept


def _checked_beams(cloud: Tensor, ring: Tensor, there: Tensor, appended: int, sensor: Lidar) -> Tensor | None:
    """First rows of the beams where a file holds several echoes a beam; raises where there are too many beams."""
    rings, columns = len(sensor.elevations_deg or ()), sensor.columns or 1
    returns = int(there.sum())
    first = None
    number, step_deg = ring.cpu().numpy(), TURN_DEG / columns
    if holds_pairs(returns, rings, columns) or shares_beams(as_numpy(cloud[:, :3]), number, step_deg):
        xyz = torch.where(there[:, None], cloud[:, :3], 0.0).double().cpu().numpy()
        rows = first_rows(xyz, number, step_deg)
        first = torch.from_numpy(rows).to(cloud.device)
        returns = int((first[there] == there.nonzero()[:, 0]).sum())
    if returns + appended > (1.0 + TOO_MANY) * rings * columns:
        pattern = estimate_pattern(cloud[:, :3].cpu(), torch.where(there, ring, -1).cpu())
        if pattern.beams + appended > (1.0 + TOO_MANY) * rings * columns:  # echoes of a beam counted once
            check_scan_counts(pattern, appended, rings=rings, columns=columns)
    return first


def _echo_words(first_row: Tensor | None, there: Tensor) -> str:
    if first_row is None:
        return ""
    further = int((first_row[there] != there.nonzero()[:, 0]).sum())
    return f"; {further} rows are further echoes of a beam and meet the same particles"


def _words(end: Tensor, rings: str, *, sky_alone: bool) -> str:
    counts = torch.bincount(end.long(), minlength=len(BeamEnd)).tolist()
    named = {
        BeamEnd.SKY: "in the sky",
        BeamEnd.GROUND: "on the ground",
        BeamEnd.OWN_VEHICLE: "on the own vehicle",
        BeamEnd.OBSTACLE: "at an obstacle",
    }
    parts = ", ".join(f"{counts[kind]} {where}" for kind, where in named.items() if counts[kind])
    only = "; only beams that end in the sky are simulated" if sky_alone else ""
    ends = f", which end: {parts}" if parts else ""
    return f"completed from the scan pattern with {len(end)} beams{ends}{only} ({rings})"


def _rows(
    cloud: Tensor, there: Tensor, ring: Tensor, direction: Tensor, found_ring: Tensor, column: int | None
) -> Tensor:
    """Rows for beams without return: further columns as those of the nearest return of the ring in azimuth."""
    rows = cloud.new_zeros(len(direction), cloud.shape[-1])
    if cloud.shape[-1] <= 4 or not len(rows):
        return rows
    returns = cloud[there]
    if len(returns):
        key = 2.0 * TURN_DEG * ring[there].double() + _azimuth_deg(returns)
        order = key.argsort()
        sought = 2.0 * TURN_DEG * found_ring.double() + _azimuth_deg(direction)
        after = torch.searchsorted(key[order], sought).clamp(max=len(order) - 1)
        before = (after - 1).clamp(min=0)
        nearer = (key[order][after] - sought).abs() < (key[order][before] - sought).abs()
        rows[:, 4:] = returns[order[torch.where(nearer, after, before)], 4:]
    if column is not None:
        rows[:, column] = found_ring.to(rows)
    return rows


def _azimuth_deg(xyz: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(xyz[:, 1].double(), xyz[:, 0].double())) % TURN_DEG
