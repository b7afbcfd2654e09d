"""What a recipe says of a transform: its sensor, and its options where they differ from the defaults."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from torchweather.image.depth import ConstantDepth, FlatGround
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.stages import (
    Chain,
    Effect,
    Extinction,
    ExtinctionAndAirlight,
    ParticleReturns,
    ParticleVeil,
    PathAttenuation,
    VolumeClutter,
    WetRadome,
)
from torchweather.stages.path_attenuation import DEFAULT_MODELS
from torchweather.transforms.camera import BayerWeather
from torchweather.transforms.lidar import LidarWeather
from torchweather.transforms.radar import RadarAttenuation

__all__ = [
    "GROUND",
    "OPTIONS",
    "RecipeTransform",
    "options_of",
    "sensor_of",
    "sensor_values",
    "with_more_effects",
]

RecipeTransform = BayerWeather | LidarWeather | RadarAttenuation
T = TypeVar("T", bound=RecipeTransform)
GROUND = "ground"
# By the kind of the sensor: options of the transform and their defaults.
OPTIONS: dict[str, dict[str, Any]] = {
    kind: {
        name: parameter.default
        for name, parameter in inspect.signature(transform.__init__).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    for kind, transform in (("camera", BayerWeather), ("lidar", LidarWeather), ("radar", RadarAttenuation))
}


def sensor_of(transform: RecipeTransform) -> Camera | Lidar | Radar:
    """The sensor that a transform was built for."""
    return transform.camera if isinstance(transform, BayerWeather) else transform.sensor


def sensor_values(sensor: Camera | Lidar | Radar) -> dict[str, Any]:
    """A sensor as a recipe holds it: all its fields that are set."""
    if isinstance(sensor, Lidar) and sensor.directions is not None:
        raise ValueError(
            "save_recipe: directions belong to the data and not to a recipe. Save without them "
            "(dataclasses.replace(lidar, directions=None)) and give them at the call."
        )
    fields = {key: value for key, value in sensor.to_dict().items() if value is not None}
    return {"kind": sensor.kind, **fields}


def options_of(transform: RecipeTransform) -> dict[str, Any]:
    """The keyword arguments that the transform was built with, where they differ from the defaults."""
    known, found = _known_and_found(transform)
    if found.get("depth") is not None:
        found["depth"] = _depth_option(found["depth"])
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in found.items()}
    rebuilt = {key: value for key, value in plain.items() if value != known[key]}
    changed = _changed(transform, rebuilt)
    if changed:
        raise ValueError(f"save_recipe: {changed}; a recipe cannot hold that. Use transform.chain.save(path).")
    return rebuilt


def with_more_effects(transform: T, effects: Sequence[Effect]) -> T:
    """A transform like another one, with effects beside those that it has.

    Raises:
        ValueError: an effect is of another sensor, or there already; or the other one's chain was changed after it was
            built.
    """
    kind = sensor_of(transform).kind
    strange = [effect.id for effect in effects if effect.id.partition(".")[0] != kind]
    if strange:
        raise ValueError(f"with_more_effects: wanted effects of a {kind}; got {', '.join(strange)}.")
    _, found = _known_and_found(transform)
    present = found.pop("effects", [])
    changed = _changed(transform, {**found, "effects": present})
    if changed:
        raise ValueError(
            f"with_more_effects: {changed}; it cannot be built anew. Use stages.with_effects(transform.chain, effects)."
        )
    again: T = type(transform)(transform.weather, sensor_of(transform), **found, effects=[*present, *effects])  # type: ignore[arg-type]
    return again


def _known_and_found(transform: RecipeTransform) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options of a kind of transform with their defaults, and those that one was built with."""
    if isinstance(transform, BayerWeather):
        return OPTIONS["camera"], _camera_options(transform)
    if isinstance(transform, LidarWeather):
        return OPTIONS["lidar"], _lidar_options(transform)
    return OPTIONS["radar"], _radar_options(transform)


def _camera_options(transform: BayerWeather) -> dict[str, Any]:
    found: dict[str, Any] = {"airlight": transform.airlight}
    for stage in transform.chain.stages.values():
        if isinstance(stage, ExtinctionAndAirlight):
            found |= {"extinction": stage.extinction_model, "variant": stage.variant}
        elif isinstance(stage, ParticleVeil):
            found |= {key: value for key, value in stage.options.items() if key in OPTIONS["camera"]}
    if transform.depth_source is not None:
        found["depth"] = transform.depth_source
    return found | _effects(transform.chain)


def _lidar_options(transform: LidarWeather) -> dict[str, Any]:
    found: dict[str, Any] = {"lost": transform.lost, "complete_scan": transform.complete_scan}
    for stage in transform.chain.stages.values():
        if isinstance(stage, (Extinction, ParticleReturns)):
            found |= stage.options
    return found | _effects(transform.chain)


def _effects(chain: Chain) -> dict[str, Any]:
    effects = [stage.to_dict() for stage in chain.stages.values() if isinstance(stage, Effect)]
    return {"effects": effects} if effects else {}


def _radar_options(transform: RadarAttenuation) -> dict[str, Any]:
    found: dict[str, Any] = {"lost": transform.lost}
    for stage in transform.chain.stages.values():
        if isinstance(stage, PathAttenuation):
            given = {kind: model for kind, model in stage.models.items() if model != DEFAULT_MODELS[kind]}
            found |= {f"{kind}_model": model for kind, model in given.items()}
        elif isinstance(stage, WetRadome):
            for name in ("loss_db", "film_db", "film_exponent"):
                found[f"radome_{name}"] = _as_given(getattr(stage, name), OPTIONS["radar"][f"radome_{name}"])
        elif isinstance(stage, VolumeClutter):
            found |= {
                "clutter": True,
                "clutter_points": stage.capacity,
                "ego_speed_m_per_s": stage.ego_speed_m_per_s,
            }
    effects = [stage.to_dict() for stage in transform.chain.stages.values() if isinstance(stage, Effect)]
    return found | ({"effects": effects} if effects else {})


def _as_given(held: Tensor, default: float) -> float:
    """The number behind a buffer of single precision: the default, or the shortest that it stands for."""
    if float(held) == float(np.float32(default)):
        return default
    return float(str(np.float32(float(held))))


def _depth_option(source: object) -> float | str:
    if isinstance(source, ConstantDepth):
        return source.depth_m
    if source == FlatGround():
        return GROUND
    raise ValueError(
        f"save_recipe: a recipe holds a depth in metres or flat ground at the camera's height and pitch; got "
        f"{type(source).__name__}. Build the transform without depth and give it at the call."
    )


def _changed(transform: RecipeTransform, options: Mapping[str, Any]) -> str:
    """In words, what of a transform's chain is not what its options make; empty where it is the same."""
    arguments = {key: value for key, value in options.items() if key != "depth"}
    again: Chain = type(transform)(transform.weather, sensor_of(transform), **arguments).chain  # type: ignore[arg-type]
    if list(again.stages) != list(transform.chain.stages):
        return (
            f"the chain has the stages {', '.join(transform.chain.stages)}, the transform makes "
            f"{', '.join(again.stages)}"
        )
    if again.to_dict() != transform.chain.to_dict():
        return "a stage of the chain was changed after the transform was built"
    return ""
