"""Systematic uncertainties of a radar study, which must not be taken for a missing effect.

Each stage here has the strength of one standard deviation of what nobody knows; the search forgets departures along its
response (``search.Systematics``). They are not effects of the catalogue and never an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.radar.clutter import DB
from torchweather.radar.effects.path import of_state
from torchweather.radar.state import RadarState

__all__ = ["ReceiverNoise"]

SPEED, POWER = 3, 4  # columns of a list
FAINTEST, WIDEST = 1e-12, 1e3


class ReceiverNoise(Effect):
    """Noise of the receiver that a target's power lacks as weather weakens it.

    A clear frame holds ``|A + n|^2``, with n of the power of the noise floor. Weather takes A down to ``sqrt(g) A`` and
    leaves n as it is; a simulated frame has ``g |A + n|^2``. Added is ``(1 - g)`` of the floor:

        |sqrt(g P) + sqrt((1 - g) share N) z|^2,  z complex normal of unit power;

    where the floor is f times the clear one, ``(f - g)`` instead of ``(1 - g)``.

    Errors of range and speed go as one over the root of the SNR: of their variance in clear air ``share (1 / g - 1)``
    times as much is added.

    Args:
        share: of the noise floor, 0 to 16; 1 is that of a receiver whose noise is all that is in its empty cells.

    References:
        Skolnik, Introduction to Radar Systems (errors as the root of the SNR); primary text not seen.
    """

    id: ClassVar[str] = "gap.receiver_noise"
    title: ClassVar[str] = "weaker targets are noisier"
    term: ClassVar[str] = "thermal noise"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 16.0, scale=1.0, identity=0.0),)
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("margin_db",)

    range_std_m: Tensor | None = None
    speed_std_m_per_s: Tensor | None = None

    def with_errors(self, range_std_m: Tensor, speed_std_m_per_s: Tensor) -> Self:
        """With the standard deviations ``(N,)`` that measured ranges and speeds of each target have in clear air."""
        self.range_std_m, self.speed_std_m_per_s = range_std_m, speed_std_m_per_s
        return self

    def variates(self) -> tuple[Variate, ...]:
        """A complex number a target, and the errors of its range and speed."""
        return tuple(Variate(name, "normal", ("N",)) for name in ("real", "imaginary", "range", "speed"))

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains of the targets."""
        gain = (state.returns.gain_db * DB).exp()
        snr = ((state.scene.points_in[..., POWER] - state.receiver.noise_floor_db[:, None]) * DB).exp()
        floor = 1.0 if state.receiver.noise_shift_db is None else (state.receiver.noise_shift_db * DB).exp()[:, None]
        lacking = (floor - gain).clamp_min(0.0) * of_state(self, "share", state)[:, None]
        one = (0.5 * lacking).sqrt()
        amplitude = (gain * snr).sqrt()
        real = amplitude + one * noise["real"].to(gain)
        imaginary = one * noise["imaginary"].to(gain)
        noisy = (real.square() + imaginary.square()) / snr
        there = state.scene.range_m > 0
        found = {"gain_db": torch.where(there, noisy.clamp_min(FAINTEST).log() / DB, state.returns.gain_db)}
        if self.range_std_m is not None and self.speed_std_m_per_s is not None:
            wider = (lacking / gain).clamp_max(WIDEST).sqrt()
            speed = state.scene.points_in[..., SPEED] + wider * self.speed_std_m_per_s * noise["speed"].to(gain)
            moved_m = wider * self.range_std_m * noise["range"].to(gain)
            longer = (1.0 + moved_m / torch.where(there, state.scene.range_m, 1.0)).clamp_min(0.0)
            place = state.scene.points_in[..., :3] * longer[..., None]
            points = torch.cat([place, speed[..., None], state.scene.points_in[..., POWER:]], -1)
            found["points_in"] = torch.where(there[..., None], points, state.scene.points_in)
        return found
