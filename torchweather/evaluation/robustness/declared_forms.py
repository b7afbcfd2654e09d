"""Keys of a declaration's input, decoders with their outputs and options, and the defaults of all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["DECODERS", "INPUT", "DecoderForm"]

INPUT: dict[str, dict[str, Any]] = {
    "camera": {
        "layout": "NCHW",
        "colour": "RGB",
        "dtype": "float32",
        "scale": 1.0,
        "mean": 0.0,
        "std": 1.0,
        "exposure": 1.0,
        "size": None,
        "fit": "stretch",
        "enlarge": True,
        "fill": 114,  # the grey of YOLOv5's and YOLOX's borders, of 255
        "multiple": 1,
    },
    "lidar": {"columns": 4, "batch": True},
}
"""By the sensor: keys of the input, and their values where nothing is declared."""

# Least score of a dense head: on 13 KITTI frames, clear and in fog of 50 m visibility, NanoDet's AP50 is that of 0.001
# to 1e-4; at 0.1 it is 0.012 lower in the fog.
DENSE_THRESHOLD = 0.02
# Overlap of the evaluation of YOLOv5 and NanoDet.
DENSE_NMS_IOU = 0.6


@dataclass(frozen=True)
class DecoderForm:
    """Form of output that a decoder reads.

    Args:
        task: ``boxes`` or ``segmentation``.
        needed: roles of the outputs that must be declared.
        usable: roles that can be declared.
        options: names and defaults.
        levels: every role is a list of outputs, one a level of the pyramid.
    """

    task: str
    needed: tuple[str, ...]
    usable: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    levels: bool = False


BOXES = {"form": "xyxy", "normalised": False, "threshold": 0.0, "nms_iou": None, "operating_threshold": None}
DENSE = {**BOXES, "form": "cxcywh", "threshold": DENSE_THRESHOLD, "nms_iou": DENSE_NMS_IOU, "activation": "none"}

DECODERS: dict[str, DecoderForm] = {
    "boxes": DecoderForm("boxes", ("boxes", "scores"), ("labels",), BOXES),
    "yolov8": DecoderForm("boxes", ("packed",), (), DENSE),
    "yolov5": DecoderForm("boxes", ("packed",), (), DENSE),
    "end-to-end": DecoderForm("boxes", ("packed",), (), BOXES),
    "mmdeploy": DecoderForm("boxes", ("boxes", "labels"), (), BOXES),
    "detr": DecoderForm(
        "boxes",
        ("logits", "boxes"),
        (),
        {**BOXES, "form": "cxcywh", "normalised": True, "activation": "softmax"},
    ),
    "nanodet": DecoderForm(
        "boxes",
        ("scores", "boxes"),
        (),
        {
            "threshold": DENSE_THRESHOLD,
            "nms_iou": DENSE_NMS_IOU,
            "operating_threshold": None,
            "activation": "none",
            "strides": [8, 16, 32],
            "centre": 0.5,
        },
        levels=True,
    ),
    "segmentation": DecoderForm("segmentation", ("logits",)),
}
"""By the name that a declaration gives."""
