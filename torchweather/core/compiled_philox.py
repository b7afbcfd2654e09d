"""Compiled numbers of keyed streams: those of numpy's Philox from any place on.

A stream is counter-based: number n depends on the key and on n alone. So a loop takes the numbers of a row when it
needs them, and none of the rows that it leaves out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from torchweather.core.compiled import jit
from torchweather.core.philox import MULTIPLIERS, NORMALS_A_BLOCK, ROUNDS, WEYL

__all__ = ["NORMALS_A_BLOCK", "draw_normals", "draw_uniforms", "philox_words", "write_levels"]

Words = NDArray[np.uint64]

MULTIPLIER_0, MULTIPLIER_1 = (np.uint64(one) for one in MULTIPLIERS)
UNIFORMS_A_BLOCK = 8  # 32 bits a number, the lower ones first
WORDS_AT_ONCE = 1024  # that stay in the cache; a multiple of 4
OF_24_BITS = np.float32(2.0**-24)
WEYL_0, WEYL_1 = (np.uint64(one) for one in WEYL)


def _upper_half(typingctx: Any, a: Any, b: Any) -> Any:
    """Upper 64 bits of the product of two words."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        wide = ir.IntType(128)
        product = builder.mul(builder.zext(args[0], wide), builder.zext(args[1], wide))
        return builder.trunc(builder.lshr(product, ir.Constant(wide, 64)), ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), codegen


_high_product: Any = intrinsic(_upper_half)


@jit
def philox_words(out: Words, key_0: np.uint64, key_1: np.uint64, first_block: int) -> None:
    """Write the words of a stream from a block of four on; block 0 has the counter 1, as numpy begins."""
    for block in range(out.size // 4):
        a, b, c, d = np.uint64(first_block + block + 1), np.uint64(0), np.uint64(0), np.uint64(0)
        of_a, of_c = key_0, key_1
        for _ in range(ROUNDS):
            high_a, low_a = _high_product(MULTIPLIER_0, a), MULTIPLIER_0 * a
            high_c, low_c = _high_product(MULTIPLIER_1, c), MULTIPLIER_1 * c
            a, b, c, d = high_c ^ b ^ of_a, low_c, high_a ^ d ^ of_c, low_a
            of_a, of_c = of_a + WEYL_0, of_c + WEYL_1
        out[4 * block], out[4 * block + 1], out[4 * block + 2], out[4 * block + 3] = a, b, c, d


@jit
def draw_normals(out: NDArray[np.float32], words: Words, key: Words, table: NDArray[np.float32], first: int) -> None:
    """Write tabulated normals of a stream, from number ``first`` on.

    Args:
        out: ``(n,)``, written.
        words: spare, 4 (n // 16 + 2) or more.
        key: ``(2,)`` of the stream.
        table: ``(65536,)``.
        first: 0 or more.
    """
    block = first // NORMALS_A_BLOCK
    blocks = (first + out.size - 1) // NORMALS_A_BLOCK - block + 1
    some = words[: 4 * blocks]
    philox_words(some, key[0], key[1], block)
    lanes = some.view(np.uint16)[first - NORMALS_A_BLOCK * block :]
    for at in range(out.size):
        out[at] = table[np.uint32(lanes[at])]


@jit
def draw_uniforms(out: NDArray[np.float32], key_0: np.uint64, key_1: np.uint64) -> None:
    """Write numbers of the law [0, 1) as numpy's ``Generator.random`` gives them, from the stream's first on.

    Args:
        out: ``(n,)``, written.
        key_0, key_1: of the stream.
    """
    words = np.empty(WORDS_AT_ONCE, np.uint64)
    for start in range(0, out.size, 2 * WORDS_AT_ONCE):
        some = out[start : start + 2 * WORDS_AT_ONCE]
        blocks = (some.size + UNIFORMS_A_BLOCK - 1) // UNIFORMS_A_BLOCK
        philox_words(words[: 4 * blocks], key_0, key_1, start // UNIFORMS_A_BLOCK)
        halves = words.view(np.uint32)
        for at in range(some.size):
            some[at] = np.float32(halves[at] >> np.uint32(8)) * OF_24_BITS


@jit
def write_levels(out: NDArray[np.float32], gaps: NDArray[np.float64], mean: float, absent: float) -> None:
    """Write the rising levels of a Poisson process; ``absent`` from 1 on.

    Args:
        out: ``(n,)``, written.
        gaps: ``(n,)`` of the exponential law.
        mean: number of points below 1.
        absent: in place of a level.
    """
    whole, one, none = 0.0, np.float32(1), np.float32(absent)
    for at in range(gaps.size):
        whole += gaps[at]
        level = np.float32(whole / mean)
        out[at] = level if level < one else none
