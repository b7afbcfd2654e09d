"""Attenuation of microwave links by classes of rain, measured beside simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.evaluation.validation.comparison import Comparison, Sample, Shift
from torchweather.evaluation.validation.frame_scores import ScoreMeaning
from torchweather.evaluation.validation.quantities import Quantity, quantity
from torchweather.gap.sensors.link.study_kind import dry_samples
from torchweather.gap.study.study import Frame

__all__ = ["RAIN_CLASSES_MM_PER_H", "LinkClass", "compared_links"]

# Lower ends of the classes of path-mean rain. The usual bounds of light, moderate and heavy rain are 2.5 and 10 mm/h
# (WMO-No. 8, American Meteorological Society's glossary: 2.5 and 7.6); below 0.1 mm/h is drizzle that gauges miss.
RAIN_CLASSES_MM_PER_H = (0.1, 1.0, 2.5, 10.0, 25.0)

Array = NDArray[Any]


@dataclass(frozen=True)
class LinkClass:
    """Links in one class of rain.

    Args:
        low_mm_per_h: lower end of the class.
        label: in words.
        score: mean attenuation, one score a link; measured and simulated of a link are a pair, the floor is dry air.
        quantity: distribution of all samples, with the root mean square of the differences sample by sample.
    """

    low_mm_per_h: float
    label: str
    score: Comparison
    quantity: Quantity


def compared_links(
    measured: Sequence[Frame], simulated: Sequence[Frame], changed: Mapping[float, Sequence[Frame]] | None = None
) -> tuple[LinkClass, ...]:
    """Attenuation of links in each class of path-mean rain that has samples.

    Args:
        measured, simulated: ``time_s``, ``attenuation_db``, ``rain_mm_per_h`` each, in the same order. A sample counts
            where both attenuations and the rain on the whole path are known.
        changed: the same simulated at multiples of the rain, by factor; none: the power is not known.
    """
    series = [_Series.of(one, other) for one, other in zip(measured, simulated, strict=True)]
    floor = Sample(tuple(mean for each in series for mean in _means(each.measured, each.quiet)))
    quiet = np.concatenate([each.measured[each.quiet] for each in series])
    found = []
    for low, high in zip(RAIN_CLASSES_MM_PER_H, (*RAIN_CLASSES_MM_PER_H[1:], math.inf), strict=True):
        chosen = [each.known & (each.rain >= low) & (each.rain < high) for each in series]
        if not any(mask.any() for mask in chosen):
            continue
        means: dict[str, Sample] = {}
        samples: dict[str, Array] = {}
        for which in ("measured", "simulated"):
            pairs = [(getattr(each, which), mask) for each, mask in zip(series, chosen, strict=True)]
            means[which] = Sample(tuple(mean for values, mask in pairs for mean in _means(values, mask)))
            samples[which] = np.concatenate([values[mask] for values, mask in pairs])
        shifts = tuple(
            Shift(factor, means["simulated"], Sample(_changed_means(frames, chosen)))
            for factor, frames in (changed or {}).items()
        )
        label = f"{low:g} to {high:g} mm/h" if high < math.inf else f"{low:g} mm/h or more"
        name = f"attenuation_db_from_{low:g}_mm_per_h"
        meaning = ScoreMeaning(False, "dB", f"mean attenuation at {label}", called=f"attenuation at {label}")
        rmse = float(np.sqrt(np.square(samples["simulated"] - samples["measured"]).mean()))
        found.append(
            LinkClass(
                low,
                label,
                Comparison(name, meaning, means["measured"], means["simulated"], floor, paired=True, shifts=shifts),
                quantity(
                    f"attenuation at {label}",
                    "dB",
                    samples["measured"],
                    samples["simulated"],
                    quiet[::2],
                    quiet[1::2],
                    rmse,
                ),
            )
        )
    return tuple(found)


@dataclass(frozen=True)
class _Series:
    """Attenuation of links over time, path-mean rain, and which samples are known and dry; all ``(T, L)``."""

    measured: Array
    simulated: Array
    rain: Array
    known: NDArray[np.bool_]
    quiet: NDArray[np.bool_]

    @classmethod
    def of(cls, measured: Frame, simulated: Frame) -> _Series:
        first, second = (np.asarray(frame["attenuation_db"], dtype=np.float64) for frame in (measured, simulated))
        rain = np.asarray(measured["rain_mm_per_h"], dtype=np.float64).mean(-1)
        there = np.isfinite(first)
        quiet = dry_samples(measured["time_s"], measured["rain_mm_per_h"]) & there
        return cls(first, second, rain, there & np.isfinite(second), quiet)


def _changed_means(frames: Sequence[Frame], chosen: Sequence[NDArray[np.bool_]]) -> tuple[float, ...]:
    pairs = zip(frames, chosen, strict=True)
    return tuple(mean for frame, mask in pairs for mean in _means(np.asarray(frame["attenuation_db"]), mask))


def _means(values: Array, chosen: NDArray[np.bool_]) -> tuple[float, ...]:
    """Mean of the chosen samples of each link; NaN without one."""
    number = chosen.sum(0)
    total = np.where(chosen, values, 0.0).sum(0)
    return tuple(float(t / n) if n else math.nan for t, n in zip(total, number, strict=True))
