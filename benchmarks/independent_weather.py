"""Streets and weather that owe nothing to the library: to test nets on that were trained with it.

Only numpy is imported. A street is a flat world of billboards with a class and a depth for each pixel. In its weather
each drop or flake nearer than `OBJECTS_TO_M` is an object of its own, moved through the exposure and hidden by what
stands before it; those behind are an extinction. Fog is a layer that thins out with height; its light is tinted and
uneven. Fall speeds, sizes of flakes, light and exposure are not those of the library.

The functions of a LiDAR put snow before its beams likewise: each beam has a Poisson number of flakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
CLASSES = ("sky", "road", "ground", "building", "tree", "car", "person")
SKY, ROAD, GROUND, BUILDING, TREE, CAR, PERSON = range(7)
PLACES = ("country", "town")
CAMERA_HEIGHT_M = 1.4
FOCAL_OVER_WIDTH = 0.75  # 67 degrees wide
OBJECTS_TO_M = 8.0  # a drop of 1 mm beyond covers less than 1/30 of a pixel's width at 320 px
SMALLEST_MM = 0.7  # smaller drops enter by their extinction
STEPS = 6  # places of a particle within an exposure
PALETTE: dict[str, dict[str, Any]] = {
    "country": {
        "ground": [(0.10, 0.16, 0.05), (0.16, 0.15, 0.07)],
        "building": [(0.35, 0.28, 0.22), (0.30, 0.14, 0.10)],
        "sky": [(0.45, 0.55, 0.75), (0.60, 0.62, 0.65)],
        "light": (1.0, 1.0, 1.0),
        "trees": 12,
        "buildings": 4,
    },
    "town": {
        "ground": [(0.20, 0.19, 0.18), (0.26, 0.24, 0.20)],
        "building": [(0.45, 0.43, 0.40), (0.22, 0.24, 0.28), (0.40, 0.34, 0.20)],
        "sky": [(0.70, 0.70, 0.70), (0.50, 0.58, 0.70), (0.75, 0.66, 0.55)],
        "light": (1.06, 1.0, 0.92),
        "trees": 5,
        "buildings": 11,
    },
}


@dataclass(frozen=True)
class Street:
    """A clear street.

    Args:
        light: ``(H, W, 3)`` linear, saturation 1.
        depth_m: ``(H, W)`` along the axis; infinite for the sky.
        classes: ``(H, W)``.
        focal_px, horizon_row: of the camera.
    """

    light: Array
    depth_m: Array
    classes: Array
    focal_px: float
    horizon_row: float

    @property
    def picture(self) -> Array:
        """``(H, W, 3)`` uint8, sRGB."""
        return encoded(self.light)


def encoded(light: Array) -> Array:
    """Linear light as sRGB of 8 bits."""
    light = light.clip(0.0, 1.0)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    found: Array = np.rint(255.0 * curve).astype(np.uint8)
    return found


def noise(draw: np.random.Generator, x: Array, y: Array, size: float) -> Array:
    """Smooth noise of mean 0 at world coordinates."""
    table = draw.normal(size=(64, 64))
    u, v = np.nan_to_num(x / size), np.nan_to_num(y / size)
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = u - i, v - j
    corners = [table[(i + p) % 64, (j + q) % 64] for p in (0, 1) for q in (0, 1)]
    found: Array = (1 - a) * ((1 - b) * corners[0] + b * corners[1]) + a * ((1 - b) * corners[2] + b * corners[3])
    return found


def hue(draw: np.random.Generator) -> Array:
    """Factors on the three colours: brightness by a third, hue by a fifth."""
    found: Array = np.exp(draw.normal(0.0, 0.35) + draw.normal(0.0, 0.2, 3))
    return found


def street(seed: int, place: str, width: int = 320, height: int = 240) -> Street:
    """A street of a place, with cars and people; the same for the same seed."""
    draw = np.random.default_rng([seed, PLACES.index(place)])
    look = PALETTE[place]
    focal, horizon = FOCAL_OVER_WIDTH * width, height * draw.uniform(0.42, 0.52)
    rows, columns = np.mgrid[0:height, 0:width].astype(float)
    down, right = (rows - horizon) / focal, (columns - (width - 1) / 2) / focal
    depth = np.where(down > 1e-3, CAMERA_HEIGHT_M / np.maximum(down, 1e-3), np.inf)
    depth[depth > 400.0] = np.inf
    across = right * np.where(np.isfinite(depth), depth, 0.0)
    half = draw.uniform(3.0, 6.0)
    road = np.abs(across - draw.uniform(-1.5, 1.5)) < half
    classes = np.where(np.isinf(depth), SKY, np.where(road, ROAD, GROUND))
    sky = np.array(look["sky"][draw.integers(len(look["sky"]))]) * draw.uniform(0.6, 1.2)
    ground = np.array(look["ground"][draw.integers(len(look["ground"]))]) * hue(draw)
    light = np.where(road[..., None], draw.uniform(0.06, 0.16), ground)
    grain = 0.25 * noise(draw, across, np.nan_to_num(depth, posinf=0.0), draw.uniform(0.2, 0.8))
    light = light * np.exp(grain)[..., None]
    dash = road & (np.abs(across - draw.uniform(-1, 1)) < 0.08) & (np.nan_to_num(depth, posinf=0.0) % 6.0 < 3.0)
    light[dash] = 0.45
    clouds = 0.15 * noise(draw, columns / width, rows / height, 0.15)
    light = np.where(
        (classes == SKY)[..., None], sky * (np.exp(clouds) * (0.7 + 0.5 * rows / horizon))[..., None], light
    )

    things: list[tuple[float, float, float, float, int]] = []  # depth, place across, width, height, class
    for _ in range(look["buildings"]):
        side = draw.choice([-1, 1])
        things.append(
            (draw.uniform(15, 90), side * draw.uniform(9, 22), draw.uniform(8, 16), draw.uniform(4, 14), BUILDING)
        )
    for _ in range(look["trees"]):
        things.append(
            (
                draw.uniform(8, 80),
                draw.choice([-1, 1]) * draw.uniform(6, 20),
                draw.uniform(2, 6),
                draw.uniform(4, 9),
                TREE,
            )
        )
    for _ in range(draw.integers(2, 6)):
        things.append((draw.uniform(6, 50), draw.uniform(-5, 5), draw.uniform(1.7, 4.2), draw.uniform(1.4, 1.9), CAR))
    for _ in range(draw.integers(2, 6)):
        things.append(
            (draw.uniform(5, 35), draw.uniform(-8, 8), draw.uniform(0.45, 0.7), draw.uniform(1.5, 1.9), PERSON)
        )
    for away, where, wide, tall, kind in sorted(things, reverse=True):
        x, y = right * away - where, CAMERA_HEIGHT_M - down * away  # metres from the middle, and above the ground
        inside = (np.abs(x) < wide / 2) & (y > 0) & (y < tall)
        if kind == TREE:
            crown = (2 * x / wide) ** 2 + ((y - 0.65 * tall) / (0.4 * tall)) ** 2 < 1 + 0.3 * noise(draw, x, y, 0.5)
            inside = crown | ((np.abs(x) < 0.2) & (y > 0) & (y < 0.6 * tall))
        if kind == PERSON:
            inside &= (y < 0.82 * tall) & (np.abs(x) < wide / 2) | (
                (x / 0.13) ** 2 + ((y - 0.9 * tall) / 0.15) ** 2 < 1
            )
        if kind == CAR:
            inside &= (y > 0.15) & ((np.abs(x) < 0.36 * wide) | (y < 0.6 * tall))
        colour = {
            BUILDING: np.array(look["building"][draw.integers(len(look["building"]))]) * hue(draw),
            TREE: np.array([0.05, 0.10, 0.03]) * hue(draw),
            CAR: draw.uniform(0.03, 0.55, 3) * draw.uniform(0.4, 1.2),
            PERSON: draw.uniform(0.03, 0.35, 3),
        }[kind]
        shade = np.exp(0.2 * noise(draw, x, y, {TREE: 0.4, BUILDING: 1.5}.get(kind, 0.5)))
        if kind == BUILDING:
            shade = np.where((x % 2.4 < 1.1) & (y % 3.0 > 1.2), 0.3 * shade, shade)
        if kind == CAR:
            shade = np.where((y > 0.62 * tall) & (np.abs(x) < 0.3 * wide), 0.25 * shade, shade)
        light[inside] = (colour * shade[..., None])[inside]
        depth[inside], classes[inside] = away, kind
    light = (light * np.array(look["light"]) * draw.uniform(0.7, 1.3)).clip(1e-3, 1.0)
    light = (light + draw.normal(0, 0.004, light.shape)).clip(0.0, 1.0)
    return Street(light, depth, classes, focal, horizon)


# ---- weather of a camera -------------------------------------------------------------------------------------------


def in_weather(
    scene: Street, seed: int, *, rain_mm_per_h: float = 0.0, snow_mm_per_h: float = 0.0, fog_m: float = math.inf
) -> Array:
    """The street in weather, ``(H, W, 3)`` uint8.

    Args:
        scene: clear.
        seed: of everything that is drawn: light, speeds, exposure, particles.
        rain_mm_per_h, snow_mm_per_h: rates.
        fog_m: visibility (contrast 5 %) at the ground.
    """
    draw = np.random.default_rng([seed, 77])
    height, width = scene.depth_m.shape
    tint = np.exp(draw.normal(0.0, 0.04, 3))
    grey = draw.uniform(0.25, 0.95)
    light = scene.light.copy()
    rows = np.arange(height)[:, None]
    uneven = np.exp(
        draw.uniform(-0.2, 0.2) * (rows / height - 0.5)
        + 0.1 * np.sin(np.arange(width) / width * 5 + draw.uniform(0, 6))
    )
    air = (grey * tint) * uneven[..., None]
    if math.isfinite(fog_m):
        share = np.exp(-fog_depth(scene, 3.0 / fog_m, draw.uniform(5.0, 120.0)))[..., None]
        light = light * share + air * (1 - share)
    exposure_s, forward, aside = draw.uniform(0.002, 0.012), draw.uniform(0.0, 15.0), draw.uniform(-4.0, 4.0)
    if rain_mm_per_h > 0:
        slope = 4.1 * rain_mm_per_h**-0.21  # Marshall and Palmer 1948, 1/mm
        per_m3 = 8000.0 / slope * math.exp(-slope * SMALLEST_MM)
        sizes = lambda n: SMALLEST_MM + draw.exponential(1 / slope, n)  # noqa: E731
        fall = lambda d: 9.65 - 10.3 * np.exp(-0.6 * d)  # noqa: E731  (Atlas 1973)
        light = behind(light, scene, 1.2e-3 * 0.25 * rain_mm_per_h**0.63, air)
        shine = light[: int(0.6 * height)].mean((0, 1)) * draw.uniform(0.8, 1.6)
        light = with_objects(light, scene, draw, per_m3, sizes, fall, shine, exposure_s, forward, aside)
    if snow_mm_per_h > 0:
        per_m3 = 1400.0 * snow_mm_per_h**0.7
        sizes = lambda n: 1.0 + draw.exponential(1.4, n)  # noqa: E731
        fall = lambda d: 0.9 + 0.1 * d  # noqa: E731
        light = behind(light, scene, 0.010 * snow_mm_per_h**0.9, air)
        shine = air.mean((0, 1)) * draw.uniform(0.7, 1.1)
        light = with_objects(light, scene, draw, per_m3, sizes, fall, shine, exposure_s, forward, aside)
    control = (scene.light.mean() / light.mean()) ** draw.uniform(0.0, 1.0) * math.exp(draw.normal(0, 0.1))
    light = light * control
    return encoded(light + draw.normal(0, 0.006, light.shape))


def fog_depth(scene: Street, extinction_per_m: float, scale_m: float) -> Array:
    """Optical depth of fog whose extinction falls by e over a height, from the camera to each surface."""
    height = scene.depth_m.shape[0]
    rise = -(np.arange(height)[:, None] - scene.horizon_row) / scene.focal_px  # metres up for a metre along the axis
    far = np.where(np.isinf(scene.depth_m), 5e3, scene.depth_m)
    steep = np.where(np.abs(rise) < 1e-6, 1e-6, rise) / scale_m
    found: Array = extinction_per_m * math.exp(-CAMERA_HEIGHT_M / scale_m) * -np.expm1(-steep * far) / steep
    return found


def behind(light: Array, scene: Street, extinction_per_m: float, air: Array) -> Array:
    """What particles beyond the objects take and add."""
    way = np.minimum(np.where(np.isinf(scene.depth_m), 500.0, scene.depth_m), 500.0)
    share = np.exp(-extinction_per_m * np.maximum(way - OBJECTS_TO_M, 0.0))[..., None]
    found: Array = light * share + 0.8 * air * (1 - share)
    return found


def with_objects(
    light: Array,
    scene: Street,
    draw: np.random.Generator,
    per_m3: float,
    sizes: Any,
    fall: Any,
    shine: Array,
    exposure_s: float,
    forward: float,
    aside: float,
) -> Array:
    """Particles before the picture, one by one: each covers pixels along its way, unless a surface hides it."""
    height, width = scene.depth_m.shape
    tan_x, tan_y = 0.55 * width / scene.focal_px, 0.6 * height / scene.focal_px
    volume = 4 * tan_x * tan_y * OBJECTS_TO_M**3 / 3
    number = draw.poisson(per_m3 * volume)
    z = OBJECTS_TO_M * draw.random(number) ** (1 / 3)
    x, y = draw.uniform(-tan_x, tan_x, number) * z, draw.uniform(-tan_y, tan_y, number) * z
    size_mm = sizes(number)
    speed = fall(size_mm)
    cover = np.zeros(height * width)
    for step in range(STEPS):
        t = exposure_s * (step + draw.random(number)) / STEPS
        away = z - forward * t
        there = away > 0.3
        column = scene.focal_px * (x + aside * t) / np.maximum(away, 0.3) + width / 2
        row = scene.focal_px * (y + speed * t) / np.maximum(away, 0.3) + scene.horizon_row
        i, j = np.floor(row).astype(int), np.floor(column).astype(int)
        across_px = size_mm * 1e-3 * scene.focal_px / np.maximum(away, 0.3)
        small = there & (across_px <= 1.5)
        seen = small & (i >= 0) & (i < height) & (j >= 0) & (j < width)
        seen[seen] = away[seen] < scene.depth_m[i[seen], j[seen]]
        np.add.at(cover, i[seen] * width + j[seen], math.pi / 4 * across_px[seen] ** 2 / STEPS)
        margin = across_px / 2 + 1
        near = there & (across_px > 1.5) & (row > -margin) & (row < height + margin) & (column > -margin)
        for k in np.flatnonzero(near & (column < width + margin)):  # disks of several pixels
            r = 0.5 * across_px[k]
            top, left = max(int(row[k] - r), 0), max(int(column[k] - r), 0)
            bottom, right = min(max(int(row[k] + r) + 2, top), height), min(max(int(column[k] + r) + 2, left), width)
            p, q = np.mgrid[min(top, height) : bottom, min(left, width) : right]
            inside = (r + 0.5 - np.hypot(p + 0.5 - row[k], q + 0.5 - column[k])).clip(0, 1)
            inside = inside * (away[k] < scene.depth_m[p, q])
            np.add.at(cover, (p * width + q).ravel(), inside.ravel() / STEPS)
    share = -np.expm1(-cover).reshape(height, width)[..., None]
    found: Array = light * (1 - share) + shine * share
    return found


# ---- weather of a LiDAR --------------------------------------------------------------------------------------------


def snow_on_beams(
    points: Array, directions: Array, seed: int, *, snow_mm_per_h: float, max_range_m: float = 80.0
) -> tuple[Array, Array]:
    """Snow before the beams of a scan.

    Args:
        points: ``(N, 4 or more)`` x, y, z, intensity 0 to 255; zero where there is no return.
        directions: ``(N, 3)`` of the beams.
        seed: of the flakes, and of how bright they are and from where on the receiver sees them.
        snow_mm_per_h: rate.

    Returns:
        The cloud, and ``(N,)`` bool: the return is a flake.
    """
    draw = np.random.default_rng([seed, 78])
    range_m = np.linalg.norm(points[:, :3], axis=1)
    reach = np.where(range_m > 0, range_m, max_range_m)
    blind, fades = draw.uniform(1.0, 4.0), draw.uniform(3.0, 8.0)
    per_m = 0.06 * snow_mm_per_h**0.8
    # Where a flake would be the first that is seen: exponential along the beam beyond the blind zone, seen ever less.
    first = blind + draw.exponential(1 / per_m, len(points))
    seen = (first < reach) & (draw.random(len(points)) < np.exp(-(first - blind) / fades))
    bright = 255 * (draw.gamma(1.5, 0.02 * math.exp(draw.normal(0, 0.4)), len(points)) * (6.0 / first) ** 0.5).clip(
        0.002, 1.0
    )
    out = points.copy()
    out[seen, :3] = directions[seen] * first[seen, None]
    out[seen, 3] = np.floor(bright[seen])
    lost = ~seen & (range_m > 0) & (draw.random(len(points)) < -np.expm1(-0.5 * per_m * (reach / 30.0) ** 2))
    out[lost, :4] = 0.0
    return out, seen
