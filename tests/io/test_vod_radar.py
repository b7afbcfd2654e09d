"""View-of-Delft's radar files: seven columns, either speed, empty frames, byte for byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from torchweather import Radar, RadarAttenuation, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.io import read_radar, write_radar
from torchweather.physics import received_power_dbm

RADAR = Radar.preset("imaging-77ghz")
# x, y, z, RCS, v_r, v_r_compensated, time
ROWS = np.array([[10.0, 2.0, -0.5, 5.5, -3.25, 0.125, 0.0], [35.5, -4.0, 0.25, -12.0, -8.5, -0.5, -1.0]], dtype="<f4")


def file(path: Path, rows: np.ndarray = ROWS) -> Path:
    rows.astype("<f4").tofile(path)
    return path


def test_the_columns_are_those_of_a_detection(tmp_path: Path) -> None:
    found = read_radar(file(tmp_path / "a.bin"), RADAR)
    assert found.columns[3:] == ("speed_m_per_s", "power_dbm", "rcs_dbsm", "v_r_compensated", "time")
    assert found.points[:, 3].tolist() == [-3.25, -8.5]
    assert found.column("rcs_dbsm").tolist() == [5.5, -12.0]
    range_m = float(np.linalg.norm(ROWS[0, :3].astype(float)))
    power = received_power_dbm(5.5, range_m, transmit_power_dbm=12.0, antenna_gain_dbi=24.0)
    assert float(found.points[0, 4]) == pytest.approx(float(power), abs=1e-3)
    assert (found.power_source, found.speed_source) == ("radar equation", "relative")
    other = read_radar(tmp_path / "a.bin", RADAR, speed="compensated")
    assert other.points[:, 3].tolist() == [0.125, -0.5]
    assert other.speed_source == "compensated"


@pytest.mark.parametrize("speed", ["relative", "compensated"])
def test_an_unchanged_file_is_the_same_and_a_changed_speed_goes_where_it_came_from(tmp_path: Path, speed: str) -> None:
    found = read_radar(file(tmp_path / "a.bin"), RADAR, speed=speed)
    write_radar(tmp_path / "b.bin", found)
    assert (tmp_path / "b.bin").read_bytes() == (tmp_path / "a.bin").read_bytes()
    points = found.points.clone()
    points[0, 3] = 9.0
    write_radar(tmp_path / "b.bin", found.with_points(points))
    rows = np.fromfile(tmp_path / "b.bin", "<f4").reshape(-1, 7)
    changed = ROWS.copy()
    changed[0, 4 if speed == "relative" else 5] = 9.0
    assert np.array_equal(rows, changed)


def test_weather_drops_rows_and_may_leave_none(tmp_path: Path) -> None:
    found = read_radar(file(tmp_path / "a.bin"), RADAR)
    weak = Radar(**{**RADAR.to_dict(), "noise_floor_db": float(found.points[1, 4]) - 12.1})
    rain = RadarAttenuation(Rain(100.0), weak, lost="drop", radome_loss_db=1.0)
    out = rain(found.points, rain.draw(found.points, seed=1))
    assert isinstance(out, torch.Tensor)
    write_radar(tmp_path / "b.bin", found.with_points(out))
    assert np.array_equal(np.fromfile(tmp_path / "b.bin", "<f4").reshape(-1, 7), ROWS[:1])
    write_radar(tmp_path / "none.bin", found.with_points(found.points[:0]))
    assert (tmp_path / "none.bin").read_bytes() == b""
    assert read_radar(tmp_path / "none.bin", RADAR).points.shape == (0, 8)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "lidar.bin").write_bytes(bytes(16))
    with pytest.raises(TorchweatherError, match=r"seven float32 numbers .*28 bytes each; got 16 bytes"):
        read_radar(tmp_path / "lidar.bin", RADAR)
    file(tmp_path / "nan.bin", np.full((2, 7), np.nan))
    with pytest.raises(TorchweatherError, match="finite numbers"):
        read_radar(tmp_path / "nan.bin", RADAR)
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_radar(tmp_path / "no.bin", RADAR)
    with pytest.raises(TorchweatherError, match="missing x, y, z, rcs"):
        write_radar(tmp_path / "b.bin", torch.ones(1, 6))
