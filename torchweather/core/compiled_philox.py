"""Compiled numbers of keyed streams: those of numpy's Philox from any place on.

A stream is counter-based: number n depends on the key and on n alone. So a loop takes the numbers of a row when it
needs them, and none of the rows that it leaves out.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from torchweather.core.compiled import jit, uncontracted
from torchweather.core.philox import MULTIPLIERS, NORMALS_A_BLOCK, ROUNDS, WEYL

__all__ = [
    "NORMALS_A_BLOCK",
    "Ziggurat",
    "draw_normals",
    "draw_standard_normals",
    "draw_uniforms",
    "philox_words",
    "write_levels",
    "ziggurat",
]

Words = NDArray[np.uint64]

MULTIPLIER_0, MULTIPLIER_1 = (np.uint64(one) for one in MULTIPLIERS)
UNIFORMS_A_BLOCK = 8  # 32 bits a number, the lower ones first
WORDS_AT_ONCE = 1024  # that stay in the cache; a multiple of 4
OF_24_BITS = np.float32(2.0**-24)
WEYL_0, WEYL_1 = (np.uint64(one) for one in WEYL)
AHEAD = 16  # numbers of 32 bits that are there before one of the normal law is drawn
CHECKED, CHECKED_KEY = 1 << 16, (np.uint64(5), np.uint64(7))  # normals that are compared once, some 17 of the tail


def _both_halves(typingctx: Any, a: Any, b: Any) -> Any:
    """Upper and lower 64 bits of the product of two words, of one multiplication."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        wide, word = ir.IntType(128), ir.IntType(64)
        product = builder.mul(builder.zext(args[0], wide), builder.zext(args[1], wide))
        halves = builder.trunc(builder.lshr(product, ir.Constant(wide, 64)), word), builder.trunc(product, word)
        return context.make_tuple(builder, signature.return_type, halves)

    pair: Any = types.UniTuple
    return pair(types.uint64, 2)(types.uint64, types.uint64), codegen


_product: Any = intrinsic(_both_halves)


@jit
def philox_words(out: Words, key_0: np.uint64, key_1: np.uint64, first_block: int) -> None:
    """Write the words of a stream from a block of four on; block 0 has the counter 1, as numpy begins."""
    for block in range(out.size // 4):
        a, b, c, d = np.uint64(first_block + block + 1), np.uint64(0), np.uint64(0), np.uint64(0)
        of_a, of_c = key_0, key_1
        for _ in range(ROUNDS):
            high_a, low_a = _product(MULTIPLIER_0, a)
            high_c, low_c = _product(MULTIPLIER_1, c)
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


class Ziggurat(NamedTuple):
    """Tables of 256 layers of the normal law, after Marsaglia and Tsang (2000), as numpy has them.

    Args:
        inside: largest whole number of 23 bits that needs no look at the density.
        width: of the layer over 2^23.
        density: at the layer's edge.
        tail, inverse_tail: where the tail begins.
    """

    inside: NDArray[np.uint32]
    width: NDArray[np.float32]
    density: NDArray[np.float32]
    tail: np.float32
    inverse_tail: np.float32


@lru_cache
def ziggurat() -> Ziggurat | None:
    """Tables with which ``draw_standard_normals`` gives numpy's bits here; ``None`` where it does not."""
    try:
        from numba.np.random import _constants as of

        tables = Ziggurat(of.ki_float, of.wi_float, of.fi_float, of.ziggurat_nor_r_f, of.ziggurat_nor_inv_r_f)
        found = np.empty(CHECKED, np.float32)
        draw_standard_normals(found, CHECKED_KEY[0], CHECKED_KEY[1], tables)
    except (ImportError, AttributeError):  # they are no public part of numba
        return None
    numpys = np.random.Generator(np.random.Philox(key=np.array(CHECKED_KEY, np.uint64)))
    return tables if np.array_equal(found, numpys.standard_normal(CHECKED, dtype=np.float32)) else None


@uncontracted
def draw_standard_normals(out: NDArray[np.float32], key_0: np.uint64, key_1: np.uint64, tables: Ziggurat) -> None:
    """Write normals as numpy's ``Generator.standard_normal`` gives them, from the stream's first on.

    Args:
        out: ``(n,)``, written.
        key_0, key_1: of the stream.
        tables: of the layers.
    """
    inside, width, density = tables.inside, tables.width, tables.density
    words = np.empty(WORDS_AT_ONCE, np.uint64)
    halves = words.view(np.uint32)
    count, block, at = 0, 0, 0
    philox_words(words, key_0, key_1, block)
    while count < out.size:
        if at + AHEAD > halves.size:
            block += at // UNIFORMS_A_BLOCK
            at %= UNIFORMS_A_BLOCK
            philox_words(words, key_0, key_1, block)
        bits = halves[at]
        at += 1
        layer = bits & np.uint32(0xFF)
        whole = np.uint32(bits >> np.uint32(9))
        x = np.float32(np.int32(whole)) * width[layer]
        x = -x if bits & np.uint32(0x100) else x
        if whole < inside[layer]:
            out[count] = x
            count += 1
            continue
        if layer > 0:
            share = np.float32(halves[at] >> np.uint32(8)) * OF_24_BITS
            at += 1
            if (density[layer - 1] - density[layer]) * share + density[layer] < math.exp(
                -0.5 * np.float64(x) * np.float64(x)
            ):
                out[count] = x
                count += 1
            continue
        while True:
            if at + AHEAD > halves.size:
                block += at // UNIFORMS_A_BLOCK
                at %= UNIFORMS_A_BLOCK
                philox_words(words, key_0, key_1, block)
            beyond = -tables.inverse_tail * np.log1p(-np.float32(halves[at] >> np.uint32(8)) * OF_24_BITS)
            y = -np.log1p(-np.float32(halves[at + 1] >> np.uint32(8)) * OF_24_BITS)
            at += 2
            if y + y > beyond * beyond:
                out[count] = -(tables.tail + beyond) if (whole >> np.uint32(8)) & np.uint32(1) else tables.tail + beyond
                count += 1
                break
