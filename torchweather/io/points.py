"""Point clouds of any format: the format is told by the suffix."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.io.csv_points import read_csv_points, write_csv_points
from torchweather.io.las import read_las, write_las
from torchweather.io.npz_points import read_npz_points, write_npz_points
from torchweather.io.pcd import read_pcd, write_pcd
from torchweather.io.ply import read_ply, write_ply
from torchweather.io.point_cloud import PointCloud, cloud_from_stored
from torchweather.io.point_files import (
    FLOAT32_ROWS,
    ROWS,
    read_float32_file,
    read_rows_file,
    write_float32_file,
    write_rows_file,
)
from torchweather.io.row_layout import stated_fields
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints
from torchweather.io.viewpoint import VIEWPOINTS, points_to_file

__all__ = ["POINT_FORMATS", "POINT_SUFFIXES", "read_points", "write_points"]

# Longer suffixes first: nuScenes' sweeps end in .bin too.
POINT_SUFFIXES = {
    ".pcd.bin": "nuscenes",
    ".bin": "kitti",
    ".pcd": "pcd",
    ".ply": "ply",
    ".npz": "npz",
    ".csv": "csv",
    ".las": "las",
    ".laz": "las",
}
POINT_FORMATS = tuple(dict.fromkeys(POINT_SUFFIXES.values()))
_READERS: dict[str, Callable[[Path], StoredPoints]] = {
    "kitti": lambda path: read_float32_file(path, "kitti"),
    "nuscenes": lambda path: read_float32_file(path, "nuscenes"),
    "pcd": read_pcd,
    "ply": read_ply,
    "npz": read_npz_points,
    "csv": read_csv_points,
    "las": read_las,
}
_WRITERS: dict[str, Callable[[Path, StoredPoints], None]] = {
    "kitti": write_float32_file,
    "nuscenes": write_float32_file,
    ROWS: write_rows_file,
    "pcd": write_pcd,
    "ply": write_ply,
    "npz": write_npz_points,
    "csv": write_csv_points,
    "las": write_las,
}
# What is written where nobody says otherwise.
_ENCODINGS = {"pcd": "binary", "ply": "binary_little_endian", "npz": "table", "las": "las"}


def read_points(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    intensity: str = "auto",
    columns: Sequence[str] | None = None,
    dtype: torch.dtype | None = None,
    bin_columns: str | Sequence[str] | None = None,
    bin_dtype: str = "float32",
    intensity_unit: str | None = None,
    viewpoint: str = "apply",
) -> PointCloud:
    """A point cloud with named columns.

    x, y, z and the intensity come first, the other columns follow in the file's order. Rows whose x, y and z are NaN
    or infinite (beams without a return) get x = y = z = 0, are marked in ``missing`` and are written back as they
    were. Frames are those of the file: nuScenes stores x right, y forward.

    A ``.bin`` has no header. Numbers that do not look like the format's columns are refused, with the likely layout;
    ``bin_columns`` states another one.

    Args:
        path: ``.bin`` (KITTI, SemanticKITTI, WADS: four float32), ``.pcd.bin`` (nuScenes: five float32), ``.pcd``,
            ``.ply``, ``.npz``, ``.csv``, ``.las`` or ``.laz`` (extra ``las``).
        format: one of `POINT_FORMATS`, where the suffix does not tell or lies.
        intensity: name of the intensity column; ``auto`` takes the first of `INTENSITY_NAMES` that is there, ``none``
            reads without. Of several, ``auto`` takes the one that fits ``intensity_unit``, or warns of the choice.
        columns: names of the columns to read; all by default.
        dtype: ``torch.float32`` or ``torch.float64``. By default float32 where it holds every number of the file
            exactly, else float64 (time stamps as uint32 or double): no bit is lost silently.
        bin_columns: columns of a file of rows without a header, in its order: ``"x,y,z,intensity,ring"``, or a
            sequence of names. ``name:uint16`` has a type of its own, ``_:uint8`` is padding. ``format`` is not used.
        bin_dtype: type of the columns of ``bin_columns`` without one, ``float32`` or ``float64``.
        intensity_unit: of the sensor, ``Lidar.intensity_unit``: a calibrated unit takes ``reflectivity`` before
            ``intensity``, ``photons`` takes ``signal`` and ``intensity`` before it.
        viewpoint: of a PCD file that was taken from elsewhere than the origin of its points. ``apply`` gives the points
            in the sensor's frame, float64, and `write_points` puts them back. ``ignore`` leaves them as they are; the
            sensor's place is then ``Lidar.origin_m``. Columns other than x, y, z stay in the file's frame.

    Raises:
        TorchweatherError: the file is missing, truncated, lies about its size, lacks a column, or holds numbers of
            another layout; NaN or infinity in part of a position. Files without a header (KITTI, nuScenes, csv without
            names) must hold a point: nothing tells an empty cloud from a broken file. PCD, PLY, NPZ and csv with names
            may hold none.

    Example:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "one.pcd"
        >>> write_points(target, torch.tensor([[10.0, 2.0, -1.5, 0.25]]))
        >>> read_points(target).points
        tensor([[10.0000,  2.0000, -1.5000,  0.2500]])
    """
    check_arguments(
        "read_points(path: path, format: str | None, intensity: str, columns: Sequence[str] | None, "
        "dtype: dtype | None, bin_columns: str | Sequence[str] | None, bin_dtype: str, intensity_unit: str | None, "
        "viewpoint: str)",
        path,
        format,
        intensity,
        columns,
        dtype,
        bin_columns,
        bin_dtype,
        intensity_unit,
        viewpoint,
    )
    source = Path(path)
    if bin_columns is not None:
        stored = read_rows_file(source, stated_fields(bin_columns, bin_dtype))
    else:
        stored = _READERS[_format(source, format, "read_points")](source)
    check_one_of("viewpoint", viewpoint, VIEWPOINTS, owner="read_points")
    return cloud_from_stored(
        stored,
        source,
        intensity=intensity,
        columns=columns,
        dtype=dtype,
        intensity_unit=intensity_unit,
        viewpoint=viewpoint,
    )


def write_points(
    path: str | os.PathLike[str],
    cloud: PointCloud | Tensor,
    *,
    format: str | None = None,
    encoding: str | None = None,
    columns: Sequence[str] | None = None,
) -> None:
    """Write a cloud; in the fields, dtypes and variant it was read in, where it came from the same format.

    What was read and did not change is written bit for bit: KITTI, nuScenes and binary PCD and PLY give the same
    file, but for bytes that stand for nothing (padding fields become zero, elements other than PLY's vertices are
    gone). Texts give the same numbers in their shortest form, compressed files the same content. Numbers in float64
    are rounded where the field is float32; a number that a whole-number field cannot hold is refused. The file
    appears under its name when it is complete.

    Args:
        path: suffixes as for `read_points`; the folder must exist.
        cloud: from `read_points` (`PointCloud.with_points` after a transform), or a tensor ``(N, C)``.
        format: one of `POINT_FORMATS`, where the suffix does not tell.
        encoding: ``ascii``, ``binary`` (default), ``binary_compressed`` for PCD; ``ascii``, ``binary_little_endian``
            (default), ``binary_big_endian`` for PLY; ``table`` (default), ``columns`` and each with ``_compressed``
            for NPZ. Text and the compression of PCD are slow, some seconds for a million points.
        columns: names of the columns of a tensor (default x, y, z, intensity, ring), or of a cloud's columns to write.

    Raises:
        ValueError: unknown format or encoding, columns that do not fit the points.
        TorchweatherError: what the format cannot hold: other columns or an empty cloud or NaN in KITTI and nuScenes,
            fractions in a whole-number field.
    """
    check_arguments(
        "write_points(path: path, cloud: PointCloud | Tensor, format: str | None, encoding: str | None, "
        "columns: Sequence[str] | None)",
        path,
        cloud,
        format,
        encoding,
        columns,
    )
    target = Path(path)
    kind = _format(target, format, "write_points")
    if format is None and kind in FLOAT32_ROWS and _layout_format(cloud) == ROWS:
        kind = ROWS
    if encoding is not None and kind not in _ENCODINGS:
        raise InputValueError(f"write_points: encoding must be None for {kind}; got {encoding!r}.")
    chosen = _chosen(cloud, columns)
    _WRITERS[kind](target, _stored(chosen, kind, encoding, target))


def _layout_format(cloud: PointCloud | Tensor) -> str:
    return "" if isinstance(cloud, Tensor) or cloud.layout is None else cloud.layout.format


def _format(path: Path, format: str | None, owner: str) -> str:
    if format is not None:
        check_one_of("format", format, POINT_FORMATS, owner=owner)
        return format
    name = path.name.lower()
    for suffix, known in POINT_SUFFIXES.items():
        if name.endswith(suffix):
            return known
    raise InputValueError(
        f"{owner}: path must end in {', '.join(POINT_SUFFIXES)}; got {path.name!r}. Or name the format: "
        f"format='{POINT_FORMATS[0]}' ({', '.join(POINT_FORMATS)})."
    )


def _chosen(cloud: PointCloud | Tensor, columns: Sequence[str] | None) -> PointCloud:
    """The cloud with the columns that are to be written."""
    if isinstance(cloud, Tensor):
        usual = ("x", "y", "z", "intensity", "ring")
        if columns is None and (cloud.ndim != 2 or not 4 <= cloud.shape[1] <= len(usual)):
            raise InputValueError(
                "write_points: a tensor must be (N, 4) or (N, 5) = x, y, z, intensity, ring; got "
                f"{tuple(cloud.shape)}. Name other columns with columns=(...)."
            )
        return PointCloud(cloud, usual[: cloud.shape[1]] if columns is None else tuple(columns))
    if columns is None:
        return cloud
    indices = [cloud.columns.index(name) for name in columns if name in cloud.columns]
    if len(indices) != len(columns):
        raise InputValueError(
            f"write_points: columns must be among {', '.join(cloud.columns)}; got {', '.join(columns)}."
        )
    missing = None if cloud.missing is None else cloud.missing[:, indices]
    return PointCloud(cloud.points[:, indices], tuple(columns), cloud.grid, missing, cloud.layout, cloud.viewpoint)


def _stored(cloud: PointCloud, kind: str, encoding: str | None, target: Path) -> StoredPoints:
    """The cloud's columns in the fields of the file to be."""
    values = _values(cloud, target)
    before = cloud.layout if cloud.layout is not None and cloud.layout.format == kind else None
    fields = list(_fields(cloud, kind, before, values.dtype))
    arrays: list[npt.NDArray[Any] | None] = []
    for one in fields:
        if one.is_padding:
            arrays.append(None)
            continue
        indices = [cloud.columns.index(name) for name in one.columns]
        mine = _cast(values[:, indices], np.dtype(one.dtype), one, target)
        arrays.append(mine[:, 0] if one.count == 1 else mine)
    old = before or PointLayout(kind, ())
    layout = PointLayout(
        kind,
        tuple(fields),
        encoding or old.encoding or _ENCODINGS.get(kind, ""),
        old.header,
        old.trailer,
        old.no_return,
        cloud.viewpoint or old.viewpoint,
    )
    return StoredPoints(layout, tuple(arrays), cloud.grid)


