"""Rain, Fog, Snow and Mixture: one description of the weather that drives every sensor.

The intensity of a weather (``rate_mm_per_h``, ``mor_m``) is a number or a tensor of the batch shape and may require
grad; everything else is a plain number or a name. Every number may also be a distribution (``distributions``), and the
intensity a pair (low, high): then ``drawn`` gives one weather of it, and ``Compose`` draws one for each sample.
"""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torchweather.atmosphere.named_weather import ALIASES, NamedWeather
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import (
    Distribution,
    Uniform,
    distribution_from,
    distributions_in,
    with_distributions,
    with_drawn,
)
from torchweather.core.errors import (
    InputTypeError,
    InputValueError,
    TorchweatherWarning,
    check_between,
    check_one_of,
    check_positive,
    nearest_name,
    owner_name,
)
from torchweather.core.fields import between, check_fields
from torchweather.core.plugins import find_plugin, plugin_names
from torchweather.core.random import keyed_stream
from torchweather.core.schema import MAPPING, NUMBERS, ROWS, check_value
from torchweather.physics import (
    FOG,
    RAIN,
    SNOW,
    Binned,
    LogNormal,
    SizeDistribution,
    close_rate,
    physical_diameter_mm,
    precipitation_rate_mm_per_h,
    rehearse_fog,
)
from torchweather.physics.flake_reflectivity import flake_reflectivity
from torchweather.physics.precipitation_rate import fall_speed_law

__all__ = [
    "Fog",
    "Mixture",
    "Rain",
    "Snow",
    "Weather",
    "check_drawn",
    "check_intensities",
    "parse_weather",
    "weather_from_dict",
]

Intensity = float | Tensor
# What the constructors take: a distribution, and a pair for ``Uniform``, is drawn before anything is computed.
Given = Intensity | Distribution | tuple[float, float]

# Rates that the size distributions were fitted to, mm/h; outside them a weather warns once.
RAIN_RATE_RANGE_MM_PER_H = (0.1, 200.0)
SNOW_RATE_RANGE_MM_PER_H = (0.05, 10.0)
# A rate beyond this is no weather: the largest one-minute rain on record is 1870 mm/h (WMO: Unionville 1956, 31 mm
# in a minute).
ABSURD_RATE_MM_PER_H = 2000.0
# Contrast threshold to which the fog distributions of ``torchweather.physics.FOG`` are scaled (WMO's MOR).
MOR_CONTRAST = 0.05
# Name and visibilities, m, of the fogs that were measured in the REHEARSE fog chamber (D3.4 Table 5).
REHEARSE, REHEARSE_MOR_M = "rehearse", (10, 20, 30, 50)
# Patches are laid out on a grid that follows their length; below this the sectors of a LiDAR would be too coarse.
PATCH_LENGTH_LOW_M, PATCH_LENGTH_HIGH_M, PATCH_LOG_STD_HIGH = 5.0, 10_000.0, 2.0


RANGES = {
    "wind_m_per_s": between(-100.0, 100.0, "m/s (forward, left, up in the vehicle frame)"),
    "temperature_c": between(-60.0, 60.0, "degrees Celsius"),
    "albedo": between(0.0, 1.0),
    "flake_reflectivity": between(0.0, 1.0),
    "melt_fraction": between(0.0, 1.0, advice="It is the share of a flake's mass that is liquid; dry snow is 0."),
    "visibility_spread": between(0.3, 3.0, advice="It multiplies the extinction of the rate; typical snow is 1."),
    "contrast": between(1e-6, 1 - 1e-6),
}
"""Values that the fields of a weather take, beside its intensity and its patches."""


