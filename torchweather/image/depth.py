"""Depth of an image; it lives in `torchweather.camera.depth`, this is its former address."""

from __future__ import annotations

from torchweather.camera.depth import (
    ConstantDepth,
    DepthFromCallable,
    DepthFromPoints,
    DepthMap,
    DepthSource,
    FlatGround,
    as_depth_source,
    check_depth,
    project_points,
)

__all__ = [
    "ConstantDepth",
    "DepthFromCallable",
    "DepthFromPoints",
    "DepthMap",
    "DepthSource",
    "FlatGround",
    "as_depth_source",
    "check_depth",
    "project_points",
]
