"""Simpler graphs give the same numbers; casts found from held types are those of torch's own pass."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor

pytest.importorskip("onnxscript")
import onnx
import onnx_ir
from onnx import TensorProto, helper, numpy_helper
from torch.onnx._internal.exporter import _fx_passes
from torch.onnx._internal.fx.passes import type_promotion

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.export import to_onnx
from torchweather.export.promoting import promoting_by_held_types
from torchweather.export.tidying import simplify
from torchweather.pipeline.graph_operations import (
    cells_apart,
    cells_together,
    entries_at,
    repeated,
    sums_before,
    sums_of_rows,
    weighted_sum,
)
from torchweather.sensors import Camera
from torchweather.transforms import BayerRain, BayerSnow

X = np.arange(12, dtype=np.float32).reshape(3, 4)
WEIGHTS = {
    "flat": np.array([-1], np.int64),
    "first": np.array([0], np.int64),
    "row": np.array([1, -1], np.int64),
    "one": np.array([1], np.int64),
    "same": np.array([1, 1], np.int64),
    "never": np.array([False]),
    "nothing": np.array([0.0], np.float32),
    "once": np.array(1.0, np.float32),
    "twice": np.array(2.0, np.float32),
}
# Nodes, and how many of them remain where the values that they name have the shapes given.
CASES: dict[str, tuple[list[tuple[str, list[str], str, dict[str, Any]]], dict[str, list[int | str]], int]] = {
    "a reshape to what it was": (
        [("Reshape", ["x", "flat"], "a", {}), ("Reshape", ["a", "flat"], "b", {}), ("Exp", ["b"], "y", {})],
        {"a": ["n"], "b": ["n"]},
        2,
    ),
    "two shapes one after the other": (
        [("Unsqueeze", ["x", "first"], "a", {}), ("Reshape", ["a", "row"], "y", {})],
        {"a": [1, "n", 4]},
        1,
    ),
    "a shape of sizes": (
        [("Shape", ["x"], "s", {}), ("Reshape", ["x", "s"], "a", {}), ("Exp", ["a"], "y", {})],
        {"a": ["n", 4]},
        1,
    ),
    "axes one by one": (
        [("Unsqueeze", ["x", "first"], "a", {}), ("Unsqueeze", ["a", "one"], "b", {}), ("Exp", ["b"], "y", {})],
        {"a": [1, "n", 4], "b": [1, 1, "n", 4]},
        2,
    ),
    "a cast to its type": (
        [("Cast", ["x"], "a", {"to": TensorProto.FLOAT}), ("Exp", ["a"], "y", {})],
        {"a": ["n", 4]},
        1,
    ),
    "a choice that is made": (
        [("Exp", ["x"], "e", {}), ("Where", ["never", "e", "x"], "a", {}), ("Neg", ["a"], "y", {})],
        {"a": ["n", 4], "e": ["n", 4]},
        1,
    ),
    "transposed twice": (
        [
            ("Transpose", ["x"], "a", {"perm": [1, 0]}),
            ("Transpose", ["a"], "b", {"perm": [1, 0]}),
            ("Exp", ["b"], "y", {}),
        ],
        {"a": [4, "n"], "b": ["n", 4]},
        1,
    ),
    "numbers that change nothing": (
        [("Add", ["nothing", "x"], "a", {}), ("Mul", ["a", "once"], "b", {}), ("Exp", ["b"], "y", {})],
        {"a": ["n", 4], "b": ["n", 4]},
        1,
    ),
    "another number beside it": (
        [("Mul", ["x", "twice"], "a", {}), ("Add", ["a", "once"], "b", {}), ("Exp", ["b"], "y", {})],
        {"a": ["n", 4], "b": ["n", 4]},
        3,
    ),
    "an expansion to what it was": (
        [("Expand", ["x", "same"], "a", {}), ("Exp", ["a"], "y", {})],
        {"a": ["n", 4]},
        1,
    ),
}


def model_of(nodes: Sequence[tuple[str, list[str], str, dict[str, Any]]], shapes: dict[str, list[int | str]]) -> Any:
    def info(name: str, shape: list[int | str] | None) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    used = {name for _, inputs, _, _ in nodes for name in inputs}
    graph = helper.make_graph(
        [helper.make_node(kind, inputs, [output], **more) for kind, inputs, output, more in nodes],
        "graph",
        [info("x", ["n", 4])],
        [info("y", None)],
        [numpy_helper.from_array(value, name) for name, value in WEIGHTS.items() if name in used],
        value_info=[info(name, shape) for name, shape in shapes.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)


def run(model: Any) -> Any:
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {"x": X})[0]


@pytest.mark.parametrize("name", CASES)
def test_a_simpler_graph_gives_the_same_numbers(name: str) -> None:
    nodes, shapes, left = CASES[name]
    model = model_of(nodes, shapes)
    found = onnx_ir.from_proto(model)
    simplify(found)
    from onnxscript import optimizer

    optimizer.remove_unused_nodes(found)
    assert len(found.graph) == left
    np.testing.assert_array_equal(run(onnx_ir.to_proto(found)), run(model))


class Mixed(torch.nn.Module):
    """Operands of several types."""

    def forward(self, x: Tensor, n: Tensor) -> Tensor:
        return torch.where(n > 1.5, x * n, x + 1) / (n + 2) - n.clamp_min(1) * (x > 0)


@pytest.mark.parametrize("missing", [False, True])
def test_parts_that_another_torch_lacks_are_not_needed(missing: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    before = vars(_fx_passes)["insert_type_promotion_nodes"]
    if missing:
        monkeypatch.delattr(type_promotion, "InsertTypePromotion")
    with promoting_by_held_types():
        assert (vars(_fx_passes)["insert_type_promotion_nodes"] is before) == missing
    assert vars(_fx_passes)["insert_type_promotion_nodes"] is before


@pytest.mark.filterwarnings("ignore")  # torch's own
def test_casts_from_held_types_are_those_of_torch() -> None:
    arguments = (torch.randn(5, 3), torch.arange(3))
    program = torch.export.export(Mixed(), arguments)
    found = []
    for how in (promoting_by_held_types(), nullcontext()):
        with how:
            exported = torch.onnx.export(program, opset_version=20, dynamo=True, optimize=False, verbose=False)
        assert exported is not None
        found.append([node.op_type for node in exported.model.graph])
        feed = dict(zip((one.name for one in exported.model_proto.graph.input), arguments, strict=True))
        session = onnxruntime.InferenceSession(exported.model_proto.SerializeToString())
        (given,) = session.run(None, {name: value.numpy() for name, value in feed.items()})
        torch.testing.assert_close(torch.from_numpy(given), Mixed()(*arguments))
    assert sorted(found[0]) == sorted(found[1])
    assert "Cast" in found[0]


def test_operations_of_one_node_are_torchs_where_no_graph_is_written() -> None:
    mosaic = torch.arange(48.0).view(1, 1, 6, 8)
    planes = cells_apart(mosaic)
    assert torch.equal(planes[0, 1], mosaic[0, 0, 0::2, 1::2])
    assert torch.equal(cells_together(planes), mosaic)
    table = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    rows = {"both": table, "one": table[:1]}
    sums = [{"both.1": 2.0, "one": -1.0, "": 0.5}, {"both.0": 1.0}]
    assert sums_of_rows(rows, sums).tolist() == [[7.5, 8.5, 9.5], [1.0, 2.0, 3.0]]
    assert torch.equal(sums_of_rows(rows, sums, as_columns=True), sums_of_rows(rows, sums).T)
    assert weighted_sum(table, [-1.0, 3.0]).tolist() == [[11.0, 13.0, 15.0]]
    assert sums_before(torch.tensor([3, 1, 2])).tolist() == [0, 3, 4]
    assert entries_at(table[:1], torch.tensor([[2], [0]])).tolist() == [[[3.0], [1.0]]]
    wider = repeated(mosaic, 7, 3)  # by more than the map is high
    assert torch.equal(wider[0, 0], torch.from_numpy(np.pad(mosaic[0, 0].numpy(), ((7, 7), (3, 3)), mode="wrap")))


CAMERA = Camera.from_intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)


@pytest.mark.long
@pytest.mark.parametrize(
    ("transform", "most"), [(BayerRain(Rain(25.0), CAMERA), 345), (BayerSnow(Snow(2.0), CAMERA), 395)]
)
def test_graphs_of_particles_stay_small(transform: BayerRain | BayerSnow, most: int, tmp_path: Path) -> None:
    to_onnx(transform, tmp_path / "graph.onnx", height=480, width=640)
    assert len(onnx.load(tmp_path / "graph.onnx").graph.node) <= most
