"""Radar detections from files and back: PCD (nuScenes), View-of-Delft, csv, NPZ; power and cross section by the radar
equation.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError, TorchweatherError, TorchweatherWarning, check_one_of, nearest_name
from torchweather.io.csv_points import read_csv_points
from torchweather.io.npz_points import read_npz_points
from torchweather.io.nuscenes_radar import empty_sweep, is_nuscenes_radar
from torchweather.io.pcd import read_pcd
from torchweather.io.point_cloud import FARTHEST_M, PointCloud, exact_dtype, flat_columns
from torchweather.io.points import write_points
from torchweather.io.radar_columns import POSITIONS, RADIAL, SPEEDS, RadarColumns
from torchweather.io.stored_points import PointLayout, StoredPoints
from torchweather.io.vod_radar import read_vod_radar, write_vod_radar
from torchweather.physics import received_power_dbm, target_rcs_dbsm
from torchweather.radar.sensor import Radar

__all__ = ["RADAR_COLUMNS", "RADAR_FORMATS", "RadarPoints", "read_radar", "write_radar"]

RADAR_COLUMNS = ("x_m", "y_m", "z_m", "speed_m_per_s", "power_dbm", "rcs_dbsm")
RADAR_FORMATS = ("pcd", "npz", "csv", "vod")
SUFFIX_OF = {"vod": "bin"}  # others end in their name
RADAR_EQUATION = "radar equation"
FROM_FILE = "file"
GAINS = ("boresight", "pattern")
_READERS: dict[str, Callable[[Path], StoredPoints]] = {
    "pcd": read_pcd,
    "npz": lambda path: read_npz_points(path, positions=POSITIONS, usual=RADAR_COLUMNS),
    "csv": read_csv_points,
    "vod": read_vod_radar,
}


@dataclass(frozen=True, eq=False)
class RadarPoints:
    """Detections of a radar and the names of their columns.

    Args:
        points: ``(N, 6 or more)`` float32 or float64: x forward, y left, z up in metres, radial speed in m/s (positive
            when receding), power in dBm (or dB), radar cross section in dBsm, then the file's other columns. A row of
            range 0 is no detection.
        columns: their names; the first six are `RADAR_COLUMNS`, with ``power_db`` where a file says so.
        power_source, rcs_source: ``file``, or ``radar equation`` where the other one gave it.
        speed_source: ``file`` (a radial speed), or of which velocity it is the part along the line of sight:
            ``relative`` to the radar or ``compensated`` for the car's own motion.
        lost: ``(N, 6)`` the six numbers as the file holds them, where it holds rows without a detection.
        layout: fields, dtypes and variant of the file; ``None`` for detections that came from none.

    Example:
        >>> RadarPoints(torch.tensor([[50.0, 0.0, 0.0, -3.0, -111.1, 0.0]])).column("rcs_dbsm")
        tensor([0.])
    """

    points: Tensor
    columns: tuple[str, ...] = RADAR_COLUMNS
    power_source: str = FROM_FILE
    rcs_source: str = FROM_FILE
    speed_source: str = FROM_FILE
    lost: Tensor | None = field(default=None, repr=False)
    layout: PointLayout | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        check_arguments(
            "RadarPoints(points: Tensor, columns: Sequence, power_source: str, rcs_source: str, speed_source: str, "
            "lost: Tensor | None, layout: PointLayout | None)",
            self.points,
            self.columns,
            self.power_source,
            self.rcs_source,
            self.speed_source,
            self.lost,
            self.layout,
        )
        check_arguments("RadarPoints(columns: Sequence[str])", self.columns)
        object.__setattr__(self, "columns", tuple(self.columns))
        if self.points.ndim != 2 or self.points.shape[1] < 6 or self.points.dtype not in (torch.float32, torch.float64):
            raise InputValueError(
                f"RadarPoints: points must be float32 or float64 of shape (N, 6 or more); got {self.points.dtype} "
                f"{tuple(self.points.shape)}. The first six columns are x, y, z in metres, speed in m/s, power in dBm, "
                "RCS in dBsm."
            )
        if len(self.columns) != self.points.shape[1] or len(set(self.columns)) != len(self.columns):
            raise InputValueError(
                f"RadarPoints: columns must be {self.points.shape[1]} different names, one for each column of points; "
                f"got {', '.join(self.columns)}."
            )

    def column(self, name: str) -> Tensor:
        """The column of that name, ``(N,)``."""
        check_one_of("column", name, self.columns, owner=self)
        return self.points[:, self.columns.index(name)]

    def with_points(self, points: Tensor) -> RadarPoints:
        """The same columns with other points, as a transform gives them; to be written in the layout of the file."""
        same = points.shape == self.points.shape
        return replace(self, points=points, lost=self.lost if same else None)


def read_radar(
    path: str | os.PathLike[str],
    radar: Radar | None = None,
    *,
    format: str | None = None,
    speed: str = "relative",
    gain: str = "boresight",
    keep: Mapping[str, Collection[int]] | None = None,
) -> RadarPoints:
    """Detections of a radar with named columns.

    A file holds a position (``x_m``, ``y_m``, ``z_m`` or ``x``, ``y``, ``z``; or ``range_m`` with ``azimuth_rad`` or
    ``azimuth_deg`` and ``elevation_rad`` or ``elevation_deg``), a speed (``speed_m_per_s``, or nuScenes' ``vx`` and
    ``vy``) and a power (``power_dbm``, ``power_db``) or a cross section (``rcs_dbsm``, ``rcs``) or both. Other columns
    follow. Rows whose position or power is NaN, and rows at range 0, are no detections: their six numbers become 0.

    Args:
        path: ``.pcd`` (nuScenes' radars, or columns as above), ``.npz`` (an array for each column, or a table
            ``points`` of the six), ``.csv`` with a line of names, ``.bin`` (View-of-Delft: seven float32 a row).
        radar: whose link budget gives the power from the cross section or the reverse, where the file has but one.
        format: one of `RADAR_FORMATS`, where the suffix does not tell.
        speed: which velocity of nuScenes is taken, ``relative`` (``vx``, ``vy``: what the radar measures) or
            ``compensated`` (``vx_comp``, ``vy_comp``); the radial speed is ``(x vx + y vy) / r``. Of View-of-Delft
            ``v_r`` or ``v_r_compensated``.
        gain: antenna gain in the radar equation: ``boresight`` in all directions, or the radar's ``pattern``.
        keep: values to keep by column; other rows are left out. All rows are read by default, those that a maker marks
            as invalid too; `NUSCENES_RADAR_STATES` is nuScenes' usual choice.

    Returns:
        Float32 where it holds every number of the file exactly, else float64. ``power_source`` and ``rcs_source`` say
        what the radar equation gave.

    Raises:
        TorchweatherError: the file is missing, truncated, or lacks a column; one of power and cross section is missing
            and no radar given; a negative range; NaN or infinity in part of a detection.

    Note:
        The radar equation is that of clear air, and holds for the file as far as ``radar`` is its sensor. ``power_db``
        is taken as dBm there.

    References:
        PHYSICS.md 6.2. The PCD fields are those of nuScenes' development kit, RadarPointCloud.from_file.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "one.csv"
        >>> _ = file.write_text("range_m,azimuth_deg,elevation_deg,speed_m_per_s,rcs_dbsm\\n50,0,0,-3,0\\n")
        >>> found = read_radar(file, Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0))
        >>> found.points[0, :6]
        tensor([  50.0000,    0.0000,    0.0000,   -3.0000, -111.1285,    0.0000])
        >>> found.power_source
        'radar equation'
    """
    check_arguments(
        "read_radar(path: path, radar: Radar | None, format: str | None, speed: str, gain: str, keep: Mapping | None)",
        path,
        radar,
        format,
        speed,
        gain,
        keep,
    )
    source = Path(path)
    check_one_of("speed", speed, SPEEDS, owner="read_radar")
    check_one_of("gain", gain, GAINS, owner="read_radar")
    return detections_from_stored(
        _READERS[_format(source, format, "read_radar")](source), source, radar, speed, gain, keep
    )


def detections_from_stored(
    stored: StoredPoints,
    source: Path,
    radar: Radar | None = None,
    speed: str = "relative",
    gain: str = "boresight",
    keep: Mapping[str, Collection[int]] | None = None,
) -> RadarPoints:
    """Detections from the content of a file; the arguments are those of `read_radar`."""
    if stored.grid is not None:
        raise TorchweatherError(f"{source}: expected a list of detections (N,); got a grid {stored.grid}.")
    if stored.layout.viewpoint is not None:
        shown = " ".join(f"{number:g}" for number in stored.layout.viewpoint)
        warnings.warn(
            f"{source}: its VIEWPOINT, {shown}, is not applied: positions and speeds are taken as seen from the "
            "origin. Where they are not, move them to the radar's frame and write VIEWPOINT 0 0 0 1 0 0 0.",
            TorchweatherWarning,
            stacklevel=3,
        )
    found = flat_columns(stored, source)
    if stored.layout.format == "csv" and not stored.layout.header:
        raise TorchweatherError(
            f"{source}: expected a line of names, such as {','.join(RADAR_COLUMNS)}; there is none."
        )
    names = RadarColumns.among(tuple(found), speed, source)
    dtype = exact_dtype(found, None, source)
    if keep is not None:
        kept = _kept(found, keep, stored.rows, source)
        found = {name: column[kept] for name, column in found.items()}
    with np.errstate(all="ignore"):  # NaN and infinity are found below
        wide = {name: column.astype(np.float64) for name, column in found.items()}
        six, lost = _detections(wide, names, radar, gain, source)
        leading = six.astype(dtype)
    _check_numbers(leading, lost, source)
    as_read = torch.from_numpy(leading.copy()) if bool(lost.any()) else None
    leading[lost] = 0.0
    others = [name for name in found if name not in names.direct]
    table = np.column_stack([leading, *(found[name].astype(dtype) for name in others)])
    first = list(RADAR_COLUMNS)
    if names.power is not None:
        first[4] = names.power.lower()
    return RadarPoints(
        torch.from_numpy(table),
        (*first, *others),
        FROM_FILE if names.power is not None else RADAR_EQUATION,
        FROM_FILE if names.rcs is not None else RADAR_EQUATION,
        speed if names.velocities or names.speed[0] in RADIAL.values() else FROM_FILE,
        as_read,
        stored.layout,
    )


def write_radar(
    path: str | os.PathLike[str],
    detections: RadarPoints | Tensor,
    *,
    format: str | None = None,
    columns: Sequence[str] | None = None,
) -> None:
    """Write detections; in the fields, dtypes and variant they were read in, where they came from the same format.

    Rows without a detection (range 0) are left out, but for those that the file held. A file read and written without
    a change is the same byte by byte (binary PCD; texts and compressed files have the same numbers). A changed position
    goes into range and angles where the file has those, a changed speed into the velocities along the line of sight. A
    power that the radar equation gave is written where ``columns`` names it or the format is another one. In a nuScenes
    sweep without a detection stands a row of NaN, its mark for that.

    Args:
        path: suffixes as for `read_radar`; the folder must exist.
        detections: from `read_radar` (`RadarPoints.with_points` after a transform), or a tensor ``(N, 6)`` of
            `RADAR_COLUMNS`.
        format: one of `RADAR_FORMATS`, where the suffix does not tell.
        columns: names to write out of ``detections.columns``, instead of those of the file.

    Raises:
        ValueError: unknown format, column, or shape.
        TorchweatherError: what the format or a field of it cannot hold.
    """
    check_arguments(
        "write_radar(path: path, detections: RadarPoints | Tensor, format: str | None, columns: Sequence[str] | None)",
        path,
        detections,
        format,
        columns,
    )
    target = Path(path)
    kind = _format(target, format, "write_radar")
    radar_points = RadarPoints(detections) if isinstance(detections, Tensor) else detections
    points: npt.NDArray[np.floating] = as_numpy(radar_points.points)
    gone = (points[:, :3] == 0).all(axis=1)
    if radar_points.lost is not None:
        before = radar_points.lost.cpu().numpy()
        still = gone & _lost(before)
        points = np.concatenate([np.where(still[:, None], before, points[:, :6]), points[:, 6:]], axis=1)
        gone = gone & ~still
    points = points[~gone]
    layout = radar_points.layout if radar_points.layout is not None and radar_points.layout.format == kind else None
    if columns is not None or layout is None:
        wanted = radar_points.columns if columns is None else tuple(columns)
        for name in wanted:
            check_one_of("columns", name, radar_points.columns, owner="write_radar")
        table = points[:, [radar_points.columns.index(name) for name in wanted]]
    else:
        wanted = tuple(name for one in layout.fields for name in one.columns)
        table = _in_fields(points, radar_points, wanted, target)
    if kind == "vod":
        write_vod_radar(target, {name: table[:, k] for k, name in enumerate(wanted)})
        return
    cloud = PointCloud(torch.from_numpy(np.ascontiguousarray(table)), wanted, layout=layout)
    write_points(target, cloud, format=kind)


def _format(path: Path, format: str | None, owner: str) -> str:
    if format is not None:
        check_one_of("format", format, RADAR_FORMATS, owner=owner)
        return format
    suffix = path.suffix.lower().removeprefix(".")
    known = {SUFFIX_OF.get(name, name): name for name in RADAR_FORMATS}
    if suffix not in known:
        raise InputValueError(
            f"{owner}: path must end in .{', .'.join(known)}; got {path.name!r}. Or name the format: "
            f"format='{RADAR_FORMATS[0]}'."
        )
    return known[suffix]


def _kept(
    found: dict[str, npt.NDArray[np.generic]], keep: Mapping[str, Collection[int]], rows: int, source: Path
) -> npt.NDArray[np.bool_]:
    """Rows whose columns hold one of the values to keep."""
    kept = np.ones(rows, np.bool_)
    for name, values in keep.items():
        if name not in found:
            raise TorchweatherError(
                f"{source}: expected a column {name!r} to keep rows by; got {', '.join(found)}."
                f"{nearest_name(name, found)}"
            )
        kept &= np.isin(found[name], list(values))
    return kept


def _detections(
    wide: dict[str, npt.NDArray[np.float64]], names: RadarColumns, radar: Radar | None, gain: str, source: Path
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """``(N, 6)`` numbers of the detections, and ``(N,)`` which rows are none."""
    if names.spherical and bool((wide[names.position[0]] < 0).any()):
        worst = float(np.nanmin(wide[names.position[0]]))
        raise TorchweatherError(f"{source}: expected {names.position[0]} of 0 m or more; got {worst:g} m.")
    position = names.position_m(wide)
    speed = names.speed_m_per_s(wide, position)
    power, rcs = (None if name is None else wide[name] for name in (names.power, names.rcs))
    known = np.zeros_like(speed)
    six = np.column_stack([position, speed, known if power is None else power, known if rcs is None else rcs])
    lost = _lost(six)
    if power is None:
        six[:, 4] = _by_radar_equation(six[:, 5], position, lost, "power_dbm", radar, gain, source)
    if rcs is None:
        six[:, 5] = _by_radar_equation(six[:, 4], position, lost, "rcs_dbsm", radar, gain, source)
    return six, lost


def _lost(six: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Rows that are no detections: no position, no power, or range 0."""
    lost: npt.NDArray[np.bool_] = np.isnan(six[:, :3]).all(axis=1) | np.isnan(six[:, 4]) | (six[:, :3] == 0).all(axis=1)
    return lost


