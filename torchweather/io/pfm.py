"""Portable float maps (``.pfm``): one float32 a pixel, as stereo matchers and their benchmarks write disparity."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchweather.core.errors import TorchweatherError

__all__ = ["read_pfm"]

_HEADER_BYTES = 200  # far more than three short lines take
_VALUE_BYTES = 4
# One byte of white space ends the header.
_HEADER = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+([-+0-9.eE]{1,40})\s")


def read_pfm(source: Path) -> npt.NDArray[Any]:
    """The values of a grey map, ``(H, W)`` float32, first row on top.

    Raises:
        TorchweatherError: no grey map, or not as many values as its header says.

    References:
        P. Debevec, the PFM format: ``Pf``, width and height, a scale whose sign is negative for little endian; rows
        from the bottom to the top.
    """
    if not source.is_file():
        raise TorchweatherError(f"{source}: no such file.")
    with source.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    if head[:2] != b"Pf":
        got = "three channels (PF)" if head[:2] == b"PF" else "no PFM header"
        raise TorchweatherError(f"{source}: expected a grey portable float map, which begins with Pf; got {got}.")
    found = _HEADER.match(head)
    if found is None:
        raise TorchweatherError(f"{source}: expected width, height and scale in the header of a .pfm; got others.")
    width, height = int(found[1]), int(found[2])
    try:
        scale = float(found[3])
    except ValueError:
        scale = math.nan
    if min(width, height) < 1 or not math.isfinite(scale) or scale == 0:
        raise TorchweatherError(
            f"{source}: expected a size above 0 and a scale other than 0; got {width} x {height}, scale {scale:g}."
        )
    wanted, there = width * height * _VALUE_BYTES, source.stat().st_size
    if there - found.end() != wanted:
        raise TorchweatherError(
            f"{source}: {width} x {height} values take {wanted} bytes behind the header; the file has "
            f"{there - found.end()}. It is truncated or its header is wrong."
        )
    values = np.fromfile(source, dtype="<f4" if scale < 0 else ">f4", offset=found.end())
    return np.ascontiguousarray(values.reshape(height, width)[::-1]).astype(np.float32)
