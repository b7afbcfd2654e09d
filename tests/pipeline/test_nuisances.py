"""Nuisance parameters: options, effects and fields of sensors that are drawn for each sample."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
import torch

import torchweather as tw
from torchweather.camera.effects.all import CameraExposureGain
from torchweather.compose.compose import Draw
from torchweather.core.distributions import distributions_in, with_drawn
from torchweather.core.random import derived_seed, keyed_stream
from torchweather.export import to_onnx
from torchweather.lidar.effects.all import LidarThresholdShift
from torchweather.pipeline.sensor_transform import draw_nuisances
from torchweather.recipes import load_recipe, save_recipe

CAMERA = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
LIDAR = tw.Lidar.preset("velodyne-hdl-64e")
RADAR = tw.Radar.preset("imaging-77ghz")
AIRLIGHT, GAIN = tw.Uniform(0.3, 0.9), tw.LogUniform(0.8, 1.25)
FRAME = 0.1 + 0.5 * torch.rand(3, 1, 24, 32, generator=torch.Generator().manual_seed(1))


def camera(weather: Any, **more: Any) -> tw.BayerWeather:
    return tw.BayerWeather(weather, CAMERA, **{"depth": 30.0, "airlight": AIRLIGHT, **more})


def both(**more: Any) -> tw.Compose:
    """A camera and a LiDAR of one vehicle, both without a weather of their own."""
    gain = [CameraExposureGain(factor=GAIN)]
    lidar = tw.Lidar.preset("velodyne-hdl-64e", near_full_m=tw.Uniform(5.0, 30.0))
    return tw.Compose(
        {
            "image": camera(None, effects=gain),
            "second": camera(None, effects=gain),
            "points": tw.LidarWeather(None, lidar, effects=[{"effect": "lidar.threshold_shift", "shift_db": AIRLIGHT}]),
        },
        weather=tw.Mixture(
            tw.Fog(mor_m=(50, 200)),
            tw.Snow(1.0, flake_reflectivity=tw.Uniform(0.1, 0.4), wind_m_per_s=(0.0, tw.Uniform(-5, 5), 0.0)),
        ),
        history="draw",
        **more,
    )


def sample(seed: int = 0) -> dict[str, Any]:
    random = torch.Generator().manual_seed(seed)
    along = torch.nn.functional.normalize(torch.randn(60, 3, generator=random), dim=-1)
    points = torch.cat([40 * along, torch.full((60, 1), 90.0)], -1)
    return {"image": FRAME[0], "second": FRAME[1], "points": points}


# ---- what was drawn --------------------------------------------------------------------------------------------------


def test_draws_follow_their_law_and_are_independent_of_each_other() -> None:
    nuisances = {"airlight": AIRLIGHT, "effects.camera.exposure_gain.factor": GAIN}
    drawn = np.array([list(draw_nuisances(nuisances, seed).values()) for seed in range(2000)])
    shares = np.stack([(drawn[:, 0] - 0.3) / 0.6, np.log(drawn[:, 1] / 0.8) / math.log(1.25 / 0.8)])
    # Uniform on 0..1: mean 1/2 and variance 1/12 of 2000 draws; four standard deviations of each.
    assert np.abs(shares.mean(1) - 0.5).max() < 4 * (1 / 12 / 2000) ** 0.5
    assert np.abs(shares.var(1) - 1 / 12).max() < 4 * (1 / 180 / 2000) ** 0.5
    assert abs(np.corrcoef(shares)[0, 1]) < 4 / 2000**0.5


def test_a_call_is_what_a_transform_with_the_drawn_numbers_gives() -> None:
    transform = camera(tw.Rain(20.0), effects=[CameraExposureGain(factor=GAIN)])
    seed = 11
    light = AIRLIGHT.at(float(keyed_stream(seed, "nuisance.airlight").random()))
    gain = GAIN.at(float(keyed_stream(seed, "nuisance.effects.camera.exposure_gain.factor").random()))
    plain = camera(tw.Rain(20.0), airlight=light, effects=[CameraExposureGain(factor=gain)])
    wanted = plain(FRAME[0], noise=plain.draw(FRAME[0], seed=seed))
    assert torch.equal(transform(FRAME[0], seed=seed), wanted)
    assert not torch.equal(transform(FRAME[0], seed=seed + 1), wanted)


def test_sensors_share_what_is_of_the_world_and_not_what_is_their_own() -> None:
    drawn = both().draw(sample(), seed=5)
    assert isinstance(drawn, Draw)
    found = drawn.nuisances
    assert found["image"]["airlight"] == found["second"]["airlight"]
    factor = "effects.camera.exposure_gain.factor"
    assert found["image"][factor] != found["second"][factor]
    assert found["image"][factor] == draw_nuisances({factor: GAIN}, derived_seed(5, "image"))[factor]
    assert 5.0 < found["points"]["sensor.near_full_m"] < 30.0
    assert drawn.weather is not None
    snow = drawn.weather["parts"][1]
    assert 0.1 < snow["flake_reflectivity"] < 0.4
    assert snow["wind_m_per_s"][0] == 0.0 != snow["wind_m_per_s"][1]


def test_a_record_of_plain_values_gives_the_same_bits_again() -> None:
    first = both()(sample(), seed=5)
    again = both()(sample(), draw=Draw.from_dict(json.loads(json.dumps(first["draw"]))))
    assert all(torch.equal(first[key], again[key]) for key in ("image", "second", "points"))
    assert again["draw"] == first["draw"]
    other = {**first["draw"], "nuisances": {**first["draw"]["nuisances"], "image": {"airlight": 0.4}}}
    with pytest.raises(ValueError, match=r"'image': the draw must have a value for each of airlight, effects"):
        both()(sample(), draw=Draw.from_dict(other))


def test_a_batch_is_its_samples_and_clear_ones_stay() -> None:
    compose = both(p=0.6)
    data = {key: torch.stack([value] * 4) for key, value in sample().items()}
    together = compose(data, seed=20)
    for place in range(4):
        alone = compose(sample(), seed=20 + place)
        assert all(torch.equal(alone[key], together[key][place]) for key in sample())
        if alone["draw"]["weather"] is None:
            assert "nuisances" not in alone["draw"]
            assert all(torch.equal(alone[key], value) for key, value in sample().items())
    assert {one["weather"] is None for one in together["draw"]} == {True, False}


def test_what_a_batch_shared_is_drawn_for_each_of_its_samples() -> None:
    snow = tw.Snow((0.5, 2.0), flake_reflectivity=tw.Uniform(0.1, 0.9))
    lidar = tw.LidarSnow(snow, LIDAR, lost="drop")
    clouds = torch.stack([sample(k)["points"] for k in range(2)])
    together = lidar.run(clouds, seed=3)
    for place in range(2):
        alone = lidar.run(clouds[place], seed=3 + place)
        assert torch.equal(alone.points, together.points[place])
        assert torch.equal(alone.empty_beams, together.empty_beams[place])
    assert isinstance(lidar(clouds, seed=3), list)


def test_depth_beside_a_batch_goes_to_its_samples() -> None:
    fog = camera(tw.Fog(mor_m=100.0), depth=None)
    depth = torch.tensor([10.0, 30.0, 90.0]).reshape(3, 1, 1, 1).expand(3, 1, 24, 32)
    together = fog(FRAME, depth, seed=2)
    assert all(torch.equal(together[k], fog(FRAME[k], depth[k], seed=2 + k)) for k in range(3))
    shared = fog(FRAME, depth[0], seed=2)
    assert torch.equal(shared[2], fog(FRAME[2], depth[0], seed=4))
    out = torch.empty(3, 1, 24, 32)
    fog(FRAME, depth, out=out, seed=2)
    assert torch.allclose(out, together, atol=1e-6)


def test_photographs_take_distributions_in_their_options() -> None:
    picture = torch.full((3, 24, 32), 0.3)
    rainy = tw.RandomRain(20.0, p=1.0, depth=30.0, camera=CAMERA, airlight=tw.Choice([0.2, 0.9]))
    plain = {light: tw.RandomRain(20.0, p=1.0, depth=30.0, camera=CAMERA, airlight=light) for light in (0.2, 0.9)}
    found = [
        next(k for k, one in plain.items() if torch.equal(one(picture, seed=s), rainy(picture, seed=s)))
        for s in range(8)
    ]
    assert set(found) == {0.2, 0.9}


# ---- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (
            lambda: camera(tw.Fog(100.0), airlight=tw.Uniform(0.5, 3.0)),
            r"got 3.0. .*airlight=Uniform\(low=0.5, high=3.0",
        ),
        (lambda: camera(tw.Fog(100.0), layer_top_m=tw.Uniform(0.1, 9.0)), r"got 0.1.*layer_top_m=Uniform\(low=0.1"),
        (lambda: CameraExposureGain(factor=tw.Uniform(1.0, 20.0)), r"0..10; got 20.0. .*Uniform\(low=1.0, high=20.0"),
        (lambda: tw.LidarRain(tw.Rain(9.0), LIDAR, q_back=tw.Uniform(-1.0, 1.0)), r"q_back.*-1"),
        (lambda: tw.Lidar.preset("velodyne-hdl-64e", near_full_m=tw.Uniform(1.0, 9.0)), r"got 1 and 2 m.*near_full_m"),
        (lambda: camera(tw.Fog(100.0), near_m=tw.Uniform(0.5, 1.0)), "near_m cannot be drawn for each sample"),
        (lambda: camera(tw.Fog(100.0), p=tw.Uniform(0.5, 1.0)), "p cannot be drawn for each sample"),
        (
            lambda: tw.Camera.preset("lucid-triton", fx=tw.Uniform(9, 10)),
            "fx cannot be drawn .* Drawn can be: exposure_s",
        ),
        (lambda: camera(tw.Fog(100.0), depth=tw.Choice([object()])), "depth that are drawn must be numbers or text"),
        (lambda: tw.Uniform(1.0, 2.0) * 2, r"Uniform\(low=1.0, high=2.0\): it has yet to be drawn"),
    ],
)
def test_a_range_out_of_law_is_refused_with_the_range(build: Any, text: str) -> None:
    with pytest.raises((TypeError, ValueError), match=text):
        build()


def test_what_is_not_drawn_yet_cannot_be_applied(tmp_path: Any) -> None:
    transform = camera(tw.Rain(10.0))
    with pytest.raises(ValueError, match=r"BayerWeather: airlight must be a value here; got Uniform"):
        transform(FRAME, noise=transform.draw(FRAME, seed=1))
    with pytest.raises(ValueError, match=r"airlight must be a value here"):
        to_onnx(transform, tmp_path / "graph.onnx")
    effect = CameraExposureGain(factor=GAIN)
    with pytest.raises(ValueError, match=r"CameraExposureGain: factor must be a number here"):
        effect(camera(tw.Rain(10.0), airlight=0.5).state_of(FRAME), {})


def test_a_transform_without_a_weather_waits_for_one() -> None:
    for waiting, data in ((camera(None, airlight=0.5), FRAME[0]), (tw.LidarFog(None, LIDAR), sample()["points"])):
        with pytest.raises(ValueError, match=r"it was built without a weather. .*Compose\(weather=...\)"):
            waiting(data)
        with pytest.raises(ValueError, match=r"Compose: 'x' was built without a weather"):
            tw.Compose({"x": waiting})
    fog = tw.Fog(mor_m=80.0)
    wanted = camera(fog, airlight=0.5)(FRAME[0], seed=1)
    assert torch.equal(camera(None, airlight=0.5).with_weather(fog)(FRAME[0], seed=1), wanted)
    assert torch.equal(tw.Compose({"x": camera(None, airlight=0.5)}, weather=fog)({"x": FRAME[0]}, seed=1)["x"], wanted)


# ---- cost and files -------------------------------------------------------------------------------------------------


def test_what_flakes_do_with_light_needs_no_new_tables() -> None:
    veils = [
        tw.BayerSnow(tw.Snow(1.0, **more), CAMERA).chain.stages["particle_veil"] for more in ({}, {"albedo": 0.85})
    ]
    tables = [veil.parts[0].tables for veil in veils]  # type: ignore[attr-defined]
    assert tables[0] is tables[1]


def test_a_recipe_keeps_distributions(tmp_path: Any) -> None:
    lidar = tw.Lidar.preset("velodyne-hdl-64e", near_full_m=tw.Uniform(5.0, 30.0))
    transform = tw.LidarWeather(
        tw.Fog(mor_m=(50, 200)),
        lidar,
        receiver=tw.Choice(["gate", "matched"]),
        effects=[LidarThresholdShift(shift_db=AIRLIGHT)],
    )
    save_recipe(transform, tmp_path / "mine.yaml", title="mine")
    again = load_recipe(tmp_path / "mine.yaml")
    assert isinstance(again, tw.LidarWeather)
    assert again.nuisances == transform.nuisances
    cloud = sample()["points"]
    assert torch.equal(again(cloud, seed=1), transform(cloud, seed=1))


def test_distributions_are_found_and_replaced_wherever_they_are() -> None:
    given = {"effects": [CameraExposureGain(factor=GAIN)], "light": (0.1, AIRLIGHT), "night": {"level": AIRLIGHT}}
    found = distributions_in(given)
    assert list(found) == ["effects.camera.exposure_gain.factor", "light.1", "night.level"]
    drawn = with_drawn(given, {"effects.camera.exposure_gain.factor": 1.1, "light.1": 0.5})
    assert drawn["effects"][0].random == {}
    assert abs(float(drawn["effects"][0].factor) - 1.1) < 1e-6
    assert (drawn["light"], drawn["night"]) == ((0.1, 0.5), given["night"])
