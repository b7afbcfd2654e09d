"""NightLamps, OwnLight and LampVeil: the lamps of a night scene, and their light on surfaces and fog."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather, weather_from_dict
from torchweather.camera.airlight import frame_mean
from torchweather.camera.fog import FADING_COLOUR, ExtinctionAndAirlight
from torchweather.camera.night.found_lamps import BRIGHT, LampInView, found_lamps, lamp_in_view
from torchweather.camera.night.lamp_light import (
    LEAST_DISTANCE_M,
    FogOptics,
    LampLight,
    fog_optics,
    lamp_light,
    stacked,
)
from torchweather.camera.night.lamps import FIND, Night, as_night
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning, check_positive
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["DAY_ABOVE", "LampVeil", "NightLamps", "OwnLight"]

DAY_ABOVE = 0.15  # of saturation, mean of a frame: a night frame is darker, its lamps included
# A surface hides a lamp where it is nearer by more than this: a car's front holds its lamps, and depths err.
LAMP_IN_FRONT_M, DEPTH_ERROR = 0.5, 0.05
SURFACE_ALBEDO = 0.15  # of a street, to tell how much of a surface's light comes from the own headlamps


@register
class NightLamps(Stage):
    """Lamps of a night scene, before any weather: which there are, how bright beyond saturation, what they light.

    A given lamp behind a surface that is nearer is left out, unless the frame shows a bright spot there.

    A lamp saturates the frame: the light beyond it is taken from its intensity. In fog it fades from there, and its
    glow is that light, scattered onward (``multiple_scattering.py``).

    Identity: it changes no pixel.

    Note:
        It stands in front of effects of the scene, so that a wet road mirrors its lamps. What
        ``camera.extinction_scale`` changes reaches the fog, and not the light of lamps on it.

    Args:
        night: lamps and exposure, or its dictionary.
        weathers: what is in the air, or their dictionaries.
        wavelengths_nm: of the colours red, green (or clear) and blue.
        far_m: depth up to which particles are lit.
    """

    default_name: ClassVar[str] = "night_lamps"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.sky"),
        "image.signal",
        *("receiver.camera", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.sky"),
        *("air.lamp_excess", "air.lamp_light"),
    )

    def __init__(
        self,
        night: Night | Mapping[str, Any],
        weathers: Sequence[Weather | Mapping[str, Any]],
        wavelengths_nm: Sequence[float],
        far_m: float = 200.0,
    ) -> None:
        check_arguments(
            "NightLamps(weathers: Sequence, wavelengths_nm: Sequence[float], far_m: float)",
            weathers,
            wavelengths_nm,
            far_m,
        )
        super().__init__()
        found = as_night(night, self)
        if found is None:
            raise InputValueError("NightLamps: night must be a Night; got False.")
        self.night, self.far_m = found, float(far_m)
        self.wavelengths_nm = tuple(float(one) for one in wavelengths_nm)
        self.weathers = [one if isinstance(one, Weather) else weather_from_dict(one) for one in weathers]
        fogs = [one for one in self.weathers if isinstance(one, Fog)]
        self.fog = ExtinctionAndAirlight(fogs[0], self.wavelengths_nm) if fogs else None

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "night": self.night.to_dict(),
            "weathers": [one.to_dict() for one in self.weathers],
            "wavelengths_nm": list(self.wavelengths_nm),
            "far_m": self.far_m,
        }

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The state with its lamps."""
        if is_exporting():
            raise InputValueError(
                "NightLamps: night cannot be exported; its lamps are looked for in each frame. Export without night."
            )
        assert state.receiver.camera is not None
        self._warn_of_day(state)
        camera = state.receiver.camera
        self._warn_of_near_lamps(camera.height_m)
        excess = torch.zeros_like(state.image.signal)
        depth_m = state.scene.depth_m.expand(state.batch, -1, -1, -1).clone()
        sky = None if state.scene.sky is None else state.scene.sky.expand(state.batch, -1, -1, -1).clone()
        lights = []
        for sample in range(state.batch):
            seen, outside = self._lamps(state, sample)
            for lamp in seen:
                self._put(lamp, sample, state, excess, depth_m, sky)
            in_view = [lamp.lamp for lamp in seen]
            lights.append(
                lamp_light(
                    camera,
                    depth_m[sample, 0].float(),
                    self.far_m,
                    self.night.own_lamps,
                    outside,
                    in_view,
                    self._optics(state, sample),
                    next((one for one in self.weathers if isinstance(one, Rain)), None),
                    next((one for one in self.weathers if isinstance(one, Snow)), None),
                    self.night.saturation_cd_per_m2,
                )
            )
        light = _on_device(stacked(lights), state.image.signal)
        return state.changed(depth_m=depth_m, sky=sky, lamp_excess=excess, lamp_light=light)

    def _lamps(self, state: CameraState, sample: int) -> tuple[list[LampInView], list[Any]]:
        """Lamps of others in the picture, and those outside of it."""
        camera, size = state.receiver.camera, state.image.signal.shape[-2:]
        assert camera is not None
        if self.night.lamps == FIND:
            return found_lamps(state, sample, self.night, camera), []
        seen, outside = [], []
        for lamp in self.night.given_lamps:
            mosaic = state.receiver.cfa_index is not None
            view = lamp_in_view(lamp, (size[0], size[1]), camera, self.night, mosaic=mosaic)
            if view is None:
                outside.append(lamp)
            elif not self._hidden(view, sample, state):
                seen.append(view)
        return seen, outside

    @staticmethod
    def _hidden(lamp: LampInView, sample: int, state: CameraState) -> bool:
        """Occlusion of a lamp: a surface in front of all of its pixels, and no bright spot of the frame there."""
        rows, columns = (torch.from_numpy(one).to(state.scene.depth_m.device) for one in (lamp.rows, lamp.columns))
        depth_m = state.scene.depth_m[min(sample, len(state.scene.depth_m) - 1), 0, rows, columns]
        nearest_m = lamp.depth_m * (1.0 - DEPTH_ERROR) - LAMP_IN_FRONT_M
        shown = state.image.signal[sample][:, rows, columns].max()
        return bool(depth_m.max() < nearest_m) and float(shown) < BRIGHT

    def _put(
        self,
        lamp: LampInView,
        sample: int,
        state: CameraState,
        excess: Tensor,
        depth_m: Tensor,
        sky: Tensor | None,
    ) -> None:
        """Write a lamp's light beyond the frame's, its depth, and that no sky is there; in place."""
        rows, columns = (torch.from_numpy(one).to(excess.device) for one in (lamp.rows, lamp.columns))
        light = excess.new_tensor(lamp.signal)
        index = state.receiver.cfa_index
        if index is None:
            before = state.image.signal[sample, :, rows, columns]
            excess[sample, :, rows, columns] = (light[:, None] - before).clamp_min(0.0)
        else:
            own = light[index.to(excess.device)[rows % 2, columns % 2]]
            excess[sample, 0, rows, columns] = (own - state.image.signal[sample, 0, rows, columns]).clamp_min(0.0)
        depth_m[sample, 0, rows, columns] = depth_m[sample, 0, rows, columns].clamp_max(lamp.depth_m)
        if sky is not None:
            sky[sample, 0, rows, columns] = 0.0

    def _optics(self, state: CameraState, sample: int) -> FogOptics | None:
        if self.fog is None:
            return None
        mor_m = self.fog.mor_m.reshape(-1)
        own_m = float(mor_m[min(sample, len(mor_m) - 1)].detach())
        extinction = self.fog.extinction_per_m(state.batch)[sample, FADING_COLOUR].detach()
        if not float(extinction) > 0.0:
            return None
        return fog_optics(self.fog.weather, own_m, float(extinction), self.wavelengths_nm[FADING_COLOUR])

    def _warn_of_day(self, state: CameraState) -> None:
        mean = frame_mean(state).mean(1)
        if bool((mean > DAY_ABOVE).any()):
            warnings.warn(
                f"{type(self).__name__}: night is asked for, and the mean of a frame is {float(mean.max()):.2f} of "
                f"saturation, above {DAY_ABOVE:g}: this looks like day. Leave night out for frames taken by day.",
                TorchweatherWarning,
                stacklevel=4,
            )

    def _warn_of_near_lamps(self, height_m: float) -> None:
        """Warn of lamps nearer to the camera than the distance up to which their light grows."""
        for lamp in (*self.night.own_lamps, *self.night.given_lamps):
            distance_m = math.dist(lamp.position_m, (0.0, 0.0, height_m))
            if distance_m < LEAST_DISTANCE_M:
                warnings.warn(
                    f"{type(self).__name__}: a lamp at position_m={lamp.position_m} is {distance_m:.2g} m from the "
                    f"camera, which is at (0, 0, {height_m:g}). Air and particles nearer to a lamp than "
                    f"{LEAST_DISTANCE_M:g} m are lit as from {LEAST_DISTANCE_M:g} m: too dark in front of the lens. "
                    f"Place lamps at least {LEAST_DISTANCE_M:g} m from the camera.",
                    TorchweatherWarning,
                    stacklevel=4,
                )


