"""RGB images as colour planes of linear light, and back: without a mosaic, without loss."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchweather.camera.srgb_bytes import bytes_of_light, light_of_bytes
from torchweather.camera.tone import normalise, quantise, srgb_decode, srgb_encode
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.core.masks import ends_of

__all__ = ["check_rgb", "encoded_planes", "linear_planes"]

INTEGER_DTYPES = (torch.uint8, torch.uint16)


def check_rgb(rgb: Any, owner: str) -> None:
    """Raise unless ``rgb`` is an image ``(..., 3, H, W)`` with pixels, uint8, uint16 or float in 0..1."""
    if not isinstance(rgb, Tensor):
        raise InputTypeError(f"{owner}: rgb must be a torch.Tensor (..., 3, H, W); got {type(rgb).__name__}.")
    if rgb.ndim < 3 or rgb.shape[-3] != 3:
        raw = rgb.ndim >= 3 and rgb.shape[-3] == 1
        advice = " A raw mosaic goes to the Bayer transform itself." if raw else ""
        raise InputValueError(f"{owner}: rgb must have shape (..., 3, H, W); got {tuple(rgb.shape)}.{advice}")
    height, width = rgb.shape[-2:]
    if height == 0 or width == 0:
        raise InputValueError(f"{owner}: rgb must have pixels; got {height} x {width}.")
    if not rgb.is_floating_point() and rgb.dtype not in INTEGER_DTYPES:
        raise InputTypeError(f"{owner}: rgb must be uint8, uint16 or float in 0..1; got {rgb.dtype}.")


def check_rgb_values(rgb: Tensor, owner: str) -> None:
    """Raise unless a float image lies in 0..1, without NaN."""
    if rgb.is_floating_point() and rgb.numel() and not torch.compiler.is_compiling():
        low, high = ends_of(rgb)
        if not (low >= 0.0 and high <= 1.0):  # NaN fails both
            raise InputValueError(
                f"{owner}: float images must lie in 0..1, without NaN; got {low:g}..{high:g}. Divide by the full "
                "scale (255 for 8 bits)."
            )


def linear_planes(rgb: Tensor) -> Tensor:
    """Linear light of an sRGB image ``(..., 3, H, W)``, float32 (float64 of float64), saturation 1."""
    if rgb.dtype == torch.uint8 and not torch.compiler.is_compiling():
        return light_of_bytes(rgb)
    if rgb.dtype == torch.uint8:  # every level once
        levels = torch.arange(256, dtype=torch.float32, device=rgb.device) / 255.0
        return srgb_decode(levels)[rgb.int()]
    if rgb.dtype == torch.float64:
        return srgb_decode(rgb)
    return srgb_decode(normalise(rgb.float() if rgb.is_floating_point() else rgb))


def encoded_planes(after: Tensor, before: Tensor, rgb: Tensor) -> Tensor:
    """The sRGB image of linear light; samples that did not change keep the input's own bits.

    Args:
        after: ``(..., 3, H, W)`` linear light of the result.
        before: the same of the input.
        rgb: the input, whose dtype the result has.
    """
    if rgb.dtype == torch.uint8 and not torch.compiler.is_compiling():
        return bytes_of_light(after)  # which gives every level of `linear_planes` back
    seen = srgb_encode(after.clamp(0.0, 1.0))
    if rgb.is_floating_point():
        return torch.where(after == before, rgb, seen.to(rgb.dtype))
    # uint16 knows few operations: choose in int32.
    levels = quantise(seen, torch.int32, 0.0, float(torch.iinfo(rgb.dtype).max))
    return torch.where(after == before, rgb.to(torch.int32), levels).to(rgb.dtype)
