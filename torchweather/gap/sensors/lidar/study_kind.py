"""A study of a LiDAR: its arrays, frames as the ready-made chain simulates them, and what such a study may lack."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import TorchweatherError
from torchweather.gap.sensors.lidar.reading_steps import within_steps
from torchweather.gap.sensors.lidar.stable_beams import beam_shares
from torchweather.gap.study.checks import UNIT_TOLERANCE, ArrayRule, refuse, unit_vectors
from torchweather.gap.study.conditions import Condition, StudyContent, StudyScene
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.kinds import Finding, Given, Looks, Paths, StudyKind, place
from torchweather.gap.study.recorded_frames import CloudFile, beam_directions
from torchweather.io.points import POINT_SUFFIXES
from torchweather.lidar.intensity import EIGHT_BITS, FULL_SCALE, are_integers, reflectivity_from_intensity
from torchweather.lidar.scan import scan_directions
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.point_kind import PointKind
from torchweather.scenes.lidar_view import reported_intensity

__all__ = ["LidarStudy", "simulated_lidar"]

# The darkest calibrated target that is sold (Spectralon) reflects 2 %; half of a scene is never half as dark.
DARKEST = 0.01
# Of the beams that return, that see one surface in all clear frames. Below the first the scene is hardly one.
FEW_STABLE, MANY_STABLE = 0.5, 0.8
GRID = ("H", "W")

Array = NDArray[Any]


class LidarStudy(StudyKind):
    """A study of a LiDAR."""

    name = "lidar"
    sensor_class = Lidar
    arrays: ClassVar[Mapping[str, Mapping[str, ArrayRule]]] = {
        "beams": {
            "direction": ArrayRule(
                (*GRID, 3), "unit vectors x forward, y left, z up", holds=unit_vectors, advice="Divide by their length."
            ),
        },
        "geometry": {
            "mask": ArrayRule(GRID, "0, or 1 for beams that do not count", 0.0, 1.0, whole=True, required=False),
            "cos_incidence": ArrayRule(
                GRID, "0..1, or NaN where a beam meets no surface", 0.0, 1.0 + UNIT_TOLERANCE, nan=True, required=False
            ),
            "up": ArrayRule(
                GRID,
                "-1..1 (z of the surface's normal), or NaN where a beam meets no surface",
                -1.0 - UNIT_TOLERANCE,
                1.0 + UNIT_TOLERANCE,
                nan=True,
                required=False,
            ),
        },
        "frame": {
            "range_m": ArrayRule(
                GRID, "0 m (no return) or more, finite", 0.0, advice="Set beams without a return to 0."
            ),
            "intensity": ArrayRule(
                GRID, "0 or more in the sensor's intensity_unit, finite", 0.0, advice="Set beams without a return to 0."
            ),
        },
    }
    shared = "beams"
    shared_wanted = "a LiDAR study needs direction (H, W, 3), unit vectors"
    frame_file, suffixes, kitti_folder = CloudFile, tuple(POINT_SUFFIXES), "velodyne"
    signal, signal_name = "intensity", "return"
    spread_effect = "lidar.patchy_weather"
    drift = "a drift of the laser's power passes for lidar.window_loss"
    loss_effect = "lidar.extinction_scale"

    def completed(self, sensor: Lidar, beams: Frame | None) -> tuple[Lidar, Frame | None]:
        """Beams of the sensor's scan pattern where none are given; the study keeps no others."""
        if beams is None and sensor.elevations_deg and sensor.columns:
            grid = (len(sensor.elevations_deg), sensor.columns, 3)
            beams = {"direction": scan_directions(sensor).reshape(grid).numpy()}
        return replace(sensor, directions=None), beams

    def recorded(
        self, sensor: Lidar, scenes: Paths, measured: Sequence[Path], given: Given, owner: str
    ) -> tuple[Lidar, Frame | None, Mapping[str, Frame]]:
        """Beams of all clouds."""
        if given["depth"] is not None:
            raise TorchweatherError(f"{owner}: depth belongs to a camera; the sensor is a LiDAR. Leave it out.")
        files = [*(path for some in scenes.values() for path in some), *measured]
        return sensor, {"direction": beam_directions(files, sensor, given["directions"], owner)}, {}

    def check_frame(self, sensor: Lidar, frame: Frame, name: str) -> None:
        """Intensities of the sensor's unit."""
        full_scale = FULL_SCALE[sensor.intensity_unit]
        if full_scale is not None:
            refuse(
                frame["intensity"] > full_scale,
                frame["intensity"],
                f"{name}: intensity must be at most {full_scale:g} in the sensor's intensity_unit",
                "Name the unit of the data in the sensor's overrides.",
            )

    def simulated(
        self, study: StudyContent, condition: Condition, start: Frame, seed: int, effects: tuple[Effect, ...] = ()
    ) -> Frame:
        """A scan in the condition's weather."""
        assert condition.weather is not None
        lidar = study.sensor_as(Lidar)
        intensity = torch.from_numpy(np.array(start["intensity"], dtype=np.float32))
        rounded = lidar.intensity_unit in EIGHT_BITS and bool(are_integers(intensity[None], lidar.intensity_unit).all())
        if rounded:
            start = {**start, "intensity": _unrounded(start, lidar, seed)}
        frame = simulated_lidar(
            start,
            study.beams["direction"],
            condition.weather,
            replace(lidar, intensity_unit="reflectivity") if rounded else lidar,
            seed,
            effects=effects,
            geometry=study.scenes[condition.scene].geometry,
        )
        if not rounded:
            return frame
        reflectivity, range_m = (torch.from_numpy(frame[name]) for name in ("intensity", "range_m"))
        return {**frame, "intensity": reported_intensity(reflectivity, range_m, lidar).numpy()}

    def signals(self, frame: Frame) -> Array:
        """Intensities of the returns."""
        return np.asarray(frame["intensity"])[np.asarray(frame["range_m"]) > 0]

    def geometry_findings(self, scene: str, geometry: Frame) -> Iterator[Finding]:
        """Angles, which distinguish wet surfaces."""
        if "cos_incidence" not in geometry:
            yield Finding(
                "warning",
                f"The scene {scene} has no cos_incidence.",
                "lidar.wet_target cannot be distinguished from lidar.window_loss: wet surfaces are known by the angle "
                "at which they are hit.",
                "Give cos_incidence (H, W) in the geometry.",
            )
        if "up" not in geometry:
            yield Finding(
                "note",
                f"The scene {scene} has no up.",
                "lidar.wet_target is harder to tell from lidar.ring_gain: what faces up gets wet first.",
                "Give up (H, W), the upward component of the surfaces' normals, in the geometry.",
            )

    def findings(self, study: StudyContent, clear: Looks, measured: Looks) -> Iterator[Finding]:
        """Intensities that are missing, or in another unit."""
        lidar = study.sensor_as(Lidar)
        unit = lidar.intensity_unit
        looks = [look for some in (*clear.values(), *measured.values()) for look in some if look.signals]
        high = {name: max((one.high for one in some if one.signals), default=math.inf) for name, some in clear.items()}
        black = [name for name, value in high.items() if value <= 0]
        if unit != "none" and black:
            yield Finding(
                "error",
                f"The clear frames of {', '.join(black)} have returns and no intensity "
                f"({place(study.scenes[black[0]].clear)}).",
                f"In {unit}, the sensor's intensity_unit, this says that nothing reflects: every "
                "return then stands at the threshold of detection, and any weather takes it away.",
                "Give the sensor's intensities, or state intensity_unit: none in the sensor's overrides.",
            )
        elif looks and min(look.low for look in looks) == max(look.high for look in looks):
            yield Finding(
                "warning",
                "All intensities are equal.",
                "Without intensities lidar.window_loss cannot be distinguished from lidar.threshold_shift, and "
                "extinction shows only in the points that are lost.",
                "Give the sensor's intensities where it has any.",
            )
        if unit not in ("none", "photons"):
            yield from _of_intensity_unit(lidar, clear)
        for scene in study.scenes.values():
            if len(scene.clear) > 1:
                yield from _of_stable_beams(scene)


