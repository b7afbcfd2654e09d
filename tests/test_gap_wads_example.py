"""The example that asks what the snow model lacks on WADS: its parts, a made recording, and the real one."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.running_examples import load_example, run_example
from tests.test_examples import made_wads
from torchweather.gap import Study, find_gap

EXAMPLE = "gap_wads_snow.py"


@pytest.fixture(scope="module")
def example() -> Any:
    return load_example("parts/snow_study.py")


def test_a_frame_is_divided_into_every_so_many_columns(example: Any) -> None:
    frame = {"range_m": np.arange(20.0).reshape(2, 10)}
    first, second, third = example.divided(frame, 3)
    assert first["range_m"].tolist() == [[0.0, 3.0, 6.0], [10.0, 13.0, 16.0]]
    assert third["range_m"].tolist() == [[2.0, 5.0, 8.0], [12.0, 15.0, 18.0]]
    assert second["range_m"].shape == (2, 3)  # the tenth column has no partners


def test_the_first_echo_is_the_nearest_that_is_there(example: Any) -> None:
    along = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    beams = example.Beams(
        object_m=torch.tensor([9.0, 0.0, 4.0]),
        azimuth_deg=torch.zeros(3),
        elevation_deg=torch.zeros(3),
        range_m=torch.tensor([[9.0, 5.0], [0.0, 3.0], [4.0, 0.0]]),
        intensity=torch.tensor([[7.0, 1.0], [0.0, 2.0], [8.0, 0.0]]),
        snow=torch.tensor([[False, True], [False, True], [False, False]]),
    )
    everything = example.first_echoes(beams, along, True).points
    assert everything.tolist() == [[5.0, 0.0, 0.0, 1.0], [0.0, 3.0, 0.0, 2.0], [0.0, 0.0, 4.0, 8.0]]
    assert example.first_echoes(beams, along, False).points.tolist() == [[9.0, 0.0, 0.0, 7.0], [0.0, 0.0, 4.0, 8.0]]


def a_third(study: Study) -> Study:
    """Four of the twelve scans of each frame: enough beams to tell the effect, in a third of the time."""
    conditions = tuple(replace(one, frames=one.frames[:4]) for one in study.conditions)
    scenes = {name: replace(scene, clear=scene.clear[:4]) for name, scene in study.scenes.items()}
    return replace(study, conditions=conditions, scenes=scenes)


@pytest.mark.long
def test_a_recording_without_faint_first_echoes_lacks_what_a_last_echo_lacks(example: Any, tmp_path: Path) -> None:
    """The made recording has the strongest and the last echo: a flake that is fainter than what is behind is missing.

    That acts as a sensor that reports the last echo, and the snowfall itself is right.
    """
    for seed in (1, 2):
        made_wads(tmp_path, 1.0, seed)
    study = a_third(example.study_of(tmp_path, 1.0, 0.1, scans=12, intensity_unit="none"))
    assert [one.split for one in study.conditions] == ["fit", "holdout"]
    rivals = ["last_return", "particle_backscatter", "threshold_shift"]
    found = find_gap(study, effects=[f"lidar.{name}" for name in rivals]).answer
    assert [one["name"] for one in found["effects"]] == ["lidar.last_return"]
    assert found["effects"][0]["parameters"]["probability"] > 0.9
    assert found["nuisance"]["rate_factor"] == pytest.approx(1.0, abs=0.1)  # what the record leaves open


def test_without_a_recording_the_example_says_what_it_needs(tmp_path: Path) -> None:
    assert "TORCHWEATHER_REAL_DATA" in run_example(EXAMPLE, [], tmp_path).stderr
    done = run_example(EXAMPLE, ["--data", "."], tmp_path)
    assert done.returncode == 1
    assert "two frames or more" in done.stderr


@pytest.mark.long  # minutes
@pytest.mark.real_data
def test_real_snow_is_searched(tmp_path: Path) -> None:
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root or not (Path(root) / "wads_snow").is_dir():
        pytest.skip("TORCHWEATHER_REAL_DATA holds no wads_snow")
    done = run_example(EXAMPLE, ["--data", str(Path(root) / "wads_snow"), "--out", "page"], tmp_path)
    assert done.returncode == 0, done.stderr
    # What the tables of docs/lidar.md say by hand: these objects could not have been seen with 30 m at 10 %.
    assert "without intensities: named_and_rest, lidar.threshold_shift: shift_db −" in done.stdout
    assert (tmp_path / "page" / "report.html").stat().st_size > 10_000
