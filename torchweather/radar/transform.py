"""RadarAttenuation: weather on the detections of a radar."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.density_field import patchy_air
from torchweather.atmosphere.weather import CLEAR_AIR, Rain, Snow, Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning, check_one_of
from torchweather.core.precision import outside_autocast
from torchweather.lidar.clouds import FARTHEST_M
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.conditions import with_conditions
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.sensor_transform import WeatherTransform
from torchweather.pipeline.tiling import is_exporting
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.clutter import VolumeClutter
from torchweather.radar.conditions import radar_conditions
from torchweather.radar.options import RadarOptions
from torchweather.radar.sensor import Radar
from torchweather.radar.stages import POWER, RadarDetection, ToRadarPoints
from torchweather.radar.state import RadarState

__all__ = ["RadarAttenuation", "RadarResult"]

COLUMNS = 6
COLUMNS_WANTED = "x, y, z in m, radial speed in m/s, power in dB, radar cross section in dBsm"
LOST_AS = ("zero", "nan", "drop")
# Fields of the state that effects may need and a list does not hold, and which sizes each has behind the batch's.
KNOWN = {"target_class": "N", "frame_number": "", "past_rain_mm_per_h": "T", "past_rain_min": "T"}
List = Tensor | list[Tensor]


@dataclass(frozen=True)
class RadarResult:
    """Effect of the weather on a list of detections. With ``lost="drop"`` a batch gives lists, one entry a sample.

    Args:
        points: ``(..., N, C)`` the detections, in the columns and the dtype of the input; K rows more with clutter.
        kind: ``(..., N)`` int8, ``PointKind`` of each: OBJECT 0, PARTICLE 1 (clutter), LOST 2 (no detection: lost, or
            empty in the input).
        source: ``(..., N)`` row of the input, -1 for clutter.
        snr_db: ``(..., N)`` signal over the noise floor, also of what is lost; -inf where there is nothing.
        attenuation_db: ``(..., N)`` two-way loss of path and cover together, and of what effects do to the power; 0 for
            clutter.
        floored_points: ``(...)`` detections whose power column says less than the detection threshold.
    """

    points: List
    kind: List
    source: List
    snr_db: List
    attenuation_db: List
    floored_points: Tensor

    sensor: ClassVar[str] = "radar"

    @property
    def transmission(self) -> List:
        """``(..., N)`` share of each echo's power that is left."""
        loss_db = self.attenuation_db
        if isinstance(loss_db, Tensor):
            return torch.pow(10.0, -loss_db / 10.0)
        return [torch.pow(10.0, -one / 10.0) for one in loss_db]


