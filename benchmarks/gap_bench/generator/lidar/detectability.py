"""How strong an effect is in a study, and whether it can be told apart: fixed from the truth before any search runs.

The signature of an effect is the change of the coarse statistics of the fitted conditions, whitened by their scatter
over replicates and freed of what an error of each condition's weather record does. Its length is the detectability d'.
Each condition has noise of its own frames; the noise of a scene's clear frames, with which they are compared, is the
same for all its conditions, and so is what those few frames leave open of the scale of intensities: it decides which
returns the threshold takes.
Two sets of seeds, A and B, keep the noise of the estimate out of lengths and cosines: products are taken between a
signature of A and one of B.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .coarse_statistics import BROAD, Tally
from .design import Design
from .effects import CATALOGUE
from .known import Known
from .lidar_sensor import SCALE_SPREAD, shoot
from .lidar_shot import Effect, View, Weather
from .measured_forms import MEASURED
from .outside import OUTSIDE
from .scene import FloatArray

__all__ = ["IDENTIFIABLE_BELOW", "KINDS", "STRENGTHS", "Curve", "Detector", "brighter", "independent"]

KINDS: dict[str, type[Known]] = {**CATALOGUE, **OUTSIDE, **MEASURED}
IDENTIFIABLE_BELOW = 0.95
STRENGTHS = tuple(float(value) for value in np.linspace(0.1, 1.0, 8))
# Frames of each condition and seed set, and base frames from which the scatter is taken.
FRAMES, MANY_FRAMES, REPLICATES = 3, 12, 24
# Weight of the diagonal in the pooled correlation: 24 replicates a condition cannot hold all of it.
SHRINKAGE = 0.4
RATE_STEP, RATE_FRAMES = 1.25, 12
# A rate may be off by any number of its directions' units; brightness by which the response to a scale is taken.
RATE_KNOWN_TO, SCALE_STEP = 1e4, 0.3
# Variances between a few frames below this share of that of the replicates are chance.
LEAST_VARIANCE = 0.3
# Whitened changes below this many standard deviations of their own noise are set to 0 in a direction.
NOISE_CUT = 2.0


@dataclass(frozen=True)
class Curve:
    """An effect of growing strength in one design.

    Args:
        name: in the catalogue.
        fixed: parameters that are not swept.
        sign: of the swept one.
        strengths, lengths: d' at each strength.
        signatures: ``(2, strengths, K)`` of both seed sets.
    """

    name: str
    fixed: dict[str, float]
    sign: float
    strengths: FloatArray
    lengths: FloatArray
    signatures: FloatArray

    def strength_for(self, length: float) -> float | None:
        """The weakest strength whose d' reaches ``length``; ``None`` where no strength does."""
        rising = np.minimum.accumulate(self.lengths[::-1])[::-1]  # from where on it stays that long
        above = np.flatnonzero(rising >= length)
        if not len(above):
            return None
        high = int(above[0])
        if high == 0:  # d' grows about with the swept parameter, which grows by a factor per strength
            return float(self.strengths[0])
        low = high - 1
        start, end = np.log(max(rising[low], 0.3)), np.log(rising[high])
        share = (np.log(length) - start) / max(end - start, 1e-9)
        return float(self.strengths[low] + share * (self.strengths[high] - self.strengths[low]))

    def effect(self, strength: float) -> Known:
        """The effect at a strength."""
        return KINDS[self.name].at(self.sign * strength, self.fixed)

    def signature(self, strength: float) -> FloatArray:
        """Of both seed sets at the nearest strength, ``(2, K)``."""
        return self.signatures[:, int(np.argmin(np.abs(self.strengths - strength)))]


