"""Radar frames: what became of each target against plain loops, what each effect moves, and what a search names."""

from __future__ import annotations

import itertools
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.gap.tiny_radar_study import CLASSES, EFFECTS, SENSOR, WEATHERS, tiny_radar_study
from torchweather.atmosphere.weather import Fog, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap import Study, find_gap
from torchweather.gap.gap_report import GapReport
from torchweather.gap.inference.effect_forms import is_another, tried_values
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.sensors.radar.fading import FADING_SPREAD_DB, chance_of_fading, shares_by_class
from torchweather.gap.sensors.radar.forms import MOST_STRUCK, multipath_form, wet_rcs_form
from torchweather.gap.sensors.radar.frames import GHOST_STEP, RadarFrames
from torchweather.gap.sensors.radar.scene import (
    FLICKERS,
    LEAST_LEVEL_SHARE,
    LEAST_SPREAD,
    MEASURED,
    PRIOR_DEGREES,
    SELDOM,
    detections_of,
    inverse_variance_weights,
    own_spread,
    radar_scene,
)
from torchweather.gap.sensors.radar.sums import (
    FLOOR_STEPS_DB,
    FLOOR_WEIGHT,
    GHOST_DELAY_M,
    SAME_DIRECTION_RAD,
    SAME_SPEED_M_PER_S,
    RadarSums,
    _at_one_delay,
)
from torchweather.gap.sensors.radar.systematics import ReceiverNoise
from torchweather.gap.statistics.frame_statistics import Pool, Reduced
from torchweather.gap.study.frames import Frames, FrameSource
from torchweather.gap.study.study import StudyScene
from torchweather.pipeline.effect import Effect
from torchweather.stages import RadarState
from torchweather.transforms import RadarAttenuation

NUMBER, CLEAR, FRAMES = 40, 4, 3
SEEDS = (11, 2**40 + 5, 17)


@pytest.fixture(scope="module")
def study() -> Study:
    effects = [EFFECTS["radar.multipath"](amplitude=0.4, delay_m=6.0), EFFECTS["radar.volume_clutter"](share=0.001)]
    return tiny_radar_study(effects, seed=3, number=NUMBER, clear=CLEAR, frames=FRAMES)


@pytest.fixture(scope="module")
def model(study: Study) -> RadarFrames:
    return RadarFrames(study)


def group(model: RadarFrames, frames: Reduced, statistic: str, axis: str, what: str = "value") -> Any:
    """Sums ``(F, bins)`` of one group."""
    for one, part in zip(model.layout.binned, model.layout.slices, strict=False):
        if (one.statistic, one.axis) == (statistic, axis):
            return getattr(frames, what)[:, part]
    raise AssertionError(f"no {statistic} along {axis}")


def assert_same(found: Reduced, expected: Reduced, tolerance: float = 0.0) -> None:
    for field in fields(Reduced):
        np.testing.assert_allclose(
            getattr(found, field.name), getattr(expected, field.name), rtol=tolerance, atol=tolerance
        )


# ---- what a frame is compared with -----------------------------------------------------------------------------------


def test_references_leave_one_clear_frame_out(study: Study, model: RadarFrames) -> None:
    power = np.stack([frame["power_db"] for frame in study.scenes["s0"].clear])
    for row in range(CLEAR):
        for target in range(NUMBER):
            others = [power[k, target] for k in range(CLEAR) if k != row and not math.isnan(power[k, target])]
            found = model.scenes["s0"].reference["power_db"][row, target]
            assert math.isnan(found) if not others else found == pytest.approx(sum(others) / len(others), abs=1e-9)


def test_spreads_are_drawn_towards_the_median_one(study: Study, model: RadarFrames) -> None:
    power = np.stack([frame["power_db"] for frame in study.scenes["s0"].clear])
    own = [power[~np.isnan(power[:, n]), n] for n in range(NUMBER)]
    median = np.median([values.var(ddof=1) for values in own if len(values) > 1])
    for n in range(NUMBER):
        others = np.delete(power[:, n], 1)
        values = others[~np.isnan(others)]
        squares = ((values - values.mean()) ** 2).sum() if len(values) else 0.0
        degrees = max(len(values) - 1, 0)
        wanted = (squares + PRIOR_DEGREES * median) / (degrees + PRIOR_DEGREES) + LEAST_SPREAD["power_db"] ** 2
        assert model.scenes["s0"].spread["power_db"][1, n] == pytest.approx(math.sqrt(wanted), rel=1e-9)


# ---- what became of each target --------------------------------------------------------------------------------------


