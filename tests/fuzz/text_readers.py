"""Readers of calibrations, boxes, speeds, tables, drops, recipes, studies, declarations and records."""

from __future__ import annotations

import gzip
import json
import sqlite3
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.io import netcdf_file

from tests.datasets.augment.data_sets import BOTH, BOXES, CALIBRATION, FOG, nuscenes
from tests.fuzz.reader import Reader, given, saved
from tests.gap import studies
from torchweather import datasets, io, sensors
from torchweather.atmosphere.weather import parse_weather
from torchweather.cli.run_record import read_runs
from torchweather.datasets.augment import Manifest, Row
from torchweather.datasets.augment.layouts import find_frames
from torchweather.datasets.augment.own_vehicle import masks_from_text, masks_to_text
from torchweather.datasets.speeds import read_speeds, read_timestamps
from torchweather.evaluation.robustness import read_boxes_truth, read_declaration
from torchweather.evaluation.robustness.baseline import read_baseline
from torchweather.evaluation.sweep import parse_levels
from torchweather.gap import Study
from torchweather.gap.model_file import read_model
from torchweather.lidar import OwnVehicleMask
from torchweather.recipes import load_recipe, read_recipe, recipes_folder

__all__ = ["READERS"]

RECTIFIED = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)

# ---- calibrations ----------------------------------------------------------------------------------------------------

P = "700 0 600 45 0 700 180 0.2 0 0 1 0.003"
TR = "0 -1 0 0.1 0 0 -1 -0.3 1 0 0 -0.4"
OBJECT = "".join(f"P{k}: {P}\n" for k in range(4)) + f"R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {TR}\n"
ODOMETRY = "".join(f"P{k}: {P}\n" for k in range(4)) + f"Tr: {TR}\n"
TRACKING = f"P0: {P}\nP2: {P}\nR_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam {TR}\nTr_imu_velo {TR}\n"
RAW = f"calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 1.242e+03 3.75e+02\nR_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_02: {P}\n"
RAW_VELODYNE = "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0.1 -0.3 -0.4\n"
OPENCV = """%YAML:1.0
---
image_width: 1280
image_height: 720
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1.1586e+03, 0., 6.692e+02, 0., 1155.4, 390.8, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.517e-01, 2.04e-02, -4e-4, 0., -6.3e-02 ]
"""
ROS = """image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0.0, 320.5, 0.0, 501.0, 240.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0.001, -0.002, 0.0]}
"""
COLMAP = "# cameras\n1 OPENCV 640 480 500 501 320 240 -0.3 0.1 0.001 -0.002\n"
COLMAP_OTHER = "1 SIMPLE_RADIAL 640 480 500 320 240 -0.3\n"
MATRIX = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]]
LIDAR2CAM = [[1.0, 0, 0, 0.01], [0, 0, -1, -0.33], [0, 1, 0, -0.43], [0, 0, 0, 1]]
CAM2EGO = [[0.0, 0, 1, 1.7], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]
MMDET = json.dumps({"images": {"CAM_FRONT": {"cam2img": MATRIX, "lidar2cam": LIDAR2CAM, "cam2ego": CAM2EGO}}})
SENSOR_ROWS = json.dumps(
    [{"token": "a", "translation": [1.7, 0, 1.5], "rotation": [0.5, -0.5, 0.5, -0.5], "camera_intrinsic": MATRIX}]
)


def _calibration(path: Path) -> Any:
    found = datasets.read_kitti_calibration(path)
    return found, datasets.read_kitti_rectified_from_lidar(path)


def _camera(width: int, height: int) -> Callable[[Path], Any]:
    return lambda path: datasets.read_camera(path, width=width, height=height).to_dict()


def _beside(**contents: str) -> Callable[[Path], Mapping[str, bytes]]:
    return lambda _: {name.replace("__", "."): text.encode() for name, text in contents.items()}


# ---- boxes, speeds, tables -------------------------------------------------------------------------------------------

