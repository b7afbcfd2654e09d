"""Bags of ROS 1 and 2: images, clouds and radar detections by topic, one message at a time (extra ``ros``)."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import MissingExtraError, TorchweatherError, check_one_of, nearest_name
from torchweather.core.extras import install_hint
from torchweather.io.point_cloud import PointCloud, cloud_from_stored
from torchweather.io.radar_columns import SPEEDS
from torchweather.io.radar_points import RadarPoints, detections_from_stored
from torchweather.io.ros_messages import (
    IMAGE_ENCODINGS,
    cloud_fields,
    compressed_image,
    plain_image,
    radar_returns,
    renamed,
)
from torchweather.radar.sensor import Radar

__all__ = ["RosBag", "RosFrame", "RosTopic"]

Content = TypeVar("Content", Tensor, PointCloud, RadarPoints)

IMAGE, COMPRESSED, CLOUD, RADAR = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
    "radar_msgs/msg/RadarScan",
)
# Definitions that a message of each type is read by, with its header's.
_HEADER, _TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
_PARTS = {CLOUD: ("sensor_msgs/msg/PointField",), RADAR: ("radar_msgs/msg/RadarReturn",)}
_RADAR_DEFINITION = (
    "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n"
    "================================================================================\nMSG: radar_msgs/RadarReturn\n"
    "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n"
)


@dataclass(frozen=True)
class RosTopic:
    """A topic of a bag.

    Args:
        name: such as ``/ouster/points``.
        message_type: such as ``sensor_msgs/msg/PointCloud2``; ROS 1 types are written this way, too.
        messages: their number.
    """

    name: str
    message_type: str
    messages: int


@dataclass(frozen=True, eq=False)
class RosFrame(Generic[Content]):
    """A message of a sensor.

    Args:
        content: `Tensor` of an image, `PointCloud` or `RadarPoints`.
        stamp_ns: time in the message's header, nanoseconds in the sensor's clock.
        recorded_ns: time at which the message was recorded, nanoseconds.
        frame_id: coordinate frame in the header, such as ``os_sensor``.
        encoding: of an image, such as ``bayer_rggb8`` or ``jpeg``; else empty.
    """

    content: Content
    stamp_ns: int
    recorded_ns: int
    frame_id: str
    encoding: str = ""


class RosBag:
    """A recording of ROS 1 (``.bag``) or ROS 2 (a folder with metadata.yaml, ``.mcap`` or ``.db3``).

    Messages are read one after the other in the order in which they were recorded, so a recording of any length takes
    the memory of a message and of a chunk of the file. A ROS 2 bag without definitions of its messages is read with
    those of ROS 2 Humble.

    Args:
        path: of the bag.

    Attributes:
        path: of the bag.
        topics: what the bag holds, by name.

    Raises:
        MissingExtraError: rosbags is not installed (extra ``ros``).
        TorchweatherError: no such bag, or a damaged one.

    Example:
        >>> bag = RosBag("run.mcap")  # doctest: +SKIP
        >>> [(topic.name, topic.messages) for topic in bag.topics]  # doctest: +SKIP
        [('/ouster/points', 600), ('/triton/image_raw', 900)]
        >>> for frame in bag.points("/ouster/points"):  # doctest: +SKIP
        ...     print(frame.stamp_ns, frame.content.points.shape)
    """

    path: Path
    topics: tuple[RosTopic, ...]

    def __init__(self, path: str | os.PathLike[str]) -> None:
        check_arguments("RosBag(path: path)", path)
        self.path = Path(path)
        with self._opened() as reader:
            found: dict[str, list[Any]] = {}
            for one in reader.connections:
                found.setdefault(one.topic, []).append(one)
        self.topics = tuple(
            RosTopic(name, each[0].msgtype, sum(one.msgcount for one in each)) for name, each in sorted(found.items())
        )

    def __repr__(self) -> str:
        return f"RosBag({str(self.path)!r}: {len(self.topics)} topics)"

    def images(self, topic: str, *, encoding: str | None = None) -> Iterator[RosFrame[Tensor]]:
        """Images of a topic.

        Args:
            topic: of type sensor_msgs/Image or sensor_msgs/CompressedImage.
            encoding: of plain images in place of the messages' own, for drivers that name none or another:
                ``rgb8``, ``bayer_rggb8``, ``mono16``, ...

        Yields:
            ``(1, H, W)`` for one value a pixel (grey, mosaic, depth as 16UC1 or 32FC1) or ``(3, H, W)`` RGB, in the
            stored dtype.

        Raises:
            TorchweatherError: no such topic, one of another type, or a message that cannot be read.
        """
        check_arguments("RosBag.images(topic: str, encoding: str | None)", topic, encoding)
        if encoding is not None:
            check_one_of("encoding", encoding, IMAGE_ENCODINGS, owner="RosBag.images")
        kind = self._checked(topic, (IMAGE, COMPRESSED))
        if kind == COMPRESSED:
            return self._frames(topic, compressed_image, lambda message: str(message.format))
        return self._frames(
            topic,
            lambda message, source: plain_image(message, source, encoding),
            lambda message: encoding or str(message.encoding),
        )

    def points(
        self,
        topic: str,
        *,
        intensity: str = "auto",
        columns: Sequence[str] | None = None,
        dtype: torch.dtype | None = None,
        intensity_unit: str | None = None,
    ) -> Iterator[RosFrame[PointCloud]]:
        """Clouds of a topic.

        Args:
            topic: of type sensor_msgs/PointCloud2.
            intensity: name of the field; ``auto`` or ``none``, as of `read_points`.
            columns: names of the fields to read; all by default.
            dtype: ``torch.float32`` or ``torch.float64``; by default float32 where it holds every number exactly.
            intensity_unit: of the sensor, ``Lidar.intensity_unit``, which chooses among several intensities.

        Yields:
            `PointCloud`: x, y, z in metres in the message's frame, intensity, then the other fields.

        Raises:
            TorchweatherError: no such topic, one of another type, or a message that cannot be read.
        """
        check_arguments(
            "RosBag.points(topic: str, intensity: str, columns: Sequence[str] | None, dtype: dtype | None, "
            "intensity_unit: str | None)",
            topic,
            intensity,
            columns,
            dtype,
            intensity_unit,
        )
        self._checked(topic, (CLOUD,))

        def cloud(message: Any, source: Path) -> PointCloud:
            return cloud_from_stored(
                cloud_fields(message, source),
                source,
                intensity=intensity,
                columns=columns,
                dtype=dtype,
                intensity_unit=intensity_unit,
            )

        return self._frames(topic, cloud)

    def radar(
        self,
        topic: str,
        radar: Radar | None = None,
        *,
        columns: Mapping[str, str] | None = None,
        speed: str = "relative",
    ) -> Iterator[RosFrame[RadarPoints]]:
        """Detections of a topic.

        Args:
            topic: of type radar_msgs/RadarScan, or a sensor_msgs/PointCloud2 with the columns of `read_radar`.
            radar: whose link budget gives the power from the cross section or the reverse, where a message has but one.
            columns: of a PointCloud2 the message's name of each of ours, such as ``{"speed_m_per_s": "doppler",
                "power_db": "intensity"}``.
            speed: ``relative`` or ``compensated``, as of `read_radar`.

        Yields:
            `RadarPoints`. The doppler velocity of a RadarScan is taken as positive when receding; its text does not
            state the sign.

        Raises:
            TorchweatherError: no such topic, one of another type, or a message without a column; with those it has.
        """
        check_arguments(
            "RosBag.radar(topic: str, radar: Radar | None, columns: Mapping[str] | None, speed: str)",
            topic,
            radar,
            columns,
            speed,
        )
        check_one_of("speed", speed, SPEEDS, owner="RosBag.radar")
        scan = self._checked(topic, (RADAR, CLOUD)) == RADAR
        names = dict(columns or {})
        check_arguments("RosBag.radar(columns: Sequence[str])", list(names.values()))

        def detections(message: Any, source: Path) -> RadarPoints:
            stored = radar_returns(message) if scan else cloud_fields(message, source)
            return detections_from_stored(renamed(stored, names, source), source, radar, speed)

        return self._frames(topic, detections)

    def _checked(self, topic: str, types: tuple[str, ...]) -> str:
        """Type of a topic that is one of those."""
        found = {one.name: one for one in self.topics}
        if topic not in found:
            there = ", ".join(f"{one.name} ({one.message_type})" for one in self.topics) or "no topic"
            raise TorchweatherError(f"{self.path}: no topic {topic!r}; got {there}.{nearest_name(topic, found)}")
        kind = found[topic].message_type
        if kind not in types:
            fitting = ", ".join(one.name for one in self.topics if one.message_type in types) or "none"
            raise TorchweatherError(
                f"{self.path}: topic {topic}: expected {' or '.join(types)}; got {kind}. Topics of that type: "
                f"{fitting}."
            )
        return kind

    def _frames(
        self,
        topic: str,
        decode: Callable[[Any, Path], Content],
        encoding: Callable[[Any], str] = lambda message: "",
    ) -> Iterator[RosFrame[Content]]:
        """Messages of a topic, decoded."""
        with self._opened() as reader:
            kind = next(one.message_type for one in self.topics if one.name == topic)
            wanted = [one for one in reader.connections if (one.topic, one.msgtype) == (topic, kind)]
            self._check_definitions(reader, kind)
            messages = reader.messages(connections=wanted)
            number = 0
            while True:
                source = self.path / topic.strip("/") / str(number)
                with self._refused(source):
                    following = next(messages, None)
                    if following is None:
                        return
                    connection, recorded_ns, data = following
                    message = reader.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                yield RosFrame(
                    decode(message, source),
                    int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec),
                    int(recorded_ns),
                    str(message.header.frame_id),
                    encoding(message),
                )
                number += 1

    def _check_definitions(self, reader: Any, kind: str) -> None:
        """Refuse a bag whose own definition of a message lacks a field, or has it in another type."""
        usual, found = reader.default_typestore.fielddefs, reader.typestore.fielddefs
        for name in (kind, *_PARTS.get(kind, ()), _HEADER, _TIME):
            defined = dict(found[name][1]) if name in found else {}
            other = [field for field, form in usual[name][1] if defined.get(field) != form]
            if other:
                raise TorchweatherError(
                    f"{self.path}: expected {name} with {', '.join(field for field, _ in usual[name][1])}; the bag "
                    f"defines it with {', '.join(defined) or 'nothing'}, or {other[0]} as another type."
                )

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        try:
            highlevel, typesys = (importlib.import_module(f"rosbags.{name}") for name in ("highlevel", "typesys"))
        except ImportError as error:
            raise MissingExtraError(f"Bags of ROS need rosbags. {install_hint('ros')}") from error
        if not self.path.exists():
            raise TorchweatherError(f"{self.path}: no such bag.")
        usual = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        usual.register(typesys.get_types_from_msg(_RADAR_DEFINITION, RADAR))
        with self._refused(self.path):
            reader = highlevel.AnyReader([self.path], default_typestore=usual)
            reader.open()
        try:
            yield reader
        finally:
            reader.close()

    @contextmanager
    def _refused(self, source: Path) -> Iterator[None]:
        """Within the block what rosbags and its parts raise of a damaged bag becomes the package's own error."""
        try:
            yield
        except Exception as error:
            raise TorchweatherError(
                f"{source}: expected a bag of ROS 1 (.bag) or ROS 2 (a folder with metadata.yaml, .mcap, .db3); it "
                f"cannot be read ({type(error).__name__}: {error})."
            ) from error
