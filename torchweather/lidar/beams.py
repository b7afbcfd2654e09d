"""The beams of a cloud: those with a return, those without, where each starts and how far it goes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError, owner_name
from torchweather.lidar.cloud_frame import are_plain, holds_return, points_in_sensor_frame, with_column
from torchweather.lidar.scan import recover_ring
from torchweather.lidar.sensor import Lidar, unit_directions
from torchweather.lidar.sweep.beam_ends import BeamEnd, beam_ends, ways_above_ground
from torchweather.lidar.sweep.beam_heights import beam_heights_m
from torchweather.lidar.sweep.completion import complete_scan as completed
from torchweather.lidar.sweep.echo_pairs import first_rows, holds_pairs
from torchweather.lidar.sweep.own_vehicle import OwnVehicle, OwnVehicleMask, rows_in_box
from torchweather.lidar.sweep.sweep_rings import sweep_rings
from torchweather.pipeline.tiling import is_exporting

__all__ = ["COMPLETE_SCAN", "BeamFinder", "Beams", "beams_of"]

COMPLETE_SCAN = (False, True, "sky")
ROWS_ALONE = "the rows that exist; a row without return has no direction and stays empty"


@dataclass(frozen=True)
class Beams:
    """The beams of a cloud.

    Args:
        points: ``(B, N, C)`` in at least float32, from where the beams start; N with the beams that were appended.
        empty_direction: ``(1 or B, N, 3)`` unit vectors for rows without return, or ``None``.
        end_m: ``(B, N)`` way of each beam to its end, ``inf`` for those with a return (less for a return below the
            ground); ``None``: the maximum range.
        end: ``(B, N)`` int8, `BeamEnd` of each row; ``None`` in an exported graph.
        height_m: ``(1 or B, N)`` at which the beams start over the sensor's origin, or ``None`` for 0.
        first_row: ``(B, N)`` int64 first row of each row's beam where a file holds several echoes a beam, or ``None``.
        scan: how beams without return were treated, in words.
        appended: rows at the end that are not in the input.
        on_own: ``(B, N)`` bool, returns that lie on the own vehicle; ``None`` where it is not known.
        range_m: ``(B, N)`` range of each row, 0 where it holds no return; ``None`` where it is not worked out yet.
    """

    points: Tensor
    empty_direction: Tensor | None
    end_m: Tensor | None
    end: Tensor | None
    height_m: Tensor | None
    first_row: Tensor | None
    scan: str
    appended: int
    on_own: Tensor | None = None
    range_m: Tensor | None = None


class BeamFinder:
    """`beams_of` for one transform, with the last cloud's beams kept: a draw and the call after it find them once."""

    def __init__(self) -> None:
        self._cloud: Tensor | None = None
        self._asked: tuple[Lidar, bool | str, bool, OwnVehicle | None] | None = None
        self._beams: Beams | None = None
        self._unit: tuple[Tensor, int, Tensor] | None = None

    def for_another_weather(self) -> BeamFinder:
        """One that keeps nothing of a cloud."""
        found = BeamFinder()
        found._unit = self._unit
        return found

    def _unit_directions(self, directions: Tensor | None, sensor: Lidar, owner: object) -> Tensor | None:
        """Directions of unit length; those of the sensor are worked out once."""
        if directions is None or directions is not sensor.directions or is_exporting():
            return None if directions is None else unit_directions(directions, owner=owner)
        known = self._unit
        if known is None or known[0] is not directions or known[1] != directions._version:
            known = directions, directions._version, unit_directions(directions, owner=owner)
            self._unit = known
        return known[2]

    def __call__(
        self,
        points: Tensor,
        sensor: Lidar,
        directions: Tensor | None,
        *,
        complete_scan: bool | str,
        at_scene: bool,
        own_vehicle: OwnVehicle | None,
        owner: object,
    ) -> Beams:
        """As `beams_of`, of a cloud ``(..., N, C)`` in its own frame."""
        keeps = bool(complete_scan) and directions is None and not points.requires_grad
        if keeps and self._beams is not None and self._asked == (sensor, complete_scan, at_scene, own_vehicle):
            # By value: a buffer that somebody writes anew is another cloud.
            kept = self._cloud
            alike = kept is not None and (kept.dtype, kept.device) == (points.dtype, points.device)
            if alike and kept is not None and torch.equal(kept, points):
                return self._beams
        local = points_in_sensor_frame(points, sensor)
        beams = beams_of(
            local,
            sensor,
            directions if complete_scan else self._unit_directions(directions, sensor, owner),
            complete_scan=complete_scan,
            at_scene=at_scene,
            own_vehicle=own_vehicle,
            owner=owner,
            are_unit=True,
        )
        if keeps:
            self._beams, self._cloud = beams, points.detach().clone()
            self._asked = sensor, complete_scan, at_scene, own_vehicle
        return beams

    def __deepcopy__(self, memo: dict[int, object]) -> BeamFinder:
        return BeamFinder()

    def __reduce__(self) -> tuple[type[BeamFinder], tuple[()]]:
        return BeamFinder, ()


