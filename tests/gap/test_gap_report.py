"""The report of a result that was made by hand: what is unknown, the record, the map, the model's file."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Fog, Rain, Weather
from torchweather.camera.effects.optics import CameraDefocus
from torchweather.camera.effects.sensor import CameraExposureGain
from torchweather.core.errors import TorchweatherError
from torchweather.gap.gap_report import _at_bound, _standard_error, gap_report, read_model, write_model
from torchweather.gap.inference.candidate_fits import Candidate
from torchweather.gap.inference.clear_air import ClearAir
from torchweather.gap.inference.empirical_fit import Departures
from torchweather.gap.inference.held_out import HeldOut
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import Observation, SimulatedDistribution, Whitening
from torchweather.gap.inference.unknown import log_chance, without_means
from torchweather.gap.model_file import Additions
from torchweather.gap.statistics.frame_statistics import Group, Layout
from torchweather.gap.statistics.log_square import mean_log_square
from torchweather.lidar.effects.all import LidarRangeNoise, LidarWindowLoss
from torchweather.lidar.effects.empirical import Empirical
from torchweather.pipeline.effect import Parameter
from torchweather.report.gap_words import verdict_sentence
from torchweather.sensors import Camera, Lidar
from torchweather.stages import EFFECTS, with_effects
from torchweather.transforms import BayerRain, LidarWeather

Floats = NDArray[np.float64]

SECTORS = tuple(float(v) for v in np.linspace(-math.pi, math.pi, 17))
RATIO = Group("log_intensity_ratio", "azimuth_rad", "mean", SECTORS)
LOST = Group("lost_share", "range_m", "share", (0.0, 10.0, 20.0, 30.0, 1000.0))
LAYOUT = Layout((RATIO, LOST), ("log_intensity_ratio",), (1e-3,), ())
SIZE = LAYOUT.size  # 16, 4, between, slope
SLOPE = SIZE - 1
SD = 0.01
CONDITIONS: dict[str, tuple[Weather, float]] = {
    "c0": (Rain(10.0), 0.1),
    "c1": (Rain(20.0), 0.2),
    "c2": (Fog(100.0), 0.1),
}
WINDOW = LidarWindowLoss(loss_db=1.5)


def condition(name: str) -> Any:
    weather, rel_sd = CONDITIONS[name]
    return SimpleNamespace(id=name, weather=weather, rel_sd=rel_sd, scene="s0")


def base(mean: float = 0.5, whole: float = 1.0, **off: Floats) -> SimulatedDistribution:
    """The simulator: everything 0.5 with one scatter, with whole frames so many times that; correlations of 0.3 between
    neighbours."""
    values = np.full(SIZE, mean)
    correlation = np.eye(SIZE) + 0.3 * (np.eye(SIZE, k=1) + np.eye(SIZE, k=-1))
    used = np.ones(SIZE, bool)
    ones = dict.fromkeys(CONDITIONS, np.ones(SIZE))
    return SimulatedDistribution(
        mean={name: values + off.get(name, np.zeros(SIZE)) for name in CONDITIONS},
        sd={name: np.full(SIZE, SD) for name in CONDITIONS},
        total={name: np.full(SIZE, whole * SD) for name in CONDITIONS},
        used=dict.fromkeys(CONDITIONS, used),
        whitening=Whitening(np.linalg.cholesky(correlation)),
        draws={name: np.tile(values, (4, 1)) for name in CONDITIONS},
        independent={},
        shared={},
        expected=ones,
        model=ones,
        event=ones,
        degrees_of_freedom=ones,
        told_by_clear=ones,
    )


def result(verdict: str, departure: Floats, left: Floats | None = None, whole: float = 1.0, **more: Any) -> Any:
    """A result whose conditions all depart from the simulation by ``departure``, of which ``left`` is not explained."""
    start = base(whole=whole)
    measured = [
        Observation(condition(name), start.mean[name] + departure, np.ones(SIZE, bool), 5) for name in CONDITIONS
    ]
    weight = np.full((5, LAYOUT.bins), 200.0)
    shared = {"fit": (), "holdout": (), "catalogue": ["lidar.window_loss"]}
    model = SimpleNamespace(layout=LAYOUT, measured=lambda _: SimpleNamespace(weight=weight), **shared)
    residual = departure if left is None else left
    whitened = np.concatenate([start.whitened(name, residual) for name in CONDITIONS])
    search = SimpleNamespace(
        model=model,
        measured=measured,
        start=start,
        origin=ParameterPoint(),
        simulated_frames=100,
        seed=0,
        catalogue_effects=lambda point: [EFFECTS[name](**values) for name, values in point.values.items()],
    )
    held = HeldOut(3.0, 1.0, 0.1, 9.0 * SIZE, p_value=0.0)
    given = {
        "verdict": verdict,
        "fit": None,
        "rounds": (),
        "global_test": SimpleNamespace(p_value=1e-9, misfit_null=np.array([60.0])),
        "before": held,
        "after": held,
        "left": whitened,
        "search": search,
        "seconds": 1.0,
        "clear": (ClearAir("s0", 0.4, "lost_share", "range_m", -1.2),),
    }
    return SimpleNamespace(**{**given, **more})


def ripple(amplitude: float) -> Floats:
    found = np.zeros(SIZE)
    middle = 0.5 * (np.array(SECTORS[1:]) + np.array(SECTORS[:-1]))
    found[:16] = amplitude * np.sin(2.0 * middle + 0.5)
    return found


def drift(size: float) -> Floats:
    found = np.zeros(SIZE)
    found[SLOPE] = size
    return found


def test_a_ripple_is_named_by_axis_curve_formula_and_stage() -> None:
    report = gap_report(result("unknown", ripple(0.05)), "ab" * 32, 3)
    one = report.to_dict()["unknown"]
    assert (one["statistic"], one["axis"]) == ("log_intensity_ratio", "azimuth_rad")
    loudest = int(np.argmin(np.abs(np.array(SECTORS) - one["from"])))
    assert (one["from"], one["to"]) == pytest.approx((SECTORS[loudest], SECTORS[loudest + 1]), abs=1e-5)
    assert abs(ripple(0.05)[loudest]) == pytest.approx(np.abs(ripple(0.05)).max())
    # The same departure in three conditions adds up as the root of three.
    assert one["z"] == pytest.approx(ripple(0.05)[loudest] / SD * math.sqrt(3.0), rel=1e-3)
    assert one["curve"]["unit"] == "ln(intensity ratio)"
    np.testing.assert_allclose(one["curve"]["value"], ripple(0.05)[:16], atol=1e-6)
    np.testing.assert_allclose(
        np.subtract(one["curve"]["high"], one["curve"]["value"]), 1.6449 * SD / math.sqrt(3), rtol=1e-3
    )
    assert one["formula"]["name"] == "sine"
    assert one["formula"]["parameters"]["times"] == 2.0
    assert one["why_not"] is None
    assert isinstance(report.empirical, Empirical)
    assert one["empirical"]["kind"] == "intensity"
    middles = torch.tensor([0.5 * (a + b) for a, b in itertools.pairwise(SECTORS)])
    np.testing.assert_allclose(report.empirical.curve(middles).numpy(), ripple(0.05)[:16], atol=1e-5)


def test_what_whole_frames_do_widens_a_curve_and_not_what_is_left_of_it() -> None:
    """What they do is a nuisance that was fitted: the rest stands out by the scatter without it."""
    given = result("unknown", ripple(0.05), whole=2.0)
    plain, found = (gap_report(one, "ab" * 32, 3).to_dict() for one in (result("unknown", ripple(0.05)), given))
    assert found["unknown"]["z"] == pytest.approx(plain["unknown"]["z"], rel=1e-6)
    curve = found["unknown"]["curve"]
    np.testing.assert_allclose(np.subtract(curve["high"], curve["value"]), 1.6449 * 2.0 * SD / math.sqrt(3), rtol=1e-3)
    # Departures that are shown are in units of all of it.
    (loudest,), (quieter,) = plain["where"], found["where"]
    assert quieter["z"] == pytest.approx(loudest["z"] / 2.0, rel=1e-5)


def test_what_the_nuisance_explains_is_not_what_is_unknown() -> None:
    """A shift of all intensities is louder, but explained; the drift over time is not, and no stage copies it."""
    departure = drift(0.2) + np.where(np.arange(SIZE) < 16, -0.9, 0.0)
    report = gap_report(result("unknown", departure, left=drift(0.2)), "ab" * 32, 3)
    one = report.to_dict()["unknown"]
    assert (one["statistic"], one["axis"]) == ("log_intensity_ratio", "time")
    assert one["empirical"] is None
    assert one["formula"] is None
    assert "changes from the first frame to the last" in one["why_not"]
    assert report.empirical is None
    assert one["curve"]["value"] == pytest.approx([0.2])


def test_of_two_departures_the_more_significant_counts_not_the_loudest_bin() -> None:
    """One bin of 7 standard deviations is less than sixteen of 4."""
    many = np.zeros(SIZE)
    many[:16] = np.where(np.arange(16) % 2, 0.04, -0.04)
    many[17] = 0.07
    assert gap_report(result("unknown", many), "ab" * 32, 3).to_dict()["unknown"]["statistic"] == "log_intensity_ratio"
    many[:16] /= 8.0
    assert gap_report(result("unknown", many), "ab" * 32, 3).to_dict()["unknown"]["statistic"] == "lost_share"


@pytest.mark.parametrize("clear", [None, 0.03])
def test_a_spread_that_a_ripple_makes_is_not_what_is_unknown(clear: float | None) -> None:
    """By the law of total variance; a spread of its own stays. Told as a logarithm, and as a mean logarithm of squares
    in units of clear air's."""
    kind = "spread" if clear is None else "mean"
    spread = Group("log_intensity_spread", "range_m", kind, (0.0, 10.0, 20.0))

    def entry(variance: float) -> float:
        if clear is None:
            return 0.5 * math.log(variance)
        return float(mean_log_square(np.array([math.sqrt(variance) / clear]))[0])

    units = {} if clear is None else {"log_intensity_spread": np.array([clear])}
    layout = Layout((RATIO, spread), (), (), ())
    mean = ripple(0.05)[:16]
    variance = 0.03**2
    for own in (0.0, 0.04**2):
        sd = np.array([[0.002] * 16 + [0.01, 0.01]])
        measured = np.concatenate([mean, [entry(variance + mean.var() + own)] * 2])[None]
        simulated = np.array([[0.0] * 16 + [entry(variance)] * 2])
        z = (measured - simulated) / sd
        used = np.ones_like(z, dtype=bool)
        found = Departures(layout, measured, simulated, sd, used, np.array([5]), np.full((1, 18), 100.0), units)
        less = without_means(found, z)
        np.testing.assert_array_equal(less[:, :16], z[:, :16])
        left = (entry(variance + own) - entry(variance)) / 0.01
        assert z[0, -1] > (40 if clear is None else 30)  # a mean logarithm of squares tells less of a ripple
        # The variance that the errors of the means add, 0.002^2, is taken off: 0.3 of a standard deviation.
        np.testing.assert_allclose(less[0, 16:], left, atol=0.4)


