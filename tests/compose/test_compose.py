"""Compose: one weather on all sensors of a sample, particles of its own before each, the same for the same seed."""

from __future__ import annotations

import copy
import json
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.compose.compose import Draw
from torchweather.core.random import derived_seed, sample_seed

CAMERA = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
LIDAR = tw.Lidar.preset("velodyne-hdl-64e")
RADAR = tw.Radar.preset("imaging-77ghz")


def sample(seed: int = 0) -> dict[str, Any]:
    draw = torch.Generator().manual_seed(seed)
    along = torch.nn.functional.normalize(torch.randn(200, 3, generator=draw), dim=-1)
    points = torch.cat([along * (5 + 40 * torch.rand(200, 1, generator=draw)), torch.full((200, 1), 90.0)], -1)
    detections = torch.tensor([[50.0, 0.0, 0.0, -3.0, -100.0, 10.0], [20.0, 5.0, 0.0, 1.0, -95.0, 0.0]])
    return {
        "image": 0.1 + 0.5 * torch.rand(1, 24, 32, generator=draw),
        "depth": torch.full((1, 24, 32), 30.0),
        "points": points,
        "radar": detections,
        "token": f"sample-{seed}",
    }


def transforms(weather: tw.Rain | tw.Fog | None = None) -> dict[str, Any]:
    own = weather or tw.Rain(10.0)
    return {
        "image": tw.BayerWeather(own, CAMERA, airlight=0.7),
        "points": tw.LidarWeather(own, LIDAR),
        "radar": tw.RadarAttenuation(own, RADAR),
    }


def stormy(**more: Any) -> tw.Compose:
    return tw.Compose(transforms(), weather=tw.Rain(rate_mm_per_h=(5, 80)), history="history", **more)


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return all(torch.equal(a[key], b[key]) for key in ("image", "points", "radar"))


# ---- one weather -----------------------------------------------------------------------------------------------------


def test_every_sensor_gets_what_its_own_transform_gives_in_the_weather_that_was_drawn() -> None:
    given = sample()
    out = stormy()(given, seed=11)
    rain = tw.Rain(out["history"]["weather"]["rate_mm_per_h"])
    image = tw.BayerRain(rain, CAMERA, airlight=0.7)
    noise = image.draw(given["image"], seed=derived_seed(11, "image"))
    assert torch.equal(out["image"], image(given["image"], given["depth"], noise))
    points = tw.LidarRain(rain, LIDAR)
    wanted = points(given["points"], points.draw(given["points"], seed=derived_seed(11, "points")))
    assert torch.equal(out["points"], wanted)
    assert torch.equal(out["radar"], tw.RadarAttenuation(rain, RADAR)(given["radar"]))
    assert not torch.equal(out["radar"], given["radar"])


def test_the_input_is_left_as_it_was_and_unknown_keys_pass_through() -> None:
    given = sample()
    before = copy.deepcopy(given)
    out = stormy()(given, seed=1)
    assert list(given) == list(before)
    assert all(torch.equal(given[key], before[key]) for key in before if key != "token")
    assert out["token"] is given["token"]
    assert out["depth"] is given["depth"]


def test_two_cameras_of_one_sample_see_other_drops_of_the_same_rain() -> None:
    camera = tw.BayerRain(tw.Rain(40.0), CAMERA, depth=30.0, airlight=0.7)
    both = tw.Compose({"left": camera, "right": camera})
    frame = sample()["image"]
    out, results = both.run({"left": frame, "right": frame}, seed=3)
    assert not torch.equal(out["left"], out["right"])
    masks = [results[key].particle_mask.mean() for key in ("left", "right")]
    assert masks[0] == pytest.approx(float(masks[1]), rel=1.0)


