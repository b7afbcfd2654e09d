"""Points on planes lose their noise, and only they."""

from __future__ import annotations

import numpy as np

from torchweather.camera.depth.completion_noise import level_depths, rows_closer

NOISE_M = 0.02
FOCAL_PX, HEIGHT_M = 700.0, 1.65


def rings(seed: int = 0) -> np.ndarray:
    """Places of the points of 30 rings 6 px apart below the horizon, 2.6 px apart along them; ``(N, 2)``."""
    column, row = np.meshgrid(np.arange(0.0, 200.0, 2.6), np.arange(60.0, 240.0, 6.0))
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, column.size))
    return np.stack([column.ravel(), row.ravel()], -1) + jitter.T


def one_plane_at_a_time(pixel_xy: np.ndarray, depth_m: np.ndarray, count: int, within_m: float) -> np.ndarray:
    """What `level_depths` computes, point by point with a least-squares solver."""
    levelled = depth_m.copy()
    place = rows_closer(pixel_xy)
    for index, here in enumerate(place):
        near = np.argsort(np.square(place - here).sum(-1), kind="stable")[:count]
        basis = np.concatenate([np.ones((count, 1)), place[near] - here], -1)
        inverse, *_ = np.linalg.lstsq(basis, 1.0 / depth_m[near], rcond=None)
        off_m = np.abs(1.0 / depth_m[near] - basis @ inverse) * depth_m[index] ** 2
        if off_m.max() < within_m:
            levelled[index] = 1.0 / inverse[0]
    return levelled


def test_it_is_the_least_squares_plane_of_the_neighbours() -> None:
    place = rings()[:600]
    truth = HEIGHT_M * FOCAL_PX / place[:, 1]
    truth[place[:, 0] > 100.0] *= 0.7
    noisy = truth + np.random.default_rng(1).normal(0.0, NOISE_M, len(truth))
    expected = one_plane_at_a_time(place, noisy, 16, 0.1)
    assert (expected != noisy).mean() > 0.5, "the scene must have planes"
    assert (expected == noisy).mean() > 0.03, "and a step that is left alone"
    np.testing.assert_allclose(level_depths(place, noisy), expected, rtol=1e-6)


def test_a_road_loses_the_noise_that_the_mean_of_its_neighbours_loses() -> None:
    place = rings()
    truth = HEIGHT_M * FOCAL_PX / place[:, 1]
    noisy = truth + np.random.default_rng(2).normal(0.0, NOISE_M, len(truth))
    inner = (np.abs(place[:, 0] - 100.0) < 80.0) & (np.abs(place[:, 1] - 150.0) < 60.0)
    left = (level_depths(place, noisy) - truth)[inner].std() / NOISE_M
    # In the middle of n points a plane's value has the variance of their mean, 1 / 16; the sample of about 1,200
    # overlapping planes is worth a sixteenth as many, so its own error is 1 / sqrt(2 * 75) = 8 %: three of them.
    assert abs(left - 0.25) < 0.25 * 0.25, left


def test_a_depth_step_a_pole_and_leaves_stay_as_they_are() -> None:
    place = rings()
    walls = np.where(place[:, 0] < 100.0, 8.0, 20.0)
    np.testing.assert_allclose(level_depths(place, walls), walls, rtol=1e-8)
    pole = np.where(np.abs(place[:, 0] - 100.0) < 3.0, 8.0, 20.0)
    np.testing.assert_allclose(level_depths(place, pole), pole, rtol=1e-8)
    leaves = 10.0 + np.random.default_rng(3).uniform(-1.0, 1.0, len(place))
    assert (level_depths(place, leaves) == leaves).mean() > 0.99


def test_too_few_points_and_points_on_one_line_are_no_error() -> None:
    few = np.array([5.0, 6.0, 7.0])
    np.testing.assert_array_equal(level_depths(rings()[:3], few), few)
    line = np.stack([np.arange(40.0), np.full(40, 9.0)], -1)
    np.testing.assert_allclose(level_depths(line, np.full(40, 12.0)), 12.0, rtol=1e-6)
