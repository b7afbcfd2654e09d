"""RandomWeather and its kinds: any picture in, the same kind of picture out, in weather of its own."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

import torchweather as tw
from torchweather.core.errors import TorchweatherWarning
from torchweather.sensors import fit_camera

H, W = 24, 32
KINDS = [
    (tw.RandomRain, {"rate_mm_per_h": (20, 50)}),
    (tw.RandomFog, {"mor_m": (50, 500)}),
    (tw.RandomSnow, {"rate_mm_per_h": (1, 3)}),
    (tw.RandomWeather, {}),
]


def picture(*batch: int, dtype: torch.dtype = torch.uint8) -> Tensor:
    values = torch.rand(*batch, 3, H, W, generator=torch.Generator().manual_seed(1))
    return (values * 255).to(torch.uint8) if dtype == torch.uint8 else values.to(dtype)


def fog(**more: Any) -> tw.RandomFog:
    return tw.RandomFog(mor_m=50.0, **{"p": 1.0, "depth": 30.0, "airlight": 0.7, **more})


class TaggedImage(Tensor):
    """As torchvision's tv_tensors.Image: a tensor of a class of its own."""


@pytest.mark.parametrize(("kind", "values"), KINDS, ids=lambda one: getattr(one, "__name__", ""))
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.float16])
def test_a_tensor_comes_back_in_its_dtype_and_shape(kind: Any, values: dict[str, Any], dtype: torch.dtype) -> None:
    transform = kind(**values, p=1.0, depth=30.0, airlight=0.7)
    for batch in ((), (2,), (2, 2)):
        given = picture(*batch, dtype=dtype)
        kept = given.clone()
        out = transform(given, seed=1)
        assert (out.shape, out.dtype) == (given.shape, given.dtype)
        assert torch.equal(given, kept)
        assert not torch.equal(out, given)


def test_numpy_and_pil_give_what_the_tensor_gives() -> None:
    tensor = picture()
    array = np.ascontiguousarray(tensor.permute(1, 2, 0).numpy())
    expected = fog()(tensor, seed=3)
    of_array = fog()(array, seed=3)
    assert isinstance(of_array, np.ndarray)
    assert np.array_equal(of_array, expected.permute(1, 2, 0).numpy())
    of_pil = fog()(Image.fromarray(array), seed=3)
    assert isinstance(of_pil, Image.Image)
    assert np.array_equal(np.asarray(of_pil), of_array)


def test_a_subclass_of_tensor_comes_back_as_such_and_others_pass_through() -> None:
    boxes = torch.tensor([[1.0, 2.0, 3.0, 4.0]])
    out, same, label = fog()(picture().as_subclass(TaggedImage), boxes, "car", seed=1)
    assert type(out) is TaggedImage
    assert same is boxes
    assert label == "car"
    assert torch.equal(out.as_subclass(Tensor), fog()(picture(), seed=1))


def test_a_list_gives_a_list_of_the_single_results() -> None:
    rain = tw.RandomRain(30.0, p=1.0, depth=30.0, airlight=0.7)
    pictures = [picture(), picture()[:, :20, :30].contiguous()]
    out = rain(pictures, seed=5)
    assert torch.equal(out[0], rain(pictures[0], seed=5))
    assert torch.equal(out[1], rain(pictures[1], seed=6))


def test_a_batch_equals_its_pictures() -> None:
    weather = tw.RandomWeather(p=1.0, depth=30.0, airlight=0.7)
    batch = picture(3)
    out = weather(batch, seed=8)
    for row in range(3):
        assert torch.equal(out[row], weather(batch[row], seed=8 + row))


def test_p_is_the_share_of_pictures_in_weather_and_the_others_keep_their_bits() -> None:
    out = fog(p=0.5)(picture(1).expand(64, 3, H, W), seed=0)
    changed = sum(not torch.equal(one, picture()) for one in out)
    # Binomial of 64 and 1/2: five standard deviations of 4 about 32.
    assert 12 <= changed <= 52
    assert fog(p=0.0)(given := picture()) is given


def test_the_global_generator_decides_unless_told_otherwise() -> None:
    rain = tw.RandomRain((5, 50), p=1.0, depth=30.0, airlight=0.7)
    torch.manual_seed(3)
    first = rain(picture())
    torch.manual_seed(3)
    assert torch.equal(rain(picture()), first)
    before = torch.get_rng_state()
    own = [rain(picture(), generator=torch.Generator().manual_seed(4)) for _ in range(2)]
    assert torch.equal(own[0], own[1])
    assert torch.equal(torch.get_rng_state(), before)


