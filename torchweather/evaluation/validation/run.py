"""The validation process of D3.4 (Figure 18): measured against clear beside simulated against clear."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from torchweather import __version__
from torchweather.core.errors import InputValueError
from torchweather.core.threads import one_thread_an_operation
from torchweather.evaluation.validation.comparison import (
    AGREES,
    DIFFERS,
    FAMILY_LEVEL,
    UNDECIDED,
    UNJUDGED,
    Comparison,
    Sample,
    Shift,
    judged,
)
from torchweather.evaluation.validation.effect_power import STRENGTHS, EffectStrength, TriedEffect, named_effects
from torchweather.evaluation.validation.frame_scores import FrameScores, frame_scores
from torchweather.evaluation.validation.link_scores import compared_links
from torchweather.evaluation.validation.power import FACTOR, FURTHER, POWER, changed_weather
from torchweather.evaluation.validation.quantities import Quantity, Values, compared_quantities, values_of
from torchweather.evaluation.validation.severity import TrendComparison, class_trends, compared_trends, weather_label
from torchweather.gap.diagnosis import Finding, diagnose
from torchweather.gap.sensors.camera.scene_change import with_parts_ignored
from torchweather.gap.sensors.link.study_kind import rain_attenuation_db
from torchweather.gap.study.simulation import simulate, start_frame
from torchweather.gap.study.study import Condition, Frame, Study, StudyScene
from torchweather.pipeline.effect import Effect

__all__ = ["ConditionResult", "Validation", "reference_frame", "validate"]

Step = Callable[[int], object]
# Frames simulated at another rate or visibility: change and scatter of a score are scaled to the study's own numbers.
POWER_FRAMES = 8
EFFECT_FRAMES = 4  # the same with an effect: there are many of them
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
        effects: that were tried, for the power against them.
        not_tried: effect to the reason why these frames cannot have it.
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
    effects: tuple[TriedEffect, ...] = ()
    not_tried: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """``differs`` where a score does; ``agrees`` where one agrees and none differs; else ``not decided``.

        ``unjudged`` where no score could be judged.
        """
        found = {score.verdict for score in self.scores}
        return next((each for each in (DIFFERS, AGREES, UNDECIDED) if each in found), UNJUDGED)

    @property
    def smallest_change(self) -> tuple[float, float] | None:
        """Factors of rate or visibility, below and above 1, that the most sensitive score would have shown.

        0 and infinity where none would have shown a factor of 4; ``None`` where the power is not known.
        """
        known = [each for each in (score.smallest_change for score in self.scores) if each is not None]
        if not known:
            return None
        return max(below for below, _ in known), min(above for _, above in known)

    @property
    def smallest_effects(self) -> tuple[EffectStrength, ...]:
        """For each effect that was tried, the smallest strength that the most sensitive score would have shown."""
        found = []
        for tried in self.effects:
            strength, score = min((each.smallest_strength(tried.id), each.name) for each in self.scores)
            most = max(each.factor for each in self.scores[0].effects[tried.id])
            found.append(EffectStrength.of(tried, strength, most, score))
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "id": self.id,
            "scene": self.scene,
            "label": self.label,
            "split": self.split,
            "weather": None if self.weather is None else dict(self.weather),
            "frames": self.frames,
            "verdict": self.verdict,
            "smallest_factors_flagged": self.smallest_change,
            "smallest_effects_flagged": [each.to_dict() for each in self.smallest_effects],
            "effects_not_tried": dict(self.not_tried),
            "scores": [score.to_dict() for score in self.scores],
            "quantities": [quantity.to_dict() for quantity in self.quantities],
            "simulation_s": [round(seconds, 6) for seconds in self.simulation_s],
        }


@dataclass(frozen=True)
class Validation:
    """Result of ``validate``.

    Args:
        kind: of the study.
        seed: of the simulation.
        sha256: of the study.
        conditions: in the study's order.
        trends: over the severity of each weather of each scene.
        left_out: scores that these frames cannot have, and why.
        findings: parts of its scenes that changed, and what the study lacks.
    """

    kind: str
    seed: int
    sha256: str
    conditions: tuple[ConditionResult, ...]
    trends: tuple[TrendComparison, ...]
    left_out: Mapping[str, str]
    findings: tuple[Finding, ...]

    def counts(self) -> dict[str, int]:
        """Comparisons that agree, differ, are not decided and unjudged; of those that agree, how many at the floor."""
        all_of = [score for condition in self.conditions for score in condition.scores]
        verdicts = [score.verdict for score in all_of]
        at_floor = [
            score.verdict == "agrees" and {score.side_of_floor(which) for which in ("measured", "simulated")} == {"at"}
            for score in all_of
        ]
        return {
            "agree": verdicts.count("agrees"),
            "differ": verdicts.count("differs"),
            "not_decided": verdicts.count("not decided"),
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
        judged_number = counts["agree"] + counts["differ"] + counts["not_decided"]
        if not judged_number:
            return (
                "Nothing could be judged: there are too few frames to know how much scores scatter. "
                "Give two measured frames or more for each condition."
            )
        conditions = len(self.conditions)
        of = f"{_number(judged_number, 'comparison')} ({_number(conditions, 'condition')})"
        said = [
            *self._decided(),
            f"Simulation and measurement agree within their scatter in {counts['agree']} of {of}.",
        ]
        if differing:
            worst = sorted(differing.items(), key=lambda item: -len(item[1]))
            called = {score.name: score.meaning.called for each in self.conditions for score in each.scores}
            named = [f"{called[name] or name}{_where(labels, conditions)}" for name, labels in worst]
            said.append(f"They differ in {'; '.join(named)}.")
        if counts["not_decided"]:
            said.append(
                f"{_number(counts['not_decided'], 'comparison')} not decided: these frames do not exclude that the "
                f"rate or visibility is wrong by a factor of {FACTOR:g}."
            )
        if counts["agree_at_floor"]:
            said.append(
                f"In {counts['agree_at_floor']} of those that agree, neither is distinguishable from clear frames: "
                "agreement there says little."
            )
        if counts["unjudged"]:
            said.append(f"{_number(counts['unjudged'], 'comparison')} could not be judged.")
        return " ".join(said)

    def _decided(self) -> list[str]:
        """Conditions in which the frames could have shown a wrong rate or visibility; none where nothing was tried."""
        tried = [each for each in self.conditions if each.smallest_change is not None]
        if not tried:
            return []
        could = sum(
            changes is not None and changes[0] >= 1.0 / FACTOR and changes[1] <= FACTOR
            for changes in (each.smallest_change for each in tried)
        )
        said = f"These frames would have shown a rate or visibility wrong by a factor of {FACTOR:g}, with "
        return [said + f"{100 * POWER:.0f} % power, in {could} of {_number(len(tried), 'condition')}."]

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
            "power": {"probability": POWER, "factor": FACTOR},
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
    study: Study,
    *,
    seed: int = 0,
    names: Sequence[str] | None = None,
    step: Step | None = None,
    power: bool = True,
    effects: Sequence[str] = (),
    ignore_parts: Sequence[str] = (),
) -> Validation:
    """Compare simulated frames with measured ones, both by their scores against clear frames.

    Each condition gets as many simulated frames as it has measured ones. Measured and simulated frame ``i`` are scored
    against the same clear frame, never the one that the simulation started from (``reference_frame``). The floor is
    each clear frame against the next one. A score agrees where the gap of the means is within what chance does:
    Student's t, with a chance of 5 % that any comparison of the study is called different where none is. It agrees only
    where the same frames would have flagged half and twice the rate or visibility with 80 % power, and exclude them;
    else it is not decided. Frames at these rates are simulated for that.

    Args:
        study: measured and clear frames.
        seed: of the simulation.
        names: of the scores; ``None``: all that the frames can have. Not for links.
        step: told of each condition done.
        power: False simulates no other rates, in a third of the time; then nothing is called agreement.
        effects: ids of effects, or ``all``, whose smallest strength that these frames would have flagged is computed. A
            hint of what the study can show; no verdict depends on it. Not for links, nor without ``power``.
        ignore_parts: parts of a camera's picture that do not count, ``SCENE:ROW,COLUMN`` as the finding "scene changed"
            names them; as if they were in the scene's mask.

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
    study = with_parts_ignored(study, ignore_parts, "validate")
    tried = named_effects(study.kind, effects, "validate")
    if tried and not power:
        raise InputValueError(
            "validate: effects are for the power of a comparison; got power=False. Leave one of them out."
        )
    work = Work(seed, names, step or (lambda _: None), power, tried)
    found, trends, left_out = COMPARED.get(study.kind, _frames)(study, work)
    return Validation(
        kind=study.kind,
        seed=seed,
        sha256=study.sha256,
        conditions=tuple(_judged(found)),
        trends=tuple(trends),
        left_out=left_out,
        findings=(*study.study_kind.scene_changes(study), *diagnose(study)),
    )