def test_sums_of_targets_are_those_of_a_loop(study: Study, model: RadarFrames) -> None:
    condition, scene = model.fit[1], model.scenes["s0"]
    found = model.measured(condition)
    per_km = float(RadarAttenuation(WEATHERS[1], SENSOR).attenuation_db_per_km)
    edges = {one.axis: one.edges for one in model.layout.binned}
    clear_power = np.stack([frame["power_db"] for frame in study.scenes["s0"].clear])
    variance = [np.nanvar(one, ddof=1) for one in clear_power.T if np.isfinite(one).sum() > 1]
    typical_db = math.sqrt(float(np.median(variance)) + LEAST_SPREAD["power_db"] ** 2)
    snr_db = SENSOR.detection_snr_db
    shares = shares_by_class(
        clear_power - scene.clear.floor_db.mean(), snr_db, typical_db, scene.geometry["target_class"]
    )
    lever = (np.arange(FRAMES) - 1.0) / math.sqrt(2.0 / 3.0)
    weights_of = scene.level_weight["power_db"]
    for axis in ("range_m", "target_class", "azimuth_rad", "margin_db"):
        names = ("lost", "number", "gone", "flicker", "power", "weight")
        wanted = {name: np.zeros((FRAMES, len(edges[axis]) - 1)) for name in names}
        drift = np.zeros((FRAMES, 2))
        for k, frame in enumerate(condition.frames):
            row = k % CLEAR
            reference = {name: scene.reference[name][row] for name in ("power_db", "range_m")}
            for n in range(NUMBER):
                others = np.delete(clear_power[:, n], row)
                if np.isfinite(others).sum() < 2:  # of three
                    continue
                floor = np.delete(scene.clear.floor_db, row).mean()
                margin = np.nanmean(others) - floor - SENSOR.detection_snr_db
                steady = np.isfinite(others).all() and margin > FLICKERS * scene.spread["power_db"][row, n]
                steady &= bool(chance_of_fading(others[:, None] - floor, snr_db, typical_db, shares[n])[0] < SELDOM)
                own = {"margin_db": margin}.get(axis) or scene.geometry[axis][n]
                inner = edges[axis][1:-1]
                place = sum(own >= edge - 1e-9 for edge in inner)  # sums of dB in another order
                wanted["number"][k, place] += steady
                wanted["flicker"][k, place] += not steady
                if math.isnan(frame["power_db"][n]):
                    wanted["lost"][k, place] += steady
                    wanted["gone"][k, place] += not steady
                else:
                    weight = weights_of[row, n]
                    loss = 2e-3 * per_km * scene.geometry["range_m"][n]
                    wanted["power"][k, place] += weight * (frame["power_db"][n] + loss - reference["power_db"][n])
                    wanted["weight"][k, place] += weight
                    drift[k] += lever[k] ** 2, lever[k] * (frame["range_m"][n] - reference["range_m"][n])
        np.testing.assert_allclose(group(model, found, "lost_target_share", axis), wanted["lost"])
        np.testing.assert_allclose(group(model, found, "lost_target_share", axis, "weight"), wanted["number"])
        if axis in ("range_m", "margin_db"):
            np.testing.assert_allclose(group(model, found, "lost_flickering_share", axis), wanted["gone"])
            np.testing.assert_allclose(group(model, found, "lost_flickering_share", axis, "weight"), wanted["flicker"])
        # A bin holds as many targets as would tell its mean as well if all weighed the same.
        as_many = np.zeros((FRAMES, len(edges[axis]) - 1))
        for k in range(FRAMES):
            weights: list[list[float]] = [[] for _ in as_many[k]]
            for n in scene.counted[k].nonzero()[0]:
                own = scene.axes[axis][k, n]
                weights[sum(own >= edge - 1e-9 for edge in edges[axis][1:-1])].append(weights_of[k, n])
            as_many[k] = [sum(own) / max(sum(one**2 for one in own), 1e-300) for own in weights]
        values, weight = (group(model, found, "power_residual_db", axis, what) for what in ("value", "weight"))
        np.testing.assert_allclose(values, as_many * wanted["power"], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(weight, as_many * wanted["weight"], rtol=1e-6)
        np.testing.assert_allclose(group(model, found, "range_drift_m", "frame", "weight")[:, 0], drift[:, 0])
        np.testing.assert_allclose(group(model, found, "range_drift_m", "frame")[:, 0], drift[:, 1], atol=1e-9)


def test_spreads_are_about_the_target_s_own_mean_and_the_frame_s(study: Study, model: RadarFrames) -> None:
    condition, scene = model.fit[0], model.scenes["s0"]
    reduced = model.measured(condition)
    found = group(model, reduced, "speed_spread", "target_class")
    weight = group(model, reduced, "speed_spread", "target_class", "weight")
    speed = np.stack([frame["speed_m_per_s"] for frame in condition.frames])
    power = np.stack([frame["power_db"] for frame in condition.frames])
    for k in range(FRAMES):
        there = {n for n in range(NUMBER) if scene.counted[k, n] and math.isfinite(power[k, n])}
        with_ = {n: [j for j in range(FRAMES) if scene.counted[j, n] and math.isfinite(power[j, n])] for n in there}
        own = {n: speed[k, n] - speed[with_[n], n].mean() for n in there}
        weight_of = scene.level_weight["speed_m_per_s"][k]
        common = sum(weight_of[n] * value for n, value in own.items()) / sum(weight_of[n] for n in own)
        wanted, degrees = np.zeros(CLASSES), np.zeros(CLASSES)
        for n in there:
            number = len(with_[n])
            scatter = (own[n] - common) ** 2 * number / max(number - 1, 1)
            place = int(scene.geometry["target_class"][n])
            free = 1 - 1 / number
            degrees[place] += free
            wanted[place] += free * math.log1p(scatter / scene.spread["speed_m_per_s"][k, n] ** 2)
        np.testing.assert_allclose(found[k], wanted, rtol=1e-9)
        np.testing.assert_allclose(weight[k], degrees, rtol=1e-9)


def test_what_all_targets_share_in_a_frame_is_read_from_the_quiet_ones() -> None:
    rng = np.random.default_rng(3)
    own_db = np.repeat([0.02, 0.3, 5.0], [10, 20, 30])  # of quiet, of usual and of fluctuating targets
    shared_db = 0.1 * rng.standard_normal((8, 1))
    power_db = shared_db + own_db * rng.standard_normal((8, 60))
    power_db[2, 3] = np.nan
    weights = inverse_variance_weights(power_db, 0.05, np.broadcast_to(-own_db, (8, 60)))
    assert weights.shape == (8, 60)
    quiet, usual, fluctuating = (weights[:, part].mean() for part in (slice(10), slice(10, 30), slice(30, 60)))
    assert quiet > 10.0 * usual > 500.0 * fluctuating
    for row, weight in enumerate(weights):
        others = np.delete(power_db, row, 0)
        there = ~np.isnan(others)
        apart = np.where(there, others - np.nanmean(others, 0), 0.0)
        level = (weight * apart).sum(1) / (weight * there).sum(1)
        true = np.delete(shared_db, row, 0)[:, 0]
        # Ten targets of 0.02 dB know it to 0.006 dB; equal weights of all would know it to 0.5 dB.
        assert np.abs(level - (true - true.mean())).max() < 0.03


def test_a_single_other_frame_tells_no_spread_of_a_target_but_its_class_may() -> None:
    power_db = np.array([[20.0, 21.0, 30.0], [20.6, 21.2, 30.4]])
    median = np.median([0.3**2, 0.1**2, 0.2**2]) * 2.0 + 0.05**2
    fluctuates = np.broadcast_to([0.0, 0.5, 1.0], (2, 3))
    weights = inverse_variance_weights(power_db, 0.05, np.ones((2, 3)), fluctuates)
    wanted = [median, 0.5 * median + 0.5 * FADING_SPREAD_DB**2, FADING_SPREAD_DB**2]
    np.testing.assert_allclose(1.0 / weights, np.broadcast_to(wanted, (2, 3)), rtol=1e-9)
    np.testing.assert_allclose(inverse_variance_weights(power_db, 0.05, np.ones((2, 3))), 1.0 / median, rtol=1e-9)


def test_a_target_that_one_clear_frame_has_tells_of_losses_alone() -> None:
    model = RadarFrames(tiny_radar_study(seed=9, number=NUMBER, clear=2, frames=2))
    scene, frames = model.scenes["s0"], model.fit[0].frames
    once = (~np.isnan(scene.clear.power_db)).sum(0) == 1
    assert once.any()
    assert not (scene.known & once).any()
    found = detections_of(list(frames))
    moved = replace(found, **{name: getattr(found, name) + np.where(once, 9.0, 0.0) for name in MEASURED})
    lost = replace(found, **{name: np.where(once, np.nan, getattr(found, name)) for name in MEASURED})
    row, lever = np.array([0, 1]), np.array([-1.0, 1.0])
    as_it_is, as_moved, as_lost = (model._sums["s0"](one, row, np.zeros(NUMBER), lever) for one in (found, moved, lost))
    for name in ("power_residual_db", "speed_residual_m_per_s", "range_error_m"):
        of_values = [group(model, one, name, "range_m") for one in (as_it_is, as_moved)]
        np.testing.assert_array_equal(*of_values)
    flickers = [group(model, one, "lost_flickering_share", "range_m").sum() for one in (as_it_is, as_lost)]
    assert flickers[0] < flickers[1]


def test_targets_that_one_other_frame_has_weigh_nothing() -> None:
    power_db = np.array([[20.0, np.nan], [20.5, 30.0], [np.nan, 30.5]])
    weights = inverse_variance_weights(power_db, 0.05, np.full((3, 2), 20.0))
    assert np.isfinite(weights).all()
    assert (weights > 0).tolist() == [[False, True], [False, False], [True, False]]


def test_fluctuating_targets_weigh_what_their_law_says_however_alike_a_few_frames_are() -> None:
    rng = np.random.default_rng(8)
    power_db = 10.0 * np.log10(rng.exponential(size=(8, 200)))
    power_db[:, 0] = 0.3 * rng.standard_normal(8)  # alike by chance
    weights = inverse_variance_weights(power_db, 0.05, np.zeros((8, 200)), np.ones((8, 200)))
    quiet = FADING_SPREAD_DB**2 * (1.0 + LEAST_LEVEL_SHARE) + 0.05**2 / 12.0
    np.testing.assert_allclose(weights, 1.0 / quiet, rtol=1e-9)
    # The law's own spread, drawn.
    drawn = 10.0 * np.log10(rng.exponential(size=200_000))
    assert drawn.std() == pytest.approx(FADING_SPREAD_DB, rel=0.01)


def test_a_mean_of_powers_is_known_as_well_as_the_inverse_variances_allow() -> None:
    """Of 100 targets, steady ones of 13 to 45 dB and 30 that fluctuate, 100 recordings: the mean scatters by no more
    than 1.25 of what the true variances give, is not off by more than noise, and equal weights lose by far."""
    rng = np.random.default_rng(5)
    mean_db, moves = rng.uniform(13.0, 45.0, 100), np.arange(100) < 30

    def recorded(frames: int) -> NDArray[np.float64]:
        power = np.where(moves, rng.exponential(size=(frames, 100)), 1.0) * 10.0 ** (0.1 * mean_db)
        noise = rng.standard_normal((2, frames, 100)) / math.sqrt(2.0)
        snr_db = 10.0 * np.log10((np.sqrt(power) + noise[0]) ** 2 + noise[1] ** 2)
        return np.asarray(np.where(snr_db >= SENSOR.detection_snr_db, snr_db, np.nan) - 125.0)

    long = recorded(4000)
    true_variance, true_mean = np.nanvar(long, 0), np.nanmean(long, 0)
    departures: dict[str, list[float]] = {"own": [], "true": [], "equal": []}
    geometry = {
        "range_m": np.full(100, 20.0),
        "azimuth_rad": np.linspace(-0.5, 0.5, 100),
        "elevation_rad": np.linspace(-0.1, 0.1, 100),
        "speed_m_per_s": np.zeros(100),
        "target_class": np.zeros(100),
    }
    measured = {"range_m": geometry["range_m"], "speed_m_per_s": np.zeros(100)}
    for _ in range(100):
        clear: list[FrameSource] = [
            {**measured, "power_db": row, "noise_floor_db": np.array(-125.0)} for row in recorded(8)
        ]
        scene = radar_scene(StudyScene("s", Frames(clear, lambda frame, name: frame, "clear"), geometry), SENSOR)
        frame = recorded(1)[0]
        there = np.isfinite(frame) & scene.counted[0]
        apart = np.where(there, frame - true_mean, 0.0)
        for name, weight in (
            ("own", scene.level_weight["power_db"][0]),
            ("true", 1.0 / true_variance),
            ("equal", np.ones(100)),
        ):
            departures[name].append(float((weight * apart * there).sum() / (weight * there).sum()))
    spread = {name: float(np.std(values)) for name, values in departures.items()}
    assert spread["own"] < 1.25 * spread["true"]
    assert spread["own"] < 0.3 * spread["equal"]
    # Over 100 recordings a mean is known to a tenth of its scatter.
    assert abs(float(np.mean(departures["own"]))) < 4.0 * spread["own"] / math.sqrt(100.0)


def test_multipath_is_tried_from_the_ghost_of_the_strongest_target_on(model: RadarFrames) -> None:
    amplitudes = model.sizes["amplitude"]
    assert isinstance(amplitudes, list)
    margins = [scene.axes["margin_db"] for scene in model.scenes.values()]
    strongest = max(float(np.nanmax(one)) for one in margins)
    assert -strongest < 20.0 * math.log10(amplitudes[0]) < -strongest + 3.0
    assert amplitudes[-1] == pytest.approx(1.0)
    assert max(high / low for low, high in itertools.pairwise(amplitudes)) <= GHOST_STEP + 1e-9
    condition = model.fit[0]
    listed = []
    for amplitude in (0.5 * amplitudes[0], amplitudes[1]):
        effect = model.forms["radar.multipath"](amplitude=amplitude, delay_m=6.0)
        ghosts = group(model, model.simulated(condition, [effect], 0.0, range(12)), "ghost_count", "ghost_delay_m")
        listed.append(float(ghosts.sum()))
    assert listed[1] > listed[0]


def test_what_is_the_same_in_all_frames_is_no_fluctuation(study: Study, model: RadarFrames) -> None:
    condition = model.fit[0]
    frames = detections_of(list(condition.frames))
    ripple_db = np.random.default_rng(1).normal(0.0, 3.0, NUMBER)
    rows, none, lever = np.arange(FRAMES), np.zeros(NUMBER), np.zeros(FRAMES)
    plain = model.reduce("s0", frames, rows, none, lever, together=FRAMES)
    rippled = replace(frames, power_db=frames.power_db + ripple_db)
    found = model.reduce("s0", rippled, rows, none, lever, together=FRAMES)
    for axis in ("range_m", "target_class"):
        before, after = (group(model, one, "power_spread", axis) for one in (plain, found))
        # The frame's mean moves by the ripple of targets that not all frames have.
        np.testing.assert_allclose(after.sum(), before.sum(), rtol=0.05)
    moved = group(model, found, "power_residual_db", "range_m") - group(model, plain, "power_residual_db", "range_m")
    assert np.abs(moved).max() > 1.0


def test_the_own_mean_is_taken_over_frames_of_different_clear_frames(model: RadarFrames) -> None:
    condition = model.fit[0]
    seeds = tuple(range(2 * FRAMES))
    whole = group(model, model.simulated(condition, [], 0.0, seeds), "power_spread", "range_m")
    first = group(model, model.simulated(condition, [], 0.0, seeds[:FRAMES]), "power_spread", "range_m")
    np.testing.assert_allclose(whole[:FRAMES], first, rtol=1e-9)


def test_a_floor_fills_its_steps_one_after_the_other(model: RadarFrames) -> None:
    clear = model.scenes["s0"].clear
    higher = replace(clear, floor_db=model.scenes["s0"].reference_floor_db + 2.75)
    found = model.reduce("s0", higher, np.arange(CLEAR), np.zeros(NUMBER), np.zeros(CLEAR))
    filled = group(model, found, "noise_floor_share", "noise_floor_db") / FLOOR_WEIGHT
    steps = FLOOR_STEPS_DB
    for place in range(1, len(steps) - 2):
        low, high = steps[place - 1], steps[place + 2]
        wanted = min(max((2.75 - low) / (high - low), 0.0), 1.0)
        np.testing.assert_allclose(filled[:, place], wanted, atol=1e-9)
    assert ((filled > 0) & (filled < 1)).sum() == 3 * CLEAR


def test_further_detections_are_counted_by_range_and_ghosts_behind_their_targets(
    study: Study, model: RadarFrames
) -> None:
    condition, scene = model.fit[0], model.scenes["s0"]
    found = model.measured(condition)
    edges = next(one.edges for one in model.layout.binned if one.statistic == "clutter_count")
    ghosts = 0
    for k, frame in enumerate(condition.frames):
        counts = np.histogram(frame["clutter"][:, 0], edges)[0]
        np.testing.assert_array_equal(group(model, found, "clutter_count", "particle_range_m")[k], counts)
        own = 0
        for range_m, azimuth, elevation, speed, _, _ in frame["clutter"]:
            follows = [
                n
                for n in range(NUMBER)
                if np.isfinite(frame["power_db"][n])
                and range_m - frame["range_m"][n] >= 0.2
                and ((azimuth - scene.geometry["azimuth_rad"][n]) / SAME_DIRECTION_RAD) ** 2
                + ((elevation - scene.geometry["elevation_rad"][n]) / SAME_DIRECTION_RAD) ** 2
                + ((speed - frame["speed_m_per_s"][n]) / SAME_SPEED_M_PER_S) ** 2
                < 1.0
            ]
            own += bool(follows)
        assert group(model, found, "ghost_count", "ghost_delay_m")[k].sum() == pytest.approx(own)
        ghosts += own
    assert ghosts > 10


def test_a_ghost_is_held_against_the_nearest_target_in_direction_and_speed(model: RadarFrames) -> None:
    """Targets drawn together, so that several lie near a further detection; many of these are too far off to count."""
    scene, rng, number = model.scenes["s0"], np.random.default_rng(6), 400
    together = {name: 0.1 * scene.geometry[name] for name in ("azimuth_rad", "elevation_rad")}
    scene = replace(scene, geometry={**scene.geometry, **together})
    frame, target = np.sort(rng.integers(0, CLEAR, number)), rng.integers(0, NUMBER, number)
    angles = [
        scene.geometry[name][target] + 1.5 * SAME_DIRECTION_RAD * rng.normal(size=number)
        for name in ("azimuth_rad", "elevation_rad")
    ]
    speed = scene.clear.speed_m_per_s[frame, target] + 1.5 * SAME_SPEED_M_PER_S * rng.normal(size=number)
    range_m, power_db = rng.uniform(5.0, 150.0, number), rng.normal(-90.0, 5.0, number)
    clutter = np.stack([range_m, *angles, speed, power_db], 1)
    frames = replace(scene.clear, clutter=clutter, clutter_frame=frame)
    delay_m, fainter_db = RadarSums(scene, model.layout)._behind(frames)
    several = 0
    for m, (where, azimuth, elevation, fast, power) in enumerate(frames.clutter):
        k = frames.clutter_frame[m]
        off = (
            ((azimuth - scene.geometry["azimuth_rad"]) / SAME_DIRECTION_RAD) ** 2
            + ((elevation - scene.geometry["elevation_rad"]) / SAME_DIRECTION_RAD) ** 2
            + ((fast - frames.speed_m_per_s[k]) / SAME_SPEED_M_PER_S) ** 2
        )
        off[~(where - frames.range_m[k] >= 0.2)] = np.inf
        best = int(np.where(np.isnan(off), np.inf, off).argmin())
        several += int((off < 1.0).sum() > 1)
        if off[best] < 1.0:
            assert delay_m[m] == pytest.approx(where - frames.range_m[k, best])
            assert fainter_db[m] == pytest.approx(power - frames.power_db[k, best])
        else:
            assert np.isnan(delay_m[m])
            assert np.isnan(fainter_db[m])
    assert np.isfinite(delay_m).sum() > 20
    assert several > 3


@pytest.mark.parametrize(
    ("statistic", "known_to"), [("ghost_power_db", 1.0), ("log_ghost_delay", 0.1), ("clutter_snr_db", 1.0)]
)
def test_a_path_is_the_same_one_in_all_frames(model: RadarFrames, statistic: str, known_to: float) -> None:
    """However many frames there are, its power is known to 1 dB and its delay to a tenth."""
    found = model.measured(model.fit[0])
    pool = Pool(model.layout, found)
    means = model.layout.each(lambda one: (one.statistic, one.kind) == (statistic, "mean"))
    a_frame = group(model, found, statistic, "particle_range_m", "weight").mean(0)[: means.sum()]
    assert a_frame.max() > 3.0
    least = known_to / np.sqrt(np.maximum(a_frame, 1.0))
    np.testing.assert_allclose(pool.known_to(10_000)[means], least)


def test_a_detection_far_behind_a_target_by_chance_is_no_ghost_of_the_same_path() -> None:
    delays = np.array([2.4, 2.5, np.nan, 2.6, 103.0, 2.55, 0.9])
    assert _at_one_delay(delays).tolist() == [True, True, False, True, False, True, False]
    assert not _at_one_delay(np.full(3, np.nan)).any()
    assert _at_one_delay(np.zeros(0)).shape == (0,)


def test_portions_of_the_targets_add_up(model: RadarFrames) -> None:
    condition = model.fit[0]
    whole = model.simulated(condition, [], 0.1, SEEDS)
    apart = model.simulated(condition, [], 0.1, SEEDS, portions=16)
    for name in ("value", "square"):
        summed = getattr(apart, name).reshape(len(SEEDS), 16, -1).sum(1)
        np.testing.assert_allclose(summed, getattr(whole, name), atol=1e-9)
    assert apart.scalar.shape == (16 * len(SEEDS), len(model.layout.scalars))


# ---- what is simulated -----------------------------------------------------------------------------------------------


def test_simulated_frames_are_the_ready_made_chain_on_clear_frames(study: Study, model: RadarFrames) -> None:
    condition = model.fit[1]
    found = group(model, model.simulated(condition, [], 0.0, SEEDS), "lost_target_share", "target_class").sum(1)
    transform = RadarAttenuation(WEATHERS[1], replace(SENSOR, noise_floor_db=model.sensor.noise_floor_db))
    for k, seed in enumerate(SEEDS):
        clear = study.scenes["s0"].clear[seed % CLEAR]
        floor = float(clear["noise_floor_db"])
        loss = 2e-3 * float(transform.attenuation_db_per_km) * clear["range_m"]
        kept = clear["power_db"] - loss >= floor + SENSOR.detection_snr_db  # NaN is false
        assert found[k] == (model.scenes["s0"].steady[seed % CLEAR] & ~kept).sum()


def test_the_same_seeds_give_the_same_frames(model: RadarFrames) -> None:
    effect = EFFECTS["radar.fluctuation"](log_std_db=2.0)
    assert_same(
        model.simulated(model.fit[0], [effect], 0.0, SEEDS), model.simulated(model.fit[0], [effect], 0.0, SEEDS)
    )


def test_more_rain_than_recorded_loses_more_and_leaves_the_transform_as_it_was(model: RadarFrames) -> None:
    condition = model.fit[1]
    before = model.simulated(condition, [], 0.0, SEEDS)
    more = model.simulated(condition, [], 0.3, SEEDS)
    power = [group(model, one, "power_residual_db", "range_m").sum() for one in (before, more)]
    assert power[1] < power[0] - 1.0
    assert_same(model.simulated(condition, [], 0.0, SEEDS), before)


def test_ranges_drift_over_the_frames_of_the_condition(model: RadarFrames) -> None:
    effect = EFFECTS["radar.range_migration"](m_per_frame=0.5)
    found = model.simulated(model.fit[0], [effect], 0.0, [CLEAR * k for k in range(2 * FRAMES)])
    apart = group(model, found, "range_error_m", "range_m").sum(1)
    number = group(model, found, "range_error_m", "range_m", "weight").sum(1)
    base = model.simulated(model.fit[0], [], 0.0, [CLEAR * k for k in range(2 * FRAMES)])
    at_rest = group(model, base, "range_error_m", "range_m").sum(1) / number
    np.testing.assert_allclose(apart / number - at_rest, 0.5 * np.tile(np.arange(FRAMES), 2), atol=1e-4)


def test_interference_strikes_as_many_frames_as_its_probability_says(model: RadarFrames) -> None:
    seeds = list(range(12))
    one = EFFECTS["radar.interference"](probability=0.375, level_db=12.0)
    found = model.simulated(model.fit[0], [one], 0.0, seeds)
    step = FLOOR_STEPS_DB.index(5.0)  # full where a frame is struck
    struck = group(model, found, "noise_floor_share", "noise_floor_db")[:, step] / FLOOR_WEIGHT
    assert struck.sum() == pytest.approx(0.375 * 12, abs=1e-6)
    assert sorted(struck)[-4:] == [1.0] * 4
    assert sum(0.0 < value < 1.0 for value in struck) == 1


def test_an_interferer_that_strikes_every_frame_is_another_effect(model: RadarFrames) -> None:
    at = {"radar.interference": {"probability": MOST_STRUCK, "level_db": 4.0}}
    below = {"radar.interference": {"probability": 0.9, "level_db": 4.0}}
    assert is_another(model, at)
    assert not is_another(model, below)
    assert not is_another(model, {"radar.noise_floor": {"shift_db": 4.0}})


def test_a_noise_floor_that_rises_makes_targets_noisier(study: Study, model: RadarFrames) -> None:
    """By as much more as the floor rises, not only by what weather takes from the target."""
    condition, seeds = model.fit[0], list(range(40))
    higher = EFFECTS["radar.noise_floor"](shift_db=6.0)
    lower_threshold = EFFECTS["radar.cfar_shift"](shift_db=-6.0)
    spreads = []
    for effects in ([], [higher, lower_threshold]):
        stages = [*effects, *model.systematics(condition, {"noise": 1.0})]
        frames = model.simulated(condition, stages, 0.0, seeds)
        value, weight = (group(model, frames, "speed_spread", "margin_db", what).sum(0) for what in ("value", "weight"))
        spreads.append(value / weight)
    assert (spreads[1] > 1.5 * spreads[0]).all()  # of variances four times as large: log(1 + 4 u^2), about


def test_added_errors_are_those_of_each_target(study: Study, model: RadarFrames) -> None:
    speed = np.stack([frame["speed_m_per_s"] for frame in study.scenes["s0"].clear])
    found = own_spread(speed)
    for n in range(NUMBER):
        values = speed[~np.isnan(speed[:, n]), n]
        if len(values) > 1:
            assert found[n] == pytest.approx(values.std(ddof=1), rel=1e-9)
    some = [values.var(ddof=1) for values in (one[~np.isnan(one)] for one in speed.T) if len(values) > 1]
    alone = np.flatnonzero(np.isfinite(speed).sum(0) < 2)
    np.testing.assert_allclose(found[alone], math.sqrt(float(np.median(some))), rtol=1e-9)


# ---- few frames ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("clear", "frames", "spreads", "drift"), [(2, 3, False, True), (3, 2, True, False)])
def test_what_few_frames_do_not_tell_is_not_looked_at(clear: int, frames: int, spreads: bool, drift: bool) -> None:
    """Of two clear frames one is left: it tells no spread. A slope takes three frames."""
    few = RadarFrames(tiny_radar_study([], seed=3, number=120, clear=clear, frames=frames))
    enough = Pool(few.layout, few.measured(few.fit[0])).enough(frames)
    statistic = few.layout.each(lambda one: one.statistic)
    for name, looked_at in (("power_spread", spreads), ("speed_spread", spreads), ("range_spread", spreads)):
        assert bool(enough[statistic == name].any()) == looked_at
    assert bool(enough[statistic == "range_drift_m"].any()) == drift
    assert enough[statistic == "power_residual_db"].sum() > 20


MOVED: list[tuple[str, dict[str, Any], str, str]] = [
    ("radar.wet_radome", {"loss_db": 2.0}, "power_residual_db", "range_m"),
    ("radar.volume_clutter", {"share": 0.01}, "clutter_count", "particle_range_m"),
    ("radar.noise_floor", {"shift_db": 2.0}, "noise_floor_share", "noise_floor_db"),
    ("radar.cfar_shift", {"shift_db": 4.0}, "lost_flickering_share", "margin_db"),
    ("radar.cfar_shift", {"shift_db": -4.0}, "clutter_count", "particle_range_m"),
    ("radar.path_loss_scale", {"factor": 2.0}, "power_residual_db", "range_m"),
    ("radar.multipath", {"amplitude": 0.4, "delay_m": 6.0}, "ghost_count", "ghost_delay_m"),
    ("radar.doppler_spread", {"std_m_per_s": 0.5}, "speed_spread", "range_m"),
    ("radar.wet_rcs", {"gain_db": [0.0, 3.0, -3.0]}, "power_residual_db", "target_class"),
    ("radar.interference", {"probability": 0.5, "level_db": 10.0}, "noise_floor_share", "noise_floor_db"),
    ("radar.range_migration", {"m_per_frame": 0.1}, "range_drift_m", "frame"),
    ("radar.pattern_tilt", {"angle_rad": 0.1}, "power_residual_db", "azimuth_rad"),
    ("radar.fluctuation", {"log_std_db": 3.0}, "power_spread", "margin_db"),
    ("radar.detection_limit", {"max_count": 15.0}, "lost_target_share", "margin_db"),
]


@pytest.mark.parametrize(("name", "values", "statistic", "axis"), MOVED, ids=[f"{one[0]}-{one[2]}" for one in MOVED])
def test_every_effect_moves_its_statistic(
    model: RadarFrames, name: str, values: dict[str, Any], statistic: str, axis: str
) -> None:
    """By more than eight times the scatter of as many independent elements."""
    condition, seeds = model.fit[1], list(range(24))
    pools = [
        Pool(model.layout, model.simulated(condition, some, 0.0, seeds)) for some in ([], [EFFECTS[name](**values)])
    ]
    index = np.arange(24)[None]
    part = next(
        part
        for one, part in zip(model.layout.groups, model.layout.slices, strict=True)
        if (one.statistic, one.axis) == (statistic, axis)
    )
    change = (pools[1].vectors(index) - pools[0].vectors(index))[0, part]
    least = np.hypot(pools[0].independent_scatter(24), pools[0].known_to(24))[part]
    # Of what is no sum over bins neither is stated: a change of its own size.
    assert (np.abs(change) / np.where(least > 0, least, 0.1)).max() > 8.0


def test_the_catalogue_is_all_that_is_moved(model: RadarFrames) -> None:
    assert list(dict.fromkeys(one[0] for one in MOVED)) == model.catalogue


# ---- what is left open -----------------------------------------------------------------------------------------------


def state(power_db: float, loss_db: float, number: int) -> RadarState:
    points = torch.zeros(1, number, 6, dtype=torch.float64)
    points[..., 0], points[..., 4] = 50.0, power_db
    found = RadarAttenuation(Fog(math.inf), SENSOR).state_of(points)
    return found.changed(
        gain_db=torch.full((1, number), -loss_db, dtype=torch.float64), noise_floor_db=torch.zeros(1).double()
    )


def test_a_weakened_target_is_as_noisy_as_one_that_was_weak_from_the_start() -> None:
    """Power of amplitude and noise: mean S + N, variance N^2 + 2 S N, of 20,000 draws known to 1 and 3 %."""
    snr, loss, number = 10.0**2.5, 10.0**1.5, 20_000
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(2, number)) * math.sqrt(0.5)
    clear = (math.sqrt(snr) + noise[0]) ** 2 + noise[1] ** 2
    before = state(0.0, 10.0 * math.log10(loss), number)
    points = before.scene.points_in.clone()
    points[0, :, 4] = torch.from_numpy(10.0 * np.log10(clear))
    before = before.changed(points_in=points)
    stage = ReceiverNoise(share=1.0)
    drawn = {k: v.double() for k, v in stage.draw(before, seed=torch.tensor([5])).items()}
    gain = stage(before, drawn).returns.gain_db[0].numpy()
    weak = clear * 10.0 ** (0.1 * gain)
    signal = snr / loss
    assert weak.mean() == pytest.approx(signal + 1.0, rel=0.01)
    assert weak.var() == pytest.approx(1.0 + 2.0 * signal, rel=0.05)


