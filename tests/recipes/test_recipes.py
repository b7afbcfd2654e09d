"""Recipes: every ready-made pipeline builds, what is saved comes back, what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import yaml

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.core.errors import TorchweatherError
from torchweather.image import DepthMap, FlatGround
from torchweather.recipes.recipes import (
    FORMAT,
    list_recipes,
    load_recipe,
    read_recipe,
    recipes_folder,
    save_recipe,
)
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import (
    AsBayer,
    BayerFog,
    BayerRain,
    BayerWeather,
    LidarFog,
    LidarRain,
    LidarSnow,
    LidarWeather,
    RadarAttenuation,
)

SMALL = Camera.from_intrinsics(40.0, 40.0, 15.5, 11.5, 32, 24)
HDL = Lidar.preset("velodyne-hdl-64e")
AWR = Radar.preset("awr1843-like")

# Conditions of the camera tables of ROADVIEW D3.4: rain rates mm/h, fog visibilities m, snow rates mm/h (Table 4).
D34_RAIN, D34_FOG, D34_SNOW = {10.0, 25.0, 50.0}, {10.0, 20.0, 30.0, 50.0}, {2.59, 2.70, 3.03}

WELL = {
    "format": FORMAT,
    "title": "fog",
    "transform": "BayerFog",
    "weather": {"kind": "fog", "mor_m": 40.0},
    "sensor": {"kind": "camera", "preset": "lucid-triton", "exposure_s": 0.01},
    "options": {"airlight": 0.7},
}


def written(folder: Path, values: object) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.mark.parametrize("name", [recipe.name for recipe in list_recipes()])
def test_every_recipe_builds_its_transform(name: str) -> None:
    recipe = read_recipe(name)
    given = {"sensor": SMALL, "depth": 30.0, "airlight": 0.7} if recipe.sensor_kind == "camera" else {}
    transform = load_recipe(name, **given)
    assert type(transform).__name__ == recipe.transform
    assert isinstance(transform, (BayerWeather, LidarWeather, RadarAttenuation))
    assert recipe.name.startswith(f"{recipe.sensor_kind}/")
    assert transform.weather.to_dict() == recipe.build_weather().to_dict()
    assert recipe.title


def test_the_conditions_of_d34_are_there() -> None:
    weathers = [recipe.build_weather() for recipe in list_recipes() if recipe.sensor_kind == "camera"]
    rain = {float(w.rate_mm_per_h) for w in weathers if isinstance(w, Rain)}
    fog = {float(w.mor_m) for w in weathers if isinstance(w, Fog)}
    snow = {float(w.rate_mm_per_h) for w in weathers if isinstance(w, Snow) and w.size_distribution == "brandes"}
    assert rain == D34_RAIN
    assert fog == D34_FOG
    assert snow == D34_SNOW
    assert any(isinstance(w, Mixture) for w in weathers)


def test_a_recipe_is_found_by_its_short_name_and_its_path() -> None:
    whole = read_recipe("camera/fog-30m")
    assert read_recipe("fog-30m") == whole
    assert read_recipe(recipes_folder() / "camera" / "fog-30m.yaml") == whole
    assert whole.sensor_name == "camera:lucid-triton"


def test_fields_beside_a_preset_replace_those_of_the_preset(tmp_path: Path) -> None:
    camera = read_recipe(written(tmp_path, WELL)).build_camera()
    assert camera == Camera.preset("lucid-triton", exposure_s=0.01)


def test_overrides_replace_weather_sensor_and_options() -> None:
    transform = load_recipe("fog-30m", weather="rain:rate=5", sensor={"width": 32, "height": 24}, depth="ground")
    assert isinstance(transform, BayerWeather)
    assert transform.weather == Rain(5.0)
    assert (transform.camera.width, transform.camera.fx) == (32, Camera.preset("lucid-triton").fx)
    assert transform.depth_source == FlatGround()
    assert isinstance(load_recipe("fog-30m", sensor="camera:gopro-hero5-acdc", rgb=True), AsBayer)


@pytest.mark.parametrize(
    "transform",
    [
        BayerRain(Rain(12.0, wind_m_per_s=(1.0, 0.5, 0.0)), SMALL, depth=30.0, far_m=80.0, ego_speed_m_per_s=13.9),
        BayerFog(Fog(mor_m=77.0), SMALL, depth=FlatGround(), extinction="koschmieder", airlight=(0.6, 0.7, 0.8)),
        BayerWeather(Mixture(Snow(1.5, albedo=0.85), Fog(mor_m=300.0)), SMALL, variant=None, drop_view="upper"),
        AsBayer(BayerFog(Fog(mor_m=50.0), Camera.preset("sekonix-sf3325"))),
    ],
    ids=["rain", "fog", "mixture", "rgb"],
)
def test_what_is_saved_comes_back(transform: BayerWeather | AsBayer, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    save_recipe(transform, path, title="Mine")
    again = load_recipe(path)
    assert type(again) is type(transform)
    before = transform.transform if isinstance(transform, AsBayer) else transform
    after = again.transform if isinstance(again, AsBayer) else again
    assert isinstance(after, BayerWeather)
    assert type(after) is type(before)
    assert after.weather.to_dict() == before.weather.to_dict()
    assert after.camera == before.camera
    assert after.depth_source == before.depth_source
    assert after.chain.to_dict() == before.chain.to_dict()
    # Saved once more it is the same file, to the letter.
    twice = tmp_path / "twice.yaml"
    save_recipe(again, twice, title="Mine")
    assert twice.read_text() == path.read_text()


def test_a_saved_recipe_gives_the_same_pixels(tmp_path: Path) -> None:
    transform = BayerRain(Rain(30.0), SMALL, depth=25.0, airlight=0.7)
    save_recipe(transform, tmp_path / "rain.yaml", title="Rain")
    again = load_recipe(tmp_path / "rain.yaml")
    frame = torch.full((1, 24, 32), 0.2)
    assert isinstance(again, BayerWeather)
    first, second = (each(frame, noise=each.draw(frame, seed=5)) for each in (transform, again))
    assert torch.equal(first, second)


@pytest.mark.parametrize(
    "transform",
    [
        LidarRain(Rain(12.0), HDL, q_back=0.6, lost="nan"),
        LidarFog(Fog(mor_m=77.0), HDL, variant="hahner"),
        LidarSnow(Snow(1.5), Lidar.preset("pandar64-wads"), complete_scan=True, q_eff=1.5),
        LidarRain(Rain(12.0), HDL, variant="d3_4"),
        LidarWeather(Mixture(Snow(1.5), Fog(mor_m=300.0)), HDL, fog_extinction="koschmieder"),
    ],
    ids=["rain", "fog", "snow", "d3.4", "mixture"],
)
def test_what_is_saved_of_a_lidar_comes_back_and_gives_the_same_cloud(transform: LidarWeather, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    save_recipe(transform, path, title="Mine")
    again = load_recipe(path)
    assert isinstance(again, LidarWeather)
    assert type(again) is type(transform)
    assert again.sensor == transform.sensor
    assert again.chain.to_dict() == transform.chain.to_dict()
    assert (again.lost, again.complete_scan) == (transform.lost, transform.complete_scan)
    if not transform.complete_scan:  # which wants a cloud of the scan pattern
        points = torch.rand(200, 4, generator=torch.Generator().manual_seed(1)) * 40
        first, second = (each(points, each.draw(points, seed=5)) for each in (transform, again))
        assert isinstance(first, torch.Tensor)
        assert isinstance(second, torch.Tensor)
        assert torch.equal(first.nan_to_num(-1), second.nan_to_num(-1))


def test_a_lidar_recipe_takes_overrides_of_its_own_kind() -> None:
    fog = load_recipe("os1-fog-50m", sensor={"return_mode": "dual"}, lost="drop")
    assert isinstance(fog, LidarFog)
    assert (fog.sensor.return_mode, fog.sensor.wavelength_nm, fog.lost) == ("dual", 865.0, "drop")
    mixed = load_recipe("os1-fog-50m", weather="rain:rate=5+fog:mor=80", sensor="lidar:velodyne-vlp-16")
    assert type(mixed) is LidarWeather
    with pytest.raises(ValueError, match="depth"):
        load_recipe("os1-fog-50m", depth=3.0)
    with pytest.raises(TorchweatherError, match="must be a lidar; got camera"):
        load_recipe("os1-fog-50m", sensor="camera")
    with pytest.raises(TorchweatherError, match="lost"):
        load_recipe("os1-fog-50m", lost="gone")


@pytest.mark.parametrize(
    ("transform", "options"),
    [
        (RadarAttenuation(Rain(12.0), AWR), {}),
        (RadarAttenuation(Rain(12.0), AWR, radome_loss_db=0.7, lost="nan"), {"radome_loss_db": 0.7, "lost": "nan"}),
        (
            RadarAttenuation(Snow(2.0), AWR, clutter=True, clutter_points=9, ego_speed_m_per_s=3.1),
            {"clutter": True, "clutter_points": 9, "ego_speed_m_per_s": 3.1},
        ),
        (
            RadarAttenuation(Mixture(Rain(5.0), Fog(mor_m=90.0)), AWR, variant="d3_4"),
            {"variant": "d3_4"},
        ),
    ],
    ids=["rain", "radome", "clutter", "d3.4"],
)
def test_what_is_saved_of_a_radar_comes_back_and_gives_the_same_points(
    transform: RadarAttenuation, options: dict[str, object], tmp_path: Path
) -> None:
    path = tmp_path / "mine.yaml"
    save_recipe(transform, path, title="Mine")
    assert read_recipe(path).options == options
    again = load_recipe(path)
    assert isinstance(again, RadarAttenuation)
    assert (again.sensor, again.lost) == (transform.sensor, transform.lost)
    assert again.chain.to_dict() == transform.chain.to_dict()
    points = torch.tensor([[30.0, 2.0, 0.0, -1.0, -100.0, 5.0], [60.0, 0.0, 0.0, 0.0, -139.0, -3.0]])
    first, second = (each(points, each.draw(points, seed=5)) for each in (transform, again))
    assert isinstance(first, torch.Tensor)
    assert isinstance(second, torch.Tensor)
    assert torch.equal(first.nan_to_num(-1), second.nan_to_num(-1))


def test_a_radar_recipe_takes_overrides_of_its_own_kind_and_refuses_others(tmp_path: Path) -> None:
    radar = load_recipe("imaging-fog-20m", weather="rain:rate=5", sensor="radar:awr1843-like", radome_loss_db=2.0)
    assert isinstance(radar, RadarAttenuation)
    assert (radar.weather, radar.sensor) == (Rain(5.0), AWR)
    assert "wet_radome" in radar.chain.stages
    with pytest.raises(ValueError, match="radome_loss_db"):
        load_recipe("imaging-fog-20m", radome_los_db=2.0)
    with pytest.raises(TorchweatherError, match="must be a radar; got lidar"):
        load_recipe("imaging-fog-20m", sensor="lidar")
    changed = RadarAttenuation(Rain(12.0), AWR)
    changed.chain = changed.chain.remove("radar_detection")
    with pytest.raises(ValueError, match="radar_detection"):
        save_recipe(changed, tmp_path / "mine.yaml", title="t")


def test_a_lidar_recipe_is_not_for_images_and_holds_no_directions(tmp_path: Path) -> None:
    lidar_fog = {
        **{key: value for key, value in WELL.items() if key != "options"},
        "transform": "LidarFog",
        "sensor": {"kind": "lidar", "preset": "velodyne-vlp-16"},
    }
    assert read_recipe(written(tmp_path, lidar_fog)).build_sensor() == Lidar.preset("velodyne-vlp-16")
    for change, said in (
        ({"rgb": True}, "rgb belongs to a camera"),
        ({"options": {"depth": 3.0}}, "'depth'"),
        ({"sensor": {"kind": "camera"}}, "must be lidar"),
        ({"sensor": {"kind": "lidar", "preset": "velodyne-vlp-16", "return_mode": "all"}}, "return_mode"),
    ):
        with pytest.raises(TorchweatherError, match=said):
            read_recipe(written(tmp_path, {**lidar_fog, **change}))
    along = Lidar.preset("velodyne-vlp-16", directions=torch.eye(3))
    with pytest.raises(ValueError, match="directions"):
        save_recipe(LidarFog(Fog(mor_m=50.0), along), tmp_path / "mine.yaml", title="t")


def test_what_a_recipe_cannot_hold_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    with pytest.raises(ValueError, match="DepthMap"):
        save_recipe(BayerFog(Fog(mor_m=50.0), SMALL, depth=DepthMap(torch.ones(24, 32))), path, title="t")
    changed = BayerFog(Fog(mor_m=50.0), SMALL)
    changed.chain = changed.chain.remove("quantise")
    with pytest.raises(ValueError, match="save"):
        save_recipe(changed, path, title="t")
    with pytest.raises(TypeError, match="BayerRain"):
        save_recipe(torch.nn.Identity(), path, title="t")
    with pytest.raises(ValueError, match=r"\.yaml"):
        save_recipe(BayerFog(Fog(mor_m=50.0), SMALL), tmp_path / "mine.json", title="t")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "torchweather-recipe/9"}, "recipe/9"),
        ({"wether": {}}, "'weather'"),
        ({"options": {"air_light": 0.7}}, "'airlight'"),
        ({"options": {"depth": "grond"}}, "ground"),
        ({"transform": "BayerFrog"}, "'BayerFog'"),
        ({"weather": {"kind": "fog", "mor_m": -1.0}}, "mor_m"),
        ({"weather": {"kind": "fgo"}}, "'fog'"),
        ({"weather": {"kind": "fog", "mor": 30.0}}, "mor"),
        ({"weather": 3}, "keys with values"),
        ({"sensor": {"kind": "camera", "preset": "lucid"}}, "lucid-triton"),
        ({"sensor": {"kind": "lidar"}}, "camera"),
        ({"rgb": "yes"}, "true or false"),
    ],
)
def test_a_wrong_recipe_names_its_file_and_what_was_wanted(
    change: dict[str, object], said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, {**WELL, **change})
    with pytest.raises(TorchweatherError, match=said) as caught:
        read_recipe(path)
    assert str(path) in str(caught.value)


def test_a_missing_key_and_a_file_that_is_no_yaml_are_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="lacks 'sensor'"):
        read_recipe(written(tmp_path, {key: value for key, value in WELL.items() if key != "sensor"}))
    (tmp_path / "broken.yaml").write_text("a: [1,\n  b")
    with pytest.raises(TorchweatherError, match="YAML"):
        read_recipe(tmp_path / "broken.yaml")
    (tmp_path / "object.yaml").write_text("!!python/object/apply:os.getcwd []")
    with pytest.raises(TorchweatherError, match="YAML"):
        read_recipe(tmp_path / "object.yaml")
    with pytest.raises(TorchweatherError, match="no such file"):
        read_recipe(tmp_path / "none.yaml")


def test_unknown_names_and_overrides_are_refused_with_the_nearest() -> None:
    with pytest.raises(ValueError, match="fog-30m"):
        read_recipe("fog-31m")
    with pytest.raises(ValueError, match="'airlight'"):
        load_recipe("fog-30m", air_light=0.5)
    with pytest.raises(TorchweatherError, match=r"fog-30m.*camera"):
        load_recipe("fog-30m", sensor="lidar")
    with pytest.raises(TorchweatherError, match=r"fog-30m.*airlight"):
        load_recipe("fog-30m", airlight=3.0)
