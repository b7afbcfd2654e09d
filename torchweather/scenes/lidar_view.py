"""The point cloud that a LiDAR measures of a scene in clear air, with its truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.core.random import keyed_stream
from torchweather.lidar.intensity import RETROREFLECTIVE_AT_255, WHITE
from torchweather.lidar.scan import scan_directions
from torchweather.lidar.sensor import CALIBRATION_REFLECTIVITY, Lidar, unit_directions
from torchweather.scenes.materials import Material, laser_reflectivity
from torchweather.scenes.object_boxes import object_boxes
from torchweather.scenes.pose import checked_pose
from torchweather.scenes.scene import Part, Scene

__all__ = ["ROOF_MOUNT_M", "BeamHits", "LidarView", "beam_hits", "lidar_view", "reported_intensity"]

# On the roof, above the origin of the vehicle frame and its camera: the height over ground of KITTI's scanner
# (Geiger et al. 2013, Vision meets robotics: the KITTI dataset, figure 3).
ROOF_MOUNT_M = (0.0, 0.0, 1.73)


@dataclass(frozen=True)
class LidarView:
    """A LiDAR's view of a scene, with its truth; row i is beam i.

    Args:
        points: x, y, z in the LiDAR's frame (metres), intensity in the sensor's unit, ring, ``(N, 5)``; a beam
            without return has 0 but for the ring. An unknown ring is -1. ``Lidar.speed_column`` holds 0 m/s, in
            place of the ring where it is column 4.
        directions: unit direction of every beam in the LiDAR's frame, ``(N, 3)``.
        grid: rings and columns of an organised scan; ``None`` where the directions came without.
        label: `SceneLabel` of what the beam's axis meets, ``(N,)`` int64; also where that is too faint or too far
            for a return. 0 is sky.
        object_id: index into ``Scene.objects``, ``(N,)`` int64; -1 is sky.
        cos_incidence: cosine between beam and surface normal, ``(N,)``; 0 is sky.
        boxes: around cars, pedestrians and cyclists, in the LiDAR's frame, ``(M, 7)``: centre x, y, z, length, width,
            height, yaw (see `object_boxes`).
        box_object_id: index of each box's owner in ``Scene.objects``, ``(M,)`` int64.
        T_vehicle_from_lidar: where the LiDAR stands, ``(4, 4)``.
    """

    points: Tensor
    directions: Tensor
    grid: tuple[int, int] | None
    label: Tensor
    object_id: Tensor
    cos_incidence: Tensor
    boxes: Tensor
    box_object_id: Tensor
    T_vehicle_from_lidar: Tensor

    @property
    def hit(self) -> Tensor:
        """Mask of the beams that have a return, ``(N,)`` bool."""
        found: Tensor = (self.points[:, :3] != 0).any(-1)
        return found


def lidar_view(
    scene: Scene,
    lidar: Lidar,
    *,
    directions: Tensor | None = None,
    T_vehicle_from_lidar: Tensor | Sequence[Sequence[float]] | None = None,
    range_noise_seed: int | None = None,
) -> LidarView:
    r"""Measurement of a scene by a LiDAR in clear air.

    A surface of reflectivity rho at the laser's wavelength, seen at the incidence i, is reported as a Lambertian one of
    ``rho cos i``, a retroreflector as one of its own strength; it gives a return where
    ``(rho cos i / pi) / R^2 >= X_thr = 0.1 / (pi R10^2)``, and nearer than ``near_start_m`` in any case.

    Args:
        scene: what there is to see.
        lidar: the sensor.
        directions: of the beams in the LiDAR's frame (x forward, y left, z up), ``(N, 3)``, or ``(rings, columns, 3)``
            for an organised scan; the result has their dtype and device. The default is ``lidar.directions``, and
            without those the sensor's scan pattern.
        T_vehicle_from_lidar: pose, ``(4, 4)``. The default is upright and facing ahead, 1.73 m over the origin.
        range_noise_seed: with a number, ranges carry the sensor's noise (``range_noise_m``); the same number gives the
            same noise. Ranges are rounded to ``range_resolution_m`` in any case.

    Returns:
        `LidarView`.

    Note:
        One ray stands for a beam: what fills a part of its cross-section only gives no mixed return. The near-range
        response xi hides no surface, as it hides none in real clouds; only the unit ``photons`` holds it (0 nearer
        than ``near_start_m``). Glass returns what its dust scatters: there is no interior behind it. Rough surfaces
        send more back at grazing incidence than Lambert's cosine says, so ground ends earlier here than on a road.
        Detection is by the mean signal, without photon noise. Output beyond the range of an integral unit is clipped
        at 255; fractions are cut off.

    References:
        PHYSICS.md 5.3, 5.9.

    Example:
        >>> from torchweather.scenes import test_track
        >>> ahead = torch.tensor([[1.0, 0.0, -0.04], [1.0, 0.0, 0.5]])
        >>> view = lidar_view(test_track(), Lidar(wavelength_nm=905.0), directions=ahead)
        >>> [round(x, 2) for x in view.points[:, 0].tolist()], view.hit.tolist()  # the car, the sky
        ([28.0, 0.0], [True, False])
    """
    check_arguments(
        "lidar_view(scene: Scene, lidar: Lidar, directions: real | None, "
        "T_vehicle_from_lidar: Tensor | Sequence | None, range_noise_seed: int | None)",
        scene,
        lidar,
        directions,
        T_vehicle_from_lidar,
        range_noise_seed,
    )
    return beam_hits(scene, lidar, directions, T_vehicle_from_lidar).measured(lidar, range_noise_seed)


@dataclass(frozen=True)
class BeamHits:
    """Surfaces that the beams of a LiDAR meet, row i that of beam i; noise and unit of intensity come with `measured`.

    Args:
        beams: unit directions in the LiDAR's frame, ``(N, 3)``.
        grid: rings and columns of an organised scan.
        range_m: ``(N,)``, infinite for the sky.
        reflectivity: apparent, 1 is Lambertian white at normal incidence, ``(N,)``.
        label: as in `LidarView`, like the rest.
    """

    beams: Tensor
    grid: tuple[int, int] | None
    range_m: Tensor
    reflectivity: Tensor
    label: Tensor
    object_id: Tensor
    cos_incidence: Tensor
    boxes: Tensor
    box_object_id: Tensor
    T_vehicle_from_lidar: Tensor

    def measured(self, lidar: Lidar, range_noise_seed: int | None = None) -> LidarView:
        """Report of a sensor with these beams, as of `lidar_view`. Ray casting, most of the work, is not repeated."""
        beams, grid, range_m, reflectivity = self.beams, self.grid, self.range_m, self.reflectivity
        measured = _measured_range(range_m, lidar, range_noise_seed)
        hit = _detected(range_m, reflectivity, lidar) & (measured > 0)
        hit = hit & (measured >= lidar.min_range_m) & (measured <= lidar.max_range_m)
        none = torch.zeros_like(range_m)
        xyz = torch.where(hit, measured, none)[:, None] * beams
        intensity = torch.where(hit, reported_intensity(reflectivity, torch.where(hit, range_m, none + 1), lidar), none)
        return LidarView(
            points=_at_rest(torch.cat([xyz, intensity[:, None], _rings(len(beams), grid, beams)[:, None]], -1), lidar),
            directions=beams,
            grid=grid,
            label=self.label,
            object_id=self.object_id,
            cos_incidence=self.cos_incidence,
            boxes=self.boxes,
            box_object_id=self.box_object_id,
            T_vehicle_from_lidar=self.T_vehicle_from_lidar,
        )


def beam_hits(
    scene: Scene,
    lidar: Lidar,
    directions: Tensor | None = None,
    T_vehicle_from_lidar: Tensor | Sequence[Sequence[float]] | None = None,
) -> BeamHits:
    """Surfaces that the beams meet; arguments as of `lidar_view`."""
    beams, grid = _beams(lidar, directions)
    beams = beams.to(torch.promote_types(beams.dtype, torch.float32))  # angles between beams need its digits
    pose = checked_pose("lidar_view", "lidar", T_vehicle_from_lidar, beams, ROOF_MOUNT_M)
    rays = beams @ pose[:3, :3].T
    # Beams of one azimuth have similar directions; the ray caster wants neighbours next to each other.
    order = torch.atan2(rays[:, 1], rays[:, 0]).argsort()
    seen = _in_laser_light(scene, lidar.wavelength_nm).cast(
        pose[:3, 3], rays[order], pixel_angle_rad=1e-3 * lidar.divergence_mrad
    )

    def by_beam(values: Tensor) -> Tensor:
        return torch.empty_like(values).index_copy_(0, order, values)

    cosine = by_beam(-(seen.normal * rays[order]).sum(-1)).clamp(0, 1)
    boxes, box_object_id = object_boxes(scene, torch.linalg.inv(pose))
    return BeamHits(
        beams=beams,
        grid=grid,
        range_m=by_beam(seen.range_m),
        reflectivity=by_beam(seen.reflectance[:, 0]) * cosine + by_beam(seen.emission[:, 0]),
        label=by_beam(seen.label),
        object_id=by_beam(seen.object_id),
        cos_incidence=cosine,
        boxes=boxes.to(beams.dtype),
        box_object_id=box_object_id,
        T_vehicle_from_lidar=pose,
    )


def _beams(lidar: Lidar, directions: Tensor | None) -> tuple[Tensor, tuple[int, int] | None]:
    """Unit directions ``(N, 3)``, and rings and columns where they are organised."""
    pattern = None
    if lidar.elevations_deg is not None and lidar.columns is not None:
        pattern = (len(lidar.elevations_deg), lidar.columns)
    if directions is None:
        directions = lidar.directions if lidar.directions is not None else scan_directions(lidar)
    unit = unit_directions(directions, owner=lidar)
    if unit.ndim > 3:
        raise InputValueError(
            "lidar_view: directions must be of shape (N, 3) or (rings, columns, 3), one scan at a time; "
            f"got {tuple(unit.shape)}."
        )
    if unit.ndim == 3:
        return unit.reshape(-1, 3), (unit.shape[0], unit.shape[1])
    return unit, pattern if pattern is not None and math.prod(pattern) == len(unit) else None


def _at_rest(points: Tensor, lidar: Lidar) -> Tensor:
    """Points ``(N, 5)`` with a column of speeds where the sensor measures them: scene and vehicle stand."""
    if lidar.speed_column is None:
        return points
    points = torch.nn.functional.pad(points, (0, max(0, lidar.speed_column + 1 - points.shape[1])))
    points[:, lidar.speed_column] = 0.0
    return points


def _in_laser_light(scene: Scene, wavelength_nm: float) -> Scene:
    """The scene in grey: its colour is the reflectivity for the laser, its emission what retroreflectors send back.

    The ray caster takes the surface's grain from the material, so a scene of other materials is all that it takes.
    Emission is the part of a material that does not follow the cosine of the incidence.
    """
    surfaces: dict[Material, Material] = {}

    def in_laser_light(part: Part) -> Part:
        material = part.surface
        if material not in surfaces:
            diffuse, straight_back = laser_reflectivity(material, wavelength_nm), material.retroreflectivity
            surfaces[material] = replace(material, rgb=(diffuse,) * 3, emission_rgb=(straight_back,) * 3)
        return Part(part.shape, surfaces[material])

    return replace(
        scene,
        objects=tuple(replace(thing, parts=tuple(map(in_laser_light, thing.parts))) for thing in scene.objects),
    )


def _measured_range(range_m: Tensor, lidar: Lidar, seed: int | None) -> Tensor:
    """Range with the sensor's noise, rounded to its resolution; ``inf`` stays."""
    if seed is not None and lidar.range_noise_m > 0:
        drawn = keyed_stream(seed, "scene.lidar_range_noise").standard_normal(size=len(range_m), dtype="float32")
        range_m = range_m + lidar.range_noise_m * torch.from_numpy(drawn).to(range_m)
    if lidar.range_resolution_m > 0:
        range_m = torch.round(range_m / lidar.range_resolution_m) * lidar.range_resolution_m
    return range_m


