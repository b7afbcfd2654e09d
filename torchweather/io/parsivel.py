"""OTT Parsivel disdrometers: raw spectra from NetCDF files and from telegrams."""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.extras import install_hint
from torchweather.core.inflation import check_inflated
from torchweather.io.drop_spectrum import DropSpectrum, spectrum_from_counts
from torchweather.physics import rain_fall_speed_m_per_s

__all__ = [
    "parsivel_area_mm2",
    "parsivel_edges_mm",
    "parsivel_speeds_m_per_s",
    "read_parsivel_netcdf",
    "read_parsivel_telegrams",
]

# OTT Parsivel operating instructions: 32 classes of diameter and of speed, given by their widths.
_PARSIVEL_DIAMETER_WIDTHS_MM = [0.125] * 10 + [0.25] * 5 + [0.5] * 5 + [1.0] * 5 + [2.0] * 5 + [3.0] * 2
_PARSIVEL_SPEED_WIDTHS_M_PER_S = [0.1] * 10 + [0.2] * 5 + [0.4] * 5 + [0.8] * 5 + [1.6] * 5 + [3.2] * 2
_PARSIVEL_CLASSES = 32
# Laser sheet 180 mm x 30 mm; a drop must lie inside it, which takes half its diameter off each long edge's side:
# A = 180 (30 - D/2) mm^2, Jaffrain & Berne 2011, J. Hydrometeorology 12, 352.
_PARSIVEL_LENGTH_MM, _PARSIVEL_WIDTH_MM = 180.0, 30.0

# Columns of the telegram of the EPFL network (OTT field numbers in brackets).
_TELEGRAM_COLUMNS = 24
_TELEGRAM_TIME, _TELEGRAM_RATE, _TELEGRAM_MOR, _TELEGRAM_SPECTRUM = 3, 6, 11, 22  # -, [01], [08], [93]
_TELEGRAM_INTERVAL_S = 30.0
_LONGEST_LINE = 1 << 20
_STAMP = re.compile(r"\d{2}-\d{2}-\d{4} +\d{2}:\d{2}:\d{2}", re.ASCII)

# Names under which NetCDF files keep the raw Parsivel spectrum, and its class bounds.
_SPECTRUM_NAMES = ("data_raw", "raw_drop_number", "raw_data")
_DIAMETER_BOUNDS = (("diameter_lower_bounds", "diameter_upper_bounds"), ("diameter_bin_lower", "diameter_bin_upper"))
_SPEED_BOUNDS = (("velocity_lower_bounds", "velocity_upper_bounds"), ("velocity_bin_lower", "velocity_bin_upper"))
_INTERVAL_NAMES = ("time_interval", "sample_interval")
_RATE_NAMES = ("rain_intensity", "rainfall_rate_32bit", "rainfall_rate")
_MOR_NAMES = ("MOR", "mor_visibility", "visibility")


def parsivel_edges_mm() -> Tensor:
    """Edges of the 32 diameter classes, mm, ``(33,)`` float64.

    Example:
        >>> parsivel_edges_mm()[[0, 10, 15, -1]]
        tensor([ 0.0000,  1.2500,  2.5000, 26.0000], dtype=torch.float64)
    """
    return torch.tensor([0.0, *_PARSIVEL_DIAMETER_WIDTHS_MM], dtype=torch.float64).cumsum(0)


def parsivel_speeds_m_per_s() -> Tensor:
    """Centres of the 32 speed classes, m/s, ``(32,)`` float64.

    Example:
        >>> parsivel_speeds_m_per_s()[[0, -1]]
        tensor([ 0.0500, 20.8000], dtype=torch.float64)
    """
    edges = torch.tensor([0.0, *_PARSIVEL_SPEED_WIDTHS_M_PER_S], dtype=torch.float64).cumsum(0)
    return 0.5 * (edges[1:] + edges[:-1])


def parsivel_area_mm2(edges_mm: Tensor) -> Tensor:
    """Effective sensing area of an OTT Parsivel for each diameter class, mm^2.

    Example:
        >>> parsivel_area_mm2(torch.tensor([1.0, 3.0]))
        tensor([5220.])
    """
    check_arguments("parsivel_area_mm2(edges_mm: real)", edges_mm)
    check_arguments("parsivel_area_mm2(edges_mm: real(2+))", edges_mm)
    edges_mm = edges_mm if edges_mm.is_floating_point() else edges_mm.float()
    diameter = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    return _PARSIVEL_LENGTH_MM * (_PARSIVEL_WIDTH_MM - 0.5 * diameter)


