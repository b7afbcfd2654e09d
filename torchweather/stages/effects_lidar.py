"""The effects of LiDAR, in the order of the catalogue."""

from __future__ import annotations

from torchweather.stages.effects import EFFECTS, register_effect
from torchweather.stages.effects_lidar_air import (
    LidarBeamDivergence,
    LidarExtinctionScale,
    LidarLimitedExtent,
    LidarParticleBackscatter,
    LidarPatchyWeather,
    LidarSectorLoss,
    LidarSpray,
    LidarStaticStructure,
    LidarWetTarget,
    LidarWindowLoss,
)
from torchweather.stages.effects_lidar_sensor import (
    LidarBlindZone,
    LidarCrosstalk,
    LidarIntensityCompression,
    LidarIsolatedReturnFilter,
    LidarLastReturn,
    LidarRangeBias,
    LidarRangeNoise,
    LidarRangeStretch,
    LidarRingGain,
    LidarThresholdShift,
)

__all__ = [
    "EFFECTS",
    "LidarBeamDivergence",
    "LidarBlindZone",
    "LidarCrosstalk",
    "LidarExtinctionScale",
    "LidarIntensityCompression",
    "LidarIsolatedReturnFilter",
    "LidarLastReturn",
    "LidarLimitedExtent",
    "LidarParticleBackscatter",
    "LidarPatchyWeather",
    "LidarRangeBias",
    "LidarRangeNoise",
    "LidarRangeStretch",
    "LidarRingGain",
    "LidarSectorLoss",
    "LidarSpray",
    "LidarStaticStructure",
    "LidarThresholdShift",
    "LidarWetTarget",
    "LidarWindowLoss",
]

for _effect in (
    LidarBeamDivergence,
    LidarIsolatedReturnFilter,
    LidarThresholdShift,
    LidarWindowLoss,
    LidarExtinctionScale,
    LidarWetTarget,
    LidarBlindZone,
    LidarRangeNoise,
    LidarRangeBias,
    LidarLimitedExtent,
    LidarLastReturn,
    LidarStaticStructure,
    LidarIntensityCompression,
    LidarRangeStretch,
    LidarCrosstalk,
    LidarParticleBackscatter,
    LidarSectorLoss,
    LidarPatchyWeather,
    LidarSpray,
    LidarRingGain,
):
    register_effect(_effect)
