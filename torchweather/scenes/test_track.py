"""The embedded scene: a two-lane test track under an overcast sky, with targets at known distances."""

from __future__ import annotations

import math
from itertools import pairwise

from torchweather.scenes.actors import board_on_stand, car, cyclist, pedestrian, pole, tree
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.materials import BOARD_REFLECTANCES, MATERIALS
from torchweather.scenes.primitives import Box, GroundPatch, Treeline
from torchweather.scenes.scene import Part, Scene, SceneLabel, SceneObject

__all__ = ["test_track"]

FAR_M = 4000.0  # end of the ground: 0.02 degrees below the true horizon for a camera at 1.5 m
BEHIND_M = -60.0
LANE_M = 3.5
PAINT_WIDTH_M = 0.15
RIGHT_EDGE_M, LEFT_EDGE_M = -2.35, 5.85  # edges of the asphalt; the vehicle drives in the right lane, y = 0


def _stretches(start_m: float, end_m: float) -> list[tuple[float, float]]:
    """A long thing in pieces that double with distance: each has a small bounding sphere for its distance."""
    cuts = [start_m, *(x for x in (-4.0, 0.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0) if start_m < x < end_m), end_m]
    return list(pairwise(cuts))


def _ground() -> list[SceneObject]:
    road = GroundPatch((BEHIND_M, FAR_M), (RIGHT_EDGE_M, LEFT_EDGE_M))
    lawn = GroundPatch((BEHIND_M, FAR_M), (-FAR_M, FAR_M))

    def line(middle_m: float, dash_m: float = 1.0, gap_m: float = 0.0) -> Part:
        across = (middle_m - PAINT_WIDTH_M / 2, middle_m + PAINT_WIDTH_M / 2)
        return Part(GroundPatch((BEHIND_M, FAR_M), across, dash_m=dash_m, gap_m=gap_m), "lane_paint")

    # Dashes of 4 m and gaps of 8 m on the centre line, as on rural roads (generic).
    marking = (line(-LANE_M / 2), line(LANE_M / 2, dash_m=4.0, gap_m=8.0), line(1.5 * LANE_M))
    kerb = tuple(
        Part(Box(((low + high) / 2, y, 0.06), (high - low, 0.15, 0.12)), "concrete")
        for y in (RIGHT_EDGE_M - 0.075, LEFT_EDGE_M + 0.075)
        for low, high in _stretches(BEHIND_M, 256.0)
    )
    return [
        SceneObject("lawn", SceneLabel.GRASS, (Part(lawn, "grass"),)),
        SceneObject("road", SceneLabel.ROAD, (Part(road, "asphalt"),)),
        SceneObject("lane marking", SceneLabel.LANE_MARKING, marking),
        SceneObject("kerb", SceneLabel.KERB, kerb),
    ]


def _guard_rail(y_m: float, start_m: float, end_m: float) -> SceneObject:
    parts = []
    for low, high in _stretches(start_m, end_m):
        middle, length = (low + high) / 2, high - low
        # The two ridges of a W beam and the web between them.
        parts += [Part(Box((middle, y_m, z), (length, 0.05, 0.11)), "galvanised") for z in (0.55, 0.71)]
        parts.append(Part(Box((middle, y_m + 0.03, 0.63), (length, 0.03, 0.30)), "galvanised"))
    posts = [start_m + 4.0 * k for k in range(int((end_m - start_m) / 4.0) + 1)]
    parts += [Part(Box((x, y_m + 0.10, 0.36), (0.06, 0.10, 0.72)), "galvanised") for x in posts]
    return SceneObject("guard rail", SceneLabel.GUARD_RAIL, tuple(parts))


# x, y, height in metres; rows that thin out, none nearer to the road than its crown is wide.
TREES = (
    (19.0, 14.5, 8.6),
    (27.0, 12.0, 7.2),
    (36.0, 15.5, 9.8),
    (47.0, 12.5, 8.4),
    (60.0, 14.0, 10.2),
    (76.0, 12.8, 9.0),
    (95.0, 14.5, 10.6),
    (17.5, -15.5, 9.2),
    (26.0, -14.0, 7.8),
    (34.0, -13.0, 9.4),
    (45.0, -15.0, 8.8),
    (57.0, -12.2, 9.0),
    (73.0, -14.0, 10.4),
    (92.0, -12.6, 9.6),
)


def test_track() -> Scene:
    """A test track: two cars, a pedestrian, a cyclist, calibration boards, road, rail, posts, trees, overcast sky.

    The red car's rear face stands at x = 28 m, the silver oncoming car's foremost edge at x = 56 m. The face of every
    board lies across the road: the five grey ones at x = 21 m, the checker at x = 15 m. The camera looks along x
    from above the origin.

    Returns:
        The scene.

    Example:
        >>> test_track().find("car 28 m").label.name
        'CAR'
    """
    objects = [
        *_ground(),
        car("car 28 m", (28.0, -0.15), paint="paint_red"),
        car("car 56 m", (56.0 + 4.30, LANE_M + 0.1), yaw_rad=math.pi, paint="paint_silver"),
        pedestrian("pedestrian", (12.5, -3.15), yaw_rad=math.pi * 0.60),
        cyclist("cyclist", (17.0, 3.7), yaw_rad=-math.pi * 0.42),
        board_on_stand("board checker", (15.0, 7.0), MATERIALS["checker"]),
        *(
            board_on_stand(f"board {100 * value:.0f} %", (21.0, -6.3 - 1.25 * k), value)
            for k, value in enumerate(BOARD_REFLECTANCES)
        ),
        _guard_rail(8.2, 12.0, 132.0),
        *(pole(f"post right {x:.0f} m", (x, -2.95)) for x in (16.0, 41.0, 66.0, 91.0, 116.0)),
        *(pole(f"post left {x:.0f} m", (x, 6.5)) for x in (22.5, 47.5, 72.5, 97.5)),
        *(
            tree(f"tree {k}", (x, y), height, seed=100 + k, foliage="foliage" if k % 3 else "dark_foliage")
            for k, (x, y, height) in enumerate(TREES)
        ),
        SceneObject(
            "wood",
            SceneLabel.TREE,
            (
                Part(Treeline((230.0, 300.0), (230.0, -300.0)), "distant_wood"),
                Part(Treeline((60.0, 75.0), (235.0, 75.0), (6.0, 12.0)), "distant_wood"),
                Part(Treeline((60.0, -80.0), (235.0, -80.0), (6.0, 12.0)), "distant_wood"),
            ),
        ),
    ]
    return Scene("test-track", tuple(objects), DiffuseLight())


# The scene's name begins as pytest's tests do: neither this module nor the function is one. (An empty dictionary
# rather than False: doctest reads the module's, too.)
__test__: dict[str, str] = {}
test_track.__test__ = False  # type: ignore[attr-defined]
