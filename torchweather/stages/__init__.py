"""Stages, the chains they form, and the states that pass through them."""

from torchweather.stages.camera import ExtinctionAndAirlight, Quantise
from torchweather.stages.chain import Chain
from torchweather.stages.lidar import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.stages.particle_veil import ParticleVeil
from torchweather.stages.registry import STAGES, register
from torchweather.stages.stage import Stage
from torchweather.stages.states import CameraState, LidarState, PointKind

__all__ = [
    "STAGES",
    "CameraState",
    "Chain",
    "Detection",
    "Extinction",
    "ExtinctionAndAirlight",
    "LidarState",
    "ParticleReturns",
    "ParticleVeil",
    "PointKind",
    "Quantise",
    "Stage",
    "ToEnergy",
    "ToPoints",
    "register",
]
