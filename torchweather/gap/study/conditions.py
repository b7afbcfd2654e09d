"""Scenes and conditions, and the study that they make up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from numpy.typing import NDArray

from torchweather.atmosphere.weather import Weather
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputTypeError
from torchweather.gap.study.frames import Frame, Frames
from torchweather.lidar.sensor import Lidar
from torchweather.radar.sensor import Radar

__all__ = ["Condition", "StudyContent", "StudyScene", "StudySensor"]

StudySensor = Lidar | Camera | Radar
S = TypeVar("S", Lidar, Camera, Radar)


@dataclass(frozen=True, eq=False)
class StudyScene:
    """A place that the sensor looked at in clear air.

    Args:
        id: its name in the study.
        clear: frames in clear air, each with its own sensor noise.
        geometry: arrays that all frames of the scene share; empty where a LiDAR study has none.
    """

    id: str
    clear: Frames
    geometry: Frame


@dataclass(frozen=True, eq=False)
class Condition:
    """A scene in one weather.

    Args:
        id: its name in the study.
        scene: name of its scene; empty for links.
        weather: as recorded; ``None`` is clear air (links: the record is in the frames).
        frames: as measured in this weather.
        rel_sd: relative standard deviation of the recorded rate or visibility, 0 where none is stated.
        time_s: ``(frames,)`` when each was taken, s; ``None`` is unknown.
        split: ``fit`` or ``holdout``.
        ego_speed_m_per_s: speed of the vehicle; ``None`` is unknown.
        exposure_s: of the camera, where it is not the sensor's.
        airlight: measured light of the fog or sky of a camera's condition: red, green, blue, linear, in units of
            saturation; ``None`` is estimated from the clear frames.
        exposure_gain: of a camera's condition: signal of its frames over that of the clear frames for the same light,
            by exposure time, aperture, gain and daylight together; ``None`` is unknown, and counts as 1.
    """

    id: str
    scene: str
    weather: Weather | None
    frames: Frames
    rel_sd: float
    time_s: NDArray[Any] | None
    split: str
    ego_speed_m_per_s: float | None
    exposure_s: float | None
    airlight: tuple[float, float, float] | None = None
    exposure_gain: float | None = None


@dataclass(frozen=True, eq=False)
class StudyContent:
    """The content of a study. `Study` documents the fields, and adds reading, checks and writing."""

    kind: str
    sensor: StudySensor | None
    beams: Frame
    scenes: Mapping[str, StudyScene]
    conditions: tuple[Condition, ...]
    links: Frame

    def sensor_as(self, sensor_class: type[S]) -> S:
        """The sensor, of the class that the caller works with."""
        if not isinstance(self.sensor, sensor_class):
            raise InputTypeError(
                f"Study: expected a {sensor_class.__name__}; got kind {self.kind}. Take a study of that sensor."
            )
        return self.sensor
