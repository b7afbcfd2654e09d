"""Samples a second of a data loader with 0, 1 and 2 workers, clear and in weather, and the share of time weather takes.

    python benchmarks/bench_loader.py --out benchmarks/loader.json
    python benchmarks/bench_loader.py --quick                        # tries the script, the figures mean nothing

Camera: raw frames of 1936 x 1464 and their depth, 16-bit and 32-bit, read from files. LiDAR: clouds of 131,072 beams
and their directions, read from files. Each sample gets a weather of its own, as in training: a rate or visibility that
nobody drew before. Rounds go through all settings in turn, so that a slow minute of the machine hits all; a figure is
the median.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import hand_over, machine
from torch.utils.data import DataLoader, Dataset

import torchweather as tw
from torchweather.scenes import lidar_view, test_track

WORKERS = (0, 1, 2)
WEATHERS: dict[str, Any] = {
    "clear": None,
    "rain": tw.Rain(rate_mm_per_h=tw.LogUniform(1, 50)),
    "fog": tw.Fog(mor_m=tw.LogUniform(30, 500)),
    "snow": tw.Snow(rate_mm_per_h=tw.LogUniform(0.2, 3)),
}


class Files(Dataset[Any]):
    """The same sample again and again, read from its files each time."""

    def __init__(self, folder: Path, keys: tuple[str, ...], number: int) -> None:
        self.folder, self.keys, self.number = folder, keys, number

    def __len__(self) -> int:
        return self.number

    def __getitem__(self, index: int) -> dict[str, Any]:
        return {key: torch.from_numpy(np.load(self.folder / f"{key}.npy")) for key in self.keys}


def written(folder: Path, arrays: dict[str, Any]) -> tuple[str, ...]:
    for key, value in arrays.items():
        np.save(folder / f"{key}.npy", value)
    return tuple(arrays)


def camera_sample(folder: Path, quick: bool) -> tuple[tuple[str, ...], Any, dict[str, Any]]:
    camera = tw.Camera.preset("lucid-triton")
    camera = camera.resized(242, 184) if quick else camera
    view = test_track().view(camera)
    low, high = camera.black_level, camera.white_level or 4095.0
    raw = (low + view.bayer * (high - low)).round().numpy().astype(np.uint16)
    keys = written(folder, {"image": raw, "depth": view.depth_m.numpy()})
    return keys, {"image": tw.BayerWeather(tw.Rain(10.0), camera)}, {"pixels": [camera.width, camera.height]}


def lidar_sample(folder: Path, quick: bool) -> tuple[tuple[str, ...], Any, dict[str, Any]]:
    lidar = tw.Lidar.preset("ouster-os1-128", columns=64 if quick else 1024)
    view = lidar_view(test_track(), lidar)
    keys = written(folder, {"points": view.points.numpy(), "beams": view.directions.numpy()})
    return keys, {"points": tw.LidarWeather(tw.Rain(10.0), lidar)}, {"beams": len(view.points)}


def samples_per_s(files: Files, transforms: Any, weather: Any, workers: int, inputs: Any) -> float:
    data: Any = files
    if weather is not None:
        data = tw.WeatherDataset(files, tw.Compose(transforms, weather=weather, inputs=inputs), seed=1)
    loader = DataLoader(data, batch_size=1, num_workers=workers, collate_fn=list, persistent_workers=workers > 0)
    for _ in loader:  # workers started, tables made
        pass
    start = time.perf_counter()
    for _ in loader:
        pass
    return len(files) / (time.perf_counter() - start)


def study(name: str, number: int, rounds: int, quick: bool) -> dict[str, Any]:
    make, inputs = {"camera": (camera_sample, None), "lidar": (lidar_sample, {"points": {"directions": "beams"}})}[name]
    with tempfile.TemporaryDirectory() as folder:
        keys, transforms, size = make(Path(folder), quick)
        files = Files(Path(folder), keys, number)
        found: dict[tuple[str, int], list[float]] = {}
        for _ in range(rounds):
            for weather, law in WEATHERS.items():
                for workers in WORKERS:
                    speed = samples_per_s(files, transforms, law, workers, inputs)
                    found.setdefault((weather, workers), []).append(speed)
    median = {place: statistics.median(speeds) for place, speeds in found.items()}
    result: dict[str, Any] = {**size, "samples": number, "rounds": rounds}
    for weather in WEATHERS:
        result[weather] = {
            f"{workers}_workers": {
                "samples_per_s": round(median[weather, workers], 2),
                "least_and_most": [round(pick(found[weather, workers]), 2) for pick in (min, max)],
                "share_of_time_for_weather": round(1.0 - median[weather, workers] / median["clear", workers], 3),
            }
            for workers in WORKERS
        }
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="file for the JSON; default: standard output")
    parser.add_argument("--quick", action="store_true", help="small data, one round")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"machine": machine()}
    for name, number in (("camera", 8), ("lidar", 60)):
        few, rounds = (2, 1) if arguments.quick else (number, 3)
        result[name] = study(name, few, rounds, arguments.quick)
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
