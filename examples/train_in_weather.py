"""Train with weather and without, and see what it is worth in weather that was never trained on.

    python examples/train_in_weather.py

A small detector finds cars in raw frames of the embedded test track, a small net tells the points of a LiDAR scan
apart. Both are trained twice from the same start: on clear data, and on the same data with rain, fog and snow put on
by ``Compose``, drawn anew for every sample. Both are tested on other scenes: clear, in weather of kinds and strengths
that were trained on, and in weather that was not: heavier rain, denser fog, heavier snow, rain in fog. Three seeds say
how much of the difference is chance. Writes a table, its numbers and a picture. Some minutes on two cores; --quick is
smaller.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from parts import car_detector, lidar_segmenter
from parts.car_detector import picture
from parts.lidar_segmenter import SENSOR
from parts.shared import command_line
from parts.training_data import camera_batches, camera_samples, cloud_samples, lidar_batches, loader_of, relabelled
from parts.training_results import draw, table

import torchweather as tw

# What is trained on; a third stays clear.
TRAINED_ON = tw.Choice(
    [
        None,
        tw.Rain(rate_mm_per_h=tw.LogUniform(2, 50)),
        tw.Fog(mor_m=tw.LogUniform(60, 500)),
        tw.Snow(rate_mm_per_h=tw.LogUniform(0.3, 3)),
    ],
    weights=[3, 2, 2, 2],
)
# What is tested: name, weather, whether it lies within what was trained on.
TESTS: list[tuple[str, tw.Rain | tw.Fog | tw.Snow | tw.Mixture | None, bool]] = [
    ("clear", None, True),
    ("rain 20 mm/h", tw.Rain(20.0), True),
    ("rain 100 mm/h", tw.Rain(100.0), False),
    ("fog 120 m", tw.Fog(mor_m=120.0), True),
    ("fog 40 m", tw.Fog(mor_m=40.0), False),
    ("fog 25 m", tw.Fog(mor_m=25.0), False),
    ("snow 1.5 mm/h", tw.Snow(1.5), True),
    ("snow 6 mm/h", tw.Snow(6.0), False),
    ("rain 25 mm/h in fog 80 m", tw.Mixture(tw.Rain(25.0), tw.Fog(mor_m=80.0)), False),
]


def camera_study(arguments: argparse.Namespace) -> Callable[[bool, int], list[float]]:
    """Trains a detector, with or without weather, and scores it in every test."""
    frames = [car_detector.frame(seed) for seed in range(arguments.train)]
    others = [car_detector.frame(10_000 + seed) for seed in range(arguments.test)]
    camera = frames[0].camera
    samples = camera_samples(frames)
    tests = []
    for _, weather, _ in TESTS:
        pictures = []
        for seed, each in enumerate(others):
            bayer = each.bayer
            if weather is not None:
                bad_weather = tw.BayerWeather(weather, each.camera)
                bayer = bad_weather(bayer, each.depth_m, bad_weather.draw(bayer, seed=seed))
            pictures.append(picture(bayer, each.camera))
        tests.append(torch.stack(pictures))

    def run(in_weather: bool, seed: int) -> list[float]:
        transform = tw.Compose(
            {"image": tw.BayerWeather(tw.Rain(10.0), camera)}, weather=TRAINED_ON, p=float(in_weather)
        )
        batches = camera_batches(loader_of(samples, transform, seed, arguments.steps), camera)
        detector = car_detector.trained(batches, arguments.steps, seed)
        return [car_detector.precision(detector, seen, others) for seen in tests]

    return run


def in_weather_of(weather: Any, p: float = 1.0) -> tw.Compose:
    lidar = tw.LidarWeather(tw.Rain(10.0), SENSOR)
    return tw.Compose({"points": lidar}, weather=weather, p=p, inputs={"points": {"directions": "beams"}})


def lidar_study(arguments: argparse.Namespace) -> Callable[[bool, int], list[float]]:
    """Trains a net, with or without weather, and scores it in every test."""
    samples = cloud_samples([lidar_segmenter.cloud(seed) for seed in range(arguments.train)])
    others = cloud_samples([lidar_segmenter.cloud(10_000 + seed) for seed in range(arguments.test)])
    tests = []
    for _, weather, _ in TESTS:
        compose = in_weather_of([weather] if weather is not None else [tw.Rain(1.0)], p=float(weather is not None))
        seen = [relabelled(*compose.run(sample, seed=seed)) for seed, sample in enumerate(others)]
        tests.append(tuple(torch.stack([one[key] for one in seen]) for key in ("points", "classes")))

    def run(in_weather: bool, seed: int) -> list[float]:
        loader = loader_of(samples, in_weather_of(TRAINED_ON, float(in_weather)), seed, arguments.steps, relabelled)
        net = lidar_segmenter.trained(lidar_batches(loader), arguments.steps, seed)
        return [lidar_segmenter.mean_iou(net, points, classes) for points, classes in tests]

    return run


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, default=Path("train_in_weather"), help="folder for numbers and picture")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--train", type=int, default=24, help="scenes to learn from")
    parser.add_argument("--test", type=int, default=8, help="other scenes")
    parser.add_argument("--steps", type=int, default=400, help="of training")
    parser.add_argument("--quick", action="store_true", help="few scenes, little training, one seed")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.seeds, arguments.train, arguments.test, arguments.steps = 1, 2, 1, 2
        del TESTS[3:]
    tests = [(name, inside) for name, _, inside in TESTS]
    began = time.perf_counter()
    studies = {
        "average precision of cars (camera)": camera_study(arguments),
        "mean IoU of five classes (LiDAR)": lidar_study(arguments),
    }
    results: dict[str, Any] = {}
    for title, run in studies.items():
        results[title] = {
            arm: [run(in_weather, seed) for seed in range(arguments.seeds)]
            for arm, in_weather in (("clear", False), ("weather", True))
        }
        print(f"{table(results[title], title, tests)}\n", flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    draw(results, tests, arguments.out / "train_in_weather.png")
    found = {
        "machine": platform.processor() or platform.machine(),
        "seconds": round(time.perf_counter() - began),
        "settings": {key: value for key, value in vars(arguments).items() if key != "out"},
        "tests": [{"name": name, "trained_on": inside} for name, inside in tests],
        "scores": results,
    }
    (arguments.out / "train_in_weather.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{found['seconds']} s; {arguments.out / 'train_in_weather.png'}")


if __name__ == "__main__":
    main()
