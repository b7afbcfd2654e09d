"""What each effect of radar does, against slow calculations of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from tests.radar.effects.radar_effect_scene import SENSOR, TARGETS, begin, detections, known, rain, states
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.core.random import draw_variates
from torchweather.sensors import Radar
from torchweather.stages import EFFECTS, PointKind, RadarState, VolumeClutter, WetRadome, with_effects
from torchweather.transforms import RadarAttenuation

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
Array = NDArray[Any]
THERE = detections()[..., :3].norm(dim=-1) > 0
# Sums of powers near -120 dB in single precision: two steps of 8e-6.
DB_STEPS = 2e-5


@pytest.fixture(scope="module")
def transform() -> RadarAttenuation:
    return rain()


def around(transform: RadarAttenuation, name: str, seed: int = 3, **values: Any) -> tuple[RadarState, RadarState]:
    """The state in front of an effect and behind it."""
    effect = EFFECTS[name](**values)
    chain = with_effects(transform.chain, [effect])
    state = begin(transform)
    found = states(chain, state, chain.draw(state, seed=seed))
    return found[effect.after], found[effect.default_name]


def outcomes(transform: RadarAttenuation, name: str, seed: int = 3, **values: Any) -> tuple[RadarState, RadarState]:
    """What comes out of the chain without the effect and with it."""
    chain = with_effects(transform.chain, [EFFECTS[name](**values)])
    state = begin(transform)
    noise = chain.draw(state, seed=seed)
    return transform.chain(state, noise), chain(state, noise)


def target_kinds(state: RadarState) -> Tensor:
    return state.returns.kind[:, :TARGETS]


def points_of(state: RadarState) -> Tensor:
    assert state.returns.points is not None
    return state.returns.points


# ---- cover, path, antenna, targets -------------------------------------------------------------------------------


def test_a_wet_cover_costs_every_target_the_same_and_leaves_the_floor(transform: RadarAttenuation) -> None:
    before, after = around(transform, "radar.wet_radome", loss_db=1.0, film_db=0.7, film_exponent=0.5, drying_min=10.0)
    # The rain of now against a film of 200 mm/h 5 minutes and one of 300 mm/h 30 minutes old.
    films = [50.0**0.5, 200.0**0.5 * math.exp(-0.5), 300.0**0.5 * math.exp(-3.0)]
    wanted = 1.0 + 0.7 * max(films)
    assert films.index(max(films)) == 1
    np.testing.assert_allclose((before.returns.gain_db - after.returns.gain_db)[THERE].numpy(), wanted, rtol=1e-5)
    assert (after.returns.gain_db[~THERE] == 0).all()
    np.testing.assert_allclose(after.receiver.cover_loss_db.numpy(), wanted, rtol=1e-6)
    assert torch.equal(after.floor_db, before.floor_db)


def test_in_steady_rain_the_cover_is_that_of_the_stage_of_the_plain_chain() -> None:
    points = detections()
    values = {"loss_db": 0.4, "film_db": 0.6, "film_exponent": 1.0 / 3.0}
    plain = rain(**{f"radome_{key}": value for key, value in values.items()})
    effect = rain(effects=[EFFECTS["radar.wet_radome"](**values)])
    noise = plain.draw(points, seed=2)
    assert isinstance(plain.chain.stages["wet_radome"], WetRadome)
    torch.testing.assert_close(effect(points, noise), plain(points, noise), rtol=0.0, atol=DB_STEPS)


def test_after_the_rain_the_cover_dries_and_in_snow_it_is_dry() -> None:
    effect = EFFECTS["radar.wet_radome"](film_db=1.0, film_exponent=0.5, drying_min=10.0)
    for weather in (Rain(0.0), Snow(2.0), Fog(mor_m=100.0)):
        dry = RadarAttenuation(weather, SENSOR).run(detections(), seed_noise(RadarAttenuation(weather, SENSOR)))
        wet = RadarAttenuation(weather, SENSOR, effects=[effect])
        for minutes in (0.0, 10.0, 25.0):
            past = {"past_rain_mm_per_h": torch.tensor([16.0]), "past_rain_min": torch.tensor([minutes])}
            found = wet.run(detections(), seed_noise(wet), **past)
            more_db = (found.attenuation_db - dry.attenuation_db)[THERE]  # type: ignore[operator]
            np.testing.assert_allclose(more_db.numpy(), 4.0 * math.exp(-minutes / 10.0), atol=1e-5)
        no_past = wet.run(detections(), seed_noise(wet))
        assert torch.equal(no_past.points, dry.points)  # type: ignore[arg-type]


def seed_noise(transform: RadarAttenuation) -> dict[str, Tensor]:
    return transform.draw(detections(), seed=2)


def test_three_times_the_path_loss_is_two_more_in_range(transform: RadarAttenuation) -> None:
    """P.838 at 77 GHz, horizontal, 50 mm/h: 18.76 dB/km (PHYSICS.md 6.5)."""
    before, after = around(transform, "radar.path_loss_scale", factor=3.0)
    wanted = -3.0 * 2.0 * 18.76e-3 * before.scene.range_m.double().numpy()
    np.testing.assert_allclose(after.returns.gain_db.numpy(), wanted, rtol=3e-4)
    np.testing.assert_allclose(after.air.attenuation_db_per_km.numpy(), 3.0 * 18.76, rtol=3e-4)


def pattern_db(azimuth: Array, elevation: Array) -> Array:
    """Gaussian pattern of one element below its peak: 3.01 dB at half the beamwidth, 30 dB at most."""
    across = np.degrees(azimuth) / SENSOR.azimuth_beamwidth_deg
    up = np.degrees(elevation) / SENSOR.elevation_beamwidth_deg
    return -np.minimum(40.0 * math.log10(2.0) * (across**2 + up**2), 30.0)


@pytest.mark.parametrize("angle_rad", [0.1, -0.4])
def test_a_turned_pattern_gains_where_it_points(transform: RadarAttenuation, angle_rad: float) -> None:
    before, after = around(transform, "radar.pattern_tilt", angle_rad=angle_rad)
    x, y, z = detections()[..., :3].double().numpy()[THERE.numpy()].T
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    wanted = 2.0 * (pattern_db(azimuth - angle_rad, elevation) - pattern_db(azimuth, elevation))
    got = (after.returns.gain_db - before.returns.gain_db)[THERE].numpy()
    np.testing.assert_allclose(got, wanted, atol=2e-5)
    assert wanted[azimuth * angle_rad > angle_rad**2].min() > 0
    assert (after.returns.gain_db[~THERE] == 0).all()


def test_a_pattern_turned_away_from_what_is_behind_the_radar_changes_nothing_there() -> None:
    points = torch.tensor([[-20.0, 0.5, 0.0, 0.0, -60.0, 10.0], [-20.0, -0.5, 0.0, 0.0, -60.0, 10.0]])
    tilted = RadarAttenuation(Rain(0.0), SENSOR, effects=[EFFECTS["radar.pattern_tilt"](angle_rad=0.4)])
    assert torch.equal(tilted(points), points)


def test_clutter_turns_with_the_pattern() -> None:
    plain, tilted = (
        rain(clutter=True, effects=[EFFECTS["radar.pattern_tilt"](angle_rad=angle)]) for angle in (0.0, 0.3)
    )
    noise = seed_noise(plain)
    one, other = (t(detections(), noise)[:, TARGETS:] for t in (plain, tilted))
    there = one[..., :3].norm(dim=-1) > 0
    assert int(there.sum()) > 50
    turned = torch.atan2(other[..., 1], other[..., 0]) - torch.atan2(one[..., 1], one[..., 0])
    torch.testing.assert_close(turned[there], torch.full_like(turned[there], 0.3), atol=1e-5, rtol=0.0)
    assert torch.equal(one[..., 4:], other[..., 4:])


def test_wet_targets_gain_by_their_class(transform: RadarAttenuation) -> None:
    before, after = around(transform, "radar.wet_rcs", gain_db=[2.0, -3.0, 0.5])
    by_class = {-1: 0.0, 0: 2.0, 1: -3.0, 2: 0.5, 3: 0.0}  # unknown, three given, one beyond
    gains = [by_class[int(one)] for one in known()["target_class"]]
    wanted = torch.where(THERE, torch.tensor(gains), 0.0)
    torch.testing.assert_close(after.returns.gain_db - before.returns.gain_db, wanted, atol=1e-5, rtol=0.0)


def test_one_gain_counts_for_all_known_classes_and_each_sample_may_have_its_own(transform: RadarAttenuation) -> None:
    of_known = (known()["target_class"] >= 0) & THERE
    before, after = around(transform, "radar.wet_rcs", gain_db=4.0)
    torch.testing.assert_close(
        after.returns.gain_db - before.returns.gain_db, 4.0 * of_known.float(), atol=1e-5, rtol=0.0
    )
    _, each = around(transform, "radar.wet_rcs", gain_db=torch.tensor([[1.0], [0.0], [2.0]]).expand(3, 4))
    wanted = torch.tensor([[1.0], [0.0], [2.0]]) * of_known
    torch.testing.assert_close(each.returns.gain_db - before.returns.gain_db, wanted, atol=1e-5, rtol=0.0)


def many(transform: RadarAttenuation, name: str, samples: int, **values: Any) -> RadarState:
    """The first sample's targets, many times: the state behind the effect."""
    effect = EFFECTS[name](**values)
    state = transform.state_of(detections()[:1].expand(samples, -1, -1))
    noise = draw_variates(range(samples), effect.default_name, effect.variates(), state.sizes)
    before = transform.chain.stages["path_attenuation"](state, {})
    own = {key.partition(".")[2]: torch.from_numpy(value) for key, value in noise.items()}
    after: RadarState = effect(before, own)
    return after.changed(gain_db=after.returns.gain_db - before.returns.gain_db)


