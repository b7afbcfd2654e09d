"""Draw what each effect of the radar catalogue does, with no data of your own.

    python docs/_figures/radar_effects.py --out pictures
    python docs/_figures/radar_effects.py --out pictures radar.wet_radome radar.multipath

One picture an effect, named after it: the statistic in which it shows, along its axis, in the same weather without the
effect and at two strengths. The targets are made up: at rest, of three classes, evenly spread in range, azimuth and
margin over the detection threshold. The radar is the embedded AWR1843-like one. The pictures of docs/effects-radar.md
are made by this script.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from effect_command import parsed, write_all
from effect_panels import draw
from matplotlib.figure import Figure
from radar_frames import Frames, frames_of, targets_of
from radar_pictures import PICTURES

from torchweather.atmosphere.weather import Weather

TARGETS = {"usual": 2048, "few": 256}
COLOURS = 64


def main() -> None:
    """Read the command line and draw."""
    arguments = parsed(__doc__, PICTURES, out="radar_effects", frames=24)
    targets = lru_cache(targets_of)

    def picture(name: str) -> Figure:
        drawn = PICTURES[name]
        scene = targets(TARGETS[drawn.scene])

        def frames(weather: Weather, effect: Mapping[str, Any]) -> Frames:
            return frames_of(scene, weather, effect, arguments.frames)

        return draw(name, drawn, scene, frames)

    write_all(arguments, PICTURES, picture, COLOURS)


if __name__ == "__main__":
    main()
