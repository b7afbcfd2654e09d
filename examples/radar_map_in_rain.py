"""A radar power map in clear air and in rain, from above.

    python examples/radar_map_in_rain.py --out radar_map.png
    python examples/radar_map_in_rain.py --map frame.png --layout radiate --rate 25

Without ``--map`` a frame is made up: a street with houses, cars and posts, as a radar that turns records it.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import torch
from torch import Tensor

import torchweather as tw
from torchweather.io import MAP_LAYOUTS, atomic_write, read_power_map
from torchweather.radar.power_map import (
    MapAxes,
    PowerScale,
    RadarPowerMap,
    map_detections,
    noise_floor_db,
    with_noise_scale,
)
from torchweather.report.map_picture import map_picture

NOISE_DB = 10.0  # of the bytes: 20 steps of 0.5 dB
RADAR = tw.Radar.preset("navtech-radiate")
AXES = MapAxes.of_turn(bins=576, bin_m=0.17361, azimuths=400, dims=("range", "azimuth"))


def street() -> Tensor:
    """Places and echoes of targets, ``(N, 3)``: forward m, left m, dB over the noise."""
    generator = torch.Generator().manual_seed(4)
    along = torch.arange(-90.0, 90.0, 0.15)
    targets = []
    for side, gap in ((12.0, 20.0), (-14.0, 32.0)):  # fronts of houses
        front = along[torch.remainder(along, gap) > 0.25 * gap]
        facade = 25.0 + 8.0 * torch.randn(len(front), generator=generator)
        targets.append(torch.stack([front, torch.full_like(front, side), facade], 1))
    for k in range(-8, 9):  # posts and parked cars
        targets.append(torch.tensor([[11.0 * k, 6.5, 40.0], [11.0 * k + 4.0, -7.0, 32.0]]))
        car = 11.0 * k + torch.linspace(0.0, 4.2, 12)
        targets.append(torch.stack([car, torch.full_like(car, -5.5), torch.full_like(car, 35.0)], 1))
    return torch.cat(targets)


def made_up() -> RadarPowerMap:
    """The street as bytes of 0.5 dB: fields of the targets and of the receiver's noise."""
    range_m, azimuth = AXES.axis("range").float(), AXES.axis("azimuth").float()
    generator = torch.Generator().manual_seed(5)
    noise = torch.randn(2, *AXES.shape, generator=generator) * math.sqrt(0.5)
    field = torch.complex(noise[0], noise[1])
    beam = math.radians(RADAR.azimuth_beamwidth_deg)
    for forward, left, level_db in street().tolist():
        distance, angle = math.hypot(forward, left), math.atan2(left, forward)
        if distance < 3.0 or distance > 99.0:
            continue
        off = torch.remainder(azimuth - angle + math.pi, 2.0 * math.pi) - math.pi
        bins = (range_m - distance) / RADAR.range_resolution_m
        window = torch.sinc(bins) + 0.5 * (torch.sinc(bins - 1.0) + torch.sinc(bins + 1.0))
        pattern = torch.exp(-4.0 * math.log(2.0) * (off / beam).square())  # both ways together
        phase = 2.0 * math.pi * float(torch.rand((), generator=generator))
        wave = complex(math.cos(phase), math.sin(phase)) * 10 ** (level_db / 20.0)
        field += wave * window[:, None] * pattern
    scale = PowerScale.steps(0.5)
    decibels = 10.0 * field.abs().square().log10() + NOISE_DB
    return RadarPowerMap(scale.stored(decibels, torch.zeros(0, dtype=torch.uint8)), AXES, scale)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", type=Path, help="a recorded map; default a made-up one")
    parser.add_argument("--layout", default="radiate", help=f"{', '.join(MAP_LAYOUTS)}, or a YAML file")
    parser.add_argument("--rate", type=float, default=50.0, help="of the rain, mm/h; default 50")
    parser.add_argument("--out", type=Path, default=Path("radar_map.png"))
    args = parser.parse_args()

    clear = made_up() if args.map is None else read_power_map(args.map, args.layout)
    if clear.scale.kind == "db_steps":
        clear = with_noise_scale(clear)
    floor_db = noise_floor_db(clear)
    rain = tw.RadarMapWeather(tw.Rain(args.rate), RADAR, axes=clear.axes, scale=clear.scale, noise_floor_db=floor_db)
    wet = rain.of_map(clear, seed=0)
    result = rain.run(clear.values, rain.draw(clear.values, seed=0))
    print(f"noise floor {floor_db:.1f} dB, rain up to {float(result.clutter_db.max()):.0f} dB over it")
    print(f"two-way loss at {clear.axes.range_m[-1]:.0f} m: {float(result.attenuation_db.max()):.1f} dB")
    counts = [len(map_detections(one, RADAR, noise_db=floor_db)) for one in (clear, wet)]
    print(f"detections of a CFAR: {counts[0]} clear, {counts[1]} in rain")
    picture = map_picture({"clear": clear, f"rain, {args.rate:g} mm/h": wet}, floor_db)
    with atomic_write(args.out) as unfinished:
        unfinished.write_bytes(picture)
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
