"""Recordings of microwave links and their reference rain on one clock: Germany (pycomlink), Gothenburg (OpenMRG)."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.physics import rain_attenuation_p838_db_per_km

Array = NDArray[Any]
STEP_MIN = 5
MARGIN_MIN = 10
PATH_POINTS = 20  # steps of 0.8 km on the longest path, in radar cells of 2 km
OUTSIDE_KM = 1.5  # half the diagonal of a radar cell is 1.41 km
KM_PER_DEGREE = 111.2  # of latitude


@dataclass(frozen=True)
class Recording:
    """Links and their reference on one clock; losses start ``MARGIN_MIN`` before the reference's first label."""

    loss_db: Array  # transmitted minus received level, (minutes, links)
    rain_mm_per_h: Array  # reference, mean along the path, (steps, links)
    along_mm_per_h: Array  # the same in points along the path, (steps, links, points)
    model_db: Array  # its attenuation by P.838-3, (steps, links)
    frequency_ghz: Array  # (links,)
    length_km: Array  # (links,)
    vertical: Array  # polarisation, 0 horizontal, 1 vertical, (links,)


def values(path: Path, name: str) -> Array:
    """A variable in float64, nan where it holds its fill value; times, and text as it is stored."""
    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        stored, attributes = file.variables[name][...], dict(file.variables[name].attrs)
    if stored.dtype == object:
        return np.array(stored)
    if " since " in str(attributes.get("units")):
        unit, _, start = attributes["units"].partition(" since ")
        ticks = stored.astype({"seconds": "timedelta64[s]", "minutes": "timedelta64[m]"}[unit])
        return np.asarray(np.datetime64(start.replace(" ", "T")) + ticks)
    filled = stored == attributes.get("_FillValue", np.nan)
    scale, offset = (float(attributes.get(key, usual)) for key, usual in (("scale_factor", 1), ("add_offset", 0)))
    return np.where(filled, np.nan, stored.astype(np.float64) * scale + offset)


def on_clock(samples: Array, times: Array, labels: Array) -> Array:
    """Samples at every minute from ``MARGIN_MIN`` before the first label on, nan where there are none."""
    clock = np.full((len(labels) * STEP_MIN + 2 * MARGIN_MIN, samples.shape[1]), np.nan)
    place = (times - labels[0]) // np.timedelta64(1, "m") + MARGIN_MIN
    inside = (place >= 0) & (place < len(clock))
    clock[place[inside]] = samples[inside]
    return clock


def vertical(polarisation: Array) -> Array:
    """0 for ``"h"``, 1 for ``"v"``."""
    return np.array([{"h": 0, "v": 1}[letter.lower()] for letter in polarisation])


def specific_attenuation(rain_mm_per_h: Array, frequency_ghz: Array, polarisation: Array) -> Array:
    """P.838-3 in dB/km on level paths; polarisation ``"h"`` or ``"v"``; nan where the rain is."""
    tilt_rad = vertical(polarisation) * (np.pi / 2)
    rain, frequency, tilt = (torch.from_numpy(x) for x in (np.nan_to_num(rain_mm_per_h), frequency_ghz, tilt_rad))
    gamma = rain_attenuation_p838_db_per_km(rain, frequency, polarisation_tilt_rad=tilt).numpy()
    return np.where(np.isnan(rain_mm_per_h), np.nan, gamma)


def read_germany(folder: Path) -> Recording:
    links, reference = folder / "example_cml_data.nc", folder / "example_path_averaged_reference_data.nc"
    received_dbm, transmitted_dbm = values(links, "rsl")[0].T, values(links, "tsl")[0].T
    valid = (received_dbm > -99.0) & (transmitted_dbm < 250.0)  # -99.9 and 255: no reading
    loss_db = np.where(valid, transmitted_dbm - received_dbm, np.nan)
    frequency_ghz, length_km = values(links, "frequency")[:, 0] / 1e9, values(links, "length")
    rain_mm_per_h = values(reference, "rainfall_amount") * (60.0 / STEP_MIN)  # stored: mm in a step
    polarisation = values(links, "polarization")[:, 0]
    model_db = specific_attenuation(rain_mm_per_h, frequency_ghz, polarisation) * length_km
    loss_db = on_clock(loss_db, values(links, "time"), values(reference, "time"))
    along = rain_mm_per_h[..., None]
    return Recording(loss_db, rain_mm_per_h, along, model_db, frequency_ghz, length_km, vertical(polarisation))


def radar_rain(path: Path, latitude: Array, longitude: Array) -> Array:
    """Rain of the nearest radar cell, mm/h, ``(steps, ...)``; nan outside the map."""
    reflectivity_dbz = values(path, "data")  # not the file's `dBZ`: scale and offset are in it twice
    rain_mm_per_h = (10.0 ** (reflectivity_dbz / 10.0) / 200.0) ** (1.0 / 1.6)  # Z = 200 R^1.6, Marshall and Palmer
    north_km = (latitude[..., None] - values(path, "lat").ravel()) * KM_PER_DEGREE
    east_km = (longitude[..., None] - values(path, "lon").ravel()) * KM_PER_DEGREE
    distance_km = np.hypot(north_km, east_km * np.cos(np.radians(latitude))[..., None])
    nearest = rain_mm_per_h.reshape(len(rain_mm_per_h), -1)[:, distance_km.argmin(-1)]
    return np.where(distance_km.min(-1) < OUTSIDE_KM, nearest, np.nan)


def read_gothenburg(folder: Path) -> Recording:
    links, radar = folder / "openMRG_example.nc", folder / "openMRG_example_rad.nc"
    loss_db = values(links, "tsl")[:, 0] - values(links, "rsl")[:, 0]
    frequency_ghz, length_km = values(links, "frequency")[0] / 1e3, values(links, "length") / 1e3
    along = (np.arange(PATH_POINTS)[:, None] + 0.5) / PATH_POINTS
    first, last = (np.stack([values(links, f"site_{end}_{axis}") for axis in ("lat", "lon")]) for end in (0, 1))
    rain_mm_per_h = radar_rain(radar, *(first[:, None] + along * (last - first)[:, None]))  # (steps, points, links)
    polarisation = values(links, "polarization")[0]
    gamma = specific_attenuation(rain_mm_per_h, frequency_ghz, polarisation)
    loss_db = on_clock(loss_db, values(links, "time"), values(radar, "time"))
    mean, model_db, along = rain_mm_per_h.mean(1), gamma.mean(1) * length_km, rain_mm_per_h.transpose(0, 2, 1)
    return Recording(loss_db, mean, along, model_db, frequency_ghz, length_km, vertical(polarisation))


def folder_of(file: str, given: Path | None) -> Path | None:
    """Where the file lies: in the folder given or one level below it, else by the environment, else in pycomlink."""
    root = given or os.environ.get("TORCHWEATHER_REAL_DATA")
    package = None if given else importlib.util.find_spec("pycomlink")
    places = (package and package.submodule_search_locations) or []
    for folder in [*([Path(root)] if root else []), *(Path(place, "io", "example_data") for place in places)]:
        for path in (*folder.glob(file), *sorted(folder.glob(f"*/{file}"))):
            return path.parent
    return None
