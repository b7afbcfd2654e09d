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

import math
import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from parts.radar_as_published import (
    D34_CLEAR,
    clear_thresholds,
    fixed,
    number,
    published_noise_mw,
    simulator,
    white_noise,
)
from parts.radar_counts import COLUMNS, against_loss, count, loss_for, weathers
from parts.shared import command_line, write_json

import torchweather as tw
from torchweather.scenes import radar_view, test_track

D34_RAIN, D34_SNOW = 535, 543  # D3.4, Figures 35-36


def spread(values: Sequence[int]) -> str:
    deviation = statistics.stdev(values) if len(values) > 1 else 0.0
    return f"{statistics.fmean(values):.1f} +- {deviation:.1f}"


def main(argv: Sequence[str] | None = None) -> None:
    parser = command_line(__doc__)
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
    write_json(arguments.out, report)
    print_report(report, arguments.out)


def print_report(report: dict[str, Any], out: Path) -> None:
    """Print the tables."""
    rows, losses, objects = report["weather"], report["against_loss"], report["points_without_noise"]
    print(f"{report['sensor']}, {report['channels']} channels, {report['seeds']} frames of each weather")
    print(f"D3.4: {D34_CLEAR} clear, {D34_RAIN} rain, {D34_SNOW} snow")
    print("dB/km one way: here and as published; loss: as published to", f"{report['loss_range_m']:g} m and back, dB")
    print(f"{'':14}{'dB/km':>8}{'publ.':>8}{'loss':>7}   " + "".join(f"{column:^16}" for column in COLUMNS) + "alone")
    for name, row in rows.items():
        numbers = "".join(f"{spread(row['points'][column]):^16}" for column in COLUMNS)
        losses_text = f"{row['attenuation_db_per_km']:8.2f}{row['published_attenuation_db_per_km']:8.1f}"
        print(f"{name:14}{losses_text}{row['published_loss_db']:7.2f}   {numbers}{spread(row['alone'])}")
    thermal, published = report["thermal_noise_dbm"], report["published_noise_dbm"]
    print(f"noise of a sample: {thermal:.1f} dBm thermal, {published:.1f} as published")
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
    print(f"written: {out}")


if __name__ == "__main__":
    main()
