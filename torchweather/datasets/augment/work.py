"""One frame: read, weather, write. What every worker does, whatever engine it belongs to."""

from __future__ import annotations

import errno
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

import torchweather
from torchweather.core.atomic import durable
from torchweather.core.errors import TorchweatherWarning
from torchweather.core.random import sample_seed
from torchweather.datasets.augment.frame_files import FRAME_FILES
from torchweather.datasets.augment.frame_recipe import FrameRecipe, text_sha256
from torchweather.datasets.augment.frames import COPY, Frame
from torchweather.datasets.augment.job import FramePaths, Job
from torchweather.datasets.augment.manifest import DONE, FAILED, Row
from torchweather.datasets.augment.paths import file_sha256

__all__ = ["ATTEMPTS", "FULL", "Worker", "file_stamp", "no_room"]

ATTEMPTS = ".torchweather-attempts"  # folder of marks below the target, where an engine cannot count tries otherwise
FULL = "full"  # status of a frame that found no room; it is not recorded
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class Worker:
    """Does frame after frame.

    Args:
        job: what to do.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.recipe = FrameRecipe(job.recipe)
        self.recipe_sha256 = text_sha256(job.recipe)

    def process(self, frame: Frame) -> Row:
        """The row of a frame; a frame that cannot be done leaves no file behind."""
        with durable(self.job.durable):
            return self._processed(frame)

    def _processed(self, frame: Frame) -> Row:
        started = time.perf_counter()
        seed = sample_seed(self.job.seed, frame.seed_name, 0)
        row = Row(
            frame=frame.name,
            status=DONE,
            kind=COPY if frame.is_copy else "weather",
            inputs={},
            outputs={},
            recipe_sha256=self.recipe_sha256,
            seed=seed,
            version=torchweather.__version__,
        )
        paths = FramePaths(self.job)
        said: list[warnings.WarningMessage] = []
        try:
            row = replace(row, inputs={path: _stamp(paths.source(path)) for path in frame.reads})
            for path in frame.reads:
                row.inputs[path][0] = file_sha256(paths.source(path))
            if frame.is_copy:
                for file in frame.files:
                    paths.copy(file.path, file.target)
            else:
                with torch.no_grad(), warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always", TorchweatherWarning)
                    row = self._in_weather(frame, seed, row, paths)
            results = {path: paths.target(path) for path in paths.written}
            row = replace(row, outputs={path: file_stamp(one) for path, one in results.items()})
        except Exception as error:
            for path in paths.written:
                paths.target(path).unlink(missing_ok=True)
            row = replace(row, status=FULL if no_room(error) else FAILED, error=one_line(error))
        notes = tuple(dict.fromkeys([*row.notes, *(" ".join(str(one.message).split()) for one in said)]))
        return replace(row, notes=notes, seconds=time.perf_counter() - started)

    def _in_weather(self, frame: Frame, seed: int, row: Row, paths: FramePaths) -> Row:
        files = {
            file.key: FRAME_FILES[file.kind](self.job, frame, file, paths, self.recipe.spec(file.kind))
            for file in frame.files
        }
        compose = self.recipe.for_sensors({key: one.use for key, one in files.items()})
        sample: dict[str, Any] = {one.file.key: one.data for one in files.values()}
        draw = compose.draw(sample, seed=seed)
        assert not isinstance(draw, list)
        out: dict[str, Any] = {}
        results: dict[str, Any] = {}
        # A frame that stays clear needs no depth, which takes longer than some weather.
        if draw.weather is not None or any(map(compose.clear_through_mosaic, files)):
            depths = {name: depth for one in files.values() for name, depth in one.depths()}
            out, results = compose.run(sample | depths, draw=draw)
        for key, one in files.items():
            if key in results:
                one.write(results[key])
            elif compose.clear_through_mosaic(key):
                one.save(out[key])
            else:
                one.write_clear()
        weathered = [files[key] for key in sorted(results, key=lambda key: files[key].kind)]
        notes = [(one.file.key, one.note(results[one.file.key])) for one in weathered]
        boxes = [one.boxes(results[one.file.key]) for one in weathered]
        drawn = draw.weather
        if drawn is not None and draw.nuisances:
            drawn = {**drawn, "nuisances": draw.to_dict()["nuisances"]}
        return replace(
            row,
            weather=drawn,
            boxes=next((one for one in boxes if one is not None), None),
            notes=tuple(f"{key}: {note}" for key, note in notes if note),
        )


def no_room(error: BaseException | None) -> bool:
    """Check whether an error, or its cause, is that of a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            return True
        error = error.__cause__ or error.__context__
    return False


def one_line(error: Exception) -> str:
    """The message without line breaks; of a system's error with the name of the file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


def file_stamp(path: Path) -> list[Any]:
    """Hash, size, and time of the last change in ns of a file."""
    stamp = _stamp(path)
    stamp[0] = file_sha256(path)
    return stamp


def _stamp(path: Path) -> list[Any]:
    """Place for the hash, size, time of the last change in ns."""
    found = path.stat()
    return ["", found.st_size, found.st_mtime_ns]
