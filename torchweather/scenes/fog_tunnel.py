"""A fog chamber of the greenhouse kind: a closed translucent tunnel with boards, a car and a pedestrian dummy.

Generic: a width of 5.5 m and a length of 30 m as the CEREMA PAVIN platform is described; height and fittings are
invented. There is no sky: every ray ends on something.
"""

from __future__ import annotations

import math

from torchweather.scenes.actors import board_on_stand, car, pedestrian
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.materials import MATERIALS
from torchweather.scenes.primitives import Box, FacetMesh, GroundPatch, Plane
from torchweather.scenes.scene import Part, Scene, SceneLabel, SceneObject

__all__ = ["fog_tunnel"]

WIDTH_M, LENGTH_M = 5.5, 30.0
BEHIND_M = -3.0
WALL_HEIGHT_M, RIDGE_HEIGHT_M = 1.7, 2.9
ARCH_FACETS = 8


def _arch() -> FacetMesh:
    """The roof: half an ellipse over the side walls, in flat strips along the tunnel."""
    half = WIDTH_M / 2
    profile = [
        (half * math.cos(math.pi * k / ARCH_FACETS), math.sin(math.pi * k / ARCH_FACETS))
        for k in range(ARCH_FACETS + 1)
    ]
    rise = RIDGE_HEIGHT_M - WALL_HEIGHT_M
    # The strips go on behind both end walls, so that no seam is open there.
    ends = (BEHIND_M - 1.0, LENGTH_M + 1.0)
    vertices = tuple((x, y, WALL_HEIGHT_M + rise * z) for x in ends for y, z in profile)
    count = ARCH_FACETS + 1
    triangles = [
        triangle for k in range(ARCH_FACETS) for triangle in ((k, k + 1, count + k), (k + 1, count + k + 1, count + k))
    ]
    return FacetMesh(vertices, tuple(triangles))


def fog_tunnel() -> Scene:
    """A fog tunnel, 5.5 m wide, its end wall 30 m ahead: car, pedestrian dummy, boards at 8, 13 and 20 m.

    The light is a uniform dome (the translucent roof in daylight), so that surfaces do not depend on where they stand.

    Returns:
        The scene; depth is finite everywhere.

    Example:
        >>> import torch
        >>> float(fog_tunnel().cast((0.0, 0.0, 1.5), torch.tensor([1.0, 0.0, 0.3])).label)
        14.0
    """
    half = WIDTH_M / 2
    outer = (BEHIND_M - 1.0, LENGTH_M + 1.0)
    floor = GroundPatch(outer, (-half - 1.0, half + 1.0))
    line = GroundPatch((BEHIND_M, LENGTH_M), (-0.06, 0.06), dash_m=1.0, gap_m=1.0)
    walls = tuple(
        Part(
            Box(((outer[0] + outer[1]) / 2, side * (half + 0.05), 0.9), (outer[1] - outer[0], 0.1, 1.8)),
            "membrane_wall",
        )
        for side in (1, -1)
    )
    skirting = tuple(
        Part(
            Box(((outer[0] + outer[1]) / 2, side * (half - 0.02), 0.12), (outer[1] - outer[0], 0.04, 0.24)), "concrete"
        )
        for side in (1, -1)
    )
    objects = [
        SceneObject("floor", SceneLabel.FLOOR, (Part(floor, "hall_floor"),)),
        SceneObject("line", SceneLabel.LANE_MARKING, (Part(line, "lane_paint"),)),
        SceneObject("roof", SceneLabel.ROOF, (Part(_arch(), "membrane_roof"),)),
        SceneObject("side walls", SceneLabel.WALL, walls + skirting),
        SceneObject(
            "end walls",
            SceneLabel.WALL,
            (
                Part(Plane((LENGTH_M, 0.0, 0.0), (-1.0, 0.0, 0.0)), "end_wall"),
                Part(Plane((BEHIND_M, 0.0, 0.0), (1.0, 0.0, 0.0)), "end_wall"),
                Part(Box((LENGTH_M, 0.0, 1.05), (0.06, 1.8, 2.1)), "door"),
            ),
        ),
        car("car", (17.0, 1.2), paint="paint_blue"),
        pedestrian("pedestrian dummy", (11.0, -0.55), yaw_rad=math.pi * 0.55, jacket="jacket_orange"),
        board_on_stand("board 90 %", (8.0, -1.75), 0.90, size_m=0.5, lower_edge_m=0.6),
        board_on_stand("board 5 %", (8.0, 1.75), 0.05, size_m=0.5, lower_edge_m=0.6),
        board_on_stand("board checker", (13.0, -2.0), MATERIALS["checker"], size_m=1.0, lower_edge_m=0.5),
        board_on_stand("board 50 %", (13.0, 2.35), 0.50, size_m=0.5, lower_edge_m=0.6),
        board_on_stand("board 80 %", (20.0, -0.9), 0.80, size_m=0.5, lower_edge_m=0.6),
        board_on_stand("board 10 %", (20.0, -1.7), 0.10, size_m=0.5, lower_edge_m=0.6),
    ]
    light = DiffuseLight(zenith_rgb=(0.55, 0.58, 0.59), gradient=0.0, cloud_contrast=0.0, ground_albedo=0.16)
    return Scene("fog-tunnel", tuple(objects), light)
