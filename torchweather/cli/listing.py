"""``torchweather list``: recipes, pipelines, suites, sensors, weathers, size distributions and stages."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

NAME = "list"
SUMMARY = "recipes, pipelines, suites, sensor presets, weathers, size distributions, stages"
DESCRIPTION = "Everything that has a name."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command takes none of its own."""


def run(args: argparse.Namespace) -> int:
    """Print the names."""
    from torchweather.cli.output import print_json, print_lines

    names = everything()
    if args.json:
        print_json(names)
    else:
        print_lines(listing_text(names))
    return 0


def everything() -> dict[str, Any]:
    """All names of the library as plain values."""
    from torchweather.atmosphere.weather import REHEARSE, WEATHERS
    from torchweather.physics import FOG, RAIN, SNOW
    from torchweather.recipes.pipelines import list_pipelines
    from torchweather.recipes.recipes import list_recipes
    from torchweather.recipes.suites import list_suites
    from torchweather.sensors import SENSOR_CLASSES
    from torchweather.stages import STAGES

    return {
        "recipes": [
            {
                "name": recipe.name,
                "title": recipe.title,
                "transform": recipe.transform,
                "weather": dict(recipe.weather),
                "sensor": recipe.sensor_name,
            }
            for recipe in list_recipes()
        ],
        "pipelines": [
            {
                "name": pipeline.name,
                "title": pipeline.title,
                "weather": dict(pipeline.weather),
                "sensors": {key: recipe.sensor_name for key, recipe in pipeline.transforms.items()},
            }
            for pipeline in list_pipelines()
        ],
        "suites": [
            {
                "name": suite.name,
                "title": suite.title,
                "sensor": suite.sensor_kind,
                "weathers": {name: dict(fields) for name, fields in suite.weathers.items()},
            }
            for suite in list_suites()
        ],
        "sensors": [
            {"name": f"{kind}:{name}", "source": source}
            for kind, sensor in SENSOR_CLASSES.items()
            for name, source in sensor.presets().items()
        ],
        "weathers": [{"name": kind, "knob": weather.knob_name} for kind, weather in WEATHERS.items()],
        "size_distributions": {"rain": sorted(RAIN), "fog": sorted({*FOG, REHEARSE}), "snow": sorted(SNOW)},
        "stages": sorted(STAGES),
    }


def listing_text(names: dict[str, Any]) -> str:
    """The names as text."""
    from torchweather.explain import aligned

    lines = ["Recipes (torchweather apply --recipe NAME)", ""]
    lines += ["  " + line for line in aligned([[r["name"], r["title"], r["sensor"]] for r in names["recipes"]])]
    lines += ["", "Pipelines of several sensors or weathers (load_recipe NAME; torchweather augment --recipe NAME)", ""]
    lines += ["  " + line for line in aligned([[p["name"], p["title"]] for p in names["pipelines"]])]
    lines += ["", "Suites of weathers in five severities (torchweather robustness --recipe NAME)", ""]
    lines += ["  " + line for line in aligned([[s["name"], s["title"]] for s in names["suites"]])]
    lines += ["", "Sensors (--sensor NAME)", ""]
    for sensor in names["sensors"]:
        wrapped = textwrap.wrap(sensor["source"], 100, initial_indent=" " * 6, subsequent_indent=" " * 6)
        lines += [f"  {sensor['name']}", *wrapped]
    lines += ["", "Weathers (--weather KIND:KNOB=VALUE,size_distribution=NAME; join several by +)", ""]
    rows = [
        [weather["name"], weather["knob"], ", ".join(names["size_distributions"][weather["name"]])]
        for weather in names["weathers"]
    ]
    lines += ["  " + line for line in aligned([["kind", "knob", "size distributions"], *rows])]
    return "\n".join([*lines, "", "Stages", "", *(f"  {name}" for name in names["stages"])])
