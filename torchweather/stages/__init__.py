"""Stages, the chains they form, and the states that pass through them."""

from torchweather.camera.exposure import ExposureControl, ExposureMeter
from torchweather.camera.fog import ExtinctionAndAirlight, Quantise
from torchweather.camera.particles.bank_veil import BankVeil
from torchweather.camera.particles.veil import ParticleVeil
from torchweather.camera.state import CameraState
from torchweather.lidar.doppler import RadialSpeed
from torchweather.lidar.effects.empirical import Empirical
from torchweather.lidar.stages import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.lidar.state import LidarState
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect, Parameter, effect_from_dict, register_effect, with_effects
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.registry import STAGES, register
from torchweather.pipeline.stage import Stage
from torchweather.radar.attenuation import PathAttenuation, WetRadome, weather_attenuation_db_per_km
from torchweather.radar.clutter import VolumeClutter
from torchweather.radar.stages import RadarDetection, ToRadarPoints
from torchweather.radar.state import RadarState
from torchweather.stages.catalogue import EFFECTS

__all__ = [
    "EFFECTS",
    "STAGES",
    "BankVeil",
    "CameraState",
    "Chain",
    "Detection",
    "Effect",
    "Empirical",
    "ExposureControl",
    "ExposureMeter",
    "Extinction",
    "ExtinctionAndAirlight",
    "LidarState",
    "Parameter",
    "ParticleReturns",
    "ParticleVeil",
    "PathAttenuation",
    "PointKind",
    "Quantise",
    "RadialSpeed",
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
