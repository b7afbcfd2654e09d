"""The radar's part of the demo page: the scene of the camera to an FMCW radar, clear and in rain, fog and snow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from torchweather.io import RADAR_COLUMNS, RadarPoints, write_radar
from torchweather.radar.sensor import Radar
from torchweather.report import parts
from torchweather.report.radar_figures import OTHER, above_uri, bar_uri, map_uri, power_scale
from torchweather.report.radar_views import RadarFrame, RadarScene
from torchweather.report.report import Section
from torchweather.report.tables import number_text, weathers_table
from torchweather.scenes.primitives import Point

__all__ = ["RADAR_WEATHERS", "WALKING", "radar_part"]

# Name of the files, label, kind, weather as the command line takes it. 19 mm/h is a rate
# of the literature; the law of the sizes was fitted to lower rates, so the number of flakes is scaled to it, and the
# page warns.
RADAR_WEATHERS = (
    *((f"rain-{rate}", f"Rain {rate} mm/h", "rain", f"rain:rate={rate}") for rate in (10, 25, 50)),
    *((f"fog-{mor}", f"Fog {mor} m", "fog", f"fog:mor={mor}") for mor in (10, 20, 30, 50)),
    ("snow-1", "Snow 1 mm/h", "snow", "snow:rate=1"),
    ("snow-19", "Snow 19 mm/h", "snow", "snow:rate=19,close_rate=true"),
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
FINE = """A point counts as the scene's where the scene's echo, known from the simulation without noise and weather, is
    stronger in its beam than everything else. The CSV files hold position, radial speed, power, cross section (of clear
    air: weather makes it smaller) and kind (0 scene, 1 weather or noise). Attenuation of rain after ITU-R P.838-3, of
    fog after P.840, of snow by Mie theory over the flakes."""
FILE_COLUMNS = (*RADAR_COLUMNS, "kind")


def radar_part(
    seen: RadarScene, sensor: str, seed: int, folder: Path, prefix: str, step: Callable[[int], object]
) -> tuple[dict[str, Any], Section]:
    """Simulate the scene in clear air and in every weather.

    Args:
        seen: the scene's scatterers and their echo.
        sensor: its name.
        seed: of noise and weather; the noise of the receiver is the same in all frames.
        folder: of the page; the points go to ``clouds/`` in it.
        prefix: of the files' names.
        step: told of each weather done.

    Returns:
        The record for the summary, and the section of the page.
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
    records: list[dict[str, Any]] = []
    maps, above = [], []
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
        picture = map_uri(frame, seen.radar, scale)
        maps.append(parts.Figure(picture, f"Range-Doppler map, {label}", caption=label))
        picture = above_uri(frame, seen.view.boxes, seen.radar, point_scale)
        facts = [*_facts(frame), parts.link(file, "points (CSV)")]
        above.append(parts.Figure(picture, f"Radar points from above, {label}", caption=label, facts=facts))
    notes = list(dict.fromkeys(said for *_, frame in frames for said in frame.warnings))
    summary = {
        "sensor": sensor,
        "radar": seen.radar.to_dict(),
        "scatterers": len(seen.view.object_id),
        "notes": notes,
        "weathers": records,
    }
    map_bar = bar_uri("map", scale, "mean power of the channels, dBm")
    point_bar = bar_uri("points", point_scale, "power of the scene's points, dBm")
    rings = parts.markup(
        """rings: cells that became points; white: of the scene, <span style="color:{}">orange</span>: of weather or
        noise""",
        OTHER,
    )
    triangle = parts.markup(
        """the radar is the triangle, ahead is up; outlines: cars, pedestrian, cyclist; <span style="color:{}">×</span>:
        weather or noise""",
        OTHER,
    )
    page = Section(
        f"Radar: the same scene at {seen.radar.frequency_ghz:g} GHz",
        [
            parts.Prose(list(_words(seen.radar, sensor, records))),
            *(parts.Note(f"{note} The frame is shown all the same.") for note in notes),
            parts.Heading("Range and speed", rings),
            parts.Figure(map_bar, "Colours of the maps", look="bar plain"),
            parts.Pictures(maps, across=4),
            parts.Heading("From above", triangle),
            parts.Figure(point_bar, "Colours of the points", look="bar plain"),
            parts.Pictures(above, across=4, look="stacked"),
            weathers_table("Radar, in numbers", COLUMNS, records, "radar", _text),
            parts.Fine(FINE),
        ],
        id=f"{prefix}-radar",
        short="Radar",
    )
    return summary, page


def _words(radar: Radar, sensor: str, records: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Paragraphs that explain the frames."""
    lost_db = {record["name"]: record["numbers"]["loss_56_m_db"] for record in records}
    yield parts.markup(
        """One frame of the FMCW radar <code>{}</code> in the bumper: {} virtual channels, {} chirps of {} samples,
        thermal noise, range-Doppler map, CFAR detector, points. A range bin is {:.2f} m, a speed bin {:.2f} m/s. The
        cars are facets of metal skin with small corners in them; two corner reflectors of 10 dBsm stand beside the
        road at 20 and 45 m; pedestrian, cyclist, boards, posts, guard rail and trees are points of generic cross
        section. Road users go at walking pace here, all else stands.""",
        *(sensor, radar.virtual_channels, radar.chirps, radar.samples),
        *(radar.range_resolution_m, radar.speed_resolution_m_per_s),
    )
    yield parts.markup(
        """<strong>Fog hides the scene from eyes and lasers, not from the radar.</strong> Its droplets are hundreds of
        times smaller than the wave: fog of 10 m visibility takes {:.2f} dB of the echo from 56 m.""",
        lost_db["fog-10"],
    )
    yield parts.markup(
        """<strong>Rain adds points, and they are echoes.</strong> It weakens the scene a little ({:.1f} dB from 56 m
        and back at 25 mm/h) and sends some of the wave back itself. That falls with the square of the range, a
        target's echo with the fourth power, so it shows near the radar, around the speed of the falling drops as seen
        from the side, which is near 0. The receiver's noise is the same in all frames. Dry snow does either far
        less.""",
        lost_db["rain-25"],
    )


def _facts(frame: RadarFrame) -> Iterator[str]:
    """Facts below a picture."""
    scene, other = frame.numbers["points_scene"], frame.numbers["points_other"]
    yield f"{scene} points of the scene"
    yield f"{other} of {'noise' if frame.weather is None else 'weather and noise'}"


def _text(key: str, value: float) -> str:
    if key.startswith("points_"):
        return f"{value:d}"
    if key.endswith("_dbm"):
        return f"{value:.1f}".replace("-", "\u2212")
    return number_text(value)
