"""A convolutional TensorFlow.js graph model as an ONNX graph, for any size of picture.

Only the operations of a feed-forward convolutional network are translated, and TensorFlow is not needed. TensorFlow.js
works with the colours last and ONNX with the colours first. A converted PyTorch network therefore has a transpose
before and after every convolution. Here every tensor is kept with its colours first, and a transpose only notes the
order in which the TensorFlow graph has the axes, so no transpose of pictures is left in the ONNX graph.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
NAMED_ORDER = (0, 2, 3, 1)  # axes of an ONNX picture in the order of TensorFlow's NHWC
PLAIN = (0, 1, 2, 3)
Array = NDArray[Any]


@dataclass(frozen=True)
class Value:
    """A tensor of the TensorFlow graph: a constant, or the ONNX tensor of a name with its axes in another order."""

    name: str = ""
    order: tuple[int, ...] | None = None
    constant: Array | None = None


def read_weights(manifest: list[dict[str, Any]], folder: Path) -> dict[str, Array]:
    """Constants by name; 16-bit floats become 32-bit, 8-bit and 16-bit integers are scaled back."""
    found: dict[str, Array] = {}
    for group in manifest:
        raw, start = b"".join((folder / path).read_bytes() for path in group["paths"]), 0
        for weight in group["weights"]:
            packed = weight.get("quantization")
            stored = np.dtype((packed or weight)["dtype"]).newbyteorder("<")
            count = math.prod(weight["shape"])
            values: Array = np.frombuffer(raw, stored, count, start).reshape(weight["shape"])
            start += count * stored.itemsize
            if packed and stored.kind == "u":
                values = values.astype(np.float32) * packed["scale"] + packed["min"]
            found[weight["name"]] = values.astype(np.float32 if weight["dtype"] == "float32" else np.int64)
        if start != len(raw):
            raise ValueError(f"{folder}: the weights end at byte {start}; the files have {len(raw)} bytes.")
    return found


class Converter:
    """Nodes of an ONNX graph from the nodes of a TensorFlow graph, one after another.

    Args:
        weights: constants by name.
        size: height and width of the new picture.
        built_for: height and width that the TensorFlow graph was made for; its targets of resizing are scaled.
    """

    def __init__(self, weights: dict[str, Array], size: tuple[int, int], built_for: tuple[int, int]) -> None:
        self.values = {name: Value(constant=array) for name, array in weights.items()}
        self.size, self.built_for = size, built_for
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []

    def take(self, node: dict[str, Any]) -> None:
        """Translate one node, whose inputs are known."""
        operation = node["op"]
        method = getattr(self, f"on_{operation.lower()}", None)
        if method is None:
            raise ValueError(f"{node['name']}: no translation of the operation {operation} to ONNX.")
        inputs = [self.values[name] for name in node["input"] if not name.startswith("^")]
        found = method(node["name"], inputs, node.get("attr", {}))
        for place, value in enumerate(found if isinstance(found, list) else [found]):
            self.values[node["name"] + (f":{place}" if place else "")] = value

    def add(
        self, operation: str, inputs: list[str], name: str, order: tuple[int, ...] | None, **attributes: Any
    ) -> Value:
        """One ONNX node of one output."""
        self.nodes.append(helper.make_node(operation, inputs, [name], **attributes))
        return Value(name, order)

    def constant(self, name: str, array: Array) -> str:
        """Name of a constant of the ONNX graph."""
        self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    # ---- operations that leave no node ---------------------------------------------------------------------------

    def on_sparsetodense(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Constant: values at places of an array that is filled with the last input."""
        places, shape, values, filling = (known(each, name) for each in inputs)
        found = np.full(tuple(shape), filling)
        if len(values):
            found[tuple(places.T)] = values
        return Value(constant=found)

    def on_identity(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """The input; an output of the graph gets a node so that its name is kept."""
        return self.add("Identity", [inputs[0].name], name, inputs[0].order)

    def on_transpose(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Of a picture the order is noted; of anything else a node."""
        turn = tuple(int(k) for k in known(inputs[1], name))
        if inputs[0].order is None:
            return self.add("Transpose", [inputs[0].name], name, None, perm=turn)
        return Value(inputs[0].name, tuple(inputs[0].order[k] for k in turn))

    # ---- operations on pictures ----------------------------------------------------------------------------------

    def on_add(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Sum of two tensors, or of a picture and a number for each colour."""
        first, second = inputs
        if first.constant is not None and second.constant is not None:
            return Value(constant=first.constant + second.constant)
        if second.constant is not None:
            if second.constant.ndim != 1 or first.order != NAMED_ORDER:
                raise ValueError(f"{name}: expected a bias of the last axis; got shape {second.constant.shape}.")
            return self.add(
                "Add", [first.name, self.constant(f"{name}/bias", second.constant[:, None, None])], name, first.order
            )
        if first.order != second.order:
            raise ValueError(f"{name}: expected two pictures with the same order of axes.")
        return self.add("Add", [first.name, second.name], name, first.order)

    on_addv2 = on_add

    def on_pad(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Frame of zeros, or of the third input's value."""
        pads = known(inputs[1], name)
        before, after = ([int(pads[picture(inputs[0]).index(axis)][side]) for axis in range(4)] for side in (0, 1))
        filling = known(inputs[2], name) if len(inputs) > 2 else np.float32(0)
        names = [
            self.constant(f"{name}/pads", np.array(before + after, np.int64)),
            self.constant(f"{name}/value", np.asarray(filling, np.float32)),
        ]
        return self.add("Pad", [inputs[0].name, *names], name, inputs[0].order)

    on_padv2 = on_pad

    def on_conv2d(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Convolution; TensorFlow's kernels are (height, width, in, out)."""
        self.check_valid(name, inputs[0], attributes)
        kernel = self.constant(f"{name}/kernel", known(inputs[1], name).transpose(3, 2, 0, 1))
        steps = {"strides": numbers(attributes["strides"])[1:3], "dilations": numbers(attributes["dilations"])[1:3]}
        return self.add("Conv", [inputs[0].name, kernel], name, NAMED_ORDER, **steps)

    def on_maxpool(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Largest value of a window."""
        self.check_valid(name, inputs[0], attributes)
        steps = {"kernel_shape": numbers(attributes["ksize"])[1:3], "strides": numbers(attributes["strides"])[1:3]}
        return self.add("MaxPool", [inputs[0].name], name, NAMED_ORDER, **steps)

    def on_leakyrelu(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Leaky rectified linear unit."""
        return self.add("LeakyRelu", [inputs[0].name], name, inputs[0].order, alpha=float(attributes["alpha"]["f"]))

    def on_sigmoid(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Logistic function."""
        return self.add("Sigmoid", [inputs[0].name], name, inputs[0].order)

    def on_resizebilinear(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Bilinear resizing between pixel centres to a size in proportion to the new picture."""
        if (
            inputs[0].order != NAMED_ORDER
            or attributes["align_corners"]["b"]
            or not attributes["half_pixel_centers"]["b"]
        ):
            raise ValueError(f"{name}: expected bilinear resizing with half_pixel_centers, colours last.")
        target = known(inputs[1], name) * np.array(self.size) // np.array(self.built_for)
        shape = self.helper_shape(name, inputs[0].name, target)
        return self.add(
            "Resize",
            [inputs[0].name, "", "", shape],
            name,
            NAMED_ORDER,
            mode="linear",
            coordinate_transformation_mode="half_pixel",
        )

    def helper_shape(self, name: str, source: str, target: Array) -> str:
        """Name of the whole target shape: batch and colours of the source, then height and width."""
        shape = self.add("Shape", [source], f"{name}/shape", None, end=2).name
        return self.add(
            "Concat", [shape, self.constant(f"{name}/size", target.astype(np.int64))], f"{name}/target", None, axis=0
        ).name

    def on_concatv2(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Pictures behind one another."""
        orders = {picture(each) for each in inputs[:-1]}
        if len(orders) > 1:
            raise ValueError(f"{name}: expected pictures with the same order of axes.")
        [order] = orders
        axis = order[int(known(inputs[-1], name))]
        return self.add("Concat", [each.name for each in inputs[:-1]], name, order, axis=axis)

    def on_splitv(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> list[Value]:
        """Parts of a picture along an axis."""
        sizes, order = known(inputs[1], name), picture(inputs[0])
        names = [name, *(f"{name}:{k}" for k in range(1, len(sizes)))]
        lengths = self.constant(f"{name}/sizes", sizes.astype(np.int64))
        self.nodes.append(
            helper.make_node("Split", [inputs[0].name, lengths], names, axis=order[int(known(inputs[2], name))])
        )
        return [Value(each, order) for each in names]

    def on_reshape(self, name: str, inputs: list[Value], attributes: dict[str, Any]) -> Value:
        """Another shape; the picture must have its colours first."""
        if picture(inputs[0]) != PLAIN:
            raise ValueError(f"{name}: expected a picture with its colours first.")
        shape = self.constant(f"{name}/shape", known(inputs[1], name).astype(np.int64))
        return self.add("Reshape", [inputs[0].name, shape], name, None)

    @staticmethod
    def check_valid(name: str, value: Value, attributes: dict[str, Any]) -> None:
        """Refuse what the graphs of this example do not have: padding inside a convolution, colours first."""
        padding = base64.b64decode(attributes["padding"]["s"]).decode()
        if padding != "VALID" or picture(value) != NAMED_ORDER:
            raise ValueError(f"{name}: expected padding VALID and colours last; got {padding}, order {value.order}.")


def known(value: Value, name: str) -> Array:
    """The constant, or an error."""
    if value.constant is None:
        raise ValueError(f"{name}: expected a constant input.")
    return value.constant


def picture(value: Value) -> tuple[int, ...]:
    """Order of the axes of a picture, or an error."""
    if value.order is None:
        raise ValueError(f"{value.name}: expected a picture of four axes.")
    return value.order


def numbers(attribute: dict[str, Any]) -> list[int]:
    """A list of numbers of an attribute."""
    return [int(each) for each in attribute["list"]["i"]]


def convert(model: Path, target: Path, size: tuple[int, int], outputs: dict[str, str]) -> None:
    """Write a TensorFlow.js graph model as ONNX.

    Args:
        model: the model's JSON; the weights lie beside it.
        target: the ONNX file.
        size: height and width of the picture that the ONNX graph takes, multiples of the largest stride.
        outputs: output of the TensorFlow graph to its name in the ONNX graph.
    """
    graph = json.loads(model.read_text(encoding="utf-8"))
    nodes = graph["modelTopology"]["node"]
    [entry] = [node for node in nodes if node["op"] == "Placeholder"]
    was = [int(each["size"]) for each in entry["attr"]["shape"]["shape"]["dim"]]
    converter = Converter(read_weights(graph["weightsManifest"], model.parent), size, (was[2], was[3]))
    converter.values[entry["name"]] = Value("image", PLAIN)
    waiting = [node for node in nodes if node["op"] not in ("Placeholder", "Const")]
    while waiting:
        ready = [n for n in waiting if all(i in converter.values for i in n["input"] if not i.startswith("^"))]
        if not ready:
            raise ValueError(f"{model}: {len(waiting)} nodes have inputs that no node gives.")
        for node in ready:
            converter.take(node)
        waiting = [node for node in waiting if node not in ready]
    for old, new in outputs.items():
        converter.nodes.append(helper.make_node("Identity", [old], [new]))
    # Of rank 3; the inference of shapes fills in the sizes.
    values = [helper.make_tensor_value_info(new, TensorProto.FLOAT, [None] * 3) for new in outputs.values()]
    taken = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, was[1], *size])
    made = helper.make_graph(converter.nodes, "converted", [taken], values, converter.initializers)
    whole = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8)
    onnx.checker.check_model(whole)
    target.write_bytes(onnx.shape_inference.infer_shapes(whole, strict_mode=True, data_prop=True).SerializeToString())
