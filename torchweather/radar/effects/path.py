"""Effects of radar that lie on the way to the targets and back: air, cover, antenna, targets.

Powers are in dB, two way. Bounds and typical sizes are orders of magnitude where no source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import nested_shape
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.core.random import Variate
from torchweather.physics import wet_cover_loss_db
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.clutter import DB
from torchweather.radar.state import RadarState

__all__ = [
    "RadarFluctuation",
    "RadarPathLossScale",
    "RadarPatternTilt",
    "RadarWetRadome",
    "RadarWetRcs",
]

LOST = int(PointKind.LOST)


class RadarWetRadome(Effect):
    """Water on the radar's cover: every target weaker by the same, whatever its range; the noise floor stays.

    ``loss_db + film_db (R / 1 mm/h)^film_exponent``, out and back together, with the rate R of the rain. A film left by
    rain that is over dries with ``exp(-t / drying_min)``; of several the thickest counts (``physics/wet_cover.py``,
    which has the same for a series, as a microwave link needs it).

    Args:
        loss_db: of a film that does not depend on the rain, 0 to 30 dB.
        film_db: of the film at 1 mm/h, 0 to 20 dB.
        film_exponent: of the rate, 0 to 2; a film that runs off under gravity grows with the cube root of the flow.
        drying_min: minutes in which a film dries to 1 / e, 0.1 to 600; counts where the state knows of earlier rain.

    References:
        PHYSICS.md 6.7. Kurri and Huuskonen 2008 (J. Atmos. Oceanic Technol. 25, 1590; abstract seen): 3 dB two way at
        15 mm/h on a dirty radome at C band, which is 1.2 dB at 1 mm/h with the cube root.
    """

    id: ClassVar[str] = "radar.wet_radome"
    title: ClassVar[str] = "the cover is wet"
    term: ClassVar[str] = "wet radome (wet antenna) attenuation"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("loss_db", "dB", 0.0, 30.0, scale=2.0, identity=0.0),
        Parameter("film_db", "dB", 0.0, 20.0, scale=1.0, identity=0.0),
        # Nusselt's film, as in Blevis 1965 (IEEE Trans. Antennas Propag. 13, 175), primary text not seen.
        Parameter("film_exponent", "1", 0.0, 2.0, scale=0.3, default=1.0 / 3.0),
        # Wetting takes 5 to 20 min at 38 GHz (Schleiss et al. 2013, abstract seen); drying is taken to be alike.
        Parameter("drying_min", "min", 0.1, 600.0, scale=10.0, default=10.0),
    )
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("power_ratio_db", "rate", "time")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.path_loss_scale": "power over clear air's against range: a cover costs the same at every range",
        "radar.wet_rcs": "targets of different classes, and the clutter of the rain, which a cover weakens too",
        "radar.noise_floor": "powers, which a noise floor leaves alone",
    }
    needs: ClassVar[tuple[str, ...]] = ("rates_mm_per_h",)
    reads: ClassVar[tuple[str, ...]] = (
        "scene.range_m",
        *("air.past_rain_min", "air.past_rain_mm_per_h", "air.rates_mm_per_h"),
        "returns.gain_db",
        "receiver.cover_loss_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("receiver.cover_loss_db", "returns.gain_db")

    def two_way_db(self, state: RadarState) -> Tensor:
        """Present loss of the cover, ``(B,)``."""
        assert state.air.rates_mm_per_h is not None
        like = state.receiver.cover_loss_db
        rain = state.air.rates_mm_per_h.get("rain", torch.zeros_like(like)).to(like)[:, None]
        age = torch.zeros_like(rain)
        if state.air.past_rain_mm_per_h is not None and state.air.past_rain_min is not None:
            rain = torch.cat([rain, state.air.past_rain_mm_per_h.to(like)], 1)
            age = torch.cat([age, state.air.past_rain_min.to(like)], 1)
        return wet_cover_loss_db(rain, age, *(self.value(parameter.name, like) for parameter in self.arguments))

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains, and the cover's own loss, which clutter has too."""
        loss = self.two_way_db(state)
        of_targets = torch.where(state.scene.range_m > 0, loss[:, None], 0.0)
        return {"gain_db": state.returns.gain_db - of_targets, "cover_loss_db": state.receiver.cover_loss_db + loss}


