"""Times of rain, snow and fog on one LiDAR frame, against a pass of ``exp`` and ``sqrt`` over it in the same run.

    python benchmarks/bench_lidar.py --out benchmarks/lidar.json
    python benchmarks/bench_lidar.py --quick                         # tries the script, the figures mean nothing

The embedded test track as an Ouster OS1-128 sees it: 131,072 beams (1024 columns) and 262,144 (2048), organised, with
the direction of every beam, so that beams without return (more than half: the sky) are simulated too. ``total`` is the
everyday call: it draws and renders. Set-up and peak memory (Linux only) are measured in fresh processes.

``fresh_rate`` is training: a rate or visibility of its own in each call, in CPU milliseconds of one thread, for all
return modes; the beams without return have no direction there. ``kitti_loader`` reads sweeps of 120,000 points from
``.bin`` files, clear and in weather.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import hand_over, machine, times_ms

import torchweather as tw
from torchweather.scenes import lidar_view, test_track

ROOT = Path(__file__).parents[1]
COLUMNS = (1024, 2048)
MAKE: dict[str, Callable[[Any], tw.weather.Weather]] = {"rain": tw.Rain, "snow": tw.Snow, "fog": tw.Fog}
KNOB = {"rain": 25.0, "snow": 2.0, "fog": 50.0}
DRAWN: dict[str, tw.weather.Weather] = {
    "rain": tw.Rain(rate_mm_per_h=tw.LogUniform(1.0, 50.0)),
    "snow": tw.Snow(rate_mm_per_h=tw.LogUniform(0.25, 3.0)),
    "fog": tw.Fog(mor_m=tw.LogUniform(30.0, 500.0)),
}
WEATHERS = {kind: f"{kind.capitalize()}({intensity})" for kind, intensity in KNOB.items()}
# What the issue asks for, at the larger cloud.
TARGETS = {
    "rain.total_ms": 30.0,
    "snow.total_ms": 30.0,
    "fog.total_ms": 30.0,
    "fresh_rate.strongest_cpu_ms": 19.0,
    "fresh_rate.snow_dual_cpu_ms": 35.0,
    "kitti_loader.rain_cpu_ms": 14.0,
    "setup.first_use_s": 0.3,
    "batch.time_over_that_of_single_frames": 1.1,
}
D34_TABLE_17_S = {"rain": 24.0, "fog": 17.9, "snow": 40.4}

# In a process of its own: what a first call costs, import of torch and of the library apart, and the memory it takes.
COLD = """
import json, time
start = time.perf_counter()
import torch
torch_s = time.perf_counter() - start
start = time.perf_counter()
from torchweather import Lidar, Lidar{kind}, {kind}
library_s = time.perf_counter() - start
points, directions = torch.load({cloud!r})
points = points.expand({batch}, *points.shape).clone()

def peak_mb():
    # Not ru_maxrss, which Linux hands on from the parent process.
    for line in open("/proc/self/status"):
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1e3

open("/proc/self/clear_refs", "w").write("5")  # the peak starts anew
before_mb = peak_mb()
start = time.perf_counter()
sensor = Lidar.preset("ouster-os1-128", columns={columns}, directions=directions, return_mode={mode!r})
transform = Lidar{kind}({weather}, sensor)
construct_s = time.perf_counter() - start
start = time.perf_counter()
noise = transform.draw(points, seed=0)
draw_s = time.perf_counter() - start
start = time.perf_counter()
transform(points, noise)
first_s = time.perf_counter() - start
again = []
for _ in range(3):
    start = time.perf_counter()
    transform(points, noise)
    again.append(time.perf_counter() - start)
print(json.dumps(dict(import_torch_s=torch_s, import_library_s=library_s, construct_s=construct_s, first_draw_s=draw_s,
                      first_render_s=first_s, later_render_s=min(again), before_mb=before_mb,
                      extra_peak_mb=peak_mb() - before_mb)))
