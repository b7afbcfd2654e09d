"""Bags of ROS, written by rosbags itself: all forms of file, every encoding, and bags that are not what they say."""

from __future__ import annotations

import io
import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from torchweather import Radar
from torchweather.core.errors import MissingExtraError, TorchweatherError
from torchweather.io import RosBag
from torchweather.io.ros_messages import IMAGE_ENCODINGS, cloud_fields, plain_image

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed (extra ros)")

from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

FORMS = ("ros1", "sqlite3", "mcap")
CLOUD = np.array([[28.0, 1.0, -1.5, 40.0], [15.0, -2.0, 0.5, 7.0], [56.0, 0.0, 1.0, 200.0]], np.float32)
RETURNS = np.array([[28.0, 0.1, 0.0, -3.0, 12.0], [15.0, -0.2, 0.05, 0.5, 20.0]], np.float32)
SOURCE = Path("a.bag/topic/0")


def store_of(form: str) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    returned = "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n"
    store.register(get_types_from_msg(returned, "radar_msgs/msg/RadarReturn"))
    scan = "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n"
    store.register(get_types_from_msg(scan, "radar_msgs/msg/RadarScan"))
    return store


class Recorder:
    """Messages of the kinds that a bag of the tests holds."""

    def __init__(self, form: str) -> None:
        self.form, self.store = form, store_of(form)

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, frame_id: str, number: int) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=100 + number, nanosec=5)
        extra = {"seq": number} if self.form == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **extra)

    def image(self, number: int, pixels: np.ndarray, encoding: str) -> Any:
        height, width = pixels.shape[:2]
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header("triton", number),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=pixels.nbytes // height,
            data=pixels.reshape(-1).view(np.uint8),
        )

    def cloud(self, number: int, names: tuple[str, ...] = ("x", "y", "z", "intensity"), rows: Any = CLOUD) -> Any:
        field = "sensor_msgs/msg/PointField"
        return self.make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header("os_sensor", number),
            height=1,
            width=len(rows),
            fields=[self.make(field, name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate(names)],
            is_bigendian=False,
            point_step=4 * len(names),
            row_step=4 * len(names) * len(rows),
            data=np.ascontiguousarray(rows).reshape(-1).view(np.uint8),
            is_dense=True,
        )

    def scan(self, number: int) -> Any:
        names = ("range", "azimuth", "elevation", "doppler_velocity", "amplitude")
        each = [
            self.make("radar_msgs/msg/RadarReturn", **dict(zip(names, row.tolist(), strict=True))) for row in RETURNS
        ]
        return self.make("radar_msgs/msg/RadarScan", header=self.header("radar", number), returns=each)

    def write(self, path: Path, messages: list[tuple[str, Any]]) -> Path:
        ros1 = self.form == "ros1"
        plugin = {} if ros1 else {"version": 8, "storage_plugin": StoragePlugin[self.form.upper()]}
        with (Writer1 if ros1 else Writer2)(path, **plugin) as writer:
            topics = {name: message.__msgtype__ for name, message in messages}
            given = {name: writer.add_connection(name, kind, typestore=self.store) for name, kind in topics.items()}
            encode = self.store.serialize_ros1 if ros1 else self.store.serialize_cdr
            for time, (name, message) in enumerate(messages):
                writer.write(given[name], 1000 + time, encode(message, message.__msgtype__))
        return path


