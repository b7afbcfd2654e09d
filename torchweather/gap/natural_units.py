"""Entries of the statistics back in the units of a sensor: shares in per cent, decibels, metres, returns per frame.

The search compares entries in units in which their scatter is even (``statistics/frame_statistics.py``). A reader wants
the size of a departure: 3 % more lost beams, 2 dB less intensity.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.statistics.counting import ANSCOMBE
from torchweather.gap.statistics.frame_statistics import Group
from torchweather.gap.statistics.log_square import spread_of_log_square

__all__ = ["DB_PER_NEPER", "NaturalDeparture", "NaturalUnit", "natural_unit"]

Floats = NDArray[np.float64]

DB_PER_NEPER = 10.0 / math.log(10.0)
PER_CENT = 100.0
SHARES_OF = {
    **dict.fromkeys(("clustered_share", "zero_intensity_share_of_particles"), "particle returns"),
    **dict.fromkeys(("lost_target_share", "lost_flickering_share", "speed_far_off_share"), "targets"),
    **{f"repeated_{what}_share": "targets" for what in ("power", "range", "speed")},
    "noise_floor_share": "frames",
    **{f"{side}_share_{where}": "pixels" for side in ("bright", "dark") for where in ("near", "far")},
}
COUNTS_OF = dict.fromkeys(("clutter_count", "ghost_count"), "detections per frame")
# Mean of ln(1 + square), the squares in units of clear air's variance: of a normal error, its standard deviation.
LOG_SQUARES = ("log_intensity_spread", "range_residual_spread", "power_spread", "speed_spread", "range_spread")
# Products of what is in units of the noise of a pixel.
PRODUCTS = re.compile(r"streak_correlation_.*|column_correlation|row_correlation")


@dataclass(frozen=True)
class NaturalUnit:
    """Unit of a statistic, and the way to it.

    Args:
        text: the unit.
        of: from entries and the number of frames to values in that unit.
    """

    text: str
    of: Callable[[Floats, int], Floats]


@dataclass(frozen=True)
class NaturalDeparture:
    """A curve in natural units.

    Args:
        unit: of all values.
        before, after: ``(bins,)`` measured less simulated, NaN where nothing counts; ``after`` is ``None`` where
            nothing was added.
        chance: ``(bins,)`` one standard deviation of ``before`` by chance.
    """

    unit: str
    before: Floats
    after: Floats | None
    chance: Floats


def natural_unit(group: Group) -> NaturalUnit | None:
    """Natural unit of a group's entries; ``None`` where they have none.

    Example:
        >>> lost = natural_unit(Group("lost_share", "range_m", "share", (0.0, 10.0)))
        >>> lost.text, lost.of(np.array([math.asin(math.sqrt(0.25))]), 5).round(6)
        ('% of beams', array([25.]))
        >>> natural_unit(Group("lost_share", "time", "slope", (0.0, 1.0))) is None
        True
    """
    name, kind = group.statistic, group.kind
    if kind == "share":
        return NaturalUnit(f"% of {SHARES_OF.get(name, 'beams')}", _share)
    if kind == "count":
        return NaturalUnit(COUNTS_OF.get(name, "returns per frame"), _count)
    if kind == "spread":
        return _of_spread(name)
    return _of_mean(name) if kind == "mean" else None


def _of_mean(name: str) -> NaturalUnit | None:
    if name in ("log_intensity_ratio", "log_particle_intensity"):
        return NaturalUnit("dB", _times(DB_PER_NEPER))
    if name.startswith("log_ratio_"):
        return NaturalUnit("% of clear air's light", lambda entry, frames: PER_CENT * np.exp(entry))
    if name.startswith("edge_contrast_"):
        return NaturalUnit("% of clear air's contrast", _times(PER_CENT))
    if name in LOG_SQUARES:
        return NaturalUnit("times clear air's spread", lambda entry, frames: spread_of_log_square(entry))
    if PRODUCTS.fullmatch(name):
        return NaturalUnit("of the noise variance", _times(1.0))
    if name == "log_ghost_delay":
        return NaturalUnit("m", lambda entry, frames: np.exp(entry))
    if "_px_" in name:  # of camera_shift
        return NaturalUnit("px", _times(1.0))
    endings = (("_db", "dB"), ("_m_per_s", "m/s"), ("_m", "m"))
    return next((NaturalUnit(unit, _times(1.0)) for ending, unit in endings if name.endswith(ending)), None)


def _of_spread(name: str) -> NaturalUnit | None:
    if name == "log_particle_intensity_spread":
        return NaturalUnit("dB, standard deviation", lambda entry, frames: DB_PER_NEPER * np.exp(entry))
    if name == "log_ratio_spread":
        return NaturalUnit("%, standard deviation", lambda entry, frames: PER_CENT * np.exp(entry))
    if name.startswith("difference_spread_"):
        return NaturalUnit("% of saturation, standard deviation", lambda entry, frames: PER_CENT * np.exp(entry))
    if name == "clutter_speed_spread":
        return NaturalUnit("m/s, standard deviation", lambda entry, frames: np.exp(entry))
    return None


def _times(factor: float) -> Callable[[Floats, int], Floats]:
    return lambda entry, frames: factor * entry


def _share(entry: Floats, frames: int) -> Floats:
    found: Floats = PER_CENT * np.sin(np.clip(entry, 0.0, 0.5 * math.pi)) ** 2
    return found


def _count(entry: Floats, frames: int) -> Floats:
    found: Floats = np.maximum(np.maximum(entry, 0.0) ** 2 - ANSCOMBE, 0.0) / frames
    return found
