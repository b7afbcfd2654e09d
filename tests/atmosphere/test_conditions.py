"""Water and snow on things: as parts of a weather, and what the sensors make of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from tests.atmosphere.condition_scene import CAMERA, LIDAR, RADAR, ROAD_INTENSITY, H, W, camera_in, cloud, frame
from tests.contract.table import map_weather
from torchweather.atmosphere.conditions import CONDITIONS, RoadSpray, SnowCover, WetRoad, WetWindow
from torchweather.atmosphere.conditions.ground_noise import ground_noise, uneven
from torchweather.atmosphere.conditions.road_spray import spray_values
from torchweather.atmosphere.conditions.wet_road import water_on_road_mm
from torchweather.atmosphere.conditions.wet_window import drops_on_window, film_on_window_mm
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Weather, parse_weather, weather_from_dict
from torchweather.camera.depth import FlatGround
from torchweather.compose import Compose
from torchweather.core.distributions import Uniform
from torchweather.core.errors import TorchweatherWarning
from torchweather.lidar.surfaces import grid_normals
from torchweather.physics import (
    fog_attenuation_coefficient_db_per_km_per_g_per_m3,
    water_permittivity_microwave,
    water_refractive_index,
)
from torchweather.physics.road_water import road_water_mm
from torchweather.physics.snow_pack import snow_pack_albedo
from torchweather.physics.window_film import drop_cover, film_thickness_mm, microwave_film_loss_db
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.clutter import cell_volume_m3
from torchweather.recipes import load_recipe
from torchweather.sensors import Lidar
from torchweather.transforms import BayerRain, BayerWeather, LidarWeather, RadarAttenuation, RadarMapWeather

# ---- as weather --------------------------------------------------------------------------------------------------


def test_a_mixture_keeps_the_air_and_what_is_on_things_apart() -> None:
    weather = Mixture(WetWindow(), Rain(10), WetRoad(water_mm=1))
    assert [part.kind for part in weather.parts] == ["rain"]
    assert [one.kind for one in weather.conditions] == ["wet-road", "wet-window"]
    assert weather == Mixture(Mixture(Rain(10), WetRoad(water_mm=1)), WetWindow())
    assert Rain(10).conditions == ()
    assert WetRoad().parts == ()
    assert weather != Mixture(Rain(10))


@pytest.mark.parametrize("kind", ["rain+wet-road", "wet-road"])
def test_it_goes_through_a_dictionary_and_a_file(kind: str) -> None:
    weather = Mixture(*([Rain(10.0)] if "rain" in kind else []), WetRoad(puddles=0.5), WetWindow(wiper_s=2.0))
    assert weather_from_dict(yaml.safe_load(yaml.safe_dump(weather.to_dict()))) == weather


def test_the_command_line_has_short_names_of_its_own() -> None:
    found = parse_weather("rain:rate=10+wet-road:water=1,puddles=0.4+wet-window:speed=20,wiper=2")
    assert found == Mixture(Rain(10.0), WetRoad(1.0, 0.4), WetWindow(speed_m_per_s=20.0, wiper_s=2.0))
    assert parse_weather("wet-road") == WetRoad()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("wet-rod", r"must be one of rain, fog, snow, .*wet-road.*; got 'wet-rod'. Did you mean 'wet-road'"),
        ("wet-road:watr=1", "WetRoad: unknown field 'watr'. Did you mean"),
        ("wet-road:water=11", r"WetRoad: water_mm must lie in 0..10 mm; got 11"),
        ("wet-road:water=deep", r"WetRoad: water_mm must lie in 0..10 mm; got 'deep'"),
        ("wet-window:speed=80", r"WetWindow: speed_m_per_s must lie in 0..70 m/s"),
        ("wet-road:water=nan", r"water_mm must lie in 0..10 mm"),
        ("wet-road+wet-road", "Mixture: expected each kind once; got 2 times wet-road"),
    ],
)
def test_what_is_wrong_is_named(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_weather(text)


def test_a_field_may_be_drawn() -> None:
    weather = Mixture(Rain((1.0, 50.0)), WetRoad((0.0, 2.0), puddles=Uniform(0.2, 0.4)))
    assert set(weather.random) == {"rain.rate_mm_per_h", "wet-road.water_mm", "wet-road.puddles"}
    road = weather.drawn(5).conditions[0]
    assert isinstance(road, WetRoad)
    assert 0.0 <= road.water_mm <= 2.0
    assert 0.2 <= road.puddles <= 0.4
    assert weather.drawn(5) == weather.drawn(5)
    with pytest.raises(ValueError, match=r"WetRoad: water_mm must lie in 0..10 mm; got 12"):
        WetRoad((0.0, 12.0))


@pytest.mark.parametrize("kind", sorted(CONDITIONS))
def test_every_condition_is_known_and_at_zero_does_nothing_to_any_sensor(kind: str) -> None:
    nothing = weather_from_dict({"kind": kind, CONDITIONS[kind].intensity_name: 0.0})
    image, points = frame(), cloud()
    detections = torch.tensor([[50.0, 0.0, 0.0, -3.0, -90.0, 10.0]])
    for weather in (nothing, Mixture(nothing)):
        assert torch.equal(camera_in(weather)(image, seed=1), image)
        assert torch.equal(LidarWeather(weather, LIDAR)(points, seed=1), points)
        assert torch.equal(RadarAttenuation(weather, RADAR)(detections, seed=1), detections)
    with_rain = camera_in(Mixture(Rain(10.0), nothing))
    assert torch.equal(with_rain(image, seed=1), camera_in(Rain(10.0))(image, seed=1))


# ---- laws --------------------------------------------------------------------------------------------------------


def test_depth_on_the_road_follows_the_rain_of_the_mixture() -> None:
    road = WetRoad(texture_mm=1.0, slope_percent=1.0)
    rates = torch.tensor([0.0, 10.0, 60.0])
    found = water_on_road_mm(road, Mixture(Rain(rates), road))
    assert torch.allclose(found, road_water_mm(rates, 5.0, 1.0, 1.0))
    with pytest.warns(TorchweatherWarning, match="the range the size distribution was fitted to"):
        heavy = Mixture(Rain(250.0), road)
    with pytest.raises(ValueError, match=r"WetRoad: .*rain up to 200 mm/h; got 250. Give WetRoad\(water_mm="):
        water_on_road_mm(road, heavy)


@pytest.mark.parametrize("condition", [WetRoad(), WetWindow()])
def test_a_condition_that_follows_from_rain_asks_for_it(condition: Weather) -> None:
    with pytest.raises(ValueError, match=rf"{type(condition).__name__}: it follows from rain, and .* holds none. Give"):
        camera_in(Mixture(Fog(mor_m=100), condition))


def test_a_window_is_wetter_at_speed_and_dries() -> None:
    at_rest, fast = WetWindow(), WetWindow(speed_m_per_s=25.0)
    rain = Rain(25.0)

    def film(window: WetWindow) -> float:
        return float(film_on_window_mm(window, Mixture(rain, window), length_m=0.1, inclination_deg=90.0))

    assert film(at_rest) == 0.0  # an upright window at rest
    water = float(rain.distribution().liquid_water_g_per_m3())
    assert film(fast) == pytest.approx(float(film_thickness_mm(3.6 * water * 25.0, 0.1)), rel=1e-6)
    dry = WetWindow(speed_m_per_s=25.0, rain_mm_per_h=25.0, since_rain_min=10.0)
    assert film(dry) == pytest.approx(film(fast) / math.e, rel=1e-6)


def test_drops_grow_from_stroke_to_stroke_of_the_wiper() -> None:
    rain = Rain(25.0)
    covers = []
    for since_s in (0.0, 1.0, 4.0, None):
        window = WetWindow(wiper_s=since_s)
        covers.append(float(drops_on_window(window, Mixture(rain, window), inclination_deg=0.0)))
    assert covers[0] == 0.0
    assert covers[1] == pytest.approx(float(drop_cover(25.0 / 3600.0)), rel=1e-6)
    assert covers == sorted(covers)


def test_the_ground_field_is_standard_and_shared_by_place() -> None:
    noise = torch.rand(4000, 12, 3, generator=torch.Generator().manual_seed(1))
    field = ground_noise(noise, torch.tensor([[3.0, 3.0]]), torch.tensor([[1.0, 1.0]]))
    assert torch.equal(field[:, 0], field[:, 1])
    assert float(field[:, 0].mean()) == pytest.approx(0.0, abs=4 / math.sqrt(4000))
    assert float(field[:, 0].var()) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 4000))
    # Nearly normal waves: the mean of exp(s f - s^2 / 2) is 1.
    assert float(uneven(field[:, 0], 0.5).mean()) == pytest.approx(1.0, abs=4 * 0.53 / math.sqrt(4000) + 0.01)


# ---- camera ------------------------------------------------------------------------------------------------------


def reflectance(cosine: float) -> float:
    """Fresnel's reflectance of water, unpolarised."""
    sine = math.sqrt(1 - cosine**2) / 1.33
    inner = math.sqrt(1 - sine**2)
    across = (cosine - 1.33 * inner) / (cosine + 1.33 * inner)
    along = (1.33 * cosine - inner) / (1.33 * cosine + inner)
    return (across**2 + along**2) / 2


