"""Camera frames for the gap workflow: the conditions of a study simulated, and frames reduced to statistics.

What is looked at is in ``camera_scene.py`` (what frames are compared with) and ``camera_sums.py`` (what is summed up
along which axes). A simulated frame starts from a clear frame of its scene that its seed chooses: the mean of the
others goes through the weather and the optics, and its own noise is added behind them, grown with the light. Particles
are rendered once for each seed, at a few rates, and taken between them: what happens behind or in front of them does
not move them.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.airlight import towards_horizon
from torchweather.camera.bayer import cfa_colour_index
from torchweather.camera.effects.all import EFFECTS
from torchweather.camera.fog import ExtinctionAndAirlight
from torchweather.camera.particles.veil import REFLECTED_SHARE, ParticleVeil
from torchweather.camera.rays import rays_of
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.camera.transform import BayerWeather
from torchweather.core.random import keyed_stream
from torchweather.gap.inference.effect_forms import counted_form, searched_effects
from torchweather.gap.inference.simulated_distribution import ClearNoise
from torchweather.gap.sensors.camera.clear_noise import camera_clear_noise
from torchweather.gap.sensors.camera.particles import LEAST_STEP, MOST_STEP, Rendered
from torchweather.gap.sensors.camera.scene import COLOURS, CameraScene, camera_scene, cell_colours
from torchweather.gap.sensors.camera.scene_change import refuse_changed
from torchweather.gap.sensors.camera.sums import CameraSums, camera_layout, colours_of
from torchweather.gap.sensors.camera.systematics import AirlightError, ParticleContrast
from torchweather.gap.statistics.frame_statistics import Reduced
from torchweather.gap.study.study import Condition, Study
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import Effect, with_effects
from torchweather.pipeline.stage import Stage

__all__ = ["CameraFrames"]

CONTRAST_SD = 0.01  # relative, of how much particles stand out; what two implementations of one physics differ by
DROP_LIGHT_SD = 0.01  # relative, of each colour of drops: they show more of the surroundings than the frame does
# Of the scatter of the sky's light from place to place, by which the airlight may be off; order of magnitude.
UNEVEN_SHARE = 0.25
LEAST_UNEVEN = 0.2  # of the noise's variance, below which a sky is even
# Of the signal, that one pixel in a thousand exceeds: frames saturate near it, if they do. Levels that are tried.
HIGHEST = 0.999
LEVELS = (1.0, 0.985, 0.97, 0.955, 0.93, 0.9, 0.8, 0.6, 0.3)
TOGETHER = 6  # frames: those of a response; particles of several are rendered faster
KEPT_FRAMES = 6000  # reduced ones
FARTHEST_SD = 5.0  # standard deviations of the record for which, and for a step of rates more, a draw has slots
# Stages in front of the first of which the noise of the clear frame comes in; the last of them is in every chain.
BEHIND_THE_NOISE = ("sensor_noise", "saturation", "tone_curve", "quantise")
OF_THE_CONDITION = "adherent_drops"  # stages whose draw is one for all frames of a condition


class CameraFrames:
    """Simulates frames of a study's conditions and reduces frames to statistics.

    Args:
        study: of kind ``camera``.
        options: of ``BayerWeather`` (the model under test).
        effects: that the model has already.
        named: ids of effects that are searched for although the catalogue leaves them out.

    Raises:
        TorchweatherError: a scene has a single clear frame, or is another one in weather.
    """

    each_frame_alone: ClassVar[bool] = True

    def __init__(
        self,
        study: Study,
        options: Mapping[str, Any] | None = None,
        effects: Sequence[Effect] = (),
        named: Sequence[str] = (),
    ) -> None:
        sensor = study.sensor_as(Camera)
        self.options, self.effects = dict(options or {}), list(effects)
        self.fit, self.holdout = (
            [one for one in split if one.weather is not None] for split in (study.fit, study.holdout)
        )
        self.clear_frames = {name: len(scene.clear) for name, scene in study.scenes.items()}
        self.sensor = replace(sensor, response_knots=None)  # the frames of a study are linear already
        pattern = self.sensor.bayer_pattern
        colours = colours_of(cfa_colour_index(pattern))
        self.scenes: dict[str, CameraScene] = {
            name: camera_scene(scene, self.sensor) for name, scene in study.scenes.items()
        }
        with_normals = all(scene.normal is not None for scene in self.scenes.values())
        self.catalogue = [
            name for name in searched_effects("camera", named) if with_normals or "normal" not in EFFECTS[name].needs
        ]
        # A line along a diagonal blurs nearly as a disk does; with two numbers it always explains a little more.
        self.forms = {name: counted_form(EFFECTS[name]) for name in self.catalogue if len(EFFECTS[name].arguments) > 1}
        self.as_record: AbstractSet[str] = frozenset()
        self.open_shifts: AbstractSet[str] = frozenset()
        self.map_cells: list[tuple[float, float]] = []
        # Of the conditions that are fitted to: those held out tell nothing before the end.
        highest = max((float(np.quantile(one.frames[0]["bayer"], HIGHEST)) for one in self.fit), default=1.0)
        self.sizes: Mapping[str, float | Sequence[float]] = {"level": tuple(share * highest for share in LEVELS)}
        self.layout = camera_layout(next(iter(self.scenes.values())), colours)
        self._pattern, self._colours = pattern, colours
        self.transforms: dict[str, BayerWeather] = {}
        self._sums: dict[str, CameraSums] = {}
        self._clear_sums = {
            name: CameraSums(scene, self.layout, pattern, colours, scene.reference)
            for name, scene in self.scenes.items()
        }
        self._airlight = {name: self._sky(scene) for name, scene in self.scenes.items()}
        self._rendered: dict[str, Rendered] = {}
        self._kept: OrderedDict[object, Reduced] = OrderedDict()
        self._lock = threading.Lock()
        for name in self.scenes:
            self._refuse_changed(name, study.scenes[name].geometry.get("mask"))

    # ---- frames --------------------------------------------------------------------------------------------------

    def measured(self, condition: Condition) -> Reduced:
        """The condition's own frames."""
        bayer = _frames(condition)
        # Compared with all clear frames but one, as simulated frames are.
        row = torch.arange(len(bayer)) % len(self.scenes[condition.scene].clear)
        return self._of(condition)(bayer, row)

    def clear(self, scene_id: str, portions: int = 1) -> Reduced:
        """The clear frames of a scene, each compared with the others; ``portions`` as in ``CameraSums``."""
        clear = self.scenes[scene_id].clear
        return self._clear_sums[scene_id](clear, torch.arange(len(clear)), portions)

    def transform(self, condition: Condition) -> BayerWeather:
        """The ready-made chain of a condition's weather."""
        with self._lock:
            if condition.id not in self.transforms:
                weather, options = condition.weather, dict(self.options)
                assert weather is not None
                if len(weather.parts) == 1 and weather.kind != "fog":
                    farthest = FARTHEST_SD * max(condition.rel_sd, LEAST_STEP) + MOST_STEP
                    options.setdefault("rate_capacity_mm_per_h", float(weather.intensity) * math.exp(farthest))
                options.setdefault("ego_speed_m_per_s", condition.ego_speed_m_per_s or 0.0)
                camera = self.sensor
                if condition.exposure_s is not None:
                    camera = replace(camera, exposure_s=condition.exposure_s)
                airlight, _ = self._airlight[condition.scene]
                if condition.airlight is not None:
                    options["airlight"] = condition.airlight
                elif airlight is not None:  # of all clear frames, which knows it better than one
                    gain = _gain(condition)
                    options.setdefault("airlight", tuple(min(gain * colour, 1.0) for colour in airlight))
                self.transforms[condition.id] = BayerWeather(weather, camera, **options)
            return self.transforms[condition.id]

    def open(self, condition: Condition) -> dict[str, float]:
        """Names of what the model of a condition leaves open, with the least strength each can have."""
        assert condition.weather is not None
        found = {f"airlight {colour} {condition.scene}": -math.inf for colour in self._airlight_sd(condition)}
        if any(part.kind != "fog" for part in condition.weather.parts):
            found["particle contrast"] = -math.inf
        return found

    def _airlight_sd(self, condition: Condition) -> dict[str, float]:
        """Relative standard deviation of the airlight by colour: in fog of a noisy sky, in rain as drops show it."""
        airlight, sky_sd = self._airlight[condition.scene]
        if condition.airlight is not None:  # measured: nothing of it is open but what drops show
            airlight, sky_sd = condition.airlight, {}
        assert condition.weather is not None
        kinds = {part.kind for part in condition.weather.parts}
        if "fog" in kinds:
            return sky_sd if "airlight" not in self.options else {}
        if "rain" not in kinds:
            return {}
        mean = self._mean_light(self.scenes[condition.scene])
        if condition.airlight is not None:  # at the exposure of its own frames
            mean = {colour: _gain(condition) * light for colour, light in mean.items()}
        sky = mean if airlight is None else dict(zip(COLOURS, airlight, strict=True))
        return {
            colour: DROP_LIGHT_SD * mean[colour] / (REFLECTED_SHARE * sky[colour])
            for colour in self._colours
            if sky[colour] > 0 and mean[colour] > 0
        }

    def misplaced(self, condition: Condition) -> float:
        """No statistic has particles along their own range."""
        return 0.0

    def left_open(self, condition: Condition) -> float:
        """Nothing beside how clear frames differ."""
        return 0.0

    def clear_noise(self, condition: Condition) -> ClearNoise:
        """Noise of the clear frames in frames of a condition, as the model without effects has it."""
        scene = self.scenes[condition.scene]
        with torch.no_grad():
            chain, row = self._chain(condition, ()), torch.zeros(1, dtype=torch.long)
            state, _ = self._to_the_noise(chain, condition, row, 0.0, [0])
        covered = _covered(state)
        return camera_clear_noise(scene, self._of(condition), state.image.signal, _left(state, condition), covered)

    def render_near(self, condition: Condition, log_intensity: float) -> None:
        """Render particles at this rate, and at those about it."""
        with self._lock:
            if condition.id in self._rendered:
                self._rendered[condition.id].log_rate = log_intensity

    def systematics(self, condition: Condition, strengths: Mapping[str, float]) -> list[Effect]:
        """Stages of what is left open, at strengths in standard deviations; none at 0."""
        given = {name: strengths.get(name, 0.0) for name in self.open(condition)}
        found: list[Effect] = []
        contrast = given.get("particle contrast", 0.0) * CONTRAST_SD
        if contrast != 0:
            found.append(ParticleContrast(share=min(max(contrast, -0.9), 4.0)))
        light = {
            colour: min(max(given[f"airlight {colour} {condition.scene}"] * sd, -0.9), 4.0)
            for colour, sd in self._airlight_sd(condition).items()
        }
        if any(value != 0 for value in light.values()):
            found.append(AirlightError(**light))
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
            log_intensity: logarithm of the weather's intensity over its record.
            seeds: of the frames; the same seeds give the same clear frames and random numbers for every effect.
            portions: as in ``CameraSums``.
        """
        chain = self._chain(condition, effects)
        clear = len(self.scenes[condition.scene].clear)
        # Without randomness all seeds of one clear frame give one frame.
        random = any(stage.variates() for name, stage in chain.stages.items() if name != OF_THE_CONDITION)
        wanted = list(seeds) if random else [seed % clear for seed in seeds]
        key = (condition.id, str([effect.to_dict() for effect in effects]), float(log_intensity), portions)
        found: dict[int, Reduced] = {}
        for seed in dict.fromkeys(wanted):
            kept = self._recall((key, seed))
            if kept is not None:
                found[seed] = kept
        missing = [seed for seed in dict.fromkeys(wanted) if seed not in found]
        for first in range(0, len(missing), TOGETHER):
            some = missing[first : first + TOGETHER]
            row = torch.tensor([seed % clear for seed in some])
            with torch.no_grad():
                bayer = self._through(chain, condition, row, log_intensity, some)
            reduced = self._of(condition)(bayer, row, portions)
            for number, seed in enumerate(some):
                own = slice(number * portions, (number + 1) * portions)
                names = ("weight", "value", "square", "scalar", "maps")
                found[seed] = Reduced(*(getattr(reduced, name)[own] for name in names))
                if portions == 1:
                    self._keep((key, seed), found[seed])
        return Reduced.joined([found[seed] for seed in wanted])

    def simulated_pictures(
        self, condition: Condition, effects: Sequence[Effect], log_intensity: float, seeds: Sequence[int]
    ) -> Tensor:
        """Simulated mosaics ``(F, H, W)``; arguments as ``simulated``."""
        clear, chain = len(self.scenes[condition.scene].clear), self._chain(condition, effects)
        parts = []
        for first in range(0, len(seeds), TOGETHER):
            some = list(seeds[first : first + TOGETHER])
            row = torch.tensor([seed % clear for seed in some])
            with torch.no_grad():
                parts.append(self._through(chain, condition, row, log_intensity, some)[:, 0])
        return torch.cat(parts)

    def _refuse_changed(self, scene_id: str, mask: Any) -> None:
        """Raise where the scene is another one in weather, outside of its mask (``scene_change.py``)."""
        scene = self.scenes[scene_id]
        own = [one for one in (*self.fit, *self.holdout) if one.scene == scene_id]
        measured = {one.id: self._of(one).mean_level(_frames(one)) for one in own}
        modelled = {one.id: self._of(one).modelled_level for one in own}
        level = None if scene.normal is None else scene.level_ground
        refuse_changed(scene_id, measured, modelled, level, None if mask is None else torch.from_numpy(mask != 0))

    # ---- the chain -----------------------------------------------------------------------------------------------

    def _of(self, condition: Condition) -> CameraSums:
        """Function that reduces frames of a condition."""
        found = self._sums.get(condition.id)
        if found is None:
            scene, transform = self.scenes[condition.scene], self.transform(condition)
            fog = {
                name: stage
                for name, stage in transform.chain.stages.items()
                if isinstance(stage, ExtinctionAndAirlight)
            }
            with torch.no_grad():
                reference = _lit(scene.reference, condition)
                state = transform.state_of(reference, scene.depth_m[None])
                modelled = Chain(fog)(state, {}).image.signal if fog else reference
            edges = self._clear_sums[condition.scene].edges
            found = CameraSums(scene, self.layout, self._pattern, self._colours, modelled, edges)
            with self._lock:
                self._sums[condition.id] = found
        return found

    def _sky(self, scene: CameraScene) -> tuple[tuple[float, float, float] | None, dict[str, float]]:
        """Airlight per colour, from the sky of all clear frames, and the relative error of each by their noise."""
        if not bool(scene.depth_m.isinf().any()):
            return None, {}
        sky = torch.isinf(scene.depth_m[0])
        cells = sky[0::2, 0::2] & sky[0::2, 1::2] & sky[1::2, 0::2] & sky[1::2, 1::2]
        if not bool(cells.any()):
            return None, {}
        place = cell_colours(scene.clear, self._pattern)[:, :, cells].double()  # (K, C, cells)
        weight = self._towards_horizon(sky, cells)
        found = (place * weight).sum(2)  # (K, C)
        each = torch.zeros(len(found), len(COLOURS), dtype=torch.float64)
        each[:, [COLOURS.index(colour) for colour in self._colours]] = found
        mean = each.mean(0)
        # Which part of an uneven sky lights the air is not known.
        uneven = torch.zeros(len(COLOURS), dtype=torch.float64)
        pixels = (place.var(0) * weight).sum(1) / len(each)  # noise of the mean frame
        apart = (place.mean(0) - found.mean(0)[:, None]).square()
        uneven[[COLOURS.index(colour) for colour in self._colours]] = ((apart * weight).sum(1) - pixels).clamp_min(0.0)
        square = each.var(0) / len(each) + UNEVEN_SHARE**2 * uneven.where(uneven > LEAST_UNEVEN * pixels.max(), 0.0)
        error = square.sqrt() / mean.clamp_min(1e-6)
        red, green, blue = mean.clamp(0.0, 1.0).tolist()
        known = {colour: float(error[COLOURS.index(colour)]) for colour in self._colours}
        return (red, green, blue), {colour: sd for colour, sd in known.items() if sd > 0}

    def _towards_horizon(self, sky: Tensor, cells: Tensor) -> Tensor:
        """Weight of each cell of sky for the airlight, as the model's own estimate has it; they sum to 1."""
        height, width = sky.shape
        x, y, _ = self.sensor.ray_directions(height, width, dtype=torch.float64)
        sine = rays_of(self.sensor, x, y).sine_elevation[0, 0, 0::2, 0::2]
        weight = towards_horizon(cells[None].double(), sine[None])[0][cells]
        return weight / weight.sum()

    def _mean_light(self, scene: CameraScene) -> dict[str, float]:
        """Of each colour, over the clear frames."""
        mean = cell_colours(scene.reference[-1:], self._pattern).mean((0, 2, 3)).tolist()
        return dict(zip(self._colours, mean, strict=True))

    def _chain(self, condition: Condition, effects: Sequence[Effect]) -> Chain:
        """The chain of a condition with effects, those of the catalogue and those of ``camera_nuisance.py``."""
        catalogue = [one for one in effects if one.id in EFFECTS]
        chain = with_effects(self.transform(condition).chain, [*self.effects, *catalogue])
        for one in effects:
            if one.id not in EFFECTS:  # of camera_nuisance.py
                chain = chain.insert(one, before=next(iter(chain.stages)))
        return chain

    def _through(
        self, chain: Chain, condition: Condition, row: Tensor, log_intensity: float, seeds: list[int]
    ) -> Tensor:
        """Frames ``(F, 1, H, W)`` that come out of a chain."""
        state, behind = self._to_the_noise(chain, condition, row, log_intensity, seeds)
        scene = self.scenes[condition.scene]
        light = scene.with_noise(state.image.signal, _left(state, condition), _covered(state), row)
        state = state.changed(signal=light)
        for name in behind:
            state = self._passed(name, chain.stages[name], condition, state, log_intensity, seeds)
        return state.image.signal

    def _to_the_noise(
        self, chain: Chain, condition: Condition, row: Tensor, log_intensity: float, seeds: list[int]
    ) -> tuple[CameraState, list[str]]:
        """The state where a frame's noise arises, and the names of the stages behind that."""
        scene = self.scenes[condition.scene]
        normal = None if scene.normal is None else scene.normal[None]
        # Light comes without noise: that of the frame is added where it arises, as large as the light there makes it.
        reference = _lit(scene.reference[row], condition)
        state = self.transform(condition).state_of(reference, scene.depth_m[None], normal)
        state, names = state.changed(keep_truth=True), list(chain.stages)
        first = min(names.index(name) for name in BEHIND_THE_NOISE if name in names)
        for name in names[:first]:
            state = self._passed(name, chain.stages[name], condition, state, log_intensity, seeds)
        return state, names[first:]

    def _passed(
        self, name: str, stage: Stage, condition: Condition, state: CameraState, log_intensity: float, seeds: list[int]
    ) -> CameraState:
        """The state behind a stage."""
        if isinstance(stage, ParticleVeil):
            return self._veiled(stage, condition, state, log_intensity, seeds)
        with_intensity = isinstance(stage, ExtinctionAndAirlight) and log_intensity != 0
        found = _at_visibility(stage, math.exp(log_intensity)) if with_intensity else stage
        behind: CameraState = found(state, self._noise(stage, name, condition, state, seeds))
        return behind

    def _noise(
        self, stage: Stage, name: str, condition: Condition, state: CameraState, seeds: list[int]
    ) -> dict[str, Tensor]:
        """Random numbers of a stage for the frames of some seeds."""
        if not stage.variates():
            return {}
        if name == OF_THE_CONDITION:
            seeds = [int(keyed_stream(0, f"gap.{name}.{condition.id}").integers(2**62))] * len(seeds)
        return stage.draw(state, seed=torch.tensor(seeds), name=name)

    def _veiled(
        self, stage: ParticleVeil, condition: Condition, state: CameraState, log_intensity: float, seeds: list[int]
    ) -> CameraState:
        """The state behind its particles."""
        with self._lock:
            if condition.id not in self._rendered:
                self._rendered[condition.id] = Rendered(stage, condition)
        return self._rendered[condition.id](state, log_intensity, seeds)

    def _recall(self, key: object) -> Reduced | None:
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
            return found

    def _keep(self, key: object, reduced: Reduced) -> None:
        with self._lock:
            self._kept[key] = reduced
            while len(self._kept) > KEPT_FRAMES:
                self._kept.popitem(last=False)


