"""What every image score and every cloud score promises: what it takes, what it refuses, what it leaves alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.metrics import CLOUD_SCORES, IMAGE_SCORES, ImageScore, chamfer_distance, cloud_scores, image_scores
from torchweather.metrics.score import CloudScore
from torchweather.metrics.shape_signature import PAIRS, shape_signature_distance

Images = tuple[Tensor, Tensor]

EVERY = list(IMAGE_SCORES)
every_score = pytest.mark.parametrize("name", EVERY)
SYMMETRIC = sorted(set(EVERY) - {"vif", "iw_ssim", "mdsi"})
# Of float32 against float64 (METRICS.md 1).
SINGLE = {"iw_ssim": 3e-3, "vif": 1e-3}


def score(name: str, distorted: Tensor, reference: Tensor, **options: Any) -> Tensor:
    return IMAGE_SCORES[name].function(distorted, reference, **options)


def texture(channels: int, height: int, width: int, seed: int) -> Tensor:
    coarse = torch.rand(1, channels, 9, 9, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    smooth = torch.nn.functional.interpolate(coarse, (height, width), mode="bilinear")[0]
    grain = torch.rand(channels, height, width, generator=torch.Generator().manual_seed(seed + 1)).double()
    return 0.1 + 0.6 * smooth + 0.2 * grain


@cache
def _pair(name: str, channels: int) -> Images:
    side = max(IMAGE_SCORES[name].minimum, 24)
    clear = texture(channels, side, side + 5, 1)
    return 0.7 * clear + 0.2 + 0.1 * texture(channels, side, side + 5, 7).roll(3, -1), clear


def pair(name: str, channels: int = 3, dtype: torch.dtype = torch.float64) -> Images:
    """A veiled, grainy image and the clear one, little larger than the least size, as fresh tensors."""
    worse, clear = _pair(name, channels)
    return worse.to(dtype, copy=True), clear.to(dtype, copy=True)


def inside_range(name: str, found: Tensor) -> bool:
    facts = IMAGE_SCORES[name]
    return bool(((found >= facts.low) & (found <= facts.high)).all())


# ---- images: what is refused ---------------------------------------------------------------------------------------


@every_score
def test_shapes_that_would_broadcast_are_refused(name: str) -> None:
    worse, clear = pair(name)
    height, width = clear.shape[-2:]
    for other in (clear[:1], clear[None], clear.expand(2, 3, height, width), clear[:, :, :-1], clear[:, :-1]):
        for images in ((worse, other), (other, worse)):
            with pytest.raises(ValueError, match=rf"{name}: .*one shape; got|{name}: distorted must be \(\.\.\., C"):
                score(name, *images)


@every_score
def test_channels_last_and_other_channel_counts_are_refused(name: str) -> None:
    worse, clear = pair(name)
    for change in (
        lambda image: image.movedim(0, -1),
        lambda image: image.movedim(0, -1)[None],
        lambda image: image[:2],
        lambda image: torch.cat((image, image[:1])),
        lambda image: image[:0],
    ):
        with pytest.raises(ValueError, match=rf"{name}: distorted must be .* C = (1 or )?3; got .* third from last"):
            score(name, change(worse), change(clear))


@every_score
def test_images_without_a_channel_axis_are_refused(name: str) -> None:
    worse, clear = pair(name, 1)
    with pytest.raises(ValueError, match=r"Channels come third from last|not enough|must be \(\.\.\., C, H, W\)"):
        score(name, worse[0], clear[0])


@every_score
def test_numbers_that_are_no_brightness_are_refused_in_either_image(name: str) -> None:
    for value in (math.nan, math.inf, -math.inf, -0.1, 1.1):
        for place in (0, 1):
            images = pair(name)
            images[place][1, 4, 5] = value
            with pytest.raises(ValueError, match=rf"{name}: {('distorted', 'reference')[place]} must lie in 0"):
                score(name, *images)


@every_score
def test_a_data_range_that_the_data_contradict_is_refused(name: str) -> None:
    worse, clear = pair(name)
    with pytest.raises(ValueError, match=r"data_range is 255, but no value is above"):
        score(name, worse, clear, data_range=255.0)
    with pytest.raises(ValueError, match=r"must lie in 0\.\.data_range = 1;"):
        score(name, 255.0 * worse, 255.0 * clear)
    with pytest.raises(ValueError, match=r"must lie in 0\.\.data_range = 1;"):
        score(name, worse, 255.0 * clear)
    with pytest.raises(ValueError, match=r"data_range is 65535, but no value is above"):
        score(name, 255.0 * worse, 255.0 * clear, data_range=65535.0)
    whole = [(255.0 * image).to(torch.uint8) for image in (worse, clear)]
    with pytest.raises(ValueError, match=r"must lie in 0\.\.data_range = 1;"):
        score(name, *whole)
    for useless in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"data_range must be above 0 and finite; got "):
            score(name, worse, clear, data_range=useless)
    for wrong in ("1", None, True, torch.tensor(1.0)):
        with pytest.raises(TypeError, match=r"data_range must be a number, the value of white; got "):
            score(name, worse, clear, data_range=wrong)


@every_score
def test_a_type_that_ends_below_the_data_range_is_refused(name: str) -> None:
    worse, clear = ((127.0 * image).round() for image in pair(name))
    for place, which in enumerate(("distorted", "reference")):
        for dtype, end in ((torch.uint8, 255), (torch.int8, 127), (torch.int16, 32767)):
            images = [worse, clear]
            images[place] = images[place].to(dtype)
            with pytest.raises(ValueError, match=rf"data_range is 65535, but {which} is {dtype}, which ends at {end}"):
                score(name, *images, data_range=65535)


@every_score
def test_one_image_of_another_range_in_a_batch_is_refused(name: str) -> None:
    worse, clear = pair(name)
    batches = [torch.stack([255.0 * image] * 3) for image in (worse, clear)]
    assert score(name, *batches, data_range=255.0).shape == (3,)
    for place, which in enumerate(("distorted", "reference")):
        images = [batch.clone() for batch in batches]
        images[place][1] /= 255.0
        with pytest.raises(ValueError, match=rf"data_range is 255, but no value is above 0\.\d+ in image 1 of {which}"):
            score(name, *images, data_range=255.0)


@every_score
def test_what_is_no_image_is_refused(name: str) -> None:
    worse, clear = pair(name)
    with pytest.raises(TypeError, match=rf"{name}: distorted must be a tensor .* got ndarray"):
        score(name, worse.numpy(), clear)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=rf"{name}: reference must be a tensor .* got list"):
        score(name, worse, clear.tolist())  # type: ignore[arg-type]
    for kind in (torch.bool, torch.complex64):
        with pytest.raises(TypeError, match=rf"{name}: distorted must hold real numbers; got {kind}"):
            score(name, worse.to(kind), clear)


@pytest.mark.parametrize("batch", [(0,), (2, 0), (0, 3)])
@every_score
def test_no_images_are_no_scores(name: str, batch: tuple[int, ...]) -> None:
    for channels, dtype in ((1, torch.float32), (3, torch.float64), (3, torch.uint8)):
        side = IMAGE_SCORES[name].minimum
        none = torch.zeros(*batch, channels, side, side + 1, dtype=dtype)
        found = score(name, none, none)
        assert (found.shape, found.dtype) == (batch, torch.float64 if dtype == torch.float64 else torch.float32)
    moving = none.double().requires_grad_()
    (gradient,) = torch.autograd.grad(score(name, moving, none).sum(), moving)
    assert gradient.shape == none.shape


@every_score
def test_images_without_pixels_are_refused(name: str) -> None:
    side = IMAGE_SCORES[name].minimum
    for height, width in ((side, 0), (0, side), (0, 0)):
        with pytest.raises(ValueError, match=rf"{name}: images must be {side} x {side} pixels or larger; got"):
            score(name, torch.zeros(3, height, width), torch.zeros(3, height, width))


# ---- images: what is defined ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@every_score
def test_identical_images_have_exactly_the_ideal_score(name: str, dtype: torch.dtype, channels: int) -> None:
    clear = pair(name, channels, dtype)[1]
    noise = torch.rand(clear.shape, generator=torch.Generator().manual_seed(2), dtype=dtype)
    images = [clear, noise, *(torch.full_like(clear, level) for level in (0.0, 0.3, 1.0))]
    images.append(torch.where(noise > 0.5, 1.0, 0.0).to(dtype))
    for image in images:
        assert float(score(name, image, image.clone())) == IMAGE_SCORES[name].ideal


@every_score
def test_constant_images_have_a_score_in_the_range(name: str) -> None:
    worse, clear = pair(name)
    flat = torch.full_like(clear, 0.3)
    for images in ((flat, clear), (worse, flat), (flat, flat + 0.4), (0.0 * flat, 0.0 * flat + 1.0)):
        for dtype in (torch.float32, torch.float64):
            found = score(name, *(image.to(dtype) for image in images))
            assert bool(torch.isfinite(found))
            assert inside_range(name, found)


@every_score
def test_least_differences_stay_in_the_range(name: str) -> None:
    clear = pair(name, dtype=torch.float32)[1]
    noise = torch.rand(clear.shape, generator=torch.Generator().manual_seed(4)) - 0.5
    for base in (clear, torch.full_like(clear, 0.5), torch.full_like(clear, 1e-3)):
        for step in (1e-7, 1e-5, 1e-3):
            assert inside_range(name, score(name, base + step * noise, base)), step


@pytest.mark.parametrize("channels", [1, 3])
@every_score
def test_single_precision_scores_like_double(name: str, channels: int) -> None:
    worse, clear = pair(name, channels, torch.float32)
    single, double = score(name, worse, clear), score(name, worse.double(), clear.double())
    assert (single.dtype, double.dtype) == (torch.float32, torch.float64)
    tolerance = SINGLE.get(name, 1e-4)
    assert float(single) == pytest.approx(float(double), rel=tolerance, abs=tolerance)
    assert score(name, worse, clear.double()).dtype == torch.float64


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@every_score
def test_half_precision_images_are_scored_in_single(name: str, dtype: torch.dtype) -> None:
    worse, clear = pair(name, dtype=dtype)
    found = score(name, worse, clear)
    assert found.dtype == torch.float32
    assert torch.equal(found, score(name, worse.float(), clear.float()))


@pytest.mark.parametrize(
    "dtype", [torch.uint8, torch.int16, torch.int32, torch.int64, torch.uint16, torch.uint32, torch.uint64]
)
@every_score
def test_whole_numbers_score_like_the_same_numbers(name: str, dtype: torch.dtype) -> None:
    worse, clear = ((255.0 * image).round() for image in pair(name))
    whole = score(name, worse.to(dtype), clear.to(dtype), data_range=255)
    assert whole.dtype == torch.float32
    assert torch.equal(whole, score(name, worse.float(), clear.float(), data_range=255.0))
    tolerance = SINGLE.get(name, 1e-4)
    wanted = float(score(name, worse / 255.0, clear / 255.0))
    assert float(whole) == pytest.approx(wanted, rel=tolerance, abs=tolerance)


@every_score
def test_all_sixteen_bits_are_scored(name: str) -> None:
    worse, clear = ((65535.0 * image).round() for image in pair(name, dtype=torch.float32))
    whole = score(name, worse.to(torch.uint16), clear.to(torch.uint16), data_range=65535)
    assert torch.equal(whole, score(name, worse, clear, data_range=65535.0))
    assert float(score(name, clear.to(torch.uint16), clear.to(torch.uint16), data_range=65535)) == (
        IMAGE_SCORES[name].ideal
    )
    mixed = score(name, worse.to(torch.uint16), clear.to(torch.int32), data_range=65535)
    assert torch.equal(mixed, whole)


@pytest.mark.parametrize("default", [torch.float64, torch.float16])
@every_score
def test_the_default_type_of_torch_does_not_matter(name: str, default: torch.dtype) -> None:
    wanted = {dtype: score(name, *pair(name, dtype=dtype)) for dtype in (torch.float32, torch.float64)}
    before = torch.get_default_dtype()
    try:
        torch.set_default_dtype(default)
        for dtype, found in wanted.items():
            again = score(name, *pair(name, dtype=dtype))
            assert again.dtype == dtype
            assert torch.equal(again, found)
    finally:
        torch.set_default_dtype(before)


@every_score
def test_memory_order_does_not_matter(name: str) -> None:
    worse, clear = pair(name)
    wanted = score(name, worse, clear)

    def channels_last(image: Tensor) -> Tensor:
        return image.movedim(0, -1).contiguous().movedim(-1, 0)

    def part_of_larger(image: Tensor) -> Tensor:
        larger = torch.full((image.shape[0], 2 * image.shape[1], image.shape[2] + 3), math.nan, dtype=image.dtype)
        larger[:, ::2, 1:-2] = image
        return larger[:, ::2, 1:-2]

    def transposed(image: Tensor) -> Tensor:
        return image.mT.contiguous().mT

    for change in (channels_last, part_of_larger, transposed):
        assert not change(clear).is_contiguous()
        # Sums in another order of float64.
        torch.testing.assert_close(score(name, change(worse), change(clear)), wanted, rtol=1e-11, atol=1e-13)
    repeated = score(name, worse.expand(2, *worse.shape), clear.expand(2, *clear.shape))
    torch.testing.assert_close(repeated, wanted.expand(2), rtol=1e-11, atol=1e-13)


@every_score
def test_batches_of_any_shape_give_what_their_images_give(name: str) -> None:
    worse, clear = pair(name)
    kinds = [(worse, clear), (clear, clear), (0.0 * worse, clear), (worse, 0.0 * clear + 0.5), (clear, worse)]
    kinds.append((1.0 - clear, clear))
    together = score(name, *(torch.stack(images).reshape(3, 1, 2, *clear.shape) for images in zip(*kinds, strict=True)))
    assert together.shape == (3, 1, 2)
    alone = torch.stack([score(name, *images) for images in kinds])
    torch.testing.assert_close(together.flatten(), alone, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", SYMMETRIC)
def test_symmetric_scores_are_symmetric(name: str, channels: int) -> None:
    worse, clear = pair(name, channels)
    torch.testing.assert_close(score(name, worse, clear), score(name, clear, worse), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", sorted(set(EVERY) - set(SYMMETRIC)))
def test_the_other_scores_are_not(name: str) -> None:
    worse, clear = pair(name)
    assert abs(float(score(name, worse, clear) - score(name, clear, worse))) > 1e-5


@every_score
def test_rows_and_columns_are_alike(name: str) -> None:
    """A square pair turned about its diagonal: every filter has its like in the other direction."""
    side = max(IMAGE_SCORES[name].minimum, 25)
    side += 1 - side % 2  # of an even number of frequencies the highest is on one side only
    clear = texture(3, side, side, 11)
    worse = 0.7 * clear + 0.2 + 0.1 * texture(3, side, side, 13).roll(1, -1)
    wanted = score(name, worse, clear)
    torch.testing.assert_close(score(name, worse.mT, clear.mT), wanted, rtol=1e-9, atol=1e-11)


# ---- images: what is left alone ------------------------------------------------------------------------------------


@every_score
def test_gradients_flow_to_both_images_and_are_finite(name: str) -> None:
    worse, clear = pair(name, dtype=torch.float32)
    assert not score(name, worse, clear).requires_grad
    for first, second in ((worse, clear), (clear, clear), (0.0 * clear, clear), (clear, 0.0 * clear)):
        moving, other = first.clone().requires_grad_(), second.clone().requires_grad_()
        for gradient in torch.autograd.grad(score(name, moving, other), (moving, other)):
            assert bool(torch.isfinite(gradient).all())
        if first is worse:
            assert float(gradient.abs().max()) > 0.0
    with torch.no_grad():
        assert not score(name, worse.requires_grad_(), clear).requires_grad


@every_score
def test_a_step_along_the_gradient_makes_the_image_better(name: str) -> None:
    worse, clear = pair(name)
    options = {"whole_grey": False} if name == "cw_ssim" else {}  # else rounded, and level between its steps
    moving = worse.clone().requires_grad_()
    before = score(name, moving, clear, **options)
    (gradient,) = torch.autograd.grad(before, moving)
    # In a step of 1e-6 in all, the score changes by its slope: the curvature adds a share far below 1 %.
    length = 1e-6 / float(gradient.norm())
    after = score(name, worse + length * gradient, clear, **options)
    assert float(after - before.detach()) == pytest.approx(1e-6 * float(gradient.norm()), rel=0.01)


@every_score
def test_what_was_made_without_gradients_does_not_stop_them(name: str) -> None:
    side = max(IMAGE_SCORES[name].minimum, 24) + 11  # a size of its own, so that nothing of it was kept before
    clear = texture(3, side, side + 2, 5)
    with torch.inference_mode():
        first = score(name, 0.8 * clear, clear)
    moving = (0.8 * clear).requires_grad_()
    found = score(name, moving, clear)
    assert float(found.detach()) == float(first)
    assert bool(torch.autograd.grad(found, moving)[0].any())


@every_score
def test_inputs_and_the_state_of_torch_are_left_alone(name: str) -> None:
    worse, clear = pair(name)
    copies, versions = (worse.clone(), clear.clone()), (worse._version, clear._version)
    state = torch.get_rng_state(), torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_num_threads()
    score(name, worse, clear)
    assert (worse._version, clear._version) == versions
    assert torch.equal(worse, copies[0])
    assert torch.equal(clear, copies[1])
    assert torch.equal(torch.get_rng_state(), state[0])
    assert (torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_num_threads()) == state[1:]


@every_score
def test_earlier_images_do_not_matter(name: str) -> None:
    worse, clear = pair(name, dtype=torch.float32)
    wanted = score(name, worse, clear)
    height, width = clear.shape[-2:]
    for shape in ((1, height + 1, width), (3, height, width + 1), (3, width, height)):  # what was kept must not fit
        for dtype in (torch.float32, torch.float64):
            other = torch.rand(shape, generator=torch.Generator().manual_seed(6), dtype=dtype)
            score(name, 0.5 * other, other)
    score(name, worse.double(), clear.double())
    assert torch.equal(score(name, worse, clear), wanted)


@every_score
def test_one_and_two_threads_agree_and_each_repeats_itself(name: str) -> None:
    worse, clear = (torch.stack((image, image.flip(-1))) for image in pair(name))
    before = torch.get_num_threads()
    found = {}
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found[threads] = score(name, worse, clear)
            assert torch.equal(score(name, worse, clear), found[threads])
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(found[1], found[2], rtol=1e-11, atol=1e-13)


# ---- images: several at once ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("channels", [1, 3])
def test_all_at_once_are_each_alone_in_the_order_asked_for(channels: int, dtype: torch.dtype) -> None:
    clear = torch.stack((texture(channels, 163, 170, 1), texture(channels, 163, 170, 3))).to(dtype)
    worse = 0.7 * clear + 0.2
    together = image_scores(worse, clear)
    assert list(together) == EVERY
    for name in EVERY:
        assert together[name].dtype == dtype
        tolerance = 1e-11 if dtype == torch.float64 else SINGLE.get(name, 1e-5)
        torch.testing.assert_close(together[name], score(name, worse, clear), rtol=tolerance, atol=tolerance)
    for chosen in (EVERY[::-1], ["mdsi", "ssim"], ["vif"], []):
        found = image_scores(worse, clear, iter(chosen))
        assert list(found) == chosen
        for name in chosen:
            torch.testing.assert_close(found[name], together[name], rtol=1e-5, atol=SINGLE.get(name, 1e-5))


def test_a_subset_takes_images_that_are_too_small_for_others() -> None:
    clear = texture(3, 20, 20, 1)
    assert list(image_scores(0.5 * clear, clear, ["gmsd", "ssim"])) == ["gmsd", "ssim"]
    with pytest.raises(ValueError, match="must be 161 x 161 pixels or larger; got 20 x 20"):
        image_scores(0.5 * clear, clear)
    with pytest.raises(ValueError, match=r"score must be one of .*got 'sim'"):
        image_scores(0.5 * clear, clear, ["ssim", "sim"])


def test_all_at_once_refuse_what_each_refuses() -> None:
    clear = texture(3, 163, 163, 1)
    broken = clear.clone()
    broken[0, 0, 0] = math.nan
    for worse, options in ((clear[:, 1:], {}), (broken, {}), (clear, {"data_range": 255.0})):
        with pytest.raises(ValueError, match=r"one shape|must lie in 0|data_range is 255"):
            image_scores(worse, clear, **options)


@every_score
def test_a_score_of_many_batches_is_the_mean_of_its_images(name: str) -> None:
    worse, clear = pair(name)
    collected = ImageScore(IMAGE_SCORES[name], data_range=255.0)
    images = [(worse, clear), (clear.flip(-1), clear), (1.0 - clear, clear)]
    collected.update(*(255.0 * torch.stack(both) for both in zip(*images[:2], strict=True)))
    collected.update(*(255.0 * image for image in images[2]))
    alone = torch.stack([score(name, *both) for both in images])
    # 255 x / 255 is x to the last digit or two.
    torch.testing.assert_close(collected.per_image(), alone, rtol=1e-9, atol=1e-9)
    assert float(collected.compute()) == pytest.approx(float(alone.mean()), rel=1e-9)
    assert collected.higher_is_better == IMAGE_SCORES[name].higher_is_better


# ---- clouds --------------------------------------------------------------------------------------------------------

CLOUD_NAMES = (*CLOUD_SCORES, "chamfer", "chamfer_squared")
FAR = tuple(name for name in CLOUD_NAMES if name != "sdm")


def cloud(n: int, seed: int, columns: int = 3, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.randn(n, columns, generator=generator, dtype=torch.float64) * 10.0).to(dtype)


def scores(distorted: Any, reference: Any, **options: Any) -> dict[str, Any]:
    return {
        name: found.tolist() for name, found in cloud_scores(distorted, reference, names=CLOUD_NAMES, **options).items()
    }


LOST: dict[str, Callable[[int], Tensor]] = {
    "zeros": lambda columns: torch.zeros(3, columns),
    "nan in x": lambda columns: torch.tensor([math.nan, 1.0, 2.0] + [0.0] * (columns - 3)).expand(2, columns),
    "inf in z": lambda columns: torch.tensor([1.0, 1.0, -math.inf] + [0.0] * (columns - 3)).expand(2, columns),
    "zeros with an intensity": lambda columns: torch.tensor([0.0, -0.0, 0.0] + [7.0] * (columns - 3)).expand(
        4, columns
    ),
}


@pytest.mark.parametrize("lost", list(LOST))
@pytest.mark.parametrize("columns", [3, 5])
def test_lost_rows_anywhere_in_either_cloud_do_not_count(lost: str, columns: int) -> None:
    p, r = cloud(30, 1, columns), cloud(25, 2, columns)
    wanted = scores(p, r)
    rows = LOST[lost](columns).double()
    assert scores(torch.cat((p[:9], rows, p[9:])), torch.cat((rows, r))) == wanted
    assert scores([torch.cat((rows, p))], [r]) == {name: [value] for name, value in wanted.items()}


def test_a_point_on_an_axis_or_with_a_broken_further_column_is_a_point() -> None:
    p, r = cloud(20, 1, 4), cloud(20, 2, 4)
    with_axis = torch.cat((p, torch.tensor([[0.0, 0.0, -400.0, 0.0]], dtype=p.dtype)))
    assert scores(with_axis, r)["hd"] > 300.0
    p[:, 3] = math.nan
    assert scores(p, r) == scores(p[:, :3], r[:, :3])


@pytest.mark.parametrize("n", [0, 1, 2])
@pytest.mark.parametrize("m", [0, 1, 2])
def test_clouds_of_few_points(n: int, m: int) -> None:
    found = scores(cloud(n, 1), cloud(m, 2))
    assert (found["sdm"] == 1.0) == ((n == 2) != (m == 2))
    assert (found["sdm"] == 0.0) == (n < 2 and m < 2)
    for name in FAR:
        assert math.isinf(found[name]) == ((n == 0) != (m == 0)), name
        assert (found[name] == 0.0) == (n == 0 and m == 0), name


@pytest.mark.parametrize("direction", ["both", "to_reference", "to_distorted"])
def test_one_point_against_one_is_their_distance(direction: str) -> None:
    found = scores(torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([[1.0, 6.0, 6.0]]), direction=direction)
    ways = 2.0 if direction == "both" else 1.0
    wanted = {"sdm": 0.0, **dict.fromkeys(("rmse", "mde", "mmde", "hd", "hd95"), 5.0)}
    assert found == {**wanted, "chamfer": 5.0 * ways, "chamfer_squared": 25.0 * ways}


def test_padded_batch_and_list_agree_and_padding_is_never_seen() -> None:
    sizes = [(12, 7), (1, 9), (0, 5), (20, 20), (4, 1)]
    listed = [(cloud(n, i), cloud(m, i + 50)) for i, (n, m) in enumerate(sizes)]
    wanted = scores([p for p, _ in listed], [r for _, r in listed])
    for filler in (math.nan, 0.0, 5.0, math.inf):
        padded = torch.full((2, 5, 22, 4), filler, dtype=torch.float64)
        valid = torch.zeros(2, 5, 22, dtype=torch.bool)
        for side in (0, 1):
            for i, both in enumerate(listed):
                padded[side, i, : len(both[side]), :3] = both[side]
                valid[side, i, : len(both[side])] = True
        assert scores(padded[0], padded[1], distorted_valid=valid[0], reference_valid=valid[1]) == wanted
        if filler != 5.0:
            assert scores(padded[0], padded[1]) == wanted
    for i, both in enumerate(listed):
        assert scores(*both) == {name: value[i] for name, value in wanted.items()}


def test_copies_of_points_change_means_only_by_their_weight() -> None:
    p, r = cloud(15, 1), cloud(10, 2)
    once, thrice = scores(p, r), scores(p.repeat(3, 1), r.repeat(3, 1))
    for name in ("rmse", "mde", "mmde", "hd", "chamfer", "chamfer_squared"):
        assert thrice[name] == pytest.approx(once[name], rel=1e-12), name
    assert scores(p.repeat(3, 1), p)["hd"] == 0.0
    assert scores(r[:1].repeat(400, 1), r[:1].repeat(3, 1)) == dict.fromkeys(CLOUD_NAMES, 0.0)


def test_the_default_type_of_torch_does_not_matter_to_clouds() -> None:
    before = torch.get_default_dtype()
    for dtype in (torch.float32, torch.float64):
        p, r = cloud(1600, 1, dtype=dtype), cloud(1500, 2, dtype=dtype)
        wanted = cloud_scores(p, r, names=CLOUD_NAMES)
        try:
            torch.set_default_dtype(torch.float64)
            again = cloud_scores(p, r, names=CLOUD_NAMES)
        finally:
            torch.set_default_dtype(before)
        for name in CLOUD_NAMES:
            assert again[name].dtype == dtype
            assert torch.equal(again[name], wanted[name]), name


@pytest.mark.parametrize("n", [200, 2000])  # all pairs of points, and drawn ones
def test_single_precision_far_from_the_origin(n: int) -> None:
    assert (n * (n - 1) // 2 > PAIRS) == (n == 2000)
    place = torch.tensor([1e5, -1e5, 1e5])
    p, r = (cloud(n, seed, dtype=torch.float32) + place for seed in (1, 2))
    single, double = scores(p, r), scores(p.double(), r.double())
    # The same numbers: what is left is the rounding of the scores, and in sdm of differences that are exact.
    assert single == pytest.approx(double, rel=2e-7, abs=2e-7)
    near = scores(*(c.double() - place for c in (p, r)))
    assert double == pytest.approx(near, rel=1e-9)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.int16, torch.int64, torch.uint16])
def test_other_number_types_are_scored_in_single_precision(dtype: torch.dtype) -> None:
    p, r = (cloud(n, seed).abs().to(dtype) for n, seed in ((30, 1), (20, 2)))
    assert scores(p, r.to(torch.int32)) == scores(p.float(), r.int().float())
    found = cloud_scores(p, r, names=CLOUD_NAMES)
    assert {score.dtype for score in found.values()} == {torch.float32}
    assert scores(p, r) == scores(p.float(), r.float())


def test_cloud_rows_may_lie_anywhere_in_memory() -> None:
    p, r = cloud(30, 1), cloud(20, 2)
    wide = torch.full((60, 7), math.nan, dtype=p.dtype)
    wide[::2, 2:5] = p
    assert not wide[::2, 2:5].is_contiguous()
    # Sums in another order of float64.
    assert scores(wide[::2, 2:5], r.T.contiguous().T) == pytest.approx(scores(p, r), rel=1e-13)


def test_clouds_and_the_state_of_torch_are_left_alone() -> None:
    p, r = cloud(1600, 1, 4), cloud(1500, 2, 4)
    p[3], r[5, 1] = 0.0, math.nan
    copies, state, versions = (p.clone(), r.clone()), torch.get_rng_state(), (p._version, r._version)
    first = scores(p, r, seed=3)
    scores(r, p, seed=4)
    assert scores(p, r, seed=3) == first
    assert (p._version, r._version) == versions
    assert torch.equal(torch.get_rng_state(), state)
    for now, before in zip((p, r), copies, strict=True):
        assert torch.equal(now.nan_to_num(-1.0), before.nan_to_num(-1.0))


def test_threads_do_not_change_a_cloud_score() -> None:
    p, r = cloud(3000, 1), cloud(2500, 2)
    before = torch.get_num_threads()
    found = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(scores(p, r))
    finally:
        torch.set_num_threads(before)
    assert found[0] == pytest.approx(found[1], rel=1e-12)


@pytest.mark.parametrize("name", CLOUD_NAMES)
def test_names_one_by_one_and_in_any_order(name: str) -> None:
    p, r = cloud(30, 1), cloud(20, 2)
    alone = cloud_scores(p, r, names=(name,))
    assert list(alone) == [name]
    reverse = cloud_scores(p, r, names=CLOUD_NAMES[::-1])
    assert list(reverse) == list(CLOUD_NAMES[::-1])
    assert torch.equal(alone[name], reverse[name])


def test_functions_of_one_score_are_those_of_the_set() -> None:
    p, r = cloud(1600, 1), cloud(1500, 2)
    found = cloud_scores(p, r, names=CLOUD_NAMES, seed=5)
    assert torch.equal(shape_signature_distance(p, r, seed=5), found["sdm"])
    assert torch.equal(chamfer_distance(p, r, squared=True), found["chamfer_squared"])


@pytest.mark.parametrize("search", ["tree", "exhaustive"])
@pytest.mark.parametrize("name", CLOUD_NAMES)
def test_a_step_along_the_gradient_raises_a_cloud_score(name: str, search: str) -> None:
    p, r = cloud(40, 1).requires_grad_(), cloud(30, 2)
    before = cloud_scores(p, r, names=(name,), search=search)[name]
    (gradient,) = torch.autograd.grad(before, p)
    length = 1e-6 / float(gradient.norm())
    after = cloud_scores(p.detach() + length * gradient, r, names=(name,), search=search)[name]
    # Steps of 1e-6 m change no neighbour here; the curvature adds a share far below 1 %.
    assert float(after - before.detach()) == pytest.approx(1e-6 * float(gradient.norm()), rel=0.01)


@pytest.mark.parametrize("name", CLOUD_NAMES)
def test_a_cloud_score_of_many_updates_is_the_mean_of_its_clouds(name: str) -> None:
    clouds = [(cloud(20 + i, i), cloud(30 - i, i + 9)) for i in range(4)]
    collected = CloudScore(name)
    with pytest.raises(ValueError, match=rf"{name}: no cloud was scored"):
        collected.compute()
    collected.update(*clouds[0])
    collected.update([p for p, _ in clouds[1:3]], [r for _, r in clouds[1:3]])
    collected.update([], [])
    collected.update(*(one[None] for one in clouds[3]))
    alone = [scores(*both)[name] for both in clouds]
    assert collected.per_cloud().tolist() == alone
    assert float(collected.compute()) == pytest.approx(sum(alone) / 4.0, rel=1e-13)
    assert (collected.higher_is_better, collected.ideal, collected.low) == (False, 0.0, 0.0)
    assert max(alone) <= collected.high
    collected.reset()
    collected.update(torch.zeros(5, 3), cloud(5, 1))
    assert collected.per_cloud().tolist() == [1.0 if name == "sdm" else math.inf]
