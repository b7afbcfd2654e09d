"""Pooling of local likeness to one number per image."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["chroma_likeness", "likeness", "ratio", "stretched", "weighted_mean"]


def ratio(above: Tensor, below: Tensor) -> Tensor:
    """``above / below``, and 0 with gradient 0 where ``below`` is 0."""
    there = below != 0
    safe = torch.where(there, below, torch.ones_like(below))
    return torch.where(there, above / safe, torch.zeros_like(above))


def likeness(first: Tensor, second: Tensor, constant: float) -> Tensor:
    """``(2 a b + c) / (a^2 + b^2 + c)``: 1 where both agree."""
    return (2.0 * first * second + constant) / (first.square() + second.square() + constant)


def chroma_likeness(first: Tensor, second: Tensor, constant: float, power: float) -> Tensor:
    """Product of the likeness of two planes of colour each ``(B, 2, H, W)``, to a small power: ``(B, 1, H, W)``.

    Opposite colours make the product negative; its absolute value is taken.
    """
    product = likeness(first, second, constant).prod(1, keepdim=True).abs()
    there = product > 0
    return torch.where(there, torch.where(there, product, torch.ones_like(product)) ** power, torch.zeros_like(product))


def weighted_mean(value: Tensor, weight: Tensor) -> Tensor:
    """Mean ``(B,)`` over all pixels; where an image has no weight at all, the plain mean."""
    value, weight = value.flatten(1), weight.flatten(1)
    total = weight.sum(1)
    return torch.where(total > 0, ratio((value * weight).sum(1), total), value.mean(1))


def stretched(plane: Tensor) -> Tensor:
    """Each image ``(B, 1, H, W)`` brought to 0..1; a flat one to 0."""
    low, high = plane.amin((1, 2, 3), keepdim=True), plane.amax((1, 2, 3), keepdim=True)
    return ratio(plane - low, (high - low).expand_as(plane))
