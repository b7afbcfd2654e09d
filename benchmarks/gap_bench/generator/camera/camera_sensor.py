"""Raw frames of a street in a weather: light through the air, the window and the lens onto noisy pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from torchweather.atmosphere.weather import Fog
from torchweather.physics import extinction_per_m
from torchweather.sensors import Camera

from .particles import EXPOSURE_S, Streaks, draw, optical_depth
from .scene import SKY, Eye, FloatArray, Street

__all__ = ["CFA", "Effect", "Shot", "Weather", "shoot", "study_camera"]

ELECTRONS, READ_ELECTRONS, LEVELS = 9000.0, 4.0, 4095
DROP_SKY, FLAKE_ALBEDO = 0.06, 0.9  # shares of the sky's light
SKY_STEP = 16  # px between the places at which the light of the sky is taken

CFA = np.array([[0, 1], [1, 2]])  # RGGB


def study_camera(eye: Eye) -> Camera:
    """The camera as the study says it is."""
    return Camera.from_intrinsics(
        eye.focal_px,
        eye.focal_px,
        0.5 * (eye.width - 1),
        0.5 * (eye.height - 1),
        eye.width,
        eye.height,
        exposure_s=EXPOSURE_S,
    )


@dataclass(frozen=True)
class Weather:
    """``clear``, ``fog`` of a visibility (m), ``rain`` or ``snow`` of a rate (mm/h)."""

    kind: str = "clear"
    amount: float = 0.0


@dataclass
class Shot:
    """A frame in the making: what effects may change.

    Args:
        street, weather: that are seen.
        rng: of the frame.
        pattern_rng: of the condition: the same for each of its frames.
        number, frames: of the frame, and how many the condition has.
        scene: ``(H, W, 3)`` light of the scene.
        sky: ``(3,)`` light of the sky.
        extinction_per_m: ``(3,)``.
        density: ``(H, W)`` mean density of the fog along each ray, 1.
        count, reach_m, contrast: of particles.
    """

    street: Street
    weather: Weather
    rng: np.random.Generator
    pattern_rng: np.random.Generator
    number: int
    frames: int
    scene: FloatArray
    sky: FloatArray
    extinction_per_m: FloatArray
    density: FloatArray
    count: float = 1.0
    reach_m: float = np.inf
    contrast: float = 1.0
    optical_depth: FloatArray = field(default_factory=lambda: np.zeros(()))


class Effect:
    """What may be wrong with a camera or with the weather; each method is one place on the way of the light."""

    def on_scene(self, shot: Shot) -> None:
        """Changes what is there: surfaces, air, number of particles."""

    def on_streaks(self, shot: Shot, streaks: Streaks) -> None:
        """Changes particles."""

    def on_air(self, shot: Shot, light: FloatArray) -> FloatArray:
        """Changes the light behind the fog, in front of particles."""
        return light

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        """Changes the light that comes through window and lens."""
        return light

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        """Changes the mosaic ``(H, W)`` with its noise, in units of saturation."""
        return signal


@lru_cache(maxsize=512)
def fog_extinction(mor_m: float, bands_nm: tuple[float, ...]) -> FloatArray:
    """Mie extinction of a fog at each band, 1/m."""
    droplets = Fog(mor_m).distribution()
    return np.array([float(extinction_per_m(droplets, band)) for band in bands_nm])


def shoot(
    street: Street,
    weather: Weather,
    effects: tuple[Effect, ...],
    frames: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Raw frames ``(frames, H, W)``, linear, black 0, saturation 1.

    Args:
        street: that is seen.
        weather: as it truly is.
        effects: that act.
        frames: how many.
        rng: of everything random.
    """
    pattern_seed = int(rng.integers(2**31))
    bands = tuple(study_camera(street.eye).bands.values())
    found = []
    for number in range(frames):
        extinction = fog_extinction(weather.amount, bands) if weather.kind == "fog" else np.zeros(3)
        sky = street.colour[::SKY_STEP, ::SKY_STEP][street.label[::SKY_STEP, ::SKY_STEP] == SKY].mean(0)
        shot = Shot(
            street,
            weather,
            rng,
            np.random.default_rng(pattern_seed),
            number,
            frames,
            street.colour.copy(),
            sky.copy(),
            extinction,
            np.ones(street.depth_m.shape),
        )
        found.append(_frame(shot, effects))
    return np.stack(found)


def _frame(shot: Shot, effects: tuple[Effect, ...]) -> FloatArray:
    for effect in effects:
        effect.on_scene(shot)
    light, street = shot.scene, shot.street
    if shot.weather.kind == "fog":
        ray_m = np.minimum(street.depth_m, 1e9) * street.ray_per_depth
        shot.optical_depth = ray_m * shot.density
        seen = np.exp(-shot.optical_depth[..., None] * shot.extinction_per_m)
        light = light * seen + np.minimum(shot.sky, 1.0) * (1.0 - seen)
        for effect in effects:
            light = effect.on_air(shot, light)
    elif shot.weather.kind in ("rain", "snow"):
        streaks = draw(street, shot.weather.kind, shot.weather.amount, shot.count, shot.reach_m, shot.rng)
        for effect in effects:
            effect.on_streaks(shot, streaks)
        covered = -np.expm1(-optical_depth(street, streaks, shot.rng))[..., None]
        if shot.weather.kind == "snow":
            # From all around, half of it from the ground and what stands on it.
            ground = light[street.eye.rays[1] > 0.0].mean(0)
            colour = 0.5 * FLAKE_ALBEDO * (shot.sky + ground)
        else:
            colour = (1.0 - DROP_SKY) * light.mean((0, 1)) + DROP_SKY * shot.sky
        light = np.maximum(light + shot.contrast * covered * (colour - light), 0.0)
    for effect in effects:
        light = effect.on_light(shot, light)
    signal = mosaic(light)
    electrons = shot.rng.poisson(np.clip(signal, 0.0, 4.0) * ELECTRONS) + shot.rng.normal(
        0, READ_ELECTRONS, signal.shape
    )
    signal = np.clip(electrons / ELECTRONS, 0.0, 1.0)
    for effect in effects:
        signal = effect.on_electrons(shot, signal)
    return np.asarray(np.rint(np.clip(signal, 0.0, 1.0) * LEVELS) / LEVELS)


def mosaic(light: FloatArray) -> FloatArray:
    """The colour of each pixel's filter, ``(H, W)``."""
    found = np.empty(light.shape[:2])
    for row in (0, 1):
        for column in (0, 1):
            found[row::2, column::2] = light[row::2, column::2, CFA[row, column]]
    return found
