"""Camera frames from files and to files: raw mosaics in 8 and 16 bit, colour images, arrays.

``.png``, ``.tif``/``.tiff``, ``.jpg``/``.jpeg``, ``.npy``, ``.npz``. Values and dtype come back as they were stored.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.errors import TorchweatherError
from torchweather.io.arrays import array_to_tensor, read_array
from torchweather.io.atomic import atomic_write

__all__ = ["IMAGE_SUFFIXES", "ImageInfo", "read_image", "write_image"]

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".npy", ".npz")
"""Endings that `read_image` and `write_image` know."""

_PILLOW_FORMATS = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF", ".jpg": "JPEG", ".jpeg": "JPEG"}
_WANTED = "an image: .png, .tif, .tiff, .jpg, .jpeg, .npy or .npz"


@dataclass(frozen=True)
class ImageInfo:
    """What a file held besides the pixel values.

    Args:
        path: the file.
        suffix: its ending, lower case.
        kind: ``mosaic`` (one value per pixel, raw or grey) or ``rgb``.
    """

    path: Path
    suffix: str
    kind: str


def read_image(path: str | os.PathLike[str]) -> tuple[Tensor, ImageInfo]:
    """A frame as it was stored.

    Args:
        path: PNG (8 or 16 bit grey, 8 bit colour), TIFF (8 or 16 bit or float grey, 8 bit colour), JPEG, ``.npy``, or
            ``.npz`` (the array ``bayer``, else the only one).

    Returns:
        ``(1, H, W)`` for one value per pixel or ``(3, H, W)`` for colour (transparency is dropped), in the stored
        dtype; an array may carry batch dimensions in front. And what else is known of the file.

    Raises:
        TorchweatherError: the file is missing, truncated, or no image.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "frame.png"
        >>> write_image(file, torch.tensor([[[0, 4095], [370, 3967]]], dtype=torch.uint16))
        >>> frame, info = read_image(file)
        >>> frame.dtype, frame.shape, info.kind
        (torch.uint16, torch.Size([1, 2, 2]), 'mosaic')
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix in (".npy", ".npz"):
        image = _channels_first(array_to_tensor(read_array(source, ["bayer"]), source, "an image"), source)
    elif suffix in _PILLOW_FORMATS:
        pixels = _decoded(source)
        image = array_to_tensor(pixels[None] if pixels.ndim == 2 else np.moveaxis(pixels, -1, 0), source, "an image")
    else:
        raise TorchweatherError(f"{source}: wanted {_WANTED}; got {suffix or 'no ending'}.")
    if image.numel() == 0:
        raise TorchweatherError(f"{source}: wanted {_WANTED}; got one without pixels, shape {tuple(image.shape)}.")
    return image, ImageInfo(source, suffix, "mosaic" if image.shape[-3] == 1 else "rgb")


