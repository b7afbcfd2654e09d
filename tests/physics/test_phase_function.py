"""Phase functions: normalised, with the asymmetry and the backscatter of the efficiencies, and their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.physics import extinction_and_backscatter, marshall_palmer, mie_efficiencies, rehearse_fog
from torchweather.physics.mie import mie_scattered_power
from torchweather.physics.phase_function import henyey_greenstein_per_sr, mie_phase_function_per_sr

ANGLE = torch.cat([torch.zeros(1).double(), torch.logspace(-5, math.log10(math.pi), 1500).double()]).clamp_max(math.pi)


def over_the_sphere(per_sr: torch.Tensor, weight: torch.Tensor | float = 1.0) -> float:
    return float(torch.trapezoid(2.0 * math.pi * torch.sin(ANGLE) * per_sr * weight, ANGLE))


@pytest.mark.parametrize("nominal", [10, 30, 50])
def test_fog_scatters_all_its_light_and_as_much_back_as_the_backscatter_coefficient(nominal) -> None:
    fog = rehearse_fog(nominal)
    per_sr = mie_phase_function_per_sr(fog, 550.0, ANGLE)
    assert over_the_sphere(per_sr) == pytest.approx(1.0, abs=1e-3)
    assert 0.81 < over_the_sphere(per_sr, torch.cos(ANGLE)) < 0.87
    extinction, backscatter = extinction_and_backscatter(fog, 550.0)
    # Each sums the sizes at nodes of its own; the glory's peak at 180 degrees is narrow in size.
    assert float(per_sr[-1]) == pytest.approx(float(backscatter / extinction), rel=0.01)


@pytest.mark.parametrize("x", [0.3, 5.0, 80.0])
def test_the_asymmetry_of_one_sphere_is_that_of_its_efficiencies(x) -> None:
    whole, per_sr = mie_scattered_power(np.array([x]), 1.33, ANGLE.numpy())
    known = mie_efficiencies(x, 1.33)
    found = torch.from_numpy(per_sr[0] / whole[0])
    assert float(whole[0]) == pytest.approx(float(known.q_sca) * math.pi * x * x, rel=1e-9)
    assert over_the_sphere(found) == pytest.approx(1.0, abs=2e-3)
    assert over_the_sphere(found, torch.cos(ANGLE)) == pytest.approx(float(known.g), abs=2e-3)
    assert 4.0 * math.pi * float(per_sr[0, -1]) / (math.pi * x * x) == pytest.approx(float(known.q_back), rel=1e-6)


def test_the_smallest_spheres_scatter_as_rayleigh_has_it() -> None:
    whole, per_sr = mie_scattered_power(np.array([1e-3]), 1.33, ANGLE.numpy())
    rayleigh = 3.0 / (16.0 * math.pi) * (1.0 + torch.cos(ANGLE).square().numpy())
    np.testing.assert_allclose(per_sr[0] / whole[0], rayleigh, rtol=1e-5)


def test_henyey_and_greenstein_has_its_asymmetry() -> None:
    per_sr = henyey_greenstein_per_sr(ANGLE, 0.85)
    assert over_the_sphere(per_sr) == pytest.approx(1.0, abs=1e-4)
    assert over_the_sphere(per_sr, torch.cos(ANGLE)) == pytest.approx(0.85, abs=1e-4)


def test_drops_of_rain_are_refused_by_name() -> None:
    with pytest.raises(TorchweatherError, match="size parameter"):
        mie_phase_function_per_sr(marshall_palmer(10.0), 550.0, ANGLE)
    with pytest.raises(TorchweatherError, match="angle_rad"):
        mie_phase_function_per_sr(rehearse_fog(30), 550.0, 4.0)
