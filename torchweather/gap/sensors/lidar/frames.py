"""LiDAR frames for the gap workflow: the conditions of a study simulated, and frames reduced to statistics.

What is looked at is in ``lidar_scene.py`` (what frames are compared with) and ``lidar_sums.py`` (what is counted along
which axes). A simulated frame starts from a clear frame of its scene that its seed chooses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.recent import Recent
from torchweather.gap.inference.effect_forms import searched_effects
from torchweather.gap.sensors.lidar.forms import LIDAR_FORMS
from torchweather.gap.sensors.lidar.open_beams import column_spacing_rad
from torchweather.gap.sensors.lidar.reading_steps import in_steps
from torchweather.gap.sensors.lidar.scene import LidarScene, lidar_scene
from torchweather.gap.sensors.lidar.standing import place_of_standing
from torchweather.gap.sensors.lidar.sums import LidarSums, lidar_layout, map_cells
from torchweather.gap.sensors.lidar.systematics import (
    ClearScale,
    EchoGain,
    FogEchoRange,
    FrameClock,
    ParticleReading,
    ParticleReadingScale,
    WeakSignalNoise,
)
from torchweather.gap.statistics.frame_random_effects import widened
from torchweather.gap.statistics.frame_statistics import Reduced
from torchweather.gap.study.study import Condition, Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.lidar.faintest_echo import particle_gain, run_stages
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import Extinction, ParticleReturns, ToEnergy, ToPoints
from torchweather.lidar.state import LidarState
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.effect import Effect, with_effects
from torchweather.pipeline.stage import Stage

__all__ = ["LidarFrames"]

# Of points whose intensity says less than the threshold; beams that are compared stand above it by their own signal.
LEAST_MARGIN_DB = 1e-3
BEAMS_TOGETHER = 2**17  # of several frames that are simulated at once: more do not fit into the processor's cache
KEPT = 48  # states, so that those of a setting are kept for every condition
# Relative, of the brightness of drops and flakes, and of their readings: what two implementations of one physics differ
# by, of which one adds up the echoes within a pulse and the other takes their mean (2 %, and 4 % of the number).
GAIN_SD = 0.02
# Standard deviations of a reading at the threshold, by which two implementations of one physics differ in the largest.
FOG_GAIN_SD = 0.1
FOG_MISPLACED = 0.03  # of the returns of fog: how far down its peak a noisy waveform is read, order of magnitude
FOG_RANGE_SHARE = 0.1  # of the pulse length, by which receivers differ in where they see fog; order of magnitude
DRAWN = 512  # random numbers of a stage, so that those of a setting are kept for every condition
PARTICLE_GAINS = (1.0, 1.25, 2.0, 4.0, 16.0)  # factors by which effects may brighten particles, rounded up


class LidarFrames:
    """Simulates frames of a study's conditions and reduces frames to statistics.

    Args:
        study: of kind ``lidar``.
        options: of ``LidarWeather`` (the model under test).
        effects: that the model has already.
        named: ids of effects that are searched for although the catalogue leaves them out.
    """

    each_frame_alone: ClassVar[bool] = True

    def __init__(
        self,
        study: Study,
        options: Mapping[str, Any] | None = None,
        effects: Sequence[Effect] = (),
        named: Sequence[str] = (),
    ) -> None:
        sensor = study.sensor_as(Lidar)
        self.options, self.effects = dict(options or {}), list(effects)
        self.fit, self.holdout = (
            [one for one in split if one.weather is not None] for split in (study.fit, study.holdout)
        )
        self.clear_frames = {name: len(scene.clear) for name, scene in study.scenes.items()}
        self.catalogue = searched_effects("lidar", named)
        self.forms: Mapping[str, type[Effect]] = LIDAR_FORMS
        self.as_record: AbstractSet[str] = frozenset()
        direction = torch.from_numpy(np.asarray(study.beams["direction"], dtype=np.float32))
        self.grid = (direction.shape[0], direction.shape[1])
        self.direction = direction.reshape(-1, 3)
        self.sensor = replace(sensor, directions=None, margin_db=LEAST_MARGIN_DB)
        self.energy = ToEnergy(self.sensor)
        with_intensity = self.sensor.intensity_unit != "none"
        self.scenes: dict[str, LidarScene] = {
            name: lidar_scene(scene, self.direction, self.grid, self.energy, with_intensity, self.sensor.max_range_m)
            for name, scene in study.scenes.items()
        }
        self.open_shifts: AbstractSet[str] = {"log_intensity_ratio"} if with_intensity else set()
        self.clear_scale_sd = _clear_scale_sd(self.scenes)
        some = next(iter(self.scenes.values()))
        self.layout = lidar_layout(some.edges, with_intensity, int(some.stable.sum()))
        self.azimuth = torch.atan2(self.direction[:, 1], self.direction[:, 0])
        self._sums = {
            name: LidarSums(scene, self.layout, self.grid, self.azimuth) for name, scene in self.scenes.items()
        }
        self.map_cells = map_cells()
        self.sizes: Mapping[str, float | Sequence[float]] = {
            "saturation": max(float(scene.intensity.max()) for scene in self.scenes.values())
        }
        self.transforms: dict[str, LidarWeather] = {}
        self._orders: dict[tuple[str, ...], list[str]] = {}
        self._kept = Recent[LidarState](KEPT)
        self._drawn = Recent[dict[str, Tensor]](DRAWN)

    # ---- frames --------------------------------------------------------------------------------------------------

    def measured(self, condition: Condition) -> Reduced:
        """The condition's own frames."""
        range_m, intensity = (_stacked(condition, name) for name in ("range_m", "intensity"))
        return self.reduce(condition.scene, range_m, intensity, self._row_of(condition))

    def repeated(self, condition: Condition) -> NDArray[np.float64]:
        """``(P,)`` of the condition's own frames, as ``LidarSums.repeated`` has it."""
        return self._sums[condition.scene].repeated(_stacked(condition, "range_m"), self._row_of(condition))

    def _row_of(self, condition: Condition) -> Tensor:
        """``(F,)`` what the condition's own frames are compared with: all clear frames but one, as simulated ones
        are."""
        return torch.arange(len(condition.frames)) % len(self.scenes[condition.scene].range_m)

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """The clear frames of a scene, each compared with the others; ``portions`` as in ``reduce``."""
        scene = self.scenes[scene_id]
        written = in_steps(scene.intensity, scene.step)
        return self.reduce(scene_id, scene.range_m, written, torch.arange(len(scene.range_m)), portions)

    def standing(self, azimuth_rad: float, range_m: float) -> tuple[float, float, float] | None:
        """Azimuth, rad, range, m, and width, rad, of what stands near a place in the frames to be explained."""
        frames = ((_stacked(one, "range_m"), self.scenes[one.scene].range_m) for one in self.fit if len(one.frames) > 1)
        return place_of_standing(
            self.azimuth, column_spacing_rad(self.azimuth.reshape(self.grid)), frames, azimuth_rad, range_m
        )

    def transform(self, condition: Condition) -> LidarWeather:
        """The ready-made chain of a condition's weather."""
        if condition.id not in self.transforms:
            assert condition.weather is not None
            # Beams without return go to the maximum range, as in the studies that the search was measured on.
            options = {"beam_ends": "max_range", **self.options}
            self.transforms[condition.id] = LidarWeather(condition.weather, self.sensor, **options)
        return self.transforms[condition.id]

    def open(self, condition: Condition) -> dict[str, float]:
        """Names of what the model of a condition leaves open, with the least strength each can have."""
        assert condition.weather is not None
        found = {"noise": 0.0} if self.scenes[condition.scene].variance_at_threshold > 0 else {}
        if "fog" in {part.kind for part in condition.weather.parts}:
            found |= {"fog shift": -math.inf, "fog spread": 0.0}
        if self.clear_scale_sd[condition.scene] > 0:
            found[f"clear scale {condition.scene}"] = -math.inf
        if self.sensor.intensity_unit != "none":
            found["particle reading"] = -math.inf
        return {**found, "particle gain": -math.inf}

    def clear_spread(self, condition: Condition) -> dict[str, float]:
        """Standard deviations of the clear frames of a condition's scene, in which its spreads are told: of the range,
        m, and of ln(intensity)."""
        scene = self.scenes[condition.scene]
        return {"range_residual_spread": scene.noise_m, "log_intensity_spread": scene.reading_noise}

    def misplaced(self, condition: Condition) -> float:
        """Share of the particles of a condition that the model may put into a neighbouring bin of range."""
        assert condition.weather is not None
        return FOG_MISPLACED if "fog" in {part.kind for part in condition.weather.parts} else 0.0

    def clear_noise(self, condition: Condition) -> None:
        """A simulated frame has the noise of its clear frame."""

    def left_open(self, condition: Condition) -> NDArray[np.float64] | float:
        """Scatter ``(P,)`` of mean intensities by where clear readings lie within their steps: one in all frames
        of a scene."""
        scene = self.scenes[condition.scene]
        if scene.unsure is None:
            return 0.0
        found, unsure = np.zeros(self.layout.size), scene.unsure[scene.stable].double()
        for group, part in zip(self.layout.groups, self.layout.slices, strict=True):
            if group.statistic != "log_intensity_ratio" or group.kind != "mean":
                continue
            place = scene.bins[group.axis][-1][scene.stable]
            inside = place >= 0
            number, variance = (
                torch.bincount(place[inside].long(), weights, group.bins)[: group.bins]
                for weights in (None, unsure[inside])
            )
            found[part] = (variance.sqrt() / number.clamp_min(1)).numpy()
        return found

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Every weather is simulated as it is asked for."""

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """Stages of what is left open, at strengths in standard deviations; none at 0.

        Args:
            condition: of the study.
            strengths: by name; what cannot be negative is not below 0.
        """
        given = {name: strengths.get(name, 0.0) for name in self.open(condition)}
        photons = self.sensor.photons_at_threshold
        found: list[Effect] = []
        if given.get("noise", 0.0) > 0:
            variance = given["noise"] * self.scenes[condition.scene].variance_at_threshold
            found.append(WeakSignalNoise(variance_at_threshold=min(variance, 1.0)))
        if given["particle gain"] != 0:
            fog = "fog shift" in given
            one_sd = FOG_GAIN_SD / math.sqrt(photons) if fog else GAIN_SD
            found.append(EchoGain(share=min(max(given["particle gain"] * one_sd, -0.9), 9.0)))
        if given.get("particle reading", 0.0) != 0:
            found.append(ParticleReadingScale(log_scale=min(max(given["particle reading"] * GAIN_SD, -2.0), 2.0)))
        scale = given.get(f"clear scale {condition.scene}", 0.0) * self.clear_scale_sd[condition.scene]
        if scale != 0:
            found.append(ClearScale(log_scale=min(max(scale, -2.0), 2.0)))
        shift, spread = given.get("fog shift", 0.0), max(given.get("fog spread", 0.0), 0.0)
        if shift != 0 or spread > 0:
            share = FOG_RANGE_SHARE * self.sensor.pulse_length_m
            found.append(FogEchoRange(shift_m=shift * share, spread_m=spread * share))
        return found

    def simulated(
        self,
        condition: Condition,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: Sequence[int],
        portions: int = 1,
    ) -> Reduced:
        """Frames of a condition, one for each seed, each from the clear frame that its seed is, modulo their number.

        Args:
            condition: its scene and weather.
            effects: put into the chain, beside those that the model has.
            log_intensity: logarithm of the rate or visibility over its record.
            seeds: of the frames; the same seeds give the same clear frames and random numbers for every effect.
            portions: as in ``reduce``.
        """
        scene = self.scenes[condition.scene]
        parts = []
        at_once = max(BEAMS_TOGETHER // scene.range_m.shape[-1], 1)
        edges = np.linspace(0, len(seeds), math.ceil(len(seeds) / at_once) + 1).round().astype(int)
        for first, last in pairwise(edges):
            some = list(seeds[first:last])
            row = torch.tensor([seed % len(scene.range_m) for seed in some])
            with torch.no_grad():
                out = self._through(condition, scene, row, effects, log_intensity, some)
            parts.append(self.reduce(condition.scene, *out, row, portions))
        return Reduced.joined(parts)

    def simulated_scans(
        self, condition: Condition, effects: Sequence[Effect], log_intensity: float, seeds: Sequence[int]
    ) -> tuple[Tensor, Tensor]:
        """Range and intensity ``(F, N)`` of simulated frames; arguments as ``simulated``."""
        scene = self.scenes[condition.scene]
        row = torch.tensor([seed % len(scene.range_m) for seed in seeds])
        with torch.no_grad():
            return self._through(condition, scene, row, effects, log_intensity, list(seeds))

    def _through(
        self,
        condition: Condition,
        scene: LidarScene,
        row: Tensor,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: list[int],
    ) -> tuple[Tensor, Tensor]:
        """Range and intensity ``(F, N)`` that come out of the chain."""
        transform = self.transform(condition)
        stages = self._stages(transform, scene, row, effects)
        names = [name for name in stages if name != ToPoints.default_name]
        # Two states are kept: the one before the first effect of the catalogue, which all settings of that effect
        # share, and the one behind the echoes of the particles, which all later effects share.
        own = [names.index(one.default_name) for one in effects if one.id in EFFECTS]
        first = min(own, default=len(names))
        every = list(stages.values())
        at = next((place for place, stage in enumerate(every) if isinstance(stage, ParticleReturns)), len(every))
        gain = _stepped(particle_gain(every[at + 1 :]))
        usual = transform.chain.stages
        added = [(name, str(stages[name].config())) for name in names[:first] if name not in usual]

        def key(end: int) -> object:
            weather = (log_intensity, gain) if end > 1 else ()
            return condition.id, tuple(seeds), weather, end, tuple(one for one in added if one[0] in names[:end])

        state, begun = None, 0
        ends = sorted({1, *(end for end in (at + 1, *own) if at < end <= first)})
        for end in reversed(ends):
            state = self._kept.get(key(end))
            if state is not None:
                begun = end
                break
        if state is None:
            # The scale of a frame is one of the reading: detection does not know of it.
            range_m, intensity = scene.range_m[row], scene.intensity[row] / scene.gain[row, None]
            points = torch.cat([self.direction * range_m[..., None], intensity[..., None]], -1)
            state = transform.state_of(points, self.direction)
            state = state.changed(grid=self.grid, cos_incidence=_row(scene.cos_incidence), up=_row(scene.up))
        for end in [*(one for one in ends if one > begun), len(names)]:
            part = [(name, stages[name]) for name in names[begun:end]]
            noise_of = partial(self._noise, stages, condition, state, seeds)
            with _intensity([stage for _, stage in part], condition, log_intensity):
                state = run_stages(part, state, noise_of, gain)
            begun = end
            if end in ends:
                self._kept.put(key(end), state)
        last = stages[ToPoints.default_name]
        assert isinstance(last, ToPoints)
        range_m, intensity = last.measurement(state, self._noise(stages, condition, state, seeds, last.default_name))
        return range_m, in_steps(intensity * scene.gain[row, None], scene.step)

    def _stages(
        self, transform: LidarWeather, scene: LidarScene, row: Tensor, effects: Sequence[Effect]
    ) -> dict[str, Stage]:
        """Stages of the transform, of the model's effects and of others, by name, in the order in which they run."""
        catalogued = [*self.effects, *(one for one in effects if one.id in EFFECTS)]
        others = [one for one in effects if one.id not in EFFECTS]
        if scene.reading_std > 0:
            others.append(ParticleReading(std=min(scene.reading_std, 1.0)))
        if bool(scene.clock_m.any()):
            others.append(FrameClock(late_m=scene.clock_m[row].clamp(-1.0, 1.0)))
        stages: dict[str, Stage] = {one.default_name: one for one in (*catalogued, *others)}
        order = self._orders.get(tuple(stages))
        if order is None:
            chain = with_effects(transform.chain, catalogued)
            for one in others:  # of systematics.py
                chain = chain.insert(one, before={"particle_returns": "detection"}.get(one.after, "to_points"))
            self._orders[tuple(stages)] = order = list(chain.stages)
        usual = transform.chain.stages
        return {name: stages[name] if name in stages else usual[name] for name in order}

    def _noise(
        self, stages: Mapping[str, Stage], condition: Condition, state: LidarState, seeds: list[int], name: str
    ) -> dict[str, Tensor]:
        """Random numbers of a stage for the frames of some seeds, kept: they depend on its name alone."""
        key = (condition.id, name, tuple(seeds))
        drawn = self._drawn.get(key)
        if drawn is None:
            drawn = stages[name].draw(state, seed=torch.tensor(seeds), name=name)
            self._drawn.put(key, drawn)
        return drawn

    def reduce(self, scene_id: str, range_m: Tensor, intensity: Tensor, row: Tensor, portions: int = 1) -> Reduced:
        """Sums of frames ``(F, N)`` of a scene; arguments as ``LidarSums``."""
        return self._sums[scene_id](range_m, intensity, row, portions)


