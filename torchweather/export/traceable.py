"""Traceable: a transform as a function of tensors, with what the exporter must know to write it as a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import nn

from torchweather.random import Variate

__all__ = ["Traceable"]


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
