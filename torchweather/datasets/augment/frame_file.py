"""FrameFile: one sensor's file of a frame, from reading it to writing the result."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from torch import Tensor

from torchweather.camera.depth import SceneDepth
from torchweather.compose.samples import data_of
from torchweather.compose.transform_spec import TransformSpec
from torchweather.datasets.augment.frame_recipe import SensorUse
from torchweather.datasets.augment.frames import Frame, SensorFile
from torchweather.datasets.augment.job import FramePaths, Job

__all__ = ["FrameFile"]


class FrameFile(ABC):
    """A file of a frame as it was read, and the sensor that took it; one subclass a kind of sensor.

    Args:
        job: of the run.
        frame: with the file.
        file: its place and what belongs to it.
        paths: of the frame.
        spec: the recipe's transform for this kind of sensor.
    """

    kind: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    takes_depth: ClassVar[bool] = False
    """A depth of the scene belongs to it, which a calibrated cloud can give."""
    takes_labels: ClassVar[bool] = False
    """A file with a class for each point belongs to it."""
    data: Tensor
    use: SensorUse

    def __init__(self, job: Job, frame: Frame, file: SensorFile, paths: FramePaths, spec: TransformSpec[Any]) -> None:
        self.job, self.frame, self.file, self.paths, self.spec = job, frame, file, paths, spec
        self._read(paths.source(file.path))

    @classmethod
    def prepared(
        cls,
        job: Job,
        frames: Sequence[Frame],
        spec: TransformSpec[Any],
        settings: dict[str, str],
        before: Mapping[str, str],
    ) -> Job:
        """The job with what follows from all files of the kind together, found before the first frame.

        Args:
            job: of the run.
            frames: of the data set.
            spec: the recipe's transform for this kind of sensor.
            settings: of the run; what a later run must find again is added.
            before: settings of an earlier run that goes on; empty of a new one.
        """
        return job

    @abstractmethod
    def _read(self, path: Path) -> None:
        """Set ``data`` and ``use``."""

    @abstractmethod
    def save(self, data: Tensor) -> None:
        """Write data in the format of the file."""

    def depths(self) -> Iterator[tuple[str, SceneDepth]]:
        """Key and depth that the recipe is given beside the data, where the frame gets weather; found at the call."""
        yield from ()

    def write(self, result: Any) -> None:
        """Write what the transform's ``run`` gave."""
        self.save(data_of(result))

    def write_clear(self) -> None:
        """Write the file of a frame that the recipe leaves in clear air: as it is."""
        if self.file.path == self.file.target:
            self.paths.copy(self.file.path, self.file.target)
        else:
            self.save(self.data)

    def note(self, result: Any) -> str:
        """A line on the result for the manifest; empty for none."""
        return ""

    def boxes(self, result: Any) -> list[dict[str, Any]] | None:
        """Remains of the frame's boxes in the weather, where they are counted in this file."""
        return None
