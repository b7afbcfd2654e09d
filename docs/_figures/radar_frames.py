"""Radar frames of the pictures of effects: made targets at rest, seen by the embedded AWR1843-like radar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from effect_curves import Array

import torchweather as tw
from torchweather.atmosphere.weather import Weather

__all__ = ["CLASSES", "CLEAR_AIR", "HEAVY_RAIN", "RAIN", "SENSOR", "Frames", "Targets", "frames_of", "targets_of"]

SENSOR = tw.Radar.preset("awr1843-like")
CLEAR_AIR, RAIN, HEAVY_RAIN = tw.Rain(0.0), tw.Rain(25.0), tw.Rain(50.0)
CLASSES = ("car", "person", "bush")
NEAR_M, FAR_M, VIEW_DEG, MOST_MARGIN_DB = 5.0, 65.0, 50.0, 25.0
SPEED_NOISE_M_PER_S, POWER_NOISE_DB = 0.03, 0.4  # of clear frames: a quarter of a bin, and that of an SNR of 24 dB


@dataclass(frozen=True)
class Targets:
    """What the radar detects in clear air; ``(N,)`` each."""

    points: torch.Tensor
    range_m: Array
    azimuth_deg: Array
    margin_db: Array
    kind: Array


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, N)`` of the targets and ``(F, K, 6)`` of what is listed besides; lost is NaN.

    ``setting``: parameters of the effect; empty without one.
    """

    power_db: Array
    snr_db: Array
    speed_m_per_s: Array
    range_m: Array
    floor_db: Array
    more: Array
    setting: Mapping[str, Any]


def targets_of(count: int) -> Targets:
    """Spread evenly, in an order that mixes ranges, azimuths, margins and classes."""
    even = torch.quasirandom.SobolEngine(4, scramble=True, seed=7).draw(count).double()
    range_m = NEAR_M + (FAR_M - NEAR_M) * even[:, 0]
    azimuth = torch.deg2rad(VIEW_DEG * (2.0 * even[:, 1] - 1.0))
    margin_db = MOST_MARGIN_DB * even[:, 2]
    power_db = SENSOR.floor_db + SENSOR.detection_snr_db + margin_db
    nothing = torch.zeros_like(range_m)
    columns = [range_m * azimuth.cos(), range_m * azimuth.sin(), nothing, nothing, power_db, nothing]
    kind = (len(CLASSES) * even[:, 3]).floor()
    values = (range_m, torch.rad2deg(azimuth), margin_db, kind.long())
    return Targets(torch.stack(columns, -1), *(value.numpy() for value in values))


def frames_of(targets: Targets, weather: Weather, effect: Mapping[str, Any], count: int) -> Frames:
    """Frames in the weather, each of a clear frame with noise of its own; the same draws for all effects."""
    transform = tw.RadarAttenuation(weather, SENSOR, effects=[effect] if effect else [])
    points = targets.points.repeat(count, 1, 1)
    noise = torch.randn(2, *points.shape[:2], generator=torch.Generator().manual_seed(1), dtype=points.dtype)
    points[..., 3] += SPEED_NOISE_M_PER_S * noise[0]
    threshold_db = SENSOR.floor_db + SENSOR.detection_snr_db  # what is listed lies above
    points[..., 4] = (points[..., 4] + POWER_NOISE_DB * noise[1]).clamp_min(threshold_db)
    known = {"target_class": torch.from_numpy(targets.kind), "frame_number": torch.arange(count)}
    state = transform.state_of(points, **known)
    with torch.no_grad():
        found = transform.chain(state, transform.chain.draw(state, seed=torch.arange(count)))
    rows = targets.points.shape[0]
    lost = (found.returns.kind == tw.PointKind.LOST)[..., None]
    listed = torch.where(lost, torch.nan, found.returns.points).numpy()
    own, more = listed[:, :rows], listed[:, rows:]
    snr_db = torch.where(lost[:, :rows, 0], torch.nan, found.returns.snr_db[:, :rows]).numpy()
    range_m = np.linalg.norm(own[..., :3], axis=-1)
    setting = {name: value for name, value in effect.items() if name != "effect"}
    return Frames(own[..., 4], snr_db, own[..., 3], range_m, found.floor_db.numpy(), more, setting)