def write_image(path: str | os.PathLike[str], image: Tensor) -> None:
    """Write a frame in the format that the file's ending names, whole or not at all.

    Args:
        path: ``.png`` or ``.tif(f)`` for ``uint8`` and ``uint16`` with one value per pixel and ``uint8`` colour,
            ``.jpg`` for ``uint8`` colour only (it would smear a mosaic), ``.npy`` and ``.npz`` (array ``bayer`` or
            ``rgb``) for anything.
        image: ``(H, W)``, ``(1, H, W)`` or ``(3, H, W)``; for ``.npy`` and ``.npz`` also with batch dimensions.

    Raises:
        TorchweatherError: the format cannot hold the image, or the folder does not exist.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise TorchweatherError(f"{target}: cannot be written; wanted {_WANTED}; got {suffix or 'no ending'}.")
    pixels = image.detach().cpu()
    pixels = pixels[None] if pixels.ndim == 2 else pixels
    if pixels.ndim < 3 or pixels.shape[-3] not in (1, 3) or pixels.numel() == 0:
        raise TorchweatherError(
            f"{target}: wanted an image of shape (H, W), (1, H, W) or (3, H, W); got {tuple(image.shape)}."
        )
    array = pixels.numpy()
    with atomic_write(target) as unfinished:
        if suffix == ".npy":
            np.save(unfinished, array, allow_pickle=False)
        elif suffix == ".npz":
            np.savez(unfinished, **{"bayer" if array.shape[-3] == 1 else "rgb": array})  # type: ignore[arg-type]
        else:
            _encode(target, suffix, array, unfinished)


def _encode(target: Path, suffix: str, array: npt.NDArray[Any], unfinished: Path) -> None:
    from PIL import Image

    colour = array.shape[0] == 3
    kept = {("uint8", False), ("uint8", True), ("uint16", False)} if suffix[:3] != ".jp" else {("uint8", True)}
    if array.ndim != 3 or (str(array.dtype), colour) not in kept:
        held = " or ".join(f"{dtype} {'(3, H, W)' if c else '(1, H, W)'}" for dtype, c in sorted(kept))
        raise TorchweatherError(
            f"{target}: {suffix} holds {held} here; got {array.dtype} {array.shape}. Quantise it first "
            "(torchweather.image.quantise), or write .npy."
        )
    picture = Image.fromarray(np.ascontiguousarray(np.moveaxis(array, 0, -1)) if colour else array[0])
    # Without chroma subsampling: colour edges are what a demosaicing is judged by.
    options: dict[str, Any] = {"quality": 95, "subsampling": 0} if suffix[:3] == ".jp" else {}
    picture.save(unfinished, format=_PILLOW_FORMATS[suffix], **options)


def _decoded(source: Path) -> npt.NDArray[Any]:
    """Pixels ``(H, W)`` or ``(H, W, 3)`` of a picture file, in the stored dtype."""
    from PIL import Image, UnidentifiedImageError

    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file.")
    if _is_deep_colour_png(source):
        # Pillow would hand over the upper eight bits without a word.
        raise TorchweatherError(
            f"{source}: a colour PNG of 16 bits per channel is not read without loss here. Convert it to .npy."
        )
    try:
        with Image.open(source) as picture:
            mode = picture.mode
            if mode in ("RGBA", "LA", "P", "PA", "CMYK", "YCbCr", "RGBX"):
                return np.asarray(picture.convert("L" if mode == "LA" else "RGB"))
            if mode == "1":
                return np.asarray(picture.convert("L"))
            pixels = np.asarray(picture)
    except UnidentifiedImageError as error:
        raise TorchweatherError(f"{source}: wanted {_WANTED}; the content is none of them.") from error
    except Image.DecompressionBombError as error:
        raise TorchweatherError(f"{source}: wanted {_WANTED}; {error}.") from error
    except (OSError, SyntaxError, ValueError, EOFError, zlib.error, struct.error) as error:
        raise TorchweatherError(f"{source}: wanted {_WANTED}; it is truncated or damaged ({error}).") from error
    if mode == "I" and pixels.min() >= 0 and pixels.max() <= 65535:
        # Some 16-bit files are opened in a 32-bit mode.
        return pixels.astype(np.uint16)
    if mode not in ("L", "RGB", "I", "F") and not mode.startswith("I;16"):
        raise TorchweatherError(f"{source}: wanted a grey or RGB picture; got mode {mode}.")
    return pixels


def _is_deep_colour_png(source: Path) -> bool:
    with source.open("rb") as file:
        head = file.read(26)  # signature 8, chunk length and name 8, width 4, height 4, bit depth 1, colour type 1
    return len(head) == 26 and head[:8] == b"\x89PNG\r\n\x1a\n" and head[24] == 16 and head[25] in (2, 4, 6)


def _channels_first(image: Tensor, source: Path) -> Tensor:
    if image.ndim == 2:
        return image[None]
    if image.ndim >= 3 and image.shape[-3] in (1, 3):
        return image
    if image.ndim == 3 and image.shape[-1] in (1, 3):
        return torch.movedim(image, -1, 0).contiguous()
    raise TorchweatherError(
        f"{source}: wanted an image (H, W), (..., 1, H, W) or (..., 3, H, W); got {tuple(image.shape)}."
    )