def _detected(range_m: Tensor, reflectivity: Tensor, lidar: Lidar) -> Tensor:
    """Check whether a surface of that apparent reflectivity gives a return, the limits of range apart.

    The near-range response is left out: with it, surfaces nearer than ``near_start_m``, which real clouds have, would
    be gone; and with these let through, a dark ring would open behind them where the response begins to rise.
    """
    signal = reflectivity / math.pi / range_m**2  # 0 for the sky at infinity
    return (signal >= lidar.threshold_per_m2_sr) | (range_m < lidar.near_start_m)


def reported_intensity(reflectivity: Tensor, range_m: Tensor, lidar: Lidar) -> Tensor:
    """Apparent reflectivity (1 is Lambertian white) in the sensor's unit of intensity, rounded as the unit is."""
    unit = lidar.intensity_unit
    if unit == "none":
        return torch.ones_like(reflectivity)
    if unit == "photons":
        falloff = (lidar.range_at_10_percent_m / range_m) ** 2 * lidar.near_response(range_m)
        return lidar.photons_at_threshold * (reflectivity / CALIBRATION_REFLECTIVITY) * falloff
    value = WHITE[unit] * reflectivity
    if unit == "uint8_calibrated":
        # Linear up to a white surface at 100, logarithmic from there to a retroreflector at 255.
        per_log = (255.0 - WHITE[unit]) / math.log(RETROREFLECTIVE_AT_255)
        value = torch.where(reflectivity > 1, WHITE[unit] + per_log * reflectivity.clamp_min(1).log(), value)
    if unit in ("uint8_linear", "uint8_calibrated"):
        hair = 1e-3  # 0.29 * 100 is 28.999999999999996
        value = torch.floor(value + hair).clamp(0, 255)
    return value


def _rings(number: int, grid: tuple[int, int] | None, like: Tensor) -> Tensor:
    """Ring of each beam, row by row; -1 where there are no rows."""
    if grid is None:
        return like.new_full((number,), -1.0)
    return torch.arange(grid[0], device=like.device, dtype=like.dtype).repeat_interleave(grid[1])
