"""Decoys: what looks like a missing effect and is none, or is another one than it looks like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from .design import Condition, Design
from .effects import CATALOGUE
from .radar_sensor import Effect, Shot, Targets

__all__ = ["DECOYS", "STRENGTHS_OF", "Decoy"]

Parameters = Callable[[str, float], dict[str, float]]


@dataclass(frozen=True)
class Decoy:
    """What is done to a study, and which answers are right.

    Args:
        verdicts: that are right.
        names: of effects that may be named.
        effects, clear_effects: of weather and clear frames.
        acts: in which conditions.
        scenes: that the weather frames see.
        repeated: as in ``study_of``.
    """

    verdicts: tuple[str, ...]
    names: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()
    clear_effects: tuple[Effect, ...] = ()
    acts: Callable[[Condition], bool] = field(default=lambda condition: True)
    scenes: tuple[Targets, ...] | None = None
    repeated: bool = False


class _FadingTransmitter(Effect):
    """The transmitter loses power through a condition's frames."""

    def __init__(self, end_db: float) -> None:
        self.end_db = end_db

    def on_path(self, shot: Shot) -> None:
        shot.gain_db -= (self.end_db * shot.number / max(float(shot.number.max()), 1.0))[:, None]


class _FarLoss(Effect):
    """A loss where no target stands."""

    def on_path(self, shot: Shot) -> None:
        shot.gain_db -= np.where(shot.targets.range_m > 1.5 * shot.targets.range_m.max(), 20.0, 0.0)


def _moved_target(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    scenes = []
    for targets in design.scenes:
        near = np.argsort(-targets.rcs_dbsm)[:2]  # two cars that stand elsewhere now: gone from where they were
        rcs = targets.rcs_dbsm.copy()
        rcs[near] = -80.0
        scenes.append(replace(targets, rcs_dbsm=rcs))
    return Decoy(("none", "unknown", "named_and_rest"), ("radar.wet_rcs",), scenes=tuple(scenes))


def _power_drift(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    effect = _FadingTransmitter(float(rng.uniform(1.0, 2.0)))
    return Decoy(("unknown", "named_and_rest"), ("radar.wet_radome",), (effect,))


def _pose_shift(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    turn = float(np.radians(0.2) * rng.choice([-1.0, 1.0]))
    scenes = tuple(replace(one, azimuth_rad=one.azimuth_rad + turn) for one in design.scenes)
    # Powers change as those of a pattern that is turned by as much.
    return Decoy(("none", "unknown", "named"), ("radar.pattern_tilt",), scenes=scenes)


def _cancelling(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    loss = float(rng.uniform(1.0, 2.5))
    effects = (
        CATALOGUE["radar.wet_radome"]({"loss_db": loss}),
        CATALOGUE["radar.noise_floor"]({"shift_db": -loss}),
    )
    return Decoy(
        ("named", "named_and_rest", "unknown"), ("radar.wet_radome", "radar.noise_floor", "radar.wet_rcs"), effects
    )


def _fit_only(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    effect = CATALOGUE["radar.wet_radome"](at("radar.wet_radome", 30.0))
    return Decoy(("unknown", "none"), (), (effect,), acts=lambda condition: condition.split == "fit")


def _duplicated(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    return Decoy(("none", "refused"), repeated=True)


def _in_clear_too(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    effect = CATALOGUE["radar.doppler_spread"](at("radar.doppler_spread", 30.0))
    return Decoy(("none",), (), (effect,), (effect,))


def _no_target(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    return Decoy(("none",), (), (_FarLoss(),))


DECOYS: dict[str, Callable[[Design, Parameters, np.random.Generator], Decoy]] = {
    "decoy.moved_target": _moved_target,
    "decoy.power_drift": _power_drift,
    "decoy.pose_shift": _pose_shift,
    "decoy.cancelling": _cancelling,
    "decoy.fit_only": _fit_only,
    "decoy.duplicated": _duplicated,
    "decoy.in_clear_too": _in_clear_too,
    "decoy.no_target": _no_target,
}
"""By name: from the design and the parameters of effects at a level."""

STRENGTHS_OF = {"decoy.fit_only": ("radar.wet_radome",), "decoy.in_clear_too": ("radar.doppler_spread",)}
"""Decoys that ask for parameters at a level, and of which effects."""
