"""The fog of REHEARSE-CEREMA: the first PAVIN fog and rain platform, a closed tunnel with one target.

Known from published descriptions: 30 m long, 5 m wide and 2.2 m high (Carnot network on the platform that followed it
in 2024); a greenhouse for fog by day; fog down to 10 m of visibility and rain up to 200 mm/h from injectors at the
ceiling (RCF, May 2019); the targets of D3.4 stand at 15 m. Invented: the shape of the roof, which is flat here, the
materials, and that rain and fog fill all of it.
"""

from __future__ import annotations

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.primitives import Box, GroundPatch, Plane
from torchweather.scenes.rain_field import RainField
from torchweather.scenes.rehearse_targets import rehearse_target
from torchweather.scenes.scene import Part, Scene, SceneLabel, SceneObject

__all__ = ["CEREMA_FIELD", "cerema_tunnel"]

LENGTH_M, WIDTH_M, HEIGHT_M = 30.0, 5.0, 2.2
BEHIND_M = -3.0  # the sensors stand 3 m in front of the rear wall
AHEAD_M = BEHIND_M + LENGTH_M
CEREMA_FIELD = RainField((BEHIND_M, -WIDTH_M / 2, 0.0), (AHEAD_M, WIDTH_M / 2, HEIGHT_M))
"""Where fog and rain are: the whole tunnel."""


def cerema_tunnel(target: str = "car", distance_m: float = 15.0) -> Scene:
    """A fog and rain tunnel of 30 x 5 x 2.2 m with one target, in the daylight of its translucent skin.

    Args:
        target: ``car``, ``boards`` (the calibration targets of camera, LiDAR and radar) or ``pedestrian`` (with a
            bicycle).
        distance_m: of the target's nearest face, 3 to 22 m; D3.4 scores 15 m.

    Returns:
        The scene; depth is finite everywhere. ``CEREMA_FIELD`` is where weather is.

    Raises:
        InputValueError: for another target or distance.

    Example:
        >>> import torch
        >>> hit = cerema_tunnel().cast((0.0, 0.0, 0.5), torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        >>> [round(metres, 3) for metres in hit.range_m.tolist()]  # the car, the roof
        [15.0, 1.7]
    """
    check_arguments("cerema_tunnel(target: str, distance_m: float)", target, distance_m)
    check_between("distance_m", distance_m, 3.0, 22.0, unit="m", owner="cerema_tunnel")
    along = (BEHIND_M - 1.0, AHEAD_M + 1.0)
    middle, length = (along[0] + along[1]) / 2, along[1] - along[0]
    half = WIDTH_M / 2
    floor = GroundPatch(along, (-half - 1.0, half + 1.0))
    line = GroundPatch((BEHIND_M, AHEAD_M), (-0.06, 0.06), dash_m=1.0, gap_m=1.0)
    roof = Box((middle, 0.0, HEIGHT_M + 0.05), (length, WIDTH_M + 2.0, 0.1))
    walls = tuple(
        Part(Box((middle, side * (half + 0.05), HEIGHT_M / 2), (length, 0.1, HEIGHT_M)), "membrane_wall")
        for side in (1, -1)
    )
    ends = (
        Part(Plane((AHEAD_M, 0.0, 0.0), (-1.0, 0.0, 0.0)), "end_wall"),
        Part(Plane((BEHIND_M, 0.0, 0.0), (1.0, 0.0, 0.0)), "end_wall"),
        Part(Box((AHEAD_M, 0.0, 0.9), (0.06, 1.8, 1.8)), "door"),
    )
    objects = [
        SceneObject("floor", SceneLabel.FLOOR, (Part(floor, "hall_floor"),)),
        SceneObject("line", SceneLabel.LANE_MARKING, (Part(line, "lane_paint"),)),
        SceneObject("roof", SceneLabel.ROOF, (Part(roof, "membrane_roof"),)),
        SceneObject("walls", SceneLabel.WALL, walls + ends),
        *rehearse_target(target, distance_m),
    ]
    light = DiffuseLight(zenith_rgb=(0.55, 0.58, 0.59), gradient=0.0, cloud_contrast=0.0, ground_albedo=0.16)
    return Scene("cerema-tunnel", tuple(objects), light)
