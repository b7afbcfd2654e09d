"""Beams without a return in a street of known shape: only those that end in the sky are open."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.gap.sensors.lidar.open_beams import column_spacing_rad, open_beams

ROWS, COLUMNS = 32, 256
GRID, HEIGHT_M, MAX_RANGE_M = (ROWS, COLUMNS), 1.8, 120.0
WALL_M, WALL_TOP_RAD = 12.0, math.radians(8.0)
ELEVATION = np.radians(np.linspace(-16.0, 15.0, ROWS))[:, None]
AZIMUTH = (np.arange(COLUMNS) + 0.5) * 2.0 * math.pi / COLUMNS - math.pi
FLAT = np.cos(ELEVATION)
SINE = np.sin(ELEVATION) + 0.0 * AZIMUTH
DIRECTION = torch.from_numpy(
    np.stack([FLAT * np.cos(AZIMUTH), FLAT * np.sin(AZIMUTH), SINE], -1).reshape(-1, 3).astype(np.float32)
)


def street() -> np.ndarray:
    """Ground that answers to 40 m, and a wall over half of the turn."""
    with np.errstate(divide="ignore"):
        ground = np.where(SINE < 0, -HEIGHT_M / np.minimum(SINE, -1e-9), np.inf)
    wall = np.where((np.cos(AZIMUTH) > 0) & (ELEVATION < WALL_TOP_RAD), WALL_M / FLAT, np.inf)
    found = np.minimum(ground, wall)
    return np.where(found < 40.0, found, 0.0)


def opened(*frames: np.ndarray) -> np.ndarray:
    range_m = torch.from_numpy(np.stack(frames).reshape(len(frames), -1).astype(np.float32))
    return open_beams(range_m, DIRECTION, GRID, MAX_RANGE_M).numpy().reshape(len(frames), *GRID)


def test_sky_is_open_and_dark_ground_is_not() -> None:
    (found,) = opened(street())
    behind = np.broadcast_to(np.cos(AZIMUTH) <= 0, GRID)
    above = np.where(behind, ELEVATION > -1e-6, ELEVATION >= WALL_TOP_RAD)
    np.testing.assert_array_equal(found, above)
    far_ground = behind & (street() == 0) & (ELEVATION < 0)
    assert far_ground.sum() > 100
    assert not found[far_ground].any()


@pytest.mark.parametrize("columns", [1, 3])
def test_a_side_that_gives_no_return_ends_its_beams(columns: int) -> None:
    """A vehicle's side at a glancing angle, between two walls; ground below and wall above return."""
    range_m = street()
    rows, place = slice(12, 20), slice(COLUMNS // 2 + 10, COLUMNS // 2 + 10 + columns)
    range_m[rows, place] = 0.0
    (found,) = opened(range_m)
    assert not found[rows, place].any()
    assert found.sum() == opened(street())[0].sum()


def test_each_frame_is_judged_alone() -> None:
    lit = street()
    lit[-1, 5] = 30.0  # a lone return in the sky
    found = opened(street(), lit)
    assert found[0, -1, 5]
    assert not found[1, -1, 5]
    assert found[0].sum() - found[1].sum() == 1


def test_no_returns_at_all_leave_every_beam_open() -> None:
    assert opened(np.zeros(GRID)).all()


def test_the_spacing_of_columns_goes_over_half_a_turn() -> None:
    assert column_spacing_rad(torch.from_numpy(np.tile(AZIMUTH, (2, 1)))) == pytest.approx(2.0 * math.pi / COLUMNS)
