"""Explicit lists of drops and flakes in the beams, and the waveform of fog."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.physics import (
    Q_EFF,
    SizeDistribution,
    effective_extinction_per_m,
    extinction_and_backscatter,
    extinction_per_m,
    flake_reflectivity,
    melted_diameter_mm,
    physical_diameter_mm,
    rain_q_back,
)
from torchweather.sensors import Lidar

from .scene import FloatArray

__all__ = ["Air", "Drops", "air_of", "draw_drops", "fog_echo"]

# Length of a cell of range in which drops are counted, and of the nodes of the fog's waveform, m.
CELL_M, NODE_M = 0.1, 0.25
# Nodes of the waveform below this share of its maximum are left out.
LOWEST_NODE = 0.3


@dataclass(frozen=True)
class Air:
    """Optics of a weather at the laser's wavelength.

    Args:
        extinction_per_m: one way, without the part of the forward lobe that the receiver still collects.
        backscatter_per_m_sr: of fog, else 0.
        full_echo_per_sr: power that a particle which fills the beam sends back, per steradian; 0 for fog.
        sizes: of drops or flakes; ``None`` for fog.
    """

    extinction_per_m: float
    backscatter_per_m_sr: float
    full_echo_per_sr: float
    sizes: SizeDistribution | None


@lru_cache(maxsize=256)
def air_of(kind: str, amount: float, wavelength_nm: float) -> Air:
    """Optics of ``rain`` or ``snow`` of a rate, mm/h, ``fog`` of a visibility, m, or ``clear`` air.

    A drop of diameter D in a beam of diameter D_b sends back ``Q_back / (4 pi) min(1, (D / D_b)^2)``, a flake
    ``rho / pi min(1, (D / D_b)^2)`` with the reflectivity rho of a thin flake (PHYSICS.md 5.3, 5.9, 10.3).
    """
    if kind == "clear":
        return Air(0.0, 0.0, 0.0, None)
    if kind == "fog":
        alpha, beta = extinction_and_backscatter(Fog(amount).distribution(), wavelength_nm)
        return Air(float(effective_extinction_per_m(alpha, Q_EFF["fog"])), float(beta), 0.0, None)
    sizes = (Rain if kind == "rain" else Snow)(amount).distribution()
    alpha = float(effective_extinction_per_m(extinction_per_m(sizes, wavelength_nm), Q_EFF[kind]))
    flake = float(flake_reflectivity(torch.tensor([wavelength_nm], dtype=torch.float64))[0])
    full = rain_q_back(wavelength_nm) / (4.0 * np.pi) if kind == "rain" else flake / np.pi
    return Air(alpha, 0.0, float(full), sizes)


@dataclass(frozen=True)
class Drops:
    """Particles one by one, ``(K,)`` each.

    Args:
        frame, beam: where it is.
        range_m: of its centre.
        signal: of its echo over the system constant, 1/(m^2 sr), without extinction.
    """

    frame: np.ndarray
    beam: np.ndarray
    range_m: FloatArray
    signal: FloatArray

    def only(self, keep: np.ndarray) -> Drops:
        """Some of them."""
        return Drops(self.frame[keep], self.beam[keep], self.range_m[keep], self.signal[keep])


def near_response(sensor: Lidar, range_m: FloatArray) -> FloatArray:
    """Response of the receiver in the near range, 0 to 1 (PHYSICS.md 5.3)."""
    ramp = (range_m - sensor.near_start_m) / (sensor.near_full_m - sensor.near_start_m)
    return np.asarray(np.clip(ramp, 0.0, 1.0) ** sensor.near_power)


def draw_drops(
    air: Air,
    sensor: Lidar,
    beams: int,
    density: FloatArray,
    floor_signal: float,
    divergence_rad: float,
    rng: np.random.Generator,
    pulse_m: float = 0.0,
    beam_density: FloatArray | None = None,
) -> Drops:
    """All particles of all beams that can send back ``floor_signal`` or more.

    They are a Poisson process with intensity ``A_b(r) N(D)`` in each beam, a cone.

    Args:
        air: of rain or snow.
        sensor: beam, near-range response, farthest range.
        beams: in a frame.
        density: ``(F,)`` number of particles over that of the weather.
        floor_signal: 1/(m^2 sr); weaker particles are not listed.
        divergence_rad: full angle of the cone.
        rng: draws.
        pulse_m: length over which a pulse adds the echoes of the others; 0: each particle alone.
        beam_density: ``(N,)`` number of particles in a beam over ``density``; ``None`` is 1.
    """
    sizes = air.sizes
    assert sizes is not None
    edges = np.arange(sensor.near_start_m, sensor.max_range_m + CELL_M, CELL_M)
    low, high = edges[:-1], edges[1:]
    exit_m = 1e-3 * sensor.exit_diameter_mm
    wide_low, wide_high = exit_m + divergence_rad * low, exit_m + divergence_rad * high
    volume = np.pi * (wide_high**3 - wide_low**3) / (12.0 * divergence_rad)
    # The strongest a full beam can be in the cell, and so the smallest outline that reaches the floor in it.
    best = air.full_echo_per_sr * near_response(sensor, high) / low**2
    fill = floor_signal / np.maximum(best, 1e-300)
    outline_mm = 1e3 * wide_low * np.sqrt(np.minimum(fill, 1.0))
    flakes = sizes.particle == "melted-flake"
    smallest = melted_diameter_mm(torch.from_numpy(outline_mm)) if flakes else torch.from_numpy(outline_mm)
    tail = np.where(fill < 1.0, sizes.tail_per_m3(smallest).numpy(), 0.0)  # per m^3
    used = tail > 0.0
    low, wide_low, wide_high, tail = low[used], wide_low[used], wide_high[used], tail[used]
    mean = volume[used] * tail * beams
    densest = 1.0 if beam_density is None else float(beam_density.max())
    counts = rng.poisson(densest * density[:, None] * mean)  # (F, cells)
    cell = np.tile(np.arange(len(low)), len(density))
    cell = np.repeat(cell, counts.ravel())
    frame = np.repeat(np.arange(len(density)), counts.sum(1))
    total = len(cell)
    # Within a cell the density follows the cross-section: uniform in the cube of the beam's diameter.
    cubed = wide_low[cell] ** 3 + rng.random(total) * (wide_high[cell] ** 3 - wide_low[cell] ** 3)
    wide = np.cbrt(cubed)
    range_m = (wide - exit_m) / divergence_rad
    counted = sizes.inverse_tail(torch.from_numpy(rng.random(total) * tail[cell]))
    outline = (physical_diameter_mm(counted) if flakes else counted).numpy() * 1e-3
    share = np.minimum(1.0, (outline / wide) ** 2)
    full_beam = air.full_echo_per_sr * near_response(sensor, range_m) / range_m**2
    beam = rng.integers(beams, size=total)
    dense = np.ones(total) if beam_density is None else beam_density[beam]
    # Those too weak to be listed: their mean echo over the length of a pulse adds to every listed one.
    unlisted = dense * density[frame] * _outline_area_per_m(sizes, outline_mm[used][cell]) * pulse_m
    found, alone = Drops(frame, beam, range_m, full_beam * (share + unlisted)), full_beam * share
    if beam_density is not None:
        kept = rng.random(total) < dense / densest
        found, alone = found.only(kept), alone[kept]
    return found if pulse_m == 0.0 else _with_others_of_the_pulse(found, alone, beams, pulse_m)


@lru_cache(maxsize=256)
def _areas(sizes: SizeDistribution) -> tuple[FloatArray, FloatArray]:
    """Outlines, mm, and the summed area of all smaller ones, m^2 per m^3."""
    counted = torch.from_numpy(np.geomspace(1e-2, 25.0, 2000))
    outline = (physical_diameter_mm(counted) if sizes.particle == "melted-flake" else counted).numpy()
    number = -np.diff(sizes.tail_per_m3(counted).numpy())
    middle = 1e-3 * np.sqrt(outline[1:] * outline[:-1])
    return outline, np.concatenate([[0.0], np.cumsum(number * np.pi / 4.0 * middle**2)])


def _outline_area_per_m(sizes: SizeDistribution, largest_mm: FloatArray) -> FloatArray:
    """Area of the outlines of all particles smaller than so many mm, m^2 per m^3: the share of a beam that they fill
    per metre."""
    outline, area = _areas(sizes)
    return np.asarray(np.interp(largest_mm, outline, area))


def _with_others_of_the_pulse(drops: Drops, alone: FloatArray, beams: int, pulse_m: float) -> Drops:
    """Listed particles with the echoes of the other listed ones of their beam: a pulse of the shape sin^2 and the half
    width l passes on ``cos^2(pi d / (2 l))`` of what lies d < l beside it (PHYSICS.md 10.4)."""
    order = np.lexsort((drops.range_m, drops.frame.astype(np.int64) * beams + drops.beam))
    ray = (drops.frame.astype(np.int64) * beams + drops.beam)[order]
    range_m, own = drops.range_m[order], alone[order]
    more = np.zeros(len(order))
    for step in range(1, len(order)):
        apart = range_m[step:] - range_m[:-step]
        near = (ray[step:] == ray[:-step]) & (apart < pulse_m)
        if not near.any():
            break
        share = np.where(near, np.cos(0.5 * np.pi * np.minimum(apart, pulse_m) / pulse_m) ** 2, 0.0)
        more[step:] += share * own[:-step]
        more[:-step] += share * own[step:]
    signal = drops.signal.copy()
    signal[order] += more
    return Drops(drops.frame, drops.beam, drops.range_m, signal)


def fog_echo(
    air: Air,
    sensor: Lidar,
    range_m: FloatArray,
    depth_at: FloatArray,
    density_at: FloatArray,
    nodes_m: FloatArray,
    gain: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Range and signal of the strongest point of the fog's waveform, with photon noise.

    The pulse, sin^2 of FWHM tau, is folded with ``beta xi exp(-2 depth) / R^2`` up to the target (PHYSICS.md 5.8); the
    noise is that of the photons in a cell of one pulse length, and changes over that length.

    Args:
        air: of fog.
        sensor: pulse, near-range response, photons.
        range_m: ``(N,)`` of the target, infinite where there is none.
        depth_at, density_at: ``(F, 1 or N, K)`` one-way optical depth and relative density at the nodes.
        nodes_m: ``(K,)`` nodes ``NODE_M`` apart.
        gain: ``(F or 1, N or 1, K)`` factor on the waveform.
        rng: draws.

    Returns:
        ``(F, N)`` range and signal.
    """
    local = (
        air.backscatter_per_m_sr * near_response(sensor, nodes_m) / nodes_m**2 * density_at * np.exp(-2.0 * depth_at)
    )
    pulse_nodes = max(1, round(sensor.pulse_length_m / NODE_M))
    window = np.sin(np.pi * (np.arange(2 * pulse_nodes) + 0.5) / (2 * pulse_nodes)) ** 2
    window = window * sensor.pulse_length_m / window.sum()  # the integral over range is c tau / 2
    frames, beams = len(depth_at), len(range_m)
    folded = np.apply_along_axis(np.convolve, -1, local, window)[..., pulse_nodes : pulse_nodes + len(nodes_m)]
    wave = (folded * gain).astype(np.float32)
    # Noise of a few percent never lifts a node far below the maximum to the top.
    near_top = (wave >= LOWEST_NODE * wave.max(-1, keepdims=True)).any((0, 1))
    nodes_m, wave = nodes_m[near_top], wave[..., near_top]
    # Shot noise is white; the receiver, as long as the pulse, passes it on with that length.
    nodes = len(nodes_m)
    passes = (window / np.linalg.norm(window)).astype(np.float32)
    band = np.zeros((nodes + len(passes) - 1, nodes), dtype=np.float32)
    for node in range(nodes):
        band[node : node + len(passes), node] = passes
    white = rng.standard_normal((frames * beams, len(band)), dtype=np.float32)
    noise = (white @ band).reshape(frames, beams, nodes)
    photon = np.float32(sensor.threshold_per_m2_sr / sensor.photons_at_threshold)
    seen = noise
    seen *= np.sqrt(np.maximum(wave, 0.0) * photon)
    seen += wave
    short = np.flatnonzero(range_m < nodes_m[-1])
    seen[:, short] = np.where(nodes_m <= range_m[short, None], seen[:, short], -np.inf)
    best = seen.argmax(-1)
    strongest, between = _vertex(seen, best)
    # The window has an even number of nodes: its middle lies half a node behind the one it is counted at.
    return nodes_m[best] + (0.5 + between) * NODE_M, np.maximum(strongest, 0.0)


def _vertex(seen: FloatArray, best: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Height of the parabola through the highest node and those beside it, and its place, -0.5 to 0.5 nodes."""
    last = seen.shape[-1] - 1
    left, middle, right = (
        np.take_along_axis(seen, np.clip(best + step, 0, last)[..., None], -1)[..., 0].astype(np.float64)
        for step in (-1, 0, 1)
    )
    inside = (best > 0) & (best < last) & np.isfinite(left) & np.isfinite(right)
    middle = np.where(np.isfinite(middle), middle, 0.0)
    left, right = np.where(inside, left, middle), np.where(inside, right, middle)
    bend = left - 2.0 * middle + right
    place = np.clip(0.5 * (left - right) / np.where(bend < 0.0, bend, -1e300), -0.5, 0.5)
    return middle - 0.25 * (left - right) * place, place
