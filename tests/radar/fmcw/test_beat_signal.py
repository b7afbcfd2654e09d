"""Beat signal against the reference that adds up one scatterer, chirp and element at a time."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.reference import every_sample
from torchweather.core.errors import TorchweatherWarning
from torchweather.radar import Scatterers, beat_signal
from torchweather.radar.fmcw.beat_signal import SECOND_ORDER
from torchweather.sensors import Radar

SINGLE = 2e-6  # of the sum of amplitudes: float32 phases and products
SMALL = {
    "awr1843-like": {"chirps": 12, "samples": 48},
    "imaging-77ghz": {"chirps": 6, "samples": 32},
}
TINY = Radar(
    samples=16, chirps=6, tx_half_wavelengths=((0.0, 0.0), (2.0, 1.0)), rx_half_wavelengths=((0.0, 0.0), (1.0, 0.0))
)


def small(preset: str) -> Radar:
    return Radar.preset(preset, **SMALL[preset])


def targets(radar: Radar, count: int, speed_m_per_s: float, seed: int) -> dict[str, np.ndarray[Any, Any]]:
    """Random scatterers out to 90 % of the unambiguous range; the fastest has the speed given."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(1.0, 0.9 * radar.max_range_m, count)
    direction = [every_sample.line_of_sight(*angles) for angles in rng.uniform((-1.2, -0.4), (1.2, 0.4), (count, 2))]
    speed = rng.uniform(-1.0, 1.0, count)
    return {
        "position_m": distance[:, None] * np.array(direction),
        "speed_m_per_s": speed_m_per_s * speed / np.abs(speed).max(),
        "rcs_m2": rng.uniform(0.1, 10.0, count),
        "phase_rad": rng.uniform(-math.pi, math.pi, count),
        "attenuation_db": rng.uniform(0.0, 6.0, count),
    }


def ours(radar: Radar, given: dict[str, np.ndarray[Any, Any]]) -> Tensor:
    tensors = {name: torch.from_numpy(value) for name, value in given.items()}
    field = torch.polar(tensors["rcs_m2"].sqrt(), tensors["phase_rad"])
    found = Scatterers(tensors["position_m"], tensors["speed_m_per_s"], field)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TorchweatherWarning)  # fast ones are beyond the unambiguous speed
        return beat_signal(found, radar, attenuation_db=tensors["attenuation_db"])


def amplitudes(radar: Radar, given: dict[str, np.ndarray[Any, Any]]) -> float:
    """Sum over the scatterers, by the reference's radar equation."""
    total = 0.0
    for position, rcs, loss in zip(given["position_m"], given["rcs_m2"], given["attenuation_db"], strict=True):
        distance = float(np.linalg.norm(position))
        angles = math.atan2(position[1], position[0]), math.asin(position[2] / distance)
        total += math.sqrt(every_sample.receive_power_mw(radar, rcs, distance, *angles) * 10.0 ** (-loss / 10.0))
    return total


@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.parametrize(("count", "seed"), [(1, 0), (7, 1), (300, 2)])
def test_still_scatterers_agree_to_single_precision(preset: str, count: int, seed: int) -> None:
    radar = small(preset) if count < 100 else Radar.preset(preset, chirps=2, samples=8)
    given = targets(radar, count, 0.0, seed)
    error = np.abs(ours(radar, given).numpy() - every_sample.every_sample(radar, **given)).max()
    assert error <= SINGLE * amplitudes(radar, given)


@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.parametrize("speed_m_per_s", [0.3, 3.0, 10.0, 30.0, -30.0])
def test_moving_scatterers_agree_to_the_second_order(preset: str, speed_m_per_s: float) -> None:
    radar = small(preset)
    given = targets(radar, 5, speed_m_per_s, seed=3)
    error = np.abs(ours(radar, given).numpy() - every_sample.every_sample(radar, **given)).max()
    assert error <= (SECOND_ORDER + SINGLE) * amplitudes(radar, given)


