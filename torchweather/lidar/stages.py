"""LiDAR stages: to_energy, extinction, particle_returns, detection, to_points."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.density_field import SECTORS, Banks, PatchField, mean_density, mean_extra_m, sector_of
from torchweather.atmosphere.fog_optics import FogOptics
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather, weather_from_dict
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, check_at_least, check_one_of
from torchweather.core.random import Variate
from torchweather.lidar.beam import Beam
from torchweather.lidar.compiled_calls import chosen_echoes, is_plain, read_echoes
from torchweather.lidar.intensity import (
    dimmed_intensity,
    intensity_from_signal,
    reflectivity_from_intensity,
)
from torchweather.lidar.returns.beam_particles import (
    PUBLISHED_DOMAIN_MM,
    RATE_HIGH_MM_PER_H,
    RATE_LOW_MM_PER_H,
    RATE_NODES,
    BeamParticles,
)
from torchweather.lidar.returns.compiled_calls import compiled_echoes, compiles
from torchweather.lidar.returns.soft_return import SoftReturn
from torchweather.lidar.returns.strongest import ReturnTable, strongest_before
from torchweather.lidar.sensor import CALIBRATION_REFLECTIVITY, Lidar
from torchweather.lidar.state import LidarState
from torchweather.physics import Q_EFF, InterpolationTable, extinction_from_mor, extinction_per_m
from torchweather.pipeline.module_copy import with_buffers
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = [
    "Detection",
    "Extinction",
    "ParticleReturns",
    "SensorStage",
    "ToEnergy",
    "ToPoints",
    "vehicle_directions",
]

DB = math.log(10.0) / 10.0
LEAST_RAMP = 1e-4  # of the near-range response, so that margins stay finite
THINNEST = 1e-6  # density of a beam that counts as none
NO_RANGE_M2 = 1e-12  # keeps a beam without return from dividing by its range 0
OF_POINTS = (  # of the scene: what a point that goes out is made of
    *("points_in", "empty_direction", "clear_range_m", "clear_signal", "integral", "borrowed_intensity"),
)
OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))


def _config(sensor: Lidar) -> dict[str, Any]:
    """Plain values of a sensor; the directions belong to the data, not to the stage."""
    return sensor.to_dict(without=Lidar.data_fields)


def _azimuth_and_level(state: LidarState) -> tuple[Tensor, Tensor]:
    """Azimuth of each beam and the level part of its direction, ``(B, N)`` each."""
    x, y, _ = state.direction.unbind(-1)
    return torch.atan2(y, x), (x * x + y * y).sqrt()


def vehicle_directions(state: LidarState, sensor: Lidar) -> Tensor:
    """Unit vector of each beam in the cloud's frame, ``(B, N, 3)``: x forward, y left, z up."""
    along = state.direction
    return along if sensor.rotation is None else along @ along.new_tensor(sensor.rotation).T


def exponential(uniform: Tensor) -> Tensor:
    """Standard exponential variates from uniform ones, 0 to 16.6 in single precision."""
    return -(1.0 - uniform).log()


class SensorStage(Stage):
    """A stage that is made from the sensor alone."""

    each_beam_alone = True

    def __init__(self, sensor: Lidar | Mapping[str, Any]) -> None:
        super().__init__()
        self.sensor = Lidar.of(sensor)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"sensor": _config(self.sensor)}


