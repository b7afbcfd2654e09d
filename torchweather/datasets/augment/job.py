"""Work of a run on all frames, as plain values, and the files of one frame."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from torchweather.datasets.augment.paths import inside
from torchweather.io import PointReading, atomic_write
from torchweather.lidar import OwnVehicleMask

__all__ = ["FramePaths", "Job"]


@dataclass(frozen=True)
class Job:
    """Work to be done on all frames; plain values, for processes and machines elsewhere.

    Args:
        source: root of the data set.
        target: root of the results.
        recipe: text of the recipe.
        seed: of the run.
        depth: where a camera's depth comes from: a file, a folder, metres, ``ground`` or ``lidar``; ``None`` is the
            LiDAR where the layout has one, else what the recipe says, else ``ground``.
        depth_encoding: of integer depth maps.
        depth_along: of depth maps: ``axis`` or ``ray``; ``None`` is ``axis``.
        baseline_m: of disparity maps: distance of the two lenses, m.
        own_vehicle: drive to the mask of its vehicle (`drive_of`).
        reading: how point files are to be read.
        follow_links: links may lead out of the source.
        durable: every file is on the disk before its name is (`atomic_write`).
        png_level: compression of PNG, 0 to 9; ``None`` is the usual one, 6.
    """

    source: str
    target: str
    recipe: str
    seed: int
    depth: str | None = None
    depth_encoding: str | None = None
    depth_along: str | None = None
    baseline_m: float | None = None
    own_vehicle: Mapping[str, OwnVehicleMask] = field(default_factory=dict, repr=False)
    reading: PointReading = field(default_factory=PointReading)
    follow_links: bool = False
    durable: bool = True
    png_level: int | None = None


class FramePaths:
    """Files of one frame below source and target; ``written`` lists the results, in order.

    Args:
        job: with the two roots.
    """

    def __init__(self, job: Job) -> None:
        self._source, self._target = Path(job.source), Path(job.target)
        self._follow_links = job.follow_links
        self.written: list[str] = []

    def source(self, path: str) -> Path:
        """An input file."""
        return inside(self._source, path, "augment", follow_links=self._follow_links)

    def target(self, path: str) -> Path:
        """A result."""
        return inside(self._target, path, "augment")

    def new(self, path: str) -> Path:
        """Place of a result that is about to be written; its folder is made."""
        found = self.target(path)
        found.parent.mkdir(parents=True, exist_ok=True)
        if path not in self.written:
            self.written.append(path)
        return found

    def copy(self, path: str, target: str) -> None:
        """Carry an input file along as it is."""
        with atomic_write(self.new(target)) as unfinished:
            shutil.copyfile(self.source(path), unfinished)
