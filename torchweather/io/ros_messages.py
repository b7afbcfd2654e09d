"""Messages of ROS 1 and 2 as images, clouds and detections: sensor_msgs and radar_msgs, by the names of their fields.

References:
    sensor_msgs: Image, CompressedImage, PointCloud2, PointField, image_encodings.hpp (ros2/common_interfaces).
    radar_msgs: RadarScan, RadarReturn (ros-perception/radar_msgs).
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchweather.core.errors import TorchweatherError, nearest_name
from torchweather.io.arrays import array_to_tensor
from torchweather.io.images import decoded_picture
from torchweather.io.stored_points import PointField, PointLayout, StoredPoints

__all__ = ["IMAGE_ENCODINGS", "cloud_fields", "compressed_image", "plain_image", "radar_returns", "renamed"]

_BAYER = tuple(f"bayer_{pattern}" for pattern in ("rggb", "bggr", "gbrg", "grbg"))
# Of each encoding the dtype, the channels, and which of them are red, green and blue; one value a pixel has none.
IMAGE_ENCODINGS: Mapping[str, tuple[str, int, tuple[int, ...]]] = {
    "rgb8": ("u1", 3, (0, 1, 2)),
    "bgr8": ("u1", 3, (2, 1, 0)),
    "rgba8": ("u1", 4, (0, 1, 2)),
    "bgra8": ("u1", 4, (2, 1, 0)),
    "rgb16": ("u2", 3, (0, 1, 2)),
    "bgr16": ("u2", 3, (2, 1, 0)),
    **dict.fromkeys(("mono8", "8UC1", *(f"{pattern}8" for pattern in _BAYER)), ("u1", 1, ())),
    **dict.fromkeys(("mono16", "16UC1", *(f"{pattern}16" for pattern in _BAYER)), ("u2", 1, ())),
    "32FC1": ("f4", 1, ()),
}
"""Encodings of sensor_msgs/Image that are read; alpha is dropped."""

# Codes of sensor_msgs/PointField: INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64.
_POINT_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
# Fields of radar_msgs/RadarReturn by the names that `read_radar` gives them.
_RADAR_RETURN = {
    "range_m": "range",
    "azimuth_rad": "azimuth",
    "elevation_rad": "elevation",
    "speed_m_per_s": "doppler_velocity",
    "power_db": "amplitude",
}


def plain_image(message: Any, source: Path, encoding: str | None = None) -> Tensor:
    """Pixels ``(1, H, W)`` or ``(3, H, W)`` RGB of a sensor_msgs/Image, in the dtype of its encoding.

    Args:
        message: with ``height``, ``width``, ``encoding``, ``is_bigendian``, ``step`` and ``data``.
        source: name of the message, for errors.
        encoding: in place of the message's own, one of `IMAGE_ENCODINGS`.

    Raises:
        TorchweatherError: another encoding, or less data than height and step promise.
    """
    name = message.encoding if encoding is None else encoding
    if name not in IMAGE_ENCODINGS:
        raise TorchweatherError(
            f"{source}: expected an image encoded as {', '.join(IMAGE_ENCODINGS)}; got {name!r}. Where the pixels have "
            "one of these layouts, pass encoding=..."
        )
    dtype, channels, order = IMAGE_ENCODINGS[name]
    kind = np.dtype(f"{'>' if message.is_bigendian else '<'}{dtype}")
    height, width, step = int(message.height), int(message.width), int(message.step)
    pixel_bytes = channels * kind.itemsize
    data = _bytes_of(message.data)
    if min(height, width) < 1 or step < width * pixel_bytes or data.size < height * step:
        raise TorchweatherError(
            f"{source}: expected {height} rows of {width} pixels ({name}, {pixel_bytes} bytes each), {step} bytes a "
            f"row; got {data.size} bytes. The message is damaged, or has another encoding."
        )
    rows = data[: height * step].reshape(height, step)[:, : width * pixel_bytes]
    pixels = np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)
    chosen = pixels[..., list(order)] if order else pixels
    return array_to_tensor(np.moveaxis(chosen, -1, 0), source, "an image")


def compressed_image(message: Any, source: Path) -> Tensor:
    """Pixels ``(1, H, W)`` or ``(3, H, W)`` sRGB of a sensor_msgs/CompressedImage: JPEG, PNG, TIFF or WebP.

    Args:
        message: with ``format`` and ``data``.
        source: name of the message, for errors.

    Raises:
        TorchweatherError: depth of the plugin compressedDepth, or what is no picture.
    """
    if "compressedDepth" in message.format:
        raise TorchweatherError(
            f"{source}: expected a compressed picture; got depth ({message.format}). Record the topic of the plain "
            "depth image, encoded as 16UC1 or 32FC1."
        )
    data = _bytes_of(message.data)
    pixels, _ = decoded_picture(io.BytesIO(data.tobytes()), source, data.size)
    return array_to_tensor(pixels[None] if pixels.ndim == 2 else np.moveaxis(pixels, -1, 0), source, "an image")


def cloud_fields(message: Any, source: Path) -> StoredPoints:
    """Fields of a sensor_msgs/PointCloud2 and their numbers.

    Args:
        message: with ``height``, ``width``, ``fields``, ``is_bigendian``, ``point_step``, ``row_step`` and ``data``.
        source: name of the message, for errors.

    Raises:
        TorchweatherError: a field that does not fit into a point, or less data than the steps promise.
    """
    height, width = int(message.height), int(message.width)
    step, row_step = int(message.point_step), int(message.row_step)
    order = ">" if message.is_bigendian else "<"
    fields = tuple(_point_field(one, order, step, source) for one in message.fields if one.count)
    data = _bytes_of(message.data)
    rows = max(height, 1) if width else 0
    row_step = row_step if height > 1 else width * step  # of a single row some drivers leave it 0
    needed = (rows - 1) * row_step + width * step if rows else 0
    if not fields or row_step < width * step or data.size < needed:
        raise TorchweatherError(
            f"{source}: expected {height} x {width} points of {step} bytes with fields; got "
            f"{', '.join(one.name for one in fields) or 'no field'}, {row_step} bytes a row and {data.size} bytes. The "
            "message is damaged."
        )
    offsets = [int(one.offset) for one in message.fields if one.count]
    point = np.dtype(
        {
            "names": [f"f{k}" for k in range(len(fields))],
            "formats": [(one.dtype, (one.count,)) if one.count > 1 else one.dtype for one in fields],
            "offsets": offsets,
            "itemsize": step,
        }
    )
    grid: npt.NDArray[Any] = np.ndarray((rows, width), point, data[:needed].tobytes(), strides=(row_step, step))
    flat = grid.reshape(-1)
    arrays = tuple(np.ascontiguousarray(flat[f"f{k}"]) for k in range(len(fields)))
    return StoredPoints(PointLayout("ros", fields), arrays, (height, width) if rows > 1 else None)


def radar_returns(message: Any) -> StoredPoints:
    """Range, angles, speed and power of a radar_msgs/RadarScan, by the names of `read_radar`.

    Args:
        message: with ``returns``, each with ``range`` (m), ``azimuth`` and ``elevation`` (rad), ``doppler_velocity``
            (m/s, taken as positive when receding; the message's text does not state the sign) and ``amplitude`` (dB).
    """
    columns = tuple(
        np.array([getattr(one, name) for one in message.returns], np.float32) for name in _RADAR_RETURN.values()
    )
    return StoredPoints(PointLayout("ros", tuple(PointField(name, "<f4") for name in _RADAR_RETURN)), columns)


def renamed(stored: StoredPoints, columns: Mapping[str, str], source: Path) -> StoredPoints:
    """The same numbers under other names.

    Args:
        stored: the content of a message.
        columns: the message's name of each new one, such as ``{"speed_m_per_s": "doppler"}``.
        source: name of the message, for errors.

    Raises:
        TorchweatherError: no such field; with those that there are.
    """
    names = [one.name for one in stored.layout.fields]
    for name in columns.values():
        if name not in names:
            raise TorchweatherError(
                f"{source}: expected a field {name!r}; got {', '.join(names)}.{nearest_name(name, names)}"
            )
    new = {old: name for name, old in columns.items()}
    fields = tuple(replace(one, name=new.get(one.name, one.name)) for one in stored.layout.fields)
    return replace(stored, layout=replace(stored.layout, fields=fields))


def _point_field(one: Any, order: str, step: int, source: Path) -> PointField:
    kind, count, offset = _POINT_DTYPES.get(int(one.datatype)), int(one.count), int(one.offset)
    if kind is None or offset + np.dtype(kind).itemsize * count > step:
        raise TorchweatherError(
            f"{source}: field {one.name!r}: expected datatype 1 to 8 within {step} bytes a point; got datatype "
            f"{one.datatype}, count {count} at byte {offset}."
        )
    return PointField(str(one.name), f"{order}{kind}", count)


def _bytes_of(data: Any) -> npt.NDArray[np.uint8]:
    return np.asarray(data, np.uint8).reshape(-1) if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
