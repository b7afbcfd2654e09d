"""``torchweather gap``: its files, what it says where, and what it refuses."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gap import studies
from tests.report.made_up_gaps import report
from torchweather.cli import main
from torchweather.gap import find
from torchweather.gap.gap_report import GapReport
from torchweather.gap.study.study import Study

pytestmark = pytest.mark.usefixtures("undrawn")

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    studies.study("lidar").write(tmp_path / "study")
    return tmp_path / "study"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The search replaced by a made-up one; the arguments that it was called with."""
    given: dict[str, Any] = {"verdict": "named"}

    def made_up(study: Study, *, progress: Callable[[str], None], **arguments: Any) -> GapReport:
        given.update(arguments)
        progress("response curves")
        return report(given["verdict"], study)

    monkeypatch.setattr(find, "find_gap", made_up)
    return given


@pytest.mark.parametrize("verdict", ["none", "named", "named_and_rest", "unknown"])
def test_every_verdict_is_an_answer(
    verdict: str, folder: Path, asked: dict[str, Any], tmp_path: Path, capsys: Capture
) -> None:
    asked["verdict"] = verdict
    out = tmp_path / "out"
    assert main(["gap", str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert said.err == "torchweather: response curves\n"
    assert said.out.endswith(f"\nwrote {out / 'report.html'}\n")
    assert ("lacks window loss" in said.out) == (verdict == "named")
    assert sorted(file.name for file in out.iterdir()) == ["gap.json", "model.yaml", "report.html"]
    assert json.loads((out / "gap.json").read_text(encoding="utf-8"))["verdict"] == verdict


def test_arguments_reach_the_search(folder: Path, asked: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    names = "lidar.window_loss, lidar.threshold_shift"
    arguments = ["gap", str(folder), "--out", str(tmp_path / "out"), "--seed", "5", "--effects", names, "--quiet"]
    assert main([*arguments, "--json"]) == 0
    assert (asked["seed"], asked["effects"]) == (5, ["lidar.window_loss", "lidar.threshold_shift"])
    said = capsys.readouterr()
    assert said.err == ""
    assert json.loads(said.out) == json.loads((tmp_path / "out" / "gap.json").read_text(encoding="utf-8"))


def test_without_effects_the_whole_catalogue_is_asked_for(folder: Path, asked: dict[str, Any], tmp_path: Path) -> None:
    assert main(["gap", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert (asked["seed"], asked["effects"]) == (0, None)


def one_condition(kind: str, **more: Any) -> dict[str, Any]:
    given = studies.arguments(kind)
    return {**given, "conditions": [{**given["conditions"][0], **more}]}


def one_clear_frame() -> Study:
    return studies.study("lidar", clear=1)


def copies() -> Study:
    """The frames of a condition are one frame, five times."""
    given = studies.arguments("lidar")
    first = given["conditions"][0]
    return Study.from_arrays(**{**given, "conditions": [{**first, "frames": first["frames"][:1] * 5}]})


def nothing_held_out() -> Study:
    given = studies.arguments("lidar")
    return Study.from_arrays(**{**given, "conditions": [{**one, "split": "fit"} for one in given["conditions"]]})


def no_weather() -> Study:
    return Study.from_arrays(**one_condition("lidar", weather="clear"))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (one_clear_frame, "has one clear frame"),
        (copies, "has 4 of 5 frames that repeat another one"),
        (nothing_held_out, "others held out; got 4 and 0"),
        (no_weather, "No condition has weather"),
        (lambda: studies.study("camera"), "expected 48 or more either way"),
        (lambda: studies.study("radar"), "power_db: expected targets that most clear frames have"),
        (lambda: studies.study("link"), "12 samples or more in a class of rain"),
    ],
)
def test_a_study_that_allows_no_answer_is_refused(
    make: Callable[[], Study], said: str, tmp_path: Path, capsys: Capture
) -> None:
    make().write(tmp_path / "study")
    assert main(["gap", str(tmp_path / "study"), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["study"]


def test_a_broken_frame_is_named(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    broken = sorted(file for file in folder.rglob("*.npz") if "range_m" in np.load(file))[-1]
    values = dict(np.load(broken))
    np.savez(broken, **{**values, "range_m": np.full_like(values["range_m"], math.nan)})
    assert main(["gap", str(folder), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    error = capsys.readouterr().err
    assert broken.name in error
    assert "range_m" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere/study.yaml: no such file"),
        (["nowhere", "--effects", " , "], "--effects must name an effect or more"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], said: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["gap", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_parts_of_no_picture_are_refused(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    arguments = ["gap", str(folder), "--out", str(tmp_path / "out"), "--ignore-parts", "s0:0,32", "--quiet"]
    assert main(arguments) == 2
    assert "expected a Camera; got kind" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_effect_that_does_not_exist_is_refused(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    arguments = ["gap", str(folder), "--out", str(tmp_path / "out"), "--effects", "lidar.window_los", "--quiet"]
    assert main(arguments) == 2
    assert "lidar.window_loss" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
