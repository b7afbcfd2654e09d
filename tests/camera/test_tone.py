"""The minimal ISP: exact round trips, published transfer function, order of steps."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchweather.image import (
    colour_matrix,
    compand,
    demosaic,
    develop,
    expand,
    grey_world_gains,
    mosaic,
    normalise,
    quantise,
    shoulder_curve,
    srgb_decode,
    srgb_encode,
    white_balance,
)

TWELVE_BIT = [(0.0, 0.0), (2048.0, 2048.0), (65536.0, 3072.0), (1048576.0, 4095.0)]


@pytest.mark.parametrize(
    ("dtype", "black", "white"),
    [
        (torch.uint8, 0.0, None),
        (torch.uint8, 16.0, 235.0),
        (torch.uint16, 0.0, None),
        (torch.uint16, 240.0, 4095.0),
        (torch.int16, 64.0, 1023.0),
    ],
)
def test_integers_come_back_exactly(dtype: torch.dtype, black: float, white: float | None) -> None:
    top = int(white) if white is not None else torch.iinfo(dtype).max
    raw = torch.arange(top + 1).to(dtype)  # also the numbers below black
    linear = normalise(raw, black, white)
    assert linear.dtype == torch.float32
    assert linear[-1] == 1
    assert linear[int(black)] == 0
    back = quantise(linear, dtype, black, white)
    assert back.dtype == dtype
    assert torch.equal(back.to(torch.int32), raw.to(torch.int32))


def test_float_frames_pass_as_they_are() -> None:
    frame = torch.rand(1, 4, 4, dtype=torch.float64)
    assert torch.equal(normalise(frame), frame)
    assert torch.equal(quantise(frame, torch.float64), frame)


def test_quantise_rounds_to_the_nearest_and_clips() -> None:
    raw = quantise(torch.tensor([-1.0, 0.2499, 0.2501, 7.0]), torch.uint16, 0.0, 2.0)
    assert raw.tolist() == [0, 0, 1, 2]


def test_noise_below_black_keeps_its_mean() -> None:
    assert normalise(torch.tensor([50, 78], dtype=torch.uint8), 64, 255).mean().item() == pytest.approx(0.0, abs=1e-7)


def test_levels_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ValueError, match="white_level must be above black_level"):
        normalise(torch.zeros(1), 1.0, 1.0)
    with pytest.raises(ValueError, match=r"at most 255"):
        quantise(torch.zeros(1), torch.uint8, 0, 4095)
    with pytest.raises(TypeError, match=r"uint8, uint16, int16, int32 or float; got torch.bool"):
        normalise(torch.zeros(1, dtype=torch.bool))


def test_srgb_follows_the_standard() -> None:
    # IEC 61966-2-1: 18 % grey shows at 46.1 %, the linear part has slope 12.92.
    assert srgb_encode(torch.tensor(0.18, dtype=torch.float64)).item() == pytest.approx(0.4614, abs=1e-4)
    assert srgb_encode(torch.tensor(0.001, dtype=torch.float64)).item() == pytest.approx(0.01292, rel=1e-9)


def test_srgb_decode_inverts_encode() -> None:
    # The two published constants (0.0031308, 0.04045) meet only to about 1e-7.
    linear = torch.linspace(0, 1, 1001, dtype=torch.float64)
    torch.testing.assert_close(srgb_decode(srgb_encode(linear)), linear, rtol=0, atol=1e-7)


def test_srgb_gradient_is_finite_at_black() -> None:
    x = torch.zeros(3, requires_grad=True)
    srgb_encode(x).sum().backward()
    assert torch.equal(x.grad, torch.full((3,), 12.92))


def test_srgb_gradcheck() -> None:
    x = torch.tensor([0.001, 0.02, 0.3, 0.9], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(srgb_encode, (x,))
    assert torch.autograd.gradcheck(srgb_decode, (x,))


@given(st.floats(0, 1048576))
@settings(max_examples=200, deadline=None)
def test_expand_inverts_compand(light: float) -> None:
    x = torch.tensor([light], dtype=torch.float64)
    torch.testing.assert_close(expand(compand(x, TWELVE_BIT), TWELVE_BIT), x, rtol=1e-12, atol=1e-9)


def test_every_code_of_a_companding_sensor_survives_expansion_in_single_precision() -> None:
    codes = torch.arange(4096, dtype=torch.float32)
    assert torch.equal(compand(expand(codes, TWELVE_BIT), TWELVE_BIT).round(), codes)


def test_companding_saturates_above_and_keeps_noise_below() -> None:
    assert compand(torch.tensor([2e7, -3.0]), TWELVE_BIT).tolist() == [4095.0, -3.0]


def test_knots_that_do_not_rise_are_refused() -> None:
    with pytest.raises(ValueError, match="strictly rising"):
        compand(torch.zeros(1), [(0.0, 0.0), (0.0, 1.0)])


@pytest.mark.parametrize("knee", [0.0, 0.5, 0.8, 1.0])
def test_shoulder_rises_to_one_and_leaves_what_is_below_the_knee(knee: float) -> None:
    x = torch.linspace(0, 5, 501, dtype=torch.float64)
    y = shoulder_curve(x, knee)
    assert (y.diff() >= 0).all()
    assert y.max() <= 1
    assert torch.equal(y[x <= knee], x[x <= knee])


def test_shoulder_has_no_kink() -> None:
    x = torch.tensor([0.8 - 1e-6, 0.8 + 1e-6], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(shoulder_curve(x, 0.8).sum(), x)
    torch.testing.assert_close(slope, torch.ones_like(slope), rtol=0, atol=1e-4)


def test_grey_world_gains_make_the_mean_grey() -> None:
    colour = torch.tensor([0.1, 0.3, 0.2])[:, None, None].expand(2, 3, 8, 8)
    frame = mosaic(colour, "BGGR")
    gains = grey_world_gains(frame, "BGGR")
    assert gains.shape == (2, 3)
    balanced = white_balance(demosaic(frame, "BGGR"), gains)
    torch.testing.assert_close(balanced, torch.full_like(balanced, 0.3))


def test_black_frame_has_neutral_gains() -> None:
    assert torch.equal(grey_world_gains(torch.zeros(1, 4, 4), "RGGB"), torch.ones(3))


def test_develop_shows_a_flat_colour_as_srgb() -> None:
    colour = torch.tensor([0.5, 0.25, 0.125])[:, None, None].expand(3, 8, 8)
    raw = quantise(mosaic(colour, "GRBG"), torch.uint16, 240, 4095)
    display = develop(raw, "GRBG", black_level=240, white_level=4095, gains=(1.0, 2.0, 4.0))
    # One raw step is 1/3855; the gain of 4 and the slope of sRGB at 0.5 (0.7) leave at most 1.5e-3.
    torch.testing.assert_close(display, srgb_encode(torch.full_like(display, 0.5)), rtol=0, atol=1.5e-3)


def test_develop_undoes_companding() -> None:
    knots = [(light / 1048576, code / 4095) for light, code in TWELVE_BIT]
    light = torch.full((1, 4, 4), 0.1)
    raw = quantise(compand(light, knots), torch.uint16, 240, 4095)
    display = develop(raw, "RGGB", black_level=240, white_level=4095, knots=knots, exposure=5.0)
    # In the curve's last part one code stands for 1/1023 x 15/16 of the range: half of it, times exposure and slope.
    torch.testing.assert_close(display, srgb_encode(torch.full_like(display, 0.5)), rtol=0, atol=2e-3)


def test_clipped_highlight_stays_white() -> None:
    display = develop(torch.ones(1, 4, 4), "RGGB", gains=(2.0, 1.0, 1.6))
    torch.testing.assert_close(display, torch.ones(3, 4, 4))


def test_develop_takes_gains_per_frame_and_a_matrix() -> None:
    frames = torch.full((2, 1, 4, 4), 0.2)
    gains = torch.tensor([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    swap = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    linear = srgb_decode(develop(frames, "RGGB", gains=gains, matrix=swap))
    torch.testing.assert_close(linear.mean((1, 2, 3)), torch.tensor([0.2, 0.4]))


def test_colour_matrix_mixes_channels() -> None:
    rgb = torch.rand(2, 3, 4, 5)
    matrix = torch.tensor([[0.5, 0.25, 0.25], [0.0, 1.0, 0.0], [0.1, 0.2, 0.7]])
    torch.testing.assert_close(colour_matrix(rgb, matrix)[:, 2], 0.1 * rgb[:, 0] + 0.2 * rgb[:, 1] + 0.7 * rgb[:, 2])
