"""Compose: one weather on all sensors of a sample."""

from __future__ import annotations

import json
import warnings
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Weather, weather_from_dict
from torchweather.camera.depth import SceneDepth
from torchweather.camera.particles.bank import DrawBank
from torchweather.compose.samples import as_tensor, data_of, like, like_batch, shared
from torchweather.compose.training_quality import prepared_banks, weather_at_any_rate, with_any_airlight
from torchweather.compose.transform_spec import TransformSpec, spec_of
from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Choice
from torchweather.core.errors import InputTypeError, InputValueError, check_between, nearest_name
from torchweather.core.random import derived_seed, draw_variates, keyed_stream, sample_seed, sample_seeds
from torchweather.pipeline.sensor_transform import WeatherTransform, draw_nuisances

__all__ = ["Compose", "Draw"]

KEPT = 16  # transforms that were built for a weather, kept for when it comes again
Sample = Mapping[str, Any]


@dataclass(frozen=True)
class Draw:
    """Draw of a sample, by which it can be given the same weather again.

    Args:
        seed: from which the particles of every sensor follow, 63 bits.
        weather: plain values, as ``weather_from_dict`` takes them; ``None`` is clear air: the sample stays as it is.
        nuisances: key of the sample to the values that its transform drew beside the weather, by name:
            ``{"image": {"airlight": 0.7, "effects.camera.exposure_gain.factor": 1.1}}``.
        quality: ``training`` where particles come from a bank (`DrawBank`); ``None`` is exact.

    Example:
        >>> Draw.from_dict(json.loads(json.dumps(Draw(7, {"kind": "rain", "rate_mm_per_h": 25.0}).to_dict()))).seed
        7
    """

    seed: int
    weather: Mapping[str, Any] | None
    nuisances: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    quality: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; ``nuisances`` and ``quality`` where there are any."""
        values: dict[str, Any] = {"seed": self.seed, "weather": None if self.weather is None else dict(self.weather)}
        if self.nuisances:
            values["nuisances"] = {key: dict(one) for key, one in self.nuisances.items()}
        return values if self.quality is None else {**values, "quality": self.quality}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Draw:
        """The inverse of ``to_dict``."""
        if set(values) - {"nuisances", "quality"} != {"seed", "weather"}:
            raise InputValueError(
                "Draw: expected seed and weather, perhaps nuisances and quality; got "
                f"{', '.join(map(str, values)) or 'nothing'}."
            )
        return cls(int(values["seed"]), values["weather"], values.get("nuisances", {}), values.get("quality"))


class Compose(nn.Module):
    """One weather on all sensors of a sample: drawn once, with particles of its own before each sensor.

    Args:
        transforms: key of the sample to the transform of what is there: ``BayerRain`` and its like, ``AsBayer`` around
            one, ``LidarRain`` and its like, ``RadarAttenuation``, ``RadarMapWeather``. With ``weather`` they need none
            of their own: ``BayerWeather(None, camera)``.
        weather: what all of them get, in place of what each was built with: a ``Weather``, whose numbers may be
            distributions; or a list or ``Choice`` of weathers, ``None`` among them for clear air. ``None``: what the
            transforms were built with, which must then be the same for all.
        p: probability that a sample gets weather at all.
        depth: key of the depth map or ``SceneDepth``, for cameras; where the sample has none, a camera's own depth
            source is taken.
        inputs: other arguments of the transforms by name, to keys of the sample, for each key that needs them:
            ``{"points": {"directions": "beams"}, "front": {"depth": "front_depth"}}``.
        seed: of all samples; needs ``sample_key``.
        sample_key: key of the sample's own name (a token, a file name, a number): with it the same sample gets the
            same weather in the same epoch, whatever the worker. ``WeatherDataset`` does so by the index.
        history: key under which the draw is put into the sample, as plain values.
        mosaic_clear: RGB images that stay in clear air go through the mosaic, too, where those in weather do
            (``AsBayer(..., through_mosaic=True)``): else a net may learn to tell weather by the demosaicing.

    Note:
        Of a sample all sensors share the weather's numbers, and what effects draw of the air: the gusts of
        ``lidar.patchy_weather`` are the same for all LiDARs, the banks of ``camera.patchy_fog`` for all cameras.
        Options, parameters of effects and fields of sensors that are distributions are drawn for each sample that gets
        weather: airlight, ego speed and top of the fog once for all sensors, the others for each sensor.

        A batch is a sample whose data have one more dimension in front, or are lists of clouds: each of its elements
        gets a weather of its own, exactly as it would alone.

        It returns a new dictionary. Keys that it does not know pass through as they are. Numpy arrays come back as
        numpy arrays.

    Example:
        >>> import torchweather as tw
        >>> lidar = tw.LidarRain(tw.Rain(10), tw.Lidar.preset("velodyne-hdl-64e"))
        >>> stormy = Compose({"points": lidar}, weather=tw.Rain(rate_mm_per_h=(1, 50)), history="weather")
        >>> sample = {"points": torch.tensor([[20.0, 0.0, 0.0, 120.0]]), "token": "a"}
        >>> out = stormy(sample, seed=7)
        >>> out["token"], out["points"].shape, 1 < out["weather"]["weather"]["rate_mm_per_h"] < 50
        ('a', torch.Size([1, 4]), True)
    """

    def __init__(
        self,
        transforms: Mapping[str, nn.Module],
        *more: object,
        weather: Weather | Choice | Sequence[Weather | None] | None = None,
        p: float = 1.0,
        depth: str = "depth",
        inputs: Mapping[str, Mapping[str, str]] | None = None,
        seed: int | None = None,
        sample_key: str | None = None,
        history: str | None = None,
        mosaic_clear: bool = False,
    ) -> None:
        check_arguments(
            "Compose(weather: Weather | Choice | Sequence | None, p: float, depth: str, inputs: Mapping | None, "
            "seed: int | None, sample_key: str | None, history: str | None, mosaic_clear: bool)",
            weather,
            p,
            depth,
            inputs,
            seed,
            sample_key,
            history,
            mosaic_clear,
        )
        super().__init__()
        if more or not isinstance(transforms, Mapping):
            raise InputTypeError(_no_mapping(transforms, more))
        check_between("p", p, 0.0, 1.0, owner=self)
        if (seed is not None) and sample_key is None:
            raise InputValueError(
                "Compose: seed needs sample_key, the key of what differs between samples (a token, a file name, a "
                "number). Or give a seed at each call, or wrap the data set: WeatherDataset(dataset, compose, seed)."
            )
        self.specs = {key: _spec(key, transform) for key, transform in transforms.items()}
        if not self.specs:
            raise InputValueError("Compose: expected a transform for at least one key; got none.")
        check_arguments("Compose(p: float)", p)
        self.weather = _candidates(weather, transforms)
        self.p, self.depth, self.seed, self.sample_key, self.history = float(p), depth, seed, sample_key, history
        self.mosaic_clear = bool(mosaic_clear)
        check_arguments("Compose(inputs: Mapping[str] | None)", inputs)
        for names in (inputs or {}).values():
            check_arguments("Compose(inputs_of_a_key: Mapping[str])", names)
        self.inputs = {key: dict(names) for key, names in (inputs or {}).items()}
        self._check_inputs()
        taken = {
            *self.specs,
            self.depth,
            self.sample_key,
            *(one for names in self.inputs.values() for one in names.values()),
        }
        if history in taken - {None}:
            raise InputValueError(f"Compose: history={history!r} is the key of something else; give it one of its own.")
        self._epoch = shared(torch.zeros((), dtype=torch.int64))
        self._built: OrderedDict[tuple[str, str, str], Any] = OrderedDict()
        self._latest: dict[tuple[str, str], Any] = {}  # of each key and device: others may share all but a rate
        self._banks: list[DrawBank] = []  # of training quality, handed to workers with this
        self.quality = (
            "training" if any(spec.options.get("quality", "exact") != "exact" for spec in self.specs.values()) else None
        )
        for one in self.weather.values:  # so that what does not go together is said here, and tables are made once
            for spec in self.specs.values():
                if one is not None:
                    self._banks += prepared_banks(spec.build(one.densest(), draw_nuisances(spec.nuisances, 0)), one)

    @property
    def plans(self) -> dict[str, TransformSpec[Any]]:
        """The old name of ``specs``; goes with the next release."""
        text = "Compose.plans is Compose.specs now; the old name goes with the next release."
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return self.specs

    def extra_repr(self) -> str:
        """Transforms by their keys."""
        inside = ", ".join(f"{key!r}: {spec.kind.__name__}" for key, spec in self.specs.items())
        training = "" if self.quality is None else f", quality={self.quality!r}"
        return f"{{{inside}}}, weather={list(self.weather.values)!r}, p={self.p:g}{training}"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": OrderedDict(), "_latest": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call]
        shared(self._epoch)

    # ---- drawing -------------------------------------------------------------------------------------------------

    @property
    def epoch(self) -> int:
        """Number of passes over the data so far."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Another epoch, another weather for each sample; workers that live on see it, too."""
        self._epoch.fill_(int(epoch))

    def draw(
        self, sample: Sample, *, seed: int | None = None, generator: torch.Generator | None = None
    ) -> Draw | list[Draw]:
        """Draw what ``forward`` will do to a sample; a list for a batch.

        Args:
            sample: only its sizes count, and its ``sample_key``.
            seed: of the sample; of a batch's first one, which the others follow by 1.
            generator: torch generator that gives one integer a sample; ``None`` is the global one.
        """
        number = self._number(self._data(sample))
        if seed is not None or self.sample_key is None:
            seeds = sample_seeds(() if number is None else (number,), generator, seed)
        else:
            seeds = [sample_seed(self.seed or 0, name, self.epoch) for name in self._names(sample, number)]
        draws = [self._drawn(one) for one in seeds]
        return draws[0] if number is None else draws

    def _drawn(self, seed: int) -> Draw:
        applied = float(keyed_stream(seed, "compose.applied").random()) < self.p
        chosen = self.weather.at(float(keyed_stream(seed, "compose.weather").random()))
        if not applied or chosen is None:
            return Draw(seed, None, quality=self.quality)
        nuisances = {
            key: draw_nuisances(spec.nuisances, seed, derived_seed(seed, key))
            for key, spec in self.specs.items()
            if spec.nuisances
        }
        return Draw(seed, chosen.drawn(seed).to_dict(), nuisances, self.quality)

    def _names(self, sample: Sample, number: int | None) -> list[int | str]:
        """The samples' own names."""
        assert self.sample_key is not None
        named = self._value(sample, self.sample_key)
        if isinstance(named, (Tensor, np.ndarray, np.generic)):
            named = named.tolist()
        found = [named] if number is None else list(named) if isinstance(named, (list, tuple)) else [named]
        if len(found) != (1 if number is None else number) or not all(isinstance(one, (int, str)) for one in found):
            raise InputValueError(
                f"Compose: {self.sample_key!r} must hold a number or text for each sample; got {named!r}."
            )
        return found

    # ---- applying ------------------------------------------------------------------------------------------------

    def forward(
        self, sample: Sample, *, seed: int | None = None, draw: Draw | Sequence[Draw] | None = None
    ) -> dict[str, Any]:
        """The sample in the weather.

        Args:
            sample: key to data. Mosaics are ``(1, H, W)``, images ``(3, H, W)``, clouds ``(N, 4 or more)``, lists of
                a radar ``(N, 6 or more)``, tensors or numpy arrays; one more dimension in front is a batch.
            seed: as ``draw`` takes it; ``None``: by ``sample_key``, or else from torch's global generator.
            draw: what ``draw`` gave, to do the same again.

        Returns:
            A new dictionary of the same keys (with ``history`` one more). Clouds whose lengths differ
            (``lost="drop"``) are lists in a batch.

        Raises:
            ValueError: the sample lacks a key, or the data of the keys are of batches of different sizes.
        """
        return self._run(sample, seed, draw, truth=False)[0]

    if TYPE_CHECKING:
        __call__ = forward

    def run(
        self, sample: Sample, *, seed: int | None = None, draw: Draw | Sequence[Draw] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """The sample in the weather, and what happened to the data of each key; arguments as ``forward``.

        Returns:
            The sample, and key to ``CameraResult``, ``RgbResult``, ``LidarResult`` or ``RadarResult``; in a batch to
            a list of them. A sample that got no weather has none: an empty dictionary, or ``None`` in the list.
        """
        return self._run(sample, seed, draw, truth=True)

    def _run(
        self, sample: Sample, seed: int | None, draw: Draw | Sequence[Draw] | None, *, truth: bool
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """As `run`; without ``truth`` the results are the data alone."""
        data = self._data(sample)
        number = self._number(data)
        if draw is None:
            draw = self.draw(sample, seed=seed)
        check_arguments("Compose(draw: Draw | Sequence[Draw])", draw)
        draws = [draw] if isinstance(draw, Draw) else list(draw)
        if len(draws) != (1 if number is None else number):
            raise InputValueError(f"Compose: expected a draw for each of {number or 1} samples; got {len(draws)}.")
        if self.history is not None and self.history in sample:
            raise InputValueError(
                f"Compose: the sample holds {self.history!r} already, where history is to go. If it comes from another "
                "Compose, the sample would get two weathers: give one Compose weather=Mixture(...). Else name another "
                "key."
            )
        out = dict(sample)
        results: dict[str, Any] = {}
        for key, spec in self.specs.items():
            if number is None:
                found = self._in_weather(
                    key, spec, data[key], self._extras(sample, key, spec, None, 1), draws[0], truth
                )
                if found is not None:
                    results[key] = found
                    out[key] = like(data_of(found), sample[key])
                elif self._mosaics(spec):
                    out[key] = like(self._clear(key, spec, data[key]), sample[key])
            else:
                each = [
                    self._in_weather(
                        key, spec, data[key][k], self._extras(sample, key, spec, k, number), draws[k], truth
                    )
                    for k in range(number)
                ]
                if self._mosaics(spec) or any(found is not None for found in each):
                    kept = [
                        self._clear(key, spec, data[key][k]) if found is None else data_of(found)
                        for k, found in enumerate(each)
                    ]
                    out[key] = like_batch(kept, sample[key])
                results[key] = each
        if self.history is not None:
            out[self.history] = draws[0].to_dict() if number is None else [one.to_dict() for one in draws]
        return out, results

    def clear_through_mosaic(self, key: str) -> bool:
        """True where clear images of a key go through the mosaic."""
        return self._mosaics(self.specs[key])

    def _mosaics(self, spec: TransformSpec[Any]) -> bool:
        """Check whether clear data of a key go through the mosaic."""
        return self.mosaic_clear and spec.through_mosaic

    def _clear(self, key: str, spec: TransformSpec[Any], value: Tensor) -> Tensor:
        """Data that get no weather."""
        if not self._mosaics(spec):
            return value
        some = next(one for one in self.weather.values if one is not None).densest()
        drawn = draw_nuisances(spec.nuisances, 0)
        found: Tensor = self._transform(key, spec, some.to_dict(), drawn, value.device).without_weather(value)
        return found

    def _in_weather(
        self,
        key: str,
        spec: TransformSpec[Any],
        value: Tensor,
        extras: Mapping[str, Any],
        draw: Draw,
        truth: bool,
    ) -> Any:
        """Result of a key's transform; ``None`` without weather."""
        if draw.weather is None:
            return None
        drawn = draw.nuisances.get(key, {})
        if missing := sorted(set(spec.nuisances) ^ set(drawn)):
            raise InputValueError(
                f"Compose: {key!r}: the draw must have a value for each of "
                f"{', '.join(spec.nuisances) or 'no nuisance'}, and no others; the difference is {', '.join(missing)}. "
                "It was drawn by another Compose."
            )
        if spec.by_look_ups and not truth:
            found = self._by_look_ups(key, spec, value, extras.get("depth"), draw)
            if found is not None:
                return found
        transform = self._transform(key, spec, draw.weather, drawn, value.device)
        noise = transform.draw_for_call(value, derived_seed(draw.seed, key))
        inner = transform.transform if spec.rgb else transform
        for name, stage in inner.chain.stages.items():
            if stage.air_variates():
                shared = draw_variates([draw.seed], "air", list(stage.air_variates()), {})
                noise |= {
                    f"{name}.{full.removeprefix('air.')}": torch.from_numpy(array[0]) for full, array in shared.items()
                }
        for name, one in noise.items():
            noise[name] = one.to(value.device)
        return (transform.run if truth else transform)(value, noise=noise, **extras)

    def _by_look_ups(self, key: str, spec: TransformSpec[Any], value: Tensor, depth: Any, draw: Draw) -> Tensor | None:
        """An image in weather of training quality, by one transform for all rates and airlights; ``None`` where that
        takes more than look-ups."""
        assert draw.weather is not None
        at_any_rate, drawn = weather_at_any_rate(draw.weather), draw.nuisances.get(key, {})
        if at_any_rate is None:
            return None
        light = drawn.get("airlight")
        transform = self._transform(key, spec, at_any_rate, with_any_airlight(drawn), value.device)
        rate = float(draw.weather["rate_mm_per_h"])
        found: Tensor | None = transform.in_training_weather(
            value, depth, None, derived_seed(draw.seed, key), None, [rate], light
        )
        return found

    def _transform(
        self,
        key: str,
        spec: TransformSpec[Any],
        weather: Mapping[str, Any],
        drawn: Mapping[str, Any],
        device: torch.device,
    ) -> Any:
        """The key's transform for a weather and its nuisances, kept for when they come again."""
        place = (key, json.dumps([weather, drawn], sort_keys=True), str(device))
        if place not in self._built:
            given = weather_from_dict(weather)
            near = self._latest.get((key, str(device)))
            renewed = near.renewed(given) if isinstance(near, WeatherTransform) and not drawn else None
            self._built[place] = spec.build(given, drawn).to(device) if renewed is None else renewed
            if not drawn:
                self._latest[key, str(device)] = self._built[place]
            if len(self._built) > KEPT:
                self._built.popitem(last=False)
        self._built.move_to_end(place)
        return self._built[place]

    # ---- what is in a sample -------------------------------------------------------------------------------------

    def _value(self, sample: Sample, key: str) -> Any:
        if not isinstance(sample, Mapping):
            raise InputTypeError(f"Compose: a sample must be a dictionary of named data; got {type(sample).__name__}.")
        if key not in sample:
            names = [str(one) for one in sample]
            raise InputValueError(
                f"Compose: the sample lacks {key!r}; it has {', '.join(names) or 'nothing'}.{nearest_name(key, names)}"
            )
        return sample[key]

    def _data(self, sample: Sample) -> dict[str, Any]:
        """Of each key the data, as a tensor or a list of them."""
        return {key: as_tensor(self._value(sample, key), key) for key in self.specs}

    def _number(self, data: Mapping[str, Any]) -> int | None:
        """Samples in a batch; ``None`` where it is a single one."""
        found: dict[str, int | None] = {}
        for key, value in data.items():
            single = len(self.specs[key].data_shape)
            if isinstance(value, list):
                found[key] = len(value)
            elif value.ndim == single:
                found[key] = None
            elif value.ndim == single + 1:
                found[key] = len(value)
            else:
                raise InputValueError(
                    f"Compose: {key!r} must have shape ({', '.join(self.specs[key].data_shape)}), or one dimension "
                    f"more for a batch; got {tuple(value.shape)}."
                )
        if len(set(found.values())) > 1:
            said = ", ".join(f"{key!r}: {'one sample' if n is None else f'{n} samples'}" for key, n in found.items())
            raise InputValueError(f"Compose: the data of all keys must be of one batch; got {said}.")
        return next(iter(found.values()))

    def _extras(
        self, sample: Sample, key: str, spec: TransformSpec[Any], element: int | None, number: int
    ) -> dict[str, Any]:
        """Further arguments of a key's transform, of one sample of a number of them."""
        names = dict(self.inputs.get(key, {}))
        if "depth" in spec.extra_inputs and "depth" not in names and self.depth in sample:
            names["depth"] = self.depth
        found = {}
        for argument, where in names.items():
            given = self._value(sample, where)
            if isinstance(given, SceneDepth):
                found[argument] = given if element is None else given.of_sample(element)
                continue
            value, single = as_tensor(given, where), spec.extra_inputs[argument]
            if isinstance(value, list) or value.ndim > single:  # what has one more dimension is of a batch
                if element is None or len(value) != number:
                    wanted = "one sample" if element is None else f"one sample, or of each of the {number}"
                    raise InputValueError(
                        f"Compose: {where!r} ({argument} of {key!r}) must be of {wanted} ({single} dimensions each); "
                        f"got {len(value)} of them."
                    )
                value = value[element]
            found[argument] = value
        return found

    def _check_inputs(self) -> None:
        for key, names in self.inputs.items():
            if key not in self.specs:
                raise InputValueError(
                    f"Compose: inputs names {key!r}, for which there is no transform; there are "
                    f"{', '.join(self.specs)}.{nearest_name(key, self.specs)}"
                )
            known = list(self.specs[key].extra_inputs)
            for argument in names:
                if argument not in known:
                    raise InputValueError(
                        f"Compose: inputs of {key!r}: unknown argument {argument!r}; known are "
                        f"{', '.join(known) or 'none'}.{nearest_name(argument, known)}"
                    )


def _no_mapping(given: Any, more: Sequence[object]) -> str:
    """The sentence for transforms that stand in a row, as those of other libraries do."""
    several = [*(given if isinstance(given, (list, tuple)) else [given]), *more]
    names = ", ".join(type(one).__name__ for one in several) or "none"
    return (
        "Compose: expected a dictionary from the keys of your samples to transforms, one weather on all of them, such "
        f"as Compose({{'image': ..., 'points': ...}}, weather=Rain(25)); got {names}. Several weathers at once are one "
        "transform with Mixture(Rain(10), Fog(mor_m=200)); one of several, drawn for each sample, is "
        "Compose({...}, weather=[Rain(10), Fog(mor_m=200)])."
    )


def _spec(key: str, transform: Any) -> TransformSpec[Any]:
    if isinstance(transform, (list, tuple)):
        raise InputValueError(
            f"Compose: {key!r} has {len(transform)} transforms; of two weathers the extinctions must add before any "
            "return is formed. Give one BayerWeather, LidarWeather or RadarAttenuation with weather=Mixture(...)."
        )
    if isinstance(transform, Compose):
        raise InputValueError(
            f"Compose: {key!r} is a Compose; it takes whole samples. For several weathers at once give "
            "weather=Mixture(...)."
        )
    try:
        spec = spec_of(transform)
    except TypeError as error:
        raise InputTypeError(f"Compose: {key!r}: {error}") from error
    if spec.options.get("p", 1.0) != 1.0:
        raise InputValueError(
            f"Compose: {key!r} has p={spec.options['p']:g} of its own, and all sensors of a sample see one weather. "
            "Give p to Compose."
        )
    return spec


def _candidates(weather: Any, transforms: Mapping[str, Any]) -> Choice:
    """The weathers to choose from."""
    if weather is None:
        waiting = [key for key, transform in transforms.items() if getattr(transform, "transform", transform).waits]
        if waiting:
            raise InputValueError(
                f"Compose: {', '.join(map(repr, waiting))} was built without a weather. Say which with weather=."
            )
        own = {key: _weather_of(transform) for key, transform in transforms.items()}
        first = next(iter(own.values()))
        if any(one.to_dict() != first.to_dict() for one in own.values()):
            said = ", ".join(f"{key!r}: {one!r}" for key, one in own.items())
            raise InputValueError(
                f"Compose: all sensors of a sample see one weather, and the transforms were built with several: {said}."
                " Say which with weather=."
            )
        weather = first
    choice = weather if isinstance(weather, Choice) else Choice([weather] if isinstance(weather, Weather) else weather)
    for one in choice.values:
        if one is not None and not isinstance(one, Weather):
            raise InputTypeError(
                f"Compose: weather must be Rain, Fog, Snow, a Mixture, or a list or Choice of them (None is clear air);"
                f" got {one!r}."
            )
        for part in () if one is None else one.parts:
            intensity = getattr(part, part.intensity_name)
            if isinstance(intensity, Tensor) and (intensity.requires_grad or intensity.numel() != 1):
                # A draw is plain values: a gradient would end there, and each sample has a weather of its own.
                raise InputValueError(
                    f"Compose: {part.intensity_name} must be a number or a distribution; got a tensor of shape "
                    f"{tuple(intensity.shape)}{' that requires a gradient' if intensity.requires_grad else ''}. "
                    "Call the transform itself with it."
                )
    return choice


def _weather_of(transform: Any) -> Weather:
    """The weather that a transform, or the one inside ``AsBayer``, was built with."""
    found: Weather = getattr(transform, "transform", transform).weather
    return found
