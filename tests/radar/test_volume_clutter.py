"""The echo of rain and snow themselves: how many cells, where, how strong and how fast, against own integrals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.stats import kstest
from torch import Tensor

from tests.oracles import load
from torchweather.atmosphere.weather import Fog, Rain, Snow
from torchweather.physics import received_power_dbm, reflectivity_weighted_fall_speed
from torchweather.radar.clutter import (
    FallingReflectivity,
    cell_volume_m3,
    radial_speed_m_per_s,
    two_way_widths_rad,
)
from torchweather.sensors import Radar
from torchweather.stages import RadarState, Stage, VolumeClutter

# Four elements in a row; range bins of 0.5 m to 32 m, Doppler bins of 0.6 m/s; some 300 cells of heavy rain are seen.
RADAR = Radar(
    bandwidth_mhz=300.0,
    samples=64,
    chirps=64,
    rx_half_wavelengths=((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)),
    noise_figure_db=20.0,
)
RAIN = Rain(25.0)
BATCH = 64
# Every one of the 300 is listed: at most 0.8 of the rows are (`VolumeClutter`); `rows_of` looks whether one is left.
CAPACITY = 512
# One seed in a thousand would miss it; the seeds are fixed.
P_VALUE = 1e-3
DB = math.log(10.0) / 10.0
Array = NDArray[np.float64]


def state_of(batch: int = BATCH, sensor: Radar = RADAR, **fields: float) -> RadarState:
    """A list without detections, before the clutter; double precision."""
    none = torch.zeros(batch, 0, dtype=torch.float64)
    values = {"attenuation_db_per_km": 0.0, "cover_loss_db": 0.0, "noise_floor_db": sensor.floor_db, **fields}
    return RadarState.of(
        points_in=torch.zeros(batch, 0, 6, dtype=torch.float64),
        range_m=none,
        gain_db=none,
        kind=none.to(torch.int8),
        detection_snr_db=torch.tensor(sensor.detection_snr_db, dtype=torch.float64),
        **{name: torch.full((batch,), value, dtype=torch.float64) for name, value in values.items()},
    )


def after(stage: VolumeClutter, state: RadarState | None = None, seed: int = 1) -> tuple[Tensor, Tensor]:
    """Rows ``(B, K, 6)`` and which of them are there."""
    state = state_of() if state is None else state
    found = stage(state, stage.draw(state, seed=seed))
    assert found.returns.clutter is not None
    assert found.returns.clutter_valid is not None
    return found.returns.clutter, found.returns.clutter_valid


def rows_of(stage: VolumeClutter, state: RadarState | None = None, seed: int = 1) -> Array:
    """The detections of all samples, ``(n, 6)``."""
    clutter, there = after(stage, state, seed)
    assert not bool(there[:, -1].any()), "the capacity was reached: what is tested is a part"
    rows: Array = clutter[there].numpy()
    return rows


def polar(rows: Array) -> tuple[Array, Array, Array]:
    """Range, azimuth, elevation."""
    range_m = np.linalg.norm(rows[:, :3], axis=1)
    return range_m, np.arctan2(rows[:, 1], rows[:, 0]), np.arcsin(rows[:, 2] / range_m)


# The model by hand: PHYSICS.md 6.2 and 6.5 for the reflectivity of the oracle, in watts and metres.


def pattern(radar: Radar, azimuth: Array, elevation: Array) -> Array:
    """Two-way gain of an element over its peak."""
    widths = np.deg2rad([radar.azimuth_beamwidth_deg, radar.elevation_beamwidth_deg])
    out: Array = np.exp(-8.0 * math.log(2.0) * ((azimuth / widths[0]) ** 2 + (elevation / widths[1]) ** 2))
    return out


def widths_rad(radar: Radar) -> tuple[float, float]:
    """Two-way half-power widths of a row of four elements half a wavelength apart in azimuth."""
    elements = [math.radians(w) for w in (radar.azimuth_beamwidth_deg, radar.elevation_beamwidth_deg)]
    array = 0.886 * 2.0 / 4.0
    return (2.0 / elements[0] ** 2 + 1.0 / array**2) ** -0.5, elements[1] / math.sqrt(2.0)


def doppler_bins(radar: Radar, fall: float, fall_std: float, turbulence: float = 0.5) -> float:
    """Bins under a Gaussian spectrum's equivalent width, at half the elevation width, for a beam as wide as it is."""
    tilt = math.sin(math.radians(radar.elevation_beamwidth_deg) / 2.0)
    beam_std = widths_rad(radar)[1] / 2.354820
    std = math.hypot(turbulence, fall_std * tilt, fall * beam_std)
    wavelength = 0.299792458 / radar.frequency_ghz
    bin_m_per_s = wavelength / (2.0 * radar.chirps * radar.transmitters * radar.chirp_period_us * 1e-6)
    return max(1.0, math.sqrt(2.0 * math.pi) * std / bin_m_per_s)


