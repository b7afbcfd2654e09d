"""Particles of successive frames: the same drops, moved by fall speed, wind and ego motion.

A listed particle is a point of the unit cube (image column, image row, quantile of depth, level). Slots are uniform
in that cube, whose measure is volume times number density, and both are carried along unchanged by the particles'
motion. So a frame follows from the one before by moving every particle; one that leaves the cube makes room for
one that enters, uniform in the part of the cube which the motion fills from outside. The numbers of every frame are
those of a single frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.particles.population import (
    COLUMN_DEPTH,
    COLUMN_LEVEL,
    COLUMN_U,
    COLUMN_V,
    COLUMNS,
    Population,
)
from torchweather.core.random import ABSENT, keyed_stream
from torchweather.core.threads import one_thread_an_operation

__all__ = ["next_frame"]

MOST_ROUNDS = 64  # of rejection
FEWEST_CANDIDATES, MOST_CANDIDATES = 1 << 10, 1 << 18  # of a round


def next_frame(
    population: Population,
    noise: Mapping[str, Tensor],
    size: tuple[int, int],
    interval_s: float,
    seed: int,
    stream: str,
    frame: int,
) -> dict[str, Tensor]:
    """Noise of the next frame of one sample.

    Args:
        population: the particles; its rate must be one number.
        noise: this sample's noise of the present frame, variate name to ``(slots, 4)`` or ``(J, H, W)``.
        size: H, W of the frame.
        interval_s: time from frame to frame.
        seed: the sample's integer.
        stream: name of the stage, to which the streams of newcomers belong.
        frame: number of the next frame, from 1.

    Returns:
        The same names to the next frame's arrays.
    """
    moved: dict[str, Tensor] = {}
    kind = population.weather.kind
    motion = _Motion(population, size, interval_s)
    with one_thread_an_operation():
        for number in range(len(population.tables.listed)):
            name = f"{kind}_shell_{number}"
            generator = keyed_stream(seed, f"{stream}.{name}.frame_{frame}")
            moved[name] = motion.advance(noise[name], number, generator)
    name = f"{kind}_haze"
    moved[name] = _rolled(population, noise[name], interval_s, frame)
    return moved


class _Motion:
    """The flow of one population in the unit cubes of its shells, for one frame interval."""

    def __init__(self, population: Population, size: tuple[int, int], interval_s: float) -> None:
        self.population, self.interval_s = population, interval_s
        self.height, self.width = size
        self.tables = population.at_rate(1)
        fx, fy, cx, cy = population.camera.intrinsics
        self.intrinsics = torch.tensor([fx, fy, cx, cy], dtype=torch.float64)
        self.focal = math.sqrt(fx * fy)

    def advance(self, points: Tensor, number: int, generator: np.random.Generator) -> Tensor:
        """Points ``(slots, 4)`` one interval later."""
        present = points[:, COLUMN_LEVEL] < ABSENT
        cube = points.double().clone()
        after = self._flow(cube, number, 1.0)
        left = present & ~_inside(after)
        cube = torch.where((present & ~left)[:, None], after, cube)
        missing = left.nonzero().squeeze(1)
        filled, tried = 0, FEWEST_CANDIDATES + 4 * len(missing)
        for _ in range(MOST_ROUNDS):
            if filled == len(missing):
                break
            tried = min(2 * tried, MOST_CANDIDATES)
            fresh = torch.from_numpy(generator.random((tried, COLUMNS), dtype=np.float32)).double()
            entering = fresh[~_inside(self._flow(fresh, number, -1.0))][: len(missing) - filled]
            cube[missing[filled : filled + len(entering)]] = entering
            filled += len(entering)
        # Where the motion is too small to bring newcomers, the few that left stay out.
        cube[missing[filled:], COLUMN_LEVEL] = ABSENT
        return cube.float()

    def _flow(self, cube: Tensor, number: int, direction: float) -> Tensor:
        """Carry points along by one interval, forward or back."""
        p, t = self.population, self.population.tables
        reach_u, reach_v = p.reach_px(number)
        fx, fy, cx, cy = self.intrinsics.tolist()
        quantiles = t.listed[number].log_footprint
        nodes = np.linspace(0.0, 1.0, len(quantiles))
        foot_nodes = np.exp(quantiles)
        foot = _interpolate(cube[:, COLUMN_DEPTH], nodes, foot_nodes)
        most_nodes = t.log_at(t.tail_most, quantiles)
        most = _interpolate(cube[:, COLUMN_DEPTH], nodes, most_nodes)
        u = cube[:, COLUMN_U] * (self.width + 2 * reach_u) - (reach_u + 0.5)
        v = cube[:, COLUMN_V] * (self.height + 2 * reach_v) - (reach_v + 0.5)
        x, y = p.undistorted(u, v, self.intrinsics)
        scale = p.camera.magnification(x, y)
        log_level = torch.log(cube[:, COLUMN_LEVEL].clamp(1e-30, 1.0)) + most + torch.log(scale)
        log_level = log_level + math.log(p.headroom())
        stop = ((log_level - t.log_level_low) / t.log_level_step).numpy()
        fall = np.interp(stop, np.arange(self.tables.fall_speed.shape[1]), self.tables.fall_speed[0].double().numpy())
        speed = torch.from_numpy(fall)
        depth = foot * self.focal
        step = direction * self.interval_s
        vx, vy, vz = (d * speed + w for d, w in zip(p.down, p.drift_m_per_s, strict=True))
        new_depth = (depth + vz * step).clamp_min(1e-6)
        new_x = (x * depth + vx * step) / new_depth
        new_y = (y * depth + vy * step) / new_depth
        new_foot = new_depth / self.focal
        xd, yd = p.camera.distort(new_x, new_y) if p.camera.distorted else (new_x, new_y)
        out = cube.clone()
        out[:, COLUMN_U] = (xd * fx + cx + reach_u + 0.5) / (self.width + 2 * reach_u)
        out[:, COLUMN_V] = (yd * fy + cy + reach_v + 0.5) / (self.height + 2 * reach_v)
        if bool((vz != 0).any()):
            rank = np.interp(new_foot.numpy(), foot_nodes, nodes, left=-1.0, right=2.0)
            out[:, COLUMN_DEPTH] = torch.from_numpy(rank)
        if bool((vz != 0).any()) or p.camera.distorted:
            new_most = _interpolate(out[:, COLUMN_DEPTH].clamp(0, 1), nodes, most_nodes)
            new_scale = p.camera.magnification(new_x, new_y)
            out[:, COLUMN_LEVEL] = torch.exp(log_level - math.log(p.headroom()) - new_most - torch.log(new_scale))
        return out


def _inside(cube: Tensor) -> Tensor:
    return ((cube >= 0) & (cube < 1)).all(1)


def _interpolate(position: Tensor, nodes: NDArray[np.float64], values: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(np.interp(position.numpy(), nodes, values))


def _rolled(population: Population, field: Tensor, interval_s: float, frame: int) -> Tensor:
    """Haze maps moved by whole pixels along their mean motion; they repeat at the frame's edge."""
    t = population.tables
    velocity = [
        d * t.haze_speed_m_per_s + w for d, w in zip(population.down[:2], population.drift_m_per_s[:2], strict=True)
    ]
    maps = []
    for number, shell in enumerate(population.haze_shells):
        middle = math.exp(t.log_footprint_low + t.log_footprint_step * 0.5 * (shell.first_node + shell.last_node))
        columns, rows = (
            round(v * interval_s * frame / middle) - round(v * interval_s * (frame - 1) / middle) for v in velocity
        )
        maps.append(torch.roll(field[number], (rows, columns), (-2, -1)))
    return torch.stack(maps)
