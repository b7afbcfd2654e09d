"""Nodes of a traced graph that change nothing, or that a simpler one replaces.

Rules that need to know which sizes are equal: the traced values hold their shapes, sizes of the inputs as symbols.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["simplify"]

STATIC_CHAIN = ("Reshape", "Unsqueeze")


def simplify(model: Any) -> None:
    """Apply every rule to every node once, in their order; in place. Unused nodes stay."""
    for node in list(model.graph):
        rule = RULES.get(node.op_type)
        if rule is None or node.domain not in ("", "ai.onnx"):
            continue
        found = rule(model.graph, node)
        output = node.outputs[0]
        if found is None:
            continue
        if output.is_graph_output():
            if found.producer() is None or found.is_graph_output():
                continue
            name, output.name = output.name, f"{output.name}_before"
            found.name = name
            model.graph.outputs[model.graph.outputs.index(output)] = found
        if found.shape is None and output.shape is not None:
            found.shape = output.shape
        if found.type is None:
            found.type = output.type
        output.replace_all_uses_with(found)


# ---- what is known of a value ----------------------------------------------------------------------------------------


def _sizes(value: Any) -> list[int | str | None] | None:
    """Sizes of a value, symbols as text; ``None`` where nothing is known."""
    if value is None or value.shape is None:
        return None
    return [size if isinstance(size, int) else size.value for size in value.shape]


def _constant(value: Any) -> Any:
    """A constant as an array, or ``None``."""
    tensor = None if value is None else value.const_value
    return None if tensor is None or value.is_graph_input() else tensor.numpy()


def _are_same(first: Any, second: Any) -> bool:
    """True where both shapes are known and equal."""
    sizes = _sizes(first)
    return sizes is not None and None not in sizes and sizes == _sizes(second)


def _initializer(graph: Any, array: Any) -> Any:
    import onnx_ir

    name = f"shape_{len(graph.initializers)}"
    value = onnx_ir.Value(name=name, const_value=onnx_ir.tensor(array, name=name))
    value.shape, value.dtype = onnx_ir.Shape(array.shape), onnx_ir.DataType.INT64
    graph.register_initializer(value)
    return value


# ---- rules: a graph and a node to the value that takes the place of its output, or None ------------------------------


def _reshape(graph: Any, node: Any) -> Any:
    data, shape = node.inputs[0], _constant(node.inputs[1])
    sizes = _sizes(data)
    if _are_same(data, node.outputs[0]):
        return data
    if sizes is not None and len(sizes) == 1 and shape is not None and shape.tolist() == [-1]:
        return data
    if shape is None and not ("allowzero" in node.attributes and node.attributes["allowzero"].as_int()):
        wanted = _fixed(sizes, _sizes(node.outputs[0]))
        if wanted is not None:
            node.replace_input_with(1, _initializer(graph, wanted))
            shape = wanted
    before = data.producer()
    if shape is not None and 0 not in shape and before is not None and before.op_type in STATIC_CHAIN:
        node.replace_input_with(0, before.inputs[0])
    return None


def _fixed(given: list[Any] | None, wanted: list[Any] | None) -> Any:
    """The shape of a reshape as numbers: 0 takes the size at the same place of what is given, -1 what remains."""
    if wanted is None or None in wanted:
        return None
    found = [
        size if isinstance(size, int) else 0 if given and place < len(given) and given[place] == size else -1
        for place, size in enumerate(wanted)
    ]
    if found.count(-1) > 1 or 0 in wanted:
        return None
    return np.array(found, np.int64)


def _cast(graph: Any, node: Any) -> Any:
    data = node.inputs[0]
    return data if data.dtype is not None and data.dtype == node.attributes["to"].as_int() else None


def _expand(graph: Any, node: Any) -> Any:
    return node.inputs[0] if _are_same(node.inputs[0], node.outputs[0]) else None


def _unsqueeze(graph: Any, node: Any) -> Any:
    before, axes = node.inputs[0].producer(), _constant(node.inputs[1])
    if before is None or before.op_type != "Unsqueeze" or axes is None:
        return None
    inner, sizes = _constant(before.inputs[1]), _sizes(node.outputs[0])
    if inner is None or sizes is None or axes.size != 1 or inner.size != 1:
        return None
    outer_axis, inner_axis = int(axes[0]) % len(sizes), int(inner[0]) % (len(sizes) - 1)
    both = sorted((outer_axis, inner_axis + (inner_axis >= outer_axis)))
    node.replace_input_with(0, before.inputs[0])
    node.replace_input_with(1, _initializer(graph, np.array(both, np.int64)))
    return None


def _gather(graph: Any, node: Any) -> Any:
    """One of the numbers of which a row ``(1, n)`` was put together."""
    place = _constant(node.inputs[1])
    row = node.inputs[0].producer()
    if place is None or place.ndim or row is None or row.op_type not in ("Unsqueeze", "Reshape"):
        return None
    parts = row.inputs[0].producer()
    if parts is None or parts.op_type != "Concat" or _sizes(node.inputs[0]) != [1, len(parts.inputs)]:
        return None
    if node.attributes["axis"].as_int() not in (1, -1):
        return None
    return parts.inputs[int(place)]


def _where(graph: Any, node: Any) -> Any:
    choice = _constant(node.inputs[0])
    if choice is None or choice.size != 1:
        return None
    taken = node.inputs[1 if bool(choice.reshape(-1)[0]) else 2]
    return taken if _are_same(taken, node.outputs[0]) else None


def _neutral(number: float) -> Callable[[Any, Any], Any]:
    """An operand that a number beside it leaves as it is."""

    def rule(graph: Any, node: Any) -> Any:
        for value, other in (node.inputs, reversed(node.inputs)):
            constant = _constant(other)
            is_number = constant is not None and constant.size and bool((constant == number).all())
            if is_number and _are_same(value, node.outputs[0]):
                return value
        return None

    return rule


def _transpose(graph: Any, node: Any) -> Any:
    """A tensor that is transposed twice stays."""
    before = node.inputs[0].producer()
    if before is None or before.op_type != "Transpose":
        return None
    first, second = (each.attributes["perm"].as_ints() for each in (before, node))
    return before.inputs[0] if [first[place] for place in second] == list(range(len(first))) else None


RULES: dict[str, Callable[[Any, Any], Any]] = {
    "Reshape": _reshape,
    "Cast": _cast,
    "Expand": _expand,
    "Unsqueeze": _unsqueeze,
    "Gather": _gather,
    "Where": _where,
    "Transpose": _transpose,
    "Mul": _neutral(1.0),
    "Add": _neutral(0.0),
}
