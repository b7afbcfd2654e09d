"""A study of a camera: its arrays, frames as the ready-made chain simulates them, and what such a study may lack."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.gap.sensors.camera.scene import block_levels, level_ground
from torchweather.gap.sensors.camera.scene_change import MOST_IGNORED, changed_parts, described, part_names
from torchweather.gap.study.checks import ArrayRule, unit_vectors
from torchweather.gap.study.conditions import Condition, StudyContent
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.kinds import Finding, Given, Looks, Paths, StudyKind, place
from torchweather.gap.study.recorded_frames import ImageFile, even_camera, shared_depth
from torchweather.io import IMAGE_SUFFIXES
from torchweather.pipeline.effect import Effect

__all__ = ["CameraStudy", "simulated_camera"]

# Depths within a fifth of each other are one depth: light lost on the way differs by less than a tenth where half of it
# is lost (0.5^0.2 = 0.87 of 0.5).
ONE_DEPTH = 1.2
GRID = ("H", "W")

Array = NDArray[Any]


def _above_0(values: Array) -> NDArray[np.bool_]:
    return np.asarray(values > 0)


def _normals(values: Array) -> NDArray[np.bool_]:
    """Unit vectors, and NaN or zeros where there is no surface."""
    return np.asarray(unit_vectors(values) | np.isnan(values).all(-1) | (values == 0).all(-1))


class CameraStudy(StudyKind):
    """A study of a camera."""

    name = "camera"
    sensor_class = Camera
    arrays: ClassVar[Mapping[str, Mapping[str, ArrayRule]]] = {
        "geometry": {
            "depth_m": ArrayRule(
                GRID, "above 0 m along the optical axis, inf for sky", holds=_above_0, advice="Sky is inf, not 0."
            ),
            "normal": ArrayRule(
                (*GRID, 3), "unit vectors, or NaN or 0 where there is no surface", holds=_normals, required=False
            ),
            "label": ArrayRule(GRID, "whole numbers", whole=True, required=False),
            "mask": ArrayRule(GRID, "0, or 1 for pixels that do not count", 0.0, 1.0, whole=True, required=False),
        },
        "frame": {
            "bayer": ArrayRule(
                GRID,
                "0 (black) to 1 (saturation), linear in light",
                0.0,
                1.0,
                advice="Subtract the black level, divide by white level less black level, and clip.",
            ),
        },
    }
    has_airlight = True
    frame_file, suffixes, kitti_folder = ImageFile, IMAGE_SUFFIXES, "image_2"
    signal, signal_name = "bayer", "pixel"
    spread_effect = "camera.patchy_fog"
    drift = "a drift of the exposure passes for camera.exposure_gain"
    loss_effect = "camera.extinction_scale"

    def recorded(
        self, sensor: Camera, scenes: Paths, measured: Sequence[Path], given: Given, owner: str
    ) -> tuple[Camera, Frame | None, Mapping[str, Frame]]:
        """The camera of whole cells of the colour filter array, and the depth of each scene."""
        if given["directions"] is not None:
            raise TorchweatherError(f"{owner}: directions belong to a LiDAR; the sensor is a camera. Leave them out.")
        depth, encoding = given["depth"], given["depth_encoding"]
        each = depth if isinstance(depth, Mapping) else dict.fromkeys(scenes, depth)
        geometry = {
            name: shared_depth(each.get(name), encoding, sensor, f"{owner}: depth of scene {name}") for name in scenes
        }
        return even_camera(sensor), None, geometry

    def sizes(self, sensor: Camera, owner: str) -> tuple[Mapping[str, int], str]:
        """The sensor's size, of whole cells of the colour filter array."""
        if sensor.height % 2 or sensor.width % 2:
            raise TorchweatherError(
                f"{owner}: sensor: height and width of a Bayer mosaic must be even, px; got {sensor.height} x "
                f"{sensor.width}. Crop the frames, and the camera with camera.cropped(top, left, height, width)."
            )
        return {"H": sensor.height, "W": sensor.width}, "the sensor (height, width)"

    def simulated(
        self, study: StudyContent, condition: Condition, start: Frame, seed: int, effects: tuple[Effect, ...] = ()
    ) -> Frame:
        """A raw frame in the condition's weather, by its exposure, speed and airlight."""
        assert condition.weather is not None
        camera = study.sensor_as(Camera)
        if condition.exposure_s is not None:
            camera = replace(camera, exposure_s=condition.exposure_s)
        geometry, speed = study.scenes[condition.scene].geometry, condition.ego_speed_m_per_s or 0.0
        return simulated_camera(
            start,
            geometry["depth_m"],
            condition.weather,
            camera,
            seed,
            ego_speed_m_per_s=speed,
            airlight=condition.airlight,
            exposure_gain=condition.exposure_gain or 1.0,
            effects=effects,
            normal=geometry.get("normal"),
        )

    def geometry_findings(self, scene: str, geometry: Frame) -> Iterator[Finding]:
        """Depths and normals, which distinguish effects."""
        depth_m = np.asarray(geometry["depth_m"], dtype=np.float64)
        depth_m = depth_m[np.isfinite(depth_m)]
        if depth_m.size == 0 or np.quantile(depth_m, 0.95) < ONE_DEPTH * np.quantile(depth_m, 0.05):
            yield Finding(
                "warning",
                f"The scene {scene} has one depth, if any.",
                "camera.exposure_gain cannot be distinguished from camera.airlight_scale, nor camera.stray_light.",
                "Record a scene with near and far surfaces.",
            )
        if "normal" not in geometry and "label" not in geometry:
            yield Finding(
                "note",
                f"The scene {scene} has no normal and no label.",
                "camera.wet_surface cannot be distinguished from camera.exposure_gain: it is known by the road and by "
                "surfaces that face up.",
                "Give normal (H, W, 3) or label (H, W) in the geometry.",
            )

    def scene_changes(self, study: StudyContent) -> Iterator[Finding]:
        """Parts of the picture whose edges in weather are none of the clear frames, as the gap workflow finds them."""
        camera = study.sensor_as(Camera)
        for name, scene in study.scenes.items():
            own = [one for one in study.conditions if one.scene == name and one.weather is not None]
            clear = np.mean([np.asarray(scene.clear[k]["bayer"]) for k in range(len(scene.clear))], axis=0)
            normal, mask = _planes(scene.geometry.get("normal")), scene.geometry.get("mask")
            places, number = changed_parts(
                {one.id: block_levels(_stacked(one.frames), camera.bayer_pattern) for one in own},
                {
                    one.id: block_levels(_stacked([self._in_fog(study, one, clear)]), camera.bayer_pattern)
                    for one in own
                },
                None if normal is None else level_ground(normal),
                None if mask is None else torch.from_numpy(np.asarray(mask) != 0),
            )
            if places:
                few = len(places) <= MOST_IGNORED
                offer = f", or ignore them: --ignore-parts {part_names(name, places)}" if few else ""
                yield Finding(
                    "error",
                    f"S{described(name, places, number)[1:]}",
                    "Something moved, or the camera did: scores and fits compare what is not the same.",
                    f"Take clear frames of the scene as it is in weather, put these parts in the scene's mask{offer}.",
                )

    def _in_fog(self, study: StudyContent, condition: Condition, clear: Array) -> Frame:
        """The clear scene at a condition's exposure, in the fog of its weather; drops and flakes change no edges."""
        assert condition.weather is not None
        frame: Frame = {"bayer": clear}
        fog = [part for part in condition.weather.parts if part.kind == "fog"]
        if not fog:
            return frame
        with warnings.catch_warnings():
            # The user did not ask for this frame: an airlight without any sky is told where it is used.
            warnings.simplefilter("ignore", TorchweatherWarning)
            return self.simulated(study, replace(condition, weather=fog[0]), frame, 0)

    def findings(self, study: StudyContent, clear: Looks, measured: Looks) -> Iterator[Finding]:
        """Frames of a single value."""
        looks = [look for some in (*clear.values(), *measured.values()) for look in some if look.signals]
        if looks and all(look.low == look.high for look in looks):
            yield Finding(
                "error",
                f"All pixels of a frame are equal, in every frame ({place(study.conditions[0].frames)}).",
                "There is nothing that weather could change.",
                "Check how bayer was made.",
            )