def test_powers_fluctuate_with_the_spread_asked_for_about_the_same_mean_power(transform: RadarAttenuation) -> None:
    std_db = 2.0
    gain_db = (
        many(transform, "radar.fluctuation", 2000, log_std_db=std_db).returns.gain_db[:, THERE[0]].double().numpy()
    )
    number = gain_db.size
    assert gain_db.std() == pytest.approx(std_db, rel=4.0 / math.sqrt(2 * number))
    assert gain_db.mean() == pytest.approx(-math.log(10.0) / 20.0 * std_db**2, abs=4.0 * std_db / math.sqrt(number))
    power = 10.0 ** (0.1 * gain_db)
    assert power.mean() == pytest.approx(1.0, abs=4.0 * power.std() / math.sqrt(number))
    # From frame to frame and from target to target by themselves.
    between = np.corrcoef(gain_db.T)
    assert np.abs(between[~np.eye(len(between), dtype=bool)]).max() < 6.0 / math.sqrt(2000)


# ---- floor, threshold, list --------------------------------------------------------------------------------------


def test_a_higher_floor_lowers_snrs_and_leaves_powers(transform: RadarAttenuation) -> None:
    plain, higher = outcomes(transform, "radar.noise_floor", shift_db=6.0)
    assert plain.returns.snr_db is not None
    assert higher.returns.snr_db is not None
    torch.testing.assert_close(higher.returns.snr_db[THERE], plain.returns.snr_db[THERE] - 6.0, atol=1e-5, rtol=0.0)
    assert torch.equal(points_of(higher)[..., 3:], points_of(plain)[..., 3:])
    np.testing.assert_allclose((higher.floor_db - plain.floor_db).numpy(), 6.0, atol=1e-5)
    check_threshold(plain, higher, 6.0)


