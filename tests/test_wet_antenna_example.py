"""The example that searches microwave links for what they lose beside rain: its parts on made numbers, then whole."""

from __future__ import annotations

import math
import os
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.running_examples import load_example, run_example
from torchweather.radar.effects.all import RadarPathLossScale, RadarWetRadome

ROOT = Path(__file__).parents[1]
EXAMPLE = "gap_wet_antenna.py"
PARTS = ("parts/link_scores.py", "parts/link_search.py", "parts/link_reports.py")


@pytest.fixture(scope="module")
def example() -> Any:
    return SimpleNamespace(**{name: value for part in PARTS for name, value in vars(load_example(part)).items()})


def recording(example: Any, rain: np.ndarray) -> Any:
    links = rain.shape[1]
    number = np.arange(links)
    return example.Recording(
        loss_db=np.zeros((0, links)),
        rain_mm_per_h=rain,
        along_mm_per_h=rain[..., None],
        model_db=0.5 * rain,
        frequency_ghz=20.0 + number,
        length_km=1.0 + number,
        vertical=number % 2,
    )


def test_covers_lose_in_rain_and_dry_after_it(example: Any) -> None:
    rain = np.array([0.0, 4.0, 0.05, 0.0, 1.0, 1.0])[:, None]
    radome = RadarWetRadome(loss_db=0.5, film_db=2.0, film_exponent=0.5, drying_min=10.0)
    found = example.with_effects(recording(example, rain), [radome])[:, 0] - 0.5 * rain[:, 0]
    five, ten = math.exp(-0.5), math.exp(-1.0)
    # 4 mm/h leave a film of 4 dB; what drizzle below 0.1 mm/h adds does not count; 15 min later the new film of 2 dB
    # is thicker than the 4 exp(-1.5) that are left.
    wanted = [0.0, 4.5, 4.0 * five + 0.5 * five, 4.0 * ten + 0.5 * ten, 2.5, 2.5]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_a_path_scale_is_a_factor(example: Any) -> None:
    rain = np.array([[1.0, 2.0], [3.0, np.nan]])
    found = example.with_effects(recording(example, rain), [RadarPathLossScale(factor=1.5)])
    np.testing.assert_allclose(found, 0.75 * rain)


def test_the_rain_of_the_reference_is_corrected_class_by_class(example: Any) -> None:
    by_condition = {"0.5 to 1 mm/h": 0.8, "0.1 to 0.5 mm/h": 1.1, "20 mm/h and more": 0.7, "after rain": 1.0}
    found = SimpleNamespace(answer={"nuisance": {"by_condition": by_condition}})
    rain = np.array([[0.05, 0.1, 0.4], [0.5, 30.0, np.nan]])
    np.testing.assert_array_equal(example.fitted_rain_factor(found, rain), [[1.0, 1.1, 1.1], [0.8, 0.7, 1.0]])
    made = recording(example, np.array([[0.4], [30.0]]))
    known = example.rain_attenuation_coefficients(torch.tensor([20.0], dtype=torch.float64))
    alpha = float(known.alpha_horizontal)
    found_db = example.with_effects(made, [], example.fitted_rain_factor(found, made.rain_mm_per_h))
    np.testing.assert_allclose(found_db, [[0.2 * 1.1**alpha], [15.0 * 0.7**alpha]])


def test_a_study_holds_out_links_and_days(example: Any) -> None:
    rain = np.zeros((2 * 288, 3))
    rain[10:12] = rain[300:302] = 5.0
    attenuation = np.ones_like(rain)
    chosen, held = np.array([True, False, True]), np.array([False, False, True])
    made = recording(example, rain)
    study = example.study_of(made, attenuation, chosen, held, example.GERMANY)
    assert study.links["split"].tolist() == [0, 1]
    assert study.links["length_km"].tolist() == [1.0, 3.0]
    even, odd = study.conditions
    assert {one.rel_sd for one in study.conditions} == {0.0}
    unsure = example.study_of(made, attenuation, chosen, held, example.GERMANY, 0.1)
    assert {one.rel_sd for one in unsure.conditions} == {0.1}
    assert (even.split, odd.split) == ("fit", "holdout")
    assert np.isfinite(even.frames[0]["attenuation_db"][:288]).all()
    assert np.isnan(even.frames[0]["attenuation_db"][288:]).all()
    assert np.isfinite(odd.frames[0]["attenuation_db"][288:]).all()
    (both,) = example.study_of(made, attenuation, chosen, held, example.GOTHENBURG).conditions
    assert np.isfinite(both.frames[0]["attenuation_db"]).all()


