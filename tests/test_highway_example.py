"""The example of the highway camera in fog: on made photographs of a known visibility, and on the recording."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.io import savemat

from tests.running_examples import load_example, run_example
from torchweather.camera.tone import srgb_encode
from torchweather.evaluation.fit import fit_weather
from torchweather.io import write_image

EXAMPLE = "fog_on_a_highway.py"
AIRLIGHT, GAIN, MOR_M, CLEAR_MOR_M = 0.3, 0.8, 200.0, 20000.0
FRAMES = 8


@pytest.fixture(scope="module")
def road() -> Any:
    return load_example("parts/road_camera.py")


def made_light(road: Any, foggy: bool, noise: np.random.Generator, shrink: int = 1) -> Any:
    """Linear light of a wet road with lane marks, in fog or in clear air, ``(H, W)``."""
    rows, columns = (np.arange(size // shrink) * shrink + (shrink - 1) / 2 for size in (985, 1471))
    below = np.maximum(rows - road.HORIZON_ROW, 1.0)[:, None]
    across = (road.VANISHING_COLUMN - columns) / below  # constant along the lanes
    marks = (np.abs(across - 3.0) < 0.08) | (np.abs(across - 1.2) < 0.08)
    light = np.where(marks, 0.25, 0.07)
    depth = np.where(rows[:, None] > road.HORIZON_ROW, road.DEPTH_TIMES_ROWS / below, np.inf)
    passed = np.exp(-math.log(20.0) / (MOR_M if foggy else CLEAR_MOR_M) * depth)
    frame = (GAIN if foggy else 1.0) * light * passed + AIRLIGHT * (1.0 - passed)
    return frame + 0.001 * noise.standard_normal(frame.shape)


def made_recording(road: Any, folder: Path, name: str) -> None:
    """Four frames in fog of one visibility and four clear ones, as files beside the meter's table."""
    noise = np.random.default_rng(0)
    day = folder / "frames" / name
    day.mkdir(parents=True)
    for k in range(FRAMES):
        frame = made_light(road, k < FRAMES // 2, noise)
        shown = srgb_encode(torch.from_numpy(frame).clamp(0.0, 1.0)).expand(3, -1, -1)
        write_image(day / f"2020-02-{name[-2:]}-08-{6 * k:02d}.jpg", (255.0 * shown).round().byte())
    meter = np.repeat([MOR_M] * (FRAMES // 2) + [CLEAR_MOR_M] * (FRAMES // 2), road.FRAMES_A_MORNING // FRAMES)
    (folder / "visibility").mkdir(exist_ok=True)
    savemat(folder / "visibility" / f"Vis-{name[-2:]}-Feb-2020.mat", {"vis_data": meter.astype(np.uint16)[None]})


def test_estimators_find_a_known_visibility(road: Any) -> None:
    noise, shrink = np.random.default_rng(1), 4
    foggy, clear = (
        [np.repeat(made_light(road, fog, noise, shrink)[None], 3, 0) for _ in range(4)] for fog in (True, False)
    )
    paths = tuple(Path(f"2020-02-04-08-{3 * k:02d}.jpg") for k in range(8))
    morning = road.Morning("20200204", paths, np.array([MOR_M] * 4 + [CLEAR_MOR_M] * 4))
    (block,) = road.blocks(morning)
    assert (block.name, block.places, block.rel_sd) == ("20200204-0800", (0, 1, 2, 3), 0.0)
    study = road.study_of(morning, [block], dict(enumerate(foggy)), clear, shrink)
    (fitted,) = fit_weather(study, estimators=["measured_airlight"], bootstrap=50).conditions[0].estimates
    assert fitted.intensity.value == pytest.approx(MOR_M, rel=0.03)  # clear frames have 1 % of the loss
    assert fitted.others["exposure_gain"].value == pytest.approx(GAIN, rel=0.02)
    found = road.local_extinction([light[1] for light in foggy], [light[1] for light in clear], shrink)
    assert math.log(20.0) / found.mean() == pytest.approx(MOR_M, rel=0.1)  # noise of 0.001 beside marks of 0.1


@pytest.mark.long  # the estimators alone are tested above
def test_fog_of_a_known_visibility_is_found_in_made_photographs(road: Any, tmp_path: Path) -> None:
    made_recording(road, tmp_path / "made", "20200204")
    for kept, same in (("frames/20200204", "frames/20200222"), ("visibility/Vis-04-", "visibility/Vis-22-")):
        end = "" if kept.startswith("frames") else "Feb-2020.mat"
        (tmp_path / "made" / (same + end)).symlink_to(tmp_path / "made" / (kept + end))
    arguments = ["--data", "made", "--out", "out", "--shrink", "8", "--bootstrap", "50"]
    done = run_example(EXAMPLE, arguments, tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "highway.json").read_text(encoding="utf-8"))
    assert [row["chosen_on"] for row in report["blocks"]] == [True, False]
    for row in report["blocks"]:
        assert row["meter_m"] == pytest.approx(MOR_M)
        # Clear frames have 1 % of the loss.
        assert row["fits"]["measured_airlight"][0] == pytest.approx(MOR_M, rel=0.05)
        # Marks are blurred by the means of 8 x 8 pixels, the more the farther they are.
        assert row["fits"]["local_contrast"][0] == pytest.approx(MOR_M, rel=0.25)
        curve = report["brightness_over_clear"][row["block"]]
        # The simulated frames have no gain of the exposure: what they have more is its share of the light that passes.
        more = np.subtract(curve["simulated"], curve["recorded"])
        assert (more > 0).all()
        assert (np.diff(more) < 0).all()
        assert curve["recorded"][-1] > 2.0 * curve["recorded"][0]
    assert report["chosen"] in report["blocks"][0]["fits"]
    assert (tmp_path / "out" / "highway.png").stat().st_size > 0
    assert "off by a factor of" in done.stdout


def test_frames_that_do_not_fit_the_meter_are_refused(road: Any, tmp_path: Path) -> None:
    day = tmp_path / "frames" / "20200204"
    day.mkdir(parents=True)
    for k in range(7):
        (day / f"2020-02-04-08-0{k}.jpg").write_bytes(b"")
    (tmp_path / "visibility").mkdir()
    savemat(tmp_path / "visibility" / "Vis-04-Feb-2020.mat", {"vis_data": np.full((1, 64), 200, np.uint16)})
    with pytest.raises(SystemExit, match="its 7 frames do not fit the 64 values"):
        road.mornings(tmp_path)


@pytest.mark.real_data
def test_one_morning_of_the_recording(tmp_path: Path) -> None:
    root = os.environ.get("TORCHWEATHER_REAL_DATA")
    if not root or not (Path(root) / "roadcam_fog").is_dir():
        pytest.skip("TORCHWEATHER_REAL_DATA holds no roadcam_fog")
    recorded, kept = Path(root) / "roadcam_fog", tmp_path / "kept"
    (kept / "frames").mkdir(parents=True)
    (kept / "frames" / "20200204").symlink_to(recorded / "frames" / "20200204")
    (kept / "visibility").symlink_to(recorded / "visibility")
    arguments = ["--data", "kept", "--out", "out", "--shrink", "8", "--bootstrap", "50", "--every", "2"]
    done = run_example(EXAMPLE, arguments, tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "highway.json").read_text(encoding="utf-8"))
    (row,) = report["blocks"]
    # docs/fog-on-a-highway.md: within a factor of 2, and local contrast far below it.
    assert 0.5 < row["fits"]["measured_airlight"][0] / row["meter_m"] < 2.0
    assert row["fits"]["local_contrast"][0] < row["fits"]["measured_airlight"][0]
