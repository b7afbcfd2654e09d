"""Depth maps from files: float metres, and the ways in which data sets pack depth or disparity into integers."""

from __future__ import annotations

import difflib
import math
import os
from pathlib import Path

import torch
from torch import Tensor

from torchweather.camera.depth.sparse import depth_from_disparity
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.io.arrays import array_to_tensor, read_array
from torchweather.io.depth_plausible import check_plausible
from torchweather.io.images import read_image
from torchweather.io.pfm import read_pfm

__all__ = ["CARLA_FAR_M", "DEPTH_ENCODINGS", "DISPARITY_ENCODINGS", "carla_depth_m", "read_depth", "read_disparity"]

# KITTI's development kits: depth = value / 256 m, disparity = value / 256 px; 0 is no value.
_STEPS = {
    "metre": 1.0,
    "centimetre": 1e-2,
    "millimetre": 1e-3,
    "kitti": 1.0 / 256.0,
    "disparity": 1.0,
    "disparity_kitti": 1.0 / 256.0,
}
DISPARITY_ENCODINGS = ("disparity", "disparity_kitti")
"""Encodings of a stereo pair's disparity: pixels, and 1/256 pixel per step of an integer."""
DEPTH_ENCODINGS = ("metre", "centimetre", "millimetre", "kitti", "carla", *DISPARITY_ENCODINGS)
"""Names of the encodings: 1 m, 1 cm, 1 mm, 1/256 m; 24 bits in red, green, blue; 1 and 1/256 pixel of disparity."""
_STEP_TEXT = (
    "metre, centimetre, millimetre, kitti (1/256 m), carla (24 bits in red, green, blue), disparity (pixels), "
    "disparity_kitti (1/256 pixel)"
)
# Floats are no steps of 1/256; as a length they may well be centimetres.
_INTEGER_ONLY = ("kitti", "disparity_kitti")
# A misspelt name reaches 0.89 (millimeter), another unit 0.74 (decimetre for centimetre); a wrong unit does harm.
_SAME_NAME = 0.85

# CARLA sensor reference: depth = 1000 (R + 256 G + 65536 B) / (2^24 - 1)
CARLA_FAR_M = 1000.0
CARLA_FULL = 256**3 - 1


def read_depth(
    path: str | os.PathLike[str],
    encoding: str | None = None,
    *,
    missing_m: float = math.nan,
    fx_px: float | None = None,
    baseline_m: float | None = None,
) -> Tensor:
    """Depth map of a file, metres.

    Args:
        path: ``.npy``, ``.npz`` (array ``depth_m`` or ``depth``, else the only one), ``.png``, ``.tiff`` or ``.pfm``.
        encoding: one of `DEPTH_ENCODINGS`. Float data are metres. For integers it must be named, because nothing in
            such a file distinguishes 1 mm from 1/256 m.
        missing_m: depth of pixels without a value: 0, NaN and ``-inf``. Default: NaN, unknown. ``inf`` makes sky of
            them.
        fx_px: focal length of the rectified pair, pixels; of ``disparity`` and ``disparity_kitti`` alone.
        baseline_m: distance between the two lenses, metres; of the same two.

    Returns:
        ``(1, H, W)`` float32 (an array may carry batch dimensions in front). NaN is unknown; ``inf`` is sky, and so is
        CARLA's far plane at 1000 m.

    Raises:
        TorchweatherError: no depth map, unnamed or wrong encoding, negative values, or values that no street has.

    Example:
        >>> import tempfile
        >>> from torchweather.io import write_image
        >>> file = Path(tempfile.mkdtemp()) / "depth.png"
        >>> write_image(file, torch.tensor([[[0, 2560]]], dtype=torch.uint16))
        >>> read_depth(file, "kitti")
        tensor([[[nan, 10.]]])
    """
    check_arguments(
        "read_depth(path: path, encoding: str | None, missing_m: float, fx_px: float | None, baseline_m: float | None)",
        path,
        encoding,
        missing_m,
        fx_px,
        baseline_m,
    )
    source = Path(path)
    _check_encoding(source, encoding)
    missing_m = float(missing_m)
    if 3e38 < missing_m < math.inf:
        raise InputValueError(f"read_depth: missing_m must be a depth of less than 3e38 m; got {missing_m!r}.")
    if missing_m < 0:
        raise InputValueError(
            f"read_depth: missing_m must be 0 m or more, inf for sky, NaN for unknown; got {missing_m!r}."
        )
    if encoding in DISPARITY_ENCODINGS:
        if fx_px is None or baseline_m is None:
            raise InputValueError(
                f"read_depth: encoding {encoding!r} needs fx_px (pixels) and baseline_m (metres): depth = fx baseline "
                "/ disparity. Take both from the stereo pair's calibration."
            )
        depth = depth_from_disparity(read_disparity(source, encoding), fx_px, baseline_m)
        check_plausible(depth, source, encoding)
    else:
        raw = _stored(source)
        depth = carla_depth_m(_carla_colours(raw, source)) if encoding == "carla" else _metres(raw, encoding, source)
    return depth if math.isnan(missing_m) else torch.where(depth.isnan(), missing_m, depth)


