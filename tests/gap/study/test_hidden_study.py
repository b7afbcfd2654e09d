"""Studies with effects hidden in them, and ``examples/gap_d34_suspicions.py``, which searches six."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.report.made_up_gaps import report
from tests.running_examples import load_example
from torchweather.atmosphere.weather import Rain, Weather
from torchweather.gap import find_gap
from torchweather.gap.study import hidden as module
from torchweather.gap.study.hidden import HIDEABLE, WEATHERS, HiddenStudy, drawn_effect, drawn_study, hidden_study
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.pipeline.effect import Effect
from torchweather.scenes import SCENES, LidarView, Scene, lidar_view
from torchweather.sensors import Lidar

EXAMPLE = Path(__file__).parents[3] / "examples" / "gap_d34_suspicions.py"
LIDAR = [name for name in EFFECTS if name.startswith("lidar.")]


@pytest.fixture(scope="module", autouse=True)
def seen_once() -> Iterator[None]:
    """Rendering takes most of the time of a small study, and the views are the same."""
    track = SCENES["test-track"]()

    @lru_cache
    def view(columns: int) -> LidarView:
        return lidar_view(track, module._sensor(columns))

    def kept(scene: Scene, lidar: Lidar) -> LidarView:
        assert lidar.columns is not None
        return view(lidar.columns)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "lidar_view", kept)
        yield


def small(effects: Sequence[Effect] = (), weathers: Sequence[Weather] = WEATHERS["snow"], **more: Any) -> HiddenStudy:
    return hidden_study(effects, weathers, **{"columns": 16, "clear_frames": 2, "frames": 2, **more})


def frames(study: Study) -> list[bytes]:
    """All frames in weather, bit by bit."""
    return [
        one.frames[number][key].tobytes() for one in study.conditions for number in range(2) for key in one.frames[0]
    ]


def test_it_holds_what_was_asked_for() -> None:
    hidden = small([EFFECTS["lidar.window_loss"](loss_db=2.0)], WEATHERS["fog"], clear_frames=3, rel_sd=0.2, columns=20)
    study = hidden.study
    scene = study.scenes["test-track"]
    assert study.beams["direction"].shape == (64, 20, 3)
    assert len(scene.clear) == 3
    assert [one.weather for one in study.conditions] == list(WEATHERS["fog"])
    assert [one.split for one in study.conditions] == ["fit", "fit", "holdout", "fit"]
    assert all(len(one.frames) == 2 and one.rel_sd == 0.2 for one in study.conditions)
    seen = scene.clear[0]["range_m"] > 0
    assert np.all(scene.geometry["cos_incidence"][seen] > 0)
    assert hidden.truth()["effects"] == [{"name": "lidar.window_loss", "parameters": {"loss_db": 2.0}}]
    assert list(hidden.truth()["weather_factor"]) == [one.id for one in study.conditions]


def test_the_same_seed_gives_the_same_study() -> None:
    assert small(seed=1).study.sha256 == small(seed=1).study.sha256
    assert small(seed=1).study.sha256 != small(seed=2).study.sha256


@pytest.mark.parametrize("weather", list(WEATHERS))
def test_effects_at_their_identity_leave_every_bit(weather: str) -> None:
    everything = [EFFECTS[name]() for name in LIDAR]
    assert small(everything, WEATHERS[weather]).study.sha256 == small((), WEATHERS[weather]).study.sha256


@pytest.mark.parametrize("name", list(HIDEABLE))
def test_an_effect_changes_frames_in_weather_and_no_clear_one(name: str) -> None:
    chosen = HIDEABLE[name]
    weakest = {parameter: min(span, key=abs) for parameter, span in chosen.spans.items()}
    with_effect = small([EFFECTS[name](**weakest)], WEATHERS[chosen.weather]).study
    without = small((), WEATHERS[chosen.weather]).study
    assert frames(with_effect) != frames(without)
    pair = (study.scenes["test-track"].clear for study in (with_effect, without))
    for one, other in zip(*pair, strict=True):
        assert all(np.array_equal(one[key], other[key]) for key in one)


def test_every_frame_has_noise_of_its_own() -> None:
    study = small(clear_frames=8, columns=64).study
    clear = study.scenes["test-track"].clear
    range_m, intensity = (np.stack([frame[key] for frame in clear]) for key in ("range_m", "intensity"))
    seen = (range_m > 0).all(0)
    # 1,800 beams of 8 frames: the deviation is known to 0.6 %.
    assert range_m[:, seen].std(0, ddof=1).mean() == pytest.approx(0.01 * 0.965, rel=0.03)  # c4 of 8 draws is 0.965
    assert np.log(intensity[:, seen]).std(0, ddof=1).mean() == pytest.approx(0.03 * 0.965, rel=0.03)
    assert len(set(frames(study))) == len(frames(study))


def test_the_record_is_off_and_the_frames_have_the_true_weather() -> None:
    hidden = small(rel_sd=0.2, seed=3)
    factors = list(hidden.weather_factor.values())
    assert len(set(factors)) == 4
    true = [
        replace(one, rate_mm_per_h=one.rate_mm_per_h * by) for one, by in zip(WEATHERS["snow"], factors, strict=True)
    ]
    assert frames(small((), true, rel_sd=0.0, seed=3).study) == frames(hidden.study)


def test_the_record_is_off_by_a_draw_from_its_stated_uncertainty() -> None:
    many = [Rain(10.0 + 0.1 * number) for number in range(100)]
    n = np.log(list(small((), many, rel_sd=0.1, frames=1).weather_factor.values())) / 0.1
    # 100 standard normal numbers: their deviation is known to 7 %, their mean to 0.1; 3.5 sigma.
    assert np.std(n) == pytest.approx(1.0, abs=0.25)
    assert np.mean(n) == pytest.approx(0.0, abs=0.35)


def test_draws_lie_within_their_spans_and_any_effect_comes() -> None:
    drawn = [drawn_effect(seed) for seed in range(200)]
    for effect, weather in drawn:
        if effect is None:
            continue
        assert weather == HIDEABLE[effect.id].weather
        for parameter, (low, high) in HIDEABLE[effect.id].spans.items():
            room = 2e-3 * max(abs(low), abs(high))  # three digits
            assert low - room <= float(getattr(effect, parameter)) <= high + room
    # Each of 20 has a chance of 4e-5 to be missing from 200 draws.
    assert {effect.id if effect else None for effect, _ in drawn} == {None, *HIDEABLE}


def test_none_is_drawn_only_where_that_is_allowed() -> None:
    with_none, without = ([drawn_effect(seed, allow_none=allowed) for seed in range(100)] for allowed in (True, False))
    assert any(effect is None for effect, _ in with_none)
    assert all(effect is not None for effect, _ in without)
    assert all(repr(one) == repr(other) for one, other in zip(with_none, without, strict=True) if one[0] is not None)


def test_the_draw_is_that_of_its_seed() -> None:
    one, again, other = (drawn_study(seed, columns=16) for seed in (4, 4, 8))
    assert (one.truth(), one.study.sha256) == (again.truth(), again.study.sha256)
    assert one.truth() != other.truth()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"scene": "moon"}, "scene must be one of"),
        ({"weathers": WEATHERS["rain"][:2]}, "weathers must be 3 or more"),
        ({"columns": 4}, "columns must be 16 or more"),
        ({"clear_frames": 1}, "clear_frames must be 2 or more"),
        ({"frames": 0}, "frames must be 1 or more"),
        ({"rel_sd": -0.1}, "rel_sd must be 0 or more"),
    ],
)
def test_what_cannot_be_a_study_is_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        hidden_study(**arguments)


# ---- the example of D3.4's suspicions --------------------------------------------------------------------------------


@pytest.fixture
def suspicions(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The example, its search replaced by one that always says window loss; the studies that it was given."""
    example = load_example(EXAMPLE.name)
    monkeypatch.setattr(example, "searched_studies", [], raising=False)

    def made_up(study: Study, **arguments: Any) -> Any:
        assert not arguments  # no effect is suggested to it
        example.searched_studies.append(study)
        return report("named", study)

    monkeypatch.setattr(example, "find_gap", made_up)
    return example


