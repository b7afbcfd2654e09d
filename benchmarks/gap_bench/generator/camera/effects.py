"""The nineteen effects of the catalogue, each written anew; ``same_form`` says where the form is the catalogue's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy import ndimage, special

from .camera_sensor import Effect, Shot
from .particles import EXPOSURE_S, Crowd, Streaks
from .scene import FloatArray

__all__ = ["CATALOGUE", "Known"]


@dataclass
class Known(Effect):
    """An effect with one strength that is swept.

    Class attributes:
        name: in the catalogue.
        swept: parameter that is swept, from ``weak`` at strength 0 to ``strong`` at 1, geometrically, away from its
            ``identity``; an infinite one from large to small.
        weathers: in which it shows.
        given: strength of one that no mean over frames shows, and so no d' tells.
    """

    parameters: dict[str, float] = field(default_factory=dict)

    name: ClassVar[str]
    swept: ClassVar[str]
    weak: ClassVar[float]
    strong: ClassVar[float]
    identity: ClassVar[float] = 0.0
    same_form: ClassVar[bool] = True
    weathers: ClassVar[tuple[str, ...]] = ("rain", "fog", "snow")
    shows_along: ClassVar[tuple[str, ...]] = ()
    others: ClassVar[dict[str, float]] = {}
    given: ClassVar[float | None] = None

    @classmethod
    def at(cls, strength: float) -> Known:
        """The effect at a strength in 0..1."""
        size = cls.weak * (cls.strong / cls.weak) ** strength
        return cls({**cls.others, cls.swept: cls.identity + size if np.isfinite(cls.identity) else size})

    @property
    def value(self) -> float:
        """Of the swept parameter."""
        return self.parameters[self.swept]


class ExposureGain(Known):
    name, swept, weak, strong, identity = "camera.exposure_gain", "factor", 5e-4, 0.3, 1.0

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        return light * self.value


class AirlightScale(Known):
    name, swept, weak, strong, identity = "camera.airlight_scale", "blue", 5e-4, 0.3, 1.0
    weathers, others = ("fog", "snow"), {"red": 1.0, "green": 1.0}

    def on_scene(self, shot: Shot) -> None:
        shot.sky = shot.sky * np.array([self.parameters[name] for name in ("red", "green", "blue")])


class ExtinctionScale(Known):
    name, swept, weak, strong, identity = "camera.extinction_scale", "wavelength_exponent", 0.003, 1.0, 0.0
    weathers, others = ("fog",), {"factor": 1.0}

    def on_scene(self, shot: Shot) -> None:
        bands = np.array([600.0, 530.0, 460.0])
        shot.extinction_per_m = shot.extinction_per_m * self.parameters["factor"] * (bands / 550.0) ** -self.value


class StrayLight(Known):
    name, swept, weak, strong = "camera.stray_light", "offset", 2e-5, 0.05
    others: ClassVar[dict[str, float]] = {"share": 0.0}

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        return light + self.value


class AerosolGlow(Known):
    """The glow of each optical depth is an exponential, not a Gaussian, of the same width."""

    name, swept, weak, strong, same_form = "camera.aerosol_glow", "share_per_optical_depth", 2e-5, 1.0, False
    weathers, others = ("fog",), {"width_px_per_optical_depth": 4.0}

    def on_air(self, shot: Shot, light: FloatArray) -> FloatArray:
        depth = np.minimum(shot.optical_depth * shot.extinction_per_m[1], 80.0)
        share = -np.expm1(-self.value * depth)
        width = np.minimum(self.parameters["width_px_per_optical_depth"] * depth, 32.0)
        edges = np.array([0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
        found, levels = np.zeros_like(light), []
        for sigma in edges:
            levels.append(light if sigma == 0 else _exponential(light, sigma))
        place = np.clip(np.interp(width, edges, np.arange(len(edges))), 0, len(edges) - 1 - 1e-9)
        low, part = np.floor(place).astype(int), place - np.floor(place)
        stack = np.stack(levels)
        rows, columns = np.indices(low.shape)
        found = stack[low, rows, columns] * (1 - part[..., None]) + stack[low + 1, rows, columns] * part[..., None]
        return light + share[..., None] * (found - light)


def _exponential(light: FloatArray, sigma: float) -> FloatArray:
    """Two Gaussians whose mixture has the variance of one and the tail of an exponential."""
    narrow, wide = (ndimage.gaussian_filter(light, (s * sigma, s * sigma, 0), mode="nearest") for s in (0.6, 1.5))
    share = (1.0 - 0.36) / (2.25 - 0.36)
    return np.asarray((1 - share) * narrow + share * wide)


class Defocus(Known):
    """A Gaussian of the disk's variance."""

    name, swept, weak, strong, same_form = "camera.defocus", "radius_px", 0.05, 3.0, False

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        reach = 3 + int(np.ceil(2.5 * self.value))
        # The discrete Gaussian: of samples of the continuous one a narrow one would be hardly any blur.
        weights = special.ive(np.arange(-reach, reach + 1), 0.25 * self.value**2)
        return _blurred(_blurred(light, weights, 0), weights, 1)