def test_a_higher_threshold_loses_what_lies_within_it_and_leaves_snrs_and_powers(transform: RadarAttenuation) -> None:
    plain, higher = outcomes(transform, "radar.cfar_shift", shift_db=6.0)
    assert plain.returns.snr_db is not None
    assert higher.returns.snr_db is not None
    assert torch.equal(higher.returns.snr_db, plain.returns.snr_db)
    assert torch.equal(points_of(higher)[..., 3:], points_of(plain)[..., 3:])
    assert torch.equal(higher.floor_db, plain.floor_db)
    check_threshold(plain, higher, 6.0)


def check_threshold(plain: RadarState, higher: RadarState, shift_db: float) -> None:
    """Lost is what exceeds the detection SNR by less than the shift, and nothing else."""
    assert plain.returns.snr_db is not None
    margin_db = plain.returns.snr_db.double().numpy() - SENSOR.detection_snr_db
    wanted = np.where((margin_db >= shift_db) & THERE.numpy(), OBJECT, LOST)
    assert np.array_equal(higher.returns.kind.numpy(), wanted)
    newly = (plain.returns.kind == OBJECT) & (higher.returns.kind == LOST)
    assert int(newly.sum()) > 10
    assert (points_of(higher)[..., :3][newly] == 0).all()


