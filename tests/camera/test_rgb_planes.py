"""RGB images in weather as colour planes: the stages of a mosaic on another layout, without loss."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.camera.depth import SceneDepth
from torchweather.core.errors import TorchweatherWarning
from torchweather.image import mosaic, srgb_encode
from torchweather.sensors import Camera
from torchweather.stages import EFFECTS, CameraState
from torchweather.transforms import AsBayer, BayerFog, BayerWeather

H, W = 48, 64
AIRLIGHT = (0.6, 0.62, 0.65)
WEATHERS = [Rain(20.0), Snow(2.0), Fog(mor_m=80.0), Mixture(Rain(20.0), Fog(mor_m=80.0))]
IDS = ["rain", "snow", "fog", "rain in fog"]


def camera(**more: object) -> Camera:
    return Camera.from_intrinsics(60.0, 60.0, 31.5, 20.0, W, H, **more)


def street() -> tuple[Tensor, Tensor]:
    """A picture ``(3, H, W)`` with edges, and its depth: a wall at 20 m under a sky."""
    rgb = torch.rand(3, H, W, generator=torch.Generator().manual_seed(3))
    depth_m = torch.full((1, H, W), 20.0)
    depth_m[:, :16] = math.inf
    rgb[:, :16] = torch.tensor([0.6, 0.7, 0.8])[:, None, None]
    return rgb, depth_m


def psnr_db(a: Tensor, b: Tensor) -> float:
    error = (a.double() - b.double()).square().mean()
    return math.inf if error == 0 else float(-10 * torch.log10(error))


def states(weather: Weather, flat: bool) -> tuple[BayerWeather, CameraState, CameraState]:
    """A transform, and one frame's states as a mosaic and as colour planes."""
    transform = BayerWeather(weather, camera(), airlight=AIRLIGHT)
    linear = torch.rand(1, 3, H, W, generator=torch.Generator().manual_seed(4)) * 0.5
    if flat:
        linear = torch.tensor([0.3, 0.2, 0.1])[None, :, None, None].expand(1, 3, H, W).clone()
    _, depth_m = street()
    scene = SceneDepth(depth_m)
    planes = transform.planes_state(linear, scene, (1,), keep_truth=True)
    return transform, transform.state_of(mosaic(linear, "RGGB"), depth_m[None]), planes


@pytest.mark.parametrize("weather", WEATHERS, ids=IDS)
def test_the_mosaic_of_weathered_planes_is_the_weathered_mosaic(weather: Weather) -> None:
    # Drops show the frame's mean, flakes that of its ground, which a mosaic knows from a quarter of the pixels: a flat
    # frame for both.
    transform, raw, planes = states(weather, flat=any(isinstance(part, (Rain, Snow)) for part in weather.parts))
    noise = transform.draw(raw.image.signal, seed=5)
    of_mosaic, of_planes = transform.weathered(raw, noise), transform.weathered(planes, noise)
    # The same operations in float32, with sums over a mosaic's and a plane's pixels in another order. Behind fog a
    # frame is flat no more: its mean over a quarter of the pixels is off by some 1e-4, of which a drop shows a tenth.
    mixed = len(weather.parts) > 1
    torch.testing.assert_close(
        mosaic(of_planes.image.signal, "RGGB"), of_mosaic.image.signal, rtol=0.0, atol=1e-5 if mixed else 2e-6
    )


@pytest.mark.parametrize("name", [name for name in EFFECTS if name.startswith("camera.")])
def test_effects_of_the_camera_take_colour_planes(name: str) -> None:
    effect = EFFECTS[name]
    typical = {
        one.name: one.identity + one.scale if one.identity is not None and math.isfinite(one.identity) else one.scale
        for one in effect.arguments
    }
    transform = BayerWeather(Fog(mor_m=60.0), camera(), airlight=AIRLIGHT, effects=[effect(**typical)])
    grey = torch.rand(1, 1, H, W, generator=torch.Generator().manual_seed(4)).expand(1, 3, H, W) * 0.5
    _, depth_m = street()
    state = transform.planes_state(grey.clone(), SceneDepth(depth_m), (1,))
    if "normal" in effect.needs:
        state = _with_level_ground(state)
    after = transform.weathered(state)
    assert after.image.signal.shape == (1, 3, H, W)
    assert bool(after.image.signal.isfinite().all())


