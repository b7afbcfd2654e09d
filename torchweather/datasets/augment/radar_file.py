"""A radar's list of detections in a frame."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from torch import Tensor

from torchweather.compose.transform_spec import TransformSpec
from torchweather.datasets.augment.frame_file import FrameFile
from torchweather.datasets.augment.frame_recipe import SensorUse
from torchweather.io import read_radar, write_radar
from torchweather.radar.sensor import Radar

__all__ = ["RadarFile"]


class RadarFile(FrameFile):
    """A list of detections."""

    kind: ClassVar[str] = "radar"
    suffixes: ClassVar[tuple[str, ...]] = (".pcd", ".npz", ".csv")
    spec: TransformSpec[Radar]

    def _read(self, path: Path) -> None:
        self.detections = read_radar(path, self.spec.sensor)
        self.data = self.detections.points
        self.use = SensorUse(kind=self.kind)

    def save(self, data: Tensor) -> None:
        """Write a list of detections."""
        write_radar(self.paths.new(self.file.target), self.detections.with_points(data))
