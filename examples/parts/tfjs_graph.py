"""A TensorFlow.js graph model read and evaluated as it stands, to check a conversion against.

Every node is computed in the order of axes that the TensorFlow graph has, colours last. Nothing is shared with the
conversion except the reading of the weights.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from parts.tfjs_to_onnx import numbers, read_weights
from torch import Tensor


def evaluate(model: Path, image: Tensor, outputs: list[str]) -> list[Tensor]:
    """Outputs of the graph for a picture.

    Args:
        model: the model's JSON; the weights lie beside it.
        image: ``(1, 3, H, W)`` as the graph takes it, of any size that its strides divide.
        outputs: names of nodes.
    """
    graph = json.loads(model.read_text(encoding="utf-8"))
    nodes = {node["name"]: node for node in graph["modelTopology"]["node"]}
    values: dict[str, Any] = {
        name: torch.from_numpy(array.copy())
        for name, array in read_weights(graph["weightsManifest"], model.parent).items()
    }
    [entry] = [node for node in nodes.values() if node["op"] == "Placeholder"]
    built_for = [int(each["size"]) for each in entry["attr"]["shape"]["shape"]["dim"]][2:]
    scale = [image.shape[2] / built_for[0], image.shape[3] / built_for[1]]
    values[entry["name"]] = image

    def value(name: str) -> Any:
        node, _, place = name.partition(":")
        if node not in values:
            inputs = [value(each) for each in nodes[node]["input"] if not each.startswith("^")]
            values[node] = compute(nodes[node], inputs, scale)
        found = values[node]
        return found[int(place or 0)] if isinstance(found, (tuple, list)) else found

    return [value(name) for name in outputs]


def compute(node: dict[str, Any], inputs: list[Tensor], scale: list[float]) -> Any:
    """One node; ``scale`` is the size of the picture over the size that the graph was made for."""
    operation, attributes = node["op"], node.get("attr", {})
    first = inputs[0]
    if operation == "Identity":
        return first
    if operation in ("Add", "AddV2"):
        return first + inputs[1]
    if operation == "SparseToDense":
        places, shape, values, filling = inputs
        dense = torch.full(tuple(shape.tolist()), int(filling))
        for place, one in zip(places.tolist(), values.tolist(), strict=True):
            dense[tuple(place)] = one
        return dense
    if operation == "Transpose":
        return first.permute(*inputs[1].tolist())
    if operation in ("Pad", "PadV2"):
        pads = [side for pair in reversed(inputs[1].tolist()) for side in pair]
        return F.pad(first, pads, value=float(inputs[2]) if len(inputs) > 2 else 0.0)
    if operation == "Conv2D":
        stride, dilation = numbers(attributes["strides"])[1:3], numbers(attributes["dilations"])[1:3]
        return F.conv2d(
            first.permute(0, 3, 1, 2), inputs[1].permute(3, 2, 0, 1), stride=stride, dilation=dilation
        ).permute(0, 2, 3, 1)
    if operation == "MaxPool":
        window, stride = numbers(attributes["ksize"])[1:3], numbers(attributes["strides"])[1:3]
        return F.max_pool2d(first.permute(0, 3, 1, 2), window, stride).permute(0, 2, 3, 1)
    if operation == "LeakyRelu":
        return F.leaky_relu(first, float(attributes["alpha"]["f"]))
    if operation == "Sigmoid":
        return first.sigmoid()
    if operation == "ResizeBilinear":
        size = [round(side * factor) for side, factor in zip(inputs[1].tolist(), scale, strict=True)]
        return F.interpolate(first.permute(0, 3, 1, 2), size=size, mode="bilinear").permute(0, 2, 3, 1)
    if operation == "ConcatV2":
        return torch.cat(inputs[:-1], int(inputs[-1]))
    if operation == "SplitV":
        return first.split(inputs[1].tolist(), int(inputs[2]))
    if operation == "Reshape":
        return first.reshape(inputs[1].tolist())
    raise ValueError(f"{node['name']}: the operation {operation} is not known.")
