"""Camera frames of the pictures of effects: the embedded test track, seen by a Lucid Triton of few pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from effect_curves import Array

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import SceneView

__all__ = ["Frames", "frames_of", "greens"]


@dataclass(frozen=True)
class Frames:
    """Simulated frames, ``(F, H, W)`` each."""

    signal: Array
    transmission: Array
    mask: Array


def frames_of(view: SceneView, weather: Weather, effects: Sequence[Mapping[str, Any]], count: int) -> Frames:
    """Frames in the weather; the same draws for all effects."""
    # The sky of the scene, also where a wall stands in front of it.
    sky = view.rgb[:, view.object_id[0] < 0].mean(1).tolist()
    transform = tw.BayerWeather(weather, view.camera, airlight=sky, effects=effects)
    found = []
    for seed in range(count):
        noise = transform.draw(view.bayer, seed=seed)
        result = transform.run(view.bayer, view.depth_m, noise, normal=view.normal)
        found.append([value[0].numpy() for value in (result.bayer, result.transmission, result.particle_mask)])
    signal, transmission, mask = (np.stack(values) for values in zip(*found, strict=True))
    return Frames(signal, transmission, mask)


def greens(values: Array) -> Array:
    """One green phase of the mosaic ``(..., H, W)``."""
    found: Array = values[..., 0::2, 1::2]
    return found
