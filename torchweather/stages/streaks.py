"""The mark that a moving particle leaves in an exposure, and its deposit on the pixels.

The mark is the exposure-averaged coverage: a disk of (blurred) width b convolved with the path of length L,
divided by L, averaged over each pixel (``PHYSICS.md`` 4.5). Along the path's major image axis it is a trapezoid,
across it the disk's chord profile; both are integrated over the pixel through their distribution functions, so
the sum over pixels is ``opacity pi b^2 / 4`` whatever the speed. Marks multiply: optical depths
``-ln(1 - m)`` add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torchweather.stages.by_rows import is_exporting

__all__ = ["Marks", "add_listed", "add_static", "mark_coverage"]

# Distribution function of a unit disk's chord profile on t in [-1, 1]: 1/2 + t (c0 + c1 t^2 + ...), fitted to
# 1/2 + (t sqrt(1 - t^2) + asin t) / pi with both ends exact; largest error 7e-4 of the particle's area.
CHORD_SERIES = (0.6380486488342124, -0.1231837272642443, 0.033889293670296014, -0.048754215240264124)
MEAN_CHORD = math.pi / 4  # of a disk of unit width
SMALLEST_PX = 1e-2  # a path or chord below this is as good as a point
FULL = 1.0 - 2.0**-20  # largest coverage, so that the optical depth stays finite
WIDE_PX = 1.0  # from this width on the chord differs from column to column
# A slanted path smears across its row: box of width |slope|, variance slope^2 / 12 = b^2 / 16.
SMEAR = 16 / 12
CLASSES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 4096)
CHUNK = 1 << 17  # particles at a time, and pixels at a time: their arrays stay in the cache


@dataclass(frozen=True)
class Marks:
    """Particles in the image, one entry each, ``(P,)``.

    Args:
        sample: index of the sample they belong to.
        u_px, v_px: centre of the path; a pixel's centre (row i, column j) lies at v = i, u = j.
        motion_u_px, motion_v_px: path of the exposure.
        width_px: blurred width of the disk.
        opacity: peak coverage of the disk at rest.
        depth_m: along the optical axis.
        clearness: share of its light that fog lets through to the camera; ``None`` without fog.
    """

    sample: Tensor
    u_px: Tensor
    v_px: Tensor
    motion_u_px: Tensor
    motion_v_px: Tensor
    width_px: Tensor
    opacity: Tensor
    depth_m: Tensor
    clearness: Tensor | None = None

    def __len__(self) -> int:
        return self.u_px.shape[0]

    def take(self, index: Tensor | slice) -> Marks:
        """The entries of an index or a slice."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Marks(**{name: None if value is None else value[index] for name, value in values.items()})


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
    """A mark seen along its own major axis (rows where ``steep``, columns otherwise)."""

    steep: Tensor
    major: Tensor
    minor: Tensor
    length: Tensor
    slope: Tensor
    chord: Tensor
    chord_most: Tensor
    across: Tensor
    first_major: Tensor
    last_major: Tensor
    reach_minor: Tensor


def _frame(marks: Marks, *, vertical: bool) -> _Frame:
    width = marks.width_px
    if vertical:
        steep = torch.ones_like(width, dtype=torch.bool)
        major, minor = marks.v_px, marks.u_px
        length = marks.motion_v_px.abs().clamp_min(SMALLEST_PX)
        slope = torch.zeros((), dtype=width.dtype, device=width.device)
        shortened, across = width, width
        reach = 0.5 * width
    else:
        steep = marks.motion_v_px.abs() >= marks.motion_u_px.abs()
        major = torch.where(steep, marks.v_px, marks.u_px)
        minor = torch.where(steep, marks.u_px, marks.v_px)
        along = torch.where(steep, marks.motion_v_px, marks.motion_u_px)
        aside = torch.where(steep, marks.motion_u_px, marks.motion_v_px)
        length = along.abs().clamp_min(SMALLEST_PX)
        slope = aside / torch.where(along.abs() < SMALLEST_PX, torch.ones_like(along), along)
        slope = torch.where(along.abs() < SMALLEST_PX, torch.zeros_like(slope), slope)
        secant = torch.sqrt(1 + slope.square())
        shortened = width / secant
        across = torch.sqrt((width * secant).square() + SMEAR * slope.square())
        reach = 0.5 * across
    chord = (MEAN_CHORD * shortened).clamp_min(SMALLEST_PX)
    chord_most = torch.where(width > WIDE_PX, shortened.clamp_min(SMALLEST_PX), chord)
    half = 0.5 * (length + chord_most)
    return _Frame(
        steep,
        major,
        minor,
        length,
        slope,
        chord,
        chord_most,
        across.clamp_min(SMALLEST_PX),
        torch.floor(major - half + 0.5),
        torch.floor(major + half + 0.5),
        reach,
    )


