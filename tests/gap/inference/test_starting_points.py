"""Where the search starts: points inside the bounds, of either sign, away from the identity."""

from __future__ import annotations

import itertools
import math

import pytest

from torchweather.gap.inference.starting_points import ParameterGrid, parameter_grids
from torchweather.lidar.effects.all import EFFECTS as LIDAR_EFFECTS
from torchweather.pipeline.effect import Effect
from torchweather.stages import EFFECTS

PLACES = (-2.0, 0.5)
NAMES = sorted(name for name, effect in LIDAR_EFFECTS.items() if name.startswith("lidar.") and effect.searched)


def varied(grid: ParameterGrid) -> list[str]:
    """Parameters that change along a grid."""
    return [name for name in grid.points[0] if len({values[name] for values in grid.points}) > 1]


def departures(effect: type[Effect], grid: ParameterGrid) -> dict[str, list[float]]:
    """Departures from the identity, parameter by parameter, of the points of a grid."""
    found = {}
    for parameter in effect.arguments:
        if parameter.identity is not None and parameter.name in grid.points[0]:
            values = [one[parameter.name] for one in grid.points]
            # A far extent or saturation is near to none.
            found[parameter.name] = [
                -1.0 / value if math.isinf(parameter.identity) else value - parameter.identity for value in values
            ]
    return found


def test_the_catalogue_is_there() -> None:
    assert len(NAMES) == 25


@pytest.mark.parametrize("name", NAMES)
def test_points_lie_inside_the_bounds_and_are_no_identity(name: str) -> None:
    effect = EFFECTS[name]
    bounds = {parameter.name: (parameter.low, parameter.high) for parameter in effect.arguments}
    found = parameter_grids(effect, PLACES)
    assert found
    for grid in found:
        assert grid.effect is effect
        assert grid.points
        for values in grid.points:
            assert all(bounds[key][0] <= value <= bounds[key][1] for key, value in values.items())
            assert not bool(effect(**values).at_identity)


@pytest.mark.parametrize("name", NAMES)
def test_points_grow_along_a_grid(name: str) -> None:
    for grid in parameter_grids(EFFECTS[name], PLACES):
        changed = departures(EFFECTS[name], grid)
        assert len(changed) == 1  # one deciding parameter a grid
        assert varied(grid) in ([], list(changed))
        (steps,) = changed.values()
        sizes = [abs(step) for step in steps]
        assert sizes == sorted(set(sizes))
        assert len({math.copysign(1.0, step) for step in steps}) == 1


@pytest.mark.parametrize("name", NAMES)
def test_a_deciding_parameter_is_tried_on_either_side_where_its_bounds_allow(name: str) -> None:
    effect = EFFECTS[name]
    signs: dict[str, set[float]] = {}
    for grid in parameter_grids(effect, PLACES):
        for key, steps in departures(effect, grid).items():
            signs.setdefault(key, set()).add(math.copysign(1.0, steps[0]))
    for parameter in effect.arguments:
        if parameter.identity is None:
            continue
        expected = {-1.0} if parameter.identity > parameter.low else set()
        if parameter.identity < parameter.high:
            expected |= {1.0}
        assert signs[parameter.name] == expected


def test_a_place_is_tried_where_the_caller_says() -> None:
    found = {
        values["azimuth_rad"]
        for grid in parameter_grids(EFFECTS["lidar.sector_loss"], PLACES)
        for values in grid.points
    }
    assert found == set(PLACES)
    assert not parameter_grids(EFFECTS["lidar.sector_loss"], [])


def test_weak_and_strong_points_span_a_decade_where_the_bounds_allow() -> None:
    (grid,) = parameter_grids(EFFECTS["lidar.window_loss"], PLACES)
    strengths = [values["loss_db"] for values in grid.points]
    assert strengths[-1] / strengths[0] >= 10.0
    assert strengths[0] <= 0.05 * EFFECTS["lidar.window_loss"].arguments[0].scale  # few counts go as the root


@pytest.mark.parametrize(("number", "first"), [(1, (0,)), (2, (1,)), (3, (0, 1)), (4, (0, 2)), (6, (0, 1, 2, 3, 4, 5))])
def test_a_weak_point_and_a_typical_one_are_tried_first(number: int, first: tuple[int, ...]) -> None:
    points = tuple({"loss_db": float(place)} for place in range(number))
    assert ParameterGrid(EFFECTS["lidar.window_loss"], points).first == first


@pytest.mark.parametrize("name", NAMES)
def test_of_four_steps_the_third_is_of_the_typical_size_and_far_extents_are_all_tried(name: str) -> None:
    effect = EFFECTS[name]
    scales = {one.name: (one.identity, one.scale) for one in effect.arguments if one.identity is not None}
    for grid in parameter_grids(effect, PLACES):
        ((key, steps),) = departures(effect, grid).items()
        identity, scale = scales[key]
        if math.isinf(identity):
            assert grid.first == tuple(range(len(grid.points)))
        elif len(grid.points) == 4:
            factor = identity > 0 and effect.arguments[[one.name for one in effect.arguments].index(key)].low >= 0
            typical = (
                identity * math.expm1(math.copysign(scale, steps[0])) if factor else math.copysign(scale, steps[0])
            )
            assert steps[grid.first[-1]] == pytest.approx(typical, rel=1e-9)
            assert abs(steps[grid.first[0]]) < 0.1 * abs(typical)


def test_what_cuts_is_tried_so_closely_that_nothing_is_stepped_over() -> None:
    """Particles between one metre and the next are cut or not: from half a metre to seven, by a fifth each."""
    (grid,) = parameter_grids(EFFECTS["lidar.blind_zone"], [])
    values = [point["range_m"] for point in grid.points]
    assert values[0] < 0.5 < 6.5 < values[-1]
    assert [high / low for low, high in itertools.pairwise(values)] == pytest.approx([1.2] * (len(values) - 1))
    assert list(grid.first) == list(range(len(values)))
    assert [name for name in NAMES if EFFECTS[name].cuts] == ["lidar.blind_zone"]


def test_values_that_are_a_matter_of_the_data_are_tried_as_they_are() -> None:
    (grid,) = parameter_grids(EFFECTS["camera.saturation"], (), {"level": (0.71, 0.69, 0.4)})
    assert [dict(one) for one in grid.points] == [{"level": 0.71}, {"level": 0.69}, {"level": 0.4}]


@pytest.mark.parametrize("name", NAMES)
def test_the_weakest_points_of_a_mirror_depart_by_as_much(name: str) -> None:
    for grid in parameter_grids(EFFECTS[name], PLACES):
        if grid.mirror is None:
            continue
        (one,), (other,) = departures(EFFECTS[name], grid).values(), departures(EFFECTS[name], grid.mirror).values()
        assert one[0] * other[0] < 0
        assert abs(one[0]) == pytest.approx(abs(other[0]), rel=0.1)  # a factor's by as much in logarithm
        (varying,) = set(varied(grid)) | set(varied(grid.mirror))
        assert {k: v for k, v in grid.points[0].items() if k != varying} == {
            k: v for k, v in grid.mirror.points[0].items() if k != varying
        }


def test_both_sides_of_a_range_bias_are_mirrors_and_a_blind_zone_has_none() -> None:
    assert [one.mirror is not None for one in parameter_grids(EFFECTS["lidar.range_bias"], PLACES)] == [False, True] * 2
    assert {one.mirror for one in parameter_grids(EFFECTS["lidar.blind_zone"], PLACES)} == {None}
