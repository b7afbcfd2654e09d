"""Validation: the statistics against scipy, no difference where there is none, a difference where one is hidden."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tests.gap import studies
from tests.recordings import recording
from tests.running_examples import load_example
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.camera.sensor import Camera
from torchweather.evaluation.validation.comparison import Comparison, Sample, judged
from torchweather.evaluation.validation.frame_scores import KNOWN, ScoreMeaning, frame_scores, lidar_points
from torchweather.evaluation.validation.quantities import quantity
from torchweather.evaluation.validation.run import Validation, reference_frame, validate
from torchweather.evaluation.validation.severity import compared_trends, weather_label
from torchweather.gap.sensors.link.study_kind import rain_attenuation_db
from torchweather.gap.study import embedded
from torchweather.gap.study.embedded import embedded_study
from torchweather.gap.study.simulation import start_frame
from torchweather.gap.study.study import Frame, Study
from torchweather.lidar.sensor import Lidar
from torchweather.scenes import lidar_view
from torchweather.scenes import test_track as track

LOWER, HIGHER = ScoreMeaning(False, "m"), ScoreMeaning(True)
POWERS = ("power_change_db", "power_rmse_db", "detected_share")


def comparison(
    measured: Any, simulated: Any, floor: Any = (0.0,), meaning: ScoreMeaning = LOWER, **more: Any
) -> Comparison:
    samples = (Sample(tuple(float(score) for score in each)) for each in (measured, simulated, floor))
    return Comparison("mde", meaning, *samples, **more)


# ---- statistics ------------------------------------------------------------------------------------------------------


def test_the_gap_in_errors_is_welchs_t() -> None:
    rng = np.random.default_rng(0)
    measured, simulated = rng.normal(3.0, 1.0, 5), rng.normal(4.0, 2.5, 7)
    found = comparison(measured, simulated)
    wanted = stats.ttest_ind(simulated, measured, equal_var=False)
    assert found.in_errors == pytest.approx(wanted.statistic, rel=1e-12)
    # The bound is where Welch's p equals the level.
    edge = replace(found, level=float(wanted.pvalue))
    assert edge.bound == pytest.approx(abs(wanted.statistic), rel=1e-9)


def test_pairs_are_compared_by_their_differences() -> None:
    rng = np.random.default_rng(1)
    length = rng.uniform(1.0, 30.0, 12)
    measured = length + rng.normal(0.0, 0.1, 12)
    simulated = length + 0.2 + rng.normal(0.0, 0.1, 12)
    found = comparison(measured, simulated, paired=True)
    wanted = stats.ttest_rel(simulated, measured)
    assert found.in_errors == pytest.approx(wanted.statistic, rel=1e-12)
    assert replace(found, level=float(wanted.pvalue)).bound == pytest.approx(abs(wanted.statistic), rel=1e-9)
    assert abs(comparison(measured, simulated).in_errors) < 0.2  # unpaired, the lengths hide it


def test_the_scatter_of_the_clear_frames_is_part_of_the_error() -> None:
    measured, simulated, floor = (1.0, 1.2, 0.8), (1.3, 1.5, 1.1), (0.1, 0.5, 0.3)
    each = 0.2 / math.sqrt(3)  # of three scores 0.2 apart
    assert comparison(measured, simulated, floor).error == pytest.approx(each * math.sqrt(3), rel=1e-12)
    assert comparison(measured, simulated, (0.3,)).error == pytest.approx(each * math.sqrt(2), rel=1e-12)


def test_the_level_is_shared_by_what_can_be_judged() -> None:
    whole = comparison((1, 2, 3), (1, 2, 3))
    single = comparison((1,), (2,))
    found = judged([whole, single, whole])
    assert [each.level for each in found] == [0.025] * 3
    assert [each.verdict for each in found] == ["agrees", "unjudged", "agrees"]


def test_side_of_the_floor() -> None:
    floor = (0.10, 0.11, 0.09, 0.10)
    far, near = (0.5, 0.51, 0.49), (0.10, 0.11, 0.095)
    found = comparison(far, near, floor)
    assert (found.side_of_floor("measured"), found.side_of_floor("simulated")) == ("worse", "at")
    assert replace(found, meaning=HIGHER).side_of_floor("measured") == "better"
    assert comparison((0.5,), near, floor).side_of_floor("measured") == "unjudged"
    assert found.share_of_effect == pytest.approx((np.mean(near) - 0.5) / 0.4, rel=1e-9)


@pytest.mark.parametrize(
    ("measured", "simulated", "verdict"),
    [
        ((math.inf, math.inf), (math.inf, math.inf), "unjudged"),
        ((math.inf, math.inf), (3.0, 4.0), "differs"),
        ((math.inf, 3.0), (3.0, 4.0), "unjudged"),
        ((math.nan, math.nan), (3.0, 4.0), "unjudged"),
        ((3.0, math.nan, 4.0), (3.0, 4.0, 3.5), "agrees"),
        ((2.0, 2.0), (2.0, 2.0), "agrees"),
        ((2.0, 2.0), (2.5, 2.5), "differs"),
    ],
)
def test_scores_that_are_infinite_missing_or_without_scatter(measured: Any, simulated: Any, verdict: str) -> None:
    assert comparison(measured, simulated).verdict == verdict


def test_one_quantity_by_hand() -> None:
    one, other = np.array([1.0, 2.0, 3.0]), np.array([2.0, 3.0, 7.0])
    found = quantity("power", "dB", one, other, np.zeros(0), one)
    # Medians 2 and 3; then (1, 2, 6) against (1, 2, 3): a third of the values is 3 off.
    assert (found.bias, found.scatter) == (1.0, pytest.approx(1.0))
    assert math.isnan(found.floor_bias)


# ---- pairing ---------------------------------------------------------------------------------------------------------


def test_no_frame_is_scored_against_its_own_start() -> None:
    for count in (2, 3, 8):
        for number in range(20):
            for start in range(count):
                place = reference_frame(number, start, count)
                assert 0 <= place < count
                assert place != start


def test_measured_and_simulated_frames_share_their_clear_frame() -> None:
    study = embedded_study("radar", clear_frames=3, frames=4)
    found = validate(study, seed=5, names=["power_change_db"])
    score = frame_scores(study, ["power_change_db"]).score
    condition, scene = study.conditions[3], study.scenes["test-track"]
    wanted = []
    for number, frame in enumerate(condition.frames):
        start = start_frame(study, condition, seed=5, number=number)
        wanted.append(score(frame, scene.clear[reference_frame(number, start, 3)], scene.geometry)["power_change_db"])
    assert found.conditions[3].scores[0].measured.scores == tuple(wanted)


# ---- studies in which nothing, or something, is wrong ----------------------------------------------------------------


def test_two_runs_of_one_model_agree() -> None:
    differ = 0
    for seed in range(3):
        study = embedded_study("radar", seed=seed)
        differ += validate(study, seed=100 + seed, names=POWERS, power=False).counts()["differ"] > 0
    # Each study is called different with a chance of 5 % at most: more than 1 of 3 with 0.7 %.
    assert differ <= 1


@pytest.mark.parametrize(("kind", "names"), [("lidar", ["mde", "hd95"]), ("camera", ["psnr", "gmsd"])])
def test_two_runs_of_one_model_agree_beyond_the_floor(
    kind: str, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(embedded, "CAMERA_PX", (96, 72))
    monkeypatch.setattr(embedded, "WEATHERS", (Fog(mor_m=200.0), Fog(mor_m=50.0), Snow(2.0)))
    found = validate(embedded_study(kind, clear_frames=3, frames=3), seed=4, names=names)
    # 6 comparisons of this seed; a false alarm among them has a chance of 5 %, and this seed has none.
    assert found.counts() == {"agree": 6, "differ": 0, "not_decided": 0, "unjudged": 0, "agree_at_floor": 0}
    assert {score.side_of_floor("measured") for each in found.conditions for score in each.scores} == {"worse"}
    (trend,) = found.trends
    assert trend.values == (200.0, 50.0)
    assert {name: trend.agreement(name) for name in names} == dict.fromkeys(names, True)


def test_frames_of_the_embedded_study_are_views_with_noise_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene is ray-cast once a study; the slow reference casts it for each frame."""
    monkeypatch.setattr(embedded, "CAMERA_PX", (32, 24))
    monkeypatch.setattr(embedded, "RINGS", 4)
    monkeypatch.setattr(embedded, "COLUMNS", 16)
    monkeypatch.setattr(embedded, "WEATHERS", (Fog(mor_m=200.0),))
    seed = embedded._seed(0, "clear.1")
    camera = embedded_study("camera", clear_frames=2, frames=1)
    wanted = track().view(camera.sensor_as(Camera), shot_noise_seed=seed).bayer[0]
    assert np.array_equal(camera.scenes["test-track"].clear[1]["bayer"], wanted.numpy())
    lidar = embedded_study("lidar", clear_frames=2, frames=1)
    points = lidar_view(track(), lidar.sensor_as(Lidar), range_noise_seed=seed).points
    range_m = points[:, :3].norm(dim=-1).numpy()
    # Single precision: lengths of vectors, on 100 m; the noise is some thousand times that.
    assert np.allclose(lidar.scenes["test-track"].clear[1]["range_m"].ravel(), range_m, atol=1e-4)


