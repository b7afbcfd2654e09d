"""Effects of LiDAR that lie in its receiver and its firmware.

Bounds and typical sizes are orders of magnitude where no source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.lidar.effects.air import signal_gain
from torchweather.lidar.intensity import reflectivity_from_intensity
from torchweather.lidar.stages import DB, exponential
from torchweather.lidar.state import LidarState
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind

__all__ = [
    "LidarBlindZone",
    "LidarCrosstalk",
    "LidarIntensityCompression",
    "LidarIsolatedReturnFilter",
    "LidarLastReturn",
    "LidarRangeBias",
    "LidarRangeNoise",
    "LidarRangeStretch",
    "LidarRingGain",
    "LidarThresholdShift",
]

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))

CROSSTALK_MARGIN_DB = 3.0  # mean margin of a spurious point over the threshold; order of magnitude
FAINTEST_RATIO = 1e-12  # of signals, so that logarithms and powers of a wiped signal stay finite


class LidarIsolatedReturnFilter(Effect):
    """The firmware removes lone points: a return that none of its eight neighbours on the scan has near its range.

    The scan's columns close to a ring; its first and last row have neighbours on one side.

    Args:
        probability: that a lone return is removed, 0 to 1.
        radius_m: range within which a neighbour's return counts as one of the same thing, 0.01 to 50 m.

    Note:
        For organised clouds: the sensor tells its rings and columns, and the cloud has a row for each beam.
    """

    id: ClassVar[str] = "lidar.isolated_return_filter"
    title: ClassVar[str] = "the firmware removes lone points"
    term: ClassVar[str] = "isolated-point (outlier, salt-and-pepper) filter"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("probability", "1", 0.0, 1.0, scale=0.5, identity=0.0),
        Parameter("radius_m", "m", 0.01, 50.0, scale=0.5, default=1.0),
    )
    after: ClassVar[str] = "detection"
    rank: ClassVar[int] = 2
    axes: ClassVar[tuple[str, ...]] = ("neighbours", "kind")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.last_return": "particles in front of the sky: a filter removes the lone ones, the last return none",
        "lidar.blind_zone": "ranges of the particles that are missing",
    }
    needs: ClassVar[tuple[str, ...]] = ("grid",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.grid"),
        *("returns.kind", "returns.range_m", "returns.signal"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("removal", "uniform", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The reported returns without the lone ones."""
        assert state.scene.grid is not None
        rows, columns = state.scene.grid
        shape = state.returns.range_m.shape
        # NaN is near nothing, itself included.
        reported_m = torch.where(state.returns.kind != LOST, state.returns.range_m, torch.nan).reshape(
            -1, rows, columns, shape[-1]
        )
        accompanied = self._accompanied(reported_m).reshape(shape)
        tossed = noise["removal"].to(state.scene.clear_range_m)
        removed = (tossed < self.value("probability", tossed))[..., None] & ~accompanied
        return {
            "range_m": torch.where(removed, 0.0, state.returns.range_m),
            "signal": torch.where(removed, 0.0, state.returns.signal),
            "kind": torch.where(removed, LOST, state.returns.kind),
        }

    def _accompanied(self, range_m: Tensor) -> Tensor:
        """Mask of the returns with one beside them within the radius, ``(B, rows, columns, E)``; each pair once."""
        found = torch.zeros_like(range_m, dtype=torch.bool)
        upper_m, lower_m = range_m[:, :-1], range_m[:, 1:]
        sideways = range_m.shape[2] > 1  # a single column is no neighbour of itself
        if sideways:
            own, other = self._near(range_m, range_m.roll(-1, 2))
            found |= own | other.roll(1, 2)
        for step in (-1, 0, 1) if sideways else (0,):
            own, other = self._near(upper_m, lower_m.roll(step, 2))
            found[:, :-1] |= own
            found[:, 1:] |= other.roll(-step, 2)
        return found

    def _near(self, one_m: Tensor, other_m: Tensor) -> tuple[Tensor, Tensor]:
        """Masks of the echoes of each of two beams that have one of the other within the radius."""
        apart = (one_m[..., :, None] - other_m[..., None, :]).abs()
        near = apart <= self.value("radius_m", apart)
        return near.any(-1), near.any(-2)