def test_the_least_bias_is_that_of_a_constant_and_of_each_cell(example: Any) -> None:
    number = np.array([[100, 31, 40, 30]])  # the last cell has too few samples to count
    mean, searched = np.array([[-1.0, -2.0, -4.0, 9.0]]), np.array([[-1.0, -1.0, -1.0, np.nan]])
    constant, cells = example.least_biases_db(number, mean, searched)
    assert constant == pytest.approx((1.0 + 0.0 + 2.0) / 3.0)  # of a constant of 2 dB
    assert cells == pytest.approx((0.0 + 1.0 + 3.0) / 3.0)


def test_the_searched_half_has_other_links_and_other_days(example: Any) -> None:
    rain = np.zeros((2 * 288, 4))
    rain[100:110], rain[400:410] = 5.0, 6.0
    loss_db = 50.0 + 0.1 * np.random.default_rng(0).normal(size=(2 * 288 * 5 + 20, 4))
    made = replace(recording(example, rain), loss_db=loss_db)
    alternate, whole = (example.Held(made, rules) for rules in (example.GERMANY, example.GOTHENBURG))
    for held in (alternate, whole):
        judged, searched = held.judged(0), held.searched(0)
        assert judged.any()
        assert not (judged.any(0) & searched.any(0)).any()
        assert (judged.any(0) | searched.any(0)).all()
    assert not alternate.judged(0)[:288].any()
    assert not alternate.searched(0)[288:].any()
    assert whole.judged(0)[:288].any()


def test_without_link_files_the_example_says_where_it_looks(tmp_path: Path) -> None:
    done = run_example(EXAMPLE, ["--data", "."], tmp_path)
    assert done.returncode == 1
    for word in ("--data", "TORCHWEATHER_REAL_DATA", "pycomlink", "openMRG_example.nc"):
        assert word in done.stderr


@pytest.mark.parametrize("given", ["-0.1", "1.0", "nan"])
def test_a_reference_that_is_off_by_all_or_less_than_nothing_is_refused(given: str, tmp_path: Path) -> None:
    done = run_example(EXAMPLE, ["--data", ".", f"--reference-sd={given}"], tmp_path)
    assert done.returncode == 2
    assert "--reference-sd: expected" in done.stderr


def column(text: str, label: str) -> list[float]:
    """Means of a row of scores: before and after."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {label} |"))
    return [float(value) for value in re.findall(r"([\d.]+) ±", line)]


@pytest.mark.long  # minutes
@pytest.mark.real_data
def test_measured_links_lose_at_their_wet_ends(tmp_path: Path) -> None:
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root or not all(Path(root, name).is_dir() for name in ("cml_germany", "cml_openmrg")):
        pytest.skip("TORCHWEATHER_REAL_DATA holds no cml_germany and cml_openmrg")
    done = run_example(EXAMPLE, ["--halves", "2", "--out", str(tmp_path)], tmp_path, TORCHWEATHER_REAL_DATA=root)
    assert done.returncode == 0, done.stderr
    gothenburg, germany = done.stdout.split("## Germany")
    assert gothenburg.count("| named | radar.wet_radome(") == 2  # of two halves
    assert re.search(r"^\| radar\.wet_radome\(.*\) \| named \|", gothenburg, re.MULTILINE)  # beside its rival
    # What was asked of ten halves; two of them scatter by 0.03 to 0.06 dB about it.
    assert column(gothenburg, "conditional bias")[1] < 0.33 + 0.05
    assert column(gothenburg, "5-min RMSE")[1] < 1.80 + 0.09
    assert column(gothenburg, "hourly RMSE")[1] < 1.08 + 0.06
    before, after = column(germany, "conditional bias")
    assert after < 0.7 * before
    # No constant would do much better, even one that is chosen on what is held out: 0.21 +- 0.02 dB of ten halves.
    least = re.search(r"^\| the best constant.*\| ([\d.]+) ±", germany, re.MULTILINE)
    assert least
    assert abs(float(least.group(1)) - 0.21) < 0.03
    assert after < float(least.group(1)) + 0.05
    assert "page" not in done.stderr
    assert (tmp_path / "gothenburg" / "report.html").stat().st_size > 10_000
