"""Beams into open air: the stated share against drawn sweeps, and the range that an unmeasured near response leaves."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.lidar.open_air import OpenAirReturns, open_air_returns
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.point_kind import PointKind
from torchweather.sensors import Lidar

BEAMS = 5_000


def drawn_share(weather: Weather, sensor: Lidar) -> float:
    """Share of particles among beams that have no object, level and all around."""
    angle = torch.linspace(0, 2 * math.pi, BEAMS + 1)[:-1]
    directions = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], -1)
    found = LidarWeather(weather, sensor).run(torch.zeros(BEAMS, 4), seed=3, directions=directions)
    return float((torch.as_tensor(found.kind) == PointKind.PARTICLE).float().mean())


@pytest.mark.parametrize(
    ("weather", "name"),
    [(Snow(1.0), "velodyne-hdl-64e"), (Fog(mor_m=200.0), "ouster-os1-128"), (Rain(100.0), "ouster-os2-128")],
    ids=["snow", "fog", "rain"],
)
def test_the_share_is_that_of_drawn_sweeps(weather: Weather, name: str) -> None:
    sensor = Lidar.preset(name)
    stated = open_air_returns(LidarWeather(weather, sensor))
    responses = {(sensor.near_start_m, sensor.near_full_m, sensor.near_power): stated.share}
    if stated.slow is not None and stated.fast is not None:
        responses |= {(0.0, 30.0, 2.0): stated.slow, (0.0, 10.0, 2.0): stated.fast}
    assert len(responses) == (1 if name == "ouster-os2-128" else 3)
    for (start, full, power), share in responses.items():
        own = replace(sensor, near_start_m=start, near_full_m=full, near_power=power)
        noise = math.sqrt(share * (1 - share) / BEAMS)
        assert drawn_share(weather, own) == pytest.approx(share, abs=4 * noise + 0.02 * share + 2 / BEAMS)


def test_a_sensor_that_states_its_response_has_no_range() -> None:
    given = replace(Lidar.preset("velodyne-hdl-64e"), near_start_m=0.0, near_full_m=20.0, near_power=2.0)
    found = open_air_returns(LidarWeather(Snow(1.0), given))
    assert (found.slow, found.fast) == (None, None)
    assert found.text().endswith("with the near response that the sensor states.")


def test_shares_in_words() -> None:
    assert "33 % return from particles; 2.1 % to 33 %" in OpenAirReturns(0.33, 0.021, 0.32).text()
    assert "less than 0.01 % to 100 %" in OpenAirReturns(0.5, 1e-9, 1.0).text()
    assert OpenAirReturns(0.0, 0.0, 0.0).text().startswith("Of beams into open air 0 % return")
