"""RandomWeather, RandomRain, RandomFog, RandomSnow: weather on photographs in one line."""

from __future__ import annotations

import warnings
import zlib
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.picture_types import is_picture, picture_tensor
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.sensor_fit import fit_camera
from torchweather.camera.transform import BayerWeather
from torchweather.compose.compose import Compose
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Choice, Distribution, LogUniform
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning, check_between
from torchweather.core.random import sample_seed

__all__ = ["RandomFog", "RandomRain", "RandomSnow", "RandomWeather"]

Values = float | tuple[float, float] | Distribution
DEFAULT_CAMERA = "lucid-triton"
KEPT_SIZES = 8  # pictures of a loader come in a few sizes
# Moderate to violent rain, light to heavy snow (WMO classes), and fog from thick to what a driver just notices.
RAIN_MM_PER_H, SNOW_MM_PER_H, FOG_MOR_M = LogUniform(1.0, 50.0), LogUniform(0.25, 3.0), LogUniform(50.0, 1000.0)


class RandomWeather(nn.Module):
    """Random weather on photographs: drawn anew for each picture, with the physics of `BayerWeather`.

    It stands in a pipeline of torchvision, kornia (``AugmentationSequential``), albumentations or Hugging Face as any
    other transform does, takes pictures of any size, and gives each back in the type in which it came: tensors
    ``(..., 3, H, W)`` and their subclasses, numpy arrays ``(..., H, W, 3)``, PIL images, and lists of them. What else
    it is called with (boxes, labels) passes through.

    Args:
        weather: a weather whose rate or visibility may be a distribution, or several to choose from; ``None`` among
            them is clear air. Default: rain, fog and snow, each as often as another.
        p: probability that a picture gets weather.
        camera: of the pictures; one of another size is fitted to them with square pixels. A name is a preset. Default:
            ``lucid-triton``, 81 degrees wide.
        depth: of the pictures where a call gives none: metres (one number), a map, a depth source, a function from
            picture to depth, or ``auto``: guessed from the picture. ``None`` is ``auto``, with a warning.
        seed: makes the weather of a picture a function of the seed and its pixels, in any worker and order; ``None``:
            from torch's global generator, which a ``DataLoader`` seeds per worker.
        options: of `BayerWeather`: ``airlight``, ``ego_speed_m_per_s``, ``effects``, ``quality`` and others.
            Distributions in them are drawn for each picture: ``airlight=Uniform(0.3, 0.95)``. With
            ``quality="training"`` call `prepare` before the workers of a loader start.

    Note:
        Where the depth is known (a renderer, LiDAR, stereo), give it: it decides the result. Put the transform in front
        of crops and flips, while the picture still is what the camera saw.

    Example:
        >>> weather = RandomWeather([Rain(rate_mm_per_h=(5, 50)), Fog(mor_m=200)], p=1.0, depth=30.0, airlight=0.7)
        >>> picture = torch.full((3, 24, 32), 0.4)
        >>> weather(picture, seed=1).shape
        torch.Size([3, 24, 32])
    """

    def __init__(
        self,
        weather: Weather | Choice | Sequence[Weather | None] | None = None,
        *,
        p: float = 0.5,
        camera: Camera | str | None = None,
        depth: Any = None,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        check_arguments(
            "RandomWeather(weather: Weather | Choice | Sequence | None, p: float, camera: Camera | str | None, "
            "seed: int | None)",
            weather,
            p,
            camera,
            seed,
        )
        super().__init__()
        check_between("p", p, 0.0, 1.0, owner=self)
        if weather is None:
            weather = [Rain(rate_mm_per_h=RAIN_MM_PER_H), Fog(mor_m=FOG_MOR_M), Snow(rate_mm_per_h=SNOW_MM_PER_H)]
        self.weather, self.p, self.depth, self.seed, self.options = weather, float(p), depth, seed, options
        self.camera = Camera.of(DEFAULT_CAMERA if camera is None else camera)
        self._composed: OrderedDict[tuple[int, int], Compose] = OrderedDict()
        self._warned = False
        # Wrong weathers and options are refused here; storms of training quality are rendered for a picture's size.
        self._transform(self.camera)
        Compose({"image": self._transform(self.camera, quality="exact")}, weather=self.weather, p=self.p)

    def extra_repr(self) -> str:
        """The weathers and how often they come."""
        training = "" if self.options.get("quality", "exact") == "exact" else ", quality='training'"
        return f"{self.weather!r}, p={self.p:g}{training}"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_composed": OrderedDict()}

    def forward(
        self,
        picture: Any,
        *others: Any,
        depth: Any = None,
        seed: int | None = None,
        generator: torch.Generator | None = None,
    ) -> Any:
        """The picture, or each one of a batch or list, in a weather of its own.

        Args:
            picture: a tensor ``(..., 3, H, W)``, a numpy array ``(..., H, W, 3)``, a PIL image, or a list of them;
                uint8 or float in 0..1.
            others: boxes, labels and what else belongs to it; they come back as they are.
            depth: ``(..., 1, H, W)`` or ``(H, W)`` metres along the optical axis, infinity is sky, tensor or array.
            seed: of the picture; of a batch's or list's first one, which the others follow by 1.
            generator: gives one integer a picture; ``None``: as the constructor's ``seed`` says.

        Returns:
            What came, in weather; a tuple with the others where there are any.
        """
        if isinstance(picture, (list, tuple)) and picture and all(is_picture(one) for one in picture):
            seeds = [None if seed is None else seed + number for number in range(len(picture))]
            depths = [None] * len(picture) if depth is None else list(depth)
            if len(depths) != len(picture):
                raise InputValueError(
                    f"{type(self).__name__}: depth must hold a map for each of {len(picture)} pictures; got "
                    f"{len(depths)}."
                )
            each = [self._one(*one, generator) for one in zip(picture, depths, seeds, strict=True)]
            result: Any = type(picture)(each)
        else:
            result = self._one(picture, depth, seed, generator)
        return (result, *others) if others else result

    def _one(self, picture: Any, depth: Any, seed: int | None, generator: torch.Generator | None) -> Any:
        """A picture, or a batch of one size."""
        rgb, back = picture_tensor(picture, type(self).__name__)
        if rgb.ndim < 3 or rgb.shape[-3] != 3:
            raise InputValueError(
                f"{type(self).__name__}: a picture must be (..., 3, H, W); got {tuple(rgb.shape)}. Grey pictures: "
                "picture.expand(3, -1, -1)."
            )
        if rgb.numel() == 0:
            return picture
        flat = rgb.reshape(-1, *rgb.shape[-3:]) if rgb.ndim > 4 else rgb
        sample = {"image": flat}
        given = self._depth(depth, flat)
        if given is not None:
            sample["depth"] = given
        else:
            self._note_a_guess()
        compose = self._compose(*flat.shape[-2:])
        if seed is None and generator is None and self.seed is not None:
            pictures = [flat] if flat.ndim == 3 else list(flat)
            draws = [compose.draw({"image": one}, seed=self._seed_of(one)) for one in pictures]
            draw: Any = draws if flat.ndim == 4 else draws[0]
        else:
            draw = compose.draw(sample, seed=seed, generator=generator)
        result = compose(sample, draw=draw)["image"]
        if result is flat:
            return picture  # no weather: what came, untouched
        return back(result.reshape(rgb.shape))

    def _depth(self, depth: Any, flat: Tensor) -> Tensor | None:
        """A given depth, ``(1, H, W)`` or ``(B, 1, H, W)`` as the pictures are."""
        if depth is None:
            return None
        found = torch.from_numpy(np.ascontiguousarray(depth)) if isinstance(depth, np.ndarray) else depth
        if not isinstance(found, Tensor):
            raise InputTypeError(
                f"{type(self).__name__}: depth must be a tensor or array of metres; got {type(depth).__name__}. A "
                "number, a depth source or a function goes to the constructor."
            )
        found = found if found.is_floating_point() else found.float()
        found = found[None] if found.ndim == 2 else found
        if flat.ndim == 4 and found.ndim == 3:
            # One map for all pictures, or a map (H, W) for each.
            one = found.shape[0] == 1 or found.shape[0] != flat.shape[0]
            found = found.expand(flat.shape[0], *found.shape) if one else found[:, None]
        return found.reshape(-1, *found.shape[-3:]) if flat.ndim == 4 else found

    def _seed_of(self, picture: Tensor) -> int:
        """The integer of a picture: the same wherever and whenever it comes."""
        pixels = picture.detach().cpu().contiguous().numpy()
        return sample_seed(int(self.seed or 0), zlib.crc32(pixels.tobytes()))

    def _note_a_guess(self) -> None:
        if self.depth is None and not self._warned:
            self._warned = True
            warnings.warn(
                f"{type(self).__name__}: no depth: it is guessed from the pictures. Give depth= where it is known, or "
                "depth='auto' to accept the guess.",
                TorchweatherWarning,
                stacklevel=4,
            )

    def prepare(self, height: int, width: int) -> None:
        """Make ready for pictures of a size; with ``quality="training"`` all storms are rendered now, some 10 s.

        Call it before the workers of a ``DataLoader`` start: they then share the storms.
        """
        check_arguments("RandomWeather.prepare(height: int, width: int)", height, width)
        self._compose(int(height), int(width))

    def _transform(self, camera: Camera, **others: Any) -> AsBayer:
        depth = "auto" if self.depth is None else self.depth
        first = self.weather if isinstance(self.weather, Weather) else _first(self.weather)
        return AsBayer(BayerWeather(first.densest(), camera, depth=depth, **{**self.options, **others}))

    def _compose(self, height: int, width: int) -> Compose:
        """The transform for pictures of a size; the last sizes are kept."""
        size = (height, width)
        if size not in self._composed:
            transform = self._transform(fit_camera(self.camera, width, height).camera)
            self._composed[size] = Compose({"image": transform}, weather=self.weather, p=self.p)
            if len(self._composed) > KEPT_SIZES:
                self._composed.popitem(last=False)
        self._composed.move_to_end(size)
        return self._composed[size]


def _first(weathers: Choice | Sequence[Weather | None]) -> Weather:
    """The first weather that is not clear air."""
    values = weathers.values if isinstance(weathers, Choice) else weathers
    found = next((one for one in values if isinstance(one, Weather)), None)
    if found is None:
        raise InputValueError(f"RandomWeather: weather must hold a Rain, Fog, Snow or Mixture; got {weathers!r}.")
    return found


class RandomRain(RandomWeather):
    """Rain of a random rate on photographs; arguments as `RandomWeather`.

    Args:
        rate_mm_per_h: one number, ``(low, high)`` or a distribution. Default: log-uniform, 1 to 50 mm/h.

    Example:
        >>> rainy = RandomRain(rate_mm_per_h=(5, 50), p=1.0, depth=30.0, airlight=0.7)
        >>> rainy(torch.full((3, 24, 32), 100, dtype=torch.uint8), seed=1).dtype
        torch.uint8
    """

    def __init__(self, rate_mm_per_h: Values = RAIN_MM_PER_H, **options: Any) -> None:
        super().__init__(Rain(rate_mm_per_h=rate_mm_per_h), **options)


class RandomFog(RandomWeather):
    """Fog of a random visibility on photographs; arguments as `RandomWeather`.

    Args:
        mor_m: meteorological optical range, metres: one number, ``(low, high)`` or a distribution. Default:
            log-uniform, 50 to 1000 m.

    Example:
        >>> foggy = RandomFog(mor_m=(50, 500), p=1.0, depth=30.0, airlight=0.7)
        >>> bool(foggy(torch.full((3, 24, 32), 0.1), seed=1).mean() > 0.1)
        True
    """

    def __init__(self, mor_m: Values = FOG_MOR_M, **options: Any) -> None:
        super().__init__(Fog(mor_m=mor_m), **options)


class RandomSnow(RandomWeather):
    """Snow of a random rate on photographs; arguments as `RandomWeather`.

    Args:
        rate_mm_per_h: liquid-equivalent: one number, ``(low, high)`` or a distribution. Default: log-uniform, 0.25 to
            3 mm/h.

    Example:
        >>> snowy = RandomSnow(rate_mm_per_h=2.0, p=1.0, depth=30.0, airlight=0.7)
        >>> snowy(torch.full((2, 3, 24, 32), 0.1), seed=1).shape
        torch.Size([2, 3, 24, 32])
    """

    def __init__(self, rate_mm_per_h: Values = SNOW_MM_PER_H, **options: Any) -> None:
        super().__init__(Snow(rate_mm_per_h=rate_mm_per_h), **options)
