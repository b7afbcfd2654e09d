"""Every lack of a study is found, by its words, and a study without a lack is clean."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.gap.studies import FRAMES, H, L, P, T, W, arguments, study
from torchweather.gap.diagnosis import LEVELS, Finding, diagnose
from torchweather.gap.study.study import Study


def found(values: dict[str, Any]) -> list[Finding]:
    return diagnose(Study.from_arrays(**values))


def only(values: dict[str, Any], start: str) -> Finding:
    """The one finding whose first sentence starts so."""
    matching = [one for one in found(values) if one.what.startswith(start)]
    assert len(matching) == 1, [one.what for one in found(values)]
    return matching[0]


@pytest.fixture
def lidar() -> dict[str, Any]:
    values = copy.deepcopy(arguments("lidar"))
    # Of the five conditions of a whole study three lack nothing: rain at two rates, snow in the other scene.
    values["conditions"] = [one for one in values["conditions"] if one["id"] in ("c0", "c2", "c4")]
    values["conditions"][1]["scene"] = "s1"
    return values


def test_a_study_that_lacks_nothing_has_no_findings(lidar: dict[str, Any]) -> None:
    assert found(lidar) == []


@pytest.mark.parametrize("kind", ["camera", "radar"])
def test_a_camera_and_a_radar_study_that_lack_nothing_have_no_findings(kind: str) -> None:
    assert diagnose(study(kind)) == []


def test_links_that_lack_nothing_have_no_findings() -> None:
    assert diagnose(study("link")) == []


def test_findings_come_worst_first_and_read_as_sentences(lidar: dict[str, Any]) -> None:
    lidar["scenes"] = [{**lidar["scenes"][0], "clear": lidar["scenes"][0]["clear"][:1]}]
    del lidar["scenes"][0]["geometry"]
    for one in lidar["conditions"]:
        one["scene"] = "s0"
    levels = [one.level for one in found(lidar)]
    assert levels == sorted(levels, key=LEVELS.index)
    assert set(levels) == set(LEVELS)
    for one in found(lidar):
        for sentence in (one.what, one.cost, one.advice):
            assert sentence[0].isupper() or sentence.startswith(("radar.", "lidar.", "camera.")), sentence
            assert sentence.endswith(".")
        assert str(one).startswith(f"{one.level}: {one.what}")


def test_one_clear_frame_is_an_error(lidar: dict[str, Any]) -> None:
    lidar["scenes"][1]["clear"] = lidar["scenes"][1]["clear"][:1]
    assert only(lidar, "The scene s1 has one clear frame").level == "error"


@pytest.mark.parametrize(("n", "wider", "known"), [(2, 41, 71), (3, 22, 50), (5, 12, 35), (7, 8, 29)])
def test_few_clear_frames_widen_the_floor_by_the_stated_share(
    lidar: dict[str, Any], n: int, wider: int, known: int
) -> None:
    # sqrt(n / (n - 1)) - 1 and 1 / sqrt(2 (n - 1)), by hand.
    lidar["scenes"][0]["clear"] = lidar["scenes"][0]["clear"][:n]
    one = only(lidar, f"The scene s0 has {n} clear frames")
    assert one.level == "warning"
    assert f"{wider} % wider" in one.cost
    assert f"known to {known} %" in one.cost


def test_the_shares_said_are_those_of_normal_frames() -> None:
    """20,000 draws: the standard error of a standard deviation's share is 0.5 % of it."""
    rng = np.random.default_rng(0)
    for n in (2, 5):
        draws = rng.standard_normal((20_000, n))
        against_the_others = draws[:, 0] - draws[:, 1:].mean(1)
        assert against_the_others.std() == pytest.approx(math.sqrt(n / (n - 1)), rel=0.02)
    spread = rng.standard_normal((20_000, 8)).std(1, ddof=1)
    # 1 / sqrt(2 (n - 1)) is the leading term; of eight frames it is 2 % too much.
    assert spread.std() / spread.mean() == pytest.approx(1 / math.sqrt(14), rel=0.04)


