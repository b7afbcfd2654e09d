"""A LiDAR's clear view of a scene and the same in each weather: clouds, what became of their points, numbers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.core.threads import one_thread_an_operation
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.cloud_counts import cloud_counts
from torchweather.scenes import LidarView, Scene, lidar_view

__all__ = ["LidarScene", "WeatherCloud", "lidar_scene"]


@dataclass(frozen=True)
class WeatherCloud:
    """The cloud of all beams in a weather, or in clear air.

    Args:
        points: ``(N, 5)`` x, y, z in metres, intensity, ring.
        kind: ``(N,)`` ``PointKind``.
        lost: ``(N,)`` points that the clear cloud has and whose beam reports nothing here.
        numbers: for the table.
        times_s: seconds for the set-up (transform built), the draw and the rendering.
    """

    points: Tensor
    kind: Tensor
    lost: Tensor
    numbers: dict[str, Any]
    times_s: dict[str, float]


@dataclass(frozen=True)
class LidarScene:
    """A scene as a LiDAR sees it in clear air.

    Args:
        scene: what there is.
        lidar: the sensor.
        view: of it.
        counted: names of the objects whose points are counted.
    """

    scene: Scene
    lidar: Lidar
    view: LidarView
    counted: tuple[str, ...]

    @property
    def clear(self) -> WeatherCloud:
        """The cloud without weather."""
        hit = self.view.hit
        kind = torch.where(hit, int(PointKind.OBJECT), int(PointKind.LOST)).to(torch.int8)
        numbers = {"extinction_per_m": 0.0, "objects": int(hit.sum()), **self._shares(self.view.points, kind)}
        return WeatherCloud(self.view.points, kind, torch.zeros_like(hit), numbers, {})

    def render(self, weather: Weather, seed: int) -> WeatherCloud:
        """The cloud in a weather, drawn with ``seed``."""
        points, hit = self.view.points, self.view.hit
        started = time.perf_counter()
        transform = LidarWeather(weather, self.lidar)
        built = time.perf_counter()
        noise = transform.draw(points, seed=seed)
        drawn = time.perf_counter()
        # One thread: on a busy machine torch's pool waits longer than it works, and the page shows the time.
        with torch.no_grad(), one_thread_an_operation():
            result = transform.run(points, noise, directions=self.view.directions)
        done = time.perf_counter()
        assert isinstance(result.points, Tensor)
        assert isinstance(result.kind, Tensor)
        numbers = {
            "extinction_per_m": float(transform.extinction_per_m),
            **cloud_counts(hit, result),
            **self._shares(result.points, result.kind),
        }
        times_s = {"set_up_s": built - started, "draw_s": drawn - built, "render_s": done - drawn}
        return WeatherCloud(result.points, result.kind, hit & (result.kind == PointKind.LOST), numbers, times_s)

    def _shares(self, points: Tensor, kind: Tensor) -> dict[str, Any]:
        hit = self.view.hit
        is_object, particle = kind == PointKind.OBJECT, kind == PointKind.PARTICLE
        numbers = {
            "share_objects": _share(is_object, hit),
            "share_replaced": _share(particle & hit, hit),
            "share_lost": _share(hit & (kind == PointKind.LOST), hit),
            "share_particles_empty": _share(particle & ~hit, ~hit),
            "particles": int(particle.sum()),
        }
        if bool(particle.any()):
            numbers["particle_range_m"] = float(points[particle, :3].norm(dim=-1).median())
        for name in self.counted:
            numbers[f"points_{name}"] = int((is_object & (self.view.object_id == self.scene.object_id(name))).sum())
        return numbers


def _share(part: Tensor, whole: Tensor) -> float:
    number = int(whole.sum())
    return int(part.sum()) / number if number else 0.0


def lidar_scene(scene: Scene, lidar: Lidar, seed: int, counted: Sequence[str] = ()) -> LidarScene:
    """A LiDAR on the roof of the vehicle in a scene.

    Args:
        scene: what there is to see.
        lidar: with a scan pattern.
        seed: of its range noise.
        counted: names of objects whose points are to be counted.
    """
    return LidarScene(scene, lidar, lidar_view(scene, lidar, range_noise_seed=seed), tuple(counted))
