"""Effects of a camera's pixels and converter, behind the optics and in front of the quantisation.

Signals are linear in light, black 0 and saturation 1; what exceeds saturation is saturation. Bounds and typical sizes
are orders of magnitude where no source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.core.random import Variate
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["CameraExposureGain", "CameraSaturation", "CameraSensorNoise", "CameraToneCurve"]

DARKEST = 1e-12  # keeps slopes finite at black


class CameraExposureGain(Effect):
    """The exposure or the gain is another: the whole picture is brighter or darker, ``f I``.

    Args:
        factor: f, 0 to 10.
    """

    id: ClassVar[str] = "camera.exposure_gain"
    title: ClassVar[str] = "the exposure is another"
    term: ClassVar[str] = "exposure, gain"
    # Automatic exposure answers weather within a stop, a factor of 2; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("factor", "1", 0.0, 10.0, scale=0.2, identity=1.0),)
    after: ClassVar[str] = "particle_veil"
    rank: ClassVar[int] = 5
    axes: ClassVar[tuple[str, ...]] = ("intensity", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.airlight_scale": "surfaces at several depths: a gain acts on near ones as well, airlight on far ones",
        "camera.vignetting": "the ratio against image radius",
        "camera.tone_curve": "the ratio against intensity: a gain's is the same at all",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal, brighter."""
        return {"signal": (self.value("factor", state.image.signal) * state.image.signal).clamp_max(1.0)}


class CameraSensorNoise(Effect):
    """More noise of the pixels than the clear frame carries: shot noise of the photo-electrons, and readout noise.

    ``I + n sqrt(I / K + (r / K)^2)`` with one standard normal n a pixel and K electrons for a signal of 1: the
    variance is a line in the mean (EMVA 1288, photon transfer). The converter has no value below black.

    Args:
        electrons_per_unit: K, electrons at saturation, 1 to infinity.
        read_electrons: r, standard deviation of the readout, 0 to 1000 electrons; with an infinite K it counts nothing.

    Note:
        Normal in place of Poisson: right from some ten electrons on.
    """

    id: ClassVar[str] = "camera.sensor_noise"
    title: ClassVar[str] = "pixels are noisier"
    term: ClassVar[str] = "photon shot noise and readout noise"
    # Pixels of 2 to 4 um hold some ten thousand electrons and are read with a few; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("electrons_per_unit", "1", 1.0, math.inf, scale=10000.0, identity=math.inf),
        Parameter("read_electrons", "1", 0.0, 1000.0, scale=4.0, identity=0.0),
    )
    after: ClassVar[str] = "exposure_control"
    rank: ClassVar[int] = 6
    axes: ClassVar[tuple[str, ...]] = ("variance", "intensity")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.streak_contrast": "variance against intensity at one depth, and the correlation of neighbours: streaks "
        "reach over several pixels",
        "camera.particle_count": "variance of pixels whose scene is near: few particles are in front of it",
    }
    each_frame_anew: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a pixel."""
        return (Variate("electrons", "normal", ("C", "H", "W")),)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal with its noise."""
        per_electron = 1.0 / self.value("electrons_per_unit", state.image.signal)
        read = self.value("read_electrons", state.image.signal) * per_electron
        variance = state.image.signal * per_electron + read.square()
        noisy = state.image.signal + noise["electrons"].to(state.image.signal) * variance.clamp_min(DARKEST**2).sqrt()
        return {"signal": noisy.clamp(0.0, 1.0)}


class CameraSaturation(Effect):
    """Pixels saturate early: ``min(I, level)``.

    Args:
        level: highest signal, 0 to infinity.
    """

    id: ClassVar[str] = "camera.saturation"
    title: ClassVar[str] = "bright pixels saturate"
    term: ClassVar[str] = "saturation, full-well capacity"
    # The converter's own is 1: anything below is early.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("level", "1", 0.0, math.inf, scale=0.8, identity=math.inf),)
    after: ClassVar[str] = "exposure_control"
    rank: ClassVar[int] = 7
    axes: ClassVar[tuple[str, ...]] = ("intensity",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.tone_curve": "the slope in the middle of the range, which saturation leaves alone"
    }
    cuts: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal, cut."""
        return {"signal": torch.minimum(state.image.signal, self.value("level", state.image.signal))}


class CameraToneCurve(Effect):
    """The response is curved: ``I^gamma``; black and saturation stay.

    Args:
        gamma: 0.2 to 5; below 1 the dark parts look brighter.
    """

    id: ClassVar[str] = "camera.tone_curve"
    title: ClassVar[str] = "the response is curved"
    term: ClassVar[str] = "tone curve, gamma, non-linearity"
    # Display gamma is 2.2 (IEC 61966-2-1); a linear sensor is straight within some percent.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("gamma", "1", 0.2, 5.0, scale=0.2, identity=1.0),)
    after: ClassVar[str] = "exposure_control"
    rank: ClassVar[int] = 8
    axes: ClassVar[tuple[str, ...]] = ("intensity",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.exposure_gain": "the ratio against intensity at one depth: a gain's is the same at all",
        "camera.saturation": "the slope in the middle of the range, which saturation leaves alone",
        "camera.stray_light": "black pixels: a curve leaves them black",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The signal through the curve."""
        gamma = self.value("gamma", state.image.signal)
        # The slope at black would be infinite or lost.
        curved = state.image.signal.clamp_min(DARKEST) ** gamma
        return {"signal": torch.where(state.image.signal > 0, curved, state.image.signal)}
