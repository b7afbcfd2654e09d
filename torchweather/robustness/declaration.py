"""What an ONNX detector takes and gives, declared in YAML beside it.

A declaration holds ``format: torchweather-detector/1`` and

- ``title``: what it is, in words; ``sensor``: ``camera`` or ``lidar``;
- ``input``: its ``name`` and form. Of a camera: ``layout`` (``NCHW`` or ``NHWC``), ``colour`` (``RGB``, ``BGR``, or
  ``bayer`` for the mosaic in linear light), ``dtype`` (``float32`` or ``uint8``), ``scale``, ``mean``, ``std``
  (``(scale * picture - mean) / std`` of an sRGB picture in [0, 1]), ``exposure`` (factor of a raw frame's light),
  ``size`` (``[height, width]`` that frames are brought to). Of a LiDAR: ``columns`` (how many, x, y, z, intensity,
  ...), ``batch`` (true: ``(1, N, C)``, false: ``(N, C)``);
- ``decoder``: ``boxes`` or ``segmentation``; ``outputs``: what it reads to the model's name for it. ``boxes`` reads
  ``boxes`` (N, 4) and ``scores`` (N,), or (N, K) of K classes, and ``labels`` (N,) unless the scores have classes;
  ``segmentation`` reads ``logits`` (K, H, W) or (N, K). A leading batch of 1 may stand before all;
- ``classes``: names in the order of their numbers from 0, or number to name;
- ``options`` of the decoder. ``boxes``: ``form`` (``xyxy`` or ``cxcywh``), ``normalised`` (true: in 0..1 of the input),
  ``threshold`` (least score), ``nms_iou`` (overlap from which on the weaker box of a class is left out).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.errors import TorchweatherError, nearest_name
from torchweather.transforms.recipe_files import check_format, read_yaml, refuse_unknown

__all__ = ["FORMAT", "Declaration", "read_declaration"]

FORMAT = "torchweather-detector/1"
REQUIRED = ("format", "title", "sensor", "input", "decoder", "outputs", "classes")
KEYS = (*REQUIRED, "options")
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
    },
    "lidar": {"columns": 4, "batch": True},
}
"""By the sensor: what may be said of the input, and what holds where nothing is said."""
OUTPUTS = {"boxes": (("boxes", "scores"), ("labels",)), "segmentation": (("logits",), ())}
"""By the decoder: outputs that it needs, and those that it can use."""
OPTIONS: dict[str, dict[str, Any]] = {
    "boxes": {"form": "xyxy", "normalised": False, "threshold": 0.0, "nms_iou": None},
    "segmentation": {},
}
CHOICES = {
    "layout": ("NCHW", "NHWC"),
    "colour": ("RGB", "BGR", "bayer"),
    "dtype": ("float32", "uint8"),
    "form": ("xyxy", "cxcywh"),
}


@dataclass(frozen=True)
class Declaration:
    """A detector as its declaration states it.

    Args:
        title: what it is.
        sensor: ``camera`` or ``lidar``.
        input: ``name`` and form, the defaults filled in.
        decoder: ``boxes`` or ``segmentation``.
        outputs: what the decoder reads to the model's name for it.
        classes: number to name.
        options: of the decoder, the defaults filled in.
        path: the file.
    """

    title: str
    sensor: str
    input: Mapping[str, Any]
    decoder: str
    outputs: Mapping[str, str]
    classes: Mapping[int, str]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None


def read_declaration(path: str | os.PathLike[str]) -> Declaration:
    """A declaration from its file.

    Raises:
        TorchweatherError: the file is missing, no YAML, of another format, or has unknown, missing or wrong keys.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "model.yaml"
        >>> _ = file.write_text('''
        ... format: torchweather-detector/1
        ... title: cars
        ... sensor: camera
        ... input: {name: image}
        ... decoder: boxes
        ... outputs: {boxes: boxes, scores: scores}
        ... classes: [car]
        ... ''')
        >>> read_declaration(file).input["layout"]
        'NCHW'
    """
    file = Path(path)
    return _checked(read_yaml(file, "declaration of a detector"), file)


def _checked(values: Any, path: Path) -> Declaration:
    check_format(values, path, "declaration", FORMAT, required=REQUIRED, known=KEYS)
    sensor = _one_of("sensor", values["sensor"], INPUT, path)
    decoder = _one_of("decoder", values["decoder"], OUTPUTS, path)
    if decoder == "boxes" and sensor != "camera":
        raise TorchweatherError(f"{path}: the decoder boxes is for a camera; the sensor is {sensor}.")
    parts = {key: values.get(key) or {} for key in ("input", "outputs", "options")}
    for key, value in parts.items():
        if not isinstance(value, Mapping):
            raise TorchweatherError(f"{path}: {key} must be keys with values; got {value!r}.")
    if not isinstance(parts["input"].get("name"), str):
        raise TorchweatherError(f"{path}: input needs the name that the model has for it; got {parts['input']!r}.")
    refuse_unknown(parts["input"], ("name", *INPUT[sensor]), path, f"key of a {sensor}'s input")
    needed, usable = OUTPUTS[decoder]
    refuse_unknown(parts["outputs"], (*needed, *usable), path, "output")
    for name in needed:
        if not isinstance(parts["outputs"].get(name), str):
            raise TorchweatherError(f"{path}: outputs must name the model's {name}; got {dict(parts['outputs'])!r}.")
    refuse_unknown(parts["options"], OPTIONS[decoder], path, f"option of {decoder}")
    taken = {**INPUT[sensor], **parts["input"]}
    options = {**OPTIONS[decoder], **parts["options"]}
    for key, value in (*taken.items(), *options.items()):
        if key in CHOICES:
            _one_of(key, value, CHOICES[key], path)
    _check_numbers({**taken, **options}, path)
    return Declaration(
        title=str(values["title"]),
        sensor=sensor,
        input=taken,
        decoder=decoder,
        outputs={key: str(name) for key, name in parts["outputs"].items()},
        classes=_classes(values["classes"], path),
        options=options,
        path=path,
    )


def _check_numbers(values: Mapping[str, Any], path: Path) -> None:
    for key in ("scale", "exposure", "threshold", "nms_iou"):
        value = values.get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0):
            raise TorchweatherError(f"{path}: {key} must be a number, 0 or more; got {value!r}.")
    for key in ("batch", "normalised"):
        if not isinstance(values.get(key, False), bool):
            raise TorchweatherError(f"{path}: {key} must be true or false; got {values[key]!r}.")
    size = values.get("size")
    if size is not None and not (
        isinstance(size, list) and len(size) == 2 and all(isinstance(side, int) and side > 0 for side in size)
    ):
        raise TorchweatherError(f"{path}: size must be [height, width] in pixels; got {size!r}.")
    columns = values.get("columns", 4)
    if not isinstance(columns, int) or columns < 3:
        raise TorchweatherError(f"{path}: columns must be 3 or more (x, y, z, intensity, ...); got {columns!r}.")


def _classes(values: Any, path: Path) -> dict[int, str]:
    pairs = list(enumerate(values)) if isinstance(values, list) else None
    if isinstance(values, Mapping):
        pairs = [*values.items()]
    if not pairs or not all(isinstance(number, int) for number, _ in pairs):
        raise TorchweatherError(f"{path}: classes must be a list of names, or number to name; got {values!r}.")
    names = [str(name) for _, name in pairs]
    if len({*names}) < len(names):
        raise TorchweatherError(f"{path}: every class wants a name of its own; got {', '.join(names)}.")
    return {int(number): str(name) for number, name in pairs}


def _one_of(key: str, value: object, known: Iterable[str], path: Path) -> str:
    if value not in [*known]:
        raise TorchweatherError(
            f"{path}: {key} must be one of {', '.join(known)}; got {value!r}.{nearest_name(value, known)}"
        )
    return str(value)
