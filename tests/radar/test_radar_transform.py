"""RadarAttenuation: closed forms, lost detections, the result's columns, variants, ``explain``, bad input."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from typing import Any

import pytest
import torch
from scipy.stats import kstest
from torch import Tensor

from tests.oracles import load
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.cli import main
from torchweather.core.errors import TorchweatherWarning
from torchweather.physics import received_power_dbm
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.stages import PointKind
from torchweather.transforms import RadarAttenuation

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
SENSOR = Radar.preset("imaging-77ghz")
THRESHOLD_DB = SENSOR.floor_db + SENSOR.detection_snr_db
WEATHERS: dict[str, Weather] = {
    "rain": Rain(25.0),
    "snow": Snow(1.0, melt_fraction=0.2),
    "fog": Fog(50.0),
    "mixture": Mixture(Rain(5.0), Snow(0.3), Fog(200.0)),
}
every_weather = pytest.mark.parametrize("weather", WEATHERS.values(), ids=WEATHERS.keys())


def target(range_m: float, power_db: float, number: int = 1, dtype: torch.dtype = torch.float64) -> Tensor:
    """The same target in every row, ahead and a little up."""
    row = torch.tensor([0.96 * range_m, 0.0, 0.28 * range_m, -3.0, power_db, 10.0], dtype=dtype)
    return row.expand(number, 6)


def ran(transform: RadarAttenuation, points: Tensor, seed: int = 1) -> Any:
    return transform.run(points, transform.draw(points, seed=seed))


# ---- closed forms -----------------------------------------------------------------------------------------------


def test_the_worked_example_of_the_radar_equation() -> None:
    """PHYSICS.md 6.2: 12 dBm, 13 dBi, 1 m^2, 50 m: -111.13 dBm; heavy rain takes 1.1405 dB there and back."""
    oracle = load("radar_equation")
    power = float(received_power_dbm(0.0, 50.0, transmit_power_dbm=12.0, antenna_gain_dbi=26.0))
    points = torch.tensor([[50.0, 0.0, 0.0, 0.0, power, 0.0]], dtype=torch.float64)
    got = RadarAttenuation(Rain(25.0), Radar())(points)
    assert isinstance(got, Tensor)
    assert float(got[0, 4]) == pytest.approx(oracle["Pr_dBm"] - oracle["two_way_rain25_dB"], abs=1e-5)


@every_weather
def test_power_falls_by_twice_the_attenuation_times_the_range(weather: Weather) -> None:
    transform = RadarAttenuation(weather, SENSOR)
    points = torch.cat([target(range_m, -60.0) for range_m in (1.0, 30.0, 75.0, 300.0)])
    result = ran(transform, points)
    per_km = float(transform.attenuation_db_per_km)
    wanted = torch.tensor([2e-3 * per_km * range_m for range_m in (1.0, 30.0, 75.0, 300.0)], dtype=torch.float64)
    assert per_km > 0.05
    assert torch.allclose(result.attenuation_db, wanted, rtol=1e-6)
    assert torch.allclose(points[:, 4] - result.points[:, 4], wanted, atol=1e-6)
    assert torch.equal(result.points[:, [0, 1, 2, 3, 5]], points[:, [0, 1, 2, 3, 5]])
    assert result.kind.tolist() == [OBJECT] * 4
    assert result.source.tolist() == [0, 1, 2, 3]


def test_attenuations_of_a_mixture_add() -> None:
    parts = [Rain(5.0), Snow(0.3), Fog(200.0)]
    alone = sum(float(RadarAttenuation(part, SENSOR).attenuation_db_per_km) for part in parts)
    together = float(RadarAttenuation(Mixture(*parts), SENSOR).attenuation_db_per_km)
    assert together == pytest.approx(alone, rel=1e-6)


def test_a_wet_radome_costs_all_the_same_and_the_way_comes_on_top() -> None:
    """0.5 dB and 1.2 dB (R / 1 mm/h)^(1/3) at 8 mm/h: 2.9 dB at every range."""
    points = torch.cat([target(range_m, -60.0) for range_m in (2.0, 50.0, 200.0)])
    dry = ran(RadarAttenuation(Rain(8.0), SENSOR), points)
    wet = ran(RadarAttenuation(Rain(8.0), SENSOR, radome_loss_db=0.5, radome_film_db=1.2), points)
    assert (wet.attenuation_db - dry.attenuation_db).tolist() == pytest.approx([2.9] * 3, abs=1e-5)
    assert (dry.points[:, 4] - wet.points[:, 4]).tolist() == pytest.approx([2.9] * 3, abs=1e-5)
    # A film is of rain: snow and fog have none.
    for weather in (Snow(2.0), Fog(50.0)):
        plain, film = (RadarAttenuation(weather, SENSOR, radome_film_db=film_db) for film_db in (0.0, 1.2))
        assert torch.equal(ran(film, points).points, ran(plain, points).points)


def test_the_radome_leaves_rows_without_detection_as_they_are() -> None:
    points = torch.tensor([[0.0, -0.0, 0.0, 1.0, -50.0, 3.0], [9.0, 0.0, 0.0, 1.0, -50.0, 3.0]])
    result = ran(RadarAttenuation(Rain(8.0), SENSOR, radome_loss_db=2.0), points)
    assert torch.equal(result.points[0], points[0])
    assert float(result.attenuation_db[0]) == 0.0
    assert float(result.attenuation_db[1]) > 2.0


# ---- lost -------------------------------------------------------------------------------------------------------


@every_weather
def test_a_detection_is_lost_where_its_power_falls_below_the_threshold(weather: Weather) -> None:
    transform = RadarAttenuation(weather, SENSOR)
    loss = 2e-3 * float(transform.attenuation_db_per_km) * 100.0
    points = torch.cat([target(100.0, THRESHOLD_DB + loss + excess) for excess in (0.01, -0.01)])
    result = ran(transform, points)
    assert result.kind.tolist() == [OBJECT, LOST]
    assert result.points[1].tolist() == pytest.approx([0.0, 0.0, 0.0, -3.0, THRESHOLD_DB - 0.01, 10.0], abs=1e-4)
    assert float(result.snr_db[1]) == pytest.approx(SENSOR.detection_snr_db - 0.01, abs=1e-4)


@pytest.mark.parametrize("margin_db", [1.0, 3.0])
def test_a_point_below_the_threshold_is_lost_by_the_law_of_its_margin(margin_db: float) -> None:
    """P(lost) = 1 - exp(-2 gamma R / margin), in dB; binomial over 40,000 rows, four standard deviations."""
    number, range_m = 40_000, 80.0
    transform = RadarAttenuation(Rain(25.0), replace(SENSOR, margin_db=margin_db))
    with pytest.warns(TorchweatherWarning, match="noise_floor_db"):
        result = ran(transform, target(range_m, -180.0, number))
    lost = 1.0 - math.exp(-2e-3 * float(transform.attenuation_db_per_km) * range_m / margin_db)
    tolerance = 4.0 * math.sqrt(lost * (1.0 - lost) / number)
    assert float((result.kind == LOST).float().mean()) == pytest.approx(lost, abs=tolerance)
    # What is left of the margin is exponential again: it has no memory.
    left = result.snr_db[result.kind == OBJECT] - SENSOR.detection_snr_db
    assert kstest(left.numpy(), "expon", args=(0.0, margin_db)).pvalue > 1e-3
    assert int(result.floored_points) == number


def test_the_share_that_is_lost_goes_to_zero_with_the_rate() -> None:
    """All rows stand on the floor: the share is 2 gamma R / margin, smaller the less it rains, without a step."""
    points = target(60.0, -180.0, 20_000)
    shares = []
    for rate in (0.0, 0.1, 1.0, 10.0, 100.0):
        transform = RadarAttenuation(Rain(rate), SENSOR)
        with pytest.warns(TorchweatherWarning, match="noise_floor_db"):
            result = ran(transform, points)
        shares.append(float((result.kind == LOST).float().mean()))
        expected = 1.0 - math.exp(-0.12 * float(transform.attenuation_db_per_km) / SENSOR.margin_db)
        assert shares[-1] == pytest.approx(expected, abs=4.0 * math.sqrt(expected / 20_000))
    assert shares[0] == 0.0
    assert shares[1] < 0.02
    assert shares == sorted(shares)
    assert shares[-1] > 0.5


def test_the_columns_of_a_result_agree() -> None:
    """Power, SNR, attenuation, kind and source of objects, lost ones, empty rows and clutter in one list."""
    points = torch.cat([target(40.0, -100.0), target(40.0, THRESHOLD_DB + 0.1), target(0.0, -30.0)])
    result = ran(RadarAttenuation(Rain(25.0), SENSOR, clutter=True, clutter_points=200), points)
    kind, clutter = result.kind, result.kind == PARTICLE
    assert kind[:3].tolist() == [OBJECT, LOST, LOST]
    assert bool(clutter[3:].any())
    assert not bool((kind[3:] == OBJECT).any())
    assert result.source.tolist() == [0, 1, 2] + [-1] * 200
    power = result.points[:, 4]
    seen = (kind != LOST).nonzero().flatten()
    assert torch.allclose(result.snr_db[seen], power[seen] - SENSOR.floor_db, atol=1e-9)
    assert bool((result.snr_db[seen] >= SENSOR.detection_snr_db - 1e-9).all())
    assert torch.allclose(power[:2], points[:2, 4] - result.attenuation_db[:2], atol=1e-9)
    assert float(result.snr_db[2]) == -math.inf
    empty = (kind[3:] == LOST).nonzero().flatten() + 3
    assert bool((result.points[empty] == 0).all())
    assert bool((result.snr_db[empty] == -math.inf).all())
    assert bool((result.attenuation_db[2:] == 0).all())


def test_clutter_of_rain_and_snow_at_once() -> None:
    """As many rows of each, rain's first; rain echoes far more strongly and is seen farther away."""
    points = target(30.0, -60.0)
    both = RadarAttenuation(Mixture(Rain(5.0), Snow(5.0)), SENSOR, clutter=True, clutter_points=512)
    result = ran(both, points)
    assert result.points.shape == (1 + 2 * 512, 6)
    farthest_m = []
    for rows in (slice(1, 513), slice(513, 1025)):
        seen = result.kind[rows] == PARTICLE
        assert int(seen.sum()) > 5
        farthest_m.append(float(result.points[rows][seen][:, :3].norm(dim=-1).max()))
    assert farthest_m[0] > 5.0 * farthest_m[1]
    assert list(both.chain.stages)[1:3] == ["rain_clutter", "snow_clutter"]
    fog = RadarAttenuation(Fog(50.0), SENSOR, clutter=True)
    assert ran(fog, points).points.shape == (1, 6)


