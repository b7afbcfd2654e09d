"""Camera frames from files and to files: raw mosaics in 8 and 16 bit, colour images, arrays.

``.png``, ``.tif``/``.tiff``, ``.jpg``/``.jpeg``, ``.bmp``, ``.webp``, ``.npy``, ``.npz``. Values and dtype come back as
they were stored, upright: an EXIF orientation is carried out, so what is written afterwards needs no tag. Arrays go
back to the layout they came in.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.arrays import as_numpy
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import TorchweatherError, TorchweatherWarning, check_between
from torchweather.core.inflation import check_inflated
from torchweather.io.arrays import array_to_tensor, read_named_array, write_archive
from torchweather.io.exif import BROKEN_PICTURE, ORIENTATION, exif_tags

if TYPE_CHECKING:
    from PIL import Image

__all__ = ["IMAGE_SUFFIXES", "ImageInfo", "read_image", "write_image"]

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".webp", ".npy", ".npz")
"""Endings that `read_image` and `write_image` know."""

_ARRAYS = (".npy", ".npz")
_PILLOW_FORMATS = {
    ".png": "PNG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".bmp": "BMP",
    ".webp": "WEBP",
}
# (dtype, colour) that each format holds without loss; JPEG and WebP would smear a mosaic.
_HELD = {
    "PNG": {("uint8", False), ("uint8", True), ("uint16", False)},
    "TIFF": {("uint8", False), ("uint8", True), ("uint16", False)},
    "BMP": {("uint8", False), ("uint8", True)},
    "JPEG": {("uint8", True)},
    "WEBP": {("uint8", True)},
}
_SAVE_OPTIONS: dict[str, dict[str, Any]] = {
    # Without chroma subsampling: colour edges are what a demosaicing is judged by.
    "JPEG": {"quality": 95, "subsampling": 0},
    "WEBP": {"lossless": True},
}
# Tags of TIFF 6.0.
_NEW_SUBFILE_TYPE, _BITS_PER_SAMPLE, _SAMPLES_PER_PIXEL = 254, 258, 277
_WANTED = "an image: .png, .tif, .tiff, .jpg, .jpeg, .bmp, .webp, .npy or .npz"
# Bytes of a decoded pixel by Pillow's mode; every other mode has one.
_MODE_BYTES = {"I": 4, "F": 4, "RGB": 4, "RGBA": 4, "RGBX": 4, "CMYK": 4, "YCbCr": 4, "LAB": 4, "HSV": 4, "PA": 4}


@dataclass(frozen=True)
class ImageInfo:
    """Contents of a file besides the pixel values.

    Args:
        path: the file.
        suffix: its ending, lower case.
        kind: ``mosaic`` (one value per pixel, raw or grey) or ``rgb``.
        orientation: EXIF orientation that was carried out, 1 to 8; 1 where the pixels were upright.
        layout: of an array's axes, where they are not ``(..., C, H, W)``: ``channels_last`` ``(..., H, W, C)``, or
            ``plane`` ``(H, W)``.
        array: name of the array in a ``.npz``.
    """

    path: Path
    suffix: str
    kind: str
    orientation: int = 1
    layout: str | None = None
    array: str | None = None

    @property
    def note(self) -> str:
        """Note for labels of the file, '' where there is nothing."""
        if self.orientation == 1:
            return ""
        return (
            f"{self.path.name}: EXIF orientation {self.orientation} is carried out: the result is upright and has no "
            "tag. Boxes must count in the upright picture, not in the stored pixels."
        )


def read_image(path: str | os.PathLike[str]) -> tuple[Tensor, ImageInfo]:
    """A frame as it was stored, upright.

    An EXIF orientation is carried out, for JPEG, PNG and TIFF alike. It turns the pattern of a mosaic as well, which
    is warned of. CMYK and palettes become RGB; transparency is dropped.

    Args:
        path: PNG (8 or 16 bit grey, 8 bit colour), TIFF (8 or 16 bit or float grey, 8 bit colour), JPEG, BMP, WebP,
            ``.npy``, or ``.npz`` (the array ``bayer``, else the only one), channels first or last.

    Returns:
        ``(1, H, W)`` for one value per pixel or ``(3, H, W)`` for colour, in the stored dtype; an array may carry
        batch dimensions in front. And what else is known of the file.

    Raises:
        TorchweatherError: the file is missing, truncated, no image, one that would lose something (several pages or
            pictures, colour of more than 8 bits a channel), or one that inflates to more than 64 MB and more than 100
            times its size: ``TORCHWEATHER_MAX_INFLATED_MB`` in the environment lifts that bound.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "frame.png"
        >>> write_image(file, torch.tensor([[[0, 4095], [370, 3967]]], dtype=torch.uint16))
        >>> frame, info = read_image(file)
        >>> frame.dtype, frame.shape, info.kind
        (torch.uint16, torch.Size([1, 2, 2]), 'mosaic')
    """
    check_arguments("read_image(path: path)", path)
    source = Path(path)
    suffix = source.suffix.lower()
    orientation = 1
    layout: str | None = None
    name = ""
    if suffix in _ARRAYS:
        name, array = read_named_array(source, ["bayer"])
        image, layout = _channels_first(array_to_tensor(array, source, "an image"), source)
    elif suffix in _PILLOW_FORMATS:
        pixels, orientation = _decoded(source)
        image = array_to_tensor(pixels[None] if pixels.ndim == 2 else np.moveaxis(pixels, -1, 0), source, "an image")
    else:
        raise TorchweatherError(f"{source}: expected {_WANTED}; got {suffix or 'no ending'}.")
    if image.numel() == 0:
        raise TorchweatherError(f"{source}: expected {_WANTED}; got one without pixels, shape {tuple(image.shape)}.")
    kind = "mosaic" if image.shape[-3] == 1 else "rgb"
    if kind == "mosaic" and orientation != 1:
        warnings.warn(
            f"{source}: EXIF orientation {orientation} turned the pixels upright, and the colour pattern with them if "
            "this is a raw mosaic. Give the turned pattern to the camera, or remove the tag.",
            TorchweatherWarning,
            stacklevel=2,
        )
    return image, ImageInfo(source, suffix, kind, orientation, layout, name or None)


def write_image(
    path: str | os.PathLike[str], image: Tensor, *, like: ImageInfo | None = None, png_level: int | None = None
) -> None:
    """Write a frame in the format that the file's ending names, whole or not at all.

    Args:
        path: ``.png`` or ``.tif(f)`` for ``uint8`` and ``uint16`` with one value per pixel and ``uint8`` colour,
            ``.bmp`` the same but ``uint16``, ``.jpg`` and ``.webp`` (lossless) for ``uint8`` colour only (they would
            smear a mosaic), ``.npy`` and ``.npz`` (array ``bayer`` or ``rgb``) for anything.
        image: ``(H, W)``, ``(1, H, W)`` or ``(3, H, W)``; for ``.npy`` and ``.npz`` also with batch dimensions.
        like: what `read_image` said of the file that the image comes from: an array is written in its layout, and in a
            ``.npz`` under its name.
        png_level: how hard a ``.png`` is compressed, 0 (not at all, fastest) to 9; ``None`` is 6. The pixels are the
            same.

    Raises:
        InputValueError: a level outside 0 to 9.
        TorchweatherError: the format cannot hold the image, or the folder does not exist.
    """
    check_arguments(
        "write_image(path: path, image: Tensor, like: ImageInfo | None, png_level: int | None)",
        path,
        image,
        like,
        png_level,
    )
    if png_level is not None:
        check_between("png_level", png_level, 0, 9, owner="write_image", advice="6 is usual, 1 fast.")
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise TorchweatherError(f"{target}: cannot be written; expected {_WANTED}; got {suffix or 'no ending'}.")
    pixels = image.detach().cpu()
    pixels = pixels[None] if pixels.ndim == 2 else pixels
    if pixels.ndim < 3 or pixels.shape[-3] not in (1, 3) or pixels.numel() == 0:
        raise TorchweatherError(
            f"{target}: expected an image of shape (H, W), (1, H, W) or (3, H, W); got {tuple(image.shape)}."
        )
    array = as_numpy(pixels)
    if suffix == ".npz":
        name = "bayer" if array.shape[-3] == 1 else "rgb"
        write_archive(target, {(like.array if like else None) or name: _laid_out(array, like)})
        return
    with atomic_write(target) as unfinished:
        if suffix == ".npy":
            np.save(unfinished, _laid_out(array, like), allow_pickle=False)
        else:
            _encode(target, suffix, array, unfinished, png_level)


def _laid_out(array: npt.NDArray[Any], like: ImageInfo | None) -> npt.NDArray[Any]:
    """Pixels ``(..., C, H, W)`` in the layout of the file that they come from."""
    if like is not None and like.layout == "channels_last":
        return np.ascontiguousarray(np.moveaxis(array, -3, -1))
    if like is not None and like.layout == "plane" and array.shape[0] == 1 and array.ndim == 3:
        plane: npt.NDArray[Any] = array[0]
        return plane
    return array


def _encode(target: Path, suffix: str, array: npt.NDArray[Any], unfinished: Path, png_level: int | None = None) -> None:
    from PIL import Image

    colour, form = array.shape[0] == 3, _PILLOW_FORMATS[suffix]
    kept = _HELD[form]
    if array.ndim != 3 or (str(array.dtype), colour) not in kept:
        held = " or ".join(f"{dtype} {'(3, H, W)' if c else '(1, H, W)'}" for dtype, c in sorted(kept))
        raise TorchweatherError(
            f"{target}: {suffix} holds {held} here; got {array.dtype} {array.shape}. Quantise it first "
            "(torchweather.image.quantise), or write .npy."
        )
    picture = Image.fromarray(np.ascontiguousarray(np.moveaxis(array, 0, -1)) if colour else array[0])
    level = {} if png_level is None or form != "PNG" else {"compress_level": int(png_level)}
    picture.save(unfinished, format=form, **_SAVE_OPTIONS.get(form, {}), **level)


def _decoded(source: Path) -> tuple[npt.NDArray[Any], int]:
    """Pixels ``(H, W)`` or ``(H, W, 3)`` of a picture file, upright, in the stored dtype; the orientation undone."""
    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file.")
    with source.open("rb") as file:
        return decoded_picture(file, source, source.stat().st_size)


def decoded_picture(file: BinaryIO, source: Path, stored_bytes: int) -> tuple[npt.NDArray[Any], int]:
    """Pixels of an encoded picture and the orientation undone, as `read_image` takes them from a file.

    Args:
        file: open at its start.
        source: its name, for errors.
        stored_bytes: its size, bytes.
    """
    from PIL import Image, UnidentifiedImageError, features

    if _is_deep_colour_png(file):
        # Pillow would hand over the upper eight bits without a word.
        raise TorchweatherError(
            f"{source}: a colour PNG of 16 bits per channel is not read without loss here. Convert it to .npy."
        )
    try:
        with _pillow_warnings(source), Image.open(file) as picture:
            _check_single(picture, source)
            _check_deep_tiff(picture, source)
            pixel_bytes = 2 if picture.mode.startswith("I;16") else _MODE_BYTES.get(picture.mode, 1)
            check_inflated(source, picture.width * picture.height * pixel_bytes, stored_bytes)
            orientation = _orientation(picture)
            picture.load()  # this turns a TIFF and takes its tag away, in some versions of Pillow
            upright = _plain(_turned(picture, _orientation(picture)))
            mode, pixels = upright.mode, np.asarray(upright)
    except UnidentifiedImageError as error:
        if source.suffix.lower() == ".webp" and not features.check("webp"):
            raise TorchweatherError(
                f"{source}: this Pillow was built without WebP. Install one with it, or convert the file to .png."
            ) from error
        raise TorchweatherError(f"{source}: expected {_WANTED}; the content is none of them.") from error
    except Image.DecompressionBombError as error:
        raise TorchweatherError(f"{source}: expected {_WANTED}; {error}.") from error
    except BROKEN_PICTURE as error:
        raise TorchweatherError(f"{source}: expected {_WANTED}; it is truncated or damaged ({error}).") from error
    if mode == "I" and pixels.min() >= 0 and pixels.max() <= 65535:
        # Some 16-bit files are opened in a 32-bit mode.
        return pixels.astype(np.uint16), orientation
    if mode not in ("L", "RGB", "I", "F") and not mode.startswith("I;16"):
        raise TorchweatherError(f"{source}: expected a grey or RGB picture; got mode {mode}.")
    return pixels, orientation


@contextmanager
def _pillow_warnings(source: Path) -> Iterator[None]:
    """Within the block Pillow's warnings of damaged tags become the package's own, which name the file.

    That of many pixels is left out: `check_inflated` bounds them.
    """
    from PIL import Image

    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        yield
    texts = [str(one.message) for one in found if not issubclass(one.category, Image.DecompressionBombWarning)]
    for text in dict.fromkeys(texts):
        warnings.warn(f"{source}: damaged: {text.strip()}", TorchweatherWarning, stacklevel=5)


def _check_single(picture: Image.Image, source: Path) -> None:
    """Refuse several pages and moving pictures: the others would be lost without a word."""
    count = getattr(picture, "n_frames", 1)
    # A phone's JPEG carries previews and gain maps beside the photograph, which comes first (Multi-Picture Object).
    if count == 1 or picture.format in ("MPO", "JPEG"):
        return
    if picture.format != "TIFF":
        raise TorchweatherError(
            f"{source}: expected one picture; got a moving one of {count} frames ({picture.format}). Extract its "
            "frames."
        )
    pages = []
    for number in range(count):
        picture.seek(number)
        # Bit 0 of NewSubfileType marks a smaller copy of another page.
        if not int(picture.tag_v2.get(_NEW_SUBFILE_TYPE, 0)) & 1:  # type: ignore[attr-defined]
            pages.append(number)
    if len(pages) != 1:
        raise TorchweatherError(f"{source}: expected one picture; got a TIFF of {count} pages. Split it into files.")
    picture.seek(pages[0])


def _check_deep_tiff(picture: Image.Image, source: Path) -> None:
    """Refuse colour of more than 8 bits a channel, of which Pillow would hand over the upper eight."""
    if picture.format != "TIFF":
        return
    stored = picture.tag_v2.get(_BITS_PER_SAMPLE, 1)  # type: ignore[attr-defined]
    bits = stored if isinstance(stored, tuple) else (stored,)
    channels = int(picture.tag_v2.get(_SAMPLES_PER_PIXEL, len(bits)))  # type: ignore[attr-defined]
    if channels > 1 and max(bits) > 8:
        raise TorchweatherError(
            f"{source}: a TIFF of {channels} channels with {max(bits)} bits each is not read without loss here. "
            "Convert it to .npy."
        )


def _orientation(picture: Image.Image) -> int:
    """EXIF orientation; 1, upright, where there is none or one that does not exist."""
    value = exif_tags(picture).get(ORIENTATION, 1)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def _turned(picture: Image.Image, orientation: int) -> Image.Image:
    """The picture as it is to be looked at."""
    from PIL.Image import Transpose

    # What undoes orientations 2 to 8 of EXIF 2.32: the sides at which row 0 and column 0 are to be seen.
    undo = (
        *(Transpose.FLIP_LEFT_RIGHT, Transpose.ROTATE_180, Transpose.FLIP_TOP_BOTTOM, Transpose.TRANSPOSE),
        *(Transpose.ROTATE_270, Transpose.TRANSVERSE, Transpose.ROTATE_90),
    )
    return picture if orientation == 1 else picture.transpose(undo[orientation - 2])


def _plain(picture: Image.Image) -> Image.Image:
    """Grey or RGB from palettes, inks and transparency, which is dropped; other modes as they are."""
    mode = picture.mode
    if mode in ("1", "LA"):
        return picture.convert("L")
    if mode in ("RGBA", "RGBX", "CMYK", "YCbCr"):
        return picture.convert("RGB")
    if mode in ("P", "PA", "RGBa"):
        # Through RGBA: straight to RGB a transparent palette is warned of, and premultiplied colour refused.
        return picture.convert("RGBA").convert("RGB")
    return picture


def _is_deep_colour_png(file: BinaryIO) -> bool:
    head = file.read(26)  # signature 8, chunk length and name 8, width 4, height 4, bit depth 1, colour type 1
    file.seek(0)
    return len(head) == 26 and head[:8] == b"\x89PNG\r\n\x1a\n" and head[24] == 16 and head[25] in (2, 4, 6)


def _channels_first(image: Tensor, source: Path) -> tuple[Tensor, str | None]:
    """The image ``(..., C, H, W)``, and the layout that it had, where that is another."""
    if image.ndim == 2:
        return image[None], "plane"
    if image.ndim >= 3 and image.shape[-3] in (1, 3):
        return image, None
    if image.ndim >= 3 and image.shape[-1] in (1, 3):
        return torch.movedim(image, -1, -3).contiguous(), "channels_last"
    raise TorchweatherError(
        f"{source}: expected an image (H, W), (..., C, H, W) or (..., H, W, C) with C = 1 or 3; got "
        f"{tuple(image.shape)}."
    )
