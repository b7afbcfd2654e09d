"""A radar transform as a function of tensors: detections, knobs and noise in, detections and what befell them out."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Mixture
from torchweather.core.errors import InputValueError
from torchweather.core.random import draw_variates
from torchweather.export.traceable import Traceable, knob_inputs
from torchweather.radar import RangeDopplerMap
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.clutter import VolumeClutter
from torchweather.radar.transform import RadarAttenuation

__all__ = ["traceable_map", "traceable_radar"]

OUTPUTS = ("detections", "kind", "snr_db", "attenuation_db")
MAP_INPUTS, MAP_OUTPUTS = ("real", "imaginary"), ("map_real", "map_imaginary", "power_dbm")
TRACED_BATCH = 2  # the exporter takes a size of 1 for one that never changes


def traceable_radar(transform: RadarAttenuation, points: int, columns: int) -> Traceable:
    """What the exporter needs of a radar transform.

    Args:
        transform: whose lost detections stay rows; anything else is refused.
        points: of the traced list.
        columns: of every list.
    """
    if transform.lost == "drop":
        raise InputValueError(
            f'to_onnx: {type(transform).__name__}(lost="drop") gives as many detections as are left, which no graph '
            'can say beforehand. Export lost="zero" or "nan" and leave out the rows whose kind is 2.'
        )
    graph = _RadarGraph(transform)
    batch, count = torch.export.Dim("batch", min=1), torch.export.Dim("points", min=1)
    device = next(transform.buffers()).device
    generator = torch.Generator().manual_seed(0)
    detections = torch.rand(TRACED_BATCH, points, columns, generator=generator).to(device)
    knobs = [torch.full((TRACED_BATCH,), 50.0, device=device) for _ in graph.knobs]
    noise, noise_shapes = [], []
    for key, variate in graph.variates.items():
        stage, _, _ = key.partition(".")
        array = draw_variates(range(TRACED_BATCH), stage, [variate], {"N": points})[key]
        noise.append(torch.from_numpy(array).to(device))
        noise_shapes.append({0: batch} | {i + 1: count for i, size in enumerate(variate.shape) if size == "N"})
    shapes: tuple[Any, ...] = ({0: batch, 1: count}, [{0: batch} for _ in knobs], noise_shapes)
    inputs = ["points", *graph.knobs, *graph.variates]
    return Traceable(graph, (detections, knobs, noise), shapes, inputs, list(OUTPUTS), graph.variates)


def traceable_map(transform: RangeDopplerMap) -> Traceable:
    """What the exporter needs of a range-Doppler map."""
    radar = transform.radar
    size = (TRACED_BATCH, radar.virtual_channels, radar.chirps, radar.samples)
    device = next(transform.buffers()).device
    generator = torch.Generator().manual_seed(0)
    parts = [torch.rand(size, generator=generator).to(device) for _ in MAP_INPUTS]
    batch = torch.export.Dim("batch", min=1)
    return Traceable(transform, tuple(parts), ({0: batch}, {0: batch}), list(MAP_INPUTS), list(MAP_OUTPUTS), {})


class _RadarGraph(nn.Module):
    """A radar transform as a function of tensors only."""

    def __init__(self, transform: RadarAttenuation) -> None:
        super().__init__()
        self.weathered = _Weathered(_for_any_list(transform))
        self.variates = {
            f"{name}.{variate.name}": variate
            for name, stage in transform.chain.stages.items()
            for variate in stage.variates()
        }
        self.knobs = _knobs(transform)

    def forward(self, points: Tensor, knobs: list[Tensor], noise: list[Tensor]) -> tuple[Tensor, ...]:
        named_noise = dict(zip(self.variates, noise, strict=True))
        named_knobs = {
            f"transform.chain.{buffer}": knob
            for buffers, knob in zip(self.knobs.values(), knobs, strict=True)
            for buffer in buffers
        }
        found: tuple[Tensor, ...] = torch.func.functional_call(self.weathered, named_knobs, (points, named_noise))
        return found


class _Weathered(nn.Module):
    """The tensors of ``RadarAttenuation.run`` that a graph gives."""

    def __init__(self, transform: RadarAttenuation) -> None:
        super().__init__()
        self.transform = transform

    def forward(self, points: Tensor, noise: dict[str, Tensor]) -> tuple[Tensor, ...]:
        result = self.transform.run(points, noise)
        found = (result.points, result.kind, result.snr_db, result.attenuation_db)
        return tuple(tensor for tensor in found if isinstance(tensor, Tensor))


def _for_any_list(transform: RadarAttenuation) -> RadarAttenuation:
    """The transform without a knob for each sample, which would fit one number of samples alone."""
    fits_any = copy.copy(transform)
    parts = transform.weather.parts
    fits_any.weather = Mixture(*(replace(part, **{part.knob_name: 1.0}) for part in parts))  # type: ignore[type-var]
    return fits_any


def _knobs(transform: RadarAttenuation) -> dict[str, list[str]]:
    """Graph input name to the names of the buffers of the chain that it sets."""
    inputs = knob_inputs(transform.weather.parts)
    found: dict[str, list[str]] = {name: [] for name in inputs.values()}
    for name, stage in transform.chain.stages.items():
        if isinstance(stage, PathAttenuation):
            for part in transform.weather.parts:
                found[inputs[part.kind]].append(f"_stages.{name}.parts.{part.kind}.{part.knob_name}")
        elif isinstance(stage, WetRadome) and "rain" in inputs:
            found[inputs["rain"]].append(f"_stages.{name}.rate_mm_per_h")
        elif isinstance(stage, VolumeClutter):
            found[inputs[stage.falling.weather.kind]].append(f"_stages.{name}.falling.rate_mm_per_h")
    return found
