"""Find out what microwave links lose beside the rain on their path: the search for a missing effect on real data.

    TORCHWEATHER_REAL_DATA=/data python examples/gap_wet_antenna.py      # /data/cml_openmrg, /data/cml_germany
    python examples/gap_wet_antenna.py --data folder-with-the-nc-files --halves 3 --out pages
    python examples/gap_wet_antenna.py --reference-sd 0.1     # the reference's mean rain may be off by a tenth

The links, the measured attenuation and the scores are those of ``links_against_p838.py``. The search is told nothing of
what to look for: it gets half of the links (in Germany on every other day) and answers; what it found is then added to
the model and judged on the other half. Printed, for each set: what it found, the scores before and after, as means over
seeded halves, how a scale of the path would rank, what a reference that is off would change, what no offset
betters, how much of what is left is the reference's own noise; for Germany also what the film of Gothenburg would do
there. ``--out`` writes the page of the first half. Needs ``torchweather[io]``; ``docs/links.md``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from links_against_p838 import (
    CELL_SAMPLES,
    GERMANY,
    GOTHENBURG,
    HALVES,
    STEP_MIN,
    WET_MM_PER_H,
    Array,
    Recording,
    Rules,
    cell_statistics,
    conditional_bias_db,
    dry_steps,
    folder_of,
    held_out_links,
    measured_db,
    odd_days,
    quiet_links,
    read_germany,
    read_gothenburg,
    scores,
    table,
)

from torchweather.gap import GapReport, Study, find_gap
from torchweather.physics import rain_attenuation_coefficients, wet_cover_series_db
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects.all import RadarPathLossScale, RadarWetRadome
from torchweather.report.gap_page import write_gap
from torchweather.stages import EFFECTS

SCORES = ("5-min RMSE", "hourly RMSE", "conditional bias")
PATH_SCALE = RadarPathLossScale.id
REFERENCE_SDS = (0.0, 0.1, 0.3)  # relative, of the reference's mean rain


def study_of(
    recording: Recording, attenuation_db: Array, chosen: Array, held: Array, rules: Rules, reference_sd: float = 0.0
) -> Study:
    """The chosen links as a study: those of the half held out, where the rules say so on the days held out.

    ``reference_sd``: relative standard deviation of the reference's mean rain.
    """
    odd = odd_days(len(attenuation_db))

    def condition(name: str, on: Array | bool, split: str | None) -> dict[str, Any]:
        frame = {
            "time_s": 60.0 * STEP_MIN * np.arange(len(attenuation_db)),
            "attenuation_db": np.where(on, attenuation_db, np.nan)[:, chosen],
            "rain_mm_per_h": recording.along_mm_per_h[:, chosen],
        }
        return {"id": name, "frames": [frame], "split": split, "rel_sd": reference_sd}

    days = [condition("even days", ~odd, "fit"), condition("odd days", odd, "holdout")]
    return Study.from_arrays(
        kind="link",
        links={
            "length_km": recording.length_km[chosen],
            "frequency_ghz": recording.frequency_ghz[chosen],
            "polarisation": recording.vertical[chosen],
            "split": held[chosen].astype(int),
        },
        conditions=days if rules.alternate_days else [condition("all", True, None)],
    )


def fitted_rain_factor(found: GapReport, rain_mm_per_h: Array) -> Array:
    """What the search takes the reference's rain to be times: a factor for each class of rain, 1 where it is exact."""
    fitted = found.answer["nuisance"]["by_condition"]  # "0.1 to 0.5 mm/h", ..., "20 mm/h and more", "after rain"
    classes = sorted((float(label.split()[0]), factor) for label, factor in fitted.items() if "mm/h" in label)
    lows, factors = np.array(classes).T
    place = np.searchsorted(lows, np.nan_to_num(rain_mm_per_h), side="right")
    return np.array([1.0, *factors])[place]


def with_effects(recording: Recording, effects: Sequence[Effect], rain_factor: Array | float = 1.0) -> Array:
    """Attenuation by P.838-3 with effects, dB ``(steps, links)``, the reference's rain on the path times a factor."""
    known = rain_attenuation_coefficients(torch.from_numpy(recording.frequency_ghz))
    exponent = np.where(recording.vertical == 1, known.alpha_vertical, known.alpha_horizontal)
    total_db = recording.model_db * rain_factor**exponent
    for effect in effects:
        if isinstance(effect, RadarPathLossScale):
            total_db = total_db * float(effect.factor)
        elif isinstance(effect, RadarWetRadome):
            rain = np.nan_to_num(np.where(recording.rain_mm_per_h < WET_MM_PER_H, 0.0, recording.rain_mm_per_h))
            time_min = STEP_MIN * torch.arange(len(rain), dtype=torch.float64)
            series = torch.from_numpy(rain.T.copy())
            drying = float(effect.drying_min)
            film = wet_cover_series_db(
                series, time_min, 0.0, float(effect.film_db), float(effect.film_exponent), drying
            )
            wet = wet_cover_series_db((series > 0).double(), time_min, 0.0, float(effect.loss_db), 0.0, drying)
            total_db = total_db + (film + wet).numpy().T
    return total_db


