"""Every subject in every level with every seed: what was scored, one by one or as one tidy table."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchweather.core.arguments import call_given, check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, check_one_of
from torchweather.core.threads import one_thread_an_operation
from torchweather.evaluation.sweep.levels import Level
from torchweather.evaluation.sweep.subjects import Subject

__all__ = ["COLUMNS", "Sample", "columns_of", "plan", "samples", "sweep"]

COLUMNS = ("subject", "sensor", "weather", "knob", "value", "severity", "seed", "metric", "score")
"""Of the tidy table, in their order."""

INDOOR_WEATHERS = ("fog",)


@dataclass(frozen=True, eq=False)
class Sample:
    """One subject in one level, drawn with one seed.

    Args:
        subject, level, seed: which.
        scores: by the metric's name.
        facts: plain quantities of the rendered data (see ``Subject.facts``).
        render_s, score_s: seconds that rendering and scoring took; 0 where the data equal those of the seed before,
            whose scores they have.
    """

    subject: Subject
    level: Level
    seed: int
    scores: dict[str, float]
    facts: dict[str, float]
    render_s: float
    score_s: float


def plan(subjects: Sequence[Subject], levels: Sequence[Level]) -> list[tuple[Subject, list[Level]]]:
    """The levels that each subject gets: indoors it neither rains nor snows.

    Raises:
        ValueError: no subject and level go together, or two weathers have one name.
    """
    if odd := [one for one in subjects if not (hasattr(one, "indoors") and hasattr(one, "name"))]:
        raise InputTypeError(f"sweep: expected subjects, such as CameraSubject; got {odd[0]!r:.100}.")
    series = {(level.name, level.severity) for level in levels}
    if len(series) < len(levels):
        raise InputValueError("sweep: expected each weather once; got one twice. Give all its levels in one list.")
    twice = {subject.name for subject in subjects if sum(subject.name == other.name for other in subjects) > 1}
    if twice:
        raise InputValueError(
            f"sweep: expected subjects of different names; got {', '.join(sorted(twice))} more than once."
        )
    found = []
    for subject in subjects:
        fits = [level for level in levels if not subject.indoors or _kinds(level) <= set(INDOOR_WEATHERS)]
        if fits:
            found.append((subject, fits))
    if not found:
        names = ", ".join(subject.name for subject in subjects) or "no subject"
        raise InputValueError(
            f"sweep: expected a subject and a weather that go together; got {names}. Indoors give fog."
        )
    return found


def _kinds(level: Level) -> set[str]:
    return {part.kind for part in level.weather.parts}


def samples(
    subjects: Sequence[Subject], levels: Sequence[Level], seeds: Sequence[int], names: Sequence[str] | None = None
) -> Iterator[Sample]:
    """Render and score, one after another.

    Args:
        subjects: of one sensor or of several.
        levels: of one weather or of several (see ``parse_levels``).
        seeds: each draws one storm: over the levels of a weather its random field stays, the rate alone rises.
        names: of scores; ``None``: all that the subject has.

    Yields:
        Samples by subject, level and seed.
    """
    check_arguments(
        "samples(subjects: Sequence, levels: Sequence[Level], seeds: Sequence[int], names: Sequence[str] | None)",
        subjects,
        levels,
        seeds,
        names,
    )
    seeds = [int(seed) for seed in seeds]
    if not seeds or len(set(seeds)) < len(seeds):
        raise InputValueError(f"sweep: expected one or more seeds that differ; got {list(seeds)}.")
    todo = plan(subjects, levels)
    for subject, _ in todo:
        for name in names or ():
            check_one_of("metric", name, subject.directions, owner="sweep")
    for subject, fits in todo:
        wanted = list(subject.directions if names is None else names)
        for level in fits:
            yield from _level(subject, level, seeds, wanted)


def _level(subject: Subject, level: Level, seeds: Sequence[int], names: Sequence[str]) -> Iterator[Sample]:
    before: Tensor | None = None
    scores: dict[str, float] = {}
    facts: dict[str, float] = {}
    for seed in seeds:
        started = time.perf_counter()
        try:
            # One thread: on a busy machine torch's pool waits longer than it works, and the page shows the time.
            with one_thread_an_operation():
                data = subject.render(level.weather, seed)
            rendered = time.perf_counter()
            # A camera's fog draws nothing: every seed gives the same frame.
            again = before is not None and before.shape == data.shape and torch.equal(before, data)
            if not again:
                scores, facts = subject.score(data, names), subject.facts(data)
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{subject.name}: {error}") from error
        before = data
        scored = 0.0 if again else time.perf_counter() - rendered
        yield Sample(subject, level, seed, dict(scores), dict(facts), rendered - started, scored)


def columns_of(found: Iterable[Sample]) -> dict[str, list[Any]]:
    """The tidy table of samples: one score a row, ``COLUMNS`` in their order."""
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    for sample in found:
        level = sample.level
        first = (sample.subject.name, sample.subject.sensor, level.name, level.knob, level.value, level.severity)
        for metric, score in sample.scores.items():
            for name, value in zip(COLUMNS, (*first, sample.seed, metric, score), strict=True):
                columns[name].append(value)
    return columns


def sweep(
    subjects: Sequence[Subject],
    levels: Sequence[Level],
    seeds: Sequence[int],
    names: Sequence[str] | None = None,
    progress: Callable[[int], object] | None = None,
) -> dict[str, list[Any]]:
    """Scores of subjects in weather of rising severity, as a tidy table.

    Args:
        subjects, levels, seeds, names: as in ``samples``.
        progress: called with 1 after each sample, such as ``tqdm.update``.

    Returns:
        Columns ``subject, sensor, weather, knob, value, severity, seed, metric, score``, one score a row. The weather
        is the level's ``name``; severity 1 is the lightest.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.evaluation.sweep import CameraSubject, parse_levels
        >>> camera = Camera.preset("lucid-triton").resized(16, 16)
        >>> grey = CameraSubject("grey", torch.full((1, 16, 16), 0.3), torch.full((1, 16, 16), 40.0), camera,
        ...     options={"airlight": 0.8})
        >>> table = sweep([grey], parse_levels("fog:mor=400,100"), seeds=[0], names=["psnr"])
        >>> table["value"], [round(score, 1) for score in table["score"]]
        ([400.0, 100.0], [18.8, 11.8])
    """
    check_arguments(
        "sweep(subjects: Sequence, levels: Sequence[Level], seeds: Sequence[int], names: Sequence[str] | None, "
        "progress: Callable | None)",
        subjects,
        levels,
        seeds,
        names,
        progress,
    )
    found = []
    for sample in samples(subjects, levels, seeds, names):
        found.append(sample)
        if progress is not None:
            call_given("sweep", "progress", progress, 1)
    return columns_of(found)