def test_ego_motion_reaches_the_clutter() -> None:
    """Mean speed over the cosine to the front is minus the vehicle's: folded, as the radar folds it."""
    points = target(30.0, -60.0)
    slow = 0.4 * SENSOR.max_speed_m_per_s
    rows = ran(
        RadarAttenuation(Rain(25.0), SENSOR, clutter=True, clutter_points=4096, ego_speed_m_per_s=slow), points
    ).points[1:]
    range_m = rows[:, :3].norm(dim=-1)
    rows, range_m = rows[range_m > 0], range_m[range_m > 0]
    period = 2.0 * SENSOR.max_speed_m_per_s
    off = rows[:, 3] + slow * rows[:, 0] / range_m
    off = off - period * (off / period).round()
    # Drops fall as often into the beam as out of it: the mean is 0 within four standard errors.
    assert len(off) > 1000
    assert abs(float(off.mean())) < 4.0 * float(off.std()) / len(off) ** 0.5


# ---- models -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("weather", "wanted_db_per_km"),
    [
        (Rain(25.0), 1.07 * 25.0**0.69),
        (Fog.rehearse(30), 404.0),
        (Snow(2.5), 0.8205 * 2.5),
    ],
    ids=["Sander", "Liebe", "Norouziari"],
)
def test_the_published_variant(weather: Weather, wanted_db_per_km: float) -> None:
    """1.07 R^0.69, 0.182 LWC f^2 (404 dB/km in PHYSICS.md 6.6, three digits), 0.8205 S."""
    transform = RadarAttenuation(weather, SENSOR, variant="d3_4")
    assert float(transform.attenuation_db_per_km) == pytest.approx(wanted_db_per_km, rel=2e-3)
    model: dict[str, Any] = {f"{weather.kind}_model": "d3_4"}
    one = RadarAttenuation(weather, SENSOR, **model)
    assert torch.equal(one.attenuation_db_per_km, transform.attenuation_db_per_km)


