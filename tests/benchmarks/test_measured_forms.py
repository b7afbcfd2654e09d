"""Measured forms of the bench's generator: snow as WADS has it, the response of an OS2-128, sensors as they are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.gap_bench.generator.lidar import measured_forms as forms
from benchmarks.gap_bench.generator.lidar.design import Size, draw_design, study_of
from benchmarks.gap_bench.generator.lidar.lidar_sensor import shoot, study_sensor
from benchmarks.gap_bench.generator.lidar.lidar_shot import PARTICLE, View, Weather
from benchmarks.gap_bench.generator.lidar.particles import air_of, draw_drops
from benchmarks.gap_bench.generator.lidar.rays import Target, scan_pattern
from benchmarks.gap_bench.generator.lidar.scene import Scene

FRAMES = 24
TINY = Size(rings=16, columns=64, clear_frames=2, rates=2, frames=2)


def sky() -> View:
    """Beams that end nowhere."""
    scan, number = scan_pattern(32, 128), 32 * 128
    ones = np.ones(number)
    target = Target(np.inf * ones, 0.5 * ones, ones, 0.0 * ones)
    return View(scan, target, study_sensor(scan, 2.0, 10.0), Scene((), 0.2, 1))


def flakes(view: View, *effects: Any) -> np.ndarray:
    """Share ``(N,)`` of frames in which a beam returns a flake."""
    report = shoot(view, Weather("snow", 1.0), effects, np.arange(float(FRAMES)), np.random.default_rng(5))
    return np.asarray((report.kind == PARTICLE).mean(0))


def density(effect: Any, view: View) -> np.ndarray:
    """Number of flakes ``(N,)`` in a beam over that of the weather."""
    shot: Any = SimpleNamespace(view=view)
    effect.prepare(shot)
    return np.asarray(shot.beam_density)


def test_the_profiles_are_those_of_the_recorded_shares() -> None:
    """The number in a beam is ``-ln(1 - share)``. The rear lies where the car's is; to its right are the fewest."""
    view = sky()
    around = density(forms.DensityAzimuth({"amplitude": 1.0, "azimuth_rad": 0.4}), view)
    at = np.angle(np.exp(1j * (view.scan.azimuth_rad - 0.4)))
    rear, right = (around[np.abs(at - place).argmin()] for place in (0.0, 0.75 * np.pi))
    wanted = np.log1p(-forms.SHARE_BY_AZIMUTH[7]) / np.log1p(-forms.SHARE_BY_AZIMUTH[2])
    assert rear / right == pytest.approx(wanted, rel=0.15)  # columns are 3 degrees wide
    assert around.mean() == pytest.approx(1.0, rel=0.02)

    profile = density(forms.DensityElevation({"amplitude": 1.0}), view)
    up = np.degrees(np.arcsin(view.scan.direction.reshape(-1, 3)[:, 2]))
    wanted = np.log1p(-forms.SHARE_BY_ELEVATION[1]) / np.log1p(-forms.SHARE_BY_ELEVATION[5])
    assert profile[np.abs(up + 0.75).argmin()] == pytest.approx(wanted, rel=0.1)
    assert profile[up > 12.5] == pytest.approx(1.0)


@pytest.mark.parametrize("axis", ["azimuth", "elevation"])
def test_beams_have_flakes_as_their_density_says(axis: str) -> None:
    """Thin and dense beams; 4 % less in dense ones, whose flakes dim each other."""
    view, parameters = sky(), {"amplitude": 1.0, "azimuth_rad": 0.4}
    effect = (forms.DensityAzimuth if axis == "azimuth" else forms.DensityElevation)(parameters)
    expected, share = density(effect, view), flakes(view, effect)
    plain = -np.log1p(-flakes(view).mean())
    for place in (expected > np.quantile(expected, 0.9), expected < np.quantile(expected, 0.1)):
        number = plain * expected[place]
        wanted = float((1.0 - np.exp(-number)).mean())
        noise = np.sqrt(wanted / (FRAMES * place.sum()))
        assert share[place].mean() == pytest.approx(wanted, abs=4.0 * noise + 0.06 * wanted)


