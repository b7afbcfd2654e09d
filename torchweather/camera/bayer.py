"""Colour filter arrays: which colour each pixel of a raw frame saw, and the way between colour images and mosaics.

Patterns are named by their top-left 2 x 2 cell read in rows: ``RGGB`` has red at row 0, column 0 and blue at row 1,
column 1. OpenCV and kornia name the same sensor ``BG`` (they read row 1, from column 1 on).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, check_one_of

__all__ = [
    "PATTERNS",
    "RCCB_TO_RGB",
    "RGB_TO_RCCB",
    "cfa_colour_index",
    "cfa_index",
    "colour_means",
    "join_planes",
    "mosaic",
    "split_planes",
]

Cell = tuple[tuple[int, int], tuple[int, int]]
Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

PATTERNS: dict[str, Cell] = {
    "RGGB": ((0, 1), (1, 2)),
    "BGGR": ((2, 1), (1, 0)),
    "GRBG": ((1, 0), (2, 1)),
    "GBRG": ((1, 2), (0, 1)),
    "RCCB": ((0, 1), (1, 2)),
}
"""Channel index (0 red, 1 green or clear, 2 blue) of each pixel of the top-left cell, by pattern name."""

# The clear pixel has no filter, so it collects what red, green and blue collect together. With every channel scaled
# so that a white surface gives 1, and the three colours taken as equally strong (an assumption: the real shares
# depend on the sensor's quantum efficiency and on the illuminant), C = (R + G + B) / 3.
RGB_TO_RCCB: Matrix = ((1.0, 0.0, 0.0), (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0), (0.0, 0.0, 1.0))
"""Assumed mixture that a red-clear-clear-blue sensor sees of a white-balanced colour: ``C = (R + G + B) / 3``."""

RCCB_TO_RGB: Matrix = ((1.0, 0.0, 0.0), (-1.0, 3.0, -1.0), (0.0, 0.0, 1.0))
"""Inverse of `RGB_TO_RCCB`: ``G = 3 C - R - B``. It triples the clear pixel's noise in green."""


def cfa_colour_index(pattern: str) -> Cell:
    """Channel index of each pixel of the top-left 2 x 2 cell: 0 red, 1 green (or clear), 2 blue.

    Args:
        pattern: one of `PATTERNS`, the top-left cell read in rows.

    Returns:
        Two rows of two indices.

    Example:
        >>> cfa_colour_index("GRBG")
        ((1, 0), (2, 1))
    """
    check_arguments("cfa_colour_index(pattern: str)", pattern)
    check_one_of("pattern", pattern, PATTERNS, owner="cfa_colour_index")
    return PATTERNS[pattern]


def cfa_index(height: int, width: int, pattern: str, device: torch.device | str | None = None) -> Tensor:
    """Channel index of every pixel of a frame: 0 red, 1 green (or clear), 2 blue.

    Args:
        height: rows of the frame, any number (odd sizes cut the last cell).
        width: columns of the frame.
        pattern: one of `PATTERNS`.
        device: where the result lives.

    Returns:
        ``(H, W)``, int64.

    Example:
        >>> cfa_index(2, 4, "RGGB")
        tensor([[0, 1, 0, 1],
                [1, 2, 1, 2]])
    """
    check_arguments("cfa_index(height: int, width: int, pattern: str)", height, width, pattern)
    for name, size in (("height", height), ("width", width)):
        if isinstance(size, int):  # a traced graph's is no number yet
            check_between(name, size, 0, 1 << 31, unit="px", owner="cfa_index")
    cell = torch.tensor(cfa_colour_index(pattern), device=device)
    row_phase = torch.arange(height, device=device) % 2
    column_phase = torch.arange(width, device=device) % 2
    return cell[row_phase[:, None], column_phase[None, :]]


def mosaic(rgb: Tensor, pattern: str, *, matrix: Tensor | None = None) -> Tensor:
    """Mosaic of a colour image: the one value per pixel that a colour filter array keeps.

    Args:
        rgb: colour image, ``(..., 3, H, W)``, linear in light.
        pattern: one of `PATTERNS`.
        matrix: ``(3, 3)``, native colours of the sensor from red, green, blue. Default: none for the Bayer
            patterns, `RGB_TO_RCCB` for ``RCCB``.

    Returns:
        Mosaic ``(..., 1, H, W)`` in the dtype of ``rgb``.

    Example:
        >>> red = torch.tensor([1.0, 0.0, 0.0])[:, None, None].expand(3, 2, 2)
        >>> mosaic(red, "RGGB")
        tensor([[[1., 0.],
                 [0., 0.]]])
    """
    check_arguments("mosaic(rgb: real, pattern: str, matrix: real(3, 3) | None)", rgb, pattern, matrix)
    _check_channels(rgb, 3, "mosaic", "rgb", "red, green, blue")
    index = cfa_index(rgb.shape[-2], rgb.shape[-1], pattern, rgb.device)
    red, green, blue = rgb.unbind(-3)
    if matrix is None and pattern == "RCCB":
        matrix = torch.tensor(RGB_TO_RCCB, dtype=rgb.dtype, device=rgb.device)
    if matrix is not None:
        red, green, blue = (row[0] * red + row[1] * green + row[2] * blue for row in matrix.to(rgb))
    return torch.where(index == 0, red, torch.where(index == 2, blue, green)).unsqueeze(-3)


