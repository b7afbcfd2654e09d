"""What every full-reference score must hold, whatever it measures."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

__all__ = ["batch_gives_what_its_elements_give", "gradients_are_finite", "pair", "refuses_smaller_than", "symmetric"]

Score = Callable[[Tensor, Tensor], Tensor]


def pair(*shape: int, seed: int = 5, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    """A smooth picture with noise and its paler copy with more noise, in [0, 1]."""
    source = torch.Generator().manual_seed(seed)
    height, width = shape[-2:]
    wave = torch.outer(torch.linspace(0.0, 9.0, height).sin(), torch.linspace(0.0, 7.0, width).cos())
    clear = 0.5 + 0.3 * wave + 0.1 * torch.rand(shape, generator=source)
    worse = 0.3 + 0.6 * clear + 0.08 * torch.rand(shape, generator=source)
    return worse.clamp(0.0, 1.0).to(dtype), clear.clamp(0.0, 1.0).to(dtype)


def batch_gives_what_its_elements_give(score: Score, *shape: int) -> None:
    worse, clear = pair(2, 3, *shape)
    worse[1, 0] = clear[1, 0]  # one perfect image, which must not touch its neighbours
    found = score(worse, clear)
    assert found.shape == (2, 3)
    alone = torch.stack([score(w, c) for w, c in zip(worse.flatten(0, 1), clear.flatten(0, 1), strict=True)])
    torch.testing.assert_close(found.flatten(), alone, rtol=1e-12, atol=1e-12)


def gradients_are_finite(score: Score, *shape: int) -> None:
    worse, clear = pair(*shape)
    flat = torch.full_like(clear, 0.25)
    black, white = torch.zeros_like(clear), torch.ones_like(clear)
    pairs = {
        "ordinary": (worse, clear),
        "identical": (clear, clear),
        "constant": (flat, flat),
        "black": (black, black),
        "black and white": (black, white),
        "constant against ordinary": (flat, clear),
        "ordinary against constant": (worse, flat),
    }
    for name, (x, y) in pairs.items():
        for dtype in (torch.float64, torch.float32):
            moving, other = x.to(dtype).clone().requires_grad_(), y.to(dtype).clone().requires_grad_()
            found = score(moving, other)
            assert found.dtype == dtype
            assert bool(torch.isfinite(found)), name
            for gradient in torch.autograd.grad(found, (moving, other)):
                assert bool(torch.isfinite(gradient).all()), name
            if name == "ordinary":
                assert float(gradient.abs().max()) > 0


def refuses_smaller_than(score: Score, side: int, channels: int = 3) -> None:
    assert bool(torch.isfinite(score(*pair(channels, side, side))))
    for height, width in ((side - 1, 2 * side), (2 * side, side - 1)):
        with pytest.raises(ValueError, match=rf"{side} x {side} pixels or larger; got {height} x {width}"):
            score(*pair(channels, height, width))


def symmetric(score: Score, *shape: int) -> None:
    worse, clear = pair(*shape)
    torch.testing.assert_close(score(worse, clear), score(clear, worse), rtol=1e-12, atol=1e-14)