def beams_of(
    points: Tensor,
    sensor: Lidar,
    directions: Tensor | None,
    *,
    complete_scan: bool | str,
    at_scene: bool = True,
    own_vehicle: OwnVehicle | None = None,
    owner: object,
    are_unit: bool = False,
) -> Beams:
    """Flatten the batch, and find the direction and the end of beams without return.

    Args:
        points: ``(..., N, C)`` in the sensor's frame.
        sensor: the LiDAR.
        directions: ``(N, 3)`` or ``(..., N, 3)`` of every row, or ``None``.
        complete_scan: append the beams that the scan pattern lacks; ``"sky"`` only those that end in the sky.
        at_scene: find where beams without return end; else they go to the maximum range.
        own_vehicle: mask or box of it; names the returns that lie on it.
        owner: for messages.
        are_unit: whether the directions are known to be of unit length.
    """
    count, columns = points.shape[-2:]
    batch = math.prod(points.shape[:-2])
    flat = points.reshape(batch, count, columns)
    if flat.dtype not in (torch.float32, torch.float64):
        flat = flat.float()
    if directions is not None and not are_unit and not complete_scan:
        directions = unit_directions(directions, owner=owner)
    beams = _beams_of(points, flat, sensor, directions, complete_scan, at_scene, own_vehicle, owner)
    if own_vehicle is None or beams.on_own is not None:
        return beams
    if isinstance(own_vehicle, OwnVehicleMask):
        on_own = torch.stack([_on_mask(cloud.detach(), sensor, own_vehicle) for cloud in flat])
    else:
        squared_m2 = flat[..., :3].square().sum(-1)
        on_own = (squared_m2 > 0) & (squared_m2 >= sensor.min_range_m**2) & rows_in_box(flat[..., :3], own_vehicle)
    return replace(beams, on_own=torch.nn.functional.pad(on_own, (0, beams.appended)))


def _beams_of(
    points: Tensor,
    flat: Tensor,
    sensor: Lidar,
    directions: Tensor | None,
    complete_scan: bool | str,
    at_scene: bool,
    own_vehicle: OwnVehicle | None,
    owner: object,
) -> Beams:
    if directions is not None:
        if complete_scan:
            raise InputValueError(
                f"{owner_name(owner)}: complete_scan is for clouds without directions; give one or the other."
            )
        along = _fitting(directions, points, owner).to(flat)
        there = holds_return(flat)
        height_m = beam_heights_m(flat, sensor, there=there)
        words = "directions given for every row"
        beams = Beams(_lowered(flat, height_m, there), along, None, None, height_m, None, words, 0)
        return beams if is_exporting() or not at_scene else _with_ends(beams, sensor)
    if complete_scan:
        mask = own_vehicle if isinstance(own_vehicle, OwnVehicleMask) else None
        beams = _completed(flat, sensor, mask, sky_alone=complete_scan == "sky")
        if at_scene or beams.end_m is None:
            return beams
        there = (beams.empty_direction != 0).any(-1) if beams.empty_direction is not None else beams.end_m > 0
        return replace(beams, end_m=torch.where(there, sensor.max_range_m, beams.end_m))
    if not is_exporting() and are_plain(flat):
        return _started(flat, sensor)
    there = holds_return(flat)
    height_m = beam_heights_m(flat, sensor, there=there)
    beams = Beams(_lowered(flat, height_m, there), None, None, None, height_m, None, ROWS_ALONE, 0)
    if is_exporting():
        return beams
    beams = replace(beams, first_row=_pairs(beams.points, sensor))
    return replace(beams, end=torch.where(there, int(BeamEnd.RETURN), int(BeamEnd.UNKNOWN)).to(torch.int8))


