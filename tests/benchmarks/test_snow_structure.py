"""The fits of the structure of recorded snow: known answers, the page's tables, and the recording itself."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import torchweather as tw
from tests.recordings import recording

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "lidar-snow-structure.md"


@pytest.fixture(scope="module")
def bench() -> Any:
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import snow_structure
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))
    return snow_structure


@pytest.fixture(scope="module")
def fit(bench: ModuleType) -> Any:
    return sys.modules["snow_fit"]


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((ROOT / "benchmarks" / "snow_structure.json").read_text(encoding="utf-8"))
    return found


def scan(fit: Any, number: int = 40_000) -> Any:
    """Free beams all around, without flakes."""
    draw = np.random.default_rng(1)
    nothing = np.zeros(number, bool)
    azimuth = draw.uniform(-math.pi, math.pi, number)
    ring = draw.integers(0, 40, number)
    return fit.Snow(azimuth, np.radians(-3.0 + 0.45 * ring), ring, nothing, np.zeros((number, 2)))


TRUTH: dict[str, Any] = {
    "number": 0.2,
    "azimuth": {
        "amplitude": 2.0,
        "azimuth_rad": 2.8,
        "width_rad": 0.6,
        "wind_amplitude": 0.3,
        "wind_azimuth_rad": 1.2,
    },
    "elevation": {"amplitude": 1.5, "elevation_rad": 0.02, "width_rad": 0.08, "steepness": 3.0},
}


@pytest.mark.long
def test_the_fit_finds_the_density_that_beams_were_drawn_from(fit: Any) -> None:
    snow, truth = scan(fit), fit.Density(**TRUTH)
    chance = -np.expm1(-truth.of(snow))
    drawn = np.random.default_rng(2).random(len(chance)) < chance
    snow = fit.Snow(snow.azimuth_rad, snow.elevation_rad, snow.ring, drawn, snow.ranges_m)
    found = fit.fitted_density(snow)
    # 13,000 flakes: 5 to 10 % of a parameter's size, four times for the steepness of a narrow layer.
    assert found.number == pytest.approx(0.2, rel=0.1)
    for name in ("amplitude", "width_rad", "wind_amplitude"):
        assert found.azimuth[name] == pytest.approx(TRUTH["azimuth"][name], rel=0.2)
    assert found.azimuth["azimuth_rad"] == pytest.approx(2.8, abs=0.05)
    assert found.azimuth["wind_azimuth_rad"] == pytest.approx(1.2, abs=0.15)
    assert found.elevation["amplitude"] == pytest.approx(1.5, rel=0.2)
    assert found.elevation["elevation_rad"] == pytest.approx(0.02, abs=0.005)
    assert found.elevation["width_rad"] == pytest.approx(0.08, rel=0.1)
    # Independent flakes: a variance of 1, of 1,500 blocks.
    assert fit.overdispersion(snow, truth.of(snow)) == pytest.approx(1.0, abs=0.3)


def test_the_effects_have_the_density_of_the_fit(fit: Any) -> None:
    """The same lobes in torch, by chords, and in numpy, by angles."""
    snow = scan(fit, 500)
    azimuth, elevation = snow.azimuth_rad, snow.elevation_rad
    along = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    torch = pytest.importorskip("torch")
    points = torch.from_numpy(np.concatenate([20.0 * along, np.full((500, 1), 0.5)], -1)).float()
    effects = [
        {"effect": f"lidar.particle_density_{axis}", **TRUTH[axis]} for axis in ("azimuth", "elevation")
    ]  # fmt: skip
    lidar = tw.LidarSnow(tw.Snow(rate_mm_per_h=1.0), tw.Lidar(wavelength_nm=905.0), effects=effects)
    state = lidar.state_of(points[None], None)
    for effect in ("particle_density_azimuth", "particle_density_elevation"):
        state = lidar.chain.stages[effect](state, {})
    wanted = fit.Density(**TRUTH).of(snow) / 0.2
    np.testing.assert_allclose(state.air.beam_density[0].double().numpy(), wanted, rtol=2e-4)


def test_sizes_are_found_from_the_ranges_that_they_give(fit: Any) -> None:
    sensor, weather = tw.Lidar.preset("pandar64-wads", range_at_10_percent_m=200.0), tw.Snow(rate_mm_per_h=0.3)
    factors = np.array([20.0, 0.5, 0.2, 0.1])
    by_range, upto = fit.numbers_by_range(weather, sensor, -12.0)
    snow = scan(fit, 20_000)
    number = float(factors @ upto)
    density = fit.Density(number, TRUTH["azimuth"] | {"amplitude": 0.0, "wind_amplitude": 0.0}, TRUTH["elevation"])
    density.elevation["amplitude"] = 0.0
    wanted = np.round(20_000 * factors @ by_range).astype(int)
    middles = 0.5 * (np.array(fit.RANGE_EDGES_M[1:]) + np.array(fit.RANGE_EDGES_M[:-1]))
    ranges = np.repeat(middles, wanted)
    ranges_m = np.zeros((max(len(ranges), 20_000), 2))
    ranges_m[: len(ranges), 0] = ranges
    found = fit.fitted_sizes(
        fit.Snow(snow.azimuth_rad, snow.elevation_rad, snow.ring, snow.flake, ranges_m), density, weather, sensor
    )[0]
    assert found.chi2 < 2.0  # rounded counts, and no noise
    by_found, _ = fit.numbers_by_range(weather, sensor, found.gain_db)
    np.testing.assert_allclose(20_000 * np.array(found.factors) @ by_found, wanted, rtol=0.1, atol=5.0)


def test_the_page_has_the_tables_of_the_figures(bench: Any, report: dict[str, Any]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for axis in ("azimuth", "elevation"):
        assert "\n".join(bench.table(report["frames_together"][axis], axis)) in page
        for name, label in bench.COLUMNS.items():
            shown = " | ".join(f"{inside} of {number}" for inside, number in report["within"][axis][name])
            assert f"| {axis} | {label} | {shown} |" in page


def test_what_the_page_claims_is_what_the_figures_say(bench: Any, report: dict[str, Any]) -> None:
    within = report["within"]
    assert within["elevation"]["fitted"][2] == [5, 6]
    assert within["elevation"]["preset"][2][0] < 3
    ahead = [part["azimuth"][3]["recorded"] for part in (report["frames_fitted"], *report["frames_reported"])]
    assert ahead[2] > 2.0 * ahead[0]  # in front, from frame to frame


@pytest.mark.long  # beside profiles of made snow
@pytest.mark.real_data
def test_the_profile_of_one_recorded_frame_holds_in_the_others(bench: Any, fit: Any, report: dict[str, Any]) -> None:
    folder = recording("wads_snow")
    module = bench.example()
    parts = []
    for path in sorted((folder / "velodyne").glob("*.bin")):
        beams, _, _ = module.beams_of_recording(*module.read_frame(path))
        parts.append(bench.snow_of(beams, beams.snow, beams.range_m))
    found = fit.fitted_density(parts[0])
    assert found.number == pytest.approx(report["fit"]["density"]["number"], rel=0.02)
    later = bench.joined(parts[1:])
    expected = -np.expm1(-found.of(later))
    height = np.degrees(later.elevation_rad)
    for low, high in zip(bench.ELEVATIONS_DEG[:-1], bench.ELEVATIONS_DEG[1:], strict=True):
        inside = (height > low) & (height <= high)
        # 20 %, and 1 % that the sizes and the sharing of the simulation change.
        assert expected[inside].mean() == pytest.approx(later.flake[inside].mean(), rel=0.21)