class Detector:
    """Signatures in one design.

    Args:
        design: scenes and conditions.
        seed: of the replicates, unlike those of any study.
    """

    scale_spread = SCALE_SPREAD

    def __init__(self, design: Design, seed: int) -> None:
        self.design, self.seed = design, seed
        self.conditions = [one for one in design.conditions if one.split == "fit"]
        self._tallies = [Tally(view) for view in design.views]
        residuals, self._spread = [], []
        for number, one in enumerate(self.conditions):
            base, floor = self._frames(number, one.weather, (), REPLICATES, 9)
            spread = np.maximum(base.std(0, ddof=1), floor)
            self._spread.append(spread)
            residuals.append((base - base.mean(0)) / spread)
        pooled = np.concatenate(residuals)
        correlation = (1.0 - SHRINKAGE) * pooled.T @ pooled / len(pooled) + SHRINKAGE * np.eye(pooled.shape[1])
        values, vectors = np.linalg.eigh(correlation)
        whiten = vectors * (1.0 / np.sqrt(np.maximum(values, 0.5 * SHRINKAGE)))
        # Rotated so that the clear frames' noise is independent, too: of particles they have none.
        clear = self._clear_scatter()
        self._clear, axes = np.linalg.eigh(whiten.T @ (correlation * np.outer(clear, clear)) @ whiten)
        self._whiten = whiten @ axes
        self._base = {
            count: np.stack([self._totals((), side, count=count) for side in (0, 1)]) for count in (FRAMES, MANY_FRAMES)
        }
        self._free = self._projection()

    def _frames(
        self,
        number: int,
        weather: Weather,
        effects: tuple[Effect, ...],
        frames: int,
        seed: int,
        scale: float = 1.0,
    ) -> tuple[FloatArray, FloatArray]:
        scene = self.conditions[number].scene
        rng = np.random.default_rng([self.seed, seed, number])
        view = brighter(self.design.views[scene], scale)
        return self._tallies[scene](shoot(view, weather, effects, 10.0 * np.arange(frames), rng))

    def _totals(
        self,
        effects: tuple[Effect, ...],
        side: int,
        factor: float = 1.0,
        count: int = FRAMES,
        scales: tuple[float, ...] | None = None,
    ) -> FloatArray:
        """Whitened mean of every condition, and log variances between frames of the broad statistics, ``(C, K)``.

        The mean over a condition's frames in units of its scatter; ``scales`` of the targets of each scene.
        """
        rows = []
        for number, one in enumerate(self.conditions):
            amount = one.weather.amount / factor if one.weather.kind == "fog" else one.weather.amount * factor
            scale = 1.0 if scales is None else scales[one.scene]
            frames, _ = self._frames(number, Weather(one.weather.kind, amount), effects, count, side, scale)
            scaled = frames / self._spread[number]
            mean = scaled.mean(0) @ self._whiten * np.sqrt(self.design.size.frames)
            # The log of the variance of n frames scatters by about sqrt(2 / (n - 1)).
            scatter = np.log(scaled[:, -BROAD:].var(0, ddof=1) + LEAST_VARIANCE)
            rows.append(np.append(mean, scatter / np.sqrt(2.0 / (self.design.size.frames - 1))))
        return np.stack(rows)

    def _clear_scatter(self) -> FloatArray:
        """Scatter of clear frames over that of frames in weather, of each statistic, at most 1."""
        ratios = []
        for number in range(len(self.conditions)):
            clear, _ = self._frames(number, Weather(), (), REPLICATES, 8)
            ratios.append(clear.std(0, ddof=1) / self._spread[number])
        return np.asarray(np.minimum(np.mean(ratios, 0), 1.0))

    def _apart(self, rows: FloatArray) -> FloatArray:
        """Rows ``(..., C, K)`` in units in which all are independent: freed of what a scene's clear frames share."""
        shared = self._clear * self.design.size.frames / self.design.size.clear_frames
        means = independent(rows[..., :-BROAD], [one.scene for one in self.conditions], shared)
        return np.concatenate([means, rows[..., -BROAD:]], -1)

    def _projection(self) -> FloatArray:
        """``(C K, C K)``: takes what errors of the rates do out of a signature, and what a scale can do."""
        base = self._totals((), 2, count=RATE_FRAMES)
        conditions = np.arange(len(self.conditions))
        change = self._totals((), 2, RATE_STEP, RATE_FRAMES) - base
        change = np.where(np.abs(change) > NOISE_CUT, change, 0.0)
        rates = np.zeros((len(conditions), *change.shape))
        rates[conditions, conditions] = change / np.maximum(np.linalg.norm(change, axis=1, keepdims=True), 1e-9)
        # So far that it stands out of noise; by one standard deviation of the mean of the clear frames.
        one_sd = self.scale_spread / np.sqrt(self.design.size.clear_frames)
        scaled = []
        for scene in range(len(self.design.views)):
            scales = tuple(1.0 + SCALE_STEP * (place == scene) for place in range(len(self.design.views)))
            moved = self._totals((), 2, count=RATE_FRAMES, scales=scales) - base
            scaled.append(np.where(np.abs(moved) > NOISE_CUT, moved, 0.0) * one_sd / SCALE_STEP)
        directions = self._apart(np.concatenate([RATE_KNOWN_TO * rates, np.stack(scaled)]))
        # The root of the inverse of 1 + the covariance that they make.
        _, strengths, axes = np.linalg.svd(directions.reshape(len(directions), -1), full_matrices=False)
        return np.asarray(np.eye(axes.shape[1]) - (axes.T * (1.0 - 1.0 / np.hypot(1.0, strengths))) @ axes)

    def signature(self, effects: tuple[Effect, ...], scatter_only: bool = False) -> FloatArray:
        """Of both seed sets, ``(2, C K)``, without what the rates and a scale can explain.

        ``scatter_only`` keeps the variances between frames: an effect that differs from frame to frame moves the mean
        of a few frames by chance.
        """
        count = MANY_FRAMES if scatter_only else FRAMES
        change = np.stack([self._totals(effects, side, count=count) for side in (0, 1)]) - self._base[count]
        if scatter_only:
            change[..., :-BROAD] = 0.0
            return np.asarray(change.reshape(2, -1))
        return np.asarray(self._apart(change).reshape(2, -1) @ self._free)

    def length_of(self, effect: Known) -> float:
        """d' of an effect."""
        return length(self.signature((effect,), effect.differs))

    def curve(self, name: str, fixed: dict[str, float], sign: float) -> Curve:
        """Signatures of an effect over its strengths."""
        kind = KINDS[name]
        found = [self.signature((kind.at(sign * strength, fixed),), kind.differs) for strength in STRENGTHS]
        signatures = np.stack(found, 1)
        lengths = np.array([length(one) for one in found])
        return Curve(name, fixed, sign, np.array(STRENGTHS), lengths, signatures)


