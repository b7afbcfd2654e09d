"""Recordings of real cameras in rain, fog and snow: read, run, in range, and untouched where there is no weather.

Skipped, visibly, where ``TORCHWEATHER_REAL_DATA`` is unset.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.datasets import (
    read_kitti_calibration,
    read_kitti_points,
    read_nuscenes_calibration,
    read_nuscenes_points,
)
from torchweather.image import DepthFromPoints, FlatGround
from torchweather.io import read_image
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerWeather

pytestmark = pytest.mark.real_data

Find = Callable[[str], Path]
LIGHT = (0.5, 0.5, 0.5)
FALLING: dict[str, Weather] = {"rain": Rain(50.0), "snow": Snow(3.0)}
IDENTITY = Mixture(Rain(0.0), Snow(0.0), Fog(math.inf))
# 20 bits of light in 12 by two knees: a generic curve (unverified), the recording does not say its own.
KNOTS = ((0.0, 0.0), (2**11 / 2**20, 0.5), (2**16 / 2**20, 0.75), (1.0, 1.0))


@pytest.fixture
def find() -> Find:
    return recording


def lidar_depth(image: Path, cloud: Tensor, matrix: Tensor, transform: Tensor) -> tuple[Tensor, Camera, Tensor]:
    rgb, info = read_image(image)
    assert info.kind == "rgb"
    height, width = rgb.shape[-2:]
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera.from_intrinsics(fx, fy, cx, cy, width, height)
    return rgb, camera, DepthFromPoints(cloud, transform)(camera, height, width)


def kitti(find: Find) -> tuple[Tensor, Camera, Tensor]:
    folder = "kitti_nuscenes_demo/kitti/000008"
    known = read_kitti_calibration(find(f"{folder}.txt"))
    cloud = read_kitti_points(find(f"{folder}.bin"))
    return lidar_depth(find(f"{folder}.png"), cloud, known.camera_matrix, known.T_camera_from_lidar)


def nuscenes(find: Find) -> tuple[Tensor, Camera, Tensor]:
    folder = "kitti_nuscenes_demo/nuscenes/"
    known = read_nuscenes_calibration(find(f"{folder}*calib.json"))
    cloud = read_nuscenes_points(find(f"{folder}*.pcd.bin"))
    return lidar_depth(find(f"{folder}*CAM_FRONT*.jpg"), cloud, known.camera_matrix, known.T_camera_from_lidar)


def raw(find: Find, **more: object) -> tuple[Tensor, Camera]:
    """The 12-bit frame of a snowy day; its calibration is for 1920 x 1024 with k1 only."""
    bayer, info = read_image(find("stf_raw/*.tiff"))
    assert info.kind == "mosaic"
    calibration = json.loads(find("stf_raw/calib*.json").read_text(encoding="utf-8"))
    k, height, width = calibration["K"], *bayer.shape[-2:]
    camera = Camera.from_intrinsics(
        k[0], k[4], k[2], k[5], width, height, bayer_pattern="GRBG", black_level=370.0, bit_depth=12, **more
    )
    return bayer, camera


FRAMES = {"kitti": kitti, "nuscenes": nuscenes}
every_frame = pytest.mark.parametrize("name", list(FRAMES))


@every_frame
def test_an_image_in_fog_keeps_its_format_and_loses_the_far_scene_first(find: Find, name: str) -> None:
    rgb, camera, depth = FRAMES[name](find)
    fog = AsBayer(BayerWeather(Fog(60.0), camera, airlight=LIGHT))
    before = rgb.clone()
    result = fog.run(rgb, depth, {})
    assert torch.equal(rgb, before)
    assert result.rgb.dtype == torch.uint8
    assert result.rgb.shape == rgb.shape
    # MOR 60 m: the contrast of 5 % at 60 m along the ray, less beyond; Mie over the bands within a few percent.
    at_mor = (depth > 57) & (depth < 60)
    if bool(at_mor.any()):
        assert 0.03 < float(result.transmission[at_mor].mean()) < 0.07
    near, far = depth < 10, depth > 100
    assert float(result.transmission[near].min()) > 0.5
    assert float(result.transmission[far].max()) < 0.01
    # Far pixels show the airlight, grey as it is; but for those beside near things, into which demosaicing rings.
    shown = result.rgb[:, far[0]].float()
    assert float((shown - shown.median()).abs().flatten()[::7].quantile(0.99)) < 6


@every_frame
@pytest.mark.parametrize("kind", list(FALLING))
def test_an_image_in_rain_and_snow_keeps_its_format_and_hides_behind_near_things(
    find: Find, name: str, kind: str
) -> None:
    rgb, camera, depth = FRAMES[name](find)
    transform = AsBayer(BayerWeather(FALLING[kind], camera, airlight=LIGHT))
    noise = transform.draw(rgb, seed=3)
    result = transform.run(rgb, depth, noise)
    mask = result.particle_mask
    assert result.rgb.dtype == torch.uint8
    assert result.rgb.shape == rgb.shape
    assert 0.0 <= float(mask.min()) <= float(mask.max()) <= 1.0
    assert float(mask[depth < 8].mean()) < float(mask[depth > 50].mean())
    assert 0.005 < float(mask.mean()) < 0.5
    assert torch.equal(transform(rgb, depth, noise), result.rgb)


@every_frame
def test_no_weather_gives_a_real_image_back_bit_for_bit(find: Find, name: str) -> None:
    rgb, camera, depth = FRAMES[name](find)
    transform = AsBayer(BayerWeather(IDENTITY, camera, airlight=LIGHT))
    assert torch.equal(transform(rgb, depth), rgb)


@pytest.mark.parametrize("knots", [None, KNOTS], ids=["as if linear", "companded"])
@pytest.mark.parametrize("weather", [Rain(50.0), Fog(60.0), Snow(3.0)], ids=lambda weather: str(weather.kind))
def test_a_real_raw_frame_stays_raw(find: Find, weather: Weather, knots: object) -> None:
    bayer, camera = raw(find, response_knots=knots, k1=-0.567575)
    transform = BayerWeather(weather, camera, depth=FlatGround(), airlight=0.3)
    result = transform.run(bayer, None, transform.draw(bayer, seed=3))
    values = result.bayer.to(torch.int32)
    assert result.bayer.dtype == torch.uint16
    assert result.bayer.shape == bayer.shape
    assert int(values.min()) >= 370
    assert int(values.max()) <= 4095
    assert not torch.equal(values, bayer.to(torch.int32))


@pytest.mark.parametrize("knots", [None, KNOTS], ids=["as if linear", "companded"])
def test_no_weather_gives_a_real_raw_frame_back_bit_for_bit(find: Find, knots: object) -> None:
    bayer, camera = raw(find, response_knots=knots)
    transform = BayerWeather(IDENTITY, camera, depth=FlatGround(), airlight=0.3)
    assert torch.equal(transform(bayer).to(torch.int32), bayer.to(torch.int32))