def mean_power_mw(
    range_m: Array, radar: Radar, eta: float, falling: tuple[float, float], db_per_km: float = 0.0
) -> Array:
    """Of one cell at the peak of the pattern: radar equation of ``eta V`` over the Doppler bins."""
    theta, phi = widths_rad(radar)
    volume = math.pi / (4.0 * math.log(2.0)) * theta * phi * range_m**2 * 299792458.0 / (2e6 * radar.bandwidth_mhz)
    wavelength = 0.299792458 / radar.frequency_ghz
    link = 10.0 ** ((radar.transmit_power_dbm + 2.0 * radar.antenna_gain_dbi) / 10.0) * wavelength**2
    lost = 10.0 ** (-2.0 * db_per_km * range_m / 1e3 / 10.0)
    out: Array = link * eta * volume / doppler_bins(radar, *falling) / ((4.0 * math.pi) ** 3 * range_m**4) * lost
    return out


def physics_of(weather: Rain | Snow, frequency_ghz: float = 77.0) -> tuple[float, float, float]:
    """eta, mean fall speed, its standard deviation, without the table."""
    eta, mean, std = reflectivity_weighted_fall_speed(weather.distribution(), frequency_ghz, weather.temperature_c)
    return float(eta), float(mean), float(std)


def threshold_mw(radar: Radar) -> float:
    """k T0 F fs over the samples, chirps and channels that are summed, times the detection SNR."""
    noise = 1.380649e-23 * 290.0 * 1e3 * radar.sample_rate_mhz * 1e6 * 10.0 ** (radar.noise_figure_db / 10.0)
    out: float = noise / (radar.samples * radar.chirps * 4.0) * 10.0 ** (radar.detection_snr_db / 10.0)
    return out


def expected_per_m(range_m: Array, radar: Radar, db_per_km: float = 0.0, near_m: float = 1.0) -> Array:
    """Cells above the threshold per metre: cells in the view, each with the chance of its exponential law."""
    eta, *falling = physics_of(RAIN)
    theta, phi = widths_rad(radar)
    view = [2.0 * math.radians(w) for w in (radar.azimuth_beamwidth_deg, radar.elevation_beamwidth_deg)]
    cells = view[0] * view[1] / (math.pi / (4.0 * math.log(2.0)) * theta * phi) * doppler_bins(radar, *falling)
    side = (np.arange(80) + 0.5) / 80 - 0.5
    gain = pattern(radar, side[:, None] * view[0], side[None] * view[1]).reshape(1, -1)
    mean = mean_power_mw(range_m, radar, eta, (falling[0], falling[1]), db_per_km)[:, None] * gain
    chance = np.exp(-threshold_mw(radar) / mean).mean(1)
    out: Array = np.where(range_m >= near_m, cells * chance / (299792458.0 / (2e6 * radar.bandwidth_mhz)), 0.0)
    return out


def expected_law(radar: Radar, db_per_km: float = 0.0) -> tuple[float, Any]:
    """Expected number, and the distribution function of the ranges."""
    range_m = np.linspace(1.0, radar.max_range_m, 3001)
    per_m = expected_per_m(range_m, radar, db_per_km)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (per_m[1:] + per_m[:-1]) * np.diff(range_m))])
    return float(below[-1]), lambda r: np.interp(r, range_m, below / below[-1])


# ---- cell -------------------------------------------------------------------------------------------------------


