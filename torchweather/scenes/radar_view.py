"""A scene as the scatterers that a radar sees in clear air, with its truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between, check_finite
from torchweather.radar import Scatterers, car_scatterers, corner_scatterers
from torchweather.radar.sensor import Radar
from torchweather.scenes.object_boxes import object_boxes
from torchweather.scenes.pose import checked_pose
from torchweather.scenes.primitives import Box, Foliage, Point
from torchweather.scenes.scene import Scene, SceneLabel, SceneObject

__all__ = ["BUMPER_MOUNT_M", "GENERIC_RCS_DBSM", "REFLECTORS", "CornerReflector", "RadarView", "radar_view"]

# In the bumper, below the camera, so that an object is as far from the radar as from camera and LiDAR. Generic height.
BUMPER_MOUNT_M = (0.0, 0.0, 0.5)

# Mean radar cross section of one scatterer of an object that is no car, dBsm at 76-81 GHz. All generic: orders of
# magnitude from memory, unverified. A pedestrian's is often given as some -8 dBsm, 10 to 20 dB below a car's.
GENERIC_RCS_DBSM: dict[SceneLabel, float] = {
    SceneLabel.PEDESTRIAN: -8.0,
    SceneLabel.CYCLIST: -2.0,
    SceneLabel.BOARD: -8.0,  # a board off its specular angle: its stand and edges
    SceneLabel.GUARD_RAIL: -8.0,  # each post
    SceneLabel.POLE: -15.0,  # a plastic delineator with its reflector
    SceneLabel.TREE: -8.0,  # each layer of leaves
}
# The long parts of a guard rail lie along the line of sight and mirror the wave away; its posts are shorter than this.
POST_M = 0.5
# Of a car the weakest cells are left out that hold this share of its power together: -50 dB.
NEGLIGIBLE = 1e-5
# Of the crown's shells every one is a layer of leaves; so many stand for all.
CROWN_LAYERS = 6


@dataclass(frozen=True)
class CornerReflector:
    """A trihedral corner reflector with triangular faces, which faces the radar.

    Args:
        name: of it.
        position_m: of its corner in the vehicle frame, metres.
        edge_m: inner edge; on boresight ``4 pi edge^4 / (3 lambda^2)`` is its cross section.
    """

    name: str
    position_m: Point
    edge_m: float


# 4 pi a^4 / (3 lambda^2) at 77 GHz: 10.0 dBsm.
EDGE_OF_10_DBSM_M = 0.07756

REFLECTORS: dict[str, tuple[CornerReflector, ...]] = {
    "test-track": (
        # To the right of the road at 20 m, between the posts, and to the left at 45 m, in front of the guard rail.
        CornerReflector("corner 20 m", (19.692, -3.5, 0.5), EDGE_OF_10_DBSM_M),
        CornerReflector("corner 45 m", (44.498, 6.7, 0.5), EDGE_OF_10_DBSM_M),
    ),
    # Beside the target, in the case of the radar's target (torchweather.scenes.rehearse_targets).
    "thi-hall": (CornerReflector("corner 28 m", (28.0, -0.95, 0.5), EDGE_OF_10_DBSM_M),),
    "cerema-tunnel": (CornerReflector("corner 15 m", (15.0, -0.95, 0.5), EDGE_OF_10_DBSM_M),),
}
"""Corner reflectors that stand in a scene for the radar, by the scene's name: 10 dBsm at 77 GHz."""


@dataclass(frozen=True)
class RadarView:
    """A scene as a radar's scatterers, with its truth; row i is scatterer i.

    Args:
        scatterers: ``(M,)`` in the radar's frame, float64.
        names: of the scene's objects, in their order, then of the corner reflectors.
        object_id: index into ``names``, ``(M,)`` int64.
        label: `SceneLabel` of each, ``(M,)`` int64; a corner reflector is a BOARD: a target on a stand.
        boxes: around cars, pedestrians and cyclists, in the radar's frame, ``(K, 7)`` float64: centre x, y, z,
            length, width, height, yaw (see `object_boxes`).
        box_object_id: index of each box's owner in ``names``, ``(K,)`` int64.
        T_vehicle_from_radar: where the radar stands, ``(4, 4)`` float64.
    """

    scatterers: Scatterers
    names: tuple[str, ...]
    object_id: Tensor
    label: Tensor
    boxes: Tensor
    box_object_id: Tensor
    T_vehicle_from_radar: Tensor

    def of(self, name: str) -> Tensor:
        """Mask of the scatterers of an object or reflector of that name, ``(M,)`` bool."""
        if name not in self.names:
            raise InputValueError(f"RadarView: name must be one of {', '.join(self.names)}; got {name!r}.")
        found: Tensor = self.object_id == self.names.index(name)
        return found


