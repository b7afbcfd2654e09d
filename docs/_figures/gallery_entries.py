"""Entries of the gallery: for each picture its title, the lines that make it, and the picture to compare it with."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import camera_pictures
import lidar_pictures
import lidar_structure
import lidar_surfaces
import radar_pictures
import yaml
from effect_drawing import setting_text

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.recipes import list_recipes, load_recipe
from torchweather.stages import EFFECTS

__all__ = ["CLEAR", "SETUP", "Entry", "entries", "without_effect"]

ROOT = Path(__file__).parents[2]
PRESETS = yaml.safe_load((ROOT / "torchweather" / "presets" / "sensors.yaml").read_text(encoding="utf-8"))
CLEAR = "clear"
# Lines that come first, for all entries of a sensor.
SETUP = {
    "camera": """\
import numpy as np
import torch
from PIL import Image

import torchweather as tw
from torchweather.camera.depth import ScenePrior
from torchweather.image import develop
from torchweather.scenes import test_track

photograph = Image.open("docs/images/photographs/downtown_street.jpg").convert("RGB")
image = torch.from_numpy(np.array(photograph.crop((290, 0, 1390, 396)).resize((560, 202)))).permute(2, 0, 1)
camera = tw.Camera.from_intrinsics(1570.0, 1570.0, 799.5, 124.0, 1600, 396, height_m=1.6, exposure_s=0.004)
camera = camera.cropped(0, 290, 396, 1100).resized(560, 202)
prior = ScenePrior(horizon="camera", street_half_width_m=(14.0, 10.0), farthest_m=110.0)
scene = prior.scene(camera, 202, 560, image=image)
""",
    "lidar": """\
import torchweather as tw
from torchweather.scenes import lidar_view, test_track

sensor = tw.Lidar.preset("ouster-os1-128", columns=256)
view = lidar_view(test_track(), sensor)
""",
    "radar": """\
import torch

import torchweather as tw
from torchweather.radar import FmcwRadar
from torchweather.scenes import radar_view, test_track

simulator = FmcwRadar(tw.Radar.preset("awr1843-like"))
scatterers = radar_view(test_track(), simulator.radar).scatterers
points = simulator(scatterers, simulator.draw(scatterers, seed=7))
radar = simulator.list_sensor
""",
}
PUT_ON = {
    "camera": """\
weather = tw.AsBayer(tw.BayerWeather({weather}, camera{effects}))
picture = weather(image, scene, weather.draw(image, seed=7))
""",
    "lidar": """\
weather = tw.LidarWeather({weather}, sensor{effects})
result = weather.run(view.points, weather.draw(view.points, seed=7), directions=view.directions)
""",
    "radar": """\
weather = tw.RadarAttenuation({weather}, radar{effects})
result = weather.run(points, weather.draw(points, seed=7){known})
""",
}
# Effects of the camera that need surfaces' directions, which a photograph lacks.
ON_THE_TRACK = ("camera.wet_surface", "camera.snow_cover")
PUT_ON_THE_TRACK = """\
camera = tw.Camera.preset("lucid-triton").resized(560, 424).cropped(140, 0, 202, 560)
view = test_track().view(camera)
weather = tw.BayerWeather({weather}, camera{effects})
result = weather.run(view.bayer, view.depth_m, weather.draw(view.bayer, seed=7), normal=view.normal)
picture = develop(result.bayer, camera.bayer_pattern)
"""
# What two effects of the radar need to know beside the detections.
KNOWN = {
    "radar.wet_rcs": ", target_class=torch.arange(len(points)) % 3",
    "radar.range_migration": ", frame_number=torch.tensor(50)",
}
PRESET = {
    "camera": """\
camera = tw.Camera.preset("{name}").resized({width}, {height})
view = test_track().view(camera)
rain = tw.BayerRain(tw.Rain(25.0), camera)
picture = develop(rain(view.bayer, view.depth_m, seed=7), camera.bayer_pattern)
""",
    "lidar": """\
{sensor}view = lidar_view(test_track(), sensor)
weather = tw.LidarSnow(tw.Snow(1.0), sensor)
result = weather.run(view.points, weather.draw(view.points, seed=7), directions=view.directions)
""",
    "radar": """\