class EgoBlur(Known):
    name, swept, weak, strong = "camera.ego_blur", "length_px", 0.1, 8.0
    others: ClassVar[dict[str, float]] = {"angle_rad": 0.0}

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        return _blurred(light, path_weights(self.value), 1)


def path_weights(length_px: float) -> FloatArray:
    """Weights of the pixels along a path: even ones and two weaker ends, of the path's variance ``length^2 / 12``.

    Shares of whole pixels would be no blur at all for a path of less than one.
    """
    half = int((np.hypot(length_px, 1.0) - 1.0) / 2.0)
    inner = np.arange(-half, half + 1)
    own, beyond = float((inner**2).sum()), 2.0 * (half + 1) ** 2
    variance, count = length_px**2 / 12.0, len(inner)
    # count a + 2 b = 1; own a + beyond b = variance
    end = (variance - own / count) / (beyond - 2.0 * own / count)
    return np.concatenate([[end], np.full(count, (1.0 - 2.0 * end) / count), [end]])


def _blurred(light: FloatArray, weights: FloatArray, axis: int) -> FloatArray:
    """Convolved along an axis with symmetric weights; the picture's edge is continued."""
    return np.asarray(ndimage.correlate1d(light, weights / weights.sum(), axis=axis, mode="nearest"))


class AdherentDrops(Known):
    """Drops of one size with a smooth rim."""

    name, swept, weak, strong, same_form = "camera.adherent_drops", "cover", 2e-5, 0.3, False

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        height, width = light.shape[:2]
        number = 18
        square = -np.log1p(-self.value) * height * width / number / np.pi
        rows, columns = np.arange(height)[:, None], np.arange(width)
        clear = np.ones((height, width))
        for u, v in shot.pattern_rng.random((number, 2)):
            aside = np.abs(columns - u * width)
            along = np.abs(rows - v * height)
            aside, along = np.minimum(aside, width - aside), np.minimum(along, height - along)
            clear *= 1.0 - np.exp(-(((aside**2 + along**2) / square) ** 2) * np.pi / 4.0)
        return light + (1.0 - clear)[..., None] * (light.mean((0, 1)) - light)


class Vignetting(Known):
    """A square of the image radius in place of the power of a cosine."""

    name, swept, weak, strong, same_form = "camera.vignetting", "strength", 1e-3, 1.0, False

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        x, y = shot.street.eye.rays
        return light * np.maximum(1.0 - 2.0 * self.value * (x**2 + y**2), 0.05)[..., None]


class WindSlant(Known):
    """A wind that is the same for all sizes: small drops lean more."""

    name, swept, weak, strong, same_form = "camera.wind_slant", "angle_rad", 0.01, 0.8, False
    weathers = ("rain", "snow")

    def on_streaks(self, shot: Shot, streaks: Streaks) -> None:
        speed = streaks.down_px * streaks.depth_m
        mean = float(np.average(speed, weights=streaks.width_px * streaks.depth_m + 1e-9)) if len(speed) else 0.0
        streaks.aside_px = streaks.aside_px + np.tan(self.value) * mean / streaks.depth_m
        streaks.slant = float(np.tan(self.value))


class WetSurface(Known):
    name, swept, weak, strong = "camera.wet_surface", "darkening", 5e-4, 0.5
    others: ClassVar[dict[str, float]] = {"mirror": 0.0}

    def on_scene(self, shot: Shot) -> None:
        wet = np.clip(shot.street.normal[..., 2], 0.0, 1.0)
        shot.scene = shot.scene * (1.0 - self.value * wet)[..., None]


