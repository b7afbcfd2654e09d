"""A detector over frames, weathers and severities: its performance in each, and the scores of the data it got."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.camera.depth import GUESSED, least_sure
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.core.random import sample_seed
from torchweather.evaluation.robustness.detector import OnnxDetector
from torchweather.evaluation.robustness.frames import LabelledFrame, Look, frame_in_weather
from torchweather.evaluation.robustness.intervals import RESAMPLES, Interval, Resampling
from torchweather.evaluation.robustness.operating import operating_point
from torchweather.evaluation.robustness.performance import COUNTERS, NAMES, BoxCounter, Counter
from torchweather.evaluation.robustness.result import ConditionResult, RobustnessResult
from torchweather.evaluation.sweep.run import COLUMNS
from torchweather.recipes.suite import Condition, SuiteRecipe
from torchweather.recipes.transform import TransformRecipe

__all__ = ["conditions_of", "run_robustness"]


def conditions_of(source: SuiteRecipe | TransformRecipe) -> list[Condition]:
    """The conditions of a suite; a recipe is one condition, of severity 1.

    Example:
        >>> from torchweather.recipes import read_recipe
        >>> [(c.name, c.severity, c.value) for c in conditions_of(read_recipe("camera/fog-30m", "transform"))]
        [('fog-30m', 1, 30.0)]
    """
    check_arguments("conditions_of(source: SuiteRecipe | TransformRecipe)", source)
    if isinstance(source, SuiteRecipe):
        return source.conditions()
    weather = source.build_weather()
    if not weather.parts:
        raise InputValueError(
            f"robustness: {source.name} has water or snow on things alone; a condition needs a rate or a visibility. "
            "Add rain, fog or snow to its weather, or take a suite."
        )
    part = weather.parts[0]
    if weather.random or torch.as_tensor(part.intensity).numel() != 1:
        raise InputValueError(
            f"robustness: {source.name} has several weathers or draws one a sample; a condition is one weather. Take "
            "a recipe with numbers, or a suite."
        )
    name = source.name.rpartition("/")[2]
    return [Condition(name, part.kind, part.intensity_name, float(part.intensity), 1, weather)]


def run_robustness(
    frames: Iterable[LabelledFrame],
    detector: OnnxDetector,
    conditions: Sequence[Condition],
    *,
    seed: int = 0,
    seeds: int = 1,
    metrics: Sequence[str] | None = None,
    thresholds: Sequence[float] = (0.5,),
    resamples: int = RESAMPLES,
    allow_guessed_depth: bool = False,
    look: Callable[[Look], object] | None = None,
    progress: Callable[[], object] | None = None,
) -> RobustnessResult:
    """Put every condition on every frame, run the detector, compare its answer with the truth.

    Args:
        frames: of one sensor; read one after another.
        detector: asked for every frame in clear air and in every condition.
        conditions: of a suite (``SuiteRecipe.conditions``), or ``conditions_of`` a recipe.
        seed: of the whole run. A frame's storm is drawn from ``sample_seed(seed, frame's name, k)``, k counting the
            storms: the same over all weathers and severities, so that one storm gets heavier.
        seeds: storms of each frame.
        metrics: scores of the data against the clear data; ``None``: all of the sensor, empty: none.
        thresholds: overlaps from which on a box is a hit; AP is the mean over them.
        resamples: draws of the frames for the 95 % intervals, drawn from ``seed``; 0: no intervals.
        allow_guessed_depth: run on frames whose depth is ``guessed`` too; the result's ``depth`` names it.
        look: gets the first frame in clear air and in every condition, with the first storm.
        progress: called after every frame and condition.

    Returns:
        The performance in clear air and in every condition, and the scores.

    Raises:
        TorchweatherError: no frames, one that cannot be rendered, or one of guessed depth.
    """
    if seeds < 1:
        raise InputValueError(f"robustness: seeds must be 1 or more; got {seeds}.")
    if not conditions:
        raise InputValueError("robustness: expected one condition or more; got none.")
    declaration = detector.declaration

    def counter() -> Counter:
        return COUNTERS[declaration.task](declaration.classes, thresholds)

    clear = counter()
    weathered = {(place, k): counter() for place in range(len(conditions)) for k in range(seeds)}
    scores: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    names: list[str] = []
    sureness: list[str] = []
    for frame in frames:
        if frame.subject.sensor != declaration.sensor:
            raise InputValueError(
                f"robustness: the detector is for a {declaration.sensor}; {frame.name} is of a {frame.subject.sensor}."
            )
        if frame.depth == GUESSED and not allow_guessed_depth:
            raise TorchweatherError(guessed_depth_error(frame.name))
        names.append(frame.name)
        sureness += [frame.depth] if frame.depth else []
        wanted = list(frame.subject.directions) if metrics is None else list(metrics)
        for name in wanted:
            check_one_of("metric", name, frame.subject.directions, owner="robustness")
        asked = frame_in_weather(frame, detector, look if len(names) == 1 else None)
        asked.clear(clear)
        for place, condition in enumerate(conditions):
            for k in range(seeds):
                found = asked.weather(condition, sample_seed(seed, frame.name, k), wanted, first=k == 0)
                asked.add(weathered[place, k])
                row = (frame.name, frame.subject.sensor, condition.name, condition.knob, condition.value)
                for metric, score in found.items():
                    entries = (*row, condition.severity, k, metric, score)
                    for column, entry in zip(scores.values(), entries, strict=True):
                        column.append(entry)
            if progress is not None:
                progress()
    if not names:
        raise TorchweatherError("robustness: expected one frame or more; got none.")
    return _result(
        clear,
        [(condition, [weathered[place, k] for k in range(seeds)]) for place, condition in enumerate(conditions)],
        drawn=Resampling(len(names), seed=seed, resamples=resamples),
        measure=NAMES[declaration.task],
        scores=scores,
        frames=tuple(names),
        thresholds=tuple(thresholds),
        depth=least_sure(*sureness) if sureness else "",
        operating=(
            operating_point(
                [each for each in clear.matched if each.threshold == thresholds[0]],
                declaration.options["operating_threshold"],
            )
            if isinstance(clear, BoxCounter)
            else None
        ),
    )


def _result(
    clear: Counter, counted: Sequence[tuple[Condition, list[Counter]]], *, drawn: Resampling, **values: Any
) -> RobustnessResult:
    """Performance and its intervals from the counts of clear air and of every condition."""
    in_clear_air, clear_values = clear.performance(), drawn.values([clear])
    results = []
    for condition, counters in counted:
        every = [one.performance(in_clear_air) for one in counters]
        by_class = {
            name: float(np.mean([one.by_class.get(name, math.nan) for one in every])) for name in every[0].by_class
        }
        by_seed = tuple(one.value for one in every)
        resampled = drawn.values(counters, clear)
        results.append(
            ConditionResult(
                condition,
                float(np.mean(by_seed)),
                by_seed,
                by_class,
                drawn.interval(resampled[""]),
                drawn.interval(resampled[""] - clear_values[""]),
                _by_class(drawn, resampled),
            )
        )
    return RobustnessResult(
        clear=in_clear_air,
        conditions=tuple(results),
        clear_interval=drawn.interval(clear_values[""]),
        clear_class_intervals=_by_class(drawn, clear_values),
        truths=clear.judged,
        resamples=len(drawn.weights),
        **values,
    )


def _by_class(drawn: Resampling, values: Mapping[str, NDArray[np.float64]]) -> dict[str, Interval]:
    found = {name: drawn.interval(each) for name, each in values.items() if name}
    return {name: interval for name, interval in found.items() if interval is not None}


def guessed_depth_error(frame: str) -> str:
    """Error for frames of guessed depth, with the remedy."""
    return (
        f"robustness: the depth of {frame} is guessed, not measured; the numbers would measure the guess. Give --depth "
        "DIR with a map for each frame, or with its LiDAR cloud and --calib FILE, or pass --allow-guessed-depth: the "
        'results are then headed "depth guessed".'
    )