simulator = FmcwRadar(tw.Radar.preset("{name}"))
scatterers = radar_view(test_track(), simulator.radar).scatterers
points = simulator(scatterers, simulator.draw(scatterers, seed=7))
weather = tw.RadarAttenuation(tw.Rain(50.0), simulator.list_sensor)
result = weather.run(points, weather.draw(points, seed=7))
""",
}
RECIPE = {
    "camera": """\
from torchweather.recipes import load_recipe

camera = tw.Camera.preset("{preset}").resized({width}, {height})
view = test_track().view(camera)
weather = load_recipe("{name}", sensor=camera)
picture = develop(weather(view.bayer, view.depth_m, seed=7), camera.bayer_pattern)
""",
    "lidar": """\
from torchweather.recipes import load_recipe

sensor = tw.Lidar.preset("{preset}"{columns})
view = lidar_view(test_track(), sensor)
weather = load_recipe("{name}", sensor=sensor)
result = weather.run(view.points, weather.draw(view.points, seed=7), directions=view.directions)
""",
    "radar": """\
from torchweather.recipes import load_recipe

simulator = FmcwRadar(tw.Radar.preset("{preset}"))
scatterers = radar_view(test_track(), simulator.radar).scatterers
points = simulator(scatterers, simulator.draw(scatterers, seed=7))
weather = load_recipe("{name}", sensor=simulator.list_sensor)
result = weather.run(points, weather.draw(points, seed=7))
""",
}
# Made-up scan patterns of presets that have none.
RASTERS = {
    "waymo-top": """\
elevations_deg = [2.4 - 20.0 / 63 * row for row in range(64)]
sensor = tw.Lidar.preset("waymo-top", elevations_deg=elevations_deg, columns=256)
""",
    "generic-1550nm": """\
elevations_deg = [7.5 - 0.25 * row for row in range(64)]
azimuths_deg = [60.0 - 0.75 * column for column in range(161)]
sensor = tw.Lidar.preset("generic-1550nm", elevations_deg=elevations_deg, azimuths_deg=azimuths_deg)
""",
    "aeva-aevascenes-wide": """\
elevations_deg = [7.5 - 0.25 * row for row in range(64)]
azimuths_deg = [55.0 - 0.6875 * column for column in range(161)]
sensor = tw.Lidar.preset("aeva-aevascenes-wide", elevations_deg=elevations_deg, azimuths_deg=azimuths_deg)
""",
}
POWER_MAP = """\
import sys

sys.path.insert(0, "examples")
from radar_map_in_rain import made_up

clear = made_up()
radar = tw.Radar.preset("{name}")
rain = tw.RadarMapWeather(tw.Rain(50.0), radar, axes=clear.axes, scale=clear.scale)
wet = rain.of_map(clear, seed=7)
"""
EFFECT_PICTURES: dict[str, Mapping[str, Any]] = {
    "camera": camera_pictures.PICTURES,
    "lidar": {**lidar_pictures.PICTURES, **lidar_structure.PICTURES, **lidar_surfaces.PICTURES},
    "radar": radar_pictures.PICTURES,
}
NIGHT = """\
import sys

sys.path.insert(0, "docs/_figures")
from night_photograph import night_street

