"""Readers of points: clouds of LiDARs, detections and maps of radars, labels, poses of sensors."""

# ruff: noqa: E501
from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tests.fuzz.reader import Reader, given, saved
from torchweather import io
from torchweather.datasets import read_kitti_points, read_nuscenes_points
from torchweather.radar.power_map import MapAxes, PowerScale, RadarPowerMap
from torchweather.sensors import Lidar, Radar

__all__ = ["READERS"]

LIDAR = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
RADAR = Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0)
NAMES = ("x", "y", "z", "intensity", "ring")


def cloud(columns: int = 4, rows: int = 24, seed: int = 0) -> Tensor:
    """Points at 2 to 50 m; the last one has no return."""
    random = torch.Generator().manual_seed(seed)
    points = torch.randn(rows, columns, generator=random)
    points[:, :3] *= (2 + 48 * torch.rand(rows, 1, generator=random)) / points[:, :3].norm(dim=1, keepdim=True)
    points[:, 3] = torch.rand(rows, generator=random)
    points[:, 4:] = torch.arange(rows)[:, None] % 16
    points[-1, :3] = 0.0
    return points


def detections(rows: int = 12) -> Tensor:
    """Radar detections at 5 to 80 m."""
    points = cloud(6, rows)
    points[:, 3], points[:, 4], points[:, 5] = 3.0 * points[:, 3], -90.0 - torch.arange(rows), 10.0
    return points[:-1]


def _clouds(suffix: str, encodings: Sequence[str | None], columns: int = 5) -> Callable[[Path], list[bytes]]:
    def make(folder: Path) -> list[bytes]:
        return [
            saved(folder, f"a{suffix}", lambda path, one=one: io.write_points(path, cloud(columns), encoding=one))
            for one in encodings
        ]

    return make


def _xyz(found: Any) -> Any:
    """Positions are finite; other columns are those of the file."""
    return found.points[:, :3]


def _points(path: Path) -> Any:
    return _xyz(io.read_points(path))


def _sensor_points(path: Path) -> Any:
    return _xyz(io.read_sensor_points(path, LIDAR))


def _through(path: Path) -> Any:
    """Read and written again: a cloud that is read can be written."""
    found = io.read_points(path)
    io.write_points(path.with_name(f"again{''.join(path.suffixes)}"), found)
    return _xyz(found)


