"""Surfaces that a LiDAR sees: the ground under it, and the water on the road."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.conditions.ground_noise import ground_noise, uneven
from torchweather.core.errors import InputValueError
from torchweather.lidar.state import LidarState
from torchweather.lidar.sweep.ground import fit_ground
from torchweather.physics.road_water import damp_share, drowned_share
from torchweather.pipeline.registry import register
from torchweather.pipeline.road_water import RoadWater
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["LidarRoadWater", "LidarSurfaceNormals", "ground_heights_m"]

# A return is of the road where it lies within this height of the ground: a kerb, and what the plane is off by.
ROAD_HEIGHT_M, ROAD_HEIGHT_PER_M = 0.15, 0.005


def ground_heights_m(state: LidarState, owner: object) -> Tensor:
    """Height of each return over the ground that is fitted to its cloud, ``(B, N)``, metres; NaN without return.

    Raises:
        InputValueError: a cloud shows no ground, or a graph is being traced.
    """
    name = type(owner).__name__
    if is_exporting():
        raise InputValueError(
            f"{name}: no graph can hold it, as it fits the ground to each cloud. Leave WetRoad and SnowCover out of "
            "the weather that is exported."
        )
    points = state.scene.points_in.detach()[..., :3].double().cpu().numpy()
    heights = []
    for number, cloud in enumerate(points):
        plane = fit_ground(cloud)
        if plane is None:
            raise InputValueError(
                f"{name}: sample {number} shows no ground: expected a plane through the lowest returns, 0.4 to 4 m "
                "under the sensor; got none. Pass the whole sweep in the sensor's frame, or leave WetRoad and "
                "SnowCover out of its weather."
            )
        heights.append(torch.from_numpy(plane.height_above(cloud)))
    height_m = torch.stack(heights).to(state.scene.clear_range_m)
    return torch.where(state.scene.clear_range_m > 0, height_m, torch.nan)


def ground_share(state: LidarState, height_m: Tensor) -> Tensor:
    """1 where a return is of the road, else 0, ``(B, N)``."""
    near = height_m.abs() <= ROAD_HEIGHT_M + ROAD_HEIGHT_PER_M * state.scene.clear_range_m
    return near.to(height_m)


@register
class LidarSurfaceNormals(Stage):
    """Upward part of the normals, and the angles of incidence: of an organised cloud from its neighbours, else of the
    ground alone.

    In a cloud that is not organised the ground, a plane fitted to its lowest returns, faces up, and everything else
    counts as upright.
    """

    default_name: ClassVar[str] = "surface_normals"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.clear_range_m", "scene.cos_incidence", "scene.grid", "scene.points_in", "scene.up"),
    )
    writes: ClassVar[tuple[str, ...]] = ("scene.cos_incidence", "scene.up")

    def config(self) -> dict[str, Any]:
        """Constructor arguments: none."""
        return {}

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with what was not known."""
        range_m = state.scene.clear_range_m
        place = state.scene.points_in[..., :3]
        if state.scene.up is not None and state.scene.cos_incidence is not None:
            return state
        if state.scene.grid is not None:
            batch, grid = len(range_m), state.scene.grid
            normal = grid_normals(place.reshape(batch, *grid, 3), range_m.reshape(batch, *grid))
            normal = normal.flatten(1, 2)
            up = normal[..., 2]
            cosine = (normal * place).sum(-1).abs() / range_m.clamp_min(1e-3)
        else:
            up = ground_share(state, ground_heights_m(state, self))
            cosine = place[..., 2].abs() / range_m.clamp_min(1e-3)
        return state.changed(
            up=up if state.scene.up is None else state.scene.up,
            cos_incidence=cosine if state.scene.cos_incidence is None else state.scene.cos_incidence,
        )


def grid_normals(place: Tensor, range_m: Tensor) -> Tensor:
    """Unit normals of an organised cloud, towards the sensor, ``(B, rows, columns, 3)``; 0 where there is no surface.

    Along rows and columns the difference to the neighbour that is nearer in range; columns close to a ring.
    """

    def slope(axis: int, ring: bool) -> tuple[Tensor, Tensor]:
        """Difference along an axis, and whether there is one."""
        steps, known = [], []
        for way in (-1, 1):
            there = range_m.roll(way, axis) > 0
            if not ring:
                index = torch.arange(range_m.shape[axis], device=range_m.device)
                edge = index == (range_m.shape[axis] - 1 if way < 0 else 0)
                there = there & ~(edge.view(-1, 1) if axis == 1 else edge)
            steps.append((place.roll(way, axis) - place) * -way)
            known.append(there)
        apart = [
            torch.where(there, (range_m.roll(way, axis) - range_m).abs(), torch.inf)
            for way, there in zip((-1, 1), known, strict=True)
        ]
        first = apart[0] <= apart[1]
        return torch.where(first[..., None], steps[0], steps[1]), known[0] | known[1]

    (across, one), (down, other) = slope(2, True), slope(1, False)
    normal = torch.linalg.cross(across, down, dim=-1)
    length = torch.linalg.vector_norm(normal, dim=-1, keepdim=True)
    normal = torch.where(length > 0, normal / length.clamp_min(1e-12), 0.0)
    away = (normal * place).sum(-1, keepdim=True) > 0
    normal = torch.where(away, -normal, normal)
    return torch.where(((range_m > 0) & one & other)[..., None], normal, 0.0)


@register
class LidarRoadWater(RoadWater):
    """Water on the road: which share of what each beam meets is damp, and which lies under smooth water.

    The road is what lies near a plane that is fitted to the lowest returns of each cloud. Its normals are taken to
    point up where none are known.

    Args:
        water_mm: mean depth, 0 to 10 mm, a number or one for each sample.
        texture_mm: mean texture depth of the road.
        log_std: spread of the logarithm of the depth over the road, 0 to 2.
    """

    reads: ClassVar[tuple[str, ...]] = (*("scene.clear_range_m", "scene.cos_incidence", "scene.points_in", "scene.up"),)
    writes: ClassVar[tuple[str, ...]] = ("scene.cos_incidence", "scene.damp", "scene.pool", "scene.up")

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        """The state with the water."""
        range_m = state.scene.clear_range_m
        height_m = ground_heights_m(state, self)
        road = ground_share(state, height_m)
        water = self.water_mm.to(road).view(-1, 1)
        x_m, y_m, z_m = state.scene.points_in[..., :3].unbind(-1)
        if self.log_std:
            water = water * uneven(ground_noise(noise["ground"], x_m, y_m), self.log_std)
        up, cosine = state.scene.up, state.scene.cos_incidence
        return state.changed(
            damp=road * damp_share(water),
            pool=road * drowned_share(water, self.texture_mm),
            up=road if up is None else up,
            cos_incidence=z_m.abs() / range_m.clamp_min(1e-3) if cosine is None else cosine,
        )