def test_few_frames_of_a_condition(lidar: dict[str, Any]) -> None:
    lidar["conditions"][0] |= {"frames": lidar["conditions"][0]["frames"][:1], "time_s": None}
    lidar["conditions"][1] |= {"frames": lidar["conditions"][1]["frames"][:2], "time_s": [0.0, 0.1]}
    single, few = only(lidar, "The condition c0 has one frame"), only(lidar, "The condition c2 has fewer than 5 frames")
    assert (single.level, few.level) == ("warning", "warning")
    assert "lidar.patchy_weather cannot be seen" in single.cost
    assert "2.2 times" in single.cost  # sqrt(5 / 1)
    assert "1.6 times" in few.cost  # sqrt(5 / 2)


def test_no_time(lidar: dict[str, Any]) -> None:
    for one in lidar["conditions"]:
        del one["time_s"]
    one = only(lidar, "The conditions c0, c2, c4 have no time_s")
    assert one.level == "note"
    assert "lidar.window_loss" in one.cost


# ---- copies ----------------------------------------------------------------------------------------------------------


def test_copies_sold_as_replicates_are_an_error(lidar: dict[str, Any]) -> None:
    frames = lidar["conditions"][0]["frames"]
    frames[3], frames[4] = copy.deepcopy(frames[0]), copy.deepcopy(frames[0])
    one = only(lidar, "The condition c0 has 2 of 5 frames that repeat")
    assert one.level == "error"
    assert "as if 5 frames were known where there are 3" in one.cost
    # A last digit that differs is another frame: noise is what makes replicates.
    frames[3]["range_m"][0, 0] += 1e-9
    assert only(lidar, "The condition c0 has 1 of 5 frames")


def test_clear_frames_without_noise_are_an_error(lidar: dict[str, Any]) -> None:
    lidar["scenes"][0]["clear"] = [lidar["scenes"][0]["clear"][0]] * 8
    one = only(lidar, "All 8 clear frames of the scene s0 are the same")
    assert one.level == "error"
    assert "zero" in one.cost
    lidar["scenes"][0]["clear"] = [*lidar["scenes"][0]["clear"][:7], FRAMES["lidar"](np.random.default_rng(9))]
    assert only(lidar, "The scene s0 has 6 of 8 frames that repeat").level == "error"


def test_clear_frames_passed_for_weather_and_frames_of_two_conditions_are_errors(lidar: dict[str, Any]) -> None:
    lidar["conditions"][0]["frames"][0] = lidar["scenes"][1]["clear"][3]
    assert only(lidar, "1 frames of the condition c0 are clear frames of the scene s1").level == "error"
    lidar["conditions"][0]["frames"][0] = lidar["conditions"][2]["frames"][2]
    assert only(lidar, "The conditions c0 and c4 share frames").level == "error"


# ---- weather and split -----------------------------------------------------------------------------------------------


def test_a_record_without_uncertainty(lidar: dict[str, Any]) -> None:
    del lidar["conditions"][1]["weather"]["rate_rel_sd"]
    one = only(lidar, "The condition c2 has no uncertainty of the weather record")
    assert one.level == "warning"
    assert "lidar.extinction_scale" in one.cost


@pytest.mark.parametrize("weather", ["rain:rate=0", "fog:mor=inf", "snow:rate=0"])
def test_a_record_of_zero(lidar: dict[str, Any], weather: str) -> None:
    lidar["conditions"][1] |= {"weather": weather, "rel_sd": 0.1}
    assert only(lidar, "The condition c2 has a recorded rate of 0").level == "warning"


def test_only_clear_air_is_an_error(lidar: dict[str, Any]) -> None:
    for one in lidar["conditions"]:
        one["weather"] = "clear"
    assert only(lidar, "No condition has weather").level == "error"


