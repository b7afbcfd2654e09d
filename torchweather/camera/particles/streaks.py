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
from functools import lru_cache
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.particles.depth_blocks import BLOCK_PX, DepthBlocks
from torchweather.core.masks import compare, places_of
from torchweather.pipeline.graph_operations import (
    last_row_and_column,
    parts_of,
    rows_as_columns,
    rows_at,
    sums_before,
    sums_of_rows,
    weighted_sum,
)
from torchweather.pipeline.tiling import is_exporting

__all__ = ["Marks", "add_listed", "add_pairs"]

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
# Columns are rounded up to these numbers, so that marks of like width are handled together; rows end with the last.
CLASSES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 4096)
WIDE_CLASSES = tuple(1 << k for k in range(1, 13))  # there are few wide marks
# Kinds of marks from 1 on: columns, whether the chord differs between them, whether pixels may lie beyond the image.
KINDS = (
    *((columns, False, clip) for columns in CLASSES for clip in (True, False)),
    *((columns, True, True) for columns in WIDE_CLASSES),
)
UNSEEN = 0  # kind of a mark that covers no pixel in front of the scene
# Upright marks inside the image of up to so many rows are handled together with those of as many rows.
MOST_ROWS = 8
SORTS = MOST_ROWS + 1  # of each kind: marks of 1, 2, ... rows, and before them those of any number
MARKS_AT_ONCE = 1 << 18
STRIPS = 16  # of an image of more pixels than a cache holds
PIXELS_IN_CACHE = 1 << 19
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

    def as_row(self) -> Marks:
        """The entries ``(1, P)``, as ``add_pairs`` takes them."""
        return _each(self, lambda value: value[None])


D = TypeVar("D", "Marks", "_Frame")


def _each(entries: D, function: Callable[[Tensor], Tensor]) -> D:
    """Apply a function to every field that is there."""
    present = {field.name: getattr(entries, field.name) for field in fields(entries)}
    changed: dict[str, Any] = {name: function(value) for name, value in present.items() if value is not None}
    return replace(entries, **changed)


def chord_share(offset: Tensor) -> Tensor:
    """Share of a disk of unit width that lies left of ``offset`` from its centre, in [0, 1]."""
    return 0.5 + _chord_series((2 * offset).clamp(-1.0, 1.0))


def _chord_series(t: Tensor) -> Tensor:
    """Share of a disk that lies left of ``t`` radii from its centre, in [-1, 1], less a half."""
    square = t * t
    c0, c1, c2, c3 = CHORD_SERIES
    return t * (c0 + square * (c1 + square * (c2 + square * c3)))


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


def _chord_of_columns(frame: _Frame, share: Tensor, covered: Tensor) -> Tensor:
    """Mean chord of the disk in each column, ``(..., P)``; of a narrow mark one for all columns.

    Args:
        frame: the marks.
        share: of the disk in each column.
        covered: breadth of each column that the mark covers.
    """
    # The disk's area in a column over the column's covered breadth.
    mean = (MEAN_CHORD / BOX_OF_DISK) * frame.chord * share * frame.across / covered.clamp_min(1e-3)
    wide = torch.minimum(mean.clamp_min(SMALLEST_PX), frame.chord_most)
    return torch.where(frame.width > WIDE_PX, wide, frame.chord)


