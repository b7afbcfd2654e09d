"""The effects of cameras, in the order of the catalogue, behind those of LiDAR."""

from __future__ import annotations

from torchweather.camera.effects.air import (
    CameraAerosolGlow,
    CameraAirlightScale,
    CameraExtinctionScale,
    CameraHeightFog,
    CameraPatchyFog,
    CameraWetSurface,
)
from torchweather.camera.effects.optics import (
    CameraAdherentDrops,
    CameraDefocus,
    CameraEgoBlur,
    CameraStrayLight,
    CameraVignetting,
)
from torchweather.camera.effects.particles import (
    CameraParticleCount,
    CameraRollingShutter,
    CameraStreakContrast,
    CameraWindSlant,
)
from torchweather.camera.effects.refraction import CameraRefractingDrops
from torchweather.camera.effects.sensor import (
    CameraExposureGain,
    CameraSaturation,
    CameraSensorNoise,
    CameraToneCurve,
)
from torchweather.camera.effects.spray import CameraRoadSpray
from torchweather.camera.effects.surfaces import CameraSnowCover
from torchweather.lidar.effects.all import EFFECTS
from torchweather.pipeline.effect import register_effect

__all__ = [
    "EFFECTS",
    "CameraAdherentDrops",
    "CameraAerosolGlow",
    "CameraAirlightScale",
    "CameraDefocus",
    "CameraEgoBlur",
    "CameraExposureGain",
    "CameraExtinctionScale",
    "CameraHeightFog",
    "CameraParticleCount",
    "CameraPatchyFog",
    "CameraRefractingDrops",
    "CameraRoadSpray",
    "CameraRollingShutter",
    "CameraSaturation",
    "CameraSensorNoise",
    "CameraSnowCover",
    "CameraStrayLight",
    "CameraStreakContrast",
    "CameraToneCurve",
    "CameraVignetting",
    "CameraWetSurface",
    "CameraWindSlant",
]

for _effect in (
    CameraExposureGain,
    CameraAirlightScale,
    CameraExtinctionScale,
    CameraStrayLight,
    CameraAerosolGlow,
    CameraDefocus,
    CameraEgoBlur,
    CameraAdherentDrops,
    CameraVignetting,
    CameraWindSlant,
    CameraWetSurface,
    CameraSensorNoise,
    CameraToneCurve,
    CameraSaturation,
    CameraPatchyFog,
    CameraHeightFog,
    CameraStreakContrast,
    CameraParticleCount,
    CameraRollingShutter,
    CameraSnowCover,
    CameraRoadSpray,
    CameraRefractingDrops,
):
    register_effect(_effect)
