"""Evaluate a pixelwise function band by band, so that its temporaries stay in the cache.

A fresh tensor of a whole frame costs more in page faults than the arithmetic on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torch import Tensor

from torchweather.core.threads import side_by_side

__all__ = ["by_rows", "is_exporting", "rows_of"]

# Pixels in a band: 0.5 MB of float32.
BAND_PIXELS = 1 << 17

# On another device than the processor, where the number of operations counts and no cache is to be kept: 128 MB.
DEVICE_BAND_PIXELS = 1 << 25


def is_exporting() -> bool:
    """True while a graph is traced: then nothing may depend on values."""
    return torch.compiler.is_compiling()


def rows_of(image: Tensor, first: int, last: int) -> Tensor:
    """Rows ``first..last`` of an image ``(..., H, W)``, as a view; a graph has one band of all rows."""
    return image if is_exporting() else image[..., first:last, :]


def by_rows(
    function: Callable[[int, int, Tensor | None], Sequence[Tensor]],
    shape: Sequence[int],
    like: Tensor,
    out: Tensor | None = None,
    *,
    apart: bool = False,
    band_pixels: int | None = None,
) -> tuple[Tensor, ...]:
    """Assemble the results of a function over the bands of an image of ``shape`` ``(B, C, H, W)``.

    Args:
        function: takes the first and the last row and where to write its first result (or ``None``); gives one or
            more tensors ``(B, 1 or C, rows, W)``. Bands begin at even rows.
        shape: of the first result.
        like: gives dtype and device of the results; where gradients flow, the image is one band.
        out: where to write the first result; ``None`` allocates.
        apart: run the bands side by side on threads of their own, for functions of very many operations.
        band_pixels: of a band, all samples and planes together; ``None`` is ``BAND_PIXELS``. On the processor alone:
            elsewhere a band has ``DEVICE_BAND_PIXELS``.
    """
    b, c, height, width = shape
    if is_exporting() or (torch.is_grad_enabled() and like.requires_grad):
        return tuple(function(0, height, None))
    if like.device.type != "cpu":
        band_pixels = DEVICE_BAND_PIXELS
    rows = max(2, (BAND_PIXELS if band_pixels is None else band_pixels) // max(1, b * c * width) // 2 * 2)
    bands = [(first, min(first + rows, height)) for first in range(0, height, rows)]
    results = [] if out is None else [out.view(tuple(shape))]

    def fill(first: int, last: int) -> bool:
        into = results[0][..., first:last, :] if results else None
        parts = function(first, last, into)
        if any(part.requires_grad for part in parts):  # through an intensity
            return False
        for number, part in enumerate(parts):
            if number == len(results):
                size = (b, part.shape[1], height, width)
                results.append(torch.empty(size, dtype=like.dtype, device=like.device))
            if number or part is not into:
                results[number][..., first:last, :] = part
        return True

    if not all(fill(*band) for band in bands[:1]):
        return tuple(function(0, height, None))
    rest = [partial(fill, *band) for band in bands[1:]]
    if apart:
        side_by_side(rest)
    else:
        for task in rest:
            task()
    return tuple(results)
