"""Recorded KITTI frames in snow and fog: labels, calibrations, boxes and counts agree. Skipped without the recordings.

The folder has no labels of KITTI's own. Label files are written from its 2D boxes: each box gets a car's or a person's
size and stands where the nearest points are that fall into its rectangle.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import torch

from tests.recordings import recording
from torchweather.datasets import (
    points_in_boxes,
    read_kitti_boxes,
    read_kitti_calibration,
    read_kitti_points,
    read_kitti_rectified_from_lidar,
)
from torchweather.datasets.augment import augment
from torchweather.datasets.augment.manifest import NAME, Manifest, Row
from torchweather.io import PointLabels, read_image, read_labels, write_labels

pytestmark = pytest.mark.real_data

FRAMES = ("000008", "001545")
SIZES = {1: ("Pedestrian", 1.75, 0.6, 0.8), 3: ("Car", 1.55, 1.7, 4.0), 8: ("Truck", 3.2, 2.6, 9.0)}
OBJECT, PARTICLE = 40, 110
RECIPE = """
format: torchweather-recipe/2
kind: multi_sensor
title: {kind} on recorded frames
weather: {weather}
transforms:
  image:
    transform: BayerWeather
    sensor: {{kind: camera, width: 1242, height: 375, fx: 721.5, fy: 721.5, height_m: 1.65}}
    options: {{}}
    rgb: true
  points:
    transform: LidarWeather
    sensor: {{kind: lidar, preset: velodyne-hdl-64e, intensity_unit: reflectivity}}
    options: {{complete_scan: true, lost: drop}}
p: 1.0
depth: depth
"""
WEATHERS = {"snow": "{kind: snow, rate_mm_per_h: 2.0}", "fog": "{kind: fog, mor_m: 80.0}"}


def kitti_set(root: Path, frames: tuple[str, ...]) -> Path:
    """KITTI's layout of recorded frames, with labels made from their 2D boxes, and a class for every point."""
    given = recording("kitti_13")
    listed = json.loads((given / "annotations.json").read_text(encoding="utf-8"))
    for folder in ("image_2", "velodyne", "calib", "label_2", "labels"):
        (root / "training" / folder).mkdir(parents=True)
    for name in frames:
        for folder, ending in (("image_2", "png"), ("velodyne", "bin"), ("calib", "txt")):
            shutil.copy(given / folder / f"{name}.{ending}", root / "training" / folder)
        (number,) = (one["id"] for one in listed["images"] if one["file_name"] == f"image_2/{name}.png")
        boxes = [one for one in listed["annotations"] if one["image_id"] == number]
        lines = "".join(_label(given, name, box) for box in boxes)
        (root / f"training/label_2/{name}.txt").write_text(lines, encoding="utf-8")
        classes = torch.full((len(read_kitti_points(given / f"velodyne/{name}.bin")),), OBJECT)
        write_labels(root / f"training/labels/{name}.label", PointLabels(classes, torch.zeros_like(classes)))
    return root


def _label(given: Path, name: str, box: dict) -> str:  # type: ignore[type-arg]
    """One line of a label file."""
    x, y, wide, high = box["bbox"]
    rectangle = f"{x:.2f} {y:.2f} {x + wide:.2f} {y + high:.2f}"
    calibration = read_kitti_calibration(given / f"calib/{name}.txt")
    points = read_kitti_points(given / f"velodyne/{name}.bin").double()
    ahead = points[points[:, 0] > 1.0, :3]
    ones = torch.ones(len(ahead), 1, dtype=torch.float64)
    seen = torch.cat([ahead, ones], 1) @ calibration.T_camera_from_lidar.double().T
    pixel = seen[:, :3] @ calibration.camera_matrix.double().T
    u, v = (pixel[:, :2] / pixel[:, 2:]).unbind(1)
    inside = ahead[(u > x) & (u < x + wide) & (v > y) & (v < y + high)]
    if box["iscrowd"] or len(inside) < 5:
        return f"DontCare -1 -1 -10 {rectangle} -1 -1 -1 -1000 -1000 -1000 -10\n"
    kind, h, w, length = SIZES[box["category_id"]]
    away_m = inside[:, 0].quantile(0.3)
    near = inside[(inside[:, 0] - away_m).abs() < 2.0]
    # On the road, half a length behind the face that the sensor sees.
    middle = torch.tensor([float(away_m) + 0.5 * length, float(near[:, 1].median()), -1.73, 1.0])
    place = read_kitti_rectified_from_lidar(given / f"calib/{name}.txt").double() @ middle.double()
    x_m, y_m, z_m = place[:3].tolist()
    return f"{kind} 0.00 0 -1.57 {rectangle} {h:.2f} {w:.2f} {length:.2f} {x_m:.2f} {y_m:.2f} {z_m:.2f} -1.57\n"


