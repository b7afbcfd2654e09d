"""Breaks of the validation against recordings, and of the fit to them."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

POWER_TESTS = "tests/evaluation/validation/test_power.py"
VALIDATION_TESTS = "tests/evaluation/validation/test_validation.py"
FIT_TESTS = "tests/evaluation/fit/test_fit_weather.py"
COMPARISON = "torchweather.evaluation.validation.comparison"

MUTANTS = (
    Mutant(
        "agreement_without_power",
        "frames that could not have differed do not agree",
        COMPARISON,
        "if factor not in there or self.power(factor) < POWER:",
        "if factor not in there:",
        (f"{POWER_TESTS}::test_agreement_takes_power",),
    ),
    Mutant(
        "power_of_one_side",
        "the scatter of the changed frames counts at their own number",
        COMPARISON,
        "parts = [(deviation / math.sqrt(count) if count else math.nan, count - 1), *own[1:]]",
        "parts = [(deviation / count if count else math.nan, count - 1), *own[1:]]",
        (f"{POWER_TESTS}::test_power_is_the_share_of_drawn_studies_that_differ",),
    ),
    Mutant(
        "effect_of_another_strength",
        "an effect is simulated at the strength that is stated",
        "torchweather.evaluation.validation.run",
        "found = scored(EFFECT_FRAMES, [tried.at(strength)])",
        "found = scored(EFFECT_FRAMES, [tried.at(20.0 * strength)])",
        (f"{POWER_TESTS}::test_an_effect_of_the_stated_strength_is_flagged",),
    ),
    Mutant(
        "exposure_gain_twice",
        "the exposure gain of a condition multiplies the light of its frames once",
        "torchweather.gap.sensors.camera.study_kind",
        "(exposure_gain * bayer).clamp_max(1.0)",
        "(exposure_gain * exposure_gain * bayer).clamp_max(1.0)",
        ("tests/gap/study/test_simulation.py::test_the_exposure_gain_of_the_condition_counts",),
    ),
    Mutant(
        "mask_does_not_answer_a_change",
        "parts that are masked or ignored are no change of the scene",
        "torchweather.gap.sensors.camera.study_kind",
        "None if mask is None else torch.from_numpy(np.asarray(mask) != 0),",
        "None,",
        ("tests/gap/sensors/camera/test_camera_frames.py::test_validate_and_fit_name_the_same_parts",),
    ),
    Mutant(
        "range_of_one_side",
        "a range holds the smaller values, too",
        "torchweather.evaluation.sensitivity.ranges",
        "ranges[name] = (given, min(least, value), max(largest, value))",
        "ranges[name] = (given, least, max(largest, value))",
        (
            "tests/evaluation/sensitivity/test_sensitivity.py::test_the_spread_of_visibility_is_in_the_range_of_snow[radar]",
        ),
    ),
    Mutant(
        "rounded_twice",
        "weather is put on intensities as they were before the sensor rounded them",
        "torchweather.gap.sensors.lidar.study_kind",
        "put_back = within_steps(levels, 1.0, seed)",
        "put_back = levels + 0.5",
        ("tests/gap/study/test_simulation.py::test_integers_are_rounded_once",),
    ),
    Mutant(
        "one_way_of_two",
        "the light of a LiDAR loses the extinction there and back",
        "torchweather.evaluation.fit.path_line",
        'range_m, -2.0, "extinction_per_m"',
        'range_m, -1.0, "extinction_per_m"',
        (f"{FIT_TESTS}::test_a_lidars_visibility_from_a_wrong_record",),
    ),
    Mutant(
        "noise_counts_as_contrast",
        "dark and bright lie at one depth, and are told by frames that are not measured",
        "torchweather.evaluation.fit.camera_light",
        "clear = np.mean(clear[:sorting], axis=0), clear[sorting:]",
        "clear = np.mean(clear[-1:], axis=0), clear[-1:]",
        (f"{FIT_TESTS}::test_noise_is_no_contrast",),
    ),
    Mutant(
        "masked_pixels_counted",
        "what a scene's mask leaves out does not count",
        "torchweather.evaluation.validation.frame_scores",
        'if "mask" not in geometry:',
        'if "mask" in geometry:',
        (f"{POWER_TESTS}::test_what_a_mask_leaves_out_does_not_count",),
    ),
    Mutant(
        "gain_on_measured_airlight",
        "airlight measured in the weather has the exposure of its own frames",
        "torchweather.evaluation.fit.camera_light",
        "gain = parameters[1] if exposed else 1.0",
        "gain = parameters[1]",
        (f"{FIT_TESTS}::test_a_cameras_visibility_airlight_and_gain",),
    ),
    Mutant(
        "whole_steps",
        "an integer level stands for the middle of its step",
        "torchweather.evaluation.fit.path_line",
        "HALF_STEP = 0.5",
        "HALF_STEP = 0.0",
        (f"{FIT_TESTS}::test_integers_that_are_rounded_once_give_the_rate",),
    ),
    Mutant(
        "embedded_rounded_twice",
        "weather acts on levels before the sensor rounds them",
        "torchweather.gap.study.embedded",
        "if lidar.intensity_unit in EIGHT_BITS else lidar",
        'if lidar.intensity_unit == "never" else lidar',
        (f"{FIT_TESTS}::test_the_embedded_study_rounds_once",),
    ),
    Mutant(
        "embedded_noise_of_one_frame",
        "every frame of the embedded study has noise of its own",
        "torchweather.gap.study.embedded",
        "with_sensor_noise(seen.bayer, noise)",
        "with_sensor_noise(seen.bayer, 0)",
        (f"{VALIDATION_TESTS}::test_frames_of_the_embedded_study_are_views_with_noise_of_their_own",),
    ),
    Mutant(
        "rendered_in_full",
        "a camera renders the shadows of drops alone",
        "torchweather.explain",
        'Q_RENDERED = {"rain": 1.0, "snow": 1.0, "fog": 2.0}',
        'Q_RENDERED = {"rain": 2.0, "snow": 2.0, "fog": 2.0}',
        ("tests/evaluation/sensitivity/test_sensitivity.py::test_what_the_camera_renders_is_what_explain_prints",),
    ),
)
