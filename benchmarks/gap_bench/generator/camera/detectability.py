"""How strong an effect is in a study, and whether it can be told apart: fixed from the truth before any search runs.

The signature of an effect is the change of coarse statistics of the fitted conditions, whitened by their scatter over
frames and freed of what an error of each condition's weather record does. A picture has so many pixels that their noise
leaves a mean known to 1e-5; what weather does to it is known to nobody as well as that, so a share of it counts as
scatter, and so does what cameras of one type differ by. The signature's length is the detectability d'. Products
are taken between two sets of seeds, so that noise of the estimate enters neither lengths nor cosines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .camera_sensor import Effect, Weather, shoot
from .design import Design
from .effects import CATALOGUE
from .outside import KINDS
from .scene import SKY, FloatArray, Street

__all__ = ["IDENTIFIABLE_BELOW", "STRENGTHS", "Detector", "Table"]

IDENTIFIABLE_BELOW = 0.95
STRENGTHS = tuple(float(value) for value in np.linspace(0.0, 1.0, 6))
FRAMES, SCATTER_FRAMES = 2, 10
SHRINKAGE = 0.4
RATE_STEP = 1.2
DEPTHS_M = (0.0, 9.0, 18.0, 40.0, 1e6)
LAGS = ((0, 2), (2, 0), (2, 2), (2, -2), (0, 4), (8, 0))
DARKEST = 2e-3
LEAST_SCATTER = 1e-3  # of a logarithm or a share, of the mean over a condition's frames
LEAST_OF_SPREAD = 0.01  # of the logarithm of a standard deviation: noise and texture are known less well
KNOWN_TO = 0.01  # of what weather does to a statistic
NOISE_CUT = 2.0  # whitened changes below this many standard deviations count for nothing in a direction
SHOWS_FROM = 5.0
BISECTIONS, NEAR = 7, (0.8, 1.25)  # d' over its level that counts as the level


class _Coarse:
    """Coarse statistics of frames of a street: brightness, texture and sharpness by depth, colour and place."""

    def __init__(self, street: Street, clear: FloatArray) -> None:
        self.clear = np.log(np.maximum(_planes(clear.mean(0)), DARKEST))
        self.raw = clear.mean(0)
        depth = street.depth_m[::2, ::2]
        kinds = np.digitize(np.minimum(depth, 1e5), DEPTHS_M) - 1
        kinds = np.where(street.label[::2, ::2] == SKY, len(DEPTHS_M) - 1, kinds)
        x, y = (value[::2, ::2] for value in street.eye.rays)
        level = self.clear[1]
        masks = [kinds == kind for kind in range(len(DEPTHS_M))]
        masks += [mask & (level > np.median(level[mask])) for mask in masks[:-1] if mask.any()]
        radius = np.hypot(x, y)
        masks += [(radius >= low) & (radius < high) for low, high in ((0.0, 0.2), (0.2, 0.4), (0.4, 9.0))]
        far = (depth > 18.0) & (street.label[::2, ::2] != SKY)
        masks += [far & (y < -0.05), far & (np.abs(y) < 0.05), far & (y > 0.0)]
        masks += [street.normal[::2, ::2, 2] > 0.7, np.abs(street.normal[::2, ::2, 2]) < 0.3]
        masks += [(x < 0.0), (x >= 0.0)]
        self.masks = [mask for mask in masks if mask.sum() > 30]
        self.near = street.depth_m < 20.0
        kinds_of_depth, lags = len(self.masks[: len(DEPTHS_M)]), 2 * len(LAGS)
        spread = [False] * (3 * len(self.masks)) + [True] * kinds_of_depth + [True, False] * lags + [False] * 8
        self.least = np.where(spread, LEAST_OF_SPREAD, LEAST_SCATTER)

    def __call__(self, frame: FloatArray) -> FloatArray:
        """``(S,)`` of one frame."""
        ratio = np.log(np.maximum(_planes(frame), DARKEST)) - self.clear
        found = [ratio[colour][mask].mean() for colour in range(3) for mask in self.masks]
        found += [np.log(ratio[1][mask].std() + 1e-4) for mask in self.masks[: len(DEPTHS_M)]]
        apart = frame - self.raw
        for down, aside in LAGS:
            difference = _difference(apart, down, aside)
            before, after = _difference(self.raw, down, aside), _difference(frame, down, aside)
            near = self.near[: difference.shape[0], : difference.shape[1]]
            for where in (near, ~near):
                found.append(np.log(difference[where].std() + 1e-5))
                found.append((before * after)[where].sum() / (before**2)[where].sum())
        size = np.abs(apart / np.sqrt(np.maximum(self.raw, 0.01) / 9000.0))
        found += [np.arcsin(np.sqrt((size > limit).mean())) for limit in (3.0, 5.0, 9.0, 20.0)]
        found += [np.arcsin(np.sqrt((frame > limit).mean())) for limit in (0.5, 0.6, 0.7, 0.8)]
        return np.asarray(found)


def _planes(frame: FloatArray) -> FloatArray:
    return np.stack([frame[0::2, 0::2], 0.5 * (frame[0::2, 1::2] + frame[1::2, 0::2]), frame[1::2, 1::2]])


def _difference(frame: FloatArray, down: int, aside: int) -> FloatArray:
    height, width = frame.shape
    left, right = max(-aside, 0), width - max(aside, 0)
    return frame[down:, left + aside : right + aside] - frame[: height - down, left:right]


@dataclass(frozen=True)
class Table:
    """An effect of growing strength: d' and signatures ``(2, strengths, K)`` of both seed sets."""

    name: str
    lengths: FloatArray
    signatures: FloatArray

    def about(self, length: float) -> tuple[float, float] | None:
        """Two strengths between whose d' a length lies; ``None`` where no strength reaches it, or all do."""
        rising = np.minimum.accumulate(self.lengths[::-1])[::-1]
        above = np.flatnonzero(rising >= length)
        if not len(above) or above[0] == 0:
            return None
        return STRENGTHS[int(above[0]) - 1], STRENGTHS[int(above[0])]