def test_bins_that_hold_too_little_are_null() -> None:
    given = result("unknown", ripple(0.05))
    for used in given.search.start.used.values():
        used[[0, 1, 3]] = False
    text = json.dumps(gap_report(given, "ab" * 32, 3).to_dict(), allow_nan=False)
    one = json.loads(text)["unknown"]
    assert [place for place, value in enumerate(one["curve"]["value"]) if value is None] == [0, 1, 3]
    assert [place for place, value in enumerate(one["formula"]["values"]) if value is None] == [0, 1]
    assert one["empirical"]["measured_from"] == pytest.approx(SECTORS[2], abs=1e-5)


@pytest.mark.parametrize("verdict", ["none", "named"])
def test_nothing_is_unknown_where_nothing_is_left(verdict: str) -> None:
    named = fitted() if verdict == "named" else None
    report = gap_report(result(verdict, ripple(0.01), **(named or {})), "ab" * 32, 3)
    assert report.to_dict()["unknown"] is None
    assert report.empirical is None


def fitted(**values: Any) -> dict[str, Any]:
    """A fit of window loss, which takes away what is uniform; a rival that is a pair with range noise."""
    uniform = np.where(np.arange(SIZE) < 16, -0.3, 0.0)
    point = ParameterPoint({"lidar.window_loss": {"loss_db": 1.5}}, {"c0": 0.05, "c1": -0.1, "c2": 0.1})
    fit = SimpleNamespace(
        point=point,
        base=base(**dict.fromkeys(CONDITIONS, uniform)),
        misfit=60.0,
        covariance=np.eye(1) * 0.01,
        names=(("lidar.window_loss", "loss_db"),),
    )
    rival = ParameterPoint({"lidar.range_noise": {"std_m": 0.1}, "lidar.threshold_shift": {"shift_db": 1.0}})
    other = SimpleNamespace(point=rival, base=base(), misfit=61.0, names=())
    best = Candidate("lidar.window_loss", fit, 100.0)
    second = Candidate("lidar.threshold_shift", other, 99.0)
    return {"fit": fit, "rounds": ((best, second),), **values}


