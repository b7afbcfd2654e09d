"""Beams of a frame of WADS: two echoes each, which of them are snow, and what stands behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from torch import Tensor

import torchweather as tw
from torchweather.io import FALLING_SNOW, read_labels, read_points
from torchweather.lidar.scan import empty_beams, recover_ring

SCANNER = "pandar64-wads"  # whose scan pattern the recording has
# Beams of one ring are 0.2 degrees apart, echoes of one beam agree to 1e-4.
AZIMUTH_STEPS_PER_DEG = 1000


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


def read_frame(path: Path) -> tuple[Tensor, Tensor]:
    """Points ``(N, 4)`` of ``velodyne/NAME.bin``, and which ``labels/NAME.label`` calls falling snow, ``(N,)``."""
    points = read_points(path, format="kitti").points
    labels = read_labels(path.parents[1] / "labels" / f"{path.stem}.label", len(points))
    return points, labels.classes == FALLING_SNOW


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


def joined(frames: Sequence[Beams]) -> Beams:
    names = [field.name for field in fields(Beams)]
    return Beams(**{name: torch.cat([getattr(frame, name) for frame in frames]) for name in names})
