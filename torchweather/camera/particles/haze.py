"""Haze: the optical depth of particles too faint or too many to be drawn one by one.

A depth-shell shot-noise field. Its mean and variance are those of the particles between the near limit and the
scene, exactly; each shell of depth has its own noise map, correlated as its streaks are; the marginal is
log-normal, so it is positive and skewed like shot noise.

Off the axis every mark covers 1 / cos(theta) of its area on the axis (``PHYSICS.md`` 10.1). The marks of the haze are
smaller than a pixel, so that its mean grows by 1 / cos(theta) and its variance by the square of it: by that to the
power 1.98 to 2.00 for rain, 1.89 to 2.00 for snow, computed from the marks of a pinhole and of a lens.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.night.lamp_light import NEAREST_M
from torchweather.camera.particles.haze_convolution import streaky_maps
from torchweather.camera.state import CameraState
from torchweather.pipeline.graph_operations import columns_at, entries_at, parts_of, shaped_as
from torchweather.pipeline.tiling import is_exporting, rows_of

if TYPE_CHECKING:
    from torchweather.camera.particles.population import AtRate, Population

__all__ = ["focal_px", "haze_depth", "rows_beside", "variance_before"]

LEAST = 1e-16  # optical depth and variance below which the haze does not fluctuate
FLOOR = 1e-30
RAY_NODES = 4  # lengths of ray per depth between which the haze's fading is interpolated


def haze_depth(
    population: Population,
    state: CameraState,
    noise: Mapping[str, Tensor],
    tables: AtRate,
    first: int,
    last: int,
    fog_per_m: Tensor | None = None,
    *,
    lit: bool = False,
) -> tuple[Tensor, Tensor | None]:
    """Optical depth of a population's haze in the rows ``first..last`` of the frame.

    Args:
        population: the particles.
        state: the frame.
        noise: the stage's noise.
        tables: the population's tables at each sample's rate.
        first, last: rows.
        fog_per_m: ``(B,)`` fog extinction.
        lit: weight with the light of lamps on the particles instead.

    Returns:
        Optical depth ``(B, 1, rows, W)`` and, with fog, the same weighted with the fog's transmission.
    """
    b, _, _, width = state.image.signal.shape
    focal = focal_px(state)
    # What all samples have in common, such as one depth map and one rate, is looked up once.
    scale = focal if is_exporting() else focal.view(-1, 1, 1, 1)
    depth_m = rows_of(state.scene.depth_m, first, last).float()
    node = _node(population, state, depth_m, scale)
    read = _reader(node, tables.haze_depth.shape[1])
    if tables.at_once is not None:
        every = tables.at_once.by_footprint * scale
        on_axis, variance = (shaped_as(one, state.scene.depth_m) for one in _read_at_once(node, every))
    else:
        on_axis, variance = (one * scale for one in read(tables.haze_depth, tables.haze_variance))
    ray = rows_of(state.scene.ray_per_depth, first, last).float()

    fields = noise[f"{population.weather.kind}_haze"].to(state.image.signal.device)  # (B, J, H, W)
    if tables.at_once is not None:
        maps = streaky_maps(fields, tables, population)
        deviation = _deviation_at_once(every, variance, maps, population)
    else:
        deviation = _deviation(population, tables, variance, fields, first, last, scale)
    mean = on_axis
    if tables.path_density is not None:
        denser = rows_of(tables.path_density, first, last)
        mean, variance, deviation = mean * denser, variance * denser, deviation * denser.clamp_min(0.0).sqrt()
    # -ln(1 - m) has the mean of m plus half of its variance: the mean transmission stays exp(-mean). Off the axis the
    # mean grows by the ray, and variance and deviation by its square and by it: in ln they cancel.
    everywhere = not is_exporting() and bool(mean.amin() > LEAST) and bool(variance.amin() > LEAST)
    if everywhere:
        centre = torch.addcmul(mean, variance, ray, value=0.5)
    else:
        there = (mean > LEAST) & (variance > LEAST)
        variance = torch.where(there, variance, 1.0)
        centre = torch.where(there, mean, 1.0) + 0.5 * variance * ray
    spread = torch.log1p(variance / centre.square())
    power = torch.sqrt(spread / variance) * deviation - 0.5 * spread
    optical = centre * torch.exp(power)
    if not everywhere:
        optical = torch.where(there, optical, mean)
    optical = optical * ray
    if lit:
        return optical, optical * _mean_lamplight(population, state, tables, depth_m, focal, first, last)
    if fog_per_m is None:
        return optical, None
    longest = state.scene.ray_per_depth.flatten().amax(0).float()
    clear = _mean_clear(population, tables, read, ray.expand(b, 1, last - first, width), longest, focal, fog_per_m)
    return optical, optical * clear * scale / on_axis.clamp_min(FLOOR)


def variance_before(population: Population, state: CameraState, tables: AtRate, depth_m: Tensor) -> Tensor:
    """Variance of the haze's optical depth on the axis before a scene, as ``haze_depth`` finds it.

    Args:
        population, state, tables: as of ``haze_depth``.
        depth_m: ``(1 or B, 1, ...)`` of the scene.
    """
    scale = focal_px(state).view(-1, 1, 1, 1)
    (found,) = _reader(_node(population, state, depth_m.float(), scale), tables.haze_variance.shape[1])(
        tables.haze_variance
    )
    return found * scale


def focal_px(state: CameraState) -> Tensor:
    """Mean focal length, px, ``(1 or B,)``."""
    intrinsics = state.scene.intrinsics.float()
    return torch.sqrt(intrinsics[:, 0] * intrinsics[:, 1])


def _node(population: Population, state: CameraState, depth_m: Tensor, scale: Tensor) -> Tensor:
    """Place of a depth in the tables over the footprint."""
    t = population.tables
    depth_m = depth_m.clamp(1e-6, population.far_m)
    if state.air.particle_reach_m is not None:
        depth_m = torch.minimum(depth_m, state.air.particle_reach_m.float().clamp_min(1e-6).view(-1, 1, 1, 1))
    return (torch.log(depth_m / scale) - t.log_footprint_low) / t.log_footprint_step


def rows_beside(population: Population, number: int) -> int:
    """Rows of a shell's white noise above and below a row that it takes."""
    if population.haze_steep:
        return population.taps_along[number]
    lean = math.ceil(population.taps_along[number] * abs(population.haze_slope))
    return population.taps_across[number] + lean