def test_gusts_are_of_the_air_and_not_of_a_sensor() -> None:
    weather = tw.Mixture(tw.Snow(5.0), tw.Fog(mor_m=60.0))

    def lidar() -> tw.LidarWeather:
        return tw.LidarWeather(weather, LIDAR, effects=[{"effect": "lidar.patchy_weather", "log_std": 0.8}])

    both = tw.Compose({"front": lidar(), "rear": lidar()})
    cloud = sample()["points"]
    found = []
    for seed in (1, 2):
        _, results = both.run({"front": cloud, "rear": cloud}, seed=seed)
        front, rear = results["front"], results["rear"]
        assert torch.equal(front.transmission, rear.transmission)
        assert not torch.equal(front.points, rear.points)
        found.append(float(front.transmission.mean()))
    assert abs(found[0] - found[1]) > 0.01


def densities(fog: tw.Fog, seed: int) -> list[tuple[float, float, float]]:
    """Mean density of the fog on the way to three places, as camera, LiDAR and radar of one sample see it."""
    range_m, azimuth = torch.tensor([12.0, 25.0, 40.0]), torch.tensor([0.1, -0.12, 0.05])
    x, y = range_m * azimuth.cos(), range_m * azimuth.sin()
    nothing = torch.zeros(3)
    column = (15.5 - 100.0 * y / x).round().long()
    depth = torch.full((1, 24, 32), 1000.0)
    depth[0, :, column] = x
    given = {
        "image": torch.full((1, 24, 32), 0.3),
        "depth": depth,
        "points": torch.stack([x, y, nothing, nothing + 200.0], -1),
        "radar": torch.stack([x, y, nothing, nothing, nothing - 60.0, nothing + 10.0], -1),
    }
    compose = tw.Compose(transforms(), weather=fog)
    _, results = compose.run(given, seed=seed)
    even = transforms(tw.Fog(mor_m=fog.mor_m))
    alpha = even["image"].chain.stages["extinction_and_airlight"].extinction_per_m(1)[0, 1]  # green
    found = []
    for place in range(3):
        row = 11 if (int(column[place]) + 11) % 2 else 12  # a green pixel of RGGB
        ray_m = depth[0, row, column[place]] * math.hypot(1.0, (15.5 - float(column[place])) / 100.0)
        found.append(
            (
                float(-results["image"].transmission[0, row, column[place]].log() / (alpha * ray_m)),
                float(-0.5 * results["points"].transmission[place].log() / even["points"].extinction_per_m)
                / float(range_m[place]),
                float(results["radar"].attenuation_db[place] / even["radar"].attenuation_db_per_km)
                / (2e-3 * float(range_m[place])),
            )
        )
    return found


def test_camera_lidar_and_radar_look_into_the_same_patches() -> None:
    fog = tw.Fog(mor_m=80.0, patch_log_std=0.7, patch_length_m=10.0)
    seen = [one for seed in (1, 2, 3) for one in densities(fog, seed)]
    for camera, lidar, radar in seen:
        # The pixel's own azimuth is up to half a pixel, 0.005 rad, beside the others'.
        assert camera == pytest.approx(lidar, rel=0.02)
        assert radar == pytest.approx(lidar, rel=1e-3)
    lidars = np.array([lidar for _, lidar, _ in seen])
    assert lidars.std() > 0.2  # from place to place and sample to sample


def test_the_patches_of_a_sample_are_its_own_and_come_again() -> None:
    fog = tw.Fog(mor_m=80.0, patch_log_std=0.7, patch_length_m=10.0)
    assert densities(fog, 5) == densities(fog, 5)
    assert densities(fog, 5) != densities(fog, 6)
    spread = tw.Compose(transforms(), weather=tw.Fog(mor_m=80.0, patch_log_std=tw.Uniform(0.1, 0.9)))
    drawn = [spread.draw(sample(), seed=seed).weather["patch_log_std"] for seed in range(5)]
    assert len(set(drawn)) == 5
    assert all(0.1 <= one <= 0.9 for one in drawn)


def test_without_a_weather_of_its_own_it_takes_that_of_the_transforms() -> None:
    plain = tw.Compose(transforms(tw.Rain(33.0)), history="history")
    assert plain(sample(), seed=1)["history"]["weather"]["rate_mm_per_h"] == 33.0
    lidar = tw.LidarFog(tw.Fog(mor_m=tw.LogUniform(50, 100)), LIDAR)
    assert 50 < tw.Compose({"points": lidar}).draw(sample(), seed=1).weather["mor_m"] < 100