def radar_view(
    scene: Scene,
    radar: Radar,
    *,
    T_vehicle_from_radar: Tensor | Sequence[Sequence[float]] | None = None,
    ego_speed_m_per_s: float = 0.0,
    velocity_m_per_s: Mapping[str, Point] | None = None,
    reflectors: Sequence[CornerReflector] | None = None,
) -> RadarView:
    """The scatterers that a radar sees of a scene.

    Cars are facets by physical optics with small corners in them (`car_scatterers`), corner reflectors have the cross
    section of their aperture, everything else is points of generic cross section (``GENERIC_RCS_DBSM``): one for a
    pedestrian, a cyclist, a board or a post, one for each post of a guard rail, six for a tree.

    Args:
        scene: what there is to see.
        radar: its carrier and its unambiguous range count.
        T_vehicle_from_radar: pose, ``(4, 4)``. The default is upright and facing ahead, 0.5 m over the origin.
        ego_speed_m_per_s: of the vehicle, forward, -100 to 100.
        velocity_m_per_s: x, y, z over ground in the vehicle frame, by the name of an object or reflector; what is not
            named stands still.
        reflectors: corner reflectors in the scene; ``None`` takes its own in ``REFLECTORS``.

    Returns:
        `RadarView`; the same for the same arguments.

    Note:
        Left out are what lies behind the radar or beyond ``radar.max_range_m`` (which a real receiver's filter takes
        out, and which would appear at another range here), the ground, walls and roofs, and the wood on the horizon.
        Nothing hides anything, and there are no echoes by way of the ground or the guard rail. Every car is the same
        generic hatchback,
        without its faintest parts (1e-5 of its power).

    References:
        PHYSICS.md 6.1, 6.3.

    Example:
        >>> from torchweather.scenes import test_track
        >>> view = radar_view(test_track(), Radar.preset("imaging-77ghz"), ego_speed_m_per_s=2.0)
        >>> corner = view.of("corner 20 m")
        >>> [round(float(v[corner]), 2) for v in (view.scatterers.range_m, view.scatterers.rcs_dbsm)]
        [20.0, 10.0]
        >>> round(float(view.scatterers.speed_m_per_s[view.of("car 28 m")].mean()), 2)
        -2.0
    """
    check_arguments(
        "radar_view(scene: Scene, radar: Radar, T_vehicle_from_radar: Tensor | Sequence | None, "
        "ego_speed_m_per_s: float, velocity_m_per_s: Mapping | None, reflectors: Sequence[CornerReflector] | None)",
        scene,
        radar,
        T_vehicle_from_radar,
        ego_speed_m_per_s,
        velocity_m_per_s,
        reflectors,
    )
    check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner="radar_view")
    corners = REFLECTORS.get(scene.name, ()) if reflectors is None else tuple(reflectors)
    names = (*(thing.name for thing in scene.objects), *(corner.name for corner in corners))
    velocities = _velocities(velocity_m_per_s or {}, names)
    like = torch.zeros((), dtype=torch.float64)
    pose = checked_pose("radar_view", "radar", T_vehicle_from_radar, like, BUMPER_MOUNT_M)
    boxes, owners = object_boxes(scene, torch.eye(4, dtype=torch.float64))
    box_of = dict(zip(owners.tolist(), boxes.tolist(), strict=True))

    found: list[tuple[int, SceneLabel, Scatterers]] = []
    for k, name in enumerate(names):
        x, y, z = velocities.get(name, (0.0, 0.0, 0.0))
        relative = (x - float(ego_speed_m_per_s), y, z)
        if k >= len(scene.objects):
            corner = corners[k - len(scene.objects)]
            found.append((k, SceneLabel.BOARD, _corner(corner, pose[:3, 3], relative, radar.wavelength_m)))
        elif (label := scene.objects[k].label) is SceneLabel.CAR:
            found.append((k, label, _car(scene.objects[k], box_of[k], pose[:3, 3], relative, radar.wavelength_m)))
        elif label in GENERIC_RCS_DBSM:
            found.append((k, label, _points(scene.objects[k], pose[:3, 3], relative)))
    return _view(found, names, scene, radar, pose)


def _view(
    found: list[tuple[int, SceneLabel, Scatterers]], names: tuple[str, ...], scene: Scene, radar: Radar, pose: Tensor
) -> RadarView:
    """All scatterers together, turned from the vehicle's axes into the radar's, without what it cannot see."""
    of_objects = [one for _, _, one in found]
    position = torch.cat([torch.zeros(0, 3, dtype=torch.float64), *(one.position_m for one in of_objects)])
    speed = torch.cat([torch.zeros(0, dtype=torch.float64), *(one.speed_m_per_s for one in of_objects)])
    field = torch.cat([torch.zeros(0, dtype=torch.complex128), *(one.field_m for one in of_objects)])
    count = torch.tensor([len(one.speed_m_per_s) for one in of_objects], dtype=torch.int64)
    object_id, label = (
        torch.tensor(values, dtype=torch.int64).repeat_interleave(count)
        for values in ([k for k, _, _ in found], [int(label) for _, label, _ in found])
    )
    position = position @ pose[:3, :3]
    range_m = torch.linalg.vector_norm(position, dim=-1)
    farthest_m = range_m + speed.clamp_min(0.0) * radar.frame_time_s
    seen = (position[:, 0] > 0) & (farthest_m <= radar.max_range_m) & (field != 0)
    boxes, owners = object_boxes(scene, torch.linalg.inv(pose))
    return RadarView(
        scatterers=Scatterers(position[seen], speed[seen], field[seen]),
        names=names,
        object_id=object_id[seen],
        label=label[seen],
        boxes=boxes,
        box_object_id=owners,
        T_vehicle_from_radar=pose,
    )


