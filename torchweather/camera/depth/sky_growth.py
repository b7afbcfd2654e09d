"""From sure sky to all of it: a colour model of this sky, grown to rough ground and through gaps between leaves."""

from __future__ import annotations

import numpy as np

from torchweather.camera.depth.sky_cells import Cells, Floats, Mask

__all__ = ["colour_model", "grow", "through_leaves"]

# Constants of this file: PHOTOGRAPHS.md, section sky mask, or chosen on the frames that `sky` names.
SPREAD = (0.025, 0.05)  # sRGB: least and greatest spread of the sky about its model
WITHIN = 2.5  # spreads
ROUGH_CHANGE = 0.12  # sRGB a pixel: here the growth stops
VIVID = 0.3  # blue less red: nothing but sky has so much of it in KITTI's cyan balance, not even grey poles
PALE = 0.15  # blue less red of a patch that is thick and smooth as well
HOP = 4  # cells between two patches of vivid sky
LEAF_CHANGE = 0.1  # sRGB a pixel
LEAF_DENSITY = 0.7  # of the cells around; a straight edge gives 0.4
LEAF_WINDOW = 7  # cells


def colour_model(cells: Cells, seeds: Mask) -> tuple[Floats, Floats]:
    """Colour of the sky ``(h, w, 3)``, quadratic in row and column, and its spread ``(3,)``, fitted to the seeds.

    The ridge keeps the curvature small where the seeds cover little, and the model stays near the seeds' own colours.
    """
    height, width = seeds.shape
    row, column = np.mgrid[0:height, 0:width]
    y, x = row / height - 0.5, column / width - 0.5
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    known, value = terms[seeds], cells.colour[seeds].astype(np.float64)
    ridge = len(known) * np.diag([0.0, 1e-4, 1e-4, 3e-3, 3e-3, 3e-3]) + 1e-9 * np.eye(6)
    weights = np.linalg.solve(known.T @ known + ridge, known.T @ value)
    spread = np.sqrt(((known @ weights - value) ** 2).mean(0))
    least = SPREAD[0] * brightness(cells, seeds)
    model = np.clip(terms @ weights, value.min(0) - SPREAD[1], value.max(0) + SPREAD[1])
    return model.astype(np.float32), np.clip(spread, least, SPREAD[1]).astype(np.float32)


def brightness(cells: Cells, seeds: Mask) -> float:
    """Light of the sky, 0.3..1: edges of a dim picture are weak in this proportion."""
    return float(np.clip(cells.colour[seeds].mean(0).max(), 0.3, 1.0))


def joined(cells: Mask, steps: Mask, start: Mask) -> Mask:
    """The cells whose region in ``steps`` holds a cell of ``start``."""
    from scipy.ndimage import label

    labels, _ = label(steps)
    touched = np.unique(labels[start])
    return cells & np.isin(labels, touched[touched > 0])


def grow(cells: Cells, seeds: Mask, walls: Mask, model: Floats, spread: Floats) -> Mask:
    """Cells of sky ``(h, w)``: those alike and joined to the seeds, patches of blue beyond trees, bright clouds."""
    from scipy.ndimage import binary_dilation, binary_opening

    blueness = model[..., 2] - model[..., 0]
    alike = (np.abs(cells.colour - model) / spread).max(-1) < WITHIN
    rough = ROUGH_CHANGE * cells.steepness * brightness(cells, seeds)
    alike = (alike & (cells.change < rough) & ~walls) | seeds
    alike[cells.end_row :] = False
    smooth_blue = alike & (blueness > PALE) & (cells.change < 0.4 * ROUGH_CHANGE)
    start = seeds | binary_opening(smooth_blue, np.ones((5, 5), bool))
    steps = (binary_dilation(alike) & ~walls) | binary_dilation(alike & (blueness > VIVID), iterations=HOP)
    return with_clouds(cells, joined(alike, steps, start))


def with_clouds(cells: Cells, sky: Mask) -> Mask:
    """The sky with the holes in it that are no darker: clouds, the sun, thin wires."""
    from scipy.ndimage import label, mean

    labels, count = label(~sky)
    edges = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    light = cells.light
    least = light[sky].mean() - 0.05
    inner = np.setdiff1d(np.arange(1, count + 1), edges)
    bright = inner[mean(light, labels, inner) > least] if inner.size else inner
    filled = sky | np.isin(labels, bright)
    filled[cells.end_row :] = False
    return np.asarray(filled)


def through_leaves(cells: Cells, sky: Mask, vivid_share: Floats, alike_share: Floats, dark: Floats) -> Mask:
    """Cells that hold sky between leaves, reached from the sky by short hops; with the sky itself, ``(h, w)``.

    Args:
        cells: the photograph.
        sky: cells of sky.
        vivid_share: ``(h, w)`` greatest share of vivid blue sky of any pixel in a cell.
        alike_share: ``(h, w)`` 1 where a pixel looks like a sky without colour. Such gaps are believed between dark
            or green leaves only: windows and ornaments of a white wall have bright pixels as well.
        dark: ``(3, h, w)`` darkest colour of the pixels around a cell.
    """
    from scipy.ndimage import binary_dilation, uniform_filter

    rough = cells.change > LEAF_CHANGE * cells.steepness
    dense = uniform_filter(rough.astype(np.float32), LEAF_WINDOW) > LEAF_DENSITY
    green = dark[1] - 0.5 * dark[0] - 0.5 * dark[2] > 0.03
    vivid = vivid_share > 0.5
    gaps = vivid | ((alike_share > 0.5) & rough & dense & ((dark.max(0) < 0.3) | green)) | sky
    gaps[cells.end_row :] = False
    steps = binary_dilation(gaps, iterations=2) | binary_dilation(vivid & gaps, iterations=HOP + 1)
    return joined(gaps, steps, sky)
