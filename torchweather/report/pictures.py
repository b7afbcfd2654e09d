"""Pictures for a page: one fixed development for all weathers, tinted raw crops, close-ups, data URIs."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from torchweather.camera.bayer import cfa_index, colour_means
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import develop, grey_world_gains, srgb_decode, srgb_encode

__all__ = [
    "Look",
    "Window",
    "brightened",
    "brightening",
    "centred_window",
    "cropped",
    "data_uri",
    "jpeg_bytes",
    "jpeg_uri",
    "liveliest_window",
    "look_of",
    "png_uri",
    "shrunk",
    "tinted_raw",
]

WHITE_AT = 0.62  # linear display value of the clear frame's bright parts: leaves room for what fog and snow add
BRIGHT_QUANTILE = 0.99
EXPOSURE_RANGE = (0.2, 20.0)
KNEE = 0.85  # highlights above it bend instead of clipping
GAIN_RANGE = (0.4, 2.5)  # white balance outside it is a coloured scene, not coloured light
JPEG_QUALITY = 84
NEIGHBOURS_PX = 15  # wider than a streak, so that their mean is the veil
CLOSE_UP_WHITE, BRIGHTENED_AT_MOST = 0.5, 5.0
FAR_M = 1000.0  # stands for the sky

Window = tuple[int, int, int, int]  # top, left, height, width


@dataclass(frozen=True)
class Look:
    """White balance and exposure of the clear frame, used for every frame beside it.

    Args:
        gains: factors of red, green (or clear), blue.
        exposure: factor of all.
    """

    gains: tuple[float, float, float]
    exposure: float

    def develop(self, linear: Tensor, pattern: str) -> Tensor:
        """Display picture ``(3, H, W)`` in 0..1 of a linear mosaic ``(1, H, W)``."""
        return develop(linear.clamp(0, 1), pattern, gains=self.gains, exposure=self.exposure, knee=KNEE).clamp(0, 1)


def look_of(linear: Tensor, depth_m: Tensor, camera: Camera) -> Look:
    """White balance and exposure for a clear frame: its sky is grey, its bright parts nearly white.

    Args:
        linear: mosaic ``(1, H, W)``, black 0, saturation 1.
        depth_m: ``(1, H, W)``; infinity is sky. Without sky the mean of the frame is taken as grey.
        camera: the camera.

    Example:
        >>> camera = Camera.from_intrinsics(9.0, 9.0, 3.5, 3.5, 8, 8)
        >>> look_of(torch.full((1, 8, 8), 0.31), torch.full((1, 8, 8), torch.inf), camera).exposure
        2.0
    """
    sky = torch.isinf(depth_m)
    means = colour_means(linear, camera.bayer_pattern, mask=sky)
    has_sky = bool((means > 0).all())  # without it the means are not a number
    gains = means[1] / means if has_sky else grey_world_gains(linear, camera.bayer_pattern)
    gains = gains.clamp(*GAIN_RANGE)
    index = cfa_index(linear.shape[-2], linear.shape[-1], camera.bayer_pattern)
    balanced = (linear[0] * gains[index]).flatten()[:: max(1, linear.numel() // 200_000)]
    bright = float(torch.quantile(balanced, BRIGHT_QUANTILE))
    exposure = WHITE_AT / bright if bright > 0 else 1.0
    red, green, blue = (float(v) for v in gains)
    return Look((red, green, blue), round(min(max(exposure, EXPOSURE_RANGE[0]), EXPOSURE_RANGE[1]), 4))


def shrunk(picture: Tensor, width: int) -> Tensor:
    """Display picture reduced by a whole factor to about ``width`` columns, averaged in linear light."""
    factor = max(1, round(picture.shape[-1] / width))
    if factor == 1 or min(picture.shape[-2:]) < factor:
        return picture
    return srgb_encode(F.avg_pool2d(srgb_decode(picture)[None], factor)[0])


def tinted_raw(linear: Tensor, pattern: str, exposure: float) -> Tensor:
    """The mosaic as it is, every pixel in the colour of its own filter, ``(3, H, W)``; clear pixels are grey."""
    height, width = linear.shape[-2:]
    value = srgb_encode((linear[0] * exposure).clamp(0, 1))
    index = cfa_index(height, width, pattern)
    if "C" in pattern:
        shares = torch.tensor([[1.0, 0.1, 0.1], [0.85, 0.85, 0.85], [0.1, 0.25, 1.0]])
    else:
        shares = torch.tensor([[1.0, 0.12, 0.12], [0.1, 0.9, 0.1], [0.15, 0.3, 1.0]])
    return (value[None] * shares[index].movedim(-1, 0)).clamp(0, 1)


def liveliest_window(
    before: Tensor, after: Tensor, particle_mask: Tensor, depth_m: Tensor, height: int, width: int
) -> Window:
    """Window for a close-up: the one in which particles differ most from their background.

    Args:
        before, after: display pictures ``(3, H, W)``.
        particle_mask, depth_m: ``(1, H, W)``.
        height, width: of the window, even; cut to the picture.

    Returns:
        Top, left (both even), height, width.
    """
    rows, columns = before.shape[-2:]
    height, width = min(height, rows // 2 * 2), min(width, columns // 2 * 2)
    mask, depth = particle_mask[None].float(), depth_m[None].float().clamp_max(FAR_M)
    # Change per covered share: how much a particle differs from its background.
    contrast = (after - before).mean(0) / mask.clamp_min(1e-3)
    streaks = (mask - _local_mean(mask)) * contrast
    # At the edges of objects the mask jumps with the depth; that is no particle.
    streaks = torch.where((depth - _local_mean(depth)).abs() < 0.05 * depth, streaks, torch.zeros_like(streaks))
    # A single drop in front of the lens must not decide.
    limit = float(torch.quantile(streaks.abs().flatten()[:: max(1, streaks.numel() // 200_000)], 0.995))
    energy = streaks.clamp(-limit, limit).square()
    step = (max(2, height // 4 * 2), max(2, width // 4 * 2))
    found = F.avg_pool2d(energy, (height, width), step)
    best, across = int(found.argmax()), found.shape[-1]
    return best // across * step[0], best % across * step[1], height, width


def _local_mean(image: Tensor) -> Tensor:
    return F.avg_pool2d(image, NEIGHBOURS_PX, stride=1, padding=NEIGHBOURS_PX // 2, count_include_pad=False)


def centred_window(camera: Camera, height: int, width: int) -> Window:
    """The window around the principal point, where the far objects are; top and left even."""
    height, width = min(height, camera.height // 2 * 2), min(width, camera.width // 2 * 2)
    cx, cy = camera.principal_point_px
    # Somewhat below the horizon, because objects stand on the ground.
    top = int(min(max(cy - 0.35 * height, 0), camera.height - height)) // 2 * 2
    left = int(min(max(cx - 0.5 * width, 0), camera.width - width)) // 2 * 2
    return top, left, height, width


def cropped(image: Tensor, window: Window) -> Tensor:
    """The window of ``(C, H, W)``."""
    top, left, height, width = window
    return image[..., top : top + height, left : left + width]


def brightening(picture: Tensor) -> float:
    """Factor of light that makes a dark display picture easy to look at, 1 for a bright one; two digits."""
    bright = float(torch.quantile(srgb_decode(picture).flatten(), 0.9))
    return round(min(max(CLOSE_UP_WHITE / max(bright, 1e-3), 1.0), BRIGHTENED_AT_MOST), 1)


def brightened(picture: Tensor, factor: float) -> Tensor:
    """Display picture with ``factor`` times the light."""
    return picture if factor == 1.0 else srgb_encode((srgb_decode(picture) * factor).clamp(0, 1))


def _bytes(picture: Tensor) -> NDArray[np.uint8]:
    return np.ascontiguousarray((picture.clamp(0, 1) * 255).round().to(torch.uint8).movedim(0, -1).cpu().numpy())


def _encoded(picture: Tensor, kind: str, **options: int | bool) -> bytes:
    from PIL import Image

    memory = io.BytesIO()
    Image.fromarray(_bytes(picture)).save(memory, format=kind, **options)
    return memory.getvalue()


def data_uri(content: bytes, media_type: str) -> str:
    """The content as an address that a page can carry in itself.

    Example:
        >>> data_uri(b"rain", "text/plain")
        'data:text/plain;base64,cmFpbg=='
    """
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"


def jpeg_bytes(picture: Tensor, quality: int = JPEG_QUALITY) -> bytes:
    """Display picture ``(3, H, W)`` as JPEG."""
    return _encoded(picture, "JPEG", quality=quality, optimize=True)


def jpeg_uri(picture: Tensor, quality: int = JPEG_QUALITY) -> str:
    """Display picture ``(3, H, W)`` as a JPEG that a page can carry."""
    return data_uri(jpeg_bytes(picture, quality), "image/jpeg")


def png_uri(picture: Tensor) -> str:
    """Display picture ``(3, H, W)`` as a PNG that a page can carry: every pixel exact."""
    return data_uri(_encoded(picture, "PNG", optimize=True), "image/png")
