"""Upright boxes around a scene's road users, in the frame of a sensor."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.scenes.primitives import Box, Capsule, Cylinder, Ellipsoid, FacetMesh, Foliage, Shape
from torchweather.scenes.scene import Scene, SceneLabel, SceneObject

__all__ = ["BOXED_LABELS", "object_boxes"]

BOXED_LABELS = (SceneLabel.CAR, SceneLabel.PEDESTRIAN, SceneLabel.CYCLIST)
# Headings that are tried: a box turned by half a step is longer by some 0.4 % of its width.
HEADING_STEPS = 180


def object_boxes(
    scene: Scene, sensor_from_vehicle: Tensor, labels: tuple[SceneLabel, ...] = BOXED_LABELS
) -> tuple[Tensor, Tensor]:
    """The smallest upright box around each car, pedestrian and cyclist.

    Args:
        scene: whose objects.
        sensor_from_vehicle: ``T_sensor_from_vehicle``, ``(4, 4)`` float; "upright" is along the sensor's own z.
        labels: classes that get a box.

    Returns:
        Boxes ``(M, 7)`` float64: centre x, y, z, length, width, height in metres, and yaw in radians from x to y;
        and the index of each in ``Scene.objects``, ``(M,)`` int64.

    Note:
        A box holds everything that belongs to the object, mirrors included. Length is the longer side, so yaw lies in
        [-pi/2, pi/2): front and rear are not told apart. Yaw is that of the smallest rectangle, in steps of 1
        degree: a car's heading, but up to some 25 degrees beside that of a person in mid-stride.

    Example:
        >>> from torchweather.scenes import test_track
        >>> boxes, owners = object_boxes(test_track(), torch.eye(4))
        >>> [test_track().objects[k].name for k in owners]
        ['car 28 m', 'car 56 m', 'pedestrian', 'cyclist']
        >>> [round(value, 2) for value in boxes[0, [0, 3, 6]].tolist()]
        [30.15, 4.3, 0.0]
    """
    check_arguments(
        "object_boxes(scene: Scene, sensor_from_vehicle: real(4, 4), labels: Sequence[int])",
        scene,
        sensor_from_vehicle,
        labels,
    )
    found = [(k, thing) for k, thing in enumerate(scene.objects) if thing.label in labels]
    pose = sensor_from_vehicle.detach().to("cpu", torch.float64)
    boxes = [_box(thing, pose) for _, thing in found]
    joined = torch.stack(boxes) if boxes else torch.zeros(0, 7, dtype=torch.float64)
    device = sensor_from_vehicle.device
    return joined.to(device), torch.tensor([k for k, _ in found], dtype=torch.int64, device=device)


def _box(thing: SceneObject, sensor_from_vehicle: Tensor) -> Tensor:
    """Centre, size and yaw of one object's box, ``(7,)``."""
    yaw = torch.arange(HEADING_STEPS, dtype=torch.float64) * (math.pi / HEADING_STEPS) - math.pi / 2
    flat = torch.zeros_like(yaw)
    along = torch.stack([yaw.cos(), yaw.sin(), flat], -1)
    across = torch.stack([-yaw.sin(), yaw.cos(), flat], -1)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    axes = torch.cat([along, across, up])
    high = _reach(thing, axes, sensor_from_vehicle)
    low = -_reach(thing, -axes, sensor_from_vehicle)
    # On level ground a box ends there, whatever of the object lies below it (a wheel arch's hidden edge).
    if float(sensor_from_vehicle[2, :2].abs().max()) < 1e-9:
        low[-1] = torch.maximum(low[-1], sensor_from_vehicle[2, 3])
    size, middle = high - low, (high + low) / 2
    length, width = size[:HEADING_STEPS], size[HEADING_STEPS:-1]
    # Each rectangle is tried twice, by either side as its length: the shorter one is set aside.
    best = int(torch.where(length >= width, length * width, math.inf).argmin())
    centre = middle[best] * along[best] + middle[HEADING_STEPS + best] * across[best] + middle[-1] * up[0]
    return torch.cat([centre, torch.stack([length[best], width[best], size[-1], yaw[best]])])


def _reach(thing: SceneObject, axes: Tensor, sensor_from_vehicle: Tensor) -> Tensor:
    """Extent of the object along each axis of the sensor's frame, ``(K, 3)`` to ``(K,)``."""
    in_vehicle = axes @ sensor_from_vehicle[:3, :3]
    reach = torch.stack([_shape_reach(part.shape, in_vehicle) for part in thing.parts]).amax(0)
    return reach + axes @ sensor_from_vehicle[:3, 3]


def _shape_reach(shape: Shape, axes: Tensor) -> Tensor:
    """Support function of a shape: the largest ``axis . point`` over its points, for unit axes ``(K, 3)``."""
    match shape:
        case Box():
            cos, sin = math.cos(shape.yaw_rad), math.sin(shape.yaw_rad)
            edges = axes.new_tensor([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            return axes @ axes.new_tensor(shape.centre_m) + (axes @ edges.T).abs() @ axes.new_tensor(shape.size_m) / 2
        case Ellipsoid():
            stretched: Tensor = torch.linalg.vector_norm(axes * axes.new_tensor(shape.semi_axes_m), dim=-1)
            return axes @ axes.new_tensor(shape.centre_m) + stretched
        case Capsule() | Cylinder():
            ends = axes.new_tensor([shape.start_m, shape.end_m])
            reach = (axes @ ends.T).amax(-1)
            if isinstance(shape, Capsule):
                return reach + shape.radius_m
            spine = torch.nn.functional.normalize(ends[1] - ends[0], dim=-1)
            return reach + shape.radius_m * (1 - (axes @ spine) ** 2).clamp_min(0).sqrt()
        case FacetMesh():
            return (axes @ axes.new_tensor(shape.vertices_m).T).amax(-1)
        case Foliage():
            return torch.stack([_shape_reach(shell, axes) for shell in shape.shells]).amax(0)
        case _:
            centre, radius = shape.bounding_sphere()
            return axes @ axes.new_tensor(centre) + radius
