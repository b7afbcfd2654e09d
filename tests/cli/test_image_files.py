"""apply and augment on images and depth maps of every layout: nothing is turned, transposed or lost without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from torchweather.cli import main

RECIPE = "camera/fog-50m"
LENS = ("--fx", "100", "--fy", "100")
FOG = ("--weather", "fog:mor=100", "--airlight", "0.7", "0.7", "0.7", *LENS)
HEIGHT, WIDTH, SKY_ROWS = 48, 64, 15


def picture() -> np.ndarray:
    """Sky above, a dark road, a red block in rows 30 to 39, columns 8 to 19."""
    pixels = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    pixels[:SKY_ROWS] = 200
    pixels[30:40, 8:20] = (220, 30, 30)
    return pixels


def depth(known: str = "all") -> np.ndarray:
    """10 m below the sky, in steps of 1/256 m; 0 is no value."""
    steps = np.zeros((HEIGHT, WIDTH), np.uint16)
    some = slice(None) if known == "all" else slice(None, None, 5)
    steps[SKY_ROWS :: 1 if known == "all" else 4, some] = 2560
    return steps


def apply(*argv: object) -> int:
    return main(["apply", "--quiet", *(str(one) for one in argv)])


def augment(*argv: object) -> int:
    return main(["augment", "--quiet", "--workers", "0", "--recipe", RECIPE, *(str(one) for one in argv)])


def test_sparse_depth_is_completed_and_not_sky(tmp_path: Path) -> None:
    Image.fromarray(picture()).save(tmp_path / "frame.png")
    found = {}
    for known in ("all", "some"):
        Image.fromarray(depth(known)).save(tmp_path / "d.png")
        encoded = ("--depth", tmp_path / "d.png", "--depth-encoding", "kitti")
        assert apply(tmp_path / "frame.png", "-o", tmp_path / known, *encoded, *FOG) == 0
        found[known] = np.asarray(Image.open(tmp_path / known / "frame.png")).astype(int)[20:]
    assert abs(found["some"] - found["all"]).max() <= 2
    # Fog of 100 m takes a quarter of 10 m; a road that counts as sky would be the airlight alone.
    red = found["some"][10:20, 8:20].mean((0, 1))
    assert red[0] > red[1] + 50


@pytest.mark.parametrize("shape", [(HEIGHT, WIDTH, 3), (HEIGHT, WIDTH, 1), (HEIGHT, WIDTH), (3, HEIGHT, WIDTH)])
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_arrays_come_back_in_their_layout(tmp_path: Path, shape: tuple[int, ...], suffix: str) -> None:
    pixels = np.moveaxis(picture(), -1, 0) if shape[0] == 3 else picture()[..., : shape[-1] if len(shape) == 3 else 1]
    pixels = pixels.reshape(shape)
    source = tmp_path / "src"
    source.mkdir()
    if suffix == ".npy":
        np.save(source / "frame.npy", pixels)
    else:
        np.savez(source / "frame.npz", image=pixels)
    bits = ("--bit-depth", "8", "--black-level", "0", "--white-level", "255") if shape.count(3) == 0 else ()
    assert apply(source / f"frame{suffix}", "-o", tmp_path / "out", "--depth", 30, *FOG, *bits) == 0
    written = np.load(tmp_path / "out" / f"frame{suffix}")
    written = written if suffix == ".npy" else written["image"]
    assert written.shape == shape
    assert written.dtype == np.uint8
    if 3 in shape:
        assert augment("--depth", 30, source, tmp_path / "augmented") == 0
        written = np.load(tmp_path / "augmented" / f"frame{suffix}")
        assert (written if suffix == ".npy" else written["image"]).shape == shape


def test_a_picture_stored_on_its_side_is_upright_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    source = tmp_path / "src"
    source.mkdir()
    stored = np.ascontiguousarray(picture().swapaxes(0, 1)[::-1])
    for suffix in (".jpg", ".png", ".webp"):
        Image.fromarray(stored).save(source / f"six{suffix}", exif=exif, quality=95)
    (source / "._six.png").write_bytes(b"\0\5\x16\7 resource fork")
    assert main(["apply", *map(str, (source, "-o", tmp_path / "out", "--depth", 5, *FOG))]) == 0
    assert "EXIF orientation 6" in capsys.readouterr().err
    assert augment("--depth", 5, source, tmp_path / "augmented") == 0
    assert "Boxes must count in the upright picture" in capsys.readouterr().err
    for folder in ("out", "augmented"):
        assert sorted(file.name for file in (tmp_path / folder).glob("six.*")) == ["six.jpg", "six.png", "six.webp"]
        for suffix in (".jpg", ".png", ".webp"):
            with Image.open(tmp_path / folder / f"six{suffix}") as written:
                assert written.getexif().get(0x0112, 1) == 1
                block = np.asarray(written).astype(int)[31:39, 9:19].mean((0, 1))
            assert block[0] > block[1] + 20


def test_augment_takes_distances_along_the_ray(tmp_path: Path) -> None:
    source = tmp_path / "src"
    source.mkdir()
    Image.fromarray(picture()).save(source / "frame.png")
    np.save(tmp_path / "d.npy", np.full((HEIGHT, WIDTH), 20.0, np.float32))
    found = {}
    for along in ("axis", "ray"):
        assert augment("--depth", tmp_path / "d.npy", "--depth-along", along, source, tmp_path / along) == 0
        found[along] = np.asarray(Image.open(tmp_path / along / "frame.png")).astype(int)
    # Along the ray all pixels are alike; along the axis the corner is farther away, and paler.
    assert found["axis"][-1, -1, 0] > found["ray"][-1, -1, 0]
    assert abs(found["axis"][HEIGHT // 2, WIDTH // 2] - found["ray"][HEIGHT // 2, WIDTH // 2]).max() <= 1
    assert augment("--depth", tmp_path / "d.npy", "--depth-along", "axis", source, tmp_path / "ray") == 2
