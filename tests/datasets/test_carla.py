"""CARLA's buffers, written by hand in the layout of its sensor reference, and the rig that gathers them."""

from __future__ import annotations

import logging
import math
import struct
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchweather.atmosphere.weather import Fog, Rain
from torchweather.datasets.carla import (
    camera_from_carla,
    depth_from_carla,
    depth_to_carla,
    detections_from_carla,
    detections_to_carla,
    image_from_carla,
    image_to_carla,
    points_from_carla,
    points_to_carla,
    pose_from_carla,
)
from torchweather.datasets.carla_rig import CarlaRig
from torchweather.io import read_depth, write_image
from torchweather.physics.radar_equation import received_power_dbm
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import AsBayer, BayerFog, LidarFog, RadarAttenuation

WIDTH, HEIGHT = 4, 2


def image(pixels_bgra: list[tuple[int, int, int, int]], width: int = WIDTH, **more: Any) -> SimpleNamespace:
    """carla.Image: 32-bit BGRA pixels, rows from the top."""
    raw = b"".join(struct.pack("4B", *pixel) for pixel in pixels_bgra)
    return SimpleNamespace(raw_data=raw, width=width, height=len(pixels_bgra) // width, fov=90.0, **more)


def floats(*rows: tuple[float, float, float, float], **more: Any) -> SimpleNamespace:
    """carla.LidarMeasurement or carla.RadarMeasurement: rows of four little-endian 32-bit floats."""
    return SimpleNamespace(raw_data=b"".join(struct.pack("<4f", *row) for row in rows), **more)


def test_a_frame_is_read_row_by_row_in_red_green_blue() -> None:
    pixels = [(10 * k, 10 * k + 1, 10 * k + 2, 255) for k in range(8)]
    rgb = image_from_carla(image(pixels))
    assert rgb.dtype == torch.uint8
    assert rgb[:, 0, 1].tolist() == [12, 11, 10]
    assert rgb[:, 1, 0].tolist() == [42, 41, 40]
    assert image_to_carla(rgb).tobytes() == image(pixels).raw_data


def test_the_buffer_may_be_taken_back_after_the_call() -> None:
    buffers = bytearray(image([(1, 2, 3, 255)] * 8).raw_data), bytearray(floats((1, 2, 3, 4)).raw_data)
    rgb = image_from_carla(SimpleNamespace(raw_data=memoryview(buffers[0]), width=4, height=2))
    points = points_from_carla(SimpleNamespace(raw_data=memoryview(buffers[1])))
    for buffer in buffers:
        buffer[:] = bytes(len(buffer))
    assert rgb[:, 0, 0].tolist() == [3, 2, 1]
    assert points.tolist() == [[1, -2, 3, 4]]
    points[0, 0] = 7.0  # and may be written to


def test_depth_counts_red_first() -> None:
    # From less to more significant: R, G, B; here in the order blue, green, red, alpha.
    coded = image([(0, 0, 1, 255), (0, 1, 0, 255), (1, 0, 0, 255), (255, 255, 255, 255)], width=4)
    step = 1000 / (256**3 - 1)
    found = depth_from_carla(coded)
    assert found.shape == (1, 1, 4)
    assert found[0, 0, :3].tolist() == pytest.approx([step, 256 * step, 65536 * step], rel=1e-7)
    assert found[0, 0, 3] == math.inf  # the far plane: sky


@given(st.lists(st.floats(0, 999.9), min_size=1, max_size=6))
@settings(max_examples=25, deadline=None)
def test_depth_goes_and_comes_back_to_the_step_of_the_code(metres: list[float]) -> None:
    depth = torch.tensor([*metres, math.inf]).reshape(1, 1, -1)
    coded = depth_to_carla(depth)
    back = depth_from_carla(SimpleNamespace(raw_data=coded.tobytes(), width=depth.shape[2], height=1))
    # Half a step of 60 um, and float32 of a kilometre: another 60 um.
    torch.testing.assert_close(back, depth, rtol=0, atol=1e-4)


def test_a_depth_frame_agrees_with_the_file_that_carla_saves(tmp_path: Any) -> None:
    coded = depth_to_carla(torch.tensor([[[3.0, 80.0], [500.0, math.inf]]]))
    sensor = SimpleNamespace(raw_data=coded.tobytes(), width=2, height=2)
    write_image(tmp_path / "depth.png", image_from_carla(sensor))
    assert torch.equal(read_depth(tmp_path / "depth.png", "carla"), depth_from_carla(sensor))


def test_the_camera_has_the_field_of_view_across() -> None:
    camera = camera_from_carla(SimpleNamespace(width=800, height=600, fov=100.0), exposure_s=0.01)
    # The border of the image, half a pixel outside the last centre, lies at half the field of view.
    assert math.degrees(math.atan((799.5 - camera.intrinsics[2]) / camera.fx)) == pytest.approx(50.0)
    assert camera.fx == camera.fy
    assert camera.exposure_s == 0.01


def test_points_right_of_the_sensor_come_out_right_of_it() -> None:
    right_front = floats((10.0, 5.0, -1.5, 0.9), (0.0, 0.0, 2.0, 0.5))
    points = points_from_carla(right_front)
    assert points.dtype == torch.float32
    assert points[0].tolist() == pytest.approx([10, -5, -1.5, 0.9])
    assert math.atan2(points[0, 1], points[0, 0]) < 0  # azimuth runs to the left
    assert not torch.signbit(points[1, 1])
    assert points_to_carla(points).tobytes() == right_front.raw_data
    assert points_from_carla(right_front, reflectivity=0.2)[:, 3].tolist() == pytest.approx([0.2, 0.2])
    assert points_from_carla(SimpleNamespace(raw_data=b"")).shape == (0, 4)


SEMANTIC = np.dtype([(name, "<f4") for name in "xyzc"] + [("index", "<u4"), ("tag", "<u4")])


@pytest.mark.parametrize("rows", [1, 2, 5, 6])
@pytest.mark.parametrize("index", [0, 7])
def test_a_semantic_lidar_has_24_bytes_a_point(rows: int, index: int) -> None:
    table = np.zeros(rows, SEMANTIC)
    table["x"], table["y"], table["c"] = 10 + np.arange(rows), 1.0, 0.9
    table["index"], table["tag"] = index, 2 * index
    measured = SimpleNamespace(raw_data=table.tobytes())
    found = points_from_carla(measured)
    wanted = [[10.0 + row, -1.0, 0.0, np.float32(0.9), index, 2 * index] for row in range(rows)]
    assert found.tolist() == wanted
    assert points_to_carla(found, semantic=True).tobytes() == table.tobytes()
    assert points_from_carla(measured, reflectivity=0.5)[:, 3].tolist() == pytest.approx([0.45] * rows)


def test_particles_do_not_keep_the_semantic_tag_of_what_they_hide() -> None:
    points = torch.tensor([[10.0, 0, 0, 1, 7, 14], [3.0, 0, 0, 1, 8, 14], [0.0, 0, 0, 0, 9, 14]])
    found = points_to_carla(points, semantic=True, kind=torch.tensor([0, 1, 2]))
    assert found["object_idx"].tolist() == [7, 0]
    assert found["object_tag"].tolist() == [14, 0]


def test_a_measurement_that_is_semantic_by_its_class_is_read_so_whatever_its_numbers() -> None:
    class SemanticLidarMeasurement(SimpleNamespace):
        pass

    table = np.zeros(2, SEMANTIC)
    table["x"], table["index"], table["tag"] = 5.0, 9_000_000, 300
    assert points_from_carla(SemanticLidarMeasurement(raw_data=table.tobytes())).shape == (2, 6)
    with pytest.raises(ValueError, match="rows of 24 bytes"):
        points_from_carla(SemanticLidarMeasurement(raw_data=bytes(32)))
    table["index"] = 1 << 25
    with pytest.raises(ValueError, match="16777216 or less"):
        points_from_carla(SemanticLidarMeasurement(raw_data=table.tobytes()))


def test_lost_points_are_not_in_carlas_cloud() -> None:
    points = torch.tensor([[1.0, 2, 3, 4, 9], [0, 0, 0, 5, 9], [math.nan, math.nan, math.nan, 1, 9]])
    assert points_to_carla(points).tolist() == [[1, -2, 3, 4]]


def test_a_detection_to_the_right_and_above_recedes() -> None:
    radar = Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0, loss_db=2.0)
    azimuth, altitude, range_m = math.radians(30), math.radians(10), 40.0
    (found,) = detections_from_carla(floats((7.5, azimuth, altitude, range_m)), radar, rcs_dbsm=5.0).tolist()
    across = range_m * math.cos(altitude)
    assert found[:4] == pytest.approx([across * 0.75**0.5, -across * 0.5, range_m * math.sin(altitude), 7.5], rel=1e-6)
    power = received_power_dbm(5.0, range_m, transmit_power_dbm=12.0, antenna_gain_dbi=26.0, loss_db=2.0)
    assert found[4:] == pytest.approx([float(power), 5.0], rel=1e-6)


