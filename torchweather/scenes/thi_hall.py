"""The rain of REHEARSE-THI: a hall with a sprinkled lane, one target in it.

Known from published descriptions: the rain system of THI's CARISSMA test hall sprinkles about 250 m^2 over a length of
50 m, so a lane 5 m wide (THI's page on its rain system); the building is 123 m long (elektroniknet, June 2016); the
targets of D3.4 stand at 28 m and 56 m. Invented: width and height of the hall, the height of the nozzles, where the
lane begins, walls and light. The authors of REHEARSE-3D say that the data set was recorded on CARISSMA's *outdoor*
track under mobile sprinklers; their masts are an option here, and the size of that field is not published.
"""

from __future__ import annotations

from torchweather.core.arguments import check_arguments
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.materials import Material
from torchweather.scenes.primitives import Box, Cylinder, GroundPatch, Plane
from torchweather.scenes.rain_field import RainField
from torchweather.scenes.rehearse_targets import rehearse_target
from torchweather.scenes.scene import Part, Scene, SceneLabel, SceneObject

__all__ = ["THI_RAIN_FIELD", "thi_hall"]

NOZZLE_HEIGHT_M = 5.0
THI_RAIN_FIELD = RainField((0.0, -2.5, 0.0), (50.0, 2.5, NOZZLE_HEIGHT_M))
"""The sprinkled lane: 50 m by 5 m under nozzles at 5 m; it begins at the sensors (place and height are invented)."""

BEHIND_M, AHEAD_M = -5.0, 118.0  # 123 m
HALF_WIDTH_M, HEIGHT_M = 8.0, 7.0
LAMP_SPACING_M = 8.0
MASTS_M = (7.5, 17.5, 27.5, 37.5, 47.5)  # x of the masts of mobile sprinklers, both sides of the lane
LAMP = Material(rgb=(0.1, 0.1, 0.1), emission_rgb=(0.62, 0.62, 0.60), near_infrared=(0.3, 0.3))
CEILING = Material(rgb=(0.45, 0.45, 0.44), emission_rgb=(0.05, 0.05, 0.05), near_infrared=(0.45, 0.45))


def thi_hall(target: str = "car", distance_m: float = 28.0, *, masts: bool = False) -> Scene:
    """A test hall 123 m long with a lane 50 m long that sprinklers rain on, and one target.

    Args:
        target: ``car``, ``boards`` (the calibration targets of camera, LiDAR and radar) or ``pedestrian`` (with a
            bicycle).
        distance_m: of the target's nearest face, 3 to 110 m; D3.4 scores 28 m and 56 m.
        masts: ten masts of mobile sprinklers stand along the lane.

    Returns:
        The scene; depth is finite everywhere. ``THI_RAIN_FIELD`` is where it rains.

    Raises:
        InputValueError: for another target or distance.

    Example:
        >>> import torch
        >>> hit = thi_hall().cast((0.0, 0.0, 0.5), torch.tensor([1.0, 0.0, 0.0]))
        >>> round(float(hit.range_m), 3), SceneLabel(int(hit.label)).name
        (28.0, 'CAR')
    """
    check_arguments("thi_hall(target: str, distance_m: float, masts: bool)", target, distance_m, masts)
    along = (BEHIND_M - 1.0, AHEAD_M + 1.0)
    middle, length = (along[0] + along[1]) / 2, along[1] - along[0]
    floor = GroundPatch(along, (-HALF_WIDTH_M - 1.0, HALF_WIDTH_M + 1.0))
    line = GroundPatch((BEHIND_M, AHEAD_M), (-0.06, 0.06), dash_m=1.0, gap_m=1.0)
    ceiling = Box((middle, 0.0, HEIGHT_M + 0.05), (length, 2 * HALF_WIDTH_M + 2.0, 0.1))
    rows = int((AHEAD_M - BEHIND_M) / LAMP_SPACING_M)
    lamps = tuple(
        Part(Box((BEHIND_M + LAMP_SPACING_M * (k + 0.5), side * 4.0, HEIGHT_M - 0.05), (3.0, 0.4, 0.1)), LAMP)
        for k in range(rows)
        for side in (1, -1)
    )
    pipes = tuple(
        Part(Box((25.0, side * 2.5, NOZZLE_HEIGHT_M + 0.03), (50.0, 0.06, 0.06)), "galvanised") for side in (1, -1)
    )
    objects = [
        SceneObject("floor", SceneLabel.FLOOR, (Part(floor, "hall_floor"),)),
        SceneObject("line", SceneLabel.LANE_MARKING, (Part(line, "lane_paint"),)),
        SceneObject("ceiling", SceneLabel.ROOF, (Part(ceiling, CEILING), *lamps)),
        SceneObject(
            "walls",
            SceneLabel.WALL,
            (
                *(
                    Part(Plane((0.0, side * HALF_WIDTH_M, 0.0), (0.0, -float(side), 0.0)), "end_wall")
                    for side in (1, -1)
                ),
                Part(Plane((AHEAD_M, 0.0, 0.0), (-1.0, 0.0, 0.0)), "concrete"),
                Part(Plane((BEHIND_M, 0.0, 0.0), (1.0, 0.0, 0.0)), "concrete"),
            ),
        ),
        SceneObject("sprinkler pipes", SceneLabel.POLE, pipes),
    ]
    if masts:
        posts = tuple(
            Part(Cylinder((x, side * 2.75, 0.0), (x, side * 2.75, 2.5), 0.05), "galvanised")
            for x in MASTS_M
            for side in (1, -1)
        )
        objects.append(SceneObject("sprinkler masts", SceneLabel.POLE, posts))
    objects += rehearse_target(target, distance_m)
    light = DiffuseLight(zenith_rgb=(0.75, 0.75, 0.73), gradient=0.0, cloud_contrast=0.0, ground_albedo=0.16)
    return Scene("thi-hall", tuple(objects), light)
