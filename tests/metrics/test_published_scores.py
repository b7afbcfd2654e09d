"""The published scores: all numeric cells of Tables 12, 14 and 15, and the contradictions METRICS.md names."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from importlib import resources

import pytest

from torchweather.cli import main
from torchweather.metrics import d34
from torchweather.metrics.d34 import (
    Inconsistency,
    TrendCell,
    inconsistencies,
    published_direction,
    published_scores,
    trend_cells,
)

CELLS = trend_cells()
NUMERIC = [cell for cell in CELLS if cell.published is not None]
FOUND = {each.name: each for each in inconsistencies()}


def test_the_appendix_is_whole() -> None:
    rows = published_scores()
    assert len(rows) == 1638
    assert Counter(row.sensor for row in rows) == {"camera": 72 * 14, "lidar": 64 * 6, "radar4d": 41 * 6}
    assert {row.metric for row in rows} == set(published_direction())


def test_fog_gets_worse_as_the_visibility_falls() -> None:
    conditions = {row.condition: row.severity for row in published_scores() if row.weather == "fog"}
    assert conditions["10m"] > conditions["20m"] > conditions["50m"] > conditions["400m"]


def test_there_are_56_numbers_in_three_tables() -> None:
    assert len(CELLS) == 87
    assert Counter(cell.table for cell in NUMERIC) == {12: 23, 14: 20, 15: 13}
    assert all(cell.computed is None for cell in CELLS if cell.published is None)  # no scores there either


@pytest.mark.parametrize("cell", NUMERIC, ids=lambda cell: f"{cell.table}-{cell.weather}-{cell.scene}-{cell.source}")
def test_every_number_is_that_of_the_appendix(cell: TrendCell) -> None:
    assert cell.computed == cell.published
    assert len(cell.metrics) == cell.computed
    assert set(cell.metrics) <= set(published_direction())
    assert cell.levels >= 2


def test_without_the_rule_the_numbers_do_not_come_out(monkeypatch: pytest.MonkeyPatch) -> None:
    # Turned metrics, or the baseline row counted as a level, must be seen.
    turned = {name: "down" if way == "up" else "up" for name, way in published_direction().items()}
    with monkeypatch.context() as patched:
        patched.setattr(d34, "published_direction", lambda: turned)
        assert sum(cell.computed == cell.published for cell in trend_cells() if cell.published is not None) < 20
    with monkeypatch.context() as patched:
        patched.setattr(d34.PublishedScore, "baseline", property(lambda self: False))
        wrong = [cell.scene for cell in trend_cells() if cell.published is not None and cell.computed != cell.published]
        assert wrong == ["PDD"]


@pytest.mark.parametrize(
    ("name", "found", "of"),
    [
        ("mmde_not_above_mde", 105, 105),
        ("rmse_below_mde", 23, 23),
        ("hd_below_mde", 30, 105),
        ("repeated_scene", 1, None),
        ("psnr_white", 2, 9),
        ("vif_rises_with_fog", 9, 9),
        ("one_snow_rate_decides", 28, 28),
    ],
)
def test_contradictions_are_as_metrics_md_counts_them(name: str, found: int, of: int | None) -> None:
    each = FOUND[name]
    assert each.found == found
    assert of is None or each.of == of


def test_contradictions_say_where_and_how_much() -> None:
    assert FOUND["repeated_scene"].where == "10.3.4"
    assert "all 18 scores at 56 m are those at 28 m" in FOUND["repeated_scene"].detail
    assert FOUND["psnr_white"].where == "10.1.3, 10.1.9"
    assert "48.13 dB" in FOUND["psnr_white"].why
    assert "84.11 to 91.22 dB" in FOUND["psnr_white"].detail
    assert FOUND["vif_above_one"].detail == "up to 1.4065"
    assert FOUND["vif_above_one"].where == "10.1.8"
    assert FOUND["one_snow_rate_decides"].detail.count("0 of 14, without that row 14 of 14") == 2
    two = FOUND["two_conditions"]
    assert two.found == sum(cell.levels == 2 for cell in NUMERIC) > 0


def test_contradictions_are_counted_from_the_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = published_scores()
    cured = tuple(row for row in rows if row.appendix != "10.3.4" or row.distance_m != "56")
    monkeypatch.setattr(d34, "published_scores", lambda: cured)
    fewer: dict[str, Inconsistency] = {each.name: each for each in inconsistencies()}
    assert fewer["repeated_scene"].found == 0
    assert fewer["mmde_not_above_mde"].of == 102


def test_the_figures_lie_beside_their_source() -> None:
    folder = resources.files("torchweather").joinpath("data", "d34")
    assert {each.name for each in folder.iterdir()} == {
        "SOURCE.txt",
        "d34_expected_trends.csv",
        "d34_metric_scores.csv",
    }
    source = folder.joinpath("SOURCE.txt").read_text(encoding="utf-8")
    assert "ROADVIEW" in source
    assert "outside this library's licence grant" in source


# ---- command -------------------------------------------------------------------------------------------------------


def test_the_command_prints_the_cells_and_the_contradictions(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["d34", "trends", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["cells"]) == 56
    assert {"table", "sensor", "weather", "scene", "source", "published", "computed"} <= set(printed["cells"][0])
    assert all(isinstance(cell["published"], int) for cell in printed["cells"])
    assert all(cell["published"] == cell["computed"] for cell in printed["cells"])
    assert len(printed["cells_without_number"]) == 31
    assert {each["name"] for each in printed["inconsistencies"]} == set(FOUND)


def test_the_command_as_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["d34", "trends"]) == 0
    text = capsys.readouterr().out
    assert "56 of 56 numbers are those of the appendix" in text
    assert "2 (coin flip)" in text
    assert "105 of 105" in text


def test_help_loads_no_torch() -> None:
    code = (
        "import sys\nfrom torchweather.cli import main\n"
        "try:\n    main(['d34', '--help'])\nexcept SystemExit as left:\n    assert left.code == 0\n"
        "assert not {'torch', 'numpy'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "trends" in done.stdout
