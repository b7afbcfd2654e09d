"""Check of the data range that images are declared to have."""

from __future__ import annotations

import math
import numbers

import torch
from torch import Tensor

from torchweather.core.errors import InputTypeError, InputValueError

__all__ = ["SIDES", "check_values", "value_of_white"]

SIDES = ("distorted", "reference")

# Values may leave their range by rounding, or by filters that overshoot.
SLACK = 1e-3
# From per cent on, an image in [0, 1] contradicts its range, unless it is black: below half a grey step of 8 bits.
HUNDRED = 100.0
BLACK = 0.5 / 255.0
# From 15 bits on, images of 8 bits contradict their range, unless they are dark in 8 bits too: below a 16th of white.
FIFTEEN_BITS = 32767.0
EIGHT_BITS = 255.0
DARK = EIGHT_BITS / 16.0


def value_of_white(data_range: object, images: tuple[Tensor, Tensor], name: str) -> float:
    """The data range as a number above 0 that the types of both images can hold."""
    if isinstance(data_range, bool) or not isinstance(data_range, numbers.Real):
        raise InputTypeError(f"{name}: data_range must be a number, the value of white; got {data_range!r}.")
    white = float(data_range)
    if not 0.0 < white < math.inf:
        raise InputValueError(f"{name}: data_range must be above 0 and finite; got {data_range!r}.")
    for which, image in zip(SIDES, images, strict=True):
        if not image.is_floating_point() and torch.iinfo(image.dtype).max < white:
            raise InputValueError(
                f"{name}: data_range is {white:g}, but {which} is {image.dtype}, which ends at "
                f"{torch.iinfo(image.dtype).max}. Set data_range to the value of white."
            )
    return white


def check_values(images: tuple[Tensor, Tensor], floating: bool, white: float, name: str) -> None:
    """Raise ``ValueError`` unless all values lie in their range, and no image shows that it belongs to another.

    Args:
        images: ``(B, C, H, W)`` floating point, distorted and reference.
        floating: both came as floating point; of an integer type, a number of bits is taken at its word.
        white: data range.
        name: for messages.

    Note:
        From a range of 100 on, an image in [0, 1] is one whose largest value is at most 1. Not refused are black ones
        (no value above 0.5 / 255) and whole numbers (the 0 and 1 of a nearly black recording). From 15 bits on, images
        of 8 bits are a batch of floating point whose largest value, of both sides, lies in 16..255; darker ones may be
        of either.
    """
    highest = []
    for which, image in zip(SIDES, images, strict=True):
        of_each = image.amax((1, 2, 3))
        low, high = float(image.min()), float(of_each.max())
        if not (low >= -SLACK * white and high <= (1.0 + SLACK) * white):  # NaN too
            raise InputValueError(
                f"{name}: {which} must lie in 0..data_range = {white:g}; got {low:g}..{high:g}. Set data_range "
                "to the value of white."
            )
        if white >= HUNDRED:
            _check_each(which, image, of_each, white, name)
        highest.append(high)
    if white >= FIFTEEN_BITS and floating and DARK < max(highest) <= EIGHT_BITS:
        raise InputValueError(
            f"{name}: data_range is {white:g}, but no value is above {max(highest):g}: images of 8 bits have "
            "data_range=255. If they are that dark, divide both images by data_range and leave it at 1."
        )


def _check_each(which: str, images: Tensor, highest: Tensor, white: float, name: str) -> None:
    faint = (highest > BLACK) & (highest <= 1.0 + SLACK)
    for place in faint.nonzero().flatten().tolist():
        if bool((images[place] != images[place].round()).any()):
            raise InputValueError(
                f"{name}: data_range is {white:g}, but no value is above {float(highest[place]):g} in image {place} of "
                f"{which}: images in [0, 1] have data_range=1. A wrong range adds 48 dB to the PSNR of such images. "
                "If it is that dark, divide both images by data_range and leave it at 1."
            )