def said(effect: Effect | dict[str, Any]) -> str:
    """An effect with its parameters in a line."""
    values = effect if isinstance(effect, dict) else effect.to_dict()
    numbers = {key: value for key, value in values.items() if key != "effect"}
    return f"{values['effect']}({', '.join(f'{key} = {value:.2f}' for key, value in numbers.items())})"


class Held:
    """A set of links with its halves: what was measured, and how a model is judged."""

    def __init__(self, recording: Recording, rules: Rules) -> None:
        self.recording, self.rules = recording, rules
        self.attenuation_db, _ = measured_db(recording)
        self.chosen = quiet_links(recording, self.attenuation_db, rules.longer_than_km)
        self.known = np.isfinite(recording.model_db - self.attenuation_db)
        odd = odd_days(len(self.attenuation_db))
        self.days, self.searched_days = (odd, ~odd) if rules.alternate_days else (odd | True, odd | True)

    def study(self, seed: int, reference_sd: float) -> Study:
        half = held_out_links(self.chosen, seed)
        return study_of(self.recording, self.attenuation_db, self.chosen, half, self.rules, reference_sd)

    def judged(self, seed: int) -> Array:
        return self.known & self.days & held_out_links(self.chosen, seed)

    def searched(self, seed: int) -> Array:
        return self.known & self.searched_days & self.chosen & ~held_out_links(self.chosen, seed)

    def scores(
        self, effects: Sequence[Effect], seed: int, rain_factor: Array | float = 1.0
    ) -> tuple[float, float, float]:
        error = with_effects(self.recording, effects, rain_factor) - self.attenuation_db
        return scores(self.recording, error, self.judged(seed), self.rules)

    def scores_of(self, found: GapReport, seed: int) -> tuple[float, float, float]:
        return self.scores(found.effects, seed, fitted_rain_factor(found, self.recording.rain_mm_per_h))

    def dry_noise_db(self) -> float:
        dry = dry_steps(self.recording.rain_mm_per_h) & np.isfinite(self.attenuation_db) & self.chosen
        return float(self.attenuation_db[dry].std())


def spread(values: Array) -> str:
    """Mean and standard deviation over the halves."""
    return f"{values.mean():.2f} ± {values.std():.2f}"


def report(name: str, held: Held, halves: int, reference_sd: float, out: Path | None) -> list[GapReport]:
    """Searches and judges each half of a set; returns the answers."""
    print(f"\n## {name}\n\n{held.chosen.sum()} links; searched on one half of them, judged on the other.")
    if reference_sd:
        print(f"The reference's mean rain in each class may be off by {100.0 * reference_sd:g} %.")
    answers = [find_gap(held.study(seed, reference_sd)) for seed in range(halves)]
    if out is not None:
        write_gap(out / name.lower(), held.study(0, reference_sd), answers[0])

    table(
        ["half", "verdict", "effects", "gap before", "after", "floor"],
        [
            [
                str(seed),
                one.verdict,
                "; ".join(said(effect) for effect in one.effects) or "none",
                *(f"{one.answer['gap'][key]:.2f}" for key in ("before", "after", "floor")),
            ]
            for seed, one in enumerate(answers)
        ],
    )
    before = np.array([held.scores((), seed) for seed in range(halves)])
    after = np.array([held.scores_of(one, seed) for seed, one in enumerate(answers)])
    rows = [[label, spread(old), spread(new)] for label, old, new in zip(SCORES, before.T, after.T, strict=True)]
    table([f"held out, {halves} halves, dB", "P.838-3", "with what was found"], rows)
    for effect in answers[0].effects:
        if isinstance(effect, RadarWetRadome):
            low, high = answers[0].answer["effects"][0]["interval"]["drying_min"]
            print(f"\nOf the loss a tenth is left {2.3 * float(effect.drying_min):.0f} min after the rain", end=" ")
            print(f"({2.3 * low:.0f} to {2.3 * high:.0f} min).")
    return answers