def read_parsivel_netcdf(source: Path, fall_speed_tolerance: float) -> DropSpectrum:
    """Spectra of a NetCDF-4 file with the raw counts by diameter and speed; see `read_disdrometer`."""
    try:
        import h5netcdf

        with h5netcdf.File(source, "r") as file:
            return _parsivel_from_variables(source, file.variables, dict(file.attrs), fall_speed_tolerance)
    except ImportError as error:  # also from File(): h5netcdf imports without h5py and fails only then
        raise TorchweatherError(f"{source}: NetCDF-4 files need h5netcdf and h5py. {install_hint('io')}") from error
    except TorchweatherError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise TorchweatherError(f"{source}: expected NetCDF; it is truncated or damaged ({error}).") from error


def _parsivel_from_variables(
    source: Path, variables: Any, attributes: dict[str, Any], tolerance: float
) -> DropSpectrum:
    spectrum_name = next((n for n in _SPECTRUM_NAMES if n in variables), None)
    bounds = next((pair for pair in _DIAMETER_BOUNDS if pair[0] in variables and pair[1] in variables), None)
    speeds = next((pair for pair in _SPEED_BOUNDS if pair[0] in variables and pair[1] in variables), None)
    interval = next((n for n in _INTERVAL_NAMES if n in variables), None)
    if spectrum_name is None or bounds is None or speeds is None or interval is None or "time" not in variables:
        raise TorchweatherError(
            f"{source}: expected a Parsivel file with time, {' or '.join(_INTERVAL_NAMES)}, one of "
            f"{', '.join(_SPECTRUM_NAMES)} and the bounds of its classes; got {', '.join(list(variables)[:40])}."
        )
    stored = source.stat().st_size
    for name in (spectrum_name, *bounds, *speeds, interval, "time"):
        check_inflated(source, math.prod(variables[name].shape) * 8, stored)
    lower, upper = (_numbers(variables[name]) for name in bounds)
    speed_lower, speed_upper = (_numbers(variables[name]) for name in speeds)
    counts = _numbers(variables[spectrum_name])
    classes, speed_classes = len(lower), len(speed_lower)
    if counts.ndim != 3 or sorted(counts.shape[1:]) != sorted((classes, speed_classes)):
        raise TorchweatherError(
            f"{source}: expected {spectrum_name} (time, {classes} diameters, {speed_classes} speeds); got "
            f"{counts.shape}."
        )
    edges = torch.from_numpy(np.append(lower, upper[-1]))
    speed = torch.from_numpy(0.5 * (speed_lower + speed_upper))
    oriented = _diameter_first(torch.from_numpy(np.where(np.isnan(counts), 0.0, counts)), edges, speed)
    rate, mor = (next((n for n in names if n in variables), None) for names in (_RATE_NAMES, _MOR_NAMES))
    return spectrum_from_counts(
        oriented,
        edges,
        speed,
        duration_s=float(_numbers(variables[interval])),
        area_mm2=parsivel_area_mm2(edges),
        time_s=torch.from_numpy(_seconds(source, variables["time"])),
        instrument=_text(attributes.get("sensor_long_name") or attributes.get("sensor_type") or "Parsivel"),
        fall_speed_tolerance=tolerance,
        reported_rate_mm_per_h=None if rate is None else torch.from_numpy(_numbers(variables[rate])),
        reported_mor_m=None if mor is None else torch.from_numpy(_numbers(variables[mor])),
    )


def _diameter_first(counts: Tensor, edges: Tensor, speed: Tensor) -> Tensor:
    """Counts ``(T, K, V)``, whichever of the two axes the file calls by the other's name.

    With as many classes of speed as of diameter a swapped file looks the same; but only one way round do most drops
    fall as fast as raindrops.
    """
    if counts.shape[1] != counts.shape[2]:
        return counts if counts.shape[1] == len(edges) - 1 else counts.mT
    law = rain_fall_speed_m_per_s(0.5 * (edges[1:] + edges[:-1]))[:, None]
    as_rain = ((speed - law).abs() <= 0.5 * law).to(counts.dtype)
    total = counts.sum(0)
    return counts.mT if float((total.mT * as_rain).sum()) > float((total * as_rain).sum()) else counts


