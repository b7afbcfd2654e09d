"""Samples of one scene in one weather side by side, level by level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.evaluation.sweep.levels import Level
from torchweather.evaluation.sweep.run import Sample

__all__ = ["Series", "series_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Series:
    """The scores of one scene in one weather.

    Args:
        scene: what is judged together.
        sensor: its kind.
        levels: lightest first.
        subjects: names of the frames or clouds of the scene.
        seeds: drawn.
        scores: by metric, ``(L, S)``: a row a level, a column a subject and seed, alike in every row.
        facts: likewise.
        clear: facts of the clear data, mean over the subjects.
        directions: of every metric, ``up`` or ``down``.
        render_s, score_s: mean seconds of a sample; scoring of those that were scored.
    """

    scene: str
    sensor: str
    levels: tuple[Level, ...]
    subjects: tuple[str, ...]
    seeds: tuple[int, ...]
    scores: Mapping[str, Floats]
    facts: Mapping[str, Floats]
    clear: Mapping[str, float]
    directions: Mapping[str, str]
    render_s: float
    score_s: float

    def worsening(self, metric: str) -> Floats:
        """Scores ``(L, S)`` turned so that they rise when quality falls."""
        return self.scores[metric] if self.directions[metric] == "down" else -self.scores[metric]


def series_of(found: Iterable[Sample]) -> list[Series]:
    """Samples grouped by scene and weather, in the order in which they come."""
    groups: dict[tuple[str, str], list[Sample]] = {}
    for sample in found:
        groups.setdefault((sample.subject.scene, sample.level.name), []).append(sample)
    return [_series(scene, group) for (scene, _), group in groups.items()]


def _series(scene: str, group: list[Sample]) -> Series:
    levels = sorted({sample.level.severity: sample.level for sample in group}.values(), key=lambda one: one.severity)
    subjects = {sample.subject.name: sample.subject for sample in group}
    seeds = tuple(dict.fromkeys(sample.seed for sample in group))
    by_place = {(sample.level.severity, sample.subject.name, sample.seed): sample for sample in group}
    rows = [[by_place[level.severity, name, seed] for name in subjects for seed in seeds] for level in levels]
    clear = [subject.facts(None) for subject in subjects.values()]
    scored = [sample.score_s for sample in group if sample.score_s > 0.0]
    return Series(
        scene=scene,
        sensor=group[0].subject.sensor,
        levels=tuple(levels),
        subjects=tuple(subjects),
        seeds=seeds,
        scores={
            metric: np.array([[sample.scores[metric] for sample in row] for row in rows]) for metric in group[0].scores
        },
        facts={
            fact: np.array([[sample.facts.get(fact, np.nan) for sample in row] for row in rows])
            for fact in group[0].facts
        },
        clear={fact: float(np.mean([one[fact] for one in clear if fact in one] or [np.nan])) for fact in clear[0]},
        directions={metric: group[0].subject.directions[metric] for metric in group[0].scores},
        render_s=float(np.mean([sample.render_s for sample in group])),
        score_s=float(np.mean(scored)) if scored else 0.0,
    )
