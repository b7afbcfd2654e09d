"""Checks of a cloud that a LiDAR transform takes."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from torch import Tensor

from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning, owner_name
from torchweather.lidar.cloud_frame import are_plain, points_in_sensor_frame
from torchweather.lidar.intensity import zero_intensity
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import ToEnergy
from torchweather.pipeline.tiling import is_exporting

__all__ = ["below_floor", "check_points"]

COLUMNS_WANTED = "x, y, z in metres and intensity"
# Intensities whose bulk contradicts the declared unit: a reflectivity above this is none, but of a few retroreflectors;
# 8-bit values that lie below this, some of them no integers, are no 8-bit values.
BRIGHTEST_REFLECTIVITY = 4.0
FAINTEST_FULL_SCALE = 1.0
BULK = 0.9  # quantile of the intensities above 0
# Farther than this is no return but a mark of none, such as the largest float; its square may overflow.
FARTHEST_M = 1e9


def below_floor(points: Tensor, sensor: Lidar) -> tuple[int, int]:
    """Returns of a cloud ``(..., N, 4 or more)`` whose intensity says less than the detection threshold, and all
    returns.

    Example:
        >>> cloud = torch.tensor([[10.0, 0.0, 0.0, 0.5], [40.0, 0.0, 0.0, 0.001]])
        >>> below_floor(cloud, Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity"))
        (1, 2)
    """
    values = points_in_sensor_frame(points.detach()[..., :4].double(), sensor)
    range_m = values[..., :3].square().sum(-1).sqrt()
    stage = ToEnergy(sensor).double()
    seen = (range_m > 0) & range_m.isfinite()
    zero = zero_intensity(values[..., 3], sensor.intensity_unit, sensor.zero_intensity)
    return int((seen & stage.contradicts_threshold(values[..., 3], range_m, zero)).sum()), int(seen.sum())


def check_points(points: Tensor, sensor: Lidar, owner: object) -> None:
    """Refuse what is no point cloud ``(..., N, 4 or more)``; warn where intensities contradict the declared unit."""
    name = owner_name(owner)
    if not isinstance(points, Tensor):
        raise InputTypeError(
            f"{name}: points must be a tensor (..., N, 4 or more); got {type(points).__name__}. For a numpy array call "
            "on_numpy(points)."
        )
    named = {name: getattr(sensor, name) for name in ("ring_column", "speed_column")}
    wanted = max(4, *(1 + (column or 0) for column in named.values()))
    if points.ndim < 2 or points.shape[-1] < 4:
        raise InputValueError(
            f"{name}: points must have shape (..., N, 4 or more) = {COLUMNS_WANTED}; got {tuple(points.shape)}. If "
            'your sensor gives no intensity, append a column of ones and set Lidar(intensity_unit="none").'
        )
    if points.shape[-1] < wanted:
        given = ", ".join(f"{key}={column}" for key, column in named.items() if column is not None)
        raise InputValueError(f"{name}: Lidar({given}) needs {wanted} columns; got {tuple(points.shape)}.")
    if not points.is_floating_point():
        raise InputTypeError(
            f"{name}: points must be floating point ({COLUMNS_WANTED}); got {points.dtype}. Use .float()."
        )
    if is_exporting() or not points.numel():
        return
    if are_plain(points) and (known := _numbers_of_good(points)) is not None:
        _warn_of_unit(points.detach()[..., 3], known[0], sensor, name, known[1:])
        return
    # One sum sees every NaN and every infinity, and what is absurdly far; only then is it worth looking for them.
    total = float(points.detach().sum(dtype=torch.promote_types(points.dtype, torch.float32)))
    if not abs(total) < FARTHEST_M:
        _refuse_absurd(points.detach(), name)
    intensity = points.detach()[..., 3]
    low, high = (float(value) for value in torch.aminmax(intensity))
    if low < 0:
        raise InputValueError(
            f"{name}: intensities must be 0 or more ({sensor.intensity_unit}); got {low:g}. Clip or rescale the column."
        )
    _warn_of_unit(intensity, high, sensor, name)


def _numbers_of_good(points: Tensor) -> tuple[float, int, int] | None:
    """Largest intensity, how many are above 0 and how many are bright; ``None`` where there is something to refuse."""
    from torchweather.lidar.compiled_cloud import look_at

    rows = points.detach().reshape(-1, points.shape[-1]).contiguous().numpy()
    limits = np.float32(FARTHEST_M), np.float32(BRIGHTEST_REFLECTIVITY)
    odd, low, high, positive, bright = (int(one) for one in look_at(rows, rows.view(np.int32), *limits))
    if odd or low < 0:
        return None
    return float(np.array(high, np.int32).view(np.float32)), positive, bright


def _refuse_absurd(points: Tensor, name: str) -> None:
    bad = ~torch.isfinite(points)
    rows = bad.any(-1)
    if bool(rows.any()):
        columns = sorted({int(column) for column in bad.reshape(-1, points.shape[-1]).any(0).nonzero().flatten()})
        raise InputValueError(
            f"{name}: points must be finite; got {int(rows.sum())} rows with NaN or infinity (columns {columns}). Give "
            "a beam without return the coordinates 0, 0, 0."
        )
    farthest_m = float(points[..., :3].abs().max())
    if farthest_m >= FARTHEST_M:
        raise InputValueError(
            f"{name}: coordinates must be metres; got {farthest_m:g}, too far for a return. Give a beam without return "
            "the coordinates 0, 0, 0."
        )


def _warn_of_unit(
    intensity: Tensor, high: float, sensor: Lidar, name: str, counts: tuple[int, int] | None = None
) -> None:
    unit = sensor.intensity_unit
    eight_bits = unit in ("uint8_linear", "uint8_calibrated")
    bright = high > (BRIGHTEST_REFLECTIVITY if unit == "reflectivity" else 255.0)
    faint = 0 < high <= FAINTEST_FULL_SCALE and bool((intensity != intensity.floor()).any())
    evidence = ""
    if bright and (unit == "reflectivity" or eight_bits):
        evidence = _too_bright(intensity, unit, counts)
    elif faint and (eight_bits or unit == "reflectivity_percent"):
        evidence = f"the largest is {high:g} and not all are integers. Is the unit reflectivity (0-1)?"
    if evidence:
        warnings.warn(
            f"{name}: the sensor declares intensity_unit={unit!r}, but of the cloud's intensities {evidence} Set "
            "Lidar(intensity_unit=...).",
            TorchweatherWarning,
            stacklevel=6,
        )


def _too_bright(intensity: Tensor, unit: str, counts: tuple[int, int] | None = None) -> str:
    """Evidence for a brighter unit from the bulk of the intensities; empty where only a few are bright."""
    if unit == "reflectivity":
        # Whether the bulk's largest value is above the limit follows from two counts, in a tenth of its time.
        number, bright = counts or (
            int(torch.count_nonzero(intensity > 0)),
            int(torch.count_nonzero(intensity > BRIGHTEST_REFLECTIVITY)),
        )
        dim = number - bright
        if dim >= max(1, round(BULK * number)):
            return ""
    positive = intensity[intensity > 0].double()
    bulk = float(positive.kthvalue(max(1, round(BULK * len(positive)))).values)
    if unit == "reflectivity":
        guess = "uint8_linear (0-255)" if bulk <= 255 else "photons"
        bulky = f"a tenth lies above {bulk:g}, where a white target has 1. Is the unit {guess}?"
        return bulky if bulk > BRIGHTEST_REFLECTIVITY else ""
    if bulk > 255:
        return f"a tenth lies above {bulk:g}, where the largest is 255. Is the unit photons?"
    above = int((positive > 255).sum())
    return (
        f"{above} of {len(positive)} lie above 255, which 8 bits cannot hold; nine tenths lie at {bulk:g} or below, so "
        "the unit itself is plausible. Look at those points, or clip the column."
    )
