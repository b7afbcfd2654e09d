"""The picture in mirrored directions, with an estimate of what lies above its upper edge."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.camera.mosaic_blur import phases, whole
from torchweather.camera.state import CameraState

__all__ = ["seen_along"]

# Half widths over which the picture's upper edge is averaged, pixels: 2^k - 1 for k = 0 to 9, so 0 to 511.
EDGE_LEVELS = 10


def seen_along(state: CameraState, direction: Tensor, lamps: Tensor | None = None) -> Tensor:
    """The picture in other directions, in the planes of the state's signal.

    Where a ray passes d pixels above the upper edge, the mean of the picture within d rows below that edge and d
    columns to each side stands in: the farther away, the less the edge tells. A mosaic keeps its phases. Beyond the
    other edges the edge itself stands in; a level road mirrors none of them.

    Args:
        state: with the signal and the camera.
        direction: ``(B, 3, H, W)`` in the camera's frame.
        lamps: light beyond saturation, as the signal. It is seen where a ray meets it and is no part of the means: one
            lamp near the upper edge would whiten all of them.
    """
    assert state.receiver.camera is not None
    height, width = state.image.signal.shape[-2:]
    x, y, z = (direction[:, axis : axis + 1] for axis in range(3))
    # Behind the camera nothing is known: such rays end far outside of the picture, on their side of it.
    ahead = z.clamp_min(1e-2)
    x, y = state.receiver.camera.distort(x / ahead, y / ahead)
    fx, fy, cx, cy = (value.view(-1, 1, 1, 1) for value in state.scene.intrinsics.to(direction).unbind(-1))
    column = (x * fx + cx).clamp(0.0, width - 1.0)
    row = (y * fy + cy).clamp_max(height - 1.0).expand_as(state.one_plane)
    column = column.expand_as(row)
    signal = state.image.signal
    shown = signal if lamps is None else signal + lamps
    if state.receiver.cfa_index is None:
        return _at(shown, signal, row, column)
    found, planes, edges = [], phases(shown), phases(signal)
    for phase in range(4):
        down, aside = divmod(phase, 2)
        own = (..., slice(down, None, 2), slice(aside, None, 2))
        place = (row[own] - down) / 2.0, (column[own] - aside) / 2.0
        found.append(_at(planes[:, phase : phase + 1], edges[:, phase : phase + 1], *place))
    return whole(torch.cat(found, 1))


def _at(picture: Tensor, edge: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """A picture ``(B, C, H, W)`` at places ``(B, 1, h, w)`` in its pixels, above it by `_edge_means` of another."""
    height, width = picture.shape[-2:]
    across = column[:, 0] / max(width - 1, 1) * 2.0 - 1.0
    inside = _sampled(picture, across, row[:, 0] / max(height - 1, 1) * 2.0 - 1.0)
    above = -row
    level = torch.log2(1.0 + above.clamp_min(0.0))
    beyond = _sampled(_edge_means(edge), across, level[:, 0] / (EDGE_LEVELS - 1) * 2.0 - 1.0)
    return torch.where(above > 0.0, beyond, inside)


def _edge_means(picture: Tensor) -> Tensor:
    """Means at the upper edge, ``(B, C, EDGE_LEVELS, W)``: row k over 2^k rows and 2^k - 1 columns to each side."""
    levels = []
    for level in range(EDGE_LEVELS):
        aside = 2**level - 1
        strip = picture[:, :, : aside + 1].mean(2)
        levels.append(torch.nn.functional.avg_pool1d(strip, 2 * aside + 1, 1, aside, count_include_pad=False))
    return torch.stack(levels, 2)


def _sampled(picture: Tensor, across: Tensor, along: Tensor) -> Tensor:
    grid = torch.stack([across, along], -1)
    return torch.nn.functional.grid_sample(picture, grid, padding_mode="border", align_corners=True)
