"""The LiDAR's part of the demo page: the scene of the camera as a cloud, in the same weathers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from torchweather.atmosphere.weather import Weather
from torchweather.io import PointCloud, write_points
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.lidar_figures import COLOURS, birds_eye_uri, range_images_uri
from torchweather.report.lidar_flat_figures import UNDER_COLOUR, side_views_uri
from torchweather.report.lidar_views import LidarScene, WeatherCloud
from torchweather.report.tables import number_text

__all__ = ["lidar_part"]

# Name of the file, label, kind of the weather, weather.
Named = tuple[str, str, str, Weather]

# Key in the summary, heading, unit; a share is shown in per cent.
COLUMNS = (
    ("extinction_per_m", "Extinction, effective", "1/m"),
    ("share_objects", "Points left", "%"),
    ("share_replaced", "Covered by weather", "%"),
    ("share_lost", "Lost", "%"),
    ("share_particles_empty", "Empty beams that see weather", "%"),
    ("particle_range_m", "Median range of the weather's points", "m"),
    ("points_car 28 m", "Points on the car at 28 m", ""),
    ("points_car 56 m", "Points on the car at 56 m", ""),
    ("points_pedestrian", "Points on the pedestrian", ""),
    ("render_s", "Rendering", "ms"),
)
FACTORS = {"%": 100.0, "ms": 1000.0}
FILE_COLUMNS = ("x", "y", "z", "intensity", "ring", "kind")


def lidar_part(
    seen: LidarScene,
    sensor: str,
    weathers: Sequence[Named],
    shown: Sequence[str],
    seed: int,
    folder: Path,
    prefix: str,
    step: Callable[[int], object],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Render the scene in every weather.

    Args:
        seen: the clear view.
        sensor: its name.
        weathers: name of the files, label, kind and weather.
        shown: names of the weathers that get pictures and a file.
        seed: of the weather.
        folder: of the page; clouds go to ``clouds/`` in it.
        prefix: of the files' names.
        step: told of each weather done.

    Returns:
        The record for the summary, and the part of the page.
    """
    clear = seen.clear
    (folder / "clouds").mkdir(exist_ok=True)
    records: list[dict[str, Any]] = [{"name": "clear", "label": "Clear", "numbers": clear.numbers, "times_s": {}}]
    pictured: list[tuple[str, WeatherCloud, dict[str, Any]]] = [("Clear", clear, records[0])]
    for name, label, kind, weather in weathers:
        cloud = seen.render(weather, seed)
        times_s = {key: round(value, 6) for key, value in cloud.times_s.items()}
        record = {
            "name": name, "label": label, "kind": kind, "weather": weather.to_dict(), "numbers": cloud.numbers,
            "times_s": times_s,
        }  # fmt: skip
        records.append(record)
        if name in shown:
            pictured.append((label, cloud, record))
        step(1)
    figures = []
    for label, cloud, record in pictured:
        file = f"clouds/{prefix}_{record['name']}.pcd"
        record["file"] = file
        _write(folder / file, cloud)
        figures.append(
            {
                "label": label,
                "picture": birds_eye_uri(cloud, clear),
                "file": file,
                "facts": list(_facts(record)),
            }
        )
    named = [(label, cloud) for label, cloud, _ in pictured]
    grid = seen.view.grid
    ranges = None
    if grid is not None:
        ranges = range_images_uri(named, seen.view.directions, grid)
    beams = len(clear.kind)
    summary = {"sensor": sensor, "lidar": seen.lidar.to_dict(), "beams": beams, "weathers": records}
    page = {
        "sensor": sensor,
        "lidar": seen.lidar,
        "beams": number_text(beams) if beams < 1000 else f"{beams:,}".replace(",", "\u202f"),
        "clear_points": f"{int(seen.view.hit.sum()):,}".replace(",", "\u202f"),
        "colours": COLOURS,
        "figures": figures,
        "sides": side_views_uri(named, clear),
        "under_colour": UNDER_COLOUR,
        "ranges": ranges,
        "rain": _rain(records),
        "columns": [{"heading": heading, "unit": unit} for _, heading, unit in COLUMNS],
        "rows": [{"label": record["label"], "cells": list(_cells(record))} for record in records],
    }
    return summary, page


def _facts(record: dict[str, Any]) -> Iterator[str]:
    """What stands under a picture from above."""
    numbers = record["numbers"]
    if record["name"] == "clear":
        yield f"{int(numbers['objects']):,} points".replace(",", "\u202f")
        return
    yield f"{_percent(numbers['share_objects'])} of the points left"
    if numbers["particles"] < 1000:
        yield f"{numbers['particles']} beams report the weather"
    else:
        yield f"{_percent(numbers['share_replaced'])} covered, {_percent(numbers['share_lost'])} lost"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}\u202f%"


def _rain(records: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The heaviest rain, and how many beams see a drop of it."""
    rain = [record for record in records if record.get("kind") == "rain"]
    if not rain:
        return None
    heaviest = rain[-1]
    return {"label": heaviest["label"], "drops": heaviest["numbers"]["particles"]}


def _cells(record: dict[str, Any]) -> Iterator[dict[str, Any]]:
    values = {**record["numbers"], **record["times_s"]}
    for key, _, unit in COLUMNS:
        value = values.get(key)
        text = "–" if value is None else _text(key, value * FACTORS.get(unit, 1.0))
        yield {"key": key, "value": value, "text": text}


def _text(key: str, value: float) -> str:
    if key.startswith("points_"):
        return f"{value:.0f}"
    if key.startswith("share_"):
        return f"{value:.1f}" if value == 0 or value >= 0.05 else number_text(value)
    return number_text(value)


def _write(path: Path, cloud: WeatherCloud) -> None:
    there = cloud.kind != PointKind.LOST
    table = torch.cat([cloud.points[there].float(), cloud.kind[there, None].float()], -1)
    write_points(path, PointCloud(table, FILE_COLUMNS))
