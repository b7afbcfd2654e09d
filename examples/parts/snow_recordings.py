"""Snow put on clear KITTI sweeps to train in, labelled snow of WADS to test on, and a net of each point's surroundings.

A point is described by its range, height and intensity, the distances to its neighbours, and their ranges and
intensities. Rules against snow use the same (Charron et al. 2018), and they compare sensors with other rings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from parts.lidar_segmenter import NONE, WEATHER
from parts.training_arms import SNOW, drawn_snow, naive_snow
from parts.training_data import relabelled
from scipy.spatial import KDTree
from torch import Tensor, nn

import torchweather as tw
from torchweather.core.random import sample_seed
from torchweather.io import FALLING_SNOW, read_labels, read_points

SENSOR = tw.Lidar.preset("velodyne-hdl-64e")
OTHER = 0  # class of everything but snow
DEVELOPMENT, REPORTED = "042223", "042250"  # choices were made on the first; 2.7 s lie between them
OWN_VEHICLE_M = 1.5  # nearer points are the vehicle's
ROWS = 8000  # points of a sweep that the net sees
NEIGHBOURS = (1, 3, 8, 16)
DROR_STEP_RAD = math.radians(0.2)  # between columns of WADS
Sample = dict[str, Any]


def clear_sweeps(folder: Path) -> list[Sample]:
    """Sweeps of KITTI; intensity 0 to 255."""
    found = []
    for path in sorted((folder / "velodyne").glob("*.bin")):
        points = read_points(path, format="kitti").points.clone()
        points[:, 3] = (255 * points[:, 3]).round()
        beams = points[:, :3] / points[:, :3].norm(dim=1, keepdim=True)
        found.append({"points": points, "beams": beams, "classes": torch.full((len(points),), OTHER)})
    return found


def snowy_frame(folder: Path, name: str) -> tuple[Tensor, Tensor]:
    """Points ``(N, 4)`` of a frame of WADS, each once, and which are falling snow."""
    points = read_points(folder / "velodyne" / f"{name}.bin", format="kitti").points
    snow = read_labels(folder / "labels" / f"{name}.label", len(points)).classes == FALLING_SNOW
    kept = np.sort(np.unique(points[:, :3].numpy(), axis=0, return_index=True)[1])
    kept = kept[points[kept, :3].norm(dim=1).numpy() > OWN_VEHICLE_M]
    return points[kept], snow[kept]


def described(points: Tensor, rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """Nine numbers for each of those rows of a cloud without empty rows."""
    xyz, range_m = points[:, :3].numpy(), points[:, :3].norm(dim=1).numpy()
    bright, own = np.log1p(points[:, 3].numpy()), range_m[rows]
    away_m, which = KDTree(xyz, balanced_tree=False, compact_nodes=False).query(xyz[rows], k=max(NEIGHBOURS) + 1)
    near = which[:, 1:9]
    columns = [
        np.log(own),
        xyz[rows, 2],
        bright[rows],
        *(np.log(away_m[:, k] / own + 1e-4) for k in NEIGHBOURS),
        bright[near].mean(1),
        np.log(np.abs(range_m[near] - own[:, None]).mean(1) / own + 1e-4),
    ]
    return np.stack(columns, 1).astype(np.float32)


def learned_from(sweeps: list[Sample], arm: Any, seed: int, draws: int) -> tuple[Tensor, Tensor]:
    """Descriptions of points of all sweeps in the arm's weather, and which are snow."""
    choose = np.random.default_rng(seed)
    seen, snow = [], []
    for k in range(draws * len(sweeps)):
        found = arm(sweeps[k % len(sweeps)], sample_seed(seed, k))
        there = (found["classes"] != NONE) & (found["points"][:, :3].norm(dim=1) > 0)
        points, classes = found["points"][there], found["classes"][there]
        rows = choose.choice(len(points), min(ROWS, len(points)), replace=False)
        seen.append(torch.from_numpy(described(points, rows)))
        snow.append(classes[rows] == WEATHER)
    return torch.cat(seen), torch.cat(snow)


def trained(seen: Tensor, snow: Tensor, seed: int, steps: int) -> Callable[[Tensor], Tensor]:
    """A score of snow of a net with two hidden layers."""
    torch.manual_seed(seed)
    mean, spread = seen.mean(0), seen.std(0) + 1e-6
    net = nn.Sequential(nn.Linear(9, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, 1))
    optimiser = torch.optim.AdamW(net.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 1e-2, total_steps=steps)
    for _ in range(steps):
        rows = torch.randint(len(seen), (4096,))
        answer = net((seen[rows] - mean) / spread)[:, 0]
        loss = nn.functional.binary_cross_entropy_with_logits(answer, snow[rows].float())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return lambda one: net((one - mean) / spread)[:, 0].detach()


