"""Columns of a cloud that label its points: what weather does to them."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.io.labels import FALLING_SNOW, UNLABELLED
from torchweather.io.point_cloud import PointCloud
from torchweather.pipeline.point_kind import PointKind

__all__ = ["label_columns", "with_labels_of"]

# Names, lower case without underscores, and the class of a particle: SemanticKITTI's and WADS' falling snow; LAS keeps
# 7 for noise, in all of its point formats; CARLA tags nothing with 0.
_CLASSES = {
    **dict.fromkeys(("label", "labels", "class", "classid", "semantic", "semanticlabel", "semlabel"), FALLING_SNOW),
    **dict.fromkeys(("semanticclass", "semclass", "category"), FALLING_SNOW),
    "classification": 7,
    **dict.fromkeys(("objecttag", "objtag"), 0),
}
_INSTANCES = ("instance", "instanceid", "instancelabel", "objectid", "objectidx", "objidx", "trackid")


def label_columns(cloud: PointCloud) -> dict[str, int]:
    """Columns that label points, and the class or instance that a particle gets in each.

    Example:
        >>> import torch
        >>> label_columns(PointCloud(torch.zeros(1, 6), ("x", "y", "z", "intensity", "label", "instance_id")))
        {'label': 110, 'instance_id': 0}
    """
    check_arguments("label_columns(cloud: PointCloud)", cloud)
    found = {}
    for name in cloud.columns[3:]:
        plain = name.lower().replace("_", "")
        if plain in _CLASSES:
            found[name] = min(_CLASSES[plain], _largest(cloud, name))
        elif plain in _INSTANCES:
            found[name] = 0
    return found


def with_labels_of(cloud: PointCloud, points: Tensor, kind: Tensor) -> Tensor:
    """A result whose particles and lost points do not keep the labels of what they hide.

    Args:
        cloud: as it was read.
        points: ``(N, C)`` of the result, in its columns.
        kind: ``(N,)`` `PointKind` of each row.
    """
    check_arguments("with_labels_of(cloud: PointCloud, points: Tensor, kind: Tensor)", cloud, points, kind)
    labels = label_columns(cloud)
    if not labels:
        return points
    found = points.clone()
    particle, lost = kind == int(PointKind.PARTICLE), kind == int(PointKind.LOST)
    for name, value in labels.items():
        column = cloud.columns.index(name)
        found[particle, column] = float(value)
        found[lost, column] = float(UNLABELLED)
    return found


def _largest(cloud: PointCloud, name: str) -> int:
    """The largest class that the column's field holds."""
    for one in cloud.layout.fields if cloud.layout else ():
        dtype = np.dtype(one.dtype)
        if name in one.columns and dtype.kind in "iu":
            return int(np.iinfo(dtype).max)
    return 0xFFFF
