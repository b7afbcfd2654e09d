"""Inputs, outputs and decoding of an ONNX detector, declared in YAML beside it.

A declaration holds ``format: torchweather-detector/1`` and

- ``title``: a name for the page; ``sensor``: ``camera`` or ``lidar``;
- ``input``: its ``name`` and form. Of a camera: ``layout`` (``NCHW`` or ``NHWC``), ``colour`` (``RGB``, ``BGR``, or
  ``bayer`` for the mosaic in linear light), ``dtype`` (``float32``, ``float16`` or ``uint8``), ``scale``, ``mean``,
  ``std`` (``(scale * picture - mean) / std`` of an sRGB picture in [0, 1]; mean and std in the order of ``colour``),
  ``exposure`` (factor of a raw frame's light), ``size`` (``[height, width]`` of the input), ``fit`` (``stretch``;
  ``letterbox``: one scale for both sides, the frame in the middle; ``corner``: the frame at the top left), ``enlarge``
  (false: smaller frames keep their size, with more border), ``fill`` (border, 0..255 of the picture), ``multiple``
  (without ``size``: frames get a border up to a multiple of it). Of a LiDAR: ``columns`` (number of columns: x, y, z,
  intensity, ...), ``batch`` (true: ``(1, N, C)``, false: ``(N, C)``);
- ``decoder`` and ``outputs``: role to the model's name for it. A leading batch of 1 may stand before all shapes:

  ============== ============================================================================================
  decoder        outputs
  ============== ============================================================================================
  boxes          ``boxes`` (N, 4); ``scores`` (N,) with ``labels`` (N,), or ``scores`` (N, K) of K classes
  yolov8         ``packed`` (4 + K, N): box and K scores
  yolov5         ``packed`` (N, 5 + K): box, objectness, K scores
  end-to-end     ``packed`` (N, 6): box, score, label
  mmdeploy       ``boxes`` (N, 5): box and score; ``labels`` (N,)
  detr           ``logits`` (N, K), or (N, K + 1) with "no object" last for softmax; ``boxes`` (N, 4)
  nanodet        ``scores`` and ``boxes``, a list each: (N, K) and (N, 4 * bins) a level
  segmentation   ``logits`` (K, H, W), or (N, K) of points
  ============== ============================================================================================

- ``classes``: a list of all names in the order of their numbers from 0, or number to name for some of them;
- ``options`` of the decoder: ``form`` (``xyxy``, ``cxcywh``, ``xywh`` or ``yxyx``), ``normalised`` (true: boxes in 0..1
  of the input), ``threshold`` (least score), ``nms_iou`` (overlap from which on the weaker box of a class is left out),
  ``operating_threshold`` (least score of the boxes on the page), ``activation`` of the scores (``none``, ``sigmoid``,
  ``softmax``), ``strides`` of the levels in pixels, ``centre`` of the first place in strides.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.core.schema import MAPPING, TEXT, Key, check_format, check_keys, is_whole, one_of, refuse_unknown
from torchweather.core.yaml_file import read_yaml
from torchweather.evaluation.robustness.declared_forms import DECODERS, INPUT
from torchweather.evaluation.robustness.declared_keys import KEYS
from torchweather.evaluation.robustness.input_ports import INPUT_PORTS

__all__ = ["FORMAT", "Declaration", "read_declaration"]

FORMAT = "torchweather-detector/1"
FILL_IN = "FILL IN"
"""Stands in a draft where the graph does not give the value."""
SCHEMA = {
    "format": TEXT.needed,
    "title": Key("text", lambda value: not isinstance(value, (Mapping, list)), required=True),
    "sensor": one_of(INPUT).needed,
    "input": MAPPING.needed,
    "decoder": one_of(DECODERS).needed,
    "outputs": MAPPING.needed,
    "classes": Key("a list of names, or number to name", lambda value: isinstance(value, (Mapping, list)), True),
    "options": MAPPING.or_null,
}


@dataclass(frozen=True)
class Declaration:
    """A detector as its declaration states it.

    Args:
        title: a name for the page.
        sensor: ``camera`` or ``lidar``.
        input: ``name`` and form, the defaults filled in.
        decoder: one of ``DECODERS``.
        outputs: role to the model's names for it; one name, except where the decoder has levels.
        classes: number to name.
        options: of the decoder, the defaults filled in.
        path: the file.
        all_classes: ``classes`` names every class of the model.
    """

    title: str
    sensor: str
    input: Mapping[str, Any]
    decoder: str
    outputs: Mapping[str, tuple[str, ...]]
    classes: Mapping[int, str]
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    all_classes: bool = False

    @property
    def task(self) -> str:
        """``boxes`` or ``segmentation``."""
        return DECODERS[self.decoder].task


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
        ... input: {name: images, size: [640, 640], fit: letterbox}
        ... decoder: yolov8
        ... outputs: {packed: output0}
        ... classes: [car]
        ... ''')
        >>> found = read_declaration(file)
        >>> found.task, found.input["layout"], found.options["form"]
        ('boxes', 'NCHW', 'cxcywh')
    """
    file = Path(path)
    return _checked(read_yaml(file, "the declaration of a detector", number_keys=("classes",)), file)


