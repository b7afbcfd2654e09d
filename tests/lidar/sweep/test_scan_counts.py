"""Beams of a sweep against rings times columns: what does not fit is named with the evidence."""

from __future__ import annotations

import numpy as np
import pytest

from tests.lidar.sweep.scan_sweep import COLUMNS, sweep
from torchweather.lidar import check_scan_counts, estimate_pattern, scan_count_problem

CELLS = 24 * COLUMNS


def test_a_whole_turn_fits_and_a_third_too_many_does_not() -> None:
    pattern = estimate_pattern(sweep()[0])
    lacking = CELLS - pattern.beams
    check_scan_counts(pattern, lacking)
    check_scan_counts(pattern, lacking - CELLS // 50)
    with pytest.raises(ValueError, match=rf"{pattern.beams} beams with a return \+ {2 * lacking} without"):
        check_scan_counts(pattern, 2 * lacking)


@pytest.mark.parametrize(
    ("rings", "columns", "cause"),
    [
        (64, COLUMNS, r"The sweep shows 24 rings \(-24\.0 to 2\.0 degrees\): another sensor"),
        (24, 2 * COLUMNS, "The columns are wrong: neighbours stand 0.400 degrees apart, which is 900 columns"),
    ],
)
def test_a_wrong_preset_is_named(rings: int, columns: int, cause: str) -> None:
    pattern = estimate_pattern(sweep()[0])
    problem = scan_count_problem(pattern, 0, rings=rings, columns=columns)
    assert problem is not None
    assert f"but {rings} rings x {columns} columns are {rings * columns}" in problem
    with pytest.raises(ValueError, match=cause):
        check_scan_counts(pattern, 0, rings=rings, columns=columns)


def test_two_echoes_a_beam_are_named() -> None:
    points, ring = sweep(missing=0.0)
    nearer = points * np.array([0.8, 0.8, 0.8, 1.0], np.float32)
    pattern = estimate_pattern(np.stack([points, nearer], 1).reshape(-1, 4), np.repeat(ring, 2))
    assert scan_count_problem(pattern, 0) is None
    problem = scan_count_problem(pattern, CELLS // 10)
    assert problem is not None
    assert "two echoes a beam" in problem


def test_a_part_of_a_turn_needs_no_beams_where_it_does_not_look() -> None:
    points, _ = sweep(missing=0.0)
    pattern = estimate_pattern(points[points[:, 0] > 0])
    assert scan_count_problem(pattern, 0) is None
    thinned = estimate_pattern(points[(points[:, 0] > 0)][::2])
    problem = scan_count_problem(thinned, 0, columns=COLUMNS)
    assert problem is not None
