"""Albedo of snow by photons that are followed through it, and the share of a surface that snow covers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchweather.physics import ice_refractive_index
from torchweather.physics.snow_pack import snow_pack_albedo, snow_share

PHOTONS = 20_000


def followed(single_scattering_albedo: float, asymmetry: float) -> float:
    """Share of diffuse light that a deep layer sends back, by weighted photons with Henyey and Greenstein's turns."""
    random = np.random.default_rng(5)
    mu = -np.sqrt(random.random(PHOTONS))  # downwards, diffuse
    depth, weight, back = np.zeros(PHOTONS), np.ones(PHOTONS), 0.0
    while len(depth):
        depth = depth - mu * -np.log(random.random(len(mu)))
        out = depth < 0
        back += weight[out].sum()
        depth, mu, weight = depth[~out], mu[~out], weight[~out] * single_scattering_albedo
        keep = weight > 1e-3
        depth, mu, weight = depth[keep], mu[keep], weight[keep]
        u = random.random(len(mu))
        turn = (1 + asymmetry**2 - ((1 - asymmetry**2) / (1 - asymmetry + 2 * asymmetry * u)) ** 2) / (2 * asymmetry)
        about = np.cos(2 * math.pi * random.random(len(mu)))
        mu = mu * turn + np.sqrt((1 - mu**2) * (1 - turn**2)) * about
        mu = mu.clip(-1, 1)
    return back / PHOTONS


@pytest.mark.parametrize(("wavelength_nm", "radius_um"), [(905.0, 200.0), (1300.0, 50.0), (1550.0, 30.0)])
def test_albedo_is_that_of_photons(wavelength_nm: float, radius_um: float) -> None:
    kappa = complex(ice_refractive_index(wavelength_nm)).imag
    absorbed_per_m = 4 * math.pi * kappa / (wavelength_nm * 1e-9)
    lost = 1.27 * absorbed_per_m * 2e-6 * radius_um / 3  # per extinction, of which half is diffraction
    found = followed(1 - lost, 0.8275)
    expected = float(snow_pack_albedo(wavelength_nm, radius_um))
    # The exponential is the law of weak absorption: 0.02 of its own beside the photons' scatter.
    assert found == pytest.approx(expected, abs=4 * math.sqrt(0.25 / PHOTONS) + 0.025)


def test_snow_is_white_for_cameras_and_dark_at_1550_nm() -> None:
    visible, near, far = snow_pack_albedo(torch.tensor([550.0, 905.0, 1550.0]), 50.0).tolist()
    assert visible > 0.97
    assert 0.8 < near < 0.95
    assert 0.05 < far < 0.3
    assert bool((snow_pack_albedo(905.0, torch.tensor([50.0, 200.0, 1000.0])).diff() < 0).all())


def test_snow_lies_on_what_is_level() -> None:
    depth = torch.tensor(30.0)
    slopes = torch.deg2rad(torch.tensor([0.0, 30.0, 45.0, 60.0, 90.0, 180.0])).cos()
    share = snow_share(depth, slopes)
    assert torch.allclose(share[:2], torch.full((2,), 1 - math.exp(-6.0)), atol=1e-5)
    assert 0.3 < float(share[2]) < 0.7
    assert torch.allclose(share[3:], torch.zeros(3), atol=1e-6)


@pytest.mark.parametrize(
    ("values", "said"), [((1800.0, 100.0), "300..1700 nm"), ((905.0, 5.0), r"grain_radius_um must lie in 20..2000 um")]
)
def test_beyond_the_range_of_the_law_is_refused(values: tuple[float, float], said: str) -> None:
    with pytest.raises(ValueError, match=said.replace("..", r"\.\.")):
        snow_pack_albedo(*values)
