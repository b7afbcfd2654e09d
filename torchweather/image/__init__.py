"""Raw frames and colour images: mosaic, demosaic, tone, and depth for any image."""

from __future__ import annotations

from torchweather.camera.bayer import (
    PATTERNS,
    RCCB_TO_RGB,
    RGB_TO_RCCB,
    cfa_colour_index,
    cfa_index,
    colour_means,
    join_planes,
    mosaic,
    split_planes,
)
from torchweather.camera.demosaic import METHODS, demosaic
from torchweather.camera.luminance import (
    LuminanceExposure,
    airlight_from_luminance,
    luminance_from_signal,
    signal_from_luminance,
)
from torchweather.camera.tone import (
    colour_matrix,
    compand,
    develop,
    expand,
    grey_world_gains,
    normalise,
    quantise,
    shoulder_curve,
    srgb_decode,
    srgb_encode,
    white_balance,
)
from torchweather.image.depth import (
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
    "METHODS",
    "PATTERNS",
    "RCCB_TO_RGB",
    "RGB_TO_RCCB",
    "ConstantDepth",
    "DepthFromCallable",
    "DepthFromPoints",
    "DepthMap",
    "DepthSource",
    "FlatGround",
    "LuminanceExposure",
    "airlight_from_luminance",
    "as_depth_source",
    "cfa_colour_index",
    "cfa_index",
    "check_depth",
    "colour_matrix",
    "colour_means",
    "compand",
    "demosaic",
    "develop",
    "expand",
    "grey_world_gains",
    "join_planes",
    "luminance_from_signal",
    "mosaic",
    "normalise",
    "project_points",
    "quantise",
    "shoulder_curve",
    "signal_from_luminance",
    "split_planes",
    "srgb_decode",
    "srgb_encode",
    "white_balance",
]
