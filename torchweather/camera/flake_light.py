"""Light on a falling flake: the mean over the sphere of sky and ground, estimated from the frame."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.airlight import STRIDES_PX, per_colour, thinned
from torchweather.camera.compiled_rows import map_of, on_processor
from torchweather.camera.state import CameraState
from torchweather.core.compiled import uses_compiled
from torchweather.core.masks import compare
from torchweather.pipeline.graph_operations import cells_apart, parts_of
from torchweather.pipeline.tiling import is_exporting

__all__ = ["GROUND_ALBEDO", "flake_light", "sky_gradient"]

GROUND_ALBEDO = 0.1
"""Of asphalt, for the light from below where the frame shows no ground."""
OVERCAST_GRADIENT = 2.0  # zenith over horizon less 1 of the CIE overcast sky, the steepest of grey skies
LEAST_SPREAD = 0.02  # of the sine of the elevations, standard deviation, over which a sky shows a gradient
PARTLY_SKY = 0.75  # share of a cell of the mosaic: three of its four pixels, beside one that shows something else


def flake_light(state: CameraState, horizon: Tensor) -> Tensor:
    """Radiance that a flake of albedo 1 shows, ``(B, 3)``: ``(L_sky + L_ground) / 2``.

    A flake scatters light from the whole sphere with a broad phase function. The sky's radiance is
    ``L_horizon (1 + g sin e)``; g from 0, an even sky, to 2, the CIE overcast sky, is fitted to the sky that the frame
    shows, and its mean over the upper hemisphere is ``L_horizon (1 + g / 2)``. The ground's is the mean of the frame
    below the horizon, surfaces on it included and the own vehicle not; where the frame shows none, that of a surface
    of albedo 0.1 under this sky.

    Args:
        state: the frame.
        horizon: ``(B, 3)`` radiance of the sky near the horizon, linear, in units of saturation.

    References:
        PHYSICS.md 10.2.
    """
    gradient = sky_gradient(state).to(horizon)
    from_sky = horizon * (1 + gradient / 2)
    if state.scene.sine_elevation is None:
        return (from_sky + GROUND_ALBEDO * horizon * (1 + 2 * gradient / 3)) / 2
    if _is_compiled(state):
        light, share = _light_of_ground(state, state.scene.sine_elevation)
    else:
        light, share = _mean_under(state, _ground(state, state.scene.sine_elevation))
    from_ground = torch.where(share > 0, light, GROUND_ALBEDO * horizon * (1 + 2 * gradient / 3))
    return (from_sky + from_ground) / 2


def _is_compiled(state: CameraState) -> bool:
    """True where compiled loops look for the ground: in planes, on the processor."""
    scene, signal = state.scene, state.image.signal
    if is_exporting() or state.receiver.cfa_index is not None or not uses_compiled():
        return False
    return on_processor(signal, scene.depth_m, scene.sky, scene.sine_elevation, scene.near_mask)


def _light_of_ground(state: CameraState, sine_elevation: Tensor) -> tuple[Tensor, Tensor]:
    """``_mean_under`` the ground by compiled loops."""
    from torchweather.camera.compiled_airlight import light_of_ground

    scene, signal = state.scene, state.image.signal.detach().contiguous().numpy()
    maps = (scene.depth_m, scene.sky, sine_elevation, scene.near_mask)
    found = np.stack([light_of_ground(one, *(map_of(each, row) for each in maps)) for row, one in enumerate(signal)])
    means = torch.from_numpy(found)
    share = means[:, -1:]
    return means[:, :-1] / share.clamp_min(1e-12), share


def _ground(state: CameraState, sine_elevation: Tensor) -> Tensor:
    """Share of ground of each pixel, ``(1 or B, 1, H, W)``."""
    sky = compare(state.scene.depth_m, ">=", torch.inf) if state.scene.sky is None else state.scene.sky
    ground = (sine_elevation < 0.0).to(state.image.signal) * (1 - sky.to(state.image.signal))
    if state.scene.near_mask is not None:
        ground = ground * (1 - state.scene.near_mask.to(state.image.signal))
    return ground


def _mean_under(state: CameraState, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Mean signal of each colour under a weight ``(1 or B, 1, H, W)``, ``(B, 3)``, and the mean weight, ``(B, 1)``."""
    signal = state.image.signal
    if state.receiver.cfa_index is None:
        mean = weight.mean((2, 3))
        return (signal * weight).mean((2, 3)) / mean.clamp_min(1e-12), mean.expand(signal.shape[0], 1)
    if is_exporting():
        own, lit = (cells_apart(one).mean((2, 3)) for one in (weight, signal * weight))
        return per_colour(lit / own.clamp_min(1e-12), state), own.amin(1, keepdim=True)
    cells = [(slice(y, None, 2), slice(x, None, 2)) for y in (0, 1) for x in (0, 1)]
    own = torch.stack([weight[:, 0, y, x].mean((1, 2)) for y, x in cells], 1)  # (1 or B, 4)
    lit = torch.stack([(signal[:, 0, y, x] * weight[:, 0, y, x]).mean((1, 2)) for y, x in cells], 1)
    light = per_colour((lit / own.clamp_min(1e-12)).view(-1, 2, 2), state)
    return light, own.amin(1, keepdim=True).expand(signal.shape[0], 1)


