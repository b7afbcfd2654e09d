"""mmdetection3d's results dictionary, as its pipelines pass it on."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchweather.core.errors import InputValueError
from torchweather.datasets.adapters.adapter import Adapter, array_from_image, depth_tensor, image_tensor, without_lost

__all__ = ["Mmdet3dAdapter"]

# Labels of every point: a particle would keep the label of what it hides, and rows that are left out would shift them.
_POINT_LABELS = ("pts_semantic_mask", "pts_instance_mask")


@dataclass(frozen=True, eq=False)
class Mmdet3dAdapter(Adapter):
    """Weather as a step of an mmdetection3d pipeline, behind the loading steps and before those that move points.

    ``points`` are a ``BasePoints``: an object whose ``tensor`` is ``(N, points_dim)``; what comes back is of its class,
    with the same ``attribute_dims``. ``img`` is numpy ``(H, W, 3)`` in blue, green, red, uint8 or float32 in 0..255, as
    ``LoadImageFromFile`` gives it. ``gt_bboxes_3d``, ``gt_labels_3d`` and all others pass through.

    Arguments as `Adapter`, and:

    Args:
        bgr: images are blue, green, red; ``False`` where a step has turned them to red, green, blue.
        float_white: value of white in images of floats.

    Raises:
        ValueError: a key is missing, or there are labels of points (``pts_semantic_mask``): what the weather makes of
            these says `merge_kind`, with ``kind`` and ``source`` of ``run()``.

    References:
        https://github.com/open-mmlab/mmdetection3d: docs/en/user_guides/data_pipeline.md (keys of each step),
        mmdet3d/structures/points/base_points.py.

    Example:
        >>> import torch
        >>> from types import SimpleNamespace
        >>> def colder(sample):
        ...     return {**sample, "points": sample["points"] * 0.5}
        >>> results = {"points": SimpleNamespace(tensor=torch.ones(1, 4)), "gt_labels_3d": [0]}
        >>> Mmdet3dAdapter(colder)(results)["points"].tensor
        tensor([[0.5000, 0.5000, 0.5000, 0.5000]])
    """

    bgr: bool = True
    float_white: float = 255.0

    def __call__(self, results: Mapping[str, Any]) -> dict[str, Any]:
        """The results in the weather; the dictionary that came in is not changed."""
        self._check_keys(results)
        labels = [key for key in _POINT_LABELS if results.get(key) is not None]
        if labels and self.clouds:
            raise InputValueError(
                f"Mmdet3dAdapter: {labels[0]} labels every point, and particles and lost points need labels of their "
                "own. Call run() of the LiDAR's transform and take merge_kind(labels, result.kind, result.source)."
            )
        tensors = {key: results[key].tensor for key in self.clouds}
        tensors |= {key: image_tensor(results[key], bgr=self.bgr, float_white=self.float_white) for key in self.images}
        tensors |= {key: depth_tensor(results[key]) for key in self.depths}
        found = dict(self.transform({**results, **tensors}))
        for key in self.clouds:
            cloud = without_lost(found[key]) if self.drop_lost else found[key]
            found[key] = copy.copy(results[key])
            found[key].tensor = cloud
        for key in self.images:
            found[key] = array_from_image(found[key], results[key], bgr=self.bgr, float_white=self.float_white)
        return {**found, **{key: results[key] for key in self.depths}}
