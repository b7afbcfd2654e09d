"""Tables of a precipitation for a camera's particle veil, made once over rate and pixel footprint.

Coordinates. A particle at depth Z covers ``d = D / g`` pixels and moves ``v t / g`` during the exposure, where
``g = Z / f`` is the footprint of a pixel in metres per pixel. Everything about one particle's mark depends on
(D, g) alone, so the tables run over g, and a new focal length needs no new table.

Listed and haze. A particle is *listed*, drawn one by one, where it can be seen by itself: the peak of its mark
exceeds ``min_listed_coverage``, and no more than ``max_listed_density`` larger ones share a pixel in an e-fold of
depth. That is D > D_cut(g). All smaller ones are the *haze*, which enters through the mean and the variance of its
optical depth and the correlation of its streaks. The sum depends on neither limit. In wind or from a moving vehicle
streaks differ in length and direction over the frame; variance and correlation are their means over it
(``PHYSICS.md`` 10.10).

Levels. Listed particles are a Poisson process in (pixel area, g, level) of unit density, where the level of a
particle is the number of larger particles per m^3, ``s = N_>(D; R)``. A rate R reads each particle's diameter
from its level, ``D = N_>^-1(s; R)``, and shows it if ``s < N_>(D_cut(g); R)``. Thus with one draw held,
particles keep their place while the rate rises, grow (wherever the distribution's tail rises with the rate),
and others join them.
"""

from __future__ import annotations

import itertools
import math
from copy import copy as shallow_copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.camera.particles.image_motion import ImageMotion, Streaks

__all__ = ["HazeShell", "ListedShell", "MarkOptics", "ParticleTables", "particle_tables"]

Array = NDArray[np.float64]

RATE_NODES = 64
RATE_LOW_MM_PER_H = 0.01  # below it tables follow their power law
DIAMETER_NODES = 512
FOOTPRINT_NODES = 192
LEVEL_NODES = 256
LEVEL_LOW_PER_M3 = 1e-8  # one particle in the 1e6 m^3 of a frustum of 100 m, and a hundred times rarer
FOOTPRINT_QUANTILE_NODES = 65
HAZE_SHELLS = 4
MOST_TAPS = 24
SMALLEST_MM = 1e-2  # measured bins may begin at 0; below this nothing is seen
COARSE = 4  # every fourth node of depth and size tells the correlation of the haze in motion
FLOOR = 1e-30  # keeps logarithms finite where nothing falls
LEAST_ENERGY = 1e-9  # of a kernel of the haze in its outermost taps: without them its noise differs by 3e-5 of it
# Equal-variance box of a disk's chord profile: variance b^2/16 = w^2/12.
BOX_OF_DISK = math.sqrt(12 / 16)


@dataclass(frozen=True)
class MarkOptics:
    """Optics that decide a particle's mark besides its diameter and depth.

    Args:
        exposure_s: exposure time.
        aperture_m: diameter of the entrance pupil; 0 is a pinhole.
        focus_distance_m: focus; infinity where the camera looks far away.
        lens_blur_px: diameter of the disk with the variance of the lens's point spread.
        published_blend: D3.4's blend weight (1 + d) / (v t) in place of the covered share of the exposure.
    """

    exposure_s: float
    aperture_m: float = 0.0
    focus_distance_m: float = math.inf
    lens_blur_px: float = 0.0
    published_blend: bool = False


@dataclass(frozen=True)
class ListedShell:
    """An octave of depth in which particles are drawn one by one.

    Args:
        per_px2: slots per pixel of the image with its margin.
        length_max_px, width_max_px: largest streak length and (blurred) width in the shell.
        log_footprint: ln g at uniform quantiles of the slots, ``(FOOTPRINT_QUANTILE_NODES,)``.
    """

    per_px2: float
    length_max_px: float
    width_max_px: float
    log_footprint: Array


@dataclass(frozen=True)
class HazeShell:
    """A range of depth whose haze shares one noise map.

    Args:
        first_node, last_node: its limits on the table's footprint axis.
    """

    first_node: int
    last_node: int


