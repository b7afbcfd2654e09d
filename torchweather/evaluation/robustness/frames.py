"""Labelled frames and clouds, put into weather and given to a detector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.levels import raw_to_linear
from torchweather.camera.tone import normalise
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError
from torchweather.core.threads import one_thread_an_operation
from torchweather.evaluation.robustness.detector import OnnxDetector
from torchweather.evaluation.robustness.performance import Counter
from torchweather.evaluation.sweep import CameraSubject, LidarSubject
from torchweather.pipeline.point_kind import PointKind
from torchweather.recipes.suite import Condition

__all__ = ["FrameInWeather", "LabelledFrame", "Look", "frame_in_weather", "stem_of"]


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

    @property
    def depth(self) -> str:
        """Confidence of the depth: ``exact``, ``measured``, ``completed`` or ``guessed``; empty of a LiDAR."""
        return self.subject.depth_confidence


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


OnLook = Callable[[Look], object] | None


class FrameInWeather(ABC):
    """One frame in changing weather, and what the detector finds in it; one subclass a kind of sensor."""

    def __init__(self, frame: LabelledFrame, detector: OnnxDetector, look: OnLook) -> None:
        self.frame, self.detector, self.look = frame, detector, look
        self.before: Tensor | None = None
        self.found: Any = None
        self.truth: Any = frame.truth
        self.kind: NDArray[np.bool_] | None = None
        self.scores: dict[str, float] = {}

    def clear(self, counter: Counter) -> None:
        """The frame as it is."""
        with torch.no_grad():
            self._detect_clear()
        self.add(counter)

    def weather(self, condition: Condition, seed: int, metrics: Sequence[str], *, first: bool) -> dict[str, float]:
        """The frame in a weather: its scores."""
        try:
            with one_thread_an_operation(), torch.no_grad():
                data = self._detect(condition, seed, self.look if first else None)
            if self.before is None or not torch.equal(self.before, data):
                self.scores = self.frame.subject.score(data, metrics) if metrics else {}
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{self.frame.name}, {condition.name} {condition.value:g}: {error}") from error
        self.before = data
        return dict(self.scores)

    def add(self, counter: Counter) -> None:
        """Count what was found last."""
        counter.add(self.found, self.truth, self.kind)

    @abstractmethod
    def _detect_clear(self) -> None:
        """Give the detector the clear data."""

    @abstractmethod
    def _detect(self, condition: Condition, seed: int, look: OnLook) -> Tensor:
        """Give the detector the data in a weather; returns them."""

    def _show(self, look: OnLook, condition: Condition | None, shown: Tensor) -> None:
        if look is not None:
            frame = LabelledFrame(self.frame.name, self.frame.subject, self.truth)
            look(Look(frame, condition, shown, self.found, self.kind))


class _PictureInWeather(FrameInWeather):
    """A camera's frame."""

    def __init__(self, frame: LabelledFrame, subject: CameraSubject, detector: OnnxDetector, look: OnLook) -> None:
        super().__init__(frame, detector, look)
        self.subject = subject

    def _detect_clear(self) -> None:
        self._find(self.subject.reference, None, self.look)

    def _detect(self, condition: Condition, seed: int, look: OnLook) -> Tensor:
        data = self.subject.render(condition.weather, seed, condition.effects)
        # A camera's fog draws nothing: every storm gives the same frame.
        if self.before is None or not torch.equal(self.before, data):
            self._find(data, condition, look)
        return data

    def _find(self, data: Tensor, condition: Condition | None, look: OnLook) -> None:
        camera = self.subject.camera
        if self.subject.is_rgb:
            linear, picture = None, normalise(data)
        else:
            linear = raw_to_linear(data, camera, "robustness").clamp(0.0, 1.0)
            picture = self.detector.developed(linear, camera.bayer_pattern)
        self.found = self.detector.of_frame(linear, picture)
        self._show(look, condition, picture)


class _CloudInWeather(FrameInWeather):
    """A LiDAR's cloud."""

    def __init__(self, frame: LabelledFrame, subject: LidarSubject, detector: OnnxDetector, look: OnLook) -> None:
        super().__init__(frame, detector, look)
        self.subject = subject

    def _detect_clear(self) -> None:
        points = self.subject.points
        self._find(points, torch.zeros(len(points), dtype=torch.bool), None, self.look)

    def _detect(self, condition: Condition, seed: int, look: OnLook) -> Tensor:
        result = self.subject.run(condition.weather, seed, condition.effects)
        points, kind = torch.as_tensor(result.points), torch.as_tensor(result.kind)
        self._find(points, kind == PointKind.PARTICLE, condition, look)
        return points

    def _find(self, points: Tensor, particle: Tensor, condition: Condition | None, look: OnLook) -> None:
        # What was lost is no point any more, as in a recording.
        there = (points[:, :3] != 0).any(-1) & torch.isfinite(points[:, :3]).all(-1)
        kept = points[there]
        self.kind = particle[there].numpy()
        self.truth = type(self.frame.truth)(self.frame.truth.classes[there.numpy()])
        self.found = self.detector.of_cloud(kept)
        self._show(look, condition, kept)


IN_WEATHER: dict[str, Callable[..., FrameInWeather]] = {
    CameraSubject.sensor: _PictureInWeather,
    LidarSubject.sensor: _CloudInWeather,
}


def frame_in_weather(frame: LabelledFrame, detector: OnnxDetector, look: OnLook) -> FrameInWeather:
    """A frame of any sensor for a detector; ``look`` is called with the first picture of each condition."""
    return IN_WEATHER[frame.subject.sensor](frame, frame.subject, detector, look)


def stem_of(path: Path) -> str:
    """Name of a frame by which its truth is found; nuScenes' clouds end in ``.pcd.bin``."""
    name = path.name
    return name[: -len(".pcd.bin")] if name.lower().endswith(".pcd.bin") else path.stem
