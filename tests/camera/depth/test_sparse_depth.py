"""Depth maps with unknown pixels: completed, never taken for sky; and other encodings."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchweather import BayerFog, Fog
from torchweather.camera.depth.scene_depth import COMPLETED
from torchweather.camera.depth.sparse import CompletedDepthMap, along_ray_to_axis, depth_from_disparity
from torchweather.core.errors import TorchweatherWarning
from torchweather.sensors import Camera

HEIGHT, WIDTH = 96, 128
CAMERA = Camera.from_intrinsics(fx=100.0, fy=100.0, cx=63.5, cy=30.0, width=WIDTH, height=HEIGHT)


def scattered(depth_m: Tensor, share: float = 0.045, first_row: int = 30, unknown: float = 0.0) -> Tensor:
    """A map that knows a share of its lower rows, as a projected LiDAR does."""
    known = torch.rand(depth_m.shape, generator=torch.Generator().manual_seed(1)) < share
    known[:first_row] = False
    return torch.where(known, depth_m, unknown)


def ground() -> Tensor:
    row = torch.arange(HEIGHT, dtype=torch.float64)[:, None].expand(HEIGHT, WIDTH)
    return 1.65 * 100.0 / (row - 30.0).clamp_min(1.0)


def test_fog_of_100_m_on_ground_at_10_m_that_one_pixel_in_twenty_knows() -> None:
    depth_m = CompletedDepthMap(scattered(torch.full((HEIGHT, WIDTH), 10.0)))(CAMERA, HEIGHT, WIDTH)
    transmission = torch.exp(math.log(0.05) / 100.0 * depth_m)
    assert float(transmission[:, 30:].mean()) == pytest.approx(0.74, abs=0.005)


@pytest.mark.parametrize("unknown", [0.0, math.nan, -math.inf, -1.0])
def test_zero_nan_and_negative_values_are_unknown(unknown: float) -> None:
    sparse = scattered(ground(), unknown=unknown)
    found = CompletedDepthMap(sparse)(CAMERA, HEIGHT, WIDTH, dtype=torch.float64)
    assert torch.isfinite(found[:, 40:]).all()
    error = (found[0, 45:] / ground()[45:] - 1).abs()
    assert float(error.median()) < 0.01


def test_measured_pixels_keep_their_values() -> None:
    sparse = scattered(ground())
    found = CompletedDepthMap(sparse)(CAMERA, HEIGHT, WIDTH, dtype=torch.float64)[0]
    measured = sparse > 0
    measured[:40] = False  # nearer the horizon, depth grows by 10 % and more from row to row
    assert measured.sum() > 200
    assert torch.equal(found[measured], sparse[measured])


def test_infinite_depth_stays_sky_and_nothing_else_becomes_it() -> None:
    sparse = scattered(torch.full((HEIGHT, WIDTH), 10.0))
    sparse[:12] = torch.inf
    scene = CompletedDepthMap(sparse).scene(CAMERA, HEIGHT, WIDTH)
    assert scene.confidence == COMPLETED
    assert torch.equal(torch.isinf(scene.depth_m[0]), torch.isinf(sparse))
    assert torch.equal(scene.sky_share[0] == 1, torch.isinf(sparse))


def test_a_dense_map_with_holes_keeps_every_known_pixel_and_fills_the_holes() -> None:
    truth = ground().clamp(max=60.0)
    holes = truth.clone()
    holes[50:58, 40:60] = 0.0
    holes[:, 100:103] = math.nan
    found = CompletedDepthMap(holes)(CAMERA, HEIGHT, WIDTH, dtype=torch.float64)[0]
    known = holes > 0
    assert torch.equal(found[known], holes[known])
    torch.testing.assert_close(found[45:, 100:103], truth[45:, 100:103], rtol=0.02, atol=0.0)
    torch.testing.assert_close(found[50:58, 40:60], truth[50:58, 40:60], rtol=0.02, atol=0.0)


def test_a_far_value_between_near_ones_is_not_kept() -> None:
    sparse = scattered(torch.full((HEIGHT, WIDTH), 5.0), share=0.2)
    row, column = 60, 64
    sparse[row, column], sparse[row, column - 1], sparse[row, column + 1] = 40.0, 5.0, 5.0
    found = CompletedDepthMap(sparse)(CAMERA, HEIGHT, WIDTH)
    assert float(found[0, row, column]) == pytest.approx(5.0)


def test_a_batch_of_maps_gives_what_each_one_gives() -> None:
    maps = torch.stack([scattered(ground()), scattered(torch.full((HEIGHT, WIDTH), 10.0).double())])[:, None]
    both = CompletedDepthMap(maps)(CAMERA, HEIGHT, WIDTH)
    assert both.shape == (2, 1, HEIGHT, WIDTH)
    for index in range(2):
        assert torch.equal(both[index], CompletedDepthMap(maps[index])(CAMERA, HEIGHT, WIDTH))
    # Dimensions broadcast: each map with three pictures.
    pictures = torch.full((2, 3, 1, HEIGHT, WIDTH), 0.5)
    each = CompletedDepthMap(maps[:, None])(CAMERA, HEIGHT, WIDTH, image=pictures)
    assert each.shape == (2, 3, 1, HEIGHT, WIDTH)
    assert float(each[0, 2, 0, 90].median()) < 5.0
    assert float(each[1, 0, 0, 90].median()) == pytest.approx(10.0)


@pytest.mark.parametrize("value", [0.0, math.nan, math.inf])
def test_a_map_without_any_depth_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="the whole map is unknown or sky"):
        CompletedDepthMap(torch.full((HEIGHT, WIDTH), value))


def test_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="CompletedDepthMap: depth_m must have the image's size, 4 x 6; got 96 x 128"):
        CompletedDepthMap(scattered(ground()))(CAMERA, 4, 6)
    with pytest.raises(ValueError, match="depth_m must have shape"):
        CompletedDepthMap(torch.ones(3, 4, 4))


def test_distance_along_the_ray_becomes_depth_along_the_axis_also_through_a_lens() -> None:
    camera = Camera.from_intrinsics(
        fx=80.0, fy=90.0, cx=60.0, cy=40.0, width=WIDTH, height=HEIGHT, k1=-0.1, k2=0.02, p1=0.001
    )
    depth_m = 5.0 + 30.0 * torch.rand(2, 1, HEIGHT, WIDTH, dtype=torch.float64)
    points = depth_m * camera.ray_directions(dtype=torch.float64)
    torch.testing.assert_close(along_ray_to_axis(points.norm(dim=1, keepdim=True), camera), depth_m)
    with pytest.raises(TypeError, match="floating point"):
        along_ray_to_axis(torch.ones(4, 4, dtype=torch.int32), camera)


def test_disparity_becomes_depth_and_zero_is_unknown() -> None:
    found = depth_from_disparity(torch.tensor([36.0, 0.0, -2.0, torch.nan]), fx_px=720.0, baseline_m=0.5)
    torch.testing.assert_close(found, torch.tensor([10.0, torch.nan, torch.nan, torch.nan]), equal_nan=True)
    assert depth_from_disparity(torch.tensor([36]), 720.0, 0.5).tolist() == [10.0]
    with pytest.raises(ValueError, match="baseline_m"):
        depth_from_disparity(torch.ones(1), 720.0, 0.0)


def _street(height: int = 96, width: int = 128) -> tuple[Camera, Tensor, Tensor]:
    """A camera, its frame, and a wall 10 m away below the sky in rows 0 to 29."""
    camera = Camera.from_intrinsics(fx=1000.0, fy=1000.0, cx=63.5, cy=27.0, width=width, height=height)
    depth_m = torch.full((1, height, width), 10.0)
    depth_m[:, :30] = torch.inf
    return camera, torch.full((1, height, width), 0.3), depth_m


@pytest.mark.parametrize("unknown", [0.0, math.nan, -math.inf])
def test_sparse_depth_gives_the_fog_of_whole_depth(unknown: float) -> None:
    camera, frame, whole = _street()
    sparse = torch.full_like(whole, unknown)
    sparse[:, 30::4, ::4] = 10.0
    fog = BayerFog(Fog(mor_m=100), camera, airlight=0.7)
    for given in (sparse, sparse.expand(2, 1, -1, -1)):
        with pytest.raises(ValueError, match=r"CompletedDepthMap\(depth\)"):
            fog(frame.expand(*given.shape[:-3], 1, -1, -1), given)
    with pytest.raises(ValueError, match=r"CompletedDepthMap\(depth\)"):
        BayerFog(Fog(mor_m=100), camera, airlight=0.7, depth=sparse.numpy())
    completed = BayerFog(Fog(mor_m=100), camera, airlight=0.7, depth=CompletedDepthMap(sparse)).run(frame)
    # exp(-3.0 / 100 m x 10 m)
    assert float(completed.transmission[:, 30:].mean()) == pytest.approx(0.741, abs=0.01)
    assert float(fog.run(frame, whole).transmission[:, 30:].mean()) == pytest.approx(0.741, abs=0.002)


def test_zeros_are_counted_and_sky_on_the_road_is_warned_of() -> None:
    camera, frame, whole = _street()
    fog = BayerFog(Fog(mor_m=100), camera, airlight=0.7)
    sparse = torch.where(torch.arange(128) % 4 == 0, whole, torch.inf)
    for transform, depth in ((fog, sparse), (BayerFog(Fog(mor_m=100), camera, airlight=0.7, depth=sparse), None)):
        with pytest.warns(
            TorchweatherWarning, match=r"82\.8% of the depth map is infinite.*75\.0% of its lowest third"
        ):
            transform(frame, depth)
    holes = whole.clone()
    holes[:, 90] = 0.0
    with pytest.raises(ValueError, match=r"got 0 m in 128 of 12288 pixels \(1\.0%\)"):
        fog(frame, holes)
    # A camera that looks up sees sky everywhere, and a map of sky alone is meant so.
    fog(frame, torch.full_like(whole, torch.inf))
    upward = replace(camera, pitch_rad=0.5)
    BayerFog(Fog(mor_m=100), upward, airlight=0.7)(frame, sparse)


def test_a_map_in_centimetres_is_warned_of() -> None:
    camera, frame, whole = _street()
    fog = BayerFog(Fog(mor_m=100), camera, airlight=0.7)
    sloped = whole * torch.linspace(2.0, 0.5, 96)[:, None]
    with pytest.warns(TorchweatherWarning, match="nearer than 500 m.*divide centimetres by 100"):
        fog(frame, 100.0 * sloped)
    fog(frame, sloped)