def test_a_weather_of_another_kind_takes_the_transform_that_takes_all() -> None:
    rain = tw.BayerRain(tw.Rain(10.0), CAMERA, airlight=0.7, near_m=2.0)
    either = tw.Compose({"image": rain}, weather=[tw.Fog(mor_m=40.0), None], history="history")
    given = sample()
    fog = tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, airlight=0.7)(given["image"], given["depth"])
    kinds = set()
    for seed in range(12):
        out = either(given, seed=seed)
        drawn = out["history"]["weather"]
        kinds.add(None if drawn is None else drawn["kind"])
        assert torch.equal(out["image"], given["image"] if drawn is None else fog)
    assert kinds == {None, "fog"}


def test_options_of_a_transform_hold_in_every_weather() -> None:
    given = tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, near_m=3.0, far_m=50.0, depth=30.0, airlight=0.6)
    rain = given.with_weather(tw.Rain(20.0))
    plain = tw.BayerWeather(tw.Rain(20.0), CAMERA, near_m=3.0, far_m=50.0, depth=30.0, airlight=0.6)
    frame = sample()["image"]
    assert torch.equal(rain(frame, noise=rain.draw(frame, seed=1)), plain(frame, noise=plain.draw(frame, seed=1)))


# ---- drawing ---------------------------------------------------------------------------------------------------------


def test_rates_and_shares_are_those_that_were_asked_for() -> None:
    some = tw.Compose({"points": tw.LidarRain(tw.Rain((5, 80)), LIDAR)}, p=0.3)
    number = 2000
    draws = [some.draw({"points": torch.zeros(1, 4)}, seed=seed) for seed in range(number)]
    rates = np.array([draw.weather["rate_mm_per_h"] for draw in draws if draw.weather is not None])
    # Four standard deviations of a binomial share, and of the mean and variance of a uniform law.
    assert len(rates) / number == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / number))
    spread = 75 / math.sqrt(12)
    assert rates.mean() == pytest.approx(42.5, abs=4 * spread / math.sqrt(len(rates)))
    assert rates.var() == pytest.approx(spread**2, rel=4 * math.sqrt(0.8 / len(rates)))


def test_the_same_seed_gives_the_same_sample_and_another_one_another() -> None:
    given = sample()
    assert same(stormy()(given, seed=5), stormy()(given, seed=5))
    assert not same(stormy()(given, seed=5), stormy()(given, seed=6))


def test_a_generator_or_torch_s_own_gives_the_seed() -> None:
    given, compose = sample(), stormy()
    a, b = (compose.draw(given, generator=torch.Generator().manual_seed(4)) for _ in range(2))
    assert a == b
    torch.manual_seed(4)
    assert compose.draw(given) == a


def test_a_draw_goes_through_json_and_gives_the_same_again() -> None:
    given, compose = sample(), stormy()
    out = compose(given, seed=8)
    again = Draw.from_dict(json.loads(json.dumps(out["history"])))
    assert same(compose(given, draw=again), out)
    assert same(tw.Compose(transforms())(given, draw=again), out)


def test_the_sample_s_own_name_and_the_epoch_decide() -> None:
    named = tw.Compose(transforms(), weather=tw.Rain((5, 80)), seed=3, sample_key="token")
    given = sample()
    first = named(given)
    assert same(named(given), first)
    assert named.draw(given).seed == sample_seed(3, "sample-0", 0)
    assert named.draw({**given, "token": "another"}) != named.draw(given)
    named.set_epoch(1)
    assert not same(named(given), first)
    named.set_epoch(0)
    assert same(named(given), first)


def test_p_0_gives_the_sample_back() -> None:
    given = sample()
    out, results = stormy(p=0.0).run(given, seed=1)
    assert results == {}
    assert all(out[key] is given[key] for key in given)
    assert out["history"]["weather"] is None


# ---- batches, numpy, copies ------------------------------------------------------------------------------------------