def changed(study: Study, change: Callable[[Frame], Frame]) -> Study:
    """The study with other measured frames."""
    return Study.from_arrays(
        sensor=study.sensor,
        scenes=[{"id": s.id, "clear": list(s.clear), "geometry": s.geometry} for s in study.scenes.values()],
        conditions=[
            {"id": c.id, "scene": c.scene, "weather": c.weather or "clear", "frames": [change(f) for f in c.frames]}
            for c in study.conditions
        ],
    )


def test_a_hidden_loss_is_found_where_it_is() -> None:
    study = embedded_study("radar", seed=2)
    wet = changed(study, lambda frame: {**frame, "power_db": frame["power_db"] - 1.5})
    found = validate(wet, seed=3, names=POWERS)
    assert set(found.differing()) == {"power_change_db"}
    assert len(found.differing()["power_change_db"]) == 12
    for condition in found.conditions:
        score = condition.scores[0]
        # Means of five medians over some 100 targets: within 0.5 dB of the hidden 1.5 dB.
        assert score.gap == pytest.approx(1.5, abs=0.5)
        assert score.side_of_floor("measured") == "worse"
    assert "power_change_db (all 12 conditions)" in found.verdict()
    assert "radome" not in found.verdict()  # it names no cause


def test_clear_conditions_are_at_the_floor() -> None:
    study = embedded_study("radar", clear_frames=16, frames=1)
    clear = list(study.scenes["test-track"].clear)
    geometry = study.scenes["test-track"].geometry
    dry = Study.from_arrays(
        sensor=study.sensor,
        scenes=[{"id": "s0", "clear": clear[:8], "geometry": geometry}],
        conditions=[{"id": "dry", "scene": "s0", "weather": "clear", "frames": clear[8:]}],
    )
    found = validate(dry, seed=1)
    assert found.counts() == {"agree": 9, "differ": 0, "not_decided": 0, "unjudged": 0, "agree_at_floor": 9}
    assert found.conditions[0].label == "clear"
    assert found.trends == ()


