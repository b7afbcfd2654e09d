"""Focal lengths from EXIF tags, against lenses whose geometry is known."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from torchweather.core.errors import TorchweatherError
from torchweather.io.exif import ExifFocal, focal_from_exif, read_exif_focal

FILM, LENS, PLANE, UNIT, PIXEL_X, PIXEL_Y = 0xA405, 0x920A, 0xA20E, 0xA210, 0xA002, 0xA003


def focal(tags: dict[int, object], width: int = 4032, height: int = 3024) -> float | None:
    found = focal_from_exif(tags, width, height)
    return None if found is None else found.focal_px


def test_full_frame_sees_what_film_sees() -> None:
    """A sensor of 36 x 24 mm: the equivalent is the lens itself, by the diagonal and by the width alike."""
    assert focal({FILM: 50}, 6000, 4000) == pytest.approx(50 / 36 * 6000)


def test_phones_agree_by_their_diagonal() -> None:
    """4.25 mm over pixels of 1.4 um, told as 26 mm: 3036 px; by the width it would be 2912."""
    assert focal({FILM: 26}) == pytest.approx(4.25 / 1.4e-3, rel=0.005)
    assert focal({FILM: 26}, 3024, 4032) == focal({FILM: 26})
    assert focal({FILM: 26}, 2016, 1512) == pytest.approx(focal({FILM: 26}) / 2)


@pytest.mark.parametrize(
    ("resolution", "unit"),
    [(4000 / 23.6 * 25.4, 2), (4000 / 23.6 * 25.4, None), (4000 / 23.6 * 10, 3), (4000 / 23.6, 4)],
)
def test_lens_and_pixels_of_a_millimetre(resolution: float, unit: int | None) -> None:
    tags: dict[int, object] = {LENS: IFDRational(35), PLANE: resolution} | ({UNIT: unit} if unit else {})
    assert focal(tags, 4000, 2667) == pytest.approx(35 / 23.6 * 4000)
    small = tags | {PIXEL_X: 4000, PIXEL_Y: 2667}
    assert focal(small, 1000, 667) == pytest.approx(35 / 23.6 * 1000)
    assert focal(small, 667, 1000) == pytest.approx(35 / 23.6 * 1000)  # turned upright


def test_a_cropped_picture_has_no_focal_length() -> None:
    found = focal_from_exif({FILM: 26, PIXEL_X: 4032, PIXEL_Y: 3024}, 4032, 1200)
    assert found is not None
    assert found.focal_px is None
    assert "4032 x 1200 px was cropped from one of 4032 x 3024 px" in found.evidence


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {FILM: 0},
        {FILM: "26mm"},
        {FILM: b"\x00"},
        {FILM: IFDRational(0, 0)},
        {FILM: math.nan},
        {FILM: -26},
        {LENS: 4.25},
        {LENS: 4.25, PLANE: 1000.0, UNIT: 9},
        {LENS: (1, 2), PLANE: 1000.0},
    ],
)
def test_tags_that_tell_nothing(tags: dict[int, object]) -> None:
    assert focal_from_exif(tags, 4032, 3024) is None


@pytest.mark.parametrize("millimetres", [1, 60000])
def test_views_that_no_lens_has_are_not_believed(millimetres: int) -> None:
    found = focal_from_exif({FILM: millimetres}, 4032, 3024)
    assert found is not None
    assert found.focal_px is None
    assert "would be a view of" in found.evidence


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_tags_are_read_from_files(tmp_path: Path, suffix: str) -> None:
    tags = Image.Exif()
    tags[0x010F] = "Maker"
    tags.get_ifd(0x8769)[FILM] = 28
    tags.get_ifd(0x8769)[LENS] = 4.3
    tags[0x8769] = tags.get_ifd(0x8769)  # Pillow writes it into a TIFF only so
    path = tmp_path / f"x.{suffix}"
    Image.new("RGB", (80, 60)).save(path, exif=tags)
    assert read_exif_focal(path, 80, 60) == ExifFocal(
        pytest.approx(28 * 100 / math.hypot(36, 24)), "FocalLengthIn35mmFilm 28 mm, along the diagonal"
    )


def test_files_without_tags_and_no_files(tmp_path: Path) -> None:
    Image.new("RGB", (8, 6)).save(tmp_path / "x.png")
    assert read_exif_focal(tmp_path / "x.png", 8, 6) is None
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY")
    assert read_exif_focal(tmp_path / "x.npy", 8, 6) is None
    with pytest.raises(TorchweatherError, match="no such file"):
        read_exif_focal(tmp_path / "none.jpg", 8, 6)


def test_damaged_tags_are_none(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags[0x010F] = "Maker"
    tags.get_ifd(0x8769)[FILM] = 28
    Image.new("RGB", (80, 60)).save(tmp_path / "x.jpg", exif=tags)
    content = bytearray((tmp_path / "x.jpg").read_bytes())
    start = content.index(b"Exif\x00\x00") + 6
    content[start + 4 : start + 40] = b"\xff" * 36  # offsets into nowhere
    (tmp_path / "x.jpg").write_bytes(content)
    assert read_exif_focal(tmp_path / "x.jpg", 80, 60) is None
