"""Cameras from calibration files: KITTI, nuScenes, OpenCV and ROS YAML, COLMAP."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchweather.camera.frame_sizes import same_aspect
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import TorchweatherError, check_at_least, nearest_name
from torchweather.core.yaml_file import parse_json, read_json
from torchweather.datasets.kitti import read_kitti_entries
from torchweather.datasets.yaml_calibration import camera_fields_from_yaml

__all__ = ["read_camera", "read_camera_fields"]

SUPPORTED = (
    "KITTI text (P2 or P_rect_02), nuScenes JSON (camera_intrinsic or cam2img), OpenCV or ROS YAML (camera_matrix and "
    "distortion_coefficients, or K and D), COLMAP cameras.txt"
)
NUSCENES_SIZE = (1600, 900)  # of all six cameras (Caesar et al. 2020, table 2)
# Parameters of COLMAP's models in the order of its documentation; its pixel centres lie at 0.5.
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
_MAX_BYTES = 64 * 2**20  # nuScenes' largest table of calibrations has 8 MB
# Where a principal point can lie, as a share of the frame. Of the published calibrations here the farthest is at 0.54;
# a calibration of frames of twice the size is at 1.0, of half the size at 0.25.
_MIDDLE = (0.3, 0.7)


def read_camera(
    path: str | os.PathLike[str], *, width: int | None = None, height: int | None = None, name: str | None = None
) -> Camera:
    """The camera of a calibration file, lens distortion included.

    ==========  ==========================================================================================
    file        what is read
    ==========  ==========================================================================================
    KITTI       ``P2`` (``P_rect_02`` of the raw kit) of object, tracking, odometry and raw; no distortion
    nuScenes    ``calibrated_sensor`` records, or mmdetection3d's ``cam2img``; height, pitch and roll with them
    YAML        of OpenCV (``!!opencv-matrix``) and ROS ``camera_info``: ``K`` and ``D``, so of raw frames
    COLMAP      ``cameras.txt`` with PINHOLE, SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV
    ==========  ==========================================================================================

    Args:
        path: the file.
        width, height: size of the frames, pixels; needed where the file does not hold one (KITTI but raw, some YAML).
            A calibration of another size is rescaled where the aspect ratio is the same within 1 %.
        name: of the camera where the file holds several: ``CAM_BACK`` or a token of nuScenes, ``P3`` of KITTI, the
            number of a COLMAP camera. Defaults: ``CAM_FRONT``, ``P2``, the only one.

    Raises:
        TorchweatherError: the file is missing or broken, is none of these, lacks its size, has another aspect ratio
            than the frames, or has a lens that `Camera` cannot represent (fisheye, rational).

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "cameras.txt"
        >>> _ = file.write_text("1 SIMPLE_RADIAL 640 480 500.0 320.0 240.0 -0.1")
        >>> camera = read_camera(file, width=320, height=240)
        >>> camera.fx, camera.principal_point_px, camera.k1
        (250.0, (159.5, 119.5), -0.1)
    """
    check_arguments(
        "read_camera(path: path, width: int | None, height: int | None, name: str | None)",
        path,
        width,
        height,
        name,
    )
    return Camera.from_dict(read_camera_fields(path, width=width, height=height, name=name))


def read_camera_fields(
    path: str | os.PathLike[str], *, width: int | None = None, height: int | None = None, name: str | None = None
) -> dict[str, Any]:
    """Fields of `Camera` in a calibration file, for frames of this size; arguments as `read_camera`."""
    check_arguments(
        "read_camera_fields(path: path, width: int | None, height: int | None, name: str | None)",
        path,
        width,
        height,
        name,
    )
    source = Path(path)
    fields = _fields(source, _text(source), name, (width, height))
    own = fields.get("width"), fields.get("height")
    if None in own:
        if width is None or height is None:
            raise TorchweatherError(f"{source}: the file holds no image size. Give width and height.")
        fields |= {"width": width, "height": height}
        _check_middle(fields, source)
    try:
        camera = Camera.from_dict(fields)
    except (ValueError, TypeError) as error:
        raise TorchweatherError(f"{source}: {error}") from error
    if width is None or height is None or (width, height) == own or None in own:
        return fields
    if not same_aspect(width, height, camera.width, camera.height):
        raise TorchweatherError(
            f"{source}: the calibration is of {camera.width} x {camera.height} px, the frame has {width} x {height}, "
            "another aspect ratio. Cropped frames need a calibration of their own: give fx, fy, cx and cy."
        )
    scaled = camera.resized(width, height)
    return fields | {key: getattr(scaled, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}


def _text(source: Path) -> str:
    try:
        if source.stat().st_size > _MAX_BYTES:
            raise TorchweatherError(f"{source}: expected a camera calibration; got more than {_MAX_BYTES >> 20} MB.")
        return source.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except UnicodeDecodeError as error:
        raise TorchweatherError(f"{source}: found binary data; supported are {SUPPORTED}.") from error
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error


def _fields(source: Path, text: str, name: str | None, size: tuple[int | None, int | None]) -> dict[str, Any]:
    """Fields of the camera by the kind of the file, which its content tells."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    first = lines[0] if lines else ""
    suffix = source.suffix.lower()
    if not first:
        raise TorchweatherError(f"{source}: found an empty file; supported are {SUPPORTED}.")
    if first.startswith("<"):
        raise TorchweatherError(f"{source}: found XML; supported are {SUPPORTED}. OpenCV writes YAML as well.")
    if suffix == ".json" or first[0] in "{[":
        return _from_json(source, text, name)
    if suffix in (".yaml", ".yml") or first.startswith("%YAML"):
        return camera_fields_from_yaml(source, text, SUPPORTED)
    words = first.split()
    if len(words) > 4 and words[0].isdigit() and words[1].replace("_", "").isalpha() and words[1].isupper():
        return _from_colmap(source, lines, name, size)
    if first[0].isalpha() and not any(
        line.startswith(("P0", "P1", "P2", "P3", "P_rect_", "calib_time")) for line in lines
    ):
        raise TorchweatherError(f"{source}: found text that begins with {first[:40]!r}; supported are {SUPPORTED}.")
    return _from_kitti(source, name or "P2")


