"""SnowCover: snow on the ground and on objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from torchweather.atmosphere.conditions.condition import Amount, Condition, register_condition
from torchweather.core.fields import Range, between
from torchweather.physics.snow_pack import GRAIN_RADIUS_UM

__all__ = ["SnowCover"]


@register_condition
@dataclass(frozen=True)
class SnowCover(Condition):
    """Snow on the ground and on objects, by its depth and the slope of each surface.

    Args:
        depth_mm: of the snow on level ground, 0 to 1000 mm; 5 mm cover two thirds of a road.
        uneven: spread of the logarithm of the depth over the ground, 0 (even) to 2.
        grain_um: effective radius of the grains, 20 to 2000 um: fresh snow 50 to 100, old snow 500.

    Note:
        It changes how surfaces reflect, not where they are: depth and points stay. A radar does not see it.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture, Snow
        >>> [one.kind for one in Mixture(Snow(1), SnowCover(depth_mm=20)).conditions]
        ['snow-cover']
    """

    kind: ClassVar[str] = "snow-cover"
    intensity_name: ClassVar[str] = "depth_mm"
    ranges: ClassVar[Mapping[str, Range]] = {
        "depth_mm": between(0.0, 1000.0, "mm"),
        "uneven": between(0.0, 2.0),
        "grain_um": between(*GRAIN_RADIUS_UM, "um"),
    }
    aliases: ClassVar[Mapping[str, str]] = {"depth": "depth_mm", "grain": "grain_um"}

    depth_mm: Amount = 0.0
    uneven: Amount = 0.5
    grain_um: Amount = 100.0
