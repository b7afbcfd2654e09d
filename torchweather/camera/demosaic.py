"""Colour images from raw mosaics: Malvar-He-Cutler 5 x 5 and bilinear, for every pattern.

Demosaicing is linear and repeats every two pixels. So the whole Malvar scheme is one convolution with stride 2: for
each 2 x 2 cell, a 6 x 6 window gives the twelve values (3 colours x 4 pixels) of the cell. That costs a third of
four full-size convolutions and keeps nothing that is thrown away.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from torchweather.camera.bayer import PATTERNS, RCCB_TO_RGB, cfa_colour_index, check_even
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of
from torchweather.core.precision import outside_autocast
from torchweather.core.threads import side_by_side

__all__ = ["METHODS", "demosaic", "malvar_filters", "malvar_in_bands", "malvar_kernel"]

METHODS = ("malvar", "bilinear")
"""Names of the demosaicing methods."""

# Malvar, He, Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images", ICASSP
# 2004, figure 2; all times 1/8. Rows and columns are offsets -2..2 from the pixel to be filled.
_GREEN_AT_COLOUR = (
    (0.0, 0.0, -1.0, 0.0, 0.0),
    (0.0, 0.0, 2.0, 0.0, 0.0),
    (-1.0, 2.0, 4.0, 2.0, -1.0),
    (0.0, 0.0, 2.0, 0.0, 0.0),
    (0.0, 0.0, -1.0, 0.0, 0.0),
)
_COLOUR_AT_GREEN_IN_ITS_ROW = (
    (0.0, 0.0, 0.5, 0.0, 0.0),
    (0.0, -1.0, 0.0, -1.0, 0.0),
    (-1.0, 4.0, 5.0, 4.0, -1.0),
    (0.0, -1.0, 0.0, -1.0, 0.0),
    (0.0, 0.0, 0.5, 0.0, 0.0),
)
_COLOUR_AT_GREEN_IN_ITS_COLUMN = tuple(zip(*_COLOUR_AT_GREEN_IN_ITS_ROW, strict=True))
_COLOUR_AT_OPPOSITE = (
    (0.0, 0.0, -1.5, 0.0, 0.0),
    (0.0, 2.0, 0.0, 2.0, 0.0),
    (-1.5, 0.0, 6.0, 0.0, -1.5),
    (0.0, 2.0, 0.0, 2.0, 0.0),
    (0.0, 0.0, -1.5, 0.0, 0.0),
)
_AS_MEASURED = ((0.0,) * 5, (0.0,) * 5, (0.0, 0.0, 8.0, 0.0, 0.0), (0.0,) * 5, (0.0,) * 5)

# Rows of one band on the CPU: its twelve half-size planes (3 MB at 1936 columns in float32) stay in the cache and in
# memory that the allocator already holds; fresh pages for a whole frame cost more than the arithmetic.
_BAND_ROWS = 64


@outside_autocast
def demosaic(
    bayer: Tensor,
    pattern: str,
    method: str = "malvar",
    *,
    matrix: Tensor | None = None,
    out: Tensor | None = None,
) -> Tensor:
    """Colour image from a raw mosaic.

    Values pass the known colour of each pixel through unchanged; ``malvar`` corrects the bilinear mean of the other
    two by the local curvature of the known one. Borders are reflected about the edge pixel, which keeps the colours
    of the array in place.

    Args:
        bayer: mosaic ``(..., 1, H, W)``, float32 or float64, linear in light, H and W even and 4 or more.
        pattern: one of `torchweather.image.PATTERNS`, the top-left cell read in rows.
        method: ``malvar`` (5 x 5, sharp, may overshoot at edges) or ``bilinear`` (kornia's ``raw_to_rgb``).
        matrix: ``(3, 3)``, red, green, blue from the sensor's native colours, applied after interpolation. Default:
            none for the Bayer patterns, `torchweather.image.RCCB_TO_RGB` for ``RCCB``.
        out: ``(..., 3, H, W)``, contiguous, to be filled and returned; reusing it saves the page faults of a fresh
            image. Not differentiable.

    Returns:
        ``(..., 3, H, W)`` red, green, blue in the dtype of ``bayer``. Not clipped.

    Note:
        ``malvar`` assumes that colours vary together. Balance the mosaic first where its channels differ much.

    References:
        Malvar, He, Cutler, ICASSP 2004.

    Example:
        >>> from torchweather.image import mosaic
        >>> flat = torch.tensor([0.2, 0.4, 0.8])[:, None, None].expand(3, 6, 6)
        >>> torch.allclose(demosaic(mosaic(flat, "GRBG"), "GRBG"), flat)
        True
    """
    check_arguments(
        "demosaic(bayer: Tensor, pattern: str, method: str, matrix: real(3, 3) | None, out: Tensor | None)",
        bayer,
        pattern,
        method,
        matrix,
        out,
    )
    check_one_of("pattern", pattern, PATTERNS, owner="demosaic")
    check_one_of("method", method, METHODS, owner="demosaic")
    check_even(bayer, "demosaic")
    if not bayer.is_floating_point():
        raise InputTypeError(
            f"demosaic: the mosaic must be floating point, linear in light; got {bayer.dtype}. "
            "Use torchweather.image.normalise first."
        )
    *batch, _, height, width = bayer.shape
    if height < 4 or width < 4:
        raise InputValueError(f"demosaic: the mosaic must have 4 x 4 pixels or more; got {height} x {width}.")
    if matrix is None and pattern == "RCCB":
        matrix = torch.tensor(RCCB_TO_RGB, dtype=bayer.dtype, device=bayer.device)
    if out is not None:
        _check_out(out, (*batch, 3, height, width), bayer)
    frames = bayer.reshape(-1, 1, height, width)
    if method == "bilinear":
        rgb = _bilinear(frames, pattern, matrix)
        return rgb.reshape(*batch, 3, height, width) if out is None else out.copy_(rgb.view_as(out))
    kernel = malvar_kernel(pattern, matrix, bayer)
    plain = torch.compiler.is_compiling() or bayer.device.type != "cpu"
    if out is None and (plain or (torch.is_grad_enabled() and (bayer.requires_grad or kernel.requires_grad))):
        cells = F.conv2d(F.pad(frames, (2, 2, 2, 2), mode="reflect"), kernel, stride=2)
        return F.pixel_shuffle(cells, 2).reshape(*batch, 3, height, width)
    if out is None:
        out = bayer.new_empty((*batch, 3, height, width))
    cells_out = _cells(out.view(-1, 3, height, width))

    def fill(first: int, last: int, cells: Tensor) -> None:
        cells_out[:, :, first // 2 : last // 2] = cells

    malvar_in_bands(frames, kernel, fill)
    return out


def _cells(image: Tensor) -> Tensor:
    """View of an image ``(N, 3, H, W)`` by cells, ``(N, 3, H/2, 2, W/2, 2)``."""
    count, planes, height, width = image.shape
    return image.view(count, planes, height // 2, 2, width // 2, 2)


def _bilinear(frames: Tensor, pattern: str, matrix: Tensor | None) -> Tensor:
    from kornia.color import CFA, raw_to_rgb  # imported here: it takes 0.4 s and only this method needs it

    # kornia names a sensor by the colours at (1, 1) and (1, 2), OpenCV's habit.
    names = {"RGGB": CFA.BG, "BGGR": CFA.RG, "GRBG": CFA.GB, "GBRG": CFA.GR, "RCCB": CFA.BG}
    rgb: Tensor = raw_to_rgb(frames, names[pattern])
    return rgb if matrix is None else torch.einsum("ij,njhw->nihw", matrix.to(rgb), rgb)


def malvar_in_bands(frames: Tensor, kernel: Tensor, take: Callable[[int, int, Tensor], None]) -> None:
    """Demosaic frames band by band on the processor.

    Args:
        frames: ``(N, 1, H, W)``.
        kernel: of `malvar_kernel`.
        take: gets first row, last row and the colours of each band, ``(N, 3, rows/2, 2, W/2, 2)``; bands come side by
            side from several threads.
    """
    count, _, height, width = frames.shape
    rows = max(2, min(height, _BAND_ROWS // max(count, 1))) // 2 * 2

    def fill(start: int) -> None:
        stop = min(start + rows, height)
        # Three rows or more are needed to reflect two; so the border bands always take a full cell more than they fill.
        first, last = max(start - 2, 0), min(stop + 2, height)
        above, below = 2 - (start - first), 2 - (last - stop)
        band = F.pad(frames[:, :, first:last], (2, 2, above, below), mode="reflect")
        cells = F.conv2d(band, kernel, stride=2).view(count, 3, 2, 2, (stop - start) // 2, width // 2)
        take(start, stop, cells.permute(0, 1, 4, 2, 5, 3))

    side_by_side([functools.partial(fill, start) for start in range(0, height, rows)])


@functools.cache
def _malvar_taps(pattern: str) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """Weights ``(12, 6, 6)`` (colour-major, then row and column phase), as numbers so that tracing may cache them."""
    cell = cfa_colour_index(pattern)
    taps = []
    for colour in (0, 1, 2):
        for i in (0, 1):
            for j in (0, 1):
                window = [[0.0] * 6 for _ in range(6)]
                for u, line in enumerate(_filter_at(cell, colour, i, j)):
                    for v, weight in enumerate(line):
                        window[i + u][j + v] = weight / 8.0
                taps.append(tuple(tuple(line) for line in window))
    return tuple(taps)


@functools.cache
def malvar_filters(pattern: str) -> tuple[tuple[tuple[int, ...], ...], ...]:
    """Number of the filter of each colour in each phase of the cell, ``(3, 2, 2)``, in the order of the constants.

    0 takes the pixel as measured, 1 is green at a colour, 2 and 3 a colour at green in its row and in its column, 4
    the opposite colour.
    """
    order = (_AS_MEASURED, _GREEN_AT_COLOUR, _COLOUR_AT_GREEN_IN_ITS_ROW, _COLOUR_AT_GREEN_IN_ITS_COLUMN)
    every, cell = (*order, _COLOUR_AT_OPPOSITE), cfa_colour_index(pattern)
    return tuple(
        tuple(tuple(every.index(_filter_at(cell, colour, i, j)) for j in (0, 1)) for i in (0, 1)) for colour in range(3)
    )


def _filter_at(
    cell: tuple[tuple[int, int], tuple[int, int]], colour: int, i: int, j: int
) -> tuple[tuple[float, ...], ...]:
    here = cell[i][j]
    if here == colour:
        return _AS_MEASURED
    if colour == 1:
        return _GREEN_AT_COLOUR
    if here == 1:
        return _COLOUR_AT_GREEN_IN_ITS_ROW if colour in cell[i] else _COLOUR_AT_GREEN_IN_ITS_COLUMN
    return _COLOUR_AT_OPPOSITE


def malvar_kernel(pattern: str, matrix: Tensor | None, like: Tensor) -> Tensor:
    """Weights of a cell's 6 x 6 window, ``(12, 1, 6, 6)``: colour, row and column phase."""
    kernel = torch.tensor(_malvar_taps(pattern), dtype=like.dtype, device=like.device)  # (12, 6, 6)
    if matrix is not None:
        # A colour matrix is linear too: folded into the taps it costs nothing per pixel.
        kernel = torch.einsum("ij,jkuv->ikuv", matrix.to(kernel), kernel.view(3, 4, 6, 6)).reshape(12, 6, 6)
    return kernel[:, None]  # (12, 1, 6, 6)


def _check_out(out: Tensor, shape: tuple[int, ...], like: Tensor) -> None:
    if tuple(out.shape) != shape or out.dtype != like.dtype or out.device != like.device or not out.is_contiguous():
        raise InputValueError(
            f"demosaic: out must be contiguous with shape {shape}, {like.dtype} on {like.device}; "
            f"got {tuple(out.shape)}, {out.dtype} on {out.device}."
        )
    if torch.is_grad_enabled() and like.requires_grad:
        raise InputValueError(
            "demosaic: out= cannot be used where a gradient is wanted. Leave it out, or use torch.no_grad()."
        )
