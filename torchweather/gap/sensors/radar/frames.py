"""Radar frames for the gap workflow: the conditions of a study simulated, and frames reduced to statistics.

What is looked at is in ``radar_scene.py`` (what frames are compared with) and ``radar_sums.py`` (what is counted along
which axes). A simulated frame starts from a clear frame of its scene that its seed chooses. The k-th frame that is
simulated in one call stands for the k-th of the condition, modulo their number: ranges that drift do so over frames.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.errors import TorchweatherError
from torchweather.gap.inference.effect_forms import searched_effects
from torchweather.gap.sensors.radar.forms import InterferenceForm, multipath_form, volume_clutter_form, wet_rcs_form
from torchweather.gap.sensors.radar.scene import (
    Detections,
    RadarScene,
    detection_count,
    detections_of,
    own_spread,
    radar_edges,
    radar_scene,
)
from torchweather.gap.sensors.radar.sums import RadarSums, radar_layout
from torchweather.gap.sensors.radar.systematics import ReceiverNoise
from torchweather.gap.statistics.frame_statistics import FEWEST, Reduced
from torchweather.gap.study.conditions import Condition
from torchweather.gap.study.study import Study
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect, with_effects
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.attenuation import PathAttenuation, WetRadome
from torchweather.radar.clutter import VolumeClutter
from torchweather.radar.effects.all import EFFECTS, RadarInterference, RadarVolumeClutter
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState
from torchweather.radar.transform import RadarAttenuation

__all__ = ["RadarFrames"]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

SPEED, POWER = 3, 4  # columns of a list
FEWEST_TARGETS = 2.0 * FEWEST["share"]  # targets times frames of a condition: two bins along an axis that count
CLUTTER_SHARES = tuple(1e-4 * 2.0**step for step in range(17))  # tried, up to 6.6
CLUTTER_FRAMES, CLUTTER_COUNT = 4, 2.0  # frames of each, and detections a frame that are some
GHOST_STEP = 1.4  # from an amplitude of a second path to the next that is tried: 3 dB
FALSE_ALARM_MOVED = 0.3  # standard deviation of the logarithm of their range: about a bin
FEWEST_FOR_SLOPE = 3  # frames of a condition
DRAWN = 512  # random numbers of a stage, so that those of a setting are kept for every condition
LOST = int(PointKind.LOST)


class RadarFrames:
    """Simulates frames of a study's conditions and reduces frames to statistics.

    Args:
        study: of kind ``radar``.
        options: of ``RadarAttenuation`` (the model under test).
        effects: that the model has already.
        named: ids of effects that are searched for although the catalogue leaves them out.

    Raises:
        TorchweatherError: the clear frames do not tell how much they differ.
    """

    def __init__(
        self,
        study: Study,
        options: Mapping[str, Any] | None = None,
        effects: Sequence[Effect] = (),
        named: Sequence[str] = (),
    ) -> None:
        sensor = study.sensor_as(Radar)
        self.options, self.effects = dict(options or {}), list(effects)
        self.fit, self.holdout = (
            [one for one in split if one.weather is not None] for split in (study.fit, study.holdout)
        )
        self.clear_frames = {name: len(scene.clear) for name, scene in study.scenes.items()}
        self.catalogue = searched_effects("radar", named)
        self.as_record: AbstractSet[str] = frozenset()
        self.scenes: dict[str, RadarScene] = {name: radar_scene(scene, sensor) for name, scene in study.scenes.items()}
        floor_db = float(np.mean([scene.clear.floor_db.mean() for scene in self.scenes.values()]))
        self.sensor = replace(sensor, noise_floor_db=floor_db)
        self._check()
        self.open_shifts: AbstractSet[str] = frozenset()
        self.layout = radar_layout(radar_edges(list(self.scenes.values())))
        classes = np.unique(np.concatenate([one.axes["target_class"][one.counted] for one in self.scenes.values()]))
        known = [int(one) for one in classes if one >= 0]
        forms: dict[str, type[Effect]] = {"radar.interference": InterferenceForm}
        if known:
            forms["radar.wet_rcs"] = wet_rcs_form(known)
        else:
            self.catalogue.remove("radar.wet_rcs")
        self.forms: Mapping[str, type[Effect]] = forms
        self._sums = {name: RadarSums(scene, self.layout) for name, scene in self.scenes.items()}
        self.map_cells: list[tuple[float, float]] = []
        most = max((detection_count(detections_of(list(one.frames))).max() for one in self.fit), default=2)
        amplitudes = self._ghost_amplitudes()
        self.sizes: Mapping[str, float | Sequence[float]] = {"max_count": float(max(most, 2)), "amplitude": amplitudes}
        self.transforms: dict[str, RadarAttenuation] = {}
        self._drawn: dict[object, dict[str, Tensor]] = {}
        self._lock = threading.RLock()
        forms["radar.multipath"] = multipath_form(amplitudes[0])
        forms["radar.volume_clutter"] = volume_clutter_form(self._clutter_share())

    def _ghost_amplitudes(self) -> list[float]:
        """Amplitudes of a second path, from that whose ghost of the strongest target is detected."""
        margin_db = max(float(np.nanmax(scene.axes["margin_db"])) for scene in self.scenes.values())
        faintest = 10.0 ** (-0.05 * max(margin_db, 0.0))
        steps = math.ceil(math.log(1.0 / faintest) / math.log(GHOST_STEP))
        return [float(one) for one in np.geomspace(faintest, 1.0, steps + 2)[1:]]

    def _clutter_share(self) -> float:
        """Least share of the reflectivity of rain and snow with which some of it is detected in every frame of some
        condition; the catalogue's typical one where none does."""
        for share in CLUTTER_SHARES:
            effect = RadarVolumeClutter(share=share)
            for condition in self.fit:
                row = np.arange(CLUTTER_FRAMES) % self.clear_frames[condition.scene]
                with torch.no_grad():
                    frames = self._through(condition, row, row, [effect], 0.0, list(range(CLUTTER_FRAMES)))
                before = len(self._further(condition.scene, range(CLUTTER_FRAMES))[1])
                if len(frames.clutter) - before >= CLUTTER_COUNT * CLUTTER_FRAMES:
                    return share
        return RadarVolumeClutter.arguments[0].scale

    def _check(self) -> None:
        """Refuse a study whose conditions hold too few targets for any statistic of them."""
        most = 0
        for condition in self.fit:
            targets = int(self.scenes[condition.scene].counted.sum(1).max())
            most = max(most, targets * len(condition.frames))
        if self.fit and most < FEWEST_TARGETS:
            raise TorchweatherError(
                "find_gap: not enough data to decide: scenes[].clear: power_db: expected targets that most clear "
                f"frames have, {FEWEST_TARGETS:.0f} or more times the frames of a condition; got at most {most}. "
                "Record more frames, or a scene with more targets."
            )

    # ---- frames --------------------------------------------------------------------------------------------------

    def measured(self, condition: Condition) -> Reduced:
        """The condition's own frames."""
        frames = detections_of(list(condition.frames))
        # Compared with all clear frames but one, as simulated frames are.
        row = np.arange(len(frames)) % self.clear_frames[condition.scene]
        together = self._together(condition)
        return self.reduce(
            condition.scene, frames, row, self._loss_db(condition), _lever(len(frames)), together=together
        )

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """The clear frames of a scene, each compared with the others; ``portions`` as in ``reduce``."""
        frames = self.scenes[scene_id].clear
        none = np.zeros(frames.power_db.shape[1])
        return self.reduce(scene_id, frames, np.arange(len(frames)), none, _lever(len(frames)), portions)

    def _together(self, condition: Condition) -> int:
        """Frames over which a target's own mean is taken: as many as start from different clear frames."""
        return min(len(condition.frames), self.clear_frames[condition.scene])

    def transform(self, condition: Condition) -> RadarAttenuation:
        """The ready-made chain of a condition's weather."""
        if condition.id not in self.transforms:
            assert condition.weather is not None
            options = dict(self.options)
            if condition.ego_speed_m_per_s is not None:
                options.setdefault("ego_speed_m_per_s", condition.ego_speed_m_per_s)
            self.transforms[condition.id] = RadarAttenuation(condition.weather, self.sensor, **options)
        return self.transforms[condition.id]

    def _loss_db(self, condition: Condition) -> Floats:
        """Loss ``(N,)`` on the way to each target and back in the recorded weather."""
        per_km = float(self.transform(condition).attenuation_db_per_km)
        return 2e-3 * per_km * self.scenes[condition.scene].geometry["range_m"]

    def open(self, condition: Condition) -> dict[str, float]:
        """Names of what the model of a condition leaves open, with the least strength each can have."""
        return {"noise": 0.0}

    def misplaced(self, condition: Condition) -> float:
        """No particles that a model could misplace."""
        return 0.0

    def clear_noise(self, condition: Condition) -> None:
        """A simulated frame has the noise of its clear frame."""

    def left_open(self, condition: Condition) -> float:
        """Nothing beside how clear frames differ."""
        return 0.0

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Every weather is simulated as it is asked for."""

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """Stages of what is left open, at strengths in standard deviations; none at 0."""
        share = strengths.get("noise", 0.0)
        if share <= 0:
            return []
        clear = self.scenes[condition.scene].clear
        noise = ReceiverNoise(share=min(share, 16.0))
        errors = (torch.from_numpy(own_spread(values)) for values in (clear.range_m, clear.speed_m_per_s))
        return [noise.with_errors(*errors)]

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
            log_intensity: logarithm of the weather's intensity over its record.
            seeds: of the frames, the first one of the condition's first frame and so on; the same seeds give the same
                clear frames and random numbers for every effect.
            portions: as in ``reduce``.
        """
        struck = next((one for one in effects if isinstance(one, RadarInterference)), None)
        if struck is not None and struck.config()["probability"] < 1.0:
            others = [one for one in effects if one is not struck]
            always = RadarInterference(**{**struck.config(), "probability": 1.0})
            with_, without = (
                self.simulated(condition, some, log_intensity, seeds, portions) for some in ([*others, always], others)
            )
            floors = np.repeat(_struck(struck.config()["probability"], seeds), portions)
            share = self._struck_share(condition, struck.config()["level_db"])
            return self._mixed(with_, without, floors, np.repeat(_struck(share, seeds), portions), share)
        row = np.array([seed % self.clear_frames[condition.scene] for seed in seeds])
        place = np.arange(len(seeds)) % len(condition.frames)
        with torch.no_grad():
            frames = self._through(condition, row, place, effects, log_intensity, list(seeds))
        lever = _lever(len(condition.frames))[place]
        loss_db, together = self._loss_db(condition), self._together(condition)
        return self.reduce(condition.scene, frames, row, loss_db, lever, portions, together)

    def simulated_lists(
        self, condition: Condition, effects: Sequence[Effect], log_intensity: float, seeds: Sequence[int]
    ) -> Detections:
        """Simulated detections; arguments as ``simulated``."""
        row = np.array([seed % self.clear_frames[condition.scene] for seed in seeds])
        place = np.arange(len(seeds)) % len(condition.frames)
        with torch.no_grad():
            return self._through(condition, row, place, effects, log_intensity, list(seeds))

    def _through(
        self,
        condition: Condition,
        row: Whole,
        place: Whole,
        effects: Sequence[Effect],
        log_intensity: float,
        seeds: list[int],
    ) -> Detections:
        """Output of the chain for clear frames ``(F,)`` at their places in the recording ``(F,)``."""
        scene, transform = self.scenes[condition.scene], self.transform(condition)
        chain = with_effects(transform.chain, [*self.effects, *(one for one in effects if one.id in EFFECTS)])
        for one in effects:
            if one.id not in EFFECTS:  # of radar_nuisance.py
                chain = chain.insert(one, before="radar_detection")
        state = self._state(transform, scene, row, place)
        state = _with_further(state, *self._further(condition.scene, seeds))
        noise = {
            f"{name}.{variate}": drawn.to(state.returns.gain_db)
            for name in chain.stages
            for variate, drawn in self._noise(chain, name, condition, state, seeds).items()
        }
        # Conditions run side by side, and stages that are kept for all of them hold their share while they run.
        with self._lock, _intensity(chain, log_intensity):
            out: RadarState = chain(state, noise)
        return _detections(out)

    def _struck_share(self, condition: Condition, level_db: float) -> float:
        """Share of a condition's own frames whose floor is higher by about a level, or more.

        Floors are known so well that they say which frames were struck: what became of the targets is simulated for as
        many. Were it left to chance, an interferer that strikes seldom would explain any loss by its scatter.
        """
        if level_db <= 0:
            return 0.0
        scene = self.scenes[condition.scene]
        floor_db = np.array([float(np.asarray(frame["noise_floor_db"])) for frame in condition.frames])
        above = (floor_db - scene.clear.floor_db.mean()) / level_db
        return float(np.clip(2.0 * above - 0.5, 0.0, 1.0).mean())

    def _mixed(self, struck: Reduced, spared: Reduced, floors: Floats, scalars: Floats, share: float) -> Reduced:
        """Frames each a share of a struck one and the rest of one that is not, as sums: a frame that is struck by half
        moves every sum by half, so that a probability is felt by a few frames already.

        Args:
            struck, spared: the same frames.
            floors, scalars: ``(F,)`` share of each frame, of its floor and of its scalars.
            share: of all frames, of everything else.
        """
        of_floor = np.concatenate(
            [np.full(one.bins, one.statistic == "noise_floor_share") for one in self.layout.binned]
        )
        each = np.where(of_floor, floors[:, None], share)
        weight, value, square = (
            each * getattr(struck, name) + (1.0 - each) * getattr(spared, name)
            for name in ("weight", "value", "square")
        )
        scalar = scalars[:, None] * struck.scalar + (1.0 - scalars[:, None]) * spared.scalar
        return Reduced(weight, value, square, scalar, spared.maps)

    def _further(self, scene_id: str, seeds: Sequence[int]) -> tuple[Floats, Whole]:
        """Further detections ``(M, 5)`` in clear air and the frame of each: so many of those of all clear frames, drawn
        for each seed by Poisson's law, a little moved in range.

        A handful of clear frames knows where false alarms were, not how their number varies nor where else they can be.
        """
        rows = self.scenes[scene_id].clear.clutter
        rate = 1.0 / self.clear_frames[scene_id]
        parts = []
        for seed in seeds:
            drawn = np.random.default_rng([seed, 86028121])
            chosen = rows[np.repeat(np.arange(len(rows)), drawn.poisson(rate, len(rows)))].copy()
            chosen[:, 0] *= np.exp(FALSE_ALARM_MOVED * drawn.standard_normal(len(chosen)))
            parts.append(chosen)
        return np.concatenate(parts), np.repeat(np.arange(len(seeds)), [len(one) for one in parts])

    def _state(self, transform: RadarAttenuation, scene: RadarScene, row: Whole, place: Whole) -> RadarState:
        """Clear frames as the chain takes them; a target that a frame does not have is at the origin."""
        clear, known = scene.clear, scene.geometry
        seen = ~np.isnan(clear.power_db[row])
        towards = _towards(known["azimuth_rad"], known["elevation_rad"])
        points = np.zeros((*seen.shape, 6))
        points[..., :3] = np.where(seen, clear.range_m[row], 0.0)[..., None] * towards
        points[..., SPEED] = np.where(seen, clear.speed_m_per_s[row], 0.0)
        points[..., POWER] = np.where(seen, clear.power_db[row], clear.floor_db[row, None])
        state = transform.state_of(
            torch.from_numpy(points),
            target_class=torch.from_numpy(known["target_class"].astype(np.int64)),
            frame_number=torch.from_numpy(place),
        )
        return state.changed(noise_floor_db=torch.from_numpy(clear.floor_db[row]))

    def _noise(
        self, chain: Chain, name: str, condition: Condition, state: RadarState, seeds: list[int]
    ) -> dict[str, Tensor]:
        """Random numbers of a stage for the frames of some seeds, kept: they depend on its name alone."""
        stage = chain.stages[name]
        key = (condition.id, name, len(stage.variates()), tuple(seeds))
        drawn = self._drawn.get(key)
        if drawn is None:
            drawn = stage.draw(state, seed=torch.tensor(seeds), name=name)
            with self._lock:
                while len(self._drawn) >= DRAWN:
                    self._drawn.pop(next(iter(self._drawn)))
                self._drawn[key] = drawn
        return drawn

    def reduce(
        self,
        scene_id: str,
        frames: Detections,
        row: Whole,
        loss_db: Floats,
        lever: Floats,
        portions: int = 1,
        together: int = 0,
    ) -> Reduced:
        """Sums of frames of a scene; arguments as ``RadarSums``."""
        return self._sums[scene_id](frames, row, loss_db, lever, portions, together)