@pytest.mark.parametrize("name", ["radar.noise_floor", "radar.cfar_shift"])
def test_a_lower_level_keeps_what_the_weather_takes(name: str) -> None:
    """A target 1 dB over the threshold, 60 m away in 18.76 dB/km: 2.25 dB, 1.25 too many."""
    level = SENSOR.floor_db + SENSOR.detection_snr_db
    points = torch.tensor([[60.0, 0.0, 0.0, 0.0, level + 1.0, 10.0]])
    for shift_db, kind in ((0.0, LOST), (-1.2, LOST), (-1.3, OBJECT)):
        found = rain(effects=[EFFECTS[name](shift_db=shift_db)]).run(points)
        assert isinstance(found.kind, Tensor)
        assert found.kind[:1].tolist() == [kind]  # a lower threshold lists noise behind it


@pytest.mark.parametrize("name", ["radar.noise_floor", "radar.cfar_shift"])
def test_clutter_below_the_new_level_is_not_listed(name: str) -> None:
    """Light rain, of which not even all rows are needed."""
    counts = []
    for level_db in (0.0, 9.0):
        effects = [EFFECTS[name](shift_db=level_db)]
        transform = RadarAttenuation(Rain(0.3), SENSOR, clutter=True, clutter_points=2000, effects=effects)
        result = transform.run(detections(), seed_noise(transform))
        assert isinstance(result.kind, Tensor)
        power = result.points[:, TARGETS:, 4][result.kind[:, TARGETS:] == PARTICLE]  # type: ignore[call-overload]
        assert float(power.min()) >= SENSOR.floor_db + SENSOR.detection_snr_db + level_db - 1e-4
        counts.append(len(power))
    assert counts[0] > counts[1] > 0


@pytest.mark.parametrize("up_db", [0.0, 2.0])
def test_a_lower_threshold_lists_the_cells_whose_noise_exceeds_it(transform: RadarAttenuation, up_db: float) -> None:
    """Against noise of every cell, of exponential power: how many exceed the new threshold and not the old, and by how
    much. It is the SNR that counts, however high the floor is."""
    samples, shift_db = 400, -3.0
    low, high = (10.0 ** (0.1 * (SENSOR.detection_snr_db + shift)) for shift in (shift_db, 0.0))
    cells = SENSOR.samples * SENSOR.chirps
    state = transform.state_of(detections()[:1].expand(samples, -1, -1))
    state = transform.chain.stages["path_attenuation"](state, {}).changed(noise_shift_db=torch.full((samples,), up_db))
    effect = EFFECTS["radar.cfar_shift"](shift_db=shift_db)
    noise = draw_variates(range(samples), effect.default_name, effect.variates(), state.sizes)
    after: RadarState = effect(state, {key.partition(".")[2]: torch.from_numpy(value) for key, value in noise.items()})
    assert after.returns.clutter is not None
    assert after.returns.clutter_valid is not None
    rng = np.random.default_rng(0)
    exceeding = np.concatenate([one[(one > low) & (one < high)] for one in rng.exponential(size=(samples, cells))])
    counts = after.returns.clutter_valid.sum(1).numpy()
    expected = len(exceeding) / samples
    assert 5.0 < expected < 50.0
    assert counts.mean() == pytest.approx(expected, abs=4.0 * math.sqrt(2.0 * expected / samples))
    assert counts.var() == pytest.approx(expected, rel=4.0 * math.sqrt(2.0 / samples))  # Poisson
    rows = after.returns.clutter[after.returns.clutter_valid].double().numpy()
    snr = 10.0 ** (0.1 * (rows[:, 4] - SENSOR.floor_db - up_db))
    assert snr.min() >= low * (1.0 - 1e-5)
    # Of exponential law behind the threshold: a mean of 1 over it.
    assert (snr - low).mean() == pytest.approx((exceeding - low).mean(), abs=5.0 / math.sqrt(len(rows)))
    range_m = np.linalg.norm(rows[:, :3], axis=1)
    assert range_m.max() <= SENSOR.max_range_m * (1.0 + 1e-6)
    assert range_m.mean() == pytest.approx(0.5 * SENSOR.max_range_m, rel=4.0 / math.sqrt(3.0 * len(rows)))
    assert np.abs(rows[:, 3]).max() <= SENSOR.max_speed_m_per_s
    assert (after.returns.clutter[~after.returns.clutter_valid] == 0).all()