class SensorNoise(Known):
    name, swept, weak, strong, identity = "camera.sensor_noise", "electrons_per_unit", 2e6, 1500.0, np.inf
    others: ClassVar[dict[str, float]] = {"read_electrons": 0.0}

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        return signal + shot.rng.normal(size=signal.shape) * np.sqrt(np.maximum(signal, 0.0) / self.value)


class ToneCurve(Known):
    name, swept, weak, strong, identity = "camera.tone_curve", "gamma", 5e-4, 0.4, 1.0

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        return np.maximum(signal, 0.0) ** self.value


class Saturation(Known):
    name, swept, weak, strong, identity = "camera.saturation", "level", 0.95, 0.3, np.inf

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        return np.minimum(signal, self.value)


class PatchyFog(Known):
    """One smooth field for all depths in each frame, of Gaussian banks."""

    name, swept, weak, strong, same_form = "camera.patchy_fog", "log_std", 0.003, 0.6, False
    weathers = ("fog",)

    def on_scene(self, shot: Shot) -> None:
        height, width = shot.density.shape
        coarse = shot.rng.normal(size=(7, 9))
        field = ndimage.zoom(coarse, (height / 7, width / 9), order=3)[:height, :width]
        field = field / 0.75  # of the interpolation
        shot.density = shot.density * np.exp(self.value * field - 0.5 * self.value**2)


class HeightFog(Known):
    """Exponential in height above the camera."""

    name, swept, weak, strong, identity = "camera.height_fog", "scale_height_m", 3e5, 4.0, np.inf
    weathers = ("fog",)

    def on_scene(self, shot: Shot) -> None:
        _, y = shot.street.eye.rays
        rise = -y * np.minimum(shot.street.depth_m, 1e7)
        scaled = np.clip(rise / self.value, -50.0, 1e9)
        safe = np.where(np.abs(scaled) < 1e-4, 1e-4, scaled)
        shot.density = shot.density * np.where(np.abs(scaled) < 1e-4, 1.0, -np.expm1(-safe) / safe)


class StreakContrast(Known):
    name, swept, weak, strong, identity = "camera.streak_contrast", "factor", 0.01, 2.0, 1.0
    weathers = ("rain", "snow")

    def on_scene(self, shot: Shot) -> None:
        shot.contrast = self.value


class ParticleCount(Known):
    name, swept, weak, strong, identity = "camera.particle_count", "depth_max_m", 200.0, 2.0, np.inf
    weathers, others = ("rain", "snow"), {"factor": 1.0}

    def on_scene(self, shot: Shot) -> None:
        shot.count, shot.reach_m = self.parameters["factor"], self.value


class RollingShutter(Known):
    """Each streak is as much longer as the shutter runs along with it; its place is the frame's own."""

    name, swept, weak, strong, same_form = "camera.rolling_shutter", "row_time_s", 5e-7, 2e-4, False
    weathers = ("rain", "snow")

    def on_streaks(self, shot: Shot, streaks: Streaks) -> None:
        per_row = np.minimum(streaks.down_px * self.value / EXPOSURE_S, 0.9)
        keep = shot.rng.random(len(per_row)) < 1.0 - per_row
        streaks.peak = np.where(keep, 1.0 / (1.0 - per_row), 0.0)
        streaks.down_px = streaks.down_px / (1.0 - per_row)
        streaks.crowds = [_rolled(crowd, self.value) for crowd in streaks.crowds]


def _rolled(crowd: Crowd, row_time_s: float) -> Crowd:
    share = 1.0 - min(crowd.down_px * row_time_s / EXPOSURE_S, 0.9)
    return replace(crowd, per_px=crowd.per_px * share, area_px=crowd.area_px / share, down_px=crowd.down_px / share)


CATALOGUE: dict[str, type[Known]] = {
    kind.name: kind
    for kind in (
        *(ExposureGain, AirlightScale, ExtinctionScale, StrayLight, AerosolGlow, Defocus, EgoBlur, AdherentDrops),
        *(Vignetting, WindSlant, WetSurface, SensorNoise, ToneCurve, Saturation, PatchyFog, HeightFog),
        *(StreakContrast, ParticleCount, RollingShutter),
    )
}
