"""REHEARSE-3D: sequences of a camera, LiDARs and a radar under sprinklers, in the layout that its authors publish.

Layout as on the project's page (sporsho.github.io/REHEARSE3D, README; Raisuddin et al. 2026, Sensors 26, 728):
``sequences/000`` to ``142``, each with ``arena`` (RGB, .jpeg), ``flir`` (thermal, .jpeg), ``ouster`` and ``innoviz``
(.bin), ``radar_pcd`` (.bin), ``ext_radar`` (.csv: coordinates, intensity, cross section, velocity, confidence),
``weather`` (.csv), ``lidar_radar_pcd`` (.bin) and ``lidar_radar_labels`` (.label), frames numbered with six digits, and
a ``metadata.csv`` beside most of them. A .bin of a LiDAR holds float32 rows of x, y, z, intensity (a second public
project that reads the data set tests this). Not published: the columns of ``radar_pcd``, the names of the columns in
the .csv files, and the first REHEARSE's recordings as anything but ROS bags, which `torchweather.io.RosBag` reads.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import TorchweatherError, check_between, check_one_of, nearest_name
from torchweather.core.file_names import is_hidden
from torchweather.io import PointLabels, read_image, read_labels, read_points
from torchweather.io.csv_points import read_csv_points
from torchweather.io.radar_points import RadarPoints
from torchweather.io.tables import read_table

__all__ = ["REHEARSE_FOLDERS", "RehearseSequence", "read_rehearse"]

REHEARSE_FOLDERS: Mapping[str, str] = {
    "arena": ".jpeg",
    "flir": ".jpeg",
    "ouster": ".bin",
    "innoviz": ".bin",
    "radar_pcd": ".bin",
    "ext_radar": ".csv",
    "weather": ".csv",
    "lidar_radar_pcd": ".bin",
    "lidar_radar_labels": ".label",
}
"""Folders of a sequence and the endings of their frames."""

METADATA = "metadata.csv"
CAMERAS = ("arena", "flir")
CLOUDS = ("ouster", "innoviz", "lidar_radar_pcd")
# Names that the columns of ext_radar may have, lower case, without signs; what the authors describe, not what a file
# was seen to have.
RADAR_NAMES: Mapping[str, tuple[str, ...]] = {
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "speed_m_per_s": ("velocity", "speed", "radialvelocity", "v"),
    "rcs_dbsm": ("crosssection", "rcs", "radarcrosssection"),
    "power": ("intensity", "power"),
}


@dataclass(frozen=True)
class RehearseSequence:
    """Files of one sequence.

    Args:
        folder: such as ``REHEARSE3D_PUBLIC/sequences/000``.
        frames: for each folder of ``REHEARSE_FOLDERS`` that is there its frames by name, in order.

    Note:
        Sensors run at their own rates (about 10 frames a second of camera and LiDARs, 16 of the radar, 1 of the
        weather), so frame k of one is not of the time of frame k of another; `metadata` has what the files say of it.
    """

    folder: Path
    frames: Mapping[str, tuple[Path, ...]] = field(repr=False)

    def _file(self, folder: str, index: int) -> Path:
        check_arguments("RehearseSequence(index: int)", index)
        files = self.frames.get(folder, ())
        if not files:
            raise TorchweatherError(f"{self.folder}: no frames in {folder}; there are {', '.join(self.frames)}.")
        check_between("index", index, 0, len(files) - 1, owner=f"{self.folder / folder}")
        return files[index]

    def image(self, index: int, folder: str = "arena") -> Tensor:
        """A picture, ``(3, H, W)`` or ``(1, H, W)`` uint8, sRGB; ``flir`` is the thermal camera."""
        check_one_of("folder", folder, CAMERAS, owner="RehearseSequence.image")
        return read_image(self._file(folder, index))[0]

    def points(self, index: int, folder: str = "ouster") -> Tensor:
        """A cloud, ``(N, 4)`` float32: x, y, z in metres in the sensor's frame, intensity 0..255.

        Args:
            index: of the frame in its folder.
            folder: ``ouster``, ``innoviz``, or ``lidar_radar_pcd`` (innoviz and radar merged).

        Raises:
            TorchweatherError: no such frame, or a file that is no float32 rows of four.
        """
        check_one_of("folder", folder, CLOUDS, owner="RehearseSequence.points")
        path = self._file(folder, index)
        if path.stat().st_size % 16:
            raise TorchweatherError(
                f"{path}: expected float32 rows of x, y, z, intensity (16 bytes each); got {path.stat().st_size} bytes."
            )
        return read_points(path, bin_columns=("x", "y", "z", "intensity")).points[:, :4]

    def labels(self, index: int) -> PointLabels:
        """Classes of the points of ``lidar_radar_pcd``; the numbers of the classes are the data set's own."""
        return read_labels(self._file("lidar_radar_labels", index))

    def radar(self, index: int, columns: Mapping[str, str] | None = None) -> RadarPoints:
        """Detections of ``ext_radar``.

        Args:
            index: of the frame.
            columns: name in the file of each of ``x``, ``y``, ``z``, ``speed_m_per_s``, ``rcs_dbsm`` and ``power``
                (dB); those left out are sought by the words of the authors' description.

        Returns:
            `RadarPoints` with the columns ``x_m, y_m, z_m, speed_m_per_s, power_db, rcs_dbsm``. The sign of the
            velocity and the units of intensity and cross section are taken as they stand; they are not published.

        Raises:
            TorchweatherError: a column is not found; with the names that the file has.
        """
        path = self._file("ext_radar", index)
        stored = read_csv_points(path)
        names = [one.name for one in stored.layout.fields]
        chosen = _radar_columns(names, dict(columns or {}), path)
        arrays = [stored.arrays[names.index(chosen[key])] for key in RADAR_NAMES]
        x, y, z, speed, rcs, power = (torch.from_numpy(np.asarray(one, np.float64)) for one in arrays)
        points = torch.stack([x, y, z, speed, power, rcs], -1)
        return RadarPoints(points, ("x_m", "y_m", "z_m", "speed_m_per_s", "power_db", "rcs_dbsm"))

    def weather(self, index: int) -> dict[str, object]:
        """First row of a weather record by the names of its columns, as the file has them."""
        table = read_table(self._file("weather", index))
        return {name: next(iter(values), None) for name, values in table.items()}

    def metadata(self, folder: str) -> dict[str, list[object]]:
        """Table ``metadata.csv`` of a folder by the names of its columns, as the file has them."""
        check_one_of("folder", folder, REHEARSE_FOLDERS, owner="RehearseSequence.metadata")
        path = self.folder / folder / METADATA
        if not path.is_file():
            raise TorchweatherError(f"{path}: no such file.")
        return {name: list(values) for name, values in read_table(path).items()}


