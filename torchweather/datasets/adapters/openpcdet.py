"""OpenPCDet's data_dict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torchweather.datasets.adapters.adapter import (
    Adapter,
    array_from_image,
    cloud_tensor,
    depth_tensor,
    image_tensor,
    without_lost,
)

__all__ = ["OpenPcdetAdapter"]


@dataclass(frozen=True, eq=False)
class OpenPcdetAdapter(Adapter):
    """Weather on the ``data_dict`` of OpenPCDet, as a step of its augmentor or before ``prepare_data``.

    ``points`` are ``(N, 4 or more)`` numpy: x forward, y left, z up in metres, intensity, further columns; images
    ``(H, W, 3)`` in red, green, blue, floats in 0..1. Arrays come back as arrays of their dtype. ``gt_boxes``
    ``(M, 7 or more)`` (centre, length, width, height, heading), ``gt_names``, ``frame_id``, ``use_lead_xyz`` and all
    others pass through.

    Arguments as `Adapter`. Database sampling puts objects of clear air into the cloud: weather belongs behind it. Flips
    and turns about z may come before or after.

    References:
        https://github.com/open-mmlab/OpenPCDet: DatasetTemplate.prepare_data in pcdet/datasets/dataset.py, and
        docs/DEMO.md for the axes.

    Example:
        >>> import numpy as np
        >>> def colder(sample):
        ...     return {**sample, "points": sample["points"] * 0.5}
        >>> data = {"frame_id": "000001", "points": np.ones((2, 4), np.float32), "use_lead_xyz": True}
        >>> OpenPcdetAdapter(colder)(data)["points"]
        array([[0.5, 0.5, 0.5, 0.5],
               [0.5, 0.5, 0.5, 0.5]], dtype=float32)
    """

    def __call__(self, data_dict: Mapping[str, Any]) -> dict[str, Any]:
        """The data_dict in the weather; the one that came in is not changed."""
        self._check_keys(data_dict)
        tensors = {key: cloud_tensor(data_dict[key]) for key in self.clouds}
        tensors |= {key: image_tensor(data_dict[key]) for key in self.images}
        tensors |= {key: depth_tensor(data_dict[key]) for key in self.depths}
        found = dict(self.transform({**data_dict, **tensors}))
        for key in self.clouds:
            cloud = without_lost(found[key]) if self.drop_lost else found[key]
            found[key] = cloud.numpy()
        for key in self.images:
            found[key] = array_from_image(found[key], data_dict[key])
        return {**found, **{key: data_dict[key] for key in self.depths}}
