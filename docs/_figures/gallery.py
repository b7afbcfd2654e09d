"""Draw the gallery: ``python docs/_figures/gallery.py [NAME ...]``.

Every entry of ``gallery_entries.py`` becomes ``docs/images/gallery/NAME.webp``, and ``gallery.json`` beside them holds
titles and lines for the site. A picture whose lines are those of ``gallery.json`` is not drawn again; names draw these
pictures in any case, and ``--all`` draws all.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from gallery_entries import CLEAR, SETUP, Entry, entries
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from readme_cloud import FLAKE, LOST, NIGHT, OBJECT, seen_by_eye

import torchweather as tw
from torchweather.image import develop
from torchweather.io import atomic_write
from torchweather.radar.power_map import noise_floor_db
from torchweather.report.map_picture import from_above

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "images" / "gallery"
TABLE = FOLDER / "gallery.json"
QUALITY = 72
CLOUD_PX, PLOT_PX, DPI = (480, 220), (480, 220), 100
MAP_PX, MAP_DB = 480, (-5.0, 50.0)
RADAR_LIMITS = {"xlabel": "range in m", "ylabel": "power in dBm"}


def main() -> None:
    """Draw what is missing or was changed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures to draw")
    parser.add_argument("--all", action="store_true", help="draw every picture")
    arguments = parser.parse_args()
    os.chdir(ROOT)
    FOLDER.mkdir(parents=True, exist_ok=True)
    listed = list(entries())
    drawn = {entry["name"]: entry for entry in json.loads(TABLE.read_text())["entries"]} if TABLE.exists() else {}
    for entry in listed:
        path = FOLDER / f"{entry.name}.webp"
        fresh = path.exists() and drawn.get(entry.name, {}).get("code") == entry.code
        if arguments.all or entry.name in arguments.names or not fresh:
            with atomic_write(path) as unfinished:
                picture_of(entry).save(unfinished, format="WEBP", method=6, **compression(entry.sensor))
            print(path.relative_to(ROOT), path.stat().st_size)
    for path in set(FOLDER.glob("*.webp")) - {FOLDER / f"{entry.name}.webp" for entry in listed}:
        path.unlink()
    table = {"setup": SETUP, "entries": [{**asdict(entry), "size": size_of(entry)} for entry in listed]}
    with atomic_write(TABLE) as unfinished:
        unfinished.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def size_of(entry: Entry) -> tuple[int, int]:
    """Width and height of an entry's picture."""
    with Image.open(FOLDER / f"{entry.name}.webp") as picture:
        return picture.size


def compression(sensor: str) -> dict[str, Any]:
    """How a picture is stored: photographs with losses, drawings without."""
    return {"quality": QUALITY} if sensor == "camera" else {"lossless": True}


@lru_cache
def setup(sensor: str) -> dict[str, Any]:
    """Names that the setup of a sensor defines."""
    names: dict[str, Any] = {}
    exec(compile(SETUP[sensor], f"setup of {sensor}", "exec"), names)
    return names


def picture_of(entry: Entry) -> Image.Image:
    """Run the lines of an entry and draw what they leave."""
    names = dict(setup(entry.sensor))
    exec(compile(entry.code, entry.name, "exec"), names)
    clear = entry.name.endswith(CLEAR)
    if entry.sensor == "camera":
        if clear and "view" in names:  # of a preset
            return as_picture(develop(names["view"].bayer, names["camera"].bayer_pattern))
        return as_picture(names["image" if clear else "picture"])
    if entry.sensor == "lidar":
        return cloud(names["view"], None if clear else names["result"])
    if "wet" in names:
        return power_map(names["clear" if clear else "wet"])
    return powers(names["points"], None if clear else names["result"])


def as_picture(image: torch.Tensor) -> Image.Image:
    """A picture of ``(3, H, W)``, uint8 or float in 0..1."""
    if image.is_floating_point():
        image = (255.0 * image.clamp(0.0, 1.0)).round().to(torch.uint8)
    return Image.fromarray(image.permute(1, 2, 0).contiguous().numpy())


