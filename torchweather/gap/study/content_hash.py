"""One number for all that a study holds, whatever its files are called."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from torchweather.gap.study.conditions import StudyContent
from torchweather.gap.study.frames import Frame

__all__ = ["content_sha256", "frame_sha256", "plain"]


def frame_sha256(frame: Frame) -> str:
    """SHA-256 of the arrays of a frame: names, dtypes, shapes and numbers, by name.

    Example:
        >>> frame_sha256({"a": np.zeros(2)}) == frame_sha256({"a": np.zeros(2, np.float32)})
        False
    """
    found = hashlib.sha256()
    for name in sorted(frame):
        array = np.asarray(frame[name])
        little = array.astype(array.dtype.newbyteorder("<"), copy=False)
        found.update(json.dumps([name, little.dtype.str, list(array.shape)]).encode())
        found.update(np.ascontiguousarray(little).tobytes())
    return found.hexdigest()


def content_sha256(study: StudyContent) -> str:
    """SHA-256 of a study: every array and every value, in the order of its scenes and conditions; no name of a file."""
    found = hashlib.sha256()
    for line in _lines(study):
        found.update(json.dumps(line, sort_keys=True).encode() + b"\n")
    return found.hexdigest()


def plain(value: Any) -> Any:
    """A value as YAML and JSON hold it: lists for tuples and arrays, Python's numbers for numpy's."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _lines(study: StudyContent) -> Iterable[Any]:
    yield [study.kind, None if study.sensor is None else plain(study.sensor.to_dict())]
    yield [frame_sha256(study.beams), frame_sha256(study.links)]
    for scene in study.scenes.values():
        yield [scene.id, frame_sha256(scene.geometry), [frame_sha256(frame) for frame in scene.clear]]
    for one in study.conditions:
        weather = None if one.weather is None else plain(one.weather.to_dict())
        times = None if one.time_s is None else one.time_s.tolist()
        stated = [one.id, one.scene, weather, one.rel_sd, times, one.split, one.ego_speed_m_per_s, one.exposure_s]
        if one.airlight is not None:  # studies without keep the hash that they had
            stated.append(list(one.airlight))
        if one.exposure_gain is not None:
            stated.append({"exposure_gain": one.exposure_gain})
        yield [*stated, [frame_sha256(frame) for frame in one.frames]]
