"""Pictures of a sweep: its first subject clear and in every level, with the first seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torchweather.evaluation.sweep import Level, LidarSubject, Series, Subject
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.pipeline.point_kind import PointKind
from torchweather.report import parts
from torchweather.report.cloud_counts import has_return
from torchweather.report.frames import Frame
from torchweather.report.lidar_figures import COLOURS, birds_eye_uri
from torchweather.report.lidar_flat_figures import angle_views_uri, side_views_uri
from torchweather.report.lidar_views import WeatherCloud
from torchweather.report.pictures import jpeg_uri, shrunk
from torchweather.report.sweep_figures import points_above_uri

__all__ = ["DEVELOPED", "flat_pictures", "legend", "level_pictures", "weather_clouds"]

PICTURE_PX = 480  # columns of a picture
DEVELOPED = {"camera": ", one development for all"}
LEGENDS = {
    "camera": {},
    "lidar": {
        "object": "objects",
        "particle": "returns of the weather",
        "lost": "points that are lost, where they were",
    },
    "radar": {"object": "detections", "lost": "detections of clear air"},
}


def weather_clouds(subject: LidarSubject, levels: Sequence[Level], seed: int) -> list[WeatherCloud]:
    """The clear cloud and that of each level, in the sensor's frame."""
    hit = has_return(subject.points, subject.lidar)
    kind = torch.where(hit, int(PointKind.OBJECT), int(PointKind.LOST)).to(torch.int8)
    points = points_in_sensor_frame(subject.points, subject.lidar)
    found = [WeatherCloud(points, kind, torch.zeros_like(hit), {}, {})]
    for level in levels:
        result = subject.run(level.weather, seed)
        assert isinstance(result.points, Tensor)
        assert isinstance(result.kind, Tensor)
        # A scan that was completed has rows after those of the input.
        lost = hit & (result.kind[: len(hit)] == PointKind.LOST)
        points = points_in_sensor_frame(result.points, subject.lidar)
        found.append(WeatherCloud(points, result.kind, lost, {}, {}))
    return found


def level_pictures(series: Series, subject: Subject) -> list[parts.Figure]:
    """The first subject of a series, clear and in every level, with the first seed."""
    labels = ["Clear", *(level.text for level in series.levels)]
    return [
        parts.Figure(picture, f"{series.subjects[0]}, {label}", caption=label)
        for label, picture in zip(labels, DRAWN[subject.sensor](subject, series.levels, series.seeds[0]), strict=True)
    ]


def _camera_pictures(subject: Any, levels: Sequence[Level], seed: int) -> list[str]:
    frame = Frame(subject.name, subject.name, subject.data, subject.depth_m, subject.camera)
    data = [subject.reference, *(subject.render(level.weather, seed) for level in levels)]
    return [jpeg_uri(shrunk(frame.picture(one), PICTURE_PX)) for one in data]


def _lidar_pictures(subject: Any, levels: Sequence[Level], seed: int) -> list[str]:
    found = weather_clouds(subject, levels, seed)
    return [birds_eye_uri(cloud, found[0]) for cloud in found]


def _radar_pictures(subject: Any, levels: Sequence[Level], seed: int) -> list[str]:
    clear = _there(subject.clear)
    clouds = [clear, *(_there(subject.render(level.weather, seed)) for level in levels)]
    return [points_above_uri(cloud, clear) for cloud in clouds]


def _there(points: Tensor) -> Tensor:
    return points[(points[:, :3] != 0).any(-1)]


def flat_pictures(series: Series, subject: Subject) -> list[parts.Figure]:
    """The first subject's pictures beside those from above, clear and in the heaviest weather; of a LiDAR alone."""
    return FLAT[subject.sensor](series, subject) if subject.sensor in FLAT else []


def _flat_lidar_pictures(series: Series, subject: Any) -> list[parts.Figure]:
    """A cloud from the side and by angle."""
    heaviest = series.levels[-1]
    clear, cloud = weather_clouds(subject, [heaviest], series.seeds[0])
    named = [("Clear", clear), (heaviest.text, cloud)]
    side = "ahead is right, heights drawn larger than lengths; the line is the ground"
    return [
        parts.Figure(picture, f"{title}: clear and heaviest", title=title, small=small, look="wide plain")
        for title, small, picture in (
            ("From the side", side, side_views_uri(named, clear)),
            ("By angle", "as the sensor sees it", angle_views_uri(named, clear)),
        )
    ]


DRAWN = {"camera": _camera_pictures, "lidar": _lidar_pictures, "radar": _radar_pictures}
FLAT = {"lidar": _flat_lidar_pictures}


def legend(subject: Subject) -> list[parts.Key]:
    """Colours of a cloud's points; nothing of a camera."""
    return [parts.Key(name, COLOURS[kind]) for kind, name in LEGENDS[subject.sensor].items()]