def test_a_higher_threshold_lists_nothing_and_draws_nothing(transform: RadarAttenuation) -> None:
    effect = EFFECTS["radar.cfar_shift"](shift_db=2.0)
    assert effect.variates() == ()
    assert many(transform, "radar.cfar_shift", 2, shift_db=2.0).returns.clutter is None
    state = transform.chain.stages["path_attenuation"](begin(transform), {})
    with pytest.raises(ValueError, match="it was built with a threshold that is no lower and so draws nothing"):
        torch.func.functional_call(effect, {"shift_db": torch.tensor(-2.0)}, (state, {}))


def test_noise_that_is_listed_is_told_from_what_a_target_reports(transform: RadarAttenuation) -> None:
    """Through the whole chain: rows behind the targets', of the kind PARTICLE."""
    plain, lower = outcomes(transform, "radar.cfar_shift", shift_db=-4.0)
    assert (lower.returns.kind[:, TARGETS:] == PARTICLE).sum(1).min() > 20
    assert torch.equal(points_of(lower)[:, :TARGETS, 3:], points_of(plain)[..., 3:])


def test_an_interferer_raises_the_floor_of_as_many_frames_as_asked_for(transform: RadarAttenuation) -> None:
    found = many(transform, "radar.interference", 4000, probability=0.2, level_db=7.0)
    assert found.receiver.noise_shift_db is not None
    levels = found.receiver.noise_shift_db.double().numpy()
    assert set(np.unique(levels)) == {0.0, 7.0}
    assert (levels > 0).mean() == pytest.approx(0.2, abs=4.0 * math.sqrt(0.16 / 4000))
    assert (found.returns.gain_db == 0).all()


def test_floors_add_up(transform: RadarAttenuation) -> None:
    effects = [EFFECTS["radar.noise_floor"](shift_db=2.0), EFFECTS["radar.interference"](probability=1.0, level_db=3.0)]
    chain = with_effects(transform.chain, effects)
    state = begin(transform)
    found = chain(state, chain.draw(state, seed=1))
    np.testing.assert_allclose((found.floor_db - state.receiver.noise_floor_db).numpy(), 5.0, atol=1e-5)


def test_speeds_of_targets_scatter_by_what_is_asked_for(transform: RadarAttenuation) -> None:
    found = many(transform, "radar.doppler_spread", 1000, std_m_per_s=0.4)
    error = (found.scene.points_in[..., 3] - detections()[0, :, 3])[:, THERE[0]].double().numpy()
    assert error.mean() == pytest.approx(0.0, abs=4.0 * 0.4 / math.sqrt(error.size))
    assert error.std() == pytest.approx(0.4, rel=4.0 / math.sqrt(2 * error.size))
    others = [0, 1, 2, 4, 5, 6]
    assert torch.equal(found.scene.points_in[..., others], detections()[:1, :, others].expand(1000, -1, -1))
    assert torch.equal(found.scene.points_in[:, ~THERE[0]], detections()[:1, ~THERE[0]].expand(1000, -1, -1))


