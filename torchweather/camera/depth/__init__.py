"""Depth and sky of an image: given, measured and completed, or guessed from the picture."""

from __future__ import annotations

from torchweather.camera.depth.given import ConstantDepth, DepthFromCallable, DepthMap, as_depth_source
from torchweather.camera.depth.ground import FlatGround
from torchweather.camera.depth.points import DepthFromPoints
from torchweather.camera.depth.projection import project_points
from torchweather.camera.depth.scene_depth import (
    COMPLETED,
    CONFIDENCES,
    EXACT,
    GUESSED,
    MEASURED,
    SceneDepth,
    least_sure,
)
from torchweather.camera.depth.source import DepthSource, check_depth, scene_of

__all__ = [
    "COMPLETED",
    "CONFIDENCES",
    "EXACT",
    "GUESSED",
    "MEASURED",
    "ConstantDepth",
    "DepthFromCallable",
    "DepthFromPoints",
    "DepthMap",
    "DepthSource",
    "FlatGround",
    "SceneDepth",
    "as_depth_source",
    "check_depth",
    "least_sure",
    "project_points",
    "scene_of",
]
