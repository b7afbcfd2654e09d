"""Compiled fog: path, transmission and airlight of every pixel, row after row.

The same formulas as ``fog.ExtinctionAndAirlight``, with a polynomial for exp (relative error below 2e-7). A row's
arrays stay in the cache.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.compiled_math import blend_row, exp_of
from torchweather.core.compiled import jit

__all__ = ["fog_rows"]

Array = NDArray[np.float32]

ZERO, ONE = np.float32(0), np.float32(1)


@jit
def _path_row(path: Array, depth_m: Array, ray: Array, in_layer_m: Array, farthest_m: np.float32) -> None:
    """Length of each pixel's ray in the fog."""
    for at in range(path.size):
        path[at] = min(depth_m[at], farthest_m) * ray[at]
    for at in range(in_layer_m.size):
        path[at] = min(path[at], in_layer_m[at])


@jit
def _clear_row(clear: Array, path: Array, extinction: Array, opaque: np.float32) -> None:
    """Transmission along each path."""
    for at in range(clear.size):
        clear[at] = exp_of(max(-(extinction[at] * path[at]), -opaque))


@jit
def fog_rows(
    out: Array,
    through: Array,
    signal: Array,
    depth_m: Array,
    ray: Array,
    in_layer_m: Array,
    sky: Array,
    near: Array,
    extinction: Array,
    light: Array,
    own: Array,
    farthest_m: float,
    opaque: float,
    nothing: float,
    first: int,
    last: int,
) -> None:
    """Write the rows ``first..last`` of one foggy frame.

    Args:
        out: ``(C, H, W)``, written.
        through: ``(C, H, W)`` transmission, written, 0 where next to nothing is seen; ``(0, 0, 0)``: not wanted.
        signal: ``(C, H, W)`` of the clear frame.
        depth_m, ray: ``(H, W)`` depth and length of ray per depth.
        in_layer_m: ``(H, W)`` length of the ray up to the fog's top; ``(0, 0)``: it has none.
        sky: ``(H, W)`` share of sky; ``(0, 0)``: where the depth is infinite.
        near: ``(H, W)`` share of the own vehicle; ``(0, 0)``: none.
        extinction, light: ``(C, 2, W)`` extinction, 1/m, and airlight of the pixels of even and odd rows.
        own: ``(C,)`` share of the fog's light that a picture's sky has already; ``(0,)``: not taken off.
        farthest_m: stands for an infinite depth.
        opaque: largest optical depth.
        nothing: transmission that counts as 0.
        first, last: rows.
    """
    planes, _, width = out.shape
    path, above = np.empty(width, np.float32), np.empty(width, np.float32)
    clear, share = np.empty(width, np.float32), np.empty(width, np.float32)
    most, farthest, least = np.float32(opaque), np.float32(farthest_m), np.float32(nothing)
    layered, masked, has_sky = in_layer_m.size > 0, near.size > 0, sky.size > 0
    for row in range(first, last):
        _path_row(path, depth_m[row], ray[row], in_layer_m[row] if layered else in_layer_m.ravel(), farthest)
        if own.size > 0:
            for at in range(width):
                share[at] = sky[row, at] if has_sky else np.float32(np.isinf(depth_m[row, at]))
        for plane in range(planes):
            per_m, airlight = extinction[plane, row % 2], light[plane, row % 2]
            _clear_row(clear, path, per_m, most)
            if has_sky and layered:
                _clear_row(above, in_layer_m[row], per_m, most)
                blend_row(clear, clear, above, sky[row])
            if own.size > 0:
                for at in range(width):
                    clear[at] = ONE - (ONE - clear[at]) * (ONE - share[at] * own[plane])
            if masked:
                for at in range(width):
                    above[at] = ONE
                blend_row(clear, clear, above, near[row])
            blend_row(out[plane, row], airlight, signal[plane, row], clear)
            if through.size > 0:
                for at in range(width):
                    through[plane, row, at] = clear[at] if clear[at] > least else ZERO
