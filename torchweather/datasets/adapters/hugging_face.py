"""Batches of Hugging Face datasets: a dictionary of lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchweather.datasets.adapters.adapter import Adapter, cloud_tensor, depth_tensor, image_tensor, without_lost

__all__ = ["HuggingFaceAdapter"]


@dataclass(frozen=True, eq=False)
class HuggingFaceAdapter(Adapter):
    """Weather for ``Dataset.with_transform`` and ``set_transform``, drawn anew at every access.

    They hand over a batch as a dictionary of lists, one entry a row, also for a single row. Images are pictures of
    Pillow's or arrays ``(H, W)``, ``(H, W, C)``; clouds and depth maps are arrays or nested lists. Under the keys named
    the batch comes back with tensors: images ``(C, H, W)``, clouds ``(N, C)``, depth ``(1, H, W)``; other columns as
    they were.

    Arguments as `Adapter`; ``map`` would store one draw for ever.

    References:
        https://huggingface.co/docs/datasets/image_process (data augmentation with set_transform).

    Example:
        >>> def colder(sample):
        ...     return {**sample, "points": sample["points"] * 0.5}
        >>> batch = {"points": [[[1, 2, 3, 4]], [[5, 6, 7, 8]]], "label": ["car", "van"]}
        >>> HuggingFaceAdapter(colder)(batch)
        {'points': [tensor([[0.5000, 1.0000, 1.5000, 2.0000]]), tensor([[2.5000, 3.0000, 3.5000, 4.0000]])],
         'label': ['car', 'van']}
    """

    def __call__(self, batch: Mapping[str, list[Any]]) -> dict[str, list[Any]]:
        """The batch in the weather, each row drawn by itself."""
        self._check_keys(batch)
        rows = [self._row(dict(zip(batch, values, strict=True))) for values in zip(*batch.values(), strict=True)]
        return {key: [row[key] for row in rows] for key in rows[0]} if rows else dict(batch)

    def _row(self, sample: dict[str, Any]) -> dict[str, Any]:
        tensors = {key: cloud_tensor(sample[key]) for key in self.clouds}
        tensors |= {key: image_tensor(sample[key]) for key in self.images}
        tensors |= {key: depth_tensor(sample[key]) for key in self.depths}
        found = dict(self.transform({**sample, **tensors}))
        if self.drop_lost:
            found |= {key: without_lost(found[key]) for key in self.clouds}
        return found
