"""PCD: headers as other programs write them, padding, organised clouds, and headers that lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.lzf import lzf_compress
from torchweather.io.points import read_points, write_points

# As PCL's binary writer lays out PointXYZI with padding, and a sensor driver its own fields.
HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z _ intensity _ ring t normal
SIZE 4 4 4 1 4 1 2 8 4
TYPE F F F U F U U F F
COUNT 1 1 1 4 1 12 1 1 3
WIDTH {width}
HEIGHT {height}
VIEWPOINT 1 2 3 1 0 0 0
POINTS {points}
DATA {data}
"""
ROW = np.dtype(
    [
        ("p", "<f4", 3),
        ("pad", "u1", 4),
        ("i", "<f4"),
        ("pad2", "u1", 12),
        ("ring", "<u2"),
        ("t", "<f8"),
        ("n", "<f4", 3),
    ]
)


def rows(count: int) -> np.ndarray:
    table = np.zeros(count, ROW)
    numbers = np.arange(count)
    table["p"] = numbers[:, None] + [1, 2, 3]
    table["i"] = numbers / 4
    table["ring"] = numbers
    table["t"] = 1.5e9 + numbers / 1024
    table["n"] = [0, 0, 1]
    return table


def write(path: Path, body: bytes, **header: object) -> Path:
    path.write_bytes(HEADER.format(**header).encode() + body)
    return path


