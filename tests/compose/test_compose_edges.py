"""Compose at its edges: copies, what is lost without a word, keys and batches that do not fit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import torchweather as tw

CAMERA = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
LIDAR = tw.Lidar.preset("velodyne-hdl-64e")
COPIED = {"copy": copy.deepcopy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}


def cloud(number: int = 50) -> torch.Tensor:
    along = torch.randn(number, 3, generator=torch.Generator().manual_seed(1))
    return torch.cat([10.0 * along, torch.full((number, 1), 80.0)], -1)


def rainy(**more: Any) -> tw.Compose:
    return tw.Compose({"points": tw.LidarRain(tw.Rain(rate_mm_per_h=(5, 80)), LIDAR)}, **more)


def refused(match: str, action: Callable[[], Any], error: type[Exception] = ValueError) -> None:
    with pytest.raises(error, match=match):
        action()


class Named(list[dict[str, Any]]):
    """Samples with names, for Compose to tell apart."""

    def __init__(self, compose: tw.Compose) -> None:
        super().__init__({"points": cloud(), "token": k} for k in range(4))
        self.compose = compose

    def __getitem__(self, index: Any) -> Any:
        return self.compose(super().__getitem__(index))


@pytest.mark.parametrize("copied", COPIED.values(), ids=COPIED.keys())
def test_workers_of_a_copy_see_its_next_epoch(copied: Callable[[Any], Any]) -> None:
    compose = copied(rainy(seed=3, sample_key="token"))
    data = Named(compose)
    loader: DataLoader[Any] = DataLoader(
        data, num_workers=1, persistent_workers=True, multiprocessing_context="fork", prefetch_factor=1
    )
    for epoch in (0, 1):
        compose.set_epoch(epoch)
        found = torch.cat([batch["points"] for batch in loader])
        assert torch.equal(found, torch.stack([data[k]["points"] for k in range(4)]))
    data_set = copied(tw.WeatherDataset([{"points": cloud()}], rainy()))
    assert data_set._epoch.is_shared()


def test_a_copy_keeps_an_epoch_of_its_own() -> None:
    first = rainy(seed=3, sample_key="token")
    first.set_epoch(2)
    second = copy.deepcopy(first)
    second.set_epoch(5)
    assert (first.epoch, second.epoch) == (2, 5)


def test_numbers_that_were_changed_in_a_chain_are_not_lost_without_a_word() -> None:
    lidar = tw.LidarRain(tw.Rain(10.0), LIDAR)
    tw.Compose({"points": lidar})
    lidar.chain.stages["extinction"].parts["rain"].q_eff.mul_(1.1)
    refused("extinction.*q_eff was changed.*cannot be built anew", lambda: tw.Compose({"points": lidar}))
    refused("q_eff", lambda: lidar.with_weather(tw.Rain(20.0)))


def test_a_transform_moved_to_another_dtype_is_the_same_transform() -> None:
    lidar = tw.LidarRain(tw.Rain(10.0), LIDAR)
    wanted = tw.Compose({"points": lidar})({"points": cloud()}, seed=1)["points"]
    found = tw.Compose({"points": lidar.double()})({"points": cloud()}, seed=1)["points"]
    assert torch.equal(found, wanted)


def test_an_intensity_that_a_draw_cannot_hold_is_refused() -> None:
    fitted = tw.Rain(torch.tensor(20.0, requires_grad=True))
    refused("requires a gradient", lambda: tw.Compose({"points": tw.LidarRain(fitted, LIDAR)}))
    each = tw.Mixture(tw.Rain(torch.tensor([5.0, 50.0])), tw.Fog(mor_m=90.0))
    refused(r"tensor of shape \(2,\)", lambda: rainy(weather=[each, None]))
    assert rainy(weather=tw.Rain(torch.tensor(20.0)))({"points": cloud()}, seed=1)["points"].shape == (50, 4)


def test_as_bayer_takes_another_weather() -> None:
    camera = tw.AsBayer(
        tw.BayerRain(tw.Rain(10.0), CAMERA, airlight=0.7, depth=30.0), through_mosaic=True, method="bilinear"
    )
    image = torch.full((3, 24, 32), 0.3)
    fog = camera.with_weather(tw.Fog(mor_m=40.0))
    inner = tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, airlight=0.7, depth=30.0)
    wanted = tw.AsBayer(inner, through_mosaic=True, method="bilinear")
    assert torch.equal(fog(image), wanted(image))


def test_the_history_overwrites_nothing() -> None:
    refused("history='points' is the key of something else", lambda: rainy(history="points"))
    refused("history='beams'", lambda: rainy(history="beams", inputs={"points": {"directions": "beams"}}))
    compose = rainy(history="weather")
    once = compose({"points": cloud()}, seed=1)
    refused("holds 'weather' already.*Mixture", lambda: compose(once, seed=1))


def test_depth_of_another_batch_is_refused() -> None:
    camera = tw.Compose({"image": tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, airlight=0.7)})
    images = torch.full((2, 1, 24, 32), 0.3)
    shared = camera({"image": images, "depth": torch.full((1, 24, 32), 30.0)}, seed=1)["image"]
    each = camera({"image": images, "depth": torch.full((2, 1, 24, 32), 30.0)}, seed=1)["image"]
    assert torch.equal(shared, each)
    for number in (1, 3):
        depth = torch.full((number, 1, 24, 32), 30.0)
        refused(f"'depth'.*each of the 2.*got {number}", lambda d=depth: camera({"image": images, "depth": d}))
    refused("'depth'.*one sample .*got 2", lambda: camera({"image": images[0], "depth": torch.ones(2, 1, 24, 32)}))


def test_arguments_are_those_that_the_transform_takes() -> None:
    camera = tw.AsBayer(tw.BayerFog(tw.Fog(mor_m=40.0), CAMERA, airlight=0.7))
    refused("unknown argument 'normal'", lambda: tw.Compose({"i": camera}, inputs={"i": {"normal": "n"}}))
    refused("unknown argument 'depth'; known are directions", lambda: rainy(inputs={"points": {"depth": "d"}}))
    radar = tw.RadarAttenuation(tw.Rain(10.0), tw.Radar.preset("imaging-77ghz"))
    compose = tw.Compose({"radar": radar}, inputs={"radar": {"target_class": "classes"}})
    echoes = torch.tensor([[50.0, 0.0, 0.0, -3.0, -100.0, 10.0]])
    assert compose({"radar": echoes, "classes": torch.zeros(1)}, seed=1)["radar"].shape == (1, 6)


def test_an_array_that_torch_cannot_take_is_named() -> None:
    refused("'points' holds a numpy array.*byte order", lambda: rainy()({"points": np.ones((3, 4), ">f4")}), TypeError)


@pytest.mark.parametrize("batch", [None, 3])
def test_clear_images_go_through_the_mosaic_where_that_is_asked_for(batch: int | None) -> None:
    camera = tw.Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24)
    rain = tw.AsBayer(tw.BayerRain(tw.Rain(30.0), camera, depth=30.0, airlight=0.7), through_mosaic=True)
    rgb = torch.rand(3, 24, 32, generator=torch.Generator().manual_seed(1))
    given = {"image": rgb if batch is None else rgb.expand(batch, 3, 24, 32)}
    plain = tw.Compose({"image": rain}, p=0.0)
    assert torch.equal(plain(given, seed=1)["image"], given["image"])
    out = tw.Compose({"image": rain}, p=0.0, mosaic_clear=True)(given, seed=1)["image"]
    # Rain of rate 0 with one changed pixel would go through the same mosaic.
    assert torch.equal(out, rain.without_weather(given["image"]))
    assert 0.01 < float((out - given["image"]).abs().mean()) < 0.5
    white = torch.full((3, 24, 32), 0.5)
    torch.testing.assert_close(rain.without_weather(white), white, rtol=0.0, atol=1e-5)  # evenly lit stays as it was
