"""A small organised scan in rain, for tests of the effects of LiDAR."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain
from torchweather.sensors import Lidar
from torchweather.stages import EFFECTS, Chain, Effect, LidarState
from torchweather.transforms import LidarRain, LidarWeather

ROWS, COLUMNS = 8, 64
BEAMS = ROWS * COLUMNS

# Settings at which each effect shows in the scene.
ACTIVE: dict[str, dict[str, float]] = {
    "lidar.beam_divergence": {"extra_mrad": 8.0},
    "lidar.isolated_return_filter": {"probability": 0.9, "radius_m": 1.5},
    "lidar.threshold_shift": {"shift_db": 4.0},
    "lidar.window_loss": {"loss_db": 3.0},
    "lidar.extinction_scale": {"factor": 3.0},
    "lidar.wet_target": {"share": 0.5},
    "lidar.blind_zone": {"range_m": 12.0, "loss_db": 25.0},
    "lidar.range_noise": {"std_m": 0.2},
    "lidar.range_bias": {"offset_m": 0.1, "walk_m_per_decade": -0.25},
    "lidar.limited_extent": {"extent_m": 10.0},
    "lidar.last_return": {"probability": 0.8},
    "lidar.static_structure": {"azimuth_rad": 1.0, "range_m": 9.0, "width_rad": 0.75},
    "lidar.intensity_compression": {"exponent": 0.5, "saturation": 0.25},
    "lidar.range_stretch": {"m_per_optical_depth": 2.0},
    "lidar.crosstalk": {"probability": 0.125},
    "lidar.particle_backscatter": {"gain_db": 9.0},
    "lidar.sector_loss": {"azimuth_rad": 3.0, "width_rad": 1.5, "loss_db": 5.0},
    "lidar.patchy_weather": {"log_std": 0.75},
    "lidar.spray": {"strength": 2.0, "azimuth_rad": 3.0, "width_rad": 1.5},
    "lidar.ring_gain": {"db_per_ring": 0.5},
    "lidar.particle_density_azimuth": {
        "amplitude": 4.0,
        "azimuth_rad": 3.0,
        "width_rad": 1.5,
        "wind_amplitude": 0.5,
        "wind_azimuth_rad": 1.5,
    },
    "lidar.particle_density_elevation": {
        "amplitude": 4.0,
        "elevation_rad": -0.1,
        "width_rad": 0.25,
        "steepness": 2.0,
    },
    "lidar.particle_sizes": {
        "factor_1mm": 4.0,
        "factor_2mm": 0.5,
        "factor_4mm": 2.0,
        "factor_8mm": 0.5,
    },
    "lidar.shared_particles": {"share": 1.0, "width_factor": 30.0},
    "lidar.near_response": {"full_m": 16.0, "power": 2.0},
    "lidar.snow_cover": {"depth_mm": 5.0, "reflectivity": 0.5, "uneven": 0.5},
    "lidar.road_spray": {
        "water_g_per_m": 30.0,
        "drop_mm": 0.25,
        "distance_m": 15.0,
        "lateral_m": 0.5,
        "length_m": 20.0,
        "height_m": 0.75,
        "uneven": 0.5,
        "sensor_height_m": 1.5,
    },
}


# Fields of a state whose ``None`` stands for 1.
OF_ONE = ("density_scale", "threshold_scale", "beam_density", "path_density", "size_factors")


def active(name: str, **more: Any) -> Effect:
    """An effect at a setting that shows."""
    return EFFECTS[name](**(ACTIVE[name] | more))


def scan_sensor(**more: Any) -> Lidar:
    """A sensor that sees particles from 0.9 m on."""
    sensor = Lidar(
        wavelength_nm=905.0,
        range_at_10_percent_m=60.0,
        elevations_deg=tuple(-15.0 + 25.0 * row / (ROWS - 1) for row in range(ROWS)),
        columns=COLUMNS,
    ).with_hahner_overlap()
    return replace(sensor, **more)


def directions() -> Tensor:
    """Unit vectors of the scan, ``(N, 3)``, row after row."""
    elevation = torch.tensor(scan_sensor().elevations_deg).deg2rad()[:, None].expand(ROWS, COLUMNS)
    azimuth = (2.0 * math.pi / COLUMNS * (torch.arange(COLUMNS) + 0.5))[None].expand(ROWS, COLUMNS)
    parts = elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()
    return torch.nn.functional.normalize(torch.stack(parts, -1).reshape(-1, 3), dim=-1)


def cloud(batch: int = 3) -> Tensor:
    """Objects at 2 to 60 m, a fifth of the beams without return; every sample another, ``(B, N, 4)``."""
    generator = torch.Generator().manual_seed(5)
    range_m = 2.0 + 58.0 * torch.rand(batch, BEAMS, 1, generator=generator)
    range_m[:, ::5] = 0.0
    bright = 0.02 + 0.9 * torch.rand(batch, BEAMS, 1, generator=generator)
    return torch.cat([directions() * range_m, torch.where(range_m > 0, bright, 0.0)], -1)


def rain(**more: Any) -> LidarWeather:
    """Heavy rain, seen by the sensor of the scan."""
    return LidarRain(Rain(50.0), scan_sensor(), **more)


def begin(transform: LidarWeather, batch: int = 3, dtype: torch.dtype = torch.float32) -> LidarState:
    """The state in front of the chain, with the geometry of the surfaces."""
    state = transform.state_of(cloud(batch).to(dtype), directions().to(dtype))
    generator = torch.Generator().manual_seed(6)
    cosine, up = torch.rand(2, 1, BEAMS, generator=generator).to(dtype)
    return state.changed(cos_incidence=0.05 + 0.95 * cosine, up=2.0 * up - 1.0)


def own_noise(noise: Mapping[str, Tensor], stage: str) -> dict[str, Tensor]:
    """What one stage needs."""
    return {key.removeprefix(f"{stage}."): value for key, value in noise.items() if key.startswith(f"{stage}.")}


def states(chain: Chain, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, LidarState]:
    """The state after each stage."""
    found = {}
    for name, stage in chain.stages.items():
        state = stage(state, own_noise(noise, name))
        found[name] = state
    return found


def assert_same_state(one: LidarState, other: LidarState, sample: int | slice = slice(None)) -> None:
    """Bit for bit; ``other`` may have echoes more, which are then empty, and fields that ``one`` leaves unset."""
    for field in LidarState.part_of:
        first, second = one.field(field), other.field(field)
        if not isinstance(first, Tensor):
            if field in OF_ONE and second is not None:
                assert (second[sample] == 1.0).all()
            elif field in ("extra_divergence_rad", "extra_near_power") and second is not None:
                assert (second[sample] == 0.0).all()
            elif field != "extra_near_full_m":  # says where alone
                assert first == second, field
            continue
        if first.ndim and first.shape[0] > 1:
            first, second = first[sample], second[sample]
        if field in ("range_m", "signal", "kind"):
            more = second[..., first.shape[-1] :]
            assert (more == 0).all(), field
            second = second[..., : first.shape[-1]]
        assert torch.equal(first, second), field
