"""Radar stages on the way to the targets and back: path_attenuation and wet_radome."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.density_field import mean_density, mean_extra_m
from torchweather.atmosphere.fog_optics import mor_range_m
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather, weather_from_dict
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.lidar.returns.beam_particles import RATE_HIGH_MM_PER_H, RATE_LOW_MM_PER_H, RATE_NODES
from torchweather.physics import (
    RAIN_ATTENUATION_MODELS,
    SNOW_ATTENUATION_MODELS,
    InterpolationTable,
    fog_attenuation_db_per_km,
    particle_attenuation_db_per_km,
    rain_attenuation_db_per_km,
    snow_attenuation_db_per_km,
)
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = ["FOG_ATTENUATION_MODELS", "PathAttenuation", "WetRadome", "weather_attenuation_db_per_km"]

FOG_ATTENUATION_MODELS = ("p840", "d3_4")
# The water of the default fog turns from V^-2 to V^-1 at 50 m: linear in a cell of width h, that is off by h / 4.
FOG_NODES = 1024
MODELS = {"rain": RAIN_ATTENUATION_MODELS, "fog": FOG_ATTENUATION_MODELS, "snow": SNOW_ATTENUATION_MODELS}
DEFAULT_MODELS = {"rain": "p838", "fog": "p840", "snow": "dsd_mie"}
TILT_RAD = {"h": 0.0, "v": math.pi / 2}


def weather_attenuation_db_per_km(
    weather: Weather, radar: Radar, model: str | None = None, intensity: float | Tensor | None = None
) -> Tensor:
    """Attenuation of a single weather at a radar's carrier, dB/km one way.

    Args:
        weather: ``Rain``, ``Fog`` or ``Snow``.
        radar: frequency, polarisation and elevation count.
        model: of rain ``p838`` (ITU-R P.838-3), ``dsd_mie`` (Mie over the weather's own drops) or ``d3_4`` (Sander); of
            fog ``p840`` (ITU-R P.840) or ``d3_4``; of snow ``dsd_mie`` (Mie over its own flakes) or ``d3_4``
            (Norouziari). ``None``: the first of each.
        intensity: rate, mm/h, or visibility, m, a number or a tensor, which may require grad; ``None``: the weather's.

    Returns:
        float64, of the shape of the intensity.

    References:
        PHYSICS.md 6.5-6.7.

    Example:
        >>> round(float(weather_attenuation_db_per_km(Rain(25.0), Radar())), 2)
        11.41
    """
    check_arguments(
        "weather_attenuation_db_per_km(weather: Weather, radar: Radar, model: str | None, "
        "intensity: float | Tensor | None)",
        weather,
        radar,
        model,
        intensity,
    )
    chosen = DEFAULT_MODELS[weather.kind] if model is None else model
    check_one_of(f"model of {weather.kind}", chosen, MODELS[weather.kind], owner="weather_attenuation_db_per_km")
    frequency_ghz = radar.frequency_ghz
    value = weather.intensity if intensity is None else intensity
    if isinstance(weather, Fog):
        water = weather.distribution(value).liquid_water_g_per_m3()
        variant = "d3_4" if chosen == "d3_4" else "default"
        return fog_attenuation_db_per_km(water, frequency_ghz, temperature_c=weather.temperature_c, variant=variant)
    assert isinstance(weather, (Rain, Snow))
    if chosen == "dsd_mie":
        melted = {"melt_fraction": weather.melt_fraction} if isinstance(weather, Snow) else {}
        return particle_attenuation_db_per_km(
            weather.distribution(value), frequency_ghz, temperature_c=weather.temperature_c, **melted
        )
    if isinstance(weather, Snow):
        typical = snow_attenuation_db_per_km(value, frequency_ghz, model=chosen, melt_fraction=weather.melt_fraction)
        return weather.visibility_spread * typical  # as many flakes more
    return rain_attenuation_db_per_km(
        value,
        frequency_ghz,
        model=chosen,
        polarisation_tilt_rad=TILT_RAD[radar.polarisation],
        elevation_rad=radar.elevation_rad,
    )


@lru_cache(maxsize=64)
def _table(weather: Weather, radar: Radar, model: str) -> InterpolationTable:
    """dB/km over the intensity; the weather's own counts for nothing."""

    def of_intensity(intensity: Tensor) -> Tensor:
        return weather_attenuation_db_per_km(weather, radar, model, intensity)

    if isinstance(weather, Fog):
        return InterpolationTable(of_intensity, *mor_range_m(weather), FOG_NODES, zero_at_inf=True)
    return InterpolationTable(of_intensity, RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H, RATE_NODES, zero_at_zero=True)


class _PartAttenuation(nn.Module):
    """Attenuation of one weather over its intensity."""

    def __init__(self, weather: Weather, radar: Radar, model: str) -> None:
        super().__init__()
        self.weather = weather
        none = math.inf if isinstance(weather, Fog) else 0.0
        self.at_rest: Weather = replace(weather, **{weather.intensity_name: none})  # type: ignore[type-var]
        carrier = Radar(
            frequency_ghz=radar.frequency_ghz, polarisation=radar.polarisation, elevation_rad=radar.elevation_rad
        )
        # A copy: .to(dtype) of one module must not reach the cached table of all others.
        self.table = copy.deepcopy(_table(self.at_rest, carrier, model))
        self.register_buffer(weather.intensity_name, torch.as_tensor(weather.intensity, dtype=torch.float32))

    @property
    def intensity(self) -> Tensor:
        """Rate or visibility, flattened."""
        found: Tensor = getattr(self, self.weather.intensity_name).reshape(-1)
        return found

    def forward(self) -> Tensor:
        """dB/km one way, of the intensity's shape flattened."""
        found: Tensor = self.table(self.intensity)
        return found


@register
class PathAttenuation(Stage):
    """Loss on the way to each target and back: ``2 gamma R``, all weather added.

    Identity: rates 0, visibility infinite.

    Args:
        weathers: or their dictionaries.
        sensor: the radar, or its dictionary.
        rain_model, fog_model, snow_model: as in ``weather_attenuation_db_per_km``.
    """

    default_name: ClassVar[str] = "path_attenuation"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        *("air.attenuation_db_per_km", "air.patches"),
        "returns.gain_db",
    )
    writes: ClassVar[tuple[str, ...]] = (
        *("air.attenuation_db_per_km", "air.extra_m", "air.rates_mm_per_h", "air.weathers"),
        "returns.gain_db",
        "receiver.sensor",
    )

    def __init__(
        self,
        weathers: Sequence[Weather | Mapping[str, Any]],
        sensor: Radar | Mapping[str, Any],
        rain_model: str = "p838",
        fog_model: str = "p840",
        snow_model: str = "dsd_mie",
    ) -> None:
        check_arguments(
            "PathAttenuation(weathers: Sequence, sensor: Radar | Mapping, rain_model: str, fog_model: str, "
            "snow_model: str)",
            weathers,
            sensor,
            rain_model,
            fog_model,
            snow_model,
        )
        super().__init__()
        self.sensor = Radar.of(sensor)
        self.models = {"rain": rain_model, "fog": fog_model, "snow": snow_model}
        for kind, model in self.models.items():
            check_one_of(f"{kind}_model", model, MODELS[kind], owner=self)
        built = [w if isinstance(w, Weather) else weather_from_dict(w) for w in weathers]
        self.parts = nn.ModuleDict()
        for weather in Mixture(*built).parts:
            self.parts[weather.kind] = _PartAttenuation(weather, self.sensor, self.models[weather.kind])

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        weathers = [part.weather.to_dict() for part in self.parts.values()]  # type: ignore[union-attr,operator]
        models = {f"{kind}_model": model for kind, model in self.models.items()}
        return {"weathers": weathers, "sensor": self.sensor.to_dict(), **models}

    def attenuation_db_per_km(self, batch: int) -> Tensor:
        """Of all weather together, one way, ``(B,)``."""
        return torch.stack([part().expand(batch) for part in self.parts.values()]).sum(0)

    def two_way_db(self, range_m: Tensor) -> Tensor:
        """Loss of a path ``(B, ...)`` to a target and back, dB."""
        per_km = self.attenuation_db_per_km(range_m.shape[0]).to(range_m.dtype)
        return 2e-3 * per_km.reshape(-1, *(1,) * (range_m.ndim - 1)) * range_m

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with weaker targets."""
        per_km = self.attenuation_db_per_km(state.batch).to(state.returns.gain_db.dtype)
        parts: dict[str, _PartAttenuation] = dict(self.parts.items())  # type: ignore[arg-type]
        loss_db, extra_m = self.two_way_db(state.scene.range_m), None
        if state.air.patches is not None:
            takes = [part().expand(state.batch).to(per_km) for part in parts.values()]
            extra_m = mean_extra_m(state.air.patches, [part.weather for part in parts.values()], takes)
            x, y, _ = state.scene.points_in[..., :3].unbind(-1)
            ground_m = (x * x + y * y).sqrt()
            loss_db = loss_db * mean_density(extra_m, torch.atan2(y, x), ground_m, state.air.patches.step_m)
        return state.changed(
            gain_db=state.returns.gain_db - loss_db,
            attenuation_db_per_km=state.air.attenuation_db_per_km + per_km,
            extra_m=extra_m,
            sensor=self.sensor,
            weathers=tuple(part.at_rest for part in parts.values()),
            rates_mm_per_h={
                kind: part.intensity.expand(state.batch)
                for kind, part in parts.items()
                if not isinstance(part.weather, Fog)
            },
        )


@register
class WetRadome(Stage):
    """Water on the radar's cover: every target weaker by the same, whatever its range; the noise floor stays.

    ``loss_db + film_db (R / 1 mm/h)^film_exponent`` both ways together, with the rain rate R of the weather.

    Identity: ``loss_db = 0`` and ``film_db = 0``.

    Args:
        rate_mm_per_h: rain rate; a number or one value a sample.
        loss_db: of a film that does not depend on the rate, two way.
        film_db: of the film at 1 mm/h, two way.
        film_exponent: of the rate; a film that runs off under gravity grows with the cube root of the flow.

    Note:
        What a film costs depends on cover and coating: fractions of a dB for a hydrophobic one, several dB for a sheet
        of water. There is no default beyond the identity. Drying after the rain is not in it.

    References:
        PHYSICS.md 6.7 (radome wetting exceeds dry snow). The cube root: Nusselt's film, as in Blevis 1965 (IEEE Trans.
        Antennas Propag. 13, 175), primary text not seen.
    """

    default_name: ClassVar[str] = "wet_radome"
    reads: ClassVar[tuple[str, ...]] = ("receiver.cover_loss_db", "returns.gain_db", "scene.points_in", "scene.range_m")
    writes: ClassVar[tuple[str, ...]] = ("receiver.cover_loss_db", "returns.gain_db")
    rate_mm_per_h: Tensor
    loss_db: Tensor
    film_db: Tensor
    film_exponent: Tensor

    def __init__(
        self,
        rate_mm_per_h: float | Tensor | Sequence[float] = 0.0,
        loss_db: float = 0.0,
        film_db: float = 0.0,
        film_exponent: float = 1.0 / 3.0,
    ) -> None:
        check_arguments(
            "WetRadome(rate_mm_per_h: Quantity, loss_db: float, film_db: float, film_exponent: float)",
            rate_mm_per_h,
            loss_db,
            film_db,
            film_exponent,
        )
        super().__init__()
        rate = torch.as_tensor(rate_mm_per_h, dtype=torch.float32)
        check_at_least("rate_mm_per_h", rate, 0.0, unit="mm/h", owner=self)
        given = {"loss_db": loss_db, "film_db": film_db, "film_exponent": film_exponent}
        for name, value in given.items():
            check_at_least(name, value, 0.0, unit="dB" if name.endswith("db") else "", owner=self)
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.register_buffer("rate_mm_per_h", rate)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {name: value.tolist() for name, value in self.named_buffers()}

    def two_way_db(self, batch: int) -> Tensor:
        """Loss of the film, ``(B,)``; 0 where it does not rain, but for ``loss_db``."""
        rate = self.rate_mm_per_h.reshape(-1).expand(batch)
        raining = rate > 0
        film = self.film_db * torch.where(raining, rate, torch.ones_like(rate)) ** self.film_exponent
        return self.loss_db + torch.where(raining, film, torch.zeros_like(film))

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with all targets weaker."""
        loss = self.two_way_db(state.batch).to(state.returns.gain_db.dtype)
        of_targets = torch.where(state.scene.range_m > 0, loss[:, None], 0.0)
        return state.changed(
            gain_db=state.returns.gain_db - of_targets, cover_loss_db=state.receiver.cover_loss_db + loss
        )