def _with_level_ground(state: CameraState) -> CameraState:

    normal = torch.zeros(1, 3, H, W)
    normal[:, 2] = 1.0
    return state.changed(normal=normal)


@pytest.mark.parametrize("weather", WEATHERS, ids=IDS)
def test_grey_weather_on_a_grey_image_is_grey(weather: Weather) -> None:
    _, depth_m = street()
    rgb = torch.rand(1, H, W, generator=torch.Generator().manual_seed(4)).expand(3, H, W)
    seen = AsBayer(BayerWeather(weather, camera(), airlight=0.6, extinction="koschmieder"))
    out = seen(rgb, depth_m, seen.draw(rgb, seed=1))
    assert not torch.equal(out, rgb)
    # Float32: each plane adds up alike but for the last bits of a mean over the frame.
    torch.testing.assert_close(out, out[:1].expand_as(out), rtol=0.0, atol=1e-6)


@pytest.mark.filterwarnings("ignore:.*lies outside")  # of the rates that the size distributions were fitted to
@pytest.mark.parametrize(
    ("kind", "value", "least_db"),
    [(Rain, 1e-3, 60.0), (Snow, 1e-3, 60.0), (Fog, 1e6, 60.0), (Fog, 1e7, 80.0)],
    ids=["rain", "snow", "fog of 1000 km", "fog of 10000 km"],
)
def test_nearly_no_weather_costs_nearly_nothing(kind: type[Weather], value: float, least_db: float) -> None:
    rgb, depth_m = street()
    weather = kind(value)  # type: ignore[call-arg]
    seen = AsBayer(BayerWeather(weather, camera()))
    assert psnr_db(seen(rgb, depth_m, seen.draw(rgb, seed=2)), rgb) >= least_db


def test_no_edge_of_the_clear_image_survives_where_its_light_does_not() -> None:
    rgb, depth_m = street()
    foggy = AsBayer(BayerFog(Fog(mor_m=1.0), camera(), airlight=AIRLIGHT, extinction="koschmieder"))(rgb, depth_m)
    wall = foggy[:, 16:]
    expected = srgb_encode(torch.tensor(AIRLIGHT))[:, None, None].expand_as(wall)
    # An optical depth of 60 behind 20 m: the wall is the airlight to the last bit of float32.
    torch.testing.assert_close(wall, expected, rtol=0.0, atol=1e-7)


# ---- sky, unknown, own vehicle (PHYSICS.md 10.11, 10.12) ------------------------------------------------------------


def transmission(mor_m: float, depth_m: Tensor, **more: object) -> Tensor:
    rgb, _ = street()
    fog = AsBayer(BayerFog(Fog(mor_m=mor_m), camera(), airlight=AIRLIGHT, extinction="koschmieder", **more))
    return fog.run(rgb, depth_m).transmission


def test_the_sky_is_seen_through_the_layer_along_its_ray() -> None:
    cam = camera(height_m=1.5)
    seen = transmission(1000.0, torch.full((1, H, W), math.inf), layer_top_m=200.0)
    row = 3
    elevation = math.atan((20.0 - row) / 60.0)  # at the principal point's column the ray rises by rows over fy
    column = 31  # half a pixel aside of the axis: 1 / cos of 0.008 rad is 1.00003
    expected = math.exp(-math.log(20.0) / 1000.0 * (200.0 - cam.height_m) / math.sin(elevation))
    assert float(seen[0, row, column]) == pytest.approx(expected, rel=1e-3)