class LidarThresholdShift(Effect):
    """The receiver's detection threshold is higher or lower; the intensity of what is still seen stays.

    Args:
        shift_db: of the power that is detected, -10 to 10 dB; above 0 fewer returns.

    Note:
        Readings of fog below a tenth of the threshold are not drawn, so -10 dB are the least. Beams that end nowhere in
        clear air stay without a surface, although a more sensitive receiver sees some that were too faint.
    """

    id: ClassVar[str] = "lidar.threshold_shift"
    title: ClassVar[str] = "the detection threshold is another"
    term: ClassVar[str] = "detection threshold"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("shift_db", "dB", -10.0, 10.0, scale=2.0, identity=0.0),)
    percollect: ClassVar[str | None] = "Detection threshold"
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = -3
    axes: ClassVar[tuple[str, ...]] = ("margin_db",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.window_loss": "intensities; without them the two are one",
    }
    not_simulated: ClassVar[tuple[str, ...]] = ("particles_of_empty_beams", "new_share_of_empty_beams")
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("receiver.threshold", "receiver.threshold_scale", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("receiver.threshold_scale",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold, of all samples."""
        return float(signal_gain(-self.get_buffer("shift_db")).max())

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Threshold over the sensor's."""
        return {"threshold_scale": signal_gain(self.value("shift_db", state.receiver.threshold)).expand(state.batch)}


class LidarBlindZone(Effect):
    """Returns nearer than a range are suppressed, of objects and particles.

    Args:
        range_m: 0 to 50 m.
        loss_db: of the receiver within that range, in dB of the signal, 0 or more. The default, infinity, lets nothing
            through. A receiver that wakes up late has some 30 dB: the nearest flakes are seen all the same.
    """

    id: ClassVar[str] = "lidar.blind_zone"
    title: ClassVar[str] = "near returns are suppressed"
    term: ClassVar[str] = "blind zone (minimum range, near-range blanking)"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("range_m", "m", 0.0, 50.0, scale=3.0, identity=0.0),
        Parameter("loss_db", "dB", 0.0, math.inf, scale=10.0, default=math.inf),
    )
    percollect: ClassVar[str | None] = "Object closer than min. distance"
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.isolated_return_filter": "ranges of the particles that are missing"
    }
    cuts: ClassVar[bool] = True
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("returns.range_m", "returns.signal")
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals, weaker in the zone or 0."""
        signal, range_m = state.returns.signal, state.returns.range_m
        left = torch.pow(10.0, -0.1 * self.value("loss_db", signal))
        return {"signal": torch.where(range_m < self.value("range_m", range_m), left * signal, signal)}


class LidarRangeNoise(Effect):
    """Timing jitter: the range of every reported return gets a normal error more.

    Args:
        std_m: 0 to 5 m.

    Note:
        Both returns of a dual-return sensor share the error, as they share the start of the pulse.
    """

    id: ClassVar[str] = "lidar.range_noise"
    title: ClassVar[str] = "ranges scatter more"
    term: ClassVar[str] = "range noise (timing jitter)"
    # Data sheets give 0.01 to 0.1 m.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("std_m", "m", 0.0, 5.0, scale=0.03, identity=0.0),)
    percollect: ClassVar[str | None] = "Standard deviated measuring error"
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("range_residual_spread",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.range_stretch": "the sign of the residual, and whether it grows with the optical depth"
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m")
    writes: ClassVar[tuple[str, ...]] = ("returns.range_m",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("jitter", "normal", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Ranges of the reported returns."""
        error_m = self.value("std_m", state.returns.range_m) * noise["jitter"].to(state.returns.range_m)[..., None]
        return {"range_m": _moved(state, error_m)}


