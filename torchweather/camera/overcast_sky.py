"""OvercastSky: the grey of an overcast sky in place of the picture's, behind rain and snow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, Snow, weather_from_dict
from torchweather.camera.airlight import REC709, Airlight, airlight_argument, given_or_estimated
from torchweather.camera.state import CameraState
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage

__all__ = ["OvercastSky"]

# Sine of the elevation at which the sky has the level of the airlight: its light on level ground is that of an even sky
# of 7/9 of the zenith, and (1 + 2 sin e) / 3 is 7/9 there.
LEVEL_SINE = 2.0 / 3.0
TRACE_MM_PER_H = 0.1  # a trace of precipitation, half of whose sky is overcast: the sky closes in without a jump


@register
class OvercastSky(Stage):
    """The CIE overcast sky, ``L(e) = L_zenith (1 + 2 sin e) / 3`` (CIE S 011), where the picture shows sky.

    The sky closes in with the rate R as ``R / (R + 0.1 mm/h)``, so that no rain leaves the picture as it is.

    Identity: rate 0.

    Args:
        weathers: rain, snow or both, or their dictionaries.
        airlight: grey level at 42 degrees, linear; ``None`` takes the luminance of the picture's sky.

    Note:
        Sunlight and cast shadows on the ground stay.
    """

    default_name: ClassVar[str] = "overcast_sky"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.sine_elevation", "scene.sky"),
        "air.lamp_light",
        "image.signal",
        "receiver.cfa_index",
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def __init__(
        self,
        weathers: Sequence[Rain | Snow | Mapping[str, Any]],
        airlight: Sequence[float] | float | str | Mapping[str, float] | None = None,
    ) -> None:
        super().__init__()
        self.weathers = [one if isinstance(one, (Rain, Snow)) else weather_from_dict(one) for one in weathers]
        for one in self.weathers:
            if not isinstance(one, (Rain, Snow)):
                raise InputTypeError(f"OvercastSky: weathers must be Rain or Snow; got {type(one).__name__}.")
        self.given: Airlight = airlight_argument(airlight, self)
        rates = [torch.as_tensor(one.intensity, dtype=torch.float32).reshape(-1) for one in self.weathers]
        total = rates[0]
        for rate in rates[1:]:
            total = total + rate
        self.register_buffer("rate_mm_per_h", total)
        self.rate_mm_per_h: Tensor

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        given = list(self.given) if isinstance(self.given, tuple) else self.given
        return {"weathers": [one.to_dict() for one in self.weathers], "airlight": given}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The frame under its new sky."""
        if state.scene.sine_elevation is None:
            raise InputValueError("OvercastSky: expected a state with the elevation of its rays; this one has none.")
        sky = (
            torch.isinf(state.scene.depth_m).to(state.image.signal.dtype)
            if state.scene.sky is None
            else state.scene.sky
        )
        rate = self.rate_mm_per_h.to(state.image.signal)
        share = (rate / (rate + TRACE_MM_PER_H)).view(-1, 1, 1, 1) * sky
        light = given_or_estimated("grey" if self.given is None else self.given, state, self)
        level = (light * light.new_tensor(REC709)).sum(1).view(-1, 1, 1, 1)
        up = state.scene.sine_elevation.to(state.image.signal).clamp_min(0.0)
        overcast = (level * (1.0 + 2.0 * up) / (1.0 + 2.0 * LEVEL_SINE)).clamp_max(1.0)
        return state.changed(signal=torch.lerp(state.image.signal, overcast.expand_as(state.image.signal), share))
