"""Polar power pictures of radars that turn: bare ones (RADIATE, MulRan), and those of Oxford and Boreas, whose first
eleven columns hold the time, the azimuth and a flag of each row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherError
from torchweather.io.images import read_image
from torchweather.io.map_layout import MapLayout
from torchweather.radar.power_map import MapAxes, PowerScale

__all__ = ["METADATA_COLUMNS", "PolarPicture", "read_polar_png"]

METADATA_COLUMNS = 11  # 8 bytes of time, 2 of the encoder, 1 flag
ENCODER_TICKS = 5600  # of a turn; Oxford Radar RobotCar's development kit
MEASURED = 255  # flag of a row that was measured; others are interpolated
AZIMUTHS = 400  # of a turn of Navtech's radars
LEAST_ROWS = 8


@dataclass(frozen=True, eq=False)
class PolarPicture:
    """A polar picture and what its first columns say.

    Args:
        values: the power, as ``axes``.
        axes: azimuth clockwise from forward, unless a layout says otherwise.
        scale: of the bytes.
        header: ``(A, 11)`` the bytes in front of each row; ``None`` without.
        timestamps: ``(A,)`` int64 as stored; ``None`` without.
        measured: ``(A,)`` bool, false where a row was interpolated from its neighbours; ``None`` without.
        notes: how axes and scale were found.
    """

    values: Tensor
    axes: MapAxes
    scale: PowerScale
    header: Tensor | None
    timestamps: Tensor | None
    measured: Tensor | None
    notes: tuple[str, ...]


def read_polar_png(source: Path, layout: MapLayout) -> PolarPicture:
    """A polar picture of one byte a cell.

    Args:
        source: the file.
        layout: the width of a range bin at least, which no such picture holds.

    Raises:
        TorchweatherError: no grey picture of 8 bits, or one whose axes are not known.
    """
    pixels = read_image(source)[0]
    if pixels.dtype != torch.uint8 or pixels.shape[0] != 1 or pixels.ndim != 3:
        raise TorchweatherError(
            f"{source}: expected a grey picture of 8 bits, range by azimuth; got {pixels.dtype} "
            f"{tuple(pixels.shape)}. A picture in colours is a rendering and holds no power."
        )
    whole = pixels[0]
    if layout.range_m is None:
        raise TorchweatherError(
            f"{source}: the width of a range bin is not in the file. Name the data set (layout='radiate', 'oxford', "
            "'mulran', 'boreas-2020', 'boreas-2021'), or give range_m in a layout (YAML)."
        )
    scale = layout.scale_of(is_bytes=True, is_complex=False, source=source)
    if not has_metadata(whole):
        filled = _bare(layout, tuple(whole.shape), source)
        note = "azimuths: a full turn, clockwise from forward" if layout.azimuth_deg is None else "azimuths: as given"
        return PolarPicture(whole, filled.axes_of(whole.shape, source), scale, None, None, None, (note,))
    header, values = whole[:, :METADATA_COLUMNS].contiguous(), whole[:, METADATA_COLUMNS:].contiguous()
    ticks = header[:, 8:10].contiguous().view(torch.uint16)[:, 0].long()
    times = header[:, :8].contiguous().view(torch.int64)[:, 0]
    if layout.dims not in (None, ("azimuth", "range")):
        raise TorchweatherError(
            f"{source}: the picture holds the time and azimuth of each row, so its dims are [azimuth, range]; got "
            f"{list(layout.dims or ())} from the layout."
        )
    azimuth_deg = layout.azimuth_deg or tuple(-360.0 / ENCODER_TICKS * float(tick) for tick in ticks)
    axes = replace(layout, dims=("azimuth", "range"), azimuth_deg=azimuth_deg).axes_of(values.shape, source)
    measured = header[:, 10] == MEASURED
    notes = [f"azimuths: of the encoder, {ENCODER_TICKS} ticks a turn"]
    if not bool(measured.all()):
        notes.append(f"{int((~measured).sum())} of {len(measured)} rows were interpolated by the recording")
    return PolarPicture(values, axes, scale, header, times, measured, tuple(notes))


def has_metadata(pixels: Tensor) -> bool:
    """Check whether the first eleven columns of a picture ``(A, 11 + R)`` hold times that rise, azimuths and flags."""
    if pixels.shape[0] < LEAST_ROWS or pixels.shape[1] <= METADATA_COLUMNS + 1:
        return False
    header = pixels[:, :METADATA_COLUMNS].contiguous()
    times = header[:, :8].contiguous().view(torch.int64)[:, 0]
    ticks = header[:, 8:10].contiguous().view(torch.uint16)[:, 0].long()
    flags = header[:, 10]
    rising = bool((times.diff() > 0).all()) and int(times[0]) > 0
    in_turn = bool((ticks < ENCODER_TICKS).all()) and bool(((ticks.diff() % ENCODER_TICKS) > 0).all())
    return rising and in_turn and bool(((flags == 0) | (flags == MEASURED)).all())


def _bare(layout: MapLayout, shape: tuple[int, ...], source: Path) -> MapLayout:
    """The layout with the order of the axes and a full turn filled in."""
    dims = layout.dims
    if dims is None:
        turns = [axis for axis, size in enumerate(shape) if size == AZIMUTHS]
        if len(turns) != 1:
            raise TorchweatherError(
                f"{source}: which side of {shape[0]} x {shape[1]} is the azimuth? Neither or both have {AZIMUTHS} "
                "cells. Give dims, [range, azimuth] or [azimuth, range], in a layout (YAML)."
            )
        dims = ("azimuth", "range") if turns[0] == 0 else ("range", "azimuth")
    azimuth_deg = layout.azimuth_deg
    if azimuth_deg is None and "azimuth" in dims and len(dims) == len(shape):
        azimuth_deg = {"first": 0.0, "step": -math.degrees(2.0 * math.pi / shape[dims.index("azimuth")])}
    return replace(layout, dims=dims, azimuth_deg=azimuth_deg)
