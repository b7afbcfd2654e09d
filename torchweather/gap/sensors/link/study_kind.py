"""A study of microwave links: its arrays, the loss of rain on their paths, and what such a study may lack."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.core.random import keyed_stream
from torchweather.gap.study.checks import ArrayRule, refuse
from torchweather.gap.study.conditions import Condition, StudyContent
from torchweather.gap.study.frames import Frame, Frames
from torchweather.gap.study.kinds import Finding, Looks, StudyKind, place
from torchweather.physics import rain_attenuation_p838_db_per_km
from torchweather.pipeline.effect import Effect

__all__ = ["DRY_AFTER_S", "LinkStudy", "dry_samples", "rain_attenuation_db", "simulated_link"]

# P.838-3 gives its coefficients for these frequencies (PHYSICS.md 6.5).
LINK_FREQUENCIES_GHZ = (1.0, 1000.0)
# Samples of a link further than this from any rain on it are dry (GAP.md section 1): the clear set of a link.
DRY_AFTER_S = 900.0
DRIZZLE_MM_PER_H = 0.1  # radars and gauges do not tell less from none
# A path twice as long tells what grows with length from what does not.
SPREAD_OF_LENGTHS = 2.0
LINKS = ("L",)

Array = NDArray[Any]


def _length(values: Array) -> NDArray[np.bool_]:
    return np.asarray((values > 0) & (values < math.inf))


class LinkStudy(StudyKind):
    """A study of microwave links: one record, with its rain and its dry samples in the frames."""

    name = "link"
    arrays: ClassVar[Mapping[str, Mapping[str, ArrayRule]]] = {
        "links": {
            "length_km": ArrayRule(LINKS, "above 0 km, finite", holds=_length),
            "frequency_ghz": ArrayRule(LINKS, "1..1000 GHz", *LINK_FREQUENCIES_GHZ, advice="Divide MHz by 1000."),
            "polarisation": ArrayRule(LINKS, "0 (horizontal) or 1 (vertical)", 0, 1, whole=True),
            "split": ArrayRule(LINKS, "0 (fit) or 1 (holdout)", 0, 1, whole=True),
        },
        "frame": {
            "time_s": ArrayRule(("T",), "finite, s"),
            "attenuation_db": ArrayRule(("T", "L"), "finite in dB, or NaN where a sample is missing", nan=True),
            "rain_mm_per_h": ArrayRule(
                ("T", "L", "P"), "0 mm/h or more and finite, or NaN where a sample is missing", 0.0, nan=True
            ),
        },
    }
    shared = "links"
    shared_wanted = "a study of links needs length_km, frequency_ghz, polarisation, split (L,)"
    has_scenes = False
    rel_sd_key = "rain_rel_sd"
    signal, signal_name = "attenuation_db", "sample"

    def check_frame(self, sensor: None, frame: Frame, name: str) -> None:
        """A rising time, and some numbers."""
        time_s = frame["time_s"].astype(np.float64)
        refuse(
            np.concatenate([[False], np.diff(time_s) <= 0]),
            time_s,
            f"{name}: time_s must rise from sample to sample, s",
            "Sort the samples and drop double ones.",
        )
        for key in ("attenuation_db", "rain_mm_per_h"):
            if np.isnan(frame[key]).all():
                raise TorchweatherError(f"{name}: {key} must hold some numbers; got NaN everywhere.")

    def simulated(
        self, study: StudyContent, condition: Condition, start: Frame, seed: int, effects: tuple[Effect, ...] = ()
    ) -> Frame:
        """Attenuation in the rain of the record."""
        if effects:
            raise InputValueError(
                "simulate: effects belong to frames of a sensor; got a study of links. Leave them out."
            )
        return simulated_link(study.links, start, seed)

    def findings(self, study: StudyContent, clear: Looks, measured: Looks) -> Iterator[Finding]:
        """Links held out and to fit to, their lengths, dry samples and rain."""
        links = study.links
        holdout = np.asarray(links["split"]) == 1
        if holdout.all():
            yield Finding(
                "error",
                f"All links are held out ({place(study.conditions[0].frames).rpartition(': ')[0]}: split of links).",
                "There is nothing to fit to.",
                "Set split 0 for some links.",
            )
        if not holdout.any():
            yield Finding(
                "warning",
                "No link is held out.",
                "Whether what is found holds for other links stays open.",
                "Set split 1 for a third of the links.",
            )
        length_km = np.asarray(links["length_km"], dtype=np.float64)
        if length_km.max() < SPREAD_OF_LENGTHS * length_km.min():
            yield Finding(
                "warning",
                f"All links are about as long as each other, {length_km.min():.2g} to {length_km.max():.2g} km.",
                "A loss at the ends (radar.wet_radome) cannot be distinguished from one along the path "
                "(radar.path_loss_scale).",
                "Add links that are shorter or longer by a factor of two.",
            )
        for one in study.conditions:
            yield from _of_series(one.id, one.frames)


def _of_series(name: str, frames: Frames) -> Iterator[Finding]:
    for frame in frames:
        rain = np.asarray(frame["rain_mm_per_h"])
        known = ~np.isnan(np.asarray(frame["attenuation_db"]))
        dry = dry_samples(frame["time_s"], frame["rain_mm_per_h"]) & known
        undry = np.flatnonzero(~dry.any(0))
        if len(undry):
            yield Finding(
                "error",
                f"{len(undry)} of {dry.shape[1]} links of {name} have no dry sample, more than 15 min from rain "
                f"({place(frames)}).",
                "What they attenuate in clear air is unknown, so nothing can be said of rain.",
                "Give a longer series, or leave these links out.",
            )
        if not (rain > 0).any():
            yield Finding(
                "error",
                f"{name} has no rain ({place(frames)}).",
                "There is nothing to compare.",
                "Give a series with rain in it.",
            )
        missing = 1.0 - float(known.mean())
        if missing > 0.5:
            yield Finding(
                "warning",
                f"{100 * missing:.0f} % of the attenuations of {name} are missing.",
                f"Means are uncertain by {1 / math.sqrt(1 - missing):.1f} times as much as of the whole series.",
                "Check whether links fail in heavy rain: then the strongest rain is what is missing.",
            )
        if rain.shape[-1] == 1:
            yield Finding(
                "note",
                f"The rain of {name} is a mean of each path.",
                "The law of rain attenuation bends, so a mean rate tells less than the rates along the path.",
                "Give rain_mm_per_h (T, L, P) with several samples along each path, from a radar or several gauges.",
            )


def rain_attenuation_db(links: Mapping[str, Array], rain_mm_per_h: Array) -> Array:
    """Attenuation by rain on microwave links, dB ``(T, L)``: ITU-R P.838-3 over the samples of each path.

    Args:
        links: ``length_km``, ``frequency_ghz``, ``polarisation`` (0 horizontal, 1 vertical), ``(L,)`` each.
        rain_mm_per_h: ``(T, L, P)``, P samples along each path, evenly spread; NaN is unknown, and so is the loss.

    References:
        PHYSICS.md 6.5; ITU-R P.838-3.

    Example:
        >>> link = {"length_km": np.array([2.0]), "frequency_ghz": np.array([38.0]), "polarisation": np.array([1])}
        >>> round(float(rain_attenuation_db(link, np.full((1, 1, 1), 25.0))[0, 0]), 2)
        12.06
    """
    rain = torch.from_numpy(np.array(rain_mm_per_h, dtype=np.float64))
    tilt = torch.from_numpy(np.array(links["polarisation"], dtype=np.float64)) * (math.pi / 2)
    frequency = torch.from_numpy(np.array(links["frequency_ghz"], dtype=np.float64))
    known = ~rain.isnan()
    per_km = rain_attenuation_p838_db_per_km(
        torch.where(known, rain, 0.0), frequency[:, None], polarisation_tilt_rad=tilt[:, None]
    )  # (T, L, P)
    per_km = torch.where(known, per_km, math.nan)
    found: Array = (per_km.mean(-1) * torch.from_numpy(np.array(links["length_km"], dtype=np.float64))).numpy()
    return found


def dry_samples(time_s: Array, rain_mm_per_h: Array) -> NDArray[np.bool_]:
    """Mask ``(T, L)`` of the links' samples that are further than 15 min from rain of more than 0.1 mm/h on their path.

    Args:
        time_s: ``(T,)``, rising.
        rain_mm_per_h: ``(T, L, P)``; its mean along the path counts; NaN is unknown and may be rain.

    Example:
        >>> rain = np.zeros((5, 1, 1))
        >>> rain[0] = 2.0
        >>> dry_samples(np.array([0.0, 600.0, 900.0, 901.0, 2000.0]), rain)[:, 0].tolist()
        [False, False, False, True, True]
    """
    wet = ~(np.asarray(rain_mm_per_h).mean(-1) <= DRIZZLE_MM_PER_H)
    time = np.asarray(time_s, dtype=np.float64)
    dry = np.ones(wet.shape, dtype=bool)
    for link in range(wet.shape[1]):
        rains = time[wet[:, link]]
        if len(rains):
            after = np.searchsorted(rains, time)
            since = time - rains[np.maximum(after - 1, 0)]
            until = rains[np.minimum(after, len(rains) - 1)] - time
            dry[:, link] = (np.abs(since) > DRY_AFTER_S) & (np.abs(until) > DRY_AFTER_S)
    return dry


def simulated_link(links: Frame, measured: Frame, seed: int) -> dict[str, Array]:
    """Attenuation of links in the rain of a record: the loss on the way, over a dry sample of the same link.

    Args:
        links: as in ``rain_attenuation_db``.
        measured: ``time_s (T,)``, ``attenuation_db (T, L)``, ``rain_mm_per_h (T, L, P)``; of the attenuation only the
            dry samples are used, one drawn at random for each sample.
        seed: of that draw.

    Returns:
        ``time_s``, ``attenuation_db``, ``rain_mm_per_h``. A link that is never dry starts from 0 dB.
    """
    loss = rain_attenuation_db(links, measured["rain_mm_per_h"])
    dry = dry_samples(measured["time_s"], measured["rain_mm_per_h"])
    stream = keyed_stream(seed, "gap.dry_sample")
    start = np.zeros_like(loss)
    for link in range(loss.shape[1]):
        pool = np.asarray(measured["attenuation_db"])[dry[:, link], link]
        pool = pool[np.isfinite(pool)]
        drawn: Array = stream.random(size=(len(loss),))  # as many for every link, dry or not
        if len(pool):
            start[:, link] = pool[(drawn * len(pool)).astype(np.int64)]
    return {
        "time_s": np.array(measured["time_s"]),
        "attenuation_db": start + loss,
        "rain_mm_per_h": np.array(measured["rain_mm_per_h"]),
    }
