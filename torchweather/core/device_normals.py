"""Tabulated normals of keyed streams by torch's integers, on the device that renders.

Bit for bit the numbers of numpy's Philox, so that a GPU does not wait for the processor's draw and a seed gives the
same weather on both.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from torchweather.core.philox import MULTIPLIERS, ROUNDS, WEYL
from torchweather.core.random import normal_table

__all__ = ["normals_by_torch"]

LOWER = 0xFFFFFFFF


def normals_by_torch(keys: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Normals of the streams of some keys, as ``normals_of_key``.

    Args:
        keys: ``(B, 2)`` int64.
        shape: of the numbers of one key.

    Returns:
        ``(B, *shape)`` float32 on the device of the keys.
    """
    number = math.prod(shape)
    counter = torch.arange(1, -(-number // 16) + 1, device=keys.device)
    nothing = torch.zeros_like(counter)
    samples = []
    for key in keys:
        a, b, c, d = counter, nothing, nothing, nothing
        of_a, of_c = key[0], key[1]
        for _ in range(ROUNDS):
            high_a, low_a = _product(MULTIPLIERS[0], a)
            high_c, low_c = _product(MULTIPLIERS[1], c)
            a, b, c, d = high_c ^ b ^ of_a, low_c, high_a ^ d ^ of_c, low_a
            of_a, of_c = of_a + _signed(WEYL[0]), of_c + _signed(WEYL[1])
        words = torch.stack([a, b, c, d], 1)
        lanes = torch.stack([(words >> shift) & 0xFFFF for shift in (0, 16, 32, 48)], 2).flatten()[:number]
        samples.append(_table(keys.device).index_select(0, lanes))
    return torch.stack(samples).reshape(len(keys), *shape)


def _product(factor: int, words: Tensor) -> tuple[Tensor, Tensor]:
    """Upper and lower 64 bits of the unsigned product; words lie in int64, whose products wrap."""
    low, high = factor & LOWER, factor >> 32
    words_low, words_high = words & LOWER, (words >> 32) & LOWER
    ends, crossed, other = low * words_low, low * words_high, high * words_low
    carried = ((ends >> 32) & LOWER) + (crossed & LOWER) + (other & LOWER)
    upper = high * words_high + ((crossed >> 32) & LOWER) + ((other >> 32) & LOWER) + (carried >> 32)
    return upper, words * _signed(factor)


def _signed(word: int) -> int:
    """The number of the same 64 bits with its sign."""
    return word - (1 << 64) if word >> 63 else word


@lru_cache(maxsize=4)
def _table(device: torch.device) -> Tensor:
    return torch.from_numpy(normal_table()).to(device)