@dataclass(frozen=True)
class ParticleTables:
    """The tables; leading axis of each is the rate node (uniform in ln rate) unless said otherwise.

    Args:
        log_rate_low, log_rate_step: the rate axis.
        log_footprint_low, log_footprint_step: the footprint axis, ln of m/px.
        log_level_low, log_level_step: the level axis, ln of m^-3.
        tail_at_cut: ``(P, G)`` N_>(D_cut(g); R), m^-3: listed particles per m^3.
        tail_most: ``(G,)`` its maximum over the rates: the slots' density.
        log_outline_m: ``(P, S)`` ln of the outline's diameter at a level, metres.
        log_fall_speed: ``(P, S)`` ln of its fall speed, m/s.
        haze_depth: ``(P, G)`` optical depth of the haze from the near limit to g, per pixel of focal length.
        haze_variance: ``(P, G)`` its variance, likewise.
        kernel_along, kernel_across: ``(P, J, taps)`` correlation kernels of the haze shells, unit sum of squares.
        haze_speed_m_per_s: mean fall speed of the haze, weighted by its variance.
        listed: the listed shells. haze: the haze shells.
    """

    log_rate_low: float
    log_rate_step: float
    log_footprint_low: float
    log_footprint_step: float
    log_level_low: float
    log_level_step: float
    tail_at_cut: Array
    tail_most: Array
    log_outline_m: Array
    log_fall_speed: Array
    haze_depth: Array
    haze_variance: Array
    kernel_along: Array
    kernel_across: Array
    haze_speed_m_per_s: float
    listed: tuple[ListedShell, ...]
    haze: tuple[HazeShell, ...]

    @cached_property
    def taps_along(self) -> tuple[int, ...]:
        """Of each haze shell, how far its kernel along the streaks counts to either side."""
        return _taps_that_count(self.kernel_along)

    @cached_property
    def taps_across(self) -> tuple[int, ...]:
        """Likewise across the streaks."""
        return _taps_that_count(self.kernel_across)

    @cached_property
    def at_listed_nodes(self) -> tuple[Array, Array, Array]:
        """Footprint ``(shells, nodes)``, and ln of `tail_at_cut` ``(P, shells, nodes)`` and of `tail_most` there."""
        foot = np.stack([shell.log_footprint for shell in self.listed] or [np.zeros(0)])[: len(self.listed)]
        return np.exp(foot), self.log_at(self.tail_at_cut, foot), self.log_at(self.tail_most, foot)

    def log_at(self, table: Array, log_footprint: Array) -> Array:
        """ln of a table ``(..., G)`` over the footprint, at other footprints."""
        node = (log_footprint - self.log_footprint_low) / self.log_footprint_step
        cell = np.clip(np.floor(node).astype(int), 0, table.shape[-1] - 2)
        share = np.clip(node - cell, 0.0, 1.0)
        values = np.log(np.maximum(table, FLOOR))
        return np.asarray(values[..., cell] * (1 - share) + values[..., cell + 1] * share)


def _taps_that_count(kernels: Array) -> tuple[int, ...]:
    """Taps to either side without which each of the kernels ``(P, J, taps)`` keeps its energy at every rate."""
    most = kernels.shape[-1] // 2
    square = kernels.max(0) ** 2
    square = np.maximum(square, kernels.min(0) ** 2)
    beyond = [square[:, : most - reach].sum(-1) + square[:, most + reach + 1 :].sum(-1) for reach in range(most + 1)]
    return tuple(int((np.stack(beyond)[:, shell] > LEAST_ENERGY).sum()) for shell in range(kernels.shape[1]))


def circle_of_confusion_px(footprint_m: Array, focal_px: float, optics: MarkOptics) -> Array:
    """Diameter of the blur circle, px: ``A |Z - Z_f| / (g Z_f)``; ``A / g`` at infinite focus."""
    if math.isinf(optics.focus_distance_m):
        return optics.aperture_m / footprint_m
    depth = footprint_m * focal_px
    return optics.aperture_m * np.abs(depth - optics.focus_distance_m) / (footprint_m * optics.focus_distance_m)


def mark(outline_m: Array, speed: Array, footprint_m: Array, focal_px: float, optics: MarkOptics) -> tuple[Array, ...]:
    """Width (px, blurred), length (px) and opacity of a particle's mark; the product of areas is conserved."""
    diameter = outline_m / footprint_m
    blur = np.hypot(circle_of_confusion_px(footprint_m, focal_px, optics), optics.lens_blur_px)
    width = np.hypot(diameter, blur)
    length = speed * optics.exposure_s / footprint_m
    opacity = (diameter / width) ** 2
    if optics.published_blend:
        opacity = opacity * (1 + diameter) / diameter
    return width, length, opacity


def overlap_of_boxes(lag: Array, width: Array) -> Array:
    """Autocovariance of a box of ``width`` pixels and unit area, averaged over pixels, at an integer ``lag``.

    ``(tri_w * tri_1)(lag)``, exact: the phase-averaged product of a box-filtered box with its shifted self.
    """
    wide = np.maximum(width, 1e-2)
    total = np.zeros(np.broadcast_shapes(lag.shape, wide.shape))
    for i, ci in ((-1, 1.0), (0, -2.0), (1, 1.0)):
        edge = lag + i * wide if i else lag  # of few values
        for j, cj in ((-1, 1.0), (0, -2.0), (1, 1.0)):
            distance = np.abs(edge + j)
            total += ci * cj * (distance * distance * distance)  # a power is ten times slower
    return np.asarray(np.maximum(total / (12.0 * wide * wide), 0.0))


