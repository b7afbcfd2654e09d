"""Recipes: ready-made pipelines as YAML files: a weather, a sensor and a transform with its options.

A recipe holds ``format: torchweather-recipe/1`` and

- ``title``: what it does, in words;
- ``transform``: ``BayerRain``, ``BayerFog``, ``BayerSnow`` or ``BayerWeather``;
- ``weather``: ``kind`` and the weather's fields (``parts`` for a mixture);
- ``sensor``: ``kind``, and a ``preset`` or the sensor's fields; fields beside a preset replace the preset's;
- ``options``: keyword arguments of the transform; ``depth`` is a number of metres or ``ground``;
- ``rgb``: true for RGB images, through ``AsBayer`` (default false).
"""

from __future__ import annotations

import inspect
import os
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from torch import nn

import torchweather
from torchweather.errors import TorchweatherError, nearest_name
from torchweather.image.depth import ConstantDepth, FlatGround
from torchweather.sensors import Camera, sensor_preset
from torchweather.stages import Chain, ExtinctionAndAirlight, ParticleVeil
from torchweather.transforms.as_bayer import AsBayer
from torchweather.transforms.camera import BayerFog, BayerRain, BayerSnow, BayerWeather
from torchweather.weather import Weather, parse_weather, weather_from_dict

__all__ = ["FORMAT", "Recipe", "list_recipes", "load_recipe", "read_recipe", "recipes_folder", "save_recipe"]

FORMAT = "torchweather-recipe/1"
SUFFIXES = (".yaml", ".yml")
REQUIRED = ("format", "title", "transform", "weather", "sensor")
KEYS = (*REQUIRED, "options", "rgb")
TRANSFORMS: dict[str, type[BayerWeather]] = {
    transform.__name__: transform for transform in (BayerRain, BayerFog, BayerSnow, BayerWeather)
}
OPTIONS: dict[str, Any] = {
    name: parameter.default
    for name, parameter in inspect.signature(BayerWeather.__init__).parameters.items()
    if parameter.kind is inspect.Parameter.KEYWORD_ONLY
}
GROUND = "ground"


@dataclass(frozen=True)
class Recipe:
    """A pipeline as its file states it.

    Args:
        name: path below the recipes' folder without its ending, such as ``camera/fog-30m``; for a file of one's own,
            its name.
        title: what it does.
        transform: name of the transform's class.
        weather: plain values, as ``weather_from_dict`` takes them.
        sensor: ``kind`` with ``preset`` or fields.
        options: keyword arguments of the transform.
        rgb: true for RGB images.
        path: the file.
    """

    name: str
    title: str
    transform: str
    weather: Mapping[str, Any]
    sensor: Mapping[str, Any]
    options: Mapping[str, Any] = field(default_factory=dict)
    rgb: bool = False
    path: Path | None = None

    @property
    def sensor_name(self) -> str:
        """``kind:preset``, or the kind where the fields are given."""
        preset = self.sensor.get("preset")
        return f"{self.sensor['kind']}:{preset}" if preset else str(self.sensor["kind"])

    def build_weather(self) -> Weather:
        """The weather object."""
        return weather_from_dict(self.weather)

    def build_camera(self) -> Camera:
        """The camera object."""
        return camera_of(self.sensor)


def recipes_folder() -> Path:
    """Folder of the ready-made recipes: inside the installed package, or that of the checkout."""
    package = Path(torchweather.__file__).parent
    for folder in (package / "_recipes", package.parent / "transforms"):
        if folder.is_dir():
            return folder
    raise TorchweatherError(f"{package / '_recipes'}: the ready-made recipes are missing; install torchweather again.")


def list_recipes() -> list[Recipe]:
    """All ready-made recipes, by name.

    Example:
        >>> "camera/fog-30m" in [recipe.name for recipe in list_recipes()]
        True
    """
    files = [path for path in recipes_folder().rglob("*") if path.suffix in SUFFIXES]
    return sorted((read_recipe(path) for path in files), key=lambda recipe: recipe.name)


def read_recipe(name_or_path: str | os.PathLike[str]) -> Recipe:
    """A recipe by name (``camera/fog-30m``, or ``fog-30m`` where only one ends so) or from a file.

    Raises:
        ValueError: no recipe of this name.
        TorchweatherError: the file is missing, no YAML, of another format, or has unknown or missing keys.

    Example:
        >>> read_recipe("rain-25mm-per-h").weather["rate_mm_per_h"]
        25.0
    """
    path = _find(name_or_path)
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise TorchweatherError(f"{path}: no such file.") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise TorchweatherError(f"{path}: wanted a recipe in YAML; it cannot be read ({reason}).") from error
    return _checked(values, path)


