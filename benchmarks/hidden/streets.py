"""Streets of a set of cases: one design with, for each effect, the strengths that reach d' of 5, 10 and 30."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .design import Design, Size, draw_design
from .detectability import IDENTIFIABLE_BELOW, Detector, confusion
from .effects import CATALOGUE
from .sealed import plain, read_json, write_json

__all__ = ["LEVELS", "Street", "street"]

LEVELS = (5.0, 10.0, 30.0)


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
        """Effects whose signature is nearly parallel, with the cosine; ``None`` where it was not asked for."""
        held = self.table[name][f"{level:g}"]["cosine"]
        if held is None:
            return None
        return {other: value for other, value in held.items() if value >= IDENTIFIABLE_BELOW}


def street(key: list[int], kind: str, size: Size, cache: Path | None, names: tuple[str, ...] | None = None) -> Street:
    """The street of a key, from the cache where it is there.

    Args:
        key: whole numbers from which all draws follow.
        kind: of the weather.
        size: amount of data.
        cache: folder of tables; part of what is sealed.
        names: effects that are needed; then cosines with the others are not computed. ``None``: all of them.
    """
    rng = np.random.default_rng(key)
    design = draw_design(rng, kind, size, record="common", record_sd=0.0)
    path = None if cache is None else cache / f"street-{kind}-{'-'.join(map(str, key))}.json"
    if path is not None and path.exists():
        held = read_json(path)
        if set(names or CATALOGUE) <= set(held):
            return Street(design, held)
    detector = Detector(design, key[-1] + 1)
    draws = {name: np.random.default_rng([*key, place]) for place, name in enumerate(CATALOGUE)}
    curves = {}
    for name in names or CATALOGUE:
        kind_of, own = CATALOGUE[name], draws[name]
        sign = float(own.choice([-1.0, 1.0])) if kind_of.two_sided else 1.0
        curves[name] = detector.curve(name, kind_of.fixed(own), sign)
    table: dict[str, dict[str, Any]] = {}
    for name, curve in curves.items():
        table[name] = {"lengths": [float(f"{value:.4g}") for value in curve.lengths]}
        for level in LEVELS:
            strength = curve.strength_for(level)
            if strength is None:
                continue
            table[name][f"{level:g}"] = {
                "strength": strength,
                "parameters": curve.effect(strength).parameters,
                "cosine": None if names else {k: round(v, 4) for k, v in confusion(curves, name, strength).items()},
            }
    table = plain(table)
    if path is not None:
        write_json(path, table)
    return Street(design, table)
