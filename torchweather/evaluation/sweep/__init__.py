"""Weather of rising severity on one sensor's data: levels, subjects, scores, and whether they follow."""

from torchweather.evaluation.sweep.levels import Level, parse_levels
from torchweather.evaluation.sweep.run import COLUMNS, Sample, columns_of, samples, sweep
from torchweather.evaluation.sweep.series import Series, series_of
from torchweather.evaluation.sweep.subjects import (
    CameraSubject,
    LidarSubject,
    RadarSceneSubject,
    RadarSubject,
    Subject,
)
from torchweather.evaluation.sweep.trends import Judgement, SeriesTrends, judged

__all__ = [
    "COLUMNS",
    "CameraSubject",
    "Judgement",
    "Level",
    "LidarSubject",
    "RadarSceneSubject",
    "RadarSubject",
    "Sample",
    "Series",
    "SeriesTrends",
    "Subject",
    "columns_of",
    "judged",
    "parse_levels",
    "samples",
    "series_of",
    "sweep",
]
