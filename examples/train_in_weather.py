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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from parts import car_detector, lidar_segmenter
from parts.car_detector import Batch, Frame, picture
from parts.lidar_segmenter import NONE, SENSOR, WEATHER, Cloud
from torch import Tensor
from torch.utils.data import DataLoader, RandomSampler

import torchweather as tw

matplotlib.use("Agg")
import matplotlib.pyplot as plt

BATCH = 4
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


# ---- camera ----------------------------------------------------------------------------------------------------------


def camera_samples(frames: list[Frame]) -> list[dict[str, Any]]:
    parts = [car_detector.targets(each) for each in frames]
    return [
        {"image": each.bayer, "depth": each.depth_m, "targets": part} for each, part in zip(frames, parts, strict=True)
    ]


def camera_batches(loader: DataLoader[Any], camera: tw.Camera) -> Iterator[Batch]:
    for samples in loader:
        seen = torch.stack([picture(sample["image"], camera) for sample in samples])
        positive, counts, edges = (torch.stack([sample["targets"][k] for sample in samples]) for k in range(3))
        yield seen, positive, counts, edges


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


# ---- LiDAR -----------------------------------------------------------------------------------------------------------


def cloud_samples(clouds: list[Cloud]) -> list[dict[str, Any]]:
    return [{"points": each.points, "beams": each.directions, "classes": each.classes} for each in clouds]


def relabelled(sample: dict[str, Any], results: dict[str, Any]) -> dict[str, Any]:
    """Classes after the weather: its own points are weather, lost ones are of no class."""
    if not results:
        return sample
    kind = results["points"].kind
    classes = torch.where(kind == tw.PointKind.PARTICLE, WEATHER, sample["classes"])
    return {**sample, "classes": torch.where(kind == tw.PointKind.LOST, NONE, classes)}


def in_weather_of(weather: Any, p: float = 1.0) -> tw.Compose:
    lidar = tw.LidarWeather(tw.Rain(10.0), SENSOR)
    return tw.Compose({"points": lidar}, weather=weather, p=p, inputs={"points": {"directions": "beams"}})


def lidar_batches(loader: DataLoader[Any]) -> Iterator[tuple[Tensor, Tensor]]:
    for samples in loader:
        yield torch.stack([one["points"] for one in samples]), torch.stack([one["classes"] for one in samples])


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


# ---- both ------------------------------------------------------------------------------------------------------------


def loader_of(
    samples: list[dict[str, Any]], transform: tw.Compose, seed: int, steps: int, after: Any = None
) -> DataLoader[Any]:
    """Batches of samples drawn at random, each in a weather of its own, whoever draws it again."""
    order = torch.Generator().manual_seed(seed)
    draws = RandomSampler(range(steps * BATCH), replacement=False, generator=order)
    repeated = [samples[k % len(samples)] for k in range(steps * BATCH)]
    data = tw.WeatherDataset(repeated, transform, seed=seed, after=after)
    return DataLoader(data, batch_size=BATCH, sampler=draws, collate_fn=list)


def table(scores: dict[str, Any], name: str) -> str:
    lines = [f"{name}, mean of {len(scores['clear'])} seeds (largest distance from it)", ""]
    lines.append(f"{'tested in':28s} {'trained clear':>16s} {'trained in weather':>20s} {'gain':>16s}")
    clear, weather = (np.array(scores[arm]) for arm in ("clear", "weather"))
    for k, (test, _, inside) in enumerate(TESTS):
        cells = [f"{v.mean():.2f} ({abs(v - v.mean()).max():.2f})" for v in (clear[:, k], weather[:, k])]
        gain = weather[:, k] - clear[:, k]
        cells.append(f"{gain.mean():+.2f} ({abs(gain - gain.mean()).max():.2f})")
        mark = "" if inside else " *"
        lines.append(f"{test + mark:28s} {cells[0]:>16s} {cells[1]:>20s} {cells[2]:>16s}")
    return "\n".join([*lines, "* outside of what was trained on"])


def spread(values: np.ndarray) -> np.ndarray:
    """Distances of the least and the greatest from the mean, ``(2, tests)``."""
    mean = values.mean(0)
    return np.stack([mean - values.min(0), values.max(0) - mean])


def draw(results: dict[str, Any], path: Path) -> None:
    figure, axes = plt.subplots(1, len(results), figsize=(6.4 * len(results), 4.6), constrained_layout=True)
    names = [name if inside else f"{name} *" for name, _, inside in TESTS]
    place = np.arange(len(names))
    kinds = [name.split()[0] if "in" not in name.split() else "mixture" for name, _, _ in TESTS]
    groups = [[k for k, one in enumerate(kinds) if one == kind] for kind in dict.fromkeys(kinds)]
    for axis, (title, scores) in zip(np.atleast_1d(axes), results.items(), strict=True):
        for arm, colour, label in (("clear", "0.45", "trained clear"), ("weather", "tab:blue", "trained in weather")):
            values = np.array(scores[arm])
            for group in groups:  # of one weather, light to heavy
                axis.plot(place[group], values.mean(0)[group], "o-", color=colour, label=label)
                axis.errorbar(place[group], values.mean(0)[group], spread(values)[:, group], color=colour, capsize=3)
                label = None
        axis.set_xticks(place, names, rotation=40, ha="right")
        axis.set_ylim(0, 1)
        axis.set_ylabel(title)
        axis.grid(alpha=0.3)
        axis.legend(loc="upper right")
    figure.suptitle("Points: mean of the seeds; bars: all of them; *: outside of what was trained on", fontsize=10)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
        print(f"{table(results[title], title)}\n", flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    draw(results, arguments.out / "train_in_weather.png")
    found = {
        "machine": platform.processor() or platform.machine(),
        "seconds": round(time.perf_counter() - began),
        "settings": {key: value for key, value in vars(arguments).items() if key != "out"},
        "tests": [{"name": name, "trained_on": inside} for name, _, inside in TESTS],
        "scores": results,
    }
    (arguments.out / "train_in_weather.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{found['seconds']} s; {arguments.out / 'train_in_weather.png'}")


if __name__ == "__main__":
    main()
