"""A declaration to fill in, written from the inputs and outputs of an ONNX graph."""

from __future__ import annotations

import ast
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness.declaration import FILL_IN, FORMAT
from torchweather.evaluation.robustness.declared_forms import DECODERS
from torchweather.evaluation.robustness.graph import Graph, Port, open_session
from torchweather.evaluation.robustness.likely import Likely, likely_decoder
from torchweather.io import atomic_write

__all__ = ["draft_declaration"]

LARGEST_LEVEL = 255.0
# Open sides of a convolutional detector must be multiples of its largest stride, 32 in YOLO, NanoDet and FPN.
COMMON_MULTIPLE = 32
LETTERBOXED = ("yolov5", "yolov8", "end-to-end")


def draft_declaration(model: str | os.PathLike[str], path: str | os.PathLike[str], truth: Path | None = None) -> str:
    """Write a declaration of a model as far as its graph gives it.

    Args:
        model: the ONNX file.
        path: the declaration to write; must not exist.
        truth: COCO's JSON, whose categories are named in a comment.

    Returns:
        A sentence: where the declaration is, and what must be checked in it.

    Raises:
        TorchweatherError: no ONNX graph, several inputs, or a folder that cannot be written.
    """
    file = Path(path)
    _, graph = open_session(model)
    if len(graph.inputs) != 1:
        raise TorchweatherError(
            f"{graph.path}: a detector must have one input; {graph.text}. Export it with the others as constants."
        )
    if file.exists():
        raise TorchweatherError(f"{file}: a declaration is there already; a draft would overwrite it.")
    port = next(iter(graph.inputs.values()))
    cloud = len(port.shape) in (2, 3)
    text, checks = _of_cloud(graph, port) if cloud else _of_frame(graph, port, truth)
    try:
        with atomic_write(file) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
    except (OSError, TorchweatherError) as error:
        raise TorchweatherError(
            f"{file}: no declaration of the detector, and none can be written there ({error}). Give --declare FILE in "
            "a folder that can be written; a draft is then put there."
        ) from error
    return (
        f"{file}: no declaration of the detector was there; one was written from the graph. Check {', '.join(checks)} "
        "in it, then run the same command again."
    )


def _of_frame(graph: Graph, port: Port, truth: Path | None) -> tuple[str, list[str]]:
    """Text of a camera's detector, and the keys that the graph does not give."""
    size, layout = _size_and_layout(port)
    likely = likely_decoder([*graph.outputs.values()], size)
    decoder = likely.decoder if likely else "boxes"
    small = decoder in LETTERBOXED
    scale = LARGEST_LEVEL if port.dtype == "uint8" else 1.0
    lines = [
        *_head("camera"),
        "input:",
        f"  name: {json.dumps(port.name)}",
        f"  layout: {layout}",
        "  colour: RGB               # check: or BGR (OpenCV), or bayer for a mosaic",
        f"  dtype: {port.dtype}",
        "  # check: (scale * picture - mean) / std of an sRGB picture in 0..1; scale 255 for models that take 0..255",
        f"  scale: {scale}",
        "  mean: [0, 0, 0]           # check: in the order of colour",
        "  std: [1, 1, 1]",
    ]
    if size is None:
        lines.append(f"  multiple: {COMMON_MULTIPLE}              # check: sides of the input are multiples of it")
    else:
        lines += [
            f"  size: [{size[0]}, {size[1]}]",
            f"  fit: {'letterbox' if small else 'stretch'}            # check: stretch, letterbox or corner",
            "  fill: 114                 # check: level of the border, 0..255",
        ]
    lines += _decoder_lines(graph, likely)
    lines += _class_lines(graph, likely, truth)
    options = {**DECODERS[decoder].options, **(likely.options if likely else {})}
    lines += ["options:", *(f"  {key}: {_yaml(value)}" for key, value in options.items())]
    return "\n".join(lines) + "\n", [
        *("input.colour", "input.scale, mean and std"),
        *([] if size is None else ["input.fit"]),
        *(["decoder and outputs"] if likely is None or likely.check else []),
        "classes",
        "options",
    ]


