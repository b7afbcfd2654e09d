"""WetRoad: water on the road."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.condition import Amount, Condition, rain_of, register_condition
from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import InputValueError
from torchweather.core.fields import Range, between
from torchweather.physics.road_water import DRAINAGE_M, RAIN_MM_PER_H, SLOPE_PERCENT, TEXTURE_MM, road_water_mm

__all__ = ["WetRoad", "water_on_road_mm"]


@register_condition
@dataclass(frozen=True)
class WetRoad(Condition):
    """Water on the road: darker asphalt, and a mirror where the texture is drowned.

    Args:
        water_mm: depth of the water from the bottom of the texture, 0 (dry) to 10 mm; ``None`` is what the rain of the
            mixture makes (``physics.road_water_mm``).
        puddles: spread of the logarithm of the depth over the road, 0 (even) to 2.
        texture_mm: mean texture depth of the road, 0.1 to 5 mm.
        drainage_m: way of the water along the slope, 0.5 to 50 m.
        slope_percent: of the road, 0.3 to 10 %.
        albedo: of the dry road, 0.01 to 0.6; asphalt has 0.1.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> [one.kind for one in Mixture(Rain(10), WetRoad()).conditions]
        ['wet-road']
    """

    kind: ClassVar[str] = "wet-road"
    intensity_name: ClassVar[str] = "water_mm"
    rain_field: ClassVar[str] = "water_mm"
    ranges: ClassVar[Mapping[str, Range]] = {
        "water_mm": between(0.0, 10.0, "mm", advice="Aquaplaning begins near 3 mm over the texture."),
        "puddles": between(0.0, 2.0),
        "texture_mm": between(*TEXTURE_MM, "mm"),
        "drainage_m": between(*DRAINAGE_M, "m"),
        "slope_percent": between(*SLOPE_PERCENT, "%"),
        "albedo": between(0.01, 0.6),
    }
    aliases: ClassVar[Mapping[str, str]] = {"water": "water_mm", "texture": "texture_mm"}

    water_mm: Amount | None = None
    puddles: Amount = 0.0
    texture_mm: Amount = 0.7
    drainage_m: Amount = 5.0
    slope_percent: Amount = 2.5
    albedo: Amount = 0.1


def water_on_road_mm(road: WetRoad, weather: Weather) -> Tensor:
    """Mean depth of the water, mm, one value or one for each sample, float64.

    Raises:
        InputValueError: it follows from a rain beyond the law's range.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Rain
        >>> road = WetRoad()
        >>> water_on_road_mm(road, Mixture(Rain(10), road)).round(decimals=2)
        tensor([0.5200], dtype=torch.float64)
    """
    if road.water_mm is not None:
        return torch.tensor([road.water_mm], dtype=torch.float64)
    rate = torch.as_tensor(rain_of(weather, road, "water_mm").intensity, dtype=torch.float64).reshape(-1)
    highest = float(rate.detach().max())
    if highest > RAIN_MM_PER_H[1]:
        raise InputValueError(
            f"WetRoad: the depth of water follows from rain up to {RAIN_MM_PER_H[1]:g} mm/h; got {highest:g}. Give "
            "WetRoad(water_mm=...)."
        )
    return road_water_mm(rate, road.drainage_m, road.slope_percent, road.texture_mm)  # type: ignore[arg-type]
