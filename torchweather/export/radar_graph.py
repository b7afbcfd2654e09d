"""Radar transform as a function of tensors: detections, intensities and noise in; detections and their kind out."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from torchweather.core.errors import InputValueError
from torchweather.export.metadata import described, described_sensor, sections_of
from torchweather.export.traceable import (
    TRACED_BATCH,
    GraphForm,
    PointGraph,
    Traceable,
    intensity_inputs,
    refuse_what_follows_rain,
    without_samples,
)
from torchweather.radar import RangeDopplerMap
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.clutter import VolumeClutter
from torchweather.radar.transform import RadarAttenuation

__all__ = ["MAP_FORM", "RADAR_FORM", "traceable_map", "traceable_radar"]

SECTIONS, MAP_SECTION = "6.2, 6.5-6.8", "6.4"  # of docs/PHYSICS.md
UNITS = {
    "points": "x, y, z in m, radial speed in m/s, power in dB, cross section in dBsm, further columns carried along"
}
OUTPUTS = ("detections", "kind", "snr_db", "attenuation_db")
MAP_INPUTS, MAP_OUTPUTS = ("real", "imaginary"), ("map_real", "map_imaginary", "power_dbm")


def traceable_radar(transform: RadarAttenuation, points: int, columns: int) -> Traceable:
    """Parts of a radar transform that the exporter needs.

    Args:
        transform: whose lost detections stay rows; anything else is refused.
        points: of the traced list.
        columns: of every list.
    """
    if transform.lost == "drop":
        raise InputValueError(
            f'to_onnx: {type(transform).__name__}(lost="drop") gives as many detections as are left, a number that '
            'no graph can have as a size. Export lost="zero" or "nan" and leave out the rows whose kind is 2.'
        )
    refuse_what_follows_rain(transform)
    graph = _RadarGraph(_Weathered(without_samples(transform)), transform.chain, _intensities(transform))
    batch, count = torch.export.Dim("batch", min=1), torch.export.Dim("points", min=1)
    device = next(transform.buffers()).device
    generator = torch.Generator().manual_seed(0)
    detections = torch.rand(TRACED_BATCH, points, columns, generator=generator).to(device)
    intensities, noise, intensity_shapes, noise_shapes = graph.example(points, batch, count, device)
    shapes: tuple[Any, ...] = ({0: batch, 1: count}, intensity_shapes, noise_shapes)
    inputs = ["points", *graph.intensities, *graph.variates]
    arguments, sections = (detections, intensities, noise), (SECTIONS, *sections_of(transform.weather))
    return Traceable(
        graph, arguments, shapes, inputs, list(OUTPUTS), graph.variates, described(transform), sections, units=UNITS
    )


def traceable_map(transform: RangeDopplerMap) -> Traceable:
    """Parts of a range-Doppler map that the exporter needs."""
    radar = transform.radar
    size = (TRACED_BATCH, radar.virtual_channels, radar.chirps, radar.samples)
    device = next(transform.buffers()).device
    generator = torch.Generator().manual_seed(0)
    parts = [torch.rand(size, generator=generator).to(device) for _ in MAP_INPUTS]
    batch = torch.export.Dim("batch", min=1)
    own, shapes = described_sensor(type(transform).__name__, radar), ({0: batch}, {0: batch})
    return Traceable(transform, tuple(parts), shapes, list(MAP_INPUTS), list(MAP_OUTPUTS), {}, own, (MAP_SECTION,))


RADAR_FORM = GraphForm(
    lambda transform, sizes: traceable_radar(transform, sizes.points, sizes.columns), fewest_columns=6
)
MAP_FORM = GraphForm(lambda transform, sizes: traceable_map(transform))


class _RadarGraph(PointGraph):
    """A radar transform as a function of tensors only."""

    def forward(self, points: Tensor, intensities: list[Tensor], noise: list[Tensor]) -> tuple[Tensor, ...]:
        return self.called((points,), intensities, noise)


class _Weathered(nn.Module):
    """The tensors of ``RadarAttenuation.run`` that a graph gives."""

    def __init__(self, transform: RadarAttenuation) -> None:
        super().__init__()
        self.transform = transform

    def forward(self, points: Tensor, noise: dict[str, Tensor]) -> tuple[Tensor, ...]:
        result = self.transform.run(points, noise)
        found = (result.points, result.kind, result.snr_db, result.attenuation_db)
        return tuple(tensor for tensor in found if isinstance(tensor, Tensor))


def _intensities(transform: RadarAttenuation) -> dict[str, list[str]]:
    """Graph input name to the names of the buffers of the chain that it sets."""
    inputs = intensity_inputs(transform.weather.parts)
    found: dict[str, list[str]] = {name: [] for name in inputs.values()}
    for name, stage in transform.chain.stages.items():
        if isinstance(stage, PathAttenuation):
            for part in transform.weather.parts:
                found[inputs[part.kind]].append(f"_stages.{name}.parts.{part.kind}.{part.intensity_name}")
        elif isinstance(stage, WetRadome) and "rain" in inputs:
            found[inputs["rain"]].append(f"_stages.{name}.rate_mm_per_h")
        elif isinstance(stage, VolumeClutter):
            found[inputs[stage.falling.weather.kind]].append(f"_stages.{name}.falling.rate_mm_per_h")
    return found