@pytest.mark.parametrize("speed_m_per_s", [1.0, 5.0, 8.0, 15.0, 22.0, 30.0, 50.0])
@pytest.mark.parametrize("chirps", [33, 64])
def test_the_stated_accuracy_holds_over_a_whole_frame(chirps: int, speed_m_per_s: float) -> None:
    """Twelve transmitters in turn at 1 GHz: a target at 30 m/s crosses four range cells in 64 chirps of each."""
    turns = tuple((float(k), 0.0) for k in range(12))
    radar = Radar.preset(
        "imaging-77ghz", chirps=chirps, samples=64, tx_half_wavelengths=turns, rx_half_wavelengths=[[0, 0]]
    )
    given = targets(radar, 1, speed_m_per_s, seed=4)
    error = np.abs(ours(radar, given).numpy() - every_sample.every_sample(radar, **given))
    assert error.max() <= (SECOND_ORDER + SINGLE) * amplitudes(radar, given)


def test_range_cells_crossed_within_the_frame_are_not_lost() -> None:
    """A target at 25 m/s looks different from one that stays in its cell but keeps its Doppler."""
    radar = Radar(chirps=128, samples=64)
    given = targets(radar, 1, 25.0, seed=5)
    moving = every_sample.every_sample(radar, **given)[0]
    frozen = moving[:1] * (moving[:, :1] / moving[:1, :1])  # each chirp begins alike; the beat stays that of the first
    scale = amplitudes(radar, given)
    assert 25.0 * radar.frame_time_s > radar.range_resolution_m
    assert np.abs(moving - frozen).max() > scale
    assert np.abs(ours(radar, given)[0].numpy() - moving).max() <= (SECOND_ORDER + SINGLE) * scale


def test_single_precision_positions_keep_a_phase_of_a_hundredth_of_a_radian() -> None:
    """A float32 range of 32-64 m has steps of 3.8e-6 m: 0.012 rad of phase."""
    radar = small("awr1843-like")
    given = targets(radar, 1, 0.0, seed=6)
    given["position_m"] = given["position_m"].astype(np.float32).astype(np.float64)
    field = torch.polar(torch.from_numpy(given["rcs_m2"]).sqrt(), torch.from_numpy(given["phase_rad"]))
    found = Scatterers(torch.from_numpy(given["position_m"]).float(), torch.zeros(1), field.to(torch.complex64))
    cube = beat_signal(found, radar, attenuation_db=torch.from_numpy(given["attenuation_db"]).float())
    error = np.abs(cube.numpy() - every_sample.every_sample(radar, **given)).max()
    range_step_m = float(np.spacing(np.float32(np.linalg.norm(given["position_m"]))))
    turned = 4.0 * math.pi / radar.wavelength_m * range_step_m
    assert error <= (turned + 10 * SINGLE) * amplitudes(radar, given)


def test_a_batch_is_its_elements_and_padding_is_nothing() -> None:
    radar = small("awr1843-like")
    first, second = targets(radar, 4, 5.0, seed=7), targets(radar, 2, 2.0, seed=8)
    position = torch.zeros(2, 4, 3, dtype=torch.float64)
    speed, field, loss = torch.zeros(2, 4).double(), torch.zeros(2, 4, dtype=torch.complex128), torch.zeros(2, 4)
    loss = loss.double()
    for row, given in enumerate((first, second)):
        count = len(given["rcs_m2"])
        position[row, :count] = torch.from_numpy(given["position_m"])
        speed[row, :count] = torch.from_numpy(given["speed_m_per_s"])
        field[row, :count] = torch.polar(torch.from_numpy(given["rcs_m2"]).sqrt(), torch.from_numpy(given["phase_rad"]))
        loss[row, :count] = torch.from_numpy(given["attenuation_db"])
    both = beat_signal(Scatterers(position, speed, field), radar, attenuation_db=loss)
    assert both.shape == (2, radar.virtual_channels, radar.chirps, radar.samples)
    assert both.dtype == torch.complex64
    for row, given in enumerate((first, second)):
        error = np.abs(both[row].numpy() - every_sample.every_sample(radar, **given)).max()
        assert error <= (SECOND_ORDER + SINGLE) * amplitudes(radar, given)
    nested = beat_signal(
        Scatterers(position[:, None], speed[:, None], field[:, None]), radar, attenuation_db=loss[:, None]
    )
    assert torch.equal(nested[:, 0], both)


