"""Breaks of the robustness test of a detector."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

INTERVALS = "torchweather.evaluation.robustness.intervals"
BOX_FORMS = "torchweather.evaluation.robustness.box_forms"

MUTANTS = (
    Mutant(
        "effect_of_the_condition_left_out",
        "a detector gets the data with the effects of the condition",
        "torchweather.evaluation.robustness.frames",
        "self.subject.run(condition.weather, seed, condition.effects)",
        "self.subject.run(condition.weather, seed)",
        ("tests/recipes/test_published_suites.py::test_a_detector_gets_a_cloud_with_the_effect_of_the_condition",),
    ),
    Mutant(
        "resilience_without_severities",
        "a resilience rate is over all severities",
        "torchweather.evaluation.robustness.rates",
        "_ratio(float(np.sum(v)), len(v) * clear)",
        "_ratio(float(np.sum(v)), clear)",
        ("tests/evaluation/robustness/test_rates.py::test_the_rates_are_those_of_the_papers",),
    ),
    Mutant(
        "interval_of_half_the_confidence",
        "a 95 % interval leaves 2.5 % on each side",
        INTERVALS,
        "tail = 50.0 * (1.0 - CONFIDENCE)",
        "tail = 500.0 * (1.0 - CONFIDENCE)",
        ("tests/evaluation/robustness/test_intervals.py::test_the_mean_over_frames_has_the_interval_of_the_textbook",),
    ),
    Mutant(
        "resamples_ignore_the_seed",
        "resampled frames repeat with their seed",
        INTERVALS,
        "np.random.SeedSequence(seed % 2**64)",
        "np.random.SeedSequence()",
        (
            (
                "tests/evaluation/robustness/test_intervals.py::"
                "test_intervals_are_repeated_by_the_seed_and_four_frames_have_none"
            ),
        ),
    ),
    Mutant(
        "suppression_across_classes",
        "non-maximum suppression is within a class",
        "torchweather.evaluation.robustness.suppression",
        "places = np.flatnonzero(labels == label)",
        "places = np.arange(len(labels))",
        (
            (
                "tests/evaluation/robustness/test_box_forms.py::test_dense_heads_give_every_class_of_a_place_and_"
                "suppress_within_a_class"
            ),
        ),
    ),
    Mutant(
        "yolov5_without_objectness",
        "a YOLOv5 score is objectness times class",
        BOX_FORMS,
        "active[:, :1] * active[:, 1:]",
        "active[:, 1:]",
        ("tests/evaluation/robustness/test_box_forms.py::test_every_layout_gives_the_boxes_in_the_frame",),
    ),
    Mutant(
        "detr_background_is_a_class",
        "the last logit of DETR is no object",
        BOX_FORMS,
        "scores[:, :-1].max(-1), scores[:, :-1].argmax(-1)",
        "scores.max(-1), scores.argmax(-1)",
        (
            (
                "tests/evaluation/robustness/test_box_forms.py::"
                "test_of_a_set_the_best_class_counts_though_no_object_is_surer"
            ),
        ),
    ),
    Mutant(
        "class_lost_in_weather_left_out",
        "a class that no frame shows in weather counts 0, not nothing",
        "torchweather.evaluation.robustness.performance",
        "by_class[name] = 0.0",
        "by_class[name] = 1.0",
        (
            (
                "tests/evaluation/robustness/test_performance.py::"
                "test_a_class_of_which_the_weather_took_all_has_nothing_left"
            ),
        ),
    ),
)
