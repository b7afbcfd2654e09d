"""The mark that a moving particle leaves in an exposure, and its deposit on the pixels.

The mark is the exposure-averaged coverage: a disk of (blurred) width b convolved with the path of length L,
divided by L, averaged over each pixel (``PHYSICS.md`` 4.5). Along the path's major image axis it is a trapezoid,
across it the disk's chord profile; both are integrated over the pixel through their distribution functions, so
the sum over pixels is ``opacity pi b^2 / 4`` whatever the speed. A slanted mark is a sheared upright one with the
same second moments; its single pixels may differ from the exact mark's by some ten percent. Marks multiply:
optical depths ``-ln(1 - m)`` add up.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchweather.camera.particles.depth_blocks import BLOCK_PX, DepthBlocks
from torchweather.pipeline.tiling import is_exporting

__all__ = ["Marks", "add_listed", "add_static"]

# Distribution function of a unit disk's chord profile on t in [-1, 1]: 1/2 + t (c0 + c1 t^2 + ...), fitted to
# 1/2 + (t sqrt(1 - t^2) + asin t) / pi with both ends exact; largest error 7e-4 of the particle's area.
CHORD_SERIES = (0.6380486488342124, -0.1231837272642443, 0.033889293670296014, -0.048754215240264124)
MEAN_CHORD = math.pi / 4  # of a disk of unit width
BOX_OF_DISK = math.sqrt(12 / 16)  # width of the box with the variance of a unit disk's profile
SMALLEST_PX = 1e-2  # a path or chord below this is as good as a point
FULL = 1.0 - 2.0**-20  # largest coverage, so that the optical depth stays finite
WIDE_PX = 1.0  # from this width on the chord differs from column to column
# Equal variances of a box of width s and a disk of width b: s^2 / 12 = b^2 / 16.
DISK_OF_BOX = 16 / 12
# Footprints are rounded up to these sizes, so that marks of like size are handled together.
CLASSES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 4096)
UNSEEN = 0  # kind of a mark that covers no pixel in front of the scene
MARKS_AT_ONCE = 1 << 18
PAIRS_AT_ONCE = 1 << 17  # (particle, pixel) pairs whose arrays stay in the cache


@dataclass(frozen=True)
class Marks:
    """Particles in the image, one entry each, ``(P,)``.

    Args:
        sample: index of the sample they belong to; ``None`` where there is one sample.
        u_px, v_px: centre of the path; a pixel's centre (row i, column j) lies at v = i, u = j.
        motion_u_px, motion_v_px: path of the exposure; ``motion_u_px=None``: all paths run along the columns.
        width_px: blurred width of the disk.
        opacity: peak coverage of the disk at rest; 0 leaves the particle out.
        depth_m: along the optical axis.
        clearness: share of its light that fog lets through to the camera; ``None`` without fog.
    """

    sample: Tensor | None
    u_px: Tensor
    v_px: Tensor
    motion_u_px: Tensor | None
    motion_v_px: Tensor
    width_px: Tensor
    opacity: Tensor
    depth_m: Tensor
    clearness: Tensor | None = None

    def __len__(self) -> int:
        return self.u_px.shape[0]

    def take(self, index: slice) -> Marks:
        """The entries of a slice."""
        return _each(self, lambda value: value[index])


D = TypeVar("D", "Marks", "_Frame")


def _each(entries: D, function: Callable[[Tensor], Tensor]) -> D:
    """Apply a function to every field that is there."""
    present = {field.name: getattr(entries, field.name) for field in fields(entries)}
    changed: dict[str, Any] = {name: function(value) for name, value in present.items() if value is not None}
    return replace(entries, **changed)


def chord_share(offset: Tensor) -> Tensor:
    """Share of a disk of unit width that lies left of ``offset`` from its centre, in [0, 1]."""
    t = (2 * offset).clamp(-1, 1)
    square = t * t
    c0, c1, c2, c3 = CHORD_SERIES
    return 0.5 + t * (c0 + square * (c1 + square * (c2 + square * c3)))


def trapezoid_share(offset_px: Tensor, length_px: Tensor, chord_px: Tensor) -> Tensor:
    """Share of a box of ``length`` convolved with a box of ``chord`` that lies below ``offset`` from its centre."""
    outer = 0.5 * (length_px + chord_px)
    inner = 0.5 * (length_px - chord_px).abs()
    y = torch.maximum(torch.minimum(offset_px, outer), -outer)
    rising = (y + outer).square() - (y + inner).clamp_min(0).square() - (y - inner).clamp_min(0).square()
    return rising / (2 * length_px * chord_px)


@dataclass(frozen=True)
class _Frame:
    """Marks seen along their own major axis: rows where ``steep``, columns otherwise.

    ``steep`` and ``slope`` are ``None`` where every path runs along the columns of the image.
    """

    sample: Tensor | None
    steep: Tensor | None
    slope: Tensor | None
    major: Tensor
    minor: Tensor
    length: Tensor
    chord: Tensor
    chord_most: Tensor
    across: Tensor
    area: Tensor
    width: Tensor
    first_major: Tensor
    first_minor: Tensor
    depth_m: Tensor
    clearness: Tensor | None

    def take(self, index: Tensor) -> _Frame:
        """The entries of an index."""
        return _each(self, lambda value: value.index_select(0, index))

    def part(self, first: int, last: int) -> _Frame:
        """The entries ``first..last``, as views."""
        return _each(self, lambda value: value[first:last])


def _frame(marks: Marks) -> _Frame:
    width = marks.width_px
    steep = slope = None
    if marks.motion_u_px is None:
        major, minor = marks.v_px, marks.u_px
        length = marks.motion_v_px.abs().clamp_min(SMALLEST_PX)
        across = width
    else:
        steep = marks.motion_v_px.abs() >= marks.motion_u_px.abs()
        major = torch.where(steep, marks.v_px, marks.u_px)
        minor = torch.where(steep, marks.u_px, marks.v_px)
        along = torch.where(steep, marks.motion_v_px, marks.motion_u_px)
        aside = torch.where(steep, marks.motion_u_px, marks.motion_v_px)
        length = along.abs().clamp_min(SMALLEST_PX)
        resting = along.abs() < SMALLEST_PX
        slope, across = _sheared(length, aside, torch.where(resting, torch.ones_like(along), along), width)
    chord = (BOX_OF_DISK * width).clamp_min(SMALLEST_PX)
    chord_most = torch.where(width > WIDE_PX, width, chord)
    across = across.clamp_min(SMALLEST_PX)
    return _Frame(
        sample=marks.sample,
        steep=steep,
        slope=slope,
        major=major,
        minor=minor,
        length=length,
        chord=chord,
        chord_most=chord_most,
        across=across,
        area=marks.opacity * (math.pi / 4) * width.square(),
        width=width,
        first_major=torch.floor(major - 0.5 * (length + chord_most) + 0.5),
        first_minor=torch.floor(minor - 0.5 * across + 0.5),
        depth_m=marks.depth_m,
        clearness=marks.clearness,
    )


def _sheared(length: Tensor, aside: Tensor, along: Tensor, width: Tensor) -> tuple[Tensor, Tensor]:
    """Lean of a slanted mark per step along its major axis, and its width across.

    A disk moved along a slanted path is described as a sheared upright mark with the same second moments: the lean
    is the regression of the minor on the major coordinate, ``slope L^2 / (L^2 + 3/4 b^2)``, and what it leaves is
    the width. A long path leans as it runs; a disk at rest does not lean.
    """
    slope = aside / along
    square, disk = length.square(), 0.75 * width.square()
    lean = slope * square / (square + disk)
    left_over = slope.square() * width.square() * square / (square + disk)
    # Inside one row the lean smears the mark like a box.
    return lean, torch.sqrt(width.square() + left_over + DISK_OF_BOX * lean.square())


def _steps(number: int, like: Tensor) -> Tensor:
    return torch.arange(number, device=like.device, dtype=like.dtype)


def _shares(inner: Tensor, dim: int) -> Tensor:
    """Shares between consecutive edges from the distribution function at the inner edges; they sum to one."""
    # Pads come last dimension first.
    aside = (0, 0) * (inner.ndim - 1 - dim % inner.ndim)
    pad = torch.nn.functional.pad
    return pad(inner, (*aside, 0, 1), value=1.0) - pad(inner, (*aside, 1, 0))


def _coverage(frame: _Frame, rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """Coverage ``(rows, columns, P)`` on a footprint along the major axis.

    The marks come last: footprints are a few pixels wide, and operations run along the last axis. The second result is
    the footprint's first pixel along the minor axis, ``(rows or 1, 1, P)``.
    """
    if frame.slope is None:
        minor, first_minor = frame.minor[None, None], frame.first_minor[None, None]
    else:
        offset = frame.first_major + _steps(rows, frame.major)[:, None] - frame.major
        minor = (frame.minor + frame.slope * offset)[:, None]  # (rows, 1, P)
        first_minor = torch.floor(minor - 0.5 * frame.across + 0.5)
    coverage = frame.area[None, None]
    side = share = None
    if columns > 1:
        # Inner edges, (rows or 1, columns - 1, P).
        side = first_minor + (_steps(columns - 1, frame.major) + 0.5)[:, None] - minor
        share = _shares(chord_share(side / frame.across), 1)
        coverage = coverage * share
    if rows > 1:
        edge = frame.first_major + (_steps(rows - 1, frame.major) + 0.5)[:, None] - frame.major
        if side is not None and share is not None:
            length, chord = frame.length, _chord_of_columns(frame, side, share)
            if frame.slope is None or chord.shape[0] == 1:
                along = _shares(trapezoid_share(edge[:, None], length, chord), 0)
            else:
                # Each row has its own columns: its two edges are integrated with its own chords.
                low = trapezoid_share(edge[:, None], length, chord[1:])
                high = trapezoid_share(edge[:, None], length, chord[:-1])
                ends = torch.zeros_like(low[:1])
                along = torch.cat([high, ends + 1], 0) - torch.cat([ends, low], 0)
        else:
            along = _shares(trapezoid_share(edge, frame.length, frame.chord), 0)[:, None]
        coverage = coverage * along
    return coverage.expand(rows, columns, -1), first_minor


def _chord_of_columns(frame: _Frame, side: Tensor, share: Tensor) -> Tensor:
    """Mean chord of the disk in each column, ``(rows or 1, columns, P)``; one for all columns of a narrow mark.

    Args:
        frame: the marks.
        side: inner edges of the columns.
        share: of the disk in each column.
    """
    narrow = frame.chord[None, None]
    if not is_exporting() and not bool((frame.width > WIDE_PX).any()):
        return narrow
    reach = 0.5 * frame.across
    edges = torch.maximum(torch.minimum(side, reach), -reach)
    end = reach.expand_as(edges[:, :1])
    covered = torch.cat([edges, end], 1) - torch.cat([-end, edges], 1)
    # The disk's area in a column over the column's covered breadth.
    mean = (MEAN_CHORD / BOX_OF_DISK) * narrow * share * frame.across / covered.clamp_min(1e-3)
    wide = torch.minimum(mean.clamp_min(SMALLEST_PX), frame.chord_most)
    return torch.where(frame.width > WIDE_PX, wide, narrow)


def _pixels(
    frame: _Frame, first_minor: Tensor, footprint: tuple[int, int], size: tuple[int, int], *, clip: bool
) -> tuple[Tensor, Tensor | None]:
    """Index of every footprint's pixels in the flattened batch, ``(rows, columns, P)``, and which lie in the image."""
    height, width = size
    rows, columns = footprint
    along = (frame.first_major + _steps(rows, frame.major)[:, None])[:, None]  # (rows, 1, P)
    aside = first_minor + _steps(columns, frame.major)[:, None]  # (1 or rows, columns, P)
    # Where the picture ends along and aside, and pixels from one step to the next.
    end: Tensor | float = height - 1.0
    end_aside: Tensor | float = width - 1.0
    step: Tensor | int = width
    step_aside: Tensor | int = 1
    if frame.steep is not None:
        steep = frame.steep
        end, end_aside = torch.where(steep, end, end_aside), torch.where(steep, end_aside, end)
        step, step_aside = torch.where(steep, width, 1), torch.where(steep, 1, width)
    inside = None
    if clip:
        inside = ((along >= 0) & (along <= end)) & ((aside >= 0) & (aside <= end_aside))
        along, aside = along.clamp_min(0).clamp_max(end), aside.clamp_min(0).clamp_max(end_aside)
    first = along.long() * step
    if frame.sample is not None:
        first = first + frame.sample * (height * width)
    return first + aside.long() * step_aside, inside