def test_a_cell_of_heavy_rain_has_the_cross_section_of_the_worked_example() -> None:
    """PHYSICS.md 6.5: beams of 5 x 5 degrees, 20 m, cells of 0.2 m, 25 mm/h: about -34 dBsm."""
    radar = Radar(azimuth_beamwidth_deg=5.0, elevation_beamwidth_deg=5.0, bandwidth_mhz=299.792458 / 0.4)
    volume = float(cell_volume_m3(torch.tensor(20.0, dtype=torch.float64), radar))
    assert volume == pytest.approx(math.pi / (8.0 * math.log(2.0)) * math.radians(5.0) ** 2 * 400.0 * 0.2, rel=1e-6)
    eta = float(FallingReflectivity(RAIN, 77.0)(1)[0])
    assert 10.0 * math.log10(eta * volume) == pytest.approx(-34.0, abs=0.5)
    twice = float(cell_volume_m3(torch.tensor(40.0, dtype=torch.float64), radar))
    assert twice == pytest.approx(4.0 * volume, rel=1e-6)


@pytest.mark.parametrize("name", ["imaging-77ghz", "awr1843-like"])
def test_beam_widths_are_those_of_the_pattern(name: str) -> None:
    """|array factor|^2 times the element twice, halved where it is half; Gaussians for both are good to 4 %."""
    radar = Radar.preset(name)
    angle = torch.linspace(0.0, 1.0, 20001, dtype=torch.float64)
    for axis, width_deg in enumerate((radar.azimuth_beamwidth_deg, radar.elevation_beamwidth_deg)):
        places = torch.tensor(sorted(set(radar.virtual_half_wavelengths[:, axis].tolist())))
        array = torch.exp(1j * math.pi * places[:, None] * torch.sin(angle)).mean(0).abs().square()
        product = array * torch.exp(-8.0 * math.log(2.0) * (angle / math.radians(width_deg)) ** 2)
        half = 2.0 * float(angle[int((product < 0.5).nonzero()[0])])
        assert two_way_widths_rad(radar)[axis] == pytest.approx(half, rel=0.04)


@pytest.mark.parametrize("rate", ["1", "10", "50"])
def test_reflectivity_is_the_oracles(rate: str) -> None:
    """The table's 0.5 % on top of the oracle's own tolerance of 0.2 %."""
    wanted = load("rain_radar_mie_marshall_palmer")["rows"]["77"]["10"][rate]["eta_m2_m3"]
    assert float(FallingReflectivity(Rain(float(rate)), 77.0)(1)[0]) == pytest.approx(wanted, rel=0.007)


@pytest.mark.parametrize("frequency_ghz", [24.0, 77.0])
@pytest.mark.parametrize("weather", [Rain(0.0), Snow(0.0), Snow(0.0, melt_fraction=0.4)], ids=["rain", "dry", "wet"])
def test_the_table_is_within_half_a_percent_of_the_function(weather: Rain | Snow, frequency_ghz: float) -> None:
    rates = torch.exp(torch.linspace(math.log(1e-3), math.log(300.0), 500, dtype=torch.float64))
    melted = weather.melt_fraction if isinstance(weather, Snow) else 0.0
    wanted = reflectivity_weighted_fall_speed(
        weather.distribution(rates), frequency_ghz, weather.temperature_c, melt_fraction=melted
    )
    got = FallingReflectivity(weather, frequency_ghz).table(rates)
    assert float((got / torch.stack(wanted, -1) - 1.0).abs().max()) < 0.005


# ---- how many, where, how strong --------------------------------------------------------------------------------


@pytest.mark.parametrize("db_per_km", [0.0, 100.0])
def test_number_and_ranges_follow_the_integral(db_per_km: float) -> None:
    """Poisson over 64 frames, some 10,000 detections: four standard deviations; ranges by Kolmogorov-Smirnov."""
    stage = VolumeClutter(RAIN, RADAR, capacity=CAPACITY)
    rows = rows_of(stage, state_of(attenuation_db_per_km=db_per_km))
    number, law = expected_law(RADAR, db_per_km)
    assert number * BATCH > 5000
    # 0.5 % of reflectivity moves the number by less than that.
    assert len(rows) == pytest.approx(number * BATCH, abs=4.0 * math.sqrt(number * BATCH) + 0.005 * number * BATCH)
    assert kstest(polar(rows)[0], law).pvalue > P_VALUE