def stacked(samples: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        key: torch.stack([one[key] for one in samples]) if isinstance(samples[0][key], Tensor) else list(samples)
        for key in samples[0]
    }


def test_a_batch_is_its_elements_each_with_a_weather_of_its_own() -> None:
    samples = [sample(seed) for seed in range(3)]
    compose = stormy(p=0.7)
    out = compose(stacked(samples), seed=20)
    for k, one in enumerate(samples):
        alone = compose(one, seed=20 + k)
        assert out["history"][k] == alone["history"]
        for key in ("image", "points", "radar"):
            assert torch.equal(out[key][k], alone[key])
    assert len({str(one["weather"]) for one in out["history"]}) > 1


def test_clouds_of_different_lengths_are_a_list() -> None:
    clouds = [sample(0)["points"], sample(1)["points"][:50]]
    compose = tw.Compose({"points": tw.LidarRain(tw.Rain(20.0), LIDAR, lost="drop")})
    out = compose({"points": clouds}, seed=1)
    assert isinstance(out["points"], list)
    assert torch.equal(out["points"][1], compose({"points": clouds[1]}, seed=2)["points"])


def test_numpy_arrays_come_back_as_numpy_arrays() -> None:
    given = sample()
    arrays = {key: value.numpy() if isinstance(value, Tensor) else value for key, value in given.items()}
    arrays["points"].flags.writeable = False
    out, wanted = stormy()(arrays, seed=2), stormy()(given, seed=2)
    for key in ("image", "points", "radar"):
        assert isinstance(out[key], np.ndarray)
        np.testing.assert_array_equal(out[key], wanted[key].numpy())


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
def test_a_copy_gives_the_same(copied: Callable[[Any], Any]) -> None:
    given, compose = sample(), stormy()
    out = compose(given, seed=2)
    assert same(copied(compose)(given, seed=2), out)


