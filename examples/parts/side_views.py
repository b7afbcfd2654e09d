"""A recording and a simulation beside each other: from the side, and by azimuth and elevation."""

from __future__ import annotations

import base64
from pathlib import Path

import torch
from torch import Tensor

from torchweather.io import atomic_write
from torchweather.report.lidar_flat_figures import angle_views_uri, side_views_uri
from torchweather.report.lidar_views import WeatherCloud
from torchweather.stages import PointKind


def write_side_views(clear: Tensor, clouds: dict[str, tuple[Tensor, Tensor]], side: Path, angles: Path) -> None:
    """Write two pictures, the clouds below each other.

    Args:
        clear: ``(N, 4)`` returns that no weather made, metres in the sensor's frame; the ground is fitted to them.
        clouds: for each label the points ``(M, 4)`` and which of them are particles, bool ``(M,)``.
        side: PNG from the side, with the ground.
        angles: PNG by azimuth and elevation.
    """
    named = [(label, _cloud(points, particle)) for label, (points, particle) in clouds.items()]
    air = _cloud(clear, torch.zeros(len(clear), dtype=torch.bool))
    for path, uri in ((side, side_views_uri(named, air)), (angles, angle_views_uri(named, air))):
        with atomic_write(path) as unfinished:
            unfinished.write_bytes(base64.b64decode(uri.split(",", 1)[1]))


def _cloud(points: Tensor, particle: Tensor) -> WeatherCloud:
    there = (points[:, :3] != 0).any(-1)
    kind = torch.where(particle, int(PointKind.PARTICLE), int(PointKind.OBJECT))[there].to(torch.int8)
    return WeatherCloud(points[there], kind, torch.zeros(0, dtype=torch.bool), {}, {})  # no row is marked as lost
