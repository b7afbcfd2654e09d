"""Which scores follow: the strict rule, the Hausdorff distance by the agreement of its seeds, and why others miss."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from torchweather.evaluation.sweep import Series, judged, parse_levels
from torchweather.evaluation.sweep.misses import explain_miss
from torchweather.evaluation.sweep.trends import page_p

DIRECTIONS = {"psnr": "up", "gmsd": "down", "mde": "down", "hd": "down", "hd95": "down", "sdm": "down"}


def series(scores: Mapping[str, Any], weather: str = "rain:rate=1,5,25", sensor: str = "lidar", **facts: Any) -> Series:
    levels = parse_levels(weather)
    arrays = {name: np.array(values, dtype=float) for name, values in scores.items()}
    clear = {name: values.pop("clear") for name, values in facts.items()}
    return Series(
        scene="scene",
        sensor=sensor,
        levels=tuple(levels),
        subjects=("scene",),
        seeds=tuple(range(next(iter(arrays.values())).shape[1])),
        scores=arrays,
        facts={name: np.array(values["levels"], dtype=float) for name, values in facts.items()},
        clear=clear,
        directions={name: DIRECTIONS[name] for name in arrays},
        render_s=0.0,
        score_s=0.0,
    )


def why(one: Series, metric: str) -> str:
    judgement = judged(one).metrics[metric]
    assert not judgement.follows
    return " ".join(explain_miss(one, judgement))


def test_the_mean_of_the_seeds_must_get_worse_at_every_step() -> None:
    one = series(
        {
            "psnr": [[40, 41, 42], [30, 31, 44], [20, 21, 22]],  # one seed alone goes up
            "gmsd": [[0.1, 0.1, 0.1], [0.2, 0.3, 0.1], [0.2, 0.1, 0.1]],
            "mde": [[1, 1, 1], [2, 2, 2], [2, 2, 2]],
        },
        sensor="camera",
    )
    found = judged(one)
    assert (found.expected, found.out_of) == (1, 3)
    assert [found.metrics[name].trend.verdict for name in one.scores] == ["expected", "broken", "tied"]


def test_hausdorff_distance_follows_where_the_seeds_agree_though_a_stray_point_breaks_its_mean() -> None:
    # Two of three seeds rise steadily; in the third a stray point 90 m away is there in light rain already.
    hd = [[1, 2, 91], [3, 4, 90.5], [5, 6, 90.6], [7, 8, 90.7], [9, 10, 90.8]]
    levels = "rain:rate=1,5,10,25,50"
    found = judged(series({"hd": hd, "mde": hd}, levels))
    assert found.metrics["hd"].follows
    assert found.metrics["mde"].follows  # here the mean rises as well
    hd[1][2] = 60.0
    found = judged(series({"hd": hd, "mde": hd}, levels))
    assert found.metrics["hd"].follows
    assert found.metrics["hd"].page_p is not None
    assert found.metrics["hd"].page_p <= 0.05
    assert not found.metrics["mde"].follows  # every other metric keeps to the strict rule
    assert found.interval == (1, 2)  # HD as judged, MDE as the resampled seeds have it


def test_hausdorff_distance_without_trend_does_not_follow() -> None:
    random = np.random.default_rng(5)
    passed = 0
    for _ in range(200):
        found = judged(series({"hd": random.random((5, 3))}, "rain:rate=1,5,10,25,50"), resamples=1)
        passed += found.expected
    # 5 % by ranks and 1/120 by the mean, of 200: 11.7 at most, and three standard deviations of 3.3.
    assert passed <= 21


def test_page_probability_is_that_of_all_orders() -> None:
    """Two seeds, three levels: of the 36 pairs of orders those with as large a sum of rank products."""
    scores = np.array([[1.0, 2.0], [2.0, 1.0], [3.0, 3.0]])
    ranks = scores.argsort(0).argsort(0) + 1
    statistic = (np.arange(1, 4)[:, None] * ranks).sum()
    orders = [sum(place * rank for place, rank in enumerate(order, 1)) for order in itertools.permutations((1, 2, 3))]
    as_large = sum(a + b >= statistic for a in orders for b in orders)
    assert page_p(scores) == pytest.approx(as_large / 36)


def test_page_test_needs_three_levels_and_two_samples() -> None:
    assert page_p(np.array([[1.0, 2.0], [2.0, 3.0]])) is None
    assert page_p(np.array([[1.0], [2.0], [3.0]])) is None
    assert not judged(series({"hd": [[2.0], [1.0], [3.0]]})).metrics["hd"].follows


def test_infinite_scores_of_equal_images_are_judged() -> None:
    one = series({"psnr": [[np.inf, np.inf], [40, 41], [30, 31]]}, sensor="camera")
    assert judged(one).expected == 1
    tied = series({"psnr": [[np.inf, np.inf], [np.inf, np.inf], [30, 31]]}, sensor="camera")
    assert "stays as it is, for every seed, from 1 to 5 mm/h" in why(tied, "psnr")


def test_a_step_within_the_scatter_of_the_seeds_is_told_from_one_beyond() -> None:
    scattered = [[0.1, 0.3, 0.2], [0.2, 0.1, 0.25], [0.5, 0.6, 0.7]]  # mean 0.2 to 0.183
    text = why(series({"gmsd": scattered}, sensor="camera"), "gmsd")
    assert "from 1 to 5 mm/h (0.2 to 0.18333), by less than the seeds scatter" in text
    turned = [[0.1, 0.11, 0.12], [0.5, 0.51, 0.52], [0.4, 0.41, 0.42001]]
    text = why(series({"gmsd": turned}, sensor="camera"), "gmsd")
    assert "from 5 to 25 mm/h" in text
    assert "by more than the seeds scatter" in text
    assert "levels off" not in text


def test_a_curve_that_levels_off_is_told_from_one_that_turns() -> None:
    flat = [[0.1, 0.11], [0.5, 0.51], [0.499, 0.508]]
    assert "levels off" in why(series({"gmsd": flat}, sensor="camera"), "gmsd")


def test_what_the_plain_error_does_at_the_step_is_said() -> None:
    turned = [[0.1, 0.11], [0.5, 0.51], [0.4, 0.41]]
    rises = series({"gmsd": turned, "psnr": [[30, 30], [25, 25], [20, 20]]}, sensor="camera")
    assert "the mean squared error rises" in why(rises, "gmsd")
    falls = series({"gmsd": turned, "psnr": [[30, 30], [25, 25], [26, 26]]}, sensor="camera")
    assert "the mean squared error does not rise either" in why(falls, "gmsd")


def test_a_percentile_of_zero_is_explained_by_the_share_of_points() -> None:
    zero = why(series({"hd95": np.zeros((3, 2))}), "hd95")
    assert "It is 0 at every level and for every seed." in zero
    assert "At every level at least 95 % of the points" in zero
    first = why(series({"hd95": [[0, 0], [0, 0], [0.5, 0.6]]}), "hd95")
    assert "from 1 to 5 mm/h" in first
    assert "At 1, 5 mm/h at least 95 % of the points" in first
    assert "95 %" not in why(series({"hd95": np.full((3, 2), 0.5)}), "hd95")


def test_sdm_s_turn_is_explained_by_the_distances_between_points_where_they_turn_too() -> None:
    sdm = [[0.1, 0.11], [0.3, 0.31], [0.2, 0.21]]
    distance = {"clear": 15.0, "levels": [[14, 14], [12, 12], [13, 13]]}
    outward = {"clear": 9.0, "levels": [[7, 7], [7.5, 7.5], [8, 8]]}
    turns = why(series({"sdm": sdm}, pair_distance_m=dict(distance), range_m=dict(outward)), "sdm")
    assert "15 m in clear air in the mean, 14, 12, 13 m at the levels" in turns
    assert "nearer to that of clear air again" in turns
    assert "farther out" in turns
    inward = {"clear": 9.0, "levels": [[7, 7], [7.5, 7.5], [6, 6]]}
    assert "farther out" not in why(series({"sdm": sdm}, pair_distance_m=dict(distance), range_m=inward), "sdm")
    away = {"clear": 15.0, "levels": [[14, 14], [12, 12], [11, 11]]}
    assert "nearer to" not in why(series({"sdm": sdm}, pair_distance_m=away, range_m=dict(outward)), "sdm")


def test_hausdorff_distance_s_miss_names_the_spread_of_the_seeds() -> None:
    text = why(series({"hd": [[1.0, 9.0], [7.0, 5.0], [6.0, 2.0]]}), "hd")
    # Standard deviations 5.66, 1.41, 2.83; steps of the mean 1 and 2.
    assert "differs by 3.3 m between seeds" in text
    assert "by 1.5 m between neighbouring levels" in text
    assert "with a probability of" in text
