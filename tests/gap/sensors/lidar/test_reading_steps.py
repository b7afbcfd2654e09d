"""Readings in whole steps: found, put back within them, and rounded once, after the weather."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap.tiny_study import tiny_study
from torchweather.gap.sensors.lidar.frames import LidarFrames
from torchweather.gap.sensors.lidar.reading_steps import (
    frames_within_steps,
    in_steps,
    reading_step,
    within_steps,
)
from torchweather.gap.study.study import Study

BEAMS = 20_000


def drawn(low: float, high: float) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(3).uniform(low, high, BEAMS)).float()


@pytest.mark.parametrize("step", [0.01, 1.0, 1.0 / 255.0, 257.0])
def test_a_step_is_found_wherever_readings_lie_on_one(step: float) -> None:
    readings = in_steps(step * drawn(0.0, 80.0), step)
    assert reading_step(readings) == pytest.approx(step, rel=1e-6)
    assert reading_step(readings[readings > 3.5 * step]) == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize(
    "readings",
    [
        drawn(0.0, 1.0),
        torch.round(drawn(0.1, 1.0) * 1e5) * 1e-5,  # a step too fine to matter
        torch.tensor([0.0, 0.0]),
        torch.tensor([]),
        torch.tensor([0.1, 0.2, 0.237]),
        torch.tensor([0.1, 0.2, 0.5, 0.5, 0.3]),  # surfaces of a made-up scene
        0.1 * torch.tensor([1.0, 2.0, 5.0, 9.0, 14.0, 20.0, 27.0, 35.0, 44.0, 54.0, 65.0]),
    ],
)
def test_there_is_no_step_where_readings_lie_on_none(readings: torch.Tensor) -> None:
    assert reading_step(readings) == 0.0
    assert in_steps(readings, 0.0) is readings


def test_what_was_put_back_is_rounded_to_what_it_was() -> None:
    """Evenly within the step, and at other places for another seed."""
    readings = in_steps(drawn(0.0, 0.6), 0.01)
    within = within_steps(readings, 0.01, 0)
    torch.testing.assert_close(in_steps(within, 0.01), readings, atol=1e-7, rtol=0.0)
    share = (within - readings) / 0.01
    assert float(share.mean()) == pytest.approx(0.5, abs=4.0 * math.sqrt(1.0 / 12.0 / BEAMS))
    assert float((within_steps(readings, 0.01, 1) - within).abs().max()) > 0.005


@pytest.mark.parametrize("spread", [0.002, 0.03])
def test_frames_put_back_are_as_they_may_have_been(spread: float) -> None:
    """Levels of 5 to 60 steps with noise: given what was read, places within the step are those of the true readings,
    which were never seen. Beams that no frame sees, and returns that are missing, stay."""
    rng = np.random.default_rng(4)
    level = np.exp(rng.uniform(math.log(5.0), math.log(60.0), BEAMS))
    truth = torch.from_numpy(level * (1.0 + spread * rng.standard_normal((6, BEAMS))))
    seen = torch.from_numpy(rng.random((6, BEAMS)) > 0.1)
    seen[:, :50] = False
    readings = torch.where(seen, in_steps(truth, 1.0), 0.0)
    found, _ = frames_within_steps(readings, seen, 1.0, torch.zeros(BEAMS), 0)
    torch.testing.assert_close(in_steps(found, 1.0), readings, atol=1e-7, rtol=0.0)
    share, true = ((one - readings)[seen] for one in (found, truth))
    assert float(share.mean()) == pytest.approx(float(true.mean()), abs=4.0 * math.sqrt(1.0 / 6.0 / BEAMS))
    # Beams whose readings alternate by one lie near the edge: as near as the true ones, but for what the beams share.
    step = torch.where(seen, readings, torch.inf).amin(0)
    alternates = torch.where(seen, readings, -torch.inf).amax(0) == step + 1.0
    edge = step + 1.0
    for far in (found, truth):
        away = (far - edge).abs()[:, alternates][seen[:, alternates]]
        assert float(away.mean()) < 0.5
    near = [float((one - edge).abs()[:, alternates][seen[:, alternates]].mean()) for one in (found, truth)]
    assert near[0] == pytest.approx(near[1], rel=0.15)


def test_the_scale_of_a_frame_is_kept() -> None:
    """Levels of 1 to 8 steps, which hardly ever read otherwise in a frame that is 2 % brighter."""
    rng = np.random.default_rng(6)
    scale = torch.tensor([1.0, 1.02, 0.98, 1.01])[:, None]
    truth = scale * torch.from_numpy(rng.uniform(1.0, 8.0, BEAMS)) * (1.0 + 0.01 * torch.randn(4, BEAMS))
    readings = in_steps(truth, 1.0)
    found, _ = frames_within_steps(readings, readings >= 0, 1.0, torch.zeros(BEAMS), 0)
    mean, true = ((one.mean(1) / one.mean()).double() for one in (found, truth))
    # A share of 4 % of a step is read otherwise, of as many beams: binomial noise.
    torch.testing.assert_close(mean, true, atol=4.0 * math.sqrt(0.1 / BEAMS) / 4.5, rtol=0.0)


def test_what_was_detected_lies_above_the_threshold() -> None:
    readings = torch.full((3, BEAMS), 4.0)
    found, unsure = frames_within_steps(readings, readings > 0, 1.0, torch.full((BEAMS,), 4.7), 0)
    assert float(found.min()) >= 4.7 - 1e-6
    assert float(found.mean()) == pytest.approx(4.5 + 0.35, abs=0.01)
    # A level between 4.7 and 5, even in between.
    torch.testing.assert_close(unsure, torch.full_like(unsure, 0.3**2 / 12.0 / 4.85**2), rtol=0.1, atol=0.0)


def test_weather_on_readings_in_steps_is_rounded_once() -> None:
    """Dark surfaces lose a fifth: mean and share of zeros are those of a sensor that rounds behind the weather."""
    truth, step, left = drawn(0.0, 0.05), 0.01, 0.8
    measured = in_steps(left * truth, step)
    simulated = in_steps(left * within_steps(in_steps(truth, step), step, 0), step)
    noise = float(measured.std()) * math.sqrt(2.0 / BEAMS)
    assert float(simulated.mean()) == pytest.approx(float(measured.mean()), abs=4.0 * noise)
    zeros, found = (float((one == 0).float().mean()) for one in (measured, simulated))
    assert found == pytest.approx(zeros, abs=4.0 * math.sqrt(2.0 * zeros / BEAMS))
    # As the readings stand both are off by more.
    assert abs(float((left * in_steps(truth, step)).mean() - measured.mean())) > 8.0 * noise


def rounded(study: Study, step: float) -> Study:
    """The same frames, with readings rounded down."""

    def of(frames: Any) -> list[dict[str, Any]]:
        return [{**frame, "intensity": np.floor(frame["intensity"] / step) * step} for frame in frames]

    scenes = {name: replace(scene, clear=of(scene.clear)) for name, scene in study.scenes.items()}
    conditions = tuple(replace(one, frames=of(one.frames)) for one in study.conditions)
    return replace(study, scenes=scenes, conditions=conditions)


def test_simulated_frames_have_the_steps_of_the_clear_ones() -> None:
    """And as many readings of 0 as the frames of the same model that were rounded afterwards."""
    study = rounded(tiny_study(), 0.05)
    model = LidarFrames(study)
    (scene,) = model.scenes.values()
    assert scene.step == pytest.approx(0.05, rel=1e-6)
    first = study.scenes["s0"].clear[0]["intensity"].reshape(-1)
    np.testing.assert_allclose(in_steps(scene.intensity, scene.step)[0], first, atol=1e-6)
    condition = model.fit[0]
    range_m, intensity = model.simulated_scans(condition, [], 0.0, range(8))
    places = intensity / 0.05
    torch.testing.assert_close(places, places.round(), atol=1e-3, rtol=0.0)
    zeros = float(((intensity == 0) & (range_m > 0)).float().sum() / (range_m > 0).float().sum())
    seen = list(condition.frames)
    count = sum(int((frame["range_m"] > 0).sum()) for frame in seen)
    measured = sum(int(((frame["intensity"] == 0) & (frame["range_m"] > 0)).sum()) for frame in seen) / count
    assert measured > 0.01
    assert zeros == pytest.approx(measured, abs=4.0 * math.sqrt(2.0 * measured / count))


def test_what_steps_leave_open_is_an_error_of_mean_intensities() -> None:
    """Steps of 0.05 on reflectivities of 0.1 to 0.9: of the mean over the n beams of a bin the root of their summed
    variances over n, where an even place within a step has the variance 1/12 of it."""
    model = LidarFrames(rounded(tiny_study(), 0.05))
    condition, (scene,) = model.fit[0], model.scenes.values()
    found = np.asarray(model.left_open(condition))
    variance = 1.0 / 12.0 * (0.05 / scene.reference_intensity[-1].double().clamp_min(0.01).numpy()) ** 2
    bins = 0
    for group, part in zip(model.layout.groups, model.layout.slices, strict=True):
        if group.statistic != "log_intensity_ratio" or group.kind != "mean":
            assert (found[part] == 0.0).all()
            continue
        place = np.where(scene.stable.numpy(), scene.bins[group.axis][-1].numpy(), -1)
        for number in range(group.bins):
            beams = place == number
            if beams.sum() > 30:
                even = np.sqrt(variance[beams].sum()) / beams.sum()
                # Readings alternate by the noise of 3 % in many of the brighter beams, and tell more of those.
                assert 0.3 * even < found[part][number] < 1.2 * even
                bins += 1
    assert bins > 20
    assert LidarFrames(tiny_study()).left_open(condition) == 0.0
