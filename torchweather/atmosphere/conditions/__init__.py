"""Water and snow on things: parts of a weather that are not in the air.

``Mixture(Rain(10), WetRoad(), WetWindow(speed_m_per_s=20))`` is a weather with two conditions. Each sensor translates a
condition into effects of its own (``camera/conditions.py``, ``lidar/conditions.py``, ``radar/conditions.py``).
"""

from __future__ import annotations

from torchweather.atmosphere.conditions.condition import CONDITIONS, Condition, condition_of, rain_of
from torchweather.atmosphere.conditions.road_spray import RoadSpray
from torchweather.atmosphere.conditions.snow_cover import SnowCover
from torchweather.atmosphere.conditions.wet_road import WetRoad
from torchweather.atmosphere.conditions.wet_window import WetWindow

__all__ = ["CONDITIONS", "Condition", "RoadSpray", "SnowCover", "WetRoad", "WetWindow", "condition_of", "rain_of"]
