"""Directions of a scanning LiDAR's beams, the ring of each point, and the beams of a cloud that returned nothing.

Frame: x forward, y left, z up; azimuth from x to y, elevation up. The sensor turns clockwise seen from above, as those
of Ouster, Velodyne and Hesai do: the azimuth falls as the column rises,

``azimuth(ring, column) = azimuth_offsets_deg[ring] - 360 column / columns``, column 0 along +x.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherWarning, check_at_least, check_between
from torchweather.lidar.laser_blocks import height_blocks
from torchweather.lidar.sensor import Lidar

__all__ = ["empty_beams", "estimate_elevations", "recover_ring", "scan_directions"]

TURN_DEG = 360.0
# A column of the scan may be off by less than half a step: a gap of 1.5 steps and more hides a beam.
WRONG_STEP = 1.5
HIDES_NONE = 1.4  # steps, less than 1.5 for rounding
# Least number of gaps in a cloud for a comparison of its azimuth step with the sensor's.
GAPS_TO_JUDGE = 100
GAPS_TO_SORT = 10_000  # enough for its median and lowest tenth
# Two returns of one beam share its azimuth; a gap below this share of a step lies inside one beam.
SAME_BEAM = 0.25
# A gap between sectors of the view is wider than this many columns, however few a sensor has.
FEWEST_STEPS = 3.0
# `estimate_elevations`: resolution of the histogram, and share of the mean ring's points that makes a ring.
BIN_DEG = 0.005
SMALLEST_RING = 0.05
BANDWIDTHS = 48
# The number of heaps must hold while the width grows by this factor: noise shows any number for a moment.
STEADY = 1.6
ROUNDING = 1e-9  # of the Fourier transform, and a good deal more


def scan_directions(lidar: Lidar, *, dtype: torch.dtype = torch.float32, device: torch.device | None = None) -> Tensor:
    """Unit vectors of the beams of one turn, ring after ring, or of the pixels of a flash, row after row.

    ``(cos e cos a, cos e sin a, sin e)`` with ``a = azimuth_offset - 360 column / columns`` (clockwise from above).

    Args:
        lidar: with ``elevations_deg`` and ``columns`` or ``azimuths_deg``; ``azimuth_offsets_deg`` shift whole rings.
        dtype: of the result.
        device: of the result.

    Returns:
        ``(rings * columns, 3)``, row-major: row ``ring * columns + column``.

    Note:
        All beams start at the origin. Real ones start up to 0.2 m beside it (Velodyne HDL-64E), 0.03 m (Ouster).

    Example:
        >>> lidar = Lidar(905.0, elevations_deg=(0.0, 30.0), columns=4)
        >>> scan_directions(lidar)[[0, 1, 5]].round(decimals=3) + 0.0
        tensor([[ 1.0000,  0.0000,  0.0000],
                [ 0.0000, -1.0000,  0.0000],
                [ 0.0000, -0.8660,  0.5000]])
    """
    check_arguments("scan_directions(lidar: Lidar, dtype: dtype)", lidar, dtype)
    if lidar.azimuths_deg is not None:
        rows = _elevations(lidar, "scan_directions", device)[:, None]
        across = torch.tensor(lidar.azimuths_deg, dtype=torch.float64, device=device).expand(len(rows), -1)
        return _unit(rows.expand_as(across), across).reshape(-1, 3).to(dtype)
    elevations, offsets, columns = _pattern(lidar, "scan_directions", device)
    azimuth = offsets[:, None] - torch.arange(columns, dtype=torch.float64, device=device) * (TURN_DEG / columns)
    return _unit(elevations[:, None].expand_as(azimuth), azimuth).reshape(-1, 3).to(dtype)


def recover_ring(points: Tensor, lidar: Lidar, *, origin_heights_m: Sequence[float] | None = None) -> Tensor:
    """Ring of every point of a cloud without a ring column: the one that is nearest in elevation.

    ``argmin_k |atan2(z - h_k, sqrt(x^2 + y^2)) - elevation_k|``; h is the height at which the beams of a ring start.

    Args:
        points: ``(..., N, 3 or more)`` x, y, z in metres, in the sensor's own frame and not compensated for motion.
        lidar: with ``elevations_deg``, in the order of the sensor's ring numbers.
        origin_heights_m: one height per ring; ``None`` takes the sensor's. The HDL-64E needs it: 0.204 m for its upper
            and 0.124 m for its lower block in KITTI (fitted to one frame), which is 1 degree, three rings, at 10 m.
            Ouster's own coordinates have 0.036 m (OS2: 0.078 m).

    Returns:
        int64 ``(..., N)``; -1 where there is no return (range 0, or a coordinate that is not finite).

    Note:
        A point is never refused for lying between two rings. Right where half the distance of two rings (0.08 degree
        for a Pandar64, 0.67 for an HDL-32E) exceeds what the sensor's offsets and the motion of the vehicle do to
        the elevation; near points suffer most. Share that comes out right on recordings with a ring column, with the
        presets: HDL-32E 100 % (RADIATE), 88 % beyond 1 m and 100 % beyond 10 m where the motion is compensated
        (nuScenes); HDL-64E with heights 86 % and 99.9 % beyond 10 m (Seeing Through Fog), 74 % and 95 % (KITTI, where
        the order of the file gives the rings), without heights 2 to 4 %; Ouster with heights 88 % (OS0, whose near
        points the beams' sideways offset moves), 99.99 % (OS1), 100 % (OS2), without 65, 47 and 5 %. Use the ring
        column where there is one.

    Example:
        >>> lidar = Lidar(905.0, elevations_deg=(-10.0, 0.0, 10.0))
        >>> recover_ring(torch.tensor([[10.0, 0.0, 1.7], [0.0, 9.0, -0.1], [0.0, 0.0, 0.0]]), lidar)
        tensor([ 2,  1, -1])
    """
    check_arguments(
        "recover_ring(points: real, lidar: Lidar, origin_heights_m: Sequence[float] | None)",
        points,
        lidar,
        origin_heights_m,
    )
    _check_points(points, "recover_ring")
    elevations = _elevations(lidar, "recover_ring", points.device)
    absent = origin_heights_m is None or not len(origin_heights_m)
    heights = _heights(lidar.origin_heights_m if absent else origin_heights_m, elevations, "recover_ring")
    flat = points[..., :2].norm(dim=-1)
    best = torch.full_like(flat, math.inf)
    ring = torch.full(flat.shape, -1, dtype=torch.int64, device=points.device)
    for rings in height_blocks(heights.tolist()):  # one or two blocks of lasers
        members = torch.tensor(rings, device=points.device)
        rising, order = elevations[members].sort()
        members, own = members[order], heights[members[order]].to(flat.dtype)
        middles = (0.5 * (rising[1:] + rising[:-1])).to(flat.dtype)
        rough = torch.rad2deg(torch.atan2(points[..., 2] - float(own.mean()), flat))
        place = torch.bucketize(rough.contiguous(), middles)
        # Heights of a block differ by centimetres: the neighbours are tried as well, with their own. In one block of
        # one height there is nothing to try.
        steps = (0,) if float(own.max() - own.min()) == 0 else (-1, 0, 1)
        for step in steps:
            one = (place + step).clamp(0, len(rising) - 1)
            elevation = rough if len(steps) == 1 else torch.rad2deg(torch.atan2(points[..., 2] - own[one], flat))
            distance = (elevation - rising.to(flat.dtype)[one]).abs()
            ring = torch.where(distance < best, members[one], ring)
            best = torch.minimum(distance, best)
    return torch.where(_has_return(points), ring, torch.full_like(ring, -1))


def estimate_elevations(points: Tensor, rings: int) -> tuple[Tensor, Tensor]:
    """Elevation of each ring of an unknown sensor, from the heaps that its points form in elevation.

    The histogram of the elevations is smoothed by Gaussians of rising width; the number of its maxima falls on the way
    (Silverman 1981). Of the widths that show exactly ``rings`` heaps, over a factor of 1.6 or more, the middle one is
    taken, every point is counted to its nearest heap, and each heap gives its median and spread.

    Args:
        points: ``(..., N, 3 or more)`` x, y, z in metres; all clouds of a batch count together.
        rings: number of rings.

    Returns:
        ``(elevations_deg, spread_deg)``, each ``(rings,)`` in float64, the lowest ring first. Spread is the standard
        deviation as the median absolute deviation gives it (times 1.4826).

    Raises:
        ValueError: the cloud does not show that many rings.

    Note:
        Heaps of less than 5 % of the mean ring's points are taken for stray points. Rings nearer than about twice
        their spread cannot be told apart; an HDL-64E, whose beams do not start at the origin, fails here.

    References:
        Silverman 1981, Using kernel density estimates to investigate multimodality, J. R. Stat. Soc. B 43.

    Example:
        >>> lidar = Lidar(905.0, elevations_deg=(3.0, -1.0), columns=90)
        >>> elevations_deg, spread_deg = estimate_elevations(20.0 * scan_directions(lidar), rings=2)
        >>> elevations_deg.round(decimals=3), bool(spread_deg.max() < 1e-3)
        (tensor([-1.,  3.], dtype=torch.float64), True)
    """
    check_arguments("estimate_elevations(points: real, rings: int)", points, rings)
    _check_points(points, "estimate_elevations")
    check_at_least("rings", rings, 1, owner="estimate_elevations")
    xyz = points[..., :3].reshape(-1, 3).double()
    xyz = xyz[_has_return(xyz)]
    elevation = torch.rad2deg(torch.atan2(xyz[:, 2], xyz[:, :2].norm(dim=-1)))
    if len(elevation) < rings:
        raise InputValueError(f"estimate_elevations: {rings} rings need as many returns or more; got {len(elevation)}.")
    low = float(elevation.min())
    bins = math.ceil((float(elevation.max()) - low) / BIN_DEG) + 1
    cell = ((elevation - low) / BIN_DEG).long()
    counts = torch.zeros(bins, dtype=torch.float64, device=points.device).index_add_(
        0, cell, torch.ones_like(elevation)
    )
    widest = max(2.0, bins / rings)  # bins; a mean distance of two rings
    factor = (2.0 * widest) ** (1.0 / (BANDWIDTHS - 1))
    # Room for four widths on either side, so that the ends do not reach around.
    spectrum = torch.fft.rfft(counts, n=2 * ((bins + math.ceil(8.0 * widest)) // 2 + 1))
    found = [_heaps(spectrum, counts, 0.5 * factor**step, len(elevation) / rings) for step in range(BANDWIDTHS)]
    tried = [len(heaps) for heaps in found]
    run = _longest_run(tried, rings)
    if len(run) == 0 or factor ** (len(run) - 1) < STEADY:
        raise InputValueError(
            f"estimate_elevations: the cloud does not show {rings} rings; it shows {min(tried)} to {max(tried)} heaps "
            "of elevations, by how finely one looks. Check the number and that the cloud is in the sensor's own frame, "
            "use more points, or give Lidar(elevations_deg=...) from the data sheet."
        )
    place = run[len(run) // 2]
    middles = low + (found[place].double() + 0.5) * BIN_DEG
    member = torch.bucketize(elevation, 0.5 * (middles[1:] + middles[:-1]))
    elevations = _medians(elevation, member, rings)
    return elevations, 1.4826 * _medians((elevation - elevations[member]).abs(), member, rings)


def empty_beams(
    points: Tensor,
    lidar: Lidar,
    ring: Tensor | None = None,
    *,
    origin_heights_m: Sequence[float] | None = None,
    max_gap_deg: float = 10.0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Beams of one unorganised cloud that returned nothing, inferred from the gaps between its points.

    On each ring neighbouring points that lie g apart in azimuth have ``round(g / step) - 1`` beams between them,
    spread evenly, with ``step = 360 / columns``. So the pattern follows the cloud's own phase even where the sensor's
    speed drifts, and no cell that has a point is filled again.

    Only what the cloud covers is filled. In azimuth: a sector wider than ``max_gap_deg`` without a point of any ring
    lies outside the field of view. In elevation: the rings from the lowest to the highest that has a point; in a cloud
    that does not cover the full turn (a crop to the view of a camera) also nothing below the lowest ring seen within
    ``max_gap_deg`` of azimuth. Rings without points there take the phase of the whole cloud.

    Args:
        points: one cloud ``(N, 3 or more)``: x, y, z in metres; range 0 or below ``min_range_m`` is no return.
        lidar: with ``elevations_deg``, ``columns`` (of this cloud: twice the turns per second halve it) and
            ``azimuth_offsets_deg``.
        ring: int ``(N,)`` ring of each point, below 0 for none; ``None`` takes ``recover_ring``.
        origin_heights_m: see ``recover_ring``.
        max_gap_deg: widest gap in azimuth, over all rings, that is still inside the field of view, degrees.

    Returns:
        ``(directions, ring, column)``: unit vectors ``(M, 3)`` in the dtype of the points, and int64 ``(M,)`` each.
        Columns are counted as in ``scan_directions`` from the ring's phase (circular mean of the residuals); where
        the sensor's speed drifts two beams of a ring may get the same one.

    Note:
        A cloud without returns covers nothing and has no empty beams by this measure. Rows with range 0 are not
        matched with the beams found: replace them. Points on a wrong ring leave false gaps behind.

    Example:
        >>> lidar = Lidar(905.0, elevations_deg=(0.0, 5.0), columns=90)
        >>> cloud = 10.0 * scan_directions(lidar)
        >>> directions, ring, column = empty_beams(torch.cat([cloud[:20], cloud[23:]]), lidar)
        >>> ring.tolist(), column.sort().values.tolist()
        ([0, 0, 0], [20, 21, 22])
    """
    check_arguments(
        "empty_beams(points: real, lidar: Lidar, ring: real | None, origin_heights_m: Sequence[float] | None, "
        "max_gap_deg: float)",
        points,
        lidar,
        ring,
        origin_heights_m,
        max_gap_deg,
    )
    _check_points(points, "empty_beams")
    if points.ndim != 2:
        raise InputValueError(f"empty_beams: one cloud (N, 3 or more) at a time; got shape {tuple(points.shape)}.")
    check_between("max_gap_deg", max_gap_deg, 1e-6, TURN_DEG, unit="degrees", owner="empty_beams")
    elevations, offsets, columns = _pattern(lidar, "empty_beams", points.device)
    if ring is None:
        ring = recover_ring(points, lidar, origin_heights_m=origin_heights_m)
    _check_ring(ring, points, len(elevations))
    seen = _has_return(points, lidar.min_range_m) & (ring >= 0)
    ring = ring[seen].long()
    azimuth = torch.rad2deg(torch.atan2(points[seen, 1].double(), points[seen, 0].double())) % TURN_DEG
    if not len(azimuth):
        return points.new_zeros((0, 3)), ring, ring.clone()
    step = TURN_DEG / columns
    _, rank = elevations.sort()[1].sort()  # place of each ring from the lowest to the highest
    view = _view(azimuth, max(max_gap_deg, FEWEST_STEPS * step))
    phase = _phases(azimuth, ring, offsets, step)
    ends = _ends(_turned(azimuth, view.start), ring, rank, view, step)
    found_ring, turned = _fill(ends, _turned(phase, view.start), step, columns)
    if not view.full:
        keep = _above_the_lowest(turned, rank[found_ring], _turned(azimuth, view.start), rank[ring], max_gap_deg)
        found_ring, turned = found_ring[keep], turned[keep]
    found = turned + view.start
    column = torch.round((phase[found_ring] - found) / step).long() % columns
    return _unit(elevations[found_ring], found).to(points.dtype), found_ring, column


class _View(NamedTuple):
    """Azimuths that a cloud covers: sectors ``[low, high]`` in degrees from ``start`` on."""

    start: Tensor
    low: Tensor
    high: Tensor
    full: bool


class _Ends(NamedTuple):
    """Points and borders of the view, sorted by ring and azimuth: what the gaps lie between."""

    ring: Tensor
    azimuth_deg: Tensor
    border: Tensor


def _view(azimuth: Tensor, max_gap_deg: float) -> _View:
    bins = math.ceil(2.0 * TURN_DEG / max_gap_deg)
    if bool((torch.bincount((azimuth * (bins / TURN_DEG)).long().clamp(0, bins - 1), minlength=bins) > 0).all()):
        zero = azimuth.new_zeros(1)  # no gap is wider than two bins
        return _View(azimuth.min(), zero, zero + TURN_DEG, full=True)
    rising = azimuth.sort().values
    gap = torch.cat([rising[1:] - rising[:-1], rising[:1] + TURN_DEG - rising[-1:]])
    wide = (gap > max_gap_deg).nonzero()[:, 0]
    if not len(wide):
        zero = rising.new_zeros(1)
        return _View(rising[0], zero, zero + TURN_DEG, full=True)
    last, first = wide, (wide + 1) % len(rising)
    start = rising[first[-1]]
    return _View(start, (rising[first.roll(1)] - start) % TURN_DEG, (rising[last] - start) % TURN_DEG, full=False)


def _phases(azimuth: Tensor, ring: Tensor, offsets: Tensor, step: float) -> Tensor:
    """Azimuth of a cell of each ring, degrees: circular mean of its points; of all points for a ring without."""
    angle = (azimuth - offsets[ring]) * (2.0 * math.pi / step)
    parts = torch.stack([angle.cos(), angle.sin()])
    sums = parts.new_zeros((2, len(offsets))).index_add_(1, ring, parts)
    count = torch.bincount(ring, minlength=len(offsets))
    sums = torch.where(count > 0, sums, parts.sum(1, keepdim=True))
    return offsets + torch.atan2(sums[1], sums[0]) * (step / (2.0 * math.pi))


def _ends(azimuth: Tensor, ring: Tensor, rank: Tensor, view: _View, step: float) -> _Ends:
    present = torch.bincount(ring, minlength=len(rank)) > 0
    covered = (rank >= rank[present].min()) & (rank <= rank[present].max())
    bordered = covered & ~present if view.full else covered
    rings = bordered.nonzero()[:, 0]
    # A full turn has as many cells as columns: its last one lies a step before its first.
    high = view.high - step if view.full else view.high
    low_ring = rings.repeat_interleave(len(view.low))
    border_ring = torch.cat([low_ring, low_ring])
    border_azimuth = torch.cat([view.low.repeat(len(rings)), high.repeat(len(rings))])
    # At one azimuth the lower border comes before the points and the upper one after them.
    place = torch.cat([torch.ones_like(ring), torch.zeros_like(low_ring), torch.full_like(low_ring, 2)])
    if view.full:  # the first point of a ring is also the one after its last
        first = azimuth.new_full((len(rank),), TURN_DEG).scatter_reduce(0, ring, azimuth, "amin")
        again = present.nonzero()[:, 0]
        ring, azimuth = torch.cat([ring, again]), torch.cat([azimuth, first[again] + TURN_DEG])
        place = torch.cat([torch.ones_like(again), place])
    ring, azimuth = torch.cat([ring, border_ring]), torch.cat([azimuth, border_azimuth])
    # By ring, then azimuth (up to twice a turn), then place: the last only where two azimuths are the same number.
    order = _order(ring * (4.0 * TURN_DEG) + azimuth + place * ROUNDING)
    return _Ends(ring[order], azimuth[order], place[order] != 1)


def _fill(ends: _Ends, phase: Tensor, step: float, columns: int) -> tuple[Tensor, Tensor]:
    """Ring and azimuth of the beams in the gaps between neighbours of a ring."""
    ring, left, right = ends.ring[:-1], ends.azimuth_deg[:-1], ends.azimuth_deg[1:]
    from_border, to_border = ends.border[:-1], ends.border[1:]
    gap = right - left
    same, border = ring == ends.ring[1:], from_border | to_border
    _judge_step(gap[same & ~border & (gap > SAME_BEAM * step)], step, columns)
    # Most neighbours are one step apart and have no beam between them.
    wide = (same & (border | (gap > HIDES_NONE * step))).nonzero()[:, 0]
    # From an upper border to the next sector's lower one lies what the cloud does not cover.
    outside = _outside(ends)[wide]
    ring, left, right, gap = ring[wide], left[wide], right[wide], gap[wide]
    from_border, to_border = from_border[wide], to_border[wide]
    inside, between = ~(from_border & to_border & outside), ~from_border & ~to_border

    pieces = torch.round(gap / step).clamp(min=1.0)
    one_border = torch.floor(gap / step + 0.5)  # the last cell may reach half a step across the border
    first = left - 0.5 * step + (phase[ring] - left + 0.5 * step) % step
    two_borders = torch.floor((right + 0.5 * step - first) / step - 1e-9) + 1.0
    count = torch.where(from_border, torch.where(to_border, two_borders, one_border), pieces - 1.0)
    count = torch.where(to_border & ~from_border, one_border, count)
    count = torch.where(inside, count.clamp(min=0.0), torch.zeros_like(count)).long()

    begin = torch.where(from_border, torch.where(to_border, first - step, right), left)
    stride = torch.where(between, gap / pieces, torch.full_like(gap, step))
    stride = torch.where(from_border & ~to_border, -stride, stride)
    owner = torch.arange(len(count), device=count.device).repeat_interleave(count)
    number = torch.arange(len(owner), device=count.device) - (count.cumsum(0) - count)[owner] + 1
    return ring[owner], begin[owner] + number * stride[owner]


def _order(key: Tensor) -> Tensor:
    """Places of the keys in rising order; numpy's sort is ten times as fast on rings that follow each other."""
    if key.device.type != "cpu":
        return key.argsort(stable=True)
    return torch.from_numpy(key.numpy().argsort(kind="stable"))


def _outside(ends: _Ends) -> Tensor:
    """Check whether two borders are an upper one and the next sector's lower one: borders come in pairs per ring."""
    number = ends.border.long().cumsum(0)
    return number[:-1] % 2 == 0


def _above_the_lowest(turned: Tensor, rank: Tensor, azimuth: Tensor, seen_rank: Tensor, max_gap_deg: float) -> Tensor:
    """Check whether a beam lies on or above the lowest ring near its azimuth (in its half sector and the next ones)."""
    sectors = max(1, math.ceil(2.0 * TURN_DEG / max_gap_deg))
    place = (azimuth * (sectors / TURN_DEG)).long().clamp(0, sectors - 1)
    none = int(seen_rank.max()) + 1
    lowest = torch.full((sectors,), none, dtype=torch.int64, device=rank.device)
    lowest = lowest.scatter_reduce(0, place, seen_rank, "amin")
    lowest = torch.minimum(lowest, torch.minimum(lowest.roll(1), lowest.roll(-1)))
    return rank >= lowest[(turned % TURN_DEG * (sectors / TURN_DEG)).long().clamp(0, sectors - 1)]


def _judge_step(apart: Tensor, step: float, columns: int) -> None:
    """Warn where the neighbours on the rings stand at another step than the sensor's: beams would double or vanish."""
    if len(apart) < GAPS_TO_JUDGE:
        return
    apart = apart[:: max(1, len(apart) // GAPS_TO_SORT)].sort().values
    # Beams without return widen gaps: of a finer pattern some gaps of one step are left. Points on a wrong ring make
    # small gaps: of a coarser pattern half of the gaps are right.
    least, typical = apart[len(apart) // 10], apart[len(apart) // 2]
    measured = least if least > step * WRONG_STEP else typical
    if step / WRONG_STEP <= measured <= step * WRONG_STEP or (least <= step and typical >= step):
        return
    measured = apart[(apart > measured / WRONG_STEP) & (apart < measured * WRONG_STEP)].mean()
    warnings.warn(
        f"empty_beams: neighbouring points of a ring are {float(measured):.3f} degrees apart, those of "
        f"Lidar(columns={columns}) {step:.3f}: the number of empty beams will be wrong. Set "
        f"columns={round(TURN_DEG / float(measured))}, or another sensor, if the points have not been thinned.",
        TorchweatherWarning,
        stacklevel=4,
    )


def _heaps(spectrum: Tensor, counts: Tensor, width: float, mean_ring: float) -> Tensor:
    """Bins of the maxima of the histogram, smoothed by a Gaussian of ``width`` bins; heaps of stray points left out.

    ``spectrum`` is the Fourier transform of the histogram with empty bins behind it.
    """
    size = 2 * (spectrum.shape[-1] - 1)
    frequency = torch.arange(spectrum.shape[-1], dtype=counts.dtype, device=counts.device) / size
    smooth = torch.fft.irfft(spectrum * torch.exp(-2.0 * (math.pi * width * frequency) ** 2), n=size)[: len(counts)]
    edge = smooth.new_full((1,), -1.0)
    rises = smooth > torch.cat([edge, smooth[:-1]])
    falls = smooth >= torch.cat([smooth[1:], edge])
    peaks = (rises & falls & (smooth > ROUNDING * smooth.max())).nonzero()[:, 0]
    bins = torch.arange(len(counts), device=counts.device)
    heap = torch.bucketize(bins.double(), 0.5 * (peaks[1:] + peaks[:-1]).double())
    mass = counts.new_zeros(len(peaks)).index_add_(0, heap, counts)
    kept: Tensor = peaks[mass >= SMALLEST_RING * mean_ring]
    return kept


def _longest_run(numbers: list[int], wanted: int) -> range:
    """Places of the longest run of ``wanted``; empty where there is none."""
    best = range(0)
    start = 0
    for place in range(len(numbers) + 1):
        if place == len(numbers) or numbers[place] != wanted:
            best = max(best, range(start, place), key=len)
            start = place + 1
    return best


def _medians(values: Tensor, group: Tensor, groups: int) -> Tensor:
    """Median of the values of each group, ``(groups,)``; every group has a value."""
    order = values.sort().indices
    order = order[group[order].sort(stable=True).indices]
    count = torch.bincount(group, minlength=groups)
    start = count.cumsum(0) - count
    return 0.5 * (values[order[start + (count - 1) // 2]] + values[order[start + count // 2]])


def _turned(azimuth: Tensor, start: Tensor) -> Tensor:
    return (azimuth - start) % TURN_DEG


def _unit(elevation_deg: Tensor, azimuth_deg: Tensor) -> Tensor:
    elevation, azimuth = torch.deg2rad(elevation_deg), torch.deg2rad(azimuth_deg)
    flat = elevation.cos()
    return torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], dim=-1)


def _has_return(points: Tensor, nearest_m: float = 0.0) -> Tensor:
    """Mask ``(..., N)`` of the returns: finite, not at the origin, not nearer than the sensor measures."""
    xyz = points[..., :3]
    found: Tensor = torch.isfinite(xyz).all(-1) & (xyz != 0).any(-1)
    return found & (xyz.norm(dim=-1) >= nearest_m) if nearest_m > 0 else found


def _elevations(lidar: Lidar, owner: str, device: torch.device | None) -> Tensor:
    if not lidar.elevations_deg:
        raise InputValueError(
            f"{owner}: Lidar(elevations_deg=...) must be known, one elevation per ring in degrees; got "
            f"{lidar.elevations_deg}. Take a preset that has them, or estimate_elevations."
        )
    return torch.tensor(lidar.elevations_deg, dtype=torch.float64, device=device)


def _pattern(lidar: Lidar, owner: str, device: torch.device | None) -> tuple[Tensor, Tensor, int]:
    """Elevations and azimuth offsets of the rings, degrees, and the number of columns."""
    elevations = _elevations(lidar, owner, device)
    if lidar.azimuths_deg is not None:
        raise InputValueError(
            f"{owner}: expected a sensor that turns; got a flash, which has a row of the cloud for every pixel. Its "
            "pixels without return lie along scan_directions(lidar)."
        )
    if lidar.columns is None:
        raise InputValueError(
            f"{owner}: Lidar(columns=...) must be known, the firings of each ring per turn; got None."
        )
    offsets = lidar.azimuth_offsets_deg or (0.0,) * len(elevations)
    return elevations, torch.tensor(offsets, dtype=torch.float64, device=device), lidar.columns


def _heights(heights_m: Sequence[float] | None, elevations: Tensor, owner: str) -> Tensor:
    if heights_m is None:
        return torch.zeros_like(elevations)
    if len(heights_m) != len(elevations):
        raise InputValueError(
            f"{owner}: origin_heights_m must have one value in metres for each of the {len(elevations)} rings; got "
            f"{len(heights_m)}."
        )
    return torch.tensor([float(height) for height in heights_m], dtype=torch.float64, device=elevations.device)


def _check_points(points: Tensor, owner: str) -> None:
    if points.ndim < 2 or points.shape[-1] < 3 or not points.is_floating_point():
        raise InputValueError(
            f"{owner}: points must be floating point of shape (..., N, 3 or more) = x, y, z in metres; got "
            f"{points.dtype}, {tuple(points.shape)}."
        )


def _check_ring(ring: Tensor, points: Tensor, rings: int) -> None:
    if ring.shape != points.shape[:1] or ring.is_floating_point():
        raise InputValueError(
            f"empty_beams: ring must be integers of shape ({len(points)},), one per point; got {ring.dtype}, "
            f"{tuple(ring.shape)}."
        )
    if ring.numel() and int(ring.max()) >= rings:
        raise InputValueError(
            f"empty_beams: ring must lie below the {rings} rings of the sensor; got {int(ring.max())}."
        )