class Detector:
    """Signatures in one design.

    Args:
        design: streets and conditions.
        seed: of the frames, unlike that of any study.
    """

    def __init__(self, design: Design, seed: int) -> None:
        self.design, self.seed = design, seed
        self.conditions = [one for one in design.conditions if one.split == "fit"]
        self._coarse = [
            _Coarse(street, shoot(street, Weather(), (), design.size.clear_frames, np.random.default_rng([seed, 3, k])))
            for k, street in enumerate(design.streets)
        ]
        residuals, self._spread = [], []
        for number, one in enumerate(self.conditions):
            rows = self._rows(number, one.weather, (), SCATTER_FRAMES, 9)
            spread = np.maximum(rows.std(0, ddof=1), 1e-9)
            clear = self._rows(number, Weather(), (), FRAMES, 8).mean(0)
            known = np.hypot(KNOWN_TO * (rows.mean(0) - clear), self._coarse[one.street].least)
            self._spread.append(np.hypot(spread / np.sqrt(design.size.frames), known))
            residuals.append((rows - rows.mean(0)) / spread)
        width = max(row.shape[1] for row in residuals)
        self._whiten = []
        for rows in residuals:
            correlation = (1.0 - SHRINKAGE) * rows.T @ rows / (len(rows) - 1) + SHRINKAGE * np.eye(rows.shape[1])
            values, vectors = np.linalg.eigh(correlation)
            self._whiten.append(vectors / np.sqrt(values))
        assert width
        self._base = [self._means((), side) for side in (0, 1)]
        self._rates = self._directions()

    def _rows(self, number: int, weather: Weather, effects: tuple[Effect, ...], frames: int, side: int) -> FloatArray:
        street = self.conditions[number].street
        rng = np.random.default_rng([self.seed, side, number])
        shot = shoot(self.design.streets[street], weather, effects, frames, rng)
        return np.stack([self._coarse[street](frame) for frame in shot])

    def _means(self, effects: tuple[Effect, ...], side: int, factor: float = 1.0) -> list[FloatArray]:
        """Whitened mean of each condition."""
        found = []
        for number, one in enumerate(self.conditions):
            weather = Weather(one.weather.kind, one.weather.amount * factor)
            rows = self._rows(number, weather, effects, FRAMES, side)
            found.append((rows.mean(0) / self._spread[number]) @ self._whiten[number])
        return found

    def _directions(self) -> list[FloatArray]:
        """Unit vectors along which an error of the record moves each condition."""
        moved = self._means((), 0, RATE_STEP)
        change = [after - before for after, before in zip(moved, self._base[0], strict=True)]
        return [one / max(float(np.linalg.norm(one)), 1e-9) for one in change]

    def signature(self, effects: tuple[Effect, ...]) -> FloatArray:
        """Of both seed sets ``(2, K)``, without what the record can explain."""
        sides = []
        for side in (0, 1):
            change = [
                after - before for after, before in zip(self._means(effects, side), self._base[side], strict=True)
            ]
            free = [one - (one @ along) * along for one, along in zip(change, self._rates, strict=True)]
            sides.append(np.concatenate(free))
        return np.stack(sides)

    def table(self, name: str) -> Table:
        """Signatures of an effect over its strengths."""
        found = [self.signature((KINDS[name].at(strength),)) for strength in STRENGTHS]
        return Table(name, np.array([_length(one) for one in found]), np.stack(found, 1))

    def strength_for(self, table: Table, level: float) -> float | None:
        """A strength of an effect whose d' is a level, by bisection; ``None`` where none was found."""
        ends = table.about(level)
        if ends is None:
            return None
        low, high = ends
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            found = _length(self.signature((KINDS[table.name].at(middle),)))
            if NEAR[0] * level <= found <= NEAR[1] * level:
                return middle
            low, high = (middle, high) if found < level else (low, middle)
        return None


def _length(signature: FloatArray) -> float:
    """d': one seed set's signature along the direction of the other's, both ways."""
    found = []
    for one, other in ((0, 1), (1, 0)):
        direction = np.where(np.abs(signature[one]) > NOISE_CUT, signature[one], 0.0)
        norm = float(np.linalg.norm(direction))
        found.append(float(signature[other] @ direction) / norm if norm > 0.0 else 0.0)
    return float(np.mean(found))


def confusable(tables: Sequence[Table], name: str, strength: float) -> dict[str, float]:
    """Effects of the catalogue whose signature's cosine with that of an effect is ``IDENTIFIABLE_BELOW`` or more."""
    mine = next(table for table in tables if table.name == name)
    own = mine.signatures[:, int(np.argmin(np.abs(np.array(STRENGTHS) - strength)))]
    found = {}
    for table in tables:
        if table.name == name or table.name not in CATALOGUE:
            continue
        shown = np.flatnonzero(table.lengths >= SHOWS_FROM)
        best = max((abs(_cosine(own, table.signatures[:, place])) for place in shown), default=0.0)
        if best >= IDENTIFIABLE_BELOW:
            found[table.name] = best
    return found


def _cosine(first: FloatArray, second: FloatArray) -> float:
    across = 0.5 * (first[0] @ second[1] + first[1] @ second[0])
    norm = np.sqrt(max(first[0] @ first[1], 1e-9) * max(second[0] @ second[1], 1e-9))
    return float(np.clip(across / norm, -1.0, 1.0))
