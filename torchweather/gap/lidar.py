"""What the gap workflow looks at in LiDAR frames, and how it simulates them.

A frame is compared with the clear frames of its scene, beam by beam: which beams lost their return, which report
something in front of (or behind) what stands there, and how range and intensity of the rest changed. Beams are sorted
into bins of range, energy margin, direction, incidence and so on; nothing is compared point with point.

A beam is *stable* where all clear frames see one surface and *empty* where none sees anything; others are left out. A
simulated frame starts from one clear frame and is compared with the others, a measured one with all but one too: both
differ from what they are compared with by the noise of a frame of their own.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.gap.statistics import Group, Layout, Reduced
from torchweather.gap.study import Condition, Study, StudyScene
from torchweather.sensors import Lidar
from torchweather.stages import Chain, Extinction, LidarState, ParticleReturns, ToEnergy
from torchweather.stages.effects import Effect, with_effects
from torchweather.stages.effects_lidar import EFFECTS
from torchweather.transforms import LidarWeather

__all__ = ["LidarFrames", "LidarScene"]

Floats = NDArray[np.float64]

RANGE_M = (0.0, 4.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0, 55.0, 75.0, 110.0, 1000.0)
PARTICLE_RANGE_M = (0.0, 1.5, 2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 1000.0)
MARGIN_DB = (-10.0, 0.7, 1.5, 2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 60.0)
AZIMUTH_SECTORS, ELEVATION_BINS, LEVEL_BINS = 16, 8, 5
COS_INCIDENCE = (0.0, 0.15, 0.3, 0.5, 0.75, 1.0001)
UP = (-1.0001, -0.5, 0.5, 1.0001)
# Nearer to the surface than this a return is the surface's: several times the range noise of a scanner.
SAME_SURFACE_M = 0.35
SPREAD_TIMES = 6.0
CLUSTER_M = 0.5  # returns of one thing in neighbouring beams
MAP_SECTORS, MAP_RANGES_M = 64, (0.0, 3.0, 6.0, 10.0, 15.0, 22.0, 32.0, 50.0, 1000.0)
FAINTEST = 1e-6  # of intensities in logarithms
# Weight, value and square of each statistic.
SUMS = {
    "lost_share": ("stable", "lost", "lost"),
    "new_share": ("stable", "before", "before"),
    "new_share_of_empty_beams": ("empty", "of_empty", "of_empty"),
    "beyond_share": ("stable", "beyond", "beyond"),
    "log_intensity_ratio": ("same", "ratio", "ratio2"),
    "log_intensity_spread": ("same", "ratio", "ratio2"),
    "range_residual_m": ("same", "apart", "apart2"),
    "range_residual_spread": ("same", "apart", "apart2"),
    "particles_before_objects": ("frame", "before", "before"),
    "particles_of_empty_beams": ("frame", "of_empty", "of_empty"),
    "clustered_share": ("particle", "clustered", "clustered"),
    "log_particle_intensity": ("particle", "level", "level2"),
    "log_particle_intensity_spread": ("particle", "level", "level2"),
    "lost_share_of_thin_targets": ("stable", "lost", "lost"),
}
BEAM_ROWS = (
    *("stable", "lost", "before", "beyond", "empty", "of_empty"),
    *("same", "ratio", "ratio2", "apart", "apart2"),
)
PARTICLE_ROWS = ("before", "of_empty", "particle", "clustered", "level", "level2")
KEPT = 32  # states, so that one is kept for every condition and place of an effect
EXTRA = frozenset(effect.default_name for effect in EFFECTS.values())
SCALARS = ("lost_share", "particle_root", "log_intensity_ratio", "near_particle_root")
MAPS = ("particles",)


@dataclass(frozen=True)
class LidarScene:
    """The clear frames of a scene and what each frame is compared with.

    Args:
        range_m, intensity: ``(K, N)`` clear frames.
        reference_range_m, reference_intensity: ``(K + 1, N)`` mean over the clear frames other than k, the last row
            over all; 0 where it is not defined.
        stable, empty: ``(K + 1, N)`` which beams count as what.
        tolerance_m: ``(N,)`` how near to the reference a return is the surface's.
        bins: axis to the bin of each beam ``(K + 1, N)``, -1 for none, after the clear frames other than k: a frame
            must not choose the bin that it is put into.
        edges: axis to the edges of its bins.
        isolated: ``(N,)`` beams whose surface no neighbour shares.
        cos_incidence, up: ``(N,)`` or None.
    """

    range_m: Tensor
    intensity: Tensor
    reference_range_m: Tensor
    reference_intensity: Tensor
    stable: Tensor
    empty: Tensor
    tolerance_m: Tensor
    bins: dict[str, Tensor]
    edges: dict[str, tuple[float, ...]]
    isolated: Tensor
    cos_incidence: Tensor | None
    up: Tensor | None


class LidarFrames:
    """Simulates frames of a study's conditions and reduces frames to statistics.

    Args:
        study: of kind ``lidar``.
        options: of ``LidarWeather`` (the model under test).
        effects: that the model has already.
    """

    def __init__(self, study: Study, options: Mapping[str, Any] | None = None, effects: Sequence[Effect] = ()) -> None:
        assert isinstance(study.sensor, Lidar)
        self.study, self.options, self.effects = study, dict(options or {}), list(effects)
        direction = torch.from_numpy(np.asarray(study.beams["direction"], dtype=np.float32))
        self.grid = (direction.shape[0], direction.shape[1])
        self.direction = direction.reshape(-1, 3)
        self.sensor = replace(study.sensor, directions=None)
        self.azimuth = torch.atan2(self.direction[:, 1], self.direction[:, 0])
        self.elevation = torch.asin(self.direction[:, 2].clamp(-1.0, 1.0))
        self.energy = ToEnergy(self.sensor)
        self.with_intensity = self.sensor.intensity_unit != "none"
        self.scenes = {name: self._scene(scene) for name, scene in study.scenes.items()}
        self.transforms: dict[str, LidarWeather] = {}
        self._kept: dict[object, LidarState] = {}
        self._lock = threading.Lock()
        some = next(iter(self.scenes.values()))
        self.layout = self._layout(some)
        self._matrices = {name: self._matrix(scene) for name, scene in self.scenes.items()}

    # ---- scenes --------------------------------------------------------------------------------------------------

    def _scene(self, scene: StudyScene) -> LidarScene:
        frames = [scene.clear[number] for number in range(len(scene.clear))]
        range_m, intensity = (
            torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])
            for name in ("range_m", "intensity")
        )
        number = len(frames)
        seen = (range_m > 0).double()
        # Row k leaves frame k out, the last row takes all; of a single frame, itself.
        keep = torch.ones(number + 1, number, dtype=torch.float64)
        if number > 1:
            keep[:number] -= torch.eye(number, dtype=torch.float64)
        count, frames_of = keep @ seen, keep.sum(1, keepdim=True)
        mean_range = (keep @ range_m.double()) / count.clamp_min(1.0)
        mean_intensity = (keep @ (intensity.double() * seen)) / count.clamp_min(1.0)
        far, near = range_m.amax(0), torch.where(range_m > 0, range_m, torch.inf).amin(0)
        apart = torch.where(far > 0, far - near, 0.0)
        one_surface = apart < 2.0 * SAME_SURFACE_M
        stable, empty = (count == frames_of) & one_surface, count == 0
        noise = torch.where(seen > 0, range_m.double() - mean_range[-1], 0.0)
        usual = float((noise.square().sum() / seen.sum().clamp_min(1.0)).sqrt()) if bool(seen.any()) else 0.0
        tolerance = torch.full_like(far, max(SAME_SURFACE_M, SPREAD_TIMES * min(usual, 0.2)))
        geometry = {
            name: torch.from_numpy(np.asarray(scene.geometry[name], dtype=np.float32)).reshape(-1)
            for name in ("cos_incidence", "up")
            if name in scene.geometry
        }
        bins, edges = self._bins(mean_range, mean_intensity, stable[-1], geometry)
        return LidarScene(
            range_m=range_m,
            intensity=intensity,
            reference_range_m=mean_range.float(),
            reference_intensity=mean_intensity.float(),
            stable=stable,
            empty=empty,
            tolerance_m=tolerance,
            bins=bins,
            edges=edges,
            isolated=stable[-1] & ~self._has_neighbour(mean_range[-1].float()[None], 2.0 * CLUSTER_M)[0],
            cos_incidence=geometry.get("cos_incidence"),
            up=geometry.get("up"),
        )

    def _bins(
        self, range_m: Tensor, intensity: Tensor, stable: Tensor, geometry: Mapping[str, Tensor]
    ) -> tuple[dict[str, Tensor], dict[str, tuple[float, ...]]]:
        """Bins of each beam along every axis that a beam has."""
        floats: dict[str, tuple[Tensor, tuple[float, ...]]] = {"range_m": (range_m, RANGE_M)}
        with torch.no_grad():
            signal = self.energy.signal_of_intensity(intensity.float(), range_m.float())
        margin_db = 10.0 * torch.log10((signal / self.energy.beam.threshold).clamp_min(1e-6))
        if self.with_intensity:
            floats["margin_db"] = (margin_db, MARGIN_DB)
            level = intensity.clamp_min(FAINTEST).log()
            shares = torch.linspace(0, 1, LEVEL_BINS + 1, dtype=torch.float64)[1:-1]
            inner = torch.quantile(level[-1, stable].double(), shares).tolist() if bool(stable.any()) else []
            levels = (-30.0, *inner, 30.0)
            floats["log_intensity"] = (level, levels)
        sectors = tuple(float(v) for v in np.linspace(-math.pi - 1e-6, math.pi + 1e-6, AZIMUTH_SECTORS + 1))
        floats["azimuth_rad"] = (self.azimuth, sectors)
        low, high = float(self.elevation.min()), float(self.elevation.max())
        floats["elevation_rad"] = (
            self.elevation,
            tuple(float(v) for v in np.linspace(low - 1e-6, high + 1e-6, ELEVATION_BINS + 1)),
        )
        if "cos_incidence" in geometry:
            floats["cos_incidence"] = (geometry["cos_incidence"].abs(), COS_INCIDENCE)
        if "up" in geometry:
            floats["up"] = (geometry["up"], UP)
        bins, edges = {}, {}
        for axis, (value, bounds) in floats.items():
            place = (
                torch.bucketize(value.double().contiguous(), torch.tensor(bounds, dtype=torch.float64), right=True) - 1
            )
            inside = (place >= 0) & (place < len(bounds) - 1)
            bins[axis], edges[axis] = torch.where(inside, place, -1), tuple(bounds)
        return bins, edges

    def _layout(self, scene: LidarScene) -> Layout:
        """Which statistics along which axes."""
        edges = scene.edges
        groups: list[Group] = []

        def add(statistic: str, kind: str, axes: Sequence[str]) -> None:
            groups.extend(Group(statistic, axis, kind, edges[axis]) for axis in axes if axis in edges)

        everywhere = ("range_m", "margin_db", "azimuth_rad", "elevation_rad", "cos_incidence", "up")
        add("lost_share", "share", everywhere)
        add("new_share", "share", ("range_m", "azimuth_rad", "elevation_rad"))
        add("new_share_of_empty_beams", "share", ("azimuth_rad", "elevation_rad"))
        add("beyond_share", "share", ("range_m", "azimuth_rad"))
        if self.with_intensity:
            add("log_intensity_ratio", "mean", (*everywhere, "log_intensity"))
            add("log_intensity_spread", "spread", ("range_m",))
        add("range_residual_m", "mean", ("range_m", "margin_db"))
        add("range_residual_spread", "spread", ("range_m", "margin_db"))
        groups.append(Group("particles_before_objects", "particle_range_m", "count", PARTICLE_RANGE_M))
        groups.append(Group("particles_of_empty_beams", "particle_range_m", "count", PARTICLE_RANGE_M))
        groups.append(Group("clustered_share", "particle_range_m", "share", PARTICLE_RANGE_M))
        if self.with_intensity:
            groups.append(Group("log_particle_intensity", "particle_range_m", "mean", PARTICLE_RANGE_M))
            groups.append(Group("log_particle_intensity_spread", "particle_range_m", "spread", PARTICLE_RANGE_M))
        groups.append(Group("lost_share_of_thin_targets", "isolated", "share", (0.0, 0.5, 1.5)))
        return Layout(tuple(groups), SCALARS, MAPS)

    def _matrix(self, scene: LidarScene) -> tuple[Tensor, dict[str, slice]]:
        """One-hot ``(K + 1, N, bins)`` of all axes of the beams together, and where each axis stands."""
        parts, places, start = [], {}, 0
        rows, beams = scene.stable.shape
        for axis, place in scene.bins.items():
            count = len(scene.edges[axis]) - 1
            hot = torch.zeros(rows, beams, count + 1)
            hot.scatter_(2, place.expand(rows, beams).where(place >= 0, count)[..., None], 1.0)
            parts.append(hot[..., :count])
            places[axis] = slice(start, start + count)
            start += count
        return torch.cat(parts, 2), places

    def _has_neighbour(self, range_m: Tensor, within_m: float) -> Tensor:
        """Whether one of the eight neighbours of a return ``(F, N)`` is a return of nearly its range."""
        image = range_m.reshape(-1, *self.grid)
        found = torch.zeros_like(image, dtype=torch.bool)
        rows = image.shape[-2]
        for down in (-1, 0, 1):
            if abs(down) >= rows:
                continue
            for aside in (-1, 0, 1):
                if down == aside == 0:
                    continue
                other = image.roll(aside, -1)
                shifted = torch.zeros_like(image)
                if down < 0:
                    shifted[..., :-1, :] = other[..., 1:, :]
                elif down > 0:
                    shifted[..., 1:, :] = other[..., :-1, :]
                else:
                    shifted = other
                found |= (shifted > 0) & ((shifted - image).abs() < within_m)
        return (found & (image > 0)).reshape(range_m.shape)

    # ---- frames --------------------------------------------------------------------------------------------------

    def measured(self, condition: Condition) -> Reduced:
        """The condition's own frames."""
        frames = [condition.frames[number] for number in range(len(condition.frames))]
        range_m, intensity = (
            torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])
            for name in ("range_m", "intensity")
        )
        # Compared with all clear frames but one, as simulated frames are.
        row = torch.arange(len(frames)) % len(self.scenes[condition.scene].range_m)
        return self.reduce(condition.scene, range_m, intensity, row)

    def clear(self, scene_id: str) -> Reduced:
        """The clear frames of a scene, each compared with the others."""
        scene = self.scenes[scene_id]
        return self.reduce(scene_id, scene.range_m, scene.intensity, torch.arange(len(scene.range_m)))

    def transform(self, condition: Condition) -> LidarWeather:
        """The ready-made chain of a condition's weather."""
        if condition.id not in self.transforms:
            assert condition.weather is not None
            self.transforms[condition.id] = LidarWeather(condition.weather, self.sensor, **self.options)
        return self.transforms[condition.id]

    def simulated(
        self,
        condition: Condition,
        effects: Sequence[Effect],
        log_knob: float,
        seeds: Sequence[int],
        portions: int = 1,
    ) -> Reduced:
        """Frames of a condition, one for each seed, each from a clear frame that its seed chooses.

        Args:
            condition: its scene and weather.
            effects: put into the chain, beside those that the model has.
            log_knob: logarithm of the weather's knob over its record.
            seeds: of the frames; the same seeds give the same clear frames and random numbers for every effect.
            portions: as in ``reduce``.
        """
        scene = self.scenes[condition.scene]
        row = torch.tensor([_hash(seed) % len(scene.range_m) for seed in seeds])
        range_m, intensity = scene.range_m[row], scene.intensity[row]
        with torch.no_grad():
            state = self._through(condition, scene, range_m, intensity, effects, log_knob, list(seeds))
        points = state.points
        assert points is not None
        out = points[..., :3].norm(dim=-1)
        return self.reduce(condition.scene, out, points[..., 3] * (out > 0), row, portions)

    def _through(
        self,
        condition: Condition,
        scene: LidarScene,
        range_m: Tensor,
        intensity: Tensor,
        effects: Sequence[Effect],
        log_knob: float,
        seeds: list[int],
    ) -> LidarState:
        transform = self.transform(condition)
        chain = with_effects(transform.chain, [*self.effects, *effects])
        # What comes before the last effect is the same for all its settings: kept.
        names = list(chain.stages)
        last = max((names.index(effect.default_name) for effect in effects), default=len(names))
        before = tuple(
            (name, str(stage.config())) for name, stage in list(chain.stages.items())[:last] if name in EXTRA
        )
        key = (condition.id, log_knob, tuple(seeds), names[last - 1], before)
        kept = self._kept.get(key)
        if kept is None:
            points = torch.cat([self.direction * range_m[..., None], intensity[..., None]], -1)
            state = transform.state_of(points, self.direction)
            state = replace(state, grid=self.grid, cos_incidence=_row(scene.cos_incidence), up=_row(scene.up))
            kept = self._part(chain, condition, log_knob, state, seeds, 0, last)
            self._keep(key, kept)
        return self._part(chain, condition, log_knob, kept, seeds, last, len(names))

    def _part(
        self, chain: Chain, condition: Condition, log_knob: float, state: LidarState, seeds: list[int], *ends: int
    ) -> LidarState:
        """The state after some of the stages of a chain."""
        part = Chain(dict(list(chain.stages.items())[slice(*ends)]))
        with _knob(part, condition, log_knob):
            found: LidarState = part(state, part.draw(state, seed=torch.tensor(seeds)))
        return found

    def _keep(self, key: object, state: LidarState) -> None:
        with self._lock:
            while len(self._kept) >= KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = state

    def reduce(self, scene_id: str, range_m: Tensor, intensity: Tensor, row: Tensor, portions: int = 1) -> Reduced:
        """Sums of frames ``(F, N)``.

        Args:
            scene_id: of the scene.
            range_m, intensity: ``(F, N)``; 0 where no return.
            row: ``(F,)`` what each is compared with (``LidarScene``).
            portions: into which the beams are divided at random, the same ones in each frame; the result then has
                ``F * portions`` rows, one for each frame and portion, frame by frame.
        """
        scene = self.scenes[scene_id]
        compared = self._compared(scene, range_m, intensity, row)
        if portions == 1:
            return self._sums(scene_id, compared, row, None)
        order = torch.randperm(range_m.shape[1], generator=torch.Generator().manual_seed(0))
        parts = [self._sums(scene_id, compared, row, beams) for beams in order.chunk(portions)]
        shape = ("weight", "value", "square", "scalar", "maps")
        stacked = (np.stack([getattr(part, name) for part in parts], 1) for name in shape)
        return Reduced(*(values.reshape(-1, *values.shape[2:]) for values in stacked))

    def _compared(self, scene: LidarScene, range_m: Tensor, intensity: Tensor, row: Tensor) -> dict[str, Tensor]:
        """What became of each beam, ``(F, N)`` each."""
        reference, stable, empty = scene.reference_range_m[row], scene.stable[row], scene.empty[row]
        seen = range_m > 0
        apart = range_m - reference
        same = stable & seen & (apart.abs() < scene.tolerance_m)
        before, beyond = stable & seen & (apart <= -scene.tolerance_m), stable & seen & (apart >= scene.tolerance_m)
        of_empty = empty & seen
        particle = before | of_empty
        old = scene.reference_intensity[row].clamp_min(FAINTEST)
        ratio = torch.where(same, (intensity.clamp_min(FAINTEST) / old).log(), 0.0)
        apart = torch.where(same, apart, 0.0)
        level = torch.where(particle, intensity.clamp_min(FAINTEST).log(), 0.0)
        return {
            "stable": stable, "lost": stable & ~seen, "before": before, "beyond": beyond,
            "empty": empty, "of_empty": of_empty,
            "same": same, "ratio": ratio, "ratio2": ratio * ratio, "apart": apart, "apart2": apart * apart,
            "particle": particle, "level": level, "level2": level * level,
            "clustered": particle & self._has_neighbour(range_m, CLUSTER_M),
            "thin": stable & scene.isolated, "lost_thin": stable & ~seen & scene.isolated, "range_m": range_m,
        }  # fmt: skip

    def _sums(self, scene_id: str, compared: Mapping[str, Tensor], row: Tensor, beams: Tensor | None) -> Reduced:
        """Sums over all beams, or some of them."""
        hot, places = self._matrices[scene_id]
        azimuth = self.azimuth
        if beams is not None:
            compared = {name: values[:, beams] for name, values in compared.items()}
            hot, azimuth = hot[:, beams], azimuth[beams]
        along_beams = torch.stack([compared[name].float() for name in BEAM_ROWS], 1)  # (F, rows, N)
        pairs = zip(along_beams, row.tolist(), strict=True)
        by_beam = torch.stack([frame @ hot[number] for frame, number in pairs]).double()
        bounds = torch.tensor(PARTICLE_RANGE_M)
        range_m, frames = compared["range_m"], len(row)
        place = (torch.bucketize(range_m, bounds, right=True) - 1).clamp(0, len(bounds) - 2)
        by_range = {}
        for name in PARTICLE_ROWS:
            sums = torch.zeros(frames, len(bounds) - 1, dtype=torch.float64)
            by_range[name] = sums.scatter_add_(1, place, compared[name].double())
        total = {name: compared[name].double().sum(1) for name in ("stable", "lost", "thin", "lost_thin")}
        by_range["frame"] = torch.ones_like(by_range["particle"])
        by_thin = {
            "stable": torch.stack([total["stable"] - total["thin"], total["thin"]], 1),
            "lost": torch.stack([total["lost"] - total["lost_thin"], total["lost_thin"]], 1),
        }
        found: list[list[Tensor]] = [[], [], []]
        for group in self.layout.binned:
            for target, name in zip(found, SUMS[group.statistic], strict=True):
                if group.axis in places:
                    target.append(by_beam[:, BEAM_ROWS.index(name), places[group.axis]])
                else:
                    target.append((by_thin if group.axis == "isolated" else by_range)[name])
        particle = compared["particle"]
        near = particle & (range_m < MAP_RANGES_M[1])
        scalar = torch.stack(
            [
                torch.asin((total["lost"] / total["stable"].clamp_min(1.0)).sqrt()),
                (particle.double().sum(1) + 0.375).sqrt(),
                compared["ratio"].double().sum(1) / compared["same"].double().sum(1).clamp_min(1.0),
                (near.double().sum(1) + 0.375).sqrt(),
            ],
            1,
        )
        weight, value, square = (torch.cat(parts, 1).numpy() for parts in found)
        maps = self._map(particle, range_m, azimuth)[:, None].numpy()
        return Reduced(weight, value, square, scalar.numpy(), maps)

    def _map(self, particle: Tensor, range_m: Tensor, azimuth: Tensor) -> Tensor:
        """Particles per cell of azimuth and range, ``(F, cells)``."""
        bounds = torch.tensor(MAP_RANGES_M)
        ring = (torch.bucketize(range_m, bounds, right=True) - 1).clamp(0, len(bounds) - 2)
        sector = ((azimuth + math.pi) / (2.0 * math.pi) * MAP_SECTORS).long().clamp(0, MAP_SECTORS - 1)
        cell = sector * (len(bounds) - 1) + ring
        found = torch.zeros(len(range_m), MAP_SECTORS * (len(bounds) - 1), dtype=torch.float64)
        return found.scatter_add_(1, cell, particle.double())


@contextmanager
def _knob(chain: Chain, condition: Condition, log_knob: float) -> Iterator[None]:
    """The weather's knob times ``exp(log_knob)`` in all stages of a chain, while the block lasts."""
    weather = condition.weather
    assert weather is not None
    changed = []
    for stage in chain.stages.values():
        if isinstance(stage, (Extinction, ParticleReturns)):
            for part in weather.parts:
                buffers = stage.parts[part.kind]
                changed.append((buffers, part.knob_name, getattr(buffers, part.knob_name)))
    try:
        for buffers, name, before in changed:
            setattr(buffers, name, before * math.exp(log_knob))
        yield
    finally:
        for buffers, name, before in changed:
            setattr(buffers, name, before)


def _row(values: Tensor | None) -> Tensor | None:
    return None if values is None else values[None]


def _hash(seed: int) -> int:
    """A number from a seed that has nothing to do with its lowest bits (splitmix64, Steele et al. 2014)."""
    mixed = (seed + 0x9E3779B97F4A7C15) & (2**64 - 1)
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & (2**64 - 1)
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & (2**64 - 1)
    return mixed ^ (mixed >> 31)
