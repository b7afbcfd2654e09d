"""Fall speeds against the oracles' laws and Gunn & Kinzer's measurements."""

from __future__ import annotations

import pytest
import torch

from tests.oracles import load
from torchweather.physics import (
    fall_speed_after_m_per_s,
    flake_fall_speed_m_per_s,
    rain_fall_speed_m_per_s,
    snow_fall_speed_m_per_s,
)
from torchweather.physics.snow_geometry import physical_diameter_mm

BLOCK = load("terminal_velocity")


@pytest.mark.parametrize(
    ("key", "law"),
    [
        ("rain_atlas_ulbrich_3p78_D0p67", lambda d: rain_fall_speed_m_per_s(d, "atlas-ulbrich")),
        ("snow_langleben_2p07_Dcm_0p31", snow_fall_speed_m_per_s),
        ("snow_as_printed_2_10D_0p31", lambda d: snow_fall_speed_m_per_s(d, variant="d3_4")),
    ],
)
def test_power_laws_are_as_stated(key: str, law) -> None:
    for diameter, speed in BLOCK[key].items():
        assert float(law(float(diameter))) == pytest.approx(speed, rel=1e-12)


def test_atlas_1973_is_as_stated_and_never_rises() -> None:
    for diameter, speed in BLOCK["rain_atlas73_9p65_10p3"].items():
        got = float(rain_fall_speed_m_per_s(float(diameter), "atlas-1973"))
        assert got == pytest.approx(max(speed, 0.0), rel=1e-12, abs=1e-15)  # negative below 0.109 mm


def test_brandes_polynomial_between_half_and_five_and_a_half_millimetres() -> None:
    for diameter, speed in BLOCK["rain_brandes2002"].items():
        if 0.5 <= float(diameter) <= 5.5:
            assert float(rain_fall_speed_m_per_s(float(diameter))) == pytest.approx(speed, rel=1e-12)


def test_default_speed_is_within_four_percent_of_gunn_and_kinzer_at_every_size() -> None:
    for diameter, speed in BLOCK["gunn_kinzer_measured"].items():
        assert float(rain_fall_speed_m_per_s(float(diameter))) == pytest.approx(speed, rel=0.04)


def test_small_drops_have_the_measured_speed_and_none_at_all_stands_still() -> None:
    got = rain_fall_speed_m_per_s(torch.tensor([0.0, 0.1, 0.2, 0.3], dtype=torch.float64))
    torch.testing.assert_close(got, torch.tensor([0.0, 0.27, 0.72, 1.17], dtype=torch.float64))


def test_large_drops_hold_the_measured_maximum() -> None:
    assert rain_fall_speed_m_per_s(torch.tensor([5.8, 6.0, 8.0])).tolist() == [9.17, 9.17, 9.17]


def test_speed_rises_without_a_step() -> None:
    diameter = torch.linspace(0.0, 8.0, 80_001, dtype=torch.float64)  # 0.1 um apart
    step = rain_fall_speed_m_per_s(diameter).diff()
    assert float(step.min()) >= 0.0
    assert float(step.max()) < 6e-4  # 5 m/s per mm at most


def test_flakes_fall_with_the_speed_of_their_melted_diameter() -> None:
    melted = torch.tensor([0.1, 0.12, 1.0, 4.0], dtype=torch.float64)
    speed = flake_fall_speed_m_per_s(physical_diameter_mm(melted))
    torch.testing.assert_close(speed, snow_fall_speed_m_per_s(melted))


@pytest.mark.parametrize("law", ["brandes", "atlas-1973", "atlas-ulbrich"])
def test_gradient(law: str) -> None:
    diameter = torch.tensor([0.15, 0.7, 3.3, 5.3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda d: rain_fall_speed_m_per_s(d, law), diameter)


def test_unknown_law_is_refused() -> None:
    with pytest.raises(ValueError, match="Did you mean 'brandes'"):
        rain_fall_speed_m_per_s(1.0, "brands")


def stepped_speed(terminal: float, height: float, step_s: float = 1e-4) -> float:
    """``dv/dt = g (1 - v^2 / v_t^2)`` in small steps, until the height is fallen."""
    speed = fallen = 0.0
    while fallen < height:
        speed += step_s * 9.80665 * (1.0 - (speed / terminal) ** 2)
        fallen += step_s * speed
    return speed


def test_a_drop_from_rest_falls_as_newton_says() -> None:
    heights = (0.05, 0.5, 3.0, 8.0)
    for diameter in (0.5, 1.0, 4.0):
        terminal = float(rain_fall_speed_m_per_s(diameter))
        for height in heights:
            # A step of 0.1 ms is 1 mm/s of speed at most.
            assert float(fall_speed_after_m_per_s(terminal, height)) == pytest.approx(
                stepped_speed(terminal, height), abs=2e-3
            )
    # Near the nozzle a drop falls freely; far from it, it has its terminal speed.
    assert float(fall_speed_after_m_per_s(9.0, 1e-4)) == pytest.approx((2 * 9.80665 * 1e-4) ** 0.5, rel=1e-4)
    assert fall_speed_after_m_per_s(torch.tensor([0.0, 9.0]), torch.inf).tolist() == [0.0, 9.0]
    assert fall_speed_after_m_per_s(torch.tensor([0.0, 9.0]), 0.0).tolist() == [0.0, 0.0]


def test_wrong_heights_and_speeds_are_refused() -> None:
    with pytest.raises(ValueError, match="fall_m"):
        fall_speed_after_m_per_s(4.0, -1.0)
    with pytest.raises(ValueError, match="terminal_m_per_s"):
        fall_speed_after_m_per_s(-4.0, 1.0)
