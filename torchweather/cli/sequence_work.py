"""A sequence of frames in a weather: one airlight, steady scenes, particles that move from frame to frame."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor
from tqdm import tqdm

from torchweather.atmosphere.weather import Weather
from torchweather.camera.airlight import given_or_estimated
from torchweather.camera.depth import DepthSource, SceneDepth, ScenePrior, least_sure, scene_of
from torchweather.camera.depth.steady import common_near_mask, reach_of, steady_scenes
from torchweather.camera.rgb import AsBayer
from torchweather.camera.rgb_planes import linear_planes
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.cli.frames import depth_source
from torchweather.cli.sequence_frames import ClipFrames, FolderFrames, Frame
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputTypeError, InputValueError

__all__ = ["SequencePlan", "SequenceWork", "Survey"]

T = TypeVar("T")


@dataclass(frozen=True)
class SequencePlan:
    """Work to be done on every frame."""

    weather: Weather
    camera: Camera
    options: Mapping[str, Any]
    depth: str
    said: str


@dataclass(frozen=True)
class Survey:
    """Findings on the whole drive from some frames far apart."""

    airlight: list[float]
    confidence: str
    notes: list[str]


class SequenceWork:
    """The transform, the depth's source, and what the survey found."""

    def __init__(self, plan: SequencePlan, args: argparse.Namespace, frames: FolderFrames | ClipFrames) -> None:
        self.plan, self.args, self.frames = plan, args, frames
        self.inner = BayerWeather(plan.weather, plan.camera, **plan.options)
        self.per_frame = Path(plan.depth).is_dir()
        self.source = None if self.per_frame else self._source(Path(frames.name))

    def survey(self, sampled: list[Frame]) -> Survey:
        """One airlight and one outline of the own vehicle for the whole drive, the medians of these frames."""
        scenes = [self._scene(frame) for frame in sampled]
        lights = [
            self._guarded(frame, partial(self._airlight, frame.image, scene))
            for frame, scene in zip(sampled, scenes, strict=True)
        ]
        airlight = torch.stack(lights).median(0).values.tolist()
        options = {**self.plan.options, "airlight": tuple(min(max(value, 0.0), 1.0) for value in airlight)}
        self.inner = BayerWeather(self.plan.weather, self.plan.camera, **options)
        if isinstance(self.source, ScenePrior):
            self.source = replace(self.source, near_mask=common_near_mask(scenes))
        confidence = least_sure(*(scene.confidence for scene in scenes))
        notes = [f"in {sampled[0].name}: {text}." for text in scenes[0].notes]
        if confidence == "guessed" and not notes:
            notes = ["depth is guessed."]
        return Survey(airlight, confidence, notes)

    def weathered(
        self, count: int, rate_hz: float, done: set[str] | frozenset[str], speeds_m_per_s: list[float] | None
    ) -> Iterator[tuple[Frame, Tensor]]:
        """The frames that are not done, each with its result, seen from the vehicle at each frame's speed."""
        transform: Any = (
            AsBayer(self.inner, through_mosaic=self.args.through_mosaic) if self.frames.is_rgb else self.inner
        )
        first = torch.zeros(()).expand(3 if self.frames.is_rgb else 1, *self.frames.size)
        noises = transform.draw_sequence(
            first, count, 1.0 / rate_hz, seed=self.args.seed, ego_speeds_m_per_s=speeds_m_per_s
        )
        reach = reach_of(rate_hz)
        skipped = self._done_at_start(done)
        begin = max(0, skipped - reach)
        scenes = ((frame, frame.image, self._scene(frame)) for frame in self.frames.frames(begin))
        # What a frame looks like depends on its neighbours within reach alone, so a run may begin anywhere; the
        # particles have moved on from the first frame.
        steady = itertools.dropwhile(lambda pair: pair[0].number < skipped, steady_scenes(scenes, reach=reach))
        noises = itertools.islice(noises, skipped, None)
        quiet = self.args.quiet or not sys.stderr.isatty()
        bar = tqdm(steady, unit="frame", file=sys.stderr, disable=quiet, total=count, initial=skipped)
        for (frame, scene), noise in zip(bar, noises, strict=True):
            if frame.name not in done:
                own = transform if speeds_m_per_s is None else transform.at_ego_speed(speeds_m_per_s[frame.number])
                after: Tensor = self._guarded(frame, partial(own, frame.image, scene, noise))
                yield frame, after

    def _done_at_start(self, done: set[str] | frozenset[str]) -> int:
        if not isinstance(self.frames, FolderFrames):
            # Frames of a video have their number for a name.
            return next(number for number in itertools.count() if f"{number:06d}.png" not in done)
        names = [path.name for path in self.frames.paths]
        return next((number for number, name in enumerate(names) if name not in done), len(names))

    def _source(self, frame: Path) -> DepthSource:
        return depth_source(self.plan.depth, self.args.depth_encoding, frame, args=self.args)

    def _scene(self, frame: Frame) -> SceneDepth:
        def found() -> SceneDepth:
            source = self._source(Path(frame.name)) if self.source is None else self.source
            return scene_of(source, self.plan.camera, *self.frames.size, image=frame.image)

        return self._guarded(frame, found)

    def _airlight(self, image: Tensor, scene: SceneDepth) -> Tensor:
        """Airlight of one frame, ``(3,)``."""
        if image.shape[-3] == 3:
            state = self.inner.planes_state(linear_planes(image)[None], scene, ())
        else:
            state = self.inner.state_of(image, scene)
        return given_or_estimated(self.inner.airlight, state, self.inner)[0]

    def _guarded(self, frame: Frame, act: Callable[[], T]) -> T:
        """The outcome; errors name the frame."""
        try:
            return act()
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{self.frames.name}, {frame.name}: {error}") from error
