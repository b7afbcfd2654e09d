"""Times of weather on a CUDA device beside the same calls on one thread of its machine's processor.

    python benchmarks/bench_cuda.py --out benchmarks/cuda.json

An RGB frame of 1242 x 375, a Bayer frame of 640 x 480, and the embedded test track as an Ouster OS1-128 (131,072 beams)
sees it. A call draws and renders, with a seed of its own; ``batch`` is a frame's part of a call with eight. The device
is waited for before the clock is read. ``differ`` is the share of values of one draw that are not the same on both, and
``largest_difference`` the largest of them: a beam at the edge of a decision may fall on either side.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import torch
from measure import hand_over, machine, times_ms

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import lidar_view, test_track

BATCH = 8
WEATHERS: dict[str, Weather] = {"rain": tw.Rain(10.0), "snow": tw.Snow(1.5), "fog": tw.Fog(mor_m=80.0)}
Case = tuple[Callable[[Weather], torch.nn.Module], tuple[torch.Tensor, ...], float]
"""A transform for a weather, its input, and the difference below which two values are the same."""


def cases() -> dict[str, Case]:
    photo = tw.Camera.from_intrinsics(720.0, 720.0, 620.0, 187.0, 1242, 375)
    raw = tw.Camera.from_intrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)
    of_photo, of_raw = test_track().view(photo), test_track().view(raw)
    image = (of_photo.rgb.clamp(0, 1) ** (1 / 2.2) * 255).byte()
    plain = tw.Lidar.preset("ouster-os1-128", columns=1024)
    cloud = lidar_view(test_track(), plain)
    lidar = replace(plain, directions=cloud.directions)
    return {
        "RGB 1242 x 375": (
            lambda weather: tw.AsBayer(tw.BayerWeather(weather, photo, airlight=0.7)),
            (image, of_photo.depth_m),
            1.0,  # of 255: another rounding
        ),
        "Bayer 640 x 480": (
            lambda weather: tw.BayerWeather(weather, raw, airlight=0.7),
            (of_raw.bayer, of_raw.depth_m),
            2e-5,
        ),
        "LiDAR 131,072 beams": (lambda weather: tw.LidarWeather(weather, lidar), (cloud.points,), 5e-3),
    }


def times(make: torch.nn.Module, given: tuple[torch.Tensor, ...], device: str, repeats: int) -> dict[str, Any]:
    """Milliseconds of a call, and of a frame in a batch."""
    transform = copy.deepcopy(make).to(device)
    single = tuple(one.to(device) for one in given)
    many = tuple(one.expand(BATCH, *one.shape).contiguous() for one in single)
    seeds = count()

    def call(inputs: tuple[torch.Tensor, ...]) -> None:
        transform(*inputs, seed=next(seeds))
        if device != "cpu":
            torch.cuda.synchronize()

    batch = times_ms(lambda: call(many), max(3, repeats // 4))
    return {"single": times_ms(lambda: call(single), repeats), "batch_ms_a_frame": round(batch["median_ms"] / BATCH, 3)}


def difference(make: torch.nn.Module, given: tuple[torch.Tensor, ...], device: str, same: float) -> dict[str, float]:
    """Of one draw, rendered on the processor and on the device."""
    noise = make.draw(*given[:1], seed=1)  # type: ignore[operator]
    wanted = make(*given, noise=noise).float()
    there = copy.deepcopy(make).to(device)(*(one.to(device) for one in given), noise=noise).cpu().float()
    apart = (there - wanted).abs()
    return {
        "differ": round(float((apart > same).float().mean()), 7),
        "largest_difference": round(float(apart.max()), 7),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=25, help="calls behind each median")
    parser.add_argument("--device", default="cuda")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    name = torch.cuda.get_device_name() if arguments.device == "cuda" else arguments.device
    found: dict[str, Any] = {"machine": machine(), "device": name, "batch": BATCH, "cases": {}}
    for title, (make, given, same) in cases().items():
        for kind, weather in WEATHERS.items():
            transform = make(weather)
            found["cases"][f"{title}, {kind}"] = {
                "device": times(transform, given, arguments.device, arguments.repeats),
                "processor": times(transform, given, "cpu", max(5, arguments.repeats // 4)),
                **difference(transform, given, arguments.device, same),
            }
    hand_over(found, arguments.out)


if __name__ == "__main__":
    main()
