"""``torchweather list``: recipes, sensors, weathers, size distributions and stages."""

from __future__ import annotations

import argparse
import json
import textwrap
from importlib import resources
from typing import Any

from torchweather.cli.output import print_json, print_lines
from torchweather.core.compiled import compiled_path
from torchweather.core.text import aligned

NAME = "list"
SUMMARY = "recipes, sensor presets, weathers, size distributions, stages"
DESCRIPTION = "Everything that has a name."
NAMES_FILE = "names.json"  # written by python -m tests.listed_names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command takes none of its own."""


def run(args: argparse.Namespace) -> int:
    """Print the names."""
    names = kept_names() | {"particles_rendered_by": compiled_path()}  # of this machine
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


def everything() -> dict[str, Any]:
    """All names of the library as plain values."""
    from torchweather.atmosphere.weather import REHEARSE, WEATHERS, weather_kinds
    from torchweather.physics import FOG, RAIN, SNOW
    from torchweather.recipes import MultiSensorRecipe, Recipe, SuiteRecipe, list_recipes
    from torchweather.sensors import SENSOR_CLASSES
    from torchweather.stages import STAGES

    def described(recipe: Recipe) -> dict[str, Any]:
        values: dict[str, Any] = {"name": recipe.name, "kind": recipe.kind, "title": recipe.title}
        if isinstance(recipe, SuiteRecipe):
            weathers = {name: dict(fields) for name, fields in recipe.weathers.items()}
            return {**values, "sensor": recipe.sensor_kind, "weathers": weathers}
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
    lines += ["", "Stages", "", *(f"  {name}" for name in names["stages"])]
    return "\n".join(
        [*lines, "", f"Drops and flakes before cameras, LiDAR clouds: rendered by {names['particles_rendered_by']}"]
    )
