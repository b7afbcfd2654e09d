"""A small list of targets in rain, for tests of the effects of radar."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain
from torchweather.sensors import Radar
from torchweather.stages import EFFECTS, Chain, Effect, RadarState
from torchweather.transforms import RadarAttenuation

TARGETS = 40
RATE_MM_PER_H = 50.0
SENSOR = Radar.preset("awr1843-like")

# Settings at which each effect shows in the scene.
ACTIVE: dict[str, dict[str, Any]] = {
    "radar.wet_radome": {"loss_db": 1.0, "film_db": 0.5, "film_exponent": 0.5, "drying_min": 20.0},
    "radar.volume_clutter": {"share": 4.0},
    "radar.noise_floor": {"shift_db": 4.0},
    "radar.cfar_shift": {"shift_db": 4.0},
    "radar.path_loss_scale": {"factor": 3.0},
    "radar.multipath": {"amplitude": 0.5, "delay_m": 4.0},
    "radar.doppler_spread": {"std_m_per_s": 0.5},
    "radar.wet_rcs": {"gain_db": [2.0, -3.0, 0.5]},
    "radar.interference": {"probability": 1.0, "level_db": 8.0},
    "radar.range_migration": {"m_per_frame": 0.125},
    "radar.pattern_tilt": {"angle_rad": 0.125},
    "radar.fluctuation": {"log_std_db": 3.0},
    "radar.detection_limit": {"max_count": 12.0},
    "radar.road_spray": {
        "water_g_per_m": 4000.0,
        "drop_mm": 1.5,
        "distance_m": 15.0,
        "lateral_m": 0.5,
        "length_m": 20.0,
        "height_m": 0.75,
        "uneven": 0.5,
        "sensor_height_m": 0.5,
    },
}
# They append rows, none where they were built at their identity.
APPENDING = ("radar.volume_clutter", "radar.multipath", "radar.road_spray")


def active(name: str, **more: Any) -> Effect:
    """An effect at a setting that shows."""
    return EFFECTS[name](**(ACTIVE[name] | more))


def detections(batch: int = 3) -> Tensor:
    """Targets at 3 to 60 m, up to 25 dB above the threshold, an eighth of the rows empty; ``(B, N, 7)``."""
    generator = torch.Generator().manual_seed(8)
    range_m, azimuth, elevation, margin, speed, more = torch.rand(6, batch, TARGETS, generator=generator)
    range_m = 3.0 + 57.0 * range_m
    azimuth, elevation = 1.6 * (azimuth - 0.5), 0.2 * (elevation - 0.5)
    range_m[:, ::8] = 0.0
    flat = range_m * elevation.cos()
    power = SENSOR.floor_db + SENSOR.detection_snr_db + 25.0 * margin
    place = [flat * azimuth.cos(), flat * azimuth.sin(), range_m * elevation.sin()]
    return torch.stack([*place, 6.0 * (speed - 0.5), power, 20.0 * more - 5.0, more], -1)


def known() -> dict[str, Tensor]:
    """What some effects need besides the list."""
    return {
        "target_class": torch.arange(TARGETS) % 5 - 1,  # one class unknown, three given, one beyond
        "frame_number": torch.tensor([3.0, 0.0, 7.0]),
        "past_rain_mm_per_h": torch.tensor([200.0, 300.0]),
        "past_rain_min": torch.tensor([5.0, 30.0]),
    }


def rain(**more: Any) -> RadarAttenuation:
    """Heavy rain on the radar of the scene."""
    return RadarAttenuation(Rain(RATE_MM_PER_H), SENSOR, **more)


def begin(transform: RadarAttenuation, batch: int = 3, dtype: torch.dtype = torch.float32) -> RadarState:
    """The state in front of the chain."""
    given = known() if batch == 3 else {key: value for key, value in known().items() if key != "frame_number"}
    return transform.state_of(detections(batch).to(dtype), **given)


def own_noise(noise: Mapping[str, Tensor], stage: str) -> dict[str, Tensor]:
    """What one stage needs."""
    return {key.removeprefix(f"{stage}."): value for key, value in noise.items() if key.startswith(f"{stage}.")}


def states(chain: Chain, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, RadarState]:
    """The state after each stage."""
    found = {}
    for name, stage in chain.stages.items():
        state = stage(state, own_noise(noise, name))
        found[name] = state
    return found


ZERO_FOR_NONE = ("noise_shift_db", "threshold_shift_db", "pattern_tilt_rad", "speed_std_m_per_s")


def assert_same_state(one: RadarState, other: RadarState, sample: int | slice = slice(None)) -> None:
    """Bit for bit; ``other`` may have rows more, which are then empty, and fields that ``one`` leaves unset."""
    for field in RadarState.part_of:
        first, second = one.field(field), other.field(field)
        if isinstance(first, Mapping):
            first, second = first["rain"], second["rain"]
        if not isinstance(first, Tensor):
            if field in ZERO_FOR_NONE and second is not None:
                assert (second[sample] == 0.0).all()
            elif field in ("clutter", "clutter_valid") and second is not None:
                assert (second[sample] == 0).all()
            else:
                assert first == second, field
            continue
        if first.ndim and first.shape[0] > 1:
            first, second = first[sample], second[sample]
        if field in ("kind", "snr_db", "points", "clutter", "clutter_valid"):
            rows = 1 if isinstance(sample, slice) else 0
            count = first.shape[rows]
            more = second.narrow(rows, count, second.shape[rows] - count)
            empty = {"kind": 2, "snr_db": -math.inf}.get(field, 0)
            assert (more == empty).all(), field
            second = second.narrow(rows, 0, count)
        assert torch.equal(first, second), field