class RadarAttenuation(WeatherTransform):
    """Weather on a radar's detections: each weaker by the way through it and back, and lost below the threshold.

    Args:
        weather: ``Rain``, ``Fog``, ``Snow`` or a ``Mixture`` of them, with water or snow on things
            (``torchweather.atmosphere.conditions``) or without. ``None``: that of the ``Compose`` around it.
        sensor: the radar; its ``floor_db`` is in the unit of the power column.
        rain_model: ``p838`` (ITU-R P.838-3, the default), ``dsd_mie`` (Mie over the rain's own drops) or ``d3_4``
            (Sander 1975 as published).
        fog_model: ``p840`` (ITU-R P.840, the default) or ``d3_4`` (340 times too strong at 77 GHz).
        snow_model: ``dsd_mie`` (Mie over the snow's own flakes and melt fraction, the default) or ``d3_4``
            (Norouziari 2018).
        radome_loss_db: two-way loss of the wet cover, whatever the rate.
        radome_film_db: two-way loss of a film of water at 1 mm/h of rain, which grows with the rate to the power
            ``radome_film_exponent``.
        radome_film_exponent: of the rate.
        clutter: append detections of rain and snow themselves (see ``VolumeClutter``).
        clutter_points: of each of rain and snow at most; where more cells exceed the threshold, a random share of them.
        ego_speed_m_per_s: of the vehicle, forward; for the clutter's Doppler.
        lost: lost detections become ``zero`` (x, y, z of 0; the rest stays), ``nan``, or are left out (``drop``).
        variant: ``d3_4``: all three models as the deliverable published them.
        effects: of ``stages.EFFECTS`` for radar, or their dictionaries; each goes to its place in the chain.
        p: probability that a sample gets the weather; the others come back as they are.

    What is not known may be a distribution, drawn for each sample: the models, the radome's values,
    ``ego_speed_m_per_s``, parameters of effects, and fields of the sensor that ``Radar.drawable`` names.

    Note:
        Rows at the origin are no detections and stay as they are. The radar cross section column stays: it is the
        target's. The noise floor does not change with the weather.

    References:
        PHYSICS.md 6.2, 6.5-6.8.

    Example:
        >>> radar = RadarAttenuation(Rain(rate_mm_per_h=25), Radar.preset("imaging-77ghz"))
        >>> points = torch.tensor([[50.0, 0.0, 0.0, -3.0, -112.2, 10.0]])
        >>> [round(v, 2) for v in radar(points)[0].tolist()]
        [50.0, 0.0, 0.0, -3.0, -113.34, 10.0]
    """

    takes_all: ClassVar[str] = "RadarAttenuation"
    sensor_class: ClassVar[type[Radar]] = Radar
    extra_inputs: ClassVar[Mapping[str, int]] = {name: len(sizes) for name, sizes in KNOWN.items()}
    data_shape = ("N", "6 or more")

    def __init__(
        self,
        weather: Weather | None,
        sensor: Radar,
        *,
        rain_model: str | Distribution | None = None,
        fog_model: str | Distribution | None = None,
        snow_model: str | Distribution | None = None,
        radome_loss_db: float | Distribution = 0.0,
        radome_film_db: float | Distribution = 0.0,
        radome_film_exponent: float | Distribution = 1.0 / 3.0,
        clutter: bool = False,
        clutter_points: int = 64,
        ego_speed_m_per_s: float | Distribution = 0.0,
        lost: str = "zero",
        variant: str | None = None,
        effects: Sequence[Effect | Mapping[str, Any]] = (),
        p: float = 1.0,
    ) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "rain_model": rain_model,
            "fog_model": fog_model,
            "snow_model": snow_model,
            "radome_loss_db": radome_loss_db,
            "radome_film_db": radome_film_db,
            "radome_film_exponent": radome_film_exponent,
            "clutter": clutter,
            "clutter_points": clutter_points,
            "ego_speed_m_per_s": ego_speed_m_per_s,
            "lost": lost,
            "variant": variant,
            "effects": effects,
            "p": p,
        }
        at, sensor = self._fixed(weather, RadarOptions(**values), sensor)
        check_arguments(
            "RadarAttenuation(radome_loss_db: float, radome_film_db: float, radome_film_exponent: float, "
            "clutter: bool, clutter_points: int, ego_speed_m_per_s: float, lost: str, variant: str | None, p: float)",
            at.radome_loss_db,
            at.radome_film_db,
            at.radome_film_exponent,
            at.clutter,
            at.clutter_points,
            at.ego_speed_m_per_s,
            at.lost,
            at.variant,
            at.p,
        )
        weather = self._check_weather(weather)
        self._check_p(at.p)
        Radar.check(sensor, "sensor", "imaging-77ghz", owner=self)
        check_one_of("lost", at.lost, LOST_AS, owner=self)
        check_arguments(
            "RadarAttenuation(rain_model: str | None, fog_model: str | None, snow_model: str | None, "
            "effects: Sequence)",
            at.rain_model,
            at.fog_model,
            at.snow_model,
            at.effects,
        )
        if at.variant is not None:
            check_one_of("variant", at.variant, ("d3_4",), owner=self)
            given = [model for model in (at.rain_model, at.fog_model, at.snow_model) if model is not None]
            if given:
                raise InputValueError(
                    f"RadarAttenuation: variant={at.variant!r} sets all three models; got {', '.join(given)} besides. "
                    "Give one or the other."
                )
            at = replace(at, rain_model=at.variant, fog_model=at.variant, snow_model=at.variant)
        self.weather, self.sensor, self.lost = weather, sensor, at.lost
        weather = weather.densest()
        self.ego_speed_m_per_s = float(at.ego_speed_m_per_s)
        plain = Chain(
            {
                **patchy_air(weather, at.ego_speed_m_per_s),
                "path_attenuation": PathAttenuation(
                    weather.parts or (CLEAR_AIR,),
                    sensor,
                    at.rain_model or "p838",
                    at.fog_model or "p840",
                    at.snow_model or "dsd_mie",
                ),
                "radar_detection": RadarDetection(sensor),
                "to_radar_points": ToRadarPoints(),
            }
        )
        self.chain = with_conditions(plain, at.effects, radar_conditions(weather, sensor), self)
        # The cover in front of the effects, which may append echoes; the clutter behind them, which may change it.
        if at.radome_loss_db or at.radome_film_db:
            rates = [part.intensity for part in weather.parts if isinstance(part, Rain)]
            cover = WetRadome(rates[0] if rates else 0.0, at.radome_loss_db, at.radome_film_db, at.radome_film_exponent)
            if cover.default_name in self.chain.stages:
                raise InputValueError(
                    f"{type(self).__name__}: radome_loss_db and radome_film_db are what radar.wet_radome has as "
                    "loss_db and film_db, and what WetWindow in the weather makes. Give one of them."
                )
            self.chain = self.chain.insert(cover, after="path_attenuation")
        for part in weather.parts:
            if at.clutter and isinstance(part, (Rain, Snow)):
                echo = VolumeClutter(part, sensor, capacity=at.clutter_points, ego_speed_m_per_s=at.ego_speed_m_per_s)
                self.chain = self.chain.insert(echo, before="radar_detection", name=f"{part.kind}_clutter")
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
        points: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
        **known: Tensor,
    ) -> List:
        """The detections in the weather.

        Args:
            points: ``(..., N, 6 or more)``: x, y, z (m), radial speed (m/s), power (dB), radar cross section (dBsm),
                further columns.
            noise: what ``draw`` gave; ``None`` draws anew.
            seed: for a call that draws: an integer s for the samples s, s + 1, ..., or a tensor of the batch shape.
            generator: likewise, a torch generator that gives these integers.
            known: what some effects need: ``target_class`` ``(N,)`` or ``(..., N)``, ``frame_number`` ``()`` or
                ``(...)``, ``past_rain_mm_per_h`` and ``past_rain_min`` ``(T,)`` or ``(..., T)``.

        Returns:
            The input's shape, columns and dtype; rows more with ``clutter`` and with effects that list more; a shorter
            list (of lists for a batch) with ``lost="drop"``.
        """
        if not isinstance(points, Tensor) or points.ndim < 2:
            check_detections(points, self.sensor, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and points.ndim > 2 and points.numel():
                return self.each_alone(self.forward, points, seed, generator, known, 2)
            chosen, seeds = self.at_call(points.shape[:-2], seed, generator)
            return chosen.forward(points, chosen.draw(points, seed=seeds), **known)  # type: ignore[arg-type]
        state = self._through(self.state_of(points, **known), noise, points.shape[:-2])
        assert state.returns.points is not None
        return self._outgoing(self._marked(state.returns.points, state, points), state, points)

    if TYPE_CHECKING:
        __call__ = forward

    @outside_autocast
    def run(
        self,
        points: Tensor,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
        **known: Tensor,
    ) -> RadarResult:
        """The detections, and what happened to each of them; arguments as ``forward``."""
        if not isinstance(points, Tensor) or points.ndim < 2:
            check_detections(points, self.sensor, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and points.ndim > 2 and points.numel():
                return self.each_alone(self.run, points, seed, generator, known, 2)
            chosen, seeds = self.at_call(points.shape[:-2], seed, generator)
            return chosen.run(points, chosen.draw(points, seed=seeds), **known)  # type: ignore[arg-type]
        before = self.state_of(points, **known)
        state = self._through(before, noise, points.shape[:-2])
        assert state.returns.points is not None
        assert state.returns.snr_db is not None
        batch, total = state.returns.kind.shape
        count = points.shape[-2]
        rows = torch.arange(total, device=points.device)
        source = torch.where(rows < count, rows, -1).expand(batch, total)
        loss = torch.cat([0.0 - state.returns.gain_db, state.returns.gain_db.new_zeros(batch, total - count)], 1)
        power, threshold = (
            before.scene.points_in[..., POWER],
            before.receiver.noise_floor_db + before.receiver.detection_snr_db,
        )
        floored = (before.scene.range_m > 0) & (power < threshold[:, None])
        return RadarResult(
            points=self._outgoing(self._marked(state.returns.points, state, points), state, points),
            kind=self._outgoing(state.returns.kind, state, points),
            source=self._outgoing(source, state, points),
            snr_db=self._outgoing(state.returns.snr_db.to(points.dtype), state, points),
            attenuation_db=self._outgoing(loss.to(points.dtype), state, points),
            floored_points=floored.sum(-1).reshape(points.shape[:-2]),
        )

    @outside_autocast
    def draw(
        self, points: Tensor, generator: torch.Generator | None = None, seed: int | Tensor | None = None
    ) -> dict[str, Tensor]:
        """Noise for ``forward``; depends on the number of points alone, not on where they are.

        Args:
            points: ``(..., N, C)``.
            generator: torch generator that gives one integer a sample; ``None`` is the global one.
            seed: those integers themselves: a tensor of the batch shape, or the first of them.

        Returns:
            ``<stage>.<variate>`` to a tensor that leads with the batch shape.
        """
        check_detections(points, self.sensor, self)
        return self.drawn(points.shape[:-2], {"N": points.shape[-2]}, generator, seed)

    def on_numpy(self, points: NDArray[Any], seed: int | None = None) -> NDArray[Any]:
        """Numpy in, numpy out: the detections of a simulator's sensor callback in the weather.

        Args:
            points: ``(N, 6 or more)``, floating point.
            seed: the same seed gives the same weather; ``None`` draws from torch's global generator.

        Returns:
            A new array of the dtype of ``points``.

        Example:
            >>> radar = RadarAttenuation(Rain(rate_mm_per_h=25), Radar.preset("imaging-77ghz"))
            >>> radar.on_numpy(np.array([[50.0, 0, 0, 0, -112.2, 10]], dtype=np.float32), seed=1).dtype
            dtype('float32')
        """
        with torch.no_grad():
            check_arguments("RadarAttenuation.on_numpy(points: array)", points)
            detections = torch.from_numpy(np.require(points, requirements=("C", "W")))
            found = self(detections, self.draw(detections, seed=seed))
        if isinstance(found, list):
            raise InputValueError(f"{type(self).__name__}.on_numpy: expected one list (N, 6 or more); got a batch.")
        array: NDArray[Any] = found.numpy()
        return array

    def state_of(self, points: Tensor, **known: Tensor) -> RadarState:
        """State that the chain begins with: the detections before any stage; arguments as ``forward``."""
        check_detections(points, self.sensor, self)
        self.refuse_undrawn(points.shape[:-2])
        flat = points.reshape(math.prod(points.shape[:-2]), *points.shape[-2:])
        if flat.dtype not in (torch.float32, torch.float64):
            flat = flat.float()
        x, y, z = flat[..., :3].unbind(-1)
        range_m = (x * x + y * y + z * z).sqrt()
        nothing = torch.zeros_like(range_m)
        per_sample = flat.new_zeros(flat.shape[0])  # len() would fix the batch of a graph
        there = torch.full_like(range_m, int(PointKind.OBJECT), dtype=torch.int8)
        return RadarState.of(
            points_in=flat,
            range_m=range_m,
            gain_db=nothing,
            kind=there.masked_fill(~(range_m > 0), int(PointKind.LOST)),
            noise_floor_db=per_sample + self.sensor.floor_db,
            detection_snr_db=flat.new_tensor(self.sensor.detection_snr_db),
            attenuation_db_per_km=per_sample,
            cover_loss_db=per_sample,
            ego_speed_m_per_s=self.ego_speed_m_per_s,
            **self._known(points, known),
        )

    # ---- the border --------------------------------------------------------------------------------------------

    def _known(self, points: Tensor, known: Mapping[str, Tensor]) -> dict[str, Any]:
        """Further inputs of the effects, leading with the flattened batch."""
        wrong = sorted(set(known) - set(KNOWN))
        if wrong:
            raise InputTypeError(
                f"{type(self).__name__}: unexpected keyword {', '.join(wrong)}; besides points and noise it takes "
                f"{', '.join(KNOWN)}."
            )
        batch, found = points.shape[:-2], {}
        for name, value in known.items():
            tensor = torch.as_tensor(value, device=points.device)
            sizes = {"N": points.shape[-2:-1], "T": tensor.shape[-1:], "": ()}[KNOWN[name]]
            found[name] = tensor.expand((*batch, *sizes)).reshape(math.prod(batch), *sizes)
        return found

    def _through(self, state: RadarState, noise: Mapping[str, Tensor] | None, batch: Sequence[int]) -> RadarState:
        drawn = self.chain.draw(state) if noise is None else self._flat_noise(noise, state, batch)
        found: RadarState = self.chain(state, {key: value.to(state.returns.gain_db) for key, value in drawn.items()})
        return found

    def _marked(self, values: Tensor, state: RadarState, points: Tensor) -> Tensor:
        """The list with what is lost as NaN, where asked for."""
        if self.lost != "nan":
            return values
        clutter = state.returns.kind[:, points.shape[-2] :]
        had_detection = torch.cat([state.scene.range_m > 0, torch.ones_like(clutter, dtype=torch.bool)], 1)
        gone = (state.returns.kind == PointKind.LOST) & had_detection
        first = torch.arange(values.shape[-1], device=values.device) < COLUMNS
        return torch.where(gone[..., None] & first, torch.nan, values)

    def _outgoing(self, values: Tensor, state: RadarState, points: Tensor) -> List:
        """Values ``(B, N, ...)`` as they leave: in the batch's shape, without what is lost if asked for."""
        batch = points.shape[:-2]
        if values.ndim == 3:
            values = values.to(points.dtype)
        if self.lost != "drop":
            return values.reshape(*batch, *values.shape[1:])
        kept = [value[there] for value, there in zip(values, state.returns.kind != PointKind.LOST, strict=True)]
        return kept if batch else kept[0]


def check_detections(points: Tensor, sensor: Radar, owner: object) -> None:
    """Refuse what is no list of detections ``(..., N, 6 or more)``; warn where powers contradict the noise floor."""
    name = type(owner).__name__
    if not isinstance(points, Tensor):
        raise InputTypeError(
            f"{name}: points must be a tensor (..., N, 6 or more); got {type(points).__name__}. For a numpy array call "
            "on_numpy(points)."
        )
    if points.ndim < 2 or points.shape[-1] < COLUMNS:
        raise InputValueError(
            f"{name}: points must have shape (..., N, 6 or more) = {COLUMNS_WANTED}; got {tuple(points.shape)}. A list "
            "without powers gets them from the radar equation: torchweather.physics.received_power_dbm."
        )
    if not points.is_floating_point():
        raise InputTypeError(
            f"{name}: points must be floating point ({COLUMNS_WANTED}); got {points.dtype}. Use .float()."
        )
    if is_exporting() or not points.numel():
        return
    first = points.detach()[..., :COLUMNS]
    # One sum sees every NaN and every infinity, and what is absurdly far; only then is it worth looking for them.
    if not abs(float(first.sum())) < FARTHEST_M:
        _refuse_absurd(first, name)
    _warn_of_floor(first, sensor, name)


def _refuse_absurd(points: Tensor, name: str) -> None:
    bad = ~torch.isfinite(points)
    if bool(bad.any()):
        named = ("x", "y", "z", "speed", "power", "radar cross section")
        columns = ", ".join(named[column] for column in range(COLUMNS) if bool(bad[..., column].any()))
        raise InputValueError(
            f"{name}: points must be finite; got NaN or infinity in {int(bad.any(-1).sum())} rows ({columns}). Give a "
            "row without detection the coordinates 0, 0, 0."
        )
    farthest_m = float(points[..., :3].abs().max())
    if farthest_m >= FARTHEST_M:
        raise InputValueError(
            f"{name}: coordinates must be metres; got {farthest_m:g}, too far for a detection. Give a row without "
            "detection the coordinates 0, 0, 0."
        )


def _warn_of_floor(points: Tensor, sensor: Radar, name: str) -> None:
    threshold = sensor.floor_db + sensor.detection_snr_db
    weak = points[..., POWER] < threshold
    if 2 * int(weak.sum()) <= weak.numel():
        return
    there = (points[..., :3] != 0).any(-1)
    below, count = int((weak & there).sum()), int(there.sum())
    if 2 * below > count:
        warnings.warn(
            f"{name}: {below} of {count} detections have powers below the detection threshold of {threshold:.4g} "
            f"(floor {sensor.floor_db:.4g}, SNR {sensor.detection_snr_db:g} dB); they were detected, so the floor does "
            "not belong to this power column. Set Radar(noise_floor_db=...) in its unit.",
            TorchweatherWarning,
            stacklevel=6,
        )
