"""Compose over every transform: a key gets what its transform gives with the key's own seed, and no more."""

from __future__ import annotations

import random
from typing import Any

import pytest
import torch

import torchweather as tw
from torchweather.core.random import derived_seed

CAMERA = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
LIDAR = tw.Lidar.preset("velodyne-hdl-64e")
RADAR = tw.Radar.preset("imaging-77ghz")
RAIN, FOG, SNOW = tw.Rain(30.0), tw.Fog(mor_m=60.0), tw.Snow(2.0)
BOTH = tw.Mixture(tw.Rain(10.0), tw.Fog(mor_m=200.0))
ALL: dict[str, Any] = {
    "BayerRain": tw.BayerRain(RAIN, CAMERA, airlight=0.7),
    "BayerFog": tw.BayerFog(FOG, CAMERA, airlight=0.7),
    "BayerSnow": tw.BayerSnow(SNOW, CAMERA, airlight=0.7),
    "BayerWeather": tw.BayerWeather(BOTH, CAMERA, airlight=0.7),
    "AsBayer": tw.AsBayer(tw.BayerRain(RAIN, CAMERA, airlight=0.7)),
    "LidarRain": tw.LidarRain(RAIN, LIDAR),
    "LidarFog": tw.LidarFog(FOG, LIDAR),
    "LidarSnow": tw.LidarSnow(SNOW, LIDAR),
    "LidarWeather": tw.LidarWeather(BOTH, LIDAR),
    "RadarAttenuation": tw.RadarAttenuation(RAIN, RADAR, clutter=True),
}
OF_CAMERAS = {name for name in ALL if "Bayer" in name}
each = pytest.mark.parametrize("name", list(ALL))


def data(name: str, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    draw = torch.Generator().manual_seed(3)
    if name in OF_CAMERAS:
        image = 0.1 + 0.6 * torch.rand(3 if name == "AsBayer" else 1, 24, 32, generator=draw)
        return (image * 255).to(dtype) if dtype == torch.uint8 else image.to(dtype)
    along = torch.nn.functional.normalize(torch.randn(120, 3, generator=draw), dim=-1)
    at = along * (5 + 40 * torch.rand(120, 1, generator=draw))
    tail = torch.tensor([[90.0]]) if name.startswith("Lidar") else torch.tensor([[-2.0, -100.0, 5.0]])
    return torch.cat([at, tail.expand(120, -1)], -1).to(dtype)


def sample(name: str, dtype: torch.dtype = torch.float32) -> dict[str, Any]:
    found: dict[str, Any] = {"it": data(name, dtype), "rest": object()}
    return {**found, "depth": torch.full((1, 24, 32), 30.0)} if name in OF_CAMERAS else found


@each
def test_a_key_gets_what_its_transform_gives_with_the_key_s_seed(name: str) -> None:
    given, transform = sample(name), ALL[name]
    out = tw.Compose({"it": transform})(given, seed=11)
    noise = transform.draw(given["it"], seed=derived_seed(11, "it"))
    arguments = (given["depth"], noise) if name in OF_CAMERAS else (noise,)
    assert torch.equal(out["it"].nan_to_num(-1), transform(given["it"], *arguments).nan_to_num(-1))
    assert not torch.equal(out["it"], given["it"]) or out["it"].shape != given["it"].shape


@each
def test_a_seed_leaves_the_generators_of_others_alone(name: str) -> None:
    before = torch.get_rng_state(), random.getstate()
    tw.Compose({"it": ALL[name]})(sample(name), seed=11)
    assert torch.equal(torch.get_rng_state(), before[0])
    assert random.getstate() == before[1]


@pytest.mark.parametrize(("name", "dtype"), [*((name, torch.float64) for name in ALL), ("AsBayer", torch.uint8)])
def test_a_key_keeps_its_dtype_and_its_input(name: str, dtype: torch.dtype) -> None:
    given = sample(name, dtype)
    kept = given["it"].clone()
    out = tw.Compose({"it": ALL[name]}, p=1.0)(given, seed=2)
    assert out["it"].dtype == dtype
    assert torch.equal(given["it"], kept)
    assert out["rest"] is given["rest"]


@each
def test_without_weather_nothing_is_touched(name: str) -> None:
    given = sample(name)
    out = tw.Compose({"it": ALL[name]}, p=0.0)(given, seed=2)
    assert list(out) == list(given)
    assert all(out[key] is given[key] for key in given)


def test_banks_of_fog_are_the_same_for_two_cameras() -> None:
    camera = tw.BayerFog(FOG, CAMERA, airlight=0.7, effects=[{"effect": "camera.patchy_fog", "log_std": 0.8}])
    two = tw.Compose({"left": camera, "right": camera})
    image, depth = data("BayerFog"), torch.full((1, 24, 32), 60.0)
    seen = [two.run({"left": image, "right": image, "depth": depth}, seed=seed)[1] for seed in (1, 2)]
    assert torch.equal(seen[0]["left"].transmission, seen[0]["right"].transmission)
    assert not torch.equal(seen[0]["left"].transmission, seen[1]["left"].transmission)
