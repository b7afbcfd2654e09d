"""The decoder that a graph's outputs look like."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torchweather.evaluation.robustness.graph import Port

__all__ = ["Likely", "likely_decoder", "likely_output"]

# A dense head has some thousand places, a head that ends in suppression some hundred: 300 in YOLOv8 and YOLOv10.
DENSE_PLACES = 1000
COMMON_STRIDES = (4, 8, 16, 32, 64, 128)


@dataclass(frozen=True)
class Likely:
    """A guess that a person has to check.

    Args:
        decoder: by name.
        outputs: role to the model's names.
        options: other than the decoder's defaults.
        classes: number of them, ``None`` where the graph does not give it.
        check: sentences about what can be otherwise.
    """

    decoder: str
    outputs: Mapping[str, Sequence[str]]
    options: Mapping[str, Any] = field(default_factory=dict)
    classes: int | None = None
    check: tuple[str, ...] = ()


def likely_output(port: Port) -> str:
    """Decoder of a single packed output, or ''.

    Example:
        >>> likely_output(Port("output0", (1, 84, 8400), "float32")), likely_output(Port("o", (1, 300, 6), "float32"))
        ('yolov8', 'end-to-end')
    """
    shape = port.without_batch(2)
    if len(shape) != 2:
        return ""
    first, last = shape
    if last == 6:
        return "yolov5" if isinstance(first, int) and first > DENSE_PLACES else "end-to-end"
    if isinstance(last, int) and last > 5 and (not isinstance(first, int) or first > last):
        return "yolov5"
    if isinstance(first, int) and first > 4 and (not isinstance(last, int) or last > first):
        return "yolov8"
    return ""


def likely_decoder(outputs: Sequence[Port], size: tuple[int, int] | None) -> Likely | None:
    """The decoder of a camera's detector, or ``None`` where no decoder fits.

    Args:
        outputs: of the graph.
        size: height and width of the input, where the graph fixes them.
    """
    if len(outputs) == 1:
        return _single(outputs[0])
    found = _levels(outputs, size) or _labelled(outputs)
    return found or _set(outputs)


def _single(port: Port) -> Likely | None:
    decoder, shape = likely_output(port), port.without_batch(2)
    if decoder == "yolov8":
        return Likely(
            decoder, {"packed": [port.name]}, {}, int(shape[0]) - 4, ("form: cxcywh in pixels of the input.",)
        )
    if decoder == "yolov5":
        check = ["Boxes must be in pixels of the input. YOLOX can export offsets in strides: use decode_in_inference."]
        if shape[-1] == 6:
            check.append("Of one class; if the last number is a label, the decoder is end-to-end.")
        return Likely(decoder, {"packed": [port.name]}, {}, int(shape[1]) - 5, tuple(check))
    if decoder == "end-to-end":
        return Likely(decoder, {"packed": [port.name]}, {}, None, ("The six numbers must be box, score, label.",))
    shape = port.without_batch(3)
    if len(shape) == 3:
        classes = shape[0] if isinstance(shape[0], int) else None
        return Likely("segmentation", {"logits": [port.name]}, {}, classes, ("The classes must come before the rows.",))
    return None


def _levels(outputs: Sequence[Port], size: tuple[int, int] | None) -> Likely | None:
    """Pairs of scores and distributions of the same number of places, the finest level first."""
    shapes = {port.name: port.without_batch(2) for port in outputs}
    if (
        len(outputs) % 2
        or len(outputs) < 4
        or not all(len(shape) == 2 and all(isinstance(side, int) for side in shape) for shape in shapes.values())
    ):
        return None
    counts = sorted({int(shape[0]) for shape in shapes.values()}, reverse=True)
    widths = {name: int(shape[1]) for name, shape in shapes.items()}
    pairs = [[name for name, shape in shapes.items() if shape[0] == count] for count in counts]
    if any(len(pair) != 2 for pair in pairs):
        return None
    candidates = [
        w for w in {*widths.values()} if w % 4 == 0 and all(sum(widths[n] == w for n in p) == 1 for p in pairs)
    ]
    # Of two widths that both could be four distributions the smaller is: 80 classes are more than 4 * 17 bins.
    if len({*widths.values()}) != 2 or not candidates:
        return None
    sides = min(candidates)
    boxes = [next(name for name in pair if widths[name] == sides) for pair in pairs]
    scores = [next(name for name in pair if widths[name] != sides) for pair in pairs]
    check = ["strides must be those of the levels, the finest first."]
    strides = None if size is None else [_stride(size, count) for count in counts]
    options = {} if strides is None or None in strides else {"strides": strides}
    check.append("activation: sigmoid where the scores are logits.")
    return Likely("nanodet", {"scores": scores, "boxes": boxes}, options, widths[scores[0]], tuple(check))


def _stride(size: tuple[int, int], places: int) -> int | None:
    found = [s for s in COMMON_STRIDES if math.ceil(size[0] / s) * math.ceil(size[1] / s) == places]
    return found[0] if found else None


def _labelled(outputs: Sequence[Port]) -> Likely | None:
    """Boxes with labels: of mmdeploy (scores in the boxes), or with scores apart."""
    wide = [p for p in outputs if (shape := p.without_batch(2)) and len(shape) == 2 and shape[1] in (4, 5)]
    flat = [p for p in outputs if p not in wide and len(p.without_batch(1)) == 1 and p.shape not in ((1,), ())]
    if len(wide) != 1 or not flat:
        return None
    whole = [p for p in flat if p.dtype.startswith("int") or p.name.lower() in LABEL_NAMES]
    apart = [p for p in flat if p not in whole]
    if wide[0].without_batch(2)[1] == 5 and len(whole) == 1:
        return Likely("mmdeploy", {"boxes": [wide[0].name], "labels": [whole[0].name]})
    if len(whole) != 1 or len(apart) != 1:
        return None
    outputs_of = {"boxes": [wide[0].name], "scores": [apart[0].name], "labels": [whole[0].name]}
    return Likely(
        "boxes", outputs_of, {}, None, ("form and normalised of the boxes; TensorFlow's are yxyx, normalised.",)
    )


LABEL_NAMES = ("labels", "label", "classes", "class_ids", "detection_classes")


def _set(outputs: Sequence[Port]) -> Likely | None:
    """Boxes and scores of every class, of as many places."""
    pairs = [port for port in outputs if len(port.without_batch(2)) == 2]
    boxes = [port for port in pairs if port.without_batch(2)[1] == 4]
    others = [port for port in pairs if port not in boxes]
    if len(boxes) != 1 or len(others) != 1:
        return None
    places, classes = others[0].without_batch(2)
    count = classes if isinstance(classes, int) else None
    if isinstance(places, int) and places > DENSE_PLACES:
        options = {"nms_iou": 0.6, "threshold": 0.01}
        found = {"boxes": [boxes[0].name], "scores": [others[0].name]}
        return Likely("boxes", found, options, count, ("form and normalised of the boxes.",))
    return Likely(
        "detr",
        {"logits": [others[0].name], "boxes": [boxes[0].name]},
        {},
        None if count is None else count - 1,
        ("activation: softmax with no object as the last class (DETR); sigmoid for Deformable DETR, DINO, RT-DETR.",),
    )
