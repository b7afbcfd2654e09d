"""``torchweather list``: recipes, sensors, weathers, size distributions, effects and stages."""

from __future__ import annotations

import argparse
import json
import textwrap
from importlib import resources
from typing import Any

from torchweather.cli.output import print_json, print_lines
from torchweather.core.compiled import compiled_path
from torchweather.core.exceptions import TorchweatherError
from torchweather.core.plugins import GROUPS, Plugin, plugins, recipe_files, refusal
from torchweather.core.text import aligned

NAME = "list"
SUMMARY = "recipes, sensor presets, weathers, size distributions, effects, stages"
DESCRIPTION = "Everything that has a name."
NAMES_FILE = "names.json"  # written by python -m tests.listed_names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command takes none of its own."""


def run(args: argparse.Namespace) -> int:
    """Print the names."""
    names = kept_names()
    # Of this machine:
    names |= {"added_by_packages": added_by_packages(names), "particles_rendered_by": compiled_path()}
    if args.json:
        print_json(names)
    else:
        print_lines(listing_text(names))
    return 0


def kept_names() -> dict[str, Any]:
    """All names as the package's file has them: reading it takes no torch. A test compares it with `everything`."""
    text = resources.files("torchweather").joinpath("presets", NAMES_FILE).read_text(encoding="utf-8")
    names: dict[str, Any] = json.loads(text)
    return names


def added_by_packages(names: dict[str, Any]) -> list[dict[str, Any]]:
    """Names that installed packages add, by group; nothing of a package is imported.

    Args:
        names: of the library.

    Returns:
        Rows of ``group``, ``name``, ``package``, and ``refused``: why the name cannot be used, ``None`` where it can.
    """
    own = {
        "sensors": [sensor["name"].replace(":", ".", 1) for sensor in names["sensors"]],
        "weathers": [one["name"] for one in (*names["weathers"], *names["conditions"])],
        "effects": names["effects"],
        "recipes": [recipe["name"] for recipe in names["recipes"]],
    }
    found = [(group, *row) for group in GROUPS for row in _of_group(group)]
    return [
        {
            "group": group,
            "name": name,
            "package": plugin.package,
            "refused": broken
            or refusal(name, [other for of, same, other, _ in found if (of, same) == (group, name)], own[group]),
        }
        for group, name, plugin, broken in found
    ]


def _of_group(group: str) -> list[tuple[str, Plugin, str | None]]:
    """Names, their entry points, and what is wrong with these."""
    every = [(name, one) for name, owners in plugins(group).items() for one in owners]
    if group != "recipes":
        return [(name, one, None) for name, one in every]
    rows: list[tuple[str, Plugin, str | None]] = []
    for prefix, one in every:
        try:
            rows += [(f"{prefix}/{name}", one, None) for name in recipe_files(one)]
        except TorchweatherError as error:
            rows.append((f"{prefix}/", one, str(error)))
    return rows


def everything() -> dict[str, Any]:
    """All names of the library as plain values."""
    from torchweather.atmosphere.weather import REHEARSE, WEATHERS, weather_kinds
    from torchweather.physics import FOG, RAIN, SNOW
    from torchweather.recipes import MultiSensorRecipe, Recipe, SuiteRecipe, list_recipes
    from torchweather.sensors import SENSOR_CLASSES
    from torchweather.stages import EFFECTS, STAGES

    def described(recipe: Recipe) -> dict[str, Any]:
        values: dict[str, Any] = {"name": recipe.name, "kind": recipe.kind, "title": recipe.title}
        if isinstance(recipe, SuiteRecipe):
            weathers = {name: dict(fields) for name, fields in recipe.weathers.items()}
            effects = {"effects": {name: dict(fields) for name, fields in recipe.effects.items()}}
            return {**values, "sensor": recipe.sensor_kind, "weathers": weathers, **(effects if recipe.effects else {})}
        values["weather"] = dict(recipe.weather)
        if isinstance(recipe, MultiSensorRecipe):
            return {**values, "sensors": {key: one.sensor_name for key, one in recipe.transforms.items()}}
        return {**values, "transform": recipe.transform, "sensor": recipe.sensor_name}

    recipes = [described(recipe) for recipe in list_recipes()]
    return {
        "recipes": recipes,
        # Earlier keys of two kinds; they go with the next release.
        "pipelines": [recipe for recipe in recipes if recipe["kind"] == "multi_sensor"],
        "suites": [recipe for recipe in recipes if recipe["kind"] == "suite"],
        "sensors": [
            {"name": f"{kind}:{name}", "source": source}
            for kind, sensor in SENSOR_CLASSES.items()
            for name, source in sensor.presets().items()
        ],
        "weathers": [{"name": kind, "knob": weather.intensity_name} for kind, weather in WEATHERS.items()],
        "conditions": [
            {"name": kind, "fields": list(one.ranges)} for kind, one in weather_kinds().items() if kind not in WEATHERS
        ],
        "size_distributions": {"rain": sorted(RAIN), "fog": sorted({*FOG, REHEARSE}), "snow": sorted(SNOW)},
        "effects": sorted(name for name, kind in EFFECTS.items() if kind.__module__.startswith("torchweather.")),
        "stages": sorted(name for name, kind in STAGES.items() if kind.__module__.startswith("torchweather.")),
    }


def listing_text(names: dict[str, Any]) -> str:
    """The names as text."""
    commands = {"transform": "apply", "multi_sensor": "augment", "suite": "robustness"}
    lines: list[str] = []
    for kind, command in commands.items():
        recipes = [recipe for recipe in names["recipes"] if recipe["kind"] == kind]
        rows = [[r["name"], r["title"], *([r["sensor"]] if kind == "transform" else [])] for r in recipes]
        lines += [f"Recipes of kind {kind} (torchweather {command} --recipe NAME)", ""]
        lines += [*("  " + line for line in aligned(rows)), ""]
    lines += ["Sensors (--sensor NAME)", ""]
    for sensor in names["sensors"]:
        wrapped = textwrap.wrap(sensor["source"], 100, initial_indent=" " * 6, subsequent_indent=" " * 6)
        lines += [f"  {sensor['name']}", *wrapped]
    lines += ["", "Weathers (--weather KIND:KNOB=VALUE,size_distribution=NAME; join several by +)", ""]
    rows = [
        [weather["name"], weather["knob"], ", ".join(names["size_distributions"][weather["name"]])]
        for weather in names["weathers"]
    ]
    lines += ["  " + line for line in aligned([["kind", "knob", "size distributions"], *rows])]
    lines += ["", "Water and snow on things (--weather rain:rate=10+KIND:FIELD=VALUE)", ""]
    lines += ["  " + line for line in aligned([[one["name"], ", ".join(one["fields"])] for one in names["conditions"]])]
    lines += ["", "Effects (recipes: options.effects)", "", *(f"  {name}" for name in names["effects"])]
    lines += ["", "Stages", "", *(f"  {name}" for name in names["stages"])]
    added = names["added_by_packages"]
    if added:
        rows = [[one["group"], one["name"], one["package"]] for one in added]
        lines += ["", "Added by other packages", ""]
        lines += ["  " + line for line in aligned([["group", "name", "package"], *rows])]
        lines += [f"  refused: {one['refused']}" for one in added if one["refused"]]
    return "\n".join(
        [*lines, "", f"Drops and flakes before cameras, LiDAR clouds: rendered by {names['particles_rendered_by']}"]
    )
