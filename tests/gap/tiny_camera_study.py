"""Small camera studies: the light of the library's own chain, with noise of the pixels behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.airlight import towards_horizon
from torchweather.camera.rays import rays_of
from torchweather.pipeline.effect import Effect
from torchweather.scenes import SCENES
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather

WIDTH, HEIGHT = 128, 96
ELECTRONS = 9000.0
CAMERA = replace(Camera.preset("lucid-triton").resized(WIDTH, HEIGHT), response_knots=None, exposure_s=0.1)
WEATHERS: dict[str, tuple[Weather, ...]] = {
    "fog": (Fog(mor_m=250.0), Fog(mor_m=100.0), Fog(mor_m=150.0)),
    "rain": (Rain(12.0), Rain(40.0), Rain(25.0)),
    "snow": (Snow(0.7), Snow(2.5), Snow(1.5)),
}
SPLITS = ("fit", "fit", "holdout")
CLEAR, FRAMES = 5, 3


@lru_cache
def view() -> Any:
    return SCENES["test-track"]().view(CAMERA)


@lru_cache
def horizon_light() -> tuple[float, float, float]:
    """Signal of the sky near the horizon by colour, over all cells of the mosaic that show nothing but sky.

    The estimate of a transform looks at every fourth row, which are 3 degrees of a frame as small as this one.
    """
    seen = view()
    sky = seen.depth_m[0].isinf()
    whole = sky[0::2, 0::2] & sky[0::2, 1::2] & sky[1::2, 0::2] & sky[1::2, 1::2]
    x, y, _ = CAMERA.ray_directions(HEIGHT, WIDTH, dtype=torch.float64)
    weight = towards_horizon(whole[None].double(), rays_of(CAMERA, x, y).sine_elevation[0, :, 0::2, 0::2])[0]
    mosaic = seen.bayer[0].double()
    light = [float((mosaic[y::2, x::2] * weight).sum() / weight.sum()) for y in (0, 1) for x in (0, 1)]
    return light[0], (light[1] + light[2]) / 2, light[3]  # of RGGB


def noisy(bayer: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shot noise of the light that arrives."""
    return np.clip(rng.poisson(np.clip(bayer, 0, 2) * ELECTRONS) / ELECTRONS, 0.0, 1.0).astype(np.float32)


def values_of(
    effects: Sequence[Effect] = (), kind: str = "fog", seed: int = 0, clear: int = CLEAR, frames: int = FRAMES
) -> dict[str, Any]:
    """Arguments of a study: the light of the library's own chain, with noise of the pixels behind it."""
    rng = np.random.default_rng(seed)
    seen = view()
    conditions = []
    for weather, split in zip(WEATHERS[kind], SPLITS, strict=True):
        true = replace(weather, **{weather.intensity_name: weather.intensity * float(np.exp(0.07 * rng.normal()))})
        transform = BayerWeather(true, CAMERA, effects=effects, airlight=horizon_light())
        made = []
        for _ in range(frames):
            noise = transform.draw(seen.bayer[None], seed=int(rng.integers(2**60)))
            with torch.no_grad():
                light = transform(seen.bayer[None], seen.depth_m[None], noise, normal=seen.normal[None])
            made.append({"bayer": noisy(light[0, 0].numpy(), rng)})
        name = f"{kind} {weather.intensity:g}"
        conditions.append(
            {"id": name, "scene": "s0", "weather": weather, "frames": made, "split": split, "rel_sd": 0.1}
        )
    geometry = {
        "depth_m": seen.depth_m[0].numpy(),
        "normal": seen.normal.movedim(0, -1).numpy(),
        "label": seen.label[0].numpy(),
    }
    still = [{"bayer": noisy(seen.bayer[0].numpy(), rng)} for _ in range(clear)]
    scene = {"id": "s0", "clear": still, "geometry": geometry}
    return {"kind": "camera", "sensor": CAMERA, "scenes": [scene], "conditions": conditions}
