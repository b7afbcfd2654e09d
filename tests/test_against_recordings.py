"""The table of recordings: its verdicts against simulation, and wrong physics on made stand-ins turns them over."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.running_examples import load_example, run_example

EXAMPLE = "against_recordings.py"
PAGE = Path(__file__).parents[1] / "docs" / "against-recordings.md"
UNITS = 8


@pytest.fixture(scope="module")
def verdicts() -> Any:
    return load_example("parts/verdicts.py")


def test_intervals_cover_and_the_stated_factor_is_seen(verdicts: Any) -> None:
    """6 units that scatter by 20 %: 90 % of the intervals hold the truth, 80 % of studies show the stated factor."""
    rng = np.random.default_rng(0)
    noise = 0.2 * rng.standard_normal((1000, 6))
    rows = [verdicts.row_of("a", "b", np.exp(one)) for one in noise]
    assert np.mean([row.low <= 1.0 <= row.high for row in rows]) == pytest.approx(0.9, abs=0.03)  # 3 sigma: 0.03
    factor = float(np.median([row.seen_from for row in rows]))
    moved = [verdicts.row_of("a", "b", factor * np.exp(one)) for one in noise]
    # The factor of a study of few units scatters with its own deviation: the median of them is seen in 0.75 to 0.85.
    assert np.mean([row.verdict == "inconsistent" for row in moved]) == pytest.approx(0.8, abs=0.05)


def test_verdicts(verdicts: Any) -> None:
    row = verdicts.Row
    assert row("a", "b", 6, 1.0, 0.9, 1.2, 1.3).verdict == "consistent within 1.20"
    assert row("a", "b", 6, 1.0, 0.7, 1.2, 1.3).verdict == "consistent within 1.43"
    assert row("a", "b", 6, 1.0, 0.4, 2.0, 2.5).verdict == "not decided"
    assert row("a", "b", 6, 1.5, 1.1, 2.0, 2.5).verdict == "inconsistent"
    with pytest.raises(ValueError, match="2 or more units"):
        verdicts.row_of("a", "b", [1.0, float("inf")])


LIDAR = tw.Lidar(905.0, elevations_deg=(-2.0, 2.0), columns=4, intensity_unit="reflectivity")


def loss_of_objects(options: dict[str, Any], seed: int) -> float:
    """Mean logarithm that objects at 10 to 40 m lose in rain."""
    rng = np.random.default_rng(seed)
    points = torch.zeros(400, 4)
    points[:, 0] = torch.from_numpy(rng.uniform(10.0, 40.0, 400))
    points[:, 3] = 0.5
    result = tw.LidarRain(tw.Rain(25.0), LIDAR, **options).run(points, seed=seed)
    seen = result.kind == tw.PointKind.OBJECT
    return float(-(result.points[seen, 3] / 0.5).log().mean())


def share_of_flakes(weather: dict[str, Any], seed: int) -> float:
    """Share of beams into the sky that return a flake."""
    along = torch.tensor([[1.0, 0.0, 0.3]]).expand(3000, 3) / 1.0440307
    result = tw.LidarSnow(tw.Snow(1.0, **weather), LIDAR).run(torch.zeros(3000, 4), seed=seed, directions=along)
    return float((result.kind == tw.PointKind.PARTICLE).float().mean())


CAMERA = tw.Camera.from_intrinsics(100.0, 100.0, 15.5, 11.5, 32, 24)


def brightness_in_fog(options: dict[str, Any], seed: int) -> float:
    """Brightness of a dark wall in fog over that in clear air."""
    depth_m = float(np.random.default_rng(seed).uniform(20.0, 40.0))
    wall = torch.full((1, 24, 32), 0.1)
    found = tw.BayerFog(tw.Fog(mor_m=200.0), CAMERA, depth=depth_m, **{"airlight": 0.4, **options})(wall)
    assert isinstance(found, Tensor)
    return float(found.mean() / 0.1)


@pytest.mark.parametrize(
    ("measure", "right", "wrong"),
    [
        pytest.param(loss_of_objects, {}, {"q_eff": 1.5 * 1.1}, id="extinction-1.5"),
        pytest.param(share_of_flakes, {}, {"flake_reflectivity": 1.0}, id="flakes-4"),
        pytest.param(brightness_in_fog, {}, {"airlight": 0.8}, id="airlight-2"),
    ],
)
def test_wrong_physics_turns_a_row_over(
    verdicts: Any,
    measure: Callable[[dict[str, Any], int], float],
    right: dict[str, Any],
    wrong: dict[str, Any],
) -> None:
    """Stand-ins: recorded values are the library's with 10 % of scatter of their own and other random numbers."""
    scatter = np.exp(0.1 * np.random.default_rng(5).standard_normal(UNITS))
    seeds = range(UNITS)
    recorded = [measure(right, seed if measure is not share_of_flakes else seed + 100) for seed in seeds] * scatter
    same, other = ([measure(options, seed) for seed in seeds] / recorded for options in (right, wrong))
    before, after = (verdicts.row_of("made", measure.__name__, ratios) for ratios in (same, other))
    assert before.seen_from < verdicts.BOUND
    assert before.verdict.startswith("consistent within")
    assert after.verdict == "inconsistent"


def test_rows_of_the_highway_are_those_of_its_example() -> None:
    example = load_example(EXAMPLE)
    curve = {"recorded": [1.0, 1.0, 2.0], "simulated": [1.5, 1.5, 2.0]}
    found = {
        "blocks": [
            {"meter_m": 200.0, "fits": {"measured_airlight": [ratio * 200.0], "local_contrast": [50.0]}}
            for ratio in (0.9, 1.1)
        ],
        "depth_edges_m": [8.0, 10.0, 50.0, 100.0],
        "brightness_over_clear": {"a": curve, "b": curve},
    }
    fitted, contrast, near, far = example.highway_rows(found)
    assert fitted.ratio == pytest.approx((0.9 * 1.1) ** 0.5)
    assert contrast.ratio == pytest.approx(0.25)
    assert (near.ratio, far.ratio) == (pytest.approx(1.5), pytest.approx(1.0))


def test_without_recordings_it_says_what_it_needs(tmp_path: Path) -> None:
    done = run_example(EXAMPLE, [], tmp_path)
    assert done.returncode == 1
    assert "TORCHWEATHER_REAL_DATA" in done.stderr


@pytest.mark.long
@pytest.mark.real_data
def test_links_and_drops_as_the_page_has_them(tmp_path: Path) -> None:
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root:
        pytest.skip("TORCHWEATHER_REAL_DATA is not set: no real recordings here")
    for name in ("links", "drops"):
        done = run_example(EXAMPLE, ["--only", name, "--data", root], tmp_path)
        assert done.returncode == 0, done.stderr
        page = PAGE.read_text(encoding="utf-8")
        for line in done.stdout.splitlines()[2:]:
            assert line in page
