"""Weather on image files: the camera's part of ``torchweather apply``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth import AUTO, SceneDepth, scene_of
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.cli.frame_seeds import FrameSeeds
from torchweather.cli.frames import camera_fields, camera_options, depth_source, fitted_camera, gathered
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.core.errors import TorchweatherError
from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.datasets.depth_sources import GROUND
from torchweather.io import read_image, write_image
from torchweather.recipes.transform import TransformRecipe, camera_of

__all__ = ["line", "process"]


@dataclass(frozen=True)
class Plan:
    """Work to be done on every frame."""

    weather: Weather
    camera: Camera
    options: Mapping[str, Any]
    depth: str | None


def process(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str, outcome: Outcome
) -> None:
    """Read, weather and write every frame."""
    plan = _planned(args, weather, recipe, preset)
    frames = gathered(args.inputs)
    targets = _targets(frames, args.out)
    outcome.begin(args.inputs, frames)
    outcome.about |= {"options": dict(plan.options), "depth": plan.depth or f"{AUTO} (colour), {GROUND} (raw)"}
    work = _Work(plan, args)
    for frame in tqdm(frames, unit="frame", file=sys.stderr, disable=args.quiet or not sys.stderr.isatty()):
        with outcome.file(frame):
            outcome.add(work.process(frame, targets[frame]), work.camera.to_dict())


def _planned(args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str) -> Plan:
    """Camera and options from the recipe and the arguments, the arguments first."""
    if args.sensor is None and recipe is not None:
        sensor = dict(recipe.sensor)
    else:
        sensor = {"kind": "camera", "preset": preset or "lucid-triton"}
    options = {} if recipe is None else dict(recipe.options)
    depth = options.pop("depth", None) if args.depth is None else args.depth
    options |= camera_options(args, args.ego_speed_m_per_s)
    return Plan(weather, camera_of({**sensor, **camera_fields(args)}), options, None if depth is None else str(depth))


def _targets(frames: list[Path], out: Path) -> dict[Path, Path]:
    """Where each result goes; two frames of one name, or a result in place of its frame, are refused."""
    targets: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    for frame in frames:
        target = out / frame.name
        if target in taken:
            raise InputValueError(f"apply: {taken[target]} and {frame} would both be written to {target}.")
        if target.resolve() == frame.resolve():
            raise InputValueError(f"apply: {frame} would be overwritten; give another folder to --out.")
        targets[frame] = taken[target] = target
    return targets


class _Work:
    """Transforms by camera, depth maps by file, and the seeds."""

    def __init__(self, plan: Plan, args: argparse.Namespace) -> None:
        self.plan, self.args = plan, args
        self.camera = plan.camera
        self.seeds = FrameSeeds(args.seed, args.seed_rule)
        self.said: set[str] = set()
        self.transforms: dict[tuple[Camera, bool], Any] = {}
        self.depths: dict[tuple[str, Path | None], Any] = {}

    def process(self, frame: Path, target: Path) -> dict[str, Any]:
        """One file: read, weather, write; what was done, as plain values."""
        started = time.perf_counter()
        image, info = read_image(frame)
        self._say(info.note)
        seed = self.seeds.of(frame.name, image.shape[:-3].numel())
        try:
            result, transform, scene = self._weathered(frame, image, info.kind == "rgb", seed)
        except (InputValueError, InputTypeError) as error:
            raise TorchweatherError(f"{frame}: {error}") from error
        target.parent.mkdir(parents=True, exist_ok=True)
        write_image(target, result.rgb if info.kind == "rgb" else result.bayer, like=info)
        page = self._preview(target, image, transform, scene, seed)
        return {
            "input": str(frame),
            "output": str(target),
            **({} if page is None else {"preview": str(page)}),
            "seed": seed,
            "weather": self.plan.weather.to_dict(),
            "transmission_mean": float(result.transmission.mean()),
            "particle_mask_mean": float(result.particle_mask.mean()),
            "airlight": result.airlight.tolist(),
            "depth": result.depth_confidence,
            "seconds": time.perf_counter() - started,
        }

    def _weathered(self, frame: Path, image: Any, rgb: bool, seed: int) -> tuple[Any, Any, SceneDepth]:
        """The result, the transform that gave it, and the scene."""
        height, width = image.shape[-2:]
        camera, said = fitted_camera(self.plan.camera, height, width, self.args, frame=frame)
        self.camera = camera
        self._say(said)
        if not rgb:
            _check_range(image, camera)
        transform = self._transform(camera, rgb)
        scene = scene_of(self._depth(frame, rgb), camera, height, width, image=image)
        for sentence in scene.notes:
            self._say(f"{frame.name}: {sentence}." if self.plan.depth is None else "")
        noise = transform.draw(image, seed=seed, at_rate=True)
        result = transform.run(image, scene, noise)
        return result, transform, scene

    def _preview(self, target: Path, image: Any, transform: Any, scene: SceneDepth, seed: int) -> Path | None:
        """The page of a single image, where it is asked for."""
        if not self.args.preview:
            return None
        if image.ndim != 3:
            self._say(f"{target.name}: --preview shows single images; this file holds several.")
            return None
        from torchweather.cli.preview import preview_image

        page = target.with_name(f"{target.name}.html")
        given = self.plan.options.get("airlight") is not None
        preview_image(page, image, transform, scene, seed, airlight_given=given, name=target.name)
        return page

    def _say(self, sentence: str) -> None:
        """A note, once."""
        if sentence and sentence not in self.said:
            self.said.add(sentence)
            note(sentence, quiet=self.args.quiet)

    def _transform(self, camera: Camera, rgb: bool) -> Any:
        key = (camera, rgb)
        if key not in self.transforms:
            transform = BayerWeather(self.plan.weather, camera, **self.plan.options)
            self.transforms = {key: AsBayer(transform, through_mosaic=self.args.through_mosaic) if rgb else transform}
        return self.transforms[key]

    def _depth(self, frame: Path, rgb: bool) -> Any:
        """The depth source of a frame; without one, that of a photograph is guessed from the picture, that of a raw
        frame is flat ground."""
        named = self.plan.depth or (AUTO if rgb else GROUND)
        if self.plan.depth is None and not rgb:
            self._say(f"no --depth: flat ground {self.plan.camera.height_m:g} m below the camera, guessed.")
        # One source serves all frames, except a folder of maps.
        key = (named, frame if Path(named).is_dir() else None)
        if key not in self.depths:
            self.depths = {key: depth_source(named, self.args.depth_encoding, frame, args=self.args)}
        return self.depths[key]


def _check_range(image: Any, camera: Camera) -> None:
    """Raise where a 16-bit mosaic has more bits than its camera, in the words of the command line."""
    if image.dtype == torch.uint16:
        highest = int(image.to(torch.int32).max())
        if highest > camera.saturation_level:
            raise InputValueError(
                f"the frame contradicts its camera: expected raw values up to {camera.saturation_level:g} "
                f"({camera.bit_depth} bits); got up to {highest}. Give --bit-depth or --white-level."
            )


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a frame."""
    airlight = entry["airlight"]
    light = "" if airlight and isinstance(airlight[0], list) else " ".join(f"{value:.3f}" for value in airlight)
    return (
        f"{entry['input']} -> {entry['output']}  seed {entry['seed']}  "
        f"transmission {entry['transmission_mean']:.3f}  particle mask {entry['particle_mask_mean']:.4f}  "
        + (f"airlight {light}  " if light else "")
        + f"depth {entry['depth']}  "
        + f"{entry['seconds']:.2f} s"
    )
