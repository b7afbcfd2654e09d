"""Small files that inflate, nest or never end: ``python -m tests.fuzz.bombs [--bomb npz]``.

Each is read in a child with a limit of its address space and 10 s; it must be refused in words, or be read within both.
"""

# ruff: noqa: E501
from __future__ import annotations

import argparse
import io as python_io
import json
import os
import struct
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tests.fuzz.outcome import Outcome, outcome_of
from tests.fuzz.totals import Counts, add_totals, report
from tests.fuzz.watched import watched
from torchweather import datasets, io
from torchweather.core.yaml_file import read_json, read_yaml
from torchweather.evaluation.robustness import read_boxes_truth, read_declaration
from torchweather.gap.model_file import read_model
from torchweather.recipes import read_recipe

__all__ = ["BOMBS", "defused"]

GIGABYTE = 1 << 30


@dataclass(frozen=True)
class Bomb:
    """A file and the reader that it is meant for."""

    name: str
    file: str
    make: Callable[[Path], Any]
    read: Callable[[Path], Any]


def deflated(size: int, *, raw: bool) -> bytes:
    """``size`` zero bytes, deflated at once: a block that a full flush has ended can be repeated."""
    block = 1 << 24
    press = zlib.compressobj(9, zlib.DEFLATED, -15)
    one = press.compress(bytes(block)) + press.flush(zlib.Z_FULL_FLUSH)
    body = one * (size // block) + zlib.compressobj(9, zlib.DEFLATED, -15).flush()
    # Adler-32 of zeros: the sum stays 1, and counts itself once a byte.
    return body if raw else b"\x78\xda" + body + struct.pack(">I", ((size // block * block) % 65521) << 16 | 1)


def array_header(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    """The head of a ``.npy`` file."""
    head = python_io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": kind, "fortran_order": False, "shape": shape})
    return head.getvalue()


def _archive(name: str, size: int, kind: str = "<f4") -> Callable[[Path], Any]:
    """An archive with one array of ``size`` bytes of zeros."""

    def make(path: Path) -> None:
        press = zlib.compressobj(9, zlib.DEFLATED, -15)
        head = array_header((size // np.dtype(kind).itemsize,), kind)
        data = press.compress(head) + press.flush(zlib.Z_FULL_FLUSH) + deflated(size, raw=True)
        entry, number = name.encode() + b".npy", (1 << 32) - 1
        total = min(len(head) + size, number)
        sizes = struct.pack("<III", 0, len(data), total)
        local = (
            b"PK\x03\x04" + struct.pack("<HHHHH", 20, 0, 8, 0, 33) + sizes + struct.pack("<HH", len(entry), 0) + entry
        )
        central = b"PK\x01\x02" + struct.pack("<HHHHHH", 20, 20, 0, 8, 0, 33) + sizes
        central += struct.pack("<HHHHHII", len(entry), 0, 0, 0, 0, 0, 0) + entry
        end = b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local) + len(data), 0)
        path.write_bytes(local + data + central + end)

    return make


def _many_members(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(30_000):
            archive.writestr(f"a{number}.npy", array_header((0,)))


def _png(width: int, height: int, colour: int = 0, depth: int = 8) -> Callable[[Path], Any]:
    def make(path: Path) -> None:
        rows = height * (1 + width * depth * (3 if colour == 2 else 1) // 8)
        chunks = (
            (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)),
            (b"IDAT", deflated(rows + (1 << 24), raw=False)),
            (b"IEND", b""),
        )
        path.write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + b"".join(
                struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
                for kind, data in chunks
            )
        )

    return make


def _png_text(path: Path) -> None:
    """A small picture with a text of 2 GB."""
    io.write_image(path, torch.zeros(1, 8, 8, dtype=torch.uint8))
    content = path.read_bytes()
    data = b"Comment\x00\x00" + deflated(2 * GIGABYTE, raw=False)
    chunk = struct.pack(">I", len(data)) + b"zTXt" + data + struct.pack(">I", zlib.crc32(b"zTXt" + data))
    path.write_bytes(content[:33] + chunk + content[33:])


def _tiff(path: Path) -> None:
    """Deflated, 60,000 x 60,000."""
    data = deflated(60_000 * 60_000, raw=False)
    tags = [(256, 4, 60_000), (257, 4, 60_000), (258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, 8), (277, 3, 1), (278, 4, 60_000),
            (279, 4, len(data))]  # fmt: skip
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    path.write_bytes(
        b"II*\x00" + struct.pack("<I", 8 + len(data)) + data + struct.pack("<H", len(tags)) + entries + bytes(4)
    )


def _bmp(path: Path) -> None:
    path.write_bytes(
        b"BM"
        + struct.pack("<IHHI", 200, 0, 0, 54)
        + struct.pack("<IiiHHIIiiII", 40, 90_000, 90_000, 1, 24, 0, 0, 0, 0, 0, 0)
    )


def _gz(path: Path) -> None:
    path.write_bytes(b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03" + deflated(4 * GIGABYTE, raw=True) + bytes(8))


def _pcd(head: str, data: bytes = b"") -> Callable[[Path], Any]:
    text = f"VERSION .7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n{head}\n"
    return lambda path: path.write_bytes(text.encode() + data)


def _lzf(path: Path) -> None:
    """Back references, each of 264 bytes: 88 times its size."""
    packed = b"\x00\x00" + (b"\xe0\xff\x00") * 3_000_000
    size = 1 + 264 * 3_000_000
    rows = size // 16
    _pcd(
        f"WIDTH {rows}\nHEIGHT 1\nPOINTS {rows}\nDATA binary_compressed",
        struct.pack("<II", len(packed), rows * 16) + packed,
    )(path)


def _text(text: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(text, encoding="utf-8")


def _lines(first: str, line: str, number: int, last: str = "") -> Callable[[Path], Any]:
    return lambda path: path.write_text(first + line * number + last, encoding="utf-8")


def _aliases(path: Path) -> None:
    lines = ["format: torchweather-recipe/2", "a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    path.write_text("\n".join(lines), encoding="utf-8")


def _netcdf4(path: Path) -> None:
    """A spectrum of 10 million intervals, of which the file stores none."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("data_raw", (10_000_000, 32, 32), "i4", chunks=(1, 32, 32))
        for name in (
            "diameter_lower_bounds",
            "diameter_upper_bounds",
            "velocity_lower_bounds",
            "velocity_upper_bounds",
        ):
            file[name] = np.linspace(0.1, 3.2, 32)
        file["time_interval"] = 60.0
        file["time"] = np.zeros(1)
        for name in ("data_raw", "time"):
            file[name].dims[0].label = "time"


def _netcdf3(path: Path) -> None:
    head = b"CDF\x01" + struct.pack(">I", 0)
    head += struct.pack(">III", 10, 1, 4) + b"time" + struct.pack(">I", 2_000_000_000)
    head += bytes(8) + struct.pack(">III", 11, 1, 10) + b"fall_speed\x00\x00" + struct.pack(">II", 1, 0)
    head += bytes(8) + struct.pack(">III", 6, 4_000_000_000, len(head) + 20)
    path.write_bytes(head)


def _las(path: Path) -> None:
    io.write_points(path, torch.rand(4, 4).round())
    content = bytearray(path.read_bytes())
    content[107:111] = struct.pack("<I", 4_000_000_000)
    content[247:255] = struct.pack("<Q", 1 << 62)
    path.write_bytes(bytes(content))


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


DEEP = 100_000
BOMBS = (
    *(
        Bomb(f"npz-{name}", "a.npz", _archive("points", 3 * GIGABYTE), read)
        for name, read in {
            "points": io.read_points,
            "image": io.read_image,
            "depth": io.read_depth,
            "map": io.read_power_map,
            "adc": io.read_adc,
            "radar": io.read_radar,
        }.items()
    ),
    Bomb("npz-panoptic", "a_panoptic.npz", _archive("data", 3 * GIGABYTE, "<u2"), io.read_labels),
    Bomb("npz-text", "a.npz", _archive("points", 3 * GIGABYTE, "<U1000"), io.read_points),
    Bomb("npz-members", "a.npz", _many_members, io.read_points),
    Bomb("npy-shape", "a.npy", lambda path: path.write_bytes(array_header((1 << 40,))), io.read_image),
    Bomb("npy-shape-product", "a.npy", lambda path: path.write_bytes(array_header((1 << 40, 1 << 40))), io.read_depth),
    Bomb("npy-nothing", "a.npy", lambda path: path.write_bytes(array_header((1 << 40, 0, 1 << 40))), io.read_depth),
    Bomb(
        "npy-head",
        "a.npy",
        lambda path: path.write_bytes(b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 31) + b"{'descr'"),
        io.read_image,
    ),
    Bomb(
        "npy-nested",
        "a.npy",
        lambda path: path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", 60_000) + b"(" * 60_000),
        io.read_image,
    ),
    Bomb("gz", "a.dat.gz", _gz, io.read_disdrometer),
    Bomb("png", "a.png", _png(60_000, 60_000), io.read_image),
    Bomb("png-wide", "a.png", _png(2**31 - 1, 1), io.read_image),
    Bomb("png-bits", "a.png", _png(120_000, 120_000, 0, 1), io.read_image),
    Bomb("png-colour", "a.png", _png(30_000, 30_000, 2), lambda path: io.read_depth(path, "carla")),
    Bomb("png-depth", "a.png", _png(40_000, 40_000, 0, 16), lambda path: io.read_depth(path, "kitti")),
    Bomb("png-map", "a.png", _png(60_000, 60_000), lambda path: io.read_power_map(path, "oxford")),
    Bomb("png-text", "a.png", _png_text, io.read_image),
    Bomb("png-text-exif", "a.png", _png_text, lambda path: io.read_exif_focal(path, 8, 8)),
    Bomb("tiff", "a.tiff", _tiff, io.read_image),
    Bomb("bmp", "a.bmp", _bmp, io.read_image),
    Bomb("pfm", "a.pfm", lambda path: path.write_bytes(b"Pf\n999999999 999999999\n-1.0\n"), io.read_depth),
    Bomb("pfm-head", "a.pfm", lambda path: path.write_bytes(b"Pf\n" + b"1" * (1 << 26)), io.read_depth),
    Bomb(
        "pcd-ascii",
        "a.pcd",
        _pcd("WIDTH 1000000000000\nHEIGHT 1\nPOINTS 1000000000000\nDATA ascii", b"1 2 3 4\n"),
        io.read_points,
    ),
    Bomb("pcd-binary", "a.pcd", _pcd("WIDTH 4000000000\nHEIGHT 4000000000\nDATA binary"), io.read_points),
    Bomb(
        "pcd-compressed",
        "a.pcd",
        _pcd("WIDTH 268435455\nHEIGHT 1\nDATA binary_compressed", struct.pack("<II", 8, 4294967280) + bytes(8)),
        io.read_points,
    ),
    Bomb("pcd-lzf", "a.pcd", _lzf, io.read_points),
    Bomb("pcd-fields", "a.pcd", _text("VERSION .7\nFIELDS " + "a " * 500_000 + "\n"), io.read_points),
    Bomb(
        "pcd-count",
        "a.pcd",
        _text("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1000000000\nWIDTH 1\nHEIGHT 1\nDATA ascii\n"),
        io.read_points,
    ),
    Bomb("pcd-line", "a.pcd", _text("#" * 200_000_000), io.read_points),
    Bomb(
        "ply",
        "a.ply",
        _text(
            "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
        ),
        io.read_points,
    ),
    Bomb(
        "ply-list",
        "a.ply",
        lambda path: path.write_bytes(
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty list uint float x\nproperty float y\nend_header\n"
            + b"\xff" * 40
        ),
        io.read_points,
    ),
    Bomb(
        "ply-elements",
        "a.ply",
        _lines("ply\nformat ascii 1.0\n", "element a 1\nproperty float x\n", 300_000, "end_header\n"),
        io.read_points,
    ),
    Bomb(
        "csv-columns",
        "a.csv",
        _text(",".join(f"c{k}" for k in range(200_000)) + "\n" + ",".join(["1"] * 200_000) + "\n"),
        io.read_points,
    ),
    Bomb(
        "csv-radar",
        "a.csv",
        _text(",".join(f"c{k}" for k in range(200_000)) + "\n" + ",".join(["1"] * 200_000) + "\n"),
        io.read_radar,
    ),
    Bomb("csv-cell", "a.csv", _text("x,y,z\n" + "9" * 50_000_000 + ",1,2\n"), io.read_points),
    Bomb("csv-table", "a.csv", _text("a,b\n" + "9" * 50_000_000 + ",1\n"), io.read_table),
    Bomb("csv-quote", "a.csv", _lines('a,b\n"', "x\n", 5_000_000), io.read_table),
    Bomb("las", "a.las", _las, io.read_points),
    Bomb("netcdf4", "a.nc", _netcdf4, io.read_disdrometer),
    Bomb("netcdf3", "a.cdf", _netcdf3, io.read_disdrometer),
    *(
        Bomb(f"yaml-deep-{k}", "a.yaml", _text(text), read_recipe)
        for k, text in enumerate(
            (
                "a: " + "[" * DEEP,
                "a: " + "{a: " * DEEP,
                "- " * DEEP,
                "? " * DEEP,
                "a: " + "!!x " * DEEP,
                "&a " * DEEP,
                "'" * DEEP,
            )
        )
    ),
    Bomb("yaml-aliases", "a.yaml", _aliases, read_recipe),
    Bomb("yaml-long", "a.yaml", _text("a: " + "x" * 15_000_000), read_declaration),
    Bomb("yaml-keys", "a.yaml", _text("\n".join(f"k{k}: 1" for k in range(20_000))), read_model),
    Bomb("yaml-integer", "a.yaml", _text("a: 1" + "0" * 10_000_000), lambda path: read_yaml(path, "a")),
    Bomb("yaml-sexagesimal", "a.yaml", _text("a: 1" + ":59" * 2_000_000), lambda path: read_yaml(path, "a")),
    Bomb("yaml-layout", "a.yaml", _text("dims: " + "[" * DEEP), lambda path: io.map_layout(str(path))),
    *(
        Bomb(f"json-{name}", "a.json", _text("[" * DEEP), read)
        for name, read in {
            "pose": io.read_sensor_pose,
            "camera": datasets.read_camera,
            "nuscenes": datasets.read_nuscenes_boxes,
            "calibration": datasets.read_nuscenes_calibration,
            "coco": lambda path: read_boxes_truth(path, {0: "car"}),
        }.items()
    ),
    Bomb("json-objects", "a.json", _text('{"a":' * DEEP), lambda path: read_json(path, "a")),
    Bomb("json-integer", "a.json", _text('{"a": 1' + "0" * 50_000_000 + "}"), lambda path: read_json(path, "a")),
    Bomb("json-keys", "a.json", lambda path: path.write_text(json.dumps({"a" * 20_000_000: 1})), datasets.read_camera),
    Bomb("calibration-numbers", "a.txt", _text("P2: " + "1 " * 3_000_000), datasets.read_kitti_calibration),
    Bomb("calibration-line", "a.txt", _text("P2" * 10_000_000), datasets.read_kitti_calibration),
    Bomb(
        "boxes-line",
        "a.txt",
        _text("Car " + "1" * 20_000_000),
        lambda path: datasets.read_kitti_boxes(path, torch.eye(4)),
    ),
    *(
        Bomb(f"pipe-{suffix[1:]}", f"a{suffix}", _pipe, read)
        for suffix, read in {
            ".png": io.read_image,
            ".bin": io.read_points,
            ".pcd": io.read_points,
            ".ply": io.read_points,
            ".npz": io.read_points,
            ".csv": io.read_table,
            ".yaml": read_recipe,
            ".label": io.read_labels,
            ".txt": datasets.read_kitti_calibration,
            ".json": datasets.read_camera,
            ".npy": io.read_depth,
            ".dat": io.read_disdrometer,
            ".las": io.read_points,
            ".pfm": io.read_depth,
        }.items()
    ),
    *(
        Bomb(f"endless-{suffix[1:]}", f"a{suffix}", _endless, read)
        for suffix, read in {
            ".png": io.read_image,
            ".bin": io.read_points,
            ".pcd": io.read_points,
            ".ply": io.read_points,
            ".npz": io.read_points,
            ".csv": io.read_points,
            ".yaml": read_recipe,
            ".label": io.read_labels,
            ".txt": datasets.read_kitti_calibration,
            ".json": datasets.read_camera,
            ".npy": io.read_depth,
            ".dat": io.read_disdrometer,
            ".pfm": io.read_depth,
        }.items()
    ),
)


def defused(bombs: tuple[Bomb, ...]) -> dict[str, Counts]:
    """The outcome of each bomb."""
    found: dict[str, Counts] = {}
    with tempfile.TemporaryDirectory(prefix="fuzz-bombs-") as folder:
        for at, bomb in enumerate(bombs):
            path = Path(folder) / str(at) / bomb.file
            path.parent.mkdir()
            bomb.make(path)

        def work(at: int) -> Outcome:
            return outcome_of(lambda: bombs[at].read(Path(folder) / str(at) / bombs[at].file), finite=False)

        begin = time.monotonic()
        for at, outcome in watched(work, range(len(bombs))):
            counts = found.setdefault(bombs[at].name.partition("-")[0], Counts())
            counts.add(outcome, f"--bomb {bombs[at].name}")
            now = time.monotonic()
            counts.seconds, begin = counts.seconds + now - begin, now
    return found


def main() -> int:
    """Run from the command line; exit code 1 where one was not defused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bomb", action="append", help="a bomb, or the beginning of several; all by default")
    parser.add_argument("--write", action="store_true", help="add the counts to totals.json")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found = defused(tuple(one for one in BOMBS if not given.bomb or one.name.startswith(tuple(given.bomb))))
    faults = report(found)
    if given.write:
        add_totals("bombs", 0, found)
    print(f"{sum(one.kinds.total() for one in found.values())} bombs, {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    raise SystemExit(main())
