"""A declaration is compared with the graph before the first frame; what differs is named with the remedy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from onnx import TensorProto, helper

from tests.evaluation.robustness.onnx_detectors import saved, value
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import OnnxDetector, read_declaration
from torchweather.evaluation.robustness.graph import Graph, open_session
from torchweather.evaluation.robustness.graph_check import check_graph
from torchweather.evaluation.robustness.likely import likely_decoder

Shape = list[int | str]
PACKED = Path(__file__).parent / "packed_detector"


def model(path: Path, outputs: dict[str, Shape], image: Shape | None = None, integers: str = "") -> Path:
    """A graph of these shapes whose answer is of no interest; onnxruntime takes the shapes of open sizes as given."""
    nodes, weights = [], {}
    for name, shape in outputs.items():
        kind = np.int64 if name == integers else np.float32
        weights[f"{name}_all"] = np.zeros([size if isinstance(size, int) else 3 for size in shape], kind)
        nodes.append(helper.make_node("Identity", [f"{name}_all"], [name]))
    ports = [
        value(name, shape, TensorProto.INT64 if name == integers else TensorProto.FLOAT)
        for name, shape in outputs.items()
    ]
    return saved(path, nodes, [value("images", image or [1, 3, 64, 64])], ports, weights)


def opened(path: Path, outputs: dict[str, Shape]) -> Graph:
    """The graph as onnxruntime reports it, with the open sizes that it would fold here."""
    _, graph = open_session(model(path, outputs, integers="labels"))
    ports = {name: replace(graph.outputs[name], shape=tuple(shape)) for name, shape in outputs.items()}
    return replace(graph, outputs=ports)


def declared(path: Path, decoder: str, outputs: dict[str, Any], **more: Any) -> Path:
    values: dict[str, Any] = {
        "format": "torchweather-detector/1",
        "title": "shapes",
        "sensor": "camera",
        "input": {"name": "images", "size": [64, 64]},
        "decoder": decoder,
        "outputs": outputs,
        "classes": ["car", "person"],
    }
    file = path.with_suffix(".yaml")
    file.write_text(yaml.safe_dump({**values, **more}))
    return file


LEVELS: dict[str, Shape] = {"s8": [1, 64, 2], "s16": [1, 16, 2], "b8": [1, 64, 32], "b16": [1, 16, 32]}
NAMES = {"scores": ["s8", "s16"], "boxes": ["b8", "b16"]}
STRIDES = {"options": {"strides": [8, 16]}}
GOOD: dict[str, tuple[dict[str, Shape], str, dict[str, Any], dict[str, Any]]] = {
    "yolov8": ({"o": [1, 6, 84]}, "yolov8", {"packed": "o"}, {}),
    "yolov8, open": ({"o": ["batch", 6, "anchors"]}, "yolov8", {"packed": "o"}, {}),
    "yolov5": ({"o": [1, 84, 7]}, "yolov5", {"packed": "o"}, {}),
    "end-to-end": ({"o": [1, 300, 6]}, "end-to-end", {"packed": "o"}, {}),
    "mmdeploy": ({"dets": [1, 100, 5], "labels": [1, 100]}, "mmdeploy", {"boxes": "dets", "labels": "labels"}, {}),
    "detr": ({"l": [1, 100, 3], "b": [1, 100, 4]}, "detr", {"logits": "l", "boxes": "b"}, {}),
    "one box": ({"b": [1, 4], "s": [1], "l": [1]}, "boxes", {"boxes": "b", "scores": "s", "labels": "l"}, {}),
    "nanodet": (LEVELS, "nanodet", NAMES, STRIDES),
}
BAD: dict[str, tuple[dict[str, Shape], str, dict[str, Any], dict[str, Any], str]] = {
    "transposed": (
        {"o": [1, 84, 6]},
        "yolov8",
        {"packed": "o"},
        {},
        r"yolov8 reads packed \(4 \+ K, N\) from o.*classes lists 2 names and the output has 80",
    ),
    "transposed, some classes": (
        {"o": [1, 8400, 84]},
        "yolov8",
        {"packed": "o"},
        {"classes": {0: "car"}},
        "8400 numbers for each of 84 places are the wrong way round.*looks like the decoder yolov5",
    ),
    "objectness": ({"o": [1, 7, 84]}, "yolov8", {"packed": "o"}, {}, "lists 2 names and the output has 3 classes"),
    "too few classes": (
        {"o": [1, 6, 84]},
        "yolov8",
        {"packed": "o"},
        {"classes": {5: "car"}},
        "classes has number 5 and the output 2 classes",
    ),
    "boxes that are packed": (
        {"o": [1, 84, 8400], "p": [1, 100]},
        "boxes",
        {"boxes": "o", "scores": "p"},
        {},
        r"boxes reads boxes \(N, 4\) from o.*expected 4 numbers a box, got 8400.*looks like the decoder yolov8",
    ),
    "no object": (
        {"l": [1, 100, 2], "b": [1, 100, 4]},
        "detr",
        {"logits": "l", "boxes": "b"},
        {},
        "lists 2 names and the output has 1 classes beside no object",
    ),
    "dimensions": ({"o": [1, 3, 8, 8, 7]}, "yolov5", {"packed": "o"}, {}, "the output has 5 dimensions"),
    "end to end": ({"o": [1, 300, 7]}, "end-to-end", {"packed": "o"}, {}, "expected 6 numbers a box, got 7"),
    "strides": (
        LEVELS,
        "nanodet",
        NAMES,
        {"options": {"strides": [16, 32]}},
        "stride 16 of an input of 64 x 64 px makes 16 places, got 64",
    ),
    "size": (
        {"o": [1, 6, 84]},
        "yolov8",
        {"packed": "o"},
        {"input": {"name": "images", "size": [64, 96]}},
        r"states images float32 \(1, 3, 64, 96\); .* Set input.size: \[64, 64\]",
    ),
    "layout": (
        {"o": [1, 6, 84]},
        "yolov8",
        {"packed": "o"},
        {"input": {"name": "images", "layout": "NHWC", "size": [64, 64]}},
        "Set input.layout: NCHW",
    ),
    "dtype": (
        {"o": [1, 6, 84]},
        "yolov8",
        {"packed": "o"},
        {"input": {"name": "images", "dtype": "uint8", "size": [64, 64]}},
        "Set input.dtype: float32",
    ),
}


@pytest.mark.parametrize("what", list(GOOD))
def test_a_graph_of_the_declared_shapes_is_taken(what: str, tmp_path: Path) -> None:
    outputs, decoder, roles, more = GOOD[what]
    path = tmp_path / "m.onnx"
    graph = opened(path, outputs)
    declaration = read_declaration(declared(path, decoder, roles, **more))
    check_graph(graph, declaration)
    if not any(isinstance(size, str) for shape in outputs.values() for size in shape):
        OnnxDetector(path, declaration)


@pytest.mark.parametrize("what", list(BAD))
def test_a_graph_of_other_shapes_is_refused_with_both_sides(what: str, tmp_path: Path) -> None:
    outputs, decoder, roles, more, message = BAD[what]
    path = model(tmp_path / "m.onnx", outputs)
    file = declared(path, decoder, roles, **more)
    with pytest.raises(TorchweatherError, match=message) as caught:
        OnnxDetector(path, read_declaration(file))
    assert str(caught.value).startswith(f"{file}: ")
    assert "m.onnx takes images float32" in str(caught.value)


def test_a_batch_that_is_fixed_is_named(tmp_path: Path) -> None:
    path = model(tmp_path / "m.onnx", {"o": [4, 6, 84]}, [4, 3, 64, 64])
    file = declared(path, "yolov8", {"packed": "o"})
    with pytest.raises(TorchweatherError, match="Export the model with a batch of 1"):
        OnnxDetector(path, read_declaration(file))


LIKELY: dict[str, tuple[dict[str, Shape], str, dict[str, Any]]] = {
    "yolov8": ({"o": [1, 84, 8400]}, "yolov8", {"packed": ["o"]}),
    "yolov5": ({"o": [1, 25200, 85]}, "yolov5", {"packed": ["o"]}),
    "yolov5 of one class": ({"o": [1, 25200, 6]}, "yolov5", {"packed": ["o"]}),
    "yolov5, open": ({"o": [1, "n", 85]}, "yolov5", {"packed": ["o"]}),
    "end-to-end": ({"o": [1, 300, 6]}, "end-to-end", {"packed": ["o"]}),
    "mmdeploy": ({"dets": [1, 100, 5], "labels": [1, 100]}, "mmdeploy", {"boxes": ["dets"], "labels": ["labels"]}),
    "detr": ({"b": [1, 100, 4], "l": [1, 100, 92]}, "detr", {"logits": ["l"], "boxes": ["b"]}),
    "nanodet": (
        {"s8": [1, 64, 80], "s16": [1, 16, 80], "b8": [1, 64, 32], "b16": [1, 16, 32]},
        "nanodet",
        {"scores": ["s8", "s16"], "boxes": ["b8", "b16"]},
    ),
    "segmentation": ({"o": [1, 19, 64, 64]}, "segmentation", {"logits": ["o"]}),
}


@pytest.mark.parametrize("what", list(LIKELY))
def test_the_decoder_is_guessed_from_the_shapes(what: str, tmp_path: Path) -> None:
    outputs, decoder, roles = LIKELY[what]
    graph = opened(tmp_path / "m.onnx", outputs)
    found = likely_decoder([*graph.outputs.values()], (64, 64))
    assert found is not None
    assert (found.decoder, dict(found.outputs)) == (decoder, roles)
    if decoder == "nanodet":
        assert found.options["strides"] == [8, 16]


def test_the_packed_detector_of_the_tests_is_read() -> None:
    detector = OnnxDetector(PACKED / "v8.onnx", read_declaration(PACKED / "v8.yaml"))
    assert detector.declaration.task == "boxes"
