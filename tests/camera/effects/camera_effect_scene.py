"""A small raw frame in weather, for tests of the effects of cameras."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain
from torchweather.sensors import Camera
from torchweather.stages import EFFECTS, CameraState, Effect
from torchweather.transforms import BayerWeather

H, W, FOCAL_PX = 32, 48, 100.0
LIGHT = (0.6, 0.7, 0.8)
CAMERA_EFFECTS = [name for name in EFFECTS if name.startswith("camera.")]

# Settings at which each effect shows in the scene.
ACTIVE: dict[str, dict[str, float]] = {
    "camera.exposure_gain": {"factor": 0.75},
    "camera.airlight_scale": {"red": 0.5, "green": 0.75, "blue": 1.125},
    "camera.extinction_scale": {"factor": 2.0, "wavelength_exponent": 1.0},
    "camera.stray_light": {"offset": 0.0625, "share": 0.125},
    "camera.aerosol_glow": {"share_per_optical_depth": 0.5, "width_px_per_optical_depth": 4.0},
    "camera.defocus": {"radius_px": 2.5},
    "camera.ego_blur": {"length_px": 6.0, "angle_rad": 0.5},
    "camera.adherent_drops": {"cover": 0.25},
    "camera.vignetting": {"strength": 2.0},
    "camera.wind_slant": {"angle_rad": 0.5},
    "camera.wet_surface": {"darkening": 0.25, "mirror": 0.75},
    "camera.sensor_noise": {"electrons_per_unit": 500.0, "read_electrons": 8.0},
    "camera.tone_curve": {"gamma": 0.75},
    "camera.saturation": {"level": 0.375},
    "camera.patchy_fog": {"log_std": 0.5},
    "camera.height_fog": {"scale_height_m": 4.0},
    "camera.streak_contrast": {"factor": 2.0},
    "camera.particle_count": {"factor": 2.0, "depth_max_m": 6.0},
    "camera.rolling_shutter": {"row_time_s": 2.5e-4},
    "camera.snow_cover": {"depth_mm": 4.0, "albedo": 0.875, "uneven": 0.5},
    "camera.road_spray": {
        "water_g_per_m": 8.0,
        "drop_mm": 0.25,
        "distance_m": 15.0,
        "lateral_m": 0.5,
        "length_m": 20.0,
        "height_m": 0.75,
        "uneven": 0.5,
    },
    "camera.refracting_drops": {"cover": 0.25, "blur_px": 2.0, "contact_deg": 45.0},
}


def active(name: str, **more: Any) -> Effect:
    """An effect at a setting that shows."""
    return EFFECTS[name](**(ACTIVE[name] | more))


def camera(**more: Any) -> Camera:
    return Camera.from_intrinsics(FOCAL_PX, FOCAL_PX, (W - 1) / 2, (H - 1) / 2, W, H, exposure_s=0.01, **more)


def rain_in_fog(weather: Any = None, *, own_camera: Camera | None = None, **more: Any) -> BayerWeather:
    """Heavy rain in fog, from 1 m to 10 m."""
    weather = Mixture(Rain(50.0), Fog(mor_m=60.0)) if weather is None else weather
    return BayerWeather(weather, own_camera or camera(), airlight=LIGHT, near_m=1.0, far_m=10.0, **more)


def frame(batch: int = 3, dtype: torch.dtype = torch.float32) -> Tensor:
    """A picture of all intensities, another one for each sample."""
    return (0.05 + 0.9 * torch.rand(batch, 1, H, W, generator=torch.Generator().manual_seed(5))).to(dtype)


def depth(batch: int = 3) -> Tensor:
    """Surfaces at 2 to 60 m under a sky."""
    depth_m = 2.0 + 58.0 * torch.rand(batch, 1, H, W, generator=torch.Generator().manual_seed(6))
    depth_m[:, :, :6] = math.inf
    return depth_m


def normals() -> Tensor:
    """Level ground in the lower half, walls in between, none in the sky."""
    found = torch.zeros(3, H, W)
    found[0, 6 : H // 2] = -1.0
    found[2, H // 2 :] = 1.0
    return found


def begin(transform: BayerWeather, batch: int = 3, dtype: torch.dtype = torch.float32) -> CameraState:
    """The state in front of the chain."""
    return transform.state_of(frame(batch, dtype), depth(batch).to(dtype), normals())


def colour_of(pattern: tuple[tuple[int, int], tuple[int, int]] = ((0, 1), (1, 2))) -> Tensor:
    """Colour of every pixel, ``(H, W)``; RGGB unless given."""
    return torch.tensor(pattern).repeat(H // 2, W // 2)
