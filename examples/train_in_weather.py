"""Train in several weathers, and see in weather of another renderer what each is worth.

    python examples/train_in_weather.py

A small net gives each pixel of a street picture its class. It is trained from the same start without weather, with
changes of colour alone, with the weather of kornia and of albumentations (where it is installed), with ten naive lines,
with this library, and with this library when what is not known is drawn as well. It is trained in the country and
tested in town, in weather of a renderer that does not use the library (benchmarks/independent_weather.py). A second net
tells snow from objects in a LiDAR scan, beside the rule of neighbours and intensity. With ``--sensors recorded`` it is
trained on KITTI and tested on WADS, which you give by ``--kitti`` and ``--wads``. Rows of the library's own
simulator are named so. Writes tables, numbers and a picture. The full run takes some five hours of one core;
--processes trains several nets side by side and --device on a graphics card; a run that was stopped goes on where it
was. --quick takes three minutes; --ablate adds arms that lack one part of the physics each.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from parts import lidar_segmenter, snow_points, snow_recordings
from parts.shared import command_line, recordings
from parts.snow_points import average_precision
from parts.training_arms import INPUTS
from parts.training_data import cloud_samples, picture_samples, relabelled
from parts.training_results import ablations, draw, gains, table
from parts.training_runs import Clouds, Comparison, Pictures, Test, side_by_side, trainings

import torchweather as tw

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
independent, measure = importlib.import_module("independent_weather"), importlib.import_module("measure")

Scores = dict[tuple[str, str, str], list[float]]
"""By simulator, test and arm: one of each seed, or one alone where nothing is learned."""

TRAINED_IN, TESTED_IN = "country", "town"
FULL = {"width": 320, "seeds": 5, "train": 60, "test": 24, "steps": 1000, "cloud_train": 24, "cloud_test": 8}
FULL |= {"recorded_steps": 400, "recorded_draws": 2}
QUICK = {"width": 96, "seeds": 1, "train": 12, "test": 4, "steps": 60, "cloud_train": 4, "cloud_test": 2}
QUICK |= {"recorded_steps": 100, "recorded_draws": 1}
TESTS: dict[str, dict[str, float]] = {
    "clear": {},
    "rain 30 mm/h": {"rain_mm_per_h": 30.0},
    "fog 120 m": {"fog_m": 120.0},
    "fog 40 m": {"fog_m": 40.0},
    "snow 1.5 mm/h": {"snow_mm_per_h": 1.5},
    "snow 4 mm/h": {"snow_mm_per_h": 4.0},
    "rain 20 mm/h in fog 80 m": {"rain_mm_per_h": 20.0, "fog_m": 80.0},
}
OWN = {"rain 30 mm/h": tw.Rain(30.0), "fog 80 m": tw.Fog(mor_m=80.0), "snow 1.5 mm/h": tw.Snow(1.5)}
MAIN_ARMS = {
    *("share of snow", "DROR + intensity", "none", "photometric", "kornia", "albumentations"),
    *("naive", "naive, dark flakes", "library", "library, drawn"),
}
SNOWS_MM_PER_H = (0.5, 1.5, 3.0)


def camera_rows(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Mean IoU of each arm in each test."""
    width, height = arguments.width, arguments.width * 3 // 4
    places = [(TRAINED_IN, seed) for seed in range(arguments.train)]
    places += [(TESTED_IN, seed) for seed in range(arguments.test)]
    streets = side_by_side(street_of, [(place, seed, width, height) for place, seed in places], arguments.processes)
    tested = list(enumerate(streets[arguments.train :]))
    focal = independent.FOCAL_OVER_WIDTH * width
    middle = ((width - 1) / 2, 0.47 * height)
    camera = tw.Camera.from_intrinsics(focal, focal, *middle, width, height, height_m=independent.CAMERA_HEIGHT_M)
    clear = picture_samples(streets[arguments.train :])
    tests: dict[Test, torch.Tensor] = {}
    jobs = [(scene, seed, weather) for weather in TESTS.values() for seed, scene in tested]
    seen = np.stack(side_by_side(street_in_weather, jobs, arguments.processes))
    for name, pictures in zip(TESTS, np.split(seen, len(TESTS)), strict=True):
        tests["independent", name] = torch.from_numpy(pictures).permute(0, 3, 1, 2).contiguous()
    for name, weather in OWN.items():
        own = tw.AsBayer(tw.BayerWeather(weather, camera))
        tests["own", name] = torch.stack([own(one[0], one[1], seed=seed) for seed, one in enumerate(clear)])
    pictures, depth, classes = map(torch.stack, zip(*picture_samples(streets[: arguments.train]), strict=True))
    comparison = Pictures(
        samples=(pictures, depth, classes),
        tests=tests,
        classes=torch.stack([one[2] for one in clear]),
        class_count=len(independent.CLASSES),
        camera=camera.to_dict(),
        ablate=arguments.ablate,
        steps=arguments.steps,
        device=arguments.device,
    )
    settings = {"steps": arguments.steps, "trained_in": TRAINED_IN, "tested_in": TESTED_IN}
    settings |= {"train_scenes": arguments.train, "test_scenes": arguments.test, "width": width, "height": height}
    return compared("mean IoU of 7 classes (camera)", comparison, {}, arguments, settings)