def png(pixels: np.ndarray) -> np.ndarray:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return np.frombuffer(file.getvalue(), np.uint8)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_bag_gives_what_was_recorded(form: str, tmp_path: Path) -> None:
    recorder = Recorder(form)
    mosaic = np.arange(24, dtype=np.uint16).reshape(4, 6) * 900
    colour = np.arange(72, dtype=np.uint8).reshape(4, 6, 3)
    packed = recorder.make(
        "sensor_msgs/msg/CompressedImage", header=recorder.header("flir", 7), format="png", data=png(colour)
    )
    path = recorder.write(
        tmp_path / ("run.bag" if form == "ros1" else "run"),
        [
            ("/triton/raw", recorder.image(0, mosaic, "bayer_rggb16")),
            ("/ouster/points", recorder.cloud(0)),
            ("/triton/raw", recorder.image(1, mosaic[::-1].copy(), "bayer_rggb16")),
            ("/flir/compressed", packed),
            ("/radar/scan", recorder.scan(3)),
        ],
    )
    bag = RosBag(path)
    assert [(one.name, one.messages) for one in bag.topics] == [
        ("/flir/compressed", 1),
        ("/ouster/points", 1),
        ("/radar/scan", 1),
        ("/triton/raw", 2),
    ]
    first, second = bag.images("/triton/raw")
    torch.testing.assert_close(first.content, torch.from_numpy(mosaic)[None], rtol=0, atol=0)
    assert (first.encoding, first.frame_id, first.stamp_ns, first.recorded_ns) == (
        "bayer_rggb16",
        "triton",
        100_000_000_005,
        1000,
    )
    assert second.stamp_ns - first.stamp_ns == 10**9
    torch.testing.assert_close(second.content[0].flip(0), first.content[0], rtol=0, atol=0)
    (thermal,) = bag.images("/flir/compressed")
    torch.testing.assert_close(thermal.content, torch.from_numpy(colour).permute(2, 0, 1), rtol=0, atol=0)
    (cloud,) = bag.points("/ouster/points")
    assert cloud.content.columns == ("x", "y", "z", "intensity")
    torch.testing.assert_close(cloud.content.points, torch.from_numpy(CLOUD), rtol=0, atol=0)
    (scan,) = bag.radar("/radar/scan", Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0))
    torch.testing.assert_close(scan.content.points[:, :3].norm(dim=1), torch.tensor([28.0, 15.0]))
    torch.testing.assert_close(scan.content.points[:, 3:5], torch.from_numpy(RETURNS[:, 3:]))
    assert scan.content.points[0, 1] == pytest.approx(28 * np.sin(0.1), rel=1e-6)  # anticlockwise is left


def test_clouds_of_a_radar_have_columns_by_their_names(tmp_path: Path) -> None:
    recorder = Recorder("mcap")
    rows = np.array([[10.0, 0.0, 0.0, -2.0, 33.0]], np.float32)
    message = recorder.cloud(0, ("x", "y", "z", "doppler", "snr"), rows)
    path = recorder.write(tmp_path / "run", [("/radar", message)])
    radar = Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0)
    (file,) = path.glob("*.mcap")
    for one in (RosBag(path), RosBag(file)):
        (frame,) = one.radar("/radar", radar, columns={"speed_m_per_s": "doppler", "power_db": "snr"})
        assert frame.content.points[0, :5].tolist() == [10.0, 0.0, 0.0, -2.0, 33.0]
    with pytest.raises(TorchweatherError, match=r"radar/0: expected a speed.* got x, y, z, doppler, snr"):
        list(RosBag(path).radar("/radar", radar))
    with pytest.raises(TorchweatherError, match=r"expected a field 'dopler'; got x, y, .*doppler"):
        list(RosBag(path).radar("/radar", radar, columns={"speed_m_per_s": "dopler"}))


def test_memory_is_that_of_a_message_not_of_the_bag(tmp_path: Path) -> None:
    recorder = Recorder("sqlite3")
    frame = np.zeros((256, 1024), np.uint8)
    path = recorder.write(tmp_path / "run", [("/raw", recorder.image(k, frame, "mono8")) for k in range(40)])
    tracemalloc.start()
    try:
        assert sum(1 for _ in RosBag(path).images("/raw")) == 40
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 10 * frame.nbytes  # the bag has 40


def test_what_is_asked_wrongly_is_refused_with_what_there_is(tmp_path: Path) -> None:
    recorder = Recorder("ros1")
    images = [("/raw", recorder.image(0, np.zeros((2, 3), np.uint8), "mono8"))]
    path = recorder.write(tmp_path / "run.bag", [*images, ("/ouster/points", recorder.cloud(0))])
    bag = RosBag(path)
    with pytest.raises(TorchweatherError, match=r"no topic '/ouster/point'; got /ouster/points \(.*\), /raw"):
        bag.points("/ouster/point")
    with pytest.raises(TorchweatherError, match=r"expected .*PointCloud2; got .*Image\. Topics of that type: /ou"):
        bag.points("/raw")
    with pytest.raises(ValueError, match="encoding must be"):
        bag.images("/raw", encoding="bayer")
    with pytest.raises(TorchweatherError, match="no such bag"):
        RosBag(tmp_path / "other.bag")
    with pytest.raises(TorchweatherError, match="cannot be read"):
        RosBag(tmp_path)
    whole = path.read_bytes()
    for size in (0, 100, len(whole) // 2):
        path.write_bytes(whole[:size])
        with pytest.raises(TorchweatherError, match="cannot be read"):
            RosBag(path)


def test_a_bag_that_defines_a_message_otherwise_is_refused(tmp_path: Path) -> None:
    recorder = Recorder("mcap")
    path = recorder.write(tmp_path / "run", [("/raw", recorder.image(0, np.zeros((2, 3), np.uint8), "mono8"))])
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes().replace(b"uint32 height", b"uint32 xeight"))
    with pytest.raises(TorchweatherError, match=r"expected .*Image with .*height.* defines it with .*xeight"):
        list(RosBag(file).images("/raw"))