def test_the_rest_is_what_is_left_with_what_was_named() -> None:
    uniform = np.where(np.arange(SIZE) < 16, -0.3, 0.0)
    given = result("named_and_rest", uniform + ripple(0.05), left=ripple(0.05), **fitted())
    report = gap_report(given, "ab" * 32, 3)
    np.testing.assert_allclose(report.to_dict()["unknown"]["curve"]["value"], ripple(0.05)[:16], atol=1e-6)
    assert [effect.id for effect in report.effects] == ["lidar.window_loss"]
    unnamed = gap_report(result("unknown", uniform + ripple(0.05), left=ripple(0.05), **fitted()), "ab" * 32, 3)
    # No effect is handed out then: the curve is from the model as it is.
    np.testing.assert_allclose(unnamed.to_dict()["unknown"]["curve"]["value"], ripple(0.05)[:16] - 0.3, atol=1e-6)
    assert unnamed.effects == ()


def test_both_effects_of_a_rival_pair_can_be_mistaken_for_it() -> None:
    report = gap_report(result("named", ripple(0.01), **fitted()), "ab" * 32, 3)
    (one,) = report.to_dict()["effects"]
    assert sorted(one["confusable_with"]) == ["lidar.range_noise", "lidar.threshold_shift"]


@pytest.mark.parametrize(("verdict", "right"), [("named", 0.95), ("named_and_rest", 0.8)])
def test_an_effect_that_was_found_in_a_pair_has_the_confidence_of_that_round(verdict: str, right: float) -> None:
    """The first round was led by another effect, which the pair replaced; no name is surer than names were right."""
    first = fitted()["rounds"]
    pair = ParameterPoint({"lidar.range_noise": {"std_m": 0.1}, "lidar.blind_zone": {"range_m": 2.0}})
    names = (("lidar.range_noise", "std_m"), ("lidar.blind_zone", "range_m"))
    fit = SimpleNamespace(point=pair, base=base(), misfit=50.0, covariance=np.eye(2) * 1e-4, names=names)
    best = Candidate("lidar.blind_zone", fit, 150.0)
    report = gap_report(result(verdict, ripple(0.01), fit=fit, rounds=(*first, (best,))), "ab" * 32, 3)
    assert [one["name"] for one in report.to_dict()["effects"]] == ["lidar.range_noise", "lidar.blind_zone"]
    assert [one["confidence"] for one in report.to_dict()["effects"]] == [right, right]


