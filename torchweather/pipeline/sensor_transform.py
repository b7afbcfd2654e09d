"""WeatherTransform: what the transforms of all sensors share: their checks, and noise in and out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Weather
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_between
from torchweather.core.noise import flat_noise
from torchweather.core.precision import AtLeastSingle
from torchweather.core.random import sample_seeds
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.at_call import weather_at_call
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.options import TransformOptions
from torchweather.pipeline.sensor import Sensor
from torchweather.pipeline.stage import State

__all__ = ["Sizes", "WeatherTransform", "class_for"]


@dataclass(frozen=True)
class Sizes:
    """Just enough of a state for drawing."""

    batch: int
    sizes: dict[str, int]


class WeatherTransform(AtLeastSingle):
    """A chain of stages made from a weather and a sensor.

    A subclass lists the weathers that it ``takes``; a base class takes the others. It may be built from a weather that
    has yet to be drawn: a call without noise draws one for each sample, and so does ``Compose``.
    """

    takes: ClassVar[tuple[str, ...]] = ("rain", "fog", "snow")
    takes_all: ClassVar[str] = ""
    sensor_class: ClassVar[type[Sensor]]
    """Class of the sensor that it is built for."""
    extra_inputs: ClassVar[Mapping[str, int]] = {}
    """Arguments of a call beside the data and the noise, and their dimensions in one sample."""
    data_shape: tuple[str, ...]
    """Dimensions of the data of one sample."""
    weather: Weather
    chain: Chain
    options: TransformOptions
    """Keyword arguments of the constructor, with which it can be built for another weather."""
    as_built: AsBuilt
    """Record of the chain at the end of the constructor; a subclass that changes the chain in its own records again."""
    p: float = 1.0
    """Probability that a sample gets the weather."""

    def with_weather(self, weather: Weather) -> WeatherTransform:
        """The same transform for another weather; tables that both need are shared.

        Args:
            weather: of any kind; where this class does not take it, the result is of the class that takes all.

        Raises:
            ValueError: the chain was changed after the transform was built.

        Example:
            >>> import torchweather as tw
            >>> rain = tw.LidarRain(tw.Rain(10), tw.Lidar.preset("velodyne-hdl-64e"), lost="nan")
            >>> rain.with_weather(tw.Fog(mor_m=50)).lost
            'nan'
        """
        check_arguments("LidarWeather.with_weather(weather: Weather)", weather)
        self.refuse_changes()
        return self._built_for(weather)

    @property
    def is_random(self) -> bool:
        """True where a call draws a weather for each sample: a rate is a range, or ``p`` is below 1."""
        return self.p < 1.0 or bool(self.weather.random)

    def at_call(
        self, batch: Sequence[int], seed: int | Tensor | None, generator: torch.Generator | None
    ) -> tuple[Self, Tensor]:
        """The transform with the weather of one call, and the integer of each sample.

        Args:
            batch: shape of the batch.
            seed: the integers: a tensor of the batch shape, or one integer s for s, s + 1, ...
            generator: gives one integer a sample; ``None`` is torch's global generator.
        """
        flat = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == tuple(batch) else seed
        seeds = sample_seeds(tuple(batch), generator, flat)
        chosen = self
        if self.is_random:
            self.refuse_changes()
            weather = weather_at_call(self.weather, self.p, batch, seeds, self)
            kind: Any = type(self)
            chosen = kind(weather, self.own_sensor(), **{**self.options.arguments(), "p": 1.0})
            some = next(self.buffers(), None)
            chosen = chosen if some is None else chosen.to(some.device)
        return chosen, torch.tensor(seeds, dtype=torch.int64).reshape(tuple(batch))

    def must_draw(
        self, noise: Mapping[str, Tensor] | None, seed: int | Tensor | None, generator: torch.Generator | None
    ) -> bool:
        """Whether a call must draw by `at_call` first."""
        if noise is None:
            return seed is not None or generator is not None or self.is_random
        if seed is not None or generator is not None:
            raise InputValueError(
                f"{type(self).__name__}: noise is drawn already; seed and generator are for a call that draws it. "
                "Pass noise, or one of the others."
            )
        return False

    def _check_p(self, p: float) -> None:
        check_between("p", p, 0.0, 1.0, owner=self)
        self.p = float(p)

    def own_sensor(self) -> Sensor:
        """The sensor that the transform was built for."""
        sensor = self.sensor
        assert isinstance(sensor, Sensor)
        return sensor

    def refuse_changes(self) -> None:
        """Raise where the chain was changed after the transform was built: the change would be lost in another build.

        Raises:
            ValueError: a stage, a parameter or a buffer is not what the constructor makes.
        """
        changed = self.as_built.changed(self.chain)
        if changed:
            name = type(self).__name__
            raise InputValueError(f"{name}: {changed}; it cannot be built anew. Give changes as effects=[...].")

    def _built_for(self, weather: Weather) -> WeatherTransform:
        kind: Any = class_for(type(self), weather)
        built: WeatherTransform = kind(weather, self.own_sensor(), **self.options.arguments())
        return built

    def _check_weather(self, weather: Weather) -> None:
        name = type(self).__name__
        if not isinstance(weather, Weather):
            raise InputTypeError(
                f"{name}: weather must be Rain, Fog, Snow or a Mixture, such as Rain(rate_mm_per_h=10); "
                f"got {weather!r}."
            )
        wrong = [part.kind for part in weather.parts if part.kind not in self.takes]
        if wrong:
            raise InputTypeError(
                f"{name}: takes {' or '.join(self.takes)}; got {', '.join(wrong)}. {self.takes_all} takes all."
            )

    def drawn(
        self,
        batch: Sequence[int],
        sizes: dict[str, int],
        generator: torch.Generator | None,
        seed: int | Tensor | None,
        *,
        at_rate: bool = False,
    ) -> dict[str, Tensor]:
        """Noise of the chain for named sizes, leading with the batch shape; ``at_rate`` as in ``Chain.draw``."""
        flat_seed = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == tuple(batch) else seed
        drawn = self.chain.draw(Sizes(math.prod(batch), sizes), generator, flat_seed, at_rate=at_rate)
        return {key: value.reshape(*batch, *value.shape[1:]) for key, value in drawn.items()}

    def _flat_noise(
        self, noise: Mapping[str, Tensor], state: State, batch: Sequence[int] | None = None
    ) -> dict[str, Tensor]:
        """The noise that the chain needs, ``(B, ...)``, checked against the state and the batch shape of the data."""
        variates = {
            f"{name}.{variate.name}": variate
            for name, stage in self.chain.stages.items()
            for variate in stage.variates()
        }
        return flat_noise(noise, variates, state.sizes, (state.batch,) if batch is None else batch, owner=self)


def class_for(kind: type[WeatherTransform], weather: Weather) -> type[WeatherTransform]:
    """The class; for a weather that it does not take, the nearest of its base classes that does."""
    for base in kind.__mro__:
        takes = getattr(base, "takes", ())
        if all(part.kind in takes for part in weather.parts):
            return base
    raise InputTypeError(f"{kind.__name__}: no class takes {type(weather).__name__}.")
