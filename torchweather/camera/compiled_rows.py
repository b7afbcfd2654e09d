"""Arrays that compiled loops over the rows of a frame take of a camera's state, and the rows of each thread."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.core.threads import threads_at_hand

__all__ = ["NOTHING", "bands_of", "colour_rows", "map_of", "on_processor"]

Array = NDArray[np.float32]

NOTHING: Array = np.zeros((0, 0), np.float32)
"""Stands for a map that is not there."""


def on_processor(*values: Tensor | None) -> bool:
    """True where all are of single precision on the processor and no gradient flows."""
    learns = torch.is_grad_enabled()
    return all(
        one.device.type == "cpu" and one.dtype == torch.float32 and not (learns and one.requires_grad)
        for one in values
        if one is not None
    )


def map_of(value: Tensor | None, sample: int) -> Array:
    """The map ``(H, W)`` of a sample, of one ``(1 or B, 1, H, W)`` for each or for all."""
    if value is None:
        return NOTHING
    found: Array = value[min(sample, len(value) - 1), 0].detach().contiguous().numpy()
    return found


def colour_rows(state: CameraState, per_colour: Tensor) -> Array:
    """A value per colour ``(B, 3)`` at the pixels of an even and an odd row, ``(B, C, 2, W)``."""
    b, planes, _, width = state.image.signal.shape
    rows = state.per_pixel(per_colour.detach()).expand(b, planes, 1, 2, width)
    found: Array = rows[:, :, 0].contiguous().numpy()
    return found


def bands_of(height: int) -> list[tuple[int, int]]:
    """First and last row of a band for each thread."""
    rows = max(2, -(-height // threads_at_hand()))
    return [(first, min(first + rows, height)) for first in range(0, height, rows)]
