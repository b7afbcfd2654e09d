"""Weather on drives and videos: the part of ``torchweather apply`` in which particles move from frame to frame."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchweather import __version__
from torchweather.atmosphere.weather import Weather
from torchweather.cli.frames import camera_fields, camera_options, fitted_camera, gathered
from torchweather.cli.outcome import Outcome
from torchweather.cli.output import note
from torchweather.cli.sequence_frames import (
    ClipFrames,
    FolderFrames,
    FolderResult,
    VideoResult,
    file_digest,
)
from torchweather.cli.sequence_work import SequencePlan, SequenceWork
from torchweather.core.errors import check_positive
from torchweather.core.exceptions import InputValueError
from torchweather.core.file_names import is_hidden
from torchweather.datasets.speeds import read_speeds
from torchweather.io.video import CRF, VIDEO_SUFFIXES, WRITTEN_SUFFIXES
from torchweather.recipes.transform import TransformRecipe, camera_of

__all__ = ["is_video", "line", "process"]

SURVEYED = 7  # frames for airlight and own vehicle: medians of 7 stand against 3 that are wrong
DEPTH_ARGUMENTS = (
    *("depth_encoding", "depth_along", "baseline_m", "calib", "camera_name"),
    *("depth_model", "depth_model_output", "depth_model_scale", "depth_model_multiple_px"),
)


def is_video(path: Path) -> bool:
    """Check whether a file's name is that of a video."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def process(
    args: argparse.Namespace, weather: Weather, recipe: TransformRecipe | None, preset: str, outcome: Outcome
) -> None:
    """Read, weather and write a drive frame by frame."""
    started = time.perf_counter()
    frames = _frames_of(args)
    rate_hz = _rate(args, frames)
    sampled, count = frames.sample(SURVEYED)
    speeds, said = _speeds(args.ego_speed_m_per_s, count, rate_hz)
    # The fastest sets the margins; a file's speeds move the particles one by one.
    speed = None if speeds is None else max(speeds, key=abs)
    if isinstance(frames, ClipFrames) and frames.video.has_audio:
        said.append("the video's sound is left out.")
    plan = _planned(args, weather, recipe, preset, frames, speed)
    if plan.said:
        said.append(plan.said)
    settings = {
        "torchweather": __version__,
        "weather": weather.to_dict(),
        "camera": plan.camera.to_dict(),
        "options": {key: value for key, value in plan.options.items() if key != "effects"},
        "effects": [str(effect) for effect in plan.options.get("effects", ())],
        "depth": _depth_named(plan.depth, args, frames),
        "seed": args.seed,
        "frame_rate_hz": rate_hz,
        "ego_speeds_m_per_s": speeds,
        "frames": count,
        "frames_digest": frames.digest(),
    }
    result = _result_of(args, frames, rate_hz, settings)
    if result.discarded:
        said.append(f"{args.out} holds frames of other settings, which are written anew.")
    work = SequenceWork(plan, args, frames)
    survey = work.survey(sampled) if len(result.done) < count else None
    del sampled
    for text in (*said, *(() if survey is None else survey.notes)):
        note(text, quiet=args.quiet)
    written = 0
    if survey is not None:
        result.about = {
            "airlight": survey.airlight,
            "depth_confidence": survey.confidence,
            "notes": survey.notes,
            **({"video": f"libx264, crf {CRF}"} if is_video(args.out) else {}),
        }
        with result:
            for frame, after in work.weathered(count, rate_hz, result.done, speeds):
                result.write(frame, after)
                written += 1
    entry = {
        "input": frames.name,
        "output": str(args.out),
        "frames": count,
        "frames_kept": count - written,
        "frame_rate_hz": rate_hz,
        "ego_speed_m_per_s": None if speeds is None else sum(speeds) / len(speeds),
        "seed": args.seed,
        "weather": weather.to_dict(),
        "airlight": None if survey is None else survey.airlight,
        "depth_confidence": None if survey is None else survey.confidence,
        "notes": said + ([] if survey is None else survey.notes),
        "seconds": time.perf_counter() - started,
    }
    outcome.about |= {"options": settings["options"], "depth": settings["depth"]}
    outcome.add(entry, plan.camera.to_dict())


def _frames_of(args: argparse.Namespace) -> FolderFrames | ClipFrames:
    videos = [path for path in args.inputs if is_video(path)]
    if videos and len(args.inputs) > 1:
        raise InputValueError(
            f"apply: expected one video at a time; got {len(args.inputs)} inputs. Run apply for each."
        )
    if videos:
        return ClipFrames(videos[0])
    paths = gathered(args.inputs)
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        raise InputValueError(
            "apply: two frames of the sequence have the same name; their results would have it as well."
        )
    return FolderFrames(paths)


def _rate(args: argparse.Namespace, frames: FolderFrames | ClipFrames) -> float:
    rate = frames.frame_rate_hz() if args.frame_rate_hz is None else args.frame_rate_hz
    if rate is None:
        raise InputValueError("apply: --sequence needs --frame-rate-hz, the number of frames a second.")
    check_positive("--frame-rate-hz", rate, unit="Hz", owner="apply")
    return float(rate)


