"""What every image score starts from: two images of one shape, in their data range, large enough."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from torchweather.errors import owner_name
from torchweather.metrics.colour import luma
from torchweather.metrics.filters import automatic_factor, averaged_down, subsampled

__all__ = ["Both", "Pair", "check_pair"]

Both = tuple[Tensor, Tensor]
"""Of the distorted image and of the reference, in this order."""


# Values may leave their range by rounding, or by filters that overshoot.
SLACK = 1e-3
# Images in [0, 1] are declared to be 0..255 where the largest of both is below this share of the range.
FAINT = 1.5 / 255.0


class Pair:
    """Two images of one shape, checked, and what several scores need of them, found once and kept.

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
        channels: tuple[int, ...] | None = (1, 3),
        minimum: int = 1,
        owner: object,
    ) -> None:
        self.images: Both = check_pair(
            distorted, reference, data_range, channels=channels, minimum=minimum, owner=owner
        )
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
        return score.reshape(self.batch)


def check_pair(
    distorted: Tensor,
    reference: Tensor,
    data_range: float,
    *,
    channels: tuple[int, ...] | None = (1, 3),
    minimum: int = 1,
    owner: object,
) -> Both:
    """Both images as ``(B, C, H, W)``, floating point, scaled to [0, 1].

    Args:
        distorted, reference: ``(..., C, H, W)`` of one shape, floating point or integer, in ``[0, data_range]``.
        data_range: value of white, above 0.
        channels: numbers of channels that the score is defined for; None: any.
        minimum: least height and width, pixels.
        owner: for messages.
    """
    name = owner_name(owner)
    for which, image in (("distorted", distorted), ("reference", reference)):
        if not isinstance(image, Tensor):
            raise TypeError(f"{name}: {which} must be a tensor (..., C, H, W); got {type(image).__name__}.")
        if image.is_complex() or image.dtype == torch.bool:
            raise TypeError(f"{name}: {which} must hold real numbers; got {image.dtype}.")
        if image.ndim < 3 or (channels is not None and image.shape[-3] not in channels):
            wanted = "" if channels is None else " with C = " + " or ".join(str(number) for number in channels)
            raise ValueError(
                f"{name}: {which} must be (..., C, H, W){wanted}; got {tuple(image.shape)}. Channels come "
                "third from last."
            )
    if distorted.shape != reference.shape:
        raise ValueError(
            f"{name}: both images must have one shape; got {tuple(distorted.shape)} and {tuple(reference.shape)}."
        )
    height, width = reference.shape[-2:]
    if min(height, width) < minimum:
        raise ValueError(f"{name}: images must be {minimum} x {minimum} pixels or larger; got {height} x {width}.")
    if not data_range > 0:
        raise ValueError(f"{name}: data_range must be above 0; got {data_range!r}.")
    _check_range(distorted, reference, float(data_range), name)
    kind = torch.promote_types(distorted.dtype, reference.dtype)
    kind = kind if kind in (torch.float32, torch.float64) else torch.float32
    first, second = (image.reshape(-1, *image.shape[-3:]).to(kind) for image in (distorted, reference))
    white = float(data_range)
    return (first, second) if white == 1.0 else (first / white, second / white)


def _check_range(distorted: Tensor, reference: Tensor, data_range: float, name: str) -> None:
    if torch.compiler.is_compiling() or not reference.numel():
        return
    highest = 0.0
    for which, image in (("distorted", distorted), ("reference", reference)):
        low, high = (float(value) for value in torch.aminmax(image.detach()))
        if not (low >= -SLACK * data_range and high <= (1.0 + SLACK) * data_range):  # NaN too
            raise ValueError(
                f"{name}: {which} must lie in 0..data_range = {data_range:g}; got {low:g}..{high:g}. Set data_range "
                "to the value of white."
            )
        highest = max(highest, high)
    if data_range > 1.5 and reference.is_floating_point() and 0.0 < highest <= max(1.0, FAINT * data_range):
        raise ValueError(
            f"{name}: data_range is {data_range:g}, but no value is above {highest:g}: images in [0, 1] have "
            "data_range=1. (A wrong range adds 48 dB to the PSNR of such images.)"
        )
