"""The fast particle renderer against the one that draws every particle: mean, spread, correlation, quantiles."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.reference.every_particle import render, statistics
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather

BLOCKS: dict[str, Any] = json.loads((Path(__file__).parents[2] / "reference" / "particle_statistics.json").read_text())[
    "blocks"
]
# How far the fast path may be off: shares of the reference, correlations in absolute terms. The haze's field is
# log-normal and the listed marks approximate each column's chord.
RELATIVE = {"mean": 0.01, "std": 0.05, "quantile_99": 0.05, "quantile_99.9": 0.05}
ABSOLUTE = {f"vertical_{lag}": 0.05 for lag in (1, 2, 4, 8)}
N_SEEDS = {"rain_96x96": 60, "rain_484x366": 20, "snow_484x366": 20, "rain_corner": 60, "snow_corner": 60}


@lru_cache(maxsize=4)
def fast_statistics(block: str) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Statistics of the fast path's masks, one value a seed."""
    settings = BLOCKS[block]["settings"]
    height, width, f_px = settings["height"], settings["width"], settings["f_px"]
    principal = settings.get("principal_px") or ((width - 1) / 2, (height - 1) / 2)
    camera = Camera.from_intrinsics(f_px, f_px, *principal, width, height, exposure_s=settings["exposure_s"])
    weather = (Rain if settings["kind"] == "rain" else Snow)(settings["rate_mm_per_h"])
    transform = BayerWeather(weather, camera, near_m=settings["near_m"], depth=settings["depth_m"], airlight=0.5)
    frame = torch.zeros(1, height, width)
    rows = [
        statistics(transform.run(frame, noise=transform.draw(frame, seed=seed)).particle_mask[0].double().numpy())
        for seed in range(N_SEEDS[block])
    ]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def three_standard_errors(block: str, name: str, ours: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    theirs = BLOCKS[block]["std_over_seeds"][name] ** 2 / len(BLOCKS[block]["seeds"])
    return 3 * math.sqrt(float(ours.var(ddof=1)) / len(ours) + theirs)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*RELATIVE, *ABSOLUTE])
@pytest.mark.parametrize("block", list(BLOCKS))
def test_fast_path_has_the_statistics_of_every_particle(block: str, name: str) -> None:
    ours = fast_statistics(block)[name]
    wanted = BLOCKS[block]["mean_over_seeds"][name]
    allowed = RELATIVE[name] * wanted if name in RELATIVE else ABSOLUTE[name]
    assert float(ours.mean()) == pytest.approx(wanted, abs=allowed + three_standard_errors(block, name, ours))


def test_the_reference_still_gives_its_committed_statistics() -> None:
    block = BLOCKS["rain_96x96"]
    settings = {key: value for key, value in block["settings"].items() if key != "rate_mm_per_h"}
    for seed in (0, 1):
        again = statistics(render(block["settings"]["rate_mm_per_h"], **settings, seed=seed))
        committed = block["seeds"][seed]
        assert again == pytest.approx({name: committed[name] for name in again}, rel=1e-9, abs=1e-12)
