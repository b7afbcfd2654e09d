"""Rain, Fog, Snow and Mixture: intensities, ranges, distributions, plain dictionaries."""

from __future__ import annotations

import copy
import math
import pickle
import re
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
import torch
import yaml

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather, parse_weather, weather_from_dict
from torchweather.core.errors import TorchweatherWarning
from torchweather.physics import Binned, extinction_per_m, rehearse_fog

ALL: list[Weather] = [
    Rain(25.0),
    Rain(torch.tensor([1.0, 2.0]), wind_m_per_s=(1.0, -2.0, 0.5), close_rate=True),
    Snow(1.0, albedo=0.85),
    Snow(1.0, melt_fraction=0.3),
    Fog(50.0, contrast=0.02),
    Fog(math.inf),
    Fog.rehearse(30),
    Fog.advection(80.0),
    Mixture(Rain(10.0), Fog(200.0)),
]


@pytest.mark.parametrize("rate", [-1.0, math.nan, math.inf, 1e5, "25", True, torch.tensor([1.0, -1.0])])
def test_impossible_rates_are_refused(rate: object) -> None:
    for kind in (Rain, Snow):
        with pytest.raises(ValueError, match=rf"{kind.__name__}: rate_mm_per_h must lie in 0\.\.2000 mm/h"):
            kind(rate)  # type: ignore[arg-type]


@pytest.mark.parametrize(("kind", "rate"), [(Rain, 0.01), (Rain, 500.0), (Snow, 0.01), (Snow, 30.0)])
def test_rates_outside_the_fitted_range_warn_and_name_it(kind: type[Rain] | type[Snow], rate: float) -> None:
    low, high = kind.rate_range_mm_per_h
    closed = {"close_rate": True}
    message = re.escape(f"{kind.__name__}: rate_mm_per_h = {rate:g} lies outside {low:g}..{high:g} mm/h")
    with pytest.warns(TorchweatherWarning, match=message):
        kind(rate, **closed)
    with pytest.warns(TorchweatherWarning, match=message):
        kind(torch.tensor([1.0, rate]), **closed)


@pytest.mark.parametrize("law", ["sekhon-srivastava", "gunn-marshall"])
@pytest.mark.parametrize("rate", [10.5, torch.tensor([1.0, 50.0]), (0.5, 20.0)], ids=["number", "batch", "range"])
def test_snow_beyond_its_law_is_refused_with_the_range(law: str, rate: object) -> None:
    """Above 10 mm/h these laws make less snow of more: their extinction falls."""
    with pytest.raises(ValueError, match=r"was fitted to 0\.05\.\.10 mm/h .* Lower the rate, or set close_rate=True"):
        Snow(rate, size_distribution=law)  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore:.*lies outside")
@pytest.mark.parametrize("kind", [Rain, Snow])
def test_more_weather_is_never_thinner(kind: type[Rain] | type[Snow]) -> None:
    """Extinction rises with the rate, for every law and over every rate that is accepted."""
    for law in kind.families:
        for closed in (False, True):
            rates = np.geomspace(0.02, 2000.0, 60)
            if law in kind.not_beyond_fit and not closed:
                rates = np.append(rates[rates < 10.0], 10.0)
            weather = kind(torch.as_tensor(rates), size_distribution=law, close_rate=closed)
            found = extinction_per_m(weather.distribution(), 905.0)
            assert bool((found.diff() > 0).all()), law


def test_no_rain_and_ordinary_rain_do_not_warn() -> None:
    for rate in (0.0, 0, 25, np.float32(25.0), torch.tensor([0.0, 25.0])):
        Rain(rate)  # type: ignore[arg-type]


@pytest.mark.parametrize("mor_m", [0.0, -5.0, math.nan, torch.tensor([10.0, 0.0]), "30"])
def test_impossible_visibilities_are_refused(mor_m: object) -> None:
    with pytest.raises(ValueError, match=r"Fog: mor_m must be above 0 m; got .*infinity is clear air"):
        Fog(mor_m)  # type: ignore[arg-type]


def test_other_wrong_fields_are_refused() -> None:
    with pytest.raises(ValueError, match=r"size_distribution must be one of .*Did you mean 'marshall-palmer'"):
        Rain(1.0, size_distribution="marshal-palmer")
    with pytest.raises(ValueError, match=r"wind_m_per_s must be a sequence of 3 numbers in m/s \(forward, left, up"):
        Rain(1.0, wind_m_per_s=(1.0, 2.0))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="wind_m_per_s"):
        Rain(1.0, wind_m_per_s=(math.nan, 0.0, 0.0))
    with pytest.raises(ValueError, match="temperature_c"):
        Fog(50.0, temperature_c=math.nan)
    with pytest.raises(ValueError, match=r"albedo must lie in 0..1"):
        Snow(1.0, albedo=1.2)
    for fraction in (-0.1, 1.1, math.nan, "wet"):
        with pytest.raises(ValueError, match=r"Snow: melt_fraction must lie in 0\.\.1; got .*dry snow is 0"):
            Snow(1.0, melt_fraction=fraction)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="contrast"):
        Fog(50.0, contrast=0.0)
    with pytest.raises(ValueError, match="one of 10, 20, 30, 50 m; got 15"):
        Fog.rehearse(15)
    with pytest.raises(ValueError, match=r"mor_m must lie in 10..50 m; .*default"):
        Fog(200.0, size_distribution="rehearse")
    with pytest.raises(TypeError, match="unexpected keyword"):
        Rain(rate=3.0)  # type: ignore[call-arg]


def test_a_weather_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        Rain(1.0).rate_mm_per_h = 2.0  # type: ignore[misc]


