"""Clouds of a sweep as its page shows them: clear and in each level, from the side and by angle."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.evaluation.sweep import Level, LidarSubject, Series, Subject
from torchweather.lidar.cloud_frame import points_in_sensor_frame
from torchweather.pipeline.point_kind import PointKind
from torchweather.report.cloud_counts import has_return
from torchweather.report.lidar_flat_figures import angle_views_uri, side_views_uri
from torchweather.report.lidar_views import WeatherCloud

__all__ = ["flat_pictures", "weather_clouds"]


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


def flat_pictures(series: Series, subject: Subject) -> list[dict[str, str]]:
    """A LiDAR's first cloud from the side and by angle, clear and in the heaviest weather; nothing of others."""
    if not isinstance(subject, LidarSubject):
        return []
    heaviest = series.levels[-1]
    clear, cloud = weather_clouds(subject, [heaviest], series.seeds[0])
    named = [("Clear", clear), (heaviest.text, cloud)]
    side = "ahead is right, heights drawn larger than lengths; the line is the ground"
    return [
        {"title": "From the side", "note": side, "picture": side_views_uri(named, clear)},
        {"title": "By angle", "note": "as the sensor sees it", "picture": angle_views_uri(named, clear)},
    ]
