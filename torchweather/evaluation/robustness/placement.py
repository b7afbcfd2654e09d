"""A frame brought into a detector's input, and what the detector found brought back into the frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["Placement", "placed"]

Array = NDArray[Any]
LEVELS = 255.0  # of 8 bits, in which the border is declared


@dataclass(frozen=True)
class Placement:
    """Where a frame lies in a detector's input.

    Args:
        frame: height and width of the frame, pixels.
        taken: height and width of the input.
        top, left: of the frame in the input, pixels.
        height, width: of the frame in the input; what is left over is border.

    Example:
        >>> Placement((100, 200), (64, 64), top=16, left=0, height=32, width=64).to_frame(np.array([[0., 16, 64, 48]]))
        array([[  0.,   0., 200., 100.]])
    """

    frame: tuple[int, int]
    taken: tuple[int, int]
    top: int
    left: int
    height: int
    width: int

    def to_frame(self, boxes: Array) -> Array:
        """Boxes ``(N, 4)`` left, top, right, bottom in pixels of the input, in pixels of the frame, cut at its edge."""
        offset = np.array([self.left, self.top] * 2, dtype=np.float64)
        scale = np.array([self.frame[1] / self.width, self.frame[0] / self.height] * 2)
        edge = np.array([self.frame[1], self.frame[0]] * 2, dtype=np.float64)
        found: Array = ((boxes - offset) * scale).clip(0.0, edge)
        return found

    def map_to_frame(self, logits: Tensor) -> Tensor:
        """Maps ``(K, h, w)`` over the whole input, of any size, as maps over the frame ``(K, H, W)``."""
        whole = logits[None].float()
        if (self.height, self.width) != self.taken:
            whole = F.interpolate(whole, size=self.taken, mode="bilinear")
            whole = whole[..., self.top : self.top + self.height, self.left : self.left + self.width]
        if tuple(whole.shape[-2:]) != self.frame:
            whole = F.interpolate(whole, size=self.frame, mode="bilinear")
        return whole[0]


def placed(image: Tensor, declared: Mapping[str, Any]) -> tuple[Tensor, Placement]:
    """A frame ``(C, H, W)`` in [0, 1] as the input has it, and where it lies there.

    Args:
        image: picture or mosaic.
        declared: ``size``, ``fit``, ``enlarge``, ``fill`` and ``multiple`` of the declaration's input.

    Example:
        >>> input, place = placed(torch.ones(3, 50, 100), {"size": [64, 64], "fit": "letterbox", "fill": 0})
        >>> input.shape, place.top, place.height, float(input[0, 0, 0])
        (torch.Size([3, 64, 64]), 16, 32, 0.0)
    """
    frame = (int(image.shape[-2]), int(image.shape[-1]))
    taken, inner = _sizes(frame, declared)
    if inner != frame:
        image = F.interpolate(image[None], size=inner, mode="bilinear", antialias=True, align_corners=False)[0]
        image = image.clamp(0.0, 1.0)
    top = left = 0
    if declared.get("fit") == "letterbox":
        top, left = (taken[0] - inner[0]) // 2, (taken[1] - inner[1]) // 2
    if inner != taken:
        fill = torch.as_tensor(declared["fill"], dtype=image.dtype).reshape(-1, 1, 1) / LEVELS
        whole = fill.expand(image.shape[0], *taken).clone()
        whole[:, top : top + inner[0], left : left + inner[1]] = image
        image = whole
    return image, Placement(frame, taken, top, left, *inner)


def _sizes(frame: tuple[int, int], declared: Mapping[str, Any]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size of the input, and of the frame in it."""
    if declared["size"] is None:
        multiple = int(declared.get("multiple", 1))
        height, width = (-(-side // multiple) * multiple for side in frame)
        return (height, width), frame
    height, width = declared["size"]
    if declared.get("fit", "stretch") == "stretch":
        return (height, width), (height, width)
    scale = min(height / frame[0], width / frame[1])
    if not declared.get("enlarge", True):
        scale = min(scale, 1.0)
    inner = tuple(max(1, round(side * scale)) for side in frame)
    return (height, width), (min(inner[0], height), min(inner[1], width))