def test_ranges_and_speeds_grow_noisier_with_the_loss() -> None:
    """A variance of share (1 / g - 1) times that in clear air is added; the power's own noise is small at 60 dB."""
    before = state(60.0, 10.0, 5000)
    stage = ReceiverNoise(share=0.5).with_errors(torch.tensor(0.01), torch.tensor(0.03))
    drawn = {k: v.double() for k, v in stage.draw(before, seed=torch.tensor([5])).items()}
    points = stage(before, drawn).scene.points_in[0]
    for values, one in ((points[:, 0] - 50.0, 0.01), (points[:, 3], 0.03)):
        assert float(values.std()) == pytest.approx(one * math.sqrt(0.5 * 9.0), rel=0.05)


def test_without_a_strength_nothing_is_left_open(model: RadarFrames) -> None:
    condition = model.fit[0]
    assert set(model.open(condition)) == {"noise"}
    assert model.systematics(condition, {}) == []
    (noise,) = model.systematics(condition, {"noise": 1.5})
    assert noise.config() == {"share": 1.5}
    assert model.misplaced(condition) == 0.0


# ---- forms -----------------------------------------------------------------------------------------------------------


def test_cross_sections_by_class_are_those_of_the_catalogue(model: RadarFrames) -> None:
    form = wet_rcs_form([0, 1, 2])
    one, other = form(gain_db_1=3.0, gain_db_2=-2.0), EFFECTS["radar.wet_rcs"](gain_db=[0.0, 3.0, -2.0])
    assert one.to_dict() == other.to_dict()
    assert_same(*(model.simulated(model.fit[0], [some], 0.0, SEEDS) for some in (one, other)))


