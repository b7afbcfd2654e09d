"""A particle narrower than a pixel has the spread of a disk, not of the square around it."""

from __future__ import annotations

import pytest
import torch

from tests.camera.particles.test_streaks import marks_at, mask_of


@pytest.mark.parametrize("width_px", [0.5, 0.7, 0.95])
def test_spread_along_the_motion_is_that_of_a_disk(width_px: float) -> None:
    """Of a uniform disk of diameter w: w^2 / 16 along an axis; a pixel adds 1 / 12 on the average of its phases."""
    rows = torch.arange(9.0, dtype=torch.float64)
    found = []
    for step in range(64):
        v = 4.0 + (step + 0.5) / 64 - 0.5
        of_row = mask_of(marks_at([4.2], [v], (0.0, 0.0), width_px, opacity=0.01), 9, 9).sum(1)
        found.append(float((of_row * (rows - v).square()).sum() / of_row.sum()))
    assert sum(found) / len(found) - 1 / 12 == pytest.approx(width_px**2 / 16, rel=0.02)  # a square would have 1 / 12