def _struck(probability: float, seeds: Sequence[int]) -> Floats:
    """Share ``(F,)`` of each frame that an interferer strikes, 0 or 1 but for one of them: of so many frames as many as
    the probability says, in an order that the seeds draw."""
    drawn = np.array([np.random.default_rng([seed, 49979687]).random() for seed in seeds])
    order = drawn.argsort().argsort()
    return np.asarray(np.clip(probability * len(seeds) - order, 0.0, 1.0), dtype=np.float64)


def _lever(frames: int) -> Floats:
    """Place of each frame in a recording, of mean 0 and mean square 1 over it; 0 of so few that none has a slope."""
    if frames < FEWEST_FOR_SLOPE:
        return np.zeros(frames)
    place: Floats = np.arange(frames, dtype=np.float64) - 0.5 * (frames - 1)
    found: Floats = place / max(math.sqrt(float((place**2).mean())), 1e-9)
    return found


def _towards(azimuth_rad: Floats, elevation_rad: Floats) -> Floats:
    """Unit vectors ``(..., 3)``."""
    flat = np.cos(elevation_rad)
    found: Floats = np.stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)], -1)
    return found


def _with_further(state: RadarState, further: Floats, frame: Whole) -> RadarState:
    """A state with further detections ``(M, 5)`` of its frames, which a list that is full may drop."""
    if not len(further):
        return state
    place = np.arange(len(frame)) - np.searchsorted(frame, frame)  # of each within its frame
    rows = np.zeros((state.batch, int(place.max()) + 1, 6))
    rows[frame, place, :3] = further[:, :1] * _towards(further[:, 1], further[:, 2])
    rows[frame, place, SPEED], rows[frame, place, POWER] = further[:, 3], further[:, 4]
    there = np.zeros(rows.shape[:2], dtype=bool)
    there[frame, place] = True
    return state.changed(clutter=torch.from_numpy(rows), clutter_valid=torch.from_numpy(there))


