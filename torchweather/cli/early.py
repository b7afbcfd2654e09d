"""Mistakes in the arguments that need no torch to be seen, which takes seconds to load.

The commands find the same mistakes later, with the same messages; a test compares them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from torchweather.cli.apply import ARGUMENTS
from torchweather.cli.listing import kept_names
from torchweather.core.exceptions import InputValueError
from torchweather.core.plugins import find_recipe, plugin_names, recipe_names
from torchweather.core.text import nearest_name

__all__ = ["refuse_early"]

SENSORS = {"camera": "Camera", "lidar": "Lidar", "radar": "Radar"}
OWN_FILES = (".yaml", ".yml")
SCENE = "scene:"  # in place of a file


def refuse_early(args: argparse.Namespace, command: str) -> None:
    """Raise for unknown names and missing files of some commands.

    Raises:
        InputValueError: a weather, recipe or sensor of no such name, or no such file.
    """
    if command == "apply" and args.weather is None and args.recipe is None:
        raise InputValueError("apply: give --weather, such as fog:mor=30, or --recipe (see torchweather list).")
    if command == "apply" and not _plain(args):
        return
    if command in ("apply", "explain", "view"):
        if args.weather is not None:
            _refuse_weather(args.weather)
        if args.sensor is not None:
            _refuse_preset(args.sensor)
    if command == "apply":
        if args.recipe is not None:
            _refuse_recipe(args.recipe)
        _refuse_missing(args.inputs, "no such file")
    if command == "view":
        _refuse_missing([args.input], "no such file")
    if command == "metrics":
        _refuse_missing([args.reference, args.distorted], "no such file or folder")


def _plain(args: argparse.Namespace) -> bool:
    """Check whether ``apply`` has one input and no argument of one kind of sensor: others are looked at first."""
    special = {name for names in ARGUMENTS.values() for name in names}
    return len(args.inputs) == 1 and all(getattr(args, name) in (None, False) for name in special)


def _refuse_weather(text: str) -> None:
    names = kept_names()
    kinds = [one["name"] for one in (*names["weathers"], *names["conditions"])] + plugin_names("weathers")
    for part in text.split("+"):
        kind = part.strip().partition(":")[0]
        if kind not in kinds:
            raise InputValueError(
                f"torchweather: weather must be one of {', '.join(kinds)}; got {kind!r}.{nearest_name(kind, kinds)}"
            )


def _refuse_preset(text: str) -> None:
    kind, _, preset = text.partition(":")
    if preset.endswith(OWN_FILES) or Path(preset).exists():
        return
    presets = [one["name"].removeprefix(f"{kind}:") for one in kept_names()["sensors"] if one["name"].startswith(kind)]
    presets += plugin_names("sensors", f"{kind}.")
    if kind in SENSORS and preset and preset not in presets:
        raise InputValueError(
            f"{SENSORS[kind]}: preset must be one of {', '.join(presets)}; got {preset!r}."
            f"{nearest_name(preset, presets)}"
        )


def _refuse_recipe(wanted: str) -> None:
    """Of a name alone: what kind of recipe it is, and what is in a file of one's own, is seen later."""
    if wanted.endswith(OWN_FILES):
        return
    names = kept_names()
    every = [one["name"] for kind in ("recipes", "pipelines", "suites") for one in names[kind]]
    if any(wanted in (name, name.rpartition("/")[2]) for name in every) or find_recipe(wanted, every):
        return
    own = (one["name"] for one in names["recipes"] if one["kind"] == "transform")
    known = sorted([*own, *recipe_names(["transform"])])
    near = nearest_name(wanted, [*known, *(name.rpartition("/")[2] for name in known)])
    raise InputValueError(
        f"torchweather: recipe must be one of {', '.join(known)}, or a file ending in .yaml; got {wanted!r}.{near}"
    )


def _refuse_missing(paths: Sequence[Path], text: str) -> None:
    for path in paths:
        if not str(path).startswith(SCENE) and not path.exists():
            raise InputValueError(f"{path}: {text}.")
