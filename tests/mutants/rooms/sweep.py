"""Breaks of the sweep over severities."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

LEVELS = "torchweather.evaluation.sweep.levels"
TRENDS = "torchweather.evaluation.sweep.trends"

MUTANTS = (
    Mutant(
        "visibility_levels_rise",
        "weather is heavier where visibility is shorter",
        LEVELS,
        'RISES = {"rate_mm_per_h": True, "mor_m": False}',
        'RISES = {"rate_mm_per_h": True, "mor_m": True}',
        ("tests/evaluation/sweep/test_levels.py::test_rates_rise_and_visibilities_fall",),
    ),
    Mutant(
        "level_given_twice_accepted",
        "levels of a sweep differ",
        LEVELS,
        "if twice is not None:",
        "if False:",
        ("tests/evaluation/sweep/test_levels.py::test_what_is_no_list_of_levels_is_refused",),
    ),
    Mutant(
        "argument_given_twice_accepted",
        "an argument of a weather is given once",
        LEVELS,
        "if last in self.arguments:",
        "if False:",
        ("tests/evaluation/sweep/test_levels.py::test_what_is_no_list_of_levels_is_refused",),
    ),
    Mutant(
        "every_trend_significant",
        "Page's test is at the 5 % level",
        TRENDS,
        "SIGNIFICANT = 0.05",
        "SIGNIFICANT = 1.0",
        ("tests/evaluation/sweep/test_sweep_trends.py::test_hausdorff_distance_s_miss_names_the_spread_of_the_seeds",),
    ),
    Mutant(
        "page_test_of_the_frames",
        "Page's test ranks the levels within a frame",
        TRENDS,
        "page_trend_test(worsening.T)",
        "page_trend_test(worsening)",
        ("tests/evaluation/sweep/test_sweep_trends.py::test_page_probability_is_that_of_all_orders",),
    ),
    Mutant(
        "scatter_is_a_standard_deviation",
        "the mean of a step scatters by its standard error",
        "torchweather.evaluation.sweep.misses",
        "/ np.sqrt(len(step))",
        "",
        ("tests/evaluation/sweep/test_misses.py::test_a_step_is_compared_with_the_error_of_its_mean",),
    ),
)
