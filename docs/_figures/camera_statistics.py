"""Statistics of camera frames in which effects show, each as a curve of its axis."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import effect_curves
import numpy as np
from camera_frames import Frames, greens
from effect_curves import Array, Curve

from torchweather.scenes import SceneView

Statistic = Callable[[SceneView, Frames, Frames], Curve]
"""Of the scene, the frames, and those without the effect."""

LEAST_VALUES = 40  # in a bin that is drawn


def in_bins(axis: Array, values: Array, edges: Array) -> Curve:
    """Mean of the finite values in each bin of the axis."""
    return effect_curves.in_bins(axis, np.where(np.isfinite(values), values, np.nan), edges, least=LEAST_VALUES)


def depth_of(view: SceneView) -> Array:
    """Depth of the green pixels of one phase, m."""
    return greens(view.depth_m[0].numpy())


DEPTHS_M = np.concatenate([np.arange(2.5, 15.0, 2.5), np.arange(15.0, 61.0, 5.0)])


def against_depth(view: SceneView, frames: Frames, plain: Frames, *, make: Callable[[Array, Array], Array]) -> Curve:
    """A value made of the signal and of that without the effect, against depth."""
    own, other = (greens(one.signal).mean(0) for one in (frames, plain))
    return in_bins(depth_of(view), make(own, other), DEPTHS_M)


def optical_depth(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Of the red and blue pixels together, from the transmission."""
    return in_bins(depth_of(view), -np.log(np.maximum(greens(frames.transmission).mean(0), 1e-6)), DEPTHS_M)


def against_radius(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Signal over that without the effect, against the distance from the image's centre."""
    height, width = view.bayer.shape[-2:]
    row, column = np.mgrid[:height, :width]
    radius = greens(np.hypot(row - (height - 1) / 2, column - (width - 1) / 2))
    own, other = (greens(one.signal).mean(0) for one in (frames, plain))
    return in_bins(radius, own / other, np.arange(0.0, 310.0, 15.0))


def sharpness(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Mean step between neighbours of a colour over that without the effect, against depth."""
    edges = DEPTHS_M[DEPTHS_M < 50.0]
    steps = [np.hypot(*np.gradient(greens(one.signal).mean(0))) for one in (frames, plain)]
    (x, own), (_, other) = (in_bins(depth_of(view), step, edges) for step in steps)
    return x, own / other


def sharpness_by_direction(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """What is left of steps across edges, against the direction of the step."""
    down, across = np.gradient(greens(plain.signal).mean(0))
    own_down, own_across = np.gradient(greens(frames.signal).mean(0))
    size = np.hypot(down, across)
    direction = np.degrees(np.arctan2(down, across)) % 180.0
    left = (own_down * down + own_across * across) / np.maximum(size, 1e-6) ** 2
    strong = size > np.quantile(size, 0.9)
    return in_bins(direction[strong], left[strong], np.arange(0.0, 181.0, 15.0))


def along_a_row(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Signal of the first frame along a row."""
    signal = greens(frames.signal)[0]
    row = int(0.65 * len(signal))
    return 2.0 * np.arange(signal.shape[1]), signal[row]


def streak_directions(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Correlation of the particles' mask with itself twelve pixels along each direction."""
    lean = np.arange(-60.0, 61.0, 5.0)
    mask = frames.mask - frames.mask.mean((1, 2), keepdims=True)
    whole, found = (mask**2).mean(), []
    for angle in np.radians(lean):
        down, aside = round(12.0 * np.cos(angle)), round(12.0 * np.sin(angle))
        shifted = np.roll(mask, (-down, -aside), (1, 2))[:, : mask.shape[1] - down]
        found.append((mask[:, : mask.shape[1] - down] * shifted).mean() / whole)
    return lean, np.array(found)


def on_the_road(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Signal over that without the effect against the depth of level ground."""
    own, other = (greens(one.signal).mean(0) for one in (frames, plain))
    level = greens(view.normal[2].numpy()) > 0.9
    return in_bins(depth_of(view)[level], (own / other)[level], np.concatenate([[2.5, 3.5], DEPTHS_M[1:10]]))


def variance(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Variance from frame to frame against the mean signal, 1e-4."""
    signal, mean = greens(frames.signal), greens(plain.signal).mean(0)
    return in_bins(mean, 1e4 * signal.var(0, ddof=1), np.arange(0.02, 0.62, 0.04))


def response(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Signal against that without the effect."""
    own, other = (greens(one.signal)[0] for one in (frames, plain))
    return in_bins(other, own, np.arange(0.0, 0.66, 0.02))


def frame_by_frame(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Transmission to 30 to 50 m in each frame."""
    there = (depth_of(view) > 30.0) & (depth_of(view) < 50.0)
    return np.arange(len(frames.signal)), greens(frames.transmission)[:, there].mean(1)


def by_elevation(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Transmission against elevation."""
    height, width = view.bayer.shape[-2:]
    row = np.mgrid[:height, :width][0]
    elevation = np.degrees(np.arctan(((height - 1) / 2 - row) / view.camera.fy))
    return in_bins(greens(elevation), greens(frames.transmission).mean(0), np.arange(-30.0, 31.0, 3.0))


def flicker(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Standard deviation from frame to frame against depth, 1e-3."""
    return in_bins(depth_of(view), 1e3 * greens(frames.signal).std(0, ddof=1), DEPTHS_M)


def cover(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Cover by particles against depth, percent."""
    return in_bins(depth_of(view), 100.0 * greens(frames.mask).mean(0), DEPTHS_M)


def streak_lengths(view: SceneView, frames: Frames, plain: Frames) -> Curve:
    """Correlation of the mask with itself some rows below."""
    mask = frames.mask - frames.mask.mean((1, 2), keepdims=True)
    rows = np.arange(0, 26)
    whole = (mask**2).mean()
    return rows, np.array([(mask[:, : mask.shape[1] - lag] * mask[:, lag:]).mean() / whole for lag in rows])


ratio = partial(against_depth, make=lambda own, other: own / other)
more = partial(against_depth, make=lambda own, other: own - other)
