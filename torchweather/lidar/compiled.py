"""Compiled path of a LiDAR's beams on the processor: what it covers, and its calls.

Results equal those of torch to rounding: ln and exp by polynomials (2e-7). What stays with torch is in `rendered_by`,
but for the echoes of particles, which compiled loops draw there as well (``returns/compiled_calls.py``). Gradients,
exported graphs, clouds in double precision and devices other than the processor stay with torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.compiled import compiled_path, uses_compiled
from torchweather.core.threads import side_by_side, threads_at_hand
from torchweather.lidar.compiled_calls import MODES
from torchweather.lidar.intensity import LOG_STEP, WHITE
from torchweather.lidar.returns.beam_particles import BeamParticles
from torchweather.lidar.returns.compiled_calls import FEWEST_BEAMS, NO_MAP, NO_ROW, array_of, no_part, part_of
from torchweather.lidar.sensor import CALIBRATION_REFLECTIVITY
from torchweather.lidar.stages import (
    DB,
    LEAST_RAMP,
    NO_RANGE_M2,
    Detection,
    Extinction,
    ParticleReturns,
    ToEnergy,
    ToPoints,
)
from torchweather.lidar.state import LidarState
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.tiling import is_exporting

if TYPE_CHECKING:
    from torchweather.lidar.compiled_beams import Receiver

__all__ = ["covers", "rendered_by", "weathered"]

PLAIN = (ToEnergy, Extinction, ParticleReturns, Detection, ToPoints)

Array = NDArray[np.float32]


def rendered_by(chain: Chain) -> str:
    """Name of the path that weathers clouds on the processor, with the reason where it is torch."""
    path = compiled_path()
    if path != "numba":
        return path
    stages = list(chain.stages.items())
    parts = [part for _, stage in stages if isinstance(stage, ParticleReturns) for part in stage.kinds.values()]
    if any(isinstance(part, BeamParticles) and part.published for part in parts):
        return "torch (variant d3_4)"
    if tuple(type(stage) for _, stage in stages) == PLAIN:
        return path
    other = next((name for name, stage in stages if type(stage) not in PLAIN), "another chain of stages")
    in_banks = any("air.patches" in stage.writes for _, stage in stages)
    return f"torch ({other})" if in_banks else f"torch ({other}), echoes by numba"


def covers(chain: Chain, state: LidarState, noise: Mapping[str, Tensor]) -> bool:
    """True where the compiled path weathers this cloud."""
    if is_exporting() or not uses_compiled() or rendered_by(chain) != "numba":
        return False
    scene, air, receiver = state.scene, state.air, state.receiver
    of_air = (air.density_scale, air.patches, air.path_density, air.beam_density, air.size_factors)
    of_receiver = (receiver.threshold_scale, receiver.extra_divergence_rad, receiver.extra_near_power)
    if any(one is not None for one in (*of_air, *of_receiver)):
        return False
    clouds = (scene.points_in, scene.clear_range_m, air.reach_m)
    if not scene.points_in.numel() or any(one.dtype != torch.float32 for one in clouds):
        return False
    learns = torch.is_grad_enabled()
    used = (*clouds, scene.empty_direction, *noise.values(), *chain.buffers(), *chain.parameters())
    return all(one is None or (one.device.type == "cpu" and not (learns and one.requires_grad)) for one in used)


def weathered(chain: Chain, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
    """The state after the chain; the same on any number of threads.

    Args:
        chain, state: as of `covers`, which holds.
        noise: of the chain, ``(B, ..., N)``.
    """
    from torchweather.lidar.compiled_beams import Cloud, Drawn, Out, weather_beams

    energy, extinguishing, returns, _, to_points = chain.stages.values()
    assert isinstance(energy, ToEnergy)
    assert isinstance(extinguishing, Extinction)
    assert isinstance(returns, ParticleReturns)
    assert isinstance(to_points, ToPoints)
    scene, batch = state.scene, state.batch
    count, reported = scene.points_in.shape[1], to_points.reported
    with torch.no_grad():
        extinction = extinguishing.extinction_per_m(batch).to(scene.points_in.dtype)
        tables = {kind: returns.table_of(kind, extinction) for kind in returns.kinds}
    points, clear_signal = torch.empty_like(scene.points_in), torch.empty(batch, count)
    second = torch.empty_like(points) if reported == 2 else None
    range_m, signal = torch.empty(batch, count, reported), torch.empty(batch, count, reported)
    kind = torch.empty(batch, count, reported, dtype=torch.int8)
    given, direction = array_of(scene.points_in), _map_of(scene.empty_direction)
    clear_m, reach_m, borrowed = (
        _map_of(one) for one in (scene.clear_range_m, state.air.reach_m, scene.borrowed_intensity)
    )
    margin, noises = array_of(noise["to_energy.margin"]), noise.get("to_points.range_noise")
    receiver = _receiver(energy, returns, to_points)
    shares = max(1, min(threads_at_hand(), count // FEWEST_BEAMS))
    edges = [count * share // shares for share in range(shares + 1)]
    zeros = scene.zero_intensity
    tasks = []
    for sample in range(batch):
        out = Out(
            points[sample].numpy(),
            NO_MAP if second is None else second[sample].numpy(),
            *(one[sample].numpy() for one in (clear_signal, range_m, signal, kind)),
        )
        cloud = Cloud(
            given[sample],
            direction[min(sample, len(direction) - 1)] if len(direction) else NO_MAP,
            clear_m[sample],
            reach_m[sample],
            borrowed[sample] if len(borrowed) else NO_ROW,
            np.float32(scene.integral[sample, 0]),
            np.float32(0.0 if zeros is None else zeros[sample, 0]),
            np.float32(extinction[sample]),
        )
        drawn = Drawn(margin[sample], NO_MAP if noises is None else array_of(noises[sample]))
        parts = [
            part_of(
                part,
                returns.beam,
                tables[name].of_sample(sample),
                array_of(noise[f"particle_returns.{name}_arrival"][sample]),
                array_of(noise[f"particle_returns.{name}_place"][sample]),
                float(receiver.threshold),
            )
            for name, part in returns.kinds.items()
        ]
        parts += [no_part()] * (3 - len(parts))
        own = partial(weather_beams, out, cloud, drawn, parts[0], parts[1], parts[2], receiver)
        tasks += [partial(own, first, last) for first, last in pairwise(edges)]
    side_by_side(tasks)
    return state.changed(
        clear_signal=clear_signal,
        range_m=range_m,
        signal=signal,
        kind=kind,
        points=points,
        second=second,
        extinction_per_m=extinction,
        threshold=energy.beam.threshold,
        sensor=energy.sensor,
    )


def _map_of(values: Tensor | None) -> Array:
    return NO_MAP if values is None else array_of(values)


def _receiver(energy: ToEnergy, returns: ParticleReturns, to_points: ToPoints) -> Receiver:
    from torchweather.lidar.compiled_beams import UNITS, Receiver

    beam, sensor = energy.beam, to_points.sensor
    single: dict[str, float | Tensor] = {
        "threshold": beam.threshold,
        "mean_margin": DB * energy.margin_db,
        "near_start_m": beam.near_start_m,
        "near_full_m": beam.near_full_m,
        "near_power": beam.near_power,
        "least_ramp": LEAST_RAMP,
        "full_signal": CALIBRATION_REFLECTIVITY,
        "nearest_m": sensor.near_start_m,
        "apart_m": sensor.echo_separation,
        "white": WHITE.get(sensor.intensity_unit, 0.0),
        "assumed": sensor.assumed_reflectivity,
        "log_step": LOG_STEP,
        "least_range_m2": NO_RANGE_M2,
        "photons_at_threshold": to_points.photons_at_threshold,
        "range_noise_m": to_points.range_noise_m,
        "range_step_m": sensor.range_resolution_m,
    }
    values = {name: np.float32(float(value)) for name, value in single.items()}
    return Receiver(**values, unit=UNITS[sensor.intensity_unit], mode=MODES.index(sensor.return_mode))
