"""Scores inside torch.autocast, such as Lightning's validation step: the numbers that they have outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from tests.metrics.behaviour import pair
from torchweather import metrics
from torchweather.image import colour_matrix, demosaic, develop
from torchweather.metrics import IMAGE_SCORES, BayerScore, CloudScore, ImageScore, bayer_scores, image_scores

KINDS = (torch.bfloat16, torch.float16)


def same_inside(call: Callable[[], Any]) -> None:
    outside = call()
    for kind in KINDS:
        with torch.autocast("cpu", dtype=kind):
            inside = call()
            # Nothing but the score is taken out of autocast.
            assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == kind
        torch.testing.assert_close(inside, outside, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("name", IMAGE_SCORES)
def test_image_score(name: str) -> None:
    worse, clear = (image.float() for image in pair(3, 176, 180))
    same_inside(lambda: image_scores(worse, clear, [name]))
    same_inside(lambda: IMAGE_SCORES[name].function(worse, clear))
    same_inside(lambda: ImageScore(IMAGE_SCORES[name])(worse, clear))


def test_scores_of_a_network_in_half_precision() -> None:
    worse, clear = (image.bfloat16() for image in pair(3, 64, 64))
    same_inside(lambda: image_scores(worse, clear, ["ssim", "haarpsi", "sr_sim"]))


@pytest.mark.parametrize("scored_as", ["demosaic", "planes"])
@pytest.mark.parametrize("pattern", ["RGGB", "RCCB"])
def test_bayer_scores(scored_as: str, pattern: str) -> None:
    worse, clear = (image[:1].float() for image in pair(3, 96, 96))
    names = ["ssim", "cw_ssim", "dss", "sr_sim", "haarpsi", "mdsi"] if scored_as == "demosaic" else ["ssim", "gmsd"]
    same_inside(lambda: bayer_scores(worse, clear, names, pattern=pattern, scored_as=scored_as))
    score = BayerScore("haarpsi", pattern=pattern, scored_as=scored_as)
    same_inside(lambda: score(worse, clear))


@pytest.mark.parametrize("method", ["malvar", "bilinear"])
@pytest.mark.parametrize("grad", [False, True])
def test_demosaic(method: str, grad: bool) -> None:
    raw = torch.rand(2, 1, 20, 24, generator=torch.Generator().manual_seed(1)).requires_grad_(grad)
    same_inside(lambda: demosaic(raw, "RCCB", method))
    same_inside(lambda: develop(raw, "RCCB", method=method))
    matrix = torch.tensor([[1.5, -0.3, -0.2], [-0.2, 1.4, -0.2], [0.0, -0.4, 1.4]])
    same_inside(lambda: colour_matrix(demosaic(raw, "RGGB", method), matrix))


def test_clouds_and_boxes() -> None:
    generator = torch.Generator().manual_seed(2)
    clear = 60 * torch.rand(300, 3, generator=generator)
    worse = clear[:250] + 0.1 * torch.randn(250, 3, generator=generator)
    same_inside(lambda: metrics.cloud_scores(worse, clear))
    same_inside(lambda: metrics.chamfer_distance(worse, clear))
    same_inside(lambda: metrics.sdm(worse, clear))
    same_inside(lambda: CloudScore("hd95")(worse, clear))
    same_inside(lambda: metrics.cloud_scores(worse, clear, search="exhaustive"))
    corner = 100 * torch.rand(6, 2, generator=generator)
    boxes = torch.cat([corner, corner + 20 + 30 * torch.rand(6, 2, generator=generator)], 1)
    same_inside(lambda: metrics.box_iou(boxes, boxes + 3))
    ground = torch.cat([corner / 5, 4 + torch.rand(6, 3, generator=generator)], 1)
    same_inside(lambda: metrics.bev_iou(ground, ground + 0.3))
