"""Local measures of large images, a strip of rows at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

__all__ = ["in_strips", "strips"]

# Values of one image in a strip: what a measure needs in between then stays in the cache of a processor, and under the
# 32 MiB beyond which the C library takes memory from the system anew for each array. Times are flat from half to twice
# this number.
STRIP_VALUES = 1 << 18


def strips(image: Tensor, reach: int) -> Iterator[slice]:
    """Rows of an image ``(..., H, W)`` in strips that overlap by ``reach``, the rows of a window less one, so that each
    window lies in one strip. Processors only: elsewhere the strip is the whole image."""
    height = image.shape[-2]
    per_row = max(1, image.numel() // max(1, height))
    rows = max(reach + 1, STRIP_VALUES // per_row) if image.device.type == "cpu" else height
    for first in range(0, height - reach, rows):
        yield slice(first, min(first + rows, height - reach) + reach)


def in_strips(local: Callable[..., Tensor], reach: int, *images: Tensor) -> Tensor:
    """Map of a local measure, found strip by strip.

    Args:
        local: of a strip ``(B, C, h, W)`` of each image to ``(B, C', h - reach, W')``.
        reach: rows of a window less one.
        images: each ``(B, C, H, W)``.
    """
    return torch.cat([local(*(image[..., rows, :] for image in images)) for rows in strips(images[0], reach)], -2)