@pytest.mark.parametrize("weather", ALL, ids=repr)
def test_a_weather_survives_yaml_pickle_and_deepcopy(weather: Weather) -> None:
    written = yaml.safe_dump(weather.to_dict())
    for again in (
        weather_from_dict(yaml.safe_load(written)),
        pickle.loads(pickle.dumps(weather)),
        copy.deepcopy(weather),
    ):
        assert again.to_dict() == weather.to_dict()
        assert type(again) is type(weather)


def test_measured_rain_survives_yaml() -> None:
    measured = Rain(10.0, size_distribution=Binned([0.2, 0.5, 1.0, 3.0], [900.0, 400.0, 20.0]))
    again = weather_from_dict(yaml.safe_load(yaml.safe_dump(measured.to_dict())))
    assert isinstance(again, Rain)
    assert torch.equal(again.distribution().total_per_m3, measured.distribution().total_per_m3)


def test_unknown_fields_of_a_dictionary_are_refused() -> None:
    with pytest.raises(ValueError, match=r"Rain: unknown field 'rate_mm_h'. Did you mean"):
        weather_from_dict({"kind": "rain", "rate_mm_h": 3.0})
    with pytest.raises(ValueError, match=r"weather kind must be one of rain, fog, snow, .*; got 'hail'"):
        weather_from_dict({"kind": "hail"})


def test_a_mixture_is_flat_sorted_and_of_different_kinds() -> None:
    one, other = Mixture(Rain(1.0), Fog(50.0)), Mixture(Fog(50.0), Rain(1.0))
    assert one == other
    assert hash(one) == hash(other)
    assert Mixture(Mixture(Rain(1.0), Fog(50.0)), Snow(0.5)).parts == Mixture(Snow(0.5), Fog(50.0), Rain(1.0)).parts
    with pytest.raises(ValueError, match=r"each kind once; got 2 times rain"):
        Mixture(Rain(1.0), Rain(2.0))
    with pytest.raises(ValueError, match="at least one"):
        Mixture()


@pytest.mark.parametrize(
    ("text", "weather"),
    [
        ("rain:rate=25", Rain(25.0)),
        ("snow:rate=1,albedo=0.85", Snow(1.0, albedo=0.85)),
        ("snow:rate=1,melt_fraction=0.3", Snow(1.0, melt_fraction=0.3)),
        ("fog:mor=30", Fog(30.0)),
        ("fog:mor=inf", Fog(math.inf)),
        ("fog:mor=30 + rain:rate=5,close_rate=true", Mixture(Rain(5.0, close_rate=True), Fog(30.0))),
    ],
)
def test_the_command_lines_short_form(text: str, weather: Weather) -> None:
    assert parse_weather(text) == weather


@pytest.mark.parametrize("text", ["rian:rate=3", "rain:rate", "rain:rate=fast", "rain:speed=3", "", "fog:mor=0", "+"])
def test_unreadable_short_forms_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"must be|must lie|expected key=value|unknown field"):
        parse_weather(text)


def test_closing_the_rate_makes_the_flux_the_rate() -> None:
    # PHYSICS.md 2.2: Marshall-Palmer with measured fall speeds carries 11.6 mm/h at a nominal 10 mm/h.
    open_, closed = Rain(10.0).distribution(), Rain(10.0, close_rate=True).distribution()
    ratio = float(open_.total_per_m3 / closed.total_per_m3)
    assert 1.10 < ratio < 1.20


@pytest.mark.parametrize("mor_m", [7.0, 25.0, 300.0])
@pytest.mark.parametrize("contrast", [0.05, 0.02])
def test_fog_has_the_extinction_of_its_visibility_and_contrast(mor_m: float, contrast: float) -> None:
    fog = Fog(mor_m, contrast=contrast)
    wanted = math.log(1 / contrast) / mor_m
    # The distribution is scaled with a Mie table of its own; PHYSICS.md 7 fixes 550 nm.
    assert float(extinction_per_m(fog.distribution(), 550.0)) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("mor_m", [10, 20, 30, 50])
def test_rehearse_fogs_are_the_measured_ones_unscaled(mor_m: int) -> None:
    ours, measured = Fog.rehearse(mor_m).distribution(), rehearse_fog(mor_m)
    assert float(ours.total_per_m3) == pytest.approx(float(measured.total_per_m3), rel=1e-12)
    assert float(extinction_per_m(ours, 530.0)) == pytest.approx(float(extinction_per_m(measured, 530.0)), rel=1e-12)


def test_flakes_are_larger_than_their_melted_drops() -> None:
    diameter_mm = torch.tensor([0.1, 1.0, 3.0])
    assert bool((Snow(1.0).physical_diameter_mm(diameter_mm) > diameter_mm).all())
    assert torch.equal(Rain(1.0).physical_diameter_mm(diameter_mm), diameter_mm)


def test_snow_is_dry_unless_told_and_melting_leaves_sizes_and_speeds() -> None:
    assert Snow(1.0).melt_fraction == 0.0
    assert weather_from_dict({"kind": "snow", "rate_mm_per_h": 1.0}) == Snow(1.0)
    dry, wet = Snow(1.0), Snow(1.0, melt_fraction=0.3)
    assert wet != dry
    assert weather_from_dict(wet.to_dict()) == wet
    diameter_mm = torch.tensor([0.1, 1.0, 3.0])
    assert torch.equal(
        wet.distribution().number_density_per_m3_mm(diameter_mm),
        dry.distribution().number_density_per_m3_mm(diameter_mm),
    )
    assert torch.equal(wet.fall_speed_m_per_s(diameter_mm), dry.fall_speed_m_per_s(diameter_mm))
