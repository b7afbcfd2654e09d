"""Depth and sky of an image: given, measured and completed, or guessed from the picture."""

from __future__ import annotations

from torchweather.camera.depth.completion import CompletedDepth
from torchweather.camera.depth.given import AUTO, ConstantDepth, DepthFromCallable, DepthMap, as_depth_source
from torchweather.camera.depth.ground import FlatGround
from torchweather.camera.depth.horizon import Horizon, find_horizon
from torchweather.camera.depth.near_mask import find_near_mask
from torchweather.camera.depth.network import DepthNetwork
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
from torchweather.camera.depth.scene_prior import ScenePrior
from torchweather.camera.depth.sky import Sky, find_sky, sky_mask
from torchweather.camera.depth.source import DepthSource, check_depth, scene_of
from torchweather.camera.depth.sparse import CompletedDepthMap, along_ray_to_axis, depth_from_disparity

__all__ = [
    "AUTO",
    "COMPLETED",
    "CONFIDENCES",
    "EXACT",
    "GUESSED",
    "MEASURED",
    "CompletedDepth",
    "CompletedDepthMap",
    "ConstantDepth",
    "DepthFromCallable",
    "DepthFromPoints",
    "DepthMap",
    "DepthNetwork",
    "DepthSource",
    "FlatGround",
    "Horizon",
    "SceneDepth",
    "ScenePrior",
    "Sky",
    "along_ray_to_axis",
    "as_depth_source",
    "check_depth",
    "depth_from_disparity",
    "find_horizon",
    "find_near_mask",
    "find_sky",
    "least_sure",
    "project_points",
    "scene_of",
    "sky_mask",
]
