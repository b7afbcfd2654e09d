"""The faintest echo of a particle that a chain can detect: what is fainter need not be drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from torch import Tensor

from torchweather.lidar.doppler import RadialSpeed
from torchweather.lidar.stages import Detection, Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.lidar.state import LidarState
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["particle_gain", "run_stages", "through_stages"]

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
        gain: as of ``run_stages``.
    """
    return run_stages(list(chain.stages.items()), state, lambda name: chain.noise_of(name, noise), gain)


def run_stages(
    stages: Sequence[tuple[str, Stage]],
    state: LidarState,
    noise_of: Callable[[str], Mapping[str, Tensor]],
    gain: float | None = None,
) -> LidarState:
    """The state after some stages; particles that the sensor cannot detect are not drawn.

    Args:
        stages: with their names, in order.
        state: as of ``Chain.forward``.
        noise_of: random numbers of a stage, by its name.
        gain: as ``particle_gain``, where stages that are not among these come after them; ``None`` is that of these.
    """
    for number, (name, stage) in enumerate(stages):
        own = noise_of(name)
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