TRACKS = "".join(f"{frame} 1 Car 0 0 -1.6 10 10 20 20 1.6 1.8 4.0 {frame} 1 20 -1.5\n" for frame in range(3))
BOXES_JSON = json.dumps(
    {
        "results": {
            "s": [
                {
                    "translation": [10, 1, 0],
                    "size": [1.8, 4, 1.6],
                    "rotation": [0.9, 0, 0, 0.4],
                    "detection_name": "car",
                },
                {"translation": [20, 1, 0], "size": [1, 1, 1], "rotation": [1, 0, 0, 0], "velocity": [1.0, 0.5]},
            ]
        }
    }
)
BOXES_LIST = json.dumps(
    [{"sample_token": "s", "translation": [10, 1, 0], "size": [1.8, 4, 1.6], "rotation": [0.9, 0, 0, 0.4]}]
)
COCO = json.dumps(
    {
        "images": [{"id": 1, "file_name": "a.png", "height": 10, "width": 12}, {"id": 2, "file_name": "b/b.png"}],
        "annotations": [
            {"id": 1, "image_id": 1, "category_id": 3, "bbox": [1, 2, 3.5, 4], "iscrowd": 0},
            {"id": 2, "image_id": 2, "category_id": 4, "bbox": [0, 0, 5, 5], "iscrowd": 1},
        ],
        "categories": [{"id": 3, "name": "car"}, {"id": 4, "name": "person"}],
    }
)
SPEEDS = "time_s,speed_km_per_h\n0,36\n0.1,37.5\n0.2,38\n"
SPEED_LINES = "# m/s\n10\n10.5\n11\n"
TIMES = "2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.064389445\n2011-09-26 13:02:26.164389445\n"
OXTS = "49.0 8.4 116 0.03 0.003 -1.3 " + "10 0.5 " + " ".join(["0.1"] * 22) + "\n"
TABLE = 'frame,rate,name\n007,0.1,"a, ""b"""\n008,nan,\'=c\n009,,é\n'

# ---- drops -----------------------------------------------------------------------------------------------------------


def _telegram(_: Path) -> list[bytes]:
    spectrum = ["0"] * 1024
    spectrum[10 * 32 + 9] = "7"
    row = ["1"] * 24
    row[3], row[6], row[11], row[22] = "01-01-2010 00:00:30", "5.2", "9999", ",".join(spectrum)
    text = "\n".join([",".join(f'"{cell}"' for cell in row)] * 2).encode() + b"\n"
    return [text, gzip.compress(text, mtime=0)]


def _drops(folder: Path) -> list[bytes]:
    def write(path: Path) -> None:
        with netcdf_file(path, "w") as file:
            file.createDimension("time", 6)
            for name, values in {
                "equivolumetric_sphere_diameter": [1.0, 1.5, 2.0, 1.0, 3.0, -9999.0],
                "fall_speed": [4.0, 5.4, 6.5, 4.1, 8.0, 1.0],
                "area": [9000.0] * 6,
                "time_offset": [1.0, 5.0, 20.0, 70.0, 80.0, 90.0],
            }.items():
                file.createVariable(name, "d", ("time",))[:] = values
            file.createVariable("base_time", "i", ())[...] = 1_300_000_000

    return [saved(folder, "a.cdf", write)]


def _parsivel(folder: Path) -> list[bytes]:
    def write(path: Path) -> None:
        import h5netcdf

        edges, speeds = io.parsivel_edges_mm().numpy(), io.parsivel_speeds_m_per_s().numpy()
        counts = np.zeros((2, 32, 32), "i2")
        counts[:, 10, 20] = 5
        with h5netcdf.File(path, "w") as file:
            file.dimensions = {"time": 2, "d": 32, "v": 32}
            file.create_variable("data_raw", ("time", "d", "v"), data=counts)
            file.create_variable("diameter_lower_bounds", ("d",), data=edges[:-1])
            file.create_variable("diameter_upper_bounds", ("d",), data=edges[1:])
            file.create_variable("velocity_lower_bounds", ("v",), data=speeds - 0.05)
            file.create_variable("velocity_upper_bounds", ("v",), data=speeds + 0.05)
            file.create_variable("time_interval", (), data=60.0)
            file.create_variable("rain_intensity", ("time",), data=np.array([1.0, 2.0]))
            time = file.create_variable("time", ("time",), data=np.array([0.0, 1.0]))
            time.attrs["units"] = "hours since 2024-07-22 00:00:00"

    return [saved(folder, "a.nc", write)]


