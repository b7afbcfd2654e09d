"""Design of a radar study: targets, conditions and the error of the weather's record, all drawn from one seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchweather.gap.study.study import Study

from ..records import drawn_amounts, drawn_record, recorded_weather
from .radar_sensor import Effect, Targets, Weather, draw_targets, shoot, study_radar

__all__ = ["Condition", "Design", "Size", "draw_design", "study_of", "with_record"]

# Amounts of the conditions before they are jittered: rates in mm/h, visibilities in m.
AMOUNTS = {
    "rain": (8.0, 20.0, 40.0, 75.0),
    "snow": (0.4, 0.9, 1.8, 3.2),
    "fog": (400.0, 220.0, 130.0, 80.0),
}
FRAME_STEP_S = 0.1


@dataclass(frozen=True)
class Size:
    """How much data a study has."""

    targets: int = 128
    scenes: int = 2
    clear_frames: int = 8
    rates: int = 4
    frames: int = 6

    def fewer_targets(self) -> Size:
        """Half of the targets."""
        return replace(self, targets=64)


@dataclass(frozen=True)
class Condition:
    """One scene in one weather: as it truly is, and as it is recorded."""

    id: str
    scene: int
    weather: Weather
    recorded: float
    split: str


@dataclass(frozen=True)
class Design:
    """Everything about a study but its hidden effects and its noise."""

    kind: str
    size: Size
    scenes: tuple[Targets, ...]
    conditions: tuple[Condition, ...]
    record: str


def draw_design(rng: np.random.Generator, kind: str, size: Size | None = None) -> Design:
    """Scenes and conditions whose record is right.

    Args:
        rng: draws.
        kind: ``rain``, ``snow`` or ``fog``.
        size: amount of data.
    """
    size = size or Size()
    scenes = tuple(draw_targets(rng, size.targets) for _ in range(size.scenes))
    return with_record(Design(kind, size, scenes, (), ""), rng, 0.0)


def with_record(design: Design, rng: np.random.Generator, record_sd: float | None = None) -> Design:
    """The same scenes with conditions and errors of the record drawn anew.

    Args:
        design: scenes and size.
        rng: draws.
        record_sd: error of the record in its standard deviations, common to all conditions, with a sign drawn;
            ``None`` draws it, common to all or one for each.
    """
    record, shared = drawn_record(rng, record_sd)
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
    scenes: tuple[Targets, ...] | None = None,
    repeated: bool = False,
) -> Study:
    """The study with effects hidden in it.

    Args:
        design: scenes and conditions.
        effects: act in the weather frames.
        rng: of the noise.
        clear_effects: act in the clear frames.
        acts: whether the effects act in a condition.
        scenes: what the weather frames see where it is not what the clear frames see.
        repeated: the first frame of each condition stands for all of them.
    """
    radar = study_radar()
    clear_number = np.arange(design.size.clear_frames)
    given: list[Mapping[str, Any]] = []
    for place, targets in enumerate(design.scenes):
        report = shoot(radar, targets, Weather(), clear_effects, clear_number, rng)
        given.append({"id": f"s{place}", "clear": report.frames(), "geometry": targets.geometry})
    seen = scenes or design.scenes
    number = np.arange(design.size.frames)
    conditions: list[Mapping[str, Any]] = []
    for one in design.conditions:
        report = shoot(radar, seen[one.scene], one.weather, effects if acts(one) else (), number, rng)
        frames = report.frames()
        conditions.append(
            {
                "id": one.id,
                "scene": f"s{one.scene}",
                "weather": recorded_weather(design.kind, one.recorded),
                "frames": [frames[0] for _ in frames] if repeated else frames,
                "time_s": (FRAME_STEP_S * number).tolist(),
                "split": one.split,
            }
        )
    return Study.from_arrays(sensor=radar, scenes=given, conditions=conditions)
