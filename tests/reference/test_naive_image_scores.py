"""The image scores of the package against those written down from the papers, on small images of many kinds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.reference import naive_image_scores as naive
from torchweather.metrics import IMAGE_SCORES

Image = NDArray[np.float64]

# Both sides compute in float64 the same sums in another order: 1e-9 is a thousand times what remains of it.
TOLERANCE = 1e-9
# Variances of sums of squares up to 255^2, which lose digits before the logarithm.
TOLERANCE_OF_VIF = 1e-7

SCORES: dict[str, Callable[[Image, Image], float]] = {
    "psnr": naive.naive_psnr,
    "ssim": naive.naive_ssim,
    "gmsd": naive.naive_gmsd,
    "haarpsi": naive.naive_haarpsi,
    "mdsi": naive.naive_mdsi,
    "vif": naive.naive_vif,
}
COLOUR_ONLY = ("mdsi",)


def scene(channels: int, height: int, width: int, seed: int) -> Image:
    """A ramp with an edge, a disc and fine grain, another in every channel."""
    draw = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    planes = []
    for channel in range(channels):
        plane = 0.2 + 0.4 * ((channel + 1) * x + y) / ((channel + 1) * width + height)
        plane[:, width // 3 : width // 2] += 0.25 - 0.2 * channel
        plane[(x - 0.7 * width) ** 2 + (y - 0.4 * height) ** 2 < (0.2 * width) ** 2] *= 0.5 + 0.2 * channel
        planes.append(plane + 0.08 * draw.standard_normal((height, width)))
    return np.clip(np.stack(planes), 0.0, 1.0)


def blurred(image: Image) -> Image:
    found = image
    for axis in (1, 2):
        found = (np.roll(found, 1, axis) + found + np.roll(found, -1, axis)) / 3.0
    return found


def noisy(image: Image) -> Image:
    return np.clip(image + 0.1 * np.random.default_rng(3).standard_normal(image.shape), 0.0, 1.0)


DISTORTIONS: dict[str, Callable[[Image], Image]] = {
    "veil": lambda image: 0.6 * image + 0.4 * 0.85,
    "noise": noisy,
    "blur": blurred,
    "negative": lambda image: 1.0 - image,
    "shift": lambda image: np.roll(image, 2, 2),
    "contrast": lambda image: np.clip(1.6 * (image - 0.5) + 0.5, 0.0, 1.0),
}


def found(name: str, worse: Image, clear: Image) -> float:
    options = {"full_resolution": True} if name == "ssim" else {}
    return float(IMAGE_SCORES[name].function(torch.from_numpy(worse), torch.from_numpy(clear), **options))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("distortion", list(DISTORTIONS))
@pytest.mark.parametrize("name", list(SCORES))
def test_score_is_that_of_the_paper(name: str, distortion: str, channels: int) -> None:
    if channels == 1 and name in COLOUR_ONLY:
        clear = np.repeat(scene(1, 46, 52, 1), 3, 0)  # a grey image in three channels
    else:
        clear = scene(channels, 46, 52, 1)
    worse = DISTORTIONS[distortion](clear)
    wanted = SCORES[name](worse, clear)
    assert math.isfinite(wanted)
    assert wanted != pytest.approx(IMAGE_SCORES[name].ideal, abs=1e-3)  # a distortion that the score can see
    tolerance = TOLERANCE_OF_VIF if name == "vif" else TOLERANCE
    assert found(name, worse, clear) == pytest.approx(wanted, rel=tolerance, abs=tolerance)
    assert found(name, clear, worse) == pytest.approx(SCORES[name](clear, worse), rel=tolerance, abs=tolerance)


@pytest.mark.parametrize("name", list(SCORES))
def test_naive_score_of_identical_images_is_the_ideal(name: str) -> None:
    clear = scene(3, 44, 44, 2)
    # The inverse of the logistic function loses no more than 1e-9; the least variance of VIF takes 1e-8 of it.
    assert SCORES[name](clear, clear) == pytest.approx(IMAGE_SCORES[name].ideal, abs=1e-7)
