"""A LiDAR's cloud as its transforms take it: the intensity that its unit names, seen from where it stands."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from torchweather.core.arguments import check_arguments
from torchweather.io.point_cloud import PointCloud
from torchweather.io.points import read_points
from torchweather.lidar.sensor import Lidar

__all__ = ["PointReading", "read_sensor_points"]


@dataclass(frozen=True)
class PointReading:
    """Reading of point files; plain values, the arguments of `read_points`.

    Args:
        intensity: name of the column, ``auto`` or ``none``.
        bin_columns: of files without a header; ``None`` is the format's.
        bin_dtype: of columns without a type of their own.
        viewpoint: ``apply`` or ``ignore``; ``None`` applies it unless the sensor's place is given.
    """

    intensity: str = "auto"
    bin_columns: str | Sequence[str] | None = None
    bin_dtype: str = "float32"
    viewpoint: str | None = None


def read_sensor_points(path: str | os.PathLike[str], sensor: Lidar, reading: PointReading | None = None) -> PointCloud:
    """A cloud of a sensor.

    Args:
        path: as of `read_points`.
        sensor: whose ``intensity_unit`` chooses among several intensities, and whose place, where it is not the origin,
            takes that of a PCD file's viewpoint.
        reading: what else is known of the file.
    """
    check_arguments(
        "read_sensor_points(path: path, sensor: Lidar, reading: PointReading | None)",
        path,
        sensor,
        reading,
    )
    how = reading or PointReading()
    placed = sensor.rotation is not None or any(sensor.origin_m)
    return read_points(
        path,
        intensity=how.intensity,
        bin_columns=how.bin_columns,
        bin_dtype=how.bin_dtype,
        intensity_unit=sensor.intensity_unit,
        viewpoint=how.viewpoint or ("ignore" if placed else "apply"),
    )
