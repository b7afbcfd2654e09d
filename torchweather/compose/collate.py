"""Samples as one batch, for a ``DataLoader``: what has one shape is stacked, clouds of different length are joined."""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.compose.batches import collate_indexed, collate_list, collate_padded
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of, nearest_name
from torchweather.io.point_cloud import PointCloud

__all__ = ["CLOUDS_AS", "Collate"]

CLOUDS_AS = ("padded", "indexed", "list")
"""Ways to join clouds: one tensor with a mask, one tensor with the sample's number in front, or a list."""


@dataclass(frozen=True)
class Collate:
    """A ``collate_fn`` for samples that are dictionaries.

    Args:
        clouds: keys whose values are ``(N_i, C)`` with a length of their own: clouds, lists of detections, boxes as
            rows. They are named, because by chance all clouds of a batch may have one length. A key that no sample of
            a batch has is no error.
        clouds_as: ``padded``: ``(B, N, C)``, rows of zeros (a range of 0: transforms take them for beams without a
            return), and a mask ``(B, N)`` under ``<key>_mask``. ``indexed``: ``(sum N_i, 1 + C)``, the sample's number
            in front, as OpenPCDet and MinkowskiEngine have it. ``list``: the clouds as they are.

    All other tensors and arrays must have one shape and are stacked; numbers become a tensor; anything else (names,
    boxes, a history) becomes a list.

    Example:
        >>> samples = [{"points": torch.ones(n, 4), "image": torch.zeros(1, 2, 2), "name": str(n)} for n in (3, 1)]
        >>> batch = Collate()(samples)
        >>> batch["points"].shape, batch["points_mask"].sum(1), batch["image"].shape, batch["name"]
        (torch.Size([2, 3, 4]), tensor([3, 1]), torch.Size([2, 1, 2, 2]), ['3', '1'])
    """

    clouds: Sequence[str] = ("points",)
    clouds_as: str = "padded"

    def __post_init__(self) -> None:
        check_arguments("Collate(clouds_as: str)", self.clouds_as)
        check_one_of("clouds_as", self.clouds_as, CLOUDS_AS, owner=self)
        keys: tuple[object, ...] = (None,)
        if not isinstance(self.clouds, (str, Tensor, np.ndarray)) and hasattr(self.clouds, "__len__"):
            keys = tuple(self.clouds)
        if not all(isinstance(key, str) for key in keys):
            raise InputTypeError(
                f"Collate: clouds must be a sequence of keys, ({self.clouds!r},); got {self.clouds!r}."
            )
        object.__setattr__(self, "clouds", tuple(self.clouds))

    def __call__(self, samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """The batch; keys in the order of the first sample.

        Args:
            samples: dictionaries with the same keys.

        Raises:
            ValueError: no sample, keys that differ, shapes that differ under a key that is not one of ``clouds``.
        """
        if not samples:
            raise InputValueError("Collate: at least one sample is wanted; got none.")
        first = samples[0]
        for number, sample in enumerate(samples):
            if sample.keys() != first.keys():
                odd = sorted(map(str, sample.keys() ^ first.keys()))
                raise InputValueError(
                    f"Collate: samples must have the same keys; {', '.join(odd)} is only in some (sample {number} "
                    f"differs from sample 0).{nearest_name(odd[0], set(map(str, first)) - set(odd))}"
                )
        batch: dict[str, Any] = {}
        for key in first:
            values = [sample[key] for sample in samples]
            if key not in self.clouds:
                batch[key] = _joined(key, values)
                continue
            rows = [_cloud(key, value) for value in values]
            try:
                if self.clouds_as == "padded":
                    if f"{key}_mask" in first:
                        raise InputValueError(f"the samples hold {key}_mask, the name of the mask.")
                    batch[key], batch[f"{key}_mask"] = collate_padded(rows)
                else:
                    batch[key] = collate_list(rows) if self.clouds_as == "list" else collate_indexed(rows)
            except ValueError as error:
                raise InputValueError(f"Collate: {key!r}: {error}") from error
        return batch


def _cloud(key: str, value: object) -> Tensor:
    if isinstance(value, PointCloud):
        return value.points
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    if not isinstance(value, Tensor):
        raise InputTypeError(f"Collate: {key!r} must be (N, C), a tensor, an array or a PointCloud; got {value!r}.")
    return value


def _joined(key: str, values: list[Any]) -> Any:
    if all(isinstance(value, np.ndarray) and value.dtype.kind in "biuf" for value in values):
        values = [torch.from_numpy(value) for value in values]
    if all(isinstance(value, Tensor) for value in values):
        shapes = {tuple(value.shape) for value in values}
        if len(shapes) > 1:
            raise InputValueError(
                f"Collate: {key!r} must have one shape in all samples; got {', '.join(map(str, sorted(shapes)))}. "
                f"Crop or resize images; where it is a cloud, name it: Collate(clouds=(..., {key!r}))."
            )
        return torch.stack(values)
    if all(isinstance(value, numbers.Real) for value in values):
        return torch.tensor(values)
    return values