# ---- links -----------------------------------------------------------------------------------------------------------


def link_study(factor: float) -> Study:
    """Ten links in showers: a multiple of P.838's loss, with 0.1 dB of noise and 5 % of each link's own."""
    rng = np.random.default_rng(7)
    links = {
        "length_km": rng.uniform(1.0, 6.0, 10),
        "frequency_ghz": rng.uniform(18.0, 38.0, 10),
        "polarisation": np.arange(10) % 2,
        "split": np.arange(10) % 2,
    }
    rain = np.zeros((400, 10, 2))
    rain[60:90] = rng.uniform(0.2, 8.0, (30, 10, 2))
    rain[300:320] = rng.uniform(5.0, 40.0, (20, 10, 2))
    loss = factor * rain_attenuation_db(links, rain) * rng.normal(1.0, 0.05, 10)
    frame = {
        "time_s": 300.0 * np.arange(400),
        "attenuation_db": loss + rng.normal(0.0, 0.1, loss.shape),
        "rain_mm_per_h": rain,
    }
    return Study.from_arrays(kind="link", links=links, conditions=[{"id": "june", "frames": [frame]}])


def test_links_agree_by_classes_of_rain() -> None:
    found = validate(link_study(1.0), seed=1)
    assert found.counts()["differ"] == 0
    (june,) = found.conditions
    assert [score.name for score in june.scores][-1] == "attenuation_db_from_25_mm_per_h"
    assert all(score.paired and len(score.measured.scores) == 10 for score in june.scores)
    assert all(each.rmse < 1.0 for each in june.quantities)
    (trend,) = found.trends
    assert trend.agreement("attenuation_db") is True
    assert trend.measured.metrics["attenuation_db"].verdict == "expected"