def _started(flat: Tensor, sensor: Lidar) -> Beams:
    """The rows of a cloud without directions, by compiled loops: the bits of torch."""
    from torchweather.lidar.compiled_cloud import start_rows

    clouds = flat.detach().contiguous()
    height_m = _heights(clouds, sensor)
    lowered = clouds if height_m is None else torch.empty_like(clouds)
    range_m, end = torch.empty(flat.shape[:-1]), torch.empty(flat.shape[:-1], dtype=torch.int8)
    nowhere = np.zeros((0, 0), np.float32)
    for sample, cloud in enumerate(clouds):
        start_rows(
            nowhere if height_m is None else lowered[sample].numpy(),
            range_m[sample].numpy(),
            end[sample].numpy(),
            cloud.numpy(),
            np.zeros(1, np.float32) if height_m is None else _of_rows(height_m[sample]).numpy(),
            int(BeamEnd.UNKNOWN),
        )
    range_m.sqrt_()  # torch rounds a root otherwise than the processor
    if sensor.min_range_m > 0:
        range_m = torch.where(range_m < sensor.min_range_m, 0.0, range_m)
    first_row = _pairs(lowered, sensor)
    return Beams(lowered, None, None, end, height_m, first_row, ROWS_ALONE, 0, range_m=range_m)


def _heights(clouds: Tensor, sensor: Lidar) -> Tensor | None:
    """As ``beam_heights_m``, of rows at the origin, too, where all beams start at one height."""
    values = set(sensor.origin_heights_m or ())
    if len(values) == 1 and any(values):
        return torch.tensor(values.pop()).expand(clouds.shape[:-1])
    return beam_heights_m(clouds, sensor)


def _of_rows(height_m: Tensor) -> Tensor:
    """Heights of the rows of a cloud, one of all where they are expanded from one."""
    return (height_m[:1] if height_m.stride(0) == 0 else height_m).contiguous()


def _lowered(flat: Tensor, height_m: Tensor | None, there: Tensor | None = None) -> Tensor:
    """The cloud from where its beams start; rows at the origin hold no return and stay there (not in ``there``)."""
    if height_m is None:
        return flat
    z = flat[..., 2]
    return with_column(flat, 2, torch.where(holds_return(flat) if there is None else there, z - height_m.to(z), z))


def _fitting(directions: Tensor, points: Tensor, owner: object) -> Tensor:
    count = points.shape[-2]
    batch = points.shape[:-2]
    if directions.shape[-2] != count:
        raise InputValueError(
            f"{owner_name(owner)}: directions must have one row for each of the {count} points; got "
            f"{tuple(directions.shape)}. An organised cloud keeps a row for every beam, range 0 where none returned."
        )
    if directions.ndim == 2:
        return directions[None]
    if directions.shape[:-2] != batch:
        raise InputValueError(
            f"{owner_name(owner)}: directions {tuple(directions.shape)} must lead with the batch shape {tuple(batch)}."
        )
    return directions.reshape(-1, count, 3)


def _with_ends(beams: Beams, sensor: Lidar) -> Beams:
    """The beams of an organised cloud with the ends of those without return."""
    points, along = beams.points, beams.empty_direction
    assert along is not None
    returns = (points[..., :3].square().sum(-1) > sensor.min_range_m**2) & holds_return(points)
    end_m = torch.full(returns.shape, torch.inf, dtype=points.dtype)
    end = torch.full(returns.shape, int(BeamEnd.RETURN), dtype=torch.int8)
    clouds, directions = as_numpy(points), as_numpy(along)
    for sample, hit in enumerate(as_numpy(returns)):
        there, empty = np.flatnonzero(hit), np.flatnonzero(~hit)
        if not len(empty):
            continue
        direction = directions[min(sample, len(directions) - 1)].take(empty, 0)
        known = (direction != 0).any(-1)
        xyz = clouds[sample, :, :3].take(there, 0)
        step_deg = sensor.column_step_deg or 0.2
        found = beam_ends(xyz, direction, sensor.max_range_m, step_deg=step_deg)
        end_m[sample].numpy()[there] = ways_above_ground(xyz, found.ground, 0.0)
        end_m[sample].numpy()[empty] = np.where(known, found.distance_m, 0.0)
        end[sample].numpy()[empty] = np.where(known, found.end, int(BeamEnd.UNKNOWN))
    return replace(beams, end_m=end_m.to(points), end=end.to(points.device))


