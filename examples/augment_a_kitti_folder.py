"""Put a data set in KITTI's layout into weather with ``torchweather augment``, and look into its manifest.

    python examples/augment_a_kitti_folder.py
    python examples/augment_a_kitti_folder.py --data KITTI/object --recipe my.yaml     # a data set of one's own

Without data a small one is made of the embedded scene: images, clouds, calibrations and boxes of a few frames below
``training``. The command puts each frame, camera and LiDAR together, into a weather of its own, drawn from the recipe.
The table shows what was drawn, and how many points the weather left on the boxes. A second call of the same command
finds that all is done.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

import torchweather as tw
from torchweather.cli import main
from torchweather.datasets import Boxes, write_kitti_boxes
from torchweather.datasets.augment import Manifest
from torchweather.image import develop
from torchweather.io import write_image, write_points
from torchweather.scenes import lidar_view, test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--data", type=Path, help="root of a data set in KITTI's layout; default: one is made")
parser.add_argument("--recipe", default="multi_sensor/kitti-training-mix")
parser.add_argument("--out", type=Path, default=Path("kitti_in_weather"), help="folder of the result")
parser.add_argument("--frames", type=int, default=6, help="of the made data set")
parser.add_argument("--width", type=int, default=620, help="of its images, pixels")
parser.add_argument("--columns", type=int, default=600, help="of its scans: firings of each ring in a turn")
parser.add_argument("--workers", type=int, default=2)
parser.add_argument("--seed", type=int, default=7)
arguments = parser.parse_args()


def made(root: Path) -> Path:
    """The embedded scene in KITTI's layout; the frames differ by the noise of their sensors."""
    height = round(arguments.width * 375 / 1242 / 2) * 2  # a mosaic has whole cells of 2 x 2
    focal_px = 721.54 * arguments.width / 1242
    camera = tw.Camera.from_intrinsics(
        focal_px, focal_px, (arguments.width - 1) / 2, (height - 1) / 2, arguments.width, height, height_m=1.65
    )
    lidar = tw.Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity", columns=arguments.columns)
    scene = test_track()
    # Into the camera (x right, y down, z ahead) from the Velodyne (x ahead, y left, z up), 8 cm above it.
    velo_to_cam = torch.tensor([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, -0.08], [1.0, 0.0, 0.0, 0.0]])
    calibration = {
        "P2": [focal_px, 0, (arguments.width - 1) / 2, 0, 0, focal_px, (height - 1) / 2, 0, 0, 0, 1, 0],
        "R0_rect": [1, 0, 0, 0, 1, 0, 0, 0, 1],
        "Tr_velo_to_cam": velo_to_cam.flatten().tolist(),
    }
    rectified_from_lidar = torch.cat([velo_to_cam, torch.tensor([[0.0, 0.0, 0.0, 1.0]])]).double()
    training = root / "training"
    for folder in ("image_2", "velodyne", "calib", "label_2"):
        (training / folder).mkdir(parents=True, exist_ok=True)
    for number in range(arguments.frames):
        name = f"{number:06d}"
        image = scene.view(camera, shot_noise_seed=number)
        rgb = (develop(image.bayer, camera.bayer_pattern, exposure=1.4) * 255).round().to(torch.uint8)
        cloud = lidar_view(scene, lidar, range_noise_seed=number)
        owners = [scene.objects[k] for k in cloud.box_object_id.tolist()]
        names = tuple(owner.label.name.capitalize() for owner in owners)
        boxes = Boxes(cloud.boxes[:, :3], cloud.boxes[:, 3:6], cloud.boxes[:, 6], names)
        write_image(training / "image_2" / f"{name}.png", rgb)
        points = cloud.points[cloud.hit, :4]
        points[:, 3].clamp_(max=1.0)  # KITTI's reflectance ends at 1, also of a retroreflector
        write_points(training / "velodyne" / f"{name}.bin", points)
        write_kitti_boxes(training / "label_2" / f"{name}.txt", boxes, rectified_from_lidar)
        text = "".join(f"{key}: {' '.join(f'{one:.6e}' for one in values)}\n" for key, values in calibration.items())
        (training / "calib" / f"{name}.txt").write_text(text, encoding="utf-8")
    return root


def in_words(weather: object) -> str:
    """A weather as the manifest has it, in a few words."""
    if not isinstance(weather, dict):
        return "clear air"
    if weather["kind"] == "mixture":
        return " and ".join(in_words(part) for part in weather["parts"])
    number = f"{weather['mor_m']:.0f} m" if weather["kind"] == "fog" else f"{weather['rate_mm_per_h']:.1f} mm/h"
    return f"{weather['kind']} {number}"


if __name__ == "__main__":  # the workers import this file
    source = arguments.data or made(arguments.out.with_name(f"{arguments.out.name}_clear"))
    command = ["augment", str(source), str(arguments.out), "--recipe", arguments.recipe, "--layout", "kitti"]
    command += ["--workers", str(arguments.workers), "--seed", str(arguments.seed)]
    code = main(command)
    print(f"exit code {code}\n")
    with Manifest(arguments.out) as manifest:
        for row in manifest.rows():
            if row.kind == "weather":
                boxes = row.boxes or []
                left = ", ".join(f"{box['name']} {box['points_left']}/{box['points_before']}" for box in boxes)
                print(f"{row.frame}  {row.status}  {in_words(row.weather):28}  points on boxes: {left or 'all'}")
    print("\nthe same command again:")
    main(command)
    raise SystemExit(code)