def test_each_suspicion_is_hidden_in_its_weather(suspicions: Any) -> None:
    found = suspicions.SUSPICIONS.values()
    assert {(one.section, *(effect.id for effect in one.effects), one.weather) for one in found} == {
        ("5.2.2", "lidar.isolated_return_filter", "snow"),
        ("5.3.2", "lidar.extinction_scale", "fog"),
        ("7.4.2", "lidar.limited_extent", "rain"),
        ("7.4.2.1", "lidar.static_structure", "rain"),
        ("7.4.1.1", "camera.exposure_gain", "rain"),
        ("6.1", "radar.noise_floor", "radar.cfar_shift", "rain"),
    }
    assert not any(bool(effect.at_identity) for one in found for effect in one.effects)


def test_the_example_writes_what_it_found_and_says_where_it_is_wrong(
    suspicions: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--columns", "16", "--only", "extinction", "extent", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", [EXAMPLE.name, *arguments])
    suspicions.main()
    assert [one.conditions[0].weather.kind for one in suspicions.searched_studies] == ["fog", "rain"]
    table = {re.sub(r"  +", "|", line) for line in capsys.readouterr().out.splitlines()}
    assert "5.3.2|lidar.extinction_scale.factor 0.700|-|2.13 -> 1.03|1.00" in table
    assert "|(not lidar.window_loss.loss_db)|0.0200 dB|0.0180 to 0.0220" in table
    rows = json.loads((tmp_path / "suspicions.json").read_text(encoding="utf-8"))
    names = [[one["name"] for one in row["hidden"]] for row in rows]
    assert names == [["lidar.extinction_scale"], ["lidar.limited_extent"]]
    for name in ("extinction", "extent"):
        assert (tmp_path / f"{name}.png").stat().st_size > 0
        assert {file.name for file in (tmp_path / name).iterdir()} == {"gap.json", "model.yaml", "report.html"}