def _by_radar_equation(
    known: npt.NDArray[np.float64],
    position_m: npt.NDArray[np.float64],
    lost: npt.NDArray[np.bool_],
    wanted: str,
    radar: Radar | None,
    gain: str,
    source: Path,
) -> npt.NDArray[np.float64]:
    """The power that a cross section gives, or the reverse; 0 where there is no detection."""
    if radar is None:
        raise TorchweatherError(
            f"{source}: expected {wanted}; the file has none. The radar equation gives it with the radar's link "
            "budget: read_radar(path, radar=Radar(...))."
        )
    values = np.zeros_like(known)
    here = np.flatnonzero(~lost & np.isfinite(known) & np.isfinite(position_m).all(axis=1))
    x, y, z = torch.from_numpy(position_m[here]).unbind(1)
    flat = torch.hypot(x, y)
    both_ways_dbi: Tensor | float = 2.0 * radar.antenna_gain_dbi
    if gain == "pattern":
        both_ways_dbi = 2.0 * radar.gain_dbi(torch.atan2(y, x), torch.atan2(z, flat))
    equation = received_power_dbm if wanted == "power_dbm" else target_rcs_dbsm
    values[here] = equation(
        torch.from_numpy(known[here]),
        torch.hypot(flat, z),
        frequency_ghz=radar.frequency_ghz,
        transmit_power_dbm=radar.transmit_power_dbm,
        antenna_gain_dbi=both_ways_dbi,
        loss_db=radar.loss_db,
    ).numpy()
    return values


