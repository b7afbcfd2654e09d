"""Draw what the effects of the structure of rain and snow do: density by direction, sizes, one particle in two beams.

    python examples/draw_lidar_structure.py --out pictures
    python examples/draw_lidar_structure.py --out pictures lidar.particle_sizes

Scene, sensor and style are those of ``draw_lidar_effects.py``; pictures of docs/effects-lidar.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from draw_lidar_effects import (
    LIGHT_SNOW,
    SNOW,
    Array,
    Beams,
    Curve,
    Frames,
    FromAbove,
    Lines,
    Picture,
    beams_of,
    bins,
    brightness,
    counts,
    draw,
    frames_of,
    in_bins,
    save,
)

from torchweather.atmosphere.weather import Weather
from torchweather.report.figures import STYLE
from torchweather.stages import EFFECTS

FINE_COLUMNS, FINE_FRAMES = 1024, 4  # of the scan on which beams overlap
APART_CM = 2.0 * np.arange(26)


def particle_share(beams: Beams, frames: Frames, axis: str, edges: Array) -> Curve:
    """Beams into the sky that return a particle, percent."""
    shown = 100.0 * frames.particle[:, ~beams.hit]
    return in_bins(np.broadcast_to(getattr(beams, axis)[~beams.hit], shown.shape), shown, edges)


def apart_of_neighbours(beams: Beams, frames: Frames) -> Curve:
    """Pairs of particle returns beside each other in a ring, by how far apart they are in range."""
    rows, columns = beams.grid
    range_m = frames.range_m.reshape(-1, rows, columns)
    both = frames.particle.reshape(-1, rows, columns)
    pairs = both[..., 1:] & both[..., :-1]
    apart_cm = 100.0 * np.abs(np.diff(range_m, axis=-1))[pairs]
    number, _ = np.histogram(apart_cm, APART_CM)
    return 0.5 * (APART_CM[1:] + APART_CM[:-1]), number / len(frames.kind)


PICTURES: dict[str, Picture] = {
    "lidar.particle_density_azimuth": Picture(
        LIGHT_SNOW,
        ({"amplitude": 2.0}, {"amplitude": 2.0, "wind_amplitude": 0.6}),
        (
            Lines(
                partial(particle_share, axis="azimuth_deg", edges=bins(-180, 180, 10)),
                "azimuth, degrees",
                "sky beams with a particle, %",
                zero=True,
                more={"xlim": (180, -180), "xticks": (180, 90, 0, -90, -180)},
            ),
            FromAbove(15.0),
        ),
        common={"azimuth_rad": math.pi, "width_rad": 1.0},
        legend=(0, "lower left"),
    ),
    "lidar.particle_density_elevation": Picture(
        LIGHT_SNOW,
        ({"amplitude": 2.0}, {"amplitude": 2.0, "steepness": 8.0}),
        (
            Lines(
                partial(particle_share, axis="elevation_deg", edges=bins(0, 23, 1)),
                "elevation, degrees",
                "sky beams with a particle, %",
                zero=True,
            ),
        ),
        common={"elevation_rad": 0.1, "width_rad": 0.15},
    ),
    "lidar.particle_sizes": Picture(
        SNOW, ({"factor_1mm": 5.0}, {"factor_4mm": 5.0}), (counts, brightness), legend=(1, "upper right")
    ),
    "lidar.shared_particles": Picture(
        SNOW,
        ({"share": 0.5}, {"share": 1.0}),
        (
            Lines(
                apart_of_neighbours,
                "neighbouring particle returns: apart in range, cm",
                "pairs in a frame",
                zero=True,
                steps=True,
            ),
        ),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="ids such as lidar.particle_sizes; all by default")
    parser.add_argument("--out", type=Path, default=Path("lidar_effects"), help="folder")
    parser.add_argument("--frames", type=int, default=24, help="over which statistics are taken")
    parser.add_argument("--columns", type=int, default=256, help="of the scan; fewer is quicker")
    parser.add_argument("--fine-columns", type=int, default=FINE_COLUMNS, help="of the scan on which beams overlap")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.effects) - set(PICTURES))
    if unknown:
        parser.error(f"no such effect: {', '.join(unknown)}; known are {', '.join(PICTURES)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.effects or PICTURES:
        fine = name == "lidar.shared_particles"
        beams = beams_of(arguments.fine_columns if fine else arguments.columns)
        count = min(FINE_FRAMES, arguments.frames) if fine else arguments.frames

        def frames(
            weather: Weather, effects: tuple[Mapping[str, Any], ...], beams: Beams = beams, count: int = count
        ) -> Frames:
            return frames_of(beams, weather, effects, count)

        path = arguments.out / f"{name}.png"
        with mpl.rc_context({**STYLE, "font.size": 9.0}):
            save(draw(name, beams, frames, PICTURES[name]), path)
        print(f"{EFFECTS[name].title}: {path}")


if __name__ == "__main__":
    main()
