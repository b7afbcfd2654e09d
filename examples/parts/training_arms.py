"""Ways to bring weather into training: none, colours alone, other libraries, ten naive lines, this library."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import kornia
import numpy as np
import torch
from parts.lidar_segmenter import SENSOR, WEATHER
from parts.training_data import relabelled
from torch import Tensor

import torchweather as tw
from torchweather.recipes import load_recipe

Arm = Callable[[Tensor, Tensor, int], Tensor]
"""Picture ``(3, H, W)`` uint8, depth ``(1, H, W)`` in metres and a seed to the picture in weather."""

# What the library is trained on; a third stays clear.
TRAINED_ON = tw.Choice(
    [
        None,
        tw.Rain(rate_mm_per_h=tw.LogUniform(2, 50)),
        tw.Fog(mor_m=tw.LogUniform(40, 500)),
        tw.Snow(rate_mm_per_h=tw.LogUniform(0.3, 3)),
    ],
    weights=[3, 2, 2, 2],
)
KINDS, SHARES = ("clear", "rain", "fog", "snow"), (3 / 9, 2 / 9, 2 / 9, 2 / 9)


# ---- arms without physics ------------------------------------------------------------------------------------------


def none(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
    return picture


def photometric(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
    """Contrast, brightness, gamma, colour, blur and noise."""
    draw = np.random.default_rng(seed)
    x = (picture / 255) ** float(draw.uniform(0.7, 1.5))
    x = (x - 0.5) * float(draw.uniform(0.5, 1.3)) + 0.5 + float(draw.uniform(-0.2, 0.2))
    x = x * torch.tensor(draw.uniform(0.85, 1.15, (3, 1, 1)), dtype=torch.float32)
    if draw.random() < 0.3:
        x = kornia.filters.gaussian_blur2d(x[None], 5, (1.2, 1.2))[0]
    x = x + float(draw.uniform(0, 0.05)) * torch.from_numpy(draw.normal(size=x.shape).astype(np.float32))
    return (255 * x.clamp(0, 1)).round().byte()


def of_kornia(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
    """Rain and snow of kornia, which has no fog; its options are those of its documentation."""
    kind = np.random.default_rng(seed).choice(KINDS, p=SHARES)
    if kind == "clear":
        return picture
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        rain = kornia.augmentation.RandomRain(
            p=1.0, number_of_drops=(500, 1500), drop_height=(5, 15), drop_width=(-3, 3)
        )
        snow = kornia.augmentation.RandomSnow(p=1.0, snow_coefficient=(0.2, 0.6), brightness=(1.2, 2.5))
        return (255 * (snow if kind == "snow" else rain)(picture[None] / 255)[0].clamp(0, 1)).round().byte()


def of_albumentations(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
    """Rain, fog and snow of albumentations, with its defaults."""
    import albumentations

    kind = np.random.default_rng(seed).choice(KINDS, p=SHARES)
    if kind == "clear":
        return picture
    made = {"rain": albumentations.RandomRain, "fog": albumentations.RandomFog, "snow": albumentations.RandomSnow}[kind]
    changed = albumentations.Compose([made(p=1.0)], seed=seed)(image=picture.permute(1, 2, 0).numpy())["image"]
    return torch.from_numpy(changed).permute(2, 0, 1)


def naive(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
    """Ten lines: fog by depth into a grey that is drawn; white streaks or dots anywhere."""
    draw = np.random.default_rng(seed)
    kind, x = draw.choice(KINDS, p=SHARES), picture / 255
    if kind == "clear":
        return picture
    visibility_m = math.exp(
        draw.uniform(math.log(40 if kind == "fog" else 300), math.log(500 if kind == "fog" else 3000))
    )
    air, through = draw.uniform(0.3, 0.95), torch.exp(-3 * depth / visibility_m)
    x = x * through + air * (1 - through)
    if kind != "fog":
        mask = np.zeros(depth.shape[-2:], np.float32)
        for row, column in draw.integers(0, mask.shape, (draw.integers(100, 1500), 2)):
            mask[row : row + (draw.integers(3, 15) if kind == "rain" else 2), column : column + draw.integers(1, 3)] = 1
        x = x + torch.from_numpy(mask) * (draw.uniform(0.4, 1.0) - x) * draw.uniform(0.2, 0.8)
    return (255 * x.clamp(0, 1)).round().byte()


# ---- arms with physics ---------------------------------------------------------------------------------------------


def library(camera: tw.Camera) -> Arm:
    """Weather of a drawn rate; everything else as the library has it."""
    return composed(tw.Compose({"image": tw.AsBayer(tw.BayerWeather(None, camera))}, weather=TRAINED_ON))


def drawn(camera: tw.Camera, **changes: Any) -> Arm:
    """The recipe that draws what is not known as well."""
    return composed(load_recipe("training/camera", transforms={"image": {"sensor": camera, **changes}}))


def composed(compose: Any) -> Arm:
    def put(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
        return compose({"image": picture, "depth": depth}, seed=seed)["image"]  # type: ignore[no-any-return]

    return put


def other_sizes(camera: tw.Camera) -> Arm:
    """The recipe with fewer and larger drops: those of a thunderstorm (Joss et al. 1968)."""
    known = load_recipe("training/camera").weather
    weathers = [
        replace(one, size_distribution="thunderstorm") if isinstance(one, tw.Rain) else one for one in known.values
    ]
    weather = tw.Choice(weathers, known.weights)
    return composed(load_recipe("training/camera", weather=weather, transforms={"image": {"sensor": camera}}))


def flat(compose_of: Callable[..., Arm], camera: tw.Camera) -> Arm:
    """An arm whose rain and snow see no surface in front of them: particles pass through everything."""
    arm, fogless = compose_of(camera), load_recipe("training/camera", transforms={"image": {"sensor": camera}})

    def put(picture: Tensor, depth: Tensor, seed: int) -> Tensor:
        draw = fogless.draw({"image": picture, "depth": depth}, seed=seed)
        kind = draw.weather and draw.weather["kind"]
        return arm(picture, torch.full_like(depth, 300.0) if kind in ("rain", "snow") else depth, seed)

    return put


def picture_arms(camera: tw.Camera, ablate: bool) -> dict[str, Arm]:
    """Arms by name; those whose library is not installed are named and left out."""
    arms: dict[str, Arm] = {"none": none, "photometric": photometric, "kornia": of_kornia}
    if importlib.util.find_spec("albumentations") is None:
        print("albumentations is not installed: its arm is left out", flush=True)
    else:
        arms["albumentations"] = of_albumentations
    arms |= {"naive": naive, "library": library(camera), "library, drawn": drawn(camera)}
    if ablate:
        short = tw.Camera.from_dict({**camera.to_dict(), "exposure_s": 2e-4})
        arms |= {
            "drawn, airlight of the frame": drawn(camera, airlight=None),
            "drawn, no streaks": drawn(short),
            "drawn, no depth test": flat(drawn, camera),
            "drawn, no veil": drawn(camera, far_m=6.0),
            "drawn, other sizes": other_sizes(camera),
        }
    return arms


# ---- clouds --------------------------------------------------------------------------------------------------------

SNOW = tw.Choice([None, tw.Snow(rate_mm_per_h=tw.LogUniform(0.3, 3))], weights=[1, 2])
INPUTS = {"points": {"directions": "beams"}}


def naive_snow(sample: dict[str, Any], seed: int) -> dict[str, Any]:
    """Three lines: a drawn share of the beams returns dimly from a drawn short range."""
    draw = np.random.default_rng(seed)
    near = torch.from_numpy(draw.exponential(draw.uniform(2, 12), len(sample["points"])).astype(np.float32))
    hit = torch.from_numpy(draw.random(len(near)) < draw.uniform(0, 0.3)) & (near > 1)
    points, classes = sample["points"].clone(), torch.where(hit, WEATHER, sample["classes"])
    points[hit, :3], points[hit, 3] = (
        (sample["beams"] * near[:, None])[hit],
        torch.floor(20 * torch.rand(int(hit.sum()))),
    )
    return {**sample, "points": points, "classes": classes}


def snow_recipe(sensor: tw.Lidar, inputs: Mapping[str, Any]) -> tw.Compose:
    """The snow of the recipe that draws what is not known, with its near response in place of the sensor's."""
    weather = next(one for one in load_recipe("training/lidar").weather.values if isinstance(one, tw.Snow))
    fields = {name: value for name, value in sensor.to_dict().items() if name not in ("near_start_m", "near_full_m")}
    compose: tw.Compose = load_recipe(
        "training/lidar",
        weather=tw.Choice([None, weather], weights=[1, 2]),
        transforms={"points": {"sensor": fields}},
        inputs=inputs,
    )
    return compose


def drawn_snow(sensor: tw.Lidar, inputs: Mapping[str, Any]) -> Callable[[dict[str, Any], int], dict[str, Any]]:
    compose = snow_recipe(sensor, inputs)
    return lambda sample, seed: relabelled(*compose.run(sample, seed=seed))


def cloud_arms() -> dict[str, Callable[[dict[str, Any], int], dict[str, Any]]]:
    """Arms of the LiDAR by name."""
    plain = tw.Compose({"points": tw.LidarWeather(None, SENSOR)}, weather=SNOW, inputs=INPUTS)
    return {
        "naive": naive_snow,
        "library": lambda sample, seed: relabelled(*plain.run(sample, seed=seed)),
        "library, drawn": drawn_snow(SENSOR, INPUTS),
    }
