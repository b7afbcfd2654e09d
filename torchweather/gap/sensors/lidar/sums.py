"""LiDAR frames to sums over bins: what became of each beam, counted along the axes of its scene.

Against the mean of the clear frames a stable beam is *lost*, sees something *before* or *beyond* its surface, or sees
the *same* surface, with another intensity (``ratio``, of logarithms) at another range (``apart``). Returns of empty
beams and those before the surface are *particles*.

References:
    GAP.md 3 (1).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.compiled import uses_compiled
from torchweather.gap.sensors.lidar.scene import CLUSTER_M, FAINTEST, LidarScene, has_neighbour
from torchweather.gap.statistics.frame_statistics import Group, Layout, Reduced

if TYPE_CHECKING:
    from torchweather.gap.sensors.lidar.compiled_sums import Cells, Surfaces

__all__ = ["LidarSums", "lidar_layout", "map_cells"]

PARTICLE_RANGE_M = (0.0, 1.5, 2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 1000.0)
TICKS_PER_M = 2  # of which the edges are multiples
MAP_SECTORS, MAP_RANGES_M = 64, (0.0, 3.0, 6.0, 10.0, 15.0, 22.0, 32.0, 50.0, 1000.0)
# Weight, value and square of each statistic.
SUMS = {
    "lost_share": ("stable", "lost", "lost"),
    "new_share": ("stable", "before", "before"),
    "new_share_of_empty_beams": ("empty", "of_empty", "of_empty"),
    "beyond_share": ("stable", "beyond", "beyond"),
    "log_intensity_ratio": ("bright", "ratio", "ratio2"),
    "log_intensity_spread": ("bright", "even", "even2"),
    "zero_intensity_share": ("same", "dark", "dark"),
    "range_residual_m": ("same", "apart", "apart2"),
    "range_residual_spread": ("same", "wide", "wide2"),
    "particles_before_objects": ("frame", "before", "before"),
    "particles_of_empty_beams": ("frame", "of_empty", "of_empty"),
    "clustered_share": ("particle", "clustered", "clustered"),
    "log_particle_intensity": ("bright_particle", "level", "level2"),
    "log_particle_intensity_spread": ("bright_particle", "level", "level2"),
    "zero_intensity_share_of_particles": ("particle", "dark_particle", "dark_particle"),
    "lost_share_of_thin_targets": ("stable", "lost", "lost"),
}
OF_SURFACES = ("lost", "before", "beyond", "dark", "ratio", "ratio2")
OF_THE_SAME = ("apart", "apart2", "wide", "wide2", "even", "even2")
COUNTS = ("stable", "same", "bright")  # beams, those that see the surface, and of these with an intensity
OF_PARTICLES = (
    *("frame", "before", "of_empty", "particle", "clustered"),
    *("bright_particle", "dark_particle", "level", "level2"),
)
FAR_OUT = 3.0  # clear air's standard deviations; for the middle of its bin a reading beyond counts as lying there
SCALARS = ("lost_share", "particle_root", "log_intensity_ratio", "near_particle_root")
STEADY_COUNT = 0.35  # of 0.5, the scatter of a stabilised count, below which frames are called alike
STEADY_RATIO = 1e-3  # of a mean logarithm over thousands of beams
MAPS = ("particles",)
FROM_CLEAR = ("log_intensity_spread", "range_residual_spread")  # noise that simulated frames have from clear ones

ABOUT_CLEAR_MEAN = ("log_intensity_spread", "range_residual_spread")
OF_SEEN = ("log_intensity_ratio",)
SAME_EVENTS = {
    "lost_share_of_thin_targets": "lost_share",
    "particles_before_objects": "new_share",
    "particles_of_empty_beams": "new_share_of_empty_beams",
}


def lidar_layout(edges: Mapping[str, tuple[float, ...]], with_intensity: bool, beams: int) -> Layout:
    """Statistics along each of the axes that a scene has.

    Args:
        edges: of the bins of each axis.
        with_intensity: whether intensities mean anything.
        beams: that see a surface in a frame.
    """
    groups: list[Group] = []

    def add(statistic: str, kind: str, axes: Sequence[str]) -> None:
        groups.extend(Group(statistic, axis, kind, edges[axis]) for axis in axes if axis in edges)

    everywhere = ("range_m", "margin_db", "azimuth_rad", "elevation_rad", "cos_incidence", "up")
    add("lost_share", "share", everywhere)
    add("new_share", "share", ("range_m", "azimuth_rad", "elevation_rad"))
    add("new_share_of_empty_beams", "share", ("azimuth_rad", "elevation_rad"))
    add("beyond_share", "share", ("range_m", "azimuth_rad"))
    if with_intensity:
        add("log_intensity_ratio", "mean", (*everywhere, "log_intensity"))
        add("log_intensity_spread", "mean", ("range_m",))
        add("zero_intensity_share", "share", ("range_m",))
    add("range_residual_m", "mean", ("range_m", "margin_db"))
    add("range_residual_spread", "mean", ("range_m", "margin_db"))
    groups.append(Group("particles_before_objects", "particle_range_m", "count", PARTICLE_RANGE_M))
    groups.append(Group("particles_of_empty_beams", "particle_range_m", "count", PARTICLE_RANGE_M))
    groups.append(Group("clustered_share", "particle_range_m", "share", PARTICLE_RANGE_M))
    if with_intensity:
        groups.append(Group("log_particle_intensity", "particle_range_m", "mean", PARTICLE_RANGE_M))
        groups.append(Group("log_particle_intensity_spread", "particle_range_m", "spread", PARTICLE_RANGE_M))
        groups.append(Group("zero_intensity_share_of_particles", "particle_range_m", "share", PARTICLE_RANGE_M))
    add("lost_share_of_thin_targets", "share", ("isolated",))
    steady = (STEADY_COUNT / math.sqrt(max(beams, 1)), STEADY_COUNT, STEADY_RATIO, STEADY_COUNT)
    return Layout(
        tuple(groups),
        SCALARS,
        steady,
        MAPS,
        FROM_CLEAR,
        about_clear_mean=ABOUT_CLEAR_MEAN,
        same_events=SAME_EVENTS,
        of_seen=OF_SEEN,
        near_counts=("near_particle_root",),
    )


def map_cells() -> list[tuple[float, float]]:
    """Azimuth, rad, and range, m, of the middle of each cell of the map; the last ring counts as twice its start."""
    rings = [0.5 * (near + min(far, 3.0 * near)) for near, far in itertools.pairwise(MAP_RANGES_M)]
    rings[0] = 0.5 * MAP_RANGES_M[1]
    sectors = [(place + 0.5) / MAP_SECTORS * 2.0 * math.pi - math.pi for place in range(MAP_SECTORS)]
    return [(azimuth, ring) for azimuth in sectors for ring in rings]


class _Beams:
    """Some beams of a scene, summed over along some of its axes.

    Args:
        scene: with the bins of its beams.
        which: ``(N,)`` the beams; or ``(K + 1, N)``, where they are others whatever a frame is compared with.
        axes: along which they are summed.
    """

    def __init__(self, scene: LidarScene, which: Tensor, axes: Sequence[str]) -> None:
        rows = which.expand(len(scene.reference_range_m), -1)
        self.beam = rows.any(0).nonzero()[:, 0]
        self.counts = rows[:, self.beam]  # (K + 1, S)
        self.place: dict[str, slice] = {}
        self.bins = {axis: scene.bins[axis][:, self.beam].where(self.counts, -1) for axis in axes}  # (K + 1, S)
        self._count = {axis: len(scene.edges[axis]) - 1 for axis in axes}
        # One row where the bins are the same whatever a frame is compared with.
        shared = all(bool((bins == bins[:1]).all()) for bins in self.bins.values())
        start = 0
        hot = []
        for axis in axes:
            bins, count = self.bins[axis][: 1 if shared else None], self._count[axis]
            one = torch.zeros(*bins.shape, count + 1)
            one.scatter_(2, bins.where(bins >= 0, count)[..., None], 1.0)
            hot.append(one[..., :count])
            self.place[axis] = slice(start, start + count)
            start += count
        self._hot = torch.cat(hot, 2)
        self._number = self._hot.sum(1, dtype=torch.float64)

    def places(self, row: int) -> NDArray[np.int32]:
        """Place of each beam's bin along each axis ``(axes, S)`` in the sums of a frame; -1 outside."""
        of_axes = [
            torch.where(bins[row] >= 0, bins[row] + self.place[axis].start, -1).int()
            for axis, bins in self.bins.items()
        ]
        return torch.stack(of_axes).contiguous().numpy() if of_axes else np.zeros((0, len(self.beam)), np.int32)

    def number(self, row: Tensor) -> Tensor:
        """Number of beams in each bin ``(F, bins)``."""
        return self._number[row.clamp_max(len(self._number) - 1)]

    def summed(self, values: Tensor, row: Tensor, portion: Tensor, portions: int) -> tuple[Tensor, Tensor]:
        """Number of beams ``(F * portions, bins)``, and sums ``(F * portions, R, bins)`` of values ``(F, R, S)``."""
        if portions == 1:
            return self.number(row), self.whole(values, row)
        one = torch.ones(len(row), 1, len(self.beam))
        return self.portioned(one, row, portion, portions)[:, 0], self.portioned(values, row, portion, portions)

    def whole(self, values: Tensor, row: Tensor) -> Tensor:
        """Sums ``(F, R, bins)`` of values ``(F, R, S)``; frames with the same bins in one product."""
        row = row.clamp_max(len(self._hot) - 1)
        found = torch.empty(*values.shape[:2], self._hot.shape[2], dtype=torch.float64)
        for number in sorted(set(row.tolist())):
            of_row = row == number
            some = values if bool(of_row.all()) else values[of_row]
            found[of_row] = (some.flatten(0, 1) @ self._hot[number]).double().reshape(*some.shape[:2], -1)
        return found

    def portioned(self, values: Tensor, row: Tensor, portion: Tensor, portions: int) -> Tensor:
        """Sums ``(F * portions, R, bins)``, each over the beams of one portion ``(N,)``."""
        own = portion[self.beam]
        parts = []
        for axis, bins in self.bins.items():
            count = self._count[axis]
            index = torch.where(bins[row] >= 0, own * count + bins[row], portions * count)[:, None].expand(values.shape)
            sums = torch.zeros(*values.shape[:2], portions * count + 1, dtype=torch.float64)
            sums.scatter_add_(2, index, values.double())
            parts.append(sums[..., :-1].reshape(*sums.shape[:2], portions, count))
        return torch.cat(parts, 3).transpose(1, 2).flatten(0, 1)


