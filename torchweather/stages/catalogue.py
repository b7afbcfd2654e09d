"""The catalogue: importing it registers the effects of every sensor."""

from __future__ import annotations

from torchweather.stages import effects_camera, effects_lidar, effects_radar  # noqa: F401  they register themselves
from torchweather.stages.effects import EFFECTS

__all__ = ["EFFECTS"]
