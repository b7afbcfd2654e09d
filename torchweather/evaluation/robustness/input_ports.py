"""Inputs of detectors by the kind of sensor: tasks, shape and type of what goes in, shape of what comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["INPUT_PORTS", "InputPort", "Shape"]

Shape = tuple[int | str, ...]


@dataclass(frozen=True)
class InputPort:
    """Input of the detectors of one kind of sensor.

    Args:
        tasks: that such a detector can have.
        logits: shape of the scores of the classes of all pixels or points.
        declared: shape and type of the input, from the declaration's ``input``.
    """

    tasks: tuple[str, ...]
    logits: Shape
    declared: Callable[[Mapping[str, Any]], tuple[Shape, str]]


def _picture(taken: Mapping[str, Any]) -> tuple[Shape, str]:
    colours = 1 if taken["colour"] == "bayer" else 3
    height, width = taken["size"] or ("H", "W")
    shape = (1, colours, height, width) if taken["layout"] == "NCHW" else (1, height, width, colours)
    return shape, str(taken["dtype"])


def _cloud(taken: Mapping[str, Any]) -> tuple[Shape, str]:
    return (*((1,) if taken["batch"] else ()), "N", int(taken["columns"])), "float32"


INPUT_PORTS: dict[str, InputPort] = {
    "camera": InputPort(("boxes", "segmentation"), ("K", "H", "W"), _picture),
    "lidar": InputPort(("segmentation",), ("N", "K"), _cloud),
}
"""By the sensor that a declaration names."""
