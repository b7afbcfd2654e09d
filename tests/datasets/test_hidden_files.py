"""Names that begin with a dot are no data: macOS writes ``._name`` beside each file on other disks."""

from __future__ import annotations

from pathlib import Path

from torchweather.datasets.depth_clouds import calibration_file, cloud_file
from torchweather.datasets.speeds import read_speeds

MAC = b"\x00\x05\x16\x07Mac OS X"


def test_hidden_files_beside_calibrations_and_packets_are_no_data(tmp_path: Path) -> None:
    data = tmp_path / "drive/oxts/data"
    data.mkdir(parents=True)
    for number in range(2):
        (data / f"{number:010d}.txt").write_text(" ".join(["3"] * 30))
        (data / f"._{number:010d}.txt").write_bytes(MAC)
    (tmp_path / "drive/oxts/timestamps.txt").write_text("2011-09-26 13:02:25.0\n2011-09-26 13:02:25.1\n")
    assert len(read_speeds(tmp_path / "drive").speed_m_per_s) == 2
    calib = tmp_path / "calib"
    calib.mkdir()
    (calib / "one.txt").write_text("P2: 1")
    (calib / "._one.txt").write_bytes(MAC)
    assert calibration_file(calib, Path("000007.png")) == calib / "one.txt"
    log = "n015-2018-07-24-11-22-45+0800"
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    (clouds / f"._{log}__LIDAR_TOP__1532402927647951.pcd.bin").write_bytes(MAC)
    assert cloud_file(clouds, Path(f"{log}__CAM_FRONT__1532402927647951.jpg")) is None
