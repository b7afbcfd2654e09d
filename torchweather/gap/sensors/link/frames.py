"""Microwave links for the gap workflow: a record of many links is one frame for each class of rain.

A condition is a class of rain, and the time after rain; its frame is the whole record there. The links of split 1 are
held out, and where conditions of the study state a split, theirs. What is looked at is the mean attenuation along the
length of the path, the frequency, and the minutes since rain: a loss on the path grows with its length, a loss at its
ends does not. The error of the reference's rain is the error of the weather record, one for each class of rain; a scale
of the loss on the path does the same, and is never named beside another effect.

References:
    GAP.md 1, 3 (4, 10); PHYSICS.md 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Rain
from torchweather.core.errors import TorchweatherError
from torchweather.gap.sensors.link.effects import LINK_EFFECTS, attenuation_db
from torchweather.gap.sensors.link.samples import LinkSamples, Scatter, link_samples, rain_classes
from torchweather.gap.statistics.frame_statistics import FEWEST, Group, Layout, Reduced
from torchweather.gap.study.conditions import Condition
from torchweather.gap.study.frames import Frames
from torchweather.gap.study.splits import FIT, HOLDOUT
from torchweather.gap.study.study import Study
from torchweather.pipeline.effect import Effect

__all__ = ["LinkFrames"]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

LENGTHS = FREQUENCIES = 5  # bins, each of about as many samples
SINCE_MIN = (2.5, 7.5, 12.5, 17.5, 27.5, 42.5, 62.5, 92.5, 122.5)  # middles between steps of 5 min
AFTER = "after rain"
ATTENUATION = "attenuation_db"


class LinkFrames:
    """Simulates the samples of links and reduces them to statistics.

    Args:
        study: of kind ``link``.
        options: none; the model of links has no options.
        effects: that the model has already.
        named: as of other sensors; every effect of links is in the catalogue.

    Raises:
        TorchweatherError: options are given, or the record does not hold what an answer needs.
    """

    def __init__(
        self,
        study: Study,
        options: Mapping[str, Any] | None = None,
        effects: Sequence[Effect] = (),
        named: Sequence[str] = (),
    ) -> None:
        if options:
            raise TorchweatherError(f"find_gap: options: the model of links has none; got {', '.join(options)}.")
        self.effects = list(effects)
        self.catalogue = list(LINK_EFFECTS)
        self.as_record: AbstractSet[str] = {"radar.path_loss_scale"}
        self.map_cells: list[tuple[float, float]] = []
        self.sizes: Mapping[str, float | Sequence[float]] = {}
        self.open_shifts: AbstractSet[str] = frozenset()
        held = np.asarray(study.links["split"]) == 1
        self._check(held)
        splits = {FIT: ~held, HOLDOUT: held}
        found = {split: self._samples(study, split, chosen) for split, chosen in splits.items()}
        wet = LinkSamples.joined([samples for samples, _ in found.values()])
        self.layout = _layout(wet)
        self.samples: dict[str, LinkSamples] = {}
        self.dry = {split: _full_hours(dry) for split, (_, dry) in found.items()}
        self.clear_frames = {split: int(dry.hour.max(initial=0)) + 1 for split, dry in self.dry.items()}
        self.rel_sd = max(one.rel_sd for one in study.conditions)
        self.fit, self.holdout = (self._conditions(split, found[split][0]) for split in (FIT, HOLDOUT))
        if not self.fit or not self.holdout:
            raise TorchweatherError(
                f"find_gap: not enough data to decide: expected {FEWEST['mean']:.0f} samples or more in a class of "
                f"rain, or after rain, in both parts of the links; got {len(found[FIT][0])} to fit to and "
                f"{len(found[HOLDOUT][0])} held out, in rain and after it. Give a longer record."
            )
        self._drawn: dict[tuple[str, int], Floats] = {}
        self.cells = {name: self._cells(samples) for name, samples in self.samples.items()}
        self.scatter = {name: Scatter.of(samples, self.cells[name][0]) for name, samples in self.samples.items()}

    def _check(self, held: NDArray[np.bool_]) -> None:
        if held.all() or not held.any():
            raise TorchweatherError(
                "find_gap: not enough data to decide: links: split: expected links to fit to (0) and others held out "
                f"(1); got {int((~held).sum())} and {int(held.sum())}. Half and half, drawn at random, is usual."
            )

    def _samples(self, study: Study, split: str, chosen: NDArray[np.bool_]) -> tuple[LinkSamples, LinkSamples]:
        """In rain and after it, and dry, of the links of a split."""
        stated = any(one.split == HOLDOUT for one in study.conditions)
        parts = [
            link_samples(study.links, frame, chosen, "find_gap")
            for one in study.conditions
            if not stated or one.split == split
            for frame in one.frames
        ]
        return LinkSamples.joined([one for one, _ in parts]), LinkSamples.joined([dry for _, dry in parts])

    def _conditions(self, split: str, samples: LinkSamples) -> list[Condition]:
        """One for each class of rain that the links of a split have seen, and one for the time after rain."""
        found = []
        for low, high in rain_classes():
            inside = (samples.since_min == 0) & (samples.rain_mm_per_h >= low) & (samples.rain_mm_per_h < high)
            if inside.sum() >= FEWEST["mean"]:
                label = f"{low:g} mm/h and more" if math.isinf(high) else f"{low:g} to {high:g} mm/h"
                found.append(self._condition(label, split, samples.of(inside), self.rel_sd))
        later = samples.since_min > 0
        if later.sum() >= FEWEST["mean"]:
            found.append(self._condition(AFTER, split, samples.of(later), 0.0))
        return found

    def _condition(self, label: str, split: str, samples: LinkSamples, rel_sd: float) -> Condition:
        name = label if split == FIT else f"held out, {label}"
        self.samples[name] = samples
        rain = Rain(float(samples.wet_mm_per_h.mean()))
        return Condition(
            name, split, rain, Frames((), lambda frame, name: frame, name), rel_sd, None, split, None, None
        )

    def _cells(self, samples: LinkSamples) -> list[Whole]:
        """Bin of each sample in each group; the number of bins where it is in none."""
        along = {
            "length_km": samples.length_km,
            "frequency_ghz": samples.frequency_ghz,
            "minutes_since_rain": samples.since_min,
        }
        found = []
        for group in self.layout.binned:
            place = np.searchsorted(np.asarray(group.edges), along[group.axis], side="right") - 1
            found.append(np.where((place >= 0) & (place < group.bins), place, group.bins))
        return found

    def measured(self, condition: Condition) -> Reduced:
        """The record in a class."""
        samples = self.samples[condition.id]
        return self._reduced(samples, self.cells[condition.id], samples.measured_db[None])

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """Dry air, an hour at a time."""
        dry = self.dry[scene_id]
        cells = self._cells(dry)
        hours = [dry.hour == hour for hour in range(self.clear_frames[scene_id])]
        parts = [
            self._reduced(dry.of(hour), [cell[hour] for cell in cells], dry.measured_db[None, hour], portions)
            for hour in hours
        ]
        return Reduced.joined(parts)

    def open(self, condition: Condition) -> Mapping[str, float]:
        """Nothing but the reference's rain, which is the record."""
        return {}

    def misplaced(self, condition: Condition) -> float:
        """No particles."""
        return 0.0

    def clear_noise(self, condition: Condition) -> None:
        """A simulated frame has the noise of its clear frame."""

    def left_open(self, condition: Condition) -> float:
        """Nothing beside how clear hours differ."""
        return 0.0

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Every weather is simulated as it is asked for."""

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """None."""
        return []

    def simulated(
        self,
        condition: Condition,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: Sequence[int],
        portions: int = 1,
    ) -> Reduced:
        """The record simulated, once for each seed.

        Args:
            condition: a class of rain.
            effects: beside those that the model has.
            log_intensity: logarithm of the rain over that of the reference.
            seeds: of the scatter.
            portions: of the links.
        """
        samples = self.samples[condition.id]
        mean = attenuation_db(samples, [*self.effects, *effects], log_intensity)
        noise = np.stack([self._noise(condition, seed) for seed in seeds])
        return self._reduced(samples, self.cells[condition.id], mean + noise, portions)

    def simulated_records(
        self, condition: Condition, effects: Sequence[Effect], log_intensity: float, seeds: Sequence[int]
    ) -> Floats:
        """Simulated attenuations ``(F, S)``, dB; arguments as ``simulated``."""
        mean = attenuation_db(self.samples[condition.id], [*self.effects, *effects], log_intensity)
        return mean + np.stack([self._noise(condition, seed) for seed in seeds])

    def _noise(self, condition: Condition, seed: int) -> Floats:
        """Scatter of a simulated record, kept: it depends on the seed alone."""
        key = (condition.id, seed)
        if key not in self._drawn:
            self._drawn[key] = self.scatter[condition.id].drawn(self.samples[condition.id], seed)
        return self._drawn[key]

    def _reduced(self, samples: LinkSamples, cells: Sequence[Whole], values: Floats, portions: int = 1) -> Reduced:
        """Sums of records ``(F, S)`` over the bins, ``(F portions, bins)``."""
        sums: list[list[Floats]] = [[], [], []]
        for group, cell in zip(self.layout.binned, cells, strict=True):
            place = samples.link % portions * group.bins + cell
            inside = np.flatnonzero(cell < group.bins)
            order = inside[np.argsort(place[inside], kind="stable")]
            filled, first = np.unique(place[order], return_index=True)
            ordered = values[:, order]
            for total, each in zip(sums, (np.ones((1, len(order))), ordered, ordered**2), strict=True):
                found = np.zeros((len(values), portions * group.bins))
                if len(order):
                    found[:, filled] = np.add.reduceat(each, first, axis=1)
                total.append(found.reshape(len(values) * portions, group.bins))
        weight, value, square = (np.concatenate(total, 1) for total in sums)
        return Reduced(weight, value, square, np.zeros((len(weight), 0)), np.zeros((len(weight), 0, 0)))


def _layout(samples: LinkSamples) -> Layout:
    """Mean attenuation along length, frequency and time since rain; bins of links with about as many samples."""
    wet = samples.of(samples.since_min == 0)
    groups = (
        Group(ATTENUATION, "length_km", "mean", _quantiles(wet.length_km, LENGTHS)),
        Group(ATTENUATION, "frequency_ghz", "mean", _quantiles(wet.frequency_ghz, FREQUENCIES)),
        Group("attenuation_after_rain_db", "minutes_since_rain", "mean", SINCE_MIN),
    )
    return Layout(groups, (), (), ())


def _quantiles(values: Floats, number: int) -> tuple[float, ...]:
    """Edges of so many bins with about as many values each, fewer where values repeat; the last one is open."""
    inner = np.unique(np.quantile(values, np.arange(1, number) / number))
    low, high = float(values.min()), float(values.max())
    return (low, *(float(one) for one in inner if low < one < high), float(np.nextafter(high, math.inf)))


def _full_hours(dry: LinkSamples) -> LinkSamples:
    """Dry samples of the hours that hold enough of them, the hours counted from 0."""
    number = np.bincount(dry.hour)
    full = number[dry.hour] >= FEWEST["mean"]
    kept = dry.of(full) if full.any() else dry
    return replace(kept, hour=np.unique(kept.hour, return_inverse=True)[1])
