"""Scores collected over a data set, of images and of point clouds, with update, compute and reset."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError
from torchweather.metrics.cloud_scores import cloud_scores
from torchweather.metrics.clouds import Clouds

__all__ = ["CloudScore", "Collected", "ImageScore", "ScoreFacts"]


@dataclass(frozen=True)
class ScoreFacts:
    """Facts of a score.

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


class Collected(nn.Module):
    """Scores of many images or clouds, float64 on the CPU, in the order in which they came.

    Args:
        name: of the score, for messages.
        of: what is scored, for messages.
    """

    def __init__(self, name: str, of: str) -> None:
        super().__init__()
        self._name, self._of = name, of
        self._scores: list[Tensor] = []

    def _collect(self, scores: Tensor) -> None:
        self._scores.append(scores.detach().double().cpu())

    def _collected(self) -> Tensor:
        if not sum(len(scores) for scores in self._scores):
            raise InputValueError(
                f"{self._name}: no {self._of} was scored; call update(distorted, reference) before compute()."
            )
        return torch.cat(self._scores)

    def compute(self) -> Tensor:
        """Mean over all so far; infinite where one is (PSNR of identical images, distance to an empty cloud)."""
        return self._collected().mean(0)

    def reset(self) -> None:
        """Forget what was scored so far."""
        self._scores = []


class ImageScore(Collected):
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
        check_arguments("ImageScore(facts: ScoreFacts, data_range: float)", facts, data_range)
        super().__init__(getattr(facts.function, "__name__", "score"), "image")
        self.facts, self.data_range, self.options = facts, float(data_range), options

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
            self._collect(self(distorted, reference).reshape(-1))

    def per_image(self) -> Tensor:
        """``(n,)`` scores of all images so far, float64, in order."""
        return self._collected()


class CloudScore(Collected):
    """A score of point clouds, collected over clouds, padded batches and lists of clouds of any sizes.

    Args:
        name: of ``CLOUD_SCORES``, or ``chamfer`` or ``chamfer_squared``.
        options: of ``cloud_scores``: ``correspondence``, ``direction``, ``region``, ``seed``, ``search``.

    Example:
        >>> score = CloudScore("hd", direction="to_reference")
        >>> clear = torch.tensor([[1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
        >>> score.update([clear + 0.5, clear], [clear, clear[:1]])
        >>> score.per_cloud().round(decimals=3), round(float(score.compute()), 3)
        (tensor([0.8660, 4.0000], dtype=torch.float64), 2.433)
    """

    higher_is_better = False
    low = 0.0
    ideal = 0.0

    def __init__(self, name: str, **options: Any) -> None:
        check_arguments("CloudScore(name: str)", name)
        super().__init__(name, "cloud")
        self.name, self.options = name, options
        self._scored([], [])  # no clouds: name and options are checked here, not in the first update

    @property
    def high(self) -> float:
        """Largest value: 1 of ``sdm``; distances have no bound."""
        return 1.0 if self.name == "sdm" else math.inf

    def forward(
        self,
        distorted: Clouds,
        reference: Clouds,
        *,
        distorted_valid: Clouds | None = None,
        reference_valid: Clouds | None = None,
    ) -> Tensor:
        """Score of each cloud, ``(...)`` or one for each of a list; nothing is collected, gradients flow.

        Args:
            distorted, reference: one cloud ``(N, 3 or more)``, a padded batch ``(..., N, 3 or more)`` or a list.
            distorted_valid, reference_valid: ``(..., N)`` bool or a list; false for padding.
        """
        return self._scored(distorted, reference, distorted_valid=distorted_valid, reference_valid=reference_valid)

    def update(
        self,
        distorted: Clouds,
        reference: Clouds,
        *,
        distorted_valid: Clouds | None = None,
        reference_valid: Clouds | None = None,
    ) -> None:
        """Collect the scores of clouds, which are given as in ``forward``."""
        with torch.no_grad():
            found = self(distorted, reference, distorted_valid=distorted_valid, reference_valid=reference_valid)
            self._collect(found.reshape(-1))

    def per_cloud(self) -> Tensor:
        """``(n,)`` scores of all clouds so far, float64, in order."""
        return self._collected()

    def _scored(self, distorted: Clouds, reference: Clouds, **valid: Any) -> Tensor:
        return cloud_scores(distorted, reference, names=(self.name,), owner=self, **valid, **self.options)[self.name]