def _stacked(condition: Condition, name: str) -> Tensor:
    """Readings ``(F, N)`` of a condition's frames."""
    frames = [condition.frames[number] for number in range(len(condition.frames))]
    return torch.stack([torch.from_numpy(np.asarray(frame[name], dtype=np.float32)).reshape(-1) for frame in frames])


def _clear_scale_sd(scenes: Mapping[str, LidarScene]) -> dict[str, float]:
    """Standard deviation of the logarithm of the scale of each scene's clear mean, from how frames of all differ."""
    squares = sum(float(scene.log_scale.square().sum()) for scene in scenes.values())
    degrees_of_freedom = sum(len(scene.log_scale) - 1 for scene in scenes.values())
    if degrees_of_freedom < 1:
        return dict.fromkeys(scenes, 0.0)
    one_frame = squares / degrees_of_freedom * widened(degrees_of_freedom)
    return {name: math.sqrt(one_frame / len(scene.log_scale)) for name, scene in scenes.items()}


def _stepped(gain: float) -> float:
    """The next larger of a few gains of particles, so that states are shared by effects of similar strength."""
    return next((step for step in PARTICLE_GAINS if step >= gain), math.inf)


@contextmanager
def _intensity(stages: Sequence[Stage], condition: Condition, log_intensity: float) -> Iterator[None]:
    """Rate or visibility times ``exp(log_intensity)`` in some stages, while the block lasts."""
    weather = condition.weather
    assert weather is not None
    changed = []
    for stage in stages:
        if isinstance(stage, (Extinction, ParticleReturns)):
            for part in weather.parts:
                buffers = stage.parts[part.kind]
                changed.append((buffers, part.intensity_name, getattr(buffers, part.intensity_name)))
    try:
        for buffers, name, before in changed:
            setattr(buffers, name, before * math.exp(log_intensity))
        yield
    finally:
        for buffers, name, before in changed:
            setattr(buffers, name, before)


def _row(values: Tensor | None) -> Tensor | None:
    return None if values is None else values[None]
