"""Boxes: KITTI's camera frame, nuScenes' global frame, points inside, and what weather leaves of them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchweather.core.errors import TorchweatherError
from torchweather.datasets.box_visibility import box_visibility
from torchweather.datasets.boxes import Boxes, points_in_boxes
from torchweather.datasets.kitti import read_kitti_calibration, read_kitti_rectified_from_lidar
from torchweather.datasets.kitti_boxes import read_kitti_boxes, write_kitti_boxes
from torchweather.datasets.nuscenes_boxes import (
    boxes_from_nuscenes,
    boxes_to_nuscenes,
    read_nuscenes_boxes,
    write_nuscenes_boxes,
)

# Ideal mounting: camera x = -y, y = -z, z = x of the LiDAR, 0.27 m in front of it and 0.08 m below.
IDEAL = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]], dtype=torch.float64)
# Form of KITTI's labels, numbers made up; the third is a result with a score.
LABEL = """Car 0.88 3 -0.69 0.00 192.37 402.31 374.00 1.60 1.57 3.23 -2.70 1.74 3.68 -1.29
Pedestrian 0.00 0 -0.20 712.40 143.00 810.73 307.92 1.89 0.48 1.20 1.84 1.47 8.41 0.01
Cyclist 0.00 1 1.57 100.00 100.00 200.00 200.00 1.70 0.60 1.80 10.00 1.60 40.00 3.14 0.93
DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10
"""


def label(tmp_path: Path, text: str = LABEL) -> Path:
    (tmp_path / "label.txt").write_text(text)
    return tmp_path / "label.txt"


def test_kitti_boxes_stand_on_their_bottom_and_head_where_they_look(tmp_path: Path) -> None:
    """A car 10 m ahead, rotation_y = -pi / 2: it looks away from the camera, so along the LiDAR's x."""
    line = "Car 0 0 0 0 0 0 0 1.50 1.60 4.00 -2.00 1.65 10.00 {}\n"
    for rotation, yaw in ((-math.pi / 2, 0.0), (0.0, -math.pi / 2), (math.pi / 2, math.pi)):
        boxes = read_kitti_boxes(label(tmp_path, line.format(rotation)), IDEAL)
        # By hand: x = 10 + 0.27; y = 2; z = -(1.65 - 0.75) - 0.08.
        torch.testing.assert_close(boxes.centre_m, torch.tensor([[10.27, 2.0, -0.98]], dtype=torch.float64))
        assert boxes.size_m.tolist() == [[4.0, 1.6, 1.5]]
        assert math.cos(boxes.yaw_rad.item() - yaw) == pytest.approx(1.0, abs=1e-12)


def test_kitti_labels_are_written_back_byte_for_byte_with_the_real_mounting(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text("721.5 0 609.6 44.9 0 721.5 172.9 0.2 0 0 1 0.003")
    mounting = read_kitti_rectified_from_lidar(tmp_path / "calib.txt")
    boxes = read_kitti_boxes(label(tmp_path), mounting)
    assert boxes.names == ("Car", "Pedestrian", "Cyclist")
    assert boxes.records[2]["score"] == 0.93
    assert len(boxes.unplaced) == 1
    write_kitti_boxes(tmp_path / "again.txt", boxes, mounting)
    assert (tmp_path / "again.txt").read_text() == LABEL
    # Labels are placed in the frame of camera 0; camera 2 stands 6 cm beside.
    camera_2 = read_kitti_calibration(tmp_path / "calib.txt").T_camera_from_lidar
    assert (camera_2 - mounting)[0, 3].item() == pytest.approx(0.06, abs=0.005)


@given(
    st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3)),
    st.floats(-math.pi, math.pi),
    st.floats(-0.2, 0.2),
    st.floats(-math.pi, math.pi),
)
@settings(max_examples=60, deadline=None)
def test_any_box_goes_to_nuscenes_and_back(
    centre: tuple[float, float, float], yaw: float, tilt: float, turn: float
) -> None:
    """Also between frames tilted against each other."""
    cos, sin = math.cos(turn), math.sin(turn)
    about_z = torch.tensor([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]], dtype=torch.float64)
    cos, sin = math.cos(tilt), math.sin(tilt)
    about_x = torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]], dtype=torch.float64)
    transform = torch.eye(4, dtype=torch.float64)
    transform[:3, :3], transform[:3, 3] = about_z @ about_x, torch.tensor([600.0, 1600.0, 1.0])
    boxes = Boxes(
        torch.tensor([centre], dtype=torch.float64),
        torch.tensor([[4.0, 2, 1.5]], dtype=torch.float64),
        torch.tensor([yaw], dtype=torch.float64),
        ("car",),
    )
    back = boxes_from_nuscenes(boxes_to_nuscenes(boxes, transform), transform)
    # Float64 with coordinates of a kilometre: 1e-12 of them.
    torch.testing.assert_close(back.centre_m, boxes.centre_m, rtol=0, atol=1e-9)
    torch.testing.assert_close(back.size_m, boxes.size_m)
    assert math.cos(back.yaw_rad.item() - yaw) == pytest.approx(1.0, abs=1e-12)