def brighter(view: View, scale: float) -> View:
    """A view whose targets send back so many times as much."""
    if scale == 1.0:
        return view
    return replace(view, target=replace(view.target, reflectivity=view.target.reflectivity * scale))


def independent(rows: FloatArray, scenes: list[int], shared: FloatArray) -> FloatArray:
    """Rows ``(..., C, K)``, in units of the noise of a condition's own frames, in units in which they are independent.

    Conditions of a scene have variances ``shared (K,)`` in common: their covariance is ``1 + J shared``, whose inverse
    root takes a part of their mean away from each.
    """
    found = np.array(rows, dtype=np.float64)
    for scene in set(scenes):
        places = [place for place, one in enumerate(scenes) if one == scene]
        mean = rows[..., places, :].mean(-2, keepdims=True)
        found[..., places, :] -= mean * (1.0 - 1.0 / np.sqrt(1.0 + len(places) * np.maximum(shared, 0.0)))
    return found


def _direction(signature: FloatArray) -> FloatArray:
    """A signature with what is likely noise set to 0."""
    return np.where(np.abs(signature) > NOISE_CUT, signature, 0.0)


def length(signature: FloatArray) -> float:
    """d': one seed set's signature along the direction of the other's, both ways."""
    found = []
    for one, other in ((0, 1), (1, 0)):
        direction = _direction(signature[one])
        norm = float(np.linalg.norm(direction))
        found.append(float(signature[other] @ direction) / norm if norm > 0.0 else 0.0)
    return float(np.mean(found))


def cosine(first: FloatArray, second: FloatArray) -> float:
    """Of two signatures ``(2, K)``, products between the seed sets only."""
    across = 0.5 * (first[0] @ second[1] + first[1] @ second[0])
    norm = np.sqrt(max(first[0] @ first[1], 1e-9) * max(second[0] @ second[1], 1e-9))
    return float(np.clip(across / norm, -1.0, 1.0))


def confusion(curves: dict[str, Curve], name: str, strength: float, weakest: float = 5.0) -> dict[str, float]:
    """Largest absolute cosine of an effect's signature with each other of the catalogue that shows at all."""
    mine = curves[name].signature(strength)
    found = {}
    for other, curve in curves.items():
        usable = np.flatnonzero(curve.lengths >= weakest)
        if other != name and other not in OUTSIDE and len(usable):
            found[other] = max(abs(cosine(mine, curve.signatures[:, k])) for k in usable)
    return found