def test_published_fog_is_340_times_too_strong() -> None:
    ratio = [
        float(RadarAttenuation(Fog.rehearse(30), SENSOR, variant=variant).attenuation_db_per_km)
        for variant in ("d3_4", None)
    ]
    assert ratio[0] / ratio[1] == pytest.approx(343.0, rel=0.005)


def test_melting_snow_takes_more_than_rain_of_its_rate() -> None:
    """PHYSICS.md 6.7: it can exceed rain at the same rate; dry snow is far below it."""
    dry, wet, rain = (
        float(RadarAttenuation(weather, SENSOR).attenuation_db_per_km)
        for weather in (Snow(2.5), Snow(2.5, melt_fraction=0.5), Rain(2.5))
    )
    assert dry < 0.3 * rain
    assert wet > 1.5 * rain
    with pytest.raises(ValueError, match=r"dry snow and needs melt_fraction = 0; got 0\.5"):
        RadarAttenuation(Snow(2.5, melt_fraction=0.5), SENSOR, variant="d3_4")


def test_rain_by_drops_is_a_quarter_above_p838() -> None:
    """23-27 % at 77 GHz (PHYSICS.md 6.5)."""
    by_drops, p838 = (
        float(RadarAttenuation(Rain(25.0), SENSOR, rain_model=model).attenuation_db_per_km)
        for model in ("dsd_mie", "p838")
    )
    assert by_drops / p838 == pytest.approx(1.27, abs=0.01)