def _speeds(given: float | Path | None, count: int, rate_hz: float) -> tuple[list[float] | None, list[str]]:
    """Speed of the vehicle in each frame, m/s, and what to say about it."""
    if isinstance(given, Path):
        speeds = read_speeds(given).at_frames(count, rate_hz)
        return speeds.tolist(), [f"{given}: speeds of {speeds.min():.1f} to {speeds.max():.1f} m/s."]
    return None if given is None else [given] * count, []


def _planned(
    args: argparse.Namespace,
    weather: Weather,
    recipe: TransformRecipe | None,
    preset: str,
    frames: FolderFrames | ClipFrames,
    speed: float | None,
) -> SequencePlan:
    """Camera and options from the recipe and the arguments, the arguments first."""
    if args.sensor is None and recipe is not None:
        sensor = dict(recipe.sensor)
    else:
        sensor = {"kind": "camera", "preset": preset or "lucid-triton"}
    options = {} if recipe is None else dict(recipe.options)
    # The picture is guessed from where nothing else is known of it; a mosaic cannot be.
    usual = options.pop("depth", "auto" if frames.is_rgb else "ground")
    options |= camera_options(args, speed)
    path = frames.paths[0] if isinstance(frames, FolderFrames) else None
    camera, said = fitted_camera(camera_of({**sensor, **camera_fields(args)}), *frames.size, args=args, frame=path)
    if not options.get("ego_speed_m_per_s") and any(part.kind != "fog" for part in weather.parts):
        standing = "no --ego-speed-m-per-s: particles fall in front of a standing vehicle."
        said = f"{said} {standing}".strip()
    return SequencePlan(weather, camera, options, str(usual if args.depth is None else args.depth), said)


def _depth_named(depth: str, args: argparse.Namespace, frames: FolderFrames | ClipFrames) -> dict[str, Any]:
    """The depth as part of the settings; files and folders by their content."""
    if Path(depth).is_dir() and not isinstance(frames, FolderFrames):
        raise InputValueError("apply: a folder of depth maps goes with a folder of frames; extract the video's frames.")
    given = {name: getattr(args, name, None) for name in DEPTH_ARGUMENTS}
    digests = {}
    for path in (Path(depth), *(value for value in given.values() if isinstance(value, Path))):
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            if file.is_file() and not (path.is_dir() and is_hidden(file)):
                digests[str(file)] = file_digest(file)
    return {"given": depth, **{name: None if v is None else str(v) for name, v in given.items()}, "digests": digests}


def _result_of(
    args: argparse.Namespace, frames: FolderFrames | ClipFrames, rate_hz: float, settings: Mapping[str, Any]
) -> FolderResult | VideoResult:
    if not is_video(args.out):
        if isinstance(frames, FolderFrames) and any(p.parent.resolve() == args.out.resolve() for p in frames.paths):
            raise InputValueError(
                f"apply: the frames in {args.out} would be overwritten; give another folder to --out."
            )
        return FolderResult(args.out, settings)
    if args.out.suffix.lower() not in WRITTEN_SUFFIXES:
        raise InputValueError(f"apply: --out must be a folder or end in {', '.join(WRITTEN_SUFFIXES)}; got {args.out}.")
    if args.out.is_dir():
        raise InputValueError(f"apply: {args.out} is a folder; expected a name for the video.")
    if not frames.is_rgb:
        raise InputValueError(
            "apply: raw mosaics do not go into a video, whose compression smears them; give a folder."
        )
    if any(side % 2 for side in frames.size):
        note("H.264 needs even sizes: the last row or column is doubled.", quiet=args.quiet)
    if isinstance(frames, FolderFrames):
        return VideoResult(args.out, frames.size, rate_hz, None, settings)
    video = frames.video
    if args.out.resolve() == video.path.resolve():
        raise InputValueError(f"apply: {args.out} would be overwritten; give another name to --out.")
    # The video keeps its own times, even where --frame-rate-hz says how fast the drive went in truth (slow motion).
    return VideoResult(args.out, frames.size, video.frame_rate_hz, video.time_base, settings)


def line(entry: Mapping[str, Any]) -> str:
    """Line of output on a sequence."""
    speed, airlight = entry["ego_speed_m_per_s"], entry["airlight"]
    parts = [
        f"{entry['input']} -> {entry['output']}",
        f"{entry['frames']} frames at {entry['frame_rate_hz']:.6g} Hz"
        + (f", {entry['frames_kept']} of them kept" if entry["frames_kept"] else ""),
        f"seed {entry['seed']}",
        f"ego speed {0.0 if speed is None else speed:.4g} m/s",
        "" if airlight is None else "airlight " + " ".join(f"{value:.3f}" for value in airlight),
        "" if entry["depth_confidence"] is None else f"depth {entry['depth_confidence']}",
        f"{entry['seconds']:.1f} s",
    ]
    return "  ".join(part for part in parts if part)
