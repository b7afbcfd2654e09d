"""Samples and batches of two trainings: cars in raw frames, classes of the points of a scan."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from parts import car_detector
from parts.car_detector import Batch, Frame, picture
from parts.lidar_segmenter import NONE, WEATHER, Cloud
from torch import Tensor
from torch.utils.data import DataLoader, RandomSampler

import torchweather as tw

BATCH = 4


def camera_samples(frames: list[Frame]) -> list[dict[str, Any]]:
    parts = [car_detector.targets(each) for each in frames]
    return [
        {"image": each.bayer, "depth": each.depth_m, "targets": part} for each, part in zip(frames, parts, strict=True)
    ]


def camera_batches(loader: DataLoader[Any], camera: tw.Camera) -> Iterator[Batch]:
    for samples in loader:
        seen = torch.stack([picture(sample["image"], camera) for sample in samples])
        positive, counts, edges = (torch.stack([sample["targets"][k] for sample in samples]) for k in range(3))
        yield seen, positive, counts, edges


def cloud_samples(clouds: list[Cloud]) -> list[dict[str, Any]]:
    return [{"points": each.points, "beams": each.directions, "classes": each.classes} for each in clouds]


def relabelled(sample: dict[str, Any], results: dict[str, Any]) -> dict[str, Any]:
    """Classes after the weather: its own points are weather, lost ones are of no class."""
    if not results:
        return sample
    kind = results["points"].kind
    classes = torch.where(kind == tw.PointKind.PARTICLE, WEATHER, sample["classes"])
    return {**sample, "classes": torch.where(kind == tw.PointKind.LOST, NONE, classes)}


def lidar_batches(loader: DataLoader[Any]) -> Iterator[tuple[Tensor, Tensor]]:
    for samples in loader:
        yield torch.stack([one["points"] for one in samples]), torch.stack([one["classes"] for one in samples])


def loader_of(
    samples: list[dict[str, Any]], transform: tw.Compose, seed: int, steps: int, after: Any = None
) -> DataLoader[Any]:
    """Batches of samples drawn at random, each in a weather of its own, whoever draws it again."""
    order = torch.Generator().manual_seed(seed)
    draws = RandomSampler(range(steps * BATCH), replacement=False, generator=order)
    repeated = [samples[k % len(samples)] for k in range(steps * BATCH)]
    data = tw.WeatherDataset(repeated, transform, seed=seed, after=after)
    return DataLoader(data, batch_size=BATCH, sampler=draws, collate_fn=list)
