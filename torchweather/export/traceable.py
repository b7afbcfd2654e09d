"""Traceable: a transform as a function of tensors, with what the exporter must know to write it as a graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.conditions import Condition
from torchweather.atmosphere.weather import Mixture, Weather
from torchweather.core.errors import InputValueError
from torchweather.core.random import Variate, draw_variates
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.sensor_transform import WeatherTransform

__all__ = [
    "TRACED_BATCH",
    "GraphForm",
    "GraphSizes",
    "PointGraph",
    "Traceable",
    "intensity_inputs",
    "variates_of",
    "refuse_what_follows_rain",
    "without_samples",
]

FALLING = ("rain", "snow")
TRACED_BATCH = 2  # the exporter takes a size of 1 for one that never changes


@dataclass(frozen=True)
class Traceable:
    """A module whose arguments and results are tensors, or lists of them.

    Args:
        module: what is traced.
        arguments: to trace it with.
        dynamic_shapes: of the arguments, as ``torch.export`` takes them.
        inputs, outputs: names of the graph's, in order.
        variates: the inputs that are noise, and what fills them.
        described: the transform as plain values, for the graph's properties.
        sections: of docs/PHYSICS.md.
        units: of inputs whose unit depends on the sensor.
        levels: of points that a lower rate needs less of; see ``feed.LEVELS_KEY``.
    """

    module: nn.Module
    arguments: tuple[Any, ...]
    dynamic_shapes: tuple[Any, ...]
    inputs: list[str]
    outputs: list[str]
    variates: Mapping[str, Variate]
    described: Mapping[str, Any]
    sections: Sequence[str]
    units: Mapping[str, str] = field(default_factory=dict)
    levels: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GraphSizes:
    """Sizes and options of a graph; the arguments are those of `to_onnx`."""

    height: int
    width: int
    points: int
    columns: int
    directions: bool | None
    masks: bool


@dataclass(frozen=True)
class GraphForm:
    """Graph of one class of transforms.

    Args:
        trace: transform and sizes to what is traced.
        fewest_columns: of its clouds or lists.
        whole_cells: height and width must be even.
        takes_masks: shares of sky and own vehicle can be inputs.
    """

    trace: Callable[[Any, GraphSizes], Traceable]
    fewest_columns: int = 0
    whole_cells: bool = True
    takes_masks: bool = False


class PointGraph(nn.Module):
    """A transform of clouds or lists as a function of tensors only.

    Args:
        weathered: gives the tensors of the result; holds the transform as ``transform``.
        intensities: input of the graph to the buffers of the chain that it sets.
    """

    def __init__(self, weathered: nn.Module, chain: Chain, intensities: Mapping[str, Sequence[str]]) -> None:
        super().__init__()
        self.weathered, self.variates, self.intensities = weathered, variates_of(chain), intensities

    def called(self, data: Sequence[Any], intensities: Sequence[Tensor], noise: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """The tensors of the result for data, intensities and noise in the order of the graph's inputs."""
        set_to = {
            f"transform.chain.{buffer}": intensity
            for buffers, intensity in zip(self.intensities.values(), intensities, strict=True)
            for buffer in buffers
        }
        named_noise = dict(zip(self.variates, noise, strict=True))
        found: tuple[Tensor, ...] = torch.func.functional_call(self.weathered, set_to, (*data, named_noise))
        return found

    def example(self, points: int, batch: Any, count: Any, device: torch.device) -> tuple[Any, Any, Any, Any]:
        """Intensities and noise to trace with, and the dynamic shapes of both."""
        intensities = [torch.full((TRACED_BATCH,), 50.0, device=device) for _ in self.intensities]
        noise, shapes = [], []
        for key, variate in self.variates.items():
            stage, _, _ = key.partition(".")
            array = draw_variates(range(TRACED_BATCH), stage, [variate], {"N": points})[key]
            noise.append(torch.from_numpy(array).to(device))
            shapes.append({0: batch} | {i + 1: count for i, size in enumerate(variate.shape) if size == "N"})
        return intensities, noise, [{0: batch} for _ in intensities], shapes


def variates_of(chain: Chain) -> dict[str, Variate]:
    """Noise inputs of a graph and what fills them."""
    return {f"{name}.{variate.name}": variate for name, stage in chain.stages.items() for variate in stage.variates()}


T = TypeVar("T", bound=WeatherTransform)


def without_samples(transform: T) -> T:
    """The transform without an intensity for each sample, which would fit one number of samples alone."""
    fits_any, weather = copy(transform), transform.weather
    parts = [replace(part, **{part.intensity_name: 1.0}) for part in weather.parts]  # type: ignore[type-var]
    fits_any.weather = Mixture(*parts, *weather.conditions)
    return fits_any


def refuse_what_follows_rain(transform: WeatherTransform) -> None:
    """Raise where water on things follows from a rain whose rate is an input of the graph.

    Raises:
        InputValueError: it does.
    """
    for one in transform.weather.conditions:
        if isinstance(one, Condition) and one.follows_rain:
            name = type(one).__name__
            raise InputValueError(
                f"{type(transform).__name__}: the rate is an input of the graph, and {name} follows from it when the "
                f"transform is built. Give {name}({one.rain_field}=...), or leave it out of what is exported."
            )


def intensity_inputs(parts: Sequence[Weather]) -> dict[str, str]:
    """Kind of each weather to the name of its intensity as a graph's input; rates of a mixture are told apart."""
    alone = sum(part.kind in FALLING for part in parts) == 1
    return {
        part.kind: part.intensity_name if alone or part.kind not in FALLING else f"{part.kind}_{part.intensity_name}"
        for part in parts
    }
