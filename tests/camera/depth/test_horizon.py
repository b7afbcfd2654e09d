"""Horizon and vanishing point: recovered from ray-cast streets, and the camera's own where the picture has no edges."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.camera.depth.street_corridor import corridor, leaves
from torchweather.camera.depth.horizon import find_horizon, horizon_of_camera
from torchweather.camera.depth.line_segments import find_segments
from torchweather.sensors import Camera

CAMERA = Camera.from_intrinsics(fx=480.0, fy=480.0, cx=319.5, cy=119.5, width=640, height=240, height_m=1.6)
LENS = {"k1": -0.25, "k2": 0.02, "k3": -0.05}

# Pitch, heading and roll of the true camera, degrees; distortion.
STREETS = [
    (0.0, 0.0, 0.0, {}),
    (1.0, 4.0, 0.0, {}),
    (-1.2, -6.0, 0.0, {}),
    (0.8, 3.0, 3.0, {}),
    (-0.9, 5.0, 0.0, LENS),
    (0.7, -4.0, -2.0, LENS),
    (0.5, 12.0, 6.0, {}),
    (0.5, 22.0, 0.0, LENS),
]


@pytest.mark.parametrize(("pitch", "heading", "roll", "lens"), STREETS)
def test_the_horizon_of_a_street_is_found_within_a_pixel(
    pitch: float, heading: float, roll: float, lens: dict[str, float]
) -> None:
    assumed = replace(CAMERA, roll_rad=math.radians(roll), **lens)
    true = replace(assumed, pitch_rad=math.radians(pitch))
    picture, _, _ = corridor(true, heading_rad=math.radians(heading))
    expected = horizon_of_camera(true, heading_rad=math.radians(heading))
    found = find_horizon(picture, assumed)
    assert abs(found.row - expected.row) < 1.0
    assert abs(found.column - expected.column) < 2.5
    assert found.confidence > 0.3
    assert math.degrees(found.pitch_rad) == pytest.approx(pitch, abs=0.12)


def test_the_horizon_of_a_camera_lies_where_level_ground_ends() -> None:
    camera = replace(CAMERA, pitch_rad=0.03, roll_rad=0.05, **LENS)
    horizon = horizon_of_camera(camera)
    down = torch.tensor(camera.down_direction())
    ray = camera.ray_directions()
    fall = torch.einsum("c,chw->hw", down, ray)[:, round(camera.principal_point_px[0])]
    assert abs(float(fall.abs().argmin()) - horizon.row) <= 1.0
    assert horizon.confidence == 0.0


def test_a_heading_to_the_right_moves_the_vanishing_point_to_the_right() -> None:
    column = CAMERA.principal_point_px[0] + CAMERA.fx * math.tan(0.1)
    assert horizon_of_camera(CAMERA, heading_rad=0.1).column == pytest.approx(column)


@pytest.mark.parametrize("texture", ["plain", "leaves"])
def test_without_edges_along_a_street_the_cameras_own_pitch_stands(texture: str) -> None:
    camera = replace(CAMERA, pitch_rad=0.02)
    picture = torch.full((3, 240, 640), 0.4) if texture == "plain" else leaves(240, 640)
    found = find_horizon(picture, camera)
    assert found.row == pytest.approx(119.5 + 480.0 * math.tan(0.02), abs=3.0)
    assert found.confidence < 0.2
    assert texture == "leaves" or found == horizon_of_camera(camera)


def test_level_edges_below_the_horizon_do_not_draw_it_down() -> None:
    # Bumpers, steps and shadows across the street lie about level, and many of them near one row.
    picture = torch.full((3, 240, 640), 0.5)
    for number in range(12):
        row, column = 136 + 3 * (number % 3), 8 + 52 * number
        picture[:, row : row + 4, column : column + 30] = 0.1
    assert abs(find_horizon(picture, CAMERA).row - 119.5) < 3.0


def test_the_answer_is_the_same_every_time_and_for_bytes() -> None:
    picture, _, _ = corridor(replace(CAMERA, pitch_rad=0.01), heading_rad=0.05)
    first = find_horizon(picture, CAMERA)
    assert find_horizon(picture.clone(), CAMERA) == first
    in_bytes = find_horizon((255 * picture).round().to(torch.uint8), CAMERA)
    assert in_bytes.row == pytest.approx(first.row, abs=0.5)


def test_a_wide_picture_is_averaged_down_and_keeps_its_rows() -> None:
    camera = replace(CAMERA.resized(1920, 720), pitch_rad=0.012)
    picture, _, _ = corridor(camera)
    found = find_horizon(picture, replace(camera, pitch_rad=0.0))
    assert abs(found.row - horizon_of_camera(camera).row) < 3.0


def test_a_batch_is_refused() -> None:
    with pytest.raises(ValueError, match="find_horizon: expected one picture"):
        find_horizon(torch.zeros(2, 3, 24, 32), CAMERA)


@pytest.mark.parametrize("angle_deg", [0.0, 12.0, 38.0, 60.0, 90.0, 131.0])
def test_a_straight_edge_is_one_segment_of_its_direction(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    y, x = np.mgrid[0:120, 0:120].astype(np.float64) - 59.5
    across = -math.sin(angle) * x + math.cos(angle) * y
    inside = np.clip(46.0 - np.hypot(x, y), 0.0, 1.0)  # a disk cut in two: its rim is no straight edge
    picture = (0.5 + 0.3 * np.clip(across, -0.5, 0.5) * inside).astype(np.float32)
    segments = find_segments(picture)
    longest = int(segments.length_px.argmax())
    direction = segments.direction_xy[longest]
    assert abs(direction @ [-math.sin(angle), math.cos(angle)]) < math.sin(math.radians(0.5))
    assert segments.length_px[longest] == pytest.approx(92.0, abs=6.0)
    assert np.abs(segments.centre_xy[longest] - 59.5).max() < 1.5


def test_a_plain_picture_has_no_segments() -> None:
    assert len(find_segments(np.full((50, 60), 0.3, np.float32)).length_px) == 0