def _kernel(covariance: Array, taps: int) -> Array:
    """Symmetric kernel ``(..., 2 taps + 1)`` of unit energy with this autocorrelation ``(..., taps + 1)``."""
    n = 8 * (taps + 1)
    symmetric = np.zeros((*covariance.shape[:-1], n))
    symmetric[..., : taps + 1] = covariance
    symmetric[..., n - taps :] = covariance[..., :0:-1]
    amplitude = np.sqrt(np.maximum(np.fft.fft(symmetric).real, 0.0))
    kernel = np.fft.ifft(amplitude).real
    centred = np.concatenate([kernel[..., n - taps :], kernel[..., : taps + 1]], axis=-1)
    return np.asarray(centred / np.sqrt((centred**2).sum(-1, keepdims=True)))


def _log_grid(low: float, high: float, nodes: int) -> tuple[Array, float]:
    grid = np.linspace(math.log(low), math.log(high), nodes)
    return grid, float(grid[1] - grid[0])


def _cumulative(values: Array, grid: Array) -> Array:
    """Trapezoid integral from the first node along the last axis."""
    steps = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(grid)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def build_particle_tables(
    weather: Rain | Snow,
    optics: MarkOptics,
    focal_px: float,
    near_m: float,
    far_m: float,
    min_listed_coverage: float,
    max_listed_density: float,
    rate_capacity: float,
    motion: ImageMotion | None = None,
) -> ParticleTables:
    """Tabulate a precipitation for a camera; see the module's text. Takes about 0.1 s, in motion half a second."""
    log_rate, rate_step = _log_grid(RATE_LOW_MM_PER_H, rate_capacity, RATE_NODES)
    log_foot, foot_step = _log_grid(near_m / focal_px, far_m / focal_px, FOOTPRINT_NODES)
    foot = np.exp(log_foot)[:, None]  # (G, 1)

    distribution = weather.distribution(torch.from_numpy(np.exp(log_rate)))
    high_mm = float(distribution.diameter_max_mm)
    low_mm = max(float(distribution.diameter_min_mm), SMALLEST_MM)
    log_mm, _ = _log_grid(low_mm, high_mm, DIAMETER_NODES)
    diameter = torch.from_numpy(np.exp(log_mm))
    # exp(log(x)) may fall a rounding step outside the domain, where the density is 0.
    diameter = diameter.clamp(low_mm, high_mm)
    density = distribution.number_density_per_m3_mm(diameter).numpy()  # (P, K) per m^3 and mm
    outline = weather.physical_diameter_mm(diameter).numpy() * 1e-3
    speed = weather.fall_speed_m_per_s(diameter).numpy()
    per_log = density * diameter.numpy()  # dN / d ln D

    # Tails, from the top down.
    tail = _cumulative(per_log[:, ::-1], -log_mm[::-1])[:, ::-1]  # (P, K) m^-3

    width, length, opacity = mark(outline, speed, foot, focal_px, optics)  # (G, K)
    peak = opacity * np.minimum(1, width**2) * np.minimum(1, width / np.maximum(length, 1e-9))
    larger_per_px = focal_px * foot**3 * tail.max(0)  # (G, K) per e-fold of depth
    listed = (peak > min_listed_coverage) & (larger_per_px <= max_listed_density)
    # A larger particle of the same depth is listed as well.
    listed = np.flip(np.logical_and.accumulate(np.flip(listed, 1), 1), 1)
    if_listed = listed.any(1)
    cut_node = np.where(if_listed, listed.argmax(1), DIAMETER_NODES - 1)
    haze = np.arange(DIAMETER_NODES) <= cut_node[:, None]  # (G, K), every class below the cut and the cut itself

    tail_at_cut = np.where(if_listed, tail[:, cut_node], 0.0)  # (P, G)
    tail_most = tail_at_cut.max(0)
    log_level, level_step = _log_grid(LEVEL_LOW_PER_M3, max(float(tail.max()), 10 * LEVEL_LOW_PER_M3), LEVEL_NODES)
    log_outline, log_speed = np.empty((2, RATE_NODES, LEVEL_NODES))
    for row in range(RATE_NODES):
        rising = np.log(np.maximum(tail[row, ::-1], 1e-300))
        log_outline[row] = np.interp(log_level, rising, np.log(outline[::-1]))
        log_speed[row] = np.interp(log_level, rising, np.log(np.maximum(speed[::-1], 1e-6)))

    # Haze: trapezoid weights that stop at the cut.
    weights = np.full((FOOTPRINT_NODES, DIAMETER_NODES), log_mm[1] - log_mm[0]) * haze
    weights[:, 0] *= 0.5
    weights[np.arange(FOOTPRINT_NODES), cut_node] *= 0.5
    weights[cut_node == 0] = 0.0
    area_m2 = math.pi / 4 * outline**2 * opacity * (width * foot / outline) ** 2  # = pi/4 D^2 unless published
    along = np.hypot(length, BOX_OF_DISK * width)
    across = BOX_OF_DISK * width
    lags = np.arange(MOST_TAPS + 1.0)
    zero = np.zeros(1)
    energy = (area_m2 / foot**2) ** 2 * weights  # squared marks, px^4
    if motion is None:
        streaks = None
        variance_weight = energy * overlap_of_boxes(zero, along) * overlap_of_boxes(zero, across)
    else:
        streaks = motion.streaks(speed)
        ways = [one.speed_m_per_s * optics.exposure_s / foot for one in streaks]  # (G, K) each
        shares = [one.weight for one in streaks]
        met = [share * overlap_of_boxes(zero, np.hypot(way, across)) for share, way in zip(shares, ways, strict=True)]
        variance_weight = energy * sum(met) * overlap_of_boxes(zero, across)
        along = np.hypot(np.sqrt(sum(share * way**2 for share, way in zip(shares, ways, strict=True))), across)
    # per unit of ln g and of focal length: dZ dV/dpx^2 = f g^2 f dg
    haze_depth = _cumulative((per_log @ (area_m2 * weights).T) * foot[:, 0], log_foot)
    variance_density = (per_log @ variance_weight.T) * foot[:, 0] ** 3
    haze_variance = _cumulative(variance_density, log_foot)

    reference_row = int(np.abs(log_rate - math.log(min(50.0, rate_capacity) / 2)).argmin())
    edges = _equal_shares(haze_variance[reference_row], HAZE_SHELLS)
    shells = tuple(HazeShell(a, b) for a, b in itertools.pairwise(edges))
    reach = variance_weight * foot**3 * per_log[reference_row]
    taps = _taps_needed(along, reach)
    kernels = []
    for turned, size in ((False, along), (True, across)):
        rows = []
        for shell in shells:
            inside = slice(shell.first_node, shell.last_node + 1)
            if streaks is None:
                covariance = overlap_of_boxes(lags[: taps + 1, None, None], size[inside]) / overlap_of_boxes(
                    zero, size[inside]
                )
                share = variance_weight[inside] * foot[inside] ** 3  # (g, K)
                rows.append(np.einsum("lgk,gk,pk->pl", covariance, share, per_log, optimize=True))
                continue
            some = (slice(shell.first_node, shell.last_node + 1, COARSE), slice(None, None, COARSE))
            reached = _turned_covariance(streaks, lags[: taps + 1], foot[some[0]], across[some], optics, turned=turned)
            share = energy[some] * foot[some[0]] ** 3
            rows.append(np.einsum("lgk,gk,pk->pl", reached, share, per_log[:, ::COARSE], optimize=True))
        covariances = np.stack(rows, axis=1)  # (P, J, taps + 1)
        covariances[covariances[..., 0] <= 0] = np.eye(taps + 1)[0]
        kernels.append(_kernel(covariances / covariances[..., :1], taps))
    total_reach = reach.sum()
    haze_speed = float((reach * speed).sum() / total_reach) if total_reach > 0 else 0.0

    return ParticleTables(
        log_rate_low=float(log_rate[0]),
        log_rate_step=rate_step,
        log_footprint_low=float(log_foot[0]),
        log_footprint_step=foot_step,
        log_level_low=float(log_level[0]),
        log_level_step=level_step,
        tail_at_cut=tail_at_cut,
        tail_most=tail_most,
        log_outline_m=log_outline,
        log_fall_speed=log_speed,
        haze_depth=haze_depth,
        haze_variance=haze_variance,
        kernel_along=kernels[0],
        kernel_across=kernels[1],
        haze_speed_m_per_s=haze_speed,
        listed=_listed_shells(log_foot, tail_most, width, length, focal_px),
        haze=shells,
    )