@pytest.mark.parametrize(
    ("identity", "value", "variance", "expected"),
    [
        (0.0, 3.0, 0.04, (1.5 * 0.2, 0.2 * 3.0, 0.01 * 2.0)),
        (0.0, -3.0, 0.0, (0.2 * 3.0, 0.01 * 2.0)),
        (1.0, 0.5, 0.01, (1.5 * 0.1, 0.2 * 0.5, 0.01 * 2.0)),  # a factor: half of it is gone
        (math.inf, 40.0, 1.0, (1.5, 0.2 * 40.0)),  # an extent
        (None, 3.0, 0.04, (1.5 * 0.2, 0.06 * 2.0)),  # a place has no strength
        (0.0, 0.0, -1e-9, (0.01 * 2.0,)),  # no worse than rounding
    ],
)
def test_the_form_of_an_effect_leaves_a_share_of_its_strength_open(
    identity: float | None, value: float, variance: float, expected: tuple[float, ...]
) -> None:
    declared = Parameter("it", "1", -10.0, 100.0, scale=2.0, identity=identity)
    assert _standard_error(declared, value, variance) == pytest.approx(math.hypot(*expected), rel=1e-12)


def test_a_width_is_a_matter_of_the_form_as_well() -> None:
    declared = Parameter("width_rad", "rad", 0.0, 6.0, scale=2.0, default=0.5)
    assert _standard_error(declared, 0.5, 0.04) == pytest.approx(math.hypot(1.5 * 0.2, 0.06 * 2.0, 0.2 * 0.5))