def _from_kitti(source: Path, name: str) -> dict[str, Any]:
    entries = read_kitti_entries(source)
    name = f"P{int(name[-2:])}" if name.startswith(("P_rect_", "image_")) and name[-1:].isdigit() else name
    numbers = entries.get(name, [])
    if len(numbers) not in (12, 16):
        found = ", ".join(f"{key} ({len(values)} numbers)" for key, values in entries.items()) or "no numbers"
        raise TorchweatherError(f"{source}: expected {name} of a KITTI calibration (12 or 16 numbers); found {found}.")
    rows = (numbers[0:3], numbers[4:7], numbers[8:11])
    fields = _intrinsics(rows, source, name)
    size = entries.get(f"S_rect_0{name[1:]}", [])
    return fields | (_size(size[0], size[1], source) if len(size) == 2 else {})


def _from_json(source: Path, text: str, name: str | None) -> dict[str, Any]:
    content = parse_json(text, str(source), "a calibration")
    if isinstance(content, dict):
        content = content.get("images", content)
    records = content if isinstance(content, list) else [content]
    if records and all(isinstance(record, dict) and "camera_intrinsic" in record for record in records):
        return _from_nuscenes_table(source, records, name)
    cameras = content if isinstance(content, dict) else {}
    cameras = {key: value for key, value in cameras.items() if isinstance(value, dict) and "cam2img" in value}
    if not cameras:
        found = (
            f"JSON with the keys {', '.join(map(str, list(content)[:8]))}" if isinstance(content, dict) else "a list"
        )
        raise TorchweatherError(f"{source}: found {found}; supported are {SUPPORTED}.")
    wanted = name or ("CAM_FRONT" if "CAM_FRONT" in cameras or len(cameras) > 1 else next(iter(cameras)))
    if wanted not in cameras:
        raise TorchweatherError(
            f"{source}: expected the camera {wanted!r}; found {', '.join(cameras)}.{nearest_name(wanted, cameras)}"
        )
    return _nuscenes_fields(cameras[wanted]["cam2img"], cameras[wanted].get("cam2ego"), source, wanted)


def _from_nuscenes_table(source: Path, records: Sequence[Mapping[str, Any]], name: str | None) -> dict[str, Any]:
    """One camera of ``calibrated_sensor``; channels are named by ``sensor.json`` beside it."""
    cameras = [record for record in records if record["camera_intrinsic"]]
    channels: dict[Any, Any] = {}
    beside = source.with_name("sensor.json")
    if beside.is_file():
        try:
            channels = {entry["token"]: entry["channel"] for entry in read_json(beside, "nuScenes' table of sensors")}
        except (KeyError, TypeError) as error:
            raise TorchweatherError(f"{beside}: expected nuScenes' table of sensors; {error!r}.") from error
    chosen = [
        record
        for record in cameras
        if name is None or name in (record.get("token"), channels.get(record.get("sensor_token")))
    ]
    if len(chosen) != 1:
        raise TorchweatherError(
            f"{source}: expected one camera; found {len(chosen)} of {len(cameras)} records with camera_intrinsic"
            f"{f' named {name!r}' if name else ''}. Each log has its own: name one by its token."
        )
    record = chosen[0]
    pose = None
    if "rotation" in record and "translation" in record:
        pose = _pose(record["rotation"], record["translation"], source)
    return _nuscenes_fields(record["camera_intrinsic"], pose, source, "camera_intrinsic")


