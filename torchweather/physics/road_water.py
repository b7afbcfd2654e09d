r"""Water on a road: depth from the rain, and what it does to the light that the road reflects.

The depth of water on a sloping road follows Gallaway's regression on measurements of sprinkled pavements. In metric
units, with the depth counted from the bottom of the texture,

    w = 0.103 T^0.11 L^0.43 I^0.59 / S^0.42

with the mean texture depth T and w in mm, the drainage length L in m, the rain I in mm/h and the slope S in per cent;
Gallaway's film over the tops of the texture is ``w - T``.

References:
    Gallaway, Schiller and Rose 1971, Texas Transportation Institute report 138-5: 3.38e-3 in, ft, in/h and m/m, minus
    T; primary text not seen. Ångström 1925, Geografiska Annaler 7, 323, as in Lekner and Dorf 1988, Appl. Opt. 27,
    1278, eq. 1.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import check_between
from torchweather.physics.float64 import Quantity, to_float64

__all__ = ["damp_share", "drowned_share", "road_water_mm", "wet_albedo"]

GALLAWAY = (0.103, 0.11, 0.43, 0.59, 0.42)  # factor; powers of texture, length, rain and slope
# Ranges within which the law is taken. The measurements had slopes of 0.5 to 8 %, textures of 0.1 to 4 mm, lengths up
# to 15 m and rain up to 140 mm/h.
RAIN_MM_PER_H, TEXTURE_MM, DRAINAGE_M, SLOPE_PERCENT = (0.0, 200.0), (0.1, 5.0), (0.5, 50.0), (0.3, 10.0)
WATER_INDEX = 1.33
DAMP_MM = 0.05  # of water darkens the grains of a surface by 1 - 1/e; order of magnitude


def road_water_mm(
    rain_mm_per_h: Quantity, drainage_m: Quantity = 5.0, slope_percent: Quantity = 2.5, texture_mm: Quantity = 0.7
) -> Tensor:
    """Depth of the water on a road in steady rain, mm, from the bottom of the texture.

    Args:
        rain_mm_per_h: 0 to 200 mm/h.
        drainage_m: way that the water has come along the slope, 0.5 to 50 m.
        slope_percent: 0.3 to 10 %.
        texture_mm: mean texture depth (sand patch), 0.1 to 5 mm.

    Returns:
        Float64 of the broadcast shape; 0 without rain.

    Raises:
        InputValueError: a value outside its range.

    Example:
        >>> road_water_mm(torch.tensor([0.0, 10.0, 50.0])).round(decimals=2)
        tensor([0.0000, 0.5200, 1.3500], dtype=torch.float64)
    """
    owner = "road_water_mm"
    check_broadcast(owner, rain=rain_mm_per_h, drainage=drainage_m, slope=slope_percent, texture=texture_mm)
    rain, length, slope, texture = to_float64(rain_mm_per_h, drainage_m, slope_percent, texture_mm)
    check_between("rain_mm_per_h", rain, *RAIN_MM_PER_H, unit="mm/h", owner=owner)
    check_between("drainage_m", length, *DRAINAGE_M, unit="m", owner=owner)
    check_between("slope_percent", slope, *SLOPE_PERCENT, unit="%", owner=owner)
    check_between("texture_mm", texture, *TEXTURE_MM, unit="mm", owner=owner)
    factor, of_texture, of_length, of_rain, of_slope = GALLAWAY
    falls = rain > 0
    flow = torch.where(falls, rain, 1.0) ** of_rain
    water = factor * texture**of_texture * length**of_length * flow / slope**of_slope
    return torch.where(falls, water, 0.0)


def wet_albedo(dry_albedo: Quantity, refractive_index: Quantity = WATER_INDEX) -> Tensor:
    """Albedo of a rough surface under a film of water: ``a / (a + n^2 (1 - a))``.

    Of the light that a Lambertian surface sends into the film, the share ``1 - 1 / n^2`` is totally reflected and comes
    back to be absorbed.

    Args:
        dry_albedo: 0 to 1.
        refractive_index: n of the liquid, 1 to 2.

    Returns:
        Float64.

    Example:
        >>> round(float(wet_albedo(0.1)), 3)  # asphalt
        0.059
    """
    check_broadcast("wet_albedo", dry_albedo=dry_albedo, refractive_index=refractive_index)
    dry, index = to_float64(dry_albedo, refractive_index)
    check_between("dry_albedo", dry, 0.0, 1.0, owner="wet_albedo")
    check_between("refractive_index", index, 1.0, 2.0, owner="wet_albedo")
    return dry / (dry + index.square() * (1.0 - dry))


def damp_share(water_mm: Tensor) -> Tensor:
    """Share of a surface that is dark with water, 0 to 1: ``1 - exp(-w / 0.05 mm)``, order of magnitude.

    Args:
        water_mm: depth of the water, 0 or more, any shape.

    Example:
        >>> damp_share(torch.tensor([0.0, 0.05, 1.0]))
        tensor([0.0000, 0.6321, 1.0000])
    """
    check_arguments("damp_share(water_mm: floating)", water_mm)
    return -torch.expm1(-water_mm / DAMP_MM)


def drowned_share(water_mm: Tensor, texture_mm: float) -> Tensor:
    """Share of a surface whose texture lies under smooth water, 0 to 1: ``1 - exp(-w / T)``.

    It is that of places of a road whose local texture depths are exponential about the mean T.

    Args:
        water_mm: depth of the water, 0 or more, any shape.
        texture_mm: mean texture depth.

    Example:
        >>> drowned_share(torch.tensor([0.0, 0.7]), 0.7)
        tensor([0.0000, 0.6321])
    """
    check_arguments("drowned_share(water_mm: floating, texture_mm: float)", water_mm, texture_mm)
    check_between("texture_mm", texture_mm, *TEXTURE_MM, unit="mm", owner="drowned_share")
    return -torch.expm1(-water_mm / texture_mm)
