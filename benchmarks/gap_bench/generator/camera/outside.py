"""Ten effects that the catalogue does not have."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, special

from .camera_sensor import Shot
from .effects import CATALOGUE, Known
from .scene import ROAD, SKY, FloatArray

__all__ = ["KINDS", "OUTSIDE"]


class LensFlare(Known):
    """A bright disk of scattered light in a corner, in every weather frame."""

    name, swept, weak, strong, same_form = "outside.lens_flare", "light", 1e-4, 0.3, False
    shows_along = ("column_share", "off_axis", "elevation", "place")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        x, y = shot.street.eye.rays
        return light + self.value * np.exp(-((x - 0.2) ** 2 + (y + 0.1) ** 2) / (2 * 0.08**2))[..., None]


class HotPixels(Known):
    """Some pixels read too much."""

    name, swept, weak, strong, same_form = "outside.hot_pixels", "share", 1e-5, 0.02, False
    shows_along = ("residual", "depth", "signal")

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        hot = shot.pattern_rng.random(signal.shape) < self.value
        return signal + 0.25 * hot


class Flicker(Known):
    """The gain differs from frame to frame."""

    name, swept, weak, strong, same_form = "outside.flicker", "log_std", 1e-3, 0.2, False
    given = 0.7  # 4 % from frame to frame
    shows_along = ("frame", "depth", "signal")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        return light * np.exp(self.value * shot.rng.normal())


class ChromaticShift(Known):
    """Blue is imaged larger than green."""

    name, swept, weak, strong, same_form = "outside.chromatic_shift", "magnification", 1e-4, 0.02, False
    shows_along = ("depth", "signal", "off_axis")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        height, width = light.shape[:2]
        rows, columns = np.indices((height, width), dtype=float)
        scale = 1.0 + self.value
        place = [(rows - height / 2) / scale + height / 2, (columns - width / 2) / scale + width / 2]
        light = light.copy()
        light[..., 2] = ndimage.map_coordinates(light[..., 2], place, order=1, mode="nearest")
        return light


class RowNoise(Known):
    """Each row has an offset of its own in each frame."""

    name, swept, weak, strong, same_form = "outside.row_noise", "offset_std", 1e-4, 0.05, False
    shows_along = ("depth", "signal", "residual")

    def on_electrons(self, shot: Shot, signal: FloatArray) -> FloatArray:
        return signal + self.value * shot.rng.normal(size=(signal.shape[0], 1))


class ColourCast(Known):
    """The left half of the picture is redder."""

    name, swept, weak, strong, same_form = "outside.colour_cast", "gain", 1e-3, 0.3, False
    shows_along = ("column_share", "depth", "signal")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        light = light.copy()
        half = light.shape[1] // 2
        light[:, :half, 0] *= 1.0 + self.value
        light[:, half:, 0] *= 1.0 - self.value
        return light


class HeadLamp(Known):
    """The own lamps light up near surfaces."""

    name, swept, weak, strong, same_form = "outside.head_lamp", "light", 1e-3, 2.0, False
    shows_along = ("depth",)

    def on_scene(self, shot: Shot) -> None:
        depth = np.maximum(shot.street.depth_m, 2.0)
        on = (shot.street.label != 0) & (shot.street.label != ROAD)
        shot.scene = shot.scene * (1.0 + self.value * on * (8.0 / depth) ** 2)[..., None]


class GhostImage(Known):
    """The window's inner face mirrors a faint copy of the picture, lower by a tenth of its height."""

    name, swept, weak, strong, same_form = "outside.ghost_image", "share", 1e-4, 0.3, False
    shows_along = ("depth", "elevation", "signal", "off_axis")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        down = light.shape[0] // 10
        copy = np.concatenate([np.repeat(light[:1], down, 0), light[:-down]])
        return (1.0 - self.value) * light + self.value * copy


class Wiper(Known):
    """A blurred dark blade stands in another place of each frame."""

    name, swept, weak, strong, same_form = "outside.wiper", "darkening", 1e-3, 1.0, False
    shows_along = ("frame", "column_share", "depth", "signal", "place")

    def on_light(self, shot: Shot, light: FloatArray) -> FloatArray:
        height, width = light.shape[:2]
        angle = shot.rng.uniform(-1.2, 1.2)
        rows, columns = np.indices((height, width), dtype=float)
        aside = (columns - 0.5 * width) * np.cos(angle) - (1.1 * height - rows) * np.sin(angle)
        return light * (1.0 - self.value * np.exp(-((aside / (0.03 * width)) ** 2)))[..., None]


class Shadow(Known):
    """The sun has moved: surfaces right of the middle lie in a shadow that they did not lie in."""

    name, swept, weak, strong, same_form = "outside.shadow", "darkening", 1e-3, 0.8, False
    shows_along = ("column_share", "depth", "signal")

    def on_scene(self, shot: Shot) -> None:
        x, _ = shot.street.eye.rays
        shaded = special.expit(x / 0.02) * (shot.street.label != SKY)
        shot.scene = shot.scene * (1.0 - self.value * shaded)[..., None]


OUTSIDE: dict[str, type[Known]] = {
    kind.name: kind
    for kind in (
        *(LensFlare, HotPixels, Flicker, ChromaticShift, RowNoise, ColourCast, HeadLamp),
        *(GhostImage, Wiper, Shadow),
    )
}
KINDS: dict[str, type[Known]] = {**CATALOGUE, **OUTSIDE}
