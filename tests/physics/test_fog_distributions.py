"""Fogs by their visibility."""

from __future__ import annotations

import math

import pytest
import torch

from torchweather.physics import (
    FOG,
    RAIN,
    SNOW,
    advection_fog,
    default_fog,
    extinction_per_m,
    mor_from_extinction,
    rehearse_fog,
    scaled_to_visibility,
)


@pytest.mark.parametrize("name", [name for name in FOG if name != "advection-liquid-water"])
def test_every_named_fog_has_the_visibility_asked_for(name: str) -> None:
    mor = torch.tensor([12.0, 60.0, 700.0], dtype=torch.float64)
    fog = FOG[name](mor)
    torch.testing.assert_close(mor_from_extinction(extinction_per_m(fog, 550.0)), mor, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize("nominal", [10, 20, 30, 50])
def test_default_fog_has_the_shape_measured_at_its_visibility(nominal: int) -> None:
    fog, measured = default_fog(float(nominal)), rehearse_fog(nominal)
    assert float(fog.median_radius_um) == pytest.approx(float(measured.median_radius_um), rel=1e-12)
    assert float(fog.sigma) == pytest.approx(float(measured.sigma), rel=1e-12)
    # the measured number gives a visibility about 10 % shorter
    assert float(fog.number_per_cm3) == pytest.approx(0.9 * float(measured.number_per_cm3), rel=0.03)


def test_default_fog_holds_its_shape_outside_the_measured_visibilities() -> None:
    for outside, edge in ((3.0, 10.0), (800.0, 50.0)):
        assert float(default_fog(outside).sigma) == float(default_fog(edge).sigma)


def test_extinction_falls_smoothly_with_the_visibility_at_every_wavelength() -> None:
    mor = torch.logspace(0.7, 3.5, 300, dtype=torch.float64)
    for wavelength_nm in (460.0, 905.0):
        extinction = extinction_per_m(default_fog(mor), wavelength_nm)
        assert bool((extinction.diff() < 0).all())


def test_unlimited_visibility_has_no_droplets() -> None:
    fog = default_fog(torch.tensor([math.inf, 50.0]))
    assert float(fog.total_per_m3[0]) == 0.0
    assert float(extinction_per_m(fog, 905.0)[0]) == 0.0
    assert float(extinction_per_m(advection_fog(math.inf), 905.0)) == 0.0


def test_older_visual_range_means_more_droplets() -> None:
    ratio = default_fog(100.0, contrast=0.02).number_per_cm3 / default_fog(100.0).number_per_cm3
    assert float(ratio) == pytest.approx(math.log(50.0) / math.log(20.0), rel=1e-12)


def test_gradient_in_the_visibility() -> None:
    mor = torch.tensor([12.0, 34.0, 300.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: extinction_per_m(default_fog(v), 905.0), mor)
    assert torch.autograd.gradcheck(lambda v: advection_fog(v, variant="liquid-water").total_per_m3 * 1e-6, mor)


def test_scaling_keeps_the_shape() -> None:
    measured = rehearse_fog(30)
    fog = scaled_to_visibility(measured, torch.tensor([20.0, 40.0]))
    assert fog.batch_shape == (2,)
    ratio = fog.effective_diameter_mm / measured.effective_diameter_mm
    torch.testing.assert_close(ratio, torch.ones_like(ratio))


def test_every_named_distribution_is_batched_over_its_intensity() -> None:
    intensity = torch.tensor([5.0, 50.0])
    for named in (*RAIN.values(), *SNOW.values(), *FOG.values()):
        assert named(intensity).total_per_m3.shape == (2,)
        assert named(5.0).total_per_m3.shape == ()


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan])
def test_visibility_of_zero_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="mor_m must be above 0 m"):
        default_fog(bad)


def test_unmeasured_nominal_visibility_is_refused() -> None:
    with pytest.raises(ValueError, match="10, 20, 30, 50 m"):
        rehearse_fog(40)
