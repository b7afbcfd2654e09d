"""``torchweather fit``: a study folder, a folder of frames, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.evaluation.fit.test_fit_weather import camera_study, radar_study
from torchweather.cli import main

Capture = pytest.CaptureFixture[str]


def test_a_study_folder(tmp_path: Path, capsys: Capture) -> None:
    radar_study(1, true=40.0).write(tmp_path / "study")
    assert main(["fit", str(tmp_path / "study"), "--bootstrap", "50"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("c0: rain rate, recorded 10 mm/h, 8 frames\n  slope ")
    assert main(["fit", str(tmp_path / "study"), "--bootstrap", "50", "--json", "--estimators", "no_offset"]) == 0
    (condition,) = json.loads(capsys.readouterr().out)["conditions"]
    (estimate,) = condition["estimates"]
    assert estimate["intensity"]["low"] < 40.0 < estimate["intensity"]["high"]


def test_folders_of_frames(tmp_path: Path, capsys: Capture) -> None:
    study = camera_study(2, true_m=80.0)
    for name, frames in (("clear", study.scenes["s0"].clear), ("fog", study.conditions[0].frames)):
        (tmp_path / name).mkdir()
        for k, frame in enumerate(frames):
            np.save(tmp_path / name / f"{k}.npy", frame["bayer"].astype(np.float32)[None])
    np.save(tmp_path / "depth.npy", study.scenes["s0"].geometry["depth_m"].astype(np.float32))
    np.save(tmp_path / "mask.npy", np.zeros((60, 80), dtype=bool))
    (tmp_path / "camera.yaml").write_text(
        "kind: camera\nwidth: 80\nheight: 60\nfx: 4000.0\nfy: 4000.0\ncx: 39.5\ncy: 29.5\nbayer_pattern: RGGB\n"
    )
    words = ["fit", str(tmp_path / "fog"), "--clear", str(tmp_path / "clear"), "--weather", "fog:mor=200"]
    words += ["--depth", str(tmp_path / "depth.npy"), "--mask", str(tmp_path / "mask.npy")]
    words += ["--bootstrap", "50", "--json"]
    assert main([*words, "--sensor", f"camera:{tmp_path / 'camera.yaml'}"]) == 0, capsys.readouterr().err
    (condition,) = json.loads(capsys.readouterr().out)["conditions"]
    found = {each["name"]: each["intensity"]["value"] for each in condition["estimates"]}
    assert found["all_light"] == pytest.approx(80.0, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere/study.yaml: no such file"),
        (["nowhere", "--clear", "there"], "missing: --sensor, --weather"),
        (["nowhere", "--depth", "3"], "--depth belongs to a folder of frames"),
        (["nowhere", "--estimators", ","], "--estimators must name one or more"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], said: str, capsys: Capture) -> None:
    assert main(["fit", *arguments]) == 2
    assert said in capsys.readouterr().err
