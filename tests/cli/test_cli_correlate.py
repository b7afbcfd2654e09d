"""``torchweather correlate``: tables in, numbers and a page out, mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from torchweather.cli import main
from torchweather.io import write_table

pytestmark = pytest.mark.usefixtures("undrawn")

LEVELS = [("rain", 1.0), ("rain", 10.0), ("rain", 50.0), ("fog", 500.0), ("fog", 100.0), ("fog", 30.0)]
AP = [0.9, 0.7, 0.6, 0.8, 0.4, 0.1]


def tables(folder: Path, suffix: str = ".csv") -> list[str]:
    """A sweep of two scores and two seeds, and the detector's performance in another order."""
    rows: list[tuple[Any, ...]] = []
    for number, ((weather, value), ap) in enumerate(zip(LEVELS, AP, strict=True)):
        for seed in (0, 1):
            intensity = "rate_mm_per_h" if weather == "rain" else "mor_m"
            start = ("track", "camera", weather, intensity, value, number % 3 + 1, seed)
            rows += [(*start, "ssim", ap + 0.01 * seed), (*start, "psnr", [20.0, 35.0, 31.0, 22.0, 30.0, 21.0][number])]
    names = ("subject", "sensor", "weather", "knob", "value", "severity", "seed", "metric", "score")
    write_table(folder / f"scores{suffix}", dict(zip(names, map(list, zip(*rows, strict=True)), strict=True)))
    shuffled = [3, 0, 5, 1, 4, 2]
    performance = {
        "weather": [LEVELS[k][0] for k in shuffled],
        "value": [LEVELS[k][1] for k in shuffled],
        "AP": [AP[k] for k in shuffled],
    }
    write_table(folder / f"ap{suffix}", performance)
    return ["correlate", str(folder / f"scores{suffix}"), str(folder / f"ap{suffix}"), "--out", str(folder / "out")]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_json_has_the_numbers_that_the_folder_has(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*tables(tmp_path, suffix), "--performance-column", "AP", "--json", "--resamples", "100"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "out" / "correlation.json").read_text(encoding="utf-8"))
    assert printed["conditions"] == 6
    assert printed["by"] == ["weather", "value"]
    first = printed["metrics"][0]
    assert first["metric"] == "ssim"
    assert first["spearman"]["value"] == pytest.approx(1.0)
    assert (tmp_path / "out" / "index.html").stat().st_size > 0


def test_text_prints_the_claim_beside_what_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*tables(tmp_path), "--performance-column", "AP"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "AP over 6 conditions"
    row = next(line.split() for line in lines if " ssim " in line)
    assert row[:3] == ["1", "ssim", "1.00"]
    assert any(line.endswith("PSNR, VIF and MDSI do not.") for line in lines)
    assert any(line.startswith("Found, high from 0.7 on: ") for line in lines)
    assert lines[-1].endswith("index.html")


def test_the_threshold_and_the_conditions_are_the_users(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [*tables(tmp_path), "--performance-column", "AP", "--json"]
    assert main([*arguments, "--highly", "0.2", "--by", "weather,value", "--seed", "3"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["d34_claim"]["highly"], printed["seed"]) == (0.2, 3)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "column 'performance'; got weather, value, AP"),
        (["--performance-column", "APs"], "Did you mean 'AP'?"),
        (["--performance-column", "AP", "--by", "seed"], "by must name columns that both tables have, weather, value"),
        (["--performance-column", "AP", "--by", "weather"], "4 conditions or more with a performance; got 2"),
    ],
)
def test_mistakes_are_told_in_one_line(
    more: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*tables(tmp_path), *more]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_table_without_scores_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables(tmp_path)
    assert main(["correlate", str(tmp_path / "ap.csv"), str(tmp_path / "ap.csv"), "--out", str(tmp_path / "out")]) == 2
    assert "ap.csv: expected the table of a sweep" in capsys.readouterr().err
