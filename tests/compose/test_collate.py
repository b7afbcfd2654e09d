"""Samples become a batch: stacked, padded, indexed, listed; through a DataLoader with workers."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from torchweather.compose import split_indexed, split_padded
from torchweather.compose.collate import Collate
from torchweather.datasets import Boxes
from torchweather.io import PointCloud


class Samples(Dataset[dict[str, Any]]):
    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> dict[str, Any]:
        generator = torch.Generator().manual_seed(index)
        return {
            "image": torch.full((1, 4, 6), index, dtype=torch.uint8),
            "points": torch.rand(index + 1, 4, generator=generator) + 1,
            "token": f"t{index}",
            "index": index,
        }


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_pads_clouds_and_stacks_the_rest(workers: int) -> None:
    data = Samples()
    batches = list(DataLoader(data, batch_size=2, collate_fn=Collate(), num_workers=workers))
    assert [list(batch) for batch in batches] == [["image", "points", "points_mask", "token", "index"]] * 2
    assert batches[1]["points"].shape == (2, 4, 4)
    assert batches[1]["image"].dtype == torch.uint8
    assert batches[1]["token"] == ["t2", "t3"]
    assert batches[1]["index"].tolist() == [2, 3]
    back = [cloud for batch in batches for cloud in split_padded(batch["points"], batch["points_mask"])]
    for index, cloud in enumerate(back):
        assert torch.equal(cloud, data[index]["points"])


def test_clouds_of_one_length_by_chance_give_the_same_format() -> None:
    batch = Collate()([{"points": torch.ones(3, 4)}, {"points": torch.ones(3, 4)}])
    assert batch["points_mask"].tolist() == [[True] * 3] * 2


def test_clouds_as_index_column_or_list() -> None:
    samples = [Samples()[index] for index in range(3)]
    indexed = Collate(clouds_as="indexed")(samples)
    assert indexed["points"].shape == (6, 5)
    for index, cloud in enumerate(split_indexed(indexed["points"], 3)):
        assert torch.equal(cloud, samples[index]["points"])
    listed = Collate(clouds_as="list")(samples)
    assert [len(cloud) for cloud in listed["points"]] == [1, 2, 3]


def test_arrays_files_boxes_and_anything_else() -> None:
    box = Boxes(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), ())
    cloud = PointCloud(torch.ones(2, 4), ("x", "y", "z", "i"))
    samples = [
        {"points": cloud, "rows": np.ones((n, 7), np.float32), "boxes": box, "depth": np.zeros((1, 2, 2)), "rate": 2.5}
        for n in (1, 3)
    ]
    batch = Collate(clouds=("points", "rows"))(samples)
    assert batch["rows"].shape == (2, 3, 7)
    assert batch["rows_mask"].sum(1).tolist() == [1, 3]
    assert batch["boxes"] == [box, box]
    assert batch["depth"].shape == (2, 1, 2, 2)
    assert torch.equal(batch["rate"], torch.tensor([2.5, 2.5]))
    assert pickle.loads(pickle.dumps(Collate(clouds=("a",)))) == Collate(clouds=["a"])


def test_what_does_not_fit_is_named() -> None:
    collate = Collate()
    with pytest.raises(ValueError, match="got none"):
        collate([])
    with pytest.raises(ValueError, match=r"depth is only in some \(sample 1"):
        collate([{"a": 1}, {"a": 1, "depth": 2}])
    with pytest.raises(ValueError, match=r"'cloud' must have one shape.*Collate\(clouds=\(\.\.\., 'cloud'\)\)"):
        collate([{"cloud": torch.ones(2, 4)}, {"cloud": torch.ones(3, 4)}])
    with pytest.raises(ValueError, match=r"'points': collate: clouds must be \(N, C\) with one C"):
        collate([{"points": torch.ones(2, 4)}, {"points": torch.ones(3, 5)}])
    with pytest.raises(ValueError, match="points_mask"):
        collate([{"points": torch.ones(2, 4), "points_mask": 0}])
    with pytest.raises(TypeError, match="a tensor, an array or a PointCloud"):
        collate([{"points": [1, 2]}])
    with pytest.raises(ValueError, match="Did you mean 'padded'"):
        Collate(clouds_as="paded")
    with pytest.raises(TypeError, match="sequence of keys"):
        Collate(clouds="points")
