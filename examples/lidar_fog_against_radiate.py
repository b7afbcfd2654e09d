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

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import torch
from parts.side_views import write_side_views
from torch import Tensor

import torchweather as tw
from torchweather.io import atomic_write, read_points
from torchweather.lidar import beam_ends
from torchweather.lidar.scan import recover_ring, scan_directions

PRESET = "velodyne-hdl-32e"
FOG_FROM_M, FOG_TO_M = 2.0, 6.0
HORIZON_DEG = 1.0  # rings above: no road
OWN_VEHICLE_M = 2.0
# A surface fills neighbouring cells of the range image at one range; fog does not.
SAME_SURFACE_M = 0.3
NEIGHBOURS_OF_A_SURFACE = 3
MOR_GRID_M = [60.0 * 1.25**k for k in range(20)]
RANGE_EDGES_M = [0.5 * k for k in range(81)]
INTENSITY_EDGES_M = [2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 25.0, 30.0, 40.0]
RETROREFLECTIVE = 100.0  # Velodyne: above 100 of 255


@dataclass(frozen=True)
class Scan:
    """A frame on the sensor's grid.

    Args:
        points: ``(rings, columns, 4)``; a cell without return has range 0.
        directions: ``(rings, columns, 3)``.
    """

    points: Tensor
    directions: Tensor

    @property
    def range_m(self) -> Tensor:
        found: Tensor = self.points[..., :3].norm(dim=-1)
        return found


def on_grid(points: Tensor, sensor: tw.Lidar) -> Scan:
    """The frame as a range image; where two points fall into one cell, one of them stays."""
    assert sensor.elevations_deg is not None
    assert sensor.columns is not None
    rings, columns = len(sensor.elevations_deg), sensor.columns
    along = scan_directions(sensor).reshape(rings, columns, 3)
    first = torch.atan2(along[:, 0, 1], along[:, 0, 0])  # azimuth of each ring's column 0
    step = torch.atan2(along[:, 1, 1], along[:, 1, 0]) - first
    step = torch.remainder(step + math.pi, 2 * math.pi) - math.pi
    ring = recover_ring(points, sensor)
    azimuth = torch.atan2(points[:, 1], points[:, 0])
    column = torch.round((azimuth - first[ring]) / step[ring]).long() % columns
    grid = torch.zeros(rings, columns, 4)
    grid[ring, column] = points[:, :4]
    return Scan(grid, along)


