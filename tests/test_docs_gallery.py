"""The gallery: every severity, effect and preset has its picture, with the lines that made it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

import torchweather as tw
from tests.test_docs_effects import module_of
from torchweather.recipes import load_recipe
from torchweather.stages import EFFECTS

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "images" / "gallery"
MOST_BYTES = 3_000_000  # of all pictures
TABLE: dict[str, Any] = json.loads((FOLDER / "gallery.json").read_text(encoding="utf-8"))
SENSORS = ("camera", "lidar", "radar")


def names(sensor: str) -> set[str]:
    return {entry["name"] for entry in TABLE["entries"] if entry["sensor"] == sensor}


def test_the_table_is_what_the_script_would_write() -> None:
    made = module_of(ROOT / "docs" / "_figures" / "gallery_entries.py")
    assert TABLE["setup"] == made.SETUP, "run docs/_figures/gallery.py"
    listed = {entry.name: (entry.code, entry.title, entry.before) for entry in made.entries()}
    assert {e["name"]: (e["code"], e["title"], e["before"]) for e in TABLE["entries"]} == listed


def test_every_entry_has_its_picture_and_all_are_small() -> None:
    paths = {entry["name"]: FOLDER / f"{entry['name']}.webp" for entry in TABLE["entries"]}
    assert sorted(paths.values()) == sorted(FOLDER.glob("*.webp"))
    assert sum(path.stat().st_size for path in paths.values()) < MOST_BYTES
    for entry in TABLE["entries"]:
        if entry["before"]:  # a slider lays one over the other
            with Image.open(paths[entry["name"]]) as after, Image.open(paths[entry["before"]]) as before:
                assert after.size == before.size, entry["name"]


@pytest.mark.parametrize("sensor", SENSORS)
def test_every_severity_effect_and_preset_is_shown(sensor: str) -> None:
    severities = {f"{sensor}-{c.weather.kind}-{c.severity}" for c in load_recipe(f"{sensor}/robustness").conditions()}
    effects = {name for name, effect in EFFECTS.items() if name.startswith(f"{sensor}.")}
    presets = {
        f"{sensor}-preset-{name}"
        for name in module_of(ROOT / "docs" / "_figures" / "gallery_entries.py").PRESETS[sensor]
        if scans(sensor, name)
    }
    assert severities | effects | presets <= names(sensor)
    assert min(len(severities), len(effects), len(presets)) > 1


def scans(sensor: str, name: str) -> bool:
    """Whether a preset gives a picture, a scan or detections of a scene."""
    if sensor == "lidar":
        return tw.Lidar.preset(name).elevations_deg is not None
    return sensor == "camera" or tw.Radar.preset(name).chirps > 1


def test_the_page_of_every_effect_and_weather_has_its_picture() -> None:
    pictures = module_of(ROOT / "docs" / "_site" / "pictures.py")
    for name, effect in EFFECTS.items():
        if name.partition(".")[0] in SENSORS:
            assert pictures.picture_of_class(effect.__name__, TABLE)["name"] == name
    for name, wanted in pictures.OF_CLASS.items():
        assert pictures.picture_of_class(name, TABLE)["name"] == wanted
        assert hasattr(tw, name)
    assert pictures.picture_of_class("Compose", TABLE) is None


@pytest.mark.parametrize("name", ["camera-fog-3", "lidar-snow-1", "radar-rain-5"])
def test_lines_of_an_entry_run_and_change_the_data(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    (entry,) = [entry for entry in TABLE["entries"] if entry["name"] == name]
    found: dict[str, Any] = {}
    exec(compile(TABLE["setup"][entry["sensor"]] + entry["code"], name, "exec"), found)
    if entry["sensor"] == "camera":
        assert found["picture"].shape == found["image"].shape
        assert not torch.equal(found["picture"], found["image"])
    else:
        before = found["view"].points if entry["sensor"] == "lidar" else found["points"]
        assert found["result"].points.shape == before.shape
        assert not torch.equal(found["result"].points, before)
