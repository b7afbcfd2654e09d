"""Compiled path of the particle layer on the processor: what it covers, and its calls.

The same loops in C++ (g++ 12, -O3 -march=native) take 0.9 to 1.3 of the time of numba's: numba it is, and the wheel
stays pure Python. Results equal those of torch to rounding: sums of optical depth differ by their order, ln and exp
of the haze by 2e-7.

Features that stay with torch: lens distortion, patches and counts of particles, lamps, gradients, exported graphs,
devices other than the processor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.compiled_rows import NOTHING, bands_of, colour_rows, map_of
from torchweather.camera.particles.depth_blocks import BLOCK_PX
from torchweather.camera.particles.population import AtRate, Population
from torchweather.camera.particles.streaks import (
    BOX_OF_DISK,
    CHORD_SERIES,
    DISK_OF_BOX,
    FULL,
    MEAN_CHORD,
    SMALLEST_PX,
    WIDE_PX,
)
from torchweather.camera.state import CameraState
from torchweather.core.compiled import compiled_path, uses_compiled
from torchweather.core.random import ABSENT, normal_table
from torchweather.core.threads import side_by_side, threads_at_hand
from torchweather.pipeline.tiling import is_exporting

if TYPE_CHECKING:
    from torchweather.camera.particles.compiled_haze import HazeAxis, HazeTables, Noise
    from torchweather.camera.particles.compiled_marks import Lens, Motion, Nodes

__all__ = ["covers", "frame_behind", "haze_depth", "listed_depth", "rendered_by"]

BAND_PIXELS = 1 << 16  # of sums and depth, that stay in the cache
FEWEST_COLUMNS = 64  # of a band that has a thread of its own
RAY_NODES = 4  # lengths of ray per depth between which the haze's fading is interpolated
SLOWEST = 0.1  # of a rolling shutter relative to a particle, in rows

Array = NDArray[np.float32]


class _Shell(NamedTuple):
    """Points of a shell in bands of columns, where each band begins, and the arguments of ``add_points``."""

    points: Array
    begins: NDArray[np.int64]
    footprint: Array
    most: Array
    bound: Array
    outline_m: Array
    fall_speed: Array
    nodes: Nodes
    lens: Lens
    motion: Motion
    fog_per_m: float


def covers(population: Population, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate) -> bool:
    """True where the compiled path renders this population in this frame."""
    if is_exporting() or not uses_compiled():
        return False
    if population.camera.distorted or tables.count is not None or tables.banks is not None:
        return False
    scene, air = state.scene, state.air
    used = (
        *(state.image.signal, scene.depth_m, scene.intrinsics, scene.ray_per_depth, tables.outline_m),
        *(tables.haze_depth, tables.haze_variance, tables.bounds, *noise.values()),
        *(air.path_tangent, air.particle_reach_m, air.fog_extinction_per_m, state.receiver.row_time_s),
    )
    learns = torch.is_grad_enabled()
    return all(one is None or (one.device.type == "cpu" and not (learns and one.requires_grad)) for one in used)


def rendered_by(population: Population) -> str:
    """Name of the path that renders a population on the processor, with the reason where it is torch."""
    path = compiled_path()
    return "torch (lens distortion)" if path == "numba" and population.camera.distorted else path


def _array(values: Tensor) -> Array:
    """A tensor's values as float32 in row-major order."""
    array: Array = values.detach().float().contiguous().numpy()
    return array


def _of(values: Array, sample: int) -> Array:
    """The row of a sample, of one row for each or one for all."""
    row: Array = values[min(sample, len(values) - 1)]
    return row


