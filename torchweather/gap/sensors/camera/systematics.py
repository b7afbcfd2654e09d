"""Systematic uncertainties of a camera's frames: how much particles stand out, how bright the airlight is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["AirlightError", "ParticleContrast"]


class ParticleContrast(Effect):
    """Contrast of drops and flakes, as far as it is not known: what light they bend in, how blurred they are.

    Args:
        share: of what they change in the picture, more.
    """

    id: ClassVar[str] = "gap.particle_contrast"
    title: ClassVar[str] = "drops and flakes stand out a little more or less"
    term: ClassVar[str] = "photometry of rain streaks"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("share", "1", -0.9, 4.0, scale=0.05, identity=0.0),)
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("streak_contrast",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Change by particles over the modelled."""
        share: Tensor = self.get_buffer("share")
        factor = (1.0 + share.to(state.image.signal)).expand(state.batch)
        return {
            "particle_contrast": factor if state.air.particle_contrast is None else factor * state.air.particle_contrast
        }


class AirlightError(Effect):
    """The airlight as far as the sky of a few noisy frames, or the light that drops show, does not tell it.

    Args:
        red, green, blue: of the airlight, more.
    """

    id: ClassVar[str] = "gap.airlight_error"
    title: ClassVar[str] = "the airlight is a little brighter or darker than the noisy sky says"
    term: ClassVar[str] = "airlight (atmospheric light)"
    arguments: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(colour, "1", -0.9, 4.0, scale=0.005, identity=0.0) for colour in ("red", "green", "blue")
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("depth_m", "colour")

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Light of the sky over the modelled one."""
        more = torch.stack([self.get_buffer(colour).to(state.image.signal) for colour in ("red", "green", "blue")])
        scale = (1.0 + more).expand(state.batch, 3)
        return {"airlight_scale": scale if state.air.airlight_scale is None else scale * state.air.airlight_scale}
