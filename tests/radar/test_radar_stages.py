"""Radar stages on states made by hand: the way through the weather, the wet cover, the threshold, the rows that leave.

The volume's own echo has its tests in ``test_volume_clutter.py``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from scipy.stats import kstest
from torch import Tensor

from tests.oracles import load
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.physics import FOG
from torchweather.sensors import Radar
from torchweather.stages import (
    PathAttenuation,
    PointKind,
    RadarDetection,
    RadarState,
    ToRadarPoints,
    WetRadome,
    weather_attenuation_db_per_km,
)

OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))
SENSOR = Radar(noise_floor_db=-120.0, detection_snr_db=10.0, margin_db=3.0)
THRESHOLD_DB = -110.0
P838 = load("p838_3")["rows"]


def state_of(points: Tensor, **fields: Any) -> RadarState:
    """Detections before any stage; one list ``(N, C)`` or a batch of them."""
    points = points if points.ndim == 3 else points[None]
    batch = len(points)
    range_m = points[..., :3].norm(dim=-1)
    none = points.new_zeros(batch)
    state = RadarState.of(
        points_in=points,
        range_m=range_m,
        gain_db=torch.zeros_like(range_m),
        kind=torch.where(range_m > 0, OBJECT, LOST).to(torch.int8),
        noise_floor_db=none - 120.0,
        detection_snr_db=points.new_tensor(10.0),
        attenuation_db_per_km=none,
        cover_loss_db=none,
    )
    return state.changed(**fields)


def at(range_m: float, power_db: float = -50.0, number: int = 1) -> Tensor:
    """The same target in every row, double precision."""
    row = torch.tensor([0.6 * range_m, 0.0, 0.8 * range_m, -3.0, power_db, 10.0], dtype=torch.float64)
    return row.expand(number, 6)


def gain_db(stage: PathAttenuation, range_m: float) -> float:
    return float(stage(state_of(at(range_m)), {}).returns.gain_db)


# ---- attenuation ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("polarisation", ["h", "v"])
@pytest.mark.parametrize("frequency", P838)
def test_rain_costs_what_p838_says_there_and_back(frequency: str, polarisation: str) -> None:
    """A kilometre away twice a kilometre's attenuation, of the radar's own polarisation."""
    radar = replace(SENSOR, frequency_ghz=float(frequency), polarisation=polarisation)
    row = P838[frequency][f"gamma{polarisation.upper()}"]
    other = P838[frequency]["gammaV" if polarisation == "h" else "gammaH"]
    for rate in (1.0, 25.0, 100.0):
        wanted = 2.0 * row[f"{rate:g}"]
        # The intensity is float32 and the table a power law through P.838's own.
        assert gain_db(PathAttenuation([Rain(rate)], radar), 1000.0) == pytest.approx(-wanted, rel=2e-6)
        assert abs(other[f"{rate:g}"] / row[f"{rate:g}"] - 1.0) > 1e-4  # the other polarisation would be seen


def test_a_slanted_path_mixes_the_polarisations() -> None:
    """P.838's own mixing rule: straight up both polarisations are the mean of k_H and k_V."""
    row = P838["77"]
    k_h, a_h, k_v, a_v = (row[key] for key in ("kH", "aH", "kV", "aV"))
    for elevation in (0.0, 0.5, math.pi / 2):
        for polarisation, sign in (("h", 1.0), ("v", -1.0)):
            mix = sign * math.cos(elevation) ** 2
            k = 0.5 * (k_h + k_v + (k_h - k_v) * mix)
            alpha = 0.5 * (k_h * a_h + k_v * a_v + (k_h * a_h - k_v * a_v) * mix) / k
            radar = replace(SENSOR, elevation_rad=elevation, polarisation=polarisation)
            got = gain_db(PathAttenuation([Rain(25.0)], radar), 100.0)
            assert got == pytest.approx(-0.2 * k * 25.0**alpha, rel=2e-6)


@pytest.mark.parametrize("mor_m", [10, 20, 30, 50])
def test_fog_costs_what_p840_says_of_its_water(mor_m: int) -> None:
    """The measured fogs; at their visibilities the table has no node, hence its 0.5 %."""
    stage = PathAttenuation([Fog.rehearse(mor_m)], SENSOR)
    wanted = load("fog_radar_77GHz_10C")["rows"][str(mor_m)]["Kl_LWC"]
    assert gain_db(stage, 1000.0) == pytest.approx(-2.0 * wanted, rel=0.005)


