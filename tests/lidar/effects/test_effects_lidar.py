"""What each effect of LiDAR does, against slow calculations of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.effects.effect_scene import (
    BEAMS,
    COLUMNS,
    ROWS,
    active,
    begin,
    cloud,
    directions,
    own_noise,
    rain,
    scan_sensor,
    states,
)
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.core.random import draw_variates
from torchweather.sensors import Lidar
from torchweather.stages import EFFECTS, LidarState, PointKind, with_effects
from torchweather.transforms import LidarFog, LidarRain, LidarWeather

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
AZIMUTH = torch.atan2(directions()[:, 1], directions()[:, 0])


@pytest.fixture(scope="module")
def transform() -> LidarWeather:
    return rain()


def around(transform: LidarWeather, name: str, seed: int = 3, **values: Any) -> tuple[LidarState, LidarState]:
    """The state in front of an effect and behind it, in rain."""
    effect = EFFECTS[name](**values)
    chain = with_effects(transform.chain, [effect])
    state = begin(transform)
    noise = chain.draw(state, seed=seed)
    found = states(chain, state, noise)
    before = {"to_energy": None, **found}[effect.after]
    assert before is not None
    return before, found[effect.default_name]


def outcomes(transform: LidarWeather, name: str, seed: int = 3, **values: Any) -> tuple[LidarState, LidarState]:
    """What comes out of the chain without the effect and with it."""
    chain = with_effects(transform.chain, [EFFECTS[name](**values)])
    state = begin(transform)
    noise = chain.draw(state, seed=seed)
    return transform.chain(state, noise), chain(state, noise)


def points_of(state: LidarState) -> Tensor:
    assert state.returns.points is not None
    return state.returns.points


# ---- air and optics ----------------------------------------------------------------------------------------------


def test_window_loss_of_3_db_halves_every_signal_and_the_intensity_of_objects_and_particles(
    transform: LidarWeather,
) -> None:
    half_db = 10.0 * math.log10(2.0)
    before, after = around(transform, "lidar.window_loss", loss_db=half_db)
    torch.testing.assert_close(after.returns.signal, 0.5 * before.returns.signal, rtol=1e-6, atol=0.0)
    plain, lossy = outcomes(transform, "lidar.window_loss", loss_db=half_db)
    for kind in (OBJECT, PARTICLE):
        both = (plain.returns.kind[..., 0] == kind) & (lossy.returns.kind[..., 0] == kind)
        assert int(both.sum()) > 20
        ratio = points_of(lossy)[..., 3][both] / points_of(plain)[..., 3][both]
        torch.testing.assert_close(ratio, torch.full_like(ratio, 0.5), rtol=1e-5, atol=0.0)


def test_twice_the_extinction_is_the_objects_intensity_at_twice_alpha(transform: LidarWeather) -> None:
    alpha = float(transform.extinction_per_m)
    before, after = around(transform, "lidar.extinction_scale", factor=2.0)
    clear_m, clear = before.scene.clear_range_m.double(), before.scene.clear_signal.double()
    torch.testing.assert_close(
        after.returns.signal[..., 0].double(), clear * torch.exp(-4.0 * alpha * clear_m), rtol=1e-5, atol=0.0
    )
    assert after.air.extinction_per_m is not None
    assert after.air.extinction_per_m.tolist() == pytest.approx([2.0 * alpha] * 3)


def test_twice_the_extinction_is_the_rain_seen_with_twice_the_extinction_efficiency(transform: LidarWeather) -> None:
    """q_eff counts linearly, so a model with twice of it is the same chain, particles included."""
    twice = LidarRain(Rain(50.0), scan_sensor(), q_eff=2.2)
    noise = transform.draw(cloud(), seed=4)
    with_effect = rain(effects=[EFFECTS["lidar.extinction_scale"](factor=2.0)])(cloud(), noise, directions=directions())
    torch.testing.assert_close(with_effect, twice(cloud(), noise, directions=directions()), rtol=1e-5, atol=1e-6)


def test_limited_extent_attenuates_up_to_the_extent_and_has_no_particle_beyond(transform: LidarWeather) -> None:
    alpha, extent_m = float(transform.extinction_per_m), 7.0
    before, after = around(transform, "lidar.limited_extent", extent_m=extent_m)
    inside_m = np.minimum(before.scene.clear_range_m.double().numpy(), extent_m)
    wanted = before.scene.clear_signal.double().numpy() * np.exp(-2.0 * alpha * inside_m)
    np.testing.assert_allclose(after.returns.signal[..., 0].double().numpy(), wanted, rtol=1e-5)
    plain, limited = outcomes(transform, "lidar.limited_extent", extent_m=3.0)
    ranges = [state.returns.range_m[state.returns.kind == PARTICLE] for state in (plain, limited)]
    assert float(ranges[0].max()) > 3.5
    assert float(ranges[1].max()) <= 3.0
    assert len(ranges[1]) > 50


def test_the_particles_of_a_limited_extent_are_those_in_front_of_a_wall_there(transform: LidarWeather) -> None:
    """Drops in front of 4 m, whether a wall stands there or the rain ends: bit for bit the same draw."""
    chain = with_effects(transform.chain, [EFFECTS["lidar.limited_extent"](extent_m=4.0)])
    state = begin(transform)
    noise = chain.draw(state, seed=3)
    limited = states(chain, state, noise)["particle_returns"]
    wall = transform.state_of(torch.cat([4.0 * directions(), 0.5 * torch.ones(BEAMS, 1)], -1).expand(3, -1, -1))
    in_front = states(transform.chain, wall, noise)["particle_returns"]
    far = (state.air.reach_m > 4.01) & (in_front.returns.range_m[..., 1] > 0)
    assert int(far.sum()) > 200
    torch.testing.assert_close(
        limited.returns.range_m[..., 1][far], in_front.returns.range_m[..., 1][far], rtol=1e-4, atol=1e-4
    )


def test_a_wider_beam_sees_more_drops_and_each_of_them_fainter() -> None:
    """Far beyond the exit a drop's signal goes with 1 / D_b^2, and the number of drops with D_b^2."""
    sensor = replace(scan_sensor(), exit_diameter_mm=0.1, divergence_mrad=1.0)
    transform = LidarRain(Rain(50.0), sensor, q_eff=0.0)
    _, after = around(transform, "lidar.beam_divergence", extra_mrad=2.0)
    assert after.receiver.extra_divergence_rad is not None
    assert after.receiver.extra_divergence_rad.tolist() == pytest.approx([2e-3] * 3)
    part = transform.chain.stages["particle_returns"].kinds["rain"]
    own = transform.chain.stages["particle_returns"].beam
    signal, reach = torch.full((1, 1), 1e-5), torch.full((1, 1), 100.0)
    wide = part.expected_above(own.widened(after.receiver.extra_divergence_rad[:1]), signal, torch.zeros(1), reach)
    # Three times the diameter: nine times the area, and the same drops are those of nine times the signal before.
    equal = part.expected_above(own, 9.0 * signal, torch.zeros(1), reach)
    # But for the exit's 0.1 mm against 3 mm at 1 m, and for drops wider than the beam, near the sensor.
    assert float(wide / (9.0 * equal)) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("known", ["both", "up", "incidence", "none"])
