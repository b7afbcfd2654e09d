"""AsBayer: weather of a camera on RGB images, in linear light, without a mosaic or by way of one."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Weather
from torchweather.camera.bank_pass import in_training_weather
from torchweather.camera.demosaic import METHODS
from torchweather.camera.depth import EXACT, DepthMap, SceneDepth, check_depth
from torchweather.camera.particles.bank_veil import EXACT_QUALITY
from torchweather.camera.rgb_planes import check_rgb, check_rgb_values, encoded_planes, linear_planes
from torchweather.camera.state import CameraState
from torchweather.camera.through_mosaic import (
    image_of_mosaic,
    mosaic_of_image,
    padded,
    padded_scene,
    padded_size,
)
from torchweather.camera.transform import BayerWeather, CameraResult
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_one_of, check_positive
from torchweather.core.precision import outside_autocast
from torchweather.core.random import sizes_of

__all__ = ["AsBayer", "RgbResult"]

FADING_PLANE = 1  # green stands for all colours in a result's transmission


@dataclass(frozen=True)
class RgbResult:
    """Result of a weather on an RGB image.

    Args:
        rgb: ``(..., 3, H, W)`` the image, in the dtype of the input.
        transmission: ``(..., 1, H, W)`` share of the scene's light that fog lets through (green); 1 without fog.
        airlight: ``(..., 3)`` linear signal of the sky that was used (red, green or clear, blue).
        particle_mask: ``(..., 1, H, W)`` share of the exposure in which particles cover the pixel.
        depth_confidence: how sure the depth is: ``exact``, ``measured``, ``completed`` or ``guessed``.
    """

    rgb: Tensor
    transmission: Tensor
    airlight: Tensor
    particle_mask: Tensor
    depth_confidence: str = EXACT

    sensor: ClassVar[str] = "camera"


class AsBayer(nn.Module):
    """A Bayer transform for RGB images.

    Each image is sRGB-decoded and given the weather in linear light, as three colour planes behind one layer of
    particles, and sRGB-encoded again. Nothing is sampled away: a pixel that the weather does not change keeps its own
    bits, and grey weather on a grey image is grey.

    With ``through_mosaic=True`` the image is sampled by the camera's colour filter array, weathered as a raw frame and
    demosaiced, which adds the sensor's own loss: about 36 dB PSNR on the demo's scene. Compare such images with
    ``without_weather(image)``, which goes the same way.

    Args:
        transform: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather``. A function of the image as its depth
            source is given the RGB image, as depth networks want it. Airlight that is not given is the grey of the sky
            above the horizon.
        through_mosaic: go through the camera's mosaic. Odd heights and widths are then padded by reflection at the
            bottom and right, and cropped back.
        method: of demosaicing, ``malvar`` (sharper) or ``bilinear``; for ``through_mosaic`` alone.

    Note:
        The image is taken for plain sRGB: a camera's own tone curve, sharpening and local contrast are not undone, so
        light is linear only roughly. Sunlight and cast shadows of the clear image stay. Where raw frames exist, use
        them.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.camera.transform import BayerFog
        >>> from torchweather.atmosphere.weather import Fog
        >>> camera = Camera.from_intrinsics(100, 100, 15, 11, 31, 23)
        >>> foggy = AsBayer(BayerFog(Fog(mor_m=50), camera, depth=40.0, airlight=0.7))
        >>> rgb = torch.full((3, 23, 31), 60, dtype=torch.uint8)
        >>> foggy(rgb).shape, foggy(rgb).dtype
        (torch.Size([3, 23, 31]), torch.uint8)
    """

    extra_inputs: ClassVar[Mapping[str, int]] = {"depth": 3}
    data_shape: ClassVar[tuple[str, ...]] = ("3", "H", "W")

    def __init__(self, transform: BayerWeather, *, through_mosaic: bool = False, method: str = "malvar") -> None:
        check_arguments(
            "AsBayer(through_mosaic: bool, method: str)",
            through_mosaic,
            method,
        )
        super().__init__()
        if not isinstance(transform, BayerWeather):
            raise InputTypeError(
                "AsBayer: transform must be a Bayer transform, such as BayerFog(Fog(mor_m=50), camera); got "
                f"{type(transform).__name__}."
            )
        check_one_of("method", method, METHODS, owner=self)
        if method != METHODS[0] and not through_mosaic:
            raise InputValueError(
                f"AsBayer: method={method!r} demosaics, and there is no mosaic here. Give through_mosaic=True with it."
            )
        self.transform = transform
        self.through_mosaic = through_mosaic
        self.method = method

    def extra_repr(self) -> str:
        """The way, and the demosaicing method on it."""
        return f"through_mosaic=True, method={self.method!r}" if self.through_mosaic else ""

    # ---- calls -------------------------------------------------------------------------------------------------

    @outside_autocast
    def forward(
        self,
        rgb: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """The image in this weather.

        Args:
            rgb: ``(..., 3, H, W)`` sRGB, uint8, uint16 or float in 0..1.
            depth: ``(..., 1, H, W)`` metres along the optical axis, infinity is sky; or a ``SceneDepth``; ``None``
                takes the transform's source.
            noise: what ``draw`` gave; ``None`` draws.
            seed: for a call that draws: an integer s for the samples s, s + 1, ..., or a tensor of the batch shape.
            generator: likewise, a torch generator that gives these integers.

        Returns:
            ``(..., 3, H, W)`` in the dtype of ``rgb``. The inputs are not changed.
        """
        if not isinstance(rgb, Tensor) or rgb.ndim < 3:
            check_rgb(rgb, "AsBayer")  # refuses it
        must_draw = self.transform.must_draw(noise, seed, generator)
        if self.transform.quality != EXACT_QUALITY:
            found = self.in_training_weather(rgb, depth, noise, seed, generator)
            if found is not None:
                return found
        if must_draw:
            if self.transform.draws_alone and rgb.ndim > 3 and rgb.numel():
                return self.transform.each_alone(self.forward, rgb, seed, generator, {"depth": depth}, 3)
            inner, seeds = self.transform.at_call(rgb.shape[:-3], seed, generator)
            chosen = AsBayer(inner, through_mosaic=self.through_mosaic, method=self.method)
            return chosen.forward(rgb, depth, chosen._drawn_for_call(rgb, seeds))
        if self.through_mosaic:
            before, inner, scene = self._raw(rgb, depth)
            return image_of_mosaic(before, inner(before, scene, noise), rgb, inner.camera, self.method)
        state, after, _ = self._planes(rgb, depth, noise, keep_truth=False)
        return encoded_planes(after.image.signal.reshape(rgb.shape), state.image.signal.reshape(rgb.shape), rgb)

    if TYPE_CHECKING:
        __call__ = forward

    def in_training_weather(
        self,
        rgb: Tensor,
        depth: Tensor | SceneDepth | None,
        noise: Mapping[str, Tensor] | None = None,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
        rates_mm_per_h: Sequence[float] | None = None,
        airlight: Any = None,
    ) -> Tensor | None:
        """The image in weather of training quality by look-ups alone; ``None`` where that takes more.

        Args:
            rgb, depth, noise, seed, generator: as of ``forward``.
            rates_mm_per_h: of each image, in place of the transform's own.
            airlight: likewise; ``None`` is the transform's.
        """
        if self.through_mosaic:
            return None
        self._check(rgb)
        inner = self._inner(*rgb.shape[-2:])
        return in_training_weather(inner, rgb, depth, noise, seed, generator, rates_mm_per_h, airlight)

    def with_weather(self, weather: Weather) -> AsBayer:
        """The same for another weather; tables that both need are shared."""
        check_arguments("AsBayer.with_weather(weather: Weather)", weather)
        inner: Any = self.transform.with_weather(weather)
        return AsBayer(inner, through_mosaic=self.through_mosaic, method=self.method)

    def at_ego_speed(self, ego_speed_m_per_s: float) -> AsBayer:
        """The same seen from the vehicle at another speed; see ``BayerWeather.at_ego_speed``."""
        inner = self.transform.at_ego_speed(ego_speed_m_per_s)
        return AsBayer(inner, through_mosaic=self.through_mosaic, method=self.method)

    @outside_autocast
    def run(
        self,
        rgb: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> RgbResult:
        """The image, and with it transmission, airlight, particle mask and how sure the depth is."""
        if not isinstance(rgb, Tensor) or rgb.ndim < 3:
            check_rgb(rgb, "AsBayer")  # refuses it
        if self.transform.must_draw(noise, seed, generator):
            if self.transform.draws_alone and rgb.ndim > 3 and rgb.numel():
                return self.transform.each_alone(self.run, rgb, seed, generator, {"depth": depth}, 3)
            inner, seeds = self.transform.at_call(rgb.shape[:-3], seed, generator)
            chosen = AsBayer(inner, through_mosaic=self.through_mosaic, method=self.method)
            return chosen.run(rgb, depth, chosen._drawn_for_call(rgb, seeds))
        batch, (height, width) = rgb.shape[:-3], rgb.shape[-2:]
        if self.through_mosaic:
            before, inner, scene = self._raw(rgb, depth)
            result: CameraResult = inner.run(before, scene, noise)
            return RgbResult(
                rgb=image_of_mosaic(before, result.bayer, rgb, inner.camera, self.method),
                transmission=result.transmission[..., :height, :width],
                airlight=result.airlight,
                particle_mask=result.particle_mask[..., :height, :width],
                depth_confidence=result.depth_confidence,
            )
        state, after, scene = self._planes(rgb, depth, noise, keep_truth=True)
        transmission, airlight, mask = self.transform.truth_of(state, after)
        return RgbResult(
            rgb=encoded_planes(after.image.signal.reshape(rgb.shape), state.image.signal.reshape(rgb.shape), rgb),
            transmission=transmission[:, FADING_PLANE].reshape(*batch, 1, height, width),
            airlight=airlight.reshape(*batch, 3),
            particle_mask=mask.reshape(*batch, 1, height, width),
            depth_confidence=scene.confidence,
        )

    @outside_autocast
    def draw(
        self,
        rgb: Tensor,
        depth: Tensor | SceneDepth | None = None,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
        *,
        at_rate: bool = False,
    ) -> dict[str, Tensor]:
        """Noise for an image (or a batch).

        Args:
            rgb: the image; only its shape counts.
            depth: ignored, so that ``draw`` takes what ``forward`` takes.
            generator: takes one integer per sample from it; ``None`` is torch's global generator.
            seed: the integers themselves: a tensor of the batch shape, or one integer s for s, s + 1, ...
            at_rate: draw only what the present rates need, as in ``BayerWeather.draw``.
        """
        check_arguments("AsBayer.draw(at_rate: bool)", at_rate)
        self._check(rgb)
        height, width = rgb.shape[-2:]
        if self.through_mosaic:
            height, width = padded_size(height, width)
            frame = torch.zeros(()).expand(*rgb.shape[:-3], 1, height, width)
            return self._inner(height, width).draw(frame, None, generator, seed, at_rate=at_rate)
        return self.transform.drawn(rgb.shape[:-3], sizes_of(height, width, 3), generator, seed, at_rate=at_rate)

    def draw_for_call(self, value: Tensor, seed: int) -> dict[str, Tensor]:
        """Noise of one image for one call at the present rates, with keys in place of the haze's normals."""
        return self._drawn_for_call(value, seed)

    def _drawn_for_call(self, rgb: Tensor, seed: int | Tensor) -> dict[str, Tensor]:
        self._check(rgb)
        (height, width), planes, inner = rgb.shape[-2:], 3, self.transform
        if self.through_mosaic:
            (height, width), planes = padded_size(height, width), 1
            inner = self._inner(height, width)
        return inner.drawn(rgb.shape[:-3], sizes_of(height, width, planes), None, seed, at_rate=True, keyed=True)

    @outside_autocast
    def draw_sequence(
        self,
        rgb: Tensor,
        frames: int,
        frame_interval_s: float,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
        *,
        ego_speeds_m_per_s: Sequence[float] | None = None,
    ) -> Iterator[dict[str, Tensor]]:
        """Noise of successive frames in which particles move; arguments as ``BayerWeather.draw_sequence``."""
        self._check(rgb)
        check_at_least("frames", frames, 1, owner=self)
        check_positive("frame_interval_s", frame_interval_s, unit="s", owner=self)
        if self.through_mosaic:
            height, width = padded_size(*rgb.shape[-2:])
            frame = torch.zeros(()).expand(*rgb.shape[:-3], 1, height, width)
            inner = self._inner(height, width)
            return inner.draw_sequence(
                frame, frames, frame_interval_s, generator, seed, ego_speeds_m_per_s=ego_speeds_m_per_s
            )
        return self.transform.sequence_of(rgb, frames, frame_interval_s, generator, seed, ego_speeds_m_per_s)

    def without_weather(self, rgb: Tensor) -> Tensor:
        """The clear image to compare images in weather with: the image itself, or by way of the mosaic alone.

        Args:
            rgb: as in ``forward``.

        Returns:
            ``(..., 3, H, W)`` in the dtype of ``rgb``.
        """
        self._check(rgb)
        check_rgb_values(rgb, "AsBayer")
        if not self.through_mosaic:
            return rgb
        inner = self._inner(*padded_size(*rgb.shape[-2:]))
        return image_of_mosaic(None, mosaic_of_image(rgb, inner.camera), rgb, inner.camera, self.method)

    # ---- colour planes -------------------------------------------------------------------------------------------

    def _planes(
        self,
        rgb: Tensor,
        depth: Tensor | SceneDepth | None,
        noise: Mapping[str, Tensor] | None,
        *,
        keep_truth: bool,
    ) -> tuple[CameraState, CameraState, SceneDepth]:
        """State before and after the weather, and the scene."""
        self._check(rgb)
        check_rgb_values(rgb, "AsBayer")
        height, width = rgb.shape[-2:]
        inner = self._inner(height, width)
        scene = inner.scene_of(rgb, depth)
        linear = linear_planes(rgb).reshape(-1, 3, height, width)
        state = inner.planes_state(linear, scene, rgb.shape[:-3], keep_truth=keep_truth)
        return state, inner.weathered(state, noise, rgb.shape[:-3]), scene

    # ---- the mosaic ----------------------------------------------------------------------------------------------

    def _raw(
        self, rgb: Tensor, depth: Tensor | SceneDepth | None
    ) -> tuple[Tensor, BayerWeather, SceneDepth | Tensor | None]:
        """Mosaic of the padded image as the camera's raw float frame, the transform for its size, and the scene."""
        self._check(rgb)
        check_rgb_values(rgb, "AsBayer")
        size = padded_size(*rgb.shape[-2:])
        inner = self._inner(*size)
        return mosaic_of_image(rgb, inner.camera), inner, self._padded_depth(rgb, depth, size)

    def _padded_depth(
        self, rgb: Tensor, depth: Tensor | SceneDepth | None, size: tuple[int, int]
    ) -> SceneDepth | Tensor | None:
        height, width = rgb.shape[-2:]
        source = self.transform.depth_source
        if depth is None:
            if source is None:
                return None  # the transform explains what is missing
            if isinstance(source, DepthMap) and tuple(source.depth_m.shape[-2:]) == size:
                return source.depth_m.to(rgb.device)
            depth = self._inner(height, width).scene_of(rgb, None)
        if isinstance(depth, SceneDepth):
            check_depth(depth.depth_m, height, width, owner=self)
            return padded_scene(depth, *size)
        if not isinstance(depth, Tensor) or tuple(depth.shape[-2:]) != (height, width):
            return depth  # of the padded size already, or refused by the transform
        return padded(depth, *size)

    def _check(self, rgb: Tensor) -> None:
        check_rgb(rgb, "AsBayer")
        height, width = rgb.shape[-2:]
        camera = self.transform.camera
        if (camera.height, camera.width) not in {(height, width), padded_size(height, width)}:
            raise InputValueError(
                f"AsBayer: the image is {height} x {width} px, the camera {camera.height} x {camera.width}. Use "
                "camera.resized(width, height) for a scaled image or camera.cropped(top, left, height, width) for a "
                "window."
            )

    def _inner(self, height: int, width: int) -> BayerWeather:
        """The transform, its camera enlarged by the padding, or without it; the padding is at the right and bottom,
        so the principal point stays.
        """
        camera = self.transform.camera
        if (camera.height, camera.width) == (height, width):
            return self.transform
        inner = copy.copy(self.transform)  # shares stages and buffers
        inner.camera = replace(camera, height=height, width=width)
        inner.forget_rays()
        return inner
