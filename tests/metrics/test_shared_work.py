"""All image scores in one call: the figures of each alone, what they share found once, large images in strips."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.metrics.behaviour import pair
from torchweather.metrics import IMAGE_SCORES, image_scores, pairs, strips
from torchweather.metrics.image_scores import OF_PAIR
from torchweather.metrics.strips import in_strips

# Odd sides, and shorter than 161 none: every pyramid has an odd level.
SHAPE = (3, 203, 171)


def counted(monkeypatch: pytest.MonkeyPatch, calls: Counter[str], place: Any, *names: str) -> None:
    def counting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            calls[name] += 1
            return function(*args, **options)

        return call

    for name in names:
        monkeypatch.setattr(place, name, counting(name, getattr(place, name)))


@pytest.mark.parametrize("shape", [SHAPE, (1, 203, 171), (2, *SHAPE)], ids=["colour", "grey", "batch"])
def test_together_is_alone(shape: tuple[int, ...]) -> None:
    worse, clear = pair(*shape)
    together = image_scores(255.0 * worse, 255.0 * clear, data_range=255.0)
    assert list(together) == list(IMAGE_SCORES) == list(OF_PAIR)
    for name, facts in IMAGE_SCORES.items():
        alone = facts.function(255.0 * worse, 255.0 * clear, data_range=255.0)
        assert together[name].shape == shape[:-3]
        torch.testing.assert_close(together[name], alone, rtol=1e-12, atol=1e-12, msg=name)


def test_what_scores_share_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """One check, and of each of the two images one luma, one copy of half the size, one shrunk copy."""
    calls: Counter[str] = Counter()
    counted(monkeypatch, calls, pairs, "check_pair", "luma", "subsampled", "averaged_down")
    worse, clear = pair(*SHAPE)
    image_scores(worse, clear)
    assert calls == {"check_pair": 1, "luma": 2, "subsampled": 2, "averaged_down": 2}
    calls.clear()
    for facts in IMAGE_SCORES.values():
        facts.function(worse, clear)
    # alone: luma of CW-SSIM, DSS, VIF, MS-GMSD; halves of HaarPSI, GMSD, MS-GMSD; shrunk of SSIM, FSIM
    # (SR-SIM shrinks in float64 by itself)
    assert calls == {"check_pair": 14, "luma": 8, "subsampled": 6, "averaged_down": 4}


def test_what_nobody_asks_for_is_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[str] = Counter()
    counted(monkeypatch, calls, pairs, "luma", "subsampled", "averaged_down")
    image_scores(*pair(*SHAPE), ["psnr", "ms_ssim"])
    assert not calls
    assert image_scores(*pair(*SHAPE), []) == {}


def test_gradients_can_be_taken_score_by_score() -> None:
    worse, clear = pair(*SHAPE)
    moving = worse.clone().requires_grad_()
    for name, score in image_scores(moving, clear).items():
        (together,) = torch.autograd.grad(score, moving)
        alone_of = worse.clone().requires_grad_()
        (alone,) = torch.autograd.grad(IMAGE_SCORES[name].function(alone_of, clear), alone_of)
        torch.testing.assert_close(together, alone, rtol=1e-12, atol=1e-14, msg=name)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_strips_do_not_show(monkeypatch: pytest.MonkeyPatch, dtype: torch.dtype) -> None:
    """From one strip to strips of a few rows: rounding alone, as the means that SSIM takes out are those of strips."""
    worse, clear = pair(*SHAPE, dtype=dtype)
    monkeypatch.setattr(strips, "STRIP_VALUES", 1 << 40)
    whole = image_scores(worse, clear)
    monkeypatch.setattr(strips, "STRIP_VALUES", 1)
    narrow = image_scores(worse, clear)
    # float32: some 60 roundings of 6e-8
    tolerance = 4e-6 if dtype == torch.float32 else 1e-12
    for name, score in whole.items():
        torch.testing.assert_close(narrow[name], score, rtol=tolerance, atol=tolerance, msg=name)


@pytest.mark.parametrize(("height", "reach", "values"), [(50, 10, 1), (50, 10, 24), (11, 10, 1), (64, 0, 100)])
def test_every_window_lies_in_one_strip(monkeypatch: pytest.MonkeyPatch, height: int, reach: int, values: int) -> None:
    monkeypatch.setattr(strips, "STRIP_VALUES", values)
    rows = torch.arange(float(height)).reshape(1, 1, height, 1)
    seen = []

    def first_of_each_window(strip: Tensor) -> Tensor:
        seen.append(strip.shape[-2])
        return strip[..., : strip.shape[-2] - reach, :]

    found = in_strips(first_of_each_window, reach, rows)
    assert torch.equal(found, rows[..., : height - reach, :])
    assert len(seen) == -(-(height - reach) // max(reach + 1, values))


def test_the_error_names_the_score_that_needs_the_largest_image() -> None:
    with pytest.raises(ValueError, match="vif: images must be 41 x 41 pixels or larger; got 40 x 60"):
        image_scores(*pair(3, 40, 60), ["psnr", "vif", "gmsd"])
    four = torch.rand(4, 8, 8)
    with pytest.raises(ValueError, match="C = 1 or 3"):
        image_scores(four, four, ["psnr"])