def _check_numbers(six: npt.NDArray[np.floating], lost: npt.NDArray[np.bool_], source: Path) -> None:
    wrong = np.where(lost[:, None], np.isinf(six), ~np.isfinite(six)) | (np.abs(six) > FARTHEST_M)
    if bool(wrong.any()):
        row, column = (int(index[0]) for index in np.nonzero(wrong))
        raise TorchweatherError(
            f"{source}: expected finite numbers, or NaN in the whole position or the power for no detection; got "
            f"{RADAR_COLUMNS[column]} = {six[row, column]} in row {row}. Is the file damaged?"
        )


def _in_fields(
    points: npt.NDArray[np.floating], radar_points: RadarPoints, wanted: tuple[str, ...], target: Path
) -> npt.NDArray[np.floating]:
    """The detections in the columns of the file that they came from."""
    if not len(points) and is_nuscenes_radar(wanted):
        sweep = empty_sweep(wanted)
        return np.column_stack([sweep[name] for name in wanted]).astype(points.dtype)
    speed = radar_points.speed_source
    names = RadarColumns.among(wanted, speed if speed in SPEEDS else "relative", target)
    other = {name: points[:, place].astype(np.float64) for place, name in enumerate(radar_points.columns) if place >= 6}
    columns = names.stored(points[:, :6].astype(np.float64), other, float(np.finfo(points.dtype).eps))
    return np.column_stack([columns[name] for name in wanted]).astype(points.dtype)
