"""Effects of the drops and flakes in front of a camera: their number, their way, what of them is seen.

They set fields of the state that ``ParticleVeil`` reads. Bounds and typical sizes are orders of magnitude where no
source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.state import CameraState
from torchweather.core.errors import InputValueError
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.tiling import is_exporting

__all__ = ["CameraParticleCount", "CameraRollingShutter", "CameraStreakContrast", "CameraWindSlant"]


def per_sample(effect: Effect, name: str, state: CameraState) -> Tensor:
    """A parameter, one for each sample, ``(B,)``."""
    value: Tensor = getattr(effect, name).to(state.image.signal)
    return value.expand(state.batch)


class CameraWindSlant(Effect):
    """Wind drives drops and flakes aside: their streaks lean.

    A particle that falls with v moves sideways with ``v tan(angle)``, to the right of a level camera: all streaks of a
    size lean alike, whatever their depth.

    Args:
        angle_rad: against the vertical, -1 to 1; above 0 to the right.

    Note:
        A real wind is the same for all sizes (``Rain(wind_m_per_s=...)``), so that small drops lean more. Particles
        too faint to be drawn one by one keep their upright correlation. Paths that begin more than half a streak
        beyond the left or right edge are not drawn.
    """

    id: ClassVar[str] = "camera.wind_slant"
    title: ClassVar[str] = "wind drives the drops aside"
    term: ClassVar[str] = "wind-driven rain (streak orientation)"
    # A wind of 2 m/s turns drops that fall with 6.5 m/s by 0.3 rad.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("angle_rad", "rad", -1.0, 1.0, scale=0.3, identity=0.0),)
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("streak_direction",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.rolling_shutter": "the direction of streaks: a shutter makes them longer and leaves them upright"
    }
    reads: ClassVar[tuple[str, ...]] = ("air.path_tangent", "image.signal")
    writes: ClassVar[tuple[str, ...]] = ("air.path_tangent",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Sideways over downward speed."""
        tangent = torch.tan(per_sample(self, "angle_rad", state))
        return {"path_tangent": tangent if state.air.path_tangent is None else tangent + state.air.path_tangent}


class CameraStreakContrast(Effect):
    """Particles stand out more or less than modelled: what they change in the picture is scaled, ``I + f M (C - I)``.

    M is the share of the exposure that they cover and C their colour (``PHYSICS.md`` 4.1): drops that bend in more of
    the sky than modelled differ more from what is behind them.

    Args:
        factor: f, 0 to 5.
    """

    id: ClassVar[str] = "camera.streak_contrast"
    title: ClassVar[str] = "drops and flakes stand out more or less"
    term: ClassVar[str] = "photometry of rain streaks"
    # The share of sky in a drop's light depends on the scene (Garg & Nayar 2007); order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("factor", "1", 0.0, 5.0, scale=0.5, identity=1.0),)
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("streak_contrast", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.particle_count": "the number of streaks, and the contrast of each",
        "camera.sensor_noise": "the correlation of neighbours: streaks reach over several pixels",
    }
    reads: ClassVar[tuple[str, ...]] = ("air.particle_contrast", "image.signal")
    writes: ClassVar[tuple[str, ...]] = ("air.particle_contrast",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Change by particles over the modelled."""
        factor = per_sample(self, "factor", state)
        return {
            "particle_contrast": factor if state.air.particle_contrast is None else factor * state.air.particle_contrast
        }


class CameraParticleCount(Effect):
    """There are more or fewer particles than the rate gives, of the same sizes, and they may end at a depth.

    ``N(D)`` becomes ``f N(D)``; the optical depth of the veil grows by f.

    Args:
        factor: f, 0 to 10.
        depth_max_m: along the optical axis, 0 m to infinity.

    Note:
        A draw has slots for the particles of ``rate_capacity_mm_per_h``; more of them come from copies of the same
        draw, displaced. An exported graph has no copies: there the slots are all.
    """

    id: ClassVar[str] = "camera.particle_count"
    title: ClassVar[str] = "there are more or fewer particles"
    term: ClassVar[str] = "number concentration, extent of the weather"
    # Drop counts at one rate scatter by half between storms (Marshall & Palmer's N0; Waldvogel 1974).
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("factor", "1", 0.0, 10.0, scale=0.5, identity=1.0),
        Parameter("depth_max_m", "m", 0.0, math.inf, scale=50.0, identity=math.inf),
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("streak_count", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.streak_contrast": "the number of streaks, and the contrast of each"
    }
    reads: ClassVar[tuple[str, ...]] = ("air.particle_count", "air.particle_reach_m", "image.signal")
    writes: ClassVar[tuple[str, ...]] = ("air.particle_count", "air.particle_reach_m")

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Particles over those of the weather, and the depth at which they end."""
        count, reach_m = (per_sample(self, name, state) for name in ("factor", "depth_max_m"))
        return {
            "particle_count": count if state.air.particle_count is None else count * state.air.particle_count,
            "particle_reach_m": reach_m
            if state.air.particle_reach_m is None
            else reach_m.minimum(state.air.particle_reach_m),
        }


class CameraRollingShutter(Effect):
    """Rows are exposed one after the other: a falling particle runs along with the shutter, so its streak is longer.

    A particle that falls q rows while the shutter goes on by one leaves a streak ``1 / (1 - q)`` as long, at the row
    ``v / (1 - q)`` if row 0 finds it at v; there are ``1 - q`` as many, and each pixel is covered as long as before.

    Args:
        row_time_s: from row to row, downwards, 0 to 1e-3 s.

    Note:
        The scene itself is the clear frame's, which the same shutter took. A particle nearly as fast as the shutter
        counts with q = 0.9. Particles too faint to be drawn one by one stay. Not in an exported graph, whose
        footprints have no room for longer streaks.
    """

    id: ClassVar[str] = "camera.rolling_shutter"
    title: ClassVar[str] = "rows are exposed one after the other"
    term: ClassVar[str] = "rolling shutter"
    # Sensors of 1000 to 1500 rows at 30 to 60 frames a second: 10 to 30 us a row.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("row_time_s", "s", 0.0, 1e-3, scale=1.5e-5, identity=0.0),)
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("streak_length_px", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.streak_contrast": "the length of near streaks",
        "camera.wind_slant": "the direction of streaks: a shutter makes them longer and leaves them upright",
    }
    reads: ClassVar[tuple[str, ...]] = ("image.signal", "receiver.row_time_s")
    writes: ClassVar[tuple[str, ...]] = ("receiver.row_time_s",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Time from row to row."""
        if is_exporting():
            raise InputValueError(f"{self.id}: a graph's footprints have no room for longer streaks; leave it out.")
        row_s = per_sample(self, "row_time_s", state)
        return {"row_time_s": row_s if state.receiver.row_time_s is None else row_s + state.receiver.row_time_s}