def test_a_single_condition_and_one_scene(lidar: dict[str, Any]) -> None:
    lidar["conditions"] = lidar["conditions"][:1]
    lidar["scenes"] = lidar["scenes"][:1]
    assert only(lidar, "There is a single condition").level == "warning"
    assert only(lidar, "There is one scene").level == "note"
    assert not [one for one in found(lidar) if one.what.startswith("No condition is held out")]


def test_splits_that_hold_nothing_or_all_or_the_same_out(lidar: dict[str, Any]) -> None:
    for one in lidar["conditions"]:
        one["split"] = "fit"
    assert only(lidar, "No condition is held out").level == "warning"
    for one in lidar["conditions"]:
        one["split"] = "holdout"
    assert only(lidar, "All conditions are held out").level == "error"
    lidar["conditions"][0]["split"] = "fit"
    lidar["conditions"][2]["weather"] = dict(lidar["conditions"][0]["weather"])
    assert only(lidar, "The condition c4 has the scene and the weather of a condition to fit to").level == "warning"


# ---- what each sensor needs ------------------------------------------------------------------------------------------


def test_a_lidar_without_geometry(lidar: dict[str, Any]) -> None:
    del lidar["scenes"][0]["geometry"]
    assert (
        "lidar.wet_target cannot be distinguished from lidar.window_loss"
        in only(lidar, "The scene s0 has no cos_inc").cost
    )
    assert only(lidar, "The scene s0 has no up").level == "note"


def all_frames(values: dict[str, Any]) -> list[dict[str, Any]]:
    return [frame for one in values["scenes"] for frame in one["clear"]] + [
        frame for one in values["conditions"] for frame in one["frames"]
    ]


def test_equal_intensities(lidar: dict[str, Any]) -> None:
    for frame in all_frames(lidar):
        frame["intensity"] = np.where(frame["range_m"] > 0, 0.1, 0.0)
    one = only(lidar, "All intensities are equal")
    assert "lidar.threshold_shift" in one.cost
    all_frames(lidar)[0]["intensity"][all_frames(lidar)[0]["range_m"] > 0] = 0.2
    assert not [one for one in found(lidar) if one.what.startswith("All intensities")]


@pytest.mark.parametrize(("unit", "factor"), [("reflectivity", 255.0), ("uint8_linear", 1.0), ("photons", None)])
def test_intensities_of_another_unit(lidar: dict[str, Any], unit: str, factor: float | None) -> None:
    """Of white and of black: half of the returns of the study have a reflectivity about 0.5."""
    lidar["sensor"] = replace(lidar["sensor"], intensity_unit=unit)
    for frame in all_frames(lidar):
        frame["intensity"] = frame["intensity"] * (factor or 1.0)
    said = [one for one in found(lidar) if one.what.startswith("The median intensity of the clear frames")]
    assert [one.level for one in said] == ([] if factor is None else ["warning", "warning"])


def test_returns_without_intensity_are_an_error_unless_the_unit_says_so(lidar: dict[str, Any]) -> None:
    for frame in all_frames(lidar):
        frame["intensity"] = np.zeros((H, W))
    one = only(lidar, "The clear frames of s0, s1 have returns and no intensity (Study.from_arrays: scenes[0].clear)")
    assert one.level == "error"
    lidar["sensor"] = replace(lidar["sensor"], intensity_unit="none")
    assert not [one for one in found(lidar) if one.level == "error"]
    assert only(lidar, "All intensities are equal").level == "warning"


