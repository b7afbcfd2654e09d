"""The validation process of D3.4 (Figure 18): measured against clear beside simulated against clear."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchweather import __version__
from torchweather.core.errors import InputValueError
from torchweather.core.threads import one_thread_an_operation
from torchweather.evaluation.validation.comparison import FAMILY_LEVEL, Comparison, Sample, judged
from torchweather.evaluation.validation.frame_scores import FrameScores, frame_scores
from torchweather.evaluation.validation.link_scores import compared_links
from torchweather.evaluation.validation.quantities import Quantity, Values, compared_quantities, values_of
from torchweather.evaluation.validation.severity import TrendComparison, class_trends, compared_trends, weather_label
from torchweather.gap.diagnosis import Finding, diagnose
from torchweather.gap.study.simulation import simulate, start_frame
from torchweather.gap.study.study import Condition, Study, StudyScene

__all__ = ["ConditionResult", "Validation", "reference_frame", "validate"]

Step = Callable[[int], object]
SMALL_FRAME = 1 << 18  # values: operations on its float32 arrays of 1 MB take less than waking a pool of threads


@dataclass(frozen=True)
class ConditionResult:
    """Measured and simulated frames of one condition against clear frames.

    Args:
        id, scene, label, split: of the condition; the label is its weather in words.
        weather: as a dictionary; None is clear air.
        frames: how many were measured, and as many simulated.
        scores: in the order of the study's scores.
        quantities: distributions of scalar quantities.
        simulation_s: seconds for each simulated frame; the first of a weather and sensor sets the transform up.
    """

    id: str
    scene: str
    label: str
    split: str
    weather: Mapping[str, Any] | None
    frames: int
    scores: tuple[Comparison, ...]
    quantities: tuple[Quantity, ...]
    simulation_s: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "id": self.id,
            "scene": self.scene,
            "label": self.label,
            "split": self.split,
            "weather": None if self.weather is None else dict(self.weather),
            "frames": self.frames,
            "scores": [score.to_dict() for score in self.scores],
            "quantities": [quantity.to_dict() for quantity in self.quantities],
            "simulation_s": [round(seconds, 6) for seconds in self.simulation_s],
        }


@dataclass(frozen=True)
class Validation:
    """What ``validate`` found.

    Args:
        kind: of the study.
        seed: of the simulation.
        sha256: of the study.
        conditions: in the study's order.
        trends: over the severity of each weather of each scene.
        left_out: scores that these frames cannot have, and why.
        findings: what the study lacks.
    """

    kind: str
    seed: int
    sha256: str
    conditions: tuple[ConditionResult, ...]
    trends: tuple[TrendComparison, ...]
    left_out: Mapping[str, str]
    findings: tuple[Finding, ...]

    def counts(self) -> dict[str, int]:
        """Comparisons that agree, differ and are unjudged; of those that agree, how many are at the floor alike."""
        all_of = [score for condition in self.conditions for score in condition.scores]
        verdicts = [score.verdict for score in all_of]
        at_floor = [
            score.verdict == "agrees" and {score.side_of_floor(which) for which in ("measured", "simulated")} == {"at"}
            for score in all_of
        ]
        return {
            "agree": verdicts.count("agrees"),
            "differ": verdicts.count("differs"),
            "unjudged": verdicts.count("unjudged"),
            "agree_at_floor": sum(at_floor),
        }

    def differing(self) -> dict[str, list[str]]:
        """Score to the labels of the conditions in which it differs."""
        found: dict[str, list[str]] = {}
        for condition in self.conditions:
            for score in condition.scores:
                if score.verdict == "differs":
                    found.setdefault(score.name, []).append(condition.label)
        return found

    def verdict(self) -> str:
        """The outcome in plain words. It names what disagrees, not why."""
        counts, differing = self.counts(), self.differing()
        judged_number = counts["agree"] + counts["differ"]
        if not judged_number:
            return (
                "Nothing could be judged: there are too few frames to know how much scores scatter. "
                "Give two measured frames or more for each condition."
            )
        conditions = len(self.conditions)
        of = f"{_number(judged_number, 'comparison')} ({_number(conditions, 'condition')})"
        said = [f"Simulation and measurement agree within their scatter in {counts['agree']} of {of}."]
        if differing:
            worst = sorted(differing.items(), key=lambda item: -len(item[1]))
            called = {score.name: score.meaning.called for each in self.conditions for score in each.scores}
            named = [f"{called[name] or name}{_where(labels, conditions)}" for name, labels in worst]
            said.append(f"They differ in {'; '.join(named)}.")
        if counts["agree_at_floor"]:
            said.append(
                f"In {counts['agree_at_floor']} of those that agree, neither can be told from clear frames: there "
                "agreement says little."
            )
        if counts["unjudged"]:
            said.append(f"{_number(counts['unjudged'], 'comparison')} could not be judged.")
        return " ".join(said)

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON can hold: a number that is not finite is text (``inf``, ``-inf``, ``nan``)."""
        found = {
            "torchweather": __version__,
            "kind": self.kind,
            "seed": self.seed,
            "study_sha256": self.sha256,
            "verdict": self.verdict(),
            "counts": self.counts(),
            "chance_of_a_false_difference": FAMILY_LEVEL,
            "left_out": dict(self.left_out),
            "conditions": [condition.to_dict() for condition in self.conditions],
            "trends": [trend.to_dict() for trend in self.trends],
            "findings": [
                {"level": each.level, "what": each.what, "cost": each.cost, "advice": each.advice}
                for each in self.findings
            ],
        }
        plain: dict[str, Any] = _plain(found)
        return plain