def _of_stable_beams(scene: StudyScene) -> Iterator[Finding]:
    """Beams that see another surface, or none, from one clear frame to the next."""
    number = len(scene.clear)
    every = [torch.from_numpy(np.asarray(scene.clear[k]["range_m"], dtype=np.float32)).flatten() for k in range(number)]
    found = beam_shares(torch.stack(every))
    if found.stable + found.missing + found.moved == 0 or found.stable >= MANY_STABLE:
        return
    yield Finding(
        "warning" if found.stable < FEW_STABLE else "note",
        f"{100 * found.stable:.0f} % of the beams of scene {scene.id} that return see one surface in all {number} "
        f"clear frames; {100 * found.missing:.0f} % have no return in some, {100 * found.moved:.0f} % return from "
        "several ranges.",
        "Only the first are compared as surfaces; what moves, or comes and goes in clear air, hides what weather does.",
        "Record from a standing vehicle, with nothing that moves nearby; give a drive's frames as scenes of their own.",
    )


def _of_intensity_unit(lidar: Lidar, clear: Looks) -> Iterator[Finding]:
    """Half of a scene's returns brighter than white, or darker than anything: the data are in another unit."""
    unit = lidar.intensity_unit
    for name, looks in clear.items():
        middle = max((look.middle for look in looks if look.high > 0), default=math.nan)
        reflectivity = reflectivity_from_intensity(torch.tensor(middle), unit, lidar.assumed_reflectivity).item()
        if reflectivity < DARKEST or reflectivity > 1.0:
            yield Finding(
                "warning",
                f"The median intensity of the clear frames of {name}, {middle:.3g}, is a reflectivity of "
                f"{reflectivity:.2g} in {unit}, the sensor's intensity_unit.",
                f"Targets of a road lie between {DARKEST:g} and 1. In a wrong unit the model loses too many returns or "
                "too few.",
                "State the unit of the data as intensity_unit in the sensor's overrides.",
            )


