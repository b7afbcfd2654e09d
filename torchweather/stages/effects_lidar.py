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
from torchweather.stages.effects_lidar_structure import (
    LidarParticleDensityAzimuth,
    LidarParticleDensityElevation,
    LidarParticleSizes,
    LidarSharedParticles,
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
    "LidarParticleDensityAzimuth",
    "LidarParticleDensityElevation",
    "LidarParticleSizes",
    "LidarPatchyWeather",
    "LidarRangeBias",
    "LidarRangeNoise",
    "LidarRangeStretch",
    "LidarRingGain",
    "LidarSectorLoss",
    "LidarSharedParticles",
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
    LidarParticleDensityAzimuth,
    LidarParticleDensityElevation,
    LidarParticleSizes,
    LidarSharedParticles,
):
    register_effect(_effect)
