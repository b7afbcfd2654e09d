"""Weather on the sensors of a vehicle in CARLA, frame by frame, in the callbacks that they call."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import torch

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_at_least, check_one_of
from torchweather.datasets.carla import (
    CAR_RCS_DBSM,
    depth_from_carla,
    detections_from_carla,
    image_from_carla,
    points_from_carla,
)
from torchweather.radar.sensor import Radar

__all__ = ["CARLA_SENSORS", "CarlaRig"]

CARLA_SENSORS = ("camera", "depth", "lidar", "radar")
"""Kinds of sensors whose buffers are understood."""

_TIMES_KEPT = 1000  # of the last frames
Sample = dict[str, Any]


class CarlaRig:
    """Gathers the measurements of one frame, calls a transform of samples once, and hands the sample on.

    ``rig.listener(key)`` is the callback of a sensor: ``actor.listen(rig.listener("points"))``. The measurement is
    copied at once (CARLA takes its buffer back). When all keys of a frame are there, the sample goes through the
    transform, in the thread of one of the sensors, one frame at a time and in their order; the other sensors do not
    wait for it.

    A sample has, under the keys named: images ``(3, H, W)`` uint8, depth ``(1, H, W)`` metres, clouds ``(N, 4)``, lists
    of detections ``(N, 6)``; and ``frame`` (CARLA's number, which a ``sample_key`` may take) and ``timestamp_s``.

    Args:
        transform: takes a sample and gives a sample, such as ``Compose``.
        sensors: keys of the sample to kinds, ``camera``, ``depth``, ``lidar``, ``radar``.
        deliver: called with each sample in the weather.
        radar: link budget of the radars, needed where there is one.
        rcs_dbsm: cross section of a radar's detections, which CARLA does not give.
        reflectivity: of what a LiDAR hits, which CARLA does not give; ``None`` leaves CARLA's number in the column.
        report: called with a line about each frame: its number, the time that it took, how much of it was the
            transform. Default: a log message of level INFO; ``print`` prints.
        waiting_frames: frames that may wait for a sensor, and complete ones that may wait for their turn; beyond that
            the oldest is given up.

    Attributes:
        times_s: time of each of the last 1000 frames, seconds, from its last measurement to the sample in the weather.
        given_up: frames that never became complete, or for which there was no time.

    Raises:
        ValueError: an unknown kind of sensor, a radar without its link budget.

    Example:
        >>> import numpy as np
        >>> from types import SimpleNamespace
        >>> from torchweather.sensors import Lidar
        >>> from torchweather.transforms import LidarFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> fog = LidarFog(Fog(mor_m=50), Lidar(wavelength_nm=905, intensity_unit="none"))
        >>> def weather(sample):
        ...     return {**sample, "points": fog(sample["points"])}
        >>> rig = CarlaRig(weather, {"points": "lidar"}, deliver=lambda sample: print(sample["frame"]))
        >>> cloud = np.float32([[10, 0, 0, 0.96], [90, 0, 0, 0.7]]).tobytes()
        >>> rig.listener("points")(SimpleNamespace(raw_data=cloud, frame=7, timestamp=0.35))
        7
    """

    def __init__(
        self,
        transform: Callable[[Sample], Mapping[str, Any]],
        sensors: Mapping[str, str],
        deliver: Callable[[Sample], object] | None = None,
        *,
        radar: Radar | None = None,
        rcs_dbsm: float = CAR_RCS_DBSM,
        reflectivity: float | None = None,
        report: Callable[[str], object] | None = None,
        waiting_frames: int = 16,
    ) -> None:
        check_arguments(
            "CarlaRig(transform: Callable, sensors: Mapping, deliver: Callable | None, radar: Radar | None, "
            "rcs_dbsm: float, reflectivity: float | None, report: Callable | None, waiting_frames: int)",
            transform,
            sensors,
            deliver,
            radar,
            rcs_dbsm,
            reflectivity,
            report,
            waiting_frames,
        )
        if not sensors:
            raise InputValueError("CarlaRig: sensors must name at least one, such as {'points': 'lidar'}; got none.")
        for kind in sensors.values():
            check_one_of("sensors", kind, CARLA_SENSORS, owner=self)
        readers: dict[str, Callable[[Any], torch.Tensor]] = {
            "camera": image_from_carla,
            "depth": depth_from_carla,
            "lidar": partial(points_from_carla, reflectivity=reflectivity),
        }
        if radar is not None:
            readers["radar"] = partial(detections_from_carla, radar=radar, rcs_dbsm=rcs_dbsm)
        if any(kind not in readers for kind in sensors.values()):
            raise InputValueError(
                "CarlaRig: a radar needs its link budget, because CARLA gives no power; expected radar=Radar(...), "
                "such as Radar.preset('imaging-77ghz')."
            )
        check_at_least("waiting_frames", waiting_frames, 1, owner=self)
        self.transform, self.sensors, self.deliver = transform, dict(sensors), deliver
        self.report = logging.getLogger(__name__).info if report is None else report
        self.times_s: deque[float] = deque(maxlen=_TIMES_KEPT)
        self.given_up = 0
        self.waiting_frames = int(waiting_frames)
        self._read = {key: readers[kind] for key, kind in sensors.items()}
        self._waiting: dict[int, Sample] = {}  # by frame, incomplete
        self._ready: deque[tuple[Sample, float]] = deque()  # complete, with the time at which they became so
        self._last = -1  # frame that was completed
        self._busy = False
        self._lock = threading.Lock()  # of these four

    def listener(self, key: str) -> Callable[[Any], None]:
        """The callback of the sensor under ``key``, for ``carla.Sensor.listen``."""
        check_one_of("key", key, list(self.sensors), owner=self)
        return partial(self._take, key)

    def _take(self, key: str, measurement: Any) -> None:
        """One measurement; where it completes its frame and nobody is at work, the work is done here."""
        began = time.perf_counter()
        value, frame = self._read[key](measurement), int(measurement.frame)
        with self._lock:
            self._gather(key, value, frame, float(measurement.timestamp), began)
            if self._busy:
                return
            self._busy = True
        try:
            while (ready := self._next()) is not None:
                self._work(*ready)
        except BaseException:
            with self._lock:
                self._busy = False
            raise

    def _gather(self, key: str, value: torch.Tensor, frame: int, timestamp_s: float, began: float) -> None:
        if self._last - self.waiting_frames < frame <= self._last:
            return  # of a frame that was given up
        if frame <= self._last:  # far back: the simulator counts anew
            self._waiting.clear()
            self._last = -1
        sample = self._waiting.setdefault(frame, {"frame": frame, "timestamp_s": timestamp_s})
        sample[key] = value
        if all(name in sample for name in self.sensors):
            self._ready.append((self._waiting.pop(frame), began))
            self._last = frame
            # Sensors send their frames in order: what is older and incomplete stays so.
            for older in [number for number in self._waiting if number < frame]:
                self._give_up(older)
        if len(self._waiting) > self.waiting_frames:
            self._give_up(min(self._waiting))
        if len(self._ready) > self.waiting_frames:
            self._ready.popleft()
            self.given_up += 1

    def _give_up(self, frame: int) -> None:
        del self._waiting[frame]
        self.given_up += 1

    def _next(self) -> tuple[Sample, float] | None:
        with self._lock:
            if self._ready:
                return self._ready.popleft()
            self._busy = False  # under the lock: who completes a frame from now on does the work
            return None

    def _work(self, sample: Sample, began: float) -> None:
        ordered = {**{key: sample[key] for key in self.sensors}, **sample}
        started = time.perf_counter()
        with torch.no_grad():
            found = dict(self.transform(ordered))
        ended = time.perf_counter()
        whole_ms, weather_ms = 1e3 * (ended - began), 1e3 * (ended - started)
        self.times_s.append(ended - began)
        self.report(f"frame {sample['frame']}: {whole_ms:.1f} ms, of which weather {weather_ms:.1f} ms")
        if self.deliver is not None:
            self.deliver(found)
