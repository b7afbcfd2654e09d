"""The whole chain with noise: a corner reflector comes out where it is, as fast as it is and as strong as it is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather.radar.fmcw.detection as detection
from tests.reference import every_sample
from torchweather.atmosphere.weather import Rain
from torchweather.core.errors import TorchweatherWarning
from torchweather.radar import WINDOWS, FmcwRadar, Scatterers, cfar_for
from torchweather.sensors import Radar
from torchweather.stages import weather_attenuation_db_per_km

RADARS = {
    "awr1843-like": Radar.preset("awr1843-like"),
    "imaging-77ghz": Radar.preset("imaging-77ghz", chirps=16, samples=128),
}
HALF_A_BIN, HALF_A_DB = 0.5, 0.5  # the acceptance of the issue: bins of range and speed, dB of power
HALF_A_BEAM = 0.5  # of 2 / n direction cosines for n elements in a row


def corner(radar: Radar, rng: np.random.Generator, fastest: float = 0.95) -> dict[str, float]:
    """A reflector anywhere between bins, well above the noise."""
    return {
        "range_m": rng.uniform(3.0, 0.45 * radar.max_range_m),
        "azimuth_rad": rng.uniform(-0.7, 0.7),
        "elevation_rad": rng.uniform(-0.2, 0.2),
        "rcs_dbsm": rng.uniform(5.0, 20.0),
        "speed_m_per_s": rng.uniform(-fastest, fastest) * radar.max_speed_m_per_s,
        "phase_rad": rng.uniform(-math.pi, math.pi),
    }


def scatterer(target: dict[str, float]) -> Scatterers:
    others = {name: value for name, value in target.items() if name != "range_m"}
    return Scatterers.from_spherical(torch.tensor([target["range_m"]], dtype=torch.float64), **others)


def received_dbm(radar: Radar, target: dict[str, float]) -> float:
    place = target["range_m"], target["azimuth_rad"], target["elevation_rad"]
    return 10.0 * math.log10(every_sample.receive_power_mw(radar, 10.0 ** (0.1 * target["rcs_dbsm"]), *place))


def strongest(points: Tensor | list[Tensor]) -> Tensor:
    assert isinstance(points, Tensor)
    assert len(points) > 0
    return points[points[:, 4].argmax()].double()


def errors(radar: Radar, target: dict[str, float], point: Tensor) -> dict[str, float]:
    """Of range and speed in bins, of direction in beams, of power and cross section in dB."""
    range_m = float(point[:3].norm())
    direction = every_sample.line_of_sight(target["azimuth_rad"], target["elevation_rad"])
    elements = radar.virtual_half_wavelengths.numpy()
    beams = 2.0 / (1.0 + np.ptp(elements, axis=0))
    off = np.abs(point[1:3].numpy() / range_m - direction[1:]) / beams
    return {
        "range": abs(range_m - target["range_m"]) / radar.range_resolution_m,
        "speed": abs(float(point[3]) - target["speed_m_per_s"]) / radar.speed_resolution_m_per_s,
        "azimuth": float(off[0]),
        "elevation": float(off[1]),
        "power": abs(float(point[4]) - received_dbm(radar, target)),
        "rcs": abs(float(point[5]) - target["rcs_dbsm"]),
    }


def assert_accepted(found: dict[str, float]) -> None:
    for name in ("range", "speed"):
        assert found[name] <= HALF_A_BIN, found
    for name in ("azimuth", "elevation"):
        assert found[name] <= HALF_A_BEAM, found
    for name in ("power", "rcs"):
        assert found[name] <= HALF_A_DB, found


@pytest.mark.parametrize("cfar", ["ca", "os"])
@pytest.mark.parametrize("window_name", [name for name in WINDOWS if name != "rectangular"])
@pytest.mark.parametrize("preset", RADARS)
def test_a_corner_reflector_comes_out_right(preset: str, window_name: str, cfar: str) -> None:
    radar = RADARS[preset]
    chain = FmcwRadar(radar, window_name=window_name, cfar=cfar)
    rng = np.random.default_rng(1)
    for seed in range(6):
        target = corner(radar, rng)
        scene = scatterer(target)
        assert_accepted(errors(radar, target, strongest(chain(scene, chain.draw(scene, seed=seed)))))


@pytest.mark.parametrize("cfar", ["ca", "os"])
@pytest.mark.parametrize("preset", RADARS)
def test_a_corner_reflector_comes_out_right_without_a_window(preset: str, cfar: str) -> None:
    """Slow targets: the response of a rectangular window is not that of one tone once range cells are crossed."""
    radar = RADARS[preset]
    chain = FmcwRadar(radar, window_name="rectangular", cfar=cfar)
    rng = np.random.default_rng(2)
    tenth = 0.1 * radar.range_resolution_m / radar.frame_time_s / radar.max_speed_m_per_s
    for seed in range(6):
        target = corner(radar, rng, fastest=min(tenth, 0.95))
        scene = scatterer(target)
        assert_accepted(errors(radar, target, strongest(chain(scene, chain.draw(scene, seed=seed)))))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("preset", RADARS)
def test_targets_just_slower_than_the_unambiguous_speed_keep_their_sign(preset: str, sign: float) -> None:
    """A third of a bin below it: the nearest bin is the first one of the other direction."""
    radar = RADARS[preset]
    chain = FmcwRadar(radar)
    speed = sign * (radar.max_speed_m_per_s - 0.33 * radar.speed_resolution_m_per_s)
    target = {"range_m": 9.0, "azimuth_rad": 0.2, "elevation_rad": 0.05, "rcs_dbsm": 10.0, "speed_m_per_s": speed}
    scene = scatterer(target)
    assert_accepted(errors(radar, target, strongest(chain(scene, chain.draw(scene, seed=0)))))


@pytest.mark.parametrize("share", [-0.9, 0.4, 0.9])
def test_speed_follows_the_carrier_in_the_middle_of_the_sweep(share: float) -> None:
    """In a range bin the phase turns as that of ``f + B / 2``: 0.65 % more at 1 GHz, here 0.75 bins at 0.9 v_max.

    Tolerance: noise of 1 / sqrt(SNR) of a bin, 40 dB.
    """
    radar = Radar(samples=128, chirps=256)
    chain = FmcwRadar(radar)
    speed = share * radar.max_speed_m_per_s
    target = {"range_m": 9.0, "azimuth_rad": 0.0, "elevation_rad": 0.0, "rcs_dbsm": 15.0, "speed_m_per_s": speed}
    scene = scatterer(target)
    assert errors(radar, target, strongest(chain(scene, chain.draw(scene, seed=0))))["speed"] <= 0.05


def test_the_slow_search_agrees_with_the_chain() -> None:
    """The samples alone, searched without any transform, say the same of the target."""
    radar = Radar.preset("awr1843-like", chirps=32, samples=64)
    chain = FmcwRadar(radar)
    target = corner(radar, np.random.default_rng(3))
    scene = scatterer(target)
    noise = chain.draw(scene, seed=0)
    start = target["range_m"] + 0.1, target["speed_m_per_s"] + 0.1, target["azimuth_rad"] + 0.05, 0.0
    *place, power_mw = every_sample.strongest_echo(radar, chain.cube(scene, noise).numpy(), start, rounds=10)
    names = ("range_m", "speed_m_per_s", "azimuth_rad", "elevation_rad")
    slow = dict(target, **dict(zip(names, place, strict=True)))
    slow["rcs_dbsm"] += 10.0 * math.log10(power_mw) - received_dbm(radar, slow)
    assert_accepted(errors(radar, slow, strongest(chain(scene, noise))))
    # 40 dB of SNR over all samples: 1e-2 of a resolution cell
    assert slow["range_m"] == pytest.approx(target["range_m"], abs=0.02 * radar.range_resolution_m)
    assert slow["speed_m_per_s"] == pytest.approx(target["speed_m_per_s"], abs=0.02 * radar.speed_resolution_m_per_s)
    assert slow["azimuth_rad"] == pytest.approx(target["azimuth_rad"], abs=0.01)
    assert slow["elevation_rad"] == pytest.approx(target["elevation_rad"], abs=0.03)


@pytest.mark.parametrize("preset", RADARS)
def test_rain_takes_its_attenuation_twice(preset: str) -> None:
    radar = RADARS[preset]
    rain = Rain(rate_mm_per_h=25.0)
    dry, wet = FmcwRadar(radar), FmcwRadar(radar, rain)
    gamma = 1.12762 * 25.0**0.70729 if radar.polarisation == "v" else 1.13197 * 25.0**0.71768  # P.838-3, PHYSICS.md 6.5
    assert float(weather_attenuation_db_per_km(rain, radar)) == pytest.approx(gamma, rel=1e-3)
    range_m = 0.9 * radar.max_range_m
    scene = scatterer(
        {"range_m": range_m, "azimuth_rad": 0.1, "elevation_rad": 0.0, "rcs_dbsm": 25.0, "speed_m_per_s": 1.0}
    )
    lost = strongest(dry(scene, dry.draw(scene, seed=0))) - strongest(wet(scene, wet.draw(scene, seed=0)))
    wanted = 2.0 * gamma * range_m * 1e-3
    assert float(lost[4]) == pytest.approx(wanted, abs=0.3)
    assert float(lost[5]) == pytest.approx(wanted, abs=0.3)


def test_one_way_attenuation_would_be_seen() -> None:
    """At 67 m the way back costs 0.77 dB in 25 mm/h: more than the tolerance above."""
    assert 1.13197 * 25.0**0.71768 * 0.9 * RADARS["awr1843-like"].max_range_m * 1e-3 > 2 * 0.3


def pair(radar: Radar, bins: tuple[float, float], phase_rad: float) -> Scatterers:
    """Two equal reflectors, so many range and Doppler bins apart, their echoes so far out of phase."""
    range_m = torch.tensor([40.0, 40.0 + bins[0]]).double() * radar.range_resolution_m
    speed = torch.tensor([3.0, 3.0 + bins[1]]).double() * radar.speed_resolution_m_per_s
    turned = -4.0 * math.pi / radar.wavelength_m * range_m + torch.tensor([0.0, phase_rad]).double()
    return Scatterers.from_spherical(range_m, 0.1, 0.05, torch.tensor([10.0, 10.0]), speed, turned)


@pytest.mark.parametrize("cfar", ["ca", "os"])
@pytest.mark.parametrize("phase_rad", [0.5 * math.pi, math.pi])
@pytest.mark.parametrize("bins", [(2.0, 0.0), (0.0, 2.0), (2.0, 2.0)])
@pytest.mark.parametrize("window_name", ["rectangular", "hann"])
def test_two_reflectors_two_bins_apart_are_two(
    window_name: str, bins: tuple[float, float], phase_rad: float, cfar: str
) -> None:
    """Echoes in phase fill the bin between them under Hann's window, those out of phase do not."""
    radar = RADARS["awr1843-like"]
    chain = FmcwRadar(radar, window_name=window_name, cfar=cfar)
    scene = pair(radar, bins, phase_rad)
    points = chain(scene, chain.draw(scene, seed=0))
    assert isinstance(points, Tensor)
    best = points[points[:, 4].topk(2).indices].double()
    for range_m, speed in zip(scene.range_m, scene.speed_m_per_s, strict=True):
        off = (best[:, :3].norm(dim=1) - range_m).abs() / radar.range_resolution_m
        slip = (best[:, 3] - speed).abs() / radar.speed_resolution_m_per_s
        assert int(((off <= 1.0) & (slip <= 1.0)).sum()) == 1


