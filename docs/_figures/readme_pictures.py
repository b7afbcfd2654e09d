"""Make the pictures of the README: a photograph in weather, a film of snow, a point cloud in snow.

python docs/_figures/readme_pictures.py
python docs/_figures/readme_pictures.py --out pictures --photograph docs/images/photographs/downtown_street.jpg
python docs/_figures/readme_pictures.py --original mmod_cars_test_image2.jpg    # the photograph itself, first
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from PIL import Image
from readme_cloud import cloud
from readme_street import FILM_RATE_HZ, IMAGES, PHOTOGRAPH, before_after, film, reduced

from torchweather.io import atomic_write


def main() -> None:
    """Write the three pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photograph", type=Path, default=PHOTOGRAPH, help="with a .json of its name beside it")
    parser.add_argument("--original", type=Path, help="make the photograph from this file first")
    parser.add_argument("--columns", type=int, default=2048, help="of the LiDAR's scan")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder for the pictures")
    arguments = parser.parse_args()

    settings = json.loads(arguments.photograph.with_suffix(".json").read_text(encoding="utf-8"))
    if arguments.original is not None:
        with atomic_write(arguments.photograph) as unfinished:
            reduced(arguments.original, settings).save(unfinished, format="JPEG", quality=90, optimize=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    frames = film(arguments.photograph, settings)
    moving: dict[str, Any] = {"save_all": True, "append_images": frames[1:], "duration": round(1000 / FILM_RATE_HZ)}
    pictures: dict[str, tuple[Image.Image, dict[str, Any]]] = {
        "readme_before_after.jpg": (
            before_after(arguments.photograph, settings),
            {"format": "JPEG", "quality": 82, "optimize": True},
        ),
        "readme_snow.webp": (frames[0], {"format": "WEBP", "quality": 60, "method": 6, "loop": 0, **moving}),
        "readme_cloud.png": (cloud(arguments.columns), {"format": "PNG", "optimize": True}),
    }
    for name, (picture, how) in pictures.items():
        path = arguments.out / name
        with atomic_write(path) as unfinished:
            picture.save(unfinished, **how)
        print(f"{path}: {picture.width} x {picture.height} px, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
