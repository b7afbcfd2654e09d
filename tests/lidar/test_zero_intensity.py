"""Intensity 0 of a sensor that counts in steps: the middle of what is rounded to it."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain
from torchweather.lidar.clouds import below_floor
from torchweather.lidar.intensity import zero_intensity
from torchweather.sensors import Lidar
from torchweather.transforms import LidarWeather


@pytest.mark.parametrize(
    ("unit", "values", "zero"),
    [
        ("uint8_linear", [0.0, 3.0, 255.0], 0.5),
        ("uint8_calibrated", [0.0, 0.0], 0.5),
        ("uint8_linear", [0.0, 3.5], 0.0),  # not counted
        ("reflectivity", [0.0, 0.31, 0.99], 0.005),
        ("reflectivity", [0.0, 0.315], 0.0),
        ("reflectivity", [0.0, 0.0], 0.0),  # nothing that has a step
        ("reflectivity_percent", [0.0, 4.0], 0.0),
        ("photons", [0.0, 4.0], 0.0),
        ("none", [0.0, 1.0], 0.0),
    ],
)
def test_half_a_step_where_the_data_have_one(unit: str, values: list[float], zero: float) -> None:
    assert float(zero_intensity(torch.tensor([values]), unit)) == pytest.approx(zero, rel=1e-6)


def test_all_hundredths_of_single_precision_are_steps() -> None:
    values = (torch.arange(100, dtype=torch.float64) / 100).float()
    assert float(zero_intensity(values[None], "reflectivity")) == pytest.approx(0.005)
    # One value beside a step, in the thousandths, is none of them.
    assert float(zero_intensity(torch.cat([values, torch.tensor([0.503])])[None], "reflectivity")) == 0.0


def signal(sensor: Lidar, intensities: list[float], range_m: float) -> Tensor:
    """X of objects in clear air, floor and all; the margin is next to nothing."""
    points = torch.tensor([[range_m, 0.0, 0.0, value] for value in intensities])
    transform = LidarWeather(Rain(rate_mm_per_h=0), sensor)
    state = transform.state_of(points)
    noise = transform.chain.draw(state, seed=torch.tensor([1]))
    own = {key.split(".")[1]: value for key, value in noise.items() if key.startswith("to_energy.")}
    return transform.chain.stages["to_energy"](state, own).scene.clear_signal[0]


def test_a_counted_zero_has_the_signal_of_half_a_count() -> None:
    sensor = Lidar(905.0, intensity_unit="uint8_linear", near_start_m=0.5, near_full_m=1.0, margin_db=1e-6)
    found = signal(sensor, [0.0, 7.0], 5.0)
    assert float(found[0]) == pytest.approx(0.5 / 255 / math.pi / 25, rel=1e-5)
    assert float(found[1]) == pytest.approx(7 / 255 / math.pi / 25, rel=1e-5)


def test_what_zero_stands_for_can_be_given() -> None:
    plain = {"intensity_unit": "uint8_linear", "near_start_m": 0.5, "near_full_m": 1.0, "margin_db": 1e-6}
    none = Lidar(905.0, zero_intensity=0.0, **plain)  # type: ignore[arg-type]
    assert float(signal(none, [0.0, 7.0], 5.0)[0]) == pytest.approx(none.threshold_per_m2_sr, rel=1e-5)
    whole = Lidar(905.0, zero_intensity=1.0, **plain)  # type: ignore[arg-type]
    assert float(signal(whole, [0.0, 1.0], 5.0).diff()) == 0.0
    with pytest.raises(ValueError, match="zero_intensity must be 0 or more"):
        Lidar(905.0, zero_intensity=-1.0)


def test_each_sample_of_a_batch_has_a_step_of_its_own() -> None:
    sensor = Lidar.preset("velodyne-hdl-64e")
    counted = torch.tensor([[9.0, 0.0, 0.0, 0.0], [9.0, 1.0, 0.0, 8.0]])
    free = torch.tensor([[9.0, 0.0, 0.0, 0.0], [9.0, 1.0, 0.0, 8.5]])
    transform = LidarWeather(Fog(mor_m=60), sensor)
    both = transform.state_of(torch.stack([counted, free])).scene.zero_intensity
    assert both is not None
    assert both[:, 0].tolist() == [0.5, 0.0]


def test_near_black_points_of_a_recording_are_not_called_too_faint() -> None:
    """KITTI: a fifth of the points has intensity 0, most of them near enough for half a hundredth."""
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    cloud = torch.tensor([[10.0, 0.0, 0.0, 0.0], [60.0, 0.0, 0.0, 0.0], [10.0, 1.0, 0.0, 0.31]])
    assert below_floor(cloud, sensor) == (1, 3)


def test_no_weather_leaves_zeros_as_they_are() -> None:
    cloud = torch.tensor([[10.0, 0.0, 0.0, 0.0], [10.0, 1.0, 0.0, 31.0]])
    transform = LidarWeather(Rain(rate_mm_per_h=0), Lidar.preset("velodyne-hdl-64e"))
    assert torch.equal(transform(cloud), cloud)
