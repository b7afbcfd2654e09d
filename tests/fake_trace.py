"""Run of a graph's module on tensors without numbers, as an exporter traces it: no stage may look at a value."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode
from torch.utils._pytree import tree_leaves, tree_map

from torchweather.export.traceable import Traceable


def traced_shapes(traceable: Traceable) -> list[tuple[int, ...]]:
    """Shapes of the outputs of a graph, run on tensors that have shapes and no numbers.

    A stage that reads a value (``float``, ``tolist``, an ``if`` on a tensor) raises here, as most do in
    ``torch.export``, which takes 20 times as long.
    """
    mode = FakeTensorMode(allow_non_fake_inputs=True)
    with as_exported(), mode, torch.no_grad():
        given = tree_map(mode.from_tensor, traceable.arguments)
        found = tree_leaves(traceable.module(*given))
    assert all(isinstance(tensor, FakeTensor) for tensor in found)
    return [tuple(tensor.shape) for tensor in found]


@contextmanager
def as_exported() -> Iterator[None]:
    """Within, the package takes the branches of an export."""
    before: Callable[[], Any] = torch.compiler.is_compiling
    torch.compiler.is_compiling = lambda: True  # type: ignore[assignment]
    try:
        yield
    finally:
        torch.compiler.is_compiling = before  # type: ignore[assignment]