def _deposit(
    total: Tensor,
    faded: Tensor | None,
    frame: _Frame,
    footprint: tuple[int, int],
    depth_m: Tensor,
    size: tuple[int, int],
    *,
    clip: bool,
    test_depth: bool,
) -> tuple[Tensor, Tensor | None]:
    """Add the optical depth of marks to their pixels; in place, except while a graph is traced."""
    coverage, first_minor = _coverage(frame, *footprint)
    pixel, inside = _pixels(frame, first_minor, footprint, size, clip=clip)
    seen = inside
    if test_depth:
        before = frame.depth_m < depth_m.index_select(0, pixel.reshape(-1)).view(coverage.shape)
        seen = before if inside is None else before & inside
    if seen is not None:
        coverage = torch.where(seen, coverage, torch.zeros_like(coverage))
    optical = coverage.clamp(0.0, FULL).neg_().log1p_().neg_()
    add = torch.Tensor.scatter_add if is_exporting() else torch.Tensor.scatter_add_
    # Mark by mark, so that pixels add up in one order whatever marks are beside these.
    where = pixel.movedim(-1, 0).reshape(-1)
    total = add(total, 0, where, optical.movedim(-1, 0).reshape(-1))
    if faded is not None and frame.clearness is not None:
        faded = add(faded, 0, where, (optical * frame.clearness).movedim(-1, 0).reshape(-1))
    return total, faded


