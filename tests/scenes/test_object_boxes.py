"""Boxes around road users against the shapes that they hold."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.scenes import Scene, SceneLabel, fog_tunnel, object_boxes, test_track
from torchweather.scenes.lighting import DiffuseLight
from torchweather.scenes.primitives import Box, Capsule, Cylinder, Ellipsoid, FacetMesh, Shape
from torchweather.scenes.scene import Part, SceneObject

LEVEL = torch.eye(4, dtype=torch.float64)


def box_of(shape: Shape, pose: Tensor = LEVEL) -> Tensor:
    scene = Scene("one", (SceneObject("thing", SceneLabel.CAR, (Part(shape, "asphalt"),)),), DiffuseLight())
    boxes, owner = object_boxes(scene, pose)
    assert owner.tolist() == [0]
    return boxes[0]


def turned(yaw_rad: float, pitch_rad: float, at_m: tuple[float, float, float]) -> Tensor:
    """A pose: pitch about y, then yaw about z."""
    cy, sy, cp, sp = math.cos(yaw_rad), math.sin(yaw_rad), math.cos(pitch_rad), math.sin(pitch_rad)
    yaw = torch.tensor([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]], dtype=torch.float64)
    pitch = torch.tensor([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = yaw @ pitch, torch.tensor(at_m, dtype=torch.float64)
    return pose


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Box((5.0, 1.0, 2.0), (4.0, 2.0, 1.0), math.radians(30)), (5, 1, 2, 4, 2, 1, math.radians(30))),
        (Box((5.0, 1.0, 2.0), (2.0, 4.0, 1.0), math.radians(30)), (5, 1, 2, 4, 2, 1, math.radians(-60))),
        (Ellipsoid((5.0, 1.0, 2.0), (2.0, 1.0, 0.5)), (5, 1, 2, 4, 2, 1, 0)),
        (Capsule((4.0, 1.0, 2.0), (6.0, 1.0, 2.0), 0.5), (5, 1, 2, 3, 1, 1, 0)),
        (Cylinder((4.0, 1.0, 2.0), (7.0, 1.0, 2.0), 0.5), (5.5, 1, 2, 3, 1, 1, 0)),
        (
            FacetMesh(((3.0, 0.0, 1.0), (7.0, 0.0, 1.0), (7.0, 2.0, 3.0), (3.0, 2.0, 3.0)), ((0, 1, 2), (0, 2, 3))),
            (5, 1, 2, 4, 2, 2, 0),
        ),
    ],
)
def test_box_of_one_shape_is_its_closed_form(shape: Shape, expected: tuple[float, ...]) -> None:
    torch.testing.assert_close(box_of(shape), torch.tensor(expected, dtype=torch.float64))


def test_cars_have_their_own_size_and_place() -> None:
    scene = test_track()
    boxes, owner = object_boxes(scene, LEVEL)
    found = {scene.objects[k].name: box for k, box in zip(owner.tolist(), boxes, strict=True)}
    # 4.30 m long, 1.47 m high, 2.13 m wide from mirror to mirror (middles at 0.97 m, each 0.19 m wide).
    for name, middle in (("car 28 m", (28.0 + 2.15, -0.15)), ("car 56 m", (56.0 + 2.15, 3.6))):
        expected = torch.tensor([*middle, 1.47 / 2, 4.30, 2.13, 1.47, 0.0], dtype=torch.float64)
        torch.testing.assert_close(found[name], expected)
    # Walking adult of 1.75 m, its hair a little above.
    assert float(found["pedestrian"][5]) == pytest.approx(1.76, abs=0.01)


@pytest.mark.parametrize("build", [test_track, fog_tunnel])
@pytest.mark.parametrize("pose", [LEVEL, turned(0.7, 0.1, (0.4, -0.2, -1.7))], ids=["level", "turned and tilted"])
def test_box_holds_every_point_that_a_ray_hits_on_its_object(build: object, pose: Tensor) -> None:
    scene: Scene = build()  # type: ignore[operator]
    boxes, owner = object_boxes(scene, pose)
    for box, k in zip(boxes, owner.tolist(), strict=True):
        middle = torch.linalg.inv(pose)[:3, :3] @ (box[:3] - pose[:3, 3])
        generator = torch.Generator().manual_seed(k)
        for _ in range(3):
            # From 6 m away on a random side, so that all sides are seen.
            side = torch.nn.functional.normalize(torch.randn(3, generator=generator, dtype=torch.float64), dim=-1)
            side[2] = side[2].abs()
            origin = middle + 6 * side
            aim = middle + 1.5 * torch.randn(1000, 3, generator=generator, dtype=torch.float64)
            alone = Scene("alone", (scene.objects[k],), scene.light)
            hit = alone.cast(origin, aim - origin)
            point = hit.point_m[hit.object_id == 0] @ pose[:3, :3].T + pose[:3, 3] - box[:3]
            point = point[hit.point_m[hit.object_id == 0][:, 2] >= 0]
            cos, sin = box[6].cos(), box[6].sin()
            own = torch.stack([cos * point[:, 0] + sin * point[:, 1], cos * point[:, 1] - sin * point[:, 0]], -1)
            own = torch.cat([own, point[:, 2:]], -1)
            # Seams of meshes overlap by 1e-5 of a facet.
            assert (own.abs() <= box[3:6] / 2 + 1e-4).all()


def test_scene_without_road_users_has_no_boxes() -> None:
    boxes, owner = object_boxes(Scene("empty", (), DiffuseLight()), LEVEL)
    assert boxes.shape == (0, 7)
    assert owner.shape == (0,)
