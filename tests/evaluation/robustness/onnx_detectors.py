"""Detectors whose answers are known, made by hand: no training, no export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

OPSETS = [helper.make_opsetid("", 17)]


def value(name: str, shape: list[int | str], kind: int = TensorProto.FLOAT) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, shape)


def saved(path: Path, nodes: list[Any], inputs: list[Any], outputs: list[Any], weights: dict[str, Any]) -> Path:
    constants = [numpy_helper.from_array(np.asarray(array), name) for name, array in weights.items()]
    graph = helper.make_graph(nodes, "detector", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=OPSETS, ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


def declared(path: Path, **values: Any) -> Path:
    file = path.with_suffix(".yaml")
    file.write_text(yaml.safe_dump({"format": "torchweather-detector/1", "title": "By hand", **values}))
    return file


def fixed_boxes(path: Path, boxes: list[list[float]]) -> Path:
    """Always the same boxes; their score is the contrast of the frame: standard deviation over its mean."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("Sub", ["image", "mean"], ["apart"]),
        helper.make_node("Mul", ["apart", "apart"], ["square"]),
        helper.make_node("ReduceMean", ["square"], ["variance"], keepdims=0),
        helper.make_node("Sqrt", ["variance"], ["deviation"]),
        helper.make_node("Div", ["deviation", "mean"], ["contrast"]),
        helper.make_node("Mul", ["ones", "contrast"], ["scores"]),
        helper.make_node("Identity", ["fixed"], ["boxes"]),
        helper.make_node("Identity", ["classes"], ["labels"]),
    ]
    count = len(boxes)
    return saved(
        path,
        nodes,
        [value("image", [1, 3, "H", "W"])],
        [
            value("boxes", [count, 4]),
            value("scores", [count]),
            value("labels", [count], TensorProto.INT64),
        ],
        {
            "fixed": np.array(boxes, np.float32),
            "ones": np.ones(count, np.float32),
            "classes": np.zeros(count, np.int64),
        },
    )


def near_points(path: Path, range_m: float) -> Path:
    """Two classes of points: 0 within a range, 1 beyond."""
    nodes = [
        helper.make_node("Slice", ["points", "zero", "three", "last"], ["xyz"]),
        helper.make_node("ReduceL2", ["xyz"], ["range"], axes=[2], keepdims=1),
        helper.make_node("Sub", ["limit", "range"], ["near"]),
        helper.make_node("Neg", ["near"], ["far"]),
        helper.make_node("Concat", ["near", "far"], ["logits"], axis=2),
    ]
    one = np.array([0], np.int64)
    return saved(
        path,
        nodes,
        [value("points", [1, "N", 4])],
        [value("logits", [1, "N", 2])],
        {"zero": one, "three": one + 3, "last": one + 2, "limit": np.array(range_m, np.float32)},
    )


def bright_pixels(path: Path) -> Path:
    """Two classes of pixels: 1 where the image is brighter than a half."""
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["grey"], axes=[1], keepdims=1),
        helper.make_node("Sub", ["grey", "half"], ["bright"]),
        helper.make_node("Neg", ["bright"], ["dark"]),
        helper.make_node("Concat", ["dark", "bright"], ["logits"], axis=1),
    ]
    return saved(
        path,
        nodes,
        [value("image", [1, 3, "H", "W"])],
        [value("logits", [1, 2, "H", "W"])],
        {"half": np.array(0.5, np.float32)},
    )