def test_wet_targets_are_darker_by_up_and_incidence_and_particles_are_not(transform: LidarWeather, known: str) -> None:
    state = begin(transform)
    if known in ("incidence", "none"):
        state = state.changed(up=None)
    if known in ("up", "none"):
        state = state.changed(cos_incidence=None)
    chain = with_effects(transform.chain, [EFFECTS["lidar.wet_target"](share=0.6)])
    found = states(chain, state, chain.draw(state, seed=3))
    before, after = found["extinction"], found["wet_target"]
    for beam in range(1, BEAMS, 37):
        if float(before.scene.clear_range_m[1, beam]) == 0.0:
            continue
        wet = 1.0
        if state.scene.up is not None:
            wet *= 0.5 * (1.0 + float(state.scene.up[0, beam]))
        if state.scene.cos_incidence is not None:
            wet *= (
                1.0
                - 0.5 * (water_transmittance(float(state.scene.cos_incidence[0, beam])) / water_transmittance(1.0)) ** 2
            )
        assert float(after.returns.signal[1, beam, 0] / before.returns.signal[1, beam, 0]) == pytest.approx(
            1.0 - 0.6 * wet, rel=1e-5
        )
    plain = states(transform.chain, state, chain.draw(state, seed=3))["particle_returns"]
    assert torch.equal(found["particle_returns"].returns.signal[..., 1:], plain.returns.signal[..., 1:])


def water_transmittance(cos_in: float) -> float:
    """Fresnel by the angles (sines and tangents), n = 1.33."""
    angle = math.acos(min(cos_in, 1.0))
    if angle < 1e-6:
        return 1.0 - (0.33 / 2.33) ** 2
    water = math.asin(math.sin(angle) / 1.33)
    upright = (math.sin(angle - water) / math.sin(angle + water)) ** 2
    parallel = (math.tan(angle - water) / math.tan(angle + water)) ** 2
    return 1.0 - 0.5 * (upright + parallel)


def inside_sector(azimuth_rad: float, width_rad: float) -> Tensor:
    """By the difference of the angles, wrapped."""
    apart = [abs((float(a) - azimuth_rad + math.pi) % (2.0 * math.pi) - math.pi) for a in AZIMUTH]
    return torch.tensor(apart) <= 0.5 * width_rad


