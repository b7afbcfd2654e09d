"""The every-particle reference against closed forms, brute-force sampling and the committed statistics."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import gammainc

from tests.reference.every_particle import (
    Kind,
    Particles,
    Population,
    Rendered,
    draw_particles,
    geometric_extinction,
    mark_patches,
    population,
    projected_area_px2,
    rain_fall_speed,
    render,
    render_counted,
    snow_fall_speed,
    statistics,
)
from tests.reference.make_particle_statistics import expected_mean

Array = NDArray[np.float64]

F_PX = 968.0 / math.tan(math.radians(40.4))
SMALL: dict[str, Any] = {
    "f_px": F_PX,
    "height": 96,
    "width": 96,
    "near_m": 1.5,
    "depth_m": 8.0,
    "exposure_s": 0.005,
}


@lru_cache
def small_frame(kind: Kind, rate_mm_per_h: float, seed: int, slant_rad: float) -> Rendered:
    """One of the frames that several tests look at."""
    return render_counted(rate_mm_per_h, kind=kind, seed=seed, slant_rad=slant_rad, **SMALL)


COMMITTED = json.loads(Path(__file__).with_name("particle_statistics.json").read_text())

# Block `camera_streak` of the project's physics oracles (independent implementation, tolerance 1e-9): width and
# motion in pixels of a drop, and the sum of its mask over the pixels.
CAMERA_STREAK = {
    "1 mm at 2 m": (0.6139707119170354, 11.60404645523197, 0.29606371923542485),
    "1 mm at 5 m": (0.2455882847668142, 4.641618582092788, 0.04737019507766799),
    "1 mm at 20 m": (0.06139707119170355, 1.160404645523197, 0.002960637192354249),
    "3 mm at 2 m": (1.8419121357511063, 24.225943467364168, 2.6645734731188235),
    "3 mm at 10 m": (0.36838242715022135, 4.845188693472834, 0.10658293892475298),
}


def one_mark(x: float, y: float, width_px: float, motion_px: float) -> Particles:
    return Particles(*(np.array([v]) for v in (x, y, 1.0, width_px, motion_px)))


def patch_of(mark: Particles, slant_rad: float = 0.0, **options: float) -> tuple[Array, int, int]:
    values, row, column, _ = next(iter(mark_patches(mark, slant_rad, **options)))
    return values[0], int(row[0]), int(column[0])


def sampled_patch(mark: Particles, slant_rad: float, shape: tuple[int, ...], row: int, column: int, n: int) -> Array:
    """Box average of ``|segment intersected with chord| / L`` over ``n x n`` points per pixel."""
    height, width = shape
    y, x = np.meshgrid(
        (np.arange(height * n) + 0.5) / n - 0.5 + row - mark.y_px[0],
        (np.arange(width * n) + 0.5) / n - 0.5 + column - mark.x_px[0],
        indexing="ij",
    )
    along = x * math.sin(slant_rad) + y * math.cos(slant_rad)
    across = x * math.cos(slant_rad) - y * math.sin(slant_rad)
    half_chord = np.sqrt(np.maximum(mark.width_px[0] ** 2 / 4.0 - across**2, 0.0))
    half_motion = mark.motion_px[0] / 2.0
    if half_motion == 0.0:
        covered = (np.abs(along) < half_chord).astype(np.float64)
    else:
        low, high = np.maximum(along - half_chord, -half_motion), np.minimum(along + half_chord, half_motion)
        covered = np.maximum(high - low, 0.0) / (2.0 * half_motion)
    averages: Array = covered.reshape(height, n, width, n).mean(axis=(1, 3))
    return averages


@pytest.mark.parametrize("slant_rad", [0.0, 0.3, -1.2, math.pi / 2])
@pytest.mark.parametrize("name", CAMERA_STREAK)
def test_sum_of_mask_is_the_disk_area_at_any_speed_and_direction(name: str, slant_rad: float) -> None:
    width_px, motion_px, sum_of_mask = CAMERA_STREAK[name]
    for x, y in ((5.0, 7.0), (5.5, 7.49), (-0.37, 2.21)):
        values, _, _ = patch_of(one_mark(x, y, width_px, motion_px), slant_rad)
        assert values.sum() == pytest.approx(sum_of_mask, rel=1e-9)  # the oracle block's tolerance


@pytest.mark.parametrize(
    ("width_px", "motion_px", "slant_rad"),
    [
        (0.045, 0.05, 0.0),
        (0.045, 2.3, 0.0),
        (0.3, 0.3, 0.0),
        (0.6, 5.6, 0.0),
        (2.4, 0.5, 0.0),
        (3.3, 0.0, 0.0),
        (0.3, 2.0, 0.7),
        (1.8, 4.2, -0.4),
        (0.6, 3.6, math.pi / 2),
    ],
)
def test_every_pixel_of_a_mark_agrees_with_sampled_coverage(
    width_px: float, motion_px: float, slant_rad: float
) -> None:
    # 200 points per pixel resolve an edge to 1/400 px; of a mark narrower than 0.2 px they resolve too little, so
    # those take 40 points per width. What is left is the stated error of the reference, under 1 % of the peak.
    n = max(200, math.ceil(40.0 / width_px))
    for x, y in ((5.47, 7.51), (4.9, 6.2)):
        mark = one_mark(x, y, width_px, motion_px)
        values, row, column = patch_of(mark, slant_rad)
        expected = sampled_patch(mark, slant_rad, values.shape, row, column, n)
        assert np.abs(values - expected).max() < 0.01 * expected.max()


def test_thin_closed_form_agrees_with_the_full_integral_where_it_takes_over() -> None:
    # The largest width and the shortest motion, twice the width, are the worst case: 0.3 % of the peak.
    rng = np.random.default_rng(3)
    for motion_px in (0.1, 0.15, 0.6, 3.0):
        x, y = rng.random((2, 200))
        marks = Particles(x, y, np.ones(200), np.full(200, 0.05), np.full(200, motion_px))
        (thin, *_), (full, *_) = (next(iter(mark_patches(marks, thin_px=limit))) for limit in (1.0, 0.0))
        assert not np.array_equal(thin, full)
        assert np.abs(thin - full).max() < 3e-3 * full.max()


def test_resting_particle_leaves_its_disk() -> None:
    values, row, column = patch_of(one_mark(10.0, 20.0, 8.0, 0.0))
    assert values.sum() == pytest.approx(16.0 * math.pi, rel=1e-9)
    # Rest is a motion of 1e-6 px, by which rounding errors of 1e-15 are divided.
    assert values[20 - row - 2 : 20 - row + 3, 10 - column - 2 : 10 - column + 3] == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("slant_rad", [0.0, 0.6, -1.0, math.pi / 2])
def test_mark_lies_where_the_particle_is_and_along_its_motion(slant_rad: float) -> None:
    # Averaged over positions in the pixel, pixels add a box's variance 1/12 and no shift; a uniform motion L has
    # the variance L^2/12 along itself, a disk d^2/16 on each axis. 32 x 32 positions average to 5e-3 or better.
    y, x = (a.ravel() + 5.0 for a in np.mgrid[:32, :32] / 32.0)
    marks = Particles(x, y, np.arange(x.size, dtype=np.float64), np.full(x.size, 0.8), np.full(x.size, 6.0))
    moments = np.zeros(6)
    for values, row, column, index in mark_patches(marks, slant_rad):
        of = index.astype(np.intp)
        away_y = row[:, None, None] + np.arange(values.shape[1])[:, None] - y[of][:, None, None]
        away_x = column[:, None, None] + np.arange(values.shape[2]) - x[of][:, None, None]
        for i, power in enumerate((1.0, away_x, away_y, away_x**2, away_y**2, away_x * away_y)):
            moments[i] += (values * power).sum()
    blur, along = 0.8**2 / 16.0 + 1.0 / 12.0, 6.0**2 / 12.0
    dx, dy = math.sin(slant_rad), math.cos(slant_rad)
    expected = [0.0, 0.0, along * dx * dx + blur, along * dy * dy + blur, along * dx * dy]
    assert moments[1:] / moments[0] == pytest.approx(expected, abs=5e-3)


def test_geometric_extinction_of_marshall_palmer_is_the_incomplete_gamma_function() -> None:
    for rate in (1.0, 10.0, 50.0):
        slope = 4.1 * rate**-0.21
        share = gammainc(3.0, 8.0 * slope) - gammainc(3.0, 0.1 * slope)
        closed = math.pi / 4.0 * 8000.0 * 2.0 / slope**3 * share * 1e-6
        assert geometric_extinction(population("rain", rate)) == pytest.approx(closed, rel=1e-9)


def test_fall_speeds_are_the_measured_ones() -> None:
    # Gunn & Kinzer 1949; the polynomial stays within 4 % of them from 0.5 to 5.8 mm.
    small = rain_fall_speed(np.array([0.1, 0.2, 0.3]))
    assert small == pytest.approx([0.27, 0.72, 1.17])
    large = rain_fall_speed(np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 5.8]))
    assert large == pytest.approx([2.06, 4.03, 6.49, 8.06, 8.83, 9.09, 9.17], rel=0.04)
    assert rain_fall_speed(np.array([7.0])) == pytest.approx([9.17])
    assert snow_fall_speed(np.array([1.0, 10.0])) == pytest.approx([1.0138421560926836, 2.07], rel=1e-12)


def test_snow_marks_show_the_physical_diameter() -> None:
    snow = population("snow", 3.0)
    melted = np.array([0.1, 1.0, snow.largest_mm])
    # 0.1 mm is solid ice; the domain ends where the flake is 20 mm wide.
    assert snow.optical_diameters_mm(melted) == pytest.approx([0.10293, 2.2947, 20.0])


def campbell_moments(pop: Population, lags: tuple[int, ...], n: int = 40_000, **settings: Any) -> tuple[float, Array]:
    """Optical depth and ``int n sum_pixels m(x) m(x + lag rows)`` per pixel, by importance sampling of single marks."""
    rng = np.random.default_rng(11)
    f_px, near, far = settings["f_px"], settings["near_m"], settings["depth_m"]
    u = rng.random((4, n))
    size = pop.smallest_mm * (pop.largest_mm / pop.smallest_mm) ** u[0]
    depth = near * (far / near) ** u[1]
    per_draw = pop.n0_per_m3_mm * np.exp(-pop.slope_per_mm * size) * size * math.log(pop.largest_mm / pop.smallest_mm)
    per_draw = per_draw * depth**3 / f_px**2 * math.log(far / near) / n  # particles per pixel that one draw stands for
    speed = pop.fall_speeds_m_per_s(size)
    optical_m = pop.optical_diameters_mm(size) * 1e-3
    # The depth field of a mark carries its index, so that the weight is found again after grouping.
    marks = Particles(
        u[2],
        u[3],
        np.arange(n, dtype=np.float64),
        f_px * optical_m / depth,
        f_px * speed * settings["exposure_s"] / depth,
    )
    first, second = 0.0, np.zeros(len(lags))
    for values, _, _, index in mark_patches(marks):
        weight = per_draw[index.astype(np.intp)]
        first += float((weight * values.sum((1, 2))).sum())
        for i, lag in enumerate(lags):
            pairs = (values[:, lag:] * values[:, : max(0, values.shape[1] - lag)]).sum((1, 2))
            second[i] += float((weight * pairs).sum())
    return first, second


@pytest.mark.parametrize(("kind", "rate"), [("rain", 50.0), ("snow", 3.0)])
def test_mean_and_correlation_are_those_of_poisson_shot_noise(kind: Kind, rate: float) -> None:
    """Campbell's theorem: ``E[T] = exp(-tau)``, ``cov(T, T_lag) = exp(-2 tau) (exp(kappa_lag) - 1)``."""
    lags = (0, 1, 2, 4, 8)
    pop = population(kind, rate)
    tau, kappa = campbell_moments(pop, lags, **SMALL)
    alpha = geometric_extinction(pop)
    assert tau == pytest.approx(alpha * 6.5, rel=0.02)  # spread of the importance weights over 40000 draws: 0.6 %
    expected_mean = 1.0 - math.exp(-alpha * 6.5)
    expected = math.exp(-2.0 * alpha * 6.5) * np.expm1(kappa)
    # About the known mean, not the frame's own, so that the estimate has no bias from the frame's finite size.
    frames = []
    for seed in range(30):
        away = small_frame(kind, rate, seed, 0.0).mask - expected_mean
        frames.append([np.mean(away), *(np.mean(away[lag:] * away[: 96 - lag]) for lag in lags)])
    means, errors = np.mean(frames, 0), np.std(frames, 0, ddof=1) / math.sqrt(len(frames))
    assert abs(means[0]) < 4.0 * errors[0]
    # 3 % for the importance sampling of kappa, four standard errors for the 30 frames.
    assert (np.abs(means[1:] - expected) < 4.0 * errors[1:] + 0.03 * expected).all()