def test_the_horizon_of_the_scene_sets_the_elevation_of_its_rays() -> None:
    rgb, _ = street()
    fog = AsBayer(BayerFog(Fog(mor_m=1000.0), camera(), airlight=AIRLIGHT))
    endless = torch.full((1, H, W), math.inf)
    seen = fog.run(rgb, SceneDepth(endless, horizon_row=30.0)).transmission  # the camera's own is row 20
    pitch_rad = math.atan((30.0 - 20.0) / 60.0)
    pitched = AsBayer(BayerFog(Fog(mor_m=1000.0), camera(pitch_rad=pitch_rad), airlight=AIRLIGHT))
    torch.testing.assert_close(seen, pitched.run(rgb, endless).transmission, rtol=1e-5, atol=1e-7)
    assert float(seen[0, 10, 31]) > 5 * float(fog.run(rgb, endless).transmission[0, 10, 31])


def test_a_level_ray_ends_where_the_earth_curves_away() -> None:
    seen = transmission(1e6, torch.full((1, H, W), math.inf), layer_top_m=200.0)
    level_m = math.sqrt(2 * 6.371e6 * 200.0)
    expected = math.exp(-math.log(20.0) / 1e6 * level_m)
    assert float(seen[0, 20, 31]) == pytest.approx(expected, rel=1e-4)  # on the horizon
    assert float(seen[0, 40, 31]) == pytest.approx(expected, rel=1e-4)  # and below it


def test_a_layer_without_a_top_hides_the_sky_at_any_visibility() -> None:
    assert transmission(1e6, torch.full((1, H, W), math.inf), layer_top_m=math.inf).lt(1e-30).all()


@pytest.mark.parametrize("depth_m", [math.inf, 5.0, 60.0, 5e3], ids=["sky", "5 m", "60 m", "5 km"])
def test_transmission_grows_without_a_jump_from_10_m_to_1000_km_of_visibility(depth_m: float) -> None:
    steps = torch.logspace(1, 6, 101).tolist()
    seen = torch.stack([transmission(mor, torch.full((1, H, W), depth_m)).flatten() for mor in steps])
    change = seen.diff(dim=0)
    assert bool((change >= 0).all())
    # exp(-c/V) changes by at most ln(step) / e from one visibility to the next; the step is 10^0.05.
    assert float(change.max()) <= math.log(10**0.05) / math.e * 1.001
    assert float(seen[-1].min()) > 0.85  # 50 km, the longest way in the layer, at 1000 km


def test_a_share_of_sky_lets_through_that_share_of_the_sky_s_light() -> None:
    rgb, _ = street()
    depth_m = torch.full((1, H, W), 20.0)
    fog = AsBayer(BayerFog(Fog(mor_m=200.0), camera(), airlight=AIRLIGHT))
    wall = fog.run(rgb, SceneDepth(depth_m)).transmission
    sky = fog.run(rgb, SceneDepth(torch.full_like(depth_m, math.inf))).transmission
    mixed = fog.run(rgb, SceneDepth(depth_m, sky=torch.full_like(depth_m, 0.25))).transmission
    torch.testing.assert_close(mixed, 0.75 * wall + 0.25 * sky, rtol=1e-6, atol=1e-7)


def test_particles_in_front_of_a_pixel_that_is_mostly_sky_are_those_of_the_sky() -> None:
    rgb = torch.full((3, H, W), 0.1)
    near = torch.full((1, H, W), 3.0)  # the wall of which the pixel shows a little
    snow = AsBayer(BayerWeather(Snow(3.0), camera(), airlight=0.7))
    noise = snow.draw(rgb, seed=1)
    open_sky = snow.run(rgb, torch.full((1, H, W), math.inf), noise).particle_mask
    mostly = snow.run(rgb, SceneDepth(near, sky=torch.full_like(near, 0.9)), noise).particle_mask
    little = snow.run(rgb, SceneDepth(near, sky=torch.full_like(near, 0.1)), noise).particle_mask
    assert torch.equal(mostly, open_sky)
    assert torch.equal(little, snow.run(rgb, near, noise).particle_mask)
    assert float(open_sky.mean()) > 2 * float(little.mean())