def _checked(values: Any, path: Path) -> Declaration:
    check_format(values, FORMAT, str(path), "a declaration of a detector")
    _check_filled_in(values, path)
    check_keys(values, SCHEMA, str(path))
    sensor, decoder, classes = values["sensor"], values["decoder"], values["classes"]
    form = DECODERS[decoder]
    if form.task not in INPUT_PORTS[sensor].tasks:
        raise TorchweatherError(f"{path}: the decoder {decoder} is for a camera; the sensor is {sensor}.")
    name = Key("the name that the model has for it", TEXT.fits, required=True)
    taken = _filled("input", values["input"], INPUT[sensor], {"name": name}, path)
    options = _filled("options", values.get("options") or {}, form.options, {}, path)
    _check_fit(values["input"], taken, path)
    outputs = _outputs(decoder, values["outputs"], path)
    if form.levels and {len(names) for names in outputs.values()} != {len(options["strides"])}:
        raise TorchweatherError(
            f"{path}: {decoder} needs one output a level in each of {', '.join(outputs)}; strides has "
            f"{len(options['strides'])} levels, outputs {', '.join(str(len(names)) for names in outputs.values())}."
        )
    return Declaration(
        title=str(values["title"]),
        sensor=sensor,
        input=taken,
        decoder=decoder,
        outputs=outputs,
        classes=_classes(classes, path),
        options=options,
        path=path,
        all_classes=isinstance(classes, list),
    )


def _filled(
    at: str, given: Mapping[str, Any], defaults: Mapping[str, Any], more: Mapping[str, Key], path: Path
) -> dict[str, Any]:
    """The values of the input or the options, the defaults filled in."""
    check_keys(given, {**more, **{key: KEYS[key] for key in defaults}}, str(path), at)
    return {**defaults, **given}


def _check_filled_in(values: Any, path: Path) -> None:
    """Refuse a draft in which something is still to be filled in."""
    for key, value in values.items():
        inside = [*value.values()] if isinstance(value, Mapping) else value if isinstance(value, list) else [value]
        if FILL_IN in inside:
            raise TorchweatherError(f"{path}: {key} is still to be filled in; got {value!r}. See the comments there.")


def _outputs(decoder: str, given: Mapping[str, Any], path: Path) -> dict[str, tuple[str, ...]]:
    """Names of the model's outputs for each role of the decoder."""
    form = DECODERS[decoder]
    refuse_unknown(given, (*form.needed, *form.usable), "outputs", str(path))
    found: dict[str, tuple[str, ...]] = {}
    for role in (*form.needed, *(each for each in form.usable if each in given)):
        names = given.get(role)
        listed: list[Any] = names if isinstance(names, list) and form.levels else [names]
        if not listed or not all(isinstance(name, str) for name in listed):
            kind = "a list of the model's outputs" if form.levels else "the model's output"
            raise TorchweatherError(f"{path}: outputs must name {kind} for {role}; got {dict(given)!r}.")
        found[role] = tuple(listed)
    every = [name for names in found.values() for name in names]
    if len({*every}) < len(every):
        raise TorchweatherError(
            f"{path}: outputs must name every output once; got {', '.join(every)}. If boxes, scores and classes are "
            f"one output, declare outputs: {{packed: {every[0]}}} and its decoder. Decoders of one output: yolov8 "
            "(4 + K, N), yolov5 (N, 5 + K), end-to-end (N, 6)."
        )
    return found


def _check_fit(given: Mapping[str, Any], taken: Mapping[str, Any], path: Path) -> None:
    """Refuse a border where nothing says how large the input is, or where it would be two things."""
    if taken.get("fit", "stretch") != "stretch" and taken["size"] is None:
        raise TorchweatherError(
            f"{path}: fit: {taken['fit']} needs size: [height, width] of the input in pixels; got none."
        )
    if given.get("multiple") not in (None, 1) and taken["size"] is not None:
        raise TorchweatherError(f"{path}: multiple is for an input without size; got both. Leave one of them out.")


def _classes(values: Any, path: Path) -> dict[int, str]:
    pairs = list(enumerate(values)) if isinstance(values, list) else None
    if isinstance(values, Mapping):
        pairs = [*values.items()]
    if not pairs or not all(is_whole(number) and number >= 0 for number, _ in pairs):
        raise TorchweatherError(f"{path}: classes must be a list of names, or number to name; got {values!r}.")
    names = [str(name) for _, name in pairs]
    if len({*names}) < len(names):
        raise TorchweatherError(f"{path}: every class needs a name of its own; got {', '.join(names)}.")
    return {int(number): str(name) for number, name in pairs}