def test_two_directions_of_one_cell_are_two() -> None:
    radar = RADARS["imaging-77ghz"]
    chain = FmcwRadar(radar)
    scene = Scatterers.from_spherical(torch.tensor([9.0, 9.0]), torch.tensor([-0.1, 0.1]), 0.0, 10.0)
    points = chain(scene, chain.draw(scene, seed=0))
    assert isinstance(points, Tensor)
    azimuth = torch.atan2(points[:, 1], points[:, 0])[points[:, 4].topk(2).indices].sort().values
    assert azimuth.tolist() == pytest.approx([-0.1, 0.1], abs=0.5 * 2.0 / 32)


# ---- transmitters that take turns --------------------------------------------------------------------------------

TURNS = Radar.preset(
    "awr1843-like",
    samples=64,
    tx_half_wavelengths=((0.0, 0.0), (4.0, 0.0)),
    chirps=64,
)


def left_of_peak(radar: Radar, left: float, turn_rad: float) -> float:
    """Where the array looks when each transmitter is so much later in phase than the one before."""
    tried = np.linspace(-1.0, 1.0, 20001)
    place = np.array([tx[0] + rx[0] for tx in radar.tx_half_wavelengths for rx in radar.rx_half_wavelengths])
    order = np.repeat(np.arange(radar.transmitters), radar.receivers)
    seen = np.exp(1j * (order * turn_rad - math.pi * left * place))
    return float(tried[np.abs(np.exp(1j * math.pi * np.outer(tried, place)) @ seen).argmax()])


