"""RadarMapWeather: weather on the power maps of a radar."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.density_field import patchy_air
from torchweather.atmosphere.weather import CLEAR_AIR, Rain, Snow, Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of
from torchweather.core.precision import outside_autocast
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.conditions import with_conditions
from torchweather.pipeline.effect import Effect, effect_from_dict
from torchweather.pipeline.sensor_transform import WeatherTransform
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.conditions import radar_conditions
from torchweather.radar.map_options import RadarMapOptions
from torchweather.radar.power_map import (
    MapAxes,
    MapClutter,
    MapReceiver,
    PowerMapState,
    PowerScale,
    RadarPowerMap,
    map_state,
)
from torchweather.radar.sensor import Radar

__all__ = ["MAP_EFFECTS", "RadarMapResult", "RadarMapWeather"]

MAP_EFFECTS = ("radar.wet_radome", "radar.path_loss_scale", "radar.noise_floor")
"""Effects of the catalogue that a map can show; the others are of lists of detections."""


@dataclass(frozen=True)
class RadarMapResult:
    """Effect of the weather on a power map.

    Args:
        values: ``(..., *S)`` the map, in the dtype of the input; S as the sizes of the axes.
        attenuation_db: ``(..., *S)`` two-way loss of path and cover, in sizes that broadcast over the map.
        clutter_db: ``(..., *S)`` mean echo of rain and snow over the mean noise, dB, likewise; minus infinity without.
        noise_floor_db: ``(..., *S)`` mean noise of the input, dB in the map's unit, likewise.
    """

    values: Tensor
    attenuation_db: Tensor
    clutter_db: Tensor
    noise_floor_db: Tensor


class RadarMapWeather(WeatherTransform):
    """Weather on the power maps of a radar: weaker echoes over the same noise floor, and the speckle of rain and snow.

    Args:
        weather: ``Rain``, ``Fog``, ``Snow`` (melting: ``melt_fraction``) or a ``Mixture`` of them.
        sensor: the radar; its link budget says how far echoes of rain lie above its noise.
        axes: order and place of the cells.
        scale: what the numbers of the maps mean.
        noise_floor_db: mean noise in the maps' unit: one number, or one for each range bin; ``None``: found in the
            quiet cells of each map.
        looks: independent looks whose mean power a cell holds, 1 to 64.
        oversampling: range resolution over the width of a range bin, for the correlation of noise along the range (Hann
            window); 0: none. ``None``: the sensor's resolution over the maps' bin.
        rain_model, fog_model, snow_model: as of ``RadarAttenuation``.
        radome_loss_db, radome_film_db, radome_film_exponent: of a wet cover, as of ``RadarAttenuation``.
        clutter: add the echoes of rain and snow.
        clutter_share: factor on their reflectivity.
        ego_speed_m_per_s: of the vehicle, forward; for the clutter's Doppler.
        effects: ``radar.wet_radome``, ``radar.path_loss_scale``, ``radar.noise_floor``, or their dictionaries.
        p: probability that a sample gets the weather; the others come back as they are.

    What is not known may be a distribution, drawn for each sample, as of ``RadarAttenuation``.

    Note:
        Without weather the input's own bits come out. A cell that was cut off at the top of its scale loses from there.

    References:
        PHYSICS.md 6.2, 6.5-6.8; ``radar/power_map/receiver.py`` for the law of a cell.

    Example:
        >>> from torchweather import Radar, Rain
        >>> axes = MapAxes.of_turn(bins=200, bin_m=0.25, azimuths=80)
        >>> clear = torch.full((80, 200), 1e-3)
        >>> clear[10, 159] = 1e4  # 70 dB over the noise, 39.9 m away
        >>> rain = RadarMapWeather(
        ...     Rain(50), Radar(), axes=axes, scale=PowerScale("linear"), noise_floor_db=-30.0, clutter=False
        ... )
        >>> wet = rain(clear, rain.draw(clear, seed=1))
        >>> round(float(10 * (clear / wet)[10, 159].log10()), 1)
        1.5
    """

    takes_all: ClassVar[str] = "RadarMapWeather"
    sensor_class: ClassVar[type[Radar]] = Radar

    def __init__(
        self,
        weather: Weather | None,
        sensor: Radar,
        *,
        axes: MapAxes,
        scale: PowerScale,
        noise_floor_db: float | Sequence[float] | None = None,
        looks: int = 1,
        oversampling: float | None = None,
        rain_model: str | Distribution = "p838",
        fog_model: str | Distribution = "p840",
        snow_model: str | Distribution = "dsd_mie",
        radome_loss_db: float | Distribution = 0.0,
        radome_film_db: float | Distribution = 0.0,
        radome_film_exponent: float | Distribution = 1.0 / 3.0,
        clutter: bool = True,
        clutter_share: float | Distribution = 1.0,
        ego_speed_m_per_s: float | Distribution = 0.0,
        effects: Sequence[Effect | Mapping[str, Any]] = (),
        p: float = 1.0,
    ) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "axes": axes,
            "scale": scale,
            "noise_floor_db": noise_floor_db,
            "looks": looks,
            "oversampling": oversampling,
            "rain_model": rain_model,
            "fog_model": fog_model,
            "snow_model": snow_model,
            "radome_loss_db": radome_loss_db,
            "radome_film_db": radome_film_db,
            "radome_film_exponent": radome_film_exponent,
            "clutter": clutter,
            "clutter_share": clutter_share,
            "ego_speed_m_per_s": ego_speed_m_per_s,
            "effects": effects,
            "p": p,
        }
        at, sensor = self._fixed(weather, RadarMapOptions(**values), sensor)
        check_arguments(
            "RadarMapWeather(noise_floor_db: float | Sequence[float] | None, looks: int, "
            "oversampling: float | None, rain_model: str, fog_model: str, snow_model: str, radome_loss_db: float, "
            "radome_film_db: float, radome_film_exponent: float, clutter: bool, clutter_share: float, "
            "ego_speed_m_per_s: float, effects: Sequence, p: float)",
            at.noise_floor_db,
            at.looks,
            at.oversampling,
            at.rain_model,
            at.fog_model,
            at.snow_model,
            at.radome_loss_db,
            at.radome_film_db,
            at.radome_film_exponent,
            at.clutter,
            at.clutter_share,
            at.ego_speed_m_per_s,
            at.effects,
            at.p,
        )
        weather = self._check_weather(weather)
        self._check_p(at.p)
        Radar.check(sensor, "sensor", "imaging-77ghz", owner=self)
        for name, value, wanted in (("axes", at.axes, MapAxes), ("scale", at.scale, PowerScale)):
            if not isinstance(value, wanted):
                raise InputTypeError(f"RadarMapWeather: {name} must be {wanted.__name__}; got {type(value).__name__}.")
        self.weather, self.sensor, self.axes, self.scale = weather, sensor, at.axes, at.scale
        self.data_shape = at.axes.dims
        self.ego_speed_m_per_s = float(at.ego_speed_m_per_s)
        dense = weather.densest()
        oversampling = at.oversampling
        if oversampling is None:
            oversampling = max(1.0, sensor.range_resolution_m / at.axes.range_bin_m)
        floor = list(at.noise_floor_db) if isinstance(at.noise_floor_db, Sequence) else at.noise_floor_db
        stages = {
            **patchy_air(dense, at.ego_speed_m_per_s),
            "path_attenuation": PathAttenuation(
                dense.parts or (CLEAR_AIR,), sensor, at.rain_model, at.fog_model, at.snow_model
            ),
        }
        if at.radome_loss_db or at.radome_film_db:
            rates = [part.intensity for part in dense.parts if isinstance(part, Rain)]
            stages["wet_cover"] = WetRadome(
                rates[0] if rates else 0.0, at.radome_loss_db, at.radome_film_db, at.radome_film_exponent
            )
        stages["map_receiver"] = MapReceiver(at.axes, at.scale, floor, at.looks, oversampling)
        built = [effect if isinstance(effect, Effect) else effect_from_dict(effect) for effect in at.effects]
        conditions = radar_conditions(dense, sensor)
        for effect in (*built, *(effect for _, effect in conditions.effects)):
            check_one_of("effects", effect.id, MAP_EFFECTS, owner=self)
        chain = with_conditions(Chain(stages), built, conditions, self)
        for part in dense.parts:
            if at.clutter and at.clutter_share > 0 and isinstance(part, (Rain, Snow)):
                echo = MapClutter(part, sensor, at.axes, at.clutter_share, ego_speed_m_per_s=at.ego_speed_m_per_s)
                chain = chain.insert(echo, before="map_receiver", name=f"{part.kind}_clutter")
        self.chain = chain
        self.as_built = AsBuilt.of(self.chain)

    @property
    def attenuation_db_per_km(self) -> Tensor:
        """Of all weather together, one way, one value for each value of the intensity."""
        stage = self.chain.stages["path_attenuation"]
        assert isinstance(stage, PathAttenuation)
        return stage.attenuation_db_per_km(max(part().numel() for part in stage.parts.values()))

    # ---- calls -------------------------------------------------------------------------------------------------

    @outside_autocast
    def forward(
        self,
        values: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """The map in the weather.

        Args:
            values: ``(..., *S)``, S as the sizes of the axes, in numbers of the scale.
            noise: what ``draw`` gave; ``None`` draws anew.
            seed: for a call that draws: an integer s for the samples s, s + 1, ..., or a tensor of the batch shape.
            generator: likewise, a torch generator that gives these integers.

        Returns:
            The same shape and dtype.
        """
        if not isinstance(values, Tensor):
            self._check_values(values)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and values.ndim > len(self.axes.dims) and values.numel():
                return self.each_alone(self.forward, values, seed, generator, {}, len(self.axes.dims))
            chosen, seeds = self.at_call(values.shape[: values.ndim - len(self.axes.dims)], seed, generator)
            return chosen.forward(values, chosen.draw(values, seed=seeds))
        state = self._through(values, noise)
        assert state.maps.map_out is not None
        return state.maps.map_out.reshape(values.shape)

    if TYPE_CHECKING:
        __call__ = forward

    @outside_autocast
    def run(
        self,
        values: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> RadarMapResult:
        """The map, and what happened to it; arguments as ``forward``."""
        if not isinstance(values, Tensor):
            self._check_values(values)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and values.ndim > len(self.axes.dims) and values.numel():
                return self.each_alone(self.run, values, seed, generator, {}, len(self.axes.dims))
            chosen, seeds = self.at_call(values.shape[: values.ndim - len(self.axes.dims)], seed, generator)
            return chosen.run(values, chosen.draw(values, seed=seeds))
        state = self._through(values, noise)
        assert state.maps.map_out is not None
        assert state.maps.map_in is not None
        batch = values.shape[: values.ndim - len(self.axes.dims)]
        receiver = self.chain.stages["map_receiver"]
        assert isinstance(receiver, MapReceiver)
        loss_db = 0.0 - state.returns.gain_db.reshape(state.batch, len(self.axes.range_m), -1)
        clutter = state.maps.map_clutter
        if clutter is None:
            clutter = loss_db.new_zeros(state.batch, *(1 for _ in self.axes.dims))
        parts = {
            "attenuation_db": self.axes.laid_out(loss_db, ("range", "azimuth")),
            "clutter_db": 10.0 * clutter.log10(),
            "noise_floor_db": receiver.floor_db(state.maps.map_in),
        }
        shaped = {
            name: part.expand(state.batch, *part.shape[1:]).reshape(*batch, *part.shape[1:])
            for name, part in parts.items()
        }
        return RadarMapResult(values=state.maps.map_out.reshape(values.shape), **shaped)

    def of_map(self, power_map: RadarPowerMap, seed: int | None = None) -> RadarPowerMap:
        """A recorded map in the weather.

        Args:
            power_map: of the same axes and scale.
            seed: the same seed gives the same weather; ``None`` draws from torch's global generator.
        """
        check_arguments("RadarMapWeather.of_map(power_map: RadarPowerMap, seed: int | None)", power_map, seed)
        if power_map.axes != self.axes or power_map.scale != self.scale:
            raise InputValueError(
                "RadarMapWeather.of_map: the map has other axes or another scale than the transform. Build one with "
                "axes=power_map.axes, scale=power_map.scale."
            )
        with torch.no_grad():
            return power_map.with_values(self(power_map.values, self.draw(power_map.values, seed=seed)))

    @outside_autocast
    def draw(
        self, values: Tensor, generator: torch.Generator | None = None, seed: int | Tensor | None = None
    ) -> dict[str, Tensor]:
        """Noise for ``forward``; depends on the sizes alone.

        Args:
            values: ``(..., *S)``.
            generator: torch generator that gives one integer a sample; ``None`` is the global one.
            seed: those integers themselves: a tensor of the batch shape, or the first of them.

        Returns:
            ``<stage>.<variate>`` to a tensor that leads with the batch shape.
        """
        self._check_values(values)
        return self.drawn(values.shape[: values.ndim - len(self.axes.dims)], {}, generator, seed)

    # ---- the border --------------------------------------------------------------------------------------------

    def _check_values(self, values: Tensor) -> None:
        shape, name = self.axes.shape, type(self).__name__
        if not isinstance(values, Tensor):
            raise InputTypeError(f"{name}: values must be a tensor; got {type(values).__name__}.")
        if values.ndim < len(shape) or tuple(values.shape[values.ndim - len(shape) :]) != shape:
            named = ", ".join(f"{dim} {size}" for dim, size in zip(self.axes.dims, shape, strict=True))
            raise InputValueError(f"{name}: values must have shape (..., {named}); got {tuple(values.shape)}.")
        self.scale.check(values)
        if values.is_floating_point() or values.is_complex():
            real = torch.view_as_real(values) if values.is_complex() else values
            bad = int(real.isnan().sum() if self.scale.kind == "db" else (~real.isfinite()).sum())
            if bad:
                raise InputValueError(
                    f"{name}: values must be finite; got NaN or infinity in {bad} cells. Give no power 0."
                )

    def _through(self, values: Tensor, noise: Mapping[str, Tensor] | None) -> PowerMapState:
        self._check_values(values)
        batch = values.shape[: values.ndim - len(self.axes.dims)]
        self.refuse_undrawn(batch)
        flat = values.reshape(math.prod(batch), *self.axes.shape)
        state = map_state(flat, self.axes, self.sensor, self.ego_speed_m_per_s)
        drawn = self.chain.draw(state) if noise is None else self._flat_noise(noise, state, batch)
        found: PowerMapState = self.chain(state, {key: value.to(flat.device) for key, value in drawn.items()})
        return found