def load_recipe(name_or_path: str | os.PathLike[str], **overrides: Any) -> nn.Module:
    """The transform of a recipe, ready to call.

    Args:
        name_or_path: as in ``read_recipe``.
        overrides: ``weather`` (an object, text such as ``rain:rate=25``, or plain values), ``sensor`` (a ``Camera``,
            text such as ``camera:gopro-hero5-acdc``, or fields to replace), ``rgb``, or any option of the transform,
            such as ``depth``.

    Returns:
        ``BayerWeather`` or one of its kinds; inside ``AsBayer`` where the recipe is for RGB images.

    Example:
        >>> fog = load_recipe("fog-30m", depth=40.0, airlight=0.7)
        >>> fog.weather.mor_m
        30.0
    """
    recipe = read_recipe(name_or_path)
    known = ["weather", "sensor", "rgb", *OPTIONS]
    for key in overrides:
        if key not in known:
            raise ValueError(
                f"load_recipe: unknown override {key!r}; known are {', '.join(known)}.{nearest_name(key, known)}"
            )
    weather, sensor = overrides.pop("weather", None), overrides.pop("sensor", None)
    rgb = bool(overrides.pop("rgb", recipe.rgb))
    where = recipe.path or recipe.name
    try:
        chosen = recipe.build_weather() if weather is None else _as_weather(weather)
        camera = recipe.build_camera() if sensor is None else _as_camera(sensor, recipe)
        options = {**recipe.options, **overrides}
        if isinstance(options.get("depth"), str):
            options["depth"] = FlatGround()
        kind = TRANSFORMS[recipe.transform]
        # A mixture in place of a single weather needs the class that takes any.
        if not all(part.kind in kind.takes for part in chosen.parts):
            kind = BayerWeather
        transform = kind(chosen, camera, **options)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{where}: {error}") from error
    return AsBayer(transform) if rgb else transform


def save_recipe(transform: nn.Module, path: str | os.PathLike[str], *, title: str) -> None:
    """Write a transform as a recipe, whole or not at all.

    Args:
        transform: ``BayerWeather`` or one of its kinds, or ``AsBayer`` around one.
        path: the file, ending in ``.yaml``.
        title: what it does, in words.

    Raises:
        ValueError: something that a recipe cannot hold: a depth map or function, stages put in (``Chain.save`` holds
            those), another demosaicing.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "mine.yaml"
        >>> save_recipe(load_recipe("fog-30m", depth=40.0), file, title="My fog")
        >>> read_recipe(file).options
        {'depth': 40.0}
    """
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise ValueError(f"save_recipe: the file must end in .yaml; got {target.name!r}.")
    rgb = isinstance(transform, AsBayer)
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, BayerWeather) or type(inner).__name__ not in TRANSFORMS:
        raise TypeError(
            f"save_recipe: transform must be one of {', '.join(TRANSFORMS)}, or AsBayer around one; got "
            f"{type(inner).__name__}."
        )
    if isinstance(transform, AsBayer) and transform.method != "malvar":
        raise ValueError(f"save_recipe: a recipe demosaics with malvar; got method={transform.method!r}.")
    values: dict[str, Any] = {
        "format": FORMAT,
        "title": str(title),
        "transform": type(inner).__name__,
        "weather": inner.weather.to_dict(),
        "sensor": {"kind": "camera", **_without_none(inner.camera.to_dict())},
        "options": _options_of(inner),
    }
    if rgb:
        values["rgb"] = True
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            yaml.safe_dump(values, file, sort_keys=False)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


# ---- reading -------------------------------------------------------------------------------------------------------


def _find(name_or_path: str | os.PathLike[str]) -> Path:
    if isinstance(name_or_path, os.PathLike) or str(name_or_path).endswith(SUFFIXES):
        return Path(name_or_path)
    folder = recipes_folder()
    files = {_name(path): path for path in folder.rglob("*") if path.suffix in SUFFIXES}
    found = [path for name, path in files.items() if str(name_or_path) in (name, name.rpartition("/")[2])]
    if len(found) == 1:
        return found[0]
    if found:
        several = ", ".join(sorted(_name(path) for path in found))
        raise ValueError(f"torchweather: recipe {str(name_or_path)!r} could be {several}; give the whole name.")
    short = [name.rpartition("/")[2] for name in files]
    raise ValueError(
        f"torchweather: recipe must be one of {', '.join(sorted(files))}, or a file ending in .yaml; got "
        f"{str(name_or_path)!r}.{nearest_name(str(name_or_path), [*files, *short])}"
    )


def _name(path: Path) -> str:
    folder = recipes_folder()
    inside = path.is_relative_to(folder)
    return (path.relative_to(folder) if inside else Path(path.name)).with_name(path.stem).as_posix()


