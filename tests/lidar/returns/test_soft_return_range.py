"""Where and how often fog is read, against a receiver by brute force: noise filtered by the pulse, its maximum taken.

The waveform is that of ``tests/reference/fog_waveform.py``. With 1,000 photons at the threshold its noise is normal, of
the root of the photons. The receiver's filter is the pulse itself, so that the noise is white noise filtered with
``sin^2``, and the maximum of the sum is the reading. ``SoftReturn`` draws it from Rice's rate of crossings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from tests.reference.every_lidar_particle import Link
from tests.reference.fog_waveform import SoftTarget, soft_signal
from torchweather.atmosphere.weather import Fog
from torchweather.sensors import Lidar
from torchweather.stages import ParticleReturns
from torchweather.transforms import LidarFog

PHOTONS, STEP_M, FARTHEST_M, DRAWS = 1000.0, 0.05, 30.0, 20_000
OS1 = replace(Lidar.preset("ouster-os1-128"), photons_at_threshold=PHOTONS, range_noise_m=0.0, range_resolution_m=0.0)
MORS_M = (30.0, 50.0, 100.0)
# Photons at the waveform's maximum: one standard deviation below the threshold, at it, and one above.
PEAKS = (970.0, 1000.0, 1030.0)


@dataclass(frozen=True)
class Readings:
    """Range and photons ``(DRAWS,)`` of the reading of each beam."""

    range_m: NDArray[np.float64]
    photons: NDArray[np.float64]

    @property
    def detected(self) -> float:
        """Share of the readings at the threshold or above."""
        return float((self.photons >= PHOTONS).mean())


def sensor(mor_m: float, peak: float) -> Lidar:
    """Sees the maximum of a fog with so many photons."""
    returns = returns_of(mor_m, OS1)
    range_m = torch.arange(2.0, 10.0, 0.01)
    fog: Any = LidarFog(Fog(mor_m=mor_m), OS1)
    most = float(returns.kinds["fog"].signal(returns.beam, fog.extinction_per_m, range_m).max())  # type: ignore[operator]
    # The threshold is that of a target of 10 %: 0.1 / (pi R^2).
    return replace(OS1, range_at_10_percent_m=math.sqrt(0.1 / math.pi / (most * PHOTONS / peak)))


def returns_of(mor_m: float, lidar: Lidar) -> ParticleReturns:
    found = LidarFog(Fog(mor_m=mor_m), lidar).chain.stages["particle_returns"]
    assert isinstance(found, ParticleReturns)
    return found


def drawn(mor_m: float, peak: float, object_m: float = 0.0) -> Readings:
    """What the library draws for beams without an object, or in front of one."""
    lidar = sensor(mor_m, peak)
    fog = LidarFog(Fog(mor_m=mor_m), lidar)
    direction = torch.tensor([[1.0, 0.0, 0.0]]).expand(DRAWS, 3)
    points = torch.tensor([object_m, 0.0, 0.0, 1.0 if object_m else 0.0]).expand(1, DRAWS, 4)
    state: Any = fog.state_of(points, direction)
    noise = fog.chain.draw(state, seed=2)
    for name in ("to_energy", "extinction", "particle_returns"):
        own = {key.removeprefix(f"{name}."): value for key, value in noise.items() if key.startswith(f"{name}.")}
        state = fog.chain.stages[name](state, own)
    photons = state.returns.signal[0, :, 1] / state.receiver.threshold * PHOTONS
    return Readings(state.returns.range_m[0, :, 1].double().numpy(), photons.double().numpy())


@lru_cache(maxsize=1)
def receiver_noise(length_m: float, steps: int) -> NDArray[np.float64]:
    """Normal numbers ``(DRAWS, steps)`` that are correlated as the pulse, the same for every fog."""
    place = np.arange(-length_m + 0.5 * STEP_M, length_m, STEP_M)
    pulse = np.cos(0.5 * math.pi * place / length_m) ** 2
    white = np.random.default_rng(1).normal(size=(DRAWS, steps + len(pulse) - 1))
    return np.asarray(fftconvolve(white, pulse[None] / math.sqrt(float(pulse @ pulse)), mode="valid", axes=1))


@pytest.fixture(scope="module", autouse=True)
def _noise_goes() -> Iterator[None]:
    """90 MB."""
    yield
    receiver_noise.cache_clear()


def by_brute_force(mor_m: float, peak: float, object_m: float = math.inf) -> Readings:
    """Maxima of the waveform, up to an object, with noise that is correlated as the pulse."""
    fog = LidarFog(Fog(mor_m=mor_m), OS1)
    target = SoftTarget(float(fog.extinction_per_m), float(fog.backscatter_per_m_sr))
    length_m = target.pulse_length_m
    range_m = np.arange(2.0 + 0.5 * STEP_M, FARTHEST_M, STEP_M)
    waveform = soft_signal(range_m + length_m, target, Link(0.0095, OS1.divergence_mrad * 1e-3, 40.0))
    mean = peak * waveform / waveform.max()
    noise = receiver_noise(length_m, len(range_m))
    reading = np.where(range_m < object_m, mean + np.sqrt(mean) * noise, -np.inf)
    top = reading.argmax(1)
    return Readings(range_m[top], reading[np.arange(DRAWS), top])


CASES = [(mor_m, peak) for mor_m in MORS_M for peak in PEAKS]


@pytest.fixture(scope="module")
def found() -> dict[tuple[float, float], tuple[Readings, Readings]]:
    """Drawn and by brute force."""
    return {case: (drawn(*case), by_brute_force(*case)) for case in CASES}


Found = dict[tuple[float, float], tuple[Readings, Readings]]


@pytest.mark.parametrize("case", CASES)
def test_fog_is_read_at_the_mean_range_of_the_receiver(found: Found, case: tuple[float, float]) -> None:
    library, brute = found[case]
    # 4 standard errors of a difference of means of 20,000, spread 0.19 m: 0.008 m. The places are weighted as if the
    # waveform were straight: 0.01 to 0.043 m too far, a thirtieth of the pulse length.
    assert 0.0 < library.range_m.mean() - brute.range_m.mean() < 0.055
    assert np.median(library.range_m) == pytest.approx(np.median(brute.range_m), abs=0.06)  # steps of 0.05 m


@pytest.mark.parametrize("case", CASES)
def test_its_spread_is_the_receiver_s(found: Found, case: tuple[float, float]) -> None:
    library, brute = found[case]
    # 4 standard errors of two standard deviations: 4 x 0.19 / sqrt(40,000) x sqrt(2), tails doubled: 0.01 m.
    assert library.range_m.std() == pytest.approx(brute.range_m.std(), abs=0.015)


@pytest.mark.parametrize("case", CASES)
def test_the_share_that_is_detected_is_the_receiver_s(found: Found, case: tuple[float, float]) -> None:
    library, brute = found[case]
    # 4 standard errors of a difference of two shares of 20,000: 0.02; the tables' nodes: 0.02 (0.045 deviations).
    assert library.detected == pytest.approx(brute.detected, abs=0.04)


@pytest.mark.parametrize("case", CASES)
def test_the_readings_have_the_receiver_s_distribution(found: Found, case: tuple[float, float]) -> None:
    """In standard deviations of one count: counts of pulse lengths independent of each other would be 0.15 too high in
    the mean, 0.6 in the low tail, and scatter by 13 % less."""
    library, brute = found[case]
    deviation = math.sqrt(PHOTONS)
    # 4 standard errors: 0.04 x 0.95 of the mean, 3 % of the spread, 0.15 of a percentile.
    assert library.photons.mean() == pytest.approx(brute.photons.mean(), abs=0.09 * deviation)
    assert library.photons.std() / brute.photons.std() == pytest.approx(1.0, abs=0.03)
    for tail in (0.01, 0.99):
        assert np.quantile(library.photons, tail) == pytest.approx(
            np.quantile(brute.photons, tail), abs=0.2 * deviation
        )


@pytest.mark.parametrize("object_m", [2.8, 3.3, 3.9])
def test_in_front_of_a_near_object_fog_is_read_where_its_waveform_ends(object_m: float) -> None:
    """The waveform of fog of 100 m rises to 3.9 m: cut off before, it is largest at its end."""
    library, brute = drawn(100.0, 1000.0, object_m), by_brute_force(100.0, 1000.0, object_m)
    assert (library.range_m <= object_m * (1 + 1e-4)).all()  # the beam starts 0.036 m above the object's height
    # On the rising side the places are those at which the waveform comes within its noise of its end: 0.08 m at most.
    assert library.range_m.mean() == pytest.approx(brute.range_m.mean(), abs=0.1)
    # From the last step of the brute force to the object, 0.025 m, the waveform still rises: by 16 photons at 2.8 m.
    assert library.photons.mean() == pytest.approx(brute.photons.mean(), abs=0.5 * math.sqrt(PHOTONS))


def test_more_photons_are_detected_more_often(found: Found) -> None:
    for mor_m in MORS_M:
        for one in (0, 1):
            shares = [found[mor_m, peak][one].detected for peak in PEAKS]
            assert shares[0] < 0.25 < shares[1] < 0.75 < shares[2]
