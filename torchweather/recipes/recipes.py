"""Recipes as YAML files: found by name, read, built and written."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, overload

from torch import nn

from torchweather.camera.rgb import AsBayer
from torchweather.compose.compose import Compose
from torchweather.compose.transform_spec import TRANSFORMS, sensor_of
from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputTypeError, InputValueError
from torchweather.core.yaml_file import dump_yaml
from torchweather.recipes.files import KINDS, SUFFIXES, find, ready_made, recipes_folder
from torchweather.recipes.multi_sensor import MultiSensorRecipe, checked_multi_sensor, first_weather
from torchweather.recipes.options import RecipeTransform, options_of, sensor_values
from torchweather.recipes.schema import FORMAT, read_values
from torchweather.recipes.suite import SuiteRecipe, checked_suite
from torchweather.recipes.transform import TransformRecipe, checked_transform

__all__ = ["FORMAT", "Recipe", "list_recipes", "load_recipe", "read_recipe", "recipes_folder", "save_recipe"]

Recipe = TransformRecipe | MultiSensorRecipe | SuiteRecipe
Kinds = str | Sequence[str] | None
CHECKED: dict[str, Callable[[Mapping[str, Any], Path], Recipe]] = {
    "transform": checked_transform,
    "multi_sensor": checked_multi_sensor,
    "suite": checked_suite,
}


@overload
def list_recipes(kind: Literal["transform"]) -> list[TransformRecipe]: ...
@overload
def list_recipes(kind: Literal["multi_sensor"]) -> list[MultiSensorRecipe]: ...
@overload
def list_recipes(kind: Literal["suite"]) -> list[SuiteRecipe]: ...
@overload
def list_recipes(kind: Kinds = None) -> list[Recipe]: ...
def list_recipes(kind: Kinds = None) -> Sequence[Recipe]:
    """All ready-made recipes, or those of a kind, by name.

    Args:
        kind: ``transform``, ``multi_sensor`` or ``suite``, or several of them; ``None``: all.

    Example:
        >>> [recipe.name for recipe in list_recipes("suite") if recipe.sensor_kind == "lidar"]
        ['lidar/3d-corruptions-ad', 'lidar/robo3d', 'lidar/robustness']
    """
    return sorted((read_recipe(path) for path in ready_made(_kinds(kind)).values()), key=lambda recipe: recipe.name)


@overload
def read_recipe(name_or_path: str | os.PathLike[str], kind: Literal["transform"]) -> TransformRecipe: ...
@overload
def read_recipe(name_or_path: str | os.PathLike[str], kind: Literal["multi_sensor"]) -> MultiSensorRecipe: ...
@overload
def read_recipe(name_or_path: str | os.PathLike[str], kind: Literal["suite"]) -> SuiteRecipe: ...
@overload
def read_recipe(name_or_path: str | os.PathLike[str], kind: Kinds = None) -> Recipe: ...
def read_recipe(name_or_path: str | os.PathLike[str], kind: Kinds = None) -> Recipe:
    """A recipe by name (``camera/fog-30m``, or ``fog-30m``) or from a file.

    Args:
        name_or_path: where a short name stands for recipes of several kinds, a transform is meant before a multi_sensor
            and that before a suite.
        kind: that it must be of: ``transform``, ``multi_sensor`` or ``suite``, or several of them, in this order.

    Raises:
        ValueError: no recipe of this name and kind, or several.
        TorchweatherError: the file is missing or no YAML, is of another kind, or has unknown, missing or wrong keys;
            the message names the file and the key.

    Example:
        >>> read_recipe("rain-25mm-per-h").weather["rate_mm_per_h"]
        25.0
        >>> list(read_recipe("multi_sensor/training-mix").transforms)
        ['image', 'points', 'radar']
    """
    check_arguments("read_recipe(name_or_path: path)", name_or_path)
    kinds = _kinds(kind)
    path = find(name_or_path, kinds)
    values = read_values(path)
    if values["kind"] not in kinds:
        raise InputValueError(f"{path}: kind must be {' or '.join(kinds)}; got {values['kind']}.")
    return CHECKED[values["kind"]](values, path)


def load_recipe(name_or_path: str | os.PathLike[str], *, kind: Kinds = None, **overrides: Any) -> Any:
    """Load what a recipe describes, ready to use.

    Args:
        name_or_path, kind: as in ``read_recipe``.
        overrides: of a transform: ``weather`` (an object, text such as ``rain:rate=25``, or plain values), ``sensor``
            (of the recipe's kind: an object, text such as ``camera:gopro-hero5-acdc``, or fields to replace), ``rgb``,
            or any option of the transform, such as ``depth``. Of a multi_sensor: ``p``, ``depth``, ``inputs``,
            ``seed``, ``sample_key``, ``history`` and ``mosaic_clear`` of ``Compose``; ``weather`` (also text such as
            ``rain:rate=1..50``); ``transforms``, by the file's keys the overrides of one transform, or ``None`` to
            leave the key out; ``keys``, the file's keys to those of your samples.

    Returns:
        Of a transform: ``BayerWeather`` or ``LidarWeather`` or one of their kinds, or ``RadarAttenuation``; inside
        ``AsBayer`` where the recipe is for RGB images. Of a multi_sensor: ``Compose``. Of a suite: ``SuiteRecipe``, for
        its ``conditions()``.

    Example:
        >>> fog = load_recipe("fog-30m", depth=40.0, airlight=0.7)
        >>> fog.weather.mor_m
        30.0
        >>> changes = {"points": {"sensor": "lidar:velodyne-hdl-32e"}, "radar": None}
        >>> mine = load_recipe("multi_sensor/training-mix", transforms=changes, keys={"points": "LIDAR_TOP"}, p=0.5)
        >>> list(mine.specs), mine.p
        (['image', 'LIDAR_TOP'], 0.5)
    """
    check_arguments("load_recipe(name_or_path: path)", name_or_path)
    return read_recipe(name_or_path, kind).build(**overrides)


def save_recipe(transform: nn.Module | Compose, path: str | os.PathLike[str], *, title: str) -> None:
    """Write a transform or a ``Compose`` as a recipe, whole or not at all.

    Args:
        transform: ``BayerWeather``, ``LidarWeather`` or one of their kinds, ``RadarAttenuation``, or ``AsBayer``
            around one of a camera; or a ``Compose`` of these, whose ``seed``, ``sample_key`` and ``history`` stay out.
        path: the file, ending in ``.yaml``.
        title: what it does, in words.

    Raises:
        ValueError: something that a recipe cannot hold: a depth map or function, directions of beams, stages put in
            (``Chain.save`` holds those), another demosaicing, clear air only.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "mine.yaml"
        >>> save_recipe(load_recipe("fog-30m", depth=40.0), file, title="My fog")
        >>> read_recipe(file).options
        {'depth': 40.0}
    """
    check_arguments("save_recipe(path: path, title: str)", path, title)
    described = _several(transform) if isinstance(transform, Compose) else _one(transform)
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise InputValueError(f"save_recipe: the file must end in .yaml; got {target.name!r}.")
    text = dump_yaml({"format": FORMAT, "title": str(title), **described})
    with atomic_write(target) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def _one(transform: nn.Module) -> dict[str, Any]:
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, RecipeTransform) or type(inner).__name__ not in TRANSFORMS:
        raise InputTypeError(
            f"save_recipe: transform must be one of {', '.join(TRANSFORMS)}, AsBayer around one, or a Compose; got "
            f"{type(inner).__name__}."
        )
    if isinstance(transform, AsBayer) and transform.method != "malvar":
        raise InputValueError(f"save_recipe: a recipe demosaics with malvar; got method={transform.method!r}.")
    weather = inner.weather.to_dict()
    return {"kind": "transform", "weather": weather, **_of_a_sensor(type(inner).__name__, transform)}


def _several(compose: Compose) -> dict[str, Any]:
    first = first_weather(compose.weather)
    alone = len(compose.weather.values) == 1
    return {
        "kind": "multi_sensor",
        "weather": first.to_dict() if alone else compose.weather.to_dict(),
        "transforms": {key: _of_a_sensor(spec.kind.__name__, spec.build(first)) for key, spec in compose.specs.items()},
        "p": compose.p,
        "depth": compose.depth,
        **({"mosaic_clear": True} if compose.mosaic_clear else {}),
        **({"inputs": compose.inputs} if compose.inputs else {}),
    }


def _of_a_sensor(name: str, transform: Any) -> dict[str, Any]:
    rgb = isinstance(transform, AsBayer)
    inner = transform.transform if rgb else transform
    flags = {"rgb": rgb, "through_mosaic": rgb and transform.through_mosaic}
    return {
        "transform": name,
        "sensor": sensor_values(sensor_of(inner)),
        "options": options_of(inner),
        **{flag: True for flag, said in flags.items() if said},
    }


def _kinds(kind: Kinds) -> Sequence[str]:
    return KINDS if kind is None else (kind,) if isinstance(kind, str) else kind