def add_pairs(
    total: Tensor, faded: Tensor | None, marks: Marks, depth_m: Tensor, size: tuple[int, int]
) -> tuple[Tensor, Tensor | None]:
    """``add_listed`` by one list of all (mark, pixel) pairs, which a graph holds as few operations.

    Nothing but the length of the list depends on a value: every mark has a pair at least, of no coverage where it is
    beyond the image. The arguments are those of ``add_listed``, but one row each, ``(1, ...)``, of which onnxruntime
    takes numbers fast; the sums are new tensors.
    """
    frame = _frame(marks)
    first, spans, ends = _extent(frame, size)
    number = spans.prod(0).long()
    if marks.opacity.ndim == marks.u_px.ndim:  # else all marks are there
        number = torch.where(frame.area[0] > 0, number, 1)
    # A mark's pairs are counted from its last one down to 0.
    last_pair = torch.cumsum(number, 0) - 1
    pairs: int = number.sum().item()  # type: ignore[assignment]  # int() would fix the number in a graph
    if is_exporting():
        torch._check(pairs >= 0)  # type: ignore[no-untyped-call]
    ended = torch.zeros(pairs, device=number.device, dtype=number.dtype).scatter(0, last_pair, number.sign())
    mark = sums_before(ended)
    own = _of_pairs(frame, first, spans, mark)
    place = (rows_at(last_pair, mark) - torch.arange(pairs, device=mark.device)).to(own["columns"].dtype)
    row = torch.floor((place + 0.5) / own["columns"])
    column = place - row * own["columns"]
    down, inside = own["first_major"] + row, None
    if frame.slope is None or frame.steep is None:
        aside, side = own["first_minor"] + column, own["side"] + column
    else:
        minor = own["minor"] + own["slope"] * (own["offset"] + row)
        aside = torch.floor(minor - own["reach"] + 0.5) + column
        side = aside - minor + torch.tensor([[-0.5], [0.5]], device=mark.device)
        steep = own["steep"] > 0.5
        inside = (aside >= 0) & (aside <= torch.where(steep, ends[1], ends[0]))
        down, aside = torch.where(steep, down, aside), torch.where(steep, aside, down)
    # At two edges of the pixel along and aside, (2, pairs).
    radii = (side / own["reach"]).clamp(-1.0, 1.0)
    share, covered = _between(_chord_series(radii)), own["reach"] * _between(radii)
    # The disk's area in a column over the column's covered breadth; of a narrow mark, whose chord is not less than its
    # largest one, one for all columns.
    mean = own["disk"] * share / covered.clamp_min(1e-3)
    chord = torch.minimum(torch.maximum(mean, own["chord_least"]), own["chord_most"])
    coverage = own["area_per_length"] * share * _along(row, own["offset"], own["length"], chord) / chord
    pixel = down.long() * size[1] + aside.long()
    if inside is not None:
        pixel = torch.where(inside, pixel, 0)
    if frame.sample is not None:
        pixel = pixel + frame.sample.gather(1, mark[None]) * (size[0] * size[1])
    seen = own["depth_m"] < depth_m.gather(1, pixel)
    if inside is not None:
        seen = seen & inside
    optical = -torch.log(1.0 - torch.where(seen, coverage, 0.0).clamp(0.0, FULL))  # ONNX has no log1p
    total = total.scatter_add(1, pixel, optical)
    if faded is not None and "clearness" in own:
        faded = faded.scatter_add(1, pixel, optical * own["clearness"])
    return total, faded


