"""``torchweather robustness`` on guessed depth, without a declaration, on frames of several sizes, with intervals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.evaluation.robustness.robustness_command import (
    BOX,
    arguments,
    camera_data,
    camera_model,
    own_suite,
    with_declaration,
)
from tests.report.parsed_page import Page
from torchweather.camera.depth import SceneDepth
from torchweather.cli import main
from torchweather.core.errors import TorchweatherError
from torchweather.evaluation.robustness import BoxTruth, LabelledFrame, OnnxDetector, read_declaration, run_robustness
from torchweather.evaluation.sweep import CameraSubject
from torchweather.io import read_table, write_image
from torchweather.recipes import read_recipe
from torchweather.sensors import Camera

pytestmark = pytest.mark.usefixtures("undrawn")


def without_depth(folder: Path) -> list[str]:
    """Data without depth maps, so that depth is guessed as flat ground."""
    camera_data(folder / "data")
    shutil.rmtree(folder / "data" / "depth")
    camera_model(folder)
    own_suite(folder)
    return arguments(folder, **{"--metrics": "none"})


def test_guessed_depth_is_refused_with_the_remedies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = without_depth(tmp_path)
    for more in ([], ["--depth", "ground"]):
        assert main([*command, *more]) == 2
        said = capsys.readouterr().err
        for remedy in ("--depth DIR", "LiDAR", "--allow-guessed-depth"):
            assert remedy in said
        assert not (tmp_path / "out").exists()


def test_guessed_depth_that_is_allowed_stands_in_every_headline(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*without_depth(tmp_path), "--allow-guessed-depth"]) == 0
    assert capsys.readouterr().out.startswith("DEPTH GUESSED")
    found = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert (found["headline"], found["depth"]) == ("depth guessed", "guessed")
    assert {*read_table(tmp_path / "out" / "robustness.csv")["depth"]} == {"guessed"}
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "in the weather, depth guessed</h1>" in page
    assert found["notes"][0].startswith("The depth of the frames is guessed")


def test_frames_of_guessed_depth_are_refused_in_python_too(tmp_path: Path) -> None:
    camera = Camera.preset("lucid-triton").resized(16, 16)
    truth = BoxTruth(np.array([BOX]), ("car",), np.zeros(1, bool))
    depth_m, light = torch.full((1, 16, 16), 9.0), {"airlight": 0.6}
    measured, guessed = (
        CameraSubject("a", torch.rand(1, 16, 16), depth_m, camera, options=light, scene_depth=SceneDepth(depth_m, sure))
        for sure in ("measured", "guessed")
    )
    detector = OnnxDetector(camera_model(tmp_path), read_declaration(tmp_path / "model.yaml"))
    conditions = read_recipe(own_suite(tmp_path), "suite").conditions()[:1]
    frames = [LabelledFrame("a", measured, truth), LabelledFrame("b", guessed, truth)]
    with pytest.raises(TorchweatherError, match="depth of b is guessed"):
        run_robustness(frames, detector, conditions, metrics=[])
    found = run_robustness(frames, detector, conditions, metrics=[], allow_guessed_depth=True)
    assert found.depth == "guessed"
    assert run_robustness(frames[:1], detector, conditions, metrics=[]).depth == "measured"


def test_without_a_declaration_one_is_written_and_the_run_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera_data(tmp_path / "data")
    model = camera_model(tmp_path)
    declared_by_hand = model.with_suffix(".yaml").read_text()
    model.with_suffix(".yaml").unlink()
    assert main(["robustness", "--model", str(model), "--data", str(tmp_path / "data")]) == 2
    said = capsys.readouterr().err
    assert f"{model.with_suffix('.yaml')}: no declaration of the detector was there; one was written" in said
    assert "input.colour" in said
    assert "has the categories car" in model.with_suffix(".yaml").read_text()
    assert main(["robustness", "--model", str(model), "--data", str(tmp_path / "data")]) == 2
    assert "is still to be filled in" in capsys.readouterr().err
    model.with_suffix(".yaml").write_text(declared_by_hand)
    assert main(["robustness", "--model", str(model), "--data", str(tmp_path / "data")]) == 2
    assert "--out is missing" in capsys.readouterr().err


def test_frames_of_several_sizes_go_through_one_fixed_input(tmp_path: Path) -> None:
    """A detector of 48 x 64 px that says the box of the first frame; the second is half again as large and portrait."""
    data = camera_data(tmp_path / "data")
    raw = torch.full((1, 96, 72), 40000, dtype=torch.int32)
    raw[:, 12:48, 12:60] = 2000
    write_image(data / "images" / "1.png", raw.to(torch.uint16))
    np.save(data / "depth" / "1.npy", np.full((96, 72), 30.0, np.float32))
    truth = json.loads((data / "annotations.json").read_text())
    # The frame fills 48 x 36 px of the input from column 14 on, at half its size.
    truth["annotations"][1]["bbox"] = [0.0, 16.0, 52.0, 48.0]
    (data / "annotations.json").write_text(json.dumps(truth))
    camera_model(tmp_path)
    own_suite(tmp_path)
    letterboxed = with_declaration(input={"name": "image", "size": [48, 64], "fit": "letterbox", "fill": 0})
    assert main(letterboxed(tmp_path, arguments(tmp_path, **{"--metrics": "none"}))) == 0
    found = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert found["clear"] == 1.0
    assert found["clear_interval"] is None  # two frames are too few


def test_intervals_stand_in_the_table_the_numbers_and_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Six frames of two contrasts: in some fog the one kind is found and the other is not."""
    camera_data(tmp_path / "data", count=6)
    camera_model(tmp_path)
    own_suite(tmp_path)
    command = arguments(tmp_path, **{"--metrics": "none", "--resamples": "200"})
    assert main(command) == 0
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert found["resamples"] == 200
    for each in found["conditions"]:
        low, high = each["interval"]
        assert low <= each["performance"] <= high
        assert each["difference_interval"][0] <= each["performance"] - found["clear"] <= each["difference_interval"][1]
    assert "  95 %" in said
    assert "1.00-1.00" in said
    table = read_table(tmp_path / "out" / "robustness.csv")
    assert table["low"] == [each["interval"][0] for each in found["conditions"]]
    page = Page((tmp_path / "out" / "index.html").read_text(encoding="utf-8"))
    assert "95 % interval 1.00 to 1.00" in page.words
    assert "6 frames are few" in page.words
    assert found["operating_point"]["origin"] == "maximum F1 on the clear frames"
    assert main([*command, "--resamples", "0"]) == 0
    assert "95 %" not in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "robustness.json").read_text())["clear_interval"] is None
