"""Recorded snow by azimuth and elevation against the snow model with and without the effects of its structure.

    TORCHWEATHER_REAL_DATA=... python benchmarks/snow_structure.py --out benchmarks/snow_structure.json

Fits density over azimuth and elevation, sizes, backscatter and sharing to the first frame of ``wads_snow`` and reports
on the others. Counted is the share of beams with a flake among those that see no object behind it and look more than 3
degrees below the horizon at most (lower ones end on the vehicle). Bins, estimators and the bar of 20 % were fixed
before the frames of the report were read. The error of a share is that of its count, with the clumping of the recorded
flakes (``snow_fit.overdispersion``, from the first frame); what could have been seen is twice of it.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from measure import hand_over, machine
from numpy.typing import NDArray
from snow_fit import (
    RANGE_EDGES_M,
    Density,
    Shared,
    Sizes,
    Snow,
    counted_shared,
    fitted_density,
    fitted_sizes,
    matching_rate,
    overdispersion,
    shares,
)

import torchweather as tw
from torchweather.lidar.returns.beam_particles import SIZE_KNOTS_MM

EXAMPLES = Path(__file__).parents[1] / "examples"
PRESET = "pandar64-wads"
RANGE_AT_10_PERCENT_M = 200.0  # Hesai's data sheet, from memory (unverified)
RATE_MM_PER_H = 3.0  # sizes are over those of this rate; the snowfall is not known
FREE_ABOVE_DEG = -3.0
SECTORS_DEG = tuple(-180.0 + 45.0 * k - 22.5 for k in range(1, 9))  # their lower ends; the last wraps
ELEVATIONS_DEG = (-3.0, -1.5, 0.0, 1.5, 3.0, 9.0, 16.0)
BAR = 0.2
SCALINGS, DAMPED = 6, 0.8  # steps to the recorded share, and the power of each
SEEDS = tuple(range(1, 7))


def example() -> ModuleType:
    """The part of the examples that takes a recorded frame apart into beams."""
    sys.path.insert(0, str(EXAMPLES))
    try:
        return importlib.import_module("parts.snow_beams")
    finally:
        sys.path.remove(str(EXAMPLES))


def snow_of(beams: Any, snow: torch.Tensor, range_m: torch.Tensor) -> Snow:
    """The free beams of a frame with recorded or simulated flakes ``(N, 2)``."""
    free = (beams.object_m == 0) & (beams.elevation_deg > FREE_ABOVE_DEG)
    elevations = torch.tensor(tw.Lidar.preset(PRESET).elevations_deg, dtype=torch.float64)
    ring = (beams.elevation_deg[free, None] - elevations).abs().argmin(1)
    return Snow(
        np.radians(beams.azimuth_deg[free].numpy()),
        np.radians(beams.elevation_deg[free].numpy()),
        ring.numpy(),
        snow[free].any(1).numpy(),
        torch.where(snow, range_m, 0.0)[free].double().numpy(),
    )


def simulated(frame: tuple[Any, ...], weather: tw.Snow, sensor: tw.Lidar, effects: Sequence[Any], seed: int) -> Snow:
    """Snow of the model in the free beams of a recorded frame."""
    beams, cloud, along = frame
    lidar = tw.LidarSnow(weather, sensor, effects=effects)
    with torch.no_grad():
        result = lidar.run(cloud, lidar.draw(cloud, seed=seed), directions=along)
    both = torch.stack([result.points, result.second], 1)[..., :3].norm(dim=-1)
    kinds = torch.stack([result.kind, result.second_kind], 1)
    return snow_of(beams, kinds == tw.PointKind.PARTICLE, both)


def joined(parts: Sequence[Snow]) -> Snow:
    """Beams of several frames."""
    return Snow(*(np.concatenate([getattr(one, name) for one in parts]) for name in Snow.__dataclass_fields__))


def by_azimuth(snow: Snow) -> list[tuple[int, float]]:
    """Beams and share with a flake in eight sectors; the last is to the rear."""
    turned = (np.degrees(snow.azimuth_rad) - SECTORS_DEG[0]) % 360.0
    return shares(snow.flake, turned, tuple(45.0 * k for k in range(9)))


def by_elevation(snow: Snow) -> list[tuple[int, float]]:
    return shares(snow.flake, np.degrees(snow.elevation_rad), ELEVATIONS_DEG)


def rows(
    recorded: Snow, models: dict[str, list[Snow]], clumping: float, first: Snow
) -> dict[str, list[dict[str, Any]]]:
    """Each bin: beams, recorded share, its error, what could have been seen, and the share of each model."""
    found: dict[str, list[dict[str, Any]]] = {}
    for name, count in (("azimuth", by_azimuth), ("elevation", by_elevation)):
        simulated_shares = {key: count(joined(parts)) for key, parts in models.items()} | {"first": count(first)}
        middles = (
            [f"{math.remainder(low + 22.5, 360.0):g}" for low in SECTORS_DEG]
            if name == "azimuth"
            else [f"{a:g} to {b:g}" for a, b in pairwise(ELEVATIONS_DEG)]
        )
        found[name] = []
        for place, (beams, share) in enumerate(count(recorded)):
            error = math.sqrt(clumping * share * (1.0 - share) / max(beams, 1)) if beams else math.nan
            found[name].append(
                {
                    "bin": middles[place],
                    "beams": beams,
                    "recorded": share,
                    "error": error,
                    "seen_from": 2.0 * error / share if share else math.inf,
                    **{key: values[place][1] for key, values in simulated_shares.items()},
                }
            )
    return found


def quantiles(snow: Snow) -> list[float]:
    values: NDArray[np.float64] = snow.ranges_m[snow.ranges_m > 0]
    return [float(one) for one in np.quantile(values, [0.05, 0.5, 0.95])]


def effects_of(density: Density, sizes: Sizes, shared: Shared) -> list[dict[str, Any]]:
    """The fitted effects, as a recipe holds them."""
    factors = {f"factor_{knot:g}mm": one for knot, one in zip(SIZE_KNOTS_MM, sizes.factors, strict=True)}
    found: list[dict[str, Any]] = [
        {"effect": "lidar.particle_density_azimuth", **density.azimuth},
        {"effect": "lidar.particle_density_elevation", **density.elevation},
        {"effect": "lidar.particle_sizes", **factors},
        {"effect": "lidar.particle_backscatter", "gain_db": sizes.gain_db},
        {"effect": "lidar.shared_particles", "share": min(max(shared.share, 0.0), 1.0)},
    ]
    return found


def matched(
    sizes: Sizes,
    effects: Callable[[Sizes], list[dict[str, Any]]],
    frame: tuple[Any, ...],
    first: Snow,
    weather: tw.Snow,
    sensor: tw.Lidar,
) -> Sizes:
    """Sizes with factors scaled so that the model, whose pulses add, gives the recorded share, and chi-square anew."""
    wanted = -math.log1p(-float(first.flake.mean()))
    for seed in range(1, SCALINGS + 1):
        found = simulated(frame, weather, sensor, effects(sizes), seed=seed)
        more = (wanted / -math.log1p(-min(float(found.flake.mean()), 0.999))) ** DAMPED
        sizes = replace(sizes, factors=tuple(min(one * more, 100.0) for one in sizes.factors))
    counts, _ = np.histogram(first.ranges_m[first.ranges_m > 0], RANGE_EDGES_M)
    runs = [simulated(frame, weather, sensor, effects(sizes), seed=seed) for seed in SEEDS[:2]]
    seen = [np.histogram(one.ranges_m[one.ranges_m > 0], RANGE_EDGES_M)[0] for one in runs]
    return replace(sizes, chi2=float(((np.mean(seen, 0) - counts) ** 2 / (counts + 1.0)).sum()))


def report_of(folder: Path) -> dict[str, Any]:
    """Everything that the page shows."""
    module = example()
    frames = []
    for path in sorted((folder / "velodyne").glob("*.bin")):
        frames.append(module.beams_of_recording(*module.read_frame(path)))
    recorded = [snow_of(beams, beams.snow, beams.range_m) for beams, _, _ in frames]
    first, others = recorded[0], recorded[1:]
    plain_sensor = tw.Lidar.preset(PRESET)
    sensor = replace(plain_sensor, range_at_10_percent_m=RANGE_AT_10_PERCENT_M)
    weather = tw.Snow(rate_mm_per_h=RATE_MM_PER_H)

    density = fitted_density(first)
    clumping = overdispersion(first, density.of(first))
    sharing = [counted_shared(first, sensor), *(counted_shared(one, sensor) for one in others)]
    candidates = fitted_sizes(first, density, weather, sensor)

    def fitted(one: Sizes) -> list[dict[str, Any]]:
        return effects_of(density, one, sharing[0])

    def without_direction(one: Sizes) -> list[dict[str, Any]]:
        return [effect for effect in fitted(one) if "density" not in effect["effect"]]

    tried = [matched(one, fitted, frames[0], first, weather, sensor) for one in candidates]
    sizes = min(tried, key=lambda one: one.chi2)
    effects = fitted(sizes)
    alike = without_direction(matched(sizes, without_direction, frames[0], first, weather, sensor))
    plain_rate = matching_rate(tw.Snow(rate_mm_per_h=1.0), plain_sensor, float(first.flake.mean()))
    models: dict[str, tuple[tw.Snow, tw.Lidar, Sequence[Any]]] = {
        "preset": (tw.Snow(rate_mm_per_h=plain_rate), plain_sensor, ()),
        "alike": (weather, sensor, alike),
        "fitted": (weather, sensor, effects),
    }
    runs = {
        name: [[simulated(frame, *model, seed=100 * seed + k) for seed in SEEDS] for k, frame in enumerate(frames)]
        for name, model in models.items()
    }
    later = {name: [one for frame in run[1:] for one in frame] for name, run in runs.items()}
    report: dict[str, Any] = {
        "fit": {
            "density": asdict(density),
            "clumping": clumping,
            "sizes": asdict(sizes),
            "gains": [asdict(one) for one in tried],
            "effects": effects,
            "preset_rate_mm_per_h": plain_rate,
        },
        "shared": [{**asdict(one), "share": one.share, "error": one.error} for one in sharing],
        "frames_fitted": rows(first, {name: run[0] for name, run in runs.items()}, clumping, first),
        "frames_reported": [
            rows(one, {name: run[k] for name, run in runs.items()}, clumping, first) for k, one in enumerate(others, 1)
        ],
        "frames_together": rows(joined(others), later, clumping, first),
        "range_edges_m": RANGE_EDGES_M,
        "ranges_m": {
            "recorded": quantiles(joined(others)),
            **{name: quantiles(joined(run)) for name, run in later.items()},
        },
    }
    report["within"] = {
        axis: {
            name: [within(one[axis], name) for one in (report["frames_reported"] + [report["frames_together"]])]
            for name in (*models, "first")
        }
        for axis in ("azimuth", "elevation")
    }
    return report


def rounded(value: Any) -> Any:
    """Numbers with five digits."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    return [rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