def _checked(values: Any, path: Path) -> Recipe:
    if not isinstance(values, Mapping) or values.get("format") != FORMAT:
        got = values.get("format") if isinstance(values, Mapping) else type(values).__name__
        raise TorchweatherError(f"{path}: wanted a recipe of format {FORMAT!r}; got {got!r}.")
    _refuse_unknown(values, KEYS, path, "key")
    for key in REQUIRED:
        if key not in values:
            raise TorchweatherError(f"{path}: the recipe lacks {key!r}; wanted {', '.join(REQUIRED)}.")
    options = values.get("options") or {}
    for key, value in (("weather", values["weather"]), ("sensor", values["sensor"]), ("options", options)):
        if not isinstance(value, Mapping):
            raise TorchweatherError(f"{path}: {key} must be keys with values; got {value!r}.")
    _refuse_unknown(options, OPTIONS, path, "option")
    transform = values["transform"]
    if transform not in TRANSFORMS:
        raise TorchweatherError(
            f"{path}: transform must be one of {', '.join(TRANSFORMS)}; got {transform!r}."
            f"{nearest_name(transform, TRANSFORMS)}"
        )
    depth = options.get("depth")
    if isinstance(depth, str) and depth != GROUND:
        raise TorchweatherError(f"{path}: options.depth must be a number of metres or {GROUND!r}; got {depth!r}.")
    if not isinstance(values.get("rgb", False), bool):
        raise TorchweatherError(f"{path}: rgb must be true or false; got {values['rgb']!r}.")
    recipe = Recipe(
        name=_name(path),
        title=str(values["title"]),
        transform=transform,
        weather=dict(values["weather"]),
        sensor=dict(values["sensor"]),
        options=dict(options),
        rgb=values.get("rgb", False),
        path=path,
    )
    try:
        recipe.build_weather()
        recipe.build_camera()
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{path}: {error}") from error
    return recipe


def camera_of(values: Mapping[str, Any]) -> Camera:
    """The camera of a recipe's ``sensor``: a preset with fields replaced, or all fields."""
    fields = dict(values)
    kind, preset = fields.pop("kind", None), fields.pop("preset", None)
    if kind != "camera":
        raise ValueError(f"sensor.kind must be camera; got {kind!r}.")
    # A list of YAML stands for a tuple of the dataclass.
    fields = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
    return Camera.from_dict(fields) if preset is None else Camera.preset(str(preset), **fields)


def _as_weather(weather: Any) -> Weather:
    if isinstance(weather, str):
        return parse_weather(weather)
    built: Weather = weather_from_dict(weather) if isinstance(weather, Mapping) else weather
    return built


def _as_camera(sensor: Any, recipe: Recipe) -> Camera:
    if isinstance(sensor, Mapping):
        base = {} if "preset" in sensor else recipe.sensor
        return camera_of({"kind": "camera", **base, **sensor})
    built = sensor_preset(sensor)[1] if isinstance(sensor, str) else sensor
    if not isinstance(built, Camera):
        raise TypeError(f"sensor must be a camera; got {getattr(built, 'kind', type(built).__name__)}.")
    return built


def _refuse_unknown(values: Mapping[str, Any], known: Iterable[str], path: Path, what: str) -> None:
    names = list(known)
    for key in values:
        if key not in names:
            raise TorchweatherError(
                f"{path}: unknown {what} {key!r}; known are {', '.join(names)}.{nearest_name(key, names)}"
            )


# ---- writing -------------------------------------------------------------------------------------------------------


def _options_of(transform: BayerWeather) -> dict[str, Any]:
    """The keyword arguments that the transform was built with, where they differ from the defaults."""
    expected = type(transform)(transform.weather, transform.camera).chain.stages
    stages = transform.chain.stages
    if list(stages) != list(expected):
        raise ValueError(
            f"save_recipe: the chain has the stages {', '.join(stages)}, the transform makes {', '.join(expected)}; a "
            "recipe cannot hold that. Use transform.chain.save(path)."
        )
    found: dict[str, Any] = {"airlight": transform.airlight}
    for stage in stages.values():
        if isinstance(stage, ExtinctionAndAirlight):
            found |= {"extinction": stage.extinction_model, "variant": stage.variant}
        elif isinstance(stage, ParticleVeil):
            found |= {key: value for key, value in stage.options.items() if key in OPTIONS}
    if transform.depth_source is not None:
        found["depth"] = _depth_option(transform.depth_source)
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in found.items()}
    rebuilt = {key: value for key, value in plain.items() if value != OPTIONS[key]}
    _check_same_chain(transform, rebuilt)
    return rebuilt


def _depth_option(source: object) -> float | str:
    if isinstance(source, ConstantDepth):
        return source.depth_m
    if source == FlatGround():
        return GROUND
    raise ValueError(
        f"save_recipe: a recipe holds a depth in metres or flat ground at the camera's height and pitch; got "
        f"{type(source).__name__}. Build the transform without depth and give it at the call."
    )


def _check_same_chain(transform: BayerWeather, options: Mapping[str, Any]) -> None:
    arguments = {key: value for key, value in options.items() if key != "depth"}
    again: Chain = type(transform)(transform.weather, transform.camera, **arguments).chain
    if again.to_dict() != transform.chain.to_dict():
        raise ValueError(
            "save_recipe: a stage of the chain was changed after the transform was built; a recipe cannot hold that. "
            "Use transform.chain.save(path)."
        )


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}
