"""Speeds of the own vehicle along a drive: KITTI's raw recordings, tables, lists of numbers."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.file_names import is_hidden

__all__ = ["FASTEST_M_PER_S", "Speeds", "read_speeds", "read_timestamps"]

FASTEST_M_PER_S = 100.0
"""Largest speed that is taken for one in m/s: 360 km/h. Larger numbers are km/h by mistake."""

# Raw KITTI data, dataformat.txt of the development kit: 30 values a line, number 9 is the forward speed in m/s.
_OXTS_VALUES, _OXTS_FORWARD = 30, 8
_SPEED_NAMES = {"speed_m_per_s": 1.0, "ego_speed_m_per_s": 1.0, "speed_km_per_h": 1 / 3.6}
_STAMP = re.compile(r"\d{4}-\d{2}-\d{2}[ T]\d{2}:\d{2}(:\d{2}(\.\d{1,9})?)?", re.ASCII)
_TIME_NAME = "time_s"
_WANTED = (
    "expected one speed in m/s a line, or columns with a header: speed_m_per_s or speed_km_per_h, and time_s where the "
    "speeds are not those of the frames"
)


@dataclass(frozen=True)
class Speeds:
    """Forward speeds along a drive.

    Args:
        speed_m_per_s: ``(N,)``, negative backwards.
        time_s: ``(N,)`` seconds since the first one, growing; ``None``: one speed a frame.
        path: the file or folder they come from.

    Example:
        >>> Speeds(np.array([10.0, 20.0]), np.array([0.0, 1.0])).at_frames(3, 2.0)
        array([10., 15., 20.])
    """

    speed_m_per_s: npt.NDArray[np.float64]
    time_s: npt.NDArray[np.float64] | None = None
    path: Path | None = None

    def at_frames(self, count: int, frame_rate_hz: float) -> npt.NDArray[np.float64]:
        """Speed at each frame, ``(count,)``, m/s.

        As many speeds as frames belong to them in order. Others are interpolated at the frames' times, the first frame
        at the first speed; for two frame intervals behind the last one it holds.

        Args:
            count: number of frames.
            frame_rate_hz: of the frames.
        """
        name = "Speeds" if self.path is None else str(self.path)
        if len(self.speed_m_per_s) == count:
            return self.speed_m_per_s.copy()
        if self.time_s is None:
            raise TorchweatherError(
                f"{name}: expected one speed for each of {count} frames; got {len(self.speed_m_per_s)}. Add a column "
                "time_s, or give the frames that the speeds belong to."
            )
        times = np.arange(count) / frame_rate_hz
        if times[-1] > self.time_s[-1] + 2 / frame_rate_hz:
            raise TorchweatherError(
                f"{name}: the speeds end at {self.time_s[-1]:.2f} s, the {count} frames at {times[-1]:.2f} s. Give "
                "speeds for the whole drive."
            )
        return np.interp(times, self.time_s, self.speed_m_per_s)


def read_speeds(path: str | os.PathLike[str]) -> Speeds:
    """Speeds of a drive.

    Args:
        path: a folder of raw KITTI data (``oxts``, its ``data``, or the drive that holds ``oxts``), or a text or CSV
            file: one speed in m/s a line, or columns ``speed_m_per_s`` (or ``speed_km_per_h``) and ``time_s`` named in
            a header. ``#`` begins a comment.

    Raises:
        TorchweatherError: nothing to read, another layout, or speeds above 100 m/s.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "speeds.csv"
        >>> _ = file.write_text("time_s,speed_km_per_h\\n0,36\\n1,72\\n")
        >>> read_speeds(file).speed_m_per_s
        array([10., 20.])
    """
    source = Path(path)
    speeds = _kitti_speeds(source) if source.is_dir() else _speeds_of_table(source)
    if not len(speeds.speed_m_per_s):
        raise TorchweatherError(f"{source}: {_WANTED}; got none.")
    if not bool(np.isfinite(speeds.speed_m_per_s).all()):
        raise TorchweatherError(f"{source}: speeds must be finite numbers; got NaN or infinity.")
    fastest = float(np.abs(speeds.speed_m_per_s).max())
    if fastest > FASTEST_M_PER_S:
        raise TorchweatherError(
            f"{source}: speeds must be up to {FASTEST_M_PER_S:g} m/s; got {fastest:g}. Name a column of km/h "
            "speed_km_per_h."
        )
    return speeds


def read_timestamps(path: str | os.PathLike[str]) -> npt.NDArray[np.float64]:
    """Times of raw KITTI's ``timestamps.txt``, ``(N,)``, seconds since the first.

    Args:
        path: the file; each line is a date and a time of day with nanoseconds.
    """
    source = Path(path)
    lines = [line.strip() for line in _text(source).splitlines() if line.strip()]
    try:
        if odd := [line for line in lines if not _STAMP.fullmatch(line)]:
            raise InputValueError(f"got {odd[0][:60]!r}")
        times = np.array([line.replace(" ", "T") for line in lines], dtype="datetime64[ns]")
    except ValueError as error:
        raise TorchweatherError(f"{source}: expected dates such as 2011-09-26 13:02:25.964389445 ({error}).") from error
    if not len(times):
        raise TorchweatherError(f"{source}: expected a date and time a line; the file is empty.")
    seconds: npt.NDArray[np.float64] = (times - times[0]) / np.timedelta64(1, "s")
    _check_growing(seconds, source)
    return seconds


def _kitti_speeds(folder: Path) -> Speeds:
    # The drive, its oxts, or the data in it.
    places = [folder / "oxts", folder, *([folder.parent] if folder.name == "data" else [])]
    for oxts in places:
        packets = sorted(path for path in (oxts / "data").glob("*.txt") if not is_hidden(path))
        if packets:
            break
    else:
        raise TorchweatherError(
            f"{folder}: expected raw KITTI data, oxts/data/0000000000.txt and so on; found none. A table of speeds is "
            "given as a file."
        )
    speeds = []
    for packet in packets:
        values = _text(packet).split()
        if len(values) != _OXTS_VALUES:
            raise TorchweatherError(f"{packet}: expected {_OXTS_VALUES} numbers of raw KITTI data; got {len(values)}.")
        speeds.append(_number(values[_OXTS_FORWARD], packet))
    stamps = oxts / "timestamps.txt"
    times = read_timestamps(stamps) if stamps.is_file() else None
    if times is not None and len(times) != len(speeds):
        raise TorchweatherError(f"{stamps}: expected a time for each of {len(speeds)} packets; got {len(times)}.")
    return Speeds(np.array(speeds), times, folder)


def _speeds_of_table(source: Path) -> Speeds:
    lines = [line.split("#", 1)[0].strip() for line in _text(source).splitlines()]
    rows = [[field for field in re.split(r"[,;\s]+", line) if field] for line in lines]
    rows = [row for row in rows if row]
    if not rows:
        return Speeds(np.empty(0))
    names = [field.lower() for field in rows[0]] if re.match(r"[A-Za-z_]", rows[0][0]) else []
    if names:
        speed = [name for name in names if name in _SPEED_NAMES]
        if len(speed) != 1:
            raise TorchweatherError(f"{source}: {_WANTED}; got the header {', '.join(rows[0])}.")
        rows = rows[1:]
    elif len(rows[0]) != 1:
        raise TorchweatherError(f"{source}: {_WANTED}; got {len(rows[0])} numbers in the first line.")
    width = len(names) or 1
    for number, row in enumerate(rows):
        if len(row) != width:
            raise TorchweatherError(f"{source}: row {number + 1} has {len(row)} fields; the table has {width} columns.")
    column = names.index(speed[0]) if names else 0
    factor = _SPEED_NAMES[speed[0]] if names else 1.0
    values = np.array([_number(row[column], source) for row in rows]) * factor
    times = None
    if _TIME_NAME in names and len(rows):
        times = np.array([_number(row[names.index(_TIME_NAME)], source) for row in rows])
        if not bool(np.isfinite(times).all()):
            raise TorchweatherError(f"{source}: times must be finite numbers of seconds; got NaN or infinity.")
        times = times - times[0]
        _check_growing(times, source)
    return Speeds(values, times, source)


def _check_growing(times: npt.NDArray[np.float64], source: Path) -> None:
    if not bool((np.diff(times) > 0).all()):
        raise TorchweatherError(f"{source}: times must grow from row to row; they do not.")


def _number(text: str, source: Path) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise TorchweatherError(f"{source}: expected numbers; got {text!r}.") from error


def _text(source: Path) -> str:
    try:
        return source.read_text(encoding="utf-8")
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise TorchweatherError(f"{source}: expected text with speeds; got a binary file.") from error