@pytest.mark.parametrize("weather", WEATHERS, ids=IDS)
def test_no_weather_lies_in_front_of_the_own_vehicle(weather: Weather) -> None:
    rgb, depth_m = street()
    near = torch.zeros(1, H, W)
    near[:, 40:] = 1.0
    seen = AsBayer(BayerWeather(weather, camera(), airlight=AIRLIGHT))
    out = seen(rgb, SceneDepth(depth_m, near_mask=near), seen.draw(rgb, seed=1))
    assert torch.equal(out[:, 40:], rgb[:, 40:])
    assert not torch.equal(out[:, :40], rgb[:, :40])


# ---- an overcast sky ------------------------------------------------------------------------------------------------


def test_an_overcast_sky_has_the_cie_s_gradient_and_stays_in_the_sky() -> None:
    rgb, depth_m = street()
    cam = camera()
    rain = BayerWeather(Rain(50.0), cam, airlight=0.5, sky="overcast")
    state = rain.planes_state(linear := torch.full((1, 3, H, W), 0.2), SceneDepth(depth_m), (1,))
    after = rain.chain.stages["overcast_sky"](state, {}).image.signal
    assert torch.equal(after[..., 16:, :], linear[..., 16:, :])
    sine = [math.sin(math.atan((20.0 - row) / 60.0)) for row in (2, 14)]
    share = 50.0 / 50.1  # of the sky at 50 mm/h
    for row, up in zip((2, 14), sine, strict=True):
        expected = share * 0.5 * (1 + 2 * up) / (1 + 4 / 3) + (1 - share) * 0.2
        torch.testing.assert_close(after[0, :, row, 31], torch.full((3,), expected), rtol=1e-3, atol=0.0)
    assert not torch.equal(AsBayer(rain)(rgb, depth_m), rgb)


def test_an_overcast_sky_comes_with_its_rain() -> None:
    rgb, depth_m = street()
    assert torch.equal(AsBayer(BayerWeather(Rain(0.0), camera(), airlight=0.5, sky="overcast"))(rgb, depth_m), rgb)
    with pytest.raises(ValueError, match="sky"):
        BayerWeather(Rain(1.0), camera(), sky="cloudy")
    assert "overcast_sky" not in BayerWeather(Fog(mor_m=100.0), camera(), sky="overcast").chain.stages


# ---- airlight of photographs (PHYSICS.md 10.7) ----------------------------------------------------------------------


def airlight(rgb: Tensor, depth_m: Tensor, **more: object) -> Tensor:
    return AsBayer(BayerFog(Fog(mor_m=100.0), camera(), **more)).run(rgb, depth_m).airlight  # type: ignore[arg-type]


def test_airlight_is_the_grey_of_the_sky_above_the_horizon_not_of_all_sky() -> None:
    _, depth_m = street()
    linear = torch.full((3, H, W), 0.2)
    linear[:, :6] = torch.tensor([0.05, 0.1, 0.3])[:, None, None]  # deep blue overhead
    linear[:, 6:16] = torch.tensor([0.55, 0.6, 0.65])[:, None, None]
    found = airlight(srgb_encode(linear), depth_m)
    assert bool((found == found[0]).all())
    # Of the rows looked at, 0 and 4 are overhead, with exp(-(sine - lowest sine) / sin 3 deg) = 0.03 and 0.09 of the
    # weight of row 12: 0.12 of 1.41 in all, so the luminance is 0.56.
    assert 0.53 < float(found[0]) < 0.6
    coloured = airlight(srgb_encode(linear), depth_m, airlight="sky")
    assert float(coloured[2]) > float(coloured[0])


