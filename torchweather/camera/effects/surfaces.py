"""Effects of a camera on the surfaces that it sees: snow on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import GROUND_VARIATE, ground_noise, uneven
from torchweather.camera.airlight import given_or_estimated
from torchweather.camera.state import CameraState
from torchweather.camera.surfaces import footprint_of, places
from torchweather.core.random import Variate
from torchweather.physics.snow_pack import snow_share
from torchweather.pipeline.effect import Effect, Parameter

__all__ = ["CameraSnowCover"]

SMOOTH_PX = 5  # over which the share is averaged
SHADE_OF_DRIFTS = 0.04  # by which drifts and hollows differ in brightness, a standard deviation; order of magnitude


class CameraSnowCover(Effect):
    """Snow lies on the ground and on objects: surfaces that face up turn white.

    ``I (1 - s) + s L`` with the share s of the surface that snow covers (``physics.snow_share`` of depth and upward
    part of the normal) and its light ``L = albedo A (1 + up) / 2``: A is the light of an even, overcast sky, of which a
    slope sees a part. Drifts make the depth uneven, log-normally over the ground.

    Args:
        depth_mm: of the snow on level ground, 0 to 1000 mm.
        albedo: of the snow, 0 to 1.
        uneven: spread of the logarithm of the depth, 0 to 2.

    Note:
        A is the airlight of the transform, or that of the frame's sky. Cast shadows and sunlight on the snow are not
        drawn, and surfaces keep their shape.
    """

    id: ClassVar[str] = "camera.snow_cover"
    title: ClassVar[str] = "snow lies on the ground and on objects"
    term: ClassVar[str] = "snow cover (snow-covered area fraction)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("depth_mm", "mm", 0.0, 1000.0, scale=10.0, identity=0.0),
        Parameter("albedo", "1", 0.0, 1.0, scale=0.1, default=0.9),
        Parameter("uneven", "1", 0.0, 2.0, scale=0.5, default=0.5),
    )
    after: ClassVar[str] = "scene"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("up", "place")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.exposure_gain": "surfaces that stand upright: they stay as they are",
        "camera.wet_surface": "brightness of level ground: water darkens it, snow whitens it",
    }
    of_the_air: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("camera", "normal")
    reads: ClassVar[tuple[str, ...]] = (
        *(
            "scene.depth_m",
            "scene.ground",
            "scene.intrinsics",
            "scene.near_mask",
            "scene.normal",
            "scene.ray_per_depth",
        ),
        *("scene.sine_elevation", "scene.sky"),
        *("air.lamp_light", "air.skylight"),
        "image.signal",
        *("receiver.camera", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """Variates of the snow's depth."""
        return (GROUND_VARIATE,)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The white scene."""
        assert state.scene.normal is not None
        up = state.scene.normal[:, 2:].to(state.image.signal)
        ground = state.scene.ground
        if ground is not None:  # of a guessed depth no slope is known: what may be ground is level
            up = torch.ones_like(up)
        x_m, y_m, _ = places(state)
        field = ground_noise(noise["ground"].to(up), x_m, y_m, footprint_of(state, x_m))
        log_std = self.value("uneven", field)
        share = snow_share(self.value("depth_mm", field) * uneven(field, log_std), up)
        # Normals of leaves and edges differ from pixel to pixel; what a lens shows of them is their mean.
        share = torch.nn.functional.avg_pool2d(share, SMOOTH_PX, 1, SMOOTH_PX // 2, count_include_pad=False)
        if ground is not None:
            share = share * ground.to(share)
        if state.scene.near_mask is not None:
            share = share * (1.0 - state.scene.near_mask)
        sky = state.air.skylight if state.air.skylight is not None else given_or_estimated(None, state, self)
        seen = self.value("albedo", field) * 0.5 * (1.0 + up) * (1.0 + SHADE_OF_DRIFTS * log_std * field)
        light = state.per_pixel(sky.to(up)) * state.by_cells(seen.expand_as(share))
        light = light.expand_as(state.by_cells(state.image.signal)).flatten(2, 3).clamp_max(1.0)
        return {"signal": torch.lerp(state.image.signal, light, share.expand_as(light))}