# ---- what is found ---------------------------------------------------------------------------------------------------


def named(report: GapReport) -> dict[str, dict[str, float]]:
    return {one["name"]: one["parameters"] for one in report.answer["effects"]}


@pytest.mark.parametrize("seed", [0, 3])
def test_radars_that_lose_what_the_rain_takes_lack_nothing(seed: int) -> None:
    found = find_gap(tiny_radar_study(seed=seed))
    assert found.verdict == "none"
    assert found.answer["p_value"] > 1e-3


# Beside those of the reduced bench (radar.wet_radome, noise_floor, doppler_spread, pattern_tilt).
# Without radar.cfar_shift: with as many targets in every frame it is not told from radar.detection_limit.
FOUND: list[tuple[Effect, dict[str, float]]] = [
    (EFFECTS["radar.wet_rcs"](gain_db=[0.0, -2.0, 1.0]), {"gain_db_0": 0.0, "gain_db_1": -2.0, "gain_db_2": 1.0}),
    (EFFECTS["radar.range_migration"](m_per_frame=0.02), {"m_per_frame": 0.02}),
    (EFFECTS["radar.detection_limit"](max_count=60.0), {"max_count": 60.0}),
]


@pytest.mark.parametrize(("effect", "parameters"), FOUND, ids=[one[0].id for one in FOUND])
def test_what_the_library_hides_is_found(effect: Effect, parameters: dict[str, float]) -> None:
    found = find_gap(tiny_radar_study([effect]))
    assert found.verdict == "named"
    assert list(named(found)) == [effect.id]
    intervals = found.answer["effects"][0]["interval"]
    for name, value in parameters.items():
        low, high = intervals[name]
        assert low <= value <= high
    gap = found.answer["gap"]
    assert gap["after"] < 1.2 * gap["floor"] < gap["before"]
    # What is handed out is the catalogue's, and goes into a model.
    (handed_out,) = found.effects
    repaired = RadarAttenuation(Rain(10.0), SENSOR, effects=found.effects)
    assert handed_out.to_dict()["effect"] == effect.id
    assert effect.default_name in repaired.chain.stages


