"""LAS and LAZ, the point files of surveying, by laspy (extra ``las``)."""

from __future__ import annotations

import importlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.atomic import atomic_write
from torchweather.core.errors import MissingExtraError, TorchweatherError, check_one_of
from torchweather.io.las_header import check_las_header
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["LAS_ENCODINGS", "read_las", "write_las"]

LAS_ENCODINGS = ("las", "laz")
_HINT = (
    "LAS and LAZ need laspy, LAZ lazrs as well. Install them with: pip install 'laspy[lazrs]>=2.5' (in a clone of "
    "torchweather: pip install -e '.[las]')."
)
_POSITION = ("x", "y", "z")
_RAW = {"X", "Y", "Z"}  # the same as whole numbers of the header's scale
# Of clouds from other formats: millimetres, a point format with a time and 16 bits of intensity.
_SCALE_M, _POINT_FORMAT, _VERSION = 0.001, 6, "1.4"


def read_las(path: str | os.PathLike[str]) -> StoredPoints:
    """The dimensions of a LAS or LAZ file: x, y, z in metres (float64) and all others as stored.

    Raises:
        MissingExtraError: laspy is not installed, or for LAZ lazrs.
        TorchweatherError: no such file, or a damaged one.

    References:
        LAS specification 1.4 R15, American Society for Photogrammetry and Remote Sensing, 2019.
    """
    source, laspy = Path(path), _laspy()
    if not source.is_file():
        raise TorchweatherError(f"{source}: cannot be read (no such file).")
    if source.suffix.lower() == ".laz" and not laspy.LazBackend.detect_available():
        raise MissingExtraError(f"{source}: {_HINT}")
    check_las_header(source)
    try:
        with np.errstate(all="ignore"):  # positions are looked at below
            las = laspy.read(str(source), laz_backend=_backend(laspy))
        names = [str(name) for name in las.point_format.dimension_names if name not in _RAW]
        with np.errstate(all="ignore"):
            arrays = [np.asarray(las[name]) for name in (*_POSITION, *names)]
        header = _header_bytes(laspy, las.header)
    except BaseException as error:  # laspy and lazrs raise what their parts raise, lazrs its panics as BaseException
        if isinstance(error, (KeyboardInterrupt, SystemExit)) or not _is_of_reader(error):
            raise
        raise TorchweatherError(f"{source}: cannot be read as LAS ({type(error).__name__}: {error}).") from error
    if not all(np.isfinite(array).all() for array in arrays[:3]):
        raise TorchweatherError(f"{source}: cannot be read as LAS: its scale or offset makes no finite positions.")
    fields = tuple(
        PointField(name, array.dtype.str, 1 if array.ndim == 1 else array.shape[1])
        for name, array in zip((*_POSITION, *names), arrays, strict=True)
    )
    encoding = "laz" if source.suffix.lower() == ".laz" else "las"
    return StoredPoints(PointLayout("las", fields, encoding, header), tuple(arrays))


def write_las(path: str | os.PathLike[str], stored: StoredPoints) -> None:
    """Write the fields with the header that they were read with, or as point format 6 in millimetres.

    Raises:
        MissingExtraError: laspy is not installed, or for LAZ lazrs.
        TorchweatherError: a position or a value that the file cannot hold.
    """
    target, laspy = Path(path), _laspy()
    check_one_of("encoding", stored.layout.encoding, LAS_ENCODINGS, owner="write_las")
    compressed = target.suffix.lower() == ".laz"
    if compressed and not laspy.LazBackend.detect_available():
        raise MissingExtraError(f"{target}: {_HINT}")
    columns = {one.name: np.asarray(array) for one, array in zip(stored.layout.fields, stored.arrays, strict=True)}
    header = _header(laspy, stored, columns)
    _check_positions(columns, header, target)
    try:
        las = laspy.LasData(header)
        las.points = laspy.ScaleAwarePointRecord.zeros(stored.rows, header=header)
        for name, values in columns.items():
            las[name] = values
        written = io.BytesIO()
        las.write(written, do_compress=compressed)
    except Exception as error:  # laspy raises what its parts raise
        raise TorchweatherError(f"{target}: cannot be written as LAS ({type(error).__name__}: {error}).") from error
    with atomic_write(target) as unfinished:
        unfinished.write_bytes(written.getvalue())


def _laspy() -> Any:
    try:
        return importlib.import_module("laspy")  # there only with the extra
    except ImportError as error:
        raise MissingExtraError(_HINT) from error


def _backend(laspy: Any) -> Any:
    """Lazrs point after point where it is there: its other reader ends the process for a damaged table of chunks."""
    return laspy.LazBackend.Lazrs if laspy.LazBackend.Lazrs.is_available() else laspy.LazBackend.detect_available()


def _is_of_reader(error: BaseException) -> bool:
    return isinstance(error, Exception) or type(error).__name__ == "PanicException"


def _header_bytes(laspy: Any, header: Any) -> bytes:
    """The header with its records, as a file without points."""
    empty = io.BytesIO()
    laspy.LasData(header, points=laspy.ScaleAwarePointRecord.zeros(0, header=header)).write(empty, do_compress=False)
    return empty.getvalue()


def _header(laspy: Any, stored: StoredPoints, columns: dict[str, npt.NDArray[Any]]) -> Any:
    """The header of the file that the points came from, or a new one; with a dimension for each column."""
    if stored.layout.header:
        header = laspy.read(io.BytesIO(stored.layout.header)).header
    else:
        header = laspy.LasHeader(version=_VERSION, point_format=_POINT_FORMAT)
        header.scales = np.full(3, _SCALE_M)
        position = np.stack([columns[name].astype(np.float64) for name in _POSITION], axis=1)
        header.offsets = np.floor(np.nanmean(position, axis=0)) if len(position) else np.zeros(3)
    known = {str(name) for name in header.point_format.dimension_names}
    more = [
        laspy.ExtraBytesParams(one.name, np.dtype(one.dtype))
        for one in stored.layout.fields
        if one.name not in known and one.name not in _POSITION
    ]
    if more:
        header.add_extra_dims(more)
    return header


def _check_positions(columns: dict[str, npt.NDArray[Any]], header: Any, target: Path) -> None:
    """Refuse positions that are no 32-bit numbers of steps of the header's scale."""
    for axis, scale, offset in zip(_POSITION, header.scales, header.offsets, strict=True):
        if axis not in columns:
            raise TorchweatherError(f"{target}: expected columns x, y, z in metres; got {', '.join(columns)}.")
        steps = (columns[axis].astype(np.float64) - offset) / scale
        limits = np.iinfo(np.int32)
        if not bool(((steps >= limits.min) & (steps <= limits.max)).all()):
            raise TorchweatherError(
                f"{target}: {axis} must lie within 2^31 steps of {scale:g} m about {offset:g} m, those of the file's "
                "header. A lost point in the origin does not: leave lost points out (lost='drop'; command line: --lost "
                "drop)."
            )
