"""Photons traced one by one through fog, backward from a camera: the slow reference of multiple scattering.

Light may be traced against its direction (Helmholtz reciprocity): a path that leaves the camera along a pixel's ray and
ends on a surface brings that surface's radiance to the pixel. Lengths are optical depths.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import torch

from torchweather.physics import SizeDistribution
from torchweather.physics.phase_function import mie_phase_function_per_sr

Array = npt.NDArray[np.float64]


def scattering_angles(distribution: SizeDistribution, wavelength_nm: float) -> Callable[[Array], Array]:
    """Scattering angle, rad, of uniform numbers: the inverse of the phase function's distribution."""
    angle = np.concatenate([[0.0], np.geomspace(1e-5, math.pi, 2000)]).clip(0.0, math.pi)
    per_sr = mie_phase_function_per_sr(distribution, wavelength_nm, torch.from_numpy(angle)).numpy()
    power = 2.0 * math.pi * np.sin(angle) * per_sr
    below = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(angle))])
    return lambda uniform: np.interp(uniform, below / below[-1], angle)


def turned(direction: Array, angle: Array, azimuth: Array) -> Array:
    """Directions ``(N, 3)`` turned by an angle, about an azimuth around themselves."""
    steep = np.abs(direction[:, 2:]) < 0.9
    aside = np.cross(direction, np.where(steep, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    across = np.cross(direction, aside)
    sideways = aside * np.cos(azimuth)[:, None] + across * np.sin(azimuth)[:, None]
    return direction * np.cos(angle)[:, None] + sideways * np.sin(angle)[:, None]


def ends_on_a_plane(
    optical_depth: float, angles: Callable[[Array], Array], photons: int, seed: int, lost_beyond: float = 3.0
) -> Array:
    """Where paths straight ahead end on a plane, seen from the camera: tangents across and down, ``(N, 2)``.

    NaN where a path comes back behind the camera, or aside by more than ``lost_beyond`` times the plane's distance.
    """
    random = np.random.default_rng(seed)
    place, direction = np.zeros((photons, 3)), np.tile([0.0, 0.0, 1.0], (photons, 1))
    ends, flying = np.full((photons, 2), np.nan), np.arange(photons)
    while len(flying):
        step = random.exponential(size=len(flying))
        ahead = direction[flying, 2]
        left = (optical_depth - place[flying, 2]) / np.where(ahead > 0, ahead, np.nan)
        meets = step >= left  # never where a path goes backward: NaN
        met = flying[meets]
        ends[met] = (place[met, :2] + direction[met, :2] * left[meets, None]) / optical_depth
        flying, step = flying[~meets], step[~meets]
        place[flying] += direction[flying] * step[:, None]
        aside = np.hypot(place[flying, 0], place[flying, 1])
        flying = flying[(place[flying, 2] > 0) & (aside < lost_beyond * optical_depth)]
        turn = angles(random.random(len(flying))), 2.0 * math.pi * random.random(len(flying))
        direction[flying] = turned(direction[flying], *turn)
    return ends


GROUND_Z_M, WALL_X_M, WALL_HALF_WIDTH_M, WALL_TOP_Z_M, STRIPE_M, TOP_Z_M = -1.5, 20.0, 6.0, 4.0, 2.0, 60.0
GROUND, WALL_BRIGHT, WALL_DARK, SKY = 0.1, 0.4, 0.05, 1.0


def wall_radiance(y_m: Array) -> Array:
    """Radiance of the striped wall of `street_radiance`."""
    return np.where(np.floor(y_m / STRIPE_M) % 2 == 0, WALL_BRIGHT, WALL_DARK)


def street_radiance(
    direction: Array,
    extinction_per_m: float,
    angles: Callable[[Array], Array],
    photons: int,
    seed: int,
    *,
    wall: bool = True,
) -> Array:
    """Radiance that a camera 1.5 m above a dark road sees in fog under a bright sky, with a striped wall 20 m ahead.

    Args:
        direction: ``(D, 3)`` forward, left, up; of any length.
        extinction_per_m: of fog up to 60 m above the camera.
        angles: of `scattering_angles`.
        photons: paths for each direction.
        seed: of the paths.
        wall: whether it stands there.
    """
    random = np.random.default_rng(seed)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    heading = np.repeat(unit, photons, 0)
    place, found, flying = np.zeros_like(heading), np.zeros(len(heading)), np.arange(len(heading))
    while len(flying):
        step_m = random.exponential(size=len(flying)) / extinction_per_m
        at, along = place[flying], heading[flying]
        with np.errstate(divide="ignore", invalid="ignore"):
            ground_m = np.where(along[:, 2] < 0, (GROUND_Z_M - at[:, 2]) / along[:, 2], np.inf)
            sky_m = np.where(along[:, 2] > 0, (TOP_Z_M - at[:, 2]) / along[:, 2], np.inf)
            wall_m = (WALL_X_M - at[:, 0]) / along[:, 0]
            y_m, z_m = at[:, 1] + along[:, 1] * wall_m, at[:, 2] + along[:, 2] * wall_m
        inside = wall & (np.abs(y_m) < WALL_HALF_WIDTH_M) & (z_m < WALL_TOP_Z_M) & (z_m > GROUND_Z_M) & (wall_m > 1e-9)
        wall_m = np.where(inside, wall_m, np.inf)
        first_m = np.minimum(np.minimum(ground_m, wall_m), sky_m)
        ended = step_m >= first_m
        radiance = np.where(first_m == sky_m, SKY, np.where(first_m == ground_m, GROUND, wall_radiance(y_m)))
        found[flying[ended]] = radiance[ended]
        flying, step_m = flying[~ended], step_m[~ended]
        place[flying] += heading[flying] * step_m[:, None]
        turn = angles(random.random(len(flying))), 2.0 * math.pi * random.random(len(flying))
        heading[flying] = turned(heading[flying], *turn)
    return found.reshape(len(direction), photons).mean(1)


def lamp_radiance(
    look: Array,
    lamp_m: Array,
    intensity: Callable[[Array], Array],
    extinction_per_m: float,
    angles: Callable[[Array], Array],
    per_sr: Callable[[Array], Array],
    photons: int,
    seed: int,
    *,
    ground_z_m: float = -math.inf,
    size_m: float = 0.0,
    orders: int = 60,
) -> float:
    """Radiance that a camera at the origin sees of a lamp's light in fog, scattered once to ``orders`` times.

    At each scattering of a path traced back from the camera, the lamp's light that reaches it is added.

    Args:
        look: ``(3,)`` of the pixel, forward, left, up.
        lamp_m: ``(3,)`` place of the lamp.
        intensity: of unit directions ``(N, 3)`` from the lamp, cd.
        extinction_per_m: of the fog.
        angles: of `scattering_angles`.
        per_sr: phase function of the cosine.
        photons: paths.
        seed: of the paths.
        ground_z_m: black ground, on which paths end.
        size_m: nearest distance of a scattering from the lamp.
        orders: of scattering.
    """
    random = np.random.default_rng(seed)
    direction = np.tile(look / np.linalg.norm(look), (photons, 1))
    place, total = np.zeros((photons, 3)), 0.0
    reach_m = 20.0 / extinction_per_m + 5.0 * float(np.linalg.norm(lamp_m))
    for _ in range(orders):
        place = place + direction * (random.exponential(size=len(place)) / extinction_per_m)[:, None]
        inside = (np.abs(place) < reach_m).all(1) & (place[:, 2] > ground_z_m)
        place, direction = place[inside], direction[inside]
        if not len(place):
            break
        offset = place - lamp_m
        distance = np.maximum(np.linalg.norm(offset, axis=1), max(size_m, 1e-6))
        unit = offset / distance[:, None]
        arriving = intensity(unit) / distance**2 * np.exp(-extinction_per_m * distance)
        total += float((arriving * per_sr(-(unit * direction).sum(1))).sum()) / photons
        turn = angles(random.random(len(place))), 2.0 * math.pi * random.random(len(place))
        direction = turned(direction, *turn)
    return total


def phase_of_cosine(distribution: SizeDistribution, wavelength_nm: float) -> Callable[[Array], Array]:
    """Phase function, 1/sr, of the cosine of the scattering angle."""
    angle = np.concatenate([[0.0], np.geomspace(1e-4, math.pi, 3000)]).clip(0.0, math.pi)
    per_sr = mie_phase_function_per_sr(distribution, wavelength_nm, torch.from_numpy(angle)).numpy()
    return lambda cosine: np.interp(np.arccos(np.clip(cosine, -1.0, 1.0)), angle, per_sr)


def lidar_orders(
    half_angle_rad: float,
    aperture_m: float,
    extinction_per_m: float,
    angles: Callable[[Array], Array],
    per_sr: Callable[[Array], Array],
    photons: int,
    seed: int,
    edges_m: Array,
) -> Array:
    """Light of a LiDAR's pulse that fog sends back into its view, by order of scattering and range, ``(12, K)``.

    Photons leave a cone; at each scattering the light that goes straight back to the receiver counts where the
    receiver, whose view is the cone, sees the place. Range is half of the way that the light went.
    """
    random = np.random.default_rng(seed)
    off, around = np.sqrt(random.random(photons)) * half_angle_rad, 2.0 * math.pi * random.random(photons)
    direction = np.stack([off * np.cos(around), off * np.sin(around), np.sqrt(1.0 - off**2)], 1)
    place, way, found = np.zeros((photons, 3)), np.zeros(photons), np.zeros((12, len(edges_m) - 1))
    for order in range(len(found)):
        step = random.exponential(size=len(place)) / extinction_per_m
        place, way = place + direction * step[:, None], way + step
        inside = way < 2.0 * edges_m[-1]
        place, direction, way = place[inside], direction[inside], way[inside]
        back_m = np.linalg.norm(place, axis=1)
        lateral = np.hypot(place[:, 0], place[:, 1])
        seen = (place[:, 2] > 0) & (lateral < half_angle_rad * place[:, 2] + 0.5 * aperture_m)
        cosine = -(direction * place).sum(1) / np.maximum(back_m, 1e-9)
        power = np.exp(-extinction_per_m * back_m) / np.maximum(back_m, 1e-3) ** 2 * per_sr(cosine)
        found[order] = np.histogram(0.5 * (way + back_m)[seen], edges_m, weights=power[seen])[0] / photons
        turn = angles(random.random(len(place))), 2.0 * math.pi * random.random(len(place))
        direction = turned(direction, *turn)
    return found


FOG_LIGHT, WALL_STRAIGHT, WALL_BY_FOG = 0, 1, 2


def lidar_wall_echo(
    wall_m: float,
    reflectivity: float,
    half_angle_rad: float,
    aperture_m: float,
    extinction_per_m: float,
    angles: Callable[[Array], Array],
    per_sr: Callable[[Array], Array],
    photons: int,
    seed: int,
) -> tuple[Array, Array, Array]:
    """Light of a LiDAR's pulse from a Lambertian wall in fog and from the fog: kind, delay in metres, power.

    Kinds are ``FOG_LIGHT``, scattered by fog twice or more and never at the wall; ``WALL_STRAIGHT``; and
    ``WALL_BY_FOG``, from the wall and scattered on its way. The delay is half of the way beyond that straight to the
    place (of fog) or the wall and back. Photons and view are those of `lidar_orders`.
    """
    random = np.random.default_rng(seed)
    off, around = np.sqrt(random.random(photons)) * half_angle_rad, 2.0 * math.pi * random.random(photons)
    direction = np.stack([off * np.cos(around), off * np.sin(around), np.sqrt(1.0 - off**2)], 1)
    place, way, weight = np.zeros((photons, 3)), np.zeros(photons), np.full(photons, 1.0 / photons)
    at_wall, orders, found = np.zeros(photons, bool), np.zeros(photons, int), []
    while len(place):
        step = random.exponential(size=len(place)) / extinction_per_m
        toward = direction[:, 2] > 0
        left = np.where(toward, (wall_m - place[:, 2]) / np.where(toward, direction[:, 2], 1.0), np.inf)
        meets = step >= left
        step = np.where(meets, left, step)
        place, way = place + direction * step[:, None], way + step
        back_m = np.linalg.norm(place, axis=1)
        seen = (place[:, 2] > 0) & (np.hypot(*place[:, :2].T) < half_angle_rad * place[:, 2] + 0.5 * aperture_m)
        lambert = reflectivity / math.pi * place[:, 2] / back_m
        kernel = np.where(meets, lambert, per_sr(-(direction * place).sum(1) / back_m))
        power = weight * kernel * np.exp(-extinction_per_m * back_m) / back_m**2
        scattered = at_wall | (orders > 0)  # by the wall or by fog, before this place
        by_fog = np.where(at_wall, WALL_BY_FOG, FOG_LIGHT)
        kind = np.where(meets, np.where(scattered, WALL_BY_FOG, WALL_STRAIGHT), by_fog)
        delay_m = 0.5 * (way + back_m) - np.where(meets | at_wall, wall_m, back_m)
        counts = seen & (meets | scattered)
        found.append(np.stack([kind, delay_m, power])[:, counts])
        # A wall sends on in all directions, a droplet by its phase function.
        up, around = np.sqrt(random.random(len(place))), 2.0 * math.pi * random.random(len(place))
        flat = np.sqrt(1.0 - up**2)
        lambertian = np.stack([flat * np.cos(around), flat * np.sin(around), -up], 1)
        turn = angles(random.random(len(place))), 2.0 * math.pi * random.random(len(place))
        direction = np.where(meets[:, None], lambertian, turned(direction, *turn))
        weight, at_wall, orders = np.where(meets, weight * reflectivity, weight), at_wall | meets, orders + ~meets
        inside = (way < 2.0 * wall_m + 12.0) & (place[:, 2] > 0) & (np.abs(place[:, :2]).max(1) < 2.0 * wall_m)
        place, direction, way, weight = place[inside], direction[inside], way[inside], weight[inside]
        at_wall, orders = at_wall[inside], orders[inside]
    kinds, delays_m, powers = np.concatenate(found, 1)
    return kinds, delays_m, powers
