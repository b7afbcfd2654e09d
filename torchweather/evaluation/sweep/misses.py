"""Reasons why a score does not follow its weather: what the numbers of the sweep show, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t

from torchweather.evaluation.sweep.levels import UNITS
from torchweather.evaluation.sweep.series import Floats, Series
from torchweather.evaluation.sweep.trends import Judgement

__all__ = ["explain_miss"]

# One-sided confidence from which a step is more than scatter of the seeds.
CONFIDENCE = 0.95
# A curve whose wrong steps are a small part of its range has levelled off rather than turned.
SMALL_PART = 0.1
# Scores of plain errors, of images and of points.
PLAIN_ERRORS = {"psnr": "the mean squared error", "mde": "the mean distance"}


def explain_miss(series: Series, judgement: Judgement) -> list[str]:
    """Reasons, from the sweep's own numbers, why a score does not show the expected trend.

    Args:
        series: of the scene and weather.
        judgement: of one of its metrics, one that does not follow.

    Returns:
        Sentences: which steps fail and by how much, whether that is within the scatter of the seeds, and what else
        was measured of the data at these steps. Every sentence states what was computed; none is a stock phrase that
        holds without looking.
    """
    if judgement.trend.verdict == "unjudged":
        return ["Fewer than two levels have a score."]
    metric = judgement.metric
    scores = series.scores[metric]
    wrong = [number for number in range(len(scores) - 1) if not _worse(series, metric, number)]
    said = _steps(series, metric, wrong) + _size(series, metric, wrong)
    if metric == "hd":
        said += _one_point(series, judgement)
    elif metric == "hd95":
        said += _share_of_points(series)
    elif metric == "sdm":
        said += _pair_distance(series, wrong)
    said += _others(series, metric, wrong)
    return said


def _means(values: Floats) -> Floats:
    found: Floats = values.mean(1)
    return found


def _worse(series: Series, metric: str, number: int) -> bool:
    before, after = _means(series.worsening(metric))[number : number + 2]
    return bool(after > before)


def _at(series: Series, number: int) -> str:
    return f"{series.levels[number].value:g}"


def _steps(series: Series, metric: str, wrong: Sequence[int]) -> list[str]:
    """The steps that fail: equal, within the scatter of the seeds, or beyond it."""
    groups: dict[str, list[int]] = {}
    for number in wrong:
        groups.setdefault(_kind_of_step(series.scores[metric], number), []).append(number)
    unit = UNITS[series.levels[0].knob]
    said = []
    if "equal" in groups:
        values = {f"{series.scores[metric][number].mean():.4g}" for number in groups["equal"]}
        if len(groups["equal"]) == len(series.levels) - 1:
            said.append(f"It is {values.pop()} at every level and for every seed.")
        else:
            said.append(f"It stays as it is, for every seed, {_listed(series, groups['equal'])} {unit}.")
    for kind, why in WHY.items():
        if kind in groups:
            values_of = series.scores[metric].mean(1)
            steps = " and ".join(
                f"{_listed(series, [number])} {unit} ({values_of[number]:.5g} to {values_of[number + 1]:.5g})"
                for number in groups[kind]
            )
            said.append(f"Its mean goes the wrong way {steps}{why}.")
    return said


WHY = {
    "within": ", by less than the seeds scatter: other seeds may turn it round",
    "beyond": ", by more than the seeds scatter (one-sided 95 %): chance does not explain it",
    "unknown": "",
}


def _kind_of_step(scores: Floats, number: int) -> str:
    before, after = scores[number : number + 2]
    if np.array_equal(before, after):
        return "equal"
    step = after - before
    if len(step) < 2 or not np.isfinite(step).all():
        return "unknown"
    error = float(step.std(ddof=1)) / np.sqrt(len(step))
    return "beyond" if abs(float(step.mean())) > t.ppf(CONFIDENCE, len(step) - 1) * error else "within"


def _listed(series: Series, steps: Sequence[int]) -> str:
    return " and ".join(f"from {_at(series, number)} to {_at(series, number + 1)}" for number in steps)


def _size(series: Series, metric: str, wrong: Sequence[int]) -> list[str]:
    means = _means(series.worsening(metric))
    extent = float(means.max() - means.min())
    if not np.isfinite(extent) or extent <= 0.0:
        return []
    back = sum(max(0.0, float(means[number] - means[number + 1])) for number in wrong)
    if not 0.0 < back <= SMALL_PART * extent:
        return []
    return [f"The wrong steps together are {100 * back / extent:.2g} % of its range over all levels: it levels off."]


def _one_point(series: Series, judgement: Judgement) -> list[str]:
    scores = series.scores["hd"]
    if scores.shape[1] < 2 or not np.isfinite(scores).all():
        return ["HD is the distance of a single point."]
    spread = float(scores.std(1, ddof=1).mean())
    step = float(np.abs(np.diff(scores.mean(1))).mean())
    text = f"HD is the distance of a single point: it differs by {spread:.2g} m between seeds (standard deviation), by "
    text += f"{step:.2g} m between neighbouring levels."
    if judgement.page_p is not None:
        text += (
            f" Seeds that ranked the levels at random would agree as much with a probability of {judgement.page_p:.2g}."
        )
    return [text]


def _share_of_points(series: Series) -> list[str]:
    """A 95th percentile of 0 says how few points have changed."""
    zero = [number for number, row in enumerate(series.scores["hd95"]) if not row.any()]
    if not zero:
        return []
    unit = UNITS[series.levels[0].knob]
    where = "every level" if len(zero) == len(series.levels) else f"{', '.join(_at(series, n) for n in zero)} {unit}"
    text = f"At {where} at least 95 % of the points of either cloud have a point of the other in the same place"
    return [f"{text}: the 95th percentile of the distances is 0."]


def _pair_distance(series: Series, wrong: Sequence[int]) -> list[str]:
    if "pair_distance_m" not in series.facts:
        return []
    distance, clear = series.facts["pair_distance_m"].mean(1), series.clear["pair_distance_m"]
    listed = ", ".join(f"{value:.4g}" for value in distance)
    text = f"SDM compares the distances between two points of a cloud: {clear:.4g} m in clear air in the mean, "
    said = [f"{text}{listed} m at the levels."]
    apart = np.abs(distance - clear)
    if wrong and all(apart[number + 1] < apart[number] for number in wrong):
        said.append("At the steps that fail it comes nearer to that of clear air again.")
        range_m = series.facts["range_m"].mean(1)
        farther = bool(distance[0] < clear) and all(range_m[number + 1] > range_m[number] for number in wrong)
        if farther:
            listed = ", ".join(f"{value:.3g}" for value in range_m)
            said.append(f"The points lie farther out there: their median range is {listed} m at the levels.")
    return said


def _others(series: Series, metric: str, wrong: Sequence[int]) -> list[str]:
    """Check whether the plain error goes on rising where this score does not."""
    plain = next((one for one in PLAIN_ERRORS if one in series.scores), metric)
    if metric == plain or not wrong:
        return []
    name = PLAIN_ERRORS[plain]
    rises = [number for number in wrong if _worse(series, plain, number)]
    if len(rises) == len(wrong):
        return [f"The data do differ more at each of these steps: {name} rises."]
    if not rises:
        return [f"At these steps {name} does not rise either."]
    return [f"Of these {len(wrong)} steps, {name} rises at {len(rises)}."]
