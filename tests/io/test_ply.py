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
        (b"plx\n", "wanted a PLY header"),
        (b"ply\nformat ascii 1.0\n", "wanted a PLY header"),
        (ply("ascii", FACE), "wanted an element vertex; got face"),
        (ply("morse", VERTEX), "wanted format ascii"),
        (ply("ascii", "element vertex two\n"), "element vertex two"),
        (ply("ascii", "property float x\n"), "IndexError"),
        (ply("ascii", VERTEX.replace("uchar", "quad")), "quad"),
        (ply("ascii", "banana\n"), "no such line in PLY"),
        (ply("ascii", VERTEX.replace("uchar intensity", "list uchar int i")), "single numbers"),
        (ply("ascii", VERTEX.replace("vertex 2", "vertex -2")), "negative"),
        (ply("binary_little_endian", VERTEX) + bytes(25), "wanted 2 points of at least 13 bytes"),
        (ply("binary_little_endian", VERTEX.replace("vertex 2", "vertex 9999999999")) + bytes(26), "9999999999 points"),
        (ply("ascii", VERTEX.replace("vertex 2", "vertex 9999999999")) + bytes(26), "9999999999 points"),
        (ply("binary_little_endian", CAMERA, VERTEX) + bytes(4), "wanted 1 rows of camera of at least 10 bytes"),
        (ply("binary_little_endian", FACE, VERTEX) + bytes(8), "wanted 2 rows of face of at least 5 bytes"),
        (ply("binary_little_endian", FACE.replace("2", "999999999999", 1), VERTEX) + bytes(8), "999999999999"),
        (ply("binary_little_endian", FACE, VERTEX) + bytes([255]) + bytes(20), "ends within them"),
        (ply("ascii", VERTEX) + b"1 2 3 4\n5 6 7 x\n", "x"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(TorchweatherError, match=rf"a\.ply: .*({message})"):
        read_points(tmp_path / "a.ply")
