"""Water on a road, as the stages of all sensors take it: its depth, the road's texture, how unevenly it lies."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import GROUND_VARIATE
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_between
from torchweather.core.random import Variate
from torchweather.physics.road_water import TEXTURE_MM
from torchweather.pipeline.stage import Stage

__all__ = ["RoadWater"]


class RoadWater(Stage):
    """Base of the stages of water on the road.

    Args:
        water_mm: mean depth, 0 to 10 mm, a number or one for each sample.
        texture_mm: mean texture depth of the road.
        log_std: spread of the logarithm of the depth over the road, 0 to 2.
    """

    default_name: ClassVar[str] = "road_water"
    of_the_air: ClassVar[bool] = True
    water_mm: Tensor

    def __init__(self, water_mm: Any, texture_mm: float = 0.7, log_std: float = 0.0) -> None:
        check_arguments(f"{type(self).__name__}(texture_mm: float, log_std: float)", texture_mm, log_std)
        super().__init__()
        self.register_buffer("water_mm", torch.as_tensor(water_mm, dtype=torch.float32).reshape(-1))
        check_between("water_mm", self.water_mm, 0.0, 10.0, unit="mm", owner=self)
        check_between("texture_mm", texture_mm, *TEXTURE_MM, unit="mm", owner=self)
        check_between("log_std", log_std, 0.0, 2.0, owner=self)
        self.texture_mm, self.log_std = float(texture_mm), float(log_std)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"water_mm": self.water_mm.tolist(), "texture_mm": self.texture_mm, "log_std": self.log_std}

    def variates(self) -> tuple[Variate, ...]:
        """Where the water lies deeper; none where it is even."""
        return (GROUND_VARIATE,) if self.log_std else ()
