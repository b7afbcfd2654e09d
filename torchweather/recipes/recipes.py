"""Ready-made recipes as YAML files: found by name, read, built and written."""

from __future__ import annotations

import os
from typing import Any

from torch import nn

from torchweather.camera.rgb import AsBayer
from torchweather.compose.plans import TRANSFORMS, sensor_of
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError
from torchweather.recipes.files import (
    PIPELINE,
    RECIPE,
    files_of,
    find,
    format_of,
    read_yaml,
    recipes_folder,
    write_yaml,
)
from torchweather.recipes.options import RecipeTransform, options_of, sensor_values
from torchweather.recipes.pipelines import load_pipeline
from torchweather.recipes.recipe import (
    FORMAT,
    Recipe,
    as_weather,
    built_recipe,
    checked_recipe,
    overrides_of,
    refuse_overrides,
)

__all__ = ["FORMAT", "Recipe", "list_recipes", "load_recipe", "read_recipe", "recipes_folder", "save_recipe"]


def list_recipes() -> list[Recipe]:
    """All ready-made recipes, by name.

    Example:
        >>> "camera/fog-30m" in [recipe.name for recipe in list_recipes()]
        True
    """
    return sorted((read_recipe(path) for path in files_of(RECIPE)), key=lambda recipe: recipe.name)


def read_recipe(name_or_path: str | os.PathLike[str]) -> Recipe:
    """A recipe by name (``camera/fog-30m``, or ``fog-30m`` where only one ends so) or from a file.

    Raises:
        ValueError: no recipe of this name.
        TorchweatherError: the file is missing, no YAML, of another format, or has unknown or missing keys.

    Example:
        >>> read_recipe("rain-25mm-per-h").weather["rate_mm_per_h"]
        25.0
    """
    path = find(name_or_path)
    return checked_recipe(read_yaml(path, "recipe"), path)


def load_recipe(name_or_path: str | os.PathLike[str], **overrides: Any) -> nn.Module:
    """The transform of a recipe, ready to call; of a pipeline (``transforms.pipelines``) its ``Compose``.

    Args:
        name_or_path: as in ``read_recipe``.
        overrides: ``weather`` (an object, text such as ``rain:rate=25``, or plain values), ``sensor`` (of the recipe's
            kind: an object, text such as ``camera:gopro-hero5-acdc``, or fields to replace), ``rgb``, or any option of
            the transform, such as ``depth``. Of a pipeline, what ``load_pipeline`` takes.

    Returns:
        ``BayerWeather`` or ``LidarWeather`` or one of their kinds, or ``RadarAttenuation``; inside ``AsBayer`` where
        the recipe is for RGB images.

    Example:
        >>> fog = load_recipe("fog-30m", depth=40.0, airlight=0.7)
        >>> fog.weather.mor_m
        30.0
    """
    if format_of(find(name_or_path, "recipe", RECIPE, PIPELINE)).startswith(PIPELINE):
        return load_pipeline(name_or_path, **overrides)
    recipe = read_recipe(name_or_path)
    refuse_overrides(overrides, ["weather", *overrides_of(recipe)], "load_recipe")
    weather = overrides.pop("weather", None)
    try:
        return built_recipe(recipe, recipe.build_weather() if weather is None else as_weather(weather), overrides)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{recipe.path or recipe.name}: {error}") from error


def save_recipe(transform: nn.Module, path: str | os.PathLike[str], *, title: str) -> None:
    """Write a transform as a recipe, whole or not at all.

    Args:
        transform: ``BayerWeather``, ``LidarWeather`` or one of their kinds, ``RadarAttenuation``, or ``AsBayer``
            around one of a camera.
        path: the file, ending in ``.yaml``.
        title: what it does, in words.

    Raises:
        ValueError: something that a recipe cannot hold: a depth map or function, directions of beams, stages put in
            (``Chain.save`` holds those), another demosaicing.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> file = Path(tempfile.mkdtemp()) / "mine.yaml"
        >>> save_recipe(load_recipe("fog-30m", depth=40.0), file, title="My fog")
        >>> read_recipe(file).options
        {'depth': 40.0}
    """
    inner = transform.transform if isinstance(transform, AsBayer) else transform
    if not isinstance(inner, RecipeTransform) or type(inner).__name__ not in TRANSFORMS:
        raise InputTypeError(
            f"save_recipe: transform must be one of {', '.join(TRANSFORMS)}, or AsBayer around one; got "
            f"{type(inner).__name__}."
        )
    if isinstance(transform, AsBayer) and transform.method != "malvar":
        raise InputValueError(f"save_recipe: a recipe demosaics with malvar; got method={transform.method!r}.")
    values: dict[str, Any] = {
        "format": FORMAT,
        "title": str(title),
        "transform": type(inner).__name__,
        "weather": inner.weather.to_dict(),
        "sensor": sensor_values(sensor_of(inner)),
        "options": options_of(inner),
    }
    if isinstance(transform, AsBayer):
        values["rgb"] = True
        if transform.through_mosaic:
            values["through_mosaic"] = True
    write_yaml(values, path, owner="save_recipe")