def test_links_with_twice_the_loss_differ() -> None:
    # One way taken for two, or amplitude for power: a factor of 2 in dB.
    found = validate(link_study(2.0), seed=1)
    assert "attenuation_db_from_10_mm_per_h" in found.differing()
    assert "attenuation at 10 to 25 mm/h" in found.verdict()
    heavy = found.conditions[0].scores[-1]
    assert heavy.simulated.mean == pytest.approx(heavy.measured.mean / 2, rel=0.1)
    with pytest.raises(ValueError, match="names is for frames"):
        validate(link_study(1.0), names=["psnr"])


@pytest.mark.long  # beside the example of tests/test_links_example.py
@pytest.mark.real_data
def test_recorded_links_lose_what_rain_takes() -> None:
    folder = recording("cml_germany")
    measured = load_example("parts/link_recordings.py").read_germany(folder)
    losses = load_example("parts/link_losses.py")
    attenuation_db = losses.measured_db(measured)[0]
    chosen = losses.quiet_links(measured, attenuation_db, 0.0)
    frame = {
        "time_s": 300.0 * np.arange(len(attenuation_db)),  # 5-min steps
        "attenuation_db": attenuation_db[:, chosen],
        "rain_mm_per_h": measured.rain_mm_per_h[:, chosen, None],
    }
    links = {
        "length_km": measured.length_km[chosen],
        "frequency_ghz": measured.frequency_ghz[chosen],
        "polarisation": np.ones(int(np.sum(chosen))),
        "split": np.arange(int(np.sum(chosen))) % 2,
    }
    found = validate(Study.from_arrays(kind="link", links=links, conditions=[{"id": "links", "frames": [frame]}]))
    middle = {score.name: score for score in found.conditions[0].scores}
    for low in ("2.5", "10"):
        score = middle[f"attenuation_db_from_{low}_mm_per_h"]
        # Moderate rain, where the radar's path mean is good: within a fifth. Twice the loss would be 100 % off.
        assert score.simulated.mean == pytest.approx(score.measured.mean, rel=0.2)


# ---- trends, scores, results -----------------------------------------------------------------------------------------


def test_trends_go_from_light_to_heavy() -> None:
    scores = [[comparison((v, v + 0.1), (v, v + 0.1))] for v in (1.0, 2.0, 3.0)]
    for weathers in ([Rain(5.0), Rain(10.0), Rain(50.0)], [Fog(mor_m=400.0), Fog(mor_m=100.0), Fog(mor_m=30.0)]):
        shuffled = [("s0", weathers[k], scores[k]) for k in (1, 2, 0)]
        (trend,) = compared_trends(shuffled, seed=0)
        assert trend.values == tuple(float(weather.intensity) for weather in weathers)
        assert trend.measured.metrics["mde"].verdict == "expected"
    assert compared_trends([("s0", Rain(5.0), scores[0]), ("s1", Rain(9.0), scores[1])], seed=0) == []


