"""Hold simulated snow against the labelled falling snow of WADS, beam by beam.

    TORCHWEATHER_REAL_DATA=/data python examples/lidar_snow_against_wads.py     # /data/wads_snow
    python examples/lidar_snow_against_wads.py --data sequences/36 --out compared --rates 0.5 1 2

A frame is taken apart into beams, its snow points are removed, and snow is simulated into what is left, with the same
directions: what the beam saw behind the flake where the recording has it, else nothing. Both are then described by the
same numbers. Nothing is fitted. Writes ``wads.md``, ``wads.json`` and ``wads.png``, and two views of the first frame
and of the same frame in simulated snow: ``wads_side.png`` from the side, ``wads_angles.png`` by azimuth and elevation.

The recording sensor stores two echoes of every beam: the last, and the strongest or, where that is the last, the second
strongest (Hesai, Pandar64 user manual, section 3.1.2.2). ``return_mode="dual"`` gives the last and the strongest alone,
so a flake that is fainter than the object behind it is missing. `LastAndOther` is the recording sensor's rule as a
stage; the tables have both.

A third sensor stands beside the two presets to show what would have to be otherwise: the range at 10 % of the data
sheet (200 m, from memory, unverified) and flakes fainter by the square of 200 m over the 30 m of `pandar64-wads`, so
that a flake alone in its beam is seen as often as before. It is an assumption, not a preset.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from parts.side_views import write_side_views
from torch import Tensor

import torchweather as tw
from torchweather.io import FALLING_SNOW, atomic_write, read_labels, read_points
from torchweather.lidar.scan import empty_beams, recover_ring
from torchweather.stages import Chain, LidarState, Stage

SCANNER = "pandar64-wads"  # whose scan pattern the recording has
DATA_SHEET_RANGE_AT_10_PERCENT_M = 200.0  # Pandar64, from memory (unverified)
ALBEDO = 0.9  # of Snow()
RATES_MM_PER_H = (0.25, 0.5, 1.0, 2.0, 3.0)
RULES = ("strongest and last", "last and strongest other")
RANGE_EDGES_M = (0.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
ELEVATION_EDGES_DEG = (-25.0, -12.0, -8.0, -5.0, -3.0, -1.5, 0.0, 1.5, 3.0, 9.0, 16.0)
# Beams further down that return no object never return snow either: most likely they end on the vehicle.
FREE_ABOVE_DEG = -3.0
SECTORS = 12
HISTOGRAM_EDGES_M = [0.5 * k for k in range(61)]
# Beams of one ring are 0.2 degrees apart, echoes of one beam agree to 1e-4.
AZIMUTH_STEPS_PER_DEG = 1000


@dataclass(frozen=True)
class Case:
    """A sensor and the reflectivity of flakes to simulate with."""

    name: str
    sensor: tw.Lidar
    albedo: float = ALBEDO


def cases() -> list[Case]:
    scanner, plain = (tw.Lidar.preset(name, return_mode="dual") for name in (SCANNER, "velodyne-hdl-64e"))
    far = replace(scanner, range_at_10_percent_m=DATA_SHEET_RANGE_AT_10_PERCENT_M)
    fainter = (far.range_at_10_percent_m / scanner.range_at_10_percent_m) ** 2
    name = f"{SCANNER} with {far.range_at_10_percent_m:g} m at 10 %, flakes {fainter:.0f} times fainter"
    return [Case(SCANNER, scanner), Case("velodyne-hdl-64e", plain), Case(name, far, ALBEDO / fainter)]


@dataclass(frozen=True)
class Beams:
    """Beams of a frame and the two echoes that each of them reports; an empty echo has range 0.

    Args:
        object_m: range of what is behind the snow, ``(N,)``; 0 where there is nothing.
        azimuth_deg: ``(N,)`` from x to y.
        elevation_deg: ``(N,)`` up.
        range_m, intensity: ``(N, 2)``.
        snow: ``(N, 2)`` which echoes are snow.
    """

    object_m: Tensor
    azimuth_deg: Tensor
    elevation_deg: Tensor
    range_m: Tensor
    intensity: Tensor
    snow: Tensor


def azimuth_deg(vectors: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(vectors[:, 1].double(), vectors[:, 0].double()))


def elevation_deg(directions: Tensor) -> Tensor:
    return torch.rad2deg(torch.asin(directions[:, 2].double()))


def beams_of_recording(points: Tensor, snow: Tensor) -> tuple[Beams, Tensor, Tensor]:
    """Beams of a recorded frame, and what to simulate into: a cloud without snow ``(N, 4)``, directions ``(N, 3)``.

    The two echoes of a beam stand up to 64 rows apart: first the last echoes of a firing of all rings, then the
    others. A beam with a single echo has it twice. Of two echoes that are no snow the last counts as the object. Beams
    whose only return was snow, and beams that the scan pattern has and the file lacks, are empty and have a direction.
    """
    scanner = tw.Lidar.preset(SCANNER)
    azimuth = torch.round(azimuth_deg(points) * AZIMUTH_STEPS_PER_DEG).long()
    key = recover_ring(points, scanner) * 1_000_000 + azimuth
    _, beam = torch.unique(key, return_inverse=True)
    count = int(beam.max()) + 1
    rows = torch.arange(len(points))
    last = torch.full((count,), len(points)).scatter_reduce(0, beam, rows, "amin")
    other = torch.full((count,), -1).scatter_reduce(0, beam, rows, "amax")
    echoes = torch.stack([last, other], 1)  # (N, 2)
    range_m = points[:, :3].norm(dim=-1)[echoes]
    flakes = snow[echoes]
    twice = range_m[:, 0] == range_m[:, 1]
    behind = torch.where(~flakes[:, 0], last, other)  # row of the object, where there is one
    empty = flakes.all(1)
    cloud = torch.where(empty[:, None], torch.zeros_like(points[behind]), points[behind])
    along = points[last, :3] / range_m[:, :1]
    lacking = empty_beams(points[last], scanner)[0]
    cloud = torch.cat([cloud, cloud.new_zeros(len(lacking), 4)])
    along = torch.cat([along, lacking])
    single = torch.stack([torch.zeros_like(twice), twice], 1)
    nothing = torch.zeros(len(lacking), 2)
    beams = Beams(
        object_m=cloud[:, :3].norm(dim=-1),
        azimuth_deg=azimuth_deg(along),
        elevation_deg=elevation_deg(along),
        range_m=torch.cat([torch.where(single, 0.0, range_m), nothing]),
        intensity=torch.cat([torch.where(single, 0.0, points[echoes][..., 3]), nothing]),
        snow=torch.cat([flakes & ~single, nothing.bool()]),
    )
    return beams, cloud, along


class LastAndOther(Stage):
    """Detection as the recording sensor does it: the last echo, and the strongest of the others.

    An echo within ``echo_separation`` of a stronger one is part of that one, as in ``Detection``.
    """

    def __init__(self, sensor: tw.Lidar) -> None:
        super().__init__()
        self.sensor = sensor

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        range_m, signal = state.range_m, state.signal
        strength = torch.where(signal >= state.threshold, signal, 0.0)
        near = (state.clear_range_m > 0) & (state.clear_range_m < self.sensor.near_start_m)
        strength[..., 0] = torch.where(near, torch.inf, torch.where(state.clear_range_m > 0, strength[..., 0], 0.0))
        kept = strength.clone()
        for k in range(strength.shape[-1]):
            louder = strength > strength[..., k : k + 1]
            close = (range_m - range_m[..., k : k + 1]).abs() < self.sensor.echo_separation
            kept[..., k] = torch.where((louder & close).any(-1), 0.0, strength[..., k])
        last = torch.where(kept > 0, range_m, 0.0).argmax(-1, keepdim=True)
        others = kept.scatter(-1, last, 0.0)
        other = others.argmax(-1, keepdim=True)
        chosen = torch.cat([last, other], -1)
        there = torch.cat([kept.gather(-1, last), others.gather(-1, other)], -1) > 0
        lost = torch.full_like(state.kind[..., :2], int(tw.PointKind.LOST))
        return replace(
            state,
            range_m=torch.where(there, range_m.gather(-1, chosen), 0.0),
            signal=torch.where(there, signal.gather(-1, chosen), 0.0),
            kind=torch.where(there, state.kind.gather(-1, chosen), lost),
        )


def simulated(cloud: Tensor, along: Tensor, case: Case, rate_mm_per_h: float, seed: int) -> list[Beams]:
    """Snow in a frame, as each of `RULES` reports it: one storm, seen twice."""
    lidar = tw.LidarSnow(tw.Snow(rate_mm_per_h=rate_mm_per_h, albedo=case.albedo), case.sensor)
    noise = lidar.draw(cloud, seed=seed)
    found = []
    for rule in RULES:
        if rule != RULES[0]:
            lidar.chain = Chain({**lidar.chain.stages, "detection": LastAndOther(case.sensor)})
        with torch.no_grad():
            result = lidar.run(cloud, noise, directions=along)
        assert isinstance(result.points, Tensor)
        assert isinstance(result.second, Tensor)
        assert isinstance(result.kind, Tensor)
        assert isinstance(result.second_kind, Tensor)
        both = torch.stack([result.points, result.second], 1)
        kinds = torch.stack([result.kind, result.second_kind], 1)
        there = kinds != tw.PointKind.LOST
        found.append(
            Beams(
                object_m=cloud[:, :3].norm(dim=-1),
                azimuth_deg=azimuth_deg(along),
                elevation_deg=elevation_deg(along),
                range_m=torch.where(there, both[..., :3].norm(dim=-1), 0.0),
                intensity=torch.where(there, both[..., 3], 0.0),
                snow=kinds == tw.PointKind.PARTICLE,
            )
        )
    return found


def joined(frames: Sequence[Beams]) -> Beams:
    names = [field.name for field in fields(Beams)]
    return Beams(**{name: torch.cat([getattr(frame, name) for frame in frames]) for name in names})


def share(part: Tensor, whole: Tensor) -> float:
    return float((part & whole).sum()) / max(int(whole.sum()), 1)


def statistics(beams: Beams) -> dict[str, Any]:
    """What the tables compare; shares 0 to 1, ranges in metres."""
    there, snow = beams.range_m > 0, beams.snow
    reported, snowy = there.any(1), snow.any(1)
    empty = beams.object_m == 0
    single = there.sum(1) == 1
    # A file of the recording sensor has a single echo twice.
    points = 2.0 * int(reported.sum())
    snow_points = float(snow.sum(1).mul(1 + single).sum())
    ranges = beams.range_m[snow]
    bins = torch.bucketize(beams.object_m, torch.tensor(RANGE_EDGES_M[1:]), right=True)
    sectors = ((beams.azimuth_deg + 180.0) * (SECTORS / 360.0)).long().clamp(0, SECTORS - 1)
    levels = torch.bucketize(beams.elevation_deg, torch.tensor(ELEVATION_EDGES_DEG[1:-1]).double())
    quantiles = torch.tensor([0.05, 0.5, 0.95])
    width = 0.5 * max(len(ranges), 1)
    alone = beams.range_m[snow & empty[:, None]]

    def spread(values: Tensor) -> list[float]:
        return [round(float(v), 2) for v in values.double().quantile(quantiles.double())] if len(values) else []

    return {
        "beams with snow": share(snowy, reported),
        "directions with snow only": share(snowy & (snow | ~there).all(1), torch.ones_like(empty)),
        "beams without object that return snow": share(snowy, empty),
        f"the same, above {FREE_ABOVE_DEG:g} degrees": share(snowy, empty & (beams.elevation_deg > FREE_ABOVE_DEG)),
        "points that are snow": snow_points / points,
        "range of snow, 5/50/95 %, m": spread(ranges),
        "range of snow in beams without object, 5/50/95 %, m": spread(alone),
        "snow points at intensity 0": share(beams.intensity < 1, snow),
        "beams with two snow echoes": share(snow.all(1), reported),
        "objects not reported": share(~(there & ~snow).any(1), ~empty),
        "snow, given the object's range": [
            share(snowy, (bins == k) & ~empty) for k in range(len(RANGE_EDGES_M) - 1)
        ],
        "histogram": (torch.histogram(ranges.float(), torch.tensor(HISTOGRAM_EDGES_M)).hist / width).tolist(),
        "snow without object, by elevation": [
            share(snowy, (levels == k) & empty) for k in range(len(ELEVATION_EDGES_DEG) - 1)
        ],
        "snow by azimuth sector": [share(snowy, (sectors == k) & reported) for k in range(SECTORS)],
    }  # fmt: skip


def rate_that_matches(rates: Sequence[float], values: Sequence[float], wanted: float) -> str:
    """Rate at which a simulated number crosses the recorded one, between the simulated rates in their logarithm."""
    for low, high, before, after in zip(rates, rates[1:], values, values[1:], strict=False):
        if min(before, after) <= wanted <= max(before, after) and before != after:
            part = (wanted - before) / (after - before)
            return f"{low * (high / low) ** part:.2g}"
    rising = values[-1] >= values[0]
    below = wanted < min(values)
    return f"< {rates[0]:g}" if below == rising else f"> {rates[-1]:g}"


def rows_of(found: dict[str, Any]) -> dict[str, float]:
    """The single numbers of `statistics`, by the name of their row."""
    flat: dict[str, float] = {}
    for name, value in found.items():
        if name.startswith("range of snow"):
            base = name.partition(", 5/50/95")[0]
            flat |= {f"{base}, {q} %, m": v for q, v in zip((5, 50, 95), value or [math.nan] * 3, strict=True)}
        elif name in ("snow without object, by elevation", "histogram"):
            continue
        elif name == "snow, given the object's range":
            edges = pairwise(RANGE_EDGES_M)
            flat |= {f"snow, object at {a:g} to {b:g} m": v for (a, b), v in zip(edges, value, strict=True)}
        elif name == "snow by azimuth sector":
            flat["sectors of 30 degrees: most over least"] = max(value) / max(min(value), 1e-9)
        else:
            flat[name] = value
    return flat


def table(recorded: dict[str, Any], runs: dict[float, dict[str, Any]]) -> str:
    """Markdown: a row for each number, a column for each rate, and the rate that matches."""
    rates = sorted(runs)
    columns = [rows_of(runs[rate]) for rate in rates]
    lines = [
        "| | recorded | " + " | ".join(f"{rate:g}" for rate in rates) + " | rate that matches, mm/h |",
        "| --- " * (len(rates) + 3) + "|",
    ]
    for name, wanted in rows_of(recorded).items():
        values = [column[name] for column in columns]
        digits = "{:.1f}" if ", m" in name or "over least" in name else "{:.3f}"
        told = (
            "" if name == "objects not reported" or "over least" in name else rate_that_matches(rates, values, wanted)
        )
        seen = "unknown" if name == "objects not reported" else digits.format(wanted)
        lines.append(f"| {name} | {seen} | " + " | ".join(digits.format(v) for v in values) + f" | {told} |")
    return "\n".join(lines)


def draw(found: dict[str, Any], runs: Mapping[tuple[str, str, float], Any], path: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(15, 8.5), layout="constrained")
    rates = sorted({rate for _, _, rate in runs})
    colours = [plt.get_cmap("viridis")(0.9 * k / max(len(rates) - 1, 1)) for k in range(len(rates))]
    middles = [0.5 * (a + b) for a, b in pairwise(RANGE_EDGES_M)]
    names = list(dict.fromkeys(name for name, _, _ in runs))
    for axis, name in zip(axes[0], names, strict=True):
        for colour, rate in zip(colours, rates, strict=True):
            for rule, style in zip(RULES, ("-", ":"), strict=True):
                values = runs[name, rule, rate]["snow, given the object's range"]
                label = f"{rate:g} mm/h" if style == "-" else None
                axis.plot(middles, [max(v, 1e-4) for v in values], style, color=colour, label=label)
        axis.plot(middles, found["snow, given the object's range"], "ko", label="WADS")
        axis.set(xlabel="range of the object in m", ylabel="share of beams with a snow echo", yscale="log")
        axis.set_ylim(1e-3, 1.2)
        axis.set_title(
            name.replace(" with ", "\nwith ") + "\nsolid: strongest and last; dotted: last and strongest other", size=9
        )
    axes[0, 0].legend(fontsize=8)

    ranges, levels, sectors = axes[1]
    for axis, key, edges in (
        (ranges, "histogram", HISTOGRAM_EDGES_M),
        (levels, "snow without object, by elevation", ELEVATION_EDGES_DEG),
        (sectors, "snow by azimuth sector", [-180.0 + 360.0 / SECTORS * k for k in range(SECTORS + 1)]),
    ):
        axis.stairs(found[key], edges, color="k", fill=True, alpha=0.25, label="WADS")
        for colour, rate in zip(colours, rates, strict=True):
            axis.stairs(runs[names[-1], RULES[0], rate][key], edges, color=colour, label=f"{rate:g} mm/h")
        axis.set_title("lines: " + names[-1] + ",\nstrongest and last", size=9)
    ranges.set(xlabel="range of the snow echo in m", ylabel="share per metre", xlim=(0, 25))
    levels.set(xlabel="elevation of the beam in degrees", ylabel="share of beams without object that return snow")
    sectors.set(xlabel="azimuth of the beam in degrees (x to y)", ylabel="share of reporting beams with a snow echo")
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=100)
    plt.close(figure)


def write_views(points: Tensor, snow: Tensor, folder: Path, seed: int) -> None:
    """A recorded frame ``(N, 4)`` from the side, and snow of 1 mm/h in the same frame without its flakes."""
    clear = points[~snow]
    rows = np.unique(clear.numpy(), axis=0, return_index=True)[1]  # a beam with a single echo has it twice
    clear = clear[np.sort(rows)]
    sensor = tw.Lidar.preset(SCANNER, return_mode="strongest")
    simulation = tw.LidarSnow(tw.Snow(rate_mm_per_h=1.0), sensor, complete_scan=True)
    with torch.no_grad():
        result = simulation.run(clear, simulation.draw(clear, seed=seed))
    assert isinstance(result.points, Tensor)
    assert isinstance(result.kind, Tensor)
    clouds = {
        "recorded": (points, snow),
        "simulated, 1 mm/h": (result.points, result.kind == tw.PointKind.PARTICLE),
    }
    write_side_views(clear, clouds, folder / "wads_side.png", folder / "wads_angles.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with velodyne/*.bin and labels/*.label")
    parser.add_argument("--out", type=Path, default=Path("wads"), help="folder to write to")
    parser.add_argument("--rates", type=float, nargs="+", default=list(RATES_MM_PER_H), help="melted mm/h")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.data is None:
        root = os.environ.get("TORCHWEATHER_REAL_DATA")
        if not root:
            sys.exit("no recording: give --data FOLDER, or set TORCHWEATHER_REAL_DATA to a folder with wads_snow/")
        arguments.data = Path(root) / "wads_snow"
    clouds = sorted((arguments.data / "velodyne").glob("*.bin"))
    if not clouds:
        sys.exit(f"{arguments.data}: holds no velodyne/*.bin")
    rates = sorted(arguments.rates)

    frames = []
    for path in clouds:
        points = read_points(path, format="kitti").points
        labels = read_labels(arguments.data / "labels" / f"{path.stem}.label", len(points))
        frames.append(beams_of_recording(points, labels.classes == FALLING_SNOW))
        if path == clouds[0]:
            first = points, labels.classes == FALLING_SNOW
    recorded = joined([beams for beams, _, _ in frames])
    found = statistics(recorded)
    each = {path.stem: statistics(beams) for path, (beams, _, _) in zip(clouds, frames, strict=True)}
    print(f"{len(frames)} frames, {len(recorded.object_m)} directions")

    runs: dict[tuple[str, str, float], dict[str, Any]] = {}
    floored: dict[str, float] = {}
    for case in cases():
        seen = sum(int((cloud[:, :3] != 0).any(1).sum()) for _, cloud, _ in frames)
        dry = tw.LidarSnow(tw.Snow(rate_mm_per_h=0), case.sensor)
        floored[case.name] = sum(int(dry.run(cloud).floored_points) for _, cloud, _ in frames) / seen
        for rate in rates:
            # One seed for each frame: the same storm for every sensor and rate.
            drawn = [
                simulated(cloud, along, case, rate, arguments.seed + k) for k, (_, cloud, along) in enumerate(frames)
            ]
            for rule, beams in zip(RULES, zip(*drawn, strict=True), strict=True):
                runs[case.name, rule, rate] = statistics(joined(beams))

    arguments.out.mkdir(parents=True, exist_ok=True)
    text = ""
    for case in cases():
        text += f"\n## {case.name}\n\nObjects whose intensity says less than the threshold: {floored[case.name]:.1%}.\n"
        for rule in RULES:
            text += f"\n### Reported: {rule}\n\n"
            text += table(found, {rate: runs[case.name, rule, rate] for rate in rates}) + "\n"
    with atomic_write(arguments.out / "wads.md") as unfinished:
        unfinished.write_text(text.lstrip(), encoding="utf-8")
    report = {
        "torchweather": tw.__version__,
        "seed": arguments.seed,
        "range edges, m": RANGE_EDGES_M,
        "elevation edges, degrees": ELEVATION_EDGES_DEG,
        "recorded": found,
        "recorded, each frame": each,
        "objects below the threshold": floored,
        "simulated": [
            {"sensor": name, "reported": rule, "rate_mm_per_h": rate} | values
            for (name, rule, rate), values in runs.items()
        ],
    }
    with atomic_write(arguments.out / "wads.json") as unfinished:
        unfinished.write_text(json.dumps(_rounded(report), indent=1), encoding="utf-8")
    draw(found, runs, arguments.out / "wads.png")
    write_views(*first, arguments.out, arguments.seed)
    print(text)
    print(f"written: {arguments.out}/wads.md, wads.json, wads.png, wads_side.png, wads_angles.png")


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 5)
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


if __name__ == "__main__":
    main()