day, image, camera, scene, night = night_street(560)
"""
PUT_ON_AT_NIGHT = """\
weather = tw.AsBayer(tw.BayerWeather({weather}, camera, night=night, scattering="multiple"))
picture = weather(image, scene, weather.draw(image, seed=7))
"""
NIGHT_WEATHERS = {
    "Fog of 60 m": "tw.Fog(60.0)",
    "Rain of 25 mm/h": "tw.Rain(25.0)",
    "Rain of 25 mm/h, wet road": "tw.Mixture(tw.Rain(25.0), tw.WetRoad(puddles=0.5))",
    "Snow of 2 mm/h": "tw.Snow(2.0)",
}
# Weathers beside the severities: title and expression.
WEATHERS = {
    "camera": {
        "Rain of 60 mm/h in mist of 400 m": "tw.Mixture(tw.Rain(60.0), tw.Fog(400.0))",
        "Snow of 2 mm/h in haze of 800 m": "tw.Mixture(tw.Snow(2.0), tw.Fog(800.0))",
        "Drizzle of 5 mm/h": 'tw.Rain(5.0, size_distribution="drizzle")',
        "Thunderstorm of 50 mm/h": 'tw.Rain(50.0, size_distribution="thunderstorm")',
        "Rain of 50 mm/h in wind of 8 m/s": "tw.Rain(50.0, wind_m_per_s=(0.0, -8.0, 0.0))",
        "Fog of 120 m in banks": "tw.Fog(120.0, patch_log_std=0.7, patch_length_m=15.0)",
        "Rain of 20 mm/h, wet road": "tw.Mixture(tw.Rain(20.0), tw.WetRoad(puddles=0.5))",
        "Rain of 20 mm/h, wet window": "tw.Mixture(tw.Rain(20.0), tw.WetWindow(speed_m_per_s=20.0, wiper_s=3.0))",
        "Rain of 20 mm/h, spray of a car ahead": "tw.Mixture(tw.Rain(20.0), tw.RoadSpray(20.0))",
        "Snow of 1 mm/h, lying snow": "tw.Mixture(tw.Snow(1.0), tw.SnowCover(20.0))",
    },
    "lidar": {
        "Rain of 10 mm/h in fog of 200 m": "tw.Mixture(tw.Rain(10.0), tw.Fog(200.0))",
        "Fog of 120 m in banks": "tw.Fog(120.0, patch_log_std=0.7, patch_length_m=15.0)",
        "Rain of 20 mm/h, wet road": "tw.Mixture(tw.Rain(20.0), tw.WetRoad(puddles=0.5))",
        "Rain of 20 mm/h, spray of a car ahead": "tw.Mixture(tw.Rain(20.0), tw.RoadSpray(20.0))",
        "Snow of 1 mm/h, lying snow": "tw.Mixture(tw.Snow(1.0), tw.SnowCover(20.0))",
    },
    "radar": {
        "Rain of 10 mm/h in fog of 200 m": "tw.Mixture(tw.Rain(10.0), tw.Fog(200.0))",
        "Melting snow of 3 mm/h": "tw.Snow(3.0, melt_fraction=0.5)",
    },
}
UNITS = {"rain": "mm/h", "snow": "mm/h", "fog": "m visibility"}
WIDTH_PX, HEIGHT_PX = 400, 300  # of a camera preset's picture, at most
COLUMNS = 256  # of a LiDAR preset's scan, at most


@dataclass(frozen=True)
class Entry:
    """A picture of the gallery.

    Args:
        name: of the file, without its ending.
        sensor: ``camera``, ``lidar`` or ``radar``.
        group: heading under which it stands.
        title: caption.
        code: lines that make it, after the setup of the sensor.
        before: name of the picture that the slider shows on its left side; empty for a picture that is one.
    """

    name: str
    sensor: str
    group: str
    title: str
    code: str
    before: str


def entries() -> Iterator[Entry]:
    """Every entry: clear air, severities, further weathers, effects and presets of each sensor."""
    for sensor in SETUP:
        yield Entry(f"{sensor}-{CLEAR}", sensor, "", "clear air", "", "")
        yield from severities(sensor)
        for title, weather in WEATHERS[sensor].items():
            yield weathered(f"{sensor}-{slug(title)}", sensor, "More weathers", title, weather)
        if sensor == "camera":
            yield from nights()
        yield from effects(sensor)
        yield from presets(sensor)
        yield from recipes(sensor)


def severities(sensor: str) -> Iterator[Entry]:
    """Rain, fog and snow of the suite, in five severities each."""
    for condition in load_recipe(f"{sensor}/robustness").conditions():
        kind = condition.weather.kind
        title = f"{kind.capitalize()}, severity {condition.severity}: {condition.value:g} {UNITS[kind]}"
        name = f"{sensor}-{kind}-{condition.severity}"
        yield weathered(name, sensor, f"{kind.capitalize()} in five severities", title, expression(condition.weather))


def nights() -> Iterator[Entry]:
    """Weathers on the photograph relit as by night, compared with clear air by night."""
    before = f"camera-night-{CLEAR}"
    for title, weather in NIGHT_WEATHERS.items():
        code = NIGHT + PUT_ON_AT_NIGHT.format(weather=weather)
        yield Entry(f"camera-night-{slug(title)}", "camera", "Night, on the day photograph relit", title, code, before)
    yield Entry(before, "camera", "", "clear air", NIGHT + "picture = image\n", "")


def weathered(name: str, sensor: str, group: str, title: str, weather: str) -> Entry:
    """A weather, compared with clear air."""
    return Entry(
        name, sensor, group, title, PUT_ON[sensor].format(weather=weather, effects="", known=""), f"{sensor}-{CLEAR}"
    )


def effects(sensor: str) -> Iterator[Entry]:
    """Every effect at its stronger setting, compared with the same weather without it."""
    compared = {}
    for name, drawn in EFFECT_PICTURES[sensor].items():
        weather = expression(drawn.weather)
        lines = PUT_ON_THE_TRACK if name in ON_THE_TRACK else PUT_ON[sensor]
        without = without_effect(sensor, weather, lines)
        compared[without.name] = without
        setting = {**drawn.common, **drawn.settings[1]}
        given = ", ".join(f'"{key}": {value!r}' for key, value in {"effect": name, **setting}.items())
        given = given.replace(f"'{name}'", f'"{name}"')
        code = lines.format(weather=weather, effects=", effects=[effect]", known=KNOWN.get(name, ""))
        title = f"{EFFECTS[name].title}: {setting_text(name, setting)}"
        yield Entry(name, sensor, "Effects", title, f"effect = {{{given}}}\n{code}", without.name)
    yield from compared.values()


def without_effect(sensor: str, weather: str, lines: str) -> Entry:
    """The weather that effects are compared in."""
    code = lines.format(weather=weather, effects="", known="")
    place = "-track" if lines is PUT_ON_THE_TRACK else ""
    return Entry(f"{sensor}{place}-{slug(weather.removeprefix('tw.'))}", sensor, "", "without the effect", code, "")


def presets(sensor: str) -> Iterator[Entry]:
    """Every preset in one weather, compared with clear air."""
    weather = {"camera": "rain of 25 mm/h", "lidar": "snow of 1 mm/h", "radar": "rain of 50 mm/h"}
    group = f"Presets on embedded scenes, in {weather[sensor]}"
    for name, fields in PRESETS[sensor].items():
        wanted, title = size_of(sensor, name), name
        if sensor == "lidar":
            wanted["sensor"] = RASTERS.get(name, f'sensor = tw.Lidar.preset("{name}"{wanted["columns"]})\n')
            title += ", made-up scan pattern" if name in RASTERS else ""
        code = PRESET[sensor].format(name=name, **wanted)
        if fields.get("chirps") == 1:  # turns and gives power maps, no detections
            code, title = POWER_MAP.format(name=name), f"{name}: power map of a made-up street"
        before = f"{sensor}-preset-{slug(name)}-{CLEAR}"
        yield Entry(f"{sensor}-preset-{slug(name)}", sensor, group, title, code, before)
        yield Entry(before, sensor, "", "clear air", code, "")


def size_of(sensor: str, preset: str) -> dict[str, Any]:
    """Size at which a preset looks at the embedded scene: a camera's picture, the columns of a LiDAR."""
    fields = PRESETS[sensor][preset]
    if sensor == "camera":
        scale = min(WIDTH_PX / fields["width"], HEIGHT_PX / fields["height"])
        return {side: 2 * round(scale * fields[side] / 2) for side in ("width", "height")}
    if sensor == "lidar":
        return {"columns": f", columns={COLUMNS}" if fields.get("columns", 0) > COLUMNS else ""}
    return {}


def recipes(sensor: str) -> Iterator[Entry]:
    """Every recipe that is one transform, compared with clear air; they stand on the page of recipes."""
    for recipe in list_recipes(kind="transform"):
        if recipe.name.startswith(f"{sensor}/"):
            preset = yaml.safe_load(recipe.path.read_text(encoding="utf-8"))["sensor"]["preset"]
            code = RECIPE[sensor].format(name=recipe.name, preset=preset, **size_of(sensor, preset))
            name = f"recipe-{slug(recipe.name)}"
            yield Entry(name, sensor, "", recipe.title, code, f"{sensor}-preset-{slug(preset)}-{CLEAR}")


def expression(weather: Weather) -> str:
    """A weather as it is written in code."""
    value = weather.mor_m if isinstance(weather, tw.Fog) else weather.intensity
    return f"tw.{type(weather).__name__}({float(value)!r})"


def slug(text: str) -> str:
    """A title as the name of a file."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.")
