"""Ends of beams without return on a street whose ends are known, and the raster against a search of every return."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_opening

from tests.lidar.sweep.street_sweep import CAR, COLUMNS, MAX_RANGE_M, SENSOR_M, street
from torchweather.core import compiled as switch
from torchweather.lidar.sweep.beam_ends import BeamEnd, beam_ends
from torchweather.lidar.sweep.ground import fit_ground
from torchweather.lidar.sweep.sweep_raster import SweepRaster, long_runs


@pytest.mark.parametrize("slope", [0.0, 0.03, -0.03])
@pytest.mark.parametrize("with_rings", [True, False])
def test_ends_of_a_street_are_those_of_the_scene(slope: float, with_rings: bool) -> None:
    sweep = street(slope)
    ends = beam_ends(
        sweep.points,
        sweep.direction,
        MAX_RANGE_M,
        step_deg=360.0 / COLUMNS,
        ring=sweep.ring if with_rings else None,
        direction_ring=sweep.direction_ring if with_rings else None,
    )
    for end in (BeamEnd.SKY, BeamEnd.GROUND, BeamEnd.OBSTACLE, BeamEnd.OWN_VEHICLE):
        there = sweep.truth == end
        assert there.sum() > 20, end
        assert (ends.end[there] == end).mean() > 0.95, end
    assert ends.ground is not None
    assert ends.ground.height_m == pytest.approx(-SENSOR_M, abs=0.03)
    assert ends.ground.slope_x == pytest.approx(slope, abs=0.003)
    right = (ends.end == sweep.truth) & (sweep.truth_m > 0)
    off = np.abs(ends.distance_m[right] / sweep.truth_m[right] - 1)
    end, truth_m = ends.end[right], sweep.truth_m[right]
    assert off[(end == BeamEnd.GROUND) & (truth_m < 40)].max() < 0.05
    assert off[end == BeamEnd.OBSTACLE].max() < 0.35, "the house beside the car, which is nearer"
    assert np.median(off[end == BeamEnd.OBSTACLE]) < 0.02


def test_nothing_ends_below_the_ground_and_nothing_on_the_own_vehicle_has_a_way() -> None:
    sweep = street(0.02)
    ends = beam_ends(sweep.points, sweep.direction, MAX_RANGE_M, step_deg=360.0 / COLUMNS)
    assert ends.ground is not None
    tip = sweep.direction * ends.distance_m[:, None]
    assert ends.ground.height_above(tip).min() > -1e-9
    assert (ends.distance_m[ends.end == BeamEnd.OWN_VEHICLE] == 0).all()
    assert (ends.distance_m[ends.end == BeamEnd.SKY] == MAX_RANGE_M).all()


def test_a_pane_ends_at_its_frame_and_not_at_the_road_behind() -> None:
    sweep = street()
    ends = beam_ends(sweep.points, sweep.direction, MAX_RANGE_M, step_deg=360.0 / COLUMNS)
    pane = (sweep.truth == BeamEnd.OBSTACLE) & (np.abs(sweep.direction[:, 1]) < 0.06) & (sweep.direction[:, 0] > 0)
    assert pane.sum() > 10
    assert np.abs(ends.distance_m[pane] * sweep.direction[pane, 0] - CAR[0]).max() < 0.1


def test_a_known_own_vehicle_and_a_given_ground_are_taken() -> None:
    sweep = street()
    own = sweep.direction[:, 2] > 0.05
    plane = fit_ground(sweep.points)
    ends = beam_ends(sweep.points, sweep.direction, MAX_RANGE_M, own_vehicle=own, ground=plane)
    assert ends.ground is plane
    assert ((ends.end == BeamEnd.OWN_VEHICLE) == own).all()


def test_without_returns_or_without_a_ground_beams_go_on() -> None:
    up_and_down = np.array([[0.8, 0.0, 0.6], [0.8, 0.0, -0.6]])
    ends = beam_ends(np.zeros((0, 3)), up_and_down, 50.0)
    assert ends.end.tolist() == [BeamEnd.SKY, BeamEnd.SKY]
    assert ends.distance_m.tolist() == [50.0, 50.0]
    assert ends.ground is None
    few = beam_ends(np.array([[3.0, 4.0, 0.0], [5.0, 5.0, 1.0]]), up_and_down, 50.0)
    assert few.distance_m.tolist() == [50.0, 50.0]


def test_neighbours_are_those_of_a_search_of_every_cell() -> None:
    rng = np.random.default_rng(5)
    rows, columns = 9, 40
    cells = rng.permutation(rows * columns)
    seen, empty = cells[:120], cells[120:200]
    elevation, azimuth = np.radians(np.linspace(-20, 20, rows)), np.radians((np.arange(columns) + 0.5) * 9.0)

    def rays(cell: np.ndarray) -> np.ndarray:
        e, a = elevation[cell // columns], azimuth[cell % columns]
        return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)

    range_m = rng.uniform(2.0, 50.0, len(seen))
    raised = rng.random(len(seen)) < 0.5
    raster = SweepRaster(rays(seen) * range_m[:, None], raised, rays(empty), 9.0, seen // columns, empty // columns)
    found = raster.neighbours(60.0, 12.0)
    for number, cell in enumerate(empty):
        row, column = divmod(int(cell), columns)
        for side, (down, across) in zip(found, ((0, 1), (0, -1), (1, 0), (-1, 0)), strict=True):
            expected, away, high = np.inf, np.inf, False
            for step in range(1, columns if across else rows):
                there = row + down * step
                if not 0 <= there < rows or step * (9.0 if across else 5.0) > (60.0 if across else 12.0) + 1e-6:
                    break
                at = np.flatnonzero(seen == there * columns + (column + across * step) % columns)
                if len(at):
                    expected, away, high = range_m[at[0]], step * (9.0 if across else 5.0), raised[at[0]]
                    break
            assert side.range_m[number] == pytest.approx(expected, abs=1e-4)
            assert side.away_deg[number] == pytest.approx(away)
            assert side.raised[number] == high


@pytest.mark.parametrize(("density", "reach_deg", "up_deg"), [(0.3, 60.0, 12.0), (0.02, 400.0, 90.0), (0.9, 4.0, 0.0)])
def test_compiled_neighbours_are_the_same_bits(
    density: float, reach_deg: float, up_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(8)
    rows, columns, step_deg = 17, 120, 3.0
    elevation, azimuth = np.radians(rng.uniform(-25, 15, rows)), np.radians((np.arange(columns) + 0.5) * step_deg)
    cell = np.arange(rows * columns)
    e, a = elevation[cell // columns], azimuth[cell % columns]
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    hit = (rng.random(len(cell)) < density) & (cell // columns != 5)  # one ring is empty
    range_m, raised = rng.uniform(2.0, 50.0, hit.sum()), rng.random(hit.sum()) < 0.5
    beams = ~hit | (rng.random(len(cell)) < 0.1)  # some share a cell with a return
    raster = SweepRaster(
        rays[hit] * range_m[:, None], raised, rays[beams], step_deg, cell[hit] // columns, cell[beams] // columns
    )
    monkeypatch.setenv(switch.SWITCH, "0")
    slow = raster.neighbours(reach_deg, up_deg)
    monkeypatch.setenv(switch.SWITCH, "1")
    assert switch.uses_compiled()
    for one, other in zip(raster.neighbours(reach_deg, up_deg), slow, strict=True):
        np.testing.assert_array_equal(one.range_m, other.range_m)
        np.testing.assert_array_equal(one.away_deg, other.away_deg)
        np.testing.assert_array_equal(one.raised, other.raised)
        assert np.isfinite(other.range_m).any()


def test_regions_are_wide_connected_and_whole_across_the_seam() -> None:
    columns = 360
    azimuth = np.radians(np.arange(columns) + 0.5)

    def ring(at: np.ndarray, degrees: float) -> np.ndarray:
        e = np.radians(degrees)
        return np.stack([np.cos(at) * np.cos(e), np.sin(at) * np.cos(e), np.full(len(at), np.sin(e))], -1)

    gone = (np.arange(columns) < 6) | (np.arange(columns) >= 354)  # 12 degrees about azimuth 0, on both rings
    lone = np.arange(columns) == 100
    empty = np.concatenate([ring(azimuth[gone | lone], -20.0), ring(azimuth[gone], -19.0)])
    number = np.repeat([0, 1], [int((gone | lone).sum()), int(gone.sum())])
    returns = np.concatenate([ring(azimuth[~(gone | lone)], -20.0), ring(azimuth[~gone], -19.0)]) * 5.0
    of_returns = np.repeat([0, 1], [int((~(gone | lone)).sum()), int((~gone).sum())])
    raster = SweepRaster(returns, np.zeros(len(returns), bool), empty, 1.0, of_returns, number)
    all_of_them = np.ones(len(empty), bool)
    found = raster.regions(width_deg=3.0, below=all_of_them, reaching=number == 0, except_=~all_of_them)
    assert found.sum() == 24
    assert not found[np.flatnonzero(number == 0)[6]], "a single beam is no region"
    none = raster.regions(width_deg=3.0, below=all_of_them, reaching=~all_of_them, except_=~all_of_them)
    assert not none.any()
    assert not raster.regions(width_deg=20.0, below=all_of_them, reaching=all_of_them, except_=~all_of_them).any()


@pytest.mark.parametrize("width", [1, 2, 5])
def test_long_runs_are_a_morphological_opening(width: int) -> None:
    mask = np.random.default_rng(4).random((6, 90)) < 0.7
    assert np.array_equal(long_runs(mask, width), binary_opening(mask, np.ones((1, width), bool)))
