"""Cells of a camera's picture: light of the measured frames over the mean of the clear ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.places import CellValues, Point, quantity_of
from torchweather.gap.sensors.camera.frames import CameraFrames
from torchweather.gap.study.conditions import Condition

__all__ = ["camera_cells"]

Floats = NDArray[np.float64]

ACROSS = 48  # cells, at most; each is as high as it is wide
LEAST_PX = 4  # of a cell: two of the mosaic's own
GAMMA = 2.2  # of the picture of a frame
BRIGHTEST = 0.995  # quantile that is white
TEXTURES = (
    "difference_spread",
    "edge_contrast",
    "streak",
    "column_corr",
    "row_corr",
    "bright",
    "dark",
    "lone",
    "log_diff",
)
PER_CENT = 100.0


def camera_cells(
    model: CameraFrames, condition: Condition, statistic: str, before: Point, after: Point | None, seeds: Sequence[int]
) -> CellValues:
    """Cells of a condition's pictures; arguments as ``places.PlacesOf``."""
    frames = [condition.frames[place]["bayer"] for place in range(len(condition.frames))]
    measured = torch.stack([torch.from_numpy(np.array(frame, dtype=np.float32)) for frame in frames])
    height, width = measured.shape[1:]
    side = max(LEAST_PX, 2 * round(width / ACROSS / 2))
    clear = _light(model.scenes[condition.scene].reference[-1], side)
    texture = quantity_of(statistic, dict.fromkeys(TEXTURES, "texture"), "light") == "texture"

    def of(mosaics: Tensor) -> Floats:
        found = _texture(mosaics, side) if texture else _light(mosaics, side) / clear.clamp_min(1e-4)
        return PER_CENT * found.flatten(1).double().numpy()

    rows, columns = height // side, width // side
    return CellValues(
        "spread of neighbouring pixels" if texture else "light over clear air's",
        "% of saturation" if texture else "% of clear air's light",
        of(measured),
        of(model.simulated_pictures(condition, *before, seeds)),
        None if after is None else of(model.simulated_pictures(condition, *after, seeds)),
        np.zeros(rows * columns),
        shape=(rows, columns),
        x_name="column, px",
        y_name="row, px",
        extent=(0.0, float(columns * side), float(rows * side), 0.0),
        frame=_picture(measured[0, : rows * side, : columns * side]),
    )


def _blocks(mosaics: Tensor, side: int) -> Tensor:
    """Square blocks ``(F, h, w, side, side)`` of mosaics ``(F, H, W)``."""
    return mosaics.unfold(1, side, side).unfold(2, side, side)


def _light(mosaics: Tensor, side: int) -> Tensor:
    return _blocks(mosaics, side).mean((3, 4))


def _texture(mosaics: Tensor, side: int) -> Tensor:
    """Root mean square difference of pixels of one colour beside each other, over the root of two."""
    across = _blocks(mosaics, side)
    return (across[..., 2:] - across[..., :-2]).square().mean((3, 4)).mul(0.5).sqrt()


def _picture(mosaic: Tensor) -> Floats:
    """A mosaic in grey, as a display shows it."""
    grey = mosaic.unfold(0, 2, 2).unfold(1, 2, 2).mean((2, 3)).double().numpy()
    white = max(float(np.quantile(grey, BRIGHTEST)), 1e-6)
    found: Floats = np.clip(grey / white, 0.0, 1.0) ** (1.0 / GAMMA)
    return found
