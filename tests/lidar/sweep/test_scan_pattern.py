"""Scan patterns from sweeps whose pattern is known, and clear refusals of clouds that are no sweep."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from tests.lidar.sweep.scan_sweep import COLUMNS, ELEVATIONS_DEG, HEIGHTS_M, Array, sweep, turned_about_y
from torchweather.lidar import estimate_pattern
from torchweather.lidar.sweep.azimuth_step import fit_azimuth_step
from torchweather.lidar.sweep.cone_fit import fit_cones
from torchweather.lidar.sweep.ring_elevations import rings_from_elevations
from torchweather.lidar.sweep.ring_order import rings_from_order
from torchweather.sensors import Lidar

# Points of 0.01 m noise along the beam stay on their cone; float32 at 20 m rounds to 1e-6 m, 1e-5 degree.
ELEVATION_DEG = 0.005
HEIGHT_M = 0.002


@pytest.mark.parametrize("way", ["file order", "ring column", "elevations"])
def test_rings_elevations_heights_and_columns_are_those_of_the_sensor(way: str) -> None:
    points, ring = sweep()
    order = np.random.default_rng(1).permutation(len(points)) if way == "elevations" else np.arange(len(points))
    pattern = estimate_pattern(points[order], ring[order] if way == "ring column" else None)
    assert pattern.found_by == way
    assert np.array_equal(pattern.ring, ring[order])
    assert np.abs(pattern.elevations_deg - ELEVATIONS_DEG).max() < ELEVATION_DEG
    assert np.abs(pattern.heights_m - HEIGHTS_M).max() < HEIGHT_M
    low, high = pattern.columns_interval
    assert pattern.columns == COLUMNS
    assert low - 0.5 <= COLUMNS <= high + 0.5
    assert np.array_equal(pattern.counts, np.bincount(ring))
    assert pattern.beams == len(points)
    assert pattern.coverage_deg == 360.0
    assert pattern.frame is None
    # The phase is that of the columns: 0.3 of a step.
    off = (pattern.phase_deg / pattern.step_deg - 0.3 + 0.5) % 1.0 - 0.5
    assert np.abs(off).max() < 0.05
    assert pattern.notes == ()


def test_rows_without_return_and_tensors_are_taken_as_they_are() -> None:
    points, ring = sweep()
    rng = np.random.default_rng(0)
    points[rng.choice(len(points), 500, replace=False)] = np.nan
    points[rng.choice(len(points), 500, replace=False)] = 0.0
    gone = ~np.isfinite(points).all(1) | (points[:, :3] == 0).all(1)
    pattern = estimate_pattern(torch.from_numpy(points))
    assert np.array_equal(pattern.ring, np.where(gone, -1, ring))


@pytest.mark.parametrize(
    ("change", "rings_fall"),
    [
        (lambda p: p, False),
        (lambda p: p[::-1].copy(), True),
        (lambda p: p * np.array([1, -1, 1, 1], np.float32), False),
        (lambda p: p[:, [1, 0, 2, 3]], False),
        (lambda p: p[p[:, 0] > 0], False),
        (lambda p: p[p[:, 1] > 0], False),
        (lambda p: p[np.abs(p[:, 1]) < p[:, 0]], False),
        (lambda p: p[~((p[:, 0] > 0) & (np.abs(p[:, 1]) < 0.5 * p[:, 0]))], False),
        (lambda p: p[::3], False),
    ],
    ids=["whole", "reversed", "mirrored", "axes swapped", "front", "left", "quarter", "blocked", "thinned"],
)
def test_rings_in_file_order_are_found_in_parts_and_turns_of_a_sweep(
    change: Callable[[Array], Array], rings_fall: bool
) -> None:
    points, ring = sweep()
    rows = change(np.concatenate([points[:, :3], ring[:, None].astype(np.float32)], 1))
    found = rings_from_order(rows[:, :3])
    assert found is not None
    truth = rows[:, 3].astype(np.int64)
    assert np.array_equal(found, 23 - truth if rings_fall else truth)


def test_rings_that_begin_at_different_azimuths_are_cut_where_their_cone_begins() -> None:
    # As an Ouster's: columns aligned to the firing, rings to -3..3 degrees beside them.
    points, ring = sweep(heights_m=np.full(24, 0.04), missing=0.0, noise_m=0.0)
    angle = np.radians(np.array([-3.0, -1.0, 1.0, 3.0])[ring % 4] + 180.0)
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, points[:, 2]], -1)
    found = rings_from_order(turned)
    assert found is not None
    assert (found == ring).mean() > 0.999


def test_the_error_of_an_elevation_is_of_the_size_of_its_scatter() -> None:
    # Elevations scatter by 0.02 degree from point to point; 40 sweeps show how far the fits scatter.
    found, claimed = [], []
    for seed in range(40):
        points, ring = sweep(columns=300, seed=seed, noise_m=0.0)
        rng = np.random.default_rng(seed)
        points[:, 2] += np.hypot(points[:, 0], points[:, 1]) * np.radians(0.02) * rng.standard_normal(len(points))
        fit = fit_cones(points[:, :3], ring, 24)
        found.append(fit.elevation_deg)
        claimed.append(fit.elevation_error_deg)
    scatter, claim = np.std(found, 0), np.median(claimed, 0)
    # 40 sweeps tell a standard deviation to 11 percent, 12 sectors to 20.
    assert 0.6 < np.median(scatter / claim) < 1.6


def test_the_step_is_the_firings_where_azimuths_are_rounded_and_returns_are_missing() -> None:
    # KITTI rounds to 0.09 degree: gaps of one firing (0.1671 degree) are 0.09 or 0.18.
    rng = np.random.default_rng(0)
    azimuth = np.round(np.arange(2155) * (360.0 / 2155) / 0.09) * 0.09
    kept = [np.sort(azimuth[rng.random(2155) > 0.1]) for _ in range(32)]
    step = fit_azimuth_step(np.concatenate(kept), np.repeat(np.arange(32), [len(k) for k in kept]), 32)
    assert step is not None
    assert 360.0 / step.step_deg == pytest.approx(2155, rel=0.003)
    assert step.beams == sum(len(k) for k in kept)
    assert fit_azimuth_step(azimuth[:50], np.zeros(50, np.int64), 1) is None


@pytest.mark.parametrize(
    ("degrees", "found_by"), [(2.0, "file order"), (-3.0, "ring column")], ids=["file order", "ring column"]
)
def test_a_tilt_is_noticed_and_taken_out_of_the_elevations(degrees: float, found_by: str) -> None:
    points, ring = sweep()
    pattern = estimate_pattern(turned_about_y(points, degrees), ring if found_by == "ring column" else None)
    assert pattern.found_by == found_by
    assert pattern.frame is not None
    assert pattern.frame.tilt_deg[0] == pytest.approx(-degrees, abs=0.1)
    assert any("tilted against its sensor" in note for note in pattern.notes)
    # Rings of one range, on the road alone, take the height of the others: 0.08 m at 4 m is a degree.
    off = np.abs(pattern.elevations_deg - ELEVATIONS_DEG)
    assert off[12:].max() < 0.05
    assert off.max() < 1.2


def test_a_blocked_sector_and_a_half_turn_are_noticed() -> None:
    points, _ = sweep()
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    blocked = estimate_pattern(points[(azimuth < 100) | (azimuth > 160)])
    assert blocked.coverage_deg == pytest.approx(300.0, abs=2.0)
    assert any("azimuths of 100 to 160 degrees" in note for note in blocked.notes)
    assert estimate_pattern(points[points[:, 0] > 0]).coverage_deg == pytest.approx(180.0, abs=2.0)


def shuffled(points: Array) -> Array:
    return points[np.random.default_rng(0).permutation(len(points))]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: np.concatenate([p, p]), r"\d+ of \d+ returns repeat other rows of the file: a sweep written"),
        (lambda p: np.concatenate([p, sweep(seed=3)[0]]), "lie on the cone of another one: several sweeps in one file"),
        (lambda p: p + np.array([3000, 500, 0, 0], np.float32), r"got points at \d+ m in the median.*map's frame"),
        (lambda p: p + np.array([300, 50, 0, 0], np.float32), r"in the sensor's frame \(not in a map's"),
        (lambda p: p * np.float32(1000), "divide by 1000"),
        (lambda p: shuffled(turned_about_y(p, 5.0)), "neither the order of its rows nor its elevations show rings"),
        (lambda p: np.random.default_rng(0).normal(size=(20000, 3)) * 10, "nor its elevations show rings"),
        (lambda p: p * 0, "the cloud has no return"),
        (lambda p: p[:0], "the cloud has no return"),
        (lambda p: p[:, :2], r"points must be one cloud of floating point \(N, 3 or more\)"),
        (lambda p: p[None], r"got float32, \(1, \d+, 4\)"),
        (lambda p: p.astype(np.int64), "got int64"),
    ],
    ids=[
        "twice",
        "merged",
        "map",
        "near-map",
        "millimetres",
        "tilted-and-shuffled",
        "noise",
        "zeros",
        "empty",
        "two-columns",
        "batch",
        "integers",
    ],
)
def test_what_is_no_sweep_of_a_sensor_is_refused_with_the_evidence(
    change: Callable[[Array], Array], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        estimate_pattern(change(sweep()[0]))


@pytest.mark.parametrize("way", ["file order", "ring column", "elevations"])
def test_fewer_rings_than_declared_are_refused(way: str) -> None:
    points, ring = sweep()
    some = points[ring < 16]
    order = np.random.default_rng(0).permutation(len(some)) if way == "elevations" else np.arange(len(some))
    given = ring[ring < 16][order] if way == "ring column" else None
    message = "expected 64 rings of a LiDAR in the sweep, but (it shows 16 by|neither)"
    with pytest.raises(ValueError, match=message):
        estimate_pattern(some[order], given, rings=64)
    assert estimate_pattern(some[order], given, rings=16).rings == 16


def test_a_ring_column_of_another_length_or_kind_is_refused() -> None:
    points, ring = sweep()
    with pytest.raises(ValueError, match=r"ring must be integers of shape \(\d+,\), one per row"):
        estimate_pattern(points, ring[:-1])
    with pytest.raises(ValueError, match="got float64"):
        estimate_pattern(points, ring.astype(np.float64))


def test_elevations_of_two_blocks_at_two_heights_are_told_apart_in_any_order() -> None:
    points, ring = sweep(seed=2)
    order = np.random.default_rng(5).permutation(len(points))
    found = rings_from_elevations(points[order, :3])
    assert found is not None
    assert (found == ring[order]).mean() > 0.999
    assert rings_from_elevations(points[order, :3], rings=30) is None


def test_a_pattern_replaces_that_of_a_sensor_and_fills_rings_without_points() -> None:
    points, ring = sweep()
    kept = ring != 5
    lidar = Lidar(905.0, elevations_deg=tuple(ELEVATIONS_DEG + 0.4), origin_heights_m=(0.1,) * 24, columns=700)
    fitted = estimate_pattern(points[kept], ring[kept]).applied_to(lidar)
    assert fitted.columns == COLUMNS
    assert fitted.elevations_deg is not None
    assert fitted.elevations_deg[5] == pytest.approx(ELEVATIONS_DEG[5] + 0.4)
    assert fitted.elevations_deg[6] == pytest.approx(ELEVATIONS_DEG[6], abs=ELEVATION_DEG)
    bare = estimate_pattern(points[kept], ring[kept]).applied_to(Lidar(905.0))
    assert bare.elevations_deg is not None
    assert bare.elevations_deg[5] == pytest.approx(0.5 * (ELEVATIONS_DEG[4] + ELEVATIONS_DEG[6]), abs=0.01)
