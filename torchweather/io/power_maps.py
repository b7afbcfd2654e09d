"""Radar power maps from files and back: polar pictures and arrays, byte for byte where nothing changed."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError
from torchweather.io.arrays import array_to_tensor, read_archive, read_array, write_archive
from torchweather.io.images import write_image
from torchweather.io.map_layout import AXES, MapLayout, map_layout
from torchweather.io.polar_png import read_polar_png
from torchweather.radar.power_map import RadarPowerMap

__all__ = ["MAP_SUFFIXES", "MapRecord", "read_power_map", "write_power_map"]

MAP_SUFFIXES = (".png", ".npy", ".npz")
"""Endings that `read_power_map` and `write_power_map` know."""
KEYS = ("map", "power", "values")
OTHERS = ("dims", "scale", *AXES.values(), "azimuth_rad", "elevation_rad")
WANTED = "a radar power map: .png, .npy or .npz"


@dataclass(frozen=True, eq=False)
class MapRecord:
    """Contents of a file, kept for the writer.

    Args:
        suffix: of the file.
        content: its bytes.
        values: as they were read.
        header: ``(A, 11)`` bytes in front of the rows of a picture.
        arrays: of a ``.npz`` by name.
        key: of the map among them.
        compressed: whether the ``.npz`` is.
        quadratures: whether real and imaginary part are the last dimension of the file.
        timestamps: ``(A,)`` int64 of the rows of a picture, as stored.
        measured: ``(A,)`` bool of the rows of a picture.
    """

    suffix: str
    content: bytes = field(repr=False)
    values: Tensor = field(repr=False)
    header: Tensor | None = field(default=None, repr=False)
    arrays: dict[str, npt.NDArray[Any]] | None = field(default=None, repr=False)
    key: str = ""
    compressed: bool = False
    quadratures: bool = False
    timestamps: Tensor | None = field(default=None, repr=False)
    measured: Tensor | None = field(default=None, repr=False)


def read_power_map(path: str | os.PathLike[str], layout: MapLayout | str | None = None) -> RadarPowerMap:
    """A map of power as a radar recorded it.

    Args:
        path: ``.png``: a polar picture of 8 bits, with or without the eleven columns of Oxford and Boreas. ``.npy``: an
            array. ``.npz``: an array ``map`` (or ``power``, ``values``), with ``dims`` and ``scale`` as texts, and
            ``range_m``, ``azimuth_deg`` or ``azimuth_rad``, ``elevation_deg`` or ``elevation_rad``, ``speed_m_per_s``.
        layout: what the file does not hold, or holds otherwise: a name of `MAP_LAYOUTS`, a YAML file, a `MapLayout`.

    Raises:
        TorchweatherError: the file is missing or broken, or an axis or the scale is not known.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "frame.npz"
        >>> np.savez(file, map=np.ones((3, 2), np.float32), dims=["range", "azimuth"], scale="linear",
        ...          range_m=[1.0, 2.0, 3.0], azimuth_deg=[10.0, -10.0])
        >>> read_power_map(file).axes.shape
        (3, 2)
    """
    check_arguments("read_power_map(path: path, layout: MapLayout | str | None)", path, layout)
    source = Path(path)
    known = map_layout(layout) if isinstance(layout, str) else layout or MapLayout()
    suffix = source.suffix.lower()
    if suffix not in MAP_SUFFIXES:
        raise TorchweatherError(f"{source}: expected {WANTED}; got {suffix or 'no ending'}.")
    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file.")
    content = source.read_bytes()
    try:
        if suffix == ".png":
            found = read_polar_png(source, known)
            record = MapRecord(suffix, content, found.values, found.header)
            record = replace(record, timestamps=found.timestamps, measured=found.measured)
            return RadarPowerMap(found.values, found.axes, found.scale, record, found.notes)
        return _array_map(source, suffix, content, known)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{source}: {error}") from error


def write_power_map(path: str | os.PathLike[str], power_map: RadarPowerMap) -> None:
    """Write a map in the format of its file; an unchanged map gives the same bytes.

    Args:
        path: ``.png`` (bytes over range and azimuth), ``.npy``, ``.npz``; the folder must exist.
        power_map: of `read_power_map`, ``with_values`` after a transform, or one of your own.

    Raises:
        TorchweatherError: the format cannot hold the map.
    """
    check_arguments("write_power_map(path: path, power_map: RadarPowerMap)", path, power_map)
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in MAP_SUFFIXES:
        raise TorchweatherError(f"{target}: expected {WANTED}; got {suffix or 'no ending'}.")
    record = power_map.record if isinstance(power_map.record, MapRecord) else None
    values = power_map.values.detach().cpu()
    if record is not None and record.suffix == suffix and _same(values, record.values):
        with atomic_write(target) as unfinished:
            unfinished.write_bytes(record.content)
        return
    if suffix == ".png":
        _write_picture(target, values, record)
        return
    stored = torch.view_as_real(values) if record is not None and record.quadratures else values
    array = stored.contiguous().numpy()
    if suffix == ".npy":
        with atomic_write(target) as unfinished:
            np.save(unfinished, array, allow_pickle=False)
        return
    if record is not None and record.arrays is not None:
        write_archive(target, {**record.arrays, record.key: array}, compressed=record.compressed)
        return
    axes = {key: np.asarray(value) for key, value in power_map.axes.to_dict().items() if value is not None}
    write_archive(target, {"map": array, **axes, "scale": np.asarray(power_map.scale.kind)})


def _write_picture(target: Path, values: Tensor, record: MapRecord | None) -> None:
    if values.dtype != torch.uint8 or values.ndim != 2:
        raise TorchweatherError(
            f"{target}: a polar picture holds bytes over range and azimuth; got {values.dtype} {tuple(values.shape)}. "
            "Write .npy or .npz."
        )
    header = None if record is None else record.header
    write_image(target, values[None] if header is None else torch.cat([header, values], 1)[None])


def _same(values: Tensor, before: Tensor) -> bool:
    """Check whether numbers are the same bits; NaN is like itself."""
    if values.dtype != before.dtype or values.shape != before.shape:
        return False
    one, other = (torch.view_as_real(v) if v.is_complex() else v for v in (values, before))
    return one.contiguous().numpy().tobytes() == other.contiguous().numpy().tobytes()


def _array_map(source: Path, suffix: str, content: bytes, layout: MapLayout) -> RadarPowerMap:
    arrays: dict[str, npt.NDArray[Any]] | None = None
    key, compressed = "", False
    if suffix == ".npy":
        array = read_array(source, ())
    else:
        arrays, compressed = read_archive(source)
        key = _key(arrays, layout, source)
        array = arrays[key]
        layout = _completed(layout, arrays)
    if array.dtype.kind == "c":
        values = torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", copy=True))
    else:
        values = array_to_tensor(array, source, "a radar map")
    if layout.quadratures:
        if values.ndim < 2 or values.shape[-1] != 2 or values.dtype not in (torch.float32, torch.float64):
            raise TorchweatherError(
                f"{source}: quadratures are a last dimension of 2 of float32 or float64 (real, imaginary); got "
                f"{values.dtype} {tuple(values.shape)}."
            )
        values = torch.view_as_complex(values)
    axes = layout.axes_of(values.shape, source)
    scale = layout.scale_of(is_bytes=values.dtype == torch.uint8, is_complex=values.is_complex(), source=source)
    record = MapRecord(suffix, content, values, None, arrays, key, compressed, layout.quadratures)
    return RadarPowerMap(values, axes, scale, record)


def _key(arrays: dict[str, npt.NDArray[Any]], layout: MapLayout, source: Path) -> str:
    """Name of the map among the arrays of a file."""
    wanted = [layout.key] if layout.key is not None else list(KEYS)
    found = [name for name in wanted if name in arrays]
    others = [name for name in arrays if name not in OTHERS]
    if not found and layout.key is None and len(others) == 1:
        found = others
    if not found:
        raise TorchweatherError(
            f"{source}: expected an array named {' or '.join(wanted)}; got {', '.join(arrays) or 'none'}. Give key "
            "in a layout (YAML)."
        )
    return found[0]


def _completed(layout: MapLayout, arrays: dict[str, npt.NDArray[Any]]) -> MapLayout:
    """The layout with what the file holds and it does not say."""
    found: dict[str, Any] = {}
    if layout.dims is None and "dims" in arrays:
        found["dims"] = tuple(str(name) for name in np.atleast_1d(arrays["dims"]))
    if layout.scale is None and "scale" in arrays:
        found["scale"] = str(arrays["scale"])
    for name in AXES.values():
        if getattr(layout, name) is not None:
            continue
        radians = name.replace("_deg", "_rad")
        if name in arrays:
            found[name] = tuple(np.asarray(arrays[name], np.float64).reshape(-1).tolist())
        elif radians in arrays:
            with np.errstate(over="ignore"):  # infinity is refused as an axis
                found[name] = tuple(np.rad2deg(np.asarray(arrays[radians], np.float64)).reshape(-1).tolist())
    return replace(layout, **found)
