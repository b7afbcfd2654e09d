"""Returns on the own vehicle in weather: they come back bit for bit, and nothing else does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.sweep.own_car_drive import SENSOR, mirror, sweep
from tests.recordings import recording
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.io import read_points
from torchweather.lidar import OwnVehicleMask, own_vehicle_mask
from torchweather.recipes import load_recipe, save_recipe
from torchweather.report.cloud_counts import cloud_counts, has_return
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarFog, LidarSnow, LidarWeather

SEEN = SENSOR  # its pattern, 100 m
BOX = (-0.5, 0.5, 0.5, 1.5, -0.5, -0.2)  # around the mirror, metres
THICK = (Fog(mor_m=3.0), Snow(rate_mm_per_h=8.0), Rain(rate_mm_per_h=100.0))


@pytest.fixture(scope="module")
def mask() -> OwnVehicleMask:
    return own_vehicle_mask([sweep(place)[0] for place in (0.0, 0.9, 1.7, 2.8, 4.1)], SENSOR)


def run(transform: LidarWeather, cloud: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    result = transform.run(cloud, transform.draw(cloud, seed=3))
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    assert isinstance(result.transmission, Tensor)
    return result.points, result.kind, result.transmission


@pytest.mark.parametrize("weather", THICK, ids=lambda weather: weather.kind)
@pytest.mark.parametrize("complete_scan", [False, True])
@pytest.mark.parametrize("by", ["mask", "box"])
def test_the_own_vehicle_keeps_its_bits(weather: Weather, complete_scan: bool, by: str, mask: OwnVehicleMask) -> None:
    cloud, returned = sweep(6.0)
    own = torch.from_numpy(mirror()[returned])
    told = LidarWeather(weather, SEEN, complete_scan=complete_scan, own_vehicle=mask if by == "mask" else BOX)
    points, kind, transmission = run(told, cloud)
    here = slice(0, len(cloud))
    assert torch.equal(points[here][own], cloud[own])
    assert bool((kind[here][own] == PointKind.OBJECT).all())
    assert bool((transmission[here][own] == 1.0).all())
    # All others are as without: the vehicle's rows take nothing from them.
    if by == "box" or not complete_scan:
        untold = LidarWeather(weather, SEEN, complete_scan=complete_scan)
        before, before_kind, _ = run(untold, cloud)
        assert torch.equal(points[here][~own], before[here][~own])
        assert torch.equal(kind[here][~own], before_kind[here][~own])
        if weather.kind == "fog":
            assert not torch.equal(before[here][own], cloud[own]), "the weather changes them if it is not told"


def test_a_dual_sensor_has_no_second_return_from_it() -> None:
    cloud, _ = sweep(6.0)
    sensor = Lidar(**{**SEEN.to_dict(), "return_mode": "dual"})
    box = (-20.0, 20.0, -20.0, 20.0, -5.0, 5.0)  # so large a vehicle that flakes lie in front of it
    own = (cloud[:, :3].abs() <= torch.tensor([20.0, 20.0, 5.0])).all(-1)
    seconds = []
    for told in (None, box):
        snow = LidarSnow(Snow(rate_mm_per_h=8.0), sensor, own_vehicle=told)
        result = snow.run(cloud, snow.draw(cloud, seed=3))
        assert isinstance(result.second, Tensor)
        assert isinstance(result.second_kind, Tensor)
        assert isinstance(result.points, Tensor)
        seconds.append((result.second_kind[own] != PointKind.LOST) | result.second[own].any(-1))
    assert torch.equal(result.points[own], cloud[own])
    assert int(seconds[0].sum()) > 100
    assert not seconds[1].any()


def test_a_person_2_m_away_is_weathered(mask: OwnVehicleMask) -> None:
    cloud, _ = sweep(6.0, person=True)
    near = (cloud[:, :3].norm(dim=-1) < 2.2) & (cloud[:, 0] > 1.0)
    assert int(near.sum()) > 500
    fog = LidarFog(Fog(mor_m=3.0), SEEN, own_vehicle=mask)
    points, _, transmission = run(fog, cloud)
    assert bool((transmission[near] < 0.2).all())
    assert not (points[near] == cloud[near]).all(-1).any()


@pytest.mark.parametrize("weather", [Fog(mor_m=torch.inf), Snow(rate_mm_per_h=0.0), Rain(rate_mm_per_h=0.0)])
def test_without_weather_the_cloud_keeps_its_bits(weather: Weather, mask: OwnVehicleMask) -> None:
    cloud, _ = sweep(6.0)
    points, _, _ = run(LidarWeather(weather, SEEN, complete_scan=True, own_vehicle=mask), cloud)
    assert torch.equal(points[: len(cloud)], cloud)
    assert not points[len(cloud) :, :3].any()


def test_the_counts_call_them_objects(mask: OwnVehicleMask) -> None:
    cloud, returned = sweep(6.0)
    fog = LidarFog(Fog(mor_m=0.3), SEEN, own_vehicle=mask)  # 0.3 m: nothing else comes back
    found = cloud_counts(has_return(cloud, SEEN), fog.run(cloud, fog.draw(cloud, seed=1)))
    own = int(mirror()[returned].sum())
    assert (found["own_vehicle_points"], found["objects"], found["empty_beams"]) == (own, own, 0)
    assert found["lost"] + found["particles"] + own == len(cloud)


def test_a_batch_with_the_mask_is_its_samples(mask: OwnVehicleMask) -> None:
    first, second = sweep(6.0)[0], sweep(7.0)[0]
    count = min(len(first), len(second))
    both = torch.stack([first[:count], second[:count]])
    fog = LidarFog(Fog(mor_m=3.0), SEEN, complete_scan=True, own_vehicle=mask)
    result = fog.run(both, fog.draw(both, seed=1))
    assert result.own_vehicle_points is not None
    for place in range(2):
        alone = fog.run(both[place], fog.draw(both[place], seed=1))
        assert alone.own_vehicle_points is not None
        assert int(result.own_vehicle_points[place]) == int(alone.own_vehicle_points) > 50


def test_expected_leaves_them_in_clear_air(mask: OwnVehicleMask) -> None:
    cloud, returned = sweep(6.0)
    own = torch.from_numpy(mirror()[returned])
    clear, _ = LidarFog(Fog(mor_m=torch.inf), SEEN).expected(cloud)
    signal, reported = LidarFog(Fog(mor_m=3.0), SEEN, own_vehicle=mask).expected(cloud)
    assert torch.equal(signal[own], clear[own])
    assert bool((reported[own] == 1.0).all())
    assert bool((signal[~own] < clear[~own]).all())


def test_a_recipe_holds_a_box_or_a_file(mask: OwnVehicleMask, tmp_path: Path) -> None:
    mask.save(tmp_path / "car.npz")
    for own in (list(BOX), str(tmp_path / "car.npz")):
        save_recipe(LidarFog(Fog(mor_m=50.0), SEEN, own_vehicle=own), tmp_path / "fog.yaml", title="fog")
        built = load_recipe(tmp_path / "fog.yaml")
        assert isinstance(built, LidarFog)
        found = built.own_vehicle
        assert found == BOX if isinstance(own, list) else isinstance(found, OwnVehicleMask)
    with pytest.raises(ValueError, match=r"Write it with mask.save"):
        save_recipe(LidarFog(Fog(mor_m=50.0), SEEN, own_vehicle=mask), tmp_path / "no.yaml", title="fog")


def test_a_mask_of_another_sensor_is_refused(mask: OwnVehicleMask) -> None:
    other = Lidar.preset("velodyne-vlp-16")
    with pytest.raises(ValueError, match=rf"expected a mask of the sensor's 16 rings; got one of {len(mask.blocked)}"):
        LidarSnow(Snow(1.0), other, own_vehicle=mask)


@pytest.mark.real_data
def test_nuscenes_own_car_is_neither_lost_nor_weathered() -> None:
    cloud = read_points(recording("kitti_nuscenes_demo/nuscenes/*.pcd.bin")).points
    sensor = Lidar.preset("velodyne-hdl-32e", ring_column=4)
    range_m = cloud[:, :3].norm(dim=-1)
    # Sensor 1.8 m above the road, in the middle of the roof: within 2 m, x to the right, only the roof's edge returns.
    box = (-1.2, 1.2, -2.5, 1.5, -1.2, -0.2)
    fog = LidarFog(Fog(mor_m=3.0), sensor, own_vehicle=box)
    result = fog.run(cloud, fog.draw(cloud, seed=1))
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    inside = (cloud[:, :3] >= cloud.new_tensor(box[0::2])) & (cloud[:, :3] <= cloud.new_tensor(box[1::2]))
    own = inside.all(-1) & (range_m >= 1.0)
    assert int(own.sum()) == int(result.own_vehicle_points or 0) > 100
    assert torch.equal(result.points[own], cloud[own])
    # Rows below 1 m stand for beams without a return, and are no points of the vehicle.
    none = range_m < 1.0
    assert int(result.empty_beams) == int(none.sum()) > 8000
    assert bool((result.kind[none] == PointKind.LOST).all())


@pytest.mark.long  # beside made sweeps
@pytest.mark.real_data
def test_kittis_own_car_keeps_its_bits_in_snow() -> None:
    files = sorted(recording("kitti_13/velodyne").glob("*.bin"))
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    clouds = [read_points(file).points for file in files]
    mask = own_vehicle_mask(clouds, sensor)
    snow = LidarSnow(Snow(rate_mm_per_h=2.0), sensor, complete_scan=True, own_vehicle=mask)
    fog = LidarFog(Fog(mor_m=5.0), sensor, complete_scan=True, own_vehicle=mask)
    for cloud in clouds[1:4]:
        for transform in (snow, fog):
            points, kind, transmission = run(transform, cloud)
            own = np.flatnonzero(transmission[: len(cloud)].numpy() == 1.0)
            assert 20 < len(own) < 35
            assert torch.equal(points[own], cloud[own])
            assert bool((kind[own] == PointKind.OBJECT).all())
