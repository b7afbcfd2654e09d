"""View-of-Delft's radar files: rows of seven float32 numbers, one a detection, of one scan or of several."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["VOD_COLUMNS", "read_vod_radar", "write_vod_radar"]

VOD_COLUMNS = ("x", "y", "z", "rcs", "v_r", "v_r_compensated", "time")
"""Metres, dBsm, m/s relative to the radar, m/s less the car's own motion, number of the scan (0 the newest)."""
ROW_BYTES = 4 * len(VOD_COLUMNS)


def read_vod_radar(path: Path) -> StoredPoints:
    """The columns of ``radar/training/velodyne/*.bin``; an empty file is a frame without detections.

    Args:
        path: the file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TorchweatherError(f"{path}: cannot be read ({error.strerror}).") from error
    if len(content) % ROW_BYTES:
        raise TorchweatherError(
            f"{path}: expected rows of seven float32 numbers ({', '.join(VOD_COLUMNS)}), {ROW_BYTES} bytes each; got "
            f"{len(content)} bytes. The file is truncated, or a LiDAR's (four numbers a row)."
        )
    table: npt.NDArray[np.float32] = np.frombuffer(content, "<f4").reshape(-1, len(VOD_COLUMNS))
    if not bool(np.isfinite(table).all()):
        raise TorchweatherError(
            f"{path}: expected finite numbers ({', '.join(VOD_COLUMNS)}); got NaN or infinity. A LiDAR's file?"
        )
    fields = tuple(PointField(name, "<f4") for name in VOD_COLUMNS)
    return StoredPoints(PointLayout("vod", fields), tuple(table[:, k] for k in range(len(VOD_COLUMNS))))


def write_vod_radar(path: Path, columns: dict[str, npt.NDArray[Any]]) -> None:
    """Write the seven columns, whole or not at all.

    Args:
        path: the file.
        columns: name to ``(N,)``, all of `VOD_COLUMNS`; N may be 0.
    """
    missing = [name for name in VOD_COLUMNS if name not in columns]
    if missing:
        raise TorchweatherError(
            f"{path}: View-of-Delft's rows are {', '.join(VOD_COLUMNS)}; missing {', '.join(missing)}. Write .csv or "
            ".npz, which take any columns."
        )
    table = np.stack([np.asarray(columns[name]) for name in VOD_COLUMNS], axis=1).astype("<f4")
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(table.tobytes())
