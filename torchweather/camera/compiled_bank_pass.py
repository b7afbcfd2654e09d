"""Compiled look-ups of `BankPass`: the numbers of its torch operations bit by bit, row after row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.core.compiled import uncontracted

__all__ = ["picture_rows"]

U32 = np.uint32  # indices without a sign need no look at negative ones
EIGHT = np.int32(8)
U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
F32 = NDArray[np.float32]


@uncontracted
def picture_rows(
    rgb: U8,
    depth_m: F32,
    ray: F32,
    base: I32,
    amplitude: F32,
    even: F32,
    level: F32,
    codes: U8,
    rows: I32,
    columns: I32,
    blended: U8,
    near_m: np.float32,
    far_m: np.float32,
    offset: np.float32,
    most: np.float32,
    first_bin: np.int32,
    first_class: np.int32,
    bin_shift: np.int32,
    class_shift: np.int32,
    out: U8,
) -> None:
    """Write a picture in weather to ``out``.

    Args:
        rgb, out: ``(3, H, W)``.
        depth_m, ray: ``(H, W)``.
        base: ``(bins,)`` place of each bin's layer in a storm's codes.
        amplitude, even: ``(bins,)``; level: ``(256,)``, as of ``BankTables``.
        codes: ``(storms, layers * pixels)``.
        rows, columns: ``(storms, H)``, ``(storms, W)`` places on the torus.
        blended: ``(3, classes * 256)``.
        near_m, far_m: limits of the bins.
        offset, most: of the optical depth's classes.
        first_bin, first_class, bin_shift, class_shift: of their bits.
    """
    height, width = depth_m.shape
    codes_0, codes_1 = codes[0], codes[1]
    red, green, blue = blended[0], blended[1], blended[2]
    across_0, across_1 = columns[0], columns[1]
    place = np.empty(width, np.uint32)  # of each pixel's class in the tables
    for v in range(height):
        depths, rays = depth_m[v], ray[v]
        down_0, down_1 = U32(rows[0, v]), U32(rows[1, v])
        for u in range(width):
            held = min(max(depths[u], near_m), far_m)
            depth_bin = U32((np.float32(held).view(np.int32) >> bin_shift) - first_bin)
            layer = U32(base[depth_bin])
            storms = level[codes_0[layer + down_0 + U32(across_0[u])]]
            storms += level[codes_1[layer + down_1 + U32(across_1[u])]]
            held = min((storms * amplitude[depth_bin] + even[depth_bin]) * rays[u] + offset, most)
            place[u] = U32(((np.float32(held).view(np.int32) >> class_shift) - first_class) << EIGHT)
        red_in, green_in, blue_in = rgb[0, v], rgb[1, v], rgb[2, v]
        red_out, green_out, blue_out = out[0, v], out[1, v], out[2, v]
        for u in range(width):
            red_out[u] = red[place[u] + U32(red_in[u])]
            green_out[u] = green[place[u] + U32(green_in[u])]
            blue_out[u] = blue[place[u] + U32(blue_in[u])]
