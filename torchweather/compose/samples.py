"""Contents of a sample: tensors or numpy arrays, single ones, stacked in a batch, or in a list."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import InputTypeError

__all__ = ["as_tensor", "data_of", "like", "like_batch", "shared"]


def as_tensor(value: Any, key: str) -> Any:
    """A tensor, or a list of tensors, of what a sample holds; numpy arrays share their memory."""
    if isinstance(value, Tensor):
        return value
    if isinstance(value, np.ndarray):
        try:
            return torch.from_numpy(value if value.flags.writeable and value.flags.c_contiguous else value.copy())
        except (TypeError, ValueError) as error:  # words, objects, another byte order
            raise InputTypeError(f"Compose: {key!r} holds a numpy array that torch cannot take: {error}") from error
    if isinstance(value, (list, tuple)) and all(isinstance(one, (Tensor, np.ndarray)) for one in value):
        return [as_tensor(one, key) for one in value]
    if isinstance(value, (bool, int, float, np.generic)):
        try:
            return torch.as_tensor(value)
        except (
            TypeError,
            ValueError,
            RuntimeError,
            OverflowError,
        ) as error:  # more digits than an integer of torch has
            raise InputTypeError(f"Compose: {key!r} holds a number that torch cannot take: {value!r:.100}.") from error
    raise InputTypeError(
        f"Compose: {key!r} must hold a tensor, a numpy array, or a list of them; got {type(value).__name__}."
    )


def data_of(result: Any) -> Any:
    """The data themselves, of a result."""
    if isinstance(result, Tensor):
        return result
    for name in ("bayer", "rgb", "points", "values"):
        if hasattr(result, name):
            return getattr(result, name)
    raise InputTypeError(f"Compose: a result without data: {type(result).__name__}.")


def like(value: Tensor, given: Any) -> Any:
    """A tensor, or a numpy array where one was given."""
    return value.numpy() if isinstance(given, np.ndarray) else value


def like_batch(values: list[Tensor], given: Any) -> Any:
    """Stacked as they came, or a list where they came as one or differ in length."""
    if isinstance(given, (list, tuple)):
        return [like(value, one) for value, one in zip(values, given, strict=True)]
    if len({value.shape for value in values}) > 1:
        return [like(value, given) for value in values]
    return like(torch.stack(values), given)


def shared(value: Tensor) -> Tensor:
    """The tensor, in memory that worker processes see too; a copy of it has to be put there again."""
    value.share_memory_()  # type: ignore[no-untyped-call]
    return value
