"""Traceable: a transform as a function of tensors, with what the exporter must know to write it as a graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import nn

from torchweather.atmosphere.weather import Weather
from torchweather.core.random import Variate

__all__ = ["Traceable", "knob_inputs"]

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
    """

    module: nn.Module
    arguments: tuple[Any, ...]
    dynamic_shapes: tuple[Any, ...]
    inputs: list[str]
    outputs: list[str]
    variates: Mapping[str, Variate]


def knob_inputs(parts: Sequence[Weather]) -> dict[str, str]:
    """Kind of each weather to the name of its knob as a graph's input; rates of a mixture are told apart."""
    alone = sum(part.kind in FALLING for part in parts) == 1
    return {
        part.kind: part.knob_name if alone or part.kind not in FALLING else f"{part.kind}_{part.knob_name}"
        for part in parts
    }