def _on_mask(cloud: Tensor, sensor: Lidar, mask: OwnVehicleMask) -> Tensor:
    held = mask.holds(as_numpy(cloud[:, :3]), sweep_rings(cloud, sensor).ring.cpu().numpy())
    return torch.from_numpy(held).to(cloud.device)


def _completed(flat: Tensor, sensor: Lidar, mask: OwnVehicleMask | None, *, sky_alone: bool) -> Beams:
    """Append the beams that the scan pattern has and the cloud lacks; samples that lack fewer get rows of zeros."""
    batch, count, columns = flat.shape
    sweeps = [completed(cloud.detach(), sensor, sky_alone=sky_alone, own_vehicle=mask) for cloud in flat]
    most = max((len(sweep.direction) for sweep in sweeps), default=0)
    rows = flat.new_zeros(batch, most, columns)
    direction = flat.new_zeros(batch, count + most, 3)
    end_m = flat.new_zeros(batch, count + most)
    end = torch.full((batch, count + most), int(BeamEnd.UNKNOWN), dtype=torch.int8, device=flat.device)
    heights = any(sweep.height_m is not None for sweep in sweeps)
    height_m = flat.new_zeros(batch, count + most) if heights else None
    for sample, sweep in enumerate(sweeps):
        own = slice(count, count + len(sweep.direction))
        direction[sample, own] = sweep.direction.to(flat)
        end_m[sample, :count] = sweep.row_way_m
        end_m[sample, own] = sweep.end_m.to(flat)
        end[sample, :count] = sweep.row_end
        end[sample, own] = sweep.end
        rows[sample, : len(sweep.direction)] = sweep.rows.to(flat)
        if height_m is not None and sweep.height_m is not None and sweep.row_height_m is not None:
            height_m[sample, :count] = sweep.row_height_m
            height_m[sample, own] = sweep.height_m
    first_row = None
    if any(sweep.first_row is not None for sweep in sweeps):
        own_rows = torch.arange(count + most, device=flat.device)
        first_row = own_rows.repeat(batch, 1)
        for sample, sweep in enumerate(sweeps):
            if sweep.first_row is not None:
                first_row[sample, :count] = sweep.first_row
    words = "; ".join(dict.fromkeys(sweep.words for sweep in sweeps))
    points = torch.cat([_lowered(flat, None if height_m is None else height_m[:, :count]), rows], 1)
    on_own = None
    if mask is not None:
        own_rows_of = [sweep.row_own for sweep in sweeps if sweep.row_own is not None]
        on_own = torch.nn.functional.pad(torch.stack(own_rows_of), (0, most)) if own_rows_of else None
    return Beams(points, direction, end_m, end, height_m, first_row, words, most, on_own)


def _pairs(points: Tensor, sensor: Lidar) -> Tensor | None:
    """First row of each row's beam ``(B, N)``, where there are more returns than the sensor has beams."""
    rings, columns = sensor.elevations_deg, sensor.columns
    if rings is None or columns is None or not holds_pairs(points.shape[1], len(rings), columns):
        return None
    found = []
    for cloud in points.detach():
        ring = recover_ring(cloud, replace(sensor, origin_heights_m=None)) if sensor.ring_column is None else None
        number = cloud[:, sensor.ring_column or 0].long() if ring is None else ring
        rows = first_rows(cloud[:, :3].double().cpu().numpy(), number.cpu().numpy(), 360.0 / columns)
        found.append(torch.from_numpy(rows).to(points.device))
    return torch.stack(found)