def _velocities(given: Mapping[str, Point], names: tuple[str, ...]) -> dict[str, Point]:
    for name, value in given.items():
        if name not in names:
            raise InputValueError(
                f"radar_view: velocity_m_per_s must name objects of the scene ({', '.join(names)}); got {name!r}."
            )
        if len(value) != 3:
            raise InputValueError(f"radar_view: velocity_m_per_s of {name} must be x, y, z in m/s; got {value!r}.")
        check_finite(f"velocity_m_per_s of {name}", torch.tensor(value), unit="m/s", owner="radar_view")
    return dict(given)


def _car(thing: SceneObject, box: list[float], radar_m: Tensor, velocity: Point, wavelength_m: float) -> Scatterers:
    """The generic car where the scene's stands; relative to the radar, in the vehicle's axes."""
    yaw = _heading_rad(thing)
    rear = [box[axis] - 0.5 * box[3] * along for axis, along in ((0, math.cos(yaw)), (1, math.sin(yaw)))]
    x, y, z = radar_m.tolist()
    car = car_scatterers(
        (rear[0] - x, rear[1] - y), wavelength_m, yaw_rad=yaw, velocity_m_per_s=velocity, radar_height_m=z
    )
    power = car.field_m.abs().square()
    weakest_first = power.argsort()
    held = power[weakest_first].cumsum(0) / power.sum()
    kept = weakest_first[held > NEGLIGIBLE].sort().values
    return Scatterers(car.position_m[kept], car.speed_m_per_s[kept], car.field_m[kept])


def _heading_rad(car: SceneObject) -> float:
    """From the tail lights to the head lights."""
    middle = {}
    for lamp in ("head_light", "tail_light"):
        at = [part.shape.bounding_sphere()[0] for part in car.parts if part.material == lamp]
        if not at:
            raise InputValueError(
                f"radar_view: car {car.name!r} must have parts of {lamp}, which distinguish its front from its rear."
            )
        middle[lamp] = [sum(point[axis] for point in at) / len(at) for axis in (0, 1)]
    (x1, y1), (x0, y0) = middle["head_light"], middle["tail_light"]
    # A car along an axis is meant exactly: rounding would turn its facets by 1e-16.
    return round(math.atan2(y1 - y0, x1 - x0), 12)


def _corner(corner: CornerReflector, radar_m: Tensor, velocity: Point, wavelength_m: float) -> Scatterers:
    """A corner reflector on its boresight; relative to the radar, in the vehicle's axes."""
    at = torch.tensor([corner.position_m], dtype=torch.float64)
    facing = torch.nn.functional.normalize(radar_m - at, dim=-1)
    edge, way = torch.tensor([corner.edge_m], dtype=torch.float64), torch.tensor(velocity, dtype=torch.float64)
    return corner_scatterers(at, facing, edge, radar_m, way, wavelength_m)


def _points(thing: SceneObject, radar_m: Tensor, velocity: Point) -> Scatterers:
    """Points of generic cross section; relative to the radar, in the vehicle's axes."""
    at = torch.tensor(_centres(thing), dtype=torch.float64).reshape(-1, 3) - radar_m
    away = at / torch.linalg.vector_norm(at, dim=-1, keepdim=True)
    return Scatterers.from_rcs(at, GENERIC_RCS_DBSM[thing.label], away @ away.new_tensor(velocity))


def _centres(thing: SceneObject) -> list[Point]:
    """Where the points of an object are."""
    if thing.label is SceneLabel.GUARD_RAIL:
        boxes = [part.shape for part in thing.parts if isinstance(part.shape, Box)]
        return [box.centre_m for box in boxes if max(box.size_m[:2]) < POST_M]
    if thing.label is SceneLabel.TREE:
        crowns = [
            shell.centre_m for part in thing.parts if isinstance(part.shape, Foliage) for shell in part.shape.shells
        ]
        return crowns[:: max(1, math.ceil(len(crowns) / CROWN_LAYERS))]
    spheres = [part.shape.bounding_sphere() for part in thing.parts]
    low, high = ([pick(c[axis] for c, _ in spheres) for axis in range(3)] for pick in (min, max))
    return [tuple((a + b) / 2 for a, b in zip(low, high, strict=True))]  # type: ignore[list-item]
