"""A detector over frames, weathers and severities: its performance in each, and the scores of the data it got."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.errors import TorchweatherError, check_one_of
from torchweather.image import normalise
from torchweather.random import sample_seed
from torchweather.robustness.detector import OnnxDetector
from torchweather.robustness.performance import COUNTERS, NAMES, Counter, Performance
from torchweather.robustness.rates import Rates, rates
from torchweather.stages import PointKind
from torchweather.sweep import CameraSubject, LidarSubject
from torchweather.sweep.run import COLUMNS
from torchweather.threads import one_thread_an_operation
from torchweather.transforms.raw_levels import raw_to_linear
from torchweather.transforms.recipes import Recipe
from torchweather.transforms.suites import Condition, Suite

__all__ = ["ConditionResult", "LabelledFrame", "Look", "RobustnessResult", "conditions_of", "run_robustness"]


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A frame or cloud with what is in it.

    Args:
        name: by which its storms are drawn and its scores stand in the table.
        subject: the clear data and how weather is put on them.
        truth: ``BoxTruth`` or ``LabelTruth``.
    """

    name: str
    subject: CameraSubject | LidarSubject
    truth: Any


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as the detector got it, for a picture.

    Args:
        frame: which.
        condition: ``None`` in clear air.
        shown: sRGB picture ``(3, H, W)``, or points ``(N, C)``.
        found: boxes with scores and labels, or classes.
        weather: of a cloud, ``(N,)``: the point is a particle.
    """

    frame: LabelledFrame
    condition: Condition | None
    shown: Tensor
    found: Any
    weather: NDArray[np.bool_] | None


@dataclass(frozen=True)
class ConditionResult:
    """The performance in one weather and severity.

    Args:
        condition: which.
        value: mean over the seeds, in [0, 1].
        by_seed: of each seed.
        by_class: mean over the seeds.
    """

    condition: Condition
    value: float
    by_seed: tuple[float, ...]
    by_class: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class RobustnessResult:
    """Everything that a run found.

    Args:
        measure: ``AP`` or ``mIoU``.
        clear: performance in clear air.
        conditions: in every weather and severity.
        scores: tidy table of the metrics' scores, as a sweep's.
        frames: names of the frames.
    """

    measure: str
    clear: Performance
    conditions: tuple[ConditionResult, ...]
    scores: Mapping[str, list[Any]]
    frames: tuple[str, ...]
    thresholds: tuple[float, ...] = field(default=(0.5,))

    @property
    def by_weather(self) -> dict[str, list[ConditionResult]]:
        """The conditions of each weather, lightest first."""
        found: dict[str, list[ConditionResult]] = {}
        for each in self.conditions:
            found.setdefault(each.condition.name, []).append(each)
        return found

    def rates(self, baseline: Mapping[str, Sequence[float]] | None = None) -> Rates:
        """Resilience rate and corruption error."""
        values = {name: [each.value for each in group] for name, group in self.by_weather.items()}
        return rates(self.clear.value, values, baseline)

    def performance_table(self) -> dict[str, list[Any]]:
        """A row a condition and seed, as ``torchweather correlate`` takes it; clear air has no weather and no row."""
        columns: dict[str, list[Any]] = {
            name: [] for name in ("weather", "knob", "value", "severity", "seed", self.measure)
        }
        classes = list(self.clear.by_class)
        columns |= {f"{self.measure}_{name}": [] for name in classes}
        for each in self.conditions:
            one = each.condition
            for seed, value in enumerate(each.by_seed):
                by_class = [each.by_class.get(name, math.nan) for name in classes]
                row = (one.name, one.knob, one.value, one.severity, seed, value, *by_class)
                for column, entry in zip(columns.values(), row, strict=True):
                    column.append(entry)
        return columns


def conditions_of(source: Suite | Recipe) -> list[Condition]:
    """The conditions of a suite; a recipe is one condition, of severity 1.

    Example:
        >>> from torchweather.transforms.recipes import read_recipe
        >>> [(c.name, c.severity, c.value) for c in conditions_of(read_recipe("camera/fog-30m"))]
        [('fog-30m', 1, 30.0)]
    """
    if isinstance(source, Suite):
        return source.conditions()
    weather = source.build_weather()
    part = weather.parts[0]
    if weather.random or torch.as_tensor(part.knob).numel() != 1:
        raise ValueError(
            f"robustness: {source.name} has several weathers or draws one a sample; a condition is one weather. Take "
            "a recipe with numbers, or a suite."
        )
    return [Condition(source.name.rpartition("/")[2], part.kind, part.knob_name, float(part.knob), 1, weather)]


def run_robustness(
    frames: Iterable[LabelledFrame],
    detector: OnnxDetector,
    conditions: Sequence[Condition],
    *,
    seed: int = 0,
    seeds: int = 1,
    metrics: Sequence[str] | None = None,
    thresholds: Sequence[float] = (0.5,),
    look: Callable[[Look], object] | None = None,
    progress: Callable[[], object] | None = None,
) -> RobustnessResult:
    """Put every condition on every frame, ask the detector, hold what it says against the truth.

    Args:
        frames: of one sensor; read one after another.
        detector: asked for every frame in clear air and in every condition.
        conditions: of a suite (``Suite.conditions``), or ``conditions_of`` a recipe.
        seed: of the whole run. A frame's storm is drawn from ``sample_seed(seed, frame's name, k)``, k counting the
            storms: the same over all weathers and severities, so that one storm gets heavier.
        seeds: storms of each frame.
        metrics: scores of the data against the clear data; ``None``: all of the sensor, empty: none.
        thresholds: overlaps from which on a box is a hit; AP is the mean over them.
        look: gets the first frame in clear air and in every condition, with the first storm.
        progress: called after every frame and condition.

    Returns:
        The performance in clear air and in every condition, and the scores.

    Raises:
        TorchweatherError: no frames, or one that cannot be rendered.
    """
    if seeds < 1:
        raise ValueError(f"robustness: seeds must be 1 or more; got {seeds}.")
    if not conditions:
        raise ValueError("robustness: wanted one condition or more; got none.")
    declaration = detector.declaration

    def counter() -> Counter:
        return COUNTERS[declaration.decoder](declaration.classes, thresholds)

    clear = counter()
    weathered = {(place, k): counter() for place in range(len(conditions)) for k in range(seeds)}
    scores: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    names: list[str] = []
    for frame in frames:
        if frame.subject.sensor != declaration.sensor:
            raise ValueError(
                f"robustness: the detector is for a {declaration.sensor}; {frame.name} is of a {frame.subject.sensor}."
            )
        names.append(frame.name)
        wanted = list(frame.subject.directions) if metrics is None else list(metrics)
        for name in wanted:
            check_one_of("metric", name, frame.subject.directions, owner="robustness")
        asked = _Asked(frame, detector, look if len(names) == 1 else None)
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
        raise TorchweatherError("robustness: wanted one frame or more; got none.")
    in_clear_air = clear.performance()
    results = []
    for place, condition in enumerate(conditions):
        every = [weathered[place, k].performance(in_clear_air) for k in range(seeds)]
        by_class = {
            name: float(np.mean([one.by_class.get(name, math.nan) for one in every])) for name in every[0].by_class
        }
        values = tuple(one.value for one in every)
        results.append(ConditionResult(condition, float(np.mean(values)), values, by_class))
    return RobustnessResult(
        NAMES[declaration.decoder], in_clear_air, tuple(results), scores, tuple(names), tuple(thresholds)
    )


class _Asked:
    """One frame in changing weather, and what the detector says of it."""

    def __init__(self, frame: LabelledFrame, detector: OnnxDetector, look: Callable[[Look], object] | None) -> None:
        self.frame, self.detector, self.look = frame, detector, look
        self.before: Tensor | None = None
        self.found: Any = None
        self.truth: Any = frame.truth
        self.kind: NDArray[np.bool_] | None = None
        self.scores: dict[str, float] = {}

    def clear(self, counter: Counter) -> None:
        """The frame as it is."""
        subject = self.frame.subject
        with torch.no_grad():
            if isinstance(subject, LidarSubject):
                self._cloud(subject.points, torch.zeros(len(subject.points), dtype=torch.bool), None)
            else:
                self._frame(subject, subject.data, None)
        self.add(counter)

    def weather(self, condition: Condition, seed: int, metrics: Sequence[str], *, first: bool) -> dict[str, float]:
        """The frame in a weather: its scores."""
        subject = self.frame.subject
        look = self.look if first else None
        try:
            with one_thread_an_operation(), torch.no_grad():
                if isinstance(subject, LidarSubject):
                    result = subject.run(condition.weather, seed)
                    assert isinstance(result.points, Tensor)
                    assert isinstance(result.kind, Tensor)
                    data = result.points
                    self._cloud(data, result.kind == PointKind.PARTICLE, condition, look)
                else:
                    data = subject.render(condition.weather, seed)
                    # A camera's fog draws nothing: every storm gives the same frame.
                    if self.before is None or not torch.equal(self.before, data):
                        self._frame(subject, data, condition, look)
            if self.before is None or not torch.equal(self.before, data):
                self.scores = subject.score(data, metrics) if metrics else {}
        except (ValueError, TypeError) as error:
            raise TorchweatherError(f"{self.frame.name}, {condition.name} {condition.value:g}: {error}") from error
        self.before = data
        return dict(self.scores)

    def add(self, counter: Counter) -> None:
        """Count what was found last."""
        counter.add(self.found, self.truth, self.kind)

    def _frame(
        self,
        subject: CameraSubject,
        data: Tensor,
        condition: Condition | None,
        look: Callable[[Look], object] | None = None,
    ) -> None:
        if subject.is_rgb:
            linear, picture = None, normalise(data)
        else:
            linear = raw_to_linear(data, subject.camera, "robustness").clamp(0.0, 1.0)
            picture = self.detector.developed(linear, subject.camera.bayer_pattern)
        self.found = self.detector.of_frame(linear, picture)
        self._show(look if condition is not None else self.look, condition, picture)

    def _cloud(
        self,
        points: Tensor,
        particle: Tensor,
        condition: Condition | None,
        look: Callable[[Look], object] | None = None,
    ) -> None:
        # What was lost is no point any more, as in a recording.
        there = (points[:, :3] != 0).any(-1) & torch.isfinite(points[:, :3]).all(-1)
        kept = points[there]
        self.kind = particle[there].numpy()
        self.truth = type(self.frame.truth)(self.frame.truth.classes[there.numpy()])
        self.found = self.detector.of_cloud(kept)
        self._show(look if condition is not None else self.look, condition, kept)

    def _show(self, look: Callable[[Look], object] | None, condition: Condition | None, shown: Tensor) -> None:
        if look is not None:
            frame = LabelledFrame(self.frame.name, self.frame.subject, self.truth)
            look(Look(frame, condition, shown, self.found, self.kind))


def stem_of(path: Path) -> str:
    """Name of a frame by which its truth is found; nuScenes' clouds end in ``.pcd.bin``."""
    name = path.name
    return name[: -len(".pcd.bin")] if name.lower().endswith(".pcd.bin") else path.stem
