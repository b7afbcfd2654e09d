"""Places of frames that depart: known effects in small studies of every sensor, against their size."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gap.tiny_camera_study import values_of
from tests.gap.tiny_link_study import tiny_link_study
from tests.gap.tiny_radar_study import tiny_radar_study
from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Rain
from torchweather.camera.effects.all import EFFECTS
from torchweather.gap.find import CELLS, MODELS
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.natural_units import natural_unit
from torchweather.gap.places import DEPARTS, CellValues, mean_over_frames, places_of
from torchweather.gap.study.study import Study
from torchweather.pipeline.effect import Effect

WINDOW, EXPOSURE, RADOME = "lidar.window_loss", "camera.exposure_gain", "radar.wet_radome"


def study_of(kind: str) -> tuple[Study, Effect]:
    """A study with an effect hidden, and the effect."""
    if kind == "lidar":
        effect = EFFECTS[WINDOW](loss_db=2.0)
        return tiny_study([effect], seed=1, weathers=(Rain(10.0), Rain(20.0), Rain(15.0))), effect
    if kind == "camera":
        effect = EFFECTS[EXPOSURE](factor=1.1)
        return Study.from_arrays(**values_of([effect], "fog", seed=1)), effect
    if kind == "radar":
        effect = EFFECTS[RADOME](loss_db=3.0)
        return tiny_radar_study([effect], seed=1), effect
    return tiny_link_study(constant_db=2.0), EFFECTS[RADOME](loss_db=2.0, drying_min=12.0)


@pytest.mark.parametrize(
    ("kind", "statistic", "unit", "size"),
    [
        ("lidar", "log_intensity_ratio", "dB", -2.0),
        ("camera", "log_ratio_green", "% of clear air's light", 10.0),
        ("radar", "power_residual_db", "dB", -3.0),
        ("link", "attenuation_db", "dB", 2.0),
    ],
)
def test_a_hidden_effect_departs_by_its_size_and_not_once_it_is_added(
    kind: str, statistic: str, unit: str, size: float
) -> None:
    study, effect = study_of(kind)
    model: Any = MODELS[kind](study, None, (), ())
    found = CELLS[kind](model, model.fit[0], statistic, ([], 0.0), ([effect], 0.0), range(8))
    assert found.unit == unit
    assert found.after is not None
    before, after = (
        np.nanmedian(mean_over_frames(found.measured)[0] - mean_over_frames(one)[0])
        for one in (found.before, found.after)
    )
    # Of the camera it is a tenth of what is seen, all of it near by and more than clear air's where fog adds light.
    assert before == pytest.approx(size, rel=0.35 if kind == "camera" else 0.1)
    assert abs(after) < 0.1 * abs(size)
    cells = found.measured.shape[1]
    assert found.shape is None or np.prod(found.shape) == cells
    assert (found.x is None) == (found.shape is not None)


def test_lost_beams_are_counted_in_per_cent() -> None:
    study, _ = study_of("lidar")
    model: Any = MODELS["lidar"](study, None, (), ())
    found = CELLS["lidar"](model, model.fit[0], "lost_share", ([], 0.0), None, range(8))
    assert found.after is None
    assert found.unit == "% of beams"
    assert np.nanmin(found.measured) >= 0.0
    assert np.nanmax(found.measured) <= 100.0
    assert np.nanmean(found.measured) > np.nanmean(found.before)  # a window takes returns away


def result(departure: float, frames: int = 5, clear: int = 9) -> tuple[Any, Any]:
    """A result of one condition, and cells of which the first departs."""
    rng = np.random.default_rng(3)
    condition = SimpleNamespace(id="c0", scene="s0")
    search = SimpleNamespace(
        measured=[SimpleNamespace(condition=condition, frames=frames)],
        start=SimpleNamespace(z=lambda one: np.ones(3)),
        origin=ParameterPoint(),
        catalogue_effects=lambda point: [],
        model=SimpleNamespace(systematics=lambda one, strengths: [], clear_frames={"s0": clear}),
    )

    def cells(condition: Any, statistic: str, before: Any, after: Any, seeds: Any) -> CellValues:
        measured = rng.normal(size=(frames, 2000))
        measured[:, 0] += departure
        return CellValues("it", "m", measured, rng.normal(size=(len(seeds), 2000)), None, np.zeros(2000))

    return SimpleNamespace(search=search, fit=None), cells


def test_chance_is_that_of_few_frames() -> None:
    """The square of the scatter of a mean of 5 and one of at most 9 independent frames, its law Student's."""
    found = places_of(*result(30.0), "lost_share")
    assert found is not None
    assert found.before[0] > DEPARTS * found.chance[0]
    beyond = np.abs(found.before[1:]) > DEPARTS * found.chance[1:]
    assert beyond.mean() < 0.005  # 0.0027 in the mean
    # Of 8 degrees of freedom 3 standard deviations of a normal law are 4.09.
    assert np.median(found.chance) == pytest.approx(4.09 / 3.0 * np.sqrt(1 / 5 + 1 / 9), rel=0.05)


def test_no_picture_where_nothing_counts() -> None:
    given, _ = result(0.0)
    empty = np.full((5, 4), np.nan)
    assert places_of(given, lambda *some: CellValues("it", "m", empty, empty, None, np.zeros(4)), None) is None
    assert places_of(given, lambda *some: None, None) is None


@pytest.mark.parametrize("kind", ["lidar", "camera", "radar", "link"])
def test_every_statistic_along_an_axis_has_a_natural_unit(kind: str) -> None:
    model: Any = MODELS[kind](study_of(kind)[0], None, (), ())
    for group in model.layout.binned:
        unit = natural_unit(group)
        if (group.statistic, group.kind) == ("log_ghost_delay", "spread"):
            continue
        assert unit is not None, group
        entry = np.linspace(0.7, 1.2, 6)  # counts of nothing are 0.61
        values = unit.of(entry, 5)
        assert (np.diff(values) > 0).all(), group  # never turned over
    for group in model.layout.groups[len(model.layout.binned) :]:
        assert natural_unit(group) is None
