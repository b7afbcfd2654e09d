"""BayerRain, BayerFog, BayerSnow: weather on the raw mosaic of a camera."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.density_field import PatchyAir, patchy_air
from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.airlight import airlight_argument, given_or_estimated, scaled_airlight
from torchweather.camera.bayer import cfa_colour_index
from torchweather.camera.conditions import camera_conditions
from torchweather.camera.depth import EXACT, SceneDepth, as_depth_source, check_depth, scene_of
from torchweather.camera.depth.source import warn_of_depth
from torchweather.camera.exposure import ExposureControl, as_exposure_control
from torchweather.camera.fog import ExtinctionAndAirlight, Quantise
from torchweather.camera.levels import check_bayer, raw_from_linear, raw_to_linear
from torchweather.camera.night.lamps import Night, as_night
from torchweather.camera.night.stages import LampVeil, NightLamps, OwnLight
from torchweather.camera.options import RENAMED, CameraOptions
from torchweather.camera.overcast_sky import OvercastSky
from torchweather.camera.particles.bank import DrawBank
from torchweather.camera.particles.bank_veil import EXACT_QUALITY, BankVeil, checked_quality
from torchweather.camera.particles.veil import ParticleVeil
from torchweather.camera.rays import Rays, kept_rays, rays_of_frame
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_one_of, check_positive
from torchweather.core.moved import renamed_arguments
from torchweather.core.precision import outside_autocast
from torchweather.core.random import sample_seeds, sizes_of
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.conditions import with_conditions
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.sensor_transform import Sizes, WeatherTransform
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["BayerFog", "BayerRain", "BayerSnow", "BayerWeather", "CameraResult"]

VARIANTS = ("d3_4",)
SKIES = ("overcast",)


@dataclass(frozen=True)
class CameraResult:
    """Effect of the weather on a frame.

    Args:
        bayer: ``(..., 1, H, W)`` the frame, in the dtype of the input.
        transmission: ``(..., 1, H, W)`` share of the scene's light that fog lets through; 1 without fog.
        airlight: ``(..., 3)`` linear signal of the sky that was used (red, green or clear, blue).
        particle_mask: ``(..., 1, H, W)`` share of the exposure in which particles cover the pixel.
        depth_confidence: how sure the depth is: ``exact``, ``measured``, ``completed`` or ``guessed``.
    """

    bayer: Tensor
    transmission: Tensor
    airlight: Tensor
    particle_mask: Tensor
    depth_confidence: str = EXACT

    sensor: ClassVar[str] = "camera"


class BayerWeather(WeatherTransform):
    """Any weather on a raw Bayer frame: rain, fog, snow or a ``Mixture``.

    Args:
        weather: what falls, and water or snow on things (``torchweather.atmosphere.conditions``); its intensity may be
            a tensor of the batch shape. ``None``: that of the ``Compose`` around it.
        camera: the camera that took the frame.
        depth: depth of the scene where the call gives none: a number of metres, a map, a depth source such as
            ``FlatGround()``, or a function of the image.
        airlight: linear signal of the sky (red, green, blue), saturation 1; ``sky`` or ``grey`` takes colour or
            luminance of the frame's sky above the horizon; ``None`` is ``sky``, and ``grey`` for RGB images. A
            mapping holds the arguments of ``torchweather.image.airlight_from_luminance``.
        layer_top_m: height of the fog's top above the ground, metres; above it the sky shows through. Default: 200 m,
            the top of deep radiation fog; infinity is fog without end.
        sky: ``overcast`` puts the grey of an overcast sky behind rain and snow, where the frame shows sky; sunlight and
            cast shadows stay. ``None`` keeps the frame's.
        night: ``True`` or a ``Night``: the frame was taken at night, and lamps light fog and particles and glow;
            ``None`` is day.
        exposure_control: ``mean`` or ``median`` gives the frame in weather the mean or median signal of the clear one,
            as cameras do; or an ``ExposureControl`` with window, target and limits. ``None`` keeps the exposure.
        extinction: of fog: ``mie`` or ``koschmieder``.
        scattering: of fog: ``single``, or ``multiple`` for dense fog (visibility below 50 m), where the light that
            droplets scatter onward matters: it blurs what is seen and keeps large shapes visible farther.
        near_m, far_m: limits of falling particles along the optical axis.
        min_listed_coverage: peak coverage of a pixel above which a particle is drawn one by one, 1e-6 to 1; the others
            enter through their moments.
        max_listed_density: particles per pixel and e-fold of depth up to which they are drawn one by one.
        ego_speed_m_per_s: speed of the vehicle, forward.
        drop_radiance: what a drop shows: the mean of the ``frame`` or of its ``upper`` three fifths.
        rate_capacity_mm_per_h: highest rate that one draw serves.
        variant: ``d3_4`` computes what the deliverable published (``PHYSICS.md`` 8) where that differs.
        quality: ``exact``, or ``training``: rain and snow are composed from a `DrawBank` of rendered storms, at a
            fraction of the time and with the same statistics; or the bank itself. Fog has one quality.
        effects: of ``stages.EFFECTS`` for cameras, or their dictionaries; each goes to its place in the chain.
        p: probability that a sample gets the weather; the others come back as they are.

    What is not known may be a distribution, drawn for each sample: ``airlight`` (one, or one for each colour),
    ``layer_top_m``, ``ego_speed_m_per_s``, ``sky``, ``exposure_control``, ``extinction``, ``scattering``,
    ``drop_radiance``, a depth in metres, parameters of effects, and exposure time, aperture and focus of the camera.
    ``docs/how-to/draw-what-is-not-known.md`` gives ranges and what they cost.

    Note:
        Day and sky light only. Without ``scattering="multiple"`` light is scattered once: fog of a visibility below
        50 m then hides more than it should and blurs nothing.

    Example:
        >>> from torchweather.atmosphere.weather import Mixture
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> sleet_in_fog = BayerWeather(Mixture(Fog(mor_m=200), Snow(1.0)), camera, depth=30.0, airlight=0.7)
        >>> sleet_in_fog(torch.full((1, 24, 32), 0.2)).shape
        torch.Size([1, 24, 32])
    """

    takes_all: ClassVar[str] = "BayerWeather"
    sensor_class: ClassVar[type[Camera]] = Camera
    extra_inputs: ClassVar[Mapping[str, int]] = {"depth": 3, "normal": 3}
    data_shape = ("1", "H", "W")

    @renamed_arguments(**RENAMED)
    def __init__(
        self,
        weather: Weather | None,
        camera: Camera,
        *,
        depth: object = None,
        airlight: Sequence[float | Distribution] | float | str | Mapping[str, float] | Distribution | None = None,
        layer_top_m: float | Distribution = 200.0,
        sky: str | Distribution | None = None,
        night: Night | Mapping[str, Any] | bool | None = None,
        exposure_control: str | ExposureControl | Mapping[str, Any] | Distribution | None = None,
        extinction: str | Distribution = "mie",
        scattering: str | Distribution = "single",
        near_m: float = 0.5,
        far_m: float = 200.0,
        min_listed_coverage: float = 1 / 1024,
        max_listed_density: float = 0.25,
        ego_speed_m_per_s: float | Distribution = 0.0,
        drop_radiance: str | Distribution = "frame",
        rate_capacity_mm_per_h: float | None = None,
        variant: str | None = None,
        quality: str | DrawBank = EXACT_QUALITY,
        effects: Sequence[Effect | Mapping[str, Any]] = (),
        p: float = 1.0,
    ) -> None:
        super().__init__()
        values: dict[str, Any] = {
            "depth": depth,
            "airlight": airlight,
            "layer_top_m": layer_top_m,
            "sky": sky,
            "night": night,
            "exposure_control": exposure_control,
            "extinction": extinction,
            "scattering": scattering,
            "near_m": near_m,
            "far_m": far_m,
            "min_listed_coverage": min_listed_coverage,
            "max_listed_density": max_listed_density,
            "ego_speed_m_per_s": ego_speed_m_per_s,
            "drop_radiance": drop_radiance,
            "rate_capacity_mm_per_h": rate_capacity_mm_per_h,
            "variant": variant,
            "quality": quality,
            "effects": effects,
            "p": p,
        }
        at, camera = self._fixed(weather, CameraOptions(**values), camera)
        check_arguments(
            "BayerWeather(airlight: Sequence[float] | float | str | Mapping | None, layer_top_m: float, "
            "sky: str | None, extinction: str, scattering: str, near_m: float, far_m: float, "
            "min_listed_coverage: float, max_listed_density: float, ego_speed_m_per_s: float, drop_radiance: str, "
            "rate_capacity_mm_per_h: float | None, variant: str | None, p: float)",
            at.airlight,
            at.layer_top_m,
            at.sky,
            at.extinction,
            at.scattering,
            at.near_m,
            at.far_m,
            at.min_listed_coverage,
            at.max_listed_density,
            at.ego_speed_m_per_s,
            at.drop_radiance,
            at.rate_capacity_mm_per_h,
            at.variant,
            at.p,
        )
        self.quality = checked_quality(at.quality, "BayerWeather")
        weather = self._check_weather(weather)
        self._check_p(at.p)
        Camera.check(camera, "camera", "lucid-triton", owner=self)
        if at.variant is not None:
            check_one_of("variant", at.variant, VARIANTS, owner=self)
        if at.sky is not None:
            check_one_of("sky", at.sky, SKIES, owner=self)
        light = airlight_argument(at.airlight, owner=self)
        check_at_least(
            "layer_top_m", at.layer_top_m, camera.height_m, unit="m", owner=self, advice="It must be above the camera."
        )
        self.weather, self.camera, self.layer_top_m = weather, camera, float(at.layer_top_m)
        weather = weather.densest()
        self.depth_source = None if at.depth is None else as_depth_source(at.depth)
        self.airlight = light
        stages: dict[str, Stage] = patchy_air(weather, at.ego_speed_m_per_s)
        fogs = [part for part in weather.parts if isinstance(part, Fog)]
        falling = [part for part in weather.parts if isinstance(part, (Rain, Snow))]
        if falling and at.sky is not None:
            stages["overcast_sky"] = OvercastSky(falling, light)
        if fogs:
            stages["extinction_and_airlight"] = ExtinctionAndAirlight(
                fogs[0], tuple(camera.bands.values()), light, at.extinction, at.variant, at.scattering
            )
        if falling:
            kind = ParticleVeil if quality == EXACT_QUALITY else BankVeil.of(self.weather, self.nuisances, quality)
            stages["particle_veil"] = kind(
                falling,
                camera,
                near_m=at.near_m,
                far_m=at.far_m,
                min_listed_coverage=at.min_listed_coverage,
                max_listed_density=at.max_listed_density,
                ego_speed_m_per_s=at.ego_speed_m_per_s,
                ambient=light,
                drop_radiance=at.drop_radiance,
                rate_capacity_mm_per_h=at.rate_capacity_mm_per_h,
                variant=at.variant,
            )
        by_night = None if at.night is None else as_night(at.night, self)
        if by_night is not None and fogs:
            lit: dict[str, Stage] = {}
            for name, stage in stages.items():
                if name == "extinction_and_airlight":
                    own_light = OwnLight(fogs[0], by_night.saturation_cd_per_m2)
                    lit |= {"own_light": own_light, name: stage, "lamp_veil": LampVeil()}
                else:
                    lit[name] = stage
            stages = lit
        conditions = camera_conditions(weather, camera, light)
        meter: dict[str, Stage] = {}
        if at.exposure_control is not None:
            control = as_exposure_control(at.exposure_control, owner=self)
            meter = {"exposure_meter": control.meter()}
            stages = {**stages, "exposure_control": control}
            # It meters the clear frame; effects of the scene without a condition belong to the scene that it meters.
            stages = stages if conditions.effects else {**meter, **stages}
        stages["quantise"] = Quantise()
        check_arguments("BayerWeather(effects: Sequence)", at.effects)
        chain = with_conditions(Chain(stages), at.effects, conditions, self)
        if meter and conditions.effects:
            chain = Chain({**meter, **chain.stages})
        if by_night is not None:  # in front of all, so that a wet road mirrors its lamps
            lamps = NightLamps(by_night, weather.parts, tuple(camera.bands.values()), at.far_m)
            chain = Chain({"night_lamps": lamps, **chain.stages})
        self.chain = chain
        self.as_built = AsBuilt.of(self.chain)
        self._rays: dict[tuple[Any, ...], Rays] = {}

    def extra_repr(self) -> str:
        """The weather and the camera."""
        training = "" if self.quality == EXACT_QUALITY else ", quality='training'"
        return f"{self.weather!r}, {self.camera!r}{training}"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_rays": {}}

    # ---- calls -------------------------------------------------------------------------------------------------

    def own_sensor(self) -> Camera:
        """The camera, with its distributions."""
        found: Camera = self._given_sensor if self._sensor_is_drawn else self.camera
        return found

    @outside_autocast
    def forward(
        self,
        bayer: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        normal: Tensor | None = None,
        out: Tensor | None = None,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """The frame in this weather.

        Args:
            bayer: ``(..., 1, H, W)`` mosaic, uint8, uint16 or float in 0..1.
            depth: ``(..., 1, H, W)`` metres along the optical axis, infinity is sky; or a ``SceneDepth``, which a
                source's ``scene`` gives; ``None`` takes the constructor's source.
            noise: what ``draw`` gave; ``None`` draws.
            normal: ``(..., 3, H, W)`` unit normals of the surfaces in the vehicle's frame (x forward, y left, z up), 0
                where there is none; for ``camera.wet_surface``.
            out: a float32 tensor of the frame's shape to write to, for fog alone; it gets linear light.
            seed: for a call that draws: an integer s for the samples s, s + 1, ..., or a tensor of the batch shape.
            generator: likewise, a torch generator that gives these integers.

        Returns:
            ``(..., 1, H, W)`` in the dtype of ``bayer``. The inputs are not changed.
        """
        if not isinstance(bayer, Tensor) or bayer.ndim < 3:
            check_bayer(bayer, self.camera, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and bayer.ndim > 3 and bayer.numel():
                beside = {"depth": depth, "normal": normal, "out": out}
                return self.each_alone(self.forward, bayer, seed, generator, beside, 3)
            chosen, seeds = self.at_call(bayer.shape[:-3], seed, generator)
            return chosen.forward(bayer, depth, chosen.drawn_for_call(bayer, seeds), normal=normal, out=out)
        state = self._state(bayer, depth, normal)
        drawn = (
            self.chain.draw(state, at_rate=True) if noise is None else self._flat_noise(noise, state, bayer.shape[:-3])
        )
        check_arguments("BayerWeather(out: Tensor | None)", out)
        if out is not None:
            self._run_into(state, out)
            return out
        return self._raw(self.chain(state, drawn), state, bayer)

    if TYPE_CHECKING:
        __call__ = forward

    @outside_autocast
    def run(
        self,
        bayer: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        normal: Tensor | None = None,
        seed: int | Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> CameraResult:
        """The frame, and with it transmission, airlight and particle mask; arguments as ``forward``."""
        if not isinstance(bayer, Tensor) or bayer.ndim < 3:
            check_bayer(bayer, self.camera, self)  # refuses it
        if self.must_draw(noise, seed, generator):
            if self.draws_alone and bayer.ndim > 3 and bayer.numel():
                return self.each_alone(self.run, bayer, seed, generator, {"depth": depth, "normal": normal}, 3)
            chosen, seeds = self.at_call(bayer.shape[:-3], seed, generator)
            return chosen.run(bayer, depth, chosen.drawn_for_call(bayer, seeds), normal=normal)
        scene = self.scene_of(bayer, depth)
        state = self._state(bayer, scene, normal, keep_truth=True)
        after = self.weathered(state, noise, bayer.shape[:-3])
        transmission, airlight, mask = self.truth_of(state, after)
        return CameraResult(
            bayer=self._raw(after, state, bayer),
            transmission=transmission.reshape(bayer.shape),
            airlight=airlight.reshape(*bayer.shape[:-3], 3),
            particle_mask=mask.reshape(bayer.shape),
            depth_confidence=scene.confidence,
        )

    def weathered(
        self, state: CameraState, noise: Mapping[str, Tensor] | None = None, batch: Sequence[int] | None = None
    ) -> CameraState:
        """The state after the chain.

        Args:
            state: of `state_of` or `planes_state`.
            noise: what ``draw`` gave; ``None`` draws.
            batch: batch shape of the frames, with which the noise leads; (B,) unless given.
        """
        drawn = self.chain.draw(state, at_rate=True) if noise is None else self._flat_noise(noise, state, batch)
        after: CameraState = self.chain(state, drawn)
        return after

    def truth_of(self, state: CameraState, after: CameraState) -> tuple[Tensor, Tensor, Tensor]:
        """Transmission ``(B, C, H, W)``, airlight ``(B, 3)`` and particle mask ``(B, 1, H, W)`` of a frame."""
        airlight = after.air.airlight
        if airlight is None:
            veil, lit = self.chain.stages.get("particle_veil"), state.changed(airlight_scale=after.air.airlight_scale)
            if isinstance(veil, ParticleVeil):
                airlight = veil.ambient(lit)
            else:
                airlight = scaled_airlight(given_or_estimated(None, state, self), lit)
        transmission = (
            torch.ones_like(state.image.signal) if after.image.transmission is None else after.image.transmission
        )
        mask = torch.zeros_like(state.one_plane) if after.image.particle_mask is None else after.image.particle_mask
        return transmission, airlight, mask

    @outside_autocast
    def draw(
        self,
        bayer: Tensor,
        depth: Tensor | None = None,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
        *,
        at_rate: bool = False,
    ) -> dict[str, Tensor]:
        """Noise for a frame (or a batch): ``<stage>.<variate>`` to a tensor with the frame's leading dimensions.

        Args:
            bayer: the frame; only its shape counts.
            depth: ignored, so that ``draw`` takes what ``forward`` takes.
            generator: takes one integer per sample from it; ``None`` is torch's global generator.
            seed: the integers themselves: a tensor of the batch shape, or one integer s for s, s + 1, ...
            at_rate: draw only what the present rates need: particles of higher rates are left out, and samples without
                particles get zeros. Otherwise one draw serves every rate.

        Returns:
            float32 tensors on the CPU; the same seed gives the same numbers everywhere.
        """
        check_arguments("BayerWeather.draw(at_rate: bool)", at_rate)
        check_bayer(bayer, self.camera, self)
        return self.drawn(bayer.shape[:-3], sizes_of(*bayer.shape[-2:]), generator, seed, at_rate=at_rate)

    def draw_for_call(self, value: Tensor, seed: int) -> dict[str, Tensor]:
        """Noise of one sample for one call at the present rates, with keys in place of the haze's normals."""
        return self.drawn_for_call(value, seed)

    def drawn_for_call(self, bayer: Tensor, seed: int | Tensor) -> dict[str, Tensor]:
        """As ``draw(bayer, seed=seed, at_rate=True)``, for one call of this transform alone."""
        check_bayer(bayer, self.camera, self)
        return self.drawn(bayer.shape[:-3], sizes_of(*bayer.shape[-2:]), None, seed, at_rate=True, keyed=True)

    @outside_autocast
    def draw_sequence(
        self,
        bayer: Tensor,
        frames: int,
        frame_interval_s: float,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
        *,
        ego_speeds_m_per_s: Sequence[float] | None = None,
    ) -> Iterator[dict[str, Tensor]]:
        """Noise of successive frames in which particles and patches move with fall speed, wind and ego motion.

        Args:
            bayer: a frame of the sequence; only its shape counts.
            frames: how many.
            frame_interval_s: from frame to frame, seconds.
            generator, seed: as in ``draw``; the first frame is what ``draw`` gives.
            ego_speeds_m_per_s: one speed a frame, none faster than the constructor's. Frame k is then that of
                ``at_ego_speed(ego_speeds_m_per_s[k])``. Default: the constructor's in every frame.

        Yields:
            Noise for ``forward``, frame after frame.

        Note:
            The rate must be one number. Where the vehicle moves, a particle that crosses into the next octave of
            depth is exchanged for another.

        Example:
            >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
            >>> rain = BayerRain(Rain(rate_mm_per_h=25), camera, depth=30.0, airlight=0.7)
            >>> frame = torch.full((1, 24, 32), 0.2)
            >>> film = [rain(frame, noise=noise) for noise in rain.draw_sequence(frame, 3, 1 / 30, seed=7)]
            >>> len(film)
            3
        """
        check_bayer(bayer, self.camera, self)
        return self.sequence_of(bayer, frames, frame_interval_s, generator, seed, ego_speeds_m_per_s)

    def at_ego_speed(self, ego_speed_m_per_s: float) -> BayerWeather:
        """The same seen from the vehicle at another speed; it takes the noise of this one.

        Args:
            ego_speed_m_per_s: forward; its magnitude is at most that of the constructor's.
        """
        check_arguments("BayerWeather.at_ego_speed(ego_speed_m_per_s: float)", ego_speed_m_per_s)
        stages = self.chain.stages | patchy_air(self.weather.densest(), ego_speed_m_per_s)
        for name, stage in stages.items():
            if isinstance(stage, ParticleVeil):
                stages[name] = stage.at_ego_speed(ego_speed_m_per_s)
        other = copy.copy(self)
        other._modules = dict(self._modules)
        other.chain = Chain(stages)
        return other

    def sequence_of(
        self,
        image: Tensor,
        frames: int,
        frame_interval_s: float,
        generator: torch.Generator | None,
        seed: int | Tensor | None,
        ego_speeds_m_per_s: Sequence[float] | None = None,
    ) -> Iterator[dict[str, Tensor]]:
        """Noise of successive frames of an image ``(..., C, H, W)``."""
        check_arguments(
            f"{type(self).__name__}(image: Tensor(..., C, H, W), frames: int, ego_speeds_m_per_s: Sequence | None)",
            image,
            frames,
            ego_speeds_m_per_s,
        )
        check_at_least("frames", frames, 1, owner=self)
        check_positive("frame_interval_s", frame_interval_s, unit="s", owner=self)
        if ego_speeds_m_per_s is not None and len(ego_speeds_m_per_s) != frames:
            raise InputValueError(
                f"{type(self).__name__}: ego_speeds_m_per_s must hold one speed for each of {frames} frames; got "
                f"{len(ego_speeds_m_per_s)}."
            )
        batch = image.shape[:-3]
        flat_seed = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == batch else seed
        seeds = sample_seeds((math.prod(batch),), generator, flat_seed)
        height, width = image.shape[-2:]
        sizes = Sizes(len(seeds), sizes_of(height, width, image.shape[-3]))
        noise = self.drawn((len(seeds),), sizes.sizes, None, torch.tensor(seeds))
        for frame in range(int(frames)):
            if frame:
                moving = self
                if ego_speeds_m_per_s is not None:  # the mean over the interval moves the particles
                    moving = self.at_ego_speed(0.5 * (ego_speeds_m_per_s[frame - 1] + ego_speeds_m_per_s[frame]))
                for name, stage in moving.chain.stages.items():
                    own = {k.removeprefix(f"{name}."): v for k, v in noise.items() if k.startswith(f"{name}.")}
                    if isinstance(stage, ParticleVeil):
                        own = stage.next_frame(own, (height, width), frame_interval_s, seeds, name, frame)
                    elif isinstance(stage, PatchyAir):
                        own = stage.next_frame(own, frame_interval_s)
                    elif isinstance(stage, Effect) and stage.each_frame_anew:
                        own = stage.draw(sizes, seed=seeds, name=f"{name}.frame_{frame}")
                    noise = {**noise, **{f"{name}.{key}": value for key, value in own.items()}}
            yield {key: value.reshape(*batch, *value.shape[1:]) for key, value in noise.items()}

    def state_of(
        self, bayer: Tensor, depth: Tensor | SceneDepth | None = None, normal: Tensor | None = None
    ) -> CameraState:
        """State that the chain begins with: the frame before any stage.

        Args:
            bayer, depth, normal: as in ``forward``.
        """
        return self._state(bayer, depth, normal)

    # ---- the border --------------------------------------------------------------------------------------------

    def _state(
        self,
        bayer: Tensor,
        depth: Tensor | SceneDepth | None,
        normal: Tensor | None = None,
        *,
        keep_truth: bool = False,
    ) -> CameraState:
        check_bayer(bayer, self.camera, self)
        height, width = bayer.shape[-2:]
        linear = raw_to_linear(bayer, self.camera, self).reshape(-1, 1, height, width)
        state = self.planes_state(linear, self.scene_of(bayer, depth), bayer.shape[:-3], keep_truth=keep_truth)
        return state.changed(
            cfa_index=torch.tensor(cfa_colour_index(self.camera.bayer_pattern), device=linear.device),
            normal=None if normal is None else self._normal(normal, bayer, linear),
        )

    def planes_state(
        self, linear: Tensor, scene: SceneDepth, batch: Sequence[int], *, keep_truth: bool = False
    ) -> CameraState:
        """State of a picture of linear light ``(B, 3, H, W)`` in front of a scene, before any stage.

        Args:
            linear: red, green, blue, black 0 and saturation 1.
            scene: depth, sky and own vehicle.
            batch: the batch shape, whose product is B.
            keep_truth: compute transmission and particle mask as well.
        """
        self.refuse_undrawn(torch.Size(batch))
        return self.scene_state(linear, scene, batch, keep_truth=keep_truth)

    def scene_state(
        self, linear: Tensor, scene: SceneDepth, batch: Sequence[int], *, keep_truth: bool = False
    ) -> CameraState:
        """As `planes_state`, of a weather that may have yet to be drawn."""
        rays = self._rays_for(linear, scene.horizon_row)

        def flat(name: str) -> Tensor | None:
            share = getattr(scene, name)
            return None if share is None else self._flat(share, name, batch, linear)

        depth_m = flat("depth_m")
        assert depth_m is not None
        return CameraState.of(
            signal=linear,
            depth_m=depth_m,
            ray_per_depth=rays.per_depth,
            cfa_index=None,
            intrinsics=torch.tensor([self.camera.intrinsics], device=linear.device, dtype=linear.dtype),
            keep_truth=keep_truth,
            camera=self.camera,
            ray_in_layer_m=rays.in_layer_m,
            sky=flat("sky"),
            near_mask=flat("near_mask"),
            ground=flat("ground"),
            sine_elevation=rays.sine_elevation,
        )

    def _normal(self, normal: Tensor, bayer: Tensor, linear: Tensor) -> Tensor:
        batch, (height, width) = bayer.shape[:-3], linear.shape[-2:]
        if (
            not isinstance(normal, Tensor)
            or not normal.is_floating_point()
            or tuple(normal.shape[-3:]) != (3, height, width)
        ):
            raise InputValueError(
                f"{type(self).__name__}: normal must be a tensor (..., 3, {height}, {width}) of unit normals in the "
                f"vehicle's frame; got {tuple(normal.shape) if isinstance(normal, Tensor) else type(normal).__name__}."
            )
        shared = normal.ndim == 3 or normal.shape[:-3].numel() == 1
        if not shared and not torch.compiler.is_compiling() and normal.shape[:-3] != batch:
            raise InputValueError(
                f"{type(self).__name__}: normal must have the batch {tuple(batch)}; got {tuple(normal.shape)}."
            )
        spread = normal if shared else normal.expand(*batch, 3, height, width)
        return spread.reshape(-1, 3, height, width).to(linear)

    def scene_of(self, image: Tensor, depth: Tensor | SceneDepth | None) -> SceneDepth:
        """Depth of an image ``(..., C, H, W)``: as given at the call, else from the constructor's source."""
        check_arguments("BayerWeather(image: Tensor(..., H, W))", image)
        height, width = image.shape[-2:]
        if isinstance(depth, SceneDepth):
            check_depth(depth.depth_m, height, width, owner=self)
            return depth
        if depth is None:
            if self.depth_source is None:
                raise InputValueError(
                    f"{type(self).__name__}: no depth. Give forward(bayer, depth) a map (..., 1, H, W) in metres, or "
                    "the constructor a source: depth=30.0, depth=FlatGround(), a map or a function of the image."
                )
            dtype = torch.float64 if image.dtype == torch.float64 else torch.float32
            return scene_of(self.depth_source, self.camera, height, width, image=image, dtype=dtype)
        if not isinstance(depth, Tensor):
            raise InputTypeError(
                f"{type(self).__name__}: depth must be a tensor (..., 1, H, W) in metres or a SceneDepth; got "
                f"{type(depth).__name__}. A number or a depth source goes to the constructor."
            )
        check_depth(depth, height, width, owner=self)
        warn_of_depth(depth, self.camera, self)
        return SceneDepth(depth, EXACT)

    def _flat(self, share: Tensor, name: str, batch: Sequence[int], linear: Tensor) -> Tensor:
        """A map ``(..., 1, H, W)`` for the flattened batch, ``(1 or B, 1, H, W)``."""
        height, width = linear.shape[-2:]
        try:
            spread = share.expand(*batch, 1, height, width)
        except RuntimeError as error:
            raise InputValueError(
                f"{type(self).__name__}: {'depth' if name == 'depth_m' else name} {tuple(share.shape)} does not fit "
                f"the frame {(*batch, linear.shape[1], height, width)}."
            ) from error
        shared = share.ndim <= 3 or share.shape[:-3].numel() == 1
        flat = share.reshape(1, 1, height, width) if shared else spread.reshape(-1, 1, height, width)
        return flat.to(device=linear.device, dtype=linear.dtype)

    def forget_rays(self) -> None:
        """Drop the geometry of the rays that is kept for the last size; for a copy with another camera."""
        self._rays = {}

    def _rays_for(self, linear: Tensor, horizon_row: float | None) -> Rays:
        height, width = linear.shape[-2:]
        if is_exporting():
            return rays_of_frame(self.camera, height, width, linear, self.layer_top_m, horizon_row)
        key = (height, width, linear.device, linear.dtype, horizon_row)
        if key not in self._rays:
            self._rays = {key: kept_rays(self.camera, height, width, linear, self.layer_top_m, horizon_row)}
        return self._rays[key]

    def _raw(self, after: CameraState, before: CameraState, bayer: Tensor) -> Tensor:
        return raw_from_linear(
            after.image.signal.reshape(bayer.shape), before.image.signal.reshape(bayer.shape), bayer, self.camera
        )

    def _run_into(self, state: CameraState, out: Tensor) -> None:
        fog = self.chain.stages.get("extinction_and_airlight")
        if not isinstance(fog, ExtinctionAndAirlight) or len(self.chain.stages) != 2:
            raise InputValueError(f"{type(self).__name__}: out= is for fog alone.")
        if self.camera.response_knots:
            raise InputValueError(
                f"{type(self).__name__}: out= takes linear light; this camera compands (response_knots)."
            )
        if (
            out.dtype != state.image.signal.dtype
            or out.numel() != state.image.signal.numel()
            or not out.is_contiguous()
        ):
            raise InputValueError(
                f"{type(self).__name__}: out must be contiguous {state.image.signal.dtype} of "
                f"{state.image.signal.numel()} elements; got {out.dtype}, {tuple(out.shape)}."
            )
        fog(state, {}, out=out.view(state.image.signal.shape))