def _reader(node: Tensor, nodes: int) -> Callable[..., list[Tensor]]:
    """Interpolates tables ``(1 or B, nodes)`` at fractional node numbers ``(1 or B, 1, rows, W)``, the ends held."""
    if is_exporting():
        return _reader_of_graph(node, nodes)
    cell = node.detach().floor().clamp(0.0, nodes - 2.0)
    share = (node - cell).clamp(0.0, 1.0)
    place = cell.int()

    def read(table: Tensor) -> Tensor:
        at = place
        if len(table) > 1:
            row = torch.arange(table.shape[0], device=node.device, dtype=torch.int32)
            at = at + (row * nodes).view(-1, 1, 1, 1)
        step = torch.nn.functional.pad(table[:, 1:] - table[:, :-1], (0, 1))
        low, rise = (one.reshape(-1).index_select(0, at.reshape(-1)).view(at.shape) for one in (table, step))
        return low + share * rise

    return lambda *tables: [read(table) for table in tables]


def _reader_of_graph(node: Tensor, nodes: int) -> Callable[..., list[Tensor]]:
    """``_reader`` of tables of one sample, which are read together."""
    share, place = _between_nodes(node, nodes)

    def read(*tables: Tensor) -> list[Tensor]:
        every = torch.cat(tables)
        low, high = columns_at(every, place), columns_at(every, place + 1)
        return [shaped_as(one, node) for one in parts_of(low + share * (high - low), (1,) * len(tables))]

    return read


