"""Small radar studies with an effect hidden in them by the library's own chain: the machinery, not the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Rain, Weather
from torchweather.gap.study.study import Study
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects.all import EFFECTS as EFFECTS  # the catalogue, filled
from torchweather.sensors import Radar
from torchweather.stages import PointKind
from torchweather.transforms import RadarAttenuation

SENSOR = Radar.preset("imaging-77ghz")
WEATHERS: tuple[Weather, ...] = (Rain(15.0), Rain(40.0), Rain(25.0))  # the last is held out
CLASSES = 3
POWER_NOISE_DB, RANGE_NOISE_M, SPEED_NOISE_M_PER_S, FLOOR_NOISE_DB = 0.4, 0.02, 0.05, 0.03


@dataclass(frozen=True)
class Targets:
    """What stands there."""

    geometry: dict[str, NDArray[Any]]
    power_db: NDArray[np.float64]
    fluctuates: NDArray[np.bool_]

    @classmethod
    def drawn(cls, seed: int, number: int) -> Targets:
        """Targets that know nothing of each other, a quarter of which fluctuate as Swerling's case 1."""
        rng = np.random.default_rng([seed, 1])
        geometry = {
            "range_m": np.exp(rng.uniform(np.log(8.0), np.log(140.0), number)),
            "azimuth_rad": rng.uniform(-0.6, 0.6, number),
            "elevation_rad": rng.uniform(-0.1, 0.1, number),
            "speed_m_per_s": rng.uniform(-3.0, 3.0, number),
            "target_class": rng.integers(0, CLASSES, number),
        }
        margin_db = rng.uniform(0.0, 35.0, number)
        return cls(geometry, SENSOR.floor_db + SENSOR.detection_snr_db + margin_db, rng.random(number) < 0.25)

    def frame(self, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """A clear frame, with noise of its own."""
        number = len(self.power_db)
        fluctuation = np.where(self.fluctuates, 10.0 * np.log10(rng.exponential(size=number)), 0.0)
        power_db = self.power_db + fluctuation + POWER_NOISE_DB * rng.normal(size=number)
        seen = power_db >= SENSOR.floor_db + SENSOR.detection_snr_db
        range_m = self.geometry["range_m"] + RANGE_NOISE_M * rng.normal(size=number)
        speed = self.geometry["speed_m_per_s"] + SPEED_NOISE_M_PER_S * rng.normal(size=number)
        return {
            "power_db": np.where(seen, power_db, np.nan),
            "range_m": np.where(seen, range_m, np.nan),
            "speed_m_per_s": np.where(seen, speed, np.nan),
            "noise_floor_db": np.array(SENSOR.floor_db + FLOOR_NOISE_DB * rng.normal()),
        }


def through(
    targets: Targets, frame: dict[str, NDArray[Any]], weather: Weather, effects: Sequence[Effect], seed: int, place: int
) -> dict[str, NDArray[Any]]:
    """A clear frame in weather, with effects, by the chain."""
    known, seen = targets.geometry, ~np.isnan(frame["power_db"])
    floor_db = float(frame["noise_floor_db"])
    transform = RadarAttenuation(weather, replace(SENSOR, noise_floor_db=floor_db), effects=effects)
    flat = np.cos(known["elevation_rad"])
    towards = np.stack(
        [flat * np.cos(known["azimuth_rad"]), flat * np.sin(known["azimuth_rad"]), np.sin(known["elevation_rad"])], -1
    )
    points = np.zeros((len(seen), 6))
    points[:, :3] = np.where(seen, frame["range_m"], 0.0)[:, None] * towards
    points[:, 3] = np.where(seen, frame["speed_m_per_s"], 0.0)
    points[:, 4] = np.where(seen, frame["power_db"], floor_db)
    given = torch.from_numpy(points)[None]
    state = transform.state_of(
        given, target_class=torch.from_numpy(known["target_class"]), frame_number=torch.tensor([place])
    )
    with torch.no_grad():
        noise = {k: v.double() for k, v in transform.chain.draw(state, seed=torch.tensor([seed])).items()}
        out: Any = transform.chain(state, noise)
    rows, kind = out.returns.points[0].numpy(), out.returns.kind[0].numpy()
    there = kind[: len(seen)] != int(PointKind.LOST)
    more = rows[len(seen) :][kind[len(seen) :] != int(PointKind.LOST)]
    range_m = np.linalg.norm(more[:, :3], axis=1)
    clutter = [
        *(range_m, np.arctan2(more[:, 1], more[:, 0]), np.arcsin(more[:, 2] / np.maximum(range_m, 1e-9))),
        *(more[:, 3], more[:, 4], np.zeros(len(more))),
    ]
    return {
        "power_db": np.where(there, rows[: len(seen), 4], np.nan),
        "range_m": np.where(there, np.linalg.norm(rows[: len(seen), :3], axis=1), np.nan),
        "speed_m_per_s": np.where(there, rows[: len(seen), 3], np.nan),
        "noise_floor_db": np.array(float(out.floor_db[0])),
        "clutter": np.stack(clutter, 1),
    }


def tiny_radar_study(
    effects: Sequence[Effect] = (),
    *,
    seed: int = 0,
    number: int = 96,
    clear: int = 8,
    frames: int = 6,
    weathers: Sequence[Weather] = WEATHERS,
    rel_sd: float = 0.05,
) -> Study:
    """A study of one scene, the record of the weather right, the last condition held out.

    Args:
        effects: hidden in all measured frames.
        seed: of everything.
        number: of targets.
        clear, frames: numbers of clear frames, and of frames of each condition.
        weathers: one condition each.
        rel_sd: stated of the record.
    """
    targets = Targets.drawn(seed, number)
    rng = np.random.default_rng([seed, 2])
    conditions = [
        {
            "id": f"c{place}",
            "scene": "s0",
            "weather": weather,
            "rel_sd": rel_sd,
            "frames": [
                through(targets, targets.frame(rng), weather, effects, int(rng.integers(2**62)), number)
                for number in range(frames)
            ],
            "time_s": [0.1 * number for number in range(frames)],
            "split": "holdout" if place == len(weathers) - 1 else "fit",
        }
        for place, weather in enumerate(weathers)
    ]
    given = {"id": "s0", "clear": [targets.frame(rng) for _ in range(clear)], "geometry": targets.geometry}
    return Study.from_arrays(sensor=SENSOR, scenes=[given], conditions=conditions)
