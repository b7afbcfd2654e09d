"""Frames in a detector's input: letterbox, corner, stretch, multiples; and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from torchweather.evaluation.robustness.placement import placed

DECLARED: dict[str, Any] = {"size": [64, 96], "fit": "letterbox", "fill": 51, "multiple": 1}
SIZES = [(30, 100), (100, 30), (64, 96), (375, 1242), (7, 9)]


def marked(height: int, width: int) -> tuple[torch.Tensor, list[float]]:
    """A frame with a white box, and the box."""
    image = torch.zeros(3, height, width)
    top, bottom, left, right = height // 4, height // 2, width // 4, width // 2
    image[:, top:bottom, left:right] = 1.0
    return image, [float(left), float(top), float(right), float(bottom)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("fit", ["stretch", "letterbox", "corner"])
def test_a_box_in_the_input_comes_back_to_its_place_in_frames_of_any_size(size: tuple[int, int], fit: str) -> None:
    image, box = marked(*size)
    taken, place = placed(image, {**DECLARED, "fit": fit})
    assert tuple(taken.shape) == (3, 64, 96)
    white = np.argwhere((taken[0] > 0.5).numpy())
    (top, left), (bottom, right) = white.min(0), white.max(0) + 1
    found = place.to_frame(np.array([[left, top, right, bottom]], dtype=np.float64))[0]
    # A pixel of the input is as many of the frame; half of one is rounding.
    tolerance = max(size[0] / place.height, size[1] / place.width, 1.0)
    assert found == pytest.approx(box, abs=tolerance)


@pytest.mark.parametrize(("fit", "top"), [("letterbox", 17), ("corner", 0)])
def test_one_scale_holds_for_both_sides_and_the_rest_is_border(fit: str, top: int) -> None:
    taken, place = placed(torch.ones(3, 30, 96), {**DECLARED, "fit": fit})
    assert (place.height, place.width, place.top, place.left) == (30, 96, top, 0)
    border = torch.ones(64, dtype=torch.bool)
    border[top : top + 30] = False
    assert torch.equal(taken[:, border], torch.full_like(taken[:, border], 51 / 255))
    assert torch.equal(taken[:, ~border], torch.ones(3, 30, 96))  # not resized: bit for bit


def test_a_small_frame_keeps_its_size_where_it_is_not_to_be_enlarged() -> None:
    image = torch.rand(3, 30, 40)
    taken, place = placed(image, {**DECLARED, "enlarge": False})
    assert (place.height, place.width, place.top, place.left) == (30, 40, 17, 28)
    assert torch.equal(taken[:, 17:47, 28:68], image)
    _, place = placed(torch.rand(3, 128, 192), {**DECLARED, "enlarge": False})
    assert (place.height, place.width) == (64, 96)


def test_a_frame_without_size_gets_a_border_up_to_the_multiple() -> None:
    image = torch.rand(3, 33, 64)
    taken, place = placed(image, {**DECLARED, "size": None, "fit": "stretch", "multiple": 32})
    assert tuple(taken.shape) == (3, 64, 64)
    assert torch.equal(taken[:, :33], image)
    assert place.to_frame(np.array([[0.0, 0.0, 64.0, 64.0]])).tolist() == [[0.0, 0.0, 64.0, 33.0]]


def test_a_map_over_the_input_loses_its_border() -> None:
    image = torch.ones(3, 20, 60)
    _, place = placed(image, DECLARED)
    logits = torch.zeros(2, 16, 24)  # a stride of 4
    logits[0] = 1.0
    logits[1, 4:12] = 5.0  # rows 16 to 48 of the input: the frame's
    assert place.map_to_frame(logits).shape == (2, 20, 60)
    assert bool((place.map_to_frame(logits).argmax(0)[2:-2] == 1).all())