def test_the_number_differs_from_frame_to_frame_as_poisson_says() -> None:
    """Variance over mean is 1; of 64 frames its standard deviation is sqrt(2 / 63) = 0.18."""
    _, there = after(VolumeClutter(RAIN, RADAR, capacity=CAPACITY))
    count = there.sum(1).double()
    assert float(count.var() / count.mean()) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 63))


def test_powers_above_the_threshold_are_exponential_about_the_mean_of_the_cell() -> None:
    """(p - T) / P(R, direction) has the law exp(-x): the radar equation, pattern and path of each row by hand."""
    db_per_km, cover_db = 60.0, 1.5
    stage = VolumeClutter(RAIN, RADAR, capacity=CAPACITY)
    rows = rows_of(stage, state_of(attenuation_db_per_km=db_per_km, cover_loss_db=cover_db))
    eta, *falling = physics_of(RAIN)
    range_m, azimuth, elevation = polar(rows)
    mean = mean_power_mw(range_m, RADAR, eta, (falling[0], falling[1]), db_per_km) * 10.0 ** (-cover_db / 10.0)
    mean *= pattern(RADAR, azimuth, elevation)
    excess = 10.0 ** (rows[:, 4] / 10.0) - threshold_mw(RADAR)
    assert len(rows) > 2000
    assert bool((excess > -1e-9 * threshold_mw(RADAR)).all())
    assert kstest(excess / mean, "expon").pvalue > P_VALUE
    assert float((excess / mean).mean()) == pytest.approx(1.0, abs=4.0 / math.sqrt(len(rows)))


def test_mean_power_falls_with_the_square_of_the_range() -> None:
    """A cell grows as R^2 and its echo falls as R^4: the slope of ln(mean) over ln R is -2.

    Of the excess over the threshold, pattern taken out, in clear air. ln of an exponential variate has a standard
    deviation of pi / sqrt(6).
    """
    rows = rows_of(VolumeClutter(RAIN, RADAR, capacity=CAPACITY))
    range_m, azimuth, elevation = polar(rows)
    threshold = 10.0 ** ((RADAR.floor_db + RADAR.detection_snr_db) / 10.0)
    excess = (10.0 ** (rows[:, 4] / 10.0) - threshold) / pattern(RADAR, azimuth, elevation)
    x = np.log(range_m) - np.log(range_m).mean()
    slope = float((x * np.log(excess)).sum() / (x * x).sum())
    assert slope == pytest.approx(-2.0, abs=4.0 * math.pi / math.sqrt(6.0) / math.sqrt(float((x * x).sum())))


def test_the_cross_section_column_gives_the_power_back_by_the_radar_equation() -> None:
    rows = rows_of(VolumeClutter(RAIN, RADAR, capacity=CAPACITY))
    range_m, azimuth, elevation = polar(rows)
    power = received_power_dbm(
        torch.from_numpy(rows[:, 5]),
        torch.from_numpy(range_m),
        transmit_power_dbm=RADAR.transmit_power_dbm,
        antenna_gain_dbi=2.0 * RADAR.antenna_gain_dbi,
    )
    off_db = 10.0 * np.log10(pattern(RADAR, azimuth, elevation))
    assert np.allclose(power.numpy() + off_db, rows[:, 4], atol=1e-5)


def test_directions_lie_in_the_view_and_are_even_about_boresight() -> None:
    rows = rows_of(VolumeClutter(RAIN, RADAR, capacity=CAPACITY))
    _, azimuth, elevation = polar(rows)
    assert float(np.abs(azimuth).max()) <= math.radians(65.0)
    assert float(np.abs(elevation).max()) <= math.radians(25.0)
    for angle in (azimuth, elevation):
        assert abs(float(angle.mean())) < 4.0 * float(angle.std()) / math.sqrt(len(angle))
    assert math.degrees(float(azimuth.std())) > 10.0


def test_nothing_nearer_than_near_nor_farther_than_the_sampling_reaches() -> None:
    rows = rows_of(VolumeClutter(RAIN, RADAR, capacity=CAPACITY, near_m=4.0))
    range_m, _, _ = polar(rows)
    assert float(range_m.min()) >= 4.0 - 1e-6
    assert float(range_m.max()) <= RADAR.max_range_m + 1e-6


