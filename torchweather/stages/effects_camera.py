"""The effects of cameras, in the order of the catalogue, behind those of LiDAR."""

from __future__ import annotations

from torchweather.stages.effects import register_effect
from torchweather.stages.effects_camera_air import (
    CameraAerosolGlow,
    CameraAirlightScale,
    CameraExtinctionScale,
    CameraHeightFog,
    CameraPatchyFog,
    CameraWetSurface,
)
from torchweather.stages.effects_camera_optics import (
    CameraAdherentDrops,
    CameraDefocus,
    CameraEgoBlur,
    CameraStrayLight,
    CameraVignetting,
)
from torchweather.stages.effects_camera_particles import (
    CameraParticleCount,
    CameraRollingShutter,
    CameraStreakContrast,
    CameraWindSlant,
)
from torchweather.stages.effects_camera_sensor import (
    CameraExposureGain,
    CameraSaturation,
    CameraSensorNoise,
    CameraToneCurve,
)
from torchweather.stages.effects_lidar import EFFECTS

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
    "CameraRollingShutter",
    "CameraSaturation",
    "CameraSensorNoise",
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
):
    register_effect(_effect)
