"""What particles cover of a camera's frames: rendered at a few settings for each seed, and taken between them.

The optical depth of drops and flakes grows with their number; between two neighbouring rates, and between two numbers
of particles, it is taken as a line. The few particles that one of the two has more are then seen in part: at steps of
``exp(0.1)`` in the rate one particle in ten. So it is between two depths up to which there are particles, and, at steps
that move the end of a streak by a fraction of a pixel, between two slants.
"""

from __future__ import annotations

import copy
import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from torchweather.gap.study import Condition
from torchweather.stages import CameraState, ParticleVeil

__all__ = ["LEAST_STEP", "MOST_STEP", "Rendered"]

LEAST_STEP, MOST_STEP = 0.04, 0.12  # of the logarithm of the rate between two that are rendered
COUNT_STEP = 0.2  # of that of the number of particles
LEAST_COUNT = math.exp(-10 * COUNT_STEP)  # fewer are those, fainter
KEPT_BYTES = 100e6  # of optical depths, of a condition
REACH_STEP = 0.1  # of that of the depth up to which there are particles
TANGENT_STEP = 0.02
WAYS = ("particle_reach_m", "path_tangent", "row_time_s")  # fields of the state that move particles
ALIKE = 1e-6  # of a step: a rate that is one of those rendered


class Rendered:
    """Particles in front of the frames of one condition.

    Args:
        stage: that renders them, at the recorded rate.
        condition: of the study.
    """

    def __init__(self, stage: ParticleVeil, condition: Condition) -> None:
        self.stage = stage
        self.alone = len(stage.parts) == 1
        self.step = min(max(condition.rel_sd, LEAST_STEP), MOST_STEP)
        self.rates = [part.rate_mm_per_h for part in stage.parts]
        self.log_rate = 0.0  # logarithm over the record about which rates are rendered
        self._kept: OrderedDict[object, Tensor] = OrderedDict()
        self._drawn: tuple[list[int], dict[str, Tensor]] | None = None
        self._lock = threading.Lock()

    def __call__(self, state: CameraState, log_knob: float, seeds: list[int]) -> CameraState:
        """The state behind the particles of some seeds.

        Args:
            state: with what effects say of particles.
            log_knob: logarithm of the rate over its record.
            seeds: one for each frame.
        """
        if not self.alone or state.fog_extinction_per_m is not None:
            noise = self.stage.draw(state, seed=torch.tensor(seeds), name=self.stage.default_name)
            return self._at(log_knob)(state, noise)  # type: ignore[no-any-return]
        return self.stage.behind(state, -torch.expm1(-self._optical(state, log_knob, seeds)))

    def _at(self, log_knob: float) -> ParticleVeil:
        """The stage at another rate."""
        found = copy.copy(self.stage)
        found._modules = dict(self.stage._modules)
        populations = torch.nn.ModuleList()
        for part, rate in zip(self.stage.parts, self.rates, strict=True):
            other = copy.copy(part)
            other._buffers = {**part._buffers, "rate_mm_per_h": rate * math.exp(log_knob)}
            populations.append(other)
        found._modules["populations"] = populations
        return found

    def _optical(self, state: CameraState, log_knob: float, seeds: list[int]) -> Tensor:
        """Optical depth of the particles of each frame, ``(F, 1, H, W)``; all frames have the same effects."""
        count = 1.0 if state.particle_count is None else float(state.particle_count[0])
        total = torch.zeros_like(state.signal)
        if count == 0.0:
            return total
        more = max(count, LEAST_COUNT)
        steps, counts = _between(log_knob - self.log_rate, self.step), _between(math.log(more), COUNT_STEP)
        rates = [(round(self.log_rate + number * self.step, 12), share) for number, share in steps]
        ways = {name: ends for name in WAYS if (ends := self._ends(name, getattr(state, name))) is not None}
        for (log_rate, share), (number, part), way in itertools.product(
            rates, counts, itertools.product(*ways.values())
        ):
            moved = {name: value for name, (value, _) in zip(ways, way, strict=True)}
            weight = share * part * math.prod(of for _, of in way)
            nodes = self._nodes(state, log_rate, number, moved, seeds)
            total.add_(torch.stack([nodes[seed] for seed in seeds]).float(), alpha=weight)
        return total * (count / more)

    def _ends(self, name: str, given: Tensor | None) -> list[tuple[float, float]] | None:
        """Values of a field that are rendered, below and above that of all frames, with their shares."""
        if given is None:
            return None
        value = float(given[0])
        if name == "path_tangent":
            return [(place * TANGENT_STEP, share) for place, share in _on_a_line(value / TANGENT_STEP)]
        if name == "particle_reach_m":
            nearest, farthest = (self.stage.options[end] for end in ("near_m", "far_m"))
            share = min(max(value, nearest), farthest) / farthest
            return [(farthest * math.exp(k * REACH_STEP), of) for k, of in _between(math.log(share), REACH_STEP)]
        return [(value, 1.0)]  # a shutter that rolls moves near streaks by whole pixels

    def _nodes(
        self, state: CameraState, log_rate: float, number: int, moved: Mapping[str, float], seeds: list[int]
    ) -> dict[int, Tensor]:
        """Optical depth ``(1, H, W)`` of each seed at one of the settings that are rendered, as float16."""
        setting = (log_rate, number, *moved.items())
        found: dict[int, Tensor] = {}
        with self._lock:
            for seed in dict.fromkeys(seeds):
                if (setting, seed) in self._kept:
                    found[seed] = self._kept[setting, seed]
                    self._kept.move_to_end((setting, seed))
        missing = [seed for seed in dict.fromkeys(seeds) if seed not in found]
        if not missing:
            return found
        way = {name: state.signal.new_full((len(missing),), value) for name, value in moved.items()}
        bare = replace(
            state,
            signal=state.signal[: len(missing)],
            keep_truth=True,
            normal=None,
            particle_count=None if number == 0 else torch.full((len(missing),), math.exp(number * COUNT_STEP)),
            particle_contrast=None,
            airlight_scale=None,
            particle_reach_m=way.get("particle_reach_m"),
            path_tangent=way.get("path_tangent"),
            row_time_s=way.get("row_time_s"),
        )
        mask = self._at(log_rate)(bare, self._noise(bare, missing)).particle_mask
        with self._lock:
            for seed, optical in zip(missing, (-torch.log1p(-mask)).half().unbind(0), strict=True):
                found[seed] = self._kept[setting, seed] = optical.clone()
            while len(self._kept) * optical.numel() * 2 > KEPT_BYTES:
                self._kept.popitem(last=False)
        return found

    def _noise(self, state: CameraState, seeds: list[int]) -> dict[str, Tensor]:
        """Random numbers of some seeds; those of the last ones are kept, as a few settings follow one another."""
        if self._drawn is None or self._drawn[0] != seeds:
            self._drawn = (seeds, self.stage.draw(state, seed=torch.tensor(seeds), name=self.stage.default_name))
        return self._drawn[1]


def _between(value: float, step: float) -> list[tuple[int, float]]:
    """Numbers of the steps below and above a logarithm, with shares that are linear in what it is the logarithm of.

    Example:
        >>> _between(0.2, 0.1)
        [(2, 1.0)]
        >>> [(number, round(share, 3)) for number, share in _between(0.05, 0.1)]
        [(0, 0.512), (1, 0.488)]
    """
    found = _on_a_line(value / step)
    if len(found) == 1:
        return found
    below = found[0][0]
    share = math.expm1(value - below * step) / math.expm1(step)
    return [(below, 1.0 - share), (below + 1, share)]


def _on_a_line(place: float) -> list[tuple[int, float]]:
    """Whole numbers below and above, with their shares; one alone if it is that."""
    nearest, below = round(place), math.floor(place)
    if abs(place - nearest) < ALIKE:
        return [(nearest, 1.0)]
    return [(below, below + 1 - place), (below + 1, place - below)]
