"""Ray-cast scenes with known truth: a test track and a fog tunnel, seen by the library's sensors."""

from __future__ import annotations

from collections.abc import Callable

from torchweather.scenes.fog_tunnel import fog_tunnel
from torchweather.scenes.lidar_view import LidarView, lidar_view
from torchweather.scenes.object_boxes import object_boxes
from torchweather.scenes.radar_view import CornerReflector, RadarView, radar_view
from torchweather.scenes.scene import Hit, Scene, SceneLabel, SceneObject, SceneView
from torchweather.scenes.test_track import test_track

__all__ = [
    "SCENES",
    "CornerReflector",
    "Hit",
    "LidarView",
    "RadarView",
    "Scene",
    "SceneLabel",
    "SceneObject",
    "SceneView",
    "fog_tunnel",
    "lidar_view",
    "object_boxes",
    "radar_view",
    "test_track",
]

SCENES: dict[str, Callable[[], Scene]] = {"test-track": test_track, "fog-tunnel": fog_tunnel}
"""The scenes by the name that the command line takes."""
