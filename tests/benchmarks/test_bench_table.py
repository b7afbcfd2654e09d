"""The table of the bench: from a score made by hand, and in the docs as it was committed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gap_bench.bars import LIDAR_BARS, against_bars
from benchmarks.gap_bench.generator.bench_sensor import bench_sensor
from benchmarks.gap_bench.scoring import score
from benchmarks.gap_bench.sealed import plain, read_json, read_lines
from benchmarks.gap_bench.steps import truth_of
from benchmarks.gap_bench.table_text import _share, bars_table, missed_table, other_figures_table

ROOT = Path(__file__).resolve().parents[2]
SCORES = ROOT / "benchmarks" / "gap_bench"
PAGES = {"gap-bench.md": SCORES / "lidar", "gap-camera.md": SCORES / "camera", "gap-radar.md": SCORES / "radar"}


def truth(case: str, family: str, *names: str) -> dict[str, Any]:
    effects = [
        {
            "name": f"lidar.{name}",
            "parameters": {"loss_db": 1.0},
            "level": 10.0,
            "identifiable": True,
            "same_form": True,
            "confusable_with": {},
        }
        for name in names
    ]
    return {"id": case, "family": family, "weather": "rain", "options": {}, "effects": effects}


def answered(case: str, verdict: str, *names: str) -> dict[str, Any]:
    effects = [
        {
            "name": f"lidar.{name}",
            "parameters": {"loss_db": 1.1},
            "interval": {"loss_db": [0.9, 1.2]},
            "confidence": 0.9,
        }
        for name in names
    ]
    report = {"verdict": verdict, "effects": effects, "gap": {"before": 4.0, "after": 1.0, "floor": 1.0}}
    return {"case": case, "seconds": 20.0, "report": report}


def test_a_row_says_what_was_reached_of_how_many_and_whether_the_bar_holds() -> None:
    truths = {
        "a": truth("a", "single", "window_loss"),
        "b": truth("b", "single", "window_loss"),
        "c": truth("c", "pair", "window_loss", "range_noise"),
        "d": truth("d", "null"),
    }
    answers = [
        answered("a", "named", "window_loss"),
        answered("b", "none"),
        answered("c", "named", "window_loss"),
        answered("d", "none"),
    ]
    found = score(truths, answers)
    lines = bars_table(found["table"], against_bars(found["table"], LIDAR_BARS)).splitlines()
    assert lines[2] == (
        "| single effects, identifiable, d' of 10 or more: exact name "
        "| >= 97 % | 1 of 2 (50 %) | 9.4 to 91 % | **no** |"
    )
    assert "| nothing hidden, whole workflow: alarms | <= 0 % | 0 of 1 (0.0 %) | 0.0 to 79 % | yes |" in lines
    assert "| seconds a study, median | <= 30 | 20 |  | yes |" in lines
    alone = score(truths, answers, alone=[{"case": case, "seconds": own} for case, own in (("a", 40.0), ("x", 1.0))])
    assert "| seconds a study, median | <= 30 | 40 (1 searched alone) |  | **no** |" in bars_table(
        alone["table"], against_bars(alone["table"], LIDAR_BARS)
    )
    assert "| nothing hidden, global test alone: alarms | <= 1 % | 0 of 0 |  | not counted |" in lines
    assert "| single effects in rain: exact name | 1 of 2 (50 %) | 9.4 to 91 % |" in other_figures_table(found["table"])
    assert missed_table(found["cases"]).splitlines()[2:] == [
        "| range noise + window loss | 10 | rain | window loss | 1 |",
        "| window loss | 10 | rain | none | 1 |",
    ]


@pytest.mark.parametrize("name", list(PAGES))
def test_the_docs_hold_the_table_that_was_committed(name: str) -> None:
    found = read_json(PAGES[name] / "score.json")
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    for text in (
        bars_table(found["table"], found["bars"]),
        other_figures_table(found["table"]),
        missed_table(read_json(PAGES[name] / "cases.json")),
    ):
        assert text in page
    assert all(len(one["truth_sha256"]) == 64 for one in found["sets"])


def test_the_pages_of_the_bench_show_no_hash() -> None:
    """Of a truth or of a commit: those are in the JSON beside the figures."""
    commits = {commit for one in SCORES.glob("*/code_commits.json") for commit in read_json(one).values()}
    assert commits
    for name, folder in PAGES.items():
        page = (ROOT / "docs" / name).read_text(encoding="utf-8")
        assert not re.search(r"\b[0-9a-f]{40}\b|\b[0-9a-f]{64}\b", page)
        assert not [commit for commit in commits if commit in page]
        assert f"gap_bench/{folder.name}/code_commits.json" in page


@pytest.mark.parametrize(
    ("hits", "of", "text"),
    [
        (0, 60, "0.0 %"),
        (2, 400, "0.5 %"),
        (3, 39, "7.7 %"),
        (996, 10000, "10 %"),
        (399, 400, "99.8 %"),
        (60, 60, "100 %"),
    ],
)
def test_a_count_that_is_not_zero_never_shows_as_nothing(hits: int, of: int, text: str) -> None:
    """Below 10 % with one decimal, and so is what is nearly all."""
    assert _share({"hits": hits, "of": of, "share": hits / of}) == f"{hits} of {of} ({text})"


@pytest.mark.parametrize("sensor", ["camera", "radar"])
def test_a_score_follows_from_the_truths_and_answers_that_are_kept(sensor: str) -> None:
    committed = read_json(SCORES / sensor / "score.json")
    folders = [SCORES / sensor / one["set"] for one in committed["sets"]]
    truths = {case: truth for folder in folders for case, truth in truth_of(folder).items()}
    answers, known = (
        [line for folder in folders for line in read_lines(folder / name)] for name in ("answers.jsonl", "known.jsonl")
    )
    found = plain(score(truths, answers, known, bench_sensor(sensor).floors))
    assert found["table"] == committed["table"]
    assert found["cases"] == read_json(SCORES / sensor / "cases.json")
    assert all(one["sealed"] in {seal["truth_sha256"] for seal in committed["sets"]} for one in answers)


def test_the_camera_s_page_quotes_earlier_sets_as_they_were_scored() -> None:
    page = (ROOT / "docs" / "gap-camera.md").read_text(encoding="utf-8")
    earlier = read_json(SCORES / "camera" / "earlier_sets.json")
    earlier["blindc2"] |= earlier.pop("blindc2-outside")
    for name, figures in earlier.items():
        row = next((line for line in page.splitlines() if line.startswith(f"| `{name}`")), None)
        if row is None:  # its figures are in the text
            continue
        for figure in ("pairs_both", "outside_unknown"):
            if figure in figures:
                assert "| {} of {} |".format(*figures[figure]) in row
