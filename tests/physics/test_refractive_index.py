"""Refractive indices against the sources' own numbers."""

from __future__ import annotations

import pytest
import torch

from tests.oracles import load
from torchweather.core.errors import TorchweatherWarning
from torchweather.physics import (
    ice_permittivity_microwave,
    ice_refractive_index,
    ice_refractive_index_microwave,
    maxwell_garnett,
    snow_refractive_index_microwave,
    water_permittivity_microwave,
    water_refractive_index,
    water_refractive_index_25c,
    water_refractive_index_microwave,
)

BLOCK = load("refractive_index")
EXACT = 1e-9  # the stated tolerance of the millimetre-wave formulae


@pytest.mark.parametrize("name", BLOCK["optical"])
def test_optical_index_of_water_and_ice(name: str) -> None:
    wavelength_nm, row = float(name.removesuffix("nm")), BLOCK["optical"][name]
    for celsius, n in row["water_n_iapws"].items():
        # 2e-6: the formula is the same; the densities of water differ in the sixth digit
        assert complex(water_refractive_index(wavelength_nm, float(celsius))).real == pytest.approx(n, abs=2e-6)
    table = complex(water_refractive_index_25c(wavelength_nm))
    assert table.real == pytest.approx(row["water_hale_querry_25C"][0], abs=3e-5)  # rows 1549/1600 nm
    # n within 0.003 between the sources at 25 C and at 10 C, as the block states
    assert complex(water_refractive_index(wavelength_nm)).real == pytest.approx(table.real, abs=0.0032)
    ice = complex(ice_refractive_index(wavelength_nm))
    assert ice.real == pytest.approx(row["ice_warren_brandt"][0], abs=1e-6)
    assert ice.imag == pytest.approx(row["ice_warren_brandt"][1], rel=1e-6)


@pytest.mark.parametrize("name", BLOCK["optical"])
def test_absorption_of_water_is_that_of_the_named_source(name: str) -> None:
    wavelength_nm, row = float(name.removesuffix("nm")), BLOCK["optical"][name]
    source = "water_segelstein" if wavelength_nm > 1000 else "water_hale_querry_25C"
    # Segelstein's table is thinned beyond 1000 nm
    tolerance = 2e-3 if wavelength_nm > 1000 else 1e-9
    assert complex(water_refractive_index(wavelength_nm)).imag == pytest.approx(row[source][1], rel=tolerance)


def test_millimetre_wave_water_is_the_double_debye_model() -> None:
    for frequency, rows in BLOCK["water_mw"].items():
        for celsius, row in rows.items():
            eps = complex(water_permittivity_microwave(float(frequency), float(celsius)))
            n = complex(water_refractive_index_microwave(float(frequency), float(celsius)))
            assert abs(eps / complex(*row["eps"]) - 1) < EXACT
            assert abs(n / complex(*row["n"]) - 1) < EXACT
            k_squared = abs((eps - 1) / (eps + 2)) ** 2
            assert k_squared == pytest.approx(row["K2"], rel=EXACT)


def test_millimetre_wave_ice_is_maetzlers() -> None:
    for frequency, rows in BLOCK["ice_mw"].items():
        for celsius, row in rows.items():
            eps = complex(ice_permittivity_microwave(float(frequency), float(celsius)))
            n = complex(ice_refractive_index_microwave(float(frequency), float(celsius)))
            assert eps.real == pytest.approx(row["eps"][0], rel=EXACT)
            assert eps.imag == pytest.approx(row["eps"][1], rel=EXACT)
            assert n.imag == pytest.approx(row["n"][1], rel=EXACT)


def test_mixture_without_ice_is_air_and_full_of_ice_is_ice() -> None:
    ice = ice_permittivity_microwave(77.0, -5.0)
    assert complex(maxwell_garnett(1.0, ice, 0.0)) == pytest.approx(1.0)
    assert complex(maxwell_garnett(1.0, ice, 1.0)) == pytest.approx(complex(ice))
    assert complex(snow_refractive_index_microwave(77.0, 0.917)) == pytest.approx(
        complex(ice_refractive_index_microwave(77.0, -5.0))
    )


def test_index_is_batched_over_wavelength_and_temperature() -> None:
    index = water_refractive_index(torch.tensor([[460.0], [600.0]]), torch.tensor([0.0, 10.0, 20.0]))
    assert index.shape == (2, 3)
    assert index.dtype == torch.complex128
    assert bool((index.imag > 0).all())


def test_wavelength_outside_the_table_warns() -> None:
    with pytest.warns(TorchweatherWarning, match="300-2500 and 8000-14000 nm"):
        ice_refractive_index(3000.0)


def test_bad_temperature_is_refused() -> None:
    with pytest.raises(ValueError, match="temperature_c"):
        water_refractive_index_microwave(77.0, 500.0)