@pytest.mark.parametrize(
    ("azimuth_rad", "width_rad"), [(3.0, 1.0), (-3.1, 0.7), (0.0, 2.0 * math.pi), (1.0, 4.5), (1.0, 0.0)]
)
def test_a_dirty_sector_weakens_its_beams_alone(transform: LidarWeather, azimuth_rad: float, width_rad: float) -> None:
    before, after = around(transform, "lidar.sector_loss", azimuth_rad=azimuth_rad, width_rad=width_rad, loss_db=10.0)
    wanted = torch.where(inside_sector(azimuth_rad, width_rad)[None, :, None], 0.1, 1.0) * before.returns.signal
    torch.testing.assert_close(after.returns.signal, wanted, rtol=1e-5, atol=0.0)


def test_particles_are_brighter_and_objects_are_not(transform: LidarWeather) -> None:
    before, after = around(transform, "lidar.particle_backscatter", gain_db=10.0)
    torch.testing.assert_close(
        after.returns.signal[..., 1:], 10.0 * before.returns.signal[..., 1:], rtol=1e-5, atol=0.0
    )
    assert torch.equal(after.returns.signal[..., 0], before.returns.signal[..., 0])


def test_the_density_of_patchy_weather_has_mean_1_and_the_spread_asked_for(transform: LidarWeather) -> None:
    """20,000 samples: mean 1 and variance exp(s^2) - 1 within four standard errors."""
    samples, log_std = 20_000, 0.5
    effect = EFFECTS["lidar.patchy_weather"](log_std=log_std)
    state = begin(transform, batch=1)
    wide = state.changed(
        **{
            name: state.field(name)[:, :1].expand(samples, *(-1,) * (state.field(name).ndim - 1))
            for name in ("points_in", "signal", "range_m", "kind", "clear_range_m", "reach_m", "clear_signal")
        },
    )
    noise = draw_variates(range(samples), effect.default_name, effect.variates(), wide.sizes)
    found = effect(wide, {"density": torch.from_numpy(noise["patchy_weather.density"])}).air.density_scale
    assert found is not None
    density = found.double()
    variance = math.exp(log_std**2) - 1.0
    assert float(density.mean()) == pytest.approx(1.0, abs=4.0 * math.sqrt(variance / samples))
    assert float(density.log().std()) == pytest.approx(log_std, abs=4.0 * log_std / math.sqrt(2 * samples))


def test_a_dense_patch_is_the_rain_with_more_drops_of_every_size(transform: LidarWeather) -> None:
    """The density counts in the extinction and in the particles, each sample by itself."""
    effect = EFFECTS["lidar.patchy_weather"](log_std=1.0)
    state = begin(transform)
    chain = with_effects(transform.chain, [effect])
    noise = chain.draw(state, seed=3)
    found = states(chain, state, noise)
    drawn = noise["patchy_weather.density"][:, 0].double()
    density = torch.exp(drawn - 0.5)
    alpha = float(transform.extinction_per_m)
    extinction = found["extinction"].air.extinction_per_m
    assert extinction is not None
    torch.testing.assert_close(extinction.double(), alpha * density, rtol=1e-5, atol=0.0)


def test_a_static_structure_stands_where_it_was_put(transform: LidarWeather) -> None:
    values = {"azimuth_rad": 1.0, "range_m": 9.0, "width_rad": 0.6}
    before, after = around(transform, "lidar.static_structure", **values)
    inside = inside_sector(1.0, 0.6)
    sensor, direction = scan_sensor(), directions().double()
    for sample in range(3):
        for beam in range(BEAMS):
            clear_m = float(before.scene.clear_range_m[sample, beam])
            slant_m = 9.0 / math.hypot(float(direction[beam, 0]), float(direction[beam, 1]))
            got = after.scene.clear_range_m[sample, beam], after.scene.clear_signal[sample, beam]
            if bool(inside[beam]) and (clear_m == 0.0 or clear_m > slant_m):
                assert float(got[0]) == pytest.approx(slant_m, rel=1e-5)
                assert float(got[1]) == pytest.approx(0.1 / math.pi / slant_m**2, rel=1e-5)
                assert int(after.returns.kind[sample, beam, 0]) == OBJECT
                assert float(after.scene.points_in[sample, beam, 3]) == pytest.approx(0.1)
                place = after.scene.points_in[sample, beam, :3].double()
                torch.testing.assert_close(place, direction[beam] * slant_m, rtol=1e-5, atol=1e-5)
            else:
                assert float(got[0]) == clear_m
                assert torch.equal(after.scene.points_in[sample, beam], before.scene.points_in[sample, beam])
    assert sensor.near_full_m < 9.0


