"""Noise that a user hands to a transform: its keys, shapes, types and values must be those of a draw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torchweather.core.exceptions import InputTypeError, InputValueError
from torchweather.core.random import ABSENT, Variate

__all__ = ["flat_noise"]

# Least and largest number of each law. A uniform of float16 can round up to 1.
BOUNDS: dict[str, tuple[float, float]] = {
    "uniform": (0.0, 1.0),
    "normal": (-math.inf, math.inf),
    "tabulated_normal": (-math.inf, math.inf),
    "exponential": (0.0, math.inf),
    "points": (0.0, ABSENT),
}
AGAIN = "Use what draw() of this transform gives for this data."


def flat_noise(
    noise: Mapping[str, Tensor],
    variates: Mapping[str, Variate],
    sizes: Mapping[str, int],
    batch: Sequence[int],
    *,
    owner: object,
) -> dict[str, Tensor]:
    """Noise for the samples of a batch in one row, ``(B, *shape)`` each.

    Args:
        noise: ``<stage>.<variate>`` to a tensor that leads with the batch shape, or with (B,), as ``draw`` gives it.
            What it holds for further stages is left aside: the same storm without one of its stages.
        variates: ``<stage>.<variate>`` to the law and shape that are needed.
        sizes: of the data, that shapes refer to.
        batch: batch shape of the data, of B samples.
        owner: for messages.

    Raises:
        InputTypeError: no mapping of tensors of real floating-point numbers.
        InputValueError: a key is missing, a shape does not fit, or a number is NaN, infinite or outside its law. An
            exported or compiled graph checks shapes alone.
    """
    name = type(owner).__name__
    if not isinstance(noise, Mapping):
        raise InputTypeError(
            f"{name}: noise must be a mapping of names to tensors; got {type(noise).__name__}. {AGAIN}"
        )
    lacking = [key for key in variates if key not in noise]
    if lacking:
        raise InputValueError(f"{name}: the noise is of another transform: it lacks {', '.join(lacking[:3])}. {AGAIN}")
    flat = {
        key: _checked(
            noise[key],
            f"{name}: noise {key!r}",
            variate.sample_shape(sizes),
            tuple(batch),
            fewer=variate.law == "points",
            keyed=variate.law == "tabulated_normal",
        )
        for key, variate in variates.items()
    }
    if flat and not torch.compiler.is_compiling():
        _check_values(flat, variates, name)
    return flat


def _checked(
    value: Tensor, what: str, shape: tuple[int, ...], batch: tuple[int, ...], *, fewer: bool, keyed: bool
) -> Tensor:
    """The noise of a variate with its samples in one row; of points there may be ``fewer``, for a lower rate, and of
    tabulated normals the keys of their streams."""
    number = math.prod(batch)
    of_keys = ((*batch, 2), (number, 2))
    if keyed and isinstance(value, Tensor) and value.dtype == torch.int64 and tuple(value.shape) in of_keys:
        shape = (2,)
    elif not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise InputTypeError(f"{what} must be a floating-point tensor; got {got}. {AGAIN}")
    leading = value.shape[: value.ndim - len(shape)] if value.ndim >= len(shape) else None
    if fewer and leading is not None and not torch.compiler.is_compiling():
        shape = (min(shape[0], value.shape[-2]), *shape[1:])
    fits = leading is not None and tuple(value.shape[len(leading) :]) == shape
    if not fits or leading not in (batch, (number,)):
        raise InputValueError(
            f"{what} must hold {shape} for each sample of the batch {batch}; got {tuple(value.shape)}. {AGAIN}"
        )
    return value.reshape(number, *shape)


def _check_values(flat: Mapping[str, Tensor], variates: Mapping[str, Variate], name: str) -> None:
    """Look at the ends of every tensor: one pass each, and one answer from the device."""
    filled = {key: value.detach() for key, value in flat.items() if value.numel() and value.is_floating_point()}
    if not filled:
        return
    ends = torch.stack([torch.stack(torch.aminmax(value)).double().cpu() for value in filled.values()]).tolist()
    for key, (least, most) in zip(filled, ends, strict=True):
        low, high = BOUNDS[variates[key].law]
        if not (low <= least and most <= high and math.isfinite(least) and math.isfinite(most)):
            law = variates[key].law
            raise InputValueError(
                f"{name}: noise {key!r} must be finite numbers of the law {law!r} ({low:g} to {high:g}); got {least:g} "
                f"to {most:g}. {AGAIN}"
            )
