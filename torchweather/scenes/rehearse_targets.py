"""The targets of the REHEARSE recordings, which ROADVIEW D3.4 scores one at a time.

Sizes of the target boards as the ROADVIEW project lists them (its repository ``dataset_creator_OSI``, ``targets.yaml``:
LiDAR target 0.5 x 1.8 m, camera target 1.5 x 1.8 m, radar target 0.25 m; car 4.06 x 1.80 x 1.43 m, the library's is
4.30 x 1.80 x 1.47 m). What is printed on the boards, and their reflectances, are invented.
"""

from __future__ import annotations

import math

from torchweather.core.errors import check_between, check_one_of
from torchweather.scenes.actors import board_on_stand, car, cyclist, pedestrian
from torchweather.scenes.materials import MATERIALS, board
from torchweather.scenes.primitives import Box, Cylinder
from torchweather.scenes.scene import Part, SceneLabel, SceneObject

__all__ = ["TARGETS", "rehearse_target"]

TARGETS = ("car", "boards", "pedestrian")
"""``car``; ``boards``: the calibration targets of camera, LiDAR and radar; ``pedestrian``: pedestrian and bicycle."""

BESIDE_M = 1.6  # of the LiDAR's targets from the camera's: the rain field is 5 m wide
RADAR_HEIGHT_M = 0.5  # of the radar's target; that of the radar's default mount


def rehearse_target(target: str, distance_m: float) -> list[SceneObject]:
    """Objects of one target; the nearest face of each stands at the distance.

    Args:
        target: one of ``TARGETS``.
        distance_m: along x, 3 to 110 m.
    """
    check_one_of("target", target, TARGETS, owner="rehearse_target")
    check_between("distance_m", distance_m, 3.0, 110.0, unit="m", owner="rehearse_target")
    if target == "car":
        return [car("car", (distance_m, 0.0), paint="paint_silver")]
    if target == "pedestrian":
        return [
            pedestrian("pedestrian", (distance_m + 0.3, -0.9), yaw_rad=math.pi / 2),
            cyclist("cyclist", (distance_m + 0.4, 0.9), yaw_rad=math.pi / 2),
        ]
    return [
        board_on_stand("camera target", (distance_m, 0.0), MATERIALS["checker"], size_m=1.5, lower_edge_m=0.3),
        _panel("LiDAR target 10 %", distance_m, BESIDE_M, 0.10),
        _panel("LiDAR target 80 %", distance_m, -BESIDE_M, 0.80),
        _radar_target(distance_m),
    ]


def _panel(name: str, x_m: float, y_m: float, reflectance: float) -> SceneObject:
    """A diffuse panel of 0.5 x 1.8 m across the view."""
    return SceneObject(
        name, SceneLabel.BOARD, (Part(Box((x_m + 0.01, y_m, 0.9), (0.02, 0.5, 1.8)), board(reflectance)),)
    )


def _radar_target(x_m: float) -> SceneObject:
    """The case of the radar's corner reflector on its pole; the reflector itself is one of ``radar_view``."""
    case = Part(Box((x_m + 0.125, -0.95, RADAR_HEIGHT_M), (0.25, 0.25, 0.25)), "galvanised")
    stand = Part(Cylinder((x_m + 0.125, -0.95, 0.0), (x_m + 0.125, -0.95, RADAR_HEIGHT_M), 0.02), "galvanised")
    return SceneObject("radar target", SceneLabel.BOARD, (case, stand))