def test_directions_of_beams_without_return_are_an_input() -> None:
    lidar = tw.LidarFog(tw.Fog(mor_m=20.0), LIDAR)
    points = torch.zeros(300, 4)
    along = torch.nn.functional.normalize(torch.randn(300, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    compose = tw.Compose({"points": lidar}, inputs={"points": {"directions": "beams"}})
    out, results = compose.run({"points": points, "beams": along}, seed=1)
    assert int((results["points"].kind == tw.PointKind.PARTICLE).sum()) > 50
    assert torch.equal(out["points"], results["points"].points)


# ---- in the pipelines of others --------------------------------------------------------------------------------------


class ComposeOfTorchvision:
    """What ``torchvision.transforms.v2.Compose`` documents: each transform is called with what the last one gave."""

    def __init__(self, transforms: list[Callable[..., Any]]) -> None:
        self.transforms = transforms

    def __call__(self, *inputs: Any) -> Any:
        needs_unpacking = len(inputs) > 1
        for transform in self.transforms:
            outputs = transform(*inputs)
            inputs = outputs if needs_unpacking else (outputs,)
        return outputs


def test_in_a_pipeline_of_torchvision_and_after_kornia() -> None:
    from kornia.augmentation import RandomHorizontalFlip

    flip = RandomHorizontalFlip(p=1.0, keepdim=True)
    camera = tw.AsBayer(tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, airlight=0.7))
    foggy = tw.Compose({"image": camera}, seed=1, sample_key="token")
    rgb = torch.rand(3, 24, 32, generator=torch.Generator().manual_seed(0))
    given = {"image": rgb, "depth": sample()["depth"], "token": 5}
    pipeline = ComposeOfTorchvision([lambda one: {**one, "image": flip(one["image"])}, foggy])
    out = pipeline(given)
    assert torch.equal(out["image"], camera(rgb.flip(-1), given["depth"]))


# ---- what is refused -------------------------------------------------------------------------------------------------


def refused(match: str, action: Callable[[], Any], error: type[Exception] = ValueError) -> None:
    with pytest.raises(error, match=match):
        action()


def test_a_missing_key_is_named_with_what_is_there() -> None:
    given = sample()
    given["point"] = given.pop("points")
    refused(r"lacks 'points'; it has image, depth, radar, token, point\. Did you mean 'point'", lambda: stormy()(given))
    refused("sample must be a dictionary", lambda: stormy()(given["image"]), TypeError)


def test_data_of_different_batches_are_refused() -> None:
    given = {**stacked([sample(0), sample(1)]), "radar": sample()["radar"]}
    refused("'image': 2 samples, 'points': 2 samples, 'radar': one sample", lambda: stormy()(given))


def test_two_weathers_for_one_key_are_a_mixture() -> None:
    lidar = transforms()["points"]
    refused(r"Mixture\(", lambda: tw.Compose({"points": [lidar, lidar]}))
    refused("Mixture", lambda: tw.Compose({"points": tw.Compose({"points": lidar})}))


def test_what_is_no_weather_and_no_transform_is_refused() -> None:
    lidar = transforms()["points"]
    refused("'points': expected a transform of weather", lambda: tw.Compose({"points": torch.nn.ReLU()}), TypeError)
    refused("weather must be Rain", lambda: tw.Compose({"points": lidar}, weather=["rain"]), TypeError)
    refused("at least one key", lambda: tw.Compose({}))
    refused("p must lie", lambda: tw.Compose({"points": lidar}, p=1.5))
    refused("seed needs sample_key", lambda: tw.Compose({"points": lidar}, seed=1))
    refused(
        "inputs of 'points': unknown argument 'direction'.*directions",
        lambda: tw.Compose({"points": lidar}, inputs={"points": {"direction": "beams"}}),
    )
    fog = tw.LidarFog(tw.Fog(mor_m=50.0), LIDAR)
    refused("see one weather.*Say which with weather=", lambda: tw.Compose({"points": lidar, "rear": fog}))
    refused("expected a draw for each of 1", lambda: stormy()(sample(), draw=[Draw(1, None)] * 2))
    refused("expected seed and weather", lambda: Draw.from_dict({"seed": 1}))


def test_a_chain_that_was_changed_by_hand_is_refused() -> None:
    lidar = transforms()["points"]
    effect = tw.stages.effect_from_dict({"effect": "lidar.window_loss", "loss_db": 1.0})
    lidar.chain = lidar.chain.insert(effect, after="particle_returns")
    refused("cannot be built anew", lambda: tw.Compose({"points": lidar}))


def test_noise_alone_does_not_say_which_weather_was_drawn() -> None:
    lidar = tw.LidarRain(tw.Rain(rate_mm_per_h=(1, 50)), LIDAR)
    points = sample()["points"]
    noise = lidar.draw(points, seed=1)
    refused(r"rate_mm_per_h must be a number here; got Uniform.*without noise", lambda: lidar(points, noise))


def test_a_lidar_is_renewed_for_another_rate_and_built_for_another_weather() -> None:
    sensor = tw.Lidar.preset("velodyne-vlp-16")
    points = torch.rand(3000, 4, generator=torch.Generator().manual_seed(2)) * torch.tensor([40.0, 40.0, 1.0, 255.0])
    weathers = [tw.Rain(5.0), tw.Rain(50.0), tw.Rain(5.0, temperature_c=20.0), tw.Snow(1.0), tw.Snow(2.0)]
    weathers.append(tw.Mixture(tw.Rain(5.0), tw.Fog(mor_m=80.0)))
    lidar = tw.LidarWeather(tw.Rain(50.0), sensor)
    compose = tw.Compose({"points": lidar}, weather=tw.Choice(weathers))
    for weather in (*weathers, *weathers[::-1]):
        draw = Draw(5, weather.to_dict())
        alone = tw.Compose({"points": lidar}, weather=weather)({"points": points}, draw=draw)
        assert torch.equal(compose({"points": points}, draw=draw)["points"], alone["points"])
    shared = [built.chain.stages["detection"] for built in compose._built.values()]
    assert len(shared) == len(weathers)
    assert len(set(map(id, shared))) == len(weathers) - 2  # rain at 50 mm/h and snow at 2 mm/h share all else
