"""Samples of microwave links in rain and just after it: what the record holds, sorted by how hard it rains.

A sample is one link at one time. In rain its attenuation is simulated as the loss of the recorded rain on the path
(ITU-R P.838-3, ``A = k R^a L``); after rain as none. How far samples scatter about the means of their class is taken
from the record itself, in three parts: of a link, of an hour of a link, of a sample. Most of it is the reference, which
sees the rain of a radar cell or a gauge and not that of the path.

References:
    GAP.md 1 (links), 3 (10); PHYSICS.md 6.5. Components of variance: Searle, Casella & McCulloch 1992.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.core.errors import TorchweatherError
from torchweather.gap.sensors.link.study_kind import DRIZZLE_MM_PER_H, dry_samples, rain_attenuation_db
from torchweather.gap.study.frames import Frame
from torchweather.physics import rain_attenuation_p838_db_per_km

__all__ = ["AFTER_RAIN_MIN", "RAIN_EDGES_MM_PER_H", "Scatter", "LinkSamples", "link_samples"]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Light, moderate and heavy rain, split further; the lowest is what the reference calls rain.
RAIN_EDGES_MM_PER_H = (DRIZZLE_MM_PER_H, 0.5, 1.0, 2.0, 5.0, 20.0, math.inf)
AFTER_RAIN_MIN = 120.0  # how long after rain a cover may still be wet
HOUR_S = 3600.0


@dataclass(frozen=True)
class LinkSamples:
    """Samples ``(S,)`` each.

    Args:
        link: number of the link.
        hour: number of the hour of the record.
        length_km, frequency_ghz: of the link.
        exponent: a of ``k R^a``.
        rain_mm_per_h: mean along the path.
        wet_mm_per_h: rain that wets the covers: that of now, or the last that fell.
        since_min: minutes since it rained, 0 in rain.
        path_db: loss of the recorded rain on the path.
        measured_db: attenuation as measured.
    """

    link: Whole
    hour: Whole
    length_km: Floats
    frequency_ghz: Floats
    exponent: Floats
    rain_mm_per_h: Floats
    wet_mm_per_h: Floats
    since_min: Floats
    path_db: Floats
    measured_db: Floats

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.link)

    def of(self, chosen: Mask) -> LinkSamples:
        """Some of them."""
        return replace(self, **{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    @classmethod
    def joined(cls, parts: Sequence[LinkSamples]) -> LinkSamples:
        """Those of several records of the same links; the hours of each are its own."""
        found: dict[str, NDArray[Any]] = {}
        for field in fields(cls):
            arrays = [getattr(part, field.name) for part in parts]
            if field.name == "hour":
                firsts = np.cumsum([0] + [int(one.max(initial=-1)) + 1 for one in arrays])
                arrays = [one + first for one, first in zip(arrays, firsts, strict=False)]
            found[field.name] = np.concatenate(arrays)
        return cls(**found)


def link_samples(links: Frame, frame: Frame, chosen: Mask, owner: str) -> tuple[LinkSamples, LinkSamples]:
    """Samples of some links in rain and up to two hours after it, and those of dry air.

    Args:
        links: ``length_km, frequency_ghz, polarisation``, ``(L,)`` each.
        frame: ``time_s (T,)``, ``attenuation_db (T, L)``, ``rain_mm_per_h (T, L, P)``.
        chosen: ``(L,)`` links.
        owner: who complains.

    Raises:
        TorchweatherError: it never rains, or no sample is dry.
    """
    time_s = np.asarray(frame["time_s"], dtype=np.float64)
    rain = np.asarray(frame["rain_mm_per_h"], dtype=np.float64)
    measured = np.asarray(frame["attenuation_db"], dtype=np.float64)
    path = rain_attenuation_db(links, rain)
    mean = rain.mean(-1)
    since, last = _since_rain(time_s, mean)
    known = np.isfinite(measured) & np.isfinite(mean) & chosen
    wet = known & (mean >= RAIN_EDGES_MM_PER_H[0])
    after = known & (mean < RAIN_EDGES_MM_PER_H[0]) & (since > 0) & (since <= AFTER_RAIN_MIN)
    dry = known & dry_samples(time_s, rain)
    if not wet.any():
        raise TorchweatherError(
            f"{owner}: not enough data to decide: expected rain of {RAIN_EDGES_MM_PER_H[0]:g} mm/h or more on the "
            f"links; the record's largest is {np.nanmax(mean, initial=0.0):g} mm/h (rain_mm_per_h, not mm in a step)."
        )
    if not dry.any():
        raise TorchweatherError(
            f"{owner}: not enough data to decide: no sample is dry, 15 min or more from rain on its link; the scatter "
            "without rain cannot be measured. Give a longer record."
        )
    exponent = _exponent(links)
    hour = ((time_s - time_s[0]) // HOUR_S).astype(np.int64)

    def of(mask: Mask) -> LinkSamples:
        step, link = np.nonzero(mask)
        return LinkSamples(
            link,
            hour[step],
            np.asarray(links["length_km"], dtype=np.float64)[link],
            np.asarray(links["frequency_ghz"], dtype=np.float64)[link],
            exponent[link],
            mean[mask],
            np.where(wet, mean, last)[mask],
            np.where(wet, 0.0, since)[mask],
            np.where(wet, path, 0.0)[mask],
            measured[mask],
        )

    return of(wet | after), of(dry)


def _exponent(links: Frame) -> Floats:
    """a of ``k R^a`` of each link."""
    frequency = torch.from_numpy(np.array(links["frequency_ghz"], dtype=np.float64))
    tilt = torch.from_numpy(np.array(links["polarisation"], dtype=np.float64)) * (math.pi / 2)
    rain = torch.tensor([[1.0], [math.e]], dtype=torch.float64)
    found: Floats = (
        rain_attenuation_p838_db_per_km(rain, frequency, polarisation_tilt_rad=tilt).log().diff(dim=0)[0].numpy()
    )
    return found


def _since_rain(time_s: Floats, rain_mm_per_h: Floats) -> tuple[Floats, Floats]:
    """Minutes since the last wet sample of each link, infinite before the first, and the rain of that, ``(T, L)``."""
    wet = rain_mm_per_h >= RAIN_EDGES_MM_PER_H[0]
    step = np.where(wet, np.arange(len(wet))[:, None], -1)
    latest = np.maximum.accumulate(step, 0)
    since = np.where(latest >= 0, (time_s[:, None] - time_s[np.maximum(latest, 0)]) / 60.0, np.inf)
    return since, np.take_along_axis(np.nan_to_num(rain_mm_per_h), np.maximum(latest, 0), 0)


@dataclass(frozen=True)
class Scatter:
    """Scatter of samples about the means of their cells, variances in dB^2.

    Args:
        link: common to all samples of a link in a cell.
        hour: common to those of an hour of a link.
        sample: of each.
    """

    link: float
    hour: float
    sample: float

    @classmethod
    def of(cls, samples: LinkSamples, cell: Whole) -> Scatter:
        """From the departures of the measured samples from the simulated ones, about their mean in each cell."""
        apart = samples.measured_db - samples.path_db
        number = np.maximum(np.bincount(cell), 1)
        apart = apart - (np.bincount(cell, apart) / number)[cell]
        whole = float((apart**2).mean()) if len(apart) else 0.0
        hours = int(samples.hour.max(initial=0)) + 1
        same_link = _mean_product(apart, samples.link)
        same_hour = _mean_product(apart, samples.link * hours + samples.hour)
        in_hour = min(max(same_hour, 0.0), whole)
        of_link = min(max(same_link, 0.0), in_hour)
        return cls(of_link, in_hour - of_link, whole - in_hour)

    def drawn(self, samples: LinkSamples, seed: int) -> Floats:
        """Departures of samples that scatter so."""
        generator = np.random.default_rng([seed & 0x7FFFFFFF, seed >> 31])
        hours = int(samples.hour.max(initial=0)) + 1
        links = int(samples.link.max(initial=0)) + 1
        found: Floats = math.sqrt(self.link) * generator.normal(size=links)[samples.link]
        of_hour = generator.normal(size=links * hours)[samples.link * hours + samples.hour]
        found = found + math.sqrt(self.hour) * of_hour
        return found + math.sqrt(self.sample) * generator.normal(size=len(samples))


def _mean_product(apart: Floats, group: Whole) -> float:
    """Mean product of two different samples of one group."""
    _, place = np.unique(group, return_inverse=True)
    total, number = np.bincount(place, apart), np.bincount(place)
    pairs = float((number * (number - 1)).sum())
    return float((total**2).sum() - (apart**2).sum()) / pairs if pairs > 0 else 0.0


def rain_classes() -> list[tuple[float, float]]:
    """Lower and upper end of each class of rain, mm/h."""
    return list(pairwise(RAIN_EDGES_MM_PER_H))
