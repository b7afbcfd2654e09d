"""Files of recipes: what is wrong in one is refused with the file and the dotted key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from torchweather.atmosphere.weather import Fog, Mixture, Rain
from torchweather.core.errors import TorchweatherError
from torchweather.recipes import read_recipe
from torchweather.recipes.schema import FORMAT
from torchweather.sensors import Camera, Lidar

RATES = [1.0, 2.0, 3.0, 4.0, 5.0]
LIDAR = {"transform": "LidarWeather", "sensor": {"kind": "lidar", "preset": "ouster-os1-128"}}
RADAR = {"kind": "radar", "preset": "x"}
GOOD: dict[str, dict[str, Any]] = {
    "transform": {
        "transform": "BayerFog",
        "weather": {"kind": "fog", "mor_m": 40.0},
        "sensor": {"kind": "camera", "preset": "lucid-triton", "exposure_s": 0.01},
        "options": {"airlight": 0.7},
    },
    "multi_sensor": {"weather": {"kind": "rain", "rate_mm_per_h": 25.0}, "transforms": {"points": LIDAR}, "p": 1.0},
    "suite": {"sensor": {"kind": "camera"}, "weathers": {"rain": {"rate_mm_per_h": RATES}}},
}
KITTI = {"kind": "camera", "preset": "kitti"}
VLP = {"kind": "lidar", "preset": "velodyne-vlp-16"}


def written(folder: Path, of: str, /, **changes: Any) -> Path:
    """A file of a kind with keys changed; ``...`` leaves one out."""
    values = {"format": FORMAT, "kind": of, "title": "mine", **GOOD[of], **changes}
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not ...}))
    return path


def rain(**fields: Any) -> dict[str, Any]:
    return {"weathers": {"rain": {"rate_mm_per_h": RATES, **fields}}}


def test_good_files_are_read(tmp_path: Path) -> None:
    recipe = read_recipe(written(tmp_path, "transform", options=None), "transform")
    assert recipe.build_camera() == Camera.preset("lucid-triton", exposure_s=0.01)  # fields replace the preset's
    assert (recipe.options, recipe.name) == ({}, "mine")
    lidar = read_recipe(written(tmp_path, "transform", transform="LidarFog", sensor=VLP, options=...), "transform")
    assert lidar.build_sensor() == Lidar.preset("velodyne-vlp-16")
    parts = [{"kind": "rain", "rate_mm_per_h": RATES}, {"kind": "fog", "mor_m": 300.0}]
    suite = read_recipe(written(tmp_path, "suite", weathers={"rain-in-fog": {"parts": parts}}), "suite")
    found = suite.conditions()
    assert [c.value for c in found] == RATES
    assert found[2].weather == Mixture(Rain(3.0), Fog(mor_m=300.0))
    assert (found[2].kind, found[2].name, found[2].severity) == ("rain", "rain-in-fog", 3)
    assert list(read_recipe(written(tmp_path, "multi_sensor"), "multi_sensor").transforms) == ["points"]


ALL_KINDS: list[tuple[dict[str, Any], str]] = [
    ({"format": "torchweather-recipe/9"}, r"format must be 'torchweather-recipe/2'; got 'torchweather-recipe/9'"),
    ({"kind": ...}, "kind must be one of transform, multi_sensor, suite; got None"),
    ({"kind": "multisensor"}, "kind must be one of .*Did you mean 'multi_sensor'"),
    ({"kind": ["suite"]}, "kind must be one of"),
    ({"title": ...}, "title is missing"),
    ({"title": ["a"]}, "title must be text"),
    ({"titel": "a"}, "unknown key 'titel'.*Did you mean 'title'"),
]
WRONG: dict[str, list[tuple[dict[str, Any], str]]] = {
    "transform": [
        ({"wether": {}}, "unknown key 'wether'.*Did you mean 'weather'"),
        ({"sensor": ...}, "sensor is missing"),
        ({"options": {"air_light": 0.7}}, "unknown key 'options.air_light'.*Did you mean 'airlight'"),
        ({"options": {"depth": "grond"}}, "options.depth must be metres, 'ground' or 'auto'; got 'grond'"),
        ({"options": [1]}, "options must be keys with values"),
        ({"transform": "BayerFrog"}, "transform must be one of .*Did you mean 'BayerFog'"),
        ({"weather": {"kind": "fog", "mor_m": -1.0}}, "weather: Fog: mor_m must"),
        ({"weather": {"kind": "fgo"}}, "weather: .*Did you mean 'fog'"),
        ({"weather": {"kind": "fog", "mor": 30.0}}, "weather: .*'mor'"),
        ({"weather": 3}, "weather must be keys with values; got 3"),
        ({"sensor": {"kind": "camera", "preset": "lucid"}}, "sensor: .*lucid-triton"),
        ({"sensor": {"kind": "lidar"}}, "sensor.kind must be camera; got 'lidar'"),
        (
            {"sensor": {"kind": "camera", "preset": "kitti", "widht": 3}},
            "unknown key 'sensor.widht'.*Did you mean 'width'",
        ),
        (
            {"sensor": {"kind": "camera", "preset": "kitti", "width": 3.5}},
            "sensor.width must be a whole number; got 3.5",
        ),
        ({"rgb": None}, "rgb must be true or false; got None"),
        ({"rgb": "yes"}, "rgb must be true or false; got 'yes'"),
        ({"through_mosaic": True}, "through_mosaic is for RGB images"),
        ({"transform": "LidarFog", "sensor": VLP, "options": {}, "rgb": True}, "rgb is for a camera"),
        ({"transform": "LidarFog", "sensor": VLP, "options": {"depth": 3.0}}, "unknown key 'options.depth'"),
        ({"transform": "LidarFog", "options": {}, "sensor": {"kind": "camera"}}, "sensor.kind must be lidar"),
        ({"transform": "LidarFog", "options": {}, "sensor": {**VLP, "return_mode": "all"}}, "sensor: .*return_mode"),
    ],
    "multi_sensor": [
        ({"transfroms": {}}, "unknown key 'transfroms'.*Did you mean 'transforms'"),
        ({"weather": ...}, "weather is missing"),
        ({"weather": {"kind": "rain", "rate_mm_per_h": {"unifrom": [1, 2]}}}, "weather: .*expected a number or one of"),
        ({"weather": {"kind": "rain", "rate_mm_per_h": {"uniform": [-1, 2]}}}, "weather: .*rate_mm_per_h must lie"),
        ({"weather": {"choice": [None]}}, "weather: .*at least one weather that is not null"),
        ({"weather": {"choice": [None], "weight": [1]}}, "weather: expected choice"),
        ({"transforms": {"points": {**LIDAR, "sensors": 1}}}, "unknown key 'transforms.points.sensors'.*'sensor'"),
        ({"transforms": {"points": {**LIDAR, "transform": "LidarRian"}}}, "transforms.points.transform.*'LidarRain'"),
        (
            {"transforms": {"points": {**LIDAR, "sensor": RADAR}}},
            "transforms.points.sensor.kind must be lidar",
        ),
        ({"transforms": {"points": {**LIDAR, "options": {"lsot": "nan"}}}}, "'transforms.points.options.lsot'.*'lost'"),
        ({"transforms": {"points": {"sensor": LIDAR["sensor"]}}}, "transforms.points.transform is missing"),
        ({"transforms": {"points": 3}}, "transforms.points must be keys with values"),
        ({"transforms": {}}, "transforms must be keys with values"),
        ({"p": 2}, r"p must be a number in \[0, 1\]; got 2"),
        ({"inputs": {"point": {"directions": "beams"}}}, "unknown key 'inputs.point'.*Did you mean 'points'"),
        ({"inputs": {"points": "beams"}}, "inputs.points must be keys with values"),
        ({"inputs": ["beams"]}, "inputs must be keys with values"),
        ({"depth": 3}, "depth must be a key of the sample; got 3"),
    ],
    "suite": [
        ({"wheathers": {}}, "unknown key 'wheathers'.*Did you mean 'weathers'"),
        ({"sensor": {"kind": "lider"}}, "sensor.kind must be one of .*Did you mean 'lidar'"),
        ({"sensor": {}}, "sensor.kind must be one of camera, lidar, radar; got None"),
        ({"sensor": {"kind": "camera", "preset": "lucid-tritom"}}, "sensor: .*Did you mean 'lucid-triton'"),
        ({"options": {"airligth": 1}}, "unknown key 'options.airligth'.*Did you mean 'airlight'"),
        ({"weathers": {}}, "weathers or effects is missing; expected keys with values"),
        ({"weathers": {"rian": {"mor_m": RATES}}}, "weathers.rian.kind must be one of .*Did you mean 'rain'"),
        ({"weathers": {"rain": 5}}, "weathers.rain must be keys with values"),
        ({"weathers": {"both": {"parts": {}}}}, "weathers.both.parts must be a list of entries with keys"),
        (rain(siz="x"), "weathers.rain: .*siz"),
        (rain(rate_mm_per_h=RATES[:4]), r"weathers.rain: expected 5 severities.*\[4\]"),
        (rain(rate_mm_per_h=5.0), "weathers.rain: expected 5 severities.*no list"),
        (rain(rate_mm_per_h=RATES[::-1]), "weathers.rain: severities must get heavier.*5 before 4"),
        (rain(rate_mm_per_h=[-1.0, *RATES[:4]]), "weathers.rain: .*rate_mm_per_h must lie in"),
        (rain(rate_mm_per_h=["a", *RATES[:4]]), "weathers.rain: .*rate_mm_per_h|float"),
        (
            {"weathers": {"both": {"parts": [{"kind": "fog"}, {"kind": "rain", "rate_mm_per_h": RATES}]}}},
            "weathers.both.mor_m is missing",
        ),
    ],
}
CASES = [
    pytest.param(kind, change, said, id=f"{kind}-{said}")
    for kind, wrong in WRONG.items()
    for change, said in [*ALL_KINDS, *wrong]
]


@pytest.mark.parametrize(("kind", "change", "said"), CASES)
def test_what_is_wrong_is_refused_with_file_and_key(
    kind: str, change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, kind, **change)
    with pytest.raises(TorchweatherError, match=said) as caught:
        read_recipe(path)
    assert str(caught.value).startswith(f"{path}: ")