@pytest.mark.parametrize(
    ("unit", "wanted"),
    [
        ("reflectivity", 0.1),
        ("reflectivity_percent", 10.0),
        ("uint8_linear", 25.0),
        ("uint8_calibrated", 10.0),
        ("photons", 10.0 * (60.0 / 9.0) ** 2),  # ten at the range of a 10 % target at the threshold
        ("none", 1.0),
    ],
)
def test_a_static_structure_has_10_percent_in_the_unit_of_the_cloud(unit: str, wanted: float) -> None:
    sensor = scan_sensor(intensity_unit=unit, elevations_deg=None, columns=None)
    transform = LidarRain(Rain(0.0), sensor, effects=[EFFECTS["lidar.static_structure"](range_m=9.0, width_rad=0.5)])
    points = torch.tensor([[30.0, 0.0, 0.0, 3.0], [0.0, 30.0, 0.0, 3.0]])
    out = transform(points, transform.draw(points, seed=1))
    assert float(out[0, 0]) == pytest.approx(9.0)
    assert float(out[0, 3]) == pytest.approx(wanted, abs=1.0 if unit == "photons" else 1e-5)
    assert torch.equal(out[1], points[1])


def test_a_structure_beyond_its_detection_hides_what_is_behind() -> None:
    """10 % at 100 m are below the threshold of a sensor that sees them to 60 m: nothing returns, nor does the wall."""
    transform = LidarRain(
        Rain(0.0),
        scan_sensor(elevations_deg=None, columns=None),
        effects=[EFFECTS["lidar.static_structure"](range_m=100.0, width_rad=0.5)],
    )
    points = torch.tensor([[110.0, 0.0, 0.0, 0.9], [0.0, 110.0, 0.0, 0.9]])
    result = transform.run(points, transform.draw(points, seed=1))
    assert isinstance(result.kind, Tensor)
    assert result.kind.tolist() == [LOST, OBJECT]


def test_spray_is_near_in_its_sector_and_as_frequent_as_asked_for(transform: LidarWeather) -> None:
    """Against Poisson counts: share of beams 1 - exp(-mean), four standard deviations over all draws."""
    strength, hits, wanted, variance = 0.8, 0, 0.0, 0.0
    effect = EFFECTS["lidar.spray"](strength=strength, azimuth_rad=math.pi, width_rad=2.0)
    inside = inside_sector(math.pi, 2.0)
    near_m = scan_sensor().near_start_m
    margins, ranges = [], []
    chain = with_effects(transform.chain, [effect])
    state = begin(transform)
    for seed in range(0, 60, 3):
        found = states(chain, state, chain.draw(state, seed=seed))
        before, after = found["particle_returns"], found["spray"]
        assert after.returns.signal.shape[-1] == before.returns.signal.shape[-1] + 1
        there = after.returns.signal[..., -1] > 0
        assert not bool(there[:, ~inside].any())
        assert (after.returns.kind[..., -1] == PARTICLE).all()
        reach_m = torch.where(before.scene.clear_range_m > 0, before.scene.clear_range_m, before.air.reach_m).double()
        mean = strength * (1.0 - torch.exp(-(reach_m - near_m).clamp_min(0.0) / 5.0))[:, inside]
        share = 1.0 - torch.exp(-mean)
        hits += int(there.sum())
        wanted += float(share.sum())
        variance += float((share * (1.0 - share)).sum())
        assert (after.returns.range_m[..., -1][there] <= reach_m[there]).all()
        assert (after.returns.range_m[..., -1][there] >= near_m).all()
        far = there & (reach_m > 40.0)
        ranges.append(after.returns.range_m[..., -1][far].double())
        margins.append((after.returns.signal[..., -1][far] / after.receiver.threshold).double().log10() * 10.0)
    assert hits == pytest.approx(wanted, abs=4.0 * math.sqrt(variance))
    range_m, margin_db = torch.cat(ranges), torch.cat(margins)
    number = len(range_m)
    assert float((range_m - near_m).mean()) == pytest.approx(5.0, abs=4.0 * 5.0 / math.sqrt(number))
    # The largest of n margins of mean 3 dB, n Poisson of mean mu and not 0: numbers drawn one by one.
    generator = np.random.default_rng(1)
    counts = generator.poisson(strength, 200_000)
    largest = np.array([generator.exponential(3.0, count).max() for count in counts if count])
    assert float(margin_db.mean()) == pytest.approx(
        largest.mean(), abs=4.0 * largest.std() * (1 / math.sqrt(number) + 1 / math.sqrt(len(largest)))
    )


# ---- receiver and firmware ---------------------------------------------------------------------------------------