def test_nuscenes_annotations_in_the_global_frame() -> None:
    """The car stands 10 m north of the sensor, looks north; the sensor looks north too: yaw 0, straight ahead."""
    half = math.pi / 4
    note = {
        "translation": [100.0, 210.0, 1.0],
        "size": [2.0, 4.0, 1.5],
        "rotation": [math.cos(half), 0.0, 0.0, math.sin(half)],
        "category_name": "vehicle.car",
        "num_lidar_pts": 9,
        "token": "abc",
    }
    # Sensor at (100, 200, 2): its x is north (global y), its y is west.
    transform = torch.tensor([[0.0, 1, 0, -200], [-1, 0, 0, 100], [0, 0, 1, -2], [0, 0, 0, 1]], dtype=torch.float64)
    boxes = boxes_from_nuscenes([note], transform)
    torch.testing.assert_close(boxes.centre_m, torch.tensor([[10.0, 0, -1]], dtype=torch.float64))
    assert boxes.size_m.tolist() == [[4, 2, 1.5]]
    assert boxes.yaw_rad.item() == pytest.approx(0.0, abs=1e-12)
    points = torch.tensor([[11.9, 0.9, -0.5, 1], [11.9, 1.1, -0.5, 1], [8.1, -0.9, -0.5, 1]])
    left = box_visibility(boxes, points, points, torch.tensor([0, 0, 1]), torch.tensor([0.5, 0.1, 0.25]))
    (written,) = boxes_to_nuscenes(boxes, transform, left)
    assert written["num_lidar_pts"] == 1
    assert written["token"] == "abc"
    assert written["category_name"] == "vehicle.car"
    assert written["translation"] == pytest.approx(note["translation"])
    assert written["rotation"] == pytest.approx(note["rotation"])


def test_nuscenes_json_as_a_list_and_as_results(tmp_path: Path) -> None:
    note = {"translation": [1, 2, 3], "size": [1, 2, 3], "rotation": [1, 0, 0, 0], "detection_name": "car"}
    notes = [{**note, "sample_token": "a"}, {**note, "sample_token": "b", "detection_name": "bus"}]
    path = tmp_path / "boxes.json"
    path.write_text(json.dumps(notes))
    assert read_nuscenes_boxes(path).names == ("car", "bus")
    assert read_nuscenes_boxes(path, sample_token="b").names == ("bus",)
    write_nuscenes_boxes(tmp_path / "again.json", read_nuscenes_boxes(path))
    assert json.loads((tmp_path / "again.json").read_text()) == notes
    path.write_text(json.dumps({"meta": {}, "results": {"a": notes[:1], "b": notes[1:]}}))
    assert read_nuscenes_boxes(path, sample_token="b").names == ("bus",)
    with pytest.raises(TorchweatherError, match="expected sample_token, one of 2 samples"):
        read_nuscenes_boxes(path)
    path.write_text("[]")
    assert len(read_nuscenes_boxes(path)) == 0
    for text, message in (("{", "expected json"), ("3", "a list of"), ('[{"size": [1]}]', "annotation 0: .*KeyError")):
        path.write_text(text)
        with pytest.raises(TorchweatherError, match=rf"boxes\.json: .*{message}"):
            read_nuscenes_boxes(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": [0, 1, 1]}, "sizes above 0 m"),
        ({"translation": [math.nan, 0, 0]}, "finite"),
        ({"rotation": [0, 0, 0, 0]}, "quaternion that is not 0"),
        ({"rotation": [1, 0, 0]}, r"\[3, 3, 3\] numbers"),
        ({"size": "big"}, "ValueError"),
    ],
)
def test_broken_annotations_are_named(change: dict[str, object], message: str) -> None:
    note: dict[str, object] = {"translation": [1, 2, 3], "size": [1, 2, 3], "rotation": [1, 0, 0, 0]}
    with pytest.raises(TorchweatherError, match=f"annotation 1: .*{message}"):
        boxes_from_nuscenes([note, {**note, **change}])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Car 1 2 3\n", "line 1: .*got 3 numbers"),
        (LABEL.replace("8.41", "far"), "line 2: .*far"),
        (LABEL.replace("8.41", "nan"), "finite"),
        (LABEL.replace(" 0 ", " nan ", 1), "line 2"),
    ],
)
def test_broken_kitti_labels_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(TorchweatherError, match=rf"label\.txt: .*{message}"):
        read_kitti_boxes(label(tmp_path, text), IDEAL)


def test_an_empty_kitti_label_has_no_boxes(tmp_path: Path) -> None:
    boxes = read_kitti_boxes(label(tmp_path, ""), IDEAL)
    assert len(boxes) == 0
    assert points_in_boxes(torch.rand(5, 4), boxes).shape == (5, 0)
    left = box_visibility(boxes, torch.rand(5, 4), torch.rand(5, 4), torch.zeros(5), torch.ones(5))
    assert left.points_left.shape == (0,)
    write_kitti_boxes(tmp_path / "again.txt", boxes, IDEAL)
    assert (tmp_path / "again.txt").read_text() == ""