def _extent(frame: _Frame, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """First row and column of each mark inside the image, and how many it has of both, ``(2, P)`` each.

    Of leaning marks along their major axis, and aside of it, where the first one differs from row to row and is 0 here.

    Returns:
        First, number, and the numbers of the image's last row and column, ``(2, 1)``.
    """
    ends = last_row_and_column(size, frame.major)
    middle = {"major": frame.major, "minor": frame.minor, "across": frame.across}
    long = {"length": frame.length, "chord": frame.chord_most}
    first_row = {"major": 1.0, "length": -0.5, "chord": -0.5, "": 0.5}
    last_row = {"major": 1.0, "length": 0.5, "chord": 0.5, "": 0.5}
    if frame.slope is None or frame.steep is None:
        first_column = {"minor": 1.0, "across": -0.5, "": 0.5}
        last_column = {"minor": 1.0, "across": 0.5, "": 0.5}
        edges = sums_of_rows(middle | long, [first_row, first_column, last_row, last_column])
        first, last = (torch.minimum(one, ends) for one in parts_of(torch.floor(edges).clamp_min(0.0), (2, 2)))
        return first, last - first + 1.0, ends
    edges = torch.floor(sums_of_rows({"major": frame.major} | long, [first_row, last_row])).clamp_min(0.0)
    first, last = parts_of(torch.minimum(edges, torch.where(frame.steep, ends[0], ends[1])), (1, 1))
    columns = torch.floor(frame.across) + 2
    return torch.cat([first, torch.zeros_like(first)]), torch.cat([last - first + 1.0, columns]), ends


def _of_pairs(frame: _Frame, first: Tensor, spans: Tensor, mark: Tensor) -> dict[str, Tensor]:
    """Numbers of each pair's mark, ``(1, pairs)``, and ``side``, ``(2, pairs)``; one lookup.

    Args:
        frame: the marks.
        first, spans: first row and column, and number of both, of each mark.
        mark: of each pair.
    """
    wide = frame.width > WIDE_PX
    given = {
        "first": first,
        "spans": spans,
        "major": frame.major,
        "minor": frame.minor,
        "length": frame.length,
        "across": frame.across,
        "chord_least": torch.where(wide, SMALLEST_PX, frame.chord),
        "chord_most": frame.chord_most,
        "disk": frame.width.square() if frame.slope is None else frame.width * frame.across,
        "area_per_length": frame.area / frame.length,
        "depth_m": frame.depth_m,
    }
    side = {"first.1": 1.0, "minor": -1.0}
    wanted: dict[str, list[dict[str, float]]] = {
        "first_major": [{"first.0": 1.0}],
        "columns": [{"spans.1": 1.0}],
        "offset": [{"first.0": 1.0, "major": -1.0}],
        "length": [{"length": 1.0}],
        "reach": [{"across": 0.5}],
        "chord_least": [{"chord_least": 1.0}],
        "chord_most": [{"chord_most": 1.0}],
        "disk": [{"disk": MEAN_CHORD}],
        "area_per_length": [{"area_per_length": 0.5}],
        "depth_m": [{"depth_m": 1.0}],
    }
    if frame.slope is None or frame.steep is None:
        wanted |= {"first_minor": [{"first.1": 1.0}], "side": [side | {"": -0.5}, side | {"": 0.5}]}
    else:
        given |= {"slope": frame.slope, "steep": frame.steep.to(first.dtype)}
        wanted |= {name: [{name: 1.0}] for name in ("minor", "slope", "steep")}
    if frame.clearness is not None:
        given["clearness"] = frame.clearness
        wanted["clearness"] = [{"clearness": 1.0}]
    every = sums_of_rows(given, [one for sums in wanted.values() for one in sums], as_columns=True)
    found = parts_of(rows_as_columns(rows_at(every, mark)), [len(sums) for sums in wanted.values()])
    return dict(zip(wanted, found, strict=True))


def _along(row: Tensor, offset: Tensor, length: Tensor, chord: Tensor) -> Tensor:
    """Share of a path in a row, times twice its lengths: the trapezoid between the edges of the row.

    Args:
        row: number of the row within the mark, ``(1, pairs)``.
        offset: of the mark's first row from the path's centre.
        length, chord: of the path and of the box convolved with it.
    """
    if not is_exporting():
        edges = torch.tensor([[-0.5], [0.5]], device=row.device)
        return _between(_rising(offset + row + edges, length, chord))
    # The distribution function of a trapezoid is a sum of squared ramps that begin at its four corners.
    rows = {"row": row, "offset": offset, "length": length, "chord": chord}
    ramps, signs = [], []
    for edge, one in ((-0.5, -1.0), (0.5, 1.0)):
        for by_length, by_chord in ((0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)):
            ramps.append({"row": 1.0, "offset": 1.0, "length": by_length, "chord": by_chord, "": edge})
            signs.append(one * math.copysign(1.0, by_length * by_chord))
    return weighted_sum(sums_of_rows(rows, ramps).clamp_min(0.0).square(), signs)


def _rising(offset: Tensor, length: Tensor, chord: Tensor) -> Tensor:
    """``trapezoid_share`` times twice its lengths, from the lower end on."""
    whole = length + chord
    place = torch.minimum((offset + 0.5 * whole).clamp_min(0.0), whole)
    over = (place - torch.minimum(length, chord)).clamp_min(0.0), (place - torch.maximum(length, chord)).clamp_min(0.0)
    return place.square() - over[0].square() - over[1].square()


def _between(edges: Tensor) -> Tensor:
    """Share between two edges, of a distribution function at them, ``(2, pairs)``."""
    return weighted_sum(edges, [-1.0, 1.0])


def add_listed(
    total: Tensor,
    faded: Tensor | None,
    marks: Marks,
    depth_m: Tensor,
    size: tuple[int, int],
    blocks: DepthBlocks | None = None,
    *,
    by_columns: bool = False,
) -> tuple[Tensor, Tensor | None]:
    """Add the optical depth of every mark to the pixels that it covers in front of the scene.

    Marks of equally many columns are handled together, each with as many rows as it has.

    Args:
        total: ``(B * H * W,)`` optical depth so far; changed in place.
        faded: the same weighted with each mark's ``clearness``, or ``None``; changed in place.
        marks: the particles.
        depth_m: ``(B * H * W,)`` scene depth; a pixel sees the particles nearer than it.
        size: H, W.
        blocks: extremes of ``depth_m``; spares most marks the test per pixel.
        by_columns: ``total``, ``faded`` and ``depth_m`` hold one column of the image after the other, so that a
            falling mark lies together.

    Returns:
        ``total`` and ``faded``.
    """
    image = _Pixels(*size, by_columns=by_columns)
    for start in range(0, len(marks), MARKS_AT_ONCE):
        chunk = marks.take(slice(start, start + MARKS_AT_ONCE))
        frame = _frame(chunk)
        sort, rows, before = _sorts(chunk, frame, size, blocks)
        counts = torch.bincount(sort, minlength=SORTS * (len(KINDS) + 1)).tolist()
        order = _order(image.with_strip(sort, chunk))[counts[UNSEEN] :]
        rows, before = rows.index_select(0, order), before.index_select(0, order)
        place = (depth_m, image, counts[SORTS:])
        total, faded = _add_sorted(total, faded, frame.take(order), rows, before, *place)
    return total, faded


def _order(kind: Tensor) -> Tensor:
    """Stable order of small whole numbers."""
    if kind.device.type == "cpu":  # numpy's radix sort: a sixth of torch.sort's time
        return torch.from_numpy(np.argsort(kind.numpy(), kind="stable"))
    return torch.sort(kind, stable=True)[1]


@dataclass(frozen=True)
class _Pixels:
    """Rows and columns of an image, and how it lies in memory."""

    height: int
    width: int
    by_columns: bool = False

    def with_strip(self, sort: Tensor, marks: Marks) -> Tensor:
        """Sorts, and within each the strips of a large image, so that marks near each other come together."""
        size, place = (self.width, marks.u_px) if self.by_columns else (self.height, marks.v_px)
        if self.height * self.width <= PIXELS_IN_CACHE:
            return sort
        strip = (place * (STRIPS / size)).clamp(0, STRIPS - 1).to(torch.int16)
        return sort * STRIPS + strip

    @property
    def down(self) -> int:
        """From a pixel to that below it."""
        return 1 if self.by_columns else self.width

    @property
    def across(self) -> int:
        """From a pixel to that on its right."""
        return self.height if self.by_columns else 1


@lru_cache(maxsize=4)
def _class_table(bounds: tuple[int, ...]) -> Tensor:
    """Class of every number of columns, whose bounds ascend."""
    return torch.from_numpy(np.searchsorted(bounds, np.arange(bounds[-1] + 1)))


def _class_of(columns: Tensor, bounds: tuple[int, ...]) -> Tensor:
    """First class that has so many columns, or the last one; of whole numbers ``(P,)``."""
    whole = columns.clamp(1, bounds[-1]).int()
    return _class_table(bounds).to(whole.device).index_select(0, whole)


def _sorts(
    marks: Marks, frame: _Frame, size: tuple[int, int], blocks: DepthBlocks | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Sort of each mark, how many rows it has along its major axis, and whether all of it is before the scene.

    A sort is ``SORTS`` times the kind plus the rows, where marks of as many rows are handled together. Kind ``UNSEEN``
    is a mark that covers no pixel in front of the scene. What is seen of the scene decides on no other kind: the marks
    of a pixel add up in one order whatever is behind them.
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
    # A class may have more columns than the mark: what it adds must lie inside the image as well.
    bounds = torch.tensor(CLASSES, device=rows.device, dtype=rows.dtype)
    columns_class = _class_of(columns, CLASSES)
    spare = bounds.index_select(0, columns_class) - columns
    bottom, right = top + tall, left + broad
    inside = compare(top, ">=", 0) & compare(left, ">=", 0)
    inside &= compare(bottom + spare, "<", height) & compare(right + spare, "<", width)
    unseen = compare(bottom, "<", 0) | compare(right, "<", 0) | compare(top, ">=", height)
    unseen |= compare(left, ">=", width) | compare(frame.area, "<=", 0)
    before = torch.zeros_like(inside)
    if blocks is not None:
        small = compare(tall, "<=", 2 * BLOCK_PX) & compare(broad, "<=", 2 * BLOCK_PX)
        nearest, farthest = blocks.at(marks.sample, marks.u_px, marks.v_px)
        before = small & compare(marks.depth_m, "<", nearest)
        unseen |= small & compare(marks.depth_m, ">=", farthest)
    kind, alike = columns_class * 2 + inside, inside
    wide = compare(frame.width, ">", WIDE_PX)
    if bool(wide.any()):
        wide_kind = 2 * len(CLASSES) + _class_of(columns, WIDE_CLASSES)
        kind = kind + wide * (wide_kind - kind)
        alike = inside & ~wide
    sort = (kind + 1) * SORTS
    rows = rows.clamp(1, CLASSES[-1]).int()
    if frame.slope is None:
        sort += rows * (alike & compare(rows, "<=", MOST_ROWS))
    # Small integers sort fastest.
    return sort.masked_fill_(unseen, UNSEEN).to(torch.int16), rows.long(), before


def _add_sorted(
    total: Tensor,
    faded: Tensor | None,
    frame: _Frame,
    rows: Tensor,
    before: Tensor,
    depth_m: Tensor,
    image: _Pixels,
    counts: list[int],
) -> tuple[Tensor, Tensor | None]:
    """Add marks that are sorted.

    Args:
        total, faded, depth_m: as in ``add_listed``.
        image: its size.
        frame: the marks, ``(P,)``.
        rows: of each mark, ``(P,)``.
        before: whether all of a mark is before the scene, ``(P,)``.
        counts: marks of each sort of the kinds above ``UNSEEN``.
    """
    last = list(accumulate(counts))
    present = [(number, stop - counts[number], stop) for number, stop in enumerate(last) if counts[number]]
    if not present:
        return total, faded
    ends = torch.cumsum(rows, 0)
    row_ends = ends[torch.tensor([stop - 1 for _, _, stop in present], device=ends.device)].tolist()
    for place, (number, first, stop) in enumerate(present):
        kind, alike = divmod(number, SORTS)
        columns, wide, clip = KINDS[kind]
        if alike:
            same = _MarksAlike(frame.part(first, stop), alike, columns)
            total, faded = same.deposit(total, faded, before[first:stop], depth_m, image)
            continue
        start = row_ends[place - 1] if place else 0
        for some, number_of_rows in _portions(ends, first, stop, start, row_ends[place], PAIRS_AT_ONCE // columns):
            part = _RowsOfMarks.of(frame.part(some.start, some.stop), rows[some], number_of_rows)
            scene = None if bool(before[some].all()) else depth_m
            total, faded = part.deposit(total, faded, columns, scene, image, wide=wide, clip=clip)
    return total, faded


def _portions(ends: Tensor, first: int, stop: int, before: int, after: int, most_rows: int) -> list[tuple[slice, int]]:
    """Marks ``first..stop`` in portions of some ``most_rows`` rows, with the rows of each; at least one mark each."""
    if after - before <= most_rows:
        return [(slice(first, stop), after - before)]
    own = ends[first:stop]
    aims = torch.arange(before + most_rows, after, max(1, most_rows), device=ends.device)
    cuts = sorted({min(cut + 1, stop - first) for cut in torch.searchsorted(own, aims).tolist()} | {stop - first})
    sums = own[torch.tensor(cuts, device=ends.device) - 1].tolist()
    starts, sums_before = [0, *cuts[:-1]], [before, *sums[:-1]]
    return [
        (slice(first + low, first + high), up - down)
        for low, high, down, up in zip(starts, cuts, sums_before, sums, strict=True)
    ]


@dataclass(frozen=True)
class _MarksAlike:
    """Narrow upright marks inside the image that have as many rows and columns: no pixel needs to look up its mark.

    Args:
        frame: the marks, ``(P,)``.
        rows, columns: of every mark.
    """

    frame: _Frame
    rows: int
    columns: int

    def deposit(
        self, total: Tensor, faded: Tensor | None, before: Tensor, depth_m: Tensor, image: _Pixels
    ) -> tuple[Tensor, Tensor | None]:
        """Add the optical depth of the marks to their pixels, in place.

        First every mark's first pixel, then every mark's second one: a pixel adds up in one order whatever marks are
        beside its own.

        Args:
            total, faded, depth_m: as in ``add_listed``.
            before: whether all of a mark is before the scene, ``(P,)``.
            image: its size.
        """
        coverage, pixel = self._coverage(), self._pixels(image)
        beside = places_of(~before)  # marks with pixels to look at
        if len(beside):
            there = depth_m.index_select(0, pixel.index_select(1, beside).view(-1))
            near = compare(self.frame.depth_m.index_select(0, beside), "<", there.view(-1, len(beside)))
            coverage = coverage.index_copy(1, beside, coverage.index_select(1, beside) * near)
        optical = coverage.clamp(0.0, FULL).neg_().log1p_().neg_()
        total = total.scatter_add_(0, pixel.view(-1), optical.view(-1))
        if faded is not None and self.frame.clearness is not None:
            faded = faded.scatter_add_(0, pixel.view(-1), (optical * self.frame.clearness).view(-1))
        return total, faded

    def _coverage(self) -> Tensor:
        """Coverage of each pixel of every mark, ``(rows * columns, P)``."""
        frame = self.frame
        coverage = frame.area[None]
        if self.rows > 1:
            reach, middle = 0.5 * (frame.length + frame.chord), 0.5 * (frame.length - frame.chord).abs()
            edge = (frame.first_major + 0.5) - frame.major
            y = torch.clamp(edge + _steps(self.rows - 1, edge)[:, None], -reach, reach)
            # trapezoid_share, with each mark's area in its factor
            rising = (y + reach).square_()
            rising -= (y + middle).clamp_min_(0).square_()
            rising -= (y - middle).clamp_min_(0).square_()
            share = rising * (frame.area / (2 * frame.length * frame.chord))
            coverage = torch.cat([share, coverage])
            coverage[1:] -= share
        if self.columns > 1:
            side = frame.first_minor + (_steps(self.columns - 1, frame.minor)[:, None] + 0.5) - frame.minor
            weight = _shares(chord_share(side / frame.across), 0)
            coverage = (coverage[:, None] * weight).flatten(0, 1)
        return coverage

    def _pixels(self, image: _Pixels) -> Tensor:
        """Index of the pixels ``(rows * columns, P)`` in the flattened batch."""
        frame = self.frame
        first = frame.first_major.int().long() * image.down + frame.first_minor.int().long() * image.across
        if frame.sample is not None:
            first = first + frame.sample * (image.height * image.width)
        steps = [row * image.down + column * image.across for row in range(self.rows) for column in range(self.columns)]
        return first + torch.tensor(steps, device=first.device)[:, None]


@dataclass(frozen=True)
class _RowsOfMarks:
    """Marks, and every row of every one of them, one mark after the other.

    Args:
        frame: the marks, ``(P,)``.
        mark: mark of each row, ``(R,)``.
        row: number of each row within its mark, ``(R,)``.
        first, last: place of each mark's first and last row, ``(P,)``.
    """

    frame: _Frame
    mark: Tensor
    row: Tensor
    first: Tensor
    last: Tensor

    @classmethod
    def of(cls, frame: _Frame, rows: Tensor, number_of_rows: int) -> _RowsOfMarks:
        """The rows of marks that have ``rows`` each, ``number_of_rows`` in all."""
        if rows.device.type == "cpu":  # a third of the time of torch.repeat_interleave
            mark = torch.from_numpy(np.repeat(np.arange(len(rows)), rows.numpy()))
        else:
            mark = torch.repeat_interleave(rows, output_size=number_of_rows)
        end = torch.cumsum(rows, 0)
        first = end - rows
        # Whole numbers of a portion are exact in float32.
        place = torch.arange(number_of_rows, device=rows.device, dtype=frame.major.dtype)
        return cls(frame, mark, place - first.to(place.dtype).index_select(0, mark), first, end - 1)

    def deposit(
        self,
        total: Tensor,
        faded: Tensor | None,
        columns: int,
        depth_m: Tensor | None,
        image: _Pixels,
        *,
        wide: bool,
        clip: bool,
    ) -> tuple[Tensor, Tensor | None]:
        """Add the optical depth of the marks on ``columns`` columns to their pixels, in place; mark by mark, so that
        a pixel adds up in one order whatever marks are beside its own.

        Args:
            total, faded: as in ``add_listed``.
            image: its size.
            columns: of every mark, at least what it covers.
            depth_m: of the scene; ``None`` where all marks are before it.
            wide: whether the chord differs from column to column.
            clip: whether marks may reach beyond the image.
        """
        if self.frame.slope is None and not wide:
            coverage, pixel = self._upright(columns, image, clip=clip)
        else:
            coverage, pixel = self._leaning_or_wide(columns, image, clip=clip)
        if depth_m is not None:
            there = depth_m.index_select(0, pixel.reshape(-1)).view(pixel.shape)
            coverage = coverage * (self._each(self.frame.depth_m) < there)
        optical = coverage.clamp(0.0, FULL).neg_().log1p_().neg_()
        where = pixel.T.reshape(-1)
        total = total.scatter_add_(0, where, optical.T.reshape(-1))
        if faded is not None and self.frame.clearness is not None:
            weighted = optical * self._each(self.frame.clearness)
            faded = faded.scatter_add_(0, where, weighted.T.reshape(-1))
        return total, faded

    def _each(self, values: Tensor) -> Tensor:
        """A value of each mark at each of its rows, ``(..., P)`` to ``(..., R)``."""
        return values.index_select(-1, self.mark)

    def _along(self, share: Tensor, whole: Tensor) -> Tensor:
        """Share that lies in each row, from distribution functions ``(..., R)`` at the rows' lower edges.

        Args:
            share: the distribution functions, whose last row of each mark is set to ``whole``, ``(..., P)``.
        """
        share = share.index_copy(-1, self.last, whole)
        along = share.clone()
        along[..., 1:] -= share[..., :-1]
        return along.index_copy_(-1, self.first, share.index_select(-1, self.first))

    def _upright(self, columns: int, image: _Pixels, *, clip: bool) -> tuple[Tensor, Tensor]:
        """Coverage and pixels ``(columns, R)`` of narrow marks along the columns of the image."""
        frame = self.frame
        outer = 0.5 * (frame.length + frame.chord)
        inner = 0.5 * (frame.length - frame.chord).abs()
        edge = self._each((frame.first_major + 0.5) - frame.major) + self.row
        reach = self._each(outer)
        y = torch.clamp(edge, -reach, reach)
        middle = self._each(inner)
        # trapezoid_share, with each mark's area in its factor
        rising = (y + reach).square_()
        rising -= (y + middle).clamp_min_(0).square_()
        rising -= (y - middle).clamp_min_(0).square_()
        share = rising * self._each(frame.area / (2 * frame.length * frame.chord))
        coverage = self._along(share, frame.area)
        if clip:
            down = self._each(frame.first_major) + self.row
            coverage = coverage * ((down >= 0) & (down < image.height))
        aside = _steps(columns, frame.major)[:, None]
        first_minor = frame.first_minor
        weight = None
        if columns > 1:
            side = first_minor + (aside[:-1] + 0.5) - frame.minor
            weight = _shares(chord_share(side / frame.across), 0)
        if clip:
            across = first_minor + aside
            inside = ((across >= 0) & (across < image.width)).to(coverage.dtype)
            weight = inside if weight is None else weight * inside
        coverage = coverage[None] if weight is None else coverage * self._each(weight)
        first = frame.first_major.long() * image.down + first_minor.long() * image.across
        return coverage, self._pixels(first - self.first * image.down, columns, image, clip=clip)

    def _pixels(self, first: Tensor, columns: int, image: _Pixels, *, clip: bool) -> Tensor:
        """Index of the pixels ``(columns, R)`` of upright marks in the flattened batch; where nothing is covered, of
        any pixel of the mark's own sample."""
        down = torch.arange(0, len(self.mark) * image.down, image.down, device=first.device)
        pixel = self._each(first).add_(down)
        if columns > 1:
            pixel = pixel + torch.arange(0, columns * image.across, image.across, device=first.device)[:, None]
        else:
            pixel = pixel[None]
        if clip:
            pixel = pixel.clamp_(0, image.height * image.width - 1)
        if self.frame.sample is not None:
            pixel = pixel + self._each(self.frame.sample) * (image.height * image.width)
        return pixel

    def _leaning_or_wide(self, columns: int, image: _Pixels, *, clip: bool) -> tuple[Tensor, Tensor]:
        """Coverage and pixels ``(columns, R)`` of any marks: each row has its own columns and chords."""
        frame = self.frame.take(self.mark)  # (R,)
        height, width = image.height, image.width
        offset = (frame.first_major - frame.major) + self.row
        if frame.slope is None:
            minor, first_minor = frame.minor, frame.first_minor
        else:
            minor = frame.minor + frame.slope * offset
            first_minor = torch.floor(minor - 0.5 * frame.across + 0.5)
        aside = _steps(columns, frame.major)[:, None]
        chord, share = frame.chord, None
        if columns > 1:
            side = first_minor + (aside[:-1] + 0.5) - minor
            share = _shares(chord_share(side / frame.across), 0)  # (columns, R)
            if bool((self.frame.width > WIDE_PX).any()):
                reach = 0.5 * frame.across
                edges = torch.maximum(torch.minimum(side, reach), -reach)
                ends = torch.cat([-reach[None], edges, reach[None]])
                chord = _chord_of_columns(frame, share, ends[1:] - ends[:-1])
        below = trapezoid_share(offset + 0.5, frame.length, chord)
        last = torch.ones_like(self.frame.major)
        if chord.ndim == 1:
            along = self._along(below, last)
        else:
            # Each row's edges are integrated with its own chords.
            above = trapezoid_share(offset - 0.5, frame.length, chord).index_fill(-1, self.first, 0.0)
            along = below.index_fill(-1, self.last, 1.0) - above
        coverage = frame.area * along if share is None else frame.area * share * along
        coverage = coverage.expand(columns, -1)
        down, across = frame.first_major + self.row, first_minor + aside
        if frame.steep is not None:
            steep = frame.steep
            down, across = torch.where(steep, down, across), torch.where(steep, across, down)
        if clip:
            coverage = coverage * ((down >= 0) & (down < height) & (across >= 0) & (across < width))
        pixel = down.long() * image.down + across.long() * image.across
        if clip:
            pixel = pixel.clamp(0, height * width - 1)
        if frame.sample is not None:
            pixel = pixel + frame.sample * (height * width)
        return coverage, pixel
