"""Published ranges that every law of the library has to lie in, or is known to miss."""

from __future__ import annotations

import math

import pytest

import torchweather as tw
from torchweather.physics import FOG, SNOW, extinction_per_m

DB_PER_NEPER = 10.0 / math.log(10.0)
# Product of the loss (dB/km) and the visibility (km) in measured fogs, visible and near infrared; ln 20 is 13.0.
FOG_DB_TIMES_V = (8.5, 17.0)
# Largest over smallest visibility at one measured snowfall rate.
SNOW_SPREAD = (3.0, 10.0)


@pytest.mark.parametrize("law", list(FOG))
@pytest.mark.parametrize("wavelength_nm", [550.0, 785.0, 905.0, 1550.0])
def test_loss_times_visibility_of_fog(law: str, wavelength_nm: float) -> None:
    for mor_m in (50.0, 200.0, 500.0):
        loss = float(extinction_per_m(tw.Fog(mor_m=mor_m, size_distribution=law).distribution(), wavelength_nm))
        assert FOG_DB_TIMES_V[0] < DB_PER_NEPER * loss * mor_m < FOG_DB_TIMES_V[1]


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_size_laws_of_snow_differ_by_less_than_measured_visibilities_do(rate: float) -> None:
    """A known limit, on docs/against-recordings.md: sizes alone explain a part of the spread."""
    found = [float(extinction_per_m(tw.Snow(rate, size_distribution=law).distribution(), 550.0)) for law in SNOW]
    assert 1.4 < max(found) / min(found) < SNOW_SPREAD[0]