"""


def intensities(kind: str, number: int) -> torch.Tensor:
    """As many values of the intensity, all different, around that of the single frame."""
    return KNOB[kind] * (0.6 + 0.8 * torch.arange(1, number + 1) / (number + 1))


def exp_and_sqrt(points: torch.Tensor, repeats: int) -> dict[str, float]:
    # The logarithm keeps exp finite; its time does not depend on it.
    values = points[:, :4].abs().log1p().contiguous()
    return times_ms(lambda: torch.exp(values).sqrt(), repeats)


def frame_times(kind: str, points: torch.Tensor, sensor: tw.Lidar, repeats: int) -> dict[str, Any]:
    """One frame: drawing, rendering, the everyday call, and the call of a simulator."""
    transform = tw.LidarWeather(MAKE[kind](KNOB[kind]), sensor)
    noise = transform.draw(points, seed=1)
    array = points.numpy()
    total = times_ms(lambda: transform(points), repeats)
    kinds = transform.run(points, noise).kind
    assert isinstance(kinds, torch.Tensor)
    return {
        "draw": times_ms(lambda: transform.draw(points, seed=1), repeats),
        "render": times_ms(lambda: transform(points, noise), repeats),
        "total": total,
        "on_numpy": times_ms(lambda: transform.on_numpy(array), repeats),
        "run": times_ms(lambda: transform.run(points, noise), repeats),
        "particles": int((kinds == tw.PointKind.PARTICLE).sum()),
        "times_faster_than_d34": round(D34_TABLE_17_S[kind] * 1e3 / total["median_ms"]),
    }


def new_intensity_times(kind: str, points: torch.Tensor, sensor: tw.Lidar, repeats: int) -> dict[str, float]:
    """The same transform at another rate or visibility: the first call at it solves the table of returns anew."""
    transform = tw.LidarWeather(MAKE[kind](KNOB[kind]), sensor)
    name = MAKE[kind](KNOB[kind]).intensity_name
    buffers = [buffer for buffer, _ in transform.named_buffers() if buffer.endswith(name)]
    noise = transform.draw(points, seed=1)
    transform(points, noise)

    def at(intensity: torch.Tensor) -> float:
        start = time.perf_counter()
        torch.func.functional_call(transform, dict.fromkeys(buffers, intensity), (points, noise))
        return 1e3 * (time.perf_counter() - start)

    pairs = [(at(intensity), at(intensity)) for intensity in intensities(kind, repeats)]
    first_ms, later_ms = (statistics.median(times) for times in zip(*pairs, strict=True))
    return {
        "first_call_ms": round(first_ms, 2),
        "second_call_ms": round(later_ms, 2),
        "extra_ms": round(first_ms - later_ms, 2),
    }


def cpu_ms(call: Callable[[], object], repeats: int) -> dict[str, float]:
    """CPU time of calls on one thread: other processes do not count."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        call()
        times = []
        for _ in range(repeats):
            start = time.process_time()
            call()
            times.append(1e3 * (time.process_time() - start))
    finally:
        torch.set_num_threads(threads)
    return {
        "median_cpu_ms": round(statistics.median(times), 2),
        "min_cpu_ms": round(min(times), 2),
        "repeats": len(times),
    }


def fresh_rates(points: torch.Tensor, sensor: tw.Lidar, repeats: int) -> dict[str, Any]:
    """A rate of its own in each call, in every return mode, and the transform for another weather alone."""
    found: dict[str, Any] = {}
    for mode in ("strongest", "first", "last", "dual"):
        of_mode = replace(sensor, return_mode=mode)
        for kind, make in MAKE.items():
            seeds = iter(range(10_000))
            drawn = tw.LidarWeather(DRAWN[kind], of_mode)
            fixed = tw.LidarWeather(make(KNOB[kind]), of_mode)
            others = iter(intensities(kind, repeats + 1).tolist())
            found.setdefault(mode, {})[kind] = {
                "call": cpu_ms(lambda drawn=drawn, seeds=seeds: drawn(points, seed=next(seeds)), repeats),
                "with_weather": cpu_ms(
                    lambda fixed=fixed, make=make, others=others: fixed.with_weather(make(next(others))), repeats
                ),
            }
    return found


