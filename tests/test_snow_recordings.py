"""The recorded part of the training example, on made recordings of known answers."""

from __future__ import annotations

import argparse
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.running_examples import load_example
from torchweather.io import FALLING_SNOW

PLACES = 1500


@pytest.fixture(scope="module")
def example() -> Any:
    """The example and its part on recordings."""
    return SimpleNamespace(
        main=load_example("train_in_weather.py"),
        part=load_example("parts/snow_recordings.py"),
        arms=load_example("parts/training_arms.py"),
    )


def wall(draw: np.random.Generator) -> np.ndarray:
    """A wall 10 to 20 m away, ``(N, 4)``; intensity 0.3 to 0.9."""
    angle, height = draw.uniform(-0.5, 0.5, PLACES), draw.uniform(-1.0, 1.0, PLACES)
    away = 15 + 5 * np.sin(3 * angle)
    return np.stack([away * np.cos(angle), away * np.sin(angle), height, draw.uniform(0.3, 0.9, PLACES)], 1)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """KITTI's and WADS' folders; in the latter every tenth point is a flake, and each point occurs twice."""
    draw = np.random.default_rng(1)
    for name in ("kitti/velodyne", "wads/velodyne", "wads/labels"):
        (tmp_path / name).mkdir(parents=True)
    wall(draw).astype(np.float32).tofile(tmp_path / "kitti/velodyne/000000.bin")
    for frame in ("042223", "042250"):
        points, classes = wall(draw), np.zeros(PLACES, np.uint32)
        points[:, 3] = np.floor(50 * points[:, 3])
        classes[::10] = FALLING_SNOW
        points[::10, :3] *= draw.uniform(0.2, 0.5, (PLACES // 10, 1))
        points[::10, 3] = 0.0
        twice = np.concatenate([points, points]).astype(np.float32)
        twice.tofile(tmp_path / f"wads/velodyne/{frame}.bin")
        np.concatenate([classes, classes]).tofile(tmp_path / f"wads/labels/{frame}.label")
    return tmp_path / "kitti", tmp_path / "wads"


def test_arms_learn_from_sweeps_and_are_scored_on_labelled_snow(example: Any, folders: tuple[Path, Path]) -> None:
    arguments = argparse.Namespace(kitti=folders[0], wads=folders[1], ablate=False, arms=["naive", "library"], seeds=1)
    arguments.recorded_draws, arguments.recorded_steps = 2, 30
    rows = {(row["simulator"], row["arm"]): row for row in example.main.recorded_rows(arguments)}
    assert {arm for _, arm in rows} == {"share of snow", "DROR + intensity", "naive", "library"}
    assert rows["recorded", "share of snow"]["scores"] == [pytest.approx(0.1)]
    assert rows["recorded", "DROR + intensity"]["scores"][0] > 0.95  # flakes stand alone and are dark
    assert all(0 <= row["scores"][0] <= 1 and row["test"].startswith("WADS") for row in rows.values())


def test_points_that_occur_twice_count_once(example: Any, folders: tuple[Path, Path]) -> None:
    points, snow = example.part.snowy_frame(folders[1], "042250")
    assert len(points) == PLACES
    assert int(snow.sum()) == PLACES // 10


def test_a_part_is_exchanged_and_nothing_else(example: Any, folders: tuple[Path, Path]) -> None:
    """Each ablation changes its own part of the library's snow."""
    [sweep] = example.part.clear_sweeps(folders[0])
    arms = example.part.arms(True)
    seed = next(k for k in range(20) if (arms["library"](sweep, k)["classes"] == example.part.WEATHER).any())
    plain = arms["library"](sweep, seed)
    flakes = plain["classes"] == example.part.WEATHER
    brighter = arms["library, naive intensities"](sweep, seed)
    assert torch.equal(brighter["points"][:, :3], plain["points"][:, :3])
    assert torch.equal(brighter["points"][~flakes], plain["points"][~flakes])
    moved = arms["library, naive ranges"](sweep, seed)
    assert torch.equal(moved["points"][:, 3], plain["points"][:, 3])
    assert (moved["points"][flakes, :3].norm(dim=1) > 0.999).all()
    kept = arms["library, no lost points"](sweep, seed)
    lost = plain["classes"] == example.part.NONE
    assert torch.equal(kept["points"][lost], sweep["points"][lost])
    assert (kept["classes"] != example.part.NONE).all()


def test_the_drawn_arm_draws_the_near_response_of_the_recipe(example: Any, folders: tuple[Path, Path]) -> None:
    [sweep] = example.part.clear_sweeps(folders[0])
    compose = example.arms.snow_recipe(example.part.SENSOR, {})
    drawn = [compose.draw(sweep, seed=k) for k in range(40)]
    values = [draw.nuisances["points"] for draw in drawn if draw.weather is not None]
    assert len(values) > 15
    full, start = ([one[f"sensor.near_{name}_m"] for one in values] for name in ("full", "start"))
    assert min(full) < 3
    assert max(full) > 15
    assert all(1 <= one <= 30 for one in full)
    assert all(0 <= one <= 0.9 for one in start)