@given(
    st.lists(st.tuples(st.floats(-60, 60), st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(0.5, 200)), max_size=5)
)
@settings(max_examples=50, deadline=None)
def test_detections_go_and_come_back(rows: list[tuple[float, float, float, float]]) -> None:
    measured = floats(*rows)
    back = detections_to_carla(detections_from_carla(measured, Radar()))
    # Float32 in x, y, z, and the angles out of them.
    np.testing.assert_allclose(back, np.frombuffer(measured.raw_data, "<f4").reshape(-1, 4), rtol=2e-6, atol=2e-6)


def test_no_detection_stays_none_and_a_lost_one_is_left_out() -> None:
    found = detections_from_carla(floats((1.0, 0.1, 0.1, 0.0), (0.0, 0.0, 0.0, 10.0)), Radar())
    assert found[0].tolist() == [0.0] * 6
    assert detections_to_carla(found).tolist() == [[0, 0, 0, 10]]


def test_a_pose_turns_the_same_things_the_same_way() -> None:
    """Unreal's yaw turns x to y, to the right; the point ahead of a sensor turned right lies right of the car."""
    yaw = math.radians(30)
    cos, sin = math.cos(yaw), math.sin(yaw)
    matrix = [[cos, -sin, 0, 1.5], [sin, cos, 0, 0.4], [0, 0, 1, 2.0], [0, 0, 0, 1]]
    pose = pose_from_carla(SimpleNamespace(get_matrix=lambda: matrix))
    in_sensor = np.array([10.0, 3.0, 1.0, 1.0])
    in_car = np.array(matrix) @ in_sensor
    ours = pose @ torch.tensor([10.0, -3.0, 1.0, 1.0], dtype=torch.float64)
    assert ours.tolist() == pytest.approx([in_car[0], -in_car[1], in_car[2], 1.0])
    ahead = pose @ torch.tensor([10.0, 0, 0, 1], dtype=torch.float64)
    assert ahead[1] < -0.4  # to the right
    assert torch.linalg.det(pose[:3, :3]).item() == pytest.approx(1.0)
    torch.testing.assert_close(pose_from_carla(pose), torch.tensor(matrix, dtype=torch.float64))


