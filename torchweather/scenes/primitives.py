"""Where a ray first meets a shape: patches, boxes, ellipsoids, cylinders, capsules and facets.

A ray is ``origin + t * direction``; directions need not be unit vectors, so that with camera rays scaled to z = 1
the parameter ``t`` is the depth along the optical axis itself. All lengths are metres, all shapes stand in the
vehicle frame (x forward, y left, z up).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from torchweather.core.errors import check_positive
from torchweather.scenes.position_noise import value_noise

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Ellipsoid",
    "FacetMesh",
    "Foliage",
    "GroundPatch",
    "Plane",
    "Point",
    "Shape",
    "Treeline",
    "enclosing_sphere",
]

Point = tuple[float, float, float]

# A hit nearer than this many direction lengths is the surface that the ray starts on.
NEAREST = 1e-4


class Shape(Protocol):
    """Interface of a shape for the ray caster."""

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit: parameter ``t`` ``(N,)`` (``inf`` is a miss) and unit normal towards the viewer ``(N, 3)``.

        Args:
            origin: start of all rays, metres, ``(3,)``.
            direction: ``(N, 3)``, any length above zero.
        """
        ...

    def bounding_sphere(self) -> tuple[Point, float]:
        """Centre and radius of a sphere that holds the shape, metres; the radius may be infinite."""
        ...


def _sphere_of(low: Point, high: Point) -> tuple[Point, float]:
    """The sphere around an axis-aligned box."""
    centre = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2)
    return centre, math.dist(low, high) / 2


def enclosing_sphere(spheres: list[tuple[Point, float]]) -> tuple[Point, float]:
    """A sphere around others: about the middle of the box that holds them; infinite if one of them is."""
    if any(math.isinf(radius) for _, radius in spheres):
        return spheres[0][0], math.inf
    low = [min(centre[k] - radius for centre, radius in spheres) for k in range(3)]
    high = [max(centre[k] + radius for centre, radius in spheres) for k in range(3)]
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2)
    return middle, max(math.dist(middle, centre) + radius for centre, radius in spheres)


def _facing(normal: Tensor, direction: Tensor) -> Tensor:
    """The normal's side that looks at the viewer."""
    return torch.where((normal * direction).sum(-1, keepdim=True) > 0, -normal, normal)


def _unit(vector: Tensor) -> Tensor:
    return torch.nn.functional.normalize(vector, dim=-1)


def _at(origin: Tensor, direction: Tensor, t: Tensor) -> Tensor:
    """Point of the ray; misses are put at the origin so that no NaN comes from ``inf * 0``."""
    return origin + torch.where(torch.isfinite(t), t, torch.zeros_like(t))[:, None] * direction


def _only(valid: Tensor, t: Tensor) -> Tensor:
    return torch.where(valid & (t > NEAREST), t, torch.full_like(t, math.inf))


