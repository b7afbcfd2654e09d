"""Looks at a cloud by compiled loops: the bits of torch, the same refusals, and no change of what was given."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.core import compiled as switch
from torchweather.lidar.beams import Beams, beams_of
from torchweather.lidar.clouds import check_points
from torchweather.lidar.intensity import are_integers, zero_intensity
from torchweather.lidar.laser_blocks import height_blocks
from torchweather.lidar.sweep import beam_heights
from torchweather.lidar.sweep.beam_heights import beam_heights_m

TWO_BLOCKS = ("velodyne-hdl-64e", "velodyne-hdl-64e-s3")


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(switch.SWITCH, "1")


def both(monkeypatch: pytest.MonkeyPatch, call: Callable[[], Any]) -> tuple[Any, Any]:
    fast = call()
    with monkeypatch.context() as without:
        without.setenv(switch.SWITCH, "0")
        return fast, call()


def cloud_of(rows: int, low_deg: float = -28.0, high_deg: float = 6.0) -> Tensor:
    random = torch.Generator().manual_seed(7)
    elevation, azimuth, place, intensity = torch.rand(4, rows, generator=random, dtype=torch.float64)
    elevation, azimuth = torch.deg2rad(low_deg + (high_deg - low_deg) * elevation), 2.0 * math.pi * azimuth
    level, range_m = elevation.cos(), 0.8 * 120.0**place
    columns = (level * azimuth.cos() * range_m, level * azimuth.sin() * range_m, elevation.sin() * range_m, intensity)
    cloud = torch.stack(columns, -1).float()
    cloud[5::97, :3] = 0.0
    cloud[7::1009, :2] = 0.0  # straight up and down
    return cloud


def at_limits(sensor: tw.Lidar) -> Tensor:
    """Returns at all elevations between two rings of a block, a few steps of single precision above and below."""
    elevations, heights = sensor.elevations_deg, sensor.origin_heights_m
    assert elevations is not None
    assert heights is not None
    found = []
    for members in height_blocks(heights):
        rising = torch.tensor(sorted(elevations[ring] for ring in members), dtype=torch.float64)
        limits = torch.deg2rad(0.5 * (rising[1:] + rising[:-1])).tan()
        level_m = torch.linspace(2.0, 90.0, 40, dtype=torch.float64)[:, None, None]
        off = torch.linspace(-4e-6, 4e-6, 81, dtype=torch.float64)[:, None]
        z = level_m * (limits + off) + sum(heights[ring] for ring in members) / len(members)
        found.append(torch.stack([level_m.expand_as(z), torch.zeros_like(z), z], -1).reshape(-1, 3))
    return torch.cat(found).float()


@pytest.mark.parametrize("preset", TWO_BLOCKS)
def test_heights_of_two_blocks_are_those_of_torch_bit_for_bit(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = tw.Lidar.preset(preset)
    points = torch.cat([cloud_of(60_000)[:, :3], at_limits(sensor)])
    taken: list[int] = []
    by_elevation = beam_heights._by_elevation

    def counted(some: Tensor, *more: Any) -> Tensor:
        taken.append(len(some))
        return by_elevation(some, *more)

    monkeypatch.setattr(beam_heights, "_by_elevation", counted)
    fast, slow = both(monkeypatch, lambda: beam_heights_m(points, sensor))
    assert torch.equal(fast, slow)
    assert taken[1] == len(points)
    fast, slow = both(monkeypatch, lambda: beam_heights_m(points[:60_000], sensor))
    assert torch.equal(fast, slow)
    assert taken[2] < 6000  # torch looks at the beams between the blocks, a degree of 34


def test_sensors_of_one_block_or_of_blocks_across_each_other_stay_with_torch() -> None:
    across = tw.Lidar(905.0, elevations_deg=(-10.0, 2.0, -4.0, -2.0), origin_heights_m=(0.1, 0.1, 0.3, 0.3))
    assert beam_heights._blocks(across) is None
    assert beam_heights._blocks(tw.Lidar.preset("ouster-os1-128")) is None
    assert beam_heights._blocks(tw.Lidar.preset(TWO_BLOCKS[0])) is not None


def beams(points: Tensor, sensor: tw.Lidar) -> Beams:
    return beams_of(points, sensor, None, complete_scan=False, owner="test")


@pytest.mark.parametrize(
    "sensor",
    [
        tw.Lidar(905.0),
        tw.Lidar(905.0, min_range_m=3.0),
        tw.Lidar.preset("ouster-os1-128"),
        tw.Lidar.preset(TWO_BLOCKS[0], min_range_m=3.0),
    ],
    ids=["none", "near", "one", "two"],
)
def test_beams_start_and_end_with_the_bits_of_torch(sensor: tw.Lidar, monkeypatch: pytest.MonkeyPatch) -> None:
    points = torch.stack([cloud_of(3000), cloud_of(3000).flip(0)])
    given = points.clone()
    fast, slow = both(monkeypatch, lambda: beams(points, sensor))
    assert torch.equal(points, given)
    assert torch.equal(fast.points, slow.points)
    assert torch.equal(fast.end, slow.end)
    assert fast.end.unique().tolist() == [0, 5]
    x, y, z = slow.points[..., :3].unbind(-1)
    range_m = (x * x + y * y + z * z).sqrt()
    assert torch.equal(fast.range_m, torch.where(range_m < sensor.min_range_m, 0.0, range_m))
    there = (points[..., :3] != 0).any(-1)
    assert (fast.height_m is None) == (slow.height_m is None)
    if fast.height_m is not None:
        assert torch.equal(torch.where(there, fast.height_m, 0.0), slow.height_m)


@pytest.mark.parametrize(
    "sensor",
    [tw.Lidar(905.0), tw.Lidar.preset("ouster-os1-128", intensity_unit="reflectivity")],
    ids=["at 0", "above"],
)
def test_a_call_leaves_the_cloud_that_it_was_given(sensor: tw.Lidar) -> None:
    points = cloud_of(2000)
    given = points.clone()
    assert torch.equal(tw.LidarRain(tw.Rain(0.0), sensor)(points, seed=1), given)
    tw.LidarRain(tw.Rain(50.0), sensor)(points, seed=1)
    assert torch.equal(points, given)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3e9, -1.0])
@pytest.mark.parametrize("column", [1, 3, 4])
def test_odd_numbers_are_refused_in_the_same_words(value: float, column: int, monkeypatch: pytest.MonkeyPatch) -> None:
    points = torch.nn.functional.pad(cloud_of(500), (0, 1), value=1.0)
    points[123, column] = value

    def refusal() -> str:
        try:
            check_points(points, tw.Lidar(905.0, intensity_unit="photons"), "test")
        except ValueError as error:
            return str(error)
        return ""

    fast, slow = both(monkeypatch, refusal)
    assert fast == slow
    assert bool(fast) == (not math.isfinite(value) or (value > 1.0 and column == 1) or (value < 0.0 and column == 3))


@pytest.mark.parametrize("unit", ["reflectivity", "uint8_linear"])
@pytest.mark.parametrize("scale", [0.5, 3.0, 90.0, 400.0])
def test_units_are_warned_of_alike(unit: str, scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    points = cloud_of(900)
    points[:, 3] *= scale
    points[::9, 3] = -0.0

    def warning() -> list[str]:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            check_points(points, tw.Lidar(905.0, intensity_unit=unit), "test")
        return [str(one.message) for one in found]

    fast, slow = both(monkeypatch, warning)
    assert fast == slow


@pytest.mark.parametrize("unit", ["reflectivity", "uint8_linear", "photons"])
@pytest.mark.parametrize("step", [0.0, 0.01, 1.0])
@pytest.mark.parametrize("off", [0.0, 8e-6, 0.3])
def test_steps_of_intensities_are_those_of_torch(
    unit: str, step: float, off: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    intensity = cloud_of(2400)[:, 3].reshape(2, 1200)
    intensity = (intensity / step).round() * step if step else intensity
    intensity[1, 1100] += off
    for call in (are_integers, zero_intensity):
        fast, slow = both(monkeypatch, lambda call=call: call(intensity, unit))
        assert torch.equal(fast, slow)
    assert torch.equal(zero_intensity(0.0 * intensity, unit), 0.5 * (zero_intensity(0.0 * intensity, unit) > 0))


def test_directions_of_a_sensor_are_scaled_once_and_anew_where_they_changed() -> None:
    points = cloud_of(400)
    along = torch.nn.functional.normalize(points[:, :3] + 1e-3, dim=-1)
    sensor = tw.Lidar(905.0, directions=along)
    lidar = tw.LidarSnow(tw.Snow(3.0), sensor, beam_ends="max_range")
    noise = lidar.draw(points, seed=2)
    first = lidar(points, noise)
    kept = lidar._find_beams._unit
    assert torch.equal(lidar(points, noise), first)
    assert lidar._find_beams._unit is kept
    assert torch.equal(lidar(points, noise, directions=sensor.directions.clone()), first)
    sensor.directions.mul_(torch.tensor([1.0, -1.0, 1.0]))
    assert torch.equal(lidar(points, noise), lidar(points, noise, directions=sensor.directions.clone()))
    assert not torch.equal(lidar(points, noise), first)
