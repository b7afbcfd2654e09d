"""Make a short film of a drive through snow, in which the flakes really move.

    python examples/drive_in_snow.py --out drive_in_snow.gif --frames 24 --speed 8
    python examples/drive_in_snow.py --out frames/ --frames 8       # one PNG a frame

Flakes keep their identity from frame to frame: they fall, drift with the wind and come towards the driving car. The
scene itself stands still: it is one frame of the embedded test track.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

import torchweather as tw
from torchweather.image import develop
from torchweather.io import atomic_write
from torchweather.scenes import test_track


def picture(bayer: Tensor, pattern: str) -> Image.Image:
    rgb = develop(bayer, pattern, exposure=1.3)
    return Image.fromarray((rgb * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous().numpy())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("drive_in_snow.gif"), help="a .gif, or a folder for PNGs")
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--frame-rate", type=float, default=20.0, help="frames per second")
    parser.add_argument("--rate", type=float, default=2.0, help="snowfall, mm/h of melted water")
    parser.add_argument("--speed", type=float, default=8.0, help="of the car, m/s")
    parser.add_argument("--wind", type=float, default=1.5, help="from the right, m/s")
    parser.add_argument("--width", type=int, default=484, help="pixels")
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()

    width = arguments.width // 2 * 2
    camera = tw.Camera.preset("lucid-triton").resized(width, round(width * 0.378) * 2)
    view = test_track().view(camera)
    weather = tw.Snow(rate_mm_per_h=arguments.rate, wind_m_per_s=(0.0, arguments.wind, 0.0))
    snow = tw.BayerSnow(weather, camera, far_m=30.0, ego_speed_m_per_s=arguments.speed)

    interval_s = 1.0 / arguments.frame_rate
    start = time.perf_counter()
    film = [
        picture(snow(view.bayer, view.depth_m, noise), camera.bayer_pattern)
        for noise in snow.draw_sequence(view.bayer, arguments.frames, interval_s, seed=arguments.seed)
    ]
    seconds = time.perf_counter() - start
    if arguments.out.suffix.lower() == ".gif":
        with atomic_write(arguments.out) as unfinished:
            milliseconds = round(1000 * interval_s)
            film[0].save(unfinished, format="GIF", save_all=True, append_images=film[1:], duration=milliseconds, loop=0)
    else:
        arguments.out.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(film):
            with atomic_write(arguments.out / f"{number:04d}.png") as unfinished:
                frame.save(unfinished, format="PNG")
    print(f"{len(film)} frames of {camera.width} x {camera.height} px, {1e3 * seconds / len(film):.0f} ms each")
    print(f"film: {arguments.out}")


if __name__ == "__main__":
    main()
