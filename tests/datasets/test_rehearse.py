"""REHEARSE-3D's published layout, on folders written here byte by byte."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
import torch

import torchweather as tw
from torchweather.core.errors import TorchweatherError
from torchweather.datasets import REHEARSE_FOLDERS, RehearseSequence, read_rehearse
from torchweather.gap import study_from_folders
from torchweather.io import write_image

POINTS = [(28.0, 0.5, -1.0, 12.0), (54.5, -9.25, 0.0, 254.0)]
RADAR = "X,Y,Z,Intensity,Cross Section,Velocity,Confidence\n28.0,0.1,0.2,41.5,9.0,-0.25,0.9\n"


def cloud(rows: list[tuple[float, ...]]) -> bytes:
    """Little-endian float32 rows, as the authors' .bin files."""
    return b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows)


def write_sequence(folder: Path, points: list[tuple[float, ...]] = POINTS, frames: int = 1) -> None:
    """One sequence with every folder that is published."""
    for name in REHEARSE_FOLDERS:
        (folder / name).mkdir(parents=True)
    for k in range(frames):
        for name in ("ouster", "innoviz", "lidar_radar_pcd"):
            (folder / name / f"{k:06d}.bin").write_bytes(cloud(points))
        (folder / "lidar_radar_labels" / f"{k:06d}.label").write_bytes(struct.pack("<2I", 7, (3 << 16) | 40))
        (folder / "ext_radar" / f"{k:06d}.csv").write_text(RADAR, encoding="utf-8")
        write_image(folder / "arena" / f"{k:06d}.jpeg", torch.full((3, 8, 16), 90 + k, dtype=torch.uint8))
    (folder / "ouster" / "metadata.csv").write_text("frame,timestamp\n000000,1.5\n", encoding="utf-8")
    (folder / "ouster" / "._000000.bin").write_bytes(b"thumbnail")
    (folder / "weather" / "000000.csv").write_text("dew_point,wind_speed\n8.5,1.25\n", encoding="utf-8")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name in ("001", "000"):
        write_sequence(tmp_path / "sequences" / name)
    return tmp_path


def test_sequences_are_found_from_every_level(root: Path) -> None:
    for start in (root, root / "sequences"):
        assert [one.folder.name for one in read_rehearse(start)] == ["000", "001"]
    [alone] = read_rehearse(root / "sequences" / "001")
    assert alone.folder.name == "001"
    # Empty folders are left out; the hidden file and the table are no frames.
    assert {name: len(files) for name, files in alone.frames.items()} == {
        name: 1 for name in REHEARSE_FOLDERS if name not in ("flir", "radar_pcd")
    }


def test_each_sensor_is_read_as_its_files_say(root: Path) -> None:
    one = read_rehearse(root)[0]
    for folder in ("ouster", "innoviz", "lidar_radar_pcd"):
        assert one.points(0, folder).tolist() == [list(row) for row in POINTS]
    assert one.labels(0).classes.tolist() == [7, 40]
    assert one.labels(0).instances.tolist() == [0, 3]
    assert one.image(0).shape == (3, 8, 16)
    assert one.weather(0) == {"dew_point": 8.5, "wind_speed": 1.25}
    assert one.metadata("ouster") == {"frame": ["000000"], "timestamp": [1.5]}


def test_radar_columns_are_found_by_word_or_by_name(root: Path) -> None:
    one = read_rehearse(root)[0]
    wanted = [28.0, 0.1, 0.2, -0.25, 41.5, 9.0]
    assert one.radar(0).points.tolist() == [pytest.approx(wanted)]
    assert one.radar(0).columns[3:] == ("speed_m_per_s", "power_db", "rcs_dbsm")
    file = one.frames["ext_radar"][0]
    file.write_text(RADAR.replace("Velocity", "vr"), encoding="utf-8")
    with pytest.raises(TorchweatherError, match=r"velocity or speed.*got X, Y, Z, Intensity, Cross Section, vr"):
        one.radar(0)
    assert one.radar(0, {"speed_m_per_s": "vr"}).points.tolist() == [pytest.approx(wanted)]
    with pytest.raises(TorchweatherError, match="no column 'vrr'"):
        one.radar(0, {"speed_m_per_s": "vrr"})


def test_what_is_not_there_is_named(root: Path, tmp_path: Path) -> None:
    one = read_rehearse(root)[0]
    with pytest.raises(TorchweatherError, match="no frames in flir; there are arena, ouster"):
        one.image(0, "flir")
    with pytest.raises(TorchweatherError, match="index"):
        one.points(1)
    with pytest.raises(TorchweatherError, match="folder"):
        one.points(0, "velodyne")
    with pytest.raises(TorchweatherError, match=r"metadata\.csv: no such file"):
        one.metadata("arena")
    one.frames["ouster"][0].write_bytes(cloud(POINTS) + b"\0\0\0\0")
    with pytest.raises(TorchweatherError, match=r"16 bytes each.*got 36"):
        one.points(0)
    with pytest.raises(TorchweatherError, match="no such folder"):
        read_rehearse(tmp_path / "elsewhere")
    (tmp_path / "other" / "velodyne").mkdir(parents=True)
    with pytest.raises(TorchweatherError, match="such as ouster, arena and ext_radar; got velodyne"):
        read_rehearse(tmp_path / "other")


def test_a_study_of_sequences_has_their_names(tmp_path: Path) -> None:
    lidar = tw.Lidar(905.0, elevations_deg=(-2.0, 0.0), columns=90)
    for name, count in (("000", 2), ("001", 1), ("002", 1)):
        write_sequence(tmp_path / name, frames=count)
    clear, light, heavy = (one.folder / "ouster" for one in read_rehearse(tmp_path))
    study = study_from_folders(clear, {light: "rain:rate=10", heavy: "rain:rate=50"}, lidar)
    assert [one.id for one in study.conditions] == ["001-ouster", "002-ouster"]
    assert isinstance(read_rehearse(tmp_path)[0], RehearseSequence)
