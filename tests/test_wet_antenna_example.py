"""The example that searches microwave links for what they lose beside rain: its parts on made numbers, then whole."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.running_examples import load_example, run_example
from torchweather.stages.effects_radar import RadarPathLossScale, RadarWetRadome

ROOT = Path(__file__).parents[1]
EXAMPLE = "gap_wet_antenna.py"


@pytest.fixture(scope="module")
def example() -> Any:
    return load_example(EXAMPLE)


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
    assert (even.split, odd.split) == ("fit", "holdout")
    assert np.isfinite(even.frames[0]["attenuation_db"][:288]).all()
    assert np.isnan(even.frames[0]["attenuation_db"][288:]).all()
    assert np.isfinite(odd.frames[0]["attenuation_db"][288:]).all()
    (both,) = example.study_of(made, attenuation, chosen, held, example.GOTHENBURG).conditions
    assert np.isfinite(both.frames[0]["attenuation_db"]).all()


def test_without_link_files_the_example_says_where_it_looks(tmp_path: Path) -> None:
    done = run_example(EXAMPLE, ["--data", "."], tmp_path)
    assert done.returncode == 1
    for word in ("--data", "TORCHWEATHER_REAL_DATA", "pycomlink", "openMRG_example.nc"):
        assert word in done.stderr


def column(text: str, label: str) -> list[float]:
    """Means of a row of scores: before and after."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {label} |"))
    return [float(value) for value in re.findall(r"([\d.]+) ±", line)]


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
    assert "page" not in done.stderr
    assert (tmp_path / "gothenburg" / "report.html").stat().st_size > 10_000