def _radar_columns(names: list[str], given: dict[str, str], path: Path) -> dict[str, str]:
    """Name in the file of each key of `RADAR_NAMES`."""
    for key, name in given.items():
        check_one_of("columns", key, RADAR_NAMES, owner="RehearseSequence.radar")
        if name not in names:
            raise TorchweatherError(f"{path}: no column {name!r}; got {', '.join(names)}.{nearest_name(name, names)}")
    plain = {re.sub(r"[^a-z]", "", name.lower()): name for name in reversed(names)}
    found = dict(given)
    for key, words in RADAR_NAMES.items():
        known = [plain[word] for word in words if word in plain]
        if key not in found and not known:
            raise TorchweatherError(
                f"{path}: expected a column {' or '.join(words)} for {key}; got {', '.join(names)}. Name it: "
                f"radar(index, columns={{{key!r}: ...}})."
            )
        found.setdefault(key, known[0] if known else "")
    return found


def read_rehearse(root: str | os.PathLike[str]) -> tuple[RehearseSequence, ...]:
    """Sequences of REHEARSE-3D.

    Args:
        root: ``REHEARSE3D_PUBLIC``, its folder ``sequences``, or one sequence.

    Returns:
        The sequences by name. No frame is read yet.

    Raises:
        TorchweatherError: no folder of that layout; with what was expected and what is there.

    Example:
        >>> import tempfile
        >>> from torchweather.io import write_points
        >>> ouster = Path(tempfile.mkdtemp()) / "sequences" / "000" / "ouster"
        >>> ouster.mkdir(parents=True)
        >>> write_points(ouster / "000000.bin", torch.tensor([[28.0, 0.0, -1.0, 12.0]]))
        >>> [sequence] = read_rehearse(ouster.parents[2])
        >>> sequence.folder.name, sequence.points(0).tolist()
        ('000', [[28.0, 0.0, -1.0, 12.0]])
    """
    check_arguments("read_rehearse(root: path)", root)
    path = Path(root)
    if not path.is_dir():
        raise TorchweatherError(f"{path}: no such folder; expected REHEARSE3D_PUBLIC with its folder sequences.")
    inside = path / "sequences"
    holder = inside if inside.is_dir() else path
    folders = [holder] if _frames(holder) else sorted(one for one in holder.iterdir() if one.is_dir())
    found = tuple(RehearseSequence(one, frames) for one in folders if (frames := _frames(one)))
    if not found:
        there = ", ".join(sorted(one.name for one in holder.iterdir() if not is_hidden(one))[:5]) or "nothing"
        raise TorchweatherError(
            f"{holder}: expected sequences with folders such as ouster, arena and ext_radar; got {there}."
        )
    return found


def _frames(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Frames of the sensors of one sequence."""
    found = {}
    for name, ending in REHEARSE_FOLDERS.items():
        if (folder / name).is_dir():
            files = (one for one in (folder / name).iterdir() if one.suffix == ending and not is_hidden(one))
            frames = tuple(sorted(one for one in files if one.name != METADATA))
            if frames:
                found[name] = frames
    return found
