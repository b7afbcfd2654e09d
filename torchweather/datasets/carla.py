"""Raw buffers of CARLA's sensors to tensors of this library, and back.

CARLA's axes are Unreal's: x forward, y to the right, z up, left-handed; azimuth runs from x to the right. Here y is to
the left, right-handed, and azimuth runs to the left: y and azimuth change sign, and nothing else knows of it. The
functions take any object with the attributes of the sensor reference (``raw_data``, ``width``, ``height``, ``fov``);
the package ``carla`` is not needed.

References:
    https://carla.readthedocs.io/en/latest/ref_sensors/ (layout of the buffers, 0.9.x).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputTypeError, InputValueError, check_between
from torchweather.io.depth import CARLA_FAR_M, CARLA_FULL, carla_depth_m
from torchweather.io.row_layout import looks_semantic
from torchweather.physics.radar_equation import received_power_dbm
from torchweather.pipeline.point_kind import PointKind
from torchweather.radar.sensor import Radar

__all__ = [
    "camera_from_carla",
    "depth_from_carla",
    "depth_to_carla",
    "detections_from_carla",
    "detections_to_carla",
    "image_from_carla",
    "image_to_carla",
    "points_from_carla",
    "points_to_carla",
    "pose_from_carla",
]

# A point of the semantic LiDAR (SemanticLidarDetection in LibCarla).
_SEMANTIC = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "cos_inc_angle")] + [("object_idx", "<u4"), ("object_tag", "<u4")]
)
VALUES_A_ROW = 6  # semantic LiDAR
FLOATS_A_ROW = 4  # LiDAR: x, y, z, intensity; radar: velocity, azimuth, altitude, depth
# Mean cross section of a passenger car at 77 GHz: 10.6 dBsm in radar/fmcw/car.py; ISO 15622 tests with 10 m^2.
CAR_RCS_DBSM = 10.0


class CarlaImage(Protocol):
    """Fields of a ``carla.Image``."""

    raw_data: Any
    width: int
    height: int


class CarlaMeasurement(Protocol):
    """Fields of a ``carla.LidarMeasurement`` or ``carla.RadarMeasurement``."""

    raw_data: Any


# ---- camera --------------------------------------------------------------------------------------------------------


def image_from_carla(image: CarlaImage) -> Tensor:
    """Frame of an RGB camera: BGRA bytes to ``(3, H, W)`` uint8, red, green, blue, with memory of its own.

    Args:
        image: with ``raw_data``, ``width`` and ``height`` in pixels.

    Note:
        The frame is tone-mapped for a screen: give it to `AsBayer`, which decodes sRGB. Switch off what is weather or
        lens already: ``enable_postprocess_effects`` (bloom, flares, exposure that adapts) and the world's own
        ``fog_density`` and ``precipitation``.

    Example:
        >>> from types import SimpleNamespace
        >>> one = SimpleNamespace(raw_data=bytes([10, 20, 30, 255]), width=1, height=1)
        >>> image_from_carla(one).flatten()
        tensor([30, 20, 10], dtype=torch.uint8)
    """
    return torch.from_numpy(np.ascontiguousarray(_bgra(image, "image_from_carla")[..., 2::-1].transpose(2, 0, 1)))


def image_to_carla(rgb: Tensor) -> npt.NDArray[np.uint8]:
    """BGRA bytes ``(H, W, 4)`` of an image ``(3, H, W)`` uint8, alpha 255; ``.tobytes()`` is CARLA's ``raw_data``."""
    check_arguments("image_to_carla(rgb: real)", rgb)
    if rgb.ndim != 3 or rgb.shape[0] != 3 or rgb.dtype != torch.uint8:
        raise InputValueError(f"image_to_carla: rgb must be (3, H, W) uint8; got {rgb.dtype} {tuple(rgb.shape)}.")
    array: npt.NDArray[np.uint8] = rgb.detach().cpu().numpy().transpose(1, 2, 0)
    return np.dstack((array[..., ::-1], np.full(array.shape[:2], 255, np.uint8)))


