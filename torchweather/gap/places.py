"""Places of a frame or a scan at which measured frames depart from simulated ones, cell by cell in natural units.

The search itself looks at statistics along axes. This is for the eye of the reader: the condition that departs most,
its frame, and the cells whose mean over the measured frames is not that of the simulated ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm as normal
from scipy.stats import t as student

from torchweather.gap.inference.forward_selection import GapResult
from torchweather.gap.inference.simulated_conditions import ParameterPoint
from torchweather.gap.study.conditions import Condition
from torchweather.pipeline.effect import Effect

__all__ = ["DEPARTS", "SIMULATED", "CellValues", "Places", "PlacesOf", "mean_over_frames", "places_of", "quantity_of"]

Floats = NDArray[np.float64]

SIMULATED = 16  # frames: their standard deviation is known to a fifth
DEPARTS = 3.0  # standard deviations of chance, from which a place is said to depart
LEAST_DEGREES = 3  # of freedom, of the scatter of a place


@dataclass(frozen=True)
class CellValues:
    """A quantity of frames in the cells of a frame.

    Args:
        quantity: in words.
        unit: of all values.
        measured, before: ``(frames, cells)`` of measured frames and of simulated ones; NaN where a frame has none.
        after: with what was fitted; ``None`` where nothing was.
        least: ``(cells,)`` chance below which the mean of the measured frames is not known, such as half a beam.
        shape: rows and columns of the cells; ``None`` where they are single things that stand anywhere.
        x, y: ``(cells,)`` where those stand.
        x_name, y_name: axes, with units.
        extent: left, right, bottom and top of a grid of cells on those axes.
        frame: ``(H, W)`` one measured frame as a picture, 0 to 1, under a grid of cells.
    """

    quantity: str
    unit: str
    measured: Floats
    before: Floats
    after: Floats | None
    least: Floats
    shape: tuple[int, int] | None = None
    x: Floats | None = None
    y: Floats | None = None
    x_name: str = ""
    y_name: str = ""
    extent: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0)
    frame: Floats | None = None


@dataclass(frozen=True)
class Places:
    """Departure of a condition's frames from the simulation, cell by cell.

    Args:
        condition: of the study.
        frames: measured ones.
        values: what is compared.
        before, after: ``(cells,)`` mean measured less mean simulated.
        chance: ``(cells,)`` standard deviation of ``before`` by chance, wider where few clear frames tell it: so that
            ``DEPARTS`` of them are as rare as of a normal law.
    """

    condition: str
    frames: int
    values: CellValues
    before: Floats
    after: Floats | None
    chance: Floats


Point = tuple[Sequence[Effect], float]
"""Effects, also those of systematic uncertainties, and the logarithm of the weather's intensity over its record."""
PlacesOf = Callable[[Condition, str, Point, Point | None, Sequence[int]], CellValues | None]
"""Values of a condition's cells for a statistic, simulated at one point and at another, for some seeds."""


def places_of(result: GapResult, cells: PlacesOf, statistic: str | None) -> Places | None:
    """Where the condition that departs most departs.

    Args:
        result: of the search.
        cells: of the kind of sensor.
        statistic: that departs most; ``None`` where none stands out.

    Returns:
        ``None`` where the frames cannot be laid out, or too little is in any place.
    """
    search = result.search
    target = max(search.measured, key=lambda one: float((search.start.z(one) ** 2).sum()))
    condition = target.condition

    def at(point: ParameterPoint) -> Point:
        effects = [*search.catalogue_effects(point), *search.model.systematics(condition, point.open)]
        return effects, point.log_intensity.get(condition.id, 0.0)

    after = None if result.fit is None else at(result.fit.point)
    found = cells(condition, statistic or "", at(search.origin), after, range(SIMULATED))
    if found is None:
        return None
    clear = search.model.clear_frames[condition.scene]
    measured, number = mean_over_frames(found.measured)
    before, _ = mean_over_frames(found.before)
    scatter = _scatter(found.before)
    # Simulated frames start from the clear ones: no number of them knows more than those do, of the mean and of the
    # scatter (Student's law).
    known_by = min(SIMULATED, clear)
    wider = float(student.ppf(normal.cdf(DEPARTS), max(known_by - 1, LEAST_DEGREES))) / DEPARTS
    chance = wider * scatter * np.sqrt(1.0 / np.maximum(number, 1) + 1.0 / known_by)
    if not np.isfinite(measured - before + chance).any():
        return None
    return Places(
        condition.id,
        target.frames,
        found,
        measured - before,
        None if found.after is None else measured - mean_over_frames(found.after)[0],
        np.maximum(chance, found.least),
    )


def quantity_of(statistic: str, beginnings: Mapping[str, str], usual: str) -> str:
    """Quantity of a frame that shows a statistic, by how its name begins.

    Example:
        >>> quantity_of("lost_share", {"lost": "lost", "new": "before"}, "intensity")
        'lost'
    """
    return next((found for begins, found in beginnings.items() if statistic.startswith(begins)), usual)


def mean_over_frames(values: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Mean over the frames that have a value, NaN where none has; and their number."""
    known = np.isfinite(values)
    number = known.sum(0)
    total = np.where(known, values, 0.0).sum(0)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan), number


def _scatter(values: Floats) -> Floats:
    """Standard deviation over the frames that have a value; NaN where fewer than three have."""
    mean, number = mean_over_frames(values)
    square = np.where(np.isfinite(values), (values - mean) ** 2, 0.0).sum(0)
    return np.where(number > 2, np.sqrt(square / np.maximum(number - 1, 1)), np.nan)