def _turned_covariance(
    streaks: list[Streaks], lags: Array, foot: Array, across: Array, optics: MarkOptics, *, turned: bool
) -> Array:
    """Autocovariance ``(lags, G, K)`` of marks of unit area along the haze's axis, or across it, mean over the frame.

    A lag has a part along a streak and a part across it; the mark is a box of its length and one of its width.

    Args:
        streaks: at places of the frame, of every size of the tables.
        lags: pixels, ``(lags,)``.
        foot: ``(G, 1)`` m/px.
        across: ``(G, K)`` equal-variance box of the marks' width, px.
        optics: the camera's.
        turned: across the axis.
    """
    total = np.zeros((len(lags), *across.shape))
    for one in streaks:
        way = one.speed_m_per_s[::COARSE] * optics.exposure_s / foot
        first, second = np.abs(one.cosine[::COARSE]), np.abs(one.sine[::COARSE])
        if turned:
            first, second = second, first
        lag = lags[:, None, None]
        length = np.hypot(way, across)
        total += one.weight * overlap_of_boxes(lag * first, length) * overlap_of_boxes(lag * second, across)
    return total


def _equal_shares(cumulative: Array, number: int) -> list[int]:
    """Node numbers that cut a cumulative curve into equal shares, strictly rising, first and last included."""
    last = len(cumulative) - 1
    total = cumulative[-1]
    if total <= 0:
        return [round(k * last / number) for k in range(number + 1)]
    inner = [int(np.searchsorted(cumulative, total * k / number)) for k in range(1, number)]
    edges = [0]
    for k, node in enumerate(inner):
        edges.append(min(max(node, edges[-1] + 1), last - (number - 1 - k)))
    return [*edges, last]