@lru_cache(maxsize=64)
def _camera_transform(
    weather: Weather,
    camera: Camera,
    ego_speed_m_per_s: float,
    airlight: tuple[float, float, float] | None,
    effects: tuple[Effect, ...],
) -> BayerWeather:
    # The frames of a study are linear already.
    linear = replace(camera, response_knots=None)
    return BayerWeather(weather, linear, ego_speed_m_per_s=ego_speed_m_per_s, airlight=airlight, effects=effects)


def simulated_camera(
    clear: Frame,
    depth_m: Array,
    weather: Weather,
    camera: Camera,
    seed: int,
    *,
    ego_speed_m_per_s: float = 0.0,
    airlight: tuple[float, float, float] | None = None,
    exposure_gain: float = 1.0,
    effects: tuple[Effect, ...] = (),
    normal: Array | None = None,
) -> dict[str, Array]:
    """A raw frame in a weather.

    Args:
        clear: ``bayer (H, W)``, linear, black 0, saturation 1.
        depth_m: ``(H, W)`` along the optical axis, infinity is sky.
        weather, camera: as in ``BayerWeather``; the camera's exposure is that of the frame.
        seed: of the weather.
        ego_speed_m_per_s: of the vehicle, forward.
        airlight: as measured in the weather, linear, at the exposure of its frames; ``None`` takes that of the clear
            frame's sky, as ``BayerWeather`` finds it.
        exposure_gain: signal in the weather over that of the clear frame for the same light, above 0. What it raises
            over saturation counts as saturated behind the weather, too.
        effects: of the catalogue, put into the chain.
        normal: ``(H, W, 3)`` of the surfaces, 0 or NaN where there is none; for effects that need it.

    Returns:
        ``bayer (H, W)``.
    """
    transform = _camera_transform(weather, camera, ego_speed_m_per_s, airlight, effects)
    bayer = torch.from_numpy(np.array(clear["bayer"], dtype=np.float32))[None]
    bayer = bayer if exposure_gain == 1 else (exposure_gain * bayer).clamp_max(1.0)
    depth = torch.from_numpy(np.array(depth_m, dtype=np.float32))[None]
    with torch.no_grad():
        found = transform(bayer, depth, transform.draw(bayer, seed=seed), normal=_planes(normal) if effects else None)
    return {"bayer": found[0].numpy()}


def _stacked(frames: Iterable[Frame]) -> Tensor:
    """Frames ``(F, 1, H, W)``."""
    return torch.stack([torch.from_numpy(np.array(frame["bayer"], dtype=np.float32)) for frame in frames])[:, None]


def _planes(normal: Array | None) -> Tensor | None:
    """Normals ``(3, H, W)``, 0 where there is no surface."""
    if normal is None:
        return None
    found = torch.from_numpy(np.nan_to_num(np.asarray(normal, dtype=np.float32)))
    return found.permute(2, 0, 1).contiguous()
