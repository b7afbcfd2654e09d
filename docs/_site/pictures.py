"""Pictures of the gallery for pages of the site: the table of all, and a picture with its slider."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

__all__ = ["picture_of_class", "pictures_of_recipe", "read_table", "slider"]

PICTURES = "images/gallery"
# Pictures of classes that are no effects; an effect's class has the name of its picture.
OF_CLASS = {
    "BayerRain": "camera-rain-5",
    "BayerFog": "camera-fog-3",
    "BayerSnow": "camera-snow-3",
    "BayerWeather": "camera-rain-of-60-mm-h-in-mist-of-400-m",
    "LidarRain": "lidar-rain-5",
    "LidarFog": "lidar-fog-4",
    "LidarSnow": "lidar-snow-3",
    "LidarWeather": "lidar-rain-of-10-mm-h-in-fog-of-200-m",
    "RadarAttenuation": "radar-rain-5",
    "WetRoad": "camera-rain-of-20-mm-h-wet-road",
    "WetWindow": "camera-rain-of-20-mm-h-wet-window",
    "RoadSpray": "camera-rain-of-20-mm-h-spray-of-a-car-ahead",
    "SnowCover": "camera-snow-of-1-mm-h-lying-snow",
}
# Recipes of one sensor that have the weather and the sensor of multi_sensor/NAME.
PARTS = ("camera/", "lidar/os1-", "radar/imaging-")
WORD = re.compile(r"[A-Z][a-z]*")


def read_table(docs: Path) -> dict[str, Any]:
    """Table that ``docs/_figures/gallery.py`` writes."""
    table: dict[str, Any] = json.loads((docs / PICTURES / "gallery.json").read_text(encoding="utf-8"))
    return table


def picture_of_class(name: str, table: dict[str, Any]) -> dict[str, Any] | None:
    """Entry of the gallery that shows a class, where one does: ``CameraDefocus`` is ``camera.defocus``."""
    first, *rest = [word.lower() for word in WORD.findall(name)] or [""]
    wanted = OF_CLASS.get(name, f"{first}.{'_'.join(rest)}")
    return next((entry for entry in table["entries"] if entry["name"] == wanted), None)


def pictures_of_recipe(name: str, table: dict[str, Any]) -> list[dict[str, Any]]:
    """Entries that show a recipe: ``camera/fog-10m`` is ``recipe-camera-fog-10m``; one of several sensors has each."""
    folder, _, rest = name.partition("/")
    parts = [f"{before}{rest}" for before in PARTS] if folder == "multi_sensor" else [name]
    wanted = [f"recipe-{part.replace('/', '-')}" for part in parts]
    return [entry for entry in table["entries"] if entry["name"] in wanted]


def slider(entry: dict[str, Any], up: str) -> str:
    """The picture over the one that it is compared with, and a slider between both.

    Args:
        entry: of the table.
        up: from the page's address to the site's root, such as ``../../``.
    """
    width, height = entry["size"]
    title = html.escape(entry["title"])
    size = f'width="{width}" height="{height}" loading="lazy"'
    after, before = (f"{up}{PICTURES}/{entry[key]}.webp" for key in ("name", "before"))
    return (
        f'<div class="before-after" style="aspect-ratio: {width} / {height}">'
        f'<img src="{after}" alt="{title}" {size}>'
        f'<img class="before" src="{before}" alt="the same without" {size}>'
        f'<input type="range" min="0" max="100" value="50" aria-label="{title}: share of the picture without it">'
        "</div>"
    )
