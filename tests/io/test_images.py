"""Images come back as they were stored, and broken files are named."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.image import develop
from torchweather.io import atomic_write, read_image, write_image


def frame(dtype: torch.dtype, channels: int = 1, height: int = 6, width: int = 10) -> torch.Tensor:
    top = 65536 if dtype == torch.uint16 else 256
    values = torch.randint(0, top, (channels, height, width), generator=torch.Generator().manual_seed(3))
    return values.to(dtype)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF", ".npy", ".npz"])
@pytest.mark.parametrize(("dtype", "channels"), [(torch.uint8, 1), (torch.uint16, 1), (torch.uint8, 3)])
def test_integers_come_back_exactly(tmp_path: Path, suffix: str, dtype: torch.dtype, channels: int) -> None:
    image = frame(dtype, channels)
    path = tmp_path / f"frame{suffix}"
    write_image(path, image)
    back, info = read_image(path)
    assert back.dtype == dtype
    assert torch.equal(back, image)
    assert info.kind == ("mosaic" if channels == 1 else "rgb")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_arrays_keep_floats_and_batches(tmp_path: Path, suffix: str) -> None:
    image = torch.rand(2, 5, 1, 4, 6, dtype=torch.float64)
    write_image(tmp_path / f"x{suffix}", image)
    assert torch.equal(read_image(tmp_path / f"x{suffix}")[0], image)


def test_jpeg_of_a_colour_image_is_close(tmp_path: Path) -> None:
    image = torch.tensor([200, 120, 40], dtype=torch.uint8)[:, None, None].expand(3, 16, 16)
    write_image(tmp_path / "x.jpg", image)
    back, info = read_image(tmp_path / "x.jpg")
    assert info.kind == "rgb"
    assert (back.int() - image.int()).abs().max() <= 3  # quality 95 of a flat colour: rounding of the transform


@pytest.mark.parametrize("shape", [(6, 10), (1, 6, 10), (6, 10, 1), (6, 10, 3), (3, 6, 10)])
def test_arrays_of_other_tools_become_channels_first(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "x.npy", np.zeros(shape, dtype=">u2"))
    image, _ = read_image(tmp_path / "x.npy")
    assert image.dtype == torch.uint16
    assert image.shape == (3 if 3 in shape else 1, 6, 10)


def test_npz_key_bayer_is_taken_among_several(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", bayer=np.full((4, 4), 7, np.uint8), depth=np.zeros((4, 4)))
    assert read_image(tmp_path / "x.npz")[0].float().mean() == 7
    np.savez(tmp_path / "y.npz", bayr=np.zeros((4, 4)), depth=np.zeros((4, 4)))
    with pytest.raises(TorchweatherError, match=r"named bayer.*got bayr, depth.*Did you mean 'bayr'"):
        read_image(tmp_path / "y.npz")


@pytest.mark.parametrize("mode", ["RGBA", "P", "L", "1"])
def test_other_picture_modes_become_grey_or_colour(tmp_path: Path, mode: str) -> None:
    Image.new("RGB", (4, 6), (255, 255, 255)).convert(mode).save(tmp_path / "x.png")
    image, _ = read_image(tmp_path / "x.png")
    assert image.shape == (1 if mode in ("L", "1") else 3, 6, 4)
    assert image.dtype == torch.uint8
    assert image.min() == 255


def png_with_16_bit_colour(path: Path) -> None:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", 2, 1, 16, 2, 0, 0, 0)
    pixels = zlib.compress(b"\x00" + bytes(12))
    signature = b"\x89PNG\r\n\x1a\n"
    path.write_bytes(signature + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b""))


def test_deep_colour_png_is_refused_rather_than_cut_to_eight_bits(tmp_path: Path) -> None:
    png_with_16_bit_colour(tmp_path / "x.png")
    with pytest.raises(TorchweatherError, match="16 bits per channel"):
        read_image(tmp_path / "x.png")


def scene() -> np.ndarray:
    """A picture (16, 24, 3) whose every corner and half differs: sky above, road below, a red block at the left."""
    picture = np.zeros((16, 24, 3), np.uint8)
    picture[:6] = (150, 180, 230)
    picture[6:] = (70, 70, 70)
    picture[9:13, 2:7] = (220, 20, 20)
    picture[0, 0] = (255, 255, 255)
    return picture


# How a picture is stored whose tag asks for the turn that makes it upright; by the sides at which EXIF 2.32 sees row
# 0 and column 0 (table 6): top left, top right, bottom right, bottom left, left top, right top, right bottom, left
# bottom.
STORED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda p: p,
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: p.swapaxes(0, 1)[::-1],
    7: lambda p: p.swapaxes(0, 1)[::-1, ::-1],
    8: lambda p: p.swapaxes(0, 1)[:, ::-1],
}


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
@pytest.mark.parametrize("orientation", list(STORED))
def test_photographs_come_upright_and_are_written_without_a_tag(tmp_path: Path, suffix: str, orientation: int) -> None:
    tags = Image.Exif()
    tags[0x0112] = orientation
    stored = np.ascontiguousarray(STORED[orientation](scene()))
    options = {"quality": 100, "subsampling": 0} if suffix == "jpg" else {}
    Image.fromarray(stored).save(tmp_path / f"x.{suffix}", exif=tags, **options)
    image, info = read_image(tmp_path / f"x.{suffix}")
    wanted = torch.from_numpy(scene()).movedim(-1, 0)
    assert image.shape == wanted.shape
    assert info.orientation == orientation
    if suffix == "jpg":  # the white pixel rings over its block of 8 x 8; elsewhere rounding is left
        assert (image.int() - wanted.int()).abs()[:, 8:].max() < 12
        assert image[:, 0, 0].min() > 230
    else:
        assert torch.equal(image, wanted)
    write_image(tmp_path / f"y.{suffix}", image)
    back, info = read_image(tmp_path / f"y.{suffix}")
    assert (back.shape, info.orientation) == (wanted.shape, 1)
    with Image.open(tmp_path / f"y.{suffix}") as picture:
        assert 0x0112 not in picture.getexif()


def test_a_turned_mosaic_is_warned_of(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags[0x0112] = 3
    raw = np.arange(24, dtype=np.uint16).reshape(4, 6)
    Image.fromarray(raw[::-1, ::-1].copy()).save(tmp_path / "x.png", exif=tags)
    with pytest.warns(TorchweatherWarning, match="orientation 3 turned the pixels upright, and the colour pattern"):
        image, _ = read_image(tmp_path / "x.png")
    assert torch.equal(image[0].int(), torch.from_numpy(raw.astype(np.int32)))


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_orientations_that_do_not_exist_turn_nothing(tmp_path: Path, orientation: int) -> None:
    tags = Image.Exif()
    tags[0x0112] = orientation
    Image.fromarray(scene()).save(tmp_path / "x.png", exif=tags)
    image, info = read_image(tmp_path / "x.png")
    assert info.orientation == 1
    assert torch.equal(image, torch.from_numpy(scene()).movedim(-1, 0))


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_inks_become_rgb(tmp_path: Path, suffix: str) -> None:
    """Cyan ink alone lets green and blue through; black ink alone leaves grey."""
    inks = np.zeros((16, 16, 4), np.uint8)
    inks[:8, :, 0] = 255
    inks[8:, :, 3] = 155
    options = {"quality": 100} if suffix == "jpg" else {}
    Image.fromarray(inks, mode="CMYK").save(tmp_path / f"x.{suffix}", **options)
    image, info = read_image(tmp_path / f"x.{suffix}")
    assert (info.kind, image.shape, image.dtype) == ("rgb", (3, 16, 16), torch.uint8)
    for rows, colour in ((slice(0, 8), (0, 255, 255)), (slice(8, 16), (100, 100, 100))):
        assert (image[:, rows].float().mean((1, 2)) - torch.tensor(colour)).abs().max() < 3


@pytest.mark.parametrize("transparent", [None, 1, bytes([255, 0, 128])])
def test_palettes_with_and_without_transparency_keep_their_colours(tmp_path: Path, transparent: object) -> None:
    picture = Image.fromarray(np.array([[0, 1, 2], [2, 1, 0]], np.uint8), mode="P")
    picture.putpalette([10, 20, 30, 200, 100, 50, 1, 2, 3])
    picture.save(tmp_path / "x.png", **({} if transparent is None else {"transparency": transparent}))
    image, _ = read_image(tmp_path / "x.png")
    assert image[:, 0].T.tolist() == [[10, 20, 30], [200, 100, 50], [1, 2, 3]]


@pytest.mark.parametrize("mode", ["LA", "PA", "RGBA", "RGBX"])
def test_alpha_is_dropped(tmp_path: Path, mode: str) -> None:
    Image.new("RGBA", (6, 4), (90, 90, 90, 7)).convert(mode).save(tmp_path / "x.tif")
    image, _ = read_image(tmp_path / "x.tif")
    assert image.shape == (1 if mode == "LA" else 3, 4, 6)
    assert image.unique().tolist() == [90]


def tiff(path: Path, planes: np.ndarray, *, contiguous: bool = True) -> None:
    """A plain TIFF of any number of channels and bits, one strip a plane: Pillow writes none of 16-bit colour."""
    height, width, channels = planes.shape
    parts = [planes] if contiguous else [planes[..., c] for c in range(channels)]
    strips = [np.ascontiguousarray(part).astype(planes.dtype.newbyteorder("<")).tobytes() for part in parts]
    entries = 10
    here = 8 + 2 + 12 * entries + 4
    bits_at = here
    here += 2 * channels
    lists_at = here
    here += 8 * len(strips)
    offsets = [here + sum(map(len, strips[:i])) for i in range(len(strips))]

    def values(kind: int, numbers: list[int], where: int) -> tuple[int, int, bytes]:
        packed = struct.pack(f"<{len(numbers)}{'H' if kind == 3 else 'I'}", *numbers)
        return kind, len(numbers), packed.ljust(4, b"\0") if len(packed) <= 4 else struct.pack("<I", where)

    tags = {
        256: values(3, [width], 0),
        257: values(3, [height], 0),
        258: values(3, [planes.dtype.itemsize * 8] * channels, bits_at),
        259: values(3, [1], 0),
        262: values(3, [2], 0),
        273: values(4, offsets, lists_at),
        277: values(3, [channels], 0),
        278: values(3, [height], 0),
        279: values(4, [len(strip) for strip in strips], lists_at + 4 * len(strips)),
        284: values(3, [1 if contiguous else 2], 0),
    }
    head = b"II*\0" + struct.pack("<IH", 8, entries)
    head += b"".join(struct.pack("<HHI", tag, kind, count) + value for tag, (kind, count, value) in tags.items())
    body = struct.pack(f"<I{channels}H", 0, *[planes.dtype.itemsize * 8] * channels)
    body += struct.pack(f"<{2 * len(strips)}I", *offsets, *map(len, strips))
    path.write_bytes(head + body + b"".join(strips))


@pytest.mark.parametrize("contiguous", [True, False])
@pytest.mark.parametrize("channels", [3, 4])
def test_deep_colour_tiff_is_refused_rather_than_cut_to_eight_bits(
    tmp_path: Path, channels: int, contiguous: bool
) -> None:
    planes = np.arange(4 * 6 * channels).reshape(4, 6, channels)
    tiff(tmp_path / "x.tif", (planes * 17).astype(np.uint16), contiguous=contiguous)
    with pytest.raises(TorchweatherError, match=rf"TIFF of {channels} channels with 16 bits each.*Convert it to \.npy"):
        read_image(tmp_path / "x.tif")
    if channels == 3:  # the same file of 8 bits is read: the writer above is right
        tiff(tmp_path / "y.tif", planes.astype(np.uint8), contiguous=contiguous)
        assert torch.equal(read_image(tmp_path / "y.tif")[0].movedim(0, -1), torch.from_numpy(planes.astype(np.uint8)))


def test_pages_are_refused_with_their_number(tmp_path: Path) -> None:
    pages = [Image.new("L", (6, 4), grey) for grey in (10, 20, 30)]
    pages[0].save(tmp_path / "x.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(TorchweatherError, match=r"got a TIFF of 3 pages\. Split it into files"):
        read_image(tmp_path / "x.tif")
    pages[0].save(tmp_path / "y.tif", save_all=True)
    assert read_image(tmp_path / "y.tif")[0].unique().tolist() == [10]


def test_a_smaller_copy_beside_the_picture_is_no_page(tmp_path: Path) -> None:
    large, small = Image.new("L", (12, 8), 10), Image.new("L", (6, 4), 20)
    small.encoderinfo = {"tiffinfo": {254: 1}}
    large.save(tmp_path / "x.tif", save_all=True, append_images=[small])
    image, _ = read_image(tmp_path / "x.tif")
    assert image.shape == (1, 8, 12)


@pytest.mark.parametrize("kind", ["PNG", "GIF", "WEBP"])
def test_moving_pictures_are_refused(tmp_path: Path, kind: str) -> None:
    frames = [Image.new("RGB", (8, 8), (40 * i, 0, 200)) for i in range(3)]
    try:
        frames[0].save(tmp_path / "x.png", format=kind, save_all=True, append_images=frames[1:])
    except KeyError:
        pytest.skip(f"this Pillow writes no {kind}")
    with pytest.raises(TorchweatherError, match=rf"moving one of 3 frames \({kind}\)"):
        read_image(tmp_path / "x.png")
    (tmp_path / "x.png").rename(tmp_path / f"x.{kind.lower()}")
    if kind == "GIF":
        with pytest.raises(TorchweatherError, match=rf"expected an image: .*got \.{kind.lower()}"):
            read_image(tmp_path / f"x.{kind.lower()}")


def test_a_phones_jpeg_with_a_preview_gives_its_photograph(tmp_path: Path) -> None:
    photograph, preview = Image.new("RGB", (16, 8), (200, 0, 0)), Image.new("RGB", (8, 4), (0, 0, 200))
    photograph.save(tmp_path / "x.jpg", format="MPO", save_all=True, append_images=[preview])
    image, _ = read_image(tmp_path / "x.jpg")
    assert image.shape == (3, 8, 16)
    assert image[0].float().mean() > 190


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".npy", ".npz"])
def test_truncated_files_are_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cut{suffix}"
    write_image(path, frame(torch.uint8, 3, 64, 64))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TorchweatherError, match=rf"cut\{suffix}.*(expected|cannot hold)"):
        read_image(path)


def test_a_tiff_without_its_width_is_named(tmp_path: Path) -> None:
    tiff(tmp_path / "x.tif", np.zeros((4, 6, 3), np.uint8))
    content = bytearray((tmp_path / "x.tif").read_bytes())
    content[10:12] = struct.pack("<H", 255)  # the first tag, ImageWidth, becomes another one
    (tmp_path / "x.tif").write_bytes(content)
    with pytest.raises(TorchweatherError, match=r"x\.tif.*expected"):
        read_image(tmp_path / "x.tif")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".npy", ".npz", ".bmp", ""])
def test_files_that_are_no_image_are_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"text{suffix}"
    path.write_text("this is no image")
    with pytest.raises(TorchweatherError, match=r"text.*expected"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_missing_and_empty_files_are_named(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(TorchweatherError, match="no such file"):
        read_image(tmp_path / f"none{suffix}")
    (tmp_path / f"empty{suffix}").touch()
    with pytest.raises(TorchweatherError, match="empty"):
        read_image(tmp_path / f"empty{suffix}")


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(TorchweatherError, match="never loaded"):
        read_image(tmp_path / "x.npy")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 4), complex), "complex128"),
        (np.zeros((2, 4, 4)), r"got \(2, 4, 4\)"),
        (np.zeros(5), r"got \(5,\)"),
        (np.zeros((0, 4)), "without pixels"),
    ],
)
def test_arrays_that_are_no_image_are_refused(tmp_path: Path, array: np.ndarray, message: str) -> None:
    np.save(tmp_path / "x.npy", array)
    with pytest.raises(TorchweatherError, match=message):
        read_image(tmp_path / "x.npy")


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("x.png", torch.zeros(1, 4, 4), "Quantise it first"),
        ("x.png", torch.zeros(3, 4, 4, dtype=torch.uint16), "write .npy"),
        ("x.jpg", torch.zeros(1, 4, 4, dtype=torch.uint8), r"holds uint8 \(3, H, W\)"),
        ("x.gif", torch.zeros(1, 4, 4, dtype=torch.uint8), "got .gif"),
        ("x.npy", torch.zeros(2, 4, 4), r"got \(2, 4, 4\)"),
        ("nowhere/x.npy", torch.zeros(1, 4, 4), "no folder"),
    ],
)
def test_what_cannot_be_written_is_refused_and_leaves_nothing(
    tmp_path: Path, name: str, image: torch.Tensor, message: str
) -> None:
    with pytest.raises(TorchweatherError, match=message):
        write_image(tmp_path / name, image)
    assert list(tmp_path.iterdir()) == []


def test_failed_write_keeps_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("old")

    def fail() -> None:
        with atomic_write(path) as unfinished:
            unfinished.write_text("half")
            raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        fail()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x.txt"]


def test_failed_write_of_a_new_file_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def save(file: Path, *_: object, **__: object) -> None:
        Path(file).write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "save", save)
    with pytest.raises(OSError, match="disk full"):
        write_image(tmp_path / "x.npy", torch.zeros(1, 4, 4))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.real_data
def test_twelve_bit_raw_frame_of_a_snowy_day(real_data: Callable[[str], Path]) -> None:
    image, info = read_image(real_data("stf_raw/2018-02-12_15-39-23_00100.tiff"))
    assert info.kind == "mosaic"
    assert image.dtype == torch.uint16
    assert image.shape == (1, 1024, 1920)
    values = image.to(torch.int32)
    assert (values.min().item(), values.max().item()) == (370, 3967)


@pytest.mark.real_data
def test_pattern_of_the_real_raw_frame_is_grbg(real_data: Callable[[str], Path]) -> None:
    """With the wrong green diagonal a grey street turns into a checkerboard: neighbours differ three times as much."""
    raw, _ = read_image(real_data("stf_raw/2018-02-12_15-39-23_00100.tiff"))

    def roughness(pattern: str) -> float:
        picture = develop(raw, pattern, black_level=370, white_level=4095)
        return float(picture.diff(dim=-1).abs().mean())

    assert roughness("GRBG") < 0.5 * roughness("RGGB")


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
@pytest.mark.parametrize(
    "shape", [(6, 10), (1, 6, 10), (6, 10, 1), (6, 10, 3), (3, 6, 10), (2, 6, 10, 3), (2, 3, 6, 10)]
)
def test_arrays_go_back_to_their_layout(tmp_path: Path, suffix: str, shape: tuple[int, ...]) -> None:
    stored = np.random.default_rng(1).integers(0, 4096, shape, dtype=np.uint16)
    if suffix == ".npy":
        np.save(tmp_path / "x.npy", stored)
    else:
        np.savez(tmp_path / "x.npz", picture=stored)
    image, info = read_image(tmp_path / f"x{suffix}")
    write_image(tmp_path / f"y{suffix}", image, like=info)
    back = np.load(tmp_path / f"y{suffix}")
    assert np.array_equal(back["picture"] if suffix == ".npz" else back, stored)
    write_image(tmp_path / f"z{suffix}", image)  # of its own, channels come first
    assert torch.equal(read_image(tmp_path / f"z{suffix}")[0], image)


@pytest.mark.parametrize(("suffix", "channels"), [(".bmp", 1), (".bmp", 3), (".webp", 3)])
def test_bmp_and_webp_lose_nothing(tmp_path: Path, suffix: str, channels: int) -> None:
    image = frame(torch.uint8, channels)
    write_image(tmp_path / f"x{suffix}", image)
    back, info = read_image(tmp_path / f"x{suffix}")
    assert torch.equal(back, image)
    assert info.kind == ("mosaic" if channels == 1 else "rgb")


@pytest.mark.parametrize(("suffix", "dtype", "channels"), [(".bmp", torch.uint16, 1), (".webp", torch.uint8, 1)])
def test_bmp_and_webp_refuse_what_they_cannot_hold(
    tmp_path: Path, suffix: str, dtype: torch.dtype, channels: int
) -> None:
    with pytest.raises(TorchweatherError, match=r"holds uint8 .*write \.npy"):
        write_image(tmp_path / f"x{suffix}", frame(dtype, channels))


def test_a_moving_webp_is_refused(tmp_path: Path) -> None:
    pages = [Image.new("RGB", (12, 8), (40 * k, 0, 0)) for k in range(3)]
    pages[0].save(tmp_path / "x.webp", save_all=True, append_images=pages[1:], lossless=True)
    with pytest.raises(TorchweatherError, match="moving one of 3 frames"):
        read_image(tmp_path / "x.webp")


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_is_carried_out_and_told(tmp_path: Path, suffix: str, orientation: int) -> None:
    upright = np.zeros((48, 64, 3), np.uint8)
    upright[:20] = (90, 140, 220)
    upright[30:40, 8:20] = (220, 30, 30)
    # How a camera stores it that was held so: the inverse of what a viewer does.
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.swapaxes(0, 1),
        6: upright.swapaxes(0, 1)[::-1],
        7: upright[::-1, ::-1].swapaxes(0, 1),
        8: upright.swapaxes(0, 1)[:, ::-1],
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = (
        {"quality": 100, "subsampling": 0} if suffix == ".jpg" else {"lossless": True} if suffix == ".webp" else {}
    )
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / f"x{suffix}", exif=exif, **options)
    image, info = read_image(tmp_path / f"x{suffix}")
    assert image.shape == (3, 48, 64)
    assert (image.int() - torch.from_numpy(upright).movedim(-1, 0).int()).abs().float().mean() < 4
    assert info.orientation == orientation
    assert ("upright" in info.note) == (orientation != 1)
    write_image(tmp_path / f"y{suffix}", image, like=info)
    with Image.open(tmp_path / f"y{suffix}") as written:
        assert written.size == (64, 48)
        assert written.getexif().get(0x0112, 1) == 1


def test_a_small_file_of_a_large_picture_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.new("I;16", (9000, 4000), 7).save(tmp_path / "x.png")
    with pytest.raises(TorchweatherError, match=r"inflate from 0\.\d MB to 72 MB.*TORCHWEATHER_MAX_INFLATED_MB=73"):
        read_image(tmp_path / "x.png")
    monkeypatch.setenv("TORCHWEATHER_MAX_INFLATED_MB", "73")
    assert read_image(tmp_path / "x.png")[0].shape == (1, 4000, 9000)
    monkeypatch.setenv("TORCHWEATHER_MAX_INFLATED_MB", "many")
    with pytest.raises(TorchweatherError, match="number of megabytes"):
        read_image(tmp_path / "x.png")
