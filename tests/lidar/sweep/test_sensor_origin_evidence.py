"""When an estimated origin counts as apart from the cloud's: evidence in errors, in gain, and in metres."""

from __future__ import annotations

from dataclasses import replace

import pytest

from torchweather.lidar.sweep.sensor_origin import SensorOrigin

APART = SensorOrigin(
    origin_m=(1.0, 0.0, 0.0),
    error_m=(0.05, 0.05, 0.05),
    motion_m=(0.0, 0.0),
    spread_deg=0.05,
    spread_at_zero_deg=0.20,
    rings=32,
    found_by="file order",
)


def test_an_offset_of_many_errors_from_which_the_cones_fit_better_is_apart() -> None:
    assert APART.is_apart
    assert replace(APART, origin_m=(0.0, 0.0, 1.8), spread_at_zero_deg=0.05).is_apart  # a mast, on the same axis


@pytest.mark.parametrize(
    "changed",
    [
        {"error_m": (0.3, 0.0, 0.05)},  # 1.0 m is 3.3 errors
        {"error_m": (0.0, 0.3, 0.05)},
        {"spread_at_zero_deg": 0.06},  # the cones fit as well from the cloud's origin
        {"motion_m": (0.5, 0.6)},  # the vehicle moved by 0.78 m within the sweep
        {"origin_m": (0.25, 0.0, 0.0)},  # less than the sensors of a cloud lie apart
        {"origin_m": (0.0, 0.0, 0.45)},
        {"origin_m": (0.0, 0.0, 1.8), "error_m": (0.0, 0.0, 0.5)},
        {"spread_deg": 0.16, "spread_at_zero_deg": 1.0},  # no cones at all
    ],
)
def test_weak_evidence_moves_no_sensor(changed: dict[str, object]) -> None:
    assert not replace(APART, **changed).is_apart
