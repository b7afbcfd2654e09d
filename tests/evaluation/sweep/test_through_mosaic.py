"""RGB frames through the camera's mosaic: the clear frame goes the same way, and weather that fades costs nothing."""

from __future__ import annotations

import math

import torch

from torchweather.atmosphere.weather import Fog
from torchweather.evaluation.sweep import CameraSubject
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerWeather

CAMERA = Camera.from_intrinsics(200, 200, 99.5, 99.5, 200, 200)


def subject(**more: bool) -> CameraSubject:
    rgb = torch.rand(3, 200, 200, generator=torch.Generator().manual_seed(2))
    return CameraSubject("noise", rgb, torch.full((1, 200, 200), 20.0), CAMERA, options={"airlight": 0.6}, **more)


def test_the_clear_frame_takes_the_same_way() -> None:
    plain, mosaic = subject(), subject(through_mosaic=True)
    assert torch.equal(plain.reference, plain.data)
    wanted = AsBayer(BayerWeather(Fog(mor_m=50.0), CAMERA), through_mosaic=True).without_weather(mosaic.data)
    assert torch.equal(mosaic.reference, wanted)
    assert not torch.equal(mosaic.reference, mosaic.data)


def test_fading_fog_costs_nothing_either_way() -> None:
    for one in (subject(), subject(through_mosaic=True)):
        thin = one.score(one.render(Fog(mor_m=1e7), 0), ["psnr"])["psnr"]
        thick = one.score(one.render(Fog(mor_m=100.0), 0), ["psnr"])["psnr"]
        # 2e-5 of the light of a surface 20 m away: 80 dB and more. Against the frame as it came, a mosaic costs all but
        # some 20 dB of noise.
        assert thin > 80.0
        assert thick < 30.0
    assert math.isfinite(thin)
