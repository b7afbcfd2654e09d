"""Cover of a camera's frames by particles: rendered at a few rates for each seed, and taken between them.

The optical depth of drops and flakes grows with their number and with the depth at which they end; between two
neighbouring rates, two numbers of particles and two such depths it is taken as a line. The few particles that one of
the two has more are then seen in part: at steps of ``exp(0.1)`` in the rate one particle in ten. What moves particles
is rendered as it is.
"""

from __future__ import annotations

import copy
import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Mapping

import torch
from torch import Tensor

from torchweather.camera.particles.veil import ParticleVeil
from torchweather.camera.state import CameraState
from torchweather.gap.study.study import Condition

__all__ = ["LEAST_STEP", "MOST_STEP", "REACH_STEP", "Rendered"]

LEAST_STEP, MOST_STEP = 0.04, 0.12  # of the logarithm of the rate between two that are rendered
COUNT_STEP = 0.2  # of that of the number of particles
REACH_STEP = 0.1  # of that of the depth at which they end, from where the model's own end
LEAST_COUNT = math.exp(-10 * COUNT_STEP)  # fewer are those, fainter
KEPT_BYTES = 200e6  # of optical depths, of a condition
WAYS = ("path_tangent", "row_time_s")  # fields of the state that move particles
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

    def __call__(self, state: CameraState, log_intensity: float, seeds: list[int]) -> CameraState:
        """The state behind the particles of some seeds.

        Args:
            state: with what effects say of particles.
            log_intensity: logarithm of the rate over its record.
            seeds: one for each frame.
        """
        if not self.alone or state.air.fog_extinction_per_m is not None:
            noise = self.stage.draw(state, seed=torch.tensor(seeds), name=self.stage.default_name)
            return self._at(log_intensity)(state, noise)  # type: ignore[no-any-return]
        return self.stage.behind(state, self._optical(state, log_intensity, seeds).neg_().expm1_().neg_())

    def _at(self, log_intensity: float) -> ParticleVeil:
        """The stage at another rate."""
        found = copy.copy(self.stage)
        found._modules = dict(self.stage._modules)
        populations = torch.nn.ModuleList()
        for part, rate in zip(self.stage.parts, self.rates, strict=True):
            other = copy.copy(part)
            other._buffers = {**part._buffers, "rate_mm_per_h": rate * math.exp(log_intensity)}
            populations.append(other)
        found._modules["populations"] = populations
        return found

    def _optical(self, state: CameraState, log_intensity: float, seeds: list[int]) -> Tensor:
        """Optical depth of the particles of each frame, ``(F, 1, H, W)``; all frames have the same effects."""
        count = 1.0 if state.air.particle_count is None else float(state.air.particle_count[0])
        total = torch.zeros_like(state.image.signal)
        if count == 0.0:
            return total
        more = max(count, LEAST_COUNT)
        way = {name: float(given[0]) for name in WAYS if (given := state.field(name)) is not None}
        log_reach = self._log_reach(state)
        if way:  # seldom twice the same
            rendered = self._render(state, log_intensity, math.log(more), log_reach, way, seeds)
            return rendered.float().mul_(count / more)
        axes = (
            _between(log_intensity - self.log_rate, self.step),
            _between(math.log(more), COUNT_STEP),
            _between(log_reach, REACH_STEP),
        )
        for (rate, share), (number, part), (end, piece) in itertools.product(*axes):
            nodes = self._nodes(state, round(self.log_rate + rate * self.step, 12), number, end, seeds)
            total.add_(torch.stack([nodes[seed] for seed in seeds]).float(), alpha=share * part * piece)
        return total.mul_(count / more)

    def _log_reach(self, state: CameraState) -> float:
        """Logarithm of the depth at which the particles of all frames end over the model's own end, 0 or less."""
        if state.air.particle_reach_m is None:
            return 0.0
        (part,) = self.stage.parts
        reach_m = min(max(float(state.air.particle_reach_m[0]), part.near_m), part.far_m)
        return math.log(reach_m / part.far_m)

    def _nodes(self, state: CameraState, log_rate: float, number: int, end: int, seeds: list[int]) -> dict[int, Tensor]:
        """Optical depth ``(1, H, W)`` of each seed at one of the rates, numbers and ends that are rendered; float16."""
        key = (log_rate, number, end)
        found: dict[int, Tensor] = {}
        with self._lock:
            for seed in dict.fromkeys(seeds):
                if (key, seed) in self._kept:
                    found[seed] = self._kept[key, seed]
                    self._kept.move_to_end((key, seed))
        missing = [seed for seed in dict.fromkeys(seeds) if seed not in found]
        if not missing:
            return found
        rendered = self._render(state, log_rate, number * COUNT_STEP, end * REACH_STEP, {}, missing)
        with self._lock:
            for seed, optical in zip(missing, rendered.unbind(0), strict=True):
                found[seed] = self._kept[key, seed] = optical.clone()
            while len(self._kept) * rendered[0].numel() * 2 > KEPT_BYTES:
                self._kept.popitem(last=False)
        return found

    def _render(
        self,
        state: CameraState,
        log_rate: float,
        log_count: float,
        log_reach: float,
        way: Mapping[str, float],
        seeds: list[int],
    ) -> Tensor:
        """Optical depth ``(F, 1, H, W)`` of the frame of each seed, as float16."""
        number = len(seeds)
        # One value for all frames: what it is looked up for is then looked up once.
        moved = {name: torch.full((1,), value) for name, value in way.items()}
        count = None if log_count == 0.0 else torch.full((1,), math.exp(log_count))
        reach_m = None
        if log_reach < 0.0:
            reach_m = torch.full((1,), self.stage.parts[0].far_m * math.exp(log_reach))
        bare = state.changed(
            signal=state.image.signal[:1].expand(number, -1, -1, -1),
            normal=None,
            particle_count=count,
            particle_contrast=None,
            airlight_scale=None,
            particle_reach_m=reach_m,
            path_tangent=moved.get("path_tangent"),
            row_time_s=moved.get("row_time_s"),
        )
        return self._at(log_rate).optical_depth(bare, self._noise(bare, seeds)).half()

    def _noise(self, state: CameraState, seeds: list[int]) -> dict[str, Tensor]:
        """Random numbers of some seeds; those of the last ones are kept, as a few rates follow one another."""
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
        >>> [(number, round(share, 3)) for number, share in _between(-0.05, 0.1)]
        [(-1, 0.512), (0, 0.488)]
    """
    place = value / step
    nearest = round(place)
    if abs(place - nearest) < ALIKE:
        return [(nearest, 1.0)]
    below = math.floor(place)
    share = math.expm1(value - below * step) / math.expm1(step)
    return [(below, 1.0 - share), (below + 1, share)]
