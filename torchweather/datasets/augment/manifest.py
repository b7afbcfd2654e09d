"""The manifest: what was made of which file, by which recipe and seed; an SQLite file in the folder of the results."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.core.errors import InputTypeError, TorchweatherError
from torchweather.datasets.augment.paths import file_sha256, inside

__all__ = ["DONE", "FAILED", "FORMAT", "NAME", "Manifest", "Row"]

NAME = "torchweather-manifest.sqlite"
FORMAT = "torchweather-manifest/1"
DONE, FAILED = "done", "failed"

_MOST_SKIPPED = 1 << 24  # rows at once, when a damaged file is searched

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
        outputs: path below the target to ``[sha256, bytes, time of change in ns]``.
        recipe_sha256: of the recipe's text.
        seed: of the frame, 63 bits.
        version: of torchweather.
        weather: what was drawn, plain values, with ``nuisances`` by key and name where the recipe draws them; ``None``
            is clear air, or a copy.
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
        anew: begin again: the outputs of all rows that can be read are deleted, and the file, damaged or not.
        rebuild: write the file anew from the rows that can be read and whose outputs have the hashes they name.

    Raises:
        TorchweatherError: another process is at work in the folder, or the file is damaged or no manifest.
    """

    def __init__(self, folder: Path, *, anew: bool = False, rebuild: bool = False) -> None:
        self.folder, self.path = folder, folder / NAME
        self._lock = _lock(folder)
        self._file: sqlite3.Connection | None = None
        try:
            if anew:
                self._begin_again()
            elif rebuild:
                self._rebuild()
            with self._in_words():
                self._open().executescript(_TABLES)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let others at it."""
        if self._file is not None:
            self._file.close()
            self._file = None
        self._unlock()

    def _open(self) -> sqlite3.Connection:
        if self._file is None:
            self._file = sqlite3.connect(self.path, isolation_level=None)
        return self._file

    def __enter__(self) -> Manifest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def settings(self) -> dict[str, str]:
        """Settings of the run, by name; empty in a new manifest."""
        with self._in_words():
            found = self._open().execute("select key, value from run").fetchall()
        if not all(isinstance(key, str) and isinstance(value, str) for key, value in found):
            raise self._damaged("a setting is no text")
        return dict(found)

    def write_settings(self, values: Mapping[str, str]) -> None:
        """Keep what the run was asked for."""
        with self._in_words(), self._open() as file:
            file.execute("begin")
            file.executemany("insert or replace into run values (?, ?)", list(values.items()))

    def record(self, row: Row) -> None:
        """Keep a row, in place of an older one of the frame."""
        values = (
            _stored(row.frame),
            row.status,
            row.kind,
            json.dumps(row.inputs),
            json.dumps(row.outputs),
            row.recipe_sha256,
            row.seed,
            row.version,
            None if row.weather is None else json.dumps(row.weather),
            None if row.boxes is None else json.dumps(row.boxes),
            None if row.error is None else _stored(row.error),
            json.dumps(row.notes),
            row.seconds,
        )
        with self._in_words():
            self._open().execute(f"insert or replace into frames values ({', '.join('?' * len(values))})", values)

    def rows(self) -> Iterator[Row]:
        """All rows, by name."""
        with self._in_words():
            found = self._open().execute("select * from frames order by frame").fetchall()
        for values in found:
            try:
                yield _row(values)
            except (ValueError, TypeError, RecursionError) as error:
                raise self._damaged(f"a row cannot be read ({error})") from error

    def outputs_stand(self, row: Row, *, verify: bool = False) -> bool:
        """True where all files of a row are there, as they were written.

        Args:
            row: of the frame.
            verify: compare the hashes; else sizes and times of change, and the hash only where the time differs.

        Raises:
            TorchweatherError: a path in the manifest leads out of the folder.
        """
        for relative, (sha256, size, *changed_ns) in row.outputs.items():
            path = inside(self.folder, relative, str(self.path))
            if not path.is_file():
                return False
            found = path.stat()
            if found.st_size != size:
                return False
            if (verify or [found.st_mtime_ns] != changed_ns) and file_sha256(path) != sha256:
                return False
        return True

    def remove_frame(self, row: Row, keep: Collection[str] = ()) -> list[str]:
        """Delete a row and the files that it names, but those in ``keep``; the paths of what is gone."""
        gone = [path for path in row.outputs if path not in keep]
        self._remove(gone)
        with self._in_words():
            self._open().execute("delete from frames where frame = ?", (_stored(row.frame),))
        return gone

    def remove_outputs_of_frame(self, frame: str) -> None:
        """Delete the files that a frame's row names, where there is one."""
        with self._in_words():
            found = self._open().execute("select * from frames where frame = ?", (_stored(frame),)).fetchall()
        for values in found:
            try:
                outputs = _row(values).outputs
            except (ValueError, TypeError, RecursionError) as error:
                raise self._damaged(f"the row of {frame} cannot be read ({error})") from error
            self._remove(outputs)

    def _remove(self, outputs: Iterable[str]) -> None:
        for relative in outputs:
            inside(self.folder, relative, str(self.path)).unlink(missing_ok=True)

    def _begin_again(self) -> None:
        """Delete the outputs of all rows that can be read, and the file."""
        for row in salvaged(self.path)[1]:
            for relative in row.outputs:
                with contextlib.suppress(TorchweatherError, OSError):  # no path of this folder, in a damaged row
                    inside(self.folder, relative, str(self.path)).unlink(missing_ok=True)
        self._forget()

    def _rebuild(self) -> None:
        """Write the file anew from what can be read of it and is confirmed by the outputs."""
        settings, rows = salvaged(self.path)
        if settings.get("format") != FORMAT:
            raise TorchweatherError(
                f"{self.path}: the settings of its run cannot be read, so nothing shows how its results were made. "
                "--restart deletes what it names and begins again."
            )
        kept = [row for row in rows if row.status == DONE and self._confirmed(row)]
        self._forget()
        with self._in_words():
            self._open().executescript(_TABLES)
        self.write_settings(settings)
        for row in kept:
            self.record(row)

    def _confirmed(self, row: Row) -> bool:
        try:
            return self.outputs_stand(row, verify=True)
        except (TorchweatherError, OSError):
            return False

    def _forget(self) -> None:
        """Delete the file, and what SQLite may have left beside it."""
        if self._file is not None:
            self._file.close()
            self._file = None
        for ending in ("", "-journal", "-wal", "-shm"):
            self.path.with_name(self.path.name + ending).unlink(missing_ok=True)

    def _damaged(self, why: str) -> TorchweatherError:
        return TorchweatherError(
            f"{self.path}: expected a manifest of torchweather; {why}. --rebuild keeps what can be read and whose "
            "files have their hashes; --restart deletes what it names and begins again."
        )

    @contextmanager
    def _in_words(self) -> Iterator[None]:
        """Errors of the database as the library's errors; a full disk as that of any other file."""
        try:
            yield
        except sqlite3.Error as error:
            if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path)) from error
            raise self._damaged(str(error)) from error
        except (UnicodeError, OverflowError) as error:
            raise self._damaged(str(error)) from error

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _row(values: Sequence[Any]) -> Row:
    """A row of the table; ``ValueError`` or ``TypeError`` where it is damaged."""
    frame, status, kind, inputs, outputs, recipe, seed, version, weather, boxes, error, notes, seconds = values
    row = Row(
        _found(frame),
        status,
        kind,
        json.loads(inputs),
        json.loads(outputs),
        recipe,
        seed,
        version,
        None if weather is None else json.loads(weather),
        None if boxes is None else json.loads(boxes),
        None if error is None else _found(error),
        tuple(json.loads(notes)),
        seconds,
    )
    texts = (row.frame, row.status, row.kind, row.recipe_sha256, row.version, *row.notes)
    if not all(isinstance(text, str) for text in texts) or not isinstance(row.seed, int):
        raise InputTypeError("a text or the seed is none")
    if row.weather is not None and not isinstance(row.weather, dict):
        raise InputTypeError("the weather is no mapping")
    if row.boxes is not None and not (isinstance(row.boxes, list) and all(isinstance(one, dict) for one in row.boxes)):
        raise InputTypeError("the boxes are no list of mappings")
    for files, numbers in ((row.inputs, (2,)), (row.outputs, (1, 2))):  # of earlier versions without the time
        if not isinstance(files, dict):
            raise InputTypeError("the files are no mapping")
        for sha256, *rest in files.values():
            if not isinstance(sha256, str) or len(rest) not in numbers or not all(isinstance(one, int) for one in rest):
                raise InputTypeError("a file's hash, size or time is none")
    return row


