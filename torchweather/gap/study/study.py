"""Study: frames of a sensor in clear air and in weather, as a folder holds them or from arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from torchweather.core.errors import InputValueError, TorchweatherError, nearest_name
from torchweather.gap.sensors.all import KINDS
from torchweather.gap.study.conditions import Condition, StudyContent, StudyScene, StudySensor
from torchweather.gap.study.content_hash import content_sha256
from torchweather.gap.study.files import read_values, write_folder
from torchweather.gap.study.frames import Frame, Frames
from torchweather.gap.study.kinds import StudyKind
from torchweather.gap.study.parts import build_parts
from torchweather.gap.study.splits import FIT, HOLDOUT
from torchweather.sensors import sensor_preset

__all__ = ["Condition", "Frame", "Frames", "Study", "StudyScene"]


@dataclass(frozen=True, eq=False)
class Study(StudyContent):
    """Frames of one sensor in clear air and in weather, with the record of the weather.

    Build it with `Study.read` or `Study.from_arrays`.

    Args:
        kind: ``lidar``, ``camera``, ``radar`` or ``link``.
        sensor: what took the frames; ``None`` for links.
        beams: LiDAR: ``direction (H, W, 3)``; else empty.
        scenes: by name; empty for links.
        conditions: each with a split, ``fit`` or ``holdout``.
        links: links: ``length_km, frequency_ghz, polarisation, split``, ``(L,)`` each; else empty.

    Note:
        Two studies of the same content have the same `sha256`; they are not compared by ``==``.

    References:
        The format: ``docs/study-folder.md``.
    """

    @classmethod
    def from_arrays(
        cls,
        *,
        conditions: Sequence[Mapping[str, Any]],
        kind: str | None = None,
        sensor: StudySensor | str | None = None,
        beams: Frame | None = None,
        scenes: Sequence[Mapping[str, Any]] = (),
        links: Frame | None = None,
    ) -> Self:
        """A study without files; names, shapes and units of the arrays are those of the folder's files.

        Args:
            conditions: each with ``id``, ``scene``, ``weather`` (an object such as ``Rain(25.0)``, text such as
                ``rain:rate=25`` or ``clear``, or the keys of ``study.yaml``), ``frames``, and where known ``rel_sd``
                (of the recorded rate or visibility), ``time_s``, ``split``, ``ego_speed_m_per_s``, ``exposure_s``,
                ``airlight``, ``exposure_gain``.
            kind: ``lidar``, ``camera``, ``radar`` or ``link``; ``None`` is that of the sensor.
            sensor: an object, or text such as ``lidar:ouster-os1-128``; none for links.
            beams: LiDAR: ``direction (H, W, 3)``; ``None`` takes the sensor's scan pattern.
            scenes: each with ``id``, ``clear`` (frames), and ``geometry`` where there is one.
            links: links: ``length_km, frequency_ghz, polarisation, split``, ``(L,)`` each.

        Returns:
            The study. Arrays are checked and not copied.

        Raises:
            TorchweatherError: something is missing or wrong, with the key and the array.

        Example:
            >>> import numpy as np
            >>> from torchweather.lidar.sensor import Lidar
            >>> lidar = Lidar(905.0, elevations_deg=(-2.0, 2.0), columns=4)
            >>> noise = np.random.default_rng(0)
            >>> def frame(intensity):
            ...     range_m = 20.0 + 0.02 * noise.standard_normal((2, 4))
            ...     return {"range_m": range_m, "intensity": np.full((2, 4), intensity)}
            >>> study = Study.from_arrays(
            ...     sensor=lidar,
            ...     scenes=[{"id": "s0", "clear": [frame(0.5) for _ in range(8)]}],
            ...     conditions=[
            ...         {"id": "c0", "scene": "s0", "weather": "fog:mor=50", "rel_sd": 0.1, "frames": [frame(0.2)]},
            ...         {"id": "c1", "scene": "s0", "weather": "fog:mor=20", "rel_sd": 0.1, "frames": [frame(0.1)]},
            ...     ],
            ... )
            >>> [(one.id, one.split) for one in study.conditions]
            [('c0', 'fit'), ('c1', 'holdout')]
        """
        owner = "Study.from_arrays"
        built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
        named = kind if kind is not None else ("link" if built is None else built.kind)
        _check_sensor(named, built, owner)
        built, beams = KINDS[named].completed(built, beams)
        given = {"beams": beams, "links": links}
        return cls(named, built, *build_parts(named, built, given, list(scenes), list(conditions), owner))

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Self:
        """The study of a folder; frames are read, and checked, when they are asked for.

        Args:
            folder: with ``study.yaml`` of format ``torchweather-study/1``, and the ``.npz`` files that it names.

        Raises:
            TorchweatherError: a file is missing or broken, a key unknown or missing, a value out of its range, a path
                that leaves the folder; with file and key.

        Example:
            >>> Study.read("no/such/folder")
            Traceback (most recent call last):
            torchweather.core.errors.TorchweatherError: no/such/folder/study.yaml: no such file. ...
        """
        values = read_values(Path(folder))
        _check_sensor(values.kind, values.sensor, values.owner)
        given = {"beams": values.beams, "links": values.links}
        parts = build_parts(values.kind, values.sensor, given, values.scenes, values.conditions, values.owner)
        return cls(values.kind, values.sensor, *parts)

    def write(self, folder: str | os.PathLike[str]) -> None:
        """Write the study as a folder, whole or not at all.

        Args:
            folder: new or empty; made where it does not exist.

        Raises:
            TorchweatherError: the folder holds something, or cannot be written.

        Note:
            `Study.read` gives the same study back, with the same `sha256`. The splits are written as they stand.
        """
        write_folder(self, Path(folder))

    @property
    def study_kind(self) -> StudyKind:
        """Facts and steps of studies of this kind."""
        return KINDS[self.kind]

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all content: arrays, sensor, weather, splits; names of files do not count. Reads every frame."""
        return content_sha256(self)

    @property
    def fit(self) -> tuple[Condition, ...]:
        """Conditions to fit to. Links: all conditions; ``links["split"]`` is 0 for the links to fit to."""
        return self._with(FIT)

    @property
    def holdout(self) -> tuple[Condition, ...]:
        """Conditions held out. Links: all conditions; ``links["split"]`` is 1 for the links held out."""
        return self._with(HOLDOUT)

    def _with(self, split: str) -> tuple[Condition, ...]:
        return tuple(one for one in self.conditions if "split" in self.links or one.split == split)

    def scene_of(self, condition: Condition) -> StudyScene:
        """The scene of a condition; links have none."""
        if condition.scene not in self.scenes:
            raise InputValueError(
                f"Study: the condition {condition.id!r} must belong to one of the scenes "
                f"{', '.join(self.scenes) or '(a study of links has none)'}; got {condition.scene!r}."
            )
        return self.scenes[condition.scene]


def _check_sensor(kind: str, sensor: object, owner: str) -> None:
    if kind not in tuple(KINDS):
        raise TorchweatherError(
            f"{owner}: kind must be one of {', '.join(KINDS)}; got {kind!r}.{nearest_name(kind, KINDS)}"
        )
    wanted = KINDS[kind].sensor_class
    if wanted is None and sensor is not None:
        raise TorchweatherError(f"{owner}: a study of links has no sensor; got {type(sensor).__name__}.")
    if wanted is not None and not isinstance(sensor, wanted):
        raise TorchweatherError(
            f"{owner}: sensor must be a {wanted.__name__} for kind {kind}; got {type(sensor).__name__}."
        )
