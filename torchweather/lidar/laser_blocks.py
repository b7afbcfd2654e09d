"""Blocks of a LiDAR's lasers that start at about the same height."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["height_blocks"]

# Lasers this near to each other are one block: 0.02 m is 0.1 degree at 10 m.
_BLOCK_M = 0.02


def height_blocks(heights: Sequence[float]) -> list[list[int]]:
    """Rings by blocks of lasers whose heights are alike.

    Args:
        heights: of every ring's laser, metres.

    Returns:
        Numbers of the rings of each block, the lowest block first.

    Example:
        >>> height_blocks((0.20, 0.21, 0.12, 0.13))
        [[2, 3], [0, 1]]
    """
    blocks: list[list[int]] = []
    lowest = -math.inf
    for ring in sorted(range(len(heights)), key=lambda ring: heights[ring]):
        if heights[ring] - lowest > _BLOCK_M:
            blocks.append([])
            lowest = heights[ring]
        blocks[-1].append(ring)
    return blocks
