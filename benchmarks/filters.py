"""Filters of the camera and of the image scores: own code compared with kornia, in time and in value.

    python benchmarks/filters.py --out benchmarks/filters.json

Both sides of a row run in turn on one thread. The figures are medians of the processor time, so that other programs
count little, the ratio of kornia to own code, and the greatest difference of their results on random values in [0, 1).
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from kornia import filters as kf
from measure import hand_over, machine
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d

from torchweather.camera import mosaic_blur
from torchweather.camera.depth.sky_cells import steepest_change
from torchweather.camera.depth.steady import _grey, _smooth_grey
from torchweather.camera.particles.haze import _along_rows
from torchweather.metrics.filters import SCHARR, filtered, gaussian_weights, gradient_magnitude, root, side_by_side
from torchweather.metrics.strips import STRIP_VALUES

Pair = tuple[Callable[[], Tensor], Callable[[], Tensor]]  # own code, kornia
SIZES = ((480, 640), (1080, 1920))


def random(*shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0))


def inside(image: Tensor, border: int) -> Tensor:
    return image[..., border:-border, border:-border]


def crossed(image: Tensor, one: Tensor, other: Tensor, border: str) -> tuple[Tensor, Tensor]:
    """Filtered by both outer products of two rows of weights."""
    return kf.filter2d_separable(image, one, other, border), kf.filter2d_separable(image, other, one, border)


def scores(height: int, width: int) -> dict[str, Pair]:
    """Filters of the image scores."""
    strip = random(1, 12, STRIP_VALUES // (3 * width) + 10, width)  # four moments of three colours
    window = gaussian_weights(11, 1.5, strip)
    planes = random(1, 2, height, width)
    smooth, differ = (planes.new_tensor([weights]) for weights in SCHARR)
    small = gaussian_weights(5, 1.0, planes)
    five = random(1, 5, STRIP_VALUES // width, width)
    box = five.new_full((5, 1, 3, 3), 1.0 / 9.0)
    bands = random(1, 8, height // 8, width // 8).double()
    return {
        "gaussian_blur2d: windows of 11 x 11 (SSIM, VIF)": (
            lambda: filtered(strip, window, window),
            lambda: inside(kf.gaussian_blur2d(strip, 11, (1.5, 1.5), "constant"), 5),
        ),
        "filter2d_separable: Scharr's gradient (GMSD, FSIM, VSI, MDSI)": (
            lambda: gradient_magnitude(planes, *SCHARR),
            lambda: root(sum(step.square() for step in crossed(planes, smooth, differ, "constant"))),
        ),
        "filter2d_separable: every second pixel (VIF, IW-SSIM)": (
            lambda: filtered(planes, small, small, step=2),
            lambda: inside(kf.filter2d_separable(planes, small[None], small[None]), 2)[..., ::2, ::2],
        ),
        "box_blur: one sum of 3 x 3 (IW-SSIM)": (
            lambda: conv2d(side_by_side(five), box, groups=5),
            lambda: inside(kf.box_blur(five, 3, "constant", separable=False), 1),
        ),
        "box_blur: 7 x 7 coefficients, float64 (CW-SSIM)": (
            lambda: avg_pool2d(bands, 7, stride=1),
            lambda: inside(kf.box_blur(bands, 7, "constant"), 3),
        ),
    }


def camera(height: int, width: int) -> dict[str, Pair]:
    """Blurs of the effects, noise of the particles, filters of the depth."""
    cells, variance = random(1, 4, height // 2, width // 2), 192.0
    weights = cells.new_tensor([mosaic_blur._gaussian(variance / 4.0)])
    longest = len(mosaic_blur._gaussian(variance))
    rgb, angle = random(3, height, width), 0.5
    points = mosaic_blur.line_points_px(torch.tensor([6.0]), torch.tensor([angle]))
    noise, kernel = random(1, 4, 78, width) - 0.5, random(1, 4, 11)
    differ, smooth = torch.tensor([[-0.5, 0.0, 0.5]]), torch.full((1, 3), 1.0 / 3.0)
    return {
        "filter2d_separable: discrete Gaussian of 14 px (glow)": (
            lambda: mosaic_blur.gaussian_blur(cells, variance),
            lambda: kf.filter2d_separable(cells, weights, weights, "replicate"),
        ),
        "get_gaussian_discrete_kernel1d: variance 192, float64 (glow)": (
            lambda: torch.tensor(mosaic_blur._gaussian.__wrapped__(variance), dtype=torch.float64),
            lambda: kf.get_gaussian_discrete_kernel1d(longest, math.sqrt(variance), dtype=torch.float64)[0],
        ),
        "motion_blur: 6 px at 0.5 rad (ego blur)": (
            lambda: mosaic_blur.blurred_along(rgb[None], points, 3.0, 1),
            lambda: kf.motion_blur(rgb[None], 7, -math.degrees(angle), 0.0, "replicate", "bilinear"),
        ),
        "filter2d: noise of four shells along the rows (haze)": (
            lambda: _along_rows(noise, kernel, 0.0),
            lambda: kf.filter2d(noise.view(4, 1, 78, width), kernel[0, :, :, None], padding="valid").transpose(0, 1),
        ),
        "filter2d_separable: Prewitt's gradient (sky)": (
            lambda: steepest_change(rgb),
            lambda: torch.cat(crossed(rgb[None], differ, smooth, "replicate")).abs().amax((0, 1))[None],
        ),
        "box_blur: 3 x 3 (steady scenes)": (
            lambda: _smooth_grey(rgb),
            lambda: kf.box_blur(_grey(rgb)[None], 3, "replicate", separable=False)[0],
        ),
    }


def compared(pair: Pair, repeats: int) -> dict[str, float]:
    """Times of both sides, their ratio, and how far the results lie apart."""
    off = float((pair[0]() - pair[1]()).abs().max())
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats):
        for call, taken in zip(pair, times, strict=True):
            start = time.process_time()
            call()
            taken.append(1e3 * (time.process_time() - start))
    own, kornia = (statistics.median(taken) for taken in times)
    figures = {"own_ms": own, "kornia_ms": kornia, "kornia_over_own": kornia / own, "max_difference": off}
    return {name: float(f"{value:.3g}") for name, value in figures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    for height, width in SIZES:
        for name, pair in {**scores(height, width), **camera(height, width)}.items():
            with torch.no_grad():
                found.setdefault(name, {})[f"{width} x {height}"] = compared(pair, arguments.repeats)
    hand_over({"machine": machine(), "filters": found}, arguments.out)


if __name__ == "__main__":
    main()