def test_fields_of_any_type_and_count_come_back_byte_for_byte(tmp_path: Path) -> None:
    source = write(tmp_path / "a.pcd", rows(6).tobytes(), width=3, height=2, points=6, data="binary")
    found = read_points(source)
    assert found.columns == ("x", "y", "z", "intensity", "ring", "t", "normal_0", "normal_1", "normal_2")
    assert found.grid == (2, 3)
    assert found.points.dtype == torch.float64  # time stamps
    assert found.column("t").tolist() == rows(6)["t"].tolist()
    assert found.points[4, :5].tolist() == [4, 4, 4, 1, 4]  # seen from the viewpoint, (1, 2, 3)
    write_points(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_bytes() == source.read_bytes()


@pytest.mark.parametrize("encoding", ["ascii", "binary_compressed"])
def test_another_encoding_keeps_fields_comments_and_viewpoint(tmp_path: Path, encoding: str) -> None:
    found = read_points(write(tmp_path / "a.pcd", rows(6).tobytes(), width=3, height=2, points=6, data="binary"))
    write_points(tmp_path / "b.pcd", found, encoding=encoding)
    again = read_points(tmp_path / "b.pcd")
    assert torch.equal(again.points, found.points)
    assert again.grid == (2, 3)
    assert found.layout is not None
    assert again.layout is not None
    assert again.layout.fields == found.layout.fields
    assert b"VIEWPOINT 1 2 3 1 0 0 0\n" in (tmp_path / "b.pcd").read_bytes()
    write_points(tmp_path / "c.pcd", again, encoding="binary")
    assert (tmp_path / "c.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()


def test_compressed_points_are_stored_field_by_field(tmp_path: Path) -> None:
    """By hand: the plain bytes are all x, then all y, and so on, behind two sizes."""
    table = rows(4)
    columns = [table["p"][:, k] for k in range(3)] + [table[name] for name in ("pad", "i", "pad2", "ring", "t", "n")]
    plain = b"".join(np.ascontiguousarray(column).tobytes() for column in columns)
    packed = bytes(lzf_compress(plain))
    sizes = np.array([len(packed), len(plain)], "<u4").tobytes()
    header = {"width": 4, "height": 1, "points": 4, "data": "binary_compressed"}
    found = read_points(write(tmp_path / "a.pcd", sizes + packed, **header))
    assert found.grid is None
    assert found.points[3, :5].tolist() == [3, 3, 3, 0.75, 3]
    assert found.column("normal_2").tolist() == [1, 1, 1, 1]


def test_text_with_nan_and_whole_numbers_beyond_float64(tmp_path: Path) -> None:
    text = (
        "VERSION .7\nFIELDS x y z reflectivity stamp\nSIZE 4 4 4 1 8\nTYPE F F F U U\nWIDTH 2\nHEIGHT 2\nPOINTS 4\n"
        "DATA ascii\n1 2 3 200 9007199254740993\nnan nan nan 0 1\n\n-1.5 2e1 3 4 2\r\n0.1 0 0 5 3"
    )
    (tmp_path / "a.pcd").write_text(text, newline="")
    with pytest.raises(TorchweatherError, match="'stamp'"):
        read_points(tmp_path / "a.pcd")
    found = read_points(tmp_path / "a.pcd", columns=("x", "y", "z", "reflectivity"))
    assert found.points.dtype == torch.float32
    assert found.nan_rows == 1
    expected = [[1, 2, 3, 200], [0, 0, 0, 0], [-1.5, 20, 3, 4], [0.1, 0, 0, 5]]
    torch.testing.assert_close(found.points, torch.tensor(expected), rtol=0, atol=0)
    write_points(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_text().endswith("DATA ascii\n1 2 3 200\nnan nan nan 0\n-1.5 20 3 4\n0.1 0 0 5\n")


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_a_header_that_promises_a_hundred_gigabytes_is_refused_at_once(tmp_path: Path, data: str) -> None:
    body = np.array([4, 2**32 - 1], "<u4").tobytes() + b"\x00a\x20\x00" if data != "ascii" else b"1 2 3\n"
    source = write(tmp_path / "a.pcd", body, width=10**10, height=1, points=10**10, data=data)
    with pytest.raises(TorchweatherError, match=r"a\.pcd: expected 10000000000 points.*header"):
        read_points(source)


def test_a_stream_that_promises_more_than_lzf_can_hold_is_refused(tmp_path: Path) -> None:
    """40 million points of 54 bytes fit 32-bit sizes; four bytes cannot stand for them."""
    sizes = np.array([4, 40_000_000 * ROW.itemsize], "<u4").tobytes()
    header = {"width": 40_000_000, "height": 1, "points": 40_000_000, "data": "binary_compressed"}
    with pytest.raises(TorchweatherError, match="4 compressed bytes"):
        read_points(write(tmp_path / "a.pcd", sizes + b"\x00a\x20\x00", **header))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("HEIGHT 1", "HEIGHT 2"), "POINTS = WIDTH x HEIGHT"),
        (("WIDTH 2", "WIDTH -2"), "none negative"),
        (("POINTS 2", "POINTS 3"), "POINTS = WIDTH x HEIGHT"),
        (
            (
                "WIDTH 2\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 2",
                "WIDTH 3\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 3",
            ),
            "expected 3 points of at least 54 bytes",
        ),
        (
            (
                "WIDTH 2\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 2",
                "WIDTH 1\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS 1",
            ),
            "expected 1 points of 54 bytes",
        ),
        (("DATA binary", "DATA zip"), "expected DATA ascii"),
        (("TYPE F F F", "TYPE F F Q"), "field 'z'.*TYPE Q"),
        (("SIZE 4 4", "SIZE 4 3"), "field 'y'.*SIZE 3"),
        (("COUNT 1 1", "COUNT -1 1"), "COUNT -1"),
        (("COUNT 1 1", "COUNT 0 2"), "expected columns x, y, z"),
        (("VIEWPOINT 1 2 3 1 0 0 0", "VIEWPOINT 1 2 3"), "expected VIEWPOINT x y z w x y z"),
        (("VIEWPOINT 1 2 3", "VIEWPOINT 1 2 nan"), "expected VIEWPOINT"),
        (("SIZE 4 ", "SIZE "), "9 fields, 8 sizes"),
        (("WIDTH 2", "WIDTH two"), "invalid literal"),
        (("SIZE", "SIZ"), "KeyError"),
        (("DATA binary", "DAT binary"), "ends in a line DATA"),
        (("FIELDS x y z", "FIELDS x y x"), "'x' twice"),
        (("FIELDS x y z", "FIELDS x y w"), "expected columns x, y, z"),
    ],
)
def test_a_lying_header_is_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    header = HEADER.format(width=2, height=1, points=2, data="binary")
    (tmp_path / "a.pcd").write_bytes(header.replace(*change).encode() + rows(2).tobytes())
    with pytest.raises(TorchweatherError, match=rf"a\.pcd: .*{message}"):
        read_points(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("1 2 3 40\n5 6 7\n", "from line 9 on"),
        ("1 2 3 4\n5 6 seven 8\n", "seven"),
        ("1 2 3 4.5\n5 6 7 8\n", r"whole numbers 0\.\.255 \(uint8\) in column 4"),
        ("1 2 3 256\n5 6 7 8\n", "uint8"),
        ("1 2 3 4\n", "expected 2 rows of numbers.*got 1|expected 2 points"),
        ("1 2 3 4\n5 6 7 8\n9 9 9 9\n", "got 3"),
        ("1 2 3 4 5\n5 6 7 8 9\n", "rows of 4 numbers.*got 5"),
        ("1 2 1e400 4\n5 6 7 8\n", "z = inf"),
    ],
)
def test_broken_text_is_refused(tmp_path: Path, body: str, message: str) -> None:
    header = "FIELDS x y z i\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(header + body)
    with pytest.raises(TorchweatherError, match=message):
        read_points(tmp_path / "a.pcd")


