"""Tables of particles: sizes of marks by the formula, and the haze's variance by a quadrature of its own."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.camera.particles.tables import BOX_OF_DISK, MarkOptics, build_particle_tables, mark

FOCAL_PX, NEAR_M, FAR_M = 1000.0, 1.0, 16.0


def optics(exposure_s: float) -> MarkOptics:
    """A pinhole."""
    return MarkOptics(exposure_s=exposure_s, aperture_m=0.0, focus_distance_m=math.inf, lens_blur_px=0.0)


def test_a_mark_is_as_wide_as_its_particle_and_as_long_as_its_path() -> None:
    """2 mm at 5 m and f = 1000 px: 0.4 px wide; 6 m/s for 5 ms: 6 px long."""
    width, length, opacity = mark(np.array([2e-3]), np.array([6.0]), np.array([5.0 / FOCAL_PX]), FOCAL_PX, optics(5e-3))
    assert [float(one[0]) for one in (width, length, opacity)] == pytest.approx([0.4, 6.0, 1.0], rel=1e-12)


@pytest.mark.parametrize("weather", [Rain(20.0), Snow(2.0)], ids=["rain", "snow"])
def test_the_longest_mark_of_a_shell_is_that_of_its_fastest_particle(weather: Rain | Snow) -> None:
    exposure_s = 8e-3
    tables = build_particle_tables(weather, optics(exposure_s), FOCAL_PX, NEAR_M, FAR_M, 1 / 1024, 0.25, 20.0)
    largest_mm = float(weather.distribution(20.0).diameter_max_mm)
    fastest = float(weather.fall_speed_m_per_s(torch.tensor(largest_mm)))
    nodes = len(tables.haze_depth[0])
    for shell in tables.listed:
        nearest_m_per_px = math.exp(shell.log_footprint[0])
        longest = shell.length_max_px / (fastest * exposure_s / nearest_m_per_px)
        # The node at or before the shell's near end: at most one step of the grid nearer.
        assert 1.0 - 1e-6 <= longest <= (FAR_M / NEAR_M) ** (1.0 / (nodes - 1)) + 1e-6


def mean_square(width_px: np.ndarray) -> np.ndarray:
    """Mean square over pixels of a box of unit area and a width, in closed form."""
    wide = np.maximum(width_px, 1.0)
    return np.where(width_px >= 1.0, (1.0 - 1.0 / (3.0 * wide)) / wide, 1.0 - width_px / 3.0)


@pytest.mark.parametrize("exposure_s", [2e-3, 2e-2], ids=["short", "long"])
def test_the_variance_of_the_haze_is_that_of_its_marks(exposure_s: float) -> None:
    """Campbell's theorem: the number of particles times the mean square of one mark, over all sizes and depths."""
    rain = Rain(20.0)
    tables = build_particle_tables(rain, optics(exposure_s), FOCAL_PX, NEAR_M, FAR_M, 1.0, 1e9, 20.0)
    distribution = rain.distribution(20.0)
    log_mm, step_mm = np.linspace(math.log(0.1), math.log(8.0), 4001, retstep=True)
    log_m, step_m = np.linspace(math.log(NEAR_M), math.log(FAR_M), 801, retstep=True)
    mm, depth_m = torch.from_numpy(np.exp(log_mm)).clamp(0.1, 8.0), np.exp(log_m)[:, None]
    number = distribution.number_density_per_m3_mm(mm).numpy() * mm.numpy()  # per m^3 and e-fold of diameter
    px_m = depth_m / FOCAL_PX
    width, length = 1e-3 * mm.numpy() / px_m, rain.fall_speed_m_per_s(mm).numpy() * exposure_s / px_m
    across, along = BOX_OF_DISK * width, np.hypot(length, BOX_OF_DISK * width)
    square = (math.pi / 4 * width**2) ** 2 * mean_square(across) * mean_square(along)
    per_depth = np.trapezoid(number * square, dx=step_mm, axis=1)  # per m^3
    expected = np.trapezoid(per_depth * px_m[:, 0] ** 2 * depth_m[:, 0], dx=step_m)  # in the column behind a pixel
    found = np.exp(np.log(tables.haze_variance[-1, -1])) * FOCAL_PX
    assert found == pytest.approx(expected, rel=5e-3)
