"""The own vehicle in the sweeps of a drive: found on a made car and on KITTI's, and nothing else taken for it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.lidar.sweep.own_car_drive import (
    COLUMNS,
    ELEVATIONS_DEG,
    MIRROR_M,
    SENSOR,
    hidden,
    mirror,
    rings_and_columns,
    sweep,
)
from tests.recordings import recording
from torchweather.datasets import read_kitti_points
from torchweather.lidar import BeamEnd, OwnVehicleMask, own_vehicle_mask
from torchweather.lidar.sweep.completion import complete_scan
from torchweather.lidar.sweep.own_vehicle import checked_own_vehicle
from torchweather.lidar.sweep.sweep_rings import sweep_rings
from torchweather.sensors import Lidar

SHAPE = len(ELEVATIONS_DEG), COLUMNS
PLACES = (0.0, 0.9, 1.7, 2.8, 4.1)


@pytest.fixture(scope="module")
def mask() -> OwnVehicleMask:
    return own_vehicle_mask([sweep(place)[0] for place in PLACES], SENSOR)


def test_the_made_car_is_found(mask: OwnVehicleMask) -> None:
    assert (mask.sweeps, mask.views) == (5, 5.0)
    np.testing.assert_array_equal(mask.blocked, hidden().reshape(SHAPE))
    # The cells beside the mirror see it in a neighbour; nothing farther away does.
    wide = np.stack([np.roll(mirror().reshape(SHAPE), shift, 1) for shift in (-1, 0, 1)]).any(0)
    assert mask.returning[mirror().reshape(SHAPE)].all()
    assert not mask.returning[~wide].any()
    assert mask.nearest_m[mask.returning].min() > MIRROR_M - 0.06
    assert mask.farthest_m.max() < MIRROR_M + 0.06


def test_a_person_in_one_sweep_of_five_is_not_in_the_mask(mask: OwnVehicleMask) -> None:
    sweeps = [sweep(place, person=place == PLACES[2])[0] for place in PLACES]
    found = own_vehicle_mask(sweeps, SENSOR)
    np.testing.assert_array_equal(found.blocked, mask.blocked)
    np.testing.assert_array_equal(found.returning, mask.returning)
    cloud, returned = sweep(PLACES[2], person=True)
    ring, _ = rings_and_columns()
    held = found.holds(cloud[:, :3].numpy(), ring[returned])
    np.testing.assert_array_equal(held, mirror()[returned])


def test_a_person_beside_a_standing_car_is_not_in_the_mask(mask: OwnVehicleMask) -> None:
    # Ten sweeps at a red light count as one, so the person is in one view of five.
    waiting = [sweep(PLACES[0], person=True, seed=seed)[0] for seed in range(10)]
    found = own_vehicle_mask([*waiting, *(sweep(place)[0] for place in PLACES[1:])], SENSOR)
    assert (found.sweeps, found.views) == (14, 5.0)
    np.testing.assert_array_equal(found.blocked, mask.blocked)
    np.testing.assert_array_equal(found.returning, mask.returning)
    with pytest.raises(ValueError, match=re.escape("got 10 sweeps, which show 1.0 views")):
        own_vehicle_mask(waiting, SENSOR)


def test_the_road_is_no_body_though_it_lies_as_near_and_as_still() -> None:
    # A sensor 0.9 m above the road sees it within 3 m below -17 degrees.
    low = [sweep(place)[0] * torch.tensor([0.5, 0.5, 0.5, 1.0]) for place in PLACES]
    found = own_vehicle_mask(low, SENSOR)
    wide = np.stack([np.roll(mirror().reshape(SHAPE), shift, 1) for shift in (-1, 0, 1)]).any(0)
    assert not found.returning[~wide].any()


def test_the_order_of_the_sweeps_does_not_matter(mask: OwnVehicleMask) -> None:
    found = own_vehicle_mask([sweep(place)[0] for place in reversed(PLACES)], SENSOR)
    for name in ("blocked", "nearest_m", "farthest_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(mask, name))


def test_beams_that_the_car_hides_end_on_it_and_its_returns_are_named(mask: OwnVehicleMask) -> None:
    cloud, returned = sweep(6.0)
    found = complete_scan(cloud, SENSOR, own_vehicle=mask)
    on_it = found.end == int(BeamEnd.OWN_VEHICLE)
    missing = int((hidden() | mirror())[~returned].sum())
    # A degree beside the car belongs to it as well, where nothing returned.
    assert missing <= int(on_it.sum()) <= missing + 0.2 * len(ELEVATIONS_DEG) * 4
    assert not found.end_m[on_it].any()
    assert found.row_own is not None
    np.testing.assert_array_equal(found.row_own.numpy(), mirror()[returned])
    assert f"own vehicle from 5 sweeps: {int(hidden().sum())} beams blocked" in found.words


def test_a_person_in_front_of_the_body_is_no_part_of_it(mask: OwnVehicleMask) -> None:
    ring, azimuth = rings_and_columns()
    some = np.flatnonzero(mirror())[10:12]
    elevation, turn = np.radians(np.asarray(ELEVATIONS_DEG)[ring[some]]), np.radians(azimuth[some])
    beam = np.stack([np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)], -1)
    for range_m, held in ((MIRROR_M, True), (0.8, False), (1.4, False)):
        assert mask.holds(range_m * beam, ring[some]).tolist() == [held, held]
    assert not mask.holds(MIRROR_M * beam, np.full(2, -1)).any()


def test_a_mask_is_written_and_read(mask: OwnVehicleMask, tmp_path: Path) -> None:
    mask.save(tmp_path / "car.npz")
    found = OwnVehicleMask.load(tmp_path / "car.npz")
    assert found.words == mask.words
    for name in ("blocked", "nearest_m", "farthest_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(mask, name))
    np.savez(tmp_path / "other.npz", blocked=mask.blocked)
    with pytest.raises(ValueError, match="expected a mask of the own vehicle"):
        OwnVehicleMask.load(tmp_path / "other.npz")


def test_what_is_no_own_vehicle_is_refused() -> None:
    assert checked_own_vehicle([-2, 2, -1, 1, -1.6, 0], SENSOR, "LidarSnow") == (-2.0, 2.0, -1.0, 1.0, -1.6, 0.0)
    for wrong in ((2, -2, -1, 1, -1.6, 0), (1, 2, 3), True, ("a",) * 6):
        with pytest.raises(ValueError, match="LidarSnow: own_vehicle: expected a mask"):
            checked_own_vehicle(wrong, SENSOR, "LidarSnow")


@pytest.mark.long  # beside made sweeps
@pytest.mark.real_data
def test_kittis_car_is_the_same_in_every_sweep() -> None:
    files = sorted(recording("kitti_13/velodyne").glob("*.bin"))
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    clouds = [read_kitti_points(file) for file in files]
    mask = own_vehicle_mask(clouds, sensor)
    assert mask.views == len(files) == 13
    # On single sweeps without anything beside the car `beam_ends` finds 8,700 to 9,100.
    assert 8000 < int(mask.blocked.sum()) < 9500
    assert 20 < int(mask.returning.sum()) < 60
    number = []
    for cloud in clouds:
        ring = sweep_rings(cloud, sensor).ring.numpy()
        held = mask.holds(cloud[:, :3].numpy(), ring)
        # The body's returns: about 27 of them lie at 1.4 to 1.9 m, 0.5 to 0.8 m below the sensor.
        assert held.sum() < 35
        xyz = cloud.numpy()[held]
        assert np.hypot(xyz[:, 0], xyz[:, 1]).max() < 2.0
        assert xyz[:, 2].max() < -0.4
        end = complete_scan(cloud, sensor, own_vehicle=mask).end
        number.append(int((end == int(BeamEnd.OWN_VEHICLE)).sum()))
    # Sweep by sweep, beam_ends finds 7,300 to 9,900 (standard deviation 577).
    assert np.std(number) < 200
    assert 8500 < np.mean(number) < 9200