def _coverage(marks: Marks, frame: _Frame, rows: int, columns: int, *, vertical: bool, wide: bool) -> tuple[Tensor, ...]:
    """Coverage ``(P, rows, columns)`` and the pixel of every entry (major, minor) on a footprint of fixed size."""
    device, dtype = marks.u_px.device, marks.u_px.dtype
    edge = torch.arange(rows + 1, device=device, dtype=dtype) - 0.5
    major_edge = frame.first_major[:, None] + edge - frame.major[:, None]  # (P, rows + 1)
    row_at = frame.first_major[:, None] + torch.arange(rows, device=device, dtype=dtype)  # (P, rows)
    if vertical:
        minor = frame.minor[:, None, None]
    else:
        within = torch.maximum(torch.minimum(row_at - frame.major[:, None], 0.5 * frame.length[:, None]), -0.5 * frame.length[:, None])
        minor = (frame.minor[:, None] + frame.slope[:, None] * within)[..., None]  # (P, rows, 1)
    first_minor = torch.floor(minor - frame.reach_minor[:, None, None] + 0.5)
    if columns == 1:
        share = torch.ones_like(minor)
        column_at = first_minor
    else:
        side = torch.arange(columns + 1, device=device, dtype=dtype) - 0.5
        offset = first_minor + side - minor  # (P, rows or 1, columns + 1)
        cumulative = chord_share(offset / frame.across[:, None, None])
        share = cumulative[..., 1:] - cumulative[..., :-1]
        column_at = first_minor + torch.arange(columns, device=device, dtype=dtype)
    if wide:
        reach = 0.5 * frame.across[:, None, None]
        covered = torch.minimum(offset[..., 1:], reach) - torch.maximum(offset[..., :-1], -reach)
        mean_chord = share * frame.chord[:, None, None] * frame.across[:, None, None] / covered.clamp_min(1e-3)
        chord = torch.minimum(mean_chord.clamp_min(SMALLEST_PX), frame.chord_most[:, None, None])
        chord = torch.where(marks.width_px[:, None, None] > WIDE_PX, chord, frame.chord[:, None, None])
        edges = major_edge[:, :, None]  # (P, rows + 1, 1)
        if not vertical:
            # each row has its own columns: integrate its two edges with its own chords
            lower = trapezoid_share(edges[:, :-1], frame.length[:, None, None], chord)
            upper = trapezoid_share(edges[:, 1:], frame.length[:, None, None], chord)
            portion = upper - lower
        else:
            along = trapezoid_share(edges, frame.length[:, None, None], chord)  # (P, rows + 1, columns)
            portion = along[:, 1:] - along[:, :-1]
    else:
        along = trapezoid_share(major_edge, frame.length[:, None], frame.chord[:, None])
        portion = (along[:, 1:] - along[:, :-1])[..., None]
    area = marks.opacity * (math.pi / 4) * marks.width_px.square()
    return area[:, None, None] * portion * share, row_at[..., None], column_at


def mark_coverage(marks: Marks, rows: int, columns: int) -> tuple[Tensor, Tensor, Tensor]:
    """Coverage of each mark on its own footprint of ``rows x columns`` along its major axis.

    Returns:
        Coverage ``(P, rows, columns)``, and the image row and column of every entry.
    """
    frame = _frame(marks, vertical=False)
    coverage, along, aside = _coverage(marks, frame, rows, columns, vertical=False, wide=True)
    steep = frame.steep[:, None, None]
    return coverage, torch.where(steep, along, aside), torch.where(steep, aside, along)