def depth_from_carla(image: CarlaImage) -> Tensor:
    """Frame of a depth camera: ``(1, H, W)`` float32, metres along the optical axis; ``inf`` at the far plane, 1000 m.

    Args:
        image: with ``raw_data``, ``width`` and ``height``; the coded depth itself, not what a ``ColorConverter`` made.

    Example:
        >>> from types import SimpleNamespace
        >>> one = SimpleNamespace(raw_data=bytes([1, 0, 0, 255]), width=1, height=1)
        >>> round(float(depth_from_carla(one)), 4)  # the blue byte counts 65536 steps of 1000 m / (2^24 - 1)
        3.9063
    """
    return carla_depth_m(image_from_carla(image))


def depth_to_carla(depth_m: Tensor) -> npt.NDArray[np.uint8]:
    """Coded depth ``(H, W, 4)`` of a map ``(1, H, W)`` in metres; 1000 m and more is the far plane.

    The step of the code is 60 um.
    """
    check_arguments("depth_to_carla(depth_m: floating)", depth_m)
    if depth_m.ndim != 3 or depth_m.shape[0] != 1 or not bool((depth_m >= 0).all()):
        raise InputValueError(
            f"depth_to_carla: depth_m must be (1, H, W) in metres, 0 or more, inf for sky; got {tuple(depth_m.shape)}"
            f"{' with NaN or negative values' if depth_m.ndim == 3 and depth_m.shape[0] == 1 else ''}."
        )
    share = depth_m[0].detach().cpu().double().clamp_max(CARLA_FAR_M) / CARLA_FAR_M
    code = torch.round(share * CARLA_FULL).long()
    return image_to_carla(torch.stack([(code >> shift) & 255 for shift in (0, 8, 16)]).to(torch.uint8))


def camera_from_carla(image: Any, **more: Any) -> Camera:
    """The camera of a frame: from its size and horizontal angle of view; square pixels, no distortion.

    Args:
        image: with ``width``, ``height`` and ``fov``, degrees.
        more: other fields of `Camera`, such as ``exposure_s``, ``height_m``, ``pitch_rad``.

    Note:
        CARLA warps the frame a little near its edges (``lens_k`` and others); set ``lens_k`` and ``lens_kcube`` to 0
        where that matters.

    Example:
        >>> from types import SimpleNamespace
        >>> camera_from_carla(SimpleNamespace(width=800, height=600, fov=90.0)).intrinsics
        (400.0, 400.0, 399.5, 299.5)
    """
    _check_has(image, "camera_from_carla", "width", "height", "fov")
    check_between("fov", image.fov, 0.1, 179.0, unit="degrees", owner="camera_from_carla")
    focal_px = round(0.5 * image.width / math.tan(0.5 * math.radians(image.fov)), 9)
    return Camera(**{"width": image.width, "height": image.height, "fx": focal_px, "fy": focal_px, **more})


# ---- LiDAR ---------------------------------------------------------------------------------------------------------


def points_from_carla(measurement: CarlaMeasurement, reflectivity: float | None = None) -> Tensor:
    """Cloud of a ray-cast LiDAR: ``(N, 4)`` float32, x forward, y left, z up in metres, intensity.

    The semantic LiDAR has 24 bytes a point, of which two are whole numbers. Its cloud is ``(N, 6)``: x, y, z, cosine
    of the angle of incidence, index of the object, tag of its class.

    Args:
        measurement: with ``raw_data``: float32 x, y, z, intensity of each return. A ``SemanticLidarMeasurement``, or
            24 bytes a point: float32 x, y, z, cosine, uint32 index, uint32 tag.
        reflectivity: put this into the intensity's column, 1 is Lambertian white; ``None`` leaves CARLA's number. Of
            the semantic LiDAR it is multiplied by the cosine, as the light that a matt surface sends back.

    Note:
        CARLA's intensity is ``exp(-a d)``, ``a`` the sensor's ``atmosphere_attenuation_rate`` and ``d`` the distance:
        it knows nothing of what was hit, and it is no reflectivity. Either take it as a column without meaning,
        ``Lidar(intensity_unit="none", assumed_reflectivity=...)``, which leaves it as it is, or give ``reflectivity``
        and ``Lidar(intensity_unit="reflectivity")``: then the weather dims it. Its attenuation and its drop-off are a
        weather of CARLA's own; set ``atmosphere_attenuation_rate``, ``dropoff_general_rate`` and
        ``dropoff_zero_intensity`` to 0, or it rains twice. Only returns are in the buffer; for beams without one, in
        which particles are seen as well, set ``complete_scan=True`` and the sensor's ``elevations_deg``, ``columns``.

    Example:
        >>> from types import SimpleNamespace
        >>> points_from_carla(SimpleNamespace(raw_data=np.float32([10, 2, -1, 0.96]).tobytes()))
        tensor([[10.0000, -2.0000, -1.0000,  0.9600]])
    """
    check_arguments("points_from_carla(reflectivity: float | None)", reflectivity)
    reflectivity = None if reflectivity is None else float(reflectivity)
    _check_has(measurement, "points_from_carla", "raw_data")
    semantic = _is_semantic(measurement)
    if semantic:
        points = torch.from_numpy(_semantic_rows(measurement))
    else:
        points = torch.from_numpy(_rows(measurement, "points_from_carla"))
    points[:, 1] = 0.0 - points[:, 1]  # 0 stays 0, without a sign
    if reflectivity is not None:
        check_between("reflectivity", reflectivity, 0.0, 1e6, owner="points_from_carla")
        points[:, 3] = reflectivity * points[:, 3].abs() if semantic else reflectivity
    return points


