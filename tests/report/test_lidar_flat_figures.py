"""Pictures from the side and by angle: a look shows particles under the road."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from tests.report.test_lidar_section import decoded, pixels_of
from tests.report.test_view_flat import FLAKES, UNDER, road
from torchweather.lidar import fit_ground
from torchweather.report.lidar_figures import COLOURS
from torchweather.report.lidar_flat_figures import (
    GROUND,
    GROUND_LINE,
    UNDER_COLOUR,
    angle_views_uri,
    side_views_uri,
    under_the_ground,
)
from torchweather.report.lidar_views import WeatherCloud
from torchweather.stages import PointKind


def clear_road() -> WeatherCloud:
    points = road()
    return WeatherCloud(points, kinds(points, PointKind.OBJECT), torch.zeros(len(points), dtype=torch.bool), {}, {})


def kinds(points: Tensor, kind: PointKind) -> Tensor:
    return torch.full((len(points),), int(kind), dtype=torch.int8)


def with_flakes(clear: WeatherCloud, flakes: Tensor) -> WeatherCloud:
    """The road and flakes after it, as `complete_scan` appends them."""
    rows = torch.cat([flakes, torch.ones(len(flakes), 1)], 1)
    kind = torch.cat([clear.kind, kinds(rows, PointKind.PARTICLE)])
    return WeatherCloud(torch.cat([clear.points, rows]), kind, clear.lost, {}, {})


def near(picture: NDArray[Any], colour: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows and columns of the pixels of a colour."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    return np.nonzero(np.abs(picture - wanted).max(-1) <= 6)


def test_points_under_the_ground_are_those_counted_one_by_one() -> None:
    clear = clear_road()
    plane = fit_ground(clear.points[:, :3].numpy())
    found = under_the_ground(FLAKES, plane)
    assert int(found.sum()) == UNDER
    assert found.tolist() == [False, False, False, True, True, False]
    assert not under_the_ground(clear.points, plane).any()
    assert not under_the_ground(FLAKES, None).any()


@pytest.mark.parametrize("draw", [side_views_uri, angle_views_uri])
def test_a_look_shows_them(draw: Any) -> None:
    clear = clear_road()
    cloud = with_flakes(clear, FLAKES)
    above = with_flakes(clear, FLAKES[:1])
    with_some, without = decoded(draw([("Snow", cloud)], clear)), decoded(draw([("Snow", above)], clear))
    assert pixels_of(with_some, UNDER_COLOUR) > 60  # the heading has the colour, too
    assert pixels_of(without, UNDER_COLOUR) == 0
    assert pixels_of(without, COLOURS["particle"]) > 3


def test_the_ground_is_drawn_under_the_points_and_flakes_lie_in_it() -> None:
    clear = clear_road()
    flakes = torch.tensor([[10.0, 0.0, -4.0]]).expand(300, 3) + 2.0 * torch.rand(
        300, 3, generator=torch.Generator().manual_seed(0)
    )
    picture = decoded(side_views_uri([("Snow", with_flakes(clear, flakes))], clear))
    ground_rows, _ = near(picture, GROUND)
    line_rows, _ = near(picture, GROUND_LINE)
    heading = round(0.2 * len(picture))
    flake_rows, flake_columns = near(picture[heading:], UNDER_COLOUR)
    # Rows run down; the road rises by 2 %, 2.4 m of the 120 m that are shown.
    assert np.median(line_rows) < np.median(ground_rows)
    assert ground_rows.min() < flake_rows.mean() + heading < ground_rows.max()
    assert flake_columns.mean() > 0.5 * picture.shape[1]  # 10 to 12 m ahead, which is right


def test_left_is_left_by_angle() -> None:
    clear = clear_road()
    left = torch.tensor([[0.0, 20.0, 0.5]]).expand(250, 3)
    picture = decoded(angle_views_uri([("Snow", with_flakes(clear, left))], clear))
    _, columns = near(picture, COLOURS["particle"])
    # 90 degrees of 180 to -180: a quarter of the axis, which spans 5 to 99 % of the picture.
    assert columns.mean() / picture.shape[1] == pytest.approx(0.052 + 0.25 * 0.935, abs=0.01)


def test_a_cloud_without_returns_has_pictures() -> None:
    nothing = WeatherCloud(torch.zeros(5, 4), torch.full((5,), 2, dtype=torch.int8), torch.zeros(5).bool(), {}, {})
    for draw in (side_views_uri, angle_views_uri):
        assert pixels_of(decoded(draw([("Nothing", nothing)], nothing)), GROUND) == 0