def split_planes(bayer: Tensor) -> Tensor:
    """The four phases of a mosaic as planes of half the size, in the order of the cell read in rows.

    Args:
        bayer: ``(..., 1, H, W)``, H and W even.

    Returns:
        ``(..., 4, H/2, W/2)``: the pixels at (even, even), (even, odd), (odd, even), (odd, odd).

    Example:
        >>> split_planes(torch.arange(4).reshape(1, 2, 2)).flatten()
        tensor([0, 1, 2, 3])
    """
    check_arguments("split_planes(bayer: Tensor)", bayer)
    check_even(bayer, "split_planes")
    *batch, _, height, width = bayer.shape
    cells = bayer.reshape(*batch, height // 2, 2, width // 2, 2)
    return torch.movedim(cells, (-3, -1), (-4, -3)).reshape(*batch, 4, height // 2, width // 2)


def join_planes(planes: Tensor) -> Tensor:
    """The mosaic of four phase planes; the inverse of `split_planes`.

    Args:
        planes: ``(..., 4, H/2, W/2)``.

    Returns:
        ``(..., 1, H, W)``.

    Example:
        >>> mosaic_4x4 = torch.arange(16).reshape(1, 4, 4)
        >>> torch.equal(join_planes(split_planes(mosaic_4x4)), mosaic_4x4)
        True
    """
    check_arguments("join_planes(planes: Tensor)", planes)
    _check_channels(planes, 4, "join_planes", "planes", "the four phases of the cell")
    *batch, _, height, width = planes.shape
    cells = planes.reshape(*batch, 2, 2, height, width)
    return torch.movedim(cells, (-4, -3), (-3, -1)).reshape(*batch, 1, 2 * height, 2 * width)


def colour_means(
    bayer: Tensor,
    pattern: str,
    *,
    region: tuple[float, float, float, float] | None = None,
    mask: Tensor | None = None,
) -> Tensor:
    """Mean of each colour of a mosaic over a region, e.g. the light that a raindrop gathers from the scene.

    Args:
        bayer: ``(..., 1, H, W)`` float, linear in light, H and W even.
        pattern: one of `PATTERNS`.
        region: ``(top, bottom, left, right)`` as shares of the frame in [0, 1]; ``(0, 0.6, 0, 1)`` is the upper
            three fifths. A pixel belongs to it when its centre does. Default: the whole frame.
        mask: ``(..., 1, H, W)`` bool or weights, broadcast against ``bayer``: only these pixels count.

    Returns:
        ``(..., 3)``: red, green (or clear), blue. NaN for a colour of which region and mask hold no pixel.

    Example:
        >>> frame = mosaic(torch.tensor([0.2, 0.4, 0.8])[:, None, None].expand(3, 4, 4), "GBRG")
        >>> colour_means(frame, "GBRG")
        tensor([0.2000, 0.4000, 0.8000])
    """
    check_arguments(
        "colour_means(bayer: floating(..., 1, H, W), pattern: str, region: Sequence | None, mask: Tensor | None)",
        bayer,
        pattern,
        region,
        mask,
    )
    cell = cfa_colour_index(pattern)
    check_even(bayer, "colour_means")
    height, width = bayer.shape[-2:]
    weight: Tensor | None = None
    if region is not None:
        numbers = len(region) == 4 and all(isinstance(one, (int, float)) for one in region)
        top, bottom, left, right = region if numbers else (0.0,) * 4
        if not (0 <= top < bottom <= 1 and 0 <= left < right <= 1):
            raise InputValueError(
                "colour_means: region must be (top, bottom, left, right) as shares of the frame with "
                f"0 <= top < bottom <= 1 and 0 <= left < right <= 1; got {region!r}."
            )
        row = (torch.arange(height, device=bayer.device) + 0.5) / height
        column = (torch.arange(width, device=bayer.device) + 0.5) / width
        inside_rows = (row >= top) & (row < bottom)
        weight = (inside_rows[:, None] & (column >= left) & (column < right)).to(bayer.dtype)
    if mask is not None:
        if mask.ndim < 2 or tuple(mask.shape[-2:]) != (height, width):
            raise InputValueError(
                f"colour_means: mask must be (H, W) or (..., 1, H, W) of the frame; got {tuple(mask.shape)}."
            )
        weight = mask.to(bayer.dtype) if weight is None else weight * mask.to(bayer.dtype)
    sums: dict[int, list[tuple[Tensor, Tensor]]] = {0: [], 1: [], 2: []}
    for i in (0, 1):
        for j in (0, 1):
            phase = bayer[..., 0, i::2, j::2]
            if weight is None:
                # The four phases hold equally many pixels: their means can be averaged, which rounds less than sums.
                pair = phase.mean((-2, -1)), torch.ones((), dtype=bayer.dtype, device=bayer.device)
            else:
                share = weight[..., 0, i::2, j::2] if weight.ndim > 2 else weight[i::2, j::2]
                pair = (phase * share).sum((-2, -1)), share.sum((-2, -1))
            sums[cell[i][j]].append(pair)
    means = [sum(s for s, _ in found) / sum(n for _, n in found) for _, found in sorted(sums.items())]
    return torch.stack([torch.as_tensor(m) for m in means], -1)


def check_even(bayer: Tensor, owner: str) -> None:
    """Raise ``ValueError`` unless ``bayer`` has shape ``(..., 1, H, W)`` with H and W even and above zero."""
    _check_channels(bayer, 1, owner, "the mosaic", "one value per pixel")
    height, width = bayer.shape[-2:]
    if height % 2 or width % 2 or height == 0 or width == 0:
        raise InputValueError(
            f"{owner}: height and width of a mosaic must be even (whole 2 x 2 cells); got {height} x {width}. "
            "Crop a row or a column, or pad by reflection."
        )


def _check_channels(image: Tensor, channels: int, owner: str, name: str, meaning: str) -> None:
    if image.ndim < 3 or image.shape[-3] != channels:
        raise InputValueError(
            f"{owner}: {name} must have shape (..., {channels}, H, W) = {meaning}; got {tuple(image.shape)}."
        )
