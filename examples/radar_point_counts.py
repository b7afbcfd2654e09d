"""Why a simulated radar may see more points in rain than in clear air: D3.4's counts, ingredient by ingredient.

    python examples/radar_point_counts.py
    python examples/radar_point_counts.py --sensor imaging-77ghz --seeds 3

D3.4 reports 340 points in clear air, 535 in rain and 543 in snow. Five simulators count the points of one scene (the
embedded test track with cars at 28 and 56 m and two corner reflectors; nothing moves), in the same weathers and with
the same random numbers:

a   this library: thermal noise k T0 B F, attenuation, echoes of rain and snow, CFAR
b   the same without the echoes of rain and snow
c   the noise model as published, the weather's loss taken off its transmit power, and a fixed threshold
d   the noise of c, with the CFAR of b
e   the thermal noise of b, with a fixed threshold

The thresholds of c and e are those that give 340 points in clear air. Each cell of the map gives one point at most, so
that columns compare. "Alone" is what column a sees of the weather on an empty road. Writes ``radar_point_counts.json``.

Assumed, because the published simulator is not at hand (only its noise formula is): the scene and the sensor; samples
in units of the transmit power, so that a loss taken off the transmit power raises the noise against them and leaves the
signal to the radar equation; impedance 50 ohm and temperature 290 K; one loss a frame, that of the way to
``--loss-range-m`` and back; attenuations as published (Sander, 0.182 LWC f^2, Norouziari) in c and d.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.core.errors import TorchweatherWarning
from torchweather.io import atomic_write
from torchweather.radar import FmcwRadar, Scatterers
from torchweather.scenes import radar_view, test_track

D34_CLEAR, D34_RAIN, D34_SNOW = 340, 535, 543  # D3.4, Figures 15-17, 35-36
RAIN_MM_PER_H, FOG_M, SNOW_MM_PER_H = (10.0, 25.0, 50.0), (10, 20, 30, 50), (1.0, 19.0)
LOSSES_DB = (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
COLUMNS = ("a", "b", "c", "d", "e")
BOLTZMANN_J_PER_K = 1.380649e-23  # exact, SI
TEMPERATURE_K = 290.0
AS_PUBLISHED = {"rain_model": "d3_4", "fog_model": "d3_4", "snow_model": "d3_4"}
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


def weathers() -> dict[str, Weather | None]:
    found: dict[str, Weather | None] = {"clear": None}
    found |= {f"rain {rate:g} mm/h": tw.Rain(rate_mm_per_h=rate) for rate in RAIN_MM_PER_H}
    found |= {f"fog {mor_m} m": tw.Fog.rehearse(mor_m) for mor_m in FOG_M}
    with warnings.catch_warnings():
        # 19 mm/h is D3.4's own, beyond what the flakes' sizes were fitted to.
        warnings.simplefilter("ignore", TorchweatherWarning)
        found |= {f"snow {rate:g} mm/h": tw.Snow(rate_mm_per_h=rate) for rate in SNOW_MM_PER_H}
    return found


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
        raise ValueError(f"threshold_mw: wanted {points} points a frame; the map has {len(strongest) // len(cubes)}.")
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


def count(
    radar: tw.Radar,
    targets: Scatterers,
    weather: Weather | None,
    noises: Sequence[Tensor],
    thresholds: dict[str, float],
    loss_range_m: float,
    impedance_ohm: float,
) -> dict[str, Any]:
    """Points of each column and seed in one weather."""
    published = attenuation_db_per_km(weather, radar, "d3_4")
    loss_db = 2e-3 * loss_range_m * published
    sigma = math.sqrt(published_noise_mw(radar, loss_db, impedance_ohm))
    full, bare = simulator(radar, weather), simulator(radar, weather, clutter=False)
    signal = simulator(radar, weather, noise=False, clutter=False).cube(targets, {})
    as_published = simulator(radar, weather, noise=False, clutter=False, **AS_PUBLISHED).cube(targets, {})
    counts: dict[str, list[int]] = {column: [] for column in COLUMNS}
    alone: list[int] = []
    ranges: list[float] = []
    speeds: list[float] = []
    for seed, noise in enumerate(noises):
        drawn = full.draw(targets, seed=seed)
        counts["a"].append(len(tensor_of(full(targets, drawn))))
        own = tensor_of(full(nothing(), drawn))
        alone.append(len(own))
        ranges += torch.linalg.vector_norm(own[:, :3], dim=1).tolist()
        speeds += own[:, 3].tolist()
        counts["b"].append(number(bare, signal + thermal_sigma(radar) * noise))
        counts["c"].append(number(fixed(radar, thresholds["c"]), as_published + sigma * noise))
        counts["d"].append(number(bare, as_published + sigma * noise))
        counts["e"].append(number(fixed(radar, thresholds["e"]), signal + thermal_sigma(radar) * noise))
    return {
        "attenuation_db_per_km": attenuation_db_per_km(weather, radar, None),
        "published_attenuation_db_per_km": published,
        "published_loss_db": loss_db,
        "points": counts,
        "alone": alone,
        "alone_range_m": ranges,
        "alone_speed_m_per_s": speeds,
    }


def against_loss(
    radar: tw.Radar, targets: Scatterers, noises: Sequence[Tensor], power_mw: float, impedance_ohm: float
) -> dict[str, list[float]]:
    """Mean points of c where the frame loses so much: the signal weaker by the loss and the noise stronger by it."""
    signal = simulator(radar, noise=False).cube(targets, {})
    detector = fixed(radar, power_mw)
    found: dict[str, list[float]] = {"loss_db": list(LOSSES_DB), "both": [], "signal weaker only": []}
    for loss_db in LOSSES_DB:
        weaker = 10.0 ** (-loss_db / 20.0) * signal
        for name, noise_loss_db in (("both", loss_db), ("signal weaker only", 0.0)):
            sigma = math.sqrt(published_noise_mw(radar, noise_loss_db, impedance_ohm))
            found[name].append(statistics.fmean(number(detector, weaker + sigma * noise) for noise in noises))
    return found


def loss_for(points: int, table: dict[str, list[float]]) -> float:
    """Loss at which c has so many points, between the tabulated ones."""
    losses, counts = table["loss_db"], table["both"]
    for k in range(1, len(losses)):
        if counts[k - 1] <= points < counts[k]:
            return losses[k - 1] + (points - counts[k - 1]) / (counts[k] - counts[k - 1]) * (losses[k] - losses[k - 1])
    return math.nan


def spread(values: Sequence[int]) -> str:
    deviation = statistics.stdev(values) if len(values) > 1 else 0.0
    return f"{statistics.fmean(values):.1f} +- {deviation:.1f}"


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", default="awr1843-like", help="a radar preset")
    parser.add_argument("--one-channel", action="store_true", help="its first transmitter and receiver only")
    parser.add_argument("--seeds", type=int, default=20, help="frames of each weather")
    parser.add_argument("--weather", nargs="+", help="some of the weathers only, such as 'rain 50 mm/h'")
    parser.add_argument("--loss-range-m", type=float, default=28.0, help="c and d: range of the loss taken off")
    parser.add_argument("--impedance-ohm", type=float, default=50.0, help="c and d: Z, 50 (line) or 377 (free space)")
    parser.add_argument("--out", type=Path, default=Path("radar_point_counts.json"), help="numbers to write")
    arguments = parser.parse_args(argv)
    if arguments.seeds < 1:
        parser.error(f"--seeds must be 1 or more; got {arguments.seeds}")
    every = weathers()
    unknown = [name for name in arguments.weather or () if name not in every]
    if unknown:
        parser.error(f"--weather: unknown {', '.join(unknown)}; there are {', '.join(every)}")
    chosen = [name for name in every if name == "clear" or not arguments.weather or name in arguments.weather]

    radar = tw.Radar.preset(arguments.sensor)
    if arguments.one_channel:
        radar = replace(radar, tx_half_wavelengths=((0.0, 0.0),), rx_half_wavelengths=((0.0, 0.0),))
    targets = radar_view(test_track(), radar).scatterers
    noises = [white_noise(radar, targets, seed) for seed in range(arguments.seeds)]
    assumed = (arguments.loss_range_m, arguments.impedance_ohm)
    thresholds = clear_thresholds(radar, targets, noises, arguments.impedance_ohm)
    rows = {name: count(radar, targets, every[name], noises, thresholds, *assumed) for name in chosen}
    losses = against_loss(radar, targets, noises, thresholds["c"], arguments.impedance_ohm)
    signal = simulator(radar, noise=False).cube(targets, {})
    objects = {key: number(fixed(radar, value), signal) for key, value in thresholds.items()}
    mean_noise_mw = 2.0 * published_noise_mw(radar, 0.0, arguments.impedance_ohm)
    report = {
        "torchweather": tw.__version__,
        "sensor": arguments.sensor,
        "channels": radar.virtual_channels,
        "seeds": arguments.seeds,
        "loss_range_m": arguments.loss_range_m,
        "impedance_ohm": arguments.impedance_ohm,
        "thermal_noise_dbm": radar.noise_power_dbm,
        "published_noise_dbm": 10.0 * math.log10(mean_noise_mw),
        "thresholds_dbm": {key: 10.0 * math.log10(value) for key, value in thresholds.items()},
        "points_without_noise": objects,
        "weather": rows,
        "against_loss": losses,
        "loss_db_for_rain_count": loss_for(D34_RAIN, losses),
        "loss_db_for_snow_count": loss_for(D34_SNOW, losses),
    }
    with atomic_write(arguments.out) as unfinished:
        unfinished.write_text(json.dumps(report, indent=1), encoding="utf-8")

    print(f"{arguments.sensor}, {radar.virtual_channels} channels, {arguments.seeds} frames of each weather")
    print(f"D3.4: {D34_CLEAR} clear, {D34_RAIN} rain, {D34_SNOW} snow")
    print("dB/km one way: here and as published; loss: as published to", f"{arguments.loss_range_m:g} m and back, dB")
    print(f"{'':14}{'dB/km':>8}{'publ.':>8}{'loss':>7}   " + "".join(f"{column:^16}" for column in COLUMNS) + "alone")
    for name, row in rows.items():
        numbers = "".join(f"{spread(row['points'][column]):^16}" for column in COLUMNS)
        losses_text = f"{row['attenuation_db_per_km']:8.2f}{row['published_attenuation_db_per_km']:8.1f}"
        print(f"{name:14}{losses_text}{row['published_loss_db']:7.2f}   {numbers}{spread(row['alone'])}")
    print(
        f"noise of a sample: {radar.noise_power_dbm:.1f} dBm thermal, {report['published_noise_dbm']:.1f} as published"
    )
    print("alone: range of 50 and 95 % of the points, standard deviation of their speeds")
    for name, row in rows.items():
        if len(row["alone_range_m"]) > 1:
            half, most = torch.tensor(row["alone_range_m"]).quantile(torch.tensor([0.5, 0.95])).tolist()
            print(f"{name:14}{half:8.1f} m{most:8.1f} m{statistics.stdev(row['alone_speed_m_per_s']):8.2f} m/s")
    print(f"of the {D34_CLEAR} points in clear air, without noise: {objects['c']} in c, {objects['e']} in e")
    print("c, points against the loss of the frame: noise stronger and signal weaker, or the signal alone")
    for loss_db, both, alone in zip(losses["loss_db"], losses["both"], losses["signal weaker only"], strict=True):
        print(f"{loss_db:8.2f} dB {both:10.1f} {alone:10.1f}")
    for points in (D34_RAIN, D34_SNOW):
        print(f"{points} points at {loss_for(points, losses):.2f} dB")
    print(f"written: {arguments.out}")


if __name__ == "__main__":
    main()
