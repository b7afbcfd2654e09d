"""The effects of radar, in the order of the catalogue."""

from __future__ import annotations

from torchweather.pipeline.effect import EFFECTS, register_effect
from torchweather.radar.effects.echoes import RadarMultipath, RadarVolumeClutter
from torchweather.radar.effects.path import (
    RadarFluctuation,
    RadarPathLossScale,
    RadarPatternTilt,
    RadarWetRadome,
    RadarWetRcs,
)
from torchweather.radar.effects.receiver import (
    RadarCfarShift,
    RadarDetectionLimit,
    RadarDopplerSpread,
    RadarInterference,
    RadarNoiseFloor,
    RadarRangeMigration,
)
from torchweather.radar.effects.spray import RadarRoadSpray

__all__ = [
    "EFFECTS",
    "RadarCfarShift",
    "RadarDetectionLimit",
    "RadarDopplerSpread",
    "RadarFluctuation",
    "RadarInterference",
    "RadarMultipath",
    "RadarNoiseFloor",
    "RadarPathLossScale",
    "RadarPatternTilt",
    "RadarRangeMigration",
    "RadarRoadSpray",
    "RadarVolumeClutter",
    "RadarWetRadome",
    "RadarWetRcs",
]

for _effect in (
    RadarWetRadome,
    RadarVolumeClutter,
    RadarNoiseFloor,
    RadarCfarShift,
    RadarPathLossScale,
    RadarMultipath,
    RadarDopplerSpread,
    RadarWetRcs,
    RadarInterference,
    RadarRangeMigration,
    RadarPatternTilt,
    RadarFluctuation,
    RadarDetectionLimit,
    RadarRoadSpray,
):
    register_effect(_effect)