def kitti_loader(repeats: int, points: int = 120_000) -> dict[str, Any]:
    """A ``.bin`` of KITTI's size from its file through ``Compose``, each with a weather of its own."""
    sensor = tw.Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    view = lidar_view(test_track(), sensor)
    cloud = view.points[view.hit][:, :4]
    cloud = cloud.repeat(1 + points // len(cloud), 1)[:points]
    found: dict[str, Any] = {"points": len(cloud)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "000000.bin")
        cloud.numpy().astype(np.float32).tofile(file)

        def clear() -> torch.Tensor:
            return torch.from_numpy(np.fromfile(file, dtype=np.float32).reshape(-1, 4))

        found["clear"] = cpu_ms(clear, repeats)
        for kind, weather in DRAWN.items():
            compose = tw.Compose({"points": tw.LidarWeather(weather.densest(), sensor)}, weather=weather)
            seeds = iter(range(10_000))
            found[kind] = cpu_ms(lambda c=compose, s=seeds: c({"points": clear()}, seed=next(s)), repeats)
    return found


def batch_times(kind: str, points: torch.Tensor, sensor: tw.Lidar, repeats: int, size: int) -> dict[str, Any]:
    """As many frames, each at a rate of its own, in one call and one by one."""
    single = tw.LidarWeather(MAKE[kind](KNOB[kind]), sensor)
    many = tw.LidarWeather(MAKE[kind](intensities(kind, size)), sensor)
    clouds = points.expand(size, *points.shape).clone()
    noise = many.draw(clouds, seed=1)
    alone = {key: value[:1] for key, value in noise.items()}
    render_one = times_ms(lambda: single(clouds[:1], alone), repeats)
    render = times_ms(lambda: many(clouds, noise), repeats)
    total = times_ms(lambda: many(clouds), repeats)
    return {
        "render": render,
        "total": total,
        "render_of_one": render_one,
        "time_over_that_of_single_frames": round(render["median_ms"] / (size * render_one["median_ms"]), 3),
        "frames_per_s": round(1e3 * size / total["median_ms"], 1),
    }


def cold_times(cloud: Path, columns: int, repeats: int, batch: int) -> dict[str, Any]:
    """Set-up and peak memory in fresh processes: each figure the median over them."""
    found: dict[str, Any] = {}
    for name, mode, frames in (
        *((kind, "strongest", 1) for kind in WEATHERS),
        ("snow", "dual", 1),
        ("snow", "strongest", batch),
    ):
        code = COLD.format(
            kind=name.capitalize(), weather=WEATHERS[name], cloud=str(cloud), columns=columns, mode=mode, batch=frames
        )
        runs = []
        for _ in range(repeats):
            done = subprocess.run(
                [sys.executable, "-c", code],
                check=True,
                capture_output=True,
                text=True,
                cwd=ROOT,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
            runs.append(json.loads(done.stdout))
        median = {key: round(statistics.median(run[key] for run in runs), 4) for key in runs[0]}
        # What a first call costs above a later one: the tables, and whatever else is made once, such as numba's import,
        # which the first look at a cloud takes.
        once = max(0.0, median["first_render_s"] - median["later_render_s"])
        median["first_use_s"] = round(median["construct_s"] + median["first_draw_s"] + once, 4)
        key = name + ("" if mode == "strongest" else f"_{mode}") + ("" if frames == 1 else f"_batch_of_{frames}")
        found[key] = median
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=15, help="calls behind each median; 7 or more")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--quick", action="store_true", help="two calls each, on a sixteenth of the columns")
    arguments = parser.parse_args()
    if arguments.repeats < 7:
        parser.error("--repeats: fewer than 7 calls give no median to speak of")
    repeats, cold_repeats, batch, all_columns = arguments.repeats, 5, arguments.batch, COLUMNS
    if arguments.quick:
        repeats, cold_repeats, batch, all_columns = 2, 1, 2, (64, 128)

    host = machine()
    clouds: dict[str, Any] = {}
    fresh: dict[str, Any] = {}
    points, sensor = torch.empty(0), tw.Lidar.preset("ouster-os1-128")
    for columns in all_columns:
        plain = tw.Lidar.preset("ouster-os1-128", columns=columns)
        view = lidar_view(test_track(), plain)
        points, sensor = view.points, replace(plain, directions=view.directions)
        dual = replace(sensor, return_mode="dual")
        fresh = fresh or {"points": len(points), **fresh_rates(points, plain, repeats)}
        clouds[str(len(points))] = {
            "beams_with_return": int(view.hit.sum()),
            "exp_and_sqrt": exp_and_sqrt(points, 3 * repeats),
            **{kind: frame_times(kind, points, sensor, repeats) for kind in WEATHERS},
            "dual": {kind: frame_times(kind, points, dual, repeats) for kind in WEATHERS},
        }
    largest = clouds[str(len(points))]
    new_intensity = {kind: new_intensity_times(kind, points, sensor, repeats) for kind in WEATHERS}
    loader = kitti_loader(repeats, 5000 if arguments.quick else 120_000)
    batches = {kind: batch_times(kind, points, sensor, repeats, batch) for kind in WEATHERS}
    file = Path(f"{arguments.out or 'bench_lidar'}.cloud.pt")
    try:
        torch.save((points, sensor.directions), file)
        setup = cold_times(file.resolve(), all_columns[-1], cold_repeats, batch)
    finally:
        file.unlink(missing_ok=True)
    figures = {
        **{f"{kind}.total_ms": largest[kind]["total"]["median_ms"] for kind in WEATHERS},
        "fresh_rate.strongest_cpu_ms": max(fresh["strongest"][kind]["call"]["median_cpu_ms"] for kind in WEATHERS),
        "fresh_rate.snow_dual_cpu_ms": fresh["dual"]["snow"]["call"]["median_cpu_ms"],
        "kitti_loader.rain_cpu_ms": loader["rain"]["median_cpu_ms"],
        "setup.first_use_s": max(case["first_use_s"] for key, case in setup.items() if key in WEATHERS),
        "batch.time_over_that_of_single_frames": max(
            case["time_over_that_of_single_frames"] for case in batches.values()
        ),
    }
    result = {
        "what": f"LiDAR weather on clouds of {' and '.join(clouds)} beams (Ouster OS1-128), float32",
        "quick": bool(arguments.quick),
        "machine": host,
        "weathers": WEATHERS,
        "d34_table_17_s": D34_TABLE_17_S,
        "clouds": clouds,
        "new_intensity": new_intensity,
        "fresh_rate": fresh,
        "kitti_loader": loader,
        "batch": {"frames": batch, "points": len(points), **batches},
        "setup": setup,
        "summary": {
            name: {"value": round(value, 3), "target_at_most": TARGETS[name]} for name, value in figures.items()
        },
    }
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
