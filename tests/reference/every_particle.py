"""Exposure-averaged coverage of a camera image by rain or snow, every single particle of the frustum drawn.

The slow, readable oracle of the camera's particle renderer: no defocus, no cut, no continuum, no table.
It imports numpy only and shares no line with ``torchweather``, so the two can only agree by being right.

A particle of diameter ``d = f D / Z`` px that moves ``L = f v t / Z`` px during the exposure covers
``m = disk(d) * segment(L) / L`` (convolution), and a pixel holds the box average of ``m``, hence
``sum over pixels of m = pi d^2 / 4`` at any speed. Marks are composited by ``1 - prod(1 - m)``.
Off the axis a sphere's mark is an ellipse, ``1 / cos(theta)`` longer along the radius (``projected_area_px2`` casts
rays at it); it is drawn as the disk of the same area.

Accuracy of one pixel of one mark, in shares of the mark's own peak pixel (measured against 200 nodes or 1500 lines,
tested against 200 x 200 points per pixel): 0.3 % for motion straight down and for rest, 1 % for slanted
motion. The sum over pixels is ``pi d^2 / 4`` to 1e-9 always.

References: PHYSICS.md 2.2 (rain), 2.4 (snow), 2.5 (fall speeds), 4.2-4.6 (camera).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Particles",
    "Population",
    "Rendered",
    "draw_particles",
    "geometric_extinction",
    "mark_patches",
    "population",
    "projected_area_px2",
    "rain_fall_speed",
    "render",
    "render_counted",
    "snow_fall_speed",
    "statistics",
]

Array = NDArray[np.float64]
Kind = Literal["rain", "snow"]

RAIN_DIAMETER_MM = (0.1, 8.0)  # Marshall-Palmer's default domain, PHYSICS.md 2.2
SNOW_SMALLEST_MELTED_MM = 0.1  # PHYSICS.md 2.4
SNOW_LARGEST_PHYSICAL_MM = 20.0  # PHYSICS.md 2.4: without this cap the tail reaches 60 mm
THIN_MARK_PX = 0.05  # narrower marks that move twice their width or more get a profile of equal area and variance
NODES_ACROSS = 8  # Gauss-Legendre nodes per pixel column
LINES_SLANTED = 32  # Gauss-Legendre lines across a slanted mark, per started pixel of its width
LINES_NEAR_AXIS = 256  # the same within 0.2 rad of the pixel axes, where a line hops a pixel edge almost at once
SLAB_RATIO = 1.1  # far end over near end of a depth slab; only sets how tightly the margin fits
VALUES_PER_CHUNK = 2_000_000  # bounds the memory of the temporaries (16 MB each)


@dataclass(frozen=True)
class Population:
    """An exponential size distribution ``N(D) = n0 exp(-slope D)`` on ``smallest_mm..largest_mm``.

    ``D`` is the drop's diameter for rain and the melted diameter for snow; ``N`` is per unit of that ``D``.
    """

    kind: Kind
    n0_per_m3_mm: float
    slope_per_mm: float
    smallest_mm: float
    largest_mm: float

    @property
    def per_m3(self) -> float:
        """Particles per cubic metre."""
        ends = math.exp(-self.slope_per_mm * self.smallest_mm) - math.exp(-self.slope_per_mm * self.largest_mm)
        return self.n0_per_m3_mm / self.slope_per_mm * ends

    def diameters_mm(self, uniform: Array) -> Array:
        """Diameters (melted ones for snow) at the cumulative probabilities ``uniform``: truncated inverse sampling."""
        low, high = math.exp(-self.slope_per_mm * self.smallest_mm), math.exp(-self.slope_per_mm * self.largest_mm)
        return -np.log(low - uniform * (low - high)) / self.slope_per_mm

    def optical_diameters_mm(self, diameter_mm: Array) -> Array:
        """Diameter of the mark that a particle leaves: its physical, not its melted one."""
        if self.kind == "rain":
            return diameter_mm
        # rho_s = 0.178 D_phys^-0.922 g/cm^3 (Brandes 2007), at most ice: PHYSICS.md 2.4.
        return np.maximum(2.2947 * diameter_mm**1.4437, 1.0293 * diameter_mm)

    def fall_speeds_m_per_s(self, diameter_mm: Array) -> Array:
        """Terminal speed, m/s, of particles of (melted) ``diameter_mm``."""
        return rain_fall_speed(diameter_mm) if self.kind == "rain" else snow_fall_speed(diameter_mm)

    def moment(self, power: int) -> float:
        """``int D_optical^power N(D) dD`` in mm^power per m^3, by a 20001-node Simpson rule in log diameter."""
        grid = np.linspace(math.log(self.smallest_mm), math.log(self.largest_mm), 20001)
        diameter = np.exp(grid)
        density = self.n0_per_m3_mm * np.exp(-self.slope_per_mm * diameter) * diameter
        weight = np.full(grid.size, 2.0)
        weight[1::2], weight[0], weight[-1] = 4.0, 1.0, 1.0
        values = self.optical_diameters_mm(diameter) ** power * density
        return float((weight * values).sum() * (grid[1] - grid[0]) / 3.0)


@dataclass(frozen=True)
class Particles:
    """Particles of one depth slab, as the image sees them at mid-exposure; every field is ``(M,)``."""

    x_px: Array
    y_px: Array
    depth_m: Array
    width_px: Array  # diameter of the disk
    motion_px: Array  # way of its centre during the exposure

    def __len__(self) -> int:
        return int(self.x_px.size)

    def pick(self, index: NDArray[np.intp] | slice) -> Particles:
        return Particles(
            self.x_px[index], self.y_px[index], self.depth_m[index], self.width_px[index], self.motion_px[index]
        )


@dataclass(frozen=True)
class Rendered:
    """A mask and the numbers of particles behind it."""

    mask: Array  # (H, W), covered share of pixel and exposure, 0..1
    n_drawn: int  # all particles, those in the margin around the image included
    n_in_frame: int  # those whose centre lies inside the image at mid-exposure


def rain_fall_speed(diameter_mm: Array) -> Array:
    """Fall speed of rain drops, m/s: Brandes 2002, Gunn-Kinzer below 0.5 mm, 9.17 m/s above 5.8 mm (PHYSICS.md 2.5)."""
    d = diameter_mm
    brandes = -0.1021 + 4.932 * d - 0.9551 * d**2 + 0.07934 * d**3 - 0.002362 * d**4
    gunn_kinzer = np.interp(d, [0.0, 0.1, 0.2, 0.3, 0.5], [0.0, 0.27, 0.72, 1.17, 2.06])
    return np.where(d < 0.5, gunn_kinzer, np.where(d > 5.8, 9.17, brandes))


def snow_fall_speed(melted_diameter_mm: Array) -> Array:
    """Fall speed of snow flakes, m/s: 2.07 times the melted diameter in centimetres to the 0.31 (PHYSICS.md 2.5)."""
    return 2.07 * (melted_diameter_mm / 10.0) ** 0.31


def population(kind: Kind, rate_mm_per_h: float) -> Population:
    """Marshall-Palmer rain or Sekhon-Srivastava snow at ``rate_mm_per_h`` (liquid equivalent)."""
    if kind == "rain":
        return Population("rain", 8000.0, 4.1 * rate_mm_per_h**-0.21, *RAIN_DIAMETER_MM)
    if kind == "snow":
        largest = (SNOW_LARGEST_PHYSICAL_MM / 2.2947) ** (1.0 / 1.4437)  # melted diameter of a 20 mm flake
        n0, slope = 2500.0 * rate_mm_per_h**-0.94, 2.29 * rate_mm_per_h**-0.45
        return Population("snow", n0, slope, SNOW_SMALLEST_MELTED_MM, largest)
    raise ValueError(f"population: kind must be 'rain' or 'snow'; got {kind!r}")


def geometric_extinction(pop: Population) -> float:
    """Covered area per volume, 1/m: ``(pi/4) int D_optical^2 N(D) dD`` (mm^2/m^3 = 1e-6 /m)."""
    return math.pi / 4.0 * pop.moment(2) * 1e-6


def projected_area_px2(
    diameter_m: float, depth_m: float, x_px: float, y_px: float, f_px: float, steps: int = 400
) -> float:
    """Area of a sphere's image, counted over a grid of rays; its centre lies at (x_px, y_px) from the principal point.

    A ray ``t (x, y, f)`` meets the sphere where the distance of its centre from the ray is below the radius.
    """
    centre = np.array([x_px, y_px, f_px]) * depth_m / f_px
    reach = 2.0 * f_px * diameter_m / depth_m  # holds images up to 60 degrees off the axis
    side = (np.arange(steps) + 0.5) / steps * 2 * reach - reach
    x, y = np.meshgrid(x_px + side, y_px + side)
    rays = np.stack([x, y, np.full_like(x, f_px)], -1)
    along = rays @ centre / np.linalg.norm(rays, axis=-1)
    hit = centre @ centre - along**2 < (0.5 * diameter_m) ** 2
    return float(hit.mean() * (2 * reach) ** 2)


def draw_particles(
    pop: Population,
    *,
    f_px: float,
    height: int,
    width: int,
    near_m: float,
    far_m: float,
    exposure_s: float,
    slant_rad: float,
    rng: np.random.Generator,
    principal_px: tuple[float, float] | None = None,
) -> Iterator[Particles]:
    """All particles whose mark can touch the image, depth slab by depth slab: Poisson counts, uniform in space.

    A volume element seen by one pixel is ``Z^2 / f^2 dZ``, so depths have density ``Z^2`` and image positions are
    uniform. Centres lie up to half the longest mark of the slab, plus one pixel, outside the image. The principal point
    (column, row) is the image's centre unless it is given.
    """
    centre_x, centre_y = principal_px or ((width - 1) / 2, (height - 1) / 2)
    corner_x, corner_y = max(centre_x, width - centre_x), max(centre_y, height - centre_y)
    widest = math.sqrt(math.hypot(1.0, corner_x / f_px, corner_y / f_px)) * 1.05
    largest = np.array([pop.largest_mm])
    largest_m = float(pop.optical_diameters_mm(largest)[0]) * 1e-3
    fastest_m_per_s = float(pop.fall_speeds_m_per_s(np.linspace(pop.smallest_mm, pop.largest_mm, 2001)).max())
    n_slabs = max(1, math.ceil(math.log(far_m / near_m) / math.log(SLAB_RATIO)))
    edges = np.geomspace(near_m, far_m, n_slabs + 1)
    for z0, z1 in pairwise(edges.tolist()):
        motion_px = f_px * fastest_m_per_s * exposure_s / z0
        disk_px = f_px * largest_m / z0 * widest
        margin_x = (abs(math.sin(slant_rad)) * motion_px + disk_px) / 2.0 + 1.0
        margin_y = (abs(math.cos(slant_rad)) * motion_px + disk_px) / 2.0 + 1.0
        area_px = (width + 2.0 * margin_x) * (height + 2.0 * margin_y)
        volume_m3 = area_px / f_px**2 * (z1**3 - z0**3) / 3.0
        left = int(rng.poisson(pop.per_m3 * volume_m3))
        while left > 0:
            n = min(left, VALUES_PER_CHUNK // 8)
            left -= n
            u = rng.random((4, n))
            depth = np.cbrt(z0**3 + u[0] * (z1**3 - z0**3))
            size_mm = pop.diameters_mm(u[1])
            # Pixel (row i, column j) is the square around (x, y) = (j, i), so the image is -0.5..W-0.5.
            x_px = -0.5 - margin_x + u[2] * (width + 2.0 * margin_x)
            y_px = -0.5 - margin_y + u[3] * (height + 2.0 * margin_y)
            secant = np.sqrt(1.0 + ((x_px - centre_x) / f_px) ** 2 + ((y_px - centre_y) / f_px) ** 2)
            yield Particles(
                x_px=x_px,
                y_px=y_px,
                depth_m=depth,
                width_px=f_px * pop.optical_diameters_mm(size_mm) * 1e-3 / depth * np.sqrt(secant),
                motion_px=f_px * pop.fall_speeds_m_per_s(size_mm) * exposure_s / depth,
            )


def _swept(t: Array, half_chord: Array, motion: Array) -> Array:
    """``int_-inf^t`` of a chord of length ``2 half_chord`` convolved with a motion of length ``motion``, over motion.

    The convolution of two boxes is a trapezoid; its integral is a second difference of ``max(., 0)^2 / 2``.
    """
    half_motion = 0.5 * motion
    reach = half_chord + half_motion
    t = np.clip(t, -reach, reach)  # beyond the ends nothing changes; keeps the differences well conditioned

    def ramp(s: Array) -> Array:
        return np.square(np.maximum(s, 0.0))

    near, far = t + half_chord, t - half_chord
    second = ramp(near + half_motion) - ramp(near - half_motion) - ramp(far + half_motion) + ramp(far - half_motion)
    return second * (0.5 / motion)


def _gauss(n: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights


def _thin_patch(p: Particles, rows: Array, columns: Array) -> Array:
    """Pixel values of marks far narrower than a pixel, moving down the image.

    Across: the exact share of the disk in each column. Along: chord by chord the profile is a trapezoid; all chords
    together are replaced by one box of the disk's along-motion variance (``r^2/4``, a box of length ``sqrt(3) r``),
    swept over the motion. Area, mean and variance of the mark stay exact.
    """
    r = 0.5 * p.width_px[:, None]
    t = np.clip((columns - p.x_px[:, None]) / r, -1.0, 1.0)
    left_share = (np.arcsin(t) + t * np.sqrt(1.0 - t * t)) / math.pi
    half_box = 0.5 * math.sqrt(3.0) * r
    below = _swept(rows - p.y_px[:, None], half_box, p.motion_px[:, None]) / (2.0 * half_box)
    area = (math.pi * r * r)[:, :, None]
    return area * np.diff(below, axis=1)[:, :, None] * np.diff(left_share, axis=1)[:, None, :]


def _full_patch(p: Particles, rows: Array, columns: Array) -> Array:
    """Pixel values of marks of any width moving down the image: exact along the motion, Gauss-Legendre across.

    The substitution ``w = r sin(angle)`` takes the square root out of the chord length ``2 r cos(angle)``.
    """
    nodes, weights = _gauss(NODES_ACROSS)
    r = 0.5 * p.width_px
    edge = np.arcsin(np.clip((columns - p.x_px[:, None]) / r[:, None], -1.0, 1.0))
    middle, half = 0.5 * (edge[:, 1:] + edge[:, :-1]), 0.5 * np.diff(edge, axis=1)
    half_chord = r[:, None, None] * np.cos(middle[:, :, None] + half[:, :, None] * nodes)  # (M, columns, nodes)
    weight = weights * half[:, :, None] * half_chord  # dw = r cos(angle) d(angle)
    t = (rows - p.y_px[:, None])[:, :, None, None]  # (M, rows + 1, 1, 1)
    below = _swept(t, half_chord[:, None], p.motion_px[:, None, None, None])
    values: Array = (np.diff(below, axis=1) * weight[:, None]).sum(-1)
    return values


def _n_lines(slant_rad: float, widest_px: float) -> int:
    near_axis = min(abs(math.sin(slant_rad)), abs(math.cos(slant_rad))) < 0.2
    return (LINES_NEAR_AXIS if near_axis else LINES_SLANTED) * max(1, math.ceil(widest_px))


def _slanted_patch(p: Particles, rows: Array, columns: Array, slant_rad: float) -> Array:
    """Pixel values of marks moving at ``slant_rad`` from straight down towards +x.

    The mark is cut into lines parallel to the motion; each line's way through each pixel is exact.
    """
    along_x, along_y = math.sin(slant_rad), math.cos(slant_rad)
    nodes, weights = _gauss(_n_lines(slant_rad, float(p.width_px.max())))
    angle = 0.5 * math.pi * nodes
    half_chord = 0.5 * p.width_px[:, None] * np.cos(angle)  # (M, lines)
    weight = 0.5 * math.pi * weights * half_chord
    offset = 0.5 * p.width_px[:, None] * np.sin(angle)
    x0 = p.x_px[:, None] + offset * along_y
    y0 = p.y_px[:, None] - offset * along_x
    at_column = (columns[:, :, None] - x0[:, None]) / along_x  # (M, columns + 1, lines): where a line meets the edge
    at_row = (rows[:, :, None] - y0[:, None]) / along_y
    enter_x, leave_x = np.minimum(at_column[:, 1:], at_column[:, :-1]), np.maximum(at_column[:, 1:], at_column[:, :-1])
    enter_y, leave_y = np.minimum(at_row[:, 1:], at_row[:, :-1]), np.maximum(at_row[:, 1:], at_row[:, :-1])
    enter = np.maximum(enter_y[:, :, None], enter_x[:, None])  # (M, rows, columns, lines)
    leave = np.maximum(np.minimum(leave_y[:, :, None], leave_x[:, None]), enter)
    chord, motion = half_chord[:, None, None], p.motion_px[:, None, None, None]
    swept = _swept(leave, chord, motion) - _swept(enter, chord, motion)
    values: Array = (swept * weight[:, None, None]).sum(-1)
    return values


def mark_patches(
    particles: Particles, slant_rad: float = 0.0, thin_px: float = THIN_MARK_PX
) -> Iterator[tuple[Array, NDArray[np.int64], NDArray[np.int64], Array]]:
    """Marks as patches of pixels: ``(values (M, h, w), first row (M,), first column (M,), depth in m (M,))``.

    Particles are grouped by the size of their patch, so that there is no loop over particles.

    Args:
        particles: what to draw; a resting particle (``motion_px = 0``) leaves its disk.
        slant_rad: direction of the motion, from straight down the image (+y) towards +x.
        thin_px: marks narrower than this, that move straight down and twice their width or more, take the closed form
            of ``_thin_patch``.
    """
    # A motion of 1e-6 px stands for rest: the swept integral divides by it.
    moving = Particles(
        particles.x_px,
        particles.y_px,
        particles.depth_m,
        particles.width_px,
        np.maximum(particles.motion_px, 1e-6),
    )
    straight = slant_rad == 0.0
    half_x = 0.5 * (moving.width_px + abs(math.sin(slant_rad)) * moving.motion_px)
    half_y = 0.5 * (moving.width_px + abs(math.cos(slant_rad)) * moving.motion_px)
    n_columns = np.ceil(2.0 * half_x).astype(np.int64) + 1
    n_rows = np.ceil(2.0 * half_y).astype(np.int64) + 1
    thin = (moving.width_px < thin_px) & (moving.motion_px >= 2.0 * moving.width_px) & straight
    key = (n_rows << 32) | (n_columns << 1) | thin
    for k in np.unique(key):
        members = np.flatnonzero(key == k)
        h, w, is_thin = int(k >> 32), int((k >> 1) & 0x7FFFFFFF), bool(k & 1)
        lines = NODES_ACROSS if straight else _n_lines(slant_rad, float(moving.width_px[members].max()))
        across = 1 if is_thin else lines
        step = max(1, VALUES_PER_CHUNK // (h * w * across))
        for start in range(0, members.size, step):
            index = members[start : start + step]
            p = moving.pick(index)
            first_row = np.floor(p.y_px - half_y[index] + 0.5).astype(np.int64)
            first_column = np.floor(p.x_px - half_x[index] + 0.5).astype(np.int64)
            rows = (first_row[:, None] + np.arange(h + 1)).astype(np.float64) - 0.5
            columns = (first_column[:, None] + np.arange(w + 1)).astype(np.float64) - 0.5
            if is_thin:
                values = _thin_patch(p, rows, columns)
            elif straight:
                values = _full_patch(p, rows, columns)
            else:
                values = _slanted_patch(p, rows, columns, slant_rad)
            yield values, first_row, first_column, p.depth_m


def _add_log_transmission(
    log_transmission: Array, scene_depth_m: Array, particles: Particles, slant_rad: float
) -> None:
    """Add ``log(1 - m)`` of each visible mark to the image ``log_transmission`` (in place), both ``(H, W)``."""
    height, width = log_transmission.shape
    for values, first_row, first_column, depth_m in mark_patches(particles, slant_rad):
        row = first_row[:, None, None] + np.arange(values.shape[1])[:, None]
        column = first_column[:, None, None] + np.arange(values.shape[2])
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width) & (values > 0.0)
        pixel = np.where(inside, row * width + column, 0)
        visible = inside & (depth_m[:, None, None] < scene_depth_m.ravel()[pixel])
        with np.errstate(divide="ignore"):  # a pixel covered all the time transmits nothing: log(0) is right
            absorbed = np.log1p(-np.minimum(values[visible], 1.0))
        log_transmission += np.bincount(pixel[visible], absorbed, height * width).reshape(height, width)


def render_counted(
    rate_mm_per_h: float,
    *,
    f_px: float,
    height: int,
    width: int,
    near_m: float,
    depth_m: float | Array,
    exposure_s: float,
    seed: int,
    kind: Kind = "rain",
    slant_rad: float = 0.0,
    far_m: float | None = None,
    principal_px: tuple[float, float] | None = None,
) -> Rendered:
    """Coverage mask of one frame and the numbers of particles behind it; arguments as in ``render``."""
    scene_depth_m = np.broadcast_to(np.asarray(depth_m, dtype=np.float64), (height, width))
    reach_m = float(scene_depth_m.max()) if far_m is None else far_m
    if not math.isfinite(reach_m):
        raise ValueError("render: the scene is infinitely deep; give far_m, the depth in m where drawing ends")
    log_transmission = np.zeros((height, width))
    n_drawn = n_in_frame = 0
    if rate_mm_per_h > 0.0 and reach_m > near_m:
        slabs = draw_particles(
            population(kind, rate_mm_per_h),
            f_px=f_px,
            height=height,
            width=width,
            near_m=near_m,
            far_m=reach_m,
            exposure_s=exposure_s,
            slant_rad=slant_rad,
            rng=np.random.default_rng(seed),
            principal_px=principal_px,
        )
        for particles in slabs:
            inside_x = np.abs(particles.x_px - (width - 1) / 2) < width / 2
            inside_y = np.abs(particles.y_px - (height - 1) / 2) < height / 2
            n_drawn += len(particles)
            n_in_frame += int((inside_x & inside_y).sum())
            _add_log_transmission(log_transmission, scene_depth_m, particles, slant_rad)
    return Rendered(-np.expm1(log_transmission), n_drawn, n_in_frame)


def render(
    rate_mm_per_h: float,
    *,
    f_px: float,
    height: int,
    width: int,
    near_m: float,
    depth_m: float | Array,
    exposure_s: float,
    seed: int,
    kind: Kind = "rain",
    slant_rad: float = 0.0,
    far_m: float | None = None,
    principal_px: tuple[float, float] | None = None,
) -> Array:
    """Share of each pixel and of the exposure that rain or snow covers: ``1 - prod(1 - m)``, every particle drawn.

    Args:
        rate_mm_per_h: rain rate or liquid-equivalent snow rate, mm/h; 0 gives zeros.
        f_px: focal length in pixels, the same in x and y.
        height: image rows.
        width: image columns.
        near_m: depth along the optical axis where particles begin, m, > 0.
        depth_m: scene depth along the axis, m: a number or ``(H, W)``. Particles behind it are hidden, per pixel.
        exposure_s: exposure time, s, >= 0.
        seed: seed of numpy's default generator.
        kind: "rain" (Marshall-Palmer) or "snow" (Sekhon-Srivastava, physical diameters).
        slant_rad: direction of the fall in the image, from straight down (+y) towards +x.
        far_m: depth where drawing ends; default: the deepest point of the scene.
        principal_px: column and row of the principal point; default: the image's centre.

    Returns:
        ``(H, W)`` float64 in 0..1. Its expectation is ``1 - exp(-alpha (depth - near) / cos(theta))`` with
        ``alpha = geometric_extinction(population(kind, rate))``, theta the pixel's angle from the axis.

    Example:
        >>> mask = render(50.0, f_px=1137.0, height=24, width=32, near_m=1.5, depth_m=6.0, exposure_s=0.005, seed=1)
        >>> mask.shape, bool(mask.min() >= 0.0), bool(mask.max() <= 1.0)
        ((24, 32), True, True)
    """
    return render_counted(
        rate_mm_per_h,
        f_px=f_px,
        height=height,
        width=width,
        near_m=near_m,
        depth_m=depth_m,
        exposure_s=exposure_s,
        seed=seed,
        kind=kind,
        slant_rad=slant_rad,
        far_m=far_m,
        principal_px=principal_px,
    ).mask


def statistics(mask: Array) -> dict[str, float]:
    """Numbers by which two renderers are compared, of one frame ``(H, W)``.

    ``mean`` and ``std`` over the pixels (divided by their number); ``vertical_k`` and ``horizontal_k``: mean of
    ``(m - mean)(m_k - mean)`` over all pairs ``k`` rows (columns) apart inside the frame, over ``std^2``;
    ``quantile_q``: quantiles in percent, linear between order statistics.

    Example:
        >>> stripes = np.tile([[0.0], [1.0]], (8, 4))
        >>> values = statistics(stripes)
        >>> values["mean"], values["vertical_1"], values["vertical_2"], values["horizontal_1"]
        (0.5, -1.0, 1.0, 1.0)
    """
    deviation = mask - mask.mean()
    variance = float(np.mean(deviation**2))

    def correlation(first: Array, second: Array) -> float:
        return float(np.mean(first * second)) / variance if variance > 0.0 else 0.0

    values = {"mean": float(mask.mean()), "std": math.sqrt(variance)}
    for lag in (1, 2, 4, 8):
        values[f"vertical_{lag}"] = correlation(deviation[:-lag], deviation[lag:])
    for lag in (1, 2):
        values[f"horizontal_{lag}"] = correlation(deviation[:, :-lag], deviation[:, lag:])
    for percent in (50.0, 90.0, 99.0, 99.9):
        values[f"quantile_{percent:g}"] = float(np.quantile(mask, percent / 100.0))
    return values
