"""Design of a study: scenes, sensor, conditions and the error of the weather's record, all drawn from one seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study
from torchweather.sensors import Lidar

from ..records import WORST_RECORD_SD, drawn_amounts, recorded_weather
from .lidar_sensor import shoot, study_sensor
from .lidar_shot import Effect, Report, View, Weather
from .rays import Scan, cast, scan_pattern
from .scene import Scene, draw_scene

__all__ = ["Condition", "Design", "Size", "draw_design", "study_of", "with_record"]

# Amounts of the conditions before they are jittered: rates in mm/h, visibilities in m.
AMOUNTS = {
    "rain": (8.0, 20.0, 40.0, 75.0),
    "snow": (0.4, 0.9, 1.8, 3.2),
    "fog": (400.0, 220.0, 130.0, 80.0),
}
# Near-range response, m: (start, full) between which it is drawn. Drops of rain show only where it begins early.
NEAR_RESPONSE = {"rain": ((0.6, 1.4), (2.5, 4.0)), "snow": ((1.5, 2.5), (6.0, 10.0)), "fog": ((1.5, 2.5), (8.0, 10.0))}
FRAME_STEP_S = 10.0


@dataclass(frozen=True)
class Size:
    """How much data a study has."""

    rings: int = 64
    columns: int = 256
    scenes: int = 2
    clear_frames: int = 8
    rates: int = 4
    frames: int = 6

    def smaller_grid(self) -> Size:
        """A quarter of the beams."""
        return replace(self, rings=32, columns=128)


@dataclass(frozen=True)
class Condition:
    """One scene in one weather: as it truly is, and as it is recorded; at a speed, where the vehicle drives."""

    id: str
    scene: int
    weather: Weather
    recorded: float
    split: str
    ego_speed_m_per_s: float | None = None


@dataclass(frozen=True)
class Design:
    """Everything about a study but its hidden effects and its noise."""

    kind: str
    size: Size
    scan: Scan
    sensor: Lidar
    scenes: tuple[Scene, ...]
    views: tuple[View, ...]
    conditions: tuple[Condition, ...]
    record: str

    @property
    def times_s(self) -> np.ndarray:
        """Of a condition's frames."""
        return FRAME_STEP_S * np.arange(self.size.frames)


def draw_design(
    rng: np.random.Generator,
    kind: str,
    size: Size | None = None,
    record: str | None = None,
    record_sd: float | None = None,
) -> Design:
    """Scenes, conditions and the error of the record.

    Args:
        rng: draws.
        kind: ``rain``, ``snow`` or ``fog``.
        size: amount of data.
        record: ``common`` (one error for all conditions, as of a gauge) or ``each`` (one for each); ``None`` draws it.
        record_sd: error of the record in its standard deviations, with a sign drawn; ``None`` draws it.
    """
    size = size or Size()
    scan = scan_pattern(size.rings, size.columns)
    start, full = (round(float(rng.uniform(*ends)), 2) for ends in NEAR_RESPONSE[kind])
    sensor = study_sensor(scan, start, full)
    scenes = tuple(draw_scene(rng) for _ in range(size.scenes))
    views = tuple(View(scan, cast(scene, scan, sensor.max_range_m), sensor, scene) for scene in scenes)
    bare = Design(kind, size, scan, sensor, scenes, views, (), "")
    return with_record(bare, rng, record, record_sd)


def with_record(
    design: Design, rng: np.random.Generator, record: str | None = None, record_sd: float | None = None
) -> Design:
    """The same scenes and sensor with conditions and errors of the record drawn anew; arguments as `draw_design`."""
    record = record or str(rng.choice(["common", "each"]))
    if record_sd is None:
        shared = float(np.clip(rng.standard_normal(), -WORST_RECORD_SD, WORST_RECORD_SD))
    else:
        shared, record = record_sd * float(rng.choice([-1.0, 1.0])), "common"
    picked = np.linspace(0, 3, design.size.rates).round().astype(int)
    amounts = np.array(AMOUNTS[design.kind])[picked].tolist()
    conditions = [
        Condition(one.id, one.scene, Weather(design.kind, one.true), one.recorded, one.split)
        for one in drawn_amounts(rng, amounts, design.size.scenes, record, shared)
    ]
    return replace(design, conditions=tuple(conditions), record=record)


def study_of(
    design: Design,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    *,
    clear_effects: tuple[Effect, ...] = (),
    acts: Callable[[Condition], bool] = lambda condition: True,
    grown: Callable[[Effect, Condition], Effect] = lambda effect, condition: effect,
    views: tuple[View, ...] | None = None,
    repeated: bool = False,
) -> Study:
    """The study with effects hidden in it.

    Args:
        design: scenes and conditions.
        effects: act in the weather frames.
        rng: of the noise.
        clear_effects: act in the clear frames.
        acts: whether the effects act in a condition.
        grown: an effect as it is in a condition.
        views: what the weather frames see where it is not what the clear frames see.
        repeated: the first frame of each condition stands for all of them.
    """
    clear_times = FRAME_STEP_S * np.arange(design.size.clear_frames)
    scenes = []
    for number, view in enumerate(design.views):
        report = shoot(view, Weather(), clear_effects, clear_times, rng)
        geometry = {
            "cos_incidence": _grid(design, view.target.cos_incidence),
            "up": _grid(design, view.target.up),
        }
        scenes.append({"id": f"s{number}", "clear": _frames(design, report), "geometry": geometry})
    seen = views or design.views
    conditions: list[Mapping[str, Any]] = []
    for one in design.conditions:
        acting = tuple(grown(effect, one) for effect in effects) if acts(one) else ()
        report = shoot(seen[one.scene], one.weather, acting, design.times_s, rng)
        frames = _frames(design, report)
        if repeated:
            frames = [frames[0] for _ in frames]
        conditions.append(
            {
                "id": one.id,
                "scene": f"s{one.scene}",
                "weather": recorded_weather(design.kind, one.recorded),
                "frames": frames,
                "time_s": design.times_s.tolist(),
                "split": one.split,
                **({} if one.ego_speed_m_per_s is None else {"ego_speed_m_per_s": one.ego_speed_m_per_s}),
            }
        )
    beams = {"direction": design.scan.direction.astype(np.float32)}
    return Study.from_arrays(sensor=design.sensor, beams=beams, scenes=scenes, conditions=conditions)


def _grid(design: Design, values: np.ndarray) -> np.ndarray:
    return values.reshape(design.scan.shape).astype(np.float32)


def _frames(design: Design, report: Report) -> list[dict[str, np.ndarray]]:
    return [
        {"range_m": _grid(design, range_m), "intensity": _grid(design, intensity)}
        for range_m, intensity in zip(report.range_m, report.intensity, strict=True)
    ]
