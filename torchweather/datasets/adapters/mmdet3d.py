"""mmdetection3d's results dictionary, as its pipelines pass it on."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import InputValueError
from torchweather.datasets.adapters.adapter import (
    Adapter,
    array_from_image,
    depth_tensor,
    image_tensor,
    is_return,
    without_lost,
)
from torchweather.pipeline.point_kind import PointKind

__all__ = ["Mmdet3dAdapter"]

# Labels of every point: a particle would keep the label of what it hides, and rows that are left out would shift them.
_SEMANTIC, _INSTANCE = "pts_semantic_mask", "pts_instance_mask"
_POINT_LABELS = (_SEMANTIC, _INSTANCE)
_FOR_EVALUATION = "eval_ann_info"  # holds the same labels once more


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
        particle_class: class of particles in ``pts_semantic_mask``, as the mask counts (before or behind
            ``PointSegClassMapping``); their instance is 0. ``eval_ann_info`` follows too.
        lost_class: class of lost points, where ``drop_lost`` leaves them in; ``None`` is ``particle_class``.

    Raises:
        ValueError: a key is missing; there are labels of points and no ``particle_class``, several clouds, labels of
            another number of points, or a transform without ``run()``, which tells what each point is (`Compose` has
            it).

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
    particle_class: int | None = None
    lost_class: int | None = None

    def __call__(self, results: Mapping[str, Any]) -> dict[str, Any]:
        """The results in the weather; the dictionary that came in is not changed."""
        self._check_keys(results)
        tensors = {key: results[key].tensor for key in self.clouds}
        tensors |= {key: image_tensor(results[key], bgr=self.bgr, float_white=self.float_white) for key in self.images}
        tensors |= {key: depth_tensor(results[key]) for key in self.depths}
        sample = {**results, **tensors}
        labelled = bool(self.clouds) and any(results.get(key) is not None for key in _POINT_LABELS)
        if labelled:
            self._check_labels(results)
            found, what = self.transform.run(sample)  # type: ignore[attr-defined]
            found = self._with_labels(dict(found), what.get(self.clouds[0]))
        else:
            found = dict(self.transform(sample))
        for key in self.clouds:
            cloud = without_lost(found[key]) if self.drop_lost else found[key]
            found[key] = copy.copy(results[key])
            found[key].tensor = cloud
        for key in self.images:
            found[key] = array_from_image(found[key], results[key], bgr=self.bgr, float_white=self.float_white)
        return {**found, **{key: results[key] for key in self.depths}}

    def _check_labels(self, results: Mapping[str, Any]) -> None:
        """Refuse labels of points that cannot follow them."""
        present = [key for key in _POINT_LABELS if results.get(key) is not None]
        if self.particle_class is None or not hasattr(self.transform, "run") or len(self.clouds) > 1:
            raise InputValueError(
                f"Mmdet3dAdapter: {present[0]} labels every point, and particles and lost points need labels of their "
                "own. Give particle_class=, one cloud, and a transform whose run() gives the kind of each point, as "
                "that of Compose does. Or call run() of the LiDAR's transform and take "
                "merge_kind(labels, result.kind, result.source)."
            )
        rows = len(results[self.clouds[0]].tensor)
        for key in present:
            if len(results[key]) != rows:
                raise InputValueError(f"Mmdet3dAdapter: {key} must label {rows} points; got {len(results[key])}.")

    def _with_labels(self, found: dict[str, Any], result: Any) -> dict[str, Any]:
        """The labels of the points that came out; ``result`` is ``None`` in clear air."""
        cloud = found[self.clouds[0]]
        kept = is_return(cloud) if self.drop_lost else torch.ones(len(cloud), dtype=torch.bool)
        others = dict(found.get(_FOR_EVALUATION) or {})
        particle_class = int(self.particle_class or 0)
        lost_class = particle_class if self.lost_class is None else int(self.lost_class)
        for holder in (found, others):
            for key in _POINT_LABELS:
                if holder.get(key) is None:
                    continue
                classes = (particle_class, lost_class) if key == _SEMANTIC else (0, 0)
                holder[key] = _followed(holder[key], result, classes, kept)
        return {**found, _FOR_EVALUATION: others} if _FOR_EVALUATION in found else found


def _followed(labels: Any, result: Any, classes: tuple[int, int], kept: Tensor) -> Any:
    """Labels of the points that came out, an array or a tensor as they were.

    Args:
        labels: ``(N,)`` of the cloud that went in.
        result: of the LiDAR's transform; ``None`` where nothing was done.
        classes: of particles, and of lost points.
        kept: ``(K,)`` rows that are not left out.
    """
    is_array = isinstance(labels, np.ndarray)
    values = torch.from_numpy(labels.copy()) if is_array else labels
    if result is not None:
        source = result.source.to(values.device).long()
        particle = result.kind.to(values.device) == int(PointKind.PARTICLE)
        lost = (result.kind.to(values.device) == int(PointKind.LOST)) | ((source < 0) & ~particle)
        values = values[source.clamp_min(0)] if len(values) else values.new_zeros(len(source))
        values = torch.where(particle, values.new_tensor(classes[0]), values)
        values = torch.where(lost, values.new_tensor(classes[1]), values)
    values = values[kept.to(values.device)]
    return values.numpy() if is_array else values
