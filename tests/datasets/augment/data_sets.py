"""Small data sets in each layout, and the content of a folder of results."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import torch
from torch import Tensor

from torchweather.io import PointLabels, write_image, write_labels, write_points

MANIFEST = "torchweather-manifest.sqlite"
# Of a small camera and a LiDAR of intensity 0 to 1; a rate for each frame.
BOTH = """
format: torchweather-recipe/2
kind: multi_sensor
title: rain of a rate for each frame
weather: {kind: rain, rate_mm_per_h: {log_uniform: [5.0, 100.0]}}
transforms:
  image:
    transform: BayerWeather
    sensor: {kind: camera, width: 40, height: 24, fx: 40.0, fy: 40.0, height_m: 1.65}
    options: {}
    rgb: true
  points:
    transform: LidarWeather
    sensor: {kind: lidar, preset: velodyne-hdl-64e, intensity_unit: reflectivity}
    options: {}
p: 1.0
depth: depth
"""
FOG = """
format: torchweather-recipe/2
kind: transform
title: fog that takes far points away
transform: LidarFog
weather: {kind: fog, mor_m: 100.0}
sensor: {kind: lidar, preset: velodyne-hdl-64e, intensity_unit: reflectivity}
"""
CALIBRATION = """P2: 40 0 19.5 0 0 40 11.5 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0
"""
# A car 20 m ahead, one that nothing hits, and a region that nobody labelled.
BOXES = """Car 0.00 0 -1.57 10 10 20 20 1.60 1.80 4.00 0.00 1.00 20.00 -1.57
Car 0.00 0 -1.57 10 10 20 20 1.60 1.80 4.00 90.00 1.00 20.00 -1.57
DontCare -1 -1 -10 5 5 9 9 -1 -1 -1 -1000 -1000 -1000 -10
"""


def recipe(folder: Path, text: str = BOTH) -> str:
    """The path of a recipe's file."""
    file = folder / f"recipe-{hashlib.sha256(text.encode()).hexdigest()[:8]}.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def image(number: int) -> Tensor:
    return torch.randint(0, 200, (3, 24, 40), dtype=torch.uint8, generator=torch.Generator().manual_seed(number))


def cloud(number: int, rows: int = 300) -> Tensor:
    """Points ahead, 50 of them on a car at 20 m; of number 0, one more is there by chance."""
    random = torch.Generator().manual_seed(number)
    way = torch.randn(rows, 3, generator=random) * torch.tensor([0.1, 0.3, 0.1]) + torch.tensor([1.0, 0.0, 0.0])
    points = way / way.norm(dim=-1, keepdim=True) * (5 + 55 * torch.rand(rows, 1, generator=random))
    points[:50] = torch.tensor([20.0, 0.0, -0.2]) + 0.5 * (torch.rand(50, 3, generator=random) - 0.5)
    return torch.cat([points, 0.05 + 0.5 * torch.rand(rows, 1, generator=random)], -1)


def folder(root: Path, frames: int = 3) -> Path:
    """Images, clouds with labels, and a text."""
    for name in ("day/images", "day/clouds"):
        (root / name).mkdir(parents=True, exist_ok=True)
    for number in range(frames):
        write_image(root / f"day/images/{number:03d}.png", image(number))
        write_points(root / f"day/clouds/{number:03d}.bin", cloud(number))
        classes = torch.full((300,), 40)
        write_labels(root / f"day/clouds/{number:03d}.label", PointLabels(classes, torch.zeros_like(classes)))
    (root / "notes.txt").write_text("as it is", encoding="utf-8")
    return root


def kitti(root: Path, frames: int = 2) -> Path:
    """KITTI's object data."""
    for name in ("image_2", "velodyne", "calib", "label_2"):
        (root / "training" / name).mkdir(parents=True, exist_ok=True)
    for number in range(frames):
        name = f"{number:06d}"
        write_image(root / f"training/image_2/{name}.png", image(number))
        write_points(root / f"training/velodyne/{name}.bin", cloud(number))
        (root / f"training/calib/{name}.txt").write_text(CALIBRATION, encoding="utf-8")
        (root / f"training/label_2/{name}.txt").write_text(BOXES, encoding="utf-8")
    return root


def nuscenes(root: Path) -> Path:
    """One sample of a camera and the roof LiDAR, a sweep, and the tables; the car has turned by a right angle."""
    turned, straight = [0.5**0.5, 0.0, 0.0, 0.5**0.5], [1.0, 0.0, 0.0, 0.0]
    ahead = [0.5, -0.5, 0.5, -0.5]  # camera: x right, y down, z ahead, in a frame with x ahead and y left
    names = {
        "samples/CAM_FRONT/a.png": ("camera", True),
        "samples/LIDAR_TOP/a.pcd.bin": ("lidar", True),
        "sweeps/LIDAR_TOP/b.pcd.bin": ("lidar", False),
    }
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
    write_image(root / "samples/CAM_FRONT/a.png", image(0))
    for number, name in enumerate(list(names)[1:]):
        rings = torch.zeros(300, 1)
        write_points(root / name, torch.cat([cloud(number), rings], -1))
    tables = {
        "sample_data": [
            {
                "token": name,
                "sample_token": "s",
                "filename": name,
                "is_key_frame": key,
                "ego_pose_token": "p",
                "calibrated_sensor_token": sensor,
            }
            for name, (sensor, key) in names.items()
        ],
        "calibrated_sensor": [
            {
                "token": "camera",
                "translation": [0, 0, 0],
                "rotation": ahead,
                "camera_intrinsic": [[40, 0, 19.5], [0, 40, 11.5], [0, 0, 1]],
            },
            {"token": "lidar", "translation": [0, 0, 0], "rotation": straight, "camera_intrinsic": []},
        ],
        "ego_pose": [{"token": "p", "translation": [100, 200, 0], "rotation": turned}],
        # 20 m ahead of a car that looks along the world's y.
        "sample_annotation": [
            {
                "token": "car",
                "sample_token": "s",
                "translation": [100, 220, -0.2],
                "size": [1.8, 4.0, 1.6],
                "rotation": turned,
                "num_lidar_pts": 51,
            }
        ],
    }
    (root / "v1.0-mini").mkdir()
    for name, rows in tables.items():
        (root / f"v1.0-mini/{name}.json").write_text(json.dumps(rows), encoding="utf-8")
    return root


def tree(root: Path) -> dict[str, str]:
    """SHA-256 of every file by its path, without the manifest, which holds times."""
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != MANIFEST
    }