# ---- explain ----------------------------------------------------------------------------------------------------


def explained(capsys: pytest.CaptureFixture[str], *argv: str) -> dict[str, Any]:
    assert main(["explain", *argv, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


# PHYSICS.md 6.5, five digits: k and alpha of ITU-R P.838-3.
P838_ROWS = {
    ("24", "h"): (0.14250, 1.01011),
    ("24", "v"): (0.14044, 0.95609),
    ("60", "h"): (0.86061, 0.76563),
    ("60", "v"): (0.85152, 0.74856),
    ("77", "h"): (1.13197, 0.71768),
    ("77", "v"): (1.12762, 0.70729),
}


@pytest.mark.parametrize(("frequency", "polarisation"), P838_ROWS)
def test_explain_prints_the_attenuation_of_the_recommendation(
    capsys: pytest.CaptureFixture[str], frequency: str, polarisation: str
) -> None:
    numbers = explained(
        capsys,
        *("--weather", "rain:rate=25", "--sensor", "radar"),
        *("--frequency-ghz", frequency, "--polarisation", polarisation),
    )
    k, alpha = P838_ROWS[frequency, polarisation]
    # Half a unit of the fifth digit, in k and in alpha times ln 25.
    assert numbers["attenuation_db_per_km"] == pytest.approx(k * 25.0**alpha, rel=6e-5)
    sensor = replace(SENSOR, frequency_ghz=float(frequency), polarisation=polarisation)
    transform = RadarAttenuation(Rain(25.0), sensor)
    assert float(transform.attenuation_db_per_km) == pytest.approx(numbers["attenuation_db_per_km"], rel=1e-6)


def test_explain_knows_the_melt_fraction(capsys: pytest.CaptureFixture[str]) -> None:
    sensor = ("--sensor", "radar")
    dry, wet = (
        explained(capsys, "--weather", f"snow:rate=2.5{more}", *sensor)["attenuation_db_per_km"]
        for more in ("", ",melt_fraction=0.5")
    )
    assert wet > 10.0 * dry
    for value, melted in ((dry, 0.0), (wet, 0.5)):
        transform = RadarAttenuation(Snow(2.5, melt_fraction=melted), SENSOR)
        assert float(transform.attenuation_db_per_km) == pytest.approx(value, rel=0.005)


# ---- bad input --------------------------------------------------------------------------------------------------


def test_a_floor_that_contradicts_the_powers_is_warned_of_with_its_numbers() -> None:
    points = torch.cat([target(30.0, -160.0, 3), target(30.0, -60.0, 2), target(0.0, -160.0, 5)])
    transform = RadarAttenuation(Rain(1.0), SENSOR)
    with pytest.warns(
        TorchweatherWarning, match=r"3 of 5 detections .* threshold of -142.* Radar\(noise_floor_db="
    ) as w:
        transform.run(points)
    assert w[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        transform(points[1:])  # two of four: no majority
        RadarAttenuation(Rain(1.0), replace(SENSOR, noise_floor_db=-180.0))(points)


@pytest.mark.parametrize(
    ("points", "error", "message"),
    [
        (torch.zeros(4, 5), ValueError, r"\(\.\.\., N, 6 or more\) = x, y, z in m.*got \(4, 5\)"),
        (torch.zeros(6), ValueError, r"got \(6,\)"),
        (torch.zeros(4, 6, dtype=torch.int64), TypeError, r"floating point.*got torch.int64\. Use \.float\(\)"),
        ([[0.0] * 6], TypeError, r"must be a tensor.*got list.*on_numpy"),
        (torch.tensor([[1.0, 0, 0, 0, math.nan, 0]]), ValueError, r"NaN or infinity in 1 rows \(power\)"),
        (
            torch.tensor([[math.inf, 0, 0, 0, 0, math.nan], [1.0] * 6]),
            ValueError,
            r"in 1 rows \(x, radar cross section\)",
        ),
        (torch.tensor([[1e25, 0, 0, 0, -50.0, 0]]), ValueError, r"metres; got 1e\+25, too far"),
        (torch.full((1, 6), 1e308, dtype=torch.float64), ValueError, r"metres; got 1e\+308, too far"),
    ],
    ids=["columns", "one row", "integers", "list", "nan power", "infinite", "far", "farther"],
)
def test_what_is_no_list_of_detections_is_refused(points: Any, error: type[Exception], message: str) -> None:
    transform = RadarAttenuation(Rain(0.0), SENSOR)
    for call in (transform, transform.run, transform.draw):
        with pytest.raises(error, match=f"RadarAttenuation: .*{message}"):
            call(points)


def test_further_columns_may_hold_anything() -> None:
    points = torch.cat([target(30.0, -60.0), torch.tensor([[math.nan, math.inf]])], 1)
    got = RadarAttenuation(Rain(5.0), SENSOR)(points)
    assert isinstance(got, Tensor)
    assert got[0, 6:].isnan().tolist() == [True, False]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"weather": 25.0}, TypeError, r"weather must be Rain, Fog, Snow or a Mixture, .*; got 25.0"),
        (
            {"sensor": Lidar(wavelength_nm=905.0)},
            TypeError,
            r"sensor must be a Radar, such as Radar.preset\('imaging-77ghz'\); got Lidar",
        ),
        ({"sensor": Camera.preset("lucid-triton")}, TypeError, "sensor must be a Radar"),
        ({"sensor": "imaging-77ghz"}, TypeError, "sensor must be a Radar.*got 'imaging-77ghz'"),
        ({"lost": "remove"}, ValueError, "lost must be one of zero, nan, drop; got 'remove'"),
        ({"variant": "d34"}, ValueError, "variant must be one of d3_4; got 'd34'"),
        ({"rain_model": "P838"}, ValueError, "rain_model must be one of p838, dsd_mie, d3_4; got 'P838'"),
        ({"fog_model": "mie"}, ValueError, "fog_model must be one of p840, d3_4; got 'mie'"),
        ({"snow_model": "norouziari"}, ValueError, "snow_model must be one of dsd_mie, d3_4; got 'norouziari'"),
        ({"radome_loss_db": -1.0}, ValueError, "loss_db must be 0 dB or more; got -1"),
        ({"radome_film_db": math.nan}, ValueError, "film_db must be .*nan"),
        ({"clutter": True, "clutter_points": 0}, ValueError, r"capacity must lie in 1\.\.100000; got 0"),
    ],
)
def test_wrong_arguments_are_refused_by_name(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        RadarAttenuation(**{"weather": Rain(5.0), "sensor": SENSOR, **arguments})


def test_fog_above_200_ghz_is_refused_with_the_range() -> None:
    with pytest.raises(ValueError, match=r"frequency_ghz must lie in 1\.\.200 GHz \(ITU-R P\.840\); got .*300"):
        RadarAttenuation(Fog(50.0), replace(SENSOR, frequency_ghz=300.0))
    with pytest.raises(ValueError, match=r"Radar: frequency_ghz must lie in 1\.\.1000 GHz; got 1200"):
        replace(SENSOR, frequency_ghz=1200.0)


def test_the_published_variant_says_all_models() -> None:
    with pytest.raises(ValueError, match=r"sets all three models; got dsd_mie besides"):
        RadarAttenuation(Rain(5.0), SENSOR, rain_model="dsd_mie", variant="d3_4")
