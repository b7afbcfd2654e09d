"""Small LiDAR studies with an effect hidden in them by the library's own chain: the machinery, not the physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Snow, Weather
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS as EFFECTS  # the catalogue, filled
from torchweather.pipeline.effect import Effect, with_effects
from torchweather.sensors import Lidar
from torchweather.transforms import LidarWeather

SENSOR = Lidar.preset(
    "ouster-os1-128",
    elevations_deg=None,
    azimuth_offsets_deg=None,
    origin_heights_m=None,
    columns=None,
    intensity_unit="reflectivity",
    margin_db=1e-3,  # as the search has it: a study of the model itself
)
RANGE_NOISE_M, INTENSITY_NOISE, EMPTY = 0.01, 0.03, 0.15
WEATHERS: tuple[Weather, ...] = (Snow(1.0), Snow(2.0), Snow(1.5))  # the last is held out


@dataclass(frozen=True)
class Scene:
    """What stands there: ranges and reflectivities of every beam, 0 m where there is nothing."""

    direction: NDArray[np.float32]
    range_m: NDArray[np.float64]
    reflectivity: NDArray[np.float64]
    cos_incidence: NDArray[np.float64]
    up: NDArray[np.float64]

    @classmethod
    def drawn(cls, seed: int, rows: int, columns: int) -> Scene:
        """A scene of beams that know nothing of each other."""
        rng = np.random.default_rng([seed, 1])
        elevation = np.deg2rad(np.linspace(-18.0, 18.0, rows))[:, None]
        azimuth = np.linspace(-math.pi, math.pi, columns, endpoint=False)[None]
        parts = (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) + 0.0 * azimuth,
        )
        shape = (rows, columns)
        # The topmost rows look into the sky.
        sky = np.broadcast_to(np.arange(rows)[:, None] >= rows - round(EMPTY * rows), shape)
        return cls(
            np.stack(parts, -1).astype(np.float32),
            np.where(sky, 0.0, np.exp(rng.uniform(math.log(4.0), math.log(45.0), shape))),
            np.exp(rng.uniform(math.log(0.1), math.log(0.9), shape)),
            rng.uniform(0.05, 1.0, shape),
            rng.uniform(-1.0, 1.0, shape),
        )

    def frame(self, rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
        """A clear frame, with noise of its own."""
        seen = self.range_m > 0
        range_m = self.range_m + RANGE_NOISE_M * rng.normal(size=seen.shape)
        intensity = self.reflectivity * np.exp(INTENSITY_NOISE * rng.normal(size=seen.shape))
        return {
            "range_m": np.where(seen, range_m, 0.0).astype(np.float32),
            "intensity": np.where(seen, intensity, 0.0).astype(np.float32),
        }


def through(
    scene: Scene, frame: dict[str, NDArray[np.float32]], weather: Weather, effects: Sequence[Effect], seed: int
) -> dict[str, NDArray[np.float32]]:
    """A clear frame in weather, with effects, by the chain."""
    transform = LidarWeather(weather, SENSOR, beam_ends="max_range")
    chain = with_effects(transform.chain, effects)
    shape = frame["range_m"].shape
    direction = torch.from_numpy(scene.direction).reshape(-1, 3)
    range_m, intensity = (torch.from_numpy(frame[name]).reshape(-1) for name in ("range_m", "intensity"))
    points = torch.cat([direction * range_m[:, None], intensity[:, None]], -1)[None]
    geometry = {
        name: torch.from_numpy(getattr(scene, name).astype(np.float32)).reshape(1, -1)
        for name in ("cos_incidence", "up")
    }
    with torch.no_grad():
        state = transform.state_of(points, direction).changed(grid=shape, **geometry)
        out: Any = chain(state, chain.draw(state, seed=torch.tensor([seed]))).returns.points
    found = out[0, :, :3].norm(dim=-1)
    return {
        "range_m": found.reshape(shape).numpy(),
        "intensity": (out[0, :, 3] * (found > 0)).reshape(shape).numpy(),
    }


def tiny_study(
    effects: Sequence[Effect] = (),
    *,
    seed: int = 0,
    rows: int = 32,
    columns: int = 32,
    clear: int = 8,
    frames: int = 5,
    weathers: Sequence[Weather] = WEATHERS,
    rel_sd: float = 0.05,
    geometry: bool = True,
) -> Study:
    """A study of one scene, the record of the weather right, the last condition held out.

    Args:
        effects: hidden in all measured frames.
        seed: of everything.
        rows, columns: of the scan.
        clear, frames: numbers of clear frames, and of frames of each condition.
        weathers: one condition each.
        rel_sd: stated of the record.
        geometry: whether incidence and upward component are known.
    """
    scene = Scene.drawn(seed, rows, columns)
    rng = np.random.default_rng([seed, 2])
    conditions = [
        {
            "id": f"c{place}",
            "scene": "s0",
            "weather": weather,
            "rel_sd": rel_sd,
            "frames": [
                through(scene, scene.frame(rng), weather, effects, int(rng.integers(2**62))) for _ in range(frames)
            ],
            "time_s": [0.1 * number for number in range(frames)],
            "split": "holdout" if place == len(weathers) - 1 else "fit",
        }
        for place, weather in enumerate(weathers)
    ]
    given: dict[str, Any] = {"id": "s0", "clear": [scene.frame(rng) for _ in range(clear)]}
    if geometry:
        given["geometry"] = {"cos_incidence": scene.cos_incidence.astype(np.float32), "up": scene.up.astype(np.float32)}
    return Study.from_arrays(sensor=SENSOR, beams={"direction": scene.direction}, scenes=[given], conditions=conditions)
