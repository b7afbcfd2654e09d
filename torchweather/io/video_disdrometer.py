"""The 2D video disdrometer of the ARM network: every drop with its diameter, speed and sensing area."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch

from torchweather.core.errors import TorchweatherError
from torchweather.io.drop_spectrum import DropSpectrum, spectrum_from_drops

__all__ = ["read_video_netcdf"]

_VIDEO_EDGES_MM = np.arange(0.1, 10.05, 0.2)  # 2DVD convention: classes of 0.2 mm; below 0.1 mm nothing is resolved


def read_video_netcdf(source: Path, duration_s: float, fall_speed_tolerance: float) -> DropSpectrum:
    """Spectra of a drop-by-drop file of the ARM network, sorted into intervals; see `read_disdrometer`."""
    from scipy.io import netcdf_file

    wanted = ("equivolumetric_sphere_diameter", "fall_speed", "area", "time_offset", "base_time")
    try:
        # From memory, where a length that the file does not have takes none.
        with netcdf_file(io.BytesIO(source.read_bytes()), "r", mmap=False) as file:
            missing = [name for name in wanted if name not in file.variables]
            if missing:
                raise TorchweatherError(
                    f"{source}: expected the drops of a 2D video disdrometer; {', '.join(missing)} missing."
                )
            diameter, speed, area, offset, base = (
                torch.from_numpy(np.array(file.variables[name].data, dtype=np.float64)) for name in wanted
            )
    except (OSError, TypeError, ValueError, IndexError, KeyError) as error:
        raise TorchweatherError(f"{source}: expected NetCDF-3; it is truncated or damaged ({error}).") from error
    shapes = {tuple(one.shape) for one in (diameter, speed, area, offset)}
    if len(shapes) != 1 or diameter.ndim != 1 or base.numel() != 1:
        raise TorchweatherError(f"{source}: expected a number for each drop; got shapes {sorted(shapes)}.")
    good = (diameter > 0) & (speed > 0) & (area > 0)  # missing values are negative in these files
    if not bool(good.any()):
        raise TorchweatherError(f"{source}: expected drops of a 2D video disdrometer; the file holds none.")
    return spectrum_from_drops(
        diameter[good],
        speed[good],
        area[good],
        base + offset[good],
        edges_mm=torch.from_numpy(_VIDEO_EDGES_MM),
        duration_s=duration_s,
        instrument="2D video disdrometer",
        fall_speed_tolerance=fall_speed_tolerance,
    )
