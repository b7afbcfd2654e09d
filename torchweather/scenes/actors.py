"""Cars, people, bicycles, trees and boards, put together from simple shapes."""

from __future__ import annotations

import math
import random as python_random
from collections.abc import Callable

from torchweather.scenes.lighting import SlabShade, SphereShade
from torchweather.scenes.materials import Material, board
from torchweather.scenes.primitives import Box, Capsule, Cylinder, Ellipsoid, FacetMesh, Foliage, Point
from torchweather.scenes.scene import Part, SceneLabel, SceneObject

__all__ = ["board_on_stand", "car", "cyclist", "pedestrian", "pole", "tree"]

CAR_LENGTH_M, CAR_WIDTH_M, CAR_HEIGHT_M = 4.30, 1.80, 1.47  # a compact car (C segment), rounded


def _placed(at: tuple[float, float], yaw_rad: float) -> Callable[[float, float, float], Point]:
    """Vehicle coordinates of a point given in an object's own frame (x to its front, y left, z up)."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)

    def place(x: float, y: float, z: float) -> Point:
        # The turn of a half circle is meant exactly: rounding would tilt faces by 1e-16.
        return (at[0] + round(cos, 12) * x - round(sin, 12) * y, at[1] + round(sin, 12) * x + round(cos, 12) * y, z)

    return place


# Outline of the lower body seen from the side, from the rear underside over the tail, belt line and bonnet to the
# front underside: x, z, half width. x = 0 is the rearmost point, x = CAR_LENGTH_M the foremost.
BODY_OUTLINE: tuple[Point, ...] = (
    (0.14, 0.22, 0.80),
    (0.00, 0.40, 0.88),
    (0.00, 0.62, 0.90),
    (0.07, 0.80, 0.90),
    (0.16, 0.99, 0.84),
    (1.60, 0.97, 0.88),
    (3.05, 0.93, 0.84),
    (3.75, 0.85, 0.82),
    (4.12, 0.75, 0.80),
    (4.27, 0.62, 0.84),
    (4.30, 0.45, 0.84),
    (4.20, 0.22, 0.78),
)
# The cabin as two frustums: x rear, x front, z, half width of each level.
CABIN_LEVELS = ((0.18, 3.10, 0.96, 0.83), (0.50, 2.38, 1.38, 0.66), (0.80, 2.05, 1.47, 0.56))


def _strip(points: tuple[Point, ...], place: Callable[[float, float, float], Point]) -> FacetMesh:
    """A body with this outline: skin across the width and both flanks."""
    count = len(points)
    vertices = [place(x, side * half, z) for side in (1, -1) for x, z, half in points]
    triangles = []
    for k in range(count):
        after = (k + 1) % count
        triangles += [(k, after, count + k), (after, count + after, count + k)]
    for first in (0, count):
        triangles += [(first, first + k, first + k + 1) for k in range(1, count - 1)]
    return FacetMesh(tuple(vertices), tuple(triangles))


def _quads(
    corners: list[tuple[Point, Point, Point, Point]], place: Callable[[float, float, float], Point]
) -> FacetMesh:
    """Quadrilaterals, each given by its corners in order."""
    vertices = tuple(place(*corner) for quad in corners for corner in quad)
    first = [4 * k for k in range(len(corners))]
    return FacetMesh(vertices, tuple(t for f in first for t in ((f, f + 1, f + 2), (f, f + 2, f + 3))))


def _between(low: Point, high: Point, share: float) -> Point:
    return tuple(a + share * (b - a) for a, b in zip(low, high, strict=True))  # type: ignore[return-value]


def _pane(
    quad: tuple[Point, Point, Point, Point], inset: tuple[float, float, float, float], lift: Point
) -> tuple[Point, Point, Point, Point]:
    """A window in a quad (lower a, lower b, upper b, upper a): shares cut off at a, b, below, above; lifted off it."""
    lower_a, lower_b, upper_b, upper_a = quad
    from_a, from_b, below, above = inset

    def point(across: float, up: float) -> Point:
        at = _between(_between(lower_a, lower_b, across), _between(upper_a, upper_b, across), up)
        return (at[0] + lift[0], at[1] + lift[1], at[2] + lift[2])

    return (point(from_a, below), point(1 - from_b, below), point(1 - from_b, 1 - above), point(from_a, 1 - above))


def car(name: str, rear_m: tuple[float, float], yaw_rad: float = 0.0, paint: str = "paint_red") -> SceneObject:
    """A compact hatchback of 4.30 x 1.80 x 1.47 m.

    Args:
        name: of the object.
        rear_m: x, y on the ground below the middle of its rearmost edge.
        yaw_rad: heading; 0 drives along x and shows its rear.
        paint: name of a material.

    Returns:
        The car; its rear bumper is a flat face at its own x = 0, its front one ends at x = 4.30 m.
    """
    place = _placed(rear_m, yaw_rad)
    body = _strip(BODY_OUTLINE, place)
    lower, middle, upper = CABIN_LEVELS

    def side_quads(low: tuple[float, ...], high: tuple[float, ...]) -> list[tuple[Point, Point, Point, Point]]:
        """Rear, front, left, right of one frustum, each (lower a, lower b, upper b, upper a)."""
        (r0, f0, z0, w0), (r1, f1, z1, w1) = low, high
        return [
            ((r0, w0, z0), (r0, -w0, z0), (r1, -w1, z1), (r1, w1, z1)),
            ((f0, -w0, z0), (f0, w0, z0), (f1, w1, z1), (f1, -w1, z1)),
            ((f0, w0, z0), (r0, w0, z0), (r1, w1, z1), (f1, w1, z1)),
            ((r0, -w0, z0), (f0, -w0, z0), (f1, -w1, z1), (r1, -w1, z1)),
        ]

    x0, x1, z_top, half = upper
    roof = ((x0, half, z_top), (x1, half, z_top), (x1, -half, z_top), (x0, -half, z_top))
    cabin = _quads([*side_quads(lower, middle), *side_quads(middle, upper), roof], place)
    rear, front, left, right = side_quads(lower, middle)
    off = 0.008  # panes stand this far off the body so that they are hit first
    panes = [
        _pane(rear, (0.07, 0.07, 0.14, 0.06), (-off, 0.0, off)),
        _pane(front, (0.05, 0.05, 0.10, 0.03), (off, 0.0, off)),
        _pane(left, (0.09, 0.58, 0.10, 0.10), (0.0, off, off)),
        _pane(left, (0.45, 0.13, 0.10, 0.10), (0.0, off, off)),
        _pane(right, (0.58, 0.09, 0.10, 0.10), (0.0, -off, off)),
        _pane(right, (0.13, 0.45, 0.10, 0.10), (0.0, -off, off)),
    ]

    def box(x: float, y: float, z: float, size: Point) -> Box:
        return Box(place(x, y, z), size, yaw_rad)

    parts = [Part(body, paint), Part(cabin, paint), Part(_quads(panes, place), "glass")]
    parts += [
        Part(box(0.09, 0.0, 0.34, (0.17, 1.30, 0.14)), "black_plastic"),
        Part(box(4.20, 0.0, 0.36, (0.19, 1.20, 0.16)), "black_plastic"),
        Part(box(4.235, 0.0, 0.55, (0.13, 0.90, 0.08)), "black_plastic"),
        Part(box(0.035, 0.0, 0.56, (0.07, 0.52, 0.115)), "number_plate"),
        Part(box(4.265, 0.0, 0.44, (0.07, 0.52, 0.115)), "number_plate"),
    ]
    for side in (1, -1):
        parts += [
            Part(box(0.10, side * 0.74, 0.79, (0.14, 0.27, 0.17)), "tail_light"),
            Part(box(4.17, side * 0.68, 0.67, (0.16, 0.30, 0.12)), "head_light"),
            Part(box(2.72, side * 0.97, 1.03, (0.12, 0.19, 0.13)), paint),
        ]
        for axle in (0.80, 3.42):
            outer, inner = place(axle, side * 0.905, 0.31), place(axle, side * 0.68, 0.31)
            parts += [
                Part(Cylinder(place(axle, side * 0.70, 0.33), place(axle, side * 0.895, 0.33), 0.36), "black_plastic"),
                Part(Cylinder(inner, outer, 0.31), "tyre"),
                Part(Cylinder(inner, place(axle, side * 0.915, 0.31), 0.20), "rim"),
            ]
    middle_of_car = place(CAR_LENGTH_M / 2, 0.0, 0.24)
    shade = SlabShade(middle_of_car, (CAR_LENGTH_M - 0.3, CAR_WIDTH_M - 0.1), yaw_rad)
    body_shade = SlabShade((middle_of_car[0], middle_of_car[1], 0.9), (CAR_LENGTH_M - 0.4, CAR_WIDTH_M - 0.2), yaw_rad)
    return SceneObject(name, SceneLabel.CAR, tuple(parts), (shade, body_shade))


def pedestrian(
    name: str, at_m: tuple[float, float], yaw_rad: float = 0.0, jacket: str = "jacket_orange", height_m: float = 1.75
) -> SceneObject:
    """A walking adult.

    Args:
        name: of the object.
        at_m: x, y of where they stand.
        yaw_rad: walking direction.
        jacket: name of a material.
        height_m: height; all proportions follow.
    """
    turned = _placed(at_m, yaw_rad)
    scale = height_m / 1.75

    def place(x: float, y: float, z: float) -> Point:
        return turned(x * scale, y * scale, z * scale)

    def limb(start: Point, end: Point, radius: float, material: str) -> Part:
        return Part(Capsule(place(*start), place(*end), radius * scale), material)

    def ball(centre: Point, semi_axes: Point, material: str) -> Part:
        return Part(Ellipsoid(place(*centre), tuple(a * scale for a in semi_axes)), material)  # type: ignore[arg-type]

    parts = [
        # Legs in mid-stride: left one forward.
        limb((0.0, 0.09, 0.86), (0.14, 0.09, 0.48), 0.085, "trousers_dark"),
        limb((0.14, 0.09, 0.48), (0.20, 0.09, 0.10), 0.062, "trousers_dark"),
        limb((0.0, -0.09, 0.86), (-0.05, -0.09, 0.47), 0.085, "trousers_dark"),
        limb((-0.05, -0.09, 0.47), (-0.27, -0.09, 0.13), 0.062, "trousers_dark"),
        limb((0.18, 0.09, 0.045), (0.34, 0.09, 0.045), 0.045, "shoes"),
        limb((-0.29, -0.09, 0.07), (-0.16, -0.09, 0.045), 0.045, "shoes"),
        # Jacket: hips, chest, shoulders.
        limb((0.0, 0.055, 0.92), (0.0, 0.07, 1.30), 0.135, jacket),
        limb((0.0, -0.055, 0.92), (0.0, -0.07, 1.30), 0.135, jacket),
        limb((0.0, 0.15, 1.385), (0.0, -0.15, 1.385), 0.085, jacket),
        # Arms swing against the legs.
        limb((0.0, 0.235, 1.37), (-0.10, 0.255, 1.10), 0.056, jacket),
        limb((-0.10, 0.255, 1.10), (-0.06, 0.255, 0.85), 0.046, jacket),
        limb((0.0, -0.235, 1.37), (0.10, -0.255, 1.10), 0.056, jacket),
        limb((0.10, -0.255, 1.10), (0.26, -0.255, 0.92), 0.046, jacket),
        ball((-0.055, 0.255, 0.78), (0.045, 0.035, 0.075), "skin"),
        ball((0.31, -0.255, 0.87), (0.06, 0.035, 0.05), "skin"),
        limb((0.0, 0.0, 1.42), (0.015, 0.0, 1.53), 0.055, "skin"),
        ball((0.02, 0.0, 1.625), (0.094, 0.076, 0.115), "skin"),
        ball((-0.012, 0.0, 1.668), (0.098, 0.088, 0.090), "hair"),
        ball((-0.17, 0.0, 1.17), (0.12, 0.15, 0.22), "bag"),
    ]
    x, y, z = place(0.0, 0.0, 0.9)
    feet = tuple(SphereShade(place(fx, fy, 0.12), 0.13 * scale) for fx, fy in ((0.24, 0.09), (-0.22, -0.09)))
    return SceneObject(name, SceneLabel.PEDESTRIAN, tuple(parts), (SphereShade((x, y, z), 0.42 * scale), *feet))


def cyclist(name: str, at_m: tuple[float, float], yaw_rad: float = 0.0, jacket: str = "jacket_yellow") -> SceneObject:
    """A rider on a bicycle.

    Args:
        name: of the object.
        at_m: x, y on the ground between the wheels.
        yaw_rad: riding direction.
        jacket: name of a material.
    """
    place = _placed(at_m, yaw_rad)

    def tube(start: Point, end: Point, radius: float, material: str) -> Part:
        return Part(Capsule(place(*start), place(*end), radius), material)

    parts: list[Part] = []
    for x in (-0.52, 0.52):
        parts += [
            Part(Cylinder(place(x, -0.022, 0.345), place(x, 0.022, 0.345), 0.345, 0.300), "tyre"),
            tube((x, -0.05, 0.345), (x, 0.05, 0.345), 0.028, "rim"),
        ]
        # Four spokes: enough to be seen as a wheel.
        for angle in (0.4, 0.4 + math.pi / 4, 0.4 + math.pi / 2, 0.4 + 3 * math.pi / 4):
            reach = (0.31 * math.cos(angle), 0.31 * math.sin(angle))
            parts.append(
                tube((x - reach[0], 0.0, 0.345 - reach[1]), (x + reach[0], 0.0, 0.345 + reach[1]), 0.004, "rim")
            )
    crank, seat, head, rear, front = (
        (-0.06, 0.0, 0.30),
        (-0.22, 0.0, 0.84),
        (0.34, 0.0, 0.86),
        (-0.52, 0.0, 0.345),
        (0.52, 0.0, 0.345),
    )
    frame = [
        (crank, seat),
        (crank, head),
        (seat, head),
        (crank, rear),
        (seat, rear),
        (head, front),
        (head, (0.32, 0.0, 1.0)),
    ]
    parts += [tube(start, end, 0.020, "bicycle") for start, end in frame]
    parts += [
        tube((-0.30, 0.0, 0.92), (-0.14, 0.0, 0.92), 0.045, "black_plastic"),
        tube((0.32, -0.26, 1.02), (0.32, 0.26, 1.02), 0.018, "black_plastic"),
        # Rider leaning forward: hips on the saddle, hands on the bar.
        tube((-0.18, 0.055, 1.02), (0.06, 0.075, 1.42), 0.125, jacket),
        tube((-0.18, -0.055, 1.02), (0.06, -0.075, 1.42), 0.125, jacket),
        tube((0.08, 0.15, 1.44), (0.08, -0.15, 1.44), 0.080, jacket),
        tube((0.10, 0.0, 1.50), (0.15, 0.0, 1.58), 0.055, "skin"),
        Part(Ellipsoid(place(0.18, 0.0, 1.66), (0.095, 0.085, 0.115)), "skin"),
        Part(Ellipsoid(place(0.165, 0.0, 1.725), (0.125, 0.105, 0.085)), "helmet"),
    ]
    for side, knee, foot in ((1, (0.17, 0.62), (0.06, 0.16)), (-1, (0.26, 0.86), (-0.10, 0.47))):
        y = side * 0.10
        parts += [
            tube((-0.18, y, 0.96), (knee[0], y, knee[1]), 0.080, "trousers_dark"),
            tube((knee[0], y, knee[1]), (foot[0], y, foot[1] + 0.05), 0.058, "trousers_dark"),
            tube((foot[0] - 0.03, y, foot[1]), (foot[0] + 0.15, y, foot[1]), 0.042, "shoes"),
            tube((0.08, side * 0.21, 1.43), (0.20, side * 0.26, 1.20), 0.050, jacket),
            tube((0.20, side * 0.26, 1.20), (0.32, side * 0.23, 1.05), 0.042, jacket),
            Part(Ellipsoid(place(0.33, side * 0.23, 1.045), (0.05, 0.04, 0.04)), "skin"),
        ]
    x, y, z = place(-0.05, 0.0, 1.1)
    wheels = tuple(SphereShade(place(wx, 0.0, 0.2), 0.16) for wx in (-0.52, 0.52))
    return SceneObject(name, SceneLabel.CYCLIST, tuple(parts), (SphereShade((x, y, z), 0.45), *wheels))


def tree(name: str, at_m: tuple[float, float], height_m: float, seed: int, foliage: str = "foliage") -> SceneObject:
    """A deciduous tree: trunk, boughs and a crown of leafy shells.

    Args:
        name: of the object.
        at_m: x, y of the trunk.
        height_m: total height.
        seed: shape of the crown; the same number grows the same tree.
        foliage: name of a material.
    """
    # A generator of its own: the shape belongs to the tree, no global random state is read or moved.
    dice = python_random.Random(seed)
    x, y = at_m
    crown_radius = 0.30 * height_m
    crown_z = 0.64 * height_m
    trunk_top = (x + dice.uniform(-0.2, 0.2), y + dice.uniform(-0.2, 0.2), crown_z)
    parts = [Part(Capsule((x, y, 0.0), trunk_top, 0.017 * height_m), "bark")]
    fork: Point = (x, y, 0.34 * height_m)
    lobes = 14
    shells: list[Ellipsoid] = []
    gaps: list[float] = []
    for k in range(lobes):
        # Lobes spiral over the crown (golden angle), so that no side stays bare.
        level = (k + 0.5) / lobes * 2 - 1
        ring = math.sqrt(1 - level**2) * crown_radius * 0.72
        angle = k * 2.39996 + dice.uniform(-0.4, 0.4)
        centre = (
            x + ring * math.cos(angle),
            y + ring * math.sin(angle),
            crown_z + level * 0.27 * height_m + dice.uniform(-0.3, 0.3),
        )
        size = crown_radius * dice.uniform(0.36, 0.52)
        axes = (size * dice.uniform(0.9, 1.15), size * dice.uniform(0.9, 1.15), size * 0.85)
        # Sparse twigs around a denser heart: the outline frays instead of ending at a sphere.
        shells += [Ellipsoid(centre, axes), Ellipsoid(centre, (0.84 * axes[0], 0.84 * axes[1], 0.84 * axes[2]))]
        gaps += [0.56, 0.47]
        if k % 5 == 1:
            parts.append(Part(Capsule(fork, centre, 0.006 * height_m), "bark"))
    core = Ellipsoid((x, y, crown_z), (crown_radius * 0.72, crown_radius * 0.72, 0.26 * height_m))
    parts.append(Part(Foliage(tuple(shells), tuple(gaps), leaf_m=0.24), foliage))
    parts.append(Part(Foliage((core,), (0.43,), leaf_m=0.26), "dark_foliage"))
    crown = SphereShade((x, y, crown_z), crown_radius, opacity=0.8)
    return SceneObject(name, SceneLabel.TREE, tuple(parts), (crown, SphereShade((x, y, 0.15), 0.2)))


def board_on_stand(
    name: str,
    at_m: tuple[float, float],
    reflectance: float | Material,
    size_m: float = 1.0,
    lower_edge_m: float = 0.5,
    yaw_rad: float = 0.0,
) -> SceneObject:
    """A square calibration board whose face looks back along x.

    Args:
        name: of the object.
        at_m: x of its face and y of its middle.
        reflectance: diffuse reflectance 0..1, or a material.
        size_m: edge.
        lower_edge_m: height of its lower edge.
        yaw_rad: turn about the vertical.
    """
    place = _placed(at_m, yaw_rad)
    material = reflectance if isinstance(reflectance, Material) else board(reflectance)
    thick = 0.02
    half = size_m / 2
    parts = [Part(Box(place(thick / 2, 0.0, lower_edge_m + half), (thick, size_m, size_m), yaw_rad), material)]
    for side in (1, -1):
        foot, top = place(0.06, side * 0.7 * half, 0.0), place(0.06, side * 0.7 * half, lower_edge_m + 0.8 * size_m)
        parts.append(Part(Cylinder(foot, top, 0.02), "galvanised"))
        parts.append(Part(Box(place(0.06, side * 0.7 * half, 0.02), (0.6, 0.06, 0.04), yaw_rad), "galvanised"))
    x, y, z = place(0.0, 0.0, 0.6 * lower_edge_m + 0.2)
    return SceneObject(name, SceneLabel.BOARD, tuple(parts), (SphereShade((x, y, z), 0.28 * size_m),))


def pole(name: str, at_m: tuple[float, float], height_m: float = 1.05) -> SceneObject:
    """A white delineator post with a black band and a reflector."""
    x, y = at_m
    radius = 0.06
    parts = (
        Part(Cylinder((x, y, 0.0), (x, y, height_m), radius), "white_plastic"),
        Part(Cylinder((x, y, 0.68 * height_m), (x, y, 0.90 * height_m), radius + 0.003), "black_plastic"),
        Part(Box((x - radius, y, 0.79 * height_m), (0.02, 0.05, 0.16), 0.0), "reflector"),
    )
    return SceneObject(name, SceneLabel.POLE, parts, (SphereShade((x, y, 0.1), 0.1),))