def test_transmitters_turns_are_taken_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without compensation the angle is wrong by what the phase of one chirp period says; with it, right."""
    speed = 0.4 * TURNS.max_speed_m_per_s
    scene = Scatterers.from_spherical(torch.tensor([8.0]).double(), 0.2, 0.0, 15.0, speed)
    chain = FmcwRadar(TURNS)
    noise = chain.draw(scene, seed=0)
    true = math.sin(0.2)

    def left() -> float:
        point = strongest(chain(scene, noise))
        return float(point[1] / point[:3].norm())

    beam = 2.0 / 8
    assert left() == pytest.approx(true, abs=0.05 * beam)

    def nothing(speed_m_per_s: Tensor, radar: Radar) -> Tensor:
        return torch.ones(*speed_m_per_s.shape, radar.virtual_channels, dtype=torch.complex64)

    monkeypatch.setattr(detection, "transmitter_rotation", nothing)
    wrong = left_of_peak(TURNS, true, 4.0 * math.pi / TURNS.wavelength_m * speed * TURNS.chirp_period_s)
    assert abs(wrong - true) > 0.15 * beam
    assert left() == pytest.approx(wrong, abs=0.05 * beam)


def test_a_target_too_fast_appears_at_the_folded_speed_and_at_the_wrong_angle() -> None:
    """Two transmitters: the speed is wrong by 2 v_max, the phase between their turns by half a turn."""
    speed = 1.3 * TURNS.max_speed_m_per_s
    scene = Scatterers.from_spherical(torch.tensor([8.0]).double(), 0.2, 0.0, 15.0, speed)
    chain = FmcwRadar(TURNS)
    with pytest.warns(TorchweatherWarning, match=r"unambiguous speed of 12\.17 m/s \(largest 15\.82 m/s\)"):
        points = chain(scene, chain.draw(scene, seed=0))
    assert isinstance(points, Tensor)
    best = points[points[:, 4].topk(2).indices].double()  # half a turn: two directions, equally likely
    folded = speed - 2.0 * TURNS.max_speed_m_per_s
    assert best[:, 3].tolist() == pytest.approx([folded, folded], abs=0.5 * TURNS.speed_resolution_m_per_s)
    left = best[:, 1] / best[:, :3].norm(dim=1)
    assert float((left - math.sin(0.2)).abs().min()) > 0.1
    assert float((left - left_of_peak(TURNS, math.sin(0.2), math.pi)).abs().min()) < 0.05 * 2.0 / 8 * 2


# ---- noise -------------------------------------------------------------------------------------------------------


def nothing_there() -> Scatterers:
    return Scatterers.from_rcs(torch.tensor([[1.0, 0.0, 0.0]]), -torch.inf)


def test_thermal_noise_has_its_power_in_both_parts() -> None:
    radar = RADARS["awr1843-like"]
    chain = FmcwRadar(radar)
    cube = chain.cube(nothing_there(), chain.draw(nothing_there(), seed=0))
    wanted = every_sample.noise_power_mw(radar)
    # Mean square of n normals: sqrt(2 / n) = 2.3e-3 of itself; 5 standard deviations
    within = 5.0 * math.sqrt(2.0 / cube.numel())
    assert float(cube.real.square().mean()) == pytest.approx(0.5 * wanted, rel=within)
    assert float(cube.imag.square().mean()) == pytest.approx(0.5 * wanted, rel=within)
    correlation = float((cube.real * cube.imag).mean()) / (0.5 * wanted)
    assert abs(correlation) < 5.0 / math.sqrt(cube.numel())
    channels = cube.reshape(radar.virtual_channels, -1)
    between = (channels @ channels.mH).abs() / channels.shape[1] / wanted
    assert float((between - torch.eye(radar.virtual_channels)).abs().max()) < 6.0 / math.sqrt(channels.shape[1])


@pytest.mark.parametrize(
    "changed", [{"bandwidth_mhz": 100.0}, {"transmit_power_dbm": 30.0}, {"antenna_gain_dbi": 20.0}]
)
def test_noise_knows_neither_the_sweep_nor_the_transmitter(changed: dict[str, float]) -> None:
    one, other = (FmcwRadar(Radar.preset("awr1843-like", samples=32, chirps=16, **extra)) for extra in ({}, changed))
    noise = one.draw(nothing_there(), seed=0)
    assert torch.equal(one.cube(nothing_there(), noise), other.cube(nothing_there(), noise))


def test_noise_grows_with_the_receivers_bandwidth_and_noise_figure() -> None:
    base = Radar.preset("awr1843-like", samples=32, chirps=16)
    one = FmcwRadar(base)
    noise = one.draw(nothing_there(), seed=0)
    for changed, ratio in (({"sample_rate_mhz": 20.0}, 2.0), ({"noise_figure_db": 17.0}, 10.0**0.3)):
        other = FmcwRadar(Radar.preset("awr1843-like", samples=32, chirps=16, **changed))
        expected = math.sqrt(ratio) * one.cube(nothing_there(), noise)
        torch.testing.assert_close(other.cube(nothing_there(), noise), expected, rtol=1e-5, atol=0.0)


def frames_above(radar: Radar, kind: str, window_name: str, rate: float, frames: int) -> Tensor:
    """Cells of noise above their threshold, of each of some frames."""
    chain = FmcwRadar(radar, window_name=window_name, cfar=cfar_for(radar, kind, window_name, false_alarm_rate=rate))
    batch = Scatterers(*(value.expand(frames, *value.shape) for value in vars(nothing_there()).values()))
    found = chain.run(batch, chain.draw(batch, seed=11))
    return chain.cfar(10.0 ** (found.power_dbm / 10.0)).flatten(1).sum(1).double()


@pytest.mark.parametrize("window_name", ["rectangular", "hann"])
@pytest.mark.parametrize("kind", ["ca", "os"])
def test_noise_alone_is_detected_at_the_stated_rate(kind: str, window_name: str) -> None:
    radar = Radar.preset("awr1843-like", samples=64, chirps=64)
    rate, frames = 1e-2, 60
    count = frames_above(radar, kind, window_name, rate, frames)
    cells = radar.samples * radar.chirps
    share = float(count.mean()) / cells
    # Independent cells: sqrt(rate / n) = 2.0 % of itself. Neighbours of a windowed map exceed together, which widens
    # it: the frames, which are independent, say by how much.
    binomial = math.sqrt(rate * (1.0 - rate) / (cells * frames))
    measured = float(count.std()) / math.sqrt(frames) / cells
    deviation = binomial if window_name == "rectangular" else max(binomial, measured)
    assert measured < 2.5 * binomial
    safe = 0.02 * rate if kind == "os" and window_name == "hann" else 0.0  # stated by the detector: 0.99 of the rate
    assert rate - 3.5 * deviation - safe <= share <= rate + 3.5 * deviation


def test_noise_alone_yields_few_points() -> None:
    """A point needs a cell above the CFAR threshold, so that points are no more than false alarms."""
    radar = RADARS["awr1843-like"]
    chain = FmcwRadar(radar)
    points = [len(chain(nothing_there(), chain.draw(nothing_there(), seed=seed))) for seed in range(4)]
    cells = 4 * radar.samples * radar.chirps * chain.cfar.false_alarm_rate
    assert sum(points) <= cells * chain.angles_per_cell + 5.0 * math.sqrt(cells)


def test_signal_to_noise_is_that_of_the_link_budget() -> None:
    """In the middle of a cell without a window nothing is lost: P less the noise of all samples together."""
    radar = Radar.preset("awr1843-like", chirps=64)
    target = {"range_m": 60 * radar.range_resolution_m, "azimuth_rad": 0.0, "elevation_rad": 0.0, "rcs_dbsm": 0.0}
    scene = scatterer(target)
    samples = radar.samples * radar.chirps * radar.virtual_channels
    budget = received_dbm(radar, target) - 10.0 * math.log10(every_sample.noise_power_mw(radar) / samples)
    for window_name, loss_db in (("rectangular", 0.0), ("hann", 2.0 * 10.0 * math.log10(1.5))):
        chain = FmcwRadar(radar, window_name=window_name)
        found = chain.run(scene, chain.draw(scene, seed=0))
        assert isinstance(found.snr_db, Tensor)
        # Noise moves the target's power by 1 / sqrt(SNR) in amplitude (0.3 dB at 25 dB) and the estimate by 0.2 dB
        assert float(found.snr_db.max()) == pytest.approx(budget - loss_db, abs=1.0)


# ---- batches and refusals ----------------------------------------------------------------------------------------


def test_a_batch_is_its_frames() -> None:
    radar = Radar.preset("awr1843-like", samples=64, chirps=32)
    chain = FmcwRadar(radar, Rain(rate_mm_per_h=10.0))
    rng = np.random.default_rng(5)
    scenes = [scatterer(corner(radar, rng)) for _ in range(3)]
    batch = Scatterers(*(torch.stack([getattr(s, name) for s in scenes]) for name in vars(scenes[0])))
    noise = chain.draw(batch, seed=3)
    together = chain.run(batch, noise)
    assert isinstance(together.points, list)
    for row, scene in enumerate(scenes):
        alone = chain.run(scene, {name: value[row] for name, value in noise.items()})
        torch.testing.assert_close(together.points[row], alone.points, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(together.power_dbm[row], alone.power_dbm, rtol=0.0, atol=1e-2)


def test_frames_that_are_not_the_radars_are_refused() -> None:
    radar = Radar.preset("awr1843-like", samples=64, chirps=32)
    chain = FmcwRadar(radar)
    shape = r"cube must be \(\.\.\., 12 virtual channels, 32 chirps, 64 samples\).*got \(12, 64, 32\)"
    with pytest.raises(ValueError, match=shape):
        chain.process(torch.zeros(12, 64, 32, dtype=torch.complex64))
    with pytest.raises(TypeError, match=r"FmcwRadar: cube must be a complex tensor.*got torch\.float32"):
        chain.process(torch.zeros(12, 32, 64))
    broken = torch.zeros(12, 32, 64, dtype=torch.complex64)
    broken[3, 4, 5] = math.nan
    with pytest.raises(ValueError, match=r"nan|finite"):
        chain.process(broken)


@pytest.mark.parametrize(
    ("build", "error", "message"),
    [
        (lambda radar: FmcwRadar("awr1843-like"), TypeError, r"radar must be a Radar.*got 'awr1843-like'"),
        (lambda radar: FmcwRadar(radar, 25.0), TypeError, r"weather must be a Weather or None; got 25\.0"),
        (lambda radar: FmcwRadar(radar, window_name="kaiser"), ValueError, r"window_name must be one of .*'kaiser'"),
        (lambda radar: FmcwRadar(radar, cfar="xx"), ValueError, r"cfar must be one of ca, os; got 'xx'"),
        (lambda radar: FmcwRadar(radar, angles_per_cell=0), ValueError, r"angles_per_cell must be 1 or more; got 0"),
        (lambda radar: FmcwRadar(radar, dynamic_db=-1.0), ValueError, r"dynamic_db must be 0 dB or more; got -1"),
    ],
)
def test_what_makes_no_chain_is_refused(build: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        build(RADARS["awr1843-like"])


def test_targets_beyond_the_unambiguous_range_come_out_nearer() -> None:
    radar = RADARS["awr1843-like"]
    chain = FmcwRadar(radar)
    target = {"range_m": 1.3 * radar.max_range_m, "azimuth_rad": 0.1, "elevation_rad": 0.0, "rcs_dbsm": 30.0}
    scene = scatterer(target)
    with pytest.warns(TorchweatherWarning, match=r"unambiguous range of 74\.95 m \(largest 97\.43 m\)"):
        point = strongest(chain(scene, chain.draw(scene, seed=0)))
    assert float(point[:3].norm()) == pytest.approx(0.3 * radar.max_range_m, abs=0.5 * radar.range_resolution_m)
    assert float(point[4]) == pytest.approx(received_dbm(radar, target), abs=HALF_A_DB)


def test_points_follow_their_target() -> None:
    """Slopes of range, speed and power of the point over those of the target: 1.

    Without noise: the echo's phase turns by 3,200 rad/m, and so does its sum with the noise.
    """
    radar = Radar.preset("awr1843-like", samples=64, chirps=64)
    chain = FmcwRadar(radar, noise=False)
    leaves = torch.tensor([8.1, 2.05, 15.0], dtype=torch.float64, requires_grad=True)
    scene = Scatterers.from_spherical(leaves[:1], 0.1, 0.0, leaves[2:], leaves[1:2])
    point = chain(scene, chain.draw(scene, seed=0))
    assert isinstance(point, Tensor)
    best = point[point[:, 4].argmax()]
    for value, place in ((best[:3].norm(), 0), (best[3], 1), (best[5], 2)):
        slope = torch.autograd.grad(value, leaves, retain_graph=True)[0][place]
        assert float(slope) == pytest.approx(1.0, abs=0.1)
