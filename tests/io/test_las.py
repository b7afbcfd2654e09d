"""LAS and LAZ: numbers and header back as they came, and what the format cannot hold."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
import torch

from torchweather.cli import main
from torchweather.core.errors import MissingExtraError, TorchweatherError
from torchweather.io import read_points, write_points

ROWS = 200


def survey(path: Path, *, offset: float = 0.0, point_format: int = 3) -> laspy.LasData:
    """A cloud about (offset, offset, 0), with a time, a colour and a dimension of its own."""
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales, header.offsets = np.array([0.001, 0.001, 0.001]), np.array([offset, offset, 0.0])
    header.add_extra_dim(laspy.ExtraBytesParams("ring", np.uint8))
    header.system_identifier = "made by hand"
    las = laspy.LasData(header)
    rng = np.random.default_rng(1)
    las.x, las.y = offset + rng.uniform(-40, 40, ROWS), offset + rng.uniform(-40, 40, ROWS)
    las.z = rng.uniform(-2, 3, ROWS)
    las.intensity, las.ring = rng.integers(1, 255, ROWS), np.arange(ROWS) % 16
    las.gps_time = 1.5e9 + np.arange(ROWS) / 1024
    las.classification = np.full(ROWS, 2)
    las.write(str(path))
    return las


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize("point_format", [3, 6])
def test_a_survey_comes_back_with_its_header(tmp_path: Path, name: str, point_format: int) -> None:
    before = survey(tmp_path / name, offset=500_000.0, point_format=point_format)
    found = read_points(tmp_path / name)
    assert found.columns[:4] == ("x", "y", "z", "intensity")
    assert found.points.dtype == torch.float64
    assert np.array_equal(found.column("x").numpy(), np.asarray(before.x))
    assert np.array_equal(found.column("ring").numpy(), np.asarray(before.ring))
    write_points(tmp_path / f"b_{name}", found)
    again = laspy.read(tmp_path / f"b_{name}")
    assert again.header.system_identifier == "made by hand"
    assert again.header.point_format == before.header.point_format
    assert again.points.array.tobytes() == laspy.read(tmp_path / name).points.array.tobytes()
    # Points that are left out leave the others as they are.
    write_points(tmp_path / f"c_{name}", found.with_points(found.points[::2]))
    fewer = laspy.read(tmp_path / f"c_{name}")
    assert fewer.header.point_count == ROWS // 2
    assert np.array_equal(np.asarray(fewer.X), np.asarray(before.X)[::2])


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
def test_a_cloud_of_another_format_is_written_in_millimetres(tmp_path: Path, name: str) -> None:
    points = torch.tensor([[10.0, -2.0, -1.5, 12.0, 3.0], [20.5, 7.25, 0.0, 255.0, 4.0]])
    write_points(tmp_path / name, points)
    found = read_points(tmp_path / name)
    assert found.points[:, :4].tolist() == points[:, :4].tolist()
    assert found.column("ring").tolist() == [3, 4]
    with pytest.raises(TorchweatherError, match=r"field 'intensity' is uint16.*cannot hold 0\.5"):
        write_points(tmp_path / name, points * torch.tensor([1.0, 1, 1, 1 / 24, 1]))
    with pytest.raises(TorchweatherError, match=r"x must lie within 2\^31 steps of 0\.001 m"):
        write_points(tmp_path / name, torch.tensor([[5e6, 0.0, 0.0, 1.0], [-5e6, 0.0, 0.0, 1.0]]))


def test_a_lost_point_in_the_origin_of_a_map_is_refused_with_the_remedy(tmp_path: Path) -> None:
    survey(tmp_path / "a.las", offset=5_000_000.0)
    found = read_points(tmp_path / "a.las")
    lost = found.points.clone()
    lost[3, :3] = 0.0
    with pytest.raises(TorchweatherError, match="--lost drop"):
        write_points(tmp_path / "b.las", found.with_points(lost))


def test_weather_marks_its_particles_as_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    survey(tmp_path / "a.las", offset=500_000.0)
    asked = ["apply", str(tmp_path / "a.las"), "--sensor", "lidar:velodyne-hdl-64e", "--intensity-unit", "uint8_linear"]
    asked += ["--weather", "fog:mor=30", "-o", str(tmp_path / "out")]
    assert main(asked) == 2
    assert "--sensor-origin" in capsys.readouterr().err
    assert main([*asked, "--sensor-origin", "500000", "500000", "0"]) == 0
    out = laspy.read(tmp_path / "out" / "a.las")
    near = np.hypot(np.asarray(out.x) - 5e5, np.asarray(out.y) - 5e5)
    assert near.max() < 60
    assert set(np.asarray(out.classification).tolist()) == {2, 7}  # ground, and noise of the standard


@pytest.mark.parametrize("content", [b"", b"LASF", b"LASF" + bytes(300), b"no cloud" * 50])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.las").write_bytes(content)
    with pytest.raises(TorchweatherError, match=r"a\.las: cannot be read as LAS"):
        read_points(tmp_path / "a.las")
    with pytest.raises(TorchweatherError, match="no such file"):
        read_points(tmp_path / "none.las")


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    for name in ("a.las", "a.laz"):
        survey(tmp_path / name)
        whole = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(TorchweatherError, match=f"{name}: cannot be read as LAS"):
            read_points(tmp_path / name)


def test_without_laspy_the_hint_works_from_a_clone_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.las").write_bytes(b"LASF")
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'laspy\[lazrs\]>=2\.5'"):
        read_points(tmp_path / "a.las")
    with pytest.raises(MissingExtraError, match="laspy"):
        write_points(tmp_path / "b.las", torch.zeros(1, 4))


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize(
    ("place", "form", "value"),
    [
        (100, "<I", 1 << 30),  # records before the points
        (243, "<I", 1 << 30),  # records behind them: laspy reads on for hours
        (247, "<Q", 1 << 60),  # points
    ],
)
def test_a_header_that_promises_more_than_the_file_holds_is_refused_at_once(
    tmp_path: Path, name: str, place: int, form: str, value: int
) -> None:
    survey(tmp_path / name, point_format=6)
    content = bytearray((tmp_path / name).read_bytes())
    content[place : place + struct.calcsize(form)] = struct.pack(form, value)
    (tmp_path / name).write_bytes(bytes(content))
    with pytest.raises(TorchweatherError, match=r"its header promises|would inflate"):
        read_points(tmp_path / name)


@pytest.mark.parametrize("place", [0, 4])
def test_a_damaged_table_of_chunks_is_refused(tmp_path: Path, place: int) -> None:
    """Lazrs ends the whole process where it cannot have the memory for a table of 2 billion chunks."""
    survey(tmp_path / "a.laz", point_format=6)
    content = bytearray((tmp_path / "a.laz").read_bytes())
    (start,) = struct.unpack_from("<I", content, 96)
    (table,) = struct.unpack_from("<q", content, start)
    at, value = (start, struct.pack("<q", 1 << 40)) if place == 0 else (table + 4, struct.pack("<I", 1 << 31))
    content[at : at + len(value)] = value
    (tmp_path / "a.laz").write_bytes(bytes(content))
    with pytest.raises(TorchweatherError, match="its header promises"):
        read_points(tmp_path / "a.laz")


def test_a_scale_that_makes_no_finite_positions_is_refused(tmp_path: Path) -> None:
    survey(tmp_path / "a.las", point_format=6)
    content = bytearray((tmp_path / "a.las").read_bytes())
    content[131:139] = struct.pack("<d", 1e308)
    (tmp_path / "a.las").write_bytes(bytes(content))
    with pytest.raises(TorchweatherError, match="scale or offset makes no finite positions"):
        read_points(tmp_path / "a.las")
