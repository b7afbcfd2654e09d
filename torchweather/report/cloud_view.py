"""A page that shows a point cloud in clear air and in a weather: points to turn and zoom, counts by range."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather import __version__
from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import check_at_least
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarResult
from torchweather.report import parts
from torchweather.report.page import write_report
from torchweather.report.report import Report, Section
from torchweather.report.view_flat import flat_view, under_ground
from torchweather.report.view_points import (
    INT16_MAX,
    UINT16_MAX,
    RangeCounts,
    ViewPoints,
    counts_by_range,
    packed,
    thinned,
    view_points,
)
from torchweather.report.view_words import count_text, share_text, weather_words

__all__ = ["MOST_POINTS", "write_cloud_view"]

# 300 000 points of 9 bytes are 3.6 MB of base64: a browser opens two such clouds at once, and a phone draws them.
MOST_POINTS = 300_000
RINGS_M = (10.0, 20.0, 40.0, 80.0, 160.0)
# Orange against blue and grey, as in the figures, lighter: they lie on a dark ground.
COLOURS = {"object": "#b9c6d2", "particle": "#ff7f2a", "lost": "#4f97ea"}
RAMP, RAMP_COLOURS = "viridis", 24
# The brightest and farthest points of a cloud are few: a scale up to them would show all others in one colour.
TOP_QUANTILE = 0.98
GROUND_QUANTILE = 0.05  # height of the range rings: low, but above single points below the road
UNITS = {
    "reflectivity": "reflectivity, 1 = white",
    "reflectivity_percent": "reflectivity, %",
    "uint8_linear": "counts, 255 = white",
    "uint8_calibrated": "counts, 100 = white",
    "photons": "photons",
}


def write_cloud_view(
    path: str | os.PathLike[str],
    points: Tensor,
    result: LidarResult,
    sensor: Lidar,
    *,
    weather: Weather,
    seed: int,
    name: str,
    sensor_name: str,
    notes: Sequence[str] = (),
    alerts: Sequence[str] = (),
    most_points: int = MOST_POINTS,
) -> dict[str, Any]:
    """Write a self-contained page with a cloud in clear air and in weather.

    Args:
        path: of the page.
        points: ``(N, C)`` the clear cloud: x, y, z in metres, intensity in the sensor's unit.
        result: of that cloud in the weather.
        sensor: the LiDAR.
        weather: that was put on it.
        seed: of the weather.
        name: of the cloud, for the heading.
        sensor_name: such as ``lidar:velodyne-hdl-64e``.
        notes: sentences about what was guessed.
        alerts: sentences that stand above the picture, because they put all of it in doubt.
        most_points: points of each cloud that the page holds at most; it thins by beams and says so. Counts are
            always of the whole clouds.

    Returns:
        ``points``, ``objects``, ``particles``, ``lost``, ``under_ground`` (particles more than 0.3 m under the ground
        within 40 m; ``None`` where no ground is found), ``shown_clear``, ``shown_weather``, ``stride`` (one beam of so
        many is shown), ``bytes`` of the page.
    """
    check_at_least("most_points", most_points, 1, owner="write_cloud_view")
    clear, seen = view_points(points, result, sensor)
    counts = counts_by_range(clear, seen)
    shown_clear, shown_seen, stride = thinned(clear, seen, most_points)
    data, scales = _data(shown_clear, shown_seen, sensor)
    flat, plane = flat_view(clear, seen, scales["range_top_m"])
    data["flat"] = flat
    if plane is not None:
        data["ground_m"] = plane.height_m
    under = under_ground(seen, plane)
    notes = list(notes)
    if isinstance(result.second, Tensor):
        notes.append("The sensor reports two returns of a beam; second returns are shown and counted, too.")
    page = Report(
        title=f"{name} in {weather_words(weather)}",
        lead=[parts.Paragraph(_lead(weather_words(weather), seed, sensor_name, bool(notes)), "lead")],
        sections=[
            Section("", [*(parts.Alert(alert, grave=True) for alert in alerts), _stage(scales, flat, under, counts)]),
            Section("Points by range", _by_range(counts)),
            *([Section("What was assumed", [parts.Listing(notes)], id="notes")] if notes else []),
            Section("", [parts.Fine(_shown(len(shown_clear), len(shown_seen), stride, result.scan, scales))]),
        ],
        styles=["cloud.css"],
        scripts=["cloud_flat.js", "cloud_view.js"],
        data=data,
    )
    write_report(page, path)
    total = counts[-1]
    return {
        "points": total.clear,
        "objects": total.objects,
        "particles": total.particles,
        "lost": total.lost,
        "under_ground": None if plane is None else under,
        "shown_clear": len(shown_clear),
        "shown_weather": len(shown_seen),
        "stride": stride,
        "bytes": Path(path).stat().st_size,
    }


def _lead(weather: str, seed: int, sensor: str, assumed: bool) -> str:
    below = (
        parts.markup("{} stands below.", parts.link("#notes", "What was assumed"))
        if assumed
        else "Nothing was assumed."
    )
    text = "Weather: {}, seed {}. Sensor: {}. Made by torchweather {}. {}"
    return parts.markup(text, weather, seed, sensor, __version__, below)


def _stage(scales: dict[str, Any], flat: dict[str, Any], under: int, counts: Sequence[RangeCounts]) -> parts.Widget:
    """The points with what turns and colours them, and the flat views."""
    values = {
        "scales": scales,
        "flat": flat,
        "colours": COLOURS,
        "under": under,
        "under_text": count_text(under),
        "particles_text": count_text(counts[-1].particles),
    }
    return parts.Widget("cloud_stage.html", values)


def _by_range(counts: Sequence[RangeCounts]) -> list[parts.Part]:
    """Counts by range with bars; the last row is their sum."""
    most = max(1, *(max(row.clear, row.objects + row.particles) for row in counts[:-1]))
    rows: list[list[parts.Cell | str]] = []
    for row in counts:
        numbers = (row.clear, row.objects, row.particles, row.lost)
        cells = (parts.Cell(count_text(number), data={"count": number}) for number in numbers)
        bars = parts.markup(
            """<div class="two" aria-hidden="true"><div><i class="was" style="width:{:.2f}%"></i></div><div><i
            class="is" style="width:{:.2f}%"></i><i class="new" style="width:{:.2f}%"></i></div></div>""",
            *(100 * number / most for number in numbers[:3]),
        )
        head = parts.Cell(row.label, data={"range": row.label})
        rows.append([head, *cells, share_text(row.objects, row.clear), bars if row is not counts[-1] else ""])
    heads = ["range, m", "clear", "objects", "particles", "lost", "left"]
    keys = {"clear air": "var(--was)", "objects in weather": "var(--is)", "particles": "var(--new)"}
    fine = """Objects and particles count at the range that the sensor reports, lost points at their range in clear
        air. A beam that reports a particle in place of its object counts as a particle, not as lost. Left: objects in
        weather, as a share of the points in clear air."""
    return [
        parts.Legend([parts.Key(text, colour, look="stroke") for text, colour in keys.items()]),
        parts.Table([*heads, parts.Column("", "bars")], rows, look="counts"),
        parts.Fine(fine),
    ]


def _shown(clear: int, seen: int, stride: int, scan: str, scales: dict[str, Any]) -> str:
    """Sentences on the share of points that the picture shows."""
    text = "The picture shows all points."
    if stride > 1:
        text = f"""The picture shows one beam in {stride} ({count_text(clear)} points in clear air, {count_text(seen)}
            in weather and lost); the table counts all."""
    rings = ", ".join(f"{ring:.0f}" for ring in scales["rings_m"])
    return f"""{text} Scan: {scan}. Rings lie at {rings} m from the sensor, level; the arrow points along x. The page
        holds positions in steps of {scales["step_mm"]:.1f} mm."""


def _data(clear: ViewPoints, seen: ViewPoints, sensor: Lidar) -> tuple[dict[str, Any], dict[str, Any]]:
    """Data for the page's scripts, and the scales that its text names."""
    import matplotlib as mpl

    both = torch.cat([clear.xyz_m, seen.xyz_m])
    intensity = torch.cat([clear.intensity, seen.intensity]).nan_to_num().clamp_min(0)
    ranges = torch.cat([clear.range_m, seen.range_m])
    step_m = max(_highest(both.abs()), 1.0) / INT16_MAX
    intensity_step = max(_highest(intensity), 1e-9) / UINT16_MAX
    near = clear.xyz_m[(clear.range_m > 4) & (clear.range_m < 25)]
    height_m = _quantile(near[:, 2], GROUND_QUANTILE) if len(near) else 0.0
    scales = {
        "range_top_m": max(10.0, float(f"{_quantile(ranges, TOP_QUANTILE):.2g}")),
        "intensity_top": max(float(f"{_quantile(intensity, TOP_QUANTILE):.2g}"), intensity_step),
        "intensity_unit": UNITS.get(sensor.intensity_unit, ""),
        "step_mm": step_m * 1000,
        "rings_m": [ring for ring in RINGS_M if ring <= _highest(ranges)],
        "ramp": [
            "#" + "".join(f"{round(255 * float(part)):02x}" for part in mpl.colormaps[RAMP](share)[:3])
            for share in np.linspace(0.12, 1.0, RAMP_COLOURS)  # its darkest end is lost on a dark ground
        ],
    }
    data = {
        "clear": packed(clear, step_m, intensity_step),
        "weather": packed(seen, step_m, intensity_step),
        "step_m": step_m,
        "intensity_full": intensity_step * UINT16_MAX,
        "ground_m": height_m,
        "colours": list(COLOURS.values()),
        **{key: scales[key] for key in ("range_top_m", "intensity_top", "rings_m", "ramp")},
    }
    return data, scales


def _highest(values: Tensor) -> float:
    return float(values.max()) if values.numel() else 0.0


def _quantile(values: Tensor, share: float) -> float:
    return float(np.quantile(values.double().numpy(), share)) if values.numel() else 0.0
