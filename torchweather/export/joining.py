"""Two ONNX graphs as one: outputs of the first become inputs of the second, all other names stay apart.

``onnx.compose`` renames initializers after the subgraphs that read them, so that a detector with loops or branches
loses its weights; here every name of a graph, at any depth, goes through one mapping.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from torchweather.core.errors import InputValueError, TorchweatherError

__all__ = ["check_connection", "inputs_of", "join_models", "raised_to", "signature_text"]

DOMAINS = ("", "ai.onnx")  # two names of the same


def inputs_of(model: Any) -> list[Any]:
    """Inputs that a caller feeds; those with a default (old graphs list their weights) are left out."""
    weights = {each.name for each in model.graph.initializer}
    return [each for each in model.graph.input if each.name not in weights]


def signature_text(values: Any) -> str:
    """Names, types and shapes in words: ``image float32 (1, 3, H, W)``."""
    return ", ".join(f"{each.name} {_type(each)} {_shape_text(each)}" for each in values) or "nothing"


def check_connection(first: Any, second: Any, source: str, target: str, *, hint: str) -> None:
    """Raise unless an output of the first model fits an input of the second in type and shape."""
    outputs = {each.name: each for each in first.graph.output}
    inputs = {each.name: each for each in inputs_of(second)}
    both = (
        f"the weather gives {signature_text(first.graph.output)}; the detector takes {signature_text(inputs.values())}"
    )
    if source not in outputs or target not in inputs:
        missing = source if source not in outputs else target
        raise InputValueError(f"fuse: there is no {missing!r}: {both}.")
    out, into = outputs[source], inputs[target]
    given, wanted = _shape(out), _shape(into)
    fits = (
        given is None
        or wanted is None
        or (
            len(given) == len(wanted)
            and all(
                a == b or isinstance(a, str) or isinstance(b, str) or None in (a, b)
                for a, b in zip(given, wanted, strict=True)
            )
        )
    )
    if not fits or out.type.tensor_type.elem_type != into.type.tensor_type.elem_type:
        raise InputValueError(
            f"fuse: {source} {_type(out)} {_shape_text(out)} does not fit {target} {_type(into)} {_shape_text(into)}: "
            f"{both}. {hint}"
        )


def raised_to(model: Any, opset: int, name: str) -> Any:
    """The model at an opset, its own or a higher one."""
    own = _opset(model)
    if own == opset:
        return model
    from onnx import version_converter

    try:
        return version_converter.convert_version(model, opset)
    except Exception as error:  # the converter raises what its C++ part does
        raise TorchweatherError(
            f"fuse: {name} has opset {own}, which cannot be brought to {opset} ({' '.join(str(error).split())}). "
            f"Export it with opset {opset}."
        ) from error


def join_models(
    first: Any, second: Any, connections: Mapping[str, str], *, keep: tuple[str, ...] = (), name: str = "detector"
) -> Any:
    """One model.

    Args:
        first, second: ``onnx.ModelProto``.
        connections: input of the second to output of the first.
        keep: outputs of the first that the joined model gives too, after those of the second.
        name: of the second: it stands before the names inside it.

    Returns:
        The model. Inputs of the first, then those of the second that are not connected; a name that both have gets
        ``detector.`` in front.
    """
    import onnx

    opset = max(_opset(first), _opset(second))
    first, second = raised_to(first, opset, "the weather"), raised_to(second, opset, "the detector")
    public = {each.name for each in first.graph.input} | {*keep}
    outer = {name: name for name in public}
    inner: dict[str, str] = {}
    for own in [*(each.name for each in inputs_of(second)), *(each.name for each in second.graph.output)]:
        inner[own] = f"{name}.{own}" if own in public else own
    inner |= {target: outer.get(source, f"weather/{source}") for target, source in connections.items()}
    joined = onnx.ModelProto()
    joined.ir_version = max(first.ir_version, second.ir_version)
    joined.graph.name = "weather_and_detector"
    for model, renamed in (
        (first, lambda own: outer.get(own, f"weather/{own}")),
        (second, lambda own: inner.get(own, f"{name}/{own}")),
    ):
        graph = onnx.GraphProto()
        graph.CopyFrom(model.graph)
        _rename(graph, renamed)
        joined.graph.node.extend(graph.node)
        joined.graph.initializer.extend(graph.initializer)
        joined.graph.sparse_initializer.extend(graph.sparse_initializer)
        joined.functions.extend(model.functions)
        for each in model.opset_import:
            if not any(each.domain == known.domain for known in joined.opset_import):
                joined.opset_import.add(domain=each.domain, version=each.version)
        weights = {each.name for each in graph.initializer}
        connected = {inner[target] for target in connections} if model is second else set()
        joined.graph.input.extend(each for each in graph.input if each.name not in weights | connected)
    for each in second.graph.output:
        joined.graph.output.add().CopyFrom(_renamed(each, inner[each.name]))
    joined.graph.output.extend(each for each in first.graph.output if each.name in keep)
    onnx.checker.check_model(joined)
    return joined


def _renamed(value: Any, name: str) -> Any:
    import onnx

    found = onnx.ValueInfoProto()
    found.CopyFrom(value)
    found.name = name
    return found


def _rename(graph: Any, renamed: Callable[[str], str]) -> None:
    """Give every value and node of a graph, and of the graphs inside its nodes, another name; in place."""
    for node in graph.node:
        node.name = renamed(node.name) if node.name else ""
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                names[place] = renamed(name) if name else ""  # an empty name is an input that is left out
        for inside in _subgraphs(node):
            _rename(inside, renamed)
    for each in (*graph.input, *graph.output, *graph.initializer):
        each.name = renamed(each.name)
    for sparse in graph.sparse_initializer:
        sparse.values.name = renamed(sparse.values.name)
    for note in graph.quantization_annotation:
        note.tensor_name = renamed(note.tensor_name)
    # Shapes of what is inside: onnxruntime finds them itself, and symbols of two graphs could clash.
    del graph.value_info[:]


def _subgraphs(node: Any) -> Iterator[Any]:
    for attribute in node.attribute:
        if attribute.HasField("g"):
            yield attribute.g
        yield from attribute.graphs


def _opset(model: Any) -> int:
    return max((int(each.version) for each in model.opset_import if each.domain in DOMAINS), default=1)


def _shape(value: Any) -> list[int | str | None] | None:
    tensor = value.type.tensor_type
    if not tensor.HasField("shape"):
        return None
    return [
        each.dim_value if each.HasField("dim_value") else each.dim_param if each.HasField("dim_param") else None
        for each in tensor.shape.dim
    ]


def _shape_text(value: Any) -> str:
    shape = _shape(value)
    if shape is None:
        return "of any shape"
    return f"({', '.join('?' if each is None else str(each) for each in shape)})"


def _type(value: Any) -> str:
    import onnx

    number = value.type.tensor_type.elem_type
    return str(onnx.helper.tensor_dtype_to_np_dtype(number)) if number else "no tensor"
