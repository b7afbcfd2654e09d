"""Stages, the chains they form, and the states that pass through them."""

from torchweather.stages.camera import ExtinctionAndAirlight, Quantise
from torchweather.stages.chain import Chain
from torchweather.stages.particle_veil import ParticleVeil
from torchweather.stages.registry import STAGES, register
from torchweather.stages.stage import Stage
from torchweather.stages.states import CameraState

__all__ = ["STAGES", "CameraState", "Chain", "ExtinctionAndAirlight", "ParticleVeil", "Quantise", "Stage", "register"]
