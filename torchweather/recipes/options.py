"""Values of a recipe's transform: its sensor, and its options where they differ from the defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from torchweather.camera.depth import AUTO, ConstantDepth, FlatGround, ScenePrior, as_depth_source
from torchweather.camera.exposure import ExposureControl
from torchweather.camera.night.lamps import Night
from torchweather.camera.options import RENAMED, CameraOptions
from torchweather.camera.particles.bank import DrawBank
from torchweather.camera.particles.bank_veil import TRAINING_QUALITY
from torchweather.camera.transform import BayerWeather
from torchweather.compose.transform_spec import sensor_of, spec_of
from torchweather.core.distributions import Distribution
from torchweather.core.errors import InputValueError
from torchweather.core.moved import new_names
from torchweather.lidar.options import LidarOptions
from torchweather.lidar.sweep.own_vehicle import OwnVehicleMask
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.effect import Effect
from torchweather.pipeline.sensor import Sensor
from torchweather.radar.options import RadarOptions
from torchweather.radar.transform import RadarAttenuation

__all__ = [
    "FLAGS",
    "GROUND",
    "OPTIONS",
    "RecipeTransform",
    "current_names",
    "options_of",
    "sensor_values",
    "with_more_effects",
]

RecipeTransform = BayerWeather | LidarWeather | RadarAttenuation
T = TypeVar("T", bound=RecipeTransform)
GROUND = "ground"
# By the kind of the sensor: options of the transform and their defaults.
OPTIONS: dict[str, dict[str, Any]] = {
    "camera": CameraOptions.defaults(),
    "lidar": LidarOptions.defaults(),
    "radar": RadarOptions.defaults(),
}
# By the kind of the sensor: flags of a recipe beside the options.
FLAGS = {"camera": ("rgb", "through_mosaic"), "lidar": (), "radar": ()}


def current_names(options: Mapping[str, Any], owner: str) -> dict[str, Any]:
    """Options under their names of today; an old name is taken with a warning."""
    return new_names(options, RENAMED, owner, stacklevel=2)


def sensor_values(sensor: Sensor) -> dict[str, Any]:
    """A sensor as a recipe holds it: all its fields that are set."""
    fields = {key: value for key, value in sensor.to_dict().items() if value is not None}
    for name in sensor.data_fields:
        if name in fields:
            raise InputValueError(
                f"save_recipe: {name} belong to the data and not to a recipe. Save without them "
                f"(dataclasses.replace({sensor.kind}, {name}=None)) and give them at the call."
            )
    return {"kind": sensor.kind, **fields}


def options_of(transform: RecipeTransform) -> dict[str, Any]:
    """The keyword arguments that the transform was built with, where they differ from the defaults, as plain values."""
    try:
        options = dict(spec_of(transform).options)
    except ValueError as error:
        raise InputValueError(
            f"save_recipe: {error} A recipe cannot hold that; use transform.chain.save(path)."
        ) from error
    if options.get("depth") is not None and not isinstance(options["depth"], Distribution):
        options["depth"] = _depth_option(as_depth_source(options["depth"]))
    if isinstance(options.get("exposure_control"), ExposureControl):
        options["exposure_control"] = options["exposure_control"].config()
    if isinstance(options.get("quality"), DrawBank):
        options["quality"] = TRAINING_QUALITY
    if isinstance(options.get("night"), Night):
        options["night"] = options["night"].to_dict()
    if options.get("effects"):
        options["effects"] = [one.to_dict() if isinstance(one, Effect) else dict(one) for one in options["effects"]]
    known = transform.options.defaults()
    return {name: _plain(name, value) for name, value in options.items() if not _is_default(value, known[name])}


def with_more_effects(transform: T, effects: Sequence[Effect]) -> T:
    """A transform like another one, with effects beside those that it has.

    Raises:
        ValueError: an effect is of another sensor, or there already; or the other one's chain was changed after it was
            built.
    """
    kind = sensor_of(transform).kind
    strange = [effect.id for effect in effects if effect.id.partition(".")[0] != kind]
    if strange:
        raise InputValueError(f"with_more_effects: expected effects of a {kind}; got {', '.join(strange)}.")
    try:
        spec = spec_of(transform)
    except ValueError as error:
        raise InputValueError(
            f"with_more_effects: {error} Or use stages.with_effects(transform.chain, effects)."
        ) from error
    more = {**spec.options, "effects": [*spec.options.get("effects", ()), *effects]}
    again: T = replace(spec, options=more).build(transform.weather)
    return again


def _is_default(value: Any, default: Any) -> bool:
    """Check whether a value is the default's; an empty list is an empty tuple."""
    if isinstance(value, (list, tuple)) and isinstance(default, (list, tuple)):
        return list(value) == list(default)
    return not isinstance(value, Tensor) and bool(value == default)


def _plain(name: str, value: Any) -> Any:
    """A value as YAML holds it."""
    if isinstance(value, Distribution):
        return value.to_dict()
    if isinstance(value, Tensor):
        value = value.detach().tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (list, tuple)):
        return [_plain(name, one) for one in value]
    if isinstance(value, dict):
        return {key: _plain(name, one) for key, one in value.items()}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, OwnVehicleMask):
        raise InputValueError(
            "save_recipe: own_vehicle must be a box or a file; got an OwnVehicleMask. Write it with mask.save(path), "
            "then give own_vehicle=path."
        )
    raise InputValueError(
        f"save_recipe: {name} must be plain values; got {type(value).__name__}. A recipe cannot hold it."
    )


def _all_default(source: ScenePrior) -> bool:
    """Check whether nothing was given to it."""
    return all(getattr(source, one.name) is one.default for one in fields(source))


def _depth_option(source: object) -> float | str:
    if isinstance(source, ConstantDepth):
        return source.depth_m
    if source == FlatGround():
        return GROUND
    if isinstance(source, ScenePrior) and _all_default(source):
        return AUTO
    raise InputValueError(
        f"save_recipe: a recipe holds a depth in metres or flat ground at the camera's height and pitch; got "
        f"{type(source).__name__}. Build the transform without depth and give it at the call."
    )
