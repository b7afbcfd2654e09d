"""See rain on a raw camera frame, with no data of your own.

    python examples/first_rain.py

Takes the embedded scene, lets it rain 50 mm/h, and writes both developed frames side by side.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

import torchweather as tw
from torchweather.image import develop
from torchweather.io import write_image
from torchweather.scenes import test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--out", type=Path, default=Path("first_rain.png"), help="picture to write")
parser.add_argument("--width", type=int, default=968, help="pixels; the height follows")
arguments = parser.parse_args()

width = arguments.width // 2 * 2
camera = tw.Camera.preset("lucid-triton").resized(width, round(width * 0.378) * 2)
view = test_track().view(camera)
rain = tw.BayerRain(tw.Rain(rate_mm_per_h=50), camera, far_m=80)
noise = rain.draw(view.bayer, seed=7)  # the same drops on every machine
result = rain.run(view.bayer, view.depth_m, noise)

pair = [develop(bayer, camera.bayer_pattern, exposure=1.3) for bayer in (view.bayer, result.bayer)]
write_image(arguments.out, (torch.cat(pair, -1) * 255).round().to(torch.uint8))
print(f"drops cover {100 * float(result.particle_mask.mean()):.1f} % of the exposure; picture: {arguments.out}")