def test_a_model_that_has_the_effect_lacks_nothing() -> None:
    effect = EFFECTS["radar.wet_radome"](loss_db=1.5)
    assert find_gap(tiny_radar_study([effect], number=48), model_effects=[effect]).verdict == "none"


def test_the_same_seed_gives_the_same_answer() -> None:
    made = tiny_radar_study([EFFECTS["radar.doppler_spread"](std_m_per_s=0.1)], number=24, clear=4, frames=3)
    some = ["radar.doppler_spread", "radar.wet_rcs"]
    one, other = (find_gap(made, seed=2, effects=some).to_dict() for _ in range(2))
    assert {**one, "seconds": 0} == {**other, "seconds": 0}


# ---- what cannot be answered -----------------------------------------------------------------------------------------


def changed(**more: Any) -> Study:
    """The study, its first scene and first condition changed."""
    made = tiny_radar_study(number=24, clear=3, frames=2)
    scene, conditions = made.scenes["s0"], made.conditions
    given = {"id": "s0", "clear": list(scene.clear), "geometry": scene.geometry, **more.pop("scene", {})}
    rows = [
        {"id": one.id, "scene": "s0", "weather": one.weather, "frames": list(one.frames), "split": one.split}
        for one in conditions
    ]
    rows[0] |= more.pop("condition", {})
    if "split" in more:
        rows = [{**row, "split": more["split"]} for row in rows]
    return Study.from_arrays(sensor=SENSOR, scenes=[given], conditions=rows)