def _head(sensor: str) -> list[str]:
    return [
        "# Written from the ONNX graph. The graph does not give what is marked 'check'.",
        f"format: {FORMAT}",
        f"title: {FILL_IN}",
        f"sensor: {sensor}",
    ]


def _decoder_lines(graph: Graph, likely: Likely | None) -> list[str]:
    """Decoder and outputs; all outputs of the graph as a comment."""
    lines = [f"# The graph gives {'; '.join(port.text for port in graph.outputs.values())}."]
    if likely is None:
        lines += [
            f"# check: no decoder fits these outputs; known are {', '.join(DECODERS)}.",
            "decoder: boxes",
            f"outputs: {{boxes: {FILL_IN}, scores: {FILL_IN}}}",
        ]
        return lines
    levels = DECODERS[likely.decoder].levels
    outputs = {role: list(names) if levels else names[0] for role, names in likely.outputs.items()}
    lines += [f"# check: {sentence}" for sentence in likely.check]
    return [*lines, f"decoder: {likely.decoder}", f"outputs: {_yaml(outputs)}"]


def _class_lines(graph: Graph, likely: Likely | None, truth: Path | None) -> list[str]:
    """Names of the classes from the exporter's remark ``names``, or numbers to be named."""
    lines = []
    categories = _categories(truth)
    if categories:
        lines.append(f"# {truth} has the categories {', '.join(categories)}; use the same names.")
    named = _named_classes(graph.remarks)
    if named:
        return [*lines, "classes:", *(f"  {number}: {json.dumps(name)}" for number, name in named.items())]
    count = likely.classes if likely else None
    lines.append(
        "# check: number: name of the classes to be judged; the graph "
        + ("does not give their number." if count is None else f"has {count}, from 0 on.")
    )
    return [*lines, "classes:", f"  0: {FILL_IN}"]


def _of_cloud(graph: Graph, port: Port) -> tuple[str, list[str]]:
    """Text of a LiDAR's detector, and the keys that the graph does not give."""
    columns = port.shape[-1] if isinstance(port.shape[-1], int) else 4
    lines = [
        *_head("lidar"),
        "input:",
        f"  name: {json.dumps(port.name)}",
        f"  columns: {columns}                # check: x, y, z, intensity, ...",
        f"  batch: {str(len(port.shape) == 3).lower()}",
        f"# The graph gives {'; '.join(each.text for each in graph.outputs.values())}.",
        "decoder: segmentation",
        f"outputs: {_yaml({'logits': next(iter(graph.outputs))})}",
        "# check: number: name of the classes",
        "classes:",
        f"  0: {FILL_IN}",
    ]
    return "\n".join(lines) + "\n", ["input.columns", "classes"]


def _size_and_layout(port: Port) -> tuple[tuple[int, int] | None, str]:
    """Height and width where the graph fixes them, and where it has the colours."""
    last = len(port.shape) == 4 and port.shape[3] in (1, 3) and port.shape[1] not in (1, 3)
    sides = port.shape[1:3] if last else port.shape[2:4]
    fixed = [side for side in sides if isinstance(side, int)]
    return (fixed[0], fixed[1]) if len(fixed) == 2 else None, "NHWC" if last else "NCHW"


def _named_classes(remarks: Mapping[str, str]) -> dict[int, str]:
    """Classes of the remark ``names`` that Ultralytics' exporter leaves: a dictionary or list as text."""
    try:
        found = ast.literal_eval(remarks.get("names", ""))
    except (ValueError, SyntaxError):
        return {}
    pairs = dict(enumerate(found)) if isinstance(found, Sequence) and not isinstance(found, str) else found
    if not isinstance(pairs, Mapping) or not all(isinstance(number, int) for number in pairs):
        return {}
    return {int(number): str(name) for number, name in pairs.items()}


def _categories(truth: Path | None) -> list[str]:
    """Names of COCO's categories, where the file can be read."""
    try:
        values = json.loads(truth.read_text(encoding="utf-8")) if truth is not None else {}
        return [str(each["name"]) for each in values.get("categories", [])]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return []  # the run itself says what is wrong with the truth


def _yaml(value: Any) -> str:
    """A value on one line; JSON is YAML."""
    return json.dumps(value)
