"""Scores collected over batches."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from torchweather.metrics import CLOUD_SCORES, CloudScore, Region, cloud_scores
from torchweather.metrics.psnr import psnr
from torchweather.metrics.score import ImageScore, ScoreFacts

PSNR = ScoreFacts(psnr, True, 0.0, math.inf, math.inf, 1)


def pair(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(4, 3, 8, 8, generator=generator), torch.rand(4, 3, 8, 8, generator=generator)


def test_batches_count_by_their_images() -> None:
    score = ImageScore(PSNR)
    worse, clear = pair(1)
    score.update(worse[:1], clear[:1])
    score.update(worse[1:], clear[1:])
    assert torch.allclose(score.per_image(), psnr(worse, clear).double())
    assert float(score.compute()) == pytest.approx(float(psnr(worse, clear).mean()), rel=1e-6)
    assert score.higher_is_better


def test_reset_forgets_and_nothing_is_no_score() -> None:
    score = ImageScore(PSNR, data_range=255.0)
    with pytest.raises(ValueError, match="psnr: no image was scored"):
        score.compute()
    worse, clear = pair(2)
    score.update(255.0 * worse, 255.0 * clear)
    first = float(score.compute())
    score.reset()
    with pytest.raises(ValueError, match="no image was scored"):
        score.per_image()
    score.update(255.0 * clear, 255.0 * worse)
    assert float(score.compute()) == pytest.approx(first)


def test_gradients_flow_through_the_call() -> None:
    worse, clear = pair(3)
    moving = worse.requires_grad_()
    ImageScore(PSNR)(moving, clear).sum().backward()
    assert moving.grad is not None
    assert bool(torch.isfinite(moving.grad).all())


def test_an_empty_batch_is_no_image() -> None:
    score = ImageScore(PSNR)
    score.update(torch.zeros(0, 3, 8, 8), torch.zeros(0, 3, 8, 8))
    with pytest.raises(ValueError, match="no image was scored"):
        score.compute()


# ---- clouds --------------------------------------------------------------------------------------------------------


def cloud(n: int, seed: int) -> torch.Tensor:
    return torch.randn(n, 4, generator=torch.Generator().manual_seed(seed)) * 10.0


@pytest.mark.parametrize("name", [*CLOUD_SCORES, "chamfer", "chamfer_squared"])
def test_clouds_batches_and_ragged_lists_count_by_their_clouds(name: str) -> None:
    pairs = [(cloud(30, 1), cloud(30, 2)), (cloud(30, 3), cloud(30, 4)), (cloud(12, 5), cloud(41, 6))]
    options: dict[str, Any] = {"region": Region(x_m=(-15.0, 15.0)), "direction": "to_reference"}
    wanted = [float(cloud_scores(*pair, names=(name,), **options)[name]) for pair in pairs]
    score = CloudScore(name, **options)
    score.update(*pairs[0])
    score.update(pairs[1][0][None], pairs[1][1][None])
    score.update([pairs[2][0], pairs[0][0]], [pairs[2][1], pairs[0][1]])
    score.update([], [])
    assert score.per_cloud().tolist() == [*wanted, wanted[0]]
    assert float(score.compute()) == pytest.approx((sum(wanted) + wanted[0]) / 4)


def test_padding_of_clouds_does_not_count() -> None:
    clear = cloud(20, 7)
    padded = torch.cat((clear + 0.1, torch.full((5, 4), 9.0)))
    score = CloudScore("hd")
    score.update(padded[None], clear[None], distorted_valid=(torch.arange(25) < 20)[None])
    score.update(clear[None], padded[None], reference_valid=(torch.arange(25) < 20)[None])
    alone = float(CloudScore("hd")(padded[:20], clear))
    assert score.per_cloud().tolist() == [alone, alone]
    assert float(CloudScore("hd")(padded, clear)) > alone


def test_what_a_cloud_score_states_holds() -> None:
    clear, nothing = cloud(50, 8), torch.zeros(50, 4)
    for name in CLOUD_SCORES:
        score = CloudScore(name)
        assert float(score(clear, clear)) == score.ideal == score.low
        assert float(score(clear, nothing)) == score.high
        assert not score.higher_is_better
        score.update(clear, nothing)
        score.update(clear, clear)
        assert float(score.compute()) == (0.5 if name == "sdm" else math.inf)


def test_a_cloud_score_is_checked_when_it_is_made() -> None:
    with pytest.raises(ValueError, match=r"CloudScore: names must be one of .* Did you mean 'hd95'"):
        CloudScore("hd59")
    with pytest.raises(ValueError, match="correspondence must be one of nearest, index"):
        CloudScore("rmse", correspondence="row")
    with pytest.raises(TypeError, match="regoin"):
        CloudScore("rmse", regoin=None)
    score = CloudScore("mde")
    with pytest.raises(ValueError, match="mde: no cloud was scored"):
        score.compute()
    score.update(cloud(5, 1), cloud(6, 2))
    score.reset()
    with pytest.raises(ValueError, match="mde: no cloud was scored"):
        score.per_cloud()


def test_gradients_flow_through_a_cloud_score() -> None:
    moving = cloud(20, 9).requires_grad_()
    CloudScore("mde")(moving, cloud(25, 10)).backward()
    assert moving.grad is not None
    assert float(moving.grad[:, :3].abs().sum()) > 0
