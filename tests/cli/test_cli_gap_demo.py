"""``torchweather gap demo``: the truth is sealed before the search, opened after it, and shown beside the answer."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from tests.report.made_up_gaps import report
from torchweather.cli import main
from torchweather.cli.gap_demo import outcome
from torchweather.gap import find
from torchweather.gap.gap_report import GapReport
from torchweather.gap.study import hidden as hidden_study
from torchweather.gap.study.hidden import HiddenStudy, drawn_study
from torchweather.gap.study.study import Study

pytestmark = pytest.mark.usefixtures("undrawn")

Capture = pytest.CaptureFixture[str]
WINDOW_LOSS, NOTHING = 2, 3  # seeds that draw it


@lru_cache
def small_study(seed: int, **options: Any) -> HiddenStudy:
    """Few columns, drawn once for all tests that ask for this seed."""
    return drawn_study(seed, columns=16, **options)


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A smaller study, and the search replaced by one whose answer is made up; what it was called with."""
    given: dict[str, Any] = {"verdict": "named", "first": lambda: None}

    def made_up(study: Study, *, progress: Callable[[str], None], **arguments: Any) -> GapReport:
        given["first"]()
        given.update(arguments, study=study.sha256)
        progress("response curves")
        return report(given["verdict"], study)

    monkeypatch.setattr(find, "find_gap", made_up)
    monkeypatch.setattr(hidden_study, "drawn_study", small_study)
    return given


def demo(out: Path, *more: str, seed: int | None = WINDOW_LOSS) -> int:
    return main(["gap", "demo", "--out", str(out), *([] if seed is None else ["--seed", str(seed)]), *more])


def test_the_truth_is_sealed_before_the_search(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    seen: dict[str, str] = {}

    def look() -> None:
        seen["told"] = capsys.readouterr().err
        seen["sha256"] = hashlib.sha256((tmp_path / "truth.json").read_bytes()).hexdigest()

    searched["first"] = look
    assert demo(tmp_path, "--quiet") == 0
    assert f"SHA-256 {seen['sha256']}\n" in seen["told"]


def test_the_search_has_the_folder_and_the_folder_does_not_tell(searched: dict[str, Any], tmp_path: Path) -> None:
    assert demo(tmp_path) == 0
    assert searched["study"] == Study.read(tmp_path / "study").sha256
    assert not {"effects", "model_effects"} & set(searched)  # the whole catalogue, on a plain model
    assert "window" not in (tmp_path / "study" / "study.yaml").read_text(encoding="utf-8")


def test_a_truth_that_was_changed_is_not_opened(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    searched["first"] = lambda: (tmp_path / "truth.json").write_text('{"effects": []}', encoding="utf-8")
    assert demo(tmp_path) == 2
    assert "truth.json: expected the file that was sealed before the search" in capsys.readouterr().err


def test_both_are_shown_side_by_side(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    assert demo(tmp_path) == 0
    lines = capsys.readouterr().out.splitlines()
    factor = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))["weather_factor"]["rain-20"]
    rows = {re.sub(r"  +", "|", line) for line in lines}
    assert "|hidden|found" in rows
    assert "lidar.window_loss loss_db|2.49 dB|0.0200 dB (0.0180 to 0.0220)" in rows
    assert f"true over recorded weather, rain-20|{factor:.3f}|1.020" in rows
    assert "Right: window loss was hidden; the search says that window loss is missing." in lines
    assert lines[-1] == f"wrote {tmp_path / 'report.html'}"
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"study", "truth.json", "gap.json", "model.yaml", "report.html"}


def test_json_holds_both(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    assert demo(tmp_path, "--json", "--allow-none", seed=NOTHING) == 0
    said = json.loads(capsys.readouterr().out)
    truth = (tmp_path / "truth.json").read_bytes()
    assert said["hidden"] == json.loads(truth)
    assert said["hidden"]["effects"] == []
    assert said["found"] == json.loads((tmp_path / "gap.json").read_text(encoding="utf-8"))
    assert (said["seed"], said["truth_sha256"]) == (NOTHING, hashlib.sha256(truth).hexdigest())
    assert not said["right"]
    assert said["outcome"].startswith("Wrong: nothing was hidden")


def test_something_is_hidden_unless_none_is_allowed(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    assert demo(tmp_path, "--json", seed=NOTHING) == 0
    assert len(json.loads(capsys.readouterr().out)["hidden"]["effects"]) == 1


def test_none_is_not_allowed_of_a_study(tmp_path: Path, capsys: Capture) -> None:
    assert main(["gap", str(tmp_path), "--out", str(tmp_path / "out"), "--allow-none"]) == 2
    assert "--allow-none belongs to the demo" in capsys.readouterr().err


def test_without_a_seed_each_demo_is_another(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    seeds = set()
    for name in ("one", "other"):
        assert demo(tmp_path / name, seed=None) == 0
        said = capsys.readouterr()
        seed = said.out.splitlines()[0]
        assert f"torchweather: {seed};" in said.err
        seeds.add(seed)
    assert len(seeds) == 2  # of 2^32


LOSS = {"name": "lidar.window_loss"}
SHIFT = {"name": "lidar.threshold_shift"}


@pytest.mark.parametrize(
    ("hidden", "verdict", "found", "right", "said"),
    [
        ([LOSS], "named", [LOSS], True, "Right: window loss was hidden; the search says that window loss is missing."),
        ([], "none", [], True, "Right: nothing was hidden; the search says that nothing is missing."),
        ([LOSS], "none", [], False, "Not found: window loss was hidden; the search says that nothing is missing."),
        ([LOSS], "named", [SHIFT], False, "Not found: window loss was hidden; the search says that threshold shift"),
        ([LOSS], "unknown", [], False, "Not found: window loss was hidden; the search says that something"),
        ([LOSS], "named", [LOSS, SHIFT], False, "Found, but not alone: window loss was hidden"),
        ([LOSS], "named_and_rest", [LOSS], False, "Found, but not alone: window loss was hidden"),
        ([], "named", [SHIFT], False, "Wrong: nothing was hidden; the search says that threshold shift is missing."),
        ([], "unknown", [], False, "Wrong: nothing was hidden; the search says that something is missing"),
    ],
)
def test_the_outcome_is_said_plainly(hidden: list[Any], verdict: str, found: list[Any], right: bool, said: str) -> None:
    judged, sentence = outcome({"effects": hidden}, {"verdict": verdict, "effects": found})
    assert judged == right
    assert sentence.startswith(said)


def test_a_wrong_answer_is_an_answer(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    searched["verdict"] = "unknown"
    assert demo(tmp_path) == 0
    assert "Not found: window loss was hidden" in capsys.readouterr().out


def test_a_study_of_another_demo_is_not_overwritten(searched: dict[str, Any], tmp_path: Path, capsys: Capture) -> None:
    assert demo(tmp_path) == 0
    before = (tmp_path / "truth.json").read_bytes()
    assert demo(tmp_path, seed=NOTHING) == 2
    assert "expected a new or an empty folder" in capsys.readouterr().err
    assert (tmp_path / "truth.json").read_bytes() == before


def test_effects_cannot_be_chosen(tmp_path: Path, capsys: Capture) -> None:
    assert demo(tmp_path / "out", "--effects", "lidar.window_loss") == 2
    assert "--effects belongs to a study" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_called_demo_is_a_study(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["gap", "./demo", "--out", "out"]) == 2
    assert "demo/study.yaml: no such file" in capsys.readouterr().err
