"""Places that must follow a new effect or a new sensor preset, and what is still missing in them.

python -m tests.what_is_missing      # nothing is missing: exit code 0

CONTRIBUTING.md walks through both. The tests of each place say the same later, one at a time.
"""

from __future__ import annotations

import importlib
import inspect
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests import listed_names, public_names
from tests.behaviour.record import answered
from torchweather.sensors import Camera, Lidar, Radar, Sensor
from torchweather.stages import EFFECTS, Effect

ROOT = Path(__file__).parents[1]
SENSORS: tuple[type[Sensor], ...] = (Camera, Lidar, Radar)
# Of each sensor: the tests with CATALOGUE and the order in the chain, those with ACTIVE, those of the page.
CONTRACTS = {
    "camera": "tests.camera.effects.test_effects_camera",
    "lidar": "tests.lidar.effects.test_effects_lidar_contract",
    "radar": "tests.radar.effects.test_effects_radar_contract",
}
SCENES = {
    "camera": "tests.camera.effects.camera_effect_scene",
    "lidar": "tests.lidar.effects.effect_scene",
    "radar": "tests.radar.effects.radar_effect_scene",
}
PAGES = {
    "camera": "tests.test_docs_effects_camera",
    "lidar": "tests.test_docs_effects",
    "radar": "tests.test_docs_effects_radar",
}
# Tests that list the presets of a kind by name.
LISTED_PRESETS = {"lidar": "tests/lidar/test_scan.py"}
SHORTEST_SOURCE = 20  # characters; of tests/pipeline/test_sensors.py


def main() -> int:
    """Print what is missing."""
    found = [*of_effects(), *of_presets(), *of_lists()]
    for line in found:
        print(line)
    print(f"{len(found)} places are missing." if found else "Nothing is missing.")
    return 1 if found else 0


def of_effects() -> Iterator[str]:
    """Places of each effect."""
    for sensor in CONTRACTS:
        package = importlib.import_module(f"torchweather.{sensor}.effects.all")
        yield from _unregistered(sensor)
        for name in [name for name in EFFECTS if name.startswith(f"{sensor}.")]:
            if EFFECTS[name].__name__ not in package.__all__:
                yield f"{name}: add {EFFECTS[name].__name__} to __all__ of torchweather/{sensor}/effects/all.py."
            yield from _in_tests(sensor, name)
            yield from _on_the_page(sensor, name)


def _unregistered(sensor: str) -> Iterator[str]:
    """Effects whose class is there and not in the catalogue."""
    for file in sorted((ROOT / "torchweather" / sensor / "effects").glob("*.py")):
        module = importlib.import_module(f"torchweather.{sensor}.effects.{file.stem}")
        for _, kind in inspect.getmembers(module, inspect.isclass):
            own = issubclass(kind, Effect) and kind.__module__ == module.__name__ and "id" in kind.__dict__
            if own and kind.id not in EFFECTS:
                yield f"{kind.id}: register {kind.__name__} in torchweather/{sensor}/effects/all.py."


def _in_tests(sensor: str, name: str) -> Iterator[str]:
    contract, scene = importlib.import_module(CONTRACTS[sensor]), importlib.import_module(SCENES[sensor])
    file = _file(contract)
    identities = {one.name: one.identity for one in EFFECTS[name].arguments}
    if contract.CATALOGUE.get(name) != identities:
        yield f"{name}: write {identities!r} into CATALOGUE of {file}, in the order of the catalogue."
    if name not in scene.ACTIVE:
        yield f"{name}: add values at which it acts to ACTIVE of {_file(scene)}."
    together = getattr(contract, "BEAMS_TOGETHER", None)
    if together is not None and getattr(EFFECTS[name], "each_beam_alone", False) != (name not in together):
        yield f"{name}: set each_beam_alone = True where a beam needs no other, or add it to BEAMS_TOGETHER of {file}."
    text = (ROOT / file).read_text(encoding="utf-8")
    if f'"{EFFECTS[name].default_name}"' not in text:
        yield f"{name}: add its place in the chain to the test of the order in {file}."
    if EFFECTS[name].percollect is not None:
        count = sum(kind.percollect is not None for id_, kind in EFFECTS.items() if id_.startswith(f"{sensor}."))
        if "percollect" in text and f"for title in titles) == {count}" not in text:
            yield f"{name}: count its title of the cause tree in {file} ({count} titles)."


