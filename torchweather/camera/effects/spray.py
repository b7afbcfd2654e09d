"""Spray of a vehicle ahead of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import ground_noise, uneven
from torchweather.camera.airlight import given_or_estimated
from torchweather.camera.fog import FARTHEST_M, rays
from torchweather.camera.state import CameraState
from torchweather.core.random import Variate
from torchweather.physics.road_spray import spray_cross_section_m2_per_kg
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.spray import BILLOWS, REDNESS, SPRAY, cloud_of

__all__ = ["CameraRoadSpray"]


class CameraRoadSpray(Effect):
    """Tyres of a vehicle ahead throw up spray: a veil that hides what lies behind it, brightest where it is dense.

    ``I T + A (1 - T)``, ``T = exp(-sigma c)``, with the water c along each pixel's ray up to its surface
    (``physics.SprayCloud``), the geometric cross-section sigma of the drops, and the light A of the sky. Billows make
    the density uneven across the line of sight.

    Args:
        water_g_per_m: in the air behind one row of tyres, g per metre of road, 0 to 5000.
        drop_mm: Sauter diameter of the drops.
        distance_m, lateral_m: of the vehicle's rear tyres, ahead, and of its middle, to the left.
        length_m, height_m: over which the cloud thins out by e, to the rear and upwards.
        uneven: spread of the logarithm of the density, 0 to 2.

    Note:
        A is the airlight of the transform, or that of the frame's sky. Single scattering.
    """

    id: ClassVar[str] = "camera.road_spray"
    title: ClassVar[str] = "a vehicle ahead throws up spray"
    term: ClassVar[str] = "road spray (tyre spray)"
    searched: ClassVar[bool] = False
    arguments: ClassVar[tuple[Parameter, ...]] = SPRAY
    after: ClassVar[str] = "extinction_and_airlight"
    rank: ClassVar[int] = 1
    axes: ClassVar[tuple[str, ...]] = ("place", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.patchy_fog": "the place in the image: spray lies behind a vehicle, over the road"
    }
    of_the_air: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("camera", "sine_elevation")
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics", "scene.near_mask", "scene.ray_per_depth"),
        *("scene.sine_elevation", "scene.sky"),
        *("air.airlight", "air.lamp_light", "air.skylight"),
        "image.signal",
        *("receiver.camera", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def variates(self) -> tuple[Variate, ...]:
        """Variates of the spray's density."""
        return (BILLOWS,)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The scene behind its veil."""
        through = torch.exp(-self.optical_depth(state, noise["billows"]))
        if state.scene.near_mask is not None:
            through = torch.lerp(through, torch.ones_like(through), state.scene.near_mask)
        light = state.air.skylight if state.air.skylight is not None else state.air.airlight
        if light is None:
            light = given_or_estimated(None, state, self)
        veil = state.per_pixel(light.to(through)) * state.by_cells(1.0 - through)
        veil = veil.expand_as(state.by_cells(state.image.signal)).flatten(2, 3)
        return {"signal": (state.image.signal * through + veil).clamp_max(1.0)}

    def optical_depth(self, state: CameraState, billows: Tensor) -> Tensor:
        """Of the spray before each pixel's surface, ``(B, 1, H, W)``."""
        assert state.receiver.camera is not None
        assert state.scene.sine_elevation is not None
        cloud = cloud_of(self, state.one_plane)
        per_depth, rise = state.scene.ray_per_depth, state.scene.sine_elevation
        left = -rays(state)[0] / per_depth
        ahead = (1.0 - left.square() - rise.square()).clamp_min(1e-6).sqrt()
        end_m = state.scene.depth_m.clamp_max(FARTHEST_M) * per_depth
        water = cloud.column((ahead, left, rise), state.receiver.camera.height_m, end_m)
        field = ground_noise(billows.to(water), cloud.distance_m * left, cloud.distance_m * rise, redness=REDNESS)
        denser = uneven(field, self.value("uneven", field))
        return spray_cross_section_m2_per_kg(self.value("drop_mm", water)) * water * denser
