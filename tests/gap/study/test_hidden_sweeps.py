"""Effects hidden in recorded sweeps: which frames stand for what, their noise, and a real sweep searched."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from torchweather.atmosphere.weather import Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap import find_gap
from torchweather.gap.study.hidden import HiddenStudy
from torchweather.gap.study.hidden_sweeps import SweepNoise, hidden_in_sweeps, sweep_noise
from torchweather.gap.study.scan_grid import scan_frame
from torchweather.io import read_points
from torchweather.lidar.effects.all import EFFECTS
from torchweather.sensors import Lidar

LIDAR = Lidar(
    905.0,
    elevations_deg=tuple(np.linspace(-10.0, 4.0, 16)),
    columns=64,
    intensity_unit="reflectivity",
    near_start_m=0.5,
    near_full_m=2.0,
)
GRID = (16, 64)
RAIN = (Rain(10.0), Rain(40.0), Rain(25.0))
WINDOW = EFFECTS["lidar.window_loss"]


def sweeps(number: int, seed: int = 0, step: float = 0.0) -> list[dict[str, Any]]:
    """Frames of a standing sensor: 0.03 m and 2 % of noise, some beams without return."""
    rng = np.random.default_rng(seed)
    range_m, level = rng.uniform(4.0, 30.0, GRID), rng.uniform(0.1, 0.8, GRID)
    there = rng.random(GRID) > 0.1
    found = []
    for _ in range(number):
        intensity = level * np.exp(0.02 * rng.standard_normal(GRID))
        intensity = np.floor(intensity / step) * step if step else intensity
        found.append(
            {
                "range_m": np.where(there, range_m + 0.03 * rng.standard_normal(GRID), 0.0).astype(np.float32),
                "intensity": np.where(there, intensity, 0.0).astype(np.float32),
            }
        )
    return found


def hidden(frames: list[dict[str, Any]], *effects: Any, **more: Any) -> HiddenStudy:
    return hidden_in_sweeps({"street": frames}, LIDAR, effects, RAIN, **{"frames": 3, **more})


def test_frames_that_stand_for_clear_air_are_put_into_no_weather() -> None:
    """Every second one of six; what the rain leaves lies where the other three have it."""
    recorded = sweeps(6)
    study = hidden(recorded).study
    clear = study.scenes["street"].clear
    assert [np.array_equal(clear[k]["range_m"], recorded[2 * k]["range_m"]) for k in range(3)] == [True] * 3
    for one in study.conditions:
        for number in range(3):
            start, found = recorded[2 * number + 1]["range_m"], one.frames[number]["range_m"]
            same = np.abs(found - start) < 1e-3
            assert same.mean() > 0.6
            assert not (np.abs(found - recorded[2 * number]["range_m"]) < 1e-3)[start > 0].mean() > 0.1


def test_noise_is_drawn_about_a_single_sweep_as_it_is_given() -> None:
    (one,) = sweeps(1)
    study = hidden([one], noise=SweepNoise(0.05, 0.04)).study
    clear = [study.scenes["street"].clear[k] for k in range(8)]
    found = sweep_noise(clear)
    # Neighbouring differences of 920 beams in 8 frames.
    assert found.range_m == pytest.approx(0.05, rel=0.04)
    assert found.intensity == pytest.approx(0.04, rel=0.04)
    seen = np.mean([frame["range_m"] for frame in clear], 0)[one["range_m"] > 0]
    assert np.abs(seen - one["range_m"][one["range_m"] > 0]).mean() < 0.03


def test_the_noise_of_consecutive_frames_is_measured_also_in_steps() -> None:
    for step in (0.0, 0.01):
        found = sweep_noise(sweeps(8, step=step))
        assert found.range_m == pytest.approx(0.03, rel=0.05)
        assert found.intensity == pytest.approx(0.02, rel=0.07)


@pytest.mark.parametrize("number", [1, 6])
def test_readings_in_steps_stay_on_them(number: int) -> None:
    study = hidden(sweeps(number, step=0.01), WINDOW(loss_db=1.0), noise=SweepNoise(0.03, 0.02)).study
    for frames in (study.scenes["street"].clear, *(one.frames for one in study.conditions)):
        steps = 100.0 * np.stack([frames[k]["intensity"] for k in range(len(frames))])
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)


def test_effects_act_in_weather_alone_and_leave_all_draws_as_they_were() -> None:
    recorded = sweeps(6)
    bare, lossy = hidden(recorded), hidden(recorded, WINDOW(loss_db=3.0))
    assert bare.weather_factor == lossy.weather_factor
    assert lossy.truth()["effects"] == [{"name": "lidar.window_loss", "parameters": {"loss_db": 3.0}}]
    assert (
        bare.study.scenes["street"].clear[0]["intensity"].tobytes()
        == lossy.study.scenes["street"].clear[0]["intensity"].tobytes()
    )
    first, second = (one.study.conditions[0].frames[0] for one in (bare, lossy))
    both = (first["range_m"] > 0) & (first["range_m"] == second["range_m"])
    # Of light that is returned from objects; a share of 10^-0.3 reaches the threshold still.
    assert np.median(second["intensity"][both] / first["intensity"][both]) == pytest.approx(10**-0.3, rel=1e-3)
    again = hidden(recorded, WINDOW(loss_db=3.0))
    assert again.study.sha256 == lossy.study.sha256
    assert hidden(recorded, WINDOW(loss_db=3.0), seed=1).study.sha256 != lossy.study.sha256


def test_what_is_missing_is_said() -> None:
    with pytest.raises(TorchweatherError, match="street has 3 frames; expected 4 or more of a sensor that stood still"):
        hidden(sweeps(3))
    with pytest.raises(TorchweatherError, match="weathers"):
        hidden_in_sweeps({"street": sweeps(6)}, LIDAR, (), RAIN[:2])
    moving = [{"range_m": np.full(GRID, 5.0 + 2.0 * k), "intensity": np.full(GRID, 0.3)} for k in range(3)]
    with pytest.raises(TorchweatherError, match="consecutive frames of a sensor that stands still"):
        sweep_noise(moving)


@pytest.mark.parametrize(("loss_db", "named"), [(0.0, []), (1.5, ["lidar.window_loss"])])
def test_a_wet_window_is_found_in_a_sweep_of_kitti(
    loss_db: float, named: list[str], real_data: Callable[[str], Path]
) -> None:
    """Readings in hundredths, surfaces of a street, some of its columns; three effects may be named."""
    sensor = Lidar.preset("velodyne-hdl-64e", columns=128, intensity_unit="reflectivity")
    frame, _ = scan_frame(read_points(real_data("kitti_13/velodyne/000008.bin")), sensor, "000008")
    effects = [WINDOW(loss_db=loss_db)] if loss_db else []
    rain = (Rain(20.0), Rain(60.0), Rain(40.0), Rain(100.0))
    made = hidden_in_sweeps({"street": [frame]}, sensor, effects, rain, noise=SweepNoise(0.02, 0.03))
    report = find_gap(made.study, effects=["lidar.window_loss", "lidar.threshold_shift", "lidar.extinction_scale"])
    assert [one["name"] for one in report.answer["effects"]] == named
    if named:
        assert report.answer["effects"][0]["parameters"]["loss_db"] == pytest.approx(1.5, abs=0.1)
