"""Surfaces that a camera sees: their normals, their height above the ground, and the water on the road."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import ground_noise, uneven
from torchweather.camera.airlight import airlight_argument, given_or_estimated
from torchweather.camera.fog import FARTHEST_M, rays
from torchweather.camera.state import CameraState
from torchweather.physics.road_water import damp_share, drowned_share
from torchweather.pipeline.registry import register
from torchweather.pipeline.road_water import RoadWater
from torchweather.pipeline.stage import Stage

__all__ = [
    "CameraRoadWater",
    "CameraSkyLight",
    "CameraSurfaceNormals",
    "footprint_of",
    "ground_share",
    "places",
    "surface_normals",
]

# A surface is road where it is level and lies within this height of the ground: a kerb, and what depth is off by.
ROAD_HEIGHT_M, ROAD_HEIGHT_PER_M, ROAD_UP, ROAD_UP_RAMP = 0.15, 0.02, 0.75, 0.1


def surface_normals(state: CameraState) -> Tensor:
    """Unit normals in the vehicle's frame from the depth, by central differences, ``(B, 3, H, W)``; 0 in the sky.

    A pixel at the edge of an object takes the nearer side's difference: of the two one-sided ones the smaller.
    """
    assert state.receiver.camera is not None
    x, y = rays(state)
    depth_m = state.scene.depth_m.clamp_max(FARTHEST_M)
    place = torch.cat([x * depth_m, y * depth_m, depth_m.expand_as(x * depth_m)], 1)

    def slope(axis: int) -> Tensor:
        """Difference to a neighbour along an axis, of the two the one with the smaller step in depth."""
        ahead = place.roll(-1, axis) - place
        back = place - place.roll(1, axis)
        last = place.shape[axis] - 1
        index = torch.arange(last + 1, device=place.device)
        index = index.view(-1, 1) if axis == 2 else index
        nearer = (ahead[:, 2:].abs() <= back[:, 2:].abs()) | (index == 0)
        return torch.where(nearer & (index != last), ahead, back)

    across, down = slope(3), slope(2)
    normal = torch.linalg.cross(across, down, dim=1)  # x right, y down: along +z, away from the camera
    normal = -normal / torch.linalg.vector_norm(normal, dim=1, keepdim=True).clamp_min(1e-12)
    turn = normal.new_tensor(state.receiver.camera.camera_from_vehicle())
    normal = torch.einsum("ji,bjhw->bihw", turn, normal)  # back into the vehicle's frame
    return torch.where(state.scene.depth_m < FARTHEST_M, normal, 0.0)


def places(state: CameraState) -> tuple[Tensor, Tensor, Tensor]:
    """x forward, y left of each pixel's surface, and its height above flat ground, ``(B, 1, H, W)``, metres."""
    assert state.receiver.camera is not None
    assert state.scene.sine_elevation is not None
    depth_m = state.scene.depth_m.clamp_max(FARTHEST_M)
    ray_m = depth_m * state.scene.ray_per_depth
    rise_m = ray_m * state.scene.sine_elevation
    y_m = -rays(state)[0] * depth_m
    x_m = (ray_m.square() - rise_m.square() - y_m.square()).clamp_min(0.0).sqrt()
    return x_m, y_m, rise_m + state.receiver.camera.height_m


def footprint_of(state: CameraState, x_m: Tensor) -> Tensor:
    """Length of a pixel along the ground at a place ahead, ``(B, 1, H, W)``, metres."""
    assert state.receiver.camera is not None
    return x_m.square() / (state.receiver.camera.height_m * state.receiver.camera.fy)


def ground_share(state: CameraState, x_m: Tensor, height_m: Tensor) -> Tensor:
    """Share of road of each pixel, ``(B, 1, H, W)``: 1 where a surface is level and near the ground.

    Where the depth is guessed it is the probability of the guess.
    """
    if state.scene.ground is not None:
        return state.scene.ground.to(x_m)
    assert state.scene.normal is not None
    most_m = ROAD_HEIGHT_M + ROAD_HEIGHT_PER_M * x_m
    near = (2.0 - height_m.abs() / most_m).clamp(0.0, 1.0)
    level = ((state.scene.normal[:, 2:] - ROAD_UP) / ROAD_UP_RAMP).clamp(0.0, 1.0).to(near)
    return torch.where(state.scene.depth_m < FARTHEST_M, near * level, 0.0)


@register
class CameraSurfaceNormals(Stage):
    """Normals of the surfaces, from the depth where the call gives none."""

    default_name: ClassVar[str] = "surface_normals"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics", "scene.normal"),
        *("image.signal", "receiver.camera"),
    )
    writes: ClassVar[tuple[str, ...]] = ("scene.normal",)

    def config(self) -> dict[str, Any]:
        """Constructor arguments: none."""
        return {}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The state with normals."""
        return state if state.scene.normal is not None else state.changed(normal=surface_normals(state))


@register
class CameraSkyLight(Stage):
    """Light of the sky on the scene, for what is to turn white in it.

    Args:
        airlight: signals (red, green, blue) of the sky, or how to estimate them from the frame, as `BayerWeather`.
    """

    default_name: ClassVar[str] = "sky_light"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.sine_elevation", "scene.sky"),
        "air.lamp_light",
        *("image.signal", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = ("air.skylight",)

    def __init__(self, airlight: Any = None) -> None:
        super().__init__()
        self.airlight = airlight_argument(airlight, owner=self)

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"airlight": list(self.airlight) if isinstance(self.airlight, tuple) else self.airlight}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The state with the light."""
        return state.changed(skylight=given_or_estimated(self.airlight, state, self))


@register
class CameraRoadWater(RoadWater):
    """Water on the road: which share of each pixel's surface is damp, and which lies under smooth water.

    Args:
        water_mm: mean depth, 0 to 10 mm, a number or one for each sample.
        texture_mm: mean texture depth of the road.
        log_std: spread of the logarithm of the depth over the road, 0 to 2.
    """

    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics", "scene.ground", "scene.normal"),
        *("scene.ray_per_depth", "scene.sine_elevation", "image.signal", "receiver.camera"),
    )
    writes: ClassVar[tuple[str, ...]] = ("scene.damp", "scene.pool")

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The state with the water."""
        x_m, y_m, height_m = places(state)
        road = ground_share(state, x_m, height_m)
        water = self.water_mm.to(road).view(-1, 1, 1, 1)
        if self.log_std:
            field = ground_noise(noise["ground"], x_m, y_m, footprint_of(state, x_m))
            water = water * uneven(field, self.log_std)
        water = water.expand(state.batch, -1, -1, -1)
        return state.changed(damp=road * damp_share(water), pool=road * drowned_share(water, self.texture_mm))
