"""Comparisons, the places where a mask is true, and ends of values, by what is fast on the processor.

numpy takes an eighth of torch's time to compare and to find places: 7 against 63 microseconds, and 62 against 530 for a
mask without a pattern, of 65,536 numbers. Ends of values from 0 on are those of the whole numbers with the same bits:
1.5 against 1.9 milliseconds of 2.8 million, and one end by numpy 1.1 against 1.5. The results are the same.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["compare", "ends_of", "least_of", "most_of", "places_of"]

COMPARISONS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "<": (operator.lt, np.less),
    "<=": (operator.le, np.less_equal),
    ">": (operator.gt, np.greater),
    ">=": (operator.ge, np.greater_equal),
}


def _is_array(values: Tensor) -> bool:
    """True where numpy takes the values."""
    known = values.device.type == "cpu" and values.ndim > 0 and values.dtype != torch.bfloat16
    return known and not torch.compiler.is_compiling()


def compare(values: Tensor, sign: str, bound: Tensor | float) -> Tensor:
    """Mask of the values that are ``<``, ``<=``, ``>`` or ``>=`` a bound, one for each or one for all."""
    by_torch, by_numpy = COMPARISONS[sign]
    if not _is_array(values):
        found: Tensor = by_torch(values, bound)
        return found
    other = bound.detach().numpy() if isinstance(bound, Tensor) else bound
    return torch.from_numpy(by_numpy(values.detach().numpy(), other))


def ends_of(values: Tensor) -> tuple[float, float]:
    """Least and largest of some values, one or more; NaN twice where one of them is."""
    values = values.detach()
    if values.device.type != "cpu" or values.dtype != torch.float32:
        low, high = torch.aminmax(values)
        return float(low), float(high)
    ends = torch.stack(torch.aminmax(values.view(torch.int32)))
    if int(ends[0]) < 0:  # the sign is the first bit
        array = values.numpy()
        return float(array.min()), float(array.max())
    least, most = ends.view(torch.float32).tolist()
    return (least, most) if most == most else (most, most)  # the bits of NaN are above those of infinity


def least_of(values: Tensor) -> float:
    """Least of some values, one or more; NaN where one of them is."""
    values = values.detach()
    return float(values.numpy().min() if _is_array(values) else values.amin())


def most_of(values: Tensor) -> float:
    """Largest of some values, one or more; NaN where one of them is."""
    values = values.detach()
    return float(values.numpy().max() if _is_array(values) else values.amax())


def places_of(mask: Tensor) -> Tensor:
    """Indices ``(n,)`` of the true entries of a mask ``(P,)``, in order."""
    if not _is_array(mask):
        return mask.nonzero().squeeze(1)
    return torch.from_numpy(np.flatnonzero(mask.numpy()))
