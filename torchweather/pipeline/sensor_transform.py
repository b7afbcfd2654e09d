"""WeatherTransform: what the transforms of all sensors share: their checks, and noise in and out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeVar, cast

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather, check_intensities
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution, distributions_in, refuse_fixed, with_drawn
from torchweather.core.errors import InputTypeError, InputValueError, check_between
from torchweather.core.noise import flat_noise
from torchweather.core.precision import AtLeastSingle
from torchweather.core.random import keyed_stream, sample_seeds
from torchweather.pipeline.as_built import AsBuilt
from torchweather.pipeline.at_call import weather_at_call
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.effect import effect_from_dict
from torchweather.pipeline.one_by_one import one_by_one
from torchweather.pipeline.options import TransformOptions
from torchweather.pipeline.sensor import Sensor
from torchweather.pipeline.stage import State

__all__ = ["OF_THE_WORLD", "Sizes", "WeatherTransform", "class_for", "draw_nuisances"]

O = TypeVar("O", bound=TransformOptions)  # noqa: E741
S = TypeVar("S", bound=Sensor)
R = TypeVar("R")
SENSOR = "sensor"
"""In front of the names of a sensor's fields among nuisances."""
OF_THE_WORLD = ("airlight", "ego_speed_m_per_s", "layer_top_m")
"""Nuisances of the vehicle and the air: all sensors of a sample draw them from one stream."""
CLEAR = {"rain": Rain(0.0), "fog": Fog(), "snow": Snow(0.0)}
"""Weathers that do nothing, by kind: what a transform holds that waits for the weather of a ``Compose``."""


@dataclass(frozen=True)
class Sizes:
    """Just enough of a state for drawing."""

    batch: int
    sizes: dict[str, int]


