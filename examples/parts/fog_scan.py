"""Frames of a HDL-32E in fog on the sensor's grid: scattered echoes, fog simulated into empty beams, intensities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

import torchweather as tw
from torchweather.lidar import beam_ends
from torchweather.lidar.scan import recover_ring, scan_directions

FOG_FROM_M, FOG_TO_M = 2.0, 6.0
HORIZON_DEG = 1.0  # rings above: no road
OWN_VEHICLE_M = 2.0
# A surface fills neighbouring cells of the range image at one range; fog does not.
SAME_SURFACE_M = 0.3
NEIGHBOURS_OF_A_SURFACE = 3
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
