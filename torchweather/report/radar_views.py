"""A radar's frame of a scene in each weather: map, points, which of them are the scene's, numbers."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather, parse_weather
from torchweather.core.threads import one_thread_an_operation
from torchweather.radar import FmcwRadar, range_doppler
from torchweather.radar.fmcw.detection import beam_amplitude
from torchweather.radar.sensor import Radar
from torchweather.report.machine import library_warnings
from torchweather.scenes import RadarView, Scene, radar_view
from torchweather.scenes.primitives import Point

__all__ = ["CORNER", "LOSS_AT_M", "RadarFrame", "RadarScene", "radar_scene"]

LOSS_AT_M = (28, 56)  # where the cars stand
CORNER, FOUND_WITHIN_M = "corner 45 m", 1.0


@dataclass(frozen=True)
class RadarFrame:
    """One frame of a radar.

    Args:
        weather: that it is in; ``None`` is clear air.
        points: ``(N, 6)``: x, y, z (m), radial speed (m/s), power (dBm), radar cross section (dBsm).
        of_scene: ``(N,)`` bool: the scene's echo is stronger in this point than weather and noise together.
        cell: ``(N, 2)`` Doppler and range bin of each point.
        power_dbm: ``(N_c, N_s)`` range-Doppler map.
        numbers: for the table.
        times_s: seconds for the set-up, the draw and the frame.
        warnings: what the library warned of.
    """

    weather: Weather | None
    points: Tensor
    of_scene: Tensor
    cell: Tensor
    power_dbm: Tensor
    numbers: dict[str, Any]
    times_s: dict[str, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class RadarScene:
    """A scene as a radar sees it.

    Args:
        radar: the sensor.
        view: the scene's scatterers.
        echo: ``(V, N_c, N_s)`` complex map of them alone, in clear air without noise.
    """

    radar: Radar
    view: RadarView
    echo: Tensor

    def render(self, weather: str | None, seed: int) -> RadarFrame:
        """The frame in a weather, such as ``rain:rate=25``, or in clear air, drawn with ``seed``."""
        started = time.perf_counter()
        with library_warnings() as said:
            parsed = None if weather is None else parse_weather(weather)
            transform = FmcwRadar(self.radar, parsed)
            built = time.perf_counter()
            noise = transform.draw(self.view.scatterers, seed=seed)
            drawn = time.perf_counter()
            # One thread: on a busy machine torch's pool waits longer than it works, and the page shows the time.
            with torch.no_grad(), one_thread_an_operation():
                cube = transform.cube(self.view.scatterers, noise)
                result = transform.process(cube)
                done = time.perf_counter()
                channels = range_doppler(cube, self.radar, transform.window_name)
        points, cell = result.points, result.cell
        assert isinstance(points, Tensor)
        assert isinstance(cell, Tensor)
        per_km = 0.0 if transform.path is None else float(transform.path.attenuation_db_per_km(1))
        of_scene = self._of_scene(channels, points, cell, per_km)
        numbers: dict[str, Any] = {
            "attenuation_db_per_km": per_km,
            **{f"loss_{distance}_m_db": 2e-3 * per_km * distance for distance in LOSS_AT_M},
            "points_scene": int(of_scene.sum()),
            "points_other": int((~of_scene).sum()),
            "corner_45_m_dbm": self._strongest_dbm(CORNER, points),
        }
        times_s = {"set_up_s": built - started, "draw_s": drawn - built, "render_s": done - drawn}
        return RadarFrame(parsed, points, of_scene, cell, result.power_dbm, numbers, times_s, tuple(said))

    def _of_scene(self, channels: Tensor, points: Tensor, cell: Tensor, attenuation_db_per_km: float) -> Tensor:
        """True for points whose beam holds more of the scene's echo than of everything else."""
        range_m = torch.linalg.vector_norm(points[:, :3], dim=-1)
        # A cell is so short that one loss holds for all of it.
        loss = 10.0 ** (-2e-3 * attenuation_db_per_km * range_m / 20.0)
        scene = beam_amplitude(self.echo, points, cell, self.radar) * loss
        more: Tensor = scene.abs() > (beam_amplitude(channels, points, cell, self.radar) - scene).abs()
        return more

    def _strongest_dbm(self, name: str, points: Tensor) -> float | None:
        """Power of the strongest point at an object."""
        if name not in self.view.names or not bool(self.view.of(name).any()):
            return None
        at = self.view.scatterers.position_m[self.view.of(name)][0].to(points)
        near = torch.linalg.vector_norm(points[:, :3] - at, dim=-1) < FOUND_WITHIN_M
        return float(points[near, 4].max()) if bool(near.any()) else None


def radar_scene(scene: Scene, radar: Radar, velocity_m_per_s: Mapping[str, Point] | None = None) -> RadarScene:
    """A radar in the bumper of a stationary vehicle.

    Args:
        scene: what there is to see.
        radar: the sensor.
        velocity_m_per_s: of what moves, by name.
    """
    view = radar_view(scene, radar, velocity_m_per_s=velocity_m_per_s)
    bare = FmcwRadar(radar, noise=False)
    with torch.no_grad():
        echo = range_doppler(bare.cube(view.scatterers, {}), radar, bare.window_name)
    return RadarScene(radar, view, echo)
