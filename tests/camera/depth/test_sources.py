"""Depth sources: geometry in closed form, and what they refuse."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from torchweather.image import (
    ConstantDepth,
    DepthFromCallable,
    DepthFromPoints,
    DepthMap,
    FlatGround,
    as_depth_source,
    check_depth,
    project_points,
)
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(fx=500.0, fy=500.0, cx=99.5, cy=59.5, width=200, height=120, height_m=1.6)
CAMERA_FROM_LIDAR = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)


def test_flat_ground_lies_at_the_camera_height_below_every_ray() -> None:
    depth = FlatGround()(CAMERA, 120, 200, dtype=torch.float64)
    assert depth.shape == (1, 120, 200)
    points = depth * CAMERA.ray_directions(120, 200, dtype=torch.float64)
    below = torch.isfinite(depth[0])
    torch.testing.assert_close(points[1][below], torch.full_like(points[1][below], 1.6))
    assert torch.equal(below[:, 0], torch.arange(120) > 59.5)


@pytest.mark.parametrize("pitch", [-0.05, 0.03])
def test_horizon_moves_by_focal_length_times_tangent_of_pitch(pitch: float) -> None:
    depth = FlatGround(pitch_rad=pitch)(CAMERA, 120, 200)
    horizon_row = 59.5 + 500.0 * math.tan(pitch)  # looking up moves it down in the picture
    assert torch.equal(torch.isinf(depth[0, :, 100]), torch.arange(120) < horizon_row)


def test_ground_is_flat_in_the_world_under_pitch_roll_and_lens_distortion() -> None:
    camera = Camera.from_intrinsics(
        fx=500.0, fy=490.0, cx=90.0, cy=50.0, width=200, height=120,
        height_m=1.2, pitch_rad=-0.1, roll_rad=0.2, k1=-0.2, k2=0.05, p1=0.001,
    )  # fmt: skip
    depth = FlatGround()(camera, 120, 200, dtype=torch.float64)
    points = depth * camera.ray_directions(120, 200, dtype=torch.float64)
    gravity = torch.tensor(camera.down_direction(), dtype=torch.float64)
    fallen = torch.einsum("c,chw->hw", gravity, points)[torch.isfinite(depth[0])]
    torch.testing.assert_close(fallen, torch.full_like(fallen, 1.2))


def test_one_point_lands_on_its_pixel_with_its_depth_along_the_axis() -> None:
    # 20 m ahead, 1 m left, 0.4 m up: column 99.5 - 25, row 59.5 - 10.
    point = torch.tensor([[20.0, 1.0, 0.4, 0.7]])
    x, y, depth, seen = project_points(point.double(), CAMERA_FROM_LIDAR, CAMERA)
    assert (x.item(), y.item(), depth.item(), seen.item()) == pytest.approx((74.5, 49.5, 20.0, True))
    found = DepthFromPoints(point, CAMERA_FROM_LIDAR, fill="none")(CAMERA, 120, 200)
    assert torch.isfinite(found).sum() == 1
    assert found.min() == 20.0


def test_nearest_of_two_points_in_a_pixel_wins() -> None:
    points = torch.tensor([[40.0, 0.0, 0.0], [10.0, 0.0, 0.0], [25.0, 0.0, 0.0]])
    found = DepthFromPoints(points, CAMERA_FROM_LIDAR, fill="none")(CAMERA, 120, 200)
    assert found.isfinite().sum() == 1
    assert found.min() == 10.0


def test_points_behind_beside_and_without_return_are_not_seen() -> None:
    points = torch.tensor([[-20.0, 0, 0], [20.0, 30.0, 0], [0.0, 0.0, 0.0], [0.05, 0, 0]]).double()
    shifted = CAMERA_FROM_LIDAR.clone()
    shifted[2, 3] = 0.01
    assert not project_points(points, shifted, CAMERA)[3].any()


def test_distortion_does_not_fold_far_points_back_into_the_picture() -> None:
    camera = Camera.from_intrinsics(fx=500.0, fy=500.0, cx=99.5, cy=59.5, width=200, height=120, k1=-0.3)
    sideways = torch.tensor([[1.0, 1.826, 0.0]], dtype=torch.float64)  # 1 + k1 r^2 = 0: the polynomial says centre
    assert not project_points(sideways, CAMERA_FROM_LIDAR, camera)[3].any()
    assert project_points(sideways * torch.tensor([50.0, 1, 1]), CAMERA_FROM_LIDAR, camera)[3].all()


def scan_of_a_wall(distance_m: float) -> torch.Tensor:
    azimuth, elevation = torch.meshgrid(torch.linspace(-0.3, 0.3, 150), torch.linspace(-0.2, 0.05, 40), indexing="ij")
    return torch.stack(
        [torch.full_like(azimuth, distance_m), distance_m * azimuth.tan(), distance_m * elevation.tan()], -1
    ).reshape(-1, 3)


@pytest.mark.parametrize("fill", ["linear", "nearest"])
def test_scan_of_a_wall_fills_the_picture_up_to_the_top_beam(fill: str) -> None:
    found = DepthFromPoints(scan_of_a_wall(12.0), CAMERA_FROM_LIDAR, fill=fill, above="sky")(CAMERA, 120, 200)
    top_row = 59.5 - 500.0 * math.tan(0.05)
    assert torch.isinf(found[0, : math.floor(top_row)]).all()
    # The wall is one depth; only float32 rounding of the points is left.
    torch.testing.assert_close(found[0, math.ceil(top_row) :], torch.full((120 - math.ceil(top_row), 200), 12.0))


@pytest.mark.parametrize("above", ["nearest", "auto"])
def test_wall_that_reaches_the_upper_beam_goes_on_above_it(above: str) -> None:
    found = DepthFromPoints(scan_of_a_wall(12.0), CAMERA_FROM_LIDAR, above=above)(CAMERA, 120, 200)
    torch.testing.assert_close(found, torch.full_like(found, 12.0))


def test_sky_stands_over_a_fence_that_ends_below_the_upper_beam() -> None:
    """Left half a wall up to the upper beam, right half a low fence over which beams found nothing."""
    scan = scan_of_a_wall(12.0)
    left, low = scan[:, 1] > 0, scan[:, 2] < 12.0 * math.tan(-0.05)
    found = DepthFromPoints(scan[left | low], CAMERA_FROM_LIDAR)(CAMERA, 120, 200)
    assert torch.isfinite(found[0, :, :90]).all()
    fence_row = 59.5 + 500.0 * math.tan(0.05)
    assert torch.isinf(found[0, : math.floor(fence_row), 110:]).all()
    assert torch.isfinite(found[0, math.ceil(fence_row) + 4 :]).all()


def test_road_between_the_rings_is_a_plane() -> None:
    """Rings on a road 1.6 m below, a degree apart: inverse depth is linear in the picture, so planes are exact."""
    elevation, azimuth = torch.meshgrid(torch.linspace(-0.12, -0.02, 7), torch.linspace(-0.25, 0.25, 80), indexing="ij")
    reach = 1.6 / -elevation.tan()
    road = torch.stack([reach * azimuth.cos(), reach * azimuth.sin(), torch.full_like(reach, -1.6)], -1).reshape(-1, 3)
    truth = FlatGround()(CAMERA, 120, 200)
    rows = slice(78, 112)  # between the outermost rings
    linear = DepthFromPoints(road, CAMERA_FROM_LIDAR)(CAMERA, 120, 200)
    nearest = DepthFromPoints(road, CAMERA_FROM_LIDAR, fill="nearest")(CAMERA, 120, 200)
    error = (linear / truth - 1)[:, rows, 20:180].abs()
    # A pixel with a point shows that point's depth, up to half a pixel off: 0.5 of 18 px below the horizon is 2.7 %.
    assert error.max() < 0.03
    assert error.mean() < 0.1 * (nearest / truth - 1)[:, rows, 20:180].abs().mean()


def test_edge_between_two_objects_stays_a_step() -> None:
    """A post at 5 m before a wall at 40 m: no pixel may hang in the air between the two."""
    azimuth, elevation = torch.meshgrid(torch.linspace(-0.25, 0.25, 60), torch.linspace(-0.15, 0.15, 20), indexing="ij")
    reach = torch.where(azimuth.abs() < 0.05, 5.0, 40.0)
    scan = torch.stack([reach, reach * azimuth.tan(), reach * elevation.tan()], -1).reshape(-1, 3)
    found = DepthFromPoints(scan, CAMERA_FROM_LIDAR, above="nearest")(CAMERA, 120, 200)
    assert ((found - 5).abs() < 1e-3).logical_or((found - 40).abs() < 1e-2).all()


def test_hole_takes_the_depth_of_the_nearest_point() -> None:
    points = torch.tensor([[10.0, 1.5, 0.0], [30.0, -4.5, 0.0]])  # columns 24.5 and 174.5, same row
    found = DepthFromPoints(points, CAMERA_FROM_LIDAR, fill="nearest", above="nearest")(CAMERA, 120, 200)
    assert found[0, 60, 90] == 10.0
    assert found[0, 60, 110] == 30.0


def test_cloud_beside_the_picture_is_refused_when_holes_are_to_be_filled() -> None:
    source = DepthFromPoints(torch.tensor([[-5.0, 0, 0]]), CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match="no point of the cloud falls into the image"):
        source(CAMERA, 120, 200)


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (30, ConstantDepth),
        (np.float32(3.0), ConstantDepth),
        (torch.tensor(3.0), ConstantDepth),
        (torch.ones(4, 6), DepthMap),
        (np.ones((1, 4, 6)), DepthMap),
        (FlatGround(), FlatGround),
        (lambda image: image * 0 + 5, DepthFromCallable),
    ],
)
def test_anything_sensible_becomes_a_source(given: object, kind: type) -> None:
    source = as_depth_source(given)
    assert isinstance(source, kind)
    depth = source(CAMERA, 4, 6, dtype=torch.float64, image=torch.zeros(1, 4, 6))
    assert depth.shape == (1, 4, 6)
    assert depth.dtype == torch.float64


def test_text_is_no_depth() -> None:
    with pytest.raises(TypeError, match=r"read_depth"):
        as_depth_source("depth.png")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ConstantDepth(-1.0), r"depth_m must be 0 m or more; got -1"),
        (lambda: ConstantDepth(math.nan), "got nan"),
        (
            lambda: DepthMap(torch.tensor([[1.0, math.nan], [-2.0, 3.0]])),
            "got 1 NaN, 1 negative and 0 zero of 4 pixels",
        ),
        (lambda: DepthMap(torch.ones(2, 2))(CAMERA, 4, 6), r"4 x 6; got 2 x 2"),
        (lambda: check_depth(torch.ones(3, 4, 6), 4, 6, owner="x"), r"\(\.\.\., 1, 4, 6\)"),
        (lambda: FlatGround(camera_height_m=0.0), "above 0 m"),
        (lambda: DepthFromPoints(torch.ones(5, 2), torch.eye(4)), r"got \(5, 2\)"),
        (lambda: DepthFromPoints(torch.full((5, 3), math.nan), torch.eye(4)), "finite"),
        (lambda: DepthFromPoints(torch.ones(5, 3), torch.eye(3)), "4 x 4"),
        (lambda: DepthFromPoints(torch.ones(5, 3), torch.eye(4), fill="cubic"), "linear, nearest, none"),
        (lambda: DepthFromCallable(lambda x: x)(CAMERA, 4, 6), "image="),
        (lambda: DepthFromCallable(lambda x: x)(CAMERA, 4, 6, image=torch.ones(1, 4, 4)), r"got \(1, 4, 4\)"),
    ],
)
def test_wrong_depth_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_infinite_depth_is_sky_and_allowed() -> None:
    assert torch.isinf(ConstantDepth(math.inf)(CAMERA, 2, 2)).all()
    check_depth(torch.full((1, 2, 2), math.inf), owner="x")


def test_map_keeps_its_batch() -> None:
    assert DepthMap(torch.ones(5, 1, 4, 6))(CAMERA, 4, 6).shape == (5, 1, 4, 6)