def test_half_of_an_amplitude_is_half_of_the_way_to_the_profile() -> None:
    none, half, whole = (density(forms.DensityElevation({"amplitude": one}), sky()) for one in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(none, 1.0)
    np.testing.assert_allclose(half, 0.5 * (1.0 + whole))


def test_a_density_of_beams_thins_their_particles_and_takes_no_other_draws() -> None:
    """Lists of particles of twice the number in half of the beams, and of none in the others; of one in all of them."""
    sensor, beams = study_sensor(scan_pattern(32, 128), 1.0, 3.0), 4096

    def drawn(beam_density: np.ndarray | None, pulse_m: float = 0.0) -> Any:
        floor, wide = 0.5 * sensor.threshold_per_m2_sr, 1e-3 * sensor.divergence_mrad
        air, rng = air_of("snow", 1.0, 865.0), np.random.default_rng(11)
        return draw_drops(air, sensor, beams, np.ones(8), floor, wide, rng, pulse_m, beam_density)

    one, alike = drawn(None), drawn(np.ones(beams))
    np.testing.assert_array_equal(one.signal, alike.signal)
    halves = drawn(np.where(np.arange(beams) < beams // 2, 2.0, 0.0))
    assert (halves.beam < beams // 2).all()
    assert len(halves.beam) == pytest.approx(len(one.beam), abs=5.0 * np.sqrt(2.0 * len(one.beam)))
    # Echoes of a pulse add to each other where the particles are, twice as often as where they are spread.
    added = {
        name: drawn(density, 3.0).signal.mean() / drawn(density).signal.mean() - 1.0
        for name, density in (("spread", None), ("dense", np.where(np.arange(beams) < beams // 2, 2.0, 0.0)))
    }
    assert added["dense"] == pytest.approx(2.0 * added["spread"], rel=0.15)


def test_near_flakes_are_fainter_by_the_measured_response() -> None:
    """A tenth of the recorded power, at which near flakes are still reported: 7 % less at 21 m, none beyond 30 m."""
    assert forms.NearResponse.at(1.0, forms.NearResponse.fixed(np.random.default_rng(0))).parameters == {
        "power": 2.0,
        "full_m": 30.0,
    }
    view = sky()
    quiet = replace(view, sensor=replace(view.sensor, photons_at_threshold=1e12))

    def report(*effects: Any) -> Any:
        return shoot(quiet, Weather("snow", 1.0), effects, np.arange(float(FRAMES)), np.random.default_rng(5))

    base, dim = report(), report(forms.NearResponse({"full_m": 30.0, "power": 0.2}))
    same = (base.range_m == dim.range_m) & (base.kind == PARTICLE)
    assert same.sum() > 30
    np.testing.assert_allclose(
        dim.signal[same] / base.signal[same], np.minimum(base.range_m[same] / 30.0, 1.0) ** 0.2, rtol=0.01
    )
    assert (dim.kind == PARTICLE).sum() < (base.kind == PARTICLE).sum()


@pytest.mark.parametrize("name", sorted(forms.MEASURED_NULLS))
def test_what_clear_frames_have_as_well_is_a_study_of_the_same_beams(name: str) -> None:
    rng = np.random.default_rng(15)
    design = draw_design(rng, "snow", TINY, "common", 0.0)
    decoy = forms.MEASURED_NULLS[name](design, lambda effect, level: {}, rng)
    assert decoy.verdicts == ("none",)
    seen = replace(design, views=decoy.clear_views or design.views)
    study = study_of(seen, decoy.effects, rng, clear_effects=decoy.clear_effects, views=decoy.views)
    np.testing.assert_array_equal(study.beams["direction"], design.scan.direction.astype(np.float32))
    clear, weather = study.scenes["s0"].clear[0], study.conditions[0].frames[0]
    if name == "measured.intensity_in_steps":
        for frame in (clear, weather):
            steps = frame["intensity"] * 100.0
            np.testing.assert_allclose(steps, np.rint(steps), atol=1e-4)
        frames = [frame for one in study.conditions for frame in one.frames]
        assert any(((frame["intensity"] == 0.0) & (frame["range_m"] > 0.0)).any() for frame in frames)
    elif name == "measured.empty_beams_end_at_ground":
        far = (np.nan_to_num(design.views[0].target.up) > 0.5) & (design.views[0].target.range_m > forms.DARK_FROM_M)
        assert far.sum() > 20
        assert (clear["range_m"].reshape(-1)[far] == 0.0).all()
    else:
        level = design.views[0].target.range_m
        told, true = (np.isfinite(one) for one in (level, decoy.views[0].target.range_m))  # type: ignore[index]
        assert (told != true).mean() < 0.1
        assert 0.001 < np.median(np.abs(level[told & true] - decoy.views[0].target.range_m[told & true])) < 0.5  # type: ignore[index]
