"""PLY: either byte order, elements beside the vertices, comments, and headers that lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.points import read_points, write_points

VERTEX = "element vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty uchar intensity\n"
FACE = "element face 2\nproperty list uchar int vertex_index\nproperty float area\n"
CAMERA = "element camera 1\nproperty double f\nproperty short n\n"


def ply(encoding: str, *elements: str) -> bytes:
    return f"ply\nformat {encoding} 1.0\ncomment made by hand\n{''.join(elements)}end_header\n".encode()


def body(order: str) -> dict[str, bytes]:
    vertex = np.array([((1, 2, 3), 200), ((4, 5, 6), 7)], [("p", order + "f4", 3), ("i", "u1")]).tobytes()
    face = b""
    for indices in ([0, 1, 0], [1, 0, 1, 0]):
        face += bytes([len(indices)]) + np.array(indices, order + "i4").tobytes()
        face += np.array(0.5, order + "f4").tobytes()
    camera = np.array((35.0, 3), [("f", order + "f8"), ("n", order + "i2")]).tobytes()
    return {VERTEX: vertex, FACE: face, CAMERA: camera}


@pytest.mark.parametrize("elements", [(VERTEX,), (VERTEX, FACE), (FACE, CAMERA, VERTEX), (CAMERA, VERTEX, FACE)])
@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_vertices_are_found_among_other_elements(tmp_path: Path, encoding: str, elements: tuple[str, ...]) -> None:
    if encoding == "ascii":
        text = {VERTEX: "1 2 3 200\n4 5 6 7\n", FACE: "3 0 1 0 0.5\n4 1 0 1 0 0.5\n", CAMERA: "35 3\n"}
        content = "".join(text[element] for element in elements).encode()
    else:
        parts = body(">" if "big" in encoding else "<")
        content = b"".join(parts[element] for element in elements)
    source = tmp_path / "a.ply"
    source.write_bytes(ply(encoding, *elements) + content)
    found = read_points(source)
    assert found.points.tolist() == [[1, 2, 3, 200], [4, 5, 6, 7]]
    write_points(tmp_path / "b.ply", found)
    again = read_points(tmp_path / "b.ply")
    assert torch.equal(again.points, found.points)
    assert b"comment made by hand\n" in (tmp_path / "b.ply").read_bytes()
    if elements == (VERTEX,):
        assert (tmp_path / "b.ply").read_bytes() == source.read_bytes()


def test_windows_line_ends_in_the_header(tmp_path: Path) -> None:
    header = ply("binary_little_endian", VERTEX).replace(b"\n", b"\r\n")
    (tmp_path / "a.ply").write_bytes(header + body("<")[VERTEX])
    assert read_points(tmp_path / "a.ply").points[1].tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"plx\n", "expected a PLY header"),
        (b"ply\nformat ascii 1.0\n", "expected a PLY header"),
        (ply("ascii", FACE), "expected an element vertex; got face"),
        (ply("morse", VERTEX), "expected format ascii"),
        (ply("ascii", "element vertex two\n"), "element vertex two"),
        (ply("ascii", "property float x\n"), "IndexError"),
        (ply("ascii", VERTEX.replace("uchar", "quad")), "quad"),
        (ply("ascii", "banana\n"), "no such line in PLY"),
        (ply("ascii", "element vertex 2\nproperty list uchar int i\n"), "single numbers"),
        (ply("ascii", VERTEX.replace("vertex 2", "vertex -2")), "negative"),
        (ply("binary_little_endian", VERTEX) + bytes(25), "expected 2 points of at least 13 bytes"),
        (ply("binary_little_endian", VERTEX.replace("vertex 2", "vertex 9999999999")) + bytes(26), "9999999999 points"),
        (ply("ascii", VERTEX.replace("vertex 2", "vertex 9999999999")) + bytes(26), "9999999999 points"),
        (ply("binary_little_endian", CAMERA, VERTEX) + bytes(4), "expected 1 rows of camera of at least 10 bytes"),
        (ply("binary_little_endian", FACE, VERTEX) + bytes(8), "expected 2 rows of face of at least 5 bytes"),
        (ply("binary_little_endian", FACE.replace("2", "999999999999", 1), VERTEX) + bytes(8), "999999999999"),
        (ply("binary_little_endian", FACE, VERTEX) + bytes([255]) + bytes(20), "ends within them"),
        (ply("ascii", VERTEX) + b"1 2 3 4\n5 6 7 x\n", "x"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(TorchweatherError, match=rf"a\.ply: .*({message})"):
        read_points(tmp_path / "a.ply")


VIEWED = (
    "element vertex 3\nproperty list uchar int view\nproperty float x\nproperty float y\nproperty float z\n"
    "property list ushort double weights\nproperty float intensity\nproperty list uint uchar tags\n"
)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("elements", [(VIEWED,), (CAMERA, FACE, VIEWED), (VIEWED, FACE)])
@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_lists_among_the_numbers_of_a_vertex_are_stepped_over(
    tmp_path: Path, encoding: str, elements: tuple[str, ...], even: bool
) -> None:
    wanted = [[1, 2, 3, 0.5], [4, 5, 6, 0.25], [7, 8, 9, 0.125]]
    lengths = [(2, 1, 0)] * 3 if even else [(2, 1, 0), (0, 0, 3), (1, 2, 1)]
    order = ">" if "big" in encoding else "<"
    content = b""
    for (x, y, z, i), (a, b, c) in zip(wanted, lengths, strict=True):
        if encoding == "ascii":
            words = [a, *[7] * a, x, y, z, b, *[1.5] * b, i, c, *[9] * c]
            content += (" ".join(map(str, words)) + "\n").encode()
        else:
            content += bytes([a]) + np.full(a, 7, order + "i4").tobytes() + np.array([x, y, z], order + "f4").tobytes()
            content += np.array(b, order + "u2").tobytes() + np.full(b, 1.5, order + "f8").tobytes()
            content += np.array(i, order + "f4").tobytes() + np.array(c, order + "u4").tobytes() + bytes([9] * c)
    others = {FACE: b"3 0 1 0 0.5\n4 1 0 1 0 0.5\n", CAMERA: b"35 3\n"} if encoding == "ascii" else body(order)
    parts = {**others, VIEWED: content}
    (tmp_path / "a.ply").write_bytes(ply(encoding, *elements) + b"".join(parts[one] for one in elements))
    found = read_points(tmp_path / "a.ply")
    assert found.columns == ("x", "y", "z", "intensity")
    assert found.points.tolist() == wanted
    write_points(tmp_path / "b.ply", found)
    assert read_points(tmp_path / "b.ply").points.tolist() == wanted
    assert b"list" not in (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize(
    ("encoding", "content", "message"),
    [
        ("ascii", b"1 7 1 2 3 0 0.5 0\n1 7 1 2 3 0 0.5\n0 1 2 3 0 0.5 0\n", "line 14: expected the length of the list"),
        ("ascii", b"1 7 1 2 3 0 0.5 0\n1 7 1 2 3 0 0.5 1\n0 1 2 3 0 0.5 0\n", "line 14: expected 9 numbers"),
        ("ascii", b"1 7 1 2 3 0 0.5 0\n-1 7 1 2 3 0 0.5 1\n0 1 2 3 0 0.5 0\n", "length of the list 'view'"),
        ("binary_little_endian", bytes(23) * 2 + bytes(22), "3 points of at least 23 bytes"),
        ("binary_little_endian", bytes([200]) + bytes(80), "ends within them"),
        ("binary_little_endian", bytes(13) + b"\xff\xff" + bytes(80), "ends within them"),
    ],
)
def test_a_vertex_with_broken_lists_is_refused(tmp_path: Path, encoding: str, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(encoding, VIEWED) + content)
    with pytest.raises(TorchweatherError, match=rf"a\.ply: .*({message})"):
        read_points(tmp_path / "a.ply")