def test_an_interval_is_ninety_percent_of_that_error_inside_the_bounds() -> None:
    (one,) = gap_report(result("named", ripple(0.01), **fitted()), "ab" * 32, 3).to_dict()["effects"]
    (declared,) = LidarWindowLoss.arguments
    half = 1.6449 * _standard_error(declared, 1.5, 0.01)
    assert one["interval"]["loss_db"] == pytest.approx([1.5 - half, 1.5 + half], rel=1e-5)
    assert one["interval"]["loss_db"][0] > declared.low


@pytest.mark.parametrize(("loss_db", "end"), [(1.5, None), (30.0, "highest"), (29.99, "highest"), (0.0, None)])
def test_a_value_at_the_end_of_what_is_searched_is_said(loss_db: float, end: str | None) -> None:
    """The true one may lie beyond it; where the effect does nothing is no such end."""
    (declared,) = LidarWindowLoss.arguments
    assert (declared.low, declared.high, declared.identity) == (0.0, 30.0, 0.0)
    given = fitted()
    values = given["fit"].point.values["lidar.window_loss"]
    values["loss_db"] = loss_db
    report = gap_report(result("named", ripple(0.01), **given), "ab" * 32, 3)
    (one,) = report.to_dict()["effects"]
    assert one["at_bound"] == ({} if end is None else {"loss_db": end})
    assert ("the true one may be higher" in verdict_sentence(report.to_dict())) == (end is not None)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("lidar.last_return", {"probability": 1.0}),  # a share is whole
        ("lidar.sector_loss", {"azimuth_rad": 2.0 * math.pi}),  # where an angle begins again
        ("lidar.limited_extent", {"extent_m": 0.0}),  # no length is below 0
        ("lidar.limited_extent", {"extent_m": 12.0}),  # of endless values none is near the end
        ("lidar.intensity_compression", {"saturation": 40.0}),
    ],
)
def test_an_end_that_nothing_exceeds_is_no_end_of_the_search(effect: str, values: dict[str, float]) -> None:
    fit: Any = SimpleNamespace(names=tuple((effect, name) for name in values))
    found = result("named", ripple(0.01), **fitted())
    assert _at_bound(effect, fit, found, values) == {}


def test_the_record_moves_by_one_factor_and_by_each_condition() -> None:
    found = gap_report(result("named", ripple(0.01), **fitted()), "ab" * 32, 3).to_dict()["nuisance"]
    # Weights 100, 25, 100; more fog is less visibility.
    assert found["rate_factor"] == pytest.approx(math.exp((100 * 0.05 - 25 * 0.1 - 100 * 0.1) / 225), rel=1e-5)
    assert found["by_condition"] == pytest.approx(
        {"c0": math.exp(0.05), "c1": math.exp(-0.1), "c2": math.exp(0.1)}, rel=1e-5
    )
    assert gap_report(result("none", ripple(0.01)), "ab" * 32, 3).to_dict()["nuisance"]["rate_factor"] == 1.0


