"""The kinds of study by name; a new sensor adds its own here."""

from __future__ import annotations

from collections.abc import Mapping

from torchweather.gap.sensors.camera.study_kind import CameraStudy
from torchweather.gap.sensors.lidar.study_kind import LidarStudy
from torchweather.gap.sensors.link.study_kind import LinkStudy
from torchweather.gap.sensors.radar.study_kind import RadarStudy
from torchweather.gap.study.kinds import StudyKind

__all__ = ["KINDS"]

KINDS: Mapping[str, StudyKind] = {one.name: one for one in (LidarStudy(), CameraStudy(), RadarStudy(), LinkStudy())}
