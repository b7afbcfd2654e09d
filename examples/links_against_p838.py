"""Hold ITU-R P.838-3 against the attenuation that microwave links measured in rain; nothing is fitted.

    TORCHWEATHER_REAL_DATA=/data python examples/links_against_p838.py     # /data/cml_germany, /data/cml_openmrg
    python examples/links_against_p838.py --data folder-with-the-nc-files
    python examples/links_against_p838.py                                  # Germany, where pycomlink is installed

500 links in Germany over ten days (example data of pycomlink, with the radar's path mean), 364 in Gothenburg over half
a day (OpenMRG, with radar cells and gauges), 7 to 39 GHz. Prints, as Markdown, the conditional bias by rain rate and
path length, the RMSE of 5-min values and hourly means, and how well the reference is known. Needs ``torchweather[io]``.

Measured is the total loss minus its dry baseline; model is k R^alpha L with each link's frequency and polarisation, in
Gothenburg k R^alpha averaged along the path. Links are chosen by their noise in dry air alone. ``docs/links.md``.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.physics import rain_attenuation_p838_db_per_km

Array = NDArray[Any]
STEP_MIN, HOUR_STEPS = 5, 12
WET_MM_PER_H = 0.1
HEAVY_MM_PER_H = 2.0  # correlations are of rain above
FIRST_MINUTES = (-10, -5, 0, 5)  # of a step after its label: -5 is a label at its end, 0 at its start
MARGIN_MIN = 10
GAP_MIN = 5  # longest that is interpolated
NEAR_RAIN_STEPS = 3  # 15 min
MEDIAN_STEPS, CARRIED_STEPS = 36, 72  # 3 h, 6 h
MEDIAN_SAMPLES, DRY_SAMPLES = 5, 8  # dry ones at least: in those 3 h; on a link, to tell its noise
NOISE_DB = 0.8
BAND_GHZ = (10.0, 40.0)
CELL_SAMPLES, HALVES = 30, 10  # a cell needs more
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


@dataclass(frozen=True)
class Rules:
    """What differs between the two sets."""

    rain_edges_mm_per_h: tuple[float, ...]
    length_edges_km: tuple[float, ...]
    longer_than_km: float = 0.0
    alternate_days: bool = False


GERMANY = Rules((0.1, 0.5, 1.0, 2.0, 5.0, 20.0), (0.5, 3.0, 5.0, 8.0, 12.0, 30.0), 0.5, alternate_days=True)
GOTHENBURG = Rules((0.1, 0.5, 1.0, 2.0, 5.0, 20.0, 30.0), (0.0, 1.0, 2.0, 4.0, 20.0))


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


def last_row(valid: Array) -> Array:
    """The row of the last valid entry so far, ``(rows, links)``; far before the first where there is none."""
    rows = np.where(valid, np.arange(len(valid))[:, None], -(10**9))
    return np.maximum.accumulate(rows, axis=0)


def close_gaps(loss_db: Array, longest: int = GAP_MIN) -> Array:
    """Linear over gaps of up to ``longest`` rows; longer ones stay nan."""
    valid = np.isfinite(loss_db)
    before, after = last_row(valid), len(valid) - 1 - last_row(valid[::-1])[::-1]
    row, link = np.nonzero(~valid & (after - before - 1 <= longest))
    first, last = before[row, link], after[row, link]
    share = (row - first) / (last - first)
    closed = loss_db.copy()
    closed[row, link] = (1.0 - share) * loss_db[first, link] + share * loss_db[last, link]
    return closed


def means(samples: Array, number: int) -> Array:
    """Means of ``number`` rows each, of what there is; nan where there is nothing."""
    parts = samples[: len(samples) // number * number].reshape(-1, number, samples.shape[1])
    return np.asarray(np.ma.masked_invalid(parts).mean(1).filled(np.nan))


def step_means(samples: Array, first_minute: int) -> Array:
    """5-min means, ``(steps, links)``, of minutes as ``on_clock`` gives them."""
    return means(samples[MARGIN_MIN + first_minute : len(samples) - MARGIN_MIN + first_minute], STEP_MIN)


def dry_steps(rain_mm_per_h: Array) -> Array:
    """More than 15 min from any rain above ``WET_MM_PER_H``; where the reference is missing, it may rain."""
    wet = np.pad(~(rain_mm_per_h <= WET_MM_PER_H), ((NEAR_RAIN_STEPS, NEAR_RAIN_STEPS), (0, 0)))
    return np.asarray(~np.any([wet[k : k + len(rain_mm_per_h)] for k in range(2 * NEAR_RAIN_STEPS + 1)], axis=0))


def baseline_db(loss_db: Array, dry: Array) -> Array:
    """Median of the dry samples of the last 3 h, carried forward up to 6 h; nan where they are too few."""
    padded = np.pad(np.where(dry, loss_db, np.nan), ((MEDIAN_STEPS - 1, 0), (0, 0)), constant_values=np.nan)
    window = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_STEPS, 0)
    median = np.full_like(loss_db, np.nan)
    for link in range(loss_db.shape[1]):  # one at a time: all together take gigabytes
        ordered = np.sort(window[:, link])  # nan last
        number = np.isfinite(ordered).sum(1)
        middle = np.stack([np.maximum(number - 1, 0) // 2, number // 2], 1)
        median[:, link] = np.where(number < MEDIAN_SAMPLES, np.nan, np.take_along_axis(ordered, middle, 1).mean(1))
    last = last_row(np.isfinite(median))
    age = np.arange(len(median))[:, None] - last
    return np.where(age <= CARRIED_STEPS, np.take_along_axis(median, np.maximum(last, 0), 0), np.nan)


def correlation(samples: Array, rain_mm_per_h: Array) -> float:
    """Of the samples with the rain, where it is above ``HEAVY_MM_PER_H``."""
    both = (rain_mm_per_h > HEAVY_MM_PER_H) & np.isfinite(samples)
    return float(np.corrcoef(samples[both], rain_mm_per_h[both])[0, 1])


def measured_db(recording: Recording) -> tuple[Array, int]:
    """Loss minus baseline, ``(steps, links)``, under the label that correlates best with the reference; that label."""
    dry = dry_steps(recording.rain_mm_per_h)
    closed = close_gaps(recording.loss_db)
    losses_db = {first_minute: step_means(closed, first_minute) for first_minute in FIRST_MINUTES}
    found = [(loss_db - baseline_db(loss_db, dry), first_minute) for first_minute, loss_db in losses_db.items()]
    return max(found, key=lambda one: correlation(one[0], recording.rain_mm_per_h))


def quiet_links(recording: Recording, attenuation_db: Array, longer_than_km: float) -> Array:
    """Links in the band whose dry samples scatter by less than ``NOISE_DB``, ``(links,)``."""
    dry = dry_steps(recording.rain_mm_per_h)
    noise_db = np.ma.masked_array(attenuation_db, ~dry | np.isnan(attenuation_db)).std(0).filled(np.inf)
    in_band = (recording.frequency_ghz >= BAND_GHZ[0]) & (recording.frequency_ghz <= BAND_GHZ[1])
    known = (dry.sum(0) >= DRY_SAMPLES) & (noise_db < NOISE_DB)
    return np.asarray(in_band & known & (recording.length_km > longer_than_km))


def root_mean_square(error: Array) -> float:
    return float(np.sqrt((error**2).mean()))


def cell_statistics(recording: Recording, error: Array, judged: Array, rules: Rules) -> tuple[Array, Array, Array]:
    """Number, mean and standard deviation of the judged errors, each ``(rain cells, length cells)``."""
    edges = rules.rain_edges_mm_per_h, rules.length_edges_km
    rain, length, off = (x[judged] for x in np.broadcast_arrays(recording.rain_mm_per_h, recording.length_km, error))
    number, total, squares = (np.histogram2d(rain, length, edges, weights=w)[0] for w in (None, off, off**2))
    with np.errstate(invalid="ignore"):  # 0 / 0 in an empty cell
        mean = total / number
        return number, mean, np.sqrt(np.maximum(squares / number - mean**2, 0.0))


def conditional_bias_db(number: Array, mean: Array) -> float:
    """Mean over the cells of the absolute mean error."""
    return float(np.abs(mean[number > CELL_SAMPLES]).mean())


def scores(recording: Recording, error: Array, judged: Array, rules: Rules) -> tuple[float, float, float]:
    """RMSE of 5-min values in rain and of the means of hours with rain, conditional bias; of the judged samples."""
    wet = judged & (recording.rain_mm_per_h > WET_MM_PER_H)
    hours, rain = (means(np.where(judged, x, np.nan), HOUR_STEPS) for x in (error, recording.rain_mm_per_h))
    number, mean, _ = cell_statistics(recording, error, judged, rules)
    return root_mean_square(error[wet]), root_mean_square(hours[rain > WET_MM_PER_H]), conditional_bias_db(number, mean)


def odd_days(steps: int) -> Array:
    """``(steps, 1)``, the second day and every other one from there."""
    return np.asarray(np.arange(steps)[:, None] // (24 * HOUR_STEPS) % 2 == 1)


def held_out_links(chosen: Array, seed: int) -> Array:
    """A random half of the chosen links, ``(links,)``."""
    picked = np.random.default_rng(seed).permutation(np.flatnonzero(chosen))[: int(chosen.sum()) // 2]
    return np.isin(np.arange(chosen.size), picked)


def held_out_scores(recording: Recording, error: Array, known: Array, chosen: Array, rules: Rules) -> Array:
    """``scores`` of random halves of the chosen links, every other day where the rules say so, ``(HALVES, 3)``."""
    judged = known & (odd_days(len(error)) | (not rules.alternate_days))
    return np.array([scores(recording, error, judged & held_out_links(chosen, seed), rules) for seed in range(HALVES)])


def table(head: list[str], lines: list[list[str]]) -> None:
    print()
    for line in (head, ["---"] * len(head), *lines):
        print(f"| {' | '.join(line)} |")


def spans(edges: tuple[float, ...], unit: str) -> list[str]:
    return [f"{low:g} to {high:g} {unit}" for low, high in pairwise(edges)]


def report(name: str, recording: Recording, rules: Rules) -> tuple[Array, int]:
    """Prints scores, noise of the reference and cells of one set; returns the links chosen and the label."""
    attenuation_db, first_minute = measured_db(recording)
    rain_mm_per_h, model_db = recording.rain_mm_per_h, recording.model_db
    chosen = quiet_links(recording, attenuation_db, rules.longer_than_km)
    error = model_db - attenuation_db
    known = chosen & np.isfinite(error)
    wet = known & (rain_mm_per_h > WET_MM_PER_H)
    print(f"\n## {name}\n\n{chosen.sum()} of {chosen.size} links, {wet.sum()} wet samples.")
    print(f"The reference's steps start {first_minute} min after their labels.")

    found = held_out_scores(recording, error, known, chosen, rules)
    lines = zip(("5-min RMSE", "hourly RMSE", "conditional bias"), found.mean(0), found.std(0), strict=True)
    table([f"held out, {HALVES} random halves", "dB"], [[label, f"{mean:.2f} ± {sd:.2f}"] for label, mean, sd in lines])

    samples, rain = (np.where(known, x, np.nan) for x in (attenuation_db, rain_mm_per_h))
    change_db = np.diff(model_db, axis=0)[wet[1:] & np.isfinite(model_db[:-1])]
    noise = {
        "measured attenuation and rain above 2 mm/h, correlation": correlation(samples, rain),
        "the same, hourly": correlation(means(samples, HOUR_STEPS), means(rain, HOUR_STEPS)),
        "model against itself 5 min later, RMSE in dB": root_mean_square(change_db),
    }
    table(["how well the reference is known", ""], [[label, f"{number:.2f}"] for label, number in noise.items()])

    cells = np.stack(cell_statistics(recording, error, known, rules), -1)
    print("\nModel minus measured in dB: mean, standard deviation (samples).")
    rows = [[f"{mean:+.2f}, {sd:.2f} ({number:.0f})" for number, mean, sd in line] for line in cells]
    rows = [[label, *line] for label, line in zip(spans(rules.rain_edges_mm_per_h, "mm/h"), rows, strict=True)]
    table(["rain", *spans(rules.length_edges_km, "km")], rows)
    return chosen, first_minute


def report_gauges(folder: Path, first_minute: int, frequency_ghz: float) -> None:
    """The radar above the gauges of the city, and what the difference is worth in attenuation."""
    gauges, radar = folder / "openMRG_city_gauges_20150827.nc", folder / "openMRG_example_rad.nc"
    above = radar_rain(radar, values(gauges, "lat"), values(gauges, "lon"))
    rate = on_clock(60.0 * values(gauges, "rainfall_amount"), values(gauges, "time"), values(radar, "time"))
    gauge = step_means(rate, first_minute)
    steps, hours = correlation(gauge, above), correlation(means(gauge, HOUR_STEPS), means(above, HOUR_STEPS))
    print(f"\nRadar above {gauge.shape[1]} gauges, rain above 2 mm/h: correlation {steps:.2f}, hourly {hours:.2f}.")
    gamma = [specific_attenuation(rain, np.array([frequency_ghz]), np.array(["v"])) for rain in (gauge, above)]
    rows = []
    for low, high in pairwise(GOTHENBURG.rain_edges_mm_per_h):
        cell = (above >= low) & (above < high) & np.isfinite(gauge)
        if cell.any():
            off, off_db = (gauge - above)[cell], (gamma[0] - gamma[1])[cell]
            numbers = [above[cell].mean(), gauge[cell].mean(), off.std(), off_db.mean(), off_db.std()]
            rows.append([*spans((low, high), "mm/h"), str(off.size), *(f"{number:.2f}" for number in numbers)])
    attenuation = f"the same in dB/km at {frequency_ghz:.0f} GHz, mean"
    table(["radar", "samples", "mean radar", "mean gauge", "gauge - radar, s.d.", attenuation, "s.d."], rows)


def folder_of(file: str, given: Path | None) -> Path | None:
    """Where the file lies: in the folder given or one level below it, else by the environment, else in pycomlink."""
    root = given or os.environ.get("TORCHWEATHER_REAL_DATA")
    package = None if given else importlib.util.find_spec("pycomlink")
    places = (package and package.submodule_search_locations) or []
    for folder in [*([Path(root)] if root else []), *(Path(place, "io", "example_data") for place in places)]:
        for path in (*folder.glob(file), *sorted(folder.glob(f"*/{file}"))):
            return path.parent
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of the .nc files or above it; else TORCHWEATHER_REAL_DATA")
    given = parser.parse_args().data
    germany, gothenburg = (folder_of(file, given) for file in ("example_cml_data.nc", "openMRG_example.nc"))
    if not germany and not gothenburg:
        sys.exit(
            "no link files: give --data FOLDER with example_cml_data.nc or openMRG_example.nc in it or one level "
            "below, set TORCHWEATHER_REAL_DATA to such a folder, or install pycomlink, which ships the first"
        )
    if germany:
        report("Germany", read_germany(germany), GERMANY)
    if gothenburg:
        recording = read_gothenburg(gothenburg)
        chosen, first_minute = report("Gothenburg", recording, GOTHENBURG)
        report_gauges(gothenburg, first_minute, float(np.median(recording.frequency_ghz[chosen])))
    if not (germany and gothenburg):
        print(f"\nThe files of {'Gothenburg' if germany else 'Germany'} were not found.")


if __name__ == "__main__":
    main()
