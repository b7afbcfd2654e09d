"""Draw the picture of docs/how-to/water-and-snow-on-things.md, with no data of your own.

    python docs/_figures/water_and_snow.py --out water_and_snow.jpg

The embedded test track, seen by a Lucid Triton of few pixels, in clear air and under five conditions.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

import torchweather as tw
from torchweather.image import demosaic
from torchweather.scenes import test_track

WIDTH, HEIGHT, COLUMNS = 480, 300, 2
GAMMA = 2.2
SCENES: dict[str, tw.Mixture | None] = {
    "clear": None,
    "WetRoad(water_mm=1, puddles=0.8)": tw.Mixture(tw.WetRoad(water_mm=1.0, puddles=0.8)),
    "Rain(25), WetWindow(speed 20 m/s, wiper 4 s ago)": tw.Mixture(
        tw.Rain(25.0), tw.WetWindow(speed_m_per_s=20.0, wiper_s=4.0)
    ),
    "WetRoad, RoadSpray of a lorry 20 m ahead": tw.Mixture(
        tw.WetRoad(water_mm=2.0),
        tw.RoadSpray(speed_m_per_s=25.0, distance_m=20.0, lateral_m=-1.0, tyre_m=0.8, height_m=1.5),
    ),
    "SnowCover(depth_mm=3)": tw.Mixture(tw.SnowCover(depth_mm=3.0)),
    "Snow(1), SnowCover(depth_mm=30)": tw.Mixture(tw.Snow(1.0), tw.SnowCover(depth_mm=30.0)),
}


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("water_and_snow.jpg"))
    arguments = parser.parse_args()
    camera = tw.Camera.preset("lucid-triton").resized(2 * WIDTH, 3 * WIDTH // 2)
    view = test_track().view(camera)
    rows = -(-len(SCENES) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * WIDTH, rows * HEIGHT))
    for number, (title, weather) in enumerate(SCENES.items()):
        frame = view.bayer
        if weather is not None:
            frame = tw.BayerWeather(weather, camera)(frame, view.depth_m, normal=view.normal, seed=3)
        picture = labelled(frame, camera, title)
        sheet.paste(picture, (number % COLUMNS * WIDTH, number // COLUMNS * HEIGHT))
    sheet.save(arguments.out, quality=82)
    print(arguments.out)


def labelled(frame: torch.Tensor, camera: tw.Camera, title: str) -> Image.Image:
    """A raw frame as a small picture with its title."""
    colour = demosaic(frame.float(), camera.bayer_pattern)[:, : 4 * HEIGHT].clamp(0.0, 1.0) ** (1.0 / GAMMA)
    values = (255.0 * colour).byte().permute(1, 2, 0).numpy()
    cut = values[-2 * HEIGHT :]
    picture = Image.fromarray(np.ascontiguousarray(cut)).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(picture)
    box = draw.textbbox((8, 8), title)
    draw.rectangle((box[0] - 4, box[1] - 3, box[2] + 4, box[3] + 3), fill=(0, 0, 0))
    draw.text((8, 8), title, fill=(255, 255, 255))
    return picture


if __name__ == "__main__":
    main()
