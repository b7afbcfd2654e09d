"""AsBayer: RGB images in weather, with the input's own bits where the weather does nothing; the mosaic on request."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.through_mosaic import padded, padded_size
from torchweather.image import DepthFromCallable, FlatGround, demosaic, mosaic, quantise, srgb_decode, srgb_encode
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerFog, BayerWeather

AIRLIGHT = (0.7, 0.72, 0.75)
DTYPES = (torch.uint8, torch.uint16, torch.float32, torch.float64, torch.float16)


def camera(height: int = 24, width: int = 32, **more: object) -> Camera:
    return Camera.from_intrinsics(40.0, 40.0, 15.0, 11.0, width, height, **more)


def image(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    values = torch.rand(*shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    return values.to(dtype) if dtype.is_floating_point else quantise(values, dtype)


def fog(
    mor_m: float | Tensor = 50.0, cam: Camera | None = None, depth: object = 40.0, *, through_mosaic: bool = False
) -> AsBayer:
    inner = BayerFog(Fog(mor_m=mor_m), cam or camera(), depth=depth, airlight=AIRLIGHT)
    return AsBayer(inner, through_mosaic=through_mosaic)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [(24, 32), (23, 31), (1, 1)])
def test_infinite_visibility_gives_the_image_back_bit_for_bit(dtype: torch.dtype, size: tuple[int, int]) -> None:
    rgb = image(3, *size, dtype=dtype)
    out = fog(math.inf, camera(*size))(rgb)
    assert out.dtype == dtype
    assert torch.equal(out.view(torch.uint8), rgb.view(torch.uint8))


@pytest.mark.parametrize("weather", [Rain(0.0), Snow(0.0)])
def test_no_precipitation_gives_the_image_back_bit_for_bit(weather: Rain | Snow) -> None:
    rgb = image(2, 3, 23, 31)
    transform = AsBayer(BayerWeather(weather, camera(23, 31), depth=40.0, airlight=AIRLIGHT))
    assert torch.equal(transform(rgb), rgb)


def test_weather_is_applied_to_linear_light_of_the_mosaic() -> None:
    rgb = image(3, 24, 32)
    cam = camera()
    bayer_fog = BayerFog(Fog(mor_m=50.0), cam, depth=40.0, airlight=AIRLIGHT)
    raw = bayer_fog(mosaic(srgb_decode(rgb), cam.bayer_pattern))
    expected = srgb_encode(demosaic(raw, cam.bayer_pattern))
    assert torch.equal(AsBayer(bayer_fog, through_mosaic=True)(rgb), expected)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG", "RCCB"])
def test_a_grey_wall_in_fog_follows_koschmieder_in_linear_light(pattern: str) -> None:
    # A flat image loses nothing to the mosaic, so only the physics is left. Along the axis the ray is the depth.
    cam = camera(bayer_pattern=pattern)
    transform = AsBayer(BayerFog(Fog(mor_m=50.0), cam, depth=50.0, airlight=0.7, extinction="koschmieder"))
    rgb = srgb_encode(torch.full((3, 24, 32), 0.2))
    on_axis = srgb_decode(transform(rgb))[:, 11, 15]
    # 5 % contrast is left at the visibility distance. 1e-4 covers float32 through the sRGB curve and back, and the
    # neighbours within the demosaicing's reach, whose rays are 0.2 % longer.
    assert torch.allclose(on_axis, torch.tensor(0.7 + 0.05 * (0.2 - 0.7)), atol=1e-4)


def test_a_batch_equals_its_images() -> None:
    rgb = image(2, 3, 3, 23, 31)
    transform = AsBayer(
        BayerWeather(Mixture(Rain(20.0), Fog(mor_m=200.0)), camera(23, 31), depth=40.0, airlight=AIRLIGHT)
    )
    noise = transform.draw(rgb, seed=torch.arange(6).reshape(2, 3))
    out = transform(rgb, noise=noise)
    for i in range(2):
        for j in range(3):
            alone = transform(rgb[i, j], noise=transform.draw(rgb[i, j], seed=3 * i + j))
            assert torch.allclose(out[i, j], alone, atol=1e-6)


def test_the_camera_may_have_the_size_of_the_image_or_of_the_padded_image() -> None:
    rgb, depth = image(3, 23, 31), torch.full((1, 23, 31), 40.0)
    bare, whole = fog(cam=camera(23, 31)), fog(cam=camera(24, 32))
    assert torch.equal(bare(rgb, depth), whole(rgb, depth))


def test_padding_does_not_reach_into_the_image() -> None:
    # The image of 24 x 32 without its last row and column: two pixels from the border nothing may differ, because the
    # demosaicing looks two pixels far.
    rgb = image(3, 24, 32)
    out, cut = fog()(rgb), fog(cam=camera(23, 31))(rgb[:, :23, :31])
    assert torch.allclose(out[:, :20, :28], cut[:, :20, :28], atol=1e-6)


def test_padded_repeats_a_single_row_and_reflects_several() -> None:
    assert padded_size(1, 2) == (4, 4)
    assert padded_size(375, 1242) == (376, 1242)
    assert padded(torch.tensor([[5.0]]), 4, 4).eq(5.0).all()
    assert padded(torch.tensor([[1.0, 2.0, 3.0]]), 1, 4).tolist() == [[1.0, 2.0, 3.0, 2.0]]


def test_flat_ground_is_that_of_the_unpadded_camera() -> None:
    rgb = image(3, 23, 31)
    cam = camera(23, 31)
    transform = fog(cam=cam, depth=FlatGround())
    result = transform.run(rgb)
    depth = FlatGround()(cam, 23, 31)
    assert result.transmission.shape == (1, 23, 31)
    # The sky is seen through 730 m or more of the layer, an optical depth of 40 at a visibility of 50 m.
    assert result.transmission[depth.isinf()].lt(1e-16).all()
    assert torch.equal(result.rgb, transform(rgb, depth))


def test_a_depth_function_is_given_the_rgb_image() -> None:
    seen = []

    def network(rgb: Tensor) -> Tensor:
        seen.append(tuple(rgb.shape))
        return torch.full((1, *rgb.shape[-2:]), 40.0)

    fog(cam=camera(23, 31), depth=DepthFromCallable(network))(image(3, 23, 31))
    assert seen == [(3, 23, 31)]


def test_companding_of_the_camera_is_undone_on_the_way() -> None:
    knots = ((0.0, 0.0), (0.1, 0.5), (1.0, 1.0))
    rgb = image(3, 24, 32)
    # Float32 through the knots and back, on the sRGB curve's steep foot.
    assert torch.allclose(fog(cam=camera(response_knots=knots))(rgb), fog()(rgb), atol=1e-4)


def test_run_tells_transmission_mask_and_airlight() -> None:
    rgb = image(2, 3, 23, 31)
    transform = AsBayer(
        BayerWeather(Mixture(Rain(50.0), Fog(mor_m=100.0)), camera(23, 31), depth=40.0, airlight=AIRLIGHT)
    )
    noise = transform.draw(rgb, seed=1)
    result = transform.run(rgb, noise=noise)
    assert torch.equal(result.rgb, transform(rgb, noise=noise))
    assert result.transmission.shape == result.particle_mask.shape == (2, 1, 23, 31)
    assert result.airlight.shape == (2, 3)
    assert 0 < float(result.particle_mask.mean()) < 1


@pytest.mark.parametrize(
    ("rgb", "error", "said"),
    [
        (torch.zeros(1, 24, 32), ValueError, "raw mosaic goes to the Bayer transform"),
        (torch.zeros(24, 32), ValueError, r"\(..., 3, H, W\)"),
        (torch.zeros(3, 20, 32), ValueError, "camera 24 x 32"),
        (torch.zeros(3, 0, 32), ValueError, "pixels"),
        (torch.zeros(3, 24, 32, dtype=torch.int64), TypeError, "int64"),
        (torch.full((3, 24, 32), 255.0), ValueError, "0..1"),
        (torch.full((3, 24, 32), -0.1), ValueError, "0..1"),
        (torch.full((3, 24, 32), torch.nan), ValueError, "NaN"),
        ([[0.0]], TypeError, "torch.Tensor"),
    ],
)
def test_wrong_images_are_refused_with_what_was_wanted(rgb: object, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        fog()(rgb)  # type: ignore[arg-type]


def test_wrong_transforms_and_depths_are_refused() -> None:
    with pytest.raises(TypeError, match="BayerFog"):
        AsBayer(torch.nn.Identity())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="malvar"):
        AsBayer(BayerFog(Fog(mor_m=50.0), camera()), method="nearest")
    with pytest.raises(ValueError, match="depth"):
        fog(depth=None)(image(3, 24, 32))
    with pytest.raises(ValueError, match="NaN"):
        fog()(image(3, 24, 32), torch.full((1, 24, 32), torch.nan))
    with pytest.raises(ValueError, match="depth"):
        fog()(image(3, 24, 32), torch.full((1, 20, 32), 40.0))
