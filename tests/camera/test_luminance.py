"""Luminance to signal and back: against a lens integrated over its pupil, and against published exposures."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

import torchweather as tw
from torchweather.camera.airlight import airlight_argument
from torchweather.core.errors import TorchweatherError
from torchweather.image import (
    LuminanceExposure,
    airlight_from_luminance,
    luminance_from_signal,
    signal_from_luminance,
)
from torchweather.recipes import load_recipe, save_recipe

SUNNY_16 = LuminanceExposure(iso=100, f_number=16, exposure_s=0.01)
CAMERA = tw.Camera.from_intrinsics(100.0, 100.0, 15.5, 11.5, 32, 24)


def pupil_lux(luminance: float, f_number: float, off_axis_rad: float, samples: int) -> tuple[float, float]:
    """Illuminance behind a lossless lens by rays from random points of its pupil, and the error of the mean.

    The pupil is a disk of diameter f / N at the distance f; a point of it adds ``L cos^2 / d^2`` per area.
    """
    generator = torch.Generator().manual_seed(1)
    radius = 0.5 / f_number * torch.rand(samples, generator=generator, dtype=torch.float64).sqrt()
    turn = 2 * math.pi * torch.rand(samples, generator=generator, dtype=torch.float64)
    x, y = radius * turn.cos() - math.tan(off_axis_rad), radius * turn.sin()
    square = x * x + y * y + 1.0
    value = luminance * math.pi * (0.5 / f_number) ** 2 / square**2
    return float(value.mean()), float(value.std()) / math.sqrt(samples)


def test_the_lens_factor_is_that_of_an_integrated_pupil() -> None:
    """90 % transmission and 2 % vignetting, 10 degrees off the axis: ISO 2720's q, which is printed with two digits."""
    lux, error = pupil_lux(1000.0, 4.0, math.radians(10.0), 20_000)
    exposure = LuminanceExposure(iso=100, f_number=4.0, exposure_s=1.0)
    lux_s = float(signal_from_luminance(1000.0, exposure)) * 78.0 / 100.0
    # 0.65 is rounded to 0.005; a pupil of f/4 bends the cosines by 1.5 %.
    assert 0.9 * 0.98 * lux == pytest.approx(lux_s, rel=0.005 / 0.65 + 0.015, abs=5 * error)


def test_a_metered_scene_has_the_same_signal_at_every_exposure() -> None:
    """A meter of constant K sets ``L t S / N^2 = K``; with K = 12.5 that is 0.65 x 12.5 / 78 of saturation."""
    for iso, f_number, luminance in ((100, 16.0, 3200.0), (400, 5.6, 80.0), (3200, 1.4, 0.5)):
        time_s = 12.5 * f_number**2 / (luminance * iso)
        signal = float(signal_from_luminance(luminance, LuminanceExposure(iso, f_number, time_s)))
        assert signal == pytest.approx(0.65 * 12.5 / 78.0, rel=1e-12)
    # Sunny 16: f/16 at 1/100 s and ISO 100 is the exposure of a mean luminance of 3,200 cd/m^2.
    assert float(signal_from_luminance(3200.0, SUNNY_16)) == pytest.approx(0.104, abs=5e-4)


def test_an_overcast_horizon_is_in_range_at_its_usual_exposure() -> None:
    # 2,000 to 10,000 cd/m^2 (the horizon of an overcast day) at one stop and a half over sunny 16.
    exposure = {"iso": 100, "f_number": 9.5, "exposure_s": 0.01}
    low, high = (airlight_from_luminance(value, **exposure) for value in (2000.0, 9000.0))
    assert 0.15 < low < high < 1.0


def test_there_and_back() -> None:
    signal = torch.linspace(0, 1, 7, dtype=torch.float64).reshape(7, 1)
    back = signal_from_luminance(luminance_from_signal(signal, SUNNY_16), SUNNY_16)
    torch.testing.assert_close(back, signal, rtol=1e-14, atol=0)
    doubled = LuminanceExposure(iso=200, f_number=16, exposure_s=0.01)
    assert doubled.saturation_cd_per_m2 == pytest.approx(SUNNY_16.saturation_cd_per_m2 / 2)
    luminance = torch.tensor(100.0, dtype=torch.float64, requires_grad=True)
    signal_from_luminance(luminance, SUNNY_16).backward()
    assert float(luminance.grad) == pytest.approx(1 / SUNNY_16.saturation_cd_per_m2)


def test_fog_takes_a_luminance_as_it_takes_its_number(tmp_path: Path) -> None:
    values = {"luminance_cd_per_m2": 4000.0, "iso": 100, "f_number": 8.0, "exposure_s": 0.005}
    number = airlight_from_luminance(**values)
    frame = torch.rand(1, 24, 32, generator=torch.Generator().manual_seed(1))
    made = [
        tw.BayerWeather(weather, CAMERA, depth=30.0, airlight=one)
        for weather in (tw.Fog(mor_m=60), tw.Rain(25.0))
        for one in (number, values)
    ]
    for first, second in (made[:2], made[2:]):
        assert torch.equal(first(frame, seed=1), second(frame, seed=1))
    fog = tw.BayerFog(tw.Fog(mor_m=60), CAMERA, depth=30.0, airlight=values)
    save_recipe(fog, tmp_path / "luminance.yaml", title="fog of a measured luminance")
    again = load_recipe(str(tmp_path / "luminance.yaml"))
    assert torch.equal(again(frame), fog(frame))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"iso": 0.0}, "iso"),
        ({"f_number": math.nan}, "f_number"),
        ({"exposure_s": -1.0}, "exposure_s"),
        ({"lens_factor": 2.0}, "lens_factor"),
        ({"luminance_cd_per_m2": -5.0}, "luminance_cd_per_m2"),
        ({"luminance_cd_per_m2": 1e6}, "exposure_s=7.68e-05 or less"),
    ],
)
def test_values_outside_their_range_are_refused(change: dict[str, float], said: str) -> None:
    values = {"luminance_cd_per_m2": 4000.0, "iso": 100.0, "f_number": 8.0, "exposure_s": 0.005}
    with pytest.raises(TorchweatherError, match=said):
        airlight_from_luminance(**{**values, **change})


def test_wrong_keys_and_signals_are_refused() -> None:
    with pytest.raises(TorchweatherError, match="luminance_cd_per_m2, iso, f_number, exposure_s"):
        airlight_argument({"luminance": 4000.0}, "fog")
    with pytest.raises(TorchweatherError, match="signal"):
        luminance_from_signal(1.2, SUNNY_16)
