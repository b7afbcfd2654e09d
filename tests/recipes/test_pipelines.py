"""Pipelines: ready-made ones load and come back from their own files; what is wrong in a file is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import torchweather as tw
from torchweather.core.errors import TorchweatherError
from torchweather.recipes.pipelines import list_pipelines, load_pipeline, read_pipeline, save_pipeline
from torchweather.recipes.recipes import list_recipes, load_recipe, read_recipe, save_recipe

SAMPLE = {
    "points": torch.tensor([[20.0, 0.0, 0.0, 50.0], [5.0, 5.0, 1.0, 20.0]]),
    "radar": torch.tensor([[50.0, 0.0, 0.0, -3.0, -100.0, 10.0]]),
}
# Two conditions of each sensor's tables in D3.4 stand for all.
D34 = {
    "camera": ("rain-50mm-per-h", "fog-10m", "snow-brandes-2.59mm-per-h"),
    "lidar": ("os1-rain-10mm-per-h", "os1-fog-20m", "os1-snow-brandes-3.03mm-per-h", "wads-snow-0.25mm-per-h"),
    "radar": ("imaging-rain-10mm-per-h", "imaging-fog-30m", "imaging-snow-brandes-2.70mm-per-h"),
}


@pytest.mark.parametrize("pipeline", list_pipelines(), ids=lambda one: one.name)
def test_a_ready_made_pipeline_comes_back_from_its_own_file(pipeline: Any, tmp_path: Path) -> None:
    compose = load_recipe(pipeline.name, history="weather")
    assert isinstance(compose, tw.Compose)
    path = tmp_path / "mine.yaml"
    save_pipeline(compose, path, title="Mine")
    again = load_pipeline(path, history="weather")
    assert again.weather == compose.weather
    assert list(again.plans) == list(compose.plans)
    for key, plan in compose.plans.items():
        assert again.plans[key].sensor == plan.sensor
    if "image" not in compose.plans:
        sample = {key: SAMPLE[key] for key in compose.plans}
        out, wanted = again(sample, seed=3), compose(sample, seed=3)
        assert out["weather"] == wanted["weather"]
        assert all(torch.equal(out[key], wanted[key]) for key in compose.plans)


def test_every_recipe_comes_back_from_its_own_file(tmp_path: Path) -> None:
    for recipe in list_recipes():
        transform = load_recipe(recipe.name)
        save_recipe(transform, tmp_path / "mine.yaml", title="Mine")
        again = load_recipe(tmp_path / "mine.yaml")
        inner, other = (getattr(one, "transform", one) for one in (transform, again))
        assert (other.weather, other.chain.to_dict()) == (inner.weather, inner.chain.to_dict()), recipe.name


@pytest.mark.parametrize("sensor", list(D34))
def test_the_conditions_of_the_deliverable_are_there(sensor: str) -> None:
    names = {recipe.name for recipe in list_recipes()}
    assert {f"{sensor}/{name}" for name in D34[sensor]} <= names


def test_a_training_mix_draws_every_weather_and_clear_air() -> None:
    compose = load_pipeline("lidar/training-mix")
    kinds = [
        None if draw.weather is None else draw.weather["kind"]
        for draw in (compose.draw(SAMPLE, seed=seed) for seed in range(200))
    ]
    assert set(kinds) == {None, "rain", "fog", "snow", "mixture"}
    # 4 of 11 stay clear: 73 of 200, four standard deviations are 27.
    assert abs(kinds.count(None) - 200 * 4 / 11) < 27


def changed(**changes: Any) -> dict[str, Any]:
    values = yaml.safe_load(read_pipeline("multi_sensor/rain-25mm-per-h").path.read_text())
    return {key: value for key, value in {**values, **changes}.items() if value is not ...}


LIDAR = {"transform": "LidarWeather", "sensor": {"kind": "lidar", "preset": "ouster-os1-128"}}


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"transfroms": {}}, "unknown key 'transfroms'.*Did you mean 'transforms'"),
        ({"weather": ...}, "lacks 'weather'"),
        ({"format": "torchweather-pipeline/9"}, "wanted a pipeline of format"),
        ({"weather": {"kind": "rain", "rate_mm_per_h": {"unifrom": [1, 2]}}}, "weather: .*wanted a number or one of"),
        ({"weather": {"kind": "rain", "rate_mm_per_h": {"uniform": [-1, 2]}}}, "rate_mm_per_h must lie"),
        ({"weather": {"choice": [None]}}, "at least one weather that is not null"),
        ({"weather": {"choice": [None], "weight": [1]}}, "wanted choice"),
        ({"transforms": {"points": {**LIDAR, "sensors": 1}}}, "unknown key of transforms.points 'sensors'"),
        ({"transforms": {"points": {**LIDAR, "transform": "LidarRian"}}}, "Did you mean 'LidarRain'"),
        (
            {"transforms": {"points": {**LIDAR, "sensor": {"kind": "radar", "preset": "x"}}}},
            "sensor.kind must be lidar",
        ),
        ({"transforms": {"points": {**LIDAR, "options": {"lsot": "nan"}}}}, "unknown option 'lsot'"),
        ({"transforms": {}}, "must be keys with values"),
        ({"p": 2}, "p must lie"),
        ({"inputs": {"point": {"directions": "beams"}}}, "inputs names 'point'"),
        ({"inputs": ["beams"]}, "inputs must be keys of transforms"),
        ({"depth": 3}, "depth must be a key of the sample"),
        ({"transforms": {"points": {"sensor": LIDAR["sensor"]}}}, "transforms.points lacks 'transform'"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(values: dict[str, Any], match: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(changed(**values)))
    with pytest.raises(TorchweatherError, match=match) as error:
        load_pipeline(path)
    assert str(path) in str(error.value)


def test_names_and_overrides_that_are_unknown_are_refused() -> None:
    with pytest.raises(ValueError, match=r"pipeline must be one of .*multi_sensor/training-mix"):
        load_pipeline("trainingmix")
    with pytest.raises(ValueError, match=r"unknown override 'seeds'.*'seed'"):
        load_recipe("multi_sensor/training-mix", seeds=1)
    with pytest.raises(ValueError, match="could be camera/training-mix, lidar/training-mix"):
        load_pipeline("training-mix")


def test_sensors_options_and_keys_can_be_those_of_one_s_own_car() -> None:
    camera = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
    changes = {"image": {"sensor": camera, "rgb": False, "depth": 30.0, "airlight": 0.7}, "radar": None}
    mine = load_pipeline(
        "multi_sensor/training-mix", transforms=changes, keys={"image": "CAM_FRONT"}, weather="fog:mor=50"
    )
    assert list(mine.plans) == ["CAM_FRONT", "points"]
    frame = torch.full((1, 24, 32), 0.3)
    wanted = tw.BayerFog(tw.Fog(mor_m=50.0), camera, depth=30.0, airlight=0.7)(frame)
    assert torch.equal(mine({"CAM_FRONT": frame, "points": SAMPLE["points"]}, seed=1)["CAM_FRONT"], wanted)
    assert "image" in load_pipeline("multi_sensor/training-mix").plans


@pytest.mark.parametrize(
    ("overrides", "match"),
    [
        ({"transforms": {"point": {}}}, "transforms: unknown override 'point'.*'points'"),
        ({"transforms": {"points": {"depth": 3.0}}}, "'points': unknown override 'depth'"),
        ({"transforms": {"points": {"sensor": "radar"}}}, "sensor must be a lidar; got radar"),
        ({"keys": {"image": "points"}}, "two transforms would go to 'points'"),
        ({"keys": {"imag": "a"}}, "keys: unknown override 'imag'"),
        ({"weather": [None]}, "at least one weather that is not null"),
        ({"transforms": {"image": None, "points": None, "radar": None}}, "at least one key"),
    ],
)
def test_overrides_that_do_not_fit_are_named(overrides: dict[str, Any], match: str) -> None:
    with pytest.raises(TorchweatherError, match=match):
        load_pipeline("multi_sensor/training-mix", **overrides)


def test_inputs_of_a_file_follow_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(changed(inputs={"points": {"directions": "beams"}})))
    assert load_pipeline(path, keys={"points": "LIDAR_TOP"}).inputs == {"LIDAR_TOP": {"directions": "beams"}}
    assert load_pipeline(path, transforms={"points": None}).inputs == {}


def test_only_clear_air_cannot_be_saved(tmp_path: Path) -> None:
    lidar = tw.LidarFog(tw.Fog(mor_m=50.0), tw.Lidar.preset("velodyne-hdl-64e"))
    with pytest.raises(ValueError, match="not null"):
        save_pipeline(tw.Compose({"points": lidar}, weather=[None]), tmp_path / "mine.yaml", title="Clear")
    assert list(tmp_path.iterdir()) == []


def test_a_pipeline_where_a_recipe_is_wanted_is_called_one() -> None:
    with pytest.raises(ValueError, match="'multi_sensor/fog-10m' is a pipeline, where a recipe is wanted"):
        read_recipe("multi_sensor/fog-10m")
    with pytest.raises(ValueError, match="'lidar/robustness' is a suite, where a pipeline is wanted"):
        load_pipeline("lidar/robustness")
