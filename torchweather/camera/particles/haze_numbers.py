"""White noise of the haze's shells from the keys of their streams: the rows that a frame takes, and no others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.particles.haze import focal_px, rows_beside, variance_before
from torchweather.camera.state import CameraState
from torchweather.core.device_normals import normals_by_torch
from torchweather.core.random import normals_of_key

if TYPE_CHECKING:
    from torchweather.camera.particles.population import AtRate, Population

__all__ = ["numbers_of_keys"]

Rows = NDArray[np.bool_]


def numbers_of_keys(keys: Tensor, population: Population, state: CameraState, tables: AtRate) -> Tensor:
    """Normals of the streams of some keys ``(B, 2)``, ``(B, J, H, W)``, on their device; drawn there if it is no
    processor.

    On the processor, rows of a shell that no pixel needs are 0. A row needs none of a shell that begins behind all that
    the row shows.

    Args:
        keys: of each sample.
        population, state, tables: as of ``haze.haze_depth``.
    """
    height, width = state.image.signal.shape[-2:]
    shape = (len(population.haze_shells), height, width)
    if keys.device.type != "cpu":
        return normals_by_torch(keys, shape)
    taken = _rows_taken(population, state, tables)
    found = np.zeros((len(keys), *shape), np.float32)
    for sample, key in enumerate(keys.numpy().view(np.uint64)):
        for shell, rows in enumerate(taken[min(sample, len(taken) - 1)]):
            for begin, end in _runs(rows):
                first = (shell * height + begin) * width
                found[sample, shell, begin:end] = normals_of_key(key, (end - begin, width), first)
    return torch.from_numpy(found)


def _rows_taken(population: Population, state: CameraState, tables: AtRate) -> list[list[Rows]]:
    """Rows of the noise of each shell that a frame takes, of each sample or one for all."""
    with torch.no_grad():
        farthest_m = state.scene.depth_m.amax(-1, keepdim=True)
        before = variance_before(population, state, tables, farthest_m)  # (1 or B, 1, H, 1)
        low = tables.haze_variance[:, [shell.first_node for shell in population.haze_shells]]
        low = low * focal_px(state)[:, None]
        reaches = (before[:, 0, :, 0][:, None] > low[:, :, None]).numpy()
    return [[_with_neighbours(rows, rows_beside(population, j)) for j, rows in enumerate(one)] for one in reaches]


def _with_neighbours(rows: Rows, beside: int) -> Rows:
    """Rows from the first to the last one and those beside them, of an image that repeats downwards."""
    places = np.flatnonzero(rows)
    found = np.zeros(len(rows), np.bool_)
    if len(places):
        found[np.arange(places[0] - beside, places[-1] + beside + 1) % len(rows)] = True
    return found


def _runs(rows: Rows) -> list[tuple[int, int]]:
    """First row and the one after the last of each run."""
    edges = np.flatnonzero(np.diff(rows.astype(np.int8), prepend=0, append=0))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