def points_to_carla(
    points: Tensor, *, semantic: bool = False, kind: Tensor | None = None
) -> npt.NDArray[np.float32] | npt.NDArray[np.void]:
    """A cloud ``(N, 4 or more)`` as CARLA's ``(M, 4)`` float32; ``.tobytes()`` is its ``raw_data``.

    Rows without a return are left out: CARLA has none.

    Args:
        points: ``(N, 4 or more)``; of the semantic LiDAR ``(N, 6)``.
        semantic: give rows of the semantic LiDAR, ``(M,)`` with the fields ``x``, ``y``, ``z``, ``cos_inc_angle``,
            ``object_idx``, ``object_tag``.
        kind: ``(N,)`` `PointKind` of each point, ``result.kind`` of a transform; particles get index 0 and tag 0
            (Unlabeled), where they would keep those of what they hide.
    """
    check_arguments("points_to_carla(points: real, semantic: bool, kind: Tensor | None)", points, semantic, kind)
    if not semantic:
        rows = _found(points, FLOATS_A_ROW, "points_to_carla")[:, :FLOATS_A_ROW]
        rows[:, 1] = 0.0 - rows[:, 1]
        return rows.astype(np.float32)
    if kind is not None and kind.shape != points.shape[:-1]:
        raise InputValueError(
            f"points_to_carla: kind must have one value for each of the points {tuple(points.shape[:-1])}; got "
            f"{tuple(kind.shape)}."
        )
    if kind is not None and points.ndim == 2 and points.shape[1] >= VALUES_A_ROW:
        kept = (kind != int(PointKind.PARTICLE)).to(points)[:, None]
        points = torch.cat([points[:, :4], kept * points[:, 4:6]], dim=1)
    rows = _found(points, VALUES_A_ROW, "points_to_carla")
    rows[:, 1] = 0.0 - rows[:, 1]
    found = np.zeros(len(rows), _SEMANTIC)
    for column, name in enumerate(_SEMANTIC.names or ()):
        found[name] = rows[:, column]
    return found


# ---- radar ---------------------------------------------------------------------------------------------------------