def scattered(range_m: Tensor) -> Tensor:
    """Echoes that are part of no surface, ``(rings, columns)``."""
    near = torch.zeros_like(range_m)
    for rows, columns in ((0, 1), (0, -1), (0, 2), (0, -2), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        other = range_m.roll((rows, columns), (0, 1))
        if rows:  # no ring beyond the ends
            other[0 if rows > 0 else -1] = 0.0
        near += (other > 0) & ((other - range_m).abs() < SAME_SURFACE_M)
    return (range_m > 0) & (near < NEIGHBOURS_OF_A_SURFACE)


def above_horizon(scan: Scan) -> Tensor:
    return scan.directions[:, 0, 2] > math.sin(math.radians(HORIZON_DEG))


def histogram(scans: Sequence[Scan]) -> Tensor:
    """Scattered echoes above the horizon, by range."""
    found = [scan.range_m[scattered(scan.range_m) & above_horizon(scan)[:, None]] for scan in scans]
    return torch.histogram(torch.cat(found), torch.tensor(RANGE_EDGES_M)).hist


def in_fog(scan: Scan, sensor: tw.Lidar, mor_m: float, seed: int) -> Scan:
    """Fog in the empty beams, up to where they end; what the frame has was measured in the fog already and stays."""
    lidar = tw.LidarFog(tw.Fog(mor_m=mor_m), sensor)
    empty = scan.range_m == 0
    directions = scan.directions[empty]
    cloud = torch.zeros(len(directions), 4)
    returns = scan.points[~empty][:, :3].numpy()
    reach_m = torch.from_numpy(beam_ends(returns, directions.numpy(), sensor.max_range_m).distance_m).float()
    with torch.no_grad():
        foggy = lidar(cloud, lidar.draw(cloud, seed=seed), directions=directions, reach_m=reach_m)
    assert isinstance(foggy, Tensor)
    points = scan.points.clone()
    points[empty] = foggy
    return replace(scan, points=points)


def fog_echoes(counts: Tensor) -> float:
    middles = torch.tensor(RANGE_EDGES_M[:-1]) + 0.25
    return float(counts[(middles > FOG_FROM_M) & (middles < FOG_TO_M)].sum())


def visibility(wanted: float, mor_m: Sequence[float], counts: Sequence[float]) -> float:
    """Where the simulated number falls below the recorded one, in the logarithms; infinite where it never does."""
    for low, high, before, after in zip(mor_m, mor_m[1:], counts, counts[1:], strict=False):
        if before >= wanted > after:
            part = math.log((before + 0.5) / (wanted + 0.5)) / math.log((before + 0.5) / (after + 0.5))
            return float(low * (high / low) ** part)
    return math.inf if wanted <= counts[-1] else mor_m[0]


def weakest_returns_m(scans: Sequence[Scan]) -> float:
    """Range at 10 % that the weakest recorded returns imply, ``R sqrt(0.1 / rho)``; 99 % of the returns need less.

    Counts the middle of the step of an intensity, and nothing at intensity 0, whose reflectivity has no lower end.
    """
    points = torch.cat([scan.points[above_horizon(scan)].reshape(-1, 4) for scan in scans])
    seen = (points[:, :3].norm(dim=-1) > OWN_VEHICLE_M) & (points[:, 3] > 0)
    reflectivity = (points[seen, 3] + 0.5) / 255.0
    return float((points[seen, :3].norm(dim=-1) * torch.sqrt(0.1 / reflectivity)).quantile(0.99))


def intensities(scans: Sequence[Scan]) -> list[tuple[int, float]]:
    """Number and mean intensity of the returns above the horizon by range, without retroreflectors."""
    points = torch.cat([scan.points[above_horizon(scan)].reshape(-1, 4) for scan in scans])
    points = points[points[:, 3] <= RETROREFLECTIVE]
    bins = torch.bucketize(points[:, :3].norm(dim=-1), torch.tensor(INTENSITY_EDGES_M), right=True)
    chosen = [points[bins == k + 1, 3] for k in range(len(INTENSITY_EDGES_M) - 1)]
    return [(len(values), float(values.mean()) if len(values) else math.nan) for values in chosen]


def draw(recorded: Tensor, fitted: Tensor, counts: Sequence[float], report: dict[str, Any], path: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.4), layout="constrained")
    left.loglog(MOR_GRID_M, [max(count, 0.3) for count in counts], ".-", label="simulated")
    left.axhline(report["recorded_fog_echoes"], color="k", label="recorded")
    left.set(xlabel="visibility (MOR) in m", ylabel=f"scattered echoes, {FOG_FROM_M:g} to {FOG_TO_M:g} m")
    left.legend()
    middle.stairs(recorded, RANGE_EDGES_M, color="k", fill=True, alpha=0.3, label="recorded")
    alone = fitted - recorded
    middle.stairs(alone, RANGE_EDGES_M, color="C0", label=f"fog alone, MOR {report['mor_m_at_least']:.0f} m")
    middle.stairs(recorded - alone, RANGE_EDGES_M, color="C3", label="residual: recorded - fog alone")
    middle.axvspan(FOG_FROM_M, FOG_TO_M, color="C1", alpha=0.15, label="used for the fit")
    middle.set(xlabel="range in m", ylabel="scattered echoes in each 0.5 m", yscale="symlog")
    middle.legend(fontsize=8)
    middles = [0.5 * (a + b) for a, b in pairwise(INTENSITY_EDGES_M)]
    means = [mean for _, mean in report["intensities"]]
    right.plot(middles, means, "ko", label="recorded, mean of all surfaces")
    start = next(k for k, mean in enumerate(means) if mean == mean)
    for mor_m in (50.0, 200.0):  # two ways through fog of ln 20 / MOR
        fall = [means[start] * 20.0 ** (-2.0 * (m - middles[start]) / mor_m) for m in middles[start:]]
        right.plot(middles[start:], fall, label=f"one surface, MOR {mor_m:g} m")
    right.set(xlabel="range in m", ylabel="intensity (0 to 255)", yscale="log")
    right.legend(fontsize=8)
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=100)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with *.csv: x, y, z, intensity, ring of an HDL-32E")
    parser.add_argument("--out", type=Path, default=Path("radiate"), help="folder to write to")
    parser.add_argument("--range-at-10-percent", type=float, help="of the sensor, m; the preset's by default")
    parser.add_argument("--near-full", type=float, help="where its near-range response is full, m; likewise")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.data is None:
        root = os.environ.get("TORCHWEATHER_REAL_DATA")
        if not root:
            sys.exit("no recording: give --data FOLDER, or set TORCHWEATHER_REAL_DATA to a folder with radiate_fog/")
        arguments.data = Path(root) / "radiate_fog" / "velo_lidar"
    paths = sorted(arguments.data.glob("*.csv"))
    if not paths:
        sys.exit(f"{arguments.data}: holds no *.csv")
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
    with atomic_write(arguments.out / "radiate.json") as unfinished:
        unfinished.write_text(json.dumps(report, indent=1), encoding="utf-8")
    draw(recorded, fitted, added, report, arguments.out / "radiate.png")
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