def _deposit(
    marks: Marks, frame: _Frame, rows: int, columns: int, depth_m: Tensor, size: tuple[int, int], *, vertical: bool, wide: bool
) -> tuple[Tensor, Tensor]:
    """Optical depth of every (particle, pixel) pair and the pixel's index in the flattened batch."""
    height, width = size
    coverage, along, aside = _coverage(marks, frame, rows, columns, vertical=vertical, wide=wide)
    if vertical:
        row, column = along, aside
    else:
        steep = frame.steep[:, None, None]
        row, column = torch.where(steep, along, aside), torch.where(steep, aside, along)
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    pixel = (
        row.clamp(0, height - 1).long() * width
        + column.clamp(0, width - 1).long()
        + (marks.sample * (height * width))[:, None, None]
    ).reshape(-1)
    behind = depth_m.index_select(0, pixel).view(coverage.shape)
    seen = inside & (marks.depth_m[:, None, None] < behind)
    optical = -torch.log1p(-torch.where(seen, coverage, torch.zeros_like(coverage)).clamp(0.0, FULL))
    return optical, pixel


def _add(
    total: Tensor, faded: Tensor | None, marks: Marks, optical: Tensor, pixel: Tensor
) -> tuple[Tensor, Tensor | None]:
    """Add (particle, pixel) pairs to the frame, and with fog their share that reaches the camera."""
    pixel = pixel.reshape(-1)
    total = total.index_add(0, pixel, optical.reshape(-1)) if is_exporting() else total.index_add_(0, pixel, optical.reshape(-1))
    if faded is not None and marks.clearness is not None:
        dimmed = (optical * marks.clearness[:, None, None]).reshape(-1)
        faded = faded.index_add(0, pixel, dimmed) if is_exporting() else faded.index_add_(0, pixel, dimmed)
    return total, faded


def add_static(
    total: Tensor, faded: Tensor | None, marks: Marks, depth_m: Tensor, size: tuple[int, int], rows: int, columns: int
) -> tuple[Tensor, Tensor | None]:
    """``add_listed`` on one footprint of fixed size: no shape depends on a value, as a graph needs it."""
    frame = _frame(marks, vertical=False)
    optical, pixel = _deposit(marks, frame, rows, columns, depth_m, size, vertical=False, wide=True)
    return _add(total, faded, marks, optical, pixel)


def _class_of(size: Tensor) -> Tensor:
    bounds = torch.tensor(CLASSES, device=size.device, dtype=size.dtype)
    return torch.bucketize(size, bounds).clamp_max(len(CLASSES) - 1)


def add_listed(
    total: Tensor, faded: Tensor | None, marks: Marks, depth_m: Tensor, size: tuple[int, int], *, vertical: bool
) -> tuple[Tensor, Tensor | None]:
    """Add the optical depth of every mark to the pixels that it covers in front of the scene.

    Marks of like footprint are handled together, in chunks that stay in the cache.

    Args:
        total: ``(B * H * W,)`` optical depth so far; changed in place.
        faded: the same weighted with each mark's ``clearness``, or ``None``; changed in place.
        marks: the particles.
        depth_m: ``(B * H * W,)`` scene depth; a pixel sees the particles nearer than it.
        size: H, W.
        vertical: every path runs along the image's columns.

    Returns:
        ``total`` and ``faded``.
    """
    for start in range(0, len(marks), CHUNK):
        chunk = marks.take(slice(start, start + CHUNK))
        frame = _frame(chunk, vertical=vertical)
        rows = _class_of(frame.last_major - frame.first_major + 1)
        if vertical:
            needed = torch.floor(frame.minor + frame.reach_minor + 0.5) - torch.floor(frame.minor - frame.reach_minor + 0.5) + 1
        else:
            needed = torch.floor(2 * frame.reach_minor) + 2
        columns = _class_of(needed)
        kind = rows * len(CLASSES) + columns
        for number in torch.unique(kind).tolist():
            members = (kind == number).nonzero().squeeze(1)
            h, w = CLASSES[number // len(CLASSES)], CLASSES[number % len(CLASSES)]
            step = max(1, CHUNK // (h * w))
            wide = bool((chunk.width_px.index_select(0, members) > WIDE_PX).any()) and w > 1
            for first in range(0, len(members), step):
                some = members[first : first + step]
                part = chunk.take(some)
                part_frame = _take_frame(frame, some, vertical=vertical)
                optical, pixel = _deposit(part, part_frame, h, w, depth_m, size, vertical=vertical, wide=wide)
                total, faded = _add(total, faded, part, optical, pixel)
    return total, faded


def _take_frame(frame: _Frame, index: Tensor, *, vertical: bool) -> _Frame:
    values = {}
    for field in fields(_Frame):
        value = getattr(frame, field.name)
        values[field.name] = value if vertical and field.name == "slope" else value.index_select(0, index)
    return _Frame(**values)
