"""KITTI: Velodyne clouds and the calibration of the left colour camera, of all four kits."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, TorchweatherError
from torchweather.datasets.calibration import CameraLidarCalibration
from torchweather.io.points import read_points

__all__ = [
    "RAW_CALIBRATIONS",
    "kitti_camera_matrix",
    "read_kitti_calibration",
    "read_kitti_entries",
    "read_kitti_points",
    "read_kitti_rectified_from_lidar",
]

# Calibration of recording day 2011_09_26, as in the calibration files of KITTI's object data set: rectifying
# rotation, and Velodyne (x forward, y left, z up) to the unrectified reference camera.
_R0_RECT = (
    9.999239e-01, 9.837760e-03, -7.445048e-03,
    -9.869795e-03, 9.999421e-01, -4.278459e-03,
    7.402527e-03, 4.351614e-03, 9.999631e-01,
)  # fmt: skip
_TR_VELO_TO_CAM = (
    7.533745e-03, -9.999714e-01, -6.166020e-04, -4.069766e-03,
    1.480249e-02, 7.280733e-04, -9.998902e-01, -7.631618e-02,
    9.998621e-01, 7.523790e-03, 1.480755e-02, -2.717806e-01,
)  # fmt: skip


_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_RECTIFY, _VELODYNE, _ODOMETRY = "R0_rect", "Tr_velo_to_cam", "Tr"
_ORTHOGONAL = 1e-3  # the files print seven digits
RAW_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt")


def read_kitti_points(path: str | os.PathLike[str]) -> Tensor:
    """A Velodyne cloud.

    Args:
        path: ``velodyne/*.bin``.

    Returns:
        ``(N, 4)`` float32: x forward, y left, z up in metres, reflectance 0..1.

    Raises:
        TorchweatherError: the file is missing, truncated, or not float32 rows of four.
    """
    check_arguments("read_kitti_points(path: path)", path)
    return read_points(path, format="kitti").points


def read_kitti_calibration(path: str | os.PathLike[str]) -> CameraLidarCalibration:
    """Camera 2 (left colour) and the Velodyne.

    ``T_camera_from_lidar = [I | K^-1 p] R0_rect Tr_velo_to_cam`` with ``P2 = [K | p]``. The odometry kit's ``Tr``
    goes to the rectified camera already and stands for both.

    ==========  =================================================================================================
    kit         file
    ==========  =================================================================================================
    object      ``calib/NAME.txt``
    tracking    ``calib/SEQUENCE.txt``; names without colons
    odometry    ``calib.txt`` of a sequence, also SemanticKITTI's
    raw         ``calib_cam_to_cam.txt`` of a day, with ``calib_velo_to_cam.txt`` beside it
    ==========  =================================================================================================

    Args:
        path: one of these, or a text with nothing but the 12 or 16 numbers of ``P2``.

    Returns:
        The calibration. Of nothing but numbers, the Velodyne's place is that of recording day 2011_09_26 and
        ``assumption`` says so: the car and its mounts stayed the same, which leaves a few pixels.

    Raises:
        TorchweatherError: the file is missing, holds no ``P2``, or has names but lacks the Velodyne's.
    """
    check_arguments("read_kitti_calibration(path: path)", path)
    source = Path(path)
    entries = read_kitti_entries(source)
    projection = _projection(entries, source)
    camera_matrix = projection[:, :3].clone()
    offset = torch.eye(4, dtype=torch.float64)
    offset[:3, 3] = torch.linalg.solve(camera_matrix, projection[:, 3])
    rectified_from_lidar, assumption = _rectified_from_lidar(entries, source)
    try:
        return CameraLidarCalibration(camera_matrix, offset @ rectified_from_lidar, assumption)
    except InputValueError as error:
        raise TorchweatherError(f"{source}: {error}") from error


def kitti_camera_matrix(path: str | os.PathLike[str]) -> Tensor:
    """The intrinsics of camera 2, ``(3, 3)`` float64, pixels; also of a file without the Velodyne.

    Args:
        path: as of `read_kitti_calibration`.

    Raises:
        TorchweatherError: the file is missing or holds no ``P2``.
    """
    source = Path(path)
    return _projection(read_kitti_entries(source), source)[:, :3].clone()


def _projection(entries: dict[str, list[float]], source: Path) -> Tensor:
    """``P2``, ``(3, 4)``, with an invertible camera matrix."""
    if "P2" not in entries or len(entries["P2"]) not in (12, 16):
        found = ", ".join(f"{key} ({len(values)} numbers)" for key, values in entries.items()) or "no numbers"
        raise TorchweatherError(f"{source}: expected a KITTI calibration with P2 (12 or 16 numbers); got {found}.")
    projection = torch.tensor(entries["P2"][:12], dtype=torch.float64).view(3, 4)
    camera_matrix = projection[:, :3]
    if not bool(torch.linalg.det(camera_matrix).abs() > 0):
        raise TorchweatherError(f"{source}: expected an invertible camera matrix in P2; got {camera_matrix.tolist()}.")
    return projection


def read_kitti_rectified_from_lidar(path: str | os.PathLike[str]) -> Tensor:
    """From the Velodyne to the rectified frame of camera 0, in which KITTI's labels place their boxes.

    ``T = R0_rect Tr_velo_to_cam``; `read_kitti_calibration` goes on from there to camera 2, 6 cm beside.

    Args:
        path: as of `read_kitti_calibration`.

    Returns:
        ``(4, 4)`` float64.

    Raises:
        TorchweatherError: the file is missing or broken, or has names but lacks the Velodyne's.
    """
    check_arguments("read_kitti_rectified_from_lidar(path: path)", path)
    source = Path(path)
    return _rectified_from_lidar(read_kitti_entries(source), source)[0]


def _rectified_from_lidar(entries: dict[str, list[float]], source: Path) -> tuple[Tensor, str]:
    """The transform, and what had to be assumed."""
    missing = [key for key in (_RECTIFY, _VELODYNE) if key not in entries]
    if _ODOMETRY in entries:  # into the rectified camera
        _check_one_way(entries, source)
        rotation: Sequence[float] = _IDENTITY
        transform: Sequence[float] = entries[_ODOMETRY]
        missing = []
    else:
        if missing and not _is_bare(source):
            raise TorchweatherError(
                f"{source}: expected the Velodyne's place: R0_rect and Tr_velo_to_cam (object), R_rect and Tr_velo_cam "
                f"(tracking) or Tr (odometry); got {', '.join(entries) or 'no numbers'}, no "
                f"{' and no '.join(missing)}. Another day's would shift every point. Of the raw kit keep "
                "calib_velo_to_cam.txt beside calib_cam_to_cam.txt."
            )
        rotation, transform = entries.get(_RECTIFY, _R0_RECT), entries.get(_VELODYNE, _TR_VELO_TO_CAM)
    rectify, to_reference = torch.eye(4, dtype=torch.float64), torch.eye(4, dtype=torch.float64)
    name = _ODOMETRY if _ODOMETRY in entries else _VELODYNE
    try:
        rectify[:3, :3] = torch.tensor(rotation, dtype=torch.float64).view(3, 3)
        to_reference[:3] = torch.tensor(transform, dtype=torch.float64).view(3, 4)
    except RuntimeError as error:
        raise TorchweatherError(
            f"{source}: expected 9 numbers in R0_rect and 12 in {name}; got {len(rotation)} and {len(transform)}."
        ) from error
    for key, matrix in ((_RECTIFY, rectify), (name, to_reference)):
        turn = matrix[:3, :3]
        off = float((turn @ turn.T - torch.eye(3, dtype=torch.float64)).abs().max())
        if not off < _ORTHOGONAL or float(torch.linalg.det(turn)) < 0:
            raise TorchweatherError(f"{source}: expected a rotation in {key}, right-handed; got {turn.tolist()}.")
    assumption = f"{' and '.join(missing)} of KITTI's recording day 2011_09_26" if missing else ""
    return rectify @ to_reference, assumption


def _check_one_way(entries: dict[str, list[float]], source: Path) -> None:
    """Refuse a file with the odometry kit's transform and those of another kit."""
    rotation = entries.get(_RECTIFY, list(_IDENTITY))
    turned = len(rotation) != 9 or max(abs(a - b) for a, b in zip(rotation, _IDENTITY, strict=True)) > _ORTHOGONAL
    if _VELODYNE in entries or turned:
        raise TorchweatherError(
            f"{source}: expected either Tr, into the rectified camera (odometry), or R0_rect with Tr_velo_to_cam; got "
            f"{', '.join(entries)}. Take out those that do not belong to the sequence."
        )


def _is_bare(source: Path) -> bool:
    """True where a file holds numbers without names."""
    text = source.read_text(encoding="utf-8").lstrip()
    return bool(text) and not text[0].isalpha()


def read_kitti_entries(path: str | os.PathLike[str]) -> dict[str, list[float]]:
    """Named number lists of a calibration file, under the names of the object kit.

    The tracking kit leaves out some colons and the raw kit splits the file in two; both are read. Dates are left out.

    Args:
        path: a calibration file of any of KITTI's kits, or bare numbers, which are ``P2``.

    Raises:
        TorchweatherError: the file is missing, or a line is no name with numbers.
    """
    source = Path(path)
    if not source.name:
        raise TorchweatherError(f"{source}: expected the file of a KITTI calibration; got a folder.")
    cameras, velodyne = (source.with_name(name) for name in RAW_CALIBRATIONS)
    if source.name not in RAW_CALIBRATIONS:
        return _named_numbers(source)
    entries = _named_numbers(cameras) if source.name == cameras.name or cameras.is_file() else {}
    if source.name == velodyne.name or velodyne.is_file():
        beside = _named_numbers(velodyne)
        rotation, shift = beside.get("R", []), beside.get("T", [])
        if (len(rotation), len(shift)) != (9, 3):
            raise TorchweatherError(
                f"{velodyne}: expected 9 numbers in R and 3 in T; got {len(rotation)} and {len(shift)}."
            )
        entries[_VELODYNE] = [n for row in range(3) for n in (*rotation[3 * row : 3 * row + 3], shift[row])]
    return entries


def _named_numbers(source: Path) -> dict[str, list[float]]:
    aliases = {"R_rect": "R0_rect", "R_rect_00": "R0_rect", "Tr_velo_cam": "Tr_velo_to_cam"}
    aliases |= {f"P_rect_0{number}": f"P{number}" for number in range(4)}
    entries: dict[str, list[float]] = {}
    try:
        for line in source.read_text(encoding="utf-8").splitlines():
            name, colon, numbers = line.partition(":")
            if not colon and line[:1].isalpha() and len(line.split()) > 9:  # tracking: R_rect, Tr_velo_cam
                name, colon, numbers = line.partition(" ")
            key, text = (name.strip(), numbers) if colon else ("P2", line)
            if key == "calib_time":
                continue
            values = [float(word) for word in text.split()]
            if not all(map(math.isfinite, values)):
                raise InputValueError(f"{key} holds NaN or infinity")
            if values:
                entries.setdefault(aliases.get(key, key), []).extend(values)
    except FileNotFoundError as error:
        raise TorchweatherError(f"{source}: no such file.") from error
    except (OSError, ValueError) as error:
        raise TorchweatherError(f"{source}: expected a KITTI calibration (names, colon, numbers); {error}.") from error
    return entries
