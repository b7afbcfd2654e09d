"""Average precision of detectors: boxes in images and on the ground, per class and per distance."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchweather.core.arguments import call_given, check_arguments
from torchweather.core.arrays import as_numpy
from torchweather.core.errors import InputValueError, TorchweatherError, check_between, check_one_of
from torchweather.core.extras import install_hint
from torchweather.core.precision import outside_autocast
from torchweather.core.schema import is_number
from torchweather.metrics.box_overlap import bev_coverage, bev_iou, box_coverage, box_iou
from torchweather.metrics.detection_curve import INTERPOLATIONS, MatchedBoxes
from torchweather.metrics.detection_input import ImageBoxes, in_order

__all__ = ["INTERPOLATIONS", "AveragePrecision", "average_precision", "matched_boxes"]

Floats = NDArray[np.float64]
Overlap = Callable[[Tensor, Tensor], Tensor]

EVERYWHERE = (0.0, math.inf)
COVERAGES: dict[Overlap, Overlap] = {box_iou: box_coverage, bev_iou: bev_coverage}
"""By the overlap: that with truths to be ignored."""


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


@outside_autocast
def average_precision(
    detections: Sequence[Mapping[str, Any]],
    truths: Sequence[Mapping[str, Any]],
    *,
    overlap: Overlap = box_iou,
    ignored_overlap: Overlap | None = None,
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
        ignored_overlap: of detections with truths to be ignored. Default COCO's: the share of the detection that the
            truth covers (``box_coverage``, ``bev_coverage``), so that a region may hold many objects; for an overlap
            of one's own, that one.
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
    check_arguments(
        "average_precision(detections: Sequence[Mapping], truths: Sequence[Mapping], thresholds: Sequence[float], "
        "interpolation: str, ranges_m: Sequence)",
        detections,
        truths,
        thresholds,
        interpolation,
        ranges_m,
    )
    check_one_of("interpolation", interpolation, INTERPOLATIONS, owner="average_precision")
    return [
        AveragePrecision(
            each.label,
            each.threshold,
            each.range_m,
            each.average_precision(interpolation),
            int(each.truths.sum()),
            len(each.scores),
            each.recall,
        )
        for each in matched_boxes(
            detections,
            truths,
            overlap=overlap,
            ignored_overlap=ignored_overlap,
            thresholds=thresholds,
            ranges_m=ranges_m,
        )
    ]


@outside_autocast
def matched_boxes(
    detections: Sequence[Mapping[str, Any]],
    truths: Sequence[Mapping[str, Any]],
    *,
    overlap: Overlap = box_iou,
    ignored_overlap: Overlap | None = None,
    thresholds: Sequence[float] = (0.5,),
    ranges_m: Sequence[tuple[float, float]] = (EVERYWHERE,),
) -> list[MatchedBoxes]:
    """Detections matched to truths, before any score: hits and false alarms of every class, threshold and range.

    Args:
        detections, truths, overlap, ignored_overlap, thresholds, ranges_m: as in `average_precision`.

    Returns:
        Classes in order of their names, then thresholds, then ranges.
    """
    _check_arguments(detections, truths, thresholds, ranges_m)
    check_arguments("average_precision(overlap: Callable, ignored_overlap: Callable | None)", overlap, ignored_overlap)
    beside = ignored_overlap or COVERAGES.get(overlap, overlap)
    ranged = [*map(tuple, ranges_m)] != [EVERYWHERE]
    seen = [ImageBoxes(each, f"detections[{k}]", scored=True) for k, each in enumerate(detections)]
    true = [ImageBoxes(each, f"truths[{k}]", ranged=ranged) for k, each in enumerate(truths)]
    labels = in_order({label for image in (*seen, *true) for label in image.labels})
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
                overlaps[number, category] = _overlaps(found, mine, there, theirs, overlap, beside)
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
        MatchedBoxes.of_images(
            matched[category][place], step, len(truths), label, float(threshold), (float(low), float(high))
        )
        for category, label in enumerate(labels)
        for step, threshold in enumerate(thresholds)
        for place, (low, high) in enumerate(ranges_m)
    ]


def _overlaps(
    found: ImageBoxes, mine: list[int], there: ImageBoxes, theirs: list[int], overlap: Overlap, beside: Overlap
) -> Floats:
    """Overlaps ``(detections, truths)`` of an image and class; with truths to be ignored by a rule of their own."""
    values = _overlap(overlap, found.boxes[mine], there.boxes[theirs])
    ignored = np.flatnonzero(there.ignore[theirs])
    if len(ignored) and beside is not overlap:
        regions = there.boxes[[theirs[k] for k in ignored]]
        values = values.copy()
        values[:, ignored] = _overlap(beside, found.boxes[mine], regions)
    return values


def _overlap(overlap: Overlap, first: Tensor, second: Tensor) -> Floats:
    """Overlaps as an array, the function and its value checked."""
    found = call_given("average_precision", "overlap", overlap, first, second)
    if not isinstance(found, Tensor) or found.shape != (len(first), len(second)):
        raise InputValueError(
            f"average_precision: overlap must give a tensor ({len(first)}, {len(second)}); got {found!r:.200}."
        )
    values: Floats = as_numpy(found)
    return values


def _match(*records: Any, **options: Any) -> list[list[list[Mapping[str, Any]]]]:
    try:
        from torchweather.metrics.coco_matching import match
    except ImportError as error:
        raise TorchweatherError(f"average_precision: needs pycocotools. {install_hint('detection')}") from error
    return match(*records, **options)


def _check_arguments(
    detections: Sequence[Any],
    truths: Sequence[Any],
    thresholds: Sequence[float],
    ranges_m: Sequence[tuple[float, float]],
) -> None:
    name = "average_precision"
    if len(detections) != len(truths):
        raise InputValueError(
            f"{name}: detections and truths must have one entry an image; got {len(detections)} and {len(truths)}."
        )
    if not len(thresholds) or not len(ranges_m):
        raise InputValueError(f"{name}: thresholds and ranges_m must have one entry or more; got none.")
    for threshold in thresholds:
        check_between("thresholds", threshold, 1e-9, 1.0, owner=name)
    for bounds in ranges_m:
        values = bounds.tolist() if isinstance(bounds, (np.ndarray, Tensor)) else bounds
        pair = isinstance(values, Sequence) and len(values) == 2 and all(map(is_number, values))
        if not pair or not 0 <= bounds[0] < bounds[1]:
            raise InputValueError(f"{name}: ranges_m must be pairs of distances in m, 0 <= low < high; got {bounds!r}.")