@dataclass(frozen=True)
class Work:
    """Request to `validate`; fields as its arguments."""

    seed: int
    names: Sequence[str] | None
    step: Step
    power: bool
    effects: Sequence[TriedEffect]


def _threads_for(study: Study) -> AbstractContextManager[None]:
    """One thread for each of torch's operations where frames are small: its pool would wait longer than it works."""
    frame = study.conditions[0].frames[0]
    small = max(np.size(values) for values in frame.values()) < SMALL_FRAME
    return one_thread_an_operation() if small else nullcontext()


def _frames(study: Study, work: Work) -> Compared:
    """Every frame against a clear one."""
    scores, found = frame_scores(study, work.names), []
    with _threads_for(study):
        clear = {name: _clear(study, scene, scores) for name, scene in study.scenes.items()}
        for condition in study.conditions:
            found.append(_condition(study, condition, scores, clear[condition.scene], work))
            work.step(1)
    levels = [(one.scene, one.weather, each.scores) for one, each in zip(study.conditions, found, strict=True)]
    return found, compared_trends(levels, work.seed), scores.left_out


def _links(study: Study, work: Work) -> Compared:
    """Links by classes of rain."""
    if work.names is not None:
        raise InputValueError(
            "validate: names is for frames; links are scored by their attenuation alone. Leave it out."
        )
    found, trends = [], []
    for condition in study.conditions:
        simulated, seconds = [], []
        for number in range(len(condition.frames)):
            started = time.perf_counter()
            simulated.append(simulate(study, condition, seed=work.seed, number=number))
            seconds.append(time.perf_counter() - started)
        rain = [_rain_changed(study, simulated, factor) for factor in LINK_FACTORS if work.power]
        classes = compared_links(list(condition.frames), simulated, dict(zip(LINK_FACTORS, rain, strict=False)))
        result = ConditionResult(
            **{**_about(condition), "label": condition.id},  # the record of the rain is in the frames
            frames=len(simulated),
            scores=tuple(each.score for each in classes),
            quantities=tuple(each.quantity for each in classes),
            simulation_s=tuple(seconds),
        )
        found.append(result)
        trends += class_trends(condition.id, classes, work.seed)
        work.step(1)
    return found, trends, {}


