"""WeatherTransform: what the transforms of all sensors share: their checks, and noise in and out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchweather.random import flat_noise
from torchweather.sensors import Sensor
from torchweather.stages import Chain
from torchweather.stages.stage import State
from torchweather.weather import Weather

__all__ = ["Sizes", "WeatherTransform"]


@dataclass(frozen=True)
class Sizes:
    """Just enough of a state for drawing."""

    batch: int
    sizes: dict[str, int]


class WeatherTransform(nn.Module):
    """A chain of stages made from a weather and a sensor.

    A subclass says which weathers it ``takes`` and under which name another class ``takes_all``.
    """

    takes: ClassVar[tuple[str, ...]] = ("rain", "fog", "snow")
    takes_all: ClassVar[str] = ""
    weather: Weather
    chain: Chain

    def _check_weather(self, weather: Weather) -> None:
        name = type(self).__name__
        if not isinstance(weather, Weather):
            raise TypeError(f"{name}: weather must be Rain, Fog, Snow or a Mixture; got {type(weather).__name__}.")
        wrong = [part.kind for part in weather.parts if part.kind not in self.takes]
        if wrong:
            raise TypeError(
                f"{name}: takes {' or '.join(self.takes)}; got {', '.join(wrong)}. {self.takes_all} takes all."
            )

    def _check_sensor(self, sensor: object, wanted: type[Sensor], example: str) -> None:
        if not isinstance(sensor, wanted):
            raise TypeError(
                f"{type(self).__name__}: {wanted.kind if wanted.kind == 'camera' else 'sensor'} must be a "
                f"{wanted.__name__}, such as {wanted.__name__}.preset({example!r}); got {sensor!r}."
            )

    def _drawn(
        self,
        batch: Sequence[int],
        sizes: dict[str, int],
        generator: torch.Generator | None,
        seed: int | Tensor | None,
    ) -> dict[str, Tensor]:
        """Noise of the chain, leading with the batch shape."""
        flat_seed = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == tuple(batch) else seed
        drawn = self.chain.draw(Sizes(math.prod(batch), sizes), generator, flat_seed)
        return {key: value.reshape(*batch, *value.shape[1:]) for key, value in drawn.items()}

    def _flat_noise(self, noise: Mapping[str, Tensor], state: State) -> dict[str, Tensor]:
        """The noise that the chain needs, ``(B, ...)``, checked against the sizes of the state."""
        shapes = {
            f"{name}.{variate.name}": variate.sample_shape(state.sizes)
            for name, stage in self.chain.stages.items()
            for variate in stage.variates()
        }
        return flat_noise(noise, shapes, state.batch, owner=self)