def test_fog_follows_its_temperature() -> None:
    """K_l of P.840 at 0 and 20 degrees Celsius, of the same water."""
    rows = load("p840_Kl")["rows"]["77"]
    cold, warm = (gain_db(PathAttenuation([Fog(50.0, temperature_c=t)], SENSOR), 1000.0) for t in (0.0, 20.0))
    assert cold / warm == pytest.approx(rows["0"]["itur"] / rows["20"]["itur"], rel=1e-5)


def test_dry_snow_costs_what_mie_says() -> None:
    """The oracle counts flakes to 8 mm melted diameter, the weather to 4.5 mm (a flake of 20 mm): 1.2 % at 1 mm/h."""
    rows = load("snow_radar_77GHz")["rows"]["MG_brandes_density"]["SS"]
    for rate, cut in (("0.25", 0.0), ("1", 0.012)):
        wanted = 2.0 * (1.0 - cut) * rows[rate]["ext_dB_km"]
        # The oracle block's own 0.5 % on top of the table's.
        assert gain_db(PathAttenuation([Snow(float(rate))], SENSOR), 1000.0) == pytest.approx(-wanted, rel=0.01)


@pytest.mark.parametrize("rate", ["1", "10", "50"])
def test_rain_by_its_own_drops_costs_what_mie_says(rate: str) -> None:
    block = load("rain_radar_mie_marshall_palmer")
    wanted = block["rows"]["77"]["10"][rate]["atten_dB_km"]
    stage = PathAttenuation([Rain(float(rate))], SENSOR, rain_model="dsd_mie")
    assert gain_db(stage, 1000.0) == pytest.approx(-2 * wanted, rel=0.005 + float(block["tol"]))


def test_models_as_published() -> None:
    """Sander 1.07 R^0.69, 0.182 LWC f^2, Norouziari 0.8205 S: all dB/km one way (PHYSICS.md 6.5-6.7)."""
    water = float(Fog(30.0).distribution().liquid_water_g_per_m3())
    for weather, wanted in (
        (Rain(25.0), 1.07 * 25.0**0.69),
        (Fog(30.0), 0.182 * water * 77.0**2),
        (Snow(2.5), 0.8205 * 2.5),
    ):
        stage = PathAttenuation([weather], SENSOR, rain_model="d3_4", fog_model="d3_4", snow_model="d3_4")
        assert gain_db(stage, 1000.0) == pytest.approx(-2 * wanted, rel=1e-4)


def test_melting_snow_costs_many_times_what_dry_snow_does() -> None:
    """The melt fraction reaches the table: the value is that of the direct function."""
    dry, wet = Snow(2.5), Snow(2.5, melt_fraction=0.3)
    losses = [gain_db(PathAttenuation([snow], SENSOR), 1000.0) for snow in (dry, wet)]
    assert losses[1] == pytest.approx(-2 * float(weather_attenuation_db_per_km(wet, SENSOR)), rel=0.005)
    assert losses[1] < 10 * losses[0] < 0


KNOBS: dict[str, tuple[Weather, str, float, float]] = {
    "rain p838": (Rain(0.0), "p838", 1e-3, 300.0),
    "rain d3_4": (Rain(0.0), "d3_4", 1e-3, 300.0),
    "rain dsd_mie": (Rain(0.0), "dsd_mie", 1e-3, 300.0),
    "snow dsd_mie": (Snow(0.0), "dsd_mie", 1e-3, 300.0),
    "wet snow dsd_mie": (Snow(0.0, melt_fraction=0.3), "dsd_mie", 1e-3, 300.0),
    # Its power law bends where no snow gauge reads: held from the lower end of its fit.
    "snow of gunn-marshall": (Snow(0.0, size_distribution="gunn-marshall"), "dsd_mie", 0.02, 300.0),
    "snow d3_4": (Snow(0.0), "d3_4", 1e-3, 300.0),
    "measured fog": (Fog(size_distribution="rehearse"), "p840", 10.0, 50.0),
    "fog d3_4": (Fog(), "d3_4", 5.0, 20000.0),
    **{f"fog {name}": (Fog(size_distribution=name), "p840", 5.0, 20000.0) for name in FOG},
}


