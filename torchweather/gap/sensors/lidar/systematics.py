"""Systematic uncertainties of a LiDAR study, which must not be taken for a missing effect.

Each stage here has the strength of one standard deviation of what nobody knows; the search forgets departures along its
response (``search.Systematics``). They are not effects of the catalogue and never an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.lidar.state import LidarState
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.point_kind import PointKind

__all__ = [
    "ClearScale",
    "EchoGain",
    "FogEchoRange",
    "FrameClock",
    "ParticleReading",
    "ParticleReadingScale",
    "WeakSignalNoise",
]


class WeakSignalNoise(Effect):
    """Noise that a signal gains when it grows weaker, as counted photons and a quantised reading have.

    A simulated frame carries the noise of its clear frame, relative to a signal that was stronger. With a relative
    variance ``v / M`` at M times the threshold, weather that takes the signal from M to M' adds ``v (1 / M' - 1 / M)``.

    Args:
        variance_at_threshold: v.
    """

    id: ClassVar[str] = "gap.weak_signal_noise"
    title: ClassVar[str] = "weaker signals are noisier"
    term: ClassVar[str] = "shot noise"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("variance_at_threshold", "1", 0.0, 1.0, scale=1e-3, identity=0.0),
    )
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("margin",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("noise", "normal", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The object's signal, with the noise it lacks."""
        threshold, signal = state.receiver.threshold, state.returns.signal[..., 0]
        lacking = (threshold / signal.clamp_min(1e-30) - threshold / state.scene.clear_signal.clamp_min(1e-30)).clamp(
            0.0, 10.0
        )
        spread = (self.value("variance_at_threshold", signal) * lacking).sqrt()
        noisy = signal * (1.0 + spread * noise["noise"].to(signal)).clamp_min(0.0)
        return {"signal": torch.cat([noisy[..., None], state.returns.signal[..., 1:]], -1)}


class ClearScale(Effect):
    """Scale of the intensities of a scene's clear frames, as far as so few of them leave it open.

    A simulated object has the signal that the clear frames say. Where their mean was read too low, all objects are
    brighter than simulated, and fewer of them fall below the threshold.

    Args:
        log_scale: of the signal of objects.
    """

    id: ClassVar[str] = "gap.clear_scale"
    title: ClassVar[str] = "objects are brighter or fainter than their clear frames say"
    term: ClassVar[str] = "radiometric calibration error"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("log_scale", "1", -2.0, 2.0, scale=5e-3, identity=0.0),)
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("margin",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold: none grows."""
        return 1.0

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal of the objects."""
        objects = state.returns.signal[..., :1] * self.value("log_scale", state.returns.signal).exp()
        return {"signal": torch.cat([objects, state.returns.signal[..., 1:]], -1)}


class ParticleReading(Effect):
    """Noise of the reading of a particle's intensity: objects have their clear frame's, particles have none.

    No nuisance but a part of every simulated frame.

    Args:
        std: relative, as clear frames show it.
    """

    id: ClassVar[str] = "gap.particle_reading"
    title: ClassVar[str] = "readings of particles are as noisy as those of objects"
    term: ClassVar[str] = "reading noise"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("std", "1", 0.0, 1.0, scale=0.02, identity=0.0),)
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("intensity",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("reading", "normal", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal of what was detected."""
        signal = state.returns.signal
        noisy = signal * (1.0 + self.value("std", signal) * noise["reading"].to(signal)[..., None]).clamp_min(0.0)
        return {"signal": torch.where(state.returns.kind == int(PointKind.PARTICLE), noisy, signal)}


class FrameClock(Effect):
    """Range by which the clock of a whole frame is late: objects have their clear frame's, particles have none.

    No nuisance but a part of every simulated frame.

    Args:
        late_m: of each frame.
    """

    id: ClassVar[str] = "gap.frame_clock"
    title: ClassVar[str] = "ranges of particles move with the clock of their frame"
    term: ClassVar[str] = "trigger jitter"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("late_m", "m", -1.0, 1.0, scale=0.01, identity=0.0),)
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("range",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The range of the reported particles."""
        range_m = state.returns.range_m
        moved = (range_m + self.value("late_m", range_m)).clamp_min(0.1)
        return {"range_m": torch.where(state.returns.kind == int(PointKind.PARTICLE), moved, range_m)}


class ParticleReadingScale(Effect):
    """Reading of particles over that of objects: an intensity is calibrated with surfaces at some distance, and what it
    says of a particle beside the sensor nobody has measured. Detection does not know of it.

    Args:
        log_scale: of the intensity of particles.
    """

    id: ClassVar[str] = "gap.particle_reading_scale"
    title: ClassVar[str] = "intensities of particles are read on another scale than those of objects"
    term: ClassVar[str] = "radiometric calibration error in the near range"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("log_scale", "1", -2.0, 2.0, scale=0.02, identity=0.0),)
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("intensity",)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal of the particles that were detected."""
        signal = state.returns.signal
        scaled = signal * self.value("log_scale", signal).exp()
        return {"signal": torch.where(state.returns.kind == int(PointKind.PARTICLE), scaled, signal)}


class EchoGain(Effect):
    """Brightness of particles, as far as it is not known: their albedo and shape; in fog, how far the largest of a few
    noisy readings stands above their mean, which is a matter of the receiver's bandwidth.

    Args:
        share: of the signal of particles, more.
    """

    id: ClassVar[str] = "gap.echo_gain"
    title: ClassVar[str] = "particles are read brighter or fainter"
    term: ClassVar[str] = "backscatter calibration, detection statistics of a soft target"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", -0.9, 9.0, scale=0.05, identity=0.0),)
    after: ClassVar[str] = "particle_returns"
    axes: ClassVar[tuple[str, ...]] = ("kind",)

    def particle_gain(self) -> float:
        """Largest factor of a particle's signal over the threshold, of all samples."""
        return 1.0 + float(self.get_buffer("share").max())

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal of the particles."""
        signal = state.returns.signal
        brighter = signal * (1.0 + self.value("share", signal))
        return {"signal": torch.where(state.returns.kind == int(PointKind.PARTICLE), brighter, signal)}


class FogEchoRange(Effect):
    """Where on its waveform a receiver says that fog is: a matter of its filter, of a fraction of the pulse length.

    Args:
        shift_m: of all returns of fog.
        spread_m: standard deviation of a shift of each.
    """

    id: ClassVar[str] = "gap.fog_echo_range"
    title: ClassVar[str] = "fog is reported nearer or farther"
    term: ClassVar[str] = "range walk of a soft target"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("shift_m", "m", -5.0, 5.0, scale=0.1, identity=0.0),
        Parameter("spread_m", "m", 0.0, 5.0, scale=0.1, identity=0.0),
    )
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("range",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a beam."""
        return (Variate("shift", "normal", ("N",)),)

    def changes(self, state: LidarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The range of the reported particles."""
        range_m = state.returns.range_m
        each = self.value("spread_m", range_m) * noise["shift"].to(range_m)[..., None]
        moved = (range_m + self.value("shift_m", range_m) + each).clamp_min(0.1)
        return {"range_m": torch.where(state.returns.kind == int(PointKind.PARTICLE), moved, range_m)}
