"""HdrWeather: weather on a camera that merges several exposures into one frame of high dynamic range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth import SceneDepth
from torchweather.camera.sensor import Camera
from torchweather.camera.transform import BayerWeather
from torchweather.core.arguments import check_arguments, check_options
from torchweather.core.errors import InputTypeError, InputValueError, check_between
from torchweather.core.random import derived_seed, sample_seeds

__all__ = ["HdrResult", "HdrWeather"]


@dataclass(frozen=True)
class HdrResult:
    """Effect of the weather on a merged frame.

    Args:
        bayer: ``(..., 1, H, W)`` the merged frame.
        exposure: ``(..., 1, H, W)`` int64, number of the exposure that each pixel is from, 0 the longest.
        frames: the frame of each exposure, ``(..., 1, H, W)`` each, before it saturates.
    """

    bayer: Tensor
    exposure: Tensor
    frames: tuple[Tensor, ...]

    sensor: ClassVar[str] = "camera"


class HdrWeather(nn.Module):
    """Weather on an HDR camera: K exposures, one after the other, merged pixel by pixel.

    Every exposure sees its own particles, with the streaks of its own length. A pixel is taken from the longest
    exposure in which it stays below saturation, so dark parts show long faint streaks and bright parts short ones.

    Args:
        weather: ``Rain``, ``Fog``, ``Snow`` or a ``Mixture``.
        camera: its ``exposure_s`` is not looked at.
        exposures_s: exposure times, seconds, two or more, all different.
        saturation: share of an exposure's full scale from which on a pixel is taken from the next shorter one.
        options: of `BayerWeather`, the same for all exposures.

    Note:
        Frames are linear, 1 at the saturation of the *shortest* exposure; an exposure t times as long saturates at
        ``1 / t``. Exposures follow each other by more than a particle takes to leave its pixel, so their particles are
        drawn apart; a split pixel, whose exposures share their beginning, is not modelled. Noise of the exposures is
        not added.

    Example:
        >>> from torchweather.atmosphere.weather import Rain
        >>> camera = Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
        >>> hdr = HdrWeather(Rain(25.0), camera, exposures_s=(0.016, 0.001), depth=30.0, airlight=0.02)
        >>> frame = torch.full((1, 24, 32), 0.01)
        >>> frame[..., 16:] = 0.5
        >>> hdr.run(frame, seed=1).exposure[0, 0, ::31].tolist()
        [0, 1]
    """

    def __init__(
        self,
        weather: Weather,
        camera: Camera,
        *,
        exposures_s: Sequence[float],
        saturation: float = 0.95,
        **options: Any,
    ) -> None:
        super().__init__()
        check_arguments(
            "HdrWeather(weather: Weather, camera: Camera, exposures_s: Sequence[float], saturation: float)",
            weather,
            camera,
            exposures_s,
            saturation,
        )
        times = sorted((float(one) for one in exposures_s), reverse=True)
        if len(times) < 2 or len(set(times)) < len(times):
            raise InputValueError(
                f"HdrWeather: exposures_s must be two or more different times in s; got {tuple(exposures_s)!r}."
            )
        check_between("saturation", saturation, 0.1, 1.0, owner=self)
        check_options("HdrWeather", BayerWeather, options)
        if options.get("exposure_control") is not None:
            raise InputValueError("HdrWeather: exposure_control is of one exposure; scale the merged frame instead.")
        self.exposures_s, self.saturation = tuple(times), float(saturation)
        self.transforms = nn.ModuleList(
            BayerWeather(weather, replace(camera, exposure_s=time), **options) for time in times
        )

    @property
    def full_scales(self) -> tuple[float, ...]:
        """Signal at which each exposure saturates; 1 for the shortest."""
        return tuple(self.exposures_s[-1] / time for time in self.exposures_s)

    def draw(
        self, bayer: Tensor, seed: int | Tensor | None = None, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Noise of all exposures: ``exposure<k>.<stage>.<variate>``, 0 the longest.

        Args:
            bayer: ``(..., 1, H, W)``; only its shape counts.
            seed, generator: as of `BayerWeather`.
        """
        self._check(bayer)
        batch = tuple(bayer.shape[:-3])
        seeds = sample_seeds(batch, generator, seed)
        found: dict[str, Tensor] = {}
        for number, transform in enumerate(self.transforms):
            own = torch.tensor([derived_seed(one, f"exposure{number}") for one in seeds]).reshape(batch)
            drawn = transform.draw(bayer, seed=own)  # type: ignore[operator]
            found.update({f"exposure{number}.{key}": value for key, value in drawn.items()})
        return found

    def forward(
        self,
        bayer: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
    ) -> Tensor:
        """The merged frame ``(..., 1, H, W)``; arguments as of `BayerWeather`, the frame as in the note."""
        return self.run(bayer, depth, noise, seed=seed).bayer

    if TYPE_CHECKING:
        __call__ = forward

    def run(
        self,
        bayer: Tensor,
        depth: Tensor | SceneDepth | None = None,
        noise: Mapping[str, Tensor] | None = None,
        *,
        seed: int | Tensor | None = None,
    ) -> HdrResult:
        """The merged frame, and which exposure each pixel is from."""
        self._check(bayer)
        if noise is None:
            noise = self.draw(bayer, seed=seed)
        elif seed is not None:
            raise InputValueError("HdrWeather: give either noise or seed, not both.")
        frames = []
        for number, transform in enumerate(self.transforms):
            mine = f"exposure{number}."
            own = {key.removeprefix(mine): value for key, value in noise.items() if key.startswith(mine)}
            frames.append(transform(bayer, depth, own))
        merged, exposure = frames[-1], torch.full_like(bayer, len(frames) - 1, dtype=torch.int64)
        for number in reversed(range(len(frames) - 1)):
            longer = frames[number] < self.saturation * self.full_scales[number]
            merged = torch.where(longer, frames[number], merged)
            exposure = torch.where(longer, number, exposure)
        return HdrResult(merged, exposure, tuple(frames))

    def _check(self, bayer: Tensor) -> None:
        check_arguments("HdrWeather(bayer: real(..., 1, H, W))", bayer)
        if not bayer.is_floating_point():
            raise InputTypeError(
                "HdrWeather: expected a linear floating-point frame, 1 at the saturation of the shortest exposure; got "
                f"{bayer.dtype}."
            )
