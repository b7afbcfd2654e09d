"""ImageScore: a score of images collected over a data set, with update, compute and reset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

__all__ = ["ImageScore", "ScoreFacts"]


@dataclass(frozen=True)
class ScoreFacts:
    """What a score is.

    Args:
        function: ``(distorted, reference, *, data_range)`` to one score per image.
        higher_is_better: or lower.
        low, high: its range.
        ideal: score of identical images.
        minimum: least height and width of an image, pixels.
    """

    function: Callable[..., Tensor]
    higher_is_better: bool
    low: float
    high: float
    ideal: float
    minimum: int


class ImageScore(nn.Module):
    """A score of images, collected over batches.

    Args:
        facts: the score.
        data_range: value of white.
        options: of the score's function.

    Example:
        >>> from torchweather.metrics.psnr import psnr
        >>> score = ImageScore(ScoreFacts(psnr, True, 0.0, float("inf"), float("inf"), 1))
        >>> score.update(torch.full((2, 3, 4, 4), 0.5), torch.full((2, 3, 4, 4), 0.6))
        >>> round(float(score.compute()), 3), score.per_image().shape
        (20.0, torch.Size([2]))
    """

    def __init__(self, facts: ScoreFacts, *, data_range: float = 1.0, **options: Any) -> None:
        super().__init__()
        self.facts, self.data_range, self.options = facts, float(data_range), options
        self._scores: list[Tensor] = []

    @property
    def higher_is_better(self) -> bool:
        """Or lower."""
        return self.facts.higher_is_better

    def forward(self, distorted: Tensor, reference: Tensor) -> Tensor:
        """Score of each image, ``(...)``; nothing is collected, gradients flow."""
        return self.facts.function(distorted, reference, data_range=self.data_range, **self.options)

    def update(self, distorted: Tensor, reference: Tensor) -> None:
        """Collect the scores of images ``(..., C, H, W)``."""
        with torch.no_grad():
            self._scores.append(self(distorted, reference).reshape(-1).double().cpu())

    def per_image(self) -> Tensor:
        """``(n,)`` scores of all images so far, float64, in order."""
        if not self._scores:
            name = getattr(self.facts.function, "__name__", "score")
            raise ValueError(f"{name}: no image was scored; call update(distorted, reference) before compute().")
        return torch.cat(self._scores)

    def compute(self) -> Tensor:
        """Mean over all images so far; infinite where one is (PSNR of identical images)."""
        return self.per_image().mean()

    def reset(self) -> None:
        """Forget the images so far."""
        self._scores = []