def listed_depth(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    fog_per_m: Tensor | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Optical depth of the listed particles, as ``Population.listed_depth``.

    Every sample and band of columns is rendered by itself, and pixels add up in the order of the points: the result is
    the same on any number of threads.
    """
    totals, fadeds = _by_columns(population, state, noise, tables, fog_per_m)
    return _by_rows(totals), None if fadeds is None else _by_rows(fadeds)


def _by_columns(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    fog_per_m: Tensor | None = None,
) -> tuple[Array, Array | None]:
    """As ``listed_depth``, ``(B, W, H)``: one column after the other."""
    b, _, height, width = state.image.signal.shape
    falls = tables.falls.numpy()
    # One column after the other: the pixels of a falling mark lie together.
    totals = np.zeros((b, width, height), np.float32)
    fadeds = None if fog_per_m is None else np.zeros_like(totals)
    depths = [np.ascontiguousarray(depth.T) for depth in _array(state.scene.depth_m)[:, 0]]
    tasks = []
    band_columns = max(BAND_PIXELS // height, 1)  # of points; it depends on the frame alone
    bands = max(1, min(threads_at_hand() // b, width // FEWEST_COLUMNS))
    edges = [width * band // bands for band in range(bands + 1)]
    for sample in range(b):
        if not _of(falls, sample):
            continue
        shells = _shells(population, state, noise, tables, sample, fog_per_m, band_columns)
        into = (totals[sample], NOTHING if fadeds is None else fadeds[sample])
        for first, last in pairwise(edges):
            depth = depths[min(sample, len(depths) - 1)]
            tasks.append(partial(_add_shells, into, depth, shells, first, last))
    side_by_side(tasks)
    return totals, fadeds


def _by_rows(sums: Array) -> Tensor:
    return torch.from_numpy(np.stack([each.T for each in sums])[:, None])


def _shells(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    sample: int,
    fog_per_m: Tensor | None,
    band_columns: int,
) -> list[_Shell]:
    """Points in bands of columns and arguments of ``add_points`` for each shell of one sample."""
    from torchweather.camera.particles.compiled_marks import Nodes, in_bands

    p, t, width = population, population.tables, state.image.signal.shape[-1]
    lens, motion = _lens(p, state, sample), _motion(p, state, sample)
    far_m, reach_m = p.far_m, state.air.particle_reach_m
    if reach_m is not None:
        far_m = min(far_m, float(_of(_array(reach_m), sample)))
    thinning = math.log(p.focal_px * p.headroom() / lens.focal_px)
    outline, speed = _of(_array(tables.outline_m), sample), _of(_array(tables.fall_speed), sample)
    bounds = _of(_array(tables.bounds), sample)
    fog = 0.0 if fog_per_m is None else float(_of(_array(fog_per_m), sample))
    footprints, _, tails_most = t.at_listed_nodes
    shells = []
    for number in range(len(t.listed)):
        drawn = noise[f"{p.weather.kind}_shell_{number}"][sample]
        footprint, most = (one[number].astype(np.float32) for one in (footprints, tails_most))
        bound = bounds[number]
        # No level above this one is there at any depth.
        limit = min(math.exp(min(float((bound - most).max()) - thinning, 50.0)) * (1 + 1e-4), ABSENT)
        p.check_reach(drawn, number, limit, state.sizes)
        reach = p.reach_px(number)
        nodes = Nodes(*reach, p.near_m, far_m, t.log_level_low, t.log_level_step, thinning, limit)
        ordered, begins = in_bands(_array(drawn), limit, reach[0], width, band_columns)
        shells.append(_Shell(ordered, begins, footprint, most, bound, outline, speed, nodes, lens, motion, fog))
    return shells


def _lens(population: Population, state: CameraState, sample: int) -> Lens:
    from torchweather.camera.particles.compiled_marks import Lens

    fx, fy, cx, cy = (float(value) for value in _of(_array(state.scene.intrinsics), sample))
    o = population.optics
    blend = 1.0 if o.published_blend else 0.0
    optics = (o.exposure_s, o.aperture_m, o.focus_distance_m, o.lens_blur_px, blend)
    return Lens(fx, fy, cx, cy, math.sqrt(fx * fy), *(float(value) for value in optics))


def _motion(population: Population, state: CameraState, sample: int) -> Motion:
    """Velocity per fall speed and drift; a slanted path leans by its tangent, in fall speeds."""
    from torchweather.camera.particles.compiled_marks import Motion

    p, air = population, state.air
    tangent = 0.0 if air.path_tangent is None else float(_of(_array(air.path_tangent), sample))
    velocity = [down + right * tangent for down, right in zip(p.down, p.right, strict=True)]
    velocity += p.drift_m_per_s
    row_s = state.receiver.row_time_s
    row_share = 0.0 if row_s is None else float(_of(_array(row_s), sample)) / p.optics.exposure_s
    upright = 1.0 if p.vertical and tangent == 0.0 else 0.0
    return Motion._make([*velocity, row_share, upright])


def _add_shells(into: tuple[Array, Array], depth: Array, shells: list[_Shell], first: int, last: int) -> None:
    """Add all shells, band after band of points, to the columns ``first..last``."""
    from torchweather.camera.particles.compiled_marks import MarkShape, add_points, farthest_around

    constants = (BOX_OF_DISK, MEAN_CHORD, SMALLEST_PX, FULL, WIDE_PX, DISK_OF_BOX, SLOWEST)
    shape = MarkShape(*CHORD_SERIES, *constants)
    farthest = farthest_around(depth, BLOCK_PX)
    for band in range(len(shells[0].begins) - 1):
        for shell in shells:
            add_points(
                into[0],
                into[1],
                shell.points[shell.begins[band] : shell.begins[band + 1]],
                depth,
                farthest,
                BLOCK_PX,
                shell.footprint,
                shell.most,
                shell.bound,
                shell.outline_m,
                shell.fall_speed,
                shell.nodes,
                shell.lens,
                shell.motion,
                shape,
                shell.fog_per_m,
                first,
                last,
            )


def haze_depth(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    first: int,
    last: int,
    fog_per_m: Tensor | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Optical depth of the haze in the rows ``first..last``, as ``haze.haze_depth``."""
    from torchweather.camera.particles.compiled_haze import haze_rows

    t = population.tables
    b, _, _, width = state.image.signal.shape
    optical = torch.empty(b, 1, last - first, width)
    faded = None if fog_per_m is None else torch.empty_like(optical)
    rows = (..., slice(first, last), slice(None))
    depth, ray = _array(state.scene.depth_m[rows])[:, 0], _array(state.scene.ray_per_depth[rows])[:, 0]
    for sample in range(b):
        own, axis = _haze_of(population, state, tables, sample, longest=fog_per_m is not None)
        clear: Array = NOTHING
        if fog_per_m is not None:
            fog = float(_of(_array(fog_per_m), sample))
            clear = _clear_table(own.mean, t.log_footprint_low, t.log_footprint_step, axis.scale, axis.longest, fog)
        white, own_depth, own_ray = _noise_of(population, state, noise, sample), _of(depth, sample), _of(ray, sample)
        into = (optical.numpy()[sample, 0], NOTHING if faded is None else faded.numpy()[sample, 0])
        haze_rows(*into, white, own_depth, own_ray, clear, own, axis, first)
    return optical, faded


def _haze_of(
    population: Population, state: CameraState, tables: AtRate, sample: int, *, longest: bool = False
) -> tuple[HazeTables, HazeAxis]:
    """Tables of the haze of one sample; the length of the longest ray only where wanted."""
    from torchweather.camera.particles.compiled_haze import HazeAxis, HazeTables

    p, t = population, population.tables
    names = ("haze_depth", "haze_variance", "kernel_along", "kernel_across")
    mean, variance, along, across = (_of(_array(getattr(tables, name)), sample) for name in names)
    fx, fy = (float(value) for value in _of(_array(state.scene.intrinsics), sample)[:2])
    focal = math.sqrt(fx * fy)
    far_m, reach_m = p.far_m, state.air.particle_reach_m
    if reach_m is not None:
        far_m = min(far_m, max(float(_of(_array(reach_m), sample)), 1e-6))
    scaled = variance * np.float32(focal)
    lowest, highest = (
        np.array([scaled[place] for place in places])
        for places in zip(*((shell.first_node, shell.last_node) for shell in p.haze_shells), strict=True)
    )
    ray = float(state.scene.ray_per_depth.amax()) if longest else 1.0
    steep = 1.0 if p.haze_steep else 0.0
    axis = HazeAxis(focal, far_m, t.log_footprint_low, t.log_footprint_step, ray, float(p.haze_slope), steep)
    return HazeTables(mean, variance, along, across, lowest, highest), axis


def _noise_of(population: Population, state: CameraState, noise: Mapping[str, Tensor], sample: int) -> Noise:
    """White noise of the haze of one sample, in numbers or by its key."""
    from torchweather.camera.particles.compiled_haze import Noise

    given, height = noise[f"{population.weather.kind}_haze"][sample], state.image.signal.shape[-2]
    if given.dtype == torch.int64:
        return Noise(np.zeros((0, 0, 0), np.float32), given.numpy().view(np.uint64), normal_table(), height)
    return Noise(_array(given), np.zeros(2, np.uint64), normal_table(), height)


def frame_behind(
    population: Population, state: CameraState, noise: Mapping[str, Tensor], tables: AtRate, colour: Tensor
) -> tuple[Tensor, Tensor | None]:
    """The frame behind one kind of particles in clear air, and the covered share of the exposure where it is kept.

    Args:
        population, state, noise, tables: as of ``listed_depth``.
        colour: ``(B, 3)`` of the particles.
    """
    from torchweather.camera.particles.compiled_veil import veil_rows

    signal = state.image.signal.detach().contiguous()
    out = torch.empty_like(signal)
    b, _, height, width = signal.shape
    mask = torch.empty(b, 1, height, width) if state.receiver.keep_truth else None
    sharp, _ = _by_columns(population, state, noise, tables)
    light = colour_rows(state, colour.to(signal.dtype))
    scene, tasks = state.scene, []
    for sample in range(b):
        own, axis = _haze_of(population, state, tables, sample)
        kept = NOTHING if mask is None else mask[sample, 0].numpy()
        frame = (out[sample].numpy(), kept, signal[sample].numpy(), sharp[sample], light[sample])
        near, depth_m, ray = (map_of(one, sample) for one in (scene.near_mask, scene.depth_m, scene.ray_per_depth))
        one = partial(veil_rows, *frame, near, _noise_of(population, state, noise, sample), depth_m, ray)
        tasks += [partial(one, own, axis, first, last) for first, last in bands_of(height)]
    side_by_side(tasks)
    return out, mask


def _clear_table(mean: Array, low: float, step: float, focal: float, longest: float, fog_per_m: float) -> Array:
    """Haze per focal length weighted with the fog's transmission, ``(RAY_NODES, G)``; see ``haze._mean_clear``."""
    steps = np.diff(mean)
    middle_m = np.exp(low + step * (np.arange(len(steps)) + 0.5)) * focal
    length = 1 + (longest - 1) * np.linspace(0.0, 1.0, RAY_NODES)[:, None]
    clear = np.cumsum(steps * np.exp(-fog_per_m * length * middle_m), 1)
    return np.ascontiguousarray(np.pad(clear, ((0, 0), (1, 0))), dtype=np.float32)