def _pose(rotation: Any, translation: Any, source: Path) -> list[list[float]]:
    """Vehicle from camera, rows of 4, from a quaternion w, x, y, z and metres."""
    try:
        w, x, y, z = (float(value) for value in rotation)
        shift = [float(value) for value in translation]
        norm = w * w + x * x + y * y + z * z
        s = 2.0 / norm
        third = [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y), shift[2]]
    except (TypeError, ValueError, ZeroDivisionError, IndexError) as error:
        raise TorchweatherError(
            f"{source}: expected rotation (4 numbers) and translation (3 numbers); {error}."
        ) from error
    # Height, pitch and roll need the row of the vehicle's z alone.
    return [[0.0] * 4, [0.0] * 4, third]


def _nuscenes_fields(matrix: Any, pose: Any, source: Path, name: str) -> dict[str, Any]:
    """Intrinsics of 1600 x 900 px; height over ground, pitch and roll where the pose in the vehicle is known."""
    fields = _intrinsics(matrix, source, name) | dict(zip(("width", "height"), NUSCENES_SIZE, strict=True))
    if pose is None:
        return fields
    try:
        right, _, forward, height_m = (float(value) for value in pose[2])
        pitch = math.asin(forward)
        roll = -math.asin(right / math.cos(pitch))
    except (TypeError, ValueError, LookupError, ZeroDivisionError) as error:
        raise TorchweatherError(f"{source}: expected a pose of {name} in the vehicle, 4 x 4; {error}.") from error
    # The vehicle's frame lies on the road, below the rear axle (nuScenes' schema of ego_pose).
    return fields | {"height_m": height_m, "pitch_rad": pitch, "roll_rad": roll}


def _from_colmap(
    source: Path, lines: Sequence[str], name: str | None, size: tuple[int | None, int | None]
) -> dict[str, Any]:
    cameras = {line.split()[0]: line.split()[1:] for line in lines}
    chosen = [key for key in cameras if name is None or key == name]
    if len(chosen) > 1:  # by the size of the frames, where one camera alone has it
        chosen = [key for key in chosen if cameras[key][1:3] == [str(side) for side in size]]
    if len(chosen) != 1:
        raise TorchweatherError(f"{source}: expected one camera; found {', '.join(cameras)}. Name one by its number.")
    model, *values = cameras[chosen[0]]
    if model not in COLMAP_MODELS:
        raise TorchweatherError(
            f"{source}: camera {chosen[0]} has COLMAP's model {model}; supported are {', '.join(COLMAP_MODELS)}. "
            "Undistort the images with COLMAP (image_undistorter) first."
        )
    names = COLMAP_MODELS[model]
    try:
        width, height, *parameters = (float(value) for value in values)
        fields = dict(zip(names, parameters, strict=True))
    except ValueError as error:
        raise TorchweatherError(
            f"{source}: camera {chosen[0]}: expected width, height, {', '.join(names)}; got {' '.join(values)}."
        ) from error
    if "f" in fields:
        focal = fields.pop("f")
        fields |= {"fx": focal, "fy": focal}
    fields |= {"cx": fields["cx"] - 0.5, "cy": fields["cy"] - 0.5}
    return fields | _size(width, height, source)


def _size(width: float, height: float, source: Path) -> dict[str, int]:
    if not (math.isfinite(width) and math.isfinite(height)):
        raise TorchweatherError(f"{source}: expected an image size in pixels; got {width:g} x {height:g}.")
    return {"width": int(width), "height": int(height)}


def _intrinsics(rows: Any, source: Path, name: str) -> dict[str, Any]:
    """fx, fy, cx, cy of a camera matrix of at least 3 x 3."""
    try:
        matrix = [[float(value) for value in row[:3]] for row in rows[:3]]
        (fx, skew, cx), (_, fy, cy), (_, _, one) = matrix
    except (TypeError, ValueError, KeyError) as error:
        raise TorchweatherError(f"{source}: expected numbers, 3 x 3, in {name}; {error}.") from error
    if not (abs(one - 1) < 1e-6 and abs(skew) <= 1e-3 * abs(fx)):
        raise TorchweatherError(
            f"{source}: expected a camera matrix without skew and with a last 1 in {name}; got {matrix}."
        )
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}


def _check_middle(fields: Mapping[str, Any], source: Path) -> None:
    """Raise where the frame cannot be of the calibration's size, which the file does not tell."""
    for axis, side in (("cx", "width"), ("cy", "height")):
        check_at_least(side, fields[side], 1, unit="px", owner="read_camera")
        share = (fields[axis] + 0.5) / fields[side]
        if not _MIDDLE[0] <= share <= _MIDDLE[1]:
            raise TorchweatherError(
                f"{source}: {axis} = {fields[axis]:g} px is not near the middle of a {side} of {fields[side]} px: the "
                "calibration belongs to frames of another size. Give the original frames, or fx, fy, cx and cy."
            )
