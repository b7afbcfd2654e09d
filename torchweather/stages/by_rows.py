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
    function: Callable[[int, int], Sequence[Tensor]], shape: Sequence[int], like: Tensor, out: Sequence[Tensor] | None = None
) -> tuple[Tensor, ...]:
    """Assemble the results of ``function(first_row, last_row)`` over an image of ``shape`` ``(B, 1, H, W)``.

    Args:
        function: gives one or more tensors ``(B, 1, last_row - first_row, W)``; bands begin at even rows.
        shape: of the results.
        like: gives dtype and device of the results, and whether gradients flow.
        out: where to write; ``None`` allocates.
    """
    b, _, height, width = shape
    if is_exporting() or (out is None and torch.is_grad_enabled() and like.requires_grad):
        return tuple(function(0, height))
    rows = max(2, BAND_PIXELS // max(1, b * width) // 2 * 2)
    results: list[Tensor] = list(out) if out is not None else []
    for first in range(0, height, rows):
        last = min(first + rows, height)
        for number, part in enumerate(function(first, last)):
            if part.requires_grad:
                return tuple(function(0, height))
            if number == len(results):
                results.append(torch.empty(tuple(shape), dtype=like.dtype, device=like.device))
            results[number][..., first:last, :] = part
    return tuple(results)
