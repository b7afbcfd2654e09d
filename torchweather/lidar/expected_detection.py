"""Mean report of a LiDAR: expected signal of each object and its probability of detection; nothing is drawn.

Smooth in rates, visibility and sensor parameters, so that they can be fitted. The mean over draws of the chain
``to_energy``, ``extinction``, ``particle_returns``, ``detection``, except that the step at the threshold is rounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.lidar.returns.soft_return import SoftReturn
from torchweather.lidar.stages import Detection, Extinction, ParticleReturns, ToEnergy
from torchweather.lidar.state import LidarState

__all__ = ["expected_detection"]

# Nodes over the margin of points that stand on it: Gauss-Laguerre, or Gauss-Legendre where the margin has an end, of
# which so many means are looked at.
MARGIN_NODES = 8
LONGEST_MARGIN = 8.0
TINY = 1e-12


def expected_detection(
    state: LidarState, to_energy: ToEnergy, extinction: Extinction, returns: ParticleReturns, detection: Detection
) -> tuple[Tensor, Tensor]:
    """Signal of each object in the weather, 1/(m^2 sr), and the probability that it is reported, ``(B, N)`` each.

    With X the signal in clear air and T the two-way transmission, ``max(X, X_thr) T`` is expected. The object is seen
    if X T exceeds the threshold, or else if its margin m does: ``10^(m/10) T >= 1``. Seen, it is reported unless a
    particle keeps it from being (``_unbeaten``).

    The step at the threshold is rounded by the photon noise of the light that the weather takes away: of N photons,
    N T arrive, +- sqrt(N T (1 - T)).

    Args:
        state: before the first stage.
        to_energy, extinction, returns, detection: the stages.

    References:
        PHYSICS.md 5.3-5.5.
    """
    range_m, seen = state.scene.clear_range_m, state.scene.clear_range_m > 0
    threshold = to_energy.beam.threshold
    law = _Margin.of(to_energy, range_m)
    alpha = extinction.extinction_per_m(state.batch).to(range_m)
    transmission = torch.exp(-2.0 * alpha[:, None] * range_m)
    clear = to_energy.signal_of_intensity(state.scene.points_in[..., 3], range_m, state.scene.zero_intensity)
    floored, dimmed = torch.maximum(clear, threshold * torch.ones_like(clear)), clear * transmission
    rivals = _Rivals(range_m, alpha, returns, detection)

    photons = to_energy.photons_at_threshold / threshold
    spread = torch.sqrt((floored * photons * transmission * (1.0 - transmission)).clamp_min(TINY))
    above = torch.special.ndtr((dimmed - threshold) * photons / spread)
    surplus, loss = (floored / threshold).log(), 2.0 * alpha[:, None] * range_m
    strong = torch.lerp(
        rivals.unbeaten(dimmed), law.mean_above(rivals.unbeaten, dimmed, surplus), law.chance_above(surplus)
    )
    weak = law.chance_above(loss) * law.mean_above(rivals.unbeaten, threshold * torch.ones_like(clear), loss)
    reported = torch.lerp(weak, strong, above)
    near = range_m < detection.sensor.near_start_m  # nothing lies in front of these
    reported = torch.where(near, 1.0, reported)
    return torch.where(seen, floored * transmission, 0.0), torch.where(seen, reported, 0.0)


@dataclass(frozen=True)
class _Margin:
    """The law of ln(signal / threshold) of returns that stand on the margin: exponential, up to an end where near.

    Args:
        mean, end: ``(B, N)``.
        near: ``(B, N)`` bool, whether there is an end.
    """

    mean: Tensor
    end: Tensor
    near: Tensor

    @classmethod
    def of(cls, to_energy: ToEnergy, range_m: Tensor) -> _Margin:
        """The law of `ToEnergy.log_margin`."""
        mean, end = to_energy.margin_law(range_m)
        return cls(mean, end, end.isfinite())

    def chance_above(self, level: Tensor) -> Tensor:
        """Probability that the logarithm exceeds a level, ``(B, N)``."""
        return torch.exp(-level / self.mean) * ~(self.near & (level >= self.end))

    def mean_above(self, function: Callable[[Tensor], Tensor], signal: Tensor, level: Tensor) -> Tensor:
        """Mean of a function of the signal over returns whose logarithm exceeds a level.

        Args:
            function: of a signal ``(B, N)``.
            signal: of a return that stands just on the level.
            level: ln of the level over the threshold.
        """
        # The exponential law has no memory: what is left above a level is exponential again, as far as the end is.
        left = torch.minimum((self.end - level).clamp_min(0.0), LONGEST_MARGIN * self.mean)
        laguerre = np.polynomial.laguerre.laggauss(MARGIN_NODES)
        legendre = np.polynomial.legendre.leggauss(MARGIN_NODES)
        found = torch.zeros_like(signal)
        for far_place, far_weight, place, weight in zip(*laguerre, *legendre, strict=True):
            inside = 0.5 * (1.0 + float(place)) * left
            share = 0.5 * float(weight) * left / self.mean * torch.exp(-inside / self.mean)
            part = torch.where(self.near, inside, self.mean * float(far_place))
            found = found + torch.where(self.near, share, float(far_weight)) * function(signal * torch.exp(part))
        at_end = torch.where(self.near, torch.exp(-left / self.mean), 0.0)
        return found + at_end * function(signal * torch.exp(torch.where(self.near, left, 0.0)))


@dataclass(frozen=True)
class _Rivals:
    """The particles and the fog in front of each object."""

    range_m: Tensor
    alpha: Tensor
    returns: ParticleReturns
    detection: Detection

    def unbeaten(self, signal: Tensor) -> Tensor:
        """Probability that nothing keeps an object of this signal from being reported, ``(B, N)``.

        In the mode ``strongest`` that is a stronger return anywhere in front. In the others it is a stronger one so
        close that the object is part of it, and in ``first`` also any return that is farther in front.
        """
        kept = torch.ones_like(signal)
        for part in self.returns.kinds.values():
            kept = kept * self._unbeaten_by(part, signal)
        return kept.clamp(0.0, 1.0)

    def _number(self, part: BeamParticles | SoftReturn, signal: Tensor, reach_m: Tensor) -> Tensor:
        own = self.returns.beam.threshold.dtype
        number = part.expected_above(self.returns.beam, signal.to(own), self.alpha.to(own), reach_m.to(own))
        return number.clamp_min(0.0).to(signal)

    def _unbeaten_by(self, part: BeamParticles | SoftReturn, signal: Tensor) -> Tensor:
        stronger = self._number(part, signal, self.range_m)
        if self.detection.return_mode == "strongest":
            return torch.exp(-stronger)
        first, apart_m = self.detection.return_mode == "first", self.detection.sensor.echo_separation
        faint = self.returns.beam.threshold.expand_as(signal).to(signal)
        if isinstance(part, SoftReturn):
            # Fog returns once: swallowed by one that is stronger and near, or behind one that is seen farther in front.
            swallowed = -torch.expm1(-stronger) - self._in_front(part, signal, apart_m)
            return 1.0 - swallowed - (self._in_front(part, faint, apart_m) if first else 0.0)
        farther_m = (self.range_m - apart_m).clamp_min(0.0)
        swallowed = stronger - self._number(part, signal, farther_m)
        return torch.exp(-swallowed - (self._number(part, faint, farther_m) if first else 0.0))

    def _in_front(self, part: SoftReturn, signal: Tensor, apart_m: float) -> Tensor:
        own = self.returns.beam.threshold.dtype
        signal_at, alpha, range_m = (value.to(own) for value in (signal, self.alpha, self.range_m))
        return part.chance_before(self.returns.beam, signal_at, alpha, apart_m, range_m).to(signal)