class LidarRangeBias(Effect):
    """Ranges are off by an offset and by a walk with the signal: ``R + offset + walk log10(X / X_thr)``.

    Args:
        offset_m: -5 to 5 m.
        walk_m_per_decade: metres for ten times the signal, -1 to 1; a stronger pulse crosses the threshold earlier,
            which is a walk below 0.
    """

    id: ClassVar[str] = "lidar.range_bias"
    title: ClassVar[str] = "ranges are off"
    term: ClassVar[str] = "range offset and range walk"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset_m", "m", -5.0, 5.0, scale=0.05, identity=0.0),
        Parameter("walk_m_per_decade", "m/decade", -1.0, 1.0, scale=0.03, identity=0.0),
    )
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("range_residual_mean", "margin_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.range_stretch": "the residual against optical depth at a fixed signal"
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.range_m",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Ranges of the reported returns."""
        like = state.returns.range_m
        decades = torch.log10((state.returns.signal / _over_echoes(state.detected_from)).clamp_min(FAINTEST_RATIO))
        error_m = self.value("offset_m", like) + self.value("walk_m_per_decade", like) * decades
        return {"range_m": _moved(state, error_m)}


def _moved(state: LidarState, error_m: Tensor) -> Tensor:
    """Ranges with an error on the reported returns, not below 0."""
    return torch.where(
        state.returns.kind != LOST, (state.returns.range_m + error_m).clamp_min(0.0), state.returns.range_m
    )


def _over_echoes(value: Tensor) -> Tensor:
    """``()`` or ``(B, 1)`` shaped to broadcast over ``(B, N, E)``."""
    return value[..., None] if value.ndim else value


class LidarLastReturn(Effect):
    """The sensor reports the last echo: particles in front of an object that is detected vanish, others stay.

    Args:
        probability: that a beam does so, 0 to 1.
    """

    id: ClassVar[str] = "lidar.last_return"
    title: ClassVar[str] = "the last echo is reported"
    term: ClassVar[str] = "last-return mode"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("probability", "1", 0.0, 1.0, scale=0.5, identity=0.0),)
    percollect: ClassVar[str | None] = "Multiple echos per beam"
    after: ClassVar[str] = "particle_returns"
    rank: ClassVar[int] = 2
    axes: ClassVar[tuple[str, ...]] = ("kind", "object_behind")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.isolated_return_filter": "particles in front of the sky: a filter removes the lone ones, the last "
        "return none",
        "lidar.crosstalk": "clear frames, and ranges behind the particles",
    }
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "scene.clear_range_m",
        *("returns.kind", "returns.signal"),
        *("receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("mode", "uniform", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals of the particles, 0 in front of a detected object."""
        tossed = noise["mode"].to(state.scene.clear_range_m)
        object_seen = (state.returns.kind[..., 0] == OBJECT) & (state.returns.signal[..., 0] >= state.detected_from)
        silent = object_seen & (tossed < self.value("probability", tossed))
        return {"signal": torch.where((state.returns.kind == PARTICLE) & silent[..., None], 0.0, state.returns.signal)}


class LidarIntensityCompression(Effect):
    """The receiver's response is curved, or ends: intensities change, detections do not.

    ``rho^exponent`` of the reported reflectivity, which is 1 for a white surface: against the clear frame, which was
    taken with the straight response, the ratio depends on the intensity itself. A particle counts with its equivalent
    reflectivity ``pi X R^2``, an intensity in photons in units of the threshold's. No intensity exceeds the saturation.

    Args:
        exponent: 0.1 to 5; below 1 faint returns look brighter.
        saturation: largest intensity in the input's unit, 0 to infinity.
    """

    id: ClassVar[str] = "lidar.intensity_compression"
    title: ClassVar[str] = "the intensity's response is curved or ends"
    term: ClassVar[str] = "non-linear response, saturation"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("exponent", "1", 0.1, 5.0, scale=0.3, identity=1.0),
        Parameter("saturation", "1", 0.0, math.inf, scale=100.0, identity=math.inf),
    )
    percollect: ClassVar[str | None] = "Saturation of photodiode"
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("intensity",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.window_loss": "numbers of detections, which a response leaves alone",
        "lidar.threshold_shift": "numbers of detections, which a response leaves alone",
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_signal", "scene.points_in"),
        *("returns.kind", "returns.range_m", "returns.signal"),
        "receiver.sensor",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals of the reported returns."""
        level = self._level(state).clamp_min(FAINTEST_RATIO)
        signal = state.returns.signal * level ** (self.value("exponent", level) - 1.0)
        capped = torch.minimum(signal, self._largest(state))
        return {"signal": torch.where(state.returns.kind == LOST, state.returns.signal, capped)}

    def _level(self, state: LidarState) -> Tensor:
        """Reflectivity that each return is reported with, or its photons over those at the threshold, ``(B, N, E)``."""
        assert state.receiver.sensor is not None
        sensor, intensity, clear = (
            state.receiver.sensor,
            state.scene.points_in[..., 3:4],
            state.scene.clear_signal[..., None],
        )
        if sensor.intensity_unit == "photons":
            own, particle = intensity / sensor.photons_at_threshold, state.returns.signal / state.receiver.threshold
        else:
            own = reflectivity_from_intensity(intensity, sensor.intensity_unit, sensor.assumed_reflectivity)
            particle = math.pi * state.returns.signal * state.returns.range_m.square()
        seen = clear > 0
        return torch.where(
            (state.returns.kind == OBJECT) & seen, own * state.returns.signal / torch.where(seen, clear, 1.0), particle
        )

    def _largest(self, state: LidarState) -> Tensor:
        """Signal at which each return's intensity is the saturation, ``(B, N, E)``."""
        assert state.receiver.sensor is not None
        sensor, intensity = state.receiver.sensor, state.scene.points_in[..., 3]
        saturation = self.value("saturation", intensity).expand_as(intensity)
        if sensor.intensity_unit == "none":
            return torch.full_like(state.returns.signal, torch.inf)
        if sensor.intensity_unit == "photons":
            own, limit = intensity, saturation
            particle = (limit * state.receiver.threshold / sensor.photons_at_threshold)[..., None]
        else:
            own = reflectivity_from_intensity(intensity, sensor.intensity_unit, sensor.assumed_reflectivity)
            limit = reflectivity_from_intensity(saturation, sensor.intensity_unit, sensor.assumed_reflectivity)
            particle = limit[..., None] / (math.pi * state.returns.range_m.square().clamp_min(FAINTEST_RATIO))
        # An intensity of 0 has no limit; an infinite one times a signal of 0 is none either.
        gain = torch.where(own > 0, limit / torch.where(own > 0, own, 1.0), torch.inf)
        signal = torch.where(state.scene.clear_signal > 0, state.scene.clear_signal, 1.0) * gain
        return torch.where(state.returns.kind == PARTICLE, particle, signal[..., None])


class LidarRangeStretch(Effect):
    """Multiple scattering delays the light: ranges grow with the optical depth, ``R + m tau``.

    tau is the one-way optical depth of the weather in front of the return.

    Args:
        m_per_optical_depth: metres for an optical depth of 1, 0 to 10.
    """

    id: ClassVar[str] = "lidar.range_stretch"
    title: ClassVar[str] = "scattered light arrives late"
    term: ClassVar[str] = "pulse stretching by multiple scattering"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("m_per_optical_depth", "m", 0.0, 10.0, scale=0.1, identity=0.0),
    )
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("range_residual_mean", "optical_depth")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.range_noise": "the sign of the residual, and whether it grows with the optical depth",
        "lidar.range_bias": "the residual against optical depth at a fixed signal",
    }
    needs: ClassVar[tuple[str, ...]] = ("extinction_per_m",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("air.extinction_per_m", "air.path_density", "air.reach_m"),
        *("returns.kind", "returns.range_m"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.range_m",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Ranges of the reported returns."""
        assert state.air.extinction_per_m is not None
        # The weather may end in front of the return.
        inside_m = torch.minimum(state.returns.range_m, state.air.reach_m[..., None])
        if state.air.path_density is not None:
            inside_m = inside_m * state.air.path_density[..., None]
        depth = state.air.extinction_per_m[:, None, None] * inside_m
        return {"range_m": _moved(state, self.value("m_per_optical_depth", depth) * depth)}


class LidarCrosstalk(Effect):
    """Spurious points: a beam reports, instead of what it sees, light of another source, at any range.

    Uniform between the sensor's minimum and maximum range, in clear frames as in weather; margins over the threshold
    are exponential with a mean of 3 dB. A beam whose direction is not known reports none.

    Args:
        probability: for each beam, 0 to 1.
    """

    id: ClassVar[str] = "lidar.crosstalk"
    title: ClassVar[str] = "spurious points appear at any range"
    term: ClassVar[str] = "crosstalk (interference), dark counts"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("probability", "1", 0.0, 1.0, scale=0.003, identity=0.0),)
    percollect: ClassVar[str | None] = "Crosstalk"
    after: ClassVar[str] = "detection"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("particle_range_m", "rate")
    unmodelled: ClassVar[tuple[str, ...]] = ("log_particle_intensity", "log_particle_intensity_spread")
    confusable_with: ClassVar[Mapping[str, str]] = {"lidar.last_return": "clear frames, and ranges behind the objects"}
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    each_beam_alone: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.empty_direction"),
        *("returns.kind", "returns.range_m", "returns.signal"),
        *("receiver.sensor", "receiver.threshold", "receiver.threshold_scale"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.range_m", "returns.signal")

    def variates(self) -> tuple[Variate, ...]:
        """Variates of spurious points: presence, place and strength."""
        return tuple(Variate(name, "uniform", ("N",)) for name in ("hit", "place", "margin"))

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The first reported return, replaced where a beam is hit."""
        assert state.receiver.sensor is not None
        like = state.scene.clear_range_m
        hit, place, margin = (noise[name].to(like) for name in ("hit", "place", "margin"))
        known = like > 0
        if state.scene.empty_direction is not None:
            known = known | (state.scene.empty_direction != 0).any(-1)
        spurious = (hit < self.value("probability", like)) & known
        near_m, far_m = state.receiver.sensor.min_range_m, state.receiver.sensor.max_range_m
        own = {
            "range_m": far_m - (far_m - near_m) * place,
            "signal": state.detected_from * torch.exp(DB * CROSSTALK_MARGIN_DB * exponential(margin)),
            "kind": torch.full_like(state.returns.kind[..., 0], PARTICLE),
        }
        return {name: self._with_first(state.field(name), new, spurious) for name, new in own.items()}

    @staticmethod
    def _with_first(echoes: Tensor, new: Tensor, where: Tensor) -> Tensor:
        first = torch.where(where, new, echoes[..., 0])
        return torch.cat([first[..., None], echoes[..., 1:]], -1)


class LidarRingGain(Effect):
    """The gain differs from ring to ring: all signals times a power that is linear in the ring, in dB, 0 in the middle.

    Args:
        db_per_ring: -1 to 1 dB from one ring to the next of the grid.

    Note:
        For organised clouds, whose row is the ring.
    """

    id: ClassVar[str] = "lidar.ring_gain"
    title: ClassVar[str] = "the gain differs from ring to ring"
    term: ClassVar[str] = "per-ring (per-channel) gain calibration"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("db_per_ring", "dB", -1.0, 1.0, scale=0.03, identity=0.0),)
    percollect: ClassVar[str | None] = "Photon response non-uniformity noise"
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("ring",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lidar.sector_loss": "intensities against azimuth",
        "lidar.wet_target": "intensities of particles, and of surfaces of one ring at different incidence",
    }
    needs: ClassVar[tuple[str, ...]] = ("grid",)
    reads: ClassVar[tuple[str, ...]] = ("returns.signal", "scene.grid")
    writes: ClassVar[tuple[str, ...]] = ("returns.signal",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Signals with the gain of their ring."""
        assert state.scene.grid is not None
        rows, columns = state.scene.grid
        from_middle = torch.arange(rows, device=state.returns.signal.device) - 0.5 * (rows - 1)
        of_beam = from_middle.to(state.returns.signal)[:, None].expand(rows, columns).reshape(1, -1, 1)
        return {"signal": state.returns.signal * signal_gain(self.value("db_per_ring", state.returns.signal) * of_beam)}
