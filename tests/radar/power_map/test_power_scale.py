"""Scales, axes, the noise floor and the detections of radar power maps."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather import Radar, Rain
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import (
    MapAxes,
    PowerScale,
    RadarPowerMap,
    map_cfar,
    map_detections,
    noise_correlation,
    noise_floor_db,
    quiet_cells,
    with_noise_scale,
)

BIN_M = 0.25
AXES = MapAxes.of_turn(bins=200, bin_m=BIN_M, azimuths=400, dims=("range", "azimuth"))
RADAR = Radar(bandwidth_mhz=600.0, samples=200, sample_rate_mhz=1.0, chirp_period_us=500.0, chirps=1)
EVERY_BYTE = torch.arange(256, dtype=torch.uint8)


def noise(seed: int = 0, looks: int = 1) -> Tensor:
    uniform = torch.rand(looks, *AXES.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return (-torch.log1p(-uniform)).mean(0).float()


def with_targets(power: Tensor, level: float = 1e4) -> Tensor:
    """A ring of buildings and a street: a third of the map is no noise."""
    crowded = power.clone()
    crowded[60:110, 100:300] *= level
    crowded[:30] *= level
    return crowded


# ---- scales --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [PowerScale.steps(0.5), PowerScale.steps(0.33, -7.0)])
def test_every_byte_comes_back_from_its_decibels(scale: PowerScale) -> None:
    decibels = scale.decibels(EVERY_BYTE)
    assert torch.equal(scale.stored(decibels, EVERY_BYTE), EVERY_BYTE)
    low, high = scale.bounds_db(EVERY_BYTE)
    assert torch.equal(scale.stored((high - 1e-3), EVERY_BYTE), EVERY_BYTE)
    assert torch.equal(scale.stored((low[1:] + 1e-3), EVERY_BYTE), EVERY_BYTE[1:])
    assert PowerScale.from_dict(scale.to_dict()) == scale


@pytest.mark.parametrize(("kind", "number", "expected_db"), [("linear", 100.0, 20.0), ("amplitude", 100.0, 40.0)])
def test_powers_and_amplitudes(kind: str, number: float, expected_db: float) -> None:
    scale = PowerScale(kind)
    decibels = scale.decibels(torch.tensor([number]))
    assert float(decibels) == pytest.approx(expected_db)
    assert float(scale.stored(decibels, torch.zeros(1))) == pytest.approx(number, rel=1e-5)
    assert float(PowerScale("complex").decibels(torch.tensor([60.0 + 80.0j]))) == pytest.approx(40.0)


def test_the_scale_of_noise_makes_it_exponential_whatever_the_recorder_did() -> None:
    power = noise()
    recorded = (30.0 * power.pow(0.3) - 10.0).clamp(0, 255).round().to(torch.uint8)  # no dB at all
    scale = PowerScale.from_noise(recorded, 0.5)
    edges = torch.tensor(scale.edges_db)
    # A byte's upper edge is the power at which the recorder turns to the next one.
    known = [edge for edge in range(2, 27) if float((recorded <= edge).double().mean()) <= 0.9]
    for byte in known:
        expected = 10.0 * math.log10(((byte + 0.5 + 10.0) / 30.0) ** (1.0 / 0.3))
        assert float(edges[byte]) == pytest.approx(expected, abs=0.15)
    assert float(edges[200] - edges[199]) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: PowerScale("watts"), "kind must be one of"),
        (lambda: PowerScale("db_steps"), "PowerScale.steps"),
        (lambda: PowerScale("db_steps", (1.0, 0.0)), "255 rising levels"),
        (lambda: PowerScale.steps(0.0), "step_db"),
        (lambda: PowerScale.from_noise(EVERY_BYTE[:20]), "200 bytes of noise or more; got 20"),
        (lambda: PowerScale.from_noise(torch.zeros(500, dtype=torch.uint8)), "noise over several levels; got 1"),
        (lambda: MapAxes(("azimuth",), (), (0.0,)), "range among them"),
        (lambda: MapAxes(("range", "range"), (1.0, 2.0)), "different names"),
        (lambda: MapAxes(("range",), (2.0, 1.0)), "rising"),
        (lambda: MapAxes(("range", "azimuth"), (1.0, 2.0)), "azimuth_rad has no values"),
        (lambda: MapAxes(("range",), (1.0, 2.0), (0.0,)), "although dims lacks it"),
        (lambda: RadarPowerMap(torch.zeros(2, 3), AXES, PowerScale("linear")), "range 200 x azimuth 400; got"),
    ],
)
def test_what_is_no_scale_or_no_axis_is_refused(make: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


def test_axes_are_plain_values_and_back() -> None:
    axes = MapAxes(("range", "doppler"), (1.0, 2.0), None, None, (-1.0, 0.0, 1.0))
    assert MapAxes.from_dict(axes.to_dict()) == axes
    assert axes.speed_bin_m_per_s == 1.0
    assert not axes.full_turn
    assert AXES.full_turn
    half = MapAxes(("range", "azimuth"), (1.0, 2.0), tuple(0.01 * k for k in range(300)))
    assert not half.full_turn


def test_values_are_laid_out_in_the_order_of_the_map() -> None:
    axes = MapAxes(("doppler", "azimuth", "range"), (1.0, 2.0), (0.0, 0.1, 0.2), None, (-1.0, 0.0))
    of_cell = torch.arange(6.0).reshape(1, 2, 3)  # range, azimuth
    assert torch.equal(axes.laid_out(of_cell, ("range", "azimuth")), of_cell[0].T[None, None])
    assert axes.laid_out(torch.zeros(4, 3, 1), ("azimuth", "elevation")).shape == (4, 1, 3, 1)


# ---- the floor -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("kind", ["linear", "db", "db_steps"])
def test_the_floor_is_found_among_targets(kind: str, looks: int) -> None:
    power = with_targets(noise(looks=looks)) * 100.0
    scale = PowerScale.steps(0.5) if kind == "db_steps" else PowerScale(kind)
    like = torch.zeros(0, dtype=torch.uint8 if kind == "db_steps" else torch.float32)
    power_map = RadarPowerMap(scale.stored(10.0 * power.log10(), like), AXES, scale)
    # Some 4,000 cells: a median is good to 0.1 dB.
    assert noise_floor_db(power_map, looks) == pytest.approx(20.0, abs=0.3)
    assert float(power[quiet_cells(power_map)].mean()) == pytest.approx(100.0, rel=0.06)


def test_choosing_quiet_cells_does_not_lower_pure_noise() -> None:
    level = []
    for seed in range(20):
        power_map = RadarPowerMap(noise(seed), AXES, PowerScale("linear"))
        level.append(float(power_map.values[quiet_cells(power_map)].double().mean()))
    assert sum(level) / 20 == pytest.approx(1.0, abs=5.0 / math.sqrt(20 * 4000))


def test_a_map_cut_off_above_its_noise_asks_for_the_floor() -> None:
    for scale, values in (
        (PowerScale.steps(0.5), torch.zeros(AXES.shape, dtype=torch.uint8)),
        (PowerScale("linear"), torch.zeros(AXES.shape)),
    ):
        with pytest.raises(ValueError, match=r"cut off above its noise\. Give noise_floor_db"):
            noise_floor_db(RadarPowerMap(values, AXES, scale))


def test_a_map_of_bytes_read_by_its_noise_has_its_floor_at_0_db() -> None:
    recorded = (20.0 * with_targets(noise()).pow(0.25)).clamp(0, 255).to(torch.uint8)
    found = with_noise_scale(RadarPowerMap(recorded, AXES, PowerScale.steps(0.5)))
    assert torch.equal(found.values, recorded)
    assert noise_floor_db(found) == pytest.approx(0.0, abs=0.15)


def test_the_correlation_of_noise_along_the_range_is_measured() -> None:
    white = torch.randn(2, 201, 400, generator=torch.Generator().manual_seed(1))
    power = (white[:, 1:] + white[:, :-1]).square().sum(0)  # neighbours share half: amplitude 1/2, power 1/4
    found = noise_correlation(RadarPowerMap(power, AXES, PowerScale("linear")), lags=2)
    assert found == pytest.approx([0.25, 0.0], abs=0.1)


# ---- detections ----------------------------------------------------------------------------------------------------


def test_a_target_is_detected_where_it_is_with_its_cross_section() -> None:
    power = noise()
    row, column = 120, 37
    power[row, column] = 1e6
    power_map = RadarPowerMap(power, AXES, PowerScale("linear"))
    points = map_detections(power_map, RADAR)
    strongest = points[points[:, 4].argmax()]
    range_m, azimuth = AXES.range_m[row], AXES.azimuth_rad[column]  # type: ignore[index]
    assert strongest[:3].tolist() == pytest.approx([range_m * math.cos(azimuth), range_m * math.sin(azimuth), 0.0])
    assert float(strongest[4]) == pytest.approx(60.0, abs=1e-3)
    floor_dbm = RADAR.noise_power_dbm - 10.0 * math.log10(200)
    rcs = floor_dbm + 60.0 - RADAR.constant_db + 40.0 * math.log10(range_m)
    assert float(strongest[5]) == pytest.approx(rcs, abs=0.3)


def test_noise_alone_is_rarely_detected_before_and_after() -> None:
    clear = RadarPowerMap(noise(), AXES, PowerScale("linear"))
    white = Radar(**{**RADAR.to_dict(), "bandwidth_mhz": 600.0})
    cover = RadarMapWeather(
        Rain(0.0), white, axes=AXES, scale=clear.scale, noise_floor_db=0.0, radome_loss_db=40.0, oversampling=0.0
    )
    cfar = map_cfar(clear, white, 1e-3)
    flat = type(cfar)(**{**vars(cfar), "correlation": ((), ())})
    for one in (clear, cover.of_map(clear, seed=1)):
        count = len(map_detections(one, white, flat, noise_db=0.0))
        # Local maxima of nine cells alone count, but nearly all that exceed a threshold this high are.
        assert 80 - 5 * 9 <= count <= 80 + 5 * 9


def test_rain_hides_a_weak_target_and_leaves_a_strong_one() -> None:
    power = noise()
    power[120, 37], power[120, 200] = 30.0, 1e6
    clear = RadarPowerMap(power, AXES, PowerScale("linear"))
    heavy = RadarMapWeather(
        Rain(50.0), RADAR, axes=AXES, scale=clear.scale, noise_floor_db=0.0, radome_loss_db=15.0, clutter=False
    )

    def azimuths(one: RadarPowerMap) -> set[int]:
        points = map_detections(one, RADAR, noise_db=0.0)
        at_range = (points[:, :2].norm(dim=1) - AXES.range_m[120]).abs() < 0.01
        turn = torch.remainder(-torch.atan2(points[at_range, 1], points[at_range, 0]), 2.0 * math.pi)
        return set((turn / AXES.azimuth_bin_rad).round().long().tolist())

    assert {37, 200} <= azimuths(clear)
    after = azimuths(heavy.of_map(clear, seed=1))
    assert 200 in after
    assert 37 not in after


def test_a_third_dimension_gives_speed_and_elevation() -> None:
    axes = MapAxes(
        ("range", "azimuth", "doppler", "elevation"),
        tuple(0.25 + 0.25 * k for k in range(60)),
        tuple(0.02 * (k - 20) for k in range(41)),
        (0.0, 0.1, 0.2),
        (-1.0, 0.0, 1.0, 2.0),
    )
    power = torch.ones(axes.shape)
    power[30, 10, 3, 2] = 1e5
    (point,) = map_detections(RadarPowerMap(power, axes, PowerScale("linear")), RADAR, noise_db=0.0)
    range_m = axes.range_m[30]
    assert float(point[2]) == pytest.approx(range_m * math.sin(0.2), rel=1e-5)
    assert float(torch.atan2(point[1], point[0])) == pytest.approx(-0.2, abs=1e-5)
    assert float(point[3]) == 2.0