def rows_of(target: Path) -> dict[str, Row]:
    with Manifest(target) as manifest:
        return {row.frame: row for row in manifest.rows()}


def check_frame(source: Path, target: Path, name: str, row: Row) -> dict[str, int]:
    """Compare a frame's results with its inputs and with the manifest; the counts of what was found."""
    clear, weathered = source / "training", target / "training"
    assert row.status == "done", row.error
    for folder in ("calib", "label_2"):
        assert (weathered / folder / f"{name}.txt").read_bytes() == (clear / folder / f"{name}.txt").read_bytes()
    before, after = (read_image(root / f"image_2/{name}.png")[0] for root in (clear, weathered))
    assert after.shape == before.shape
    assert after.dtype == before.dtype
    assert not torch.equal(after, before)
    given, cloud = (read_kitti_points(root / f"velodyne/{name}.bin") for root in (clear, weathered))
    classes = read_labels(weathered / f"labels/{name}.label", len(cloud)).classes
    objects, particles = classes == OBJECT, classes == PARTICLE
    assert bool((objects | particles).all())
    assert bool((cloud[:, :3] != 0).any(1).all())
    (note,) = (one for one in row.notes if one.startswith("points: sweep of "))
    counts = re.fullmatch(
        r"points: sweep of (\d+) rows: (\d+) objects, (\d+) particles, 0 lost; completed from .*", note
    )
    assert counts is not None, note
    assert [int(count) for count in counts.groups()] == [len(cloud), int(objects.sum()), int(particles.sum())]
    # Objects are rows of the input, bit for bit in place, in its order.
    assert len(cloud[objects]) <= len(given)
    known = {place: number for number, place in enumerate(map(tuple, given[:, :3].tolist()))}
    order = [known.get(place, -1) for place in map(tuple, cloud[objects, :3].tolist())]
    assert min(order) >= 0
    assert order == sorted(order)
    boxes = read_kitti_boxes(
        weathered / f"label_2/{name}.txt", read_kitti_rectified_from_lidar(weathered / f"calib/{name}.txt")
    )
    lines = (clear / f"label_2/{name}.txt").read_text(encoding="utf-8").splitlines()
    assert list(boxes.names) == [line.split()[0] for line in lines if not line.startswith("DontCare")]
    assert row.boxes is not None
    assert [box["name"] for box in row.boxes] == list(boxes.names)
    met, seen = points_in_boxes(given, boxes), points_in_boxes(cloud, boxes)
    assert [box["points_before"] for box in row.boxes] == met.sum(0).tolist()
    assert [box["points_left"] for box in row.boxes] == (seen & objects[:, None]).sum(0).tolist()
    assert [box["particles"] for box in row.boxes] == (seen & particles[:, None]).sum(0).tolist()
    return {
        "boxes": len(row.boxes),
        "rows": len(given),
        "objects": int(objects.sum()),
        "particles": int(particles.sum()),
        "in boxes before": int(met.sum()),
        "in boxes left": int((seen & objects[:, None]).sum()),
        "particles in boxes": int((seen & particles[:, None]).sum()),
    }


@pytest.mark.long  # beside made frames in test_augment.py
@pytest.mark.parametrize("kind", WEATHERS)
@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_labels_of_recorded_frames_agree_with_what_the_weather_did(tmp_path: Path, kind: str) -> None:
    source, target = kitti_set(tmp_path / "clear", FRAMES), tmp_path / kind
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE.format(kind=kind, weather=WEATHERS[kind]), encoding="utf-8")
    summary = augment(source, target, str(recipe), workers=0, seed=4, layout="kitti")
    assert (summary.done, list(summary.broken)) == (summary.frames + summary.copies, [])
    files = {path.relative_to(source) for path in source.rglob("*") if path.is_file()}
    assert files == {path.relative_to(target) for path in target.rglob("*") if path.is_file()} - {Path(NAME)}
    rows = rows_of(target)
    for name in FRAMES:
        found = check_frame(source, target, name, rows[f"training/{name}"])
        assert found["boxes"] > 0
        assert found["in boxes before"] > 50
        assert 0 < found["in boxes left"] <= found["in boxes before"]
        assert found["particles"] > 1000