def test_thin_fog_adds_the_light_that_the_horizon_has_already() -> None:
    _, depth_m = street()
    light = torch.tensor([0.2, 0.3, 0.4])
    rgb = srgb_encode(light[:, None, None].expand(3, H, W))
    seen = [
        AsBayer(BayerFog(Fog(mor_m=mor), camera(), extinction="koschmieder")).run(rgb, depth_m).airlight
        for mor in (1e3, 1e4, 1e7)
    ]
    torch.testing.assert_close(seen[0], torch.full((3,), 0.5), rtol=0.0, atol=1e-5)  # opaque over 5 km
    torch.testing.assert_close(seen[2], light, rtol=0.0, atol=1e-3)  # exp(-0.0015) of it is the sky's own
    own = math.exp(-5000.0 * math.log(20.0) / 1e4)
    torch.testing.assert_close(seen[1], own * light + (1 - own) * 0.5, rtol=0.0, atol=1e-3)


def test_thin_fog_leaves_an_uneven_sky_at_the_horizon_as_it_is() -> None:
    rgb, depth_m = street()
    rgb[:, :16] = torch.linspace(0.3, 0.9, W)  # darker on the left: no single airlight is right
    depth_m[:, 16:21] = math.inf  # down to the horizon
    fog = AsBayer(BayerFog(Fog(mor_m=1e6), camera()))
    given = AsBayer(BayerFog(Fog(mor_m=1e6), camera(), airlight=0.5))
    assert psnr_db(fog(rgb, depth_m), rgb) > 60.0
    assert psnr_db(given(rgb, depth_m), rgb) < 50.0  # a measured airlight counts as it is


def test_without_a_sky_a_named_grey_stands_in_and_never_the_trees() -> None:
    rgb, _ = street()
    with pytest.warns(TorchweatherWarning, match="no sky in the frame.*a grey of 0.6 stands in"):
        found = airlight(rgb, torch.full((1, H, W), 20.0))
    assert found.tolist() == pytest.approx([0.6] * 3)


def test_a_night_sky_keeps_its_own_light_and_is_warned_of() -> None:
    _, depth_m = street()
    with pytest.warns(TorchweatherWarning, match="night"):
        found = airlight(torch.full((3, H, W), 0.05), depth_m)
    assert float(found.max()) < 0.01


def test_a_picture_of_the_night_without_a_sky_gets_no_glowing_fog() -> None:
    rgb = torch.full((3, H, W), 0.06)  # 0.005 in linear light
    with pytest.warns(TorchweatherWarning) as caught:
        found = airlight(rgb, torch.full((1, H, W), 20.0))
    said = " ".join(str(one.message) for one in caught)
    assert "its mean light stands in" in said
    assert "night" in said
    assert float(found.max()) < 0.01


def test_results_carry_how_sure_the_depth_is() -> None:
    rgb, depth_m = street()
    fog = AsBayer(BayerFog(Fog(mor_m=100.0), camera(), airlight=0.6))
    assert fog.run(rgb, depth_m).depth_confidence == "exact"
    assert fog.run(rgb, SceneDepth(depth_m, "guessed")).depth_confidence == "guessed"


def test_a_sequence_of_planes_begins_with_the_draw_and_moves() -> None:
    rgb, depth_m = street()
    rain = AsBayer(BayerWeather(Rain(30.0), camera(), airlight=0.6))
    film = [rain(rgb, depth_m, noise) for noise in rain.draw_sequence(rgb, 3, 1 / 30, seed=7)]
    assert torch.equal(film[0], rain(rgb, depth_m, rain.draw(rgb, seed=7)))
    assert not torch.equal(film[0], film[1])


def test_demosaicing_is_for_the_mosaic_alone() -> None:
    inner = BayerFog(Fog(mor_m=100.0), camera())
    with pytest.raises(ValueError, match="through_mosaic=True"):
        AsBayer(inner, method="bilinear")
    assert AsBayer(inner, through_mosaic=True, method="bilinear").method == "bilinear"
