"""Design of a study: streets, conditions and the error of the weather's record, all drawn from one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from torchweather.gap.study.study import Study

from ..records import drawn_amounts, drawn_record, recorded_weather
from .camera_sensor import Effect, Weather, shoot, study_camera
from .scene import Eye, FloatArray, Street, draw_street

__all__ = ["Condition", "Design", "Size", "draw_design", "study_of", "with_record"]

# Amounts of the conditions before they are jittered: rates in mm/h, visibilities in m.
AMOUNTS = {"rain": (8.0, 20.0, 45.0), "snow": (0.4, 1.0, 2.2), "fog": (400.0, 200.0, 100.0)}
FRAME_STEP_S = 10.0


@dataclass(frozen=True)
class Size:
    """How much data a study has."""

    width: int = 480
    height: int = 360
    streets: int = 2
    clear_frames: int = 8
    rates: int = 3
    frames: int = 6

    def smaller(self) -> Size:
        """Frames of a ninth of the pixels."""
        return replace(self, width=160, height=120)


@dataclass(frozen=True)
class Condition:
    """One street in one weather: as it truly is, and as it is recorded."""

    id: str
    street: int
    weather: Weather
    recorded: float
    split: str


@dataclass(frozen=True)
class Design:
    """Everything about a study but its hidden effects and its noise."""

    kind: str
    size: Size
    streets: tuple[Street, ...]
    conditions: tuple[Condition, ...]
    record: str


def draw_design(rng: np.random.Generator, kind: str, size: Size) -> Design:
    """Streets and conditions of a weather: ``rain``, ``snow`` or ``fog``."""
    eye = Eye(size.width, size.height)
    streets = tuple(draw_street(rng, eye) for _ in range(size.streets))
    return with_record(Design(kind, size, streets, (), ""), rng)


def with_record(design: Design, rng: np.random.Generator, record_sd: float | None = None) -> Design:
    """The same streets with conditions and errors of the record drawn anew.

    Args:
        design: with its streets.
        rng: draws.
        record_sd: error of the record in its standard deviations, with a sign drawn; ``None`` draws it.
    """
    record, shared = drawn_record(rng, record_sd)
    amounts = AMOUNTS[design.kind][: design.size.rates]
    conditions = [
        Condition(one.id, one.scene, Weather(design.kind, one.true), one.recorded, one.split)
        for one in drawn_amounts(rng, amounts, len(design.streets), record, shared)
    ]
    return replace(design, conditions=tuple(conditions), record=record)


def study_of(
    design: Design,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    *,
    clear_effects: tuple[Effect, ...] = (),
    acts: Callable[[Condition], bool] = lambda condition: True,
    seen: tuple[Street, ...] | None = None,
    repeated: bool = False,
) -> Study:
    """The study with effects hidden in it.

    Args:
        design: streets and conditions.
        effects: act in the weather frames.
        rng: of the noise.
        clear_effects: act in the clear frames.
        acts: whether the effects act in a condition.
        seen: what the weather frames see where it is not what the clear frames see.
        repeated: the first frame of each condition stands for all of them.
    """
    scenes = []
    for number, street in enumerate(design.streets):
        clear = shoot(street, Weather(), clear_effects, design.size.clear_frames, rng)
        geometry = {
            "depth_m": street.depth_m.astype(np.float32),
            "normal": street.normal.astype(np.float32),
            "label": street.label.astype(np.int64),
        }
        scenes.append({"id": f"s{number}", "clear": _frames(clear), "geometry": geometry})
    conditions = []
    for one in design.conditions:
        acting = effects if acts(one) else ()
        bayer = shoot((seen or design.streets)[one.street], one.weather, acting, design.size.frames, rng)
        frames = _frames(bayer[:1].repeat(len(bayer), 0) if repeated else bayer)
        conditions.append(
            {
                "id": one.id,
                "scene": f"s{one.street}",
                "weather": recorded_weather(design.kind, one.recorded),
                "frames": frames,
                "time_s": (FRAME_STEP_S * np.arange(len(bayer))).tolist(),
                "split": one.split,
            }
        )
    camera = study_camera(design.streets[0].eye)
    return Study.from_arrays(kind="camera", sensor=camera, scenes=scenes, conditions=conditions)


def _frames(bayer: FloatArray) -> list[dict[str, np.ndarray]]:
    return [{"bayer": frame.astype(np.float32)} for frame in bayer]
