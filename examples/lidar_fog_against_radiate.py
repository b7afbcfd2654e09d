"""Fit a visibility to LiDAR frames recorded in fog (RADIATE), and show what the fit leaves over.

    TORCHWEATHER_REAL_DATA=/data python examples/lidar_fog_against_radiate.py     # /data/radiate_fog
    python examples/lidar_fog_against_radiate.py --data velo_lidar --out fitted --range-at-10-percent 70

There is no clear twin of these frames and no measured visibility. So the fit uses the one thing that fog adds and no
scene has: echoes a few metres ahead in beams that meet nothing else. The number of scattered echoes between
``FOG_FROM_M`` and ``FOG_TO_M`` in beams above the horizon is counted, in the recording and in fog simulated into the
recording's empty beams; ``mor_m`` is where both are equal. It is the only number fitted.

Assumed: the beams without a return are those that the scan pattern has and the file lacks; the fog is the same
everywhere; the sensor is the preset (its range at 10 % and near-range response are generic). Echoes of hedges and wires
count as fog, so the visibility found is a lower bound. The intensities are printed and drawn against range, but not
fitted: surfaces differ more from one range to the next than fog makes them. Writes ``radiate.json``,
``radiate.png``, and views of the first frame and of the same frame with more fog: ``radiate_side.png`` from the side,
``radiate_angles.png`` by azimuth and elevation.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from parts.fog_figure import draw
from parts.fog_scan import (
    FOG_FROM_M,
    FOG_TO_M,
    INTENSITY_EDGES_M,
    RANGE_EDGES_M,
    above_horizon,
    fog_echoes,
    histogram,
    in_fog,
    intensities,
    on_grid,
    weakest_returns_m,
)
from parts.shared import command_line, recordings, write_json
from parts.side_views import write_side_views

import torchweather as tw
from torchweather.io import read_points

PRESET = "velodyne-hdl-32e"
MOR_GRID_M = [60.0 * 1.25**k for k in range(20)]


def visibility(wanted: float, mor_m: Sequence[float], counts: Sequence[float]) -> float:
    """Where the simulated number falls below the recorded one, in the logarithms; infinite where it never does."""
    for low, high, before, after in zip(mor_m, mor_m[1:], counts, counts[1:], strict=False):
        if before >= wanted > after:
            part = math.log((before + 0.5) / (wanted + 0.5)) / math.log((before + 0.5) / (after + 0.5))
            return float(low * (high / low) ** part)
    return math.inf if wanted <= counts[-1] else mor_m[0]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--data", type=Path, help="folder with *.csv: x, y, z, intensity, ring of an HDL-32E")
    parser.add_argument("--out", type=Path, default=Path("radiate"), help="folder to write to")
    parser.add_argument("--range-at-10-percent", type=float, help="of the sensor, m; the preset's by default")
    parser.add_argument("--near-full", type=float, help="where its near-range response is full, m; likewise")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    folder = recordings(arguments.data, "radiate_fog", "velo_lidar")
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        sys.exit(f"{folder}: holds no *.csv")
    sensor = tw.Lidar.preset(PRESET)
    if arguments.range_at_10_percent:
        sensor = replace(sensor, range_at_10_percent_m=arguments.range_at_10_percent)
    if arguments.near_full:
        sensor = replace(sensor, near_full_m=arguments.near_full)

    scans = [on_grid(read_points(path).points, sensor) for path in paths]
    recorded = histogram(scans)
    wanted = fog_echoes(recorded)
    # The recording's own echoes are in both; what the fog adds must equal what was recorded.
    added = []
    for mor_m in MOR_GRID_M:
        foggy = [in_fog(scan, sensor, mor_m, arguments.seed + k) for k, scan in enumerate(scans)]
        added.append(max(fog_echoes(histogram(foggy)) - wanted, 0.0))
    mor_m = visibility(wanted, MOR_GRID_M, added)
    fog = [in_fog(scan, sensor, min(mor_m, 1e4), arguments.seed + k) for k, scan in enumerate(scans)]
    fitted = histogram(fog)
    empty = sum(int(((scan.range_m == 0) & above_horizon(scan)[:, None]).sum()) for scan in scans)
    surfaces = intensities(scans)
    report: dict[str, Any] = {
        "torchweather": tw.__version__,
        "frames": len(scans),
        "range_at_10_percent_m": sensor.range_at_10_percent_m,
        "near_full_m": sensor.near_full_m,
        "empty_beams_above_horizon": empty,
        "recorded_fog_echoes": wanted,
        "mor_m_at_least": min(mor_m, 1e4),
        "simulated_fog_echoes": dict(zip([f"{m:.0f}" for m in MOR_GRID_M], added, strict=True)),
        "range_at_10_percent_of_weakest_returns_m": weakest_returns_m(scans),
        "range_edges_m": RANGE_EDGES_M,
        "recorded": recorded.tolist(),
        "fitted_fog_alone": (fitted - recorded).tolist(),
        "intensity_edges_m": INTENSITY_EDGES_M,
        "intensities": surfaces,
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_json(arguments.out / "radiate.json", report)
    draw(recorded, fitted, MOR_GRID_M, added, report, arguments.out / "radiate.png")
    before, after = (scan.points.reshape(-1, 4) for scan in (scans[0], fog[0]))
    nothing = torch.zeros(len(before), dtype=torch.bool)
    rows = {"recorded": (before, nothing), "and fog, simulated": (after, (after != before).any(-1))}
    write_side_views(before, rows, arguments.out / "radiate_side.png", arguments.out / "radiate_angles.png")

    print(f"{len(scans)} frames, {empty} beams above the horizon without return")
    print(f"scattered echoes, {FOG_FROM_M:g} to {FOG_TO_M:g} m: {wanted:.0f}")
    print(
        f"visibility at which fog gives as many: {mor_m:.0f} m, a lower bound for a sensor with "
        f"{sensor.range_at_10_percent_m:g} m at 10 % and full response from {sensor.near_full_m:g} m"
    )
    needed = report["range_at_10_percent_of_weakest_returns_m"]
    print(f"range at 10 % that 99 % of the returns need: {needed:.0f} m")
    print("range m   returns  mean intensity   scattered echoes: recorded, fog alone")
    for k, (number, mean) in enumerate(surfaces):
        low, high = INTENSITY_EDGES_M[k : k + 2]
        cells = slice(int(2 * low), min(int(2 * high), len(recorded)))
        here, alone = float(recorded[cells].sum()), float((fitted - recorded)[cells].sum())
        print(f"{low:4g}-{high:<4g} {number:8d} {mean:12.1f} {here:22.0f} {alone:10.0f}")
    print(f"written: {arguments.out}/radiate.json, radiate.png, radiate_side.png, radiate_angles.png")


if __name__ == "__main__":
    main()
