"""Focal length of a photograph from its EXIF tags."""

from __future__ import annotations

import math
import os
import struct
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import TorchweatherError

if TYPE_CHECKING:
    from PIL import Image

__all__ = ["ExifFocal", "exif_tags", "focal_from_exif", "read_exif_focal"]

# Tag numbers of EXIF 2.32 (JEITA CP-3451), the tags of the Exif IFD and of the main one together.
ORIENTATION = 0x0112
_EXIF_IFD = 0x8769
_FOCAL_LENGTH_MM = 0x920A
_FOCAL_LENGTH_IN_35_MM = 0xA405
_PIXEL_X, _PIXEL_Y = 0xA002, 0xA003
_PLANE_X_RESOLUTION, _PLANE_UNIT = 0xA20E, 0xA210
# FocalPlaneResolutionUnit: 2 inch (the default), 3 cm; 4 and 5 are written by some cameras.
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
# What Pillow raises for a broken file; TypeError and the last ones of tags with a wrong type or number of values.
BROKEN_PICTURE = (
    *(OSError, SyntaxError, ValueError, EOFError, zlib.error, struct.error),
    *(TypeError, LookupError, ArithmeticError),
)
# Full angles of view along the diagonal that a camera with straight lines can have: beyond 150 degrees lenses are
# fisheyes, below 1 degree telescopes. Tags outside are wrong more often than right.
_DIAGONAL_VIEW_DEG = (1.0, 150.0)


@dataclass(frozen=True)
class ExifFocal:
    """A focal length in pixels and the tags it comes from.

    Args:
        focal_px: in pixels of the frame, the same in both directions; ``None`` where the tags cannot be used.
        evidence: the tags and their values, or why they cannot be used.
    """

    focal_px: float | None
    evidence: str


def focal_from_exif(tags: Mapping[int, Any], width: int, height: int) -> ExifFocal | None:
    """The focal length of a frame of this size, from the tags of its file.

    ``FocalLengthIn35mmFilm`` compares angles of view along the *diagonal* (CIPA DCG-001), of 43.27 mm on 35 mm film:
    ``f = f35 diagonal / 43.27``. By the 36 mm of its width a 4:3 frame would come out 4 % shorter; phones whose pixel
    pitch is published agree with the diagonal within 1 %. Whole millimetres leave 2 % at 26 mm. Without that tag,
    ``FocalLength`` and ``FocalPlaneXResolution`` give the pixels of a millimetre.

    Args:
        tags: by tag number, such as `exif_tags` returns.
        width, height: of the frame, pixels, upright or not.

    Returns:
        The focal length with its evidence; ``None`` where no tag tells one. A frame that was cropped after it was
        taken (its shape differs from the recorded one) has no focal length: nobody knows which part is left.

    Example:
        >>> focal_from_exif({0xA405: 26}, 4032, 3024)
        ExifFocal(focal_px=3028..., evidence='FocalLengthIn35mmFilm 26 mm, along the diagonal')
    """
    film_mm = _positive(tags.get(_FOCAL_LENGTH_IN_35_MM))
    lens_mm, per_unit = _positive(tags.get(_FOCAL_LENGTH_MM)), _positive(tags.get(_PLANE_X_RESOLUTION))
    unit_mm = _UNIT_MM.get(int(_positive(tags.get(_PLANE_UNIT)) or 2))
    recorded = _positive(tags.get(_PIXEL_X)), _positive(tags.get(_PIXEL_Y))
    if film_mm is None and (lens_mm is None or per_unit is None or unit_mm is None):
        return None
    scale = 1.0
    if recorded[0] is not None and recorded[1] is not None:
        long_side, short_side = max(recorded[0], recorded[1]), min(recorded[0], recorded[1])
        scale = max(width, height) / long_side
        # 1 %: whole pixels of a small copy.
        if abs(min(width, height) / short_side / scale - 1) > 0.01:
            return ExifFocal(
                None,
                f"EXIF not used: the frame of {width} x {height} px was cropped from one of {recorded[0]:g} x "
                f"{recorded[1]:g} px",
            )
    if film_mm is not None:
        focal = film_mm * math.hypot(width, height) / FILM_DIAGONAL_MM
        evidence = f"FocalLengthIn35mmFilm {film_mm:g} mm, along the diagonal"
    else:
        assert lens_mm is not None
        assert per_unit is not None
        assert unit_mm is not None
        focal = lens_mm * per_unit / unit_mm * scale
        evidence = f"FocalLength {lens_mm:g} mm and FocalPlaneXResolution {per_unit / unit_mm:.4g} px/mm"
    view = math.degrees(2 * math.atan2(math.hypot(width, height) / 2, focal))
    if not _DIAGONAL_VIEW_DEG[0] <= view <= _DIAGONAL_VIEW_DEG[1]:
        return ExifFocal(None, f"EXIF not used: {evidence} would be a view of {view:.3g} degrees")
    return ExifFocal(focal, evidence)


def read_exif_focal(path: str | os.PathLike[str], width: int, height: int) -> ExifFocal | None:
    """Focal length in a photograph's file, for a frame of this size.

    Args:
        path: JPEG, PNG or TIFF; other files have no tags.
        width, height: of the frame, pixels.

    Returns:
        As `focal_from_exif`.

    Raises:
        TorchweatherError: the file is missing.
    """
    check_arguments("read_exif_focal(path: path, width: int, height: int)", path, width, height)
    from PIL import Image

    source = Path(path)
    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the size; `read_image` speaks about pixels
            with Image.open(source) as picture:
                tags = exif_tags(picture)
    except (*BROKEN_PICTURE, Image.DecompressionBombError):
        return None
    return focal_from_exif(tags, width, height)


def exif_tags(picture: Image.Image) -> dict[int, Any]:
    """EXIF tags of an opened picture, main and Exif IFD together; none where they are damaged."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged tags make no picture unreadable
            exif = picture.getexif()
            return {**dict(exif), **dict(exif.get_ifd(_EXIF_IFD))}
    except Exception:  # a parser of foreign bytes raises anything
        return {}


def _positive(value: Any) -> float | None:
    """A number above zero; ``None`` for what is none (EXIF writes 0, and 0/0, for unknown)."""
    if isinstance(value, (tuple, list)) and len(value) == 1:
        value = value[0]
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