def test_buffers_of_another_layout_are_refused() -> None:
    with pytest.raises(ValueError, match=r"4 x 3 pixels of 4 bytes.*48 bytes; got 32"):
        image_from_carla(SimpleNamespace(raw_data=bytes(32), width=4, height=3))
    with pytest.raises(ValueError, match="multiple of 16 bytes; got 24 bytes"):
        points_from_carla(SimpleNamespace(raw_data=bytes(24)))
    with pytest.raises(ValueError, match="finite"):
        detections_from_carla(floats((math.nan, 0, 0, 1)), Radar())
    with pytest.raises(ValueError, match="1, H, W"):
        depth_to_carla(torch.zeros(2, 2))
    with pytest.raises(ValueError, match="NaN or negative"):
        depth_to_carla(torch.tensor([[[-1.0]]]))
    with pytest.raises(ValueError, match="3, H, W"):
        image_to_carla(torch.zeros(3, 2, 2))
    with pytest.raises(ValueError, match=r"\(N, 6 or more\)"):
        detections_to_carla(torch.zeros(3, 4))
    with pytest.raises(ValueError, match=r"\(4, 4\)"):
        pose_from_carla(torch.eye(3))


# ---- the rig -------------------------------------------------------------------------------------------------------


def measured(frame: int) -> dict[str, SimpleNamespace]:
    stamp = {"frame": frame, "timestamp": 0.05 * frame}
    return {
        "image": image([(40, 50, 60, 255)] * 16, width=4, **stamp),
        "depth": image([(3, 0, 0, 255)] * 16, width=4, **stamp),
        "points": floats((20.0, 5.0, 0.0, 0.9), (80.0, -5.0, 0.0, 0.7), **stamp),
        "radar": floats((-3.0, 0.1, 0.0, 50.0), **stamp),
    }


SENSORS = {"image": "camera", "depth": "depth", "points": "lidar", "radar": "radar"}


def rig_of(transform: Any = dict, **more: Any) -> tuple[CarlaRig, list[dict[str, Any]]]:
    found: list[dict[str, Any]] = []
    return CarlaRig(transform, SENSORS, found.append, radar=Radar(), **more), found


