"""Scores collected over batches."""

from __future__ import annotations

import math

import pytest
import torch

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
