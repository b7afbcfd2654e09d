"""A model without a declaration: one is written from the graph, and the run stops with what to check."""

from __future__ import annotations

import json
from pathlib import Path

import onnx
import pytest
import yaml

from tests.evaluation.robustness.onnx_detectors import near_points
from tests.evaluation.robustness.test_graph_check import model
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import OnnxDetector, read_declaration
from torchweather.evaluation.robustness.draft import draft_declaration


def filled_in(path: Path, **values: object) -> None:
    """What a person does with a draft."""
    draft = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**draft, "title": "mine", **values}))


def test_a_draft_that_is_filled_in_is_a_declaration_of_the_model(tmp_path: Path) -> None:
    shapes = {"s8": [1, 64, 3], "s16": [1, 16, 3], "b8": [1, 64, 32], "b16": [1, 16, 32]}
    path, file = model(tmp_path / "m.onnx", dict(shapes)), tmp_path / "m.yaml"
    truth = tmp_path / "annotations.json"
    truth.write_text(json.dumps({"categories": [{"id": 1, "name": "car"}, {"id": 2, "name": "van"}]}))
    said = draft_declaration(path, file, truth)
    assert said.startswith(f"{file}: no declaration of the detector was there; one was written from the graph. Check ")
    assert all(key in said for key in ("input.colour", "scale, mean and std", "input.fit", "classes"))
    assert "has the categories car, van" in file.read_text()
    with pytest.raises(TorchweatherError, match="title is still to be filled in"):
        read_declaration(file)
    filled_in(file, classes=["car", "van", "tram"])
    declaration = read_declaration(file)
    assert declaration.decoder == "nanodet"
    assert declaration.options["strides"] == [8, 16]
    assert declaration.input["size"] == [64, 64]
    OnnxDetector(path, declaration)


def test_classes_come_from_the_exporters_remark(tmp_path: Path) -> None:
    path, file = model(tmp_path / "m.onnx", {"output0": [1, 6, 84]}), tmp_path / "m.yaml"
    graph = onnx.load(path)
    graph.metadata_props.add(key="names", value="{0: 'car', 1: 'person'}")
    onnx.save(graph, path)
    draft_declaration(path, file)
    filled_in(file)
    declaration = read_declaration(file)
    assert (declaration.decoder, dict(declaration.classes)) == ("yolov8", {0: "car", 1: "person"})
    assert declaration.input["fit"] == "letterbox"
    OnnxDetector(path, declaration)


def test_of_outputs_that_fit_no_decoder_all_are_listed(tmp_path: Path) -> None:
    path, file = model(tmp_path / "m.onnx", {"a": [1, 5, 5, 5], "b": [2, 2, 2]}, [1, 64, 64, 3]), tmp_path / "m.yaml"
    draft_declaration(path, file)
    text = file.read_text()
    assert "no decoder fits these outputs" in text
    assert "a float32 (1, 5, 5, 5); b float32 (2, 2, 2)" in text
    assert yaml.safe_load(text)["input"]["layout"] == "NHWC"


def test_a_detector_of_clouds_gets_a_draft_as_well(tmp_path: Path) -> None:
    path, file = near_points(tmp_path / "m.onnx", 10.0), tmp_path / "m.yaml"
    draft_declaration(path, file)
    filled_in(file, classes=["near", "far"])
    declaration = read_declaration(file)
    assert (declaration.sensor, declaration.input["columns"], declaration.input["batch"]) == ("lidar", 4, True)
    OnnxDetector(path, declaration)


def test_a_draft_overwrites_nothing_and_names_a_folder_that_is_not_there(tmp_path: Path) -> None:
    path, file = model(tmp_path / "m.onnx", {"o": [1, 6, 84]}), tmp_path / "m.yaml"
    file.write_text("mine")
    with pytest.raises(TorchweatherError, match="is there already"):
        draft_declaration(path, file)
    assert file.read_text() == "mine"
    with pytest.raises(TorchweatherError, match="Give --declare FILE"):
        draft_declaration(path, tmp_path / "none" / "m.yaml")
