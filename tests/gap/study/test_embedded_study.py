"""The study that the library makes of an embedded scene."""

from __future__ import annotations

import numpy as np
import pytest

from torchweather.gap.study.embedded import EMBEDDED_KINDS, WEATHERS, embedded_study
from torchweather.gap.study.study import Study
from torchweather.scenes import SceneLabel


@pytest.fixture(scope="module")
def radar() -> Study:
    return embedded_study("radar", clear_frames=4, frames=2, seed=1)


def test_it_has_four_strengths_of_each_weather(radar: Study) -> None:
    assert [condition.weather for condition in radar.conditions] == list(WEATHERS)
    assert {condition.split for condition in radar.conditions} == {"fit", "holdout"}
    for kind in ("rain", "fog", "snow"):
        assert sum(weather.kind == kind for weather in WEATHERS) == 4


def test_clear_frames_differ_by_noise_and_only_moving_targets_fluctuate() -> None:
    scene = embedded_study("radar", clear_frames=40, frames=1).scenes["test-track"]
    powers = np.stack([frame["power_db"] for frame in scene.clear])
    assert len({frame.tobytes() for frame in powers}) == 40
    seen = np.isfinite(powers).all(0)  # in every frame, so that the threshold cuts nothing off
    trees, cars = ((scene.geometry["target_class"] == label) & seen for label in (SceneLabel.TREE, SceneLabel.CAR))
    # Power of an exponential law in dB: a standard deviation of 10 / ln 10 * pi / sqrt(6) = 5.57 dB. Selected targets,
    # never weak, are left with somewhat less; cars have receiver noise alone, some hundredths of a dB at 30 dB SNR.
    assert 3.0 < float(powers[:, trees].std(0).mean()) < 6.5
    assert float(powers[:, cars].std(0).max()) < 0.5


def test_the_same_seed_gives_the_same_study(radar: Study) -> None:
    assert embedded_study("radar", clear_frames=4, frames=2, seed=1).sha256 == radar.sha256
    assert embedded_study("radar", clear_frames=4, frames=2, seed=2).sha256 != radar.sha256


def test_it_survives_its_folder(radar: Study, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("study") / "radar"
    radar.write(folder)
    assert Study.read(folder).sha256 == radar.sha256


def test_in_the_tunnel_there_is_fog_alone() -> None:
    study = embedded_study("lidar", scene="fog-tunnel", clear_frames=2, frames=1)
    assert [condition.weather.kind for condition in study.conditions if condition.weather is not None] == ["fog"] * 4


@pytest.mark.parametrize("kind", EMBEDDED_KINDS)
def test_more_weather_changes_more(kind: str) -> None:
    study = embedded_study(kind, clear_frames=2, frames=1)
    clear = study.scenes["test-track"].clear[0]
    main = {"lidar": "range_m", "camera": "bayer", "radar": "power_db"}[kind]
    # The radar sees rain best, the others fog.
    weather = "rain" if kind == "radar" else "fog"
    changes = [
        float(np.nanmedian(np.abs(condition.frames[0][main] - clear[main])))
        for condition in study.conditions
        if condition.weather is not None and condition.weather.kind == weather
    ]
    assert changes[-1] > changes[0]


def test_what_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match=r"kind must be one of lidar, camera, radar; got 'lidr'. Did you mean 'lidar'"):
        embedded_study("lidr")
    with pytest.raises(ValueError, match="scene must be one of test-track, fog-tunnel, thi-hall, cerema-tunnel"):
        embedded_study("radar", scene="moon")
    with pytest.raises(ValueError, match="clear_frames must be 2 or more"):
        embedded_study("radar", clear_frames=1)
