"""Scores of raw mosaics: the way they take before they are scored, plane by plane and as colour images."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.image import PATTERNS, demosaic, develop, mosaic, quantise, srgb_decode, srgb_encode
from torchweather.metrics import BayerScore, bayer_scores, image_scores

SOME = ["psnr", "ssim", "gmsd"]


def scene(*batch: int, side: int = 64, dtype: torch.dtype = torch.float64) -> Tensor:
    """Smooth random colours, linear in light."""
    noise = torch.rand(math.prod(batch), 3, 8, 8, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    picture = torch.nn.functional.interpolate(noise, (side, side), mode="bicubic").clamp(0.02, 0.95)
    return picture.reshape(*batch, 3, side, side).to(dtype)


def raw_pair(*batch: int, pattern: str = "RGGB", side: int = 64) -> tuple[Tensor, Tensor]:
    """A mosaic in a veil, and the clear one."""
    clear = scene(*batch, side=side)
    return mosaic(0.6 * clear + 0.2, pattern), mosaic(clear, pattern)


def equal(found: dict[str, Tensor], wanted: dict[str, Tensor]) -> None:
    assert list(found) == list(wanted)
    for name in wanted:
        torch.testing.assert_close(found[name], wanted[name], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_demosaiced_scores_are_those_of_the_developed_pictures(pattern: str) -> None:
    worse, clear = raw_pair(pattern=pattern)
    gains = (1.8, 1.0, 1.4)
    wanted = image_scores(develop(worse, pattern, gains=gains), develop(clear, pattern, gains=gains), SOME)
    equal(bayer_scores(worse, clear, SOME, pattern=pattern, gains=gains), wanted)


def test_linear_scores_are_those_of_the_light() -> None:
    worse, clear = raw_pair()
    wanted = image_scores(*(demosaic(raw, "RGGB").clamp(0, 1) for raw in (worse, clear)), SOME)
    found = bayer_scores(worse, clear, SOME, pattern="RGGB", encoding="linear")
    equal(found, wanted)
    assert abs(float(found["psnr"]) - float(bayer_scores(worse, clear, ["psnr"], pattern="RGGB")["psnr"])) > 0.1


def test_planes_are_the_pixels_of_the_cell_in_its_order() -> None:
    """An error of 0.1 in display values on one phase alone: 20 dB there, infinite elsewhere."""
    display = torch.full((1, 16, 16), 0.5, dtype=torch.float64)
    for place, (row, column) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        moved = display.clone()
        moved[:, row::2, column::2] += 0.1
        raw = srgb_decode(moved), srgb_decode(display)
        found = bayer_scores(*raw, ["psnr"], pattern="GRBG", scored_as="planes")["psnr"].tolist()
        assert found.pop(place) == pytest.approx(20.0, abs=1e-9)
        assert found == [math.inf] * 3


def test_planes_scored_alone_are_grey_images() -> None:
    worse, clear = raw_pair()
    found = bayer_scores(worse, clear, SOME, pattern="BGGR", scored_as="planes", encoding="linear")
    for place in range(4):
        cut = (..., slice(place // 2, None, 2), slice(place % 2, None, 2))
        equal({name: score[place] for name, score in found.items()}, image_scores(worse[cut], clear[cut], SOME))


@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_gains_meet_their_colour_and_saturation_stays_white(pattern: str) -> None:
    """Light 0.2 in red against 0.4: with red doubled 0.4 against 0.8 on red's planes; the others stay as they are."""
    cell = [colour for row in PATTERNS[pattern] for colour in row]
    lights = [torch.full((1, 8, 8), value, dtype=torch.float64) for value in (0.2, 0.4)]
    options: dict[str, Any] = {"pattern": pattern, "scored_as": "planes", "encoding": "linear"}
    found = bayer_scores(*lights, ["psnr"], gains=(2.0, 1.0, 1.0), **options)["psnr"]
    for place, colour in enumerate(cell):
        difference = 0.4 if colour == 0 else 0.2
        assert float(found[place]) == pytest.approx(-20 * math.log10(difference), abs=1e-9)
    bright = bayer_scores(4 * lights[0], 2 * lights[1], ["psnr"], gains=(2.0, 2.0, 2.0), **options)["psnr"]
    assert bright.tolist() == [math.inf] * 4  # both clipped


