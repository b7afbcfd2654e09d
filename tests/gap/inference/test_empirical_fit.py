"""A departure in natural units, and the stage that copies it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.gap.tiny_study import SENSOR, tiny_study
from torchweather.gap.find import find_gap
from torchweather.gap.gap_report import read_model
from torchweather.gap.inference.empirical_fit import UNIT_OF, WHY_NOT, Departures, empirical_stage, natural_curve
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.sensors.camera.tails import share_groups
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.radar.sums import radar_layout
from torchweather.gap.statistics.frame_statistics import Group, Layout, Pool
from torchweather.gap.statistics.log_square import mean_log_square
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.empirical import Empirical

Floats = NDArray[np.float64]
Frame = dict[str, NDArray[np.float32]]

EDGES = (0.0, 10.0, 20.0, 1000.0)
SECTORS = tuple(float(v) for v in np.linspace(-math.pi, math.pi, 5))


def stable_share(share: Any) -> Floats:
    found: Floats = np.arcsin(np.sqrt(np.asarray(share, dtype=np.float64)))
    return found


CLEAR_SPREAD = {"range_residual_spread": 0.02, "log_intensity_spread": 0.03}  # m, of ln(intensity)


def departures(group: Group, measured: Any, simulated: Any, sd: Any, used: Any = True, frames: int = 5) -> Departures:
    """Of one group and as many conditions as ``measured`` has rows."""
    rows = np.atleast_2d(np.asarray(measured, dtype=np.float64))
    shape = rows.shape
    return Departures(
        layout=Layout((group,), (), (), ()),
        measured=rows,
        simulated=np.broadcast_to(np.asarray(simulated, dtype=np.float64), shape),
        sd=np.broadcast_to(np.asarray(sd, dtype=np.float64), shape),
        used=np.broadcast_to(np.asarray(used), shape),
        frames=np.full(len(rows), frames),
        weight=np.full(shape, 100.0),
        clear_spread={name: np.full(len(rows), sd) for name, sd in CLEAR_SPREAD.items()},
    )


def test_means_are_natural_and_averaged_by_their_weights() -> None:
    group = Group("log_intensity_ratio", "range_m", "mean", EDGES)
    curve = natural_curve(departures(group, [[0.3, 0.1, 0.0], [0.2, 0.1, 0.0]], 0.0, [[0.1], [0.2]]), group)
    assert curve.unit == "ln(intensity ratio)"
    np.testing.assert_allclose(curve.value, [(0.3 * 4 + 0.2) / 5, 0.1, 0.0])
    np.testing.assert_allclose(curve.sd, math.sqrt(1.0 / 125.0))  # weights 100 and 25
    np.testing.assert_allclose(curve.high - curve.low, 2 * 1.6449 * curve.sd)


def test_the_band_widens_where_conditions_disagree() -> None:
    group = Group("log_intensity_ratio", "range_m", "mean", EDGES)
    curve = natural_curve(departures(group, [[0.0], [1.0], [2.0]] * np.ones(3), 0.0, 0.1), group)
    np.testing.assert_allclose(curve.value, 1.0)
    np.testing.assert_allclose(curve.sd, 1.0 / math.sqrt(3))  # spread 1 of three


def test_a_bin_that_never_counts_is_not_known() -> None:
    group = Group("log_intensity_ratio", "range_m", "mean", EDGES)
    used = [[True, False, False], [False, True, False]]
    curve = natural_curve(departures(group, [[0.3, 9.0, 9.0], [9.0, 0.2, 9.0]], 0.0, 0.1, used), group)
    np.testing.assert_allclose(curve.value, [0.3, 0.2, np.nan])
    assert np.isnan(curve.sd).tolist() == [False, False, True]
    stage = empirical_stage(departures(group, [[0.3, 9.0, 9.0], [9.0, 0.2, 9.0]], 0.0, 0.1, used), group)
    assert isinstance(stage, Empirical)
    assert (stage.measured_from, stage.measured_to) == (0.0, 20.0)


@pytest.mark.parametrize(("measured", "value"), [(0.3, 0.2 / 0.9), (0.04, -0.06 / 0.1)])
def test_lost_shares_are_shares_and_a_stage_that_drops_or_gives_back(measured: float, value: float) -> None:
    group = Group("lost_share", "range_m", "share", EDGES)
    given = departures(group, stable_share([measured] * 3), stable_share(0.1), 0.02)
    curve = natural_curve(given, group)
    np.testing.assert_allclose(curve.value, measured - 0.1)
    # d sin^2 v = sin 2v dv = 2 sqrt(p (1 - p)) dv; of a difference to second order.
    np.testing.assert_allclose(curve.sd, 2 * math.sqrt(0.1 * 0.9) * 0.02, rtol=1e-3)
    stage = empirical_stage(given, group)
    assert isinstance(stage, Empirical)
    assert (stage.kind, stage.of, stage.axis) == ("loss", "object", "range_m")
    assert stage.config()["value"] == pytest.approx([value] * 3)
    assert stage.config()["at"] == [5.0, 15.0, 25.0]
    assert (stage.measured_from, stage.measured_to) == (0.0, 30.0)


def test_counts_are_returns_a_frame() -> None:
    group = Group("particles_before_objects", "particle_range_m", "count", EDGES)
    counts = np.array([40.0, 10.0, 5.0])
    curve = natural_curve(departures(group, np.sqrt(counts + 0.375), np.sqrt(5.0 + 0.375), 0.5), group)
    np.testing.assert_allclose(curve.value, (counts - 5.0) / 5)
    assert curve.unit == "returns per frame"


def test_spreads_are_standard_deviations_and_their_variances_subtract() -> None:
    group = Group("log_intensity_spread", "range_m", "mean", EDGES)
    clear, wider, less_noise = mean_log_square(np.array([0.03, 0.05, 0.01]) / 0.03).tolist()
    given = departures(group, [wider, clear, clear], clear, 0.01)
    # The way back is a table with 3e-5 of a spread.
    np.testing.assert_allclose(natural_curve(given, group).value, [0.02, 0.0, 0.0], atol=5e-6)
    stage = empirical_stage(given, group)
    assert isinstance(stage, Empirical)
    assert stage.kind == "intensity_noise"
    assert stage.config()["value"] == pytest.approx([0.04, 0.0, 0.0], abs=5e-6)
    less = departures(group, [less_noise] * 3, clear, 0.01)
    assert "scatters less" in str(empirical_stage(less, group))


@pytest.mark.parametrize("what", WHY_NOT)
def test_what_no_stage_can_copy_has_a_reason(what: str) -> None:
    kind = what if what in ("between", "slope", "persistence") else "share"
    group = Group(what, "range_m", kind, EDGES)
    found = empirical_stage(departures(group, [[0.5, 0.5, 0.5]], 0.3, 0.01), group)
    assert found == WHY_NOT[what]


def test_a_statistic_without_a_stage_says_so() -> None:
    group = Group("my_statistic", "range_m", "mean", EDGES)
    assert empirical_stage(departures(group, [[0.5, 0.5, 0.5]], 0.3, 0.01), group) == "no stage acts on my_statistic"


def test_a_full_circle_closes() -> None:
    group = Group("log_intensity_ratio", "azimuth_rad", "mean", SECTORS)
    stage = empirical_stage(departures(group, [[1.0, 2.0, 3.0, 4.0]], 0.0, 0.1), group)
    assert isinstance(stage, Empirical)
    ends = stage.curve(torch.tensor([-math.pi + 1e-6, math.pi - 1e-6]))
    torch.testing.assert_close(ends, torch.full((2,), 2.5), rtol=0.0, atol=1e-4)


# ---- from frames to a curve and back -------------------------------------------------------------------------------


def changed(study: Study, change: Callable[[Frame, Frame, np.random.Generator], Frame]) -> Study:
    """The study with its measured frames changed by plain numpy; ``change`` gets a frame and the first clear one."""
    rng = np.random.default_rng(8)
    clear = {name: np.asarray(values) for name, values in dict(study.scenes["s0"].clear[0]).items()}
    scenes = [
        {"id": "s0", "clear": list(study.scenes["s0"].clear), "geometry": dict(study.scenes["s0"].geometry)},
    ]
    conditions = [
        {
            "id": one.id,
            "scene": one.scene,
            "weather": one.weather,
            "rel_sd": one.rel_sd,
            "frames": [change({k: np.array(v) for k, v in dict(frame).items()}, clear, rng) for frame in one.frames],
            "split": one.split,
        }
        for one in study.conditions
    ]
    return Study.from_arrays(sensor=SENSOR, beams=dict(study.beams), scenes=scenes, conditions=conditions)


@pytest.fixture(scope="module")
def plain() -> Study:
    return tiny_study(seed=5, frames=24, clear=4)


def between(plain: Study, other: Study) -> Departures:
    """The changed frames beside the plain ones, with the scatter from frame to frame."""
    models = LidarFrames(plain), LidarFrames(other)
    conditions = [one for one in plain.fit if one.weather is not None]
    before, after = (
        observations(models[0], conditions),
        observations(models[1], [o for o in other.fit if o.weather is not None]),
    )
    sd = []
    for one in conditions:
        pool = Pool(models[0].layout, models[0].measured(one))
        halves = pool.vectors(np.stack([np.arange(len(pool)).reshape(2, -1)[half] for half in (0, 1)]))
        sd.append(np.abs(halves[0] - halves[1]) / 2 + 1e-3)
    return Departures(
        layout=models[0].layout,
        measured=np.stack([one.vector for one in after]),
        simulated=np.stack([one.vector for one in before]),
        sd=np.stack(sd),
        used=np.stack([one.enough & other.enough for one, other in zip(before, after, strict=True)]),
        frames=np.array([one.frames for one in after]),
        weight=np.stack([models[1].measured(one).weight.mean(0) for one in conditions]),
        clear_spread={
            name: np.array([models[0].clear_spread(one)[name] for one in conditions]) for name in CLEAR_SPREAD
        },
    )


def fitted(found: Departures, statistic: str, axis: str) -> Empirical:
    (group,) = [one for one in found.layout.groups if (one.statistic, one.axis) == (statistic, axis)]
    stage = empirical_stage(found, group)
    assert isinstance(stage, Empirical)
    return stage


def azimuth(study: Study) -> Floats:
    direction = np.asarray(study.beams["direction"], dtype=np.float64)
    found: Floats = np.arctan2(direction[..., 1], direction[..., 0])
    return found


def test_a_ripple_of_the_intensity_comes_back_as_a_stage(plain: Study) -> None:
    def ripple(x: Any) -> Any:
        return 0.1 * np.sin(2.0 * x + 0.5)

    def change(frame: Frame, clear: Frame, rng: np.random.Generator) -> Frame:
        return {**frame, "intensity": (frame["intensity"] * np.exp(ripple(azimuth(plain)))).astype(np.float32)}

    found = between(plain, changed(plain, change))
    stage = fitted(found, "log_intensity_ratio", "azimuth_rad")
    assert (stage.kind, stage.of) == ("intensity", "object")
    (edges,) = {group.edges for group in found.layout.groups if group.axis == "azimuth_rad"}
    columns = azimuth(plain)[0]
    sector = np.digitize(columns, edges) - 1
    wanted = [ripple(columns[sector == number]).mean() for number in range(16)]
    # 3 % of noise, 700 returns a sector.
    np.testing.assert_allclose(stage.config()["value"][1:-1], wanted, atol=5 * 0.03 / math.sqrt(700))


@pytest.mark.parametrize("between_m", [(2.5, 3.5), (10.0, 14.0)])
def test_added_returns_come_back_as_probability_and_places(plain: Study, between_m: tuple[float, float]) -> None:
    """A tenth of the beams reports something in front of its surface, where that is far enough."""

    def change(frame: Frame, clear: Frame, rng: np.random.Generator) -> Frame:
        place = rng.uniform(*between_m, clear["range_m"].shape)
        hit = (rng.random(place.shape) < 0.1) & (clear["range_m"] > place + 0.5)
        return {
            "range_m": np.where(hit, place, frame["range_m"]).astype(np.float32),
            "intensity": np.where(hit, 0.01, frame["intensity"]).astype(np.float32),
        }

    found = between(plain, changed(plain, change))
    for statistic, axis in (("particles_before_objects", "particle_range_m"), ("new_share", "azimuth_rad")):
        stage = fitted(found, statistic, axis)
        assert (stage.kind, stage.of) == ("returns", "object")
        place = int(np.argmax(stage.shares))
        assert stage.places_m[place : place + 2] == list(between_m)
        assert stage.shares[place] > 0.8 * sum(stage.shares)
        # 850 beams, 24 frames, two conditions: 0.0015 by chance; surfaces between 10 and 14 m count by their bin, a
        # few returns of snow were replaced.
        chance = float(np.mean(stage.config()["value"]))
        assert chance == pytest.approx(0.1, abs=0.012)
    removed = between(changed(plain, change), plain)
    (group,) = [one for one in removed.layout.groups if one.statistic == "particles_before_objects"]
    assert "fewer such returns than simulated" in str(empirical_stage(removed, group))


def test_lost_returns_come_back_as_a_probability(plain: Study) -> None:
    """Beyond 20 m a fifth of what was reported is lost."""

    def change(frame: Frame, clear: Frame, rng: np.random.Generator) -> Frame:
        lost = (rng.random(frame["range_m"].shape) < 0.2) & (clear["range_m"] > 23.0)
        return {name: np.where(lost, 0.0, values).astype(np.float32) for name, values in frame.items()}

    stage = fitted(between(plain, changed(plain, change)), "lost_share", "range_m")
    value = stage.curve(torch.tensor([10.0, 20.0, 26.0, 35.0])).numpy()
    # 60 beams a bin, 24 frames, two conditions: 0.008 by chance; snow stands in front of a few.
    np.testing.assert_allclose(value, [0.0, 0.0, 0.2, 0.2], atol=0.035)


def test_the_workflow_answers_unknown_with_axis_curve_and_stage(tmp_path: Path) -> None:
    """A ripple of the intensity, searched for among effects that do not touch intensities."""

    def change(frame: Frame, clear: Frame, rng: np.random.Generator) -> Frame:
        return {**frame, "intensity": (frame["intensity"] * np.exp(0.1 * np.sin(2.0 * angle))).astype(np.float32)}

    study = tiny_study(seed=3, clear=5, frames=4)
    angle = azimuth(study)
    report = find_gap(changed(study, change), effects=["lidar.blind_zone", "lidar.range_noise"])
    assert report.verdict == "unknown"
    one = report.to_dict()["unknown"]
    assert (one["statistic"], one["axis"]) == ("log_intensity_ratio", "azimuth_rad")
    assert one["empirical"]["kind"] == "intensity"
    report.write(tmp_path)
    assert json.loads((tmp_path / "gap.json").read_text(encoding="utf-8"))["unknown"] == one
    found = read_model(tmp_path / "model.yaml")
    assert len(found) == 0
    assert found.empirical is not None
    assert report.empirical is not None
    assert found.empirical.config() == report.empirical.config()


def test_shares_and_counts_of_radars_and_cameras_are_of_what_they_have() -> None:
    edges = dict.fromkeys(("range_m", "margin_db", "azimuth_rad", "elevation_rad", "target_class"), (0.0, 1.0, 2.0))
    for group in [*radar_layout(edges).binned, *share_groups()]:
        if group.kind in ("share", "count"):
            assert UNIT_OF[group.statistic].split()[-1] in ("targets", "frames", "cells", "frame")


def test_noise_of_the_range_comes_back_as_a_stage_in_metres(plain: Study) -> None:
    """Of 3 cm on every return. Some 500 beams a frame and 24 frames know each bin's to a few per cent."""

    def change(frame: Frame, clear: Frame, rng: np.random.Generator) -> Frame:
        noise = 0.03 * rng.normal(size=frame["range_m"].shape)
        return {**frame, "range_m": np.where(frame["range_m"] > 0, frame["range_m"] + noise, 0.0).astype(np.float32)}

    found = between(plain, changed(plain, change))
    stage = fitted(found, "range_residual_spread", "range_m")
    assert (stage.kind, stage.of) == ("range_noise", "object")
    assert float(np.median(stage.value)) == pytest.approx(0.03, rel=0.1)
    (group,) = [one for one in found.layout.groups if (one.statistic, one.axis) == ("range_residual_spread", "range_m")]
    curve = natural_curve(found, group)
    assert curve.unit == "m, standard deviation"
    clear_m = float(found.clear_spread["range_residual_spread"][0])
    wider = float(np.nanmedian(curve.value))
    assert wider == pytest.approx(math.hypot(clear_m, 0.03) - clear_m, rel=0.25)
