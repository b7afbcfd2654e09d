"""Mosaics: the right colour at the right pixel, for every pattern."""

from __future__ import annotations

import pytest
import torch

from torchweather.image import (
    PATTERNS,
    RCCB_TO_RGB,
    RGB_TO_RCCB,
    cfa_colour_index,
    cfa_index,
    colour_means,
    join_planes,
    mosaic,
    split_planes,
)

COLOUR = torch.tensor([0.2, 0.4, 0.8])
BAYER = ["RGGB", "BGGR", "GRBG", "GBRG"]


def flat(height: int, width: int) -> torch.Tensor:
    return COLOUR[:, None, None].expand(3, height, width)


@pytest.mark.parametrize("pattern", BAYER)
def test_pattern_name_reads_the_top_left_cell_in_rows(pattern: str) -> None:
    letters = "".join("RGB"[i] for row in cfa_colour_index(pattern) for i in row)
    assert letters == pattern


def test_clear_pixels_of_rccb_lie_on_the_anti_diagonal() -> None:
    assert cfa_colour_index("RCCB") == ((0, 1), (1, 2))


@pytest.mark.parametrize("pattern", BAYER)
def test_mosaic_of_a_flat_colour_shows_each_pixel_its_own_colour(pattern: str) -> None:
    frame = mosaic(flat(5, 7), pattern)
    assert frame.shape == (1, 5, 7)
    assert torch.equal(frame[0], COLOUR[cfa_index(5, 7, pattern)])


def test_clear_pixel_sees_the_mean_of_the_colours() -> None:
    frame = mosaic(flat(4, 4), "RCCB")
    assert frame[0, 0, 1].item() == pytest.approx(COLOUR.mean().item(), rel=1e-6)


def test_rccb_matrices_are_inverse_and_keep_grey() -> None:
    there, back = torch.tensor(RGB_TO_RCCB, dtype=torch.float64), torch.tensor(RCCB_TO_RGB, dtype=torch.float64)
    torch.testing.assert_close(back @ there, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-15)
    torch.testing.assert_close(there.sum(1), torch.ones(3, dtype=torch.float64), rtol=0, atol=1e-15)


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float64])
def test_planes_split_and_join_without_loss(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    frame = torch.randint(0, 255, (*batch, 1, 6, 8)).to(dtype)
    planes = split_planes(frame)
    assert planes.shape == (*batch, 4, 3, 4)
    assert torch.equal(planes[..., 1, :, :], frame[..., 0, 0::2, 1::2])
    assert torch.equal(join_planes(planes), frame)


@pytest.mark.parametrize("pattern", list(PATTERNS))
def test_colour_means_of_a_flat_colour(pattern: str) -> None:
    native = torch.tensor([0.2, COLOUR.mean() if pattern == "RCCB" else 0.4, 0.8])
    frame = mosaic(flat(6, 10).expand(2, 3, 6, 10), pattern)
    torch.testing.assert_close(colour_means(frame, pattern), native.expand(2, 3))
    torch.testing.assert_close(colour_means(frame, pattern, region=(0.0, 0.5, 0.2, 1.0)), native.expand(2, 3))


def test_colour_means_take_only_the_region_and_the_mask() -> None:
    frame = torch.zeros(1, 10, 10)
    frame[:, :6] = 1.0
    assert torch.equal(colour_means(frame, "RGGB", region=(0.0, 0.6, 0.0, 1.0)), torch.ones(3))
    torch.testing.assert_close(colour_means(frame, "RGGB"), torch.full((3,), 0.6))
    assert torch.equal(colour_means(frame, "RGGB", mask=frame < 0.5), torch.zeros(3))


def test_colour_without_a_pixel_is_nan() -> None:
    mask = torch.zeros(1, 4, 4, dtype=torch.bool)
    mask[0, 0, 0] = True
    means = colour_means(torch.ones(1, 4, 4), "RGGB", mask=mask)
    assert means[0] == 1
    assert means[1:].isnan().all()


def test_unknown_pattern_and_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"pattern must be one of .*RGGB.*Did you mean 'RGGB'"):
        cfa_index(4, 4, "RGBG")
    with pytest.raises(ValueError, match=r"rgb must have shape \(..., 3, H, W\)"):
        mosaic(torch.zeros(1, 4, 4), "RGGB")
    with pytest.raises(ValueError, match="even"):
        split_planes(torch.zeros(1, 4, 5))
    with pytest.raises(ValueError, match="four phases"):
        join_planes(torch.zeros(3, 4, 4))
    with pytest.raises(ValueError, match="region"):
        colour_means(torch.zeros(1, 4, 4), "RGGB", region=(0.5, 0.2, 0.0, 1.0))
