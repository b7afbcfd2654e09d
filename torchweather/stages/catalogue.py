"""The catalogue: importing it registers the effects of every sensor."""

from __future__ import annotations

import torchweather.camera.effects.all
import torchweather.lidar.effects.all
import torchweather.radar.effects.all  # noqa: F401  they register themselves
from torchweather.pipeline.effect import EFFECTS

__all__ = ["EFFECTS"]
