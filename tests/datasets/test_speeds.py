"""Speeds of a drive: raw KITTI data, tables, and which frame has which speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from torchweather.core.errors import TorchweatherError
from torchweather.datasets.speeds import Speeds, read_speeds, read_timestamps


def kitti_drive(folder: Path, speeds: list[float], step_s: float = 0.1) -> Path:
    """Raw KITTI data: 30 values a packet, each its own position, but the forward speed."""
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    stamps = []
    for number, speed in enumerate(speeds):
        values = [str(float(place)) for place in range(30)]
        values[8] = f"{speed:.12f}"
        (data / f"{number:010d}.txt").write_text(" ".join(values) + "\n")
        second, rest = divmod(59.75 + number * step_s, 60)
        stamps.append(f"2011-09-26 13:0{2 + int(second)}:{rest:012.9f}")
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    return folder


@pytest.mark.parametrize("place", ["", "oxts", "oxts/data"])
def test_raw_kitti_data_gives_the_forward_speed(tmp_path: Path, place: str) -> None:
    drive = kitti_drive(tmp_path / "drive", [10.0, 12.5, -0.02])
    speeds = read_speeds(drive / place)
    assert speeds.speed_m_per_s.tolist() == [10.0, 12.5, -0.02]
    assert speeds.time_s is not None
    assert speeds.time_s.tolist() == pytest.approx([0.0, 0.1, 0.2])  # across a full minute


def test_as_many_speeds_as_frames_belong_to_them_in_order(tmp_path: Path) -> None:
    speeds = read_speeds(kitti_drive(tmp_path, [10.0, 12.0, 14.0]))
    assert speeds.at_frames(3, 25.0).tolist() == [10.0, 12.0, 14.0]


def test_other_numbers_of_speeds_are_interpolated_in_time() -> None:
    # 10 m/s and 2 m/s^2 more every second, at 5 Hz, for frames at 10 Hz.
    time_s = np.arange(0, 2.01, 0.2)
    frames = Speeds(10.0 + 2.0 * time_s, time_s).at_frames(21, 10.0)
    assert frames.tolist() == pytest.approx((10.0 + 0.2 * np.arange(21)).tolist())


def test_speeds_that_end_before_the_frames_are_refused() -> None:
    speeds = Speeds(np.array([1.0, 2.0]), np.array([0.0, 1.0]))
    with pytest.raises(TorchweatherError, match=r"end at 1\.00 s, the 31 frames at 3\.00 s"):
        speeds.at_frames(31, 10.0)
    with pytest.raises(TorchweatherError, match="one speed for each of 3 frames; got 2"):
        Speeds(np.array([1.0, 2.0])).at_frames(3, 10.0)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("10\n11.5\n12\n", [10.0, 11.5, 12.0]),
        ("# m/s\n10 # start\n\n11\n", [10.0, 11.0]),
        ("speed_m_per_s\n10\n11\n", [10.0, 11.0]),
        ("time_s,speed_km_per_h\n5.0,36\n5.5,72\n", [10.0, 20.0]),
        ("speed_m_per_s;heading\n10;0.1\n11;0.2\n", [10.0, 11.0]),
    ],
)
def test_tables_are_read(tmp_path: Path, text: str, wanted: list[float]) -> None:
    file = tmp_path / "speeds.csv"
    file.write_text(text)
    speeds = read_speeds(file)
    assert speeds.speed_m_per_s.tolist() == pytest.approx(wanted)
    if "time_s" in text:
        assert speeds.time_s is not None
        assert speeds.time_s.tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "got none"),
        ("0.0 10.0\n0.1 11.0\n", "got 2 numbers in the first line"),  # which one is the speed?
        ("velocity\n10\n", "got the header velocity"),
        ("speed_m_per_s\nfast\n", "got 'fast'"),
        ("50\n130\n", "up to 100 m/s; got 130"),  # km/h
        ("1e999\n", "finite"),
        ("time_s,speed_m_per_s\n1,10\n1,11\n", "times must grow"),
        ("time_s,speed_m_per_s\n1,10\n2\n", "row 2 has 1 fields"),
    ],
)
def test_tables_that_say_something_else_are_refused(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "speeds.csv"
    file.write_text(text)
    with pytest.raises(TorchweatherError, match=complaint):
        read_speeds(file)


def test_broken_kitti_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="expected raw KITTI data"):
        read_speeds(tmp_path)
    drive = kitti_drive(tmp_path / "drive", [1.0, 2.0])
    (drive / "oxts" / "timestamps.txt").write_text("2011-09-26 13:02:25.964389445\n")
    with pytest.raises(TorchweatherError, match="a time for each of 2 packets; got 1"):
        read_speeds(drive)
    (drive / "oxts" / "data" / "0000000001.txt").write_text("1 2 3\n")
    with pytest.raises(TorchweatherError, match="expected 30 numbers of raw KITTI data; got 3"):
        read_speeds(drive)
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_speeds(tmp_path / "none.csv")
    (tmp_path / "stamps.txt").write_text("yesterday\n")
    with pytest.raises(TorchweatherError, match="expected dates"):
        read_timestamps(tmp_path / "stamps.txt")
