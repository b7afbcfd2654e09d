"""The correlation's page carries what was found, claims included, and stands by itself."""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from torchweather.io import read_table
from torchweather.metrics.correlation import Correlation, correlate
from torchweather.metrics.image_scores import IMAGE_SCORES
from torchweather.report.correlation_figures import metric_name, weather_colours
from torchweather.report.correlation_page import correlation_summary, write_correlation

LEVELS = [("rain", 1.0), ("rain", 10.0), ("rain", 50.0), ("rain", 99.0), ("fog", 500.0), ("fog", 100.0), ("fog", 30.0)]
LEVELS += [("fog", 10.0), ("snow", 0.5), ("snow", 2.0), ("snow", 5.0), ("snow", 9.0)]


def found(**more: list[float]) -> Correlation:
    """All image scores over twelve conditions; PSNR, VIF and MDSI say little."""
    draw = np.random.default_rng(2)
    performance = np.linspace(0.9, 0.1, 12) + draw.normal(0, 0.02, 12)
    spread = {"psnr": 1.0, "vif": 1.0, "mdsi": 1.0}
    scores: dict[str, Any] = {
        name: (1 if facts.higher_is_better else -1) * performance + draw.normal(0, spread.get(name, 0.01), 12)
        for name, facts in IMAGE_SCORES.items()
    }
    table = {
        "weather": [weather for weather, _ in LEVELS],
        "value": [value for _, value in LEVELS],
        "performance": list(performance),
    }
    return correlate({**scores, **more}, table, resamples=300)


def text_of(page: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page.split("</style>")[1])).split())


@pytest.mark.usefixtures("undrawn")
def test_the_folder_holds_page_numbers_and_conditions(tmp_path: Path) -> None:
    result = found()
    summary = write_correlation(tmp_path / "out", result, performance="AP", notes=("A detector.",))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "conditions.csv",
        "correlation.json",
        "index.html",
    ]
    assert json.loads((tmp_path / "out" / "correlation.json").read_text(encoding="utf-8")) == summary
    table = read_table(tmp_path / "out" / "conditions.csv")
    assert table["performance"] == result.data.performance.tolist()
    assert table["score_ssim"] == result.data.scores["ssim"].tolist()
    assert list(table)[:2] == ["weather", "value"]


@pytest.mark.usefixtures("undrawn")
def test_the_page_says_what_was_found_beside_the_claim(tmp_path: Path) -> None:
    result = found()
    write_correlation(tmp_path, result, performance="AP", notes=("A detector.",))
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    text = text_of(page)
    assert "A detector." in text
    assert "Over 12 conditions of weather" in text
    assert "11 of the 14 image metrics correlate highly" in text
    for each in result.claim:
        says = "high" if each.claimed_high else "not high"
        assert re.search(rf"{metric_name(each.metric, unit=False)} {says} {each.found:.2f} .*? {each.verdict}", text)
    for each in result.metrics:
        assert f"{each.prediction.rmse:.3f}" in text
        assert f"{each.spearman.value:.2f}".replace("-", "−") in text
    assert page.count("<figure") == page.count("<img") == 1 + len(result.metrics)
    assert not re.search(r"https?:", page)  # nothing is loaded from elsewhere


def test_the_tally_counts_the_verdicts() -> None:
    result = found()
    claim = correlation_summary(result)["d34_claim"]
    verdicts = [each.verdict for each in result.claim]
    assert claim["agrees"] == verdicts.count("agrees") >= 11
    assert claim["agrees"] + claim["contradicts"] + claim["cannot_be_judged"] == 14


def test_what_has_no_value_is_said_and_not_drawn(tmp_path: Path) -> None:
    result = found(flat=[1.0] * 12, first=[math.inf, *range(11)], few=[1.0, 2.0, 3.0] + [math.nan] * 9)
    summary = write_correlation(tmp_path, result)
    text = text_of((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert "flat: no coefficient: all scores are equal." in text
    assert "few: no coefficient: 3 conditions with a score do not suffice, 4 would." in text
    assert "Infinite scores (equal images) are not drawn: first." in text
    flat = next(each for each in summary["metrics"] if each["metric"] == "flat")
    assert (flat["spearman"]["value"], flat["rank"]) == ("nan", None)
    assert summary["table"]["score_first"][0] == "inf"


def test_scores_without_weather_or_claim_have_a_page_too(tmp_path: Path) -> None:
    result = correlate({"mine": [1, 2, 3, 5, 4]}, [0.1, 0.2, 0.4, 0.3, 0.5])
    write_correlation(tmp_path, result)
    text = text_of((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert "The claim of D3.4" not in text
    assert "no columns weather and severity or value" in text
    write_correlation(tmp_path, correlate({"flat": [1.0] * 5}, [0.1, 0.2, 0.4, 0.3, 0.5]))
    assert "No score has a coefficient" in text_of((tmp_path / "index.html").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("undrawn")
def test_names_are_escaped(tmp_path: Path) -> None:
    write_correlation(tmp_path, correlate({"<b>x": [1, 2, 3, 5]}, [1, 2, 3, 4]), performance="<i>AP")
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "<b>x" not in page
    assert "<i>AP" not in page


def test_the_same_numbers_give_the_same_page(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_correlation(tmp_path / name, found())
    assert (tmp_path / "a" / "index.html").read_bytes() == (tmp_path / "b" / "index.html").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_nothing_is_left_of_a_page_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> str:
        raise RuntimeError("no page")

    monkeypatch.setattr("torchweather.report.correlation_page.write_report", fails)
    with pytest.raises(RuntimeError):
        write_correlation(tmp_path / "out", found())
    assert not list(tmp_path.iterdir())


def test_every_weather_has_a_colour_of_its_own() -> None:
    colours = weather_colours(["rain", "fog", "snow", "rain+fog:mor=200", "dust", "lidar rain", "ash"])
    assert len({*colours.values()}) == 7