@pytest.mark.parametrize("given", [True, False])
def test_the_road_darkens_and_mirrors_by_the_water_on_it(given: bool) -> None:
    """A grey frame, so that the mirrored picture is known; normals from the depth or from the call."""
    water = 0.5
    image = torch.full((1, H, W), 0.4)
    normal = torch.zeros(3, H, W)
    normal[2, H // 2 :] = 1.0
    after = camera_in(
        WetRoad(water_mm=water),
    )(image, normal=normal if given else None, seed=1)
    row, column = H - 6, W // 2
    dy = (row - (H - 1) / 2) / 100.0
    dx = (column - (W - 1) / 2) / 100.0
    mirror = reflectance(dy / math.sqrt(1 + dx**2 + dy**2)) * (1 - math.exp(-water / 0.7))
    albedo = 0.1 / (0.1 + 1.33**2 * 0.9)
    own = 0.4 * (1 - (1 - albedo / 0.1) * (1 - math.exp(-water / 0.05)))
    assert float(after[0, row, column]) == pytest.approx(own * (1 - mirror) + 0.4 * mirror, abs=1.5 / 4095)
    assert torch.equal(after[0, : H // 2], image[0, : H // 2])  # the sky


def test_only_level_ground_is_road() -> None:
    """A wall, and a roof 1.4 m over the road, stay dry."""
    image = frame()
    wall = BayerWeather(WetRoad(water_mm=2.0), CAMERA, depth=20.0, airlight=0.7)
    assert torch.equal(wall(image, seed=1), image)
    roof = torch.zeros(3, H, W)
    roof[2] = 1.0
    assert torch.equal(wall(image, normal=roof, seed=1)[0, : H // 2], image[0, : H // 2])


def test_puddles_are_deeper_in_places() -> None:
    image = torch.full((1, H, W), 0.4)
    even = camera_in(WetRoad(water_mm=0.5))(image, seed=1)[0, -12:]
    uneven_road = camera_in(WetRoad(water_mm=0.5, puddles=1.0))(image, seed=1)[0, -12:]
    # Along a row the even road differs by Fresnel's law alone.
    assert float(uneven_road.std(1).mean()) > 3.0 * float(even.std(1).mean())


def test_an_effect_given_twice_names_both() -> None:
    with pytest.raises(ValueError, match=r"BayerWeather: effects=.* camera.wet_surface, and WetRoad in the weather"):
        camera_in(WetRoad(water_mm=1.0), effects=[{"effect": "camera.wet_surface", "mirror": 0.5}])
    twice = Mixture(Rain(5.0), WetWindow(speed_m_per_s=10.0))
    with pytest.raises(ValueError, match=r"radar.wet_radome, and WetWindow"):
        RadarAttenuation(twice, RADAR, effects=[{"effect": "radar.wet_radome", "loss_db": 1.0}])
    with pytest.raises(ValueError, match=r"radome_loss_db and radome_film_db .* WetWindow in the weather"):
        RadarAttenuation(twice, RADAR, radome_loss_db=1.0)


def test_the_exposure_is_kept_from_before_the_water() -> None:
    wet = camera_in(WetRoad(water_mm=3.0), exposure_control="mean")
    assert next(iter(wet.chain.stages)) == "exposure_meter"
    image = frame()
    assert float(wet(image, seed=1).mean()) == pytest.approx(float(image.mean()), rel=0.01)


def test_samples_of_a_batch_have_the_water_of_their_rain() -> None:
    rates = torch.tensor([0.0, 40.0])
    transform = camera_in(Mixture(Rain(rates), WetRoad(), WetWindow()))
    image = frame((1,)).expand(2, 1, H, W)
    after = transform(image, seed=3)
    assert torch.equal(after[0], image[0])
    alone = camera_in(Mixture(Rain(40.0), WetRoad(), WetWindow()))(image[1], seed=4)
    # Table nodes differ between a rate and a row of them by rounding alone.
    assert torch.allclose(after[1], alone, atol=2 / 4095)


def test_a_condition_is_drawn_for_each_sample_of_a_batch() -> None:
    weather = Mixture(Rain(10.0), WetRoad((0.5, 2.0)))
    transform = camera_in(weather)
    chosen = camera_in(weather.drawn(1))
    assert torch.equal(transform(frame(), seed=1), chosen(frame(), noise=chosen.draw(frame(), seed=1)))
    pair = frame((2,))
    both = transform(pair, seed=1)
    assert all(torch.equal(both[k], transform(pair[k], seed=1 + k)) for k in range(2))
    with pytest.raises(ValueError, match=r"wet-road is one for all .* and p leaves some of them clear"):
        camera_in(WetRoad(water_mm=1.0), p=0.5)(frame((2,)), seed=1)
    rarely = camera_in(WetRoad(water_mm=1.0), p=0.0)
    assert torch.equal(rarely(frame(), seed=1), frame())


@pytest.mark.parametrize("given", [True, False])
def test_snow_whitens_the_ground_in_the_light_of_the_sky(given: bool) -> None:
    image = torch.full((1, H, W), 0.2)
    normal = torch.zeros(3, H, W)
    normal[2, H // 2 :] = 1.0
    transform = camera_in(SnowCover(depth_mm=5.0, uneven=0.0))
    after = transform(image, normal=normal if given else None, seed=1)
    share = 1 - math.exp(-1.0)
    white = float(snow_pack_albedo(550.0)) * 0.7  # airlight of the scene
    assert torch.allclose(after[0, -12:], torch.full((12, W), 0.2 * (1 - share) + white * share), atol=1 / 4095)
    assert torch.equal(after[0, : H // 2 - 3], image[0, : H // 2 - 3])


def test_snow_leaves_walls_and_takes_the_light_of_the_frame_s_own_sky() -> None:
    image = torch.full((1, H, W), 0.2)
    wall = BayerWeather(SnowCover(depth_mm=50.0), CAMERA, depth=20.0, airlight=0.7)
    assert torch.equal(wall(image, seed=1), image)
    image[:, : H // 2] = 0.5  # an even sky
    own = BayerWeather(SnowCover(depth_mm=500.0, uneven=0.0), CAMERA, depth=FlatGround())(image, seed=1)
    assert float(own[0, -8:].mean()) == pytest.approx(float(snow_pack_albedo(550.0)) * 0.5, abs=2 / 4095)


# ---- LiDAR and radar -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wavelength_nm", [905.0, 1550.0])
def test_wet_road_returns_less_and_a_wall_as_before(wavelength_nm: float) -> None:
    points, water = cloud(), 0.5
    sensor = Lidar(wavelength_nm=wavelength_nm, intensity_unit="reflectivity", range_at_10_percent_m=1000.0)
    after = LidarWeather(WetRoad(water_mm=water), sensor)(points, seed=1)
    assert isinstance(after, Tensor)
    wall = points[:, 0] == 15.0
    assert torch.equal(after[wall], points[wall])
    at = int((points[:, :2] - torch.tensor([4.0, 2.0])).square().sum(1).argmin())
    cosine = 1.7 / float(points[at, :3].norm())
    kappa = float(water_refractive_index(wavelength_nm).imag)
    ways = 2.0 / math.sqrt(1 - 1 / 1.33**2)
    left = 0.1 / (0.1 + 1.33**2 * 0.9) / 0.1 * math.exp(-4e6 * math.pi * kappa / wavelength_nm * ways * water)
    through = ((1 - reflectance(cosine)) / (1 - reflectance(1.0))) ** 2
    damp, pool = (1 - math.exp(-water / scale) for scale in (0.05, 0.7))
    gain = (1 - pool) * (1 - (1 - left) * damp * (1 - 0.5 * through)) + pool * left * through
    assert float(after[at, 3]) == pytest.approx(ROAD_INTENSITY * gain, rel=0.01)


@pytest.mark.parametrize("wavelength_nm", [905.0, 1550.0])
def test_snow_on_the_road_returns_by_its_own_reflectivity(wavelength_nm: float) -> None:
    points = cloud()
    sensor = Lidar(wavelength_nm=wavelength_nm, intensity_unit="reflectivity", range_at_10_percent_m=1000.0)
    after = LidarWeather(SnowCover(depth_mm=200.0, uneven=0.0), sensor)(points, seed=1)
    assert isinstance(after, Tensor)
    wall = points[:, 0] == 15.0
    assert torch.equal(after[wall], points[wall])
    cosine = 1.7 / points[~wall, :3].norm(dim=1)
    assert torch.allclose(after[~wall, 3], float(snow_pack_albedo(wavelength_nm)) * cosine, rtol=0.01)


def test_normals_of_an_organised_cloud_are_those_of_its_surfaces() -> None:
    """A room: a floor, and walls of a cylinder, seen by a scan."""
    elevation, azimuth = torch.meshgrid(torch.linspace(-0.6, 0.1, 24), torch.linspace(-3.1, 3.1, 90), indexing="ij")
    unit = torch.stack([elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()], -1)
    to_wall = 6.0 / elevation.cos()
    to_floor = torch.where(elevation < 0, -1.7 / elevation.sin(), torch.inf)
    range_m = torch.minimum(to_wall, to_floor)[None]
    range_m[0, 3, 7] = 0.0  # no return
    normal = grid_normals(unit[None] * range_m[..., None], range_m)[0]
    floor = (to_floor < to_wall)[1:-1, 1:-1]
    inner = normal[1:-1, 1:-1]
    assert torch.equal(normal[3, 7], torch.zeros(3))
    known = range_m[0, 1:-1, 1:-1] > 0
    edge = floor ^ floor.roll(1, 0) | (floor ^ floor.roll(-1, 0))
    assert bool((inner[..., 2][floor & known & ~edge] > 0.999).all())
    assert bool((inner[..., 2][~floor & known & ~edge].abs() < 0.01).all())


def test_a_cloud_without_ground_says_what_to_pass() -> None:
    with pytest.raises(ValueError, match=r"sample 0 shows no ground: .* Pass the whole sweep"):
        LidarWeather(WetRoad(water_mm=1.0), LIDAR)(torch.tensor([[10.0, 0.0, 0.0, 0.3]]), seed=1)


def test_the_film_on_the_radar_costs_every_target_the_same() -> None:
    window = WetWindow(speed_m_per_s=20.0, rain_mm_per_h=25.0)
    targets = torch.tensor([[20.0, 0.0, 0.0, 0.0, -60.0, 10.0], [80.0, 3.0, 0.0, 0.0, -70.0, 10.0]])
    after = RadarAttenuation(window, RADAR)(targets, seed=1)
    assert isinstance(after, Tensor)
    film = film_on_window_mm(window, window, length_m=0.06, inclination_deg=90.0)
    expected = 2.0 * float(microwave_film_loss_db(film, RADAR.frequency_ghz))
    assert 5.0 < expected < 15.0
    assert torch.allclose(targets[:, 4] - after[:, 4], torch.full((2,), expected), atol=1e-4)


def test_a_map_has_the_film_and_says_what_it_cannot_have() -> None:
    wet = map_weather(Mixture(Rain(20.0), WetWindow(speed_m_per_s=20.0)))
    assert isinstance(wet, RadarMapWeather)
    assert "wet_radome" in wet.chain.stages


def test_one_condition_for_all_sensors_of_a_sample() -> None:
    """Puddles lie at the same places for camera and LiDAR, and every sensor has its own window."""
    weather = Mixture(Rain(10.0), WetRoad(puddles=1.0), WetWindow(speed_m_per_s=15.0))
    transforms = {
        "image": BayerRain(Rain(1.0), CAMERA, depth=FlatGround(), airlight=0.7),
        "points": LidarWeather(Rain(1.0), LIDAR),
        "radar": RadarAttenuation(Rain(1.0), RADAR),
    }
    both = Compose(transforms, weather=weather)
    sample = {
        "image": frame(),
        "points": cloud(),
        "radar": torch.tensor([[50.0, 0.0, 0.0, -3.0, -90.0, 10.0]]),
    }
    out = both(sample, seed=5)
    again = both(sample, seed=5)
    assert all(torch.equal(out[key], again[key]) and not torch.equal(out[key], sample[key]) for key in sample)
    camera, lidar = (transforms[key].with_weather(weather).chain.stages["road_water"] for key in ("image", "points"))
    assert camera.of_the_air
    assert lidar.of_the_air
    assert camera.variates() == lidar.variates()
    assert len(camera.variates()) == 1


def test_a_recipe_holds_conditions(tmp_path: Any) -> None:
    recipe = {
        "format": "torchweather-recipe/2",
        "title": "a wet road",
        "kind": "transform",
        "transform": "BayerRain",
        "weather": Mixture(Rain(10.0), WetRoad(puddles=0.3)).to_dict(),
        "sensor": {"kind": "camera", "preset": "lucid-triton"},
        "options": {"depth": "ground", "airlight": 0.6},
    }
    (tmp_path / "wet.yaml").write_text(yaml.safe_dump(recipe), encoding="utf-8")
    loaded = load_recipe(tmp_path / "wet.yaml")
    assert isinstance(loaded, BayerRain)
    assert "road_water" in loaded.chain.stages


# ---- road spray ----------------------------------------------------------------------------------------------------


def spray(**more: Any) -> RoadSpray:
    return RoadSpray(**({"speed_m_per_s": 25.0, "distance_m": 12.0, "water_mm": 2.0, "uneven": 0.0} | more))


def rows(y_m: np.ndarray) -> Any:
    """Density across two rows of tyres, 1/m."""
    parts = [np.exp(-0.5 * ((y_m - side) / 0.5) ** 2) for side in (-0.8, 0.8)]
    return sum(parts) / (0.5 * math.sqrt(2 * math.pi))


def test_spray_takes_its_water_from_the_road_or_the_rain() -> None:
    given = spray_values(spray(water_mm=2.0), Mixture(spray()))["water_g_per_m"]
    of_road = Mixture(WetRoad(water_mm=2.0), spray(water_mm=None))
    assert spray_values(spray(water_mm=None), of_road)["water_g_per_m"] == pytest.approx(given)
    of_rain = Mixture(Rain(40.0), spray(water_mm=None))
    depth = float(road_water_mm(40.0))
    assert spray_values(spray(water_mm=None), of_rain)["water_g_per_m"] == pytest.approx(given * depth / 2.0)
    with pytest.raises(ValueError, match=r"RoadSpray: .* their rain differs. Give RoadSpray\(water_mm="):
        camera_in(Mixture(Rain(torch.tensor([5.0, 40.0])), spray(water_mm=None)))


def test_a_camera_sees_the_spray_as_a_veil_by_the_water_on_each_ray() -> None:
    image = torch.full((1, H, W), 0.1)
    values = spray_values(spray(), spray())
    after = BayerWeather(spray(), CAMERA, depth=40.0, airlight=0.7)(image, seed=1)
    row, column = H // 2 + 4, W // 2 + 3
    y, x = (row - (H - 1) / 2) / 100.0, (column - (W - 1) / 2) / 100.0
    norm = math.sqrt(1 + x**2 + y**2)
    unit = (1 / norm, -x / norm, -y / norm)
    steps = np.linspace(0.0, 12.0 * norm, 40_001)
    t = 0.5 * (steps[1:] + steps[:-1])
    z = np.maximum(1.5 + t * unit[2], 0.0)
    across = sum(np.exp(-0.5 * ((t * unit[1] - side) / 0.5) ** 2) for side in (-0.8, 0.8)) / (
        0.5 * math.sqrt(2 * math.pi)
    )
    behind = 12.0 - t * unit[0]
    density = np.exp(-behind / values["length_m"] - z / 0.8) / 0.8 * across * values["water_g_per_m"] * 1e-3
    tau = 1.5 / values["drop_mm"] * (density * np.diff(steps)).sum()
    through = math.exp(-tau)
    assert 0.2 < through < 0.9
    assert float(after[0, row, column]) == pytest.approx(0.1 * through + 0.7 * (1 - through), abs=2 / 4095)


def test_a_lidar_loses_what_the_spray_hides_and_lists_its_gates() -> None:
    """Against gates that are drawn one by one along a beam."""
    sensor = Lidar(wavelength_nm=905.0, intensity_unit="reflectivity", range_at_10_percent_m=150.0)
    cloud_state = spray(tyre_m=0.6)
    values = spray_values(cloud_state, cloud_state)
    count = 4000
    points = torch.tensor([[60.0, 1.8, -1.0, 0.3]]).repeat(count, 1)
    result = LidarWeather(cloud_state, sensor).run(points, seed=3)
    seen_m = result.points[:, :3].norm(dim=1)
    found = result.kind == int(PointKind.PARTICLE)
    # The brute-force beam: gates of the pulse's length, each with an exponential return about its mean.
    unit = (points[0, :3] / points[0, :3].norm()).double().numpy()
    gate = sensor.pulse_length_m
    end = 12.0 / unit[0]
    edges = np.linspace(0.0, end, 12 * 40 + 1)
    t = 0.5 * (edges[1:] + edges[:-1])
    across = sum(np.exp(-0.5 * ((t * unit[1] - side) / 0.5) ** 2) for side in (-0.8, 0.8)) / (
        0.5 * math.sqrt(2 * math.pi)
    )
    z = 1.7 + t * unit[2]
    density = (
        np.exp(-(12.0 - t * unit[0]) / values["length_m"] - z / 0.8) / 0.8 * across * values["water_g_per_m"] * 1e-3
    )
    area = 1.5 / values["drop_mm"] * density
    tau = np.cumsum(1.1 * area * np.diff(edges))
    response = sensor.near_response(torch.from_numpy(t)).numpy()
    mean = area * 0.2 / (4 * math.pi) * gate * response / t**2 * np.exp(-2 * tau) + 1e-30
    # Poisson process of gates: those above a level x number sum(len / gate exp(-x / mean)).
    level = float(sensor.threshold_per_m2_sr)
    expected = (np.diff(edges) / gate * np.exp(-level / mean)).sum()
    detected = 1 - math.exp(-expected)
    # Of the strongest return, where the object does not beat it.
    object_signal = 0.3 / math.pi / float(points[0, :3].norm()) ** 2 * math.exp(-2 * tau[-1])
    beaten = 1 - math.exp(-(np.diff(edges) / gate * np.exp(-max(level, object_signal) / mean)).sum())
    assert detected > beaten > 0.05
    error = 4 * math.sqrt(beaten * (1 - beaten) / count)
    assert float(found.float().mean()) == pytest.approx(beaten, abs=error + 0.02)  # 12 parts stand for the integral
    assert bool((seen_m[found] < 13.0).all())
    objects = ~found & (result.kind == int(PointKind.OBJECT))
    assert float(result.points[objects, 3].mean()) == pytest.approx(0.3 * math.exp(-2 * tau[-1]), rel=0.03)


def test_a_radar_loses_little_in_the_spray_and_sees_its_densest_cell() -> None:
    """Tenths of a decibel behind the vehicle, less aside of it, and one echo of the cloud."""
    targets = torch.tensor([[40.0, 0.8, 0.0, 0.0, -60.0, 10.0], [20.0, 20.0, 0.0, 0.0, -60.0, 10.0]])
    after = RadarAttenuation(spray(), RADAR).run(targets, seed=1)
    assert isinstance(after.attenuation_db, Tensor)
    loss = after.attenuation_db[:2]
    values = spray_values(spray(), spray())
    unit = (targets[0, :3] / targets[0, :3].norm()).double().numpy()
    t = np.linspace(0.0, 12.0 / unit[0], 20_001)
    t = 0.5 * (t[1:] + t[:-1])
    across = sum(np.exp(-0.5 * ((t * unit[1] - side) / 0.5) ** 2) for side in (-0.8, 0.8)) / (
        0.5 * math.sqrt(2 * math.pi)
    )
    density = np.exp(-(12.0 - t * unit[0]) / values["length_m"] - 0.5 / 0.8) / 0.8 * across * values["water_g_per_m"]
    per_km = float(fog_attenuation_coefficient_db_per_km_per_g_per_m3(RADAR.frequency_ghz, 10.0))
    expected = 2 * per_km * 1e-3 * density.mean() * 12.0 / unit[0]
    assert 0.01 < expected < 1.0
    assert float(loss[0]) == pytest.approx(expected, rel=0.01)
    assert float(loss[1]) < 0.3 * float(loss[0])  # the plume reaches past the radar
    assert isinstance(after.points, Tensor)
    assert isinstance(after.kind, Tensor)
    (row,) = after.points[after.kind == int(PointKind.PARTICLE)]
    at_m = 12.0 - 0.5 * RADAR.range_resolution_m
    assert float(row[0]) == pytest.approx(at_m)
    # Rayleigh: N D^6 of equal drops, in the densest cell.
    drop_m = 1e-3 * values["drop_mm"]
    thinned = math.exp(-(12.0 - at_m) / values["length_m"] - 0.5 / 0.8) / 0.8
    water = 1e-3 * values["water_g_per_m"] * thinned * float(rows(np.array([0.8]))[0])
    drops = water / (1000.0 * math.pi / 6.0 * drop_m**3)
    index = complex(water_permittivity_microwave(RADAR.frequency_ghz, 10.0))
    factor = abs((index - 1) / (index + 2)) ** 2 * math.pi**5 / RADAR.wavelength_m**4
    rcs = factor * drops * drop_m**6 * float(cell_volume_m3(torch.tensor(at_m), RADAR))
    assert float(row[5]) == pytest.approx(10.0 * math.log10(rcs), abs=0.01)
    deaf = RadarAttenuation(spray(), replace(RADAR, detection_snr_db=60.0))
    assert not bool((deaf.run(targets, seed=1).kind == int(PointKind.PARTICLE)).any())


def test_billows_are_the_same_for_camera_and_lidar() -> None:
    camera, lidar = camera_in(spray(uneven=0.5)), LidarWeather(spray(uneven=0.5), LIDAR)
    (one,), (other,) = (kind.chain.stages["road_spray"].air_variates() for kind in (camera, lidar))
    assert one == other
    both = Compose({"image": camera, "points": lidar}, weather=spray(uneven=0.5))
    out = both({"image": frame(), "points": cloud()}, seed=2)
    assert not torch.equal(out["image"], frame())
