"""Night scenes: identity, lamps found and given, fading, warnings, files."""

from __future__ import annotations

import itertools
import math
import warnings

import pytest
import torch

import torchweather as tw
from torchweather.camera.night.found_lamps import found_lamps, lamp_in_view
from torchweather.camera.night.lamps import Lamp, Night
from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.physics import sphere_budget
from torchweather.physics.sphere_scattering import drop_scattering_per_sr, flake_scattering_per_sr
from torchweather.pipeline.chain import Chain

CAMERA = tw.Camera.from_intrinsics(150.0, 150.0, 95.5, 71.5, 192, 144, height_m=1.5)
DARK = Night(own="none", lamps=())


def frame() -> tuple[torch.Tensor, torch.Tensor]:
    """A dark road under a dark sky, with a tail lamp, a headlamp and a street lamp; linear planes and depth."""
    down = ((torch.arange(144) - 71.5) / 150.0)[:, None].expand(144, 192)
    depth = torch.where(down > 0, 1.5 / down, torch.inf)
    light = torch.where(down > 0, 0.01, 0.001).expand(3, 144, 192).clone()
    light[0, 78:81, 120:123], depth[76:83, 118:125] = 1.0, 20.0
    light[1:, 78:81, 120:123] = 0.05
    light[0, 76:83, 118:125] = light[0, 76:83, 118:125].clamp_min(0.4)
    light[:, 79:81, 60:62], depth[78:82, 59:63] = 1.0, 40.0
    light[:, 40:42, 90:92] = 1.0
    return light, depth[None]


def test_clear_air_is_the_input_bit_for_bit() -> None:
    light, depth = frame()
    for weather in (tw.Fog(), tw.Rain(0.0), tw.Snow(0.0), tw.Mixture(tw.Fog(), tw.Rain(0.0))):
        for night in (Night(), DARK):
            found = tw.AsBayer(tw.BayerWeather(weather, CAMERA, night=night))(light.clone(), depth)
            assert torch.equal(found, light)
            mosaic = light.mean(0, keepdim=True)
            assert torch.equal(tw.BayerWeather(weather, CAMERA, night=night)(mosaic, depth), mosaic)


def test_lamps_are_found_with_their_colour_and_distance() -> None:
    light, depth = frame()
    transform = tw.BayerFog(tw.Fog(100.0), CAMERA, night=Night())
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    tail, street, head = sorted(
        found_lamps(state, 0, Night(), CAMERA), key=lambda one: (one.lamp.intensity_cd, one.depth_m)
    )
    assert tail.lamp.intensity_cd == 10.0
    assert tail.lamp.colour[0] > 1.8 * tail.lamp.colour[1]
    assert tail.depth_m == 20.0
    assert (head.lamp.intensity_cd, head.depth_m) == (1000.0, 40.0)
    # In front of the sky, 30.5 px above the horizon: 8 m high less the camera's 1.5 m.
    assert street.depth_m == pytest.approx(6.5 / (31.0 / 150.0), rel=0.02)
    # A white lamp of 1000 cd, 40 m ahead and 9.3 m aside: its lux over 4 pixels of 1 / 150^2 sr, of 10 cd/m2.
    assert head.signal[1] == pytest.approx(1000.0 / (40.0**2 + 9.3**2) * 150.0**2 / 4.0 / 10.0, rel=0.01)


def test_what_the_own_headlamps_may_light_is_no_lamp() -> None:
    light, depth = frame()
    light[:, 120:123, 90:93] = 1.0  # a stone on the road, 4.5 m ahead in the low beam
    transform = tw.BayerFog(tw.Fog(100.0), CAMERA, night=Night())
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    assert len(found_lamps(state, 0, Night(), CAMERA)) == 3
    assert len(found_lamps(state, 0, DARK, CAMERA)) == 4
    light[:, 0:30] = 1.0  # a lit wall
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    assert len(found_lamps(state, 0, Night(), CAMERA)) == 3