def test_speeds_of_clutter_scatter_more_by_as_much() -> None:
    """Variances add: that of the plain clutter, row by row the same place, and the one asked for."""
    speeds = []
    for std in (0.0, 2.0):
        transform = rain(clutter=True, clutter_points=400, effects=[EFFECTS["radar.doppler_spread"](std_m_per_s=std)])
        points = torch.zeros(20, 1, 6)
        result = transform.run(points, transform.draw(points, seed=4))
        assert isinstance(result.kind, Tensor)
        speeds.append(result.points[result.kind == PARTICLE][:, 3].double().numpy())  # type: ignore[index]
    number = len(speeds[0])
    assert number == len(speeds[1]) > 1000
    wanted = math.sqrt(speeds[0].var() + 4.0)
    assert wanted < 0.4 * SENSOR.max_speed_m_per_s  # hardly any is folded
    assert speeds[1].std() == pytest.approx(wanted, rel=4.0 / math.sqrt(2 * number))


def test_a_single_list_takes_the_number_of_its_frame() -> None:
    moved = rain(effects=[EFFECTS["radar.range_migration"](m_per_frame=-0.5)])
    points, number = detections()[0], torch.tensor(4.0)
    alone = moved.run(points, seed=2, frame_number=number)
    batched = moved.run(points[None], seed=torch.tensor([2]), frame_number=number[None])
    assert isinstance(alone.points, Tensor)
    assert isinstance(batched.points, Tensor)
    assert torch.equal(alone.points, batched.points[0])


def test_ranges_drift_by_the_frame_along_their_directions() -> None:
    effects = [
        EFFECTS["radar.range_migration"](m_per_frame=-0.5),
        EFFECTS["radar.multipath"](amplitude=0.8, delay_m=4.0),
    ]
    moved, plain = rain(effects=effects, clutter=True), rain(effects=effects[1:], clutter=True)
    noise = moved.draw(detections(), seed=2)
    one, other = (t.run(detections(), noise, **known()) for t in (plain, moved))
    frames = known()["frame_number"].tolist()
    assert isinstance(one.points, Tensor)
    assert isinstance(other.points, Tensor)
    assert isinstance(one.kind, Tensor)
    for sample, frame in enumerate(frames):
        for row in range(one.points.shape[1]):
            before, after = one.points[sample, row].double().numpy(), other.points[sample, row].double().numpy()
            if int(one.kind[sample, row]) == LOST:
                assert np.array_equal(before, after)
                continue
            range_m = np.linalg.norm(before[:3])
            wanted = before[:3] / range_m * max(range_m - 0.5 * frame, 0.0)
            np.testing.assert_allclose(after[:3], wanted, atol=1e-4)
            assert np.array_equal(before[3:], after[3:])
    assert torch.equal(one.kind, other.kind)  # type: ignore[arg-type]


@pytest.mark.parametrize("max_count", [1, 7, 25])
def test_a_full_list_holds_the_strongest(max_count: int) -> None:
    """Targets, ghosts and clutter sorted together by power."""
    others = [EFFECTS["radar.multipath"](amplitude=0.6, delay_m=3.0)]
    plain = rain(effects=others, clutter=True)
    limited = rain(effects=[*others, EFFECTS["radar.detection_limit"](max_count=max_count)], clutter=True)
    noise = limited.draw(detections(), seed=2)
    one, other = (t.run(detections(), noise) for t in (plain, limited))
    for sample in range(3):
        power, kind = one.points[sample, :, 4].numpy(), one.kind[sample].numpy()  # type: ignore[call-overload]
        found = np.flatnonzero(kind != LOST)
        strongest = found[np.argsort(-power[found])][:max_count]
        kept = np.flatnonzero(other.kind[sample].numpy() != LOST)
        assert np.array_equal(np.sort(strongest), kept)
        rows = other.points[sample].numpy()
        assert np.array_equal(rows[kept], one.points[sample].numpy()[kept])
        assert (np.delete(rows, kept, 0)[:, :3] == 0).all()
    assert len({int(one.kind[s, row]) for s in range(3) for row in np.flatnonzero(other.kind[s] != LOST)}) >= 1


# ---- echoes ------------------------------------------------------------------------------------------------------


def hann_response(bins: float) -> float:
    """Transform of a Hann window between two tones, from its samples."""
    size = 4096
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(size) + 0.5) / size)
    turned = window * np.exp(2j * np.pi * bins * (np.arange(size) + 0.5) / size)
    value = turned.sum() / window.sum() * np.exp(-1j * np.pi * bins)
    assert abs(value.imag) < 1e-6
    return float(value.real)


