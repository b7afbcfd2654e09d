"""Draw a street at night in clear air, fog, rain and snow: the embedded scene with lamps of its own and of others.

python docs/_figures/night.py
python docs/_figures/night.py --out pictures/night.jpg --width 480
"""

from __future__ import annotations

import argparse
import math
import warnings
from pathlib import Path

import torch
from PIL import Image, ImageDraw

import torchweather as tw
from torchweather.camera.tone import srgb_encode
from torchweather.io import atomic_write
from torchweather.scenes import test_track
from torchweather.scenes.night_view import night_view

RED, WARM = (2.6, 0.3, 0.1), (1.2, 1.0, 0.8)
HEADLAMPS = tuple(tw.Lamp((45.0, left, 0.7), 300.0, heading_rad=math.pi) for left in (2.2, 3.6))
TAIL_LAMPS = tuple(tw.Lamp((22.0, left, 0.8), 12.0, colour=RED) for left in (-0.7, 0.6))
STREET_LAMPS = tuple(tw.Lamp((forward, 6.0, 7.0), 2000.0, colour=WARM) for forward in (30.0, 60.0, 90.0))
NIGHT = tw.Night(lamps=(*HEADLAMPS, *TAIL_LAMPS, *STREET_LAMPS))
WEATHERS = {
    "clear": None,
    "fog, 200 m": tw.Fog(200.0),
    "fog, 50 m": tw.Fog(50.0),
    "rain, 25 mm/h": tw.Rain(25.0),
    "snow, 2 mm/h": tw.Snow(2.0),
    "rain, 10 mm/h, in fog, 150 m": tw.Mixture(tw.Rain(10.0), tw.Fog(150.0)),
}
SEED = 7


def pictures(width: int) -> dict[str, torch.Tensor]:
    """The street in each weather, sRGB, ``(3, H, W)``."""
    camera = tw.Camera.preset("lucid-triton").resized(width, width * 9 // 16 // 2 * 2)
    scene = test_track()
    clear = night_view(scene, scene.view(camera), NIGHT)
    found = {}
    for name, weather in WEATHERS.items():
        found[name] = srgb_encode(clear.rgb)
        if weather is not None:
            in_weather = tw.AsBayer(tw.BayerWeather(weather, camera, night=NIGHT, scattering="multiple"))
            found[name] = in_weather(found[name], clear.depth_m, seed=SEED)
    return found


def sheet(shown: dict[str, torch.Tensor]) -> Image.Image:
    """Pictures in two columns, each with its name."""
    _, height, width = next(iter(shown.values())).shape
    whole = Image.new("RGB", (2 * width, math.ceil(len(shown) / 2) * height))
    draw = ImageDraw.Draw(whole)
    for number, (name, picture) in enumerate(shown.items()):
        values = (picture.clamp(0, 1) * 255).round().to(torch.uint8).movedim(0, -1).numpy()
        corner = ((number % 2) * width, (number // 2) * height)
        whole.paste(Image.fromarray(values), corner)
        draw.text((corner[0] + 12, corner[1] + 10), name, fill=(235, 235, 235), font_size=max(14, width // 36))
    return whole


def main() -> None:
    """Write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "images" / "night.jpg")
    parser.add_argument("--width", type=int, default=720, help="of each picture, px")
    arguments = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=UserWarning)  # the sky of the scene at night is dark
        drawn = sheet(pictures(arguments.width))
    with atomic_write(arguments.out) as unfinished:
        drawn.save(unfinished, format="JPEG", quality=85, optimize=True)
    print(f"{arguments.out}: {drawn.width} x {drawn.height} px")


if __name__ == "__main__":
    main()