def _beside(number: Tensor, summed: Tensor) -> Tensor:
    """Sums ``(F, R, bins)`` with another row."""
    return torch.cat([summed, number[:, None]], 1)


def _with_counts(number: Tensor, summed: Tensor) -> Tensor:
    """Sums of surfaces ``(F, R, bins)``, with ``COUNTS`` in the last rows; ``number`` of stable beams ``(F, bins)``."""
    same = number - summed[:, : OF_SURFACES.index("dark")].sum(1)
    return torch.cat([summed, torch.stack([number, same, same - summed[:, OF_SURFACES.index("dark")]], 1)], 1)


class LidarSums:
    """Reduces frames of one scene.

    Args:
        scene: with its clear frames.
        layout: of the statistics.
        grid: rows and columns of the scan.
        azimuth: ``(N,)`` of the beams, rad.
    """

    def __init__(self, scene: LidarScene, layout: Layout, grid: tuple[int, int], azimuth: Tensor) -> None:
        self.scene, self.layout = scene, layout
        axes = {group.axis for group in layout.binned} - {"particle_range_m"}
        # Bins along these come from the clear frames that a frame is compared with; the others do not move.
        seen = axes & {"range_m", "margin_db", "log_intensity"}
        self.surfaces, self.standing = (_Beams(scene, scene.stable, sorted(some)) for some in (seen, axes - seen))
        self.nothing = _Beams(scene, scene.empty, ("azimuth_rad", "elevation_rad"))
        self._reference, self._reference_intensity = (
            values[:, self.surfaces.beam]
            for values in (scene.reference_range_m, scene.reference_intensity.clamp_min(FAINTEST))
        )
        self.grid = grid
        ticks = torch.arange(int(PARTICLE_RANGE_M[-2] * TICKS_PER_M) + 1) / TICKS_PER_M
        self._bin, self._ring = (
            torch.bucketize(ticks, torch.tensor(bounds[1:-1]), right=True)
            for bounds in (PARTICLE_RANGE_M, MAP_RANGES_M)
        )
        sector = (azimuth + math.pi) / (2.0 * math.pi) * MAP_SECTORS
        self._sector = sector.long().clamp(0, MAP_SECTORS - 1)
        self._portion: dict[int, Tensor] = {}
        self._places = self._places_of_sums()
        self._entries = [
            torch.cat([self._places[SUMS[group.statistic][which], group.axis] for group in layout.binned])
            for which in range(3)
        ]
        self._compiled_surfaces: dict[int, Surfaces] = {}
        self._compiled_nothing: dict[int, Cells] = {}

    def _places_of_sums(self) -> dict[tuple[str, str], Tensor]:
        """Places of the sums of a value along an axis among all sums of a frame."""
        blocks = (
            (self.surfaces.place, (*OF_SURFACES, *OF_THE_SAME, *COUNTS)),
            (self.standing.place, (*OF_SURFACES, *COUNTS)),
            (self.nothing.place, ("of_empty", "empty")),
            ({"particle_range_m": slice(0, len(PARTICLE_RANGE_M) - 1)}, OF_PARTICLES),
        )
        found, start = {}, 0
        for axes, names in blocks:
            bins = max((place.stop for place in axes.values()), default=0)
            for line, name in enumerate(names):
                for axis, place in axes.items():
                    found[name, axis] = start + line * bins + torch.arange(place.start, place.stop)
            start += len(names) * bins
        return found

    def __call__(self, range_m: Tensor, intensity: Tensor, row: Tensor, portions: int = 1) -> Reduced:
        """Sums of frames ``(F, N)``.

        Args:
            range_m, intensity: ``(F, N)``; 0 where no return.
            row: ``(F,)`` what each is compared with (``LidarScene``).
            portions: into which the beams are divided at random, the same ones in each frame; the result then has
                ``F * portions`` rows, one for each frame and portion, frame by frame.
        """
        of_empty = (range_m[:, self.nothing.beam] > 0) & self.nothing.counts[row]
        portion = self._portions(range_m.shape[1], portions)
        before, of_surfaces, of_standing = self._of_surfaces(range_m, intensity, row, portion, portions)
        particles, maps, near = self._particles(range_m, intensity, before, of_empty, portion, portions)
        number, summed = self._of_nothing(of_empty, row, portion, portions)
        blocks = (_with_counts(*of_surfaces), _with_counts(*of_standing), _beside(number, summed), particles)
        sums = torch.cat([block.flatten(1) for block in blocks], 1)
        weight, value, square = (sums[:, place].numpy() for place in self._entries)
        total = {
            name: sums[:, self._places[name, "azimuth_rad"]].sum(1) for name in ("stable", "lost", "bright", "ratio")
        }
        scalar = torch.stack(
            [
                torch.asin(((total["lost"] + 0.375) / (total["stable"] + 0.75)).sqrt()),
                (particles[:, OF_PARTICLES.index("particle")].sum(1) + 0.375).sqrt(),
                total["ratio"] / total["bright"].clamp_min(1.0),
                (near + 0.375).sqrt(),
            ],
            1,
        )
        return Reduced(weight, value, square, scalar.numpy(), maps[:, None].numpy())

    def repeated(self, range_m: Tensor, row: Tensor) -> NDArray[np.float64]:
        """``(P,)`` frames ``(F, N)`` in which the beam of a loss is lost, at the mean of all losses of a bin; 1 of what
        else is counted. A beam at the threshold may be lost in all of them, one that a filter takes in one."""
        found = np.ones(self.layout.size)
        for group, part in zip(self.layout.groups, self.layout.slices, strict=True):
            if group.kind != "share" or SUMS[group.statistic][1] != "lost":
                continue
            beams = self.surfaces if group.axis in self.surfaces.bins else self.standing
            bins, lost = beams.bins[group.axis][row], range_m[:, beams.beam] <= 0
            here = lost & (bins == torch.arange(group.bins)[:, None, None])  # (bins, F, S)
            times = here.sum(1)  # (bins, S)
            found[part] = (times.square().sum(1) / times.sum(1).clamp_min(1)).clamp_min(1.0).numpy()
        return found

    def _of_surfaces(
        self, range_m: Tensor, intensity: Tensor, row: Tensor, portion: Tensor, portions: int
    ) -> tuple[Tensor, tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """Mask ``(F, S)`` of the stable beams that see a particle; numbers and sums along the axes that follow the
        reference, and along those that do not."""
        if portions == 1 and uses_compiled():
            return self._compiled(range_m, intensity, row)
        compared, before = self._compared(range_m, intensity, row)
        found = (
            beams.summed(values, row, portion, portions)
            for beams, values in ((self.surfaces, compared), (self.standing, compared[:, : len(OF_SURFACES)]))
        )
        return before, next(found), next(found)

    def _compiled(
        self, range_m: Tensor, intensity: Tensor, row: Tensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """As ``_of_surfaces``, by compiled loops; to rounding."""
        from torchweather.gap.sensors.lidar.compiled_sums import sum_frame

        numbers = self.surfaces.number(row), self.standing.number(row)
        sizes = (numbers[0].shape[1], len(OF_SURFACES) + len(OF_THE_SAME)), (numbers[1].shape[1], len(OF_SURFACES))
        sums = [np.zeros((len(row), *size)) for size in sizes]
        before = np.zeros((len(row), len(self.surfaces.beam)), np.bool_)
        ranges, levels = (values.float().contiguous().numpy() for values in (range_m, intensity))
        for frame, reference in enumerate(row.tolist()):
            own = sums[0][frame], sums[1][frame], before[frame], ranges[frame], levels[frame]
            sum_frame(*own, self._surfaces_of(reference))
        of_surfaces, of_standing = (torch.from_numpy(one).transpose(1, 2) for one in sums)
        return torch.from_numpy(before), (numbers[0], of_surfaces), (numbers[1], of_standing)

    def _surfaces_of(self, reference: int) -> Surfaces:
        """The stable beams beside one reference, as compiled loops take them."""
        from torchweather.gap.sensors.lidar.compiled_sums import Surfaces, cells_of

        scene = self.scene
        if reference not in self._compiled_surfaces:
            by_reference = self.surfaces.places(reference)
            self._compiled_surfaces[reference] = Surfaces(
                self.surfaces.beam.int().numpy(),
                self._reference[reference].float().contiguous().numpy(),
                self._reference_intensity[reference].float().contiguous().numpy(),
                cells_of(by_reference),
                cells_of(self.standing.places(reference)),
                by_reference[list(self.surfaces.bins).index("range_m")],
                *map(np.float32, (scene.tolerance_m, scene.noise_m, scene.reading_noise, FAINTEST, FAR_OUT)),
            )
        return self._compiled_surfaces[reference]

    def _compared(self, range_m: Tensor, intensity: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        """Outcome of each stable beam ``(F, rows, S)``, and which of them see a particle ``(F, S)``."""
        beam, tolerance_m = self.surfaces.beam, self.scene.tolerance_m
        range_m = range_m[:, beam]
        seen = range_m > 0
        apart = range_m - self._reference[row]
        before, beyond = seen & (apart <= -tolerance_m), seen & (apart >= tolerance_m)
        same = seen & ~before & ~beyond
        # An intensity of 0 has no logarithm: it is counted.
        intensity = intensity[:, beam]
        bright = same & (intensity > 0)
        ratio = torch.log(intensity.clamp_min(FAINTEST) / self._reference_intensity[row])
        found = torch.empty(len(row), len(OF_SURFACES) + len(OF_THE_SAME), len(beam))
        at = {name: found[:, place] for place, name in enumerate((*OF_SURFACES, *OF_THE_SAME))}
        for name, counted in (("lost", ~seen), ("before", before), ("beyond", beyond), ("dark", same & ~bright)):
            at[name][:] = counted
        torch.mul(ratio, bright, out=at["ratio"])
        torch.mul(ratio, at["ratio"], out=at["ratio2"])
        torch.mul(apart, same, out=at["apart"])
        torch.mul(apart, at["apart"], out=at["apart2"])
        # Spreads are about the frame's own middle: a clock moves all its ranges, a scale all its intensities, and rain
        # dims with range.
        common_m = at["apart"].sum(1, keepdim=True) / same.sum(1, keepdim=True).clamp_min(1)
        middle = self._middle_by_range(ratio, bright, row)
        # Grow with the spread, and hardly with what lies far out: flakes right before the surface.
        for name, away in (
            ("wide", (apart - common_m) * same / self.scene.noise_m),
            ("even", (ratio - middle) * bright / self.scene.reading_noise),
        ):
            torch.log1p(away.square(), out=at[name])
            torch.mul(at[name], at[name], out=at[f"{name}2"])
        return found, before

    def _middle_by_range(self, ratio: Tensor, bright: Tensor, row: Tensor) -> Tensor:
        """Middle of the ratios ``(F, S)`` of bright beams in the bin of range of each beam of a frame, ``(F, S)``.

        One step of Huber's estimate from the mean (Huber 1964, Bickel 1975): one reading far out hardly moves it.
        """
        bins = self.surfaces.bins["range_m"][row]
        count = len(self.scene.edges["range_m"]) - 1
        place = bins.where(bins >= 0, count)
        empty = torch.zeros(len(row), count + 1, dtype=torch.float64)
        number = empty.scatter_add(1, place, bright.double()).clamp_min(1.0)

        def mean(values: Tensor) -> Tensor:
            return (empty.scatter_add(1, place, (values * bright).double()) / number).gather(1, place).float()

        middle, farthest = mean(ratio), FAR_OUT * self.scene.reading_noise
        return middle + mean((ratio - middle).clamp(-farthest, farthest))

    def _of_nothing(self, of_empty: Tensor, row: Tensor, portion: Tensor, portions: int) -> tuple[Tensor, Tensor]:
        """Number of empty beams along their axes ``(F, bins)``, and of those that see a particle ``(F, 1, bins)``."""
        if portions > 1 or not uses_compiled():
            return self.nothing.summed(of_empty[:, None].float(), row, portion, portions)
        from torchweather.gap.sensors.lidar.compiled_sums import cells_of, count_beams

        number = self.nothing.number(row)
        found = np.zeros((len(row), 1, number.shape[1]))
        for frame, (reference, seen) in enumerate(zip(row.tolist(), of_empty.numpy(), strict=True)):
            if reference not in self._compiled_nothing:
                self._compiled_nothing[reference] = cells_of(self.nothing.places(reference))
            count_beams(found[frame, 0], seen, self._compiled_nothing[reference])
        return number, torch.from_numpy(found)

    def _particles(
        self,
        range_m: Tensor,
        intensity: Tensor,
        before: Tensor,
        of_empty: Tensor,
        portion: Tensor,
        portions: int,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Sums of particles over range ``(F, rows, bins)``, their map ``(F, cells)``, number of near ones ``(F,)``."""
        if portions == 1 and uses_compiled():
            return self._compiled_particles(range_m, intensity, before, of_empty)
        frame_1, place_1 = before.nonzero(as_tuple=True)
        frame_2, place_2 = of_empty.nonzero(as_tuple=True)
        frame = torch.cat([frame_1, frame_2])
        beam = torch.cat([self.surfaces.beam[place_1], self.nothing.beam[place_2]])
        flat = frame * range_m.shape[1] + beam
        own = range_m.flatten()[flat]
        clustered = has_neighbour(range_m, self.grid, CLUSTER_M, flat)
        level = intensity.flatten()[flat].double()
        bright = level > 0
        level = level.clamp_min(FAINTEST).log() * bright
        slot = frame if portions == 1 else frame * portions + portion[beam]
        slots, bins, rings = len(range_m) * portions, len(PARTICLE_RANGE_M) - 1, len(MAP_RANGES_M) - 1
        tick = (own * TICKS_PER_M).long().clamp_max(len(self._bin) - 1)
        cell = slot * bins + self._bin[tick]

        def summed(values: Tensor | None, which: slice = slice(None)) -> Tensor:
            """Sums ``(slots, bins)`` over some particles, or their number."""
            weights = None if values is None else values[which].double()
            return torch.bincount(cell[which], weights, slots * bins).double().reshape(slots, bins)

        numbers = [summed(None, slice(0, len(frame_1))), summed(None, slice(len(frame_1), None))]
        everywhere = torch.ones(slots, bins, dtype=torch.float64)
        both, seen = numbers[0] + numbers[1], summed(bright)
        particles = [*numbers, both, summed(clustered), seen, both - seen, summed(level), summed(level * level)]
        sector = slot * MAP_SECTORS + self._sector[beam]
        maps = torch.bincount(sector * rings + self._ring[tick], None, slots * MAP_SECTORS * rings).double()
        maps = maps.reshape(slots, MAP_SECTORS, rings)
        return torch.stack([everywhere, *particles], 1), maps.flatten(1), maps[..., 0].sum(1)

    def _compiled_particles(
        self, range_m: Tensor, intensity: Tensor, before: Tensor, of_empty: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """As ``_particles``, by compiled loops."""
        from torchweather.gap.sensors.lidar.compiled_sums import ParticleBins, sum_particles

        stable, empty, of_tick, ring, sector = (
            values.int().numpy()
            for values in (self.surfaces.beam, self.nothing.beam, self._bin, self._ring, self._sector)
        )
        along = (stable, empty, of_tick, ring, sector, len(MAP_RANGES_M) - 1, TICKS_PER_M)
        own = ParticleBins(*along, *self.grid, np.float32(CLUSTER_M), FAINTEST)
        sums = np.zeros((len(range_m), len(OF_PARTICLES), len(PARTICLE_RANGE_M) - 1))
        maps = np.zeros((len(range_m), MAP_SECTORS * own.rings))
        ranges, levels = (values.float().contiguous().numpy() for values in (range_m, intensity))
        for frame, seen in enumerate(zip(before.numpy(), of_empty.numpy(), strict=True)):
            sum_particles(sums[frame], maps[frame], ranges[frame], levels[frame], *seen, own)
        found = torch.from_numpy(maps)
        return torch.from_numpy(sums), found, found.reshape(len(range_m), MAP_SECTORS, -1)[..., 0].sum(1)

    def _portions(self, beams: int, portions: int) -> Tensor:
        """Portion of each beam ``(N,)``."""
        if portions not in self._portion:
            order = torch.randperm(beams, generator=torch.Generator().manual_seed(0))
            self._portion[portions] = order * portions // beams
        return self._portion[portions]
