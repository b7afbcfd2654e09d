"""A LiDAR cloud out of a file: one tensor with named columns, and what is needed to write the file back as it was."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError, TorchweatherWarning, nearest_name
from torchweather.io.stored_points import PointLayout, StoredPoints
from torchweather.io.viewpoint import points_to_sensor

__all__ = ["FARTHEST_M", "INTENSITY_NAMES", "PointCloud", "cloud_from_stored", "exact_dtype", "flat_columns"]

# Names under which files keep the strength of a return, in the order in which they are sought; case does not matter.
INTENSITY_NAMES = ("intensity", "reflectivity", "reflectance", "i", "signal")
# Of a file that has several, those that fit the sensor's unit come first: Ouster's driver has the photons of a return
# in ``intensity`` (or ``signal``) and the calibrated value in ``reflectivity``.
_CALIBRATED = ("reflectivity", "reflectance", "intensity", "i", "signal")
_COUNTED = ("signal", "intensity", "i", "reflectivity", "reflectance")
_OF_UNIT = {
    "reflectivity": _CALIBRATED,
    "reflectivity_percent": _CALIBRATED,
    "uint8_calibrated": _CALIBRATED,
    "uint8_linear": INTENSITY_NAMES,
    "photons": _COUNTED,
    "none": INTENSITY_NAMES,
}
# The largest range of whole numbers that float64 holds without a gap.
_FLOAT64_WHOLE = 2**53
FARTHEST_M = float(np.finfo(np.float32).max)
"""Positions beyond this are damaged: float32 does not hold them, and products of them overflow."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A cloud and the names of its columns.

    Args:
        points: ``(N, C)`` float32 or float64: x, y, z in metres, intensity (where there is one), then the others.
        columns: their C names, as the file has them.
        grid: ``(H, W)`` of an organised cloud, row-major: row i of ``points`` is cell ``(i // W, i % W)``.
        missing: ``(N, C)``, true where the file holds NaN or infinity for a beam without a return (the row of
            ``points`` has x = y = z = 0 there); ``None`` where it holds none.
        layout: fields, dtypes and variant of the file; ``None`` for a cloud that came from none.
        viewpoint: of a PCD file whose sensor is not in the origin: x, y, z, metres, and quaternion w, x, y, z of the
            sensor in the file's frame. ``points`` are in the sensor's frame, and are written in the file's.

    Example:
        >>> cloud = PointCloud(torch.tensor([[1.0, 2.0, 3.0, 0.5]]), ("x", "y", "z", "intensity"))
        >>> cloud.column("intensity")
        tensor([0.5000])
    """

    points: Tensor
    columns: tuple[str, ...]
    grid: tuple[int, int] | None = None
    missing: Tensor | None = field(default=None, repr=False)
    layout: PointLayout | None = field(default=None, repr=False)
    viewpoint: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_arguments(
            "PointCloud(points: Tensor, columns: Sequence, grid: Sequence | None, missing: Tensor | None, "
            "layout: PointLayout | None, viewpoint: Sequence | None)",
            self.points,
            self.columns,
            self.grid,
            self.missing,
            self.layout,
            self.viewpoint,
        )
        check_arguments("PointCloud(columns: Sequence[str])", self.columns)
        object.__setattr__(self, "columns", tuple(self.columns))
        if self.points.ndim != 2 or not self.points.is_floating_point():
            raise InputValueError(
                "PointCloud: points must be floating point of shape (N, C); got "
                f"{self.points.dtype} {tuple(self.points.shape)}. Split a batch first (split_indexed, split_padded)."
            )
        if len(self.columns) != self.points.shape[1] or len(set(self.columns)) != len(self.columns):
            raise InputValueError(
                f"PointCloud: columns must be {self.points.shape[1]} different names, one for each column of points; "
                f"got {', '.join(self.columns)}."
            )
        if self.grid is not None and (
            len(self.grid) != 2
            or not all(isinstance(one, int) for one in self.grid)
            or self.grid[0] * self.grid[1] != self.points.shape[0]
        ):
            raise InputValueError(
                f"PointCloud: grid (H, W) must have a cell for each of the {self.points.shape[0]} points; got "
                f"{self.grid!r}."
            )
        if self.missing is not None and self.missing.shape != self.points.shape:
            raise InputValueError(
                f"PointCloud: missing must have the shape of points, {tuple(self.points.shape)}; got "
                f"{tuple(self.missing.shape)}."
            )

    @property
    def nan_rows(self) -> int:
        """Number of rows that the file holds as NaN or infinity: beams without a return."""
        return 0 if self.missing is None else int(self.missing[:, :3].any(dim=1).sum())

    def column(self, name: str) -> Tensor:
        """The column of that name, ``(N,)``, in the dtype of ``points``."""
        if name not in self.columns:
            raise InputValueError(
                f"PointCloud: column must be one of {', '.join(self.columns)}; got {name!r}."
                f"{nearest_name(name, self.columns)}"
            )
        return self.points[:, self.columns.index(name)]

    def with_points(self, points: Tensor) -> PointCloud:
        """The same columns with other points, as a transform gives them; to be written in the layout of the file.

        Where the number of rows changed, the cloud is organised no longer and forgets its NaN rows.
        """
        same = points.shape == self.points.shape
        return replace(self, points=points, grid=self.grid if same else None, missing=self.missing if same else None)


def cloud_from_stored(
    stored: StoredPoints,
    source: Path,
    *,
    intensity: str = "auto",
    columns: Sequence[str] | None = None,
    dtype: torch.dtype | None = None,
    intensity_unit: str | None = None,
    viewpoint: str = "apply",
) -> PointCloud:
    """The content of a file as one tensor; the arguments are those of `read_points`."""
    found = flat_columns(stored, source)
    if columns is not None:
        absent = [name for name in columns if name not in found]
        if absent:
            raise TorchweatherError(
                f"{source}: expected columns {', '.join(columns)}; got {', '.join(found)}. There is no "
                f"{', '.join(absent)}.{nearest_name(absent[0], found)}"
            )
        found = {name: found[name] for name in found if name in columns}
    first = _leading(tuple(found), intensity, intensity_unit, source)
    order = (*first, *(name for name in found if name not in first))
    kind = exact_dtype(found, dtype, source)
    seen_from = stored.layout.viewpoint if viewpoint == "apply" else None
    if seen_from and dtype is None:
        kind = np.float64  # a difference of float32 numbers, which must add up to them again
    table = np.empty((stored.rows, len(order)), kind)
    with np.errstate(over="ignore", invalid="ignore"):  # of a dtype that was asked for; found below
        for index, name in enumerate(order):
            table[:, index] = found[name]
    missing, mark = _no_returns(table, len(first), order, source)
    zero_rows = bool((table[:, :3] == 0).all(axis=1).any()) if seen_from else None
    if seen_from:
        wide = np.stack([found[name].astype(np.float64) for name in order[:3]], axis=1)
        lost = (table[:, :3] == 0).all(axis=1)
        wide[lost] = seen_from[:3]
        table[:, :3] = points_to_sensor(wide, seen_from, source)
        table[lost, :3] = 0.0
    return PointCloud(
        torch.from_numpy(table),
        order,
        stored.grid,
        None if missing is None else torch.from_numpy(missing),
        replace(stored.layout, no_return=mark, zero_rows=zero_rows),
        seen_from,
    )


def flat_columns(stored: StoredPoints, source: Path) -> dict[str, npt.NDArray[Any]]:
    """Every column by its name; fields of several numbers taken apart."""
    found: dict[str, npt.NDArray[Any]] = {}
    for one, array in zip(stored.layout.fields, stored.arrays, strict=True):
        if array is None:
            continue
        for index, name in enumerate(one.columns):
            if name in found:
                raise TorchweatherError(f"{source}: expected columns of different names; got {name!r} twice.")
            found[name] = array if one.count == 1 else array[:, index]
    return found


def _leading(names: tuple[str, ...], intensity: str, unit: str | None, source: Path) -> tuple[str, ...]:
    """Names of x, y, z and intensity as the file has them."""
    lower = {name.lower(): name for name in reversed(names)}
    shown = ", ".join(names) or "none"
    if any(axis not in lower for axis in "xyz"):
        raise TorchweatherError(f"{source}: expected columns x, y, z in metres; got {shown}.")
    position = tuple(lower[axis] for axis in "xyz")
    if intensity == "none":
        return position
    if intensity == "auto":
        known = [name for name in _OF_UNIT.get(unit or "", INTENSITY_NAMES) if name in lower]
        if not known:
            raise TorchweatherError(
                f"{source}: expected an intensity, a column named {', '.join(INTENSITY_NAMES)}; got {shown}. Name the "
                "column with intensity='...', or read without one (intensity='none')."
            )
        if unit is None and len(known) > 1:
            warnings.warn(
                f"{source}: the strength of a return stands in {' and '.join(lower[name] for name in known)}; "
                f"{lower[known[0]]} is taken. Name the right one with intensity='...', or the sensor's unit with "
                "intensity_unit='...'.",
                TorchweatherWarning,
                stacklevel=4,
            )
        return (*position, lower[known[0]])
    if intensity not in names or intensity in position:
        raise TorchweatherError(
            f"{source}: expected an intensity column {intensity!r}; got {shown}.{nearest_name(intensity, names)}"
        )
    return (*position, intensity)


def exact_dtype(found: dict[str, npt.NDArray[Any]], wanted: torch.dtype | None, source: Path) -> type[np.floating[Any]]:
    """Float32 where it holds every number exactly, else float64."""
    if wanted is not None:
        if wanted not in (torch.float32, torch.float64):
            raise InputValueError(f"read_points: dtype must be torch.float32 or torch.float64; got {wanted}.")
        return np.float32 if wanted == torch.float32 else np.float64
    kind: type[np.floating[Any]] = np.float32
    for name, array in found.items():
        if array.dtype.kind in "iu" and array.dtype.itemsize == 8 and array.size:
            low, high = int(array.min()), int(array.max())
            if max(-low, high) > _FLOAT64_WHOLE:
                raise TorchweatherError(
                    f"{source}: column {name!r} ({array.dtype.name}, {low}..{high}) does not fit a floating-point "
                    "tensor without loss. Leave it out (columns=...), or take the loss (dtype=torch.float64)."
                )
        if not _fits_float32(array):
            kind = np.float64
    return kind


def _fits_float32(array: npt.NDArray[Any]) -> bool:
    if array.dtype.itemsize <= (4 if array.dtype.kind == "f" else 2):
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = array.astype(np.float32).astype(np.float64)
    wide = array.astype(np.float64)
    return bool(((narrow == wide) | np.isnan(wide)).all())


def _no_returns(
    table: npt.NDArray[Any], n_leading: int, order: tuple[str, ...], source: Path
) -> tuple[npt.NDArray[np.bool_] | None, str | None]:
    """Rows of NaN or infinity become range 0, in place; where they were, and what marked them."""
    leading = table[:, :n_leading]
    finite = np.isfinite(leading)
    far = np.argwhere(finite[:, :3] & (np.abs(leading[:, :3]) > FARTHEST_M))
    if len(far):
        row, column = far[0]
        raise TorchweatherError(
            f"{source}: expected positions in metres; got {order[column]} = {table[row, column]} in point {row}. The "
            "file is damaged, or has other columns or another byte order."
        )
    if bool(finite.all()):
        return None, None
    lost = np.asarray(~finite[:, :3].any(axis=1))
    wrong = ~finite & ~lost[:, None]
    if bool(wrong.any()):
        row, column = (int(index[0]) for index in np.nonzero(wrong))
        raise TorchweatherError(
            f"{source}: expected finite numbers, or x, y and z all NaN or infinite for a beam without a return; got "
            f"{order[column]} = {table[row, column]} in point {row}. Other columns or another byte order, perhaps?"
        )
    mark = f"{leading[lost][0, 0]:g}"
    gone: npt.NDArray[np.bool_] = ~np.isfinite(table)
    leading[lost[:, None] & ~finite] = 0.0
    gone[~lost] = False
    gone[:, n_leading:] = False  # other columns keep their NaN
    return gone, mark
