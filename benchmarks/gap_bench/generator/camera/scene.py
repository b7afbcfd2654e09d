"""A street as a pinhole camera sees it: depth, normals, labels and linear colours of every pixel, by casting rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Eye", "FloatArray", "Street", "draw_street", "with_a_moved_car"]

FloatArray = NDArray[np.float64]

HEIGHT_M = 1.5  # of the camera over the road
SKY, ROAD, WALL, CAR, POLE, TREE = 0, 1, 2, 3, 4, 5
SKY_COLOUR = (0.62, 0.66, 0.72)  # linear, overcast


@dataclass(frozen=True)
class Eye:
    """A pinhole camera that looks along the road; x right, y down, z ahead."""

    width: int = 480
    height: int = 360

    @property
    def focal_px(self) -> float:
        """Focal length."""
        return 1.05 * self.width

    @property
    def rays(self) -> tuple[FloatArray, FloatArray]:
        """x and y of each pixel's ray at z = 1, ``(H, W)``."""
        column, row = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return (
            (column - 0.5 * (self.width - 1)) / self.focal_px,
            (row - 0.5 * (self.height - 1)) / self.focal_px,
        )


@dataclass(frozen=True)
class Street:
    """What the camera sees, and from what it was made.

    Args:
        eye: the camera.
        depth_m: ``(H, W)`` along the axis, infinity is sky.
        normal: ``(H, W, 3)``, x ahead, y left, z up; 0 for the sky.
        label: ``(H, W)``.
        colour: ``(H, W, 3)`` linear, 1 is saturation.
        parts: seed and boxes it was drawn from.
    """

    eye: Eye
    depth_m: FloatArray
    normal: FloatArray
    label: NDArray[np.int64]
    colour: FloatArray
    parts: tuple[int, tuple[tuple[float, ...], ...]]

    @property
    def ray_per_depth(self) -> FloatArray:
        """Length of the ray over the depth."""
        x, y = self.eye.rays
        return np.asarray(np.sqrt(1.0 + x**2 + y**2))


def draw_street(rng: np.random.Generator, eye: Eye) -> Street:
    """A street with walls on either side, cars, poles and a tree line at its end."""
    boxes: list[tuple[float, ...]] = []
    for side in (-1.0, 1.0):
        edge = side * rng.uniform(5.5, 8.0)
        ahead = rng.uniform(4.0, 10.0)
        while ahead < 260.0:
            length = rng.uniform(9.0, 22.0)
            height = rng.uniform(3.0, 12.0) if ahead < 150.0 else rng.uniform(2.0, 6.0)
            low, high = sorted((edge, edge + side * 9.0))
            boxes.append((low, high, HEIGHT_M - height, HEIGHT_M, ahead, ahead + length, WALL))
            ahead += length + rng.uniform(0.0, 14.0)
        for place in np.cumsum(rng.uniform(9.0, 22.0, 9)):
            x = side * rng.uniform(3.9, 4.6)
            boxes.append((x - 0.12, x + 0.12, HEIGHT_M - rng.uniform(3.5, 6.0), HEIGHT_M, place, place + 0.24, POLE))
    for _ in range(6):
        x, z = rng.uniform(-3.2, 3.2), rng.uniform(9.0, 70.0)
        boxes.append((x - 0.9, x + 0.9, HEIGHT_M - 1.5, HEIGHT_M, z, z + 4.2, CAR))
    return _cast(eye, int(rng.integers(2**31)), tuple(boxes))


def with_a_moved_car(street: Street, rng: np.random.Generator) -> Street:
    """The same street with a car of the near ones elsewhere."""
    seed, boxes = street.parts
    cars = [place for place, box in enumerate(boxes) if box[6] == CAR]
    near = min(cars, key=lambda place: boxes[place][4])
    changed = list(boxes)
    x, z = rng.uniform(-2.5, 2.5), rng.uniform(8.0, 14.0)
    changed[near] = (x - 0.9, x + 0.9, HEIGHT_M - 1.5, HEIGHT_M, z, z + 4.2, CAR)
    return _cast(street.eye, seed, tuple(changed))


