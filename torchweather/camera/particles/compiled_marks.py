"""Compiled pass over the points of a shell: point, mark and sum over pixels, one particle after the other.

The same formulas as ``Population._marks`` and ``streaks``, in double precision. Nothing is stored between the steps,
where torch writes about 60 arrays for each group of marks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchweather.camera.compiled_math import log_of_sum
from torchweather.core.compiled import jit, uncontracted

__all__ = ["Lens", "MarkShape", "Motion", "Nodes", "add_points", "farthest_around", "in_bands"]

Array = NDArray[np.float32]
Doubles = NDArray[np.float64]

ZERO, ONE, LEAST_LEVEL = np.float32(0), np.float32(1), np.float32(1e-30)
POINTS_AT_ONCE = 256  # whose marks stay in the innermost cache


class Lens(NamedTuple):
    """Camera of one sample: pinhole in px, exposure, aperture, focus, lens blur; D3.4's blend is 1.0 or 0.0."""

    fx: float
    fy: float
    cx: float
    cy: float
    focal_px: float
    exposure_s: float
    aperture_m: float
    focus_m: float
    blur_px: float
    published_blend: float


class Motion(NamedTuple):
    """Velocity of particles: ``fall`` times their speed plus ``drift``, in the camera's frame (right, down, forward).

    Args:
        row_share: rows that a rolling shutter goes on in one exposure, inverted; 0 for a global shutter.
        upright: 1.0 where every path runs along the columns.
    """

    fall_x: float
    fall_y: float
    fall_z: float
    drift_x: float
    drift_y: float
    drift_z: float
    row_share: float
    upright: float


class Nodes(NamedTuple):
    """Slots of a shell at one rate: margins, nearest and farthest particle, level axis and ln of the thinning."""

    reach_u: float
    reach_v: float
    near_m: float
    far_m: float
    level_low: float
    level_step: float
    thinning: float
    limit: float


class MarkShape(NamedTuple):
    """Constants of a mark, as ``streaks`` has them."""

    chord_0: float
    chord_1: float
    chord_2: float
    chord_3: float
    box_of_disk: float
    mean_chord: float
    smallest_px: float
    full: float
    wide_px: float
    disk_of_box: float
    slowest: float


@jit
def _chord_share(offset: float, shape: MarkShape) -> float:
    t = min(max(2.0 * offset, -1.0), 1.0)
    square = t * t
    return 0.5 + t * (shape.chord_0 + square * (shape.chord_1 + square * (shape.chord_2 + square * shape.chord_3)))


@jit
def _trapezoid_share(offset: float, length: float, chord: float, per_area: float) -> float:
    outer = 0.5 * (length + chord)
    inner = 0.5 * abs(length - chord)
    y = min(max(offset, -outer), outer)
    rising = (y + outer) ** 2 - max(y + inner, 0.0) ** 2 - max(y - inner, 0.0) ** 2
    return rising * per_area


@jit
def _optical(coverage: float, full: float) -> float:
    m = min(max(coverage, 0.0), full)
    if m < 0.02:  # the series' remainder is below 1e-9 of it
        return m * (1.0 + m * (1.0 / 2 + m * (1.0 / 3 + m * (1.0 / 4 + m * (1.0 / 5)))))
    return float(log_of_sum(ONE, np.float32(m / (1.0 - m))))  # -ln(1 - m)


@jit
def _cell(position: float, nodes: int) -> tuple[int, float]:
    if not position > 0.0:  # nan as well
        return 0, 0.0
    cell = int(min(position, nodes - 2.0))
    return cell, min(position - cell, 1.0)


@jit
def _read(table: Array, cell: int, share: float) -> float:
    low = float(table[cell])
    return low + share * (float(table[cell + 1]) - low)


@uncontracted
def _placed(drawn: np.float32, wide: np.float32, edge: np.float32) -> np.float32:
    """Column or row of a drawn number, the product rounded before the difference."""
    return drawn * wide - edge


