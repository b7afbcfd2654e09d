"""The effects of LiDAR, in the order of the catalogue."""

from __future__ import annotations

from torchweather.lidar.effects.air import (
    LidarBeamDivergence,
    LidarExtinctionScale,
    LidarLimitedExtent,
    LidarNearResponse,
    LidarParticleBackscatter,
    LidarPatchyWeather,
    LidarSectorLoss,
    LidarSpray,
    LidarStaticStructure,
    LidarWetTarget,
    LidarWindowLoss,
)
from torchweather.lidar.effects.receiver import (
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
from torchweather.lidar.effects.road_spray import LidarRoadSpray
from torchweather.lidar.effects.structure import (
    LidarParticleDensityAzimuth,
    LidarParticleDensityElevation,
    LidarParticleSizes,
    LidarSharedParticles,
)
from torchweather.lidar.effects.surfaces import LidarSnowCover
from torchweather.pipeline.effect import EFFECTS, register_effect

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
    "LidarNearResponse",
    "LidarParticleBackscatter",
    "LidarParticleDensityAzimuth",
    "LidarParticleDensityElevation",
    "LidarParticleSizes",
    "LidarPatchyWeather",
    "LidarRangeBias",
    "LidarRangeNoise",
    "LidarRangeStretch",
    "LidarRingGain",
    "LidarRoadSpray",
    "LidarSectorLoss",
    "LidarSharedParticles",
    "LidarSnowCover",
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
    LidarNearResponse,
    LidarSnowCover,
    LidarRoadSpray,
):
    register_effect(_effect)
