"""All image scores by their names: what they state of themselves holds."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.metrics import IMAGE_SCORES, ImageScore, image_scores

SIDE = 161  # the largest of the least sizes


def clear(channels: int = 3) -> Tensor:
    """Smooth random texture."""
    noise = torch.rand(1, channels, 24, 24, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    return torch.nn.functional.interpolate(noise, (SIDE, SIDE), mode="bicubic").clamp(0, 1)[0]


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
def test_identical_images_have_the_ideal_score(name: str) -> None:
    facts, image = IMAGE_SCORES[name], clear()
    found = float(facts.function(image, image))
    assert found == facts.ideal or found == pytest.approx(facts.ideal, abs=1e-9)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", list(IMAGE_SCORES))
def test_a_thicker_veil_is_worse(name: str, channels: int) -> None:
    """Fog as a veil of grey, five severities: strictly monotone in the stated sense, inside the stated range."""
    facts, image = IMAGE_SCORES[name], clear(channels)
    found = [float(facts.function(image * (1 - veil) + 0.7 * veil, image)) for veil in (0.1, 0.3, 0.5, 0.7, 0.9)]
    falling = found if facts.higher_is_better else [-value for value in found]
    assert all(worse < better for better, worse in pairwise(falling))
    assert all(facts.low <= value <= facts.high for value in found)


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
def test_the_least_size_is_the_least(name: str) -> None:
    facts, image = IMAGE_SCORES[name], clear()
    smallest = image[:, : facts.minimum, : facts.minimum]
    assert math.isfinite(float(facts.function(0.5 * smallest, smallest)))
    if facts.minimum > 1:
        smaller = smallest[:, 1:]
        with pytest.raises(ValueError, match=f"must be {facts.minimum} x {facts.minimum} pixels or larger"):
            facts.function(smaller, smaller)


def test_several_at_once_in_the_order_asked_for() -> None:
    image = clear()
    pair = torch.stack([0.8 * image, image]), torch.stack([image, image])
    found = image_scores(*pair, ["gmsd", "psnr"])
    assert list(found) == ["gmsd", "psnr"]
    assert found["gmsd"].shape == (2,)
    assert float(found["psnr"][1]) == math.inf
    with pytest.raises(ValueError, match="score must be one of"):
        image_scores(*pair, ["pnsr"])
    with pytest.raises(TypeError, match=r"names must be a list of names such as .*; got the text 'psnr'"):
        image_scores(*pair, "psnr")
    assert tw.metrics.image_scores is image_scores


def test_a_score_of_the_table_is_collected() -> None:
    score, image = ImageScore(IMAGE_SCORES["gmsd"]), clear()
    score.update(0.8 * image, image)
    score.update(image, image)
    assert float(score.per_image()[1]) == 0.0
    assert not score.higher_is_better
