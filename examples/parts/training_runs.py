"""Many trainings of one comparison: nets of each arm and seed side by side, in a run that may stop and go on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from parts import lidar_segmenter, snow_points, street_net
from parts.training_arms import cloud_arms, picture_arms
from parts.training_data import cloud_batches, picture_batches
from torch import Tensor

import torchweather as tw

Test = tuple[str, str]
"""Simulator (independent, own) and name of a test."""

Item, Result = TypeVar("Item"), TypeVar("Result")


class Comparison(Protocol):
    """Samples, arms and tests of one sensor."""

    def arms(self) -> dict[str, Any]: ...

    def scores(self, arm: str, seed: int) -> dict[Test, float]:
        """Of a net that was trained in the weather of this arm, from this seed, in each test."""
        ...


@dataclass(frozen=True)
class Pictures:
    """A class for each pixel: pictures ``(B, 3, H, W)``, depth ``(B, 1, H, W)``, classes ``(B, H, W)``."""

    samples: tuple[Tensor, Tensor, Tensor]
    tests: dict[Test, Tensor]
    classes: Tensor
    class_count: int
    camera: dict[str, Any]
    ablate: bool
    steps: int
    device: str = "cpu"

    def arms(self) -> dict[str, Any]:
        return picture_arms(tw.Camera.from_dict(self.camera), self.ablate)

    def scores(self, arm: str, seed: int) -> dict[Test, float]:
        samples = list(zip(*self.samples, strict=True))
        batches = picture_batches(samples, self.arms()[arm], seed, self.steps)
        net = street_net.trained(batches, self.steps, seed, self.class_count, self.device)
        return {test: street_net.mean_iou(net, seen, self.classes) for test, seen in self.tests.items()}


@dataclass(frozen=True)
class Clouds:
    """Snow or not for each point: clear samples, and points ``(B, N, 5)`` and classes ``(B, N)`` of each test."""

    samples: list[dict[str, Any]]
    tests: dict[Test, tuple[Tensor, Tensor]]
    steps: int
    device: str = "cpu"

    def arms(self) -> dict[str, Any]:
        return cloud_arms()

    def scores(self, arm: str, seed: int) -> dict[Test, float]:
        batches = cloud_batches(self.samples, self.arms()[arm], seed, self.steps)
        net = lidar_segmenter.trained(batches, self.steps, seed, self.device)
        return {test: snow_points.of_net(net, *seen) for test, seen in self.tests.items()}


def trainings(
    comparison: Comparison, arms: Sequence[str], seeds: int, processes: int, path: Path, settings: dict[str, Any]
) -> dict[str, list[dict[Test, float]]]:
    """Scores of each arm by seed. Each is kept in a file as soon as it is known, and taken from there when all
    ``settings`` are those of the run that wrote it."""
    known = dict(kept(path, settings))
    left = [(arm, seed) for seed in range(seeds) for arm in arms if (arm, seed) not in known]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for (arm, seed), scores in _trained(comparison, left, processes):
            known[arm, seed] = scores
            line = {"settings": settings, "arm": arm, "seed": seed, "scores": [[*k, v] for k, v in scores.items()]}
            file.write(json.dumps(line) + "\n")
            file.flush()
            print(f"{arm}, seed {seed}: {sum(scores.values()) / len(scores):.3f} in the mean", flush=True)
    return {arm: [known[arm, seed] for seed in range(seeds)] for arm in arms}


def kept(path: Path, settings: dict[str, Any]) -> Iterator[tuple[tuple[str, int], dict[Test, float]]]:
    """Scores of an earlier run with the same settings, by arm and seed."""
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        one = json.loads(line)
        if one["settings"] == settings:
            scores = {(simulator, test): score for simulator, test, score in one["scores"]}
            yield (one["arm"], one["seed"]), scores


def side_by_side(function: Callable[[Item], Result], items: Sequence[Item], processes: int) -> list[Result]:
    """The function of each item, in their order; of a module, so that another process finds it."""
    if processes == 1:
        return [function(one) for one in items]
    with _pool(processes, _one_thread) as pool:
        return list(pool.map(function, items))


def _trained(
    comparison: Comparison, left: Sequence[tuple[str, int]], processes: int
) -> Iterator[tuple[tuple[str, int], dict[Test, float]]]:
    """In the order in which they end."""
    if processes == 1:
        yield from ((one, comparison.scores(*one)) for one in left)
        return
    with _pool(processes, _receive, comparison) as pool:
        runs = {pool.submit(_of_received, *one): one for one in left}
        for run in as_completed(runs):
            yield runs[run], run.result()


def _pool(processes: int, initializer: Callable[..., None], *given: Any) -> ProcessPoolExecutor:
    """Processes started anew, as a graphics card cannot be used in a copy; tensors are shared, not copied."""
    context = torch.multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, context, initializer, given)


def _one_thread() -> None:
    torch.set_num_threads(1)


_received: list[Comparison] = []


def _receive(comparison: Comparison) -> None:
    _one_thread()
    _received[:] = [comparison]


def _of_received(arm: str, seed: int) -> dict[Test, float]:
    return _received[0].scores(arm, seed)