def test_a_scene_in_which_few_beams_see_one_surface(lidar: dict[str, Any]) -> None:
    """A drive sold as one scene: surfaces at another range in each frame, and beams that return in some."""
    clear = lidar["scenes"][0]["clear"]
    returning = np.flatnonzero(clear[0]["range_m"])

    def change(frame: dict[str, Any], beams: Any, range_m: float) -> None:
        frame["range_m"].flat[beams] = range_m

    number = len(returning) // 5
    moved, missing = returning[:number], returning[number : 2 * number]
    change(clear[1], moved, 12.0)
    few = [one for one in found(lidar) if "see one surface" in one.what]
    assert not few  # four fifths and more are enough
    change(clear[2], missing, 0.0)
    stable = 100 * (1 - 2 * number / len(returning))
    one = only(lidar, f"{stable:.0f} % of the beams of scene s0 that return see one surface in all 8 clear frames")
    assert one.level == "note"
    share = f"{100 * number / len(returning):.0f} %"
    assert f"{share} have no return in some, {share} return from several ranges" in one.what
    change(clear[3], returning[: 4 * number], 12.0)
    (worse,) = [one for one in found(lidar) if "see one surface" in one.what]
    assert worse.level == "warning"


def test_a_scene_without_a_condition(lidar: dict[str, Any]) -> None:
    for one in lidar["conditions"]:
        one["scene"] = "s0"
    assert only(lidar, "No condition belongs to the scene s1").level == "note"


def test_frames_without_returns(lidar: dict[str, Any]) -> None:
    none = np.zeros((H, W))
    for k, frame in enumerate(lidar["conditions"][0]["frames"]):
        frame |= {"range_m": none, "intensity": none + k}
    assert only(lidar, "The condition c0 has no return in any frame").level == "warning"
    for k, frame in enumerate(lidar["scenes"][0]["clear"]):
        frame |= {"range_m": none, "intensity": none + 10 + k}
    assert only(lidar, "The clear frames of s0 have no return").level == "error"


def test_a_camera_scene_of_one_depth_and_without_normals() -> None:
    values = arguments("camera")
    values["scenes"][0]["geometry"] = {"depth_m": np.full((H, W), 30.0)}
    assert "camera.airlight_scale" in only(values, "The scene s0 has one depth").cost
    assert "camera.wet_surface" in only(values, "The scene s0 has no normal and no label").cost
    values["scenes"][0]["geometry"]["depth_m"] = np.full((H, W), np.inf)
    assert only(values, "The scene s0 has one depth").level == "warning"


def test_a_black_camera_is_an_error() -> None:
    values = arguments("camera")
    for k, frame in enumerate(all_frames(values)):
        frame["bayer"] = np.full((H, W), k / 100.0)
    assert only(values, "All pixels of a frame are equal").level == "error"


def test_a_radar_without_clutter_and_with_one_class() -> None:
    values = arguments("radar")
    for frame in all_frames(values):
        del frame["clutter"]
    assert "radar.volume_clutter" in only(values, "No frame has clutter").cost
    values["scenes"][1]["geometry"]["target_class"] = np.zeros(5)
    assert "radar.wet_rcs" in only(values, "All targets of the scene s1 are of one class").cost


@pytest.mark.parametrize(
    ("links", "frame", "what", "level"),
    [
        ({"split": np.zeros(L)}, {}, "No link is held out", "warning"),
        ({"split": np.ones(L)}, {}, "All links are held out", "error"),
        ({"length_km": np.full(L, 2.0)}, {}, "All links are about as long", "warning"),
        ({}, {"rain_mm_per_h": np.ones((T, L, P))}, "3 of 3 links of series have no dry sample", "error"),
        ({}, {"rain_mm_per_h": np.zeros((T, L, P))}, "series has no rain", "error"),
        ({}, {"rain_mm_per_h": np.eye(T, L)[..., None]}, "The rain of series is a mean of each path", "note"),
        (
            {},
            {"attenuation_db": np.where(np.arange(T)[:, None] % 4 == 0, np.ones((T, L)), np.nan)},
            "75 % of the attenuations of series are missing",
            "warning",
        ),
    ],
)
def test_what_links_lack(links: dict[str, Any], frame: dict[str, Any], what: str, level: str) -> None:
    values = arguments("link")
    values["links"] |= links
    values["conditions"][0]["frames"][0] |= frame
    assert only(values, what).level == level


def test_a_level_of_another_name_is_refused() -> None:
    with pytest.raises(ValueError, match="level must be one of error, warning, note"):
        Finding("fatal", "", "", "")
