"""LidarRain, LidarFog, LidarSnow: weather on the point cloud of a LiDAR."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.density_field import PatchyAir, patchy_air
from torchweather.atmosphere.weather import CLEAR_AIR, Snow, Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputValueError, check_one_of
from torchweather.core.precision import outside_autocast
from torchweather.core.threads import one_thread_an_operation
from torchweather.lidar import compiled
from torchweather.lidar.beams import COMPLETE_SCAN, BeamFinder, Beams
from torchweather.lidar.cloud_frame import directions_in_sensor_frame, points_in_cloud_frame
from torchweather.lidar.clouds import check_points
from torchweather.lidar.conditions import lidar_conditions
from torchweather.lidar.doppler import RadialSpeed
from torchweather.lidar.expected_detection import expected_detection
from torchweather.lidar.faintest_echo import through_stages
from torchweather.lidar.frame_check import warn_of_frame
from torchweather.lidar.intensity import are_integers, borrowed_intensity, zero_intensity
from torchweather.lidar.options import LidarOptions
from torchweather.lidar.returns.soft_return import SoftReturn
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.lidar.state import LidarState
from torchweather.lidar.sweep.beam_ends import BeamEnd
from torchweather.lidar.sweep.own_vehicle import OwnVehicleMask, checked_own_vehicle
from torchweather.physics import SNOW_PACK_REFLECTIVITY
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.conditions import with_conditions
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.module_copy import with_buffers
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.sensor_transform import WeatherTransform
from torchweather.pipeline.tiling import is_exporting

__all__ = ["LidarFog", "LidarRain", "LidarResult", "LidarSnow", "LidarWeather"]

VARIANTS = ("d3_4",)
LOST_AS = ("zero", "nan", "drop")
BEAM_ENDS = ("scene", "max_range")
BEAMS_AT_ONCE = 1 << 19  # arrays of 2 MB
PLAIN = {ToEnergy, Extinction, ParticleReturns, Detection, ToPoints}
Cloud = Tensor | list[Tensor]


@dataclass(frozen=True)
class LidarResult:
    """Effect of the weather on a cloud. With ``lost="drop"`` the clouds of a batch are lists, one entry a sample.

    Args:
        points: ``(..., N, C)`` the cloud, in the columns and the dtype of the input.
        kind: ``(..., N)`` int8, ``PointKind`` of each point: OBJECT 0, PARTICLE 1, LOST 2 (no return: lost, or empty
            in the input).
        source: ``(..., N)`` row of the input that the beam belongs to; -1 for a beam that ``complete_scan`` appended.
        transmission: ``(..., N)`` two-way transmission of the weather to the object of each beam (to the maximum range
            where there is none).
        second: ``(..., N, C)`` second returns of a dual-return sensor (the last echo, where it is not the strongest);
            ``None`` in the other modes.
        second_source: ``(..., N)`` row of the input that the second return's beam belongs to, -1 where there is none.
        second_kind: ``(..., N)`` ``PointKind`` of the second returns.
        beam_end: ``(..., N)`` int8, ``lidar.BeamEnd`` of each beam: RETURN 0, and of those without a return SKY 1,
            GROUND 2, OWN_VEHICLE 3, OBSTACLE 4, or UNKNOWN 5 where the direction is not known. Particles lie before it.
        beam_end_counts: ``(..., 6)`` how many beams of the cloud, with appended ones, end at each ``BeamEnd``.
        empty_beams: ``(...)`` rows without return in the input (with those that ``complete_scan`` appended).
        floored_points: ``(...)`` returns whose intensity says less than the detection threshold, in full response of
            the receiver; they were detected, so they stand on it.
        scan: how beams without return were treated, in words.
        own_vehicle_points: ``(...)`` returns on the own vehicle, which no weather reaches; ``None`` where it is not
            known (`LidarWeather`, ``own_vehicle``).
    """

    points: Cloud
    kind: Cloud
    source: Cloud
    transmission: Cloud
    second: Cloud | None
    second_source: Cloud | None
    second_kind: Cloud | None
    beam_end: Cloud | None
    beam_end_counts: Tensor | None
    empty_beams: Tensor
    floored_points: Tensor
    scan: str
    own_vehicle_points: Tensor | None = None

    sensor: ClassVar[str] = "lidar"


class _OwnNoise(dict[str, Tensor]):
    """Noise that a call has drawn for itself: its numbers are not checked again."""


class LidarWeather(WeatherTransform):
    """Weather on LiDAR point clouds, organised or not.

    The signal of each object follows from its intensity and weakens with the extinction of the weather, on the way out
    and back. Drops, flakes and fog in the beam return light of their own; the receiver reports what its return mode
    picks from everything above its threshold.

    Args:
        weather: ``Rain``, ``Fog``, ``Snow`` or a ``Mixture`` of them, with water or snow on things
            (``torchweather.atmosphere.conditions``) or without. ``None``: that of the ``Compose`` around it.
        sensor: the LiDAR.
        q_eff: extinction efficiency that the sensor sees; ``None`` is 1.1 for rain and snow and 2 for fog.
        q_back: backscatter efficiency of raindrops; ``None`` is 0.2 (0.06 at 1550 nm), ``"glints"`` the lower bound
            0.094; 0.6 is the upper end of what is plausible.
        fog_extinction: ``mie`` or ``koschmieder`` (ln 20 / MOR at every wavelength).
        fog_backscatter: ``mie`` or ``hahner`` (0.046 / MOR).
        receiver: how the receiver filters the light of fog: ``gate`` (light of a flash in a gate of the pulse's shape)
            or ``matched`` (the pulse answered with the pulse): 4/3 of the signal, near the threshold twice as many
            false returns or more. Which one a sensor has is seldom published.
        lost: lost points become ``zero`` rows (further columns stay), ``nan``, or are left out (``drop``).
        complete_scan: infer the beams without return that an unorganised cloud lacks from the sensor's scan pattern,
            and where they end: on the ground, the own vehicle, an obstacle, or in the sky. ``"sky"`` appends only those
            that end in the sky.
        beam_ends: where a beam without return ends whose direction is known. ``scene``: where the sweep says, on the
            ground, the own vehicle, an obstacle, or in the sky (``torchweather.lidar.beam_ends``); ``max_range``: at
            the sensor's maximum range, through whatever is there.
        own_vehicle: the vehicle that carries the sensor. Returns on it are objects and come back bit for bit, with no
            particle before them. Three forms. An `OwnVehicleMask` of a drive (``lidar.own_vehicle_mask``) or its
            ``.npz`` file: a return is the vehicle's in a cell of its body within 0.15 m of the body's range, so a
            person in front of it or beside it is not; ``complete_scan`` ends the beams that it blocks on it. A box of
            the body: x from, x to, y from, y to, z from, z to, metres in the sensor's frame; every return inside is the
            vehicle's, so measure the body and add nothing. ``None``: one sweep does not show which returns are the
            vehicle's, so they are weathered as objects. Rows nearer than the sensor's ``min_range_m`` hold no return
            in any case (nuScenes: 1 m).
        variant: ``d3_4``: rain as the deliverable published it (``PHYSICS.md`` 8). ``hahner``: as Hahner et al.
            published it: fog with ``fog_backscatter="hahner", fog_extinction="koschmieder"``, snow with flakes of 0.9,
            the reflectivity of a snow pack.
        ego_speed_m_per_s: speed of the vehicle, forward; what a Doppler LiDAR (``Lidar.speed_column``) measures of
            particles. Speeds of objects come with the cloud (``torchweather.lidar.static_speed_m_per_s``).
        effects: of ``stages.EFFECTS`` for LiDAR, or their dictionaries; each goes to its place in the chain.
        p: probability that a sample gets the weather; the others come back as they are.

    What is not known may be a distribution, drawn for each sample: ``q_eff``, ``q_back``, ``fog_extinction``,
    ``fog_backscatter``, ``receiver``, ``ego_speed_m_per_s``, parameters of effects (``lidar.threshold_shift``), and
    fields of the sensor that ``Lidar.drawable`` names, such as ``near_full_m``.
    ``docs/how-to/draw-what-is-not-known.md`` gives ranges and what they cost.

    Note:
        Single scattering. The beam is uniform inside its cone. Rows without return are simulated only where their
        direction is known: ``Lidar(directions=...)``, ``directions=`` at the call, or ``complete_scan``.

    References:
        PHYSICS.md 5.

    Example:
        >>> from torchweather.atmosphere.weather import Fog, Mixture, Rain
        >>> lidar = LidarWeather(Mixture(Rain(10), Fog(mor_m=200)), Lidar.preset("velodyne-hdl-64e"))
        >>> points = torch.tensor([[20.0, 0.0, 0.0, 120.0], [0.0, 80.0, 1.0, 9.0]])
        >>> lidar(points).shape
        torch.Size([2, 4])
    """

    takes_all: ClassVar[str] = "LidarWeather"
    sensor_class: ClassVar[type[Lidar]] = Lidar
    extra_inputs: ClassVar[Mapping[str, int]] = {"directions": 2}
    data_shape = ("N", "4 or more")

    def __init__(
        self,
        weather: Weather | None,
        sensor: Lidar,
        *,
        q_eff: float | Distribution | None = None,
        q_back: float | str | Distribution | None = None,
        fog_extinction: str | Distribution = "mie",
        fog_backscatter: str | Distribution = "mie",
        receiver: str | Distribution = "gate",
        lost: str = "zero",
        complete_scan: bool | str = False,
        beam_ends: str = "scene",
        own_vehicle: OwnVehicleMask | Sequence[float] | str | None = None,
        variant: str | None = None,
        ego_speed_m_per_s: float | Distribution = 0.0,
        effects: Sequence[Effect | Mapping[str, Any]] = (),
        p: float = 1.0,
    ) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "q_eff": q_eff,
            "q_back": q_back,
            "fog_extinction": fog_extinction,
            "fog_backscatter": fog_backscatter,
            "receiver": receiver,
            "lost": lost,
            "complete_scan": complete_scan,
            "beam_ends": beam_ends,
            "own_vehicle": own_vehicle,
            "variant": variant,
            "ego_speed_m_per_s": ego_speed_m_per_s,
            "effects": effects,
            "p": p,
        }
        at, sensor = self._fixed(weather, LidarOptions(**values), sensor)
        check_arguments(
            "LidarRain(weather: Weather | None, sensor: Lidar, q_eff: float | None, q_back: float | str | None, "
            "fog_extinction: str, fog_backscatter: str, lost: str, complete_scan: bool | str, beam_ends: str, "
            "own_vehicle: OwnVehicleMask | Sequence[float] | str | None, variant: str | None, "
            "ego_speed_m_per_s: float, effects: Sequence, p: float)",
            weather,
            sensor,
            at.q_eff,
            at.q_back,
            at.fog_extinction,
            at.fog_backscatter,
            at.lost,
            at.complete_scan,
            at.beam_ends,
            at.own_vehicle,
            at.variant,
            at.ego_speed_m_per_s,
            at.effects,
            at.p,
        )
        weather = self._check_weather(weather)
        self._check_p(at.p)
        Lidar.check(sensor, "sensor", "ouster-os1-128", owner=self)
        self._check_variant(weather, at.variant)
        check_one_of("lost", at.lost, LOST_AS, owner=self)
        if at.complete_scan not in COMPLETE_SCAN:
            raise InputValueError(
                f'{type(self).__name__}: complete_scan must be False, True or "sky"; got {at.complete_scan!r}.'
            )
        if at.complete_scan and sensor.azimuths_deg is not None:
            raise InputValueError(
                f"{type(self).__name__}: complete_scan is for a sensor that turns; a flash has a row for every pixel. "
                "Give the whole grid, with directions=torchweather.lidar.scan.scan_directions(sensor)."
            )
        check_one_of("beam_ends", at.beam_ends, BEAM_ENDS, owner=self)
        self.beam_ends, self._find_beams = at.beam_ends, BeamFinder()
        self.own_vehicle = checked_own_vehicle(at.own_vehicle, sensor, type(self).__name__)
        if at.variant == "hahner":
            at = replace(at, fog_backscatter="hahner", fog_extinction="koschmieder")
        self.weather, self.sensor = weather, sensor
        self._densest = weather = weather.densest()
        self.lost, self.complete_scan = at.lost, at.complete_scan
        published = "d3_4" if at.variant == "d3_4" else None
        parts = _with_packed_flakes(weather.parts) if at.variant == "hahner" else weather.parts or (CLEAR_AIR,)
        air = patchy_air(weather)
        if air and published:
            raise InputValueError(f'{type(self).__name__}: variant="d3_4" has no patches; set patch_log_std=0.')
        doppler = {} if sensor.speed_column is None else {"radial_speed": RadialSpeed(sensor, at.ego_speed_m_per_s)}
        if at.ego_speed_m_per_s != 0 and not doppler:
            raise InputValueError(
                f"{type(self).__name__}: ego_speed_m_per_s is for a LiDAR that measures speeds; set "
                "Lidar(speed_column=...), or leave it out."
            )
        plain = Chain(
            {
                **air,
                "to_energy": ToEnergy(sensor),
                "extinction": Extinction(parts, sensor, at.q_eff, at.fog_extinction, published),
                "particle_returns": ParticleReturns(
                    parts, sensor, at.q_back, at.fog_backscatter, published, at.receiver
                ),
                "detection": Detection(sensor),
                "to_points": ToPoints(sensor),
                **doppler,
            }
        )
        self.chain = with_conditions(plain, at.effects, lidar_conditions(weather, sensor), self)
        self.as_built = AsBuilt.of(self.chain)

    def _check_variant(self, weather: Weather, variant: str | None) -> None:
        name, kinds = type(self).__name__, [part.kind for part in weather.parts]
        if variant is None:
            return
        check_one_of("variant", variant, (*VARIANTS, "hahner"), owner=self)
        if variant == "d3_4" and kinds != ["rain"]:
            raise InputValueError(
                f'{name}: variant="d3_4" exists for rain alone. The published fog and snow signals have no system '
                "constant and follow from no sensor. They need a target reflectivity of 150, pulses of 10 fs and "
                "flakes 2.8e6 times brighter than the object. Use the default."
            )
        if variant == "hahner" and not {"fog", "snow"} & set(kinds):
            raise InputValueError(f'{name}: variant="hahner" is for fog and snow; this weather has neither.')

    # ---- what the weather is, readable -------------------------------------------------------------------------

    @property
    def extinction_per_m(self) -> Tensor:
        """Effective extinction of all weather together, 1/m, one value for each value of the weather intensity."""
        stage = self._stage(Extinction)
        values = [part() for part in stage.parts.values()]
        most = max(value.numel() for value in values)
        return torch.stack([value.expand(most) for value in values]).sum(0)

    @property
    def backscatter_per_m_sr(self) -> Tensor:
        """Backscatter coefficient of fog, 1/(m sr); 0 without fog."""
        fog = self._stage(ParticleReturns).kinds.get("fog")
        if not isinstance(fog, SoftReturn):
            return torch.zeros(1)
        return fog.backscatter_per_m_sr(fog.mor_m.reshape(-1))

    @property
    def mor_m(self) -> Tensor:
        """Visibility of the fog, m; infinity without fog."""
        fog = self._stage(ParticleReturns).kinds.get("fog")
        return fog.mor_m.reshape(-1) if isinstance(fog, SoftReturn) else torch.full((1,), math.inf)

    def _stage(self, kind: type[Any]) -> Any:
        for stage in self.chain.stages.values():
            if isinstance(stage, kind):
                return stage
        raise InputValueError(f"{type(self).__name__}: the chain has no {kind.__name__} stage.")

    def _built_from(self, weather: Weather, drawn: Mapping[str, Any], sensor: Any) -> Self:
        """The transform for a weather that all samples get; a plain chain renews what depends on the intensity."""
        if drawn or sensor is not self.sensor or not self._differs_by_intensity(weather):
            return super()._built_from(weather, drawn, sensor)
        return self._at_intensity(weather)

    def renewed(self, weather: Weather) -> Self | None:
        """As of every transform."""
        some = isinstance(weather, Weather) and not weather.random and self._differs_by_intensity(weather)
        return self._at_intensity(weather) if some else None

    def _at_intensity(self, weather: Weather) -> Self:
        """The same transform for a weather that differs by intensities alone, sharing all else."""
        found = with_buffers(self)
        found.weather, found.p, found.options = weather, 1.0, replace(self.options, p=1.0)
        found._densest, found._find_beams = weather, self._find_beams.for_another_weather()
        stages = {
            name: stage.at_intensity(weather.parts) if isinstance(stage, (Extinction, ParticleReturns)) else stage
            for name, stage in self.chain.stages.items()
        }
        found.chain = Chain(stages)
        found.as_built = AsBuilt.of(found.chain, self.as_built.shared_with(self.chain, found.chain))
        return found

    def _differs_by_intensity(self, weather: Weather) -> bool:
        """True where a weather differs from this transform's by intensities alone, and the chain is the plain one."""
        own, some = self._densest, next(self.buffers())
        if some.device.type != "cpu" or some.dtype != torch.float32:
            return False
        if not isinstance(self.options, LidarOptions) or self.options.variant is not None:
            return False
        if {type(stage) for stage in self.chain.stages.values()} != PLAIN:
            return False
        return (
            not own.conditions
            and not weather.conditions
            and len(own.parts) == len(weather.parts)
            and all(_are_alike(*pair) for pair in zip(own.parts, weather.parts, strict=True))
        )

    def extra_repr(self) -> str:
        """The path that weathers clouds on the processor."""
        return f"weathered by {compiled.rendered_by(self.chain)}"

    # ---- calls -------------------------------------------------------------------------------------------------

    @outside_autocast
    def forward(
        self,
        points: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        directions: Tensor | None = None,
        reach_m: Tensor | None = None,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Cloud:
        """The cloud in the weather.

        Args:
            points: ``(..., N, 4 or more)``: x, y, z in metres, intensity in the sensor's unit, further columns.
            noise: what ``draw`` gave; ``None`` draws anew.
            directions: ``(N, 3)`` or ``(..., N, 3)`` direction of every row, for beams without return.
            reach_m: ``(..., N)`` way of every beam without return to its end, metres; ``None``: as ``beam_ends`` says.
                Rows with a return do not look at it.
            seed: for a call that draws: an integer s for the samples s, s + 1, ..., or a tensor of the batch shape.
            generator: likewise, a torch generator that gives these integers.

        Returns:
            The input's shape, columns and dtype; rows more with ``complete_scan``; a shorter cloud (a list of them for
            a batch) with ``lost="drop"``.
        """
        if not isinstance(points, Tensor) or points.ndim < 2:
            check_points(points, self.sensor, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and points.ndim > 2 and points.numel():
                beside = {"directions": directions, "reach_m": reach_m}
                return self.each_alone(self.forward, points, seed, generator, beside, 2)
            chosen, seeds = self.at_call(points.shape[:-2], seed, generator)
            return chosen.forward(points, chosen._own_noise(points, seeds), directions=directions, reach_m=reach_m)
        with _few_threads(points):
            beams, state = self._begin(points, directions, reach_m)
            state = _own_vehicle_restored(self._through(state, noise, points.shape[:-2], beams.first_row), beams)
            assert state.returns.points is not None
            return self._outgoing(state.returns.points, state.returns.kind[..., 0], points, beams)

    if TYPE_CHECKING:
        __call__ = forward

    @outside_autocast
    def run(
        self,
        points: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        directions: Tensor | None = None,
        reach_m: Tensor | None = None,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> LidarResult:
        """The cloud, and what happened to each of its points; arguments as ``forward``."""
        if not isinstance(points, Tensor) or points.ndim < 2:
            check_points(points, self.sensor, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and points.ndim > 2 and points.numel():
                beside = {"directions": directions, "reach_m": reach_m}
                return self.each_alone(self.run, points, seed, generator, beside, 2)
            chosen, seeds = self.at_call(points.shape[:-2], seed, generator)
            return chosen.run(points, chosen._own_noise(points, seeds), directions=directions, reach_m=reach_m)
        with _few_threads(points):
            return self._run(points, noise, directions, reach_m)

    def _run(
        self, points: Tensor, noise: Mapping[str, Tensor] | None, directions: Tensor | None, reach_m: Tensor | None
    ) -> LidarResult:
        """`run` with noise that is drawn, or to be drawn by the chain."""
        beams, before = self._begin(points, directions, reach_m)
        state = _own_vehicle_restored(self._through(before, noise, points.shape[:-2], beams.first_row), beams)
        assert state.returns.points is not None
        batch, count = state.returns.kind.shape[:2]
        rows = torch.arange(count, device=points.device)
        source = torch.where(rows < count - beams.appended, rows, -1).expand(batch, count)
        transmission = torch.ones_like(state.air.reach_m)
        if state.air.extinction_per_m is not None:
            # To the object where particles end before it: at the ground above a return from below it.
            under = (before.scene.clear_range_m > 0) & (before.air.reach_m < before.scene.clear_range_m)
            way_m = torch.where(under, before.scene.clear_range_m, state.air.reach_m)
            way_m = way_m if state.air.path_density is None else way_m * state.air.path_density
            transmission = torch.exp(-2.0 * state.air.extinction_per_m[:, None].to(transmission) * way_m)
        if beams.on_own is not None:
            transmission = torch.where(beams.on_own, 1.0, transmission)
        second = second_source = second_kind = None
        if state.returns.second is not None:
            kind = state.returns.kind[..., 1]
            there = torch.where(kind == PointKind.LOST, -1, source)
            second = self._outgoing(state.returns.second, kind, points, beams)
            second_source = self._outgoing(there, kind, points, beams)
            second_kind = self._outgoing(kind, kind, points, beams)
        kind = state.returns.kind[..., 0]
        lead = points.shape[:-2]
        return LidarResult(
            points=self._outgoing(state.returns.points, kind, points, beams),
            kind=self._outgoing(kind, kind, points, beams),
            source=self._outgoing(source, kind, points, beams),
            transmission=self._outgoing(transmission.to(points.dtype), kind, points, beams),
            second=second,
            second_source=second_source,
            second_kind=second_kind,
            beam_end=None if beams.end is None else self._outgoing(beams.end, kind, points, beams),
            beam_end_counts=None if beams.end is None else _counts_of(beams).reshape(*lead, len(BeamEnd)),
            empty_beams=(before.scene.clear_range_m == 0).sum(-1).reshape(lead),
            floored_points=self._floored(before).reshape(lead),
            scan=beams.scan,
            own_vehicle_points=None if beams.on_own is None else beams.on_own.sum(-1).reshape(lead),
        )

    def draw_for_call(self, value: Tensor, seed: int) -> dict[str, Tensor]:
        """As of every transform; the call checks the points."""
        return self._own_noise(value, torch.tensor(seed))

    def _own_noise(self, points: Tensor, seeds: Tensor | None) -> _OwnNoise:
        """Noise of `draw` for the call that follows, which checks the points."""
        if self.complete_scan:  # looks for beams first
            return _OwnNoise(self.draw(points, seed=seeds))
        return _OwnNoise(self.drawn(points.shape[:-2], {"N": points.shape[-2]}, None, seeds))

    @outside_autocast
    def draw(
        self, points: Tensor, generator: torch.Generator | None = None, seed: int | Tensor | None = None
    ) -> dict[str, Tensor]:
        """Noise for ``forward``; depends on the number of points alone, not on where they are.

        Args:
            points: ``(..., N, C)``; with ``complete_scan`` also the beams that they lack count.
            generator: torch generator that gives one integer a sample; ``None`` is the global one.
            seed: those integers themselves: a tensor of the batch shape, or the first of them.

        Returns:
            ``<stage>.<variate>`` to a tensor that leads with the batch shape.
        """
        check_points(points, self.sensor, self)
        count = points.shape[-2]
        if self.complete_scan:
            beams = self._find_beams(
                points,
                self.sensor,
                None,
                complete_scan=self.complete_scan,
                at_scene=self.beam_ends == "scene",
                own_vehicle=self.own_vehicle,
                owner=self,
            )
            count = beams.points.shape[-2]
        return self.drawn(points.shape[:-2], {"N": count}, generator, seed)

    def on_numpy(
        self, points: NDArray[Any], seed: int | None = None, directions: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Numpy in, numpy out: the cloud of a simulator's sensor callback in the weather.

        Args:
            points: ``(N, 4 or more)``, floating point.
            seed: the same seed gives the same weather; ``None`` draws from torch's global generator.
            directions: ``(N, 3)`` for beams without return.

        Returns:
            A new array of the dtype of ``points``.

        Example:
            >>> from torchweather.atmosphere.weather import Snow
            >>> lidar = LidarSnow(Snow(rate_mm_per_h=1), Lidar.preset("velodyne-hdl-64e"))
            >>> lidar.on_numpy(np.array([[9.0, 1.0, 0.5, 40.0]], dtype=np.float32), seed=1).dtype
            dtype('float32')
        """
        with torch.no_grad():
            cloud = _from_numpy(points)
            along = None if directions is None else _from_numpy(directions)
            noise = self.draw(cloud, seed=seed)
            out = self(cloud, noise, directions=along)
        if isinstance(out, list):
            raise InputValueError(f"{type(self).__name__}.on_numpy: expected one cloud (N, 4 or more); got a batch.")
        found: NDArray[Any] = out.numpy()
        return found

    def expected(self, points: Tensor, *, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Expected signal of each object and the probability that the sensor reports it; smooth, nothing is drawn.

        The signal is X of ``PHYSICS.md`` 5.3 in the weather, 1/(m^2 sr). A point is reported if it stays above
        threshold and nothing in front beats it (``strongest``), is seen apart from it (``first``) or swallows it (all
        but ``strongest``; of fog approximately). The step at the threshold is rounded by photon noise
        (``lidar/expected_detection.py``).

        Args:
            points: as in ``forward``.
            directions: likewise.

        Returns:
            ``(..., N)`` each; 0 for rows without return. Differentiable in rates, visibility and sensor parameters.
        """
        effects = [stage.id for stage in self.chain.stages.values() if isinstance(stage, Effect)]
        effects += [name for name, stage in self.chain.stages.items() if isinstance(stage, PatchyAir)]
        if effects:
            raise InputValueError(
                f"{type(self).__name__}: expected is for the plain chain, without {', '.join(effects)}. Average draws "
                "of run() instead."
            )
        beams, state = self._begin(points, directions)
        stages = [self._stage(kind) for kind in (ToEnergy, Extinction, ParticleReturns, Detection)]
        signal, reported = expected_detection(state, *stages)
        if beams.on_own is not None:
            clear = stages[0].signal_of_intensity(
                state.scene.points_in[..., 3], state.scene.clear_range_m, state.scene.zero_intensity
            )
            signal = torch.where(beams.on_own, clear.clamp_min(stages[0].beam.threshold), signal)
            reported = torch.where(beams.on_own, 1.0, reported)
        lead = points.shape[:-2]
        return signal.reshape(*lead, signal.shape[-1]), reported.reshape(*lead, signal.shape[-1])

    def state_of(self, points: Tensor, directions: Tensor | None = None) -> LidarState:
        """State that the chain begins with: the beams of a cloud before any stage.

        Args:
            points, directions: as in ``forward``.
        """
        return self._begin(points, directions)[1]

    # ---- the border --------------------------------------------------------------------------------------------

    def _begin(
        self, points: Tensor, directions: Tensor | None, way_m: Tensor | None = None
    ) -> tuple[Beams, LidarState]:
        check_points(points, self.sensor, self)
        if directions is None and self.sensor.directions is None:
            warn_of_frame(points, self.sensor, self)
        self.refuse_undrawn(points.shape[:-2])
        along = self.sensor.directions if directions is None else directions
        along = directions_in_sensor_frame(along, self.sensor)
        # In the sensor's frame, from where each beam starts, until _outgoing.
        at_scene = self.beam_ends == "scene" and way_m is None
        beams = self._find_beams(
            points,
            self.sensor,
            along,
            complete_scan=self.complete_scan,
            at_scene=at_scene,
            own_vehicle=self.own_vehicle,
            owner=self,
        )
        flat = beams.points
        range_m = _range_m(flat, self.sensor.min_range_m) if beams.range_m is None else beams.range_m
        reach_m = range_m
        if beams.empty_direction is not None:
            farthest: float | Tensor = self.sensor.max_range_m if beams.end_m is None else beams.end_m
            if way_m is not None:
                farthest = self._checked_way(way_m, points).to(range_m)
            reach_m = torch.where(
                range_m > 0, range_m if beams.end_m is None else beams.end_m.minimum(range_m), farthest
            )
        nothing, no_kind = (_zeros(range_m, dtype)[..., None] for dtype in (range_m.dtype, torch.int8))
        intensity, unit = flat[..., 3], self.sensor.intensity_unit
        integral = are_integers(intensity, unit)
        state = LidarState.of(
            points_in=flat,
            empty_direction=beams.empty_direction,
            clear_range_m=range_m,
            clear_signal=nothing[..., 0],
            range_m=range_m[..., None],
            signal=nothing,
            kind=no_kind,
            reach_m=reach_m,
            threshold=flat.new_tensor(self.sensor.threshold_per_m2_sr),
            integral=integral,
            borrowed_intensity=borrowed_intensity(intensity, range_m > 0, unit),
            zero_intensity=zero_intensity(intensity, unit, self.sensor.zero_intensity, integral),
            grid=self._grid(flat.shape[1]),
        )
        return beams, state

    def _checked_way(self, way_m: Tensor, points: Tensor) -> Tensor:
        """Ways to the beams' ends ``(B, N)``."""
        check_arguments(f"{type(self).__name__}(reach_m: real)", way_m)
        if way_m.shape != points.shape[:-1]:
            raise InputValueError(
                f"{type(self).__name__}: reach_m must have shape {tuple(points.shape[:-1])}, a way in metres for every "
                f"row; got {tuple(way_m.shape)}."
            )
        return way_m.reshape(-1, way_m.shape[-1])

    def _grid(self, count: int) -> tuple[int, int] | None:
        """Rows and columns where the cloud is the whole scan pattern."""
        rings, columns = self.sensor.elevations_deg, self.sensor.columns
        if rings is None or columns is None or len(rings) * columns != count:
            return None
        return len(rings), columns

    def _through(
        self,
        state: LidarState,
        noise: Mapping[str, Tensor] | None,
        batch: Sequence[int],
        first_row: Tensor | None = None,
    ) -> LidarState:
        if noise is None:
            drawn = self.chain.draw(state)
            flat = {key: value.to(state.scene.points_in.device) for key, value in drawn.items()}
        else:
            if isinstance(noise, _OwnNoise):
                known = {key: value.reshape(state.batch, *value.shape[len(batch) :]) for key, value in noise.items()}
            else:
                known = self._flat_noise(noise, state, batch)
            flat = {key: value.to(state.scene.points_in.device) for key, value in known.items()}
        if first_row is not None:  # echoes of one beam meet the same particles
            flat = {key: _of_first(value, first_row) for key, value in flat.items()}
        if compiled.covers(self.chain, state, flat):
            return compiled.weathered(self.chain, state, flat)
        if self._is_large(state):
            return self._in_portions(state, flat)
        return through_stages(self.chain, state, flat)

    def _is_large(self, state: LidarState) -> bool:
        """Check whether the cloud is worked on in portions of its beams."""
        batch, beams = state.scene.clear_range_m.shape
        if is_exporting() or batch * beams <= BEAMS_AT_ONCE or batch > beams:
            return False
        if not all(stage.each_beam_alone for stage in self.chain.stages.values()):
            return False
        learns = (state.scene.points_in, *self.chain.buffers())
        return not (torch.is_grad_enabled() and any(value.requires_grad for value in learns))

    def _in_portions(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state after the chain, portion by portion: fresh memory for larger arrays costs more than the work."""
        batch, beams = state.scene.clear_range_m.shape
        size = max(1, BEAMS_AT_ONCE // batch)
        found = []
        for start in range(0, beams, size):
            part = slice(start, start + size)
            own = {key: value[..., part] for key, value in noise.items()}
            found.append(through_stages(self.chain, state.of_beams(part), own))
        joined: dict[str, Any] = {}
        for name in ("points", "second", "kind", "reach_m", "path_density"):
            values = [part.field(name) for part in found]
            joined[name] = None if values[0] is None else torch.cat(values, 1)
        return state.changed(extinction_per_m=found[0].air.extinction_per_m, **joined)

    def _floored(self, state: LidarState) -> Tensor:
        own = (state.scene.points_in[..., 3], state.scene.clear_range_m, state.scene.zero_intensity)
        contradicts: Tensor = self._stage(ToEnergy).contradicts_threshold(*own)
        return contradicts.sum(-1)

    def _outgoing(self, values: Tensor, kind: Tensor, points: Tensor, beams: Beams) -> Cloud:
        """Values ``(B, N, ...)`` of the beams as they leave: shape and dtype of the input, lost points as asked for."""
        batch = points.shape[:-2]
        if values.ndim == 3:  # the cloud itself
            given = points.reshape(values.shape[0], *points.shape[-2:])
            values = points_in_cloud_frame(values, beams.points, given, self.sensor, beams.height_m, in_place=True).to(
                points.dtype
            )
            if self.lost == "nan":
                had_return = _range_m(beams.points, self.sensor.min_range_m) > 0
                gone = (kind == PointKind.LOST) & had_return
                first = torch.arange(values.shape[-1], device=values.device) < 4
                values = torch.where(gone[..., None] & first, torch.full_like(values, torch.nan), values)
        if self.lost != "drop":
            return values.reshape(*batch, *values.shape[1:])
        kept = [value[there] for value, there in zip(values, kind != PointKind.LOST, strict=True)]
        return kept if batch else kept[0]


def _are_alike(one: Weather, other: Weather) -> bool:
    """True where two weathers are of one kind and differ by their intensities at most; arrays count as different."""
    if type(one) is not type(other):
        return False
    names = [field.name for field in fields(one) if field.name != one.intensity_name]  # type: ignore[arg-type]
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    plain = (str, bool, int, float, tuple, type(None))
    return all(a is b or (isinstance(a, plain) and isinstance(b, plain) and a == b) for a, b in pairs)


def _few_threads(points: Tensor) -> AbstractContextManager[None]:
    """One thread an operation for a cloud on the CPU whose arrays fit the cache: more of them wait for each other."""
    small = points.device.type == "cpu" and points.numel() <= 4 * BEAMS_AT_ONCE
    return one_thread_an_operation() if small and not is_exporting() else nullcontext()


def _with_packed_flakes(parts: Sequence[Weather]) -> tuple[Weather, ...]:
    """The same weathers, flakes as bright as a pack of snow unless their reflectivity is given (Hahner et al. 2022)."""
    return tuple(
        replace(part, flake_reflectivity=SNOW_PACK_REFLECTIVITY)
        if isinstance(part, Snow) and part.flake_reflectivity is None
        else part
        for part in parts
    )


def _own_vehicle_restored(state: LidarState, beams: Beams) -> LidarState:
    """The state after the chain, with returns on the own vehicle as they came: no second echo, no particle."""
    if beams.on_own is None or state.returns.points is None:
        return state
    own = beams.on_own
    points = torch.where(own[..., None], state.scene.points_in, state.returns.points)
    kind = state.returns.kind.clone()
    kind[..., 0] = torch.where(own, int(PointKind.OBJECT), kind[..., 0])
    second = state.returns.second
    if second is not None:
        first = torch.arange(second.shape[-1], device=second.device) < 4
        second = torch.where(own[..., None], torch.where(first, 0.0, state.scene.points_in), second)
        kind[..., 1] = torch.where(own, int(PointKind.LOST), kind[..., 1])
    return state.changed(points=points, kind=kind, second=second)


def _counts_of(beams: Beams) -> Tensor:
    """Number of beams of each cloud by their end, ``(B, 6)``; rows of padding are none."""
    assert beams.end is not None
    end = beams.end.long()
    if beams.appended and beams.empty_direction is not None:
        real = (beams.empty_direction[:, -beams.appended :] != 0).any(-1)
        padding = torch.where(real, end[:, -beams.appended :], len(BeamEnd))
        end = torch.cat([end[:, : -beams.appended], padding], 1)
    counts = torch.zeros(len(end), len(BeamEnd) + 1, dtype=torch.int64, device=end.device)
    return counts.scatter_add_(1, end, torch.ones_like(end))[:, : len(BeamEnd)]


def _zeros(like: Tensor, dtype: torch.dtype) -> Tensor:
    """Zeros of a shape; those that no graph holds take no memory."""
    if is_exporting():
        return torch.zeros_like(like, dtype=dtype)
    return like.new_zeros((), dtype=dtype).expand_as(like)


def _range_m(points: Tensor, min_range_m: float) -> Tensor:
    """Range of each row, 0 where it holds no return: at the origin, or nearer than the sensor measures."""
    x, y, z = points[..., :3].unbind(-1)
    range_m = (x * x + y * y + z * z).sqrt()
    return torch.where(range_m < min_range_m, 0.0, range_m) if min_range_m > 0 else range_m


def _of_first(noise: Tensor, first_row: Tensor) -> Tensor:
    """Noise ``(B, ..., N)`` with that of each beam's first row for all its rows; other noise as it is."""
    if noise.shape[-1] != first_row.shape[-1] or noise.shape[0] != first_row.shape[0]:
        return noise
    between = (1,) * (noise.ndim - 2)
    return noise.gather(-1, first_row.view(len(first_row), *between, -1).expand_as(noise))


def _from_numpy(array: NDArray[Any]) -> Tensor:
    # A simulator's buffer may be read-only, which torch warns of: that one is copied.
    check_arguments("LidarWeather.on_numpy(points: array)", array)
    return torch.from_numpy(np.require(array, requirements=("C", "W")))


class LidarRain(LidarWeather):
    """Rain on a LiDAR's point cloud: weaker returns, lost ones, and drops near the sensor.

    Arguments as ``LidarWeather``.

    Example:
        >>> from torchweather.atmosphere.weather import Rain
        >>> lidar = LidarRain(Rain(rate_mm_per_h=25), Lidar.preset("ouster-os1-128"))
        >>> points = torch.tensor([[20.0, 0.0, 0.0, 40.0], [0.0, 60.0, 1.0, 9.0]])
        >>> noise = lidar.draw(points, seed=7)
        >>> torch.equal(lidar(points, noise), lidar(points, noise))
        True
    """

    takes: ClassVar[tuple[str, ...]] = ("rain",)


class LidarFog(LidarWeather):
    """Fog on a LiDAR's point cloud: objects fade, and the fog itself returns a few metres ahead.

    Arguments as ``LidarWeather``.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> lidar = LidarFog(Fog(mor_m=50), Lidar.preset("ouster-os1-128"))
        >>> points = torch.tensor([[60.0, 0.0, 0.0, 40.0]])
        >>> int(lidar.run(points, lidar.draw(points, seed=1)).kind)
        1
        >>> [round(float(v), 4) for v in (lidar.extinction_per_m, lidar.backscatter_per_m_sr, lidar.mor_m)]
        [0.0633, 0.003, 50.0]
    """

    takes: ClassVar[tuple[str, ...]] = ("fog",)


class LidarSnow(LidarWeather):
    """Snow on a LiDAR's point cloud: flakes in the near range, weaker returns beyond.

    Arguments as ``LidarWeather``.

    Example:
        >>> from torchweather.atmosphere.weather import Snow
        >>> lidar = LidarSnow(Snow(rate_mm_per_h=2), Lidar.preset("velodyne-hdl-64e", return_mode="dual"))
        >>> points = torch.tensor([[25.0, 0.0, 0.0, 10.0]]).expand(1000, 4)
        >>> result = lidar.run(points, lidar.draw(points, seed=1))
        >>> bool((result.kind == PointKind.PARTICLE).any()), result.second.shape
        (True, torch.Size([1000, 4]))
    """

    takes: ClassVar[tuple[str, ...]] = ("snow",)