def test_where_cells_abound_a_random_share_of_them_is_listed() -> None:
    """64 rows for several hundred cells: 0.8 of the rows, their ranges as of all of them."""
    radar = replace(RADAR, noise_figure_db=10.0)
    clutter, there = after(VolumeClutter(RAIN, radar, capacity=64), state_of(256, radar))
    rows = clutter[there].numpy()
    number, law = expected_law(radar)
    assert number > 300
    wanted = 256 * 0.8 * 64
    # Poisson, and one frame in thirty would hold more than 64 and is cut by a few rows.
    assert len(rows) == pytest.approx(wanted, abs=4.0 * math.sqrt(wanted) + 0.01 * wanted)
    assert kstest(polar(rows)[0], law).pvalue > P_VALUE


def test_a_share_of_the_reflectivity_acts_as_less_reflectivity() -> None:
    """Half the drops' cross section: as 3 dB less power transmitted, for the clutter."""
    half = after(VolumeClutter(RAIN, RADAR, share=0.5, capacity=CAPACITY))
    quiet = replace(RADAR, transmit_power_dbm=RADAR.transmit_power_dbm - 10.0 * math.log10(2.0))
    weak = after(VolumeClutter(RAIN, quiet, capacity=CAPACITY))
    assert torch.equal(half[1], weak[1])
    # The same power; the cross section column tells the two apart.
    assert torch.allclose(half[0][..., :5], weak[0][..., :5], rtol=1e-5, atol=1e-5)
    assert int(half[1].sum()) < int(after(VolumeClutter(RAIN, RADAR, capacity=CAPACITY))[1].sum())


def test_dry_snow_is_seen_far_less_than_rain() -> None:
    """1e-2.5 of the reflectivity at 77 GHz and 1 mm/h (PHYSICS.md 6.5, 6.7)."""
    clutter = [VolumeClutter(weather, RADAR, capacity=CAPACITY) for weather in (Snow(1.0), Rain(1.0))]
    counts = [int(after(one)[1].sum()) for one in clutter]
    assert 0 < 20 * counts[0] < counts[1]


# ---- how fast ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weather", [Rain(25.0), Snow(2.0)], ids=["rain", "snow"])
def test_drops_fall_towards_a_radar_that_looks_up_and_away_from_one_that_looks_down(weather: Rain | Snow) -> None:
    """Mean and spread of 100,000 cells; the standard errors are std / sqrt(n) and std / sqrt(2 n)."""
    _, fall, fall_std = physics_of(weather)
    number, turbulence = 100_000, 0.3
    noise = torch.randn(1, number, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    for up in (1.0, -1.0, 0.0, 0.5):
        direction = torch.tensor([math.sqrt(1.0 - up**2), 0.0, up], dtype=torch.float64).expand(1, number, 3)
        mean, spread = (torch.tensor([value], dtype=torch.float64) for value in (fall, fall_std))
        speed = radial_speed_m_per_s(direction, weather, mean, spread, noise, turbulence)
        std = math.hypot(turbulence, fall_std * up)
        assert float(speed.mean()) == pytest.approx(-up * fall, abs=4.0 * std / math.sqrt(number))
        assert float(speed.std()) == pytest.approx(std, rel=4.0 / math.sqrt(2.0 * number))


@pytest.mark.parametrize("ego", [0.0, 15.0])
@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (-6.0, 4.0, 1.0)], ids=str)
def test_speed_is_wind_fall_and_own_motion_with_the_spread_of_the_spectrum(
    ego: float, wind: tuple[float, float, float]
) -> None:
    """Each row's speed less its mean by hand, over its spread by hand, is a standard normal; receding is positive."""
    weather = Rain(25.0, wind_m_per_s=wind)
    stage = VolumeClutter(weather, RADAR, capacity=CAPACITY, ego_speed_m_per_s=ego, turbulence_m_per_s=0.4)
    rows = rows_of(stage)
    _, fall, fall_std = physics_of(RAIN)
    way = rows[:, :3] / np.linalg.norm(rows[:, :3], axis=1, keepdims=True)
    mean = way @ (np.array(wind) - np.array([ego, 0.0, 0.0]) - np.array([0.0, 0.0, fall]))
    spread = np.hypot(0.4, fall_std * way[:, 2])
    # As the radar folds it; the spectrum is far narrower than the unambiguous speeds.
    period = 2.0 * RADAR.max_speed_m_per_s
    off = rows[:, 3] - mean
    off -= period * np.round(off / period)
    assert kstest(off / spread, "norm").pvalue > P_VALUE
    assert float(np.abs(rows[:, 3]).max()) <= RADAR.max_speed_m_per_s * (1 + 1e-6)