def test_rosbags_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'torchweather\[ros\]'"):
        RosBag(tmp_path)


@pytest.mark.parametrize("encoding", IMAGE_ENCODINGS)
@pytest.mark.parametrize("big", [False, True])
def test_encodings(encoding: str, big: bool) -> None:
    """Rows padded to 64 bytes; red is 1, green 2, blue 3."""
    dtype, channels, order = IMAGE_ENCODINGS[encoding]
    kind = np.dtype(f"{'>' if big else '<'}{dtype}")
    stored = np.zeros((2, 3, channels), kind)
    for colour, channel in enumerate(order):
        stored[..., channel] = colour + 1
    if not order:
        stored[..., 0] = 7
    rows = np.zeros((2, 64), np.uint8)
    rows[:, : 3 * channels * kind.itemsize] = stored.reshape(2, -1).view(np.uint8)
    message = SimpleNamespace(height=2, width=3, encoding=encoding, is_bigendian=big, step=64, data=rows.reshape(-1))
    image = plain_image(message, SOURCE)
    assert image.dtype == {"u1": torch.uint8, "u2": torch.uint16, "f4": torch.float32}[dtype]
    expected = [[1, 2, 3]] if order else [[7]]
    assert image.shape == (len(expected[0]), 2, 3)
    assert image[:, 1, 2].tolist() == expected[0]
    message.data = rows.reshape(-1)[:-1]
    with pytest.raises(TorchweatherError, match="64 bytes a row; got 127 bytes"):
        plain_image(message, SOURCE)
    message.encoding = "yuv422"
    with pytest.raises(TorchweatherError, match="got 'yuv422'"):
        plain_image(message, SOURCE)


def field(name: str, offset: int, datatype: int, count: int = 1) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


@pytest.mark.parametrize("big", [False, True])
def test_organised_clouds_with_padding_and_wide_fields(big: bool) -> None:
    order = ">" if big else "<"
    point = np.dtype(
        {
            "names": ["x", "t", "pair"],
            "formats": [f"{order}f4", f"{order}u4", (f"{order}u2", (2,))],
            "offsets": [0, 8, 12],
            "itemsize": 20,
        }
    )
    grid = np.zeros((2, 3), point)
    grid["x"], grid["t"] = np.arange(6).reshape(2, 3), 4_000_000_000
    grid["pair"][..., 1] = 9
    rows = np.zeros((2, 70), np.uint8)
    rows[:, :60] = grid.view(np.uint8).reshape(2, 60)
    fields = [field("x", 0, 7), field("t", 8, 6), field("pair", 12, 4, 2), field("none", 0, 7, 0)]
    message = SimpleNamespace(
        height=2, width=3, fields=fields, is_bigendian=big, point_step=20, row_step=70, data=rows.tobytes()
    )
    stored = cloud_fields(message, SOURCE)
    assert stored.grid == (2, 3)
    x, time, pair = stored.arrays
    assert x is not None
    assert x.tolist() == [0, 1, 2, 3, 4, 5]
    assert time is not None
    assert set(time.tolist()) == {4_000_000_000}
    assert pair is not None
    assert pair.tolist() == [[0, 9]] * 6
    message.data = rows.tobytes()[:-11]
    with pytest.raises(TorchweatherError, match="70 bytes a row and 129 bytes"):
        cloud_fields(message, SOURCE)
    message.fields = [field("x", 18, 7)]
    with pytest.raises(TorchweatherError, match=r"field 'x': .*at byte 18"):
        cloud_fields(message, SOURCE)