@given(st.floats(-math.pi, math.pi), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_points_on_either_side_of_a_face(yaw: float, seed: int) -> None:
    """Points of the unit cube, scaled a little inside and outside of a turned box, in float32."""
    generator = torch.Generator().manual_seed(seed)
    size, centre = torch.tensor([4.0, 1.8, 1.5]), torch.tensor([20.0, -7.0, 0.5])
    unit = torch.rand(200, 3, generator=generator) - 0.5
    unit /= unit.abs().amax(dim=1, keepdim=True) * 2  # on the surface of the cube
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = torch.tensor([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    boxes = Boxes(centre[None], size[None], torch.tensor([yaw]), ("car",))
    # Float32 at 20 m: 2e-6 m, of half a size of 0.75 m 3e-6.
    for scale, inside in ((0.9999, True), (1.0001, False)):
        points = (scale * unit * size) @ turn.T + centre
        assert bool((points_in_boxes(points, boxes) == inside).all())


def test_visibility_counts_what_is_left_of_each_box() -> None:
    boxes = Boxes(
        torch.tensor([[10.0, 0, 0], [20.0, 0, 0], [0.0, 0, 0]]),
        torch.full((3, 3), 4.0),
        torch.zeros(3),
        ("a", "b", "c"),
    )
    before = torch.tensor([[9.0, 0, 0, 1], [10, 0, 0, 1], [11, 0, 0, 1], [20, 0, 0, 1], [0, 0, 0, 0]])
    after = before.clone()
    after[1, :3] = 0  # lost
    after[3, 0] = 10.5  # a flake that shows up within the nearer box
    kind = torch.tensor([0, 2, 0, 1, 2], dtype=torch.int8)
    transmission = torch.tensor([0.9, 0.6, 0.3, 0.2, 0.1])
    left = box_visibility(boxes, before, after, kind, transmission)
    assert left.points_before.tolist() == [3, 1, 0]  # a beam without a return lies in no box
    assert left.points_left.tolist() == [2, 0, 0]
    assert left.transmission[:2].tolist() == pytest.approx([0.6, 0.2])
    assert math.isnan(left.transmission[2])
    # NaN for lost beams, and rows dropped and appended, say the same of the points.
    after[1, :3] = torch.nan
    assert box_visibility(boxes, before, after, kind, transmission).points_left.tolist() == [2, 0, 0]
    source = torch.tensor([3, 2, 0, -1])
    more = torch.cat((after[[3, 2, 0]], torch.tensor([[10.0, 1, 0, 1]])))
    dropped = box_visibility(
        boxes, before, more, torch.tensor([1, 0, 0, 0]), torch.tensor([0.2, 0.3, 0.9, 0.5]), source
    )
    assert dropped.points_before.tolist() == [3, 1, 0]
    assert dropped.points_left.tolist() == [2, 0, 0]
    assert dropped.transmission[:2].tolist() == pytest.approx([0.6, 0.2])


def test_many_boxes_and_points_equal_a_count_one_by_one() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(200_000, 4, generator=generator) * 40 - 20
    boxes = Boxes(
        torch.rand(60, 3, generator=generator) * 40 - 20,
        torch.rand(60, 3, generator=generator) * 5 + 2,
        torch.rand(60, generator=generator) * 6,
        ("x",) * 60,
    )
    share = torch.rand(200_000, generator=generator)
    left = box_visibility(boxes, points, points, torch.zeros(200_000), share)
    for k in (0, 31, 59):
        one = points_in_boxes(points, boxes.select(torch.arange(60) == k))[:, 0]
        assert left.points_before[k] == left.points_left[k] == one.sum()
        assert left.transmission[k].item() == pytest.approx(share[one].double().mean().item(), rel=1e-4)


def test_what_does_not_fit_together_is_refused() -> None:
    boxes = Boxes(torch.zeros(1, 3), torch.ones(1, 3), torch.zeros(1), ("car",))
    points, kind = torch.rand(5, 4), torch.zeros(5)
    with pytest.raises(ValueError, match="one value for each of the 5"):
        box_visibility(boxes, points, points, kind[:4], kind)
    with pytest.raises(ValueError, match="source must give the row"):
        box_visibility(boxes, points, points[:4], kind[:4], kind[:4])
    with pytest.raises(ValueError, match=r"-1\.\.4"):
        box_visibility(boxes, points, points, kind, kind, torch.full((5,), 9))
    with pytest.raises(ValueError, match="one cloud at a time"):
        box_visibility(boxes, points[None], points, kind, kind)
    with pytest.raises(ValueError, match="sizes above 0"):
        Boxes(torch.zeros(1, 3), torch.zeros(1, 3), torch.zeros(1), ("car",))
    with pytest.raises(ValueError, match=r"must be \(M, 3\)"):
        Boxes(torch.zeros(2, 3), torch.ones(1, 3), torch.zeros(1), ("car",))
    for transform in (torch.eye(3), 2 * torch.eye(4)):
        with pytest.raises(ValueError, match="rigid transform"):
            boxes_to_nuscenes(boxes, transform)