def _cast(eye: Eye, seed: int, boxes: tuple[tuple[float, ...], ...]) -> Street:
    x, y = eye.rays
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(y > 1e-6, HEIGHT_M / np.maximum(y, 1e-6), np.inf)
    depth = np.where(depth > 400.0, np.inf, depth)
    label = np.where(np.isfinite(depth), ROAD, SKY)
    normal = np.zeros((*depth.shape, 3))
    normal[label == ROAD] = (0.0, 0.0, 1.0)
    part = np.zeros(depth.shape, dtype=np.int64)
    for number, (left, right, top, bottom, near, far, kind) in enumerate(boxes, 1):
        hit, axis = _box(x, y, (left, top, near), (right, bottom, far))
        closer = hit < depth
        depth = np.where(closer, hit, depth)
        label = np.where(closer, int(kind), label)
        part = np.where(closer, number, part)
        # Of the vehicle: ahead is z, left is -x, up is -y.
        facing = np.stack([-1.0 * (axis == 2), 1.0 * (axis == 0) * np.sign(x), 1.0 * (axis == 1) * np.sign(y) * -1], -1)
        normal = np.where(closer[..., None], facing, normal)
    return Street(eye, depth, normal, label, _painted(seed, x, y, depth, label, part), (seed, boxes))


def _box(
    x: FloatArray, y: FloatArray, low: tuple[float, ...], high: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Depth at which rays enter a box, infinity where they do not, and the axis of the face."""
    direction = np.stack([x, y, np.ones_like(x)])
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.asarray(low)[:, None, None] / direction
        second = np.asarray(high)[:, None, None] / direction
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    start, end = enter.max(0), leave.min(0)
    return np.where((start < end) & (start > 0.5), start, np.inf), enter.argmax(0)


def _painted(
    seed: int, x: FloatArray, y: FloatArray, depth: FloatArray, label: NDArray[np.int64], part: NDArray[np.int64]
) -> FloatArray:
    """Colours: panels and windows of walls, marks of the road, each in a grain that fades with distance."""
    rng = np.random.default_rng(seed)
    finite = np.where(np.isfinite(depth), depth, 400.0)
    place = np.stack([x * finite, y * finite, finite])
    base = rng.uniform(0.05, 0.4, (part.max() + 2, 1)) * rng.uniform(0.8, 1.2, (part.max() + 2, 3))
    colour = base[part]
    panel = np.floor(place[2] / 1.7) * 7.0 + np.floor(place[1] / 1.3) * 13.0 + np.floor(place[0] / 1.7) * 3.0 + part
    hashed = np.mod(np.sin(panel * 12.9898 + seed % 97) * 43758.5453, 1.0)
    walls = np.isin(label, (WALL, TREE))
    colour = np.where(walls[..., None], colour * (0.35 + 1.3 * hashed[..., None]), colour)
    # The road: a dark grain and bright marks.
    cell = np.floor(place[0] / 0.45) * 5.0 + np.floor(place[2] / 1.1) * 17.0
    grain = np.mod(np.sin(cell * 78.233 + seed % 89) * 43758.5453, 1.0)
    road = 0.07 + 0.06 * grain
    mark = (np.abs(np.abs(place[0]) - 3.4) < 0.12) | ((np.abs(place[0]) < 0.1) & (np.mod(place[2], 6.0) < 3.0))
    road = np.where(mark, 0.5, road)
    colour = np.where((label == ROAD)[..., None], road[..., None] * np.array([1.0, 1.0, 0.95]), colour)
    bright = np.where(label == CAR, 0.15 + 0.6 * (hashed > 0.6), 1.0)
    colour = np.where((label == CAR)[..., None], bright[..., None] * base[part] * 1.4, colour)
    return np.asarray(np.clip(np.where((label == SKY)[..., None], SKY_COLOUR, colour), 0.005, 0.9))
