"""Input of every image score: two images of one shape, in their data range, large enough."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional

from torchweather.core.errors import InputTypeError, InputValueError, owner_name
from torchweather.metrics.colour import luma
from torchweather.metrics.data_range import SIDES, check_values, value_of_white
from torchweather.metrics.filters import automatic_factor, averaged_down, subsampled

__all__ = ["Both", "Pair", "check_pair"]

Both = tuple[Tensor, Tensor]
"""Of the distorted image and of the reference, in this order."""


class Pair:
    """Two images of one shape, checked, and what several scores need of them, found once and kept.

    Of an empty batch ``images`` holds one black pair, which a Fourier transform can take; its score is left out.

    Args:
        distorted, reference: ``(..., C, H, W)``, as :func:`check_pair` wants them.
        data_range: value of white.
        channels, minimum, owner: as in :func:`check_pair`.

    Example:
        >>> pair = Pair(torch.ones(2, 3, 8, 8), torch.ones(2, 3, 8, 8), owner="example")
        >>> pair.luma[0].shape, pair.luma is pair.luma
        (torch.Size([2, 1, 8, 8]), True)
    """

    def __init__(
        self,
        distorted: Tensor,
        reference: Tensor,
        data_range: float = 1.0,
        *,
        channels: tuple[int, ...] = (1, 3),
        minimum: int = 1,
        owner: object,
    ) -> None:
        images = check_pair(distorted, reference, data_range, channels=channels, minimum=minimum, owner=owner)
        self.images: Both = images if len(images[0]) else (_with_a_black(images[0]), _with_a_black(images[1]))
        self.batch = reference.shape[:-3]

    @cached_property
    def luma(self) -> Both:
        """Brightness of both, ``(B, 1, H, W)``."""
        return luma(self.images[0]), luma(self.images[1])

    @cached_property
    def halved(self) -> Both:
        """Both ``subsampled`` by 2."""
        return subsampled(self.images[0], 2), subsampled(self.images[1], 2)

    @cached_property
    def shrunk(self) -> Both:
        """Both averaged down to about 256 pixels on the shorter side."""
        factor = automatic_factor(*self.images[0].shape[-2:])
        return averaged_down(self.images[0], factor), averaged_down(self.images[1], factor)

    def per_image(self, score: Tensor) -> Tensor:
        """Scores ``(B,)`` in the batch shape of the images."""
        return score[: self.batch.numel()].reshape(self.batch)


def _with_a_black(images: Tensor) -> Tensor:
    return functional.pad(images, (0, 0, 0, 0, 0, 0, 0, 1))


def check_pair(
    distorted: Tensor,
    reference: Tensor,
    data_range: float,
    *,
    channels: tuple[int, ...] = (1, 3),
    minimum: int = 1,
    owner: object,
) -> Both:
    """Both images as ``(B, C, H, W)``, floating point, scaled to [0, 1].

    Args:
        distorted, reference: ``(..., C, H, W)`` of one shape, floating point or integer, in ``[0, data_range]``.
        data_range: value of white, above 0; one that the images contradict is refused (``check_values``).
        channels: numbers of channels that the score is defined for.
        minimum: least height and width, pixels.
        owner: for messages.
    """
    name = owner_name(owner)
    for which, image in zip(SIDES, (distorted, reference), strict=True):
        if not isinstance(image, Tensor):
            raise InputTypeError(f"{name}: {which} must be a tensor (..., C, H, W); got {type(image).__name__}.")
        if image.is_complex() or image.dtype == torch.bool:
            raise InputTypeError(f"{name}: {which} must hold real numbers; got {image.dtype}.")
        if image.ndim < 3 or image.shape[-3] not in channels:
            wanted = " or ".join(str(number) for number in channels)
            raise InputValueError(
                f"{name}: {which} must be (..., C, H, W) with C = {wanted}; got {tuple(image.shape)}. Channels come "
                "third from last."
            )
    if distorted.shape != reference.shape:
        raise InputValueError(
            f"{name}: both images must have one shape; got {tuple(distorted.shape)} and {tuple(reference.shape)}."
        )
    height, width = reference.shape[-2:]
    if min(height, width) < minimum:
        raise InputValueError(f"{name}: images must be {minimum} x {minimum} pixels or larger; got {height} x {width}.")
    white = value_of_white(data_range, (distorted, reference), name)
    kind = torch.float64 if torch.float64 in (distorted.dtype, reference.dtype) else torch.float32
    first, second = (image.reshape(-1, *image.shape[-3:]).to(kind) for image in (distorted, reference))
    if reference.numel() and not torch.compiler.is_compiling():
        floating = distorted.is_floating_point() and reference.is_floating_point()
        check_values((first.detach(), second.detach()), floating, white, name)
    return (first, second) if white == 1.0 else (first / white, second / white)
