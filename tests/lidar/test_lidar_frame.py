"""A cloud in another frame than the sensor's: weather about the sensor, points back in the cloud's frame."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.lidar.cloud_frame import points_in_cloud_frame, points_in_sensor_frame
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarResult, LidarWeather

WEATHER = Mixture(Snow(rate_mm_per_h=2), Fog(mor_m=50))
# Waymo's top LiDAR, turned a little.
ORIGIN_M = (1.43, 0.0, 2.18)


def pose(yaw_rad: float = 0.3, tilt_rad: float = 0.05) -> Tensor:
    """T_cloud_from_sensor, float64."""
    c, s, ct, st = math.cos(yaw_rad), math.sin(yaw_rad), math.cos(tilt_rad), math.sin(tilt_rad)
    yaw = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    tilt = torch.tensor([[ct, 0.0, st], [0.0, 1.0, 0.0], [-st, 0.0, ct]], dtype=torch.float64)
    found = torch.eye(4, dtype=torch.float64)
    found[:3, :3], found[:3, 3] = yaw @ tilt, torch.tensor(ORIGIN_M, dtype=torch.float64)
    return found


def moved(cloud: Tensor, by: Tensor) -> Tensor:
    """A cloud of the sensor's frame in that of the pose; a row without return stays at the origin."""
    there = cloud[..., :3].double() @ by[:3, :3].T + by[:3, 3]
    there[(cloud[..., :3] == 0).all(-1)] = 0.0
    return torch.cat([there.to(cloud), cloud[..., 3:]], -1)


@pytest.fixture(scope="module")
def cloud() -> Tensor:
    generator = torch.Generator().manual_seed(3)
    points = torch.randn(3, 400, 6, generator=generator) * torch.tensor([40.0, 40.0, 2.0, 60.0, 1.0, 1.0])
    points[..., 3].abs_()
    points[:, 7] = 0.0
    return points


@pytest.fixture(scope="module")
def lidar() -> Lidar:
    return Lidar.preset("velodyne-hdl-64e")


def run(sensor: Lidar, points: Tensor, weather: Weather = WEATHER, **options: object) -> LidarResult:
    transform = LidarWeather(weather, sensor, **options)  # type: ignore[arg-type]
    return transform.run(points, transform.draw(points, seed=5))


def test_weather_is_that_of_the_cloud_in_the_sensors_frame(cloud: Tensor, lidar: Lidar) -> None:
    at = pose()
    plain, apart = run(lidar, cloud), run(lidar.with_pose(at), moved(cloud, at))
    assert torch.equal(plain.kind, apart.kind)
    particle = plain.kind == PointKind.PARTICLE
    assert int(particle.sum()) > 200
    back = (apart.points[..., :3].double() - at[:3, 3]) @ at[:3, :3]
    # Ranges differ by the rounding of the cloud, a part in 1e7 of some tens of metres.
    assert (back - plain.points[..., :3].double())[particle].abs().max() < 1e-4
    assert torch.allclose(apart.points[..., 3], plain.points[..., 3], rtol=1e-3, atol=1.01)


def test_objects_keep_their_bits_and_lost_points_are_zero(cloud: Tensor, lidar: Lidar) -> None:
    given = moved(cloud, pose())
    result = run(lidar.with_pose(pose()), given, Fog(mor_m=400))
    kept, lost = result.kind == PointKind.OBJECT, result.kind == PointKind.LOST
    assert torch.equal(result.points[kept][:, :3], given[kept][:, :3])
    assert int(lost.sum()) > 3
    assert not result.points[lost][:, :3].any()


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_no_weather_gives_the_bits_back(cloud: Tensor, lidar: Lidar, dtype: torch.dtype) -> None:
    given = moved(cloud, pose()).to(dtype)
    transform = LidarWeather(Mixture(Rain(rate_mm_per_h=0), Fog(mor_m=math.inf)), lidar.with_pose(pose()))
    assert torch.equal(transform(given), given)


def test_no_particle_gathers_about_the_clouds_origin(lidar: Lidar) -> None:
    """Waymo: without the origin the nearest flakes lie around the rear axle."""
    generator = torch.Generator().manual_seed(0)
    azimuth_rad = torch.rand(4000, generator=generator) * 2 * math.pi
    around = torch.stack([30 * azimuth_rad.cos(), 30 * azimuth_rad.sin(), torch.zeros(4000), torch.ones(4000)], -1)
    given = around + torch.tensor([*ORIGIN_M, 0.0])
    sensor = Lidar.preset("velodyne-hdl-64e", origin_m=ORIGIN_M)
    result = run(sensor, given)
    flakes = result.points[result.kind == PointKind.PARTICLE]
    assert len(flakes) > 100
    # The middle of the flakes is the sensor's place, to its standard error.
    ranges_m = (flakes[:, :3] - torch.tensor(ORIGIN_M)).norm(dim=-1)
    error_m = 3 * float(ranges_m.square().mean().sqrt()) / math.sqrt(2 * len(flakes))
    assert (flakes[:, :2].mean(0) - torch.tensor(ORIGIN_M[:2])).abs().max() < error_m
    # Beams start up to 0.21 m above the origin (two blocks of lasers) and are level beyond.
    above_m = flakes[:, 2] - ORIGIN_M[2]
    assert float(above_m.min()) >= -1e-4
    assert float(above_m.max()) < 0.21