class RadarPathLossScale(Effect):
    """The weather takes more or less on the way than modelled: ``2 gamma R`` times a factor.

    Args:
        factor: of the attenuation, 0 to 10.
    """

    id: ClassVar[str] = "radar.path_loss_scale"
    title: ClassVar[str] = "the path takes more or less power than modelled"
    term: ClassVar[str] = "specific attenuation"
    # Rain of other drops: 27 % between P.838 and Marshall-Palmer's (PHYSICS.md 6.5); snow a factor of 3 to 10 (6.7).
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("factor", "1", 0.0, 10.0, scale=0.5, identity=1.0),)
    percollect: ClassVar[str | None] = "Attenuation by atm. aerosol particles and accumulated hydrometeors"
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = -1
    axes: ClassVar[tuple[str, ...]] = ("range_m", "power_ratio_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.wet_radome": "power over clear air's against range: a line through 0 dB at the radar, or a constant"
    }
    reads: ClassVar[tuple[str, ...]] = ("air.attenuation_db_per_km", "returns.gain_db", "scene.range_m")
    writes: ClassVar[tuple[str, ...]] = ("air.attenuation_db_per_km", "returns.gain_db")

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains of the targets, and the attenuation of the air, which clutter has too."""
        per_km, factor = state.air.attenuation_db_per_km, self.value("factor", state.air.attenuation_db_per_km)
        more_db = 2e-3 * ((factor - 1.0) * per_km)[:, None] * state.scene.range_m
        return {"gain_db": state.returns.gain_db - more_db, "attenuation_db_per_km": factor * per_km}


class RadarPatternTilt(Effect):
    """The antenna's pattern is turned: powers change by ``2 (G(azimuth - angle) - G(azimuth))``, out and back.

    The radar still reports true azimuths. Clutter turns with the pattern.

    Args:
        angle_rad: from x to y, that is to the left, -0.5 to 0.5 rad.

    Note:
        G is the pattern of one element (``Radar.gain_dbi``), which ends 30 dB below its peak.
    """

    id: ClassVar[str] = "radar.pattern_tilt"
    title: ClassVar[str] = "the antenna's pattern is turned"
    term: ClassVar[str] = "antenna misalignment (beam pointing error)"
    # A tenth of a radian is 6 degrees: mounts are adjusted to a degree or so, a bent one is off by several.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("angle_rad", "rad", -0.5, 0.5, scale=0.05, identity=0.0),)
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("azimuth_rad", "power_ratio_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.wet_rcs": "targets of one class on both sides: a turned pattern gains on one and loses on the other",
        "radar.wet_radome": "power over clear air's against azimuth",
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        "returns.gain_db",
        *("receiver.cover_loss_db", "receiver.pattern_tilt_rad", "receiver.sensor"),
    )
    writes: ClassVar[tuple[str, ...]] = ("receiver.pattern_tilt_rad", "returns.gain_db")

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains by direction, and the tilt, which clutter follows."""
        assert state.receiver.sensor is not None
        x, y, z = state.scene.points_in[..., :3].unbind(-1)
        azimuth = torch.atan2(y, torch.where(state.scene.range_m > 0, x, 1.0))
        elevation = torch.asin((z / torch.where(state.scene.range_m > 0, state.scene.range_m, 1.0)).clamp(-1.0, 1.0))
        off = azimuth - self.value("angle_rad", azimuth)
        off = off - 2.0 * math.pi * (off / (2.0 * math.pi)).round()
        more_db = 2.0 * (
            state.receiver.sensor.gain_dbi(off, elevation) - state.receiver.sensor.gain_dbi(azimuth, elevation)
        )
        tilt = self.value("angle_rad", state.receiver.cover_loss_db).expand(state.batch)
        gain_db = state.returns.gain_db + torch.where(state.scene.range_m > 0, more_db, 0.0)
        return {"gain_db": gain_db, "pattern_tilt_rad": plus(state.receiver.pattern_tilt_rad, tilt)}


@dataclass(frozen=True)
class PerClass(Parameter):
    """A number for each class of target: one for all classes, ``(classes,)``, or ``(B, classes)``."""

    def tensor(self, value: float | Sequence[float] | Tensor, owner: object) -> Tensor:
        """The values within the bounds as float32; anything else is refused."""
        try:
            if nested_shape(value) is None:
                raise InputTypeError("no numbers")
            found = torch.as_tensor(value, dtype=torch.float32)
        except (TypeError, ValueError, RuntimeError, OverflowError) as error:
            raise InputValueError(
                f"{type(owner).__name__}: {self.name} must be numbers; got {value!r:.100}."
            ) from error
        if found.ndim > 2:
            raise InputValueError(
                f"{type(owner).__name__}: {self.name} must be one number, one for each class, (classes,), or those for "
                f"each sample, (B, classes); got {tuple(found.shape)}."
            )
        super().tensor(found.reshape(-1), owner)
        return found


