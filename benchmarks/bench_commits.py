"""Processor time of a training sample with the code of several commits, in turn on one machine.

    python benchmarks/bench_commits.py 0eac09b6 HEAD --out benchmarks/commits.json
    python benchmarks/bench_commits.py HEAD --quick                   # tries the script, the figures mean nothing

A JPEG of 1242 x 375 and of 1600 x 900 px and a KITTI ``.bin`` of 120,000 points, each read and put into a weather of
its own. One thread. Commits go in turn, one process each, for so many rounds; a figure is the median of the rounds'
medians. Packages are those of this environment: of commits that know numba, particles are rendered by compiled loops
where it is installed. ``training`` is training quality, where a commit has it.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import cpu_times_ms, hand_over, machine
from PIL import Image

import torchweather as tw
from torchweather.scenes import test_track

ROOT = Path(__file__).parents[1]
SIZES = ((1242, 375), (1600, 900))
POINTS = 120_000
# Drawn for each sample, and of the transform as it is built.
WEATHERS: dict[str, tuple[Any, Any]] = {
    "rain": (tw.Rain(rate_mm_per_h=(8, 12)), tw.Rain(10.0)),
    "snow": (tw.Snow(rate_mm_per_h=(2, 3)), tw.Snow(2.5)),
    "fog": (tw.Fog(mor_m=(30, 500)), tw.Fog(mor_m=100.0)),
}
CAMERAS = {"rain": tw.BayerRain, "snow": tw.BayerSnow, "fog": tw.BayerFog}
LIDARS = {"rain": tw.LidarRain, "snow": tw.LidarSnow, "fog": tw.LidarFog}

Calls = dict[str, Callable[[int], Any]]


def decoded(jpeg: bytes) -> torch.Tensor:
    return torch.from_numpy(np.array(Image.open(io.BytesIO(jpeg)))).permute(2, 0, 1)


def camera_calls(width: int, height: int) -> Calls:
    """The embedded street as a JPEG, clear and in every weather."""
    camera = tw.Camera.from_intrinsics(720.0, 720.0, width / 2 - 0.5, height / 2 - 0.5, width, height, height_m=1.65)
    view, file = test_track().view(camera), io.BytesIO()
    street = (view.rgb.clamp(0, 1) ** (1 / 2.2) * 255).byte().permute(1, 2, 0).numpy()
    Image.fromarray(street).save(file, "JPEG", quality=95)
    jpeg, depth = file.getvalue(), view.depth_m
    found: Calls = {f"{width} x {height} clear": lambda seed: decoded(jpeg)}
    qualities = ("exact", "training") if "quality" in signature(tw.BayerWeather.__init__).parameters else ("",)
    for kind, (drawn, usual) in WEATHERS.items():
        for quality in qualities if kind != "fog" else qualities[:1]:
            options = {"quality": quality} if quality else {}
            inner = tw.AsBayer(CAMERAS[kind](usual, camera, airlight=0.7, **options))
            run = tw.Compose({"image": inner}, weather=drawn)
            name = f"{width} x {height} {kind}" + (" training" if quality == "training" else "")
            found[name] = lambda seed, run=run: run({"image": decoded(jpeg), "depth": depth}, seed=seed)
    return found


def lidar_calls(folder: Path) -> Calls:
    """A made-up sweep in a file, clear and in every weather."""
    rng, path = np.random.default_rng(0), folder / "sweep.bin"
    direction = rng.normal(size=(POINTS, 3)) * [1.0, 1.0, 0.15]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    range_m = np.exp(rng.uniform(np.log(3.0), np.log(80.0), POINTS))
    reflectivity = rng.uniform(0.05, 0.6, (POINTS, 1))
    np.concatenate([direction * range_m[:, None], reflectivity], 1).astype(np.float32).tofile(path)
    sensor = tw.Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")

    def read() -> torch.Tensor:
        return torch.from_numpy(np.fromfile(path, np.float32).reshape(-1, 4))

    found: Calls = {"KITTI .bin clear": lambda seed: read()}
    for kind, (drawn, usual) in WEATHERS.items():
        run = tw.Compose({"points": LIDARS[kind](usual, sensor)}, weather=drawn)
        found[f"KITTI .bin {kind}"] = lambda seed, run=run: run({"points": read()}, seed=seed)
    return found


def measured(repeats: int, sizes: tuple[tuple[int, int], ...]) -> dict[str, float]:
    """Processor milliseconds of every sample: the median of so many after two that do not count."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        calls: Calls = {}
        for size in sizes:
            calls |= camera_calls(*size)
        calls |= lidar_calls(Path(folder))
        times = cpu_times_ms(calls, repeats)
    return {name: statistics.median(some) for name, some in times.items()}


def of_commit(tree: Path, arguments: argparse.Namespace) -> dict[str, float]:
    """The figures of a tree, from a process of its own."""
    command = [sys.executable, __file__, "--here", "--repeats", str(arguments.repeats)]
    command += ["--quick"] if arguments.quick else []
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, cwd=tree, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="*", help="of this clone")
    parser.add_argument("--out", type=Path, help="file for the JSON; default: standard output")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="a small image, one sample")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)  # of the processes it starts
    arguments = parser.parse_args()
    if arguments.here:
        print(
            json.dumps(
                measured(1 if arguments.quick else arguments.repeats, ((320, 240),) if arguments.quick else SIZES)
            )
        )
        return
    if not arguments.commits:
        parser.error("commits: expected one or more; got none.")
    git = ["git", "-C", str(ROOT)]
    rounds: dict[str, list[dict[str, float]]] = {commit: [] for commit in arguments.commits}
    with tempfile.TemporaryDirectory() as folder:
        trees = {commit: Path(folder) / str(place) for place, commit in enumerate(rounds)}
        try:
            for commit, tree in trees.items():
                subprocess.run([*git, "worktree", "add", "-q", "--detach", str(tree), commit], check=True)
            for _ in range(1 if arguments.quick else arguments.rounds):
                for commit, tree in trees.items():
                    rounds[commit].append(of_commit(tree, arguments))
        finally:
            for tree in trees.values():
                subprocess.run([*git, "worktree", "remove", "--force", str(tree)], check=False)
    samples = {
        commit: {name: round(statistics.median(one[name] for one in some), 1) for name in some[0]}
        for commit, some in rounds.items()
    }
    numbers = {
        commit: subprocess.run([*git, "rev-parse", commit], capture_output=True, text=True, check=True).stdout.strip()
        for commit in rounds
    }
    hand_over(
        {"machine": {**machine(), "threads": 1}, "quick": arguments.quick, "commits": numbers, "cpu_ms": samples},
        arguments.out,
    )


if __name__ == "__main__":
    main()