def test_a_threshold_of_6_db_more_loses_what_lies_within_6_db_and_leaves_intensities(transform: LidarWeather) -> None:
    plain, shifted = outcomes(transform, "lidar.threshold_shift", shift_db=6.0)
    margin_db = 10.0 * torch.log10(plain.returns.signal[..., 0] / plain.receiver.threshold)
    seen = plain.returns.kind[..., 0] == OBJECT
    lost = seen & (shifted.returns.kind[..., 0] != OBJECT)
    assert float(margin_db[lost].max()) < 6.0
    assert int(lost.sum()) > 50
    stayed = seen & ~lost
    assert float(margin_db[stayed].min()) >= 6.0
    assert torch.equal(points_of(plain)[stayed], points_of(shifted)[stayed])


def test_nothing_nearer_than_the_blind_zone_is_reported() -> None:
    sensor = scan_sensor(near_start_m=3.0, near_full_m=4.0, elevations_deg=None, columns=None)
    transform = LidarRain(Rain(0.0), sensor, effects=[EFFECTS["lidar.blind_zone"](range_m=5.0)])
    points = torch.tensor([[1.0, 0, 0, 0.5], [4.9, 0, 0, 0.5], [5.1, 0, 0, 0.5]])
    result = transform.run(points, transform.draw(points, seed=1))
    assert isinstance(result.kind, Tensor)
    assert result.kind.tolist() == [LOST, LOST, OBJECT]
    plain, blind = outcomes(rain(), "lidar.blind_zone", range_m=2.5)
    near, far = (
        (plain.returns.range_m < 2.5) & (plain.returns.kind == PARTICLE),
        (plain.returns.range_m >= 2.5) & (plain.returns.kind != LOST),
    )
    assert int(near.sum()) > 50
    assert torch.equal(blind.returns.range_m[far], plain.returns.range_m[far])
    assert float(blind.returns.range_m[blind.returns.kind != LOST].min()) >= 2.5


def test_a_receiver_that_wakes_up_late_loses_signal_in_its_blind_zone(transform: LidarWeather) -> None:
    """10 dB of the signal within the zone, where it is detected all the same; nothing beyond."""
    before, after = around(transform, "lidar.blind_zone", range_m=6.0, loss_db=10.0)
    near = before.returns.range_m < 6.0
    assert int((near & (before.returns.signal > 0)).sum()) > 50
    torch.testing.assert_close(after.returns.signal[near], 0.1 * before.returns.signal[near], rtol=1e-6, atol=0.0)
    assert torch.equal(after.returns.signal[~near], before.returns.signal[~near])
    _, sharp = around(transform, "lidar.blind_zone", range_m=6.0)
    assert float(sharp.returns.signal[near].abs().max()) == 0.0


def test_range_noise_is_normal_with_the_spread_asked_for(transform: LidarWeather) -> None:
    before, after = around(transform, "lidar.range_noise", std_m=0.05)
    reported = before.returns.kind != LOST
    error_m = (after.returns.range_m - before.returns.range_m)[reported].double()
    number = len(error_m)
    assert float(error_m.mean()) == pytest.approx(0.0, abs=4.0 * 0.05 / math.sqrt(number))
    assert float(error_m.std()) == pytest.approx(0.05, rel=4.0 / math.sqrt(2 * number))
    assert torch.equal(after.returns.range_m[~reported], before.returns.range_m[~reported])


def test_a_range_is_not_negative(transform: LidarWeather) -> None:
    _, after = around(transform, "lidar.range_bias", offset_m=-5.0)
    assert float(after.returns.range_m.min()) == 0.0
    assert int((after.returns.range_m[after.returns.kind != LOST] == 0).sum()) > 5


def test_range_bias_walks_with_the_decades_of_the_signal(transform: LidarWeather) -> None:
    before, after = around(transform, "lidar.range_bias", offset_m=0.1, walk_m_per_decade=-0.05)
    for sample, beam in ((0, 1), (1, 7), (2, 33), (0, 444)):
        assert int(before.returns.kind[sample, beam, 0]) != LOST
        decades = math.log10(float(before.returns.signal[sample, beam, 0]) / scan_sensor().threshold_per_m2_sr)
        moved = float(after.returns.range_m[sample, beam, 0] - before.returns.range_m[sample, beam, 0])
        assert moved == pytest.approx(0.1 - 0.05 * decades, abs=1e-5)


