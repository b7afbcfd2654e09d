"""Processor time of a training sample: a JPEG read and put into weather, beside other libraries in the same run.

    python benchmarks/bench_training.py --out benchmarks/training.json
    python benchmarks/bench_training.py --quick                        # tries the script, the figures mean nothing

One thread. Every sample has a rate or visibility and an airlight of its own; depth is given. All arms go in turn,
sample by sample, so that a slow minute of the machine hits all; a figure is the median. ``torch`` and ``numba`` are
exact quality, ``bank`` is training quality; what is not installed is named under ``left_out``. ``growth`` is exact rain
on images of other sizes, per million pixels. ``transforms`` are single calls on a mosaic or an RGB image in memory.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import cpu_times_ms, hand_over, machine
from PIL import Image

import torchweather as tw
from torchweather.scenes import test_track

SIZES = {"1242 x 375": (1242, 375), "1600 x 900": (1600, 900)}
TRANSFORM_SIZES = {"640 x 480": (640, 480), "1242 x 375": (1242, 375), "1936 x 1464": (1936, 1464)}
GROWTH = ((512, 512), (1242, 375), (1600, 900), (3840, 2160))
WEATHERS: dict[str, Any] = {
    "rain": tw.Rain(rate_mm_per_h=tw.LogUniform(8, 12.5)),
    "snow": tw.Snow(rate_mm_per_h=tw.LogUniform(2, 3)),
    "fog": tw.Fog(mor_m=tw.LogUniform(30, 500)),
}
AIRLIGHT = tw.Uniform(0.4, 0.9)
PATHS = {"torch": "0", "numba": "1"}  # to the setting of TORCHWEATHER_COMPILED
TARGETS_MS = {
    "torch": {"rain": 60.0, "snow": 65.0, "fog": 16.0},
    "numba": {"rain": 30.0, "snow": 32.0},
    "bank": {"rain": 14.0, "snow": 16.0},
}
# Fog takes its airlight from a frame without sky: from the brightest spot.
RAIN_50, FOG_WITHOUT_SKY, NO_RAIN = "BayerRain 50 mm/h", "BayerFog 200 m, no airlight, no sky", "AsBayer 0 mm/h"
TRANSFORM_TARGETS_MS = {
    "torch": {
        "640 x 480": {RAIN_50: 55.0},
        "1242 x 375": {NO_RAIN: 6.0},
        "1936 x 1464": {RAIN_50: 400.0, FOG_WITHOUT_SKY: 15.0, NO_RAIN: 45.0},
    },
    "numba": {"640 x 480": {RAIN_50: 18.0}, "1936 x 1464": {RAIN_50: 210.0}},
}


def street(width: int, height: int) -> tuple[bytes, torch.Tensor, tw.Camera]:
    """The embedded street as a JPEG, its depth, and the camera."""
    camera = tw.Camera.from_intrinsics(720.0, 720.0, width / 2 - 0.5, height / 2 - 0.5, width, height, height_m=1.65)
    view = test_track().view(camera)
    file = io.BytesIO()
    Image.fromarray((view.rgb.clamp(0, 1) ** (1 / 2.2) * 255).byte().permute(1, 2, 0).numpy()).save(
        file, "JPEG", quality=95
    )
    return file.getvalue(), view.depth_m, camera


def decoded(jpeg: bytes) -> torch.Tensor:
    return torch.from_numpy(np.array(Image.open(io.BytesIO(jpeg)))).permute(2, 0, 1)


def library(camera: tw.Camera, weather: Any, quality: str, depth: torch.Tensor) -> Callable[[torch.Tensor, int], Any]:
    inner = tw.AsBayer(tw.BayerWeather(None, camera, airlight=AIRLIGHT, quality=quality))
    compose = tw.Compose({"image": inner}, weather=weather)
    return lambda image, seed: compose({"image": image, "depth": depth}, seed=seed)


def peers() -> tuple[dict[str, Callable[[torch.Tensor, int], Any]], list[str]]:
    """Weathers of other libraries, and the names of what is not installed."""
    from kornia.augmentation import RandomRain, RandomSnow

    rain, snow = RandomRain(p=1.0), RandomSnow(p=1.0)
    found: dict[str, Callable[[torch.Tensor, int], Any]] = {
        "kornia RandomRain": lambda image, seed: rain(image[None].float() / 255),
        "kornia RandomSnow": lambda image, seed: snow(image[None].float() / 255),
    }
    missing = [name for name in ("albumentations", "imagecorruptions") if find_spec(name) is None]
    if "albumentations" not in missing:
        import albumentations

        for name in ("RandomRain", "RandomFog"):
            transform = getattr(albumentations, name)(p=1.0)
            found[f"albumentations {name}"] = lambda image, seed, run=transform: run(
                image=image.permute(1, 2, 0).numpy()
            )
    if "imagecorruptions" not in missing:
        from imagecorruptions import corrupt

        for name in ("fog", "snow"):
            found[f"imagecorruptions {name}"] = lambda image, seed, name=name: corrupt(
                image.permute(1, 2, 0).numpy(), corruption_name=name
            )
    return found, missing


def medians(calls: dict[str, Callable[[int], Any]], repeats: int) -> dict[str, dict[str, float]]:
    """Processor milliseconds of each call, all in turn."""
    times = cpu_times_ms(calls, repeats)
    return {
        name: {
            "median_cpu_ms": round(statistics.median(some), 2),
            "min_ms": round(min(some), 2),
            "max_ms": round(max(some), 2),
        }
        for name, some in times.items()
    }


def loader_times(size: tuple[int, int], repeats: int, path: str) -> dict[str, Any]:
    """A clear loader and every weather on this path; the peers beside the first path."""
    jpeg, depth, camera = street(*size)
    calls: dict[str, Callable[[int], Any]] = {"clear": lambda seed: decoded(jpeg)}
    qualities = {"exact": path, **({"training": "bank"} if path == "numba" or find_spec("numba") is None else {})}
    for kind, weather in WEATHERS.items():
        for quality, name in qualities.items():
            if quality == "training" and kind == "fog":
                continue
            run = library(camera, weather, quality, depth)
            calls[f"{name} {kind}"] = lambda seed, run=run: run(decoded(jpeg), seed)
    missing: list[str] = []
    if path == "torch":
        others, missing = peers()
        for name, run in others.items():
            calls[name] = lambda seed, run=run: run(decoded(jpeg), seed)
    return {"samples": medians(calls, repeats), "left_out": missing}


def transform_times(size: tuple[int, int], repeats: int) -> dict[str, Any]:
    """Single calls on an image in memory, everything drawn anew; of a mosaic where the image has whole tiles."""
    jpeg, depth, camera = street(*size)
    image, near = decoded(jpeg), depth.clamp(max=200.0)
    dry = tw.AsBayer(tw.BayerRain(tw.Rain(0.0), camera, airlight=0.7))
    calls: dict[str, Callable[[int], Any]] = {NO_RAIN: lambda seed: dry(image, depth, seed=seed)}
    if size[1] % 2 == 0:
        mosaic = (image.float().mean(0, keepdim=True) / 255) ** 2.2
        rain, fog = tw.BayerRain(tw.Rain(50.0), camera, airlight=0.7), tw.BayerFog(tw.Fog(200.0), camera)
        calls[RAIN_50] = lambda seed: rain(mosaic, depth, seed=seed)
        calls[FOG_WITHOUT_SKY] = lambda seed: fog(mosaic, near, seed=seed)
    return medians(calls, repeats)


def growth(sizes: tuple[tuple[int, int], ...], repeats: int) -> dict[str, float]:
    """Processor milliseconds of exact rain per million pixels."""
    found = {}
    for width, height in sizes:
        jpeg, depth, camera = street(width, height)
        run, image = library(camera, WEATHERS["rain"], "exact", depth), decoded(jpeg)
        cost = medians({"rain": lambda seed, run=run, image=image: run(image, seed)}, repeats)["rain"]["median_cpu_ms"]
        found[f"{width} x {height}"] = round(cost / (width * height / 1e6), 1)
    return found


def of_path(path: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """The figures of one path, from a process of its own."""
    command = [sys.executable, __file__, "--path", path, "--repeats", str(arguments.repeats)]
    command += ["--quick"] if arguments.quick else []
    environment = {**os.environ, "TORCHWEATHER_COMPILED": PATHS[path]}
    found: dict[str, Any] = json.loads(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
    return found


def measured(path: str, arguments: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(1)
    sizes = {"320 x 240": (320, 240)} if arguments.quick else SIZES
    repeats = 2 if arguments.quick else arguments.repeats
    return {
        "loader": {name: loader_times(size, repeats, path) for name, size in sizes.items()},
        "transforms": {
            name: transform_times(size, repeats)
            for name, size in (sizes if arguments.quick else TRANSFORM_SIZES).items()
        },
        "growth_ms_per_megapixel": growth(((320, 240),) if arguments.quick else GROWTH, max(2, repeats // 3)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="file for the JSON; default: standard output")
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--quick", action="store_true", help="small image, two samples")
    parser.add_argument("--path", choices=tuple(PATHS), help=argparse.SUPPRESS)  # of the processes it starts
    arguments = parser.parse_args()
    if arguments.path:
        print(json.dumps(measured(arguments.path, arguments)))
        return
    paths = {path: of_path(path, arguments) for path in PATHS if path == "torch" or find_spec("numba") is not None}
    result: dict[str, Any] = {"machine": {**machine(), "threads": 1}, "quick": arguments.quick, "loader": {}}
    for size, first in paths["torch"]["loader"].items():
        samples = dict(first["samples"])
        for path in paths:
            samples |= {
                key: value for key, value in paths[path]["loader"][size]["samples"].items() if key not in samples
            }
        clear = samples["clear"]["median_cpu_ms"]
        for entry in samples.values():
            entry["share_of_time_for_weather"] = round(max(0.0, 1 - clear / entry["median_cpu_ms"]), 2)
        result["loader"][size] = {"left_out": first["left_out"], "samples": samples}
    result["transforms"] = {path: found["transforms"] for path, found in paths.items()}
    result["growth_ms_per_megapixel"] = {path: found["growth_ms_per_megapixel"] for path, found in paths.items()}
    result["targets_at_most_ms"] = {"1242 x 375": TARGETS_MS, "transforms": TRANSFORM_TARGETS_MS}
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
