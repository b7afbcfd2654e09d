"""What frames are compared with: which beams count, the noise of clear frames, and who stands beside whom."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

from tests.gap.tiny_study import SENSOR
from torchweather.gap.sensors.lidar.scene import FLICKER_SD, LidarScene, _variances, has_neighbour, lidar_scene
from torchweather.gap.study.conditions import StudyScene
from torchweather.stages import ToEnergy

ROWS, COLUMNS, FRAMES = 16, 64, 6
BEAMS = ROWS * COLUMNS
RANGE_M = 20.0
ENERGY = ToEnergy(SENSOR)
RNG = np.random.default_rng


def reflectivity(margin_db: Any) -> Any:
    """Of a target at 20 m that stands so far above the threshold: X = rho xi / (pi R^2), xi = 1 there."""
    return SENSOR.threshold_per_m2_sr * 10.0 ** (0.1 * margin_db) * math.pi * RANGE_M**2


def scene_of(range_m: Any, intensity: Any) -> LidarScene:
    """Of frames ``(K, N)``."""
    frames = [
        {"range_m": one.reshape(ROWS, COLUMNS), "intensity": other.reshape(ROWS, COLUMNS)}
        for one, other in zip(range_m, intensity, strict=True)
    ]
    elevation = np.repeat(np.linspace(-0.3, 0.3, ROWS), COLUMNS)
    azimuth = np.tile(np.linspace(-3.0, 3.0, COLUMNS), ROWS)
    parts = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    direction = torch.from_numpy(np.stack(parts, -1)).float()
    scene = StudyScene("s", frames, {})
    return lidar_scene(scene, direction, (ROWS, COLUMNS), ENERGY, True, SENSOR.max_range_m)


def noisy(rng: np.random.Generator, margin_db: Any, std: Any) -> Any:
    """Intensities ``(K, N)`` of beams with relative noise."""
    return reflectivity(margin_db) * np.exp(std * rng.normal(size=(FRAMES, len(margin_db))))


FAR = np.full((FRAMES, BEAMS), RANGE_M)


def test_beams_that_noise_brings_to_the_threshold_are_left_out() -> None:
    """Noise of 3 % is 0.130 dB: a beam within 0.78 dB of the threshold was chosen by it."""
    margin_db = np.linspace(0.3, 12.0, BEAMS)
    found = scene_of(FAR, noisy(RNG(1), margin_db, 0.03))
    zone_db = FLICKER_SD * 0.03 * 10.0 / math.log(10.0)
    # The mean of six frames is noisy by 0.053 dB itself: four of those.
    sure, out = margin_db > zone_db + 0.21, margin_db < zone_db - 0.21
    assert found.stable.numpy()[sure].all()
    assert not found.stable.numpy()[out].any()
    assert out.sum() > 20
    assert not found.empty[-1].any()


def test_beams_without_noise_count_from_the_threshold_on() -> None:
    margin_db = np.linspace(-3.0, 3.0, BEAMS)
    found = scene_of(FAR, np.tile(reflectivity(margin_db), (FRAMES, 1)))
    # Rounding of single precision is a noise of 1e-7.
    sure = np.abs(margin_db) > 1e-4
    np.testing.assert_array_equal(found.stable.numpy()[sure], margin_db[sure] > 0)


def test_no_beam_of_a_bin_is_chosen_by_the_noise_of_its_own_frame() -> None:
    """Two clear frames, beams about the threshold: those that count in a bin of the other frame's mean are read as high
    as a frame that had no say, not higher as where all stable beams are taken."""
    rng, std = RNG(8), 0.03
    margin_db = rng.uniform(0.2, 2.0, (60, BEAMS))
    before, now = [], []
    for one in margin_db:
        clear = reflectivity(one) * np.exp(std * rng.normal(size=(2, BEAMS)))
        found = scene_of(FAR[:2], clear)
        limit_db = FLICKER_SD * std * 10.0 / math.log(10.0)
        reference = found.reference_intensity[0].numpy()  # of the second frame
        near = 10.0 * np.log10(reference / reflectivity(0.0)) < limit_db + 0.7
        counts = found.stable.numpy() & near
        excess = np.log(clear[0] / reflectivity(one))
        before.append(excess[counts])
        now.append(excess[counts & (found.bins["margin_db"][0].numpy() >= 0)])
    assert np.concatenate(before).mean() > 10.0 * std / math.sqrt(len(np.concatenate(before)))
    error = std / math.sqrt(len(np.concatenate(now)))
    assert error < 0.002
    assert abs(np.concatenate(now).mean()) < 4.0 * error


def test_a_surface_that_one_clear_frame_saw_is_something_new_beside_the_others() -> None:
    range_m, margin_db = FAR.copy(), np.linspace(2.0, 12.0, BEAMS)
    sky = BEAMS - COLUMNS  # the topmost row
    range_m[:, sky:] = 0.0
    once, twice = sky + 5, sky + 26
    range_m[2, once] = range_m[1, twice] = range_m[4, twice] = RANGE_M
    found = scene_of(range_m, np.where(range_m > 0, noisy(RNG(2), margin_db, 0.03), 0.0))
    expected = np.zeros((FRAMES + 1, BEAMS), bool)
    expected[:, sky:] = True
    expected[:, [once, twice]] = False
    expected[2, once] = True
    np.testing.assert_array_equal(found.empty.numpy(), expected)
    assert not found.stable[sky:].any()


def test_the_clock_of_each_clear_frame_is_found() -> None:
    late_m = np.array([0.004, -0.01, 0.0, 0.002, 0.001, 0.003])
    range_m = FAR + late_m[:, None] + 0.02 * RNG(9).normal(size=FAR.shape)
    found = scene_of(range_m, noisy(RNG(2), np.linspace(2.0, 12.0, BEAMS), 0.03))
    np.testing.assert_allclose(found.clock_m.numpy(), late_m - late_m.mean(), atol=4.0 * 0.02 / math.sqrt(BEAMS))


def test_the_scale_of_each_clear_frame_is_found() -> None:
    """A laser that is 2 % stronger in one frame: 0.1 % apart, 1,000 beams of 3 % tell it."""
    gain = np.array([1.0, 1.02, 1.0, 0.99, 1.0, 1.0])
    intensity = noisy(RNG(2), np.linspace(2.0, 12.0, BEAMS), 0.03) * gain[:, None]
    found = scene_of(FAR, intensity)
    # Over the mean of all: its logarithm is less than that of the mean by half the variance, 0.0005.
    np.testing.assert_allclose(found.gain.numpy(), gain / gain.mean(), atol=4 * 0.03 / math.sqrt(BEAMS) + 0.0005)
    assert abs(found.gain[1] / found.gain[3] - 1.02 / 0.99) < 4 * 0.03 * math.sqrt(2.0 / BEAMS)
    # What whole frames do is no noise of beams.
    assert found.reading_std == pytest.approx(0.03, rel=0.08)


def drawn_variances(seed: int, constant: float, growing: float, beams: int, frames: int) -> tuple[Any, Any, Any]:
    rng = RNG(seed)
    margin_db = rng.uniform(1.0, 18.0, beams)
    variance = constant + growing * 10.0 ** (-0.1 * margin_db)
    apart = np.sqrt(variance) * rng.normal(size=(frames, beams))
    return torch.from_numpy(apart - apart.mean(0)), torch.from_numpy(margin_db), variance


@pytest.mark.parametrize(("constant", "growing"), [(9e-4, 4e-3), (1e-4, 1e-2), (4e-3, 1e-3)])
def test_both_parts_of_the_noise_are_recovered_within_their_errors(constant: float, growing: float) -> None:
    frames, beams = 8, 4000
    apart, margin_db, variance = drawn_variances(3, constant, growing, beams, frames)
    found, slope = _variances(apart, margin_db)
    # The variance of a beam from 8 frames is known to sqrt(2 / 7); a straight line through 4,000 of them.
    weak = 10.0 ** (-0.1 * margin_db.numpy())
    centred = weak - weak.mean()
    of_one = variance**2 * 2.0 / (frames - 1)
    error = math.sqrt(float((centred**2 * of_one).sum())) / float((centred**2).sum())
    assert slope == pytest.approx(growing, abs=4.0 * error)
    ahead = math.sqrt(of_one.mean() / beams + (weak.mean() * error) ** 2)
    assert found == pytest.approx(constant, abs=4.0 * ahead)
    assert 4.0 * min(error / growing, ahead / constant) < 0.5  # it tells something


def test_neither_part_of_the_noise_is_negative() -> None:
    apart, margin_db, _ = drawn_variances(4, 0.0, 1e-2, 4000, 8)
    constant, growing = _variances(apart, margin_db)
    assert 0.0 <= constant < 2e-4
    assert growing == pytest.approx(1e-2, rel=0.1)
    # Noise that falls towards the threshold has no part that grows.
    rng = RNG(5)
    falling = torch.from_numpy(np.sqrt(1e-3 * (1.0 - 10.0 ** (-0.1 * margin_db.numpy()))) * rng.normal(size=(8, 4000)))
    constant, growing = _variances(falling - falling.mean(0), margin_db)
    assert growing == 0.0
    assert constant == pytest.approx(float(falling.square().mean()), rel=0.05)


def test_the_noise_of_a_scene_is_what_its_clear_frames_have() -> None:
    margin_db = np.linspace(3.0, 15.0, BEAMS)
    std = np.sqrt(4e-4 + 4e-3 * 10.0 ** (-0.1 * margin_db))
    rng = RNG(6)
    found = scene_of(FAR + 0.02 * rng.normal(size=FAR.shape), noisy(rng, margin_db, std))
    # 1,000 beams of six frames: a line to 15 %, three of that.
    assert found.variance_at_threshold == pytest.approx(4e-3, rel=0.45)
    assert found.reading_std == pytest.approx(0.02, rel=0.25)
    # 5,000 departures: sqrt(0.5 / 5,000) = 1 %.
    assert found.noise_m == pytest.approx(0.02, rel=0.05)
    assert found.tolerance_m == 0.35


def test_a_noisy_scanner_has_a_wider_surface() -> None:
    rng = RNG(7)
    found = scene_of(FAR + 0.1 * np.clip(rng.normal(size=FAR.shape), -3, 3), noisy(rng, np.full(BEAMS, 9.0), 0.02))
    assert found.tolerance_m == pytest.approx(0.6, rel=0.05)
    assert found.stable.all()


# ---- neighbours ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("grid", [(5, 7), (1, 9), (6, 1), (4, 2), (1, 1), (3, 3)])
def test_neighbours_agree_with_a_loop_over_the_eight_around_each(grid: tuple[int, int]) -> None:
    rows, columns = grid
    rng = RNG([8, rows, columns])
    image = np.round(rng.uniform(3.0, 7.0, (4, rows, columns)), 3)
    image[rng.random(image.shape) < 0.3] = 0.0
    frames = torch.from_numpy(image.reshape(4, -1))
    every = torch.arange(frames.numel())
    some = every[2::3]
    assert torch.equal(has_neighbour(frames, grid, 0.5, some), has_neighbour(frames, grid, 0.5, every)[some])
    found = has_neighbour(frames, grid, 0.5, every).reshape(image.shape).numpy()
    seen = 0
    for frame, row, column in np.ndindex(image.shape):
        own = image[frame, row, column]
        around = {
            (row + down, (column + aside) % columns)
            for down in (-1, 0, 1)
            for aside in (-1, 0, 1)
            if 0 <= row + down < rows
        } - {(row, column)}
        expected = own > 0 and any(image[frame][one] > 0 and abs(image[frame][one] - own) < 0.5 for one in around)
        assert found[frame, row, column] == expected
        seen += expected
    assert grid == (1, 1) or 0 < seen < image.size