def _taps_needed(along: Array, reach: Array) -> int:
    """Lags that hold 99.9 % of the haze's variance, at most ``MOST_TAPS``."""
    total = reach.sum()
    for taps in range(1, MOST_TAPS):
        if reach[along > taps].sum() <= 1e-3 * total:
            return taps
    return MOST_TAPS


def _listed_shells(
    log_foot: Array, tail_most: Array, width: Array, length: Array, focal_px: float
) -> tuple[ListedShell, ...]:
    shells = []
    number = max(1, math.ceil((log_foot[-1] - log_foot[0]) / math.log(2.0)))
    edges = np.linspace(log_foot[0], log_foot[-1], number + 1)
    for low, high in itertools.pairwise(edges):
        fine = np.linspace(low, high, 1025)
        tail = np.interp(fine, log_foot, tail_most)
        density = focal_px * np.exp(3 * fine) * tail  # slots per px^2 and unit of ln g
        cumulative = _cumulative(density, fine)
        if cumulative[-1] <= 0:
            continue
        quantiles = np.linspace(0, cumulative[-1], FOOTPRINT_QUANTILE_NODES)
        near = int(np.clip(np.searchsorted(log_foot, low) - 1, 0, len(log_foot) - 1))
        shells.append(
            ListedShell(
                per_px2=float(cumulative[-1]),
                length_max_px=float(length[near].max()),
                width_max_px=float(width[near].max()),
                log_footprint=np.interp(quantiles, cumulative, fine),
            )
        )
    return tuple(shells)


@lru_cache(maxsize=32)
def _cached(
    shape: Rain | Snow,
    optics: MarkOptics,
    focal_px: float,
    near_m: float,
    far_m: float,
    min_listed_coverage: float,
    max_listed_density: float,
    rate_capacity: float,
    motion: ImageMotion | None,
) -> ParticleTables:
    return build_particle_tables(
        shape, optics, focal_px, near_m, far_m, min_listed_coverage, max_listed_density, rate_capacity, motion
    )


def particle_tables(
    weather: Rain | Snow,
    optics: MarkOptics,
    focal_px: float,
    near_m: float,
    far_m: float,
    min_listed_coverage: float,
    max_listed_density: float,
    rate_capacity: float,
    motion: ImageMotion | None = None,
) -> ParticleTables:
    """The tables, from a cache that does not look at the rate or at what flakes do with light; without motion, those of
    particles that fall straight down the image."""
    same: dict[str, Any] = {"rate_mm_per_h": 0.0, "wind_m_per_s": (0.0, 0.0, 0.0)}
    if isinstance(weather, Snow):
        same |= {"albedo": Snow.albedo, "flake_reflectivity": None, "melt_fraction": 0.0}
    shape = shallow_copy(weather)
    for name, value in same.items():  # not by replace, whose checks take a millisecond of every sample
        object.__setattr__(shape, name, value)
    moving = None if motion is None or motion.still else motion.rounded()
    limits = (near_m, far_m, min_listed_coverage, max_listed_density, rate_capacity)
    return _cached(shape, optics, focal_px, *limits, moving)