def _detections(out: RadarState) -> Detections:
    """The list that comes out of a chain."""
    assert out.returns.points is not None
    count = out.scene.points_in.shape[1]
    points, there = out.returns.points.numpy().astype(np.float64), (out.returns.kind != LOST).numpy()
    range_m = np.sqrt((points[..., :3] ** 2).sum(-1))

    def of_targets(values: Floats) -> Floats:
        return np.where(there[:, :count], values[:, :count], np.nan)

    frame, place = there[:, count:].nonzero()
    rows = points[frame, count + place]
    own = range_m[frame, count + place]
    azimuth = np.arctan2(rows[:, 1], rows[:, 0])
    elevation = np.arcsin(np.clip(rows[:, 2] / np.maximum(own, 1e-9), -1.0, 1.0))
    made = np.stack([own, azimuth, elevation, rows[:, SPEED], rows[:, POWER]], 1)
    return Detections(
        of_targets(points[..., POWER]),
        of_targets(range_m),
        of_targets(points[..., SPEED]),
        out.floor_db.numpy().astype(np.float64),
        made,
        frame,
    )


@contextmanager
def _intensity(chain: Chain, log_intensity: float) -> Iterator[None]:
    """The weather's intensity times ``exp(log_intensity)`` in all stages of a chain, while the block lasts."""
    changed: list[tuple[torch.nn.Module, str, Tensor]] = []
    for stage in chain.stages.values():
        if isinstance(stage, PathAttenuation):
            for part in stage.parts.values():
                name = str(part.weather.intensity_name)  # type: ignore[union-attr]
                changed.append((part, name, getattr(part, name)))
        elif isinstance(stage, VolumeClutter):
            changed.append((stage.falling, "rate_mm_per_h", stage.falling.rate_mm_per_h))
        elif isinstance(stage, WetRadome):
            changed.append((stage, "rate_mm_per_h", stage.rate_mm_per_h))
    try:
        for owner, name, before in changed:
            setattr(owner, name, before * math.exp(log_intensity))
        yield
    finally:
        for owner, name, before in changed:
            setattr(owner, name, before)