@pytest.mark.parametrize("slant_rad", [0.0, 0.9])
def test_mean_coverage_follows_beer_lambert(slant_rad: float) -> None:
    rain = population("rain", 50.0)
    alpha = geometric_extinction(rain)
    n_frames = 10 if slant_rad == 0.0 else 4
    masks = [small_frame("rain", 50.0, seed, slant_rad).mask for seed in range(n_frames)]
    # A drop adds pi d^2/4 px to the frame's sum, so the frame mean of the optical depth has the variance
    # int (pi f^2 D^2 / 4 Z^2)^2 N Z^2/f^2 dZ dD / pixels = (pi f)^2 / 16 <D^4> (1/near - 1/far) / pixels.
    variance = (math.pi * F_PX) ** 2 / 16.0 * rain.moment(4) * 1e-12 * (1.0 / 1.5 - 1.0 / 8.0) / 96**2
    tolerance = 4.0 * math.sqrt(variance / n_frames)
    assert np.mean(masks) == pytest.approx(1.0 - math.exp(-6.5 * alpha), abs=tolerance)


def test_number_and_sizes_of_drops_are_those_of_the_volume() -> None:
    rain = population("rain", 50.0)
    expected = rain.per_m3 * 96**2 / F_PX**2 * (8.0**3 - 1.5**3) / 3.0
    counts = [small_frame("rain", 50.0, seed, 0.0).n_in_frame for seed in range(10)]
    assert np.sum(counts) == pytest.approx(10 * expected, abs=4.0 * math.sqrt(10 * expected))
    arguments = {k: v for k, v in SMALL.items() if k != "depth_m"}
    slabs = draw_particles(rain, far_m=8.0, slant_rad=0.0, rng=np.random.default_rng(5), **arguments)
    size_mm = np.concatenate([p.width_px * p.depth_m / F_PX * 1e3 for p in slabs])
    for low, high in ((0.1, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 8.0)):
        share = (math.exp(-rain.slope_per_mm * low) - math.exp(-rain.slope_per_mm * high)) / (
            math.exp(-rain.slope_per_mm * 0.1) - math.exp(-rain.slope_per_mm * 8.0)
        )
        found = np.count_nonzero((size_mm >= low) & (size_mm < high))
        assert found == pytest.approx(size_mm.size * share, abs=4.0 * math.sqrt(size_mm.size * share))