def _values(cloud: PointCloud, target: Path) -> npt.NDArray[Any]:
    """The numbers, with NaN or infinity again where a beam had no return and still has none."""
    points = cloud.points.detach().cpu()
    if points.dtype not in (torch.float32, torch.float64):
        points = points.float()
    values: npt.NDArray[Any] = points.numpy()
    positions = [k for k, name in enumerate(cloud.columns) if name.lower() in ("x", "y", "z")]
    if bool(np.isinf(values[:, positions]).any()):
        raise TorchweatherError(f"{target}: expected finite x, y and z in metres, or NaN for no return; got infinity.")
    lost = (values[:, positions] == 0).all(axis=1)
    if cloud.viewpoint and len(positions) == 3:
        order = sorted(positions, key=lambda k: cloud.columns[k].lower())
        values = values.astype(np.float64)
        values[:, order] = points_to_file(values[:, order], cloud.viewpoint)
        if cloud.layout is not None and cloud.layout.zero_rows:
            values[np.ix_(lost, order)] = 0.0
    if cloud.missing is not None:
        mark = values.dtype.type((cloud.layout.no_return if cloud.layout else "") or "nan")
        values = np.where(cloud.missing.cpu().numpy() & lost[:, None], mark, values)
    return values


def _fields(cloud: PointCloud, kind: str, before: PointLayout | None, dtype: np.dtype[Any]) -> list[PointField]:
    if kind in FLOAT32_ROWS:
        return [PointField(name, "<f4") for name in cloud.columns]
    kept = [one for one in (before.fields if before else ()) if set(one.columns) <= set(cloud.columns)]
    known = {name for one in kept for name in one.columns}
    # Of a file of another format the dtypes are kept, where this format has them.
    elsewhere = {name: one.dtype for one in (cloud.layout.fields if cloud.layout else ()) for name in one.columns}
    for name in cloud.columns:
        if name not in known:
            wanted = np.dtype(elsewhere.get(name, dtype))
            code = wanted.str[1:]
            if (kind in ("pcd", "ply") and code == "f2") or (kind == "ply" and code in ("i8", "u8")):
                wanted = np.dtype(np.float32 if code == "f2" else np.float64)
            if kind == "las" and name.lower() == "intensity":  # the standard's
                wanted = np.dtype(np.uint16)
            kept.append(PointField(name, wanted.newbyteorder("<").str))
    return kept


def _cast(values: npt.NDArray[Any], dtype: np.dtype[Any], one: PointField, target: Path) -> npt.NDArray[Any]:
    """Values in the dtype of a field; whole numbers only where they are whole and fit."""
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        # Compared as float64: 2^63 and 2^64 are exact there, 2^63 - 1 is not.
        wide = values.astype(np.float64)
        fits = (wide >= float(limits.min)) & (wide < float(limits.max) + (dtype.itemsize < 8)) & (wide == np.rint(wide))
        if not bool(fits.all()):
            raise TorchweatherError(
                f"{target}: field {one.name!r} is {dtype.name} in the file it came from and cannot hold "
                f"{values[~fits][0]}. Round the column, or write as floating point (dataclasses.replace(cloud, "
                "layout=None))."
            )
        return wide.astype(dtype)
    with np.errstate(over="ignore"):
        cast = values.astype(dtype, copy=False)
    if one.name.lower() in ("x", "y", "z") and bool((np.isinf(cast) & np.isfinite(values)).any()):
        raise TorchweatherError(f"{target}: expected finite {one.name} in metres, or NaN for no return; got infinity.")
    return cast