def nothing(frame: Any) -> dict[str, Any]:
    gone = {name: np.full_like(frame[name], np.nan) for name in ("power_db", "range_m", "speed_m_per_s")}
    return {**frame, **gone}


def test_one_clear_frame_is_refused() -> None:
    made = tiny_radar_study(number=24, clear=3, frames=2)
    one = changed(scene={"clear": list(made.scenes["s0"].clear)[:1]})
    with pytest.raises(TorchweatherError, match=r"one clear frame \(Study.from_arrays: scenes\[0\].clear\)"):
        find_gap(one)


def test_clear_frames_without_a_detection_are_refused() -> None:
    made = tiny_radar_study(number=24, clear=3, frames=2)
    empty = [
        {**nothing(frame), "noise_floor_db": np.array(-100.0 + k)} for k, frame in enumerate(made.scenes["s0"].clear)
    ]
    with pytest.raises(TorchweatherError, match=r"not enough data to decide: The clear frames of s0 have no detection"):
        find_gap(changed(scene={"clear": empty}))


def test_targets_that_no_two_clear_frames_have_are_refused() -> None:
    made = tiny_radar_study(number=24, clear=3, frames=2)
    frames = []
    for k, frame in enumerate(made.scenes["s0"].clear):
        mine = np.arange(24) % 3 == k
        frames.append(
            {**frame, **{n: np.where(mine, frame[n], np.nan) for n in ("power_db", "range_m", "speed_m_per_s")}}
        )
    with pytest.raises(TorchweatherError, match=r"scenes\[0\].clear.*power_db: expected targets that two clear frames"):
        RadarFrames(changed(scene={"clear": frames}))


