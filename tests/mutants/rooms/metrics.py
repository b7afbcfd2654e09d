"""Breaks of the scores and of their statistics."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

BOX_OVERLAP = "torchweather.metrics.box_overlap"
DETECTION_CURVE = "torchweather.metrics.detection_curve"
TRENDS = "torchweather.metrics.trends"

MUTANTS = (
    Mutant(
        "spread_about_the_phase_with_its_sign",
        "energy is less by the spread about the mean phase, by compiled loops too",
        "torchweather.metrics.compiled_phase",
        "across += abs(even * odd_mean - odd * even_mean)",
        "across += even * odd_mean - odd * even_mean",
        ("tests/metrics/test_compiled_phase.py::test_fsim_by_compiled_loops_is_that_of_torch",),
    ),
    Mutant(
        "psnr_of_amplitude",
        "PSNR is 10 log10 of the mean square",
        "torchweather.metrics.psnr",
        "-10.0 * safe.log10()",
        "-20.0 * safe.log10()",
        ("tests/metrics/test_psnr.py::test_oracle",),
    ),
    Mutant(
        "ssim_constant_of_contrast",
        "SSIM's K2 is 0.03",
        "torchweather.metrics.ssim",
        "K1, K2 = 0.01, 0.03",
        "K1, K2 = 0.01, 0.01",
        ("tests/metrics/test_ssim.py::test_oracle",),
    ),
    Mutant(
        "fsim_noise_of_complex_filters",
        "noise through a filter's real part has the power of its even part",
        "torchweather.metrics.phase_congruency",
        "(0.5 * (together + turned))",
        "together",
        ("tests/metrics/test_fsim.py::test_noise_through_the_filters_is_that_over_the_image",),
    ),
    Mutant(
        "iou_over_the_sum",
        "an overlap is over the union, not the sum of the areas",
        BOX_OVERLAP,
        "return _over(shared, area[:, None] + other[None] - shared)",
        "return _over(shared, area[:, None] + other[None])",
        ("tests/metrics/test_box_overlap.py::test_touching_nested_and_flat_rectangles",),
    ),
    Mutant(
        "bev_yaw_ignored",
        "boxes on the ground are turned",
        BOX_OVERLAP,
        "turn = (first[:, None, 4] - second[None, :, 4])[..., None]",
        "turn = 0.0 * (first[:, None, 4] - second[None, :, 4])[..., None]",
        ("tests/metrics/test_box_overlap.py::test_an_octagon_is_shared_by_squares_turned_by_half_a_quarter",),
    ),
    Mutant(
        "kitti_recalls_of_coco",
        "KITTI's AP takes 40 recalls without 0",
        DETECTION_CURVE,
        "KITTI_RECALLS = np.arange(1, 41) / 40",
        "KITTI_RECALLS = np.arange(0, 41) / 40",
        ("tests/metrics/test_detection.py::test_precision_counted_by_hand",),
    ),
    Mutant(
        "precision_not_made_to_fall",
        "AP takes the best precision at a recall or beyond",
        DETECTION_CURVE,
        "falling = np.maximum.accumulate(precision[::-1])[::-1]",
        "falling = precision",
        ("tests/metrics/test_detection.py::test_the_score_is_that_of_pycocotools",),
    ),
    Mutant(
        "bootstrap_of_trends_ignores_seed",
        "a bootstrap repeats with its seed",
        TRENDS,
        "self.generator = np.random.default_rng(seed)",
        "self.generator = np.random.default_rng()",
        ("tests/metrics/test_trends.py::test_one_seed_gives_one_answer",),
    ),
    Mutant(
        "higher_is_better_reversed",
        "the direction of a metric turns the sign of its trend",
        TRENDS,
        'sign = 1.0 if direction[metric] == "down" else -1.0',
        "sign = 1.0",
        ("tests/metrics/test_trends.py::test_counts_leave_out_what_cannot_be_judged",),
    ),
    Mutant(
        "missing_points_are_points",
        "a row of zeros is a beam without return",
        "torchweather.metrics.clouds",
        "found = (size > 0) & (size < torch.inf)",
        "found = size < torch.inf",
        ("tests/metrics/test_clouds.py::test_empty_clouds_have_defined_scores",),
    ),
    Mutant(
        "rank_of_the_signed_coefficient",
        "metrics are ranked by the size of their correlation",
        "torchweather.metrics.correlation",
        "sizes = np.array([abs(each.spearman.value) for each in with_value])",
        "sizes = np.array([each.spearman.value for each in with_value])",
        ("tests/metrics/test_correlation.py::test_metrics_are_ranked_by_the_size_of_rho_with_their_spread",),
    ),
    Mutant(
        "sr_sim_whitens_rounding_noise",
        "a frequency that an image lacks has no part in its saliency",
        "torchweather.metrics.sr_sim",
        "ABSENT = 1e-3",
        "ABSENT = 1e-16",
        ("tests/metrics/test_sr_sim.py::test_float32_gives_the_float64_value_where_frequencies_are_absent",),
    ),
    Mutant(
        "scores_rounded_by_autocast",
        "a score is the same inside autocast",
        "torchweather.core.precision",
        "with torch.autocast(device, enabled=False):",
        "with torch.autocast(device, enabled=True):\n                    return function(*args, **kwargs)",
        ("tests/metrics/test_autocast.py::test_bayer_scores",),
    ),
)
