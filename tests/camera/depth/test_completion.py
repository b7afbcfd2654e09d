"""Completion of a LiDAR cloud: a road, a box and a wall whose true depth is known, scanned from beside the camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.camera.depth.completion import CompletedDepth
from torchweather.camera.depth.hidden_points import enclosed_returns, hidden_points, lonely_points, unseen_points
from torchweather.camera.depth.scene_depth import COMPLETED
from torchweather.sensors import Camera

HEIGHT, WIDTH = 120, 320
CAMERA = Camera.from_intrinsics(fx=250.0, fy=250.0, cx=159.5, cy=50.0, width=WIDTH, height=HEIGHT, height_m=1.65)
LIDAR_FROM_CAMERA_M = np.array([0.0, -0.1, -0.3])  # where the LiDAR stands: 10 cm above, 30 cm behind the camera
T_CAMERA_FROM_LIDAR = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]]).double()

GROUND_M = 1.65
WALL_M, WALL_TOP_M = 40.0, 12.0
BOX = (-3.0, 1.0, 9.0, 12.0, 1.5)  # left, right, front, back, height; metres


def distances(origin: np.ndarray, direction: np.ndarray, wall_top_m: float = WALL_TOP_M) -> np.ndarray:
    """Way along each ray to the first surface, in lengths of the ray; ``inf`` in the sky. Camera's axes."""
    y, z = direction[..., 1], direction[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = [np.where(y > 0, (GROUND_M - origin[1]) / y, np.inf)]
        wall = np.where(z > 0, (WALL_M - origin[2]) / z, np.inf)
        hits.append(np.where(origin[1] + wall * y > GROUND_M - wall_top_m, wall, np.inf))
        left, right, front, back, height = BOX
        lower, upper = np.array([left, GROUND_M - height, front]), np.array([right, GROUND_M, back])
        enter, leave = (lower - origin) / direction, (upper - origin) / direction
        first, last = np.minimum(enter, leave).max(-1), np.maximum(enter, leave).min(-1)
        hits.append(np.where((first < last) & (first > 0), first, np.inf))
    nearest: np.ndarray = np.minimum.reduce(hits)
    return nearest


def true_depth(wall_top_m: float = WALL_TOP_M) -> np.ndarray:
    ray = CAMERA.ray_directions(dtype=torch.float64).permute(1, 2, 0).numpy()
    return distances(np.zeros(3), ray, wall_top_m)


def scan(wall_top_m: float = WALL_TOP_M, lowest_rad: float = -0.40, rings: int = 56) -> Tensor:
    """Points of a spinning LiDAR whose highest ring looks 2 degrees up; within 80 m, in its own frame."""
    elevation = np.linspace(lowest_rad, math.radians(2.0), rings)[:, None]
    azimuth = np.arange(-0.75, 0.75, 0.004)[None]
    direction = np.stack(
        np.broadcast_arrays(
            np.sin(azimuth) * np.cos(elevation), -np.sin(elevation), np.cos(azimuth) * np.cos(elevation)
        ),
        -1,
    )
    way = distances(LIDAR_FROM_CAMERA_M, direction, wall_top_m)
    hit = way < 80.0
    x, y, z = (direction * np.where(hit, way, 0.0)[..., None])[hit].T
    seen = np.stack([z, -x, -y], -1)
    # A house behind the car, so that the scan's own upper edge is known where nothing reaches it ahead.
    behind = np.stack([np.full(60, -20.0), np.linspace(-9, 9, 60), np.full(60, 20.0 * math.tan(math.radians(2.0)))], -1)
    return torch.from_numpy(np.concatenate([seen, np.repeat(behind, 3, 0)]))


def picture(depth_m: np.ndarray) -> Tensor:
    """Grey by surface: box dark, road middle, wall bright."""
    on_box = (depth_m > 8.0) & (depth_m < 12.5)
    on_box &= ~np.isclose(depth_m, road_depth(), rtol=1e-6)
    grey = np.where(on_box, 0.2, np.where(np.isclose(depth_m, WALL_M), 0.8, 0.5))
    return torch.from_numpy(grey).float().expand(3, HEIGHT, WIDTH).contiguous()


def road_depth() -> np.ndarray:
    ray = CAMERA.ray_directions(dtype=torch.float64).numpy()
    return np.where(ray[1] > 0, GROUND_M / np.where(ray[1] > 0, ray[1], 1.0), np.inf)


def no_sky(rgb: Tensor, **_: object) -> Tensor:
    return torch.zeros(1, *rgb.shape[-2:])


def completed(image: Tensor | None = None, cloud: Tensor | None = None, **more: object) -> np.ndarray:
    source = CompletedDepth(scan() if cloud is None else cloud, T_CAMERA_FROM_LIDAR, **more)
    depth: np.ndarray = source(CAMERA, HEIGHT, WIDTH, dtype=torch.float64, image=image)[0].numpy()
    return depth


def off(found: np.ndarray, truth: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
    error: np.ndarray = np.abs(found - truth)[rows] / truth[rows]
    return error


def test_road_box_and_wall_come_out_at_their_true_depth() -> None:
    truth = true_depth()
    error = off(completed(picture(truth), sky=no_sky), truth, slice(40, None))
    # Planes are exact on planes. What is left lies within half the spacing of the points from a step.
    assert np.median(error) < 1e-3
    assert np.quantile(error, 0.9) < 0.01
    assert (error > 0.25).mean() < 0.01


def test_picture_places_the_step_where_its_edge_is() -> None:
    truth = true_depth()
    rows = slice(40, 90)
    wrong_with = (off(completed(picture(truth), sky=no_sky), truth, rows) > 0.25).sum()
    wrong_without = (off(completed(), truth, rows) > 0.25).sum()
    assert wrong_without > 0
    assert wrong_with < 0.5 * wrong_without


def test_a_picture_without_edges_does_no_harm_to_surfaces() -> None:
    truth = true_depth()
    flat = completed(torch.full((3, HEIGHT, WIDTH), 0.5), sky=no_sky)
    np.testing.assert_allclose(np.median(off(flat, truth, slice(40, None))), 0.0, atol=1e-3)


def test_wall_goes_on_above_the_scan_and_the_road_below_it() -> None:
    truth = true_depth()
    cloud = scan(lowest_rad=-0.2, rings=36)  # the lowest ring meets the picture at row 101
    found = completed(picture(truth), cloud, sky=no_sky)
    assert np.isfinite(found).all()
    beside = np.s_[:20, 220:]  # far from the box
    np.testing.assert_allclose(found[beside], WALL_M, rtol=0.02)
    below = np.s_[105:, 220:]
    np.testing.assert_allclose(found[below], truth[below], rtol=0.02)


def test_box_cut_off_below_the_scan_stands_on_the_road() -> None:
    # Without a ring below -0.1 rad the box's front (9 m) and the road at 16 m are the lowest things hit.
    found = completed(None, scan(lowest_rad=-0.1, rings=28))
    column = 140
    assert found[85, column] == pytest.approx(9.0, rel=0.05)  # the front reaches down to row 95
    assert found[115, column] == pytest.approx(road_depth()[115, column], rel=0.05)


def test_sky_without_a_picture_is_above_the_topmost_points_and_above_the_horizon_only() -> None:
    cloud = scan(wall_top_m=2.0)  # its upper edge at row 48, 11 px below the highest ring
    found = completed(None, cloud)
    sky = np.isinf(found)
    assert sky[:35, 220:].all()
    assert not sky[51:].any()  # the horizon is row 50
    reaching = np.isinf(completed(None, scan()))
    assert not reaching.any()  # the wall reaches the highest ring, so it may go on


def test_sky_share_is_soft_and_depth_infinite_where_it_is_alone() -> None:
    truth = true_depth()
    share = torch.zeros(1, HEIGHT, WIDTH)
    share[:, :20], share[:, 20:25], share[:, 60:] = 1.0, 0.6, 1.0
    seen: dict[str, object] = {}

    def find(rgb: Tensor, *, horizon_row: float, returns: Tensor) -> Tensor:
        seen.update(horizon_row=horizon_row, returns=returns, shape=tuple(rgb.shape))
        return share

    scene = CompletedDepth(scan(), T_CAMERA_FROM_LIDAR, sky=find).scene(CAMERA, HEIGHT, WIDTH, image=picture(truth))
    assert scene.confidence == COMPLETED
    assert scene.sky is not None
    assert torch.isinf(scene.depth_m[:, :20]).all()
    assert torch.isfinite(scene.depth_m[:, 20:]).all()  # partly sky: the surface; below the horizon: never sky
    torch.testing.assert_close(scene.sky[:, 20:25], share[:, 20:25])
    assert scene.sky[:, 51:].sum() == 0
    assert seen["horizon_row"] == 50.0
    assert seen["shape"] == (3, HEIGHT, WIDTH)
    assert isinstance(seen["returns"], Tensor)
    assert seen["returns"].shape == (1, HEIGHT, WIDTH)
    assert 0.02 < seen["returns"].float().mean() < 0.8
    given = CompletedDepth(scan(), T_CAMERA_FROM_LIDAR, sky=share).scene(CAMERA, HEIGHT, WIDTH, image=picture(truth))
    assert torch.equal(given.depth_m, scene.depth_m)


def test_horizon_follows_the_pitch() -> None:
    up = replace(CAMERA, pitch_rad=0.1)  # looks up: the horizon lies 25 px lower
    share = torch.ones(1, HEIGHT, WIDTH)
    scene = CompletedDepth(scan(), T_CAMERA_FROM_LIDAR, sky=share).scene(up, HEIGHT, WIDTH)
    assert scene.sky is not None
    rows = (scene.sky[0] > 0).any(1).nonzero().flatten()
    assert int(rows.max()) == 75


def test_a_batch_of_pictures_gives_what_each_one_gives() -> None:
    truth = true_depth()
    one, other = picture(truth), torch.full((3, HEIGHT, WIDTH), 0.5)
    source = CompletedDepth(scan(), T_CAMERA_FROM_LIDAR, sky=no_sky)
    both = source(CAMERA, HEIGHT, WIDTH, image=torch.stack([one, other]))
    assert both.shape == (2, 1, HEIGHT, WIDTH)
    assert torch.equal(both[0], source(CAMERA, HEIGHT, WIDTH, image=one))
    assert torch.equal(both[1], source(CAMERA, HEIGHT, WIDTH, image=other))
    assert torch.equal(both[0], source(CAMERA, HEIGHT, WIDTH, image=(one * 255).round().byte())) or torch.allclose(
        both[0], source(CAMERA, HEIGHT, WIDTH, image=(one * 255).round().byte()), rtol=0.3
    )


def test_a_mosaic_guides_as_its_grey_picture() -> None:
    truth = true_depth()
    found = completed(picture(truth)[:1])
    assert (off(found, truth, slice(40, 90)) > 0.25).sum() < (off(completed(), truth, slice(40, 90)) > 0.25).sum()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_handful_of_points_still_fills_the_picture(count: int) -> None:
    cloud = torch.tensor([[20.0, 1.0, 0.0], [20.0, -2.0, 0.0], [20.0, 0.0, -1.0]])[:count]
    found = completed(None, cloud)
    assert np.isfinite(found[51:]).all()
    np.testing.assert_allclose(found[np.isfinite(found)], 20.0 - 0.3, rtol=1e-6)


def test_hidden_points_lie_between_nearer_ones_and_grazing_road_is_kept() -> None:
    row, column = (
        place.ravel() for place in np.meshgrid(np.arange(60.0, 119, 5), np.arange(4.0, 316, 2), indexing="ij")
    )
    road = road_depth()[row.astype(int), column.astype(int)]
    assert not hidden_points(column, row, road, HEIGHT, WIDTH).any()
    # Close rows, as of a map: the next row of the road is many metres nearer, and within the search's strip.
    near_horizon = np.meshgrid(np.arange(54.0, 70), np.arange(4.0, 316, 2), indexing="ij")
    far = road_depth()[near_horizon[0].astype(int), near_horizon[1].astype(int)].ravel()
    close = (near_horizon[1].ravel(), near_horizon[0].ravel(), far, HEIGHT, WIDTH)
    assert not hidden_points(*close, 1.0 / (250.0 * GROUND_M)).any()
    wall = np.full(len(row), 8.0)
    behind = (np.arange(len(row)) % 7) == 3
    found = hidden_points(column, row, np.where(behind, 30.0, wall), HEIGHT, WIDTH)
    inside = (column > 10) & (column < 305)
    assert np.array_equal(found[inside], behind[inside])
    # A step to one side alone hides nothing.
    half = np.where(column < 160, 8.0, 30.0)
    found = hidden_points(column, row, half, HEIGHT, WIDTH)
    assert not found[np.abs(column - 160) > 1].any()  # nearer, within the tolerance of the calibration


def test_returns_from_behind_a_pane_are_found_and_those_over_a_gap_are_kept() -> None:
    row, column = (
        place.ravel() for place in np.meshgrid(np.arange(2.0, 119, 5), np.arange(4.0, 316, 2), indexing="ij")
    )
    # At 10 m and 250 px: 0.72 x 0.4 m are 18 x 10 px.
    pane = (np.abs(column - 160) < 9) & (np.abs(row - 60) < 5)
    found = enclosed_returns(column, row, np.where(pane, 25.0, 10.0), HEIGHT, WIDTH, 250.0, 250.0)
    assert pane.sum() >= 9
    assert np.array_equal(found, pane)
    together = unseen_points(column, row, np.where(pane, 25.0, 10.0), HEIGHT, WIDTH, 250.0, 250.0, GROUND_M)
    assert np.array_equal(together, pane)
    gap = np.abs(column - 160) < 9  # open above and below; its rim lies within the tolerance of the calibration
    found = enclosed_returns(column, row, np.where(gap, 25.0, 10.0), HEIGHT, WIDTH, 250.0, 250.0)
    assert not found[np.abs(column - 160) < 6].any()
    gate = (np.abs(column - 160) < 40) & (np.abs(row - 60) < 30)  # 3.2 x 2.4 m
    assert not enclosed_returns(column, row, np.where(gate, 25.0, 10.0), HEIGHT, WIDTH, 250.0, 250.0).any()


def test_a_single_far_point_is_left_out_and_a_single_near_one_is_kept() -> None:
    row, column = (
        place.ravel() for place in np.meshgrid(np.arange(2.0, 119, 5), np.arange(4.0, 316, 5), indexing="ij")
    )
    depth_m = np.full(len(row), 10.0)
    depth_m[500], depth_m[700] = 30.0, 3.0
    assert np.flatnonzero(lonely_points(column, row, depth_m)).tolist() == [500]


def test_unseen_points_are_those_of_the_scene_behind_the_box() -> None:
    # From 1 m higher the scanner sees the wall's foot and the road behind the box, which the camera does not.
    truth = true_depth()
    column, row = np.meshgrid(np.arange(60, 200, 2), np.arange(55, 90, 3))
    column, row = column.ravel().astype(float), row.ravel().astype(float)
    depth_m = truth[row.astype(int), column.astype(int)]
    through = (np.arange(len(row)) % 11 == 5) & (depth_m < 10)
    found = unseen_points(column, row, np.where(through, WALL_M, depth_m), HEIGHT, WIDTH, 250.0, 250.0, GROUND_M)
    assert found[through].mean() > 0.7
    assert found[~through].mean() < 0.02


def test_what_is_refused() -> None:
    with pytest.raises(ValueError, match=r"points_xyz must have shape \(N, 3 or more\)"):
        CompletedDepth(torch.zeros(4), T_CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match="must be finite"):
        CompletedDepth(torch.tensor([[1.0, torch.nan, 0.0]]), T_CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match="4 x 4"):
        CompletedDepth(torch.ones(1, 3), torch.eye(3))
    behind = CompletedDepth(torch.tensor([[-5.0, 0.0, 0.0]]), T_CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match="no point of the cloud falls into the image"):
        behind(CAMERA, HEIGHT, WIDTH)
    source = CompletedDepth(scan(), T_CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match=r"image must have shape \(\.\.\., 3 or 1, 120, 320\)"):
        source(CAMERA, HEIGHT, WIDTH, image=torch.zeros(3, 10, 10))