def linear(weather: tw.Fog, night: Night, light: torch.Tensor, depth: torch.Tensor, **options: object) -> torch.Tensor:
    """Linear colour planes in weather."""
    transform = tw.BayerWeather(weather, CAMERA, night=night, **options)
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    return transform.weathered(state).image.signal[0]


def test_a_lamp_glows_by_the_light_that_the_frame_does_not_show() -> None:
    light, depth = frame()
    night = Night(own="none")
    glow = linear(tw.Fog(60.0), night, light, depth, airlight=0.0)
    brighter = linear(tw.Fog(60.0), Night(own="none", white_lamp_cd=4000.0), light, depth, airlight=0.0)
    without = linear(tw.Fog(60.0), DARK, light, depth, airlight=0.0)
    beside = (slice(None), 79, 75)  # 14 px beside the headlamp
    assert float(glow[beside].min()) > 3.0 * float(without[beside].max())
    street, added = slice(38, 44), brighter - without
    ratio = added[1, street, 60:84].mean() / (glow - without)[1, street, 60:84].mean()
    assert float(ratio) == pytest.approx(4.0, rel=0.05)
    # The lamp itself stays saturated until the fog has dimmed it to saturation.
    assert float(glow[1, 79, 60]) >= 1.0 - 1e-6
    dense = linear(tw.Fog(5.0), night, light, depth, airlight=0.0)
    assert float(dense[1, 79, 60]) < 0.1


def test_a_given_lamp_is_where_its_position_says_and_one_behind_is_no_error() -> None:
    light, depth = frame()
    light, depth = torch.full_like(light, 0.001), torch.full_like(depth, 60.0)
    lamps = (Lamp((40.0, 4.0, 1.5), 500.0), Lamp((-10.0, 0.0, 3.0), 500.0))
    found = linear(tw.Fog(80.0), Night(own="none", lamps=lamps), light, depth, airlight=0.0)
    assert divmod(int(found[1].argmax()), 192) == (pytest.approx(71.5, abs=1.0), pytest.approx(95.5 - 15.0, abs=1.0))
    assert float(found[1, 71, 80]) > 10 * float(found[1, 71, 150])


def test_a_given_lamp_behind_a_wall_is_left_out_unless_the_frame_shows_it() -> None:
    light, depth = torch.full((3, 144, 192), 0.001), torch.full((1, 144, 192), 20.0)
    lamp = Night(own="none", lamps=(Lamp((40.0, 4.0, 1.5), 500.0),))
    hidden = linear(tw.Fog(80.0), lamp, light, depth, airlight=0.0)
    assert torch.equal(hidden, linear(tw.Fog(80.0), DARK, light, depth, airlight=0.0))
    for distance_m in (37.6, math.inf):  # nearer by 0.5 m and 5 % of 40 m is 37.5 m: the lamp's own car, and nothing
        seen = linear(tw.Fog(80.0), lamp, light, torch.full_like(depth, distance_m), airlight=0.0)
        assert float(seen[1, 71, 80]) > 10 * float(hidden[1, 71, 80])
    light[:, 71:73, 79:82] = 1.0  # the frame shows a lamp where the depth has a wall
    assert float(linear(tw.Fog(80.0), lamp, light, depth, airlight=0.0)[1, 71, 76]) > 3 * float(hidden[1, 71, 76])