@jit
def farthest_around(depth_m: Array, block_px: int) -> Array:
    """Farthest depth over 3 x 3 blocks around each block of a depth map."""
    height, width = depth_m.shape
    rows, columns = (height + block_px - 1) // block_px, (width + block_px - 1) // block_px
    own = np.full((rows, columns), -np.inf, np.float32)
    for row in range(height):
        for column in range(columns):
            most = own[row // block_px, column]
            for at in range(column * block_px, min((column + 1) * block_px, width)):
                most = max(most, depth_m[row, at])
            own[row // block_px, column] = most
    around = np.empty((rows, columns), np.float32)
    for row in range(rows):
        for column in range(columns):
            most = own[row, column]
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    most = max(most, own[r, c])
            around[row, column] = most
    return around


@jit
def in_bands(
    points: Array, limit: float, reach_u: float, width: int, band_columns: int
) -> tuple[Array, NDArray[np.int64]]:
    """Points ``(P, 4)`` of a level below ``limit``, band after band of columns, and where each band begins.

    Within a band they keep their order. A band's pixels stay in the cache while its points are rendered.
    """
    bands = (width + band_columns - 1) // band_columns
    begins, band_of = np.zeros(bands + 1, np.int64), np.empty(points.shape[0], np.int32)
    for point in range(points.shape[0]):
        band_of[point] = -1
        if points[point, 3] < limit:
            band_of[point] = _band(points[point, 0], reach_u, width, band_columns, bands)
            begins[band_of[point] + 1] += 1
    for band in range(bands):
        begins[band + 1] += begins[band]
    free = begins.copy()
    ordered = np.empty((begins[bands], 4), np.float32)
    for point in range(points.shape[0]):
        band = band_of[point]
        if band >= 0:
            for column in range(4):
                ordered[free[band], column] = points[point, column]
            free[band] += 1
    return ordered, begins


@jit
def _band(drawn_u: float, reach_u: float, width: int, band_columns: int, bands: int) -> int:
    u = drawn_u * (width + 2.0 * reach_u) - (reach_u + 0.5)
    return int(min(u / band_columns, bands - 1.0)) if u > 0.0 else 0  # nan: the first one


class _Marks(NamedTuple):
    """Marks of some points, ``(POINTS_AT_ONCE,)``; written by ``_shown`` and ``_measured``.

    Args:
        foot, log_level: m/px, and ln of the density of particles that are larger.
        u, v, z: column, row and depth.
        area, breadth: px2 and px.
        motion_u, motion_v: path of the exposure, px.
        clear: transmission of the fog.
    """

    foot: Doubles
    log_level: Doubles
    u: Doubles
    v: Doubles
    z: Doubles
    area: Doubles
    breadth: Doubles
    motion_u: Doubles
    motion_v: Doubles
    clear: Doubles


class _Into(NamedTuple):
    """Sums that marks are added to, flattened; see ``add_points``.

    Args:
        sums, faded, depth: ``(W * H,)``; ``faded`` is empty without fog.
        along, optical: ``(H,)`` spare: share of a mark in each row, and what it adds.
        height: H.
        first, last: columns.
        weighted: whether there is fog.
    """

    sums: Array
    faded: Array
    depth: Array
    along: Doubles
    optical: Doubles
    height: int
    first: int
    last: int
    weighted: bool


@jit
def _shown(
    marks: _Marks,
    points: Array,
    farthest_m: Array,
    block_px: int,
    footprint: Array,
    most: Array,
    bound: Array,
    nodes: Nodes,
    focal_px: float,
    small: bool,
    width: int,
    height: int,
) -> int:
    """Write place and level of the points that are shown, in their order, and return how many there are.

    Every point is computed to the end, and the next one is written over those that are not shown: a branch that the
    processor cannot foresee costs more than what is left out.
    """
    wide_u, edge_u = np.float32(width + 2.0 * nodes.reach_u), np.float32(nodes.reach_u + 0.5)
    wide_v, edge_v = np.float32(height + 2.0 * nodes.reach_v), np.float32(nodes.reach_v + 0.5)
    per_block, most_row, most_column = 1.0 / block_px, farthest_m.shape[1] - 1.0, farthest_m.shape[0] - 1.0
    feet, log_levels, zs, us, vs = marks.foot, marks.log_level, marks.z, marks.u, marks.v
    count = 0
    for point in range(points.shape[0]):
        level = points[point, 3]
        cell, share = _cell(float(points[point, 2]) * (footprint.size - 1), footprint.size)
        log_level = float(log_of_sum(ZERO, max(level, LEAST_LEVEL))) + _read(most, cell, share)
        log_level += nodes.thinning
        foot = _read(footprint, cell, share)
        z = foot * focal_px
        # Rounded as torch does: at column 1000 single precision holds 6e-5 px.
        u = float(_placed(points[point, 0], wide_u, edge_u))
        v = float(_placed(points[point, 1], wide_v, edge_v))
        near = abs(u) < 1e6 and abs(v) < 1e6
        shown = near & (level < nodes.limit) & (log_level < _read(bound, cell, share))
        shown = shown & (nodes.near_m <= z) & (z <= nodes.far_m)
        if small:
            row = int(min(max((v if near else 0.0) * per_block, 0.0), most_row))
            column = int(min(max((u if near else 0.0) * per_block, 0.0), most_column))
            shown = shown & (z < farthest_m[column, row])
        feet[count], log_levels[count], zs[count], us[count], vs[count] = foot, log_level, z, u, v
        count += int(shown)
    return count


@jit
def _measured(
    marks: _Marks,
    count: int,
    outline_m: Array,
    fall_speed: Array,
    nodes: Nodes,
    lens: Lens,
    motion: Motion,
    shape: MarkShape,
    fog_per_m: float,
    weighted: bool,
) -> None:
    """Write area, breadth, path and transmission of the first ``count`` marks."""
    per_fx, per_fy, per_step = 1.0 / lens.fx, 1.0 / lens.fy, 1.0 / nodes.level_step
    upright = motion.upright == 1.0
    fallen_px = lens.exposure_s * lens.fy / lens.focal_px
    feet, log_levels, zs, us, vs = marks.foot, marks.log_level, marks.z, marks.u, marks.v
    areas, breadths, clears = marks.area, marks.breadth, marks.clear
    motions_u, motions_v = marks.motion_u, marks.motion_v
    for mark in range(count):
        u, v, z, per_foot = us[mark], vs[mark], zs[mark], 1.0 / feet[mark]
        x, y = (u - lens.cx) * per_fx, (v - lens.cy) * per_fy
        growth = math.sqrt(1.0 + x * x + y * y)
        stop, above = _cell((log_levels[mark] - nodes.level_low) * per_step, outline_m.size)
        own_square = (_read(outline_m, stop, above) * per_foot) ** 2 * growth
        speed = _read(fall_speed, stop, above)
        motion_u = 0.0
        if upright:
            motion_v = speed * fallen_px * per_foot
        else:
            vx = motion.fall_x * speed + motion.drift_x
            vy = motion.fall_y * speed + motion.drift_y
            vz = motion.fall_z * speed + motion.drift_z
            motion_u = (vx - x * vz) * lens.exposure_s / z * lens.fx
            motion_v = (vy - y * vz) * lens.exposure_s / z * lens.fy
        blur = 0.0
        if lens.aperture_m > 0.0:
            blur = lens.aperture_m * per_foot
            if lens.focus_m < np.inf:
                blur = blur * abs(z - lens.focus_m) / lens.focus_m
        square = own_square + lens.blur_px * lens.blur_px + blur * blur
        area = own_square * (math.pi / 4)  # its opacity, the share of its own area, times its area
        if lens.published_blend == 1.0:
            diameter = math.sqrt(own_square)
            area = area * (1.0 + diameter) / diameter
        if motion.row_share != 0.0:
            stretch = 1.0 / max(1.0 - motion_v * motion.row_share, shape.slowest)
            v = v * stretch
            u = u + motion_u * (v * motion.row_share)
            motion_u, motion_v, area = motion_u * stretch, motion_v * stretch, area * stretch
            us[mark], vs[mark] = u, v
        if weighted:
            x, y = (u - lens.cx) * per_fx, (v - lens.cy) * per_fy
            clears[mark] = math.exp(-fog_per_m * z * math.sqrt(1.0 + x * x + y * y))
        areas[mark], breadths[mark] = area, math.sqrt(square)
        motions_u[mark], motions_v[mark] = motion_u, motion_v


@jit
def _own_chord(
    column: int, columns: int, side: float, across: float, share: float, chord: float, most: float, shape: MarkShape
) -> float:
    """Chord of a wide mark in a column: the disk's area there over the column's covered breadth.

    Args:
        column, columns: of the mark.
        side: the column's far edge from the mark's middle, px.
        across: breadth of the mark, px.
        share: of the disk's area in the column.
        chord, most: of the whole mark, and the longest one.
        shape: constants.
    """
    reach = 0.5 * across
    to_side = reach if column == columns - 1 else min(max(side, -reach), reach)
    from_side = -reach if column == 0 else min(max(side - 1.0, -reach), reach)
    mean = shape.mean_chord / shape.box_of_disk * chord * share * across
    return min(max(mean / max(to_side - from_side, 1e-3), shape.smallest_px), most)


@jit
def _add_upright(into: _Into, marks: _Marks, count: int, shape: MarkShape) -> None:
    """Add marks along the columns, one column of a mark after the other.

    In the rows where both ends of the trapezoid are far, each row has the same share: one value for all of them.
    """
    sums, faded, depth, along, optical = into.sums, into.faded, into.depth, into.along, into.optical
    us, vs, zs, areas, breadths = marks.u, marks.v, marks.z, marks.area, marks.breadth
    paths, clears = marks.motion_v, marks.clear
    for mark in range(count):
        u, v, z, breadth = us[mark], vs[mark], zs[mark], breadths[mark]
        length = max(abs(paths[mark]), shape.smallest_px)
        across, chord = max(breadth, shape.smallest_px), max(shape.box_of_disk * breadth, shape.smallest_px)
        wide = breadth > shape.wide_px
        longest = breadth if wide else chord
        extent, reach = 0.5 * (length + longest), 0.5 * across
        first, start = math.floor(v - extent + 0.5), math.floor(u - reach + 0.5)
        rows, columns = math.floor(v + extent + 0.5) - first + 1, math.floor(u + reach + 0.5) - start + 1
        begin, end = max(0, -first), min(rows, into.height - first)
        left, right = max(0, into.first - start), min(columns, into.last - start)
        if begin >= end or left >= right:
            continue
        own, per_across, edge = chord, 1.0 / across, first + 0.5 - v
        before = _chord_share((start + left - 0.5 - u) * per_across, shape) if left > 0 else 0.0
        flat_begin, flat_end, per_row = end, end, 0.0
        for column in range(left, right):
            side = start + column + 0.5 - u
            here = 1.0 if column == columns - 1 else _chord_share(side * per_across, shape)
            share = here - before
            before = here
            several = wide and columns > 1
            if several:
                own = _own_chord(column, columns, side, across, share, chord, longest, shape)
            if several or column == left:  # shares of the rows
                per_area, flat, per_row = 0.5 / (length * own), 0.5 * abs(length - own), 1.0 / max(length, own)
                flat_begin = min(max(math.ceil(1.0 - flat - edge), begin), end)
                flat_end = min(max(math.floor(flat - edge) + 1, flat_begin), end)
                below = _trapezoid_share(edge + (begin - 1), length, own, per_area) if begin > 0 else 0.0
                for step in range(begin, flat_begin):
                    upper = 1.0 if step == rows - 1 else _trapezoid_share(edge + step, length, own, per_area)
                    along[step - begin] = upper - below
                    below = upper
                if flat_end > flat_begin:
                    below = (edge + (flat_end - 1)) * per_row + 0.5
                for step in range(flat_end, end):
                    upper = 1.0 if step == rows - 1 else _trapezoid_share(edge + step, length, own, per_area)
                    along[step - begin] = upper - below
                    below = upper
            whole, at = areas[mark] * share, (start + column) * into.height + first + begin
            for row in range(flat_begin - begin):
                optical[row] = _optical(whole * along[row], shape.full)
            if flat_end > flat_begin:
                optical[flat_begin - begin : flat_end - begin] = _optical(whole * per_row, shape.full)
            for row in range(flat_end - begin, end - begin):
                optical[row] = _optical(whole * along[row], shape.full)
            for row in range(end - begin):
                if z < depth[at + row]:
                    sums[at + row] += optical[row]
            if into.weighted:
                for row in range(end - begin):
                    if z < depth[at + row]:
                        faded[at + row] += optical[row] * clears[mark]


@jit
def _add_leaning(into: _Into, marks: _Marks, count: int, shape: MarkShape) -> None:
    """Add marks in any direction, row by row of their major axis."""
    sums, faded, depth, shares = into.sums, into.faded, into.depth, into.along
    us, vs, zs, areas, breadths = marks.u, marks.v, marks.z, marks.area, marks.breadth
    motions_u, motions_v, clears = marks.motion_u, marks.motion_v, marks.clear
    for mark in range(count):
        u, v, z, clear = us[mark], vs[mark], zs[mark], clears[mark]
        area, breadth, motion_u, motion_v = areas[mark], breadths[mark], motions_u[mark], motions_v[mark]
        square = breadth * breadth
        steep = abs(motion_v) >= abs(motion_u)
        if steep:
            major, minor, along, aside = v, u, motion_v, motion_u
        else:
            major, minor, along, aside = u, v, motion_u, motion_v
        length = max(abs(along), shape.smallest_px)
        steepness = aside / along if abs(along) >= shape.smallest_px else aside
        path, disk = length * length, 0.75 * square
        slope = steepness * path / (path + disk)
        left_over = steepness * steepness * square * path / (path + disk)
        across = max(math.sqrt(square + left_over + shape.disk_of_box * slope * slope), shape.smallest_px)
        chord = max(shape.box_of_disk * breadth, shape.smallest_px)
        wide = breadth > shape.wide_px
        chord_most = breadth if wide else chord
        first = math.floor(major - 0.5 * (length + chord_most) + 0.5)
        rows = math.floor(major + 0.5 * (length + chord_most) + 0.5) - first + 1
        columns = math.floor(across) + 2
        # Pixels of the mark that are in the columns, and steps over the flattened frame.
        height = into.height
        low, high, low_aside, high_aside, stride, stride_aside = into.first, into.last, 0, height, height, 1
        if steep:
            low, high, low_aside, high_aside, stride, stride_aside = 0, height, into.first, into.last, 1, height
        begin, end = max(0, low - first), min(rows, high - first)
        if begin >= end:
            continue
        if columns > shares.size:
            shares = np.empty(2 * columns)
        reach, per_area = 0.5 * across, 0.5 / (length * chord)
        per_length, per_across = 1.0 / length, 1.0 / across
        # Between these edges the trapezoid of every column is flat.
        flat = 0.5 * (length - chord_most)
        below = _trapezoid_share(first + begin - 0.5 - major, length, chord, per_area) if begin > 0 else 0.0
        for step in range(begin, end):
            edge = first + step + 0.5 - major
            centre = minor + slope * (edge - 0.5)
            start = math.floor(centre - reach + 0.5)
            left, right = max(0, low_aside - start), min(columns, high_aside - start)
            before = 0.0
            for column in range(columns - 1):
                here = _chord_share((start + column + 0.5 - centre) * per_across, shape)
                shares[column] = here - before
                before = here
            shares[columns - 1] = 1.0 - before
            at = (first + step) * stride + start * stride_aside
            if edge - 1.0 >= -flat and edge <= flat:
                below = edge * per_length + 0.5
                for column in range(left, right):
                    optical = _optical(area * shares[column] * per_length, shape.full)
                    pixel = at + column * stride_aside
                    if z < depth[pixel]:
                        sums[pixel] += optical
                        if into.weighted:
                            faded[pixel] += optical * clear
                continue
            share_along = 0.0
            if not wide:
                here = 1.0 if step == rows - 1 else _trapezoid_share(edge, length, chord, per_area)
                share_along = here - below
                below = here
            for column in range(left, right):
                if wide:
                    side = start + column + 0.5 - centre
                    own = _own_chord(column, columns, side, across, shares[column], chord, chord_most, shape)
                    per_own = 0.5 / (length * own)
                    upper = 1.0 if step == rows - 1 else _trapezoid_share(edge, length, own, per_own)
                    lower = 0.0 if step == 0 else _trapezoid_share(edge - 1.0, length, own, per_own)
                    share_along = upper - lower
                optical = _optical(area * shares[column] * share_along, shape.full)
                pixel = at + column * stride_aside
                if z < depth[pixel]:
                    sums[pixel] += optical
                    if into.weighted:
                        faded[pixel] += optical * clear


@jit
def add_points(
    total: Array,
    faded: Array,
    points: Array,
    depth_m: Array,
    farthest_m: Array,
    block_px: int,
    footprint: Array,
    most: Array,
    bound: Array,
    outline_m: Array,
    fall_speed: Array,
    nodes: Nodes,
    lens: Lens,
    motion: Motion,
    shape: MarkShape,
    fog_per_m: float,
    first_column: int,
    last_column: int,
) -> None:
    """Add the optical depth of a shell's particles to the columns ``first_column..last_column`` of one frame.

    Pixels add up in the order of the points, whatever the columns are. Maps hold one column after the other, so that
    the pixels of a falling mark lie together.

    Args:
        total: ``(W, H)``, changed in place.
        faded: the same weighted with the fog's transmission, changed in place; ``(0, 0)`` without fog.
        points: ``(P, 4)`` column, row, depth and level in [0, 1); a level of 2 is an unused slot.
        depth_m: ``(W, H)`` of the scene.
        farthest_m: of the blocks around, ``farthest_around(depth_m, block_px)``.
        block_px: size of a block.
        footprint, most, bound: over the quantile of depth: m/px, ln of the slots' density, ln of that of particles.
        outline_m, fall_speed: over the level.
        nodes, lens, motion, shape: numbers.
        fog_per_m: extinction.
        first_column, last_column: columns.
    """
    width, height = total.shape
    weighted = faded.size > 0
    small = max(nodes.reach_u, nodes.reach_v) < block_px and motion.row_share == 0.0
    spare, rows = np.zeros((10, POINTS_AT_ONCE)), np.empty((2, max(height, 64)))
    place, mark_of = spare[:5], spare[5:]
    marks = _Marks(
        place[0], place[1], place[2], place[3], place[4], mark_of[0], mark_of[1], mark_of[2], mark_of[3], mark_of[4]
    )
    sums, sums_faded, depth = total.ravel(), faded.ravel(), depth_m.ravel()
    into = _Into(sums, sums_faded, depth, rows[0], rows[1], height, first_column, last_column, weighted)
    for begin in range(0, points.shape[0], POINTS_AT_ONCE):
        some = points[begin : begin + POINTS_AT_ONCE]
        count = _shown(
            marks, some, farthest_m, block_px, footprint, most, bound, nodes, lens.focal_px, small, width, height
        )
        _measured(marks, count, outline_m, fall_speed, nodes, lens, motion, shape, fog_per_m, weighted)
        if motion.upright == 1.0:
            _add_upright(into, marks, count, shape)
        else:
            _add_leaning(into, marks, count, shape)
