"""AsBayer: weather of a raw camera on RGB images, by way of the mosaic that the camera would have recorded."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from torchweather.camera.depth import DepthMap
from torchweather.errors import check_one_of
from torchweather.image.bayer import mosaic
from torchweather.image.demosaic import METHODS, demosaic
from torchweather.image.tone import compand, expand, normalise, quantise, srgb_decode, srgb_encode
from torchweather.transforms.camera import BayerWeather, CameraResult
from torchweather.weather import Weather

__all__ = ["AsBayer", "RgbResult"]

SMALLEST_PX = 4  # a mosaic needs two 2 x 2 cells in each direction to be demosaiced
INTEGER_DTYPES = (torch.uint8, torch.uint16)


@dataclass(frozen=True)
class RgbResult:
    """What the weather did to an RGB image.

    Args:
        rgb: ``(..., 3, H, W)`` the image, in the dtype of the input.
        transmission: ``(..., 1, H, W)`` share of the scene's light that fog lets through; 1 without fog.
        airlight: ``(..., 3)`` linear signal of the sky that was used (red, green or clear, blue).
        particle_mask: ``(..., 1, H, W)`` share of the exposure in which particles cover the pixel.
    """

    rgb: Tensor
    transmission: Tensor
    airlight: Tensor
    particle_mask: Tensor


class AsBayer(nn.Module):
    """A Bayer transform for RGB images: RGB, linear light, mosaic, weather, demosaic, RGB.

    Each image is sRGB-decoded, sampled by the camera's colour filter array, given the weather, demosaiced and
    sRGB-encoded again. An image whose mosaic the weather leaves unchanged (rate 0, visibility infinite) comes back
    bit for bit; any other image has gone through the mosaic as a whole, so that its sharpness is the same everywhere.

    Odd heights and widths are padded by reflection at the bottom and right, and cropped back; the camera may have the
    size of the image or of the padded image.

    Args:
        transform: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather``. A function of the image as its depth
            source is given the RGB image, as depth networks want it.
        method: ``malvar`` (sharper) or ``bilinear`` demosaicing.

    Note:
        What it costs: two thirds of the samples are dropped and interpolated again. Detail of one or two pixels
        blurs or gets false colours and a fine grid: 36 dB PSNR on the demo's scene, see ``docs/as_bayer.md``. The
        other assumption is that the image is plain sRGB: a camera's own tone curve, sharpening and local contrast are
        not undone, so light is linear only roughly. Where raw frames exist, use them.

    Example:
        >>> from torchweather.sensors import Camera
        >>> from torchweather.transforms.camera import BayerFog
        >>> from torchweather.weather import Fog
        >>> camera = Camera.from_intrinsics(100, 100, 15, 11, 31, 23)
        >>> foggy = AsBayer(BayerFog(Fog(mor_m=50), camera, depth=40.0, airlight=0.7))
        >>> rgb = torch.full((3, 23, 31), 60, dtype=torch.uint8)
        >>> foggy(rgb).shape, foggy(rgb).dtype
        (torch.Size([3, 23, 31]), torch.uint8)
    """

    def __init__(self, transform: BayerWeather, *, method: str = "malvar") -> None:
        super().__init__()
        if not isinstance(transform, BayerWeather):
            raise TypeError(
                "AsBayer: transform must be a Bayer transform, such as BayerFog(Fog(mor_m=50), camera); got "
                f"{type(transform).__name__}."
            )
        check_one_of("method", method, METHODS, owner=self)
        self.transform = transform
        self.method = method

    def extra_repr(self) -> str:
        """The demosaicing method."""
        return f"method={self.method!r}"

    # ---- calls -------------------------------------------------------------------------------------------------

    def forward(self, rgb: Tensor, depth: Tensor | None = None, noise: Mapping[str, Tensor] | None = None) -> Tensor:
        """The image in this weather.

        Args:
            rgb: ``(..., 3, H, W)`` sRGB, uint8, uint16 or float in 0..1.
            depth: ``(..., 1, H, W)`` metres along the optical axis, infinity is sky; ``None`` takes the transform's
                source.
            noise: what ``draw`` gave; ``None`` draws.

        Returns:
            ``(..., 3, H, W)`` in the dtype of ``rgb``. The inputs are not changed.
        """
        before, inner = self._mosaic(rgb)
        after = inner(before, self._depth(rgb, depth), noise)
        return self._rgb(before, after, rgb)

    def with_weather(self, weather: Weather) -> AsBayer:
        """The same for another weather; tables that both need are shared."""
        inner = self.transform.with_weather(weather)
        assert isinstance(inner, BayerWeather)
        return AsBayer(inner, method=self.method)

    def run(self, rgb: Tensor, depth: Tensor | None = None, noise: Mapping[str, Tensor] | None = None) -> RgbResult:
        """The image, and with it transmission, airlight and particle mask."""
        before, inner = self._mosaic(rgb)
        result: CameraResult = inner.run(before, self._depth(rgb, depth), noise)
        height, width = rgb.shape[-2:]
        return RgbResult(
            rgb=self._rgb(before, result.bayer, rgb),
            transmission=result.transmission[..., :height, :width],
            airlight=result.airlight,
            particle_mask=result.particle_mask[..., :height, :width],
        )

    def draw(
        self,
        rgb: Tensor,
        depth: Tensor | None = None,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
    ) -> dict[str, Tensor]:
        """Noise for an image (or a batch): that of the transform for the mosaic of the padded size.

        Args:
            rgb: the image; only its shape counts.
            depth: ignored, so that ``draw`` takes what ``forward`` takes.
            generator: takes one integer per sample from it; ``None`` is torch's global generator.
            seed: the integers themselves: a tensor of the batch shape, or one integer s for s, s + 1, ...
        """
        self._check_shape(rgb)
        height, width = padded_size(*rgb.shape[-2:])
        frame = torch.zeros(()).expand(*rgb.shape[:-3], 1, height, width)
        return self._inner(height, width).draw(frame, None, generator, seed)

    def without_weather(self, rgb: Tensor) -> Tensor:
        """The image by way of the mosaic alone: as sharp as images in weather, for the clear ones beside them.

        Args:
            rgb: as in ``forward``.

        Returns:
            ``(..., 3, H, W)`` in the dtype of ``rgb``.
        """
        before, _ = self._mosaic(rgb)
        return self._rgb(None, before, rgb)

    # ---- the way to the mosaic and back --------------------------------------------------------------------------

    def _check_shape(self, rgb: Tensor) -> None:
        if not isinstance(rgb, Tensor):
            raise TypeError(f"AsBayer: rgb must be a torch.Tensor (..., 3, H, W); got {type(rgb).__name__}.")
        if rgb.ndim < 3 or rgb.shape[-3] != 3:
            raw = rgb.ndim >= 3 and rgb.shape[-3] == 1
            advice = " A raw mosaic goes to the Bayer transform itself." if raw else ""
            raise ValueError(f"AsBayer: rgb must have shape (..., 3, H, W); got {tuple(rgb.shape)}.{advice}")
        height, width = rgb.shape[-2:]
        if height == 0 or width == 0:
            raise ValueError(f"AsBayer: rgb must have pixels; got {height} x {width}.")
        camera = self.transform.camera
        if (camera.height, camera.width) not in {(height, width), padded_size(height, width)}:
            raise ValueError(
                f"AsBayer: the image is {height} x {width} px, the camera {camera.height} x {camera.width}. Use "
                "camera.resized(width, height) for a scaled image or camera.cropped(top, left, height, width) for a "
                "window."
            )

    def _check_values(self, rgb: Tensor) -> None:
        if not rgb.is_floating_point():
            if rgb.dtype not in INTEGER_DTYPES:
                raise TypeError(f"AsBayer: rgb must be uint8, uint16 or float in 0..1; got {rgb.dtype}.")
            return
        if rgb.numel():
            low, high = (float(v) for v in torch.aminmax(rgb.detach()))
            if not (low >= 0.0 and high <= 1.0):  # NaN fails both
                raise ValueError(
                    f"AsBayer: float images must lie in 0..1, without NaN; got {low:g}..{high:g}. Divide by the full "
                    "scale (255 for 8 bits)."
                )

    def _mosaic(self, rgb: Tensor) -> tuple[Tensor, BayerWeather]:
        """The mosaic of the padded image as the camera's raw float frame, and the transform for its size."""
        self._check_shape(rgb)
        self._check_values(rgb)
        linear = srgb_decode(normalise(rgb if rgb.dtype == torch.float64 else in_float32(rgb)))
        height, width = padded_size(*rgb.shape[-2:])
        inner = self._inner(height, width)
        frame = mosaic(padded(linear, height, width), inner.camera.bayer_pattern)
        knots = inner.camera.response_knots
        return (compand(frame, knots) if knots else frame), inner

    def _inner(self, height: int, width: int) -> BayerWeather:
        """The transform, its camera enlarged by the padding; the padding is at the right and bottom, so the
        principal point stays.
        """
        camera = self.transform.camera
        if (camera.height, camera.width) == (height, width):
            return self.transform
        inner = copy.copy(self.transform)  # shares stages and buffers
        inner.camera = replace(camera, height=height, width=width)
        return inner

    def _depth(self, rgb: Tensor, depth: Tensor | None) -> Tensor | None:
        height, width = rgb.shape[-2:]
        whole = padded_size(height, width)
        source = self.transform.depth_source
        if depth is None:
            if source is None:
                return None  # the transform explains what is missing
            if isinstance(source, DepthMap) and tuple(source.depth_m.shape[-2:]) == whole:
                return source.depth_m.to(rgb.device)
            dtype = torch.float64 if rgb.dtype == torch.float64 else torch.float32
            camera = replace(self.transform.camera, height=height, width=width)
            depth = source(camera, height, width, device=rgb.device, dtype=dtype, image=rgb)
        if not isinstance(depth, Tensor) or tuple(depth.shape[-2:]) != (height, width):
            return depth  # of the padded size already, or refused by the transform
        return padded(depth, *whole)

    def _rgb(self, before: Tensor | None, after: Tensor, rgb: Tensor) -> Tensor:
        """The image of the weather's mosaic; images whose mosaic did not change from before, where that is given, keep
        the input's own bits.
        """
        camera = self.transform.camera
        height, width = rgb.shape[-2:]
        linear = expand(after, camera.response_knots) if camera.response_knots else after
        seen = srgb_encode(demosaic(linear, camera.bayer_pattern, self.method)[..., :height, :width])
        unlike = torch.ones_like(after, dtype=torch.bool) if before is None else after != before
        changed = unlike.flatten(-3).any(-1)[..., None, None, None]
        if rgb.is_floating_point():
            return torch.where(changed, seen.to(rgb.dtype), rgb)
        # uint16 knows few operations: choose in int32.
        full = float(torch.iinfo(rgb.dtype).max)
        return torch.where(changed, quantise(seen, torch.int32, 0.0, full), rgb.to(torch.int32)).to(rgb.dtype)


def in_float32(rgb: Tensor) -> Tensor:
    """Half precision as float32; integers as they are (``normalise`` knows their full scale)."""
    return rgb.float() if rgb.is_floating_point() else rgb


def padded_size(height: int, width: int) -> tuple[int, int]:
    """The next even size of at least two cells.

    Example:
        >>> padded_size(375, 1242), padded_size(1, 1)
        ((376, 1242), (4, 4))
    """
    return max(SMALLEST_PX, math.ceil(height / 2) * 2), max(SMALLEST_PX, math.ceil(width / 2) * 2)


def padded(image: Tensor, height: int, width: int) -> Tensor:
    """``(..., H, W)`` enlarged at the bottom and right by reflection; a single row or column is repeated.

    Example:
        >>> padded(torch.tensor([[1, 2, 3]]), 2, 4)
        tensor([[1, 2, 3, 2],
                [1, 2, 3, 2]])
    """
    for axis, size in ((-2, height), (-1, width)):
        present = image.shape[axis]
        if size != present:
            index = torch.arange(size, device=image.device)
            mirrored = torch.where(index < present, index, (2 * (present - 1) - index).clamp_min(0))
            image = image.index_select(axis, mirrored)
    return image
