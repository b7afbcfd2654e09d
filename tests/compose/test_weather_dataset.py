"""A data set in weather: the same for the same seed, index and epoch, whatever the workers."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

import torchweather as tw

LIDAR = tw.Lidar.preset("velodyne-hdl-64e")


class Clouds(Dataset[Any]):
    def __len__(self) -> int:
        return 6

    def __getitem__(self, index: int) -> dict[str, Any]:
        along = torch.randn(100, 3, generator=torch.Generator().manual_seed(index))
        return {"points": torch.cat([10 * along, torch.full((100, 1), 80.0)], -1), "index": index}


def rainy(**more: Any) -> tw.WeatherDataset:
    lidar = tw.LidarRain(tw.Rain(rate_mm_per_h=(5, 80)), LIDAR)
    return tw.WeatherDataset(Clouds(), tw.Compose({"points": lidar}, p=0.8), seed=7, **more)


def epoch(loader: DataLoader[Any]) -> Tensor:
    batches = list(loader)
    order = torch.cat([batch["index"] for batch in batches]).argsort()
    return torch.cat([batch["points"] for batch in batches])[order]


@pytest.fixture(scope="module")
def alone() -> list[Tensor]:
    """Two epochs, without workers."""
    data, found = rainy(), []
    for number in (0, 1):
        data.set_epoch(number)
        found.append(torch.stack([data[k]["points"] for k in range(len(data))]))
    return found


def test_the_weather_is_another_one_for_each_sample_and_epoch(alone: list[Tensor]) -> None:
    first, second = alone
    assert not torch.equal(first, second)
    data = rainy()
    assert torch.equal(data[-1]["points"], first[-1])
    other = tw.WeatherDataset(Clouds(), data.transform, seed=8)
    assert not torch.equal(torch.stack([other[k]["points"] for k in range(6)]), first)


@pytest.mark.parametrize("workers", [1, 2])
def test_it_does_not_depend_on_the_workers(alone: list[Tensor], workers: int) -> None:
    loader = DataLoader(rainy(), batch_size=2, shuffle=True, num_workers=workers, multiprocessing_context="fork")
    assert torch.equal(epoch(loader), alone[0])


def test_workers_that_live_on_see_the_next_epoch(alone: list[Tensor]) -> None:
    data = rainy()
    loader = DataLoader(
        data, batch_size=3, num_workers=2, persistent_workers=True, multiprocessing_context="fork", prefetch_factor=1
    )
    assert torch.equal(epoch(loader), alone[0])
    data.set_epoch(1)
    assert torch.equal(epoch(loader), alone[1])


@pytest.mark.slow
def test_spawned_workers_see_it_too(alone: list[Tensor]) -> None:
    data = rainy()
    data.set_epoch(1)
    loader = DataLoader(data, batch_size=6, num_workers=1, multiprocessing_context="spawn")
    assert torch.equal(epoch(loader), alone[1])


def test_labels_follow_with_what_happened_to_the_points() -> None:
    def counted(sample: dict[str, Any], results: dict[str, Any]) -> dict[str, Any]:
        return {**sample, "clear": not results, "kept": results and results["points"].transmission.mean()}

    data = rainy(after=counted)
    assert {data[k]["clear"] for k in range(6)} == {False, True}
    assert all(data[k]["clear"] or 0.5 < data[k]["kept"] < 1.0 for k in range(6))
    assert torch.equal(data[0]["points"], rainy()[0]["points"])
