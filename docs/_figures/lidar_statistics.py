"""Statistics of LiDAR frames in which effects show, each as a curve of its axis."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from effect_curves import Array, Curve, in_bins, middle
from lidar_frames import Beams, Frames

import torchweather as tw

NEIGHBOUR_M = 1.0  # apart in range at most, for neighbours on the scan; the filter's default
APART_CM = 2.0 * np.arange(26)


def intensity_ratio(
    beams: Beams, frames: Frames, axis: str, edges: Array, only: Callable[[Beams], Array] | None = None
) -> Curve:
    """Median intensity of objects over that in clear air, dB; a lost return counts as less than any other."""
    with np.errstate(divide="ignore"):
        ratio_db = 10.0 * np.log10(np.where(frames.object, frames.intensity, 0.0) / np.maximum(beams.intensity, 1e-9))
    picked = beams.hit & (only(beams) if only else True) & ~frames.particle
    x, y = in_bins(np.broadcast_to(getattr(beams, axis), picked.shape)[picked], ratio_db[picked], edges, np.median)
    return x, np.where(np.isfinite(y), y, np.nan)


def lost_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams that see an object in clear air and report nothing, percent."""
    lost = 100.0 * (frames.kind == tw.PointKind.LOST)[:, beams.hit]
    return in_bins(np.broadcast_to(getattr(beams, axis)[beams.hit], lost.shape), lost, edges)


def nearer_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams that meet an object where there is none in clear air, percent."""
    nearer = 100.0 * (frames.object & (~beams.hit | (frames.range_m < beams.range_m - 0.5)))
    return in_bins(np.broadcast_to(getattr(beams, axis), nearer.shape), nearer, edges)


def particle_count(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Particle returns of a frame in each metre of range."""
    counts, _ = np.histogram(frames.range_m[frames.particle], edges)
    return middle(edges), counts / np.diff(edges) / len(frames.range_m)


def particle_intensity(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Mean intensity of the particle returns, photons."""
    return in_bins(frames.range_m[frames.particle], frames.intensity[frames.particle], edges)


def residual(beams: Beams, frames: Frames, axis: Callable[[Beams], Array], edges: Array) -> Curve:
    """Mean range of objects less that in clear air, cm."""
    picked = frames.object & beams.hit
    error_cm = 100.0 * (frames.range_m - beams.range_m)[picked]
    return in_bins(np.broadcast_to(axis(beams), picked.shape)[picked], error_cm, edges)


def residual_share(beams: Beams, frames: Frames, edges: Array) -> Curve:
    """Objects with a range less that in clear air, in cm, in each bin, percent."""
    picked = frames.object & beams.hit
    counts, _ = np.histogram(100.0 * (frames.range_m - beams.range_m)[picked], edges)
    return middle(edges), 100.0 * counts / picked.sum()


def neighbours(beams: Beams, frames: Frames) -> Curve:
    """Particle returns of a frame by how many of their eight neighbours on the scan return from near their range."""
    rows, columns = beams.grid
    reported = np.where(frames.kind == tw.PointKind.LOST, np.nan, frames.range_m).reshape(-1, rows, columns)
    framed = np.pad(
        np.pad(reported, ((0, 0), (0, 0), (1, 1)), "wrap"), ((0, 0), (1, 1), (0, 0)), constant_values=np.nan
    )
    near = np.zeros(reported.shape, int)
    for row in range(3):
        for column in range(3):
            if (row, column) != (1, 1):
                other = framed[:, row : row + rows, column : column + columns]
                near += np.abs(other - reported) <= NEIGHBOUR_M
    found = near.reshape(frames.kind.shape)[frames.particle]
    return np.arange(6), np.bincount(np.minimum(found, 5), minlength=6) / len(frames.kind)


BEHIND_M = np.array([5.0, 10.0, 15.0, 20.0, 30.0, 60.0])
BEHIND = (*(f"{a:g}–{b:g}" for a, b in pairwise(BEHIND_M)), "sky")


def particles_before(beams: Beams, frames: Frames) -> Curve:
    """Beams that return a particle by the range of the object behind it, percent; the last is the sky."""
    share = 100.0 * frames.particle.mean(0)
    _, found = in_bins(beams.range_m[beams.hit], share[beams.hit], BEHIND_M)
    return np.arange(len(BEHIND)), np.append(found, share[~beams.hit].mean())


def particles_in_frames(beams: Beams, frames: Frames) -> Curve:
    """Particle returns of each frame, thousands."""
    return np.arange(1, len(frames.kind) + 1), 1e-3 * frames.particle.sum(1)


def particle_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams into the sky that return a particle, percent."""
    shown = 100.0 * frames.particle[:, ~beams.hit]
    return in_bins(np.broadcast_to(getattr(beams, axis)[~beams.hit], shown.shape), shown, edges)


def apart_of_neighbours(beams: Beams, frames: Frames) -> Curve:
    """Pairs of particle returns beside each other in a ring, by how far apart they are in range."""
    rows, columns = beams.grid
    range_m = frames.range_m.reshape(-1, rows, columns)
    both = frames.particle.reshape(-1, rows, columns)
    pairs = both[..., 1:] & both[..., :-1]
    apart_cm = 100.0 * np.abs(np.diff(range_m, axis=-1))[pairs]
    number, _ = np.histogram(apart_cm, APART_CM)
    return middle(APART_CM), number / len(frames.kind)