def test_a_frame_goes_through_the_weather_when_its_last_sensor_has_sent() -> None:
    camera = Camera.from_field_of_view(math.pi / 2, math.pi / 2, 4, 4)
    fog = AsBayer(BayerFog(Fog(mor_m=50), camera, airlight=0.7))
    lidar = LidarFog(Fog(mor_m=50), Lidar(wavelength_nm=905, intensity_unit="none"))
    radar = RadarAttenuation(Rain(rate_mm_per_h=50), Radar())
    lines: list[str] = []

    def weather(sample: dict[str, Any]) -> dict[str, Any]:
        return {
            **sample,
            "image": fog(sample["image"], sample["depth"]),
            "points": lidar(sample["points"], lidar.draw(sample["points"], seed=sample["frame"])),
            "radar": radar(sample["radar"], radar.draw(sample["radar"], seed=sample["frame"])),
        }

    rig, found = rig_of(weather, report=lines.append)
    for key, measurement in measured(12).items():
        assert not found
        rig.listener(key)(measurement)
    (sample,) = found
    assert list(sample) == ["image", "depth", "points", "radar", "frame", "timestamp_s"]
    assert (sample["frame"], sample["timestamp_s"]) == (12, pytest.approx(0.6))
    assert (sample["image"] > image_from_carla(measured(12)["image"])).all()  # the airlight is brighter
    assert sample["points"].shape == (2, 4)
    clear = detections_from_carla(measured(12)["radar"], Radar())
    assert sample["radar"][0, 4] < clear[0, 4]
    assert len(rig.times_s) == 1 == len(lines)
    assert lines[0].startswith("frame 12: ")
    assert "ms" in lines[0]


def test_frames_come_out_in_order_and_incomplete_ones_are_given_up() -> None:
    rig, found = rig_of(waiting_frames=3)
    for frame in (1, 2, 3):
        for key, measurement in measured(frame).items():
            if not (frame == 2 and key == "depth"):
                rig.listener(key)(measurement)
    rig.listener("depth")(measured(2)["depth"])  # too late
    assert [sample["frame"] for sample in found] == [1, 3]
    assert rig.given_up == 1
    for frame in range(4, 9):  # the depth camera died: no more than three wait
        rig.listener("image")(measured(frame)["image"])
    assert rig.given_up == 3
    for key, measurement in measured(1).items():  # another episode, which counts anew: far behind 3
        rig.listener(key)(measurement)
    assert [sample["frame"] for sample in found] == [1, 3]  # 1 > 3 - 3 is a straggler still
    for frame in (50, 2):
        for key, measurement in measured(frame).items():
            rig.listener(key)(measurement)
    assert [sample["frame"] for sample in found] == [1, 3, 50, 2]


def test_sensors_in_threads_of_their_own_do_not_wait_for_the_weather() -> None:
    working, go_on = threading.Event(), threading.Event()
    active = []

    def slow(sample: dict[str, Any]) -> dict[str, Any]:
        active.append(sample["frame"])
        assert len(active) == 1
        working.set()
        assert go_on.wait(10)
        active.remove(sample["frame"])
        return sample

    rig, found = rig_of(slow, waiting_frames=2)
    first = threading.Thread(target=lambda: [rig.listener(key)(value) for key, value in measured(1).items()])
    first.start()
    assert working.wait(10)
    for frame in (2, 3, 4):  # all sent while frame 1 is at work; two may wait
        for key, value in measured(frame).items():
            rig.listener(key)(value)
    assert not found
    go_on.set()
    first.join(10)
    assert [sample["frame"] for sample in found] == [1, 3, 4]
    assert rig.given_up == 1


def test_an_error_in_the_weather_does_not_stop_the_rig() -> None:
    def sometimes(sample: dict[str, Any]) -> dict[str, Any]:
        if sample["frame"] == 1:
            raise RuntimeError("no fog today")
        return sample

    rig, found = rig_of(sometimes)
    for key in ("image", "depth", "points"):
        rig.listener(key)(measured(1)[key])
    with pytest.raises(RuntimeError, match="no fog today"):
        rig.listener("radar")(measured(1)["radar"])
    for key, value in measured(2).items():
        rig.listener(key)(value)
    assert [sample["frame"] for sample in found] == [2]


def test_the_time_of_a_frame_is_logged_where_nobody_asks_for_it(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="torchweather.datasets.carla_rig"):
        rig = CarlaRig(dict, {"points": "lidar"}, reflectivity=0.3)
        rig.listener("points")(measured(5)["points"])
    assert caplog.messages[0].startswith("frame 5: ")


def test_a_rig_that_cannot_work_is_refused() -> None:
    with pytest.raises(ValueError, match="link budget"):
        CarlaRig(dict, {"radar": "radar"})
    with pytest.raises(ValueError, match="Did you mean 'lidar'"):
        CarlaRig(dict, {"points": "lidars"})
    with pytest.raises(ValueError, match="at least one"):
        CarlaRig(dict, {})
    with pytest.raises(ValueError, match="Did you mean 'points'"):
        CarlaRig(dict, {"points": "lidar"}).listener("point")
