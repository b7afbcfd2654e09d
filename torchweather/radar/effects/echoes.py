"""Effects of radar that list detections more: echoes by a second path and of the weather itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.core.errors import InputValueError
from torchweather.core.random import Variate
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.tiling import is_exporting
from torchweather.radar.clutter import DB, VolumeClutter
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = ["Appending", "RadarMultipath", "RadarVolumeClutter", "listed"]

LOST = int(PointKind.LOST)
SPEED, POWER, RCS = 3, 4, 5  # columns of a list

CLUTTER_ROWS = 256  # that volume clutter appends for each of rain and snow
MAIN_LOBE_BINS = 2.0  # from the peak of a Hann window's response to its first zero
FAINTEST = 1e-6  # of a power over another, so that logarithms of what cancels stay finite


class Appending(Effect):
    """An effect that lists detections more. Built with values that list none it appends no row and draws nothing."""

    silent: ClassVar[str] = "at its identity"

    def __init__(self, **values: float | Sequence[float] | Tensor) -> None:
        super().__init__(**values)
        free = any(getattr(self, parameter.name).requires_grad for parameter in self.arguments)
        self.appends = free or self.lists()

    def variates(self) -> tuple[Variate, ...]:
        """Those of the rows; none where none are appended."""
        return self.own_variates() if self.appends else ()

    def lists(self) -> bool:
        """True if its values add rows to the list."""
        return not bool(self.at_identity.all())

    def own_variates(self) -> tuple[Variate, ...]:
        """Random numbers that the effect needs where it acts."""
        raise NotImplementedError

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state after the effect, with its rows."""
        if not self.appends:
            if not is_exporting() and self.lists():
                raise InputValueError(
                    f"{type(self).__name__}: it was built {self.silent} and so draws nothing; got other values "
                    "since. Build it with values of its own, or with those that require a gradient."
                )
            return self.without_rows(state, noise)
        changed: RadarState = super().forward(state, noise)
        return self.appended(changed, noise)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Nothing but the rows."""
        return {}

    def without_rows(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state where nothing is listed."""
        return state

    def appended(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with the rows; there are none in samples at the identity."""
        raise NotImplementedError


def listed(state: RadarState, rows: Tensor, there: Tensor) -> RadarState:
    """The state with rows ``(B, K, 6)`` behind those that it has, and which of them are there."""
    if state.returns.clutter is not None and state.returns.clutter_valid is not None:
        rows, there = torch.cat([state.returns.clutter, rows], 1), torch.cat([state.returns.clutter_valid, there], 1)
    return state.changed(clutter=rows, clutter_valid=there)


class RadarMultipath(Appending):
    """A second path, longer by a fixed delay: ghosts behind the targets, or lobing where the two are not resolved.

    Through a Hann window two echoes d bins apart meet with ``w = sinc(d) + sinc(d - 1) / 2 + sinc(d + 1) / 2``. The
    target's own cell so holds the power ``|1 + a w exp(j phi)|^2`` of what it held: lobing. Beyond the main lobe, from
    two bins on, a ghost is listed: at R + delay in the same direction and at the same speed, of the target's power
    times ``a^2`` and the weather's loss on the way that is longer.

    Args:
        amplitude: a, of the echo by the second path over that by the first, 0 to 1, a ratio of voltages.
        delay_m: by how much farther a ghost appears, 0.001 to 100 m.

    Note:
        The phase turns once within half a wavelength (2 mm at 77 GHz), less than any geometry is known to: it is drawn
        for each target and frame. A target whose power column lies below the threshold has no ghost. Ghosts are of the
        kind PARTICLE.
    """

    id: ClassVar[str] = "radar.multipath"
    title: ClassVar[str] = "a second path makes ghosts and lobes"
    term: ClassVar[str] = "multipath propagation (ghost targets, lobing)"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("amplitude", "1", 0.0, 1.0, scale=0.2, identity=0.0),
        # Rails and bodies of cars are metres away; the road's path is longer by centimetres.
        Parameter("delay_m", "m", 0.001, 100.0, scale=3.0, default=5.0),
    )
    percollect: ClassVar[str | None] = "Multi-path reflection"
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("ghost_delay_m", "ghost_power_db", "power_spread_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.volume_clutter": "places: ghosts follow their targets, clutter is near and anywhere",
        "radar.fluctuation": "ghosts behind the targets; without them, the law of the powers over many frames",
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        "air.attenuation_db_per_km",
        *("returns.clutter", "returns.gain_db", "returns.kind"),
        "receiver.detection_snr_db",
        "receiver.noise_floor_db",
        "receiver.noise_shift_db",
        "receiver.sensor",
        "receiver.threshold_shift_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.clutter", "returns.clutter_valid", "returns.gain_db")

    def own_variates(self) -> tuple[Variate, ...]:
        """The phase of each target's second path."""
        return (Variate("phase", "uniform", ("N",)),)

    def _together(self, state: RadarState) -> Tensor:
        """w: share of the second echo's amplitude in the target's cell, ``()`` or ``(B, 1)``."""
        assert state.receiver.sensor is not None
        bins = self.value("delay_m", state.returns.gain_db) / state.receiver.sensor.range_resolution_m
        return torch.sinc(bins) + 0.5 * (torch.sinc(bins - 1.0) + torch.sinc(bins + 1.0))

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Gains of the targets."""
        phase = 2.0 * math.pi * noise["phase"].to(state.returns.gain_db)
        second = self.value("amplitude", phase) * self._together(state)
        power = 1.0 + 2.0 * second * phase.cos() + second.square()
        more_db = power.clamp_min(FAINTEST).log() / DB
        return {"gain_db": state.returns.gain_db + torch.where(state.scene.range_m > 0, more_db, 0.0)}

    def appended(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with a row for the ghost of each target."""
        assert state.receiver.sensor is not None
        range_m, power_in = state.scene.range_m, state.scene.points_in[..., POWER]
        amplitude, delay_m = (self.value(name, range_m) for name in ("amplitude", "delay_m"))
        fainter_db = 2.0 * amplitude.clamp_min(FAINTEST).log() / DB
        fainter_db = fainter_db - 2e-3 * state.air.attenuation_db_per_km[:, None] * delay_m
        power_db = power_in + state.returns.gain_db + fainter_db
        ghost_m = range_m + delay_m
        there = (range_m > 0) & (state.returns.kind != LOST) & (power_db >= state.detected_from_db[:, None])
        there = there & (delay_m >= MAIN_LOBE_BINS * state.receiver.sensor.range_resolution_m)
        there = there & (ghost_m < state.receiver.sensor.max_range_m) & (amplitude > 0)
        longer = ghost_m / torch.where(range_m > 0, range_m, 1.0)
        # The radar equation of what is seen there, the weather's loss in it as in all clutter.
        rcs_dbsm = state.scene.points_in[..., RCS] + power_db - power_in + 4.0 * longer.clamp_min(FAINTEST).log() / DB
        place = state.scene.points_in[..., :3] * longer[..., None]
        rows = torch.cat([place, torch.stack([state.scene.points_in[..., SPEED], power_db, rcs_dbsm], -1)], -1)
        rows = torch.where(there[..., None], rows, 0.0)
        return listed(state, rows, there)


class RadarVolumeClutter(Appending):
    """Rain and snow are detected themselves: near, falling with R^-2, at the speeds of falling drops.

    ``VolumeClutter`` with ``share`` times the reflectivity of the modelled weather; 1 is what the radar equation says.

    Args:
        share: of the reflectivity, 0 to 10.

    Note:
        It adds to what the chain has: with ``RadarAttenuation(clutter=True)`` there are ``1 + share``. At most 256
        rows for each of rain and snow, of which four fifths are filled where more cells exceed the threshold; a higher
        share then shows in ranges and powers. Fog has none.

    References:
        PHYSICS.md 6.5.
    """

    id: ClassVar[str] = "radar.volume_clutter"
    title: ClassVar[str] = "the weather itself is detected"
    term: ClassVar[str] = "volume (rain, weather) clutter"
    # A CFAR, which follows the clutter around a cell, lists some 26 detections in rain of 25 mm/h (docs/radar.md);
    # the radar equation says as many at a share of 0.004 (AWR1843-like), and 6900 at 1.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", 0.0, 10.0, scale=0.01, identity=0.0),)
    percollect: ClassVar[str | None] = "Scattering by atm. particles"
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = 2
    axes: ClassVar[tuple[str, ...]] = ("clutter_range_m", "clutter_power_db", "clutter_speed_m_per_s")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.multipath": "ranges: clutter is near and thins out, a ghost stands behind its target",
        "radar.cfar_shift": "powers of the detections that are new, against range",
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor", "weathers", "rates_mm_per_h")
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        *("air.attenuation_db_per_km", "air.extra_m", "air.patches", "air.rates_mm_per_h", "air.weathers"),
        *("returns.clutter", "returns.clutter_valid", "returns.gain_db"),
        "receiver.cover_loss_db",
        "receiver.detection_snr_db",
        "receiver.ego_speed_m_per_s",
        "receiver.noise_floor_db",
        "receiver.noise_shift_db",
        "receiver.pattern_tilt_rad",
        "receiver.sensor",
        "receiver.speed_std_m_per_s",
        "receiver.threshold_shift_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.clutter", "returns.clutter_valid")
    share: Tensor

    def own_variates(self) -> tuple[Variate, ...]:
        """Those of a ``VolumeClutter`` of rain and of one of snow."""
        names = ("arrival", "direction", "azimuth", "elevation", "power")
        each = [Variate(name, "uniform", (CLUTTER_ROWS,)) for name in names]
        each.append(Variate("doppler", "normal", (CLUTTER_ROWS,)))
        return tuple(replace(variate, name=f"{kind}_{variate.name}") for kind in ("rain", "snow") for variate in each)

    def appended(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with the clutter of each weather."""
        assert state.receiver.sensor is not None
        assert state.air.weathers is not None
        assert state.air.rates_mm_per_h is not None
        if is_exporting():
            raise InputValueError(
                "RadarVolumeClutter: no graph can hold it, as it learns from the state what falls. Export "
                "RadarAttenuation(clutter=True), whose share is 1."
            )
        for weather in state.air.weathers:
            if not isinstance(weather, (Rain, Snow)):
                continue
            kind = weather.kind
            stage = _clutter(
                weather, state.receiver.sensor, state.receiver.ego_speed_m_per_s, state.returns.gain_db.device
            )
            values = {"share": self.share, "falling.rate_mm_per_h": state.air.rates_mm_per_h[kind]}
            own = {k.removeprefix(f"{kind}_"): v for k, v in noise.items() if k.startswith(f"{kind}_")}
            state = torch.func.functional_call(stage, values, (state, own))
        return state


@lru_cache(maxsize=16)
def _clutter(weather: Rain | Snow, sensor: Radar, ego_speed_m_per_s: float, device: torch.device) -> VolumeClutter:
    """The stage whose share and rate are then put in."""
    return VolumeClutter(weather, sensor, capacity=CLUTTER_ROWS, ego_speed_m_per_s=ego_speed_m_per_s).to(device)
