"""Decoys: studies that tempt to name an effect that is not there, or not there as it seems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from .design import Condition, Design
from .effects import CATALOGUE
from .lidar_shot import Echoes, Effect, Shot, View
from .rays import cast
from .scene import move_a_car

__all__ = ["DECOYS", "STRENGTHS_OF", "Decoy"]

Parameters = Callable[[str, float], dict[str, float]]


@dataclass(frozen=True)
class Decoy:
    """How a study is made, and which answers are right.

    Args:
        verdicts: that are right.
        names: that may be asserted.
        effects, clear_effects: in the weather frames and in the clear ones.
        acts: whether the effects act in a condition.
        views: what the weather frames see; ``None`` is what the clear frames see.
        clear_views: what the clear frames see; ``None`` is what the design says.
        repeated: the first frame stands for all; then refusing the study is right too.
    """

    verdicts: tuple[str, ...]
    names: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()
    clear_effects: tuple[Effect, ...] = ()
    acts: Callable[[Condition], bool] = field(default=lambda condition: True)
    views: tuple[View, ...] | None = None
    clear_views: tuple[View, ...] | None = None
    repeated: bool = False


class _FadingLaser(Effect):
    """The laser loses power through a condition's frames."""

    def __init__(self, end_db: float) -> None:
        self.end_db = end_db

    def on_echoes(self, shot: Shot, echoes: Echoes) -> None:
        share = shot.time_s / max(float(shot.time_s.max()), 1e-9)
        gain = 10.0 ** (-0.1 * self.end_db * share)
        echoes.target, echoes.signal = echoes.target * gain[:, None], echoes.signal * gain[echoes.frame]


def _known(name: str, parameters: dict[str, float]) -> Effect:
    return CATALOGUE[name](dict(parameters))


def _parked_car(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    views = tuple(_seen(view, replace(view, scene=move_a_car(view.scene, rng))) for view in design.views)
    # A car in a new place is a structure that stands there in every weather frame.
    return Decoy(("none", "unknown", "named_and_rest"), ("lidar.static_structure",), views=views)


def _pose_shift(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    yaw, pitch = np.radians(0.2) * rng.choice([-1.0, 1.0], 2) * (1.0, 0.5)
    found = []
    for view in design.views:
        seen = _seen(view, replace(view, scan=view.scan.turned(float(yaw), float(pitch))))
        found.append(replace(seen, scan=view.scan))  # the record knows nothing of the turn
    return Decoy(("none", "unknown"), views=tuple(found))


def _seen(view: View, changed: View) -> View:
    return replace(changed, target=cast(changed.scene, changed.scan, view.sensor.max_range_m))


def _laser_drift(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    return Decoy(("unknown", "named_and_rest"), ("lidar.window_loss",), (_FadingLaser(float(rng.uniform(1.0, 2.0))),))


def _cancelling(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    loss = float(rng.uniform(0.6, 1.5))
    effects = (
        _known("lidar.window_loss", {"loss_db": loss}),
        _known("lidar.threshold_shift", {"shift_db": -loss}),
    )
    return Decoy(("named", "named_and_rest", "unknown"), ("lidar.window_loss", "lidar.threshold_shift"), effects)


def _fit_only(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    effect = _known("lidar.window_loss", at("lidar.window_loss", 30.0))
    return Decoy(("unknown", "none"), (), (effect,), acts=lambda condition: condition.split == "fit")


def _duplicated(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    return Decoy(("none", "refused"), repeated=True)


def _in_clear_too(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    effect = _known("lidar.range_noise", at("lidar.range_noise", 30.0))
    return Decoy(("none",), (), (effect,), (effect,))


def _no_target(design: Design, at: Parameters, rng: np.random.Generator) -> Decoy:
    farthest = max(float(view.target.range_m[np.isfinite(view.target.range_m)].max()) for view in design.views)
    return Decoy(("none",), (), (_known("lidar.limited_extent", {"extent_m": 2.0 * farthest}),))


DECOYS: dict[str, Callable[[Design, Parameters, np.random.Generator], Decoy]] = {
    "decoy.parked_car": _parked_car,
    "decoy.pose_shift": _pose_shift,
    "decoy.laser_drift": _laser_drift,
    "decoy.cancelling": _cancelling,
    "decoy.fit_only": _fit_only,
    "decoy.duplicated": _duplicated,
    "decoy.in_clear_too": _in_clear_too,
    "decoy.no_target": _no_target,
}
"""By name: from the design and the parameters of effects at a level."""

STRENGTHS_OF = {"decoy.fit_only": ("lidar.window_loss",), "decoy.in_clear_too": ("lidar.range_noise",)}
"""Decoys that ask for parameters at a level, and of which effects."""
