"""Evaluate a pixelwise function band by band, so that its temporaries stay in the cache.

A fresh tensor of a whole frame costs more in page faults than the arithmetic on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

__all__ = ["by_rows", "is_exporting"]

# Pixels in a band: 0.5 MB of float32.
BAND_PIXELS = 1 << 17


def is_exporting() -> bool:
    """True while a graph is traced: then nothing may depend on values."""
    return bool(torch.compiler.is_compiling() or torch.onnx.is_in_onnx_export())


def by_rows(
    function: Callable[[int, int, Tensor | None], Sequence[Tensor]],
    shape: Sequence[int],
    like: Tensor,
    out: Tensor | None = None,
) -> tuple[Tensor, ...]:
    """Assemble the results of a function over the bands of an image of ``shape`` ``(B, 1, H, W)``.

    Args:
        function: takes the first and the last row and where to write its first result (or ``None``); gives one or
            more tensors ``(B, 1, rows, W)``. Bands begin at even rows.
        shape: of the results.
        like: gives dtype and device of the results; where gradients flow, the image is one band.
        out: where to write the first result; ``None`` allocates.
    """
    b, _, height, width = shape
    if is_exporting() or (torch.is_grad_enabled() and like.requires_grad):
        return tuple(function(0, height, None))
    rows = max(2, BAND_PIXELS // max(1, b * width) // 2 * 2)
    results = [] if out is None else [out.view(tuple(shape))]
    for first in range(0, height, rows):
        last = min(first + rows, height)
        into = results[0][..., first:last, :] if results else None
        for number, part in enumerate(function(first, last, into)):
            if part.requires_grad:  # through a knob
                return tuple(function(0, height, None))
            if number == len(results):
                results.append(torch.empty(tuple(shape), dtype=like.dtype, device=like.device))
            if number or part is not into:
                results[number][..., first:last, :] = part
    return tuple(results)