def _on_device(light: LampLight, like: Tensor) -> LampLight:
    names = ("fog", "drop", "flake", "on_surface", "own_fade", "colour")
    return LampLight(**{name: getattr(light, name).to(like.device) for name in names}, far_m=light.far_m)


@register
class OwnLight(Stage):
    """Surfaces in the light of the own headlamps: darker by the fog between the headlamps and them.

    The share of a surface's light that is theirs is what a surface of albedo 0.15 would show of it, up to all of it.

    Identity: no fog.

    Args:
        fog: or its dictionary.
        saturation_cd_per_m2: luminance that saturates the camera.
    """

    default_name: ClassVar[str] = "own_light"
    reads: ClassVar[tuple[str, ...]] = ("scene.depth_m", "air.lamp_light", "image.signal")
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)
    mor_m: Tensor

    def __init__(self, fog: Fog | Mapping[str, Any], saturation_cd_per_m2: float) -> None:
        check_arguments("OwnLight(fog: Fog | Mapping, saturation_cd_per_m2: float)", fog, saturation_cd_per_m2)
        super().__init__()
        check_positive("saturation_cd_per_m2", saturation_cd_per_m2, unit="cd/m2", owner=self)
        given = fog if isinstance(fog, Weather) else weather_from_dict(fog)
        if not isinstance(given, Fog):
            raise InputTypeError(f"OwnLight: fog must be Fog; got {type(given).__name__}.")
        self.fog, self.saturation_cd_per_m2 = given, float(saturation_cd_per_m2)
        self.register_buffer("mor_m", torch.as_tensor(given.mor_m, dtype=torch.float32))

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"fog": self.fog.to_dict(), "saturation_cd_per_m2": self.saturation_cd_per_m2}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The scene as the own headlamps light it through the fog."""
        light = state.air.lamp_light
        if light is None:
            return state
        depth_m = state.scene.depth_m.to(state.image.signal)
        shown = light.seen(light.on_surface, depth_m) * (SURFACE_ALBEDO / torch.pi / self.saturation_cd_per_m2)
        share = (shown / state.image.signal.clamp_min(1e-6)).clamp(0.0, 1.0)
        share = torch.where(torch.isfinite(depth_m), share, 0.0)
        lit = state.image.signal * (1.0 - share * (1.0 - light.seen(light.own_fade, depth_m)))
        foggy = torch.isfinite(self.mor_m).reshape(-1, 1, 1, 1)  # elsewhere the frame keeps its own bits
        return state.changed(signal=torch.where(foggy, lit, state.image.signal))


@register
class LampVeil(Stage):
    """Light of headlamps that the fog sends back: a veil over the picture, up to what each pixel shows.

    Identity: no fog.
    """

    default_name: ClassVar[str] = "lamp_veil"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.near_mask"),
        "air.lamp_light",
        "image.signal",
        "receiver.cfa_index",
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def config(self) -> dict[str, Any]:
        """Constructor arguments: none."""
        return {}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The frame behind the veil."""
        if state.air.lamp_light is None:
            return state
        veil = state.air.lamp_light.seen(state.air.lamp_light.fog, state.scene.depth_m.to(state.image.signal))
        veil = of_own_colour(veil, state)
        if state.scene.near_mask is not None:
            veil = veil * (1.0 - state.scene.near_mask.to(veil))
        return state.changed(signal=state.image.signal + veil)


def of_own_colour(planes: Tensor, state: CameraState) -> Tensor:
    """Colour planes ``(B, 3, H, W)``; of a mosaic, each pixel's own colour, ``(B, 1, H, W)``."""
    index = state.receiver.cfa_index
    if index is None:
        return planes
    height, width = planes.shape[-2:]
    own = index.to(planes.device).repeat(height // 2, width // 2)
    return planes.gather(1, own.expand(planes.shape[0], 1, height, width))