ORGANISED = b"""VERSION .7
FIELDS x y z _ intensity reflectivity ring empty
SIZE 4 4 4 1 4 2 1 8
TYPE F F F U F U U F
COUNT 1 1 1 2 1 1 1 0
WIDTH 3
HEIGHT 2
VIEWPOINT 1 2 0 0.7071 0 0 0.7071
POINTS 6
DATA ascii
"""
ORGANISED += b"".join(b"%d.5 -2 1 0 0 0.25 %d 3\n" % (10 + k, 40 * k) for k in range(5)) + b"nan nan nan 0 0 0 0 3\n"
WITH_LIST = b"""ply
format ascii 1.0
comment made by hand
element vertex 3
property float x
property list uchar int seen
property double y
property float z
property uchar intensity
element face 1
property list uchar int vertex_indices
end_header
1 2 4 5 2.5 3 10
4 0 5 6 20
7 1 9 8.25 9 30
3 0 1 2
"""
CSV = b"x,y,z,intensity,ring\n1.5,2,-0.25,10,0\n4,5.125,6,20,1\n-7,8,1e1,0,2\n"
BARE_CSV = b"1.5,2,-0.25,10,0\n4,5.125,6,20,1\n-7,8,1e1,0,2\n"
NUSCENES = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms vy_rms
SIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1
TYPE F F F I I F F F F F I I I I I I I I
COUNT 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1
WIDTH 4
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 4
DATA binary
"""


def _nuscenes_radar(_: Path) -> list[bytes]:
    rows = b"".join(
        np.array([10.0 + k, k, 0.0], "<f4").tobytes()
        + bytes([1, k, 0])
        + np.array([5.0, -3.0, 0.5, -1.0, 0.0], "<f4").tobytes()
        + bytes([1, 3, 19, 19, 0, 1, 16, 3])
        for k in range(4)
    )
    return [NUSCENES.encode() + rows + b"\n"]


def _radar(path: Path) -> Any:
    return io.read_radar(path, RADAR).points[:, :6]


def _npz_columns(folder: Path) -> list[bytes]:
    each = dict(zip(NAMES, cloud(5).numpy().T, strict=True))
    return [
        saved(folder, "a.npz", lambda path: np.savez(path, **each)),
        saved(folder, "b.npz", lambda path: np.savez_compressed(path, points=cloud(5), columns=np.array(NAMES))),
        saved(folder, "c.npz", lambda path: np.savez(path, points=cloud(4).reshape(4, 6, 4))),
    ]


def _radar_files(form: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [saved(folder, f"a.{form}", lambda path: io.write_radar(path, detections(), format=form))]


def _vod(folder: Path) -> list[bytes]:
    return [np.column_stack([detections().numpy(), np.zeros(11)]).astype("<f4").tobytes()]


def _maps(folder: Path) -> list[bytes]:
    level = torch.arange(8 * 12).reshape(8, 12).to(torch.uint8)
    axes = MapAxes.of_turn(bins=12, bin_m=0.5, azimuths=8)
    one = RadarPowerMap(level, axes, PowerScale.steps(0.5))
    two = RadarPowerMap(level.float() / 10.0, axes, PowerScale("db"))
    return [
        saved(folder, f"{number}.npz", lambda path, power=power: io.write_power_map(path, power))
        for number, power in enumerate((one, two))
    ]


def _map(path: Path) -> Any:
    found = io.read_power_map(path)
    return found.axes if found.values.is_floating_point() else (found.axes, found.decibels)


def _turning_picture(folder: Path) -> list[bytes]:
    level = torch.randint(0, 256, (16, 24), dtype=torch.uint8, generator=torch.Generator().manual_seed(1))
    header = np.zeros((16, 11), np.uint8)
    header[:, :8] = (1_547_131_046_353_776 + 625 * np.arange(16)).astype("<i8")[:, None].view(np.uint8)
    header[:, 8:10] = (350 * np.arange(16)).astype("<u2")[:, None].view(np.uint8)
    header[:, 10] = 255
    oxford = torch.from_numpy(np.concatenate([header, level.numpy()], 1))
    return [
        saved(folder, f"{k}.png", lambda path, one=one: io.write_image(path, one[None]))
        for k, one in enumerate((oxford, level))
    ]


def _adc(folder: Path) -> list[bytes]:
    cube = torch.ones(2, 4, 8, dtype=torch.complex64)
    words = np.full((2, 4, 8), 65535, np.uint16)
    return [
        saved(folder, "a.npz", lambda path: io.write_adc(path, cube)),
        saved(folder, "b.npz", lambda path: np.savez(path, i=words, q=words)),
    ]


def _labels(n: int = 24) -> Callable[[Path], list[bytes]]:
    given = io.PointLabels(torch.arange(n) % 20, torch.arange(n) * 3)
    return lambda folder: [saved(folder, "a.label", lambda path: io.write_labels(path, given))]


def _panoptic(folder: Path) -> list[bytes]:
    return [saved(folder, "a.npz", lambda path: np.savez_compressed(path, data=np.arange(24, dtype=np.uint16) * 1000))]


def _las(folder: Path) -> list[bytes]:
    return [saved(folder, "a.las", lambda path: io.write_points(path, cloud(5).mul(100).round()))]


def _laz(folder: Path) -> list[bytes]:
    return [saved(folder, "a.laz", lambda path: io.write_points(path, cloud(5).mul(100).round()))]


def _pose_texts(_: Path) -> list[bytes]:
    return [
        b"T_cloud_from_sensor:\n- [1, 0, 0, 0.5]\n- [0, 1, 0, -1]\n- [0, 0, 1, 1.8]\n- [0, 0, 0, 1]\n",
        b"translation: [0.5, 0, 1.8]\nrotation: [0.7071, 0, 0, 0.7071]\n",
        b"[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]",
    ]


def _pose_rows(_: Path) -> list[bytes]:
    return [b"Tr: 1 0 0 0.5 0 1 0 -1 0 0 1 1.8\n", b"1 0 0 0\n0 0 -1 0\n0 1 0 0\n0 0 0 1\n"]


READERS = (
    Reader("points-bin", "a.bin", _clouds(".bin", [None], 4), _through),
    Reader(
        "points-bin-stated",
        "a.bin",
        _clouds(".bin", [None], 4),
        lambda path: _xyz(io.read_points(path, bin_columns="x,y,z,intensity")),
    ),
    Reader("points-bin-kitti", "a.bin", _clouds(".bin", [None], 4), lambda path: read_kitti_points(path)[:, :3]),
    Reader("points-pcd-bin", "a.pcd.bin", _clouds(".pcd.bin", [None]), _through),
    Reader("points-nuscenes", "a.pcd.bin", _clouds(".pcd.bin", [None]), lambda path: read_nuscenes_points(path)[:, :3]),
    Reader("points-pcd", "a.pcd", _clouds(".pcd", ("ascii", "binary", "binary_compressed")), _through),
    Reader("points-pcd-sensor", "a.pcd", _clouds(".pcd", ("ascii", "binary", "binary_compressed")), _sensor_points),
    Reader("points-pcd-organised", "a.pcd", given(ORGANISED), _through),
    Reader("points-ply", "a.ply", _clouds(".ply", io.PLY_ENCODINGS), _through),
    Reader("points-ply-lists", "a.ply", given(WITH_LIST), _through),
    Reader("points-npz", "a.npz", _npz_columns, _through),
    Reader("points-csv", "a.csv", given(CSV, BARE_CSV), _through),
    Reader("points-las", "a.las", _las, _through),
    # Lazrs reserves what a chunk says of its layers, up to 36 GB, before it reads; it does not touch it.
    Reader("points-laz", "a.laz", _laz, _points, memory_bytes=80 << 30),
    Reader("radar-pcd", "a.pcd", lambda folder: _nuscenes_radar(folder) + _radar_files("pcd")(folder), _radar),
    Reader("radar-npz", "a.npz", _radar_files("npz"), _radar),
    Reader("radar-csv", "a.csv", _radar_files("csv"), _radar),
    Reader("radar-vod", "a.bin", _vod, _radar),
    Reader("radar-map-npz", "a.npz", _maps, _map),
    Reader(
        "radar-map-png",
        "a.png",
        lambda folder: _turning_picture(folder)[:1],
        lambda path: io.read_power_map(path, "oxford").axes,
    ),
    Reader(
        "radar-map-radiate",
        "a.png",
        lambda folder: _turning_picture(folder)[1:],
        lambda path: io.read_power_map(path, "radiate").axes,
    ),
    Reader("radar-adc", "a.npz", _adc, lambda path: io.read_adc(path).cube),
    Reader("labels-semantickitti", "a.label", _labels(), lambda path: io.read_labels(path, 24)),
    Reader("labels-lidarseg", "a_lidarseg.bin", given(bytes(range(24))), lambda path: io.read_labels(path, 24)),
    Reader("labels-panoptic", "a_panoptic.npz", _panoptic, lambda path: io.read_labels(path)),
    Reader("pose-yaml", "a.yaml", _pose_texts, io.read_sensor_pose),
    Reader("pose-json", "a.json", lambda folder: _pose_texts(folder)[2:], io.read_sensor_pose),
    Reader("pose-txt", "a.txt", _pose_rows, io.read_sensor_pose),
    Reader(
        "pose-npy",
        "a.npy",
        lambda folder: [saved(folder, "a.npy", lambda path: np.save(path, np.eye(4)))],
        io.read_sensor_pose,
    ),
)