def test_the_map_holds_every_statistic_before_and_after() -> None:
    uniform = np.where(np.arange(SIZE) < 16, -0.3, 0.0)
    found = gap_report(result("named", uniform + drift(0.05), **fitted()), "ab" * 32, 3).residuals
    assert found is not None
    assert found.groups == tuple((group.statistic, group.axis) for group in LAYOUT.groups)
    assert found.after is not None
    np.testing.assert_allclose(found.before, np.tile([[30.0], [0.0], [0.0], [5.0]], (1, 3)), atol=1e-9)
    np.testing.assert_allclose(found.after, np.tile([[0.0], [0.0], [0.0], [5.0]], (1, 3)), atol=1e-9)


def test_responses_are_what_each_effect_changes_beside_the_measurement() -> None:
    uniform = np.where(np.arange(SIZE) < 16, -0.3, 0.0)
    found = gap_report(result("named", uniform, **fitted()), "ab" * 32, 3).responses
    measured, window, rival = (one for one in found if one.statistic == "log_intensity_ratio")
    assert (measured.effect, window.effect, rival.effect) == (None, "lidar.window_loss", "lidar.threshold_shift")
    np.testing.assert_allclose(measured.values, -30.0 * math.sqrt(3.0))
    np.testing.assert_allclose(window.values, measured.values)
    np.testing.assert_allclose(rival.values, 0.0)
    # 0.3 of a logarithm of an intensity are 1.303 dB.
    np.testing.assert_allclose(measured.natural, -3.0 / math.log(10.0))
    np.testing.assert_allclose(window.natural, measured.natural)
    assert measured.unit == "dB"


def test_a_curve_has_its_own_unit_beside_standard_deviations() -> None:
    uniform = np.where(np.arange(SIZE) < 16, -0.3, 0.0)
    report = gap_report(result("named", uniform, **fitted()), "ab" * 32, 3)
    curve = next(one for one in report.curves if one.statistic == "log_intensity_ratio")
    assert curve.natural is not None
    assert curve.natural.unit == "dB"
    np.testing.assert_allclose(curve.natural.before, -3.0 / math.log(10.0))
    np.testing.assert_allclose(curve.natural.after, 0.0, atol=1e-12)
    np.testing.assert_allclose(curve.natural.before / curve.natural.chance, curve.before)
    loudest = report.to_dict()["where"][0]
    assert (loudest["departure"], loudest["unit"]) == (pytest.approx(-1.30288, abs=1e-5), "dB")


def test_the_answer_holds_the_share_of_the_excess_that_is_left() -> None:
    before, after = HeldOut(3.0, 1.0, 0.1, 9.0, p_value=0.0), HeldOut(1.5, 1.0, 0.1, 2.0, p_value=0.0)
    found = gap_report(result("named", ripple(0.01), before=before, after=after, **fitted()), "ab" * 32, 3).to_dict()
    assert found["gap"]["excess_left"] == 0.25
    alike = HeldOut(1.05, 1.0, 0.1, 1.1, p_value=0.0)
    found = gap_report(result("none", ripple(0.01), before=alike, after=alike), "ab" * 32, 3).to_dict()
    assert found["gap"]["excess_left"] is None


def test_a_value_on_its_bound_lowers_the_confidence_of_its_partner() -> None:
    pair = ParameterPoint({"lidar.window_loss": {"loss_db": 30.0}, "lidar.blind_zone": {"range_m": 2.0}})
    names = (("lidar.window_loss", "loss_db"), ("lidar.blind_zone", "range_m"))
    fit = SimpleNamespace(point=pair, base=base(), misfit=50.0, covariance=np.eye(2) * 1e-4, names=names)
    best = Candidate("lidar.blind_zone", fit, 150.0)
    given = result("named", ripple(0.01), fit=fit, rounds=((best,),))
    loss, zone = gap_report(given, "ab" * 32, 3).to_dict()["effects"]
    assert (loss["at_bound"], zone["at_bound"]) == ({"loss_db": "highest"}, {})
    assert (loss["beside_bound"], zone["beside_bound"]) == ([], ["lidar.window_loss"])
    assert (loss["confidence"], zone["confidence"]) == (0.95, pytest.approx(0.8))


