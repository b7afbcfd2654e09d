"""The faintest echo of a particle that a chain can detect: what is fainter need not be drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from torch import Tensor

from torchweather.lidar.doppler import RadialSpeed
from torchweather.lidar.stages import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.lidar.state import LidarState
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["particle_gain", "through_stages"]

LOOK_AT_DETECTED = (ToEnergy, Extinction, ParticleReturns, Detection, RadialSpeed, ToPoints)
SIGNAL_OVER_THRESHOLD = {"returns.signal", "receiver.threshold", "receiver.threshold_scale"}
MARGIN = 1e-4  # of the faintest signal, for rounding


def through_stages(
    chain: Chain, state: LidarState, noise: Mapping[str, Tensor], gain: float | None = None
) -> LidarState:
    """The state after the stages of a chain; particles that the sensor cannot detect are not drawn.

    Args:
        chain: its stages.
        state, noise: as of ``Chain.forward``.
        gain: as ``particle_gain``, where stages that are not in this chain come after it; ``None`` is that of its own.
    """
    stages = list(chain.stages.items())
    for number, (name, stage) in enumerate(stages):
        own = chain.noise_of(name, noise)
        if isinstance(stage, ParticleReturns) and not is_exporting():
            most = particle_gain(one for _, one in stages[number + 1 :]) if gain is None else gain
            least = None if math.isinf(most) else state.detected_from.detach().min() * ((1.0 - MARGIN) / most)
            state = stage(state, own, faintest=least)
        else:
            state = stage(state, own)
    return state


def particle_gain(stages: Iterable[Stage]) -> float:
    """Largest factor by which stages up to the detection may raise a particle's signal over the threshold; at least 1.

    Infinite where one of them does not say so: an effect that changes signals says it by a method ``particle_gain``.

    Example:
        >>> import torchweather as tw
        >>> brighter = {"effect": "lidar.particle_backscatter", "gain_db": 3.0}
        >>> chain = tw.LidarRain(tw.Rain(10.0), tw.Lidar.preset("velodyne-hdl-64e"), effects=[brighter]).chain
        >>> round(particle_gain(list(chain.stages.values())[3:]), 3)
        1.995
    """
    gain = 1.0
    for stage in stages:
        own = getattr(stage, "particle_gain", None)
        if type(stage) is Detection:
            return gain
        if own is not None:
            gain *= max(1.0, own())
            continue
        if type(stage) in LOOK_AT_DETECTED:
            continue
        if not isinstance(stage, Effect) or not stage.writes or SIGNAL_OVER_THRESHOLD & set(stage.writes):
            return math.inf
    return math.inf  # not detected here
