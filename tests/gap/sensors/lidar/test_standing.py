"""Where in a cell of the map a thing stands, from the beams that return from it in nearly every frame."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from tests.gap.tiny_study import tiny_study
from torchweather.atmosphere.weather import Snow
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.location_search import standing_grids
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.lidar.standing import place_of_standing
from torchweather.lidar.effects.all import EFFECTS

ROWS, COLUMNS, FRAMES = 16, 256, 6
SPACING = 2.0 * math.pi / COLUMNS
AZIMUTH = (torch.arange(COLUMNS) * SPACING - math.pi).repeat(ROWS)


def frames(first: int, last: int, fog_m: float = 0.0, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Measured and clear frames: a wall at 30 m, flakes anywhere, a thing at 9 m in some columns, fog."""
    rng = torch.Generator().manual_seed(seed)
    clear = torch.full((4, ROWS * COLUMNS), 30.0)
    measured = torch.full((FRAMES, ROWS * COLUMNS), 30.0)
    flake = torch.rand(measured.shape, generator=rng) < 0.1
    measured[flake] = 3.0 + 12.0 * torch.rand(int(flake.sum()), generator=rng)
    if fog_m:
        seen = torch.rand(ROWS * COLUMNS, generator=rng) < 0.3
        measured[:, seen] = fog_m
    column = torch.arange(COLUMNS).repeat(ROWS)
    measured[:, (column >= first) & (column <= last)] = 9.0
    return measured, clear


@pytest.mark.parametrize(("first", "last"), [(40, 40), (40, 43), (0, 2)])
@pytest.mark.parametrize("fog_m", [0.0, 8.0])
def test_a_thing_is_found_in_its_columns(first: int, last: int, fog_m: float) -> None:
    """Also where fog returns in front of three beams in ten, and looked for 0.05 rad and a quarter of its range off."""
    middle = 0.5 * (first + last) * SPACING - math.pi
    found = place_of_standing(AZIMUTH, SPACING, [frames(first, last, fog_m)], middle + 0.05, 9.0 * 1.25)
    assert found is not None
    azimuth, range_m, width = found
    assert math.remainder(azimuth - middle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert range_m == pytest.approx(9.0, abs=1e-4)
    assert width == pytest.approx((last - first + 1) * SPACING, rel=1e-3)


def test_nothing_stands_where_flakes_fall_or_the_clear_frames_have_it() -> None:
    measured, clear = frames(1, 0)
    assert place_of_standing(AZIMUTH, SPACING, [(measured, clear)], 0.0, 9.0) is None
    measured, _ = frames(120, 130)
    assert place_of_standing(AZIMUTH, SPACING, [(measured, measured[:4])], 125 * SPACING - math.pi, 9.0) is None


def test_what_reaches_farther_than_is_looked_has_no_place() -> None:
    """A wall of 40 columns, 1 rad: its middle is not known from 0.2 rad to either side."""
    assert place_of_standing(AZIMUTH, SPACING, [frames(100, 140)], 100 * SPACING - math.pi, 9.0) is None


def test_a_thing_is_looked_for_from_where_it_stands_in_the_frames() -> None:
    """One column of a study, 0.03 rad beside the middle of its cell; one grid, with the column's own width."""
    post = EFFECTS["lidar.static_structure"](azimuth_rad=-2.258, range_m=8.0, width_rad=0.02)
    study = tiny_study([post], seed=2, rows=16, columns=256, clear=4, weathers=(Snow(2.0), Snow(1.2)))
    search = SimulatorLikelihood(model := LidarFrames(study), observations(model, study.fit), 0, pool_frames=12)
    (grid,) = standing_grids(search, [EFFECTS["lidar.static_structure"]], ParameterPoint())
    (values,) = grid.points
    assert values["azimuth_rad"] == pytest.approx(-2.258, abs=1e-3)
    assert values["range_m"] == pytest.approx(8.0, rel=0.02)
    assert values["width_rad"] == pytest.approx(SPACING, rel=1e-3)
