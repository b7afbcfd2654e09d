"""A simulator whose answer is known: every effect adds its own direction, times its strength, to Gaussian noise.

It stands in the place of a sensor's frames. What the search must find is then a matter of linear algebra: the strength
of each direction in the measured means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.atmosphere.weather import Snow
from torchweather.gap.statistics.frame_statistics import PARTICLE_AXIS, Group, Layout, Reduced
from torchweather.gap.study.conditions import Condition
from torchweather.lidar.effects.all import EFFECTS
from torchweather.pipeline.effect import Effect

Floats = NDArray[np.float64]

BINS, GROUPS = 12, 4
WEIGHT = 400.0  # elements of a bin and frame, each of variance 1
FRAMES, CLEAR = 6, 8
# Parameter of each effect and the bins that it moves; those of the first two overlap, the fourth covers two others.
DIRECTIONS: dict[str, tuple[str, slice]] = {
    "lidar.window_loss": ("loss_db", slice(0, 12)),
    "lidar.extinction_scale": ("factor", slice(8, 20)),
    "lidar.range_noise": ("std_m", slice(24, 34)),
    "lidar.wet_target": ("share", slice(24, 44)),
    "lidar.range_bias": ("offset_m", slice(34, 44)),
}
OPEN = "lidar.particle_backscatter"  # a systematic of the simulator, not an effect that can be named
RECORD = slice(12, 30)  # bins that follow the intensity of the weather
UNKNOWN = slice(44, 48)  # bins that no effect moves
SCATTER = 1.0 / np.sqrt(WEIGHT * FRAMES)
SIZE = BINS * GROUPS


def direction(name: str) -> Floats:
    """What one unit of an effect's parameter adds to the means: 10 to 30 scatters, growing along its bins."""
    found = np.zeros(SIZE)
    part = DIRECTIONS[name][1]
    found[part] = 20.0 * SCATTER * np.linspace(0.5, 1.5, part.stop - part.start)
    return found


def effect(name: str, strength: float) -> Effect:
    """An effect so many units from its identity."""
    parameter = DIRECTIONS[name][0]
    identity = next(one.identity for one in EFFECTS[name].arguments if one.name == parameter)
    return EFFECTS[name](**{parameter: (identity or 0.0) + strength})


def strength_of(one: Effect | str, values: Mapping[str, float] | None = None) -> float:
    """Units of an effect, or of fitted values of its parameters, from its identity."""
    name = one if isinstance(one, str) else one.id
    parameter = DIRECTIONS[name][0]
    identity = next(each.identity for each in EFFECTS[name].arguments if each.name == parameter)
    return float(getattr(one, parameter) if values is None else values[parameter]) - (identity or 0.0)


def unknown(scatters: float) -> Floats:
    """A pattern that no effect makes, of so many scatters in each of its bins."""
    found = np.zeros(SIZE)
    found[UNKNOWN] = scatters * np.array([1.0, -1.0, 1.0, -1.0])
    return found


def condition(name: str, split: str = "fit") -> Condition:
    """A condition without frames: the simulator draws them. Its record is known to a tenth."""
    frames: Any = ()
    return Condition(name, "street", Snow(2.0), frames, 0.1, None, split, None, None)


