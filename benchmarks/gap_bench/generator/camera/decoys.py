"""Decoys: studies that tempt to name an effect that is not there, or not there as it seems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .camera_sensor import Effect, Shot
from .design import Condition, Design
from .effects import CATALOGUE
from .scene import FloatArray, Street, with_a_moved_car

__all__ = ["DECOYS", "Decoy"]


@dataclass(frozen=True)
class Decoy:
    """How a study is made, and which answers are right; fields as in ``study_of``."""

    verdicts: tuple[str, ...]
    names: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()
    clear_effects: tuple[Effect, ...] = ()
    acts: Callable[[Condition], bool] = field(default=lambda condition: True)
    seen: tuple[Street, ...] | None = None
    repeated: bool = False


class _Drift(Effect):
    """The exposure falls through a condition's frames."""

    def __init__(self, end: float) -> None:
        self.end = end

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        return light * (1.0 - self.end * shot.number / max(shot.frames - 1, 1))


def _moved_car(design: Design, rng: np.random.Generator) -> Decoy:
    seen = tuple(with_a_moved_car(street, rng) for street in design.streets)
    return Decoy(("unknown", "refused"), seen=seen)


def _drift(design: Design, rng: np.random.Generator) -> Decoy:
    return Decoy(("unknown", "named_and_rest"), ("camera.exposure_gain",), (_Drift(float(rng.uniform(0.03, 0.08))),))


def _fit_only(design: Design, rng: np.random.Generator) -> Decoy:
    effect = CATALOGUE["camera.exposure_gain"]({"factor": 1.02})
    return Decoy(("unknown", "none"), (), (effect,), acts=lambda condition: condition.split == "fit")


def _duplicated(design: Design, rng: np.random.Generator) -> Decoy:
    return Decoy(("none", "refused"), repeated=True)


def _in_clear_too(design: Design, rng: np.random.Generator) -> Decoy:
    # A blur or a vignetting of particles and airlight would not be in the clear frames.
    effect = CATALOGUE["camera.exposure_gain"]({"factor": 0.9})
    return Decoy(("none",), (), (effect,), (effect,))


def _no_target(design: Design, rng: np.random.Generator) -> Decoy:
    """A saturation above all there is."""
    return Decoy(("none",), (), (CATALOGUE["camera.saturation"]({"level": 0.99}),))


DECOYS: dict[str, Callable[[Design, np.random.Generator], Decoy]] = {
    "decoy.moved_car": _moved_car,
    "decoy.exposure_drift": _drift,
    "decoy.fit_only": _fit_only,
    "decoy.duplicated": _duplicated,
    "decoy.in_clear_too": _in_clear_too,
    "decoy.no_target": _no_target,
}
"""By name: from the design and a generator of random numbers."""