def test_candidates_of_later_rounds_are_listed_with_what_they_stand_beside() -> None:
    first = fitted()["rounds"]
    pair = ParameterPoint({"lidar.window_loss": {"loss_db": 1.5}, "lidar.blind_zone": {"range_m": 2.0}})
    fit = SimpleNamespace(point=pair, base=base(), misfit=50.0, covariance=np.eye(2) * 1e-4, names=())
    second = Candidate("lidar.blind_zone", fit, 150.0)
    given = result("named", ripple(0.01), **{**fitted(), "rounds": (*first, (second,))})
    (added,) = gap_report(given, "ab" * 32, 3).to_dict()["added"]
    assert added["beside"] == ["lidar.window_loss"]
    assert [(one["name"], one["weight"]) for one in added["candidates"]] == [("lidar.blind_zone", 1.0)]


def test_the_answer_says_where_it_comes_from() -> None:
    answer = gap_report(result("none", ripple(0.01)), "ab" * 32, 3).to_dict()
    assert answer["study_sha256"] == "ab" * 32
    assert answer["seed"] == 3
    assert answer["clear_air"] == [
        {"scene": "s0", "p_value": 0.4, "statistic": "lost_share", "axis": "range_m", "z": -1.2}
    ]
    assert answer["version"]


@pytest.mark.parametrize("total", [10.0, 1100.0, 1300.0, 1e5])
@pytest.mark.parametrize("degrees_of_freedom", [2, 16, 40])
def test_small_chances_are_told_apart_beyond_what_a_float_holds(total: float, degrees_of_freedom: int) -> None:
    """For an even number of degrees it is exp(-x) times the first terms of exp(x), x half the sum of squares."""
    half = total / 2.0
    terms = sum(half ** (k - degrees_of_freedom / 2 + 1) / math.factorial(k) for k in range(degrees_of_freedom // 2))
    wanted = math.log(terms) + (degrees_of_freedom / 2 - 1) * math.log(half) - half
    # Of the asymptote's terms two are kept; the third is (19 18 / 550^2) at most.
    assert log_chance(total, degrees_of_freedom) == pytest.approx(wanted, abs=2e-3)


# ---- the model and its file ----------------------------------------------------------------------------------------


EMPIRICAL = Empirical("intensity", "range_m", [5.0, 50.0], [0.2, -0.4], 2.0, 80.0)


def sensor() -> Lidar:
    return Lidar(wavelength_nm=905.0, range_at_10_percent_m=60.0)


def model() -> LidarWeather:
    return LidarWeather(Rain(10.0), sensor(), q_eff=1.5, effects=[LidarRangeNoise(std_m=0.05)])


def points() -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    place = 60.0 * torch.rand(2, 200, 3, generator=generator) - 30.0
    return torch.cat([place, torch.rand(2, 200, 1, generator=generator)], -1)


def test_applied_saved_and_loaded_it_simulates_the_same_bits(tmp_path: Path) -> None:
    write_model(tmp_path / "model.yaml", [WINDOW], EMPIRICAL)
    loaded = read_model(tmp_path / "model.yaml")
    assert [effect.to_dict() for effect in loaded] == [WINDOW.to_dict()]
    assert loaded.empirical is not None
    assert loaded.empirical.config() == EMPIRICAL.config()
    plain = model()
    repaired = loaded.apply(plain, empirical=True)
    by_hand = with_effects(plain.chain, [WINDOW]).insert(EMPIRICAL, before="to_points")
    assert repaired.chain.to_dict() == by_hand.to_dict()
    assert list(plain.chain.stages) == [name for name in by_hand.stages if name not in ("window_loss", "empirical")]
    noise = repaired.draw(points(), seed=4)
    state = plain.state_of(points())
    assert torch.equal(repaired(points(), noise), by_hand(state, noise).returns.points)
    without = loaded.apply(plain)
    assert "empirical" not in without.chain.stages
    assert not torch.equal(without(points(), noise), repaired(points(), noise))


def test_effects_go_beside_what_a_camera_was_built_with() -> None:
    camera = Camera.from_intrinsics(60.0, 60.0, 15.5, 11.5, 32, 24)
    options: dict[str, Any] = {"depth": 30.0, "airlight": 0.5, "ego_speed_m_per_s": 10.0}
    defocus, gain = CameraDefocus(radius_px=1.0), CameraExposureGain(factor=1.2)
    plain = BayerRain(Rain(20.0), camera, **options, effects=[defocus])
    repaired = Additions((gain,)).apply(plain)
    at_once = BayerRain(Rain(20.0), camera, **options, effects=[defocus, gain])
    assert repaired.chain.to_dict() == at_once.chain.to_dict()
    bayer = torch.rand(1, 24, 32, generator=torch.Generator().manual_seed(1))
    assert type(repaired) is BayerRain
    found, wanted, without = (one(bayer, noise=one.draw(bayer, seed=4)) for one in (repaired, at_once, plain))
    assert torch.equal(found, wanted)  # depth and all
    assert not torch.equal(found, without)


def test_a_chain_that_was_changed_by_hand_is_not_built_anew() -> None:
    changed = model()
    changed.chain = changed.chain.insert(EMPIRICAL, before="to_points")
    with pytest.raises(ValueError, match="the chain has the stages"):
        Additions((WINDOW,)).apply(changed)


def test_effects_of_a_file_go_into_a_transform_as_they_are(tmp_path: Path) -> None:
    write_model(tmp_path / "model.yaml", [WINDOW])
    found = read_model(tmp_path / "model.yaml")
    assert found.empirical is None
    assert "window_loss" in LidarWeather(Rain(1.0), sensor(), effects=found).chain.stages
    with pytest.raises(ValueError, match="there is no empirical stage"):
        found.apply(model(), empirical=True)


VALID: dict[str, Any] = {
    "format": "torchweather-model/1",
    "effects": [WINDOW.to_dict()],
    "empirical": EMPIRICAL.config(),
}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "format must be"),
        ("- 1", "format must be"),
        ("a: [", "expected YAML with a model written by GapReport.write"),
        ("!!python/object/apply:os.system [ls]", "expected YAML with a model written by GapReport.write"),
        (
            yaml.safe_dump({**VALID, "format": "torchweather-model/9"}),
            "format must be 'torchweather-model/1'",
        ),
        (yaml.safe_dump({**VALID, "effects": 3}), "effects must be a list of effects; got 3"),
        (yaml.safe_dump({**VALID, "effects": [3]}), r"effects\[0\]: .*values must be a mapping"),
        (yaml.safe_dump({**VALID, "effects": [{"effect": "lidar.no"}]}), r"effects\[0\]: .*effect must be one of"),
        (
            yaml.safe_dump({**VALID, "effects": [{"effect": "lidar.window_loss", "loss": 1}]}),
            r"effects\[0\]: .*loss_db",
        ),
        (
            yaml.safe_dump({**VALID, "empirical": [1]}),
            "empirical must be keys with values, the arguments of an Empirical stage",
        ),
        (yaml.safe_dump({**VALID, "empirical": {"kind": "intensity"}}), "empirical: .*missing"),
        (
            yaml.safe_dump({**VALID, "empirical": {**EMPIRICAL.config(), "kind": "x"}}),
            "empirical: .*kind must be one of",
        ),
        (yaml.safe_dump({**VALID, "empirical": {**EMPIRICAL.config(), "at": None}}), "empirical: "),
    ],
)
def test_a_broken_file_is_named(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(TorchweatherError, match=f"model.yaml: {said}"):
        read_model(tmp_path / "model.yaml")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        TorchweatherError, match=r"nowhere.yaml: no such file; expected YAML with a model written by GapReport.write"
    ):
        read_model(tmp_path / "nowhere.yaml")
