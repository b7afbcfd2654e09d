"""Population: one kind of particle in a camera's frustum, its draws and its optical depth per pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import copy as shallow_copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.atmosphere.density_field import Banks
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.camera.fog import ground_rays, over_ground
from torchweather.camera.particles.depth_blocks import BLOCK_PX, DepthBlocks
from torchweather.camera.particles.image_motion import ImageMotion
from torchweather.camera.particles.streaks import Marks, add_listed, add_static
from torchweather.camera.particles.tables import MarkOptics, particle_tables
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.core.random import ABSENT, Variate
from torchweather.core.threads import side_by_side
from torchweather.pipeline.tiling import is_exporting

__all__ = ["Population"]

RATE_CAPACITY_MM_PER_H = {"rain": 100.0, "snow": 10.0}
FLOOR = 1e-30  # keeps logarithms finite where nothing falls
SUMS = 4  # partial sums of the optical depth, filled side by side
SLOTS_AT_ONCE = 1 << 18  # points whose arrays stay in the cache
# By which a second use of the draw is displaced in column, row and depth: powers of the root of x^4 = x + 1.
DISPLACED = (0.8191725134, 0.6710436067, 0.5497004779)
STEEPEST = 1.6  # longest sideways path over the fall's, in an exported graph: the bound of camera.wind_slant
SLOWEST = 0.1  # of a rolling shutter relative to a particle, in rows: beyond that its mark grows no longer
# Columns of a point: image column and row, depth, level.
COLUMN_U, COLUMN_V, COLUMN_DEPTH, COLUMN_LEVEL, COLUMNS = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class _Points:
    """Points ``(P, 4)`` that are rendered alike, and the sample of each (``None``: one sample).

    Args:
        slanted: whether paths lean although the camera stands upright in still air.
        copy: number of the displaced copy; its levels begin there.
    """

    points: Tensor
    sample: Tensor | None
    slanted: bool = False
    copy: int = 0


@dataclass(frozen=True)
class AtRate:
    """The tables at each sample's rate.

    Args:
        bounds: of each shell, ln of the density of listed particles.
        outline_m, fall_speed: over the level.
        haze_depth, haze_variance: over the footprint.
        kernel_along, kernel_across: of each shell of the haze.
        falls: ``(B,)`` whether anything falls.
        count: ``(B,)`` particles at the densest place over those of the rate; ``None`` is 1.
        banks: where they are dense; ``None`` is everywhere alike.
        path_density: ``(B, 1, H, W)`` mean density in front of the scene; ``None`` likewise.
    """

    bounds: list[Tensor]
    outline_m: Tensor
    fall_speed: Tensor
    haze_depth: Tensor
    haze_variance: Tensor
    kernel_along: Tensor
    kernel_across: Tensor
    falls: Tensor
    count: Tensor | None = None
    banks: Banks | None = None
    path_density: Tensor | None = None


class Population(nn.Module):
    """Rain drops or snow flakes seen by a camera; used by ``ParticleVeil``.

    Args:
        weather: the precipitation.
        camera: the camera.
        near_m, far_m, min_listed_coverage, max_listed_density, ego_speed_m_per_s, rate_capacity_mm_per_h: as in
            ``ParticleVeil``.
        published_blend: D3.4's blend weight.
    """

    rate_mm_per_h: Tensor

    def __init__(
        self,
        weather: Rain | Snow,
        camera: Camera,
        *,
        near_m: float,
        far_m: float,
        min_listed_coverage: float,
        max_listed_density: float,
        ego_speed_m_per_s: float,
        rate_capacity_mm_per_h: float | None,
        published_blend: bool,
    ) -> None:
        super().__init__()
        self.weather, self.camera = weather, camera
        check_arguments(
            "ParticleVeil(near_m: float, far_m: float, rate_capacity_mm_per_h: float | None, ego_speed_m_per_s: float, "
            "min_listed_coverage: float, max_listed_density: float)",
            near_m,
            far_m,
            rate_capacity_mm_per_h,
            ego_speed_m_per_s,
            min_listed_coverage,
            max_listed_density,
        )
        if rate_capacity_mm_per_h is not None:
            check_between("rate_capacity_mm_per_h", rate_capacity_mm_per_h, 0.0, 1e4, owner="ParticleVeil")
        check_at_least("near_m", near_m, 1e-3, unit="m", owner="ParticleVeil")
        self.near_m, self.far_m = float(near_m), float(far_m)
        focus = math.inf if camera.focus_distance_m is None else camera.focus_distance_m
        self.optics = MarkOptics(camera.exposure_s, camera.aperture_m, focus, camera.lens_blur_px, published_blend)
        self.focal_px = math.sqrt(camera.fx * camera.fy)
        self._headroom, self._widest = self._lens_extremes()
        capacity = rate_capacity_mm_per_h or RATE_CAPACITY_MM_PER_H[weather.kind]
        rate = weather.rate_mm_per_h
        highest = float(rate.detach().max()) if isinstance(rate, Tensor) and rate.numel() else rate
        if isinstance(highest, (int, float)) and highest > capacity:
            capacity = float(highest)
        self.rate_capacity_mm_per_h = capacity
        self._limits = (self.near_m, self.far_m, min_listed_coverage, max_listed_density, capacity)
        self.tables = particle_tables(weather, self.optics, self.focal_px, *self._limits)
        self.register_buffer("rate_mm_per_h", torch.as_tensor(rate, dtype=torch.float32))
        self._set_motion(ego_speed_m_per_s)
        self.reach_drift_m_per_s = self.drift_m_per_s
        self._set_tables()

    def at_ego_speed(self, ego_speed_m_per_s: float) -> Population:
        """The same particles seen from the vehicle at another, smaller speed; margins and slots stay as they are.

        Args:
            ego_speed_m_per_s: forward; its magnitude is at most that of the constructor's.
        """
        other = shallow_copy(self)  # shares tables, but of the haze's texture
        other._buffers = dict(self._buffers)
        other._set_motion(ego_speed_m_per_s)
        return other

    def _set_motion(self, ego_speed_m_per_s: float) -> None:
        rotation = torch.tensor(self.camera.camera_from_vehicle(), dtype=torch.float64)
        wind = torch.tensor(self.weather.wind_m_per_s, dtype=torch.float64)
        drift = rotation @ (wind - torch.tensor([ego_speed_m_per_s, 0.0, 0.0], dtype=torch.float64))
        self.down = self.camera.down_direction()
        self.right: tuple[float, ...] = tuple((-rotation[:, 1]).tolist())  # horizontal, in the camera's frame
        self.drift_m_per_s: tuple[float, float, float] = tuple(drift.tolist())
        self.vertical = self.down == (0.0, 1.0, 0.0) and not bool(drift.any()) and not self.camera.distorted
        haze = [d * self.tables.haze_speed_m_per_s + v for d, v in zip(self.down, self.drift_m_per_s, strict=True)]
        # The haze's streaks run along its mean motion at the image's centre.
        self.haze_steep = abs(haze[1]) >= abs(haze[0])
        major, minor = (haze[1], haze[0]) if self.haze_steep else (haze[0], haze[1])
        self.haze_slope = minor / major if abs(major) > 1e-9 else 0.0
        self._set_texture()

    def _set_texture(self) -> None:
        """Variance and correlation of the haze as its streaks are, in wind and from a moving vehicle."""
        camera = self.camera
        (cx, cy), (fx, fy) = camera.principal_point_px, (camera.fx, camera.fy)
        x = ((-0.5 - cx) / fx, (camera.width - 0.5 - cx) / fx)
        y = ((-0.5 - cy) / fy, (camera.height - 0.5 - cy) / fy)
        motion = ImageMotion(self.down, self.drift_m_per_s, x, y, self.haze_steep, self.haze_slope)
        textured = particle_tables(self.weather, self.optics, self.focal_px, *self._limits, motion)
        self._keep("variance_table", textured.haze_variance)
        self._keep("along_table", textured.kernel_along)
        self._keep("across_table", textured.kernel_across)
        self.haze_shells = textured.haze

    def _set_tables(self) -> None:
        t = self.tables
        self._keep("outline", t.log_outline_m)
        self._keep("speed", t.log_fall_speed)
        self._keep("depth_table", t.haze_depth)
        self.nearest_foot_m_per_px = tuple(math.exp(float(shell.log_footprint[0])) for shell in t.listed)
        for number, shell in enumerate(t.listed):
            # Tables over the footprint, read at the shell's own nodes.
            self._keep(f"footprint_{number}", np.exp(shell.log_footprint))
            self._keep(f"tail_at_cut_{number}", t.log_at(t.tail_at_cut, shell.log_footprint))
            self._keep(f"tail_most_{number}", t.log_at(t.tail_most, shell.log_footprint))

    def _keep(self, name: str, table: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        values = torch.from_numpy(np.ascontiguousarray(table)).float()
        before = self._buffers.get(name)
        self.register_buffer(name, values if before is None else values.to(before), persistent=False)

    # ---- draws -------------------------------------------------------------------------------------------------

    def reach_px(self, number: int) -> tuple[float, float]:
        """Margin of a shell, px: half of its longest path with its widest mark."""
        shell = self.tables.listed[number]
        nearest = self.nearest_foot_m_per_px[number]
        across, along, axial = (abs(v) for v in self.reach_drift_m_per_s)
        fastest = shell.length_max_px * nearest / self.optics.exposure_s  # fall speed of the fastest particle, m/s
        radial = axial + fastest * abs(self.down[2])
        half_u = max(self.camera.principal_point_px[0], self.camera.width - self.camera.principal_point_px[0])
        half_v = max(self.camera.principal_point_px[1], self.camera.height - self.camera.principal_point_px[1])
        speed_u = across + fastest * abs(self.down[0]) + radial * half_u / self.camera.fx
        speed_v = along + fastest * abs(self.down[1]) + radial * half_v / self.camera.fy
        scale = self.optics.exposure_s / nearest
        return (
            0.5 * (speed_u * scale + self.width_max_px(number)) + 1,
            0.5 * (speed_v * scale + self.width_max_px(number)) + 1,
        )

    def width_max_px(self, number: int) -> float:
        """Width of a shell's widest mark anywhere in the frame."""
        return self.tables.listed[number].width_max_px * self._widest

    def variates(self) -> tuple[Variate, ...]:
        """Points of each listed shell and the noise maps of the haze."""
        kind = self.weather.kind
        points = []
        for number, shell in enumerate(self.tables.listed):
            u, v = self.reach_px(number)
            per_px2 = shell.per_px2 * self.headroom()
            points.append(Variate(f"{kind}_shell_{number}", "points", (), per_px2, u, v, COLUMNS))
        haze = Variate(f"{kind}_haze", "normal", (len(self.haze_shells), "H", "W"))
        return (*points, haze)

    def headroom(self) -> float:
        """Slots that the lens distortion asks for, per slot of an undistorted lens; 1 without distortion."""
        return self._headroom

    def _lens_extremes(self) -> tuple[float, float]:
        """Slots per slot of an undistorted lens, and the largest growth of a mark's width off the axis."""
        w, h = self.camera.width, self.camera.height
        u = torch.linspace(-0.5, w - 0.5, 33, dtype=torch.float64)[None].expand(33, 33)
        v = torch.linspace(-0.5, h - 0.5, 33, dtype=torch.float64)[:, None].expand(33, 33)
        intrinsics = torch.tensor([self.camera.intrinsics], dtype=torch.float64)
        x, y = self.undistorted(u, v, intrinsics[0])
        scale = self.camera.magnification(x, y)
        widest = math.sqrt(float((mark_growth(x, y) * scale).max()))
        return max(1.0, float((1 / scale).max()) * 1.05) if self.camera.distorted else 1.0, widest

    def check_rate(self) -> None:
        """Raise ``ValueError`` where the rate exceeds what the slots of a draw can hold."""
        if is_exporting() or not self.rate_mm_per_h.numel():
            return
        highest = float(self.rate_mm_per_h.detach().max())
        if highest > self.rate_capacity_mm_per_h * (1 + 1e-6):
            raise InputValueError(
                f"ParticleVeil: rate_mm_per_h must be at most rate_capacity_mm_per_h = {self.rate_capacity_mm_per_h:g} "
                f"mm/h; got {highest:g}. Build the transform with rate_capacity_mm_per_h={highest:g} or more."
            )

    # ---- tables at a rate --------------------------------------------------------------------------------------

    def in_air(self, state: CameraState) -> AtRate:
        """The tables at each sample's rate, in the air of the state."""
        tables = self.at_rate(state.batch, state.air.particle_count)
        if state.air.patches is None or self.weather.patch_log_std == 0.0:
            return tables
        banks = state.air.patches.banks(self.weather)
        azimuth_rad, level = ground_rays(state)
        mean = banks.mean_to(azimuth_rad, level * state.scene.depth_m.clamp_max(self.far_m))
        densest = banks.density.flatten(1).amax(1)
        count = densest if tables.count is None else densest * tables.count
        return replace(tables, count=count, banks=banks, path_density=mean.float())

    def at_rate(self, batch: int, count: Tensor | None = None) -> AtRate:
        """Interpolate every table in ln(rate), one row per sample, or one where all have one rate.

        ``count`` ``(1 or B,)`` are the particles for each one.
        """
        rate = self.rate_mm_per_h.float().reshape(-1)
        if is_exporting():  # a graph's batch may have any size
            rate = rate.expand(batch)
        falls = rate > 0
        safe = torch.where(falls, rate, torch.ones_like(rate))
        position = (torch.log(safe) - self.tables.log_rate_low) / self.tables.log_rate_step
        cell = position.detach().floor().clamp(0, len(self.tables.tail_at_cut) - 2)
        share = position - cell  # beyond the ends: the end cells' power law
        index = cell.long()

        def rows(table: Tensor) -> Tensor:
            weight = share.reshape(-1, *[1] * (table.ndim - 1))
            return table.float()[index] * (1 - weight) + table.float()[index + 1] * weight

        amount = falls.to(rate.dtype)[:, None]
        if count is not None:
            amount = amount * count.to(rate.dtype)[:, None]
        # Linear tables (optical depth, variance) follow the rate's power law below the first node.
        low = torch.exp(share.clamp_max(0.0) * self.tables.log_rate_step)[:, None]
        held = share.clamp_min(0.0)

        def linear(table: Tensor) -> Tensor:
            weight = held.reshape(-1, *[1] * (table.ndim - 1))
            return table.float()[index] * (1 - weight) + table.float()[index + 1] * weight

        return AtRate(
            [rows(getattr(self, f"tail_at_cut_{number}")) for number in range(len(self.tables.listed))],
            torch.exp(rows(self.outline)),  # type: ignore[arg-type]
            torch.exp(rows(self.speed)),  # type: ignore[arg-type]
            linear(self.depth_table) * amount * low,  # type: ignore[arg-type]
            linear(self.variance_table) * amount * low,  # type: ignore[arg-type]
            linear(self.along_table),  # type: ignore[arg-type]
            linear(self.across_table),  # type: ignore[arg-type]
            falls,
            count,
        )

    # ---- listed particles --------------------------------------------------------------------------------------

    def undistorted(self, u: Tensor, v: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor]:
        """Undistorted normalised coordinates of image positions, for intrinsics ``(..., 4)``."""
        fx, fy, cx, cy = intrinsics.unbind(-1)
        return self.camera.undistort((u - cx) / fx, (v - cy) / fy)

    def marks(self, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate, number: int) -> Iterator[Marks]:
        """The particles of one listed shell as marks in the image, in portions.

        Absent particles are left out; while a graph is traced they stay, with opacity 0.
        """
        for _, points, sample in self._portions(state, noise, number):
            for part in self._parts_of(state, points, sample, tables, number):
                yield self._marks(state, part, tables, number, None)

    def _portions(
        self, state: CameraState, noise: Mapping[str, Tensor], number: int
    ) -> Iterator[tuple[int, Tensor, Tensor | None]]:
        """Points ``(P, 4)`` of a shell and the sample of each (``None``: one sample), in portions.

        A portion holds whole samples or a part of one, and has its number in its sample, so that a batch adds up in
        the order of its elements.
        """
        points = noise[f"{self.weather.kind}_shell_{number}"].to(state.image.signal.device)
        batch, slots, _ = points.shape
        sample = torch.arange(batch, device=points.device)[:, None].expand(batch, slots)
        together = batch if is_exporting() else max(1, SLOTS_AT_ONCE // max(1, slots))
        for row in range(0, batch, together):
            flat = points[row : row + together].reshape(-1, COLUMNS)
            whose = None if batch == 1 else sample[row : row + together].reshape(-1)
            if is_exporting() or together > 1:
                yield 0, flat, whose
                continue
            for portion, start in enumerate(range(0, slots, SLOTS_AT_ONCE)):
                some = slice(start, start + SLOTS_AT_ONCE)
                yield portion, flat[some], None if whose is None else whose[some]

    def _parts_of(
        self, state: CameraState, points: Tensor, sample: Tensor | None, tables: AtRate, number: int
    ) -> Iterator[_Points]:
        """Points that are rendered alike: samples with slanted paths apart, then what exceeds the slots.

        A count above what the slots hold comes from displaced copies of the same points, whose levels go on.
        """
        parts = [_Points(points, sample)]
        if state.air.path_tangent is not None and self.vertical:
            slanted = state.air.path_tangent != 0
            if is_exporting() or bool(slanted.all()):
                parts = [_Points(points, sample, slanted=True)]
            elif sample is not None and bool(slanted.any()):
                which = _own(slanted, sample)
                kinds = [(chosen.nonzero().squeeze(1), own) for chosen, own in ((~which, False), (which, True))]
                parts = [_Points(points[rows], sample[rows], own) for rows, own in kinds]
        yield from parts
        count = tables.count
        if count is None or is_exporting():
            return
        most: Tensor = getattr(self, f"tail_most_{number}")
        own = state.scene.intrinsics.detach().float().expand(state.batch, 4)
        room = torch.sqrt(own[:, 0] * own[:, 1]) / self.focal_px * (tables.bounds[number].detach() - most).amax(1).exp()
        wanted = torch.where(count > 1, count.detach() * room, 0.0)
        for copy in range(1, math.ceil(float(wanted.max()))):
            for part in parts:
                yield replace(part, points=_displaced(part.points, copy), copy=copy)

    def _marks(
        self, state: CameraState, part: _Points, tables: AtRate, number: int, blocks: DepthBlocks | None
    ) -> Marks:
        t, points, sample = self.tables, part.points, part.sample
        height, width = state.image.signal.shape[-2:]
        reach_u, reach_v = self.reach_px(number)
        # A level below `accept` is a particle at this rate; the slots' density belongs to the camera's own focal
        # length and to an undistorted lens.
        intrinsics = state.scene.intrinsics.float()
        focal = torch.sqrt(intrinsics[:, 0] * intrinsics[:, 1])
        thin = math.log(self.focal_px * self.headroom()) - torch.log(focal)
        if tables.count is not None:
            thin = thin - torch.log(tables.count.float().clamp_min(FLOOR))
        quantiles, most = getattr(self, f"footprint_{number}").float(), getattr(self, f"tail_most_{number}").float()
        bound = tables.bounds[number]  # (1 or B, nodes) ln of N_>(D_cut; R)
        if not self.camera.distorted and not is_exporting():
            # None of a higher level is there at any depth: most of the slots are for higher rates.
            highest = float((bound.detach() - most).max() - thin.detach().min())
            limit = math.exp(min(highest, 50.0)) * (1 + 1e-4) - part.copy  # a little more than rounding can move it
            some = (points[:, COLUMN_LEVEL] < limit).nonzero().squeeze(1)
            points, sample = points.index_select(0, some), None if sample is None else sample.index_select(0, some)
        columns = points.T if is_exporting() else points.T.contiguous()
        drawn_u, drawn_v, drawn_depth, drawn_level = (columns[k] for k in range(COLUMNS))
        thinning = _own(thin, sample)
        level = drawn_level + part.copy if part.copy else drawn_level
        cell, share = _cell(drawn_depth * (len(quantiles) - 1), len(quantiles))
        cut_level = _read(bound, cell, share, sample)
        if not self.camera.distorted:
            log_level = torch.log(level.clamp_min(FLOOR)) + _read(most, cell, share) + thinning
            shown = (drawn_level < ABSENT) & (log_level < cut_level)
            if not is_exporting():
                seen = shown.nonzero().squeeze(1)
                drawn_u, drawn_v, cell, share, log_level, cut_level, shown = (
                    one.index_select(0, seen) for one in (drawn_u, drawn_v, cell, share, log_level, cut_level, shown)
                )
                sample = None if sample is None else sample.index_select(0, seen)
        foot = _read(quantiles, cell, share)
        u = drawn_u * (width + 2 * reach_u) - (reach_u + 0.5)
        v = drawn_v * (height + 2 * reach_v) - (reach_v + 0.5)
        depth_m = foot * _own(focal, sample)
        stays = state.air.path_tangent is None and state.receiver.row_time_s is None
        if blocks is not None and stays and max(reach_u, reach_v) < BLOCK_PX and not self.camera.distorted:
            before = (depth_m < blocks.at(sample, u, v)[1]).nonzero().squeeze(1)
            if len(before) < 0.9 * len(u):
                u, v, foot, depth_m, log_level, cut_level, shown = (
                    one.index_select(0, before) for one in (u, v, foot, depth_m, log_level, cut_level, shown)
                )
                sample = None if sample is None else sample.index_select(0, before)
        own, focal_of = _own(intrinsics, sample), _own(focal, sample)
        x, y = self.undistorted(u, v, own)
        enlarged = mark_growth(x, y)
        if self.camera.distorted:
            scale = self.camera.magnification(x, y)
            enlarged = enlarged * scale
            log_level = torch.log(level.clamp_min(FLOOR)) + _read(most, cell, share)
            log_level = log_level + thinning + torch.log(scale)
            shown = (drawn_level < ABSENT) & (log_level < cut_level)
        if tables.banks is not None:
            # So far every place was the densest one: the rest of the slots' particles are not there.
            densest = _own(tables.banks.density.flatten(1).amax(1), sample)
            log_level = log_level + torch.log(densest / self._density(tables.banks, u, v, depth_m, own, sample))
            shown = shown & (log_level < cut_level)
        shown = shown & (depth_m >= self.near_m) & (depth_m <= self.far_m)
        if state.air.particle_reach_m is not None:
            shown = shown & (depth_m <= _own(state.air.particle_reach_m, sample))
        if part.copy and tables.count is not None:
            shown = shown & _own(tables.count > 1, sample)
        shown = shown & _own(tables.falls, sample)
        stop, above = _cell((log_level - t.log_level_low) / t.log_level_step, tables.outline_m.shape[1])
        outline_m = _read(tables.outline_m, stop, above, sample)
        speed = _read(tables.fall_speed, stop, above, sample)
        diameter = outline_m / foot * torch.sqrt(enlarged)
        if self.vertical and not part.slanted:
            motion_u, motion_v = None, speed * (self.optics.exposure_s * own[..., 1] / focal_of) / foot
        else:
            tangent = None if state.air.path_tangent is None else _own(state.air.path_tangent, sample)
            motion_u, motion_v = self._path_px(x, y, speed, depth_m, own, tangent)
        width_px, opacity = self._blurred(diameter, foot, depth_m)
        marks = Marks(
            sample=sample,
            u_px=u,
            v_px=v,
            motion_u_px=motion_u,
            motion_v_px=motion_v,
            width_px=width_px,
            opacity=torch.where(shown, opacity, torch.zeros_like(opacity)),
            depth_m=depth_m,
        )
        return marks if state.receiver.row_time_s is None else self._row_by_row(marks, state.receiver.row_time_s)

    def _density(
        self, banks: Banks, u: Tensor, v: Tensor, depth_m: Tensor, own: Tensor, sample: Tensor | None
    ) -> Tensor:
        """Density where each of the points is, ``(P,)``."""
        azimuth_rad, level = over_ground(self.camera, *self.undistorted(u, v, own))
        return banks.at_points(azimuth_rad, level * depth_m, sample).clamp_min(FLOOR)

    def _row_by_row(self, marks: Marks, row_time_s: Tensor) -> Marks:
        """Marks of a rolling shutter, which exposes each row later by ``row_time_s`` ``(B,)``.

        A particle that falls q rows while the shutter goes on by one meets the rows at ``v / (1 - q)``, v being where
        row 0's exposure finds it. Its path is longer by as much, and each of its pixels sees it as long as before.
        """
        row_s = _own(row_time_s, marks.sample)
        stretch = 1.0 / (1.0 - marks.motion_v_px * (row_s / self.optics.exposure_s)).clamp_min(SLOWEST)
        v_px = marks.v_px * stretch
        u_px, motion_u = marks.u_px, marks.motion_u_px
        if motion_u is not None:
            u_px = u_px + motion_u * (v_px * (row_s / self.optics.exposure_s))
            motion_u = motion_u * stretch
        return replace(
            marks,
            u_px=u_px,
            v_px=v_px,
            motion_u_px=motion_u,
            motion_v_px=marks.motion_v_px * stretch,
            opacity=marks.opacity * stretch,
        )

    def _path_px(
        self, x: Tensor, y: Tensor, speed: Tensor, depth_m: Tensor, own: Tensor, tangent: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Path of the exposure in pixels, from the velocity relative to the camera."""
        vx, vy, vz = (d * speed + w for d, w in zip(self.down, self.drift_m_per_s, strict=True))
        if tangent is not None:
            vx, vy, vz = (v + r * (speed * tangent) for v, r in zip((vx, vy, vz), self.right, strict=True))
        per_depth = self.optics.exposure_s / depth_m
        dx, dy = (vx - x * vz) * per_depth, (vy - y * vz) * per_depth
        if self.camera.distorted:
            xx, xy, yx, yy = self.camera.distortion_jacobian(x, y)
            dx, dy = xx * dx + xy * dy, yx * dx + yy * dy
        return dx * own[..., 0], dy * own[..., 1]

    def _blurred(self, diameter: Tensor, foot: Tensor, depth_m: Tensor) -> tuple[Tensor, Tensor]:
        """Width and peak of the disk after defocus and lens blur: second moments add, the area is conserved."""
        square = diameter.square()
        blurred = square + self.optics.lens_blur_px**2
        if self.optics.aperture_m > 0:
            focus = self.optics.focus_distance_m
            out_of_focus = 1.0 if math.isinf(focus) else (depth_m - focus).abs() / focus
            blurred = blurred + (self.optics.aperture_m / foot * out_of_focus).square()
        sharp = self.optics.aperture_m == 0 and self.optics.lens_blur_px == 0
        width = diameter if sharp else torch.sqrt(blurred)
        opacity = torch.ones_like(diameter) if sharp else square / blurred
        if self.optics.published_blend:
            opacity = opacity * (1 + diameter) / diameter
        return width, opacity

    def listed_depth(
        self,
        state: CameraState,
        noise: Mapping[str, Tensor],
        tables: AtRate,
        fog_per_m: Tensor | None = None,
        *,
        lit: bool = False,
    ) -> tuple[Tensor, Tensor | None]:
        """Optical depth of the listed particles, ``(B, 1, H, W)``.

        Args:
            state: the frame.
            noise: the stage's noise.
            tables: the tables at each sample's rate.
            fog_per_m: ``(B,)`` fog extinction; where given, the second result is the optical depth weighted with
                the fog's transmission to each particle.
            lit: weight with the light of lamps on each particle instead.
        """
        b, _, height, width = state.image.signal.shape
        depth = state.scene.depth_m.float().expand(b, 1, height, width)
        blocks = None if is_exporting() else DepthBlocks.of(depth)
        depth = depth.reshape(-1)
        # Shells add to these sums in turn, and the sums to each other: the same order on any number of threads.
        sums = 1 if is_exporting() else SUMS
        totals = [torch.zeros(b * height * width, device=depth.device, dtype=torch.float32) for _ in range(sums)]
        weighted = fog_per_m is not None or lit
        fadeds = [torch.zeros_like(total) if weighted else None for total in totals]

        def add(which: int) -> None:
            for number in range(len(self.tables.listed)):
                for portion, points, sample in self._portions(state, noise, number):
                    if (number + portion) % sums != which:
                        continue
                    for part in self._parts_of(state, points, sample, tables, number):
                        marks = self._marks(state, part, tables, number, blocks)
                        if lit:
                            marks = replace(marks, clearness=self._lamplight(marks, state))
                        elif fog_per_m is not None:
                            marks = replace(marks, clearness=self._clearness(marks, state, fog_per_m))
                        place = (marks, depth, (height, width))
                        if is_exporting():
                            footprint = self._footprint_px(number, slanted=part.slanted)
                            totals[which], fadeds[which] = add_static(totals[which], fadeds[which], *place, footprint)
                        else:
                            totals[which], fadeds[which] = add_listed(totals[which], fadeds[which], *place, blocks)

        tasks = [partial(add, which) for which in range(sums)]
        moved = (tables.outline_m, tables.count, state.air.path_tangent, state.receiver.row_time_s)
        learns = torch.is_grad_enabled() and any(value is not None and value.requires_grad for value in moved)
        if is_exporting() or learns:
            for task in tasks:
                task()
        else:
            side_by_side(tasks)
        total, faded = totals[0], fadeds[0]
        for more, more_faded in zip(totals[1:], fadeds[1:], strict=True):
            total = total + more if is_exporting() or learns else total.add_(more)
            faded = None if faded is None or more_faded is None else faded + more_faded
        shape = (b, 1, height, width)
        return total.view(shape), None if faded is None else faded.view(shape)

    def _clearness(self, marks: Marks, state: CameraState, fog_per_m: Tensor) -> Tensor:
        """Share of each particle's light that the fog lets through, along its ray."""
        fog, own = _own(fog_per_m, marks.sample), _own(state.scene.intrinsics.float(), marks.sample)
        x, y = self.undistorted(marks.u_px, marks.v_px, own)
        return torch.exp(-fog * marks.depth_m * torch.sqrt(1 + x.square() + y.square()))

    def lamp_values(self, state: CameraState) -> Tensor:
        """Luminance that a particle shows of lamps at the nodes of their light, ``(B, 1, K, h, w)``."""
        assert state.air.lamp_light is not None
        return state.air.lamp_light.drop if isinstance(self.weather, Rain) else state.air.lamp_light.flake

    def _lamplight(self, marks: Marks, state: CameraState) -> Tensor:
        """Luminance of each particle by lamps, units of saturation."""
        assert state.air.lamp_light is not None
        size = state.image.signal.shape[-2:]
        values = self.lamp_values(state).expand(state.batch, -1, -1, -1, -1)
        place = (marks.sample, marks.u_px, marks.v_px, marks.depth_m, (size[0], size[1]))
        return state.air.lamp_light.at_points(values, *place)

    def _footprint_px(self, number: int, *, slanted: bool = False) -> tuple[int, int]:
        """Rows and columns that hold any mark of the shell, for a graph of fixed footprint."""
        reach_u, reach_v = self.reach_px(number)
        upright = self.vertical and not slanted
        along = math.ceil(2 * reach_v) if upright else math.ceil(2 * max(reach_u, reach_v))
        if slanted:
            along = math.ceil(along * STEEPEST)
        return along + 1, math.ceil(self.width_max_px(number) * math.sqrt(1.0 if upright else 2.0)) + (
            2 if upright else 4
        )


def mark_growth(x: Tensor, y: Tensor) -> Tensor:
    """Area of a sphere's mark over that of the same sphere on the axis at the same depth, ``1 / cos(theta)``.

    It subtends ``pi D^2 cos^2(theta) / (4 Z^2)``, and a solid angle covers ``f^2 / cos^3(theta)`` of a plane
    (``PHYSICS.md`` 10.1).

    Args:
        x, y: undistorted normalised coordinates.
    """
    return torch.sqrt(1 + x.square() + y.square())


def _displaced(points: Tensor, copy: int) -> Tensor:
    """The same points elsewhere in the unit cube."""
    shift = points.new_tensor([copy * step for step in DISPLACED])
    columns = [COLUMN_U, COLUMN_V, COLUMN_DEPTH]
    moved = (points[:, columns] + shift) % 1.0
    return torch.cat([moved, points[:, COLUMN_LEVEL:]], 1)


def _own(values: Tensor, sample: Tensor | None) -> Tensor:
    """What belongs to each point's sample, of one row for each sample or one for all; rows are gathered at a cost."""
    return values[0] if sample is None or (not is_exporting() and len(values) == 1) else values[sample]


def _cell(position: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    cell = position.detach().floor().clamp(0, nodes - 2)
    return cell.long(), (position - cell).clamp(0.0, 1.0)


def _read(table: Tensor, cell: Tensor, share: Tensor, row: Tensor | None = None) -> Tensor:
    """``table (n,)``, or ``table (1 or B, n)`` at a row each, between the nodes ``cell`` and ``cell + 1``."""
    if row is None or (not is_exporting() and table.numel() == table.shape[-1]):
        at = cell
    else:
        at = row * table.shape[-1] + cell
    flat = table.reshape(-1)
    low = flat.index_select(0, at)
    return torch.lerp(low, flat.index_select(0, at + 1), share)