def test_nothing_held_out_is_refused() -> None:
    with pytest.raises(TorchweatherError, match=r"conditions\[\]\.split: expected conditions in weather to fit to"):
        find_gap(changed(split="fit"))


def test_too_few_targets_are_refused() -> None:
    with pytest.raises(TorchweatherError, match=r"scenes\[\]\.clear: power_db: expected targets"):
        find_gap(tiny_radar_study(number=2, clear=2, frames=1))


def test_a_frame_of_another_size_is_refused_with_its_key() -> None:
    made = tiny_radar_study(number=24, clear=3, frames=2)
    short = [{**frame, "power_db": frame["power_db"][:5]} for frame in made.conditions[0].frames]
    with pytest.raises(TorchweatherError, match=r"conditions\[0\].*power_db must have shape \(N,\)"):
        changed(condition={"frames": short})


def test_conditions_that_lost_everything_are_answered() -> None:
    """That all is lost can be compared: nothing is undefined, and something is missing."""
    made = tiny_radar_study(number=48, clear=4, frames=3)
    gone = [
        {**nothing(frame), "noise_floor_db": np.asarray(frame["noise_floor_db"]) + 0.001 * k}
        for k, frame in enumerate(made.conditions[0].frames)
    ]
    conditions = [
        {"id": one.id, "scene": "s0", "weather": one.weather, "split": one.split, "rel_sd": 0.05}
        | {"frames": gone if one.id == "c0" else list(one.frames)}
        for one in made.conditions
    ]
    scene = {"id": "s0", "clear": list(made.scenes["s0"].clear), "geometry": made.scenes["s0"].geometry}
    lossy = Study.from_arrays(sensor=SENSOR, scenes=[scene], conditions=conditions)
    assert find_gap(lossy, effects=["radar.wet_radome", "radar.path_loss_scale"]).verdict != "none"
    assert detections_of(gone).clutter.shape[1] == 5