def detections_from_carla(measurement: CarlaMeasurement, radar: Radar, rcs_dbsm: float = CAR_RCS_DBSM) -> Tensor:
    """Detections of a radar: ``(N, 6)`` float32, x, y, z in metres, radial speed in m/s, power in dBm, RCS in dBsm.

    Args:
        measurement: with ``raw_data``: float32 velocity (m/s), azimuth, altitude (rad), depth (distance, m) of each.
        radar: whose link budget gives the power, by the radar equation of clear air at boresight.
        rcs_dbsm: cross section of every detection: CARLA has neither cross section nor power. Default: a passenger
            car's.

    Note:
        The speed is positive where the target recedes, as here: the simulator projects the target's velocity relative
        to the radar on the way from the radar to the target (``Radar.cpp``), whatever "towards the sensor" in the
        reference suggests. A detection is one ray that met a surface: there is no resolution, no noise and no clutter
        in it, and one car gives many.

    References:
        PHYSICS.md 6.2.

    Example:
        >>> from types import SimpleNamespace
        >>> ahead = SimpleNamespace(raw_data=np.float32([-3.0, 0.0, 0.0, 50.0]).tobytes())
        >>> [round(value, 1) for value in detections_from_carla(ahead, Radar(), rcs_dbsm=0.0)[0].tolist()]
        [50.0, 0.0, 0.0, -3.0, -111.1, 0.0]
    """
    check_arguments("detections_from_carla(radar: Radar, rcs_dbsm: float)", radar, rcs_dbsm)
    _check_has(measurement, "detections_from_carla", "raw_data")
    check_between("rcs_dbsm", rcs_dbsm, -300.0, 300.0, unit="dBsm", owner="detections_from_carla")
    speed, azimuth, altitude, range_m = torch.from_numpy(_rows(measurement, "detections_from_carla")).double().unbind(1)
    found = torch.zeros(len(speed), 6, dtype=torch.float64)
    found[:, 0] = range_m * torch.cos(altitude) * torch.cos(azimuth)
    found[:, 1] = 0.0 - range_m * torch.cos(altitude) * torch.sin(azimuth)
    found[:, 2] = range_m * torch.sin(altitude)
    found[:, 3], found[:, 5] = speed, float(rcs_dbsm)
    hit = range_m > 0
    found[hit, 4] = received_power_dbm(
        rcs_dbsm,
        range_m[hit],
        frequency_ghz=radar.frequency_ghz,
        transmit_power_dbm=radar.transmit_power_dbm,
        antenna_gain_dbi=2.0 * radar.antenna_gain_dbi,
        loss_db=radar.loss_db,
    )
    return torch.where(hit[:, None], found, 0.0).float()


def detections_to_carla(detections: Tensor) -> npt.NDArray[np.float32]:
    """Detections ``(N, 6 or more)`` as CARLA's ``(M, 4)`` float32: velocity, azimuth, altitude, depth.

    ``.tobytes()`` is CARLA's ``raw_data``. Lost ones are left out; power and cross section have no place there.
    """
    check_arguments("detections_to_carla(detections: real)", detections)
    x, y, z, speed = _found(detections, 6, "detections_to_carla")[:, :4].T
    flat = np.hypot(x, y)
    return np.stack((speed, 0.0 - np.arctan2(y, x), np.arctan2(z, flat), np.hypot(flat, z)), axis=1).astype(np.float32)


# ---- poses ---------------------------------------------------------------------------------------------------------


def pose_from_carla(transform: Any) -> Tensor:
    """A ``carla.Transform`` as ``T_parent_from_sensor``, ``(4, 4)`` float64, metres, right-handed.

    Args:
        transform: an object with ``get_matrix()``, such as a ``carla.Transform``, or that matrix itself, 4 x 4.

    Returns:
        ``S M S`` with ``S = diag(1, -1, 1, 1)``: the same motion between frames with y to the left. For a camera the
        result is that of its body (x forward), not of its image (z along the axis). It is its own inverse:
        ``pose_from_carla(pose_from_carla(M))`` is M.

    Example:
        >>> moved_right = [[1, 0, 0, 0], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]
        >>> pose_from_carla(moved_right)[:, 3]
        tensor([ 0., -2.,  0.,  1.], dtype=torch.float64)
    """
    matrix: Tensor | Sequence[Sequence[float]] = (
        transform.get_matrix() if hasattr(transform, "get_matrix") else transform
    )
    try:
        numbers = np.asarray(matrix)
        found = torch.as_tensor(numbers.real.astype(np.float64) if numbers.dtype.kind in "fiu" else None)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputTypeError(
            f"pose_from_carla: transform must be a carla.Transform or its matrix of numbers; got {matrix!r:.100}."
        ) from error
    if found.shape != (4, 4):
        raise InputValueError(
            "pose_from_carla: transform must be a carla.Transform or its matrix, (4, 4) in metres; got shape "
            f"{tuple(found.shape)}."
        )
    mirror = torch.tensor([1.0, -1.0, 1.0, 1.0], dtype=torch.float64)
    return mirror[:, None] * found * mirror + 0.0  # + 0: no zero with a sign


