"""Outcome of a run over many files: what was done, which files are broken, and which were left out."""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.cli.mistakes import one_line
from torchweather.cli.output import listed, note
from torchweather.core.exceptions import TorchweatherError

__all__ = ["BROKEN", "Outcome", "left_out_of"]

BROKEN = 1
"""Exit code of a run that did everything but its broken files."""
OWN = ("torchweather-record.json", "torchweather-manifest.sqlite", "sequence.jsonl")  # what runs leave beside results
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


@dataclass
class Outcome:
    """Outcome of a run over files.

    Args:
        quiet: no notes.
        total: number of files to do; a single one is no run to go on with: its error ends the command.
        done: what was done to each frame, as plain values.
        broken: name of each file that could not be done, and why.
        left_out: names in the folders given that no frame was read from.
        sensors: the sensors of the frames, each once, as plain values.
        about: what holds for all frames: options, the depth's source.
    """

    quiet: bool = False
    total: int = 0
    done: list[dict[str, Any]] = field(default_factory=list)
    broken: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    sensors: list[dict[str, Any]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)

    def begin(self, inputs: Iterable[Path], files: Sequence[Path]) -> None:
        """Take the files that were found among the inputs."""
        self.total, self.left_out = len(files), left_out_of(inputs, files)

    @contextmanager
    def file(self, path: Path) -> Iterator[None]:
        """The work on one of several files: where it is broken, the run goes on with the next.

        Warnings, such as that of an airlight that stands in, become part of what was done to its frames.
        """
        first = len(self.done)
        with _warnings_kept() as texts:
            try:
                yield
            except (TorchweatherError, OSError) as error:
                if self.total == 1 or _no_room(error):
                    raise
                self.broken[str(path)] = one_line(error)
                note(f"broken: {_named(path, one_line(error))}", quiet=False)
        for entry in self.done[first:] if texts else ():
            entry["warnings"] = texts

    def add(self, entry: dict[str, Any], sensor: Mapping[str, Any] | None = None) -> None:
        """Keep what was done to a frame, and by which sensor it was seen."""
        if sensor is not None and sensor not in self.sensors:
            self.sensors.append(dict(sensor))
        self.done.append(entry)

    def close(self) -> int:
        """Print the files that were left out and broken; the exit code.

        Raises:
            TorchweatherError: no file could be done.
        """
        if self.left_out:
            count = len(self.left_out)
            word = "file or folder" if count == 1 else "files or folders"
            note(f"left out: {count} {word} of those given: {listed(self.left_out)}.", quiet=self.quiet)
        if self.broken and not self.done:
            path, why = next(iter(self.broken.items()))
            raise TorchweatherError(f"none of {self.total} files could be done; the first: {_named(Path(path), why)}")
        if self.broken:
            note(f"{len(self.broken)} of {self.total} files are broken: {listed(self.broken)}.")
        return BROKEN if self.broken else 0


@contextmanager
def _warnings_kept() -> Iterator[list[str]]:
    """Texts of the warnings inside the block, each once; they are shown as well."""
    texts: list[str] = []
    shown = warnings.showwarning

    def keep(message: Warning | str, *more: Any, **named: Any) -> None:
        text = " ".join(str(message).split())
        if text not in texts:
            texts.append(text)
        shown(message, *more, **named)

    warnings.showwarning = keep
    try:
        yield texts
    finally:
        warnings.showwarning = shown


def left_out_of(inputs: Iterable[Path], files: Iterable[Path]) -> list[str]:
    """Names in the folders among ``inputs`` that are none of the ``files``; hidden ones are not counted."""
    taken = {os.fspath(path) for path in files}
    found = []
    for folder in inputs:
        if folder.is_dir():
            inside = sorted(path for path in folder.iterdir() if path.name[0] != "." and path.name not in OWN)
            found += [f"{path}{'/' if path.is_dir() else ''}" for path in inside if os.fspath(path) not in taken]
    return found


def _named(path: Path, why: str) -> str:
    """Reason why a file is broken, with its name once."""
    return why if str(path) in why else f"{path}: {why}"


def _no_room(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            return True
        error = error.__cause__
    return False
