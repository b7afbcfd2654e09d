"""Draw wet road, wet window, spray and lying snow on a photograph.

    python docs/_figures/water_and_snow_photograph.py --out docs/images/water_and_snow_photograph.jpg

Beside the photograph lies a .json of its name with what the picture does not tell (readme_street.py). The depth is
guessed, the boxes of the cars are given.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from PIL import Image
from readme_street import GAP, PHOTOGRAPH, as_picture, labelled, street, weathered

import torchweather as tw

SEED, COLUMNS, WIDTH = 3, 2, 796
SCENES: dict[str, tw.Mixture | None] = {
    "clear": None,
    "WetRoad(water_mm=0.4, puddles=0.6)": tw.Mixture(tw.WetRoad(water_mm=0.4, puddles=0.6)),
    "Rain(25), WetWindow(speed 20 m/s, wiper 4 s ago)": tw.Mixture(
        tw.Rain(25.0), tw.WetWindow(speed_m_per_s=20.0, wiper_s=4.0)
    ),
    "WetRoad, RoadSpray of a lorry 20 m ahead": tw.Mixture(
        tw.WetRoad(water_mm=0.2),
        tw.RoadSpray(speed_m_per_s=25.0, distance_m=20.0, lateral_m=-1.0, tyre_m=0.8, height_m=1.5),
    ),
    "SnowCover(depth_mm=3)": tw.Mixture(tw.SnowCover(depth_mm=3.0)),
    "Snow(1), SnowCover(depth_mm=30)": tw.Mixture(tw.Snow(1.0), tw.SnowCover(depth_mm=30.0)),
}


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photograph", type=Path, default=PHOTOGRAPH, help="with a .json of its name beside it")
    parser.add_argument("--out", type=Path, default=Path("water_and_snow_photograph.jpg"))
    arguments = parser.parse_args()
    settings = json.loads(arguments.photograph.with_suffix(".json").read_text(encoding="utf-8"))
    image, camera, scene = street(arguments.photograph, settings, settings["panel"], WIDTH)
    rows, columns = image.shape[-2:]
    lines = -(-len(SCENES) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * columns + GAP, lines * (rows + GAP) - GAP), "white")
    for number, (title, weather) in enumerate(SCENES.items()):
        seen = image
        if weather is not None:
            transform = weathered(weather, camera)
            seen = transform(image, scene, transform.draw(image, seed=SEED))
        place = (number % COLUMNS * (columns + GAP), number // COLUMNS * (rows + GAP))
        sheet.paste(labelled(as_picture(seen), title), place)
    sheet.save(arguments.out, quality=80, optimize=True)
    print(arguments.out)


if __name__ == "__main__":
    main()
