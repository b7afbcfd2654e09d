"""Reference of recipes and sensor presets, written from their YAML when the site is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pictures import pictures_of_recipe, read_table, slider

INDEX = """# Reference

- [Python](python.md): a page for each module, public class and function, from the docstrings.
- [Command line](command-line.md): every command with its arguments, from the parsers.
- [Recipes](recipes.md) and [sensor presets](presets.md), from their YAML.
- [Effects](effects.md): a page for each. All of a sensor on one page: [cameras](../effects-camera.md),
  [LiDAR](../effects-lidar.md), [radar](../effects-radar.md).
- [Metrics](../metrics.md), [the study folder](../study-folder.md) and [conventions](../conventions.md): frames, units,
  data contracts, seeds.
- [Equations](../PHYSICS.md), with units, defaults and sources. Docstrings cite them as `PHYSICS.md`.
"""
SENSORS = {"camera": "Cameras", "lidar": "LiDAR", "radar": "Radars"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    root = Path(config.docs_dir).parent
    pages = {
        "reference/index.md": INDEX,
        "reference/recipes.md": recipes(root / "transforms", read_table(Path(config.docs_dir))),
        "reference/presets.md": presets(root / "torchweather" / "presets" / "sensors.yaml"),
    }
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def recipes(folder: Path, table: dict[str, Any]) -> str:
    """Table of the recipes in each folder, and a picture of each that is one weather."""
    lines = [
        "# Recipes",
        "",
        "Load one by name, `torchweather.recipes.load_recipe`, or give the name to a command as `--recipe`.",
        "A `transform` is one weather before one sensor, with a picture below its table; clear air is on its left.",
        "A `multi_sensor` recipe puts one weather on all sensors of a sample, with a picture of each. Mixes draw",
        "another weather for each sample, and have no picture. A `suite` is a list of weathers and severities,",
        "which the gallery shows for [cameras](../gallery/camera.md), [LiDAR](../gallery/lidar.md) and",
        "[radar](../gallery/radar.md).",
    ]
    for part in sorted(path for path in folder.iterdir() if path.is_dir()):
        lines += ["", f"## {part.name}", "", "| name | kind | what it is |", "| --- | --- | --- |"]
        names = [f"{part.name}/{path.stem}" for path in sorted(part.glob("*.yaml"))]
        for name in names:
            recipe = yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8"))
            lines.append(f"| `{name}` | {recipe['kind']} | {cell(recipe['title'])} |")
        lines += pictures([(name, entry) for name in names for entry in pictures_of_recipe(name, table)])
    return "\n".join([*lines, ""])


def pictures(shown: list[tuple[str, dict[str, Any]]]) -> list[str]:
    """Sliders of the recipes that have pictures."""
    lines = []
    for name, entry in shown:
        lines += [
            "",
            '<div class="gallery-entry" markdown>',
            "",
            slider(entry, "../../"),
            "",
            f"`{name}`",
            "",
            "</div>",
        ]
    return ["", '<div class="gallery" markdown>', *lines, "", "</div>"] if lines else []


def presets(path: Path) -> str:
    """Fields and source of each sensor."""
    listed = yaml.safe_load(path.read_text(encoding="utf-8"))
    lines = [
        "# Sensor presets",
        "",
        "`Camera.preset(name)`, `Lidar.preset(name)` and `Radar.preset(name)` build a sensor.",
        "Keywords change its fields. The source of a preset names what is unverified.",
    ]
    for sensor, heading in SENSORS.items():
        lines += ["", f"## {heading}"]
        for name, fields in listed[sensor].items():
            lines += ["", f"### {name}", "", *cell(fields.get("source", "")).splitlines(), ""]
            lines += ["| field | value |", "| --- | --- |"]
            lines += [f"| `{field}` | {value(given)} |" for field, given in fields.items() if field != "source"]
    return "\n".join([*lines, ""])


def value(given: Any) -> str:
    """A field's value; of a long list only its ends."""
    if isinstance(given, list) and len(given) > 6:
        return f"{len(given)} values, {given[0]} to {given[-1]}"
    return f"`{cell(str(given))}`"


def cell(text: str) -> str:
    """A text in the cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
