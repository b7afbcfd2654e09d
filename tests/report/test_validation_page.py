"""The page of a validation: whole, self-contained, and its numbers are those of the result."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gap import studies
from tests.report.parsed_page import Page
from torchweather.evaluation.validation.run import Validation, validate
from torchweather.gap.diagnosis import Finding
from torchweather.gap.study.embedded import embedded_study
from torchweather.gap.study.study import Study
from torchweather.report import validation_page
from torchweather.report.validation_figures import lidar_above_uri
from torchweather.report.validation_page import write_validation

Written = tuple[Path, Study, Validation]


@pytest.fixture(scope="module")
def radar(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("pages") / "radar"
    study = embedded_study("radar", clear_frames=4, frames=3)
    wet = replace(
        study,
        conditions=tuple(
            replace(each, frames=type(each.frames)([weaker(f) for f in each.frames], lambda f, _: f, each.id))
            for each in study.conditions
        ),
    )
    validation = validate(wet, seed=3)
    write_validation(folder, wet, validation)
    return folder, wet, validation


@pytest.fixture(scope="module")
def short(radar: Written) -> tuple[Study, Validation]:
    """One condition and one score, whose page is drawn in a second."""
    study = replace(radar[1], conditions=radar[1].conditions[:1])
    return study, validate(study, seed=3, names=["power_change_db"])


def weaker(frame: Any) -> Any:
    return {**frame, "power_db": frame["power_db"] - 6.0}


def text_of(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def test_the_page_is_whole_and_loads_nothing(radar: Written) -> None:
    text = text_of(radar[0])
    page = Page(text)
    assert page.mistakes == []
    assert all(image.get("alt") for image in page.all("img"))
    assert all(str(attrs["src"]).startswith("data:image/") for _, attrs in page.elements if "src" in attrs)
    assert not page.all("script")
    assert "http:" not in text
    assert "https:" not in text
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for link in page.all("a"):
        assert (radar[0] / str(link["href"])).is_file()


def test_the_verdict_and_the_differences_stand_on_the_page(radar: Written) -> None:
    folder, _, validation = radar
    text = text_of(folder)
    assert validation.verdict() in text
    differ = sum(score.verdict == "differs" for each in validation.conditions for score in each.scores)
    assert differ >= 12  # 6 dB of power in every condition
    # In the matrix, in the list of all numbers, and once in the legend.
    cells = re.findall(r'<td class="differs">', text)
    assert len(cells) == 2 * differ
    assert "Nothing was measured here" not in text
    assert "torchweather gap" in text


def test_the_json_holds_what_was_found(radar: Written) -> None:
    folder, study, validation = radar
    summary = json.loads((folder / "validation.json").read_text(encoding="utf-8"))
    assert summary["study_sha256"] == study.sha256
    assert summary["verdict"] == validation.verdict()
    assert summary["self_check"] is False
    gaps = [score["gap"] for each in summary["conditions"] for score in each["scores"]]
    assert gaps == [score.gap for each in validation.conditions for score in each.scores]
    assert len(summary["trends"]) == 3


@pytest.mark.usefixtures("undrawn")
def test_errors_of_the_study_stand_beside_the_verdict(
    radar: Written, short: tuple[Study, Validation], tmp_path: Path
) -> None:
    study, validation = short
    broken = Finding("error", "Frames stand twice.", "Their <scatter> is not known.", "Take others.")
    write_validation(tmp_path / "page", study, replace(validation, findings=(broken,)))
    header = text_of(tmp_path / "page").partition("</header>")[0]
    assert "cannot be trusted.</strong> Frames stand twice. Their &lt;scatter&gt; is not known." in header
    assert "cannot be trusted" not in text_of(radar[0])


@pytest.mark.usefixtures("undrawn")
def test_a_self_check_says_that_nothing_was_measured(short: tuple[Study, Validation], tmp_path: Path) -> None:
    study, validation = short
    write_validation(tmp_path / "page", study, validation, self_check=True)
    assert "Nothing was measured here" in text_of(tmp_path / "page")


@pytest.mark.filterwarnings("ignore:.*no sky.*")
@pytest.mark.parametrize("kind", ["lidar", "link"])
def test_every_kind_has_its_pictures(kind: str, tmp_path: Path) -> None:
    study = studies.study(kind)
    validation = validate(study, seed=1)
    write_validation(tmp_path / "page", study, validation)
    page = Page(text_of(tmp_path / "page"))
    assert page.mistakes == []
    strongest = 1 if kind == "link" else 3 * len({(c.scene, c.weather.kind) for c in study.conditions if c.weather})
    figures = 1 if kind == "link" else len(validation.conditions[0].scores)
    assert len(page.all("img")) == strongest + figures


def test_pictures_of_a_camera_are_developed_alike(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    depth_m = np.full((studies.H, studies.W), 30.0)
    depth_m[:2] = np.inf
    shots = [{"bayer": np.clip(0.3 + 0.01 * rng.standard_normal((studies.H, studies.W)), 0, 1)} for _ in range(5)]
    study = Study.from_arrays(
        sensor=studies.CAMERA,
        scenes=[{"id": "<b>yard</b>", "clear": shots[:3], "geometry": {"depth_m": depth_m}}],
        conditions=[{"id": "c0", "scene": "<b>yard</b>", "weather": "fog:mor=60", "frames": shots[3:]}],
    )
    write_validation(tmp_path / "page", study, validate(study, seed=1))
    text = text_of(tmp_path / "page")
    page = Page(text)
    assert page.mistakes == []
    assert len(page.all("img")) == 3 + 3
    assert "Left out. MS-SSIM" in text


def test_a_return_in_front_is_told_from_one_that_stayed() -> None:
    direction = studies.directions(np.random.default_rng(0))
    clear = {"range_m": np.full((studies.H, studies.W), 20.0)}
    same = lidar_above_uri(clear, clear, direction)
    jitter = lidar_above_uri({"range_m": clear["range_m"] - 0.4}, {"range_m": clear["range_m"] - 0.4}, direction)
    nearer = lidar_above_uri({"range_m": clear["range_m"] - 0.6}, clear, direction)
    assert len({same, jitter, nearer}) == 3


@pytest.mark.usefixtures("undrawn")
def test_a_failure_leaves_no_file(
    short: tuple[Study, Validation], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **__: object) -> str:
        raise RuntimeError("disk on fire")

    monkeypatch.setattr(validation_page, "write_report", stop)
    with pytest.raises(RuntimeError, match="disk on fire"):
        write_validation(tmp_path / "a" / "b", *short)
    assert list(tmp_path.iterdir()) == []
