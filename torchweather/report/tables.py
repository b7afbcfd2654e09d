"""The table of physical numbers of a page: which rows, in which order, how each number is written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Cell", "Row", "number_text", "rows_of"]

# Key in the summary, name, unit, group. A share is shown in per cent.
ROWS = (
    ("extinction_red_per_m", "Extinction, red", "1/m", "Air"),
    ("extinction_green_per_m", "Extinction, green", "1/m", "Air"),
    ("extinction_clear_per_m", "Extinction, clear", "1/m", "Air"),
    ("extinction_blue_per_m", "Extinction, blue", "1/m", "Air"),
    ("mor_m", "Visibility (MOR, from Mie at 550 nm)", "m", "Air"),
    ("particles_per_m3", "Particles", "1/m³", "Air"),
    ("liquid_water_g_per_m3", "Liquid water content", "g/m³", "Air"),
    ("optical_depth_28_m", "Optical depth to 28 m, as the camera sees it", "", "Light"),
    ("optical_depth_56_m", "Optical depth to 56 m, as the camera sees it", "", "Light"),
    ("transmission_28_m", "Transmission from 28 m", "%", "Light"),
    ("transmission_56_m", "Transmission from 56 m", "%", "Light"),
    ("particles_in_view", "Particles between camera and scene", "", "Particles"),
    ("particles_drawn_one_by_one", "Particles drawn one by one", "", "Particles"),
    ("share_drawn_one_by_one", "Share of particles drawn one by one", "%", "Particles"),
    ("share_of_optical_depth_drawn_one_by_one", "Share of optical depth drawn one by one", "%", "Particles"),
    ("mask_mean", "Mean of the particle mask, rendered", "%", "Particles"),
    ("mask_mean_expected", "Mean of the particle mask, expected: 1 − exp(−τ)", "%", "Particles"),
    ("set_up_s", "Set-up of the transform", "s", "Time"),
    ("draw_s", "Draw of the random numbers", "s", "Time"),
    ("render_s", "Rendering of the frame", "s", "Time"),
)
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Cell:
    """A number as it stands in the summary, and as it is written."""

    value: float
    text: str


@dataclass(frozen=True)
class Row:
    """A quantity over the strengths of a weather."""

    key: str
    name: str
    unit: str
    group: str
    cells: tuple[Cell, ...]


def number_text(value: float) -> str:
    """A number with three significant digits, for reading.

    Example:
        >>> [number_text(v) for v in (0.0, 0.002714, 2.5, 4213.0, 73500000.0, 2.1e-7)]
        ['0', '0.00271', '2.50', '4 210', '7.35 × 10⁷', '2.10 × 10⁻⁷']
    """
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "∞"
    mantissa, _, power = f"{value:.2e}".partition("e")
    exponent = int(power)
    if not -4 <= exponent < 5:
        return f"{mantissa} × 10{str(exponent).translate(SUPERSCRIPT)}"
    rounded = float(f"{value:.2e}")
    return f"{rounded:,.{max(0, 2 - exponent)}f}".replace(",", " ")


def rows_of(records: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Rows for the weathers of a section; those that none of them has are left out."""
    columns = [{**record["numbers"], **record["times_s"]} for record in records]
    rows = []
    for key, name, unit, group in ROWS:
        if any(key not in column for column in columns):
            continue
        values = [column[key] for column in columns]
        cells = tuple(Cell(v, number_text(100 * v if unit == "%" else v)) for v in values)
        rows.append(Row(key, name, unit, group, cells))
    return rows