def _spectrum(path: Path) -> Any:
    found = io.read_disdrometer(path)
    return found.density_per_m3_mm, found.rate_mm_per_h, found.time_s  # reported values may be missing


# ---- YAML ------------------------------------------------------------------------------------------------------------

DETECTOR = """format: torchweather-detector/1
title: cars
sensor: camera
input: {name: images, size: [64, 96], fit: letterbox, scale: 0.00392}
decoder: yolov8
outputs: {packed: output0}
classes: {0: car, 2: person}
options: {form: cxcywh, threshold: 0.25}
"""
MODEL = """format: torchweather-model/1
effects:
- {effect: lidar.window_loss, loss_db: 1.0}
- {effect: lidar.threshold_shift, shift_db: 0.5}
"""
LAYOUT = """dims: [range, azimuth]
range_m: {first: 0.5, step: 0.25}
azimuth_deg: [0, 90, 180, 270]
scale: db_steps
step_db: 0.5
"""
SENSOR = "kind: lidar\npreset: velodyne-vlp-16\nrange_noise_m: 0.02\nintensity_unit: reflectivity\n"


def _recipes(*patterns: str) -> Callable[[Path], list[bytes]]:
    def make(_: Path) -> list[bytes]:
        root = recipes_folder()
        return [path.read_bytes() for pattern in patterns for path in sorted(root.glob(pattern))[:3]]

    return make


@cache
def _study(kind: str) -> dict[str, bytes]:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        Study.from_arrays(**studies.arguments(kind, clear=2, frames=1)).write(Path(folder) / "study")
        root = Path(folder) / "study"
        return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def _study_file(path: Path) -> Any:
    found = Study.read(path.parent)
    return [dict(one.frames[0]) for one in found.conditions][:0]


def _study_frame(path: Path) -> Any:
    found = Study.read(path.parents[1])
    return [list(one.clear) for one in found.scenes.values()] and [list(one.frames) for one in found.conditions][:0]


def _of_study(kind: str) -> Callable[[Path], Mapping[str, bytes]]:
    return lambda _: dict(_study(kind).items())


def _frame_of(kind: str, part: str) -> Reader:
    names = [name for name in _study(kind) if part in name and "geometry" not in name]
    return Reader(
        f"study-{kind}-{part}",
        names[0],
        lambda _: [_study(kind)[name] for name in names],
        _study_frame,
        _of_study(kind),
    )


# ---- records ---------------------------------------------------------------------------------------------------------

RECORD = json.dumps({"format": "torchweather-record/1", "runs": [{"command": "apply", "files": [{"output": "a.png"}]}]})
BASELINE = json.dumps({"format": "torchweather-robustness/1", "detector": "a", "measure": "AP", "conditions": []})


def _own_mask() -> OwnVehicleMask:
    blocked = np.zeros((4, 8), bool)
    blocked[0, :3] = True
    near = np.where(blocked, 1.0, np.inf).astype(np.float32)
    return OwnVehicleMask(blocked, near, np.where(blocked, 2.0, 0.0).astype(np.float32), 6, 3.0)


def _mask(folder: Path) -> list[bytes]:
    return [saved(folder, "a.npz", _own_mask().save)]


def _mask_text(_: Path) -> list[bytes]:
    return [masks_to_text({"drive/": _own_mask()}).encode()]


def _manifest(folder: Path) -> list[bytes]:
    with Manifest(folder) as manifest:
        manifest.write_settings({"format": "torchweather-manifest/1", "seed": "0", "recipe": "fog"})
        for number in range(3):
            manifest.record(
                Row(
                    f"day/{number:03d}",
                    "done",
                    "weather",
                    {f"{number}.png": ["ab" * 32, 10, 5]},
                    {f"{number}.png": ["cd" * 32, 10, 5]},
                    "ef" * 32,
                    7 + number,
                    "0.1.0",
                    {"kind": "fog", "mor_m": 30.0},
                    None,
                    None,
                    ("a note",),
                )
            )
    return [(folder / "torchweather-manifest.sqlite").read_bytes()]


