"""Small studies of every kind, made of random numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study
from torchweather.sensors import Camera, Lidar, Radar

H, W, N, T, L, P = 4, 6, 5, 40, 3, 2
LIDAR = Lidar.preset(
    "ouster-os1-128",
    range_at_10_percent_m=33.3,
    intensity_unit="reflectivity",
    elevations_deg=None,
    columns=None,
    azimuth_offsets_deg=None,
    origin_heights_m=None,
)
CAMERA = Camera.from_intrinsics(20.0, 20.0, 2.5, 1.5, W, H, exposure_s=0.002)
RADAR = Radar.preset("imaging-77ghz", detection_snr_db=9.0)
WEATHERS: list[Any] = [
    {"kind": "rain", "rate_mm_per_h": 25, "rate_rel_sd": 0.1},
    {"kind": "fog", "mor_m": 50.0, "mor_rel_sd": 0.2},
    {"kind": "snow", "rate_mm_per_h": 1.5, "rate_rel_sd": 0.3},
    {"kind": "clear"},
]


def lidar_frame(rng: np.random.Generator) -> dict[str, Any]:
    there = np.arange(H * W).reshape(H, W) % 5 > 0  # the same beams in every frame, as of a scene that stands
    return {
        "range_m": np.where(there, 20.0 + 0.02 * rng.standard_normal((H, W)), 0.0),
        "intensity": np.where(there, rng.random((H, W)), 0.0).astype(np.float32),
    }


def camera_frame(rng: np.random.Generator) -> dict[str, Any]:
    return {"bayer": rng.random((H, W)).astype(np.float32)}


def radar_frame(rng: np.random.Generator) -> dict[str, Any]:
    there = rng.random(N) < 0.7
    return {
        "power_db": np.where(there, -70.0 + rng.standard_normal(N), np.nan),
        "range_m": np.where(there, 30.0 + rng.standard_normal(N), np.nan),
        "speed_m_per_s": np.where(there, rng.standard_normal(N), np.nan),
        "noise_floor_db": np.array(-100.0),
        "clutter": rng.random((3, 6)),
    }


FRAMES: dict[str, Callable[[np.random.Generator], dict[str, Any]]] = {
    "lidar": lidar_frame,
    "camera": camera_frame,
    "radar": radar_frame,
}
SENSORS = {"lidar": LIDAR, "camera": CAMERA, "radar": RADAR}
KINDS = ("lidar", "camera", "radar", "link")


def directions(rng: np.random.Generator) -> Any:
    found = rng.standard_normal((H, W, 3))
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def geometry(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    if kind == "lidar":
        return {"cos_incidence": rng.random((H, W)), "up": rng.random((H, W))}
    if kind == "camera":
        normal = directions(rng)
        normal[0] = np.nan
        depth_m = 5.0 + 50.0 * rng.random((H, W))
        depth_m[0] = np.inf
        return {"depth_m": depth_m, "normal": normal, "label": np.arange(H * W).reshape(H, W)}
    return {
        "range_m": 30.0 + rng.random(N),
        "azimuth_rad": rng.random(N),
        "elevation_rad": 0.1 * rng.random(N),
        "speed_m_per_s": rng.standard_normal(N),
        "target_class": np.arange(N),
    }


def links(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "length_km": np.array([1.0, 2.0, 4.0]),
        "frequency_ghz": 20.0 + rng.random(L),
        "polarisation": np.array([0, 1, 1]),
        "split": np.array([0, 0, 1]),
    }


def series(rng: np.random.Generator) -> dict[str, Any]:
    rain = np.zeros((T, L, P))
    rain[25:30] = 10.0 * rng.random((5, L, P))
    return {
        "time_s": 60.0 * np.arange(T),
        "attenuation_db": rng.random((T, L)),
        "rain_mm_per_h": rain,
    }


def arguments(kind: str, *, clear: int = 8, frames: int = 5, seed: int = 0) -> dict[str, Any]:
    """What `Study.from_arrays` takes for a study that lacks nothing (two scenes)."""
    rng = np.random.default_rng(seed)
    if kind == "link":
        return {"links": links(rng), "conditions": [{"id": "series", "frames": [series(rng)]}]}
    frame = FRAMES[kind]
    conditions = [
        {
            "id": f"c{place}",
            "scene": f"s{place % 2}",
            "weather": weather,
            "frames": [frame(rng) for _ in range(frames)],
            "time_s": [0.1 * k for k in range(frames)],
        }
        for place, weather in enumerate([*WEATHERS, {**WEATHERS[0], "rate_mm_per_h": 5.0}])
    ]
    conditions[0] |= {"ego_speed_m_per_s": 13.9, "exposure_s": 0.004}
    given: dict[str, Any] = {
        "sensor": SENSORS[kind],
        "scenes": [
            {"id": f"s{k}", "clear": [frame(rng) for _ in range(clear)], "geometry": geometry(kind, rng)}
            for k in range(2)
        ],
        "conditions": conditions,
    }
    return {**given, "beams": {"direction": directions(rng)}} if kind == "lidar" else given


def study(kind: str, **more: Any) -> Study:
    return Study.from_arrays(**arguments(kind, **more))
