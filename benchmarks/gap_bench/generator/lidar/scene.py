"""Street scenes of a plane, boxes and upright posts, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Box", "Scene", "draw_scene", "move_a_car"]

FloatArray = NDArray[np.float64]

SENSOR_HEIGHT_M = 1.9
# Nothing stands nearer to the sensor than this, in metres.
CLEARANCE_M = 4.0


@dataclass(frozen=True)
class Box:
    """An upright box turned about the vertical, metres and rad, with a Lambertian reflectivity."""

    kind: str
    x_m: float
    y_m: float
    length_m: float
    width_m: float
    height_m: float
    yaw_rad: float
    reflectivity: float


@dataclass(frozen=True)
class Scene:
    """What stands around the sensor.

    Args:
        boxes: cars, houses, posts, walls; all stand on the ground.
        ground_reflectivity: mean of the ground; patches differ by ``patch_seed``.
        patch_seed: of the ground's patches and of the boxes' texture.
    """

    boxes: tuple[Box, ...]
    ground_reflectivity: float
    patch_seed: int


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    """A draw that is uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_scene(rng: np.random.Generator) -> Scene:
    """A street: two rows of houses, parked cars, posts, a wall across, and open sky between.

    The numbers are those of a town (orders of magnitude): cars 4.4 x 1.8 x 1.5 m, posts 0.15-0.4 m, houses 6-14 m high.
    """
    boxes: list[Box] = []
    heading = rng.uniform(-np.pi, np.pi)

    def stand(kind: str, along: float, aside: float, size: tuple[float, float, float], low: float, high: float) -> None:
        length, width, height = size
        if np.hypot(along, aside) < CLEARANCE_M + 0.5 * np.hypot(length, width):
            return
        cos, sin = np.cos(heading), np.sin(heading)
        boxes.append(
            Box(
                kind,
                float(along * cos - aside * sin),
                float(along * sin + aside * cos),
                length,
                width,
                height,
                float(heading + rng.normal(0.0, 0.05)),
                _spread(rng, low, high),
            )
        )

    for side in (-1.0, 1.0):
        along = -75.0
        while along < 75.0:
            length = rng.uniform(8.0, 18.0)
            if rng.random() < 0.75:
                set_back = rng.uniform(9.0, 22.0)
                size = (float(length), float(rng.uniform(6.0, 10.0)), float(rng.uniform(6.0, 14.0)))
                stand("house", along + 0.5 * length, side * (set_back + 4.0), size, 0.1, 0.7)
            along += length + rng.uniform(1.0, 9.0)
        for _ in range(int(rng.integers(4, 7))):
            place, aside = rng.uniform(-35.0, 35.0), side * rng.uniform(4.5, 6.5)
            stand("car", float(place), float(aside), (4.4, 1.8, float(rng.uniform(1.4, 1.9))), 0.06, 0.6)
        for _ in range(int(rng.integers(5, 9))):
            wide = float(rng.uniform(0.15, 0.4))
            place, aside = rng.uniform(-45.0, 45.0), side * rng.uniform(7.0, 8.5)
            stand("post", float(place), float(aside), (wide, wide, float(rng.uniform(2.5, 8.0))), 0.15, 0.8)
    for end in (-1.0, 1.0):
        if rng.random() < 0.7:
            distance = end * rng.uniform(35.0, 75.0)
            stand("wall", float(distance), float(rng.uniform(-4.0, 4.0)), (1.0, 9.0, 4.0), 0.2, 0.6)
    for _ in range(3):
        stand(
            "car",
            float(rng.uniform(8.0, 40.0) * rng.choice([-1, 1])),
            float(rng.normal(0, 1.5)),
            (4.4, 1.8, 1.5),
            0.1,
            0.5,
        )
    return Scene(tuple(boxes), float(rng.uniform(0.12, 0.25)), int(rng.integers(2**31)))


def move_a_car(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same street with its nearest car parked some metres further on."""
    cars = [box for box in scene.boxes if box.kind == "car"]
    car = min(cars, key=lambda box: np.hypot(box.x_m, box.y_m))
    step = float(rng.uniform(3.0, 5.0) * rng.choice([-1.0, 1.0]))
    moved = replace(car, x_m=car.x_m + step * np.cos(car.yaw_rad), y_m=car.y_m + step * np.sin(car.yaw_rad))
    if np.hypot(moved.x_m, moved.y_m) < CLEARANCE_M + 2.0:
        step = -step
        moved = replace(car, x_m=car.x_m + step * np.cos(car.yaw_rad), y_m=car.y_m + step * np.sin(car.yaw_rad))
    return replace(scene, boxes=tuple(moved if box is car else box for box in scene.boxes))
