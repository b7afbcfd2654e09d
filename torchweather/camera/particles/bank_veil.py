"""BankVeil: rain drops or snow flakes of a bank of training weather in front of a camera."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.airlight import airlight_argument
from torchweather.camera.particles.bank import DrawBank
from torchweather.camera.particles.veil import FAINTEST, ParticleVeil
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.core.random import Variate
from torchweather.core.threads import one_thread_an_operation
from torchweather.pipeline.registry import register
from torchweather.pipeline.tiling import is_exporting

__all__ = ["EXACT_QUALITY", "QUALITIES", "TRAINING_QUALITY", "BankVeil", "checked_quality"]

EXACT_QUALITY, TRAINING_QUALITY = "exact", "training"
QUALITIES = (EXACT_QUALITY, TRAINING_QUALITY)
# What changes particles in a way that a rendered storm cannot follow.
REFUSED = {
    "fog_extinction_per_m": "fog, in which particles fade",
    "lamp_light": "lamps, which light particles",
    "particle_count": "another number of particles (camera.gusts and the like)",
    "path_tangent": "slanted paths (camera.wind_slant)",
    "patches": "gusts",
}
ADVICE = 'Use quality="exact" with it.'


def checked_quality(quality: object, owner: str) -> str | DrawBank:
    """``exact``, ``training`` or a bank; anything else is refused."""
    if isinstance(quality, DrawBank) or (isinstance(quality, str) and quality in QUALITIES):
        return quality
    raise InputValueError(f"{owner}: quality must be exact, training or a DrawBank; got {quality!r:.100}.")


@register
class BankVeil(ParticleVeil):
    """Rain or snow between camera and scene, composed from a bank of rendered storms.

    The optical depth comes from a `DrawBank` in place of particles of its own; colours and the blend are those of
    `ParticleVeil`. The noise of a sample are the displacements of its storms.

    Identity: rate 0.

    Args:
        weathers: rain, snow or both, or their dictionaries.
        camera: the camera, or its dictionary.
        bank: of the one weather; ``None`` takes a bank of this process, rendered at first use.
        options: as of `ParticleVeil`. An ego speed, a variant and wind along the axis are refused.
    """

    default_name: ClassVar[str] = "particle_veil"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics", "scene.near_mask", "scene.ray_per_depth"),
        *("scene.sine_elevation", "scene.sky"),
        *(f"air.{name}" for name in REFUSED),
        *("air.airlight", "air.airlight_scale", "air.particle_contrast", "air.particle_reach_m"),
        "image.signal",
        *("receiver.cfa_index", "receiver.keep_truth", "receiver.row_time_s"),
    )
    writes: ClassVar[tuple[str, ...]] = ParticleVeil.writes

    def __init__(
        self,
        weathers: Sequence[Rain | Snow | Mapping[str, Any]],
        camera: Camera | Mapping[str, Any],
        bank: DrawBank | None = None,
        **options: Any,
    ) -> None:
        super().__init__(weathers, camera, **options)
        if self.options["ego_speed_m_per_s"]:
            raise InputValueError(
                f"BankVeil: a bank holds storms seen at rest; got ego_speed_m_per_s="
                f"{self.options['ego_speed_m_per_s']:g}. {ADVICE}"
            )
        if self.options["variant"] is not None:
            raise InputValueError(f"BankVeil: a bank has no variant; got {self.options['variant']!r}. {ADVICE}")
        if bank is not None and len(self.parts) != 1:
            raise InputValueError(
                f'BankVeil: a bank is of one weather; got {len(self.parts)}. Give quality="training", which takes a '
                "bank for each."
            )
        self.banks = [self._bank(number) if bank is None else bank for number in range(len(self.parts))]
        if bank is not None:
            self._check_bank(bank)

    def variates_at_rate(
        self, batch: int, written: frozenset[str] | None
    ) -> tuple[tuple[Variate, ...], list[bool] | None]:
        """The same at any rate."""
        return self.variates(), None

    @classmethod
    def of(cls, weather: Weather, nuisances: Mapping[str, object], quality: str | DrawBank) -> Callable[..., BankVeil]:
        """Constructor of the stage in a weather.

        Args:
            weather: whose rates alone may be distributions; fog is refused, in which particles would fade.
            nuisances: of the transform; those of the camera would ask for a bank for each sample.
            quality: ``training``, or the bank.
        """
        if any(isinstance(part, Fog) for part in weather.parts):
            raise InputValueError(f"BayerWeather: training quality has no fog with rain or snow. {ADVICE}")
        _refuse_other_draws(weather)
        for name in nuisances:
            if name.startswith("sensor."):
                raise InputValueError(f"BayerWeather: a bank is of one camera; got a distribution for {name}. {ADVICE}")
        return partial(cls, bank=quality if isinstance(quality, DrawBank) else None)

    def _bank_values(self, number: int) -> dict[str, Any]:
        part = self.parts[number]
        return {
            "near_m": part.near_m,
            "far_m": part.far_m,
            "min_listed_coverage": self.options["min_listed_coverage"],
            "max_listed_density": self.options["max_listed_density"],
            "rate_capacity_mm_per_h": part.rate_capacity_mm_per_h,
        }

    def _bank(self, number: int) -> DrawBank:
        weather = _without_rate(self.parts[number].weather)
        return _bank_of(weather, self.camera, tuple(self._bank_values(number).items()))

    def _check_bank(self, bank: DrawBank) -> None:
        if not isinstance(bank, DrawBank):
            raise InputTypeError(f"BankVeil: bank must be a DrawBank; got {type(bank).__name__}.")
        own = {**self._bank_values(0), "camera": self.camera, "weather": _without_rate(self.parts[0].weather)}
        for name, value in own.items():
            if name == "rate_capacity_mm_per_h":
                if value <= bank.rate_capacity_mm_per_h:
                    continue
            elif getattr(bank, name) == value:
                continue
            raise InputValueError(
                f"BankVeil: the bank was built for {name}={getattr(bank, name)!r}; the transform has {value!r}. Build "
                "the bank with the transform's values."
            )

    def at_ego_speed(self, ego_speed_m_per_s: float) -> ParticleVeil:
        """Refused unless the vehicle stands: a bank's storms are seen at rest."""
        if ego_speed_m_per_s == 0.0:
            return self
        raise InputValueError(
            f"BankVeil: a bank holds storms seen at rest; got ego_speed_m_per_s={ego_speed_m_per_s:g}. {ADVICE}"
        )

    def next_frame(
        self,
        noise: Mapping[str, Tensor],
        size: tuple[int, int],
        interval_s: float,
        seeds: Sequence[int],
        name: str,
        frame: int,
    ) -> dict[str, Tensor]:
        """Refused: the particles of a bank do not move from frame to frame."""
        raise InputValueError(f"BankVeil: particles of a bank do not move from frame to frame. {ADVICE}")

    def variates(self) -> tuple[Variate, ...]:
        """Displacements and mirroring of the storms of each kind."""
        return tuple(bank.variate() for bank in self.banks)

    def prepare(self, weather: Weather) -> None:
        """Render the storms of all rates that may be drawn of a weather now, before workers start.

        Args:
            weather: whose rates may be distributions.
        """
        _refuse_other_draws(weather)
        for part in weather.parts:
            for bank in self.banks:
                if part.kind == bank.weather.kind and isinstance(part, (Rain, Snow)):
                    rate: Any = part.random.get("rate_mm_per_h", part.rate_mm_per_h)
                    values = [float(one) for one in (rate.ends() if isinstance(rate, Distribution) else [rate])]
                    if max(values) > 0:
                        bank.prepare(min(values), max(values))

    def in_airlight(self, airlight: Any) -> BankVeil:
        """The same particles in another airlight, as of `BayerWeather`."""
        other = copy.copy(self)
        other.given_ambient = airlight_argument(airlight, self)
        return other

    def colours(self, state: CameraState) -> list[Tensor]:
        """Linear colour of each kind of particles, ``(B, 3)`` each."""
        return self._colours(state)

    def optical_depth(self, state: CameraState, noise: Mapping[str, Tensor]) -> Tensor:
        """Optical depth of all particles in front of the scene, ``(B, 1, H, W)``; ``forward`` covers 1 less its exp."""
        return torch.stack(self._depths(state, noise)).sum(0)

    def _depths(self, state: CameraState, noise: Mapping[str, Tensor]) -> list[Tensor]:
        """Optical depth of each kind, ``(B, 1, H, W)`` each."""
        self._refuse(state)
        height, width = state.image.signal.shape[-2:]
        depth_m = state.scene.depth_m
        if state.scene.sky is not None:
            depth_m = torch.where(state.scene.sky > 0.5, torch.inf, depth_m)
        if state.air.particle_reach_m is not None:
            depth_m = torch.minimum(depth_m, state.air.particle_reach_m.view(-1, 1, 1, 1))
        depth_m = depth_m.detach().float().expand(state.batch, 1, height, width).cpu()
        found = []
        for part, bank in zip(self.parts, self.banks, strict=True):
            rates = part.rate_mm_per_h.detach().float().reshape(-1).expand(state.batch).tolist()
            places = noise[bank.variate().name]
            each = [
                bank.optical_depth(depth_m[row, 0], rate, places[row].float().cpu()) for row, rate in enumerate(rates)
            ]
            optical = torch.stack(each)[:, None].to(state.image.signal.device)
            found.append(optical * state.scene.ray_per_depth.float())
        return found

    def _refuse(self, state: CameraState) -> None:
        if is_exporting():
            raise InputValueError(f"BankVeil: a bank is not part of a graph. {ADVICE}")
        for name, what in REFUSED.items():
            if getattr(state.air, name) is not None:
                raise InputValueError(f"BankVeil: training quality has no {what}. {ADVICE}")
        if state.receiver.row_time_s is not None:
            raise InputValueError(f"BankVeil: training quality has no rolling shutter. {ADVICE}")

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The frame behind its particles."""
        with one_thread_an_operation():
            return self._render(state, noise)

    def _render(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        if state.image.signal.numel() == 0:
            return state.changed(particle_mask=state.one_plane if state.receiver.keep_truth else None)
        depths = self._depths(state, noise)
        colours = [state.per_pixel(colour) for colour in self._colours(state)]
        total = torch.stack(depths).sum(0)
        mask = -torch.expm1(-total).to(state.image.signal.dtype)
        if state.scene.near_mask is not None:  # nothing falls between the lens and the own vehicle
            mask = mask * (1.0 - state.scene.near_mask.to(mask.dtype))
        light: Tensor = colours[0]
        if len(colours) > 1:
            each = [state.by_cells(depth) * colour for depth, colour in zip(depths, colours, strict=True)]
            light = torch.stack(each).sum(0) / state.by_cells(total).clamp_min(FAINTEST)
        contrast = state.air.particle_contrast
        weight = state.by_cells(mask) if contrast is None else state.by_cells(mask) * contrast.view(-1, 1, 1, 1, 1)
        signal = torch.lerp(state.by_cells(state.image.signal), light.to(mask.dtype), weight).flatten(2, 3)
        if contrast is not None:
            signal = torch.where(contrast.view(-1, 1, 1, 1) == 1, signal, signal.clamp(0.0, 1.0))
        return state.changed(signal=signal, particle_mask=mask if state.receiver.keep_truth else None)


def _refuse_other_draws(weather: Weather) -> None:
    for part in weather.parts:
        for name in set(part.random) - {part.intensity_name}:
            raise InputValueError(
                f"BayerWeather: a bank is of one {part.kind} at any rate; got a distribution for {name}. {ADVICE}"
            )


def _without_rate(weather: Rain | Snow) -> Rain | Snow:
    return replace(weather, rate_mm_per_h=1.0)


@lru_cache(maxsize=32)
def _bank_of(weather: Rain | Snow, camera: Camera, values: tuple[tuple[str, Any], ...]) -> DrawBank:
    return DrawBank.shared(weather, camera, **dict(values))
