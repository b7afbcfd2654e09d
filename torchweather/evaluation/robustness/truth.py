"""Ground truth: boxes of COCO's JSON, label images, and labels of points."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, check_one_of, nearest_name
from torchweather.core.yaml_file import read_json
from torchweather.io import read_image
from torchweather.io.labels import read_labels

__all__ = ["LABEL_SUFFIXES", "BoxTruth", "LabelTruth", "read_boxes_truth", "read_label_truth"]

LABEL_AXES = {"camera": 2, "lidar": 1}
"""By the sensor: axes of its labels, rows and columns of an image, points of a cloud."""
LABEL_SUFFIXES = {"camera": (".png", ".npy", ".npz", ".tif"), "lidar": (".label",)}
"""By the sensor: endings of the files that hold the class of every pixel or point."""


@dataclass(frozen=True)
class BoxTruth:
    """The boxes of one frame.

    Args:
        boxes: ``(M, 4)`` left, top, right, bottom, pixels.
        labels: names of their classes.
        ignore: ``(M,)`` bool: neither missed nor false (COCO's crowds).
        size_px: height and width of the image in which the boxes count; ``None`` where the file does not say.
    """

    boxes: NDArray[np.float64]
    labels: tuple[str, ...]
    ignore: NDArray[np.bool_]
    size_px: tuple[int, int] | None = None

    def check_size(self, shape: tuple[int, ...], frame: object) -> None:
        """Raise where the boxes count in an image of another size than the frame ``(H, W)``, such as one on its side.

        Example:
            >>> BoxTruth(np.zeros((0, 4)), (), np.zeros(0, bool), (480, 640)).check_size((480, 640), "0.jpg")
        """
        if self.size_px is None or len(shape) != 2 or self.size_px == tuple(shape):
            return
        turned = self.size_px == tuple(shape[::-1])
        remedy = (
            "The frame was turned upright by its EXIF orientation: count the boxes in the upright picture, or remove "
            "the tag."
            if turned
            else "Give the images that were annotated, or scale the boxes."
        )
        raise TorchweatherError(
            f"{frame}: the boxes belong to an image of {self.size_px[1]} x {self.size_px[0]} px; the frame has "
            f"{shape[1]} x {shape[0]}. {remedy}"
        )


@dataclass(frozen=True)
class LabelTruth:
    """The class of every pixel ``(H, W)`` or point ``(N,)``; numbers that are no class are not judged."""

    classes: NDArray[np.int64]


def read_boxes_truth(path: str | os.PathLike[str], classes: Mapping[int, str]) -> dict[str, BoxTruth]:
    """Boxes by the stem of the frame's file name.

    Args:
        path: COCO's JSON: ``images`` (``id``, ``file_name``; ``height`` and ``width`` are compared with the frame's),
            ``annotations`` (``image_id``, ``category_id``, ``bbox``
            left, top, width, height in pixels, ``iscrowd``), ``categories`` (``id``, ``name``).
        classes: of the detector; boxes of other categories are left out.

    Raises:
        TorchweatherError: the file is missing or no such JSON, or has no category that the detector knows.
    """
    check_arguments("read_boxes_truth(path: path, classes: Mapping)", path, classes)
    if not classes or not all(isinstance(name, str) for name in classes.values()):
        raise InputTypeError(f"read_boxes_truth: classes must be numbers with names; got {classes!r:.200}.")
    file = Path(path)
    values = read_json(file, "ground truth, COCO's")
    try:
        images = {each["id"]: Path(each["file_name"]).stem for each in values["images"]}
        sizes = {Path(each["file_name"]).stem: _size_px(each) for each in values["images"]}
        names = {each["id"]: str(each["name"]) for each in values["categories"]}
        boxes = [
            (images[each["image_id"]], names[each["category_id"]], [float(v) for v in each["bbox"]], each)
            for each in values["annotations"]
        ]
    except (ValueError, KeyError, TypeError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise TorchweatherError(
            f"{file}: expected ground truth as COCO's JSON (images, annotations, categories); it cannot be read "
            f"({reason})."
        ) from error
    if len({*images.values()}) < len(images):
        raise TorchweatherError(f"{file}: expected images of different names; some stand there twice.")
    known = {*classes.values()} & {*names.values()}
    if not known:
        hint = nearest_name(next(iter(classes.values())), names.values())
        raise TorchweatherError(
            f"{file}: no category of the detector; it has {', '.join(sorted({*names.values()})) or 'none'}, "
            f"the detector {', '.join(classes.values())}.{hint}"
        )
    found: dict[str, list[tuple[str, list[float], bool]]] = defaultdict(list)
    for stem, name, box, each in boxes:
        if len(box) != 4 or not all(math.isfinite(v) for v in box) or min(box[2:]) < 0:
            raise TorchweatherError(f"{file}: bbox must be left, top, width, height in pixels; got {each['bbox']!r}.")
        if name in known:
            left, top, width, height = box
            found[stem].append((name, [left, top, left + width, top + height], bool(each.get("iscrowd", 0))))
    return {stem: replace(_boxes(found[stem]), size_px=sizes[stem]) for stem in images.values()}


def _size_px(image: Mapping[str, Any]) -> tuple[int, int] | None:
    height, width = image.get("height"), image.get("width")
    if isinstance(height, int) and isinstance(width, int) and min(height, width) > 0:
        return height, width
    return None


def _boxes(entries: list[tuple[str, list[float], bool]]) -> BoxTruth:
    return BoxTruth(
        np.array([box for _, box, _ in entries], dtype=np.float64).reshape(-1, 4),
        tuple(name for name, _, _ in entries),
        np.array([crowd for _, _, crowd in entries], dtype=bool),
    )


def read_label_truth(folder: str | os.PathLike[str], stem: str, sensor: str, shape: tuple[int, ...]) -> LabelTruth:
    """Labels of one frame or cloud, from the file of its name in a folder.

    Args:
        folder: of the label images (one value a pixel) or ``.label`` files (SemanticKITTI's).
        stem: name of the frame without its ending.
        sensor: ``camera`` or ``lidar``.
        shape: ``(H, W)`` or ``(N,)``, checked.
    """
    check_arguments(
        "read_label_truth(folder: path, stem: str, sensor: str, shape: Sequence)",
        folder,
        stem,
        sensor,
        shape,
    )
    check_arguments("read_label_truth(stem: path)", stem)
    check_one_of("sensor", sensor, LABEL_SUFFIXES, owner="read_label_truth")
    if len(shape) != LABEL_AXES[sensor]:
        raise InputValueError(f"read_label_truth: shape must be (H, W) of an image or (N,) of a cloud; got {shape!r}.")
    for suffix in LABEL_SUFFIXES[sensor]:
        file = Path(folder) / f"{stem}{suffix}"
        if file.is_file():
            return LabelTruth(_labels(file, shape))
    raise TorchweatherError(
        f"{folder}: no ground truth for {stem}; expected {stem} with {', '.join(LABEL_SUFFIXES[sensor])}."
    )


def _labels(file: Path, shape: tuple[int, ...]) -> NDArray[np.int64]:
    if file.suffix == ".label":
        return np.asarray(read_labels(file, shape[0]).classes.numpy(), dtype=np.int64)
    image, _ = read_image(file)
    if tuple(image.shape) != (1, *shape):
        raise TorchweatherError(
            f"{file}: expected one class a pixel, {shape[0]} x {shape[1]} as the frame; got shape {tuple(image.shape)}."
        )
    return np.asarray(image[0].numpy(), dtype=np.int64)


def frame_truth(truths: Mapping[str, Any], stem: str, where: str) -> Any:
    """The truth of a frame among those of a file."""
    if stem not in truths:
        raise TorchweatherError(f"{where}: no ground truth for {stem}; it has {len(truths)} other images.")
    return truths[stem]
