"""Curves of the pictures of effects: averages and counts in bins of an axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_VALUES", "Array", "Curve", "bins", "density", "in_bins", "middle"]

Array = NDArray[Any]
Curve = tuple[Array, Array]
"""x and y."""

LEAST_VALUES = 20  # in a bin that is drawn; fewer say little


def bins(low: float, high: float, step: float) -> Array:
    """Edges from low to high."""
    return np.arange(low, high + 0.5 * step, step)


def middle(edges: Array) -> Array:
    """Centres of the bins between the edges."""
    found: Array = 0.5 * (edges[1:] + edges[:-1])
    return found


def in_bins(
    axis: Array,
    values: Array,
    edges: Array,
    average: Callable[[Array], Any] = np.mean,
    least: int = LEAST_VALUES,
) -> Curve:
    """Average of the values in each bin of the axis; NaN where there are few. Values that are NaN do not count."""
    place = np.digitize(axis, edges) - 1
    found = np.full(len(edges) - 1, np.nan)
    for number in range(len(found)):
        inside = values[place == number]
        inside = inside[~np.isnan(inside)]
        if len(inside) >= least:
            found[number] = average(inside)
    return middle(edges), found


def density(values: Array, edges: Array, per: float) -> Curve:
    """Finite values in each unit of their axis, over ``per``."""
    counts, _ = np.histogram(values[np.isfinite(values)], edges)
    return middle(edges), counts / np.diff(edges) / per
