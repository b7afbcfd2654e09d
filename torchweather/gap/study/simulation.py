"""Frames as the ready-made chain simulates them: the base model of a study.

Every optional stage of the chain is at its identity. A simulated frame starts from a clear frame of the same scene that
is drawn at random, and gets no sensor noise of its own: the clear frames carry it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.core.random import keyed_stream
from torchweather.gap.study.study import Condition, Frame, Study
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.physics import rain_attenuation_p838_db_per_km
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.sensor import Radar
from torchweather.radar.transform import RadarAttenuation

__all__ = [
    "DRY_AFTER_S",
    "dry_samples",
    "rain_attenuation_db",
    "simulate",
    "simulated_camera",
    "simulated_lidar",
    "simulated_link",
    "simulated_radar",
    "start_frame",
]

# Samples of a link further than this from any rain on it are dry (GAP.md section 1): the clear set of a link.
DRY_AFTER_S = 900.0
DRIZZLE_MM_PER_H = 0.1  # radars and gauges do not tell less from none
TRANSFORMS_KEPT = 64

Array = NDArray[Any]


def simulate(study: Study, condition: Condition, *, seed: int, number: int = 0) -> Frame:
    """A frame of a condition as the library simulates it.

    Args:
        study: with the sensor and the clear frames.
        condition: weather, scene, and where they apply speed of the vehicle and exposure.
        seed: of the whole simulation.
        number: of the frame; each has a start frame and weather of its own.

    Returns:
        Arrays of the study's kind, as in its own frames. In clear air a clear frame itself.

    Note:
        Beams without return have a direction, so particles can return there. A fluctuating record of the weather
        (``rel_sd``) is not drawn: the intensity is taken as it stands. Radar: no clutter of rain or snow beyond what
        the clear frame has. Links: the loss of rain on the way (ITU-R P.838-3) over dry samples of the same link.

    Example:
        >>> from torchweather.gap.study.embedded import embedded_study
        >>> study = embedded_study("radar", clear_frames=2, frames=1)
        >>> frame = simulate(study, study.conditions[0], seed=1)
        >>> sorted(frame)
        ['noise_floor_db', 'power_db', 'range_m', 'speed_m_per_s']
    """
    if study.kind == "link":
        frame = condition.frames[number % len(condition.frames)]
        return simulated_link(study.links, frame, _stream_seed(seed, condition.id, number))
    scene = study.scene_of(condition)
    clear = scene.clear[start_frame(study, condition, seed=seed, number=number)]
    if condition.weather is None:
        return clear
    drawn = _stream_seed(seed, condition.id, number)
    if isinstance(study.sensor, Lidar):
        return simulated_lidar(clear, study.beams["direction"], condition.weather, study.sensor, drawn)
    if isinstance(study.sensor, Camera):
        camera = study.sensor
        if condition.exposure_s is not None:
            camera = replace(camera, exposure_s=condition.exposure_s)
        depth_m = scene.geometry["depth_m"]
        speed = condition.ego_speed_m_per_s or 0.0
        return simulated_camera(
            clear, depth_m, condition.weather, camera, drawn, ego_speed_m_per_s=speed, airlight=condition.airlight
        )
    assert isinstance(study.sensor, Radar)  # kinds are checked when a study is built
    return simulated_radar(clear, scene.geometry, condition.weather, study.sensor, drawn)


def start_frame(study: Study, condition: Condition, *, seed: int, number: int = 0) -> int:
    """Position of the clear frame that ``simulate`` starts from, drawn at random."""
    count = len(study.scene_of(condition).clear)
    return int(keyed_stream(seed, f"gap.start_frame.{condition.id}.{number}").integers(count))


def _stream_seed(seed: int, condition: str, number: int) -> int:
    """Seed of the weather of one frame."""
    return int(keyed_stream(seed, f"gap.weather.{condition}.{number}").integers(2**62))


# ---- LiDAR -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=TRANSFORMS_KEPT)
def _lidar_transform(weather: Weather, lidar: Lidar) -> LidarWeather:
    return LidarWeather(weather, replace(lidar, directions=None), beam_ends="max_range")


def simulated_lidar(clear: Frame, direction: Array, weather: Weather, lidar: Lidar, seed: int) -> dict[str, Array]:
    """A scan in a weather.

    Args:
        clear: ``range_m (H, W)``, 0 where no return; ``intensity (H, W)`` in the sensor's unit.
        direction: ``(H, W, 3)`` unit vectors.
        weather, lidar: as in ``LidarWeather``.
        seed: of the weather.

    Returns:
        The same arrays. A beam that still reports its object has the clear frame's own range; of a dual-return sensor
        the strongest return counts.
    """
    grid = clear["range_m"].shape
    range_m, intensity = _flat(clear["range_m"]), _flat(clear["intensity"])
    beams = torch.from_numpy(np.array(direction, dtype=np.float32)).reshape(-1, 3)
    points = torch.cat([range_m[:, None] * beams, intensity[:, None]], -1)
    transform = _lidar_transform(weather, lidar)
    with torch.no_grad():
        result = transform.run(points, transform.draw(points, seed=seed), directions=beams)
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    found = torch.linalg.vector_norm(result.points[:, :3], dim=-1)
    found = torch.where(result.kind == PointKind.OBJECT, range_m, found)
    lost = result.kind == PointKind.LOST
    return {
        "range_m": found.masked_fill(lost, 0.0).reshape(grid).numpy(),
        "intensity": result.points[:, 3].masked_fill(lost, 0.0).reshape(grid).numpy(),
    }


def _flat(values: Array) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float32)).reshape(-1)


# ---- camera ----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=TRANSFORMS_KEPT)
def _camera_transform(
    weather: Weather, camera: Camera, ego_speed_m_per_s: float, airlight: tuple[float, float, float] | None
) -> BayerWeather:
    # The frames of a study are linear already.
    linear = replace(camera, response_knots=None)
    return BayerWeather(weather, linear, ego_speed_m_per_s=ego_speed_m_per_s, airlight=airlight)


def simulated_camera(
    clear: Frame,
    depth_m: Array,
    weather: Weather,
    camera: Camera,
    seed: int,
    *,
    ego_speed_m_per_s: float = 0.0,
    airlight: tuple[float, float, float] | None = None,
) -> dict[str, Array]:
    """A raw frame in a weather.

    Args:
        clear: ``bayer (H, W)``, linear, black 0, saturation 1.
        depth_m: ``(H, W)`` along the optical axis, infinity is sky.
        weather, camera: as in ``BayerWeather``; the camera's exposure is that of the frame.
        seed: of the weather.
        ego_speed_m_per_s: of the vehicle, forward.
        airlight: as measured, linear; ``None`` takes that of the clear frame's sky, as ``BayerWeather`` finds it.

    Returns:
        ``bayer (H, W)``.
    """
    transform = _camera_transform(weather, camera, ego_speed_m_per_s, airlight)
    bayer = torch.from_numpy(np.array(clear["bayer"], dtype=np.float32))[None]
    depth = torch.from_numpy(np.array(depth_m, dtype=np.float32))[None]
    with torch.no_grad():
        found = transform(bayer, depth, transform.draw(bayer, seed=seed))
    return {"bayer": found[0].numpy()}


# ---- radar -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=TRANSFORMS_KEPT)
def _radar_transform(weather: Weather, radar: Radar) -> RadarAttenuation:
    return RadarAttenuation(weather, radar)


def simulated_radar(clear: Frame, geometry: Frame, weather: Weather, radar: Radar, seed: int) -> dict[str, Array]:
    """Detections of known targets in a weather: weaker by the way there and back, gone below the threshold.

    Args:
        clear: ``power_db``, ``range_m``, ``speed_m_per_s`` ``(N,)``, NaN where not detected; ``noise_floor_db``;
            ``clutter`` where there is any, which stays as it is.
        geometry: ``range_m``, ``azimuth_rad``, ``elevation_rad`` ``(N,)`` of the targets.
        weather, radar: as in ``RadarAttenuation``.
        seed: of the margin of targets whose power says less than the threshold.

    Returns:
        The arrays of ``clear``.
    """
    floor_db = float(clear["noise_floor_db"])
    transform = _radar_transform(weather, replace(radar, noise_floor_db=floor_db))
    power = torch.from_numpy(np.array(clear["power_db"], dtype=np.float64))
    seen = ~power.isnan()
    towards = _unit(geometry["azimuth_rad"], geometry["elevation_rad"])
    place = torch.from_numpy(np.array(geometry["range_m"], dtype=np.float64))[:, None] * towards
    points = torch.zeros(len(power), 6, dtype=torch.float64)
    points[:, :3] = torch.where(seen[:, None], place, 0.0)
    points[:, 4] = torch.where(seen, power, floor_db)
    with torch.no_grad():
        result = transform.run(points, transform.draw(points, seed=seed))
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    there = (result.kind == PointKind.OBJECT).numpy()
    found: dict[str, Array] = {key: np.array(value) for key, value in clear.items()}
    found["power_db"] = np.where(there, result.points[:, 4].numpy(), np.nan)
    for name in ("range_m", "speed_m_per_s"):
        found[name] = np.where(there, clear[name], np.nan)
    return found


def _unit(azimuth_rad: Array, elevation_rad: Array) -> Tensor:
    """``(N, 3)`` unit vectors, x ahead, y left, z up."""
    azimuth = torch.from_numpy(np.array(azimuth_rad, dtype=np.float64))
    elevation = torch.from_numpy(np.array(elevation_rad, dtype=np.float64))
    flat = elevation.cos()
    return torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], -1)


# ---- link ------------------------------------------------------------------------------------------------------------


def rain_attenuation_db(links: Mapping[str, Array], rain_mm_per_h: Array) -> Array:
    """What rain takes on the way of microwave links, dB ``(T, L)``: ITU-R P.838-3 over the samples of each path.

    Args:
        links: ``length_km``, ``frequency_ghz``, ``polarisation`` (0 horizontal, 1 vertical), ``(L,)`` each.
        rain_mm_per_h: ``(T, L, P)``, P samples along each path, evenly spread; NaN is unknown, and so is the loss.

    References:
        PHYSICS.md 6.5; ITU-R P.838-3.

    Example:
        >>> link = {"length_km": np.array([2.0]), "frequency_ghz": np.array([38.0]), "polarisation": np.array([1])}
        >>> round(float(rain_attenuation_db(link, np.full((1, 1, 1), 25.0))[0, 0]), 2)
        12.06
    """
    rain = torch.from_numpy(np.array(rain_mm_per_h, dtype=np.float64))
    tilt = torch.from_numpy(np.array(links["polarisation"], dtype=np.float64)) * (math.pi / 2)
    frequency = torch.from_numpy(np.array(links["frequency_ghz"], dtype=np.float64))
    known = ~rain.isnan()
    per_km = rain_attenuation_p838_db_per_km(
        torch.where(known, rain, 0.0), frequency[:, None], polarisation_tilt_rad=tilt[:, None]
    )  # (T, L, P)
    per_km = torch.where(known, per_km, math.nan)
    found: Array = (per_km.mean(-1) * torch.from_numpy(np.array(links["length_km"], dtype=np.float64))).numpy()
    return found


def dry_samples(time_s: Array, rain_mm_per_h: Array) -> NDArray[np.bool_]:
    """Which samples ``(T, L)`` of links are further than 15 min from rain of more than 0.1 mm/h on their path.

    Args:
        time_s: ``(T,)``, rising.
        rain_mm_per_h: ``(T, L, P)``; its mean along the path counts; NaN is unknown and may be rain.

    Example:
        >>> rain = np.zeros((5, 1, 1))
        >>> rain[0] = 2.0
        >>> dry_samples(np.array([0.0, 600.0, 900.0, 901.0, 2000.0]), rain)[:, 0].tolist()
        [False, False, False, True, True]
    """
    wet = ~(np.asarray(rain_mm_per_h).mean(-1) <= DRIZZLE_MM_PER_H)
    time = np.asarray(time_s, dtype=np.float64)
    dry = np.ones(wet.shape, dtype=bool)
    for link in range(wet.shape[1]):
        rains = time[wet[:, link]]
        if len(rains):
            after = np.searchsorted(rains, time)
            since = time - rains[np.maximum(after - 1, 0)]
            until = rains[np.minimum(after, len(rains) - 1)] - time
            dry[:, link] = (np.abs(since) > DRY_AFTER_S) & (np.abs(until) > DRY_AFTER_S)
    return dry


def simulated_link(links: Frame, measured: Frame, seed: int) -> dict[str, Array]:
    """Attenuation of links in the rain of a record: the loss on the way, over a dry sample of the same link.

    Args:
        links: as in ``rain_attenuation_db``.
        measured: ``time_s (T,)``, ``attenuation_db (T, L)``, ``rain_mm_per_h (T, L, P)``; of the attenuation only the
            dry samples are used, one drawn at random for each sample.
        seed: of that draw.

    Returns:
        ``time_s``, ``attenuation_db``, ``rain_mm_per_h``. A link that is never dry starts from 0 dB.
    """
    loss = rain_attenuation_db(links, measured["rain_mm_per_h"])
    dry = dry_samples(measured["time_s"], measured["rain_mm_per_h"])
    stream = keyed_stream(seed, "gap.dry_sample")
    start = np.zeros_like(loss)
    for link in range(loss.shape[1]):
        pool = np.asarray(measured["attenuation_db"])[dry[:, link], link]
        pool = pool[np.isfinite(pool)]
        drawn: Array = stream.random(size=(len(loss),))  # as many for every link, dry or not
        if len(pool):
            start[:, link] = pool[(drawn * len(pool)).astype(np.int64)]
    return {
        "time_s": np.array(measured["time_s"]),
        "attenuation_db": start + loss,
        "rain_mm_per_h": np.array(measured["rain_mm_per_h"]),
    }
