"""What holds of any image and any cloud: ranges, order, invariances, and scores that fall as noise rises."""

from __future__ import annotations

import itertools
import math
from itertools import pairwise
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import Phase, given, settings
from torch import Tensor

from torchweather.metrics import (
    IMAGE_SCORES,
    Region,
    cloud_scores,
    double_validation,
    expected_trends,
    point_counts,
    sdm,
)
from torchweather.metrics.psnr import psnr
from torchweather.metrics.ssim import ssim

quick = settings(max_examples=40, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
few = settings(quick, max_examples=8)
seeds = st.integers(0, 2**32 - 1)
FAR = ("rmse", "mde", "mmde", "hd", "hd95")


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


# ---- images --------------------------------------------------------------------------------------------------------


def texture(side: int, seed: int) -> Tensor:
    coarse = torch.rand(1, 3, 11, 11, generator=generator(seed), dtype=torch.float64)
    smooth = torch.nn.functional.interpolate(coarse, (side, side + 3), mode="bicubic", align_corners=True)[0]
    return (0.2 + 0.6 * smooth).clamp(0.1, 0.9)


def any_image(kind: str, side: int, seed: int) -> Tensor:
    """Smooth, grain, black and white, faint, flat, or half flat."""
    grain = torch.rand(3, side, side + 3, generator=generator(seed), dtype=torch.float64)
    made = {
        "smooth": texture(side, seed),
        "grain": grain,
        "black and white": (grain > 0.5).double(),
        "faint": 0.4 + 1e-6 * grain,
        "flat": torch.full_like(grain, float(grain[0, 0, 0])),
        "half flat": torch.where(torch.arange(side + 3) < side // 2, 0.7, grain),
        "dark": 1e-4 * grain,
    }
    return made[kind]


kinds = st.sampled_from(["smooth", "grain", "black and white", "faint", "flat", "half flat", "dark"])


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
@few
@given(first=kinds, second=kinds, seed=seeds, single=st.booleans())
def test_any_two_images_have_a_score_in_its_range(name: str, first: str, second: str, seed: int, single: bool) -> None:
    facts = IMAGE_SCORES[name]
    side = max(facts.minimum, 20)
    x, y = any_image(first, side, seed), any_image(second, side, seed + 1)
    dtype = torch.float32 if single else torch.float64
    found = float(facts.function(x.to(dtype), y.to(dtype)))
    assert facts.low <= found <= facts.high


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
@few
@given(kind=kinds, seed=seeds, scale=st.sampled_from([2.0, 255.0, 1023.0, 65535.0]))
def test_scores_do_not_depend_on_the_unit_of_brightness(name: str, kind: str, seed: int, scale: float) -> None:
    facts = IMAGE_SCORES[name]
    side = max(facts.minimum, 20)
    clear = any_image("smooth", side, seed)
    worse = 0.6 * clear + 0.1 + 0.2 * any_image(kind, side, seed + 1)
    wanted = float(facts.function(worse, clear))
    found = float(facts.function(scale * worse, scale * clear, data_range=scale))
    # x s / s is x to a rounding of 1e-16, which thresholds and roots raise to no more than 1e-9.
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@quick
@given(
    offset=st.floats(1e-4, 0.5),
    level=st.floats(0.1, 0.5),
    scale=st.sampled_from([1.0, 255.0, 4095.0]),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
)
def test_psnr_of_a_constant_offset(offset: float, level: float, scale: float, shape: tuple[int, int]) -> None:
    clear = torch.full((3, *shape), level * scale, dtype=torch.float64)
    found = float(psnr(clear + offset * scale, clear, data_range=scale))
    # An offset of 1e-4 beside a level of 0.5 has lost four digits of sixteen.
    assert found == pytest.approx(-20.0 * math.log10(offset), abs=1e-9)


@quick
@given(seed=seeds, share=st.floats(0.05, 1.0), factor=st.floats(0.1, 1.0))
def test_psnr_of_a_share_of_the_error(seed: int, share: float, factor: float) -> None:
    """The error times f is 20 log10 f less; an error in a share s of the pixels is 10 log10 s less."""
    error = 0.4 * (torch.rand(1, 20, 50, generator=generator(seed), dtype=torch.float64) - 0.5)
    clear = torch.full_like(error, 0.5)
    whole = float(psnr(clear + error, clear))
    assert float(psnr(clear + factor * error, clear)) == pytest.approx(whole - 20.0 * math.log10(factor), abs=1e-9)
    number = max(1, round(share * 1000))
    some = torch.where(torch.arange(1000).reshape(1, 20, 50) < number, 0.2, torch.tensor(0.0).double())
    wanted = -20.0 * math.log10(0.2) - 10.0 * math.log10(number / 1000)
    assert float(psnr(clear + some, clear)) == pytest.approx(wanted, abs=1e-9)


@quick
@given(seed=seeds, gain=st.floats(0.0, 1.0), offset=st.floats(0.0, 0.3))
def test_ssim_of_brightness_and_contrast_where_the_image_is_a_checkerboard(
    seed: int, gain: float, offset: float
) -> None:
    """Every window of a fine checkerboard has one mean and one variance, to the share of the window's rest."""
    board = ((torch.arange(24)[:, None] + torch.arange(24)) % 2).double()[None]
    clear = 0.2 + 0.4 * board
    worse = 0.2 + offset + gain * 0.4 * board
    mx, my = 0.2 + offset + 0.2 * gain, 0.4
    vx, vy, both = (0.2 * gain) ** 2, 0.2**2, 0.2**2 * gain
    wanted = (2 * mx * my + 1e-4) * (2 * both + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    # The Gaussian of 1.5 pixels passes exp(-(pi 1.5)^2) = 2e-10 of an alternation along each side, but is cut at 5
    # pixels, 3.3 sigma, which leaves about 1e-3 of a side and 1e-6 of both.
    assert float(ssim(worse, clear, full_resolution=True)) == pytest.approx(wanted, abs=1e-4)


NOISE = (0.01, 0.03, 0.06, 0.1, 0.15)


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
def test_more_noise_is_worse(name: str) -> None:
    """Mean of three seeds, five levels, the same draws at every level."""
    facts = IMAGE_SCORES[name]
    side = max(facts.minimum, 96)
    found = []
    for sigma in NOISE:
        scores = []
        for seed in range(3):
            clear = texture(side, seed)
            noise = torch.randn(clear.shape, generator=generator(seed + 100), dtype=torch.float64)
            scores.append(float(facts.function((clear + sigma * noise).clamp(0.0, 1.0), clear)))
        found.append(sum(scores) / 3.0)
    falling = found if facts.higher_is_better else [-score for score in found]
    assert all(worse < better for better, worse in pairwise(falling)), found
    ideal = facts.ideal if facts.higher_is_better else -facts.ideal
    assert falling[0] < ideal


@pytest.mark.parametrize("name", list(IMAGE_SCORES))
def test_more_blur_is_worse(name: str) -> None:
    """A binomial filter passes a share of every frequency, none turned over: again and again it takes more away."""
    facts = IMAGE_SCORES[name]
    side = max(facts.minimum, 96)
    grain = torch.randn(3, side, side + 3, generator=generator(6)).double()
    clear = (texture(side, 5) + 0.1 * grain).clamp(0.0, 1.0)
    found, image = [], clear
    for _ in range(4):
        for axis in (1, 2):
            ends = image.narrow(axis, 0, 1), image.narrow(axis, image.shape[axis] - 1, 1)
            padded = torch.cat((ends[0], image, ends[1]), axis)
            image = sum(w * padded.narrow(axis, i, image.shape[axis]) for i, w in enumerate((0.25, 0.5, 0.25)))
        found.append(float(facts.function(image, clear)))
    falling = found if facts.higher_is_better else [-score for score in found]
    assert all(worse < better for better, worse in pairwise(falling)), found


# ---- clouds --------------------------------------------------------------------------------------------------------


def cloud(n: int, seed: int, spread_m: tuple[float, float, float] = (20.0, 10.0, 2.0)) -> Tensor:
    return torch.randn(n, 3, generator=generator(seed), dtype=torch.float64) * torch.tensor(spread_m).double()


def moved(points: Tensor, seed: int, mirrored: bool) -> Tensor:
    """Turned about any axis, shifted by some 100 m, or seen in a mirror."""
    turn, rest = torch.linalg.qr(torch.randn(3, 3, generator=generator(seed), dtype=torch.float64))
    turn = turn * rest.diagonal().sign()
    if (float(torch.det(turn)) < 0) != mirrored:
        turn = turn * torch.tensor([1.0, 1.0, -1.0]).double()
    return points @ turn.T + 100.0 * torch.randn(3, generator=generator(seed + 1), dtype=torch.float64)


def values(scores: dict[str, Tensor]) -> dict[str, float]:
    return {name: float(score) for name, score in scores.items()}


@quick
@given(n=st.integers(2, 70), m=st.integers(2, 70), seed=seeds, mirrored=st.booleans(), scale=st.floats(1e-3, 1e3))
def test_shapes_are_blind_to_rigid_motion_order_and_joint_scale(
    n: int, m: int, seed: int, mirrored: bool, scale: float
) -> None:
    p, r = cloud(n, seed), cloud(m, seed + 1, (5.0, 5.0, 5.0))
    wanted = float(sdm(p, r))
    order = torch.randperm(n, generator=generator(seed))
    changed = scale * moved(p, seed + 2, mirrored)[order], scale * moved(r, seed + 4, not mirrored)
    # Coordinates of 100 m in float64 leave distances of 10 m exact to 1e-14.
    assert float(sdm(*changed)) == pytest.approx(wanted, abs=1e-11)
    assert 0.0 <= wanted <= 1.0


@quick
@given(n=st.integers(2, 60), m=st.integers(2, 60), seed=seeds, mirrored=st.booleans())
def test_distances_are_blind_to_a_rigid_motion_of_both(n: int, m: int, seed: int, mirrored: bool) -> None:
    p, r = cloud(n, seed), cloud(m, seed + 1)
    together = moved(torch.cat((p, r)), seed + 2, mirrored).split((n, m))
    wanted = values(cloud_scores(p, r))
    assert values(cloud_scores(*together)) == pytest.approx(wanted, rel=1e-9, abs=1e-10)


@few
@given(seed=seeds, share=st.sampled_from([0.2, 0.5, 0.8]))
def test_a_sample_of_a_cloud_has_its_shape(seed: int, share: float) -> None:
    whole = cloud(6000, seed)
    kept = torch.randperm(6000, generator=generator(seed))[: round(share * 6000)]
    found = float(sdm(whole[kept], whole))
    # Distances of this cloud: relative standard deviation about 0.6. A sample of K of N points has a mean distance
    # that varies by about 2 x 0.6 / 2 x sqrt(1/K - 1/N), SDM is near that share of the mean; 2^20 pairs add 0.0008.
    spread = 0.6 * math.sqrt(1.0 / len(kept) - 1.0 / 6000) + 0.0008
    assert 0.0 < found < 4.0 * spread
    # The distances to a sample are no better than its spacing, and a shape of another size is told apart.
    assert float(sdm(1.2 * whole[kept], whole)) == pytest.approx(1.0 - 1.0 / 1.2, abs=4.0 * spread)


@quick
@given(n=st.integers(2, 70), seed=seeds, factor=st.floats(1.0, 50.0))
def test_shape_of_a_scaled_cloud(n: int, seed: int, factor: float) -> None:
    """W = (f - 1) mu, so 2 (f - 1) / (1 + f + f - 1) = 1 - 1 / f."""
    p = cloud(n, seed)
    assert float(sdm(factor * p, p)) == pytest.approx(1.0 - 1.0 / factor, abs=1e-12)


@quick
@given(n=st.integers(1, 80), m=st.integers(1, 80), seed=seeds, spread=st.floats(1e-3, 1e4), grid=st.booleans())
def test_chain_of_distances(n: int, m: int, seed: int, spread: float, grid: bool) -> None:
    p, r = spread * cloud(n, seed), spread * cloud(m, seed + 1)
    if grid:  # copies and ties
        p, r = (1.0 + (points / (5.0 * spread)).round() for points in (p, r))
    s = values(cloud_scores(p, r, names=(*FAR, "chamfer", "chamfer_squared")))
    slack = 1.0 + 1e-12  # rounding of the means
    assert 0.0 <= s["hd95"] <= s["hd"]
    assert s["mde"] <= s["mmde"] * slack
    assert s["mmde"] <= s["hd"] * slack
    assert s["mde"] <= s["rmse"] * slack
    assert s["rmse"] <= s["hd"] * slack
    assert s["mmde"] <= s["chamfer"] * slack <= 2.0 * s["mmde"] * slack * slack
    assert s["chamfer_squared"] <= 2.0 * s["hd"] ** 2 * slack
    if n == m:
        assert s["mde"] == pytest.approx(0.5 * s["chamfer"], rel=1e-12)
        assert s["rmse"] == pytest.approx(math.sqrt(0.5 * s["chamfer_squared"]), rel=1e-12)


@quick
@given(n=st.integers(1, 60), m=st.integers(1, 60), seed=seeds)
def test_ways_there_and_back_are_those_of_both(n: int, m: int, seed: int) -> None:
    p, r = cloud(n, seed), cloud(m, seed + 1)
    names = (*FAR, "chamfer")
    both, there, back = (
        values(cloud_scores(p, r, names=names, direction=way)) for way in ("both", "to_reference", "to_distorted")
    )
    for name in ("mmde", "hd", "hd95"):
        assert both[name] == max(there[name], back[name])
    assert both["mde"] == pytest.approx((n * there["mde"] + m * back["mde"]) / (n + m), rel=1e-12)
    squares = (n * there["rmse"] ** 2 + m * back["rmse"] ** 2) / (n + m)
    assert both["rmse"] == pytest.approx(math.sqrt(squares), rel=1e-12)
    assert both["chamfer"] == pytest.approx(there["chamfer"] + back["chamfer"], rel=1e-12)


@quick
@given(n=st.integers(1, 60), far=st.integers(1, 40), seed=seeds)
def test_points_lost_and_points_added_are_seen_one_way_only(n: int, far: int, seed: int) -> None:
    near = cloud(n, seed)
    more = torch.cat((near, near[:1] + torch.tensor([1e3, 0.0, 0.0]).double() + cloud(far, seed + 1)))
    for distorted, reference, blind in ((more, near, "to_distorted"), (near, more, "to_reference")):
        assert set(values(cloud_scores(distorted, reference, names=FAR, direction=blind)).values()) == {0.0}
        found = values(cloud_scores(distorted, reference, names=FAR))
        assert found["hd"] > 700.0
        rank = 0.95 * (n + far - 1)
        if math.floor(rank) >= n:  # both ranks beside the percentile are of the far points
            assert found["hd95"] > 700.0
        if math.ceil(rank) < n:
            assert found["hd95"] == 0.0


def test_more_scatter_of_the_points_is_worse() -> None:
    """Mean of three seeds, five levels from 2 cm to 2 m, points about 1 m apart."""
    levels = []
    for sigma in (0.02, 0.08, 0.3, 0.8, 2.0):
        found = []
        for seed in range(3):
            clear = cloud(1200, seed, (8.0, 8.0, 2.0))
            worse = clear + sigma * torch.randn(clear.shape, generator=generator(seed + 50)).double()
            found.append(cloud_scores(worse, clear))
        levels.append({name: float(torch.stack([score[name] for score in found]).mean()) for name in found[0]})
    for name in levels[0]:
        assert all(more[name] > less[name] for less, more in pairwise(levels)), name


@quick
@given(n=st.integers(0, 60), seed=seeds, cut=st.floats(-20.0, 20.0))
def test_two_sides_of_a_plane_hold_all_points(n: int, seed: int, cut: float) -> None:
    points = cloud(n, seed)
    kind = torch.randint(0, 3, (n,), generator=generator(seed))
    sides = Region(x_m=(-math.inf, cut)), Region(x_m=(cut, math.inf))
    assert sum(int(point_counts(points, region=side)) for side in sides) == n
    each = sum(point_counts(points, kind, region=side) for side in sides)
    assert torch.equal(torch.as_tensor(each), point_counts(points, kind))
    assert int(point_counts(points, kind).sum()) == n


# ---- trends --------------------------------------------------------------------------------------------------------


def verdict(levels: list[Any], direction: str = "down", **options: Any) -> str:
    scene = expected_trends({"road": {"score": levels}}, {"score": direction}, **options)["road"]
    return scene.metrics["score"].verdict


@pytest.mark.parametrize("levels", [2, 3, 4, 5])
def test_one_order_in_all_is_the_expected_one(levels: int) -> None:
    found = [verdict(list(order)) for order in itertools.permutations(range(levels))]
    assert found.count("expected") == found.count("reversed") == 1
    assert found.count("broken") == math.factorial(levels) - 2
    assert found[0] == "expected"
    assert found[-1] == "reversed"
    chance = expected_trends({"s": {"m": list(range(levels))}}, {"m": "down"})["s"].metrics["m"].chance
    assert chance == found.count("expected") / len(found)


scores_of_levels = st.lists(st.one_of(st.none(), st.integers(-4, 4).map(float)), min_size=0, max_size=7)


@quick
@given(levels=scores_of_levels, gain=st.floats(0.5, 4.0), offset=st.integers(-5, 5))
def test_verdicts_know_only_the_order(levels: list[float | None], gain: float, offset: int) -> None:
    wanted = verdict(levels)
    assert verdict([None if x is None else gain * x + offset for x in levels]) == wanted
    assert verdict([None if x is None else math.exp(x) for x in levels]) == wanted
    assert verdict([None if x is None else -x for x in levels], "up") == wanted
    assert verdict([x for x in levels if x is not None]) == wanted
    other_way = {"expected": "reversed", "reversed": "expected", "unjudged": "unjudged"}
    there = [x for x in levels if x is not None]
    if wanted in other_way:
        assert verdict(levels[::-1]) == other_way[wanted]
    elif len(set(there)) == 1:
        assert wanted == verdict(levels[::-1]) == "tied"


@quick
@given(levels=scores_of_levels, frames=st.integers(2, 5), seed=seeds)
def test_frames_that_agree_are_a_number(levels: list[float | None], frames: int, seed: int) -> None:
    alike = [None if x is None else [x] * frames for x in levels]
    found = expected_trends({"s": {"m": alike}}, {"m": "up"}, resamples=20, seed=seed)["s"]
    assert found.metrics["m"].verdict == verdict(levels, "up")
    if found.out_of:
        assert found.metrics["m"].confidence == float(found.expected)
        assert found.interval == (found.expected, found.expected)
    # The mean of frames that scatter about the level is the level.
    about = np.random.default_rng(seed).integers(-3, 4, frames)
    scattered = [None if x is None else [x + d for d in about] + [x - d for d in about] for x in levels]
    assert verdict(scattered, "up") == verdict(levels, "up")


# ---- double validation ---------------------------------------------------------------------------------------------


@quick
@given(
    sample=st.lists(st.integers(-1000, 1000).map(float), min_size=1, max_size=40),
    shift=st.integers(-(2**20), 2**20),
    seed=seeds,
    centre=st.sampled_from(["median", "mean"]),
)
def test_a_shift_is_all_bias(sample: list[float], shift: int, seed: int, centre: str) -> None:
    measured = torch.tensor(sample, dtype=torch.float64)
    order = torch.randperm(len(sample), generator=generator(seed))
    found = double_validation(measured[order] + shift, measured, centre=centre)
    if centre == "median":  # halves of whole numbers are exact
        assert (float(found.bias), float(found.scatter)) == (float(shift), 0.0)
    else:
        assert float(found.bias) == pytest.approx(shift, abs=1e-9)
        assert float(found.scatter) == pytest.approx(0.0, abs=1e-9)


@quick
@given(n=st.integers(1, 40), m=st.integers(1, 40), seed=seeds, factor=st.floats(0.1, 10.0), copies=st.integers(2, 4))
def test_bias_and_scatter_have_the_unit_of_the_quantity(n: int, m: int, seed: int, factor: float, copies: int) -> None:
    x, y = cloud(n, seed)[:, 0], cloud(m, seed + 1)[:, 0]
    wanted = double_validation(x, y)
    scaled = double_validation(-factor * x, -factor * y)
    assert float(scaled.bias) == pytest.approx(-factor * float(wanted.bias), rel=1e-9, abs=1e-12)
    assert float(scaled.scatter) == pytest.approx(factor * float(wanted.scatter), rel=1e-9, abs=1e-12)
    repeated = double_validation(x.repeat(copies), y)
    assert float(repeated.scatter) == pytest.approx(float(wanted.scatter), rel=1e-9, abs=1e-12)
    assert float(wanted.scatter) >= abs(float((x - wanted.bias).mean() - y.mean())) - 1e-12


@quick
@given(n=st.integers(1, 40), seed=seeds, factor=st.floats(1.0, 8.0))
def test_scatter_of_a_stretched_sample(n: int, seed: int, factor: float) -> None:
    """About its own centre: each value moves by (f - 1) of its distance, none past another."""
    y = cloud(n, seed)[:, 0]
    middle = y.sort().values[[(n - 1) // 2, n // 2]].mean()
    found = double_validation(middle + factor * (y - middle), y)
    assert float(found.bias) == pytest.approx(0.0, abs=1e-9)
    assert float(found.scatter) == pytest.approx((factor - 1.0) * float((y - middle).abs().mean()), rel=1e-9, abs=1e-9)