def _stored(text: str) -> str:
    """A text that SQLite takes: a name that is no Unicode as JSON."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return json.dumps(text)
    return json.dumps(text) if text.startswith('"') else text


def _found(text: str) -> str:
    """The value that `_stored` was given."""
    found = json.loads(text) if text.startswith('"') else text
    if not isinstance(found, str):
        raise InputTypeError("a name is no text")
    return found


def salvaged(path: Path) -> tuple[dict[str, str], list[Row]]:
    """Settings and rows that can still be read in a damaged file; nothing is raised for what cannot."""
    if not path.is_file():
        return {}, []
    settings: dict[str, str] = {}
    rows: list[Row] = []
    try:
        file = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    except sqlite3.Error:
        return {}, []
    with contextlib.closing(file):
        with contextlib.suppress(sqlite3.Error, UnicodeError):
            found = file.execute("select key, value from run").fetchall()
            settings = {key: value for key, value in found if isinstance(key, str) and isinstance(value, str)}
        last, gap = 0, 1
        while gap <= _MOST_SKIPPED:
            try:
                for rowid, *values in file.execute("select rowid, * from frames where rowid > ?", (last,)):
                    last, gap = max(last, rowid), 1
                    with contextlib.suppress(ValueError, TypeError, RecursionError, AttributeError):
                        rows.append(_row(values))
                break
            except (sqlite3.Error, UnicodeError, OverflowError, MemoryError):
                last, gap = last + gap, 2 * gap  # over the damaged rows
    return settings, rows


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