def _frames(condition: Condition) -> Tensor:
    """Frames of a condition ``(F, 1, H, W)``."""
    frames = [condition.frames[number]["bayer"] for number in range(len(condition.frames))]
    return torch.stack([torch.from_numpy(np.array(frame, dtype=np.float32)) for frame in frames])[:, None]


def _gain(condition: Condition) -> float:
    """Signal of a condition's frames over that of clear frames for the same light; 1 where it is not stated."""
    return 1.0 if condition.exposure_gain is None else condition.exposure_gain


def _lit(clear: Tensor, condition: Condition) -> Tensor:
    """Clear frames at the exposure of a condition."""
    gain = _gain(condition)
    return clear if gain == 1 else (gain * clear).clamp_max(1.0)


def _left(state: CameraState, condition: Condition) -> Tensor | None:
    """Share of a clear frame's signal that the medium leaves, at the exposure of a condition; ``None`` is 1."""
    left, gain = state.image.transmission, _gain(condition)
    if gain == 1:
        return left
    return torch.full_like(state.image.signal, gain) if left is None else gain * left


def _covered(state: CameraState) -> Tensor | None:
    """Share of the exposure in which particles hide what is behind them, ``(F, 1, H, W)``."""
    mask, contrast = state.image.particle_mask, state.air.particle_contrast
    return mask if mask is None or contrast is None else (mask * contrast.view(-1, 1, 1, 1)).clamp(0.0, 1.0)


def _at_visibility(stage: Stage, factor: float) -> ExtinctionAndAirlight:
    """A fog of another visibility."""
    assert isinstance(stage, ExtinctionAndAirlight)
    found = ExtinctionAndAirlight.__new__(ExtinctionAndAirlight)
    torch.nn.Module.__init__(found)
    found.__dict__.update(stage.__dict__)
    found._buffers = {**stage._buffers, "mor_m": stage.mor_m * factor}
    return found
