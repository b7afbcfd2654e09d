"""Whole data sets into weather: folders, KITTI and nuScenes, on many processes, with a manifest."""

from __future__ import annotations

from torchweather.datasets.augment.layouts import LAYOUTS
from torchweather.datasets.augment.manifest import Manifest, Row
from torchweather.datasets.augment.run import ENGINES, Progress, Summary, augment

__all__ = ["ENGINES", "LAYOUTS", "Manifest", "Progress", "Row", "Summary", "augment"]
