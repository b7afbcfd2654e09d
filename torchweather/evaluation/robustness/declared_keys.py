"""Keys of a declaration's input and options, and the values that each takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torchweather.core.schema import FLAG, NUMBER, SHARE, Key, is_number, is_whole, one_of

__all__ = ["KEYS"]


def _not_negative(value: Any) -> bool:
    return bool(is_number(value) and value >= 0)


def _positive(value: Any) -> bool:
    return bool(is_number(value) and value > 0)


def _whole(least: int) -> Callable[[Any], bool]:
    return lambda value: is_whole(value) and value >= least


def _colours(each: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """One number, or one a colour."""
    return lambda value: all(map(each, value)) and len(value) in (1, 3) if isinstance(value, list) else each(value)


def _listed(each: Callable[[Any], bool], number: int | None = None) -> Callable[[Any], bool]:
    """A list of at least one, or of a number of them."""
    return lambda value: (
        isinstance(value, list) and all(map(each, value)) and (len(value) == number if number else bool(value))
    )


KEYS: dict[str, Key] = {
    "layout": one_of(("NCHW", "NHWC")),
    "colour": one_of(("RGB", "BGR", "bayer")),
    "dtype": one_of(("float32", "float16", "uint8")),
    "fit": one_of(("stretch", "letterbox", "corner")),
    "form": one_of(("xyxy", "cxcywh", "xywh", "yxyx")),
    "activation": one_of(("none", "sigmoid", "softmax")),
    "scale": Key("a number, more than 0", _positive),
    "exposure": Key("a number, more than 0", _positive),
    "mean": Key("a number, or one a colour", _colours(NUMBER.fits)),
    "std": Key("a number more than 0, or one a colour", _colours(_positive)),
    "fill": Key("a level from 0 to 255, or one a colour", _colours(lambda v: _not_negative(v) and v <= 255)),
    "size": Key("[height, width] in pixels", _listed(_whole(1), 2)).or_null,
    "multiple": Key("a whole number of pixels, 1 or more", _whole(1)),
    "columns": Key("3 or more (x, y, z, intensity, ...)", _whole(3)),
    "enlarge": FLAG,
    "batch": FLAG,
    "normalised": FLAG,
    "threshold": SHARE,
    "operating_threshold": SHARE.or_null,
    "nms_iou": SHARE.or_null,
    "strides": Key("a list of pixels, one a level", _listed(_positive)),
    "centre": Key("a number of strides, 0 or more", _not_negative),
}
"""By the name of a key."""
