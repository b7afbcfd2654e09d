"""The manifest: what was made of which file, by which recipe and seed; an SQLite file in the folder of the results."""

from __future__ import annotations

import errno
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.datasets.augment.paths import inside

__all__ = ["DONE", "FAILED", "FORMAT", "NAME", "Manifest", "Row"]

NAME = "torchweather-manifest.sqlite"
FORMAT = "torchweather-manifest/1"
DONE, FAILED = "done", "failed"

_TABLES = """
create table if not exists run (key text primary key, value text not null);
create table if not exists frames (
    frame text primary key,
    status text not null,
    kind text not null,
    inputs text not null,
    outputs text not null,
    recipe_sha256 text not null,
    seed integer not null,
    version text not null,
    weather text,
    boxes text,
    error text,
    notes text not null,
    seconds real not null
);
"""


@dataclass(frozen=True)
class Row:
    """A frame in the manifest.

    Args:
        frame: its name.
        status: ``done`` or ``failed``.
        kind: ``weather`` or ``copy``.
        inputs: path below the source to ``[sha256, bytes, time of change in ns]``.
        outputs: path below the target to ``[sha256, bytes]``.
        recipe_sha256: of the recipe's text.
        seed: of the frame, 63 bits.
        version: of torchweather.
        weather: what was drawn, plain values; ``None`` is clear air, or a copy.
        boxes: for each box of the frame, what the weather left of it and how many particles lie in it.
        error: of a failed frame.
        notes: how sure its depth is, what the rows of its sweep are, and warnings about it, such as an intensity that
            does not fit the sensor.
        seconds: that it took.
    """

    frame: str
    status: str
    kind: str
    inputs: Mapping[str, Any]
    outputs: Mapping[str, Any]
    recipe_sha256: str
    seed: int
    version: str
    weather: Mapping[str, Any] | None = None
    boxes: list[dict[str, Any]] | None = None
    error: str | None = None
    notes: tuple[str, ...] = ()
    seconds: float = field(default=0.0, compare=False)


class Manifest:
    """The rows of all frames; one process at a time writes them.

    Each row is committed by itself, after the files that it names have their names: killed at any moment, the manifest
    says of no frame that it is done that is not.

    Args:
        folder: of the results; it must exist.

    Raises:
        TorchweatherError: another process is at work in the folder, or the file is no manifest.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / NAME
        self._lock = _lock(folder)
        self._file = sqlite3.connect(self.path, isolation_level=None)
        try:
            with self._in_words():
                self._file.executescript(_TABLES)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let others at it."""
        self._file.close()
        self._unlock()

    def __enter__(self) -> Manifest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def settings(self) -> dict[str, str]:
        """What the run was asked for, by name; empty in a new manifest."""
        return dict(self._file.execute("select key, value from run"))

    def write_settings(self, values: Mapping[str, str]) -> None:
        """Keep what the run was asked for."""
        with self._in_words(), self._file:
            self._file.execute("begin")
            self._file.executemany("insert or replace into run values (?, ?)", list(values.items()))

    def record(self, row: Row) -> None:
        """Keep a row, in place of an older one of the frame."""
        values = (
            row.frame,
            row.status,
            row.kind,
            json.dumps(row.inputs),
            json.dumps(row.outputs),
            row.recipe_sha256,
            row.seed,
            row.version,
            None if row.weather is None else json.dumps(row.weather),
            None if row.boxes is None else json.dumps(row.boxes),
            row.error,
            json.dumps(row.notes),
            row.seconds,
        )
        with self._in_words():
            self._file.execute(f"insert or replace into frames values ({', '.join('?' * len(values))})", values)

    def rows(self) -> Iterator[Row]:
        """All rows, by name."""
        for values in self._file.execute("select * from frames order by frame").fetchall():
            frame, status, kind, inputs, outputs, recipe, seed, version, weather, boxes, error, notes, seconds = values
            yield Row(
                frame,
                status,
                kind,
                json.loads(inputs),
                json.loads(outputs),
                recipe,
                seed,
                version,
                None if weather is None else json.loads(weather),
                None if boxes is None else json.loads(boxes),
                error,
                tuple(json.loads(notes)),
                seconds,
            )

    def outputs_stand(self, row: Row) -> bool:
        """Whether all files of a row are there, in their size.

        Raises:
            TorchweatherError: a path in the manifest leads out of the folder.
        """
        for relative, (_, size) in row.outputs.items():
            path = inside(self.folder, relative, str(self.path))
            if not path.is_file() or path.stat().st_size != size:
                return False
        return True

    def remove_outputs(self) -> None:
        """Delete all files that the rows name, and the rows."""
        for row in self.rows():
            self._remove(row.outputs)
        self._file.executescript("begin; delete from frames; delete from run; commit;")

    def remove_outputs_of_frame(self, frame: str) -> None:
        """Delete the files that a frame's row names, where there is one."""
        for (outputs,) in self._file.execute("select outputs from frames where frame = ?", (frame,)).fetchall():
            self._remove(json.loads(outputs))

    def _remove(self, outputs: Iterable[str]) -> None:
        for relative in outputs:
            inside(self.folder, relative, str(self.path)).unlink(missing_ok=True)

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        """What the database says, as the library's errors; a full disk as that of any other file."""
        try:
            yield
        except sqlite3.Error as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path)) from error
            raise TorchweatherError(f"{self.path}: wanted a manifest of torchweather; {error}.") from error

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _lock(folder: Path) -> int | None:
    """A lock on the folder itself, which the system takes back when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise TorchweatherError(f"{folder}: another run is at work here; wait for it, or give another DST.") from error
    return handle
