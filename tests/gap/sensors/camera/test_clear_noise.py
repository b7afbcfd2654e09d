"""Noise of a camera's clear frames in weather: against frames that are drawn, block by block, and Koschmieder's law."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.gap.tiny_camera_study import ELECTRONS, values_of
from torchweather.gap import Study
from torchweather.gap.inference.simulated_distribution import ClearNoise
from torchweather.gap.sensors.camera.clear_noise import camera_clear_noise
from torchweather.gap.sensors.camera.frames import CameraFrames
from torchweather.gap.sensors.camera.scene import cell_colours, in_blocks
from torchweather.physics import extinction_per_m

CLEAR = 8
GREEN_PIXELS = 8  # of a block of 4 x 4 px


@pytest.fixture(scope="module")
def model() -> CameraFrames:
    return CameraFrames(Study.from_arrays(**values_of(kind="fog", clear=CLEAR, frames=1)))


def blocks(model: CameraFrames, bayer: Tensor) -> Tensor:
    """Green of blocks ``(F, B)``."""
    return in_blocks(cell_colours(bayer, model.sensor.bayer_pattern))[:, 1].double()


def entries(model: CameraFrames, found: np.ndarray, statistic: str, axis: str) -> np.ndarray:
    """Those of one group."""
    for group, part in zip(model.layout.groups, model.layout.slices, strict=True):
        if (group.statistic, group.axis) == (statistic, axis):
            return found[part]
    raise AssertionError(statistic)


def test_in_clear_air_it_is_that_of_frames_compared_with_the_others(model: CameraFrames) -> None:
    """A frame departs by ``K / (K - 1)`` as far from the mean of the others as from that of all."""
    scene, sums = model.scenes["s0"], model._clear_sums["s0"]
    found = camera_clear_noise(scene, sums, scene.reference[-1:], None, None)
    np.testing.assert_allclose(found.own, ((CLEAR - 1) / CLEAR) ** 2, rtol=1e-6)
    np.testing.assert_allclose(found.passed, 1.0, rtol=1e-6)


@pytest.mark.parametrize("number", [0, 1])
def test_own_noise_over_that_of_simulated_frames_is_as_drawn(model: CameraFrames, number: int) -> None:
    """Shot noise of the fog's light, over the scatter of what is simulated from eight clear frames."""
    condition, scene = model.fit[number], model.scenes["s0"]
    frames = model.simulated_pictures(condition, [], 0.0, range(CLEAR))[:, None]
    ratio = (blocks(model, frames) / blocks(model, scene.reference[:-1])).log()
    level = blocks(model, frames).mean(0)
    drawn, own = ratio.var(0), 1.0 / (ELECTRONS * GREEN_PIXELS * level)
    inside = scene.bins["depth_m"] >= 0
    found = entries(model, model.clear_noise(condition).own, "log_ratio_green", "depth_m")[scene.bins["depth_m"]]
    expected = float(own[inside].sum() / drawn[inside].sum())
    stated = float(own[inside].sum() / (own.numpy() / found)[inside].sum())
    # A variance of 8 values in each of some 500 blocks: sqrt(2 / 3,500) = 2.4 %; the noise's law as much again.
    assert int(inside.sum()) > 400
    assert stated == pytest.approx(expected, rel=0.1)


def test_fog_lets_the_clear_frames_noise_through_as_it_does_the_scene(model: CameraFrames) -> None:
    """``t^2 I0 / I``, t by the extinction of the droplets and the way to each surface."""
    condition, scene = model.fit[1], model.scenes["s0"]
    assert condition.weather is not None
    bands = model.sensor.bands
    extinction = float(extinction_per_m(condition.weather.distribution(), bands["green"]))
    y, x = torch.meshgrid(torch.arange(scene.depth_m.shape[-2]), torch.arange(scene.depth_m.shape[-1]), indexing="ij")
    fx, fy, cx, cy = model.sensor.intrinsics
    right, down = (x - cx) / fx, (y - cy) / fy
    seen = torch.exp(-extinction * scene.depth_m * torch.sqrt(1.0 + right**2 + down**2))[None]
    before, left = blocks(model, scene.reference[-1:])[0], blocks(model, seen)[0]
    now = blocks(model, model.simulated_pictures(condition, [], 0.0, range(CLEAR))[:, None]).mean(0)
    found = entries(model, model.clear_noise(condition).passed, "log_ratio_green", "depth_m")
    some = 0
    for place, passed in enumerate(found):
        inside = scene.bins["depth_m"] == place
        if int(inside.sum()) < 5:
            continue
        weight = 1.0 / now[inside].square()
        expected = float((weight * left[inside].square() * before[inside]).sum() / (weight * now[inside]).sum())
        assert passed == pytest.approx(expected, abs=0.03)  # noise of the constant part, and of the picture
        some += 1
    assert some > 5
    assert found.min() < 0.1 < 0.7 < found.max()


def test_of_regressions_on_the_clear_scene_the_fog_is_in_what_is_compared(model: CameraFrames) -> None:
    """Far away nothing is left of the scene: own noise is ``g / (a K / (K - 1))^2`` of it, ``(K - 1) / K``."""
    found = model.clear_noise(model.fit[1])
    own = entries(model, found.own, "shift_across_px_green", "depth_m")
    passed = entries(model, found.passed, "shift_across_px_green", "depth_m")
    far = int(np.argmin(passed))
    assert passed[far] < 0.05
    assert own[far] == pytest.approx((CLEAR - 1) / CLEAR, rel=0.02)


def test_other_statistics_are_left_alone(model: CameraFrames) -> None:
    found: ClearNoise = model.clear_noise(model.fit[1])
    others = ~model.layout.averages
    assert (found.passed[others] == 1.0).all()
    assert (found.own[others] == ((CLEAR - 1) / CLEAR) ** 2).all()