def test_a_lamp_in_the_picture_shows_its_beam_towards_the_camera() -> None:
    size, night = (144, 192), Night(own="none")

    def level(**beam: object) -> float:
        seen = lamp_in_view(Lamp((40.0, 0.0, 1.5), 20_000.0, **beam), size, CAMERA, night)  # at the camera's height
        assert seen is not None
        assert seen.signal[0] == seen.signal[2]
        return seen.signal[1]

    plain = level()
    assert level(beam="rear", heading_rad=math.pi) == pytest.approx(plain, rel=1e-12)
    assert level(beam="rear", heading_rad=math.pi - 1.0) == pytest.approx(math.cos(1.0) * plain, rel=1e-9)
    assert level(beam="rear") == 0.0  # it shines away
    # Horizontally a low beam keeps its stray light of 1.5 %, and sigmoid(-0.57 / 0.15) = 0.022 of the hot spot's
    # exp(-0.5) and the apron's 0.15 exp(-0.5).
    dipped = 0.015 + (0.6065 + 0.15 * 0.6065) / (1.0 + math.exp(0.57 / 0.15))
    assert level(beam="low_beam", heading_rad=math.pi) == pytest.approx(dipped * plain, rel=1e-3)


@pytest.mark.filterwarnings("ignore:NightLamps. a lamp at")  # at the lens, for a closed form
def test_what_the_own_headlamps_light_fades_on_both_ways() -> None:
    high = Lamp((0.0, 0.0, 1.5), 2000.0)  # at the camera, shining everywhere
    depth = torch.full((1, 144, 192), 20.0)
    # As bright as a surface of albedo 0.15 in this lamp, 20 m ahead.
    level = 2000.0 / 400.0 * 0.15 / math.pi / 10.0
    light = torch.full((3, 144, 192), level)
    fog, middle = tw.Fog(mor_m=100.0), (1, 71, 95)
    lit = linear(fog, Night(own=(high,), lamps=()), light, depth, airlight=0.0)
    unlit = linear(fog, DARK, light, depth, airlight=0.0)
    transform = tw.BayerFog(fog, CAMERA, night=Night(own=(high,), lamps=()))
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    after = transform.chain.stages["night_lamps"](state, {})
    assert torch.equal(after.image.signal, state.image.signal)
    veil = after.air.lamp_light.seen(after.air.lamp_light.fog, depth[None])[0]
    faded = (lit - veil)[middle] / unlit[middle]
    optics = transform.chain.stages["night_lamps"]._optics(state, 0)
    # An even lamp: what is scattered onward by less than a radian arrives as well.
    kept = math.exp(-optics.extinction_per_m * (1.0 - optics.forward.share) * 20.0)
    assert float(faded) == pytest.approx(kept, rel=0.03)
    assert float(veil[middle]) > 0.0


def test_flakes_near_the_car_are_white() -> None:
    depth = torch.full((1, 144, 192), 100.0)
    light = torch.full((3, 144, 192), 0.002)
    lit, dark = (
        tw.BayerSnow(tw.Snow(1.0), CAMERA, night=Night(own=own, lamps=()), airlight=0.002)
        for own in ("high_beam", "none")
    )
    state = lit.planes_state(light[None], lit.scene_of(light, depth), (1,))
    noise = lit.chain.draw(state, seed=4)
    gain = (lit.chain(state, noise).image.signal - dark.chain(state, noise).image.signal)[0, 1]
    assert float(gain.min()) > -1e-6
    assert float(gain.max()) > 0.05