class BayerRain(BayerWeather):
    """Rain on a raw Bayer frame: drops in the viewing frustum, with the streaks of the exposure.

    Arguments as ``BayerWeather``.

    Example:
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> rain = BayerRain(Rain(rate_mm_per_h=25), camera, depth=30.0, airlight=0.7)
        >>> frame = torch.full((1, 24, 32), 0.2)
        >>> noise = rain.draw(frame, seed=7)
        >>> torch.equal(rain(frame, noise=noise), rain(frame, noise=noise))
        True
    """

    takes: ClassVar[tuple[str, ...]] = ("rain",)


class BayerFog(BayerWeather):
    """Fog on a raw Bayer frame: the scene fades along the ray into the airlight, each colour at its own extinction.

    Arguments as ``BayerWeather``.

    Example:
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> fog = BayerFog(Fog(mor_m=50), camera, depth=50.0, airlight=0.7)
        >>> bool(fog(torch.full((1, 24, 32), 0.2)).mean() > 0.6)
        True
    """

    takes: ClassVar[tuple[str, ...]] = ("fog",)


class BayerSnow(BayerWeather):
    """Snow on a raw Bayer frame: flakes in the viewing frustum, white in the light of the sky.

    Arguments as ``BayerWeather``.

    Example:
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> snow = BayerSnow(Snow(rate_mm_per_h=2), camera, depth=30.0, airlight=0.7)
        >>> bool(snow.run(torch.full((1, 24, 32), 0.2)).particle_mask.max() > 0)
        True
    """

    takes: ClassVar[tuple[str, ...]] = ("snow",)
