"""Share of sky of each full-size pixel: 1 inside, 0 far away, a mixture of two colours between."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_max_pool2d

from torchweather.camera.depth.sky_cells import Cells, Floats, Mask, enlarged
from torchweather.camera.depth.sky_growth import VIVID, WITHIN, through_leaves

__all__ = ["sky_share"]

# Constants of this file were chosen on the frames that `sky` names.
SURE = 2  # cells inside the sky's border
NEAR = 2  # cells outside it
SPECK = 5  # cells
WINDOW = 9  # cells over which the colours of sky and ground are averaged
LEAST_CONTRAST = 0.1  # sRGB: with less between sky and ground a colour tells nothing
OFF_THE_LINE = 0.1  # sRGB: further off, a colour is no mixture of sky and leaves
FILTER_PX, FILTER_EPS = 5, 1e-3  # guided filter


def mean_of(mask: Mask, colour: Floats, fallback: Floats) -> Floats:
    """Mean colour ``(3, h, w)`` of the masked cells around each cell; ``fallback`` where there are none."""
    from scipy.ndimage import uniform_filter

    weight = mask.astype(np.float32)
    share = uniform_filter(weight, WINDOW, mode="nearest")
    total = uniform_filter(colour * weight[..., None], (WINDOW, WINDOW, 0), mode="nearest")
    mean = (total / np.maximum(share, 1e-6)[..., None]).transpose(2, 0, 1)
    return np.where(share > 0.02, mean, fallback)


def mixture(rgb: Tensor, ground: Tensor, sky: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Share of sky in a colour between ground and sky, its distance from their line, and their contrast; sRGB."""
    step = sky - ground
    square = (step * step).sum(0, keepdim=True)
    share = ((rgb - ground) * step).sum(0, keepdim=True) / square.clamp_min(1e-4)
    return share, (rgb - ground - share * step).abs().amax(0, keepdim=True), square.sqrt()


def darkest(rgb: Tensor, size: tuple[int, int]) -> Floats:
    """Darkest value of each colour of the pixels in each cell, ``(3, h, w)``."""
    dark: Floats = -adaptive_max_pool2d(-rgb[None], size)[0].numpy()
    return dark


def sky_share(rgb: Tensor, cells: Cells, sky: Mask, model: Floats, spread: Floats) -> Tensor:
    """Share of sky ``(1, H, W)`` of the pixels of ``rgb`` ``(3, H, W)``, given the cells of sky.

    In the open, the ground's colour is the mean of the cells beyond the border. Between leaves that mean is half sky
    already; there the darkest pixels around are the ground, and blueness is asked as well.
    """
    from scipy.ndimage import binary_closing, binary_dilation, binary_erosion, minimum_filter, uniform_filter

    height, width = rgb.shape[-2:]
    size = sky.shape

    def pixels(values: Floats | Mask) -> Tensor:
        return enlarged(values, height, width)

    colour = mean_of(binary_erosion(sky, border_value=1), cells.colour, model.transpose(2, 0, 1))
    blueness = colour[2] - colour[0]
    dark = darkest(rgb, size)
    dark_around = uniform_filter(dark, (0, 5, 5))
    ground = mean_of(~binary_dilation(sky, iterations=2), cells.colour, dark_around)
    leafy = np.clip((uniform_filter((cells.change > 0.1).astype(np.float32), 7) - 0.5) / 0.3, 0, 1)
    ground = ground + 0.5 * leafy * (dark_around - ground)

    sky_colour, vivid = pixels(colour), pixels(blueness > VIVID)
    open_share, _, contrast = mixture(rgb, pixels(ground), sky_colour)
    deep = uniform_filter(minimum_filter(dark, (1, 7, 7)), (0, 5, 5))
    leaf_share, off_line, _ = mixture(rgb, pixels(deep), sky_colour)
    blue_share = (rgb[2:] - rgb[:1]) / (sky_colour[2:] - sky_colour[:1]).clamp_min(VIVID)
    leaf_share = torch.minimum(leaf_share, blue_share) * vivid
    off_model = ((rgb - sky_colour).abs() / torch.from_numpy(spread)[:, None, None]).amax(0, keepdim=True)

    sure_leaf = leaf_share * ((off_line < OFF_THE_LINE) & (leaf_share < 1.2))
    alike = (off_model < WITHIN) & (vivid <= 0)
    with_gaps = through_leaves(
        cells,
        sky,
        adaptive_max_pool2d(sure_leaf[None], size)[0, 0].numpy(),
        adaptive_max_pool2d(alike.float()[None], size)[0, 0].numpy(),
        dark_around,
    )
    in_leaves = pixels(with_gaps & ~binary_dilation(sky)) * vivid
    stretched = in_leaves * (leaf_share - 0.25) / 0.5 + (1 - in_leaves) * (open_share - 0.15) / 0.7
    trust = torch.maximum(((contrast - LEAST_CONTRAST) / LEAST_CONTRAST).clamp(0, 1), in_leaves)
    # Without contrast only the cells tell; wires and specks, which made holes in them, are too fine to be ground.
    without_specks = sky | binary_closing(sky, np.ones((SPECK, SPECK), bool))
    blurred = uniform_filter(without_specks.astype(np.float32), 2 * NEAR + 1, mode="nearest")
    share = trust * stretched.clamp(0, 1) + (1 - trust) * pixels(blurred)

    sure = pixels(binary_erosion(sky, border_value=1, iterations=SURE))
    near = pixels(binary_dilation(with_gaps, iterations=NEAR))
    share = smoothed(torch.maximum(sure, share) * near, rgb, (near > 0) & (sure < 1))
    share = torch.where(sure >= 1, torch.ones_like(share), share)
    return torch.where(near <= 0, torch.zeros_like(share), share)


def smoothed(share: Tensor, rgb: Tensor, border: Tensor) -> Tensor:
    """The share along the edges of the picture's blue, where sky and ground differ most; elsewhere as it is.

    Only the part of the picture that holds the border is filtered, which costs most of the time.
    """
    from kornia.filters import guided_blur

    if not bool(border.any()):
        return share
    part = [slice(None)]
    for dim in (2, 1):
        places = border[0].any(dim - 1).nonzero()
        part.append(slice(max(0, int(places[0]) - FILTER_PX), int(places[-1]) + 1 + FILTER_PX))
    rows_columns = tuple(part)
    guide, inner = rgb[2:][rows_columns], share[rows_columns]
    if min(inner.shape[-2:]) <= FILTER_PX:  # the filter's reflected border needs more
        return share
    result = share.clone()
    result[rows_columns] = guided_blur(guide[None], inner[None], FILTER_PX, FILTER_EPS, separable=True)[0].clamp(0, 1)
    return result
