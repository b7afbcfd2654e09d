r"""Radar stage map_receiver: what the receiver shows of weakened echoes, its own noise, and the weather's echo.

A cell of a recording holds ``|s + n|^2``: an echo s and noise n of mean power N, which cannot be told apart. Weakened
by the weather to ``s sqrt(L)``, with the noise as strong as before, it is

    z' = sqrt(L) z + sqrt(F - L + C / N) sqrt(N) w,    z = s + n,  |z|^2 = P

with w complex Gaussian of mean power 1, F the noise over that of clear air (1), C the mean echo of rain or snow:
``sqrt(L) n`` and fresh noise of the power (F - L) N together are noise of the power F N again. So the floor keeps its
mean and its exponential law, a target loses L, and rain adds speckle of the exponential law with the mean C. The phase
of z is not known and not needed, as that of w is uniform. A cell that is the mean of several looks takes one such step
with all of z and further looks of w alone, which is the same law.

References:
    PHYSICS.md 6.2, 6.5, 6.8.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, nested_shape
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.core.random import Variate
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.radar.clutter import DB
from torchweather.radar.power_map.cells import PowerMapState
from torchweather.radar.power_map.noise_floor import noise_floor_db
from torchweather.radar.power_map.power_map import MapAxes, RadarPowerMap
from torchweather.radar.power_map.scale import PowerScale

__all__ = ["MapReceiver", "oversampled_taps"]

MOST_LOOKS = 64
LEAST = 1e-12  # of a power over the noise: 120 dB below it


def oversampled_taps(oversampling: float) -> Tensor:
    """Weights of a running sum along the range that correlate white noise as a Hann window does, ``(2 h + 1,)``.

    The response of the window in bins of the map, of power 1.

    Args:
        oversampling: range resolution c / 2B over the width of a bin, 1 or more; 0 is white noise.

    Example:
        >>> taps = oversampled_taps(1.0)
        >>> round(float((taps[1:] * taps[:-1]).sum().abs()), 4), round(float((taps[2:] * taps[:-2]).sum().abs()), 4)
        (0.6667, 0.1667)
    """
    check_arguments("oversampled_taps(oversampling: float)", oversampling)
    check_between("oversampling", oversampling, 0.0, 1e4, owner="oversampled_taps")
    if oversampling == 0:
        return torch.ones(1)
    check_at_least("oversampling", oversampling, 0.5, owner="oversampled_taps", advice="0 is white noise.")
    half = math.ceil(2.0 * oversampling - 1e-9) - 1
    lag = torch.arange(-half, half + 1, dtype=torch.float64) / oversampling
    taps = torch.sinc(lag) + 0.5 * (torch.sinc(lag - 1.0) + torch.sinc(lag + 1.0))
    return (taps / taps.square().sum().sqrt()).float()


@register
class MapReceiver(Stage):
    """The map as the receiver shows it in the weather.

    Identity: where the weather takes nothing, adds nothing and the noise is as before, the input's own bits come out.

    Args:
        axes: of the maps, or their dictionary.
        scale: of their numbers, or its dictionary.
        noise_floor_db: mean power of the noise in the map's unit, one number or one for each range bin; ``None``: found
            in each map by ``noise_floor_db``.
        looks: independent looks whose mean power a cell holds.
        oversampling: range resolution over the width of a range bin: neighbouring bins share their noise; 0: they do
            not.

    Note:
        A byte stands for all powers between its edges, and one of them is drawn, so that a loss below one step shows in
        the mean. Byte 0 holds all below the scale: a power of the noise's law is drawn there. Byte 255 counts as its
        level. Echoes and noise of neighbouring bins are taken to be in phase.
    """

    default_name: ClassVar[str] = "map_receiver"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        "returns.gain_db",
        *("maps.map_clutter", "maps.map_in"),
        *("receiver.noise_floor_db", "receiver.noise_shift_db"),
    )
    writes: ClassVar[tuple[str, ...]] = ("maps.map_out",)

    def __init__(
        self,
        axes: MapAxes | Mapping[str, Any],
        scale: PowerScale | Mapping[str, Any],
        noise_floor_db: float | list[float] | tuple[float, ...] | None = None,
        looks: int = 1,
        oversampling: float = 1.0,
    ) -> None:
        check_arguments(
            "MapReceiver(axes: MapAxes | Mapping, scale: PowerScale | Mapping, "
            "noise_floor_db: float | Sequence[float] | None, looks: int, oversampling: float)",
            axes,
            scale,
            noise_floor_db,
            looks,
            oversampling,
        )
        super().__init__()
        self.axes = axes if isinstance(axes, MapAxes) else MapAxes.from_dict(axes)
        self.scale = scale if isinstance(scale, PowerScale) else PowerScale.from_dict(scale)
        check_between("looks", looks, 1, MOST_LOOKS, owner=self)
        if looks != int(looks) or (self.scale.kind == "complex" and looks != 1):
            raise InputValueError(f"MapReceiver: looks must be a whole number, 1 of complex maps; got {looks!r}.")
        if oversampling != 0:
            check_between("oversampling", oversampling, 1.0, 64.0, owner=self)
        self.looks, self.oversampling = int(looks), float(oversampling)
        self.noise_floor = _floor(noise_floor_db, self.axes)
        self.register_buffer("taps", oversampled_taps(self.oversampling), persistent=False)

    taps: Tensor

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "axes": self.axes.to_dict(),
            "scale": self.scale.to_dict(),
            "noise_floor_db": self.noise_floor,
            "looks": self.looks,
            "oversampling": self.oversampling,
        }

    def variates(self) -> tuple[Variate, ...]:
        """White noise of each look of each cell, and the place of each byte within its level."""
        shape = self.axes.shape
        normal = [Variate(name, "normal", (self.looks, *shape)) for name in ("real", "imaginary")]
        if self.scale.kind == "db_steps":
            normal.append(Variate("level", "uniform", shape))
        return tuple(normal)

    def floor_db(self, values: Tensor) -> Tensor:
        """Noise floor of maps ``(B, *S)``, shaped to broadcast over them, dB in their unit."""
        if isinstance(self.noise_floor, tuple):
            profile = torch.tensor(self.noise_floor, device=values.device)
            return self.axes.laid_out(profile[None], ("range",))
        if self.noise_floor is not None:
            each = [self.noise_floor] * values.shape[0]
        else:
            each = [noise_floor_db(RadarPowerMap(one, self.axes, self.scale), self.looks) for one in values.detach()]
        return torch.tensor(each, device=values.device).reshape(-1, *(1,) * (values.ndim - 1))

    def forward(self, state: PowerMapState, noise: Mapping[str, Tensor]) -> PowerMapState:
        """The state with the maps that go out."""
        values = state.maps.map_in
        assert values is not None
        batch = state.batch
        gain_db = self.axes.laid_out(
            state.returns.gain_db.reshape(batch, len(self.axes.range_m), -1), ("range", "azimuth")
        )
        kept = torch.exp(DB * gain_db)
        shift = (
            torch.zeros_like(state.floor_db) if state.receiver.noise_shift_db is None else state.receiver.noise_shift_db
        )
        level = torch.exp(DB * shift).reshape(-1, *(1,) * (values.ndim - 1))
        added = (level - kept).clamp_min(0.0)
        if state.maps.map_clutter is not None:
            added = added + state.maps.map_clutter
        changed = ((gain_db != 0) | (added != 0)).expand(values.shape)
        floor_db = self.floor_db(values)
        if self.scale.kind == "complex":
            scaled = (values * torch.exp(0.5 * DB * -floor_db)).to(torch.complex64)
            echo = scaled * _root(kept) + torch.complex(*self._white(noise, 0)) * _root(added)
            out = (echo * torch.exp(0.5 * DB * floor_db)).to(values.dtype)
        else:
            power = self._power(values, floor_db, noise)
            shown = self._mixed(power * kept, added, noise)
            out = self.scale.stored(shown.clamp_min(LEAST).log() / DB + floor_db, values)
        return state.changed(map_out=torch.where(changed, out, values))

    def _power(self, values: Tensor, floor_db: Tensor, noise: Mapping[str, Tensor]) -> Tensor:
        """``(B, *S)`` power over the noise."""
        if self.scale.kind != "db_steps":
            return torch.exp(DB * (self.scale.decibels(values) - floor_db)).float()
        low_db, high_db = self.scale.bounds_db(values)
        place = noise["level"].to(high_db)
        high = torch.exp(DB * (high_db - floor_db))
        inside = torch.exp(
            DB * (torch.lerp(torch.where(low_db.isfinite(), low_db, high_db), high_db, place) - floor_db)
        )
        below = -torch.log1p(place * torch.expm1(-high))  # of the exponential law, cut off at the first edge
        return torch.where(low_db.isfinite(), inside, below)

    def _mixed(self, echo: Tensor, added: Tensor, noise: Mapping[str, Tensor]) -> Tensor:
        """Power of an echo and Gaussian noise of mean power ``added``, over all looks."""
        real, imaginary = self._white(noise, 0)
        total = (_root(self.looks * echo) + _root(added) * real).square() + added * imaginary.square()
        for look in range(1, self.looks):
            real, imaginary = self._white(noise, look)
            total = total + added * (real.square() + imaginary.square())
        return total / self.looks

    def _white(self, noise: Mapping[str, Tensor], look: int) -> tuple[Tensor, Tensor]:
        """Real and imaginary part of complex noise of power 1, correlated along the range."""
        dim = 1 + self.axes.dims.index("range")
        half = (len(self.taps) - 1) // 2
        parts = []
        for name in ("real", "imaginary"):
            white = noise[name][:, look].float() * math.sqrt(0.5)
            if half:
                taps = self.taps.to(white).tolist()
                white = sum(
                    (tap * white.roll(place - half, dim) for place, tap in enumerate(taps)), torch.zeros_like(white)
                )
            parts.append(white)
        return parts[0], parts[1]


def _root(power: Tensor) -> Tensor:
    """Square root whose gradient at 0 is 0."""
    there = power > 0
    return torch.where(there, torch.where(there, power, 1.0).sqrt(), 0.0)


def _floor(value: Any, axes: MapAxes) -> float | tuple[float, ...] | None:
    if value is None:
        return None
    if nested_shape(value) == ():
        check_between("noise_floor_db", float(value), -400.0, 400.0, unit="dB", owner="MapReceiver")
        return float(value)
    profile = tuple(float(one) for one in value)
    if len(profile) != len(axes.range_m):
        raise InputValueError(
            f"MapReceiver: noise_floor_db must be one number of dB or one for each of {len(axes.range_m)} range bins; "
            f"got {len(profile)}."
        )
    check_between("noise_floor_db", torch.tensor(profile), -400.0, 400.0, unit="dB", owner="MapReceiver")
    return profile
