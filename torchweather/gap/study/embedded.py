"""A study of an embedded scene whose "measured" frames the library makes itself: there is nothing to find in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.sensor import Camera
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.core.random import keyed_stream
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.sensors.camera.study_kind import simulated_camera
from torchweather.gap.sensors.lidar.study_kind import simulated_lidar
from torchweather.gap.sensors.radar.study_kind import simulated_radar
from torchweather.gap.study.study import Frame, Study
from torchweather.lidar.intensity import EIGHT_BITS
from torchweather.lidar.sensor import Lidar
from torchweather.radar.sensor import Radar
from torchweather.scenes import SCENES, RadarView, Scene, radar_view
from torchweather.scenes.lidar_view import beam_hits, reported_intensity
from torchweather.scenes.raw_frame import DRY
from torchweather.scenes.scene import SceneLabel, with_sensor_noise
from torchweather.sensors import DEFAULT_PRESETS

__all__ = ["EMBEDDED_KINDS", "WEATHERS", "embedded_study"]

EMBEDDED_KINDS = ("lidar", "camera", "radar")
# Four strengths each: fewer make a trend a matter of chance (METRICS.md 3).
WEATHERS: tuple[Weather, ...] = (
    *(Rain(rate) for rate in (5.0, 10.0, 25.0, 50.0)),
    *(Fog(mor_m=mor) for mor in (400.0, 200.0, 100.0, 50.0)),
    *(Snow(rate) for rate in (0.5, 1.0, 2.0, 4.0)),
)
# Small enough that a study is validated in well under a minute: 64 rings of 256 columns; all image scores take 161
# pixels a side, and the preset's frames have 1936 x 1464.
RINGS, COLUMNS = 64, 256
CAMERA_PX = (232, 176)
# Radar targets whose parts move while nothing else does; cars, posts and boards stand still, and so does the radar.
FLUTTERING = (SceneLabel.PEDESTRIAN, SceneLabel.CYCLIST, SceneLabel.TREE)

Array = NDArray[Any]
Clear = Callable[[int], dict[str, Array]]
Weathered = Callable[[Frame, Weather, int], dict[str, Array]]
Recorded = Callable[[dict[str, Array]], dict[str, Array]]  # a frame in the steps of the sensor
# Beams, geometry, and how frames are made.
Parts = tuple[dict[str, Array], dict[str, Array], Clear, Weathered, Recorded]


@one_thread_an_operation()  # all arrays are small: torch's pool would wait longer than it works
def embedded_study(
    kind: str,
    *,
    preset: str | None = None,
    scene: str = "test-track",
    clear_frames: int = 8,
    frames: int = 5,
    seed: int = 0,
) -> Study:
    """A study of an embedded scene without any measurement: every frame is simulated.

    Clear frames differ by the sensor's noise: shot and readout noise of the camera, range noise of the LiDAR, receiver
    noise of the radar, to which people, cyclists and trees fluctuate. The frames that stand for measured ones are the
    base model on clear frames of their own, with random numbers of their own. Validated, such a study shows what
    agreement looks like, and how far apart two runs of the same model are.

    Args:
        kind: ``lidar``, ``camera`` or ``radar``.
        preset: of the sensor; ``None`` is the library's default. Its resolution is reduced.
        scene: a name in ``torchweather.scenes.SCENES``; in the fog tunnel there is fog alone.
        clear_frames: 2 or more.
        frames: of each condition, 1 or more.
        seed: of all noise and weather.

    Example:
        >>> study = embedded_study("radar", clear_frames=2, frames=1)
        >>> study.kind, len(study.conditions), len(study.scenes["test-track"].clear)
        ('radar', 12, 2)
    """
    check_one_of("kind", kind, EMBEDDED_KINDS, owner="embedded_study")
    check_one_of("scene", scene, SCENES, owner="embedded_study")
    check_at_least("clear_frames", clear_frames, 2, owner="embedded_study")
    check_at_least("frames", frames, 1, owner="embedded_study")
    name = preset or DEFAULT_PRESETS[kind]
    sensor, beams, geometry, clear, weathered, recorded = _BUILDERS[kind](SCENES[scene](), name)
    noise = [_seed(seed, f"clear.{number}") for number in range(clear_frames + frames)]
    views = [clear(each) for each in noise]
    weathers = [weather for weather in WEATHERS if scene not in DRY or weather.kind == "fog"]
    conditions = []
    for weather in weathers:
        label = f"{weather.kind}-{weather.intensity:g}"
        made = [
            recorded(weathered(views[clear_frames + number], weather, _seed(seed, f"weather.{label}.{number}")))
            for number in range(frames)
        ]
        conditions.append({"id": label, "scene": scene, "weather": weather, "frames": made})
    return Study.from_arrays(
        kind=kind,
        sensor=sensor,
        beams=beams or None,
        scenes=[{"id": scene, "clear": [recorded(view) for view in views[:clear_frames]], "geometry": geometry}],
        conditions=conditions,
    )


def _seed(seed: int, stream: str) -> int:
    return int(keyed_stream(seed, f"gap.embedded_study.{stream}").integers(2**62))


def _lidar(scene: Scene, preset: str) -> tuple[Lidar, *Parts]:
    whole = Lidar.preset(preset)
    rings = whole.elevations_deg
    assert rings is not None  # every preset has its pattern
    step = max(1, len(rings) // RINGS)
    offsets = whole.azimuth_offsets_deg
    lidar = replace(
        whole,
        elevations_deg=rings[::step],
        azimuth_offsets_deg=None if offsets is None else offsets[::step],
        origin_heights_m=None,
        columns=COLUMNS,
    )
    hits = beam_hits(scene, lidar)
    seen = hits.measured(lidar)
    assert seen.grid is not None
    grid = seen.grid
    direction = seen.directions.reshape(*grid, 3).numpy()

    # A sensor rounds once: weather on a frame of integers would hide every loss of less than half a step.
    fine = replace(lidar, intensity_unit="reflectivity") if lidar.intensity_unit in EIGHT_BITS else lidar

    def clear(noise: int) -> dict[str, Array]:
        points = hits.measured(fine, range_noise_seed=noise).points
        range_m = torch.linalg.vector_norm(points[:, :3], dim=-1)
        return {"range_m": range_m.reshape(grid).numpy(), "intensity": points[:, 3].reshape(grid).numpy()}

    def weathered(frame: Frame, weather: Weather, seed: int) -> dict[str, Array]:
        return simulated_lidar(frame, direction, weather, fine, seed)

    def recorded(frame: dict[str, Array]) -> dict[str, Array]:
        if fine is lidar:
            return frame
        reflectivity, range_m = (torch.from_numpy(frame[name]) for name in ("intensity", "range_m"))
        return {**frame, "intensity": reported_intensity(reflectivity, range_m, lidar).numpy()}

    geometry = {"cos_incidence": seen.cos_incidence.reshape(grid).numpy()}
    return lidar, {"direction": direction}, geometry, clear, weathered, recorded


def _camera(scene: Scene, preset: str) -> tuple[Camera, *Parts]:
    camera = replace(Camera.preset(preset).resized(*CAMERA_PX), response_knots=None)
    seen = scene.view(camera)
    depth_m = seen.depth_m[0].numpy()

    def clear(noise: int) -> dict[str, Array]:
        return {"bayer": with_sensor_noise(seen.bayer, noise)[0].numpy()}

    def weathered(frame: Frame, weather: Weather, seed: int) -> dict[str, Array]:
        return simulated_camera(frame, depth_m, weather, camera, seed)

    geometry = {"depth_m": depth_m, "normal": seen.normal.movedim(0, -1).numpy(), "label": seen.label[0].numpy()}
    return camera, {}, geometry, clear, weathered, dict


def _radar(scene: Scene, preset: str) -> tuple[Radar, *Parts]:
    radar = Radar.preset(preset)
    targets = _targets(radar_view(scene, radar))
    geometry = {name: values for name, values in targets.items() if name != "rcs_dbsm"}
    gain = radar.gain_dbi(*(torch.from_numpy(targets[key]) for key in ("azimuth_rad", "elevation_rad"))).numpy()
    mean_snr_db = (
        radar.constant_db
        + targets["rcs_dbsm"]
        - 40.0 * np.log10(targets["range_m"])
        + 2.0 * (gain - radar.antenna_gain_dbi)
        - radar.floor_db
    )
    moving = np.isin(targets["target_class"], FLUTTERING)

    def clear(noise: int) -> dict[str, Array]:
        stream = keyed_stream(noise, "gap.embedded_study.radar")
        count = len(mean_snr_db)
        # Swerling 1: parts that move against each other make the power exponential from frame to frame.
        fluctuation = np.where(moving, stream.standard_exponential(count), 1.0)
        amplitude = np.sqrt(10.0 ** (mean_snr_db / 10.0) * fluctuation)
        receiver = stream.standard_normal((2, count)) / np.sqrt(2.0)  # unit power: the noise floor
        snr = np.square(amplitude + receiver[0]) + np.square(receiver[1])
        seen = 10.0 * np.log10(snr) >= radar.detection_snr_db
        # Skolnik, Introduction to Radar Systems: an error of resolution / sqrt(2 SNR); primary text not seen.
        error = stream.standard_normal((2, count)) / np.sqrt(2.0 * snr)
        range_m = np.maximum(targets["range_m"] + radar.range_resolution_m * error[0], 0.0)
        speed = targets["speed_m_per_s"] + radar.speed_resolution_m_per_s * error[1]
        return {
            "power_db": np.where(seen, radar.floor_db + 10.0 * np.log10(snr), np.nan),
            "range_m": np.where(seen, range_m, np.nan),
            "speed_m_per_s": np.where(seen, speed, np.nan),
            "noise_floor_db": np.array(radar.floor_db),
        }

    def weathered(frame: Frame, weather: Weather, seed: int) -> dict[str, Array]:
        return simulated_radar(frame, geometry, weather, radar, seed)

    return radar, {}, geometry, clear, weathered, dict


def _targets(view: RadarView) -> dict[str, Array]:
    """One target a scatterer; all facets of a car are one target, in the middle of its echo, of their summed power."""
    scatterers = view.scatterers
    columns: dict[str, list[float]] = {name: [] for name in _TARGET}
    of_car = view.label == SceneLabel.CAR
    single = [torch.tensor([row]) for row in (~of_car).nonzero()[:, 0].tolist()]
    cars = [((view.object_id == car) & of_car).nonzero()[:, 0] for car in sorted(set(view.object_id[of_car].tolist()))]
    for rows in [*single, *cars]:
        power = scatterers.field_m[rows].abs().square()
        share = power / power.sum()
        x, y, z = (share[:, None] * scatterers.position_m[rows]).sum(0).tolist()
        flat = float(np.hypot(x, y))
        values = (
            float(np.hypot(flat, z)),
            float(np.arctan2(y, x)),
            float(np.arctan2(z, flat)),
            float((share * scatterers.speed_m_per_s[rows]).sum()),
            float(view.label[rows[0]]),
            float(10.0 * torch.log10(power.sum())),
        )
        for name, value in zip(_TARGET, values, strict=True):
            columns[name].append(value)
    found: dict[str, Array] = {name: np.array(values) for name, values in columns.items()}
    return found


_TARGET = ("range_m", "azimuth_rad", "elevation_rad", "speed_m_per_s", "target_class", "rcs_dbsm")
_BUILDERS: Mapping[str, Callable[[Scene, str], tuple[Any, *Parts]]] = {
    "lidar": _lidar,
    "camera": _camera,
    "radar": _radar,
}
