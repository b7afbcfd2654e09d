"""Normals of keyed streams by torch's integers against numpy's Philox."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchweather.core.device_normals import normals_by_torch
from torchweather.core.random import Variate, draw_variates, normals_of_key


@pytest.mark.parametrize("shape", [(1,), (3, 5, 7), (2, 61, 90), (70_001,)])
def test_they_are_those_of_numpy_bit_by_bit(shape: tuple[int, ...]) -> None:
    words = np.array([[0, 0], [7, 2**64 - 5], [2**63, 0x9E3779B97F4A7C15]], np.uint64)
    found = normals_by_torch(torch.from_numpy(words.view(np.int64)), shape)
    assert found.dtype == torch.float32
    np.testing.assert_array_equal(found.numpy(), np.stack([normals_of_key(key, shape) for key in words]))


def test_keys_of_a_draw_are_those_of_its_streams() -> None:
    haze = Variate("haze", "tabulated_normal", (2, "H", "W"))
    sizes, seeds = {"H": 9, "W": 13}, [3, -8, 2**62]
    keys = draw_variates(seeds, "veil", [haze], sizes, keyed=True)["veil.haze"]
    drawn = draw_variates(seeds, "veil", [haze], sizes)["veil.haze"]
    np.testing.assert_array_equal(normals_by_torch(torch.from_numpy(keys), (2, 9, 13)).numpy(), drawn)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_device_has_the_same_bit_by_bit() -> None:
    keys = torch.tensor([[0, 0], [7, -5], [-(2**63), 2**62 + 1]])
    there = normals_by_torch(keys.cuda(), (2, 61, 90))
    assert there.is_cuda
    np.testing.assert_array_equal(there.cpu().numpy(), normals_by_torch(keys, (2, 61, 90)).numpy())
