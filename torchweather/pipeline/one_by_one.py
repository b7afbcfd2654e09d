"""Batches whose samples differ in what a transform is built from: each sample alone, then put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import torch
from torch import Tensor

__all__ = ["one_by_one", "sample_of"]


def one_by_one(
    call: Callable[..., Any],
    data: Tensor,
    seeds: Sequence[int],
    beside: Mapping[str, Any],
    sizes: Mapping[str, int],
    *,
    dimensions: int,
    listed: bool = False,
) -> Any:
    """Results of a call for each sample of a batch, put together as those of a batch.

    Args:
        call: takes the data of one sample, ``seed=`` and what stands beside the data.
        data: with the batch's dimensions in front.
        seeds: one integer for each sample, row-major.
        beside: other arguments of the call, by name; of the whole batch or of one sample.
        sizes: dimensions of each of them in one sample.
        dimensions: of the data of one sample.
        listed: return clouds as lists, as ``lost="drop"`` does. Clouds of different lengths are lists in any case.

    Example:
        >>> one_by_one(lambda one, seed: one + seed, torch.zeros(2, 3), [5, 7], {}, {}, dimensions=1)
        tensor([[5., 5., 5.],
                [7., 7., 7.]])
    """
    batch = tuple(data.shape[: data.ndim - dimensions])
    flat = data.reshape(-1, *data.shape[len(batch) :])
    found = []
    for place, seed in enumerate(seeds):
        own = {name: sample_of(value, sizes.get(name, 0), batch, place) for name, value in beside.items()}
        found.append(call(flat[place], seed=seed, **own))
    return _joined(found, batch, listed)


def sample_of(value: Any, dimensions: int, batch: Sequence[int], place: int) -> Any:
    """One sample's share of an argument beside the data.

    Args:
        value: a tensor, with a batch in front or without; what has ``of_sample``; anything else is of all samples.
        dimensions: of the tensor in one sample.
        batch: the batch shape.
        place: of the sample, row-major.
    """
    if hasattr(value, "of_sample"):
        return value.of_sample(place)
    if not isinstance(value, Tensor) or value.ndim <= dimensions:
        return value
    alone = value.shape[value.ndim - dimensions :]
    return value.expand(*batch, *alone).reshape(-1, *alone)[place]


def _joined(found: Sequence[Any], batch: Sequence[int], listed: bool) -> Any:
    """Tensors stacked to the batch shape; results field by field; what is no tensor as of the first sample."""
    first = found[0]
    if is_dataclass(first) and not isinstance(first, type):
        values = {}
        for field in fields(first):
            # "Cloud" and "List" are what a transform may give as a list; a "Tensor" is of one shape in all samples.
            as_list = listed and "Tensor" not in str(field.type)
            values[field.name] = _joined([getattr(one, field.name) for one in found], batch, as_list)
        return type(first)(**values)
    if not isinstance(first, Tensor):
        return first
    if listed or len({one.shape for one in found}) > 1:
        return list(found)
    return torch.stack(list(found)).reshape(*batch, *first.shape)