def test_nearer_objects_hide_the_drops_behind_them_pixel_by_pixel() -> None:
    settings = {k: v for k, v in SMALL.items() if k != "depth_m"} | {"seed": 4, "far_m": 8.0}
    depth = np.full((96, 96), 8.0)
    depth[:, 40:70] = 3.0
    near, far = render(50.0, depth_m=3.0, **settings), render(50.0, depth_m=8.0, **settings)
    both = render(50.0, depth_m=depth, **settings)
    assert np.array_equal(both[:, 40:70], near[:, 40:70])
    assert np.array_equal(both[:, 70:], far[:, 70:])
    assert (near <= far).all()
    assert near.mean() < far.mean()
    assert not render(50.0, depth_m=1.5, **settings).any()


def test_image_border_is_as_wet_as_its_middle() -> None:
    # Marks of particles whose centre lies outside the image belong to it; without them the first and last rows
    # lose up to half. Small frames, so that most pixels are near a border; a long exposure, so that marks reach far.
    settings = SMALL | {"height": 6, "near_m": 3.0, "exposure_s": 0.01}
    edges = np.array([render(50.0, seed=s, **settings)[[0, -1]].mean() for s in range(16)])
    expected = 1.0 - math.exp(-5.0 * geometric_extinction(population("rain", 50.0)))
    error = edges.std(ddof=1) / math.sqrt(edges.size)
    assert error < 0.03 * expected  # sharp enough to see a loss of an eighth
    assert edges.mean() == pytest.approx(expected, abs=4.0 * error)


