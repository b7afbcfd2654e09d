"""Intensity units: there and back, rounding of counts, what stays untouched."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.lidar.intensity import dimmed_intensity, intensity_from_signal, reflectivity_from_intensity

LINEAR = {"reflectivity": 1.0, "reflectivity_percent": 100.0, "uint8_linear": 255.0, "uint8_calibrated": 100.0}
COUNTED = ("reflectivity_percent", "uint8_linear", "uint8_calibrated", "photons")
UNITS = (*LINEAR, "photons", "none")
FRACTIONAL, INTEGRAL = torch.tensor([[False]]), torch.tensor([[True]])
K = torch.tensor(1.0)


def particle(reflectivity: Tensor, unit: str, integral: Tensor = FRACTIONAL) -> Tensor:
    """Intensity of particles of an equivalent reflectivity, at ranges of 2 to 5 m."""
    range_m = torch.linspace(2.0, 5.0, reflectivity.numel(), dtype=torch.float64)[None]
    return intensity_from_signal(reflectivity / (math.pi * range_m**2), range_m, unit, integral, K)


@pytest.mark.parametrize(("unit", "white"), LINEAR.items())
def test_a_white_target_has_reflectivity_one(unit: str, white: float) -> None:
    assert float(reflectivity_from_intensity(torch.tensor(white), unit, 0.1)) == 1.0


@pytest.mark.parametrize("unit", LINEAR)
def test_a_signal_goes_to_an_intensity_and_back(unit: str) -> None:
    """pi X R^2 is the reflectivity that a diffuse target of that signal would have."""
    wanted = torch.logspace(-4, 2, 40, dtype=torch.float64)[None]
    got = reflectivity_from_intensity(particle(wanted, unit), unit, 0.1)
    assert torch.allclose(got, wanted, rtol=1e-12)


def test_calibrated_bytes_are_linear_to_white_and_logarithmic_to_a_retroreflector() -> None:
    value = torch.tensor([0.0, 50.0, 100.0, 177.5, 255.0], dtype=torch.float64)
    wanted = torch.tensor([0.0, 0.5, 1.0, 10.0, 100.0], dtype=torch.float64)
    assert torch.allclose(reflectivity_from_intensity(value, "uint8_calibrated", 0.1), wanted, rtol=1e-12)


def test_without_a_unit_every_target_has_the_assumed_reflectivity_and_every_return_the_value_one() -> None:
    assert torch.equal(reflectivity_from_intensity(torch.tensor([0.0, 7.0]), "none", 0.3), torch.tensor([0.3, 0.3]))
    assert torch.equal(particle(torch.tensor([[1e-3, 2.0]]), "none"), torch.ones(1, 2))


def test_photons_of_a_particle_are_its_signal_times_the_system_constant() -> None:
    signal, range_m = torch.tensor([[2e-5, 4e-5]]), torch.tensor([[3.0, 9.0]])
    found = intensity_from_signal(signal, range_m, "photons", FRACTIONAL, torch.tensor(5e5))
    assert torch.allclose(found, torch.tensor([[10.0, 20.0]]))


@pytest.mark.parametrize("unit", COUNTED)
def test_counts_of_particles_are_rounded_down_where_the_input_counts(unit: str) -> None:
    """A 1 mm flake in a 23 mm beam has 0.0017 of white: WADS shows 0 for 97-99 % of its snow."""
    reflectivity = torch.tensor([[0.0017, 0.0099, 0.5, 0.999, 1.0]], dtype=torch.float64)
    exact, counted = particle(reflectivity, unit), particle(reflectivity, unit, INTEGRAL)
    assert torch.equal(counted, exact.floor())
    assert not torch.equal(counted, exact)
    assert float(particle(torch.tensor([[0.0017]]), unit, INTEGRAL)) == 0.0


@pytest.mark.parametrize("unit", ["uint8_linear", "uint8_calibrated"])
def test_bytes_end_at_255_and_only_where_the_input_is_bytes(unit: str) -> None:
    bright = torch.tensor([[1e4]], dtype=torch.float64)
    assert float(particle(bright, unit, INTEGRAL)) == 255.0
    assert float(particle(bright, unit)) > 255.0


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("integral", [FRACTIONAL, INTEGRAL], ids=["fractional", "integral"])
def test_gain_one_is_the_identity(unit: str, integral: Tensor) -> None:
    values = torch.tensor([[0.0, -0.0, 1e-30, 0.3, 7.0, 100.0, 100.5, 254.7, 255.0, 900.0]])
    got = dimmed_intensity(values, torch.ones_like(values), unit, integral)
    assert torch.equal(got.view(torch.int32), values.view(torch.int32))


@pytest.mark.parametrize("unit", LINEAR)
def test_half_the_signal_is_half_the_reflectivity(unit: str) -> None:
    values = torch.linspace(0.0, 255.0, 511, dtype=torch.float64)[None]
    for gain in (0.9, 0.5, 1e-3, 0.0):
        got = dimmed_intensity(values, torch.full_like(values, gain), unit, FRACTIONAL)
        wanted = gain * reflectivity_from_intensity(values, unit, 0.1)
        # A gain of 0 stops at 1e-30 in the logarithmic part.
        assert torch.allclose(reflectivity_from_intensity(got, unit, 0.1), wanted, rtol=1e-12, atol=1e-27)


def test_half_the_photons() -> None:
    values = torch.tensor([[0.0, 3.0, 800.0]])
    assert torch.equal(dimmed_intensity(values, torch.full_like(values, 0.5), "photons", FRACTIONAL), 0.5 * values)


@pytest.mark.parametrize("unit", COUNTED)
@pytest.mark.parametrize("gain", [0.999999, 0.99, 0.6, 0.1, 1e-4])
def test_dimmed_counts_are_integers_unbiased_and_never_brighter(unit: str, gain: float) -> None:
    values = torch.arange(0.0, 256.0, dtype=torch.float64)[None]
    got = dimmed_intensity(values, torch.full_like(values, gain), unit, INTEGRAL)
    assert torch.equal(got, got.floor())
    assert bool((got <= values).all())
    assert bool((got >= 0).all())
    assert bool((got.diff() >= 0).all())
    if unit != "uint8_calibrated":
        # The middle of the step is dimmed and rounded down: half a step too high by the middle, half too low by the
        # floor; 256 values scatter by 1/sqrt(12 * 256).
        below = (values + 0.5) * gain - (got + 0.5)
        assert abs(float(below.mean())) < 0.5 * (1 - gain) + 0.1


@pytest.mark.parametrize("unit", UNITS)
def test_a_smaller_gain_never_gives_a_larger_intensity(unit: str) -> None:
    values = torch.linspace(0.0, 300.0, 61)[:, None]
    gain = torch.linspace(0.0, 1.0, 501)[None]
    for integral, base in ((FRACTIONAL, values), (INTEGRAL, values.floor())):
        got = dimmed_intensity(base.expand(61, 501), gain.expand(61, 501), unit, integral)
        # Bytes above 255 that claim to be integers are clipped where they are dimmed, and left alone where not.
        assert bool((got.diff(dim=1) >= -1e-4).all())
        assert bool(torch.isfinite(got).all())


def test_gradients_are_finite_everywhere() -> None:
    for unit in UNITS:
        value = torch.tensor([[0.0, 50.0, 100.0, 101.0, 255.0]], dtype=torch.float64, requires_grad=True)
        gain = torch.tensor([[1.0, 0.5, 0.0, 1e-9, 0.3]], dtype=torch.float64, requires_grad=True)
        dimmed_intensity(value, gain, unit, FRACTIONAL).sum().backward()  # type: ignore[no-untyped-call]
        for tensor in (value, gain):
            if tensor.grad is not None:
                assert bool(torch.isfinite(tensor.grad).all()), unit
