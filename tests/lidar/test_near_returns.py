"""Returns of objects where the near-range response rises: nothing jumps at ``near_start_m``."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Snow, Weather
from torchweather.sensors import Lidar
from torchweather.stages import PointKind, ToEnergy
from torchweather.transforms import LidarWeather

BEAMS = 4000
RANGES_M = [1.8 + 0.02 * step for step in range(21)]  # 1.8 to 2.2 m
# The response of all presets here begins at 2 m. No ring has a height: a point at x = R is R away from its laser.
PLAIN = {"elevations_deg": None, "azimuth_offsets_deg": None, "origin_heights_m": None, "columns": None}


def sensor(name: str, **more: object) -> Lidar:
    return Lidar.preset(name, **PLAIN, near_start_m=2.0, near_full_m=10.0, near_power=1.0, **more)


def at(range_m: float, intensity: float, beams: int = BEAMS) -> Tensor:
    return torch.tensor([[range_m, 0.0, 0.0, intensity]]).expand(beams, 4).contiguous()


def not_reported(lidar: Lidar, weather: Weather, intensity: float, ranges_m: list[float]) -> list[float]:
    """Share of objects at each range that are not reported."""
    transform = LidarWeather(weather, lidar)
    found = []
    for range_m in ranges_m:
        points = at(range_m, intensity)
        kind = transform.run(points, transform.draw(points, seed=3)).kind
        assert isinstance(kind, Tensor)
        found.append(float((kind != PointKind.OBJECT).float().mean()))
    return found


@pytest.mark.parametrize("name", ["velodyne-hdl-64e", "ouster-os1-128"])
@pytest.mark.parametrize("intensity", [0.0, 1.0, 5.0, 50.0])
def test_no_return_is_lost_all_at_once_at_the_start_of_the_response(name: str, intensity: float) -> None:
    """Fog of 30 m took 84 % at 2.00 m and none at 1.99 m."""
    lost = not_reported(sensor(name), Fog(mor_m=30), intensity, RANGES_M)
    assert lost[:10] == [0.0] * 10
    steps = [after - before for before, after in pairwise(lost)]
    # 2 % more of the beams in 2 cm, and three standard errors of the difference of two shares of 15 %.
    allowed = 0.02 + 3 * math.sqrt(2 * 0.15 * 0.85 / BEAMS)
    assert max(map(abs, steps)) < allowed, (lost, allowed)
    assert lost[-1] < 0.2


def test_a_faint_return_is_lost_ever_more_often_with_range() -> None:
    lost = not_reported(sensor("velodyne-hdl-64e"), Fog(mor_m=30), 0.0, [2.0, 2.2, 2.5, 3.0, 4.0, 6.0])
    assert lost[0] == 0.0
    assert all(after > before for before, after in pairwise(lost))
    assert lost[-1] > 0.95  # fog of 30 m hides what is dark


@pytest.mark.parametrize("weather", [Fog(mor_m=30), Fog(mor_m=100), Snow(rate_mm_per_h=3)], ids=str)
@pytest.mark.parametrize("intensity", [0.0, 5.0])
def test_the_expected_share_is_that_of_draws(weather: Weather, intensity: float) -> None:
    lidar = sensor("velodyne-hdl-64e")
    ranges_m = [1.99, 2.05, 2.2, 2.5, 3.0, 5.0, 8.0]
    lost = not_reported(lidar, weather, intensity, ranges_m)
    transform = LidarWeather(weather, lidar)
    cloud = torch.cat([at(range_m, intensity, 1) for range_m in ranges_m])
    expected = 1.0 - transform.expected(cloud)[1]
    # Eight nodes over a margin that ends: 0.02 of error besides the three standard errors of a share.
    assert torch.allclose(expected, torch.tensor(lost), atol=0.02 + 3 * math.sqrt(0.25 / BEAMS))


def test_the_margin_has_the_sensors_mean_in_full_response_and_ends_at_a_grey_target_near() -> None:
    lidar = sensor("ouster-os1-128", margin_db=1.5)
    stage = ToEnergy(lidar)
    uniform = (torch.arange(200_000) + 0.5) / 200_000
    for range_m, mean_db in ((10.0, 1.5), (60.0, 1.5), (6.0, 3.0), (2.0, math.inf)):
        margin_db = stage.log_margin(torch.full((200_000,), range_m), uniform) * 10 / math.log(10)
        end_db = 10 * math.log10(0.1 / math.pi / range_m**2 / lidar.threshold_per_m2_sr)
        if range_m >= lidar.near_full_m:
            assert float(margin_db.mean()) == pytest.approx(mean_db, rel=1e-3)
            continue
        # But for one return in 10,000, whose margin would be larger at any range.
        assert float(margin_db.sort().values[-20]) == pytest.approx(end_db, rel=1e-5)
        # Of an exponential law cut at its end the mean is m (1 - exp(-end / m)).
        cut = end_db if math.isinf(mean_db) else mean_db * -math.expm1(-end_db / mean_db)
        assert float(margin_db.mean()) == pytest.approx(cut, rel=2e-3)


def test_the_margin_has_gradients_at_every_range() -> None:
    stage = ToEnergy(sensor("ouster-os1-128"))
    stage.margin_db.requires_grad_()
    range_m = torch.tensor([0.0, 1.0, 2.0, 2.001, 5.0, 10.0, 50.0], requires_grad=True)
    stage.log_margin(range_m, torch.full((7,), 0.5)).sum().backward()
    assert stage.margin_db.grad is not None
    assert bool(torch.isfinite(stage.margin_db.grad))
    assert range_m.grad is not None
    assert bool(torch.isfinite(range_m.grad).all())
