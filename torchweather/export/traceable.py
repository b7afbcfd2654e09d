"""Traceable: a transform as a function of tensors, with what the exporter must know to write it as a graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import nn

from torchweather.atmosphere.weather import Weather
from torchweather.core.random import Variate

__all__ = ["GraphForm", "GraphSizes", "Traceable", "intensity_inputs"]

FALLING = ("rain", "snow")


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


def intensity_inputs(parts: Sequence[Weather]) -> dict[str, str]:
    """Kind of each weather to the name of its intensity as a graph's input; rates of a mixture are told apart."""
    alone = sum(part.kind in FALLING for part in parts) == 1
    return {
        part.kind: part.intensity_name if alone or part.kind not in FALLING else f"{part.kind}_{part.intensity_name}"
        for part in parts
    }