@pytest.mark.parametrize(("weather", "model", "low", "high"), KNOBS.values(), ids=KNOBS.keys())
def test_the_table_is_within_half_a_percent_of_the_function(
    weather: Weather, model: str, low: float, high: float
) -> None:
    """DESIGN.md 2, at 600 intensities that are no nodes; the kink of the default fog at 50 m among them."""
    intensities = torch.exp(torch.linspace(math.log(low), math.log(high), 600, dtype=torch.float64))
    if isinstance(weather, Fog) and low < 50.0 < high:
        intensities = torch.cat([intensities, torch.linspace(49.0, 51.0, 201, dtype=torch.float64)])
    wanted = weather_attenuation_db_per_km(weather, SENSOR, model, intensities)
    stage = PathAttenuation([weather], SENSOR, **{f"{weather.kind}_model": model})
    got = stage.parts[weather.kind].table(intensities)  # type: ignore[operator]
    assert float((got / wanted - 1.0).abs().max()) < 0.005


def test_weathers_add_whatever_their_order() -> None:
    weathers = [Snow(1.0), Rain(10.0), Fog(100.0)]
    alone = sum(gain_db(PathAttenuation([weather], SENSOR), 300.0) for weather in weathers)
    stages = [PathAttenuation(order, SENSOR) for order in (weathers, weathers[::-1], [Mixture(*weathers)])]
    together = [gain_db(stage, 300.0) for stage in stages]
    assert together[0] == together[1] == together[2]
    # Sums of float32 coefficients.
    assert together[0] == pytest.approx(alone, rel=1e-6)


def test_a_second_stage_adds_to_the_first() -> None:
    """Rain in front of the fog bank: gain and attenuation are those of both."""
    state = state_of(at(200.0))
    for stage in (PathAttenuation([Rain(10.0)], SENSOR), PathAttenuation([Fog(50.0)], SENSOR)):
        state = stage(state, {})
    both = PathAttenuation([Rain(10.0), Fog(50.0)], SENSOR)(state_of(at(200.0)), {})
    assert float(state.returns.gain_db) == pytest.approx(float(both.returns.gain_db), rel=1e-6)
    assert float(state.air.attenuation_db_per_km) == pytest.approx(float(both.air.attenuation_db_per_km), rel=1e-6)


def test_the_same_weather_twice_and_none_at_all_are_refused() -> None:
    with pytest.raises(ValueError, match="each kind once; got 2 times rain"):
        PathAttenuation([Rain(5.0), Rain(10.0)], SENSOR)
    with pytest.raises(ValueError, match="at least one weather"):
        PathAttenuation([], SENSOR)


@pytest.mark.parametrize("name", ["rain_model", "fog_model", "snow_model"])
def test_unknown_models_are_refused_by_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be one of .*d3_4; got 'sander'"):
        PathAttenuation([Rain(5.0)], SENSOR, **{name: "sander"})
    with pytest.raises(ValueError, match="model of rain must be one of p838, dsd_mie, d3_4; got 'p840'"):
        weather_attenuation_db_per_km(Rain(5.0), SENSOR, "p840")


def test_a_frequency_outside_a_formula_is_refused_with_its_range() -> None:
    beyond = replace(SENSOR, frequency_ghz=240.0)
    with pytest.raises(ValueError, match=r"must lie in 1\.\.200 GHz \(ITU-R P\.840\); got .*240"):
        PathAttenuation([Fog(100.0)], beyond)
    # Rain and snow have no such end, nor has the published form of fog.
    assert gain_db(PathAttenuation([Rain(10.0), Snow(1.0)], beyond), 100.0) < 0
    assert gain_db(PathAttenuation([Fog(100.0)], beyond, fog_model="d3_4"), 100.0) < 0


