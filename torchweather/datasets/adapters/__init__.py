"""Samples of other training code: OpenPCDet, mmdetection3d, Hugging Face datasets; none of them is imported."""

from __future__ import annotations

from torchweather.datasets.adapters.hugging_face import HuggingFaceAdapter
from torchweather.datasets.adapters.mmdet3d import Mmdet3dAdapter
from torchweather.datasets.adapters.openpcdet import OpenPcdetAdapter

__all__ = ["HuggingFaceAdapter", "Mmdet3dAdapter", "OpenPcdetAdapter"]