def test_second_paths_are_tried_in_each_octave_of_their_delay() -> None:
    """Ghosts are counted in octaves of their delay: no derivative leads from one to the next."""
    tried = tried_values(multipath_form(0.01), "delay_m")
    octaves = np.digitize(tried, GHOST_DELAY_M)
    assert list(np.diff(octaves)) == [1] * (len(tried) - 1)
    for one, octave in zip(tried, octaves, strict=True):
        assert one == pytest.approx(math.sqrt(GHOST_DELAY_M[octave - 1] * GHOST_DELAY_M[octave]), rel=0.03)
    assert tried[0] < 1.6
    assert tried[-1] > 12.8


def test_a_path_loss_is_named_beside_another_effect() -> None:
    """A record that is off is a nuisance, with its stated error: what goes far beyond that is none."""
    hidden = [EFFECTS["radar.doppler_spread"](std_m_per_s=3.0), EFFECTS["radar.path_loss_scale"](factor=2.0)]
    report = find_gap(tiny_radar_study(hidden), effects=[one.id for one in hidden])
    assert report.verdict == "named"
    found = {one.id: one for one in report.effects}
    assert set(found) == {one.id for one in hidden}
    assert float(found["radar.path_loss_scale"].factor) == pytest.approx(2.0, rel=0.1)


def test_the_number_of_ghosts_is_known_to_half_of_it(model: RadarFrames) -> None:
    """As few targets have one above the threshold, in every frame; other numbers are known as ever."""
    search = SimulatorLikelihood(model, observations(model, model.fit), 0)
    effect = model.forms["radar.multipath"]
    values = {"amplitude": 0.4, "delay_m": 6.0}
    base = search.at(ParameterPoint({effect.id: values}))
    model.forms["radar.multipath"] = type("Exact", (effect,), {"unmodelled": ()})
    exact = search.at(ParameterPoint({effect.id: values}))
    model.forms["radar.multipath"] = effect
    ghosts = model.layout.each(lambda group: group.statistic in ("ghost_count", "clutter_count"))
    for name, sd in base.sd.items():
        change = base.mean[name] - search.start.mean[name]
        np.testing.assert_allclose(sd, np.hypot(exact.sd[name], 0.5 * np.where(ghosts, change, 0.0)), rtol=1e-9)
    moved = np.concatenate([(base.mean[name] - search.start.mean[name])[ghosts] for name in base.mean])
    assert np.abs(moved).max() > 1.0
