"""How strong an effect is in a radar study, and whether it can be told apart: fixed before any search runs.

The signature of an effect is the change of coarse statistics of the fitted conditions, whitened by their scatter over
repeated recordings without it and freed of what errors of the weather's record do. Its length is the detectability d'.
Two sets of seeds keep the noise of the estimate out of lengths and cosines: products are taken between a signature of
one and one of the other.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..records import REL_SD
from .design import Design
from .effects import CATALOGUE, Known
from .outside import OUTSIDE
from .radar_sensor import FLOOR_DBM, SNR_DB, Effect, Floats, Report, Targets, Weather, shoot, study_radar

__all__ = ["IDENTIFIABLE_BELOW", "KINDS", "STRENGTHS", "Curve", "Detector", "confusion", "refined"]

KINDS: dict[str, type[Known]] = {**CATALOGUE, **OUTSIDE}
IDENTIFIABLE_BELOW = 0.95
STRENGTHS = tuple(float(value) for value in np.linspace(0.1, 1.0, 10))
RECORDINGS, BASE_RECORDINGS = 12, 60  # of each condition and seed set; without effects, for the scatter
SHRINKAGE = 0.3
RATE_STEP = 1.1
NOISE_CUT = 2.0  # standard deviations of its own noise, below which a change is set to 0 in a direction
BISECTIONS, NEAR_ENOUGH = 7, 0.2
LEAST = 1e-3  # scatter of a statistic
CLUTTER_M = ((0.0, 4.0), (4.0, 10.0), (10.0, 25.0), (25.0, 1e4))  # ranges in which others are counted
# Scatter of a stabilised count of one frame, at least. Where hardly ever anything is counted it hardly scatters, and a
# handful of counts would be tens of its scatters off; the likelihood of Poisson's law says how many they are.
LEAST_OF_COUNT = 0.2


class Statistics:
    """Coarse statistics of recordings of one scene, against its targets' powers in clear air."""

    def __init__(self, targets: Targets, seed: int) -> None:
        self.targets = targets
        clear = shoot(study_radar(), targets, Weather(), (), np.arange(200), np.random.default_rng([seed, 1]))
        there = np.isfinite(clear.power_db)
        self.often = there.mean(0) > 0.2
        self.power_db = np.nanmean(np.where(there | ~self.often, np.nan_to_num(clear.power_db), np.nan), 0)
        self.spread_db = np.sqrt(np.nanmean(np.where(there, (clear.power_db - self.power_db) ** 2, np.nan), 0) + 0.01)
        margin = self.power_db - FLOOR_DBM - SNR_DB
        self.groups = [
            *_binned(targets.range_m, (6.0, 12.0, 25.0, 50.0, 131.0), self.often),
            *_binned(margin, (-5.0, 2.0, 6.0, 12.0, 80.0), self.often),
            *_binned(targets.target_class, (-0.5, 0.5, 1.5, 2.5, 3.5), self.often),
            *_binned(targets.azimuth_rad, (-0.7, -0.4, -0.15, 0.15, 0.4, 0.7), self.often),
            *_binned(targets.elevation_rad, (-0.1, -0.03, 0.03, 0.1), self.often),
        ]

    @property
    def counts(self) -> slice:
        """Places of the counts: behind three of each group, four of speeds and ranges, three of the floor."""
        start = 3 * len(self.groups) + 4 + 3
        return slice(start, start + len(CLUTTER_M) + 1)

    def __call__(self, report: Report, recordings: int) -> Floats:
        """Statistics ``(recordings, K)`` of frames, as many of each recording."""
        frames = len(report.floor_db) // recordings
        there = np.isfinite(report.power_db)
        power = np.where(there, report.power_db - self.power_db, 0.0)
        weight = there / self.spread_db**2
        speed = np.where(there, report.speed_m_per_s - self.targets.speed_m_per_s, 0.0)
        range_m = np.where(there, report.range_m - self.targets.range_m, 0.0)
        wide = np.where(there, np.log1p((power - _mean(power, weight)) ** 2 / self.spread_db**2), 0.0)
        columns: list[Floats] = []
        for group in self.groups:
            own = there[:, group].sum(1)
            columns += [
                np.arcsin(np.sqrt(own / max(group.sum(), 1))),
                _mean(power[:, group], weight[:, group])[:, 0],
                _mean(wide[:, group], there[:, group])[:, 0],
            ]
        for values in (speed, range_m, np.log1p((speed / 0.04) ** 2), np.log1p((range_m / 0.02) ** 2)):
            columns.append(_mean(values, there)[:, 0])
        floor = report.floor_db - FLOOR_DBM
        columns += [floor, np.clip(floor, 0.0, 1.0), np.clip(floor - 3.0, 0.0, 1.0)]
        count = len(report.floor_db)
        others = np.bincount(report.clutter_frame, minlength=count)
        for low, high in CLUTTER_M:
            inside = (report.clutter[:, 0] >= low) & (report.clutter[:, 0] < high)
            columns.append(np.sqrt(np.bincount(report.clutter_frame[inside], minlength=count) + 0.375))
        columns.append(np.sqrt(self._followers(report, count) + 0.375))
        rows = np.stack(columns, 1).reshape(recordings, frames, -1)
        lever = np.linspace(-1.0, 1.0, frames)
        scalars = np.stack([there.sum(1) + others, _mean(power, weight)[:, 0], floor], 1).reshape(recordings, frames, 3)
        apart = np.log(scalars.var(1, ddof=1) + np.array([1.0, 1e-3, 1e-3]))
        moved = _mean(range_m, there)[:, 0].reshape(recordings, frames)
        return np.concatenate([rows.mean(1), apart, (moved * lever).mean(1, keepdims=True)], 1)

    def _followers(self, report: Report, count: int) -> Floats:
        """Others of each frame in the direction of a target."""
        azimuth = np.abs(report.clutter[:, 1:2] - self.targets.azimuth_rad) < 0.01
        elevation = np.abs(report.clutter[:, 2:3] - self.targets.elevation_rad) < 0.01
        behind = report.clutter[:, :1] > self.targets.range_m + 1.0
        return np.bincount(report.clutter_frame[(azimuth & elevation & behind).any(1)], minlength=count)