def add_static(
    total: Tensor,
    faded: Tensor | None,
    marks: Marks,
    depth_m: Tensor,
    size: tuple[int, int],
    footprint: tuple[int, int],
) -> tuple[Tensor, Tensor | None]:
    """``add_listed`` on one footprint of fixed size: no shape depends on a value, as a graph needs it."""
    return _deposit(total, faded, _frame(marks), footprint, depth_m, size, clip=True, test_depth=True)


def _class_of(size: Tensor, classes: Tensor) -> Tensor:
    return classes.index_select(0, size.clamp(0, CLASSES[-1]).long())


def add_listed(
    total: Tensor,
    faded: Tensor | None,
    marks: Marks,
    depth_m: Tensor,
    size: tuple[int, int],
    blocks: DepthBlocks | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Add the optical depth of every mark to the pixels that it covers in front of the scene.

    Marks of like footprint are handled together, in portions that stay in the cache.

    Args:
        total: ``(B * H * W,)`` optical depth so far; changed in place.
        faded: the same weighted with each mark's ``clearness``, or ``None``; changed in place.
        marks: the particles.
        depth_m: ``(B * H * W,)`` scene depth; a pixel sees the particles nearer than it.
        size: H, W.
        blocks: extremes of ``depth_m``; spares most marks the test per pixel.

    Returns:
        ``total`` and ``faded``.
    """
    for start in range(0, len(marks), MARKS_AT_ONCE):
        chunk = marks.take(slice(start, start + MARKS_AT_ONCE))
        frame = _frame(chunk)
        kind = _kinds(chunk, frame, size, blocks)
        kind, order = torch.sort(kind, stable=True)
        counts = torch.bincount(kind, minlength=2 * len(CLASSES) ** 2 + 1).tolist()
        first = counts[UNSEEN]
        frame = frame.take(order[first:])
        first = 0
        for number, count in enumerate(counts):
            if number == UNSEEN or count == 0:
                continue
            footprint, simple = divmod(number - 1, 2)
            rows, columns = (CLASSES[place] for place in divmod(footprint, len(CLASSES)))
            step = max(1, PAIRS_AT_ONCE // (rows * columns))
            for some in range(first, first + count, step):
                part = frame.part(some, min(some + step, first + count))
                total, faded = _deposit(
                    total, faded, part, (rows, columns), depth_m, size, clip=not simple, test_depth=not simple
                )
            first += count
    return total, faded


def _kinds(marks: Marks, frame: _Frame, size: tuple[int, int], blocks: DepthBlocks | None) -> Tensor:
    """Class of each mark's footprint, and whether it is simple: inside the image and before the scene.

    ``UNSEEN`` is a mark that covers no pixel in front of the scene.
    """
    height, width = size
    rows = torch.floor(frame.major + 0.5 * (frame.length + frame.chord_most) + 0.5) - frame.first_major + 1
    if frame.slope is None or frame.steep is None:
        columns = torch.floor(frame.minor + 0.5 * frame.across + 0.5) - frame.first_minor + 1
        top, left, tall, broad = frame.first_major, frame.first_minor, rows, columns
    else:
        columns = torch.floor(frame.across) + 2
        # The mark leans aside by half of its drift in each direction; its end rows' centres lie up to half a pixel
        # beyond its ends.
        lean = 0.5 * frame.slope.abs() * (frame.length + frame.chord_most + 1)
        minor_low, minor_size = torch.floor(frame.first_minor - lean), columns + 2 * lean + 2
        top, tall = torch.where(frame.steep, frame.first_major, minor_low), torch.where(frame.steep, rows, minor_size)
        left, broad = torch.where(frame.steep, minor_low, frame.first_major), torch.where(frame.steep, minor_size, rows)
    # Classes may be larger than the mark: what they add must lie inside the image as well.
    bounds = torch.tensor(CLASSES, device=rows.device, dtype=rows.dtype)
    classes = torch.bucketize(torch.arange(CLASSES[-1] + 1, device=rows.device, dtype=rows.dtype), bounds)
    rows_class, columns_class = _class_of(rows, classes), _class_of(columns, classes)
    spare = (bounds.index_select(0, rows_class) - rows) + (bounds.index_select(0, columns_class) - columns)
    bottom, right = top + tall, left + broad
    # The rows that a class adds go on leaning, to either side.
    before = spare if frame.slope is not None else torch.zeros_like(spare)
    simple = (top >= before) & (left >= before) & (bottom + spare < height) & (right + spare < width)
    unseen = (bottom < 0) | (right < 0) | (top >= height) | (left >= width) | (frame.area <= 0)
    if blocks is None:
        simple = torch.zeros_like(simple)
    else:
        small = (tall <= 2 * BLOCK_PX) & (broad <= 2 * BLOCK_PX)
        nearest, farthest = blocks.at(marks.sample, marks.u_px, marks.v_px)
        simple &= small & (marks.depth_m < nearest)
        unseen |= small & (marks.depth_m >= farthest)
    kind = (rows_class * len(CLASSES) + columns_class) * 2 + simple + 1
    # Small integers sort fastest.
    return kind.masked_fill_(unseen, UNSEEN).to(torch.int16)
