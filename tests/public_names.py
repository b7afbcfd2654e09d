"""The list of public names: ``python -m tests.public_names`` writes docs/public-names.md anew.

A name that leaves the list needs a line in CHANGELOG.md and an old name that works for one minor release.
"""

from __future__ import annotations

import importlib
import re
import textwrap
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "public-names.md"
MODULES = {
    "torchweather": "the classes that most users need",
    "torchweather.sensors": "sensors and their geometry",
    "torchweather.transforms": "the transforms of all sensors",
    "torchweather.stages": "stages and chains, for transforms of one's own",
    "torchweather.atmosphere.weather": "weather",
    "torchweather.atmosphere.conditions": "water and snow on things",
    "torchweather.atmosphere.density_field": "banks and gusts",
    "torchweather.camera.depth": "depth and sky of images",
    "torchweather.camera.effects.all": "effects of cameras",
    "torchweather.lidar": "LiDAR: completion of scans, fits of a sensor",
    "torchweather.lidar.effects.all": "effects of LiDAR",
    "torchweather.radar": "radar: lists, maps, chirps",
    "torchweather.radar.effects.all": "effects of radar",
    "torchweather.radar.power_map": "axes and scales of power maps",
    "torchweather.pipeline.effect": "effects of one's own",
    "torchweather.compose": "several sensors of a sample, batches",
    "torchweather.recipes": "recipes: load, save, list",
    "torchweather.image": "mosaics, colours, levels",
    "torchweather.io": "files of images, points and radar",
    "torchweather.datasets": "data sets, boxes, calibrations",
    "torchweather.datasets.augment": "whole data sets in weather",
    "torchweather.metrics": "scores of images, clouds, detections",
    "torchweather.evaluation.sweep": "scores over rates and visibilities",
    "torchweather.evaluation.robustness": "detectors in weather",
    "torchweather.evaluation.validation": "simulation beside recordings",
    "torchweather.evaluation.fit": "rate or visibility from recordings",
    "torchweather.export": "ONNX",
    "torchweather.gap": "effects that the simulation lacks",
    "torchweather.scenes": "scenes of known truth",
    "torchweather.physics": "size distributions, optics, radio",
    "torchweather.core.errors": "errors and warnings",
    "torchweather.core.random": "streams of random numbers",
}
HEAD = """# Public names

These names are public: {number} in {modules} modules. Everything else may change without notice, also what else a
module holds.

- A public name that goes, or gets another name or place, works for one more minor release. Its use gives a
  `DeprecationWarning` that names what to write instead.
- Arguments of public functions count as public names; so do the keys of recipes, studies, manifests and JSON output.
- A change of results is named in the [changelog](../CHANGELOG.md). The draws of a seed are a rule of their own:
  [conventions](conventions.md#seeds).
- `tests/test_public_names.py` compares this page with the code.
"""


def names_of(module: str) -> list[str]:
    """Public names of a module, sorted."""
    return sorted(importlib.import_module(module).__all__, key=lambda name: (name.lower(), name))


def documented_members() -> Iterator[tuple[str, str]]:
    """Docstrings of public modules, functions and classes, and of the public members of these, each once.

    Members that a class inherits inside the package count as its own. A value counts by the class that it is of.
    """
    seen = set()
    for module in MODULES:
        yield module, importlib.import_module(module).__doc__ or ""
        for name in names_of(module):
            named = getattr(importlib.import_module(module), name)
            found = named if callable(named) else type(named)
            if not found.__module__.startswith("torchweather"):
                continue
            yield from _once(f"{module}.{name}", found, seen)
            for base in found.__mro__ if isinstance(found, type) else ():
                if base.__module__.startswith("torchweather"):
                    for inside, member in vars(base).items():
                        if not inside.startswith("_") or inside == "__call__":
                            yield from _once(f"{module}.{name}.{inside}", getattr(member, "__func__", member), seen)


def _once(name: str, found: object, seen: set[int]) -> Iterator[tuple[str, str]]:
    """Docstring of a function, class or property that was not met before."""
    if id(found) not in seen and (callable(found) or isinstance(found, (property, cached_property))):
        seen.add(id(found))
        if found.__doc__:
            yield name, found.__doc__


def written() -> dict[str, list[str]]:
    """Modules and their names as the page lists them."""
    sections = re.split(r"^## `(torchweather[\w.]*)`.*$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return {module: re.findall(r"`(\w+)`", text) for module, text in zip(sections[::2], sections[1::2], strict=True)}


def main() -> None:
    """Write the page."""
    each = {module: names_of(module) for module in MODULES}
    number = len({f"{module}.{name}" for module, names in each.items() for name in names})
    text = HEAD.format(number=number, modules=len(each))
    for module, names in each.items():
        listed = textwrap.fill(" ".join(f"`{name}`" for name in names), 120, break_long_words=False)
        text += f"\n## `{module}`: {MODULES[module]}\n\n{listed}\n"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