def test_a_field_of_zero_anywhere_changes_nothing() -> None:
    radar = small("awr1843-like")
    one = Scatterers.from_rcs(torch.tensor([[12.0, 1.0, 0.5]]), 5.0)
    nothing = Scatterers.from_rcs(torch.tensor([[0.0, 0.0, 0.0], [1e4, 0.0, 0.0]]), -torch.inf)
    alone = beat_signal(one, radar)
    difference = (beat_signal(one.joined(nothing), radar) - alone).abs().max()
    assert float(difference) <= SINGLE * float(alone.abs().max())  # sums of another length round otherwise
    assert not beat_signal(nothing, radar).any()


def test_six_db_on_the_way_halve_the_amplitude() -> None:
    """Powers count in dB: 20 log10 of the amplitude."""
    radar = small("awr1843-like")
    one = Scatterers.from_rcs(torch.tensor([[12.0, 1.0, 0.5]]), 5.0)
    half = beat_signal(one, radar, attenuation_db=torch.tensor([20.0 * math.log10(2.0)]))
    torch.testing.assert_close(2.0 * half, beat_signal(one, radar), rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("speed_m_per_s", [0.0, 4.0])
def test_gradients_are_those_of_the_reference(speed_m_per_s: float) -> None:
    """Central differences of the reference in float64; samples are single precision, and so are the gradients."""
    given = targets(TINY, 2, speed_m_per_s, seed=9)
    given["position_m"] *= 2.0 / np.linalg.norm(given["position_m"], axis=1, keepdims=True)  # strong and near
    rng = np.random.default_rng(0)
    scale = 1.0 / amplitudes(TINY, given)
    weight = scale * (rng.normal(size=(4, 6, 16)) + 1j * rng.normal(size=(4, 6, 16)))

    def reference(**changed: np.ndarray[Any, Any]) -> float:
        return float((weight.conj() * every_sample.every_sample(TINY, **{**given, **changed})).real.sum())

    leaves = {name: torch.from_numpy(value).requires_grad_() for name, value in given.items()}
    field = torch.polar(leaves["rcs_m2"].sqrt(), leaves["phase_rad"])
    scatterers = Scatterers(leaves["position_m"], leaves["speed_m_per_s"], field)
    cube = beat_signal(scatterers, TINY, attenuation_db=leaves["attenuation_db"])
    (torch.from_numpy(weight).conj() * cube).real.sum().backward()
    for name, value in given.items():
        step = 1e-7 if name == "position_m" else 1e-5
        wanted = np.zeros_like(value)
        for place in np.ndindex(value.shape):
            high, low = value.copy(), value.copy()
            high[place] += step
            low[place] -= step
            wanted[place] = (reference(**{name: high}) - reference(**{name: low})) / (2.0 * step)
        # Rounding adds over 384 samples; with motion, the second order that is left out. At rest the slope over the
        # speed is that of the phase alone: the range cells crossed add a share of B / f.
        tolerance = 2e-5 if speed_m_per_s == 0.0 else 5e-3
        if name == "speed_m_per_s":
            tolerance = max(tolerance, 1e-3 * TINY.bandwidth_mhz / TINY.frequency_ghz)
        tolerance *= max(np.abs(wanted).max(), 1.0)
        got = leaves[name].grad
        assert got is not None
        np.testing.assert_allclose(got.numpy(), wanted, rtol=0.0, atol=tolerance, err_msg=name)


def test_targets_beyond_the_unambiguous_range_fold_back_and_are_named() -> None:
    radar = Radar(samples=64, chirps=2)  # 9.59 m
    position = torch.tensor([[12.0, 0.0, 0.0], [5.0, 0.0, 0.0]], dtype=torch.float64)
    both = Scatterers.from_rcs(position, torch.tensor([20.0, -30.0]))
    with pytest.warns(
        TorchweatherWarning, match=r"1 of 2 scatterers lie beyond the unambiguous range of 9\.593 m \(largest 12 m\)"
    ):
        cube = beat_signal(both, radar)
    spectrum = [abs(every_sample.tone(cube[0, 0].numpy(), k / 64 / 8)) for k in range(512)]
    folded_m = 12.0 - radar.max_range_m
    assert np.argmax(spectrum) / 8 * radar.range_resolution_m == pytest.approx(
        folded_m, abs=radar.range_resolution_m / 8
    )


def test_speeds_beyond_the_unambiguous_one_fold_back_and_are_named() -> None:
    radar = Radar(samples=16, chirps=64)  # 19.47 m/s
    with pytest.warns(TorchweatherWarning, match=r"1 of 1 .* unambiguous speed of 19\.47 m/s \(largest 25 m/s\)"):
        cube = beat_signal(Scatterers.from_rcs(torch.tensor([[1.0, 0.0, 0.0]]), 0.0, -25.0), radar)
    spectrum = [abs(every_sample.tone(cube[0, :, 0].numpy(), (k - 256) / 512)) for k in range(512)]
    shown = (np.argmax(spectrum) - 256) / 8 * radar.speed_resolution_m_per_s
    assert shown == pytest.approx(2.0 * radar.max_speed_m_per_s - 25.0, abs=radar.speed_resolution_m_per_s / 8)


def test_targets_within_the_limits_do_not_warn() -> None:
    radar = Radar(samples=64, chirps=2)
    beat_signal(Scatterers.from_rcs(torch.tensor([[9.5, 0.0, 0.0]]), 0.0, 19.0), radar)  # warnings are errors here


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Scatterers.from_rcs(torch.zeros(0, 3), 0.0), r"one scatterer or more; got shape \(0,\)"),
        (
            lambda: Scatterers.from_rcs(torch.zeros(1, 3), 0.0),
            r"range of a scatterer must be above 0 m; got 0",
        ),
    ],
)
def test_nothing_to_look_at_is_refused(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        beat_signal(build(), TINY)


def test_an_attenuation_that_amplifies_or_is_no_number_is_refused() -> None:
    one = Scatterers.from_rcs(torch.tensor([[2.0, 0.0, 0.0]]), 0.0)
    for bad in (-0.5, math.nan):
        with pytest.raises(ValueError, match=f"attenuation_db must be 0 dB or more; got .*{bad}"):
            beat_signal(one, TINY, attenuation_db=torch.tensor([bad]))


def test_scatterers_of_impossible_shape_or_value_are_refused() -> None:
    good = {"position_m": torch.ones(2, 3), "speed_m_per_s": torch.zeros(2), "field_m": torch.ones(2).cfloat()}
    bad: dict[str, tuple[Tensor, type[Exception], str]] = {
        "position_m": (
            torch.ones(2, 2),
            ValueError,
            r"position_m must be \(\.\.\., M, 3\) in metres; got shape \(2, 2\)",
        ),
        "speed_m_per_s": (
            torch.zeros(3),
            ValueError,
            r"speed_m_per_s must be \(2,\), one a position; got shape \(3,\)",
        ),
        "field_m": (torch.ones(2), TypeError, r"field_m must be complex, metres; got torch\.float32"),
    }
    for name, (value, error, message) in bad.items():
        with pytest.raises(error, match=message):
            Scatterers(**{**good, name: value})
    for name, value in good.items():
        broken = value.clone()
        broken[0] = math.nan
        with pytest.raises(ValueError, match=f"{name}.*finite.*nan"):
            Scatterers(**{**good, name: broken})
    with pytest.raises(ValueError, match=r"range_m must be above 0 m; got -3"):
        Scatterers.from_spherical(torch.tensor([-3.0]), 0.0, 0.0, 0.0)