def test_no_rain_covers_nothing() -> None:
    assert not render(0.0, seed=1, **SMALL).any()


def test_infinite_scene_needs_an_end_of_drawing() -> None:
    with pytest.raises(ValueError, match="far_m"):
        render(50.0, seed=1, **(SMALL | {"depth_m": math.inf}))


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 40.0, 55.0])
def test_a_spheres_image_grows_by_the_secant_of_its_angle(angle_deg: float) -> None:
    """PHYSICS.md 10.1, from rays cast at a sphere, without the formula."""
    off = F_PX * math.tan(math.radians(angle_deg))
    found = projected_area_px2(0.003, 2.0, 0.6 * off, -0.8 * off, F_PX)
    on_axis = math.pi / 4 * (F_PX * 0.003 / 2.0) ** 2
    # 400 x 400 rays, of which the edge of an ellipse cuts about 600: half of them at random is 0.1 % of its area.
    assert found / on_axis == pytest.approx(1 / math.cos(math.radians(angle_deg)), rel=3e-3)


@pytest.mark.parametrize("block", COMMITTED["blocks"])
def test_committed_mean_is_beer_lambert(block: str) -> None:
    found = COMMITTED["blocks"][block]
    expected = expected_mean(found["settings"])
    error = found["std_over_seeds"]["mean"] / math.sqrt(len(found["seeds"]))
    assert found["mean_over_seeds"]["mean"] == pytest.approx(expected, abs=4.0 * error)


def test_committed_statistics_are_those_of_this_renderer() -> None:
    found = COMMITTED["blocks"]["rain_96x96"]
    again = statistics(render(**found["settings"], seed=0))
    # The random stream of one seed is numpy's, which keeps it within a release line; 1e-9 leaves room for libm only.
    assert again == pytest.approx({name: found["seeds"][0][name] for name in again}, rel=1e-9, abs=1e-12)
