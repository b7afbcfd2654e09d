"""Flash (solid-state) LiDARs: the grid of pixels, and the drops they see against drops listed in the whole field."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference.agreement import ks_critical, ks_distance, share_z, z_critical
from tests.reference.every_particle import population
from torchweather.atmosphere.weather import Rain
from torchweather.lidar.scan import empty_beams, scan_directions
from torchweather.pipeline.point_kind import PointKind
from torchweather.scenes import lidar_view
from torchweather.scenes import test_track as track
from torchweather.sensors import Lidar
from torchweather.transforms import LidarWeather

VIEW_DEG, COLUMNS, ROWS = (40.0, 24.0), 40, 30
# An aperture of a point: then each drop lies in the field of one pixel alone.
FLASH = Lidar.flash(
    905.0,
    view_deg=VIEW_DEG,
    columns=COLUMNS,
    rows=ROWS,
    exit_diameter_mm=0.01,
    range_at_10_percent_m=50.0,
    pulse_width_ns=1e-3,  # every drop returns alone
    near_start_m=0.5,
    near_full_m=0.51,
    max_range_m=30.0,
)


def test_the_grid_covers_the_view_in_equal_steps() -> None:
    directions = scan_directions(FLASH, dtype=torch.float64).reshape(ROWS, COLUMNS, 3)
    azimuth = torch.rad2deg(torch.atan2(directions[..., 1], directions[..., 0]))
    elevation = torch.rad2deg(torch.asin(directions[..., 2]))
    torch.testing.assert_close(azimuth[0], torch.linspace(19.5, -19.5, COLUMNS).double(), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(elevation[:, 0], torch.linspace(11.6, -11.6, ROWS).double(), atol=1e-5, rtol=0.0)
    assert float((azimuth - azimuth[:1]).abs().max()) < 1e-9
    pixel_sr = math.radians(1.0) * math.radians(0.8)
    assert 0.25 * math.pi * (1e-3 * FLASH.divergence_mrad) ** 2 == pytest.approx(pixel_sr, rel=1e-12)
    assert (FLASH.columns, FLASH.column_step_deg) == (COLUMNS, pytest.approx(1.0))


def listed_drops(frames: int, rate: float, extinction_per_m: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Range of the brightest visible drop of each pixel (inf: none), from drops listed in the field of view."""
    rng = np.random.default_rng(seed)
    sizes = population("rain", rate)
    half = np.radians(VIEW_DEG[0]) / 2, np.radians(VIEW_DEG[1]) / 2
    solid_sr = 2 * half[0] * 2 * np.sin(half[1])
    threshold = 0.1 / math.pi / FLASH.range_at_10_percent_m**2
    cone = 1e-3 * FLASH.divergence_mrad
    best = np.zeros((frames, ROWS, COLUMNS))
    ranges = np.full((frames, ROWS, COLUMNS), np.inf)
    # A drop of the largest size is seen up to here: 0.2 / (4 pi r^2) (D / (cone r))^2 = threshold.
    far = (0.2 / (4 * math.pi) * (sizes.largest_mm * 1e-3 / cone) ** 2 / threshold) ** 0.25
    volume = solid_sr * (far**3 - 0.5**3) / 3
    # Only drops that the nearest place could show.
    least_mm = 1e3 * cone * 0.5 * math.sqrt(threshold * 0.5**2 * 4 * math.pi / 0.2)
    low, high = (
        np.exp(-sizes.slope_per_mm * max(sizes.smallest_mm, least_mm)),
        np.exp(-sizes.slope_per_mm * sizes.largest_mm),
    )
    share = (low - high) / (np.exp(-sizes.slope_per_mm * sizes.smallest_mm) - high)
    for frame in range(frames):
        n = rng.poisson(sizes.per_m3 * share * volume)
        r = (0.5**3 + rng.random(n) * (far**3 - 0.5**3)) ** (1 / 3)
        azimuth = rng.uniform(-half[0], half[0], n)
        elevation = np.arcsin(rng.uniform(-np.sin(half[1]), np.sin(half[1]), n))
        diameter_mm = -np.log(low - rng.random(n) * (low - high)) / sizes.slope_per_mm
        ratio = np.minimum(1.0, diameter_mm * 1e-3 / (cone * r)) ** 2
        signal = (
            0.2 / (4 * math.pi) * np.minimum(1.0, (r - 0.5) / 0.01) * np.exp(-2 * extinction_per_m * r) / r**2 * ratio
        )
        column = np.minimum(((half[0] - azimuth) / (2 * half[0]) * COLUMNS).astype(int), COLUMNS - 1)
        row = np.minimum(((half[1] - elevation) / (2 * half[1]) * ROWS).astype(int), ROWS - 1)
        seen = signal >= threshold
        for k in np.flatnonzero(seen)[np.argsort(signal[seen])]:
            best[frame, row[k], column[k]], ranges[frame, row[k], column[k]] = signal[k], r[k]
    return best, ranges


def test_pixels_see_the_drops_of_their_own_field() -> None:
    rate, frames = 40.0, 60
    transform = LidarWeather(Rain(rate), FLASH)
    points = torch.zeros(frames, ROWS * COLUMNS, 4)
    result = transform.run(points, seed=3, directions=scan_directions(FLASH))
    assert isinstance(result.points, Tensor)
    particle = result.kind == int(PointKind.PARTICLE)
    best, ranges = listed_drops(frames, rate, float(transform.extinction_per_m), seed=8)
    hits, pixels = (int(particle.sum()), int((best > 0).sum())), frames * ROWS * COLUMNS
    assert min(hits) > 1000
    assert abs(share_z(hits[0], pixels, hits[1], pixels)) < z_critical()
    found = result.points[particle][:, :3].norm(dim=-1).numpy()
    assert ks_distance(found, ranges[best > 0]) < ks_critical(hits[0], hits[1])


def test_a_view_of_a_flash_is_its_grid() -> None:
    flash = Lidar.preset("generic-flash-1064nm")
    view = lidar_view(track(), flash)
    assert view.grid == (32, 128)
    assert len(view.points) == 32 * 128
    clear = LidarWeather(Rain(0.0), flash)(view.points, seed=1, directions=view.directions)
    assert torch.equal(clear, view.points)  # type: ignore[arg-type]
    wet = LidarWeather(Rain(50.0), flash).run(view.points, seed=1, directions=view.directions)
    assert bool((wet.kind == int(PointKind.OBJECT)).any())
    assert flash.divergence_mrad == pytest.approx(
        Lidar.flash(1064.0, view_deg=(120.0, 30.0), columns=128, rows=32).divergence_mrad, abs=0.005
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: LidarWeather(Rain(1.0), FLASH, complete_scan=True), "complete_scan is for a sensor that turns"),
        (lambda: empty_beams(torch.ones(3, 4), FLASH), "empty_beams: expected a sensor that turns; got a flash"),
        (lambda: replace(FLASH, columns=7), "columns of their number, 40, or None; got 7 columns"),
        (lambda: Lidar(905.0, azimuths_deg=(0.0, 1.0)), "they need elevations_deg"),
        (lambda: Lidar.flash(905.0, view_deg=(0.0, 3.0), columns=2, rows=2), r"view_deg\[0\] must lie in 0.001..359"),
        (lambda: Lidar.flash(905.0, view_deg=(3.0,), columns=2, rows=2), "view_deg must be"),
        (lambda: Lidar.flash(905.0, view_deg=(3.0, 3.0), columns=0, rows=2), "columns must lie in 1..100000"),
        (lambda: replace(FLASH, azimuth_offsets_deg=(0.0,) * ROWS), "azimuth_offsets_deg are of rings that turn"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
