"""Coefficients against scipy, joins counted by hand, and what a metric says beyond the level of the weather."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from torchweather.metrics.coefficients import (
    Coefficient,
    spread,
    weighted_kendall,
    weighted_pearson,
    weighted_spearman,
)
from torchweather.metrics.correlation import MetricCorrelation, correlate
from torchweather.metrics.d34_claim import D34_CLAIM, check_claim
from torchweather.metrics.image_scores import IMAGE_SCORES
from torchweather.metrics.level_model import partial_correlation, prediction

Floats = NDArray[np.float64]


def one(scores: Any, performance: Any, **options: Any) -> MetricCorrelation:
    return correlate({"metric": scores}, performance, **options).metrics[0]


def tied(count: int, seed: int) -> tuple[Floats, Floats]:
    """Related numbers, many of them equal."""
    draw = np.random.default_rng(seed)
    x = draw.integers(0, count // 2, count).astype(np.float64)
    return x, np.round(x / 3 + draw.normal(0, 1.5, count))


# ---- coefficients --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_coefficients_are_those_of_scipy(seed: int) -> None:
    x, y = tied(20, seed)
    found = one(x, y)
    for name, function in (("pearson", stats.pearsonr), ("spearman", stats.spearmanr), ("kendall", stats.kendalltau)):
        wanted = function(x, y)
        coefficient: Coefficient = getattr(found, name)
        assert (coefficient.value, coefficient.p_value) == (wanted.statistic, wanted.pvalue)
        assert coefficient.low <= coefficient.value <= coefficient.high


def test_resamples_by_weight_are_those_by_repetition() -> None:
    x, y = tied(15, 7)
    draws = np.random.default_rng(0).multinomial(15, np.full(15, 1 / 15), size=50)
    for weighted, function in (
        (weighted_pearson, stats.pearsonr),
        (weighted_spearman, stats.spearmanr),
        (weighted_kendall, stats.kendalltau),
    ):
        repeated = [function(np.repeat(x, drawn), np.repeat(y, drawn)).statistic for drawn in draws]
        np.testing.assert_allclose(weighted(x, y, draws.astype(float)), repeated, rtol=0, atol=1e-12)


def test_a_resample_of_one_value_has_no_coefficient() -> None:
    x, y = np.array([0.1, 0.7, 0.9, 0.3]) + 1e3, np.array([0.3, 0.1, 0.2, 0.9])
    one_value = 4.0 * np.eye(4)
    for weighted in (weighted_pearson, weighted_spearman, weighted_kendall):
        assert np.isnan(weighted(x, y, one_value)).all()


def test_the_interval_covers_the_true_correlation() -> None:
    draw = np.random.default_rng(3)
    rho, count, repetitions = 0.6, 60, 400
    hits = 0
    for _ in range(repetitions):
        x = draw.normal(size=count)
        y = rho * x + math.sqrt(1 - rho**2) * draw.normal(size=count)
        drawn = draw.multinomial(count, np.full(count, 1 / count), size=400).astype(float)
        low, high = spread(weighted_pearson(x, y, drawn))
        hits += low <= rho <= high
    # Percentile intervals of 60 normal pairs cover 93 to 95 %; the standard error of 400 repetitions is 1.2 %, times 3.
    assert hits / repetitions == pytest.approx(0.94, abs=0.045)


def test_a_decreasing_metric_correlates_negatively() -> None:
    found = one([4, 3, 2, 1], [0.1, 0.2, 0.3, 0.4])
    assert (found.pearson.value, found.spearman.value, found.kendall.value) == pytest.approx((-1, -1, -1))


def test_ranks_ignore_the_scale_of_the_score_and_pearson_does_not() -> None:
    x = np.array([1.0, 2.0, 4.0, 7.0, 3.0, 9.0])
    y = np.array([0.3, 0.5, 0.4, 0.9, 0.1, 0.8])
    plain, bent = one(x, y), one(np.exp(x), y)
    assert bent.spearman == plain.spearman
    assert bent.kendall == plain.kendall
    assert abs(bent.pearson.value - plain.pearson.value) > 0.05


def test_an_infinite_score_is_the_largest_rank_and_no_point_of_a_line() -> None:
    psnr, ap = [math.inf, 40.0, 30.0, 25.0, 28.0], [0.9, 0.8, 0.5, 0.3, 0.35]
    found, without, large = one(psnr, ap), one(psnr[1:], ap[1:]), one([99.0, *psnr[1:]], ap)
    assert (found.conditions, found.infinite, found.prediction.conditions) == (5, 1, 4)
    assert found.spearman == large.spearman
    assert found.kendall == large.kendall
    assert found.pearson.value == without.pearson.value
    assert found.prediction == without.prediction


def test_what_never_changes_has_no_coefficient_but_a_reason() -> None:
    found = correlate({"flat": [2.0] * 5, "steep": [1, 2, 3, 4, 5]}, [0.1, 0.3, 0.2, 0.5, 0.4])
    assert [each.metric for each in found.metrics] == ["steep", "flat"]
    flat = found.metrics[1]
    assert (flat.rank, flat.rank_interval) == (None, None)
    for coefficient in (flat.pearson, flat.spearman, flat.kendall):
        assert math.isnan(coefficient.value)
        assert coefficient.reason == "all scores are equal"
    assert math.isnan(flat.prediction.rmse)
    same = one([1, 2, 3, 4], [0.5] * 4)
    assert same.spearman.reason == "all performances are equal"


def test_missing_scores_leave_their_conditions_out() -> None:
    x, y = [1.0, math.nan, 3.0, 5.0, 4.0, None], [0.1, 0.9, 0.2, 0.4, 0.3, 0.7]
    found = one(x, y)
    assert found.conditions == 4
    assert found.spearman.value == 1.0
    assert found.pearson.value == one([1, 3, 5, 4], [0.1, 0.2, 0.4, 0.3]).pearson.value
    few = one([1.0, None, None, None, 2.0, 3.0], y)
    assert "3 conditions with a score do not suffice" in few.spearman.reason


def test_the_same_seed_gives_the_same_intervals() -> None:
    x, y = tied(12, 3)
    assert one(x, y, seed=1).spearman == one(x, y, seed=1).spearman
    assert one(x, y, seed=1).spearman.low != one(x, y, seed=2).spearman.low


# ---- ranking -------------------------------------------------------------------------------------------------------


def test_metrics_are_ranked_by_the_size_of_rho_with_their_spread() -> None:
    draw = np.random.default_rng(0)
    y = draw.random(40)
    scores = {"noise": draw.random(40), "good": -y + draw.normal(0, 0.1, 40), "best": y**3}
    found = correlate(scores, y)
    assert [each.metric for each in found.metrics] == ["best", "good", "noise"]
    assert [each.rank for each in found.metrics] == [1, 2, 3]
    # 40 conditions tell rho = 1, about -0.9 and about 0 apart in every resample.
    assert [each.rank_interval for each in found.metrics] == [(1, 1), (2, 2), (3, 3)]


def test_metrics_of_one_worth_change_places_in_the_bootstrap() -> None:
    draw = np.random.default_rng(1)
    y = draw.random(12)
    found = correlate({name: y + draw.normal(0, 0.2, 12) for name in "abcd"}, y)
    assert {each.rank_interval for each in found.metrics} & {(1, 4), (1, 3), (2, 4)}
    equal = correlate({"a": y, "b": 2 * y}, y)
    assert [each.rank for each in equal.metrics] == [1, 1]


# ---- tables --------------------------------------------------------------------------------------------------------

LEVELS = [("rain", 1.0), ("rain", 10.0), ("rain", 50.0), ("fog", 500.0), ("fog", 100.0), ("fog", 30.0)]
AP = {("rain", 1.0): 0.9, ("rain", 10.0): 0.7, ("rain", 50.0): 0.6}
AP |= {("fog", 500.0): 0.8, ("fog", 100.0): 0.4, ("fog", 30.0): 0.1}


def sweep_table(seeds: int = 3, noise: float = 0.0, subjects: tuple[str, ...] = ("track",)) -> dict[str, list[Any]]:
    """Rows as a sweep writes them; ``ssim`` is the performance, ``gmsd`` its opposite."""
    draw = np.random.default_rng(5)
    names = ("subject", "sensor", "weather", "knob", "value", "severity", "seed", "metric", "score")
    rows = []
    for subject in subjects:
        for number, (weather, value) in enumerate(LEVELS):
            for seed in range(seeds):
                knob = "rate_mm_per_h" if weather == "rain" else "mor_m"
                start = (subject, "camera", weather, knob, value, number % 3 + 1, seed)
                score = AP[weather, value] + float(draw.normal(0, 1)) * noise
                rows += [(*start, "ssim", score), (*start, "gmsd", -2 * score)]
    return {name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


def performance_table(**more: list[Any]) -> dict[str, list[Any]]:
    order = [3, 0, 5, 1, 4, 2]
    levels = [LEVELS[k] for k in order]
    return {
        "weather": [weather for weather, _ in levels],
        "value": [value for _, value in levels],
        "performance": [AP[level] for level in levels],
        **more,
    }


def test_tables_are_joined_by_what_they_share_and_seeds_are_averaged() -> None:
    found = correlate(sweep_table(), performance_table())
    assert found.data.by == ("weather", "value")
    assert len(found.data.performance) == 6
    ssim, gmsd = (next(each for each in found.metrics if each.metric == name) for name in ("ssim", "gmsd"))
    assert ssim.conditions == 6
    assert (ssim.pearson.value, gmsd.pearson.value) == pytest.approx((1.0, -1.0))
    assert (found.data.scored_only, found.data.performed_only) == (0, 0)


def test_more_seeds_do_not_narrow_the_interval() -> None:
    few, many = (correlate(sweep_table(seeds), performance_table()).metrics[0] for seeds in (2, 20))
    assert few.conditions == many.conditions == 6
    assert (few.kendall.low, few.kendall.high) == (many.kendall.low, many.kendall.high)


def test_scores_are_means_over_the_seeds() -> None:
    table = sweep_table(seeds=4, noise=0.3)
    found = correlate(table, performance_table())
    for k, (weather, value) in enumerate(zip(*found.data.labels.values(), strict=True)):
        rows = zip(table["weather"], table["value"], table["metric"], table["score"], strict=True)
        mean = np.mean([score for w, v, metric, score in rows if (w, v, metric) == (weather, value, "ssim")])
        assert found.data.scores["ssim"][k] == pytest.approx(mean, abs=1e-15)
        assert found.data.performance[k] == AP[weather, value]


def test_seeds_that_both_tables_have_are_matched_and_then_averaged() -> None:
    performance = {name: column * 3 for name, column in performance_table().items()}
    performance["seed"] = [seed for seed in range(3) for _ in range(6)]
    performance["performance"][6:12] = [None] * 6  # of seed 1 there is none
    scores = sweep_table()
    scores["score"] = [
        99.0 if seed == 1 else score for seed, score in zip(scores["seed"], scores["score"], strict=True)
    ]
    found = correlate(scores, performance)
    assert found.data.by == ("weather", "value")
    assert found.metrics[0].conditions == 6
    assert found.data.scores["ssim"] == pytest.approx(found.data.performance)
    assert len(correlate(scores, performance, by=["weather", "value", "seed"]).data.performance) == 12


def test_the_performance_of_several_classes_is_their_mean() -> None:
    one_class = performance_table()
    twice = {name: [*column, *column] for name, column in one_class.items()}
    twice["performance"] = [p + shift for shift in (-0.05, 0.05) for p in one_class["performance"]]
    twice["class"] = ["car"] * 6 + ["person"] * 6
    found = correlate(sweep_table(), twice)
    assert found.data.performance == pytest.approx(correlate(sweep_table(), one_class).data.performance)


def test_subjects_are_conditions_where_both_tables_tell_them_apart() -> None:
    scores = sweep_table(subjects=("a", "b"))
    both = {name: [*column, *column] for name, column in performance_table().items()}
    both["subject"] = ["a"] * 6 + ["b"] * 6
    assert len(correlate(scores, both).data.performance) == 12
    assert len(correlate(scores, performance_table()).data.performance) == 6
    assert len(correlate(scores, both, by=["weather", "value"]).data.performance) == 6


def test_conditions_of_one_table_only_are_left_out_and_counted() -> None:
    performance = performance_table()
    performance["value"][0] = 1234.0
    found = correlate(sweep_table(), performance)
    assert (len(found.data.performance), found.data.scored_only, found.data.performed_only) == (5, 1, 1)
    performance = performance_table()
    performance["performance"][:2] = [math.nan, None]
    assert len(correlate(sweep_table(), performance).data.performance) == 4


def test_a_performance_by_severity_is_joined_by_it() -> None:
    scores = sweep_table()
    performance = {
        "weather": ["rain"] * 3 + ["fog"] * 3,
        "severity": [1, 2, 3] * 2,
        "AP": [AP[level] for level in LEVELS],
    }
    found = correlate(scores, performance, performance_column="AP")
    assert found.data.by == ("weather", "severity")
    assert found.metrics[0].pearson.value == pytest.approx(1.0)


def test_everything_found_becomes_json() -> None:
    found = correlate(sweep_table(noise=0.1), performance_table())
    again = json.loads(json.dumps(found.to_dict()))
    assert again["conditions"] == 6
    assert again["metrics"][0]["metric"] == found.metrics[0].metric
    assert len(again["table"]["performance"]) == len(again["table"]["score_ssim"]) == 6


@pytest.mark.parametrize(
    ("scores", "performance", "options", "said"),
    [
        ({"a": [1, 2, 3]}, [1, 2, 3], {}, "4 conditions or more with a performance; got 3.*Sweep more levels"),
        ({"a": [1, 2, 3, 4, 5]}, [1, 2, 3, 4], {}, "one value a condition, 4 as the performance; got 5"),
        ({"a": [1, 2, 3, 4]}, [1, 2, 3, math.inf], {}, "must be finite"),
        ({"a": [1, 2, "x", 4]}, [1, 2, 3, 4], {}, "a must hold numbers; got 'x'"),
        ({}, [1, 2, 3, 4], {}, "one metric or more; got none"),
        ({"a": [1, 2, 3, 4]}, [1, 2, 3, 4], {"by": ["weather"]}, "by needs a table"),
        ({"a": [1, 2, 3, 4]}, [1, 2, 3, 4], {"resamples": 0}, "resamples must be 1 or more"),
        ({"a": [1, 2, 3, 4]}, [1, 2, 3, 4], {"highly": 2.0}, "highly must lie in 0..1"),
        (sweep_table(), [1, 2, 3, 4], {}, "performance must be a table"),
        (sweep_table(), performance_table(), {"performance_column": "AP"}, "column 'AP'; got weather, value"),
        (sweep_table(), performance_table(), {"by": ["subject"]}, "both tables have, weather, value"),
        (sweep_table(), {"performance": [1, 2]}, {}, "must share condition columns"),
        (sweep_table(), {**performance_table(), "value": ["x"] * 6}, {}, "no condition stands in both tables"),
        (sweep_table(), {**performance_table(), "value": [1.0]}, {}, "must be of one length"),
    ],
)
def test_what_cannot_be_correlated_is_refused(
    scores: Any, performance: Any, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        correlate(scores, performance, **options)


# ---- beyond the level ----------------------------------------------------------------------------------------------

KINDS = ["rain"] * 8 + ["fog"] * 8
STEPS = np.tile(np.arange(1.0, 9.0), 2)


def test_one_kind_of_weather_gives_the_textbook_formula() -> None:
    x, y = tied(14, 2)
    level = np.arange(1.0, 15.0)
    found = partial_correlation(x, y, ["rain"] * 14, level, ranks=False)
    r = np.corrcoef([x, y, level])
    wanted = (r[0, 1] - r[0, 2] * r[1, 2]) / math.sqrt((1 - r[0, 2] ** 2) * (1 - r[1, 2] ** 2))
    assert found.value == pytest.approx(wanted, abs=1e-12)
    assert found.degrees_of_freedom == 11
    # Student's t, as for a plain correlation of one condition less.
    t = wanted * math.sqrt(11 / (1 - wanted**2))
    assert found.p_value == pytest.approx(2 * stats.t.sf(abs(t), 11), rel=1e-9)


def test_a_metric_that_only_follows_the_level_says_nothing_more() -> None:
    draw = np.random.default_rng(4)
    slope = np.where(np.array(KINDS) == "rain", -0.05, -0.1)
    values, p_values = [], []
    for _ in range(300):
        performance = 0.9 + slope * STEPS + draw.normal(0, 0.05, 16)
        metric = 3.0 * slope * STEPS + draw.normal(0, 0.1, 16)
        assert abs(np.corrcoef(metric, performance)[0, 1]) > 0.5  # though they correlate
        found = partial_correlation(metric, performance, KINDS, STEPS, ranks=False)
        values.append(found.value)
        p_values.append(found.p_value)
    # 11 degrees of freedom: standard deviation 0.29, of the mean of 300 0.017, three of them; 5 % of p-values below
    # 0.05, give or take three standard errors of 1.3 %.
    assert abs(np.mean(values)) < 0.05
    assert np.mean(np.array(p_values) < 0.05) == pytest.approx(0.05, abs=0.038)


@pytest.mark.parametrize("ranks", [False, True])
def test_a_metric_that_follows_the_detector_itself_says_more_than_the_level(ranks: bool) -> None:
    draw = np.random.default_rng(4)
    performance = 0.9 - 0.08 * STEPS + draw.normal(0, 0.05, 16)
    found = partial_correlation(-np.log(2.0 - performance), performance, KINDS, STEPS, ranks=ranks)
    assert found.value > 0.97
    assert found.p_value < 1e-4


def test_partial_correlation_says_why_it_has_no_value() -> None:
    x, y = tied(16, 1)
    assert "no columns weather" in partial_correlation(x, y, None, None, ranks=True).reason
    assert "do not suffice" in partial_correlation(x[6:11], y[6:11], KINDS[6:11], STEPS[6:11], ranks=True).reason
    assert partial_correlation(STEPS, y, KINDS, STEPS, ranks=False).reason == "the level explains the score wholly"


def test_prediction_leaves_out_one_condition_at_a_time() -> None:
    x, y = tied(16, 6)
    found = prediction(x, y, KINDS, STEPS)
    by_metric, by_level = [], []
    for k in range(16):
        others = np.arange(16) != k
        by_metric.append(np.polyval(np.polyfit(x[others], y[others], 1), x[k]) - y[k])
        alike = others & (np.array(KINDS) == KINDS[k])
        by_level.append(np.polyval(np.polyfit(STEPS[alike], y[alike], 1), STEPS[k]) - y[k])
    assert found.rmse == pytest.approx(np.sqrt(np.mean(np.square(by_metric))), rel=1e-9)
    assert found.rmse_of_level == pytest.approx(np.sqrt(np.mean(np.square(by_level))), rel=1e-9)
    assert found.rmse_of_mean == pytest.approx(np.std(y) * 16 / 15, rel=1e-12)


def test_prediction_by_a_perfect_metric_has_no_error() -> None:
    y = np.linspace(0.1, 0.9, 9)
    found = prediction(5 - 3 * y, y, None, None)
    assert found.rmse == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(found.rmse_of_level)
    assert found.rmse_of_mean > 0.2


def test_a_kind_with_one_condition_is_predicted_by_the_others_mean() -> None:
    y = np.array([0.8, 0.6, 0.4, 0.9])
    found = prediction(np.array([1.0, 2.0, 3.0, 4.0]), y, ["rain"] * 3 + ["snow"], np.array([1.0, 2.0, 3.0, 1.0]))
    # The rain is a straight line; the snow is met by the mean 0.6.
    assert found.rmse_of_level == pytest.approx(0.3 / 2, abs=1e-12)


def test_levels_rank_visibility_as_well_as_rate() -> None:
    scores, performance = sweep_table(noise=0.02), performance_table()
    with_severity = correlate(scores, performance)
    del scores["severity"]
    without = correlate(scores, performance)
    assert with_severity.data.level is not None
    # Fog's order turns round, which changes the sign of its slope and nothing else.
    for one_way, other_way in zip(with_severity.metrics, without.metrics, strict=True):
        assert one_way.prediction.rmse_of_level == pytest.approx(other_way.prediction.rmse_of_level)


# ---- the claim of D3.4 ---------------------------------------------------------------------------------------------


def test_the_claim_is_about_all_image_scores() -> None:
    assert {*D34_CLAIM.high, *D34_CLAIM.not_high} == {*IMAGE_SCORES}
    assert (len(D34_CLAIM.high), len(D34_CLAIM.not_high)) == (11, 3)


@pytest.mark.parametrize(
    ("metric", "interval", "verdict"),
    [
        ("ssim", (0.75, 0.95), "agrees"),
        ("ssim", (-0.95, -0.75), "agrees"),
        ("ssim", (0.6, 0.9), "cannot be judged"),
        ("ssim", (-0.3, 0.6), "contradicts"),
        ("psnr", (-0.3, 0.6), "agrees"),
        ("psnr", (0.75, 0.95), "contradicts"),
        ("psnr", (-0.2, 0.9), "cannot be judged"),
        ("HAAR-PSI", (0.8, 0.9), "agrees"),
        ("MS-GMSD", (-0.9, -0.8), "agrees"),
        ("vif", (math.nan, math.nan), "cannot be judged"),
    ],
)
def test_a_claim_is_judged_by_the_whole_interval(metric: str, interval: tuple[float, float], verdict: str) -> None:
    [found] = check_claim({metric: Coefficient(sum(interval) / 2, *interval, 0.01)})
    assert found.verdict == verdict


def test_metrics_that_the_claim_does_not_name_are_not_judged() -> None:
    assert check_claim({"hd95": Coefficient(0.9, 0.8, 0.95, 0.01)}) == ()


def test_the_threshold_is_the_users() -> None:
    ssim = {"ssim": Coefficient(0.8, 0.75, 0.85, 0.01)}
    assert check_claim(ssim)[0].verdict == "agrees"
    assert check_claim(ssim, highly=0.9)[0].verdict == "contradicts"
