"""Put rain, fog and snow on a KITTI or nuScenes image, with the depth of its LiDAR cloud.

    python examples/kitti_in_weather.py --image 000008.png --points 000008.bin --calibration 000008.txt
    python examples/kitti_in_weather.py --image CAM_FRONT.jpg --points LIDAR_TOP.pcd.bin --calibration calib.json
    TORCHWEATHER_REAL_DATA=/data python examples/kitti_in_weather.py     # the frames found there
    python examples/kitti_in_weather.py                                  # no data: the embedded scene

The image is taken for plain sRGB, sampled as a Bayer camera would have, given the weather, and demosaiced again
(``AsBayer``). A calibration that ends in .json is nuScenes', any other KITTI's.

The airlight is a grey as bright as the image's sky: these are fair-weather images, and fog or a snow cloud under a blue
sky is not blue. ``--airlight`` sets another one. Where the LiDAR does not reach, what is sky is a guess
(``DepthFromPoints.above``): tall objects may lose their tops in fog, and the guess may show as upright blocks.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import torchweather as tw
from torchweather.datasets import (
    read_kitti_calibration,
    read_kitti_points,
    read_nuscenes_calibration,
    read_nuscenes_points,
)
from torchweather.image import DepthFromPoints, develop, normalise, srgb_decode
from torchweather.io import read_image, write_image
from torchweather.scenes import test_track

WEATHERS = {"rain": tw.Rain(rate_mm_per_h=50), "fog": tw.Fog(mor_m=60), "snow": tw.Snow(rate_mm_per_h=3)}


@dataclass(frozen=True)
class Frame:
    """An RGB image ``(3, H, W)``, its camera, and its depth ``(1, H, W)`` in metres."""

    name: str
    rgb: Tensor
    camera: tw.Camera
    depth_m: Tensor


def lidar_frame(image: Path, points: Path, calibration: Path) -> Frame:
    """An image whose depth comes from its LiDAR cloud."""
    rgb, _ = read_image(image)
    height, width = rgb.shape[-2:]
    if calibration.suffix == ".json":
        known, cloud = read_nuscenes_calibration(calibration), read_nuscenes_points(points)
    else:
        known, cloud = read_kitti_calibration(calibration), read_kitti_points(points)
    if known.assumption:
        print(f"{calibration.name}: assumed {known.assumption}")
    matrix = known.camera_matrix.tolist()
    camera = tw.Camera.from_intrinsics(matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2], width, height)
    depth_m = DepthFromPoints(cloud, known.T_camera_from_lidar)(camera, height, width)
    return Frame(image.stem, rgb, camera, depth_m)


def grey_of_the_sky(frame: Frame) -> float:
    """Mean linear light of the pixels at infinite depth, or of the brightest hundredth where there are none."""
    light = srgb_decode(normalise(frame.rgb)).mean(0)
    sky = torch.isinf(frame.depth_m[0])
    return float(light[sky].mean()) if bool(sky.any()) else float(light.flatten().quantile(0.99))


def embedded_frame(width: int) -> Frame:
    """The test track as an 8-bit sRGB image."""
    camera = tw.Camera.preset("lucid-triton").resized(width // 2 * 2, round(width * 0.378) * 2)
    view = test_track().view(camera)
    rgb = (develop(view.bayer, camera.bayer_pattern, exposure=1.4) * 255).round().to(torch.uint8)
    return Frame("test-track", rgb, camera, view.depth_m)


def found_frames(folder: Path) -> list[Frame]:
    """Frames below a folder: KITTI's image, cloud and calibration share a stem, nuScenes' a calibration in json."""
    frames = [
        lidar_frame(image, image.with_suffix(".bin"), image.with_suffix(".txt"))
        for image in sorted(folder.rglob("*.png"))
        if image.with_suffix(".bin").exists() and image.with_suffix(".txt").exists()
    ]
    for image in sorted(folder.rglob("*__CAM_FRONT__*.jpg")):
        log = image.name.partition("__")[0]
        points, calibration = sorted(image.parent.glob(f"{log}__LIDAR_TOP__*.bin")), image.parent / f"{log}_calib.json"
        if points and calibration.exists():
            frames.append(lidar_frame(image, points[0], calibration))
    return frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path)
    parser.add_argument("--points", type=Path)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--airlight", type=float, nargs=3, metavar=("RED", "GREEN", "BLUE"), help="linear, 0..1")
    parser.add_argument("--out", type=Path, default=Path("in_weather"), help="folder for the pictures")
    parser.add_argument("--width", type=int, default=968, help="of the embedded scene, pixels")
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()

    given = (arguments.image, arguments.points, arguments.calibration)
    if all(given):
        frames = [lidar_frame(*given)]
    elif any(given):
        parser.error("--image, --points and --calibration go together")
    else:
        folder = os.environ.get("TORCHWEATHER_REAL_DATA")
        frames = found_frames(Path(folder)) if folder else []
        if not frames:
            print("no image given and none found (TORCHWEATHER_REAL_DATA): taking the embedded scene")
            frames = [embedded_frame(arguments.width)]

    arguments.out.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        write_image(arguments.out / f"{frame.name}_clear.png", frame.rgb)
        light = arguments.airlight or grey_of_the_sky(frame)
        for name, weather in WEATHERS.items():
            transform = tw.AsBayer(tw.BayerWeather(weather, frame.camera, airlight=light))
            noise = transform.draw(frame.rgb, seed=arguments.seed)
            start = time.perf_counter()
            result = transform.run(frame.rgb, frame.depth_m, noise)
            seconds = time.perf_counter() - start
            picture = arguments.out / f"{frame.name}_{name}.png"
            write_image(picture, result.rgb)
            clear, covered = float(result.transmission.mean()), float(result.particle_mask.mean())
            airlight = ", ".join(f"{value:.2f}" for value in result.airlight.tolist())
            print(f"{picture}: {1e3 * seconds:.0f} ms, airlight {airlight}", end=", ")
            print(f"mean transmission of fog {clear:.2f}, covered by particles {covered:.3f}")


if __name__ == "__main__":
    main()
