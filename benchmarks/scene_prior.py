"""Guessed depth of street photographs against LiDAR: error, levels of fog, horizon, own bonnet, time.

    TORCHWEATHER_REAL_DATA=... python benchmarks/scene_prior.py --out benchmarks/scene_prior.json

Needs ``kitti_13`` (pictures, clouds, calibration), ``sky_truth`` (masks by hand: 255 sky, 0 none, 128 left out) and,
for the bonnet, ``dashcam_highway``. Depth is compared at the pixels that a LiDAR return falls on, so no completion is
judged. Levels are the mean absolute sRGB difference of the picture in fog, rendered with the guess and with completed
LiDAR depth and the sky drawn by hand.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
from pathlib import Path

import torch
from measure import hand_over, machine, times_ms
from torch import Tensor

from torchweather.camera.depth import DepthFromPoints, DepthSource, FlatGround, project_points
from torchweather.camera.depth.horizon import find_horizon
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.camera.depth.scene_depth import SceneDepth
from torchweather.camera.depth.scene_prior import ScenePrior
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.io import read_image

CHOSEN_ON = ("000000", "000002", "000005", "000008", "000015", "000020", "001545")
HEIGHT_M = 1.65  # of KITTI's cameras over the road
AIRLIGHT = 0.6  # grey, linear
VISIBILITIES_M = (1000.0, 500.0, 200.0, 100.0, 50.0)
NEAREST_M = 1.5


class Frame:
    """A KITTI frame with what is known of it."""

    def __init__(self, root: Path, name: str) -> None:
        folder = root / "kitti_13"
        self.name = name
        self.rgb = read_image(folder / "image_2" / f"{name}.png")[0]
        self.height, self.width = self.rgb.shape[-2:]
        known = read_kitti_calibration(folder / "calib" / f"{name}.txt")
        self.camera = known.camera(self.width, self.height, height_m=HEIGHT_M)
        cloud, transform = read_kitti_points(folder / "velodyne" / f"{name}.bin"), known.T_camera_from_lidar
        self.points = (cloud[:, :3].double() @ transform[:3, :3].T + transform[:3, 3]).numpy()
        self.returns = DepthFromPoints(cloud, transform, fill="none")(self.camera, self.height, self.width)
        self.completed = DepthFromPoints(cloud, transform, above="nearest")(self.camera, self.height, self.width)
        mask = root / "sky_truth" / f"{name}.png"
        self.sky = read_image(mask)[0][:1] if mask.exists() else None
        assert int(project_points(cloud, transform, self.camera)[3].sum()) > 1000


def linear(srgb: Tensor) -> Tensor:
    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def encoded(light: Tensor) -> Tensor:
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light.clamp_min(1e-9) ** (1 / 2.4) - 0.055)


def in_fog(frame: Frame, depth_m: Tensor, sky: Tensor, visibility_m: float) -> Tensor:
    """The frame in fog, sRGB levels 0..255; the sky is hidden wholly."""
    stretch = frame.camera.ray_directions(frame.height, frame.width).square().sum(0).sqrt()
    transmission = torch.exp(-3.0 / visibility_m * depth_m.clamp(max=1e6) * stretch) * (1.0 - sky)
    light = linear(frame.rgb.float() / 255.0)
    return 255.0 * encoded(light * transmission + AIRLIGHT * (1.0 - transmission))


def depth_scores(frame: Frame, scene: SceneDepth) -> dict[str, float]:
    there = torch.isfinite(frame.returns) & (frame.returns > NEAREST_M)
    guessed, true = scene.depth_m[there].clamp(max=1e4), frame.returns[there]
    ratio = torch.maximum(guessed / true, true / guessed)
    return {
        "median_relative_error": round(float(((guessed - true).abs() / true).median()), 4),
        "within_1.25": round(float((ratio < 1.25).double().mean()), 4),
        "within_2": round(float((ratio < 2.0).double().mean()), 4),
    }


def fog_levels(frame: Frame, scene: SceneDepth) -> dict[str, float]:
    """Levels at each visibility; empty where no sky was drawn by hand."""
    if frame.sky is None:
        return {}
    true_sky, used = (frame.sky == 255).float(), frame.sky != 128
    result = {}
    for visibility_m in VISIBILITIES_M:
        guess = in_fog(frame, scene.depth_m, scene.sky_share, visibility_m)
        truth = in_fog(frame, frame.completed, true_sky, visibility_m)
        result[f"levels_{visibility_m:g}_m"] = round(float((guess - truth).abs().mean(0, keepdim=True)[used].mean()), 3)
    return result


def road_horizon_row(frame: Frame) -> float:
    """Horizon at the principal point's column of the plane through the road's returns, by least trimmed squares."""
    points = torch.from_numpy(frame.points)
    x, y, z = points.unbind(-1)
    road = points[(x.abs() < 5.0) & (z > 4.0) & (z < 22.0) & ((y - HEIGHT_M).abs() < 0.5)]
    generator = torch.Generator().manual_seed(0)
    best, agreed = -1, road[:, 0] > -math.inf
    for _ in range(400):
        a, b, c = road[torch.randint(len(road), (3,), generator=generator)]
        normal = torch.linalg.cross(b - a, c - a)
        if float(normal.norm()) < 1e-3:
            continue
        normal = normal / normal.norm() * normal[1].sign()
        near = (road @ normal - normal @ a).abs() < 0.04
        if float(normal[1]) > 0.98 and int(near.sum()) > best:
            best, agreed = int(near.sum()), near
    plane = torch.linalg.lstsq(road[agreed], torch.ones(int(agreed.sum()), 1, dtype=torch.float64)).solution[:, 0]
    _, fy, _, cy = frame.camera.intrinsics
    return float(cy - fy * plane[2] / plane[1])


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: round(statistics.mean(row[name] for row in rows if name in row), 4) for name in names}


def bonnets(root: Path) -> dict[str, object]:
    """Frames in which a bonnet is found, of those with and without one."""
    with_one = [p for p in sorted((root / "dashcam_highway").glob("*.jpg")) if not p.name.startswith("p1_")]
    without = [*sorted((root / "dashcam_highway").glob("p1_*.jpg")), *sorted((root / "kitti_13/image_2").glob("*.png"))]
    without += sorted((root / "kitti_nuscenes_demo/nuscenes").glob("*.jpg"))
    without += sorted((root / "roadcam_fog/frames").glob("*/*.jpg"))[::8]
    found = [sum(bool(find_near_mask(read_image(p)[0]).any()) for p in paths) for paths in (with_one, without)]
    return {"with_bonnet": len(with_one), "found": found[0], "without": len(without), "false_alarms": found[1]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    root = Path(os.environ["TORCHWEATHER_REAL_DATA"])

    boxes: dict[str, list[list[float]]] = {}
    listed = json.loads((root / "kitti_13/annotations.json").read_text(encoding="utf-8"))
    names = {entry["id"]: Path(entry["file_name"]).stem for entry in listed["images"]}
    for entry in listed["annotations"]:
        x, y, w, h = entry["bbox"]
        if not entry.get("iscrowd"):
            boxes.setdefault(names[entry["image_id"]], []).append([x, y, x + w, y + h])

    frames = [Frame(root, path.stem) for path in sorted((root / "kitti_13/image_2").glob("*.png"))]
    ways: dict[str, dict[str, dict[str, float]]] = {"flat_ground": {}, "scene_prior": {}, "scene_prior_and_boxes": {}}
    horizon: dict[str, dict[str, float]] = {}
    for frame in frames:
        sources: dict[str, DepthSource] = {
            "flat_ground": FlatGround(),
            "scene_prior": ScenePrior(),
            "scene_prior_and_boxes": ScenePrior(boxes=torch.tensor(boxes[frame.name]) if frame.name in boxes else None),
        }
        for way, source in sources.items():
            scene = source.scene(frame.camera, frame.height, frame.width, image=frame.rgb)
            ways[way][frame.name] = {**depth_scores(frame, scene), **fog_levels(frame, scene)}
        true_row, found = road_horizon_row(frame), find_horizon(frame.rgb, frame.camera)
        horizon[frame.name] = {
            "off_px": round(abs(found.row - true_row), 2),
            "principal_point_off_px": round(abs(frame.camera.principal_point_px[1] - true_row), 2),
            "confidence": round(found.confidence, 3),
        }

    others = [frame.name for frame in frames if frame.name not in CHOSEN_ON]
    groups = {"chosen_on": CHOSEN_ON, "others": others, "all": [frame.name for frame in frames]}
    frame = next(f for f in frames if (f.width, f.height) == (1242, 375))
    camera, rgb = frame.camera, frame.rgb
    no_sky = torch.zeros(1, frame.height, frame.width)
    result = {
        "what": "ScenePrior without any measurement against the LiDAR of kitti_13",
        "machine": machine(),
        "groups": {name: list(members) for name, members in groups.items()},
        "depth": {
            way: {group: means([rows[name] for name in members]) for group, members in groups.items()}
            for way, rows in ways.items()
        },
        "horizon": {group: means([horizon[name] for name in members]) for group, members in groups.items()},
        "bonnet": bonnets(root),
        "times_1242_x_375": {
            "horizon": times_ms(lambda: find_horizon(rgb, camera), arguments.repeats),
            "near_mask": times_ms(lambda: find_near_mask(rgb), arguments.repeats),
            "scene_without_sky_mask": times_ms(
                lambda: ScenePrior(sky=no_sky).scene(camera, frame.height, frame.width, image=rgb), arguments.repeats
            ),
        },
        "frames": ways,
        "horizon_of_frames": horizon,
    }
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