def test_a_trend_that_only_one_of_them_has_is_no_agreement() -> None:
    rising = [(v, v + 0.1, v - 0.1) for v in (1.0, 2.0, 3.0)]
    flat = [(v, v + 0.1, v - 0.1) for v in (3.0, 2.0, 1.0)]
    levels = [("s0", Rain(r), [comparison(m, s)]) for r, m, s in zip((1.0, 5.0, 25.0), rising, flat, strict=True)]
    (trend,) = compared_trends(levels, seed=0)
    assert trend.agreement("mde") is False
    noisy = [("s0", Rain(r), [comparison(m, (0.0, 9.0, 1.0))]) for r, m in zip((1.0, 5.0), rising[:2], strict=True)]
    assert compared_trends(noisy, seed=0)[0].agreement("mde") is None


def test_labels_of_weathers() -> None:
    assert [weather_label(each) for each in (None, Rain(2.5), Fog(mor_m=50.0))] == [
        "clear",
        "rain 2.5 mm/h",
        "fog 50 m",
    ]


def test_scores_that_a_frame_is_too_small_for_are_left_out() -> None:
    small = studies.study("camera")  # 4 x 6 pixels
    found = frame_scores(small)
    assert list(found.meanings) == ["psnr", "vsi", "mdsi"]
    assert "161 pixels a side; these frames have 4" in found.left_out["ms_ssim"]
    with pytest.raises(ValueError, match=r"score must be one of psnr.*got 'pnsr'. Did you mean 'psnr'"):
        frame_scores(small, ["pnsr"])


def test_scores_of_a_radar_by_hand() -> None:
    study = embedded_study("radar", clear_frames=2, frames=1)
    geometry = study.scenes["test-track"].geometry
    clear = study.scenes["test-track"].clear[0]
    power = np.array(clear["power_db"])
    power[np.flatnonzero(np.isfinite(power))[:10]] = np.nan
    weaker = {**clear, "power_db": power - 2.0}
    found = frame_scores(study).score(weaker, clear, geometry)
    assert list(found) == list(KNOWN["radar"])
    assert found["power_change_db"] == pytest.approx(-2.0)
    assert found["power_rmse_db"] == pytest.approx(2.0)
    before = int(np.isfinite(clear["power_db"]).sum())
    assert found["detected_share"] == pytest.approx((before - 10) / before)


def test_points_of_a_scan_are_its_returns() -> None:
    frame = {"range_m": np.array([[2.0, 0.0]])}
    assert lidar_points(frame, np.array([[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])).tolist() == [[0.0, 2.0, 0.0]]


@pytest.fixture(scope="module")
def found() -> Validation:
    return validate(embedded_study("radar", clear_frames=2, frames=1), names=["detected_share"])


def test_one_frame_of_each_cannot_be_judged(found: Validation) -> None:
    assert found.counts()["unjudged"] == 12
    assert "Nothing could be judged" in found.verdict()
    assert any("frame" in finding.what for finding in found.findings)


def test_results_are_plain_json(found: Validation) -> None:
    text = json.dumps(found.to_dict(), allow_nan=False)
    back = json.loads(text)
    assert back["study_sha256"] == found.sha256
    assert back["conditions"][0]["scores"][0]["gap_standard_error"] == "nan"
    assert back["conditions"][0]["weather"]["rate_mm_per_h"] == 5.0


def test_a_single_clear_frame_is_refused() -> None:
    study = embedded_study("radar", clear_frames=2, frames=1)
    scene = study.scenes["test-track"]
    alone = replace(study, scenes={"test-track": replace(scene, clear=scene.clear[:1])})
    with pytest.raises(ValueError, match="test-track must have 2 clear frames or more"):
        validate(alone)