def test_a_seed_of_the_transform_makes_the_weather_a_function_of_the_picture() -> None:
    rain = tw.RandomRain((5, 50), p=1.0, depth=30.0, airlight=0.7, seed=7)
    one, other = picture(), 255 - picture()
    first = rain(one)
    rain(other)
    assert rain._seed_of(one) != rain._seed_of(other)  # another storm
    assert torch.equal(rain(one), first)
    assert torch.equal(rain(torch.stack([other, one]))[1], first)
    assert not torch.equal(tw.RandomRain((5, 50), p=1.0, depth=30.0, airlight=0.7, seed=8)(one), first)


def test_a_depth_at_the_call_decides() -> None:
    near, far = torch.full((H, W), 5.0), np.full((1, H, W), 80.0, np.float32)
    light = [float(fog()(picture(), depth=depth, seed=1).float().std()) for depth in (near, far)]
    assert light[0] > 2 * light[1]  # fog takes the contrast of what is far
    maps = torch.stack([near[None], torch.full((1, H, W), 80.0)])
    batch = fog()(picture(2), depth=maps, seed=1)
    assert torch.equal(batch[0], fog()(picture(2)[0], depth=near, seed=1))


def test_a_function_of_the_picture_may_give_the_depth() -> None:
    seen = []

    def network(rgb: Tensor) -> Tensor:
        seen.append(tuple(rgb.shape))
        return torch.full((1, *rgb.shape[-2:]), 30.0)

    fog(depth=network)(picture(), seed=1)
    assert seen == [(3, H, W)]


def test_without_a_depth_it_is_guessed_with_one_warning() -> None:
    guessing = tw.RandomFog(mor_m=50.0, p=1.0, airlight=0.7)
    with pytest.warns(TorchweatherWarning, match="no depth: it is guessed from the pictures"):
        first = guessing(picture(), seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.equal(guessing(picture(), seed=1), first)
        assert torch.equal(tw.RandomFog(mor_m=50.0, p=1.0, airlight=0.7, depth="auto")(picture(), seed=1), first)


def test_another_size_gets_the_camera_s_view_with_square_pixels() -> None:
    camera = tw.Camera.preset("lucid-triton")
    wide = torch.full((3, 20, 60), 0.3)
    own = fit_camera(camera, 60, 20).camera
    expected = tw.AsBayer(tw.BayerFog(tw.Fog(mor_m=50.0), own, depth=30.0, airlight=0.7))(wide)
    assert torch.equal(fog()(wide, seed=1), expected)


def test_it_stands_in_kornia_s_pipeline() -> None:
    from kornia.augmentation import AugmentationSequential, RandomHorizontalFlip

    batch = picture(2, dtype=torch.float32)
    pipeline = AugmentationSequential(fog(), RandomHorizontalFlip(p=1.0), data_keys=["input"])
    torch.manual_seed(0)
    out = pipeline(batch)
    torch.testing.assert_close(out, fog()(batch, seed=1).flip(-1))  # fog of one visibility needs no random numbers


def test_it_goes_to_workers() -> None:
    rain = pickle.loads(pickle.dumps(tw.RandomRain((5, 50), p=1.0, depth=30.0, airlight=0.7)))
    assert torch.equal(
        rain(picture(), seed=2), tw.RandomRain((5, 50), p=1.0, depth=30.0, airlight=0.7)(picture(), seed=2)
    )


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        (lambda: fog()(torch.zeros(1, H, W)), ValueError, r"\(\.\.\., 3, H, W\); got \(1, 24, 32\)"),
        (lambda: fog()(np.zeros((3, H, W), np.uint8)), ValueError, "Channels come last in numpy"),
        (lambda: fog()(Image.new("L", (W, H))), ValueError, "mode RGB; got L. Use image.convert"),
        (lambda: fog()("photo.jpg"), TypeError, "expected a picture.*got str"),
        (lambda: fog()(picture(), depth=30.0), TypeError, "goes to the constructor"),
        (lambda: fog()([picture()], depth=[]), ValueError, "a map for each of 1 pictures; got 0"),
        (lambda: tw.RandomFog(mor_m=50.0, p=1.5), ValueError, "p must"),
        (lambda: tw.RandomFog(mor_m=50.0, airlihgt=0.5), TypeError, "airlihgt"),
        (lambda: tw.RandomWeather([None]), ValueError, "must hold a Rain, Fog, Snow or Mixture"),
        (lambda: tw.RandomFog(mor_m=50.0, camera="kiti"), ValueError, "kitti"),
    ],
)
def test_what_it_cannot_take_is_refused_with_the_remedy(wrong: Any, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        wrong()
