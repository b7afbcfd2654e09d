"""Average precision of detectors: boxes in images and on the ground, per class and per distance."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.errors import TorchweatherError, check_between, check_one_of
from torchweather.metrics.box_overlap import box_iou

__all__ = ["INTERPOLATIONS", "AveragePrecision", "average_precision"]

Floats = NDArray[np.float64]
Overlap = Callable[[Tensor, Tensor], Tensor]

EVERYWHERE = (0.0, math.inf)
# Recalls at which COCO reads the precision, as pycocotools rounds them.
COCO_RECALLS = np.linspace(0.0, 1.0, 101)
# Simonelli et al. 2019, "Disentangling monocular 3D object detection": KITTI's 40 recalls, without 0.
KITTI_RECALLS = np.arange(1, 41) / 40


@dataclass(frozen=True)
class AveragePrecision:
    """Average precision of one class at one threshold in one range of distance."""

    label: Hashable
    threshold: float
    """Overlap from which on a detection is a hit."""
    range_m: tuple[float, float]
    """Distances from the first (included) to the second (not)."""
    value: float
    """In [0, 1]; NaN where the class has no truth that counts."""
    truths: int
    """Those that count: of the class, in the range, not to be ignored."""
    detections: int
    """Those that count: hits of such truths and false alarms."""
    recall: float
    """Share of the truths that any detection hits; NaN where there are none."""

    def to_dict(self) -> dict[str, Any]:
        """The fields by name."""
        return asdict(self)


def average_precision(
    detections: Sequence[Mapping[str, Any]],
    truths: Sequence[Mapping[str, Any]],
    *,
    overlap: Overlap = box_iou,
    thresholds: Sequence[float] = (0.5,),
    interpolation: str = "coco",
    ranges_m: Sequence[tuple[float, float]] = (EVERYWHERE,),
) -> list[AveragePrecision]:
    """Average precision: area under precision against recall, per class, threshold and range of distance.

    Within an image and class, detections take truths from the surest on: each the truth that it overlaps most among
    those not taken. A hit overlaps by the threshold or more; every other detection is a false alarm.

    Args:
        detections: one entry an image: ``boxes`` ``(N, 4)`` left, top, right, bottom or whatever ``overlap`` takes,
            ``scores`` ``(N,)``, ``labels`` ``(N,)`` (numbers or text), and, where distances matter, ``range_m``
            ``(N,)``, NaN where unknown. Arrays, tensors or lists.
        truths: one entry an image: ``boxes``, ``labels``, ``range_m`` likewise, and optionally ``ignore`` ``(N,)``: it
            is no miss to overlook such a box, and no false alarm to find it, any number of times.
        overlap: ``box_iou``, ``bev_iou`` for boxes ``(N, 5)`` on the ground, or a function of ``(N, ...)`` and
            ``(M, ...)`` boxes to ``(N, M)`` numbers in [0, 1].
        thresholds: overlaps, in (0, 1].
        interpolation: ``coco``: mean of the precision at 101 recalls; ``pascal``: area under the whole curve (Pascal
            VOC from 2010 on); ``kitti``: mean at 40 recalls. All make precision fall with recall first.
        ranges_m: bounds of distance; the lower one belongs to the range. A truth outside is ignored, and so is a
            detection outside that hits nothing. A detection of unknown distance that hits nothing is a false alarm in
            every range.

    Returns:
        Classes in order of their names, then thresholds, then ranges. Every class that a truth or a detection names.

    Note:
        Matching is pycocotools' ``COCOeval`` (extra ``detection``), to which the overlaps are handed, with the
        distance in the place of its area; so 2D and bird's-eye boxes follow one rule. The area under the curve is
        taken here, because ``COCOeval`` reads precision at given recalls only; on ``coco`` both agree to 1e-12. Unlike
        COCO's own setting there is no limit of 100 detections. ``range_m`` defaults to the distance of the centre for
        boxes ``(N, 5)``.

    References:
        Lin et al. 2014, "Microsoft COCO"; Everingham et al. 2010, "The Pascal VOC challenge"; Geiger et al. 2012.

    Example:
        >>> truth = {"boxes": [[0, 0, 10, 10], [20, 0, 30, 10]], "labels": ["car", "car"]}
        >>> found = {"boxes": [[0, 0, 10, 9], [50, 0, 60, 10]], "labels": ["car", "car"], "scores": [0.9, 0.8]}
        >>> [car] = average_precision([found], [truth], interpolation="pascal")
        >>> car.value, car.recall, car.truths
        (0.5, 0.5, 2)
    """
    name = "average_precision"
    check_one_of("interpolation", interpolation, INTERPOLATIONS, owner=name)
    _check_arguments(detections, truths, thresholds, ranges_m)
    ranged = [*map(tuple, ranges_m)] != [EVERYWHERE]
    seen = [_Image(each, f"detections[{k}]", scored=True) for k, each in enumerate(detections)]
    true = [_Image(each, f"truths[{k}]", ranged=ranged) for k, each in enumerate(truths)]
    labels = _in_order({label for image in (*seen, *true) for label in image.labels})
    if not labels:
        return []
    records: tuple[list[dict[str, Any]], list[dict[str, Any]]] = ([], [])
    overlaps: dict[tuple[int, int], Floats] = {}
    for number, (found, there) in enumerate(zip(seen, true, strict=True), 1):
        for category, label in enumerate(labels, 1):
            mine, theirs = found.of(label), there.of(label)
            shared = {"image_id": number, "category_id": category}
            records[0].extend({**shared, **found.record(k)} for k in mine)
            records[1].extend({**shared, **there.record(k)} for k in theirs)
            if mine and theirs:
                overlaps[number, category] = overlap(found.boxes[mine], there.boxes[theirs]).cpu().numpy()
    matched = _match(
        records[1],
        records[0],
        overlaps,
        images=len(truths),
        classes=len(labels),
        thresholds=thresholds,
        # COCO counts both bounds in.
        ranges=[(low, math.nextafter(high, -math.inf)) for low, high in ranges_m],
    )
    return [
        _average_precision(
            matched[category][place], step, label, threshold, (float(low), float(high)), INTERPOLATIONS[interpolation]
        )
        for category, label in enumerate(labels)
        for step, threshold in enumerate(thresholds)
        for place, (low, high) in enumerate(ranges_m)
    ]


def _match(*records: Any, **options: Any) -> list[list[list[Mapping[str, Any]]]]:
    try:
        from torchweather.metrics.coco_matching import match
    except ImportError as error:
        raise TorchweatherError("average_precision: needs pycocotools: install torchweather[detection].") from error
    return match(*records, **options)


# ---- the curve -----------------------------------------------------------------------------------------------------


def _average_precision(
    images: Sequence[Mapping[str, Any]],
    step: int,
    label: Hashable,
    threshold: float,
    range_m: tuple[float, float],
    area: Callable[[Floats, Floats], float],
) -> AveragePrecision:
    """The score of all images at the threshold of number ``step``."""
    truths = int(sum(np.count_nonzero(np.asarray(image["gtIgnore"]) == 0) for image in images))
    scores = np.concatenate([image["dtScores"] for image in images] or [np.zeros(0)])
    hits = np.concatenate([image["dtMatches"][step] > 0 for image in images] or [np.zeros(0, bool)])
    counts = ~np.concatenate([image["dtIgnore"][step].astype(bool) for image in images] or [np.zeros(0, bool)])
    order = np.argsort(-scores, kind="stable")
    hits = hits[order][counts[order]]
    number = int(counts.sum())
    if not truths:
        return AveragePrecision(label, float(threshold), range_m, math.nan, 0, number, math.nan)
    recall = np.cumsum(hits) / truths
    precision = np.cumsum(hits) / np.arange(1, number + 1)
    # The best precision at this recall or a higher one.
    falling = np.maximum.accumulate(precision[::-1])[::-1]
    reached = float(recall[-1]) if number else 0.0
    return AveragePrecision(label, float(threshold), range_m, area(recall, falling), truths, number, reached)


def _mean_at(recalls: Floats) -> Callable[[Floats, Floats], float]:
    def mean(recall: Floats, precision: Floats) -> float:
        first = np.searchsorted(recall, recalls, side="left")
        return float(np.append(precision, 0.0)[first].mean())

    return mean


def _whole_area(recall: Floats, precision: Floats) -> float:
    return float(np.sum(np.diff(recall, prepend=0.0) * precision))


INTERPOLATIONS: dict[str, Callable[[Floats, Floats], float]] = {
    "coco": _mean_at(COCO_RECALLS),
    "pascal": _whole_area,
    "kitti": _mean_at(KITTI_RECALLS),
}


# ---- what comes in -------------------------------------------------------------------------------------------------


class _Image:
    """Boxes of one image, checked; detections with the surest first."""

    def __init__(self, entry: Mapping[str, Any], where: str, *, scored: bool = False, ranged: bool = False) -> None:
        optional = ("range_m",) if scored else ("range_m", "ignore")
        needed = ("boxes", "labels", "scores") if scored else ("boxes", "labels")
        if not isinstance(entry, Mapping) or not {*needed} <= {*entry} <= {*needed, *optional}:
            came = ", ".join(map(str, entry)) if isinstance(entry, Mapping) else type(entry).__name__
            raise ValueError(
                f"average_precision: {where} must have {', '.join(needed)} (and may have {', '.join(optional)}); "
                f"got {came or 'nothing'}."
            )
        labels = entry["labels"]
        self.labels = labels.tolist() if isinstance(labels, (np.ndarray, Tensor)) else list(labels)
        count = len(self.labels)
        boxes = torch.as_tensor(_numbers(entry["boxes"], f"{where}: boxes"))
        self.boxes = boxes if boxes.numel() or boxes.ndim > 1 else boxes.reshape(0, 4)
        if len(self.boxes) != count:
            raise ValueError(
                f"average_precision: {where} must have one label a box; got {count} labels and {len(self.boxes)} boxes."
            )
        self.scores = self._column(entry, "scores", where) if scored else np.zeros(count)
        self.ignore = self._column(entry, "ignore", where) if "ignore" in entry else np.zeros(count)
        self.range_m = self._ranges(entry, where, ranged=ranged)

    def _column(self, entry: Mapping[str, Any], key: str, where: str, *, unknown: bool = False) -> Floats:
        values = _numbers(entry[key], f"{where}: {key}", unknown=unknown)
        if values.shape != (len(self.labels),):
            raise ValueError(
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
            raise ValueError(
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
    array = values.detach().cpu().numpy() if isinstance(values, Tensor) else values
    try:
        found: Floats = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"average_precision: {where} must be numbers of one shape; got {values!r}.") from error
    if not (np.isfinite(found) | (np.isnan(found) & unknown)).all():
        raise ValueError(f"average_precision: {where} must be finite; got NaN or infinity. Leave such boxes out.")
    return found


def _in_order(labels: set[Any]) -> list[Any]:
    try:
        return sorted(labels)
    except TypeError as error:
        kinds = ", ".join(sorted({type(label).__name__ for label in labels}))
        raise ValueError(f"average_precision: labels must be all numbers or all text; got {kinds}.") from error


def _check_arguments(
    detections: Sequence[Any],
    truths: Sequence[Any],
    thresholds: Sequence[float],
    ranges_m: Sequence[tuple[float, float]],
) -> None:
    name = "average_precision"
    if len(detections) != len(truths):
        raise ValueError(
            f"{name}: detections and truths must have one entry an image; got {len(detections)} and {len(truths)}."
        )
    if not len(thresholds) or not len(ranges_m):
        raise ValueError(f"{name}: thresholds and ranges_m must have one entry or more; got none.")
    for threshold in thresholds:
        check_between("thresholds", threshold, 1e-9, 1.0, owner=name)
    for bounds in ranges_m:
        if len(bounds) != 2 or not 0 <= bounds[0] < bounds[1]:
            raise ValueError(f"{name}: ranges_m must be pairs of distances in m, 0 <= low < high; got {bounds!r}.")