# ---- buffers -------------------------------------------------------------------------------------------------------


def _bgra(image: CarlaImage, owner: str) -> npt.NDArray[np.uint8]:
    """``(H, W, 4)`` bytes, a view of the buffer."""
    _check_has(image, owner, "raw_data", "width", "height")
    flat: npt.NDArray[np.uint8] = np.frombuffer(image.raw_data, np.uint8)
    wanted = 4 * image.width * image.height
    if flat.size != wanted or not wanted:
        raise InputValueError(
            f"{owner}: raw_data must hold {image.width} x {image.height} pixels of 4 bytes (blue, green, red, alpha), "
            f"{wanted} bytes; got {flat.size}."
        )
    return flat.reshape(image.height, image.width, 4)


def _check_has(sensor_data: object, owner: str, *names: str) -> None:
    """Refuse what is none of CARLA's objects."""
    missing = [name for name in names if not hasattr(sensor_data, name)]
    if missing:
        raise InputTypeError(f"{owner}: expected an object of CARLA with {', '.join(names)}; got {sensor_data!r:.100}.")
    if "raw_data" in names:
        try:
            memoryview(sensor_data.raw_data)  # type: ignore[attr-defined]
        except TypeError as error:
            raise InputTypeError(f"{owner}: raw_data of {sensor_data!r:.100} must be bytes.") from error


def _is_semantic(measurement: CarlaMeasurement) -> bool:
    """True where a measurement is the semantic LiDAR's, by its class or else by its numbers."""
    return "Semantic" in type(measurement).__name__ or looks_semantic(np.frombuffer(measurement.raw_data, np.uint8))


def _semantic_rows(measurement: CarlaMeasurement) -> npt.NDArray[np.float32]:
    """``(N, 6)`` floats with memory of their own."""
    size = memoryview(measurement.raw_data).nbytes
    if size % _SEMANTIC.itemsize:
        raise InputValueError(
            f"points_from_carla: raw_data of a semantic LiDAR must hold rows of {_SEMANTIC.itemsize} bytes (x, y, z, "
            f"cosine, index, tag); got {size} bytes."
        )
    rows = np.frombuffer(measurement.raw_data, _SEMANTIC)
    found: npt.NDArray[np.float32] = np.stack([rows[name].astype(np.float32) for name in _SEMANTIC.names or ()], axis=1)
    if not bool(np.isfinite(found).all()):
        raise InputValueError("points_from_carla: raw_data must hold finite numbers; got NaN or infinity.")
    if bool((rows["object_idx"] > 1 << 24).any()):
        raise InputValueError(
            f"points_from_carla: indices of objects must be {1 << 24} or less, which float32 holds exactly; got "
            f"{int(rows['object_idx'].max())}."
        )
    return found


def _rows(measurement: CarlaMeasurement, owner: str) -> npt.NDArray[np.float32]:
    """``(N, 4)`` floats with memory of their own: CARLA takes the buffer back after the callback."""
    size = memoryview(measurement.raw_data).nbytes
    if size % (4 * FLOATS_A_ROW):
        raise InputValueError(
            f"{owner}: raw_data must hold rows of four 32-bit floats, a multiple of 16 bytes; got {size} bytes. Is it "
            "the buffer of another sensor? A semantic LiDAR's has 24 bytes a point."
        )
    floats: npt.NDArray[np.float32] = np.frombuffer(measurement.raw_data, "<f4").astype(np.float32)
    if not bool(np.isfinite(floats).all()):
        raise InputValueError(f"{owner}: raw_data must hold finite numbers; got NaN or infinity.")
    return floats.reshape(-1, FLOATS_A_ROW)


def _found(points: Tensor, columns: int, owner: str) -> npt.NDArray[np.float64]:
    """The rows that are returns, float64."""
    if points.ndim != 2 or points.shape[1] < columns:
        raise InputValueError(f"{owner}: points must be (N, {columns} or more), one sample; got {tuple(points.shape)}.")
    rows: npt.NDArray[np.float64] = points.detach().cpu().double().numpy()
    there = (rows[:, :3] != 0).any(axis=1) & np.isfinite(rows[:, :3]).all(axis=1)
    found: npt.NDArray[np.float64] = rows[there]
    return found