def validate(
    study: Study, *, seed: int = 0, names: Sequence[str] | None = None, step: Step | None = None
) -> Validation:
    """Hold simulated frames against measured ones, both against clear frames.

    Each condition gets as many simulated frames as it has measured ones. Measured and simulated frame ``i`` are scored
    against the same clear frame, never the one that the simulation started from (``reference_frame``). The floor is
    each clear frame against the next one. A score agrees where the gap of the means is within what chance does:
    Student's t, with a chance of 5 % that any comparison of the study is called different where none is.

    Args:
        study: measured and clear frames.
        seed: of the simulation.
        names: of the scores; ``None``: all that the frames can have. Not for links.
        step: told of each condition done.

    Returns:
        Scores, distributions, trends over severity, and what the study lacks.

    Note:
        Frames count as independent; those that follow each other within seconds are not, and then differences are
        called too readily. Uncertainty of the weather record is not in the scatter.

    References:
        METRICS.md 3, 4; GAP.md 1; D3.4 Figure 18.

    Example:
        >>> from torchweather.gap.study.embedded import embedded_study
        >>> found = validate(embedded_study("radar", clear_frames=3, frames=3), seed=1)
        >>> found.counts()["differ"]
        0
    """
    found, trends, left_out = COMPARED.get(study.kind, _frames)(study, seed, names, step or (lambda _: None))
    return Validation(
        kind=study.kind,
        seed=seed,
        sha256=study.sha256,
        conditions=tuple(_judged(found)),
        trends=tuple(trends),
        left_out=left_out,
        findings=tuple(diagnose(study)),
    )


def _threads_for(study: Study) -> AbstractContextManager[None]:
    """One thread for each of torch's operations where frames are small: its pool would wait longer than it works."""
    frame = study.conditions[0].frames[0]
    small = max(np.size(values) for values in frame.values()) < SMALL_FRAME
    return one_thread_an_operation() if small else nullcontext()


def _frames(study: Study, seed: int, names: Sequence[str] | None, step: Step) -> Compared:
    """Every frame against a clear one."""
    scores, found = frame_scores(study, names), []
    with _threads_for(study):
        clear = {name: _clear(study, scene, scores) for name, scene in study.scenes.items()}
        for condition in study.conditions:
            found.append(_condition(study, condition, scores, clear[condition.scene], seed))
            step(1)
    levels = [(one.scene, one.weather, each.scores) for one, each in zip(study.conditions, found, strict=True)]
    return found, compared_trends(levels, seed), scores.left_out


def _links(study: Study, seed: int, names: Sequence[str] | None, step: Step) -> Compared:
    """Links by classes of rain."""
    if names is not None:
        raise InputValueError(
            "validate: names is for frames; links are scored by their attenuation alone. Leave it out."
        )
    found, trends = [], []
    for condition in study.conditions:
        simulated, seconds = [], []
        for number in range(len(condition.frames)):
            started = time.perf_counter()
            simulated.append(simulate(study, condition, seed=seed, number=number))
            seconds.append(time.perf_counter() - started)
        classes = compared_links(list(condition.frames), simulated)
        result = ConditionResult(
            **{**_about(condition), "label": condition.id},  # the record of the rain is in the frames
            frames=len(simulated),
            scores=tuple(each.score for each in classes),
            quantities=tuple(each.quantity for each in classes),
            simulation_s=tuple(seconds),
        )
        found.append(result)
        trends += class_trends(condition.id, classes, seed)
        step(1)
    return found, trends, {}


