"""Completion on KITTI frames that no constant was chosen on: rings left out, the sky, the whole picture.

Skipped, visibly, where ``TORCHWEATHER_REAL_DATA`` is unset. ``benchmarks/depth_completion.json`` has the figures of
all frames.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.recordings import recording
from torchweather.camera.depth.completion import CompletedDepth
from torchweather.camera.depth.hidden_points import hidden_points
from torchweather.camera.depth.points import DepthFromPoints
from torchweather.camera.depth.projection import project_points
from torchweather.camera.depth.sparse import CompletedDepthMap
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.io import read_image
from torchweather.sensors import Camera

pytestmark = pytest.mark.real_data

FRAMES = ("000001", "000015", "000020")


def no_sky(rgb: Tensor, **_: object) -> Tensor:
    return torch.zeros(1, *rgb.shape[-2:])


def read(name: str) -> tuple[Tensor, Camera, Tensor, Tensor]:
    folder = recording("kitti_13")
    known = read_kitti_calibration(folder / f"calib/{name}.txt")
    rgb = read_image(folder / f"image_2/{name}.png")[0]
    fx, fy, cx, cy = (float(known.camera_matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera.from_intrinsics(fx, fy, cx, cy, rgb.shape[-1], rgb.shape[-2])
    return rgb, camera, read_kitti_points(folder / f"velodyne/{name}.bin").double(), known.T_camera_from_lidar


def left_out_errors(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors at the points of every fourth ring, of today's completion and of the new one."""
    rgb, camera, points, transform = read(name)
    height, width = rgb.shape[-2:]
    azimuth = np.mod(torch.atan2(points[:, 1], points[:, 0]).numpy(), 2 * np.pi)
    out = np.concatenate([[0], np.cumsum(np.diff(azimuth) < -np.pi)]) % 4 == 3
    column, row, depth_m, seen = (value.numpy() for value in project_points(points, transform, camera))
    at = out & seen
    at[seen] &= ~hidden_points(column[seen], row[seen], depth_m[seen], height, width)
    pixel = np.rint(row[at]).astype(int), np.rint(column[at]).astype(int)
    kept = points[torch.from_numpy(~out)]
    errors = []
    for source in (DepthFromPoints(kept, transform), CompletedDepth(kept, transform, sky=no_sky)):
        found = source(camera, height, width, image=rgb)[0].numpy()[pixel]
        errors.append(np.abs(found - depth_m[at]) / depth_m[at])
    return errors[0], errors[1]


@pytest.mark.long  # beside made scenes in test_completion.py
def test_left_out_rings_are_found_again_more_often_than_without_the_picture() -> None:
    pairs = [left_out_errors(name) for name in FRAMES]
    before, after = (np.concatenate(part) for part in zip(*pairs, strict=True))
    assert np.median(after) < 0.0075
    # Fewer than half of the gross errors of linear interpolation without hidden points removed.
    assert (after > 0.25).mean() < 0.5 * (before > 0.25).mean()
    assert np.quantile(after, 0.9) < np.quantile(before, 0.9)


def test_every_pixel_has_a_depth_and_measured_ones_their_own() -> None:
    rgb, camera, points, transform = read(FRAMES[1])
    height, width = rgb.shape[-2:]
    source = CompletedDepth(points, transform, sky=no_sky)
    depth_m = source(camera, height, width, image=rgb, dtype=torch.float64)[0].numpy()
    assert np.isfinite(depth_m).all()
    assert depth_m.min() > 1.0
    assert depth_m.max() < 85.0  # the scanner's range
    column, row, value, seen = (part.numpy() for part in project_points(points, transform, camera))
    found = depth_m[np.rint(row[seen]).astype(int), np.rint(column[seen]).astype(int)]
    assert (np.abs(found - value[seen]) < 1e-9).mean() > 0.8  # the others are hidden, or share their pixel
    # The same points as a map of pixels, as KITTI's depth files hold them.
    sparse = DepthFromPoints(points, transform, fill="none")(camera, height, width, dtype=torch.float64)
    sparse[torch.isinf(sparse)] = 0.0
    by_map = CompletedDepthMap(sparse, sky=no_sky)(camera, height, width, image=rgb, dtype=torch.float64)[0].numpy()
    assert np.median(np.abs(by_map / depth_m - 1)[150:]) < 0.01


def test_sky_without_a_picture_stays_above_the_horizon() -> None:
    rgb, camera, points, transform = read(FRAMES[0])
    depth_m = CompletedDepth(points, transform)(camera, *rgb.shape[-2:])[0]
    sky = torch.isinf(depth_m)
    assert 0.02 < float(sky.float().mean()) < 0.3  # a highway under open sky
    assert not sky[round(camera.principal_point_px[1]) + 1 :].any()
