"""A declaration compared with the model's graph, before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.evaluation.robustness.declaration import Declaration
from torchweather.evaluation.robustness.graph import Graph, Port
from torchweather.evaluation.robustness.input_ports import INPUT_PORTS, Shape
from torchweather.evaluation.robustness.likely import likely_output

__all__ = ["check_graph"]

FEWEST_PX = 4  # of a side of an image; less is the axis of the colours

# Shapes by decoder and role. A text with K is a number of classes, one with "bins" four distributions.
SHAPES: dict[str, dict[str, Shape]] = {
    "boxes": {"boxes": ("N", 4)},
    "yolov8": {"packed": ("4 + K", "N")},
    "yolov5": {"packed": ("N", "5 + K")},
    "end-to-end": {"packed": ("N", 6)},
    "mmdeploy": {"boxes": ("N", 5), "labels": ("N",)},
    "detr": {"logits": ("N", "K"), "boxes": ("N", 4)},
    "nanodet": {"scores": ("N", "K"), "boxes": ("N", "4 bins")},
}
BESIDE = {"4 + K": 4, "5 + K": 5, "K": 0}
"""Numbers beside the scores of the classes on an axis."""


def check_graph(graph: Graph, declaration: Declaration) -> None:
    """Refuse a model whose inputs and outputs are not the declared ones.

    Raises:
        TorchweatherError: with the declaration's file, what it declares, and what the graph has.
    """
    where = declaration.path
    _check_input(graph, declaration)
    for role, names in declaration.outputs.items():
        for name in names:
            if name not in graph.outputs:
                raise TorchweatherError(
                    f"{where}: the declaration names output {name!r} for {role}; {graph.text}."
                    f"{nearest_name(name, graph.outputs)}"
                )
    for role, shape in _shapes(declaration).items():
        for level, name in enumerate(declaration.outputs[role]):
            _check_output(graph, declaration, role, level, graph.outputs[name], shape)


def _shapes(declaration: Declaration) -> dict[str, Shape]:
    if declaration.decoder == "segmentation":
        return {"logits": INPUT_PORTS[declaration.sensor].logits}
    shapes = dict(SHAPES[declaration.decoder])
    if declaration.decoder == "boxes":
        labelled = "labels" in declaration.outputs
        shapes |= {"scores": ("N",), "labels": ("N",)} if labelled else {"scores": ("N", "K")}
    return shapes


# ---- the input -----------------------------------------------------------------------------------------------------


def _check_input(graph: Graph, declaration: Declaration) -> None:
    declared, where = declaration.input, declaration.path
    if {*graph.inputs} != {declared["name"]}:
        hint = "" if declared["name"] in graph.inputs else nearest_name(declared["name"], graph.inputs)
        more = " A detector with several inputs is not supported." if len(graph.inputs) > 1 else ""
        raise TorchweatherError(f"{where}: the declaration names input {declared['name']!r}; {graph.text}.{hint}{more}")
    port = graph.inputs[declared["name"]]
    wanted, kind = INPUT_PORTS[declaration.sensor].declared(declaration.input)
    fits = not port.shape or (len(port.shape) == len(wanted) and all(map(_fits, port.shape, wanted)))
    if fits and port.dtype == kind:
        return
    shape = ", ".join(map(str, wanted))
    raise TorchweatherError(
        f"{where}: the declaration states {declared['name']} {kind} ({shape}); {graph.text}."
        f"{_input_remedy(port, wanted, kind)}"
    )


def _input_remedy(port: Port, wanted: Sequence[int | str], kind: str) -> str:
    """A change of the declaration that would fit, or ''."""
    if port.dtype != kind:
        return f" Set input.dtype: {port.dtype}." if port.dtype in ("float32", "float16", "uint8") else ""
    if len(port.shape) != 4 or len(wanted) != 4:
        return ""
    if isinstance(port.shape[0], int) and port.shape[0] != 1:
        return " Export the model with a batch of 1."
    first = port.shape[1] in (1, 3)
    if first != (wanted[1] in (1, 3)):
        return f" Set input.layout: {'NCHW' if first else 'NHWC'}."
    size = port.shape[2:] if first else port.shape[1:3]
    return f" Set input.size: [{size[0]}, {size[1]}]." if all(isinstance(side, int) for side in size) else ""


def _fits(own: object, said: object) -> bool:
    """Tell if a model's size can be the declared one: equal, or one of them open; three rows would be colours."""
    if isinstance(own, int) and isinstance(said, int):
        return own == said
    return said not in ("H", "W") or not isinstance(own, int) or own >= FEWEST_PX


# ---- the outputs ---------------------------------------------------------------------------------------------------


def _check_output(graph: Graph, declaration: Declaration, role: str, level: int, port: Port, shape: Shape) -> None:
    if not port.shape:
        return
    own = port.without_batch(len(shape))
    said = _misfit(declaration, role, level, own, shape)
    if said:
        wanted = ", ".join(map(str, shape))
        likely = likely_output(port)
        hint = f" It looks like the decoder {likely}." if likely and likely != declaration.decoder else ""
        raise TorchweatherError(
            f"{declaration.path}: the decoder {declaration.decoder} reads {role} ({wanted}) from {port.name}, with or "
            f"without a batch of 1; {said}; {graph.text}.{hint}"
        )


def _misfit(declaration: Declaration, role: str, level: int, own: Shape, shape: Shape) -> str:
    """In what an output's shape is not the declared one, or ''."""
    if len(own) != len(shape):
        return f"the output has {len(own)} dimensions"
    for size, wanted in zip(own, shape, strict=True):
        if not isinstance(size, int):
            continue
        if isinstance(wanted, int) and size != wanted:
            return f"expected {wanted} numbers a box, got {size}"
        if wanted in BESIDE and (said := _wrong_classes(declaration, size - BESIDE[str(wanted)])):
            return said
        if wanted == "4 bins" and (size % 4 or size < 8):
            return f"expected a multiple of 4, of 2 bins or more; got {size}"
    if declaration.decoder in ("yolov8", "yolov5"):
        numbers, places = own if declaration.decoder == "yolov8" else own[::-1]
        if isinstance(numbers, int) and isinstance(places, int) and numbers > places:
            return f"{numbers} numbers for each of {places} places are the wrong way round"
    if declaration.decoder == "nanodet" and isinstance(own[0], int):
        return _wrong_places(declaration, level, own[0])
    return ""


def _wrong_classes(declaration: Declaration, count: int) -> str:
    """In what the number of classes is not the declared one, or ''."""
    softmax_set = declaration.decoder == "detr" and declaration.options["activation"] == "softmax"
    count -= int(softmax_set)  # the last one is "no object"
    if declaration.all_classes and declaration.task == "boxes" and len(declaration.classes) != count:
        return (
            f"classes lists {len(declaration.classes)} names and the output has {max(count, 0)} classes"
            f"{' beside no object' if softmax_set else ''} (list all of them, or give number: name for some)"
        )
    if max(declaration.classes) >= count:
        return f"classes has number {max(declaration.classes)} and the output {max(count, 0)} classes, from 0 on"
    return ""


def _wrong_places(declaration: Declaration, level: int, count: int) -> str:
    """In what a level's number of places is not that of its stride, or ''."""
    size, stride = declaration.input["size"], declaration.options["strides"][level]
    if size is None:
        return ""
    places = math.prod(math.ceil(side / stride) for side in size)
    if places == count:
        return ""
    return f"stride {stride} of an input of {size[0]} x {size[1]} px makes {places} places, got {count}"
