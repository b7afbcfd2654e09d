"""Base of the kinds of study: the facts and the steps in which studies of two sensors differ."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from torchweather.core.errors import check_one_of
from torchweather.gap.study.checks import ArrayRule
from torchweather.gap.study.conditions import Condition, StudyContent, StudySensor
from torchweather.gap.study.frames import Frame, Frames
from torchweather.gap.study.recorded_frames import CloudFile, ImageFile
from torchweather.pipeline.effect import Effect

__all__ = ["LEVELS", "Finding", "FrameLook", "Given", "Looks", "Paths", "StudyKind", "place"]

LEVELS = ("error", "warning", "note")
"""An error: no answer can be trusted. A warning: some answers cannot be given. A note: more data would show more."""


@dataclass(frozen=True)
class Finding:
    """Something that a study lacks.

    Args:
        level: ``error``, ``warning`` or ``note``.
        what: what is missing; of an error, with file and key in brackets.
        cost: what that costs.
        advice: what to do.
    """

    level: str
    what: str
    cost: str
    advice: str

    def __post_init__(self) -> None:
        check_one_of("level", self.level, LEVELS, owner=self)

    def __str__(self) -> str:
        return f"{self.level}: {self.what} {self.cost} {self.advice}"


def place(frames: Frames) -> str:
    """File and key of frames, without the folder: ``study.yaml: scenes[0].clear``."""
    owner, _, key = frames.name.rpartition(": ")
    return f"{PurePath(owner).name}: {key}"


@dataclass(frozen=True)
class FrameLook:
    """Summary of a frame: its hash, number, range and median of its signals, and the names of its arrays."""

    sha256: str
    signals: int
    low: float
    middle: float
    high: float
    arrays: frozenset[str]


Looks = Mapping[str, Sequence[FrameLook]]
"""By the name of a scene or a condition: its frames."""

Paths = Mapping[str, Sequence[Path]]
"""By the name of a scene: files of its frames."""

Given = Mapping[str, Any]
"""Beside the files: ``depth``, ``depth_encoding``, ``directions``; ``None`` where not given."""


class StudyKind(ABC):
    """A kind of study. Each sensor's folder has one, and ``gap/sensors/all.py`` lists them."""

    name: ClassVar[str]
    sensor_class: ClassVar[type[StudySensor] | None] = None
    # By part: frame, and where there are such, geometry, beams, links.
    arrays: ClassVar[Mapping[str, Mapping[str, ArrayRule]]]
    shared: ClassVar[str] = ""  # part that all frames share, beams or links
    shared_wanted: ClassVar[str] = ""  # its arrays in words
    has_scenes: ClassVar[bool] = True  # False where the frames themselves hold the clear samples
    has_airlight: ClassVar[bool] = False  # True where a condition can state its airlight and exposure gain
    # Key of a condition for the relative standard deviation of the weather, where its record is in the frames.
    rel_sd_key: ClassVar[str] = ""

    # Files of frames as the sensor records them; none where a study cannot be made of them.
    frame_file: ClassVar[type[CloudFile] | type[ImageFile] | None] = None
    suffixes: ClassVar[tuple[str, ...]] = ()
    kitti_folder: ClassVar[str] = ""

    # For the diagnosis: the array that weather changes, one of its values, and effects that show only in the spread
    # between frames, only in frames with times, and by a wrong record of the weather.
    signal: ClassVar[str]
    signal_name: ClassVar[str]
    spread_effect: ClassVar[str] = ""
    drift: ClassVar[str] = ""
    loss_effect: ClassVar[str] = ""

    def completed(self, sensor: Any, beams: Frame | None) -> tuple[Any, Frame | None]:
        """Sensor and beams as a study keeps them."""
        return sensor, beams

    def recorded(
        self, sensor: Any, scenes: Paths, measured: Sequence[Path], given: Given, owner: str
    ) -> tuple[Any, Frame | None, Mapping[str, Frame]]:
        """Sensor, beams, and geometry of each scene, for files of frames and the arrays given with them."""
        return sensor, None, {}

    def sizes(self, sensor: Any, owner: str) -> tuple[Mapping[str, int], str]:
        """Letters in the shapes of arrays that follow from the sensor, and its name; others follow from arrays."""
        return {}, ""

    def check_frame(self, sensor: Any, frame: Frame, name: str) -> None:
        """Raise where arrays of a frame contradict each other, or the sensor."""
        return

    @abstractmethod
    def simulated(
        self, study: StudyContent, condition: Condition, start: Frame, seed: int, effects: tuple[Effect, ...] = ()
    ) -> Frame:
        """A frame of a condition by the base model, from a clear frame (links: from the measured one).

        Args:
            study: with the sensor and the geometry of the scenes.
            condition: with a weather.
            start: the frame that it starts from.
            seed: of the weather and of the effects.
            effects: of the catalogue, put into the chain.
        """

    def signals(self, frame: Frame) -> NDArray[Any]:
        """Values of a frame that weather changes, ``(K,)``."""
        values = np.asarray(frame[self.signal])
        return np.asarray(values[~np.isnan(values)])

    def geometry_findings(self, scene: str, geometry: Frame) -> Iterable[Finding]:
        """Findings on the geometry of a scene."""
        return ()

    def scene_changes(self, study: StudyContent) -> Iterable[Finding]:
        """Findings on scenes that are another one in weather than in clear air."""
        return ()

    @abstractmethod
    def findings(self, study: StudyContent, clear: Looks, measured: Looks) -> Iterable[Finding]:
        """Findings on the frames of a study that only this kind has."""