@dataclass(frozen=True)
class Plane:
    """An infinite plane.

    Args:
        point_m: any point of it.
        normal: unit vector across it.

    Example:
        >>> wall = Plane(point_m=(10.0, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
        >>> wall.intersect(torch.zeros(3), torch.tensor([[1.0, 0.5, 0.0]]))[0]
        tensor([10.])
    """

    point_m: Point
    normal: Point

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        normal = direction.new_tensor(self.normal)
        along = direction @ normal
        t = ((direction.new_tensor(self.point_m) - origin) @ normal) / along
        return _only(along != 0, t), _facing(normal.expand_as(direction), direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Infinite."""
        return self.point_m, math.inf


@dataclass(frozen=True)
class GroundPatch:
    """A horizontal rectangle, whole or dashed along x: a lawn, a road, the paint on it.

    Patches of one height give bit-equal ``t``; the caster lets the later part win a tie, so paint lies on the road
    without any gap between them.

    Args:
        x_m, y_m: extent ``(low, high)``.
        z_m: height.
        dash_m, gap_m: painted and unpainted length along x from ``x_m[0]`` on; no gap is a whole rectangle.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    z_m: float = 0.0
    dash_m: float = 1.0
    gap_m: float = 0.0

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        dx, dy, dz = direction.unbind(-1)
        t = (self.z_m - origin[2]) / dz
        x, y = origin[0] + t * dx, origin[1] + t * dy
        inside = (x >= self.x_m[0]) & (x < self.x_m[1]) & (y >= self.y_m[0]) & (y < self.y_m[1])
        if self.gap_m > 0:
            inside = inside & (torch.remainder(x - self.x_m[0], self.dash_m + self.gap_m) < self.dash_m)
        up = direction.new_tensor([0.0, 0.0, 1.0])
        return _only(inside, t), _facing(up.expand_as(direction), direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around the rectangle."""
        return _sphere_of((self.x_m[0], self.y_m[0], self.z_m), (self.x_m[1], self.y_m[1], self.z_m))


@dataclass(frozen=True)
class Box:
    """A box turned about the vertical.

    Args:
        centre_m: middle of the box.
        size_m: full edges along its own x, y, z.
        yaw_rad: turn from x to y.

    Example:
        >>> box = Box(centre_m=(10.5, 0.0, 0.0), size_m=(1.0, 1.0, 1.0))
        >>> box.intersect(torch.zeros(3), torch.tensor([[1.0, 0.0, 0.0]]))[0]
        tensor([10.])
    """

    centre_m: Point
    size_m: Point
    yaw_rad: float = 0.0

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turn = direction.new_tensor(
            [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
        )  # local from vehicle, right-hand
        d = direction @ turn
        o = (origin - direction.new_tensor(self.centre_m)) @ turn
        half = direction.new_tensor(self.size_m) / 2
        # A component of exactly zero would give 0 / 0 on a face; this shifts the ray by far less than a micrometre.
        d = torch.where(d == 0, torch.full_like(d, 1e-12), d)
        first, second = (-half - o) / d, (half - o) / d
        near, axis = torch.minimum(first, second).max(-1)
        far, far_axis = torch.maximum(first, second).min(-1)
        inside = near <= NEAREST
        t = torch.where(inside, far, near)
        axis = torch.where(inside, far_axis, axis)
        normal = torch.nn.functional.one_hot(axis, 3).to(d) @ turn.T
        return _only(near <= far, t), _facing(normal, direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around the box."""
        return self.centre_m, math.hypot(*self.size_m) / 2


def _ellipsoid_roots(
    centre: Point, semi_axes: Point, origin: Tensor, direction: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Both roots and whether they exist; the ray is scaled to the unit sphere.

    The discriminant is taken from the distance of closest approach, which keeps its digits where ``b^2 - a c`` cancels.
    """
    axes = direction.new_tensor(semi_axes)
    o, d = (origin - direction.new_tensor(centre)) / axes, direction / axes
    a = (d * d).sum(-1)
    middle = -(d @ o) / a
    closest = o + middle[:, None] * d
    rest = 1 - (closest * closest).sum(-1)
    half_chord = (rest.clamp_min(0) / a).sqrt()
    return middle - half_chord, middle + half_chord, rest >= 0


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid with axes along x, y, z; equal semi-axes make a sphere.

    Args:
        centre_m: middle.
        semi_axes_m: half the length along x, y, z.

    Example:
        >>> ball = Ellipsoid(centre_m=(10.0, 0.0, 0.0), semi_axes_m=(1.0, 1.0, 1.0))
        >>> ball.intersect(torch.zeros(3), torch.tensor([[1.0, 0.0, 0.0]]))[0]
        tensor([9.])
    """

    centre_m: Point
    semi_axes_m: Point

    def __post_init__(self) -> None:
        for axis in self.semi_axes_m:
            check_positive("semi_axes_m", axis, unit="m", owner=self)

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        near, far, met = _ellipsoid_roots(self.centre_m, self.semi_axes_m, origin, direction)
        t = _only(met, torch.where(near > NEAREST, near, far))
        return t, _facing(self._normal(_at(origin, direction, t)), direction)

    def _normal(self, point: Tensor) -> Tensor:
        return _unit((point - point.new_tensor(self.centre_m)) / point.new_tensor(self.semi_axes_m) ** 2)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere of the longest semi-axis."""
        return self.centre_m, max(self.semi_axes_m)


@dataclass(frozen=True)
class Foliage:
    """Shells of leaves: ellipsoids with gaps, through which their far sides or what lies behind is seen.

    A point of a shell is a leaf where noise of two scales, ``leaf_m`` and a half of it, exceeds the shell's threshold.

    Args:
        shells: the ellipsoids.
        gap_thresholds: one for each shell; 0 is closed, 1 is no leaf at all, half the shell is open near 0.5.
        leaf_m: size of a clump of leaves.
    """

    shells: tuple[Ellipsoid, ...]
    gap_thresholds: tuple[float, ...]
    leaf_m: float = 0.25

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`; ``N x K`` numbers are held for K shells."""
        centre = direction.new_tensor([shell.centre_m for shell in self.shells])  # (K, 3)
        axes = direction.new_tensor([shell.semi_axes_m for shell in self.shells])
        # As in `_ellipsoid_roots`, with the three components as sums of (N, K) terms.
        o = (origin - centre) / axes
        d = [direction[:, k, None] / axes[:, k] for k in range(3)]
        a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        middle = -(d[0] * o[:, 0] + d[1] * o[:, 1] + d[2] * o[:, 2]) / a
        closest = [o[:, k] + middle * d[k] for k in range(3)]
        rest = 1 - closest[0] ** 2 - closest[1] ** 2 - closest[2] ** 2
        half_chord = (rest.clamp_min(0) / a).sqrt()
        front = self._leaves(origin, direction, _only(rest >= 0, middle - half_chord))
        t, shell = front.min(-1)
        back = middle + half_chord
        # A far side counts only before the nearest leaf found so far.
        back_t, back_shell = self._leaves(origin, direction, _only((rest >= 0) & (back < t[:, None]), back)).min(-1)
        shell = torch.where(back_t < t, back_shell, shell)
        t = torch.minimum(t, back_t)
        normal = _unit((_at(origin, direction, t) - centre[shell]) / axes[shell] ** 2)
        return t, _facing(normal, direction)

    def _leaves(self, origin: Tensor, direction: Tensor, t: Tensor) -> Tensor:
        """``t`` ``(N, K)`` where the point is a leaf, else a miss; only real candidates pay for the noise."""
        ray, shell = torch.isfinite(t).nonzero(as_tuple=True)
        found = t[ray, shell]
        point = origin + found[:, None] * direction[ray]
        density = 0.6 * value_noise(point, self.leaf_m, seed=11) + 0.4 * value_noise(point, 0.45 * self.leaf_m, seed=12)
        leaf = density > t.new_tensor(self.gap_thresholds)[shell]
        return torch.full_like(t, math.inf).index_put((ray[leaf], shell[leaf]), found[leaf])

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around all shells."""
        return enclosing_sphere([shell.bounding_sphere() for shell in self.shells])


@dataclass(frozen=True)
class Cylinder:
    """A capped cylinder between two points; with ``inner_radius_m`` a tube with ring-shaped ends.

    Args:
        start_m, end_m: centres of the two ends.
        radius_m: outer radius.
        inner_radius_m: radius of the bore; 0 is solid.
    """

    start_m: Point
    end_m: Point
    radius_m: float
    inner_radius_m: float = 0.0

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        start = direction.new_tensor(self.start_m)
        axis = direction.new_tensor(self.end_m) - start
        length = float(axis.norm())
        axis = axis / length
        o = origin - start
        d_along, o_along = direction @ axis, o @ axis
        # In the plane across the axis the cylinder is a circle.
        d, o = direction - d_along[:, None] * axis, o - o_along * axis
        a = (d * d).sum(-1)
        middle = -(d @ o) / a
        closest = o + middle[:, None] * d
        miss2 = (closest * closest).sum(-1)
        best = torch.full_like(a, math.inf)
        normal = axis.expand_as(direction)
        for height in (0.0, length):
            t = (height - o_along) / d_along
            across = o + t[:, None] * d
            r2 = (across * across).sum(-1)
            t = _only((r2 <= self.radius_m**2) & (r2 >= self.inner_radius_m**2), t)
            best = torch.minimum(best, t)
        for radius in (self.radius_m, self.inner_radius_m):
            rest = radius**2 - miss2
            half_chord = (rest.clamp_min(0) / a).sqrt()
            for t in (middle - half_chord, middle + half_chord):
                height_at = o_along + t * d_along
                t = _only((rest > 0) & (height_at >= 0) & (height_at <= length), t)
                nearer = t < best
                best = torch.where(nearer, t, best)
                outward = _unit(o + torch.where(nearer, t, torch.zeros_like(t))[:, None] * d)
                normal = torch.where(nearer[:, None], outward, normal)
        return best, _facing(normal, direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around both ends."""
        centre, half = _sphere_of(self.start_m, self.end_m)
        return centre, math.hypot(half, self.radius_m)


@dataclass(frozen=True)
class Capsule:
    """All points within ``radius_m`` of a segment: limbs, tubes, branches.

    Args:
        start_m, end_m: ends of the segment.
        radius_m: distance from it.
    """

    start_m: Point
    end_m: Point
    radius_m: float

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        start = direction.new_tensor(self.start_m)
        segment = direction.new_tensor(self.end_m) - start
        length2 = segment @ segment
        o = origin - start
        d_along, o_along = direction @ segment / length2, o @ segment / length2
        d, across = direction - d_along[:, None] * segment, o - o_along * segment
        a = (d * d).sum(-1)
        middle = -(d @ across) / a
        closest = across + middle[:, None] * d
        rest = self.radius_m**2 - (closest * closest).sum(-1)
        t = middle - (rest.clamp_min(0) / a).sqrt()
        share = o_along + t * d_along
        best = _only((rest >= 0) & (share >= 0) & (share <= 1), t)
        ball = (self.radius_m,) * 3
        for end in (self.start_m, self.end_m):
            near, _, met = _ellipsoid_roots(end, ball, origin, direction)
            best = torch.minimum(best, _only(met, near))
        point = _at(origin, direction, best)
        share = (((point - start) @ segment) / length2).clamp(0, 1)
        return best, _facing(_unit(point - start - share[:, None] * segment), direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around the capsule."""
        centre, half = _sphere_of(self.start_m, self.end_m)
        return centre, half + self.radius_m


@dataclass(frozen=True)
class FacetMesh:
    """Flat triangles (Moeller and Trumbore 1997), seen from both sides.

    Args:
        vertices_m: corners.
        triangles: three indices into ``vertices_m`` each.
    """

    vertices_m: tuple[Point, ...]
    triangles: tuple[tuple[int, int, int], ...]

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`; ``N x K`` numbers are held for K triangles."""
        corner = direction.new_tensor(self.vertices_m)[
            torch.tensor(self.triangles, device=direction.device)
        ]  # (K, 3, 3)
        first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
        across = torch.linalg.cross(first, second)
        s = origin - corner[:, 0]
        # Cramer's rule; the triple products are rearranged so that each is one (N, 3) x (3, K) product.
        determinant = -(direction @ across.T)
        u = direction @ torch.linalg.cross(second, s).T / determinant
        v = -(direction @ torch.linalg.cross(first, s).T) / determinant
        t = (s * across).sum(-1) / determinant
        # A hair of overlap closes the seams between neighbours in float32.
        seam = -1e-5
        t, facet = _only((u >= seam) & (v >= seam) & (u + v <= 1 - seam), t).min(-1)
        return t, _facing(_unit(across)[facet], direction)

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around the box of all corners."""
        low = tuple(min(v[k] for v in self.vertices_m) for k in range(3))
        high = tuple(max(v[k] for v in self.vertices_m) for k in range(3))
        return _sphere_of(low, high)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Treeline:
    """The ragged silhouette of a distant wood: a vertical wall whose height is noise along it.

    Args:
        start_m, end_m: feet of the wall, (x, y).
        height_m: lowest and highest crown.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    height_m: tuple[float, float] = (7.0, 14.0)

    def intersect(self, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """First hit, see `Shape.intersect`."""
        along = (self.end_m[0] - self.start_m[0], self.end_m[1] - self.start_m[1])
        length = math.hypot(*along)
        tangent = direction.new_tensor([along[0] / length, along[1] / length, 0.0])
        normal = direction.new_tensor([along[1] / length, -along[0] / length, 0.0])
        foot = direction.new_tensor([*self.start_m, 0.0])
        t = ((foot - origin) @ normal) / (direction @ normal)
        point = _at(origin, direction, t)
        share = (point - foot) @ tangent
        maybe = torch.isfinite(t) & (share >= 0) & (share <= length) & (point[:, 2] >= 0)
        # Only rays between the ground and the highest crown pay for the noise.
        maybe = (maybe & (point[:, 2] <= self.height_m[1])).nonzero()[:, 0]
        inside = torch.zeros_like(t, dtype=torch.bool).index_put((maybe,), self._below_top(point[maybe], share[maybe]))
        return _only(inside, t), _facing(normal.expand_as(direction), direction)

    def _below_top(self, point: Tensor, share: Tensor) -> Tensor:
        """Crowns of about 12 m, boughs of 3 m, twigs that also depend on height."""
        line = torch.stack([share, torch.zeros_like(share), torch.zeros_like(share)], -1)
        crown = 0.6 * value_noise(line, 12.0, seed=3) + 0.3 * value_noise(line, 3.0, seed=4)
        crown = crown + 0.1 * value_noise(point, 0.7, seed=5)
        return point[:, 2] <= self.height_m[0] + (self.height_m[1] - self.height_m[0]) * crown

    def bounding_sphere(self) -> tuple[Point, float]:
        """Sphere around the wall."""
        return _sphere_of((*self.start_m, 0.0), (*self.end_m, self.height_m[1]))