class RadarWetRcs(Effect):
    """Wet targets reflect more or less than dry ones, each class by its own.

    Args:
        gain_db: of the radar cross section, -20 to 20 dB: one number for all classes, one for each, ``(classes,)``, in
            the order of ``target_class`` from 0, or ``(B, classes)``. Classes beyond, and those not known (below 0),
            stay.

    Note:
        The column of the cross section stays, as it does in weather.
    """

    id: ClassVar[str] = "radar.wet_rcs"
    title: ClassVar[str] = "wet targets reflect more or less"
    term: ClassVar[str] = "radar cross section of wet targets"
    # Metal stays as it is but for a film; wet cloth and leaves reflect more than dry ones: order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (PerClass("gain_db", "dB", -20.0, 20.0, scale=2.0, identity=0.0),)
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("target_class", "power_ratio_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.wet_radome": "targets of different classes; with one class the two are one",
        "radar.pattern_tilt": "targets of one class at different azimuths",
    }
    needs: ClassVar[tuple[str, ...]] = ("target_class",)
    reads: ClassVar[tuple[str, ...]] = ("returns.gain_db", "scene.points_in", "scene.range_m", "scene.target_class")
    writes: ClassVar[tuple[str, ...]] = ("returns.gain_db",)
    gain_db: Tensor

    @property
    def at_identity(self) -> Tensor:
        """True where no class changes, ``()`` or ``(B,)`` bool."""
        none = torch.eq(self.gain_db, 0.0)
        return none.all(-1) if none.ndim else none

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains by class."""
        assert state.scene.target_class is not None
        given = self.gain_db.to(state.returns.gain_db)
        classes = state.scene.target_class.long().expand(state.batch, -1)
        known = torch.where((classes >= 0) & (state.scene.range_m > 0), 1.0, 0.0).to(given)
        if not given.ndim:
            return {"gain_db": state.returns.gain_db + known * given}
        of_class = given.expand(state.batch, -1)
        count = of_class.shape[-1]
        own = of_class.gather(1, classes.clamp(0, count - 1))
        return {"gain_db": state.returns.gain_db + known * torch.where(classes < count, own, 0.0)}


class RadarFluctuation(Effect):
    """Each target's power fluctuates from frame to frame, log-normally about the same mean power.

    ``s n - s^2 ln(10) / 20`` dB with a standard normal n for each target and frame.

    Args:
        log_std_db: s, 0 to 15 dB. The exponential power of Swerling's case 1 spreads by 5.6 dB.

    References:
        Swerling 1960 (IRE Trans. Inf. Theory 6, 269), primary text not seen; the 5.6 dB are
        ``10 pi / (sqrt(6) ln 10)``, the spread of the logarithm of an exponential variate.
    """

    id: ClassVar[str] = "radar.fluctuation"
    title: ClassVar[str] = "powers fluctuate from frame to frame"
    term: ClassVar[str] = "target fluctuation (Swerling), scintillation"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("log_std_db", "dB", 0.0, 15.0, scale=2.0, identity=0.0),)
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("power_spread_db", "frame")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.interference": "powers: an interferer raises the floor of a frame and leaves them alone",
        "radar.multipath": "ghosts behind the targets, and the law of the powers: two waves have a largest sum",
    }
    reads: ClassVar[tuple[str, ...]] = ("returns.gain_db", "scene.range_m")
    writes: ClassVar[tuple[str, ...]] = ("returns.gain_db",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a target."""
        return (Variate("power", "normal", ("N",)),)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains of the targets."""
        drawn = noise["power"].to(state.returns.gain_db)
        std = self.value("log_std_db", drawn)
        more_db = std * drawn - 0.5 * DB * std.square()
        return {"gain_db": state.returns.gain_db + torch.where(state.scene.range_m > 0, more_db, 0.0)}


def plus(before: Tensor | None, more: Tensor) -> Tensor:
    """The sum, where ``None`` is 0."""
    return more if before is None else before + more


def of_state(effect: Effect, name: str, state: RadarState) -> Tensor:
    """A parameter as one number for each sample, ``(B,)``."""
    return effect.value(name, state.receiver.cover_loss_db).expand(state.batch)
