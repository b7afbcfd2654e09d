"""Declarations of detectors and their decoders: what is read, and what is refused, with the name that is near."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from tests.evaluation.robustness.onnx_detectors import bright_pixels, declared, fixed_boxes, near_points
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import OnnxDetector, read_declaration
from torchweather.evaluation.robustness.decoders import decode_boxes, decode_segmentation
from torchweather.evaluation.robustness.placement import Placement


def well() -> dict[str, Any]:
    return {
        "format": "torchweather-detector/1",
        "title": "cars",
        "sensor": "camera",
        "input": {"name": "image"},
        "decoder": "boxes",
        "outputs": {"boxes": "boxes", "scores": "scores", "labels": "labels"},
        "classes": ["car", "person"],
    }


def listed(outputs: dict[str, Any]) -> dict[str, list[Any]]:
    """One output for each role."""
    return {role: [array] for role, array in outputs.items()}


def written(folder: Path, values: object) -> Path:
    path = folder / "model.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "format": (lambda v: v.update(format="x"), "format must be 'torchweather-detector/1'; got 'x'"),
    "key": (lambda v: v.update(decodr="boxes"), "unknown key 'decodr'.*Did you mean 'decoder'"),
    "decoder": (lambda v: v.update(decoder="boxs"), "decoder must be one of boxes, yolov8, .*; got 'boxs'.*'boxes'"),
    "sensor": (lambda v: v.update(sensor="radar"), "sensor must be one of camera, lidar; got 'radar'"),
    "lidar boxes": (lambda v: v.update(sensor="lidar"), "boxes is for a camera"),
    "no classes": (lambda v: v.pop("classes"), "classes is missing"),
    "classes": (lambda v: v.update(classes="car"), "classes must be a list"),
    "twice": (lambda v: v.update(classes=["car", "car"]), "a name of its own"),
    "input": (lambda v: v.update(input={}), "input.name is missing"),
    "layout": (lambda v: v["input"].update(layout="NHCW"), "layout must be one of NCHW, NHWC.*Did you mean"),
    "input key": (lambda v: v["input"].update(colours="RGB"), "Did you mean 'colour'"),
    "size": (lambda v: v["input"].update(size=[3]), r"size must be \[height, width\]"),
    "outputs": (lambda v: v.update(outputs={"boxes": "b"}), "outputs must name the model's output for scores"),
    "option": (lambda v: v.update(options={"treshold": 0.1}), "Did you mean 'threshold'"),
    "one output twice": (lambda v: v.update(outputs={"boxes": "o", "scores": "o"}), "every output once.*yolov8"),
    "no output of the decoder": (lambda v: v.update(decoder="yolov8"), "unknown key 'outputs.boxes'"),
    "levels": (
        lambda v: v.update(decoder="nanodet", outputs={"scores": ["a"], "boxes": ["b", "c", "d"]}),
        "one output a level.*strides has 3 levels, outputs 1, 3",
    ),
    "letterbox": (lambda v: v["input"].update(fit="letterbox"), "fit: letterbox needs size"),
    "multiple": (lambda v: v["input"].update(multiple=32, size=[64, 64]), "multiple is for an input without size"),
    "fill": (lambda v: v["input"].update(fill=256), "fill must be a level from 0 to 255"),
    "std": (lambda v: v["input"].update(std=[1, 1, 0]), "std must be a number more than 0"),
    "operating": (lambda v: v.update(options={"operating_threshold": 40}), r"operating_threshold must be .*\[0, 1\]"),
    "draft": (lambda v: v.update(classes={0: "FILL IN"}), "classes is still to be filled in"),
    "number": (lambda v: v.update(options={"nms_iou": "a"}), "nms_iou must be a number"),
}


@pytest.mark.parametrize("what", list(WRONG))
def test_what_is_wrong_in_a_declaration_is_named_with_the_file(what: str, tmp_path: Path) -> None:
    change, message = WRONG[what]
    values = well()
    change(values)
    path = written(tmp_path, values)
    with pytest.raises(TorchweatherError, match=message) as caught:
        read_declaration(path)
    assert str(path) in str(caught.value)


MISMATCH: dict[str, tuple[dict[str, Any], str]] = {
    "input name": ({"input": {"name": "imgae"}}, r"names input 'imgae'.*takes image float32 \(1, 3, H, W\).*'image'"),
    "layout": ({"input": {"name": "image", "layout": "NHWC"}}, r"states image float32 \(1, H, W, 3\);.*\(1, 3, H, W\)"),
    "type": (
        {"input": {"name": "image", "dtype": "uint8"}},
        r"states image uint8 \(1, 3, H, W\);.*takes image float32",
    ),
    "colour": ({"input": {"name": "image", "colour": "bayer"}}, r"states image float32 \(1, 1, H, W\)"),
    "output": ({"outputs": {"boxes": "bokses", "scores": "scores"}}, r"names output 'bokses' for boxes.*gives boxes"),
}


@pytest.mark.parametrize("what", list(MISMATCH))
def test_a_model_that_is_not_as_declared_is_refused_with_both_sides(what: str, tmp_path: Path) -> None:
    change, message = MISMATCH[what]
    model = fixed_boxes(tmp_path / "model.onnx", [[0, 0, 1, 1]])
    declaration = read_declaration(written(tmp_path, {**well(), **change}))
    with pytest.raises(TorchweatherError, match=message):
        OnnxDetector(model, declaration)


def test_a_model_that_is_none_or_not_there_is_named(tmp_path: Path) -> None:
    declaration = read_declaration(written(tmp_path, well()))
    with pytest.raises(TorchweatherError, match="no such file"):
        OnnxDetector(tmp_path / "none.onnx", declaration)
    (tmp_path / "broken.onnx").write_bytes(b"nothing")
    with pytest.raises(TorchweatherError, match="expected an ONNX graph"):
        OnnxDetector(tmp_path / "broken.onnx", declaration)


def test_boxes_are_scaled_back_cut_by_score_and_the_weaker_of_a_class_left_out(tmp_path: Path) -> None:
    values = {**well(), "options": {"form": "cxcywh", "normalised": True, "threshold": 0.2, "nms_iou": 0.5}}
    declaration = read_declaration(written(tmp_path, values))
    stretched = Placement((100, 200), (32, 32), 0, 0, 32, 32)
    outputs = {
        "boxes": np.array([[[0.5, 0.5, 0.2, 0.4], [0.5, 0.5, 0.2, 0.5], [0.5, 0.5, 0.2, 0.4], [0.1, 0.1, 0.1, 0.1]]]),
        "scores": np.array([[0.9, 0.95, 0.8, 0.1]]),
        "labels": np.array([[0, 0, 1, 0]]),
    }
    found = decode_boxes(listed(outputs), declaration, stretched)
    assert found["labels"] == ["car", "person"]
    assert found["boxes"] == pytest.approx(np.array([[80, 25, 120, 75], [80, 30, 120, 70]]))
    by_class = {"boxes": outputs["boxes"], "scores": np.array([[[0.3, 0.6], [0.7, 0.1], [0.1, 0.1], [0.0, 0.9]]])}
    again = decode_boxes(listed(by_class), declaration, stretched)
    assert sorted(zip(again["labels"], again["scores"], strict=True)) == [
        ("car", 0.7),
        ("person", 0.6),
        ("person", 0.9),
    ]
    pixels = read_declaration(written(tmp_path, {**values, "options": {"form": "xyxy"}}))
    wide = Placement((64, 96), (32, 32), 0, 0, 32, 32)
    corners = np.array([[[16.0, 8.0, 24.0, 32.0]] * 4])
    scaled = decode_boxes(listed({**outputs, "boxes": corners}), pixels, wide)
    assert scaled["boxes"][0] == pytest.approx([48, 16, 72, 64])


def test_classes_of_points_and_pixels_are_the_largest_logits(tmp_path: Path) -> None:
    cloud = near_points(tmp_path / "near.onnx", 10.0)
    near = declared(
        cloud,
        sensor="lidar",
        input={"name": "points", "columns": 4},
        decoder="segmentation",
        outputs={"logits": "logits"},
        classes=["near", "far"],
    )
    points = torch.tensor([[3.0, 0.0, 0.0, 1.0, 7.0], [30.0, 0.0, 0.0, 1.0, 7.0]])
    assert OnnxDetector(cloud, read_declaration(near)).of_cloud(points).tolist() == [0, 1]
    image = bright_pixels(tmp_path / "bright.onnx")
    bright = declared(
        image,
        sensor="camera",
        input={"name": "image", "size": [4, 4]},
        decoder="segmentation",
        outputs={"logits": "logits"},
        classes=["dark", "bright"],
    )
    picture = torch.zeros(3, 8, 8)
    picture[:, :, 4:] = 1.0
    found = OnnxDetector(image, read_declaration(bright)).of_frame(None, picture)
    assert found.shape == (8, 8)  # brought to 4 x 4 and back
    assert np.array_equal(found, (picture[0] > 0.5).long().numpy())
    with pytest.raises(TorchweatherError, match="must have 3 dimensions"):
        decode_segmentation({"logits": [np.zeros(5)]}, read_declaration(bright), Placement((8, 8), (4, 4), 0, 0, 4, 4))
