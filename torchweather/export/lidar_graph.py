"""LiDAR transform as a function of tensors: points, directions, intensities and noise in; points and kind out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.core.errors import InputValueError
from torchweather.export.metadata import described, sections_of
from torchweather.export.traceable import (
    TRACED_BATCH,
    GraphForm,
    PointGraph,
    Traceable,
    intensity_inputs,
    refuse_what_follows_rain,
    without_samples,
)
from torchweather.lidar.stages import Extinction, ParticleReturns
from torchweather.lidar.transform import LidarWeather

__all__ = ["LIDAR_FORM", "traceable_lidar"]

SECTION = "5"  # of docs/PHYSICS.md
UNITS = {
    "points": "x, y, z in m (x forward, y left, z up), intensity in the sensor's unit, further columns carried along"
}
OUTPUTS = ("cloud", "kind", "second", "second_kind")


def traceable_lidar(transform: LidarWeather, points: int, columns: int, directions: bool | None) -> Traceable:
    """Parts of a LiDAR transform that the exporter needs.

    Args:
        transform: whose lost points stay rows and whose clouds are not completed; anything else is refused.
        points: of the traced cloud.
        columns: of every cloud.
        directions: whether the graph takes the direction of every row; ``None``: if the transform's sensor has them.
    """
    if transform.lost == "drop":
        raise InputValueError(
            f'to_onnx: {type(transform).__name__}(lost="drop") gives as many points as are left, a number that no '
            'graph can have as a size. Export lost="zero" or "nan" and leave out the rows whose kind is 2.'
        )
    if transform.complete_scan:
        raise InputValueError(
            f"to_onnx: {type(transform).__name__}(complete_scan=True) appends as many beams as a cloud lacks, a "
            "number that no graph can have as a size. Give the graph an organised cloud and its directions "
            "(directions=True)."
        )
    if transform.own_vehicle is not None:
        raise InputValueError(
            f"to_onnx: {type(transform).__name__}(own_vehicle=...) names rows of each cloud, which the graph does not "
            "do. Build it without, and put the own vehicle's rows back behind the graph."
        )
    if directions is None:
        directions = transform.sensor.directions is not None
    graph = _LidarGraph(_Weathered(_for_any_cloud(transform)), transform.chain, _intensities(transform))
    batch, count = torch.export.Dim("batch", min=1), torch.export.Dim("points", min=1)
    device = next(transform.buffers()).device
    generator = torch.Generator().manual_seed(0)
    cloud = torch.rand(TRACED_BATCH, points, columns, generator=generator).to(device)
    along = [torch.nn.functional.normalize(cloud[0, :, :3], dim=-1)] if directions else []
    # Where beams without return end takes a search of the whole sweep: the graph is told.
    ways = [cloud[..., 0].clone()] if directions and transform.beam_ends == "scene" else []
    intensities, noise, intensity_shapes, noise_shapes = graph.example(points, batch, count, device)
    shapes: tuple[Any, ...] = (
        {0: batch, 1: count},
        [{0: count} for _ in along],
        [{0: batch, 1: count} for _ in ways],
        intensity_shapes,
        noise_shapes,
    )
    inputs = ["points", *(["directions"] if along else []), *(["reach_m"] if ways else [])]
    inputs += [*graph.intensities, *graph.variates]
    outputs = list(OUTPUTS if transform.sensor.return_mode == "dual" else OUTPUTS[:2])
    arguments, sections = (cloud, along, ways, intensities, noise), (SECTION, *sections_of(transform.weather))
    return Traceable(
        graph, arguments, shapes, inputs, outputs, graph.variates, described(transform), sections, units=UNITS
    )


LIDAR_FORM = GraphForm(
    lambda transform, sizes: traceable_lidar(transform, sizes.points, sizes.columns, sizes.directions),
    fewest_columns=4,
)


class _LidarGraph(PointGraph):
    """A LiDAR transform as a function of tensors only."""

    def forward(
        self,
        points: Tensor,
        directions: list[Tensor],
        ways: list[Tensor],
        intensities: list[Tensor],
        noise: list[Tensor],
    ) -> tuple[Tensor, ...]:
        along, way = (given[0] if given else None for given in (directions, ways))
        return self.called((points, along, way), intensities, noise)


class _Weathered(nn.Module):
    """The tensors of ``LidarWeather.run`` that a graph gives."""

    def __init__(self, transform: LidarWeather) -> None:
        super().__init__()
        self.transform = transform

    def forward(
        self, points: Tensor, directions: Tensor | None, reach_m: Tensor | None, noise: dict[str, Tensor]
    ) -> tuple[Tensor, ...]:
        result = self.transform.run(points, noise, directions=directions, reach_m=reach_m)
        found = (result.points, result.kind, result.second, result.second_kind)
        return tuple(tensor for tensor in found if isinstance(tensor, Tensor))


def _for_any_cloud(transform: LidarWeather) -> LidarWeather:
    """The transform without what fits one cloud alone: directions, number of columns, an intensity for each sample."""
    refuse_what_follows_rain(transform)
    fits_any = without_samples(transform)
    fits_any.sensor = replace(transform.sensor, directions=None, columns=None)
    return fits_any


def _intensities(transform: LidarWeather) -> dict[str, list[str]]:
    """Graph input name to the names of the buffers of the chain that it sets."""
    found: dict[str, list[str]] = {}
    inputs = intensity_inputs(transform.weather.parts)
    for name, stage in transform.chain.stages.items():
        if isinstance(stage, (Extinction, ParticleReturns)):
            for part in transform.weather.parts:
                found.setdefault(inputs[part.kind], []).append(
                    f"_stages.{name}.parts.{part.kind}.{part.intensity_name}"
                )
    return found