def test_integers_score_as_the_light_that_they_are() -> None:
    worse, clear = (quantise(raw, torch.uint16, 0.0, 4095.0) for raw in raw_pair())
    light = worse.double() / 4095.0, clear.double() / 4095.0
    found = bayer_scores(worse, clear, SOME, pattern="RGGB", data_range=4095.0)
    for name, score in bayer_scores(*light, SOME, pattern="RGGB").items():
        assert float(found[name]) == pytest.approx(float(score), rel=1e-4)  # float32 of the integers


@pytest.mark.parametrize("scored_as", ["demosaic", "planes"])
def test_a_batch_gives_what_its_elements_give(scored_as: str) -> None:
    worse, clear = raw_pair(2, 3, side=32)
    worse[1, 2] = clear[1, 2]
    found = bayer_scores(worse, clear, SOME, pattern="RGGB", scored_as=scored_as)
    for i in range(2):
        for j in range(3):
            alone = bayer_scores(worse[i, j], clear[i, j], SOME, pattern="RGGB", scored_as=scored_as)
            equal({name: score[i, j] for name, score in found.items()}, alone)
    assert found["psnr"].shape == ((2, 3) if scored_as == "demosaic" else (2, 3, 4))


@pytest.mark.parametrize("scored_as", ["demosaic", "planes"])
def test_a_thicker_veil_is_worse_by_every_score(scored_as: str) -> None:
    clear = mosaic(scene(side=322), "RGGB")
    veiled = [clear * (1 - veil) + 0.6 * veil for veil in (0.1, 0.4, 0.8)]
    found = [bayer_scores(raw, clear, pattern="RGGB", scored_as=scored_as) for raw in veiled]
    assert len(found[0]) == 14
    for name in found[0]:
        sign = -1.0 if name in ("gmsd", "ms_gmsd", "mdsi") else 1.0
        assert all(bool((sign * after[name] < sign * before[name]).all()) for before, after in pairwise(found)), name


@pytest.mark.parametrize("scored_as", ["demosaic", "planes"])
def test_gradients_reach_the_mosaic(scored_as: str) -> None:
    worse, clear = raw_pair(side=32)
    for start in (worse, clear):  # identical mosaics too
        moving = start.clone().requires_grad_()
        bayer_scores(moving, clear, ["ssim"], pattern="RGGB", scored_as=scored_as)["ssim"].sum().backward()
        assert moving.grad is not None
        assert bool(torch.isfinite(moving.grad).all())
    moving = worse.clone().requires_grad_()
    bayer_scores(moving, clear, ["psnr"], pattern="RGGB", scored_as=scored_as)["psnr"].sum().backward()
    assert moving.grad is not None
    assert bool((moving.grad != 0).all())


def test_display_values_of_planes_are_encoded() -> None:
    worse, clear = raw_pair()
    encoded = image_scores(srgb_encode(worse[:, ::2, ::2]), srgb_encode(clear[:, ::2, ::2]), SOME)
    found = bayer_scores(worse, clear, SOME, pattern="RGGB", scored_as="planes")
    equal({name: score[0] for name, score in found.items()}, encoded)


RAW = torch.rand(1, 16, 16, generator=torch.Generator().manual_seed(1))
CODES = quantise(RAW, torch.uint16, 0.0, 4095.0)


