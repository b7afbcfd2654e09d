"""Statistics of beams with snow, and tables of the recorded against the simulated ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from parts.snow_beams import Beams
from torch import Tensor

RANGE_EDGES_M = (0.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
ELEVATION_EDGES_DEG = (-25.0, -12.0, -8.0, -5.0, -3.0, -1.5, 0.0, 1.5, 3.0, 9.0, 16.0)
# Beams further down that return no object never return snow either: most likely they end on the vehicle.
FREE_ABOVE_DEG = -3.0
SECTORS = 12
HISTOGRAM_EDGES_M = [0.5 * k for k in range(61)]


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
