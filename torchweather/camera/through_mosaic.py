"""RGB images by way of the mosaic that the camera would have recorded: sampled, weathered raw, demosaiced."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.bayer import RCCB_TO_RGB, cfa_colour_index, mosaic
from torchweather.camera.compiled_rows import bands_of
from torchweather.camera.demosaic import METHODS, demosaic, malvar_filters, malvar_in_bands, malvar_kernel
from torchweather.camera.depth import SceneDepth
from torchweather.camera.rgb_planes import linear_planes
from torchweather.camera.sensor import Camera
from torchweather.camera.srgb_bytes import byte_limits, bytes_of_light
from torchweather.camera.tone import compand, expand, quantise, srgb_encode
from torchweather.core.compiled import uses_compiled
from torchweather.core.threads import side_by_side

__all__ = ["image_of_mosaic", "mosaic_of_image", "padded", "padded_scene", "padded_size"]

SMALLEST_PX = 4  # a mosaic needs two 2 x 2 cells in each direction to be demosaiced


def mosaic_of_image(rgb: Tensor, camera: Camera) -> Tensor:
    """The camera's raw float frame ``(..., 1, H', W')`` of an sRGB image, of the padded size."""
    size = padded_size(*rgb.shape[-2:])
    if rgb.dtype == torch.uint8 and camera.bayer_pattern != "RCCB":  # whose clear pixel mixes colours of linear light
        frame = linear_planes(_sampled(padded(rgb, *size), camera.bayer_pattern))
    else:
        frame = mosaic(padded(linear_planes(rgb), *size), camera.bayer_pattern)
    return compand(frame, camera.response_knots) if camera.response_knots else frame


def _sampled(image: Tensor, pattern: str) -> Tensor:
    """The colour of each pixel of a mosaic, ``(..., 3, H, W)`` to ``(..., 1, H, W)``."""
    frame = image.new_empty(*image.shape[:-3], 1, *image.shape[-2:])
    for row, colours in enumerate(cfa_colour_index(pattern)):
        for column, colour in enumerate(colours):
            frame[..., 0, row::2, column::2] = image[..., colour, row::2, column::2]
    return frame


def image_of_mosaic(before: Tensor | None, after: Tensor, rgb: Tensor, camera: Camera, method: str) -> Tensor:
    """The image of the weather's mosaic; images whose mosaic did not change from before keep the input's own bits.

    Args:
        before: the mosaic without weather; ``None`` demosaics every image.
        after: the mosaic in weather, raw.
        rgb: the image that came in.
        camera: pattern and companding of the mosaic.
        method: of demosaicing.
    """
    height, width = rgb.shape[-2:]
    linear = expand(after, camera.response_knots) if camera.response_knots else after
    if rgb.dtype == torch.uint8 and not torch.compiler.is_compiling():
        seen = _levels(linear, camera.bayer_pattern, method)[..., :height, :width]
        if before is None:
            return seen
        own = (after == before).flatten(-3).all(-1)
        return torch.where(own[..., None, None, None], rgb, seen) if bool(own.any()) else seen
    seen = srgb_encode(demosaic(linear, camera.bayer_pattern, method)[..., :height, :width])
    unlike = torch.ones_like(after, dtype=torch.bool) if before is None else after != before
    changed = unlike.flatten(-3).any(-1)[..., None, None, None]
    if rgb.is_floating_point():
        return torch.where(changed, seen.to(rgb.dtype), rgb)
    # uint16 knows few operations: choose in int32.
    full = float(torch.iinfo(rgb.dtype).max)
    return torch.where(changed, quantise(seen, torch.int32, 0.0, full), rgb.to(torch.int32)).to(rgb.dtype)


def _levels(bayer: Tensor, pattern: str, method: str) -> Tensor:
    """sRGB levels ``(..., 3, H, W)`` of the colour image of a mosaic, uint8.

    By ``malvar`` each band is encoded while it is in the cache, and the colour image in float is never whole.
    """
    if method != METHODS[0] or bayer.dtype != torch.float32 or bayer.device.type != "cpu":
        return bytes_of_light(demosaic(bayer, pattern, method))
    *batch, _, height, width = bayer.shape
    matrix = torch.tensor(RCCB_TO_RGB) if pattern == "RCCB" else None
    out = torch.empty((*batch, 3, height, width), dtype=torch.uint8)
    if uses_compiled():
        _compiled_levels(out.view(-1, 3, height, width), bayer.detach().reshape(-1, height, width), pattern, matrix)
        return out
    seen = out.view(-1, 3, height, width)

    def fill(first: int, last: int, cells: Tensor) -> None:
        seen[:, :, first:last] = bytes_of_light(cells.reshape(len(seen), 3, last - first, width))

    with torch.no_grad():
        malvar_in_bands(bayer.reshape(-1, 1, height, width), malvar_kernel(pattern, matrix, bayer), fill)
    return out


def _compiled_levels(out: Tensor, frames: Tensor, pattern: str, matrix: Tensor | None) -> None:
    """Write the levels ``(N, 3, H, W)`` of mosaics ``(N, H, W)`` by compiled loops."""
    from torchweather.camera.compiled_mosaic import levels_of_mosaic

    filters = np.array(malvar_filters(pattern))
    mixing = (torch.empty(0, 0) if matrix is None else matrix).numpy()
    level, begins = (table.numpy() for table in byte_limits(out.device))
    side_by_side(
        [
            partial(levels_of_mosaic, seen, frame, filters, mixing, level, begins, first, last)
            for seen, frame in zip(out.numpy(), frames.contiguous().numpy(), strict=True)
            for first, last in bands_of(frames.shape[-2])
        ]
    )


def padded_size(height: int, width: int) -> tuple[int, int]:
    """The next even size of at least two cells.

    Example:
        >>> padded_size(375, 1242), padded_size(1, 1)
        ((376, 1242), (4, 4))
    """
    return max(SMALLEST_PX, math.ceil(height / 2) * 2), max(SMALLEST_PX, math.ceil(width / 2) * 2)


def padded(image: Tensor, height: int, width: int) -> Tensor:
    """``(..., H, W)`` enlarged at the bottom and right by reflection; a single row or column is repeated.

    Example:
        >>> padded(torch.tensor([[1, 2, 3]]), 2, 4)
        tensor([[1, 2, 3, 2],
                [1, 2, 3, 2]])
    """
    for axis, size in ((-2, height), (-1, width)):
        present = image.shape[axis]
        if size != present:
            index = torch.arange(size, device=image.device)
            mirrored = torch.where(index < present, index, (2 * (present - 1) - index).clamp_min(0))
            image = image.index_select(axis, mirrored)
    return image


def padded_scene(scene: SceneDepth, height: int, width: int) -> SceneDepth:
    """The scene of the padded image."""
    larger: dict[str, Any] = {
        name: padded(value, height, width)
        for name in ("depth_m", "sky", "near_mask", "ground")
        if (value := getattr(scene, name)) is not None
    }
    return replace(scene, **larger)
