"""The border of the camera transforms: raw levels, depth, noise, and every kind of bad input."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.levels import raw_from_linear, raw_to_linear
from torchweather.core.errors import TorchweatherWarning
from torchweather.image.depth import FlatGround
from torchweather.sensors import Camera
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

H, W = 24, 32
CAMERA = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H)
RAIN = BayerRain(Rain(20.0), CAMERA, airlight=0.7, far_m=30.0)
FOG = BayerFog(Fog(50.0), CAMERA, airlight=0.7)


def frame(*batch: int) -> Tensor:
    return torch.full((*batch, 1, H, W), 0.2)


def depth(value: float = 20.0) -> Tensor:
    return torch.full((1, H, W), value)


# ---- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transform", [RAIN, FOG], ids=["rain", "fog"])
@pytest.mark.parametrize(
    ("bayer", "kind", "wanted"),
    [
        ([[0.2]], TypeError, "bayer must be a torch.Tensor (..., 1, H, W); got list"),
        (torch.zeros(H, W), ValueError, "bayer must have shape (..., 1, H, W); got (24, 32)"),
        (torch.zeros(3, H, W), ValueError, "got (3, 24, 32). For RGB images use AsBayer(transform)"),
        (torch.zeros(1, 23, W), ValueError, "H and W of a Bayer mosaic must be even; got 23 x 32. Crop the frame, or use AsBayer"),  # noqa: E501
        (torch.zeros(1, 1, 1), ValueError, "must be even; got 1 x 1"),
        (torch.zeros(1, 12, 16), ValueError, "the frame is 12 x 16 px, the camera 24 x 32. Use camera.resized(width, height)"),  # noqa: E501
        (torch.zeros(1, H, W, dtype=torch.int64), TypeError, "bayer must be uint8, uint16 or float in 0..1; got torch.int64"),  # noqa: E501
        (torch.zeros(1, H, W, dtype=torch.bool), TypeError, "got torch.bool"),
        (torch.zeros(1, H, W, dtype=torch.complex64), TypeError, "got torch.complex64"),
        (torch.full((1, H, W), 300.0), ValueError, "the frame contradicts its description: expected values up to 1 (float frames run from 0 to 1), without NaN; got up to 300"),  # noqa: E501
        (torch.full((1, H, W), math.nan), ValueError, "without NaN; got up to nan"),
        (torch.full((1, H, W), math.inf), ValueError, "got up to inf"),
        (torch.full((1, H, W), -0.1), ValueError, "float frames must lie in 0..1; got -0.1. Subtract the black level and clip"),  # noqa: E501
        (torch.full((1, H, W), 5000).to(torch.uint16), ValueError, "expected values up to 4095, without NaN; got up to 5000. Set Camera(bit_depth=..., white_level=...)"),  # noqa: E501
    ],
    ids=lambda value: None,
)  # fmt: skip
def test_frames_that_are_no_mosaic_are_refused(
    transform: BayerWeather, bayer: Any, kind: type[Exception], wanted: str
) -> None:
    message = re.escape(wanted)
    with pytest.raises(kind, match=message) as caught:
        transform(bayer, depth())
    assert str(caught.value).startswith(type(transform).__name__)


@pytest.mark.parametrize("transform", [RAIN, FOG], ids=["rain", "fog"])
@pytest.mark.parametrize(
    ("wrong", "kind", "wanted"),
    [
        (20.0, TypeError, "depth must be a tensor (..., 1, H, W) in metres or a SceneDepth; got float. A number or a depth source goes to the constructor"),  # noqa: E501
        (torch.full((H, W), 20.0), ValueError, "depth must have shape (..., 1, 24, 32), metres; got (24, 32)"),
        (torch.full((1, 12, 16), 20.0), ValueError, "depth must have shape (..., 1, 24, 32), metres; got (1, 12, 16)"),
        (torch.full((3, 1, H, W), 20.0), ValueError, "depth (3, 1, 24, 32) does not fit the frame (2, 1, 24, 32)"),
        (torch.full((1, H, W), 20), TypeError, "depth must be floating point, metres; got torch.int64"),
        (torch.full((1, H, W), math.nan), ValueError, "got 768 NaN, 0 negative and 0 zero of 768 pixels"),
        (torch.full((1, H, W), -1.0), ValueError, "got 0 NaN, 768 negative and 0 zero of 768 pixels"),
        (torch.full((1, H, W), -math.inf), ValueError, "above 0 m along the optical axis, inf for sky"),
    ],
    ids=lambda value: None,
)  # fmt: skip
def test_depths_that_are_none_are_refused(
    transform: BayerWeather, wrong: Any, kind: type[Exception], wanted: str
) -> None:
    with pytest.raises(kind, match=re.escape(wanted)):
        transform(frame(2), wrong)


def test_without_any_depth_the_message_says_where_to_give_it() -> None:
    with pytest.raises(
        ValueError, match=r"BayerFog: no depth. Give forward\(bayer, depth\) .* or the constructor a source"
    ):
        FOG(frame())


@pytest.mark.parametrize(
    ("build", "kind", "wanted"),
    [
        (lambda: BayerRain(Fog(50.0), CAMERA), TypeError, "BayerRain: takes rain; got fog. BayerWeather takes all"),
        (lambda: BayerFog(Mixture(Fog(50.0), Rain(2.0)), CAMERA), TypeError, "BayerFog: takes fog; got rain"),
        (lambda: BayerSnow(25.0, CAMERA), TypeError, "BayerSnow: weather must be Rain, Fog, Snow or a Mixture, such as Rain(rate_mm_per_h=10); got 25.0"),  # type: ignore[arg-type]  # noqa: E501
        (lambda: BayerRain(Rain(5.0), "lucid-triton"), TypeError, "camera must be a Camera, such as Camera.preset('lucid-triton')"),  # type: ignore[arg-type]  # noqa: E501
        (lambda: BayerFog(Fog(50.0), CAMERA, extinction="mee"), ValueError, "extinction must be one of mie, koschmieder; got 'mee'"),  # noqa: E501
        (lambda: BayerFog(Fog(50.0), CAMERA, variant="d34"), ValueError, "variant must be one of d3_4; got 'd34'"),
        (lambda: BayerRain(Rain(5.0), CAMERA, airlight=2.0), ValueError, "BayerRain: airlight must be one number or (red, green, blue) in 0..1"),  # noqa: E501
    ],
    ids=lambda value: None,
)  # fmt: skip
def test_wrong_constructor_arguments_are_refused(build: Any, kind: type[Exception], wanted: str) -> None:
    with pytest.raises(kind, match=re.escape(wanted)):
        build()


def test_an_intensity_of_another_shape_than_the_batch_is_refused() -> None:
    fog = BayerFog(Fog(torch.tensor([20.0, 50.0])), CAMERA, depth=20.0, airlight=0.7)
    assert fog(frame(2)).shape == (2, 1, H, W)
    for batch in ((), (3,), (2, 2)):
        with pytest.raises(
            ValueError, match=r"mor_m must be one value or one for each sample, shape .*; got shape \(2,\)"
        ):
            fog(frame(*batch))


def test_noise_of_another_weather_or_batch_is_refused() -> None:
    noise = RAIN.draw(frame(2), seed=1)
    snow = BayerSnow(Snow(1.0), CAMERA, airlight=0.7)
    with pytest.raises(
        ValueError, match=r"BayerSnow: the noise is of another transform: it (holds|lacks) particle_veil\."
    ):
        snow(frame(2), depth(), noise)
    with pytest.raises(
        ValueError, match=r"must hold .* for each sample of the batch \(3,\); got \(2, .* Use what draw"
    ):
        RAIN(frame(3), depth(), noise)


def test_drawing_checks_its_frame_and_seed() -> None:
    with pytest.raises(ValueError, match=r"the camera 24 x 32"):
        RAIN.draw(torch.zeros(1, 12, 16))
    with pytest.raises(ValueError, match=r"either seed or generator"):
        RAIN.draw(frame(), generator=torch.Generator(), seed=1)
    with pytest.raises(ValueError, match=r"seed must be one integer or a tensor of the batch shape"):
        RAIN.draw(frame(2), seed=torch.arange(3))


def test_out_is_for_fog_alone() -> None:
    with pytest.raises(ValueError, match="BayerRain: out= is for fog alone"):
        RAIN(frame(), depth(), out=torch.empty(1, H, W))


def test_a_refused_frame_leaves_the_input_and_out_alone() -> None:
    out, given = torch.full((1, H, W), 7.0), frame()
    wrong = depth()
    wrong[0, 3, 3] = math.nan
    with pytest.raises(ValueError, match="1 NaN"):
        FOG(given, wrong, out=out)
    assert torch.equal(out, torch.full((1, H, W), 7.0))
    assert torch.equal(given, frame())


def test_no_sky_and_no_airlight_warn_and_name_the_transform_or_stage() -> None:
    for transform in (BayerFog(Fog(50.0), CAMERA, depth=20.0), BayerRain(Rain(5.0), CAMERA, depth=20.0)):
        with pytest.warns(TorchweatherWarning, match=r"no sky in the frame .* Give airlight=\(red, green, blue\)"):
            transform(frame())


# ---- depth sources ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", [20.0, depth(), lambda image: depth()], ids=["number", "map", "network"])
def test_every_depth_source_is_taken(source: object) -> None:
    given = frame(2)
    fog = BayerFog(Fog(50.0), CAMERA, depth=source, airlight=0.7)
    assert torch.equal(fog(given), FOG(given, depth()))


def test_flat_ground_has_its_sky_above_the_horizon() -> None:
    fog = BayerFog(Fog(50.0), CAMERA, depth=FlatGround(), airlight=0.7)
    transmission = fog.run(frame()).transmission[0]
    assert bool((transmission[:12] < 1e-30).all())
    assert float(transmission[-1, 0]) == pytest.approx(math.exp(-0.06 * 39.13), rel=0.03)  # 1.5 m below, 11.5 px


def test_the_calls_depth_comes_before_the_constructors() -> None:
    fog = BayerFog(Fog(50.0), CAMERA, depth=99.0, airlight=0.7)
    assert torch.equal(fog(frame(), depth()), FOG(frame(), depth()))


def test_one_depth_serves_a_batch_and_each_sample_may_have_its_own() -> None:
    maps = torch.stack([depth(10.0), depth(30.0)])
    got = FOG(frame(2), maps)
    assert torch.equal(got[0], FOG(frame(), depth(10.0)))
    assert torch.equal(got[1], FOG(frame(), depth(30.0)))
    grid = FOG(frame(2, 3), maps[:, None])
    assert torch.equal(grid[1, 2], got[1])
    assert torch.equal(FOG(frame(2, 3), depth(10.0))[1, 1], got[0])


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64], ids=str)
def test_depth_of_any_float_type(dtype: torch.dtype) -> None:
    assert torch.equal(FOG(frame(), depth().to(dtype)), FOG(frame(), depth()))


# ---- raw levels ------------------------------------------------------------------------------------------------------


def test_raw_values_are_linear_between_black_and_white() -> None:
    camera = Camera.from_intrinsics(9.0, 9.0, 1.0, 1.0, 4, 2, black_level=200.0, white_level=4000.0)
    raw = torch.tensor([[[200, 1150, 2100, 4000], [0, 100, 300, 3050]]], dtype=torch.int32).to(torch.uint16)
    linear = raw_to_linear(raw, camera, "test")
    wanted = [0.0, 0.25, 0.5, 1.0, -200 / 3800, -100 / 3800, 100 / 3800, 0.75]
    assert linear.flatten().tolist() == pytest.approx(wanted, abs=1e-6)
    assert torch.equal(raw_from_linear(linear, linear, raw, camera).to(torch.int32), raw.to(torch.int32))
    assert torch.equal(
        raw_from_linear(linear, linear + 1, raw, camera).to(torch.int32).clamp_min(200),
        raw.to(torch.int32).clamp_min(200),
    )


def test_an_eight_bit_frame_of_a_twelve_bit_camera_holds_its_upper_bits() -> None:
    raw = torch.tensor([[[0, 255], [51, 102]]], dtype=torch.uint8)
    camera = Camera.from_intrinsics(9.0, 9.0, 0.5, 0.5, 2, 2)
    assert raw_to_linear(raw, camera, "test").flatten().tolist() == pytest.approx([0.0, 1.0, 0.2, 0.4])


def test_fog_on_raw_values_rounds_to_the_nearest() -> None:
    fog = BayerFog(Fog(50.0), CAMERA, depth=20.0, airlight=0.7)
    raw = torch.full((1, H, W), 400, dtype=torch.int32).to(torch.uint16)
    exact = fog(torch.full((1, H, W), 400 / 4095)).double() * 4095
    assert float((fog(raw).to(torch.float64) - exact).abs().max()) <= 0.5 + 1e-3


def test_fog_works_on_light_and_not_on_companded_values() -> None:
    knots = ((0.0, 0.0), (0.25, 0.5), (1.0, 1.0))
    companding = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H, response_knots=knots)
    fog = BayerFog(Fog(50.0), companding, depth=20.0, airlight=0.7)
    # Raw 0.4 is light 0.2; the result of the linear camera is companded back: 0.5 + (x - 0.25) / 1.5 above 0.25.
    linear = FOG(frame(), depth())
    wanted = torch.where(linear < 0.25, 2 * linear, 0.5 + (linear - 0.25) / 1.5)
    assert torch.allclose(fog(torch.full((1, H, W), 0.4)), wanted, atol=1e-6)