def test_a_camera_exposes_longer_in_rain_than_in_clear_air(suspicions: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Near by, where rain hardly takes anything, light is 10 % more; the noise is that of the light on the sensor."""
    monkeypatch.setattr("parts.d34_studies.CAMERA_PX", (64, 48))
    monkeypatch.setattr("parts.d34_studies.RATES_MM_PER_H", {0.5: "fit", 1.0: "holdout"})
    hidden = suspicions.camera_study(suspicions.SUSPICIONS["exposure"].effects[0], 3)
    assert [(one.id, one.split) for one in hidden.study.conditions] == [("rain-0.5", "fit"), ("rain-1", "holdout")]
    assert all(0.6 < factor < 1.6 and factor != 1.0 for factor in hidden.weather_factor.values())
    assert hidden.truth()["effects"] == [{"name": "camera.exposure_gain", "parameters": {"factor": 1.1}}]
    (scene,) = hidden.study.scenes.values()
    clear = np.stack([frame["bayer"] for frame in scene.clear])
    rainy = np.stack([frame["bayer"] for frame in hidden.study.conditions[0].frames])
    lit = (clear.mean(0) > 0.05) & (clear.mean(0) < 0.8) & (scene.geometry["depth_m"] < 15.0)
    # Hundreds of pixels of 0.7 to 5 % noise each; rain of 0.5 mm/h takes a thousandth.
    assert np.median((rainy.mean(0) / clear.mean(0))[lit]) == pytest.approx(1.1, abs=0.005)
    noise = clear.var(0, ddof=1)[lit].mean() / (clear.mean(0)[lit].mean() / 10_000.0 + (5.0 / 10_000.0) ** 2)
    assert noise == pytest.approx(1.0, abs=0.1)  # 7 degrees of freedom of each pixel


def test_a_radar_whose_noise_grows_in_rain_detects_more(suspicions: Any) -> None:
    """Its threshold stays in power, so that noise is detected; the floor of empty cells says by how much it grew."""
    suspicion = suspicions.SUSPICIONS["noise"]
    hidden = suspicions.radar_study(suspicion.effects, suspicions.NOISE_UP_DB, 3)
    names = [one["name"] for one in hidden.truth()["effects"]]
    assert names == ["radar.noise_floor", "radar.cfar_shift"]
    assert [one.split for one in hidden.study.conditions] == ["fit", "fit", "holdout", "fit"]
    (scene,) = hidden.study.scenes.values()
    rainy = [frame for one in hidden.study.conditions for frame in one.frames]

    def listed(frame: Any) -> int:
        return int(np.isfinite(frame["power_db"]).sum()) + len(frame["clutter"])

    clear, wet = (np.mean([listed(frame) for frame in some]) for some in (scene.clear, rainy))
    assert wet > 1.3 * clear  # D3.4: 535 to 543 instead of 340
    # Cells above 12 dB less 4: 32,768 exp(-6.31), of a Poisson law.
    false = [len(frame["clutter"]) for frame in rainy]
    assert np.mean(false) == pytest.approx(32_768 * np.exp(-(10.0**0.8)), abs=4.0 * np.sqrt(60.0 / len(rainy)))
    up_db = np.mean([frame["noise_floor_db"] for frame in rainy]) - np.mean(
        [frame["noise_floor_db"] for frame in scene.clear]
    )
    assert up_db == pytest.approx(4.0, abs=0.06)
    lowest = min(float(np.nanmin(frame["power_db"])) for frame in [*scene.clear, *rainy])
    assert lowest >= -125.0 + 12.0


@pytest.mark.long  # beside the studies of tests/gap/sensors/radar/test_radar_frames.py
def test_the_noise_of_d3_4_is_found_and_named(suspicions: Any) -> None:
    suspicion = suspicions.SUSPICIONS["noise"]
    report_ = find_gap(suspicions.radar_study(suspicion.effects, suspicions.NOISE_UP_DB, 0).study)
    found = {one["name"]: one for one in report_.answer["effects"]}
    assert report_.verdict == "named"
    assert list(found) == ["radar.noise_floor", "radar.cfar_shift"]
    for effect in suspicion.effects:
        assert found[effect.id]["parameters"]["shift_db"] == pytest.approx(float(effect.shift_db), abs=0.2)
