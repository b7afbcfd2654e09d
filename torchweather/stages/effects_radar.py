"""The effects of radar, in the order of the catalogue."""

from __future__ import annotations

from torchweather.stages.effects import EFFECTS, register_effect
from torchweather.stages.effects_radar_echoes import RadarMultipath, RadarVolumeClutter
from torchweather.stages.effects_radar_path import (
    RadarFluctuation,
    RadarPathLossScale,
    RadarPatternTilt,
    RadarWetRadome,
    RadarWetRcs,
)
from torchweather.stages.effects_radar_receiver import (
    RadarCfarShift,
    RadarDetectionLimit,
    RadarDopplerSpread,
    RadarInterference,
    RadarNoiseFloor,
    RadarRangeMigration,
)

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
):
    register_effect(_effect)
