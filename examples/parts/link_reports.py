"""Tables beside the answer of a search on links: rivals, the least bias there is, what the noise is of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from parts.link_losses import WET_MM_PER_H
from parts.link_recordings import Array
from parts.link_scores import CELL_SAMPLES, cell_statistics, conditional_bias_db, table
from parts.link_search import Held, fitted_rain_factor, said

from torchweather.gap import GapReport, find_gap
from torchweather.radar.effects.all import RadarPathLossScale
from torchweather.stages import EFFECTS

PATH_SCALE = RadarPathLossScale.id
REFERENCE_SDS = (0.0, 0.1, 0.3)  # relative, of the reference's mean rain


def spread(values: Array) -> str:
    """Mean and standard deviation over the halves."""
    return f"{values.mean():.2f} ± {values.std():.2f}"


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
        f"{dry:.2f} dB is what the links scatter in dry air. The rest, {rest:.2f} dB or {share:.0f} % of the variance, "
        "comes and goes with the rain: above all what falls on the path and the reference does not see."
    )
