"""``torchweather robustness``: numbers by hand, repeatable, one storm that gets heavier, one line for what is wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from tests.evaluation.robustness.onnx_detectors import bright_pixels, declared, near_points
from tests.evaluation.robustness.robustness_command import (
    BOX,
    SIZE,
    arguments,
    camera_data,
    camera_model,
    own_suite,
    with_declaration,
)
from tests.report.parsed_page import Page
from torchweather.atmosphere.weather import Weather
from torchweather.cli import main
from torchweather.evaluation.robustness import BoxTruth, LabelledFrame, OnnxDetector, read_declaration, run_robustness
from torchweather.evaluation.sweep import CameraSubject
from torchweather.io import PointLabels, read_table, write_image, write_labels
from torchweather.recipes import read_recipe, recipes_folder
from torchweather.recipes.suite import SuiteRecipe
from torchweather.sensors import Camera

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robustness")
    camera_data(folder / "data")
    camera_model(folder)
    own_suite(folder)
    assert main(arguments(folder)) == 0
    return folder


def test_the_rates_follow_from_what_was_found(done: Path) -> None:
    found = json.loads((done / "out" / "robustness.json").read_text())
    values = [each["performance"] for each in found["conditions"]]
    assert found["clear"] == 1.0
    assert values[0] == 1.0  # thin fog leaves the contrast
    assert values[-1] == 0.0  # at twice the visibility nothing is left of it
    assert values == sorted(values, reverse=True)
    assert found["mean_resilience_rate"] == pytest.approx(sum(values) / 5)
    assert found["mean_corruption_error"] is None  # the detector makes no error in clear air
    assert [each["value"] for each in found["conditions"]] == [1000.0, 400.0, 100.0, 30.0, 15.0]
    psnr = [each["scores"]["psnr"] for each in found["conditions"]]
    assert psnr == sorted(psnr, reverse=True)


def test_the_tables_and_the_page_hold_the_same(done: Path) -> None:
    found = json.loads((done / "out" / "robustness.json").read_text())
    table = read_table(done / "out" / "robustness.csv")
    assert table["AP"] == [each["performance"] for each in found["conditions"]]
    assert read_table(done / "out" / "performance.csv")["AP_car"] == table["AP"]
    scores = read_table(done / "out" / "scores.csv")
    assert len(scores["score"]) == 2 * 5 * 2
    assert {*scores["subject"]} <= {"0", "1", 0, 1}
    page = Page((done / "out" / "index.html").read_text(encoding="utf-8"))
    assert not page.mistakes
    assert all(str(each["src"]).startswith("data:") for each in page.all("img"))
    assert "It is lowest in fog 100 m: 0.00." in page.words
    assert (done / "out" / "correlation" / "index.html").is_file()
    correlated = {each["metric"]: each for each in found["correlation"]}
    assert correlated["psnr"]["spearman"] > 0.5
    assert not list(done.rglob(".*"))  # nothing half written


def test_a_run_is_repeated_by_its_seed_and_a_baseline_of_itself_has_an_error_of_one(done: Path) -> None:
    assert main(arguments(done, out="again", **{"--baseline": str(done / "out")})) == 0
    first, second = (json.loads((done / name / "robustness.json").read_text()) for name in ("out", "again"))
    assert second["conditions"] == first["conditions"]
    assert second["mean_corruption_error"] == 1.0
    assert second["reference"] == "baseline"
    assert (done / "again" / "scores.csv").read_bytes() == (done / "out" / "scores.csv").read_bytes()


@dataclass(frozen=True, eq=False)
class Watched(CameraSubject):
    """Keeps what it was asked to render."""

    asked: Any = None

    def render(self, weather: Weather, seed: int, effects: Sequence[Mapping[str, Any]] = ()) -> Tensor:
        self.asked.append((self.name, weather, seed))
        return super().render(weather, seed, effects)


def test_a_frame_keeps_its_storm_over_all_severities_and_frames_differ(tmp_path: Path) -> None:
    asked: list[tuple[str, Weather, int]] = []
    camera = Camera.preset("lucid-triton").resized(16, 16)
    truth = BoxTruth(np.array([BOX]), ("car",), np.zeros(1, bool))
    light = {"airlight": 0.6}
    frames = [
        LabelledFrame(
            name,
            Watched(name, torch.rand(1, 16, 16), torch.full((1, 16, 16), 9.0), camera, options=light, asked=asked),
            truth,
        )
        for name in ("a", "b")
    ]
    detector = OnnxDetector(camera_model(tmp_path), read_declaration(tmp_path / "model.yaml"))
    suite = SuiteRecipe(
        "rain", "", {"kind": "camera"}, {"rain": {"kind": "rain", "rate_mm_per_h": [1.0, 5.0, 10.0, 20.0, 40.0]}}
    )
    run_robustness(frames, detector, suite.conditions(), seeds=2, metrics=[])
    seeds = {name: {seed for frame, _, seed in asked if frame == name} for name in ("a", "b")}
    assert len(asked) == 2 * 5 * 2
    assert len(seeds["a"]) == len(seeds["b"]) == 2
    assert not seeds["a"] & seeds["b"]


def test_points_of_a_cloud_are_judged_and_those_of_the_weather_are_false_alarms(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    (folder / "clouds").mkdir(parents=True)
    (folder / "labels").mkdir()
    angle = torch.linspace(-1.0, 1.0, 400)
    range_m = torch.full((400,), 15.0)
    points = torch.stack([range_m * angle.cos(), range_m * angle.sin(), torch.zeros(400), torch.full((400,), 0.3)], 1)
    points.numpy().astype("<f4").tofile(folder / "clouds" / "a.bin")
    classes = (range_m > 20.0).long()
    write_labels(folder / "labels" / "a.label", PointLabels(classes, torch.zeros_like(classes)))
    model = near_points(tmp_path / "model.onnx", 20.0)
    declared(
        model,
        sensor="lidar",
        input={"name": "points"},
        decoder="segmentation",
        outputs={"logits": "logits"},
        classes=["near", "far"],
    )
    command = ["robustness", "--model", str(model), "--data", str(folder), "--out", str(tmp_path / "out"), "--quiet"]
    command += [
        "--recipe",
        str(own_suite(tmp_path, "lidar")),
        "--sensor",
        "lidar:velodyne-hdl-64e",
        "--metrics",
        "none",
    ]
    assert main([*command, "--intensity-unit", "reflectivity"]) == 0
    found = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert found["clear"] == 1.0
    near = [each["by_class"]["near"] for each in found["conditions"]]
    assert near[-1] < 0.9 < near[0]  # fog's echoes are near, and none of them is a point of the class
    assert not (tmp_path / "out" / "correlation").exists()


def test_pixels_of_colour_images_are_judged(tmp_path: Path) -> None:
    """A white half and a black one: fog makes the black one brighter than a half."""
    folder = tmp_path / "data"
    (folder / "images").mkdir(parents=True)
    (folder / "labels").mkdir()
    image = torch.zeros(3, *SIZE, dtype=torch.uint8)
    image[:, :, 32:] = 255
    write_image(folder / "images" / "a.png", image)
    write_image(folder / "labels" / "a.png", (image[:1] > 0).to(torch.uint8))
    model = bright_pixels(tmp_path / "model.onnx")
    declared(
        model,
        sensor="camera",
        input={"name": "image"},
        decoder="segmentation",
        outputs={"logits": "logits"},
        classes=["dark", "bright"],
    )
    own_suite(tmp_path)
    assert main([*arguments(tmp_path), "--depth", "30"]) == 0
    found = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert found["measure"] == "mIoU"
    assert found["clear"] == 1.0
    assert found["conditions"][0]["performance"] > 0.9
    # Everything is bright: of the dark half nothing is found, of the bright one all, and as much again.
    assert found["conditions"][-1]["by_class"] == {"dark": 0.0, "bright": 0.5}


def test_known_depth_is_named_and_heads_nothing(done: Path) -> None:
    found = json.loads((done / "out" / "robustness.json").read_text())
    assert (found["headline"], found["depth"]) == ("", "exact")
    assert "guessed" not in (done / "out" / "index.html").read_text(encoding="utf-8")


def replaced(flag: str, value: str) -> Callable[[Path, list[str]], list[str]]:
    def change(_: Path, command: list[str]) -> list[str]:
        place = command.index(flag) if flag in command else len(command)
        return [*command[:place], flag, value, *command[place + 2 :]]

    return change


def emptied(name: str) -> Callable[[Path, list[str]], list[str]]:
    def change(folder: Path, command: list[str]) -> list[str]:
        target = folder / "data" / name
        if target.is_dir():
            shutil.rmtree(target)
            target.mkdir()
        else:
            target.unlink()
        return command

    return change


def renamed_frame(folder: Path, command: list[str]) -> list[str]:
    (folder / "data" / "images" / "1.png").rename(folder / "data" / "images" / "x.png")
    return command


def drawn_weather(folder: Path, command: list[str]) -> list[str]:
    recipe = yaml.safe_load((recipes_folder() / "camera" / "rain-25mm-per-h.yaml").read_text())
    recipe["weather"]["rate_mm_per_h"] = [1.0, 50.0]
    (folder / "drawn.yaml").write_text(yaml.safe_dump(recipe))
    return replaced("--recipe", str(folder / "drawn.yaml"))(folder, command)


WRONG: dict[str, tuple[Callable[[Path, list[str]], list[str]], str]] = {
    "decoder": (with_declaration(decoder="boxen"), "decoder must be one of boxes, yolov8"),
    "input": (with_declaration(input={"name": "picture"}), "the declaration names input 'picture'"),
    "empty folder": (emptied("images"), "no images; expected"),
    "no truth": (emptied("annotations.json"), "expected JSON with ground truth, COCO's"),
    "truth of another frame": (renamed_frame, "no ground truth for x"),
    "no depth": (emptied("depth"), "no depth map for 0.png"),
    "no data": (replaced("--data", "/nowhere/at/all"), "no such folder"),
    "suite of another sensor": (replaced("--recipe", "lidar/robustness"), "lidar/robustness is for a lidar"),
    "recipe of another sensor": (replaced("--recipe", "imaging-fog-20m"), "radar/imaging-fog-20m is for a radar"),
    "unknown recipe": (replaced("--recipe", "camera/robustnes"), "Did you mean 'camera/robustness'"),
    "drawn weather": (drawn_weather, "a condition is one weather"),
    "several sensors": (
        replaced("--recipe", "multi_sensor/training-mix"),
        "is of kind multi_sensor; expected suite or transform",
    ),
    "sensor": (replaced("--sensor", "lidar:os1"), "--sensor is a lidar; the detector is for a camera"),
    "argument of a lidar": (replaced("--max-range-m", "50"), "--max-range-m is for a lidar"),
    "overlap": (replaced("--iou", "50"), "--iou must be numbers in (0, 1]"),
    "metric": (replaced("--metrics", "pnsr"), "Did you mean 'psnr'"),
    "seeds": (replaced("--seeds", "0"), "seeds must be 1 or more"),
    "baseline": (replaced("--baseline", "/nowhere"), "expected JSON with the result of another run"),
}


@pytest.mark.parametrize("what", list(WRONG))
def test_what_is_wrong_is_one_line_and_nothing_is_written(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera_data(tmp_path / "data")
    camera_model(tmp_path)
    own_suite(tmp_path)
    change, message = WRONG[what]
    assert main(change(tmp_path, arguments(tmp_path))) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.rglob(".*"))


def test_a_disk_that_is_full_leaves_what_was_there(
    done: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in (done / "out").rglob("*") if path.is_file()}
    write = Path.write_text

    def full(self: Path, text: str, **options: Any) -> int:
        if "index" in self.name:
            write(self, text[:100], **options)
            raise OSError(28, "No space left on device", str(self))
        return write(self, text, **options)

    monkeypatch.setattr(Path, "write_text", full)
    assert main(arguments(done)) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (done / "out").rglob("*") if path.is_file()} == before
    assert not list(done.rglob(".*"))


def test_a_recipe_is_one_condition(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*arguments(done, out="one", **{"--recipe": "fog-30m"}), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(each["weather"], each["severity"], each["value"]) for each in found["conditions"]] == [
        ("fog-30m", 1, 30.0)
    ]
    assert found["correlation"] is None


def test_the_default_is_the_suite_of_the_sensor() -> None:
    assert read_recipe("camera/robustness", "suite").sensor_kind == "camera"