def of_rule(points: Tensor) -> Tensor:
    """Score of DROR with the intensity: few neighbours within a radius that grows with range, and dim."""
    xyz = points[:, :3].numpy()
    radius_m = np.maximum(3.0 * DROR_STEP_RAD * np.hypot(xyz[:, 0], xyz[:, 1]), 0.04)
    count = KDTree(xyz).query_ball_point(xyz, radius_m, return_length=True)
    return -torch.log(torch.from_numpy(count).float()) - points[:, 3] / 50


def arms(ablate: bool) -> dict[str, Callable[[Sample, int], Sample]]:
    """Arms by name; with `ablate` those that lack one part of the physics each."""
    found = {"naive": naive_snow, "naive, dark flakes": dark(naive_snow), "library": simulated(SENSOR)}
    found["library, drawn"] = drawn_snow(SENSOR, {})
    if ablate:
        found |= {
            "naive, scale of intensity drawn": other_scale(naive_snow),
            "library, scale of intensity drawn": other_scale(found["library"]),
            "library, drawn, scale of intensity drawn": other_scale(found["library, drawn"]),
            "library, dark flakes": dark(found["library"]),
            "library, naive intensities": other_intensities(found["library"]),
            "library, naive ranges": other_ranges(found["library"]),
            "library, no lost points": nothing_lost(found["library"]),
            "library, near response full from 3 m": simulated(replace(SENSOR, near_start_m=1.0, near_full_m=3.0)),
            "library, near response full from 30 m": simulated(replace(SENSOR, near_full_m=30.0)),
        }
    return found


def simulated(sensor: tw.Lidar) -> Callable[[Sample, int], Sample]:
    compose = tw.Compose({"points": tw.LidarWeather(None, sensor)}, weather=SNOW)
    return lambda sample, seed: relabelled(*compose.run(sample, seed=seed))


def dark(arm: Any) -> Callable[[Sample, int], Sample]:
    """Flakes of intensity 0, as nearly all are in WADS."""

    def put(sample: Sample, seed: int) -> Sample:
        found = arm(sample, seed)
        points = found["points"].clone()
        points[found["classes"] == WEATHER, 3] = 0.0
        return {**found, "points": points}

    return put


def other_scale(arm: Any) -> Callable[[Sample, int], Sample]:
    """Intensities of objects and flakes times a factor of 1/8 to 1: the median of KITTI is 71 of 255, of WADS 9."""

    def put(sample: Sample, seed: int) -> Sample:
        found, low = arm(sample, seed), math.log(1 / 8)
        points = found["points"].clone()
        points[:, 3] = torch.floor(points[:, 3] * math.exp(np.random.default_rng(seed).uniform(low, 0.0)))
        return {**found, "points": points}

    return put


def other_intensities(arm: Any) -> Callable[[Sample, int], Sample]:
    """Flakes as bright as the naive ones."""

    def put(sample: Sample, seed: int) -> Sample:
        found = arm(sample, seed)
        flakes = found["classes"] == WEATHER
        bright = np.floor(20 * np.random.default_rng(seed).random(int(flakes.sum())))
        points = found["points"].clone()
        points[flakes, 3] = torch.from_numpy(bright).float()
        return {**found, "points": points}

    return put


def other_ranges(arm: Any) -> Callable[[Sample, int], Sample]:
    """Flakes as far away as the naive ones."""

    def put(sample: Sample, seed: int) -> Sample:
        found, draw = arm(sample, seed), np.random.default_rng(seed)
        flakes, points = found["classes"] == WEATHER, found["points"].clone()
        range_m = 1 + draw.exponential(draw.uniform(2, 12), int(flakes.sum()))
        points[flakes, :3] *= (torch.from_numpy(range_m).float() / points[flakes, :3].norm(dim=1))[:, None]
        return {**found, "points": points}

    return put


def nothing_lost(arm: Any) -> Callable[[Sample, int], Sample]:
    """Points that snow hides without a return of its own stay."""

    def put(sample: Sample, seed: int) -> Sample:
        found = arm(sample, seed)
        lost = found["classes"] == NONE
        points = torch.where(lost[:, None], sample["points"], found["points"])
        return {**found, "points": points, "classes": torch.where(lost, sample["classes"], found["classes"])}

    return put
