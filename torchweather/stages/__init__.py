"""Stages, the chains they form, and the states that pass through them."""

from torchweather.stages.camera import ExtinctionAndAirlight, Quantise
from torchweather.stages.catalogue import EFFECTS
from torchweather.stages.chain import Chain
from torchweather.stages.effects import Effect, Parameter, effect_from_dict, register_effect, with_effects
from torchweather.stages.empirical import Empirical
from torchweather.stages.lidar import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.stages.particle_veil import ParticleVeil
from torchweather.stages.path_attenuation import PathAttenuation, WetRadome, weather_attenuation_db_per_km
from torchweather.stages.radar import RadarDetection, ToRadarPoints
from torchweather.stages.registry import STAGES, register
from torchweather.stages.stage import Stage
from torchweather.stages.states import CameraState, LidarState, PointKind, RadarState
from torchweather.stages.volume_clutter import VolumeClutter

__all__ = [
    "EFFECTS",
    "STAGES",
    "CameraState",
    "Chain",
    "Detection",
    "Effect",
    "Empirical",
    "Extinction",
    "ExtinctionAndAirlight",
    "LidarState",
    "Parameter",
    "ParticleReturns",
    "ParticleVeil",
    "PathAttenuation",
    "PointKind",
    "Quantise",
    "RadarDetection",
    "RadarState",
    "Stage",
    "ToEnergy",
    "ToPoints",
    "ToRadarPoints",
    "VolumeClutter",
    "WetRadome",
    "effect_from_dict",
    "register",
    "register_effect",
    "weather_attenuation_db_per_km",
    "with_effects",
]
