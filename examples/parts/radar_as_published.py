"""Simulators of the same radar that differ in one ingredient: D3.4's noise and fixed threshold, or this library's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.radar import FmcwRadar, Scatterers

D34_CLEAR = 340  # points, D3.4, Figures 15-17
BOLTZMANN_J_PER_K = 1.380649e-23  # exact, SI
TEMPERATURE_K = 290.0
WITHOUT_GATE_DB = -100.0  # detection SNR of a radar whose only threshold is the fixed one


@dataclass(frozen=True)
class FixedThreshold:
    """In the place of a CFAR: a cell is a point where its power exceeds a constant."""

    power_mw: float

    def detect_at(self, power: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
        """Which cells exceed it; of the noise around them it knows nothing."""
        found = power[rows, columns] > self.power_mw
        return found, torch.zeros_like(power[rows, columns][found])


def nothing() -> Scatterers:
    """An empty road: what is seen there is the weather."""
    return Scatterers.from_rcs(torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64), -math.inf)


def attenuation_db_per_km(weather: Weather | None, radar: tw.Radar, variant: str | None) -> float:
    """One way, by the default models or as published."""
    return float(tw.RadarAttenuation(weather, radar, variant=variant).attenuation_db_per_km) if weather else 0.0


def published_noise_mw(radar: tw.Radar, loss_db: float, impedance_ohm: float) -> float:
    """``PNoise = 4 Z k T (f_end - f_start) / 10^(P_tx / 10)``, its square root the sigma of each of I and Q.

    The samples of this library are in sqrt(mW), those of the formula are divided by the transmit power: it is
    multiplied again here, by that of clear air. Volts squared are taken for milliwatts.
    """
    voltage = 4.0 * impedance_ohm * BOLTZMANN_J_PER_K * TEMPERATURE_K * 1e6 * radar.bandwidth_mhz
    weakened_dbm = radar.transmit_power_dbm - loss_db
    return voltage / 10.0 ** (weakened_dbm / 10.0) * 10.0 ** (radar.transmit_power_dbm / 10.0)


def white_noise(radar: tw.Radar, targets: Scatterers, seed: int) -> Tensor:
    """Unit variance in I and in Q, the numbers that the simulator of column a draws for its thermal noise."""
    drawn = FmcwRadar(radar).draw(targets, seed=seed)
    return torch.complex(drawn["thermal_noise.real"], drawn["thermal_noise.imaginary"])


def simulator(radar: tw.Radar, weather: Weather | None = None, **options: Any) -> FmcwRadar:
    return FmcwRadar(radar, weather, angles_per_cell=1, **options)


def fixed(radar: tw.Radar, power_mw: float) -> FmcwRadar:
    detector: Any = FixedThreshold(power_mw)
    return simulator(replace(radar, detection_snr_db=WITHOUT_GATE_DB), cfar=detector)


def threshold_mw(radar: tw.Radar, cubes: Sequence[Tensor], points: int) -> float:
    """The fixed threshold above which these frames have so many points on average."""
    everything = fixed(radar, 0.0)
    peaks = []
    for cube in cubes:
        result = everything.process(cube)
        doppler, column = tensor_of(result.cell).T
        peaks.append(10.0 ** (result.power_dbm[doppler, column].double() / 10.0))
    strongest = torch.cat(peaks).sort(descending=True).values
    last = points * len(cubes)
    if last >= len(strongest):
        raise ValueError(f"threshold_mw: expected {points} points a frame; the map has {len(strongest) // len(cubes)}.")
    return float((strongest[last - 1] * strongest[last]).sqrt())


def tensor_of(value: Tensor | list[Tensor]) -> Tensor:
    assert isinstance(value, Tensor)  # one frame at a time
    return value


def number(processing: FmcwRadar, cube: Tensor) -> int:
    return len(tensor_of(processing.process(cube).points))


def clear_thresholds(
    radar: tw.Radar, targets: Scatterers, noises: Sequence[Tensor], impedance_ohm: float
) -> dict[str, float]:
    """Of c and e."""
    signal = simulator(radar, noise=False).cube(targets, {})
    sigma = {"c": math.sqrt(published_noise_mw(radar, 0.0, impedance_ohm)), "e": thermal_sigma(radar)}
    return {key: threshold_mw(radar, [signal + own * w for w in noises], D34_CLEAR) for key, own in sigma.items()}


def thermal_sigma(radar: tw.Radar) -> float:
    """Of each of I and Q, sqrt(mW)."""
    return math.sqrt(0.5 * 10.0 ** (radar.noise_power_dbm / 10.0))
