"""The echo of rain and snow in the samples of every preset: its factor exists however many channels there are."""

from __future__ import annotations

import pytest
import torch

from torchweather.atmosphere.weather import Rain, Snow
from torchweather.radar import VolumeEcho
from torchweather.sensors import Radar


@pytest.mark.parametrize("preset", sorted(Radar.presets()))
@pytest.mark.parametrize("weather", [Rain(25.0), Snow(1.0)], ids=["rain", "snow"])
@pytest.mark.parametrize("turbulence_m_per_s", [0.0, 0.5])
def test_the_covariance_of_all_channels_has_a_factor(
    preset: str, weather: Rain | Snow, turbulence_m_per_s: float
) -> None:
    echo = VolumeEcho(weather, Radar.preset(preset), turbulence_m_per_s=turbulence_m_per_s)
    _, fall, fall_std = (value.float() for value in echo.falling(1))
    covariance = echo.covariance(fall, fall_std)
    factor = torch.linalg.cholesky(covariance)
    again = factor @ factor.mH
    scale = covariance.diagonal(dim1=-2, dim2=-1).real.amax(-1)[..., None, None]
    # Rounding of float32 (6e-8) over up to 192 terms.
    assert float(((again - covariance).abs() / scale).max()) < 2e-5


def test_the_added_white_noise_does_not_count() -> None:
    """Summed over Doppler, a channel's power is the pattern's integral over the view, within the 1e-5 that is added."""
    echo = VolumeEcho(Rain(25.0), Radar.preset("awr1843-like"))
    _, fall, fall_std = (value.float() for value in echo.falling(1))
    power = echo.covariance(fall, fall_std).diagonal(dim1=-2, dim2=-1).real.sum(1)
    _, weight = echo._directions(power.device)
    assert torch.allclose(power, weight.sum().expand_as(power), rtol=1e-4)