def _on_the_page(sensor: str, name: str) -> Iterator[str]:
    page: Any = importlib.import_module(PAGES[sensor])
    where, effect = page.PAGE.relative_to(ROOT), EFFECTS[name]
    section = page.sections_of(page.PAGE).get(page.heading(effect))
    if section is None:
        yield (
            f"{name}: add a section '## {page.heading(effect)}' to {where}, in the order of the catalogue, with the\n"
            f"    line `{name}` · {effect.term}, a picture, words, the table and the list as of its neighbours."
        )
    elif missing := [line for line in page_lines(page, effect) if line not in section]:
        yield f"{name}: its section of {where} lacks the line {missing[0]!r}."
    script = page.module_of(page.SCRIPT)
    if name not in script.PICTURES:
        yield f"{name}: add it to PICTURES of docs/_figures/{sensor}_*.py, in the order of the catalogue."
    picture = page.PICTURES / f"{name}.png"
    if not picture.is_file():
        command = f"python {page.SCRIPT.relative_to(ROOT)} --out {page.PICTURES.relative_to(ROOT)} {name}"
        yield f"{name}: draw {picture.relative_to(ROOT)}: {command}"


def page_lines(page: Any, effect: type[Effect]) -> list[str]:
    """Lines that the section of an effect must have."""
    of_camera = not hasattr(page, "table")
    table = [*page.HEAD, *(page.row(one) for one in effect.arguments)] if of_camera else page.table(effect)
    return [f"`{effect.id}` · {effect.term}", *table, *page.facts(effect)]


def of_presets() -> Iterator[str]:
    """Places of each sensor preset."""
    for kind in SENSORS:
        for name, source in kind.presets().items():
            if len(source) <= SHORTEST_SOURCE:
                yield f"{kind.kind}:{name}: give the source of its numbers in torchweather/presets/sensors.yaml."
            file = LISTED_PRESETS.get(kind.kind)
            if file is not None and f'"{name}"' not in (ROOT / file).read_text(encoding="utf-8"):
                yield f"{kind.kind}:{name}: add it to {file}, which lists presets, their near range and intensity unit."


def of_lists() -> Iterator[str]:
    """Files that are written by commands."""
    if listed_names.FILE.read_text(encoding="utf-8") != listed_names.text_of_names():
        yield "names of `torchweather list`: run python -m tests.listed_names"
    if public_names.written() != {module: public_names.names_of(module) for module in public_names.MODULES}:
        yield "docs/public-names.md: run python -m tests.public_names"
    gallery: Any = importlib.import_module("tests.test_docs_gallery")
    entries = importlib.import_module("tests.test_docs_effects").module_of(ROOT / "docs/_figures/gallery_entries.py")
    drawn = {entry["name"]: entry["code"] for entry in gallery.TABLE["entries"]}
    changed = [entry.name for entry in entries.entries() if drawn.get(entry.name) != entry.code]
    if changed:
        yield f"{', '.join(changed)}: draw them for the gallery: python docs/_figures/gallery.py"
    record = json.loads((ROOT / "tests" / "behaviour" / "record.json").read_text(encoding="utf-8"))
    unrecorded = [
        name
        for name in EFFECTS
        if f"effects/{name}" not in record["cases"] and EFFECTS[name].__module__.startswith("torchweather.")
    ]
    if unrecorded:
        yield f"{', '.join(unrecorded)}: run python -m tests.behaviour.record --write (minutes)"
    if answered("presets")["hash"] != record["cases"]["presets"]["hash"]:
        yield "sensor presets: run python -m tests.behaviour.record --write (minutes)"


def _file(module: Any) -> str:
    return str(Path(module.__file__).relative_to(ROOT))


if __name__ == "__main__":
    sys.exit(main())
