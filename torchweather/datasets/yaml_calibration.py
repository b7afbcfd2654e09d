"""Camera calibrations in YAML, as OpenCV and ROS write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.core.yaml_file import parse_yaml

__all__ = ["camera_fields_from_yaml"]

_MAX_CHARACTERS = 2**20  # a calibration has some 2,000
# Names of the same entry, lower case without underscores: OpenCV's samples, ROS 1 and 2, messages and files.
_MATRIX = ("cameramatrix", "k", "intrinsicmatrix", "m")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "distortion", "d")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
# OpenCV's order; beyond it come the rational, thin prism and tilted models.
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
_PLAIN_MODELS = ("", "plumb_bob", "radtan", "brown_conrady", "opencv", "pinhole")


OPENCV_TAGS = {"tag:yaml.org,2002:opencv-matrix": "map"}


def camera_fields_from_yaml(source: Path, text: str, supported: str) -> dict[str, Any]:
    """Fields of `Camera` from OpenCV's or ROS's YAML: ``K``, ``D`` and, where it is there, the image size.

    Args:
        source: the file, for messages.
        text: its content.
        supported: what is read instead, for messages.

    Raises:
        TorchweatherError: no such calibration, or a lens that is not Brown-Conrady.
    """
    if len(text) > _MAX_CHARACTERS:
        raise TorchweatherError(f"{source}: expected the YAML of a calibration; got {len(text)} characters.")
    # OpenCV's first line, %YAML:1.0, is no YAML.
    plain = "\n".join(line for line in text.splitlines() if not line.startswith("%YAML"))
    content = parse_yaml(plain, str(source), "a calibration of OpenCV or ROS", tags=OPENCV_TAGS, allow_nan=True)
    entries = (
        {str(key).lower().replace("_", ""): value for key, value in content.items()}
        if isinstance(content, dict)
        else {}
    )
    matrix = _first(entries, _MATRIX)
    if matrix is None:
        keys = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise TorchweatherError(f"{source}: found YAML with {keys}; supported are {supported}.")
    values = _numbers(matrix, source, "camera matrix")
    if len(values) != 9:
        raise TorchweatherError(f"{source}: expected 9 numbers in the camera matrix; got {len(values)}.")
    if abs(values[1]) > 1e-3 * abs(values[0]):
        raise TorchweatherError(f"{source}: expected a camera matrix without skew; got {values[1]:g} px.")
    fields: dict[str, Any] = {"fx": values[0], "fy": values[4], "cx": values[2], "cy": values[5]}
    for side, names in (("width", _WIDTH), ("height", _HEIGHT)):
        pixels = _first(entries, names)
        if pixels is not None:
            fields[side] = int(_number(pixels, source, side))
    return fields | _lens(entries, source)


def _lens(entries: Mapping[str, Any], source: Path) -> dict[str, float]:
    """Brown-Conrady coefficients; other lenses are refused."""
    model = str(entries.get("distortionmodel") or "").lower()
    if entries.get("fisheyemodel") not in (None, 0, False):
        model = "fisheye"
    stored = _first(entries, _DISTORTION)
    values = [] if stored is None else _numbers(stored, source, "distortion coefficients")
    if any(values) and (model not in (*_PLAIN_MODELS, "rational_polynomial") or any(values[5:])):
        kind = model or f"a model of {len(values)} coefficients"
        raise TorchweatherError(
            f"{source}: the lens distortion is {kind}; a Camera has k1, k2, p1, p2, k3 (plumb_bob). Undistort the "
            "frames and give the calibration of the undistorted ones."
        )
    return dict(zip(_COEFFICIENTS, values, strict=False))


def _first(entries: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((entries[name] for name in names if name in entries), None)


def _numbers(value: Any, source: Path, name: str) -> list[float]:
    """All numbers of a list, of nested lists, or of a matrix with rows, cols and data, in rows."""
    if isinstance(value, Mapping):
        data = _numbers(value.get("data"), source, name)
        if "rows" in value and "cols" in value:
            count = _number(value["rows"], source, name) * _number(value["cols"], source, name)
            if count != len(data):
                raise TorchweatherError(f"{source}: expected {count:g} numbers in the {name}; got {len(data)}.")
        return data
    if not isinstance(value, list):
        raise TorchweatherError(f"{source}: expected a list of numbers in the {name}; got {value!r}.")
    return [
        number
        for item in value
        for number in (_numbers(item, source, name) if isinstance(item, list) else [_number(item, source, name)])
    ]


def _number(value: Any, source: Path, name: str) -> float:
    """YAML 1.1 takes 1e-3 for text; both files and people write it."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise TorchweatherError(f"{source}: expected finite numbers in the {name}; got {value!r}.")
    return number
