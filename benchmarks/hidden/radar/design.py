"""Design of a radar study: targets, conditions and the error of the weather's record, all drawn from one seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchweather.gap.study import Study

from .radar_sensor import Effect, Targets, Weather, draw_targets, shoot, study_radar

__all__ = ["REL_SD", "Condition", "Design", "Size", "draw_design", "study_of", "with_record"]

# Amounts of the conditions before they are jittered: rates in mm/h, visibilities in m.
AMOUNTS = {
    "rain": (8.0, 20.0, 40.0, 75.0),
    "snow": (0.4, 0.9, 1.8, 3.2),
    "fog": (400.0, 220.0, 130.0, 80.0),
}
REL_SD = 0.1
# Records that are off by more than this many standard deviations are drawn again.
WORST_RECORD_SD = 2.5
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
    record = str(rng.choice(["common", "each"]))
    shared = float(np.clip(rng.standard_normal(), -WORST_RECORD_SD, WORST_RECORD_SD))
    if record_sd is not None:
        shared, record = record_sd * float(rng.choice([-1.0, 1.0])), "common"
    conditions = []
    picked = np.linspace(0, 3, design.size.rates).round().astype(int)
    for scene in range(design.size.scenes):
        for place, amount in enumerate(np.array(AMOUNTS[design.kind])[picked]):
            recorded = float(f"{amount * np.exp(rng.uniform(-0.1, 0.1)):.3g}")
            own = float(np.clip(rng.standard_normal(), -WORST_RECORD_SD, WORST_RECORD_SD))
            true = recorded * (1.0 + REL_SD * (shared if record == "common" else own))
            # One of the middle rates is held out, another one in each scene.
            split = "holdout" if place == min(1 + scene % 2, design.size.rates - 1) else "fit"
            weather = Weather(design.kind, float(f"{true:.6g}"))
            conditions.append(Condition(f"c{len(conditions):02d}", scene, weather, recorded, split))
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
        knob, spread = ("mor_m", "mor_rel_sd") if design.kind == "fog" else ("rate_mm_per_h", "rate_rel_sd")
        conditions.append(
            {
                "id": one.id,
                "scene": f"s{one.scene}",
                "weather": {"kind": design.kind, knob: one.recorded, spread: REL_SD},
                "frames": [frames[0] for _ in frames] if repeated else frames,
                "time_s": (FRAME_STEP_S * number).tolist(),
                "split": one.split,
            }
        )
    return Study.from_arrays(sensor=radar, scenes=given, conditions=conditions)