class WeatherTransform(AtLeastSingle):
    """A chain of stages made from a weather and a sensor.

    A subclass lists the weathers that it ``takes``; a base class takes the others. It may be built from a weather that
    has yet to be drawn: a call without noise draws one for each sample, and so does ``Compose``. The same holds of its
    nuisance parameters: options, parameters of effects and fields of the sensor that are distributions.
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
    nuisances: Mapping[str, Distribution] = {}
    """Values drawn for each sample beside the weather, by name: ``airlight``, ``effects.camera.exposure_gain.factor``,
    ``sensor.near_full_m``."""
    _given_sensor: Any
    _sensor_is_drawn: bool = False
    waits: bool = False
    """True where it was built without a weather, which ``Compose`` or ``with_weather`` gives."""

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
        """True where a call draws for each sample: a rate or a nuisance is a range, or ``p`` is below 1."""
        return self.p < 1.0 or bool(self.weather.random) or bool(self.nuisances)

    @property
    def draws_alone(self) -> bool:
        """True where something is drawn that all samples of a batch would share: then each sample is computed alone."""
        shared = [name for part in self.weather.parts for name in part.random if name != part.intensity_name]
        return bool(self.nuisances or shared or any(one.random for one in self.weather.conditions))

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
            nothing = not seeds and self.draws_alone
            weather = self.weather.densest() if nothing else weather_at_call(self.weather, self.p, batch, seeds, self)
            drawn = draw_nuisances(self.nuisances, seeds[0] if seeds else 0)
            chosen = self._built_from(weather, drawn, self.own_sensor())
            some = next(self.buffers(), None)
            moved = some is not None and any(one.device != some.device for one in chosen.buffers())
            chosen = chosen.to(some.device) if some is not None and moved else chosen
        return chosen, torch.tensor(seeds, dtype=torch.int64).reshape(tuple(batch))

    def each_alone(
        self,
        call: Callable[..., R],
        data: Tensor,
        seed: int | Tensor | None,
        generator: torch.Generator | None,
        beside: Mapping[str, Any],
        dimensions: int,
    ) -> R:
        """Result of a call for a batch whose samples each have nuisances of their own.

        Args:
            call: ``forward`` or ``run`` of this transform, or of one around it.
            data: with the batch in front.
            seed, generator: as of `at_call`.
            beside: other arguments of the call.
            dimensions: of the data of one sample.
        """
        batch = tuple(data.shape[: data.ndim - dimensions])
        flat = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == batch else seed
        seeds = sample_seeds(batch, generator, flat)
        sizes = {**self.extra_inputs, "reach_m": 1, "out": 3}
        listed = getattr(self.options, "lost", "") == "drop"
        found: R = one_by_one(call, data, seeds, beside, sizes, dimensions=dimensions, listed=listed)
        return found

    def must_draw(
        self, noise: Mapping[str, Tensor] | None, seed: int | Tensor | None, generator: torch.Generator | None
    ) -> bool:
        """True if a call must draw by `at_call` first."""
        self.refuse_waiting()
        if noise is None:
            return seed is not None or generator is not None or self.is_random
        if seed is not None or generator is not None:
            raise InputValueError(
                f"{type(self).__name__}: noise is drawn already; seed and generator are for a call that draws it. "
                "Pass noise, or one of the others."
            )
        return False

    def refuse_undrawn(self, batch: Sequence[int]) -> None:
        """Raise where weather or nuisances have yet to be drawn, or do not fit the batch."""
        check_intensities(self.weather, batch, owner=self)
        self.refuse_nuisances()

    def refuse_waiting(self) -> None:
        """Raise where there is no weather yet."""
        if self.waits:
            raise InputValueError(
                f"{type(self).__name__}: it was built without a weather. Give it one, with_weather(Rain(10)), or give "
                "the transform to Compose(weather=...)."
            )

    def refuse_nuisances(self) -> None:
        """Raise where there is no weather, or nuisances have yet to be drawn."""
        self.refuse_waiting()
        for name, one in self.nuisances.items():
            raise InputValueError(
                f"{type(self).__name__}: {name} must be a value here; got {one!r}. Call the transform without noise, "
                "or Compose, which draw one for each sample."
            )

    def _fixed(self, weather: Weather | None, options: O, sensor: S) -> tuple[O, S]:
        """Options and sensor without distributions, to build the chain from; those as given are kept.

        A transform whose nuisances are yet to be drawn is built with the first end of each.
        """
        effects = options.effects
        if isinstance(effects, Sequence) and any(isinstance(one, Mapping) and _is_drawn(one) for one in effects):
            built = [effect_from_dict(one) if isinstance(one, Mapping) and _is_drawn(one) else one for one in effects]
            options = replace(options, effects=built)
        refuse_fixed(options.arguments(), options.fixed, type(self).__name__)
        self.options, self._given_sensor = options, sensor
        of_sensor = distributions_in(sensor, SENSOR) if isinstance(sensor, Sensor) else {}
        self.nuisances, self._sensor_is_drawn = {**options.random, **of_sensor}, bool(of_sensor)
        if not self.nuisances:
            return options, sensor
        first = {
            name: max(one.ends(), key=abs) if name in options.ahead else one.ends()[0]
            for name, one in self.nuisances.items()
        }
        self._check_ends(weather.densest() if isinstance(weather, Weather) else CLEAR[self.takes[0]], first)
        return options.with_drawn(_of_options(first)), with_drawn(sensor, first, SENSOR)

    def _check_ends(self, weather: Weather, first: Mapping[str, Any]) -> None:
        """Raise where an end of an option is refused, with the range; effects and sensors have checked their own."""
        for name, one in self.nuisances.items():
            if name.startswith((f"{SENSOR}.", "effects.")):
                continue
            for end in one.ends():
                if end is not None and not isinstance(end, (str, bool, int, float, list, tuple, Mapping)):
                    raise InputTypeError(
                        f"{type(self).__name__}: values of {name} that are drawn must be numbers or text; got {end!r}. "
                        "Plain values can be recorded and replayed."
                    )
                try:
                    self._built_from(weather, {**first, name: end}, self._given_sensor)
                except (TypeError, ValueError) as error:
                    named = [f"{key}={law!r}" for key, law in self.nuisances.items() if key.split(".")[0] in str(error)]
                    raise type(error)(
                        f"{error} It is an end of {', '.join(named)}." if named else str(error)
                    ) from error

    def _check_p(self, p: float) -> None:
        check_between("p", p, 0.0, 1.0, owner=self)
        self.p = float(p)

    def own_sensor(self) -> Sensor:
        """The sensor that the transform was built for, with its distributions."""
        sensor = self._given_sensor if self._sensor_is_drawn else self.sensor
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

    def renewed(self, weather: Weather) -> Self | None:
        """The transform for a weather that differs by its intensity alone, sharing all else with this one.

        ``None`` where it must be built anew.
        """
        return None

    def _built_from(self, weather: Weather, drawn: Mapping[str, Any], sensor: Any) -> Self:
        """The transform for a weather that all samples get, with values of its nuisances."""
        kind: Any = type(self)
        options = self.options.with_drawn(_of_options(drawn)) if drawn else self.options
        built: Self = kind(weather, with_drawn(sensor, drawn, SENSOR), **{**options.arguments(), "p": 1.0})
        return built

    def _built_for(self, weather: Weather) -> WeatherTransform:
        kind: Any = class_for(type(self), weather)
        built: WeatherTransform = kind(weather, self.own_sensor(), **self.options.arguments())
        return built

    def _check_weather(self, weather: Weather | None) -> Weather:
        """The weather; clear air where none is given yet."""
        name = type(self).__name__
        if weather is None:
            self.waits = True
            return CLEAR[self.takes[0]]
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
        return weather

    def drawn(
        self,
        batch: Sequence[int],
        sizes: dict[str, int],
        generator: torch.Generator | None,
        seed: int | Tensor | None,
        *,
        at_rate: bool = False,
        keyed: bool = False,
    ) -> dict[str, Tensor]:
        """Noise of the chain for named sizes, leading with the batch shape; the rest as in ``Chain.draw``."""
        flat_seed = seed.reshape(-1) if isinstance(seed, Tensor) and seed.shape == tuple(batch) else seed
        drawn = self.chain.draw(Sizes(math.prod(batch), sizes), generator, flat_seed, at_rate=at_rate, keyed=keyed)
        return {key: value.reshape(*batch, *value.shape[1:]) for key, value in drawn.items()}

    def draw_for_call(self, value: Tensor, seed: int) -> dict[str, Tensor]:
        """Noise of one sample for one call: what the present rates need, where a draw may serve others too."""
        noise: dict[str, Tensor] = cast(Any, self).draw(value, seed=seed)
        return noise

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


def draw_nuisances(nuisances: Mapping[str, Distribution], seed: int, of_sensor: int | None = None) -> dict[str, Any]:
    """A value for each nuisance, each from a stream of its own.

    Args:
        nuisances: name to distribution.
        seed: of the sample; gives what all its sensors share, `OF_THE_WORLD`.
        of_sensor: of the sample's sensor; gives the others. ``None``: the sample's.

    Example:
        >>> from torchweather.core.distributions import Uniform
        >>> drawn = draw_nuisances({"airlight": Uniform(0.5, 0.9)}, seed=7)
        >>> drawn == draw_nuisances({"airlight": Uniform(0.5, 0.9)}, seed=7, of_sensor=3)
        True
    """
    own = seed if of_sensor is None else of_sensor
    return {
        name: one.at(
            float(keyed_stream(seed if name.partition(".")[0] in OF_THE_WORLD else own, f"nuisance.{name}").random())
        )
        for name, one in nuisances.items()
    }


def _is_drawn(effect: Mapping[str, Any]) -> bool:
    """True where a dictionary of an effect has a parameter that is drawn."""
    return any(isinstance(one, (Mapping, Distribution)) for one in effect.values())


def _of_options(drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Those nuisances that are options."""
    return {name: value for name, value in drawn.items() if not name.startswith(SENSOR + ".")}


def class_for(kind: type[WeatherTransform], weather: Weather) -> type[WeatherTransform]:
    """The class; for a weather that it does not take, the nearest of its base classes that does."""
    for base in kind.__mro__:
        takes = getattr(base, "takes", ())
        if all(part.kind in takes for part in weather.parts):
            return base
    raise InputTypeError(f"{kind.__name__}: no class takes {type(weather).__name__}.")
