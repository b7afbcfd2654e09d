"""Batches of clouds: lists, padding, index columns, and their inverses."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchweather.compose.batches import (
    collate_indexed,
    collate_list,
    collate_padded,
    join_indexed,
    split_indexed,
    split_padded,
)
from torchweather.io.point_cloud import PointCloud

lengths = st.lists(st.integers(0, 5), min_size=1, max_size=5)


def clouds(sizes: list[int]) -> list[torch.Tensor]:
    return [torch.rand(size, 4, generator=torch.Generator().manual_seed(k)) for k, size in enumerate(sizes)]


def same(first: list[torch.Tensor], second: list[torch.Tensor]) -> bool:
    return len(first) == len(second) and all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@given(lengths)
@settings(max_examples=50, deadline=None)
def test_padding_comes_off_again(sizes: list[int]) -> None:
    points, mask = collate_padded(clouds(sizes))
    assert points.shape == (len(sizes), max(sizes), 4)
    assert mask.sum(dim=1).tolist() == sizes
    assert not points[~mask].any()  # range 0: beams without a return
    assert same(split_padded(points, mask), clouds(sizes))


@given(lengths, st.randoms(use_true_random=False))
@settings(max_examples=50, deadline=None)
def test_an_index_column_splits_and_joins_in_any_order_of_rows(sizes: list[int], random: object) -> None:
    batch = collate_indexed(clouds(sizes))
    assert batch.shape == (sum(sizes), 5)
    assert same(split_indexed(batch, len(sizes)), clouds(sizes))
    mixed = batch[torch.randperm(len(batch), generator=torch.Generator().manual_seed(sum(sizes)))]
    parts = split_indexed(mixed, len(sizes))
    assert torch.equal(join_indexed(parts, mixed), mixed)
    changed = join_indexed([part + 1 for part in parts], mixed)
    assert torch.equal(changed[:, 1:], mixed[:, 1:] + 1)
    assert torch.equal(changed[:, 0], mixed[:, 0])


def test_clouds_of_files_and_empty_batches() -> None:
    tensors = clouds([2, 3])
    files = [PointCloud(cloud, ("x", "y", "z", "i")) for cloud in tensors]
    assert same(collate_list(files), tensors)
    assert torch.equal(collate_indexed(files), collate_indexed(tensors))
    assert split_indexed(torch.zeros(0, 5)) == []
    assert [len(cloud) for cloud in split_indexed(torch.zeros(0, 5), 2)] == [0, 0]
    assert torch.equal(join_indexed([], torch.zeros(0, 5)), torch.zeros(0, 5))


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ValueError, match=r"got \(2, 4\), \(2, 5\)"):
        collate_padded([torch.zeros(2, 4), torch.zeros(2, 5)])
    with pytest.raises(ValueError, match="got none"):
        collate_list([])
    with pytest.raises(ValueError, match="one dtype and device"):
        collate_indexed([torch.zeros(2, 4), torch.zeros(2, 4).double()])
    # bfloat16 counts to 256: sample 257 would become 256.
    with pytest.raises(ValueError, match=r"258 samples cannot be numbered in torch\.bfloat16"):
        collate_indexed([torch.zeros(0, 4, dtype=torch.bfloat16)] * 258)
    collate_indexed([torch.zeros(0, 4, dtype=torch.bfloat16)] * 257)
    with pytest.raises(ValueError, match="sample numbers"):
        split_indexed(torch.tensor([[0.5, 1, 2, 3]]))
    with pytest.raises(ValueError, match="sample numbers"):
        split_indexed(torch.tensor([[-1.0, 1, 2, 3]]))
    with pytest.raises(ValueError, match="n_samples must be 3 or more"):
        split_indexed(torch.tensor([[2.0, 1, 2, 3]]), 2)
    with pytest.raises(ValueError, match="Where points were dropped"):
        join_indexed([torch.zeros(1, 3)], torch.zeros(2, 4))
    with pytest.raises(ValueError, match="mask"):
        split_padded(torch.zeros(2, 3, 4), torch.zeros(2, 3))