LINK_FACTORS = (1.0 / FURTHER, 1.0 / FACTOR, FACTOR, FURTHER)


def _rain_changed(study: Study, simulated: Sequence[Frame], factor: float) -> list[Frame]:
    """Simulated series with the loss of a multiple of the rain, over the same dry samples."""
    found: list[Frame] = []
    for frame in simulated:
        rain = np.asarray(frame["rain_mm_per_h"])
        loss = [rain_attenuation_db(study.links, each) for each in (rain, factor * rain)]
        found.append({**frame, "attenuation_db": np.asarray(frame["attenuation_db"]) + loss[1] - loss[0]})
    return found


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
    """Agreement of the clear frames of a scene with each other."""

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


def _condition(study: Study, condition: Condition, scores: FrameScores, clear: _Clear, work: Work) -> ConditionResult:
    scene, seed = study.scene_of(condition), work.seed
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
    compared = tuple(
        Comparison(
            name,
            meaning,
            measured=_sample(found["measured"], name),
            simulated=_sample(found["simulated"], name),
            floor=clear.floor[name],
        )
        for name, meaning in scores.meanings.items()
    )
    tried: dict[str, TriedEffect] = {}
    not_tried: dict[str, str] = {}
    if condition.weather is not None:
        # At its share of the level if every comparison can be judged, which is what the power is stated for.
        level = FAMILY_LEVEL / (len(study.conditions) * len(compared))
        compared = tuple(replace(each, level=level, shifts=()) for each in compared)
        if work.power:
            compared = _with_power(compared, found["simulated"], partial(_scores_at, study, condition, scores, seed))
        for one in work.effects:
            try:
                compared = _with_effect(
                    compared, found["simulated"], one, partial(_scored, study, condition, scores, seed)
                )
            except InputValueError as error:  # frames without what the effect needs, such as normals of surfaces
                not_tried[one.id] = str(error)
            else:
                tried[one.id] = one
    return ConditionResult(
        **_about(condition),
        frames=len(condition.frames),
        scores=compared,
        quantities=compared_quantities(values["measured"], values["simulated"], clear.values),
        simulation_s=tuple(seconds),
        effects=tuple(tried.values()),
        not_tried=not_tried,
    )