@pytest.mark.parametrize(
    ("make", "none", "some", "sign"),
    [(Rain, 0.0, 25.0, 1.0), (Snow, 0.0, 1.0, 1.0), (Fog, math.inf, 100.0, -1.0)],
    ids=["rain", "snow", "fog"],
)
def test_the_gradient_of_the_intensity(make: Any, none: float, some: float, sign: float) -> None:
    """More rain, or less visibility, takes more: against the difference quotient, and finite where nothing falls."""
    intensity = torch.tensor([none, some], dtype=torch.float64, requires_grad=True)
    state = state_of(at(150.0).expand(2, 1, 6))
    loss = -PathAttenuation([make(intensity)], SENSOR)(state, {}).returns.gain_db[:, 0]
    (gradient,) = torch.autograd.grad(loss.sum(), intensity)
    assert loss[0] == 0.0
    assert gradient[0] == 0.0
    step = 1e-3 * some
    up, down = (-gain_db(PathAttenuation([make(some + s)], SENSOR), 150.0) for s in (step, -step))
    # Both ends in the same cell of the table; its curvature over 2e-3 and float32 differences leave 1 %.
    assert float(gradient[1]) == pytest.approx((up - down) / (2 * step), rel=0.01)
    assert float(gradient[1]) * sign > 0


# ---- cover ------------------------------------------------------------------------------------------------------


def test_a_wet_cover_costs_the_same_at_every_range_and_the_dry_one_nothing() -> None:
    points = torch.cat([at(range_m) for range_m in (2.0, 50.0, 300.0)])
    for rate, film_db, wanted in ((8.0, 1.5, 0.5 + 3.0), (1.0, 1.5, 2.0), (0.0, 1.5, 0.5), (8.0, 0.0, 0.5)):
        after = WetRadome(rate, loss_db=0.5, film_db=film_db)(state_of(points), {})
        assert after.returns.gain_db[0].tolist() == pytest.approx([-wanted] * 3, rel=1e-6)
        assert float(after.receiver.cover_loss_db) == pytest.approx(wanted, rel=1e-6)
        assert torch.equal(after.receiver.noise_floor_db, state_of(points).receiver.noise_floor_db)
    for dry in (WetRadome(50.0), WetRadome(0.0, film_db=2.0)):
        assert bool((dry(state_of(points), {}).returns.gain_db == 0).all())


def test_a_wet_cover_leaves_rows_without_detection_alone() -> None:
    state = state_of(torch.cat([at(0.0), at(20.0)]))
    assert WetRadome(loss_db=2.0)(state, {}).returns.gain_db.tolist() == [[0.0, -2.0]]


def test_a_film_for_each_sample_and_its_gradient() -> None:
    """3 dB at 1 mm/h to the power 1/2: derivative 1.5 / sqrt(R), and 0 where it does not rain."""
    rate = torch.tensor([0.0, 4.0, 9.0], requires_grad=True)
    after = WetRadome(rate, film_db=3.0, film_exponent=0.5)(state_of(at(10.0).expand(3, 1, 6)), {})
    assert after.receiver.cover_loss_db.tolist() == pytest.approx([0.0, 6.0, 9.0])
    (gradient,) = torch.autograd.grad(after.receiver.cover_loss_db.sum(), rate)
    assert gradient.tolist() == pytest.approx([0.0, 0.75, 0.5])


@pytest.mark.parametrize("name", ["rate_mm_per_h", "loss_db", "film_db", "film_exponent"])
def test_a_cover_that_amplifies_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"WetRadome: {name} must be .*0.*; got .*-0\.5"):
        WetRadome(**{name: -0.5})


# ---- detection --------------------------------------------------------------------------------------------------


def detected(power_db: float, gain: float, margin: float = 0.5, range_m: float = 20.0) -> RadarState:
    """After detection, with a margin given as the probability of a smaller one."""
    state = state_of(at(range_m, power_db))
    state = state.changed(gain_db=torch.full_like(state.returns.gain_db, gain))
    found: RadarState = RadarDetection(SENSOR)(state, {"margin": torch.full((1, 1), margin, dtype=torch.float64)})
    return found


@pytest.mark.parametrize(
    ("power_db", "gain", "kind"),
    [
        (THRESHOLD_DB, 0.0, OBJECT),
        (THRESHOLD_DB, -1e-6, LOST),
        (THRESHOLD_DB + 5.0, -5.0, OBJECT),
        (THRESHOLD_DB + 5.0, -5.001, LOST),
        (-40.0, -69.9, OBJECT),
        (-40.0, -70.1, LOST),
    ],
)
def test_a_target_is_lost_below_the_floor_plus_the_detection_snr(power_db: float, gain: float, kind: int) -> None:
    after = detected(power_db, gain)
    assert int(after.returns.kind) == kind
    assert after.returns.snr_db is not None
    assert float(after.returns.snr_db) == pytest.approx(power_db + gain + 120.0, abs=1e-9)


