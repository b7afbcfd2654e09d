"""Where the sensor of a cloud stands, from the cones of its lasers; clouds in the vehicle's frame are noticed."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from tests.recordings import recording
from torchweather.atmosphere.weather import Rain
from torchweather.core.errors import TorchweatherWarning
from torchweather.io import read_points
from torchweather.lidar.frame_check import frame_note
from torchweather.lidar.sweep.sensor_origin import SensorOrigin, estimate_origin
from torchweather.sensors import Lidar
from torchweather.transforms import LidarWeather

Numbers = npt.NDArray[np.floating[Any]]

WAYMO_M = (1.43, 0.0, 2.18)
HEIGHT_M, COLUMNS = 1.8, 500
ELEVATIONS_DEG = np.linspace(-22.0, 3.0, 32)


def sweep(height_m: float = HEIGHT_M, slope: float = 0.01, seed: int = 0) -> tuple[Numbers, npt.NDArray[np.int64]]:
    """A road that rises a little between walls of several distances, ring after ring; and the rings."""
    rng = np.random.default_rng(seed)
    azimuth = -2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS
    tangent = np.tan(np.radians(ELEVATIONS_DEG))[:, None]
    road = height_m / np.maximum(slope * np.cos(azimuth) - tangent, 1e-6)
    # Blocks of houses and cars, 24 sectors wide: ranges of 6 to 50 m.
    wall = np.repeat(rng.uniform(6.0, 50.0, 25), COLUMNS // 25)[None]
    rho = np.minimum(road, wall) + rng.normal(0.0, 0.01, (32, COLUMNS))
    xyz = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), rho * tangent], -1).reshape(-1, 3)
    return xyz, np.repeat(np.arange(32), COLUMNS)


def found(xyz: Numbers, ring: npt.NDArray[np.int64] | None = None) -> SensorOrigin:
    origin = estimate_origin(xyz, ring)
    assert origin is not None
    return origin


@pytest.mark.parametrize("by_ring", [False, True], ids=["file order", "ring column"])
@pytest.mark.parametrize("shift_m", [WAYMO_M, (-2.0, 0.7, 3.0), (350.0, -800.0, 40.0)], ids=str)
def test_the_place_is_found_from_rings_by_order_or_column(shift_m: tuple[float, float, float], by_ring: bool) -> None:
    xyz, ring = sweep()
    origin = found(xyz + np.array(shift_m), ring if by_ring else None)
    # 0.01 m of range noise on 8,000 points; the error of the middle is far smaller.
    assert np.allclose(origin.origin_m, shift_m, atol=0.02)
    assert max(origin.error_m) < 0.03
    assert origin.rings == 32
    assert origin.is_apart
    assert origin.spread_deg < 0.05


def test_a_cloud_in_the_sensors_own_frame_is_left_alone() -> None:
    xyz, ring = sweep()
    for origin in (found(xyz), found(xyz, ring)):
        assert np.allclose(origin.origin_m, 0.0, atol=0.02)
        assert not origin.is_apart


def test_lasers_above_the_origin_are_those_of_a_sensor() -> None:
    """An HDL-64E's two blocks stand 0.12 and 0.20 m above its origin."""
    xyz, ring = sweep()
    xyz[:, 2] += np.where(ring < 16, 0.12, 0.20)
    origin = found(xyz)
    assert origin.origin_m[2] == pytest.approx(0.16, abs=0.05)
    assert not origin.is_apart


@pytest.mark.parametrize("way_m", [0.5, 2.0, 3.0])
def test_compensation_for_motion_is_no_other_frame(way_m: float) -> None:
    xyz, ring = sweep()
    turn = np.tile((np.arange(COLUMNS) + 0.5) / COLUMNS, 32)
    for moment in (0.0, 0.5, 1.0):  # to which the cloud is compensated
        moved = xyz + np.stack([way_m * (turn - moment), 0 * turn, 0 * turn], -1)
        origin = estimate_origin(moved, ring)
        assert origin is None or not origin.is_apart