@register
class ToEnergy(SensorStage):
    """Signal of each object in clear air, from its intensity.

    ``X = (I / pi) xi(R) / R^2`` from a reflectivity, ``X = I / K`` from photons. A return in the input was detected, so
    ``X >= X_thr 10^(m/10)`` with a margin m of exponential law (``PHYSICS.md`` 5.3). An intensity of 0 stands for
    ``zero_intensity`` of the state.

    Note:
        Where the receiver's response rises, that a return was detected says how wrong the response is rather than how
        faint the return: the mean margin there is that of the sensor over the ramp of the response, up to the signal of
        a 10 % target in full response. So the chance to lose a faint return goes to 0 towards ``near_start_m``, nearer
        than which none is lost (``Detection``).

    Args:
        sensor: the LiDAR, or its dictionary.
    """

    default_name: ClassVar[str] = "to_energy"
    reads: ClassVar[tuple[str, ...]] = ("scene.clear_range_m", "scene.points_in", "scene.zero_intensity")
    writes: ClassVar[tuple[str, ...]] = (
        "scene.clear_signal",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.sensor", "receiver.threshold"),
    )
    margin_db: Tensor
    photons_at_threshold: Tensor

    def __init__(self, sensor: Lidar | Mapping[str, Any]) -> None:
        check_arguments("ToEnergy(sensor: Lidar | Mapping)", sensor)
        super().__init__(sensor)
        self.beam = Beam(self.sensor)
        self.register_buffer("margin_db", torch.tensor(self.sensor.margin_db))
        self.register_buffer("photons_at_threshold", torch.tensor(float(self.sensor.photons_at_threshold)))

    def variates(self) -> tuple[Variate, ...]:
        """The margin of each beam, as the probability of a smaller one."""
        return (Variate("margin", "uniform", ("N",)),)

    def signal_of_intensity(self, intensity: Tensor, range_m: Tensor, zero_intensity: Tensor | None = None) -> Tensor:
        """X of an object from its intensity, without the floor, ``(B, N)``; 0 for a beam without return.

        Args:
            intensity: ``(B, N)`` in the sensor's unit.
            range_m: ``(B, N)``.
            zero_intensity: ``(B, 1)`` intensity that a value of 0 stands for; ``None`` is 0.
        """
        unit = self.sensor.intensity_unit
        if zero_intensity is not None:
            intensity = torch.where(intensity == 0, zero_intensity.to(intensity), intensity)
        if unit == "photons":
            return intensity * (range_m > 0) * (self.beam.threshold / self.photons_at_threshold)
        reflectivity = reflectivity_from_intensity(intensity, unit, self.sensor.assumed_reflectivity)
        # At range 0 the receiver's response is 0.
        return reflectivity * self.beam.near_response(range_m) / (math.pi * range_m.square()).clamp_min(NO_RANGE_M2)

    def contradicts_threshold(self, intensity: Tensor, range_m: Tensor, zero_intensity: Tensor | None = None) -> Tensor:
        """True where a return's intensity is below the threshold, in full response of the receiver, ``(B, N)``.

        Near the sensor, where the response rises, every return is faint by it: that says nothing of the calibration.

        Args:
            intensity, range_m, zero_intensity: as in ``signal_of_intensity``.
        """
        signal = self.signal_of_intensity(intensity, range_m, zero_intensity)
        if self.sensor.intensity_unit != "photons":
            response = self.beam.near_response(range_m)
            rising = (response > 0) & (response < 1)
            signal = torch.where(rising, signal / torch.where(rising, response, 1.0), signal)
            signal = torch.where(response > 0, signal, torch.inf)
        return (range_m > 0) & (signal < self.beam.threshold)

    def margin_law(self, range_m: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and end of the margin, ln of a signal over the threshold, ``(B, N)`` each; an end only where it is near.

        Args:
            range_m: ``(B, N)``.
        """
        ramp = self.beam.near_ramp(range_m)
        full = CALIBRATION_REFLECTIVITY / (math.pi * range_m.square()).clamp_min(NO_RANGE_M2) / self.beam.threshold
        end = torch.where(ramp < 1.0, full.log().clamp_min(0.0), torch.inf)
        return DB * self.margin_db / ramp.clamp_min(LEAST_RAMP), end

    def log_margin(self, range_m: Tensor, uniform: Tensor) -> Tensor:
        """ln of the least signal of a return over the threshold, ``(B, N)``.

        Args:
            range_m: ``(B, N)``.
            uniform: ``(B, N)`` the probability of a smaller one.
        """
        mean, end = self.margin_law(range_m)
        drawn = exponential(uniform.to(range_m))
        return torch.minimum(mean * drawn, torch.maximum(end, DB * self.margin_db * drawn))

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the objects' signals."""

        range_m, margin = state.scene.clear_range_m, noise["margin"]
        seen = range_m > 0
        floor = self.beam.threshold * torch.exp(self.log_margin(range_m, margin))
        given = self.signal_of_intensity(state.scene.points_in[..., 3], range_m, state.scene.zero_intensity)
        signal = torch.maximum(given, floor)
        signal = torch.where(seen, signal, 0.0)
        kind = torch.where(seen, OBJECT, LOST).to(torch.int8)
        return state.changed(
            clear_signal=signal,
            signal=signal[..., None],
            range_m=range_m[..., None],
            kind=kind[..., None],
            threshold=self.beam.threshold,
            sensor=self.sensor,
        )


def _single(intensity: Any) -> Tensor:
    return torch.as_tensor(intensity, dtype=torch.float32)


@lru_cache(maxsize=64)
def _falling_table(weather: Rain | Snow, wavelength_nm: float, published: bool) -> InterpolationTable:
    """Full extinction of rain or snow, 1/m, over the rate (the weather's own counts for nothing)."""

    def of_rate(rate: Tensor) -> Tensor:
        distribution = weather.distribution(rate)
        if published:
            distribution = distribution.within(*PUBLISHED_DOMAIN_MM)
        return extinction_per_m(distribution, wavelength_nm, temperature_c=weather.temperature_c)

    return InterpolationTable(of_rate, RATE_LOW_MM_PER_H, RATE_HIGH_MM_PER_H, RATE_NODES, zero_at_zero=True)


class _PartExtinction(nn.Module):
    """Effective extinction of one weather: ``alpha q_eff / 2``."""

    q_eff: Tensor

    def __init__(self, weather: Weather, sensor: Lidar, q_eff: float, *, koschmieder: bool, published: bool) -> None:
        super().__init__()
        self.weather, self.koschmieder = weather, koschmieder
        if isinstance(weather, Fog):
            self.optics = FogOptics(weather, float(sensor.wavelength_nm))
        elif isinstance(weather, (Rain, Snow)):
            at_rest = replace(weather, rate_mm_per_h=0.0)
            self.table = copy.deepcopy(_falling_table(at_rest, float(sensor.wavelength_nm), published))
        check_arguments("Extinction(q_eff: float)", q_eff)
        self.register_buffer("q_eff", torch.tensor(float(q_eff)))
        self.register_buffer(weather.intensity_name, torch.as_tensor(weather.intensity, dtype=torch.float32))

    def at_intensity(self, weather: Weather) -> _PartExtinction:
        """The same for a weather that differs by its intensity alone; tables are shared."""
        found = with_buffers(self, **{weather.intensity_name: _single(weather.intensity)})
        found.weather = weather
        return found

    def forward(self) -> Tensor:
        """1/m, of the intensity's shape flattened."""
        weather_intensity = getattr(self, self.weather.intensity_name).reshape(-1)
        full: Tensor
        if not isinstance(self.weather, Fog):
            full = self.table(weather_intensity)
        elif self.koschmieder:
            full = extinction_from_mor(weather_intensity, self.weather.contrast).to(weather_intensity)
        else:
            full = self.optics.extinction_per_m(weather_intensity)
        return full * (0.5 * self.q_eff)


@register
class Extinction(Stage):
    """The way through the weather and back: ``X exp(-2 alpha R)``, for every beam, with the extinctions added.

    Identity: rates 0, visibility infinite.

    Args:
        weathers: or their dictionaries.
        sensor: the LiDAR, or its dictionary.
        q_eff: extinction efficiency that the sensor sees, 1 (blocking only) to 2 (the whole forward lobe is lost);
            ``None`` is 1.1 for rain and snow, 2 for fog (``PHYSICS.md`` 3.2).
        fog_extinction: ``mie``, or ``koschmieder`` (ln(1/contrast) / MOR at the laser's wavelength too).
        variant: ``d3_4``: drops of 0.5-6 mm and half the extinction (the published pi/8).
    """

    default_name: ClassVar[str] = "extinction"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        *("air.beam_density", "air.density_scale", "air.patches", "air.path_density", "air.reach_m"),
        "returns.signal",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.extinction_per_m", "air.extra_m", "air.path_density", "returns.signal")
    each_beam_alone = True

    def __init__(
        self,
        weathers: Sequence[Weather | Mapping[str, Any]],
        sensor: Lidar | Mapping[str, Any],
        q_eff: float | None = None,
        fog_extinction: str = "mie",
        variant: str | None = None,
    ) -> None:
        check_arguments(
            "Extinction(weathers: Sequence, sensor: Lidar | Mapping, q_eff: float | None, fog_extinction: str, "
            "variant: str | None)",
            weathers,
            sensor,
            q_eff,
            fog_extinction,
            variant,
        )
        super().__init__()
        self.sensor = Lidar.of(sensor)
        if q_eff is not None:
            check_at_least("q_eff", q_eff, 0.0, owner=self)
        check_one_of("fog_extinction", fog_extinction, ("mie", "koschmieder"), owner=self)
        self.options = {"q_eff": q_eff, "fog_extinction": fog_extinction, "variant": variant}
        built = [w if isinstance(w, Weather) else weather_from_dict(w) for w in weathers]
        published = variant == "d3_4"
        self.parts = nn.ModuleDict()
        for weather in sorted(built, key=lambda part: part.kind):
            default = 1.0 if published else Q_EFF[weather.kind]
            self.parts[weather.kind] = _PartExtinction(
                weather,
                self.sensor,
                default if q_eff is None else q_eff,
                koschmieder=fog_extinction == "koschmieder",
                published=published,
            )

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        weathers = [part.weather.to_dict() for part in self.parts.values()]  # type: ignore[union-attr,operator]
        return {"weathers": weathers, "sensor": _config(self.sensor), **self.options}

    def at_intensity(self, weathers: Sequence[Weather]) -> Extinction:
        """The same stage for weathers that differ by their intensities alone; tables are shared."""
        found = with_buffers(self)
        parts = {one.kind: self.parts[one.kind].at_intensity(one) for one in weathers}  # type: ignore[operator]
        found.parts = nn.ModuleDict({kind: parts[kind] for kind in self.parts})
        return found

    def extinction_per_m(self, batch: int) -> Tensor:
        """Effective extinction of all weather together, 1/m, ``(B,)``."""
        parts = [part().expand(batch) for part in self.parts.values()]
        return torch.stack(parts).sum(0)

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the objects' signals weakened."""
        extinction = self.extinction_per_m(state.batch).to(state.returns.signal.dtype)
        if state.air.density_scale is not None:
            extinction = extinction * state.air.density_scale.to(extinction)
        if state.air.patches is not None:
            state = self._through_patches(state, state.air.patches)
        if state.air.beam_density is not None:
            own = (
                state.air.beam_density
                if state.air.path_density is None
                else state.air.path_density * state.air.beam_density
            )
            state = state.changed(path_density=own)
        clear = torch.exp(-2.0 * extinction[:, None] * state.uniform_m)
        return state.changed(signal=state.returns.signal * clear[..., None], extinction_per_m=extinction)

    def _through_patches(self, state: LidarState, patches: PatchField) -> LidarState:
        """The state with the mean density on each beam's way: of several weathers, weighted by what each takes."""
        parts: dict[str, _PartExtinction] = dict(self.parts.items())  # type: ignore[arg-type]
        takes = [part().expand(state.batch).to(state.returns.signal.dtype) for part in parts.values()]
        extra_m = mean_extra_m(patches, [part.weather for part in parts.values()], takes)
        azimuth_rad, level = _azimuth_and_level(state)
        # Patches are columns: the mean on a way that rises is that on its shadow.
        density = mean_density(extra_m, azimuth_rad, level * state.air.reach_m, patches.step_m)
        return state.changed(extra_m=extra_m, path_density=density)


@register
class ParticleReturns(Stage):
    """Returns of drops, flakes and fog in front of each object, or up to the maximum range where there is none.

    The strongest particles of each beam are drawn exactly without listing them all (``lidar/returns/strongest.py``):
    one where the sensor reports the strongest return, else so many that more are above threshold in one beam of 10,000.

    Identity: rates 0, visibility infinite.

    Args:
        weathers: or their dictionaries.
        sensor: the LiDAR, or its dictionary.
        q_back: backscatter efficiency of drops, ``"glints"``, or ``None`` for the default (``BeamParticles``).
        fog_backscatter: ``mie`` or ``hahner`` (``SoftReturn``).
        receiver: of fog's return, ``gate`` or ``matched`` (``SoftReturn``).
        variant: ``d3_4``: the published cylinder, drops and limit of detection; rain only.
    """

    default_name: ClassVar[str] = "particle_returns"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction", "scene.points_in"),
        "air.beam_density",
        "air.density_scale",
        "air.extinction_per_m",
        "air.extra_m",
        "air.patches",
        "air.reach_m",
        "air.size_factors",
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.extra_divergence_rad", "receiver.extra_near_full_m", "receiver.extra_near_power"),
    )
    writes: ClassVar[tuple[str, ...]] = (
        "returns.echo_speed_m_per_s",
        *("returns.kind", "returns.range_m", "returns.signal"),
    )
    each_beam_alone = True

    def __init__(
        self,
        weathers: Sequence[Weather | Mapping[str, Any]],
        sensor: Lidar | Mapping[str, Any],
        q_back: float | str | None = None,
        fog_backscatter: str = "mie",
        variant: str | None = None,
        receiver: str = "gate",
    ) -> None:
        check_arguments(
            "ParticleReturns(weathers: Sequence, sensor: Lidar | Mapping, q_back: float | str | None, "
            "fog_backscatter: str, variant: str | None)",
            weathers,
            sensor,
            q_back,
            fog_backscatter,
            variant,
        )
        super().__init__()
        self.sensor = Lidar.of(sensor)
        self.beam = Beam(self.sensor)
        self.options = {
            "q_back": q_back,
            "fog_backscatter": fog_backscatter,
            "variant": variant,
            "receiver": receiver,
        }
        built = [w if isinstance(w, Weather) else weather_from_dict(w) for w in weathers]
        self.parts = nn.ModuleDict()
        for weather in sorted(built, key=lambda part: part.kind):
            part: nn.Module
            if isinstance(weather, Fog):
                part = SoftReturn(weather, self.sensor, backscatter=fog_backscatter, receiver=receiver)
            elif isinstance(weather, (Rain, Snow)):
                given = q_back if isinstance(weather, Rain) else None
                part = BeamParticles(weather, self.sensor, q_back=given, published=variant == "d3_4")
            else:
                raise InputTypeError(
                    f"ParticleReturns: weathers must be Rain, Fog or Snow; got {type(weather).__name__}."
                )
            self.parts[weather.kind] = part
        self._last_tables: dict[str, tuple[list[Tensor], ReturnTable]] = {}

    def at_intensity(self, weathers: Sequence[Weather]) -> ParticleReturns:
        """The same stage for weathers that differ by their intensities alone; tables are shared."""
        found = with_buffers(self)
        parts = {one.kind: self.parts[one.kind].at_intensity(one, self.beam) for one in weathers}  # type: ignore[operator]
        found.parts = nn.ModuleDict({kind: parts[kind] for kind in self.parts})
        found._last_tables = {}
        return found

    @property
    def kinds(self) -> dict[str, BeamParticles | SoftReturn]:
        """Returning particles, by the kind of weather."""
        return dict(self.parts.items())  # type: ignore[arg-type]

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        weathers = [part.weather.to_dict() for part in self.kinds.values()]
        return {"weathers": weathers, "sensor": _config(self.sensor), **self.options}

    def variates(self) -> tuple[Variate, ...]:
        """Arrival and place of the strongest returns of each kind."""
        return tuple(variate for part in self.kinds.values() for variate in part.variates())

    def extra_repr(self) -> str:
        """Largest number of returns of each kind in a beam."""
        return ", ".join(f"{kind}_echoes={part.echoes}" for kind, part in self.kinds.items())

    def forward(self, state: LidarState, noise: Mapping[str, Tensor], *, faintest: Tensor | None = None) -> LidarState:
        """The state with an echo more for each return that a beam may have.

        Args:
            state, noise: as of every stage.
            faintest: signal below which an echo may be left out, for a chain that does not look at fainter ones.
        """
        extinction = state.air.extinction_per_m
        if extinction is None:
            extinction = torch.zeros(state.batch, dtype=state.returns.signal.dtype, device=state.returns.signal.device)
        ranges, signals = [state.returns.range_m], [state.returns.signal]
        extinction = extinction.to(self.beam.threshold.dtype)
        beam = self._beam(state)
        for kind, part in self.kinds.items():
            arrival, place = noise[f"{kind}_arrival"], noise[f"{kind}_place"]
            drawn = self._drawn if state.air.patches is None else self._drawn_in_patches
            range_m, signal = drawn(part, beam, extinction, arrival, place, state, faintest)
            ranges.append(range_m.to(state.returns.range_m.dtype))
            signals.append(signal.to(state.returns.signal.dtype))
        kinds = [state.returns.kind, *(torch.full_like(more, PARTICLE, dtype=torch.int8) for more in ranges[1:])]
        changed = {"range_m": _joined(ranges), "signal": _joined(signals), "kind": _joined(kinds)}
        if self.sensor.speed_column is not None:
            speeds = [torch.zeros_like(ranges[0])]
            for part, range_m, signal in zip(self.kinds.values(), ranges[1:], signals[1:], strict=True):
                speeds.append(self._speeds(part, beam, extinction, range_m, signal, state))
            changed["echo_speed_m_per_s"] = _joined(speeds)
        return state.changed(**changed)

    def _beam(self, state: LidarState, sectors: int = 1) -> Beam:
        """The beam as the particles of a state see it, of so many sectors a sample."""
        receiver, beam = state.receiver, self.beam
        if receiver.extra_divergence_rad is not None:
            beam = beam.widened(receiver.extra_divergence_rad.repeat_interleave(sectors, 0))
        if receiver.extra_near_full_m is not None and receiver.extra_near_power is not None:
            near = receiver.extra_near_full_m, receiver.extra_near_power
            beam = beam.fainter_near(*(value.repeat_interleave(sectors, 0) for value in near))
        return beam

    def _speeds(
        self,
        part: BeamParticles | SoftReturn,
        beam: Beam,
        extinction: Tensor,
        range_m: Tensor,
        signal: Tensor,
        state: LidarState,
    ) -> Tensor:
        """Radial speed over the ground, ``(B, N, echoes)``: wind and fall along the beam; fog drifts with the wind."""
        along = vehicle_directions(state, self.sensor)
        speed = (along @ along.new_tensor(self._wind_m_per_s(part.weather)))[..., None].expand_as(range_m)
        if not isinstance(part, BeamParticles):
            return speed
        falls = []
        for echo in range(range_m.shape[-1]):
            own = (range_m[..., echo].to(extinction), signal[..., echo].to(extinction))
            outline_m = part.outline_m(beam, *own, extinction, state.air.density_scale)
            falls.append(part.fall_speed_m_per_s(outline_m).to(along))
        return speed - torch.stack(falls, -1) * along[..., 2:]

    def _wind_m_per_s(self, weather: Weather) -> tuple[float, float, float]:
        """Wind of a weather; fog drifts with that of the rain or snow beside it."""
        winds = [
            getattr(one, "wind_m_per_s", None) for one in (weather, *(part.weather for part in self.kinds.values()))
        ]
        return next((wind for wind in winds if wind is not None), (0.0, 0.0, 0.0))

    def _drawn(
        self,
        part: BeamParticles | SoftReturn,
        beam: Beam,
        extinction: Tensor,
        arrival: Tensor,
        place: Tensor,
        state: LidarState,
        faintest: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """Range and signal, ``(B, N, echoes)``; 0 where there is no such return."""
        reach_m = state.air.reach_m.to(extinction.dtype)
        reach, start = part.grid.position(reach_m), part.start(reach_m)
        density, sizes = state.air.density_scale, state.air.size_factors
        table = self._table(part, beam, extinction, density, sizes) if start is None else None
        between = None if table is not None else part.between(beam, extinction, density, sizes=sizes)

        if table is not None and not is_exporting():
            own = (table, state.air.beam_density, faintest)
            used = (state.air.reach_m, arrival, place, table.signal, table.share, table.place, *own[1:])
            drawn = compiled_echoes if compiles(part, used) else _echoes_of_table
            return drawn(part, beam, reach_m, arrival, place, *own)

        def strongest(arrived: Tensor, own_place: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            if table is not None:
                return table.strongest_before(arrived, own_place, reach)
            assert between is not None
            return strongest_before(between, arrived, own_place, reach, start)

        return _echoes(part, beam, reach_m, arrival, place, strongest, state.air.beam_density)

    def _drawn_in_patches(
        self,
        part: BeamParticles | SoftReturn,
        beam: Beam,
        extinction: Tensor,
        arrival: Tensor,
        place: Tensor,
        state: LidarState,
        faintest: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """As ``_drawn``, each beam in the air of its sector, level with the ground."""
        assert state.air.patches is not None
        banks = state.air.patches.banks(part.weather)
        way_m = (
            torch.zeros_like(banks.extra_m) if state.air.extra_m is None else state.air.extra_m
        )  # of all weather together
        air = Banks(banks.density.to(extinction), way_m.to(extinction), banks.step_m).of_sectors()

        def each(values: Tensor | None) -> Tensor | None:
            return None if values is None else values.repeat_interleave(SECTORS, 0)

        beam = self._beam(state, SECTORS)
        own = (state.air.density_scale, air, state.air.size_factors)
        of_sectors = (beam, extinction.repeat_interleave(SECTORS, 0), each(own[0]), own[1], each(own[2]))
        between, places = part.tables(*of_sectors)
        sector = sector_of(_azimuth_and_level(state)[0])
        reach_m = state.air.reach_m.to(extinction.dtype)
        reach = part.grid.position(reach_m)

        def strongest(arrived: Tensor, own_place: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            return strongest_before(between, arrived, own_place, reach, None, places, sector, SECTORS)

        return _echoes(part, beam, reach_m, arrival, place, strongest, state.air.beam_density)

    def table_of(self, kind: str, extinction: Tensor) -> ReturnTable:
        """The table of a kind of weather without effects on the air, by compiled loops, to rounding.

        Args:
            kind: of the weather.
            extinction: ``(B,)`` of all weather together, 1/m.
        """
        part, extinction = self.kinds[kind], extinction.to(self.beam.threshold.dtype)

        def solved(own: Tensor) -> ReturnTable:
            if isinstance(part, BeamParticles):
                return ReturnTable.compiled(part.compiled_between(self.beam, own))
            return ReturnTable.compiled(*part.compiled_tables(self.beam, own))

        inputs = [extinction, *part.parameters_of_table(), *self.beam.buffers()]
        return self._kept_table(f"{kind} compiled", inputs, solved)

    def _table(
        self,
        part: BeamParticles | SoftReturn,
        beam: Beam,
        extinction: Tensor,
        density: Tensor | None,
        sizes: Tensor | None = None,
    ) -> ReturnTable:
        """The table at this weather and sensor; the last one is kept while nothing it depends on has changed."""
        inputs = [extinction, *part.parameters_of_table(), *beam.buffers()]
        inputs += [value for value in (density, sizes) if value is not None]

        def solved(own: Tensor) -> ReturnTable:
            of_air = (beam, own, density)
            if isinstance(part, BeamParticles) and compiles(part, (*inputs, own)):
                return ReturnTable.compiled(part.compiled_between(*of_air, sizes=sizes))
            return ReturnTable.of(*part.tables(*of_air, sizes=sizes))

        if is_exporting() or any(value.requires_grad for value in inputs):
            return solved(extinction)
        return self._kept_table(part.kind, inputs, solved, is_uniform=density is None and sizes is None)

    def _kept_table(
        self,
        name: str,
        inputs: Sequence[Tensor],
        solved: Callable[[Tensor], ReturnTable],
        *,
        is_uniform: bool = True,
    ) -> ReturnTable:
        """The last table of a name, solved anew where something it depends on has changed.

        Args:
            name: of the table.
            inputs: what it depends on; the first is the extinction.
            solved: the table at an extinction.
            is_uniform: no effect gives the samples of a batch an air of their own.
        """
        extinction = inputs[0]
        before, table = self._last_tables.get(name, (None, None))
        if before is None or table is None or len(before) != len(inputs) or not all(map(_same, before, inputs)):
            shared = is_uniform and all(value.numel() == 1 for value in inputs[1:]) and _all_alike(extinction)
            with torch.no_grad():
                # One table serves all samples that are in the same weather.
                table = solved(extinction[:1] if shared else extinction)
            table = table.expanded(len(extinction)) if shared else table
            self._last_tables[name] = ([value.clone() for value in inputs], table)
        return table


def _echoes(
    part: BeamParticles | SoftReturn,
    beam: Beam,
    reach_m: Tensor,
    arrival: Tensor,
    place: Tensor,
    strongest: Callable[[Tensor, Tensor], tuple[Tensor, Tensor, Tensor]],
    density: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Range and signal, ``(B, N, echoes)``, of the strongest, the next strongest and so on; 0 where there is none.

    Args:
        part: what returns.
        beam: the sensor's.
        reach_m: ``(B, N)`` up to which it counts.
        arrival, place: ``(B, echoes, N)`` its variates.
        strongest: solves for signal, range and whether there is one, as ``strongest_before`` gives them.
        density: ``(B, N)`` of each beam over that of the weather; ``None`` is 1.
    """
    ranges, signals = [], []
    arrived = torch.zeros_like(reach_m)
    counted, own, per_density = _of_density(part, density, reach_m)
    for echo in range(part.echoes):
        arrived = arrived + exponential(arrival[:, echo].to(reach_m))
        reached = arrived if per_density is None else arrived * per_density
        row, column, exists = strongest(reached, place[:, echo].to(reach_m))
        signal = part.signal_at(row, beam) * exists
        ranges.append(torch.minimum(part.grid.range_m(column), reach_m) * exists)
        signals.append(signal if own is None or counted else signal * own)
    return torch.stack(ranges, 1).transpose(1, 2), torch.stack(signals, 1).transpose(1, 2)


def _of_density(
    part: BeamParticles | SoftReturn, density: Tensor | None, like: Tensor
) -> tuple[bool, Tensor | None, Tensor | None]:
    """Kind of a beam's density (of particles or not), the density, and the factor of its arrivals."""
    # d times as many particles: d Lambda = E. Fog is no list of particles; of it there is d times the light.
    counted = isinstance(part, BeamParticles)
    own = None if density is None else density.to(like)
    return counted, own, None if own is None or not counted else own.clamp_min(THINNEST).reciprocal()


def _echoes_of_table(
    part: BeamParticles | SoftReturn,
    beam: Beam,
    reach_m: Tensor,
    arrival: Tensor,
    place: Tensor,
    table: ReturnTable,
    density: Tensor | None,
    faintest: Tensor | None,
) -> tuple[Tensor, Tensor]:
    """As ``_echoes``, read from a table; no more echoes than any beam has, and of each only the beams that have it.

    A beam without a strongest particle has no next strongest.

    Args:
        part, beam, reach_m, arrival, place, density: as of ``_echoes``.
        table: the solutions.
        faintest: signal of the faintest echo that counts; ``None`` counts every echo of the table.
    """
    of_samples = [
        _echoes_of_beams(
            part,
            beam,
            reach_m[sample],
            arrival[sample],
            place[sample],
            table.of_sample(sample),
            None if density is None else density[sample if len(density) > 1 else 0],
            faintest,
        )
        for sample in range(len(reach_m))
    ]
    most = max((len(ranges) for ranges, _ in of_samples), default=1)
    if not of_samples:
        nothing = reach_m.new_zeros(0, reach_m.shape[1], 1)
        return nothing, nothing
    nothing = torch.zeros_like(reach_m[0])
    joined = [
        torch.stack([torch.stack([*echoes, *[nothing] * (most - len(echoes))]) for echoes in each])
        for each in zip(*of_samples, strict=True)
    ]
    return joined[0].transpose(1, 2), joined[1].transpose(1, 2)


def _echoes_of_beams(
    part: BeamParticles | SoftReturn,
    beam: Beam,
    reach_m: Tensor,
    arrival: Tensor,
    place: Tensor,
    table: ReturnTable,
    density: Tensor | None,
    faintest: Tensor | None,
) -> tuple[list[Tensor], list[Tensor]]:
    """Ranges and signals ``(N,)`` of each echo of one sample; the first always, the others where a beam has one.

    Args:
        part, beam, table, faintest: as of ``_echoes_of_table``.
        reach_m, density: ``(N,)``.
        arrival, place: ``(echoes, N)``.
    """
    counted, own, per_density = _of_density(part, density, reach_m)
    reach = part.grid.position(reach_m)
    alive: Tensor | None = None  # the beams that had the echo before; None is all
    arrived = torch.zeros_like(reach_m)
    ranges: list[Tensor] = []
    signals: list[Tensor] = []
    for echo in range(part.echoes):
        within, far_m = _at(reach, alive), _at(reach_m, alive)
        arrived = arrived + exponential(_at(arrival[echo], alive).to(reach_m))
        reached = arrived if per_density is None else arrived * _at(per_density, alive)
        row = table.signal_before(reached[None], within[None])[0]
        exists = row > 0.0
        signal = part.signal_at(row.clamp_min(0.0), beam) * exists
        signal = signal if own is None or counted else signal * _at(own, alive)
        here = (exists if faintest is None else exists & (signal >= faintest)).nonzero()[:, 0]
        if ranges and not len(here):
            break
        alive = here if alive is None else alive[here]
        row, signal, arrived = row[here], signal[here], arrived[here]
        drawn = _at(place[echo], alive).to(reach_m)
        column = table.place_before(row[None], drawn[None], within[here][None])[0]
        range_m = torch.minimum(part.grid.range_m(column), far_m[here])
        ranges.append(torch.zeros_like(reach_m).index_copy(0, alive, range_m))
        signals.append(torch.zeros_like(reach_m).index_copy(0, alive, signal.to(reach_m)))
    return ranges, signals


def _at(values: Tensor, beams: Tensor | None) -> Tensor:
    return values if beams is None else values[beams]


def _all_alike(values: Tensor) -> bool:
    return len(values) > 0 and torch.equal(values, values[:1].expand_as(values))


def _same(one: Tensor, other: Tensor) -> bool:
    return one.device == other.device and one.dtype == other.dtype and torch.equal(one, other)


def _joined(echoes: Sequence[Tensor]) -> Tensor:
    """Echoes ``(B, N, E)`` of several kinds in one tensor, each echo by itself in memory."""
    return torch.cat([echo.transpose(1, 2) for echo in echoes], 1).transpose(1, 2)


@register
class Detection(SensorStage):
    """Detection of the receiver: echoes above threshold, merged where they are close, chosen by the return mode.

    An echo within ``echo_separation_m`` of a stronger one is part of that one. An object nearer than ``near_start_m``
    has nothing in front of it and is always reported, as it was in the input.

    Identity: none; where nothing was weakened and nothing added, every object is reported.

    Args:
        sensor: the LiDAR, or its dictionary; its ``return_mode`` decides.
    """

    default_name: ClassVar[str] = "detection"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.clear_range_m",
        *("returns.echo_speed_m_per_s", "returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = (
        "returns.echo_speed_m_per_s",
        *("returns.kind", "returns.range_m", "returns.signal"),
    )

    @property
    def return_mode(self) -> str:
        """Return mode: the echoes that the sensor reports."""
        return self.sensor.return_mode

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the reported echoes: one, or two of a dual-return sensor."""
        returns, clear_m = state.returns, state.scene.clear_range_m
        if returns.echo_speed_m_per_s is None and is_plain(
            returns.range_m, returns.signal, state.detected_from, clear_m
        ):
            found = chosen_echoes(
                returns.range_m, returns.signal, returns.kind, state.detected_from, clear_m, self.sensor
            )
            return state.changed(**dict(zip(("range_m", "signal", "kind"), found, strict=True)))
        every = [state.returns.range_m, state.returns.signal, state.returns.kind]
        if (speed := state.returns.echo_speed_m_per_s) is not None:
            more = state.returns.range_m.shape[-1] - speed.shape[-1]
            every.append(torch.nn.functional.pad(speed, (0, more)) if more else speed)
        echoes = [_Echoes(*parts) for parts in zip(*(values.unbind(-1) for values in every), strict=True)]
        chosen = self._chosen_of(echoes, state.detected_from, state.scene.clear_range_m)
        columns = zip(*(echo.parts for echo in chosen), strict=True)
        names = ("range_m", "signal", "kind", "echo_speed_m_per_s")
        joined = [torch.stack(values, 1).transpose(1, 2) for values in columns]
        return state.changed(**dict(zip(names, joined, strict=False)))

    def _chosen_of(self, echoes: Sequence[_Echoes], threshold: Tensor, clear_range_m: Tensor) -> list[_Echoes]:
        """The reported echoes. Beams in which nothing but the object is seen, most of them, have no choice."""
        if is_exporting() or len(echoes) == 1:
            return self._chosen(echoes, threshold, clear_range_m)
        particles = echoes[1].signal >= threshold
        for echo in echoes[2:]:
            particles = particles | (echo.signal >= threshold)
        beams = particles.reshape(-1).nonzero()[:, 0]
        if 2 * len(beams) > particles.numel():
            return self._chosen(echoes, threshold, clear_range_m)
        alone = self._chosen(echoes[:1], threshold, clear_range_m)
        if not len(beams):
            return alone
        own = threshold.expand_as(clear_range_m).reshape(-1)[beams] if threshold.ndim else threshold
        among = [_Echoes(*(part.reshape(-1)[beams] for part in echo.parts)) for echo in echoes]
        found = self._chosen(among, own, clear_range_m.reshape(-1)[beams])
        return [
            _Echoes(
                *(
                    whole.reshape(-1).index_copy(0, beams, some.to(whole)).reshape(whole.shape)
                    for whole, some in zip(one.parts, other.parts, strict=True)
                )
            )
            for one, other in zip(alone, found, strict=True)
        ]

    def _chosen(self, echoes: Sequence[_Echoes], threshold: Tensor, clear_range_m: Tensor) -> list[_Echoes]:
        """The reported echoes of some beams: one, or two of a dual-return sensor; the object's echo is the first."""
        zero = torch.zeros_like(clear_range_m)
        # Strength decides; 0 is an echo that is not seen.
        strengths = [torch.where(echo.signal >= threshold, echo.signal, 0.0) for echo in echoes]
        # An object without any signal is one that an effect has taken away.
        near = (clear_range_m > 0) & (clear_range_m < self.sensor.near_start_m) & (echoes[0].signal > 0)
        strengths[0] = torch.where(near, torch.inf, strengths[0])
        strongest = _best(strengths, echoes)
        if self.return_mode == "strongest":
            return [strongest]
        strengths = self._merged([echo.range_m for echo in echoes], strengths)
        power = -1.0 if self.return_mode == "first" else 1.0
        scores = [
            torch.where(strength > 0, echo.range_m**power, zero)
            for strength, echo in zip(strengths, echoes, strict=True)
        ]
        end = _best(scores, echoes)
        if self.return_mode != "dual":
            return [end]
        # One echo is reported once: a beam whose strongest echo is its last has no second return.
        again = end.range_m == strongest.range_m
        second = [torch.where(again, x, y) for x, y in zip(_nothing(end), end.parts, strict=True)]
        return [strongest, _Echoes(*second)]

    def _merged(self, ranges: Sequence[Tensor], strengths: Sequence[Tensor]) -> list[Tensor]:
        """Strengths with 0 for every echo that is part of a stronger one."""
        apart = self.sensor.echo_separation
        merged = []
        for k, (range_m, strength) in enumerate(zip(ranges, strengths, strict=True)):
            absorbed = torch.zeros_like(strength, dtype=torch.bool)
            for other, (other_range, other_strength) in enumerate(zip(ranges, strengths, strict=True)):
                if other != k:
                    # Of two equal echoes the earlier in the list counts as the stronger.
                    stronger = other_strength >= strength if other < k else other_strength > strength
                    absorbed = absorbed | (stronger & ((other_range - range_m).abs() < apart))
            merged.append(torch.where(absorbed, torch.zeros_like(strength), strength))
        return merged


@dataclass(frozen=True)
class _Echoes:
    """One echo of each beam; its speed where the sensor measures it."""

    range_m: Tensor
    signal: Tensor
    kind: Tensor
    speed_m_per_s: Tensor | None = None

    @property
    def parts(self) -> tuple[Tensor, ...]:
        known = (self.range_m, self.signal, self.kind)
        return known if self.speed_m_per_s is None else (*known, self.speed_m_per_s)


def _nothing(like: _Echoes) -> tuple[Tensor, ...]:
    return tuple(torch.full_like(part, LOST) if part is like.kind else torch.zeros_like(part) for part in like.parts)


def _best(scores: Sequence[Tensor], echoes: Sequence[_Echoes]) -> _Echoes:
    """The echo of the highest score in each beam, the first of equals; none where all scores are 0."""
    best, found = scores[0], echoes[0].parts
    for score, echo in zip(scores[1:], echoes[1:], strict=True):
        better = score > best
        found = tuple(torch.where(better, new, old) for new, old in zip(echo.parts, found, strict=True))
        best = torch.maximum(best, score)
    none = best <= 0
    range_m, signal, kind, *speed = found
    return _Echoes(
        torch.where(none, 0.0, range_m),
        torch.where(none, 0.0, signal),
        torch.where(none, LOST, kind).to(torch.int8),
        *(torch.where(none, 0.0, one) for one in speed),
    )


@register
class ToPoints(SensorStage):
    """Points of the reported echoes: along the beam, in the unit of the input's intensity.

    What no stage touched comes out with the input's own bits. A particle's intensity is that of its equivalent
    reflectivity ``pi X R^2``; its range gets the sensor's noise and resolution.

    Identity: untouched echoes.

    Args:
        sensor: the LiDAR, or its dictionary.
    """

    default_name: ClassVar[str] = "to_points"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.borrowed_intensity", "scene.clear_range_m", "scene.clear_signal", "scene.empty_direction"),
        *("scene.integral", "scene.points_in"),
        *("returns.kind", "returns.range_m", "returns.signal"),
        "receiver.threshold",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.points", "returns.second")
    photons_at_threshold: Tensor
    range_noise_m: Tensor

    def __init__(self, sensor: Lidar | Mapping[str, Any]) -> None:
        check_arguments("ToPoints(sensor: Lidar | Mapping)", sensor)
        super().__init__(sensor)
        self.register_buffer("photons_at_threshold", torch.tensor(float(self.sensor.photons_at_threshold)))
        self.register_buffer("range_noise_m", torch.tensor(float(self.sensor.range_noise_m)))
        self.reported = 2 if self.sensor.return_mode == "dual" else 1

    def variates(self) -> tuple[Variate, ...]:
        """Range noise of the reported echoes, where the sensor has any."""
        if self.sensor.range_noise_m == 0:
            return ()
        return (Variate("range_noise", "normal", (self.reported, "N")),)

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the points that go out."""
        drawn = noise.get("range_noise")
        noises = [None if drawn is None else drawn[:, echo] for echo in range(state.returns.range_m.shape[-1])]
        second = None
        if len(noises) > 1:
            second = self._cloud(state, 1, noises[1]) if is_exporting() else self._second(state, noises[1])
        return state.changed(points=self._cloud(state, 0, noises[0]), second=second)

    def _second(self, state: LidarState, noise: Tensor | None) -> Tensor:
        """Points of the second echo as of ``_cloud``, worked out for the beams that have one; most have none."""
        scene, clear = state.scene, state.scene.clear_range_m
        sample, beam = (state.returns.kind[..., 1] != LOST).nonzero(as_tuple=True)
        if 2 * len(beam) > clear.numel():
            return self._cloud(state, 1, noise)

        def own(values: Tensor) -> Tensor:
            """Values ``(B or 1, N or 1, ...)`` of these beams, each a sample, ``(beams, 1, ...)``."""
            return values.expand(*clear.shape, *values.shape[2:])[sample, beam][:, None]

        known = {name: own(value) for name in OF_POINTS if (value := getattr(scene, name)) is not None}
        echo = {name: own(getattr(state.returns, name)[..., 1:]) for name in ("range_m", "signal", "kind")}
        found = self._cloud(state.changed(**known, **echo), 0, None if noise is None else own(noise))
        # A beam without the echo: 0, or what came with it where it was empty.
        points = scene.points_in
        whole = torch.cat([torch.where(clear[..., None] > 0, 0.0, points[..., :4]), points[..., 4:]], -1)
        return whole.index_put((sample, beam), found[:, 0])

    def _measured(self, range_m: Tensor, noise: Tensor | None) -> Tensor:
        """Range of a particle as the sensor measures it."""
        if noise is not None:
            range_m = (range_m + self.range_noise_m * noise.to(range_m)).clamp_min(0.0)
        step = self.sensor.range_resolution_m
        return torch.round(range_m / step) * step if step > 0 else range_m

    def measurement(self, state: LidarState, noise: Mapping[str, Tensor], echo: int = 0) -> tuple[Tensor, Tensor]:
        """Range, metres, and intensity ``(B, N)`` of one reported echo; 0 and 0 where there is none.

        What no stage touched has the input's own intensity.
        """
        drawn = noise.get("range_noise")
        scene, own = state.scene, None if drawn is None else drawn[:, echo]
        of_clear = scene.clear_range_m, scene.clear_signal
        given = scene.points_in, scene.borrowed_intensity
        if is_plain(state.returns.range_m, state.returns.signal, state.receiver.threshold, own, *of_clear, *given):
            returns = state.returns
            of_echo = returns.range_m[..., echo], returns.signal[..., echo], returns.kind[..., echo]
            return read_echoes(of_echo, of_clear, *given, own, scene.integral, state.receiver.threshold, self.sensor)
        range_m, value, lost = self._out(state, own, echo)
        return torch.where(lost, 0.0, range_m), torch.where(lost, 0.0, value)

    def _out(self, state: LidarState, noise: Tensor | None, echo: int) -> tuple[Tensor, Tensor, Tensor]:
        """Range and intensity of one reported echo, and where there is none, ``(B, N)`` each."""
        clear = state.scene.clear_range_m
        range_m, signal, kind = (
            state.returns.range_m[..., echo],
            state.returns.signal[..., echo],
            state.returns.kind[..., echo],
        )
        particle, lost = kind == PARTICLE, kind == LOST
        gain = signal / torch.where(clear > 0, state.scene.clear_signal, 1.0)
        unit, intensity, integral = self.sensor.intensity_unit, state.scene.points_in[..., 3], state.scene.integral
        dimmed, borrowed = dimmed_intensity(intensity, gain, unit, integral), state.scene.borrowed_intensity
        per_signal = self.photons_at_threshold / state.receiver.threshold
        if is_exporting():
            range_m = torch.where(particle, self._measured(range_m, noise), range_m)
            returned = borrowed
            if returned is None:
                returned = intensity_from_signal(signal, range_m, unit, integral, per_signal)
            return range_m, torch.where(particle, returned, dimmed), lost
        # Particles are few: what they return is worked out for them alone.
        beams = particle.nonzero(as_tuple=True)
        measured_m = self._measured(range_m[beams], None if noise is None else noise[beams])
        if borrowed is None:
            whole = integral.expand_as(range_m)[beams]
            returned = intensity_from_signal(signal[beams], measured_m, unit, whole, per_signal)
        else:
            returned = borrowed[beams]
        return range_m.index_put(beams, measured_m), dimmed.index_put(beams, returned.to(dimmed)), lost

    def _cloud(self, state: LidarState, echo: int, noise: Tensor | None) -> Tensor:
        """Points ``(B, N, C)`` of one reported echo."""
        points, clear = state.scene.points_in, state.scene.clear_range_m
        range_m, value, lost = self._out(state, noise, echo)
        seen = clear > 0
        gone = lost & seen
        # 1 for an object that stayed where it was, and for a beam that was empty and stayed so.
        scale = torch.where(lost, 1.0, range_m / torch.where(seen, clear, 1.0))
        columns = list(points[..., :3].unbind(-1))  # one by one: several times faster than under a mask of one column
        if state.scene.empty_direction is not None:
            along = state.scene.empty_direction.to(points).unbind(-1)
            here = seen | lost
            columns = [torch.where(here, own, given) for own, given in zip(columns, along, strict=True)]
        columns = [torch.where(gone, 0.0, column * scale) for column in columns]
        # A beam that was empty and stayed so keeps what it came with.
        value = torch.where(gone, 0.0, torch.where(lost, points[..., 3], value))
        return torch.stack([*columns, value, *points[..., 4:].unbind(-1)], -1)