def _read_at_once(node: Tensor, every: Tensor) -> list[Tensor]:
    """Depth and variance of the haze, each ``(1, pixels)``, from ``(1, 4 * nodes)`` of both and then their steps."""
    share, place = _between_nodes(node, every.shape[1] // 4)
    low, rise = parts_of(columns_at(every.view(4, -1), place), (2, 2))
    return parts_of(low + share * rise, (1, 1))


def _between_nodes(node: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """Place behind a node, 0 to 1, and the node's number, ``(1, pixels)``."""
    flat = node.reshape(1, -1)
    cell = flat.floor().clamp(0.0, nodes - 2.0)
    return (flat - cell).clamp(0.0, 1.0), cell.long()


def _deviation(
    population: Population,
    tables: AtRate,
    variance: Tensor,
    fields: Tensor,
    first: int,
    last: int,
    scale: Tensor,
) -> Tensor:
    """Sum of the shells' noise maps, each with the variance of its part in front of the scene."""
    total = torch.zeros_like(variance)
    learns = variance.requires_grad  # the root's gradient at 0 is infinite
    most = variance.detach().flatten(1).amax(1)
    for number, shell in enumerate(population.haze_shells):
        low, high = tables.haze_variance[:, shell.first_node], tables.haze_variance[:, shell.last_node]
        low, high = (end.view(-1, 1, 1, 1) * scale for end in (low, high))
        if not bool((most > low.detach().flatten()).any()):
            continue  # nowhere does the shell reach into the air before the scene
        smooth = _streaky(fields, tables, first, last, population, number)
        if learns:
            inside = torch.minimum(variance, high) - low
            positive = inside > 0
            root = torch.sqrt(torch.where(positive, inside, torch.ones_like(inside)))
            root = torch.where(positive, root, torch.zeros_like(root))
            total = total + root * smooth
        else:
            root = torch.clamp(variance, low, high).sub_(low).sqrt_()
            total = torch.addcmul(total, root, smooth)
    return total


def _deviation_at_once(every: Tensor, variance: Tensor, maps: Tensor, population: Population) -> Tensor:
    """``_deviation`` of all shells in few operations, of their maps ``(1, J, H, W)`` and the tables of a graph."""

    def at_ends(nodes: list[int]) -> Tensor:
        place = torch.from_numpy(np.array(nodes)).to(variance.device) + every.shape[1] // 4
        return entries_at(every, place[:, None, None])

    low = at_ends([shell.first_node for shell in population.haze_shells])
    high = at_ends([shell.last_node for shell in population.haze_shells])
    inside = torch.minimum(variance, high) - low
    return (inside.clamp_min(0.0).sqrt() * maps).sum(1, keepdim=True)


def _mean_clear(
    population: Population,
    tables: AtRate,
    read: Callable[..., list[Tensor]],
    ray: Tensor,
    longest: Tensor,
    focal: Tensor,
    fog_per_m: Tensor,
) -> Tensor:
    """Haze per focal length weighted with the fog's transmission along the ray to it, ``(B, 1, rows, W)``.

    Summed over depth for a few lengths of ray per depth, and interpolated between them.
    """
    t = population.tables
    steps = tables.haze_depth[:, 1:] - tables.haze_depth[:, :-1]
    middle = torch.arange(steps.shape[1], device=steps.device) + 0.5
    middle_m = torch.exp(t.log_footprint_low + t.log_footprint_step * middle) * focal[:, None]
    place = (ray - 1) / (longest - 1).clamp_min(1e-6) * (RAY_NODES - 1)
    total = torch.zeros_like(ray)
    for node in range(RAY_NODES):
        length_m = middle_m * (1 + (longest - 1) * node / (RAY_NODES - 1))
        clear = torch.cumsum(steps * torch.exp(-fog_per_m[:, None] * length_m), 1)
        near = (1 - (place - node).abs()).clamp_min(0)
        (found,) = read(torch.nn.functional.pad(clear, (1, 0)))
        total = total + near * found
    return total


def _mean_lamplight(
    population: Population, state: CameraState, tables: AtRate, depth_m: Tensor, focal: Tensor, first: int, last: int
) -> Tensor:
    """Mean luminance by lamps of the haze in front of the scene, weighted with its optical depth, ``(B, 1, rows, W)``.

    On the coarse grid of the lamps' light, whose nodes are summed one behind the other.
    """
    light = state.air.lamp_light
    assert light is not None
    t = population.tables
    values = population.lamp_values(state).expand(state.batch, -1, -1, -1, -1).to(depth_m.device)
    nodes = values.shape[2]
    span = math.log(light.far_m / NEAREST_M)
    node_m = NEAREST_M * torch.exp(torch.linspace(0.0, span, nodes, device=depth_m.device))
    place = (torch.log(node_m / focal[:, None]) - t.log_footprint_low) / t.log_footprint_step
    rows = tables.haze_depth.expand(place.shape[0], -1)
    optical = torch.stack([_at_nodes(row, own) for row, own in zip(rows, place, strict=True)])
    steps = (optical[:, 1:] - optical[:, :-1]).clamp_min(0.0)[:, None, :, None, None]
    between = 0.5 * (values[:, :, 1:] + values[:, :, :-1])
    pad = (0, 0, 0, 0, 1, 0)
    lit = torch.nn.functional.pad(torch.cumsum(steps * between, 2), pad)
    whole = torch.nn.functional.pad(torch.cumsum(steps, 2), pad)
    mean = torch.where(whole > FLOOR, lit / whole.clamp_min(FLOOR), values)
    depth = state.scene.depth_m.float().clamp_max(population.far_m).expand(state.batch, -1, -1, -1)
    return light.seen(mean, depth)[..., first:last, :]


def _at_nodes(row: Tensor, place: Tensor) -> Tensor:
    """A table ``(n,)`` at fractional node numbers, the ends held."""
    cell = place.floor().clamp(0, len(row) - 2)
    low, high = row[cell.long()], row[cell.long() + 1]
    return low + (place - cell).clamp(0.0, 1.0) * (high - low)


def _streaky(noise: Tensor, tables: AtRate, first: int, last: int, population: Population, number: int) -> Tensor:
    """White noise of one shell, of ``(B, J, H, W)``, with the correlation of its streaks, rows ``first..last``.

    Streaks run along the rows' direction (down the image) where ``haze_steep``, else along the columns', and drift
    aside by ``haze_slope`` pixels per step. The maps repeat at the frame's edges.
    """
    shell = slice(number, number + 1)
    along, across = tables.kernel_along[:, shell], tables.kernel_across[:, shell]
    taps_along, taps_across = population.taps_along[number], population.taps_across[number]
    slope, beside = population.haze_slope, rows_beside(population, number)
    band = _row_window(noise[:, shell], first - beside, last + beside)
    if population.haze_steep:
        return _along_columns(_along_rows(band, along, slope, taps_along), across, 0.0, taps_across)
    return _along_columns(_along_rows(band, across, 0.0, taps_across), along, slope, taps_along)


def _along_rows(band: Tensor, kernel: Tensor, slope: float, taps: int | None = None) -> Tensor:
    """Weighted sum over neighbouring rows; the band loses ``taps`` rows at each end.

    Args:
        band: ``(B, J, rows, W)``, which repeats along its columns.
        kernel: ``(B, J, weights)``.
        slope: columns per row.
        taps: how far the kernel counts to either side; ``None`` takes all of it.
    """
    # kornia.filters.filter2d: 1.5 times the time at 1920 x 1080 (2.3 against 1.6 ms), and nothing for the slope
    reach = kernel.shape[-1] // 2 if taps is None else taps
    rows = band.shape[-2] - 2 * reach

    def part(tap: int) -> Tensor:
        along = band[..., reach + tap : reach + tap + rows, :]
        return _blend(tap * slope, lambda shift: torch.roll(along, -shift, -1) if shift else along)

    return _weighted(part, kernel, reach)


def _along_columns(band: Tensor, kernel: Tensor, slope: float, taps: int) -> Tensor:
    """Weighted sum over neighbouring columns; with a slope, the band loses the rows of its lean at each end."""
    lean = math.ceil(taps * abs(slope))
    rows, width = band.shape[-2] - 2 * lean, band.shape[-1]

    def part(tap: int) -> Tensor:
        rolled = torch.roll(band, -tap, -1) if tap else band
        return _blend(tap * slope, lambda shift: rolled[..., lean + shift : lean + shift + rows, :])

    if slope or taps >= width or kernel.requires_grad or band.requires_grad:
        return _weighted(part, kernel, taps)
    # In place, and what goes beyond an edge to the other one.
    middle = kernel.shape[-1] // 2
    total = band * kernel[:, :, middle, None, None]
    for tap in range(1, taps + 1):
        before, after = kernel[:, :, middle - tap, None, None], kernel[:, :, middle + tap, None, None]
        total[..., tap:].addcmul_(band[..., :-tap], before)
        total[..., :tap].addcmul_(band[..., -tap:], before)
        total[..., :-tap].addcmul_(band[..., tap:], after)
        total[..., -tap:].addcmul_(band[..., :tap], after)
    return total


def _weighted(part: Callable[[int], Tensor], kernel: Tensor, taps: int) -> Tensor:
    """Sum of shifted maps ``part(-taps..taps)`` with the weights of a kernel ``(B, J, weights)``."""
    middle = kernel.shape[-1] // 2
    total = part(0) * kernel[:, :, middle, None, None]
    learns = total.requires_grad
    for tap in range(1, taps + 1):
        for way in (-tap, tap):
            weight = kernel[:, :, middle + way, None, None]
            total = torch.addcmul(total, part(way), weight) if learns else total.addcmul_(part(way), weight)
    return total


def _blend(shift: float, shifted: Callable[[int], Tensor]) -> Tensor:
    """Noise shifted by a fraction of a pixel: weights of equal energy, so that its variance stays."""
    whole = math.floor(shift)
    share = shift - whole
    if share == 0:
        return shifted(whole)
    energy = math.hypot(1 - share, share)
    return shifted(whole) * ((1 - share) / energy) + shifted(whole + 1) * (share / energy)


def _row_window(image: Tensor, first: int, last: int) -> Tensor:
    """Rows ``first..last`` of an image that repeats downwards."""
    height = image.shape[-2]
    if first >= 0 and last <= height:
        return image[..., first:last, :]
    index = torch.arange(first, last, device=image.device)
    return image.index_select(-2, index % height)