def _binned(values: Floats, edges: tuple[float, ...], some: Floats) -> list[Floats]:
    return [some & (values >= low) & (values < high) for low, high in itertools.pairwise(edges)]


def _mean(values: Floats, weight: Floats) -> Floats:
    return np.asarray((values * weight).sum(1, keepdims=True) / np.maximum(weight.sum(1, keepdims=True), 1e-9))


@dataclass(frozen=True)
class Curve:
    """An effect of growing strength in one design.

    Args:
        name: in the catalogue or outside of it.
        fixed: parameters that are not swept.
        sign: of the swept one.
        lengths: d' at each of `STRENGTHS`.
        signatures: ``(2, strengths, K)`` of both seed sets.
    """

    name: str
    fixed: dict[str, float]
    sign: float
    lengths: Floats
    signatures: Floats

    def strength_for(self, length: float) -> float | None:
        """The weakest strength whose d' reaches ``length``; ``None`` where no strength does, or the weakest is over."""
        rising = np.minimum.accumulate(self.lengths[::-1])[::-1]
        above = np.flatnonzero(rising >= length)
        if not len(above) or above[0] == 0:
            return None
        low, high = int(above[0]) - 1, int(above[0])
        start, end = np.log(max(rising[low], 0.5)), np.log(rising[high])
        share = np.clip((np.log(length) - start) / max(end - start, 1e-9), 0.0, 1.0)
        return float(STRENGTHS[low] + share * (STRENGTHS[high] - STRENGTHS[low]))

    def effect(self, strength: float) -> Known:
        """The effect at a strength."""
        return KINDS[self.name].at(self.sign * strength, self.fixed)


