"""A small street for tests of water and snow on things: a frame, a cloud and the sensors that took them."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth import FlatGround
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import BayerWeather

H, W = 64, 96
CAMERA = Camera.from_intrinsics(100.0, 100.0, (W - 1) / 2, (H - 1) / 2, W, H, height_m=1.5)
LIDAR = Lidar(wavelength_nm=905.0, intensity_unit="reflectivity")
RADAR = Radar.preset("imaging-77ghz")
ROAD_INTENSITY, WALL_INTENSITY = 0.1, 0.4


def frame(batch: tuple[int, ...] = ()) -> Tensor:
    return (0.1 + 0.5 * torch.rand(*batch, 1, H, W, generator=torch.Generator().manual_seed(4))).float()


def cloud() -> Tensor:
    """A level road 1.7 m below the sensor, and a wall 15 m ahead."""
    x, y = torch.meshgrid(torch.linspace(-14, 14, 60), torch.linspace(-14, 14, 60), indexing="ij")
    road = torch.stack([x, y, torch.full_like(x, -1.7), torch.full_like(x, ROAD_INTENSITY)], -1).reshape(-1, 4)
    y, z = torch.meshgrid(torch.linspace(-4, 4, 20), torch.linspace(0.0, 3.0, 20), indexing="ij")
    wall = torch.stack([torch.full_like(y, 15.0), y, z, torch.full_like(y, WALL_INTENSITY)], -1).reshape(-1, 4)
    return torch.cat([road, wall])


def camera_in(weather: Weather, **more: Any) -> BayerWeather:
    return BayerWeather(weather, CAMERA, depth=FlatGround(), airlight=0.7, **more)
