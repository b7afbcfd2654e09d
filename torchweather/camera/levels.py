"""Raw values of a camera to linear light and back, and the checks at this border."""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.camera.tone import compand, expand, normalise, quantise
from torchweather.core.errors import InputTypeError, InputValueError, owner_name
from torchweather.core.masks import ends_of
from torchweather.pipeline.tiling import is_exporting

__all__ = ["check_bayer", "raw_from_linear", "raw_to_linear"]

INTEGER_DTYPES = (torch.uint8, torch.uint16)


def levels(camera: Camera, dtype: torch.dtype) -> tuple[float, float]:
    """Black and white level in the numbers of a dtype.

    A float frame runs from 0 to 1. An 8-bit frame of a camera with more bits holds the upper eight of them.
    """
    if dtype.is_floating_point:
        return 0.0, 1.0
    scale = 2.0 ** (8 - camera.bit_depth) if dtype == torch.uint8 and camera.bit_depth > 8 else 1.0
    whole_range = scale < 1 and camera.saturation_level == 2**camera.bit_depth - 1
    white = 255.0 if whole_range else camera.saturation_level * scale
    return camera.black_level * scale, white


def check_bayer(bayer: Tensor, camera: Camera, owner: object) -> None:
    """Raise unless ``bayer`` is a mosaic ``(..., 1, H, W)`` of the camera's size in a known dtype."""
    name = owner_name(owner)
    if not isinstance(bayer, Tensor):
        raise InputTypeError(f"{name}: bayer must be a torch.Tensor (..., 1, H, W); got {type(bayer).__name__}.")
    if bayer.ndim < 3 or bayer.shape[-3] != 1:
        hint = " For RGB images use AsBayer(transform)." if bayer.ndim >= 3 and bayer.shape[-3] == 3 else ""
        raise InputValueError(f"{name}: bayer must have shape (..., 1, H, W); got {tuple(bayer.shape)}.{hint}")
    if not bayer.is_floating_point() and bayer.dtype not in INTEGER_DTYPES:
        raise InputTypeError(f"{name}: bayer must be uint8, uint16 or float in 0..1; got {bayer.dtype}.")
    height, width = bayer.shape[-2:]
    if is_exporting():
        return
    if height % 2 or width % 2:
        raise InputValueError(
            f"{name}: H and W of a Bayer mosaic must be even; got {height} x {width}. Crop the frame, or use "
            "AsBayer, which pads RGB images."
        )
    if (height, width) != (camera.height, camera.width):
        raise InputValueError(
            f"{name}: the frame is {height} x {width} px, the camera {camera.height} x {camera.width}. Use "
            "camera.resized(width, height) for a scaled image or camera.cropped(top, left, height, width) for a window."
        )


def raw_to_linear(bayer: Tensor, camera: Camera, owner: object) -> Tensor:
    """Linear light of raw values, black 0, saturation 1; float32 unless the input is float64."""
    black, white = levels(camera, bayer.dtype)
    linear = normalise(bayer, black, white)
    linear = linear if linear.dtype in (torch.float32, torch.float64) else linear.float()
    if not is_exporting() and linear.numel():
        low, high = ends_of(linear)
        # Half a step of rounding is no contradiction.
        if not (high <= 1.0 + 1e-6 and low == low):
            raw_high = high * (white - black) + black
            raise InputValueError(
                f"{owner_name(owner)}: the frame contradicts its description: expected values up to {white:g}"
                f"{' (float frames run from 0 to 1)' if bayer.is_floating_point() else ''}, without NaN; got up to "
                f"{raw_high:g}. Set Camera(bit_depth=..., white_level=...) or scale the frame."
            )
        if bayer.is_floating_point() and low < 0:
            raise InputValueError(
                f"{owner_name(owner)}: float frames must lie in 0..1; got {low:g}. Subtract the black level and clip."
            )
    return expand(linear, camera.response_knots) if camera.response_knots else linear


def raw_from_linear(linear: Tensor, before: Tensor, bayer: Tensor, camera: Camera) -> Tensor:
    """Raw values of the result in the dtype of the input; unchanged pixels keep the input's own bits.

    Args:
        linear: the result.
        before: linear light of the input.
        bayer: the input.
        camera: the camera.
    """
    if bayer.is_floating_point() and not camera.response_knots:
        return linear.to(bayer.dtype)
    black, white = levels(camera, bayer.dtype)
    encoded = compand(linear, camera.response_knots) if camera.response_knots else linear
    if bayer.is_floating_point():
        return torch.where(linear == before, bayer, encoded.to(bayer.dtype))
    # uint16 knows few operations: choose in int32.
    changed = quantise(encoded, torch.int32, black, white)
    kept = torch.where(linear == before, bayer.to(torch.int32), changed)
    return kept.to(bayer.dtype)
