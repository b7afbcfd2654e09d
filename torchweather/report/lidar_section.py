"""The LiDAR's part of the demo page: the scene of the camera as a cloud, in the same weathers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from torchweather.atmosphere.weather import Weather
from torchweather.io import PointCloud, write_points
from torchweather.pipeline.point_kind import PointKind
from torchweather.report import parts
from torchweather.report.lidar_figures import COLOURS, birds_eye_uri, range_images_uri
from torchweather.report.lidar_flat_figures import UNDER_COLOUR, side_views_uri
from torchweather.report.lidar_views import LidarScene, WeatherCloud
from torchweather.report.report import Section
from torchweather.report.tables import number_text, weathers_table
from torchweather.report.view_words import count_text

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
FINE = """Shares of points are of those in clear air; of empty beams, of those without a return there. The PCD files
    hold x, y, z, intensity, ring and kind (0 object, 1 weather). Extinction is the effective one: light that drops
    and flakes diffract forward stays in the beam."""
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
) -> tuple[dict[str, Any], Section]:
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
        The record for the summary, and the section of the page.
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
    named = [(label, cloud) for label, cloud, _ in pictured]
    figures = []
    for label, cloud, record in pictured:
        file = f"clouds/{prefix}_{record['name']}.pcd"
        record["file"] = file
        _write(folder / file, cloud)
        picture, facts = birds_eye_uri(cloud, clear), [*_facts(record), parts.link(file, "cloud (PCD)")]
        figures.append(parts.Figure(picture, f"Point cloud from above, {label}", caption=label, facts=facts))
    beams = len(clear.kind)
    summary = {"sensor": sensor, "lidar": seen.lidar.to_dict(), "beams": beams, "weathers": records}
    under = parts.markup(
        """ahead is right, all points in one plane, heights drawn larger than lengths; the line is the ground, and
        <span style="color:{}">particles under it</span> would be an error""",
        UNDER_COLOUR,
    )
    sides = parts.Figure(
        side_views_uri(named, clear),
        "Point clouds from the side with the ground: clear, rain, fog, snow",
        title="From the side",
        small=under,
        look="wide plain",
    )
    page = Section(
        "LiDAR: the same scene, the same weather",
        [
            parts.Prose(list(_words(seen, sensor, records))),
            parts.Legend(
                [
                    parts.Key("object", COLOURS["object"]),
                    parts.Key("weather: drop, flake or fog", COLOURS["particle"]),
                    parts.Key("lost: where the point was in clear air", COLOURS["lost"]),
                ]
            ),
            parts.Heading("From above", "the sensor is the triangle, ahead is up, rings in metres"),
            parts.Pictures(figures, across=4, look="stacked"),
            sides,
            *_around(seen, named),
            weathers_table("LiDAR, in numbers", COLUMNS, records, "lidar", _text),
            parts.Fine(FINE),
        ],
        id=f"{prefix}-lidar",
        short="LiDAR",
    )
    return summary, page


def _around(seen: LidarScene, named: Sequence[tuple[str, WeatherCloud]]) -> list[parts.Part]:
    """Range images, where the beams form a grid."""
    if seen.view.grid is None:
        return []
    picture = range_images_uri(named, seen.view.directions, seen.view.grid)
    title, small = "All around, as the sensor sees it", "objects from dark (near) to light grey (far); white: no return"
    return [parts.Figure(picture, "Range images: clear, rain, fog, snow", title=title, small=small, look="wide plain")]


def _words(seen: LidarScene, sensor: str, records: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Paragraphs that explain the clouds."""
    lidar, count = seen.lidar, len(seen.clear.kind)
    beams = number_text(count) if count < 1000 else count_text(count)
    reported = lidar.return_mode if lidar.return_mode != "dual" else "strongest"
    yield parts.markup(
        """The scene of the pictures above as the sensor <code>{}</code> measures it from the roof: {} beams at {:g} nm,
        {} of which meet something that returns enough light. Each beam reports one point, its {} return. Weather dims
        the objects on the way out and back, and what is in the air returns light of its own.""",
        *(sensor, beams, lidar.wavelength_nm, count_text(int(seen.view.hit.sum())), reported),
    )
    rain = [record for record in records if record.get("kind") == "rain"]
    if rain:
        drops = rain[-1]["numbers"]["particles"]
        yield parts.markup(
            """<strong>Almost no raindrop is seen, and that is right.</strong> A drop fills a tiny part of the beam, and
            returns little: {} of {} beams {} one ({}). Rain takes the points that were barely detected in clear air.
            Near drops are hidden by the receiver itself: its response rises from nothing at {:g} m to all at {:g} m
            (plausible values, not measured on this sensor).""",
            *(drops or "none", beams, "reports" if drops == 1 else "report", rain[-1]["label"]),
            *(lidar.near_start_m, lidar.near_full_m),
        )
    yield """Fog is a cloud of countless droplets: its echo peaks some metres ahead, where the receiver begins to see,
        and beats every object behind that is fainter. So most beams report a shell of fog around the sensor, also
        those that met nothing before."""
    yield """A snowflake is large enough to be seen one by one, in the first ten to twenty metres. A beam into the empty
        sky reports even a faint flake; a beam that also meets a near, bright object reports that."""


def _facts(record: dict[str, Any]) -> Iterator[str]:
    """Facts below a picture from above."""
    numbers = record["numbers"]
    if record["name"] == "clear":
        yield f"{count_text(int(numbers['objects']))} points"
        return
    yield f"{_percent(numbers['share_objects'])} of the points left"
    if numbers["particles"] < 1000:
        yield f"{numbers['particles']} beams report the weather"
    else:
        yield f"{_percent(numbers['share_replaced'])} covered, {_percent(numbers['share_lost'])} lost"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}\u202f%"


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
