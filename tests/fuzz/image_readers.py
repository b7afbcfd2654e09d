"""Readers of pictures, depth, disparity, videos and photographs' tags."""

# ruff: noqa: SIM105
from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from tests.fuzz.reader import Reader, saved
from torchweather import io
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness.truth import read_label_truth
from torchweather.io.depth import read_disparity
from torchweather.io.video import VideoReader, write_video

__all__ = ["READERS"]

COLOURS = torch.arange(3 * 10 * 12).reshape(3, 10, 12).to(torch.uint8)
MOSAIC = (torch.arange(120, dtype=torch.int32) * 500).reshape(1, 10, 12).to(torch.uint16)
DEPTH = 2.0 + torch.arange(120, dtype=torch.float32).reshape(10, 12) / 4.0


def _pictures(suffix: str, pictures: Sequence[Tensor]) -> Callable[[Path], list[bytes]]:
    def make(folder: Path) -> list[bytes]:
        return [
            saved(folder, f"{k}{suffix}", lambda path, one=one: io.write_image(path, one))
            for k, one in enumerate(pictures)
        ]

    return make


def _photographs(suffix: str) -> Callable[[Path], list[bytes]]:
    """Pictures with EXIF: an orientation and a focal length."""

    def make(folder: Path) -> list[bytes]:
        picture = Image.fromarray(COLOURS.permute(1, 2, 0).numpy())
        tags = picture.getexif()
        tags[0x0112] = 6
        tags.get_ifd(0x8769).update({0xA405: 26, 0x920A: 4.25, 0xA20E: 5000.0, 0xA210: 3})
        grey = Image.fromarray(COLOURS[0].numpy())
        palette = picture.quantize(8)
        found = [saved(folder, f"a{suffix}", lambda path: picture.save(path, exif=tags))]
        found.append(saved(folder, f"b{suffix}", grey.save))
        if suffix == ".png":
            found.append(saved(folder, f"c{suffix}", palette.save))
        return found

    return make


def _tiffs(folder: Path) -> list[bytes]:
    """Grey of 8 and 16 bits and float, colour with and without compression, two pages."""
    picture = Image.fromarray(COLOURS.permute(1, 2, 0).numpy())
    pages = {"save_all": True, "append_images": [picture]}
    return [
        *_pictures(".tiff", [COLOURS, COLOURS[:1], MOSAIC])(folder),
        saved(folder, "d.tiff", Image.fromarray(DEPTH.numpy()).save),
        saved(folder, "e.tiff", lambda path: picture.save(path, compression="tiff_lzw")),
        saved(folder, "f.tiff", lambda path: picture.save(path, compression="tiff_deflate")),
        saved(folder, "g.tiff", lambda path: picture.save(path, **pages)),
    ]


def _through(path: Path) -> Any:
    """Read and written again, in its own format."""
    found, info = io.read_image(path)
    if found.dtype == torch.uint8 or path.suffix in (".npy", ".npz"):
        try:
            io.write_image(path.with_name(f"again{path.suffix}"), found, like=info)
        except TorchweatherError:
            pass  # a format that holds less than it reads: a grey JPEG
    return None if found.is_floating_point() else found


def _depth(encoding: str | None) -> Callable[[Path], Any]:
    def read(path: Path) -> Any:
        found = io.read_depth(path, encoding)
        known = found[~found.isnan()]  # NaN is unknown, infinity is sky, 0 a colour of CARLA
        assert bool((known >= 0).all() if encoding == "carla" else (known > 0).all()), (
            f"depths of {float(known.min())} m"
        )
        return found.shape

    return read


def _disparity(path: Path) -> Any:
    found = read_disparity(path)
    return found[~found.isnan()]


def _arrays(suffix: str, *arrays: Any, name: str = "") -> Callable[[Path], list[bytes]]:
    def make(folder: Path) -> list[bytes]:
        if suffix == ".npy":
            return [saved(folder, "a.npy", lambda path, one=one: np.save(path, one)) for one in arrays]
        writers = (np.savez, np.savez_compressed)
        return [
            saved(folder, "a.npz", lambda path, one=one, k=k: writers[k % 2](path, **{name: one}))
            for k, one in enumerate(arrays)
        ]

    return make


def _pfm(_: Path) -> list[bytes]:
    values = DEPTH.numpy()[::-1]
    return [
        b"Pf\n12 10\n-1.0\n" + values.astype("<f4").tobytes(),
        b"Pf\n12 10\n1.0\n" + values.astype(">f4").tobytes(),
    ]


def _coded(folder: Path) -> list[bytes]:
    return [saved(folder, "a.png", lambda path: io.write_image(path, (1 + DEPTH * 256)[None].to(torch.uint16)))]


def _video(folder: Path) -> list[bytes]:
    def write(path: Path) -> None:
        with write_video(path, 16, 16, 10) as video:
            for level in (10, 90, 200):
                video.add(torch.full((3, 16, 16), level, dtype=torch.uint8))

    return [saved(folder, "a.mp4", write)]


def _frames(path: Path) -> Any:
    reader = VideoReader(path)
    return sum(1 for _ in zip(reader, range(20), strict=False))


READERS = (
    Reader("image-png", "a.png", _pictures(".png", [COLOURS, COLOURS[:1], MOSAIC]), _through),
    Reader("image-png-tags", "a.png", _photographs(".png"), _through),
    Reader("image-jpeg", "a.jpg", _photographs(".jpg"), _through),
    Reader("image-tiff", "a.tiff", _tiffs, _through),
    Reader("image-bmp", "a.bmp", _pictures(".bmp", [COLOURS, COLOURS[:1]]), _through),
    Reader("image-webp", "a.webp", _pictures(".webp", [COLOURS]), _through),
    Reader(
        "image-npy",
        "a.npy",
        _arrays(".npy", COLOURS.numpy(), MOSAIC.numpy(), COLOURS.permute(1, 2, 0).numpy()),
        _through,
    ),
    Reader("image-npz", "a.npz", _arrays(".npz", MOSAIC.numpy(), COLOURS.float().numpy(), name="bayer"), _through),
    Reader("image-exif", "a.jpg", _photographs(".jpg"), lambda path: io.read_exif_focal(path, 12, 10)),
    Reader("image-exif-png", "a.png", _photographs(".png"), lambda path: io.read_exif_focal(path, 12, 10)),
    Reader(
        "image-labels",
        "a.png",
        _pictures(".png", [COLOURS[:1]]),
        lambda path: read_label_truth(path.parent, "a", "camera", (10, 12)),
    ),
    Reader("depth-png", "a.png", _coded, _depth("kitti")),
    Reader("depth-carla", "a.png", _pictures(".png", [COLOURS]), _depth("carla")),
    Reader(
        "depth-tiff",
        "a.tiff",
        lambda folder: [saved(folder, "a.tiff", Image.fromarray(DEPTH.numpy()).save)],
        _depth(None),
    ),
    Reader("depth-pfm", "a.pfm", _pfm, _depth(None)),
    Reader("depth-npy", "a.npy", _arrays(".npy", DEPTH.numpy(), DEPTH.double()[None].numpy()), _depth(None)),
    Reader("depth-npz", "a.npz", _arrays(".npz", DEPTH.numpy(), DEPTH.half().numpy(), name="depth_m"), _depth(None)),
    Reader("disparity-pfm", "a.pfm", _pfm, _disparity),
    Reader("disparity-npz", "a.npz", _arrays(".npz", DEPTH.numpy(), name="disparity"), _disparity),
    Reader("video", "a.mp4", _video, _frames),
)
