"""How strong an effect is in a study, and whether it can be told apart: fixed from the truth before any search runs.

The signature of an effect is the change of the coarse statistics of the fitted conditions, whitened by their scatter
over replicates and freed of what an error of each condition's weather record does. Its length is the detectability d'.
Two sets of seeds, A and B, keep the noise of the estimate out of lengths and cosines: products are taken between a
signature of A and one of B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .coarse_statistics import BROAD, Tally
from .design import Design
from .effects import CATALOGUE, Known
from .lidar_sensor import Effect, Weather, shoot
from .outside import OUTSIDE
from .scene import FloatArray

__all__ = ["IDENTIFIABLE_BELOW", "KINDS", "STRENGTHS", "Curve", "Detector"]

KINDS: dict[str, type[Known]] = {**CATALOGUE, **OUTSIDE}
IDENTIFIABLE_BELOW = 0.95
STRENGTHS = tuple(float(value) for value in np.linspace(0.1, 1.0, 8))
# Frames of each condition and seed set, and base frames from which the scatter is taken.
FRAMES, MANY_FRAMES, REPLICATES = 3, 12, 24
# Weight of the diagonal in the pooled correlation: 24 replicates a condition cannot hold all of it.
SHRINKAGE = 0.4
RATE_STEP, RATE_FRAMES = 1.25, 12
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
        self._whiten = vectors * (1.0 / np.sqrt(np.maximum(values, 0.5 * SHRINKAGE)))
        self._base = {
            count: np.stack([self._totals((), side, count=count) for side in (0, 1)]) for count in (FRAMES, MANY_FRAMES)
        }
        self._rate = self._rate_directions()

    def _frames(
        self, number: int, weather: Weather, effects: tuple[Effect, ...], frames: int, seed: int
    ) -> tuple[FloatArray, FloatArray]:
        scene = self.conditions[number].scene
        rng = np.random.default_rng([self.seed, seed, number])
        return self._tallies[scene](shoot(self.design.views[scene], weather, effects, 10.0 * np.arange(frames), rng))

    def _totals(self, effects: tuple[Effect, ...], side: int, factor: float = 1.0, count: int = FRAMES) -> FloatArray:
        """Whitened mean of every condition, and log variances between frames of the broad statistics, ``(C, K)``.

        In units of the scatter of the mean over a condition's frames, that of the clear frames included.
        """
        unit = np.sqrt(1.0 / self.design.size.frames + 1.0 / self.design.size.clear_frames)
        rows = []
        for number, one in enumerate(self.conditions):
            amount = one.weather.amount / factor if one.weather.kind == "fog" else one.weather.amount * factor
            frames, _ = self._frames(number, Weather(one.weather.kind, amount), effects, count, side)
            scaled = frames / self._spread[number]
            mean = scaled.mean(0) @ self._whiten / unit
            # The log of the variance of n frames scatters by about sqrt(2 / (n - 1)).
            scatter = np.log(scaled[:, -BROAD:].var(0, ddof=1) + LEAST_VARIANCE)
            rows.append(np.append(mean, scatter / np.sqrt(2.0 / (self.design.size.frames - 1))))
        return np.stack(rows)

    def _rate_directions(self) -> FloatArray:
        """Unit vector of a change of each condition's rate, ``(C, K)``."""
        base = self._totals((), 2, count=RATE_FRAMES)
        change = self._totals((), 2, RATE_STEP, RATE_FRAMES) - base
        change = np.where(np.abs(change) > NOISE_CUT, change, 0.0)
        return np.asarray(change / np.maximum(np.linalg.norm(change, axis=1, keepdims=True), 1e-9))

    def signature(self, effects: tuple[Effect, ...], scatter_only: bool = False) -> FloatArray:
        """Of both seed sets, ``(2, C K)``, without what the rates can explain.

        ``scatter_only`` keeps the variances between frames: an effect that differs from frame to frame moves the mean
        of a few frames by chance.
        """
        count = MANY_FRAMES if scatter_only else FRAMES
        change = np.stack([self._totals(effects, side, count=count) for side in (0, 1)]) - self._base[count]
        if scatter_only:
            change[..., :-BROAD] = 0.0
            return np.asarray(change.reshape(2, -1))
        along = (change * self._rate).sum(-1, keepdims=True)
        return np.asarray((change - along * self._rate).reshape(2, -1))

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
        if other != name and other in CATALOGUE and len(usable):
            found[other] = max(abs(cosine(mine, curve.signatures[:, k])) for k in usable)
    return found
