"""Image scores of raw mosaics: of each plane of the 2 x 2 cell, or of the colour image after demosaic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from torchweather.camera.bayer import PATTERNS, cfa_index, check_even, split_planes
from torchweather.camera.demosaic import demosaic
from torchweather.camera.tone import srgb_encode
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of, check_positive
from torchweather.core.precision import outside_autocast
from torchweather.metrics.image_scores import IMAGE_SCORES, image_scores
from torchweather.metrics.pairs import check_pair
from torchweather.metrics.score import Collected, ScoreFacts

__all__ = ["ENCODINGS", "SCORED_AS", "BayerScore", "bayer_scores"]

SCORED_AS = ("demosaic", "planes")
"""Parts of a mosaic that can be scored."""

ENCODINGS = ("srgb", "linear")
"""Values that are scored: as a display gets them, or linear in light."""


@outside_autocast
def bayer_scores(
    distorted: Tensor,
    reference: Tensor,
    names: Iterable[str] | None = None,
    *,
    pattern: str,
    scored_as: str = "demosaic",
    encoding: str = "srgb",
    gains: Tensor | Sequence[float] = (1.0, 1.0, 1.0),
    data_range: float = 1.0,
) -> dict[str, Tensor]:
    """Several scores of raw mosaics.

    Both mosaics take one way: light in [0, 1], white balance and clipping at 1, demosaic or planes, clipping to
    [0, 1], sRGB. Image scores are made for display values, where equal steps look equal; linear light weighs the dark
    parts of a frame less.

    Args:
        distorted, reference: ``(..., 1, H, W)``, linear in light, in ``[0, data_range]``, H and W even; black is 0
            (``torchweather.image.normalise`` takes a black level away; clip what it leaves below 0).
        names: of ``IMAGE_SCORES``; ``None``: all of them.
        pattern: one of ``torchweather.image.PATTERNS``, the top-left cell read in rows.
        scored_as: ``demosaic``: the colour image of ``torchweather.image.demosaic``; ``planes``: each pixel of the
            2 x 2 cell as a grey image of half the size, nothing interpolated.
        encoding: ``srgb`` (display values) or ``linear``.
        gains: factors of red, green (or clear), blue, above 0, alike for both mosaics.
        data_range: value of white less that of black; an integer mosaic needs it, such as 4095 of 12 bits.

    Returns:
        Name to scores in the order asked for: ``(...)`` of ``demosaic``; ``(..., 4)`` of ``planes``, in the order of
        the cell: top left, top right, bottom left, bottom right. Differentiable as the scores are.

    Note:
        All fourteen scores take 161 pixels a side: of a mosaic scored as planes, 322. An ``RCCB`` mosaic is demosaiced
        with an assumed mixture of its clear pixels, which triples their noise in green; its planes assume nothing.

    References:
        sRGB: IEC 61966-2-1:1999. Scores: METRICS.md 1.

    Example:
        >>> clear = torch.rand(1, 32, 32, generator=torch.Generator().manual_seed(1))
        >>> veiled = 0.5 * clear + 0.2
        >>> bayer_scores(veiled, clear, ["gmsd"], pattern="RGGB")["gmsd"].shape
        torch.Size([])
        >>> bayer_scores(veiled, clear, ["gmsd"], pattern="RGGB", scored_as="planes")["gmsd"].shape
        torch.Size([4])
    """
    check_arguments(
        "bayer_scores(distorted: Tensor, reference: Tensor, pattern: str, scored_as: str, encoding: str, "
        "gains: Tensor | Sequence[float], data_range: float)",
        distorted,
        reference,
        pattern,
        scored_as,
        encoding,
        gains,
        data_range,
    )
    check_one_of("pattern", pattern, PATTERNS, owner="bayer_scores")
    check_one_of("scored_as", scored_as, SCORED_AS, owner="bayer_scores")
    check_one_of("encoding", encoding, ENCODINGS, owner="bayer_scores")
    mosaics = _mosaic("distorted", distorted), _mosaic("reference", reference)
    pair = check_pair(*mosaics, data_range, channels=(1,), owner="bayer_scores")
    if data_range <= 1.0 and not (distorted.is_floating_point() and reference.is_floating_point()):
        raise InputValueError(
            "bayer_scores: a mosaic of integers needs data_range, the value of white, such as 4095 of 12 bits; got "
            f"{data_range:g}."
        )
    factors = _factors(gains, pair[1])
    first, second = (_pictures(light, pattern, scored_as, encoding, factors) for light in pair)
    scores = image_scores(first, second, names)
    shape = distorted.shape[:-3] if scored_as == "demosaic" else (*distorted.shape[:-3], 4)
    return {name: score.reshape(shape) for name, score in scores.items()}


class BayerScore(Collected):
    """A score of raw mosaics, collected over batches.

    Args:
        name: of ``IMAGE_SCORES``.
        pattern, options: as in ``bayer_scores``.

    Example:
        >>> score = BayerScore("psnr", pattern="RGGB", scored_as="planes", encoding="linear")
        >>> score.update(torch.full((2, 1, 8, 8), 0.5), torch.full((2, 1, 8, 8), 0.6))
        >>> score.compute().round(decimals=3), score.per_image().shape
        (tensor([20., 20., 20., 20.], dtype=torch.float64), torch.Size([2, 4]))
    """

    def __init__(self, name: str, *, pattern: str, **options: Any) -> None:
        check_arguments("BayerScore(name: str, pattern: str)", name, pattern)
        super().__init__(name, "mosaic")
        check_one_of("score", name, IMAGE_SCORES, owner=self)
        self.name, self.pattern, self.options = name, pattern, options

    @property
    def facts(self) -> ScoreFacts:
        """Facts of the score."""
        return IMAGE_SCORES[self.name]

    @property
    def higher_is_better(self) -> bool:
        """Or lower."""
        return self.facts.higher_is_better

    def forward(self, distorted: Tensor, reference: Tensor) -> Tensor:
        """Score of each mosaic, ``(...)`` or ``(..., 4)``; nothing is collected, gradients flow."""
        return bayer_scores(distorted, reference, [self.name], pattern=self.pattern, **self.options)[self.name]

    def update(self, distorted: Tensor, reference: Tensor) -> None:
        """Collect the scores of mosaics ``(..., 1, H, W)``."""
        with torch.no_grad():
            found = self(distorted, reference)
            self._collect(found.flatten(0, distorted.ndim - 4) if distorted.ndim > 3 else found[None])

    def per_image(self) -> Tensor:
        """``(n,)`` scores of all mosaics so far, or ``(n, 4)`` of their planes, float64, in order."""
        return self._collected()


def _pictures(light: Tensor, pattern: str, scored_as: str, encoding: str, factors: Tensor) -> Tensor:
    """Images ``(B, 3, H, W)`` or ``(4 B, 1, H/2, W/2)`` in [0, 1] of mosaics ``(B, 1, H, W)``."""
    index = cfa_index(light.shape[-2], light.shape[-1], pattern, light.device)
    # Clipped before the colours are mixed: a saturated pixel is white under any gains.
    balanced = (light * factors[index]).clamp(0.0, 1.0)
    image = demosaic(balanced, pattern) if scored_as == "demosaic" else split_planes(balanced).flatten(0, 1)[:, None]
    return srgb_encode(image) if encoding == "srgb" else image.clamp(0.0, 1.0)


def _factors(gains: Tensor | Sequence[float], like: Tensor) -> Tensor:
    factors = torch.as_tensor(gains, dtype=like.dtype, device=like.device)
    if factors.shape != (3,):
        raise InputValueError(
            f"bayer_scores: gains must be three factors, of red, green (or clear), blue; got shape "
            f"{tuple(factors.shape)}."
        )
    check_positive("gains", factors, owner="bayer_scores")
    return factors


def _mosaic(which: str, mosaic: Tensor) -> Tensor:
    """A mosaic of whole cells, in a type that torch finds the extremes of."""
    if not isinstance(mosaic, Tensor):
        raise InputTypeError(f"bayer_scores: {which} must be a tensor (..., 1, H, W); got {type(mosaic).__name__}.")
    if mosaic.ndim >= 3 and mosaic.shape[-3] == 3:
        raise InputValueError(
            f"bayer_scores: {which} must be a mosaic (..., 1, H, W); got {tuple(mosaic.shape)}. Colour images are for "
            "image_scores."
        )
    check_even(mosaic, "bayer_scores")
    return mosaic.int() if mosaic.dtype == torch.uint16 else mosaic