@pytest.mark.parametrize("delay_bins", [0.01, 0.5, 1.0, 1.5, 2.5])
def test_an_unresolved_second_path_makes_lobes(transform: RadarAttenuation, delay_bins: float) -> None:
    amplitude, delay_m = 0.6, delay_bins * SENSOR.range_resolution_m
    effect = EFFECTS["radar.multipath"](amplitude=amplitude, delay_m=delay_m)
    chain = with_effects(transform.chain, [effect])
    state = begin(transform)
    noise = chain.draw(state, seed=3)
    found = states(chain, state, noise)
    before, after = found["path_attenuation"], found["multipath"]
    second = amplitude * hann_response(delay_bins)
    phase = 2.0 * np.pi * noise["multipath.phase"].double().numpy()
    wanted = 20.0 * np.log10(np.abs(1.0 + second * np.exp(1j * phase)))
    got = (after.returns.gain_db - before.returns.gain_db).double().numpy()
    np.testing.assert_allclose(got[THERE.numpy()], wanted[THERE.numpy()], atol=2e-4)
    assert after.returns.clutter_valid is not None
    assert bool(after.returns.clutter_valid.any()) == (delay_bins > 2.0)


def test_ghosts_stand_behind_their_targets(transform: RadarAttenuation) -> None:
    amplitude, delay_m = 0.3, 5.0
    _, found = outcomes(transform, "radar.multipath", amplitude=amplitude, delay_m=delay_m)
    points, kind = points_of(found).double().numpy(), found.returns.kind.numpy()
    seen = 0
    for sample in range(3):
        for row in range(TARGETS):
            target = detections()[sample, row].double().numpy()
            ghost, ghost_kind = points[sample, TARGETS + row], kind[sample, TARGETS + row]
            range_m = np.linalg.norm(target[:3])
            # Its own way is 5 m longer out and back together with the target's: 18.76 dB/km (PHYSICS.md 6.5).
            power = points[sample, row, 4] + 20.0 * math.log10(amplitude) - 2.0 * 18.76e-3 * delay_m
            listed = range_m > 0 and power >= SENSOR.floor_db + SENSOR.detection_snr_db
            listed = listed and range_m + delay_m < SENSOR.max_range_m
            assert ghost_kind == (PARTICLE if listed else LOST)
            if not listed:
                assert (ghost == 0).all()
                continue
            seen += 1
            np.testing.assert_allclose(ghost[:3], target[:3] / range_m * (range_m + delay_m), atol=1e-4)
            assert ghost[3] == target[3]
            assert ghost[4] == pytest.approx(power, abs=1e-3)
            # What the radar equation makes of that power at that range, from the target's clear power and section.
            rcs = target[5] + power - target[4] + 40.0 * math.log10((range_m + delay_m) / range_m)
            assert ghost[5] == pytest.approx(rcs, abs=1e-3)
    assert seen > 20


def test_ghosts_stand_before_the_clutter_that_was_there_and_count_as_clutter_in_the_result() -> None:
    transform = rain(effects=[EFFECTS["radar.multipath"](amplitude=0.5, delay_m=4.0)], clutter=True, clutter_points=20)
    result = transform.run(detections(), seed_noise(transform))
    assert isinstance(result.source, Tensor)
    assert result.points.shape == (3, 2 * TARGETS + 20, 7)  # type: ignore[union-attr]
    assert (result.source[:, TARGETS:] == -1).all()


def test_the_weather_is_detected_as_the_plain_stage_does_it() -> None:
    """Share 1 of the effect and the clutter of the transform: the same draws, the same rows."""
    plain = RadarAttenuation(Rain(25.0), SENSOR, clutter=True, clutter_points=256, ego_speed_m_per_s=3.0)
    effect = RadarAttenuation(
        Rain(25.0), SENSOR, ego_speed_m_per_s=3.0, effects=[EFFECTS["radar.volume_clutter"](share=1.0)]
    )
    noise = effect.draw(detections(), seed=6)
    renamed = {
        key.replace("volume_clutter.rain_", "rain_clutter."): value for key, value in noise.items() if "snow" not in key
    }
    assert torch.equal(effect(detections(), noise), plain(detections(), renamed))