@pytest.mark.parametrize(
    ("pair", "options", "message"),
    [
        ((RAW.expand(3, 16, 16),) * 2, {}, r"a mosaic \(..., 1, H, W\); got \(3, 16, 16\).*image_scores"),
        ((RAW[:, :15], RAW[:, :15]), {}, "height and width of a mosaic must be even .*; got 15 x 16"),
        ((RAW[0], RAW[0]), {}, r"must have shape \(..., 1, H, W\)"),
        ((RAW, RAW[:, :14]), {}, r"one shape; got \(1, 16, 16\) and \(1, 14, 16\)"),
        ((CODES, CODES), {}, r"distorted must lie in 0..data_range = 1; got .* Set data_range"),
        ((CODES, CODES), {"data_range": 255.0}, "must lie in 0..data_range = 255"),
        (((RAW > 0.5).int(),) * 2, {}, "integers needs data_range, the value of white.*; got 1"),
        ((RAW, RAW), {"data_range": 255.0}, r"data_range is 255, but no value is above 0\.9"),
        ((RAW - 0.5, RAW), {}, "distorted must lie in 0..data_range"),
        ((RAW, RAW.log()), {}, "reference must lie in 0..data_range"),
        ((RAW, torch.where(RAW > 0.5, math.nan, RAW)), {}, "reference must lie in 0..data_range = 1; got nan"),
        ((RAW, RAW), {"pattern": "RGBG"}, "pattern must be one of RGGB"),
        ((RAW, RAW), {"scored_as": "plane"}, "Did you mean 'planes'"),
        ((RAW, RAW), {"encoding": "gamma"}, "encoding must be one of srgb, linear"),
        ((RAW, RAW), {"gains": (1.0, 2.0)}, "gains must be three factors"),
        ((RAW, RAW), {"gains": (1.0, 0.0, 1.0)}, "gains must be above 0"),
        ((RAW, RAW), {"names": ["pnsr"]}, "Did you mean 'psnr'"),
        ((RAW, RAW), {"names": ["ssim"], "scored_as": "planes"}, "11 x 11 pixels or larger; got 8 x 8"),
    ],
)
def test_wrong_input_is_refused(pair: tuple[Tensor, Tensor], options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        bayer_scores(*pair, **{"pattern": "RGGB", "names": ["psnr"], **options})


def test_what_is_no_mosaic_is_refused() -> None:
    with pytest.raises(TypeError, match="reference must be a tensor"):
        bayer_scores(RAW, RAW.numpy(), pattern="RGGB")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="must hold real numbers"):
        bayer_scores(RAW > 0.5, RAW > 0.5, pattern="RGGB")


def test_black_and_identical_mosaics_have_the_ideal_scores() -> None:
    black = torch.zeros(1, 322, 322)
    for raw in (black, raw_pair(side=322)[1]):
        for scored_as in ("demosaic", "planes"):
            found = bayer_scores(raw, raw, pattern="RGGB", scored_as=scored_as)
            assert bool((found.pop("psnr") == math.inf).all())
            for name, score in found.items():
                ideal = 0.0 if name in ("gmsd", "ms_gmsd", "mdsi") else 1.0
                torch.testing.assert_close(score, torch.full_like(score, ideal), rtol=0, atol=1e-5)


def test_scores_are_collected_plane_by_plane() -> None:
    worse, clear = raw_pair(3, side=32)
    score = BayerScore("ssim", pattern="GBRG", scored_as="planes", encoding="linear")
    score.update(worse[:1], clear[:1])
    score.update(worse[1], clear[1])
    score.update(worse[None, 2:], clear[None, 2:])
    wanted = bayer_scores(worse, clear, ["ssim"], pattern="GBRG", scored_as="planes", encoding="linear")["ssim"]
    torch.testing.assert_close(score.per_image(), wanted, rtol=1e-12, atol=0)
    torch.testing.assert_close(score.compute(), wanted.mean(0), rtol=1e-12, atol=0)
    assert score.higher_is_better
    assert not BayerScore("gmsd", pattern="RGGB").higher_is_better
    with pytest.raises(ValueError, match="Did you mean 'ssim'"):
        BayerScore("sim", pattern="RGGB")


def test_colour_scores_are_one_for_each_mosaic() -> None:
    worse, clear = raw_pair(2, side=32)
    score = BayerScore("psnr", pattern="RGGB")
    with pytest.raises(ValueError, match="psnr: no mosaic was scored"):
        score.compute()
    score.update(worse, clear)
    score.update(worse[0], clear[0])
    wanted = bayer_scores(worse, clear, ["psnr"], pattern="RGGB")["psnr"]
    assert score.per_image().tolist() == [*wanted.tolist(), float(wanted[0])]
    score.reset()
    with pytest.raises(ValueError, match="no mosaic was scored"):
        score.per_image()