def test_rows_in_no_order_tell_nothing_without_a_ring_column() -> None:
    xyz, ring = sweep()
    order = np.random.default_rng(1).permutation(len(xyz))
    assert estimate_origin(xyz[order] + np.array(WAYMO_M)) is None
    assert np.allclose(found(xyz[order] + np.array(WAYMO_M), ring[order]).origin_m, WAYMO_M, atol=0.02)


def test_clouds_that_are_no_sweep_tell_nothing() -> None:
    rng = np.random.default_rng(2)
    for xyz in (rng.normal(size=(100, 3)), 20 * rng.normal(size=(20_000, 3)), np.zeros((9000, 3))):
        origin = estimate_origin(xyz)
        assert origin is None or not origin.is_apart


def test_rows_without_return_and_rings_below_zero_do_not_count() -> None:
    xyz, ring = sweep()
    moved = xyz + np.array(WAYMO_M)
    moved[::7], ring[::11] = 0.0, -1
    moved[1::7] = np.nan
    assert np.allclose(found(moved, ring).origin_m, WAYMO_M, atol=0.02)


def cloud(shift_m: tuple[float, float, float]) -> torch.Tensor:
    xyz, ring = sweep()
    rows = np.column_stack([xyz + np.array(shift_m), np.full(len(xyz), 0.3), ring])
    return torch.from_numpy(rows).float()


def test_the_note_says_what_to_pass_and_then_falls_silent() -> None:
    plain = Lidar(905.0)
    note = frame_note(cloud(WAYMO_M), plain)
    assert "--sensor-origin 1.43 -0.00 2.18" in note.replace("1.43 0.00", "1.43 -0.00")
    assert "The cones of 32 rings (file order) meet in (1.43, " in note
    assert frame_note(cloud(WAYMO_M), Lidar(905.0, origin_m=WAYMO_M)) == ""
    assert frame_note(cloud((0.0, 0.0, 0.0)), plain) == ""
    wrong = frame_note(cloud(WAYMO_M), Lidar(905.0, origin_m=(0.0, 0.0, 2.18)))
    assert "not in (0.0, 0.0, 2.18) as given" in wrong
    assert "origin_m=(1.43, " in wrong


def test_a_transform_warns_once_of_a_cloud_in_the_vehicles_frame() -> None:
    sensor = Lidar(905.0, max_range_m=119.0, ring_column=4)
    transform = LidarWeather(Rain(rate_mm_per_h=0), sensor)
    with pytest.warns(TorchweatherWarning, match=r"LidarWeather: The cones .* meet in \(1\.43"):
        transform(cloud(WAYMO_M))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        transform(cloud(WAYMO_M))
        LidarWeather(Rain(rate_mm_per_h=0), Lidar(905.0, max_range_m=119.0, origin_m=WAYMO_M))(cloud(WAYMO_M))


@pytest.mark.parametrize(
    ("pattern", "across_m"),
    [
        ("kitti_13/velodyne/000000.bin", 0.02),
        ("kitti_13/velodyne/000076.bin", 0.02),
        ("radiate_fog/velo_lidar/000001.csv", 0.02),
        # Compensated for motion, 0.4 m a turn.
        ("kitti_nuscenes_demo/nuscenes/*.pcd.bin", 0.3),
    ],
)
def test_recordings_that_were_moved(pattern: str, across_m: float) -> None:
    read = read_points(recording(pattern))
    points = read.points.double().numpy()
    ring = points[:, read.columns.index("ring")].astype(np.int64) if "ring" in read.columns else None
    own = found(points[:, :3], ring)
    assert not own.is_apart
    moved = points[:, :3] + np.array(WAYMO_M) * (points[:, :3] != 0).any(1, keepdims=True)
    origin = found(moved, ring)
    assert origin.is_apart
    assert np.allclose(np.subtract(origin.origin_m, WAYMO_M)[:2], 0.0, atol=across_m)
    assert origin.origin_m[2] - own.origin_m[2] == pytest.approx(WAYMO_M[2], abs=0.03)
