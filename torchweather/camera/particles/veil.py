"""ParticleVeil: rain drops and snow flakes in the viewing frustum of a camera."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, Snow, weather_from_dict
from torchweather.camera.airlight import Airlight, airlight_argument, frame_mean, given_or_estimated, scaled_airlight
from torchweather.camera.compiled_rows import on_processor
from torchweather.camera.flake_light import flake_light
from torchweather.camera.fog import FADING_COLOUR
from torchweather.camera.options import RENAMED
from torchweather.camera.particles import compiled
from torchweather.camera.particles.haze import haze_depth as haze_by_torch
from torchweather.camera.particles.haze_numbers import numbers_of_keys
from torchweather.camera.particles.optical_depth import haze_depth, listed_depth
from torchweather.camera.particles.population import Array, AtRate, Population
from torchweather.camera.particles.sequence import next_frame
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import (
    InputTypeError,
    InputValueError,
    check_at_least,
    check_between,
    check_one_of,
    check_positive,
)
from torchweather.core.moved import renamed_arguments
from torchweather.core.random import Variate
from torchweather.core.threads import one_thread_an_operation
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import by_rows, is_exporting, rows_of

__all__ = ["REFLECTED_SHARE", "ParticleVeil"]

REFLECTED_SHARE = 0.06  # of the light of a drop comes from its outside: Garg & Nayar 2007, PHYSICS.md 4.1
DROP_VIEWS = ("frame", "upper")
BAND_PIXELS = 1 << 16  # whose shells of the haze stay in the cache
# Fields by which particles of any level may come in: number in the air, focal length.
CHANGES_LEVELS = frozenset({"air.particle_count", "air.patches", "scene.intrinsics"})
FAINTEST = 1e-20  # optical depth below which a colour does not matter


@register
class ParticleVeil(Stage):
    """Rain or snow between camera and scene, drawn particle by particle where it can be seen.

    Every pixel's particles cover the share ``M = 1 - prod(1 - m)`` of its exposure, ``m`` the covered share of each
    one that is nearer than the scene. The pixel becomes ``(1 - M) I + M C`` with C the particles' colour:
    ``0.94`` of the scene's mean and ``0.06`` of the sky for drops, the albedo times the mean light of sky and ground
    for flakes, per CFA colour and linear in light (``PHYSICS.md`` 4.1-4.7, 10.2). Particles seen through fog fade into
    the airlight.

    Particles whose mark peaks above ``min_listed_coverage`` are rendered one by one; all others enter through the exact
    mean and variance of their optical depth with the correlation of their streaks.

    Identity: rate 0.

    Args:
        weathers: rain, snow or both, or their dictionaries.
        camera: the camera, or its dictionary.
        near_m, far_m: limits of the particles along the axis; beyond ``far_m`` the air is clear.
        min_listed_coverage: peak coverage above which a particle is drawn one by one.
        max_listed_density: listed particles per pixel and e-fold of depth; where there are more, none is seen by
            itself and the smallest count as haze.
        ego_speed_m_per_s: of the vehicle, forward.
        ambient: linear signal of the sky per colour; ``None`` estimates it from the frame.
        drop_radiance: what a drop shows: the mean of the whole ``frame`` or of its ``upper`` three fifths.
        rate_capacity_mm_per_h: highest rate that one draw serves; ``None`` is 100 mm/h for rain and 10 mm/h for
            snow, or the weather's own rate where that is higher.
        variant: ``d3_4`` takes D3.4's blend weight (1 + d)/(v t) in place of the covered share.
    """

    default_name: ClassVar[str] = "particle_veil"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics", "scene.near_mask", "scene.ray_per_depth"),
        *("scene.sine_elevation", "scene.sky"),
        "air.airlight",
        "air.airlight_scale",
        "air.fog_extinction_per_m",
        "air.lamp_light",
        "air.particle_contrast",
        "air.particle_count",
        "air.particle_reach_m",
        "air.patches",
        "air.path_tangent",
        "image.signal",
        *("receiver.camera", "receiver.cfa_index", "receiver.keep_truth", "receiver.row_time_s"),
    )
    writes: ClassVar[tuple[str, ...]] = ("image.particle_mask", "image.signal")
    takes_keys: ClassVar[bool] = True

    @renamed_arguments(**RENAMED)
    def __init__(
        self,
        weathers: Sequence[Rain | Snow | Mapping[str, Any]],
        camera: Camera | Mapping[str, Any],
        near_m: float = 0.5,
        far_m: float = 200.0,
        min_listed_coverage: float = 1 / 1024,
        max_listed_density: float = 0.25,
        ego_speed_m_per_s: float = 0.0,
        ambient: Sequence[float] | float | str | None = None,
        drop_radiance: str = "frame",
        rate_capacity_mm_per_h: float | None = None,
        variant: str | None = None,
    ) -> None:
        check_arguments(
            "ParticleVeil(weathers: Sequence, camera: Camera | Mapping, near_m: float, far_m: float, "
            "min_listed_coverage: float, max_listed_density: float, ego_speed_m_per_s: float, "
            "ambient: Sequence[float] | float | str | None, drop_radiance: str, "
            "rate_capacity_mm_per_h: float | None, variant: str | None)",
            weathers,
            camera,
            near_m,
            far_m,
            min_listed_coverage,
            max_listed_density,
            ego_speed_m_per_s,
            ambient,
            drop_radiance,
            rate_capacity_mm_per_h,
            variant,
        )
        super().__init__()
        self.camera = Camera.of(camera)
        near_m, far_m = float(near_m), float(far_m)
        min_listed_coverage, max_listed_density = float(min_listed_coverage), float(max_listed_density)
        check_positive("near_m", near_m, unit="m", owner=self)
        check_at_least("far_m", far_m, 2 * near_m, unit="m", owner=self, advice="It must be at least twice near_m.")
        check_between("far_m", far_m, 0.0, 1e9, unit="m", owner=self)
        if rate_capacity_mm_per_h is not None:
            check_positive("rate_capacity_mm_per_h", rate_capacity_mm_per_h, unit="mm/h", owner=self)
        check_between("min_listed_coverage", min_listed_coverage, 1e-6, 1.0, owner=self)
        check_positive("max_listed_density", max_listed_density, unit="particles per pixel", owner=self)
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -100.0, 100.0, unit="m/s", owner=self)
        check_one_of("drop_radiance", drop_radiance, DROP_VIEWS, owner=self)
        built = [w if isinstance(w, (Rain, Snow)) else weather_from_dict(w) for w in weathers]
        self.options: dict[str, Any] = {
            "near_m": near_m,
            "far_m": far_m,
            "min_listed_coverage": min_listed_coverage,
            "max_listed_density": max_listed_density,
            "ego_speed_m_per_s": ego_speed_m_per_s,
            "ambient": list(ambient) if isinstance(ambient, (list, tuple)) else ambient,
            "drop_radiance": drop_radiance,
            "rate_capacity_mm_per_h": rate_capacity_mm_per_h,
            "variant": variant,
        }
        self.drop_radiance = drop_radiance
        self.given_ambient: Airlight = airlight_argument(ambient, self)
        self.populations = torch.nn.ModuleList()
        for weather in sorted(built, key=lambda part: part.kind):
            if not isinstance(weather, (Rain, Snow)):
                raise InputTypeError(f"ParticleVeil: weathers must be Rain or Snow; got {type(weather).__name__}.")
            self.populations.append(
                Population(
                    weather,
                    self.camera,
                    near_m=near_m,
                    far_m=far_m,
                    min_listed_coverage=min_listed_coverage,
                    max_listed_density=max_listed_density,
                    ego_speed_m_per_s=ego_speed_m_per_s,
                    rate_capacity_mm_per_h=rate_capacity_mm_per_h,
                    published_blend=variant == "d3_4",
                )
            )

    def at_ego_speed(self, ego_speed_m_per_s: float) -> ParticleVeil:
        """The same particles seen from the vehicle at another, smaller speed; it takes the noise of this one.

        Args:
            ego_speed_m_per_s: forward; its magnitude is at most that of the constructor's.
        """
        fastest = abs(float(self.options["ego_speed_m_per_s"]))
        check_between("ego_speed_m_per_s", ego_speed_m_per_s, -fastest, fastest, unit="m/s", owner=self)
        other = copy.copy(self)
        other._modules = dict(self._modules)
        other.populations = torch.nn.ModuleList(part.at_ego_speed(ego_speed_m_per_s) for part in self.parts)
        return other

    @property
    def parts(self) -> list[Population]:
        """The populations, one for each kind of particle."""
        return list(self.populations)  # type: ignore[arg-type]

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "weathers": [part.weather.to_dict() for part in self.parts],
            "camera": self.camera.to_dict(),
            **self.options,
        }

    def extra_repr(self) -> str:
        """The path that renders each kind of particle on the processor."""
        return ", ".join(f"{part.weather.kind} rendered by {compiled.rendered_by(part)}" for part in self.parts)

    def variates(self) -> tuple[Variate, ...]:
        """Points of every listed shell and the noise maps of the haze, for each kind of particle."""
        return tuple(variate for part in self.parts for variate in part.variates())

    def variates_at_rate(
        self, batch: int, written: frozenset[str] | None
    ) -> tuple[tuple[Variate, ...], list[bool] | None]:
        """Points as far as the rates of a batch show them; samples without particles need none."""
        if written is None or written & CHANGES_LEVELS:
            return self.variates(), None
        cut = tuple(variate for part in self.parts for variate in part.variates_at_rate())
        return cut, self._falling(batch)

    def level_limits(self, written: frozenset[str] | None) -> dict[str, tuple[Population, Array]]:
        """Of each variate of points that a lower rate needs less of: its particles and ``Population.level_limits``.

        Args:
            written: as for ``variates_at_rate``.
        """
        if written is None or written & CHANGES_LEVELS:
            return {}
        return {
            variate.name: (part, limits)
            for part in self.parts
            if not part.camera.distorted
            for variate, limits in zip(part.variates(), part.level_limits(), strict=False)  # the last is the haze's
        }

    def next_frame(
        self,
        noise: Mapping[str, Tensor],
        size: tuple[int, int],
        interval_s: float,
        seeds: Sequence[int],
        name: str,
        frame: int,
    ) -> dict[str, Tensor]:
        """Noise ``(B, ...)`` of the next frame of a sequence; see ``torchweather.camera.particles.sequence``."""
        samples = []
        for row, seed in enumerate(seeds):
            own = {key: value[row] for key, value in noise.items()}
            samples.append(
                {
                    key: value
                    for part in self.parts
                    for key, value in next_frame(part, own, size, interval_s, seed, name, frame).items()
                }
            )
        return {key: torch.stack([sample[key] for sample in samples]) for key in samples[0]}

    def ambient(self, state: CameraState) -> Tensor:
        """Signal of the sky per colour, ``(B, 3)``."""
        if not isinstance(self.given_ambient, tuple) and state.air.airlight is not None:
            return state.air.airlight  # the fog's stage has scaled it
        return scaled_airlight(given_or_estimated(self.given_ambient, state, self), state)

    def _colours(self, state: CameraState) -> list[Tensor]:
        ambient = self.ambient(state)
        colours = []
        for part in self.parts:
            if isinstance(part.weather, Snow):
                colours.append(part.weather.albedo * flake_light(state, ambient))
            else:
                colours.append((1 - REFLECTED_SHARE) * self._seen_through(state) + REFLECTED_SHARE * ambient)
        return colours

    def _seen_through(self, state: CameraState) -> Tensor:
        if self.drop_radiance == "frame":
            return frame_mean(state)
        # Whole row pairs of the upper three fifths; sym_max, so that a graph of any height counts anew.
        rows = torch.sym_max(2, state.image.signal.shape[-2] * 3 // 5 // 2 * 2)  # type: ignore[no-untyped-call]
        return frame_mean(state.changed(signal=state.image.signal[..., :rows, :]))

    def behind(self, state: CameraState, particle_mask: Tensor) -> CameraState:
        """The frame behind particles of one kind, without fog, whose share of the exposure is known.

        Args:
            state: the frame.
            particle_mask: ``(B, 1, H, W)``, as ``forward`` gives it.
        """
        if len(self.parts) != 1 or state.air.fog_extinction_per_m is not None:
            raise InputValueError(
                "ParticleVeil.behind: one kind of particles, and no fog, has one colour; use forward."
            )
        colour, contrast = state.per_pixel(self._colours(state)[0]), state.air.particle_contrast
        mask = state.by_cells(particle_mask)
        weight = mask if contrast is None else mask * contrast.view(-1, 1, 1, 1, 1)
        signal = torch.lerp(state.by_cells(state.image.signal), colour, weight).flatten(2, 3)
        if contrast is not None:
            signal = torch.where(contrast.view(-1, 1, 1, 1) == 1, signal, signal.clamp(0.0, 1.0))
        return state.changed(signal=signal, particle_mask=particle_mask if state.receiver.keep_truth else None)

    def optical_depth(self, state: CameraState, noise: Mapping[str, Tensor]) -> Tensor:
        """Optical depth of all particles in front of the scene, ``(B, 1, H, W)``; ``forward`` covers 1 less its exp.

        Args:
            state: the frame, whose signal does not matter.
            noise: as for ``forward``.
        """
        one = state.one_plane
        total, shape = torch.zeros_like(one), one.shape
        with one_thread_an_operation():
            for part in self.parts:
                part.check_rate()
                table = part.in_air(state)
                sharp, _ = listed_depth(part, state, noise, table)

                def band(
                    first: int, last: int, into: Tensor | None, part: Population = part, table: AtRate = table
                ) -> tuple[Tensor]:
                    return (haze_depth(part, state, noise, table, first, last)[0].expand(shape[0], -1, -1, -1),)

                (haze,) = by_rows(band, shape, one, apart=True, band_pixels=BAND_PIXELS)
                total += sharp.add_(haze)
        return total

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The frame behind its particles.

        Under ``torch.compile`` particles are rendered as without it: which of them are seen depends on values, so that
        a graph would hold all of them. An exported graph does.
        """
        if torch.compiler.is_dynamo_compiling():
            apart: Callable[..., CameraState] = torch.compiler.disable(self._render)  # type: ignore[no-untyped-call]
            return apart(state, noise)
        if is_exporting():
            return self._render(state, noise)
        with one_thread_an_operation():
            return self._render(state, noise)

    def _render(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        if state.image.signal.numel() == 0:
            return state.changed(particle_mask=state.one_plane if state.receiver.keep_truth else None)
        before = state
        for part in self.parts:
            part.check_rate()
        if not is_exporting():
            falling = self._falling(state.batch)
            if not any(falling):
                mask = torch.zeros_like(state.one_plane) if state.receiver.keep_truth else None
                return state.changed(signal=state.image.signal.clone(), particle_mask=mask)
            if not all(falling) and state.air.patches is None and state.air.lamp_light is None:
                return self._render_some(state, noise, [row for row, falls in enumerate(falling) if falls])
        if state.scene.sky is not None:
            # Particles reach to the far limit in front of the sky. A pixel that is mostly sky shows those, not the few
            # in front of the leaf that it has in part: where the share comes near 1, nothing jumps.
            state = state.changed(depth_m=torch.where(state.scene.sky > 0.5, torch.inf, state.scene.depth_m))
        each_colour = self._colours(state)
        tables = [part.in_air(state) for part in self.parts]
        if self._is_in_one_pass(state, noise, tables, each_colour):
            signal, covered = compiled.frame_behind(self.parts[0], state, noise, tables[0], each_colour[0])
            return before.changed(signal=signal, particle_mask=covered)
        noise = self._with_numbers(noise, state, tables)
        # A graph holds the places in the CFA's cells as planes, which takes fewer operations.
        spread, apart = (state.per_place, state.by_places) if is_exporting() else (state.per_pixel, state.by_cells)
        colours = [spread(colour) for colour in each_colour]
        contrast = state.air.particle_contrast
        fog = state.air.fog_extinction_per_m
        fog_per_m = None if fog is None else fog[:, FADING_COLOUR].float()
        listed = [
            listed_depth(part, state, noise, table, fog_per_m) for part, table in zip(self.parts, tables, strict=True)
        ]
        lamps = state.air.lamp_light
        lit: list[Tensor | None] = [None for _ in self.parts]
        lamp_colour = None
        if lamps is not None:
            lamp_colour = spread(lamps.colour.to(state.image.signal).expand(state.batch, 3))
            lit = [
                part.listed_depth(state, noise, table, lit=True)[1]
                for part, table in zip(self.parts, tables, strict=True)
            ]

        def band(first: int, last: int, into: Tensor | None) -> tuple[Tensor, ...]:
            depths, lights = [], []
            for part, table, (sharp, sharp_faded), colour, sharp_lit in zip(
                self.parts, tables, listed, colours, lit, strict=True
            ):
                haze, haze_faded = haze_depth(part, state, noise, table, first, last, fog_per_m)
                depths.append(apart(rows_of(sharp, first, last) + haze))
                if sharp_faded is not None and haze_faded is not None:
                    faded = apart(rows_of(sharp_faded, first, last) + haze_faded)
                    colour = self._through_fog(state, colour, faded, depths[-1], spread)
                if sharp_lit is not None and lamp_colour is not None:
                    haze_lit = haze_by_torch(part, state, noise, table, first, last, lit=True)[1]
                    assert haze_lit is not None
                    shown = apart(rows_of(sharp_lit, first, last) + haze_lit) / depths[-1].clamp_min(FAINTEST)
                    colour = colour + shown * lamp_colour
                lights.append(colour)
            total = sum(depths[1:], depths[0])
            covered = 1.0 - torch.exp(-total) if is_exporting() else -torch.expm1(-total)
            mask = covered.to(state.image.signal.dtype)
            if state.scene.near_mask is not None:  # nothing falls between the lens and the own vehicle
                mask = mask * (1.0 - apart(rows_of(state.scene.near_mask, first, last)).to(mask.dtype))
            if len(lights) == 1:
                light = lights[0].to(mask.dtype)
            else:
                light = sum(d * c for d, c in zip(depths, lights, strict=True)) / total.clamp_min(FAINTEST)
            weight = mask if contrast is None else mask * contrast.view(-1, *(1,) * (mask.ndim - 1))
            clear = rows_of(state.image.signal, first, last)
            if is_exporting():
                start = apart(clear)
                signal = state.from_places(start + weight * (light.to(mask.dtype) - start))
            else:
                signal = torch.lerp(apart(clear), light.to(mask.dtype), weight).reshape(clear.shape)
            if contrast is not None:  # more than the whole way to the particles' colour may leave what there is
                signal = torch.where(contrast.view(-1, 1, 1, 1) == 1, signal, signal.clamp(0.0, 1.0))
            if not state.receiver.keep_truth:
                return (signal,)
            return signal, state.from_places(mask) if is_exporting() else mask.flatten(2, 3)

        planes = state.image.signal.shape[1]
        results = by_rows(
            band, state.image.signal.shape, state.image.signal, apart=True, band_pixels=planes * BAND_PIXELS
        )
        return before.changed(signal=results[0], particle_mask=results[1] if state.receiver.keep_truth else None)

    def _is_in_one_pass(
        self, state: CameraState, noise: Mapping[str, Tensor], tables: Sequence[AtRate], colours: Sequence[Tensor]
    ) -> bool:
        """True where compiled loops take one kind of particles in clear air from the points to the frame."""
        air, scene = state.air, state.scene
        if len(self.parts) != 1 or air.particle_contrast is not None or air.lamp_light is not None:
            return False
        if air.fog_extinction_per_m is not None or not compiled.covers(self.parts[0], state, noise, tables[0]):
            return False
        return on_processor(state.image.signal, scene.depth_m, scene.ray_per_depth, scene.near_mask, colours[0])

    def _with_numbers(
        self, noise: Mapping[str, Tensor], state: CameraState, tables: Sequence[AtRate]
    ) -> Mapping[str, Tensor]:
        """The noise with numbers in place of keys, where torch renders."""
        found = dict(noise)
        for part, table in zip(self.parts, tables, strict=True):
            lit = state.air.lamp_light is not None
            name = f"{part.weather.kind}_haze"
            if noise[name].dtype == torch.int64 and (lit or not compiled.covers(part, state, noise, table)):
                found[name] = numbers_of_keys(noise[name].to(state.image.signal.device), part, state, table)
        return found

    def _falling(self, batch: int) -> list[bool]:
        """Mask of the samples in which something falls; where a rate is learnt, something may."""
        rates = [part.rate_mm_per_h for part in self.parts]
        if any(rate.requires_grad for rate in rates):
            return [True] * batch
        falls = torch.stack([(rate.detach().reshape(-1) > 0).expand(batch) for rate in rates])
        found: list[bool] = falls.any(0).tolist()
        return found

    def _render_some(self, state: CameraState, noise: Mapping[str, Tensor], rows: list[int]) -> CameraState:
        """The state with some of the samples behind particles; the others stay as they are."""
        index = torch.tensor(rows, device=state.image.signal.device)

        def own(value: Any, name: str) -> Any:
            of_each = isinstance(value, Tensor) and value.ndim > 0 and len(value) == state.batch
            return value.index_select(0, index.to(value.device)) if of_each and name != "cfa_index" else value

        names = [field.partition(".")[2] for field in self.reads]
        some = state.changed(**{name: own(state.field(name), name) for name in names})
        other = copy.copy(self)
        other._modules = dict(self._modules)
        other.populations = torch.nn.ModuleList(part.of_samples(index) for part in self.parts)
        after = other._render(some, {key: value[index.to(value.device)] for key, value in noise.items()})
        signal = state.image.signal.index_copy(0, index, after.image.signal)
        mask = None
        if after.image.particle_mask is not None:
            mask = torch.zeros_like(state.one_plane).index_copy(0, index, after.image.particle_mask)
        return state.changed(signal=signal, particle_mask=mask)

    def _through_fog(
        self,
        state: CameraState,
        colour: Tensor,
        faded: Tensor,
        optical: Tensor,
        spread: Callable[[Tensor], Tensor],
    ) -> Tensor:
        """Colour of particles seen through fog: their light fades, the airlight takes its place."""
        # Both are set by the fog's stage.
        assert state.air.airlight is not None
        assert state.air.fog_extinction_per_m is not None
        clear = (faded / optical.clamp_min(FAINTEST)).clamp(FAINTEST, 1.0)
        reference = state.air.fog_extinction_per_m[:, FADING_COLOUR, None]
        ratio = torch.where(reference > 0, state.air.fog_extinction_per_m / reference.clamp_min(FAINTEST), 1.0)
        airlight = spread(state.air.airlight)
        return airlight + clear ** spread(ratio) * (colour - airlight)
