"""A scene of simple shapes: what a ray hits, and the raw frame, depth, normals and labels that a camera sees of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from itertools import accumulate

import torch
from torch import Tensor

from torchweather.camera.bayer import mosaic
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError, check_at_least, check_positive
from torchweather.core.random import keyed_stream
from torchweather.core.threads import one_thread_an_operation
from torchweather.scenes.lighting import DiffuseLight, SlabShade, SphereShade
from torchweather.scenes.materials import MATERIALS, Material, surface_reflectance
from torchweather.scenes.primitives import Point, Shape, enclosing_sphere

__all__ = ["Hit", "Part", "Scene", "SceneLabel", "SceneObject", "SceneView"]

# Rays traced together: neighbours, because they share one bounding cone; few enough to stay in the processor's cache.
BLOCK_RAYS = 1 << 13
# Edge of a square tile of pixels: two tiles are a block.
TILE_PX = 64
# Neighbouring pixels whose luminance differs by more than this share of saturation are sampled finely.
EDGE_CONTRAST = 0.04
# Shades act on what lies flat and lower than this.
GROUND_BELOW_M = 0.3

# Noise of a generic automotive sensor: full well of a 3 um pixel, readout noise (both unverified for any one product).
FULL_WELL_ELECTRONS = 10_000.0
READ_NOISE_ELECTRONS = 4.0


class SceneLabel(IntEnum):
    """Class of what a pixel shows."""

    SKY = 0
    ROAD = 1
    LANE_MARKING = 2
    KERB = 3
    GRASS = 4
    CAR = 5
    PEDESTRIAN = 6
    CYCLIST = 7
    BOARD = 8
    GUARD_RAIL = 9
    POLE = 10
    TREE = 11
    FLOOR = 12
    WALL = 13
    ROOF = 14


@dataclass(frozen=True)
class Part:
    """One shape of one material; ``material`` is a name in `MATERIALS` or a `Material`."""

    shape: Shape
    material: Material | str

    @property
    def surface(self) -> Material:
        """The material itself."""
        return MATERIALS[self.material] if isinstance(self.material, str) else self.material


@dataclass(frozen=True)
class SceneObject:
    """Shapes that belong together, with one label.

    Args:
        name: unique in its scene.
        label: class of all its parts.
        parts: where two parts are hit at the very same distance, the later one is seen.
        shades: how it darkens the ground around it.
    """

    name: str
    label: SceneLabel
    parts: tuple[Part, ...]
    shades: tuple[SlabShade | SphereShade, ...] = ()


@dataclass(frozen=True)
class Hit:
    """First surface that rays meet; leading dimensions are those of the rays.

    Args:
        t: multiples of the ray's direction vector; the depth for camera rays scaled to z = 1. ``inf`` is sky.
        range_m: metres along the ray.
        point_m: where, vehicle frame, ``(..., 3)``; the ray's origin where nothing was hit.
        normal: unit, towards the viewer, ``(..., 3)``; 0 where nothing was hit.
        object_id: index into ``Scene.objects``; -1 is sky.
        label: `SceneLabel`.
        reflectance: linear red, green, blue, 0..1, ``(..., 3)``; 0 for the sky.
        emission: radiance sent by the surface itself, share of saturation, ``(..., 3)``.
        gloss: share mirrored at normal incidence.
    """

    t: Tensor
    range_m: Tensor
    point_m: Tensor
    normal: Tensor
    object_id: Tensor
    label: Tensor
    reflectance: Tensor
    emission: Tensor
    gloss: Tensor


@dataclass(frozen=True)
class SceneView:
    """A camera's view of a scene, with its truth.

    Args:
        bayer: raw mosaic, linear, black 0, saturation 1, ``(1, H, W)``.
        rgb: the colours before the mosaic, linear, ``(3, H, W)``; without sensor noise.
        depth_m: along the optical axis, of the pixel's central ray, ``(1, H, W)``; ``inf`` is sky.
        normal: unit normal in the vehicle frame, ``(3, H, W)``; 0 is sky.
        label: `SceneLabel`, ``(1, H, W)``, int64.
        object_id: index into ``Scene.objects``, ``(1, H, W)``, int64; -1 is sky.
        camera: the camera of this view.
    """

    bayer: Tensor
    rgb: Tensor
    depth_m: Tensor
    normal: Tensor
    label: Tensor
    object_id: Tensor
    camera: Camera


@dataclass(frozen=True)
class Scene:
    """Objects under one light.

    Args:
        name: of the scene.
        objects: later ones win where two are hit at the very same distance (paint on a road).
        light: the sky.

    Example:
        >>> from torchweather.scenes import test_track
        >>> camera = Camera.preset("lucid-triton").resized(64, 48)
        >>> view = test_track().view(camera)
        >>> view.bayer.shape, bool(torch.isinf(view.depth_m[0, 0]).any())
        (torch.Size([1, 48, 64]), True)
    """

    name: str
    objects: tuple[SceneObject, ...]
    light: DiffuseLight = field(default_factory=DiffuseLight)

    def __post_init__(self) -> None:
        names = [thing.name for thing in self.objects]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise InputValueError(f"Scene: names of objects must be unique; got {', '.join(doubled)} more than once.")

    def find(self, name: str) -> SceneObject:
        """The object of that name."""
        return self.objects[self.object_id(name)]

    def object_id(self, name: str) -> int:
        """Index of the object of that name, as ``Hit.object_id`` and ``SceneView.object_id`` hold it."""
        names = [thing.name for thing in self.objects]
        if name not in names:
            raise InputValueError(f"Scene: no object {name!r} in {self.name}; it has {', '.join(names)}.")
        return names.index(name)

    def cast(self, origin_m: Tensor | Sequence[float], direction: Tensor, *, pixel_angle_rad: float = 0.0) -> Hit:
        """First hit of each ray.

        Args:
            origin_m: start of all rays in the vehicle frame, metres, ``(3,)``.
            direction: ``(..., 3)`` float, any length above zero. Neighbouring rays should be neighbours in memory:
                they are traced in blocks, each against the objects in its cone only.
            pixel_angle_rad: angle between neighbouring rays; surface grain finer than that is averaged.

        Returns:
            `Hit` with the leading dimensions of ``direction``.

        Example:
            >>> from torchweather.scenes import test_track
            >>> hit = test_track().cast((0.0, 0.0, 1.5), torch.tensor([0.0, 0.0, -1.0]))
            >>> float(hit.range_m), SceneLabel(int(hit.label)).name
            (1.5, 'ROAD')
        """
        if direction.ndim < 1 or direction.shape[-1] != 3 or not direction.is_floating_point():
            raise InputValueError(
                "Scene.cast: direction must be a float tensor of shape (..., 3) = x, y, z in the vehicle frame; "
                f"got {direction.dtype} {tuple(direction.shape)}."
            )
        origin = torch.as_tensor(origin_m, dtype=direction.dtype, device=direction.device)
        lead = direction.shape[:-1]
        hit, _ = self._look(origin, direction.reshape(-1, 3), pixel_angle_rad, colour=False)
        return Hit(**{name: value.reshape((*lead, *value.shape[1:])) for name, value in vars(hit).items()})

    def radiance(self, hit: Hit, direction: Tensor) -> Tensor:
        """Light that comes back along each ray, share of saturation, ``(..., 3)``, 0..1.

        Diffuse reflection of sky and ground light, less what nearby objects hide, a mirrored share by Schlick's
        approximation of Fresnel reflection on glossy surfaces, and emission; the sky itself where nothing was hit.
        """
        lead = direction.shape[:-1]
        rays = direction.reshape(-1, 3)
        normal, point = hit.normal.reshape(-1, 3), hit.point_m.reshape(-1, 3)
        is_sky = hit.object_id.reshape(-1) < 0
        sky_light, ground_light = self.light.irradiance(normal)
        sky_light = sky_light * (1 - self._hidden_share(point, normal, is_sky))[:, None]
        reflectance = hit.reflectance.reshape(-1, 3)
        colour = reflectance / math.pi * (sky_light + ground_light) + hit.emission.reshape(-1, 3)
        gloss = hit.gloss.reshape(-1)
        shiny = (gloss > 0).nonzero()[:, 0]
        ray, face = torch.nn.functional.normalize(rays[shiny], dim=-1), normal[shiny]
        cosine = -(ray * face).sum(-1, keepdim=True)
        # Schlick 1994, An inexpensive BRDF model for physically-based rendering.
        mirror = gloss[shiny, None] + (1 - gloss[shiny, None]) * (1 - cosine).clamp(0, 1) ** 5
        mixed = torch.lerp(colour[shiny], self.light.mirrored(ray + 2 * cosine * face), mirror)
        colour = colour.index_put((shiny,), mixed)
        sky = is_sky.nonzero()[:, 0]
        colour = colour.index_put((sky,), self.light.sky_radiance(rays[sky]))
        return colour.clamp(0, 1).reshape(*lead, 3)

    def view(
        self,
        camera: Camera,
        *,
        shot_noise_seed: int | None = None,
        supersample: int = 2,
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> SceneView:
        """The raw frame that ``camera`` takes from above the origin of the vehicle frame, with its truth.

        Depth, normals and labels are those of each pixel's central ray; colours at edges are means over
        ``supersample`` x ``supersample`` rays.

        Args:
            camera: stands at (0, 0, ``camera.height_m``), looks along x; pitch, roll and lens distortion count.
            shot_noise_seed: with a number, the Bayer frame carries shot and readout noise of a generic sensor
                (10 000 electrons full well, 4 electrons readout); the same number gives the same noise.
            supersample: rays along each side of a pixel at edges; 1 is no antialiasing.
            device: where to compute; the default is torch's.
            dtype: float32 or float64.

        Returns:
            `SceneView`.
        """
        check_at_least("supersample", supersample, 1, unit="rays", owner="Scene.view")
        check_positive("width x height", camera.width * camera.height, unit="px", owner="Scene.view")
        height, width = camera.height, camera.width
        # A margin of two pixels (even, so that it is a crop) gives border pixels the neighbours that they have in a
        # larger frame: a cropped camera sees the crop of the picture.
        margin = 2
        wide = camera.cropped(-margin, -margin, height + 2 * margin, width + 2 * margin)
        pixel_angle = 1 / max(camera.fx, camera.fy)
        origin = torch.tensor([0.0, 0.0, camera.height_m], device=device, dtype=dtype)
        vehicle_from_camera = torch.tensor(camera.camera_from_vehicle(), device=device, dtype=dtype)  # as rows: v R
        order = _tile_order(wide.height, wide.width, device)
        direction = (wide.ray_directions(device=device, dtype=dtype).flatten(1).T @ vehicle_from_camera)[order]
        hit, colour = self._look(origin, direction, pixel_angle)

        def image(flat: Tensor) -> Tensor:
            """Values in tile order as a picture ``(C, H + 4, W + 4)``."""
            back = torch.empty_like(flat).index_copy_(0, order, flat)
            return back.reshape(wide.height, wide.width, -1).movedim(-1, 0)

        if supersample > 1:
            edges = _edges(image(colour), image(hit.object_id[:, None])).flatten()[order]
            fine = edges.nonzero()[:, 0]
            colour = colour.index_put(
                (fine,), self._fine_colour(wide, order[fine], supersample, origin, vehicle_from_camera)
            )

        def window(flat: Tensor) -> Tensor:
            return image(flat)[:, margin : margin + height, margin : margin + width].contiguous()

        rgb = window(colour)
        bayer = mosaic(rgb, camera.bayer_pattern)
        if shot_noise_seed is not None:
            bayer = with_sensor_noise(bayer, shot_noise_seed)
        return SceneView(
            bayer=bayer,
            rgb=rgb,
            depth_m=window(hit.t[:, None]),
            normal=window(hit.normal),
            label=window(hit.label[:, None]),
            object_id=window(hit.object_id[:, None]),
            camera=camera,
        )

    def _fine_colour(
        self, camera: Camera, pixel: Tensor, supersample: int, origin: Tensor, vehicle_from_camera: Tensor
    ) -> Tensor:
        """Mean colour of a grid of rays inside each of the given pixels (flat indices)."""
        cx, cy = camera.principal_point_px
        row, column = pixel // camera.width, pixel % camera.width
        step = (torch.arange(supersample, device=origin.device, dtype=origin.dtype) + 0.5) / supersample - 0.5
        y = (row[:, None, None] + step[:, None] - cy) / camera.fy  # (P, S, 1)
        x = (column[:, None, None] + step - cx) / camera.fx  # (P, 1, S)
        shape = (len(pixel), supersample, supersample)
        y, x = y.expand(shape), x.expand(shape)
        xu, yu = camera.undistort(x, y)
        direction = torch.stack([xu, yu, torch.ones_like(xu)], -1).reshape(-1, 3) @ vehicle_from_camera
        _, colour = self._look(origin, direction, 1 / (max(camera.fx, camera.fy) * supersample))
        return colour.reshape(-1, supersample**2, 3).mean(1)

    @cached_property
    def _parts(self) -> list[tuple[int, Part]]:
        """Every part with the index of its object."""
        return [(k, part) for k, thing in enumerate(self.objects) for part in thing.parts]

    @cached_property
    def _part_bounds(self) -> Tensor:
        return _as_rows([part.shape.bounding_sphere() for _, part in self._parts])

    @cached_property
    def _object_bounds(self) -> Tensor:
        return _as_rows([enclosing_sphere([p.shape.bounding_sphere() for p in thing.parts]) for thing in self.objects])

    @cached_property
    def _first_part(self) -> list[int]:
        """Index of each object's first part, and the number of all parts."""
        return [0, *accumulate(len(thing.parts) for thing in self.objects)]

    @cached_property
    def _surfaces(self) -> list[Material]:
        """The different materials."""
        return list(dict.fromkeys(part.surface for _, part in self._parts))

    @cached_property
    def _surface_of_part(self) -> list[int]:
        return [self._surfaces.index(part.surface) for _, part in self._parts]

    def _look(
        self, origin: Tensor, direction: Tensor, pixel_angle_rad: float, *, colour: bool = True
    ) -> tuple[Hit, Tensor]:
        """Hits and radiance of ``(N, 3)`` rays, block by block, so that intermediate arrays stay in the cache."""
        hits, colours = [], []
        with one_thread_an_operation():
            for start in range(0, max(len(direction), 1), BLOCK_RAYS):
                rays = direction[start : start + BLOCK_RAYS]
                hits.append(self._hit(origin, rays, pixel_angle_rad))
                colours.append(self.radiance(hits[-1], rays) if colour else rays[:0])
        joined = {name: torch.cat([vars(hit)[name] for hit in hits]) for name in vars(hits[0])}
        return Hit(**joined), torch.cat(colours)

    def _hit(self, origin: Tensor, direction: Tensor, pixel_angle_rad: float) -> Hit:
        """`cast` for one block of rays."""
        t, normal, part = self._trace(origin, direction)
        found = torch.isfinite(t)
        point = origin + torch.where(found, t, torch.zeros_like(t))[:, None] * direction
        range_m = t * direction.norm(dim=-1)
        # One more row at the end: part -1 is the sky.
        object_of_part = torch.tensor([*(k for k, _ in self._parts), -1], device=t.device)
        label_of_part = torch.tensor([*(int(self.objects[k].label) for k, _ in self._parts), 0], device=t.device)
        surface_of_part = torch.tensor([*self._surface_of_part, -1], device=t.device)
        gloss_of_part = torch.tensor([*(p.surface.gloss for _, p in self._parts), 0.0], device=t.device, dtype=t.dtype)
        footprint = torch.where(found, range_m, torch.zeros_like(t)) * pixel_angle_rad
        # A slanted surface lengthens the footprint one way; its geometric mean with the other way counts.
        slant = (normal * direction).sum(-1).abs() / direction.norm(dim=-1)
        footprint = footprint / slant.clamp_min(0.01).sqrt()
        surface_index = surface_of_part[part]
        reflectance, emission = torch.zeros_like(direction), torch.zeros_like(direction)
        for k in torch.bincount(surface_index + 1, minlength=1).nonzero()[:, 0].sub(1).tolist():
            if k >= 0:
                here = (surface_index == k).nonzero()[:, 0]
                reflectance[here], emission[here] = surface_reflectance(self._surfaces[k], point[here], footprint[here])
        return Hit(
            t=t,
            range_m=range_m,
            point_m=point,
            normal=normal,
            object_id=object_of_part[part],
            label=label_of_part[part],
            reflectance=reflectance,
            emission=emission,
            gloss=gloss_of_part[part],
        )

    def _trace(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Parameter, normal and part index (-1 is sky) of the first hit of one block of rays."""
        number = direction.shape[0]
        best = torch.full((number,), math.inf, dtype=direction.dtype, device=direction.device)
        normal = torch.zeros_like(direction)
        part = torch.full((number,), -1, dtype=torch.long, device=direction.device)
        if not number or not self._parts:
            return best, normal, part
        unit = torch.nn.functional.normalize(direction, dim=-1)
        centre, radius = _spheres(self._object_bounds, origin)
        part_centre, part_radius = _spheres(self._part_bounds, origin)
        part_seen = _cone_meets_sphere(unit, part_centre, part_radius).tolist()
        for k in _cone_meets_sphere(unit, centre, radius).nonzero()[:, 0].tolist():
            near = _near_spheres(unit, centre[k : k + 1], radius[k : k + 1])[0].nonzero()[:, 0]
            if not near.numel():
                continue
            every = near.numel() == number
            rays, first, last = direction if every else direction[near], self._first_part[k], self._first_part[k + 1]
            candidates = [index for index in range(first, last) if part_seen[index]]
            close = _near_spheres(unit if every else unit[near], part_centre[candidates], part_radius[candidates])
            for index, passes in zip(candidates, close, strict=True):
                chosen = passes.nonzero()[:, 0]
                if chosen.numel():
                    t, n = self._parts[index][1].shape.intersect(origin, rays[chosen])
                    target = near[chosen]
                    nearer = (torch.isfinite(t) & (t <= best[target])).nonzero()[:, 0]
                    target = target[nearer]
                    best[target], normal[target], part[target] = t[nearer], n[nearer], index
        return best, normal, part

    def _hidden_share(self, point_m: Tensor, normal: Tensor, is_sky: Tensor) -> Tensor:
        """Share of the sky's light that objects keep from level ground; 0 elsewhere."""
        lit = torch.ones_like(point_m[:, 0])
        ground = ((normal[:, 2] > 0.9) & (point_m[:, 2] < GROUND_BELOW_M) & ~is_sky).nonzero()[:, 0]
        if not ground.numel():
            return 1 - lit
        where = point_m[ground]
        (x_low, y_low, _), (x_high, y_high, _) = where.amin(0).tolist(), where.amax(0).tolist()
        for shade in (shade for thing in self.objects for shade in thing.shades):
            x, y, reach = shade.centre_m[0], shade.centre_m[1], shade.reach_m
            if x + reach < x_low or x - reach > x_high or y + reach < y_low or y - reach > y_high:
                continue
            near = (((where[:, 0] - x).abs() < reach) & ((where[:, 1] - y).abs() < reach)).nonzero()[:, 0]
            if near.numel():
                target = ground[near]
                lit[target] = lit[target] * (1 - shade.hidden_share(where[near]))
        return 1 - lit


def _as_rows(bounds: list[tuple[Point, float]]) -> Tensor:
    """Spheres as rows x, y, z, radius."""
    return torch.tensor([(*centre, radius) for centre, radius in bounds], dtype=torch.float64, device="cpu")


def _spheres(rows: Tensor, origin: Tensor) -> tuple[Tensor, Tensor]:
    """Centres relative to the rays' origin ``(K, 3)`` and radii ``(K,)``."""
    here = rows.to(origin)
    return here[:, :3] - origin, here[:, 3]


def _cone_meets_sphere(unit: Tensor, centre: Tensor, radius: Tensor) -> Tensor:
    """Mask ``(parts,)`` of the bounding spheres that the cone around all rays may meet; it spares tests of each ray."""
    axis = torch.nn.functional.normalize(unit.mean(0), dim=-1)
    # The slack covers rounding of the cosines near 1 (float32: acos(1 - 1e-7) = 5e-4 rad).
    half_angle = torch.acos((unit @ axis).amin().clamp(-1, 1)) + 2e-3
    distance = centre.norm(dim=-1).clamp_min(1e-9)
    off_axis = torch.acos((centre @ axis / distance).clamp(-1, 1))
    apparent = torch.asin((radius / distance).clamp(0, 1))
    meets: Tensor = (off_axis <= half_angle + apparent) | (distance <= radius)
    return meets


def _near_spheres(unit: Tensor, centre: Tensor, radius: Tensor) -> Tensor:
    """Mask ``(parts, N)`` of the rays that pass each sphere within its radius; some slack keeps rounding harmless."""
    distance2 = (centre * centre).sum(-1)
    # Distance^2 - along^2 cancels: its rounding is some 1e-7 of distance^2, the slack adds 1e-6 of it at least.
    reach2 = (1.01 * radius + 1e-3 * distance2.sqrt()) ** 2
    along = centre @ unit.T
    passes: Tensor = (distance2 - reach2)[:, None] <= along * along
    return passes


def _tile_order(height: int, width: int, device: torch.device | str | None) -> Tensor:
    """Flat pixel indices, tile by tile, so that rays traced together look the same way."""
    row = torch.arange(height, device=device)[:, None].expand(height, width)
    column = torch.arange(width, device=device).expand(height, width)
    tiles_across = -(-width // TILE_PX)
    tile = (row // TILE_PX) * tiles_across + column // TILE_PX
    inside = (row % TILE_PX) * TILE_PX + column % TILE_PX
    return torch.argsort((tile * TILE_PX**2 + inside).flatten())


def _edges(colour: Tensor, object_id: Tensor) -> Tensor:
    """Pixels that differ from one of their four neighbours in object or by `EDGE_CONTRAST`, ``(H, W)``."""
    luminance = colour.mean(0)
    edge = torch.zeros_like(luminance, dtype=torch.bool)
    for axis in (0, 1):
        first, second = (slice(None, -1), slice(1, None))
        at = (lambda part: (part, slice(None))) if axis == 0 else (lambda part: (slice(None), part))
        differs = (luminance[at(first)] - luminance[at(second)]).abs() > EDGE_CONTRAST
        differs = differs | (object_id[0][at(first)] != object_id[0][at(second)])
        edge[at(first)] |= differs
        edge[at(second)] |= differs
    return edge


def with_sensor_noise(signal: Tensor, seed: int) -> Tensor:
    """Shot and readout noise, normal approximation of the Poisson law, clipped to [0, 1] as a sensor clips."""
    drawn = keyed_stream(seed, "scene.sensor_noise").standard_normal(size=tuple(signal.shape), dtype="float32")
    variance = signal / FULL_WELL_ELECTRONS + (READ_NOISE_ELECTRONS / FULL_WELL_ELECTRONS) ** 2
    return (signal + variance.sqrt() * torch.from_numpy(drawn).to(signal)).clamp(0, 1)
