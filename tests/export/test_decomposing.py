"""Programs whose decomposition replaces single nodes: the same numbers as torch's own way, which traces all anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.export.decomposing import DecomposedByNode, decompose_nodes

aten = torch.ops.aten
# Operations that ONNX does not have, as torch's exporter hands them over.
TABLE: dict[Any, Callable[..., Any]] = {
    aten.square.default: torch.square,
    aten.item.default: torch.Tensor.item,
    aten.rsub.Scalar: lambda a, b: b - a,
    aten.neg_.default: lambda a: -a,
    aten.__and__.Tensor: torch.bitwise_and,
    aten.__or__.Tensor: torch.bitwise_or,
    aten.special_ndtr.default: lambda a: 0.5 * torch.special.erfc(-a * 0.5**0.5),
}


class Every(torch.nn.Module):
    """Each operation that has a rule."""

    def forward(self, x: Tensor) -> Tensor:
        whole = (x > 0) & (x < 1) | (x == 5)
        shares = (1 - x.square()).exp().neg_().neg_() * whole.to(x.dtype)
        turned = shares.T.movedim(-1, 0).double().float().reshape(-1)
        return torch.special.ndtr(turned) + x.flatten().numel() + x.numel() + whole.sum().item()


class Shared(torch.nn.Module):
    """An operation in place on what another one reads."""

    def forward(self, x: Tensor) -> Tensor:
        y = x + 1
        z = y * 2
        y.neg_()
        return y + z


class View(torch.nn.Module):
    """An operation in place on a part."""

    def forward(self, x: Tensor) -> Tensor:
        y = x + 1
        y[:1].neg_()
        return y


def exported(module: torch.nn.Module, x: Tensor) -> DecomposedByNode:
    rows, columns = torch.export.Dim("rows", min=2), torch.export.Dim("columns", min=2)
    return DecomposedByNode.of(torch.export.export(module, (x,), dynamic_shapes=({0: rows, 1: columns},), strict=False))


def test_every_rule_gives_the_numbers_of_the_operation_at_another_size() -> None:
    program = exported(Every(), torch.rand(3, 4))
    assert decompose_nodes(program.graph_module, TABLE)
    left = {node.target for node in program.graph.nodes}
    assert not left & {*TABLE, aten.to.dtype, aten.numpy_T.default, aten.movedim.int, aten.sym_numel.default}
    other = torch.linspace(-1.0, 5.0, 35).reshape(5, 7)
    (found,) = program.graph_module(other)
    torch.testing.assert_close(found, Every()(other), rtol=0, atol=1e-5)  # roundings of float32 below 128


@pytest.mark.filterwarnings("ignore::FutureWarning")  # torch's own, inside its way
@pytest.mark.parametrize("module", [Shared(), View()], ids=["shared", "view"])
def test_what_is_changed_in_place_and_read_is_left_to_torch(module: torch.nn.Module) -> None:
    program = exported(module, torch.rand(3, 4))
    assert not decompose_nodes(program.graph_module, TABLE)
    x = torch.rand(5, 7)
    assert torch.equal(program.run_decompositions({}).module()(x), module(x))