@pytest.mark.filterwarnings("ignore:NightLamps. a lamp at")  # at the lens, for a closed form
@pytest.mark.parametrize(("far_m", "listed"), [(100.0, {}), (6.0, {"min_listed_coverage": 1e-6})])
def test_the_mean_light_of_flakes_is_that_of_each_slice_of_air(far_m, listed) -> None:
    # Thin snow, where the order of the flakes in depth does not matter (at 1 mm/h it is 6 % of the light); nearly all
    # of them as haze, or one by one.
    snow, depth, light = tw.Snow(0.2), torch.full((1, 144, 192), far_m), torch.full((3, 144, 192), 0.002)
    lamp = Lamp((0.0, 0.0, 20.0), 200_000.0) if far_m > 50.0 else Lamp((0.0, 0.0, 1.5), 500.0)
    lit, dark = (
        tw.BayerSnow(snow, CAMERA, night=Night(own=own, lamps=()), airlight=0.002, **listed)
        for own in ((lamp,), "none")
    )
    state = lit.planes_state(light[None], lit.scene_of(light, depth), (1,))
    lamplight = lit.chain.stages["night_lamps"](state, {}).air.lamp_light
    per_m = float(0.5 * tw.physics.extinction_per_m(snow.distribution(), 550.0, q_ext=2.0))
    expected = torch.zeros(1, 1, 144, 192)
    for near, far in itertools.pairwise(torch.logspace(math.log10(0.5), math.log10(far_m), 200).tolist()):
        middle_m = torch.full((1, 1, 144, 192), 0.5 * (near + far))
        path_m = middle_m * state.scene.ray_per_depth
        shown = lamplight.seen(lamplight.flake, middle_m) * torch.exp(-per_m * path_m)
        expected += shown * (far - near) * state.scene.ray_per_depth * per_m
    means = []
    for seed in range(4 if far_m > 50.0 else 16):
        noise = lit.chain.draw(state, seed=seed)
        bright, without = (one.chain(state, noise).image.signal[:, 1] for one in (lit, dark))
        means.append(float((bright - without).mean()))
    error = 4.0 * float(torch.tensor(means).std()) / math.sqrt(len(means))
    assert sum(means) / len(means) == pytest.approx(float(expected.mean()), abs=error, rel=0.02)


def test_a_mosaic_shows_what_colour_planes_show() -> None:
    light, depth = frame()
    grey = light.mean(0, keepdim=True)
    night = Night(own="low_beam", lamps=(Lamp((30.0, 2.0, 1.0), 400.0),))
    options = {"night": night, "airlight": 0.01, "scattering": "multiple"}
    planes = tw.BayerWeather(tw.Fog(80.0), CAMERA, **options)
    state = planes.planes_state(grey.expand(1, 3, 144, 192), planes.scene_of(grey, depth), (1,))
    expected = planes.chain(state, {}).image.signal[0, 1].clamp(0, 1)
    found = planes(grey, depth)[0]
    green = torch.zeros(144, 192, dtype=torch.bool)
    green[0::2, 1::2] = green[1::2, 0::2] = True
    away = green.clone()
    away[60:90] = False  # next to the lamp the two have pixels of another size
    assert float((found - expected)[away].abs().max()) < 0.02 * float(expected[away].max()) + 0.002


def test_a_day_frame_is_warned_of_with_the_evidence() -> None:
    day = torch.full((1, 144, 192), 0.4)
    with pytest.warns(TorchweatherWarning, match=r"0\.40 of saturation.*looks like day"):
        tw.BayerFog(tw.Fog(100.0), CAMERA, night=True, airlight=0.5, depth=30.0)(day)


def test_a_night_frame_without_the_option_is_warned_of_and_with_it_is_not() -> None:
    light, depth = frame()
    mosaic = light.mean(0, keepdim=True)
    with pytest.warns(TorchweatherWarning, match="looks like night"):
        tw.BayerFog(tw.Fog(100.0), CAMERA)(mosaic, depth)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tw.BayerFog(tw.Fog(100.0), CAMERA, night=True)(mosaic, depth)


@pytest.mark.parametrize("which", ["own", "lamps"])
def test_a_lamp_at_the_lens_is_warned_of_with_the_bound(which) -> None:
    light, depth = frame()
    for distance_m, near in ((0.49, True), (0.51, False)):
        night = Night(**{"own": "none", "lamps": (), which: (Lamp((0.0, distance_m, CAMERA.height_m), 10.0),)})
        fog = tw.BayerFog(tw.Fog(100.0), CAMERA, night=night, airlight=0.01)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            fog(light[:1], depth)
        texts = [str(one.message) for one in said if "from the camera" in str(one.message)]
        assert len(texts) == near
        if near:
            assert "is 0.49 m from the camera" in texts[0]
            assert "at least 0.5 m" in texts[0]