def test_directions_of_empty_rows_are_the_clouds(lidar: Lidar) -> None:
    at = pose()
    along = torch.tensor([[1.0, 0.2, 0.05], [-0.4, 1.0, 0.0]])
    empty = torch.zeros(2, 4)
    sensor = lidar.with_pose(at)
    transform = LidarWeather(Fog(mor_m=15), sensor)
    result = transform.run(empty, transform.draw(empty, seed=1), directions=along)
    found = result.points[..., :3].double() - at[:3, 3]
    assert bool((result.kind == PointKind.PARTICLE).all())
    wanted = (along / along.norm(dim=-1, keepdim=True)).double()
    assert torch.allclose(found / found.norm(dim=-1, keepdim=True), wanted, atol=1e-6)


def test_completed_beams_start_at_the_sensor() -> None:
    from torchweather.sensors import scan_directions

    sensor = Lidar(905.0, elevations_deg=(-10.0, 0.0, 10.0), columns=360, near_start_m=1.0, near_full_m=2.0)
    full = 20.0 * scan_directions(sensor)
    some = torch.cat([full, torch.ones(len(full), 1)], -1)[torch.arange(len(full)) % 7 > 0]
    at = pose()
    plain = run(sensor, some, complete_scan=True)
    apart = run(sensor.with_pose(at), moved(some, at), complete_scan=True)
    assert plain.empty_beams == apart.empty_beams == len(full) - len(some)
    assert torch.equal(plain.kind, apart.kind)


@pytest.mark.parametrize("dual", [False, True])
def test_second_returns_and_left_out_points_come_in_the_clouds_frame(cloud: Tensor, dual: bool) -> None:
    sensor = Lidar.preset("velodyne-hdl-64e", return_mode="dual" if dual else "strongest")
    at = pose()
    plain, apart = run(sensor, cloud[0], lost="drop"), run(sensor.with_pose(at), moved(cloud[0], at), lost="drop")
    pairs = [(plain.points, apart.points)] + ([(plain.second, apart.second)] if dual else [])
    for one, other in pairs:
        assert isinstance(one, Tensor)
        assert isinstance(other, Tensor)
        assert len(one) > 0
        assert torch.allclose(moved(one, at)[:, :3], other[:, :3], atol=2e-4)


def test_minimum_range_counts_from_the_sensor() -> None:
    sensor = Lidar(905.0, min_range_m=1.0, origin_m=(5.0, 0.0, 0.0), near_start_m=0.5, near_full_m=0.8)
    points = torch.tensor([[5.5, 0.0, 0.0, 1.0], [0.5, 0.0, 0.0, 1.0]])  # 0.5 and 4.5 m from the sensor
    transform = LidarWeather(Rain(rate_mm_per_h=0), sensor)
    result = transform.run(points, transform.draw(points, seed=0))
    assert result.kind.tolist() == [PointKind.LOST, PointKind.OBJECT]


def test_there_and_back_is_the_cloud(cloud: Tensor, lidar: Lidar) -> None:
    sensor = lidar.with_pose(pose())
    local = points_in_sensor_frame(cloud, sensor)
    assert torch.equal(points_in_cloud_frame(local, local, cloud, sensor), cloud)
    # Moved by nothing but what the frames say: without the input's own bits it is the same to rounding.
    free = points_in_cloud_frame(local, local + 1.0, cloud, sensor)
    assert torch.allclose(free, cloud, atol=1e-5)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"origin_m": (1.0, 2.0)}, "three finite numbers in metres"),
        ({"origin_m": (1.0, 2.0, math.nan)}, "three finite numbers in metres"),
        ({"origin_m": "front"}, "three finite numbers in metres"),
        ({"rotation": ((1, 0, 0), (0, 1, 0))}, r"expected a rotation \(3, 3\)"),
        ({"rotation": ((2, 0, 0), (0, 1, 0), (0, 0, 1))}, r"expected a rotation \(3, 3\)"),
        ({"rotation": ((1, 0, 0), (0, -1, 0), (0, 0, 1))}, "a reflection"),
    ],
)
def test_a_wrong_place_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Lidar(905.0, **fields)  # type: ignore[arg-type]


def test_a_transposed_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="Is the matrix transposed"):
        Lidar(905.0).with_pose(pose().T)


def test_a_sensor_with_a_pose_goes_through_a_dictionary(lidar: Lidar) -> None:
    apart = lidar.with_pose(pose())
    assert Lidar.from_dict(apart.to_dict()) == apart
    assert lidar.with_pose(torch.eye(4)) == lidar