def lidar_rows(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Average precision of snow of each arm and of the rule, in each test."""
    seeds = [*range(arguments.cloud_train), *(10_000 + seed for seed in range(arguments.cloud_test))]
    samples = cloud_samples(side_by_side(lidar_segmenter.cloud, seeds, arguments.processes))
    samples, clear = samples[: arguments.cloud_train], samples[arguments.cloud_train :]
    tests: dict[Test, tuple[torch.Tensor, torch.Tensor]] = {}
    for rate in SNOWS_MM_PER_H:
        seen = [independent_snow(one, seed, rate) for seed, one in enumerate(clear)]
        tests["independent", f"snow {rate:g} mm/h"] = stacked(seen)
    transform = tw.LidarSnow(tw.Snow(1.5), lidar_segmenter.SENSOR)
    compose = tw.Compose({"points": transform}, inputs=INPUTS)
    tests["own", "snow 1.5 mm/h"] = stacked([relabelled(*compose.run(one, seed=k)) for k, one in enumerate(clear)])
    known: Scores = {}
    for (simulator, test), (points, classes) in tests.items():
        known[simulator, test, "share of snow"] = [snow_share(classes)]
        known[simulator, test, "DROR + intensity"] = [snow_points.of_rule(points, classes)]
    settings = {"steps": arguments.steps}
    settings |= {"train_scenes": arguments.cloud_train, "test_scenes": arguments.cloud_test}
    comparison = Clouds(samples, tests, arguments.steps, arguments.device)
    return compared("average precision of snow (LiDAR)", comparison, known, arguments, settings)


def compared(
    title: str, comparison: Comparison, known: Scores, arguments: argparse.Namespace, settings: dict[str, Any]
) -> list[dict[str, Any]]:
    """Rows of nets that are trained in each arm, behind those that are known."""
    arms = list(chosen(comparison.arms(), arguments.arms))
    run = {"sensor": title, "code": measure.commit(), **settings}
    found = trainings(comparison, arms, arguments.seeds, arguments.processes, arguments.out / "scores.jsonl", run)
    for arm, by_seed in found.items():
        for simulator, test in by_seed[0]:
            known[simulator, test, arm] = [scores[simulator, test] for scores in by_seed]
    return rows_of(title, known, {"seeds": arguments.seeds, **settings})


def street_of(job: tuple[str, int, int, int]) -> Any:
    """A street of a place, a seed and a size."""
    place, seed, width, height = job
    return independent.street(seed, place, width, height)


def street_in_weather(job: tuple[Any, int, dict[str, float]]) -> np.ndarray:
    """Its picture in a weather of the independent renderer."""
    scene, seed, weather = job
    return np.asarray(independent.in_weather(scene, 1000 + seed, **weather) if weather else scene.picture)


def recorded_rows(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Average precision of snow in recorded scans: trained on KITTI with snow put on, tested on WADS."""
    sweeps = snow_recordings.clear_sweeps(kitti_folder(arguments))
    tests = {}
    for simulator, frame in (("recorded", snow_recordings.REPORTED), ("development", snow_recordings.DEVELOPMENT)):
        points, snow = snow_recordings.snowy_frame(recordings(arguments.wads, "wads_snow"), frame)
        tests[simulator, f"WADS {frame}"] = (points, snow)
    scores: Scores = {}
    described = {}
    for test, (points, snow) in tests.items():
        scores[(*test, "share of snow")] = [float(snow.float().mean())]
        scores[(*test, "DROR + intensity")] = [average_precision(snow_recordings.of_rule(points), snow)]
        described[test] = torch.from_numpy(snow_recordings.described(points, np.arange(len(points))))
    for name, arm in chosen(snow_recordings.arms(arguments.ablate), arguments.arms).items():
        began = time.process_time()
        for seed in range(arguments.seeds):
            seen, snow = snow_recordings.learned_from(sweeps, arm, seed, arguments.recorded_draws)
            net = snow_recordings.trained(seen, snow, seed, arguments.recorded_steps)
            for test, (_, snow) in tests.items():
                scores.setdefault((*test, name), []).append(average_precision(net(described[test]), snow))
        print(f"recorded, {name}: {time.process_time() - began:.0f} s of CPU", flush=True)
    settings = {"seeds": arguments.seeds, "steps": arguments.recorded_steps, "draws": arguments.recorded_draws}
    settings |= {"test_scenes": 1, "train_scenes": len(list(kitti_folder(arguments).glob("velodyne/*.bin")))}
    settings |= {"trained_on": "KITTI, snow put on", "tested_on": "WADS, labelled snow"}
    return rows_of("average precision of snow in recordings (LiDAR)", scores, settings)


def kitti_folder(arguments: argparse.Namespace) -> Path:
    return recordings(arguments.kitti, "kitti_13")


def independent_snow(sample: dict[str, Any], seed: int, rate_mm_per_h: float) -> dict[str, Any]:
    """A scan in snow of the independent renderer."""
    points, flake = independent.snow_on_beams(
        sample["points"].numpy(), sample["beams"].numpy(), seed, snow_mm_per_h=rate_mm_per_h
    )
    lost = torch.from_numpy(np.linalg.norm(points[:, :3], axis=1) == 0)
    classes = torch.where(torch.from_numpy(flake), lidar_segmenter.WEATHER, sample["classes"])
    return {"points": torch.from_numpy(points), "classes": torch.where(lost, lidar_segmenter.NONE, classes)}


def stacked(samples: list[dict[str, Any]]) -> tuple[torch.Tensor, torch.Tensor]:
    """Points and classes of several scans."""
    return torch.stack([one["points"] for one in samples]), torch.stack([one["classes"] for one in samples])


def snow_share(classes: torch.Tensor) -> float:
    """Share of flakes among the returns: the average precision of chance."""
    return float((classes == lidar_segmenter.WEATHER).sum() / (classes != lidar_segmenter.NONE).sum())


def chosen(arms: dict[str, Any], names: list[str] | None) -> dict[str, Any]:
    """The arms of those names; all where none are given."""
    return arms if not names else {name: arm for name, arm in arms.items() if name in names}


def rows_of(title: str, scores: Scores, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """One row a test and arm, with the settings."""
    rows = [
        {"sensor": title, "simulator": simulator, "test": test, "arm": arm, "scores": found, **settings}
        for (simulator, test, arm), found in scores.items()
    ]
    return [{**row, "ablation": True} if row["arm"] not in MAIN_ARMS else row for row in rows]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--out", type=Path, default=Path("train_in_weather"), help="folder for numbers and picture")
    for name, number in FULL.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, help=f"default: {number}, quick {QUICK[name]}")
    parser.add_argument("--arms", nargs="+", metavar="NAME", help="these alone")
    parser.add_argument("--sensors", nargs="+", choices=("camera", "lidar", "recorded"), default=["camera", "lidar"])
    for name in ("kitti", "wads"):
        parser.add_argument(f"--{name}", type=Path, help="folder with velodyne/*.bin, of the sensor recorded")
    parser.add_argument("--ablate", action="store_true", help="arms that lack one part of the physics each")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="nets trained side by side (default: 1)")
    parser.add_argument("--device", default="cpu", help="where nets are trained, such as cuda (default: cpu)")
    parser.add_argument("--quick", action="store_true", help="small pictures, little training, one seed")
    arguments = parser.parse_args()
    for name, number in (QUICK if arguments.quick else FULL).items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, number)
    began = time.perf_counter()
    rows: list[dict[str, Any]] = []
    for name, run in (("camera", camera_rows), ("lidar", lidar_rows), ("recorded", recorded_rows)):
        if name in arguments.sensors:
            rows += run(arguments)
            sensor = rows[-1]["sensor"]
            print(f"{sensor}\n\n{table(rows, sensor)}\n\n{ablations(rows, sensor)}\n", flush=True)
    arms = {row["arm"] for row in rows}
    for sensor in dict.fromkeys(row["sensor"] for row in rows):
        if {"library, drawn", "naive"} <= arms:
            over = gains(rows, sensor, "library, drawn", "naive")
            print(f"{sensor}: library, drawn, over naive by seed: {', '.join(f'{one:+.3f}' for one in over)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    draw(rows, arguments.out / "train_in_weather.png")
    found = {
        "commit": measure.commit(),
        "machine": platform.processor() or platform.machine(),
        "seconds": round(time.perf_counter() - began),
        "rows": [{**row, "scores": [one if math.isfinite(one) else None for one in row["scores"]]} for row in rows],
    }
    (arguments.out / "train_in_weather.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{found['seconds']} s; {arguments.out / 'train_in_weather.png'}")


if __name__ == "__main__":
    main()