def _manifest_text(folder: Path) -> list[bytes]:
    """Rows changed in the database, not in its bytes."""
    base = _manifest(folder)[0]
    found = [base]
    for column, value in (
        ("outputs", '{"a": 5}'), ("outputs", "[" * 2000), ("outputs", '{"a": [1, 2, 3]}'), ("inputs", "nan"),
        ("notes", "null"), ("notes", "[1]"), ("weather", "[]"), ("boxes", "{}"), ("frame", b"\xff\xfe"), ("seed", "x"),
        ("seconds", "x"), ("status", 7), ("outputs", '{"../x": ["ab", 1, 2]}'), ("frame", '"\\ud800"'), ("error", '"'),
    ):  # fmt: skip
        path = folder / "b.sqlite"
        path.write_bytes(base)
        with sqlite3.connect(path) as file:
            file.execute(f"update frames set {column} = ? where frame = 'day/001'", (value,))
        file.close()
        found.append(path.read_bytes())
    return found


def _rows(path: Path) -> Any:
    with Manifest(path.parent) as manifest:
        manifest.settings()
        return [manifest.outputs_stand(row) for row in manifest.rows()]


def _rebuilt(path: Path) -> Any:
    with Manifest(path.parent, rebuild=True) as manifest:
        return [row.seed for row in manifest.rows()]


def _begun_again(path: Path) -> Any:
    with Manifest(path.parent, anew=True) as manifest:
        return [row.seed for row in manifest.rows()]


def _boxes(path: Path) -> Any:
    found = datasets.read_nuscenes_boxes(path)
    return found.centre_m, found.size_m, found.yaw_rad  # a record's velocity may be NaN, unknown


def _tables(folder: Path) -> dict[str, bytes]:
    nuscenes(folder / "set")
    root = folder / "set"
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def _table_reader(name: str) -> Reader:
    file = f"v1.0-mini/{name}.json"

    def read(path: Path) -> Any:
        found = find_frames(path.parents[1], {"camera": "image", "lidar": "points"}, recipe="a", layout="nuscenes")
        return len(found.frames)

    return Reader(f"nuscenes-{name}", file, lambda folder: [_tables(folder)[file]], read, _tables)


