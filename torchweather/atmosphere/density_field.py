"""PatchyAir: weather that comes in banks and gusts, one field of density over the ground for all sensors of a vehicle.

The number of particles at a place is that of the weather times

    rho(x, y) = exp(s g(x, y) - s^2 / 2),    <rho> = 1,

with g a normal field of variance 1 and the correlation ``exp(-d^2 / (2 l^2))``: a sum of K plane waves,
``sqrt(2 / K) sum cos(k p + phi)``, of wave vectors k normal with a standard deviation of 1 / l and phases phi uniform.
s is a weather's ``patch_log_std``, l its ``patch_length_m``. Extinction, backscatter and counts all follow the number,
so that a way of length R weakens by the mean density along it, ``exp(-alpha int_0^R rho dr)``.

The field is laid out once a sample, on azimuths and ranges about the vehicle, and read between them.

References:
    The logarithm of rain over the ground as a normal field: Bell 1987, J. Geophys. Res. 92, 9631 (primary text not
    seen). The form of the correlation is a choice; spread and length are parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import PATCH_LENGTH_LOW_M, Weather, check_drawn
from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputValueError, check_at_least, check_between
from torchweather.core.random import Variate
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage

__all__ = [
    "Banks",
    "BanksAlongBeams",
    "PatchField",
    "PatchyAir",
    "mean_density",
    "mean_extra_m",
    "of_beams",
    "patchy_air",
    "sector_of",
]

WAVES = 64
_MOST_BEAMS = 1 << 40
AZIMUTHS = 192  # of the layout, and so 1.9 degrees apart
STEPS_PER_LENGTH, LENGTHS = 8, 16  # ranges are an eighth of a patch apart, up to 16 patches; beyond, the density is 1
NODES = STEPS_PER_LENGTH * LENGTHS + 1
SECTORS = 32  # of beams that see one air in front of them
NOTHING = 1e-30  # per metre, that stands for no loss at all
SHORTEST_M = 1e-3  # a way of 0 m has the density where it begins


@dataclass(frozen=True)
class Banks:
    """Density of one weather about the vehicle, over its mean.

    Args:
        density: ``(B, AZIMUTHS + 1, NODES)``.
        extra_m: ``(B, AZIMUTHS + 1, NODES)`` extra length of a way of equal optical depth in air of density 1.
        step_m: between ranges.
    """

    density: Tensor
    extra_m: Tensor
    step_m: float

    def at(self, azimuth_rad: Tensor, range_m: Tensor) -> Tensor:
        """Density at places ``(B or 1, ...)``; 1 beyond the layout."""
        found = _read(self.density, azimuth_rad, range_m, self.step_m)
        return torch.where(range_m > self.step_m * (NODES - 1), 1.0, found)

    def at_points(self, azimuth_rad: Tensor, range_m: Tensor, sample: Tensor | int | None) -> Tensor:
        """Density at points ``(P,)``, each in the air of its sample or all in that of one (``None``: there is one)."""
        first = 0 if sample is None else sample * ((AZIMUTHS + 1) * NODES)
        found = _interpolated(self.density.flatten(), azimuth_rad, range_m, self.step_m, first)
        return torch.where(range_m > self.step_m * (NODES - 1), 1.0, found)

    def mean_to(self, azimuth_rad: Tensor, range_m: Tensor) -> Tensor:
        """Mean density on the way to places ``(B or 1, ...)``."""
        return mean_density(self.extra_m, azimuth_rad, range_m, self.step_m)

    def of_sectors(self) -> BanksAlongBeams:
        """The air along the middle of each of ``SECTORS`` sectors."""
        every = AZIMUTHS // SECTORS
        density, extra_m = (table[:, :AZIMUTHS:every].flatten(0, 1) for table in (self.density, self.extra_m))
        return BanksAlongBeams(density, extra_m, self.step_m)


@dataclass(frozen=True)
class BanksAlongBeams:
    """Density along beams and the extra length of their ways in air of density 1, ``(beams, NODES)`` each."""

    density: Tensor
    extra_m: Tensor
    step_m: float

    def density_at(self, range_m: Tensor) -> Tensor:
        """``(beams, ...)`` at ranges ``(...)``."""
        found = self._between(self.density, range_m)
        return torch.where(range_m > self.step_m * (NODES - 1), 1.0, found)

    def way_m(self, range_m: Tensor) -> Tensor:
        """``(beams, ...)`` length of air of density 1 that takes as much as the way to ranges ``(...)``."""
        return range_m + self._between(self.extra_m, range_m)

    def _between(self, table: Tensor, range_m: Tensor) -> Tensor:
        place = (range_m / self.step_m).clamp(0.0, NODES - 1.0)
        node = place.floor().clamp_max(NODES - 2)
        low = node.to(torch.int64).flatten()
        found = torch.lerp(table[:, low], table[:, low + 1], (place - node).flatten())
        return found.reshape(-1, *range_m.shape)


@dataclass(frozen=True)
class PatchField:
    """g about the vehicle, ``(B, AZIMUTHS + 1, NODES)``, the last azimuth being the first; ranges ``step_m`` apart."""

    normal: Tensor
    step_m: float

    def banks(self, weather: Weather) -> Banks:
        """Density of a weather; 1 everywhere where it has no patches."""
        check_drawn(weather, owner=self)
        log_std = float(weather.patch_log_std)  # type: ignore[arg-type]
        excess = torch.expm1(log_std * self.normal - 0.5 * log_std**2)
        cells_m = (0.5 * self.step_m) * (excess[..., 1:] + excess[..., :-1])
        extra_m = torch.nn.functional.pad(cells_m.cumsum(-1), (1, 0))
        return Banks(1.0 + excess, extra_m, self.step_m)


def mean_extra_m(patches: PatchField, weathers: Sequence[Weather], takes: Sequence[Tensor]) -> Tensor:
    """``Banks.extra_m`` of several weathers together, each weighted by what it takes per metre, ``(B,)`` each."""
    check_arguments(
        "mean_extra_m(patches: PatchField, weathers: Sequence[Weather], takes: Sequence[Tensor])",
        patches,
        weathers,
        takes,
    )
    compiling = torch.compiler.is_compiling()  # a comparison of sizes would fix them in a graph
    if (
        len(takes) != len(weathers)
        or not takes
        or (
            not compiling
            and any(take.ndim != 1 or not take.is_floating_point() or take.shape != takes[0].shape for take in takes)
        )
        or (not compiling and len(takes[0]) not in (1, len(patches.normal)))
    ):
        raise InputValueError(
            f"mean_extra_m: takes must be a tensor (B,) for each of {len(weathers)} weathers; got {len(takes)}."
        )
    for take in takes:
        check_between("takes", take, 0.0, 1e9, unit="1/m", owner="mean_extra_m")
    total = torch.stack(list(takes)).sum(0).clamp_min(NOTHING)
    shares = [(take / total)[:, None, None] for take in takes]
    return sum(
        (share * patches.banks(weather).extra_m for share, weather in zip(shares, weathers, strict=True)),
        torch.zeros_like(patches.normal),
    )


def mean_density(extra_m: Tensor, azimuth_rad: Tensor, range_m: Tensor, step_m: float) -> Tensor:
    """Mean density on the way to places ``(B or 1, ...)``, from ``Banks.extra_m`` or a mean of several."""
    check_arguments(
        f"mean_density(extra_m: floating(S, {AZIMUTHS + 1}, {NODES}), azimuth_rad: floating, "
        "range_m: floating, step_m: float)",
        extra_m,
        azimuth_rad,
        range_m,
        step_m,
    )
    check_broadcast("mean_density", azimuth_rad=azimuth_rad, range_m=range_m)
    check_between("step_m", step_m, 1e-6, 1e9, unit="m", owner="mean_density")
    check_between("azimuth_rad", azimuth_rad, -1e3, 1e3, unit="radians", owner="mean_density")
    check_at_least("range_m", range_m, 0.0, unit="m", owner="mean_density")
    if max(azimuth_rad.ndim, range_m.ndim) < 2:
        raise InputValueError(
            f"mean_density: places must be (B or 1, ...); got {tuple(azimuth_rad.shape)} and {tuple(range_m.shape)}."
        )
    compiling = torch.compiler.is_compiling()  # a comparison of sizes would fix them in a graph
    both = torch.broadcast_shapes(azimuth_rad.shape, range_m.shape)  # type: ignore[no-untyped-call]
    batch = 1 if compiling else both[0]
    if batch != 1 and batch != len(extra_m):
        raise InputValueError(f"mean_density: places must be of {len(extra_m)} samples or of one; got {batch}.")
    kind = torch.promote_types(azimuth_rad.dtype, range_m.dtype)
    exact = torch.promote_types(kind, torch.float32)  # float16 does not count the places of the table
    way_m = range_m.to(exact).clamp_min(SHORTEST_M)
    return (1.0 + _read(extra_m, azimuth_rad.to(exact), way_m, step_m) / way_m).to(kind)


def _read(table: Tensor, azimuth_rad: Tensor, range_m: Tensor, step_m: float) -> Tensor:
    """A table ``(B, AZIMUTHS + 1, NODES)`` between its nodes, at places ``(B or 1, ...)``."""
    azimuth_rad, range_m = torch.broadcast_tensors(azimuth_rad, range_m)  # type: ignore[no-untyped-call]
    shape = (table.shape[0], *range_m.shape[1:])
    places = [value.expand(shape).flatten(1) for value in (azimuth_rad, range_m)]
    return _interpolated(table.flatten(1), places[0], places[1], step_m).reshape(shape)


def _interpolated(flat: Tensor, azimuth_rad: Tensor, range_m: Tensor, step_m: float, first: Tensor | int = 0) -> Tensor:
    """A table laid flat in its last dimension, from ``first`` on, at places of the same dimensions."""
    turn = ((azimuth_rad + math.pi) * (AZIMUTHS / (2.0 * math.pi))).clamp(0.0, float(AZIMUTHS))
    out = (range_m / step_m).clamp(0.0, NODES - 1.0)
    column, row = turn.detach().floor().clamp_max(AZIMUTHS - 1), out.detach().floor().clamp_max(NODES - 2)
    at, flat = (column * NODES + row).to(torch.int64) + first, flat.to(out)
    near = torch.lerp(flat.gather(-1, at), flat.gather(-1, at + NODES), turn - column)
    far = torch.lerp(flat.gather(-1, at + 1), flat.gather(-1, at + NODES + 1), turn - column)
    return torch.lerp(near, far, out - row)


def of_beams(values: Tensor, beams: int) -> Tensor:
    """Values of each sample, or of one, ``(B or 1, ...)``, for several beams of each, one sample after the other."""
    check_arguments("of_beams(values: Tensor, beams: int)", values, beams)
    beams = beams if torch.compiler.is_compiling() else int(beams)
    own = values.shape[0] if values.ndim else 0
    if not torch.compiler.is_compiling() and (not 0 <= beams < _MOST_BEAMS or not own or beams % own):
        raise InputValueError(f"of_beams: beams must be a multiple of the {own} samples; got {beams}.")
    return values.expand(beams, *values.shape[1:]) if own in (1, beams) else values.repeat_interleave(beams // own, 0)


def sector_of(azimuth_rad: Tensor) -> Tensor:
    """Number of the sector that an azimuth lies in, the one of ``-pi`` being the first; int64."""
    check_arguments("sector_of(azimuth_rad: real)", azimuth_rad)
    nearest = torch.round((azimuth_rad + math.pi) * (SECTORS / (2.0 * math.pi))).to(torch.int64)
    return torch.where(nearest >= SECTORS, nearest - SECTORS, nearest)


@register
class PatchyAir(Stage):
    """The field of density about the vehicle, for the stages behind it; the same noise gives every sensor the same one.

    ``Compose`` hands all sensors of a sample the noise of one draw.

    Args:
        length_m: l above, 5 m or more.
        drift_m_per_s: (forward, left) velocity of the air relative to the vehicle; moves the patches from frame to
            frame of a sequence.

    Note:
        Patches are columns: they do not depend on height. Sensors are taken to stand at one place, x forward.
    """

    default_name: ClassVar[str] = "air"
    of_the_air: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ()
    writes: ClassVar[tuple[str, ...]] = ("air.patches",)

    def __init__(self, length_m: float, drift_m_per_s: Sequence[float] = (0.0, 0.0)) -> None:
        check_arguments("PatchyAir(length_m: float, drift_m_per_s: Sequence[float])", length_m, drift_m_per_s)
        super().__init__()
        check_at_least("length_m", length_m, PATCH_LENGTH_LOW_M, unit="m", owner=self)
        self.length_m = float(length_m)
        if len(drift_m_per_s) != 2:
            raise InputValueError(f"PatchyAir: drift_m_per_s must be (forward, left) in m/s; got {drift_m_per_s!r}.")
        for speed in drift_m_per_s:
            check_between("drift_m_per_s", speed, -200.0, 200.0, unit="m/s", owner=self)
        self.drift_m_per_s = tuple(float(speed) for speed in drift_m_per_s)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"length_m": self.length_m, "drift_m_per_s": list(self.drift_m_per_s)}

    def variates(self) -> tuple[Variate, ...]:
        """Wave vectors in units of 1 / l, and phases in turns."""
        return Variate("wave", "normal", (WAVES, 2)), Variate("phase", "uniform", (WAVES,))

    def next_frame(self, noise: Mapping[str, Tensor], interval_s: float) -> dict[str, Tensor]:
        """The noise of the field after it has drifted on for a while."""
        moved = noise["wave"].new_tensor(self.drift_m_per_s) * (interval_s / self.length_m)
        turns = noise["phase"] - (noise["wave"] * moved).sum(-1) / (2.0 * math.pi)
        return {"wave": noise["wave"], "phase": turns - turns.floor()}

    def field(self, noise: Mapping[str, Tensor]) -> PatchField:
        """g, laid out about the vehicle."""
        wave, phase = noise["wave"], noise["phase"]
        azimuth = (torch.arange(AZIMUTHS + 1, device=wave.device) * (2.0 * math.pi / AZIMUTHS) - math.pi).to(wave)
        along = torch.stack([azimuth.cos(), azimuth.sin()])  # (2, A + 1)
        lengths = torch.arange(NODES, device=wave.device).to(wave) / STEPS_PER_LENGTH
        turn = (wave @ along)[..., None] * lengths  # (B, K, A + 1, NODES) radians
        waves = torch.cos(turn + 2.0 * math.pi * phase[..., None, None])
        return PatchField(math.sqrt(2.0 / WAVES) * waves.sum(1), self.length_m / STEPS_PER_LENGTH)

    def forward(self, state: Any, noise: Mapping[str, Tensor]) -> Any:
        """The state with the field."""
        device = _device_of(state)
        return state.changed(patches=self.field({key: value.to(device) for key, value in noise.items()}))


def _device_of(state: Any) -> torch.device | None:
    """Where the tensors of a state are; ``None`` of one without tensors."""
    parts = [part for part in vars(state).values() if hasattr(part, "__dict__")]
    values = (value for part in parts for value in vars(part).values())
    return next((value.device for value in values if isinstance(value, Tensor)), None)


def patchy_air(weather: Weather, ego_speed_m_per_s: float = 0.0) -> dict[str, Stage]:
    """The stage of a weather's patches by its name, nothing where it has none."""
    check_arguments("patchy_air(weather: Weather, ego_speed_m_per_s: float)", weather, ego_speed_m_per_s)
    patchy = [part for part in weather.parts if part.patch_log_std != 0.0]
    if not patchy:
        return {}
    winds = [getattr(part, "wind_m_per_s", (0.0, 0.0, 0.0)) for part in weather.parts]
    wind = next((one for one in winds if any(one)), (0.0, 0.0, 0.0))
    length_m = float(patchy[0].patch_length_m)  # type: ignore[arg-type]
    stage = PatchyAir(length_m, (wind[0] - ego_speed_m_per_s, wind[1]))
    return {stage.default_name: stage}


torch.export.register_dataclass(PatchField, serialized_type_name="torchweather.PatchField")