class Weather:
    """Base of every weather: a kind, an intensity, a plain dictionary."""

    kind: ClassVar[str] = ""
    intensity_name: ClassVar[str] = ""
    patch_log_std: Given = 0.0
    patch_length_m: Given = 100.0

    @property
    def intensity(self) -> Intensity:
        """The rate or the visibility.

        Raises:
            ValueError: it has yet to be drawn.
        """
        check_drawn(self, owner=self)
        value: Intensity = getattr(self, self.intensity_name)
        return value

    @property
    def knob(self) -> Intensity:
        """Old name of ``intensity``; it goes with the next release."""
        text = "Weather.knob is Weather.intensity now; the old name goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return self.intensity

    @property
    def parts(self) -> tuple[Weather, ...]:
        """The weathers this one is made of; itself unless it is a mixture."""
        return (self,)

    @property
    def conditions(self) -> tuple[Weather, ...]:
        """Water and snow on things (``atmosphere/conditions``); none unless it is a mixture that holds some."""
        return ()

    @property
    def random(self) -> dict[str, Distribution]:
        """Fields that are drawn for each sample, by name; of the wind by its place, ``wind_m_per_s.0`` forward."""
        return distributions_in({field.name: getattr(self, field.name) for field in fields(self)})  # type: ignore[arg-type]

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """The same with other values of fields that ``random`` names."""
        names = dict.fromkeys(name.partition(".")[0] for name in values)
        changed = {name: with_drawn(getattr(self, name), values, name) for name in names}
        return replace(self, **changed) if changed else self  # type: ignore[type-var]

    def drawn(self, seed: int) -> Weather:
        """One weather: a plain number for every field that is random, each from a stream of its own.

        Args:
            seed: the same one gives the same weather.

        Example:
            >>> Rain(rate_mm_per_h=(1, 50)).drawn(seed=7) == Rain(rate_mm_per_h=(1, 50)).drawn(seed=7)
            True
        """
        values = {
            name: one.at(float(keyed_stream(seed, f"weather.{self.kind}.{name}").random()))
            for name, one in self.random.items()
        }
        return self.with_values(values)

    def densest(self) -> Weather:
        """The one with most particles of those that can be drawn: highest rate, least visibility, the rest at will."""
        pick = {"rate_mm_per_h": max, "mor_m": min, "patch_log_std": max, "visibility_spread": max}
        return self.with_values(
            {name: pick.get(name, lambda ends: ends[0])(one.ends()) for name, one in self.random.items()}
        )

    def _ends_are_good(self) -> bool:
        """Check whether anything is random; all that can be drawn has then been checked."""
        intensity = getattr(self, self.intensity_name)
        if isinstance(intensity, (tuple, list)):
            if len(intensity) != 2 or isinstance(intensity, list):
                raise InputValueError(
                    f"{type(self).__name__}: {self.intensity_name} must be a number, a tensor, a pair (low, high) or a "
                    f"distribution such as LogUniform(1, 50); got {intensity!r}."
                )
            object.__setattr__(self, self.intensity_name, Uniform(*intensity))
        random = self.random
        first = {name: one.ends()[0] for name, one in random.items()}
        for name, one in random.items():
            for end in one.ends():
                self.with_values({**first, name: end})
        return bool(random)

    def _check_patches(self) -> None:
        check_between("patch_log_std", self.patch_log_std, 0.0, PATCH_LOG_STD_HIGH, owner=self)
        lengths_m = (PATCH_LENGTH_LOW_M, PATCH_LENGTH_HIGH_M)
        check_between("patch_length_m", self.patch_length_m, *lengths_m, unit="m", owner=self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``weather_from_dict`` takes and YAML can hold; a tensor intensity is detached."""
        values: dict[str, Any] = {"kind": self.kind}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                value = value.detach().tolist()
            elif isinstance(value, Binned):
                value = _bins_to_dict(value)
            elif isinstance(value, Distribution):
                value = value.to_dict()
            if isinstance(value, tuple):
                value = [one.to_dict() if isinstance(one, Distribution) else one for one in value]
            values[field.name] = value
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Build the weather from plain values; unknown keys are refused with the nearest name."""
        known = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        if "visibility_m" in values and "mor_m" in known:
            values = {"mor_m" if key == "visibility_m" else key: value for key, value in values.items()}
        taken = {}
        for key, value in values.items():
            if key == "kind":
                continue
            if key not in known:
                raise InputValueError(f"{cls.__name__}: unknown field {key!r}.{nearest_name(key, known)}")
            if key == cls.intensity_name and isinstance(value, list):
                check_value(value, NUMBERS, cls.__name__, key)
                check_arguments(f"{cls.__name__}({key}: Quantity)", value)  # lists as long as each other
                value = torch.tensor(value)
            if key == "size_distribution" and not isinstance(value, (str, Mapping, Binned)):
                raise InputTypeError(f"{cls.__name__}: {key} must be a name or its bins; got {value!r}.")
            if isinstance(value, Mapping):
                if key == "size_distribution":
                    bins = ("edges_mm", "density_per_m3_mm", "particle")
                    if set(value) != set(bins):
                        raise InputValueError(
                            f"{cls.__name__}: {key} must have {', '.join(bins)}; got {', '.join(map(str, value))}."
                        )
                    value = Binned(value["edges_mm"], value["density_per_m3_mm"], particle=value["particle"])
                else:
                    value = distribution_from(value, owner=f"{cls.__name__}: {key}")
            if isinstance(value, list):
                value = tuple(with_distributions(value, owner=f"{cls.__name__}: {key}"))
            taken[key] = value
        return cls(**taken)


@dataclass(frozen=True)
class _Precipitation(Weather):
    rate_mm_per_h: Given = 0.0
    size_distribution: str | Binned = ""
    close_rate: bool = False
    temperature_c: float = 10.0
    wind_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    patch_log_std: Given = 0.0
    patch_length_m: Given = 100.0

    intensity_name: ClassVar[str] = "rate_mm_per_h"
    rate_range_mm_per_h: ClassVar[tuple[float, float]] = (0.0, math.inf)
    families: ClassVar[Mapping[str, Any]] = {}
    not_beyond_fit: ClassVar[tuple[str, ...]] = ()
    """Families whose extinction falls with the rate beyond the range of their fit."""
    particles: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        rate = self.intensity
        check_between(
            "rate_mm_per_h",
            rate,
            0.0,
            ABSURD_RATE_MM_PER_H,
            unit="mm/h (liquid equivalent)",
            owner=self,
            advice="Heavy rain is 50 mm/h, heavy snow 5 mm/h.",
        )
        check_fields(self, RANGES)
        if not isinstance(self.size_distribution, Binned):
            check_one_of("size_distribution", self.size_distribution, self.families, owner=self)
        elif self.size_distribution.particle not in self.particles:
            raise InputValueError(
                f"{type(self).__name__}: size_distribution must count {' or '.join(self.particles)}; got bins of "
                f"{self.size_distribution.particle!r}. Set Binned(particle=...)."
            )
        object.__setattr__(self, "rate_mm_per_h", _plain_intensity(rate))
        self._check_patches()
        self._check_fit()

    def _check_fit(self) -> None:
        """Refuse rates at which the law of the sizes is wrong; warn of others outside the range of its fit."""
        low, high = self.rate_range_mm_per_h
        rates = torch.as_tensor(self.rate_mm_per_h).detach().reshape(-1)
        if torch.compiler.is_compiling():
            return
        above = rates[rates > high]
        if above.numel() and self.size_distribution in self.not_beyond_fit and not self.close_rate:
            raise InputValueError(
                f"{type(self).__name__}: rate_mm_per_h = {above[0].item():g} lies above {high:g} mm/h. The law "
                f"{self.size_distribution!r} was fitted to {low:g}..{high:g} mm/h (liquid equivalent) and makes less "
                f"{self.kind} of a higher rate. Lower the rate, or set close_rate=True: the sizes then follow the law, "
                "and their number is scaled to the rate."
            )
        outside = rates[(rates > 0) & ((rates < low) | (rates > high))]
        if outside.numel():
            warnings.warn(
                f"{type(self).__name__}: rate_mm_per_h = {outside[0].item():g} lies outside {low:g}..{high:g} mm/h, "
                f"the range the size distribution was fitted to.",
                TorchweatherWarning,
                stacklevel=5,
            )

    @property
    def particle(self) -> str:
        """Particle of the size distribution: ``drop``, ``melted-flake`` (melted diameter) or ``flake`` (outline)."""
        found = self.size_distribution
        return self.families[found](1.0).particle if isinstance(found, str) else found.particle

    def distribution(self, rate_mm_per_h: Intensity | None = None) -> SizeDistribution:
        """Size distribution at a rate (the weather's own by default), per diameter of ``particle``."""
        rate = self.intensity if rate_mm_per_h is None else rate_mm_per_h
        if isinstance(self.size_distribution, str):
            found: SizeDistribution = self.families[self.size_distribution](rate)
            return close_rate(found, rate) if self.close_rate else found
        measured = self.size_distribution
        return measured.scaled(torch.as_tensor(rate) / precipitation_rate_mm_per_h(measured))

    def physical_diameter_mm(self, diameter_mm: Tensor) -> Tensor:
        """Diameter of the particle's outline, mm, from the diameter that the distribution counts."""
        return physical_diameter_mm(diameter_mm) if self.particle == "melted-flake" else diameter_mm

    def fall_speed_m_per_s(self, diameter_mm: Tensor) -> Tensor:
        """Fall speed, m/s, from the diameter that the distribution counts, mm (``PHYSICS.md`` 2.5)."""
        return fall_speed_law(self.particle)(diameter_mm)


@dataclass(frozen=True)
class Rain(_Precipitation):
    """Rain of a rate.

    Args:
        rate_mm_per_h: rain rate, mm/h, a number or a tensor of the batch shape; 0 is no rain.
        size_distribution: a name from ``torchweather.physics.RAIN`` or measured bins (``Binned``), which are then
            scaled to the rate.
        close_rate: scale the distribution so that its flux is exactly the rate.
        temperature_c: water temperature, degrees Celsius.
        wind_m_per_s: air velocity (forward, left, up) in the vehicle frame, m/s; each of the three may be drawn.
        patch_log_std: spread of the logarithm of the drops' number over the ground, 0 (uniform) to 2; its mean stays.
        patch_length_m: over which the density of gusts changes, 5 to 10,000 m (``atmosphere/density_field.py``).

    Example:
        >>> Rain(rate_mm_per_h=25).distribution().total_per_m3 > 1000
        tensor(True)
    """

    kind: ClassVar[str] = "rain"
    rate_range_mm_per_h: ClassVar[tuple[float, float]] = RAIN_RATE_RANGE_MM_PER_H
    families: ClassVar[Mapping[str, Any]] = RAIN
    particles: ClassVar[tuple[str, ...]] = ("drop",)

    size_distribution: str | Binned = "marshall-palmer"


@dataclass(frozen=True)
class Snow(_Precipitation):
    """Snow of a liquid-equivalent rate, dry unless ``melt_fraction`` is set.

    Args:
        rate_mm_per_h: liquid-equivalent snowfall rate, mm/h, a number or a tensor of the batch shape; up to 10 mm/h
            for the laws of Sekhon & Srivastava and Gunn & Marshall, which were not fitted to more.
        size_distribution: a name from ``torchweather.physics.SNOW`` (per melted diameter) or measured bins.
        close_rate: scale the distribution so that its flux is exactly the rate.
        temperature_c: ice temperature, degrees Celsius.
        wind_m_per_s: air velocity (forward, left, up) in the vehicle frame, m/s.
        albedo: share of light that a flake scatters, for a camera: 0.85-0.98 in the visible (``PHYSICS.md`` 10.2).
        flake_reflectivity: of a flake, for a LiDAR, 0-1; ``None`` is that of a thin layer of ice grains at the laser's
            wavelength, known within a factor of 2: 0.25 from 500 to 1,064 nm, 0.09 at 1,550 nm
            (``torchweather.physics.flake_reflectivity``).
        melt_fraction: share of a flake's mass that is liquid, 0-1. Radar attenuation and backscatter use it
            (``PHYSICS.md`` 6.7); camera and LiDAR take the flake as dry, and number and fall speed stay those of
            dry snow.
        patch_log_std, patch_length_m: as in ``Rain``.
        visibility_spread: extinction over that of the size distribution at the rate, 0.3 to 3. Measured visibilities at
            one rate differ by a factor of 3 to 10 (Rasmussen et al. 1999, J. Appl. Meteor. 38). It stands for slower
            or faster flakes at the same mass flux: their number in the air is multiplied and their fall speed divided
            by it, for every sensor; their sizes stay.

    Example:
        >>> Snow(rate_mm_per_h=1).albedo
        0.9
        >>> denser = Snow(rate_mm_per_h=1, visibility_spread=2.0).distribution().total_per_m3
        >>> round(float(denser / Snow(rate_mm_per_h=1).distribution().total_per_m3), 6)
        2.0
    """

    kind: ClassVar[str] = "snow"
    rate_range_mm_per_h: ClassVar[tuple[float, float]] = SNOW_RATE_RANGE_MM_PER_H
    families: ClassVar[Mapping[str, Any]] = SNOW
    not_beyond_fit: ClassVar[tuple[str, ...]] = ("sekhon-srivastava", "gunn-marshall")
    particles: ClassVar[tuple[str, ...]] = ("melted-flake", "flake")

    size_distribution: str | Binned = "sekhon-srivastava"
    temperature_c: float = -5.0
    albedo: float = 0.9
    melt_fraction: float = 0.0
    flake_reflectivity: float | None = None
    visibility_spread: float = 1.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values that ``weather_from_dict`` takes; a spread of 1 is left out, as files had it before."""
        values = super().to_dict()
        if values["visibility_spread"] == 1.0:
            del values["visibility_spread"]
        return values

    def distribution(self, rate_mm_per_h: Intensity | None = None) -> SizeDistribution:
        """Size distribution in the air at a rate (the weather's own by default), per diameter of ``particle``."""
        found = super().distribution(rate_mm_per_h)
        return found if self.visibility_spread == 1.0 else found.scaled(self.visibility_spread)

    def fall_speed_m_per_s(self, diameter_mm: Tensor) -> Tensor:
        """Fall speed, m/s, from the diameter that the distribution counts, mm; with the number it keeps the flux."""
        speed = super().fall_speed_m_per_s(diameter_mm)
        return speed if self.visibility_spread == 1.0 else speed / self.visibility_spread

    def reflectivity_at(self, wavelength_nm: float) -> float:
        """Reflectivity of a flake for a LiDAR of a wavelength, nm: the given one, or that of a layer of ice grains.

        Example:
            >>> round(Snow(1).reflectivity_at(905.0), 2), Snow(1, flake_reflectivity=0.9).reflectivity_at(905.0)
            (0.25, 0.9)
        """
        if self.flake_reflectivity is not None:
            return self.flake_reflectivity
        return float(flake_reflectivity(wavelength_nm))


@dataclass(frozen=True, init=False)
class Fog(Weather):
    """Fog of a visibility.

    Args:
        mor_m: meteorological optical range, metres, a number or a tensor of the batch shape; infinity is no fog.
        size_distribution: a name from ``torchweather.physics.FOG``, each a function of ``mor_m``, or ``rehearse``:
            the measured fogs unscaled, interpolated between their nominal 10, 20, 30 and 50 m.
        contrast: contrast threshold of the visibility; 0.05 is the MOR's, 0.02 the older visual range's.
        temperature_c: water temperature, degrees Celsius.
        patch_log_std: spread of the logarithm of the droplets' number over the ground, 0 (uniform) to 2; the
            visibility is that of the mean number.
        patch_length_m: over which the density of banks changes, 5 to 10,000 m (``atmosphere/density_field.py``).
        visibility_m: another name of ``mor_m``.

    Example:
        >>> Fog(visibility_m=50) == Fog(mor_m=50)
        True
    """

    kind: ClassVar[str] = "fog"
    intensity_name: ClassVar[str] = "mor_m"

    mor_m: Given = math.inf
    size_distribution: str = "default"
    contrast: float = 0.05
    temperature_c: float = 10.0
    patch_log_std: Given = 0.0
    patch_length_m: Given = 30.0

    def __init__(
        self,
        mor_m: Given = math.inf,
        size_distribution: str = "default",
        contrast: float = 0.05,
        temperature_c: float = 10.0,
        patch_log_std: Given = 0.0,
        patch_length_m: Given = 30.0,
        *,
        visibility_m: Given | None = None,
    ) -> None:
        if visibility_m is not None and not (isinstance(mor_m, float) and math.isinf(mor_m)):
            raise InputValueError(
                f"Fog: mor_m and visibility_m are one number, the visibility in metres; got mor_m={mor_m!r} and "
                f"visibility_m={visibility_m!r}. Pass one of them."
            )
        values = {
            "mor_m": mor_m if visibility_m is None else visibility_m,
            "size_distribution": size_distribution,
            "contrast": contrast,
            "temperature_c": temperature_c,
            "patch_log_std": patch_log_std,
            "patch_length_m": patch_length_m,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @property
    def visibility_m(self) -> Given:
        """The visibility, metres: ``mor_m``."""
        return self.mor_m

    def __post_init__(self) -> None:
        if self._ends_are_good():
            return
        check_positive("mor_m", self.mor_m, unit="m", owner=self, advice="Dense fog is 50 m; infinity is clear air.")
        check_one_of("size_distribution", self.size_distribution, (*FOG, REHEARSE), owner=self)
        if self.size_distribution == REHEARSE:
            self._check_measured()
        check_fields(self, RANGES)
        self._check_patches()
        object.__setattr__(self, "mor_m", _plain_intensity(self.intensity))

    def _check_measured(self) -> None:
        mor_m = torch.as_tensor(self.mor_m).detach()
        low, high = REHEARSE_MOR_M[0], REHEARSE_MOR_M[-1]
        check_between(
            "mor_m",
            mor_m[mor_m.isfinite()],
            low,
            high,
            unit="m",
            owner=self,
            advice="The REHEARSE fogs were measured there; size_distribution='default' goes on beyond them.",
        )

    @classmethod
    def rehearse(cls, mor_m: int) -> Fog:
        """The measured REHEARSE fog of nominal visibility 10, 20, 30 or 50 m, unscaled (D3.4 Table 5)."""
        if mor_m not in REHEARSE_MOR_M:
            raise InputValueError(f"Fog.rehearse: mor_m must be one of 10, 20, 30, 50 m; got {mor_m!r}.")
        return cls(mor_m=float(mor_m), size_distribution=REHEARSE)

    @classmethod
    def advection(cls, mor_m: Intensity) -> Fog:
        """Advection fog (gamma distribution, effective radius 10 um) scaled to the visibility."""
        return cls(mor_m=mor_m, size_distribution="advection")

    def distribution(self, mor_m: Intensity | None = None) -> SizeDistribution:
        """Droplet size distribution at a visibility (the weather's own by default)."""
        mor = self.intensity if mor_m is None else mor_m
        if self.size_distribution == REHEARSE:
            return _rehearse_between(mor)
        found: SizeDistribution = FOG[self.size_distribution](mor)
        if self.contrast == MOR_CONTRAST:
            return found
        # A visibility of another contrast threshold: as many droplets more as ln(1/contrast) is above ln 20.
        return found.scaled(math.log(self.contrast) / math.log(MOR_CONTRAST))


def _rehearse_between(mor_m: Intensity) -> LogNormal:
    """The measured fogs; ln N, ln r and sigma linear in ln V between them, held outside."""
    measured = [rehearse_fog(mor) for mor in REHEARSE_MOR_M]
    log_v = torch.log(torch.as_tensor(mor_m, dtype=torch.float64).clamp(REHEARSE_MOR_M[0], REHEARSE_MOR_M[-1]))
    rows = torch.tensor(
        [[math.log(f.number_per_cm3), math.log(f.median_radius_um), f.sigma] for f in measured], dtype=torch.float64
    )
    value = rows[0].expand(*log_v.shape, 3)
    for k in range(len(measured) - 1):  # a sum of ramps: elementwise and differentiable
        low, high = (math.log(v) for v in REHEARSE_MOR_M[k : k + 2])
        ramp = ((log_v - low) / (high - low)).clamp(0.0, 1.0)
        value = value + ramp[..., None] * (rows[k + 1] - rows[k])
    return LogNormal(torch.exp(value[..., 0]), torch.exp(value[..., 1]), value[..., 2])


def check_drawn(weather: Weather, *, owner: object) -> None:
    """Raise where a weather has yet to be drawn."""
    for part in (*weather.parts, *weather.conditions):
        for name, one in part.random.items():
            raise InputValueError(
                f"{owner_name(owner)}: {name} must be a number here; got {one!r}. Draw one weather, "
                "weather.drawn(seed); or call the transform without noise, or Compose, which draw one for each sample."
            )


def check_intensities(weather: Weather, batch: Sequence[int], *, owner: object) -> None:
    """Raise unless each intensity is one value or one for each sample of the batch."""
    check_drawn(weather, owner=owner)
    for part in weather.parts:
        intensity = part.intensity
        if isinstance(intensity, Tensor) and intensity.numel() != 1 and tuple(intensity.shape) != tuple(batch):
            raise InputValueError(
                f"{owner_name(owner)}: {part.intensity_name} must be one value or one for each sample, shape "
                f"{tuple(batch)}; got shape {tuple(intensity.shape)}."
            )


def _bins_to_dict(measured: Binned) -> dict[str, Any]:
    return {
        "edges_mm": measured.edges_mm.tolist(),
        "density_per_m3_mm": measured.density_per_m3_mm.tolist(),
        "particle": measured.particle,
    }


def _plain_intensity(intensity: Intensity) -> Intensity:
    """A number as Python has it, so that it prints and goes to YAML; a tensor stays."""
    return intensity if isinstance(intensity, (Tensor, int, float)) else float(intensity)


class Mixture(Weather):
    """Several weathers at once: ``Mixture(Rain(10), Fog(mor_m=200))``.

    Extinctions add, particles of all kinds compete, the sensor measures once. The order does not matter, and
    ``Mixture(x)`` is ``x``. Water and snow on things (``torchweather.atmosphere.conditions``) are weathers too:
    ``Mixture(Rain(10), WetRoad())``. They are its ``conditions``; its ``parts`` are what is in the air.

    Example:
        >>> [part.kind for part in Mixture(Snow(1), Fog(mor_m=300)).parts]
        ['fog', 'snow']
    """

    kind: ClassVar[str] = "mixture"

    def __init__(self, *weathers: Weather | Sequence[Weather]) -> None:
        given = [one for some in weathers for one in (some if isinstance(some, (list, tuple)) else (some,))]
        for one in given:
            if not isinstance(one, Weather):
                raise InputTypeError(
                    f"Mixture: expected weathers, such as Mixture(Rain(10), Fog(mor_m=200)); got {one!r} among them."
                )
        flat = [part for weather in given for part in weather.parts]
        on_things = [one for weather in given for one in weather.conditions]
        if not flat and not on_things:
            raise InputValueError("Mixture: expected at least one weather; got none.")
        kinds = [part.kind for part in (*flat, *on_things)]
        for kind in set(kinds):
            if kinds.count(kind) > 1:
                raise InputValueError(
                    f"Mixture: expected each kind once; got {kinds.count(kind)} times {kind}. Add their rates (or "
                    "their extinctions, for fog) into one."
                )
        self._parts = tuple(sorted(flat, key=lambda part: part.kind))
        self._conditions = tuple(sorted(on_things, key=lambda one: one.kind))
        lengths = {part.kind: part.patch_length_m for part in self._parts if part.patch_log_std != 0.0}
        if len({repr(length) for length in lengths.values()}) > 1:
            said = ", ".join(f"{kind} {length!r}" for kind, length in lengths.items())
            raise InputValueError(
                f"Mixture: all patches are of one field and have one patch_length_m, in m; got {said}."
            )

    @property
    def parts(self) -> tuple[Weather, ...]:
        """The weathers in the air, in a fixed order."""
        return self._parts

    @property
    def conditions(self) -> tuple[Weather, ...]:
        """Water and snow on things, in a fixed order."""
        return self._conditions

    @property
    def _all(self) -> tuple[Weather, ...]:
        return (*self._parts, *self._conditions)

    @property
    def random(self) -> dict[str, Distribution]:
        """Fields of the parts and conditions that are drawn for each sample, as ``rain.rate_mm_per_h``."""
        return {f"{part.kind}.{name}": one for part in self._all for name, one in part.random.items()}

    def with_values(self, values: Mapping[str, Any]) -> Mixture:
        """The same with other values of fields that ``random`` names."""
        own = {part.kind: {} for part in self._all}  # type: dict[str, dict[str, Any]]
        for name, value in values.items():
            kind, _, field = name.partition(".")
            own[kind][field] = value
        return Mixture(*(part.with_values(own[part.kind]) for part in self._all))

    def drawn(self, seed: int) -> Mixture:
        """One of each part and condition."""
        check_arguments("Mixture.drawn(seed: int)", seed)
        return Mixture(*(part.drawn(seed) for part in self._all))

    def densest(self) -> Mixture:
        """The densest of each part."""
        return Mixture(*(part.densest() for part in self._all))

    def __repr__(self) -> str:
        return f"Mixture({', '.join(map(repr, self._all))})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mixture) and self._all == other._all

    def __hash__(self) -> int:
        return hash(self._all)

    def to_dict(self) -> dict[str, Any]:
        """Plain values: the parts and conditions."""
        return {"kind": self.kind, "parts": [part.to_dict() for part in self._all]}


CLEAR_AIR = Rain(0.0)
"""Air in which nothing falls, for the chain of a weather that is on things alone."""
WEATHERS: dict[str, type[Rain] | type[Fog] | type[Snow]] = {"rain": Rain, "fog": Fog, "snow": Snow}
CONDITIONS: dict[str, type[Any]] = {}
"""Kind to class of water and snow on things; filled by ``torchweather.atmosphere.conditions``."""
# It builds on this file and is found by its name, so that a file can hold a condition in a process without any yet.
CONDITIONS_ROOM = "torchweather.atmosphere.conditions"
EXAMPLES = {"rain": "rain:rate=25", "fog": "fog:mor=100", "snow": "snow:rate=1"}


def weather_from_dict(values: Mapping[str, Any]) -> Weather:
    """The weather that ``to_dict`` wrote: ``{"kind": "rain", "rate_mm_per_h": 25.0, ...}``."""
    check_arguments("weather_from_dict(values: Mapping)", values)
    check_value(values, MAPPING, "torchweather", "weather")
    kind = values.get("kind")
    check_arguments("weather_from_dict(kind: str | None)", kind)
    if kind == "mixture":
        check_value(values.get("parts"), ROWS, "Mixture", "parts")
        return Mixture(*(weather_from_dict(part) for part in values["parts"]))
    check_one_of("weather kind", kind, weather_names(), owner="torchweather")
    found: Weather = weather_kind(str(kind)).from_dict(values)
    return found


def weather_kinds() -> dict[str, type[Any]]:
    """Kind to class of what is in the air and of what lies on things, in the library."""
    importlib.import_module(CONDITIONS_ROOM)
    return {**WEATHERS, **CONDITIONS}


def weather_names() -> list[str]:
    """Kinds of the library and names of installed packages."""
    return [*weather_kinds(), *plugin_names("weathers")]


def weather_kind(name: str) -> Any:
    """The class of a kind, or the weather that a package adds under a name of ``weather_names``.

    Raises:
        InputValueError: the name has two owners.
    """
    kinds = weather_kinds()
    plugin = find_plugin("weathers", name, kinds)
    return kinds[name] if plugin is None else NamedWeather(plugin, Weather)


def parse_weather(text: str, *, random: bool = False) -> Weather:
    """Read a weather as the command line takes it: ``rain:rate=25``, ``fog:mor=30+rain:rate=5``.

    Args:
        text: kinds with their fields; conditions of things too, ``rain:rate=10+wet-road:water=1``.
        random: takes ranges too, ``rain:rate=1..50``.

    Example:
        >>> parse_weather("fog:mor=30").mor_m
        30.0
    """
    check_arguments("parse_weather(text: str, random: bool)", text, random)
    parts = [_parse_one(part) for part in text.split("+")]
    weather = parts[0] if len(parts) == 1 else Mixture(*parts)
    if not random:
        check_drawn(weather, owner=f"weather {text!r}")
    return weather


def _parse_one(text: str) -> Weather:
    kind, _, arguments = text.strip().partition(":")
    check_one_of("weather", kind, weather_names(), owner="torchweather")
    found = weather_kind(kind)
    aliases = ALIASES if kind in WEATHERS else found.aliases
    values: dict[str, Any] = {}
    for argument in filter(None, arguments.split(",")):
        key, equals, value = argument.partition("=")
        if not equals:
            raise InputValueError(
                f"torchweather: weather {text!r}: expected key=value, for example rate=25; got {argument!r}."
            )
        values[aliases.get(key.strip(), key.strip())] = _plain(value.strip())
    weather: Weather = found.from_dict(values)
    if kind in WEATHERS and weather.intensity_name not in values:
        # The constructors' own value is clear air, which nobody writes this for.
        wanted = "a visibility in metres" if kind == "fog" else "a rate in mm/h"
        raise InputValueError(
            f"torchweather: weather {text.strip()!r}: expected {wanted}; got none. Give e.g. {EXAMPLES[kind]}."
        )
    return weather


def _plain(text: str) -> str | float | bool | Uniform:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    low, dots, high = text.partition("..")
    try:
        return Uniform(_number(low), _number(high)) if dots else _number(text)
    except InputValueError:
        raise
    except ValueError:
        return text


def _number(text: str) -> float:
    """A number; infinity only where it is written so."""
    value = float(text)
    if math.isinf(value) and "inf" not in text.lower():
        raise InputValueError(f"torchweather: weather: expected a number of at most 1.8e308; got {text[:40]!r}.")
    return value
