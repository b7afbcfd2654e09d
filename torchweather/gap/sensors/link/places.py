"""Microwave links by length and frequency: mean attenuation of each in a class of rain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.places import CellValues, Point
from torchweather.gap.sensors.link.frames import LinkFrames
from torchweather.gap.study.conditions import Condition

__all__ = ["link_cells"]

Floats = NDArray[np.float64]


def link_cells(
    model: LinkFrames, condition: Condition, statistic: str, before: Point, after: Point | None, seeds: Sequence[int]
) -> CellValues:
    """Links of a condition, each with its mean over the samples; arguments as ``places.PlacesOf``."""
    samples = model.samples[condition.id]
    links, first, own = np.unique(samples.link, return_index=True, return_inverse=True)
    number = np.bincount(own)

    def of(records: Floats) -> Floats:
        return np.stack([np.bincount(own, record) / number for record in records])

    return CellValues(
        "mean attenuation",
        "dB",
        of(samples.measured_db[None]),
        of(model.simulated_records(condition, *before, seeds)),
        None if after is None else of(model.simulated_records(condition, *after, seeds)),
        np.zeros(len(links)),
        x=samples.length_km[first],
        y=samples.frequency_ghz[first],
        x_name="length of the link, km",
        y_name="frequency, GHz",
    )