def within(bins: Sequence[dict[str, Any]], model: str) -> list[int]:
    """Bins in which a model is within the bar of the recording, and all bins."""
    return [sum(abs(one[model] - one["recorded"]) <= BAR * one["recorded"] for one in bins), len(bins)]


COLUMNS = {"preset": "preset, one rate", "alike": "fitted, alike all around", "fitted": "fitted", "first": "frame 1"}


def table(bins: Sequence[dict[str, Any]], axis: str) -> list[str]:
    """Rows of the page: shares in percent, and the fitted model over the recording."""
    names = " | ".join(COLUMNS.values())
    lines = [f"| {axis}, degrees | beams | recorded, % | could be seen from | {names} | fitted / recorded |"]
    lines.append("| --- " * (6 + len(COLUMNS) - 1) + "|")
    for one in bins:
        shown = " | ".join(f"{100.0 * one[key]:.1f}" for key in COLUMNS)
        ratio = one["fitted"] / one["recorded"] if one["recorded"] else math.inf
        seen = f"{100.0 * one['seen_from']:.0f} %" if math.isfinite(one["seen_from"]) else "–"
        error = f"{100.0 * one['recorded']:.1f} ± {100.0 * one['error']:.1f}"
        lines.append(f"| {one['bin']} | {one['beams']} | {error} | {seen} | {shown} | {ratio:.2f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with velodyne/*.bin and labels/*.label")
    parser.add_argument("--out", type=Path, help="JSON to write")
    arguments = parser.parse_args()
    if arguments.data is None:
        root = os.environ.get("TORCHWEATHER_REAL_DATA")
        if not root:
            sys.exit("no recording: give --data FOLDER, or set TORCHWEATHER_REAL_DATA to a folder with wads_snow/")
        arguments.data = Path(root) / "wads_snow"
    torch.set_num_threads(1)
    report = {"machine": machine(), **rounded(report_of(arguments.data))}
    hand_over(report, arguments.out)
    for part in ("frames_together", "frames_fitted"):
        for axis, bins in report[part].items():
            print(part, *table(bins, axis), "", sep="\n")
    print(json.dumps({"fit": report["fit"], "within": report["within"], "shared": report["shared"]}, indent=1))


if __name__ == "__main__":
    main()
