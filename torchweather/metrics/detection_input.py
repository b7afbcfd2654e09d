"""Boxes of an image as a caller gives them, checked."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError

__all__ = ["ImageBoxes", "in_order"]

Floats = NDArray[np.float64]


class ImageBoxes:
    """Boxes of one image, checked; detections with the surest first."""

    def __init__(self, entry: Mapping[str, Any], where: str, *, scored: bool = False, ranged: bool = False) -> None:
        optional = ("range_m",) if scored else ("range_m", "ignore")
        needed = ("boxes", "labels", "scores") if scored else ("boxes", "labels")
        if not isinstance(entry, Mapping) or not {*needed} <= {*entry} <= {*needed, *optional}:
            came = ", ".join(map(str, entry)) if isinstance(entry, Mapping) else type(entry).__name__
            raise InputValueError(
                f"average_precision: {where} must have {', '.join(needed)} (and may have {', '.join(optional)}); "
                f"got {came or 'nothing'}."
            )
        labels = entry["labels"]
        check_arguments("average_precision(labels: Iterable)", labels)
        self.labels = labels.tolist() if isinstance(labels, (np.ndarray, Tensor)) else list(labels)
        count = len(self.labels)
        if not all(isinstance(label, Hashable) for label in self.labels):
            raise InputValueError(
                f"average_precision: {where}: labels must be one name or number a box; got {labels!r:.200}."
            )
        boxes = torch.as_tensor(_numbers(entry["boxes"], f"{where}: boxes"))
        self.boxes = boxes if boxes.numel() or boxes.ndim > 1 else boxes.reshape(0, 4)
        if len(self.boxes) != count:
            raise InputValueError(
                f"average_precision: {where} must have one label a box; got {count} labels and {len(self.boxes)} boxes."
            )
        self.scores = self._column(entry, "scores", where) if scored else np.zeros(count)
        self.ignore = self._column(entry, "ignore", where) if "ignore" in entry else np.zeros(count)
        self.range_m = self._ranges(entry, where, ranged=ranged)

    def _column(self, entry: Mapping[str, Any], key: str, where: str, *, unknown: bool = False) -> Floats:
        values = _numbers(entry[key], f"{where}: {key}", unknown=unknown)
        if values.shape != (len(self.labels),):
            raise InputValueError(
                f"average_precision: {where}: {key} must have one value a box, ({len(self.labels)},); "
                f"got {values.shape}."
            )
        return values

    def _ranges(self, entry: Mapping[str, Any], where: str, *, ranged: bool) -> Floats:
        if entry.get("range_m") is not None:
            return self._column(entry, "range_m", where, unknown="scores" in entry)
        if self.boxes.ndim == 2 and self.boxes.shape[1] == 5:
            return np.asarray(self.boxes[:, :2].norm(dim=-1).numpy(), dtype=np.float64)
        if ranged and self.labels:
            raise InputValueError(
                f"average_precision: {where} must have range_m, distances in metres, for ranges_m; got none."
            )
        return np.full(len(self.labels), math.nan)

    def of(self, label: Hashable) -> list[int]:
        """Places of a class's boxes, the surest first; equally sure ones in the order they came."""
        mine = [k for k, each in enumerate(self.labels) if each == label]
        return sorted(mine, key=lambda k: -self.scores[k])

    def record(self, k: int) -> dict[str, Any]:
        """A box as pycocotools has it; NaN lies in every range."""
        return {"area": float(self.range_m[k]), "score": float(self.scores[k]), "iscrowd": int(self.ignore[k] != 0)}


def _numbers(values: Any, where: str, *, unknown: bool = False) -> Floats:
    """Numbers as float64; NaN where ``unknown`` allows it."""
    array = as_numpy(values) if isinstance(values, Tensor) else values
    try:
        found: Floats = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputValueError(f"average_precision: {where} must be numbers of one shape; got {values!r}.") from error
    if not (np.isfinite(found) | (np.isnan(found) & unknown)).all():
        raise InputValueError(f"average_precision: {where} must be finite; got NaN or infinity. Leave such boxes out.")
    return found


def in_order(labels: set[Any]) -> list[Any]:
    """Classes in order of their names or numbers."""
    """Classes in order of their names or numbers."""
    try:
        return sorted(labels)
    except TypeError as error:
        kinds = ", ".join(sorted({type(label).__name__ for label in labels}))
        raise InputValueError(f"average_precision: labels must be all numbers or all text; got {kinds}.") from error
