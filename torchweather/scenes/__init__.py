"""Ray-cast scenes with known truth: a test track, a fog tunnel and the halls of REHEARSE, seen by the sensors."""

from __future__ import annotations

from collections.abc import Callable

from torchweather.scenes.cerema_tunnel import CEREMA_FIELD, cerema_tunnel
from torchweather.scenes.fog_tunnel import fog_tunnel
from torchweather.scenes.lidar_view import LidarView, lidar_view
from torchweather.scenes.object_boxes import object_boxes
from torchweather.scenes.radar_view import CornerReflector, RadarView, radar_view
from torchweather.scenes.rain_field import RainField
from torchweather.scenes.scene import Hit, Scene, SceneLabel, SceneObject, SceneView
from torchweather.scenes.test_track import test_track
from torchweather.scenes.thi_hall import THI_RAIN_FIELD, thi_hall

__all__ = [
    "CEREMA_FIELD",
    "SCENES",
    "THI_RAIN_FIELD",
    "CornerReflector",
    "Hit",
    "LidarView",
    "RadarView",
    "RainField",
    "Scene",
    "SceneLabel",
    "SceneObject",
    "SceneView",
    "cerema_tunnel",
    "fog_tunnel",
    "lidar_view",
    "object_boxes",
    "radar_view",
    "test_track",
    "thi_hall",
]

SCENES: dict[str, Callable[[], Scene]] = {
    "test-track": test_track,
    "fog-tunnel": fog_tunnel,
    "thi-hall": thi_hall,
    "cerema-tunnel": cerema_tunnel,
}
"""The scenes by the name that the command line takes."""
