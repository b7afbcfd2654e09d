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

from torchweather.errors import TorchweatherError
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


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".npy", ".npz"])
def test_truncated_files_are_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cut{suffix}"
    write_image(path, frame(torch.uint8, 3, 64, 64))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TorchweatherError, match=rf"cut\{suffix}.*wanted"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg", ".npy", ".npz", ".bmp", ""])
def test_files_that_are_no_image_are_named(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"text{suffix}"
    path.write_text("this is no image")
    with pytest.raises(TorchweatherError, match=r"text.*wanted"):
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
        ("x.bmp", torch.zeros(1, 4, 4, dtype=torch.uint8), "got .bmp"),
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