Scores = list[dict[str, float]]


def _scores_at(study: Study, condition: Condition, scores: FrameScores, seed: int, factor: float) -> Scores | None:
    """Scores of frames simulated at another rate or visibility, with the draws and clear frames of the recorded one."""
    assert condition.weather is not None
    weather = changed_weather(condition.weather, factor)
    if weather is None:
        return None
    return _scored(study, replace(condition, weather=weather), scores, seed, POWER_FRAMES)


def _scored(
    study: Study, condition: Condition, scores: FrameScores, seed: int, most: int, effects: Sequence[Effect] = ()
) -> Scores:
    """Scores of at most ``most`` simulated frames, with the draws and clear frames of those of the recorded weather."""
    scene, found = study.scene_of(condition), []
    for number in range(min(len(condition.frames), most)):
        start = start_frame(study, condition, seed=seed, number=number)
        reference = scene.clear[reference_frame(number, start, len(scene.clear))]
        frame = simulate(study, condition, seed=seed, number=number, effects=effects)
        found.append(scores.score(frame, reference, scene.geometry))
    return found


def _with_effect(
    compared: tuple[Comparison, ...], recorded: Scores, tried: TriedEffect, scored: Callable[..., Scores]
) -> tuple[Comparison, ...]:
    """The comparisons with an effect of its typical size, and a weaker one where that is flagged, else a stronger."""
    typical, weaker, stronger = (tried.strength(each) for each in STRENGTHS)
    compared = _with_strength(compared, recorded, tried, typical, scored)
    flagged = any(each.power_of_effect(tried.id, typical) >= POWER for each in compared)
    further = weaker if flagged else stronger
    # The bounds of a parameter may allow no more.
    return compared if further == typical else _with_strength(compared, recorded, tried, further, scored)


def _with_strength(
    compared: tuple[Comparison, ...],
    recorded: Scores,
    tried: TriedEffect,
    strength: float,
    scored: Callable[..., Scores],
) -> tuple[Comparison, ...]:
    found = scored(EFFECT_FRAMES, [tried.at(strength)])

    def shift(name: str) -> Shift:
        return Shift(strength, _sample(recorded[: len(found)], name), _sample(found, name))

    return tuple(
        replace(each, effects={**each.effects, tried.id: (*each.effects.get(tried.id, ()), shift(each.name))})
        for each in compared
    )


def _with_power(
    compared: tuple[Comparison, ...], recorded: Scores, at: Callable[[float], Scores | None]
) -> tuple[Comparison, ...]:
    """The comparisons with scores at half and twice the intensity; farther where no score would have shown these."""
    for near, far in ((1.0 / FACTOR, 1.0 / FURTHER), (FACTOR, FURTHER)):
        for factor in (near, far):
            found = at(factor)
            if found is None:
                break
            compared = tuple(
                replace(
                    each,
                    shifts=(
                        *(each.shifts or ()),
                        Shift(factor, _sample(recorded[: len(found)], each.name), _sample(found, each.name)),
                    ),
                )
                for each in compared
            )
            if any(each.power(factor) >= POWER for each in compared):
                break
    return compared


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
