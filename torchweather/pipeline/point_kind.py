"""Kinds of the points of a cloud and of detections."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["PointKind"]


class PointKind(IntEnum):
    """Label of a point of the output.

    Example:
        >>> PointKind(1).name
        'PARTICLE'
    """

    OBJECT = 0
    """A return of the scene, weakened by the weather."""
    PARTICLE = 1
    """A return of a drop, a flake or of fog."""
    LOST = 2
    """No return: the object's went under the threshold, or the beam had none to begin with."""