def test_range_stretch_grows_with_the_optical_depth_and_ends_with_the_weather(transform: LidarWeather) -> None:
    alpha = float(transform.extinction_per_m)
    before, after = around(transform, "lidar.range_stretch", m_per_optical_depth=3.0)
    reported = before.returns.kind != LOST
    torch.testing.assert_close(
        after.returns.range_m[reported], (before.returns.range_m * (1.0 + 3.0 * alpha))[reported], rtol=1e-5, atol=1e-5
    )
    effects = [EFFECTS["lidar.range_stretch"](m_per_optical_depth=3.0), EFFECTS["lidar.limited_extent"](extent_m=10.0)]
    chain = with_effects(transform.chain, effects)
    state = begin(transform)
    found = states(chain, state, chain.draw(state, seed=3))
    before, after = found["detection"], found["range_stretch"]
    far = (before.returns.kind == OBJECT) & (before.returns.range_m > 10.0)
    torch.testing.assert_close(
        (after.returns.range_m - before.returns.range_m)[far],
        torch.full((int(far.sum()),), 30.0 * alpha),
        rtol=1e-3,
        atol=1e-5,
    )


def test_the_last_return_drops_particles_in_front_of_what_is_seen_alone(transform: LidarWeather) -> None:
    before, after = around(transform, "lidar.last_return", probability=1.0)
    seen = (before.returns.kind[..., 0] == OBJECT) & (before.returns.signal[..., 0] >= before.receiver.threshold)
    assert (after.returns.signal[..., 1:][seen] == 0).all()
    assert torch.equal(after.returns.signal[..., 1:][~seen], before.returns.signal[..., 1:][~seen])
    assert torch.equal(after.returns.signal[..., 0], before.returns.signal[..., 0])
    part = around(transform, "lidar.last_return", probability=0.3)
    had = seen & (before.returns.signal[..., 1] > 0)
    share = float((part[1].returns.signal[..., 1][had] == 0).double().mean())
    number = int(had.sum())
    assert share == pytest.approx(0.3, abs=4.0 * math.sqrt(0.21 / number))


def test_in_strongest_mode_the_last_return_uncovers_the_objects(transform: LidarWeather) -> None:
    plain, last = outcomes(transform, "lidar.last_return", probability=1.0)
    covered = (plain.returns.kind[..., 0] == PARTICLE) & (last.returns.kind[..., 0] == OBJECT)
    assert int(covered.sum()) > 5
    assert not bool(((plain.returns.kind[..., 0] == OBJECT) & (last.returns.kind[..., 0] != OBJECT)).any())


def brute_force_isolated(range_m: Any, reported: Any, radius_m: float) -> Any:
    """Beams without a neighbour within the radius, by loops."""
    alone = np.zeros(ROWS * COLUMNS, dtype=bool)
    for row in range(ROWS):
        for column in range(COLUMNS):
            beam = row * COLUMNS + column
            if not reported[beam]:
                continue
            alone[beam] = True
            for r in range(max(0, row - 1), min(ROWS, row + 2)):
                for c in (column - 1, column, column + 1):
                    other = r * COLUMNS + c % COLUMNS
                    if other != beam and reported[other] and abs(range_m[other] - range_m[beam]) <= radius_m:
                        alone[beam] = False
    return alone


@pytest.mark.parametrize("radius_m", [0.5, 3.0, 20.0])
def test_the_isolated_return_filter_removes_what_a_brute_force_search_finds(
    transform: LidarWeather, radius_m: float
) -> None:
    before, after = around(transform, "lidar.isolated_return_filter", probability=1.0, radius_m=radius_m)
    for sample in range(3):
        range_m = before.returns.range_m[sample, :, 0].numpy()
        reported = before.returns.kind[sample, :, 0].numpy() != LOST
        alone = brute_force_isolated(range_m, reported, radius_m)
        assert 5 < alone.sum() < reported.sum()
        kept = after.returns.kind[sample, :, 0].numpy() != LOST
        assert np.array_equal(kept, reported & ~alone)
        assert (after.returns.range_m[sample, :, 0].numpy()[alone] == 0).all()
    half = around(transform, "lidar.isolated_return_filter", probability=0.5, radius_m=radius_m)[1]
    removed = (before.returns.kind != LOST) & (half.returns.kind == LOST)
    number = int(((before.returns.kind != LOST) & (after.returns.kind == LOST)).sum())
    assert int(removed.sum()) == pytest.approx(0.5 * number, abs=4.0 * math.sqrt(0.25 * number))


def test_the_filter_looks_at_both_returns_of_a_dual_sensor() -> None:
    """A lone second return goes and its accompanied first stays."""
    sensor = scan_sensor(return_mode="dual")
    state = LidarRain(Rain(0.0), sensor).state_of(cloud(1), directions())
    range_m = torch.full((1, BEAMS, 2), 20.0)
    range_m[..., 1] = 0.0
    kind = torch.zeros(1, BEAMS, 2, dtype=torch.int8)
    kind[..., 1] = LOST
    kind[0, 130, 1], range_m[0, 130, 1] = OBJECT, 40.0
    after = EFFECTS["lidar.isolated_return_filter"](probability=1.0, radius_m=1.0)(
        state.changed(range_m=range_m, signal=torch.ones_like(range_m), kind=kind), {"removal": torch.zeros(1, BEAMS)}
    )
    assert (after.returns.kind[..., 0] == OBJECT).all()
    assert (after.returns.kind[..., 1] == LOST).all()


