"""Drop size spectra from the files of disdrometers, whichever of the known formats they have."""

from __future__ import annotations

import os
from pathlib import Path

from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError, check_at_least, check_positive
from torchweather.core.file_names import check_no_device
from torchweather.io.drop_spectrum import DropSpectrum
from torchweather.io.parsivel import read_parsivel_netcdf, read_parsivel_telegrams
from torchweather.io.video_disdrometer import read_video_netcdf

__all__ = ["read_disdrometer"]


def read_disdrometer(
    path: str | os.PathLike[str], *, duration_s: float = 60.0, fall_speed_tolerance: float = 0.5
) -> DropSpectrum:
    """Drop size spectra of a disdrometer file; the format is recognised by its content.

    Args:
        path: Parsivel NetCDF with the raw spectrum (`data_raw` or `raw_drop_number`; needs h5netcdf and h5py), ARM 2DVD
            drop-by-drop NetCDF (`.cdf`), or Parsivel telegrams with 24 columns (`.dat`, `.dat.gz`, 30 s).
        duration_s: interval into which drop-by-drop data are sorted; the other formats bring their own.
        fall_speed_tolerance: drops whose speed differs from a raindrop's by more than this share are left out: they
            are edge hits, splashes, insects or snow. ``inf`` keeps all.

    Raises:
        TorchweatherError: the file is missing, truncated, or of none of these formats.
    """
    source = Path(path)
    check_no_device(source)
    check_positive("duration_s", duration_s, unit="s", owner="read_disdrometer")
    check_at_least("fall_speed_tolerance", fall_speed_tolerance, 0.0, owner="read_disdrometer")
    try:
        with source.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise TorchweatherError(f"{source}: cannot be read ({error}).") from error
    try:
        if head[:8] == b"\x89HDF\r\n\x1a\n":
            return read_parsivel_netcdf(source, fall_speed_tolerance)
        if head[:3] == b"CDF":
            return read_video_netcdf(source, duration_s, fall_speed_tolerance)
        return read_parsivel_telegrams(source, fall_speed_tolerance)
    except (InputValueError, InputTypeError) as error:  # of the numbers in the file
        raise TorchweatherError(f"{source}: {error}") from error