Compared = tuple[list[ConditionResult], list[TrendComparison], Mapping[str, str]]
COMPARED = {"link": _links}  # studies of other kinds hold frames


def reference_frame(number: int, start: int, count: int) -> int:
    """Position of the clear frame that measured and simulated frame ``number`` are scored against.

    Args:
        number: of the frame.
        start: position of the clear frame that the simulated frame started from: it is never its own reference.
        count: of clear frames, 2 or more.

    Example:
        >>> [reference_frame(number, 1, 3) for number in range(4)]
        [0, 2, 2, 0]
    """
    place = number % count
    return (place + 1) % count if place == start else place


@dataclass(frozen=True)
class _Clear:
    """What the clear frames of a scene say of each other."""

    floor: dict[str, Sample]
    values: list[Values]


def _clear(study: Study, scene: StudyScene, scores: FrameScores) -> _Clear:
    count = len(scene.clear)
    if count < 2:
        raise InputValueError(
            f"validate: scene {scene.id} must have 2 clear frames or more (8 are advised), since each frame is scored "
            f"against another one; got {count}."
        )
    frames = [scene.clear[place] for place in range(count)]
    # Two frames make one pair: the other way round it is nearly the same score again.
    pairs = [(place, (place + 1) % count) for place in range(count if count > 2 else 1)]
    found = [scores.score(frames[one], frames[other], scene.geometry) for one, other in pairs]
    floor = {name: _sample(found, name) for name in scores.meanings}
    return _Clear(floor, [values_of(study, frame) for frame in frames])


def _condition(study: Study, condition: Condition, scores: FrameScores, clear: _Clear, seed: int) -> ConditionResult:
    scene = study.scene_of(condition)
    found: dict[str, list[dict[str, float]]] = {"measured": [], "simulated": []}
    values: dict[str, list[Values]] = {"measured": [], "simulated": []}
    seconds = []
    for number in range(len(condition.frames)):
        started = time.perf_counter()
        simulated = simulate(study, condition, seed=seed, number=number)
        seconds.append(time.perf_counter() - started)
        start = start_frame(study, condition, seed=seed, number=number)
        reference = scene.clear[reference_frame(number, start, len(scene.clear))]
        for which, frame in (("measured", condition.frames[number]), ("simulated", simulated)):
            found[which].append(scores.score(frame, reference, scene.geometry))
            values[which].append(values_of(study, frame))
    return ConditionResult(
        **_about(condition),
        frames=len(condition.frames),
        scores=tuple(
            Comparison(
                name,
                meaning,
                measured=_sample(found["measured"], name),
                simulated=_sample(found["simulated"], name),
                floor=clear.floor[name],
            )
            for name, meaning in scores.meanings.items()
        ),
        quantities=compared_quantities(values["measured"], values["simulated"], clear.values),
        simulation_s=tuple(seconds),
    )


def _sample(found: Sequence[Mapping[str, float]], name: str) -> Sample:
    return Sample(tuple(each[name] for each in found))


def _about(condition: Condition) -> dict[str, Any]:
    return {
        "id": condition.id,
        "scene": condition.scene,
        "label": weather_label(condition.weather),
        "split": condition.split,
        "weather": None if condition.weather is None else condition.weather.to_dict(),
    }


def _judged(conditions: list[ConditionResult]) -> list[ConditionResult]:
    """The conditions with every comparison judged at its share of the level of all."""
    all_of = iter(judged([score for condition in conditions for score in condition.scores]))
    return [replace(each, scores=tuple(next(all_of) for _ in each.scores)) for each in conditions]


def _number(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _where(labels: Sequence[str], conditions: int) -> str:
    if conditions == 1:
        return ""
    if len(labels) == conditions:
        return f" (all {conditions} conditions)"
    return f" ({', '.join(labels) if len(labels) <= 3 else f'{len(labels)} of {conditions} conditions'})"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value.item() if isinstance(value, np.generic) else value
