"""Population: one kind of particle in a camera's frustum, its draws and its optical depth per pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy as shallow_copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from torchweather.atmosphere.density_field import Banks
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.camera.fog import ground_rays, over_ground
from torchweather.camera.particles.depth_blocks import BLOCK_PX, DepthBlocks
from torchweather.camera.particles.image_motion import ImageMotion
from torchweather.camera.particles.streaks import Marks, add_listed, add_pairs
from torchweather.camera.particles.tables import MarkOptics, particle_tables
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.core.masks import compare, places_of
from torchweather.core.random import ABSENT, Variate
from torchweather.core.threads import side_by_side
from torchweather.pipeline.graph_operations import columns_at, parts_of, rows_as_columns, rows_at, shaped_as
from torchweather.pipeline.tiling import is_exporting

__all__ = ["Array", "AtRate", "Population"]

Array = np.ndarray[Any, np.dtype[np.float64]]

RATE_CAPACITY_MM_PER_H = {"rain": 100.0, "snow": 10.0}
FLOOR = 1e-30  # keeps logarithms finite where nothing falls
ROUNDING = 1 + 1e-4  # of a highest level: more than float32 can move it
SUMS = 4  # partial sums of the optical depth, filled side by side
POINTS_AT_ONCE = 1 << 16  # points of all shells whose arrays stay in the cache
POINTS_ON_DEVICE = 1 << 20  # on a GPU, which wants few operations
# By which a second use of the draw is displaced in column, row and depth: powers of the root of x^4 = x + 1.
DISPLACED = (0.8191725134, 0.6710436067, 0.5497004779)
SLOWEST = 0.1  # of a rolling shutter relative to a particle, in rows: beyond that its mark grows no longer
# Columns of a point: image column and row, depth, level.
COLUMN_U, COLUMN_V, COLUMN_DEPTH, COLUMN_LEVEL, COLUMNS = 0, 1, 2, 3, 4
BETWEEN_SHELLS = ABSENT + 1.0  # level of no point


@dataclass(frozen=True)
class _Points:
    """Points ``(P, 4)`` that are rendered alike.

    Args:
        sample: the sample they belong to, of each point in a graph; ``None`` where there is one sample.
        shell: the shell of each point, or the one that all of them belong to.
        slanted: whether paths lean although the camera stands upright in still air.
        copy: number of the displaced copy; its levels begin there.
    """

    points: Tensor
    sample: Tensor | int | None
    shell: Tensor | int
    slanted: bool = False
    copy: int = 0


@dataclass(frozen=True)
class AtRate:
    """The tables at each sample's rate.

    Args:
        bounds: ``(1 or B, shells, nodes)`` ln of the density of listed particles.
        outline_m, fall_speed: over the level.
        haze_depth, haze_variance: over the footprint.
        kernel_along, kernel_across: of each shell of the haze.
        falls: ``(B,)`` whether anything falls.
        count: ``(B,)`` particles at the densest place over those of the rate; ``None`` is 1.
        banks: where they are dense; ``None`` is everywhere alike.
        path_density: ``(B, 1, H, W)`` mean density in front of the scene; ``None`` likewise.
        at_once: how a graph reads the same tables; ``None`` elsewhere.
    """

    bounds: Tensor
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
    at_once: _AtOnce | None = None


@dataclass(frozen=True)
class _AtOnce:
    """Tables at one rate, each with what a straight line between its nodes needs.

    Args:
        bounds: ``(2, shells * nodes)`` those of ``AtRate``, then their steps to the next node.
        by_level: ``(4, nodes)`` outline and fall speed, then both one node further.
        by_footprint: ``(1, 4 * nodes)`` depth and variance of the haze, then their steps to the next node.
    """

    bounds: tuple[Tensor, Tensor]
    by_level: Tensor
    by_footprint: Tensor


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

    def of_samples(self, rows: Tensor) -> Population:
        """The same particles at the rates of some samples of a batch, ``rows`` ``(n,)``."""
        if self.rate_mm_per_h.numel() <= 1:
            return self
        other = shallow_copy(self)
        other._buffers = {**self._buffers, "rate_mm_per_h": self.rate_mm_per_h.reshape(-1)[rows]}
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
        self.taps_along, self.taps_across = textured.taps_along, textured.taps_across

    def _set_tables(self) -> None:
        t = self.tables
        self._keep("outline", t.log_outline_m)
        self._keep("speed", t.log_fall_speed)
        self._keep("depth_table", t.haze_depth)
        self.nearest_foot_m_per_px = tuple(math.exp(float(shell.log_footprint[0])) for shell in t.listed)
        # Tables over the footprint, read at each shell's own nodes, (..., shells, nodes).
        footprints, tails_at_cut, tails_most = t.at_listed_nodes
        self._keep("footprints", footprints)
        self._keep("tails_at_cut", tails_at_cut)
        self._keep("tails_most", tails_most)

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
        haze = Variate(f"{kind}_haze", "tabulated_normal", (len(self.haze_shells), "H", "W"))
        return (*points, haze)

    def variates_at_rate(self) -> tuple[Variate, ...]:
        """The same as far as the particles' own rates show them, at the camera's own focal length."""
        whole = self.variates()
        if self.camera.distorted or self.rate_mm_per_h.requires_grad or not self.rate_mm_per_h.numel():
            return whole
        tables = self.at_rate(self.rate_mm_per_h.numel())
        most: Tensor = self.tails_most  # type: ignore[assignment]
        above = (tables.bounds - most.float()).amax(-1).masked_fill(~tables.falls[:, None], -math.inf)
        limits = (above.amax(0).clamp_max(0.0).exp() * ROUNDING).clamp_max(1.0).tolist()
        shells = [replace(one, level_limit=limit) for one, limit in zip(whole[:-1], limits, strict=True)]
        return (*shells, whole[-1])

    def level_limits(self) -> Array:
        """ln of the highest level that is shown, ``(shells, rates)``, at the rates of the tables and the camera's own
        focal length; between two of them, a straight line over ln of the rate is no less than the limit there."""
        at_cut = self.tails_at_cut.double().cpu().numpy()  # type: ignore[operator]
        most = self.tails_most.double().cpu().numpy()  # type: ignore[operator]
        return np.asarray((at_cut - most).max(-1).T + math.log(ROUNDING))

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
        falls = rate > 0
        safe = torch.where(falls, rate, 1.0)
        position = (torch.log(safe) - self.tables.log_rate_low) / self.tables.log_rate_step
        cell = position.detach().floor().clamp(0.0, len(self.tables.tail_at_cut) - 2.0)
        share = position - cell  # beyond the ends: the end cells' power law
        index = cell.long()

        # Linear tables (optical depth, variance) follow the rate's power law below the first node.
        low = torch.exp(share.clamp_max(0.0) * self.tables.log_rate_step)
        if is_exporting():
            return self._at_one_rate(index, share, torch.where(falls, low, 0.0), falls, count)
        held = share.clamp_min(0.0)
        amount = falls.to(rate.dtype)[:, None]
        if count is not None:
            amount = amount * count.to(rate.dtype)[:, None]

        def between(table: Any, weight: Tensor) -> Tensor:
            weight = weight.reshape(-1, *[1] * (table.ndim - 1))
            found: Tensor = table.float()[index] * (1 - weight) + table.float()[index + 1] * weight
            return found

        return AtRate(
            between(self.tails_at_cut, share),
            torch.exp(between(self.outline, share)),
            torch.exp(between(self.speed, share)),
            between(self.depth_table, held) * amount * low[:, None],
            between(self.variance_table, held) * amount * low[:, None],
            between(self.along_table, held),
            between(self.across_table, held),
            falls,
            count,
        )

    def _at_one_rate(self, index: Tensor, share: Tensor, amount: Tensor, falls: Tensor, count: Tensor | None) -> AtRate:
        """``at_rate`` in few operations, as a graph of one rate holds it; each argument is ``(1,)``.

        Args:
            index, share: node of the rate, place behind it.
            amount: of the linear tables.
            falls, count: as in ``AtRate``.
        """
        given = (self.tails_at_cut, self.outline, self.speed, self.depth_table, self.variance_table)
        bounds, outline, speed, depth, variance = (cast(Tensor, one).float() for one in given)
        along, across = cast(Tensor, self.along_table), cast(Tensor, self.across_table)
        steep = [bounds, _steps(bounds), outline, speed, _next(outline), _next(speed)]
        flat = [depth, variance, _steps(depth), _steps(variance)]
        flat += [trimmed(along, self.taps_along), trimmed(across, self.taps_across)]
        sizes = [table[0].numel() for table in (*steep, *flat)]
        every = torch.cat([table.float().flatten(1) for table in (*steep, *flat)], 1)
        # Beyond the ends the steep tables go on, and the flat ones are held.
        least = every.new_tensor([-math.inf] * sum(sizes[: len(steep)]) + [0.0] * sum(sizes[len(steep) :]))
        low, high = rows_at(every, index), rows_at(every, index + 1)
        row = low + torch.maximum(share, least) * (high - low)
        cuts, levels, nodes = sizes[0], 4 * sizes[2], 4 * sizes[6]
        at, step, level, foot, *kernels = parts_of(row, [cuts, cuts, levels, nodes, *sizes[-2:]], 1)
        by_level = torch.exp(level).view(4, -1)
        linear = foot * (amount if count is None else amount * count.to(amount.dtype))
        each = linear.view(4, 1, -1)
        along, across = (one.view(1, len(self.haze_shells), -1) for one in kernels)
        return AtRate(
            at.view(1, *bounds.shape[1:]),
            by_level[:1],
            by_level[1:2],
            each[0],
            each[1],
            along,
            across,
            falls,
            count,
            at_once=_AtOnce((at, step), by_level, linear),
        )

    # ---- listed particles --------------------------------------------------------------------------------------

    def undistorted(self, u: Tensor, v: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor]:
        """Undistorted normalised coordinates of image positions, for intrinsics ``(..., 4)``."""
        fx, fy, cx, cy = (intrinsics[..., k] for k in range(4))
        return self.camera.undistort((u - cx) / fx, (v - cy) / fy)

    def marks(self, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate, number: int) -> Iterator[Marks]:
        """The particles of one listed shell as marks in the image, in portions.

        Absent particles are left out; while a graph is traced they stay, with opacity 0.
        """
        if is_exporting():
            for part in self._parts_of(state, self._every_point(state, noise, (number,)), tables):
                yield self._marks(state, part, tables, None)
            return
        for row in range(state.batch):
            for points in self._points_of(state, noise, tables, row, (number,)):
                for part in self._parts_of(state, points, tables):
                    yield self._marks(state, part, tables, None)

    def _every_point(self, state: CameraState, noise: Mapping[str, Tensor], shells: Sequence[int]) -> _Points:
        """All slots of neighbouring shells, as a graph has them, ``(4, P)``; an absent one of its own level between
        two shells.

        Raises:
            InputValueError: there are several samples.
        """
        if state.batch != 1:
            raise InputValueError(
                f"ParticleVeil: a graph holds one sample; got a batch of {state.batch}. Export with a batch of 1."
            )
        each = [noise[f"{self.weather.kind}_shell_{number}"] for number in shells]
        between = torch.full((1, 1, COLUMNS), BETWEEN_SHELLS, device=each[0].device)
        points = torch.cat([each[0], *(one for later in each[1:] for one in (between, later))], 1)
        points = points.reshape(-1, COLUMNS).to(state.image.signal.device)
        return _Points(rows_as_columns(points), None, shells[0])

    def _points_of(
        self,
        state: CameraState,
        noise: Mapping[str, Tensor],
        tables: AtRate,
        row: int,
        shells: Sequence[int],
    ) -> list[_Points]:
        """The points of some shells that can be there at the rate of a sample, one shell after the other, in portions.

        A portion holds points of one sample, so that a batch adds up as its elements do.
        """
        device = state.image.signal.device
        highest = self._highest_levels(state, tables, row)
        kept = []
        for number in shells:
            points = noise[f"{self.weather.kind}_shell_{number}"][row].to(device)
            self.check_reach(points, number, highest[number], state.sizes)
            # Of a slot that is not used, the level is ABSENT. Displaced copies go on where these levels end.
            low = compare(points[:, COLUMN_LEVEL], "<", min(highest[number], 0.5 * (1.0 + ABSENT)))
            count = int(low.sum())
            if bool(low[:count].all()):  # as drawn: in order of the levels
                kept.append(points[:count])
            else:
                kept.append(points.index_select(0, places_of(low)))
        counts = torch.tensor([len(points) for points in kept], device=device)
        shell = torch.repeat_interleave(torch.tensor(list(shells), device=device), counts)
        every = torch.cat(kept) if kept else torch.zeros(0, COLUMNS, device=device)
        sample = None if state.batch == 1 else row
        portion = POINTS_AT_ONCE if device.type == "cpu" else POINTS_ON_DEVICE
        return [
            _Points(every[start : start + portion], sample, shell[start : start + portion])
            for start in range(0, len(every), portion)
        ]

    def check_reach(self, points: Tensor, number: int, highest: float, sizes: Mapping[str, int]) -> None:
        """Raise where points that were drawn for a lower rate do not reach the levels of this one."""
        if len(points) and float(points[-1, COLUMN_LEVEL]) >= min(highest, 1.0):
            return
        slots = self.variates()[number].sample_shape(sizes)[0]
        if len(points) < slots:
            raise InputValueError(
                f"ParticleVeil: noise '{self.weather.kind}_shell_{number}' was drawn for a lower rate; it holds "
                f"{len(points)} of {slots} points. Draw at this rate, or without at_rate=True, which serves every rate."
            )

    def _highest_levels(self, state: CameraState, tables: AtRate, row: int) -> list[float]:
        """Of each shell: no particle of a higher level is there at any depth; infinite where that is not known."""
        if self.camera.distorted:
            return [math.inf] * len(self.tables.listed)
        bound = _row_of(tables.bounds.detach(), row)
        most: Tensor = self.tails_most  # type: ignore[assignment]
        highest = (bound - most.float()).amax(-1) - _own(self._thinning(state, tables).detach(), row)
        return (highest.clamp_max(50.0).exp() * ROUNDING).tolist()

    def _thinning(self, state: CameraState, tables: AtRate) -> Tensor:
        """ln of the slots' density over that of the particles, ``(1 or B,)``.

        The slots' density belongs to the camera's own focal length and to an undistorted lens.
        """
        intrinsics = state.scene.intrinsics.float()
        focal = torch.sqrt(intrinsics[:, 0] * intrinsics[:, 1])
        thin = math.log(self.focal_px * self.headroom()) - torch.log(focal)
        if tables.count is not None:
            thin = thin - torch.log(tables.count.float().clamp_min(FLOOR))
        return thin

    def _parts_of(self, state: CameraState, points: _Points, tables: AtRate) -> Iterator[_Points]:
        """Points that are rendered alike: as they are, then what exceeds the slots.

        A count above what the slots hold comes from displaced copies of the same points, whose levels go on.
        """
        tangent = state.air.path_tangent
        if tangent is not None and self.vertical:
            slanted = is_exporting() or bool(_own(tangent, _whole(points.sample)) != 0)
            points = replace(points, slanted=slanted)
        yield points
        count = tables.count
        if count is None or is_exporting():
            return
        row = _whole(points.sample)
        own = _own(count.detach(), row)
        if not bool(own > 1):
            return
        most: Tensor = self.tails_most  # type: ignore[assignment]
        focal = _own(torch.sqrt(state.scene.intrinsics[:, 0] * state.scene.intrinsics[:, 1]).detach().float(), row)
        room = (focal / self.focal_px) * (_row_of(tables.bounds.detach(), row) - most).amax(1).exp()  # (shells,)
        wanted = torch.ceil(own * room)
        for copy in range(1, int(wanted.max())):
            some = (wanted[points.shell] > copy).nonzero().squeeze(1)
            shell = points.shell[some] if isinstance(points.shell, Tensor) else points.shell
            moved = replace(points, points=_displaced(points.points[some], copy), shell=shell, copy=copy)
            yield moved

    def _marks(self, state: CameraState, part: _Points, tables: AtRate, blocks: DepthBlocks | None) -> Marks:
        t, points, sample, shell = self.tables, part.points, part.sample, part.shell
        height, width = state.image.signal.shape[-2:]
        intrinsics = state.scene.intrinsics.float()
        focal = torch.sqrt(intrinsics[:, 0] * intrinsics[:, 1])
        if part.copy:
            limit = torch.tensor(self._highest_levels(state, tables, _whole(sample)), device=points.device) - part.copy
            some = (points[:, COLUMN_LEVEL] < _of_shell(limit, shell)).nonzero().squeeze(1)
            points = points.index_select(0, some)
            shell = shell.index_select(0, some) if isinstance(shell, Tensor) else shell
        if is_exporting():
            # What is one number a point is (1, P).
            drawn_u, drawn_v, drawn_depth, drawn_level = parts_of(points, (1,) * COLUMNS)
            shell = torch.cumsum((drawn_level > ABSENT).long(), 1) + shell if len(self.tables.listed) > 1 else shell
        else:
            drawn_u, drawn_v, drawn_depth, drawn_level = points.T.contiguous()
        # A level below the cut's is a particle at this rate.
        thinning = _own(self._thinning(state, tables), sample)
        level = drawn_level + part.copy if part.copy else drawn_level
        quantiles: Tensor = self.footprints  # type: ignore[assignment]
        most: Tensor = self.tails_most  # type: ignore[assignment]
        nodes = quantiles.shape[-1]
        cell, share = _cell(drawn_depth * (nodes - 1), nodes)
        left_out = False  # what is not shown, in a graph
        if is_exporting():
            cut_level, most_level, foot, *reach = self._of_shells(tables, cell, share, shell)
        elif isinstance(shell, Tensor):
            cut_level = _read(_row_of(tables.bounds, _whole(sample)), cell, share, shell)
        else:
            cut_level = _read(tables.bounds[:, shell], cell, share, sample)
        if not is_exporting():
            most_level = _read(most.float(), cell, share, shell)
        if not self.camera.distorted:
            log_level = torch.log(level.clamp_min(FLOOR)) + most_level + thinning
            shown = compare(drawn_level, "<", ABSENT) & compare(log_level, "<", cut_level)
            if is_exporting():
                if tables.banks is None:
                    depth_m = foot * focal
                    shown = shown & self._in_range(depth_m) & tables.falls
                    left_out = True
                    every = torch.cat([drawn_u, drawn_v, log_level, foot, depth_m, *reach])
                    columns = parts_of(columns_at(every, _places(shown)), (1,) * (5 + len(reach)))
                    drawn_u, drawn_v, log_level, foot, depth_m, *reach = columns
            else:
                seen = places_of(shown)
                drawn_u, drawn_v, cell, share, log_level = (
                    one.index_select(0, seen) for one in (drawn_u, drawn_v, cell, share, log_level)
                )
                if tables.banks is not None:
                    cut_level = cut_level.index_select(0, seen)
                shown = shown.new_ones(len(seen))
                shell = shell.index_select(0, seen) if isinstance(shell, Tensor) else shell
        if not is_exporting():
            foot = _read(quantiles.float(), cell, share, shell)
            reach_u, reach_v = (_of_shell(reach, shell) for reach in self._reaches(points))
            reach = [2 * reach_u, reach_u + 0.5, 2 * reach_v, reach_v + 0.5]
        u = drawn_u * (width + reach[0]) - reach[1]
        v = drawn_v * (height + reach[2]) - reach[3]
        if not left_out:
            depth_m = foot * _own(focal, sample)
        stays = state.air.path_tangent is None and state.receiver.row_time_s is None
        if blocks is not None and stays and not self.camera.distorted:
            hidden = compare(depth_m, ">=", blocks.at(None, u, v)[1])
            small = torch.stack([reach.reshape(-1) for reach in self._reaches(points)]).amax(0) < BLOCK_PX
            before = places_of(~(hidden & _of_shell(small, shell)))
            if len(before) < 0.9 * len(u):
                u, v, foot, depth_m, log_level = (
                    one.index_select(0, before) for one in (u, v, foot, depth_m, log_level)
                )
                shown = shown.new_ones(len(before))
                if tables.banks is not None:
                    cut_level = cut_level.index_select(0, before)
        own, focal_of = _own(intrinsics, sample), _own(focal, sample)
        x, y = self.undistorted(u, v, own)
        enlarged = mark_growth(x, y)
        if self.camera.distorted:
            scale = self.camera.magnification(x, y)
            enlarged = enlarged * scale
            log_level = torch.log(level.clamp_min(FLOOR)) + most_level + thinning + torch.log(scale)
            shown = (drawn_level < ABSENT) & (log_level < cut_level)
        if tables.banks is not None:
            # So far every place was the densest one: the rest of the slots' particles are not there.
            densest = _own(tables.banks.density.flatten(1).amax(1), sample)
            log_level = log_level + torch.log(densest / self._density(tables.banks, u, v, depth_m, own, sample))
            shown = shown & (log_level < cut_level)
        if left_out:
            shown = depth_m.new_ones(1, dtype=torch.bool)
        elif is_exporting():
            shown = shown & self._in_range(depth_m)
        else:
            shown = shown & compare(depth_m, ">=", self.near_m) & compare(depth_m, "<=", self.far_m)
        if state.air.particle_reach_m is not None:
            shown = shown & (depth_m <= _own(state.air.particle_reach_m, sample))
        if part.copy and tables.count is not None:
            shown = shown & _own(tables.count > 1, sample)
        if not left_out:
            shown = shown & _own(tables.falls, sample)
        stop, above = _cell((log_level - t.log_level_low) / t.log_level_step, tables.outline_m.shape[1])
        if tables.at_once is not None:
            here, further = parts_of(columns_at(tables.at_once.by_level, stop), (2, 2))
            outline_m, speed = parts_of(here + above * (further - here), (1, 1))
        else:
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
            sample=sample if isinstance(sample, Tensor) else None,
            u_px=u,
            v_px=v,
            motion_u_px=motion_u,
            motion_v_px=motion_v,
            width_px=width_px,
            opacity=torch.where(shown, opacity, 0.0) if is_exporting() else opacity * shown,
            depth_m=depth_m,
        )
        row_time_s = state.receiver.row_time_s
        return marks if row_time_s is None else self._row_by_row(marks, _own(row_time_s, sample))

    def _in_range(self, depth_m: Tensor) -> Tensor:
        """True where a depth is one of the particles'."""
        return depth_m.clamp(self.near_m, self.far_m) == depth_m

    def _of_shells(self, tables: AtRate, cell: Tensor, share: Tensor, shell: Tensor | int) -> list[Tensor]:
        """Level of the cut, highest level, footprint, twice the reach and half a pixel more than the reach, of each
        point ``(1, P)`` of a graph, each as shaped; the reach along both axes."""
        quantiles: Tensor = self.footprints  # type: ignore[assignment]
        most: Tensor = self.tails_most  # type: ignore[assignment]
        nodes = quantiles.shape[-1]
        reaches = self._reaches(quantiles.float())
        widened = [value[:, None].expand(-1, nodes) for each in reaches for value in (2 * each, each + 0.5)]
        fixed = torch.stack([most.float(), quantiles.float()])
        further = torch.stack([*_steps(fixed), *widened]).flatten(1)
        assert tables.at_once is not None
        at, step = tables.at_once.bounds
        table = torch.cat([at, fixed.flatten(1), step, further])
        low, rise, *reach = parts_of(columns_at(table, shell * nodes + cell), (3, 3, *(1,) * len(widened)))
        return [*parts_of(low + share * rise, (1, 1, 1)), *reach]

    def _reaches(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """``reach_px`` of every shell, ``(shells,)`` each."""
        reach = [self.reach_px(number) for number in range(len(self.tables.listed))]
        across, along = zip(*reach, strict=True) if reach else ((), ())
        return like.new_tensor(across), like.new_tensor(along)

    def _density(
        self, banks: Banks, u: Tensor, v: Tensor, depth_m: Tensor, own: Tensor, sample: Tensor | int | None
    ) -> Tensor:
        """Density where each of the points is, ``(P,)``."""
        azimuth_rad, level = over_ground(self.camera, *self.undistorted(u, v, own))
        found = banks.at_points(azimuth_rad.reshape(-1), (level * depth_m).reshape(-1), sample)
        return found.reshape(u.shape).clamp_min(FLOOR)

    def _row_by_row(self, marks: Marks, row_s: Tensor) -> Marks:
        """Marks of a rolling shutter, which exposes each row later by ``row_s``, ``()`` or ``(P,)``.

        A particle that falls q rows while the shutter goes on by one meets the rows at ``v / (1 - q)``, v being where
        row 0's exposure finds it. Its path is longer by as much, and each of its pixels sees it as long as before.
        """
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
        opacity = diameter.new_ones(1 if is_exporting() else diameter.shape) if sharp else square / blurred
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
        if is_exporting():
            return self._every_depth(state, noise, tables, fog_per_m, lit=lit)
        if state.image.signal.device.type != "cpu":
            return self._depth_by_pairs(state, noise, tables, fog_per_m, lit=lit)
        b, _, height, width = state.image.signal.shape
        depth_m = state.scene.depth_m.float()
        blocks, by_columns = DepthBlocks.of(depth_m), depth_m.transpose(-1, -2).flatten(1)
        points = [self._points_of(state, noise, tables, row, range(len(self.tables.listed))) for row in range(b)]
        moved = (tables.outline_m, tables.count, state.air.path_tangent, state.receiver.row_time_s)
        learns = torch.is_grad_enabled() and any(value is not None and value.requires_grad for value in moved)
        weighted = fog_per_m is not None or lit
        # Portions add to these sums in turn, and the sums to each other: the same order on any number of threads.
        # They hold one column after the other: a falling mark lies together.
        sums = max(1, min(SUMS, max((len(portions) for portions in points), default=0)))
        totals = [torch.zeros(b, height * width, device=depth_m.device) for _ in range(sums)]
        fadeds = [torch.zeros_like(total) if weighted else None for total in totals]

        def add(row: int, which: int) -> None:
            total, whole_faded = totals[which][row], fadeds[which]
            faded = None if whole_faded is None else whole_faded[row]
            own_depth = by_columns[row if len(by_columns) > 1 else 0]
            own_blocks = blocks.of_sample(row)
            for portion in points[row][which::sums]:
                for part in self._parts_of(state, portion, tables):
                    marks = self._marks(state, part, tables, own_blocks)
                    marks = self._through_the_air(marks, state, part.sample, fog_per_m, lit=lit)
                    add_listed(total, faded, marks, own_depth, (height, width), own_blocks, by_columns=True)

        tasks = [partial(add, row, which) for row in range(b) for which in range(min(sums, len(points[row])))]
        if learns:
            for task in tasks:
                task()
        else:
            side_by_side(tasks)
        total, faded = totals[0], fadeds[0]
        for more, more_faded in zip(totals[1:], fadeds[1:], strict=True):
            total = total + more if learns else total.add_(more)
            faded = None if faded is None or more_faded is None else faded + more_faded

        def by_rows(sum_by_columns: Tensor) -> Tensor:
            return sum_by_columns.view(b, 1, width, height).transpose(-1, -2).contiguous()

        return by_rows(total), None if faded is None else by_rows(faded)

    def _depth_by_pairs(
        self, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate, fog_per_m: Tensor | None, *, lit: bool
    ) -> tuple[Tensor, Tensor | None]:
        """``listed_depth`` by one list of (mark, pixel) pairs a portion: the few operations that a GPU waits for."""
        b, _, height, width = state.image.signal.shape
        depth_m = state.scene.depth_m.float()
        blocks, flat = DepthBlocks.of(depth_m), depth_m.flatten(1)
        totals, fadeds = [], []
        for row in range(b):
            own_depth = flat[row if len(flat) > 1 else 0]
            total = torch.zeros_like(own_depth)[None]
            faded = torch.zeros_like(total) if fog_per_m is not None or lit else None
            for portion in self._points_of(state, noise, tables, row, range(len(self.tables.listed))):
                for part in self._parts_of(state, portion, tables):
                    marks = self._marks(state, part, tables, blocks.of_sample(row))
                    marks = self._through_the_air(marks, state, part.sample, fog_per_m, lit=lit)
                    total, faded = add_pairs(total, faded, marks.as_row(), own_depth[None], (height, width))
            totals.append(total)
            fadeds += [] if faded is None else [faded]
        shape = (b, 1, height, width)
        return torch.stack(totals).view(shape), torch.stack(fadeds).view(shape) if fadeds else None

    def _through_the_air(
        self, marks: Marks, state: CameraState, sample: Tensor | int | None, fog_per_m: Tensor | None, *, lit: bool
    ) -> Marks:
        """Marks with the light that reaches the camera from them: of lamps, or through fog."""
        if lit:
            return replace(marks, clearness=self._lamplight(marks, state, sample))
        if fog_per_m is not None:
            return replace(marks, clearness=self._clearness(marks, state, fog_per_m, sample))
        return marks

    def _every_depth(
        self, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate, fog_per_m: Tensor | None, *, lit: bool
    ) -> tuple[Tensor, Tensor | None]:
        """``listed_depth`` of every slot of one sample, of all shells in one pass, as a graph holds it."""
        height, width = state.image.signal.shape[-2:]
        depth_m = state.scene.depth_m.float()
        depth = depth_m.reshape(1, -1)
        total = torch.zeros_like(depth)
        faded = torch.zeros_like(total) if fog_per_m is not None or lit else None
        every = self._every_point(state, noise, range(len(self.tables.listed)))
        for part in self._parts_of(state, every, tables):
            marks = self._marks(state, part, tables, None)
            marks = self._through_the_air(marks, state, part.sample, fog_per_m, lit=lit)
            total, faded = add_pairs(total, faded, marks, depth, (height, width))
        return shaped_as(total, depth_m), None if faded is None else shaped_as(faded, depth_m)

    def _clearness(self, marks: Marks, state: CameraState, fog_per_m: Tensor, sample: Tensor | int | None) -> Tensor:
        """Share of each particle's light that the fog lets through, along its ray."""
        fog, own = _own(fog_per_m, sample), _own(state.scene.intrinsics.float(), sample)
        x, y = self.undistorted(marks.u_px, marks.v_px, own)
        return torch.exp(-fog * marks.depth_m * torch.sqrt(1 + x.square() + y.square()))

    def lamp_values(self, state: CameraState) -> Tensor:
        """Luminance that a particle shows of lamps at the nodes of their light, ``(B, 1, K, h, w)``."""
        assert state.air.lamp_light is not None
        return state.air.lamp_light.drop if isinstance(self.weather, Rain) else state.air.lamp_light.flake

    def _lamplight(self, marks: Marks, state: CameraState, sample: Tensor | int | None) -> Tensor:
        """Luminance of each particle by lamps, units of saturation."""
        assert state.air.lamp_light is not None
        size = state.image.signal.shape[-2:]
        values = self.lamp_values(state).expand(state.batch, -1, -1, -1, -1)
        u_px, v_px, depth_m = (each.reshape(-1) for each in (marks.u_px, marks.v_px, marks.depth_m))
        found = state.air.lamp_light.at_points(values, sample, u_px, v_px, depth_m, (size[0], size[1]))
        return found.reshape(marks.u_px.shape)


def trimmed(table: Tensor, taps: tuple[int, ...]) -> Tensor:
    """Weights ``(..., J, 2 most + 1)`` of a kernel ``(..., J, weights)`` as far as each shell's taps count."""
    most, middle = max(taps), table.shape[-1] // 2
    own = table[..., middle - most : middle + most + 1]
    counts = np.abs(np.arange(-most, most + 1)) <= np.array(taps)[:, None]
    return own * torch.from_numpy(counts.astype(np.float32)).to(own)


def _steps(table: Tensor) -> Tensor:
    """From each node of a table ``(..., nodes)`` to the next; 0 at the last one."""
    return pad(table[..., 1:] - table[..., :-1], (0, 1))


def _next(table: Tensor) -> Tensor:
    """A table ``(..., nodes)`` one node further; the last one twice."""
    return torch.cat([table[..., 1:], table[..., -1:]], -1)


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


def _own(values: Tensor, sample: Tensor | int | None) -> Tensor:
    """Values of each point's sample, from one row for each sample or one for all; rows are gathered at a cost."""
    if is_exporting() and len(values) == 1:  # of one sample, and broadcast
        return values
    if sample is None or isinstance(sample, int):
        return _row_of(values, sample or 0)
    return values[0] if not is_exporting() and len(values) == 1 else values[sample]


def _row_of(values: Tensor, row: int) -> Tensor:
    """Values of one sample, from one row for each sample or one for all."""
    return values[row if len(values) > 1 else 0]


def _places(mask: Tensor) -> Tensor:
    """Places ``(1, n)`` where a mask ``(1, P)`` is true."""
    return torch.nonzero(mask).T[1:]


def _whole(sample: Tensor | int | None) -> int:
    """Number of the one sample that points belong to."""
    assert not isinstance(sample, Tensor)
    return sample or 0


def _of_shell(values: Tensor, shell: Tensor | int) -> Tensor:
    """A value of each shell ``(shells,)`` at each point's."""
    return values[shell] if isinstance(shell, int) else _at(values, shell)


def _cell(position: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    cell = position.detach().floor().clamp(0.0, nodes - 2.0)
    whole = cell.long() if is_exporting() else cell.int().long()  # to int first: half of the time
    return whole, (position - cell).clamp(0.0, 1.0)


def _at(values: Tensor, place: Tensor) -> Tensor:
    """Entries of ``(n,)`` at places ``(P,)``, in a graph ``(1, P)``, by what is fast in torch or in a graph."""
    if is_exporting():
        return (values if values.ndim == 2 else values[None]).gather(1, place)
    return values.index_select(0, place)


def _read(table: Tensor, cell: Tensor, share: Tensor, row: Tensor | int | None = None) -> Tensor:
    """``table (n,)``, or ``table (1 or more, n)`` at a row for each or for all, between ``cell`` and ``cell + 1``."""
    if isinstance(row, Tensor) and (is_exporting() or table.numel() > table.shape[-1]):
        at, flat = row * table.shape[-1] + cell, table.reshape(-1)
    elif is_exporting() or table.ndim == 1:
        at, flat = cell, table
    else:
        at, flat = cell, _row_of(table, row if isinstance(row, int) else 0)
    low, high = _at(flat, at), _at(flat, at + 1)
    return low + share * (high - low) if is_exporting() else torch.lerp(low, high, share)