@dataclass
class LinearSimulator:
    """A `FrameModel` with a linear response.

    Args:
        hidden: effects of the measured frames; of the conditions that are held out ``elsewhere``, where given.
        unknown: added to the means of the measured frames, in scatters; no effect explains it.
        record: logarithm of the true intensity over the recorded one.
        effects: that the model has already.
        open_as: effect that something left open looks like, and its units of a standard deviation.
        drift: what stands open in the measured frames, in standard deviations.
        as_record: effects that do what an error of the record does.
        conditions: number of those that are fitted.
        clear_frames: of the one scene.
    """

    hidden: Sequence[Effect] = ()
    elsewhere: Sequence[Effect] | None = None
    unknown: Floats = field(default_factory=lambda: np.zeros(SIZE))
    record: float = 0.0
    effects: list[Effect] = field(default_factory=list)
    open_as: tuple[str, float] | None = None
    drift: float = 0.0
    seed: int = 0
    as_record: AbstractSet[str] = frozenset()
    conditions: int = 2
    clear_frames: Mapping[str, int] = field(default_factory=lambda: {"street": CLEAR})
    sizes: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    open_shifts: AbstractSet[str] = frozenset()
    map_cells: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        edges = tuple(float(one) for one in range(BINS + 1))
        binned = tuple(Group(f"statistic_{one}", PARTICLE_AXIS, "mean", edges) for one in range(GROUPS))
        self.layout = Layout(binned, (), (), ())
        self.fit = [condition(f"fitted {one}") for one in range(self.conditions)]
        self.holdout = [condition("held out", "holdout")]
        self.catalogue = tuple(DIRECTIONS)

    def _frames(self, mean: Floats, seeds: Sequence[int], portions: int = 1) -> Reduced:
        """Frames of a mean, in portions of their elements."""
        weight = np.full((len(seeds) * portions, SIZE), WEIGHT / portions)
        noise = [np.random.default_rng([seed, portions]).normal(size=(portions, SIZE)) for seed in seeds]
        entry = mean + np.concatenate(noise) / np.sqrt(weight)
        nothing = np.zeros((len(weight), 0))
        return Reduced(weight, weight * entry, weight * (entry**2 + 1.0), nothing, nothing[..., None])

    def added(self, effects: Sequence[Effect]) -> Floats:
        """Sum of the directions of effects, each times its strength."""
        total = np.zeros(SIZE)
        for one in effects:
            if one.id == OPEN and self.open_as:
                total += self.open_as[1] * float(one.gain_db) * direction(self.open_as[0])
            else:
                total += strength_of(one) * direction(one.id)
        return total

    def measured(self, condition: Condition) -> Reduced:
        """Frames with what is hidden, in the true intensity."""
        held = condition.split == "holdout" and self.elsewhere is not None
        own = self.elsewhere if held and self.elsewhere is not None else self.hidden
        stages = [*self.effects, *own, *self.systematics(condition, {"drift": self.drift})]
        place = [one.id for one in (*self.fit, *self.holdout)].index(condition.id)
        seeds = [100_000 + 1000 * self.seed + 10 * place + frame for frame in range(FRAMES)]
        return self._frames(self.added(stages) + self._of_record(self.record) + SCATTER * self.unknown, seeds)

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """Frames of clear air: noise."""
        return self._frames(np.zeros(SIZE), range(self.clear_frames[scene_id]), portions)

    def simulated(
        self,
        condition: Condition,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: Sequence[int],
        portions: int = 1,
    ) -> Reduced:
        """Frames of the model with further effects."""
        mean = self.added([*self.effects, *effects]) + self._of_record(log_intensity)
        return self._frames(mean, [seed % 2**31 for seed in seeds], portions)

    def _of_record(self, log_intensity: float) -> Floats:
        found = np.zeros(SIZE)
        found[RECORD] = 30.0 * SCATTER * log_intensity
        return found

    def open(self, condition: Condition) -> Mapping[str, float]:
        """One number that is left open, or none."""
        return {"drift": -10.0} if self.open_as else {}

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """What is open, at its strength."""
        strength = strengths.get("drift", 0.0)
        return [EFFECTS[OPEN](gain_db=strength)] if self.open_as and strength else []

    def misplaced(self, condition: Condition) -> float:
        """Particles are in their bin."""
        return 0.0

    def clear_noise(self, condition: Condition) -> None:
        """A simulated frame has the noise of its clear frame."""

    def left_open(self, condition: Condition) -> float:
        """Nothing beside how clear frames differ."""
        return 0.0

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Simulate about this weather: any will do here."""