# ---- what there is not ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [Rain, Snow])
def test_without_rain_every_row_is_empty(make: Any) -> None:
    clutter, there = after(VolumeClutter(make(0.0), RADAR))
    assert not bool(there.any())
    assert bool((clutter == 0).all())
    assert clutter.shape == (BATCH, 64, 6)


def test_at_identity_nothing_is_drawn_nor_appended() -> None:
    stage, state = VolumeClutter(RAIN, RADAR, share=0.0), state_of()
    assert stage.draw(state, seed=1) == {}
    assert stage(state, {}) is state


def test_a_rate_for_each_sample() -> None:
    stage = VolumeClutter(Rain(torch.tensor([0.0, 25.0, 5.0])), RADAR, capacity=2048)
    state = state_of(3)
    noise = stage.draw(state, seed=torch.tensor([1, 2, 3]))
    together = stage(state, noise)
    assert int(together.returns.clutter_valid[0].sum()) == 0
    for row, rate in ((1, 25.0), (2, 5.0)):
        alone = VolumeClutter(Rain(rate), RADAR, capacity=2048)
        single = alone(state_of(1), {key: value[row : row + 1] for key, value in noise.items()})
        assert torch.equal(single.returns.clutter_valid[0], together.returns.clutter_valid[row])
        assert torch.allclose(single.returns.clutter[0], together.returns.clutter[row], rtol=1e-6)


def test_the_gradient_of_the_rate_is_finite_also_where_it_does_not_rain() -> None:
    rate = torch.tensor([0.0, 25.0], requires_grad=True)
    clutter, _ = after(VolumeClutter(Rain(rate), RADAR, capacity=512), state_of(2))
    (gradient,) = torch.autograd.grad(clutter[..., 4].sum(), rate)
    assert bool(torch.isfinite(gradient).all())
    assert gradient[0] == 0.0
    assert gradient[1] != 0.0


def test_rows_of_an_earlier_stage_stay() -> None:
    """Rain and snow at once: both are listed, the first ones first."""
    stages: list[Stage] = [VolumeClutter(RAIN, RADAR, capacity=512), VolumeClutter(Snow(5.0), RADAR, capacity=128)]
    state = state_of(2)
    alone = [stage(state, stage.draw(state, seed=1)) for stage in stages]
    both = stages[1](alone[0], stages[1].draw(state, seed=1))
    assert torch.equal(both.returns.clutter, torch.cat([one.returns.clutter for one in alone], 1))
    assert torch.equal(both.returns.clutter_valid, torch.cat([one.returns.clutter_valid for one in alone], 1))
    assert bool(alone[0].returns.clutter_valid.any())


def test_a_stage_is_rebuilt_from_its_arguments() -> None:
    stage = VolumeClutter(
        Snow(2.0, melt_fraction=0.2), RADAR, 0.7, 100, near_m=2.0, ego_speed_m_per_s=8.0, turbulence_m_per_s=0.1
    )
    again = VolumeClutter(**stage.config())
    assert again.config() == stage.config()
    first, other = after(stage), after(again)
    assert all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"weather": Fog(50.0)}, "weather must be Rain or Snow; got Fog"),
        ({"share": -0.1}, r"share must be 0 or more; got -0\.1"),
        ({"capacity": 0}, r"capacity must lie in 1\.\.100000; got 0"),
        ({"near_m": 0.0}, r"near_m must lie in 0\.1\.\.28.* m; got 0"),
        ({"near_m": 40.0}, "near_m must lie in .* m; got 40"),
        ({"ego_speed_m_per_s": 200.0}, r"ego_speed_m_per_s must lie in -100\.\.100 m/s; got 200"),
        ({"turbulence_m_per_s": -1.0}, "turbulence_m_per_s must lie in .* m/s; got -1"),
    ],
)
def test_arguments_out_of_range_are_refused_with_the_range(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=f"VolumeClutter: {message}"):
        VolumeClutter(**{"weather": RAIN, "sensor": RADAR, **arguments})