@lru_cache(maxsize=64)
def _lidar_transform(weather: Weather, lidar: Lidar, effects: tuple[Effect, ...]) -> LidarWeather:
    return LidarWeather(weather, replace(lidar, directions=None), beam_ends="max_range", effects=effects)


def simulated_lidar(
    clear: Frame,
    direction: Array,
    weather: Weather,
    lidar: Lidar,
    seed: int,
    *,
    effects: tuple[Effect, ...] = (),
    geometry: Frame | None = None,
) -> dict[str, Array]:
    """A scan in a weather.

    Args:
        clear: ``range_m (H, W)``, 0 where no return; ``intensity (H, W)`` in the sensor's unit.
        direction: ``(H, W, 3)`` unit vectors.
        weather, lidar: as in ``LidarWeather``.
        seed: of the weather.
        effects: of the catalogue, put into the chain.
        geometry: of the scene: ``cos_incidence`` and ``up`` ``(H, W)`` where known, for effects that need them.

    Returns:
        The same arrays. A beam that still reports its object has the clear frame's own range, unless effects move it;
        of a dual-return sensor the strongest return counts.
    """
    grid = clear["range_m"].shape
    range_m, intensity = _flat(clear["range_m"]), _flat(clear["intensity"])
    beams = torch.from_numpy(np.array(direction, dtype=np.float32)).reshape(-1, 3)
    points = torch.cat([range_m[:, None] * beams, intensity[:, None]], -1)
    transform = _lidar_transform(weather, lidar, effects)
    if effects:
        return _with_effects(transform, points, beams, grid, seed, geometry or {})
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


def _unrounded(clear: Frame, lidar: Lidar, seed: int) -> Array:
    """Reflectivities that a sensor rounds down to the integers of a frame, drawn evenly within each step.

    A sensor in weather rounds once. Weather on integers would round twice: losses below a step vanish, and dark returns
    are lost that a sensor keeps.
    """
    levels = torch.from_numpy(np.asarray(clear["intensity"], dtype=np.float64))
    put_back = within_steps(levels, 1.0, seed)
    within = torch.where(torch.from_numpy(np.asarray(clear["range_m"]) > 0), put_back, 0.0).float()
    return reflectivity_from_intensity(within, lidar.intensity_unit, lidar.assumed_reflectivity).numpy()


def _with_effects(
    transform: LidarWeather, points: Tensor, beams: Tensor, grid: tuple[int, ...], seed: int, geometry: Frame
) -> dict[str, Array]:
    """A scan through a chain with effects, which need the grid of the beams and may move objects in range."""
    known = {name: _flat(geometry[name])[None] for name in ("cos_incidence", "up") if name in geometry}
    with torch.no_grad():
        state = transform.state_of(points[None], beams).changed(grid=tuple(grid), **known)
        out = transform.chain(state, transform.draw(points[None], seed=torch.tensor([seed])))
    lost = out.returns.kind[0, :, 0] == PointKind.LOST
    range_m = torch.linalg.vector_norm(out.returns.points[0, :, :3], dim=-1)
    return {
        "range_m": range_m.masked_fill(lost, 0.0).reshape(grid).numpy(),
        "intensity": out.returns.points[0, :, 3].masked_fill(lost, 0.0).reshape(grid).numpy(),
    }


def _flat(values: Array) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float32)).reshape(-1)
