"""Depth maps from files: metres as arrays, and the three ways in which data sets pack depth into a PNG."""

from __future__ import annotations

import math
import os
from pathlib import Path

import torch
from torch import Tensor

from torchweather.errors import TorchweatherError, nearest_name
from torchweather.io.arrays import array_to_tensor, read_array
from torchweather.io.images import read_image

__all__ = ["CARLA_FAR_M", "DEPTH_ENCODINGS", "carla_depth_m", "read_depth"]

DEPTH_ENCODINGS = ("metre", "millimetre", "kitti", "carla")
"""Names of the encodings: float metres; 1 mm, 1/256 m per step of an integer; 24 bits in red, green, blue."""

_STEP_M = {"millimetre": 1e-3, "kitti": 1.0 / 256.0}  # KITTI depth development kit: depth = value / 256, 0 is no value
# CARLA sensor reference: depth = 1000 (R + 256 G + 65536 B) / (2^24 - 1)
CARLA_FAR_M = 1000.0
CARLA_FULL = 256**3 - 1


def read_depth(path: str | os.PathLike[str], encoding: str | None = None, *, missing_m: float = math.inf) -> Tensor:
    """Depth map of a file, metres along the optical axis.

    Args:
        path: ``.npy``, ``.npz`` (array ``depth_m`` or ``depth``, else the only one), ``.png`` or ``.tiff``.
        encoding: one of `DEPTH_ENCODINGS`. Float data are metres. For integers it must be named, because nothing in
            such a file tells 1 mm from 1/256 m.
        missing_m: depth of pixels without a value (0 in ``millimetre`` and ``kitti``). Default: ``inf``, sky.

    Returns:
        ``(1, H, W)`` float32 (an array may carry batch dimensions in front); ``inf`` is sky, and so is CARLA's far
        plane at 1000 m.

    Raises:
        TorchweatherError: no depth map, unnamed or wrong encoding, NaN or negative values.

    Example:
        >>> import tempfile
        >>> from torchweather.io import write_image
        >>> file = Path(tempfile.mkdtemp()) / "depth.png"
        >>> write_image(file, torch.tensor([[[0, 2560]]], dtype=torch.uint16))
        >>> read_depth(file, "kitti")
        tensor([[[inf, 10.]]])
    """
    source = Path(path)
    if encoding is not None and encoding not in DEPTH_ENCODINGS:
        raise TorchweatherError(
            f"{source}: encoding must be one of {', '.join(DEPTH_ENCODINGS)}; got {encoding!r}."
            f"{nearest_name(encoding, DEPTH_ENCODINGS)}"
        )
    if not missing_m >= 0:
        raise ValueError(f"read_depth: missing_m must be 0 m or more, inf for sky; got {missing_m!r}.")
    if source.suffix.lower() in (".npy", ".npz"):
        raw = array_to_tensor(read_array(source, ["depth_m", "depth"]), source, "a depth map")
        raw = raw[None] if raw.ndim == 2 else raw
    else:
        raw, _ = read_image(source)
    depth = _in_metres(raw, encoding, missing_m, source)
    if not bool((depth >= 0).all()):
        raise TorchweatherError(
            f"{source}: depth must be 0 m or more, inf for sky; got {int(depth.isnan().sum())} NaN and "
            f"{int((depth < 0).sum())} negative of {depth.numel()} pixels."
        )
    return depth


def carla_depth_m(rgb: Tensor) -> Tensor:
    """Metres out of CARLA's coded depth, ``1000 (R + 256 G + 65536 B) / (2^24 - 1)``.

    Args:
        rgb: ``(..., 3, H, W)`` uint8, red, green, blue.

    Returns:
        ``(..., 1, H, W)`` float32; ``inf`` for the far plane, which is what the renderer clears to: nothing was hit.

    Example:
        >>> carla_depth_m(torch.tensor([0, 0, 128], dtype=torch.uint8)[:, None, None])
        tensor([[[500.0000]]])
    """
    red, green, blue = rgb.to(torch.float64).unbind(-3)
    code = red + 256.0 * green + 65536.0 * blue
    metres = torch.where(code >= CARLA_FULL, torch.inf, code * (CARLA_FAR_M / CARLA_FULL))
    return metres.to(torch.float32).unsqueeze(-3)


def _in_metres(raw: Tensor, encoding: str | None, missing_m: float, source: Path) -> Tensor:
    channels = 3 if encoding == "carla" else 1
    if raw.ndim < 3 or raw.shape[-3] != channels or raw.numel() == 0:
        advice = ' A colour PNG may be CARLA\'s: encoding="carla".' if raw.ndim >= 3 and raw.shape[-3] == 3 else ""
        raise TorchweatherError(
            f"{source}: wanted a depth map of shape (..., {channels}, H, W); got {tuple(raw.shape)}.{advice}"
        )
    if encoding == "carla":
        if raw.dtype != torch.uint8:
            raise TorchweatherError(f"{source}: CARLA's depth is 8-bit colour; got {raw.dtype}.")
        return carla_depth_m(raw)
    in_steps = encoding in _STEP_M
    if in_steps if raw.is_floating_point() else encoding is None:
        raise TorchweatherError(
            f"{source}: {raw.dtype} with encoding={encoding!r}; floats are metres (encoding None or 'metre'), integers "
            "need 'millimetre', 'kitti' (1/256 m) or 'metre', because nothing in the file tells them apart."
        )
    if encoding is None or not in_steps:
        return raw.to(torch.float32)
    code = raw.to(torch.float64)
    return torch.where(code == 0, missing_m, code * _STEP_M[encoding]).to(torch.float32)