def test_clutter_is_near_falls_with_the_square_of_the_range_and_moves_as_drops_do() -> None:
    """Against the radar equation: the mean echo of a cell is the one of eta V, and counts follow from it.

    Of exponential law, the powers above the threshold T exceed it by the mean P(R) of the cell: R^-2.
    """
    sensor = replace(SENSOR, noise_figure_db=5.0)
    transform = RadarAttenuation(Rain(25.0), sensor, effects=[EFFECTS["radar.volume_clutter"](share=0.5)])
    points = torch.zeros(150, 1, 6)
    result = transform.run(points, transform.draw(points, seed=6))
    rows = result.points[result.kind == PARTICLE].double().numpy()  # type: ignore[index,union-attr]
    range_m = np.linalg.norm(rows[:, :3], axis=1)
    assert len(rows) > 3000
    assert np.median(range_m) < 15.0
    # Power beyond the pattern: what the radar equation calls the cell's cross section over R^2 (its volume).
    threshold = sensor.floor_db + sensor.detection_snr_db
    excess = 10.0 ** (0.1 * rows[:, 4]) - 10.0 ** (0.1 * threshold)
    off_db = rows[:, 4] - sensor.constant_db - rows[:, 5] + 40.0 * np.log10(range_m)
    loss_db = 2.0 * 11.41e-3 * range_m
    mean_at_1_m = excess / 10.0 ** (0.1 * (off_db - loss_db)) * range_m**2
    near, far = range_m < np.median(range_m), range_m >= np.median(range_m)
    error = mean_at_1_m[near].mean() * math.sqrt(2.0 / near.sum() + 2.0 / far.sum())
    assert mean_at_1_m[near].mean() == pytest.approx(mean_at_1_m[far].mean(), abs=4.0 * error)
    # Rain falls: what comes from above recedes downwards, from below approaches.
    up = rows[:, 2] / range_m
    slope = np.polyfit(up, rows[:, 3], 1)[0]
    assert -9.0 < slope < -2.0


def test_half_the_share_is_half_the_reflectivity() -> None:
    """The same draws with half of eta as with half of the share: that of the plain stage."""
    state = rain().chain.stages["path_attenuation"](begin(rain()), {})
    effect = EFFECTS["radar.volume_clutter"](share=torch.tensor([0.5, 2.0, 0.0]))
    stage = VolumeClutter(Rain(50.0), SENSOR, capacity=256)
    noise = effect.draw(state, seed=2)
    found = effect(state, noise)
    own = {key.removeprefix("rain_"): value for key, value in noise.items() if key.startswith("rain_")}
    for sample, share in enumerate((0.5, 2.0, 0.0)):
        stage.share.fill_(share)
        wanted = stage(state, own)
        assert wanted.returns.clutter is not None
        assert found.returns.clutter is not None
        torch.testing.assert_close(found.returns.clutter[sample], wanted.returns.clutter[sample], rtol=1e-5, atol=1e-5)
    assert not bool(found.returns.clutter_valid[2].any())


def test_fog_is_not_detected() -> None:
    foggy = RadarAttenuation(Fog(mor_m=50.0), SENSOR, effects=[EFFECTS["radar.volume_clutter"](share=1.0)])
    assert foggy(detections(), seed_noise(foggy)).shape == detections().shape


def test_a_radar_of_another_resolution_resolves_other_paths() -> None:
    coarse = Radar(bandwidth_mhz=150.0, noise_floor_db=-120.0)  # bins of 1 m
    points = torch.tensor([[20.0, 0.0, 0.0, 0.0, -60.0, 10.0]])
    for delay_m, ghosts in ((1.9, 0), (2.1, 1)):
        transform = RadarAttenuation(
            Rain(0.0), coarse, effects=[EFFECTS["radar.multipath"](amplitude=0.5, delay_m=delay_m)], lost="drop"
        )
        assert len(transform(points)) == 1 + ghosts
