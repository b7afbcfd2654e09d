"""Draw what each effect of the LiDAR catalogue does, with no data of your own.

    python docs/_figures/lidar_effects.py --out pictures
    python docs/_figures/lidar_effects.py --out pictures lidar.window_loss lidar.spray

One picture an effect, named after it: the statistic in which it shows, along its axis, in the same weather without the
effect and at two strengths. The scene is the embedded test track, the sensor an Ouster OS1-128 with few columns; the
numbers are over all frames. The pictures of docs/effects-lidar.md are made by this script.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import lidar_pictures
import lidar_structure
import lidar_surfaces
from effect_command import parsed, write_all
from effect_panels import Picture, draw
from lidar_frames import Beams, Frames, beams_of, frames_of
from matplotlib.figure import Figure

from torchweather.atmosphere.weather import Weather

PICTURES: dict[str, Picture] = {**lidar_pictures.PICTURES, **lidar_structure.PICTURES, **lidar_surfaces.PICTURES}
FINE_FRAMES, COLOURS = 4, 64


def main() -> None:
    """Read the command line and draw."""
    arguments = parsed(
        __doc__,
        PICTURES,
        out="lidar_effects",
        frames=24,
        columns=(256, "of the scan; fewer is quicker"),
        fine_columns=(1024, "of the scan on which beams overlap"),
    )

    @lru_cache
    def scene(which: str) -> Beams:
        return beams_of(arguments.fine_columns if which == "fine" else arguments.columns)

    def simulated(which: str, weather: Weather, effect: Mapping[str, Any]) -> Frames:
        count = min(FINE_FRAMES, arguments.frames) if which == "fine" else arguments.frames
        return frames_of(scene(which), weather, [effect] if effect else [], count)

    without = lru_cache(lambda which, weather: simulated(which, weather, {}))

    def picture(name: str) -> Figure:
        drawn = PICTURES[name]

        def frames(weather: Weather, effect: Mapping[str, Any]) -> Frames:
            return simulated(drawn.scene, weather, effect) if effect else without(drawn.scene, weather)

        return draw(name, drawn, scene(drawn.scene), frames)

    write_all(arguments, PICTURES, picture, COLOURS)


if __name__ == "__main__":
    main()
