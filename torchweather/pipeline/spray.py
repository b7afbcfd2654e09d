"""Parameters and cloud that the effects of road spray of all sensors share."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from torchweather.core.random import Variate
from torchweather.physics.road_spray import SprayCloud
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["BILLOWS", "REDNESS", "SPRAY", "cloud_of"]

SPRAY: tuple[Parameter, ...] = (
    Parameter("water_g_per_m", "g/m", 0.0, 5000.0, scale=4.0, identity=0.0),
    Parameter("drop_mm", "mm", 0.02, 2.0, scale=0.1, default=0.2),
    Parameter("distance_m", "m", 2.0, 150.0, scale=10.0, default=15.0),
    Parameter("lateral_m", "m", -20.0, 20.0, scale=1.0, default=0.0),
    Parameter("length_m", "m", 1.0, 200.0, scale=10.0, default=20.0),
    Parameter("height_m", "m", 0.1, 5.0, scale=0.5, default=0.8),
    Parameter("uneven", "1", 0.0, 2.0, scale=0.5, default=0.5),
)
"""Water in the air behind one row of tyres, drops, place and size of the cloud, spread of its density."""
REDNESS = 1.0  # of the billows: those of metres prevail; order of magnitude
BILLOWS = Variate("billows", "uniform", (12, 3))
"""Waves of the density across the line of sight; one cloud for all sensors of a sample."""


def cloud_of(effect: Effect, like: Tensor) -> SprayCloud:
    """The cloud of an effect's parameters, shaped to broadcast over a tensor ``(B, ...)``."""
    names = ("distance_m", "lateral_m", "length_m", "height_m")
    values: dict[str, Any] = {name: effect.value(name, like) for name in names}
    return SprayCloud(water_kg_per_m=1e-3 * effect.value("water_g_per_m", like), **values)