@pytest.mark.parametrize("exponent", [0.5, 2.0])
def test_a_curved_response_is_a_power_of_the_reflectivity(transform: LidarWeather, exponent: float) -> None:
    plain, curved = outcomes(transform, "lidar.intensity_compression", exponent=exponent)
    assert torch.equal(plain.returns.kind, curved.returns.kind)
    before, after = points_of(plain)[..., 3], points_of(curved)[..., 3]
    for kind in (OBJECT, PARTICLE):
        of = plain.returns.kind[..., 0] == kind
        assert int(of.sum()) > 50
        torch.testing.assert_close(after[of], before[of] ** exponent, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "white"), [("reflectivity_percent", 100.0), ("uint8_linear", 255.0), ("photons", None)]
)
def test_a_curved_response_leaves_white_or_the_threshold_where_it_is(unit: str, white: float | None) -> None:
    sensor = scan_sensor(intensity_unit=unit)
    white = float(sensor.photons_at_threshold) if white is None else white
    points = cloud()
    points[..., 3] = torch.where(points[..., 3] > 0.5, 1.0, 0.25) * white
    effect = EFFECTS["lidar.intensity_compression"](exponent=0.5)
    transform = LidarFog(Fog(mor_m=math.inf), sensor, effects=[effect])
    found = transform(points, transform.draw(points, seed=2), directions=directions())
    assert isinstance(found, Tensor)
    wanted = torch.where(points[..., 3] == white, white, 0.5 * white)  # the root of a quarter
    seen = points[..., :3].norm(dim=-1) > 0
    torch.testing.assert_close(found[..., 3][seen], wanted[seen], rtol=1e-4, atol=1.0 if unit != "photons" else 1e-3)


@pytest.mark.parametrize(
    ("unit", "saturation"),
    [
        ("reflectivity", 0.3),
        ("reflectivity_percent", 30.0),
        ("uint8_linear", 80.0),
        ("uint8_calibrated", 120.0),
        ("photons", 40.0),
    ],
)
def test_no_intensity_exceeds_the_saturation(unit: str, saturation: float) -> None:
    full = {"reflectivity": 0.9, "reflectivity_percent": 90.0, "photons": 150.0}.get(unit, 250.0)
    points = cloud()
    points[..., 3] *= full
    if unit.startswith("uint8"):
        points[..., 3] = points[..., 3].floor()
    sensor = scan_sensor(intensity_unit=unit)
    effect = EFFECTS["lidar.intensity_compression"](saturation=saturation)
    plain, capped = LidarFog(Fog(mor_m=400.0), sensor), LidarFog(Fog(mor_m=400.0), sensor, effects=[effect])
    noise = plain.draw(points, seed=2)
    open_ended = plain(points, noise, directions=directions())
    limited = capped(points, noise, directions=directions())
    assert isinstance(open_ended, Tensor)
    assert isinstance(limited, Tensor)
    assert float(open_ended[..., 3].max()) > 1.05 * saturation
    torch.testing.assert_close(limited[..., 3], open_ended[..., 3].clamp_max(saturation), rtol=1e-4, atol=1e-4)
    assert torch.equal(limited[..., :3], open_ended[..., :3])


def test_crosstalk_is_uniform_in_range_and_the_same_in_clear_frames() -> None:
    probability = 0.2
    effect = EFFECTS["lidar.crosstalk"](probability=probability)
    sensor = scan_sensor(min_range_m=20.0)
    transforms = [LidarRain(Rain(rate), sensor, effects=[effect]) for rate in (0.0, 50.0)]
    found = []
    for transform in transforms:
        plain = LidarRain(transform.weather, sensor)
        ranges, replaced, number = [], 0, 0
        for seed in range(0, 30, 3):
            noise = transform.draw(cloud(), seed=seed)
            with_it = transform.run(cloud(), noise, directions=directions())
            without = plain.run(cloud(), noise, directions=directions())
            assert isinstance(with_it.points, Tensor)
            assert isinstance(without.points, Tensor)
            assert isinstance(with_it.kind, Tensor)
            changed = (with_it.points != without.points).any(-1)
            assert (with_it.kind[changed] == PARTICLE).all()
            ranges.append(with_it.points[changed][:, :3].norm(dim=-1).double())
            replaced += int(changed.sum())
            number += changed.numel()
        share = replaced / number
        assert share == pytest.approx(probability, abs=4.0 * math.sqrt(probability * (1 - probability) / number))
        range_m = torch.cat(ranges)
        # A uniform law's mean and its deviation from the largest of Kolmogorov's statistic at 1e-4: 2.2 / sqrt(n).
        law = (range_m.sort().values - 20.0) / (sensor.max_range_m - 20.0)
        steps = torch.arange(1, len(law) + 1, dtype=torch.float64) / len(law)
        assert float((law - steps).abs().max()) < 2.2 / math.sqrt(len(law)) + 1.0 / len(law)
        found.append(range_m)
    torch.testing.assert_close(found[0], found[1], rtol=1e-5, atol=1e-4)


