"""Scan patterns: directions, ring recovery and empty beams against known patterns; the LiDAR presets."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.recordings import recording
from torchweather.core.errors import TorchweatherWarning
from torchweather.lidar.scan import empty_beams, estimate_elevations, recover_ring, scan_directions
from torchweather.sensors import Lidar

PATTERNS = [name for name in Lidar.presets() if Lidar.preset(name).elevations_deg]
SMALL = Lidar(
    905.0, elevations_deg=(6.0, 2.0, -2.0, -7.0), columns=90, azimuth_offsets_deg=(0.0, 1.3, -2.6, 0.7)
)  # 4 degrees a step


def cells(ring: Tensor, column: Tensor, columns: int) -> list[int]:
    return sorted((ring * columns + column).tolist())


def turned(points: Tensor, azimuth_deg: float) -> Tensor:
    a = math.radians(azimuth_deg)
    rotation = torch.tensor([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]], dtype=points.dtype)
    return torch.cat([points[..., :2] @ rotation.T, points[..., 2:]], dim=-1)


def azimuths(directions: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(directions[..., 1], directions[..., 0]))


# directions


@pytest.mark.parametrize("name", PATTERNS)
def test_a_preset_scans_all_its_cells_with_unit_vectors(name: str) -> None:
    lidar = Lidar.preset(name)
    assert lidar.elevations_deg is not None
    assert lidar.columns is not None
    directions = scan_directions(lidar, dtype=torch.float64)
    assert directions.shape == (len(lidar.elevations_deg) * lidar.columns, 3)
    # Rounding of sine and cosine.
    assert (directions.norm(dim=-1) - 1).abs().max() < 1e-14
    elevation = torch.rad2deg(torch.asin(directions[:, 2])).reshape(-1, lidar.columns)
    assert (elevation - torch.tensor(lidar.elevations_deg, dtype=torch.float64)[:, None]).abs().max() < 1e-10


def test_columns_run_clockwise_from_above_and_start_ahead() -> None:
    lidar = Lidar(905.0, elevations_deg=(0.0,), columns=4)
    ahead, right, back, left = scan_directions(lidar, dtype=torch.float64)
    assert torch.allclose(ahead, torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))
    assert torch.allclose(right, torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64), atol=1e-15)
    assert torch.allclose(back, torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64), atol=1e-15)
    assert torch.allclose(left, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), atol=1e-15)


def test_an_azimuth_offset_turns_its_ring_to_the_left() -> None:
    directions = scan_directions(SMALL, dtype=torch.float64).reshape(4, 90, 3)
    assert azimuths(directions[:, 0]).tolist() == pytest.approx([0.0, 1.3, -2.6, 0.7], abs=1e-12)


@pytest.mark.parametrize("name", ["ouster-os0-128", "ouster-os1-128", "ouster-os2-128"])
def test_ouster_directions_follow_the_makers_formula(name: str) -> None:
    lidar = Lidar.preset(name)
    assert lidar.elevations_deg is not None
    assert lidar.azimuth_offsets_deg is not None
    # Ouster, "Lidar range to XYZ": encoder angle 2 pi (1 - column / columns), beam azimuth negative, then half a turn
    # from the lidar frame (x to the connector at the back) to the sensor frame (x forward).
    directions = scan_directions(lidar, dtype=torch.float64).reshape(128, 1024, 3)
    for ring, column in [(0, 0), (1, 7), (64, 300), (127, 1023)]:
        beam_azimuth = 180.0 - lidar.azimuth_offsets_deg[ring]
        theta = 2 * math.pi * (1 - column / 1024) - math.radians(beam_azimuth)
        phi = math.radians(lidar.elevations_deg[ring])
        wanted = [-math.cos(theta) * math.cos(phi), -math.sin(theta) * math.cos(phi), math.sin(phi)]
        assert directions[ring, column].tolist() == pytest.approx(wanted, abs=1e-12)
    # The four azimuths of a column repeat from ring to ring; they stagger by less than half a step per unit.
    assert abs(lidar.azimuth_offsets_deg[0] - lidar.azimuth_offsets_deg[4]) < 0.5


def test_a_sensor_without_pattern_is_refused() -> None:
    with pytest.raises(ValueError, match=r"scan_directions: Lidar\(elevations_deg=\.\.\.\) must be known.*got None"):
        scan_directions(Lidar(905.0))
    with pytest.raises(ValueError, match=r"scan_directions: Lidar\(columns=\.\.\.\) must be known.*got None"):
        scan_directions(Lidar(905.0, elevations_deg=(0.0,)))


# rings


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("range_m", [1.0, 120.0])
def test_every_ring_of_a_preset_is_recovered_in_float32(name: str, range_m: float) -> None:
    lidar = Lidar.preset(name, origin_heights_m=None)
    assert lidar.elevations_deg is not None
    assert lidar.columns is not None
    ring = recover_ring(range_m * scan_directions(lidar), lidar)
    assert torch.equal(ring, torch.arange(len(lidar.elevations_deg)).repeat_interleave(lidar.columns))


def test_a_point_goes_to_the_ring_nearest_in_elevation() -> None:
    elevation = torch.deg2rad(torch.tensor([30.0, 4.1, 3.9, 0.1, -0.1, -4.4, -4.6, -60.0]))
    points = 20.0 * torch.stack([torch.zeros(8), elevation.cos(), elevation.sin()], dim=-1)
    assert recover_ring(points, SMALL).tolist() == [0, 0, 1, 1, 2, 2, 3, 3]


def test_points_without_return_have_no_ring() -> None:
    points = torch.tensor([[0.0, 0, 0, 7], [math.nan, 1, 1, 7], [1, math.inf, 0, 7], [5, 0, 0.2, 7]])
    assert recover_ring(points, SMALL).tolist() == [-1, -1, -1, 1]
    assert recover_ring(points[:0], SMALL).shape == (0,)


def test_a_batch_of_clouds_is_its_clouds_one_by_one() -> None:
    points = torch.randn(2, 3, 50, 5, generator=torch.Generator().manual_seed(1))
    together = recover_ring(points, SMALL, origin_heights_m=(0.2, 0.2, 0.1, 0.1))
    assert together.shape == (2, 3, 50)
    assert together.dtype == torch.int64
    for i in range(2):
        for j in range(3):
            assert torch.equal(together[i, j], recover_ring(points[i, j], SMALL, origin_heights_m=(0.2, 0.2, 0.1, 0.1)))


def test_rings_that_start_above_the_origin_need_their_heights() -> None:
    lidar = Lidar.preset("velodyne-hdl-64e", columns=180)
    heights = (0.15,) * 32 + (0.21,) * 32
    ring = torch.arange(64).repeat_interleave(180)
    points = 10.0 * scan_directions(lidar, dtype=torch.float64)
    points[:, 2] += torch.tensor(heights, dtype=torch.float64)[ring]
    assert torch.equal(recover_ring(points, lidar, origin_heights_m=heights), ring)
    assert torch.equal(recover_ring(points, lidar), ring)  # the preset's own
    # 0.21 m at 10 m are 1.2 degrees, of 0.34 degrees between rings: every ring of the upper block comes out too high,
    # up to the top of the pattern.
    off = recover_ring(points, replace(lidar, origin_heights_m=None)) - ring
    assert off[(ring >= 32) & (ring < 60)].min() >= 2


def test_wrong_heights_and_wrong_points_are_refused() -> None:
    with pytest.raises(
        ValueError, match="origin_heights_m must have one value in metres for each of the 4 rings; got 2"
    ):
        recover_ring(torch.zeros(3, 4), SMALL, origin_heights_m=(0.1, 0.2))
    with pytest.raises(ValueError, match=r"recover_ring: points must be floating point .*got torch.int64, \(3, 4\)"):
        recover_ring(torch.zeros(3, 4, dtype=torch.int64), SMALL)
    with pytest.raises(ValueError, match=r"empty_beams: points must be .*got torch.float32, \(3, 2\)"):
        empty_beams(torch.zeros(3, 2), SMALL)


# elevations of an unknown sensor


@pytest.mark.parametrize("noise_deg", [0.0, 0.2, 0.5])
def test_elevations_are_found_again_under_noise(noise_deg: float) -> None:
    truth = torch.arange(-15.0, 16.0, 2.0, dtype=torch.float64)
    n = 400
    generator = torch.Generator().manual_seed(3)
    elevation = truth.repeat_interleave(n) + noise_deg * torch.randn(16 * n, dtype=torch.float64, generator=generator)
    azimuth = 2 * math.pi * torch.rand(16 * n, dtype=torch.float64, generator=generator)
    e = torch.deg2rad(elevation)
    points = 30 * torch.stack([e.cos() * azimuth.cos(), e.cos() * azimuth.sin(), e.sin()], dim=-1)
    elevations, spread = estimate_elevations(points[torch.randperm(16 * n, generator=generator)], 16)
    # Standard error of a median, 1.25 sigma / sqrt(n); four of them for the worst of 16 rings. 1e-6: the coordinates.
    assert (elevations - truth).abs().max() < 4 * 1.25 * noise_deg / math.sqrt(n) + 1e-6
    # Standard error of the deviation from a median, 1.17 sigma / sqrt(n).
    assert (spread - noise_deg).abs().max() < 4 * 1.17 * noise_deg / math.sqrt(n) + 1e-6


def test_uneven_rings_of_uneven_size_and_stray_points_are_told_apart() -> None:
    lidar = Lidar.preset("pandar64-wads")
    directions = scan_directions(lidar, dtype=torch.float64).reshape(64, 1800, 3)
    thinned = torch.cat([directions[ring, : 200 + 25 * ring] for ring in range(64)])
    stray = torch.tensor([[1.0, 0.0, 0.7], [1.0, 0.0, -0.9]], dtype=torch.float64)
    elevations, spread = estimate_elevations(25 * torch.cat([thinned, stray]), 64)
    # Bins do not enter: medians of the points themselves.
    assert (elevations - torch.tensor(lidar.elevations_deg, dtype=torch.float64).sort().values).abs().max() < 1e-9
    assert spread.max() < 1e-9


@pytest.mark.parametrize("rings", [1, 4])
def test_few_rings_and_few_points_suffice_where_they_are_sharp(rings: int) -> None:
    lidar = Lidar(905.0, elevations_deg=tuple(range(rings)), columns=3)
    elevations, _ = estimate_elevations(scan_directions(lidar, dtype=torch.float64), rings)
    assert elevations.tolist() == pytest.approx(list(range(rings)), abs=1e-9)


@pytest.mark.parametrize("rings", [2, 3, 5, 20])
def test_a_cloud_that_does_not_show_that_many_rings_says_so(rings: int) -> None:
    generator = torch.Generator().manual_seed(5)
    cloud = scan_directions(SMALL).repeat(3, 1)
    cloud[:, 2] += 0.003 * torch.randn(len(cloud), generator=generator)
    assert len(estimate_elevations(cloud, 4)[0]) == 4
    if rings == 20:
        cloud = torch.randn(2000, 3, generator=generator)
    with pytest.raises(ValueError, match=rf"the cloud does not show {rings} rings; it shows \d+ to \d+ heaps"):
        estimate_elevations(cloud, rings)


def test_too_few_returns_for_the_rings_are_refused() -> None:
    with pytest.raises(ValueError, match="4 rings need as many returns or more; got 0"):
        estimate_elevations(torch.zeros(10, 3), 4)
    with pytest.raises(ValueError, match="rings must be 1 or more"):
        estimate_elevations(torch.ones(10, 3), 0)


# empty beams


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**31), st.floats(0.02, 0.9), st.floats(-180.0, 180.0))
def test_the_beams_taken_from_a_scan_are_found_at_any_phase(seed: int, share: float, phase_deg: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    directions = turned(scan_directions(SMALL, dtype=torch.float64), phase_deg)
    keep = torch.rand(360, generator=generator) > share
    # Each sector of 30 degrees has a point: the view is the full turn; top and bottom ring are seen.
    keep[torch.arange(0, 90, 3)] = True
    keep[270] = True
    keep[100] = False  # one at least is missing
    points = directions[keep] * (3 + 50 * torch.rand(int(keep.sum()), 1, dtype=torch.float64, generator=generator))
    found, ring, column = empty_beams(points[torch.randperm(len(points), generator=generator)], SMALL, max_gap_deg=30.0)
    missing = directions[~keep]
    assert len(found) == len(missing)
    distance = torch.cdist(found, missing)
    # Each missing direction once; a step is 0.07 rad. 1e-6: the phase of rings without points goes through sums.
    assert distance.min(0).values.max() < 1e-6
    assert distance.min(1).values.max() < 1e-6
    assert len(set(cells(ring, column, 90))) == len(ring)
    assert torch.equal(ring, recover_ring(found, SMALL))


def test_ring_and_column_are_those_of_the_scan() -> None:
    directions = scan_directions(SMALL)
    keep = torch.rand(360, generator=torch.Generator().manual_seed(2)) > 0.3
    found, ring, column = empty_beams(10 * directions[keep], SMALL)
    assert cells(ring, column, 90) == (~keep).nonzero()[:, 0].tolist()
    assert found.dtype == torch.float32
    assert (found - directions[ring * 90 + column]).abs().max() < 1e-5


def test_a_complete_scan_has_no_empty_beams_and_two_returns_of_a_beam_are_one() -> None:
    directions = scan_directions(SMALL)
    both = torch.cat([10 * directions, 25 * directions])
    assert len(empty_beams(10 * directions, SMALL)[0]) == 0
    assert len(empty_beams(both, SMALL)[0]) == 0
    assert len(empty_beams(torch.cat([both[:50], both[52:410], both[412:]]), SMALL)[0]) == 2


@pytest.mark.parametrize("drift", [-1.0, 1.0])
def test_neither_jitter_nor_a_drifting_speed_makes_or_hides_beams(drift: float) -> None:
    # One column too many or too few in the turn, and azimuths off by up to 15 % of a step.
    generator = torch.Generator().manual_seed(4)
    columns = 400
    lidar = Lidar(905.0, elevations_deg=(-5.0, 0.0, 5.0), columns=columns + int(drift))
    directions = scan_directions(Lidar(905.0, elevations_deg=(-5.0, 0.0, 5.0), columns=columns), dtype=torch.float64)
    step = 360.0 / columns
    azimuth = torch.deg2rad(azimuths(directions) + 0.3 * step * (torch.rand(1200, generator=generator) - 0.5))
    flat = directions[:, :2].norm(dim=-1)
    points = 20 * torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), directions[:, 2]], dim=-1)
    keep = torch.rand(1200, generator=generator) > 0.3
    found, ring, _ = empty_beams(points[keep].float(), lidar)
    missing = torch.bincount(torch.arange(3).repeat_interleave(columns)[~keep], minlength=3)
    assert (torch.bincount(ring, minlength=3) - missing).abs().max() <= 1
    # Evenly spread between its neighbours, a beam lies within half a step of its place.
    worst = torch.rad2deg(torch.cdist(found.double(), directions[~keep]).min(1).values).max()
    assert worst < 0.5 * step


def test_a_ring_without_points_inside_the_view_is_filled_whole() -> None:
    directions = scan_directions(SMALL).reshape(4, 90, 3)
    found, ring, column = empty_beams(10 * directions[[0, 1, 3]].reshape(-1, 3), SMALL)
    assert cells(ring, column, 90) == list(range(180, 270))
    # In the phase of the other rings, its own azimuth offset applied; 1e-5: float32.
    assert (found - directions[ring, column]).abs().max() < 1e-5
    # Above the highest and below the lowest ring seen the cloud says nothing.
    assert len(empty_beams(10 * directions[1:3].reshape(-1, 3), SMALL)[0]) == 0


@pytest.mark.parametrize("middle_deg", [0.0, 100.0, 180.0])
def test_a_crop_to_the_view_of_a_camera_is_not_completed_to_a_turn(middle_deg: float) -> None:
    lidar = Lidar.preset("velodyne-vlp-16")
    directions = scan_directions(lidar).reshape(16, 1808, 3)
    keep = torch.rand(16, 1808, generator=torch.Generator().manual_seed(6)) > 0.2
    keep[15] &= azimuths(directions[15]).abs() < 5.0  # the top ring sees the sky
    inside = azimuths(directions).abs() < 40.0
    crop = turned(10 * directions[keep & inside], middle_deg)
    found, ring, _ = empty_beams(crop, lidar)
    aside = azimuths(turned(found, -middle_deg))
    # At the border a ring whose last beams are missing may get one more, half a step outside.
    assert aside.abs().max() < 40.0 + 0.2
    missing = (inside & ~keep).sum(1)
    assert (torch.bincount(ring, minlength=16) - missing).abs().max() <= 2


def test_two_views_are_filled_apart() -> None:
    lidar = Lidar(905.0, elevations_deg=(-1.0, 1.0), columns=360)
    directions = scan_directions(lidar).reshape(2, 360, 3)
    columns = torch.cat([torch.arange(10, 40), torch.arange(200, 260)])
    points = directions[:, columns].reshape(-1, 3)
    keep = torch.ones(180, dtype=torch.bool)
    keep[[5, 6, 100, 29, 120]] = False  # 29 and 120: at the end and at the beginning of a view, seen by the other ring
    _, ring, column = empty_beams(10 * points[keep], lidar)
    rows = torch.cat([columns, 360 + columns])[~keep]
    assert cells(ring, column, 360) == sorted(rows.tolist())


def test_below_the_lowest_ring_of_a_crop_nothing_is_filled() -> None:
    lidar = Lidar(905.0, elevations_deg=(-20.0, -10.0, 0.0, 10.0), columns=360)
    directions = scan_directions(lidar).reshape(4, 360, 3)
    # A view of 80 degrees whose lower corners are cut: the lowest ring is seen within 10 degrees of its middle only.
    inside = azimuths(directions).abs() < 40.0
    inside[0] &= azimuths(directions[0]).abs() < 10.0
    sky = inside.clone()
    sky[3] &= azimuths(directions[3]) > 35.0
    found, ring, _ = empty_beams(10 * directions[sky], lidar)
    assert azimuths(found[ring == 0]).abs().max() < 10.0 + 10.0
    # The sky of the top ring is inside the view although it returned nothing.
    assert (ring == 3).sum() == (inside & ~sky)[3].sum()


@pytest.mark.parametrize("rows", [0, 1])
def test_a_cloud_of_no_point_or_one_covers_no_other_beam(rows: int) -> None:
    directions, ring, column = empty_beams(torch.ones(rows, 4), SMALL)
    assert directions.shape == (0, 3)
    assert ring.shape == column.shape == (0,)
    assert ring.dtype == column.dtype == torch.int64


def test_rows_without_return_are_no_points() -> None:
    directions = 10 * scan_directions(SMALL)
    directions[7] = 0.0
    directions[100] = math.nan
    assert cells(*empty_beams(directions, SMALL)[1:], 90) == [7, 100]
    assert len(empty_beams(torch.zeros(360, 3), SMALL)[0]) == 0


def test_a_ring_column_overrules_the_elevation_and_marks_lost_points() -> None:
    directions = 10 * scan_directions(SMALL)
    ring = torch.arange(4).repeat_interleave(90)
    ring[5] = -1
    assert cells(*empty_beams(directions, SMALL, ring)[1:], 90) == [5]
    swapped = torch.arange(4).flip(0).repeat_interleave(90)
    assert len(empty_beams(directions, SMALL, swapped)[0]) == 0


@pytest.mark.parametrize(("columns", "says"), [(1000, "Set columns=500"), (250, "Set columns=500")])
def test_a_cloud_of_another_speed_is_named(columns: int, says: str) -> None:
    lidar = Lidar(905.0, elevations_deg=(-1.0, 1.0), columns=500)
    cloud = 10 * scan_directions(lidar)
    with pytest.warns(TorchweatherWarning, match=rf"0.720 degrees apart, those of Lidar\(columns={columns}\).*{says}"):
        empty_beams(cloud, Lidar(905.0, elevations_deg=(-1.0, 1.0), columns=columns))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        empty_beams(cloud, lidar)


def test_wrong_ring_columns_are_refused() -> None:
    points = torch.ones(5, 4)
    with pytest.raises(ValueError, match=r"ring must be integers of shape \(5,\).*got torch.float32"):
        empty_beams(points, SMALL, torch.ones(5))
    with pytest.raises(ValueError, match="ring must lie below the 4 rings of the sensor; got 4"):
        empty_beams(points, SMALL, torch.full((5,), 4))
    with pytest.raises(ValueError, match=r"one cloud \(N, 3 or more\) at a time; got shape \(2, 5, 4\)"):
        empty_beams(points.expand(2, 5, 4), SMALL)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_gpu_finds_the_same_rings_and_beams() -> None:
    lidar = Lidar.preset("velodyne-hdl-32e")
    keep = torch.rand(32 * 2170, generator=torch.Generator().manual_seed(8)) > 0.3
    points = 10 * scan_directions(lidar)[keep]
    assert torch.equal(recover_ring(points.cuda(), lidar).cpu(), recover_ring(points, lidar))
    found, ring, column = (part.cpu() for part in empty_beams(points.cuda(), lidar))
    assert cells(ring, column, 2170) == (~keep).nonzero()[:, 0].tolist()
    assert (found - scan_directions(lidar)[ring * 2170 + column]).abs().max() < 1e-5
    elevations, _ = estimate_elevations(points.cuda(), 32)
    assert (elevations.cpu() - torch.tensor(lidar.elevations_deg)).abs().max() < 1e-4


# presets


def test_the_lidar_presets_and_their_normative_numbers() -> None:
    assert set(Lidar.presets()) == {
        "ouster-os0-128",
        "ouster-os1-128",
        "ouster-os2-128",
        "velodyne-hdl-64e",
        "velodyne-hdl-64e-s3",
        "velodyne-hdl-32e",
        "velodyne-vlp-16",
        "pandar64",
        "pandar64-wads",
        "waymo-top",
        "generic-1550nm",
        "aeva-aevascenes-wide",
        "generic-flash-1064nm",
    }
    # PHYSICS.md section 7 and 5.9.
    os1 = Lidar.preset("ouster-os1-128")
    assert (os1.wavelength_nm, os1.exit_diameter_mm, os1.range_at_10_percent_m, os1.pulse_width_ns) == (
        865,
        9.5,
        40,
        10,
    )
    assert os1.divergence_mrad == pytest.approx(math.radians(0.18) * 1e3, rel=1e-12)
    hdl = Lidar.preset("velodyne-hdl-64e")
    assert (hdl.wavelength_nm, hdl.exit_diameter_mm, hdl.divergence_mrad, hdl.pulse_width_ns) == (905, 10, 2, 10)
    assert hdl.range_at_10_percent_m == 50
    wads = Lidar.preset("pandar64-wads")
    assert (wads.near_start_m, wads.near_full_m, wads.near_power, wads.range_at_10_percent_m) == (2, 10, 2, 30)
    assert (wads.wavelength_nm, wads.return_mode, wads.divergence_mrad, wads.exit_diameter_mm) == (905, "dual", 2, 10)
    for name in Lidar.presets():
        lidar = Lidar.preset(name)
        # PHYSICS.md 10.13: the OS2's response is measured; of the others nothing is known.
        assert (lidar.near_start_m, lidar.near_full_m) == ((0, 30) if name == "ouster-os2-128" else (2, 10))
        assert lidar.intensity_unit == (
            "uint8_calibrated"
            if name.startswith(("ouster", "velodyne-vlp"))
            else "reflectivity"
            if name.startswith(("generic", "waymo", "aeva"))
            else "uint8_linear"
        )


@pytest.mark.parametrize(
    ("name", "rings", "top_deg", "bottom_deg", "tolerance_deg"),
    [
        # Data sheet views of 90, 45 and 22.5 degrees; a unit's outer beams lie within 5 % of them.
        ("ouster-os0-128", 128, 45.0, -45.0, 2.3),
        ("ouster-os1-128", 128, 22.5, -22.5, 1.6),
        ("ouster-os2-128", 128, 11.25, -11.25, 0.5),
        ("velodyne-hdl-64e", 64, 2.0, -24.33, 0.67),  # the sheet's view; KITTI's unit looks 0.67 degree lower
        ("velodyne-hdl-64e-s3", 64, 2.0, -24.33, 0.25),
        ("velodyne-hdl-32e", 32, 10.67, -30.67, 0.0),
        ("velodyne-vlp-16", 16, 15.0, -15.0, 0.0),
        ("pandar64", 64, 14.882, -24.897, 0.0),  # Hesai's table
        ("pandar64-wads", 64, 14.882, -24.897, 0.0401),  # WADS lies 0.04 degree lower
    ],
)
def test_the_rings_of_a_preset_span_the_view_of_its_data_sheet(
    name: str, rings: int, top_deg: float, bottom_deg: float, tolerance_deg: float
) -> None:
    elevations = Lidar.preset(name).elevations_deg
    assert elevations is not None
    assert len(elevations) == rings
    assert max(elevations) == pytest.approx(top_deg, abs=tolerance_deg + 1e-9)
    assert min(elevations) == pytest.approx(bottom_deg, abs=tolerance_deg + 1e-9)
    # In the order of the sensor's ring numbers: Velodyne from below (ROS, nuScenes), Ouster and Hesai from above.
    assert list(elevations) == sorted(elevations, reverse=not name.startswith("velodyne"))


# recordings


def points(pattern: str, columns: int) -> Tensor:
    found = recording(pattern)
    if found.suffix == ".csv":
        return torch.from_numpy(np.loadtxt(found, delimiter=",", dtype=np.float32))
    return torch.from_numpy(np.fromfile(found, dtype=np.float32).reshape(-1, columns))


@pytest.mark.real_data
def test_an_hdl_32e_gives_its_rings_back() -> None:
    lidar = Lidar.preset("velodyne-hdl-32e")
    fog = points("radiate_fog/velo_lidar/*.csv", 5)
    assert torch.equal(recover_ring(fog, lidar), fog[:, 4].long())
    # Points and empty beams together are one turn: its speed differs from 10 a second by less than 0.5 %.
    whole = replace(lidar, min_range_m=0.0)  # some of the points lie on the vehicle, nearer than 1 m
    assert len(fog) + len(empty_beams(fog, whole)[0]) == pytest.approx(32 * 2170, rel=0.005)
    # nuScenes compensates the motion of the vehicle, 0.4 m in a turn: far points keep their elevation.
    drive = points("kitti_nuscenes_demo/nuscenes/*.pcd.bin", 5)
    far = drive[drive[:, :3].norm(dim=-1) > 10.0]
    assert (recover_ring(far, lidar) == far[:, 4].long()).float().mean() > 0.999


@pytest.mark.real_data
def test_an_hdl_64e_gives_its_rings_back_beyond_ten_metres_once_its_heights_are_known() -> None:
    cloud = points("stf_raw/lidar*.bin", 5)
    far = cloud[cloud[:, :3].norm(dim=-1) > 10.0]
    ring = recover_ring(far, Lidar.preset("velodyne-hdl-64e-s3"), origin_heights_m=(0.15,) * 32 + (0.21,) * 32)
    assert (ring == far[:, 4].long()).float().mean() > 0.99


@pytest.mark.real_data
def test_points_and_empty_beams_of_wads_make_one_turn() -> None:
    lidar = Lidar.preset("pandar64-wads")
    cloud = points("wads_snow/velodyne/*.bin", 4)
    ring = recover_ring(cloud, lidar)
    beams = torch.unique(torch.stack([ring.float(), (azimuths(cloud) * 1000).round()]), dim=1).shape[1]
    assert beams + len(empty_beams(cloud, lidar)[0]) == pytest.approx(64 * 1800, rel=1e-3)
    elevations, spread = estimate_elevations(cloud, 64)
    assert (elevations.flip(0) - torch.tensor(lidar.elevations_deg)).abs().max() < 1e-3
    assert spread.max() < 1e-3


@pytest.mark.real_data
def test_a_kitti_crop_stays_a_crop() -> None:
    cloud = points("kitti_nuscenes_demo/kitti/*.bin", 4)
    lidar = Lidar.preset("velodyne-hdl-64e")
    directions, _, _ = empty_beams(cloud, lidar)
    aside = azimuths(cloud)
    assert aside.min() - 0.2 < azimuths(directions).min()
    assert azimuths(directions).max() < aside.max() + 0.2
    assert 0 < len(directions) < 0.5 * len(cloud)


def test_the_table_of_a_pandar64_has_the_shape_of_a_units_correction_file() -> None:
    # Elevations of rings 1 to 64 in a unit's correction file (nebula driver, calibration/hesai/64.csv).
    unit = (
        "14.9 11.05 8.077 5.075 3.058 2.046 1.878 1.706 1.54 1.369 1.202 1.031 .864 .693 .526 .355 .187 .018 -.151 "
        "-.319 -.49 -.657 -.827 -.995 -1.166 -1.333 -1.504 -1.67 -1.842 -2.01 -2.18 -2.347 -2.518 -2.682 -2.855 -3.022 "
        "-3.192 -3.357 -3.53 -3.694 -3.866 -4.032 -4.203 -4.367 -4.54 -4.702 -4.874 -5.039 -5.211 -5.373 -5.547 -5.708 "
        "-5.88 -6.043 -7.045 -8.041 -9.042 -10.027 -11.014 -11.988 -12.956 -13.912 -18.871 -24.879"
    )
    # That unit stands 0.018 degree higher than the table, the unit of WADS 0.040 lower; the rings keep their distances.
    for elevations, higher in (([float(text) for text in unit.split()], 0.018), (None, -0.040)):
        own = elevations or Lidar.preset("pandar64-wads").elevations_deg
        assert own == pytest.approx([ring + higher for ring in Lidar.preset("pandar64").elevations_deg or ()], abs=6e-4)
