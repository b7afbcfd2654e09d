"""Streets of a set of cases: one design with, for each effect, the strengths that reach d' of 5, 10 and 30."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...sealed import plain, read_json, write_json
from .design import Design, Size, draw_design
from .detectability import IDENTIFIABLE_BELOW, KINDS, Curve, Detector, confusion

__all__ = ["LEVELS", "Street", "street"]

LEVELS = (5.0, 10.0, 30.0)
# d' over its level that still counts as that level.
NEAR = (0.65, 1.5)
# In fog an extinction f times as strong gives the frames of a record f times as dense with particles 1 / f times as
# bright, beam by beam: extinction f a, backscatter b = (f b) / f. The record may be off, so nothing distinguishes them.
# Cosines do not show it: the response to a rate is removed along a direction that has noise of its own.
ALIKE_IN_FOG = ("lidar.extinction_scale", "lidar.particle_backscatter")


@dataclass(frozen=True)
class Street:
    """A design and what effects look like in it.

    Args:
        design: scenes and sensor.
        table: by effect and level: parameters, and the largest cosine with each other effect.
    """

    design: Design
    table: dict[str, dict[str, Any]]

    def has(self, name: str, level: float) -> bool:
        """Whether the effect can be that strong here."""
        return f"{level:g}" in self.table.get(name, {})

    def parameters(self, name: str, level: float) -> dict[str, float]:
        """At the strength of a level."""
        held = self.table[name][f"{level:g}"]["parameters"]
        return {key: float(value) for key, value in held.items()}

    def confusable(self, name: str, level: float) -> dict[str, float] | None:
        """Effects whose signature is nearly parallel, with the cosine, or the same; ``None`` where it was not asked for
        and is none."""
        fog = any(one.weather.kind == "fog" for one in self.design.conditions)
        same = {other: 1.0 for other in ALIKE_IN_FOG if other != name and name in ALIKE_IN_FOG and fog}
        held = self.table[name][f"{level:g}"]["cosine"]
        if held is None:
            return same or None
        return {other: value for other, value in held.items() if value >= IDENTIFIABLE_BELOW} | same


def street(key: list[int], kind: str, size: Size, cache: Path | None, names: tuple[str, ...] | None = None) -> Street:
    """The street of a key, from the cache where it is there.

    Args:
        key: whole numbers from which all draws follow.
        kind: of the weather.
        size: amount of data.
        cache: folder of tables; part of what is sealed.
        names: effects that are needed; then cosines with the others are not computed. Without any it is the design
            alone. ``None``: all, also those outside of the catalogue.
    """
    rng = np.random.default_rng(key)
    design = draw_design(rng, kind, size, record="common", record_sd=0.0)
    wanted = tuple(KINDS) if names is None else names
    if not wanted:
        return Street(design, {})
    path = None if cache is None else cache / f"street-{kind}-{'-'.join(map(str, key))}.json"
    if path is not None and path.exists():
        held = read_json(path)
        if set(wanted) <= set(held):
            return Street(design, held)
    detector = Detector(design, key[-1] + 1)
    draws = {name: np.random.default_rng([*key, place]) for place, name in enumerate(KINDS)}
    curves = {}
    for name in wanted:
        kind_of, own = KINDS[name], draws[name]
        sign = float(own.choice([-1.0, 1.0])) if kind_of.two_sided else 1.0
        curves[name] = detector.curve(name, kind_of.fixed(own), sign)
    table: dict[str, dict[str, Any]] = {}
    for name, curve in curves.items():
        table[name] = {"lengths": [float(f"{value:.4g}") for value in curve.lengths]}
        for level in LEVELS:
            strength = curve.strength_for(level)
            if strength is None:
                continue
            strength, reached = _refined(detector, curve, strength, level)
            # Some effects come in steps, such as a column of beams: the highest level then stands for more, too.
            if reached < NEAR[0] * level or (reached > NEAR[1] * level and level != LEVELS[-1]):
                continue
            table[name][f"{level:g}"] = {
                "strength": strength,
                "reached": round(reached, 2),
                "parameters": curve.effect(strength).parameters,
                "cosine": None if names else {k: round(v, 4) for k, v in confusion(curves, name, strength).items()},
            }
    table = plain(table)
    if path is not None:
        write_json(path, table)
    return Street(design, table)


def _refined(detector: Detector, curve: Curve, strength: float, level: float) -> tuple[float, float]:
    """A strength nearer to the level, by a step along a d' that grows as a power of the swept parameter."""
    kind = KINDS[curve.name]
    per_strength = abs(np.log(kind.strong / kind.weak))
    best = (np.inf, strength, 0.0)
    for _ in range(2):
        reached = detector.length_of(curve.effect(strength))
        away = abs(np.log(max(reached, 0.1) / level))
        best = min(best, (away, strength, reached))
        if away < 0.15:
            break
        strength = float(np.clip(strength + np.log(level / max(reached, 0.2 * level)) / per_strength, 0.01, 1.0))
    return best[1], best[2]
