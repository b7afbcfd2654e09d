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
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from parts.link_losses import WET_MM_PER_H, correlation, means, measured_db, quiet_links, step_means
from parts.link_recordings import (
    Array,
    Recording,
    folder_of,
    on_clock,
    radar_rain,
    read_germany,
    read_gothenburg,
    specific_attenuation,
    values,
)
from parts.link_scores import (
    GERMANY,
    GOTHENBURG,
    HALVES,
    HOUR_STEPS,
    Rules,
    cell_statistics,
    held_out_scores,
    root_mean_square,
    spans,
    table,
)


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