@pytest.mark.parametrize(
    ("night", "said"),
    [
        ({"own": "fog_lights"}, "own"),
        ({"lamps": [{"intensity_cd": 3.0}]}, "position_m"),
        ({"lamps": [{"position_m": [1.0, 2.0, 3.0], "beam": "laser"}]}, "beam"),
        ({"saturation_cd_per_m2": 0.0}, "saturation_cd_per_m2"),
        ({"lamp": []}, "lamps"),
        (3.0, "night"),
    ],
)
def test_what_is_no_night_is_refused_by_name(night, said) -> None:
    with pytest.raises(TorchweatherError, match=said):
        tw.BayerFog(tw.Fog(100.0), CAMERA, night=night)


def test_a_chain_and_a_recipe_keep_the_night(tmp_path) -> None:
    light, depth = frame()
    night = Night(own="high_beam", lamps=(Lamp((30.0, 2.0, 1.0), 400.0),))
    transform = tw.BayerFog(tw.Fog(80.0), CAMERA, night=night, airlight=0.01)
    again = Chain.from_dict(transform.chain.to_dict())
    state = transform.planes_state(light[None], transform.scene_of(light, depth), (1,))
    assert torch.equal(again(state, {}).image.signal, transform.chain(state, {}).image.signal)
    tw.recipes.save_recipe(transform, tmp_path / "night.yaml", title="A street at night")
    loaded = tw.recipes.load_recipe(str(tmp_path / "night.yaml"))
    mosaic = light.mean(0, keepdim=True)
    assert torch.equal(loaded(mosaic, depth), transform(mosaic, depth))


def test_a_wet_road_mirrors_a_lamp_as_bright_as_it_is() -> None:
    light, depth = frame()
    normal = torch.zeros(3, 144, 192)
    normal[2, 72:] = 1.0
    lamps = (Lamp((40.0, 0.0, 2.5), 800.0),)
    effects = [{"effect": "camera.wet_surface", "mirror": 1.0}]
    mosaic = light.mean(0, keepdim=True)
    wet = tw.BayerFog(tw.Fog(1e6), CAMERA, night=Night(own="none", lamps=lamps), airlight=0.0, effects=effects)
    dark = tw.BayerFog(tw.Fog(1e6), CAMERA, night=DARK, airlight=0.0, effects=effects)
    gain = wet(mosaic, depth, normal=normal) - dark(mosaic, depth, normal=normal)
    # The mirror image of the lamp, 1 m above the camera's height and 40 m ahead, is as far below the horizon: row 75.
    row = float((gain[0] * torch.arange(144.0)[:, None]).sum() / gain.sum())
    column = float((gain[0] * torch.arange(192.0)).sum() / gain.sum())
    assert (row, column) == (pytest.approx(75.25, abs=1.0), pytest.approx(95.5, abs=1.0))
    assert float(gain.max()) > 0.5


def test_a_sphere_scatters_what_fresnel_gives_it() -> None:
    angle = torch.linspace(0.0, math.pi, 6001, dtype=torch.float64)
    scattered = drop_scattering_per_sr(angle)
    whole = float(torch.trapezoid(2.0 * math.pi * torch.sin(angle) * scattered, angle))
    budget = sphere_budget(1.33)
    geometric = budget.external_reflection + budget.refraction + budget.one_internal
    assert geometric - 0.005 < whole < geometric + 0.1  # more backward, as LiDAR see it: 0.1 at most
    assert float(drop_scattering_per_sr(math.pi)) >= 0.2 / (4.0 * math.pi)
    flake = flake_scattering_per_sr(angle, 0.9, 0.25)
    assert float(torch.trapezoid(2.0 * math.pi * torch.sin(angle) * flake, angle)) == pytest.approx(0.9, abs=1e-3)
