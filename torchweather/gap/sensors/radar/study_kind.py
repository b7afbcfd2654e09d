"""A study of a radar: its arrays, frames as the ready-made chain simulates them, and what such a study may lack."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.gap.study.checks import ArrayRule, refuse
from torchweather.gap.study.conditions import Condition, StudyContent
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.kinds import Finding, Looks, StudyKind
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.sensor import Radar
from torchweather.radar.transform import RadarAttenuation

__all__ = ["RadarStudy", "simulated_radar"]

TARGETS = ("N",)

Array = NDArray[Any]


class RadarStudy(StudyKind):
    """A study of a radar: detections of known targets."""

    name = "radar"
    sensor_class = Radar
    arrays: ClassVar[Mapping[str, Mapping[str, ArrayRule]]] = {
        "geometry": {
            "range_m": ArrayRule(TARGETS, "0 m or more, finite", 0.0),
            "azimuth_rad": ArrayRule(TARGETS, "-pi..pi rad", -math.pi, math.pi, advice="Degrees are not taken."),
            "elevation_rad": ArrayRule(
                TARGETS, "-pi/2..pi/2 rad", -math.pi / 2, math.pi / 2, advice="Degrees are not taken."
            ),
            "speed_m_per_s": ArrayRule(TARGETS, "finite, m/s"),
            "target_class": ArrayRule(TARGETS, "whole numbers", whole=True),
            "mask": ArrayRule(TARGETS, "0, or 1 for targets that do not count", 0.0, 1.0, whole=True, required=False),
        },
        "frame": {
            "power_db": ArrayRule(TARGETS, "finite in dB, or NaN where the target was not detected", nan=True),
            "range_m": ArrayRule(
                TARGETS, "0 m or more and finite, or NaN where the target was not detected", 0.0, nan=True
            ),
            "speed_m_per_s": ArrayRule(TARGETS, "finite in m/s, or NaN where the target was not detected", nan=True),
            "noise_floor_db": ArrayRule((), "finite in dB"),
            "clutter": ArrayRule(
                ("M", 6),
                "finite: range m, azimuth rad, elevation rad, speed m/s, power dB, Doppler width m/s",
                required=False,
            ),
        },
    }
    signal, signal_name = "power_db", "detection"
    spread_effect = "radar.fluctuation"
    drift = "radar.range_migration, and the drying of radar.wet_radome, cannot be seen"
    loss_effect = "radar.path_loss_scale"

    def check_frame(self, sensor: Radar, frame: Frame, name: str) -> None:
        """Targets that are seen as a whole or not at all."""
        seen = ~np.isnan(frame["power_db"])
        for key in ("range_m", "speed_m_per_s"):
            refuse(
                seen & np.isnan(frame[key]),
                frame[key],
                f"{name}: {key} must be a number wherever power_db is one",
                "Set power_db to NaN where the target was not detected.",
            )

    def simulated(
        self, study: StudyContent, condition: Condition, start: Frame, seed: int, effects: tuple[Effect, ...] = ()
    ) -> Frame:
        """Detections in the condition's weather."""
        assert condition.weather is not None
        geometry = study.scenes[condition.scene].geometry
        return simulated_radar(start, geometry, condition.weather, study.sensor_as(Radar), seed, effects=effects)

    def geometry_findings(self, scene: str, geometry: Frame) -> Iterator[Finding]:
        """Classes of targets, which distinguish effects."""
        if len(np.unique(np.asarray(geometry["target_class"]))) == 1:
            yield Finding(
                "note",
                f"All targets of the scene {scene} are of one class.",
                "radar.wet_rcs, which differs by class, cannot be distinguished from radar.wet_radome.",
                "State the classes of the targets, or record a scene with several.",
            )

    def findings(self, study: StudyContent, clear: Looks, measured: Looks) -> Iterator[Finding]:
        """Frames without clutter."""
        if not any("clutter" in look.arrays for some in measured.values() for look in some):
            yield Finding(
                "note",
                "No frame has clutter.",
                "Echoes of drops (radar.volume_clutter), ghosts (radar.multipath) and radar.doppler_spread cannot be "
                "seen.",
                "Give the detections that belong to no target as clutter (M, 6).",
            )


@lru_cache(maxsize=64)
def _radar_transform(weather: Weather, radar: Radar, effects: tuple[Effect, ...]) -> RadarAttenuation:
    return RadarAttenuation(weather, radar, effects=effects)


def simulated_radar(
    clear: Frame,
    geometry: Frame,
    weather: Weather,
    radar: Radar,
    seed: int,
    *,
    effects: tuple[Effect, ...] = (),
) -> dict[str, Array]:
    """Detections of known targets in a weather: weaker by the way there and back, gone below the threshold.

    Args:
        clear: ``power_db``, ``range_m``, ``speed_m_per_s`` ``(N,)``, NaN where not detected; ``noise_floor_db``;
            ``clutter`` where there is any, which stays as it is.
        geometry: ``range_m``, ``azimuth_rad``, ``elevation_rad`` ``(N,)`` of the targets.
        weather, radar: as in ``RadarAttenuation``.
        seed: of the margin of targets whose power says less than the threshold.
        effects: of the catalogue, put into the chain.

    Returns:
        The arrays of ``clear``. Echoes that effects add are left out, and so is a change of the noise floor.
    """
    floor_db = float(clear["noise_floor_db"])
    transform = _radar_transform(weather, replace(radar, noise_floor_db=floor_db), effects)
    power = torch.from_numpy(np.array(clear["power_db"], dtype=np.float64))
    seen = ~power.isnan()
    towards = _unit(geometry["azimuth_rad"], geometry["elevation_rad"])
    place = torch.from_numpy(np.array(geometry["range_m"], dtype=np.float64))[:, None] * towards
    points = torch.zeros(len(power), 6, dtype=torch.float64)
    points[:, :3] = torch.where(seen[:, None], place, 0.0)
    points[:, 4] = torch.where(seen, power, floor_db)
    with torch.no_grad():
        known: dict[str, Any] = (
            {"target_class": torch.from_numpy(np.array(geometry["target_class"], np.int64))} if effects else {}
        )
        result = transform.run(points, transform.draw(points, seed=seed), **known)
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    targets = slice(len(power))
    there = (result.kind[targets] == PointKind.OBJECT).numpy()
    moved_m = torch.linalg.vector_norm(result.points[targets, :3], dim=-1) - torch.linalg.vector_norm(
        points[:, :3], dim=-1
    )
    found: dict[str, Array] = {key: np.array(value) for key, value in clear.items()}
    found["power_db"] = np.where(there, result.points[targets, 4].numpy(), np.nan)
    moves = {"range_m": moved_m.numpy(), "speed_m_per_s": (result.points[targets, 3] - points[:, 3]).numpy()}
    for name, move in moves.items():
        found[name] = np.where(there, clear[name] + move if effects else clear[name], np.nan)
    return found


def _unit(azimuth_rad: Array, elevation_rad: Array) -> Tensor:
    """``(N, 3)`` unit vectors, x ahead, y left, z up."""
    azimuth = torch.from_numpy(np.array(azimuth_rad, dtype=np.float64))
    elevation = torch.from_numpy(np.array(elevation_rad, dtype=np.float64))
    flat = elevation.cos()
    return torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], -1)
