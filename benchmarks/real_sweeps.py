"""Completed sweeps of KITTI: beams appended, where they end, flakes under the road, time.

    TORCHWEATHER_REAL_DATA=... python benchmarks/real_sweeps.py --out benchmarks/real_sweeps.json

Snow of 1 mm/h on 13 sweeps of a Velodyne HDL-64E, ``complete_scan=True``. The ground is a plane through each sweep's
low points, fitted here, so that the measure is not the library's. ``--before`` gives the file of an older version of
the library (this script run with that version), ``--page`` writes docs/sweep-figures.md from the JSON, ``--check``
exits with 1 where the page does not say what the JSON says.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import hand_over, machine

import torchweather as tw
from torchweather.datasets import read_kitti_points
from torchweather.lidar.sweep.completion import complete_scan
from torchweather.stages import PointKind

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "sweep-figures.md"
RINGS, COLUMNS = 64, 2155
DEEP_M = 0.3


def plane_through_the_road(points: np.ndarray) -> np.ndarray:
    """``z = a + b x + c y`` through low points within 30 m, three times over with the farthest left out."""
    flat = np.hypot(points[:, 0], points[:, 1])
    low = points[(flat > 3) & (flat < 30) & (points[:, 2] < -1.2) & (points[:, 2] > -2.6)]
    plane = np.array([np.median(low[:, 2]), 0.0, 0.0])
    for within in (0.4, 0.25, 0.15, 0.15):
        place = np.stack([np.ones(len(low)), low[:, 0], low[:, 1]], -1)
        near = np.abs(low[:, 2] - place @ plane) < within
        plane = np.linalg.lstsq(place[near], low[near, 2], rcond=None)[0]
    return plane


def measured(path: Path) -> dict[str, Any]:
    cloud = read_kitti_points(path)
    sensor = tw.Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    snow = tw.LidarSnow(tw.Snow(rate_mm_per_h=1.0), sensor, complete_scan=True)
    noise = snow.draw(cloud, seed=1)
    result = snow.run(cloud, noise)
    times = []
    for _ in range(3):
        started = time.perf_counter()
        complete_scan(cloud, sensor)
        times.append(1e3 * (time.perf_counter() - started))
    flakes = result.points[result.kind == PointKind.PARTICLE][:, :3].double().numpy()
    a, b, c = plane_through_the_road(cloud.numpy())
    depth_m = a + b * flakes[:, 0] + c * flakes[:, 1] - flakes[:, 2]
    appended = len(result.kind) - len(cloud)
    found: dict[str, Any] = {
        "returns": len(cloud),
        "missing": RINGS * COLUMNS - len(cloud),
        "appended": appended,
        "beams_over_turn": round((len(cloud) + appended) / (RINGS * COLUMNS), 4),
        "flakes": len(flakes),
        "flakes_under_the_road": int((depth_m > DEEP_M).sum()),
        "beams_ms": round(min(times), 1),
    }
    counts = getattr(result, "beam_end_counts", None)
    if counts is not None:
        names = ("return", "sky", "ground", "own_vehicle", "obstacle", "unknown")
        found["ends"] = dict(zip(names, counts.tolist(), strict=True))
    return found


def page(found: dict[str, Any]) -> str:
    rows = []
    for name, sweep in found["sweeps"].items():
        before, ends = found["before"][name], sweep["ends"]
        places = [str(ends[place]) for place in ("sky", "ground", "own_vehicle", "obstacle")]
        counts = [str(sweep["missing"]), str(before["appended"]), str(sweep["appended"])]
        under = [f"{one['flakes_under_the_road']} of {one['flakes']}" for one in (before, sweep)]
        rows.append([name, *counts, *places, *under])
    header = ["sweep", "missing", "added before", "added", "sky", "ground", "own car", "obstacle"]
    header += ["flakes under the road before", "now"]
    table = "\n".join(f"| {' | '.join(row)} |" for row in [header, ["---"] * len(header), *rows])
    old, new = (
        [statistics.median(sweep[key] for sweep in found[which].values()) for key in ("appended", "beams_over_turn")]
        for which in ("before", "sweeps")
    )
    missing = statistics.median(sweep["missing"] for sweep in found["sweeps"].values())
    ms = statistics.median(sweep["beams_ms"] for sweep in found["sweeps"].values())
    return f"""# How well is a sweep completed?

Thirteen sweeps of KITTI (Velodyne HDL-64E), which cannot be shipped, in snow of 1 mm/h with `complete_scan=True`.
`python benchmarks/real_sweeps.py --page` makes this page. "Missing" is {RINGS} rings times {COLUMNS} columns less the
returns; the motor's speed makes it {RINGS} times 2151 to 2168. "Under the road" is more than {DEEP_M} m below a plane
fitted to the road.

{table}

In the median {missing:.0f} beams are missing; {old[0]:.0f} were added before and {new[0]:.0f} are now. Returns and
added beams are {new[1]:.3f} of a turn, {old[1]:.3f} before. Most missing beams end on the car that carries the sensor:
about the same number in every sweep, because it is the same car. Ends are inferred, not measured.
Completing takes {ms:.0f} ms a sweep on one thread.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--before", type=Path, help="JSON file of an older version, or of a run with --before")
    parser.add_argument("--page", action="store_true", help="only write the page from the JSON beside this script")
    parser.add_argument("--check", action="store_true", help="only compare the page with that JSON")
    arguments = parser.parse_args()
    if arguments.page or arguments.check:
        text = page(json.loads((HERE / "real_sweeps.json").read_text(encoding="utf-8")))
        if arguments.check:
            return int(PAGE.read_text(encoding="utf-8") != text)
        PAGE.write_text(text, encoding="utf-8")
        return 0
    torch.set_num_threads(1)
    root = Path(os.environ["TORCHWEATHER_REAL_DATA"]) / "kitti_13" / "velodyne"
    sweeps = {path.stem: measured(path) for path in sorted(root.glob("*.bin"))}
    result = {"what": " ".join((__doc__ or "").split()), "machine": machine(), "sweeps": sweeps}
    if arguments.before is not None:
        older = json.loads(arguments.before.read_text(encoding="utf-8"))
        result["before"] = older.get("before", older["sweeps"])
    hand_over(result, arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
