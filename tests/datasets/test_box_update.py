"""Boxes after weather: counts, transmission, rectangles in the image, and the records of KITTI and nuScenes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchweather.atmosphere.weather import Fog, Rain
from torchweather.camera.rgb import RgbResult
from torchweather.camera.transform import CameraResult
from torchweather.datasets import boxes_from_nuscenes, write_nuscenes_boxes
from torchweather.datasets.box_projection import box_corners, project_boxes
from torchweather.datasets.box_update import update_boxes
from torchweather.datasets.boxes import Boxes, points_in_boxes
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import AsBayer, BayerFog, LidarFog, LidarRain, RadarAttenuation

SENSOR = Lidar.preset("velodyne-hdl-64e")
# x = -y, y = -z, z = x of the LiDAR.
MOUNTING = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def wall(range_m: float, rows: int, intensity: float) -> torch.Tensor:
    y = torch.linspace(-0.9, 0.9, rows)
    x = (range_m**2 - y.square()).sqrt()  # all at one range
    return torch.stack((x, y, torch.zeros(rows), torch.full((rows,), intensity)), dim=1)


def cars(*centres_m: float) -> Boxes:
    centre = torch.tensor([[x, 0.0, 0.0] for x in centres_m])
    count = len(centres_m)
    return Boxes(centre, torch.tensor([[4.0, 2.0, 2.0]]).expand(count, 3), torch.zeros(count), ("Car",) * count)


def test_fog_takes_the_far_car_and_leaves_the_near_one() -> None:
    near, far = wall(12.0, 40, 200.0), wall(60.0, 30, 30.0)
    points = torch.cat((near, far))
    fog = LidarFog(Fog(mor_m=60), SENSOR)
    result = fog.run(points, fog.draw(points, seed=3))
    first, second = update_boxes(cars(12.0, 60.0), result, points).records
    assert (first["lidar_points_before"], second["lidar_points_before"]) == (40, 30)
    # exp(-2 alpha R), Beer-Lambert, all points of a car at one range; the lasers sit up to 0.2 m higher, which is 2 mm.
    alpha = float(fog.extinction_per_m)
    assert first["lidar_transmission"] == pytest.approx(math.exp(-2 * alpha * 12.0), rel=3e-4)
    assert second["lidar_transmission"] == pytest.approx(math.exp(-2 * alpha * 60.0), rel=1e-4)
    inside = points_in_boxes(result.points, cars(12.0, 60.0)) & (result.kind == 0)[:, None]
    assert [first["lidar_points_left"], second["lidar_points_left"]] == inside.sum(0).tolist()
    assert second["lidar_points_left"] == 0 < first["lidar_points_left"]


def test_without_the_cloud_before_only_what_is_left_is_counted() -> None:
    points = torch.cat((wall(12.0, 40, 200.0), wall(60.0, 30, 30.0)))
    fog = LidarFog(Fog(mor_m=60), SENSOR)
    result = fog.run(points, fog.draw(points, seed=3))
    first, second = update_boxes(cars(12.0, 60.0), result).records
    whole = update_boxes(cars(12.0, 60.0), result, points).records
    assert first["lidar_points_left"] == whole[0]["lidar_points_left"]
    assert "lidar_points_before" not in first
    assert second["lidar_transmission"] is None
    assert first["lidar_transmission"] == pytest.approx(whole[0]["lidar_transmission"], rel=1e-5)
    # A flake inside the box is no return of the car.
    one = replace(result, kind=torch.where(torch.arange(len(points)) == 0, 1, result.kind))
    assert update_boxes(cars(12.0, 60.0), one).records[0]["lidar_points_left"] == first["lidar_points_left"] - 1


def test_a_sample_without_weather_keeps_all_its_points() -> None:
    points = torch.cat((wall(12.0, 40, 200.0), torch.zeros(1, 4)))
    first, second = update_boxes(cars(12.0, 60.0), None, points).records
    assert first == {"lidar_points_before": 40, "lidar_points_left": 40, "lidar_transmission": 1.0}
    assert second == {"lidar_points_before": 0, "lidar_points_left": 0, "lidar_transmission": None}
    with pytest.raises(ValueError, match="points are wanted"):
        update_boxes(cars(12.0), None)


def test_dropped_points_count_as_zeroed_ones_do() -> None:
    points = torch.cat((wall(12.0, 40, 200.0), wall(60.0, 30, 30.0)))
    zeroed, dropped = (LidarRain(Rain(rate_mm_per_h=100), SENSOR, lost=lost) for lost in ("zero", "drop"))
    noise = zeroed.draw(points, seed=5)
    records = [update_boxes(cars(12.0, 60.0), fog.run(points, noise), points).records for fog in (zeroed, dropped)]
    for one, other in zip(*records, strict=True):
        assert one["lidar_points_left"] == other["lidar_points_left"]
        assert one["lidar_points_before"] == other["lidar_points_before"]


def test_a_radars_boxes_keep_the_share_of_the_power() -> None:
    radar = RadarAttenuation(Rain(rate_mm_per_h=50), Radar.preset("imaging-77ghz"))
    points = torch.tensor([[50.0, 0.0, 0.0, -3.0, -95.0, 10.0], [52.0, 0.5, 0.0, -3.0, -140.0, -30.0]])
    result = radar.run(points, radar.draw(points, seed=0))
    (record,) = update_boxes(cars(51.0), result, points).records
    share = (10 ** (-result.attenuation_db / 10)).mean().item()
    assert record["radar_points_before"] == 2
    assert record["radar_points_left"] == int((result.kind == 0).sum())
    assert record["radar_transmission"] == pytest.approx(share, rel=1e-6)
    assert 0.5 < share < 1.0


def test_nuscenes_counts_are_replaced_and_the_rest_stays(tmp_path: Path) -> None:
    note = {"translation": [12, 0, 0], "size": [2, 4, 2], "rotation": [1, 0, 0, 0], "token": "a", "num_lidar_pts": 99}
    boxes = boxes_from_nuscenes([{**note, "num_radar_pts": 5}])
    points = torch.cat((wall(12.0, 40, 200.0), wall(60.0, 30, 30.0)))
    fog = LidarFog(Fog(mor_m=60), SENSOR)
    updated = update_boxes(boxes, fog.run(points, fog.draw(points, seed=3)), points)
    assert boxes.records[0]["num_lidar_pts"] == 99
    write_nuscenes_boxes(tmp_path / "boxes.json", updated)
    (written,) = json.loads((tmp_path / "boxes.json").read_text())
    assert written["num_lidar_pts"] == written["lidar_points_left"] == updated.records[0]["lidar_points_left"] < 41
    assert (written["token"], written["num_radar_pts"]) == ("a", 5)


def test_a_rectangle_is_the_outline_of_the_projected_corners() -> None:
    camera = Camera.from_intrinsics(fx=100, fy=100, cx=50, cy=40, width=101, height=81)
    turned = replace(cars(12.0), yaw_rad=torch.tensor([math.pi / 2]))  # 2 m along x, 4 m along y
    boxes = [cars(12.0), turned, cars(-12.0), replace(cars(12.0), centre_m=torch.tensor([[12.0, 40.0, 0.0]])), cars(1)]
    left, top, right, bottom = project_boxes(boxes[0], camera, MOUNTING)[0].tolist()
    assert (left, top, right, bottom) == pytest.approx((40, 30, 60, 50))  # nearest face at 10 m, 1 m to all sides
    assert project_boxes(boxes[1], camera, MOUNTING)[0].tolist() == pytest.approx(
        [50 - 200 / 11, 40 - 100 / 11, 50 + 200 / 11, 40 + 100 / 11], rel=1e-6
    )
    for hidden in boxes[2:]:  # behind, beside, around the camera
        assert project_boxes(hidden, camera, MOUNTING).isnan().all()
    oblique = replace(cars(12.0), yaw_rad=torch.tensor([0.5]))
    arms = box_corners(oblique)[0] - oblique.centre_m
    assert points_in_boxes(oblique.centre_m + 0.999 * arms, oblique).all()
    assert not points_in_boxes(oblique.centre_m + 1.001 * arms, oblique).any()


def made(transmission: torch.Tensor, mask: torch.Tensor) -> CameraResult:
    return CameraResult(transmission[None], transmission[None], torch.zeros(3), mask[None])


def test_camera_means_are_those_of_the_rectangles_pixels() -> None:
    image = torch.rand(20, 30, generator=torch.Generator().manual_seed(1))
    mask = torch.rand(20, 30, generator=torch.Generator().manual_seed(2))
    nan = math.nan
    rectangles = torch.tensor([[2.0, 3.0, 9.0, 8.0], [2.2, 2.5, 9.9, 8.4], [-5, -5, 99, 99], [nan, nan, nan, nan]])
    boxes = cars(10.0, 20.0, 30.0, 40.0)
    records = update_boxes(boxes, made(image, mask), rectangles=rectangles).records
    by_hand = [image[3:9, 2:10], image[3:9, 3:10], image]
    for record, pixels in zip(records, by_hand, strict=False):
        assert record["camera_transmission"] == pytest.approx(pixels.mean().item(), rel=1e-5)
    assert records[0]["camera_particle_cover"] == pytest.approx(mask[3:9, 2:10].mean().item(), rel=1e-5)
    assert records[3]["camera_transmission"] is None
    outside = torch.tensor([[40.0, 3.0, 50.0, 8.0], [4.2, 3, 4.8, 8], [9, 8, 2, 3], [0, 0, 0, 0]])
    found = [r["camera_transmission"] for r in update_boxes(boxes, made(image, mask), rectangles=outside).records]
    assert found[:3] == [None, None, None]
    assert found[3] == pytest.approx(image[0, 0].item(), rel=1e-6)


def test_kitti_records_bring_their_own_rectangles_and_an_rgb_image_counts_too() -> None:
    camera = Camera.from_intrinsics(fx=40, fy=40, cx=19.5, cy=14.5, width=40, height=30)
    fog = AsBayer(BayerFog(Fog(mor_m=50), camera, depth=40.0, airlight=0.7))
    result = fog.run(torch.full((3, 30, 40), 60, dtype=torch.uint8))
    assert isinstance(result, RgbResult)
    boxes = replace(cars(12.0), records=({"bbox": [5.0, 5.0, 15.0, 15.0]},))
    (record,) = update_boxes(boxes, result).records
    # At the same depth everywhere; the ray to a corner is longer: 40 to 50 m.
    assert math.exp(-50 * math.log(20) / 50) < record["camera_transmission"] < math.exp(-40 * math.log(20) / 50)
    assert record["bbox"] == [5.0, 5.0, 15.0, 15.0]


def test_what_cannot_be_updated_is_refused() -> None:
    points = wall(12.0, 4, 200.0)
    fog = LidarFog(Fog(mor_m=60), SENSOR)
    batch = torch.stack((points, points))
    with pytest.raises(ValueError, match="one sample"):
        update_boxes(cars(12.0), fog.run(batch, fog.draw(batch, seed=1)), points)
    dropping = LidarFog(Fog(mor_m=60), SENSOR, lost="drop")
    with pytest.raises(ValueError, match="a list of 2 clouds"):
        update_boxes(cars(12.0), dropping.run(batch, dropping.draw(batch, seed=1)), points)
    image = torch.zeros(4, 4)
    with pytest.raises(ValueError, match="project_boxes"):
        update_boxes(cars(12.0), made(image, image))
    with pytest.raises(ValueError, match=r"rectangles must be \(1, 4\)"):
        update_boxes(cars(12.0), made(image, image), rectangles=torch.zeros(2, 4))
    stacked = CameraResult(*(torch.zeros(2, 1, 4, 4),) * 4)
    with pytest.raises(ValueError, match="one image"):
        update_boxes(cars(12.0), stacked, rectangles=torch.zeros(1, 4))
    with pytest.raises(TypeError, match=r"result must be .*; got torch.float32"):
        update_boxes(cars(12.0), points)  # type: ignore[arg-type]