def read_disparity(path: str | os.PathLike[str], encoding: str = "disparity") -> Tensor:
    """Disparity map of a file, pixels.

    Args:
        path: as of `read_depth`; in ``.npz`` the array ``disparity`` or ``disparity_px``, else the only one.
        encoding: ``disparity`` (pixels) or ``disparity_kitti`` (integers, 1/256 pixel).

    Returns:
        ``(1, H, W)`` float32, more than 0; NaN is unknown: 0, negative, NaN or infinite in the file.

    Example:
        >>> import tempfile
        >>> from torchweather.io import write_image
        >>> file = Path(tempfile.mkdtemp()) / "disparity.png"
        >>> write_image(file, torch.tensor([[[0, 2560]]], dtype=torch.uint16))
        >>> read_disparity(file, "disparity_kitti")
        tensor([[[nan, 10.]]])
    """
    source = Path(path)
    if encoding not in DISPARITY_ENCODINGS:
        raise InputValueError(
            f"read_disparity: encoding must be one of {', '.join(DISPARITY_ENCODINGS)}; got {encoding!r}."
        )
    raw = _one_value_each(_stored(source, ("disparity", "disparity_px")), encoding, source)
    pixels = raw.to(torch.float64) * _STEPS[encoding]
    known = (pixels > 0) & torch.isfinite(pixels)
    return torch.where(known, pixels, torch.nan).to(torch.float32)


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


def _check_encoding(source: Path, encoding: str | None) -> None:
    if encoding is None or encoding in DEPTH_ENCODINGS:
        return
    near = difflib.get_close_matches(str(encoding), DEPTH_ENCODINGS, n=1, cutoff=_SAME_NAME)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise TorchweatherError(f"{source}: encoding must be one of {_STEP_TEXT}; got {encoding!r}.{hint}")


def _stored(source: Path, keys: tuple[str, ...] = ("depth_m", "depth")) -> Tensor:
    """The file's numbers, ``(..., C, H, W)``."""
    suffix = source.suffix.lower()
    if suffix == ".pfm":
        return torch.from_numpy(read_pfm(source))[None]
    if suffix == ".exr":
        raise TorchweatherError(
            f"{source}: OpenEXR is not read here. Convert the map to float metres in .npy, e.g. with OpenCV: "
            "numpy.save('depth.npy', cv2.imread('depth.exr', cv2.IMREAD_UNCHANGED))."
        )
    if suffix in (".npy", ".npz"):
        raw = array_to_tensor(read_array(source, list(keys)), source, "a depth map")
        return raw[None] if raw.ndim == 2 else raw
    return read_image(source)[0]


def _carla_colours(raw: Tensor, source: Path) -> Tensor:
    _check_shape(raw, 3, source)
    if raw.dtype != torch.uint8:
        raise TorchweatherError(f"{source}: CARLA's depth is 8-bit colour; got {raw.dtype}.")
    return raw


def _check_shape(raw: Tensor, channels: int, source: Path) -> None:
    if raw.ndim < 3 or raw.shape[-3] != channels or raw.numel() == 0:
        advice = ' A colour PNG may be CARLA\'s: encoding="carla".' if raw.ndim >= 3 and raw.shape[-3] == 3 else ""
        raise TorchweatherError(
            f"{source}: expected a depth map of shape (..., {channels}, H, W); got {tuple(raw.shape)}.{advice}"
        )


def _one_value_each(raw: Tensor, encoding: str | None, source: Path) -> Tensor:
    """A map ``(..., 1, H, W)`` whose dtype fits its encoding."""
    _check_shape(raw, 1, source)
    if raw.is_floating_point() and encoding in _INTEGER_ONLY:
        raise TorchweatherError(
            f"{source}: {raw.dtype} with encoding={encoding!r}; floats are metres (encoding None or 'metre'), "
            "'centimetre', 'millimetre' or 'disparity' (pixels). Steps of 1/256 are integers."
        )
    if not raw.is_floating_point() and encoding is None:
        raise TorchweatherError(
            f"{source}: {raw.dtype} with encoding=None; integers need 'millimetre', 'kitti' (1/256 m), 'centimetre', "
            "'metre' or a disparity, because nothing in the file distinguishes them. On the command line: "
            "--depth-encoding."
        )
    return raw


def _metres(raw: Tensor, encoding: str | None, source: Path) -> Tensor:
    """Float32 metres; NaN where the file has no value: 0, NaN, -inf."""
    value = _one_value_each(raw, encoding, source).to(torch.float64)
    # Nothing stands 0 m before a lens: 0 is how a projected LiDAR, and KITTI, write "no value".
    metres = (value * _STEPS[encoding or "metre"]).to(torch.float32)
    unknown = value.isnan() | torch.isneginf(value) | (metres == 0)  # what float32 cannot tell from 0 as well
    depth = torch.where(unknown, torch.nan, metres)
    if bool((depth.isinf() & ~value.isinf()).any()):
        raise TorchweatherError(f"{source}: depth must be metres, inf for sky; got numbers above 3e38. Is it damaged?")
    negative = int((depth < 0).sum())
    if negative:
        raise TorchweatherError(
            f"{source}: depth must be 0 m or more, inf for sky, NaN for unknown; got {negative} negative of "
            f"{depth.numel()} pixels. If they mark missing values, write NaN or 0 there."
        )
    check_plausible(depth, source, encoding, code=value, floats=raw.is_floating_point())
    return depth
