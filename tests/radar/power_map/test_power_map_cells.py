"""Weather in the cells of a radar power map: closed forms, and a reference that adds them as fields."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from scipy import stats
from torch import Tensor

from torchweather import Fog, Mixture, Radar, Rain, Snow
from torchweather.physics import (
    marshall_palmer,
    rain_attenuation_db_per_km,
    received_power_dbm,
    thermal_noise_dbm,
    volume_reflectivity_m2_per_m3,
)
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import (
    MapAxes,
    MapClutter,
    PowerScale,
    oversampled_taps,
)

LINEAR = PowerScale("linear")
RATE = 40.0
BEAM = Radar(
    transmit_power_dbm=10.0,
    antenna_gain_dbi=30.0,
    azimuth_beamwidth_deg=2.0,
    elevation_beamwidth_deg=4.0,
    noise_figure_db=12.0,
    bandwidth_mhz=300.0,
    samples=256,
    sample_rate_mhz=1.0,
    chirp_period_us=500.0,
    chirps=1,
)
BIN_M = BEAM.range_resolution_m


def turn(azimuths: int = 400, bins: int = 100, dims: tuple[str, ...] = ("azimuth", "range")) -> MapAxes:
    return MapAxes.of_turn(bins=bins, bin_m=BIN_M, azimuths=azimuths, dims=dims)


def exponential(*shape: int, seed: int = 0) -> Tensor:
    return -torch.log1p(-torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)).float()


def in_weather(values: Tensor, axes: MapAxes, weather: Any = None, seed: int = 1, **options: Any) -> Tensor:
    given = {"scale": LINEAR, "noise_floor_db": 0.0, **options}
    transform = RadarMapWeather(Rain(RATE) if weather is None else weather, BEAM, axes=axes, **given)
    found: Tensor = transform(values, transform.draw(values, seed=seed))
    return found


# ---- a point target ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("range_bin", [10, 50, 99])
def test_a_point_target_loses_twice_the_attenuation_over_its_range(range_bin: int) -> None:
    axes, echo = turn(4000), 1e5
    values = torch.full(axes.shape, 1.0)
    values[:, range_bin] = echo
    out = in_weather(values, axes, clutter=False)[:, range_bin].double()
    gamma = float(rain_attenuation_db_per_km(RATE))
    kept = 10 ** (-0.2 * gamma * axes.range_m[range_bin] / 1000.0)
    # z' = sqrt(L) z + sqrt(1 - L) w: mean L P + 1 - L, variance 2 L (1 - L) P + (1 - L)^2.
    expected, variance = kept * echo + 1.0 - kept, 2.0 * kept * (1.0 - kept) * echo + (1.0 - kept) ** 2
    assert float(out.mean()) == pytest.approx(expected, abs=5.0 * math.sqrt(variance / len(out)) + 1e-5 * echo)
    assert float(out.var()) == pytest.approx(variance, rel=5.0 * math.sqrt(2.0 / len(out)))


def test_bytes_lose_less_than_a_step_in_the_mean() -> None:
    axes = turn(8000, bins=30)
    values = torch.full(axes.shape, 180, dtype=torch.uint8)
    out = in_weather(values, axes, scale=PowerScale.steps(0.5), noise_floor_db=0.0, clutter=False)
    loss_db = 0.5 * (180.0 - out.double().mean(0))
    gamma = float(rain_attenuation_db_per_km(RATE))
    expected = 2e-3 * gamma * axes.axis("range")
    # Whole steps of 0.5 dB over a level drawn evenly: at most a quarter of a step a cell.
    assert float(expected[0]) < 0.02
    assert float((loss_db - expected).abs().max()) < 5.0 * 0.25 / math.sqrt(8000)


def test_a_wet_cover_weakens_all_ranges_alike_and_leaves_the_floor() -> None:
    axes = turn(2000, bins=40)
    values = exponential(*axes.shape)
    values[:, 20] = 1e6
    covered = in_weather(values, axes, radome_film_db=2.0, clutter=False)
    film_db = 2.0 * RATE ** (1.0 / 3.0)
    kept = 10 ** (-0.1 * (film_db + 2e-3 * float(rain_attenuation_db_per_km(RATE)) * axes.range_m[20]))
    assert float(covered[:, 20].double().mean()) == pytest.approx(kept * 1e6, rel=1e-3)
    floor = torch.cat([covered[:, :18], covered[:, 23:]], 1)
    cells = floor.numel() / 3  # neighbours share noise
    assert float(floor.double().mean()) == pytest.approx(1.0, abs=5.0 / math.sqrt(cells))


# ---- the floor -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cover_db", [1.0, 10.0, 40.0])
def test_the_noise_floor_keeps_its_mean_and_its_law(cover_db: float) -> None:
    axes = turn(400, bins=200)
    values = exponential(*axes.shape)
    out = in_weather(values, axes, radome_loss_db=cover_db, clutter=False, oversampling=0.0).flatten()
    assert float(out.double().mean()) == pytest.approx(1.0, abs=5.0 / math.sqrt(out.numel()))
    assert stats.kstest(out.numpy(), "expon").pvalue > 1e-3
    share = float(torch.corrcoef(torch.stack([out, values.flatten()]))[0, 1])
    # Its part sqrt(L) of the amplitude is the noise that was there: correlation L of the powers.
    gain = RadarMapWeather(Rain(RATE), BEAM, axes=axes, scale=LINEAR, noise_floor_db=0.0, radome_loss_db=cover_db)
    loss_db = gain.run(values).attenuation_db.expand(values.shape)
    assert share == pytest.approx(float((10 ** (-0.1 * loss_db)).mean()), abs=5.0 / math.sqrt(out.numel()))


@pytest.mark.parametrize("looks", [1, 2, 5])
def test_the_floor_of_several_looks_keeps_its_law(looks: int) -> None:
    axes = turn(200, bins=200)
    values = torch.stack([exponential(*axes.shape, seed=k) for k in range(looks)]).mean(0)
    out = in_weather(values, axes, looks=looks, radome_loss_db=6.0, clutter=False, oversampling=0.0).flatten()
    law = stats.gamma(looks, scale=1.0 / looks)
    assert stats.kstest(out.numpy(), law.cdf).pvalue > 1e-3


@pytest.mark.parametrize("cover_db", [2.0, 60.0])
def test_the_floor_of_bytes_keeps_its_histogram(cover_db: float) -> None:
    axes = turn(400, bins=200)
    scale = PowerScale.steps(0.5, bottom_db=0.0)
    values = scale.stored(10.0 * exponential(*axes.shape).log10(), torch.zeros(0, dtype=torch.uint8))
    out = in_weather(values, axes, scale=scale, radome_loss_db=cover_db, clutter=False, oversampling=0.0)
    counts = torch.stack([torch.bincount(one.flatten().long(), minlength=256) for one in (values, out)])
    assert int(counts[0, 0]) > 40_000  # more than half of the noise is cut off
    kept = counts.sum(0) > 20
    assert stats.chi2_contingency(counts[:, kept].numpy()).pvalue > 1e-3


def test_more_noise_of_an_effect_raises_the_floor_by_as_much() -> None:
    axes = turn(400, bins=200)
    values = exponential(*axes.shape)
    louder = [{"effect": "radar.noise_floor", "shift_db": 3.0}]
    out = in_weather(values, axes, Rain(0.0), effects=louder, oversampling=0.0).double()
    assert float(out.mean()) == pytest.approx(10**0.3, rel=5.0 / math.sqrt(out.numel()))


def test_a_floor_for_each_range_bin_stays_where_it_is() -> None:
    axes = turn(2000, bins=40)
    profile = [20.0 * math.log10(1.0 + k) for k in range(40)]
    values = exponential(*axes.shape) * 10 ** (0.1 * torch.tensor(profile))
    out = in_weather(values, axes, noise_floor_db=profile, radome_loss_db=20.0, clutter=False, oversampling=0.0)
    level = out.double().mean(0).log10() * 10.0 - torch.tensor(profile)
    assert float(level.abs().max()) < 5.0 * 4.34 / math.sqrt(2000)


# ---- rain in the cells ---------------------------------------------------------------------------------------------


def clutter_over_noise(range_m: float) -> float:
    """A cell of rain as one target by the radar equation, over thermal noise less the gain of the range transform."""
    eta = float(volume_reflectivity_m2_per_m3(marshall_palmer(RATE)))
    widths = [math.radians(width) / math.sqrt(2.0) for width in (2.0, 4.0)]  # two way
    volume = math.pi / (4.0 * math.log(2.0)) * widths[0] * widths[1] * range_m**2 * BIN_M
    echo = received_power_dbm(
        10.0 * math.log10(eta * volume),
        range_m,
        transmit_power_dbm=10.0,
        antenna_gain_dbi=60.0,
        attenuation_db=2e-3 * float(rain_attenuation_db_per_km(RATE)) * range_m,
    )
    noise = thermal_noise_dbm(1e6, 12.0) - 10.0 * math.log10(256.0)
    return float(10 ** (0.1 * (echo - noise)))


def test_the_clutter_of_each_bin_has_the_mean_of_the_radar_equation() -> None:
    axes = turn(4000, bins=60)
    out = in_weather(torch.zeros(axes.shape), axes, oversampling=0.0).double().mean(0)
    for place in range(2, 60):
        range_m = axes.range_m[place]
        kept = 10 ** (-0.2 * float(rain_attenuation_db_per_km(RATE)) * range_m / 1000.0)
        expected = clutter_over_noise(range_m) + 1.0 - kept
        # 5 standard errors of an exponential law; the table over the rate is within 0.5 %.
        assert float(out[place]) == pytest.approx(expected, rel=5.0 / math.sqrt(4000) + 0.005)


@pytest.mark.parametrize("looks", [1, 3])
def test_speckle_is_exponential_for_one_look(looks: int) -> None:
    axes = turn(20_000, bins=4)
    out = in_weather(torch.zeros(axes.shape), axes, looks=looks, oversampling=0.0)[:, 3]
    mean = float(out.double().mean())
    law = stats.gamma(looks, scale=mean / looks)
    assert stats.kstest(out.numpy(), law.cdf).pvalue > 1e-3


def test_the_clutter_of_a_compensated_receiver_rises_with_the_square_of_the_range() -> None:
    axes = turn(8, bins=60)
    receiver = Radar(**{**BEAM.to_dict(), "compensated_to_m": 20.0})
    plain, flat = (
        RadarMapWeather(Rain(RATE), one, axes=axes, scale=LINEAR, noise_floor_db=0.0).run(torch.zeros(axes.shape))
        for one in (BEAM, receiver)
    )
    more_db = (flat.clutter_db - plain.clutter_db)[0, 2:].double()
    range_m = axes.axis("range")[2:]
    expected = 40.0 * (range_m / 20.0).clamp(max=1.0).log10()
    assert torch.allclose(more_db, expected, atol=1e-4)


def test_melting_snow_takes_and_returns_more_than_dry() -> None:
    axes = turn(8, bins=60)
    dry, melting = (
        RadarMapWeather(Snow(2.0, melt_fraction=m), BEAM, axes=axes, scale=LINEAR, noise_floor_db=0.0).run(
            torch.zeros(axes.shape)
        )
        for m in (0.0, 0.5)
    )
    assert float(melting.attenuation_db.max()) > 3.0 * float(dry.attenuation_db.max())
    assert float((melting.clutter_db - dry.clutter_db)[0, 2:].min()) > 3.0


def test_fog_takes_and_sends_nothing_back() -> None:
    axes = turn(8, bins=60)
    found = RadarMapWeather(Fog(mor_m=30.0), BEAM, axes=axes, scale=LINEAR, noise_floor_db=0.0)
    result = found.run(torch.ones(axes.shape))
    assert float(result.attenuation_db.max()) > 0
    assert float(result.clutter_db.max()) == -math.inf


def test_the_echoes_of_a_mixture_add() -> None:
    axes, values = turn(8, bins=60), torch.zeros(8, 60)
    parts = [Rain(10.0), Snow(1.0)]
    each = [RadarMapWeather(w, BEAM, axes=axes, scale=LINEAR, noise_floor_db=0.0).run(values) for w in parts]
    both = RadarMapWeather(Mixture(*parts), BEAM, axes=axes, scale=LINEAR, noise_floor_db=0.0).run(values)
    total_db = sum(one.attenuation_db for one in each)
    assert torch.allclose(both.attenuation_db, total_db, rtol=1e-5)
    # Each echo has the loss of the other weather, too.
    power = [10 ** (0.1 * (one.clutter_db - (total_db - one.attenuation_db))[:, 2:]) for one in each]
    assert torch.allclose(10 ** (0.1 * both.clutter_db[:, 2:]), power[0] + power[1], rtol=1e-4)


def test_an_antenna_that_looks_ahead_has_its_pattern_and_one_that_turns_has_none() -> None:
    azimuth = tuple(math.radians(a) for a in (-60.0, -30.0, 0.0, 30.0, 60.0))
    axes = MapAxes(("range", "azimuth"), tuple(0.25 + 0.5 * k for k in range(40)), azimuth)
    radar = Radar.preset("awr1843-like")
    ahead = RadarMapWeather(Rain(RATE), radar, axes=axes, scale=LINEAR, noise_floor_db=0.0)
    clutter = ahead.run(torch.zeros(axes.shape)).clutter_db[20]
    off = torch.tensor(azimuth)
    expected = 2.0 * (radar.gain_dbi(off, torch.zeros_like(off)) - radar.antenna_gain_dbi)
    assert torch.allclose(clutter - clutter[2], expected, atol=1e-4)
    around = RadarMapWeather(Rain(RATE), BEAM, axes=turn(16), scale=LINEAR, noise_floor_db=0.0)
    level = around.run(torch.zeros(16, 100)).clutter_db
    assert float((level - level[:1])[:, 2:].abs().max()) < 1e-4


# ---- Doppler -------------------------------------------------------------------------------------------------------


def doppler_axes(bins: int = 64, width: float = 0.25) -> MapAxes:
    speeds = tuple(width * (k - bins // 2) for k in range(bins))
    return MapAxes(("doppler", "range", "azimuth"), (5.0, 10.0), (-0.5, 0.0, 0.7), None, speeds)


def test_the_doppler_spectrum_adds_up_and_lies_at_the_speed_of_wind_and_vehicle() -> None:
    axes = doppler_axes()
    stage = MapClutter(Rain(RATE, wind_m_per_s=(2.0, -1.0, 0.0)), BEAM, axes, ego_speed_m_per_s=3.0)
    share = stage.doppler_share(torch.tensor([5.0]), torch.tensor([1.0]))
    assert torch.allclose(share.sum(-1), torch.ones(1, 3, 1), atol=1e-5)
    speed = axes.axis("doppler").float()
    mean = (share * speed).sum(-1)[0, :, 0]
    expected = [(2.0 - 3.0) * math.cos(a) - 1.0 * math.sin(a) for a in (-0.5, 0.0, 0.7)]
    assert mean.tolist() == pytest.approx(expected, abs=0.01)
    spread = ((share * speed.square()).sum(-1)[0, :, 0] - mean.square()).sqrt()
    # Turbulence of 0.5 m/s, a bin of 0.25 m/s, and a fall of 5 m/s over the beam's two-way height.
    beam = math.radians(4.0) / math.sqrt(2.0) / 2.3548
    assert float(spread[1]) == pytest.approx(math.sqrt(0.25 + 0.25**2 / 12.0 + (5.0 * beam) ** 2), rel=0.01)


def test_the_bins_of_the_doppler_axis_share_the_echo_and_the_gain_of_the_chirps() -> None:
    axes = doppler_axes()
    chirping = Radar(**{**BEAM.to_dict(), "chirps": 64})
    flat = MapAxes(("range", "azimuth"), axes.range_m, axes.azimuth_rad)
    options: dict[str, Any] = {"scale": LINEAR, "noise_floor_db": 0.0}
    spread = RadarMapWeather(Rain(RATE), chirping, axes=axes, **options).run(torch.zeros(axes.shape)).clutter_db
    whole = RadarMapWeather(Rain(RATE), chirping, axes=flat, **options).run(torch.zeros(flat.shape)).clutter_db
    total = (10 ** (0.1 * spread)).sum(0)
    assert torch.allclose(total, 64.0 * 10 ** (0.1 * whole), rtol=1e-4)


def test_speeds_beyond_the_axis_fold_back() -> None:
    axes = doppler_axes(bins=16, width=0.5)  # 8 m/s around
    slow, fast = (
        MapClutter(Rain(RATE, wind_m_per_s=(w, 0.0, 0.0)), BEAM, axes).doppler_share(torch.zeros(1), torch.zeros(1))
        for w in (1.0, 33.0)
    )
    assert torch.allclose(slow[0, 1], fast[0, 1], atol=1e-5)


# ---- the reference: fields that add ----------------------------------------------------------------------------------


def test_a_cell_has_the_law_of_the_fields_that_add_in_it() -> None:
    """Echo, noise and rain drawn as complex fields one by one, against what is made of the recorded power alone."""
    count, echo, cover_db = 40_000, 6.0, 5.0
    axes = turn(count, bins=8)
    generator = torch.Generator().manual_seed(3)

    def field(power: float) -> Tensor:
        pair = torch.randn(2, count, generator=generator, dtype=torch.float64) * math.sqrt(0.5 * power)
        return torch.complex(pair[0], pair[1])

    place = 6
    noise = field(1.0)
    recorded = (math.sqrt(echo) + noise).abs().square()
    values = torch.ones(axes.shape)
    values[:, place] = recorded.float()
    out = in_weather(values, axes, radome_loss_db=cover_db, oversampling=0.0, clutter_share=1e-2)[:, place]
    range_m = axes.range_m[place]
    kept = 10 ** (-0.1 * (cover_db + 2e-3 * float(rain_attenuation_db_per_km(RATE)) * range_m))
    rain = 1e-2 * clutter_over_noise(range_m) * 10 ** (-0.1 * cover_db)
    expected = (math.sqrt(kept * echo) + field(1.0) + field(rain)).abs().square()
    assert rain > 0.1
    assert stats.ks_2samp(out.numpy(), expected.numpy()).pvalue > 1e-3


@pytest.mark.parametrize(("oversampling", "powers"), [(1.0, (4.0 / 9.0, 1.0 / 36.0)), (0.0, (0.0, 0.0))])
def test_neighbouring_bins_share_their_noise_as_a_window_has_it(oversampling: float, powers: tuple[float, ...]) -> None:
    axes = turn(400, bins=200)
    out = in_weather(torch.zeros(axes.shape), axes, radome_loss_db=60.0, clutter=False, oversampling=oversampling)
    for lag, expected in enumerate(powers, 1):
        pair = torch.stack([out[:, :-lag].flatten(), out[:, lag:].flatten()])
        assert float(torch.corrcoef(pair)[0, 1]) == pytest.approx(expected, abs=0.02)


def test_the_taps_of_finer_bins_are_the_windows_response() -> None:
    """Against noise that goes through a Hann window and a transform with zeros appended."""
    window = torch.hann_window(64, dtype=torch.float64)
    spectrum = torch.fft.fft(window.square(), n=64 * 2 * 8)  # correlation of the amplitude over 1/16 of a bin
    expected = (spectrum.abs() / spectrum[0].abs())[[0, 8, 16, 24, 32]]
    taps = oversampled_taps(2.0).double()
    found = torch.stack([(taps[lag:] * taps[: len(taps) - lag]).sum().abs() for lag in range(5)])
    # Sidelobes of the response, 31 dB down and more, are left out.
    assert torch.allclose(found, expected, atol=0.015)