def report_rivals(held: Held, found: GapReport, reference_sd: float) -> None:
    """Why a scale of the path ranks below, and what an uncertain reference changes; on the first half."""
    path = find_gap(held.study(0, reference_sd), effects=[PATH_SCALE])
    rows = []
    for one in (found, path):
        best = one.answer["candidates"][:1]
        gain, misfit = (f"{best[0][key]:.0f}" if best else "" for key in ("gain", "misfit"))
        fitted = [EFFECTS[entry["name"]](**entry["parameters"]) for entry in best]
        _, _, bias = held.scores(fitted, 0)
        effects = "; ".join(said(effect) for effect in fitted) or "nothing"
        rows.append([effects, one.verdict, gain, misfit, f"{one.answer['gap']['after']:.2f}", f"{bias:.2f}"])
    table(["first half", "verdict", "explains", "leaves", "gap held out", "conditional bias of it alone, dB"], rows)
    print("\nExplained and left over: squared departures in units of their scatter.")

    rows = []
    for sd in REFERENCE_SDS:
        one = find_gap(held.study(0, sd))
        factors = fitted_rain_factor(one, held.recording.rain_mm_per_h)[held.recording.rain_mm_per_h >= WET_MM_PER_H]
        times = f"{factors.min():.2f} to {factors.max():.2f}"
        bias = f"{held.scores_of(one, 0)[2]:.2f}"
        rows.append([f"{100 * sd:.0f} %", "; ".join(map(said, one.effects)) or "nothing", times, bias])
    table(["the reference's mean rain may be off by", "found", "its rain times", "conditional bias then, dB"], rows)


def least_biases_db(number: Array, mean: Array, searched: Array) -> tuple[float, float]:
    """Conditional biases that are left by the best constant there is, and by what the cells searched are off by.

    A constant moves the mean error of every cell alike, so the best one is their median: it is chosen with the answer
    in hand. The other model has a parameter for every cell.
    """
    best = np.median(mean[number > CELL_SAMPLES])
    return conditional_bias_db(number, mean - best), conditional_bias_db(number, mean - searched)


def report_least(held: Held, halves: int) -> None:
    """What the best offset leaves, and a table of what each cell of rain and length is off by."""
    error, found = held.recording.model_db - held.attenuation_db, []
    for seed in range(halves):
        judged, searched = held.judged(seed), held.searched(seed)
        number, mean, _ = cell_statistics(held.recording, error, judged, held.rules)
        found.append(least_biases_db(number, mean, cell_statistics(held.recording, error, searched, held.rules)[1]))
    constant, cells = np.array(found).T
    table(
        [f"held out, {halves} halves", "conditional bias, dB"],
        [
            ["the best constant there, known from what is held out", spread(constant)],
            ["what each cell of rain and length of the searched half is off by", spread(cells)],
        ],
    )


def report_noise(held: Held, answers: Sequence[GapReport]) -> None:
    """How much of what is left is the links', and how much the reference's."""
    rmse = np.array([held.scores_of(one, seed) for seed, one in enumerate(answers)]).mean(0)
    dry = held.dry_noise_db()
    rest = float(np.sqrt(max(rmse[0] ** 2 - rmse[2] ** 2 - dry**2, 0.0)))
    share = 100.0 * rest**2 / rmse[0] ** 2
    print(
        f"\nOf a 5-min RMSE of {rmse[0]:.2f} dB a conditional bias of {rmse[2]:.2f} dB is left of the model, and "
        f"{dry:.2f} dB is what the links scatter in dry air. The rest, {rest:.2f} dB or {share:.0f} % in square, comes "
        "and goes with the rain: above all what falls on the path and the reference does not see."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of the .nc files or above it; else TORCHWEATHER_REAL_DATA")
    parser.add_argument("--halves", type=int, default=HALVES, help="random halves of the links (default 10)")
    parser.add_argument(
        "--reference-sd",
        type=float,
        default=0.0,
        help="what the reference's mean rain in a class may be off by, relative (default 0: it counts as exact)",
    )
    parser.add_argument("--out", type=Path, help="folder for the page of the first half of each set")
    given = parser.parse_args()
    if given.halves < 1:
        parser.error(f"--halves: wanted 1 or more; got {given.halves}")
    if not 0.0 <= given.reference_sd < 1.0:
        parser.error(f"--reference-sd: wanted a relative standard deviation in 0..1; got {given.reference_sd:g}")
    gothenburg, germany = (folder_of(file, given.data) for file in ("openMRG_example.nc", "example_cml_data.nc"))
    if not germany and not gothenburg:
        sys.exit(
            "no link files: give --data FOLDER with openMRG_example.nc or example_cml_data.nc in it or one level "
            "below, set TORCHWEATHER_REAL_DATA to such a folder, or install pycomlink, which ships the second"
        )
    film: Sequence[Effect] = ()
    for name, folder, read, rules in (
        ("Gothenburg", gothenburg, read_gothenburg, GOTHENBURG),
        ("Germany", germany, read_germany, GERMANY),
    ):
        if folder is None:
            print(f"\nThe files of {name} were not found.")
            continue
        held = Held(read(folder), rules)
        answers = report(name, held, given.halves, given.reference_sd, given.out)
        report_rivals(held, answers[0], given.reference_sd)
        report_least(held, given.halves)
        report_noise(held, answers)
        if film:
            other = np.array([held.scores(film, seed) for seed in range(given.halves)])
            print(f"\nWith the film of Gothenburg, {said(film[0])}, {name} would have:")
            table(
                [f"held out, {given.halves} halves", "dB"],
                [[label, spread(one)] for label, one in zip(SCORES, other.T, strict=True)],
            )
        film = answers[0].effects


if __name__ == "__main__":
    main()
