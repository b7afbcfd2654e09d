"""Ready-made recipes of the three kinds build; what is saved comes back; overrides, names and earlier formats."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import torchweather as tw
from torchweather.core.errors import TorchweatherError
from torchweather.image import DepthMap, FlatGround
from torchweather.recipes import list_recipes, load_recipe, read_recipe, recipes_folder, save_recipe

SMALL = tw.Camera.from_intrinsics(40.0, 40.0, 15.5, 11.5, 32, 24)
HDL = tw.Lidar.preset("velodyne-hdl-64e")
AWR = tw.Radar.preset("awr1843-like")
RADAR_POINTS = torch.tensor([[30.0, 2.0, 0.0, -1.0, -100.0, 5.0], [60.0, 0.0, 0.0, 0.0, -139.0, -3.0]])
SAMPLE = {
    "points": torch.tensor([[20.0, 0.0, 0.0, 50.0], [5.0, 5.0, 1.0, 20.0]]),
    "radar": torch.tensor([[50.0, 0.0, 0.0, -3.0, -100.0, 10.0]]),
}
MIX = "multi_sensor/training-mix"
# Conditions of the camera tables of ROADVIEW D3.4: rain rates mm/h, fog visibilities m, snow rates mm/h (Table 4).
D34_RAIN, D34_FOG, D34_SNOW = {10.0, 25.0, 50.0}, {10.0, 20.0, 30.0, 50.0}, {2.59, 2.70, 3.03}
# Two conditions of each sensor's tables in D3.4 stand for all.
D34 = {
    "camera": ("rain-50mm-per-h", "fog-10m", "snow-brandes-2.59mm-per-h"),
    "lidar": ("os1-rain-10mm-per-h", "os1-fog-20m", "os1-snow-brandes-3.03mm-per-h", "wads-snow-0.25mm-per-h"),
    "radar": ("imaging-rain-10mm-per-h", "imaging-fog-30m", "imaging-snow-brandes-2.70mm-per-h"),
}


def saved(transform: Any, folder: Path) -> Any:
    """A transform that came back from its own file, which saved again is the same to the letter."""
    save_recipe(transform, folder / "mine.yaml", title="Mine")
    again = load_recipe(folder / "mine.yaml")
    save_recipe(again, folder / "twice.yaml", title="Mine")
    assert (folder / "twice.yaml").read_text() == (folder / "mine.yaml").read_text()
    return again


def same(first: Any, second: Any) -> bool:
    return torch.equal(first.nan_to_num(-1), second.nan_to_num(-1))


# ---- ready-made ones -------------------------------------------------------------------------------------------------


def test_every_file_is_one_recipe_of_one_kind() -> None:
    recipes = list_recipes()
    assert len({recipe.name for recipe in recipes}) == len(recipes) == len(list(recipes_folder().rglob("*.yaml")))
    assert Counter(recipe.kind for recipe in recipes).keys() == {"transform", "multi_sensor", "suite"}
    assert all(recipe.title for recipe in recipes)
    assert [*list_recipes("transform"), *list_recipes(("multi_sensor", "suite"))] == sorted(
        recipes, key=lambda recipe: (recipe.kind != "transform", recipe.name)
    )


@pytest.mark.parametrize("recipe", list_recipes("transform"), ids=lambda recipe: recipe.name)
def test_a_transform_builds_and_comes_back_from_its_own_file(recipe: Any, tmp_path: Path) -> None:
    given: dict[str, Any] = {"sensor": SMALL, "depth": 30.0, "airlight": 0.7} if recipe.sensor_kind == "camera" else {}
    transform = load_recipe(recipe.name, **given)
    assert type(transform).__name__ == recipe.transform
    assert recipe.name.startswith(f"{recipe.sensor_kind}/")
    assert transform.weather.to_dict() == recipe.build_weather().to_dict()
    transform = load_recipe(recipe.name)
    inner, other = (getattr(one, "transform", one) for one in (transform, saved(transform, tmp_path)))
    assert (other.weather, other.chain.to_dict()) == (inner.weather, inner.chain.to_dict())


@pytest.mark.parametrize("recipe", list_recipes("multi_sensor"), ids=lambda recipe: recipe.name)
def test_a_compose_comes_back_from_its_own_file(recipe: Any, tmp_path: Path) -> None:
    compose = load_recipe(recipe.name, history="weather")
    assert isinstance(compose, tw.Compose)
    saved(compose, tmp_path)
    again = load_recipe(tmp_path / "mine.yaml", history="weather")
    assert again.weather == compose.weather
    assert list(again.specs) == list(compose.specs)
    assert all(again.specs[key].sensor == spec.sensor for key, spec in compose.specs.items())
    if "image" not in compose.specs:
        sample = {key: SAMPLE[key] for key in compose.specs}
        out, wanted = again(sample, seed=3), compose(sample, seed=3)
        assert out["weather"] == wanted["weather"]
        assert all(torch.equal(out[key], wanted[key]) for key in compose.specs)


def test_the_conditions_of_d34_are_there() -> None:
    recipes = list_recipes("transform")
    weathers: list[Any] = [recipe.build_weather() for recipe in recipes if recipe.sensor_kind == "camera"]
    assert {w.rate_mm_per_h for w in weathers if w.kind == "rain"} == D34_RAIN
    assert {w.mor_m for w in weathers if w.kind == "fog"} == D34_FOG
    snow = [w for w in weathers if w.kind == "snow" and w.size_distribution == "brandes"]
    assert {w.rate_mm_per_h for w in snow} == D34_SNOW
    assert any(w.kind == "mixture" for w in weathers)
    names = {f"{sensor}/{name}" for sensor, some in D34.items() for name in some}
    assert names <= {recipe.name for recipe in recipes}


def test_a_training_mix_draws_every_weather_and_clear_air() -> None:
    compose = load_recipe("lidar/training-mix")
    kinds = [
        None if draw.weather is None else draw.weather["kind"]
        for draw in (compose.draw(SAMPLE, seed=seed) for seed in range(200))
    ]
    assert set(kinds) == {None, "rain", "fog", "snow", "mixture"}
    # 4 of 11 stay clear: 73 of 200, four standard deviations are 27.
    assert abs(kinds.count(None) - 200 * 4 / 11) < 27


def test_a_severity_is_the_same_weather_for_all_sensors_and_gets_heavier() -> None:
    suites = [load_recipe(f"{sensor}/robustness") for sensor in ("camera", "lidar", "radar")]
    assert [suite.sensor_kind for suite in suites] == ["camera", "lidar", "radar"]
    first = suites[0].conditions()
    assert all(suite.conditions() == first for suite in suites)
    assert [(c.name, c.severity) for c in first] == [(n, k) for n in ("rain", "fog", "snow") for k in range(1, 6)]
    for before, after in pairwise(first):
        if before.name == after.name:
            assert (after.value < before.value) == (after.name == "fog")
            assert before.weather != after.weather


# ---- names and kinds -------------------------------------------------------------------------------------------------


def test_a_recipe_is_found_by_its_short_name_and_its_path() -> None:
    whole = read_recipe("camera/fog-30m", "transform")
    assert read_recipe("fog-30m") == read_recipe(recipes_folder() / "camera" / "fog-30m.yaml") == whole
    assert whole.sensor_name == "camera:lucid-triton"
    assert read_recipe("fog-30m", "multi_sensor").name == "multi_sensor/fog-30m"
    assert read_recipe(MIX, "multi_sensor").sensor_name.startswith("image camera:lucid-triton, points lidar:")


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("fog-31m", None, "Did you mean 'fog-30m'"),
        ("lidr/robustness", "suite", "recipe must be one of camera/.*Did you mean 'lidar/robustness'"),
        ("trainingmix", "multi_sensor", rf"must be one of .*{MIX}"),
        ("training-mix", None, "could be camera/training-mix, lidar/training-mix"),
        ("robustness", "suite", "could be camera/robustness, lidar/robustness, radar/robustness"),
        ("multi_sensor/fog-10m", "transform", "is of kind multi_sensor; expected transform"),
        ("lidar/robustness", ("transform", "multi_sensor"), "is of kind suite; expected transform or multi_sensor"),
    ],
)
def test_a_name_of_none_of_several_or_of_another_kind_is_refused(name: str, kind: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        read_recipe(name, kind)


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match=r"fog-30m\.yaml: kind must be suite; got transform"):
        read_recipe(recipes_folder() / "camera" / "fog-30m.yaml", "suite")


@pytest.mark.parametrize(
    ("name", "form", "kind"),
    [
        ("camera/fog-30m", "recipe", "transform"),
        (MIX, "pipeline", "multi_sensor"),
        ("lidar/robustness", "suite", "suite"),
    ],
)
def test_a_file_of_an_earlier_format_is_read_with_a_warning(name: str, form: str, kind: str, tmp_path: Path) -> None:
    new = read_recipe(name)
    assert new.path is not None
    text = new.path.read_text().replace(f"recipe/2\nkind: {kind}\n", f"{form}/1\n")
    (tmp_path / "old.yaml").write_text(text)
    with pytest.warns(
        DeprecationWarning, match=rf"old\.yaml: .*{form}/1 is torchweather-recipe/2 with kind: {kind} now"
    ):
        old = read_recipe(tmp_path / "old.yaml")
    assert (old.kind, old.title) == (kind, new.title)


@pytest.mark.parametrize(
    ("old", "name", "new", "given"),
    [
        ("pipelines", "load_pipeline", "recipes.load_recipe", ("fog-10m",)),
        ("pipelines", "read_pipeline", "recipes.read_recipe", ("fog-10m",)),
        ("pipelines", "list_pipelines", r"recipes.list_recipes\('multi_sensor'\)", ()),
        ("suites", "read_suite", "recipes.read_recipe", ("camera/robustness",)),
        ("suites", "list_suites", r"recipes.list_recipes\('suite'\)", ()),
    ],
)
@pytest.mark.parametrize("room", ["recipes", "transforms"])
def test_an_earlier_name_works_with_a_warning(old: str, name: str, new: str, given: Any, room: str) -> None:
    module = importlib.import_module(f"torchweather.{room}.{old}")
    with pytest.warns(DeprecationWarning, match=f"{name} is torchweather.{new} now; the old name goes"):
        found = getattr(module, name)(*given)
    if given:
        assert getattr(found, "kind", "multi_sensor") == {"pipelines": "multi_sensor", "suites": "suite"}[old]
    else:
        assert [one.name for one in found] == [one.name for one in list_recipes(found[0].kind)]


def test_a_name_that_no_earlier_module_had_is_none() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        importlib.import_module("torchweather.recipes.suites").nothing  # noqa: B018


# ---- overrides -------------------------------------------------------------------------------------------------------


def test_overrides_replace_weather_sensor_and_options() -> None:
    camera = load_recipe("fog-30m", weather="rain:rate=5", sensor={"width": 32, "height": 24}, depth="ground")
    assert (camera.weather, camera.depth_source) == (tw.Rain(5.0), FlatGround())
    assert (camera.camera.width, camera.camera.fx) == (32, tw.Camera.preset("lucid-triton").fx)
    assert isinstance(load_recipe("fog-30m", sensor="camera:gopro-hero5-acdc", rgb=True), tw.AsBayer)
    lidar = load_recipe("os1-fog-50m", sensor={"return_mode": "dual"}, lost="drop")
    assert (lidar.sensor.return_mode, lidar.sensor.wavelength_nm, lidar.lost) == ("dual", 865.0, "drop")
    mixed = load_recipe("os1-fog-50m", weather="rain:rate=5+fog:mor=80", sensor="lidar:velodyne-vlp-16")
    assert type(mixed) is tw.LidarWeather
    radar = load_recipe("imaging-fog-20m", weather="rain:rate=5", sensor="radar:awr1843-like", radome_loss_db=2.0)
    assert (radar.weather, radar.sensor) == (tw.Rain(5.0), AWR)
    assert "wet_radome" in radar.chain.stages


def test_sensors_options_and_keys_can_be_those_of_one_s_own_car() -> None:
    camera = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
    changes = {"image": {"sensor": camera, "rgb": False, "depth": 30.0, "airlight": 0.7}, "radar": None}
    mine = load_recipe(MIX, transforms=changes, keys={"image": "CAM_FRONT"}, weather="fog:mor=50")
    assert list(mine.specs) == ["CAM_FRONT", "points"]
    frame = torch.full((1, 24, 32), 0.3)
    wanted = tw.BayerFog(tw.Fog(mor_m=50.0), camera, depth=30.0, airlight=0.7)(frame)
    assert torch.equal(mine({"CAM_FRONT": frame, "points": SAMPLE["points"]}, seed=1)["CAM_FRONT"], wanted)
    assert "image" in load_recipe(MIX).specs


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("fog-30m", {"air_light": 0.5}, "unknown override 'air_light'.*'airlight'"),
        ("fog-30m", {"sensor": "lidar"}, "fog-30m.*must be a camera; got lidar"),
        ("fog-30m", {"airlight": 3.0}, "fog-30m.*airlight"),
        ("os1-fog-50m", {"depth": 3.0}, "unknown override 'depth'"),
        ("os1-fog-50m", {"sensor": "camera"}, "must be a lidar; got camera"),
        ("os1-fog-50m", {"lost": "gone"}, "lost"),
        ("imaging-fog-20m", {"radome_los_db": 2.0}, "'radome_loss_db'"),
        ("imaging-fog-20m", {"sensor": "lidar"}, "must be a radar; got lidar"),
        (MIX, {"seeds": 1}, "unknown override 'seeds'.*'seed'"),
        (MIX, {"transforms": {"point": {}}}, "transforms: unknown override 'point'.*'points'"),
        (MIX, {"transforms": {"points": {"depth": 3.0}}}, "'points': unknown override 'depth'"),
        (MIX, {"transforms": {"points": {"sensor": "radar"}}}, "sensor must be a lidar; got radar"),
        (MIX, {"keys": {"image": "points"}}, "two transforms would go to 'points'"),
        (MIX, {"keys": {"imag": "a"}}, "keys: unknown override 'imag'"),
        (MIX, {"weather": [None]}, "at least one weather that is not null"),
        (MIX, {"transforms": {"image": None, "points": None, "radar": None}}, "at least one key"),
        ("camera/robustness", {"weather": "rain:rate=5"}, "unknown override 'weather'"),
    ],
)
def test_overrides_that_do_not_fit_are_named(name: str, overrides: dict[str, Any], said: str) -> None:
    with pytest.raises(TorchweatherError, match=said):
        load_recipe(name, **overrides)


# ---- saving ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda: tw.BayerRain(
            tw.Rain(12.0, wind_m_per_s=(1.0, 0.5, 0.0)), SMALL, depth=30.0, far_m=80.0, ego_speed_m_per_s=13.9
        ),
        lambda: tw.BayerFog(
            tw.Fog(mor_m=77.0), SMALL, depth=FlatGround(), extinction="koschmieder", airlight=(0.6, 0.7, 0.8)
        ),
        lambda: tw.BayerWeather(
            tw.Mixture(tw.Snow(1.5, albedo=0.85), tw.Fog(mor_m=300.0)), SMALL, variant=None, drop_radiance="upper"
        ),
        lambda: tw.AsBayer(tw.BayerFog(tw.Fog(mor_m=50.0), tw.Camera.preset("sekonix-sf3325"))),
    ],
    ids=["rain", "fog", "mixture", "rgb"],
)
def test_what_is_saved_of_a_camera_comes_back(make: Callable[[], Any], tmp_path: Path) -> None:
    transform = make()
    again = saved(transform, tmp_path)
    assert type(again) is type(transform)
    before, after = (getattr(one, "transform", one) for one in (transform, again))
    assert type(after) is type(before)
    assert after.weather.to_dict() == before.weather.to_dict()
    assert (after.camera, after.depth_source) == (before.camera, before.depth_source)
    assert after.chain.to_dict() == before.chain.to_dict()


def test_a_saved_camera_gives_the_same_pixels(tmp_path: Path) -> None:
    transform = tw.BayerRain(tw.Rain(30.0), SMALL, depth=25.0, airlight=0.7)
    frame = torch.full((1, 24, 32), 0.2)
    first, second = (each(frame, noise=each.draw(frame, seed=5)) for each in (transform, saved(transform, tmp_path)))
    assert torch.equal(first, second)


@pytest.mark.parametrize(
    "make",
    [
        lambda: tw.LidarRain(tw.Rain(12.0), HDL, q_back=0.6, lost="nan"),
        lambda: tw.LidarFog(tw.Fog(mor_m=77.0), HDL, variant="hahner"),
        lambda: tw.LidarSnow(tw.Snow(1.5), tw.Lidar.preset("pandar64-wads"), complete_scan=True, q_eff=1.5),
        lambda: tw.LidarRain(tw.Rain(12.0), HDL, variant="d3_4"),
        lambda: tw.LidarWeather(tw.Mixture(tw.Snow(1.5), tw.Fog(mor_m=300.0)), HDL, fog_extinction="koschmieder"),
    ],
    ids=["rain", "fog", "snow", "d3.4", "mixture"],
)
def test_what_is_saved_of_a_lidar_comes_back_and_gives_the_same_cloud(make: Callable[[], Any], tmp_path: Path) -> None:
    transform = make()
    again = saved(transform, tmp_path)
    assert type(again) is type(transform)
    assert again.sensor == transform.sensor
    assert again.chain.to_dict() == transform.chain.to_dict()
    assert (again.lost, again.complete_scan) == (transform.lost, transform.complete_scan)
    if not transform.complete_scan:  # which takes a cloud of the scan pattern
        points = torch.rand(200, 4, generator=torch.Generator().manual_seed(1)) * 40
        assert same(*(each(points, each.draw(points, seed=5)) for each in (transform, again)))


@pytest.mark.parametrize(
    ("make", "options"),
    [
        (lambda: tw.RadarAttenuation(tw.Rain(12.0), AWR), {}),
        (
            lambda: tw.RadarAttenuation(tw.Rain(12.0), AWR, radome_loss_db=0.7, lost="nan"),
            {"radome_loss_db": 0.7, "lost": "nan"},
        ),
        (
            lambda: tw.RadarAttenuation(tw.Snow(2.0), AWR, clutter=True, clutter_points=9, ego_speed_m_per_s=3.1),
            {"clutter": True, "clutter_points": 9, "ego_speed_m_per_s": 3.1},
        ),
        (
            lambda: tw.RadarAttenuation(tw.Mixture(tw.Rain(5.0), tw.Fog(mor_m=90.0)), AWR, variant="d3_4"),
            {"variant": "d3_4"},
        ),
    ],
    ids=["rain", "radome", "clutter", "d3.4"],
)
def test_what_is_saved_of_a_radar_comes_back_and_gives_the_same_points(
    make: Callable[[], Any], options: dict[str, object], tmp_path: Path
) -> None:
    transform = make()
    again = saved(transform, tmp_path)
    assert read_recipe(tmp_path / "mine.yaml", "transform").options == options
    assert (type(again), again.sensor, again.lost) == (tw.RadarAttenuation, transform.sensor, transform.lost)
    assert again.chain.to_dict() == transform.chain.to_dict()
    assert same(*(each(RADAR_POINTS, each.draw(RADAR_POINTS, seed=5)) for each in (transform, again)))


def without(transform: Any, stage: str) -> Any:
    transform.chain = transform.chain.remove(stage)
    return transform


def fog(**more: Any) -> tw.BayerFog:
    return tw.BayerFog(tw.Fog(mor_m=50.0), SMALL, **more)


NOT_SAVED: dict[str, tuple[Callable[[], Any], str]] = {
    "DepthMap": (lambda: fog(depth=DepthMap(torch.ones(24, 32))), "mine.yaml"),
    "quantise": (lambda: without(fog(), "quantise"), "mine.yaml"),
    "radar_detection": (lambda: without(tw.RadarAttenuation(tw.Rain(12.0), AWR), "radar_detection"), "mine.yaml"),
    "directions": (
        lambda: tw.LidarFog(tw.Fog(50.0), tw.Lidar.preset("velodyne-vlp-16", directions=torch.eye(3))),
        "mine.yaml",
    ),
    "BayerRain": (torch.nn.Identity, "mine.yaml"),
    "not null": (lambda: tw.Compose({"points": tw.LidarFog(tw.Fog(mor_m=50.0), HDL)}, weather=[None]), "mine.yaml"),
    r"must end in \.yaml": (fog, "mine.json"),
    "no folder": (fog, "none/mine.yaml"),
}


@pytest.mark.parametrize("said", list(NOT_SAVED))
def test_what_a_recipe_cannot_hold_is_refused_and_leaves_no_file(said: str, tmp_path: Path) -> None:
    make, name = NOT_SAVED[said]
    with pytest.raises(TorchweatherError, match=said):
        save_recipe(make(), tmp_path / name, title="t")
    assert list(tmp_path.iterdir()) == []


def test_inputs_of_a_file_follow_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    values = yaml.safe_load((recipes_folder() / "multi_sensor" / "rain-25mm-per-h.yaml").read_text())
    path.write_text(yaml.safe_dump({**values, "inputs": {"points": {"directions": "beams"}}}))
    assert load_recipe(path, keys={"points": "LIDAR_TOP"}).inputs == {"LIDAR_TOP": {"directions": "beams"}}
    assert load_recipe(path, transforms={"points": None}).inputs == {}