def cloud(view: Any, result: Any) -> Image.Image:
    """A cloud from behind the sensor, coloured by what each point is."""
    parts: list[tuple[torch.Tensor, str, float]] = []
    if result is None:
        parts.append((view.points[view.hit], OBJECT, 1.8))
    else:
        kind = result.kind
        many = kind.ndim > 1  # several returns of a beam
        lost = view.hit & ((kind == tw.PointKind.LOST).all(-1) if many else kind == tw.PointKind.LOST)
        parts.append((result.points[kind == tw.PointKind.OBJECT], OBJECT, 1.8))
        parts.append((view.points[lost], LOST, 4.0))
        parts.append((result.points[kind == tw.PointKind.PARTICLE], FLAKE, 2.4))
    width, height = CLOUD_PX
    figure, axes = canvas(CLOUD_PX, NIGHT, (0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set(xlim=(-0.5, 0.5), ylim=(-0.55 * height / width, 0.45 * height / width))
    for points, colour, size in parts:
        x, y, distance_m = seen_by_eye(points)
        axes.scatter(x, y, s=size * np.clip(14.0 / distance_m, 0.4, 1.5), c=colour, linewidths=0)
    return pixels(figure).quantize(12, dither=Image.Dither.NONE).convert("RGB")


def powers(points: torch.Tensor, result: Any) -> Image.Image:
    """Power of the detections against range."""
    figure, axes = canvas(PLOT_PX, "white", (0.15, 0.22, 0.83, 0.75))
    range_m = torch.linalg.vector_norm(points[:, :3], dim=1)
    axes.scatter(range_m, points[:, 4], s=22, c="#c3ccd4", linewidths=0, label="clear air")
    if result is not None:
        lost = result.kind == tw.PointKind.LOST
        found_m = torch.linalg.vector_norm(result.points[:, :3], dim=1)
        kept = result.kind == tw.PointKind.OBJECT
        other = result.kind == tw.PointKind.PARTICLE
        axes.scatter(found_m[kept], result.points[kept, 4], s=9, c="#1864ab", linewidths=0, label="in weather")
        if other.any():
            axes.scatter(found_m[other], result.points[other, 4], s=9, c=FLAKE, linewidths=0, label="of the weather")
        gone = lost[: len(range_m)]  # what the weather adds comes after the targets
        axes.scatter(range_m[gone], points[gone, 4], s=22, c="#c92a2a", marker="x", label="lost")
    axes.set(**RADAR_LIMITS, xlim=(0, 80), ylim=(-140, -80))
    axes.legend(loc="upper right", fontsize=8, frameon=False)
    return pixels(figure).quantize(48, dither=Image.Dither.NONE).convert("RGB")


def power_map(shown: Any) -> Image.Image:
    """A power map from above, forward up: dB over the noise, of the middle of the map."""
    grid = from_above(shown, MAP_PX) - noise_floor_db(shown)
    height = PLOT_PX[1]
    strip = grid[(MAP_PX - height) // 2 :][:height].clamp(*MAP_DB).nan_to_num(MAP_DB[0])
    share = (strip - MAP_DB[0]) / (MAP_DB[1] - MAP_DB[0])
    coloured = (255.0 * mpl.colormaps["magma"](share.numpy())[..., :3]).round().astype(np.uint8)
    return Image.fromarray(coloured).quantize(48, dither=Image.Dither.NONE).convert("RGB")


def canvas(size_px: tuple[int, int], colour: str, place: tuple[float, float, float, float]) -> tuple[Figure, Any]:
    """An empty figure with one plot."""
    figure = Figure(figsize=(size_px[0] / DPI, size_px[1] / DPI), dpi=DPI, facecolor=colour)
    return figure, figure.add_axes(place)


def pixels(figure: Figure) -> Image.Image:
    """A figure as a picture."""
    drawn = FigureCanvasAgg(figure)
    drawn.draw()
    return Image.fromarray(np.asarray(drawn.buffer_rgba())[..., :3].copy())


if __name__ == "__main__":
    main()
