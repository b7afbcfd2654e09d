"""docs/d34-scores.md says what the benchmark's file says; the benchmark pairs and computes what it claims."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import torch

from torchweather.physics import rain_fall_speed_m_per_s
from torchweather.scenes import SceneLabel, lidar_view, thi_hall
from torchweather.sensors import Lidar

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def scores() -> ModuleType:
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import d34_scores  # type: ignore[import-not-found]
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))
    found: ModuleType = d34_scores
    return found


def test_the_page_is_made_of_the_committed_figures() -> None:
    done = subprocess.run([sys.executable, str(ROOT / "benchmarks/d34_table.py"), "--check"], check=False)
    assert done.returncode == 0, "run python benchmarks/d34_table.py"


def test_every_printed_condition_has_a_row_and_a_model_beside_it(scores: ModuleType) -> None:
    for sensor, wanted in (("camera", 14), ("lidar", 6)):
        measured, modelled = scores.printed(scores.MEASURED[sensor]), scores.printed(scores.MODELLED[sensor])
        assert set(measured) == set(modelled)
        assert {one.weather for one in measured} == {"rain", "fog"}
        assert len(measured) == 20
        assert all(len(row) == wanted for row in (*measured.values(), *modelled.values()))


def test_drops_fall_as_newton_says(scores: ModuleType) -> None:
    """Steps of 0.1 ms of ``dv/dt = g (1 - v^2 / v_t^2)`` over the height; the density goes as the inverse speed."""
    height, rate = 3.27, 20.0
    thick = scores.falling_drops(rate, height).distribution()
    terminal_flux = scores.falling_drops(rate, 1e4).distribution()
    for diameter in (0.5, 1.0, 2.0, 4.0):
        terminal = float(rain_fall_speed_m_per_s(diameter))
        speed = fallen = 0.0
        while fallen < height:
            speed += 1e-4 * 9.81 * (1.0 - (speed / terminal) ** 2)
            fallen += 1e-4 * speed
        sizes = torch.tensor(diameter, dtype=torch.float64)
        ratio = float(thick.number_density_per_m3_mm(sizes) / terminal_flux.number_density_per_m3_mm(sizes))
        # Bins are 7.6 % wide: the speed varies by half of that inside one, and less where it is not terminal.
        assert ratio == pytest.approx(terminal / speed, rel=0.03)


def test_a_wet_floor_returns_its_share(scores: ModuleType) -> None:
    down = torch.nn.functional.normalize(torch.tensor([[1.0, 0.5, -0.5]]), dim=-1)
    lidar = Lidar(865.0, intensity_unit="reflectivity", range_at_10_percent_m=100.0)
    dry, wet = (lidar_view(scene, lidar, directions=down) for scene in (thi_hall(), scores.wet_floor(thi_hall(), 0.9)))
    assert int(dry.label) == SceneLabel.FLOOR
    assert float(wet.points[0, 3] / dry.points[0, 3]) == pytest.approx(0.1, rel=1e-5)


def test_noise_has_the_size_of_its_light(scores: ModuleType) -> None:
    grey = torch.full((1, 200, 200), 0.25)
    for light in (1.0, 1.0 / 16.0):
        spread = float((scores.noisy(grey, 1, light) - grey).std())
        expected = math.sqrt(0.25 / (10_000 * light) + (4 / (10_000 * light)) ** 2)
        # 40,000 pixels: the standard deviation is known to 1 / sqrt(2 n) = 0.35 %; four of it.
        assert spread == pytest.approx(expected, rel=0.015)