class Detector:
    """Signatures in one design.

    Args:
        design: scenes and conditions.
        seed: of the recordings, unlike those of any study.
    """

    def __init__(self, design: Design, seed: int) -> None:
        self.design, self.seed, self.radar = design, seed, study_radar()
        self.conditions = [one for one in design.conditions if one.split == "fit"]
        self._statistics = [Statistics(targets, seed) for targets in design.scenes]
        rows = [self._recorded(place, (), 9, BASE_RECORDINGS) for place in range(len(self.conditions))]
        least = np.full(rows[0].shape[1], LEAST)
        least[self._statistics[0].counts] = LEAST_OF_COUNT / np.sqrt(design.size.frames)
        self._spread = [np.maximum(one.std(0, ddof=1), least) for one in rows]
        scaled = np.concatenate([(one - one.mean(0)) / spread for one, spread in zip(rows, self._spread, strict=True)])
        size = scaled.shape[1]
        correlation = (1.0 - SHRINKAGE) * scaled.T @ scaled / len(scaled) + SHRINKAGE * np.eye(size)
        np.fill_diagonal(correlation, 1.0)  # also where a statistic scatters less than it counts
        values, vectors = np.linalg.eigh(correlation)
        self._whiten = vectors / np.sqrt(values)
        self._base = [self._whitened((), side) for side in (0, 1)]
        self._free = self._projection()

    def _recorded(
        self, place: int, effects: tuple[Effect, ...], side: int, recordings: int, factor: float = 1.0
    ) -> Floats:
        one = self.conditions[place]
        amount = one.weather.amount / factor if one.weather.kind == "fog" else one.weather.amount * factor
        number = np.tile(np.arange(self.design.size.frames), recordings)
        rng = np.random.default_rng([self.seed, side, place])
        weather = Weather(one.weather.kind, amount)
        report = shoot(self.radar, self.design.scenes[one.scene], weather, effects, number, rng)
        return self._statistics[one.scene](report, recordings)

    def _whitened(self, effects: tuple[Effect, ...], side: int, factor: float = 1.0) -> Floats:
        """Whitened mean statistics of every condition ``(C, K)``."""
        means = [
            self._recorded(place, effects, side, RECORDINGS, factor).mean(0) / self._spread[place]
            for place in range(len(self.conditions))
        ]
        return self._apart(np.stack(means) @ self._whiten)

    def _apart(self, rows: Floats) -> Floats:
        """Rows ``(C, K)`` in units in which all are independent: the noise of a scene's clear frames is the same for
        all of its conditions, whose covariance is ``1 + J frames / clear_frames``."""
        shared = self.design.size.frames / self.design.size.clear_frames
        found = rows.copy()
        for scene in {one.scene for one in self.conditions}:
            places = [place for place, one in enumerate(self.conditions) if one.scene == scene]
            found[places] -= rows[places].mean(0) * (1.0 - 1.0 / np.sqrt(1.0 + len(places) * shared))
        return found

    def _projection(self) -> Floats:
        """``(C K, C K)``: takes out of a signature what errors of the rates do, half of them common to all."""
        change = (self._whitened((), 2, RATE_STEP) - self._whitened((), 2)) * REL_SD / np.log(RATE_STEP)
        count, size = change.shape
        each = np.zeros((count + 1, count, size))
        each[np.arange(count), np.arange(count)] = change * np.sqrt(0.5)
        each[count] = change * np.sqrt(0.5)
        _, strengths, axes = np.linalg.svd(each.reshape(count + 1, -1), full_matrices=False)
        return np.asarray(np.eye(axes.shape[1]) - (axes.T * (1.0 - 1.0 / np.hypot(1.0, strengths))) @ axes)

    def signature(self, effects: tuple[Effect, ...]) -> Floats:
        """Of both seed sets, ``(2, C K)``."""
        change = [self._whitened(effects, side) - self._base[side] for side in (0, 1)]
        return np.stack([one.ravel() for one in change]) @ self._free

    def curve(self, name: str, fixed: dict[str, float], sign: float) -> Curve:
        """Signatures of an effect over its strengths."""
        found = [self.signature((KINDS[name].at(sign * strength, fixed),)) for strength in STRENGTHS]
        return Curve(name, fixed, sign, np.array([length(one) for one in found]), np.stack(found, 1))


def length(signature: Floats) -> float:
    """d': one seed set's signature along the direction of the other's, both ways."""
    found = []
    for one, other in ((0, 1), (1, 0)):
        cut = NOISE_CUT / np.sqrt(RECORDINGS) * np.sqrt(2.0)
        direction = np.where(np.abs(signature[one]) > cut, signature[one], 0.0)
        norm = float(np.linalg.norm(direction))
        found.append(float(signature[other] @ direction) / norm if norm > 0.0 else 0.0)
    return float(np.mean(found))


def cosine(first: Floats, second: Floats) -> float:
    """Of two signatures ``(2, K)``, products between the seed sets only."""
    across = 0.5 * (first[0] @ second[1] + first[1] @ second[0])
    norm = np.sqrt(max(first[0] @ first[1], 1e-9) * max(second[0] @ second[1], 1e-9))
    return float(np.clip(across / norm, -1.0, 1.0))


def refined(detector: Detector, curve: Curve, strength: float, level: float) -> tuple[float, float, Floats]:
    """A strength nearer to a level, by bisection about a first guess: it, its d', and its signature."""
    below = [one for one, value in zip(STRENGTHS, curve.lengths, strict=True) if value < level and one < strength]
    low, high = max(below, default=0.0), min(one for one in (*STRENGTHS, 1.01) if one > strength)
    best = (np.inf, strength, 0.0, np.zeros(0))
    for _ in range(BISECTIONS):
        signature = detector.signature((curve.effect(strength),))
        reached = length(signature)
        away = abs(np.log(max(reached, 0.1) / level))
        if away < best[0]:
            best = (away, strength, reached, signature)
        if away < NEAR_ENOUGH:
            break
        low, high = (strength, high) if reached < level else (low, strength)
        strength = 0.5 * (low + high)
    return best[1:]


def confusion(curves: dict[str, Curve], name: str, mine: Floats, weakest: float = 5.0) -> dict[str, float]:
    """Largest absolute cosine of a signature ``(2, K)`` with each other effect of the catalogue that shows at all.

    Args:
        curves: of all effects.
        name: of the effect whose signature it is.
        mine: the signature.
        weakest: d' from which another effect counts.
    """
    found = {}
    for other, curve in curves.items():
        usable = np.flatnonzero(curve.lengths >= weakest)
        if other != name and other in CATALOGUE and len(usable):
            found[other] = max(abs(cosine(mine, curve.signatures[:, k])) for k in usable)
    return found
