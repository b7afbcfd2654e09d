"""Samples of two trainings: pictures of streets with a class for each pixel, scans with a class for each point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from parts.lidar_segmenter import NONE, WEATHER, Cloud
from torch import Tensor

import torchweather as tw
from torchweather.core.random import sample_seed

BATCH = 4


def picture_samples(streets: list[Any]) -> list[tuple[Tensor, Tensor, Tensor]]:
    """Pictures ``(3, H, W)`` uint8, depth ``(1, H, W)`` and classes ``(H, W)``."""
    return [
        (
            torch.from_numpy(each.picture).permute(2, 0, 1).contiguous(),
            torch.from_numpy(each.depth_m)[None].float(),
            torch.from_numpy(each.classes),
        )
        for each in streets
    ]


def picture_batches(samples: list[Any], arm: Any, seed: int, steps: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Batches of samples drawn at random, each in the arm's weather; the order is that of all arms."""
    order = np.random.default_rng(seed)
    for step in range(steps):
        chosen = [samples[k] for k in order.integers(0, len(samples), BATCH)]
        seeds = [sample_seed(seed, step * BATCH + k) for k in range(BATCH)]
        seen = [arm(picture, depth, one) for (picture, depth, _), one in zip(chosen, seeds, strict=True)]
        yield torch.stack(seen), torch.stack([classes for *_, classes in chosen])


def cloud_samples(clouds: list[Cloud]) -> list[dict[str, Any]]:
    return [{"points": each.points, "beams": each.directions, "classes": each.classes} for each in clouds]


def relabelled(sample: dict[str, Any], results: dict[str, Any]) -> dict[str, Any]:
    """Classes after the weather: its own points are weather, lost ones are of no class."""
    if not results:
        return sample
    kind = results["points"].kind
    classes = torch.where(kind == tw.PointKind.PARTICLE, WEATHER, sample["classes"])
    return {**sample, "classes": torch.where(kind == tw.PointKind.LOST, NONE, classes)}


def cloud_batches(
    samples: list[dict[str, Any]], arm: Callable[..., Any], seed: int, steps: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Points ``(B, N, 5)`` and classes ``(B, N)`` of samples drawn at random, each in the arm's weather."""
    order = np.random.default_rng(seed)
    for step in range(steps):
        chosen = [samples[k] for k in order.integers(0, len(samples), BATCH)]
        seen = [arm(one, sample_seed(seed, step * BATCH + k)) for k, one in enumerate(chosen)]
        yield torch.stack([one["points"] for one in seen]), torch.stack([one["classes"] for one in seen])
