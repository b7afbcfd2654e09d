"""The radar's part of the demo page: the scene of the camera to an FMCW radar, clear and in rain, fog and snow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

from torchweather.io import RADAR_COLUMNS, RadarPoints, write_radar
from torchweather.report.radar_figures import OTHER, above_uri, bar_uri, map_uri, power_scale
from torchweather.report.radar_views import RadarFrame, RadarScene
from torchweather.report.tables import number_text
from torchweather.scenes.primitives import Point

__all__ = ["RADAR_WEATHERS", "WALKING", "radar_part"]

# Name of the files, label, kind, weather as the command line takes it. 19 mm/h of snow is a rate that the literature
# speaks of; the flakes' size distribution was fitted to lower ones, which the page says.
RADAR_WEATHERS = (
    *((f"rain-{rate}", f"Rain {rate} mm/h", "rain", f"rain:rate={rate}") for rate in (10, 25, 50)),
    *((f"fog-{mor}", f"Fog {mor} m", "fog", f"fog:mor={mor}") for mor in (10, 20, 30, 50)),
    *((f"snow-{rate}", f"Snow {rate} mm/h", "snow", f"snow:rate={rate}") for rate in (1, 19)),
)
# Walking pace, m/s in the vehicle frame: it sets the road users apart in speed, and no preset's Doppler folds.
WALKING: dict[str, Point] = {
    "car 28 m": (2.0, 0.0, 0.0),
    "car 56 m": (-2.5, 0.0, 0.0),
    "pedestrian": (-0.4, 1.2, 0.0),
    "cyclist": (0.5, -1.9, 0.0),
}

# Key in the summary, heading, unit.
COLUMNS = (
    ("attenuation_db_per_km", "Attenuation, one way", "dB/km"),
    ("loss_28_m_db", "Lost on 28 m and back", "dB"),
    ("loss_56_m_db", "Lost on 56 m and back", "dB"),
    ("corner_45_m_dbm", "Corner at 45 m", "dBm"),
    ("points_scene", "Points of the scene", ""),
    ("points_other", "Points of weather and noise", ""),
    ("render_s", "Simulation", "s"),
)
FILE_COLUMNS = (*RADAR_COLUMNS, "kind")


def radar_part(
    seen: RadarScene, sensor: str, seed: int, folder: Path, prefix: str, step: Callable[[int], object]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Simulate the scene in clear air and in every weather.

    Args:
        seen: the scene's scatterers and their echo.
        sensor: its name.
        seed: of noise and weather; the noise of the receiver is the same in all frames.
        folder: of the page; the points go to ``clouds/`` in it.
        prefix: of the files' names.
        step: told of each weather done.

    Returns:
        The record for the summary, and the part of the page.
    """
    (folder / "clouds").mkdir(exist_ok=True)
    frames = [("clear", "Clear", "clear", seen.render(None, seed))]
    for name, label, kind, weather in RADAR_WEATHERS:
        frames.append((name, label, kind, seen.render(weather, seed)))
        step(1)
    # Half of a map is noise; one cell in a thousand holds what stands out of it.
    scale = power_scale(frames[0][3].power_dbm, 0.5, 0.999)
    points_dbm = torch.cat([frame.points[frame.of_scene, 4] for *_, frame in frames])
    point_scale = power_scale(points_dbm, 0.1, 0.9) if len(points_dbm) else scale
    records, figures = [], []
    for name, label, kind, frame in frames:
        file = f"clouds/{prefix}_radar_{name}.csv"
        kinds = (~frame.of_scene)[:, None].to(frame.points)
        write_radar(folder / file, RadarPoints(torch.cat([frame.points, kinds], -1), FILE_COLUMNS))
        records.append(
            {
                "name": name,
                "label": label,
                "kind": kind,
                **({} if frame.weather is None else {"weather": frame.weather.to_dict()}),
                "numbers": frame.numbers,
                "times_s": {key: round(value, 6) for key, value in frame.times_s.items()},
                "file": file,
            }
        )
        figures.append(
            {
                "label": label,
                "map": map_uri(frame, seen.radar, scale),
                "above": above_uri(frame, seen.view.boxes, seen.radar, point_scale),
                "file": file,
                "facts": list(_facts(frame)),
            }
        )
    notes = list(dict.fromkeys(said for *_, frame in frames for said in frame.warnings))
    summary = {
        "sensor": sensor,
        "radar": seen.radar.to_dict(),
        "scatterers": len(seen.view.object_id),
        "notes": notes,
        "weathers": records,
    }
    page = {
        "sensor": sensor,
        "radar": seen.radar,
        "notes": notes,
        "other": OTHER,
        "figures": figures,
        "map_bar": bar_uri("map", scale, "mean power of the channels, dBm"),
        "point_bar": bar_uri("points", point_scale, "power of the scene's points, dBm"),
        "columns": [{"heading": heading, "unit": unit} for _, heading, unit in COLUMNS],
        "rows": [{"label": record["label"], "cells": list(_cells(record))} for record in records],
        "said": {record["name"]: record["numbers"] for record in records},
    }
    return summary, page


def _facts(frame: RadarFrame) -> Iterator[str]:
    """What stands under a picture."""
    scene, other = frame.numbers["points_scene"], frame.numbers["points_other"]
    yield f"{scene} points of the scene"
    yield f"{other} of {'noise' if frame.weather is None else 'weather and noise'}"


def _cells(record: dict[str, Any]) -> Iterator[dict[str, Any]]:
    values = {**record["numbers"], **record["times_s"]}
    for key, _, _ in COLUMNS:
        value = values[key]
        yield {"key": key, "value": value, "text": "–" if value is None else _text(key, value)}


def _text(key: str, value: float) -> str:
    if key.startswith("points_"):
        return f"{value:d}"
    if key.endswith("_dbm"):
        return f"{value:.1f}".replace("-", "\u2212")
    return number_text(value)
