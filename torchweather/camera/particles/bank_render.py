"""Rendered optical depth of one storm on a torus, layer by layer of depth, for a bank of training weather.

The storm is that of the exact path: its slots, levels, marks and haze. Its particles lie uniformly on a torus of
pixels: what a mark covers beyond one edge is added at the opposite one, so that the storm may be displaced by any
number of pixels without a seam. Divided by the length of ray per depth, it is the same storm everywhere in the frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.particles.haze import haze_depth
from torchweather.camera.particles.population import (
    COLUMN_DEPTH,
    COLUMN_LEVEL,
    COLUMN_U,
    COLUMN_V,
    COLUMNS,
    Population,
)
from torchweather.camera.state import CameraState
from torchweather.core.random import ABSENT, keyed_stream

__all__ = ["storm_layers"]

EVEN_STEPS = (0.7548776662466927, 0.5698402909980532)  # powers of the root of x^3 = x + 1
BELOW_ONE = float(np.nextafter(np.float32(1), np.float32(0)))


def storm_layers(
    population: Population, nodes_m: Sequence[float], size: tuple[int, int], share: float, seed: int, name: str
) -> Tensor:
    """Optical depth in front of each depth, on the axis, ``(K, H, W)``.

    Args:
        population: the particles, at one rate.
        nodes_m: K rising depths, metres.
        size: H, W of the torus, pixels.
        share: of the particles that this storm has, 0..1.
        seed: of the storm.
        name: of its random streams.

    Returns:
        Of particles nearer than each depth, for a ray along the axis; float32.
    """
    with torch.no_grad():
        sharp = _listed(population, nodes_m, size, share, seed, name)
        return sharp.cumsum_(0).add_(_haze(population, nodes_m, size, share, seed, name))


def _state(
    population: Population, size: tuple[int, int], depth_m: Tensor, share: float, margin: int = 0
) -> CameraState:
    """Frames ``(K, 1, H + 2 margin, W + 2 margin)`` around the axis, at flat depths ``(K,)``."""
    height, width = size[0] + 2 * margin, size[1] + 2 * margin
    fx, fy, _, _ = population.camera.intrinsics
    number = len(depth_m)
    one = torch.ones(1, 1, 1, 1)
    return CameraState.of(
        signal=torch.zeros(1, 1, 1, 1).expand(number, 1, height, width),
        depth_m=depth_m.view(-1, 1, 1, 1).expand(number, 1, height, width),
        ray_per_depth=one.expand(1, 1, height, width),
        cfa_index=None,
        intrinsics=torch.tensor([[fx, fy, (width - 1) / 2, (height - 1) / 2]]),
        camera=population.camera,
        particle_count=torch.full((1,), share),
    )


def _listed(
    population: Population, nodes_m: Sequence[float], size: tuple[int, int], share: float, seed: int, name: str
) -> Tensor:
    """Optical depth of the listed particles of each layer, ``(K, H, W)``."""
    layers, (height, width) = len(nodes_m), size
    shells = range(len(population.tables.listed))
    reach = [population.reach_px(number) for number in shells]
    margin = math.ceil(max((max(one) for one in reach), default=0.0)) + 1
    state = _state(population, size, torch.full((layers,), torch.inf), share, margin)
    noise = {}
    for number in shells:
        generator = keyed_stream(seed, f"{name}.shell_{number}")
        shell = population.tables.listed[number]
        mean = shell.per_px2 * population.headroom() * height * width
        points = _points(mean, generator)
        quantile = np.linspace(0.0, 1.0, len(shell.log_footprint))
        foot = np.interp(points[:, COLUMN_DEPTH].numpy(), quantile, np.exp(shell.log_footprint))
        layer = torch.from_numpy(np.searchsorted(np.asarray(nodes_m), foot * population.focal_px, side="left"))
        # From the torus to the frame with margins, in whose enlarged area the exact path places its points.
        for column, pixels, beyond in ((COLUMN_U, width, reach[number][0]), (COLUMN_V, height, reach[number][1])):
            points[:, column] = (points[:, column] * pixels + (margin + beyond)) / (pixels + 2 * (margin + beyond))
        noise[f"{population.weather.kind}_shell_{number}"] = _by_layer(points, layer, layers)
    tables = population.at_rate(layers, state.air.particle_count)
    sharp, _ = population.listed_depth(state, noise, tables)
    return _folded(sharp[:, 0] / _ray_per_depth(state), margin, size)


def _points(mean: float, generator: np.random.Generator) -> Tensor:
    """Slots ``(N, 4)``: places at random, depths and levels evenly spread.

    A frame's few large drops decide its deviation and its brightest pixels. An epoch sees the same storms again and
    again, so that theirs must be those of the mean over many frames: depth and level are of a sequence of low
    discrepancy (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018) from a random start.
    """
    number = math.floor(mean + generator.random())
    points = generator.random((number, COLUMNS))
    steps = np.arange(number)
    for column, step in ((COLUMN_DEPTH, EVEN_STEPS[0]), (COLUMN_LEVEL, EVEN_STEPS[1])):
        points[:, column] = (generator.random() + steps * step) % 1.0
    return torch.from_numpy(points.astype(np.float32).clip(max=BELOW_ONE))


def _by_layer(points: Tensor, layer: Tensor, layers: int) -> Tensor:
    """Points ``(layers, slots, 4)``, each in its layer; unused slots are absent."""
    each = [points[layer == number] for number in range(layers)]
    slots = max(len(one) for one in each) + 1  # the last one tells that these are all
    spread = torch.zeros(layers, slots, COLUMNS)
    spread[..., COLUMN_LEVEL] = ABSENT
    for number, one in enumerate(each):
        spread[number, : len(one)] = one
    return spread


def _ray_per_depth(state: CameraState) -> Tensor:
    """Length of ray per depth, by which marks are larger than on the axis, ``(H, W)``."""
    height, width = state.image.signal.shape[-2:]
    fx, fy, cx, cy = state.scene.intrinsics[0].tolist()
    x, y = (torch.arange(width) - cx) / fx, (torch.arange(height) - cy) / fy
    return torch.sqrt(1 + x.square() + y[:, None].square())


def _folded(image: Tensor, margin: int, size: tuple[int, int]) -> Tensor:
    """Images ``(K, H + 2 margin, W + 2 margin)`` with their margins added at the opposite edges."""
    height, width = size
    rows = (torch.arange(height + 2 * margin) - margin) % height
    columns = (torch.arange(width + 2 * margin) - margin) % width
    narrow = image.new_zeros(len(image), height, width + 2 * margin).index_add_(1, rows, image)
    return image.new_zeros(len(image), height, width).index_add_(2, columns, narrow)


def _haze(
    population: Population, nodes_m: Sequence[float], size: tuple[int, int], share: float, seed: int, name: str
) -> Tensor:
    """Optical depth of the haze in front of each depth, ``(K, H, W)``; its noise repeats at the edges."""
    height, width = size
    generator = keyed_stream(seed, f"{name}.haze")
    shells = len(population.haze_shells)
    fields = torch.from_numpy(generator.standard_normal((1, shells, height, width), dtype=np.float32))
    noise = {f"{population.weather.kind}_haze": fields}
    # Flat frames at all depths, whose noise is smoothed once.
    state = _state(population, size, torch.tensor([float(node_m) for node_m in nodes_m]), share)
    tables = replace(population.at_rate(1, state.air.particle_count), count=None)
    return haze_depth(population, state, noise, tables, 0, height)[0][:, 0]
