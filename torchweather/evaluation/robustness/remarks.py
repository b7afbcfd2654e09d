"""Sentences that a reader of a robustness result needs: few frames, guessed depth, performance above clear air."""

from __future__ import annotations

import math

from torchweather.camera.depth import GUESSED
from torchweather.evaluation.robustness.intervals import Interval
from torchweather.evaluation.robustness.result import ConditionResult, RobustnessResult

__all__ = ["FEW_FRAMES", "headline_of_depth", "interval_text", "remarks"]

FEW_TRUTHS = 10  # one box more or less found is then a recall of 0.1 or more
FEW_FRAMES = 30
"""Below it 95 % percentile intervals of AP hold the true value too seldom: in 79 % of draws of 5 simulated frames, 89 %
of 13, 93 % of 30 and of 200 (2.7 truths and 2 false alarms a frame, AP 0.85, 400 draws each)."""


def headline_of_depth(result: RobustnessResult) -> str:
    """``depth guessed`` where it is, for headlines; else empty."""
    return "depth guessed" if result.depth == GUESSED else ""


def interval_text(interval: Interval | None) -> str:
    """``0.61 to 0.82``, or empty."""
    return "" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}"


def remarks(result: RobustnessResult) -> list[str]:
    """Sentences about the result, the most important first."""
    found = []
    if result.depth == GUESSED:
        found.append(
            "The depth of the frames is guessed, not measured: the numbers tell how the detector does in the weather "
            "of a guessed scene."
        )
    count = len(result.frames)
    if count < FEW_FRAMES:
        found.append(_few(count, result.clear_interval))
    scarce = {name: n for name, n in result.truths.items() if n < FEW_TRUTHS} if result.measure == "AP" else {}
    if scarce:
        found.append(
            f"Few boxes of a class move its {result.measure} and the mean: "
            f"{', '.join(f'{name} {count}' for name, count in scarce.items())}."
        )
    if result.operating is not None and not math.isnan(result.clear.value):
        point = result.operating
        found.append(
            f"Boxes are drawn from a score of {point.threshold:.2f} on ({point.origin}): in clear air precision "
            f"{point.precision:.2f}, recall {point.recall:.2f}. {result.measure} takes all boxes."
        )
    found += [sentence for each in result.conditions if (sentence := _rise(each, result))]
    return found


def _few(count: int, clear: Interval | None) -> str:
    """Remark on the number of frames, and on how far the result can be off."""
    said = f"{count} frame{'' if count == 1 else 's'} {'is' if count == 1 else 'are'} few"
    if clear is None:
        return f"{said}: there is no interval, and another choice of frames can give other numbers."
    return (
        f"{said}: the 95 % interval in clear air is {interval_text(clear)}, and with fewer than {FEW_FRAMES} frames "
        "such intervals are too narrow."
    )


def _rise(each: ConditionResult, result: RobustnessResult) -> str:
    """Remark on a weather with a higher performance than clear air, or empty."""
    if math.isnan(each.value) or not each.value > result.clear.value:
        return ""
    one = each.condition
    said = (
        f"{result.measure} in {one.name} of {one.value:g} is {each.value:.3f}, above {result.clear.value:.3f} in clear "
        "air"
    )
    if each.difference is None or each.interval is None:
        return f"{said}; without an interval this is no sign of a gain."
    difference = f"{each.difference.low:+.3f} to {each.difference.high:+.3f}"
    span = interval_text(each.interval)
    if each.difference.low <= 0.0:
        span = interval_text(each.interval)
        contains = "contains the clear value" if result.clear.value in each.interval else "lies above it"
        return (
            f"{said}. Its 95 % interval over the frames, {span}, {contains}; the interval of the difference on the "
            f"same frames, {difference}, contains 0. So the rise is no sign of a gain."
        )
    return (
        f"{said}, and the 95 % interval of the difference on the same frames, {difference}, does not contain 0: on "
        "these frames the weather helps. Look at the pictures before believing it."
    )
