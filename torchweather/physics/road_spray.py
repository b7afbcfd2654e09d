r"""Spray behind a vehicle on a wet road: how much water its tyres lift, its drops, and the cloud that they are.

A tyre of width w on water of depth h lifts the share eta of the water that it meets as drops that stay in the air; the
cloud that a row of tyres leaves has, s behind it, t aside of its track and z over the road, the density

    C = M exp(-s / L) exp(-t^2 / (2 b^2)) / (sqrt(2 pi) b) exp(-z / H) / H,  M = rho_w w h eta,

with M the water in the air per metre of road. Spray grows with the speed to the power 2.8, so that eta, which is mass
per water met, goes with ``v^1.8``; at 80 km/h it is taken to be 0.02. Drops are 0.8 mm wide at a Weber number of 2700
and smaller with its square root, so with 1 / v; they fall out over ``L = v H / v_fall``.

References:
    Weir, Strange and Heffley 1978, FHWA-RD-78-76 (the power 2.8; primary text not seen). Drops: laboratory study of the
    spray of a grooved tyre (doctoral thesis, abstract seen: mean near 800 um at We = 2700, falling with We^-1/2). Shape
    and share: order of magnitude; Shearman et al. 1998 and Gaylard and Duncan 2011 measured such clouds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between
from torchweather.physics.fall_speed import rain_fall_speed_m_per_s

__all__ = ["SprayCloud", "spray_cross_section_m2_per_kg", "spray_drop_mm", "spray_length_m", "spray_water_kg_per_m"]

WATER_KG_PER_M3 = 1000.0
SHARE, SHARE_AT_M_PER_S, SHARE_POWER = 0.02, 22.2, 1.8
DROP_MM, DROP_AT_M_PER_S = 0.8, 4.9  # We = 2700 for a groove of 8 mm
LONGEST_M = 200.0
SPEED_M_PER_S, WATER_MM, TYRE_M = (0.0, 60.0), (0.0, 10.0), (0.05, 2.0)
TRACK_M = 1.6  # between the two rows of tyres of a car or lorry
NODES = 10


def spray_water_kg_per_m(speed_m_per_s: float, water_mm: float, tyre_m: float = 0.2) -> float:
    """Water that one row of tyres lifts into the air, kg per metre of road.

    Args:
        speed_m_per_s: of the vehicle, 0 to 60 m/s.
        water_mm: on the road, 0 to 10 mm.
        tyre_m: width of the tyres of a row, 0.05 to 2 m; twins of a lorry have 0.6 m.

    Example:
        >>> round(spray_water_kg_per_m(22.2, 1.0, 0.2), 4)
        0.004
    """
    owner = "spray_water_kg_per_m"
    check_arguments(f"{owner}(speed_m_per_s: float, water_mm: float, tyre_m: float)", speed_m_per_s, water_mm, tyre_m)
    check_between("speed_m_per_s", speed_m_per_s, *SPEED_M_PER_S, unit="m/s", owner=owner)
    check_between("water_mm", water_mm, *WATER_MM, unit="mm", owner=owner)
    check_between("tyre_m", tyre_m, *TYRE_M, unit="m", owner=owner)
    share: float = SHARE * (speed_m_per_s / SHARE_AT_M_PER_S) ** SHARE_POWER
    return WATER_KG_PER_M3 * tyre_m * 1e-3 * water_mm * share


def spray_drop_mm(speed_m_per_s: float) -> float:
    """Sauter diameter of the drops of a spray, mm, 0.05 to 1.

    Args:
        speed_m_per_s: of the vehicle, 0 to 60 m/s.

    Example:
        >>> round(spray_drop_mm(22.2), 2)
        0.18
    """
    check_arguments("spray_drop_mm(speed_m_per_s: float)", speed_m_per_s)
    check_between("speed_m_per_s", speed_m_per_s, *SPEED_M_PER_S, unit="m/s", owner="spray_drop_mm")
    return min(1.0, max(0.05, DROP_MM * DROP_AT_M_PER_S / max(speed_m_per_s, 0.1)))


def spray_length_m(speed_m_per_s: float, drop_mm: float, height_m: float) -> float:
    """Length over which a spray thins out by e: the way of the vehicle while a drop falls from the cloud's height, m.

    Args:
        speed_m_per_s: of the vehicle, 0 to 60 m/s.
        drop_mm: of its drops, 0.02 to 2 mm.
        height_m: of the cloud, 0.1 to 5 m.

    Example:
        >>> round(spray_length_m(22.2, 0.18, 0.8), 1)
        28.2
    """
    owner = "spray_length_m"
    check_arguments(f"{owner}(speed_m_per_s: float, drop_mm: float, height_m: float)", speed_m_per_s, drop_mm, height_m)
    check_between("drop_mm", drop_mm, 0.02, 2.0, unit="mm", owner=owner)
    check_between("height_m", height_m, 0.1, 5.0, unit="m", owner=owner)
    fall = float(rain_fall_speed_m_per_s(torch.tensor(drop_mm, dtype=torch.float64)))
    return min(LONGEST_M, max(1.0, speed_m_per_s * height_m / max(fall, 0.05)))


def spray_cross_section_m2_per_kg(drop_mm: Tensor) -> Tensor:
    """Geometric cross-section of a kilogram of drops, m^2: ``3 / (2 rho_w D)``.

    Args:
        drop_mm: Sauter diameter, any shape.

    Example:
        >>> spray_cross_section_m2_per_kg(torch.tensor(0.2))
        tensor(7.5000)
    """
    check_arguments("spray_cross_section_m2_per_kg(drop_mm: floating)", drop_mm)
    return 1.5e3 / (WATER_KG_PER_M3 * drop_mm)


@dataclass(frozen=True)
class SprayCloud:
    """The cloud behind the two rows of tyres of a vehicle ahead; numbers or tensors that broadcast over places.

    Args:
        water_kg_per_m: M above, of one row.
        distance_m: of the vehicle's rear tyres, ahead of the sensor.
        lateral_m: of its middle, to the left.
        length_m, height_m: L and H above.
        width_m: b above.

    Example:
        >>> cloud = SprayCloud(*(torch.tensor(v) for v in (0.004, 15.0, 0.0, 20.0, 0.8)))
        >>> bool(cloud.density(torch.tensor(14.0), torch.tensor(0.8), torch.tensor(0.3)) > 0)
        True
    """

    water_kg_per_m: Tensor
    distance_m: Tensor
    lateral_m: Tensor
    length_m: Tensor
    height_m: Tensor
    width_m: float = 0.5

    def density(self, x_m: Tensor, y_m: Tensor, z_m: Tensor) -> Tensor:
        """Water in the air, kg/m^3, at places forward, left and over the road."""
        behind = self.distance_m - x_m
        shape = sum(self._across(y_m, side) for side in (-0.5, 0.5))
        along = torch.exp(-behind.clamp_min(0.0) / self.length_m - z_m.clamp_min(0.0) / self.height_m) / self.height_m
        return torch.where((behind >= 0) & (z_m >= 0), self.water_kg_per_m * shape * along, 0.0)

    def _across(self, y_m: Tensor, side: float) -> Tensor:
        aside = (y_m - self.lateral_m - side * TRACK_M) / self.width_m
        return torch.exp(-0.5 * aside.square()) / (math.sqrt(2.0 * math.pi) * self.width_m)

    def column(self, direction: Sequence[Tensor], height_m: Tensor | float, end_m: Tensor) -> Tensor:
        """Water along rays from the sensor, kg/m^2, by Gauss's rule over where each row's cloud is met.

        Args:
            direction: unit vectors: forward, left, up.
            height_m: of the sensor over the road.
            end_m: length of each ray, which may be infinite.
        """
        dx, dy, dz = direction
        reach = self.inside_m(dx, end_m)
        found = torch.zeros_like(reach)
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        slope = torch.where(dy.abs() < 1e-6, 1e-6, dy)
        for side in (-0.5, 0.5):
            middle = self.lateral_m + side * TRACK_M
            edges = [(middle + k * 4.0 * self.width_m) / slope for k in (-1.0, 1.0)]
            low, high = (torch.minimum(*edges).clamp_min(0.0), torch.minimum(torch.maximum(*edges), reach))
            span = (high - low).clamp_min(0.0)
            for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
                t = low + span * (0.5 * (1.0 + node))
                behind, z = self.distance_m - t * dx, (height_m + t * dz).clamp_min(0.0)
                there = self._across(t * dy, side) * torch.exp(-behind / self.length_m - z / self.height_m)
                found = found + (0.5 * weight) * span * there
        return self.water_kg_per_m / self.height_m * found

    def inside_m(self, dx: Tensor, end_m: Tensor) -> Tensor:
        """Length of rays inside the cloud: up to their end, and to the vehicle that makes the spray."""
        to_lead = self.distance_m / dx.clamp_min(1e-6)
        behind = 6.0 * self.length_m  # where e^-6 is left of it
        return torch.minimum(torch.minimum(end_m, torch.where(dx > 0, to_lead, behind)), self.distance_m + behind)