def test_beams_whose_direction_is_not_known_have_no_crosstalk() -> None:
    transform = rain(effects=[EFFECTS["lidar.crosstalk"](probability=1.0)])
    result = transform.run(cloud(), transform.draw(cloud(), seed=1))
    assert isinstance(result.kind, Tensor)
    empty = cloud()[..., :3].norm(dim=-1) == 0
    assert (result.kind[empty] == LOST).all()
    assert (result.kind[~empty] == PARTICLE).all()


def test_the_gain_of_a_ring_is_linear_in_its_row_and_0_in_the_middle(transform: LidarWeather) -> None:
    before, after = around(transform, "lidar.ring_gain", db_per_ring=0.5)
    for row in range(ROWS):
        beams = slice(row * COLUMNS, (row + 1) * COLUMNS)
        factor = 10.0 ** (0.05 * (row - 3.5))
        torch.testing.assert_close(
            after.returns.signal[:, beams], factor * before.returns.signal[:, beams], rtol=1e-5, atol=0.0
        )


# ---- together ----------------------------------------------------------------------------------------------------


def test_effects_of_one_place_follow_the_way_of_the_light() -> None:
    """Spray passes the dirty window, the blind zone swallows it, and a filter sees crosstalk."""
    effects = [active("lidar.spray", width_rad=6.0), EFFECTS["lidar.window_loss"](loss_db=30.0)]
    transform = rain(effects=effects)
    state = begin(transform)
    found = states(transform.chain, state, transform.chain.draw(state, seed=1))
    torch.testing.assert_close(
        found["window_loss"].returns.signal, 1e-3 * found["spray"].returns.signal, rtol=1e-4, atol=0.0
    )
    blind = rain(effects=[active("lidar.spray", width_rad=6.0), EFFECTS["lidar.blind_zone"](range_m=50.0)])
    found = states(blind.chain, state, blind.chain.draw(state, seed=1))
    assert (
        float(found["blind_zone"].returns.signal[..., -1][found["spray"].returns.range_m[..., -1] < 50.0].max()) == 0.0
    )
    lone = [
        EFFECTS["lidar.crosstalk"](probability=0.05),
        EFFECTS["lidar.isolated_return_filter"](probability=1.0, radius_m=0.01),
    ]
    both = rain(effects=lone)
    found = states(both.chain, state, both.chain.draw(state, seed=1))
    spurious = found["crosstalk"].returns.range_m != found["detection"].returns.range_m
    assert float((found["isolated_return_filter"].returns.kind[spurious] == LOST).double().mean()) > 0.95


def test_every_return_mode_takes_every_effect() -> None:
    for mode in ("strongest", "first", "last", "dual"):
        sensor: Lidar = scan_sensor(return_mode=mode)
        chain_of = LidarRain(Rain(5.0), sensor, effects=[active(name) for name in EFFECTS if name.startswith("lidar.")])
        result = chain_of.run(cloud(), chain_of.draw(cloud(), seed=1), directions=directions())
        assert isinstance(result.points, Tensor)
        assert bool(torch.isfinite(result.points).all())
        assert (result.second is not None) == (mode == "dual")
        noise = own_noise(chain_of.draw(cloud(), seed=1), "range_noise")
        assert noise["jitter"].shape == (3, BEAMS)


def test_a_single_column_is_no_neighbour_of_itself() -> None:
    state = LidarRain(Rain(0.0), scan_sensor(elevations_deg=None, columns=None)).state_of(cloud(1)[:, :4], None)
    range_m = torch.tensor([10.0, 10.3, 30.0, 50.0])[None, :, None]
    kind = torch.zeros_like(range_m, dtype=torch.int8)
    state = state.changed(grid=(4, 1), range_m=range_m, signal=torch.ones_like(range_m), kind=kind)
    after = EFFECTS["lidar.isolated_return_filter"](probability=1.0)(state, {"removal": torch.zeros(1, 4)})
    assert after.returns.kind.flatten().tolist() == [OBJECT, OBJECT, LOST, LOST]
