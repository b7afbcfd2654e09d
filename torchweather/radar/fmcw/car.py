"""A passenger car as a radar sees it: a smooth metal skin in facets, and small corners in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, check_finite, check_positive
from torchweather.radar.fmcw.bodies import corner_scatterers, facet_scatterers, gathered
from torchweather.radar.fmcw.scatterers import Scatterers

__all__ = ["CAR_DETAILS", "CarDetail", "car_details", "car_facets", "car_scatterers"]

CAR_LENGTH_M, CAR_WIDTH_M, CAR_HEIGHT_M = 4.30, 1.80, 1.47  # a compact car (C segment), rounded

# Outline of a hatchback of that size, level by level: height, rearmost x, foremost x, half width. Generic; after the
# proportions of C-segment cars.
LEVELS = np.array(
    [
        (0.20, 0.16, 4.16, 0.78),  # underside of the sills
        (0.30, 0.04, 4.26, 0.87),
        (0.40, 0.01, 4.29, 0.89),
        (0.55, 0.00, 4.30, 0.90),  # bumpers, about 1 m of radius from below to above
        (0.70, 0.01, 4.29, 0.90),
        (0.78, 0.04, 4.14, 0.89),
        (0.86, 0.09, 3.75, 0.87),  # bonnet
        (0.95, 0.15, 3.05, 0.84),  # belt line, foot of the windscreen
        (1.10, 0.27, 2.80, 0.77),
        (1.25, 0.42, 2.50, 0.70),
        (1.38, 0.60, 2.23, 0.63),
        (1.47, 0.95, 1.90, 0.52),  # roof
    ]
)
# Plan view: how far the ends fall back from the middle to the corner, in metres. The square is the curve of the bumper
# (radius 0.9^2 / (2 x 0.10) = 4 m), the eighth power its rounded corner. Generic.
END_BOW_M, CORNER_ROUNDING_M = 0.10, 0.14
SIDE_BOW = 0.04  # share of the half width by which the flanks narrow from the middle to the ends. Generic.


@dataclass(frozen=True)
class CarDetail:
    """A small corner in the skin of a car, which sends part of the wave straight back.

    Args:
        name: what it stands for.
        place: as shares of length (0 rear, 1 front), half width (-1 right, 1 left) and height.
        azimuth_deg: of its boresight in the car's frame: 0 looks forward, 90 left, 180 back.
        edge_m: inner edge of the trihedral with the same cross section: 0.03 m is 0.22 m^2 at 77 GHz, 0.04 m 0.7 m^2.
    """

    name: str
    place: tuple[float, float, float]
    azimuth_deg: float
    edge_m: float


def _on_both_sides(name: str, place: tuple[float, float, float], azimuth_deg: float, edge_m: float) -> list[CarDetail]:
    """Given for the left, mirrored to the right."""
    x, y, z = place
    return [
        CarDetail(f"left {name}", place, azimuth_deg, edge_m),
        CarDetail(f"right {name}", (x, -y, z), -azimuth_deg, edge_m),
    ]


CAR_DETAILS: tuple[CarDetail, ...] = (
    # Sizes are generic: a few centimetres, as the recesses of lamps, plates and arches are.
    *_on_both_sides("tail lamp", (0.035, 0.80, 0.57), 165.0, 0.035),
    CarDetail("rear number plate recess", (0.010, 0.10, 0.44), 180.0, 0.030),
    CarDetail("tow eye and exhaust", (0.050, 0.45, 0.16), 180.0, 0.040),
    *_on_both_sides("rear wheel arch, facing back", (0.215, 0.98, 0.27), 125.0, 0.040),
    *_on_both_sides("rear wheel arch, facing forward", (0.155, 0.98, 0.27), 55.0, 0.040),
    *_on_both_sides("front wheel arch, facing back", (0.825, 0.98, 0.27), 125.0, 0.040),
    *_on_both_sides("front wheel arch, facing forward", (0.765, 0.98, 0.27), 55.0, 0.040),
    *_on_both_sides("door mirror, facing back", (0.620, 1.02, 0.69), 180.0, 0.030),
    *_on_both_sides("door handle", (0.450, 0.98, 0.55), 90.0, 0.030),
    *_on_both_sides("head lamp", (0.960, 0.76, 0.45), 15.0, 0.040),
    CarDetail("front number plate recess", (0.995, 0.05, 0.30), 0.0, 0.030),
    CarDetail("grille", (0.990, -0.15, 0.38), 0.0, 0.035),
)


def car_facets(
    length_m: float = CAR_LENGTH_M,
    width_m: float = CAR_WIDTH_M,
    height_m: float = CAR_HEIGHT_M,
    *,
    facet_m: float = 0.03,
) -> Tensor:
    """Closed surface of a hatchback as triangles, counter-clockwise seen from outside.

    Args:
        length_m, width_m, height_m: above 0; a generic outline is stretched to them. Length and width are those of the
            bumper's level; the height is that of the roof above the ground.
        facet_m: spacing of the corners up the body; across the ends twice, along the sides four times that.

    Returns:
        ``(F, 3, 3)`` float64 in the car's frame: x forward from the rearmost point, y left from the middle, z up from
        the ground.

    Note:
        A curved skin returns ``pi R1 R2`` from the spot that faces the radar, if along each curve its facets are
        shorter than that spot, ``sqrt(lambda R / 2)``: at 3.9 mm 4 cm for a radius of 1 m, 9 cm for 4 m. Longer ones
        make the echo flicker with aspect. No wheels, no windows of their own: all of it is skin.

    References:
        PHYSICS.md 6.3.

    Example:
        >>> car = car_facets()
        >>> (car.amax((0, 1)) - car.amin((0, 1))).round(decimals=2)  # 0.2 m of it is air under the sills
        tensor([4.3000, 1.8000, 1.2700], dtype=torch.float64)
    """
    check_arguments(
        "car_facets(length_m: float, width_m: float, height_m: float, facet_m: float)",
        length_m,
        width_m,
        height_m,
        facet_m,
    )
    for name, value in (("length_m", length_m), ("width_m", width_m), ("height_m", height_m), ("facet_m", facet_m)):
        check_positive(name, value, unit="m", owner="car_facets")
        check_between(name, value, 1e-3, 100.0, unit="m", owner="car_facets")
    scale = np.array([length_m / CAR_LENGTH_M, width_m / CAR_WIDTH_M, height_m / CAR_HEIGHT_M])

    outline = PchipInterpolator(LEVELS[:, 0], LEVELS[:, 1:])  # monotone: never beyond the named sizes
    z = _evenly_along(outline, facet_m / scale.max())
    rear, front, half_width = (torch.from_numpy(column.copy()) for column in outline(z).T)
    along = torch.linspace(0.0, 1.0, 2 + int(length_m / (4.0 * facet_m)), dtype=torch.float64)[:, None, None]
    across = torch.linspace(-1.0, 1.0, 2 + int(width_m / (2.0 * facet_m)), dtype=torch.float64)
    across = across[:, None]
    bow = END_BOW_M * across**2 + CORNER_ROUNDING_M * across**8
    x = rear + bow + along * (front - rear - 2.0 * bow)
    y = across * half_width * (1.0 - SIDE_BOW * (2.0 * along - 1.0) ** 2)
    lattice = torch.stack([x, y, torch.from_numpy(z).expand_as(x)], -1) * torch.from_numpy(scale)
    return _skin(lattice)


def car_details(
    length_m: float = CAR_LENGTH_M,
    width_m: float = CAR_WIDTH_M,
    height_m: float = CAR_HEIGHT_M,
    details: tuple[CarDetail, ...] = CAR_DETAILS,
) -> tuple[Tensor, Tensor, Tensor]:
    """Places ``(M, 3)``, boresights ``(M, 3)`` and inner edges ``(M,)`` of the corners, in the car's frame, float64.

    Example:
        >>> place, facing, edge_m = car_details()
        >>> place.shape[0] == len(CAR_DETAILS)
        True
    """
    check_arguments(
        "car_details(length_m: float, width_m: float, height_m: float, details: Sequence)",
        length_m,
        width_m,
        height_m,
        details,
    )
    for name, metres in (("length_m", length_m), ("width_m", width_m), ("height_m", height_m)):
        check_between(name, metres, 0.1, 100.0, unit="m", owner="car_details")
    check_arguments("car_details(details: Sequence[CarDetail])", details)
    size = torch.tensor([length_m, width_m / 2.0, height_m], dtype=torch.float64)
    place = torch.tensor([detail.place for detail in details], dtype=torch.float64).reshape(-1, 3) * size
    azimuth = torch.deg2rad(torch.tensor([detail.azimuth_deg for detail in details], dtype=torch.float64))
    facing = torch.stack([torch.cos(azimuth), torch.sin(azimuth), torch.zeros_like(azimuth)], -1)
    return place, facing, torch.tensor([detail.edge_m for detail in details], dtype=torch.float64)


def car_scatterers(
    rear_m: tuple[float, float],
    wavelength_m: float,
    *,
    yaw_rad: float = 0.0,
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
    radar_height_m: float = 0.5,
    facets_m: Tensor | None = None,
    details: tuple[CarDetail, ...] = CAR_DETAILS,
    reflectivity: float = 1.0,
    cell_m: float | None = 0.15,
) -> Scatterers:
    """A car in the radar's frame: its skin by physical optics and the corners in it.

    Args:
        rear_m: x, y of the middle of its rearmost edge in the radar's frame, metres.
        wavelength_m: above 0.
        yaw_rad: heading; 0 drives away along x and shows its rear.
        velocity_m_per_s: as the radar sees it.
        radar_height_m: of the radar over the ground.
        facets_m: skin in the car's frame, ``(F, 3, 3)``; ``None`` is ``car_facets()``.
        details: corners in the skin; ``()`` for none.
        reflectivity: of the skin, reflected power over incident power, 0-1; 1 is metal.
        cell_m: facets are gathered in cubes of this size (`gathered`); ``None`` keeps each one.

    Returns:
        float64 scatterers: the skin's, then those of the corners that face the radar.

    Note:
        The outline and the corners are generic: a cross section of the right size, of no particular car. From behind
        its mean is near 10.6 dBsm (nine in ten aspects 4-14 dBsm), within the 5-20 dBsm that measurements of passenger
        cars at 76-81 GHz report (unverified here). Bumpers are plastic in truth and let part of the wave through to
        the metal behind. What faces the radar is seen: no part shades another, no echo comes by way of the road.

    References:
        PHYSICS.md 6.3, 6.4. Cross sections of cars: ISO 15622 takes 10 m^2 for its test target (unverified).

    Example:
        >>> car = car_scatterers((28.0, 0.0), 0.0039, velocity_m_per_s=(3.0, 0.0, 0.0))
        >>> bool(car.range_m.min() > 27.9), round(float(car.speed_m_per_s.max()), 2)
        (True, 3.0)
    """
    check_arguments(
        "car_scatterers(rear_m: Sequence[float], wavelength_m: float, yaw_rad: float, "
        "velocity_m_per_s: Sequence[float], radar_height_m: float, facets_m: Tensor | None, "
        "details: Sequence, reflectivity: float, cell_m: float | None)",
        rear_m,
        wavelength_m,
        yaw_rad,
        velocity_m_per_s,
        radar_height_m,
        facets_m,
        details,
        reflectivity,
        cell_m,
    )
    check_finite("rear_m", torch.tensor([float(one) for one in rear_m]), unit="m", owner="car_scatterers")
    check_finite("yaw_rad", yaw_rad, unit="rad", owner="car_scatterers")
    check_finite("radar_height_m", radar_height_m, unit="m", owner="car_scatterers")
    if len(rear_m) != 2 or len(velocity_m_per_s) != 3:
        raise InputValueError(
            f"car_scatterers: rear_m must be (x, y) and velocity_m_per_s (x, y, z); got {rear_m!r} and "
            f"{velocity_m_per_s!r}."
        )
    skin = car_facets() if facets_m is None else facets_m
    check_arguments("car_scatterers(facets_m: floating(F, 3, 3))", skin)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    turn = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], dtype=skin.dtype, device=skin.device)
    at, radar, velocity = (
        torch.tensor([float(one) for one in v], dtype=skin.dtype, device=skin.device)
        for v in ((*rear_m, 0.0), (0.0, 0.0, radar_height_m), velocity_m_per_s)
    )
    seen = facet_scatterers(skin @ turn.T + at, radar, velocity, wavelength_m, reflectivity)
    if cell_m is not None:
        seen = gathered(seen, wavelength_m, cell_m)
    if not details:
        return seen
    place, facing, edge_m = (value.to(skin) for value in car_details(*_size_m(skin), details))
    corners = corner_scatterers(place @ turn.T + at, facing @ turn.T, edge_m, radar, velocity, wavelength_m)
    facing_radar = corners.field_m.abs() > 0
    return seen.joined(
        Scatterers(corners.position_m[facing_radar], corners.speed_m_per_s[facing_radar], corners.field_m[facing_radar])
    )


def _size_m(facets_m: Tensor) -> tuple[float, float, float]:
    """Length, width and height above the ground of a skin in the car's frame."""
    low, high = facets_m.amin((0, 1)), facets_m.amax((0, 1))
    return float(high[0]), float(high[1] - low[1]), float(high[2])


def _evenly_along(outline: PchipInterpolator, spacing_m: float) -> np.ndarray:
    """Heights whose points on the rear and the front outline are no farther apart than the spacing."""
    z = np.linspace(LEVELS[0, 0], LEVELS[-1, 0], 4001)
    rear, front, _ = outline(z).T
    step = np.maximum(np.hypot(np.diff(rear), np.diff(z)), np.hypot(np.diff(front), np.diff(z)))
    way = np.concatenate([[0.0], np.cumsum(step)])
    heights: np.ndarray = np.interp(np.linspace(0.0, way[-1], 1 + math.ceil(way[-1] / spacing_m)), way, z)
    return heights


def _skin(lattice: Tensor) -> Tensor:
    """Triangles over the six sides of a lattice ``(I, J, K, 3)`` of right-handed axes, outward."""
    sides = (
        lattice[0].transpose(0, 1),
        lattice[-1],
        lattice[:, 0],
        lattice[:, -1].transpose(0, 1),
        lattice[:, :, 0].transpose(0, 1),
        lattice[:, :, -1],
    )
    triangles = []
    for side in sides:
        a, b, c, d = side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]
        triangles += [torch.stack(corners, -2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return torch.cat(triangles)