def sky_gradient(state: CameraState) -> Tensor:
    """Growth of the sky's radiance from the horizon to the zenith, ``(B, 1)``, 0 to 2: g of ``1 + g sin e``.

    A straight line through the sky of the frame over the sine of the elevation, by least squares; 0 where the frame
    shows too little sky for one.
    """
    if is_exporting() and state.scene.sine_elevation is not None:
        return _gradient_of_graph(state, state.scene.sine_elevation)
    signal = thinned(state, state.image.signal, STRIDES_PX).mean(1)  # (B, n)
    if state.scene.sine_elevation is None:
        return signal.new_zeros(signal.shape[0], 1)
    up = thinned(state, state.scene.sine_elevation, STRIDES_PX).to(signal).mean(1)
    weight = _sky(state).to(signal)
    weight = (weight / weight.sum(1, keepdim=True).clamp_min(1e-12)).expand_as(signal)
    up_mean, mean = (weight * up).sum(1, keepdim=True), (weight * signal).sum(1, keepdim=True)
    spread = (weight * (up - up_mean).square()).sum(1, keepdim=True)
    both = (weight * (up - up_mean) * (signal - mean)).sum(1, keepdim=True)
    return _gradient(up_mean, mean, spread, both)


def _gradient_of_graph(state: CameraState, sine_elevation: Tensor) -> Tensor:
    """``sky_gradient`` of one sample in few operations."""
    signal, sky = state.image.signal, state.scene.sky
    sky = (torch.isinf(state.scene.depth_m) if sky is None else sky).to(signal)
    maps = [sine_elevation.to(signal), signal, sky]
    if state.receiver.cfa_index is None:
        rows = torch.cat([thinned(state, one, STRIDES_PX).mean(1) for one in maps])
        values, weight = parts_of(rows, (2, 1))
    else:  # means over the places of some cells
        rows = torch.nn.functional.avg_pool2d(torch.cat(maps), 2, STRIDES_PX).flatten(1)
        values, share = parts_of(rows, (2, 1))
        weight = (share - PARTLY_SKY).clamp_min(0.0)
    weight = weight / weight.sum(1, keepdim=True).clamp_min(1e-12)
    means = (weight * values).sum(1, keepdim=True)
    off = values - means
    spread, both = parts_of((weight * off[:1] * off).sum(1, keepdim=True), (1, 1))
    up_mean, mean = parts_of(means, (1, 1))
    return _gradient(up_mean, mean, spread, both)


def _gradient(up_mean: Tensor, mean: Tensor, spread: Tensor, both: Tensor) -> Tensor:
    """Gradient of a sky from means of the sine and of the radiance, variance of the sine and covariance of both."""
    slope = both / spread.clamp_min(LEAST_SPREAD**2)
    at_horizon = mean - slope * up_mean
    gradient = (slope / at_horizon.clamp_min(1e-6)).clamp(0.0, OVERCAST_GRADIENT)
    gradient = torch.where(at_horizon > 0, gradient, OVERCAST_GRADIENT)
    return torch.where((spread > LEAST_SPREAD**2) & (slope > 0), gradient, 0.0)


def _sky(state: CameraState) -> Tensor:
    """Share of sky of the thinned pixels, ``(1 or B, n)``; of a mosaic's cells, of those that are sky as a whole.

    Light of a cell that is sky in part is darker, and lies low: an even sky would show a gradient.
    """
    if state.scene.sky is not None:
        sky = thinned(state, state.scene.sky, STRIDES_PX)
    else:
        sky = torch.isinf(thinned(state, state.scene.depth_m, STRIDES_PX)).float()
    share = sky.mean(1)
    return share if state.receiver.cfa_index is None else (share - PARTLY_SKY).clamp_min(0.0)