def read_parsivel_telegrams(source: Path, fall_speed_tolerance: float) -> DropSpectrum:
    """Spectra of telegrams, packed by gzip or not; see `read_disdrometer`."""
    times, rates, visibilities, spectra = [], [], [], []
    try:
        for number, row in enumerate(_telegram_rows(source), start=1):
            if len(row) != _TELEGRAM_COLUMNS:
                raise TorchweatherError(
                    f"{source}: expected a disdrometer file (NetCDF, or telegrams of {_TELEGRAM_COLUMNS} columns); "
                    f"line {number} has {len(row)} columns."
                )
            spectrum = np.fromstring(row[_TELEGRAM_SPECTRUM].rstrip(",") or "0", dtype=np.float64, sep=",")
            # A telegram without drops may leave the spectrum empty.
            spectrum = np.zeros(_PARSIVEL_CLASSES**2) if spectrum.size == 1 else spectrum
            if spectrum.size != _PARSIVEL_CLASSES**2:
                raise TorchweatherError(
                    f"{source}: line {number} has {spectrum.size} classes; expected {_PARSIVEL_CLASSES**2}."
                )
            if not _STAMP.fullmatch(row[_TELEGRAM_TIME].strip()):
                raise InputValueError(f"got the time {row[_TELEGRAM_TIME][:40]!r}")
            day, clock = row[_TELEGRAM_TIME].split()
            times.append("-".join(reversed(day.split("-"))) + "T" + clock)
            rates.append(float(row[_TELEGRAM_RATE]))
            visibilities.append(float(row[_TELEGRAM_MOR]))
            spectra.append(spectrum)
        stamps = np.array(times, dtype="datetime64[s]").astype(np.float64)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise TorchweatherError(
            f"{source}: expected a disdrometer file (NetCDF, or Parsivel telegrams); it is truncated or something else "
            f"({error})."
        ) from error
    if not spectra:
        raise TorchweatherError(f"{source}: expected a disdrometer file; got an empty one.")
    edges = parsivel_edges_mm()
    by_speed = torch.from_numpy(np.stack(spectra)).view(-1, _PARSIVEL_CLASSES, _PARSIVEL_CLASSES)
    return spectrum_from_counts(
        by_speed.mT,  # telegrams run through the diameters of the first speed class, then of the second
        edges,
        parsivel_speeds_m_per_s(),
        duration_s=_TELEGRAM_INTERVAL_S,
        area_mm2=parsivel_area_mm2(edges),
        time_s=torch.from_numpy(stamps),
        instrument="OTT Parsivel",
        fall_speed_tolerance=fall_speed_tolerance,
        reported_rate_mm_per_h=torch.tensor(rates, dtype=torch.float64),
        reported_mor_m=torch.tensor(visibilities, dtype=torch.float64),
    )


def _telegram_rows(source: Path) -> Iterator[list[str]]:
    with source.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    opened: Callable[..., IO[str]] = gzip.open if packed else open
    with opened(source, "rt", encoding="ascii", newline="") as text:
        yield from (row for row in csv.reader(_lines(text, source)) if row)


def _lines(text: IO[str], source: Path) -> Iterator[str]:
    """Lines of a text, none longer than a telegram can be: a packed file may inflate to gigabytes of one line."""
    while line := text.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise TorchweatherError(
                f"{source}: expected telegrams; got a line of more than {_LONGEST_LINE} characters."
            )
        yield line


def _numbers(variable: Any) -> npt.NDArray[np.float64]:
    """Values of a NetCDF variable as float64, NaN where the file has its fill value."""
    values = np.asarray(variable[...])
    fill = variable.attrs.get("_FillValue")
    numbers = values.astype(np.float64)
    if fill is not None:
        numbers[values == np.asarray(fill).astype(values.dtype)] = np.nan
    return numbers


def _seconds(source: Path, variable: Any) -> npt.NDArray[np.float64]:
    """Seconds since 1970 from ``hours since 2024-07-22 00:00:00`` and its like."""
    units = _text(variable.attrs.get("units", ""))
    found = re.match(r"(second|minute|hour|day)s? since (\d{4}-\d{2}-\d{2})(?:[ T](\d{2}:\d{2}:\d{2}))?", units)
    if found is None:
        raise TorchweatherError(f"{source}: expected time as hours since 2024-07-22 or the like; got {units!r}.")
    step = {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0}[found[1]]
    start = np.datetime64(f"{found[2]}T{found[3] or '00:00:00'}", "s").astype(np.float64)
    with np.errstate(over="ignore"):  # what overflows is refused as a time
        return np.asarray(start + step * _numbers(variable))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