def test_a_power_below_the_threshold_stands_above_it_by_the_margin() -> None:
    """-ln(1 - u) times the mean of 3 dB, whatever the column says; nothing is lost for the column alone."""
    for power_db in (-110.5, -300.0):
        for u in (0.0, 0.5, 0.9):
            margin_db = -3.0 * math.log(1.0 - u)
            clear, weak, gone = (detected(power_db, gain, u) for gain in (0.0, -0.9 * margin_db, -margin_db - 0.01))
            assert int(clear.returns.kind) == int(weak.returns.kind) == OBJECT
            assert int(gone.returns.kind) == LOST
            assert clear.returns.snr_db is not None
            assert float(clear.returns.snr_db) == pytest.approx(10.0 + margin_db, abs=1e-6)


def test_the_drawn_margins_are_exponential() -> None:
    """Kolmogorov-Smirnov over 20,000 rows; p of 1e-3 is met by one seed in a thousand, this one is fixed."""
    number, sensor = 20_000, replace(SENSOR, margin_db=2.0)
    state = state_of(at(20.0, -130.0, number))
    stage = RadarDetection(sensor)
    after = stage(state, stage.draw(state, seed=5))
    assert after.returns.snr_db is not None
    assert kstest((after.returns.snr_db[0] - 10.0).numpy(), "expon", args=(0.0, 2.0)).pvalue > 1e-3


def test_a_row_without_detection_stays_one() -> None:
    after = detected(-40.0, 0.0, range_m=0.0)
    assert int(after.returns.kind) == LOST
    assert after.returns.snr_db is not None
    assert float(after.returns.snr_db) == -math.inf


def test_the_weathers_own_rows_follow_with_their_own_snr() -> None:
    clutter = torch.zeros(1, 2, 6, dtype=torch.float64)
    clutter[0, 0] = torch.tensor([5.0, 1.0, 0.0, 2.0, -107.0, -40.0])
    state = state_of(at(20.0), clutter=clutter, clutter_valid=torch.tensor([[True, False]]))
    after = RadarDetection(SENSOR)(state, {"margin": torch.zeros(1, 1)})
    assert after.returns.kind.tolist() == [[OBJECT, PARTICLE, LOST]]
    assert after.returns.snr_db is not None
    assert after.returns.snr_db[0].tolist() == pytest.approx([70.0, 13.0, -math.inf])


# ---- points -----------------------------------------------------------------------------------------------------


def test_rows_leave_with_their_weakened_power_and_lost_ones_at_the_origin() -> None:
    points = torch.cat([at(50.0), at(60.0), at(0.0)])
    points = torch.cat([points, torch.tensor([[7.0], [8.0], [9.0]])], 1)
    state = state_of(points)
    state = state.changed(
        gain_db=torch.tensor([[-4.0, -90.0, 0.0]], dtype=torch.float64),
        kind=torch.tensor([[OBJECT, LOST, LOST]], dtype=torch.int8),
    )
    out = ToRadarPoints()(state, {}).returns.points
    assert out is not None
    assert out[0].tolist() == [
        [*points[0, :4].tolist(), -54.0, 10.0, 7.0],
        [0.0, 0.0, 0.0, -3.0, -140.0, 10.0, 8.0],
        [0.0, 0.0, 0.0, -3.0, -50.0, 10.0, 9.0],
    ]


def test_further_columns_of_the_weathers_own_rows_are_zero() -> None:
    points = torch.cat([at(50.0), torch.tensor([[7.0, 8.0]])], 1)
    clutter = torch.arange(6.0, dtype=torch.float64).reshape(1, 1, 6)
    out = ToRadarPoints()(state_of(points, clutter=clutter, clutter_valid=torch.ones(1, 1, dtype=torch.bool)), {})
    assert out.returns.points is not None
    assert torch.equal(out.returns.points[0, 0], points[0])
    assert out.returns.points[0, 1].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0]