def test_broken_compression_is_refused(tmp_path: Path) -> None:
    plain = len(rows(2).tobytes())
    header = {"width": 2, "height": 1, "points": 2, "data": "binary_compressed"}
    for packed, message in ((bytes([31] + [0] * 20), "compressed points are broken"), (b"\0", "are there")):
        sizes = np.array([max(len(packed), 4), plain], "<u4").tobytes()
        with pytest.raises(TorchweatherError, match=message):
            read_points(write(tmp_path / "a.pcd", sizes + packed, **header))
    with pytest.raises(TorchweatherError, match="8 bytes; got 3 bytes"):
        read_points(write(tmp_path / "a.pcd", b"abc", **header))


# As Ouster's old ROS driver writes: padding and a named field of count 0.
OUSTER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z _ intensity t reflectivity ring _ noise _ range _ empty
SIZE 4 4 4 1 4 4 2 1 1 2 1 4 1 4
TYPE F F F U F U U U U U U U U F
COUNT 1 1 1 4 1 1 1 1 0 1 1 1 15 0
WIDTH 3
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 3
DATA {data}
"""
OUSTER_ROW = np.dtype(
    [
        ("p", "<f4", 3),
        ("_0", "u1", 4),
        ("intensity", "<f4"),
        ("t", "<u4"),
        ("reflectivity", "<u2"),
        ("ring", "u1"),
        ("noise", "<u2"),
        ("_1", "u1"),
        ("range", "<u4"),
        ("_2", "u1", 15),
    ]
)


@pytest.mark.parametrize("data", ["binary", "ascii", "binary_compressed"])
def test_a_field_of_count_0_takes_no_bytes_and_is_no_column(tmp_path: Path, data: str) -> None:
    table = np.zeros(3, OUSTER_ROW)
    assert table.itemsize == 49
    table["p"] = [(10, 1, -1), (20, 2, 0), (30, 3, 1)]
    table["intensity"], table["ring"], table["range"] = [100, 50, 7], [0, 1, 2], [10099, 20100, 30166]
    table["reflectivity"] = [30, 20, 10]
    if data == "binary":
        body = table.tobytes()
    elif data == "ascii":
        flat = [[np.atleast_1d(row[name]).tolist() for name in OUSTER_ROW.names or ()] for row in table]
        body = "".join(" ".join(f"{value:g}" for part in row for value in part) + "\n" for row in flat).encode()
    else:
        names = [name for name in OUSTER_ROW.names or () if name != "p"]
        plain = table["p"].T.tobytes() + b"".join(np.ascontiguousarray(table[name]).tobytes() for name in names)
        packed = bytes(lzf_compress(plain))
        body = np.array([len(packed), len(plain)], "<u4").tobytes() + packed
    (tmp_path / "a.pcd").write_bytes(OUSTER.format(data=data).encode() + body)
    found = read_points(tmp_path / "a.pcd", intensity_unit="photons")
    assert found.columns == ("x", "y", "z", "intensity", "t", "reflectivity", "ring", "noise", "range")
    assert found.points[:, :4].tolist() == [[10, 1, -1, 100], [20, 2, 0, 50], [30, 3, 1, 7]]
    assert found.column("ring").tolist() == [0, 1, 2]
    assert found.column("range").tolist() == [10099, 20100, 30166]
    write_points(tmp_path / "b.pcd", found)
    if data == "binary":
        assert (tmp_path / "b.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()
    again = read_points(tmp_path / "b.pcd", intensity_unit="photons")
    assert again.columns == found.columns
    assert torch.equal(again.points, found.points)


MOVED = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {rows}\n"
    "HEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {rows}\nDATA binary\n"
)


def moved(path: Path, viewpoint: str, table: object) -> Path:
    rows = np.array(table, "<f4")
    path.write_bytes(MOVED.format(viewpoint=viewpoint, rows=len(rows)).encode() + rows.tobytes())
    return path


@pytest.mark.parametrize(
    ("viewpoint", "first"),
    [
        ("100 200 1.75 1 0 0 0", [10, 0, 0]),
        ("100 200 1.75 0 0 0 0", [10, 0, 0]),  # a writer that leaves the quaternion out
        # A quarter turn to the left: the sensor looks along the file's y, what lies along x is on its right.
        (f"100 200 1.75 {0.5**0.5} 0 0 {0.5**0.5}", [0, -10, 0]),
        ("100 200 1.75 2 0 0 2", [0, -10, 0]),
    ],
)
def test_a_viewpoint_is_applied_and_restored(tmp_path: Path, viewpoint: str, first: list[float]) -> None:
    table = [[110, 200, 1.75, 50], [130, 200, 1.75, 50], [0, 0, 0, 0], [101.1, 199.9, 3.3, 7], [np.nan] * 3 + [1]]
    source = moved(tmp_path / "a.pcd", viewpoint, table)
    found = read_points(source)
    torch.testing.assert_close(found.points[0, :3], torch.tensor(first, dtype=torch.float64), rtol=0, atol=1e-12)
    assert found.points[:, :3].norm(dim=1)[:3].tolist() == pytest.approx([10, 30, 0])
    assert found.nan_rows == 1
    write_points(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_bytes() == source.read_bytes()
    # A point that the weather put 5 m ahead of the sensor lies there in the file's frame too.
    hit = found.points.clone()
    hit[0, :3] = 0.5 * hit[0, :3]
    write_points(tmp_path / "c.pcd", found.with_points(hit[:2]))
    assert f"VIEWPOINT {viewpoint}".split()[:4] == (tmp_path / "c.pcd").read_text("latin-1").split("\n")[8].split()[:4]
    assert read_points(tmp_path / "c.pcd", viewpoint="ignore").points[0].tolist() == pytest.approx([105, 200, 1.75, 50])
    torch.testing.assert_close(read_points(tmp_path / "c.pcd").points, hit[:2], rtol=0, atol=1e-5)


def test_a_viewpoint_may_be_ignored_and_is_kept(tmp_path: Path) -> None:
    source = moved(tmp_path / "a.pcd", "100 200 1.7 1 0 0 0", [[110, 200, 1.7, 50], [130, 200, 1.7, 50]])
    found = read_points(source, viewpoint="ignore")
    assert found.points.dtype == torch.float32
    assert found.points[0, :2].tolist() == [110, 200]
    write_points(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_bytes() == source.read_bytes()
    write_points(tmp_path / "c.pcd", found.with_points(found.points[:1]))
    assert b"VIEWPOINT 100 200 1.7" in (tmp_path / "c.pcd").read_bytes()
    with pytest.raises(ValueError, match="viewpoint must be one of"):
        read_points(source, viewpoint="maybe")


def test_a_viewpoint_of_points_that_are_in_the_sensors_frame_already_is_refused(tmp_path: Path) -> None:
    source = moved(tmp_path / "a.pcd", "1000 2000 1.7 1 0 0 0", [[10, 5, -1.7, 50], [30, -4, 0, 50]])
    with pytest.raises(TorchweatherError, match=r"VIEWPOINT puts.*\(1000, 2000, 1\.7\) m.*viewpoint='ignore'"):
        read_points(source)
    assert read_points(source, viewpoint="ignore").points[0, 0] == 10
