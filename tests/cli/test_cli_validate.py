"""``torchweather validate``: a study folder, an embedded scene, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from torchweather.atmosphere.weather import Fog, Rain
from torchweather.cli import main
from torchweather.gap.study import embedded
from torchweather.gap.study.embedded import embedded_study
from torchweather.gap.study.study import Study

pytestmark = pytest.mark.usefixtures("undrawn")

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embedded, "WEATHERS", (Rain(25.0), Fog(mor_m=50.0)))


def test_an_embedded_scene_runs_out_of_the_box(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "page"
    assert main(["validate", "scene:test-track", "--sensor", "radar", "--out", str(out), "--seed", "3"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "agree within their scatter" in said.out
    assert said.out.endswith(f"wrote {out / 'index.html'}\n")
    assert sorted(file.name for file in out.iterdir()) == ["index.html", "validation.json"]
    summary = json.loads((out / "validation.json").read_text(encoding="utf-8"))
    assert summary["self_check"] is True
    assert (summary["seed"], summary["kind"]) == (3, "radar")
    assert summary["counts"]["differ"] == 0


def test_a_study_folder_gives_the_same_twice(tmp_path: Path, capsys: Capture) -> None:
    study = embedded_study("radar", clear_frames=3, frames=2)
    study.write(tmp_path / "study")
    found = []
    for name in ("one", "two"):
        arguments = ["validate", str(tmp_path / "study"), "--out", str(tmp_path / name)]
        assert main([*arguments, "--json", "--metrics", "power_change_db, detected_share"]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[0]["study_sha256"] == Study.read(tmp_path / "study").sha256
    assert found[0]["self_check"] is False
    assert [score["score"] for score in found[0]["conditions"][0]["scores"]] == ["power_change_db", "detected_share"]
    for summary in found:
        for condition in summary["conditions"]:
            condition.pop("simulation_s")  # how long it took
    assert found[0] == found[1]


def test_errors_of_the_study_are_told(tmp_path: Path, capsys: Capture) -> None:
    study = embedded_study("radar", clear_frames=2, frames=1)
    frame = study.conditions[0].frames[0]
    scene = study.scenes["test-track"]
    twice = Study.from_arrays(
        sensor=study.sensor,
        scenes=[{"id": "s0", "clear": list(scene.clear), "geometry": scene.geometry}],
        conditions=[
            {"id": name, "scene": "s0", "weather": weather, "frames": [frame, frame]}
            for name, weather in (("light", "rain:rate=5"), ("heavy", "rain:rate=50"))
        ],
    )
    twice.write(tmp_path / "study")
    arguments = ["validate", str(tmp_path / "study"), "--out", str(tmp_path / "page"), "--metrics", "detected_share"]
    assert main(arguments) == 0
    assert "torchweather: error: " in capsys.readouterr().err
    assert main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere/study.yaml: no such file"),
        (["scene:moon"], "scene must be one of test-track, fog-tunnel"),
        (["scene:test-track", "--sensor", "sonar"], "--sensor must be one of lidar, camera, radar; got 'sonar'"),
        (["scene:test-track", "--sensor", "radar:nothing"], "preset must be one of"),
        (["nowhere", "--sensor", "radar"], "--sensor belongs to scene:NAME"),
        (["scene:test-track", "--sensor", "radar", "--metrics", "psnr"], "score must be one of power_change_db"),
        (["scene:test-track", "--sensor", "radar", "--metrics", ","], "--metrics must name a score or more"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], said: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["validate", *arguments, "--out", str(tmp_path / "page")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_named_effects_stand_on_the_page(tmp_path: Path, capsys: Capture) -> None:
    arguments = ["validate", "scene:test-track", "--sensor", "radar", "--metrics", "power_change_db", "--quiet"]
    effects = ["--power-effects", "radar.wet_rcs, radar.range_migration"]
    assert main([*arguments, *effects, "--out", str(tmp_path)]) == 0
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Effects that these frames could have shown" in page
    assert "gain_db, dB" in page
    assert "Not tried. radar.range_migration: " in page
    assert "effects" not in str(capsys.readouterr().err)
    for given, said in ((",", "must name an effect or more"), ("radar.wet_rc", "must be one of")):
        assert main([*arguments, "--power-effects", given, "--out", str(tmp_path)]) == 2
        assert said in capsys.readouterr().err