MANIFEST = "torchweather-manifest.sqlite"
CLASSES = {0: "car", 1: "person"}
READERS = (
    Reader("kitti-object", "calib/a.txt", given(OBJECT, CALIBRATION), _calibration),
    Reader("kitti-odometry", "calib.txt", given(ODOMETRY), _calibration),
    Reader("kitti-tracking", "calib/0001.txt", given(TRACKING), _calibration),
    Reader("kitti-raw", "calib_cam_to_cam.txt", given(RAW), _calibration, _beside(calib_velo_to_cam__txt=RAW_VELODYNE)),
    Reader(
        "kitti-raw-velodyne",
        "calib_velo_to_cam.txt",
        given(RAW_VELODYNE),
        lambda path: _calibration(path.with_name("calib_cam_to_cam.txt")),
        _beside(calib_cam_to_cam__txt=RAW),
    ),
    Reader("kitti-camera", "a.txt", given(OBJECT, TRACKING, P), _camera(1242, 375)),
    Reader("nuscenes-calibration", "a.json", given(MMDET[11:-1]), datasets.read_nuscenes_calibration),
    Reader("camera-json", "a.json", given(MMDET, SENSOR_ROWS), _camera(1600, 900)),
    Reader("camera-opencv", "a.yaml", given(OPENCV), _camera(1280, 720)),
    Reader("camera-ros", "a.yaml", given(ROS), _camera(640, 480)),
    Reader("camera-colmap", "cameras.txt", given(COLMAP, COLMAP_OTHER), _camera(640, 480)),
    Reader("boxes-kitti", "a.txt", given(BOXES), lambda path: datasets.read_kitti_boxes(path, RECTIFIED)),
    Reader("boxes-tracking", "a.txt", given(TRACKS), lambda path: datasets.read_kitti_boxes(path, RECTIFIED, frame=1)),
    Reader("boxes-nuscenes", "a.json", given(BOXES_JSON, BOXES_LIST), _boxes),
    Reader(
        "boxes-coco",
        "a.json",
        given(COCO),
        lambda path: {k: v.boxes for k, v in read_boxes_truth(path, CLASSES).items()},
    ),
    Reader("speeds", "a.csv", given(SPEEDS, SPEED_LINES), read_speeds),
    Reader("speeds-oxts", "oxts/data/0.txt", given(OXTS), lambda path: read_speeds(path.parents[1])),
    Reader("timestamps", "timestamps.txt", given(TIMES), read_timestamps),
    Reader("table-csv", "a.csv", given(TABLE), lambda path: len(io.read_table(path))),
    Reader("drops-telegrams", "a.dat", _telegram, _spectrum),
    Reader("drops-netcdf3", "a.cdf", _drops, _spectrum),
    Reader("drops-netcdf4", "a.nc", _parsivel, _spectrum),
    Reader(
        "recipe",
        "a.yaml",
        lambda folder: [FOG.encode(), *_recipes("camera/*.yaml", "lidar/*.yaml", "radar/*.yaml")(folder)],
        read_recipe,
    ),
    Reader(
        "recipe-built",
        "a.yaml",
        lambda folder: [FOG.encode(), *_recipes("camera/f*.yaml", "radar/*.yaml")(folder)],
        lambda path: load_recipe(path) and None,
    ),
    Reader(
        "recipe-several",
        "a.yaml",
        lambda folder: [BOTH.encode(), *_recipes("multi_sensor/*.yaml")(folder)],
        lambda path: load_recipe(path) and None,
    ),
    Reader("recipe-suite", "a.yaml", _recipes("*/robustness.yaml"), read_recipe),
    Reader("declaration", "a.yaml", given(DETECTOR), read_declaration),
    Reader("model", "a.yaml", given(MODEL), read_model),
    Reader("map-layout", "a.yaml", given(LAYOUT), lambda path: io.map_layout(str(path))),
    Reader(
        "sensor-yaml",
        "a.yaml",
        given(SENSOR, *(yaml for yaml in ("kind: camera\nwidth: 40\nheight: 24\nfx: 40\nfy: 40\n",))),
        lambda path: _sensor(path),
    ),
    Reader(
        "weather-text",
        "a.txt",
        given("rain:rate=25", "fog:mor=30+snow:rate=1", "rain:rate=1..50"),
        lambda path: _weather(path.read_bytes().decode("utf-8", "replace")),
    ),
    Reader(
        "levels-text",
        "a.txt",
        given("rain:rate=1,5,25", "fog:mor=400,100+snow:rate=1"),
        lambda path: list(parse_levels(path.read_bytes().decode("utf-8", "replace"))),
    ),
    *(
        Reader(
            f"study-{kind}",
            "study.yaml",
            lambda _, kind=kind: [_study(kind)["study.yaml"]],
            _study_file,
            _of_study(kind),
        )
        for kind in studies.KINDS
    ),
    _frame_of("lidar", "frames/condition"),
    _frame_of("camera", "frames/scene"),
    _frame_of("radar", "frames/condition"),
    Reader("run-record", "torchweather-record.json", given(RECORD), lambda path: read_runs(path.parent)),
    Reader("baseline", "robustness.json", given(BASELINE), read_baseline),
    Reader("own-vehicle", "a.npz", _mask, lambda path: OwnVehicleMask.load(path).beams),
    Reader(
        "own-vehicle-text",
        "a.json",
        _mask_text,
        lambda path: len(masks_from_text(path.read_bytes().decode("utf-8", "replace"))),
    ),
    Reader("manifest", MANIFEST, _manifest_text, _rows),
    Reader("manifest-rebuilt", MANIFEST, _manifest_text, _rebuilt),
    Reader("manifest-anew", MANIFEST, _manifest_text, _begun_again),
    *map(_table_reader, ("sample_data", "calibrated_sensor", "ego_pose", "sample_annotation")),
)


def _sensor(path: Path) -> None:
    kind = sensors.Camera if b"camera" in path.read_bytes() else sensors.Lidar
    kind.preset(str(path))  # zero_intensity and others may be None, ranges infinite


def _weather(text: str) -> Any:
    return parse_weather(text, random=True).to_dict()
