"""Draw what each effect of the camera catalogue does, with no data of your own.

    python docs/_figures/camera_effects.py --out pictures
    python docs/_figures/camera_effects.py --out pictures camera.defocus camera.wet_surface

One picture an effect, named after it. Left: the statistic in which it shows, along its axis, in the same weather
without the effect and at two strengths. Right: a frame without it and one at the greater strength. The scene is the
embedded test track, seen by a Lucid Triton of few pixels; curves are over all frames. The pictures of
docs/effects-camera.md are made by this script.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import torch
from camera_frames import Frames, frames_of
from camera_picture import draw
from camera_pictures import PICTURES
from effect_command import parsed, write_all
from matplotlib.figure import Figure

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import SceneView, test_track

COLOURS = 96


def main() -> None:
    """Read the command line and draw."""
    arguments = parsed(
        __doc__,
        PICTURES,
        out="camera_effects",
        frames=16,
        width=(480, "of the frame in pixels, a multiple of 8; fewer is quicker"),
    )
    camera = tw.Camera.preset("lucid-triton").resized(arguments.width, arguments.width * 3 // 4)
    view = test_track().view(camera)

    @lru_cache
    def at_depth(depth_m: float | None) -> SceneView:
        if depth_m is None:
            return view
        return replace(view, depth_m=torch.full_like(view.depth_m, depth_m))

    without = lru_cache(lambda weather, depth_m: frames_of(at_depth(depth_m), weather, (), arguments.frames))

    def frames(weather: Weather, effect: Mapping[str, Any], depth_m: float | None) -> Frames:
        if not effect:
            return without(weather, depth_m)
        return frames_of(at_depth(depth_m), weather, [effect], arguments.frames)

    def picture(name: str) -> Figure:
        return draw(name, PICTURES[name], view, frames)

    write_all(arguments, PICTURES, picture, COLOURS)


if __name__ == "__main__":
    main()
