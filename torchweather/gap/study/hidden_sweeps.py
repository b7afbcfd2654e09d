"""A study of recorded clear sweeps with effects hidden in it: what would the search find in my recordings?

The embedded scene has dense, even walls and noise by the book. A recording has its own beams, its own surfaces and its
own noise. Here the frames in weather are recorded clear frames through the chain of stages, with the effects; the
frames that stand for clear air are other ones, so that no noise is on both sides.

References:
    GAP.md 5 (protocol of hidden effects).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import TorchweatherError, check_at_least
from torchweather.core.random import keyed_stream
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.sensors.lidar.reading_steps import frames_within_steps, in_steps, reading_step
from torchweather.gap.sensors.lidar.scene import least_detected
from torchweather.gap.sensors.lidar.stable_beams import SAME_SURFACE_M
from torchweather.gap.study.folders import study_from_folders
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.hidden import FRAME_STEP_S, HELD_OUT, MARGIN_DB, WEATHERS, HiddenStudy
from torchweather.gap.study.splits import FIT, HOLDOUT
from torchweather.gap.study.study import Study
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import ToEnergy
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.effect import Effect

__all__ = ["SweepNoise", "hidden_in_sweeps", "sweep_noise"]

ENOUGH_FRAMES = 4  # recorded by a standing sensor: two that stand for clear air, two for the noise in weather
DRAWN_CLEAR = 8  # clear frames that are drawn about one recorded sweep
LEAST_M = 0.01  # a return lies in front of the sensor, noise and all


@dataclass(frozen=True)
class SweepNoise:
    """Noise of a beam from frame to frame.

    Args:
        range_m: standard deviation of its range.
        intensity: of the logarithm of its intensity.
    """

    range_m: float
    intensity: float


def sweep_noise(frames: Sequence[Frame]) -> SweepNoise:
    """Noise of consecutive frames of a standing sensor: of beams that two frames in a row see at one surface.

    Args:
        frames: two or more, each ``range_m (H, W)`` and ``intensity (H, W)``.

    Note:
        Differences of neighbouring frames are taken, by their mean size: ``2 sd / sqrt(pi)`` of a normal law, which
        readings in whole steps keep in the mean over all beams.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> still = [{"range_m": 20 + 0.02 * rng.standard_normal((64, 64)), "intensity": np.full((64, 64), 0.3)}
        ...          for _ in range(6)]
        >>> round(sweep_noise(still).range_m, 3)
        0.02
    """
    check_at_least("frames", len(frames), 2, owner="sweep_noise")
    range_m, intensity = (np.stack([np.asarray(one[name], dtype=np.float64) for one in frames]) for name in ARRAYS)
    apart = np.abs(np.diff(range_m, axis=0))
    both = (range_m[1:] > 0) & (range_m[:-1] > 0) & (apart < SAME_SURFACE_M)
    if not both.any():
        raise TorchweatherError(
            "sweep_noise: expected beams that two frames in a row see at the same surface; found none. Take "
            "consecutive frames of a sensor that stands still."
        )
    step = reading_step(torch.from_numpy(intensity[range_m > 0]))
    level = 0.5 * (intensity[1:] + intensity[:-1]) + 0.5 * step
    one_sd = 0.5 * math.sqrt(math.pi)
    of_intensity = np.abs(np.diff(intensity, axis=0))[both].sum() / max(float(level[both].sum()), 1e-12)
    return SweepNoise(one_sd * float(apart[both].mean()), one_sd * float(of_intensity))


ARRAYS = ("range_m", "intensity")


@one_thread_an_operation()
def hidden_in_sweeps(
    clear: Mapping[str, str | Path | Sequence[Frame]],
    sensor: Lidar,
    effects: Sequence[Effect] = (),
    weathers: Sequence[Weather] = WEATHERS["snow"],
    *,
    noise: SweepNoise | None = None,
    directions: NDArray[Any] | Tensor | None = None,
    frames: int = 6,
    rel_sd: float = 0.1,
    seed: int = 0,
) -> HiddenStudy:
    """A LiDAR study in which effects are hidden in recorded sweeps.

    A scene of four frames or more, of a sensor that stood still, is divided: the first, third, fifth ... stand for
    clear air, the others are put into weather, each in turn. So the noise is that of the recording. A scene of fewer,
    such as one sweep of a drive, has noise drawn about its first frame: give ``noise``, of other recordings of the
    sensor (``sweep_noise``).

    Args:
        clear: name of each scene to a folder of clear frames, or frames ``range_m (H, W)``, ``intensity (H, W)``.
        sensor: that took them, with its scan pattern where ``directions`` is not given.
        effects: of ``stages.EFFECTS`` for LiDAR, each kind once at most; in every frame in weather, in no clear one.
        weathers: as recorded, three or more, one condition each in every scene; the third is held out.
        noise: of a beam from frame to frame; only for scenes of fewer than four frames.
        directions: ``(H, W, 3)`` unit vectors; ``None`` takes those of the folder's organised clouds or the sensor's.
        frames: of each condition, 1 or more.
        rel_sd: stated relative standard deviation of the record, by which the true weather is off.
        seed: fixes all draws. The error of the record is the same whatever the effects are.

    Returns:
        The study, with the effects and the true weather over the recorded one (`HiddenStudy`).

    Raises:
        TorchweatherError: too few weathers, or a scene of fewer than four frames without ``noise``.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> lidar = Lidar(905.0, elevations_deg=(-4.0, -2.0, 0.0, 2.0), columns=32, intensity_unit="reflectivity")
        >>> one = {"range_m": np.full((4, 32), 12.0), "intensity": rng.uniform(0.1, 0.6, (4, 32))}
        >>> hidden = hidden_in_sweeps({"street": [one]}, lidar, noise=SweepNoise(0.02, 0.03), frames=1)
        >>> len(hidden.study.scenes["street"].clear), [one.split for one in hidden.study.conditions]
        (8, ['fit', 'fit', 'holdout', 'fit'])
    """
    owner = "hidden_in_sweeps"
    check_at_least("weathers", len(weathers), HELD_OUT + 1, owner=owner)
    check_at_least("frames", frames, 1, owner=owner)
    check_at_least("rel_sd", rel_sd, 0.0, owner=owner)
    recorded, beams = _recorded(clear, sensor, directions, weathers[0])
    lidar = replace(sensor, margin_db=MARGIN_DB)
    direction = torch.from_numpy(np.asarray(beams, dtype=np.float32)).reshape(-1, 3)
    names = [f"{weather.kind}-{float(weather.intensity):g}" for weather in weathers]
    factors = np.exp(rel_sd * _stream(seed, "record").standard_normal(len(weathers))).tolist()
    scenes, conditions = [], []
    for scene, of_scene in recorded.items():
        still, moved, step = _divided(scene, of_scene, lidar, noise, frames * len(weathers), seed)
        scenes.append({"id": scene, "clear": still})
        for place, (name, weather) in enumerate(zip(names, weathers, strict=True)):
            start = [moved[(place * frames + number) % len(moved)] for number in range(frames)]
            changed: Any = replace(weather, **{weather.intensity_name: float(weather.intensity) * factors[place]})  # type: ignore[type-var]
            conditions.append(
                {
                    "id": f"{scene}-{name}",
                    "scene": scene,
                    "weather": weather,
                    "rel_sd": rel_sd,
                    "frames": _weathered(start, step, lidar, direction, changed, effects, f"{scene}.{place}", seed),
                    "time_s": [FRAME_STEP_S * number for number in range(frames)],
                    "split": HOLDOUT if place == HELD_OUT else FIT,
                }
            )
    study = Study.from_arrays(sensor=lidar, beams={"direction": beams}, scenes=scenes, conditions=conditions)
    return HiddenStudy(study, tuple(effects), dict(zip(names, factors, strict=True)))


def _stream(seed: int, name: str) -> np.random.Generator:
    return keyed_stream(seed, f"gap.hidden_in_sweeps.{name}")


def _recorded(
    clear: Mapping[str, str | Path | Sequence[Frame]],
    sensor: Lidar,
    directions: NDArray[Any] | Tensor | None,
    weather: Weather,
) -> tuple[dict[str, list[Frame]], NDArray[Any]]:
    """The frames of each scene, and the directions of the beams: given, or of the first scene."""
    found: dict[str, list[Frame]] = {}
    for scene, one in clear.items():
        if isinstance(one, (str, Path)):
            study = study_from_folders(one, {one: weather}, sensor, directions=directions)
            frames = next(iter(study.scenes.values())).clear
            directions = study.beams["direction"] if directions is None else directions
            found[scene] = [frames[number] for number in range(len(frames))]
        else:
            found[scene] = list(one)
    if directions is None:
        given = {"id": "c", "scene": next(iter(found)), "weather": weather, "frames": next(iter(found.values()))}
        scenes = [{"id": scene, "clear": frames} for scene, frames in found.items()]
        directions = Study.from_arrays(sensor=sensor, scenes=scenes, conditions=[given]).beams["direction"]
    return found, np.asarray(directions, dtype=np.float32)


def _divided(
    scene: str, recorded: Sequence[Frame], lidar: Lidar, noise: SweepNoise | None, number: int, seed: int
) -> tuple[list[Frame], list[Frame], float]:
    """Frames that stand for clear air, as they are written; those that are put into weather, before they are rounded;
    and the step of readings."""
    if len(recorded) < ENOUGH_FRAMES and noise is None:
        raise TorchweatherError(
            f"hidden_in_sweeps: clear: the scene {scene} has {len(recorded)} frames; expected {ENOUGH_FRAMES} or more "
            "of a sensor that stood still, or noise=SweepNoise(range_m=0.02, intensity=0.03) that is drawn about one "
            "sweep. sweep_noise measures it on consecutive frames."
        )
    every = list(recorded) if len(recorded) >= ENOUGH_FRAMES else list(recorded[:1])
    levels, step = _levels(every, lidar, seed)
    if len(recorded) >= ENOUGH_FRAMES:
        return every[0::2], levels[1::2], step
    assert noise is not None
    draws = _stream(seed, f"noise.{scene}")
    drawn = [_drawn_about(levels[0], lidar, noise, draws) for _ in range(DRAWN_CLEAR + number)]
    return [_rounded(one, step) for one in drawn[:DRAWN_CLEAR]], drawn[DRAWN_CLEAR:], step


def _levels(frames: Sequence[Frame], lidar: Lidar, seed: int) -> tuple[list[Frame], float]:
    """Frames with readings within their steps, and the step."""
    range_m, intensity = _stacked(frames)
    step = reading_step(intensity[range_m > 0])
    if step == 0:
        return list(frames), step
    least = least_detected(range_m, intensity, step, ToEnergy(lidar))
    drawn = int(_stream(seed, "steps").integers(2**31))
    level, _ = frames_within_steps(intensity, range_m > 0, step, least, drawn, one_level=True)
    grid = np.asarray(frames[0]["range_m"]).shape
    pairs = zip(frames, level, strict=True)
    return [{"range_m": one["range_m"], "intensity": values.reshape(grid).numpy()} for one, values in pairs], step


def _stacked(frames: Sequence[Frame]) -> tuple[Tensor, Tensor]:
    """Ranges and intensities ``(F, N)``."""
    range_m, intensity = (
        torch.stack([torch.from_numpy(np.array(one[key], dtype=np.float32)).reshape(-1) for one in frames])
        for key in ARRAYS
    )
    return range_m, intensity


def _rounded(frame: Frame, step: float) -> Frame:
    intensity = in_steps(torch.from_numpy(np.array(frame["intensity"], dtype=np.float32)), step)
    return {"range_m": frame["range_m"], "intensity": intensity.numpy()}


def _drawn_about(frame: Frame, lidar: Lidar, noise: SweepNoise, draws: np.random.Generator) -> Frame:
    """A sweep with other noise; what then lies below the threshold is lost, but for what lay there before by its own
    calibration and was recorded all the same."""
    range_m, intensity = _stacked([frame])
    of_range, of_intensity = torch.from_numpy(draws.standard_normal((2, *range_m.shape), dtype=np.float32))
    fine = lidar.range_resolution_m
    moved = (range_m + noise.range_m * of_range).clamp_min(max(fine, LEAST_M))
    moved = torch.round(moved / fine) * fine if fine > 0 else moved
    level, energy = intensity * torch.exp(noise.intensity * of_intensity), ToEnergy(lidar)
    with torch.no_grad():
        before, after = (energy.signal_of_intensity(*one) for one in ((intensity, range_m), (level, moved)))
    lost = (after < energy.beam.threshold) & (before >= energy.beam.threshold) | (range_m == 0)
    grid = np.asarray(frame["range_m"]).shape
    found = {"range_m": moved, "intensity": level}
    return {name: torch.where(lost, 0.0, one).reshape(grid).numpy() for name, one in found.items()}


def _weathered(
    start: Sequence[Frame],
    step: float,
    lidar: Lidar,
    direction: Tensor,
    weather: Weather,
    effects: Sequence[Effect],
    name: str,
    seed: int,
) -> list[Frame]:
    """Frames through the chain with the effects, rounded once."""
    grid = np.asarray(start[0]["range_m"]).shape
    range_m, intensity = _stacked(start)
    transform = LidarWeather(weather, lidar, effects=effects, beam_ends="max_range")
    points = torch.cat([direction * range_m[..., None], intensity[..., None]], -1)
    state = transform.state_of(points, direction).changed(grid=grid)
    seeds = torch.from_numpy(_stream(seed, f"weather.{name}").integers(2**62, size=len(start)))
    with torch.no_grad():
        out = transform.chain(state, transform.chain.draw(state, seed=seeds)).returns.points
    found = torch.linalg.vector_norm(out[..., :3], dim=-1)
    read = in_steps(out[..., 3], step) * (found > 0)
    pairs = zip(found, read, strict=True)
    return [{"range_m": one.reshape(grid).numpy(), "intensity": other.reshape(grid).numpy()} for one, other in pairs]
