"""Readout of a radar's list: values that come again, and speeds far off.

A list that is written in steps holds values that several targets share exactly; noise of a receiver makes none. Speeds
that are folded by the ambiguity, or paired with the wrong chirp, are few and far off, which a spread does not tell from
many that are a little off: the shares of targets beyond several spreads do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAR_OFF_SD", "far_off", "repeated"]

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

FAR_OFF_SD = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 1e4)  # of a target's own spread in clear air


def repeated(values: Floats) -> Flags:
    """Mask of the values ``(F, N)`` that another one of the same frame equals exactly; none of NaN.

    Example:
        >>> repeated(np.array([[-80.0, -75.5, -80.0, np.nan, np.nan]])).tolist()
        [[True, False, True, False, False]]
    """
    order = values.argsort(1)
    ordered = np.take_along_axis(values, order, 1)
    alike = ordered[:, 1:] == ordered[:, :-1]  # NaN equals nothing
    again = np.zeros(values.shape, dtype=bool)
    again[:, 1:] |= alike
    again[:, :-1] |= alike
    found = np.empty_like(again)
    np.put_along_axis(found, order, again, 1)
    return found


def far_off(departure: Floats, spread: Floats) -> Floats:
    """Bin of ``FAR_OFF_SD`` of each departure, ``(F, N, bins)``: 1 there, nowhere where it is nearer or NaN.

    Args:
        departure: ``(F, N)``.
        spread: ``(F, N)``, one standard deviation, in the same unit.

    Example:
        >>> far_off(np.array([[0.1, -1.0, np.nan]]), np.full((1, 3), 0.1))[0].sum(-1).tolist()
        [0.0, 1.0, 0.0]
    """
    size = np.abs(departure) / spread
    low, high = np.array(FAR_OFF_SD[:-1]), np.array(FAR_OFF_SD[1:])
    return ((size[..., None] >= low) & (size[..., None] < high)).astype(np.float64)
